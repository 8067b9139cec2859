"""Airfoil coordinates from files in Selig's and Lednicer's format, checked and put in order.

Selig: a name, then x y from the trailing edge over the upper side to the leading edge and back below.
Lednicer: a name, the numbers of points of both sides, then the upper side and the lower side, each from the
leading to the trailing edge. Both as in the UIUC airfoil coordinates database.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import LineString

from planner.files import is_file
from planner.geometry.airfoil import leading_point
from planner.issues import Issue, Severity, TandemError

FloatArray = NDArray[np.float64]

FEWEST: Final = 15
"""Fewest points of a section; with less a spline through them says little of the nose."""
MOST: Final = 5000
WIDEST: Final = 0.10
"""Widest trailing edge, per chord; a larger gap means that points are missing."""
_MOST_BYTES: Final = 2_000_000
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_PAIR: Final = re.compile(rf"^\s*\(?\s*({_NUMBER})[\s,;]+({_NUMBER})\s*\)?\s*$")


def read_airfoil(path: Path, field: str) -> tuple[FloatArray, list[Issue]]:
    """Points (N, 2) per chord, from the trailing edge over the upper side and back, and notes of what was put
    right: its order, a chord that is not 1 long, points that were given twice.

    ``field`` is the field of the problem file that names the file. Raises ``TandemError`` with
    ``problem.missing_file``, ``problem.too_large``, ``part.airfoil_format``, ``part.airfoil_order``,
    ``part.airfoil_open``, ``part.airfoil_points`` or ``part.airfoil_crossing``.
    """
    if not is_file(path):
        raise _refuse("problem.missing_file", path, field, "there is no such file; check the path")
    if path.stat().st_size > _MOST_BYTES:
        raise _refuse("problem.too_large", path, field, "more than 2 MB; an airfoil has some hundred points")
    notes: list[Issue] = []
    rows = _numbers(path, field)
    points = _sides(rows, path, field)
    repeated = np.concatenate([[False], np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-9])
    if repeated.any():
        points = points[~repeated]
        notes.append(_note(path, field, f"left out {int(repeated.sum())} points that repeat the one before"))
    if not FEWEST <= len(points) <= MOST:
        what = f"has {len(points)} points, {FEWEST} to {MOST} are wanted; take another file of the same "
        what += "section"
        raise _refuse("part.airfoil_points", path, field, what)
    points = _ordered(points, path, field, notes)
    _whole(points, path, field)
    return _unit_chord(points, path, field, notes), notes


def _numbers(path: Path, field: str) -> FloatArray:
    lines = path.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()
    found: list[tuple[float, float]] = []
    remark: tuple[int, str] | None = None
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        pair = _PAIR.match(line)
        if pair is None:
            if found and remark is None:
                remark = number, line.strip()[:40]
            continue  # a name above the points or remarks below them, however many lines long
        if remark is not None:
            what = f"line {remark[0]} has no x and y ({remark[1]!r}); remove or correct it"
            raise _refuse("part.airfoil_format", path, field, what)
        found.append((_float(pair.group(1)), _float(pair.group(2))))
    if not found:
        what = "has no points; wanted are a name and lines of x y in Selig's or Lednicer's format"
        raise _refuse("part.airfoil_format", path, field, what)
    rows = np.array(found)
    if not np.isfinite(rows).all():
        raise _refuse("part.airfoil_format", path, field, "has numbers too large to read; repair the file")
    return rows


def _float(text: str) -> float:
    return float(text.replace("d", "e").replace("D", "e"))


def _sides(rows: FloatArray, path: Path, field: str) -> FloatArray:
    """The points in one row; Lednicer's two sides are joined at the leading edge."""
    counts = np.round(rows[0])
    if not (np.abs(rows[0] - counts) < 1e-6).all() or (counts < 3).any():
        return rows
    upper, lower = int(counts[0]), int(counts[1])
    if len(rows) - 1 != upper + lower:
        what = f"says {upper} + {lower} points (Lednicer's format) and has {len(rows) - 1}; correct it"
        raise _refuse("part.airfoil_format", path, field, what)
    top, bottom = rows[1 : 1 + upper], rows[1 + upper :]
    for side, name in ((top, "upper"), (bottom, "lower")):
        if side[0, 0] > side[-1, 0]:
            what = f"its {name} side runs from the trailing edge; Lednicer's format wants both from the nose"
            raise _refuse("part.airfoil_order", path, field, what)
    if np.linalg.norm(top[0] - bottom[0]) < 1e-9:
        bottom = bottom[1:]
    return np.concatenate([top[::-1], bottom])


