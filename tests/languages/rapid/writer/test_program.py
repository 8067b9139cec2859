"""Whole RAPID programs: against a golden text, by their structure, and as an independent reader sees them."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import from_quaternion
from planner.languages.rapid.reader.reader import read_task
from planner.targets import TargetAction
from tests.languages.writing import synthetic
from tests.languages.writing.reading import flat, modules, moves, numbers, programs

GOLDEN = Path(__file__).with_name("golden")


@pytest.fixture(scope="module")
def small():
    plan, problem = synthetic.small()
    return plan, problem, programs(plan, problem, {"least clearance": "12.3 mm (left/link_4 to stock)"})


def test_a_small_job_is_written_as_read_by_a_person(small):
    """The golden text was read line by line: forms, meeting points, order of power and stops."""
    files = small[2]
    stored = {
        str(p.relative_to(GOLDEN)): p.read_bytes().decode() for p in sorted(GOLDEN.rglob("*")) if p.is_file()
    }
    stored = {name: re.sub(r"Tandem \d+\.\d+\.\d+", "Tandem X", text) for name, text in stored.items()}
    written = {name: re.sub(r"Tandem \d+\.\d+\.\d+", "Tandem X", text) for name, text in files.items()}
    assert sorted(written) == sorted(stored)
    for name, text in written.items():
        assert text == stored[name], name


def test_the_same_plan_gives_the_same_text(small):
    plan, problem, files = small
    assert programs(plan, problem, {"least clearance": "12.3 mm (left/link_4 to stock)"}) == files


def test_margins_change_comments_only(small):
    plan, problem, files = small
    bare = programs(plan, problem)
    strip = re.compile(r"^ *!.*\n", re.MULTILINE)
    assert {n: strip.sub("", t) for n, t in bare.items()} == {n: strip.sub("", t) for n, t in files.items()}
    assert any("least clearance 12.3 mm" in text for text in files.values())


def test_an_independent_reader_finds_nothing_to_say(small):
    for task in ("T_ROB1", "T_ROB2"):
        assert read_task(modules(small[2], task)).faults == ()


def test_the_arms_meet_with_equal_ids_and_times(small):
    left, right = moves(small[2], "T_ROB1"), moves(small[2], "T_ROB2")
    assert len(left) == len(right) == 8
    assert [row[3] for row in left] == [row[3] for row in right]
    ids = [int(row[3]) for row in left]
    assert ids == sorted(set(ids))
    assert [row[5] for row in left] == [row[5] for row in right]
    assert [row[6] == "fine" for row in left] == [row[6] == "fine" for row in right]


def test_both_tasks_pass_the_same_points_once_and_in_one_order(small):
    form = re.compile(r"(WaitSyncTask|SyncMoveOn|SyncMoveOff) (\w+)")
    left, right = (
        [form.match(s).groups() for s in flat(small[2], t) if form.match(s)] for t in ("T_ROB1", "T_ROB2")
    )
    assert left == right
    names = [name for _, name in left]
    assert len(names) == len(set(names))
    for task in ("T_ROB1", "T_ROB2"):
        declared = re.findall(r"VAR syncident (\w+);", "\n".join(modules(small[2], task).values()))
        assert sorted(declared) == sorted(names)


def test_outside_synchronised_blocks_only_one_task_does_anything(small):
    stages = []
    for task in ("T_ROB1", "T_ROB2"):
        rows, inside = [[]], False
        for line in flat(small[2], task):
            if line.startswith(("WaitSyncTask", "SyncMoveO")):
                rows.append([])
            if line.startswith("SyncMove"):
                inside = line.startswith("SyncMoveOn")
            if line.startswith(("Move", "SetDO", "UIMsgBox", "TPWrite", "WaitTime")):
                rows[-1].append(inside)
        stages.append(rows)
    assert len(stages[0]) == len(stages[1])
    for one, other in zip(*stages, strict=True):
        assert all(one + other) or not one or not other


def test_moves_stop_before_a_block_begins_ends_or_meets(small):
    for task in ("T_ROB1", "T_ROB2"):
        last = ""
        for line in flat(small[2], task):
            if line.startswith(("SyncMove", "WaitSyncTask", "SetDO", "UIMsgBox")):
                assert "Move" not in last or ",fine," in last, line
            if line.startswith("Move"):
                last = line
            assert ("\\ID:=" in line) == line.startswith("MoveL")


def test_wire_power_is_switched_by_one_task_and_before_the_cut(small):
    left, right = flat(small[2], "T_ROB1"), flat(small[2], "T_ROB2")
    assert not any("SetDO" in line or "UIMsgBox" in line for line in right)
    assert (
        left.index("SetDO doWirePower,1;")
        < left.index("WaitTime 12.5;")
        < next(i for i, line in enumerate(left) if line.startswith("MoveL"))
    )
    assert left.index("SetDO doWirePower,0;") < left.index("SetDO doWirePower,1;")
    assert left.count("SetDO doWirePower,0;") == 2


def test_every_handler_switches_the_wire_off_then_stops_both_arms_and_ends(small):
    for task in ("T_ROB1", "T_ROB2"):
        text = "\n".join(modules(small[2], task).values())
        procedures = re.findall(
            r"^  PROC (?!check_stop)\w+\(\)\n(.*?)ENDPROC", text, re.DOTALL | re.MULTILINE
        )
        assert len(procedures) == 7
        for body in procedures:
            handler = body.split("  ERROR\n")[1].split("  UNDO\n")[0]
            lines = [line.strip() for line in handler.split("\n") if line.strip()]
            assert lines[0] == "SetDO doWirePower,0;"
            assert lines[1] == "StopMove\\Quick;"
            assert lines[-2:] == ["Stop\\AllMoveTasks;", "EXIT;"]
            assert not any(
                word in handler for word in ("StartMove", "RETRY", "TRYNEXT", "MoveL", "SyncMoveOff")
            )
            if "SyncMoveOn" in body:
                undo = [line.strip() for line in body.split("  UNDO\n")[1].split("\n") if line.strip()]
                assert undo[-2:] == ["SetDO doWirePower,0;", "SyncMoveUndo;"]


def test_written_targets_are_the_planned_poses(small):
    plan, problem, files = small
    for task, arm in (("T_ROB1", "left"), ("T_ROB2", "right")):
        rows = moves(files, task)
        position, quaternion = numbers(rows, 0), numbers(rows, 1)
        item = problem.cell.arm(arm)
        q = plan.operations[0].q[arm][1:]
        world = item.base @ forward_kinematics(robot(item.robot), q) @ item.tool.tcp
        expected = np.linalg.inv(plan.stock_poses[0]) @ world
        assert np.abs(position / 1e3 - expected[:, :3, 3]).max() <= 0.51e-7
        assert np.abs(from_quaternion(quaternion) - expected[:, :3, :3]).max() < 3e-8


def test_entry_joints_are_in_the_controllers_degrees_and_start_at_home(small):
    data = small[2]["T_ROB1/TandemData_1.mod"]
    stations = dict(re.findall(r"CONST jointtarget (\w+):=\[\[([-\d.,]+)\]", data))
    assert stations["j_home"] == "0.000000,0.000000,0.000000,0.000000,30.000000,0.000000"
    assert stations["j_1_start"] == "5.000000,20.000000,10.000000,15.000000,45.000000,-25.000000"
    lines = [line for line in flat(small[2], "T_ROB1") if line.startswith("MoveAbsJ")]
    assert "j_home" in lines[0] and "j_home" in lines[-1]


def test_a_parallel_rod_arm_gets_coupled_axis_3_and_no_conf_check():
    plan, problem = synthetic.small(model="irb4400_60")
    files = programs(plan, problem)
    main, data = files["T_ROB1/TandemMain_1.mod"], files["T_ROB1/TandemData_1.mod"]
    assert "ConfL\\Off;" in main and "ConfL\\On;" not in main and "! Parallel-rod arm" in main
    # start is q2 = 20, serial q3 = 10: the controller's axis 3 is their sum
    assert "j_1_start:=[[5.000000,20.000000,30.000000,15.000000,45.000000,-25.000000]" in data


def test_a_serial_arm_checks_its_configuration(small):
    assert "ConfL\\On;" in small[2]["T_ROB1/TandemMain_1.mod"]


def test_quaternions_do_not_jump_in_sign():
    job = synthetic.problem(("left",))
    q = np.repeat(synthetic.START[None, :], 200, axis=0)
    q[:, 5] = np.linspace(-6.0, 6.0, 200)
    plan = synthetic.plan(synthetic.operation(job, {"left": q}, ["transit"] * 200, actions=(), coupled=False))
    quaternion = numbers(moves(programs(plan, job), "T_ROB1"), 1)
    assert len(quaternion) == 199
    assert (np.sum(quaternion[1:] * quaternion[:-1], axis=1) > 0.99).all()
    assert quaternion[:, 0].min() < -0.3 < 0.3 < quaternion[:, 0].max()


def test_one_arm_alone_needs_no_multimove():
    job = synthetic.problem(("left",))
    q = {"left": synthetic.sweep(12)}
    labels = ["approach"] * 4 + ["cut/path"] * 8
    plan = synthetic.plan(synthetic.operation(job, q, labels, actions=(), coupled=False))
    files = programs(plan, job)
    text = "\n".join(files.values())
    for word in ("Sync", "sync", "\\ID", "all_tasks", "doWirePower", "AllMoveTasks"):
        assert word not in text
    assert {name.split("/")[0] for name in files} == {"T_ROB1"}
    assert read_task(modules(files, "T_ROB1")).faults == ()
    assert "Stop;" in text


def test_a_pair_that_does_not_move_is_dropped_and_one_that_half_moves_is_kept():
    job = synthetic.problem()
    left, right = synthetic.sweep(6), synthetic.sweep(6, 0.2)
    left[2:] = np.concatenate([left[1:2], left[2:5]])  # target 2 repeats target 1
    right[2:] = np.concatenate([right[1:2], right[2:5]])
    right[4] = right[3]  # the right arm waits at target 4
    operation = synthetic.operation(
        job, {"left": left, "right": right}, ["transit"] * 6, stop=(2,), actions=()
    )
    files = programs(synthetic.plan(operation), job)
    rows = moves(files, "T_ROB1"), moves(files, "T_ROB2")
    assert len(rows[0]) == len(rows[1]) == 4
    assert rows[0][0][6] == rows[1][0][6] == "fine"  # the stop of the dropped target
    assert rows[1][2][0] == rows[1][1][0] and rows[0][2][0] != rows[0][1][0]


def test_speeds_are_not_below_what_distance_and_time_give(small):
    for task in ("T_ROB1", "T_ROB2"):
        rows = moves(small[2], task)
        distance = np.linalg.norm(np.diff(numbers(rows, 0), axis=0), axis=1)
        speed = distance / np.array([float(row[5]) for row in rows[1:]])
        given = np.array([float(row[4]) for row in rows[1:]])
        assert (given >= speed).all() and (given <= np.maximum(5.0, 2.0 * speed)).all()


def test_rounded_times_do_not_drift():
    job = synthetic.problem(("left",))
    operation = synthetic.operation(
        job, {"left": synthetic.sweep(400)}, ["cut/a"] * 400, actions=(), coupled=False
    )
    clock = np.concatenate([[0.0], np.cumsum(np.random.default_rng(3).uniform(0.01, 0.02, 399))])
    files = programs(synthetic.plan(dataclasses.replace(operation, time=clock)), job)
    total = np.cumsum([float(row[5]) for row in moves(files, "T_ROB1")])
    assert np.abs(total - clock[1:]).max() < 1.1e-5


def test_a_segment_that_comes_again_is_numbered_and_operations_follow_each_other():
    job = synthetic.problem()
    labels = ["transit"] * 3 + ["cut/a"] * 3 + ["transit"] * 3
    q = {"left": synthetic.sweep(9), "right": synthetic.sweep(9, 0.2)}
    alone = {"right": synthetic.sweep(5)}
    plan = synthetic.plan(
        synthetic.operation(job, q, labels, name="first"),
        synthetic.operation(job, alone, ["cut/a"] * 5, name="second", actions=(), coupled=False),
    )
    files = programs(plan, job)
    names = re.findall(r"^  PROC (\w+)\(\)", "\n".join(modules(files, "T_ROB2").values()), re.MULTILINE)
    names = [name for name in names if name not in ("check_cell", "check_stop")]
    assert names == ["main", "operation_1", "operation_2", "transit", "cut_a", "transit__2", "cut_a__2"]
    left = re.findall(r"PROC (\w+)\(\)", "\n".join(modules(files, "T_ROB1").values()))
    assert "cut_a__2" not in left
    assert [row[3] for row in moves(files, "T_ROB2")] == [str(i) for i in range(1, 9)] + [None] * 4
    for task in ("T_ROB1", "T_ROB2"):
        assert read_task(modules(files, task)).faults == ()
    lines = flat(files, "T_ROB2")
    assert sum("j_home" in line for line in lines) == 3  # to home, back from the first, back from the second


def test_work_held_by_the_other_arm_rides_on_its_flange():
    job = synthetic.problem()
    q = {"left": synthetic.sweep(4), "right": synthetic.sweep(4, 0.2)}
    operation = synthetic.operation(job, q, ["cut/a"] * 4, actions=(), coupled=False)
    targets = dataclasses.replace(operation.targets, frame={"left": "held:right", "right": "world"})
    files = programs(synthetic.plan(dataclasses.replace(operation, targets=targets)), job)
    # on the user frame of the unit, its flange, stands the right arm's tool frame: 150 mm out, turned by 90
    # degrees about y
    flange = "[[0.0000,0.0000,0.0000],[1.00000000,0.00000000,0.00000000,0.00000000]]"
    start = f'w_held:=[FALSE,FALSE,"ROB_2",{flange},[[0.0000,0.0000,150.0000],[0.70710678,'
    assert start in files["T_ROB1/TandemData_1.mod"]
    assert "wobjdata" not in files["T_ROB2/TandemData_2.mod"]
    assert "\\WObj:=wobj0;" in files["T_ROB2/TandemCut1_2.mod"]


def test_lines_stay_short_at_the_largest_numbers():
    job = synthetic.problem(max_moves=100000, max_bytes=10**8)
    arms = [
        dataclasses.replace(arm, tool=dataclasses.replace(arm.tool, name="A very long name of a tool"))
        for arm in job.cell.arms
    ]
    job = dataclasses.replace(job, cell=dataclasses.replace(job.cell, arms=tuple(arms)))
    count = 12000
    q = {"left": synthetic.sweep(count, 3.0), "right": synthetic.sweep(count, 3.0)}
    operation = synthetic.operation(job, q, ["cut/a"] * count, actions=(), step=10.0)
    turn = np.eye(4)
    turn[:3, :3] = from_quaternion(np.array([-0.1, -0.5, -0.6, -0.6]))
    turn[:3, 3] = [-9.0, -9.0, -9.0]
    pose = {arm: turn @ value for arm, value in operation.targets.pose.items()}
    operation = dataclasses.replace(operation, targets=dataclasses.replace(operation.targets, pose=pose))
    files = programs(synthetic.plan(operation), job)
    # a module whose longest line has 206 characters is known to load
    assert max(len(line) for text in files.values() for line in text.split("\n")) <= 206


def test_an_action_within_the_work_parts_the_block():
    plan, problem = synthetic.small(
        actions=(*synthetic.ACTIONS, TargetAction(2, "message", text="Half way."))
    )
    operation = plan.operations[0]
    stop = operation.targets.stop.copy()
    stop[2] = True
    operation = dataclasses.replace(operation, targets=dataclasses.replace(operation.targets, stop=stop))
    files = programs(dataclasses.replace(plan, operations=(operation,)), problem)
    left = flat(files, "T_ROB1")
    at = left.index('TPWrite "Half way.";')
    assert left[at - 1].startswith("SyncMoveOff") and ",fine," in left[at - 2] and "\\ID:=2," in left[at - 2]
    assert left[at + 1].startswith("WaitSyncTask") and left[at + 2].startswith("SyncMoveOn")
    assert "\\ID:=3," in left[at + 3]


def test_an_operation_may_be_a_single_place():
    job = synthetic.problem()
    q = {"left": synthetic.sweep(3)[:1], "right": synthetic.sweep(3)[:1]}
    files = programs(synthetic.plan(synthetic.operation(job, q, ["mount"])), job)
    assert not any("Cut" in name for name in files)
    assert "SyncMove" not in "\n".join(flat(files, "T_ROB1"))
    assert "SetDO doWirePower,1;" in flat(files, "T_ROB1")
    for task in ("T_ROB1", "T_ROB2"):
        assert read_task(modules(files, task)).faults == ()


def test_persistent_data_of_one_task_cannot_be_kept_from_an_older_program(small):
    for text in modules(small[2], "T_ROB1").values():
        shared = re.findall(r"^ +PERS (\w+) (\w+)", text, re.MULTILINE)
        assert all(kind == "tasks" for kind, _ in shared)
