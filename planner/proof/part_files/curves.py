"""Curves of DXF drawings, Bezier curves and B-splines, and ruled surfaces between two guides.

ezdxf parses the text. Arcs, bulges, ellipses and splines are evaluated here. Sources: Autodesk, DXF
Reference (2018), entities and "Arbitrary Axis Algorithm"; Bezier curves by de Casteljau's algorithm,
clamped cubic B-splines by Cox and de Boor's, and lofts of them: G. Farin, Curves and Surfaces for CAGD
(2002), 4.2 and 8.2.

The problem states which points of two guides are joined by rulings. Corners, and the ends of open guides, are
joined with each other. Between them, points at equal fractions of the length, or of the parameter, are
joined. If two guides can be joined in several ways, the way with the shortest rulings counts, and all ways
that are equally short.
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
    """Return points (N, D) of a Bezier curve (de Casteljau).

    Args:
        control: Control points (C, D), or one set of them for each parameter (N, C, D).
        t: Parameters (N,).
    """
    points = np.broadcast_to(control, (len(t), *control.shape[-2:])).astype(np.float64)
    weight = t[:, None, None]
    while points.shape[1] > 1:
        points = points[:, :-1] + weight * (points[:, 1:] - points[:, :-1])
    return points[:, 0]


def bspline(control: FloatArray, t: FloatArray) -> FloatArray:
    """Return points (N, D) of a clamped uniform B-spline.

    Args:
        control: Control points (C, D), or one set of them for each parameter (N, C, D). The degree is 3, or C
        - 1 if that is less.
        t: Parameters (N,) in [0, 1].
    """
    count = control.shape[-2]
    degree = min(3, count - 1)
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    return nurbs(control, np.ones(count), knots, degree, t)


def nurbs(
    control: FloatArray, weight: FloatArray, knots: FloatArray, degree: int, t: FloatArray
) -> FloatArray:
    """Return points (N, D) of a rational B-spline (Cox and de Boor).

    Args:
        control: Control points (C, D), or one set of them for each parameter (N, C, D).
        weight: Weights (C,).
        knots: Knots (C + degree + 1,).
        degree: Degree.
        t: Parameters (N,).
    """
    count = control.shape[-2]
    span = np.clip(np.searchsorted(knots, t, side="right") - 1, degree, count - 1)
    control_sets = np.broadcast_to(control, (len(t), *control.shape[-2:]))
    rows = np.arange(len(t))[:, None]
    indices = span[:, None] - degree + np.arange(degree + 1)
    point = control_sets[rows, indices] * weight[indices][..., None]
    point = np.concatenate([point, weight[indices][..., None]], axis=2)
    for level in range(1, degree + 1):
        low = knots[indices[:, level:]]
        high = knots[indices[:, : degree + 1 - level] + degree + 1]
        blend = (t[:, None] - low) / np.where(high > low, high - low, 1.0)
        blend = np.where(high > low, blend, 0.0)[..., None]
        point = (1.0 - blend) * point[:, :-1] + blend * point[:, 1:]
    return np.asarray(point[:, 0, :-1] / point[:, 0, -1:])


def interpolate_control(at: FloatArray, control: FloatArray, u: FloatArray) -> FloatArray:
    """Interpolate the control points of a loft between its curves.

    The interpolant is the cubic spline through them with the not-a-knot condition: its first two pieces are
    one cubic, and so are its last two. A single curve is repeated.

    Args:
        at: Parameters (P,) of the curves.
        control: Control points (P, C, D) of the curves.
        u: Parameters (N,).

    Returns:
        Control points (N, C, D).
    """
    if len(at) == 1:
        return np.repeat(control, len(u), axis=0)
    return np.asarray(CubicSpline(at, control, axis=0, bc_type="not-a-knot")(u))


JOIN_DISTANCE_M: Final = 1e-5
"""Distance [m] up to which two ends of pieces of a curve are joined."""
CHORD_TOLERANCE_M: Final = 1e-6
"""Maximum deviation [m] of chords from arcs and splines."""
MIN_CHORDS: Final = 48
"""Minimum number of chords of a full circle, or of a span of a spline."""


@dataclasses.dataclass(frozen=True)
class DrawingCurve:
    """A curve of a drawing.

    Attributes:
        points: Points (N, 3) [m], the first not repeated in a closed curve.
        closed: Whether the curve is closed.
        pieces: Number of joined pieces. A drawing does not define the direction of several pieces.
    """

    points: FloatArray
    closed: bool
    pieces: int


def read_curves(path: Path, unit: float, layer: str | None) -> list[DrawingCurve]:
    """Read the visible curves in the model space of a DXF file.

    Args:
        path: Path of the file.
        unit: Metres per unit of the drawing.
        layer: Layer to read, None for all layers.

    Raises:
        UnreadError: The file cannot be read, or ezdxf is not installed.
    """
    try:
        from ezdxf.filemanagement import readfile
    except ImportError as error:
        raise UnreadError("DXF files need ezdxf: pip install 'tandem-planner[cad]'") from error
    pieces = []
    try:
        drawing = readfile(path)
        hidden_layers = {
            str(drawing_layer.dxf.name).lower()
            for drawing_layer in drawing.layers
            if drawing_layer.dxf.color < 0 or drawing_layer.dxf.flags & 1
        }  # off, or frozen
        for entity in drawing.modelspace():
            if entity.dxf.get("invisible", 0) or str(entity.dxf.layer).lower() in hidden_layers:
                continue
            if layer is None or str(entity.dxf.layer).lower() == layer.lower():
                points = _points(entity, unit)
                if points is not None and len(points) > 1:
                    pieces.append(points * unit)
    except Exception as error:  # damaged files raise any exception
        raise UnreadError(str(error).splitlines()[0][:120] if str(error) else type(error).__name__) from error
    return join_pieces(pieces)


def _points(entity: Any, unit: float) -> FloatArray | None:
    """Return points (N, 3) of an entity in the drawing's units, or None if it is not a curve.

    ``unit`` [m] is the drawing's unit, by which the number of chords of an arc is chosen.
    """
    kind, dxf = entity.dxftype(), entity.dxf
    if kind == "LINE":
        return np.array([tuple(dxf.start), tuple(dxf.end)], dtype=np.float64)
    if kind in ("ARC", "CIRCLE"):
        first, last = (dxf.start_angle, dxf.end_angle) if kind == "ARC" else (0.0, 360.0)
        sweep = (last - first) % 360.0 or 360.0
        angle = np.deg2rad(first + sweep * _arc_fractions(dxf.radius * unit, np.deg2rad(sweep)))
        centre = np.array(tuple(dxf.center), dtype=np.float64)
        flat = dxf.radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        return _to_world(centre + flat, dxf.extrusion)
    if kind == "ELLIPSE":
        major = np.array(tuple(dxf.major_axis), dtype=np.float64)
        up = np.array(tuple(dxf.extrusion), dtype=np.float64)
        minor = dxf.ratio * np.cross(up / np.linalg.norm(up), major)
        sweep = (dxf.end_param - dxf.start_param) % (2.0 * np.pi)
        sweep = sweep if sweep > 1e-12 else 2.0 * np.pi
        count = 4 * len(_arc_fractions(float(np.linalg.norm(major)) * unit, sweep))
        angle = (dxf.start_param + sweep * np.linspace(0.0, 1.0, count))[:, None]
        return np.asarray(np.array(tuple(dxf.center)) + np.cos(angle) * major + np.sin(angle) * minor)
    if kind == "SPLINE":
        return _spline(entity)
    if kind == "LWPOLYLINE":
        corners_with_bulge = np.array(
            [(x, y, bulge) for x, y, bulge in entity.get_points("xyb")], dtype=np.float64
        )
        height = float(dxf.get("elevation", 0.0))
        return _to_world(
            _polyline_with_bulges(corners_with_bulge, height, bool(entity.closed), unit), dxf.extrusion
        )
    if kind == "POLYLINE":
        corners = [vertex.dxf for vertex in entity.vertices]
        locations = np.array([tuple(vertex.location) for vertex in corners], dtype=np.float64).reshape(-1, 3)
        if entity.is_3d_polyline:
            return np.concatenate([locations, locations[:1]]) if entity.is_closed else locations
        if not entity.is_2d_polyline or not len(locations):
            return None
        bulge = np.array([float(vertex.get("bulge", 0.0)) for vertex in corners])
        height = float(tuple(dxf.get("elevation", (0.0, 0.0, 0.0)))[2])
        corners_with_bulge = np.column_stack([locations[:, :2], bulge])
        return _to_world(
            _polyline_with_bulges(corners_with_bulge, height, bool(entity.is_closed), unit), dxf.extrusion
        )
    return None


def _arc_fractions(radius: float, sweep: float) -> FloatArray:
    """Return fractions from 0 to 1 of an arc of ``radius`` [m] and ``sweep`` [rad].

    They are so close that the chords between them keep ``CHORD_TOLERANCE_M`` and ``MIN_CHORDS``.
    """
    # The sagitta of a chord over the angle s is radius * (1 - cos(s / 2)).
    step = 2.0 * np.arccos(max(0.0, 1.0 - CHORD_TOLERANCE_M / max(radius, CHORD_TOLERANCE_M)))
    count = max(int(np.ceil(sweep / step)), int(np.ceil(MIN_CHORDS * sweep / (2.0 * np.pi))), 2)
    return np.linspace(0.0, 1.0, count + 1)


def _to_world(points: FloatArray, extrusion: Any) -> FloatArray:
    """Transform points (N, 3) from an entity's frame, whose z axis is ``extrusion``, to that of the drawing.

    The x axis follows from z by DXF's "Arbitrary Axis Algorithm".
    """
    z = np.array(tuple(extrusion), dtype=np.float64)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0] if max(abs(z[0]), abs(z[1])) < 1.0 / 64.0 else [0.0, 0.0, 1.0], z)
    x = x / np.linalg.norm(x)
    return np.asarray(points @ np.array([x, np.cross(z, x), z]))


def _polyline_with_bulges(corners: FloatArray, height: float, closed: bool, unit: float) -> FloatArray:
    """Return points (N, 3) of a polyline whose segments are lines or arcs.

    ``corners`` (K, 3) are x, y and the bulge of the segment to the next corner: the tangent of a quarter of
    the angle of its arc. ``height`` is z of all points, ``unit`` the metres per unit of the drawing.
    """
    out = [corners[:1, :2]]
    next_corners = np.roll(corners, -1, axis=0)
    for start, end in zip(
        corners[: None if closed else -1], next_corners[: None if closed else -1], strict=True
    ):
        chord, bulge = end[:2] - start[:2], float(start[2])
        chord_length = float(np.hypot(*chord))
        if abs(bulge) < 1e-12 or chord_length == 0.0:
            out.append(end[None, :2])
            continue
        # A positive bulge puts the arc on the right of its chord. Bulge = tan(angle / 4).
        sweep = 4.0 * np.arctan(bulge)
        radius = 0.5 * chord_length / abs(np.sin(0.5 * sweep))
        left = np.array([-chord[1], chord[0]])
        centre = start[:2] + 0.5 * chord + 0.25 * left * (1.0 - bulge**2) / bulge
        angle = sweep * _arc_fractions(radius * unit, abs(sweep))[1:, None]
        arm = start[:2] - centre
        out.append(centre + np.cos(angle) * arm + np.sin(angle) * np.array([-arm[1], arm[0]]))
    flat = np.concatenate(out)
    return np.column_stack([flat, np.full(len(flat), height)])


def _spline(entity: Any) -> FloatArray | None:
    """Return points (N, 3) of a spline in the drawing's units, close together in each span of its knots."""
    control = np.array([tuple(point) for point in entity.control_points], dtype=np.float64).reshape(-1, 3)
    if not len(control):
        # DXF does not define a spline that has only fit points, so ezdxf's interpretation is used.
        tool = entity.construction_tool()
        return np.array([tuple(point) for point in tool.approximate(400)], dtype=np.float64)
    degree = int(entity.dxf.degree)
    knots = np.array(list(entity.knots), dtype=np.float64)
    weight = np.array(list(entity.weights), dtype=np.float64)
    weight = weight if len(weight) == len(control) else np.ones(len(control))
    spans = np.unique(knots[degree : len(control) + 1])
    inner = np.linspace(0.0, 1.0, 4 * MIN_CHORDS, endpoint=False)
    t = np.append((spans[:-1, None] + np.diff(spans)[:, None] * inner).ravel(), spans[-1])
    return nurbs(control, weight, knots, degree, t)


