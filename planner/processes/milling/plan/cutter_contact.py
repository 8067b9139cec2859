"""Where a cutter can touch a surface: a ball on a face, a cylindrical flank along rulings.

**A face seen from above.** `Over`: the place over any x and y, and the smooth normal there.
`inner`: the face without the strip along its edge that a cut leaves out.

**What a ball cannot reach**, from the part alone: before a line is laid, the ball is held against
every place of the face. A ball of radius R that touches a place p with the normal n has its centre
at p + R n. Where the face is bent inward more tightly than the ball, another place of it is nearer
to that centre than R: there the ball would cut in, and leaves a fillet of its own radius instead.

**A flank on a ruled surface.** Along a ruling of a developable surface the normal is one and the
same, and a cylinder touches the whole of it. A twisted ruling it can only touch in part. Here the
cylinder touches both guides, each from outside at the distance of its radius (as in the two-guide
positioning that Redonnet, Rubio and Dessein describe in "Side milling of ruled surfaces", Int. J.
Adv. Manuf. Technol. 14, 1998; worked out anew). One freedom is left: how far the place on the upper
guide is ahead of that on the lower one. It is chosen so that the largest distance of the cylinder
from the surface between the guides is least.

Rulings come as a flank cutter passes them (`strips`): tip guide and top guide in the order of the
cut, with tangents and outward normals, one smooth piece at a time.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, Ruled, unit
from planner.geometry.face_places import CREASE_ANGLE
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, corner_normals, small_pieces
from planner.geometry.rulings import boundaries, resample, runs
from planner.geometry.units import MM, measurement
from planner.issues import Issue

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
        **measurement(found.deep / MM, tolerance / MM, "mm"),
        hint=hint,
    )


@dataclasses.dataclass(frozen=True)
class Strip:
    """A smooth piece: ruling i from ``low[i]``, at the tip, to ``high[i]`` (M, 3) [m].

    ``out`` is +1 where the outward normal is tangent x (high - low), else -1. A ``ring`` is a whole closed
    surface without corners: its last ruling is its first one again.
    """

    low: FloatArray
    high: FloatArray
    out: float
    ring: bool = False

    def tangents(self) -> tuple[FloatArray, FloatArray]:
        """Unit tangents (M, 3) of both guides; where one stands still, that of the other."""
        low, high = (np.gradient(side, axis=0) for side in (self.low, self.high))
        sizes = [np.linalg.norm(t, axis=1, keepdims=True) for t in (low, high)]
        still = 1e-3 * np.maximum(*sizes)
        low, high = np.where(sizes[0] > still, low, high), np.where(sizes[1] > still, high, low)
        return unit(low), unit(high)

    def normals(self) -> tuple[FloatArray, FloatArray]:
        """Outward unit normals (M, 3) of the surface at both guides."""
        along = self.high - self.low
        first, second = self.tangents()
        return unit(self.out * np.cross(first, along)), unit(self.out * np.cross(second, along))

    def reversed(self) -> "Strip":
        """The same piece the other way."""
        return Strip(self.low[::-1], self.high[::-1], -self.out, self.ring)


def strips(ruled: Ruled, tip_at_start: bool, chord: float, step: float) -> list[Strip]:
    """The smooth pieces of a ruled surface along its guides, rulings at most ``step`` [m] apart."""
    fine = resample(ruled, chord, step)
    ring = fine.closed and not fine.corner.any()
    out = []
    for rows in runs(fine):
        start, end = fine.start[rows], fine.end[rows]
        out.append(Strip(start, end, 1.0, ring) if tip_at_start else Strip(end, start, -1.0, ring))
    return out


RULING_SHARES: Final = np.array([0.1, 0.25, 0.4, 0.6, 0.75, 0.9])
"""Places along a ruling, from the tip guide to the other, at which the cylinder is held against the
surface."""
MOST_AHEAD: Final = 0.8
"""How far a place on the upper guide may be ahead, over the cutter's radius."""
CHOSEN_RULINGS: Final = 72
"""Rulings at which the choice is made; it is smooth between them."""
AHEAD_TRIALS: Final = 9
"""Values of being ahead that are tried at once at each of these rulings."""
AHEAD_ZOOMS: Final = 4
"""So often they are tried, each time between the neighbours of the best one."""
AXIS_ROUNDS: Final = 40
"""Rounds at most in which the axis of a cylinder that touches both guides settles."""
AXIS_SETTLED: Final = 1e-12
"""The axis, a unit vector, has settled where a round changes it by less than this."""
RULING_WINDOW: Final = 20
"""Rulings on either side that are looked at for the place that a cylinder comes nearest to."""
AHEAD_COST: Final = 1e-4
"""What being ahead by a whole radius costs, over the radius: it settles surfaces that leave it open."""
SMOOTHING_RULINGS: Final = 3.0
"""Rulings over which the choice is made smooth."""


