"""A face seen from above: place and normal over x and y, its inner part, what a ball cannot reach.

`Over`: the place over any x and y, and the smooth normal there. `inner`: the face without the strip
along its edge that a cut leaves out.

**What a ball cannot reach**, from the part alone: before a line is laid, the ball is held against
every place of the face. A ball of radius R that touches a place p with the normal n has its centre
at p + R n. Where the face is bent inward more tightly than the ball, another place of it is nearer
to that centre than R: there the ball would cut in, and leaves a fillet of its own radius instead.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, corner_normals, small_pieces
from planner.geometry.rulings import boundaries
from planner.issues import Issue
from planner.units import MM

CREASE_ANGLE: Final = float(np.deg2rad(20.0))
"""Triangles that turn by more than this [rad] over an edge meet in a crease."""
INSIDE_WEIGHT: Final = -1e-9
"""Least barycentric weight of a place inside a triangle."""


@dataclasses.dataclass(frozen=True)
class Places:
    """Of N places: ``on`` (N,), whether the face is there; ``point``, ``normal`` (N, 3), NaN where it is
    not."""

    point: FloatArray
    normal: FloatArray
    on: BoolArray


class Over:
    """A face ``vertices`` (V, 3) [m], ``faces`` (F, 3) whose normals look up; where it lies over itself, its
    highest place counts."""

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self._corners = vertices[faces]
        self._normals = corner_normals(TriangleMesh(vertices, faces), CREASE_ANGLE)
        flat = self._corners[..., :2]
        self.low, self.high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
        area = float(np.prod(np.maximum(self.high - self.low, 1e-9)))
        self._cell = max(float(np.sqrt(area / max(len(faces), 1))), 1e-6)
        self._wide = int((self.high[0] - self.low[0]) / self._cell) + 1
        first = ((flat.min(axis=1) - self.low) / self._cell).astype(np.int64)
        count = ((flat.max(axis=1) - self.low) / self._cell).astype(np.int64) - first + 1
        each = count.prod(axis=1)
        owner = np.repeat(np.arange(len(faces)), each)
        place = np.arange(len(owner)) - np.repeat(np.cumsum(each) - each, each)
        column, row = place % count[owner, 0], place // count[owner, 0]
        key = (first[owner, 1] + row) * self._wide + first[owner, 0] + column
        order = np.argsort(key, kind="stable")
        self._key, self._owner = key[order], owner[order]

    def at(self, xy: FloatArray) -> Places:
        """The places over ``xy`` (N, 2) [m]."""
        point, normal = np.full((len(xy), 3), np.nan), np.full((len(xy), 3), np.nan)
        inside = ((xy >= self.low - 1e-9) & (xy <= self.high + 1e-9)).all(axis=1)
        cell = (np.clip(xy, self.low, self.high) - self.low) / self._cell
        key = cell[:, 1].astype(np.int64) * self._wide + cell[:, 0].astype(np.int64)
        start, end = np.searchsorted(self._key, key), np.searchsorted(self._key, key, side="right")
        each = np.where(inside, end - start, 0)
        row = np.repeat(np.arange(len(xy)), each)
        triangle = self._owner[
            np.repeat(start, each) + np.arange(len(row)) - np.repeat(np.cumsum(each) - each, each)
        ]
        weights = _weights(xy[row], self._corners[triangle][..., :2])
        hit = np.flatnonzero(weights.min(axis=1) >= INSIDE_WEIGHT)
        row, triangle, weights = row[hit], triangle[hit], weights[hit]
        there = np.einsum("nk,nkd->nd", weights, self._corners[triangle])
        order = np.argsort(there[:, 2], kind="stable")  # the highest is written last
        row, triangle, weights, there = row[order], triangle[order], weights[order], there[order]
        point[row] = there
        own = np.einsum("nk,nkd->nd", weights, self._normals[triangle])
        normal[row] = own / np.linalg.norm(own, axis=1, keepdims=True)
        return Places(point, normal, np.isfinite(point[:, 2]))


def _weights(xy: FloatArray, corners: FloatArray) -> FloatArray:
    """Barycentric weights (M, 3) of points (M, 2) in triangles (M, 3, 2); -1 in those that stand upright."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, xy - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    good = np.abs(area) > 1e-18
    safe = np.where(good, area, 1.0)
    v = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / safe
    w = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / safe
    return np.where(good[:, None], np.stack([1.0 - v - w, v, w], axis=1), -1.0)


