"""Where milling tools are while they mill: tips and axes in the block's frame, as few places of the replay as
the motion between them allows."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.claims_milling import MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.geometry.rigid import inverse
from planner.problem import Stock
from planner.segments import Segment
from planner.tooling import Cutter, Mill
from planner.verify.context import Context
from planner.verify.mill_follow import Followed, follow, looks
from planner.verify.mill_ways import down, up
from planner.verify.speed import during

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Spaced = tuple[FloatArray, FloatArray, IntArray]
"""Tips and axes (M, 3) of places on a track, and their rows (M,) of the motion."""

LEVER = 0.15
"""A point so far behind the tip [m] counts, with the tip, for the way between places."""


@dataclasses.dataclass(frozen=True)
class Track:
    """T samples of one arm in some segments: ``rows`` (T,) of the motion, ``tip``, ``axis`` (T, 3) [m] of the
    TCP and against its z axis, from tip to spindle, in the block's frame; ``joined`` (T - 1,): the next row
    is the next sample; ``label`` (T,) of the move under way."""

    rows: IntArray
    tip: FloatArray
    axis: FloatArray
    joined: BoolArray
    label: NDArray[np.str_]

    def spaced(self, step: float) -> Spaced:
        """Tips and axes (M, 3), and rows (M,) of the motion, at places at most ``step`` [m] apart along the
        way of tip and shank, which goes straight between samples."""
        if not len(self.rows):
            return self.tip, self.axis, self.rows
        ends = np.stack([self.tip, self.tip + LEVER * self.axis], axis=1)
        way = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)
        along = np.concatenate([[0.0], np.cumsum(np.where(self.joined, way, 0.0))])
        marks = np.arange(0.0, along[-1], step)
        at = np.unique(np.concatenate([marks, along[np.append(True, ~self.joined)], along[-1:]]))
        # where the way is longer than the step from sample to sample, places lie between these
        to = np.clip(np.searchsorted(along, at, side="left"), 0, len(along) - 1)
        back = np.maximum(to - 1, 0)
        span = along[to] - along[back]
        share = np.where(span > 0.0, (at - along[back]) / np.maximum(span, 1e-12), 1.0)[:, None]
        tip = self.tip[back] + share * (self.tip[to] - self.tip[back])
        axis = self.axis[back] + share * (self.axis[to] - self.axis[back])
        first = np.flatnonzero(np.append(True, ~self.joined))  # the first of each stretch, as it stands
        tip, axis = np.concatenate([tip, self.tip[first]]), np.concatenate([axis, self.axis[first]])
        rows = np.concatenate([self.rows[to], self.rows[first]])
        return tip, axis / np.linalg.norm(axis, axis=1, keepdims=True), rows


def in_block(track: Track, length: float, radius: float, stock: Stock) -> NDArray[np.bool_]:
    """(T,) whether a cutter, as a row of balls along its axis, is in the block."""
    out = np.zeros(len(track.rows), dtype=bool)
    for back in np.append(np.arange(0.0, length, max(radius, 1e-3)), length):
        at = track.tip + back * track.axis
        beyond = np.maximum(np.maximum(stock.lower - at, at - stock.upper), 0.0)
        # the first ball is the tip's end, a disk: less than its radius counts there
        near = 1e-6 if back == 0.0 else radius
        out |= np.linalg.norm(beyond, axis=1) < min(near, radius) - 1e-9
    return out


class Milling:
    """The milling of one proof: its claims by setup, and tracks worked out when asked."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.by_setup: tuple[
            tuple[int, MillsSurface | MillsAlong | MillsFlank | MillsOver | SparesPart], ...
        ] = tuple(
            (index, claim)
            for index, setup in enumerate(context.setup_claims)
            for group in setup.groups
            for claim in group
            if isinstance(claim, MillsSurface | MillsAlong | MillsFlank | MillsOver | SparesPart)
        )
        self._tracks: dict[tuple[int, str, tuple[str, ...]], Track] = {}
        self._spaced: dict[tuple[int, str, tuple[str, ...], float], Spaced] = {}
        self._followed: dict[tuple[int, int], tuple[IntArray, Followed]] = {}

    @property
    def surfaces(self) -> tuple[tuple[int, MillsSurface], ...]:
        """Surfaces that are milled."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsSurface))

    @property
    def curves(self) -> tuple[tuple[int, MillsAlong], ...]:
        """Curves that tips follow; among them the ways to passes over faces and from them, straight along the
        axis from the safe plane to wherever these begin and end."""
        own = [(i, self._said(i, claim)) for i, claim in self.by_setup if isinstance(claim, MillsAlong)]
        return (*own, *self._over_ways)

    def _said(self, index: int, claim: MillsAlong) -> MillsAlong:
        """The claim, or where either way will do, that for the way that its tool goes."""
        track = self.track(index, claim.arm, (claim.segment.key,)) if claim.back else None
        if claim.back is None or track is None or not len(track.rows):
            return claim
        seen = track.tip[[0, -1]]
        apart = [np.linalg.norm(own.tip[[0, -1]] - seen, axis=1).sum() for own in (claim, claim.back)]
        return claim if apart[0] <= apart[1] else claim.back

    @cached_property
    def _over_ways(self) -> tuple[tuple[int, MillsAlong], ...]:
        out: list[tuple[int, MillsAlong]] = []
        for index, claim in self.over:
            for segment in claim.segments:
                track = self.track(index, claim.arm, (segment.key,))
                for way, row in ((down, 0), (up, -1)) if len(track.rows) else ():
                    ends, bounds = (track.tip[row], track.axis[row]), (claim.tolerance, claim.turn)
                    out.append((index, way(claim.safe, segment, claim.arm, *ends, *bounds)))
        return tuple(out)

    @property
    def over(self) -> tuple[tuple[int, MillsOver], ...]:
        """Faces that the ends of cutters pass over."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsOver))

    @property
    def flanks(self) -> tuple[tuple[int, MillsFlank], ...]:
        """Ruled surfaces that cutters pass with their sides."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsFlank))

    @property
    def spared(self) -> tuple[tuple[int, SparesPart], ...]:
        """Faces that tools must not go into."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, SparesPart))

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of all moves in which a face is spared, a surface made or a curve followed."""
        names: list[Segment] = []
        for _, claim in self.by_setup:
            names += (claim.segment,) if isinstance(claim, MillsAlong) else claim.segments
        return frozenset(way.key for name in names for way in name.ways)

    def mounted(self, index: int, arm: str) -> Cutter | None:
        """The cutter of the tool on ``arm`` in setup ``index``."""
        tool = self.context.setups[index].cell.arm(arm).tool
        return tool.cutter if isinstance(tool, Mill) else None

    def track(self, index: int, arm: str, labels: tuple[str, ...]) -> Track:
        """The track of ``arm`` in setup ``index`` on moves of segments with these keys."""
        key = (index, arm, labels)
        if key not in self._tracks:
            self._tracks[key] = self._track(*key)
        return self._tracks[key]

    def followed(self, index: int, claim: MillsAlong) -> tuple[IntArray, Followed] | None:
        """How the claimed way is followed at those samples of its track whose rows come first; None where the
        track has none."""
        key = (index, id(claim))  # claims live as long as this does
        track = self.track(index, claim.arm, (claim.segment.key,))
        if key not in self._followed and len(track.rows):
            some = looks(track.tip, track.axis, claim.tolerance)
            self._followed[key] = some, follow(claim, track.tip[some], track.axis[some])
        return self._followed.get(key)

    def spaced(self, index: int, arm: str, labels: tuple[str, ...], step: float) -> Spaced:
        """Places along :meth:`track`, as :meth:`Track.spaced` has them: each face is held against them."""
        key = (index, arm, labels, step)
        if key not in self._spaced:
            self._spaced[key] = self.track(index, arm, labels).spaced(step)
        return self._spaced[key]

    def _track(self, index: int, arm: str, labels: tuple[str, ...]) -> Track:
        context, motion = self.context, self.context.motion
        names = motion.node_label
        chosen = np.isin(names, labels)[motion.node] & (context.sample_setup == index)
        rows = np.flatnonzero(during(chosen))
        if arm not in motion.tcp or not len(rows):
            none = np.zeros((0, 3))
            return Track(rows[:0], none, none, np.zeros(0, bool), np.zeros(0, "<U1"))
        poses, node = motion.tcp[arm][rows], motion.node[rows]
        # a segment that begins from rest begins at the written target; samples may miss that moment
        rests = ~chosen[rows] & motion.node_stop[node] & np.isfinite(motion.node_tcp[arm][node, 0, 0])
        poses[rests] = motion.node_tcp[arm][node[rests]]
        seen = inverse(context.stock_poses(index, rows)) @ poses
        joined = (np.diff(rows) == 1) & chosen[rows[1:]]
        return Track(rows, seen[:, :3, 3], -seen[:, :3, 2], joined, names[motion.node[rows]])
