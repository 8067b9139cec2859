"""Tracks in programs: poses of arms by the text, and faults in units, values and frames."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner.cell import distance, external_axis_motion
from planner.cell.kinematics import forward_kinematics
from planner.problem import Obstacle
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import external_axes
from planner.reading.cell import ObstacleFile, build_shape
from tests import track_job
from tests.proof.provers import prover_of

FIRST_STATION = "-500.0000"
"""The first station as the text has it."""


@pytest.fixture(scope="module")
def prover() -> Prover:
    return prover_of(track_job.planned_job())


def test_where_arms_stand_follows_from_the_text_within_a_micrometre(prover: Prover) -> None:
    out = track_job.planned_job()
    assert out.verified and out.plan.stations[0] != out.plan.stations[1]
    context = external_axes.with_text_stations(Context(prover.problem, prover.claims, out.programs))
    for index, setup in enumerate(out.problem.setups):
        planned = setup.cell.arm("left")
        np.testing.assert_allclose(context.base_poses(index)["left"], planned.base, atol=1e-6)
        operation_plan = out.plan.operations[index]
        flange = context.base_poses(index)["left"] @ forward_kinematics(
            planned.data, operation_plan.q["left"]
        )
        expected = operation_plan.targets.pose["left"][:, :3, 3]
        gaps = np.linalg.norm((flange @ planned.tool.tcp)[:, :3, 3] - expected, axis=1)
        assert gaps.max() < 1e-6
        rows = context.motion.tcp["left"].position[context.sample_setup == index]
        assert np.linalg.norm(rows[:, None] - expected[[0, -1]], axis=2).min(axis=0).max() < 1e-6  # stops


def first(text: str, old: str, new: str) -> str:
    assert old in text, old
    return text.replace(old, new, 1)


def moves(text: str, new: str) -> str:
    """The first station's value in all straight moves."""
    return re.sub(rf"(MoveL .*?),\[{FIRST_STATION},", rf"\1,[{new},", text)


def creeping(text: str) -> str:
    """Change the first station's value in straight moves, by less than a micrometre per move."""
    off = iter((1, 2, 1, 0))
    return re.sub(
        rf"(MoveL .*?),\[{FIRST_STATION},",
        lambda m: f"{m[1]},[{float(FIRST_STATION) - 9e-4 * next(off, 0):.4f},",
        text,
    )


ENTRY = "  PROC operation_1()"
HOME_CHECK = "    check_axes;\n"
"""The call of what looks whether the track is at home."""
HOME = "    MoveAbsJ j_home\\NoEOffs,v_entry,fine,t_ball_tool;\n"


def last_home(text: str, new: str) -> str:
    """Replace the last move, which takes the track home, by another line."""
    at = text.rindex(HOME)
    return text[:at] + new + text[at + len(HOME) :]


