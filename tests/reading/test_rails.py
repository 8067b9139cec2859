"""Axes of a gantry in a cell file: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.issues import TandemError
from planner.problem import motion_order
from tests.gantry_job import ARM, BRIDGE, KUKA, LIFT, problem
from tests.table_job import TABLE
from tests.track_job import TRACK

THIRD: dict[str, Any] = {**BRIDGE, "name": "trolley", "axis": [1, 0, 0], "unit": "TROLLEY_1", "carries": []}


def read_issues(folder: Path, axes: Any, **more: Any) -> list[tuple[str, str]]:
    with pytest.raises(TandemError) as refused:
        problem(folder, axes, **more)
    return [(issue.code, issue.message) for issue in refused.value.issues]


def test_a_gantry_is_read_in_si_units_and_takes_along_what_stands_on_it(tmp_path: Path) -> None:
    slanted = {**LIFT, "axis": [0, 3, 4], "home_mm": 100, "external_axis": 5}
    made = problem(tmp_path, [BRIDGE, slanted])
    arm = made.cell.arm("left")
    assert arm.track is None and list(arm.axes_by_name) == ["left/bridge", "left/lift"]
    lift = arm.axes_by_name["left/lift"]
    np.testing.assert_allclose(lift.axis, [0.0, 0.6, 0.8])
    assert (lift.low, lift.high, lift.home, lift.column, lift.label) == (-0.3, 0.9, 0.1, 4, "GANTRY_1 lift")
    assert (arm.linear_axes[0].column, arm.linear_axes[0].speed, lift.acceleration) == (0, 1.0, 0.5)
    stood = made.with_stations({0: {"left/bridge": 1.5, "left/lift": 0.5}})
    for setup in stood.setups:  # where nothing is said it stays
        np.testing.assert_allclose(setup.cell.arm("left").base[:3, 3], [0.0, 1.8, 1.4])
        at = {body.name: body.shapes[0].pose[:3, 3] for body in setup.cell.obstacles}
        np.testing.assert_allclose(at["rails"], [-0.7, 0.0, 0.05])
        np.testing.assert_allclose(at["column"], [-0.7, 1.5, 1.401])
        np.testing.assert_allclose(at["console"], [-0.2, 1.8, 1.349])
        assert setup.steps[-1] == (
            "Keep off the gantry GANTRY_1: once this is confirmed it takes arm left, folded at its home, one "
            "axis after the other, to where they stand: bridge at 1500.000 mm, lift at 500.000 mm."
        )
    home = stood.closing_setup
    assert home is not None
    np.testing.assert_allclose(home.cell.arm("left").base[:3, 3], [0.0, 0.06, 1.08])
    at = {body.name: body.shapes[0].pose[:3, 3] for body in home.cell.obstacles}
    np.testing.assert_allclose(at["console"], [-0.2, 0.06, 1.029], atol=1e-12)
    np.testing.assert_allclose(at["column"], [-0.7, 0.0, 1.401], atol=1e-12)
    np.testing.assert_allclose(made.cell.obstacles[2].shapes[0].pose[:3, 3], [-0.2, 0.0, 0.949])


def test_an_axis_may_have_any_name(tmp_path: Path) -> None:
    """That of the value behind an operation in which a track goes along, too (it broke off)."""
    made = problem(tmp_path, [{**BRIDGE, "name": "end"}, {**LIFT, "name": "tilt"}])
    for setup in made.with_stations({0: {"left/end": 1.5}}).setups:
        np.testing.assert_allclose(setup.cell.arm("left").base[:3, 3], [0.0, 1.5, 1.0])


def test_axes_go_one_after_the_other_a_raised_column_before_the_bridge(tmp_path: Path) -> None:
    rails = problem(tmp_path).cell.arm("left").axes_by_name
    bridge, lift = rails

    def order(start: tuple[float, float], goal: tuple[float, float]) -> tuple[str, ...]:
        return motion_order(rails, dict(zip(rails, start, strict=True)), dict(zip(rails, goal, strict=True)))

    assert order((0.0, 0.0), (1.0, 0.5)) == (bridge, lift)  # away from home: from the floor up
    assert order((1.0, 0.5), (0.0, 0.0)) == (lift, bridge)  # home: from the arm down
    assert order((1.0, 0.5), (-1.2, 0.1)) == (lift, bridge)  # what comes nearer goes first
    assert order((1.0, 0.1), (0.2, 0.5)) == (bridge, lift)
    assert order((1.0, 0.5), (-1.0, -0.5)) == (bridge, lift)  # through home, and no nearer to it
    assert order((1.0, 0.5), (1.0, 0.5)) == () and order((1.0, 0.5), (1.0, 0.2)) == (lift,)


WRONG: list[tuple[Any, str, str]] = [
    ([BRIDGE, {**LIFT, "axis": [0, 0, 0]}], "problem.field", "its length is 0"),
    ([BRIDGE, {**LIFT, "axis": [0, -1, 0.02]}], "problem.field", "parallel to bridge, 1.15 degrees off"),
    (
        [BRIDGE, LIFT, {**THIRD, "axis": [0.02, 1, 1]}],
        "problem.field",
        "trolley is nearly in the plane of bridge and lift, 0.81 degrees off",
    ),
    ([BRIDGE, {**LIFT, "range_mm": [200, 200]}], "problem.field", "the lower value first"),
    ([BRIDGE, {**LIFT, "range_mm": [-0.3, 0.9]}], "problem.field", "values are mm: 3 m are 3000"),
    ([BRIDGE, {**LIFT, "home_mm": 901}], "problem.field", "901 is outside the range of -300 to 900"),
    ([BRIDGE, {**LIFT, "speed_mm_s": 0}], "problem.field", "speed_mm_s: got 0; allowed: 1 at least"),
    ([BRIDGE, {**LIFT, "acceleration_mm_s2": 0}], "problem.field", "acceleration_mm_s2: got 0"),
    ([BRIDGE, {**LIFT, "name": "Bridge"}], "problem.duplicate_name", "two axes of arm left are called"),
    ([BRIDGE, {**LIFT, "external_axis": 1}], "problem.field", "as for axis bridge; give each axis"),
    ([BRIDGE, {**LIFT, "carries": ["console", "column"]}], "problem.field", "column is mounted on GANTRY_1"),
    ([BRIDGE, {**LIFT, "carries": ["console", "console"]}], "problem.field", "'console' is listed twice"),
    ([BRIDGE, {**LIFT, "carries": ["counter"]}], "problem.field", "'counter' is not an obstacle of the cell"),
    ([BRIDGE, {**LIFT, "unit": "ROB_1"}], "problem.duplicate_name", "the unit ROB_1 is also that of"),
    ([BRIDGE, {**LIFT, "follow": 1}], "problem.field", "the axes of a gantry stand still while"),
    ([BRIDGE], "problem.field", "has 1 entry, at least 2 required"),
]


@pytest.mark.parametrize(("axes", "code", "words"), WRONG, ids=[words for *_, words in WRONG])
def test_what_cannot_be_a_gantry_is_told(tmp_path: Path, axes: Any, code: str, words: str) -> None:
    result = read_issues(tmp_path, axes)
    assert [item for item, message in result if words in message] == [code], result


def test_what_cannot_be_together_with_a_gantry_is_told(tmp_path: Path) -> None:
    cases: list[tuple[dict[str, Any], str, str]] = [
        ({"track": TRACK}, "problem.field", "has a track and axes"),
        ({"base_auto": True}, "problem.track", "is on a gantry, whose pose is not searched"),
        ({"controller": {"language": "ros"}}, "problem.field", "axes of arm left: trajectories"),
    ]
    for more, code, words in cases:
        result = read_issues(tmp_path, (BRIDGE, LIFT), **more)
        assert (code, True) in [(item, words in message) for item, message in result], result
    units = read_issues(tmp_path, (BRIDGE, {**LIFT, "unit": "LIFT_1"}), **KUKA)
    assert any("in one kinematic (#ERSYS)" in message for _, message in units), units
    names = read_issues(tmp_path, (BRIDGE, {**LIFT, "name": "lift_of_the_whole_arm_"}), **KUKA)
    assert any("too long for a KUKA controller's messages" in message for _, message in names), names
    moved = {**TRACK, "follow": 1, "carries": ["column"]}
    result = read_issues(tmp_path, None, track=moved)
    assert any("remove follow or carries" in message for _, message in result), result


def test_a_block_on_what_an_axis_carries_is_refused(tmp_path: Path) -> None:
    problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["stock"] = {"size_mm": [100, 100, 50], "place": {"xyz_mm": [100, 0, 999]}}
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as refused:
        planner.load(path)
    (issue,) = [item for item in refused.value.issues if item.code == "problem.track"]
    assert "the block stands on console, which GANTRY_1 lift carries" in issue.message


def test_two_arms_on_one_unit_are_refused_and_a_table_besides(tmp_path: Path) -> None:
    problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    other = {**ARM, "name": "right", "base": {"xyz_mm": [3000, 0, 0]}}
    data["cell"]["arms"].append(other)
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as refused:
        planner.load(path)
    assert [issue.code for issue in refused.value.issues] == ["problem.duplicate_name"]
    data["cell"]["arms"].pop()
    data["cell"]["turntable"] = TABLE
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as refused:
        planner.load(path)
    assert "problem.turntable" in {issue.code for issue in refused.value.issues}