def _ordered(points: FloatArray, path: Path, field: str, notes: list[Issue]) -> FloatArray:
    """The points from the trailing edge over the top and back below."""
    chord = float(np.ptp(points[:, 0]))
    if chord <= 0.0:
        raise _refuse("part.airfoil_format", path, field, "all x are equal; an airfoil has x along its chord")
    step = np.diff(points[:, 0])
    step = step[np.abs(step) > 1e-3 * chord]
    back_and_forth = int((np.diff(np.sign(step)) != 0).sum())
    if back_and_forth > 2:
        what = (
            f"x turns back {back_and_forth} times along its points; the order must be from the trailing edge "
            "over the top and back below (Selig), so sort the points"
        )
        raise _refuse("part.airfoil_order", path, field, what)
    front = points[:, 0].min() + 0.5 * chord
    if points[0, 0] < front and points[-1, 0] < front:
        rear = int(np.argmax(points[:, 0]))
        turned = np.concatenate([points[rear:], points[:rear]])
        if np.linalg.norm(turned[len(points) - rear] - turned[len(points) - rear - 1]) < 1e-9 * chord:
            turned = np.delete(turned, len(points) - rear, axis=0)
        points = turned
        notes.append(_note(path, field, "began at the leading edge; its points were put in Selig's order"))
    nose = leading_point(points)
    if nose in (0, len(points) - 1) or points[0, 0] < front or points[-1, 0] < front:
        what = "runs along one side only; give both, from the trailing edge over the top and back below"
        raise _refuse("part.airfoil_open", path, field, what)
    if _area(points) < 0.0:
        points = points[::-1]
        notes.append(_note(path, field, "ran along the lower side first; its points were turned round"))
    return points


def _whole(points: FloatArray, path: Path, field: str) -> None:
    chord = float(np.ptp(points[:, 0]))
    gap = points[0] - points[-1]
    if abs(gap[0]) > 0.02 * chord or np.linalg.norm(gap) > WIDEST * chord:
        what = (
            f"has no trailing edge: its sides end at x = {points[0, 0]:g} and {points[-1, 0]:g}, "
            f"{np.linalg.norm(gap) / chord:.1%} of the chord apart, up to {WIDEST:.0%} of it upright is "
            "taken as a blunt one; add the missing points"
        )
        raise _refuse("part.airfoil_open", path, field, what)
    line = LineString(points)
    if not line.is_simple:
        where = _crossing(points)
        what = f"crosses itself near x = {where[0]:.4g}, y = {where[1]:.4g}; correct the points there"
        raise _refuse("part.airfoil_crossing", path, field, what)


def _crossing(points: FloatArray) -> FloatArray:
    """A point (2,) in which a polyline meets itself."""
    a, b = points[:-1], points[1:]
    for i in range(len(a) - 2):
        other = LineString(points[i + 2 :])
        meet = LineString([a[i], b[i]]).intersection(other)
        if not meet.is_empty:
            return np.array(meet.representative_point().coords[0])
    return np.asarray(points[0])


def _unit_chord(points: FloatArray, path: Path, field: str, notes: list[Issue]) -> FloatArray:
    """The section with its foremost point at x = 0 and its trailing edge at x = 1, not turned."""
    nose, tail = float(points[:, 0].min()), 0.5 * float(points[0, 0] + points[-1, 0])
    chord = tail - nose
    if abs(chord - 1.0) <= 2e-3 and abs(nose) <= 2e-3:
        return points
    notes.append(
        _note(path, field, f"has a chord from x = {nose:.4g} to {tail:.4g}; it was brought to 0 to 1")
    )
    return np.asarray((points - np.array([nose, 0.0])) / chord)


def _area(points: FloatArray) -> float:
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _note(path: Path, field: str, what: str) -> Issue:
    return Issue("part.airfoil_note", f"{path.name} {what}", Severity.NOTE, file=str(path), field=field)


def _refuse(code: str, path: Path, field: str, what: str) -> TandemError:
    return TandemError(Issue(code, f"{path.name}: {what}", file=str(path), field=field))
