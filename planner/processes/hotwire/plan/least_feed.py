"""Whether the arms drive a wire as fast as it has to be in the foam: one that is slow burns it."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.hotwire.plan.operation import ElasticWire, Straight
from planner.targets import Targets

LEAST_SHARE: Final = 0.97
"""Share of the least feed that a move holds at least as a whole; parts of it are slower, as in corners."""
HINTED_SHARE: Final = 0.9
"""Share of the slowest move's speed that is told as a least feed that would do."""


def check_least(op: Straight | ElasticWire, targets: Targets, time: FloatArray) -> Iterator[Issue]:
    """``motion.feed_min`` for the slowest move at the clock ``time`` (N,) [s], where that is slower than the
    operation lets the wire be in the foam."""
    speed = targets.travel[1:] / np.maximum(np.diff(time), 1e-9)
    asked = targets.feed_min[1:] > 0.0
    if not asked.any():
        return
    share = np.where(asked, speed / np.where(asked, targets.feed_min[1:], 1.0), np.inf)
    k = int(np.argmin(share))
    if share[k] >= LEAST_SHARE:
        return
    got, least = float(speed[k]) / MM, float(targets.feed_min[k + 1]) / MM
    held = math.floor(10.0 * HINTED_SHARE * got) / 10.0
    count = int(np.count_nonzero(share < LEAST_SHARE))
    more = f", as {count - 1} more do" if count > 1 else ""
    yield Issue(
        "motion.feed_min",
        f"{op.name}: the arms drive the wire at {got:.3g} mm/s on the move to {targets.name(k + 1)}{more}, "
        "which is as fast as they may at corners and in turns; in the foam "
        f"{least:g} mm/s at least are asked",
        field="operations.feed_min_mm_s",
        index=k + 1,
        target=targets.name(k + 1),
        hint=f"feed_min_mm_s: {held:g}, which they hold; or a lower feed_mm_s, a larger shape_tol_mm, which "
        "rounds corners more, or rounder corners",
        **measurement(got, least, "mm/s"),
    )
