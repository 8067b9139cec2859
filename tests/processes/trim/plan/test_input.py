"""What of trimming is refused before anything is planned, each with its own code; and slots by closed "
"forms."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.issues import Issue, TandemError
from planner.languages.writing import write as post
from planner.processes import registry
from planner.processes.trim.plan.face import SheetFace, curve_distance, offset_curve, project_curve
from planner.processes.trim.proof.outlines import encloses
from planner.tooling import torch
from tests.processes.trim.plan.small_trim import data, of_ur, problem
from tests.small_forming import dish
from tests.small_forming import write as write_forming

ROUND = {"name": "round", "circle": {"at_mm": [0, 0], "diameter_mm": 16}}


def refused(folder: Path, **fields: Any) -> list[Issue]:
    with pytest.raises(TandemError) as error:
        registry.job(problem(folder, **fields), 0).targets()
    return list(error.value.issues)


def square(half: float, at: float = 0.0) -> dict[str, Any]:
    corners = [[at - half, -half, 0], [at + half, -half, 0], [at + half, half, 0], [at - half, half, 0]]
    return {"polyline_mm": corners}


CASES: dict[str, dict[str, Any]] = {
    "trim.crosses": {
        "outlines": [ROUND, {**ROUND, "name": "b", "circle": {"at_mm": [6, 0], "diameter_mm": 16}}]
    },
    "trim.in_waste": {
        "outlines": [ROUND, {**ROUND, "name": "b", "circle": {"at_mm": [0, 0], "diameter_mm": 4}}]
    },
    "trim.off_part": {"outlines": [{**ROUND, "circle": {"at_mm": [50, 0], "diameter_mm": 40}}]},
    "trim.narrow": {"outlines": [{**ROUND, "circle": {"at_mm": [0, 0], "diameter_mm": 1.1}}]},
    "trim.corner": {"outlines": [{"name": "a", "curve": square(7.0)}], "shape_tol_mm": 0.1},
    "trim.joints": {"outlines": [{**ROUND, "joints": 20, "joint_mm": 2}]},
    "trim.lead": {"outlines": [ROUND], "lead": {"length_mm": 15}},
    "trim.wall": {
        "outlines": [{**ROUND, "circle": {"at_mm": [20, 0], "diameter_mm": 8}}],
        "tool": {"nozzle_diameter_mm": 40, "body_diameter_mm": 40},
    },
}


FOLLOWED: dict[str, dict[str, Any]] = {
    "trim.crosses": {"outlines": [{**ROUND, "circle": {"at_mm": [0, 0], "diameter_mm": 8}}]},
    "trim.in_waste": {"outlines": [ROUND]},
    "trim.off_part": {"outlines": [ROUND]},
    "trim.narrow": {"outlines": [ROUND]},
    "trim.corner": {"shape_tol_mm": 0.3},
    "trim.joints": {"outlines": [{**ROUND, "joints": 3, "joint_mm": 2}]},
    "trim.lead": {"lead": {"length_mm": 2}},
    "trim.wall": {"tool": {}},
}
"""The changes that the hints of CASES recommend."""


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("code", CASES)
def test_what_cannot_be_cut_is_refused_and_the_change_that_is_told_helps(tmp_path: Path, code: str) -> None:
    found = refused(tmp_path, **CASES[code])
    assert code in {issue.code for issue in found}
    assert all(issue.hint for issue in found)
    targets = registry.job(problem(tmp_path, **{**CASES[code], **FOLLOWED[code]}), 0).targets()
    assert targets.count > 10


@pytest.mark.parametrize(
    ("circles", "code", "words"),
    [
        ([(0, 10), (10, 10)], "trim.crosses", "within 0.00 mm of each other, at (5.0, 0.0) mm"),
        ([(0, 10), (10.3, 10)], "trim.crosses", "allowed 0.6 mm or more"),  # each edge may be off by 0.3
        ([(0, 1.2)], "trim.narrow", "narrower than the kerf of 1.2 mm"),  # its slot would be one place
    ],
)
def test_where_nothing_is_sure_to_stay_or_to_drop(
    tmp_path: Path, circles: list[tuple[float, float]], code: str, words: str
) -> None:
    lead: dict[str, Any] = {"lead": {"length_mm": 1.5}, "pierce": {"off_mm": 1.0}}
    drawn = [
        {"name": f"c{k}", "circle": {"at_mm": [x, 0], "diameter_mm": d}} for k, (x, d) in enumerate(circles)
    ]
    (issue,) = refused(tmp_path, outlines=drawn, **lead)
    assert (issue.code, words in issue.message) == (code, True), issue.message
    wider = [
        {**one, "circle": {"at_mm": [1.08 * one["circle"]["at_mm"][0], 0], "diameter_mm": 9.9}}
        for one in drawn
    ]
    assert registry.job(problem(tmp_path, outlines=wider, **lead), 0).targets().count > 10


def test_a_curve_that_crosses_itself_is_refused(tmp_path: Path) -> None:
    bow = {"polyline_mm": [[-8, -6, 0], [8, 6, 0], [8, -6, 0], [-8, 6, 0]]}
    found = refused(tmp_path, outlines=[{"name": "bow", "curve": bow}])
    assert {issue.code for issue in found} == {"trim.crosses"}
    assert "crosses itself, at (0.0, 0.0) mm" in found[0].message


def test_a_sharp_corner_that_the_tolerance_takes_is_cut(tmp_path: Path) -> None:
    # a round slot of 1.2 mm leaves 0.6 (sqrt 2 - 1) = 0.249 mm in a right angle
    (issue,) = refused(tmp_path, outlines=[{"name": "a", "curve": square(7.0)}], shape_tol_mm=0.1)
    assert issue.value == pytest.approx(0.6 * (np.sqrt(2.0) - 1.0), abs=0.005)
    targets = registry.job(problem(tmp_path, outlines=[{"name": "a", "curve": square(7.0)}]), 0).targets()
    assert targets.count > 10


def test_an_open_drawing_is_refused(tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.new()
    drawing.modelspace().add_lwpolyline([(0, 0), (10, 0), (10, 10), (0, 9)], close=False)
    drawing.saveas(tmp_path / "open.dxf")
    curve = {"dxf": {"file": "open.dxf", "unit": "mm"}}
    found = refused(tmp_path, outlines=[{"name": "a", "curve": curve}])
    assert {issue.code for issue in found} == {"trim.open"}


def test_a_forming_tool_cuts_no_sheet(tmp_path: Path) -> None:
    whole = data()
    whole["cell"]["arms"][0]["tool"] = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    with pytest.raises(TandemError, match="carries ball_tool, which is not a torch") as error:
        registry.job(read, 0).targets()
    assert [issue.code for issue in error.value.issues] == ["trim.tool"]


def test_without_a_formed_sheet_nothing_is_trimmed(tmp_path: Path) -> None:
    whole = dataclasses.replace(problem(tmp_path), part=None)
    with pytest.raises(TandemError) as error:
        registry.job(whole, 0).targets()
    assert [issue.code for issue in error.value.issues] == ["trim.no_sheet"]


def test_an_arm_that_is_too_slow_is_told(tmp_path: Path) -> None:
    job = registry.job(problem(tmp_path, outlines=[ROUND]), 0)
    targets = job.targets()
    clock = np.concatenate([[0.0], np.cumsum(targets.travel[1:] / targets.feed[1:])])
    assert job.check_timing(targets, clock) == ()
    assert [issue.code for issue in job.check_timing(targets, 4.0 * clock)] == ["trim.slow"]


def test_a_torch_that_lingers_in_a_long_slot_is_told(tmp_path: Path) -> None:
    """One move of 3 s more hardly counts on average, and burns a hole."""
    circle = {"name": "rim", "circle": {"at_mm": [0, 0], "diameter_mm": 72}, "drops": "outside"}
    job = registry.job(problem(tmp_path, outlines=[circle]), 0)
    targets = job.targets()
    step = targets.travel / targets.feed
    assert job.check_timing(targets, np.cumsum(step)) == ()
    step[targets.count // 2] += 3.0
    (issue,) = job.check_timing(targets, np.cumsum(step))
    assert issue.code == "trim.slow"
    assert "burns away more than its kerf" in issue.message


def test_controllers_of_ur_know_both_signals_by_number(tmp_path: Path) -> None:
    read = problem(tmp_path, outlines=[ROUND], **of_ur(tmp_path))
    targets = registry.job(read, 0).targets()
    assert post.controller_refusals(read, [targets]) == ()
    fewer = problem(tmp_path, outlines=[ROUND], **of_ur(tmp_path, {"doArc": 3}))
    (issue,) = post.controller_refusals(fewer, [targets])
    assert issue.code == "post.signal" and "diArcOk" in issue.message


def test_two_arms_of_ur_light_no_torch(tmp_path: Path) -> None:
    whole = data(outlines=[ROUND], **of_ur(tmp_path))
    (arm,), (one,) = whole["cell"]["arms"], whole["operations"]
    arms = ("robot", "second")
    numbers = {"doPartner": 0, "diPartner": 1, "doRunning": 1, "diPartnerRunning": 2, "diArcOk": 3}
    io = {name: numbers | {signal: 7} for name, signal in zip(arms, ("doArc", "doArc2"), strict=True)}
    whole["cell"]["controller"] = {"sync": "handshake", "io": io}
    whole["cell"]["arms"].append({**arm, "name": "second", "base": {"xyz_mm": [1400, 0, 0]}})
    other = {**one, "name": "other", "arms": ["second"], "signal": "doArc2"}
    whole["operations"].append({**other, "outlines": [{**ROUND, "name": "b"}]})
    read = pipeline.load(write_forming(tmp_path, whole, dish()))
    targets = [registry.job(read, k).targets() for k in range(2)]
    found = [i for i in post.controller_refusals(read, targets) if i.code == "post.controller"]
    assert [i.arm for i in found] == ["robot", "second"]
    assert all("beside another UR arm" in i.message for i in found)


def test_inner_curves_come_before_outer_ones(tmp_path: Path) -> None:
    rim = {"name": "rim", "circle": {"at_mm": [0, 0], "diameter_mm": 72}, "drops": "outside"}
    targets = registry.job(problem(tmp_path, outlines=[rim, ROUND]), 0).targets()
    names = list(dict.fromkeys(segment.name for segment in targets.segment if segment.name))
    assert names == ["round", "rim"]


@pytest.mark.parametrize(
    "field",
    [{"lead": {"shape": "arc"}}, {"feed_most_mm_s": 2}, {"ok_signal": "doArc"}, {"lead": {"length_mm": 0.6}}],
)
def test_fields_that_contradict_each_other_are_refused(tmp_path: Path, field: dict[str, Any]) -> None:
    with pytest.raises(TandemError) as error:
        problem(tmp_path, **field)
    assert {issue.code for issue in error.value.issues} == {"problem.field"}


def test_feed_follows_the_thickness_of_the_sine_law(tmp_path: Path) -> None:
    hole = {**ROUND, "circle": {"at_mm": [24, 0], "diameter_mm": 6}}
    read = problem(tmp_path, outlines=[hole], lead={"length_mm": 1.0}, pierce={"off_mm": 0.9})
    targets = registry.job(read, 0).targets()
    axis = -targets.pose["robot"][:, :3, 2]
    rows = np.flatnonzero([s.kind == "trim" and not s.phase for s in targets.segment])
    rows = rows[~(targets.stop[rows] | targets.stop[rows - 1])]
    wall = np.minimum(axis[rows, 2], 1.0)
    assert (targets.feed[rows] <= 8e-3 / wall + 1e-9).all()
    assert targets.feed[rows].max() > 1.2 * 8e-3  # on a wall of 40 deg 1.3 times as fast


# ---- geometry, by closed forms ----


def flat() -> SheetFace:
    corners = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]])
    return SheetFace(Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])), 0.001, 1)


@pytest.mark.parametrize(("inside", "radius"), [(True, 0.0092), (False, 0.0108)])
def test_the_slot_beside_a_circle_is_a_circle(inside: bool, radius: float) -> None:
    turn = 2.0 * np.pi * np.arange(720) / 720
    laid = project_curve("a", 0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1), flat())
    middle, out = offset_curve(laid, flat(), 0.0008, inside)
    assert np.linalg.norm(middle[:, :2], axis=1) == pytest.approx(radius, abs=2e-6)
    assert middle[:, 2] == pytest.approx(0.001)
    assert ((out[:, :2] * middle[:, :2]).sum(axis=1) * (-1.0 if inside else 1.0) > 0.0).all()


def test_the_slot_around_a_square_goes_round_its_corners() -> None:
    # outside: four sides of 20 mm and a full turn of 0.8 mm; inside: four sides of 18.4 mm
    corners = 0.01 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    laid = project_curve("a", corners, flat())
    for inside, length in ((False, 0.08 + 2.0 * np.pi * 0.0008), (True, 4.0 * 0.0184)):
        middle, _ = offset_curve(laid, flat(), 0.0008, inside)
        ring = np.concatenate([middle, middle[:1]])
        assert np.linalg.norm(np.diff(ring, axis=0), axis=1).sum() == pytest.approx(length, rel=5e-3)
        assert curve_distance(middle, laid.point).min() > 0.00077


def test_the_slot_on_a_wall_is_as_wide_along_the_wall() -> None:
    # a plane of 45 deg: along it the slot is its half width off the curve, in plan less
    corners = np.array([[-0.1, -0.1, -0.1], [0.1, -0.1, 0.1], [0.1, 0.1, 0.1], [-0.1, 0.1, -0.1]])
    face = SheetFace(Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])), 0.001, 1)
    turn = 2.0 * np.pi * np.arange(720) / 720
    laid = project_curve("a", 0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1), face)
    middle, _ = offset_curve(laid, face, 0.0008, False)
    assert curve_distance(middle, laid.point) == pytest.approx(0.0008, abs=3e-6)
    assert middle[:, 0].max() == pytest.approx(0.01 + 0.0008 / np.sqrt(2.0), abs=5e-6)


def test_what_a_curve_encloses_is_told_by_its_winding() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(-2.0, 2.0, (3000, 2))
    turn = 2.0 * np.pi * np.arange(400) / 400
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    clear = np.abs(np.linalg.norm(places, axis=1) - 1.0) > 1e-3
    assert (encloses(ring, places) == (np.linalg.norm(places, axis=1) < 1.0))[clear].all()
    assert (encloses(ring[::-1], places) == encloses(ring, places)).all()


def test_sizes_that_make_no_torch_are_refused() -> None:
    with pytest.raises(ValueError, match="too short"):
        torch("plasma", 0.003, 0.001, (0.006, 0.03, 0.02, 0.12))
    with pytest.raises(ValueError, match="no larger"):
        torch("laser", 0.001, 0.0002, (0.03, 0.03, 0.02, 0.25))
    made = torch("laser", 0.001, 0.0002, tilt=0.3)
    assert made.tcp[:3, 2] @ [np.sin(0.3), 0.0, np.cos(0.3)] == pytest.approx(1.0)
    assert np.linalg.norm(made.tcp[:3, 3]) == pytest.approx(0.251)