def join_pieces(pieces: list[FloatArray]) -> list[DrawingCurve]:
    """Join pieces (N, 3) [m] of a drawing into curves at ends that are common to two of them.

    The nearest piece is joined first. Closed pieces stay as they are. Each curve runs in the direction of its
    first piece. A closed curve also starts with its first piece.
    """
    out: list[DrawingCurve] = []
    remaining = list(range(len(pieces)))
    all_ends = np.array([piece[[0, -1]] for piece in pieces]).reshape(-1, 2, 3)
    all_open = np.array([not _is_closed(piece) for piece in pieces], dtype=bool)
    while remaining:
        # prepended: number of points before the first piece.
        chain, count, prepended = pieces[remaining.pop(0)], 1, 0
        while remaining and not _is_closed(chain):
            ends, is_open = all_ends[remaining], all_open[remaining]
            # gap (P, 2, 2) [m]: from the two ends of each remaining piece to the two ends of the chain.
            gap = np.linalg.norm(ends[:, :, None] - chain[[0, -1]][None, None], axis=3)
            gap[~is_open] = np.inf
            which, end, chain_end = np.unravel_index(int(np.argmin(gap)), gap.shape)
            if gap[which, end, chain_end] > JOIN_DISTANCE_M:
                break
            piece = pieces[remaining.pop(int(which))]
            piece = piece if end == 0 else piece[::-1]  # leads away from the chain
            chain = np.concatenate([chain, piece[1:]] if chain_end else [piece[:0:-1], chain])
            prepended += 0 if chain_end else len(piece) - 1
            count += 1
        is_closed = _is_closed(chain)
        out.append(
            DrawingCurve(np.roll(chain[:-1], -prepended, axis=0) if is_closed else chain, is_closed, count)
        )
    return out


