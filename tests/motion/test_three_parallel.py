"""Arms with three parallel axes: a UR10e by its maker's table, solved in closed form.

The references are the table and EAIK. The search handles whole turns of its joints.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bench.motion_jobs import s_curve
from planner.cell.kinematics import flange_poses, jacobian
from planner.geometry.arrays import exp_rotation, from_parts
from planner.motion import placement_margin, three_parallel
from planner.motion.planning_scene import FULL_TURN_RAD, Chain, Scene, inverse_kinematics, wrap_near
from planner.motion.search import layered_graph_search, reach
from planner.problem import Settings
from tests import urdf_text
from tests.urdf_text import LAST, OUT, RISE
from tests.urdf_text import UR10E as DATA
from tests.urdf_text import UR10E_FORM as FORM

POSES = 10_000


@pytest.fixture(scope="module")
def solved_poses():
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, 6))
    flange = urdf_text.ur10e_flange(q)
    return q, flange, inverse_kinematics(FORM, flange)


def test_the_form_is_the_makers_table():
    q = np.random.default_rng(4).uniform(-FULL_TURN_RAD, FULL_TURN_RAD, (1000, 6))
    assert np.abs(flange_poses(FORM, q) - urdf_text.ur10e_flange(q)).max() < 1e-13


def test_every_branch_reaches_the_pose_and_one_is_the_posture_asked_for(solved_poses):
    q, flange, found = solved_poses
    is_valid = ~np.isnan(found[..., 0])
    assert np.array_equal(is_valid, ~np.isnan(found).any(axis=-1))
    expected_poses = np.repeat(flange, is_valid.sum(axis=1), axis=0)
    assert np.abs(urdf_text.ur10e_flange(found[is_valid]) - expected_poses).max() < 1e-9
    assert np.nanmin(np.abs(wrap_near(found - q[:, None], np.zeros(6))).max(axis=-1), axis=1).max() < 1e-7
    assert is_valid.sum(axis=1).max() == 8


def test_there_are_as_many_branches_as_eaik_finds(solved_poses):
    """EAIK (BSD-3) treats the arm as one with three inner parallel axes.

    Results that it marks as least squares are no solutions.
    """
    peer = pytest.importorskip("eaik.IK_DH", reason="EAIK is not installed (pip install --no-deps EAIK)")
    _, flange, found = solved_poses
    d, a, alpha = np.array(urdf_text.UR10E_DH).T
    arm = peer.DhRobot(alpha, a, d)
    assert arm.hasKnownDecomposition()
    theirs = [int(np.sum(~np.asarray(item.is_LS, dtype=bool))) for item in arm.IK_batched(list(flange), 1)]
    assert np.array_equal((~np.isnan(found[..., 0])).sum(axis=1), theirs)


def test_branch_numbers_are_continuous_along_a_path():
    q = np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.1]) + np.linspace(0, 0.3, 200)[:, None] * np.ones(6)
    result = inverse_kinematics(FORM, flange_poses(FORM, q))
    branch = np.argmin(np.abs(wrap_near(result - q[:, None], np.zeros(6))).max(axis=-1), axis=1)
    assert len(set(branch.tolist())) == 1
    only = inverse_kinematics(FORM, flange_poses(FORM, q), [int(branch[0])])[:, 0]
    assert np.allclose(wrap_near(only, q), q, atol=1e-9)


@pytest.mark.parametrize("sine", [0.0, 1e-12, 1e-7])
def test_a_wrist_in_line_is_solved_with_axis_6_at_zero_or_exactly(sine):
    """At sin(q5) = 0 only the sum of what axes 4 and 6 turn is certain, and theta 6 is 0."""
    q = np.array([0.4, -1.3, 1.2, -0.9, sine, 0.7])
    result = inverse_kinematics(FORM, flange_poses(FORM, q))
    is_valid = ~np.isnan(result[:, 0])
    assert is_valid.any()
    assert np.abs(flange_poses(FORM, result[is_valid]) - flange_poses(FORM, q)).max() < 1e-9
    if sine < three_parallel.PARALLEL_SINE_TOLERANCE:
        lined = is_valid & (np.abs(np.sin(result[:, 4])) < 1e-9)
        assert lined.any() and np.abs(wrap_near(result[lined, 5], np.zeros(()))).max() < 1e-12


def test_a_stretched_elbow_is_reached_and_what_is_farther_is_not():
    q = np.random.default_rng(6).uniform(-2.0, 2.0, (500, 6))
    q[:, 2] = 0.0
    flange = flange_poses(FORM, q)
    result = inverse_kinematics(FORM, flange)
    deviation = np.abs(flange_poses(FORM, np.nan_to_num(result)) - flange[:, None]).max(axis=(-1, -2))
    assert (np.nanmin(np.where(np.isnan(result[..., 0]), np.inf, deviation), axis=1) < 1e-9).all()
    flange[:, :3, 3] *= 3.0
    distance = np.linalg.norm(flange[:, :3, 3], axis=1) > 2.0
    assert distance.sum() > 100 and np.isnan(inverse_kinematics(FORM, flange[distance])).all()


def chain():
    return Chain("arm", DATA, np.eye(4), np.eye(4), np.zeros(6))


def test_singular_postures_are_where_the_jacobian_is():
    """Its determinant is the product of c2, c3 and the three sines, the last of them times a length."""
    q = np.random.default_rng(7).uniform(-np.pi, np.pi, (500, 6))
    wrist, elbow, shoulder = np.sin(chain().singularities(q)).T
    stretch = FORM.c2 + FORM.c3 + FORM.c4
    product = FORM.c2 * FORM.c3 * stretch * wrist * elbow * shoulder
    np.testing.assert_allclose(np.abs(np.linalg.det(jacobian(DATA, q))), product, atol=1e-12)


def test_what_is_out_of_reach_is_told_by_how_far(solved_poses):
    _, flange, _ = solved_poses
    assert placement_margin.reach_gap(chain(), flange).max() < 1e-12
    far, beside = np.eye(4), np.eye(4)
    far[:3, 3], beside[:3, 3] = (2.0, 0.0, RISE + LAST), (0.05, 0.0, 0.5)
    assert np.isnan(inverse_kinematics(FORM, np.stack([far, beside]))).all()
    longest = FORM.c2 + FORM.c3 + FORM.c4
    assert placement_margin.reach_gap(chain(), far) == pytest.approx(np.sqrt(4.0 - OUT**2) - longest)
    assert placement_margin.reach_gap(chain(), beside) == pytest.approx(OUT - 0.05)


def test_each_joint_has_the_turn_that_leaves_it_most_room():
    one = chain()
    q = np.random.default_rng(8).uniform(-np.pi, np.pi, (50, 6))
    assert len(one.turns) == 3**6
    best = np.max(one.limit_margins(q, one.turns), axis=0)
    assert np.array_equal(one.best_limit_margin(q), best)


def test_turns_that_are_left_out_would_not_have_been_taken(monkeypatch):
    """A tool that spins freely on its way around axis 1, which passes the seam: with all turns and with those
    that are worth trying, the same path."""
    angle = np.deg2rad(np.linspace(-150.0, 210.0, 40))
    down = np.diag([1.0, -1.0, -1.0])
    points = np.stack([0.7 * np.cos(angle), 0.7 * np.sin(angle), np.full(40, 0.25)], axis=1)
    turned = exp_rotation(angle[:, None] * np.array([0.0, 0.0, 1.0])) @ down
    _, known = s_curve(40)
    pose = {"arm": from_parts(turned, points)}
    narrow = [dataclasses.replace(f, lower=0.3 * f.lower, upper=0.3 * f.upper) for f in known.freedoms]
    targets = dataclasses.replace(known, pose=pose, freedoms=tuple(narrow))
    scene = Scene({"arm": chain()}, np.eye(4), Settings())
    grid = reach.sample_freedoms(targets, spin_step=np.deg2rad(20.0))
    few = layered_graph_search.search_graph(scene, targets, grid)
    kept = {len(r.turns) for r in reach.compute_reach(scene, targets, grid)["arm"].branches.values()}
    monkeypatch.setattr(reach, "MAX_TURN_COMBINATIONS", 3**6)
    again = dataclasses.replace(scene)
    every = layered_graph_search.search_graph(again, targets, grid)
    assert 1 < max(kept) <= 27
    assert len(chain().turns) == 3**6
    assert few.path.cost == every.path.cost
    assert np.array_equal(few.q["arm"], every.q["arm"])
    assert np.ptp(few.q["arm"][:, 0]) > np.deg2rad(300.0)
