"""Jobs of a UR10e from its URDF: poses, a wing cut with a straight hot wire, curves milled into a panel.

Paths are compared with the maker's table, programs are proven, and their figures are read again here.
"""

from __future__ import annotations

import dataclasses
import re
import shutil

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.catalogue.robots import data_dir
from planner.geometry.arrays import exp_rotation, from_rpy, to_quaternion
from planner.issues import TandemError, has_errors
from planner.languages.writing import write
from planner.motion import solve
from planner.motion.planning_scene import FULL_TURN_RAD, Scene
from planner.processes import registry
from planner.report import setup_sheet
from tests import small_problem, urdf_text
from tests.proof import planner_jobs
from tests.refusals import change

ARM = {"urdf": "ur10e.urdf", "name": "ur10e", "family": "ur", "payload_kg": 12.5}
PROBLEMS = data_dir("problems")


def write_job(folder, source):
    (folder / "ur10e.urdf").write_text(urdf_text.ur10e(), "utf-8")
    arm = source["cell"]["arms"][0]
    arm["robot"] = ARM
    arm.pop("home_deg", None)
    (folder / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    return pipeline.load(folder / "problem.yaml")


def bundled_problem(name, cell):
    source = yaml.safe_load((PROBLEMS / name / "problem.yaml").read_text("utf-8"))
    source["cell"] = yaml.safe_load((PROBLEMS / "cells" / cell).read_text("utf-8"))
    source["cell"]["controller"] = {"io": {"robot": {"doWirePower": 3, "doSpindle": 8}}}
    return source


def wing():
    source = bundled_problem("wing", "irb4600_bow.yaml")
    source["cell"]["arms"][0]["base"] = {"xyz_mm": [0, 0, 600]}
    return source


def panel():
    source = bundled_problem("engrave", "kr60_engrave.yaml")
    source["stock"]["place"]["xyz_mm"] = [800, 0, 300]
    source["stock"]["support"][0] = {
        "kind": "box", "size_mm": [260, 180, 280], "pose": {"xyz_mm": [0, 0, -140]},
    }  # fmt: skip
    del source["operations"][0]["cuts"][0]
    return source


def poses(turns=0.0, count=41):
    """A row of poses with the tool down, which turns about its axis on the way, and may not spin freely."""
    rows = [small_problem.COLUMNS]
    down = np.diag([1.0, -1.0, -1.0])
    for fraction in np.linspace(-0.5, 0.5, count):
        w, x, y, z = to_quaternion(
            down @ exp_rotation(np.array([0.0, 0.0, turns * fraction * FULL_TURN_RAD]))
        )
        rows.append(f"650,{200 * fraction:.9g},300,{w:.17g},{x:.17g},{y:.17g},{z:.17g},20")
    source = yaml.safe_load(small_problem.PROBLEM)
    source["stock"]["place"] = {"xyz_mm": [650, 0, 0]}
    source["cell"]["arms"][0]["tool"] = {
        "kind": "plain", "tcp": {"xyz_mm": [0, 0, 150]}, "mass_kg": 1.0, "cog_mm": [0, 0, 50],
    }  # fmt: skip
    return source, "\n".join(rows) + "\n"


def plan_job(problem, plan=None):
    """The one operation of a plan, its TCP poses as targets and in the world by the maker's table."""
    plan = plan or solve.solve(problem, [job.targets() for job in registry.jobs(problem)])
    (own,) = plan.operations
    (arm,) = own.q
    scene = Scene.of(problem.cell, (arm,), plan.stock_poses[0], problem.settings)
    expected = scene.tcp_poses(own.targets, own.values, np.arange(own.targets.count))[arm]
    one = problem.cell.arm(arm)
    return own, expected, one.base @ urdf_text.ur10e_flange(own.q[arm]) @ one.tool.tcp


def require_proven(problem, plan=None):
    own, expected, got = plan_job(problem, plan)
    (q,) = own.q.values()
    assert np.abs(got - expected).max() < 1e-9
    assert np.abs(q).max() < FULL_TURN_RAD
    assert (np.diff(own.time) > 0.0).all()
    assert (np.abs(np.diff(q, axis=0)) <= 1.001 * np.diff(own.time)[:, None] * urdf_text.UR10E_SPEED).all()
    return own, q


def test_a_tool_that_turns_one_and_a_half_times_winds_axis_6_from_end_to_end(tmp_path):
    """720 degrees are there, and no other turn of axis 6 than the one that begins at -270 leads through."""
    source, table = poses(1.5)
    small_problem.write(tmp_path, table=table)
    _, q = require_proven(write_job(tmp_path, source))
    own_turn = q[:, 5] - q[:, 0]  # axis 1 turns the hand by what it goes aside
    assert np.ptp(own_turn) == pytest.approx(1.5 * FULL_TURN_RAD, abs=0.01)
    source, table = poses(2.2)
    (tmp_path / "targets.csv").write_text(table)
    with pytest.raises(TandemError) as caught:
        plan_job(write_job(tmp_path, source))
    assert {issue.code for issue in caught.value.issues} <= {"motion.no_path", "motion.joint_limit"}


POSE = re.compile(r"^movel\(pose_trans\(b_stock,p\[(.*)\]\),t=([0-9.]+),r=([0-9.]+)\)$", re.MULTILINE)


@pytest.mark.parametrize("source", [wing, panel])
def test_a_wing_and_a_panel_are_cut_by_programs_that_are_proven(tmp_path, source):
    """Targets, times and stops of the text are those of the plan; the proof follows from the text alone."""
    problem = write_job(tmp_path, source())
    outcome = pipeline.plan(problem)
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    own, _ = require_proven(problem, outcome.plan)
    assert own.targets.count > 100 and own.metrics["clearance_mm"] >= 8.0
    assert outcome.proof.issues == ()
    ((path, text),) = outcome.programs.items()
    assert path.startswith("robot/") and path.endswith(".script")
    rows = [[float(v) for v in (*found[1].split(","), *found.groups()[1:])] for found in _moves(text)]
    rows = np.array(rows)
    expected = own.targets.poses(own.values)["robot"][1:]
    assert np.abs(rows[:, :3] - expected[:, :3, 3]).max() < 1e-6
    assert np.abs(exp_rotation(rows[:, 3:6]) - expected[:, :3, :3]).max() < 1e-6
    assert abs(rows[:, 6].sum() - (own.time[-1] - own.time[0])) < 1e-3
    assert ((rows[:, 7] == 0.0) == own.targets.stop[1:]).all()
    way = np.linalg.norm(np.diff(expected[:, :3, 3], axis=0), axis=1)
    assert (rows[:-1, 7] + rows[1:, 7] < way).all()  # no two blends meet


@pytest.mark.long
def test_a_tool_that_turns_about_its_tip_stops_there(tmp_path):
    """Corners of the bundled G-code turn the cutter about its tip, where UR has no blend."""
    folder = tmp_path / "gcode"
    shutil.copytree(PROBLEMS / "gcode", folder)
    source = bundled_problem("gcode", "kr60_mill.yaml")
    source["stock"] |= {"place": {"xyz_mm": [750, 0, 300], "rpy_deg": [0, 0, 90]}, "support": "pedestal"}
    outcome = pipeline.plan(write_job(folder, source))
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    (own,), (text,) = outcome.plan.operations, outcome.programs.values()
    stops = sum(found[3] == "0.0" for found in _moves(text))
    assert stops > own.targets.stop.sum() + 10


def _moves(text):
    return POSE.finditer(text.replace("\r\n", "\n"))


def test_a_base_link_that_is_turned_as_in_urs_files_gives_the_same_program(tmp_path):
    """ROS has base_link turned by 180 degrees about z against the base of the controller."""
    source, table = poses()
    small_problem.write(tmp_path, table=table)
    texts = []
    for degrees in (0, 180):
        turn = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.deg2rad(degrees)])
        write_job(tmp_path, source)
        (tmp_path / "ur10e.urdf").write_text(urdf_text.ur10e(turn), "utf-8")
        one = change(source, "cell.arms.0.base", {"rpy_deg": [0, 0, degrees]})
        (tmp_path / "problem.yaml").write_text(yaml.safe_dump(one), "utf-8")
        problem = pipeline.load(tmp_path / "problem.yaml")
        outcome = pipeline.plan(problem)
        assert outcome.proof.ok
        (text,) = outcome.programs.values()
        rows = dict(row.split(" = ") for row in text.splitlines() if " = " in row)
        start = np.array([float(v) for v in rows["x_1_start_1"][1:-1].split(",")])
        tcp = urdf_text.ur10e_flange(start[None])[0] @ problem.cell.arms[0].tool.tcp
        np.testing.assert_allclose(tcp[:3, 3], [0.65, -0.1, 0.3], atol=1e-6)
        look = next(row for row in text.splitlines() if row.startswith("if "))
        texts.append([look, *(rows[name] for name in ("base_frame", "x_home", "t_plain", "b_world"))])
    assert texts[0] == texts[1]