def _is_closed(points: FloatArray) -> bool:
    """Return whether a polyline of more than three points ends where it starts."""
    return len(points) > 3 and bool(np.linalg.norm(points[0] - points[-1]) <= JOIN_DISTANCE_M)


EQUAL_LENGTH_TOLERANCE: Final = 1e-3
"""Relative tolerance of the mean square length of the rulings, within which two ways to join guides are
equally short.
"""
POINT_TOLERANCE_M: Final = 1e-9
"""Distance [m] up to which points of a polyline are equal."""
START_POINTS: Final = 720
"""Number of start points that are tried on a smooth closed guide."""


@dataclasses.dataclass(frozen=True)
class GuideCurve:
    """A guide of a ruled surface: a curve along which one end of the rulings runs.

    Attributes:
        points: Points (N, 3) [m], the first not repeated in a closed guide.
        parameter: Ascending parameters (N,) in [0, 1).
        anchor: Flags (N,) of the points that are joined with anchors of the other guide: corners, ends of an
            open guide, and points that are chosen otherwise.
        closed: Whether the guide is closed.
        either: Whether the direction of the guide is undefined, so that both directions are tried.
    """

    points: FloatArray
    parameter: FloatArray
    anchor: BoolArray
    closed: bool
    either: bool = False


@dataclasses.dataclass(frozen=True)
class GuideRulings:
    """A ruled surface. Its normal away from the part is (direction along ``start``) x (ruling).

    Attributes:
        start: Starts (M, 3) of the rulings, the first again at the end of a closed surface.
        end: Ends (M, 3) of the rulings.
    """

    start: FloatArray
    end: FloatArray


