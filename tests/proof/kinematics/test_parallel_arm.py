"""The form of an arm with three parallel axes against its URDF: an error in any parameter is detected."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.robots import RobotFile
from planner.geometry.arrays import from_rpy
from planner.issues import TandemError
from planner.motion import three_parallel
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.reading.arm_identification import fit_arm
from planner.reading.urdf import read_chain
from tests import urdf_text

ENDS = (from_rpy([0.1, -0.2, 0.3], [0.4, np.pi, 0.0]), from_rpy([0.01, 0.02, -0.05], [0.0, 1.2, 0.3]))


def robot_of(text):
    chain = read_chain(text, "base_link", None)
    file = RobotFile(text, "base_link", "tool0", chain.zero, chain.axis, (), chain.joints)
    return dataclasses.replace(urdf_text.UR10E, form=fit_arm(chain).form, file=file)


def model_differences(robot, **changes):
    wrong = dataclasses.replace(robot, form=dataclasses.replace(robot.form, **changes))
    return arm_model.compare_with_catalogue(arm_model.robot_machine(wrong))


@pytest.mark.parametrize("ends", [(), ENDS])
def test_what_was_found_is_the_urdfs(ends):
    robot = robot_of(urdf_text.ur10e(*ends))
    machine = arm_model.robot_machine(robot)
    assert arm_model.compare_with_catalogue(machine) == []
    with pytest.raises(TandemError, match="no spherical wrist"):
        machine.shape  # noqa: B018


@pytest.mark.parametrize("length", ["b", "c1", "c2", "c3", "c4", "c5"])
def test_a_length_that_is_off_by_a_micrometre_is_told(length):
    robot = robot_of(urdf_text.ur10e(*ENDS))
    reported = model_differences(robot, **{length: getattr(robot.form, length) + 1e-6})
    assert any("0.001000 mm" in line or "tip" in line for line in reported)


@pytest.mark.parametrize("joint", range(6))
def test_an_offset_and_a_sign_that_are_wrong_are_told(joint):
    robot = robot_of(urdf_text.ur10e(*ENDS))
    turned = np.where(np.arange(6) == joint, 1e-6, 0.0)
    assert model_differences(robot, offsets=robot.form.offsets + turned)
    reported = model_differences(robot, signs=robot.form.signs * np.where(turned > 0.0, -1.0, 1.0))
    assert any(f"axis {joint + 1} is 180.000000 deg" in line for line in reported)


def test_ends_limits_and_speeds_that_are_others_are_told():
    robot = robot_of(urdf_text.ur10e(*ENDS))
    moved = from_rpy([1e-6, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert model_differences(robot, left=robot.form.left @ moved)
    assert model_differences(robot, right=robot.form.right @ moved)
    faster = dataclasses.replace(robot, velocity=robot.velocity * 2.0)
    assert len(arm_model.compare_with_catalogue(arm_model.robot_machine(faster))) == 6


HALF_TURN = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.pi])


@pytest.mark.parametrize("base", [None, HALF_TURN, from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, 0.4])])
def test_joints_are_those_of_the_makers_table_in_the_base_of_its_controller(base):
    """Whichever way base_link is turned against the controller's base, as ROS has it by 180 degrees."""
    machine = arm_model.robot_machine(robot_of(urdf_text.ur10e(base)))
    np.testing.assert_allclose(
        np.linalg.inv(machine.table.base), np.eye(4) if base is None else base, atol=1e-12
    )
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (2000, 6))
    expected = urdf_text.ur10e_flange(q)
    np.testing.assert_allclose(machine.table.flange(q), expected, atol=1e-12)
    np.testing.assert_allclose(machine.table.base @ expected, machine.flange(q), atol=1e-12)


def test_all_postures_of_a_pose_are_found_as_the_planner_has_them_by_other_formulas():
    machine = arm_model.robot_machine(robot_of(urdf_text.ur10e()))
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (500, 6))
    flange = machine.flange(q)
    theirs = three_parallel.inverse_kinematics(urdf_text.UR10E_FORM, flange, range(8))
    ours = np.stack([inverse_kinematics.solve(machine, flange, np.full(500, b)) for b in range(8)], axis=1)
    assert (np.isfinite(ours).all(axis=2).sum(axis=1) == np.isfinite(theirs).all(axis=2).sum(axis=1)).all()
    for mine, others in zip(ours, theirs, strict=True):
        deviation = np.abs((mine[:, None] - others[None] + np.pi) % (2.0 * np.pi) - np.pi).max(axis=2)
        found = np.isfinite(mine).all(axis=1)
        assert np.where(np.isfinite(deviation), deviation, np.inf).min(axis=1)[found].max() < 1e-8
    own = inverse_kinematics.solve(machine, flange, inverse_kinematics.branch_of(machine, q))
    assert np.abs(own - q).max() < 1e-7
    measures = np.minimum.reduce(three_parallel.singularities(urdf_text.UR10E_FORM, q))
    np.testing.assert_allclose(inverse_kinematics.singularity_distance(machine, q), measures, atol=1e-12)


def test_out_of_reach_and_beside_axis_1_there_is_none():
    machine = arm_model.robot_machine(robot_of(urdf_text.ur10e()))
    far = from_rpy([1.5, 0.0, 0.3], [np.pi, 0.0, 0.0])
    near = from_rpy([0.05, 0.0, 0.6], [np.pi, 0.0, 0.0])
    for pose in (far, near):
        assert np.isnan(inverse_kinematics.solve(machine, np.tile(pose, (8, 1, 1)), np.arange(8))).all()


@pytest.mark.parametrize(
    "text",
    [
        urdf_text.ur10e(*ENDS),
        urdf_text.ur10e(None, from_rpy([0.0, 0.0, 0.0], [0.0, np.pi / 2.0, 0.0])),
        urdf_text.ur10e().replace('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0.0 0.0 -1.0"/>', 1),
    ],
)
def test_an_arm_that_ur_counts_otherwise_has_no_table(text):
    """Another tip, or an axis that turns the other way."""
    with pytest.raises(TandemError, match="UR's convention"):
        arm_model.robot_machine(robot_of(text)).table  # noqa: B018


def test_paths_go_on_over_whole_turns_of_every_axis():
    machine = arm_model.robot_machine(robot_of(urdf_text.ur10e()))
    start = np.array([3.1, -1.2, 1.4, -3.1, 1.3, 3.0])
    q = start + np.linspace(0.0, 0.4, 50)[:, None] * np.array([1.0, 0.1, 0.1, -1.0, 0.2, 1.0])
    branch = np.full(50, inverse_kinematics.branch_of(machine, start))
    found = inverse_kinematics.solve(machine, machine.flange(q), branch)
    assert np.abs(found - q).max() > 6.0
    np.testing.assert_allclose(inverse_kinematics.unwrapped_path(machine, found, start), q, atol=1e-7)
