"""Curves: Bezier and B-spline, lofts of them, guides of ruled surfaces, closed outlines of plates.

A loft goes along an arc rail, or through given curves in space. It blends the control points of its
profiles by a spline over ``at``, so a point of it is

    S(u, v) = frame(u) applied to sum_j N_j(v) c_j(u),

with N_j the Bernstein polynomials or the cubic B-spline basis (Piegl and Tiller, The NURBS Book,
1997, ch. 1-2).

Guides are dense points with their corners, from polylines and splines. Outlines are planar, cut
through a plate: which lies in which, and what is wrong with them.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from shapely import LinearRing, MultiPoint, Polygon, STRtree
from shapely.ops import nearest_points
from shapely.validation import explain_validity

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.units import MM
from planner.issues import Issue

CurveKind = Literal["bezier", "bspline"]


def basis(kind: CurveKind, count: int) -> BSpline:
    """The basis of ``count`` control points as one vector-valued spline on [0, 1]: value (..., count).

    ``bezier`` has degree count - 1; ``bspline`` is clamped, uniform, cubic (lower when count < 4).
    """
    if count < 2:
        raise ValueError(f"control points: got {count}, at least 2 are needed")
    degree = count - 1 if kind == "bezier" else min(3, count - 1)
    inner = np.linspace(0.0, 1.0, count - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    return BSpline(knots, np.eye(count), degree)


def curve_points(kind: CurveKind, control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (..., D) at t (...,) in [0, 1] of the curve with control points (count, D)."""
    return np.asarray(basis(kind, len(control))(t) @ control)


@dataclasses.dataclass(frozen=True)
class ArcRail:
    """A horizontal arc; profiles stand in its normal planes, as (out, up). Angles [rad], radius [m]."""

    radius: float
    start: float
    end: float
    centre: FloatArray


@dataclasses.dataclass(frozen=True)
class Loft:
    """A surface S(u, v), u and v in [0, 1]: profiles at ``at`` (P,), control points (P, count, 2 or 3) [m].

    With a ``rail``, control points are (out, up) in the normal planes of the arc; without, points in space.
    """

    kind: CurveKind
    at: FloatArray
    control: FloatArray
    rail: ArcRail | None

    def points(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Points (..., 3) at u, v (...,)."""
        return self._evaluate(u, v, 0, 0)

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Unit normals (..., 3) along dS/du x dS/dv: outward if start < end and profiles go up."""
        cross = np.cross(self._evaluate(u, v, 1, 0), self._evaluate(u, v, 0, 1))
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        return np.asarray(cross / np.where(length > 0.0, length, 1.0))

    def _evaluate(self, u: FloatArray, v: FloatArray, du: int, dv: int) -> FloatArray:
        degree = min(3, len(self.at) - 1)
        flat = self.control.reshape(len(self.at), -1)
        blend = make_interp_spline(self.at, flat, k=degree) if degree else None
        weights = basis(self.kind, self.control.shape[1])
        shape = (*np.shape(u), *self.control.shape[1:])

        def profile(order: int) -> FloatArray:
            if blend is None:
                value = np.broadcast_to(flat[0] * (order == 0), (*np.shape(u), flat.shape[1]))
            else:
                value = blend(u, nu=order)
            n = weights(v, nu=dv)
            return np.asarray(np.einsum("...j,...jd->...d", n, np.reshape(value, shape)))

        if self.rail is None:
            return profile(du)
        sweep = self.rail.end - self.rail.start
        angle = self.rail.start + sweep * np.asarray(u)
        radial = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        around = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)
        up = np.array([0.0, 0.0, 1.0])
        p = profile(0)
        base = self.rail.radius * (dv == 0)
        if du == 0:
            point = (base + p[..., :1]) * radial + p[..., 1:] * up
            return np.asarray(point + self.rail.centre * (dv == 0))
        q = profile(1)
        return np.asarray(q[..., :1] * radial + (base + p[..., :1]) * sweep * around + q[..., 1:] * up)


