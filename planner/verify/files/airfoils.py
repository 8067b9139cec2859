"""Airfoil sections: coordinates from files in Selig's or Lednicer's format, and NACA digits by formulas.

A section is a row of points (N, 2) per chord from the trailing edge over the upper side to the leading edge
and back below. Formulas: I. H. Abbott and A. E. von Doenhoff, Theory of Wing Sections (1959), 6.4 to 6.6;
C. L. Ladson and C. W. Brooks, NASA TM X-3284 (1975).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.verify.files.faults import UnreadError

FloatArray = NDArray[np.float64]

_SIMPLE: Final = {
    1: (0.0580, 361.4),
    2: (0.1260, 51.64),
    3: (0.2025, 15.957),
    4: (0.29, 6.643),
    5: (0.391, 3.23),
}
"""Second digit of five: place m of the camber line's joint and its factor k1, for a lift of 0.3."""
_REFLEXED: Final = {
    2: (0.130, 51.990, 0.000764),
    3: (0.217, 15.793, 0.00677),
    4: (0.318, 6.520, 0.0303),
    5: (0.441, 3.191, 0.1355),
}
"""The same with a third digit 1, and k2 / k1 behind the joint."""
_STATIONS: Final = 201


def read_section(path: Path) -> FloatArray:
    """The section of a coordinate file, its chord brought to 1 where it is not. Raises `UnreadError`."""
    rows = _rows(path.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff"))
    if len(rows) < 3:
        raise UnreadError("it has no row of points")
    first = rows[0]
    if first.min() >= 2.5 and np.abs(first - np.rint(first)).max() < 1e-6:
        upper = round(first[0])
        if len(rows) != 1 + upper + round(first[1]):
            raise UnreadError("its two sides have other numbers of points than it says")
        rows = np.concatenate([rows[upper:0:-1], rows[upper + 1 :]])
    keep = np.append(True, np.hypot(*np.diff(rows, axis=0).T) > 1e-9)
    points = rows[keep]
    points = _from_the_tail(points)
    left, tail = points[:, 0].min(), 0.5 * (points[0, 0] + points[-1, 0])
    if max(abs(left), abs(tail - left - 1.0)) > 2e-3:
        points = np.column_stack([points[:, 0] - left, points[:, 1]]) / (tail - left)
    return np.asarray(points)


def _rows(text: str) -> FloatArray:
    """Pairs of numbers (N, 2), in order; lines with anything else are names and remarks."""
    out = []
    for line in text.splitlines():
        if line.lstrip().startswith("#"):
            continue
        words = line.strip().lstrip("(").rstrip(")").replace(",", " ").replace(";", " ").split()
        try:
            pair = [float(word.lower().replace("d", "e")) for word in words]
        except ValueError:
            continue
        if len(pair) == 2:
            out.append(pair)
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def _from_the_tail(points: FloatArray) -> FloatArray:
    """The points begun at the trailing edge and turned so that they go over the upper side first."""
    low, high = points[:, 0].min(), points[:, 0].max()
    if max(points[0, 0], points[-1, 0]) < 0.5 * (low + high):  # begun at the nose
        if np.hypot(*(points[0] - points[-1])) < 1e-9 * (high - low):
            points = points[:-1]
        points = np.roll(points, -int(np.argmax(points[:, 0])), axis=0)
    x, y = points.T
    ahead = np.sum((x - np.roll(x, 1)) * (y + np.roll(y, 1)))  # twice the area, clockwise above zero
    return points if ahead <= 0.0 else points[::-1]


def section_of_digits(digits: str) -> FloatArray:
    """The section of NACA digits. Raises `UnreadError`."""
    x = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, _STATIONS)) ** 2  # close together at both edges
    line, slope = _camber(digits, x)
    tall = float(digits[-2:]) / 20.0
    half = tall * (0.2969 * x**0.5 - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)
    turn = np.arctan(slope)
    up = np.column_stack([x - half * np.sin(turn), line + half * np.cos(turn)])
    down = np.column_stack([x + half * np.sin(turn), line - half * np.cos(turn)])
    return np.vstack([up[::-1], down[1:]])


def _camber(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height and slope of the camber line at x (N,)."""
    if len(digits) == 4:
        high, place = int(digits[0]) / 100.0, int(digits[1]) / 10.0
        if high == 0.0:
            return 0.0 * x, 0.0 * x
        front = x <= place
        size = high / np.where(front, place, 1.0 - place) ** 2
        line = size * (2.0 * place * x - x**2 + np.where(front, 0.0, 1.0 - 2.0 * place))
        return line, size * 2.0 * (place - x)
    try:
        lift, second, third = int(digits[0]) * 0.15 / 0.3, int(digits[1]), int(digits[2])
        if third == 0:
            m, k = _SIMPLE[second]
            front = x < m
            line = np.where(front, x**3 - 3 * m * x**2 + m**2 * (3 - m) * x, m**3 * (1 - x))
            slope = np.where(front, 3 * x**2 - 6 * m * x + m**2 * (3 - m), -(m**3))
        else:
            m, k, ratio = _REFLEXED[second]
            back = np.where(x < m, 1.0, ratio)
            fall = ratio * (1 - m) ** 3 + m**3
            line = back * (x - m) ** 3 - fall * x + m**3
            slope = 3.0 * back * (x - m) ** 2 - fall
    except (KeyError, ValueError) as error:
        raise UnreadError(f"NACA {digits} is not known") from error
    return lift * k / 6.0 * line, lift * k / 6.0 * slope