def test_an_arm_without_a_language_is_refused_and_check_tells_of_its_reach_all_the_same(tmp_path):
    source, table = poses()
    small_problem.write(tmp_path, table=table)
    write_job(tmp_path, source)
    source = change(source, "cell.arms.0.robot", ARM | {"family": "generic"})
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    problem = pipeline.load(tmp_path / "problem.yaml")
    with pytest.raises(TandemError) as caught:
        pipeline.plan(problem)
    (issue,) = caught.value.issues
    assert (issue.code, issue.arm) == ("post.language", "left")
    assert "family generic" in issue.message and "ABB (RAPID)" in issue.message
    assert [item.code for item in pipeline.check(problem) if has_errors([item])] == ["post.language"]
    (tmp_path / "problem.yaml").write_text(
        yaml.safe_dump(change(source, "cell.arms.0.robot", "irb1200_7_70")), "utf-8"
    )
    assert not has_errors(pipeline.check(pipeline.load(tmp_path / "problem.yaml")))
    (tmp_path / "targets.csv").write_text(table.replace("\n650,", "\n1650,"))
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    problem = pipeline.load(tmp_path / "problem.yaml")
    codes = {item.code for item in pipeline.check(problem, advise=False) if has_errors([item])}
    assert codes == {"post.language", "motion.no_reach"}


