"""Arms with seven axes: a Panda and an iiwa by their makers' figures.

They are solved in closed form for each angle of the last joint, which is a freedom. The references are the
product of exponentials of their URDFs and EAIK.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.catalogue.robots import SevenParameters, robot
from planner.cell.kinematics import flange_poses, form_jacobian
from planner.geometry.arrays import from_rpy
from planner.motion import placement_margin, seven_axes
from planner.motion.planning_scene import FULL_TURN_RAD, Chain, inverse_kinematics, wrap_near
from planner.reading import arm_identification
from planner.reading.urdf import read_chain
from tests import urdf_text

POSES = 1000
ARMS = {"panda": urdf_text.panda, "iiwa": urdf_text.iiwa}


def read_robot(name, *ends):
    chain = read_chain(ARMS[name](*ends), "base_link", "tool0")
    result = arm_identification.fit_arm(chain)
    assert max(result.deviation) < 1e-12
    return chain, result.form


def test_a_panda_is_found_by_its_makers_lengths():
    _, form = read_robot("panda")
    for key, value in vars(urdf_text.PANDA_FORM).items():
        if value is not None:
            np.testing.assert_allclose(getattr(form, key), value, atol=1e-12, err_msg=key)


@pytest.fixture(scope="module", params=ARMS)
def solved_arm(request):
    chain, form = read_robot(request.param)
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (POSES, 7))
    flange = chain.tip(q)
    return chain, form, q, flange, inverse_kinematics(form, flange, last_joint=q[:, 6])


def test_every_branch_reaches_the_pose_with_the_last_joint_as_it_is_and_one_is_the_posture(solved_arm):
    chain, form, q, flange, found = solved_arm
    is_valid = ~np.isnan(found[..., 0])
    assert np.array_equal(~is_valid, np.isnan(found).all(axis=-1))
    assert np.array_equal(~is_valid, np.isnan(found).any(axis=-1))
    expected_poses = np.repeat(flange, is_valid.sum(axis=1), axis=0)
    assert np.abs(chain.tip(found[is_valid]) - expected_poses).max() < 1e-9
    assert np.abs(flange_poses(form, found[is_valid]) - expected_poses).max() < 1e-9
    assert np.array_equal(found[is_valid][:, 6], np.repeat(q[:, 6], is_valid.sum(axis=1)))
    assert np.nanmin(np.abs(wrap_near(found - q[:, None], np.zeros(7))).max(axis=-1), axis=1).max() < 1e-6
    assert is_valid.sum(axis=1).max() == 8


def lock_last_joint(solved, count):
    """Lock the last joint.

    Returns:
        Axes and steps of the other six joints, poses (B, 4, 4) of what the last joint carries, rotated as the
        base, and the number of solutions of each.
    """
    chain, _, q, _, found = solved
    still = np.where(np.arange(7) < 6, q[:count], 0.0)  # the same postures with joint 7 at zero
    target = chain.tip(still)
    target[:, :3, :3] = target[:, :3, :3] @ chain.zero[8, :3, :3].T
    steps = np.diff(chain.zero[[0, 1, 2, 3, 4, 5, 6, 8], :3, 3], axis=0)
    return chain.axis[:6], steps, target, found[:count, :, :6]


def test_there_are_as_many_branches_as_eaik_finds(solved_arm):
    """Compare with EAIK (BSD-3), last joint locked: the first three of the six remaining axes meet."""
    peer = pytest.importorskip("eaik.IK_HP", reason="EAIK is not installed (pip install --no-deps EAIK)")
    axes, steps, target, found = lock_last_joint(solved_arm, POSES)
    arm = peer.HPRobot(axes, steps)
    assert arm.hasKnownDecomposition()
    theirs = [int(np.sum(~np.asarray(item.is_LS, dtype=bool))) for item in arm.IK_batched(list(target), 1)]
    assert np.array_equal((~np.isnan(found[..., 0])).sum(axis=1), theirs)


def test_solutions_are_those_of_ssik(solved_arm):
    """ssik (BSD-3) knows arms whose last three axes meet, so it has this one from its tip on."""
    ssik = pytest.importorskip("ssik", reason="ssik is not installed (pip install ssik)")
    axes, steps, target, found = lock_last_joint(solved_arm, 100)
    peer = ssik.Manipulator.from_axes(-axes[::-1], -steps[::-1])
    for own, pose in zip(found, np.linalg.inv(target), strict=True):
        own = own[~np.isnan(own[:, 0])]
        theirs = peer.solve(pose, respect_limits=False, enumerate_windings=False)
        assert len(own) == len(theirs)
        for item in theirs:
            joint_error = np.abs(np.angle(np.exp(1j * (own - np.asarray(item.q)[::-1])))).max(axis=-1)
            assert joint_error.min() < 1e-4


def nearest(solutions, q):
    """The branch of each solution (B, 8, 7) that is the posture q (B, 7)."""
    return np.nanargmin(np.abs(wrap_near(solutions - q[:, None], np.zeros(7))).max(axis=-1), axis=1)


@pytest.mark.parametrize("name", ARMS)
def test_branch_numbers_are_continuous_while_the_last_joint_goes_along(name):
    chain, form = read_robot(name)
    q = chain.lower + (0.55 + np.linspace(0, 0.1, 200)[:, None]) * (chain.upper - chain.lower)
    result = inverse_kinematics(form, flange_poses(form, q), last_joint=q[:, 6])
    branch = nearest(result, q)
    assert len(set(branch.tolist())) == 1
    only = inverse_kinematics(form, flange_poses(form, q), [int(branch[0])], q[:, 6])[:, 0]
    assert np.allclose(wrap_near(only, q), q, atol=1e-9)


small, lengths = st.floats(-0.1, 0.1), st.floats(0.2, 0.6)
SIZES = st.tuples(small, small, small, lengths, lengths, lengths, st.floats(0.05, 0.2))


@settings(max_examples=20, deadline=None)
@given(
    SIZES,
    st.tuples(*[st.integers(-170, 170).map(np.deg2rad)] * 6),  # nearer to 15 degrees than 1e-4 is those
    st.tuples(*[st.sampled_from([-1.0, 1.0])] * 7),
    st.booleans(),
)
def test_any_such_arm_is_found_by_its_axes_and_its_start_posture_too(sizes, offsets, signs, is_rotated):
    form = SevenParameters(*sizes, offsets=np.array([0.0, *offsets]), signs=np.array(signs))
    ends = (from_rpy([0.1, -0.2, 0.3], [0.4, np.pi, 0.0]), from_rpy([0.01, 0.02, -0.05], [0.0, 1.2, 0.3]))
    arm = dataclasses.replace(
        robot("irb140"), form=form, lower=np.full(7, -2.9), upper=np.full(7, 2.9), velocity=np.ones(7)
    )
    chain = read_chain(urdf_text.robot_urdf(arm, *(ends if is_rotated else ())), "base_link", "tool0")
    result = arm_identification.fit_arm(chain)
    assert isinstance(result.form, SevenParameters)
    assert max(result.deviation) < 1e-9
    q = np.random.default_rng(1).uniform(chain.lower, chain.upper, size=(100, 7))
    q = q[np.min(seven_axes.singularities(result.form, q), axis=0) > 0.01]  # two solutions are one there
    solutions = inverse_kinematics(result.form, chain.tip(q), last_joint=q[:, 6])
    joint_error = np.abs(np.angle(np.exp(1j * (solutions - q[:, None]))))
    assert np.nanmin(joint_error.max(axis=-1), axis=1).max() < 1e-5


def read_chain_of_robot(name):
    chain, form = read_robot(name)
    data = dataclasses.replace(
        robot("irb140"), form=form, lower=chain.lower, upper=chain.upper, velocity=chain.velocity
    )
    return Chain("arm", data, np.eye(4), np.eye(4), 0.5 * (chain.lower + chain.upper))


@pytest.mark.parametrize("name", ARMS)
def test_singular_postures_are_where_the_other_six_joints_move_the_flange_by_five_ways_only(name):
    one = read_chain_of_robot(name)
    form = one.robot.form
    q = np.random.default_rng(7).uniform(one.robot.lower, one.robot.upper, (500, 7))
    size = np.abs(np.linalg.det(form_jacobian(form, q)[..., :6]))
    wrist, elbow, shoulder = np.sin(seven_axes.singularities(form, q))
    theta4 = form.signs[3] * q[:, 3] - form.offsets[3]
    bend = np.abs(np.sin(theta4 - form.straight))
    beside = np.abs(form.a2 * np.cos(theta4) - form.c2 * np.sin(theta4) + form.a3)
    np.testing.assert_allclose(size, wrist * shoulder * form.upper * form.fore * bend * beside, atol=1e-12)
    np.testing.assert_allclose(elbow, np.minimum(bend, beside / form.upper), atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_the_last_joint_moves_the_others_and_no_tool(name):
    one = read_chain_of_robot(name)
    q = np.random.default_rng(8).uniform(one.robot.lower + 0.3, one.robot.upper - 0.3, (200, 7))
    q = q[one.singularity_margin(q) > 0.2]
    step = 1e-6
    pose = one.pose(q)
    result = one.inverse(pose, last_joint=q[:, 6])
    branch = np.argmin(
        np.where(np.isnan(result), 9.0, np.abs(wrap_near(result - q[:, None], np.zeros(7)))).max(-1), 1
    )
    ahead, behind = (
        np.stack(
            [
                one.on_branch(p, int(b), near, np.array(near[6] + s))
                for p, b, near in zip(pose, branch, q, strict=True)
            ]
        )
        for s in (step, -step)
    )
    assert np.abs(one.pose(ahead) - pose).max() < 1e-9
    np.testing.assert_allclose((ahead - behind) / (2.0 * step), one.null_space_rates(q), atol=1e-5)
    assert np.array_equal(one.null_space_rates(q)[:, 6], np.ones(len(q)))


def test_what_is_out_of_reach_is_told_by_how_far(solved_arm):
    _, form, _, flange, _ = solved_arm
    assert seven_axes.reach_gap(form, form.inner(flange)).max() < 1e-12
    far = np.eye(4)
    far[:3, 3] = (3.0, 0.0, form.c1 + form.c4)
    assert np.isnan(inverse_kinematics(form, far, last_joint=np.array(0.3))).all()
    gap = placement_margin.reach_gap(dataclasses.replace(read_chain_of_robot("iiwa"), robot=_with(form)), far)
    assert gap == pytest.approx(3.0 - form.upper - form.fore - abs(form.a4))


def _with(form):
    return dataclasses.replace(read_chain_of_robot("iiwa").robot, form=form)


def test_a_pose_alone_says_too_little():
    _, form = read_robot("iiwa")
    with pytest.raises(TypeError, match="SevenParameters"):
        inverse_kinematics(form, np.eye(4))


def test_turns_of_the_last_joint_are_turns_as_those_of_any():
    one = read_chain_of_robot("iiwa")
    wide = dataclasses.replace(one.robot, lower=np.full(7, -FULL_TURN_RAD), upper=np.full(7, FULL_TURN_RAD))
    one = dataclasses.replace(one, robot=wide)
    q = np.array([0.2, 0.5, 0.3, -1.2, 0.1, 0.7, 4.0])
    result = one.inverse(one.pose(q)[None], last_joint=q[None, 6])[0]
    near = one.on_branch(
        one.pose(q), int(np.nanargmin(np.abs(wrap_near(result - q, np.zeros(7))).max(-1))), q
    )
    np.testing.assert_allclose(near, q, atol=1e-9)