def axes(strip: Strip, radius: float) -> tuple[FloatArray, FloatArray]:
    """Places ``low`` and ``high`` (M, 3) [m] on the cutter's axis, opposite of both guides, for a cylinder of
    ``radius`` [m] on the outer side of a strip with evenly spaced rulings."""
    if radius == 0.0:
        return strip.low, strip.high
    longer = _longer(strip)
    ahead = _ahead(longer, radius, strip.ring)
    low, high = _touching(longer, radius, np.arange(len(longer.low)), ahead)
    return low[RULING_WINDOW:-RULING_WINDOW], high[RULING_WINDOW:-RULING_WINDOW]


def deviation(strip: Strip, radius: float, low: FloatArray, high: FloatArray) -> FloatArray:
    """How far (M, K) [m] cylinders about the axes from ``low`` to ``high`` (M, 3) are off the surface at the
    levels: left where positive, cut too deep where negative."""
    at = np.arange(len(strip.low), dtype=np.float64)
    if strip.ring:
        return _off(_longer(strip), radius, low, high, at + RULING_WINDOW)
    return _off(strip, radius, low, high, at)


def _longer(strip: Strip) -> Strip:
    """The strip with ``RULING_WINDOW`` more rulings at both ends, so that what is ahead of the last one is
    there: a ring goes on as it began, others straight."""
    if strip.ring:
        around = len(strip.low) - 1
        rows = np.arange(-RULING_WINDOW, around + 1 + RULING_WINDOW) % around
        return Strip(strip.low[rows], strip.high[rows], strip.out)
    return Strip(_on(strip.low), _on(strip.high), strip.out)


def _on(side: FloatArray) -> FloatArray:
    """A guide (M + 2 RULING_WINDOW, 3) that goes on by ``RULING_WINDOW`` even steps at both ends."""
    more = np.arange(1, RULING_WINDOW + 1)[:, None]
    before, behind = side[0] - side[1], side[-1] - side[-2]
    return np.concatenate([side[0] + more[::-1] * before, side, side[-1] + more * behind])


def _ahead(strip: Strip, radius: float, ring: bool) -> FloatArray:
    """How many rulings (M,) the place on the upper guide is ahead; ``ring``: of the longer strip of one."""
    count = len(strip.low)
    if count < 5:
        return np.zeros(count)
    step = float(np.median(np.linalg.norm(np.diff(strip.high, axis=0), axis=1)))
    most = min(MOST_AHEAD * radius / max(step, 1e-9), RULING_WINDOW - 2.0)
    edge = RULING_WINDOW if ring else 0
    rows = np.unique(np.linspace(edge, count - 1 - edge, min(count, CHOSEN_RULINGS)).astype(np.int64))
    best, width = np.zeros(len(rows)), most
    for _ in range(AHEAD_ZOOMS):
        tried = best[:, None] + np.linspace(-width, width, AHEAD_TRIALS)
        tried = np.clip(tried, -most, most)
        which, ahead = np.repeat(rows, AHEAD_TRIALS), tried.ravel()
        low, high = _touching(strip, radius, which, ahead)
        worst = np.abs(_off(strip, radius, low, high, which + 0.5 * ahead)).max(axis=1)
        cost = worst.reshape(tried.shape) + AHEAD_COST * radius * np.square(tried * step / radius)
        best = tried[np.arange(len(rows)), cost.argmin(axis=1)]
        width *= 2.0 / (AHEAD_TRIALS - 1)
    spread = np.interp(np.arange(count), rows, best)
    # the guides end: what is ahead of the last ruling is not there
    room = np.minimum(np.arange(count), np.arange(count)[::-1]).astype(np.float64)
    if ring:
        spread = gaussian_filter1d(spread[RULING_WINDOW : -RULING_WINDOW - 1], SMOOTHING_RULINGS, mode="wrap")
        spread = spread[np.arange(-RULING_WINDOW, count - RULING_WINDOW) % len(spread)]
    else:
        spread = gaussian_filter1d(spread, SMOOTHING_RULINGS, mode="nearest")
    return np.asarray(np.clip(spread, -room, room))


