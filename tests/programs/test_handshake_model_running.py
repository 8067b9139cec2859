"""The check of two programs whose controllers monitor each other by a running wire.

Either side stops and starts at any instant, and wires are cut or stuck. The reference is a plain search.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest

from planner.programs.handshake.model import AutomatonAction, check_handshake
from planner.proof.rules.handshake import _MODEL_CASES
from tests.programs.automata import FOLLOW, LEAD, WIRES, put, wait, with_, work

WORK = ("works", "works")
STUCK = [("low", "works"), ("high", "works"), ("works", "low"), ("works", "high")]


def check_running(value):
    return AutomatonAction("look", value=value)


def start(lead):
    """The lead is started first, sees the other one stand, stops by itself; the other one is started then,
    sees the lead stand and says that it is ready; the lead is started again."""
    if lead:
        return [
            put(0, 0),
            check_running(0),
            AutomatonAction("pause"),
            AutomatonAction("gate", value=4),
            wait(1, 0),
        ]
    return [AutomatonAction("gate", value=2), put(1, 0), check_running(0), wait(0, 0)]


def program(lead, meetings=3, four=True, tail=False):
    mine, other = (0, 1) if lead else (1, 0)
    out = start(lead)
    for k in range(1, meetings + 1):
        out.append(check_running(1))
        for value in (1, 0) if four else (k % 2,):
            turn = [put(mine, value), wait(other, value)]
            out += turn if lead else turn[::-1]
        out += work(k) if tail or k < meetings else []
    return out


def both(**options):
    return [program(True, **options), program(False, **options)]


def kinds(programs):
    """Kinds of faults over all cases that the rule looks at."""
    out = set()
    for gates, running in _MODEL_CASES:
        out |= {finding.kind for finding in check_handshake(programs, WIRES, gates, running=running).findings}
    return out


@pytest.mark.parametrize("four", [True, False])
@pytest.mark.parametrize("meetings", [1, 2, 4])
def test_the_protocols_hold_with_stops_and_starts_at_any_instant(four, meetings):
    assert not kinds(both(four=four, meetings=meetings))


@pytest.mark.parametrize("who", [LEAD, FOLLOW])
def test_every_look_before_the_first_meeting_is_needed(who):
    """Without the look at 0 a wire that is stuck at 1 passes, without the one at 1 a wire that is cut."""
    good = both(meetings=3)
    first = [i for i, action in enumerate(good[who]) if action.kind == "look"][:2]
    for place, stuck in zip(first, ("high", "low"), strict=True):
        less = [list(row) for row in good]
        del less[who][place]
        running = tuple(stuck if other != who else "works" for other in (LEAD, FOLLOW))
        (finding,) = check_handshake(less, WIRES, False, running=running).findings
        assert finding.kind == "unwatched"
        assert kinds(less)
    swapped = [list(row) for row in good]
    a, b = first
    swapped[who][a], swapped[who][b] = swapped[who][b], swapped[who][a]
    assert kinds(swapped)


def test_a_lead_that_does_not_stop_by_itself_never_lets_the_other_one_see_it_stand():
    programs = both()
    programs[LEAD] = [action for action in programs[LEAD] if action.kind != "pause"]
    assert "deadlock" in kinds(programs)


def test_a_program_that_is_started_untold_waits_but_moves_nothing():
    programs = both()
    programs[FOLLOW] = programs[FOLLOW][1:]
    programs[LEAD] = [dataclasses.replace(a, value=3) if a.kind == "gate" else a for a in programs[LEAD]]
    assert {f.kind for f in check_handshake(programs, WIRES, True, running=WORK).findings} == {"deadlock"}
    for running in (WORK, *STUCK):
        assert not check_handshake(programs, WIRES, False, running=running).findings


@pytest.mark.parametrize("four", [True, False])
def test_programs_that_never_look_work_with_wires_that_are_not_there(four):
    blind = [[a for a in row if a.kind not in ("look", "pause", "gate")] for row in both(four=four)]
    for running in STUCK:
        assert {f.kind for f in check_handshake(blind, WIRES, False, running=running).findings} == {
            "unwatched"
        }


def test_a_look_behind_the_last_meeting_waits_for_ever():
    programs = both()
    programs[LEAD] = [*programs[LEAD], check_running(1)]
    assert "deadlock" in kinds(programs)


class Cell(NamedTuple):
    """All that there is, said plainly. ``since``: steps that each program has made since the other one, which
    it has read as running, stopped, counted to 2; -1 where neither is so, empty where nobody asks."""

    position: tuple = (0, 0)
    driven: tuple = (0, 0)
    read: tuple = (0, 0)
    unseen: tuple = (0, 0)
    gone: tuple = (0, 0)
    stopped: tuple = (1, 1)
    low: tuple = (1, 1)
    cut: tuple = (0, 0)
    since: tuple = ()

    def now(self, **fields):
        return self._replace(**fields)


def stopped(cell, p):
    """Stop the program. The steps of the other one are counted from here."""
    seen = not (cell.stopped[p] or cell.stopped[1 - p] or cell.low[p])
    since = with_(cell.since, 1 - p, 0) if cell.since and seen else cell.since
    return cell.now(stopped=with_(cell.stopped, p, 1), since=since)


def outside(cell, programs, gates, running):
    """Yield the events that occur without a step of a program."""
    for wire in range(2):
        if cell.read[wire] != cell.driven[wire]:
            yield cell.now(read=with_(cell.read, wire, cell.driven[wire]))
    for p in range(2):
        q = 1 - p
        ended = cell.position[p] == len(programs[p])
        works = running[p] == "works" and not cell.cut[p]
        halted = stopped(cell, p)
        if not cell.stopped[p]:
            yield halted
        if not ended and not cell.gone[p] and running == WORK:
            yield halted.now(gone=with_(cell.gone, p, 1))
        if cell.stopped[p] and not cell.low[p] and works:
            yield stopped(cell.now(low=with_(cell.low, p, 1)), q)
        if not cell.stopped[p] and cell.low[p] and works:
            yield cell.now(low=with_(cell.low, p, 0))
        if works and not gates and running == WORK and not any(cell.cut):
            fallen = cell.now(cut=with_(cell.cut, p, 1), low=with_(cell.low, p, 1))
            yield fallen if cell.low[p] else stopped(fallen, q)
        if cell.stopped[p] and not ended and not cell.gone[p] and (cell.low[p] or not works):
            action = programs[p][cell.position[p]]
            if not gates or action.kind != "gate" or cell.position[q] >= action.value:
                yield cell.now(stopped=with_(cell.stopped, p, 0), since=(-1, -1)[: len(cell.since)])


def steps(cell, programs, gates, running):
    """Yield the steps of the programs: (next cell, fault)."""

    def finished(who):
        ahead = [a.value for a in programs[who][cell.position[who] :] if a.kind in ("go", "done")]
        return ahead[0] - 1 if ahead else 10**9

    for p in range(2):
        q = 1 - p
        if cell.stopped[p] or cell.gone[p] or cell.position[p] == len(programs[p]):
            continue
        action = programs[p][cell.position[p]]
        w, v = action.wire, action.value
        after, fault = cell.now(position=with_(cell.position, p, cell.position[p] + 1)), None
        match action.kind:
            case "wait":
                if cell.read[w] != v:
                    continue
                if cell.driven[w] == v:
                    after = after.now(unseen=with_(cell.unseen, w, 0))
            case "look":
                if cell.low[q] == v:
                    continue
            case "gate":
                if gates and cell.position[q] < v:
                    continue
            case "go":
                if finished(q) < v - 1:
                    fault = "apart"
                if running != WORK and v:
                    fault = "unwatched"
            case "set":
                if cell.driven[w] != v:
                    fault = "lost_edge" if cell.unseen[w] else None
                    after = after.now(driven=with_(cell.driven, w, v), unseen=with_(cell.unseen, w, 1))
            case "pause":
                after = stopped(after, p)
        if cell.since and cell.stopped[q] and cell.since[p] >= 0 and cell.position[q] < len(programs[q]):
            after = after.now(since=with_(cell.since, p, min(2, cell.since[p] + 1)))
        if cell.stopped[q] and not cell.low[q] and running[q] == "works" and not cell.cut[q]:
            after = stopped(after.now(low=with_(cell.low, q, 1)), p)
        yield after, fault


def plain_search(programs, gates, running, since=()):
    """Kinds of the faults that the fewest steps of programs lead to, that number, and the most steps that a
    program makes behind a stop of the other one which it has not been started after; whether power may be on
    then."""
    low = tuple(int(level != "high") for level in running)
    levels = [(a, b) for a in (0, 1) for b in (0, 1)]
    here = {Cell(driven=level, read=level, low=low, since=since) for level in levels}
    count = most = 0
    powered = False
    while here:
        todo, whole = list(here), set(here)
        while todo:
            for cell in outside(todo.pop(), programs, gates, running):
                if cell not in whole:
                    whole.add(cell)
                    todo.append(cell)
        faults, following = set(), set()
        for cell in whole:
            most = max(most, 0, *cell.since)
            powered |= bool(since) and any(
                cell.since[p] > 0 and not cell.stopped[p] and not cell.low[1 - p] for p in range(2)
            )
            moved = list(steps(cell, programs, gates, running))
            for after, fault in moved:
                following.add(after)
                if fault in ("apart", "unwatched") or (fault and gates and not any(cell.gone)):
                    faults.add(fault)
            ended = all(cell.position[p] == len(programs[p]) for p in range(2))
            ways = [c for c in outside(cell, programs, gates, running) if not any(c.gone) and not any(c.cut)]
            helps = [c for c in ways if c.stopped == cell.stopped or sum(c.stopped) < sum(cell.stopped)]
            ending = any(not cell.stopped[p] and cell.position[p] == len(programs[p]) for p in range(2))
            calm = not any(cell.gone) and not any(cell.cut) and gates and running == WORK
            if calm and not moved and not ended and not helps and not ending and _followed(cell):
                faults.add("deadlock")
            if gates and ended and any(cell.unseen) and not any(cell.gone):
                faults.add("lost_edge")
        if faults:
            return faults, count, most, powered
        here, count = following, count + 1
    return set(), -1, most, powered


def _followed(cell):
    return cell.read == cell.driven and cell.low == cell.stopped


def compare_models(seed, runs, max_meetings, cases):
    rng = np.random.default_rng(seed)
    seen = set()
    for _ in range(runs):
        programs = both(
            four=bool(rng.integers(2)), meetings=int(rng.integers(1, max_meetings + 1)), tail=True
        )
        for _ in range(int(rng.integers(1, 3))):
            row = programs[int(rng.integers(2))]
            place = int(rng.integers(len(row)))
            action = row[place]
            if action.kind == "go" and place > 5:
                row.insert(place - 5, row.pop(place))
                continue
            match int(rng.integers(3)):
                case 0 if action.kind in ("set", "wait", "look", "pause"):
                    del row[place]
                case 1 if action.kind in ("set", "wait", "look"):
                    row[place] = dataclasses.replace(action, value=1 - action.value)
                case 2 if action.kind in ("set", "wait", "look"):
                    row.insert(int(rng.integers(len(row))), row.pop(place))
        for gates, running in cases:
            verdict = check_handshake(programs, WIRES, gates, running=running)
            got = (
                {finding.kind for finding in verdict.findings},
                min((finding.steps for finding in verdict.findings), default=-1),
            )
            assert got == plain_search(programs, gates, running)[:2], (programs, gates, running)
            seen |= got[0]
    return seen


def test_random_programs_against_a_plain_search():
    assert compare_models(3, 3, 1, [(True, WORK), (False, STUCK[1]), (False, STUCK[2])])


@pytest.mark.long
def test_many_random_programs_against_a_plain_search():
    cases = [(True, WORK), *[(False, running) for running in (WORK, *STUCK)]]
    assert compare_models(12, 45, 2, cases) == {"deadlock", "lost_edge", "apart", "unwatched"}


def test_behind_a_stop_the_other_side_makes_one_step_at_most_and_has_no_power():
    faults, _, most, powered = plain_search(both(meetings=1), True, WORK, (-1, -1))
    assert (faults, most, powered) == (set(), 1, False)


@pytest.mark.long
def test_so_it_is_with_an_operator_who_does_not_look_and_wires_that_are_cut():
    faults, _, most, powered = plain_search(both(meetings=2), False, WORK, (-1, -1))
    assert (faults, most, powered) == (set(), 1, False)


def test_without_the_wire_the_other_side_goes_on_with_power():
    blind = [[a for a in row if a.kind not in ("look", "pause", "gate")] for row in both(meetings=2)]
    high = ("high", "high")
    here = {Cell(low=(0, 0), stopped=(0, 0), since=(-1, -1))}
    most, powered = 0, False
    for _ in range(6):
        halted = {stopped(cell, LEAD) for cell in here}
        here = {after for cell in here | halted for after, _ in steps(cell, blind, False, high)}
        read = {cell.now(read=cell.driven) for cell in here}
        here |= read
        most = max(most, *(max(cell.since) for cell in here))
        powered |= any(cell.since[FOLLOW] > 0 and not cell.stopped[FOLLOW] for cell in here)
    assert (most, powered) == (2, True)


def test_long_programs_are_checked_in_proportion():
    few, many = (check_handshake(both(meetings=count), WIRES, running=WORK) for count in (500, 5_000))
    assert not many.findings and many.states > 1_000_000
    assert many.states < 10.01 * few.states and many.kinds == few.kinds
