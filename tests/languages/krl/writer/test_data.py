"""Status and turn, against points taught on robots, link positions, and all branches of an independent IK."""

from __future__ import annotations

import itertools

import numpy as np
import py_opw_kinematics as opw
import pytest
from scipy.spatial.transform import RigidTransform

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics, link_frames
from planner.languages.krl.writer.data import axes_near_zero, status, turn
from tests.robot_sample import KUKAS


def branches(arm, poses):
    """All solutions (N, 8, 6) of py-opw-kinematics, in the arm's own angle convention."""
    p = arm.opw
    model = opw.KinematicModel(
        a1=p.a1,
        a2=p.a2,
        b=p.b,
        c1=p.c1,
        c2=p.c2,
        c3=p.c3,
        c4=p.c4,
        offsets=tuple(p.offsets * p.signs),
        flip_axes=tuple(bool(sign < 0) for sign in p.signs),
    )
    kinematics = opw.Robot(model, degrees=False)
    return np.asarray(kinematics.reach(RigidTransform.from_matrix(poses)).joints)


# S and T of points in programs of real cells, found in public repositories: their A3 has no turn
# bit, so it is positive, as in every usual posture of these arms; A5 has one or not
@pytest.mark.parametrize(("s", "t"), [(2, 2), (2, 10), (2, 34), (2, 35), (6, 26), (6, 27)])
@pytest.mark.parametrize("name", KUKAS)
def test_taught_points_have_the_status_that_their_turn_bits_go_with(name, s, t):
    signs = np.array([-1.0 if t >> i & 1 else 1.0 for i in range(6)])
    q = np.deg2rad(signs * [20.0, 80.0, 85.0, 30.0, 50.0, 40.0])
    assert (status(robot(name), q), turn(robot(name), q)) == (s, t)


@pytest.mark.parametrize("name", KUKAS)
def test_status_agrees_with_the_places_of_the_links(name):
    arm = robot(name)
    q = np.random.default_rng(5).uniform(arm.lower, arm.upper, (4000, 6))
    frames = link_frames(arm, q)
    shoulder, elbow, wrist = frames[:, 1, :3, 3], frames[:, 2, :3, 3], frames[:, 4, :3, 3]
    ahead = np.einsum("nk,nk->n", wrist, frames[:, 0, :3, 0])  # x in the frame of axis 1
    # which side of the straight line from shoulder through elbow the wrist lies on, seen along the axis of
    # the elbow (the y of its frame), about which positive angles of axis 3 turn
    side = np.einsum("nk,nk->n", np.cross(elbow - shoulder, wrist - elbow), frames[:, 2, :3, 1])
    clear = (np.abs(ahead) > 1e-5) & (np.abs(side) > 1e-5) & (np.abs(q[:, 4]) > 1e-5)
    expected = (ahead < 0) + 2 * (side > 0) + 4 * (q[:, 4] < 0)
    assert clear.mean() > 0.99
    assert np.array_equal(status(arm, q)[clear], expected[clear])


@pytest.mark.parametrize("name", KUKAS)
def test_status_and_turn_select_exactly_one_solution_with_all_full_turns(name):
    arm = robot(name)
    q = np.random.default_rng(11).uniform(arm.lower, arm.upper, (300, 6))
    q = q[(np.abs(np.sin(q[:, 4])) > 0.05) & (np.abs(q) > np.deg2rad(2)).all(axis=1)]
    expected = np.stack([status(arm, q), turn(arm, q)], axis=1)
    shifts = 2 * np.pi * np.array(list(itertools.product((-1, 0, 1), repeat=6)))
    whole = 0
    for row, own, want in zip(branches(arm, forward_kinematics(arm, q)), q, expected, strict=True):
        found = row[np.isfinite(row).all(axis=1)]
        whole += len(found) == 8
        every = (found[:, None] + shifts).reshape(-1, 6)
        every = every[((every >= arm.lower) & (every <= arm.upper)).all(axis=1)]
        same = np.stack([status(arm, every), turn(arm, every)], axis=1)
        chosen = every[(same == want).all(axis=1)]
        assert len(chosen) == 1
        assert np.abs(chosen[0] - own).max() < 1e-9
        if len(found) == 8:
            assert sorted(status(arm, found)) == list(range(8))
    assert whole > 20


def test_noise_at_zero_does_not_change_a_bit():
    arm = robot("kr60_ha")
    noisy = np.array([-1e-9, -1.5, 1.5, -1e-9, -1e-9, -1e-9])
    assert turn(arm, noisy) == 0b000010
    assert status(arm, noisy) == 2


def test_axes_near_zero_are_named_from_one():
    q = np.deg2rad([1.9, -90.0, 90.0, -2.1, 30.0, -1.0])
    assert axes_near_zero(robot("kr10_r1100"), q).tolist() == [1, 6]