LINES = ("doPartner", "diPartner", "doRunning", "diPartnerRunning")


def wing_and_poses(folder):
    """The wing cut by one UR10e, then poses that another one passes, behind it and away from it."""
    source = wing()
    base = {"xyz_mm": [0, 2600, 600], "rpy_deg": [0, 0, 90]}
    home = [180.0, -60.0, 100.0, -130.0, -90.0, 0.0]
    tool = {"kind": "plain", "tcp": {"xyz_mm": [0, 0, 150]}, "mass_kg": 1.0, "cog_mm": [0, 0, 50]}
    foot, tcp = from_rpy([0.0, 2.6, 0.6], [0.0, 0.0, np.pi / 2]), from_rpy([0.0, 0.0, 0.15], [0.0, 0.0, 0.0])
    stands = foot @ urdf_text.ur10e_flange(np.deg2rad([home]))[0] @ tcp
    rows = [small_problem.COLUMNS.replace("left.", "helper.")]
    for k in range(9):
        x, y, z = 1e3 * stands[:3, 3] + [10.0 * k, 0.0, 5.0 * k]
        w, a, b, c = to_quaternion(stands[:3, :3])
        rows.append(f"{x:.6f},{y:.6f},{z:.6f},{w:.17g},{a:.17g},{b:.17g},{c:.17g},20")
    (folder / "targets.csv").write_text("\n".join(rows) + "\n")
    source["cell"]["arms"].append(
        {"name": "helper", "robot": ARM, "base": base, "tool": tool, "home_deg": home}
    )
    source["operations"].append(
        {"name": "poses", "process": "targets", "arms": ["helper"], "file": "targets.csv", "frame": "world"}
    )
    io = {"robot": dict(zip(LINES, (0, 0, 1, 1), strict=True)) | {"doWirePower": 8}}
    io["helper"] = dict(zip(LINES, (2, 2, 3, 3), strict=True))
    source["cell"]["controller"] = {"sync": "handshake", "io": io}
    return source


