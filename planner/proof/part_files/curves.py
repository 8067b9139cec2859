"""Curves of DXF drawings, Bezier curves and B-splines, and ruled surfaces between two guides.

ezdxf parses the text; what arcs, bulges, ellipses and splines are is worked out here. Source:
Autodesk, DXF Reference (2018), entities and "Arbitrary Axis Algorithm". Bezier curves by de
Casteljau's steps, clamped cubic B-splines by Cox and de Boor's, and lofts of them: G. Farin, Curves
and Surfaces for CAGD (2002), 4.2 and 8.2.

Which points of two guides are joined, the problem's words on them say. Corners, and the ends of
open guides, are kept together; between them points at equal shares of the way, or of the parameter,
are joined. Of the ways in which two guides may be laid on each other that one counts with the
shortest rulings; where several are as short, each of them.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.interpolate import CubicSpline

from planner.geometry.arrays import BoolArray, FloatArray
from planner.proof.part_files import UnreadError


def bezier(control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, D) at t (N,) of control points (C, D), or of one set of them for each (N, C, D)."""
    points = np.broadcast_to(control, (len(t), *control.shape[-2:])).astype(np.float64)
    share = t[:, None, None]
    while points.shape[1] > 1:
        points = points[:, :-1] + share * (points[:, 1:] - points[:, :-1])
    return points[:, 0]


