"""The whole way of both tools: over the sheet to each pass, down onto it, along it, and off again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.forming.values import Pass, ToolPath
from planner.forming.work import Work, segment
from planner.geometry.vectors import dots
from planner.segments import Segment
from planner.units import DEG

FloatArray = NDArray[np.float64]

AIR: Final = 0.005
"""How much farther than the clearance tools stay off the sheet between passes [m]."""
SHARP: Final = 15.0 * DEG
"""Tools stop where their way turns by more than this, and more than smooth ways do from target to target: a
corner that is rounded at full feed costs two tools some of their gap."""
STILL: Final = 1e-6
"""Moves that are shorter than this [m] have no direction."""
BACK: Final = 0.06
"""How far tools are drawn back before and after the job [m], so that arms come to them in free space."""


@dataclasses.dataclass(frozen=True)
class Route:
    """N targets: ``centre``, ``axis`` {arm: (N, 3)}, ``segment`` and ``stop`` (N,)."""

    centre: dict[str, FloatArray]
    axis: dict[str, FloatArray]
    segment: tuple[Segment, ...]
    stop: NDArray[np.bool_]


def lay_out(work: Work, paths: Sequence[tuple[Pass, ToolPath]], clearance: float, most: int) -> Route:
    """The route through all passes. Between passes tools go over the highest place of the part, ``clearance``
    [m] and a little more away. They stop at sharp corners, and at least every ``most`` targets of a pass, at
    the end of a loop, so that programs can be split there."""
    arms = work.operation.arms
    away = {arm: _away(work, arm, clearance) for arm in arms}
    centre: dict[str, list[FloatArray]] = {arm: [] for arm in arms}
    axis: dict[str, list[FloatArray]] = {arm: [] for arm in arms}
    segments: list[Segment] = []
    stops: list[NDArray[np.bool_]] = []
    sharp = max(SHARP, 1.1 * work.operation.tangent_deg * DEG)
    for number, (one, path) in enumerate(paths):
        own = _by_arm(work, one, path)
        count, formed = len(path.former), segment(one)
        first, last = number == 0, number == len(paths) - 1
        for arm in arms:
            points, axes = own[arm]
            rise = np.array([0.0, 0.0, 1.0 if work.above(arm) else -1.0])
            start, end = (np.where([0, 0, 1], away[arm], points[k]) for k in (0, -1))
            row = [start, start, *points, end] if not first else [start + BACK * rise, start, *points, end]
            row = row[0 if first else 1 :]
            turns = [axes[:1]] * (2 if first else 1) + [axes, axes[-1:]]
            if last:
                row.append(end + BACK * rise)
                turns.append(axes[-1:])
            centre[arm].append(np.array(row))
            axis[arm].append(np.concatenate(turns))
        segments += [Segment("approach"), Segment("approach")] if first else [Segment("link")]
        segments += [formed.at("in"), *[formed] * (count - 1), formed.at("out")]
        segments += [Segment("retreat")] if last else []
        head, tail = (2 if first else 1), (2 if last else 1)
        within = _stops(path.contact.loop, most)
        for points, _ in own.values():
            within |= _corners(points, sharp)
        within[[0, -1]] = True
        stops.append(np.concatenate([np.ones(head, bool), within, np.ones(tail, bool)]))
    return Route(
        {arm: np.concatenate(centre[arm]) for arm in arms},
        {arm: np.concatenate(axis[arm]) for arm in arms},
        tuple(segments),
        np.concatenate(stops),
    )


def _by_arm(work: Work, one: Pass, path: ToolPath) -> dict[str, tuple[FloatArray, FloatArray]]:
    out = {work.former(one): (path.former, path.axis)}
    other = work.supporter(one)
    if other is not None and path.support is not None and path.support_axis is not None:
        out[other] = (path.support, path.support_axis)
    return out


def _away(work: Work, arm: str, clearance: float) -> float:
    """Height z [m] at which a tool's TCP is off everything of the sheet, whatever is formed already."""
    head, heights = work.heads[arm], work.mesh.vertices[:, 2]
    shifts = [one.vertices[:, 2] for one in work.passes]
    low = min(float(heights.min()), *(float(z.min()) for z in shifts))
    high = max(float(heights.max()), *(float(z.max()) for z in shifts)) + work.thickness
    reach = head.radius if head.kind == "ball" else 0.0
    gap = clearance + AIR + reach
    return high + gap if work.above(arm) else low - gap


def _corners(points: FloatArray, angle: float) -> NDArray[np.bool_]:
    """(N,) where the way through ``points`` (N, 3) turns by more than ``angle`` [rad]."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    long = np.flatnonzero(length > STILL)
    out = np.zeros(len(points), dtype=bool)
    if len(long) > 1:
        way = step[long] / length[long, None]
        sharp = dots(way[1:], way[:-1]) < np.cos(angle)
        out[long[1:][sharp]] = True
    return out


def _stops(loop: NDArray[np.int64], most: int) -> NDArray[np.bool_]:
    """(N,) where to stop: at the last possible end of a loop before ``most`` targets have gone by."""
    ends = np.flatnonzero(np.diff(loop) != 0)
    out = np.zeros(len(loop), dtype=bool)
    last = 0
    while len(loop) - 1 - last > most:
        near = ends[(ends > last) & (ends <= last + most)]
        last = int(near[-1]) if len(near) else last + most
        out[last] = True
    return out