def polyline_guide(points: FloatArray, closed: bool, angle: float, either: bool = False) -> GuideCurve:
    """Return a polyline (N, 3) as a guide, with anchors at corners of more than ``angle`` [rad].

    Points that repeat the one before are removed. ``either``: the direction of the guide is undefined.
    """
    distinct = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > POINT_TOLERANCE_M)
    distinct_points = points[distinct]
    if (
        closed
        and len(distinct_points) > 1
        and np.linalg.norm(distinct_points[0] - distinct_points[-1]) <= POINT_TOLERANCE_M
    ):
        distinct_points = distinct_points[:-1]
    count = len(distinct_points)
    directions = np.roll(distinct_points, -1, axis=0) - distinct_points
    directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    cosine = np.einsum("ij,ij->i", directions, np.roll(directions, 1, axis=0))
    corner = np.arccos(np.clip(cosine, -1.0, 1.0)) > angle
    if not closed:
        corner[[0, -1]] = True
    return GuideCurve(
        distinct_points, np.arange(count) / (count if closed else max(count - 1, 1)), corner, closed, either
    )


def with_corners_at(curve: GuideCurve, at: FloatArray) -> GuideCurve:
    """Return the curve with anchors only at its points nearest to ``at`` (C, 3) [m], and at open ends."""
    anchor = np.zeros(len(curve.points), dtype=np.bool_)
    if len(at):
        anchor[np.linalg.norm(curve.points[:, None] - at[None], axis=2).argmin(axis=0)] = True
    if not curve.closed:
        anchor[[0, -1]] = True
    return dataclasses.replace(curve, anchor=anchor)


