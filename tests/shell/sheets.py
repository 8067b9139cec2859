"""Sheets for the tests: cones, plates, an uneven patch, and their loads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.geometry.arrays import FloatArray, lengths
from planner.shell.element import Membrane, ShellSheet
from planner.shell.mesh import ShellMesh, cone_rings, mesh_sheet

WINDOW = 0.125 * np.array([[-1.0, -1.0], [1.0, 1.0]])
"""A clamp of 250 x 250 mm."""


def metal(
    mesh: ShellMesh, youngs: float = 68e9, poisson: float = 0.3, membrane: Membrane = "optimal"
) -> ShellSheet:
    """1 mm of aluminium, walls thinned by the sine law (thickness x cosine of the wall angle)."""
    corners = mesh.nodes[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return ShellSheet(
        mesh.nodes, mesh.triangles, 1e-3 * normal[:, 2] / lengths(normal), youngs, poisson, membrane
    )


def plate(
    triangles: int, youngs: float = 68e9, poisson: float = 0.3, membrane: Membrane = "optimal"
) -> ShellSheet:
    """A flat sheet of 250 x 250 x 1 mm with a node in the middle."""
    return metal(mesh_sheet([], WINDOW, triangles, np.zeros((1, 2))), youngs, poisson, membrane)


def cone(radius: float, triangles: int, membrane: Membrane = "optimal") -> tuple[ShellSheet, FloatArray]:
    """A cone of 45 degrees, 20 mm deep, and a place at its floor's edge."""
    points = np.array([radius - 0.02, 0.0])
    rings = cone_rings(radius, np.radians(45.0), 0.02)
    return metal(mesh_sheet(rings, WINDOW, triangles, points[None]), membrane=membrane), points


def down(*forces: float) -> FloatArray:
    """Loads (k, 3) [N] along -z."""
    return np.array([[0.0, 0.0, -force] for force in forces])


def patch(membrane: Membrane, thickness: float = 1e-3) -> tuple[ShellSheet, Sequence[int]]:
    """A rectangle of 24 x 12 mm of uneven triangles, and its nodes inside."""
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.linspace(0.0, 24e-3, 5), np.linspace(0.0, 12e-3, 4)))
    inside = np.flatnonzero((x > 1e-9) & (x < 23.9e-3) & (y > 1e-9) & (y < 11.9e-3))
    deviation = np.random.default_rng(3).uniform(-1.2e-3, 1.2e-3, (len(inside), 2))
    nodes = np.column_stack([x, y, np.zeros(len(x))])
    nodes[inside, :2] += deviation
    corner = (np.arange(3)[:, None] * 5 + np.arange(4)).reshape(-1)
    quads = np.column_stack([corner, corner + 1, corner + 6, corner + 5])
    odd = (corner % 2 == 1)[:, None]
    one = np.where(odd, quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
    two = np.where(odd, quads[:, [1, 2, 3]], quads[:, [0, 2, 3]])
    triangles = np.concatenate([one, two])
    return ShellSheet(
        nodes, triangles, np.full(len(triangles), thickness), 70e9, 0.33, membrane
    ), inside.tolist()
