"""Reduction of the step at a joint between two bent wires: one panel follows the other.

Its target is offset from the surface at the joint by as much as the faces of the other are, and fades back to
the surface beside the joint. A wire that ends at a joint can end at any prescribed position, so such a panel
can match nearly any edge of one whose wire lies along the joint. The neighbour is unchanged.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.element.elastic_panel import ElasticJoint, ElasticPanel
from planner.geometry.arrays import FloatArray

FADE_DISTANCE_M: Final = 0.12
"""Distance [m] from a joint at which a following panel is back on the surface."""


@dataclasses.dataclass(frozen=True)
class FollowedOffset:
    """Offset that a panel follows on the line ``at`` [m] of an ``axis``.

    Attributes:
        axis: Axis across the line.
        at: Position of the line [m].
        along: Positions (K,) [m] on the other axis, ascending.
        offsets: Distance (2, K) [m] of front and back from the surface there.
    """

    axis: int
    at: float
    along: FloatArray
    offsets: FloatArray

    def offset_at(self, flat: FloatArray) -> FloatArray:
        """Return the offset (2, V) [m] of both faces at positions ``flat`` (V, 2) in the element plane."""
        along = flat[:, 1 - self.axis]
        beyond = np.maximum(self.along[0] - along, along - self.along[-1])
        factor = _smooth_step(np.abs(flat[:, self.axis] - self.at)) * _smooth_step(np.maximum(beyond, 0.0))
        return np.stack([factor * np.interp(along, self.along, offset) for offset in self.offsets])


def _smooth_step(distance: FloatArray) -> FloatArray:
    """Return a smooth step s = 3 x^2 - 2 x^3 with x = 1 - d / d_0, 0 from `FADE_DISTANCE_M` d_0 on."""
    left = np.clip(1.0 - distance / FADE_DISTANCE_M, 0.0, 1.0)
    return np.asarray(left * left * (3.0 - 2.0 * left))


def followed_offset(joint: ElasticJoint, neighbour: int, panel: ElasticPanel) -> FollowedOffset:
    """Return what the other panel of a joint follows.

    Args:
        joint: Joint.
        neighbour: Which panel of the joint ``panel`` is, 0 or 1.
        panel: Panel to follow.
    """
    rows = joint.rows[:, neighbour]
    positions = panel.rim_positions[rows]
    order = np.argsort(positions[:, 1 - joint.axis])
    at = float(positions[0, joint.axis])
    return FollowedOffset(
        joint.axis, at, positions[order, 1 - joint.axis], panel.rim_deviation[:, rows[order]]
    )