def grid_counts(loft: Loft, u: Sequence[float], v: Sequence[float], chord: float) -> tuple[int, int]:
    """How many cells along u and v keep the facets of the region within ``chord`` [m] of the surface.

    From a trial grid: the distance of a chord to its curve falls with the square of the step.
    """
    trial = 24
    uu, vv = np.linspace(u[0], u[1], 2 * trial + 1), np.linspace(v[0], v[1], 2 * trial + 1)
    p = loft.points(*np.meshgrid(uu, vv, indexing="ij"))
    along_u = np.linalg.norm(p[1::2] - 0.5 * (p[:-1:2] + p[2::2]), axis=-1).max()
    along_v = np.linalg.norm(p[:, 1::2] - 0.5 * (p[:, :-1:2] + p[:, 2::2]), axis=-1).max()
    twist = p[:-1:2, :-1:2] + p[2::2, 2::2] - p[:-1:2, 2::2] - p[2::2, :-1:2]
    share = 0.35 * chord  # each of the three errors may use a third
    nu = trial * np.sqrt(along_u / share)
    nv = trial * np.sqrt(along_v / share)
    nu, nv = max(4.0, nu), max(4.0, nv)
    diagonal = 0.25 * np.linalg.norm(twist, axis=-1).max() * trial * trial / (nu * nv)
    grow = np.sqrt(max(1.0, diagonal / share))
    return int(np.ceil(nu * grow)), int(np.ceil(nv * grow))


