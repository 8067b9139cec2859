"""Arms on external axes whose programs meet by signals.

One arm moves to its station while the other one waits, folded, until it is done.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import planner
from planner.issues import TandemError
from planner.pipeline import Outcome
from planner.proof.prove import Prover
from tests import gantry_job
from tests.proof.provers import prover_of
from tests.track_job import TRACK
from tests.two_arms_job import BOTH, LEFT, RIGHT, problem

FOLDER = tempfile.TemporaryDirectory()
"""Folder of the planned job's files while tests run."""
OPERATIONS = [("side", LEFT, (-900.0, -700.0)), ("both", BOTH, (-150.0, 150.0))]
METS: dict[str, Any] = {"sync": "handshake", "handshake": {"patience_s": 5}}
"""Minimum waiting time for either arm. Paths of 800 mm take 3.45 s more."""
NUMBERS = {"doPartner": 101, "diPartner": 101, "doRunning": 102, "diPartnerRunning": 102, "doMoveEnable": 103}


@functools.cache
def planned() -> Outcome:
    """Both arms on a track, with equal unit names: each has its own controller."""
    tracks = [{"track": {**TRACK, "home_mm": home}} for home in (0, 100)]
    made = problem(Path(FOLDER.name), OPERATIONS, tracks[1], 7, left=tracks[0], controller=METS)
    return planner.plan(made)


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(planned())


def test_arms_on_tracks_meet_by_signals() -> None:
    out = planned()
    assert out.verified, [str(issue) for issue in out.issues]
    assert out.plan.stations[0]["left"] < -0.2
    text = out.programs["right/TandemMain_2.mod"]
    stand = text[text.index("Meeting: left is at its station") :]
    wait = stand[stand.index("WaitDI diPartner,1") :].split(":=")[1].split(";")[0]
    assert float(wait) > 5.0 + abs(out.plan.stations[0]["left"]) / 0.25


STATION = "Meeting: left is at its station"


def _without(text: str, mark: str) -> str:
    """The text without the first meeting of that name."""
    at = text.index(f"    ! {mark}")
    return text[:at] + text[text.index("    ! Meeting", at + 8) :]


def _later(text: str) -> str:
    """The right arm leaves home before the left one is at its station."""
    at = text.index(f"    ! {STATION}")
    away = "    MoveAbsJ [[0,-40,0,0,30,0],[100,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v_entry,fine,t_ball_tool;\n"
    return text[:at] + away + text[at:]


def _hasty(text: str) -> str:
    """It waits no longer than for an arm alone."""
    at = text.index(f"    ! {STATION}")
    end = text.index("    ! Meeting", at + 8)
    lines = [line.split(":=")[0] + ":=5;" if ":=" in line else line for line in text[at:end].split("\n")]
    return text[:at] + "\n".join(lines) + text[end:]


MUTANTS: dict[str, tuple[str, Callable[[str], str]]] = {
    "away while the other one's track goes": ("external_axes", _later),
    "no meeting behind the station": ("handshake", lambda t: _without(t, STATION)),
    "too short a wait": ("meeting_time", _hasty),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_programs_that_meet_otherwise_are_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    good = planned().programs
    file = "right/TandemMain_2.mod"
    bad = {**good, file: change(good[file].replace("\r\n", "\n")).replace("\n", "\r\n")}
    assert bad != good
    proof = prover.prove(bad)
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]


def test_a_kuka_gantry_beside_a_kuka_arm(tmp_path: Path) -> None:
    bridge = {**gantry_job.BRIDGE, "carries": ["car"]}
    lift = {**gantry_job.LIFT, "carries": [], "range_mm": [0, 300]}
    car = {"kind": "box", "size_mm": [300, 300, 40], "pose": {"xyz_mm": [0, 0, -22]}}
    kuka = {"robot": "kr16_2"}
    out = planner.plan(
        problem(
            tmp_path,
            OPERATIONS,
            kuka,
            5,
            left={**kuka, "track": None, "axes": [bridge, lift]},
            controller={"sync": "handshake", "io": dict.fromkeys(BOTH, NUMBERS)},
            obstacles=[{"name": "car", "shapes": [car]}],
            scale=2.0,
        )
    )
    assert out.verified, [str(issue) for issue in out.issues]


def test_a_track_does_not_go_along_a_step_apart(tmp_path: Path) -> None:
    """What proves arms that are a step apart has bases that stand."""
    with pytest.raises(TandemError) as refused:
        problem(tmp_path, OPERATIONS, count=5, controller={"sync": "handshake"})
    (issue,) = refused.value.issues
    assert issue.code == "problem.track" and issue.field == "operations.1"
    assert "one arm may be a step ahead" in issue.message


@pytest.mark.long
def test_a_track_goes_along_where_its_arm_works_alone(tmp_path: Path) -> None:
    operations = [OPERATIONS[0], ("alone", RIGHT, (0.0, 1.0))]
    out = planner.plan(problem(tmp_path, operations, count=5, controller={"sync": "handshake"}))
    assert out.verified and set(out.plan.operations[0].targets.track_positions) == {"left"}
