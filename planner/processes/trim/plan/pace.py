"""How fast a tool goes in its slots: the feed that moves have on average, and where a clock is too slow."""

from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.trim.plan.cutting import Cutting
from planner.processes.trim.plan.operation import Trim
from planner.processes.trim.plan.route import TRIM
from planner.targets import Targets

MEAN_FEED_FROM_REST: Final = 0.66
"""Part of the feed that moves from or to a stop have on average, as they are faster in between."""
KNIFE_FEED: Final = (0.56, 0.8)
"""The same of a knife's moves from or to a stop, and of those beside them."""
LINGER: Final = 2.5
"""On a short stretch a torch may take so many times as long as at its least average feed; the proof allows
more."""
LINGER_TIME: Final = 0.4
"""It may also stop there for so long [s]."""
LINGER_KERFS: Final = 3.0
"""Kerfs that such a stretch is long,"""
LEAST_STRETCH: Final = 3.0 * MM
"""and so long [m] at least."""


def shares(stop: BoolArray, tool: Cutting) -> FloatArray:
    """Shares (N,) of their feeds that moves have on average: less where they come from rest or to it, as they
    are faster in between; of a knife, whose stretches may be short, also those next to them."""
    rest = np.append(False, stop[:-1]) | stop
    if tool.blade is None:
        return np.where(rest, MEAN_FEED_FROM_REST, 1.0)
    near = rest | np.append(False, rest[:-1]) | np.append(rest[1:], False)
    return np.where(rest, KNIFE_FEED[0], np.where(near, KNIFE_FEED[1], 1.0))


def too_slow(op: Trim, tool: Cutting, targets: Targets, time: FloatArray) -> tuple[Issue, ...]:
    """Slots in which the arm is slower on average than the operation allows, at the times (N,) [s] of the
    ``targets``: a torch then burns away more than its kerf."""
    out = []
    if tool.blade is not None:
        return ()  # it may be as slow as it likes
    for segment in dict.fromkeys(s for s in targets.segment if s.kind == TRIM and not s.phase):
        rows = np.array([s == segment for s in targets.segment])
        full = targets.feed / np.where(
            np.append(False, targets.stop[:-1]) | targets.stop, MEAN_FEED_FROM_REST, 1.0
        )
        took, ideal = np.diff(time, prepend=time[0])[rows], targets.travel[rows] / full[rows]
        share = float(ideal.sum()) / max(float(took.sum()), 1e-9)
        way = targets.travel[rows]
        level = np.cumsum(way) - way > op.lead.length_mm * MM
        if tool.cutter is not None and level.any():  # the way down, however quick, is no excuse
            share = min(share, float(ideal[level].sum()) / max(float(took[level].sum()), 1e-9))
        if share < op.least_feed:
            what = f"{segment}: the arm reaches {100 * share:.0f} % of the feed on average; wanted: "
            what += f"{100 * op.least_feed:.0f} %"
            hint = f"take a lower feed_mm_s, round the corners, or allow it: least_feed: {0.95 * share:.2f}"
            out.append(Issue("trim.slow", what, value=share, limit=op.least_feed, hint=hint))
        elif tool.cutter is None:
            out += _lingers(op, tool.kerf, segment, targets.travel[rows], time, rows)
    return tuple(out)


def _stretch(kerf: float) -> float:
    """How long [m] a stretch is on which a torch of that kerf [m] may not stay."""
    return max(LINGER_KERFS * kerf, LEAST_STRETCH)


def stands(op: Trim, kerf: float) -> float:
    """How long [s] a torch may take for such a stretch, and so stand in one place."""
    return LINGER * _stretch(kerf) / (op.least_feed * op.feed_mm_s * MM) + LINGER_TIME


def _lingers(
    op: Trim, kerf: float, segment: Segment, travel: FloatArray, time: FloatArray, rows: BoolArray
) -> list[Issue]:
    """Stretches of a slot, as short as a few kerfs, on which a torch would burn away more than that;
    ``travel`` (R,) [m] on the moves to its targets, which are ``rows`` (N,) of those with ``time`` (N,)."""
    at = np.flatnonzero(rows)
    along, clock = np.append(0.0, np.cumsum(travel)), time[np.append(at[0] - 1, at)]
    stretch = _stretch(kerf)
    # stretches from each target on, and those up to each
    begin = np.concatenate([along, np.maximum(along - stretch, 0.0)])
    end = np.minimum(begin + stretch, along[-1])
    spent = np.interp(end, along, clock) - np.interp(begin, along, clock)
    most = LINGER * (end - begin) / (op.least_feed * op.feed_mm_s * MM) + LINGER_TIME
    k = int(np.argmax(spent - most))
    if spent[k] <= most[k]:
        return []
    what = f"{segment}: the arm takes {spent[k]:.2f} s for {(end[k] - begin[k]) / MM:.2f} mm, where the "
    what += f"torch burns away more than its kerf; allowed: {most[k]:.2f} s"
    hint = "round the corner there, let it begin elsewhere, or take a lower feed_mm_s"
    value, limit = float(spent[k]), float(most[k])
    return [Issue("trim.slow", what, value=value, limit=limit, unit="s", hint=hint)]
