"""What a ball cannot reach of a part: sharp floors, fillets and hollows that are tighter than it is.

There it leaves a fillet of its own radius, whatever the path: told before anything is planned. A ball above a
hollow is beyond the plane of each place that is in its way, by its radius; the nearest place for its centre
that is beyond all of them is found by Dykstra's alternating projections (Boyle and Dykstra 1986). In a corner
between two planes at the angle a to each other it stays R (1 / cos(a / 2) - 1) off.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.forming.contact import Face
from planner.forming.values import BoolArray, FloatArray, IntArray, Pass
from planner.forming.work import Work
from planner.geometry.closest import small_pieces
from planner.geometry.mesh import TriangleMesh
from planner.geometry.vectors import dots
from planner.issues import Issue, Severity
from planner.units import MM

NEARLY: Final = 2e-5
"""A ball that comes so near [m] to a place reaches it."""
GRAIN: Final = 0.1
"""Places are looked at a share of the ball's radius apart."""
COARSE: Final = 0.35
"""First they are so far apart, for corners are wider than that all along."""
TOUCH: Final = 2e-6
_WORST: Final = 12
_MOST: Final = 800
_PIECES: Final = 60_000
_ROUNDS: Final = 12
_SWEEPS: Final = 80
_MIRROR: Final = np.array([1.0, 1.0, -1.0])


@dataclasses.dataclass(frozen=True)
class Unreached:
    """What a ball does not reach of a pass: by how much at most it stays ``off`` [m], at the place ``at``
    (3,) [m] of the face that it forms; the ``volume`` [m^3] that its fillets leave, in how many ``places``;
    and the ``share`` of the walls."""

    off: float
    at: FloatArray
    volume: float
    places: int
    share: float


