"""A panel cut by bent wires, and the joints between panels."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue

JOINT_PERCENTILE: Final = 95.0
"""Percentage of the points of a joint whose step must be within the limit."""


@dataclasses.dataclass(frozen=True)
class ElasticPanel:
    """A panel over a rectangle of cells. All lengths are in m.

    Attributes:
        rectangle: Cells (x0, x1, y0, y1).
        along: Direction of its wire: 0 along the element's x, 1 along y.
        wire: Index of the wire in the rules.
        block: Index of the kind of block in the rules.
        pose: Pose (4, 4) of its block in the element frame.
        size: Size (3,) of the block.
        front: Front face as the wire leaves it, in the block frame.
        back: Back face as the wire leaves it, in the block frame.
        misfit: Maximum distance of the faces from the surface.
        held: Whether the wire is held safely.
        rim_positions: Positions (R, 2) of the vertices on its sides in the element plane.
        rim_deviation: Signed distance (2, R) of front and back from the surface there.
        refused: Why the check of its problem refuses it; None if it does not or was not run.
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
    rim_positions: FloatArray
    rim_deviation: FloatArray
    refused: Issue | None = None


@dataclasses.dataclass(frozen=True)
class ElasticJoint:
    """Joint between two panels.

    Attributes:
        panels: Indices of the panels.
        length: Length along the joint [m].
        steps: Steps (2, R) [m] between the fronts and between the backs at its vertices, across the surface.
        wire_ends: Whether the wires of both panels end at the joint.
        axis: Axis of the element across the joint.
        rows: Indices (R, 2) of its vertices in the ``rim_positions`` of both panels.
    """

    panels: tuple[int, int]
    length: float
    steps: FloatArray
    wire_ends: bool
    axis: int
    rows: IntArray

    @property
    def step(self) -> float:
        """Step [m] that `JOINT_PERCENTILE` percent of its points do not exceed."""
        return float(np.percentile(self.steps, JOINT_PERCENTILE))


def find_joints(panels: Sequence[ElasticPanel]) -> tuple[ElasticJoint, ...]:
    """Return the joints of all pairs of panels that share more than a corner."""
    # positions are compared in steps of 0.1 um, since neighbours compute them separately
    rims = [
        {(round(x * 1e7), round(y * 1e7)): k for k, (x, y) in enumerate(panel.rim_positions.tolist())}
        for panel in panels
    ]
    out = []
    for a, first in enumerate(panels):
        for b in range(a + 1, len(panels)):
            second = panels[b]
            axis = _common_side(first.rectangle, second.rectangle)
            if axis is None:
                continue
            shared = sorted(rims[a].keys() & rims[b].keys())
            indices = np.array([[rims[a][key], rims[b][key]] for key in shared])
            positions = first.rim_positions[indices[:, 0]]
            steps = np.abs(first.rim_deviation[:, indices[:, 0]] - second.rim_deviation[:, indices[:, 1]])
            ends = first.along == second.along == axis
            out.append(
                ElasticJoint((a, b), float(np.ptp(positions[:, 1 - axis])), steps, ends, axis, indices)
            )
    return tuple(out)


def _common_side(first: tuple[int, ...], second: tuple[int, ...]) -> int | None:
    """Return the axis across the common side of rectangles (x0, x1, y0, y1); None for a corner or nothing."""
    for axis in range(2):
        across, along = slice(2 * axis, 2 * axis + 2), slice(2 - 2 * axis, 4 - 2 * axis)
        (a0, a1), (b0, b1) = first[across], second[across]
        (c0, c1), (d0, d1) = first[along], second[along]
        if (a1 == b0 or b1 == a0) and min(c1, d1) > max(c0, d0):
            return axis
    return None
