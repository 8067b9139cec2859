"""How a tool follows a way of tips and axes: in order, also where the way crosses itself, goes back on
itself, or turns the tool in place."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.claims import MillsAlong

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEVER = 0.05
"""What a turn of the axis by one radian counts as, against ways of the tip [m]."""
AHEAD = 0.05
"""How far ahead on its way [m] a tool is looked for."""


@dataclasses.dataclass(frozen=True)
class Followed:
    """Of T samples: how far the tip is ``off`` its way (T,) [m] and the axis ``turn`` (T,) [rad] off the one
    that is wanted there; ``missed``: how many places of the way no sample and no move between two passes."""

    off: FloatArray
    turn: FloatArray
    missed: int


def follow(claim: MillsAlong, tip: FloatArray, axis: FloatArray) -> Followed:
    """How the samples ``tip``, ``axis`` (T, 3) follow the claimed way.

    Each sample is put on the first stretch of the way from where the sample before is that it keeps the
    tolerances to, or as far along the stretches that follow as it keeps them without a break and nears the
    way. One that keeps them to none counts by the nearest, and the next goes on from where this one began.
    Every place that is passed over must be near the move between both samples.
    """
    way = _Way(claim)
    count = len(tip)
    off, turn = np.empty(count), np.empty(count)
    stretch, share = 0, 0.0
    missed = way.skipped(tip[:1], axis[:1], -1, 0, _step(tip[:2], axis[:2]))
    for i in range(count):
        shares, apart, angle = way.near(tip[i], axis[i], stretch, share)
        cost = way.cost(apart, angle)
        k = int((cost <= 1.0).argmax())
        if cost[k] > 1.0:
            k = int(cost.argmin())
            off[i], turn[i] = apart[k], angle[k]
            continue
        k = way.onward(tip[i], axis[i], stretch, k, cost)
        off[i], turn[i] = apart[k], angle[k]
        pair = [max(i - 1, 0), i]
        missed += way.skipped(tip[pair], axis[pair], stretch, stretch + k)
        stretch, share = stretch + k, float(shares[k])
    missed += way.skipped(tip[-1:], axis[-1:], stretch, len(way.step), _step(tip[-2:], axis[-2:]))
    return Followed(off, turn, missed)


def looks(tip: FloatArray, axis: FloatArray, tolerance: float) -> IntArray:
    """Rows (K,) of samples (T, 3) at which a way is held against what is claimed: all that are two tolerances
    [m] apart, and both ends. Between them a tool goes no farther off than by one more."""
    if len(tip) < 2:
        return np.arange(len(tip))
    ways = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    ways = np.maximum(ways, LEVER * np.linalg.norm(np.diff(axis, axis=0), axis=1))
    number = np.floor(np.append(0.0, np.cumsum(ways)) / (2.0 * tolerance))
    # the first sample behind each mark; the last one before it, too, where the next is farther on than that
    marks = np.diff(number)
    return np.flatnonzero(np.append(True, marks > 0.0) | np.append(marks > 1.0, True))


def _step(tip: FloatArray, axis: FloatArray) -> float:
    """Way [m] between two samples, by tip or by lever."""
    ways = np.linalg.norm(tip[-1] - tip[0]), LEVER * np.linalg.norm(axis[-1] - axis[0])
    return float(max(ways))


class _Way:
    """A claimed way as stretches from place to place, along which the tip goes straight and the axis turns
    evenly by the shortest turn."""

    def __init__(self, claim: MillsAlong) -> None:
        self.claim = claim
        self.tip, self.axis = claim.tip, claim.axis
        self.step = np.diff(claim.tip, axis=0)
        self.lean = np.diff(claim.axis, axis=0)
        self.square = np.maximum((self.step * self.step).sum(axis=1), 1e-24)
        self.leant = np.maximum((self.lean * self.lean).sum(axis=1), 1e-24)
        self.angle = 2.0 * np.arcsin(np.clip(0.5 * np.sqrt(self.leant), 0.0, 1.0))
        length = np.sqrt(self.square + LEVER**2 * self.leant)
        self.along = np.concatenate([[0.0], np.cumsum(length)])

    def near(
        self, tip: FloatArray, axis: FloatArray, stretch: int, share: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of stretches from ``stretch`` on: where a sample is nearest to each, as a share of it, not before
        ``share`` of the first; how far tip [m] and axis [rad] are off there.

        It is looked for by the tip and by the axis, of which one may stand still; the better one counts.
        """
        here = self.along[stretch] + share * (self.along[stretch + 1] - self.along[stretch])
        end = int(np.searchsorted(self.along, here + AHEAD + 20.0 * self.claim.tolerance))
        part = slice(stretch, min(max(end, stretch + 1), len(self.step)))
        by_tip = ((tip - self.tip[:-1][part]) * self.step[part]).sum(axis=1) / self.square[part]
        chord = ((axis - self.axis[:-1][part]) * self.lean[part]).sum(axis=1) / self.leant[part]
        half = np.maximum(0.5 * self.angle[part], 1e-12)
        by_axis = 0.5 + 0.5 * np.arcsin((2.0 * np.clip(chord, 0.0, 1.0) - 1.0) * np.sin(half)) / half
        found = []
        for guess in (by_tip, by_axis):
            at = np.clip(guess, 0.0, 1.0)
            at[0] = max(at[0], share)
            found.append((at, *self._off(tip, axis, part, at)))
        (at, apart, angle), (other, beside, turned) = found
        better = self.cost(beside, turned) < self.cost(apart, angle)
        return (
            np.where(better, other, at),
            np.where(better, beside, apart),
            np.where(better, turned, angle),
        )

    def cost(self, apart: FloatArray, angle: FloatArray) -> FloatArray:
        """How far off, of what is allowed."""
        return np.asarray(np.maximum(apart / self.claim.tolerance, angle / self.claim.turn))

    def onward(self, tip: FloatArray, axis: FloatArray, stretch: int, first: int, cost: FloatArray) -> int:
        """The nearest stretch among those from ``first`` on that keep the tolerances, as do all places
        between them; of equal ones the first."""
        if first + 1 >= len(cost) or cost[first + 1] > 1.0:
            return first
        ends = slice(stretch + first + 1, stretch + len(cost))
        between = self.cost(*_apart(tip, axis, self.tip[ends], self.axis[ends]))
        kept = (cost[first + 1 :] <= 1.0) & (between <= 1.0)
        last = first + (int(np.argmin(kept)) if not kept.all() else len(kept))
        some = cost[first : last + 1]
        return first + int((some <= some.min() + 1e-6).argmax())

    def skipped(self, tip: FloatArray, axis: FloatArray, before: int, after: int, slack: float = 0.0) -> int:
        """How many of the places behind ``before`` up to ``after`` the move between samples (2, 3), or one
        sample (1, 3), does not come near to; ``slack`` [m] more is allowed."""
        places, axes = self.tip[before + 1 : after + 1], self.axis[before + 1 : after + 1]
        if not len(places):
            return 0
        way = tip[-1] - tip[0]
        share = np.clip((places - tip[0]) @ way / max(float(way @ way), 1e-24), 0.0, 1.0)
        apart = np.linalg.norm(tip[0] + share[:, None] * way - places, axis=1)
        turned = np.minimum(*(_apart(tip[i], axis[i], places, axes)[1] for i in (0, -1)))
        own = float(_apart(tip[0], axis[0], tip[-1:], axis[-1:])[1][0])
        allowed = 2.0 * self.claim.turn + own + slack / LEVER
        return int(((apart > 2.0 * self.claim.tolerance + slack) | (turned > allowed)).sum())

    def _off(
        self, tip: FloatArray, axis: FloatArray, part: slice, share: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """How far [m] and [rad] a sample is off the places at ``share`` of stretches."""
        angle = np.maximum(self.angle[part], 1e-9)
        first, last = np.sin((1.0 - share) * angle) / np.sin(angle), np.sin(share * angle) / np.sin(angle)
        wanted = first[:, None] * self.axis[:-1][part] + last[:, None] * self.axis[1:][part]
        return _apart(tip, axis, self.tip[:-1][part] + share[:, None] * self.step[part], wanted)


def _apart(
    tip: FloatArray, axis: FloatArray, tips: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far [m] and [rad] a sample is off places (K, 3) and axes (K, 3); angles by the chord, which is
    exact for small ones too."""
    chord = np.linalg.norm(axes - axis, axis=1)
    return np.linalg.norm(tips - tip, axis=1), 2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))