def bspline(control: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, D) at t (N,) in [0, 1] of a clamped uniform B-spline, cubic or of what degree its control
    points (C, D) or (N, C, D) allow."""
    count = control.shape[-2]
    degree = min(3, count - 1)
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    return nurbs(control, np.ones(count), knots, degree, t)


def nurbs(
    control: FloatArray, weight: FloatArray, knots: FloatArray, degree: int, t: FloatArray
) -> FloatArray:
    """Points (N, D) at t (N,) of a rational B-spline: control points (C, D) or (N, C, D), ``weight`` (C,),
    ``knots`` (C + degree + 1,)."""
    count = control.shape[-2]
    span = np.clip(np.searchsorted(knots, t, side="right") - 1, degree, count - 1)
    whole = np.broadcast_to(control, (len(t), *control.shape[-2:]))
    rows = np.arange(len(t))[:, None]
    near = span[:, None] - degree + np.arange(degree + 1)
    point = whole[rows, near] * weight[near][..., None]
    point = np.concatenate([point, weight[near][..., None]], axis=2)
    for level in range(1, degree + 1):
        low = knots[near[:, level:]]
        high = knots[near[:, : degree + 1 - level] + degree + 1]
        share = (t[:, None] - low) / np.where(high > low, high - low, 1.0)
        share = np.where(high > low, share, 0.0)[..., None]
        point = (1.0 - share) * point[:, :-1] + share * point[:, 1:]
    return np.asarray(point[:, 0, :-1] / point[:, 0, -1:])


def blended(at: FloatArray, control: FloatArray, u: FloatArray) -> FloatArray:
    """Control points (N, C, D) between those of the curves (P, C, D) at ``at`` (P,): the spline through them
    with as few joints as it can have, at u (N,)."""
    if len(at) == 1:
        return np.repeat(control, len(u), axis=0)
    return np.asarray(CubicSpline(at, control, axis=0, bc_type="not-a-knot")(u))


JOIN_DISTANCE: Final = 1e-5
"""Ends of pieces that are so near [m] are joined."""
CHORD_ERROR: Final = 1e-6
"""Chords of arcs and splines are off them by this at most [m]."""
LEAST_CHORDS: Final = 48
"""Chords of a full turn, or of a span of a spline, at least."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A curve: points (N, 3) [m], the first not repeated where it is ``closed``; ``pieces`` it was joined of:
    which way round several of them run, a drawing does not say."""

    points: FloatArray
    closed: bool
    pieces: int


def read_curves(path: Path, unit: float, layer: str | None) -> list[Drawn]:
    """The curves of the model space that are visible, of one layer or all. Raises `UnreadError`."""
    try:
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise UnreadError("DXF files need ezdxf: pip install 'tandem-planner[cad]'") from error
    pieces = []
    try:
        drawing = readfile(path)
        dark = {
            str(one.dxf.name).lower() for one in drawing.layers if one.dxf.color < 0 or one.dxf.flags & 1
        }  # off, or frozen
        for entity in drawing.modelspace():
            if entity.dxf.get("invisible", 0) or str(entity.dxf.layer).lower() in dark:
                continue
            if layer is None or str(entity.dxf.layer).lower() == layer.lower():
                points = _points(entity, unit)
                if points is not None and len(points) > 1:
                    pieces.append(points * unit)
    except Exception as error:  # damaged files raise anything
        raise UnreadError(str(error).splitlines()[0][:120] if str(error) else type(error).__name__) from error
    return chained(pieces)


def _points(entity: Any, unit: float) -> FloatArray | None:
    """Points (N, 3) of a curve in the drawing's lengths; None for what is none."""
    kind, dxf = entity.dxftype(), entity.dxf
    if kind == "LINE":
        return np.array([tuple(dxf.start), tuple(dxf.end)], dtype=np.float64)
    if kind in ("ARC", "CIRCLE"):
        first, last = (dxf.start_angle, dxf.end_angle) if kind == "ARC" else (0.0, 360.0)
        turn = (last - first) % 360.0 or 360.0
        angle = np.deg2rad(first + turn * _shares(dxf.radius * unit, np.deg2rad(turn)))
        centre = np.array(tuple(dxf.center), dtype=np.float64)
        flat = dxf.radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        return _to_world(centre + flat, dxf.extrusion)
    if kind == "ELLIPSE":
        major = np.array(tuple(dxf.major_axis), dtype=np.float64)
        up = np.array(tuple(dxf.extrusion), dtype=np.float64)
        minor = dxf.ratio * np.cross(up / np.linalg.norm(up), major)
        turn = (dxf.end_param - dxf.start_param) % (2.0 * np.pi)
        turn = turn if turn > 1e-12 else 2.0 * np.pi
        count = 4 * len(_shares(float(np.linalg.norm(major)) * unit, turn))
        angle = (dxf.start_param + turn * np.linspace(0.0, 1.0, count))[:, None]
        return np.asarray(np.array(tuple(dxf.center)) + np.cos(angle) * major + np.sin(angle) * minor)
    if kind == "SPLINE":
        return _spline(entity)
    if kind == "LWPOLYLINE":
        rows = np.array([(x, y, bulge) for x, y, bulge in entity.get_points("xyb")], dtype=np.float64)
        height = float(dxf.get("elevation", 0.0))
        return _to_world(_bulged(rows, height, bool(entity.closed), unit), dxf.extrusion)
    if kind == "POLYLINE":
        corners = [vertex.dxf for vertex in entity.vertices]
        places = np.array([tuple(vertex.location) for vertex in corners], dtype=np.float64).reshape(-1, 3)
        if entity.is_3d_polyline:
            return np.concatenate([places, places[:1]]) if entity.is_closed else places
        if not entity.is_2d_polyline or not len(places):
            return None
        bulge = np.array([float(vertex.get("bulge", 0.0)) for vertex in corners])
        height = float(tuple(dxf.get("elevation", (0.0, 0.0, 0.0)))[2])
        rows = np.column_stack([places[:, :2], bulge])
        return _to_world(_bulged(rows, height, bool(entity.is_closed), unit), dxf.extrusion)
    return None


def _shares(radius: float, turn: float) -> FloatArray:
    """Places from 0 to 1 along an arc of ``radius`` [m] over ``turn`` [rad]."""
    step = 2.0 * np.arccos(max(0.0, 1.0 - CHORD_ERROR / max(radius, CHORD_ERROR)))
    count = max(int(np.ceil(turn / step)), int(np.ceil(LEAST_CHORDS * turn / (2.0 * np.pi))), 2)
    return np.linspace(0.0, 1.0, count + 1)


