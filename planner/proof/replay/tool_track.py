"""The path of a tool through the replayed motion."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse
from planner.proof.context import Context
from planner.proof.replay.motion import during

Spaced = tuple[FloatArray, FloatArray, IntArray]
"""Tips and axes (M, 3) of places on a track, and their rows (M,) of the motion."""
TRACK_LEVER = 0.15
"""A point so far behind the tip [m] counts, with the tip, for the way between places."""
MAX_PLACES_AT_ONCE = 16_384
"""Number of places that are processed at once. It limits memory and does not change results."""
_MOST_BENDS = 64
"""Rounds at most in which places are added at bends, one between two places each."""


@dataclasses.dataclass(frozen=True)
class Track:
    """T places of one arm in some segments, as near to one another as samples are, and on corners:
    ``rows`` (T,) of the motion's samples, the last ones before; ``tip``, ``axis`` (T, 3) [m] of the TCP and
    against its z axis, from tip to spindle, in the block's frame, and ``ahead`` (T, 3) its x axis; ``joined``
    (T - 1,): the tool goes on to the next place; ``node`` (T,) the move under way, of which there are as many
    as ``names`` (K,) of their segments; ``time`` (T,) [s]."""

    rows: IntArray
    tip: FloatArray
    axis: FloatArray
    joined: BoolArray
    node: IntArray
    names: NDArray[np.str_]
    time: FloatArray
    ahead: FloatArray

    @property
    def label(self) -> NDArray[np.str_]:
        """The label (T,) of the move under way; not kept, as there are many places."""
        return self.names[self.node]

    def spaced(self, step: float, bend: float = np.inf) -> Spaced:
        """Tips and axes (M, 3), and rows (M,) of the motion, at places at most ``step`` [m] apart along the
        way of tip and shank, which goes straight between the track's own. Of these there are so many more
        that straight lines between places leave none out by more than ``bend`` [m]: a corner is one."""
        tip, axis, _, rows = self.turned(step, bend)
        return tip, axis, rows

    def turned(
        self, step: float, bend: float = np.inf, lever: float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """As :meth:`spaced`, with the x axes (M, 3) of the tool before the rows; with a ``lever`` [m] a point
        so far along them counts for the way, too."""
        if not len(self.rows):
            return self.tip, self.axis, self.ahead, self.rows
        points = [self.tip, self.tip + TRACK_LEVER * self.axis]
        if lever > 0.0:
            points.append(self.tip + lever * self.ahead)
        ends = np.stack(points, axis=1)
        way = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)
        along = np.concatenate([[0.0], np.cumsum(np.where(self.joined, way, 0.0))])
        marks = np.arange(0.0, along[-1], step)
        at = np.unique(np.concatenate([marks, along[np.append(True, ~self.joined)], along[-1:]]))
        if np.isfinite(bend):
            at = _with_bends(ends, along, at, bend)
        # where the way is longer than the step from sample to sample, places lie between these
        to = np.clip(np.searchsorted(along, at, side="left"), 0, len(along) - 1)
        back = np.maximum(to - 1, 0)
        span = along[to] - along[back]
        share = np.where(span > 0.0, (at - along[back]) / np.maximum(span, 1e-12), 1.0)[:, None]
        tip = self.tip[back] + share * (self.tip[to] - self.tip[back])
        axis = self.axis[back] + share * (self.axis[to] - self.axis[back])
        ahead = self.ahead[back] + share * (self.ahead[to] - self.ahead[back])
        first = np.flatnonzero(np.append(True, ~self.joined))  # the first of each stretch, as it stands
        tip, axis = np.concatenate([tip, self.tip[first]]), np.concatenate([axis, self.axis[first]])
        ahead = np.concatenate([ahead, self.ahead[first]])
        rows = np.concatenate([self.rows[to], self.rows[first]])
        axis, ahead = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (axis, ahead))
        return tip, axis, ahead, rows


def _with_bends(ends: FloatArray, along: FloatArray, at: FloatArray, bend: float) -> FloatArray:
    """Places ``at`` (M,) on the way ``along`` (T,) of ``ends`` (T, 2, 3), and those of T, one between two
    places in each round, that are farther than ``bend`` [m] off the straight lines between them."""
    left = np.arange(len(along))
    for _ in range(_MOST_BENDS):
        # lines begin behind a jump, where two of T are as far along as each other, and end before one
        low = np.clip(np.searchsorted(along, at[:-1], side="right") - 1, 0, len(along) - 2)
        high = np.clip(np.searchsorted(along, at[1:], side="left"), 1, len(along) - 1)
        start = _between(ends, along, low, at[:-1])
        line = _between(ends, along, high - 1, at[1:]) - start
        own = np.searchsorted(at, along[left], side="left") - 1
        inner = (own >= 0) & (along[left] < at[np.minimum(own + 1, len(at) - 1)])
        left, own = left[inner], own[inner]
        off = ends[left] - start[own]
        share = (off * line[own]).sum(axis=2) / np.maximum((line[own] ** 2).sum(axis=2), 1e-24)
        apart = np.linalg.norm(off - np.clip(share, 0.0, 1.0)[..., None] * line[own], axis=2).max(axis=1)
        far = np.isin(own, own[apart > bend])
        left, own, apart = left[far], own[far], apart[far]
        if not len(left):
            return at
        order = np.lexsort((apart, own))
        worst = order[np.append(np.diff(own[order]) > 0, True)]
        at = np.union1d(at, along[left[worst]])
    return at


def _between(ends: FloatArray, along: FloatArray, low: IntArray, at: FloatArray) -> FloatArray:
    """Ends (M, 2, 3) at places ``at`` (M,) of the way between its places ``low`` (M,) and the next ones."""
    share = (at - along[low]) / np.maximum(along[low + 1] - along[low], 1e-12)
    share = np.clip(share, 0.0, 1.0)[:, None, None]
    return np.asarray(ends[low] + share * (ends[low + 1] - ends[low]))


def track_of(context: Context, index: int, arm: str, labels: tuple[str, ...]) -> Track:
    """Find the track of ``arm`` in setup ``index`` on moves of segments with these keys."""
    motion = context.motion
    names, looks = motion.node_label, motion.looks
    chosen = np.isin(names, labels)[looks.node] & (context.sample_setup[looks.sample] == index)
    rows = np.flatnonzero(during(chosen)) if arm in motion.tcp else np.zeros(0, dtype=np.int64)
    tip, axis, ahead = np.empty((3, len(rows), 3))
    for part, seen in tcp_in_stock(context, index, arm, rows):
        tip[part], axis[part], ahead[part] = seen[:, :3, 3], -seen[:, :3, 2], seen[:, :3, 0]
    joined = (np.diff(rows) == 1) & chosen[rows[1:]]
    node, time = looks.node[rows], looks.time[rows]
    return Track(looks.sample[rows], tip, axis, joined, node, names, time, ahead)


def tcp_in_stock(
    context: Context, index: int, arm: str, rows: IntArray
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield poses (M, 4, 4) of the TCP in the block's frame at ``rows`` of the looks, part by part.

    All poses of a long job would need more memory than the rest of the proof.
    """
    for first in range(0, len(rows), MAX_PLACES_AT_ONCE):
        part = slice(first, first + MAX_PLACES_AT_ONCE)
        own = context.motion.looks.row[rows[part]]
        yield part, inverse(context.stock_poses(index, own)) @ context.motion.poses(arm, own)
