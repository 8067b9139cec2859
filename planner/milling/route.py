"""The whole way of the cutter: over the block on the safe plane to each pass,
down, along it, and off again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import dots
from planner.issues import Issue, TandemError
from planner.milling.operation import Milling, SafeSide
from planner.milling.values import Run
from planner.segments import Segment
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

SIDES: Final[dict[SafeSide, tuple[int, int]]] = {
    "left": (0, 0),
    "right": (0, 1),
    "front": (1, 0),
    "back": (1, 1),
    "top": (2, 1),
}
"""Axis of the stock frame and end (0 low, 1 high) of each side."""
LEAST: Final = 15.0 * DEG
"""Tools must rise from the block's side by this angle at least, or they never reach the safe plane."""
DOWN: Final = 2.0 * MM
"""Least way down to a pass and up from it, where the pass begins or ends on the safe plane or beyond it."""
SHARP: Final = 31.0 * DEG
"""The tool stops where its way turns by more than this."""
STILL: Final = 1e-6
"""Moves that are shorter than this [m] have no direction."""
RUN: Final = 2000
"""The tool stops at this many targets of a pass at least, where its way turns most, so that programs can be
split there."""


@dataclasses.dataclass(frozen=True)
class Route:
    """N targets: ``tip``, ``axis`` (N, 3), ``feed`` (N,) [m/s], ``reach`` (N,) [m] as in :class:`Run`,
    ``segment`` and ``stop`` (N,)."""

    tip: FloatArray
    axis: FloatArray
    feed: FloatArray
    reach: FloatArray
    segment: tuple[Segment, ...]
    stop: NDArray[np.bool_]


def lay_out(op: Milling, passes: Sequence[Run], box: FloatArray) -> Route:
    """The route through all passes over the block ``box`` (2, 3) [m]. Tools rise along their own axes to the
    safe plane and go straight on it. Raises ``TandemError`` with ``milling.safe_plane``."""
    tips: list[FloatArray] = []
    axes: list[FloatArray] = []
    feeds: list[FloatArray] = []
    reach: list[float] = []
    segments: list[Segment] = []
    stops: list[NDArray[np.bool_]] = []
    rapid, plunge = op.rapid_mm_s * MM, op.plunge_mm_s * MM
    _refuse_flat(op, passes)
    for number, run in enumerate(passes):
        path, count = run.path, len(run.path)
        start, end = ends(op, run, box)
        tips += [start[None], path.tip, end[None]]
        axes += [path.axis[:1], path.axis, path.axis[-1:]]
        feeds += [np.array([rapid, plunge]), path.feed[1:], np.array([rapid])]
        reach += [0.0, *[run.reach] * count, 0.0]
        into, out = run.first + 1, count - 1 - run.last
        segments += [Segment("approach" if number == 0 else "link")]
        segments += [run.segment.at("in")] * into + [run.segment] * (run.last - run.first)
        segments += [run.segment.at("out")] * (out + 1)
        stops.append(np.concatenate([[True], _stops(path.tip), [True]]))
    # the way up of the last pass goes on as the retreat
    tip, axis = np.concatenate(tips), np.concatenate(axes)
    rise = tip[-1] + op.safe_mm * MM * axis[-1]
    return Route(
        np.concatenate([tip, rise[None]]),
        np.concatenate([axis, axis[-1:]]),
        np.append(np.concatenate(feeds), rapid),
        np.array([*reach, 0.0]),
        (*segments, Segment("retreat")),
        np.append(np.concatenate(stops), True),
    )


def ends(op: Milling, run: Run, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (3,) on the safe plane, or beyond it, from which the tool comes down along its axis to a pass,
    and to which it rises from it."""
    path = run.path
    return _above(op, path.tip[0], path.axis[0], box), _above(op, path.tip[-1], path.axis[-1], box)


def _above(op: Milling, tip: FloatArray, axis: FloatArray, box: FloatArray) -> FloatArray:
    side, end = SIDES[op.safe_side]
    sign = 1.0 if end else -1.0
    level = box[end, side] + sign * op.safe_mm * MM
    return np.asarray(tip + max((level - tip[side]) / float(axis[side]), DOWN) * axis)


def _refuse_flat(op: Milling, passes: Sequence[Run]) -> None:
    """Raises ``TandemError`` with ``milling.safe_plane`` where a pass begins or ends with the tool too flat
    to the safe side; names the sides that would do for all passes."""
    axis = np.stack([run.path.axis[[0, -1]] for run in passes])
    rise = {side: (axis[..., k] if end else -axis[..., k]).min(axis=1) for side, (k, end) in SIDES.items()}
    here = rise[op.safe_side]
    worst = int(np.argmin(here))
    if here[worst] >= np.sin(LEAST):
        return
    lean = float(np.rad2deg(np.arccos(np.clip(here[worst], -1.0, 1.0))))
    good = [
        side
        for side in sorted(SIDES, key=lambda s: -float(rise[s].min()))
        if rise[side].min() >= np.sin(LEAST)
    ]
    raise TandemError(
        Issue(
            "milling.safe_plane",
            f"{passes[worst].name}: the tool stands {lean:.0f} degrees off the {op.safe_side} of the block, "
            f"so that it cannot rise to the safe plane there; allowed are {90.0 - LEAST / DEG:.0f}",
            field="operations.safe_side",
            value=lean,
            limit=90.0 - LEAST / DEG,
            unit="deg",
            hint=f"take safe_side: {' or '.join(good)}"
            if good
            else "no side will do for all cuts: make an operation of each, with a safe_side of its own",
        )
    )


def _stops(tip: FloatArray) -> NDArray[np.bool_]:
    """(N,) where the tool stops: at both ends, at sharp corners, at turns in place, and here and there in
    long passes."""
    out = sharp(tip)
    for first in range(RUN, len(tip) - RUN // 2, RUN):
        if not out[first - RUN // 2 : first + RUN // 2].any():
            out[first] = True
    return out


def sharp(tip: FloatArray) -> NDArray[np.bool_]:
    """(N,) where a tool stops whatever its job: at both ends, at sharp corners, at turns in place."""
    out = np.zeros(len(tip), dtype=bool)
    out[[0, -1]] = True
    step = np.diff(tip, axis=0)
    length = np.linalg.norm(step, axis=1)
    long = np.flatnonzero(length > STILL)
    if len(long) > 1:
        way = step[long] / length[long, None]
        cosine = dots(way[1:], way[:-1])
        out[long[1:][cosine < np.cos(SHARP)]] = True
    moving = length > STILL
    out[1:-1] |= moving[1:] != moving[:-1]  # before and after turns in place
    return out