def _to_world(points: FloatArray, extrusion: Any) -> FloatArray:
    """Points of an entity's own frame, whose z is ``extrusion``, in that of the drawing."""
    z = np.array(tuple(extrusion), dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0] if max(abs(z[0]), abs(z[1])) < 1.0 / 64.0 else [0.0, 0.0, 1.0], z)
    x = x / np.linalg.norm(x)
    return np.asarray(points @ np.array([x, np.cross(z, x), z]))


def _bulged(rows: FloatArray, height: float, closed: bool, unit: float) -> FloatArray:
    """Points of a polyline (K, 3) of x, y and bulge, the tangent of a quarter of the arc to the next one."""
    out = [rows[:1, :2]]
    after = np.roll(rows, -1, axis=0)
    for start, end in zip(rows[: None if closed else -1], after[: None if closed else -1], strict=True):
        chord, bulge = end[:2] - start[:2], float(start[2])
        size = float(np.hypot(*chord))
        if abs(bulge) < 1e-12 or size == 0.0:
            out.append(end[None, :2])
            continue
        # the arc is on the right of its chord for a bulge above zero; parameters of the half angle's tangent
        turn = 4.0 * np.arctan(bulge)
        radius = 0.5 * size / abs(np.sin(0.5 * turn))
        left = np.array([-chord[1], chord[0]])
        centre = start[:2] + 0.5 * chord + 0.25 * left * (1.0 - bulge**2) / bulge
        angle = turn * _shares(radius * unit, abs(turn))[1:, None]
        arm = start[:2] - centre
        out.append(centre + np.cos(angle) * arm + np.sin(angle) * np.array([-arm[1], arm[0]]))
    flat = np.concatenate(out)
    return np.column_stack([flat, np.full(len(flat), height)])


def _spline(entity: Any) -> FloatArray | None:
    control = np.array([tuple(point) for point in entity.control_points], dtype=np.float64).reshape(-1, 3)
    if not len(control):
        # through fit points alone, a curve is what the program that drew it says
        tool = entity.construction_tool()
        return np.array([tuple(point) for point in tool.approximate(400)], dtype=np.float64)
    degree = int(entity.dxf.degree)
    knots = np.array(list(entity.knots), dtype=np.float64)
    weight = np.array(list(entity.weights), dtype=np.float64)
    weight = weight if len(weight) == len(control) else np.ones(len(control))
    spans = np.unique(knots[degree : len(control) + 1])
    inner = np.linspace(0.0, 1.0, 4 * LEAST_CHORDS, endpoint=False)
    t = np.append((spans[:-1, None] + np.diff(spans)[:, None] * inner).ravel(), spans[-1])
    return nurbs(control, weight, knots, degree, t)


def chained(pieces: list[FloatArray]) -> list[Drawn]:
    """Curves of pieces whose ends meet; what is closed is left as it is. Each is run as its first piece is
    drawn, and begins with that where it is closed."""
    out: list[Drawn] = []
    left = list(range(len(pieces)))
    all_ends = np.array([piece[[0, -1]] for piece in pieces]).reshape(-1, 2, 3)
    all_open = np.array([not _shut(piece) for piece in pieces], dtype=bool)
    while left:
        chain, count, before = pieces[left.pop(0)], 1, 0
        while left and not _shut(chain):
            ends, open_ = all_ends[left], all_open[left]
            gap = np.linalg.norm(ends[:, :, None] - chain[[0, -1]][None, None], axis=3)
            gap[~open_] = np.inf
            which, end, own = np.unravel_index(int(np.argmin(gap)), gap.shape)
            if gap[which, end, own] > JOIN_DISTANCE:
                break
            piece = pieces[left.pop(int(which))]
            piece = piece if end == 0 else piece[::-1]  # leads away from the chain
            chain = np.concatenate([chain, piece[1:]] if own else [piece[:0:-1], chain])
            before += 0 if own else len(piece) - 1
            count += 1
        shut = _shut(chain)
        out.append(Drawn(np.roll(chain[:-1], -before, axis=0) if shut else chain, shut, count))
    return out


