"""The check of two programs that meet by signals, on hand-made automata.

The automata have classical faults, or random ones. The reference is a plain search without the reductions of
the check.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.programs.handshake.model import AutomatonAction, check_handshake
from tests.programs.automata import FOLLOW, LEAD, WIRES, put, wait, with_, work


def meeting(lead, phase, four):
    """One meeting; wire 0 leads from the lead to the other one, wire 1 back."""
    mine, other = (0, 1) if lead else (1, 0)
    if four:
        ask = [put(mine, 1), wait(other, 1), put(mine, 0), wait(other, 0)]
        answer = [wait(other, 1), put(mine, 1), wait(other, 0), put(mine, 0)]
    else:
        ask = [put(mine, phase), wait(other, phase)]
        answer = [wait(other, phase), put(mine, phase)]
    return ask if lead else answer


def start(lead):
    """Both lines are reset and read, and the lead asks the operator whether the other one is ready."""
    if lead:
        return [*work(0), put(0, 0), AutomatonAction("gate", value=4), wait(1, 0)]
    return [*work(0), put(1, 0), wait(0, 0)]


def program(lead, meetings=3, four=True, works=lambda k: True):
    out = start(lead)
    for k in range(1, meetings + 1):
        out += meeting(lead, k % 2, four)
        out += work(k) if works(k) else []
    return out


def both(**options):
    return [program(True, **options), program(False, **options)]


def kinds(programs, gates=True):
    return {finding.kind for finding in check_handshake(programs, WIRES, gates).findings}


@pytest.mark.parametrize("four", [True, False])
@pytest.mark.parametrize("meetings", [1, 2, 5])
def test_the_protocols_hold_whatever_the_delays(four, meetings):
    programs = both(four=four, meetings=meetings)
    assert not kinds(programs)
    assert not kinds(programs, gates=False)
    alternating = [
        program(True, 6, four, lambda k: k % 3 != 1),
        program(False, 6, four, lambda k: k % 3 != 2),
    ]
    assert not kinds(alternating)


@pytest.mark.parametrize("four", [True, False])
def test_both_setting_first_and_then_waiting_loses_an_edge(four):
    programs = [[], []]
    for mine, other in ((0, 1), (1, 0)):
        row = programs[mine]
        row += [
            put(mine, 0),
            AutomatonAction("gate", value=1),
            wait(other, 0),
            AutomatonAction("gate", value=3),
        ]
        for k in range(1, 4):
            steps = [(mine, 1), (mine, 0)] if four else [(mine, k % 2)]
            for wire, value in steps:
                row += [put(wire, value), wait(other, value)]
            row += work(k)
    assert kinds(programs) & {"lost_edge", "deadlock"}


@pytest.mark.parametrize("four", [True, False])
@pytest.mark.parametrize("who", [LEAD, FOLLOW])
def test_every_action_of_the_meetings_is_needed(four, who):
    """No set and no wait of a meeting can be left out, doubled in its level or taken for the other level."""
    good = both(four=four, meetings=4)
    first = len(start(who == LEAD))
    for place in range(first, len(good[who])):
        action = good[who][place]
        if action.kind not in ("set", "wait"):
            continue
        without = [list(row) for row in good]
        del without[who][place]
        assert kinds(without), (place, "left out")
        swapped = [list(row) for row in good]
        swapped[who][place] = dataclasses.replace(action, value=1 - action.value)
        assert kinds(swapped), (place, "other level")


@pytest.mark.parametrize("four", [True, False])
@pytest.mark.parametrize("who", [LEAD, FOLLOW])
def test_one_meeting_fewer_is_a_deadlock(four, who):
    programs = both(four=four, meetings=4)
    programs[who] = program(who == LEAD, 3, four)
    assert "deadlock" in kinds(programs)


def test_wrong_wiring():
    def crossed(row, a, b):
        return [dataclasses.replace(x, wire={a: b, b: a}[x.wire]) if x.kind == "wait" else x for x in row]

    programs = both()
    programs[FOLLOW] = crossed(programs[FOLLOW], 0, 1)  # reads its own output
    assert kinds(programs)


def test_a_toggle_that_starts_with_the_wrong_phase():
    programs = both(four=False)
    programs[FOLLOW] = [
        dataclasses.replace(x, value=1 - x.value) if i > 4 and x.kind in ("set", "wait") else x
        for i, x in enumerate(programs[FOLLOW])
    ]
    assert kinds(programs)


@pytest.mark.parametrize("four", [True, False])
def test_lines_left_at_one_need_the_start(four):
    """Without the resets and looks at the start a level of an earlier run is taken for an arrival."""
    programs = [row[len(start(who == LEAD)) :] for who, row in enumerate(both(four=four))]
    assert kinds(programs)
    for who in (LEAD, FOLLOW):
        for place, action in enumerate(start(who == LEAD)):
            if action.kind in ("set", "wait"):
                less = both(four=four)
                del less[who][place]
                assert kinds(less) or kinds(less, gates=False) or (who, action.kind) == (LEAD, "wait"), (
                    who,
                    action,
                )


def test_an_operator_who_does_not_look_can_stop_the_job_but_moves_nothing():
    programs = both()
    hasty = [[a for a in row if a.kind != "gate"] for row in programs]
    assert kinds(hasty) & {"deadlock", "lost_edge"}
    assert not kinds(hasty, gates=False)


def test_a_move_before_the_other_arm_has_arrived():
    programs = both()
    moved = programs[LEAD]
    place = next(i for i, a in enumerate(moved) if a.kind == "go" and a.value == 2)
    moved[place - 4 : place + 2] = [*moved[place : place + 2], *moved[place - 4 : place]]
    (finding,) = check_handshake(programs, WIRES).findings
    assert finding.kind == "apart" and finding.program == LEAD
    at = programs[LEAD][finding.positions[LEAD]]
    assert (at.kind, at.value) == ("go", 2)
    assert programs[FOLLOW][finding.positions[FOLLOW]].value < 2 or finding.positions[FOLLOW] < 11


def test_error_handlers_that_touch_the_lines_are_taken_for_arrivals():
    """A toggle's line may be 1 while its arm moves; a handler that resets it says that it has arrived."""
    programs = both(four=False, meetings=4)
    resets = ((0, 0),)
    programs[LEAD] = [dataclasses.replace(action, resets=resets) for action in programs[LEAD]]
    assert kinds(programs) == {"apart"}
    answers = both(four=False, meetings=4)
    answers[FOLLOW] = [dataclasses.replace(action, resets=((1, 1),)) for action in answers[FOLLOW]]
    assert kinds(answers) == {"apart"}


