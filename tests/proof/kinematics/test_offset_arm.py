"""Arms with an offset wrist in the proof: continuous postures along a path, their ends, and singular ones."""

from __future__ import annotations

import numpy as np

from planner.catalogue.robots import robot
from planner.motion import offset_wrist
from planner.proof.kinematics import arm_model, inverse_kinematics, offset_arm

GOFA = robot("crb15000_5_95")
MACHINE = arm_model.robot_machine(GOFA)
CHAIN = MACHINE.chain
START = np.deg2rad([10.0, 20.0, -10.0, 30.0, 70.0, -40.0])
END = START + np.array([0.5, -0.3, 0.4, -0.6, 0.3, 0.9])


def interpolate(start, end, count):
    return start + np.linspace(0.0, 1.0, count)[1:, None] * (end - start)


def test_joints_go_on_from_those_before_them():
    q = interpolate(START, END, 200)
    found = offset_arm.follow(CHAIN, CHAIN.tip(q), START)
    assert np.abs(found - q).max() < 1e-9
    one = offset_arm._follow_stepwise(CHAIN, CHAIN.tip(q[:40]), START)
    assert np.abs(one - found[:40]).max() < 1e-9
    assert len(offset_arm.follow(CHAIN, np.zeros((0, 4, 4)), START)) == 0


def test_whole_turns_go_on_too():
    q = interpolate(START, START + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 7.0]), 200)
    assert np.abs(offset_arm.follow(CHAIN, CHAIN.tip(q), START) - q).max() < 1e-9


def test_steps_that_are_too_long_and_places_out_of_reach_have_no_joints():
    far = interpolate(START, START + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 3)
    assert np.isnan(offset_arm.follow(CHAIN, CHAIN.tip(far), START)).all()
    q = interpolate(START, END, 100)
    flange = CHAIN.tip(q)
    flange[60:, 0, 3] += 1.5
    found = offset_arm.follow(CHAIN, flange, START)
    assert np.abs(found[:60] - q[:60]).max() < 1e-9 and np.isnan(found[60:]).all()
    assert np.isnan(offset_arm.follow(CHAIN, flange, np.full(6, np.nan))).all()


def test_beyond_a_singular_posture_nothing_is_followed():
    """Joints pass a posture whose Jacobian changes its sign; from there on the pose has two ways on."""
    start = START.copy()
    end = start.copy()
    start[4], end[4] = 0.6, -0.6
    q = interpolate(start, end, 400)
    tips, points, tip = offset_arm._axes(CHAIN, q)
    side = np.sign(np.linalg.det(offset_arm._jacobian(tips, points, tip)))
    passed = int(np.argmax(side != side[0]))
    assert passed > 0
    found = offset_arm.follow(CHAIN, CHAIN.tip(q), start)
    assert np.isnan(found[passed:]).all()
    assert np.abs(found[: passed - 10] - q[: passed - 10]).max() < 1e-6


def test_distances_to_singular_postures_are_the_planners_by_another_way():
    q = np.random.default_rng(3).uniform(GOFA.lower, GOFA.upper, (500, 6))
    own = inverse_kinematics.singularity_distance(MACHINE, q)
    theirs = np.minimum.reduce(offset_wrist.singularities(GOFA.form, q))
    np.testing.assert_allclose(own, theirs, atol=1e-7)


def test_no_point_is_farther_from_an_axis_than_its_lever():
    q = np.random.default_rng(4).uniform(GOFA.lower, GOFA.upper, (300, 6))
    lines, points, tip = offset_arm._axes(CHAIN, q)
    point = tip[:, :3, 3] + 0.2 * tip[:, :3, 0]
    deviation = np.linalg.norm(np.cross(point[:, None] - points, lines), axis=-1)
    assert (deviation <= offset_arm.max_axis_distances(CHAIN, 0.2) + 1e-12).all()


def test_confdata_select_nothing_of_such_an_arm():
    flange = MACHINE.flange(START[None])
    assert np.isnan(inverse_kinematics.select_by_confdata(MACHINE, flange, np.zeros((1, 4), int))).all()
    assert inverse_kinematics.branch_of(MACHINE, START) == 0
