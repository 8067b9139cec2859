"""Ruled surfaces as rows of rulings: thinning and thickening, triangles, outward normals, facts.

Between rulings i and i + 1 the surface is the bilinear patch of their four ends, which is what a
straight wire sweeps whose ends both go straight and evenly. Also the ruled surface that joins the
edges of a part's front and back face, and the boundaries of meshes that it is made of.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, Mesh, Ruled
from planner.geometry.curves import CORNER_ANGLE, polyline, turns
from planner.geometry.matching import aligned, join
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, Severity

_SHARES_ALONG: Final = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Places along a ruling at which deviations are looked at."""
_ROWS: Final = 64
"""Most rows of triangles along a ruling."""
_STILL_DISTANCE: Final = 1e-9
"""An end that moves by less [m] from one ruling to the next stands still."""


def points(ruled: Ruled, along: FloatArray) -> FloatArray:
    """Points (M, K, 3) [m] at the fractions ``along`` (K,) of every ruling, 0 at its start."""
    share = along[None, :, None]
    return np.asarray((1.0 - share) * ruled.start[:, None] + share * ruled.end[:, None])


def runs(ruled: Ruled) -> list[IntArray]:
    """Indices of the rulings of every smooth piece between corners, in order; neighbours share a ruling.

    A closed surface has no ends of its own: its first piece starts at its first corner, and one without
    corners is a single piece that ends where it starts. An open one also has corners at both ends.
    """
    count = len(ruled.start)
    at = np.flatnonzero(ruled.corner)
    if not ruled.closed:
        at = np.unique(np.concatenate([[0], at, [count - 1]]))
        return [np.arange(a, b + 1) for a, b in itertools.pairwise(at)]
    if len(at) == 0:
        return [np.arange(count + 1) % count]
    ends = np.append(at[1:], at[0] + count)
    return [np.arange(a, b + 1) % count for a, b in zip(at, ends, strict=True)]


def resample(ruled: Ruled, chord: float, step: float) -> Ruled:
    """The surface with as few rulings as keep its patches within ``chord`` [m] of the given one and
    neighbours within ``step`` [m] at both ends; corners stay, and so do the ends of an open surface.

    Rulings between given ones lie on the given patches. A closed surface starts at its first corner.
    """
    if not (chord > 0.0 and step > 0.0):
        raise ValueError(f"chord and step: got {chord:g} and {step:g} m, both must be above 0")
    pieces = runs(ruled)
    places, starts = [], []
    for piece in pieces:
        own = _thin(ruled.start[piece], ruled.end[piece], chord, step)
        starts.append(len(own) - 1)
        places.append((piece, own))
    start = [_at(ruled.start[piece], own[:-1]) for piece, own in places]
    end = [_at(ruled.end[piece], own[:-1]) for piece, own in places]
    first = np.concatenate([[0], np.cumsum(starts)])
    corner = np.zeros(first[-1] + (not ruled.closed), dtype=np.bool_)
    heads = np.array([piece[0] for piece, _ in places])
    corner[first[:-1]] = ruled.corner[heads]
    if not ruled.closed:
        last = places[-1][0][-1]
        start.append(ruled.start[last][None])
        end.append(ruled.end[last][None])
        corner[-1] = ruled.corner[last]
    return dataclasses.replace(ruled, start=np.concatenate(start), end=np.concatenate(end), corner=corner)


def _thin(start: FloatArray, end: FloatArray, chord: float, step: float) -> FloatArray:
    """Ascending places (K,), as fractional indices, of the rulings that stand for a smooth piece."""
    lines = np.stack([start, end], axis=1)
    length = np.linalg.norm(np.diff(lines, axis=0), axis=2)
    travel = np.maximum(length.max(axis=1), 1e-15)
    density = np.full(len(travel), 1.0 / step)
    if len(start) > 2:
        bend = np.zeros(len(start))
        unit = np.diff(lines, axis=0) / np.maximum(length, 1e-15)[:, :, None]
        moving = (length[1:] > _STILL_DISTANCE) & (length[:-1] > _STILL_DISTANCE)
        turn = np.linalg.norm(np.diff(unit, axis=0), axis=2) * moving
        # the chord of a bow of turn t over the way w has the sagitta t w / 8
        bend[1:-1] = (turn / np.maximum(0.5 * (length[1:] + length[:-1]), 1e-15)).max(axis=1)
        bend[0], bend[-1] = bend[1], bend[-2]
        density = np.maximum(density, np.sqrt(np.maximum(bend[1:], bend[:-1]) / (8.0 * chord)))
    spent = np.concatenate([[0.0], np.cumsum(density * travel)])
    whole = np.concatenate([[0.0], np.cumsum(travel)])
    cells = max(1, int(np.ceil(spent[-1] - 1e-9)))
    sight = points(Ruled("", start, end, np.zeros(len(start), dtype=np.bool_)), _SHARES_ALONG)
    while True:
        place = np.interp(np.linspace(0.0, spent[-1], cells + 1), spent, np.arange(len(spent)))
        way = np.diff(np.interp(place, np.arange(len(whole)), whole)).max()
        wide = max(_off(sight, place) / chord, (way / step) ** 2)
        if wide <= 1.0 + 1e-6 or cells >= 8 * len(start):
            return np.asarray(place)
        cells = max(cells + 1, int(np.ceil(cells * min(2.0, np.sqrt(wide)))))