def tessellate(
    loft: Loft, u: Sequence[float], v: Sequence[float], chord: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Vertices (V, 3), their exact normals (V, 3) and faces (F, 3) of a region.

    Facets stay within ``chord`` [m] of the surface. Face normals point along dS/du x dS/dv.
    """
    nu, nv = grid_counts(loft, u, v, chord)
    uu, vv = np.meshgrid(np.linspace(u[0], u[1], nu + 1), np.linspace(v[0], v[1], nv + 1), indexing="ij")
    index = np.arange((nu + 1) * (nv + 1)).reshape(nu + 1, nv + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return loft.points(uu, vv).reshape(-1, 3), loft.normals(uu, vv).reshape(-1, 3), faces.astype(np.int64)


CORNER_ANGLE: Final = float(np.deg2rad(20.0))
"""Where a polyline turns by more than this [rad] it has a corner; by less it stands for a smooth curve."""


@dataclasses.dataclass(frozen=True)
class Guide:
    """A curve as dense points (N, 3) [m]; a ``closed`` one does not repeat its first point.

    ``corner`` (N,): where it has an edge. ``anchor`` (N,): where a guide is matched to its fellow point by
    point; all corners are, and the ends of an open guide. ``parameter`` (N,): ascending in [0, 1], of the
    curve that the points come from; a closed one comes back to its first point at 1.
    """

    points: FloatArray
    corner: BoolArray
    parameter: FloatArray
    closed: bool = False
    anchor: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        anchor = self.corner.copy() if len(self.anchor) == 0 else self.anchor | self.corner
        if not self.closed:
            anchor[[0, -1]] = True
        object.__setattr__(self, "anchor", anchor)

    @property
    def length(self) -> float:
        """Length [m], the closing step of a closed guide included."""
        return float(np.linalg.norm(np.diff(ring(self), axis=0), axis=1).sum())


def ring(guide: Guide) -> FloatArray:
    """Points (N or N + 1, 3), with the first one again at the end of a closed guide."""
    return np.concatenate([guide.points, guide.points[:1]]) if guide.closed else guide.points


def turns(points: FloatArray, closed: bool) -> FloatArray:
    """Angles (N,) [rad] by which a polyline turns at its points; 0 at the ends of an open one."""
    way = np.diff(np.concatenate([points[-1:], points, points[:1]]), axis=0)
    unit = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
    cross = np.linalg.norm(np.cross(unit[:-1], unit[1:]), axis=1)
    turn = np.arctan2(cross, np.sum(unit[:-1] * unit[1:], axis=1))
    if not closed:
        turn[[0, -1]] = 0.0
    return np.asarray(turn)


def polyline(points: FloatArray, closed: bool = False, angle: float = CORNER_ANGLE) -> Guide:
    """A guide through points (N, 3) with corners where it turns by more than ``angle`` [rad].

    Points that repeat the one before them are left out, as is the last one of a closed guide where it repeats
    the first. Its parameter counts the points.
    """
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    own = points[keep]
    if closed and len(own) > 1 and np.linalg.norm(own[-1] - own[0]) <= 1e-9:
        own = own[:-1]
    count = len(own)
    parameter = np.arange(count) / max(1, count if closed else count - 1)
    return Guide(own, turns(own, closed) > angle, parameter, closed)


def spline(kind: CurveKind, control: FloatArray, chord: float, closed: bool = False) -> Guide:
    """A guide along a Bezier curve or clamped cubic B-spline with ``control`` points (C, 3), within ``chord``
    [m] of it. A closed one has a corner where its ends meet at an angle.
    """
    t = np.linspace(0.0, 1.0, 257)
    for _ in range(6):
        points = curve_points(kind, control, t)
        middle = curve_points(kind, control, 0.5 * (t[1:] + t[:-1]))
        off = np.linalg.norm(middle - 0.5 * (points[1:] + points[:-1]), axis=1)
        if off.max() <= chord:
            break
        t = np.sort(np.concatenate([t, 0.5 * (t[1:] + t[:-1])[off > chord]]))
    points = curve_points(kind, control, t)
    corner = np.zeros(len(t), dtype=np.bool_)
    if not closed:
        return Guide(points, corner, t)
    corner[0] = turns(points[:-1], True)[0] > CORNER_ANGLE
    return Guide(points[:-1], corner[:-1], t[:-1], closed=True)


def with_corners(guide: Guide, at: FloatArray) -> Guide:
    """The guide with corners at its points nearest to ``at`` (C, 3) and nowhere else."""
    distance = np.linalg.norm(guide.points[:, None] - at[None], axis=2)
    corner = np.zeros(len(guide.points), dtype=np.bool_)
    corner[np.argmin(distance, axis=0)] = True
    if not guide.closed:
        corner[[0, -1]] = False
    return dataclasses.replace(guide, corner=corner, anchor=np.zeros(0, dtype=np.bool_))


def turned(guide: Guide) -> Guide:
    """The guide run the other way round; a closed one keeps its first point."""
    if not guide.closed:
        return dataclasses.replace(
            guide,
            points=guide.points[::-1],
            corner=guide.corner[::-1],
            anchor=guide.anchor[::-1],
            parameter=1.0 - guide.parameter[::-1],
        )
    order = (-np.arange(len(guide.points))) % len(guide.points)
    parameter = (1.0 - guide.parameter[order]) % 1.0
    return dataclasses.replace(
        guide,
        points=guide.points[order],
        corner=guide.corner[order],
        anchor=guide.anchor[order],
        parameter=parameter,
    )


def rolled(guide: Guide, first: int) -> Guide:
    """A closed guide that starts at its point ``first``."""
    if not guide.closed:
        raise ValueError("only a closed guide can start elsewhere")
    order = (np.arange(len(guide.points)) + first) % len(guide.points)
    parameter = (guide.parameter[order] - guide.parameter[first]) % 1.0
    return dataclasses.replace(
        guide,
        points=guide.points[order],
        corner=guide.corner[order],
        anchor=guide.anchor[order],
        parameter=parameter,
    )


def pieces(guide: Guide) -> list[tuple[FloatArray, FloatArray]]:
    """Points (n, 3) and parameters (n,) of every piece from anchor to anchor, in order.

    A closed guide must start at an anchor, or have none: then it is one piece.
    """
    points = ring(guide)
    parameter = np.append(guide.parameter, 1.0) if guide.closed else guide.parameter
    at = np.flatnonzero(guide.anchor)
    if guide.closed:
        at = np.append(at if len(at) else [0], len(points) - 1)
    return [(points[i : j + 1], parameter[i : j + 1]) for i, j in itertools.pairwise(at)]


def arc_length(points: FloatArray) -> FloatArray:
    """Ways (N,) [m] along a polyline (N, 3) from its first point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def along(points: FloatArray, places: FloatArray, wanted: FloatArray) -> FloatArray:
    """Points (K, 3) of a polyline (N, 3) at ``wanted`` (K,) of its ascending ``places`` (N,)."""
    return np.stack([np.interp(wanted, places, points[:, axis]) for axis in range(points.shape[1])], axis=1)


TOUCHING_DISTANCE: Final = 1e-5
"""Outlines [m] that are this near touch each other; all along, they are the same one."""


@dataclasses.dataclass(frozen=True)
class Outline:
    """A closed outline (N, 2) [m], counterclockwise; ``depth`` counts the outlines around it.

    Those of odd depth are holes. ``corner`` (N,) marks its corners.
    """

    points: FloatArray
    corner: BoolArray
    depth: int = 0
    inside: int | None = None

    @property
    def hole(self) -> bool:
        """Whether the part lies around it."""
        return self.depth % 2 == 1


def check_outlines(rings: Sequence[FloatArray], names: Sequence[str]) -> list[Issue]:
    """Issues of closed rings (N, 2): crossing themselves, given twice, crossing or touching each other.

    ``names`` are the fields of the issues.
    """
    issues = []
    polygons = [Polygon(ring) for ring in rings]
    sound = []
    for polygon, ring, name in zip(polygons, rings, names, strict=True):
        if LinearRing(ring).is_simple and polygon.is_valid:
            sound.append(True)
            continue
        sound.append(False)
        where = explain_validity(polygon)
        place = where[where.find("[") + 1 : where.find("]")].split() if "[" in where else []
        at = f" near ({', '.join(f'{float(v) / MM:.2f}' for v in place[:2])}) mm" if place else ""
        what = f"the outline crosses or touches itself{at}; correct it there"
        issues.append(Issue("part.outline_crossing", what, field=name))
    tree = STRtree(polygons)
    for i, polygon in enumerate(polygons):
        for j in sorted(
            int(k) for k in tree.query(polygon, predicate="dwithin", distance=TOUCHING_DISTANCE) if k > i
        ):
            if not (sound[i] and sound[j]):
                continue
            other = polygons[j]
            alike = np.abs(np.subtract(polygon.bounds, other.bounds)).max() < TOUCHING_DISTANCE
            if alike and polygon.exterior.hausdorff_distance(other.exterior) < TOUCHING_DISTANCE:
                what = f"is the same outline as {names[i]}; leave one out"
                issues.append(Issue("part.outline_duplicate", what, field=names[j]))
            elif polygon.exterior.dwithin(other.exterior, TOUCHING_DISTANCE):
                meet = nearest_points(polygon.exterior, other.exterior)[0]
                what = f"crosses or touches {names[i]} near ({meet.x / MM:.2f}, {meet.y / MM:.2f}) mm; "
                what += "outlines must "
                what += "lie apart or one in the other, so move or join them"
                issues.append(Issue("part.outline_overlap", what, field=names[j]))
    return issues


def sides(points: FloatArray) -> tuple[float, float]:
    """Long and short side [m] of the smallest rectangle, turned as it likes, around points (K, 2) [m]."""
    around = MultiPoint(np.asarray(points)).minimum_rotated_rectangle
    if around.geom_type != "Polygon":  # all on one line, or at one place
        return float(around.length), 0.0
    one, other = np.linalg.norm(np.diff(np.asarray(around.exterior.coords), axis=0), axis=1)[:2].tolist()
    return max(one, other), min(one, other)


def nested(rings: Sequence[FloatArray], corners: Sequence[BoolArray]) -> list[Outline]:
    """The rings, counterclockwise, with their depth, in the order in which they may be cut: the inmost first,
    each hole before the outline around it, and otherwise as they are given.

    They must be free of the faults that :func:`check_outlines` finds. ``inside`` is the index, in the list
    returned, of the outline next around.
    """
    polygons = [Polygon(ring) for ring in rings]
    inner, outer = STRtree(polygons).query(polygons, predicate="within")
    within = np.zeros((len(rings), len(rings)), dtype=np.bool_)
    within[inner, outer] = inner != outer
    depth = within.sum(axis=1)
    order = sorted(range(len(rings)), key=lambda i: -int(depth[i]))
    out = []
    for i in order:
        around = [j for j in np.flatnonzero(within[i]) if depth[j] == depth[i] - 1]
        inside = order.index(int(around[0])) if around else None
        turned = not polygons[i].exterior.is_ccw
        points = rings[i][::-1] if turned else rings[i]
        corner = corners[i][::-1] if turned else corners[i]
        out.append(Outline(points, corner, int(depth[i]), inside))
    return out
