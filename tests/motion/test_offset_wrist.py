"""Arms with an offset wrist: all solutions of poses, their continuation along a path, and singularities.

The references are forward kinematics, ssik and known postures.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.catalogue.robots import OffsetParameters, robot
from planner.cell.kinematics import flange_poses, forward_kinematics
from planner.geometry.arrays import interpolate, log_rotation
from planner.motion import offset_wrist, placement_margin
from planner.motion.planning_scene import Chain, inverse_kinematics, wrap_near
from planner.reading.arm_identification import fit_arm
from planner.reading.urdf import read_chain
from tests import urdf_text

GOFA = robot("crb15000_5_95")
ZERO = np.zeros(6)
FORMS = {
    "GoFa": GOFA.form,
    "CRX-10iA/L": OffsetParameters(
        0.0, 0.0, 0.0, -0.15, 0.245, 0.71, 0.54, 0.16, np.deg2rad([0, 0, -90, 0, 0, 0]), np.ones(6)
    ),
    "shoulder ahead, both offsets": OffsetParameters(
        0.15, -0.11, 0.06, 0.05, 0.3, 0.7, 0.5, 0.17, np.deg2rad([0, 90, -90, 0, 15, 0]),
        np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0]),
    ),
}  # fmt: skip


def postures(count, seed=19):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 6))


def gap(a, b):
    """Greatest difference of joints (..., 6) without whole turns."""
    return np.abs(wrap_near(a - b, ZERO)).max(axis=-1)


@pytest.mark.parametrize("name", FORMS)
def test_known_postures_are_among_the_solutions_and_all_of_them_reach_the_pose(name):
    form, q = FORMS[name], postures(2000)
    flange = flange_poses(form, q)
    result = inverse_kinematics(form, flange)
    is_valid = ~np.isnan(result[..., 0])
    assert np.array_equal(is_valid, np.isfinite(result).all(axis=-1))
    reached = flange_poses(form, result[is_valid])
    expected_poses = np.repeat(flange, is_valid.sum(axis=1), axis=0)
    assert np.abs(reached - expected_poses).max() < 1e-9
    turned = log_rotation(np.swapaxes(reached[:, :3, :3], 1, 2) @ expected_poses[:, :3, :3])
    assert np.linalg.norm(turned, axis=1).max() < 1e-9
    assert contains_posture(result, q).mean() >= 0.9995
    count = is_valid.sum(axis=1)
    assert count.max() > 8 and count.max() <= 16
    assert (count % 2 == 0).all()  # solutions come and go in pairs
    for item in range(0, 2000, 200):  # no two of them are one
        own = result[item][is_valid[item]]
        difference = gap(own[:, None], own[None]) + 9.0 * np.eye(len(own))
        assert difference.min() > 1e-4


def contains_posture(solutions, q):
    """Whether postures (N, 6) are among the solutions (N, B, 6) of their poses."""
    return (np.where(np.isnan(solutions[..., 0]), np.inf, gap(solutions, q[:, None])) < 1e-6).any(axis=1)


def test_two_solutions_that_nearly_meet_are_found_between_samples_of_any_spacing():
    """Fanuc's M-430iA/2P: where the condition turns back just beyond zero, beside the samples about a pass by
    axis 1, and next to the end of reach. It lost these two of 5,000 postures."""
    form = OffsetParameters(0.0, 0.0, 0.0, -0.095, 0.41, 0.35, 0.35, 0.065, np.zeros(6), np.ones(6))
    upper = np.array([3.14, 2.01, 3.49, 3.32, 2.62, 4.71])
    q = np.random.default_rng(1).uniform(-upper, upper, (5000, 6))[[200, 4041]]
    assert contains_posture(inverse_kinematics(form, flange_poses(form, q)), q).all()


@pytest.mark.parametrize("name", FORMS)
def test_postures_with_the_wrist_close_by_axis_1_are_found(name):
    """The wrist is some micrometres to 10 mm beside axis 1: theta 1 and theta 6 change rapidly together.

    Excluded postures also have the arm stretched or folded.
    """
    form, rng = FORMS[name], np.random.default_rng(8)
    theta, forearm = rng.uniform(-np.pi, np.pi, (600, 6)), np.hypot(form.a2, form.c3)
    beside, tilt = 10.0 ** rng.uniform(-6.0, -2.0, 600) - form.a1, theta[:, 2] + np.arctan2(form.a2, form.c3)
    up, out = form.c2 + forearm * np.cos(tilt), forearm * np.sin(tilt)
    there = np.abs(beside) < np.hypot(up, out)  # out = up sin(theta 2) + out cos(theta 2)
    theta, up, out, beside = theta[there], up[there], out[there], beside[there]
    theta[:, 1] = np.arcsin(beside / np.hypot(up, out)) - np.arctan2(out, up)
    q = (theta + form.offsets) * form.signs
    assert contains_posture(inverse_kinematics(form, flange_poses(form, q)), q).mean() >= 0.94


SSIK_HALVES = Path(__file__).with_name("offset_wrist_ssik.txt")
"""Half the number of solutions, as hexadecimal digits, that ssik 8.2.0 (BSD-3; its solver for any six turning
joints, from the URDF's axes of a GoFa CRB 15000-5/0.95) finds of the poses of postures(1000, 7)."""


def test_there_are_as_many_solutions_as_ssik_finds():
    theirs = 2 * np.array([int(digit, 16) for digit in SSIK_HALVES.read_text("utf-8") if digit.strip()])
    result = inverse_kinematics(GOFA.form, forward_kinematics(GOFA, postures(1000, 7)))
    count = (~np.isnan(result[..., 0])).sum(axis=1)
    assert len(theirs) == 1000 and theirs.sum() == 7670
    assert np.minimum(count, theirs).sum() >= 0.9995 * theirs.sum()
    assert (count == theirs).mean() >= 0.9995


@pytest.mark.parametrize(("name", "built_in"), [("hc10_ik", "hc10"), ("fanuc_crx10ia_ik", "crx10ia")])
def test_solutions_are_those_of_ssik(name, built_in):
    """Compare with ssik's built-in arms; the URDF is written here from its forward kinematics.

    The figures are those of the built-in arms, except for the flange of its HC10, which is on axis 5.
    """
    ssik = pytest.importorskip("ssik", reason="ssik is not installed (pip install ssik)")
    peer = ssik.Manipulator.from_prebuilt(name)
    chain = read_chain(write_urdf(peer.fk), "base_link", "tool0")
    result = fit_arm(chain)
    assert isinstance(result.form, OffsetParameters) and max(result.deviation) < 1e-9
    for key in ("a1", "a2", "a3", "b3", "c1", "c2", "c3", *(["c4"] if built_in != "hc10" else [])):
        assert getattr(result.form, key) == pytest.approx(getattr(robot(built_in).form, key), abs=1e-9), key
    poses = [peer.fk(q) for q in postures(100, 5)]
    own = inverse_kinematics(result.form, np.array(poses))
    total = missed = extra = 0
    for pose, ours in zip(poses, own, strict=True):
        theirs = [s.q for s in peer.solve(pose, respect_limits=False, enumerate_windings=False)]
        difference = gap(np.array(theirs)[:, None], ours[~np.isnan(ours[:, 0])])
        total, missed = total + len(theirs), missed + int((difference.min(axis=1) > 1e-4).sum())
        extra += int((difference.min(axis=0) > 1e-4).sum())
    assert total > 700
    assert missed == extra == 0


def write_urdf(fk):
    """The text of six joints whose tip goes as ``fk``: each one's axis by what half a radian of it does."""
    zero, axes, points = fk(ZERO), [], []
    for joint in range(6):
        moved = fk(0.5 * np.eye(6)[joint]) @ np.linalg.inv(zero)
        axes.append(np.round(log_rotation(moved[:3, :3]) / 0.5, 9))
        points.append(np.linalg.lstsq(np.eye(3) - moved[:3, :3], moved[:3, 3], rcond=1e-6)[0])
    return urdf_text.arm(np.array(axes), np.round(points, 9), zero)


def test_a_path_is_followed_where_numbers_change():
    """Straight ways of 0.2 m: following finds nearly each, joined branches nearly as many."""
    form, count = FORMS["CRX-10iA/L"], 60
    start = flange_poses(form, postures(25, 3))
    end = start.copy()
    end[:, :3, 3] += 0.2 * np.array([0.6, 0.0, 0.8])
    ways = np.stack([interpolate(start, end, np.full(25, s)) for s in np.linspace(0.0, 1.0, count)])
    table = inverse_kinematics(form, ways)  # (N, S, B, 6)
    joined = offset_wrist.match_ranks(table)
    assert np.array_equal(np.isnan(joined).sum(), np.isnan(table).sum())
    whole = [
        (np.isfinite(q[..., 0]).all(axis=0) & (gap(q[1:], q[:-1]).max(axis=0, initial=0.0) < 0.5))
        for q in (table, joined)
    ]
    follows = table[0].copy()
    for poses in ways[1:]:
        is_valid = np.isfinite(follows[..., 0])
        follows[is_valid] = offset_wrist.follow_branch(
            form, np.repeat(poses, is_valid.sum(axis=1), axis=0), follows[is_valid]
        )
        assert np.isnan(follows[~is_valid]).all()
    is_valid = np.isfinite(follows[..., 0])
    expected = np.repeat(ways[-1], is_valid.sum(axis=1), axis=0)
    assert np.abs(flange_poses(form, follows[is_valid]) - expected).max() < 1e-9
    assert whole[1].sum() > whole[0].sum()
    assert 0.9 * is_valid.sum() <= whole[1].sum() <= is_valid.sum()


def test_what_is_followed_is_near_and_else_nothing():
    form, q = GOFA.form, postures(50, 4)
    flange = flange_poses(form, q)
    near = offset_wrist.follow_branch(form, flange, q + 0.02)
    is_valid = np.isfinite(near[:, 0])
    assert is_valid.mean() > 0.9 and gap(near[is_valid], q[is_valid]).max() < 0.1
    far = flange.copy()
    far[:, 2, 3] += 5.0
    assert np.isnan(offset_wrist.follow_branch(form, far, q)).all()
    chain = Chain("arm", GOFA, np.eye(4), np.eye(4), GOFA.home)
    assert np.allclose(chain.on_branch(chain.pose(q), 3, q), q, atol=1e-9)


def test_singular_postures_are_where_the_jacobian_has_no_inverse():
    """With axis 6 through the point where 4 and 5 meet, the margins are those of a spherical wrist."""
    q = postures(300, 6)
    form = dataclasses.replace(GOFA.form, a3=1e-12)
    opw = robot("irb140").opw
    opw = dataclasses.replace(
        opw, a1=0.0, a2=form.a2, b=0.0, c1=form.c1, c2=form.c2, c3=form.c3, c4=form.c4, offsets=form.offsets
    )
    spherical = dataclasses.replace(GOFA, form=opw)
    own = np.stack(offset_wrist.singularities(form, q), axis=-1)
    known = Chain("arm", spherical, np.eye(4), np.eye(4), GOFA.home).singularities(q)
    assert np.allclose(own[:, 1:], known[:, 1:], atol=1e-9)
    assert np.allclose(np.sin(own[:, 0]), np.sin(known[:, 0]), atol=1e-6)
    result = inverse_kinematics(GOFA.form, forward_kinematics(GOFA, q))
    rows = result[~np.isnan(result[..., 0])]
    wrist = offset_wrist.singularities(GOFA.form, rows)[0]
    assert 0.0 <= wrist.min() < 0.02 and wrist.max() <= 0.5 * np.pi


def test_a_pose_out_of_reach_has_no_solution_and_its_gap_is_told():
    chain = Chain("arm", GOFA, np.eye(4), np.eye(4), GOFA.home)
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, 0, 3] = [0.5, 1.2, 3.0]
    assert np.isfinite(chain.inverse(pose)[0]).any()
    assert np.isnan(chain.inverse(pose)[1:]).all()
    told = placement_margin.reach_gap(chain, pose)
    assert told[0] == 0.0 and told[2] == pytest.approx(
        np.hypot(3.0, 0.265 + 0.101) - 0.444 - np.hypot(0.11, 0.47) - 0.08, abs=1e-9
    )


