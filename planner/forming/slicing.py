"""Level lines of a height over a mesh, all levels at once."""

from __future__ import annotations

import numpy as np

from planner.forming.surface import SheetSurface
from planner.forming.values import FloatArray, IntArray


def slice_levels(
    surface: SheetSurface, height: FloatArray, levels: FloatArray
) -> tuple[tuple[FloatArray, ...], ...]:
    """For each of the ascending ``levels`` (L,) [m] the level lines of ``height`` (V,) [m].

    Lines are closed polylines (K, 3) [m], the first point repeated at the end, counter-clockwise seen from
    above, with z at the level. A vertex at a level counts as above it, so that flats at a level do no harm.
    ``height`` may differ from the surface's own where it is held constant; then the place of a line between
    two vertices is that of the surface where it can be. No level line may meet the surface's border.
    """
    faces, below = surface.faces, np.searchsorted(levels, height, side="right")
    first, last = below[faces].min(axis=1), below[faces].max(axis=1)
    crossed = np.nonzero(last > first)[0]
    if len(crossed) == 0:
        return tuple(() for _ in levels)
    corner = below[faces[crossed]]
    count = last[crossed] - first[crossed]
    owner = np.repeat(np.arange(len(crossed)), count)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    level = first[crossed][owner] + offset
    above = corner[owner] > level[:, None]
    # going round a face counter-clockwise the line leaves by the edge that comes down to below the level and
    # enters by the one that goes up: then what is above lies on its left
    rises = ~above & np.roll(above, -1, axis=1)
    falls = above & ~np.roll(above, -1, axis=1)
    edge = surface.face_edges[crossed[owner]]
    edges = len(surface.edges)
    enter = level * edges + edge[np.arange(len(owner)), np.argmax(rises, axis=1)]
    leave = level * edges + edge[np.arange(len(owner)), np.argmax(falls, axis=1)]
    node, target = np.unique(leave, return_inverse=True)
    order = np.argsort(enter)
    if not np.array_equal(enter[order], node):
        raise ValueError("a level line meets the border of the surface")
    follower = np.reshape(target, -1)[order]
    loop, rank = _rings(follower)
    sorted_ = np.lexsort((rank, loop))
    points = _points(surface, height, levels, node, edges)[sorted_]
    starts = np.nonzero(np.diff(loop[sorted_], prepend=-1))[0]
    lines: list[list[FloatArray]] = [[] for _ in levels]
    for start, stop in zip(starts, [*starts[1:].tolist(), len(points)], strict=True):
        line = _closed(points[start:stop])
        if line is not None:
            lines[int(node[sorted_[start]] // edges)].append(line)
    return tuple(tuple(group) for group in lines)


def area(line: FloatArray) -> float:
    """Signed area [m^2] of a closed polyline (K, 2 or 3) seen from above."""
    x, y = line[:, 0] - line[0, 0], line[:, 1] - line[0, 1]
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _points(
    surface: SheetSurface, height: FloatArray, levels: FloatArray, node: IntArray, edges: int
) -> FloatArray:
    level = levels[node // edges]
    a, b = surface.edges[node % edges].T
    p, q = surface.vertices[a], surface.vertices[b]
    own = (level - p[:, 2]) / np.where(q[:, 2] == p[:, 2], 1.0, q[:, 2] - p[:, 2])
    held = (level - height[a]) / (height[b] - height[a])
    own_meets = (q[:, 2] != p[:, 2]) & (own >= 0.0) & (own <= 1.0)
    points = p + np.where(own_meets, own, held)[:, None] * (q - p)
    points[:, 2] = level
    return np.asarray(points)


def _rings(follower: IntArray) -> tuple[IntArray, IntArray]:
    """For a permutation (N,) the least member of each element's cycle, and the steps from the element on to
    it, counted down: by pointer doubling."""
    count = len(follower)
    least, jump = np.arange(count), follower.copy()
    rounds = max(int(np.ceil(np.log2(max(count, 2)))), 1)
    for _ in range(rounds):
        least = np.minimum(least, least[jump])
        jump = jump[jump]
    head = least == np.arange(count)
    jump = np.where(head, np.arange(count), follower)
    steps = np.where(head, 0, 1)
    for _ in range(rounds):
        steps = steps + steps[jump]
        jump = jump[jump]
    return least, -steps


def _closed(points: FloatArray) -> FloatArray | None:
    """A ring (K, 3) without repeated points, closed and counter-clockwise; None for a mere point."""
    apart = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-9
    points = points[apart]
    if len(points) < 3:
        return None
    line = np.concatenate([points, points[:1]])
    return line if area(line) >= 0.0 else line[::-1]
