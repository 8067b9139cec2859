"""Arms that follow trajectories, and straight segments of their tools: progress and inverse kinematics.

On a straight segment between two poses, the TCP moves on a line and the tool rotates about a fixed axis, both
uniformly.
"""

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
        carrier: Arm that holds the block. The tool moves on straight segments relative to the TCP of this
            arm, or in the world if it is None.
    """

    robot: RobotData
    base: FloatArray
    tcp: FloatArray
    columns: slice
    carrier: "TrajectoryArm | None" = None

    def tcp_pose(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (..., 4, 4) [m] in the world for joints (..., D) [rad] of all arms."""
        return np.asarray(self.base @ forward_kinematics(self.robot, q[..., self.columns]) @ self.tcp)

    def relative_pose(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (..., 4, 4) [m] in the carrier's TCP frame, in the world without a carrier."""
        world_pose = self.tcp_pose(q)
        return (
            world_pose if self.carrier is None else np.asarray(inverse(self.carrier.tcp_pose(q)) @ world_pose)
        )

    def solve_joints(self, poses: FloatArray, q: FloatArray, rows: IntArray) -> FloatArray:
        """Return the joints (K, J) [rad] of the arm at which `relative_pose` gives the poses ``poses``.

        Args:
            poses: The poses, (K, 4, 4) [m].
            q: Joints of all arms, (K, D) [rad]: initial values of this arm, and the posture of its carrier.
            rows: Index of the segment of each pose, (K,), for messages.

        Raises:
            PathNotKeptError: The iteration does not converge.
        """
        world_poses = poses if self.carrier is None else self.carrier.tcp_pose(q) @ poses
        return solve_joints(self, world_poses, q[:, self.columns], rows)


def carriers_first(arms: Sequence[TrajectoryArm]) -> list[TrajectoryArm]:
    """Return the arms with carriers before the arms that move relative to them."""
    return sorted(arms, key=lambda arm: arm.carrier is not None)


class PathNotKeptError(Exception):
    """No points were found that keep the path within its tolerances and limits.

    Attributes:
        row: Index of the segment on which they fail.
        reason: Reason, for a message.
        feed_fraction: Fraction of the segment's minimum feed that is possible; 1 for other reasons.
    """

    def __init__(self, row: int, reason: str, feed_fraction: float = 1.0) -> None:
        super().__init__(reason)
        self.row = row
        self.reason = reason
        self.feed_fraction = feed_fraction


def segment_progress(ends: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the progress of poses along straight segments.

    The deviation of a pose is measured at this progress. It is that of the nearest position on the segment,
    or of the nearest rotation if the segment has no length, or 0.5 if it has neither length nor angle.

    Args:
        ends: Common ends of consecutive segments, (P, 4, 4) [m].
        poses: S poses near each segment, (P - 1, S, 4, 4) [m].

    Returns:
        Progress (P - 1, S) from 0 to 1, and lengths [m] and angles [rad] of the segments, (P - 1,) each.
    """
    step = np.diff(ends[:, :3, 3], axis=0)[:, None]
    segment_rotation = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    length = np.linalg.norm(step, axis=2)
    angle = np.linalg.norm(segment_rotation, axis=2)
    offset = poses[..., :3, 3] - ends[:-1, None, :3, 3]
    rotation = log_rotation(np.swapaxes(ends[:-1, None, :3, :3], -1, -2) @ poses[..., :3, :3])
    translation_progress = (offset * step).sum(axis=2) / np.maximum(length, 1e-9) ** 2
    rotation_progress = (rotation * segment_rotation).sum(axis=2) / np.maximum(angle, 1e-9) ** 2
    progress = np.where(length > 1e-6, translation_progress, np.where(angle > 1e-6, rotation_progress, 0.5))
    return np.clip(progress, 0.0, 1.0), length[:, 0], angle[:, 0]


def interpolate_segments(ends: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the poses (P - 1, S, 4, 4) at fractions of straight segments with uniform rotation.

    Args:
        ends: Common ends of consecutive segments, (P, 4, 4) [m].
        fraction: S fractions of each segment, (P - 1, S).
    """
    segment_rotation = log_rotation(np.swapaxes(ends[:-1, :3, :3], -1, -2) @ ends[1:, :3, :3])[:, None]
    out = np.zeros((*fraction.shape, 4, 4))
    out[..., :3, :3] = ends[:-1, None, :3, :3] @ exp_rotation(fraction[..., None] * segment_rotation)
    out[..., :3, 3] = ends[:-1, None, :3, 3] + fraction[..., None] * np.diff(ends[:, :3, 3], axis=0)[:, None]
    out[..., 3, 3] = 1.0
    return out


def spread_fractions(fraction: FloatArray, rows: IntArray, count: int) -> FloatArray:
    """Return one fraction for each of ``count`` segments, (count, 1), as `interpolate_segments` takes them.

    Args:
        fraction: Fractions of some segments, (K,); the others get 0.5, whose poses the caller ignores.
        rows: Indices of these segments, (K,).
        count: Number of segments.
    """
    out = np.full((count, 1), 0.5)
    out[rows, 0] = fraction
    return out


def solve_joints(arm: TrajectoryArm, poses: FloatArray, q: FloatArray, rows: IntArray) -> FloatArray:
    """Return the joints (K, J) [rad] at which the TCP has the poses ``poses``, by Newton's method.

    The step is q += J^+ [r, p], with the pseudoinverse J^+ of the Jacobian, the rotation vector r and the
    translation p from the reached to the required flange pose. For seven joints it is the smallest step.

    Args:
        arm: The arm.
        poses: TCP poses in the world, (K, 4, 4) [m].
        q: Initial joints, (K, J) [rad].
        rows: Index of the segment of each pose, (K,), for messages.

    Raises:
        PathNotKeptError: The iteration does not converge.
    """
    flange = inverse(arm.base) @ poses @ inverse(arm.tcp)
    out = q.copy()
    for _ in range(_MAX_NEWTON_STEPS):
        reached = forward_kinematics(arm.robot, out)
        rotation = (
            reached[:, :3, :3]
            @ log_rotation(np.swapaxes(reached[:, :3, :3], 1, 2) @ flange[:, :3, :3])[..., None]
        )
        error = np.concatenate([rotation[..., 0], flange[:, :3, 3] - reached[:, :3, 3]], axis=1)
        if np.abs(error).max(initial=0.0) <= _NEWTON_TOLERANCE:
            return out
        out = out + np.einsum("kij,kj->ki", np.linalg.pinv(jacobian(arm.robot, out)), error)
    worst_index = int(np.argmax(np.abs(error).max(axis=1)))
    raise PathNotKeptError(int(rows[worst_index]), "no joint solution exists on the straight segment")
