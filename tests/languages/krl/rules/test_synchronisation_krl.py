"""Rules whose requirements differ between KRL and RAPID, on programs written by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from planner.languages.krl.reader import reader
from planner.languages.krl.rules import moves as krl_moves
from planner.programs.signals import NumberedSignals
from planner.programs.steps import MoveStep
from planner.proof.rules import synchronisation
from tests.languages.krl.reader.wall_program import MAIN, MOVES, OLDER, read

HEAD = (
    MOVES.split("SLIN")[0].replace("$VEL.ORI1=200.0", "$VEL.ORI1={ori}").replace("ORI2=200.0", "ORI2={ori}")
)
HEAD = HEAD.replace("$VEL.CP=0.02000000", "$VEL.CP={cp}").replace("CDIS=0.3", "CDIS={way}")
HEAD = HEAD.replace("CORI=180.0", "CORI={angle}")


def moves(rows, dialect="krc4", **settings):
    """Straight moves to (X, Y, Z, A, B, C, corner) from the start of the program by hand."""
    known = {"cp": "0.02", "ori": "200.0", "way": "0.3", "angle": "180.0"} | settings
    word = "SLIN" if dialect == "krc4" else "LIN"
    text = HEAD.format(**known)
    for *place, corner in rows:
        parts = (f"{n} {v:.{4 if n in 'XYZ' else 5}f}" for n, v in zip("XYZABC", place, strict=True))
        text += f"{word} {{{','.join(parts)}}} {corner}".rstrip() + "\n"
    main = MAIN if dialect == "krc4" else OLDER
    found = read(dialect, main=main, moves=text + "END\n")
    assert found.faults == ()
    steps, _ = reader.main_flow(found, found.base_of(None), NumberedSignals({}, {}), "left")
    return tuple(step for step in steps if isinstance(step, MoveStep) and step.time is not None)


TASK = SimpleNamespace(name="left", arm=SimpleNamespace(name="left"), text=SimpleNamespace(language="krl"))
ALONG = [(x, 40.0, 210.0, 12.5, 80.0, -4.0, "C_SPL") for x in (-10.0, -9.0, -8.0)]
TURNS = [(-12.0, 40.0, 210.0, a, 80.0, -4.0, "C_ORI") for a in (14.5, 16.5, 18.5)]


@pytest.mark.parametrize(("distance", "wrong"), [("0.5", False), ("0.51", True), ("3.0", True)])
def test_a_corner_takes_half_of_the_shorter_move(distance, wrong):
    """Between moves of 1 mm."""
    issues, _ = krl_moves.corners(TASK, moves(ALONG, way=distance))
    assert {issue.code for issue in issues} == ({"verify.zone_size"} if wrong else set())


@pytest.mark.parametrize(("angle", "wrong"), [("0.9", False), ("3.0", True)])
def test_a_corner_without_way_is_held_against_the_turns(angle, wrong):
    """2 degrees about z of a base: half of them is 1 degree."""
    issues, _ = krl_moves.corners(TASK, moves(TURNS, "krc2", angle=angle))
    assert bool(issues) == wrong


def test_a_corner_by_angle_alone_is_no_corner_of_ways():
    rows = [(*row[:6], "C_ORI") for row in ALONG]
    issues, _ = krl_moves.corners(TASK, moves(rows, "krc2", angle="0.001"))
    assert issues


def test_moves_that_run_together_take_the_same_time():
    a, b, c = (moves(ALONG, cp=cp)[-1] for cp in ("0.02", "0.0201", "0.0205"))
    assert np.allclose([a.time, c.time], [0.05, 1e-3 / 0.0205])
    assert list(synchronisation._compare_times(TASK, a, TASK, b)) == []
    (issue,) = synchronisation._compare_times(TASK, a, TASK, c)
    assert issue.code == "verify.move_time" and "0.04878" in issue.message


def test_moves_as_slow_as_can_be_stated_may_be_early():
    """1 mm at 0.1 mm/s and 0.14 deg/s at most, while the other arm takes 20 s."""
    slow = moves(ALONG, cp="0.0001", ori="0.1")[-1]
    other = moves(ALONG, cp="0.00005")[-1]
    assert np.allclose([slow.time, other.time], [10.0, 20.0])
    assert list(synchronisation._compare_times(TASK, slow, TASK, other)) == []
    assert len(list(synchronisation._compare_times(TASK, moves(ALONG)[-1], TASK, other))) == 1
