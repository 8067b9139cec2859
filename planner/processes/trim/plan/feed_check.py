"""Feeds of a tool in its slots: the mean feed of moves, and slots in which the timing is too slow."""

from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.trim.plan.cutting import CuttingTool
from planner.processes.trim.plan.operation import Trim
from planner.processes.trim.plan.route import TRIM
from planner.targets import Targets

MEAN_FEED_FRACTION: Final = 0.66
"""Mean speed of moves from or to a stop, as a fraction of the feed."""
KNIFE_FEED_FRACTIONS: Final = (0.56, 0.8)
"""Mean speed of a knife's moves from or to a stop, and of those next to them, as a fraction of the feed."""
LINGER_FACTOR: Final = 2.5
"""Factor by which a torch may be slower on a short stretch than its minimum average feed.

The proof allows more.
"""
LINGER_TIME_S: Final = 0.4
"""Duration for which the torch may additionally stop on a short stretch [s]."""
LINGER_KERF_FACTOR: Final = 3.0
"""Length of a short stretch, in kerfs."""
MIN_STRETCH_M: Final = 3.0 * MM
"""Minimum length of a short stretch [m]."""


def mean_feed_fractions(stop: BoolArray, tool: CuttingTool) -> FloatArray:
    """Return the mean speeds (N,) of the moves to N targets as fractions of their feeds.

    Moves from or to a stop are slower on average. Stretches of a knife may be short, so moves adjacent to
    those are slower, too.

    Args:
        stop: Whether the tool stops at each target (N,).
        tool: How the tool cuts.
    """
    is_at_rest = np.append(False, stop[:-1]) | stop
    if tool.blade is None:
        return np.where(is_at_rest, MEAN_FEED_FRACTION, 1.0)
    is_adjacent = is_at_rest | np.append(False, is_at_rest[:-1]) | np.append(is_at_rest[1:], False)
    return np.where(is_at_rest, KNIFE_FEED_FRACTIONS[0], np.where(is_adjacent, KNIFE_FEED_FRACTIONS[1], 1.0))


def slow_issues(op: Trim, tool: CuttingTool, targets: Targets, time: FloatArray) -> tuple[Issue, ...]:
    """Return issues of slots in which the arm is slower than allowed, from the times of the plan.

    The average feed of a slot is checked, with its leads. With a mill it is checked after the lead-in as
    well. If the average of a torch is sufficient, its short stretches are checked too, because a torch that
    is too slow burns away more than its kerf. A knife has no minimum feed.

    Args:
        op: Operation.
        tool: How the tool cuts.
        targets: Targets of the operation.
        time: Times of the targets (N,) [s].
    """
    out = []
    if tool.blade is not None:
        return ()
    for segment in dict.fromkeys(s for s in targets.segment if s.kind == TRIM and not s.phase):
        in_slot = np.array([s == segment for s in targets.segment])
        # targets have the mean feed of their moves; here the feed itself is needed
        # index k: move to target k, which has a mean feed if the arm stops at its start or at its end
        full_feed = targets.feed / np.where(
            np.append(False, targets.stop[:-1]) | targets.stop, MEAN_FEED_FRACTION, 1.0
        )
        actual = np.diff(time, prepend=time[0])[in_slot]
        ideal = targets.travel[in_slot] / full_feed[in_slot]
        fraction = float(ideal.sum()) / max(float(actual.sum()), 1e-9)
        lengths = targets.travel[in_slot]
        after_lead = np.cumsum(lengths) - lengths > op.lead.length_mm * MM
        if tool.cutter is not None and after_lead.any():  # a fast plunge must not mask a slow cut
            fraction = min(
                fraction, float(ideal[after_lead].sum()) / max(float(actual[after_lead].sum()), 1e-9)
            )
        if fraction < op.least_feed:
            message = f"{segment}: the arm reaches {100 * fraction:.0f} % of the feed on average, required "
            message += f"{100 * op.least_feed:.0f} %"
            hint = f"use a lower feed_mm_s, round the corners, or allow it: least_feed: {0.95 * fraction:.2f}"
            out.append(Issue("trim.slow", message, value=fraction, limit=op.least_feed, hint=hint))
        elif tool.cutter is None:
            out += _linger_issues(op, tool.kerf, segment, targets.travel[in_slot], time, in_slot)
    return tuple(out)


def _linger_length(kerf: float) -> float:
    """Return the length [m] of a short stretch, on which a torch of that kerf [m] must not linger."""
    return max(LINGER_KERF_FACTOR * kerf, MIN_STRETCH_M)


def max_stop_time(op: Trim, kerf: float) -> float:
    """Return the maximum time [s] that a torch may take for a short stretch, and so may stop in one place.

    Args:
        op: Operation.
        kerf: Kerf of the torch [m].
    """
    return LINGER_FACTOR * _linger_length(kerf) / (op.least_feed * op.feed_mm_s * MM) + LINGER_TIME_S


def _linger_issues(
    op: Trim, kerf: float, segment: Segment, travel: FloatArray, time: FloatArray, in_slot: BoolArray
) -> list[Issue]:
    """Return an issue if a torch takes so long for a short stretch that it burns away more than its kerf.

    Stretches start or end at the targets of the slot. ``travel`` (R,) [m] are the lengths of the moves to
    these targets, ``time`` (N,) [s] the times of all targets of the operation. ``in_slot`` (N,) is true for
    the R targets of the slot.
    """
    target_rows = np.flatnonzero(in_slot)
    along = np.append(0.0, np.cumsum(travel))
    clock = time[np.append(target_rows[0] - 1, target_rows)]
    stretch = _linger_length(kerf)
    # stretches from each target on, and those up to each
    start = np.concatenate([along, np.maximum(along - stretch, 0.0)])
    end = np.minimum(start + stretch, along[-1])
    durations = np.interp(end, along, clock) - np.interp(start, along, clock)
    allowed = LINGER_FACTOR * (end - start) / (op.least_feed * op.feed_mm_s * MM) + LINGER_TIME_S
    k = int(np.argmax(durations - allowed))
    if durations[k] <= allowed[k]:
        return []
    message = (
        f"{segment}: the arm takes {durations[k]:.2f} s for {(end[k] - start[k]) / MM:.2f} mm, where the "
    )
    message += f"torch burns away more than its kerf, allowed {allowed[k]:.2f} s"
    hint = "round the corner there, start the slot elsewhere, or use a lower feed_mm_s"
    value, limit = float(durations[k]), float(allowed[k])
    return [Issue("trim.slow", message, value=value, limit=limit, unit="s", hint=hint)]
