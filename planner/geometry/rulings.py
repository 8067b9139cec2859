"""Ruled surfaces as rows of rulings: resampling, triangles, outward normals, boundaries.

Between rulings i and i + 1 the surface is the bilinear patch of their four ends. A straight wire sweeps it if
both its ends move straight and uniformly. The module also makes the ruled surface between the edges of a
part's front and back.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, Mesh, RuledSurface
from planner.geometry.curves import CORNER_ANGLE_RAD, polyline_guide, turning_angles
from planner.geometry.matching import align_guides, join_guides
from planner.geometry.mesh import TriangleMesh
from planner.issue_codes import format_message
from planner.issues import Issue, Severity

_FRACTIONS_ALONG: Final = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Fractions of a ruling at which deviations are evaluated."""
_MAX_ROWS: Final = 64
"""Maximum number of rows of triangles along a ruling."""
_STILL_DISTANCE_M: Final = 1e-9
"""Maximum motion of an end from one ruling to the next that counts as none [m]."""


def ruling_points(ruled: RuledSurface, along: FloatArray) -> FloatArray:
    """Return points (M, K, 3) [m] at the fractions ``along`` (K,) of every ruling, 0 at its start."""
    fractions = along[None, :, None]
    return np.asarray((1.0 - fractions) * ruled.start[:, None] + fractions * ruled.end[:, None])


