"""What the page draws of a problem before it is planned: surfaces, block, and ways of tool points.

All as triangles; the ways of the tool points, of poses that a table gives, as thin bars.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from planner import processes
from planner.geometry.arrays import FloatArray, Mesh
from planner.issues import Issue, TandemError
from planner.problem import Problem
from planner.report.raster import part_meshes
from planner.units import MM

PROCESS: Final = "targets"
"""Its targets are as good as read from a file; those of other processes take planning."""
MOST: Final = 3000
"""Bars of one way; of longer ones some poses are left out."""
WIDTH: Final = 0.004
"""Of a bar, as a share of the way's extent and the block's."""


def paths(problem: Problem) -> tuple[list[tuple[str, Mesh]], list[Issue]]:
    """The ways by name, in the stock's frame [m], and what is wrong with their tables."""
    found: list[tuple[str, Mesh]] = []
    faults: list[Issue] = []
    for index, operation in enumerate(problem.operations):
        if operation.process != PROCESS:
            continue
        try:
            targets = processes.job(problem, index).targets()
        except TandemError as error:
            faults.extend(error.issues)
            continue
        stock = problem.setup_of(index).stock
        for arm in targets.arms:
            places = targets.pose[arm][:, :3, 3]
            if targets.frame[arm] == "world":
                if stock.place is None:  # the search will say where the block is
                    continue
                places = (places - stock.place[:3, 3]) @ stock.place[:3, :3]
            size = max(float(np.ptp(places, axis=0).max()), float(stock.size.max()))
            found.append((f"{operation.name}, {arm}", path_bars(places, WIDTH * size)))
    return found, faults


def path_bars(places: FloatArray, width: float) -> Mesh:
    """Bars of a square section from each place (N, 3) to the next one; equal places have none."""
    some = places[np.unique(np.linspace(0, len(places) - 1, MOST + 1).round().astype(int))]
    start, way = some[:-1], np.diff(some, axis=0)
    length = np.linalg.norm(way, axis=1)
    start, way, length = start[length > 0.0], way[length > 0.0], length[length > 0.0]
    along = way / length[:, None]
    other = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    across = np.cross(along, other)
    across *= 0.5 * width / np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(along, across)
    ring = np.stack([across + up, up - across, -across - up, across - up], axis=1)
    corners = np.concatenate([start[:, None] + ring, (start + way)[:, None] + ring], axis=1)
    sides = [(i, (i + 1) % 4, 4 + i) for i in range(4)]
    sides += [((i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    caps = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    faces = np.array(sides + caps)[None] + 8 * np.arange(len(start))[:, None, None]
    return Mesh(corners.reshape(-1, 3), faces.reshape(-1, 3))


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
    vertices: FloatArray = np.round(thin.vertices / MM, 3)
    return {
        "name": name,
        "kind": kind,
        "vertices": vertices.reshape(-1).tolist(),
        "faces": np.asarray(thin.faces).reshape(-1).tolist(),
    }
