"""Jobs as G93 files for five-axis machines.

They are read back by the planner's and the proof's G-code reader, and by LinuxCNC's ``rs274`` if it is on the
path. The angles are checked against scipy's rotations.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner import pipeline, plans
from planner.cli import results
from planner.geometry.arrays import FloatArray
from planner.issues import TandemError
from planner.processes import registry
from planner.processes.milling.plan.gcode import inverse_time
from planner.processes.milling.plan.gcode.inverse_time import AXIS_TOLERANCE_RAD, MachinePath
from planner.processes.milling.plan.gcode.state import KINEMATICS, find_convention
from planner.processes.milling.plan.operation import Milling
from planner.targets import TargetAction
from tests import small_problem
from tests.processes.milling.plan.gcode.gcode_programs import read
from tests.processes.milling.plan.gcode.test_canon import COMMAND, rs274
from tests.processes.milling.plan.small_mill import PANEL, problem

TWO = [name for name, one in KINEMATICS.items() if len(one.chain) == 2]


def tool_axes(name: str, angles: FloatArray) -> FloatArray:
    """Return the tool axis (N, 3) in the part's frame, by scipy.

    Axes that carry the tool rotate it. Axes that carry the part rotate the part, which rotates the tool the
    other way.
    """
    tool, part = Rotation.identity(len(angles)), Rotation.identity(len(angles))
    for letter, sign in KINEMATICS[name].chain:
        one = Rotation.from_euler("xyz"["ABC".index(letter)], angles[:, ["ABC".index(letter)]])
        if sign > 0:
            tool = tool * one
        else:
            part = one * part  # chain of a table: from the part outwards to the bed
    return (part.inv() * tool).apply([0.0, 0.0, 1.0])


def spiral(count: int, max_tilt: float) -> MachinePath:
    """A way whose axis goes around the pole, and through its neighbourhood."""
    t = np.linspace(0.0, 1.0, count)
    tilt, about = max_tilt * np.sin(5.0 * t), 9.0 * t + 0.3
    axis = np.stack([np.sin(tilt) * np.cos(about), np.sin(tilt) * np.sin(about), np.cos(tilt)], axis=1)
    tip = 0.1 * np.stack([np.cos(about), np.sin(about), t], axis=1)
    names = [f"mill/a/{i}" for i in range(count)]
    on = (TargetAction(0, "on", signal="doSpindle"),)
    return MachinePath("a", tip, axis, np.cumsum(0.02 + 0.03 * t), names, on, 9000.0, "doSpindle")


@pytest.mark.parametrize("name", TWO)
def test_angles_point_the_tool_along_any_vector_and_go_on_from_one_another(name: str) -> None:
    rng = np.random.default_rng(11)
    loose = rng.normal(size=(200, 3))
    loose[:3] = [0, 0, 1], [0, 0, -1], [1, 0, 0]
    loose /= np.linalg.norm(loose, axis=1, keepdims=True)
    for axis in (loose, spiral(400, 0.7).axis):
        found = inverse_time.rotary_angles(axis, KINEMATICS[name])
        assert np.abs(tool_axes(name, found) - axis).max() < 1e-7
        assert set(np.flatnonzero(found.any(axis=0))) <= {"ABC".index(c) for c in KINEMATICS[name].letters}
    assert np.abs(np.diff(found, axis=0)).sum(axis=1).max() < np.pi


@pytest.mark.parametrize("name", TWO)
@pytest.mark.parametrize("index", [0, 1])
def test_an_axis_in_reverse_has_its_angles_negated(name: str, index: int) -> None:
    axis = spiral(200, 0.7).axis
    letter = KINEMATICS[name].letters[index]
    found = inverse_time.rotary_angles(axis, find_convention(name, letter))
    found[:, "ABC".index(letter)] *= -1.0
    assert np.abs(tool_axes(name, found) - axis).max() < 1e-7


@pytest.mark.parametrize("name", TWO)
def test_what_is_written_is_read_back(name: str, tmp_path: Path) -> None:
    way = spiral(120, 0.4)
    text = inverse_time.write_program("a job", [way], KINEMATICS[name])
    found = read(tmp_path, text, tool_axis="rotary", convention=name, skip=["G40", "G80"], dwell="s").path
    rows = [int(np.linalg.norm(found.tip - tip, axis=1).argmin()) for tip in way.tip]
    assert rows == sorted(rows)
    assert np.linalg.norm(found.tip[rows] - way.tip, axis=1).max() < 1e-7
    assert np.abs(found.axis[rows] - way.axis).max() < 1e-6
    step = np.linalg.norm(np.diff(found.tip, axis=0), axis=1)
    times = np.concatenate([[0.0], np.cumsum(step[rows[0] :] / found.feed[rows[0] + 1 :])])
    assert times[np.array(rows) - rows[0]] == pytest.approx(way.time - way.time[0], rel=1e-3)
    between = np.linspace(0, len(way.tip) - 1, 2000)  # the axis is near the great circle everywhere
    turn = inverse_time.divide_path(way, KINEMATICS[name])
    fraction = np.interp(between, np.arange(len(way.tip)), way.time)
    axis = tool_axes(name, np.stack([np.interp(fraction, turn[2], turn[1][:, k]) for k in range(3)], axis=1))
    assert (
        np.linalg.norm(axis - inverse_time._interpolate_axis(way, between), axis=1).max()
        < 1.5 * AXIS_TOLERANCE_RAD
    )


@pytest.mark.parametrize("name", ["head_ca", "table_ac", "head_b_table_c", "head_ba"])
def test_linuxcnc_reads_all_of_it(name: str, tmp_path: Path) -> None:
    way = spiral(120, 0.4)
    tip, turn, time, _ = inverse_time.divide_path(way, KINEMATICS[name])
    output = rs274(tmp_path, inverse_time.write_program("a job", [way], KINEMATICS[name]))
    feed, ends, seconds = 0.0, [], []
    for line in output.splitlines():
        met = COMMAND.match(line)
        values = [] if met is None else met[2].replace(",", " ").split()
        if met is not None and met[1] == "SET_FEED_RATE":
            feed = float(values[0])
        if met is not None and met[1] in ("STRAIGHT_FEED", "STRAIGHT_TRAVERSE"):
            end = np.array(values[:6], dtype=float)
            if met[1] == "STRAIGHT_FEED":
                seconds.append(60.0 * np.linalg.norm(end[:3] - ends[-1][:3]) / feed)
            ends.append(end)
    got = np.array(ends[-len(tip) :])
    assert np.abs(got[:, :3] - 1e3 * tip).max() < 1e-4
    assert np.abs(got[:, 3:] - np.rad2deg(turn)).max() < 1e-4
    assert seconds == pytest.approx(np.diff(time), rel=1e-3)


def test_a_milled_job_has_its_operator_and_its_spindle(tmp_path: Path) -> None:
    made = problem(
        tmp_path,
        PANEL,
        {**PANEL["cell"]["arms"][0]["tool"], "cutter": "ball"},
        cuts=[{"lines": "front", "stepover_mm": 3}],
    )
    (job,) = registry.jobs(made)
    targets = job.targets()
    time = np.cumsum(np.append(0.0, targets.travel[1:] / targets.feed[1:]))
    way = inverse_time.machine_path(made.operations[0], targets, targets.neutral_values(), time)
    lines = inverse_time.write_program(made.name, [way], KINEMATICS["table_ac"]).splitlines()
    first = next(line for line in lines if line.startswith("G94 G0 A"))
    assert [line for line in lines if line[:2] in ("M3", "M5", "M0", "M2", "G9") and "G1" not in line] == [
        "M0",
        "M0",  # nobody is asked anything while the spindle runs, which M0 stops on many machines
        first,
        "M3 S12000",
        "G94 G4 P1.000",
        "M5",
        "G94 G4 P1.000",
        "M0",
        "G94",
        "M2",
    ]
    assert lines.index("M3 S12000") == lines.index(first) + 3  # at the first target, as in the plan
    assert "(NOT proven for this machine: its limits, its bodies and its clamping are not known)" in lines
    assert all(line.isascii() and line.count("(") <= 1 for line in lines)


def straight(tilts: FloatArray, about: FloatArray, times: FloatArray) -> MachinePath:
    """A way along x whose axis leans by ``tilts`` (N,) towards ``about`` (N,) [rad]."""
    axis = np.stack([np.sin(tilts) * np.cos(about), np.sin(tilts) * np.sin(about), np.cos(tilts)], axis=1)
    tip = np.stack([0.01 * np.arange(len(tilts)), *np.zeros((2, len(tilts)))], axis=1)
    return MachinePath(
        "a", tip, axis, times, [f"mill/a/{i}" for i in range(len(tilts))], (), 9000.0, "doSpindle"
    )


@pytest.mark.parametrize("name", ["head_ca", "table_bc", "head_b_table_c"])
def test_along_the_axis_that_carries_it_the_tool_turns_in_time(name: str) -> None:
    tilts = np.array([0, 0, 0, 0.2, 0.2, 0, 0, 0, 0, 0.2, 0])
    about = np.array([0, 0, 0, 1.5, 1.5, 0, 0, 0, 0, 2.5, 0])
    noise = np.random.default_rng(3).random(len(tilts))
    way = straight(tilts + 4e-6 * noise, np.where(tilts > 0, about, 4.0 * noise), np.arange(11.0))
    _, turn, time, target = inverse_time.divide_path(way, KINEMATICS[name])
    c = turn[:, 2]
    assert len(c) < 30
    assert np.ptp(c[target <= 4]) < 1e-3  # stands there before the first lean, whatever noise says
    assert np.ptp(c[target >= 9]) < 1e-3
    steps = np.diff(c[np.isin(time, np.arange(4.0, 10.0))])
    assert steps == pytest.approx(steps[0], abs=1e-3)  # and turns evenly to the next one
    assert (
        np.linalg.norm(
            tool_axes(name, inverse_time.rotary_angles(way.axis, KINEMATICS[name])) - way.axis, axis=1
        ).max()
        < 5e-5
    )


def test_moves_without_time_have_a_feed_that_controllers_take(tmp_path: Path) -> None:
    way = straight(np.full(4, 0.2), np.zeros(4), np.array([0.0, 1.0, 1.0, 1.002]))
    text = inverse_time.write_program("a job", [way], KINEMATICS["table_ac"])
    assert [line.rpartition("F")[2] for line in text.splitlines() if line.startswith("G93")] == [
        "60.000000",
        "9999.000000",
        "9999.000000",
    ]
    assert "(A counts as it turns the part about +x, right hand)" in text


def test_what_a_machine_cannot_do_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        inverse_time.write_program("a job", [spiral(50, 0.4)], KINEMATICS["head_a"])
    (issue,) = caught.value.issues
    assert "cannot point the tool as 'a' does" in issue.message
    assert "mill/a/" in issue.message
    with pytest.raises(TandemError, match="which is G-code"):
        stated = {"gcode": {"file": "job.nc", "origin": {"xyz_mm": [0, 0, 0]}}}
        operation = Milling.model_validate({**PANEL["operations"][0], "cuts": [stated]})
        inverse_time.machine_path(operation, None, None, None)  # type: ignore[arg-type]
    result = pipeline.plan(pipeline.load(small_problem.write(tmp_path)))
    result.save(tmp_path / "out")
    for name, machine, said in (
        ("a.ngc", "table_ac", r"for milling only, got the operation 'poses' \(targets\)"),
        ("a.ngc", None, "--machine: got None; it is required for .ngc files"),
        ("a.glb", "table_ac", "--machine: got table_ac; it is required for .ngc files and not allowed"),
        ("a.ngc", "hexapod", "--machine: got hexapod, allowed: head_a, head_b"),
    ):
        with pytest.raises(TandemError, match=said):
            results.export_result(tmp_path / "out", tmp_path / name, machine=machine)
    with pytest.raises(TandemError, match="--reverse: got 'AB', allowed: letters of AC, each once"):
        results.export_result(tmp_path / "out", tmp_path / "a.ngc", machine="table_ac", reverse="AB")
    plans.save(dataclasses.replace(result.plan, digest="0" * 64), tmp_path / "out")
    with pytest.raises(TandemError, match="is of problem 000000000000, the folder holds"):
        results.export_result(tmp_path / "out", tmp_path / "a.ngc", machine="table_ac")
    plans.save(result.plan, tmp_path / "out")
    next((tmp_path / "out" / "programs").rglob("*.mod*")).write_text("changed")
    with pytest.raises(TandemError, match="the proof has"):
        results.export_result(tmp_path / "out", tmp_path / "a.ngc", machine="table_ac")
