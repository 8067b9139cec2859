"""Airfoil sections and the wing panel between two of them: NACA formulas and coordinate files.

A section is a row of points (N, 2) per chord, with x from the leading to the trailing edge. It goes from the
trailing edge over the upper side to the leading edge and back along the lower side. A blunt trailing edge is
open between its last and its first point.

NACA families of 4 and 5 digits: E. N. Jacobs, K. E. Ward and R. M. Pinkerton, NACA Report 460 (1933), four
digits; E. N. Jacobs and R. M. Pinkerton, NACA Report 537 (1935), five digits with simple and reflexed camber
lines; I. H. Abbott and A. E. von Doenhoff, Theory of Wing Sections (Dover, 1959), 6.4 to 6.6; constants of
the camber lines as in C. L. Ladson and C. W. Brooks, NASA TM X-3284 (1975).

Files, as in the UIUC airfoil coordinates database, are checked and sorted. Selig: a name, then x y from the
trailing edge over the upper side to the leading edge and back below. Lednicer: a name, the numbers of points
of both sides, then the upper side and the lower side, each from the leading to the trailing edge.

A panel's frame: x from the leading to the trailing edge, y from root to tip, z up. The root's leading edge is
at the origin. Sections are in planes of constant y and are joined by rulings. The tip is rotated about its
quarter-chord point.
"""

import dataclasses
import re
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from shapely.geometry import LineString

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray, RuledSurface
from planner.geometry.curves import RuledGuide, reverse_guide
from planner.geometry.matching import Match, join_guides
from planner.geometry.rulings import resample
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error

THICKNESS_COEFFICIENTS: Final = (0.2969, -0.1260, -0.3516, 0.2843, -0.1015)
"""Coefficients of x^0.5, x, x^2, x^3, x^4 of the half thickness of a section 20 % thick."""
SIMPLE_CAMBER: Final = {
    "210": (0.0580, 361.400),
    "220": (0.1260, 51.640),
    "230": (0.2025, 15.957),
    "240": (0.2900, 6.643),
    "250": (0.3910, 3.230),
}
"""Simple camber lines of five digits for a design lift coefficient of 0.3: (m, k1)."""
REFLEXED_CAMBER: Final = {
    "221": (0.1300, 51.990, 0.000764),
    "231": (0.2170, 15.793, 0.00677),
    "241": (0.3180, 6.520, 0.0303),
    "251": (0.4410, 3.191, 0.1355),
}
"""Reflexed camber lines of five digits for a design lift coefficient of 0.3: (m, k1, k2 / k1)."""
MAX_SHARP_EDGE_THICKNESS_M: Final = 1e-6
"""Maximum thickness of a sharp trailing edge [m]."""


def naca_section(digits: str, count: int = 160) -> FloatArray:
    """Return points (2 count + 1, 2) of a NACA section of 4 or 5 digits, dense at both edges.

    Thickness is normal to the camber line. The trailing edge is as blunt as the formula makes it (0.0021 of
    the chord at a thickness of 0.10).

    Args:
        digits: The section's digits.
        count: Number of intervals on each side.

    Raises:
        TandemError: The digits define no section (``part.naca``).
    """
    if not digits.isdigit() or len(digits) not in (4, 5):
        raise _refuse_digits(digits, "sections of 4 or 5 digits are known, as 2412 or 23112")
    thickness = int(digits[-2:]) / 100.0
    if not 0.01 <= thickness <= 0.40:
        raise _refuse_digits(digits, f"a thickness of {thickness:.0%} of the chord; 1 to 40 % are allowed")
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count + 1)))
    height, slope = _camber_4(digits, x) if len(digits) == 4 else _camber_5(digits, x)
    powers = np.stack([np.sqrt(x), x, x**2, x**3, x**4])
    half_thickness = 5.0 * thickness * (np.array(THICKNESS_COEFFICIENTS) @ powers)
    angle = np.arctan(slope)
    offset = half_thickness[:, None] * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    camber_line = np.stack([x, height], axis=1)
    return np.concatenate([(camber_line + offset)[::-1], (camber_line - offset)[1:]])


