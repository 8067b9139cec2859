"""Where two wires leave a step at a joint, one panel follows the other: its target is moved off the surface
there by as much as the other's faces are, and fades back to the surface beside the joint.

A wire that ends at a joint ends wherever it is asked to, so such a panel takes nearly any edge of one whose
wire lies along the joint. The neighbour stays as it is.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.element.elastic_panel import ElasticPanel, Joint
from planner.geometry.arrays import FloatArray

REACH: Final = 0.12
"""So far [m] from a joint a panel that follows its neighbour is back on the surface."""


@dataclasses.dataclass(frozen=True)
class Lead:
    """What a panel follows on the line ``at`` [m] of an ``axis``: how far, ``off`` (2, K) [m], front and back
    are off the surface there, at places ``along`` (K,) [m] on the other axis, rising."""

    axis: int
    at: float
    along: FloatArray
    off: FloatArray

    def over(self, flat: FloatArray) -> FloatArray:
        """How far (2, V) [m] both faces are to be off the surface at places ``flat`` (V, 2) of the element's
        plane."""
        along = flat[:, 1 - self.axis]
        beyond = np.maximum(self.along[0] - along, along - self.along[-1])
        share = _faded(np.abs(flat[:, self.axis] - self.at)) * _faded(np.maximum(beyond, 0.0))
        return np.stack([share * np.interp(along, self.along, off) for off in self.off])


def _faded(distance: FloatArray) -> FloatArray:
    """1 at the joint, 0 from `REACH` [m] on, without a kink."""
    left = np.clip(1.0 - distance / REACH, 0.0, 1.0)
    return np.asarray(left * left * (3.0 - 2.0 * left))


def lead(joint: Joint, neighbour: int, panel: ElasticPanel) -> Lead:
    """What the other panel of a ``joint`` follows, where ``panel`` is its first (``neighbour`` 0) or its
    second one (1)."""
    rows = joint.rows[:, neighbour]
    place = panel.flat[rows]
    order = np.argsort(place[:, 1 - joint.axis])
    at = float(place[0, joint.axis])
    return Lead(joint.axis, at, place[order, 1 - joint.axis], panel.off[:, rows[order]])