MUTANTS = {
    "another unit": ("external_axes", lambda t: first(t, "ActUnit TRACK_1", "ActUnit TRACK_2")),
    "no unit": ("external_axes", lambda t: first(t, "    ActUnit TRACK_1;\n", "")),
    "offsets left on": ("external_axes", lambda t: first(t, "    EOffsOff;\n", "")),
    "offsets left on until it has looked": (
        "external_axes",
        lambda t: first(first(t, "    EOffsOff;\n", ""), HOME_CHECK, f"{HOME_CHECK}    EOffsOff;\n"),
    ),
    "a move with offsets": ("external_axes", lambda t: last_home(t, HOME.replace(r"\NoEOffs", ""))),
    "switched off": (
        "external_axes",
        lambda t: first(t, "    operation_2;", "    DeactUnit TRACK_1;\n    operation_2;"),
    ),
    "missing value": ("external_axes", lambda t: moves(t, "9E9")),
    "missing at home": ("external_axes", lambda t: first(t, "[0.0000,9E9", "[9E9,9E9")),
    "another value": ("external_axes", lambda t: moves(t, "-480.0000")),
    "creeping away and back": ("external_axes", creeping),
    "switched off by a handler": (
        "error_handler",
        lambda t: first(t, "  ERROR\n", "  ERROR\n    DeactUnit TRACK_1;\n"),
    ),
    "another value all along": ("setup", lambda t: t.replace(FIRST_STATION, "-400.0000")),
    "beyond the range": ("external_axes", lambda t: t.replace(FIRST_STATION, "-5000.0000")),
    "a second axis": ("external_axes", lambda t: t.replace(f"[{FIRST_STATION},9E9", f"[{FIRST_STATION},10")),
    "the axis as the second": (
        "external_axes",
        lambda t: t.replace(f"[{FIRST_STATION},9E9", f"[9E9,{FIRST_STATION}"),
    ),
    "another frame": (
        "base_frames",
        lambda t: first(t, "base_frame:=[[0.0000,0.0000", "base_frame:=[[0.0000,50.0000"),
    ),
    "a fast track": ("external_axes", lambda t: first(t, "v_entry:=[250,45,250,", "v_entry:=[250,45,900,")),
    "not folded": ("external_axes", lambda t: re.sub(r"\n *MoveAbsJ j_2_station_1[^\n]*", "", t, count=1)),
    "nobody keeps off": (
        "external_axes",
        lambda t: re.sub(
            r"(    MoveAbsJ j_1_station_1[^\n]*\n)(?=    MoveAbsJ j_1_start)",
            r"\1    MoveAbsJ j_2_station_1\\NoEOffs,v_entry,fine,t_ball_tool;\n\1",
            t,
            count=1,
        ),
    ),
    "no look before the first move": ("external_axes", lambda t: first(t, HOME_CHECK, "")),
    "a look before the question": (
        "external_axes",
        lambda t: first(
            first(t, HOME_CHECK, ""), "    ActUnit TRACK_1;\n", f"    ActUnit TRACK_1;\n{HOME_CHECK}"
        ),
    ),
    "a look behind the first move": (
        "external_axes",
        lambda t: re.sub(rf"({HOME_CHECK})(    MoveAbsJ j_home[^\n]*\n)", r"\2\1", t, count=1),
    ),
    "a look of its own": (
        "external_axes",
        lambda t: first(
            t, "  PROC operation_1()", "  LOCAL PROC check_axes()\n  ENDPROC\n  PROC operation_1()"
        ),
    ),
    "a wide look": ("cell_check", lambda t: first(t, "eax_a,0.0000,1;", "eax_a,0.0000,100;")),
    "a look at another axis": ("cell_check", lambda t: first(t, "extax.eax_a,", "extax.eax_b,")),
    "a look for another home": (
        "cell_check",
        lambda t: first(t, "eax_a,0.0000,1;", f"eax_a,{FIRST_STATION},1;"),
    ),
    "a look at nothing": ("cell_check", lambda t: re.sub(r"\n *check_axis \"[^\n]*", "", t, count=1)),
    "a look that goes on": (
        "cell_check",
        lambda t: first(t, "IF Abs(got-wanted)>most", "IF got-wanted>most"),
    ),
    "not home at the end": ("external_axes", lambda t: last_home(t, "")),
    "elsewhere at the end": (
        "external_axes",
        lambda t: last_home(t, "    MoveAbsJ j_1_station_1\\NoEOffs,v_entry,fine,t_ball_tool;\n"),
    ),
    "nobody asked before it goes home": (
        "external_axes",
        lambda t: re.sub(r" *UIMsgBox[^\n]*All work done[^\n]*\n[^\n]*\n", "", t, count=1),
    ),
    "nobody told before it goes home": (
        "setup",
        lambda t: re.sub(r'(?s)(.*)TPWrite "[^\n]*folded[^\n]*', r"\1", t, count=1),
    ),
    "told another value": ("setup", lambda t: first(t, "-500.000 mm", "-900.000 mm")),
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", MUTANTS)
def test_a_wrong_track_is_refused(prover: Prover, name: str) -> None:
    word, change = MUTANTS[name]
    good = track_job.planned_job().programs
    joined = "\0".join(good.values())
    bad = dict(zip(good, change(joined.replace("\r\n", "\n")).split("\0"), strict=True))
    bad = {file: text.replace("\n", "\r\n") for file, text in bad.items()}
    assert bad != good
    proof = prover.prove(bad)
    assert not proof.ok
    assert f"verify.{word}" in {issue.code for issue in proof.issues}, [str(i) for i in proof.issues]


def test_a_unit_that_the_cell_does_not_have_is_refused(prover: Prover) -> None:
    plain = dataclasses.replace(prover.problem.cell.arms[0], linear_axes=())
    cell = dataclasses.replace(prover.problem.cell, arms=(plain,))
    other = Prover(dataclasses.replace(prover.problem, cell=cell), prover.claims)
    codes = {issue.code for issue in other.prove(track_job.planned_job().programs).issues}
    assert {"verify.external_axes", "verify.move_kinds"} <= codes


RAIL = {"kind": "box", "size_mm": [500, 7000, 50], "pose": {"xyz_mm": [0, 0, -25]}}
POST = {"kind": "box", "size_mm": [100, 50, 700], "pose": {"xyz_mm": [0, 150, 350]}}
STOP = {"kind": "box", "size_mm": [100, 50, 60], "pose": {"xyz_mm": [0, 150, 30]}}


def _over(prover: Prover, shapes: list[dict[str, object]]) -> list[str]:
    """Return the messages of verify.track_way on motion over a body of shapes."""
    good = track_job.planned_job().programs
    made = ObstacleFile.model_validate({"name": "rail", "shapes": shapes})
    cell = prover.problem.cell
    here = Obstacle("rail", tuple(build_shape(one, prover.problem.path.parent) for one in made.shapes))
    there = dataclasses.replace(prover.problem, cell=dataclasses.replace(cell, obstacles=(here,)))
    found = Prover(there, prover.claims).prove(good).issues
    return [issue.message for issue in found if issue.code == "verify.track_way"]


@pytest.mark.parametrize(("shapes", "clear"), [([RAIL], True), ([POST], False), ([RAIL, STOP], False)])
def test_the_way_between_stations_is_looked_at(
    prover: Prover, shapes: list[dict[str, object]], clear: bool
) -> None:
    """A stop of one body with the rail is lower than all of the arm but the base that runs into it."""
    assert (not _over(prover, shapes)) == clear


def test_a_planner_that_leaves_out_a_stop_is_not_believed(
    prover: Prover, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        external_axis_motion, "_supporting_shapes", lambda model, own, fixed, *_: np.ones(len(fixed), bool)
    )
    assert not _over(prover, [RAIL])
    (message,) = _over(prover, [RAIL, STOP])
    assert "it is not proven that left/base_link keeps" in message


def test_distances_that_are_too_far_are_not_believed(prover: Prover, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines are, not figures along them."""
    stop = {"kind": "cylinder", "radius_mm": 40, "length_mm": 60, "pose": {"xyz_mm": [220, 150, 30]}}
    assert not _over(prover, [RAIL, {**stop, "pose": {"xyz_mm": [260, 150, 30]}}])
    right = distance.measure_distances
    monkeypatch.setattr(
        external_axis_motion.distance,
        "measure_distances",
        lambda *args: (right(*args)[0] + 0.03, *right(*args)[1:]),
    )
    (message,) = _over(prover, [RAIL, stop])  # it is 4 mm off
    assert "it is not proven that left/base_link keeps" in message
