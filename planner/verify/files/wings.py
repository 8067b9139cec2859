"""The skin of a wing panel from its sections and the numbers that place them.

x from the leading to the trailing edge, y from root to tip, z up; origin at the root's leading edge.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner.verify.files.airfoils import read_section, section_of_digits
from planner.verify.files.guides import Curve, Ruled, matched
from planner.verify.files.values import Said, file_of, metres, radians

FloatArray = NDArray[np.float64]

SHARP: Final = 1e-6
"""A trailing edge that is thinner [m] is an edge."""
_SIDE: Final = 600
"""Places along each side of a section."""


def skin(said: Said) -> Ruled:
    """The skin, over the lower side first, away from the part outwards. Raises `UnreadError`."""
    least = metres(said.get("trailing_edge_mm") or 0.0)
    sections, chords = [], []
    for side in ("root", "tip"):
        own = said[side]
        points = read_section(file_of(own)) if own.get("file") else section_of_digits(str(own["naca"]))
        chords.append(metres(own["chord_mm"]))
        sections.append(_thick(points, least / chords[-1]))
    gaps = [
        float(np.hypot(*(points[0] - points[-1]))) * chord
        for points, chord in zip(sections, chords, strict=True)
    ]
    span = metres(said["span_mm"])
    sweep, rise = (np.tan(radians(said.get(key) or 0.0)) for key in ("sweep_deg", "dihedral_deg"))
    quarter = np.array([[0.25 * chords[0], 0.0], [0.25 * chords[0] + span * sweep, span * rise]])
    turn = (0.0, radians(said.get("twist_deg") or 0.0))
    guides = []
    for k, (points, chord) in enumerate(zip(sections, chords, strict=True)):
        curve = _curve(points, chord, max(gaps) > SHARP)
        x, z = curve.points[:, 0] - 0.25 * chord, curve.points[:, 1]
        c, s = np.cos(turn[k]), np.sin(turn[k])  # the nose, at x below zero, goes down
        placed = np.column_stack(
            [quarter[k, 0] + c * x - s * z, np.full(len(x), k * span), quarter[k, 1] + s * x + c * z]
        )
        guides.append(dataclasses.replace(curve, points=placed))
    return matched(guides[0], guides[1], "arc_length")


def _thick(points: FloatArray, least: float) -> FloatArray:
    """The section with a trailing edge of ``least`` chords, its sides moved apart in proportion to x."""
    gap = float(np.hypot(*(points[0] - points[-1])))
    if gap >= least:
        return points
    sign = np.where(np.arange(len(points)) <= _nose(points), 0.5, -0.5)
    return points + np.column_stack([0.0 * sign, sign * (least - gap) * np.clip(points[:, 0], 0.0, 1.0)])


def _nose(points: FloatArray) -> int:
    return int(np.argmax(np.hypot(*(points - 0.5 * (points[0] + points[-1])).T)))


def _curve(points: FloatArray, chord: float, blunt: bool) -> Curve:
    """A section [m] as a closed curve from the trailing edge along the lower side, kept together at the
    leading edge, the place farthest from the trailing edge, and at the trailing edge's one or two corners."""
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    curve = CubicSpline(way, points * chord)
    tail = 0.5 * chord * (points[0] + points[-1])
    at = _nose(points)
    near = np.linspace(way[max(at - 1, 0)], way[min(at + 1, len(way) - 1)], 4001)
    nose = near[int(np.argmax(np.hypot(*(curve(near) - tail).T)))]
    lower, upper = np.linspace(way[-1], nose, _SIDE), np.linspace(nose, 0.0, _SIDE)[1:]
    flat = curve(np.concatenate([lower, upper]))
    anchor = np.zeros(len(flat), dtype=np.bool_)
    anchor[[0, _SIDE - 1, -1]] = True
    if not blunt:
        flat[0] = tail
        flat, anchor = flat[:-1], anchor[:-1]
    spread = np.column_stack([flat, np.zeros(len(flat))])
    return Curve(spread, np.arange(len(flat)) / len(flat), anchor, True)