def join_guides(start: GuideCurve, end: GuideCurve, match: str) -> list[GuideRulings]:
    """Return the ruled surfaces between two guides that have the shortest rulings.

    There are several if several ways to join the guides are equally short, and none if the guides have
    different numbers of anchors. ``match`` is ``parameter`` to join points at equal parameters between
    anchors, else points at equal lengths are joined.
    """
    candidates: list[tuple[float, GuideRulings]] = []
    for start_guide in (start, reverse_curve(start)) if start.either and not start.closed else (start,):
        for end_guide in (end, reverse_curve(end)):
            candidates += _rulings_in_direction(start_guide, end_guide, match)
    if not candidates:
        return []
    best = min(mean_square for mean_square, _ in candidates)
    return [
        ruled
        for mean_square, ruled in candidates
        if mean_square <= best * (1.0 + EQUAL_LENGTH_TOLERANCE) + POINT_TOLERANCE_M**2
    ]


def match_guides(start: GuideCurve, end: GuideCurve, match: str) -> GuideRulings:
    """Return the ruled surface between two guides that start together and run in one direction.

    ``match`` is that of :func:`join_guides`. Both guides must have equal numbers of anchors.
    """
    return _rule(start, end, match)[1]


def reverse_curve(curve: GuideCurve) -> GuideCurve:
    """Return the curve in the other direction. A closed one keeps its first point."""
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


def start_at(curve: GuideCurve, first: int) -> GuideCurve:
    """Return a closed curve that starts at its point ``first``."""
    parameter = np.roll(curve.parameter - curve.parameter[first], -first) % 1.0
    return dataclasses.replace(
        curve,
        points=np.roll(curve.points, -first, axis=0),
        parameter=parameter,
        anchor=np.roll(curve.anchor, -first),
    )


def _rulings_in_direction(start: GuideCurve, end: GuideCurve, match: str) -> list[tuple[float, GuideRulings]]:
    """Return the ruled surfaces for given directions of both guides, each with its mean square ruling length.

    The first anchor of a closed guide is joined with each anchor of the other one in turn, so there are as
    many surfaces as anchors. Without anchors there is one surface: for ``match`` "parameter" from the start
    points on, else with the start point of the second guide that gives the shortest rulings. There is none if
    the guides have different numbers of anchors.
    """
    if int(start.anchor.sum()) != int(end.anchor.sum()):
        return []
    if not start.closed:
        return [_rule(start, end, match)]
    anchors = np.flatnonzero(start.anchor)
    if len(anchors):
        start = start_at(start, int(anchors[0]))
        return [_rule(start, start_at(end, int(i)), match) for i in np.flatnonzero(end.anchor)]
    if match == "parameter":
        return [_rule(start, end, match)]
    marks = np.arange(START_POINTS) / START_POINTS
    a, b = _points_along(start, marks), _points_along(end, marks)
    mean_squares = np.array(
        [np.mean(np.sum((a - np.roll(b, -k, axis=0)) ** 2, axis=1)) for k in range(START_POINTS)]
    )
    k = int(mean_squares.argmin())  # the start is at the fraction k / START_POINTS of the second guide
    length = _arc_lengths(np.concatenate([end.points, end.points[:1]]))
    first = int(np.abs(length[:-1] / length[-1] - k / START_POINTS).argmin())
    return [_rule(start, start_at(end, first), match)]