@pytest.mark.parametrize("name", FORMS)
def test_how_far_the_wrist_is_beyond_reach_is_that_of_scipys_turns(name):
    """Where axes 4 and 5 meet, with axis 6 turned step by step; postures that there are have it in reach."""
    form = FORMS[name]
    assert offset_wrist.wrist_gap(form, form.inner(flange_poses(form, postures(500)))).max() < 1e-4
    far = form.inner(flange_poses(form, postures(40, seed=3)))
    far[:, :3, 3] *= np.linspace(0.1, 4.0, 40)[:, None]
    turn = Rotation.from_euler("z", np.linspace(0.0, 2.0 * np.pi, 3600, endpoint=False)[:, None]).as_matrix()
    meet = far[:, None, :3, 3] - far[:, None, :3, :3] @ turn @ [form.a3, form.b3, form.c4] - [0, 0, form.c1]
    ahead, forearm = np.hypot(meet[..., 0], meet[..., 1]), np.hypot(form.a2, form.c3)
    reach = np.hypot([ahead - form.a1, -ahead - form.a1], meet[..., 2])
    gaps = np.maximum(reach - form.c2 - forearm, abs(form.c2 - forearm) - reach).min(axis=(0, 2))
    assert (gaps > 0.01).sum() > 5
    np.testing.assert_allclose(offset_wrist.wrist_gap(form, far), np.maximum(gaps, 0.0), atol=1e-4)