def unreached(one: Pass, radius: float) -> Unreached | None:
    """What a ball of ``radius`` [m] does not reach of the face of a pass, None where it reaches all of it."""
    vertices = one.vertices if one.side > 0 else one.vertices * _MIRROR
    start, end = one.side * one.start, one.side * one.end
    box = np.stack([one.region.min(axis=0), one.region.max(axis=0)])[:, :2]
    face = Face(TriangleMesh(vertices, one.faces), radius, box)
    corners = vertices[face.mesh.faces]
    moved = np.flatnonzero(corners[:, :, 2].min(axis=1) < start - TOUCH)  # the flat around is reached anyhow
    corners = corners[moved]
    parts, owner = small_pieces(corners, GRAIN * radius, _PIECES)
    area = 0.5 * np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
    corner = corners[owner][:, :, 2]
    flat = [(np.abs(corner - level) < TOUCH).all(axis=1) for level in (start, end)]
    wall = np.asarray(~(flat[0] | flat[1]))
    points, normal = parts.mean(axis=1), face.normals[moved[owner]]
    few = _thinned(points, wall, COARSE * radius)[0]
    hit = few[face.pushed(points[few], normal[few]) > NEARLY]
    if not len(hit):
        return None
    near = cKDTree(points[hit]).query(points, distance_upper_bound=2.0 * COARSE * radius)[0]
    some = np.flatnonzero(np.isfinite(near))
    first, cell = _thinned(points[some], wall[some], GRAIN * radius)
    total = np.bincount(cell, area[some])
    all_walls = float(area[wall].sum())
    rows = some[first]
    area[rows] = total
    back = nearest_centres(face, points[rows], normal[rows]) - points[rows]
    apart = np.linalg.norm(back, axis=1)
    use = apart > radius + NEARLY
    rows, back, apart = rows[use], back[use], apart[use]
    if not len(rows):
        return None
    # of each place the sector between it and the ball, as in a straight crease
    along = np.maximum(dots(back, normal[rows]), 0.0) / apart
    volume = float((0.5 * (apart**2 - radius**2) / apart * along * area[rows]).sum())
    k = int(np.argmax(apart))
    at = points[rows[k]] if one.side > 0 else points[rows[k]] * _MIRROR
    share = float(area[rows][wall[rows]].sum() / max(all_walls, 1e-12))
    # the farthest are corners of the mesh itself, beside these
    worst = points[rows[np.argsort(apart)[-_WORST:]]]
    around = np.unique(np.concatenate(cKDTree(points).query_ball_point(worst, 2.0 * GRAIN * radius)))
    around = around[:: -(-len(around) // _MOST)].astype(np.int64)
    corner, up = parts[around].reshape(-1, 3), np.repeat(normal[around], 3, axis=0)
    far = np.linalg.norm(nearest_centres(face, corner, up) - corner, axis=1)
    most = max(float(far.max()), float(apart[k]))
    return Unreached(most - radius, at, volume, _groups(points[rows], radius), share)


def _thinned(points: FloatArray, wall: BoolArray, size: float) -> tuple[IntArray, IntArray]:
    """The first (C,) of N points, of walls and of what is none, in each cell of a ``size`` [m], and the cells
    (N,)."""
    key = np.column_stack([np.floor(points / size).astype(np.int64), wall])
    _, first, cell = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return first, np.asarray(cell).reshape(-1)


def nearest_centres(face: Face, points: FloatArray, normal: FloatArray) -> FloatArray:
    """The nearest centres (N, 3) [m] to ``points`` (N, 3) of a face, with unit ``normal`` (N, 3) up, of its
    balls that cut in nowhere."""
    found = points + face.radius * normal
    open_: IntArray = np.arange(len(points))
    # planes in the way: unit normals, and how far along them a centre is at least
    up = np.zeros((len(points), 0, 3))
    level = np.zeros((len(points), 0))
    for _ in range(_ROUNDS):
        distance, place, away = face.deepest(found[open_])
        deep = distance < face.radius - TOUCH
        open_, place, away = open_[deep], place[deep], away[deep]
        if not len(open_):
            break
        up = np.concatenate([up[deep], away[:, None]], axis=1)
        level = np.concatenate([level[deep], (dots(away, place) + face.radius)[:, None]], axis=1)
        found[open_] = _projected(points[open_], up, level)
    return found


def _projected(points: FloatArray, up: FloatArray, level: FloatArray) -> FloatArray:
    """The nearest places (N, 3) to ``points`` (N, 3) beyond K planes, ``up`` (N, K, 3), ``level`` (N, K)."""
    place = points.copy()
    push = np.zeros(level.shape)
    for _ in range(_SWEEPS if level.shape[1] > 1 else 1):
        for k in range(level.shape[1]):
            free = dots(place, up[:, k]) - push[:, k]
            fresh = np.maximum(level[:, k] - free, 0.0)
            place += (fresh - push[:, k])[:, None] * up[:, k]
            push[:, k] = fresh
    return place


def _groups(points: FloatArray, radius: float) -> int:
    """How many places that are apart points (N, 3) make up."""
    near = cKDTree(points).sparse_distance_matrix(
        cKDTree(points), 4.0 * GRAIN * radius, output_type="coo_matrix"
    )
    return int(connected_components(near, directed=False)[0])


def unreached_issues(work: Work) -> list[Issue]:
    """What the balls do not reach of the part (forming.unreached): a note, a warning where that is more of
    the walls than may be off, or an error beyond the user's ``unreached_mm``."""
    op = work.operation
    out = []
    for one in {one.feature: one for one in work.passes}.values():
        radius = work.heads[work.former(one)].radius
        found = unreached(one, radius)
        if found is None:
            continue
        limit = op.unreached_mm
        off = found.off / MM
        x, y, z = found.at / MM
        many = "one place" if found.places == 1 else f"{found.places} places"
        what = (
            f"pass {one.name}: a ball of {radius / MM:.2f} mm radius stays up to {off:.2f} mm off the part, "
            f"most at ({x:.1f}, {y:.1f}, {z:.1f}) mm, and leaves fillets of its own radius in {many}, about "
            f"{found.volume / MM**3:.3g} mm3; it does not reach {100.0 * found.share:.1f} % of the walls"
        )
        severity = Severity.NOTE if found.share <= 1.0 - op.share else Severity.WARNING
        hint = "a smaller ball reaches more, and a part that is rounded by the ball's radius is reached whole"
        if limit is None:
            hint += "; unreached_mm says how far it may stay off"
        elif off > limit:
            severity, what = Severity.ERROR, f"{what}; unreached_mm allows {limit:g} mm"
            hint = "take a smaller ball, round the part there by the ball's radius"
            hint += f", or allow {off + 0.01:.2f} mm"
        out.append(
            Issue(
                "forming.unreached",
                what,
                severity,
                field="operations.unreached_mm",
                value=off,
                limit=limit,
                unit="mm",
                hint=hint,
            )
        )
    return out