def test_outputs_that_fall_with_their_controller_need_four_phases():
    """In four phases both lines are 0 while arms work, so a controller that goes down says nothing new."""
    for four in (True, False):
        programs = [
            [dataclasses.replace(action, resets=((who, 0),)) for action in row]
            for who, row in enumerate(both(four=four, meetings=4))
        ]
        assert kinds(programs) == (set() if four else {"apart"})


def test_the_trace_leads_from_the_start_to_the_fault():
    programs = both()
    del programs[FOLLOW][len(start(False)) + 2]  # does not wait until the lead takes its signal back
    (finding,) = check_handshake(programs, WIRES, trace=10_000).findings
    places = [0, 0]
    for event in finding.trace:
        assert event.position == places[event.program]
        places[event.program] += 1
    assert tuple(places) == finding.positions and len(finding.trace) == finding.steps


def plain_search(programs, gates):
    """Kinds of the faults that the fewest steps of programs lead to, and that number."""
    levels = [(a, b) for a in (0, 1) for b in (0, 1)]
    # places, driven, read, unseen, stopped
    here = {((0, 0), level, level, (0, 0), (0, 0)) for level in levels}
    count = 0

    def finished(who, position):
        ahead = [a.value for a in programs[who][position:] if a.kind in ("go", "done")]
        return ahead[0] - 1 if ahead else 10**9

    while here:
        todo, whole = list(here), set(here)
        while todo:
            place, driven, read, unseen, stopped = todo.pop()
            new = [
                (place, driven, with_(read, w, driven[w]), unseen, stopped)
                for w in range(2)
                if read[w] != driven[w]
            ]
            for who in range(2):
                if stopped[who] or place[who] >= len(programs[who]):
                    continue
                level = driven
                for w, v in programs[who][place[who]].resets:
                    level = with_(level, w, v)
                new += [(place, levels_, read, unseen, with_(stopped, who, 1)) for levels_ in (driven, level)]
            for state in new:
                if state not in whole:
                    whole.add(state)
                    todo.append(state)
        faults, following = set(), set()
        for place, driven, read, unseen, stopped in whole:
            steps = 0
            for who in range(2):
                if stopped[who] or place[who] >= len(programs[who]):
                    continue
                action = programs[who][place[who]]
                w, v = action.wire, action.value
                after = driven, unseen
                if action.kind == "wait":
                    if read[w] != v:
                        continue
                    after = driven, with_(unseen, w, 0) if driven[w] == v else unseen
                if action.kind == "gate" and gates and place[1 - who] < v:
                    continue
                if action.kind == "go" and finished(1 - who, place[1 - who]) < v - 1:
                    faults.add("apart")
                if action.kind == "set" and driven[w] != v:
                    if unseen[w] and gates and not any(stopped):
                        faults.add("lost_edge")
                    after = with_(driven, w, v), with_(unseen, w, 1)
                steps += 1
                following.add((with_(place, who, place[who] + 1), after[0], read, after[1], stopped))
            ended = all(place[who] >= len(programs[who]) for who in range(2))
            if not steps and read == driven and not any(stopped) and not ended and gates:
                faults.add("deadlock")
            if ended and any(unseen) and not any(stopped) and gates:
                faults.add("lost_edge")
        if faults:
            return faults, count
        here, count = following, count + 1
    return set(), -1


def test_random_programs_against_a_plain_search():
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(150):
        programs = both(four=bool(rng.integers(2)), meetings=int(rng.integers(1, 4)))
        for _ in range(int(rng.integers(0, 4))):
            row = programs[int(rng.integers(2))]
            place = int(rng.integers(len(row)))
            action = row[place]
            match int(rng.integers(4)):
                case 0 if action.kind in ("set", "wait"):
                    del row[place]
                case 1 if action.kind in ("set", "wait"):
                    row[place] = dataclasses.replace(action, value=1 - action.value)
                case 2 if action.kind in ("set", "wait"):
                    row.insert(int(rng.integers(len(row))), row.pop(place))
                case 3:
                    row[place] = dataclasses.replace(action, resets=((int(rng.integers(2)), 0),))
        for gates in (True, False):
            verdict = check_handshake(programs, WIRES, gates)
            got = (
                {finding.kind for finding in verdict.findings},
                min((finding.steps for finding in verdict.findings), default=-1),
            )
            assert got == plain_search(programs, gates)
            seen |= got[0]
    assert seen == {"deadlock", "lost_edge", "apart"}


def test_long_programs_are_checked_in_proportion():
    few, many = (check_handshake(both(meetings=count), WIRES) for count in (2_500, 25_000))
    assert not many.findings and many.states > 1_000_000
    assert many.states < 10.01 * few.states


def test_two_programs_are_needed():
    with pytest.raises(ValueError, match="two"):
        check_handshake([program(True)], WIRES)
