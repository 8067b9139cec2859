"""A face milled in parallel lines, as near to one another as a stepover or a ridge height asks."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.issues import Issue, TandemError
from planner.milling.inset import within
from planner.milling.operation import LinesCut, Milling
from planner.milling.over import Over, Places
from planner.milling.point import leant, ridge_height, ridge_step, tips
from planner.milling.thin import thinned
from planner.milling.values import Run, plain_path
from planner.tooling import Cutter
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

EDGE: Final = 1e-6
"""Lines keep so far [m] inside the edge, on which a place is neither on the face nor off it."""
ALONG: Final = 0.5 * MM
"""Distance of the places at which a line is laid on the face."""
LEVER: Final = 0.05
"""How far behind the tip [m] the tool keeps within the chord between targets, too."""
CHORD: Final = 0.1
MOST: Final = 5000
"""Lines of one cut at most."""
BEND: Final = 2.0 * MM
"""Distance over which the bend of the face across a line is measured."""
LOWER: Final = 0.85
"""Share of the highest ridges that are allowed that is advised: with those, the tolerance holds."""
SLACK: Final = 1.1
"""Ridges so many times as high as the tolerance allows are refused: those below are left to the proof."""


def runs(
    op: Milling, cut: LinesCut, over: Over, cutter: Cutter, area: shapely.Geometry | None = None
) -> list[Run]:
    """The lines in order, those that follow one another joined, in ``area`` [m] of the plan alone. Raises
    ``TandemError`` with codes ``milling.*``."""
    turn = cut.angle_deg * DEG
    way, side = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    corners = np.array([[x, y] for x in (over.low[0], over.high[0]) for y in (over.low[1], over.high[1])])
    if area is not None:
        corners = shapely.get_coordinates(area)
    ends = [(corners @ axis).min() + EDGE if len(corners) else 0.0 for axis in (way, side)]
    tops = [(corners @ axis).max() - EDGE if len(corners) else 0.0 for axis in (way, side)]
    if min(tops[0] - ends[0], tops[1] - ends[1]) <= 0.0:
        most = 0.25 * float((over.high - over.low).min()) / MM
        raise TandemError(
            Issue(
                "milling.pattern",
                f"lines: a margin of {cut.margin_mm:g} mm leaves nothing of the face; {most:.1f} mm would "
                "leave half of its width",
                field="operations.cuts.margin_mm",
                value=cut.margin_mm,
            )
        )
    count = int(np.ceil((tops[0] - ends[0]) / ALONG)) + 1
    places = np.linspace(ends[0], tops[0], count)[:, None] * way
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    most = SLACK * tolerance / op.share**2  # of a round ridge the share sqrt(tolerance / height) is within
    offsets = _offsets(cut, over, places, side, (ends[1], tops[1]), cutter, most)
    pieces: list[list[tuple[FloatArray, FloatArray]]] = []
    for number, offset in enumerate(offsets):
        laid = over.at(places + offset * side)
        if area is not None:
            laid = dataclasses.replace(laid, on=laid.on & within(area, places + offset * side))
        for first, last in _pieces(laid):
            rows = np.arange(first, last + 1)
            flip = cut.zigzag and number % 2 == 1
            line = _tool(cut, laid.point[rows], laid.normal[rows], way, flip, cutter)
            near = (
                pieces and np.linalg.norm(pieces[-1][-1][0][-1] - line[0][0]) < 3.0 * _widest(offsets) + ALONG
            )
            if cut.zigzag and near:
                pieces[-1].append(line)
            else:
                pieces.append([line])
    name, feed = f"{cut.lines}_lines", (cut.feed_mm_s or op.feed_mm_s) * MM
    out = []
    for number, piece in enumerate(pieces, 1):
        kept = [
            thinned(np.stack([t, t + LEVER * a], axis=1), CHORD * tolerance, op.step_mm * MM)
            for t, a in piece
        ]
        tip = np.concatenate([t[rows] for (t, _), rows in zip(piece, kept, strict=True)])
        axis = np.concatenate([a[rows] for (_, a), rows in zip(piece, kept, strict=True)])
        label = name if len(pieces) == 1 else f"{name}_p{number}"
        out.append(Run(label, plain_path(tip, axis, feed), 0, len(tip) - 1, 0.0))
    return out


def _widest(offsets: FloatArray) -> float:
    return float(np.diff(offsets).max(initial=0.0))


def _offsets(
    cut: LinesCut,
    over: Over,
    places: FloatArray,
    side: FloatArray,
    ends: tuple[float, float],
    cutter: Cutter,
    most: float,
) -> FloatArray:
    """Where across the face (L,) [m] its lines are: the step to the next one is the least that any place of
    the line asks for; all are made smaller alike so that the last one lies on the edge. ``most``: how
    high [m] ridges may be."""
    if cut.scallop_mm is not None and cutter.corner == 0.0:
        raise TandemError(
            Issue(
                "milling.pattern",
                "lines: a cylinder's end leaves no round ridges, so that scallop_mm says nothing; give a "
                "stepover_mm, or take a ball or bull nose",
                field="operations.cuts.scallop_mm",
            )
        )
    found, lowest = [ends[0]], np.inf
    while found[-1] < ends[1]:
        step, ridge = _step(cut, over, places, side, found[-1], ends, cutter)
        lowest = min(lowest, ridge)
        found.append(found[-1] + step)
        if len(found) > MOST:
            raise TandemError(
                Issue(
                    "milling.pattern",
                    f"lines: more than {MOST} lines; give {_wider(cut, found, ends)}",
                    field="operations.cuts",
                    value=float(len(found)),
                    limit=float(MOST),
                )
            )
    out = np.array(found)
    closer = (ends[1] - ends[0]) / (out[-1] - ends[0])
    if cutter.kind == "ball":  # a bull nose has a flat that leaves less
        _ridges(cut, float(lowest * closer**2), most)
    return np.asarray(ends[0] + (out - ends[0]) * closer)


def _wider(cut: LinesCut, found: list[float], ends: tuple[float, float]) -> str:
    """What would do with half as many lines as are allowed; the first of them are ``found`` [m]."""
    wide = 2.0 * (ends[1] - ends[0]) / max(found[-1] - found[0], 1e-9)
    if cut.stepover_mm is not None:
        return f"a stepover_mm of {np.ceil(wide * cut.stepover_mm * 100.0) / 100.0:.2f}"
    return f"a scallop_mm of {np.ceil(wide**2 * (cut.scallop_mm or 0.0) * 1000.0) / 1000.0:.3f}"


def _ridges(cut: LinesCut, lowest: float, most: float) -> None:
    """Refuse lines whose lowest ridge [m] already leaves too much of the face outside of its tolerance."""
    if lowest > most:
        # ridges go with the square of the step
        less = LOWER * most / lowest
        if cut.stepover_mm is not None:
            do = f"a stepover_mm of {np.floor(np.sqrt(less) * cut.stepover_mm * 100.0) / 100.0:.2f}"
        else:
            do = f"a scallop_mm of {np.floor(less * (cut.scallop_mm or 0.0) * 1000.0) / 1000.0:.3f}"
        raise TandemError(
            Issue(
                "milling.pattern",
                f"lines: ridges of {lowest / MM:.3f} mm or more leave too little of it within shape_tol_mm; "
                f"allowed: {most / MM:.3f} mm; give {do} or less, or more tolerance",
                field="operations.cuts",
                value=lowest / MM,
                limit=most / MM,
                unit="mm",
            )
        )


def _step(
    cut: LinesCut,
    over: Over,
    places: FloatArray,
    side: FloatArray,
    offset: float,
    ends: tuple[float, float],
    cutter: Cutter,
) -> tuple[float, float]:
    """Plan distance [m] from a line to the next one, and the height [m] of the lowest ridge between them."""
    aside = np.append(side, 0.0)
    wide = cut.stepover_mm * MM if cut.stepover_mm is not None else None
    steps, ridges = [], []
    guess = (
        wide
        if wide is not None
        else float(ridge_step((cut.scallop_mm or 0.0) * MM, cutter.corner, np.zeros(1))[0])
    )
    for at in (offset, min(offset + guess, ends[1])):
        rows = [over.at(places + (at + shift) * side) for shift in (-BEND, 0.0, BEND)]
        on = rows[0].on & rows[1].on & rows[2].on
        if not on.any():
            on = rows[1].on
            if not on.any():
                continue
            slope = np.abs(rows[1].normal[on] @ aside)
            bend = np.zeros(len(slope))
        else:
            slope = np.abs(rows[1].normal[on] @ aside)
            turn = (rows[2].normal[on] - rows[0].normal[on]) @ aside
            bend = turn / (2.0 * BEND)
        flat = np.sqrt(np.maximum(1.0 - slope**2, 1e-4))
        if wide is not None:
            steps.append(float((wide * flat).min()))
            ridges.append(float(ridge_height(wide, cutter.corner, bend).min()))
        else:
            steps.append(float((ridge_step((cut.scallop_mm or 0.0) * MM, cutter.corner, bend) * flat).min()))
    asked = min(ridges, default=0.0) if wide is not None else (cut.scallop_mm or 0.0) * MM
    return max(min(steps, default=guess), 0.02 * MM), asked


def _pieces(laid: Places) -> list[tuple[int, int]]:
    """First and last index of each stretch of a line that lies on the face, of two places at least."""
    on = np.concatenate([[False], laid.on, [False]])
    turns = np.flatnonzero(on[1:] != on[:-1])
    return [(int(a), int(b) - 1) for a, b in zip(turns[::2], turns[1::2], strict=True) if b - a >= 2]


def _tool(
    cut: LinesCut, point: FloatArray, normal: FloatArray, way: FloatArray, flip: bool, cutter: Cutter
) -> tuple[FloatArray, FloatArray]:
    """Tips and axes (N, 3) along one line."""
    if flip:
        point, normal = point[::-1], normal[::-1]
    feed = np.gradient(point, axis=0)
    if cut.axis == "upright":
        axis = np.broadcast_to([0.0, 0.0, 1.0], point.shape).copy()
    else:
        axis = leant(normal, feed, cut.lead_deg * DEG, cut.tilt_deg * DEG)
    return tips(point, normal, axis, cutter), axis
