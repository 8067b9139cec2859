"""`motion.json`: its arms and targets are those requested, and its motion is the planned one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner
from planner.catalogue.robots import urdf_path
from planner.geometry.arrays import exp_rotation
from planner.report import motion_file
from tests import small_problem


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> planner.Outcome:
    folder = tmp_path_factory.mktemp("small")
    line = "  - {name: again, process: targets, arms: [left], file: again.csv, frame: world}\n"
    rows = [f"{small_problem.COLUMNS},segment", *(f"{row},cut/again" for row in small_problem.ROWS)]
    (folder / "again.csv").write_text("\n".join(rows))
    return planner.plan(planner.load(small_problem.write(folder, small_problem.PROBLEM + line)))


@pytest.fixture(scope="module")
def motion(outcome: planner.Outcome, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("out") / "out"
    outcome.save(folder, pages=False)
    data: dict[str, Any] = json.loads((folder / "motion.json").read_text())
    return data


def test_planes_are_the_poses_that_were_asked_for(motion: dict[str, Any]) -> None:
    own = motion["operations"][0]
    expected = np.array([[float(word) for word in row.split(",")] for row in small_problem.ROWS])
    planes = np.array(own["arms"]["left"]["tcp"])
    assert planes.shape == (len(expected), 9)
    assert np.abs(planes[:, :3] - expected[:, :3]).max() < 1e-6
    turn = exp_rotation(2 * np.pi / 3 * np.array([-1.0, 1.0, 1.0]) / np.sqrt(3.0))  # 0.5, -0.5, 0.5, 0.5
    assert np.abs(planes[:, 3:6] - turn[:, 0]).max() < 1e-9
    assert np.abs(planes[:, 6:9] - turn[:, 1]).max() < 1e-9
    assert own["block"] == {"plane": [450, 0, 0, 1, 0, 0, 0, 1, 0]}


def test_joints_and_times_are_those_of_the_plan(outcome: planner.Outcome, motion: dict[str, Any]) -> None:
    own, planned = motion["operations"][0], outcome.plan.operations[0]
    left = motion["arms"]["left"]
    assert (left["robot"], left["joints"]) == ("irb140", [f"joint_{i}" for i in range(1, 7)])
    assert left["home_deg"] == [0, 0, 0, 0, 45, 0]
    assert left["base"] == [0, 0, 0, 1, 0, 0, 0, 1, 0]
    way = own["arms"]["left"]
    assert np.abs(np.radians(way["joints_deg"]) - planned.q["left"]).max() < 1e-10
    assert np.shape(way["entry_deg"]) == planned.approach["left"].shape
    assert np.abs(np.array(own["time_s"]) - planned.time + planned.time[0]).max() < 1e-6
    assert own["names"] == [planned.targets.name(k) for k in range(planned.targets.count)]
    assert own["segments"] == [str(segment) for segment in planned.targets.segment]


def test_operations_follow_one_another_on_the_clock(outcome: planner.Outcome, motion: dict[str, Any]) -> None:
    first, second = motion["operations"]
    assert (first["name"], second["name"]) == ("poses", "again")
    assert first["start_s"] == 0
    assert second["start_s"] == first["time_s"][-1] > 0
    assert second["start_s"] + second["time_s"][-1] == pytest.approx(outcome.plan.duration, abs=1e-5)


def test_a_held_block_stands_in_its_holder() -> None:
    problem = planner.load("shell_piece_held")
    (setup, *_) = problem.setups
    result = motion_file._block_plane(setup, np.eye(4))
    assert result["held_by"] == setup.stock.held_by
    assert result["in_tcp"][:3] == pytest.approx((setup.stock.grip[:3, 3] * 1e3).tolist(), abs=1e-8)


def test_joints_of_ones_own_arm_have_the_names_of_its_urdf(tmp_path: Path) -> None:
    text = urdf_path("irb140").read_text("utf-8").replace('"joint_', '"shop_a1_joint_')
    (tmp_path / "mine.urdf").write_text(text, "utf-8")
    own = "{urdf: mine.urdf, name: mine, family: abb, payload_kg: 6, full_speed_after_s: 0.25}"
    problem = planner.load(
        small_problem.write(tmp_path, small_problem.PROBLEM.replace("robot: irb140", f"robot: {own}"))
    )
    assert problem.cell.arms[0].data.joints == tuple(f"shop_a1_joint_{i}" for i in range(1, 7))
