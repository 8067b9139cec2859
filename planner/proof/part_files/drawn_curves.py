"""Curves of drawings, as the proof reads them from their files."""

from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline

from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.arrays import FloatArray
from planner.proof.part_files import UNITS, UnreadError, curves, rhino

MILLIMETRE_M = 1e-3
"""One millimetre in metres."""
SPLINE_POINTS = 4000
"""Number of points on a spline."""
CORNERED_KINDS = ("polyline", "dxf", "rhino")
"""Kinds of curves whose corners are intended."""
POINT_TOLERANCE_M = 1e-9
"""Distance [m] up to which points of a curve are equal."""


class CurveReadError(ValueError):
    """A curve that cannot be read from its file, or a file without exactly one curve."""


def curve_points(drawn: DrawnCurve) -> tuple[FloatArray, bool]:
    """Return the points of a curve: the only one of its file, or the stated polyline, or points of a spline.

    Returns:
        Points (N, 3) [m], and whether the curve may run in the other direction as well. This is so for a
        curve of several pieces of a drawing, whose direction the drawing does not define.

    Raises:
        CurveReadError: The file does not have exactly one curve, or cannot be read.
    """
    if drawn.file is not None:
        return _only_curve(drawn, drawn.file)
    stated_points = np.array(drawn.points_mm, dtype=np.float64) * MILLIMETRE_M
    if drawn.kind == "polyline":
        is_distinct = np.linalg.norm(np.diff(stated_points, axis=0), axis=1) > POINT_TOLERANCE_M
        return stated_points[np.append(True, is_distinct)], False
    count = len(stated_points)
    degree = count - 1 if drawn.kind == "bezier" else min(3, count - 1)
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    return np.asarray(BSpline(knots, stated_points, degree)(np.linspace(0.0, 1.0, SPLINE_POINTS + 1))), False


def _only_curve(drawn: DrawnCurve, file: Path) -> tuple[FloatArray, bool]:
    """Return the only curve of a drawing as :func:`curve_points` does.

    The first point of a closed curve is repeated at its end. ``z_mm``, if stated, replaces the heights.
    """
    try:
        file_curves = curves_of(drawn)
    except UnreadError as error:
        raise CurveReadError(f"{file}: {error}") from error
    if len(file_curves) != 1:
        raise CurveReadError(f"{file} has {len(file_curves)} curves; expected: 1")
    out = _closed_points(file_curves[0])
    if drawn.z_mm is not None:
        out[:, 2] = drawn.z_mm * MILLIMETRE_M
    return out, file_curves[0].pieces > 1


def _closed_points(curve: curves.DrawingCurve) -> FloatArray:
    """Return a copy of the points (N, 3) [m] of a curve, with the first one repeated if it is closed."""
    points = curve.points
    return np.concatenate([points, points[:1]]) if curve.closed else points.copy()


def curves_of(drawn: DrawnCurve) -> list[curves.DrawingCurve]:
    """Return the curves of a file that an entry selects, layer by layer.

    Raises:
        UnreadError: The file cannot be read.
    """
    if drawn.file is None:
        raise UnreadError("no file is named")
    out: list[curves.DrawingCurve] = []
    for layer in drawn.layers or (drawn.layer,):
        if drawn.kind == "rhino":
            chosen = {"layer": layer, "name": drawn.name, "colour": drawn.colour}
            out += rhino.read_curves({"file": drawn.file, "unit": drawn.unit or None, **chosen})
        else:
            out += curves.read_curves(drawn.file, UNITS[drawn.unit], layer)
    return out


def explode_drawings(drawn: tuple[DrawnCurve, ...]) -> tuple[DrawnCurve, ...]:
    """Return curves, with each entry that names layers replaced by the curves of its file as polylines.

    Raises:
        CurveReadError: A file cannot be read.
    """
    out: list[DrawnCurve] = []
    for entry in drawn:
        if not entry.layers:
            out.append(entry)
            continue
        try:
            file_curves = curves_of(entry)
        except UnreadError as error:
            raise CurveReadError(f"{entry.file}: {error}") from error
        polylines_mm = [(_closed_points(curve) / MILLIMETRE_M).tolist() for curve in file_curves]
        out += [DrawnCurve("polyline", tuple(map(tuple, points))) for points in polylines_mm]
    return tuple(out)
