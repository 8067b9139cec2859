"""Whether points are inside the head of a tool anywhere along its way."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.vectors import dots, lengths

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

LOOKED = 0.001
"""Where bounds do not settle it, tools are looked at at least whenever they have moved half as far [m]."""
ROUGH = 0.02
"""Bounds by the nearest place may be too near by this share."""
_BLOCK = 128
_QUERIES = 2000


@dataclasses.dataclass(frozen=True)
class HeadWay:
    """Where a head is looked at: at ``rows`` (R,) of its track, with ``centre``, ``axis`` (R, 3) there, and
    what it is held against has risen by ``rise`` (R,) [m].

    ``slide`` (R,) [m] and ``turn`` (R,) [rad] are how far the TCP has gone, past what rises, and the axis has
    turned until then: a place ``back`` [m] behind the TCP goes by no more than slide and back times turn.
    """

    rows: IntArray
    centre: FloatArray
    axis: FloatArray
    rise: FloatArray
    slide: FloatArray
    turn: FloatArray

    @staticmethod
    def of(centre: FloatArray, axis: FloatArray, rise: FloatArray, back: float) -> HeadWay:
        """Of rows (T, ...), those between which nothing up to ``back`` [m] behind the TCP goes farther than
        half of ``LOOKED``, or single steps that are longer."""
        slide = np.concatenate([[0.0], np.cumsum(lengths(np.diff(centre, axis=0)) + np.abs(np.diff(rise)))])
        turn = np.concatenate([[0.0], np.cumsum(lengths(np.diff(axis, axis=0)))])
        number = np.floor((slide + back * turn) / (0.5 * LOOKED))
        rows = np.flatnonzero(np.diff(number, prepend=-1.0, append=np.inf)[:-1] != 0)
        return HeadWay(rows, centre[rows], axis[rows], rise[rows], slide[rows], turn[rows])

    def places(self, some: IntArray, back: float) -> FloatArray:
        """Places (M, 3) on the axis ``back`` [m] behind the TCP at some of the rows, as seen from what
        rises."""
        out = self.centre[some] - back * self.axis[some]
        out[:, 2] -= self.rise[some]
        return out

    def past(self, some: IntArray, back: float, size: float, height: tuple[float, float]) -> FloatArray:
        """How far (M,) [m] behind the TCP points between two heights z [m] can be at most at some of the
        rows, of those within ``size`` [m] of the place ``back`` behind it. What is behind the front of a head
        by so much is no deeper in it: a disk on a flat sheet has nothing of it inside."""
        axis, place = self.axis[some], self.places(some, back)
        low, high = (np.clip(z - place[:, 2], -size, size) for z in height)
        aside = size * np.hypot(axis[:, 0], axis[:, 1])
        return np.asarray(back + aside - np.minimum(low * axis[:, 2], high * axis[:, 2]))


@dataclasses.dataclass(frozen=True)
class Head:
    """A tool's body of revolution: its outline as ``back`` [m] behind the TCP and ``radius`` (K,) [m], and
    ``balls``, each a place behind the TCP and a radius, that hold it."""

    back: FloatArray
    radius: FloatArray
    balls: tuple[tuple[float, float], ...]

    @staticmethod
    def of(profile: FloatArray, begin: float) -> Head:
        """The part of a tool of radius profile (K, 2) from ``begin`` [m] behind its TCP on."""
        back, radius = profile[:, 0], profile[:, 1]
        if begin > back[0]:
            at = float(np.interp(begin, back, radius))
            use = back > begin
            back, radius = np.append(begin, back[use]), np.append(at, radius[use])
        if radius[0] > 0.0:
            back, radius = np.append(back[0], back), np.append(0.0, radius)
        return Head(back, radius, _cover(back, radius))

    def into(
        self, points: FloatArray, way: HeadWay, need: float, there: tuple[int, FloatArray] | None = None
    ) -> tuple[FloatArray, IntArray]:
        """How deep (M,) [m] points (P, 3) are inside the tool, and the rows (M,) of its track, where bounds
        do not say that none is deeper than ``need`` [m]. Points count that are ``there``: as high (R,) [m] as
        that toward a side, or higher."""
        if not len(points):
            return np.zeros(0), np.zeros(0, dtype=np.int64)
        tree, height = cKDTree(points), (float(points[:, 2].min()), float(points[:, 2].max()))
        deep = np.full(len(way.rows), -np.inf)
        looked = np.zeros(len(way.rows), dtype=np.bool_)
        for back, size in self.balls:
            open_ = _near(tree, way, back, size - need)
            open_ = open_[way.past(open_, back, size, height) - self.back[0] > need]
            looked[open_] = True
            for rows in np.array_split(open_, max(1, len(open_) // _QUERIES)):
                if not len(rows):
                    continue
                found = np.atleast_1d(
                    tree.query_ball_point(way.places(rows, back), size, return_sorted=False)
                )
                many = [len(one) for one in found]
                if not sum(many):
                    continue
                which = np.repeat(rows, many)
                near = points[np.fromiter(itertools.chain.from_iterable(found), np.int64, sum(many))]
                inside = self._depth(near, way, which)
                if there is not None:
                    inside = np.where(there[0] * near[:, 2] >= there[1][which], inside, -np.inf)
                np.maximum.at(deep, which, inside)
        return deep[looked], way.rows[looked]

    def _depth(self, near: FloatArray, way: HeadWay, which: IntArray) -> FloatArray:
        """How deep (M,) [m] points (M, 3) are inside the tool at some of the rows."""
        rest = near - way.places(which, 0.0)
        behind = -dots(rest, way.axis[which])
        beside = np.sqrt(np.maximum(dots(rest, rest) - behind**2, 0.0))
        return self._inside(behind, beside)

    def _inside(self, behind: FloatArray, beside: FloatArray) -> FloatArray:
        """How deep (M,) [m] points are inside the outline, negative outside; its rear end is open."""
        most = np.interp(behind, self.back, self.radius)
        inside = (beside < most) & (behind > self.back[0]) & (behind < self.back[-1])
        off = np.full(len(behind), np.inf)
        for k in range(len(self.back) - 1):
            one = np.array([self.back[k], self.radius[k]])
            way = np.array([self.back[k + 1], self.radius[k + 1]]) - one
            rest = np.stack([behind, beside], axis=1) - one
            share = np.clip(rest @ way / max(float(way @ way), 1e-30), 0.0, 1.0)
            off = np.minimum(off, lengths(rest - share[:, None] * way))
        return np.where(inside, off, -off)


def _cover(back: FloatArray, radius: FloatArray) -> tuple[tuple[float, float], ...]:
    """Balls (place behind the TCP, radius) [m] that hold a body of revolution."""
    size = max(float(radius.max()), 1e-3)
    edges = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / size)), 1) + 1)
    out = []
    for low, high in itertools.pairwise(edges):
        inner = (back >= low) & (back <= high)
        most = max(float(np.interp([low, high], back, radius).max()), float(radius[inner].max(initial=0.0)))
        out.append((0.5 * float(low + high), float(np.hypot(most, 0.5 * (high - low)))))
    return tuple(out)


def _near(tree: cKDTree, way: HeadWay, back: float, size: float) -> IntArray:
    """Rows of a way at which a point may be within ``size`` [m] of the place ``back`` [m] behind the TCP:
    stretches of it are settled by one look each where that place keeps farther off than it moves within, or
    so near that there is a point at all of it."""
    count = len(way.rows)
    gone = way.slide + abs(back) * way.turn
    first = np.arange(0, count, _BLOCK)
    last = np.minimum(first + _BLOCK, count) - 1
    mark = np.zeros(count + 1, dtype=np.int64)
    while len(first):
        look = (first + last) // 2
        step = np.maximum(gone[last] - gone[look], gone[look] - gone[first])
        reach = step + size
        most = float(reach.max(initial=0.0))
        # many places are about as near in the middle of a dish: the nearest but for a share is enough
        bound = (1.0 + ROUGH) * most + 1e-9
        far = np.asarray(tree.query(way.places(look, back), eps=ROUGH, distance_upper_bound=bound)[0])
        open_ = far < (1.0 + ROUGH) * reach
        small = open_ & ((far + step <= size) | (gone[last] - gone[first] <= LOOKED) | (last == first))
        np.add.at(mark, first[small], 1)
        np.add.at(mark, last[small] + 1, -1)
        split = open_ & ~small
        first, last, look = first[split], last[split], look[split]
        first, last = np.concatenate([first, look + 1]), np.concatenate([look, last])
    return np.flatnonzero(np.cumsum(mark[:-1]) > 0)