def _camber_4(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return height and slope (N,) of the camber line of four digits at x (N,), per chord.

    Raises ``part.naca`` if there is no such line.
    """
    m, p = int(digits[0]) / 100.0, int(digits[1]) / 10.0
    if m == 0.0:
        return np.zeros_like(x), np.zeros_like(x)
    if p == 0.0:
        raise _refuse_digits(
            digits, "camber without a position; set the second digit, the position in tenths of the chord"
        )
    scale = np.where(x < p, p * p, (1.0 - p) ** 2)
    height = m / scale * np.where(x < p, 2 * p * x - x * x, 1 - 2 * p + 2 * p * x - x * x)
    return height, 2.0 * m / scale * (p - x)


def _camber_5(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return height and slope (N,) of the camber line of five digits at x (N,), per chord.

    Raises ``part.naca`` if there is no such line.
    """
    name = f"2{digits[1:3]}"
    lift = 0.15 * int(digits[0]) / 0.3  # of the tabulated camber lines, which are for 0.3
    if int(digits[0]) == 0 or name not in SIMPLE_CAMBER | REFLEXED_CAMBER:
        known_names = ", ".join(sorted(SIMPLE_CAMBER | REFLEXED_CAMBER))
        raise _refuse_digits(
            digits, f"no such camber line; of five digits {known_names} are known (first digit 1 to 9)"
        )
    if name in SIMPLE_CAMBER:
        m, k = SIMPLE_CAMBER[name]
        front = x**3 - 3 * m * x**2 + m * m * (3 - m) * x
        height = np.where(x < m, front, m**3 * (1 - x))
        slope = np.where(x < m, 3 * x**2 - 6 * m * x + m * m * (3 - m), -(m**3))
    else:
        m, k, ratio = REFLEXED_CAMBER[name]
        linear_coefficient = ratio * (1 - m) ** 3 + m**3
        factor = np.where(x < m, 1.0, ratio)
        height = factor * (x - m) ** 3 - linear_coefficient * x + m**3
        slope = 3 * factor * (x - m) ** 2 - linear_coefficient
    return lift * k / 6.0 * height, lift * k / 6.0 * slope


def thickened(points: FloatArray, min_thickness: float) -> FloatArray:
    """Return the section with a trailing edge at least ``min_thickness`` chords thick.

    Its sides are moved apart in proportion to x, so that the leading edge is unchanged.
    """
    gap = float(np.linalg.norm(points[0] - points[-1]))
    if gap >= min_thickness:
        return points
    is_upper = np.arange(len(points)) <= leading_point(points)
    fraction = np.clip(points[:, 0], 0.0, 1.0)
    offset = 0.5 * (min_thickness - gap) * fraction * np.where(is_upper, 1.0, -1.0)
    return points + np.stack([np.zeros(len(points)), offset], axis=1)


def leading_point(points: FloatArray) -> int:
    """Return the index of the point farthest from the middle of the trailing edge."""
    return int(np.argmax(np.linalg.norm(points - 0.5 * (points[0] + points[-1]), axis=1)))


def section_guide(points: FloatArray, chord: float, tolerance: float, blunt: bool) -> RuledGuide:
    """Return a section as a closed guide in the plane z = 0.

    It starts at the trailing edge, goes over the upper side and has anchors at the leading edge, which is
    farthest from the trailing edge, and at the trailing edge, which is a corner.

    Args:
        points: Points of the section (N, 2) per chord.
        chord: The chord [m].
        tolerance: Maximum distance from the cubic spline through the points [m].
        blunt: Whether the trailing edge has two corners with a straight side, possibly without length.
    """
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    curve = CubicSpline(lengths, points * chord, axis=0)
    tail = 0.5 * (points[0] + points[-1]) * chord
    leading = leading_point(points)
    span = lengths[max(0, leading - 1)], lengths[min(len(lengths) - 1, leading + 1)]
    nose = float(
        minimize_scalar(
            lambda s: -float(np.sum((curve(s) - tail) ** 2)),
            bounds=span,
            method="bounded",
            options={"xatol": 1e-10},
        ).x
    )
    upper, lower = (_fine_parameters(curve, a, b, tolerance) for a, b in ((0.0, nose), (nose, lengths[-1])))
    parameters = np.concatenate([upper, lower[1:]])
    flat = curve(parameters)
    if not blunt:
        flat[0] = tail
        parameters, flat = parameters[:-1], flat[:-1]
    count = len(parameters)
    corner, anchor = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    corner[0] = True
    corner[-1] = blunt
    anchor[len(upper) - 1] = True
    points_3d = np.concatenate([flat, np.zeros((count, 1))], axis=1)
    parameter = np.arange(count) / count
    return RuledGuide(points_3d, corner, parameter, closed=True, anchor=anchor)


def _fine_parameters(curve: CubicSpline, start: float, stop: float, tolerance: float) -> FloatArray:
    """Return parameters between which the curve is within ``tolerance`` of its chords, ends included."""
    parameters = np.linspace(start, stop, 17)
    for _ in range(12):
        middle = 0.5 * (parameters[1:] + parameters[:-1])
        ends = curve(parameters)
        distances = np.linalg.norm(curve(middle) - 0.5 * (ends[1:] + ends[:-1]), axis=1)
        if distances.max() <= tolerance:
            break
        parameters = np.sort(np.concatenate([parameters, middle[distances > tolerance]]))
    return parameters


def _refuse_digits(digits: str, reason: str) -> TandemError:
    message = format_message("part.naca", digits=digits, reason=reason)
    return issue_error("part.naca", message, field="part.wing")


@dataclasses.dataclass(frozen=True)
class WingPanel:
    """A wing panel.

    Attributes:
        root: Points of the root section (N, 2) per chord, in Selig's order.
        tip: Points of the tip section (M, 2) per chord, in Selig's order.
        root_chord: Chord of the root [m].
        tip_chord: Chord of the tip [m].
        span: Distance of the sections [m].
        sweep: Sweep of the quarter-chord line, positive to the rear [rad].
        twist: Washout, positive with the tip's nose down [rad].
        dihedral: Dihedral, positive with the tip up [rad].
        trailing_edge: Minimum thickness of the trailing edge [m].
    """

    root: FloatArray
    tip: FloatArray
    root_chord: float
    tip_chord: float
    span: float
    sweep: float = 0.0
    twist: float = 0.0
    dihedral: float = 0.0
    trailing_edge: float = 0.0


def wing_surface(panel: WingPanel, match: Match = "arc_length", tolerance: float = 2e-5) -> RuledSurface:
    """Return the panel's closed skin from root to tip.

    It joins leading edges, and trailing edges on the upper and on the lower side, where the skin has a
    corner. Between them it joins points at equal fractions of each side's length, or as ``match`` says.

    Args:
        panel: The panel.
        match: Matching of points between the edges.
        tolerance: Maximum distance from the splines through the sections [m].
    """
    guides = []
    sections = ((panel.root, panel.root_chord), (panel.tip, panel.tip_chord))
    thickened_sections = [thickened(points, panel.trailing_edge / chord) for points, chord in sections]
    gaps = [
        float(np.linalg.norm(points[0] - points[-1])) * chord
        for points, (_, chord) in zip(thickened_sections, sections, strict=True)
    ]
    for points, (_, chord) in zip(thickened_sections, sections, strict=True):
        guides.append(section_guide(points, chord, 0.2 * tolerance, max(gaps) > MAX_SHARP_EDGE_THICKNESS_M))
    root, tip = guides
    quarter = np.array([0.25 * panel.root_chord, 0.0])
    tip_quarter = quarter + np.array([np.tan(panel.sweep), np.tan(panel.dihedral)]) * panel.span
    start = _placed(root, panel.root_chord, quarter, 0.0, 0.0)
    end = _placed(tip, panel.tip_chord, tip_quarter, panel.twist, panel.span)
    # lower side first, so that its direction x the rulings, from root to tip, points outwards
    return resample(
        join_guides("skin", reverse_guide(start), reverse_guide(end), match),
        0.6 * tolerance,
        0.25 * panel.root_chord,
    )


def _placed(guide: RuledGuide, chord: float, quarter: FloatArray, twist: float, y: float) -> RuledGuide:
    """Return the section with its quarter-chord point at x, z = ``quarter``.

    Its nose is rotated down by ``twist`` [rad].
    """
    x, z = guide.points[:, 0] - 0.25 * chord, guide.points[:, 1]
    c, s = np.cos(twist), np.sin(twist)
    placed = np.stack([quarter[0] + c * x - s * z, np.full(len(x), y), quarter[1] + s * x + c * z], axis=1)
    return dataclasses.replace(guide, points=placed)


MIN_SECTION_POINTS: Final = 15
"""Minimum number of points of a section. With fewer, a spline does not define the nose."""
MAX_SECTION_POINTS: Final = 5000
"""Maximum number of points of a section."""
MAX_TRAILING_EDGE: Final = 0.10
"""Maximum trailing edge, per chord. A larger gap means that points are missing."""
_MAX_SECTION_BYTES: Final = 2_000_000
"""Maximum size of section files [bytes]. Larger files are refused unread."""
_COORDINATE: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
"""A number, optionally with an exponent as in Fortran."""
_COORDINATE_PAIR: Final = re.compile(rf"^\s*\(?\s*({_COORDINATE})[\s,;]+({_COORDINATE})\s*\)?\s*$")
"""A line with the two coordinates of a point."""


def read_airfoil(path: Path, field: str) -> tuple[FloatArray, list[Issue]]:
    """Return points (N, 2) per chord, from the trailing edge over the upper side and back, and notes.

    The notes report corrections: order, a chord that is not 1 long, repeated points.

    Args:
        path: The file.
        field: Field of the problem file that names it.

    Raises:
        TandemError: The file is not a valid section (``problem.missing_file``, ``problem.too_large``,
            ``part.airfoil_format``, ``part.airfoil_order``, ``part.airfoil_open``, ``part.airfoil_points``,
            ``part.airfoil_crossing``).
    """
    if not is_file(path):
        raise _refuse_file(
            "problem.missing_file", path, field, f"{missing_file_reason(path)}; check the path"
        )
    if path.stat().st_size > _MAX_SECTION_BYTES:
        raise _refuse_file(
            "problem.too_large", path, field, "more than 2 MB; an airfoil has some hundred points"
        )
    notes: list[Issue] = []
    coordinates = _read_coordinates(path, field)
    points = _sides(coordinates, path, field)
    repeated = np.concatenate([[False], np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-9])
    if repeated.any():
        points = points[~repeated]
        notes.append(_note(path, field, f"left out {int(repeated.sum())} points that repeat the one before"))
    if not MIN_SECTION_POINTS <= len(points) <= MAX_SECTION_POINTS:
        reason = f"has {len(points)} points, allowed {MIN_SECTION_POINTS} to {MAX_SECTION_POINTS}; "
        reason += "use another file of the same section"
        raise _refuse_file("part.airfoil_points", path, field, reason)
    points = _ordered(points, path, field, notes)
    _check_trailing_edge_and_crossing(points, path, field)
    return _unit_chord(points, path, field, notes), notes


def _read_coordinates(path: Path, field: str) -> FloatArray:
    """Return the pairs of numbers (M, 2) of a file. Raises ``part.airfoil_format`` for text between them."""
    lines = path.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()
    pairs: list[tuple[float, float]] = []
    remark: tuple[int, str] | None = None
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        pair = _COORDINATE_PAIR.match(line)
        if pair is None:
            if pairs and remark is None:
                remark = number, line.strip()[:40]
            continue  # a name above the points or remarks below them, however many lines long
        if remark is not None:
            reason = f"line {remark[0]} has no x and y ({remark[1]!r}); remove or correct it"
            raise _refuse_file("part.airfoil_format", path, field, reason)
        pairs.append((_float(pair.group(1)), _float(pair.group(2))))
    if not pairs:
        reason = "has no points; a name and lines of x y in Selig's or Lednicer's format are required"
        raise _refuse_file("part.airfoil_format", path, field, reason)
    rows = np.array(pairs)
    if not np.isfinite(rows).all():
        raise _refuse_file(
            "part.airfoil_format", path, field, "has numbers too large to read; repair the file"
        )
    return rows


def _float(text: str) -> float:
    return float(text.replace("d", "e").replace("D", "e"))


def _sides(points: FloatArray, path: Path, field: str) -> FloatArray:
    """Return the points (N, 2) in one sequence. Lednicer's two sides are joined at the leading edge."""
    counts = np.round(points[0])
    # a file in Lednicer's format starts with two whole numbers, the counts of points
    if not (np.abs(points[0] - counts) < 1e-6).all() or (counts < 3).any():
        return points
    upper, lower = int(counts[0]), int(counts[1])
    if len(points) - 1 != upper + lower:
        reason = f"says {upper} + {lower} points (Lednicer's format) and has {len(points) - 1}; correct it"
        raise _refuse_file("part.airfoil_format", path, field, reason)
    top, bottom = points[1 : 1 + upper], points[1 + upper :]
    for side, name in ((top, "upper"), (bottom, "lower")):
        if side[0, 0] > side[-1, 0]:
            reason = (
                f"its {name} side starts at the trailing edge; in Lednicer's format both start at the nose"
            )
            raise _refuse_file("part.airfoil_order", path, field, reason)
    if np.linalg.norm(top[0] - bottom[0]) < 1e-9:
        bottom = bottom[1:]
    return np.concatenate([top[::-1], bottom])


def _ordered(points: FloatArray, path: Path, field: str, notes: list[Issue]) -> FloatArray:
    """Return the points from the trailing edge over the top and back below."""
    chord = float(np.ptp(points[:, 0]))
    if chord <= 0.0:
        raise _refuse_file(
            "part.airfoil_format", path, field, "all x are equal; an airfoil has x along its chord"
        )
    step = np.diff(points[:, 0])
    step = step[np.abs(step) > 1e-3 * chord]
    reversals = int((np.diff(np.sign(step)) != 0).sum())
    if reversals > 2:
        reason = (
            f"x turns back {reversals} times along its points; the order must be from the trailing edge "
            "over the top and back below (Selig), so sort the points"
        )
        raise _refuse_file("part.airfoil_order", path, field, reason)
    front = points[:, 0].min() + 0.5 * chord
    if points[0, 0] < front and points[-1, 0] < front:
        rear = int(np.argmax(points[:, 0]))
        rotated = np.concatenate([points[rear:], points[:rear]])
        if np.linalg.norm(rotated[len(points) - rear] - rotated[len(points) - rear - 1]) < 1e-9 * chord:
            rotated = np.delete(rotated, len(points) - rear, axis=0)
        points = rotated
        notes.append(_note(path, field, "began at the leading edge; its points were sorted in Selig's order"))
    nose = leading_point(points)
    if nose in (0, len(points) - 1) or points[0, 0] < front or points[-1, 0] < front:
        reason = "has one side only; give both, from the trailing edge over the top and back below"
        raise _refuse_file("part.airfoil_open", path, field, reason)
    if _area(points) < 0.0:
        points = points[::-1]
        notes.append(_note(path, field, "began with the lower side; the order of its points was reversed"))
    return points


def _check_trailing_edge_and_crossing(points: FloatArray, path: Path, field: str) -> None:
    """Raise ``part.airfoil_open`` for a wide trailing edge, ``part.airfoil_crossing`` for a crossing."""
    chord = float(np.ptp(points[:, 0]))
    gap = points[0] - points[-1]
    if abs(gap[0]) > 0.02 * chord or np.linalg.norm(gap) > MAX_TRAILING_EDGE * chord:
        reason = (
            f"has no trailing edge: its sides end at x = {points[0, 0]:g} and {points[-1, 0]:g}, "
            f"{np.linalg.norm(gap) / chord:.1%} of the chord apart (allowed for a blunt one: an upright gap "
            f"of up to {MAX_TRAILING_EDGE:.0%}); add the missing points"
        )
        raise _refuse_file("part.airfoil_open", path, field, reason)
    line = LineString(points)
    if not line.is_simple:
        position = _crossing(points)
        reason = f"crosses itself near x = {position[0]:.4g}, y = {position[1]:.4g}; correct the points there"
        raise _refuse_file("part.airfoil_crossing", path, field, reason)


def _crossing(points: FloatArray) -> FloatArray:
    """Return a point (2,) at which a polyline meets itself, its first point if none is found."""
    a, b = points[:-1], points[1:]
    for i in range(len(a) - 2):
        other = LineString(points[i + 2 :])
        common = LineString([a[i], b[i]]).intersection(other)
        if not common.is_empty:
            return np.array(common.representative_point().coords[0])
    return np.asarray(points[0])


def _unit_chord(points: FloatArray, path: Path, field: str, notes: list[Issue]) -> FloatArray:
    """Return the section with its foremost point at x = 0 and its trailing edge at x = 1, not rotated."""
    nose, tail = float(points[:, 0].min()), 0.5 * float(points[0, 0] + points[-1, 0])
    chord = tail - nose
    if abs(chord - 1.0) <= 2e-3 and abs(nose) <= 2e-3:
        return points
    notes.append(
        _note(path, field, f"has a chord from x = {nose:.4g} to {tail:.4g}; it was scaled to 0 to 1")
    )
    return np.asarray((points - np.array([nose, 0.0])) / chord)


def _area(points: FloatArray) -> float:
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _note(path: Path, field: str, correction: str) -> Issue:
    message = format_message("part.airfoil_note", file=path.name, correction=correction)
    return Issue("part.airfoil_note", message, Severity.NOTE, file=str(path), field=field)


def _refuse_file(code: str, path: Path, field: str, reason: str) -> TandemError:
    return issue_error(code, f"{path.name}: {reason}", file=str(path), field=field)