def _off(sight: FloatArray, place: FloatArray) -> float:
    """Largest distance [m] of given points (M, K, 3) from the patches between the rulings at ``place``."""
    count = len(sight)
    ends = _at(sight.reshape(count, -1), place).reshape(len(place), *sight.shape[1:])
    cell = np.clip(np.searchsorted(place, np.arange(count), side="right") - 1, 0, len(place) - 2)
    base, way = ends[cell], ends[cell + 1] - ends[cell]
    offset = sight - base
    square = np.maximum(np.sum(way * way, axis=2, keepdims=True), 1e-300)
    share = np.clip(np.sum(offset * way, axis=2, keepdims=True) / square, 0.0, 1.0)
    return float(np.linalg.norm(offset - share * way, axis=2).max())


def _at(rows: FloatArray, place: FloatArray) -> FloatArray:
    """Rows (K, D) at fractional indices (K,) of rows (M, D), straight in between."""
    low = np.clip(np.floor(place).astype(np.int64), 0, len(rows) - 2)
    share = (place - low)[:, None]
    return np.asarray((1.0 - share) * rows[low] + share * rows[low + 1])


def tessellate(ruled: Ruled, chord: float = 1e-5) -> Mesh:
    """Triangles of the surface, wound so that their normals point away from the part.

    Twisted patches are cut along the rulings until the triangles are within ``chord`` [m] of them, in 64 rows
    at most. Triangles of no area, at the tip of a cone, are left out.
    """
    count = len(ruled.start)
    following = np.roll(np.arange(count), -1) if ruled.closed else np.arange(1, count)
    index = np.arange(len(following))
    twist = ruled.start[index] - ruled.start[following] - ruled.end[index] + ruled.end[following]
    rows = int(np.clip(np.ceil(np.linalg.norm(twist, axis=1).max(initial=0.0) / (4.0 * chord)), 1, _ROWS))
    vertices = points(ruled, np.linspace(0.0, 1.0, rows + 1)).reshape(-1, 3)
    grid = np.arange(count * (rows + 1)).reshape(count, rows + 1)
    a, b = grid[index, :-1], grid[following, :-1]
    c, d = grid[following, 1:], grid[index, 1:]
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    p, q, r = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1)
    return Mesh(vertices, faces[area > _STILL_DISTANCE * _STILL_DISTANCE].astype(np.int64))


def outward(ruled: Ruled) -> tuple[FloatArray, FloatArray]:
    """Unit normals (M, 3) away from the part at the starts and at the ends of the rulings.

    At a corner it is the direction halfway between those of both sides; see :func:`outward_sides`.
    """
    before, after = outward_sides(ruled)
    mean = before + after
    length = np.linalg.norm(mean, axis=2, keepdims=True)
    # where the surface turns back on itself both sides cancel out
    mean = np.where(length > 1e-9, mean / np.maximum(length, 1e-9), after)
    return mean[:, 0], mean[:, 1]


def outward_sides(ruled: Ruled) -> tuple[FloatArray, FloatArray]:
    """Unit normals (M, 2, 3) away from the part just before and just after every ruling, at start and end.

    They differ at corners only; at the ends of an open surface they are those of the one side. Tangents are
    those of parabolas through three points. Where one end stands still (a cone's tip) the normal is that at
    the other end.
    """
    lines = np.stack([ruled.start, ruled.end], axis=1)
    before, after = np.zeros_like(lines), np.zeros_like(lines)
    for piece in runs(ruled):
        whole = ruled.closed and len(piece) == len(lines) + 1 and not ruled.corner.any()
        tangent = _ring_tangents(lines) if whole else _tangents(lines[piece])
        if whole:
            return (_normals(tangent, lines),) * 2
        normal = _normals(tangent, lines[piece])
        after[piece[:-1]] = normal[:-1]
        before[piece[1:]] = normal[1:]
    if not ruled.closed:
        before[0], after[-1] = after[0], before[-1]
    return before, after


def _ring_tangents(lines: FloatArray) -> FloatArray:
    return _tangents(np.concatenate([lines[-1:], lines, lines[:1]]))[1:-1]


