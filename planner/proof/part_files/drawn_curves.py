"""Curves of drawings, read again from their files."""

from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline

from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.arrays import FloatArray
from planner.proof.part_files import UNITS, UnreadError, curves, rhino

MILLIMETRE = 1e-3
"""One millimetre in metres."""
SPLINE_PLACES = 4000
"""Places on a spline."""
CORNERED_KINDS = ("polyline", "dxf", "rhino")
"""Kinds of curves whose corners are meant."""
SAME_POINT = 1e-9
"""Points of a curve nearer to each other than this [m] are one."""


class NotThereError(ValueError):
    """A curve that cannot be laid on the face."""


def points(drawn: DrawnCurve) -> tuple[FloatArray, bool]:
    """Points (N, 3) [m] of a curve, of a polyline its own, of a spline many; and whether it may as well be
    run the other way, as a drawing does not say it of what is drawn in pieces. Raises ``NotThereError``."""
    if drawn.file is not None:
        return _of_file(drawn, drawn.file)
    given = np.array(drawn.points_mm, dtype=np.float64) * MILLIMETRE
    if drawn.kind == "polyline":
        apart = np.linalg.norm(np.diff(given, axis=0), axis=1) > SAME_POINT
        return given[np.append(True, apart)], False
    count = len(given)
    degree = count - 1 if drawn.kind == "bezier" else min(3, count - 1)
    inner = np.arange(1, count - degree) / (count - degree)
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    return np.asarray(BSpline(knots, given, degree)(np.linspace(0.0, 1.0, SPLINE_PLACES + 1))), False


def _of_file(drawn: DrawnCurve, file: Path) -> tuple[FloatArray, bool]:
    """The only curve of a drawing; one that is closed ends where it began."""
    try:
        found = curves_of(drawn)
    except UnreadError as error:
        raise NotThereError(f"{file}: {error}") from error
    if len(found) != 1:
        raise NotThereError(f"{file} holds {len(found)} curves, wanted is one")
    out = _run(found[0])
    if drawn.z_mm is not None:
        out[:, 2] = drawn.z_mm * MILLIMETRE
    return out, found[0].pieces > 1


def _run(found: curves.Drawn) -> FloatArray:
    points = found.points
    return np.concatenate([points, points[:1]]) if found.closed else points.copy()


def curves_of(drawn: DrawnCurve) -> list[curves.Drawn]:
    """The curves of a file that one of its words stands for, layer by layer. Raises `UnreadError`."""
    if drawn.file is None:
        raise UnreadError("no file is named")
    out: list[curves.Drawn] = []
    for layer in drawn.layers or (drawn.layer,):
        if drawn.kind == "rhino":
            chosen = {"layer": layer, "name": drawn.name, "colour": drawn.colour}
            out += rhino.read_curves({"file": drawn.file, "unit": drawn.unit or None, **chosen})
        else:
            out += curves.read_curves(drawn.file, UNITS[drawn.unit], layer)
    return out


def each_curve(drawn: tuple[DrawnCurve, ...]) -> tuple[DrawnCurve, ...]:
    """Curves, those of drawings as polylines one by one. Raises ``NotThereError``."""
    out: list[DrawnCurve] = []
    for one in drawn:
        if not one.layers:
            out.append(one)
            continue
        try:
            found = curves_of(one)
        except UnreadError as error:
            raise NotThereError(f"{one.file}: {error}") from error
        rows = [(_run(curve) / MILLIMETRE).tolist() for curve in found]
        out += [DrawnCurve("polyline", tuple(map(tuple, points))) for points in rows]
    return tuple(out)
