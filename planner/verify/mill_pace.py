"""How fast a tool may be at each place of a way whose feed changes on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims_milling import MillsAlong
from planner.verify.mill_follow import Followed

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ROUND = 2.0
"""Feeds that begin or end so many tolerances ahead or behind count, too: corners are rounded, and where the
tool is on its way is known no better."""


def allowed(claim: MillsAlong, some: IntArray, found: Followed, count: int) -> FloatArray:
    """The feed (T - 1,) [m/s] from each of T samples to the next, of which the rows ``some`` (K,) were put on
    the way: the highest of all stretches that the tool may be on meanwhile."""
    before = np.clip(np.searchsorted(some, np.arange(count - 1), side="right") - 1, 0, len(some) - 1)
    after = np.clip(np.searchsorted(some, np.arange(1, count), side="left"), 0, len(some) - 1)
    near = ROUND * claim.tolerance
    last = len(found.along) - 2
    first = np.searchsorted(found.along, found.at[before] - near, side="right") - 1
    end = np.searchsorted(found.along, found.at[after] + near, side="left") - 1
    first = np.clip(first, 0, last)
    return highest(claim.feed[1:], first, np.clip(end, first, last))


def highest(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """The highest (M,) of the values from each of ``first`` (M,) to ``last`` (M,), both with it; by the
    highest of all stretches of 1, 2, 4 ... values."""
    level = np.floor(np.log2(last - first + 1)).astype(np.int64)
    out, table = np.empty(len(first)), values
    for k in range(int(level.max(initial=0)) + 1):
        rows = np.flatnonzero(level == k)
        out[rows] = np.maximum(table[first[rows]], table[last[rows] - (1 << k) + 1])
        table = np.maximum(table[: -(1 << k) or None], table[1 << k :]) if len(table) > 1 << k else table
    return out
