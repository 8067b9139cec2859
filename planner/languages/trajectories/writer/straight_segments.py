"""Arms that follow trajectories, and straight segments of their tools: progress and inverse kinematics."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward_kinematics, jacobian
from planner.geometry.arrays import FloatArray, IntArray, exp_rotation, inverse, log_rotation

_MAX_NEWTON_STEPS: Final = 12
"""Maximum number of Newton steps."""
_NEWTON_TOLERANCE: Final = 1e-9
"""Convergence tolerance [m, rad]."""


@dataclasses.dataclass(frozen=True)
class TrajectoryArm:
    """An arm with what it carries.

    Attributes:
        robot: Data of the robot.
        base: Base in the world, (4, 4) [m].
        tcp: TCP in the flange frame, (4, 4) [m].
        columns: Columns of its joints among those of all arms.
        carrier: Arm that holds the block. The tool moves straight relative to its tool, or in the world if
            None.
    """

    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    columns: slice
    carrier: "TrajectoryArm | None" = None

    def tcp_pose(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (..., 4, 4) in the world for joints (..., D) of all arms."""
        return np.asarray(self.base @ forward_kinematics(self.robot, q[..., self.columns]) @ self.tcp)

    def relative_pose(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (..., 4, 4) in the frame in which the tool moves straight."""
        world_pose = self.tcp_pose(q)
        return (
            world_pose if self.carrier is None else np.asarray(inverse(self.carrier.tcp_pose(q)) @ world_pose)
        )

    def solve_joints(self, poses: FloatArray, q: FloatArray, rows: IntArray) -> FloatArray:
        """Return joints (K, J) of the arm at which its tool has given poses in that frame.

        Args:
            poses: The poses, (K, 4, 4) [m].
            q: Joints of all arms, (K, D): initial values of this arm, and the posture of a carrier.
            rows: Segment of each pose, (K,), for messages.

        Raises:
            NotKeptError: The iteration does not converge.
        """
        world_poses = poses if self.carrier is None else self.carrier.tcp_pose(q) @ poses
        return solve_joints(self, world_poses, q[:, self.columns], rows)


def carriers_first(arms: Sequence[TrajectoryArm]) -> list[TrajectoryArm]:
    """Return the arms with carriers before the arms that move relative to them."""
    return sorted(arms, key=lambda arm: arm.carrier is not None)


class PathNotKeptError(Exception):
    """No points keep the path.

    Attributes:
        row: Segment.
        reason: Reason.
        feed_fraction: Fraction of its minimum feed that can be kept, if this is the reason.
    """

    def __init__(self, row: int, reason: str, feed_fraction: float = 1.0) -> None:
        super().__init__(reason)
        self.row, self.reason, self.feed_fraction = row, reason, feed_fraction


def segment_progress(ends: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the progress (P - 1, S) of poses on straight segments, and lengths and angles (P - 1,).

    Lengths and angles are those of the segments.

    Args:
        ends: Ends of the segments, (P, 4, 4).
        poses: The poses, (P - 1, S, 4, 4).
    """
    step = np.diff(ends[:, :3, 3], axis=0)[:, None]
    turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    length, angle = np.linalg.norm(step, axis=2), np.linalg.norm(turn, axis=2)
    offset = poses[..., :3, 3] - ends[:-1, None, :3, 3]
    rotation = log_rotation(np.swapaxes(ends[:-1, None, :3, :3], -1, -2) @ poses[..., :3, :3])
    translation_progress = (offset * step).sum(axis=2) / np.maximum(length, 1e-9) ** 2
    rotation_progress = (rotation * turn).sum(axis=2) / np.maximum(angle, 1e-9) ** 2
    progress = np.where(length > 1e-6, translation_progress, np.where(angle > 1e-6, rotation_progress, 0.5))
    return np.clip(progress, 0.0, 1.0), length[:, 0], angle[:, 0]


def interpolate_segments(ends: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the poses (P - 1, S, 4, 4) at fractions of straight segments with uniform rotation.

    Args:
        ends: Ends of the segments, (P, 4, 4).
        fraction: Fractions, (P - 1, S).
    """
    turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    out = np.zeros((*fraction.shape, 4, 4))
    out[..., :3, :3] = ends[:-1, None, :3, :3] @ exp_rotation(fraction[..., None] * turn)
    out[..., :3, 3] = ends[:-1, None, :3, 3] + fraction[..., None] * np.diff(ends[:, :3, 3], axis=0)[:, None]
    out[..., 3, 3] = 1.0
    return out


def spread_fractions(fraction: FloatArray, rows: IntArray, count: int) -> FloatArray:
    """Return fractions (count, 1): the given ones in ``rows``, and one half elsewhere.

    Args:
        fraction: Fractions, (K,).
        rows: Their rows, (K,).
        count: Number of rows.
    """
    out = np.full((count, 1), 0.5)
    out[rows, 0] = fraction
    return out


def solve_joints(arm: TrajectoryArm, poses: FloatArray, q: FloatArray, rows: IntArray) -> FloatArray:
    """Return joints (K, J) at which the tool has given poses, by Newton's method.

    With seven joints the pseudoinverse takes the smallest steps: q += J^+ [r, p].

    Args:
        arm: The arm.
        poses: TCP poses in the world, (K, 4, 4) [m].
        q: Initial joints, (K, J) [rad].
        rows: Segment of each pose, (K,), for messages.

    Raises:
        NotKeptError: The iteration does not converge.
    """
    flange = inverse(arm.base) @ poses @ inverse(arm.tcp)
    out = q.copy()
    for _ in range(_MAX_NEWTON_STEPS):
        reached = forward_kinematics(arm.robot, out)
        turn = (
            reached[:, :3, :3]
            @ log_rotation(np.swapaxes(reached[:, :3, :3], 1, 2) @ flange[:, :3, :3])[..., None]
        )
        error = np.concatenate([turn[..., 0], flange[:, :3, 3] - reached[:, :3, 3]], axis=1)
        if np.abs(error).max(initial=0.0) <= _NEWTON_TOLERANCE:
            return out
        out = out + np.einsum("kij,kj->ki", np.linalg.pinv(jacobian(arm.robot, out)), error)
    worst = int(np.argmax(np.abs(error).max(axis=1)))
    raise PathNotKeptError(int(rows[worst]), "no joint solution exists on the straight segment")