INNER_EDGE_SIZE: Final = 0.5 * MM
"""Triangles across the strip's inner edge are parted until they are no larger [m]; those not all inside are
left out."""
MOST_PIECES: Final = 400_000
"""Pieces into which these triangles are parted at most."""


def inner(front: Mesh, margin: float) -> shapely.Geometry:
    """What is farther than ``margin`` [m] inside the edge of the face ``front``, whose normals look up, in
    plan [m]; empty where nothing is."""
    rings = boundaries(TriangleMesh(front.vertices, front.faces))
    flat = [front.vertices[ring][:, :2] for ring in rings if len(ring) > 2]
    if not flat:
        return shapely.Polygon()
    whole = shapely.make_valid(shapely.Polygon(flat[0], flat[1:]))
    return shapely.buffer(whole, -margin, join_style="mitre")


def within(area: shapely.Geometry, xy: FloatArray) -> BoolArray:
    """Whether places (N, 2) [m] are in the area, seen from above."""
    shapely.prepare(area)
    return np.asarray(shapely.contains_xy(area, xy[:, 0], xy[:, 1]))


def clipped(front: Mesh, area: shapely.Geometry) -> Mesh:
    """The triangles of a face over the area, each with vertices of its own."""
    corners = front.vertices[front.faces]
    shapely.prepare(area)
    whole = _inside(area, corners)
    rest = corners[~whole]
    across = rest[shapely.intersects(area, shapely.polygons(rest[..., :2]))]
    parts = [corners[whole]]
    if len(across):
        pieces, _ = small_pieces(across, INNER_EDGE_SIZE, MOST_PIECES)
        parts.append(pieces[_inside(area, pieces)])
    kept = np.concatenate(parts)
    return Mesh(kept.reshape(-1, 3), np.arange(3 * len(kept), dtype=np.int64).reshape(-1, 3))


def _inside(area: shapely.Geometry, corners: FloatArray) -> BoolArray:
    """Whether triangles (T, 3, 3) are in the area as a whole."""
    return np.asarray(shapely.contains(area, shapely.polygons(corners[..., :2])))


MOST_BOUNDING_POINTS: Final = 40_000
"""Most places of a face that bound a ball."""
TRIED_POINTS: Final = 5000
"""Of these, places at which it is tried; lines are held against all of them once they are laid."""
SPACING_SHARE: Final = 0.4
"""Share of the tolerance that places between the places may hide."""
DISTANCE_SHARE: Final = 0.1
"""Share of it that is not told apart in distances."""
CUT_IN_SHARE: Final = 0.8
"""The largest ball that fits cuts in by this share of the tolerance at most."""
RADIUS_HALVINGS: Final = 9
"""Halvings by which the largest ball that fits is found."""
SMALLER_BALL_POINTS: Final = 800
"""Places at which smaller balls are tried."""


@dataclasses.dataclass(frozen=True)
class Unreached:
    """What a ball leaves of a face: touching the place ``at`` (3,) [m] it would cut in elsewhere by ``deep``
    [m], the most; the ``area`` [m^2], the ``share`` of the face, where it would by more than the tolerance;
    and ``fits`` [m], the radius of the largest ball that reaches all, None where that is next to nothing."""

    deep: float
    at: FloatArray
    area: float
    share: float
    fits: float | None


