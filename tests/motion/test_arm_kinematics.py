"""Inverse kinematics against another library (py-opw-kinematics) and against forward kinematics."""

from __future__ import annotations

import numpy as np
import pytest
from py_opw_kinematics import KinematicModel, Robot
from scipy.spatial.transform import RigidTransform

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import exp_twist, from_parts
from planner.motion import planning_scene
from planner.motion.planning_scene import FULL_TURN_RAD, Chain, wrap_near
from tests.robot_sample import SAMPLE


@pytest.mark.parametrize("name", SAMPLE)
def test_every_branch_reaches_the_pose_and_one_is_the_angle_asked_for(name: str) -> None:
    data = robot(name)
    q = np.random.default_rng(1).uniform(data.lower, data.upper, (400, 6))
    flange = forward_kinematics(data, q)
    result = planning_scene.inverse_kinematics(data.opw, flange)
    is_valid = ~np.isnan(result[..., 0])
    assert np.array_equal(is_valid, ~np.isnan(result).any(axis=-1))
    again = forward_kinematics(data, np.nan_to_num(result))
    error = np.abs(again - flange[:, None]).max(axis=(-1, -2))
    assert error[is_valid].max() < 1e-10
    away = np.abs(wrap_near(result - q[:, None], np.zeros(6))).max(axis=-1)
    assert np.nanmin(away, axis=1).max() < 1e-7


@pytest.mark.parametrize("name", SAMPLE)
def test_branches_agree_with_py_opw_kinematics(name: str) -> None:
    data = robot(name)
    p = data.opw
    model = KinematicModel(
        p.a1, p.a2, p.b, p.c1, p.c2, p.c3, p.c4, tuple(p.offsets), tuple(bool(s < 0) for s in p.signs)
    )
    other = Robot(model, degrees=False)
    q = np.random.default_rng(2).uniform(data.lower, data.upper, (200, 6))
    flange = forward_kinematics(data, q)
    theirs = np.asarray(other.reach(RigidTransform.from_matrix(flange), [(-20.0, 20.0)] * 6).joints)
    ours = planning_scene.inverse_kinematics(data.opw, flange)
    gap = np.abs(wrap_near(ours[:, :, None] - theirs[:, None], np.zeros(6))).max(axis=-1)
    gap = np.where(np.isnan(gap), np.inf, gap)
    assert np.array_equal(np.isnan(ours[..., 0]).sum(axis=1), np.isnan(theirs[..., 0]).sum(axis=1))
    matched = gap.min(axis=2)[~np.isnan(ours[..., 0])]
    assert matched.max() < 1e-6


def test_branch_numbers_are_continuous_along_a_path() -> None:
    data = robot("irb140")
    q = np.array([0.3, 0.2, -0.4, 0.5, 0.9, 0.1]) + np.linspace(0, 0.3, 200)[:, None] * np.ones(6)
    result = planning_scene.inverse_kinematics(data.opw, forward_kinematics(data, q))
    branch = np.argmin(np.abs(wrap_near(result - q[:, None], np.zeros(6))).max(axis=-1), axis=1)
    assert len(set(branch.tolist())) == 1
    only = planning_scene.inverse_kinematics(data.opw, forward_kinematics(data, q), [int(branch[0])])[:, 0]
    assert np.allclose(wrap_near(only, q), q, atol=1e-9)


def chain(name: str = "irb140") -> Chain:
    tool = from_parts(np.eye(3), np.array([0.1, 0.02, 0.3]))
    base = exp_twist(np.array([0.1, 0.2, 0.9, 0.5, -0.3, 0.2]))
    return Chain("arm", robot(name), base, tool, np.zeros(6))


def test_angles_come_wrapped_around_the_middle_of_each_range() -> None:
    one = chain()
    q = np.random.default_rng(3).uniform(one.robot.lower, one.robot.upper, (300, 6))
    result = one.inverse(one.pose(q))
    assert np.nanmax(np.abs(result - one.middle)) <= np.pi + 1e-9


def test_turns_are_those_of_axes_4_and_6_of_the_irb140() -> None:
    counts = np.round(chain().turns / FULL_TURN_RAD).astype(int)
    assert np.array_equal(counts[0], np.zeros(6))
    assert {tuple(row[[3, 5]]) for row in counts} == {(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)}
    assert not counts[:, [0, 1, 2, 4]].any()


@pytest.mark.parametrize("name", ["irb140", "irb4400_60", "kr60_ha"])
def test_limit_margins_with_turns_agree_with_the_catalogue(name: str) -> None:
    one = chain(name)
    q = np.random.default_rng(4).uniform(-4.0, 4.0, (200, 6))
    for turn, margin in zip(one.turns, one.limit_margins(q, one.turns), strict=True):
        assert np.allclose(margin, one.robot.limit_margin(q + turn), atol=1e-12)


def test_rates_carry_the_tool_along_the_twist() -> None:
    one = chain()
    q = np.array([[0.3, 0.2, -0.4, 0.5, 0.9, 0.1], [-0.6, 0.4, -0.2, -0.8, 1.1, 0.5]])
    twist = np.random.default_rng(5).normal(size=(2, 3, 6))
    rates = one.joint_rates(q, twist)
    step = 1e-5
    for k in range(3):
        ahead = one.pose(q + step * rates[:, k])
        expected = one.pose(q) @ exp_twist(step * twist[:, k])
        assert np.abs(ahead - expected).max() < 1e-7


def test_singularity_margin_is_zero_where_axes_line_up_or_the_elbow_is_stretched() -> None:
    one = chain()
    straight_wrist = np.array([0.1, 0.2, -0.3, 0.7, 0.0, 0.4])
    stretched = np.array([0.1, 0.2, -np.pi / 2, 0.7, 0.8, 0.4])
    assert one.singularity_margin(straight_wrist) < 1e-12
    assert one.singularity_margin(stretched) < 1e-12
    assert abs(one.singularities(np.array([0.1, 0.2, -0.3, 0.7, 0.25, 0.4]))[0] - 0.25) < 1e-12