def smooth_pieces(ruled: RuledSurface) -> list[IntArray]:
    """Return indices of the rulings of every smooth piece between corners, in order.

    Neighbours share a ruling. The first piece of a closed surface starts at its first corner. Without corners
    it is a single piece that ends where it starts. An open surface also has corners at both ends.
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


def resample(ruled: RuledSurface, chord: float, step: float) -> RuledSurface:
    """Return the surface with as few rulings as the tolerances permit.

    Corners and the ends of an open surface are kept. Rulings between given ones are on the given patches. A
    closed surface starts at its first corner.

    Args:
        ruled: The surface.
        chord: Maximum distance of the new patches from the given surface [m].
        step: Maximum distance of neighbouring rulings at both ends [m].

    Raises:
        ValueError: The chord or the step is not positive.
    """
    if not (chord > 0.0 and step > 0.0):
        raise ValueError(f"chord and step: must be above 0 (got {chord:g} and {step:g} m)")
    pieces = smooth_pieces(ruled)
    kept, starts = [], []
    for piece in pieces:
        indices = _kept_indices(ruled.start[piece], ruled.end[piece], chord, step)
        starts.append(len(indices) - 1)
        kept.append((piece, indices))
    start = [_rows_at(ruled.start[piece], indices[:-1]) for piece, indices in kept]
    end = [_rows_at(ruled.end[piece], indices[:-1]) for piece, indices in kept]
    first = np.concatenate([[0], np.cumsum(starts)])
    corner = np.zeros(first[-1] + (not ruled.closed), dtype=np.bool_)
    heads = np.array([piece[0] for piece, _ in kept])
    corner[first[:-1]] = ruled.corner[heads]
    if not ruled.closed:
        last = kept[-1][0][-1]
        start.append(ruled.start[last][None])
        end.append(ruled.end[last][None])
        corner[-1] = ruled.corner[last]
    return dataclasses.replace(ruled, start=np.concatenate(start), end=np.concatenate(end), corner=corner)


def _kept_indices(start: FloatArray, end: FloatArray, chord: float, step: float) -> FloatArray:
    """Return ascending fractional indices (K,) of the rulings that represent a smooth piece."""
    lines = np.stack([start, end], axis=1)
    length = np.linalg.norm(np.diff(lines, axis=0), axis=2)
    travel = np.maximum(length.max(axis=1), 1e-15)
    density = np.full(len(travel), 1.0 / step)
    if len(start) > 2:
        bend = np.zeros(len(start))
        unit = np.diff(lines, axis=0) / np.maximum(length, 1e-15)[:, :, None]
        moving = (length[1:] > _STILL_DISTANCE_M) & (length[:-1] > _STILL_DISTANCE_M)
        turning = np.linalg.norm(np.diff(unit, axis=0), axis=2) * moving
        # an arc that turns by t over the length w has the sagitta t w / 8
        bend[1:-1] = (turning / np.maximum(0.5 * (length[1:] + length[:-1]), 1e-15)).max(axis=1)
        bend[0], bend[-1] = bend[1], bend[-2]
        density = np.maximum(density, np.sqrt(np.maximum(bend[1:], bend[:-1]) / (8.0 * chord)))
    total = np.concatenate([[0.0], np.cumsum(density * travel)])
    distance = np.concatenate([[0.0], np.cumsum(travel)])
    cells = max(1, int(np.ceil(total[-1] - 1e-9)))
    samples = ruling_points(
        RuledSurface("", start, end, np.zeros(len(start), dtype=np.bool_)), _FRACTIONS_ALONG
    )
    while True:
        indices = np.interp(np.linspace(0.0, total[-1], cells + 1), total, np.arange(len(total)))
        longest_step = np.diff(np.interp(indices, np.arange(len(distance)), distance)).max()
        excess = max(_deviation(samples, indices) / chord, (longest_step / step) ** 2)
        if excess <= 1.0 + 1e-6 or cells >= 8 * len(start):
            return np.asarray(indices)
        cells = max(cells + 1, int(np.ceil(cells * min(2.0, np.sqrt(excess)))))


def _deviation(samples: FloatArray, indices: FloatArray) -> float:
    """Return the largest distance [m] of given points (M, K, 3) from the patches between rulings.

    Args:
        samples: The points.
        indices: Fractional indices of the rulings.
    """
    count = len(samples)
    ends = _rows_at(samples.reshape(count, -1), indices).reshape(len(indices), *samples.shape[1:])
    cell = np.clip(np.searchsorted(indices, np.arange(count), side="right") - 1, 0, len(indices) - 2)
    base, rulings = ends[cell], ends[cell + 1] - ends[cell]
    offset = samples - base
    square = np.maximum(np.sum(rulings * rulings, axis=2, keepdims=True), 1e-300)
    fractions = np.clip(np.sum(offset * rulings, axis=2, keepdims=True) / square, 0.0, 1.0)
    return float(np.linalg.norm(offset - fractions * rulings, axis=2).max())


def _rows_at(rows: FloatArray, indices: FloatArray) -> FloatArray:
    """Return rows (K, D) at fractional indices (K,) of rows (M, D), linear between them."""
    low = np.clip(np.floor(indices).astype(np.int64), 0, len(rows) - 2)
    fractions = (indices - low)[:, None]
    return np.asarray((1.0 - fractions) * rows[low] + fractions * rows[low + 1])


def tessellate(ruled: RuledSurface, chord: float = 1e-5) -> Mesh:
    """Return triangles of the surface, wound so that their normals point away from the part.

    Twisted patches are cut along the rulings until the triangles are within ``chord`` [m] of them, in 64 rows
    at most. Triangles without area, at the tip of a cone, are left out.
    """
    count = len(ruled.start)
    following = np.roll(np.arange(count), -1) if ruled.closed else np.arange(1, count)
    index = np.arange(len(following))
    twist = ruled.start[index] - ruled.start[following] - ruled.end[index] + ruled.end[following]
    rows = int(np.clip(np.ceil(np.linalg.norm(twist, axis=1).max(initial=0.0) / (4.0 * chord)), 1, _MAX_ROWS))
    vertices = ruling_points(ruled, np.linspace(0.0, 1.0, rows + 1)).reshape(-1, 3)
    grid = np.arange(count * (rows + 1)).reshape(count, rows + 1)
    a, b = grid[index, :-1], grid[following, :-1]
    c, d = grid[following, 1:], grid[index, 1:]
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    p, q, r = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1)
    return Mesh(vertices, faces[area > _STILL_DISTANCE_M * _STILL_DISTANCE_M].astype(np.int64))


def outward_normals(ruled: RuledSurface) -> tuple[FloatArray, FloatArray]:
    """Return unit normals (M, 3) away from the part at the starts and at the ends of the rulings.

    At a corner the normal is halfway between those of both sides, see :func:`outward_sides`.
    """
    previous, following = outward_sides(ruled)
    mean = previous + following
    length = np.linalg.norm(mean, axis=2, keepdims=True)
    # where the surface turns back on itself both sides cancel out
    mean = np.where(length > 1e-9, mean / np.maximum(length, 1e-9), following)
    return mean[:, 0], mean[:, 1]


def outward_sides(ruled: RuledSurface) -> tuple[FloatArray, FloatArray]:
    """Return unit normals (M, 2, 3) just before and just after every ruling, at start and end.

    They point away from the part and differ at corners only. At the ends of an open surface both are those of
    its one side. Tangents are those of parabolas through three points. If one end stands still (a cone's
    tip), the normal is that at the other end.
    """
    lines = np.stack([ruled.start, ruled.end], axis=1)
    previous, following = np.zeros_like(lines), np.zeros_like(lines)
    for piece in smooth_pieces(ruled):
        is_smooth_ring = ruled.closed and len(piece) == len(lines) + 1 and not ruled.corner.any()
        tangent = _ring_tangents(lines) if is_smooth_ring else _tangents(lines[piece])
        if is_smooth_ring:
            return (_normals(tangent, lines),) * 2
        normal = _normals(tangent, lines[piece])
        following[piece[:-1]] = normal[:-1]
        previous[piece[1:]] = normal[1:]
    if not ruled.closed:
        previous[0], following[-1] = following[0], previous[-1]
    return previous, following


def _ring_tangents(lines: FloatArray) -> FloatArray:
    return _tangents(np.concatenate([lines[-1:], lines, lines[:1]]))[1:-1]


def _tangents(lines: FloatArray) -> FloatArray:
    """Return tangents (M, 2, 3), unit or zero, of both ends along a smooth piece (M, 2, 3)."""
    steps = np.diff(lines, axis=0)
    length = np.linalg.norm(steps, axis=2, keepdims=True)
    unit = np.where(length > _STILL_DISTANCE_M, steps / np.maximum(length, _STILL_DISTANCE_M), 0.0)
    length = np.where(length > _STILL_DISTANCE_M, length, 0.0)
    out = np.concatenate([unit[:1], unit])
    if len(steps) > 1:
        h, g, total = length[:-1], length[1:], np.maximum(length[:-1] + length[1:], _STILL_DISTANCE_M)
        bend = (unit[1:] - unit[:-1]) * ((h > 0.0) & (g > 0.0))
        still = np.where(h > 0.0, unit[:-1], unit[1:])
        out[1:-1] = np.where((h > 0.0) & (g > 0.0), unit[:-1] + bend * (h / total), still)
        out[0] = unit[0] - bend[0] * (h[0] / total[0])
        out[-1] = unit[-1] + bend[-1] * (g[-1] / total[-1])
    size = np.linalg.norm(out, axis=2, keepdims=True)
    return np.asarray(np.where(size > 1e-9, out / np.maximum(size, 1e-9), 0.0))


def _normals(tangent: FloatArray, lines: FloatArray) -> FloatArray:
    """Return unit normals (M, 2, 3) of both ends. An end without one, as a cone's tip, gets the other's."""
    direction = (lines[:, 1] - lines[:, 0])[:, None]
    cross = np.cross(tangent, direction)
    size = np.linalg.norm(cross, axis=2, keepdims=True)
    length = np.maximum(np.linalg.norm(direction, axis=2, keepdims=True), _STILL_DISTANCE_M)
    has_normal = size > 1e-6 * length
    normal = np.where(has_normal, cross / np.maximum(size, 1e-300), 0.0)
    return np.asarray(np.where(has_normal, normal, normal[:, ::-1]))


EDGES_NAME: Final = "edges"
"""Name of the ruled surface between the outlines of two opposite faces."""
_GUIDE_CHORD_M: Final = 1e-5
"""Maximum deviation of resampled guides from their chords [m]."""


def boundary_rings(mesh: TriangleMesh) -> list[IntArray]:
    """Return vertex indices (n,) of every boundary ring, counterclockwise seen from outside.

    The longest ring is first.
    """
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


def edge_surface(front: TriangleMesh, back: TriangleMesh, displaced_front: bool) -> RuledSurface | Issue:
    """Return the closed surface from the front's boundary to the back's, within 0.01 mm.

    Its name is ``edges``. Only a cut of the edges needs it, so a note reports why there is none.

    Args:
        front: The front.
        back: The back.
        displaced_front: Whether the back is the front displaced vertex by vertex. Otherwise the boundaries
            are matched by arc length between their corners.
    """
    rings = boundary_rings(front), boundary_rings(back)
    for name, boundaries_of_face in zip(("front", "back"), rings, strict=True):
        if len(boundaries_of_face) != 1:
            reason = f"the {name} face has {len(boundaries_of_face)} boundaries instead of 1"
            return _no_edges_note(reason, "close its holes and remove other pieces")
    # seen from the front clockwise, so that this direction x the rulings, to the back, points outwards
    front_ring = rings[0][0][::-1]
    if displaced_front:
        start, end = front.vertices[front_ring], back.vertices[front_ring]
        corner = (turning_angles(start, True) > CORNER_ANGLE_RAD) | (
            turning_angles(end, True) > CORNER_ANGLE_RAD
        )
        return resample(RuledSurface(EDGES_NAME, start, end, corner, closed=True), _GUIDE_CHORD_M, 1.0)
    front_guide = polyline_guide(front.vertices[front_ring], closed=True)
    back_guide = polyline_guide(back.vertices[rings[1][0]], closed=True)
    counts = int(front_guide.corner.sum()), int(back_guide.corner.sum())
    if counts[0] != counts[1]:
        reason = f"the front's boundary has {counts[0]} corners and the back's {counts[1]}"
        return _no_edges_note(reason, "make the numbers of corners equal")
    front_guide, back_guide, _ = align_guides(front_guide, back_guide, "arc_length")
    return resample(join_guides(EDGES_NAME, front_guide, back_guide), _GUIDE_CHORD_M, 1.0)


def _no_edges_note(reason: str, remedy: str) -> Issue:
    message = format_message("part.edges", reason=reason, remedy=remedy)
    return Issue("part.edges", message, Severity.NOTE, field="part.back")


def _length(points: FloatArray) -> float:
    return float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())
