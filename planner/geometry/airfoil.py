"""Airfoil sections: NACA families of 4 and 5 digits from their formulas, and any section as a smooth guide.

A section is a row of points (N, 2) per chord, x from the leading to the trailing edge: from the trailing edge
over the upper side to the leading edge and along the lower side back. A blunt trailing edge stays open
between its last and its first point.

Sources of the formulas: E. N. Jacobs, K. E. Ward and R. M. Pinkerton, NACA Report 460 (1933), four digits;
E. N. Jacobs and R. M. Pinkerton, NACA Report 537 (1935), five digits with simple and reflexed camber lines;
I. H. Abbott and A. E. von Doenhoff, Theory of Wing Sections (Dover, 1959), 6.4 to 6.6; constants of the
camber lines as in C. L. Ladson and C. W. Brooks, NASA TM X-3284 (1975).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from planner.geometry.guides import Guide
from planner.issues import Issue, TandemError

FloatArray = NDArray[np.float64]

THICKNESS: Final = (0.2969, -0.1260, -0.3516, 0.2843, -0.1015)
"""Coefficients of x^0.5, x, x^2, x^3, x^4 of the half thickness of a section 20 % thick."""
SIMPLE: Final = {
    "210": (0.0580, 361.400),
    "220": (0.1260, 51.640),
    "230": (0.2025, 15.957),
    "240": (0.2900, 6.643),
    "250": (0.3910, 3.230),
}
"""Camber lines of five digits for a design lift coefficient of 0.3: (m, k1)."""
REFLEXED: Final = {
    "221": (0.1300, 51.990, 0.000764),
    "231": (0.2170, 15.793, 0.00677),
    "241": (0.3180, 6.520, 0.0303),
    "251": (0.4410, 3.191, 0.1355),
}
"""Reflexed camber lines for a design lift coefficient of 0.3: (m, k1, k2 / k1)."""
SHARP: Final = 1e-6
"""A trailing edge thinner than this [m] is sharp."""


def naca(digits: str, count: int = 160) -> FloatArray:
    """Points (2 count + 1, 2) of a NACA section of 4 or 5 digits, close together at both edges.

    Thickness stands at right angles to the camber line. The trailing edge is as blunt as the formula makes it
    (0.0021 of the chord at a thickness of 0.10). Raises ``TandemError`` with ``part.naca``.
    """
    if not digits.isdigit() or len(digits) not in (4, 5):
        raise _refuse(digits, "sections of 4 or 5 digits are known, as 2412 or 23112")
    thickness = int(digits[-2:]) / 100.0
    if not 0.01 <= thickness <= 0.40:
        raise _refuse(digits, f"a thickness of {thickness:.0%} of the chord; 1 to 40 % are allowed")
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count + 1)))
    height, slope = _camber_4(digits, x) if len(digits) == 4 else _camber_5(digits, x)
    powers = np.stack([np.sqrt(x), x, x**2, x**3, x**4])
    half = 5.0 * thickness * (np.array(THICKNESS) @ powers)
    angle = np.arctan(slope)
    away = half[:, None] * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    middle = np.stack([x, height], axis=1)
    return np.concatenate([(middle + away)[::-1], (middle - away)[1:]])


def _camber_4(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    m, p = int(digits[0]) / 100.0, int(digits[1]) / 10.0
    if m == 0.0:
        return np.zeros_like(x), np.zeros_like(x)
    if p == 0.0:
        raise _refuse(digits, "camber without its place; the second digit says where it is, in tenths")
    rest = np.where(x < p, p * p, (1.0 - p) ** 2)
    height = m / rest * np.where(x < p, 2 * p * x - x * x, 1 - 2 * p + 2 * p * x - x * x)
    return height, 2.0 * m / rest * (p - x)


def _camber_5(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    line = f"2{digits[1:3]}"
    lift = 0.15 * int(digits[0]) / 0.3  # of the tabulated camber lines, which are for 0.3
    if int(digits[0]) == 0 or line not in SIMPLE | REFLEXED:
        known = ", ".join(sorted(SIMPLE | REFLEXED))
        raise _refuse(digits, f"no such camber line; of five digits {known} are known (first digit 1 to 9)")
    if line in SIMPLE:
        m, k = SIMPLE[line]
        front = x**3 - 3 * m * x**2 + m * m * (3 - m) * x
        height = np.where(x < m, front, m**3 * (1 - x))
        slope = np.where(x < m, 3 * x**2 - 6 * m * x + m * m * (3 - m), -(m**3))
    else:
        m, k, ratio = REFLEXED[line]
        line_down = ratio * (1 - m) ** 3 + m**3
        factor = np.where(x < m, 1.0, ratio)
        height = factor * (x - m) ** 3 - line_down * x + m**3
        slope = 3 * factor * (x - m) ** 2 - line_down
    return lift * k / 6.0 * height, lift * k / 6.0 * slope


def thickened(points: FloatArray, least: float) -> FloatArray:
    """The section with a trailing edge at least ``least`` chords thick: upper and lower side are moved apart
    in proportion to x, so that the leading edge stays as it is.
    """
    gap = float(np.linalg.norm(points[0] - points[-1]))
    if gap >= least:
        return points
    top = np.arange(len(points)) <= leading_point(points)
    share = np.clip(points[:, 0], 0.0, 1.0)
    away = 0.5 * (least - gap) * share * np.where(top, 1.0, -1.0)
    return points + np.stack([np.zeros(len(points)), away], axis=1)


def leading_point(points: FloatArray) -> int:
    """Index of the point farthest from the middle of the trailing edge."""
    return int(np.argmax(np.linalg.norm(points - 0.5 * (points[0] + points[-1]), axis=1)))


def section_guide(points: FloatArray, chord: float, tolerance: float, blunt: bool) -> Guide:
    """A section of ``chord`` [m] as a closed guide in the plane z = 0, within ``tolerance`` [m] of the cubic
    spline through its points.

    It starts at the trailing edge, goes over the upper side and has anchors at the leading edge, which is the
    farthest from the trailing edge, and at the trailing edge, which is a corner: two corners with a straight
    side where ``blunt``, which may be of no length.
    """
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    curve = CubicSpline(way, points * chord, axis=0)
    tail = 0.5 * (points[0] + points[-1]) * chord
    near = leading_point(points)
    span = way[max(0, near - 1)], way[min(len(way) - 1, near + 1)]
    nose = float(
        minimize_scalar(
            lambda s: -float(np.sum((curve(s) - tail) ** 2)),
            bounds=span,
            method="bounded",
            options={"xatol": 1e-10},
        ).x
    )
    upper, lower = (_fine(curve, a, b, tolerance) for a, b in ((0.0, nose), (nose, way[-1])))
    place = np.concatenate([upper, lower[1:]])
    flat = curve(place)
    if not blunt:
        flat[0] = tail
        place, flat = place[:-1], flat[:-1]
    count = len(place)
    corner, anchor = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    corner[0] = True
    corner[-1] = blunt
    anchor[len(upper) - 1] = True
    spread = np.concatenate([flat, np.zeros((count, 1))], axis=1)
    parameter = np.arange(count) / count
    return Guide(spread, corner, parameter, closed=True, anchor=anchor)


def _fine(curve: CubicSpline, start: float, stop: float, tolerance: float) -> FloatArray:
    """Places between which the curve is within ``tolerance`` of its chords, ends included."""
    place = np.linspace(start, stop, 17)
    for _ in range(12):
        middle = 0.5 * (place[1:] + place[:-1])
        ends = curve(place)
        off = np.linalg.norm(curve(middle) - 0.5 * (ends[1:] + ends[:-1]), axis=1)
        if off.max() <= tolerance:
            break
        place = np.sort(np.concatenate([place, middle[off > tolerance]]))
    return place


def _refuse(digits: str, what: str) -> TandemError:
    return TandemError(Issue("part.naca", f"NACA {digits}: {what}; correct the digits", field="part.wing"))
