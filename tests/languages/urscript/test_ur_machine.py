"""Programs of two UR controllers on a simulated machine, with random stops, pauses, cut wires and mistakes.

The arms stay within one step of each other. Nothing moves or has power after the other controller is gone.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.languages.urscript import ur_pair
from tests.languages.urscript.ur_machine import TICK, Machine, Pair

WIRES = ((0, 0, 1, 2), (1, 2, 0, 0), (0, 1, 1, 3), (1, 3, 0, 1))
"""Lines of the meetings, then those that say who runs, by the numbers of ``ur_pair``."""
POWER = 9
MAX_TICKS = 20_000
REACTION = 3
"""Ticks in which a program sees its input and ends."""


def create_pair(seed=0, pauses=False, kind="four_phase", every=1, exchanged=False, reply_delay=0.0, **more):
    texts = ur_pair.programs(kind, every)
    names = [f"{arm}/small.script" for arm in ("left", "right")]
    order = names[::-1] if exchanged else names
    lines = {names[0]: LEAD_LINE, names[1]: FOLLOW_LINE}
    machines = [Machine(texts[name], pauses, **{"keeps": {lines[name]}, **more}) for name in order]
    lead = 1 if exchanged else 0
    out = Pair(*machines, WIRES, 1 + seed % 4, reply_delay)
    machines[lead].start(0.0)
    return out


def within_a_step(two, every):
    """Check that no arm has started a move more than a step after the other one's last."""
    a, b = two.machines
    assert max(a.moves - b.done, b.moves - a.done) <= every, (a.moves, b.moves, a.done, b.done)
    assert not (a.moving == "movej" and b.moving == "movej")


@pytest.mark.parametrize("pauses", [False, True])
@pytest.mark.parametrize(("kind", "every"), [("four_phase", 1), ("four_phase", 3)])
def test_both_come_to_their_end_whatever_a_popup_is(kind, every, pauses):
    """A popup that holds a program is a pause, at which outputs fall, or is none."""
    for delay in range(2):
        two = create_pair(delay, pauses, kind, every, reply_delay=2.0 * delay)
        while not two.ended and two.now < 400.0:
            two.tick()
            within_a_step(two, every)
        assert [machine.why for machine in two.machines] == ["end", "end"]
        assert two.machines[0].done == two.machines[1].done > 10


@pytest.mark.parametrize("what", ["stopped", "paused", "cut"])
@pytest.mark.parametrize("pauses", [False, True])
def test_nothing_moves_or_has_power_behind_a_stop_of_the_other_one(what, pauses):
    rng = np.random.default_rng(7 + pauses)
    for case in range(6):
        two = create_pair(case, pauses, reply_delay=3.0)
        at, victim = float(rng.uniform(1.0, 60.0)), int(rng.integers(2))
        gone, other = two.machines[victim], two.machines[1 - victim]
        while two.now < at and not two.ended:
            two.tick()
        begun = two.machines[0].told and gone.running
        if what == "stopped":
            gone.end("stopped")
        elif what == "paused" and gone.running:
            gone.pause()
        else:
            two.cut.add(2 + victim)  # the wire that says that it runs
        for _ in range(two.delay + REACTION):
            two.tick(answers=False)
        for _ in range(300):
            assert not other.moving and POWER not in other.high, (case, at, victim, other.why)
            two.tick(answers=False)
        if what == "paused" and begun:
            gone.paused = False  # somebody continues it
            moved = gone.moves
            two.tick(answers=False)
            assert gone.moves == moved
        for _ in range(300):
            assert not other.moving and POWER not in other.high
            two.tick(answers=False)
        if begun and what != "cut" and other.watching:
            assert other.why == "watched"


def test_without_the_thread_the_other_one_goes_on():
    """What the tests above look for is there to be found."""
    two = create_pair()
    for machine in two.machines:
        machine.body = [row for row in machine.body if not str(row).startswith("watching")]
    while two.machines[0].moves < 7:
        two.tick()
    two.machines[1].end("stopped")
    for _ in range(two.delay + REACTION):
        two.tick()
    assert two.machines[0].moving and POWER in two.machines[0].high


def test_each_others_program_moves_nothing():
    """Two arms of one model: the look at the arm passes, and no wire says that the other one runs."""
    two = create_pair(exchanged=True)
    for _ in range(MAX_TICKS):
        two.tick()
        lead, follow = two.machines[::-1]
        if "Start the program" in lead.asked and not follow.running and not follow.why:
            follow.start(two.now)
        if lead.asked:
            lead.answer()  # whatever the other panel says
        assert not any(machine.moves or machine.moving for machine in two.machines)
    assert any(machine.why == "checked" for machine in two.machines)