def _shut(points: FloatArray) -> bool:
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= JOIN_DISTANCE)


SAME_LENGTH_SHARE: Final = 1e-3
"""Ways to lay guides on each other are as short within this share of the rulings' mean square."""
SAME_PLACE: Final = 1e-9
"""Points of a polyline nearer to each other than this [m] are one."""
START_PLACES: Final = 720
"""Places about a smooth closed guide at which it may begin."""


@dataclasses.dataclass(frozen=True)
class Curve:
    """A guide: points (N, 3) [m], the first not repeated where it is ``closed``; ``parameter`` (N,) ascends
    in [0, 1); ``anchor`` (N,) marks corners and what else is kept together. ``either``: nothing says which
    way it runs."""

    points: FloatArray
    parameter: FloatArray
    anchor: BoolArray
    closed: bool
    either: bool = False


@dataclasses.dataclass(frozen=True)
class Ruled:
    """Rulings from ``start`` to ``end`` (M, 3), the first again at the end of a closed surface; away from the
    part is the direction of ``start`` x the rulings."""

    start: FloatArray
    end: FloatArray


def through(points: FloatArray, closed: bool, angle: float, either: bool = False) -> Curve:
    """A polyline with a corner where it turns by more than ``angle`` [rad]."""
    apart = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > SAME_PLACE)
    own = points[apart]
    if closed and len(own) > 1 and np.linalg.norm(own[0] - own[-1]) <= SAME_PLACE:
        own = own[:-1]
    count = len(own)
    way = np.roll(own, -1, axis=0) - own
    way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
    cosine = np.einsum("ij,ij->i", way, np.roll(way, 1, axis=0))
    corner = np.arccos(np.clip(cosine, -1.0, 1.0)) > angle
    if not closed:
        corner[[0, -1]] = True
    return Curve(own, np.arange(count) / (count if closed else max(count - 1, 1)), corner, closed, either)


def anchored(curve: Curve, at: FloatArray) -> Curve:
    """The curve with corners where it is nearest to ``at`` (C, 3), and nowhere else."""
    anchor = np.zeros(len(curve.points), dtype=np.bool_)
    if len(at):
        anchor[np.linalg.norm(curve.points[:, None] - at[None], axis=2).argmin(axis=0)] = True
    if not curve.closed:
        anchor[[0, -1]] = True
    return dataclasses.replace(curve, anchor=anchor)


def joined(start: Curve, end: Curve, match: str) -> list[Ruled]:
    """The surfaces that the words on two guides allow: one, or more where guides fit as well in several ways.

    Empty where the guides' corners are not as many.
    """
    found: list[tuple[float, Ruled]] = []
    for own in (start, reversed_(start)) if start.either and not start.closed else (start,):
        for other in (end, reversed_(end)):
            found += _laid(own, other, match)
    if not found:
        return []
    best = min(apart for apart, _ in found)
    return [ruled for apart, ruled in found if apart <= best * (1.0 + SAME_LENGTH_SHARE) + SAME_PLACE**2]


def matched(start: Curve, end: Curve, match: str) -> Ruled:
    """The surface between two guides that begin together and run the same way."""
    return _ruled(start, end, match)[1]


def reversed_(curve: Curve) -> Curve:
    """The curve run the other way; a closed one keeps its first point."""
    if not curve.closed:
        parameter = 1.0 - curve.parameter[::-1]
        return dataclasses.replace(
            curve, points=curve.points[::-1], parameter=parameter, anchor=curve.anchor[::-1]
        )
    order = np.append(0, np.arange(len(curve.points) - 1, 0, -1))
    parameter = np.where(order == 0, 0.0, 1.0 - curve.parameter[order])
    return dataclasses.replace(
        curve, points=curve.points[order], parameter=parameter, anchor=curve.anchor[order]
    )


