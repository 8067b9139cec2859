"""The ways of a cutter from the safe plane to a pass and back, by the problem's numbers: straight along its
own axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims_milling import MillsAlong, SafeWays
from planner.segments import Segment

FloatArray = NDArray[np.float64]

LEAST = 2e-3
"""Least way [m] down to a pass and up from it."""


def down(
    safe: SafeWays,
    segment: Segment,
    arm: str,
    tip: FloatArray,
    axis: FloatArray,
    tolerance: float,
    turn: float,
) -> MillsAlong:
    """The way from the safe plane to where a pass begins, with ``tip`` and ``axis`` (3,)."""
    tips, feed = np.stack([above(safe, tip, axis), tip]), np.full(2, safe.plunge)
    return MillsAlong(segment.at("in"), arm, tips, np.stack([axis, axis]), feed, tolerance, turn)


def up(
    safe: SafeWays,
    segment: Segment,
    arm: str,
    tip: FloatArray,
    axis: FloatArray,
    tolerance: float,
    turn: float,
) -> MillsAlong:
    """The way back to the safe plane from where a pass ends."""
    tips, feed = np.stack([tip, above(safe, tip, axis)]), np.full(2, safe.rapid)
    return MillsAlong(segment.at("out"), arm, tips, np.stack([axis, axis]), feed, tolerance, turn)


def above(safe: SafeWays, tip: FloatArray, axis: FloatArray) -> FloatArray:
    """The place (3,) at which a tool with its tip at ``tip`` (3,) is on the safe plane when it is drawn back
    along its axis; a little way back where that is beyond the plane already."""
    rise = safe.up * float(axis[safe.across])
    gap = safe.up * (safe.level - float(tip[safe.across]))
    return np.asarray(tip + max(gap / max(rise, 1e-6), LEAST) * axis)