def _rule(start: GuideCurve, end: GuideCurve, match: str) -> tuple[float, GuideRulings]:
    """Return the rulings between two guides, whose pieces from anchor to anchor are joined in order.

    There is a ruling at each point of either guide. ``match`` is that of :func:`join_guides`.

    Returns:
        Mean square length [m^2] of rulings, always between points at equal fractions of each piece's length,
        and the ruled surface.
    """
    starts: list[FloatArray] = []
    ends: list[FloatArray] = []
    total, count = 0.0, 0
    for (a, at_a), (b, at_b) in zip(_pieces(start), _pieces(end), strict=True):
        fractions_a, fractions_b = (
            (at_a, at_b) if match == "parameter" else (_length_fractions(a), _length_fractions(b))
        )
        fractions = np.union1d(fractions_a, fractions_b)
        fractions = fractions[np.append(True, np.diff(fractions) > POINT_TOLERANCE_M)]
        fractions[-1] = 1.0
        checkpoints = np.linspace(0.0, 1.0, 33)  # fractions at which the mean square is taken
        difference = _interpolate(a, _length_fractions(a), checkpoints) - _interpolate(
            b, _length_fractions(b), checkpoints
        )
        total, count = total + float(np.sum(difference**2)), count + len(checkpoints)
        # The first ruling of a piece is the last one of the piece before.
        starts.append(_interpolate(a, fractions_a, fractions)[slice(1 if starts else 0, None)])
        ends.append(_interpolate(b, fractions_b, fractions)[slice(1 if ends else 0, None)])
    return total / max(count, 1), GuideRulings(np.concatenate(starts), np.concatenate(ends))


def _pieces(curve: GuideCurve) -> list[tuple[FloatArray, FloatArray]]:
    """Return the pieces of a guide between its anchors: points (N, 3), and parameters (N,) from 0 to 1.

    A closed guide starts at its first point. It is one piece if it has no anchors.
    """
    points, parameter = curve.points, curve.parameter
    cut = np.flatnonzero(curve.anchor)
    if curve.closed:
        points, parameter = np.concatenate([points, points[:1]]), np.append(parameter, 1.0)
        cut = np.append(cut if len(cut) else [0], len(points) - 1)
    out = []
    for i, j in itertools.pairwise(cut.tolist()):
        piece_parameters = parameter[i : j + 1]
        out.append(
            (
                points[i : j + 1],
                (piece_parameters - piece_parameters[0])
                / max(float(piece_parameters[-1] - piece_parameters[0]), 1e-300),
            )
        )
    return out


def _arc_lengths(points: FloatArray) -> FloatArray:
    """Return the length (N,) of a polyline up to each of its points (N, 3)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _length_fractions(points: FloatArray) -> FloatArray:
    """Return the fraction (N,) of the length of a polyline up to each of its points (N, 3)."""
    length = _arc_lengths(points)
    return length / length[-1] if length[-1] > 0.0 else np.linspace(0.0, 1.0, len(points))


def _interpolate(points: FloatArray, fractions: FloatArray, queries: FloatArray) -> FloatArray:
    """Interpolate points (N, D), which are given at ascending fractions (N,), at queries (K,)."""
    return np.stack([np.interp(queries, fractions, column) for column in points.T], axis=1)


def _points_along(curve: GuideCurve, fractions: FloatArray) -> FloatArray:
    """Return points (N, 3) at fractions (N,) of the length of a closed guide."""
    ring = np.concatenate([curve.points, curve.points[:1]])
    return _interpolate(ring, _length_fractions(ring), fractions)