def begun(curve: Curve, first: int) -> Curve:
    """A closed curve begun at its point ``first``."""
    parameter = np.roll(curve.parameter - curve.parameter[first], -first) % 1.0
    return dataclasses.replace(
        curve,
        points=np.roll(curve.points, -first, axis=0),
        parameter=parameter,
        anchor=np.roll(curve.anchor, -first),
    )


def _laid(start: Curve, end: Curve, match: str) -> list[tuple[float, Ruled]]:
    """Surfaces, with the mean square of the rulings' lengths, for a direction of both guides."""
    if int(start.anchor.sum()) != int(end.anchor.sum()):
        return []
    if not start.closed:
        return [_ruled(start, end, match)]
    own = np.flatnonzero(start.anchor)
    if len(own):
        start = begun(start, int(own[0]))
        return [_ruled(start, begun(end, int(i)), match) for i in np.flatnonzero(end.anchor)]
    if match == "parameter":
        return [_ruled(start, end, match)]
    marks = np.arange(START_PLACES) / START_PLACES
    a, b = _along(start, marks), _along(end, marks)
    apart = np.array(
        [np.mean(np.sum((a - np.roll(b, -k, axis=0)) ** 2, axis=1)) for k in range(START_PLACES)]
    )
    k = int(apart.argmin())
    length = _length(np.concatenate([end.points, end.points[:1]]))
    first = int(np.abs(length[:-1] / length[-1] - k / START_PLACES).argmin())
    return [_ruled(start, begun(end, first), match)]


def _ruled(start: Curve, end: Curve, match: str) -> tuple[float, Ruled]:
    rows: list[FloatArray] = []
    others: list[FloatArray] = []
    total, weight = 0.0, 0
    for (a, at_a), (b, at_b) in zip(_pieces(start), _pieces(end), strict=True):
        share_a, share_b = (at_a, at_b) if match == "parameter" else (_share(a), _share(b))
        both = np.union1d(share_a, share_b)
        both = both[np.append(True, np.diff(both) > SAME_PLACE)]
        both[-1] = 1.0
        even = np.linspace(0.0, 1.0, 33)
        apart = _at(a, _share(a), even) - _at(b, _share(b), even)
        total, weight = total + float(np.sum(apart**2)), weight + len(even)
        rows.append(_at(a, share_a, both)[slice(1 if rows else 0, None)])
        others.append(_at(b, share_b, both)[slice(1 if others else 0, None)])
    return total / max(weight, 1), Ruled(np.concatenate(rows), np.concatenate(others))


def _pieces(curve: Curve) -> list[tuple[FloatArray, FloatArray]]:
    """Points and parameters, from 0 to 1 each, from anchor to anchor."""
    points, parameter = curve.points, curve.parameter
    cut = np.flatnonzero(curve.anchor)
    if curve.closed:
        points, parameter = np.concatenate([points, points[:1]]), np.append(parameter, 1.0)
        cut = np.append(cut if len(cut) else [0], len(points) - 1)
    out = []
    for i, j in itertools.pairwise(cut.tolist()):
        own = parameter[i : j + 1]
        out.append((points[i : j + 1], (own - own[0]) / max(float(own[-1] - own[0]), 1e-300)))
    return out


def _length(points: FloatArray) -> FloatArray:
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _share(points: FloatArray) -> FloatArray:
    length = _length(points)
    return length / length[-1] if length[-1] > 0.0 else np.linspace(0.0, 1.0, len(points))


def _at(points: FloatArray, share: FloatArray, wanted: FloatArray) -> FloatArray:
    return np.stack([np.interp(wanted, share, column) for column in points.T], axis=1)


def _along(curve: Curve, share: FloatArray) -> FloatArray:
    ring = np.concatenate([curve.points, curve.points[:1]])
    return _at(ring, _share(ring), share)
