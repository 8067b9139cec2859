"""Arms on gantries from the problem file to pages.

Carried bodies are in the right position in each picture, and the written files can be proven again.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.cli.results import write_pages
from planner.geometry.arrays import FloatArray
from planner.issues import has_errors
from planner.pipeline import plan, quick_check, verify
from planner.report import cell_picture, motion_file, scene, setup_sheet
from planner.report.output import cell_model
from planner.service import cell_drawing
from tests import gantry_job, track_job

PROBLEMS = Path(__file__).parent.parent / "problems" / "long_wall"


@pytest.mark.parametrize("file", ["gantry.yaml", pytest.param("gantry_kuka.yaml", marks=pytest.mark.long)])
def test_an_arm_that_hangs_from_a_gantry_reaches_all_corners_of_a_panel(file: str) -> None:
    problem = planner.load(PROBLEMS / file)
    (arm,) = problem.cell.arms
    assert arm.track is None and arm.base[2, 2] < -0.999 and len(problem.operations) == 4
    assert arm.linear_axes[0].carries == ("bridge",)
    result = quick_check(problem, 6)
    assert not has_errors(result.issues) and result.checked >= 4, [str(issue) for issue in result.issues]


@pytest.mark.long
def test_the_bridge_alone_does_not_reach_all_of_the_panel(tmp_path: Path) -> None:
    data = yaml.safe_load((PROBLEMS / "gantry.yaml").read_text())
    data["cell"] = yaml.safe_load((PROBLEMS / data["cell"]).read_text())
    (arm,) = data["cell"]["arms"]
    bridge, _ = arm.pop("axes")
    arm["track"] = {key: value for key, value in bridge.items() if key != "name"}
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(data))
    (issue,) = [i for i in planner.check(planner.load(tmp_path / "problem.yaml")) if i.severity == "error"]
    assert issue.code == "motion.station" and "no value of BRIDGE_1" in issue.message


def test_a_track_takes_what_it_carries_along(tmp_path: Path) -> None:
    """A cabinet on the carriage, behind the arm; a post beside the track is in its way alone."""
    rail = {key: value for key, value in gantry_job.BRIDGE.items() if key != "name"}
    pose = {"xyz_mm": [-500, 0, 1200]}
    cabinet = {"name": "column", "shapes": [{"kind": "box", "size_mm": [300, 400, 300], "pose": pose}]}

    def problem(*bodies: Any) -> planner.Problem:
        return gantry_job.problem(tmp_path, None, (cabinet, *bodies), rise=0.0, track=rail)

    outcome = plan(problem())
    assert outcome.verified, [str(issue) for issue in outcome.issues]
    last = outcome.problem.setups[1]
    stands = outcome.plan.stations[1]["left"]
    assert stands > 0.3 and last.cell.obstacles[0].shapes[0].pose[1, 3] == pytest.approx(stands)
    shape = {"kind": "box", "size_mm": [60, 60, 1300], "pose": {"xyz_mm": [-600, 300, 650]}}
    issues = planner.check(problem({"name": "post", "shapes": [shape]}))
    (issue,) = [i for i in issues if i.code == "motion.station"]
    assert "column and post" in issue.message


def test_files_prove_again_and_say_where_each_axis_stands(tmp_path: Path) -> None:
    outcome = gantry_job.planned_job()
    outcome.save(tmp_path)
    assert write_pages(tmp_path).ok  # of the files alone
    assert verify(planner.load(tmp_path / "problem" / "problem.yaml"), outcome.programs).ok
    motion_data = json.loads(motion_file.motion_json(outcome.problem, outcome.plan))["operations"]
    assert motion_data[1]["stations_mm"] == {"left/bridge": 800.0, "left/lift": 200.0}
    rows: dict[str, Any] = {
        str(what): str(expected)
        for _, what, expected, _ in setup_sheet.controller_checks(outcome.problem, outcome.plan).rows
    }
    assert "external axis number 2 (eax_b)" in rows["mechanical unit GANTRY_1 lift"]
    assert rows["ROB_1: base frame moved by"] == "GANTRY_1" and "column" in rows["GANTRY_1 bridge carries"]
    assert (
        "with bridge, lift" in rows["ROB_1: base frame"]
        or "at bridge, lift at 0" in rows["ROB_1: base frame"]
    )


def test_each_picture_has_what_rides_where_its_setup_does(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome, seen = gantry_job.planned_job(), list[dict[str, FloatArray]]()

    def record_scene(cell_scene: scene.VisibleScene, moment: cell_picture.PictureState) -> Any:
        seen.append(
            scene.scene_poses(
                cell_scene, moment.setup, moment.stock_pose, {k: q[None] for k, q in moment.q.items()}
            )
        )

    monkeypatch.setattr(cell_picture, "picture", record_scene)
    list(
        cell_picture.setup_pictures(cell_model(outcome.problem, outcome.plan), outcome.problem, outcome.plan)
    )
    # the model is that of the first setup, whose console stands at its station
    expected = [([0.0, -0.5, 1.0], [0.0, 0.0, 0.0]), ([0.0, 0.8, 1.2], [0.0, 1.3, 0.2])]
    for poses, (base, console) in zip(seen, expected, strict=True):
        np.testing.assert_allclose(poses["left/base_link"][0][:3, 3], base, atol=1e-9)
        np.testing.assert_allclose(poses["console"][0][:3, 3], console, atol=1e-9)


def test_the_page_has_what_rides_where_it_is() -> None:
    problem = gantry_job.planned_job().problem
    out, issues = cell_drawing.view(problem, 1)
    assert not has_errors(issues)
    bodies = {body["body"]: body for body in out["bodies"]}
    low = np.array(bodies["console"]["vertices"]).reshape(-1, 3).min(axis=0)
    np.testing.assert_allclose(low[1:], [800.0 - 150.0, 899.0 + 200.0], atol=0.1)


def test_without_the_lift_the_upper_poses_are_refused(tmp_path: Path) -> None:
    low = [gantry_job.BRIDGE, {**gantry_job.LIFT, "range_mm": [-300, -200], "home_mm": -200}]
    (issue,) = [
        i for i in planner.check(gantry_job.problem(tmp_path, low, rise=900.0)) if i.severity == "error"
    ]
    assert issue.code == "motion.station" and "bridge -1500 to 1500, lift -300 to -200 mm" in issue.message
    assert issue.hint is not None and "make the axes longer" in issue.hint and "follow" not in issue.hint


def test_an_end_stop_on_the_way_is_found_before_planning(tmp_path: Path) -> None:
    """It is higher than the rails, behind the arm: nothing but the column runs into it."""
    pose = {"xyz_mm": [-700, 300, 130]}
    stop = {"name": "stop", "shapes": [{"kind": "box", "size_mm": [100, 50, 60], "pose": pose}]}
    bodies = (gantry_job.RAILS, gantry_job.COLUMN, gantry_job.CONSOLE, stop)
    issues = planner.check(gantry_job.problem(tmp_path, obstacles=bodies))
    (issue,) = [i for i in issues if i.code == "motion.station"]
    assert "on the way there" in issue.message and "column" in issue.message and "stop" in issue.message


@pytest.mark.long
def test_two_arms_one_on_a_gantry_and_one_on_a_track(tmp_path: Path) -> None:
    gantry_job.problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    other = {**track_job.ARM, "name": "right", "base": {"xyz_mm": [4000, 0, 0]}}
    data["cell"]["arms"].append(other)
    rows = (tmp_path / "a.csv").read_text().replace("left", "right").splitlines()
    moved = [rows[0]]
    for row in rows[1:]:
        x, y, z, *rest = row.split(",")
        moved.append(",".join([str(float(x) + 4000.0), y, str(float(z) - 900.0), *rest]))
    (tmp_path / "c.csv").write_text("\n".join(moved) + "\n")
    data["operations"].append({**data["operations"][0], "name": "c", "arms": ["right"], "file": "c.csv"})
    path.write_text(yaml.safe_dump(data))
    outcome = plan(planner.load(path))
    assert outcome.verified, [str(issue) for issue in outcome.issues]
    assert set(outcome.plan.stations[2]) == {"left/bridge", "left/lift", "right"}
