"""What the page draws of a problem before it is planned: the part's surfaces and the block, as triangles."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue
from planner.problem import Mesh, Problem
from planner.report.sweep import part_meshes
from planner.service.page.paths import paths
from planner.units import MM

FINEST: Final = 60_000
"""Meshes of more triangles are thinned out for the picture."""
CELLS: Final = (400, 200, 100, 50)
"""Vertices within the same cell become one; so many cells along the longest side, until it is few enough."""


def shapes(problem: Problem) -> tuple[list[dict[str, Any]], list[Issue]]:
    """Bodies in the stock's frame [mm]: ``name``, ``kind`` (part, path, stock), ``vertices`` and ``faces``,
    both flat lists; and what is wrong with tables of poses."""
    named = list(part_meshes(problem.part))
    if problem.part is not None and problem.part.formed is not None:
        named.append(("formed sheet", problem.part.formed.mesh))
    bodies = [_body(name, "part", mesh) for name, mesh in named if len(mesh.faces)]
    ways, faults = paths(problem)
    bodies += [_body(name, "path", mesh) for name, mesh in ways]
    bodies.append(_body("sheet" if problem.stock.sheet is not None else "block", "stock", _box(problem)))
    return bodies, faults


def thinned(mesh: Mesh, most: int = FINEST) -> Mesh:
    """The mesh with neighbouring vertices joined until at most ``most`` triangles are left, if that is
    possible with a grid of 50 cells."""
    size = float(np.ptp(mesh.vertices, axis=0).max()) if len(mesh.vertices) else 0.0
    thin = mesh
    for cells in CELLS:
        if len(thin.faces) <= most or size <= 0.0:
            break
        thin = _joined(mesh, size / cells)
    return thin


def _joined(mesh: Mesh, cell: float) -> Mesh:
    """Vertices of the same cell (V, 3) of a grid become their mean; triangles that collapse are left out."""
    grid = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    _, inverse, count = np.unique(grid, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    total = np.zeros((len(count), 3))
    np.add.at(total, inverse, mesh.vertices)
    faces = inverse[mesh.faces]
    a, b, c = faces.T
    return Mesh(total / count[:, None], faces[(a != b) & (b != c) & (c != a)])


def _box(problem: Problem) -> Mesh:
    low, high = problem.stock.lower, problem.stock.upper
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))]
    return Mesh(low + corners * (high - low), np.array(faces, dtype=np.int64))


def _body(name: str, kind: str, mesh: Mesh) -> dict[str, Any]:
    thin = thinned(mesh) if kind == "part" else mesh
    vertices: NDArray[np.float64] = np.round(thin.vertices / MM, 3)
    return {
        "name": name,
        "kind": kind,
        "vertices": vertices.reshape(-1).tolist(),
        "faces": np.asarray(thin.faces).reshape(-1).tolist(),
    }