def unreached(
    face: Mesh, radius: float, tolerance: float, area: shapely.Geometry | None = None
) -> Unreached | None:
    """What a ball of ``radius`` [m] leaves of a face, of which what lies in ``area`` [m] in plan is wanted;
    None where it reaches all of that within ``tolerance`` [m]."""
    corners = face.vertices[face.faces]
    pieces, owner = small_pieces(
        corners, float(np.sqrt(8.0 * radius * SPACING_SHARE * tolerance)), MOST_BOUNDING_POINTS
    )
    size = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    points = pieces.mean(axis=1)
    own = corners[owner]
    weights = closest_on_triangles(points, own[:, 0], own[:, 1], own[:, 2])
    smooth = corner_normals(TriangleMesh(face.vertices, face.faces), CREASE_ANGLE)[owner]
    normal = np.einsum("nk,nkd->nd", weights, smooth)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    chosen = within(area, points[:, :2]) if area is not None else np.ones(len(points), dtype=np.bool_)
    whole = float(size[chosen].sum())
    tree = cKDTree(points)
    some = slice(None, None, -(-len(points) // TRIED_POINTS))
    points, normal, size = points[some], normal[some], size[some]
    wanted = chosen[some]
    hidden = DISTANCE_SHARE * tolerance
    deep = _cuts(tree, points, normal, radius, hidden)
    tight = np.flatnonzero(wanted & (deep > tolerance))
    if not len(tight):
        return None
    few = tight[:: -(-len(tight) // SMALLER_BALL_POINTS)]
    fits = _largest(tree, points[few], normal[few], radius, CUT_IN_SHARE * tolerance)
    worst = int(np.argmax(np.where(wanted, deep, 0.0)))
    share = float(size[tight].sum()) / max(float(size[wanted].sum()), 1e-30)
    return Unreached(float(deep[worst]), points[worst], share * whole, share, fits)


def _cuts(tree: cKDTree, points: FloatArray, normal: FloatArray, radius: float, hidden: float) -> FloatArray:
    """How far (N,) [m] balls that touch places (N, 3) cut into the face elsewhere; by ``hidden`` [m] too
    little at most."""
    # nearly all of the face is as far from a centre as the next: what is not told apart need not be
    near = tree.query(points + radius * normal, eps=hidden / radius, distance_upper_bound=radius - hidden)[0]
    return np.asarray(np.where(np.isfinite(near), radius - near, 0.0))


def _largest(
    tree: cKDTree, points: FloatArray, normal: FloatArray, radius: float, most: float
) -> float | None:
    """Radius [m] of the largest ball that cuts in by ``most`` [m] at most, below ``radius``: a ball that
    touches at the same place and is smaller lies within the larger one."""
    low, high = 0.0, radius
    for _ in range(RADIUS_HALVINGS):
        middle = 0.5 * (low + high)
        if float(_cuts(tree, points, normal, middle, DISTANCE_SHARE * most).max()) > most:
            high = middle
        else:
            low = middle
    return low if low > most else None


def unreached_issue(name: str, found: Unreached, radius: float, tolerance: float) -> Issue:
    """``milling.tool_radius`` of the cut ``name``."""
    at = ", ".join(f"{v / MM:.1f}" for v in found.at)
    what = (
        f"{name}: a ball of {radius / MM:g} mm radius does not fit into front at {at} mm, where it would cut "
        f"{found.deep / MM:.2f} mm too deep; it cannot touch {found.area / MM**2:.0f} mm2, "
        f"{100.0 * found.share:.1f} % of the face; allowed: {tolerance / MM:g} mm (shape_tol_mm)"
    )
    if found.fits is None:
        hint = "a crease is too sharp for any ball: round the part there"
    else:
        least = np.floor(found.fits / MM * 100.0) / 100.0
        hint = f"take a ball of {least:.2f} mm radius or less, or round the part there by {radius / MM:g} mm"
    return Issue(
        "milling.tool_radius",
        what,
        field="cell.arms.tool.diameter_mm",
        value=found.deep / MM,
        limit=tolerance / MM,
        unit="mm",
        hint=hint,
    )
