"""A panel for the bent wire, and the joints at which several meet."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue

JOINT_SHARE: Final = 95.0
"""Percent of a joint's points that must be within the step that is allowed."""


@dataclasses.dataclass(frozen=True)
class ElasticPanel:
    """A panel over the cells ``rectangle`` (x0, x1, y0, y1), its wire along the element's x (``along`` 0) or
    y (1).

    ``front``, ``back``: faces as the wire leaves them, in the frame of the block of ``size`` (3,), whose
    ``pose`` (4, 4) is in the element frame. ``misfit``: how far they are off the surface at most; ``held``:
    whether the wire is held safely there. ``flat`` (R, 2): where the vertices on its sides are in the
    element's plane; ``off`` (2, R): how far front and back are off the surface there. ``refused``: why the
    check of its problem refuses it; none where that was not asked. In m.
    """

    rectangle: tuple[int, int, int, int]
    along: int
    wire: int
    block: int
    pose: FloatArray
    size: FloatArray
    front: TriangleMesh
    back: TriangleMesh
    misfit: float
    held: bool
    flat: FloatArray
    off: FloatArray
    refused: Issue | None = None


@dataclasses.dataclass(frozen=True)
class Joint:
    """Where two panels meet: their numbers, ``length`` [m] along the joint, ``steps`` (2, R) [m] of the
    fronts and of the backs across the surface at its vertices; ``wire_ends``: whether wires of both end
    there. ``axis``: that of the element across it; ``rows`` (R, 2): its vertices among those on the sides of
    each."""

    panels: tuple[int, int]
    length: float
    steps: FloatArray
    wire_ends: bool
    axis: int
    rows: IntArray

    @property
    def step(self) -> float:
        """The step [m] that most of its points keep."""
        return float(np.percentile(self.steps, JOINT_SHARE))


def joints(panels: Sequence[ElasticPanel]) -> tuple[Joint, ...]:
    """All joints along which neighbours have more than a corner in common."""
    rims = [
        {(round(x * 1e7), round(y * 1e7)): k for k, (x, y) in enumerate(panel.flat.tolist())}
        for panel in panels
    ]
    found = []
    for a, one in enumerate(panels):
        for b in range(a + 1, len(panels)):
            other = panels[b]
            axis = _side(one.rectangle, other.rectangle)
            if axis is None:
                continue
            shared = sorted(rims[a].keys() & rims[b].keys())
            rows = np.array([[rims[a][key], rims[b][key]] for key in shared])
            place = one.flat[rows[:, 0]]
            steps = np.abs(one.off[:, rows[:, 0]] - other.off[:, rows[:, 1]])
            ends = one.along == other.along == axis
            found.append(Joint((a, b), float(np.ptp(place[:, 1 - axis])), steps, ends, axis, rows))
    return tuple(found)


def _side(one: tuple[int, ...], other: tuple[int, ...]) -> int | None:
    """The axis across the line on which two rectangles meet; None where they share no more than a corner."""
    for axis in range(2):
        across, along = slice(2 * axis, 2 * axis + 2), slice(2 - 2 * axis, 4 - 2 * axis)
        (a0, a1), (b0, b1) = one[across], other[across]
        (c0, c1), (d0, d1) = one[along], other[along]
        if (a1 == b0 or b1 == a0) and min(c1, d1) > max(c0, d0):
            return axis
    return None