def _tangents(lines: FloatArray) -> FloatArray:
    """Tangents (M, 2, 3), unit or zero, of both ends along a smooth piece (M, 2, 3)."""
    way = np.diff(lines, axis=0)
    length = np.linalg.norm(way, axis=2, keepdims=True)
    unit = np.where(length > _STILL_DISTANCE, way / np.maximum(length, _STILL_DISTANCE), 0.0)
    length = np.where(length > _STILL_DISTANCE, length, 0.0)
    out = np.concatenate([unit[:1], unit])
    if len(way) > 1:
        h, g, total = length[:-1], length[1:], np.maximum(length[:-1] + length[1:], _STILL_DISTANCE)
        bend = (unit[1:] - unit[:-1]) * ((h > 0.0) & (g > 0.0))
        still = np.where(h > 0.0, unit[:-1], unit[1:])
        out[1:-1] = np.where((h > 0.0) & (g > 0.0), unit[:-1] + bend * (h / total), still)
        out[0] = unit[0] - bend[0] * (h[0] / total[0])
        out[-1] = unit[-1] + bend[-1] * (g[-1] / total[-1])
    size = np.linalg.norm(out, axis=2, keepdims=True)
    return np.asarray(np.where(size > 1e-9, out / np.maximum(size, 1e-9), 0.0))


def _normals(tangent: FloatArray, lines: FloatArray) -> FloatArray:
    direction = (lines[:, 1] - lines[:, 0])[:, None]
    cross = np.cross(tangent, direction)
    size = np.linalg.norm(cross, axis=2, keepdims=True)
    length = np.maximum(np.linalg.norm(direction, axis=2, keepdims=True), _STILL_DISTANCE)
    good = size > 1e-6 * length
    normal = np.where(good, cross / np.maximum(size, 1e-300), 0.0)
    return np.asarray(np.where(good, normal, normal[:, ::-1]))


EDGES_NAME: Final = "edges"
"""Name of the ruled surface between the outlines of two opposite faces."""
_GUIDE_CHORD: Final = 1e-5
"""Chords of resampled guides may be off them by this [m]."""


def boundaries(mesh: TriangleMesh) -> list[IntArray]:
    """Vertex indices (n,) of every boundary ring, longest first, counterclockwise seen from outside."""
    faces = mesh.faces
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = len(mesh.vertices)
    key, back = directed @ np.array([count, 1]), directed @ np.array([1, count])
    rim = directed[~np.isin(key, back)]
    follow = dict(rim.tolist())
    rings = []
    while follow:
        first, at = follow.popitem()
        loop = [first]
        while at != first and at in follow:
            loop.append(at)
            at = follow.pop(at)
        rings.append(np.array(loop, dtype=np.int64))
    return sorted(rings, key=lambda ring: -_length(mesh.vertices[ring]))


def edge_surface(front: TriangleMesh, back: TriangleMesh, same: bool) -> Ruled | Issue:
    """The closed surface from the front's boundary to the back's, named ``edges``, within 0.01 mm.

    ``same``: the back is the front moved, vertex by vertex; otherwise the boundaries are matched by arc
    length between their corners. Where that cannot be, a note says why; nothing but a cut of the edges needs
    them.
    """
    rings = boundaries(front), boundaries(back)
    for name, mine in zip(("front", "back"), rings, strict=True):
        if len(mine) != 1:
            why = f"the {name} face has {len(mine)} boundaries, 1 is wanted"
            return _without(why, "close its holes and leave other pieces out")
    # seen from the front clockwise, so that this direction x the rulings, to the back, points outwards
    first = rings[0][0][::-1]
    if same:
        start, end = front.vertices[first], back.vertices[first]
        corner = (turns(start, True) > CORNER_ANGLE) | (turns(end, True) > CORNER_ANGLE)
        return resample(Ruled(EDGES_NAME, start, end, corner, closed=True), _GUIDE_CHORD, 1.0)
    guide = polyline(front.vertices[first], closed=True)
    other = polyline(back.vertices[rings[1][0]], closed=True)
    counts = int(guide.corner.sum()), int(other.corner.sum())
    if counts[0] != counts[1]:
        why = f"the front's boundary has {counts[0]} corners and the back's {counts[1]}"
        return _without(why, "give both as many corners")
    guide, other, _ = aligned(guide, other, "arc_length")
    return resample(join(EDGES_NAME, guide, other), _GUIDE_CHORD, 1.0)


def _without(why: str, do: str) -> Issue:
    what = f"{why}, so the part has no ruled edges that a straight wire could cut; {do} if it should"
    return Issue("part.edges", what, Severity.NOTE, field="part.back")


def _length(points: FloatArray) -> float:
    return float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
