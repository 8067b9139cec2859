"""Passing of given poses: against a plain search from pose to pose, with work that grows linearly."""

import numpy as np
import pytest

from planner.geometry.arrays import exp_rotation, exp_twist, from_parts
from planner.processes.poses.proof.pose_passing import MAX_MISSED, free_values, match_poses
from tests.work import count_calls

TOLERANCE = (5e-5, 1e-3)
SPIN = (np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),)


def spiral(count, pitch=5e-3):
    """Poses along a spiral, the tool leaning more and more."""
    s = np.arange(count) * pitch
    position = np.stack([0.2 * np.cos(s / 0.2), 0.2 * np.sin(s / 0.2), 1e-2 * s], axis=1)
    return from_parts(exp_rotation(np.stack([0.1 * s, 0.0 * s, 0.3 * s], axis=1)), position)


def plainly(path, poses, free):
    """One pose after the other against all of the path that is left."""
    start, target, met = 0, [], []
    for pose in poses:
        off = []
        for here in path[start:]:
            relative = np.linalg.inv(pose) @ here
            angle = np.arccos(np.clip((np.trace(relative[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
            if free:  # about z: what is left is the lean of z
                angle = np.arccos(np.clip(relative[2, 2], -1.0, 1.0))
            off.append((np.linalg.norm(relative[:3, 3]) / TOLERANCE[0], angle / TOLERANCE[1]))
        score = np.max(off, axis=1)
        good = np.flatnonzero(score <= 1.0)
        met.append(bool(len(good)))
        start += int(good[0]) if len(good) else 0
        target.append(start if len(good) else start + int(np.argmin(score)))
    return target, met


@pytest.mark.parametrize("case", ["same", "ways in and out", "twice", "missing", "dense", "swapped"])
def test_the_first_targets_that_meet(case):
    rng = np.random.default_rng(7)
    poses = spiral(60, 1e-5 if case == "dense" else 5e-3)
    path = poses @ exp_twist(rng.normal(0.0, 2e-6, (60, 6)))
    if case == "ways in and out":
        path = np.concatenate(
            [spiral(9)[::-1] @ from_parts(np.eye(3), np.array([0.1, 0, 0])), path, path[-3:]]
        )
    if case == "twice":
        poses = np.repeat(poses, [1, 2, 3] * 20, axis=0)
    if case == "missing":
        path = np.delete(path, [0, 7, 8, 30, 59], axis=0)
    if case == "swapped":
        path[[20, 21]] = path[[21, 20]]
    found = match_poses([path], [poses], [()], TOLERANCE)
    target, met = plainly(path, poses, ())
    assert found.is_matched.tolist() == met
    assert found.target.tolist() == target
    assert found.checked_count == len(poses)
    assert (case in ("missing", "swapped")) == (not all(met))


def test_what_is_free_may_differ():
    poses = spiral(30)
    rotated = poses @ from_parts(
        exp_rotation(np.linspace(0, 0.5, 30)[:, None] * [0.0, 0.0, 1.0]), np.zeros(3)
    )
    assert match_poses([rotated], [poses], [SPIN], TOLERANCE).is_matched.all()
    assert not match_poses([rotated], [poses], [()], TOLERANCE).is_matched.all()
    assert (
        match_poses([rotated], [poses], [SPIN], TOLERANCE).target.tolist() == plainly(rotated, poses, SPIN)[0]
    )


def test_many_poses_take_work_in_proportion():
    poses = spiral(20_000)
    _, few = count_calls(match_poses, [poses[:2000]], [poses[:2000]], [()], TOLERANCE)
    found, many = count_calls(match_poses, [poses], [poses], [()], TOLERANCE)
    assert found.is_matched.all()
    assert found.target.tolist() == list(range(20_000))
    assert found.checked_count == 20_000
    assert many < 10.5 * few
    elsewhere = match_poses([poses], [from_parts(np.eye(3), np.ones(3)) @ poses], [()], TOLERANCE)
    assert elsewhere.checked_count == MAX_MISSED


AXES = np.eye(6)


@pytest.mark.parametrize("free", [(2,), (0, 2), (2, 3), (4, 2, 0), (5, 2)])
def test_values_of_free_axes_come_back(free):
    """Against the product of exponentials that made them, turns up to half a turn, slides up to 50 mm."""
    rng = np.random.default_rng(11)
    span = [(2.8 if j == free[-1] else 1.2) if j < 3 else 0.05 for j in free]
    expected = rng.uniform(-1.0, 1.0, (200, len(free))) * span
    relative = np.broadcast_to(np.eye(4), (200, 4, 4))
    for j, axis in enumerate(free):
        relative = relative @ exp_twist(expected[:, j, None] * AXES[axis])
    found, left = free_values(relative @ exp_twist(rng.normal(0.0, 1e-6, (200, 6))), [AXES[j] for j in free])
    assert np.abs(left).max() < 1e-5
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_two_tools_pass_their_poses_at_one_target():
    left, right = spiral(20), spiral(20) @ from_parts(np.eye(3), np.array([0.0, 0.0, 0.3]))
    paths = [left, right]
    assert match_poses(paths, [left, right], [(), ()], TOLERANCE).target.tolist() == list(range(20))
    late = np.concatenate([right[:1], right[:-1]])
    assert not match_poses([left, late], [left, right], [(), ()], TOLERANCE).is_matched.all()