def _touching(
    strip: Strip, radius: float, rows: IntArray, ahead: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The axes (N, 3) of cylinders that touch the lower guide at rulings ``rows`` and the upper one ``ahead``
    (N,) rulings farther on."""
    first, second = strip.tangents()
    below, tangent = strip.low[rows], first[rows]
    at = np.clip(rows + ahead, 0, len(strip.low) - 1)
    above, along = _at(strip.high, at), unit(_at(second, at))
    way = unit(above - below)
    for _ in range(AXIS_ROUNDS):
        low = below + radius * unit(strip.out * np.cross(tangent, way))
        high = above + radius * unit(strip.out * np.cross(along, way))
        fresh = unit(high - low)
        moved = float(np.abs(fresh - way).max(initial=0.0))
        way = fresh
        if moved < AXIS_SETTLED:
            break
    return low, high


def _off(strip: Strip, radius: float, low: FloatArray, high: FloatArray, about: FloatArray) -> FloatArray:
    """How far (N, K) [m] the surface's lines at the levels stay off cylinders near rulings ``about`` (N,)."""
    centre = np.clip(np.round(about).astype(np.int64), 0, len(strip.low) - 1)
    rows = np.clip(centre[:, None] + np.arange(-RULING_WINDOW, RULING_WINDOW + 1), 0, len(strip.low) - 1)
    way = unit(high - low)
    out = np.empty((len(low), len(RULING_SHARES)))
    for k, share in enumerate(RULING_SHARES):
        line = (1.0 - share) * strip.low + share * strip.high
        # by coordinate, (3, N, W), which is how so many short vectors are worked out fastest
        rest = np.ascontiguousarray(line.T).take(rows, axis=1) - low.T[..., None]
        rest -= np.einsum("dnw,dn->nw", rest, way.T) * way.T[..., None]
        square = np.einsum("dnw,dnw->nw", rest, rest)
        near = rows[np.arange(len(rows)), square.argmin(axis=1)]
        # beyond the ends of the guides there is no surface that a cylinder could be off
        inside = (near > 0) & (near < len(strip.low) - 1)
        out[:, k] = np.where(inside, _least(square) - radius, 0.0)
    return out


def _least(square: FloatArray) -> FloatArray:
    """Root (N,) of the least of squares (N, W), by the parabola through it and its neighbours."""
    k = np.clip(square.argmin(axis=1), 1, square.shape[1] - 2)
    row = np.arange(len(square))
    a, b, c = square[row, k - 1], square[row, k], square[row, k + 1]
    bend = a - 2.0 * b + c
    low = np.where(bend > 1e-18, b - np.square(a - c) / (8.0 * np.maximum(bend, 1e-18)), b)
    return np.asarray(np.sqrt(np.maximum(np.minimum(low, square.min(axis=1)), 0.0)))


def _at(rows: FloatArray, place: FloatArray) -> FloatArray:
    """Rows (N, 3) at fractional indices ``place`` (N,)."""
    first = np.clip(place.astype(np.int64), 0, len(rows) - 2)
    share = (place - first)[:, None]
    return np.asarray((1.0 - share) * rows[first] + share * rows[first + 1])
