"""What a wire leaves behind it in the block, as strips between its places one after the other."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.problem import Mesh, Part, Ruled, Stock

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
STRAIGHT: Final = 3
"""Points that a straight wire is drawn by; two neighbouring rulings may be warped."""


def clipped(ends: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """The part of straight wires with ends (T, 2, 3) that lies in the box, as (T, STRAIGHT, 3) points; NaN
    where none does.

    Slabs: the ray's parameters of entry and exit are the greatest and the least of those of the three pairs
    of planes (Kay and Kajiya 1986).
    """
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (lower - start) / way, (upper - start) / way
    along = np.abs(way) < 1e-12
    inside = (start >= lower) & (start <= upper)
    first = np.where(along, np.where(inside, -np.inf, np.inf), np.minimum(one, other)).max(axis=1)
    last = np.where(along, np.where(inside, np.inf, -np.inf), np.maximum(one, other)).min(axis=1)
    first, last = np.maximum(first, 0.0), np.minimum(last, 1.0)
    hit = last > first
    first, last = np.where(hit, first, 0.0), np.where(hit, last, 0.0)
    share = np.linspace(0.0, 1.0, STRAIGHT)
    at = first[:, None] + (last - first)[:, None] * share
    points = start[:, None] + at[..., None] * way[:, None]
    points[~hit] = np.nan
    return np.asarray(points)


def surface(points: FloatArray, lower: FloatArray, upper: FloatArray) -> Mesh | None:
    """What wires (T, P, 3) in the stock frame sweep, one after the other, as far as it lies in the box; None
    if it does not. Straight wires are given by their two ends."""
    if points.shape[1] == 2:
        points = clipped(points, lower, upper)
    count = points.shape[1]
    i, j = np.meshgrid(np.arange(len(points) - 1), np.arange(count - 1), indexing="ij")
    a = (i * count + j).ravel()
    quads = np.stack([a, a + 1, a + count + 1, a + count], axis=1)
    vertices = points.reshape(-1, 3)
    middle = vertices[quads].mean(axis=1)
    with np.errstate(invalid="ignore"):
        inside = ((middle >= lower - 1e-9) & (middle <= upper + 1e-9)).all(axis=1)
    quads = quads[inside]
    if not len(quads):
        return None
    used, place = np.unique(quads, return_inverse=True)
    quads = place.reshape(quads.shape)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(vertices[used], faces.astype(np.int64))


def alike(one: Stock, other: Stock) -> bool:
    """Whether two blocks are of one size."""
    return np.allclose(one.lower, other.lower) and np.allclose(one.upper, other.upper)


def part_meshes(part: Part | None) -> tuple[tuple[str, Mesh], ...]:
    """The wanted surfaces by name, in the stock frame."""
    if part is None:
        return ()
    open_ = [(name, mesh) for name, mesh in (("front", part.front), ("back", part.back)) if mesh is not None]
    return (*open_, *((surface.name, ruled_mesh(surface)) for surface in part.ruled))


def ruled_mesh(surface: Ruled) -> Mesh:
    """Triangles between the rulings, with normals along tangent x ruling; a corner parts the vertices."""
    rows = np.arange(len(surface.start))
    if surface.closed:
        rows = np.append(rows, 0)
    corner = surface.corner[rows]
    # every ruling inside a stretch serves both its neighbours; one at a corner stands twice
    twice = np.repeat(rows, np.where(corner, 2, 1))
    left = np.cumsum(np.where(corner, 2, 1)) - 1
    a, b = left[:-1], left[1:] - np.where(corner[1:], 1, 0)
    vertices = np.stack([surface.start[twice], surface.end[twice]], axis=1).reshape(-1, 3)
    faces = np.concatenate(
        [np.stack([2 * a, 2 * b, 2 * b + 1], axis=1), np.stack([2 * a, 2 * b + 1, 2 * a + 1], axis=1)]
    )
    return Mesh(vertices, faces.astype(np.int64))
