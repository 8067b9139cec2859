"""Reduction of the step at a joint between two bent wires: one panel follows the other.

The target of the following panel is offset from the surface at the joint by as much as the faces of the other
panel. The offset fades to zero away from the joint. A wire that ends at a joint can end at any prescribed
position, so such a panel can match nearly any edge of one whose wire lies along the joint. The neighbour is
unchanged.
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
    """Offset from the surface that a panel follows at a joint.

    Attributes:
        axis: Axis of the element across the joint.
        at: Position of the joint on that axis [m].
        along: Positions (K,) [m] on the other axis, ascending.
        offsets: Signed distance (2, K) [m] of front and back of the followed panel from the surface there.
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
    """Return s = 3 x^2 - 2 x^3 with x = 1 - d / d_0: 1 at d = 0, and 0 from d_0 = `FADE_DISTANCE_M` on."""
    x = np.clip(1.0 - distance / FADE_DISTANCE_M, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))


def followed_offset(joint: ElasticJoint, neighbour: int, panel: ElasticPanel) -> FollowedOffset:
    """Return the offset of a panel at a joint, for the other panel of the joint to follow.

    Args:
        joint: Joint.
        neighbour: Index, 0 or 1, of ``panel`` in ``joint.panels``.
        panel: Panel to follow.
    """
    rim_indices = joint.rows[:, neighbour]
    positions = panel.rim_positions[rim_indices]
    order = np.argsort(positions[:, 1 - joint.axis])
    at = float(positions[0, joint.axis])
    return FollowedOffset(
        joint.axis, at, positions[order, 1 - joint.axis], panel.rim_deviation[:, rim_indices[order]]
    )
