"""Where a cylindrical flank has to stand to make a ruled surface.

Along a ruling of a developable surface the normal is one and the same, and a cylinder touches the
whole of it. A twisted ruling it can only touch in part. Here the cylinder touches both guides, each
from outside at the distance of its radius (as in the two-guide positioning that Redonnet, Rubio and
Dessein describe in "Side milling of ruled surfaces", Int. J. Adv. Manuf. Technol. 14, 1998; worked
out anew). One freedom is left: how far the place on the upper guide is ahead of that on the lower
one. It is chosen so that the largest distance of the cylinder from the surface between the guides
is least.

Rulings come as a flank cutter passes them (`strips`): tip guide and top guide in the order of the
cut, with tangents and outward normals, one smooth piece at a time.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from planner.geometry.arrays import FloatArray, IntArray, Ruled, unit
from planner.geometry.rulings import resample, runs


@dataclasses.dataclass(frozen=True)
class Strip:
    """A smooth piece: ruling i from ``low[i]``, at the tip, to ``high[i]`` (M, 3) [m].

    ``out`` is +1 where the outward normal is tangent x (high - low), else -1. A ``ring`` is a whole closed
    surface without corners: its last ruling is its first one again.
    """

    low: FloatArray
    high: FloatArray
    out: float
    ring: bool = False

    def tangents(self) -> tuple[FloatArray, FloatArray]:
        """Unit tangents (M, 3) of both guides; where one stands still, that of the other."""
        low, high = (np.gradient(side, axis=0) for side in (self.low, self.high))
        sizes = [np.linalg.norm(t, axis=1, keepdims=True) for t in (low, high)]
        still = 1e-3 * np.maximum(*sizes)
        low, high = np.where(sizes[0] > still, low, high), np.where(sizes[1] > still, high, low)
        return unit(low), unit(high)

    def normals(self) -> tuple[FloatArray, FloatArray]:
        """Outward unit normals (M, 3) of the surface at both guides."""
        along = self.high - self.low
        first, second = self.tangents()
        return unit(self.out * np.cross(first, along)), unit(self.out * np.cross(second, along))

    def reversed(self) -> Strip:
        """The same piece the other way."""
        return Strip(self.low[::-1], self.high[::-1], -self.out, self.ring)


def strips(ruled: Ruled, tip_at_start: bool, chord: float, step: float) -> list[Strip]:
    """The smooth pieces of a ruled surface along its guides, rulings at most ``step`` [m] apart."""
    fine = resample(ruled, chord, step)
    ring = fine.closed and not fine.corner.any()
    out = []
    for rows in runs(fine):
        start, end = fine.start[rows], fine.end[rows]
        out.append(Strip(start, end, 1.0, ring) if tip_at_start else Strip(end, start, -1.0, ring))
    return out


RULING_SHARES: Final = np.array([0.1, 0.25, 0.4, 0.6, 0.75, 0.9])
"""Places along a ruling, from the tip guide to the other, at which the cylinder is held against the
surface."""
MOST_AHEAD: Final = 0.8
"""How far a place on the upper guide may be ahead, over the cutter's radius."""
CHOSEN_RULINGS: Final = 72
"""Rulings at which the choice is made; it is smooth between them."""
AHEAD_TRIALS: Final = 9
"""Values of being ahead that are tried at once at each of these rulings."""
AHEAD_ZOOMS: Final = 4
"""So often they are tried, each time between the neighbours of the best one."""
AXIS_ROUNDS: Final = 40
"""Rounds at most in which the axis of a cylinder that touches both guides settles."""
AXIS_SETTLED: Final = 1e-12
"""The axis, a unit vector, has settled where a round changes it by less than this."""
RULING_WINDOW: Final = 20
"""Rulings on either side that are looked at for the place that a cylinder comes nearest to."""
AHEAD_COST: Final = 1e-4
"""What being ahead by a whole radius costs, over the radius: it settles surfaces that leave it open."""
SMOOTHING_RULINGS: Final = 3.0
"""Rulings over which the choice is made smooth."""


def axes(strip: Strip, radius: float) -> tuple[FloatArray, FloatArray]:
    """Places ``low`` and ``high`` (M, 3) [m] on the cutter's axis, opposite of both guides, for a cylinder of
    ``radius`` [m] on the outer side of a strip with evenly spaced rulings."""
    if radius == 0.0:
        return strip.low, strip.high
    longer = _longer(strip)
    ahead = _ahead(longer, radius, strip.ring)
    low, high = _touching(longer, radius, np.arange(len(longer.low)), ahead)
    return low[RULING_WINDOW:-RULING_WINDOW], high[RULING_WINDOW:-RULING_WINDOW]


def deviation(strip: Strip, radius: float, low: FloatArray, high: FloatArray) -> FloatArray:
    """How far (M, K) [m] cylinders about the axes from ``low`` to ``high`` (M, 3) are off the surface at the
    levels: left where positive, cut too deep where negative."""
    at = np.arange(len(strip.low), dtype=np.float64)
    if strip.ring:
        return _off(_longer(strip), radius, low, high, at + RULING_WINDOW)
    return _off(strip, radius, low, high, at)


def _longer(strip: Strip) -> Strip:
    """The strip with ``RULING_WINDOW`` more rulings at both ends, so that what is ahead of the last one is
    there: a ring goes on as it began, others straight."""
    if strip.ring:
        around = len(strip.low) - 1
        rows = np.arange(-RULING_WINDOW, around + 1 + RULING_WINDOW) % around
        return Strip(strip.low[rows], strip.high[rows], strip.out)
    return Strip(_on(strip.low), _on(strip.high), strip.out)


