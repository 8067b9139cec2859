"""Check that the planned timing moves the wire through foam at its minimum feed.

A slower wire burns the foam.
"""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.hotwire.plan.operation import ElasticWire, Straight
from planner.targets import Targets

MIN_FEED_FRACTION: Final = 0.97
"""Smallest accepted ratio of a move's mean speed to the minimum feed.

It is below 1 because the wire slows down on parts of a move, such as corners.
"""
SUGGESTED_FEED_FRACTION: Final = 0.9
"""Fraction of the slowest move's speed that the hint suggests as a new minimum feed."""


def check_min_feed(op: Straight | ElasticWire, targets: Targets, time: FloatArray) -> Iterator[Issue]:
    """Yield ``motion.feed_min`` if the mean speed of a move in foam is below the operation's minimum feed.

    The issue names the move with the smallest ratio and counts the others.

    Args:
        op: Operation with a hot wire.
        targets: Its N targets.
        time: Time (N,) [s] at which each target is reached.
    """
    # index k below is the move to target k + 1
    speed = targets.travel[1:] / np.maximum(np.diff(time), 1e-9)
    has_min_feed = targets.feed_min[1:] > 0.0
    if not has_min_feed.any():
        return
    fraction = np.where(has_min_feed, speed / np.where(has_min_feed, targets.feed_min[1:], 1.0), np.inf)
    slowest = int(np.argmin(fraction))
    if fraction[slowest] >= MIN_FEED_FRACTION:
        return
    actual, required = float(speed[slowest]) / MM, float(targets.feed_min[slowest + 1]) / MM
    suggested = math.floor(10.0 * SUGGESTED_FEED_FRACTION * actual) / 10.0
    count = int(np.count_nonzero(fraction < MIN_FEED_FRACTION))
    other_moves = f", and on {count - 1} more," if count > 1 else ""
    yield Issue(
        "motion.feed_min",
        f"{op.name}: on the move to {targets.name(slowest + 1)}{other_moves} the joint limits at corners and "
        f"rotations hold the wire at {actual:.3g} mm/s, required in foam are at least {required:g} mm/s",
        field="operations.feed_min_mm_s",
        index=slowest + 1,
        target=targets.name(slowest + 1),
        hint=f"set feed_min_mm_s: {suggested:g}, which the arms reach, or a lower feed_mm_s, or round the "
        "corners more (a larger shape_tol_mm does this too)",
        **measurement(actual, required, "mm/s"),
    )