def test_two_ur_controllers_share_a_job_and_its_programs_are_proven(tmp_path):
    """One cuts with a hot wire while the other one waits, then the other way round."""
    problem = write_job(tmp_path, wing_and_poses(tmp_path))
    outcome = pipeline.plan(problem)
    assert outcome.proof.ok, [str(issue) for issue in outcome.proof.issues]
    assert outcome.proof.issues == ()
    assert sorted(outcome.programs) == ["helper/wing.script", "robot/wing.script"]
    assert "meetings" in outcome.proof.rule("verify.handshake").where
    robot, helper = (outcome.programs[f"{arm}/wing.script"].split("\r\n") for arm in ("robot", "helper"))
    power = [i for i, row in enumerate(robot) if "# doWirePower" in row and "True" in row]
    watch = [i for i, row in enumerate(robot) if row.startswith(("watching", "kill"))]
    for i in power:  # the wire is hot only while the other program is watched
        assert robot[max(k for k in watch if k < i)].startswith("watching")
    own = robot[robot.index("thread watch_partner():") :]
    assert own[4:6] == [
        "set_standard_digital_out(1,False) # doRunning",
        "set_configurable_digital_out(0,False) # doWirePower",
    ]
    assert not any("doWirePower" in row for row in helper)
    sheet = str(setup_sheet.controller_checks(problem, outcome.plan))
    for text in (
        "doRunning is digital output 1",
        "doRunning is digital output 3",
        "low when the program does not run; no other action",
        "running wire: doRunning of robot to diPartnerRunning of helper",
        "the power of doWirePower falls with the wire that ends at diPartnerRunning",
        "both programs have ended: start both from their beginning",
        "its program ends; otherwise this controller restores outputs after a pause",
        "off; the program would restart at its end",
    ):
        assert text in sheet, text


def test_two_ur_controllers_move_poses_together(tmp_path):
    outcome = pipeline.plan(pipeline.load(planner_jobs.JOBS["handshake_ur"](tmp_path)))
    assert outcome.proof.ok and outcome.proof.issues == ()
    assert any(issue.code == "post.handshake_drift" for issue in outcome.issues)
    moves = [text.count("\nmovel(") for text in outcome.programs.values()]
    assert moves[0] == moves[1] > 5


def test_an_elastic_wire_between_two_ur_arms_is_refused_and_so_are_exchangeable_numbers(tmp_path):
    """No clock synchronises them, so one may be a step ahead; and only numbers distinguish them."""
    problem = pipeline.load(planner_jobs.JOBS["handshake_ur"](tmp_path))
    (targets,) = (job.targets() for job in registry.jobs(problem))
    joined = dataclasses.replace(targets, coupled=True)
    assert [issue.code for issue in write.refusals(problem, [joined])] == ["post.handshake_process"]
    assert write.refusals(problem, [targets]) == ()
    source = yaml.safe_load((tmp_path / "problem.yaml").read_text("utf-8"))
    source["cell"]["controller"]["io"]["right"] |= {"doRunning": 1, "doPartner": 3}
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    result = write.refusals(pipeline.load(tmp_path / "problem.yaml"), [targets])
    assert [(issue.code, issue.arm) for issue in result] == [
        ("post.signal", "left"),
        ("post.signal", "right"),
    ]
    assert "programs copied to each other's controller would run there" in result[0].message
    del source["cell"]["controller"]["sync"]
    source["cell"]["controller"] |= {"tasks": ["T_ROB1", "T_ROB2"], "units": ["ROB_1", "ROB_2"], "io": {}}
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    (issue,) = write.refusals(pipeline.load(tmp_path / "problem.yaml"), [targets])
    assert issue.code == "post.controller" and "sync: handshake" in issue.hint


def test_an_arm_that_stands_by_is_no_hindrance_to_the_others(tmp_path):
    """Its form is held against its URDF, and what works keeps off it."""
    source = yaml.safe_load(small_problem.PROBLEM)
    base = {"xyz_mm": [450, 1300, 0]}
    tool = {"kind": "plain", "tcp": {"xyz_mm": [0, 0, 150]}, "mass_kg": 1.0, "cog_mm": [0, 0, 50]}
    source["cell"]["arms"].append({"name": "right", "robot": ARM, "base": base, "tool": tool})
    (tmp_path / "ur10e.urdf").write_text(urdf_text.ur10e(), "utf-8")
    small_problem.write(tmp_path, yaml.safe_dump(source))
    outcome = pipeline.plan(pipeline.load(tmp_path / "problem.yaml"))
    assert outcome.proof.issues == ()
    passed = {row.code for row in outcome.proof.rules if row.passed}
    assert {"verify.robot_model", "verify.clearance"} <= passed
