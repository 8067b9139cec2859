"""Forward kinematics of a serial chain, computed in batches."""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray

POSTURES_PER_BATCH: Final = 4096
"""Number of postures computed in one batch. Chosen so that the arrays stay in the processor's cache."""


@dataclasses.dataclass(frozen=True, eq=False)
class SerialChain:
    """Serial chain of J revolute joints: six, or seven for a robot defined by the user's own URDF.

    Attributes:
        links: Names of the links that the joints move, and of the tip, which is fixed to the last link.
        zero: Poses (J + 1, 4, 4) of these links in the base with all joints at zero.
        axis: Unit vectors (J, 3) of the joint axes in the base, at zero. Axis i passes through the origin
            of frame i.
        lower: Lower joint limits (J,) [rad], NaN if the file states none.
        upper: Upper joint limits (J,) [rad], NaN if the file states none.
        velocity: Maximum joint speeds (J,) [rad/s], NaN if the file states none.
        step: Transforms (J + 1, 4, 4) from each joint frame, with its axis along z, to the next one. The
            first starts at the base, the last ends at the tip.
        axis_alignment: Rotations (J, 3, 3) that align z with the joint axes in the frames of the links.
    """

    links: tuple[str, ...]
    zero: FloatArray
    axis: FloatArray
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    step: FloatArray
    axis_alignment: FloatArray

    def tip(self, q: FloatArray) -> FloatArray:
        """Compute poses (..., 4, 4) of the tip in the base at joint angles ``q`` (..., J) [rad]."""
        return self._compute_frames(q, tip_only=True)[..., 0, :, :]

    def frames(self, q: FloatArray) -> FloatArray:
        """Compute poses (..., J + 1, 4, 4) of all links and the tip in the base.

        Args:
            q: Joint angles (..., J) [rad].
        """
        return self._compute_frames(q, tip_only=False)

    def _compute_frames(self, q: FloatArray, tip_only: bool) -> FloatArray:
        """Compute poses (..., J + 1 or 1, 4, 4) at joint angles (..., J) [rad], in batches of postures."""
        count = len(self.axis)
        postures = np.asarray(q, dtype=np.float64).reshape(-1, count)
        out = np.zeros((len(postures), 1 if tip_only else count + 1, 4, 4))
        out[..., 3, 3] = 1.0
        for first in range(0, len(postures), POSTURES_PER_BATCH):
            batch = slice(first, first + POSTURES_PER_BATCH)
            self._fill_frames(postures[batch], out[batch], tip_only)
        return out.reshape(*np.shape(q)[:-1], *out.shape[1:])

    def _fill_frames(self, q: FloatArray, out: FloatArray, tip_only: bool) -> None:
        """Fill ``out`` (B, J + 1 or 1, 4, 4) with poses.

        The x, y and z axes of all frames are the rows of an array (3, 3 B), with the first coordinates of all
        B postures first. Positions (3 B,) have the same order. A rotation about z then combines two rows, and
        a step to the next joint is one product with a constant matrix.

        Args:
            q: Joint angles (B, J) [rad].
            out: Poses to be filled. Their last row is set already.
            tip_only: Whether only the pose of the tip is written.
        """
        count = len(q)
        cos, sin = (np.tile(f(q.T), 3) for f in (np.cos, np.sin))
        axes = np.repeat(self.step[0, :3, :3].T, count, axis=1)
        positions = np.repeat(self.step[0, :3, 3], count)
        for i in range(len(self.axis)):
            x, y = axes[0], axes[1]
            axes = np.stack([cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x, axes[2]])
            if not tip_only:
                _write_poses(out[:, i], self.axis_alignment[i] @ axes, positions)
            positions = positions + self.step[i + 1, :3, 3] @ axes
            axes = self.step[i + 1, :3, :3].T @ axes
        _write_poses(out[:, -1], axes, positions)


def _write_poses(out: FloatArray, axes: FloatArray, positions: FloatArray) -> None:
    """Write axes (3, 3 B) and positions (3 B,) as poses (B, 4, 4)."""
    out[:, :3, :3] = axes.reshape(3, 3, -1).transpose(2, 1, 0)
    out[:, :3, 3] = positions.reshape(3, -1).T
