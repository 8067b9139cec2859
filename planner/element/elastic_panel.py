"""A panel cut by bent wires, and the joints between panels."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue

JOINT_PERCENTILE: Final = 95.0
"""Percentage of the points of a joint that must be within the allowed step."""


@dataclasses.dataclass(frozen=True)
class ElasticPanel:
    """A panel over a rectangle of cells. All lengths are in m.

    Attributes:
        rectangle: Cells (x0, x1, y0, y1).
        along: Direction of its wire: 0 along the element's x, 1 along y.
        wire: Index of the wire.
        block: Index of the kind of block.
        pose: Pose (4, 4) of its block in the element frame.
        size: Size (3,) of the block.
        front: Front face as the wire leaves it, in the block frame.
        back: Back face as the wire leaves it, in the block frame.
        misfit: Maximum distance of the faces from the surface.
        held: Whether the wire is held safely.
        rim_positions: Positions (R, 2) of the vertices on its sides in the element plane.
        rim_deviation: Distance (2, R) of front and back from the surface there.
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
    """Joint of two panels.

    Attributes:
        panels: Indices of the panels.
        length: Length along the joint [m].
        steps: Steps (2, R) [m] of the fronts and of the backs across the surface at its vertices.
        wire_ends: Whether wires of both panels end there.
        axis: Axis of the element across the joint.
        rows: Vertices (R, 2) of the joint among those on the sides of each panel.
    """

    panels: tuple[int, int]
    length: float
    steps: FloatArray
    wire_ends: bool
    axis: int
    rows: IntArray

    @property
    def step(self) -> float:
        """Step [m] that most of its points keep."""
        return float(np.percentile(self.steps, JOINT_PERCENTILE))


def find_joints(panels: Sequence[ElasticPanel]) -> tuple[ElasticJoint, ...]:
    """Return all joints along which neighbours share more than a corner."""
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
            rows = np.array([[rims[a][key], rims[b][key]] for key in shared])
            positions = first.rim_positions[rows[:, 0]]
            steps = np.abs(first.rim_deviation[:, rows[:, 0]] - second.rim_deviation[:, rows[:, 1]])
            ends = first.along == second.along == axis
            out.append(ElasticJoint((a, b), float(np.ptp(positions[:, 1 - axis])), steps, ends, axis, rows))
    return tuple(out)


def _common_side(first: tuple[int, ...], second: tuple[int, ...]) -> int | None:
    """Return the axis across the common side of two rectangles; None if they share at most a corner."""
    for axis in range(2):
        across, along = slice(2 * axis, 2 * axis + 2), slice(2 - 2 * axis, 4 - 2 * axis)
        (a0, a1), (b0, b1) = first[across], second[across]
        (c0, c1), (d0, d1) = first[along], second[along]
        if (a1 == b0 or b1 == a0) and min(c1, d1) > max(c0, d0):
            return axis
    return None