def test_one_program_alone_moves_nothing():
    two = create_pair()
    two.machines[1].why = "not started"
    for _ in range(MAX_TICKS):
        two.tick()
        if two.machines[0].asked:
            two.machines[0].answer()
        assert not two.machines[0].moves and not two.machines[0].moving
    assert two.machines[0].why == "checked"


def test_one_that_is_started_anew_moves_nothing():
    """One was stopped in the middle and is started again alone: the other one has ended by then."""
    for victim in (0, 1):
        two = create_pair()
        while two.machines[0].moves < 7:
            two.tick()
        gone, other = two.machines[victim], two.machines[1 - victim]
        gone.end("stopped")
        for _ in range(5):
            two.tick()
        assert other.why == "watched"
        moves = gone.moves
        gone.start(two.now)
        for _ in range(5000):
            two.tick()
            if gone.asked:
                gone.answer()
            assert gone.moves == moves and not gone.moving and not other.running


def test_an_output_that_nobody_set_to_fall_is_found():
    """Low when not running was forgotten, and an earlier run has left the wire high: the program takes it
    back and ends."""
    two = create_pair(keeps={1}, outputs={1})
    for _ in range(50):
        two.tick()
    assert two.machines[0].why == "stays high" and not two.machines[0].moves
    assert 1 not in two.machines[0].high
    two = create_pair()
    two.machines[1].high = {3}  # of the one that follows, which has not been started yet
    for _ in range(MAX_TICKS):
        two.tick()
    assert two.machines[0].why == "waited" and not two.machines[0].moves


LEAD_LINE, FOLLOW_LINE = 0, 2
ROUNDS = 60
SETTLES = 5
"""Ticks in which a program that sees the other one elsewhere may still be in its move."""


def disturbed(two, rng, victim):
    """Something that a person does, to the ``victim`` more often."""
    machine = two.machines[victim if rng.random() < 0.85 else 1 - victim]
    if not machine.running:
        machine.start(two.now)
    elif machine.paused:
        machine.paused = False
    elif machine.asked and (rng.random() < 0.8 or not machine.rises):
        machine.answer()
    elif rng.random() < 0.6:
        machine.end("stopped")
    else:
        machine.pause()


def beside_another(texts, seed, rounds):
    """Return the longest run of ticks in which an arm moves while the other program is at another meeting.

    The programs run up to some instant, half of the time up to a question. Then people stop, pause, continue
    and start them, and confirm every question.
    """
    rng = np.random.default_rng(seed)
    worst = moved = 0
    for case in range(rounds):
        keeps = [set(), set()] if case % 3 == 0 else [{LEAD_LINE}, {FOLLOW_LINE}]  # lines fall, or stay
        machines = [
            Machine(texts[f"{arm}/small.script"], keeps=keeps[k], move=0.1, line=line)
            for k, (arm, line) in enumerate((("left", LEAD_LINE), ("right", FOLLOW_LINE)))
        ]
        two = Pair(*machines, WIRES, 1 + case % 2)
        machines[0].start(0.0)
        question = (ur_pair.QUESTION, ur_pair.AGAIN, ur_pair.AGAIN, "?!")[int(rng.integers(4))]
        calm, bad = int(rng.integers(300, 900)), 0
        while two.now < calm * TICK or question != "?!":
            two.tick(answers=False)
            if question in machines[0].asked or two.ended:
                break
            two.answer()
        victim, times = int(rng.integers(2)), np.cumsum(rng.integers(1, 60, rng.integers(1, 6)))
        for tick in range(700):
            two.tick(answers=False)
            if tick in times:
                disturbed(two, rng, victim)
            elif tick > 450 and tick % 40 == 0:
                for machine in machines:
                    if machine.asked:
                        machine.answer()
            apart = any(
                one.moving and one.running and not one.paused and other.running and other.rises < one.rises
                for one, other in (machines, machines[::-1])
            )
            bad = bad + 1 if apart else 0
            worst, moved = max(worst, bad), moved + any(m.moving and m.running for m in machines)
    assert moved > 10 * rounds
    return worst


def test_no_arm_moves_beside_a_program_that_is_elsewhere():
    """Whatever is stopped, paused, continued, started and confirmed, and whenever."""
    assert beside_another(ur_pair.programs("four_phase", 3), 5, ROUNDS) <= SETTLES


def test_without_the_looks_behind_a_question_one_does():
    """What the test above looks for is there to be found."""

    texts = ur_pair.programs("four_phase", 3)
    blind = {path: re.sub(r"\ncheck_partner\(True,\w+\)", "", text) for path, text in texts.items()}
    assert beside_another(blind, 5, ROUNDS) > 3 * SETTLES
