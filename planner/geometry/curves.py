"""Curves: Bezier and B-spline, lofts of them, guides of ruled surfaces, closed outlines of plates.

A loft goes along an arc rail, or through given curves in space. It blends the control points of its profiles
by a spline over ``at``, so a point of it is

    S(u, v) = frame(u) applied to sum_j N_j(v) c_j(u),

with N_j the Bernstein polynomials or the cubic B-spline basis.

Guides are dense points with their corners, from polylines and splines. Outlines are planar and cut through a
plate. They are nested and checked here.

Source: Piegl and Tiller, The NURBS Book, 1997, ch. 1-2.
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
    """Return the basis of control points as one vector-valued spline on [0, 1] with values (..., count).

    Args:
        kind: ``bezier`` has degree count - 1; ``bspline`` is clamped, uniform, cubic (lower if count < 4).
        count: Number of control points.

    Raises:
        ValueError: Fewer than two control points.
    """
    if count < 2:
        raise ValueError(f"control points: got {count}, at least 2 are needed")
    degree = count - 1 if kind == "bezier" else min(3, count - 1)
    inner = np.linspace(0.0, 1.0, count - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    return BSpline(knots, np.eye(count), degree)


def curve_points(kind: CurveKind, control: FloatArray, t: FloatArray) -> FloatArray:
    """Return points (..., D) of a curve.

    Args:
        kind: Kind of the curve.
        control: Control points (count, D).
        t: Parameters (...,) in [0, 1].
    """
    return np.asarray(basis(kind, len(control))(t) @ control)


@dataclasses.dataclass(frozen=True)
class ArcRail:
    """A horizontal arc. Profiles are in its normal planes, as (out, up).

    Attributes:
        radius: Radius [m].
        start: Start angle [rad].
        end: End angle [rad].
        centre: Centre (3,) [m].
    """

    radius: float
    start: float
    end: float
    centre: FloatArray


@dataclasses.dataclass(frozen=True)
class LoftSurface:
    """A surface S(u, v), u and v in [0, 1].

    Attributes:
        kind: Kind of the profiles.
        at: Parameters of the profiles (P,).
        control: Control points (P, count, 2 or 3) [m]: with a rail (out, up) in its normal planes, else
            points in space.
        rail: Arc along which the profiles are placed, None for profiles in space.
    """

    kind: CurveKind
    at: FloatArray
    control: FloatArray
    rail: ArcRail | None

    def points(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return points (..., 3) at u, v (...,)."""
        return self._evaluate(u, v, 0, 0)

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return unit normals (..., 3) along dS/du x dS/dv.

        They point outwards if start < end and profiles go up.
        """
        cross = np.cross(self._evaluate(u, v, 1, 0), self._evaluate(u, v, 0, 1))
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        return np.asarray(cross / np.where(length > 0.0, length, 1.0))

    def _evaluate(self, u: FloatArray, v: FloatArray, du: int, dv: int) -> FloatArray:
        """Return the derivative (..., 3) of S of orders ``du`` by u and ``dv`` by v, each 0 or 1."""
        degree = min(3, len(self.at) - 1)
        flat = self.control.reshape(len(self.at), -1)
        blend = make_interp_spline(self.at, flat, k=degree) if degree else None
        weights = basis(self.kind, self.control.shape[1])
        shape = (*np.shape(u), *self.control.shape[1:])

        def profile(order: int) -> FloatArray:
            """Return the blended profile at v, derived ``order`` times by u and ``dv`` times by v."""
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


def grid_counts(loft: LoftSurface, u: Sequence[float], v: Sequence[float], chord: float) -> tuple[int, int]:
    """Return the numbers of cells along u and v that keep the facets of a region within a chord error.

    They follow from a trial grid: the chord error is proportional to the square of the step.

    Args:
        loft: The loft.
        u: Range of u.
        v: Range of v.
        chord: Chord error [m].
    """
    trial = 24
    uu, vv = np.linspace(u[0], u[1], 2 * trial + 1), np.linspace(v[0], v[1], 2 * trial + 1)
    p = loft.points(*np.meshgrid(uu, vv, indexing="ij"))
    along_u = np.linalg.norm(p[1::2] - 0.5 * (p[:-1:2] + p[2::2]), axis=-1).max()
    along_v = np.linalg.norm(p[:, 1::2] - 0.5 * (p[:, :-1:2] + p[:, 2::2]), axis=-1).max()
    twist = p[:-1:2, :-1:2] + p[2::2, 2::2] - p[:-1:2, 2::2] - p[2::2, :-1:2]
    error_limit = 0.35 * chord  # each of the three errors may use about a third
    nu = trial * np.sqrt(along_u / error_limit)
    nv = trial * np.sqrt(along_v / error_limit)
    nu, nv = max(4.0, nu), max(4.0, nv)
    diagonal = 0.25 * np.linalg.norm(twist, axis=-1).max() * trial * trial / (nu * nv)
    grow = np.sqrt(max(1.0, diagonal / error_limit))
    return int(np.ceil(nu * grow)), int(np.ceil(nv * grow))


def tessellate(
    loft: LoftSurface, u: Sequence[float], v: Sequence[float], chord: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return vertices (V, 3), exact normals (V, 3) and faces (F, 3) of a region.

    Face normals are along dS/du x dS/dv.

    Args:
        loft: The loft.
        u: Range of u.
        v: Range of v.
        chord: Chord error of the facets [m].
    """
    nu, nv = grid_counts(loft, u, v, chord)
    uu, vv = np.meshgrid(np.linspace(u[0], u[1], nu + 1), np.linspace(v[0], v[1], nv + 1), indexing="ij")
    index = np.arange((nu + 1) * (nv + 1)).reshape(nu + 1, nv + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return loft.points(uu, vv).reshape(-1, 3), loft.normals(uu, vv).reshape(-1, 3), faces.astype(np.int64)


CORNER_ANGLE_RAD: Final = float(np.deg2rad(20.0))
"""Angle of a polyline [rad] above which it has a corner. Smaller angles represent a smooth curve."""


@dataclasses.dataclass(frozen=True)
class RuledGuide:
    """A curve as dense points.

    Attributes:
        points: Points (N, 3) [m]; a closed guide does not repeat its first point.
        corner: Where it has an edge (N,).
        parameter: Ascending parameters in [0, 1] of the source curve (N,). A closed curve returns to its
            first point at 1.
        closed: Whether it is closed.
        anchor: Where it is matched to the other guide point by point (N,): all corners, and the ends of an
            open guide.
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
        """Length [m], including the closing step of a closed guide."""
        return float(np.linalg.norm(np.diff(closed_points(self), axis=0), axis=1).sum())


def closed_points(guide: RuledGuide) -> FloatArray:
    """Return points (N or N + 1, 3), with the first one repeated at the end of a closed guide."""
    return np.concatenate([guide.points, guide.points[:1]]) if guide.closed else guide.points


def turning_angles(points: FloatArray, closed: bool) -> FloatArray:
    """Return the angles (N,) [rad] of a polyline at its points; 0 at the ends of an open one.

    Args:
        points: Points (N, 3).
        closed: Whether it is closed.
    """
    steps = np.diff(np.concatenate([points[-1:], points, points[:1]]), axis=0)
    unit = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-300)
    cross = np.linalg.norm(np.cross(unit[:-1], unit[1:]), axis=1)
    angles = np.arctan2(cross, np.sum(unit[:-1] * unit[1:], axis=1))
    if not closed:
        angles[[0, -1]] = 0.0
    return np.asarray(angles)


def polyline_guide(points: FloatArray, closed: bool = False, angle: float = CORNER_ANGLE_RAD) -> RuledGuide:
    """Return a guide through points, with corners at large angles. Its parameter counts the points.

    Repeated points are left out, and the last point of a closed guide if it equals the first one.

    Args:
        points: Points (N, 3) [m].
        closed: Whether it is closed.
        angle: Minimum angle of a corner [rad].
    """
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    distinct = points[keep]
    if closed and len(distinct) > 1 and np.linalg.norm(distinct[-1] - distinct[0]) <= 1e-9:
        distinct = distinct[:-1]
    count = len(distinct)
    parameter = np.arange(count) / max(1, count if closed else count - 1)
    return RuledGuide(distinct, turning_angles(distinct, closed) > angle, parameter, closed)


def spline_guide(kind: CurveKind, control: FloatArray, chord: float, closed: bool = False) -> RuledGuide:
    """Return a guide along a Bezier curve or clamped cubic B-spline.

    A closed one has a corner where its ends meet at an angle.

    Args:
        kind: Kind of the curve.
        control: Control points (C, 3) [m].
        chord: Chord error [m].
        closed: Whether it is closed.
    """
    t = np.linspace(0.0, 1.0, 257)
    for _ in range(6):
        points = curve_points(kind, control, t)
        middle = curve_points(kind, control, 0.5 * (t[1:] + t[:-1]))
        deviation = np.linalg.norm(middle - 0.5 * (points[1:] + points[:-1]), axis=1)
        if deviation.max() <= chord:
            break
        t = np.sort(np.concatenate([t, 0.5 * (t[1:] + t[:-1])[deviation > chord]]))
    points = curve_points(kind, control, t)
    corner = np.zeros(len(t), dtype=np.bool_)
    if not closed:
        return RuledGuide(points, corner, t)
    corner[0] = turning_angles(points[:-1], True)[0] > CORNER_ANGLE_RAD
    return RuledGuide(points[:-1], corner[:-1], t[:-1], closed=True)


def with_corners(guide: RuledGuide, at: FloatArray) -> RuledGuide:
    """Return the guide with corners only at its points nearest to ``at`` (C, 3)."""
    distance = np.linalg.norm(guide.points[:, None] - at[None], axis=2)
    corner = np.zeros(len(guide.points), dtype=np.bool_)
    corner[np.argmin(distance, axis=0)] = True
    if not guide.closed:
        corner[[0, -1]] = False
    return dataclasses.replace(guide, corner=corner, anchor=np.zeros(0, dtype=np.bool_))


def reverse_guide(guide: RuledGuide) -> RuledGuide:
    """Return the guide in the opposite direction. A closed one keeps its first point."""
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


def roll_guide(guide: RuledGuide, first: int) -> RuledGuide:
    """Return a closed guide that starts at its point ``first``.

    Raises:
        ValueError: The guide is open.
    """
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


def anchor_pieces(guide: RuledGuide) -> list[tuple[FloatArray, FloatArray]]:
    """Return points (n, 3) and parameters (n,) of each piece from anchor to anchor, in order.

    A closed guide has to start at an anchor. Without anchors it is one piece.
    """
    points = closed_points(guide)
    parameter = np.append(guide.parameter, 1.0) if guide.closed else guide.parameter
    at = np.flatnonzero(guide.anchor)
    if guide.closed:
        at = np.append(at if len(at) else [0], len(points) - 1)
    return [(points[i : j + 1], parameter[i : j + 1]) for i, j in itertools.pairwise(at)]


def arc_length(points: FloatArray) -> FloatArray:
    """Return lengths (N,) [m] along a polyline (N, 3) from its first point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def interpolate_polyline(points: FloatArray, parameters: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate a polyline linearly between its points.

    Args:
        points: Points (N, D).
        parameters: Ascending parameters of the points (N,).
        at: Parameters of the result (K,). Those outside the range of ``parameters`` give the first or last
            point.

    Returns:
        Points (K, D).
    """
    return np.stack([np.interp(at, parameters, points[:, axis]) for axis in range(points.shape[1])], axis=1)


TOUCHING_DISTANCE_M: Final = 1e-5
"""Distance [m] at which outlines touch. Outlines that touch everywhere are duplicates."""


@dataclasses.dataclass(frozen=True)
class PlateOutline:
    """A closed planar outline.

    Attributes:
        points: Points (N, 2) [m], counterclockwise.
        corner: Whether each point is a corner (N,).
        depth: Number of outlines around it; those of odd depth are holes.
        parent: Index of the innermost outline around it in a list of outlines, None if there is none.
    """

    points: FloatArray
    corner: BoolArray
    depth: int = 0
    parent: int | None = None

    @property
    def hole(self) -> bool:
        """Whether the part is outside of it."""
        return self.depth % 2 == 1


def check_outlines(rings: Sequence[FloatArray], names: Sequence[str]) -> list[Issue]:
    """Return issues of closed rings: self-crossing, duplicate, crossing or touching each other.

    Args:
        rings: Rings (N, 2) [m].
        names: Fields of the issues.
    """
    issues = []
    polygons = [Polygon(ring) for ring in rings]
    is_valid = []
    for polygon, ring, name in zip(polygons, rings, names, strict=True):
        if LinearRing(ring).is_simple and polygon.is_valid:
            is_valid.append(True)
            continue
        is_valid.append(False)
        validity = explain_validity(polygon)
        position = validity[validity.find("[") + 1 : validity.find("]")].split() if "[" in validity else []
        place_text = (
            f" near ({', '.join(f'{float(v) / MM:.2f}' for v in position[:2])}) mm" if position else ""
        )
        text = f"the outline crosses or touches itself{place_text}; correct it there"
        issues.append(Issue("part.outline_crossing", text, field=name))
    tree = STRtree(polygons)
    for i, polygon in enumerate(polygons):
        for j in sorted(
            int(k) for k in tree.query(polygon, predicate="dwithin", distance=TOUCHING_DISTANCE_M) if k > i
        ):
            if not (is_valid[i] and is_valid[j]):
                continue
            other = polygons[j]
            same_bounds = np.abs(np.subtract(polygon.bounds, other.bounds)).max() < TOUCHING_DISTANCE_M
            if same_bounds and polygon.exterior.hausdorff_distance(other.exterior) < TOUCHING_DISTANCE_M:
                text = f"is the same outline as {names[i]}; remove one of them"
                issues.append(Issue("part.outline_duplicate", text, field=names[j]))
            elif polygon.exterior.dwithin(other.exterior, TOUCHING_DISTANCE_M):
                contact = nearest_points(polygon.exterior, other.exterior)[0]
                text = f"crosses or touches {names[i]} near ({contact.x / MM:.2f}, {contact.y / MM:.2f}) mm; "
                text += "outlines must be separate or one inside the other, so move or join them"
                issues.append(Issue("part.outline_overlap", text, field=names[j]))
    return issues


def bounding_sides(points: FloatArray) -> tuple[float, float]:
    """Return long and short side [m] of the smallest rotated rectangle around points (K, 2) [m]."""
    rectangle = MultiPoint(np.asarray(points)).minimum_rotated_rectangle
    if rectangle.geom_type != "Polygon":  # all on one line, or coincident
        return float(rectangle.length), 0.0
    first, second = np.linalg.norm(np.diff(np.asarray(rectangle.exterior.coords), axis=0), axis=1)[
        :2
    ].tolist()
    return max(first, second), min(first, second)


def nest_outlines(rings: Sequence[FloatArray], corners: Sequence[BoolArray]) -> list[PlateOutline]:
    """Return the rings as outlines in a possible order of cutting: innermost first, otherwise as given.

    Each hole comes before the outline around it. Outlines are counterclockwise and have a depth.

    Args:
        rings: Rings (N, 2) [m] without the faults that :func:`check_outlines` finds.
        corners: Whether each point of each ring is a corner (N,).

    Returns:
        Outlines. Their ``parent`` is an index into this list.
    """
    polygons = [Polygon(ring) for ring in rings]
    inner, outer = STRtree(polygons).query(polygons, predicate="within")
    within = np.zeros((len(rings), len(rings)), dtype=np.bool_)
    within[inner, outer] = inner != outer
    depth = within.sum(axis=1)
    order = sorted(range(len(rings)), key=lambda i: -int(depth[i]))
    out = []
    for i in order:
        enclosing = [j for j in np.flatnonzero(within[i]) if depth[j] == depth[i] - 1]
        parent = order.index(int(enclosing[0])) if enclosing else None
        is_clockwise = not polygons[i].exterior.is_ccw
        points = rings[i][::-1] if is_clockwise else rings[i]
        corner = corners[i][::-1] if is_clockwise else corners[i]
        out.append(PlateOutline(points, corner, int(depth[i]), parent))
    return out