def _on(side: FloatArray) -> FloatArray:
    """A guide (M + 2 RULING_WINDOW, 3) that goes on by ``RULING_WINDOW`` even steps at both ends."""
    more = np.arange(1, RULING_WINDOW + 1)[:, None]
    before, behind = side[0] - side[1], side[-1] - side[-2]
    return np.concatenate([side[0] + more[::-1] * before, side, side[-1] + more * behind])


def _ahead(strip: Strip, radius: float, ring: bool) -> FloatArray:
    """How many rulings (M,) the place on the upper guide is ahead; ``ring``: of the longer strip of one."""
    count = len(strip.low)
    if count < 5:
        return np.zeros(count)
    step = float(np.median(np.linalg.norm(np.diff(strip.high, axis=0), axis=1)))
    most = min(MOST_AHEAD * radius / max(step, 1e-9), RULING_WINDOW - 2.0)
    edge = RULING_WINDOW if ring else 0
    rows = np.unique(np.linspace(edge, count - 1 - edge, min(count, CHOSEN_RULINGS)).astype(np.int64))
    best, width = np.zeros(len(rows)), most
    for _ in range(AHEAD_ZOOMS):
        tried = best[:, None] + np.linspace(-width, width, AHEAD_TRIALS)
        tried = np.clip(tried, -most, most)
        which, ahead = np.repeat(rows, AHEAD_TRIALS), tried.ravel()
        low, high = _touching(strip, radius, which, ahead)
        worst = np.abs(_off(strip, radius, low, high, which + 0.5 * ahead)).max(axis=1)
        cost = worst.reshape(tried.shape) + AHEAD_COST * radius * np.square(tried * step / radius)
        best = tried[np.arange(len(rows)), cost.argmin(axis=1)]
        width *= 2.0 / (AHEAD_TRIALS - 1)
    spread = np.interp(np.arange(count), rows, best)
    # the guides end: what is ahead of the last ruling is not there
    room = np.minimum(np.arange(count), np.arange(count)[::-1]).astype(np.float64)
    if ring:
        spread = gaussian_filter1d(spread[RULING_WINDOW : -RULING_WINDOW - 1], SMOOTHING_RULINGS, mode="wrap")
        spread = spread[np.arange(-RULING_WINDOW, count - RULING_WINDOW) % len(spread)]
    else:
        spread = gaussian_filter1d(spread, SMOOTHING_RULINGS, mode="nearest")
    return np.asarray(np.clip(spread, -room, room))


def _touching(
    strip: Strip, radius: float, rows: IntArray, ahead: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The axes (N, 3) of cylinders that touch the lower guide at rulings ``rows`` and the upper one ``ahead``
    (N,) rulings farther on."""
    first, second = strip.tangents()
    below, tangent = strip.low[rows], first[rows]
    at = np.clip(rows + ahead, 0, len(strip.low) - 1)
    above, along = _at(strip.high, at), unit(_at(second, at))
    way = unit(above - below)
    for _ in range(AXIS_ROUNDS):
        low = below + radius * unit(strip.out * np.cross(tangent, way))
        high = above + radius * unit(strip.out * np.cross(along, way))
        fresh = unit(high - low)
        moved = float(np.abs(fresh - way).max(initial=0.0))
        way = fresh
        if moved < AXIS_SETTLED:
            break
    return low, high


def _off(strip: Strip, radius: float, low: FloatArray, high: FloatArray, about: FloatArray) -> FloatArray:
    """How far (N, K) [m] the surface's lines at the levels stay off cylinders near rulings ``about`` (N,)."""
    centre = np.clip(np.round(about).astype(np.int64), 0, len(strip.low) - 1)
    rows = np.clip(centre[:, None] + np.arange(-RULING_WINDOW, RULING_WINDOW + 1), 0, len(strip.low) - 1)
    way = unit(high - low)
    out = np.empty((len(low), len(RULING_SHARES)))
    for k, share in enumerate(RULING_SHARES):
        line = (1.0 - share) * strip.low + share * strip.high
        # by coordinate, (3, N, W), which is how so many short vectors are worked out fastest
        rest = np.ascontiguousarray(line.T).take(rows, axis=1) - low.T[..., None]
        rest -= np.einsum("dnw,dn->nw", rest, way.T) * way.T[..., None]
        square = np.einsum("dnw,dnw->nw", rest, rest)
        near = rows[np.arange(len(rows)), square.argmin(axis=1)]
        # beyond the ends of the guides there is no surface that a cylinder could be off
        inside = (near > 0) & (near < len(strip.low) - 1)
        out[:, k] = np.where(inside, _least(square) - radius, 0.0)
    return out


def _least(square: FloatArray) -> FloatArray:
    """Root (N,) of the least of squares (N, W), by the parabola through it and its neighbours."""
    k = np.clip(square.argmin(axis=1), 1, square.shape[1] - 2)
    row = np.arange(len(square))
    a, b, c = square[row, k - 1], square[row, k], square[row, k + 1]
    bend = a - 2.0 * b + c
    low = np.where(bend > 1e-18, b - np.square(a - c) / (8.0 * np.maximum(bend, 1e-18)), b)
    return np.asarray(np.sqrt(np.maximum(np.minimum(low, square.min(axis=1)), 0.0)))


def _at(rows: FloatArray, place: FloatArray) -> FloatArray:
    """Rows (N, 3) at fractional indices ``place`` (N,)."""
    first = np.clip(place.astype(np.int64), 0, len(rows) - 2)
    share = (place - first)[:, None]
    return np.asarray((1.0 - share) * rows[first] + share * rows[first + 1])
