"""Jobs of a GoFa, whose wrist is offset: poses, and curves milled into a panel.

They are written in RAPID without configuration data and are proven from their text. Wrong texts are not
proven.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.catalogue.robots import data_dir
from planner.geometry.arrays import from_rpy, to_quaternion
from planner.issues import TandemError
from planner.processes import registry
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.prove import prove
from tests import small_problem

GOFA = "crb15000_5_95"
CONTROLLER = {"tasks": ["T_ROB1"], "units": ["ROB_1"]}
ROBTARGET = re.compile(r"MoveL \[\[([-\d.,]+)\],\[[-\d.,]+\],\[([-\d,]+)\]")


DOWN = tuple(to_quaternion(from_rpy([0.0, 0.0, 0.0], [np.pi, 0.0, np.pi / 2])[:3, :3]))


def poses(folder, robot=GOFA, points=tuple((550, v, 350, *DOWN) for v in range(-60, 61, 20))):
    """Poses, a row of seven with the tool down unless stated, which may not spin."""
    rows = [",".join(f"{v:.17g}" for v in (*point, 40)) for point in points]
    source = yaml.safe_load(small_problem.PROBLEM)
    source["stock"]["place"] = {"xyz_mm": [550, 0, 0]}
    arm = source["cell"]["arms"][0]
    arm |= {"robot": robot, "tool": {
        "kind": "plain", "tcp": {"xyz_mm": [0, 0, 150]}, "mass_kg": 1.0, "cog_mm": [0, 0, 50],
    }}  # fmt: skip
    arm.pop("home_deg")
    source["cell"]["controller"] = CONTROLLER
    small_problem.write(folder, yaml.safe_dump(source), "\n".join([small_problem.COLUMNS, *rows]) + "\n")
    return pipeline.load(folder / "problem.yaml")


def replace_once(programs, old, new, count=1):
    """Return the programs with ``old`` replaced in the first file that has it."""
    name = next(n for n, text in programs.items() if re.search(old, text))
    return {**programs, name: re.sub(old, new, programs[name], count=count)}


def codes(problem, outcome, programs):
    claims = {op.name: op.targets.claims for op in outcome.plan.operations}
    proof = prove(problem, claims, programs)
    assert not proof.ok
    return {issue.code for issue in proof.issues}


def test_poses_are_passed_without_configuration_data_and_wrong_texts_are_refused(tmp_path):
    problem = poses(tmp_path)
    plan_outcome = pipeline.plan(problem)
    assert plan_outcome.proof.ok, [str(issue) for issue in plan_outcome.proof.issues]
    texts = "".join(plan_outcome.programs.values())
    rows = ROBTARGET.findall(texts)
    assert len(rows) >= 6 and {conf for _, conf in rows} == {"0,0,0,0"}
    assert "ConfL\\Off;" in texts and "ConfL\\On;" not in texts and "! Arm with an offset wrist" in texts
    (q,) = plan_outcome.plan.operations[0].q.values()
    assert np.abs(np.diff(q, axis=0)).max() < 0.3
    assert "verify.move_kinds" in codes(
        problem, plan_outcome, replace_once(plan_outcome.programs, r"ConfL\\Off;", r"ConfL\\On;")
    )
    assert codes(
        problem, plan_outcome, replace_once(plan_outcome.programs, r"MoveL \[\[550\.0000", "MoveL [[560.0000")
    )
    far = replace_once(plan_outcome.programs, r"MoveL \[\[550\.0000", "MoveL [[1550.0000")
    assert "verify.reach" in codes(problem, plan_outcome, far)
    start = re.search(r"j_1_start:=\[\[([-\d.]+),", texts)
    turned = replace_once(
        plan_outcome.programs, re.escape(start[0]), f"j_1_start:=[[{float(start[1]) + 20.0},"
    )
    assert codes(problem, plan_outcome, turned)
    for item in ("1,0,0,0", "0,0,0,1"):
        named = replace_once(
            plan_outcome.programs, r"(MoveL \[\[[^\]]+\],\[[^\]]+\],)\[0,0,0,0\]", rf"\1[{item}]"
        )
        assert codes(problem, plan_outcome, named) == {"verify.confdata"}


SPARSE = (
    (526.1429, -137.6474, 500.7169, 0.01610176, -0.82934803, -0.5135055, -0.21962385),
    (550.3353, -229.7921, 644.9436, 0.21894320, 0.81221578, 0.35223492, 0.41024379),
    (555.1492, -341.4526, 751.0543, 0.20813070, 0.93392842, 0.29028031, -0.01402332),
    (561.8607, -379.5330, 755.8995, 0.18793519, 0.97937397, 0.03065774, -0.06758036),
)


def test_joints_slow_down_to_the_stop_behind_a_straight_move(tmp_path):
    """Few poses with large rotations between them, each a stop.

    Between stops joints follow one cubic, which uses 0.9 of their limits at its ends. The last one ends
    between two samples, where the motion home continues.
    """
    plan_outcome = pipeline.plan(poses(tmp_path, points=SPARSE))
    assert plan_outcome.proof.ok, [str(issue) for issue in plan_outcome.proof.issues]
    (rule,) = [rule for rule in plan_outcome.proof.rules if rule.code == "verify.joint_acceleration"]
    assert 60.0 < rule.worst < 91.0
    motion = Context(
        plan_outcome.problem, registry.claims(plan_outcome.problem), plan_outcome.programs
    ).motion
    goes_on = motion.tcp["left"].position[motion.node_sample[-2] + 1]  # less than a sample behind the stop
    assert np.linalg.norm(goes_on - 1e-3 * np.array(SPARSE[-1][:3])) < 2e-7


@pytest.mark.parametrize(
    ("point", "words"),
    [
        (
            (-444.2, 535.0, -296.7, 0.624526, 0.443219, -0.102714, -0.634802),
            "its wrist cannot orient the tool as required",
        ),
        (
            (690.055, 260.616, -116.723, 0.332537, 0.646293, -0.506274, -0.464124),
            "its wrist would have to be 25 mm outside its reach",
        ),
    ],
)
def test_why_a_pose_is_out_of_reach_is_told(tmp_path, point, words):
    """Neither pose has a solution, though another direction there has some: of the first where axes 4 and 5
    meet is in reach, of the second it is 25 mm beyond, wherever axis 6 turns it."""
    problem = poses(tmp_path, points=[point, point])
    (issue,) = [i for i in pipeline.check(problem) if i.code == "motion.no_reach"]
    assert words in issue.message and issue.value == (
        None if "cannot" in words else pytest.approx(25.13, abs=0.1)
    )


def test_a_forged_length_of_the_wrist_is_found_in_the_urdf(tmp_path):
    data = poses(tmp_path).cell.arms[0].data
    assert arm_model.compare_with_catalogue(arm_model.robot_machine(data)) == []
    for field, words in (("a3", "axis 6 is"), ("c4", "the tip"), ("c2", "axis 3 is"), ("b3", "axis 6 is")):
        form = dataclasses.replace(data.form, **{field: getattr(data.form, field) + 1e-4})
        machine = arm_model.robot_machine(dataclasses.replace(data, form=form))
        assert any(words in line for line in arm_model.compare_with_catalogue(machine)), field


@pytest.mark.long
def test_curves_milled_into_a_panel_are_proven(tmp_path):
    source = yaml.safe_load((data_dir("problems") / "engrave" / "problem.yaml").read_text("utf-8"))
    cell = yaml.safe_load((data_dir("problems") / "cells" / "kr60_engrave.yaml").read_text("utf-8"))
    arm = cell["arms"][0]
    arm["robot"] = GOFA
    arm.pop("home_deg")
    arm["tool"] |= {"spindle_diameter_mm": 60, "spindle_length_mm": 150}
    source["cell"] = cell | {"controller": CONTROLLER}
    source["stock"]["place"]["xyz_mm"] = [550, 0, 250]
    source["stock"]["support"][0] = {
        "kind": "box", "size_mm": [260, 180, 230], "pose": {"xyz_mm": [0, 0, -115]},
    }  # fmt: skip
    del source["operations"][0]["cuts"][0]
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(source), "utf-8")
    plan_outcome = pipeline.plan(pipeline.load(tmp_path / "problem.yaml"))
    assert plan_outcome.proof.ok and plan_outcome.proof.issues == ()
    assert plan_outcome.plan.operations[0].targets.count > 100


def test_no_krl_is_written_for_such_an_arm(tmp_path):
    """Status names postures by a spherical wrist."""
    (tmp_path / "arm.urdf").write_text((data_dir("urdf") / f"{GOFA}.urdf").read_text("utf-8"), "utf-8")
    stated = {"urdf": "arm.urdf", "name": "mine", "payload_kg": 5}
    with pytest.raises(TandemError, match="write ur or generic"):
        poses(tmp_path, stated | {"family": "kuka"})
    robot = poses(tmp_path, stated | {"family": "abb"}).cell.arms[0].data
    assert robot.has_unnamed_postures and robot.form.a3 == pytest.approx(-0.08)
    assert np.rad2deg(robot.home) == pytest.approx([0, 0, 0, 0, 90, 0])
