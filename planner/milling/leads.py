"""Ways in and out of a cut: straight on until the cutter is off the block, and round convex corners."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ROUND: Final = np.deg2rad(5.0)
"""Turn of the cutter about a corner from target to target."""
PIECES: Final = 6
"""Targets of a way in or out on which the tool still turns."""
TURNS_ON: Final = np.deg2rad(10.0)
"""How far a tool turns on along a way in or out at most."""
FARTHEST: Final = 5.0
"""A way that is not off the block after so much [m] never is."""


def off_block(ends: FloatArray, way: FloatArray, box: FloatArray, clear: float) -> float:
    """How far [m] a cutter has to go along the unit vector ``way`` (3,) until all its ``ends`` (K, 3) are
    ``clear`` [m] beyond one side of the block ``box`` (2, 3)."""
    best = FARTHEST
    for axis in range(3):
        if way[axis] > 1e-6:
            best = min(best, (box[1, axis] + clear - float(ends[:, axis].min())) / way[axis])
        elif way[axis] < -1e-6:
            best = min(best, (float(ends[:, axis].max()) - box[0, axis] + clear) / -way[axis])
    return max(best, 0.0)


def beyond(
    low: FloatArray, high: FloatArray, low_way: FloatArray, high_way: FloatArray, length: float
) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) each, on from an axis ``low`` to ``high`` (3,) whose ends move by ``low_way`` and
    ``high_way`` (3,) at once, by ``length`` [m]: first as the surface would go on, so that the tool
    does not stop turning at once, then more and more straight."""
    scale = max(float(np.linalg.norm(low_way)), float(np.linalg.norm(high_way)), 1e-12)
    straight = 0.5 * (low_way + high_way) / scale
    turn = 0.5 * (high_way - low_way) / scale
    whole = length / max(float(np.linalg.norm(straight)), 0.1)
    rate = float(np.linalg.norm(turn)) * 2.0 / max(float(np.linalg.norm(high - low)), 1e-9)
    during = min(whole, 2.0 * TURNS_ON / max(rate, 1e-9))
    at = np.unique(np.append(np.linspace(0.0, during, PIECES + 1), whole))[:, None]
    slowing = np.where(at < during, at - at * at / (2.0 * during), 0.5 * during)
    return low + at * straight - slowing * turn, high + at * straight + slowing * turn


def round_corner(
    foot: tuple[FloatArray, FloatArray],
    before: tuple[FloatArray, FloatArray],
    after: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) each between ``before`` and ``after`` [(3,), (3,)], at the same distances from the corner's
    ruling ``foot`` [(3,), (3,)], both ends left out."""
    sides = []
    turns = []
    for at, one, two in zip(foot, before, after, strict=True):
        a, b = one - at, two - at
        turns.append(
            float(
                np.arccos(
                    np.clip(a @ b / max(float(np.linalg.norm(a)) * float(np.linalg.norm(b)), 1e-18), -1, 1)
                )
            )
        )
    count = max(int(np.ceil(max(turns) / ROUND)), 1)
    share = np.arange(1, count)[:, None] / count
    for at, one, two, turn in zip(foot, before, after, turns, strict=True):
        a, b = one - at, two - at
        if turn < 1e-9:
            sides.append(at + (1.0 - share) * a + share * b)
        else:
            sides.append(at + (np.sin((1.0 - share) * turn) * a + np.sin(share * turn) * b) / np.sin(turn))
    return sides[0], sides[1]
