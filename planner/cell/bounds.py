"""Least distances of a cell's solids: cheap bounds, which settle most configurations, and true ones.

Every moving solid has a capsule around it and one inside it, with the same axis. The distance of the outer
capsules is a lower bound of the true one, that of the inner capsules an upper bound. Fixed boxes (stock,
table, bases) stay boxes. Pairs that no bound settles are measured (:mod:`planner.cell.distance`).
"""

import dataclasses
import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import numpy as np

from planner.cell.bodies import Easing, Solid, chains_of, extent, hull_points, signed_distance
from planner.cell.bodies import fixed as is_fixed
from planner.cell.distance import AGREED_M, Cores, between_segments, cores, distances, nearest_to_box
from planner.cell.shadows import separation, support
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IndexArray,
    dots,
    from_parts,
    inverse,
    lengths,
    transform,
)

AXIS_SAMPLES: Final = 5
"""Points on a capsule's axis whose distances to a box bound that of the whole axis."""
ROUNDING_M: Final = 1e-9
"""Balls around bodies are larger by this [m], above errors of rounding."""
ROWS_AT_ONCE: Final = 32
"""Rows that are held against a box at once at first."""
FIRST_LIMIT_M: Final = 0.08
"""Lower bounds are looked for up to this [m] at first, where they are asked for farther."""
NEAR_DISTANCE: Final = 0.012
"""Solids of one arm within this distance [m] in nearly all postures tell nothing when they are near."""
NEAR_SHARE: Final = 0.95
"""Solids that are near each other in more than this share of postures always are."""
KEPT_DISTANCE: Final = 0.03
"""Solids of one arm within this distance [m] in nearly all postures that touch in none are kept apart by the
arm's build, such as the round end of a wrist and what turns about it: wider clearance cannot be had there."""


SolidPair = tuple[int, int]


@dataclasses.dataclass(frozen=True, eq=False)
class Bounds:
    """Solids as capsules, and by their support.

    Centre (S, 3) and unit axis (S, 3) of the capsules are in their body, which is ``bodies[part]``; half
    lengths and radii (S,) are outer and inner. ``frame`` (S, 3, 3) are the shapes' axes in their body,
    ``support`` (S, 5) is what :func:`support` says.

    ``boxes`` (K,) are boxes of fixed bodies, of half size (K, 3), or stand for meshes within them where not
    ``exact``. ``pairs`` (M, 2) are pairs of capsules,
    ``box_pairs`` (N, 2) of a capsule and a box, that are held apart. ``given`` (S + K,) are the solids
    themselves, moving and fixed ones, ``own`` (S + K, 4, 4) their poses in their bodies, and their ``cores``.
    ``ease`` (S + K, S + K) [m]: how much farther apart two of them count than they are, in all that is said
    of distances here; 0 but where :meth:`eased` has it.
    """

    solids: tuple[Solid, ...]
    bodies: tuple[str, ...]
    part: IndexArray
    centre: FloatArray
    axis: FloatArray
    outer: tuple[FloatArray, FloatArray]
    inner: tuple[FloatArray, FloatArray]
    frame: FloatArray
    support: FloatArray
    boxes: tuple[Solid, ...]
    half: FloatArray
    exact: BoolArray
    pairs: IndexArray
    box_pairs: IndexArray
    given: tuple[Solid, ...]
    own: FloatArray
    cores: Cores
    ease: FloatArray

    def eased(self, easing: Easing) -> "Bounds":
        """The same with pairs of bodies that count as farther apart than they are."""
        bodies = [solid.body for solid in self.given]
        ease = np.array([[easing.of(one, other) for other in bodies] for one in bodies])
        return dataclasses.replace(self, ease=ease.reshape(len(bodies), len(bodies)))

    def among(self, ignore: frozenset[frozenset[str]]) -> "Bounds":
        """The same without the pairs of bodies in ``ignore``."""
        if not ignore:
            return self
        if ignore not in self._among:
            bodies = [solid.body for solid in self.given]
            self._among[ignore] = self._kept(lambda a, b: frozenset((bodies[a], bodies[b])) not in ignore)
        return self._among[ignore]

    @functools.cached_property
    def _among(self) -> "dict[frozenset[frozenset[str]], Bounds]":
        return {}

    def always_near(self, poses: Mapping[str, FloatArray]) -> tuple[SolidPair, ...]:
        """Pairs of solids of one arm, by their places in ``given``, that its build keeps near each other in
        body poses (B | 1, 4, 4) that were drawn: within KEPT_DISTANCE, and never touching; or within
        NEAR_DISTANCE. Of any two bodies the latter are as few as it takes for the others not to be near in
        more than NEAR_SHARE of the poses.
        """
        own = self._of_one_arm()
        row, solids, gap, *_ = own.every(poses, KEPT_DISTANCE)
        count = own._placed(poses).rows
        near: dict[frozenset[str], dict[SolidPair, FloatArray]] = {}
        for at, (a, b), apart in zip(row.tolist(), solids.tolist(), gap.tolist(), strict=True):
            bodies = near.setdefault(frozenset((self.given[a].body, self.given[b].body)), {})
            bodies.setdefault((min(a, b), max(a, b)), np.full(count, np.inf))[at] = apart
        out: list[SolidPair] = []
        for pairs in near.values():
            shares = {pair: np.isfinite(apart).mean() for pair, apart in pairs.items()}
            kept = [pair for pair, apart in pairs.items() if shares[pair] > NEAR_SHARE and apart.min() > 0.0]
            out += kept
            left = {pair: apart < NEAR_DISTANCE for pair, apart in pairs.items() if pair not in kept}
            while left and np.logical_or.reduce(list(left.values())).mean() > NEAR_SHARE:
                most = max(sorted(left), key=lambda pair: int(left[pair].sum()))
                del left[most]
                out.append(most)
        return tuple(sorted(out))

    def flange_parts(self, poses: Mapping[str, FloatArray]) -> tuple[SolidPair, ...]:
        """Pairs of the link before the wrist and of what of a tool is nowhere farther than NEAR_DISTANCE from
        the flange in body poses (1, 4, 4), such as the plate by which it is mounted: the arm's build keeps
        these apart as it does the flange itself, mostly by a few millimetres."""
        out: list[SolidPair] = []
        chains = chains_of(solid.body for solid in self.given)
        for k, solid in enumerate(self.given):
            arm, _, link = solid.body.partition("/")
            if link != "tool" or arm not in chains:
                continue
            *_, before, _, last, _ = chains[arm]
            flange = [one for one in self.given if one.body == f"{arm}/{last}"]
            if not flange:
                continue
            points = transform(poses[solid.body][0] @ solid.shape.pose, hull_points(solid))
            each = [(one, inverse(poses[one.body][0] @ one.shape.pose)) for one in flange]
            off = np.min([signed_distance(one, transform(back, points)) for one, back in each], axis=0)
            if off.max() <= NEAR_DISTANCE:
                wrist = [i for i, one in enumerate(self.given) if one.body == f"{arm}/{before}"]
                out += [(min(i, k), max(i, k)) for i in wrist]
        return tuple(out)

    def without(self, solids: Collection[SolidPair]) -> "Bounds":
        """The same without pairs of solids, by their places in ``given``."""
        return self._kept(lambda a, b: (min(a, b), max(a, b)) not in solids)

    def of_bodies(self, one: str, other: str) -> tuple[SolidPair, ...]:
        """The pairs of solids of two bodies that are held apart, by their places in ``given``."""
        asked = {one, other}
        some = self._kept(lambda a, b: {self.given[a].body, self.given[b].body} == asked)
        first = [(a, b) for a, b in some.pairs.tolist()]
        return tuple(first + [(a, b + len(self.solids)) for a, b in some.box_pairs.tolist()])

    def _of_one_arm(self) -> "Bounds":
        """The same with pairs of bodies of one arm only."""
        arm = [solid.body.partition("/") for solid in self.given]
        return self._kept(lambda a, b: arm[a][0] == arm[b][0] and bool(arm[a][1]) and bool(arm[b][1]))

    def _kept(self, keep: Callable[[int, int], bool]) -> "Bounds":
        """The same with those pairs only, by their places in ``given``, that ``keep`` says to keep."""
        count = len(self.solids)
        first = np.array([keep(a, b) for a, b in self.pairs.tolist()], dtype=bool)
        second = np.array([keep(a, b + count) for a, b in self.box_pairs.tolist()], dtype=bool)
        return dataclasses.replace(
            self, pairs=self.pairs[first.reshape(-1)], box_pairs=self.box_pairs[second.reshape(-1)]
        )

    def least(
        self, poses: Mapping[str, FloatArray], limit: float, both: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (B,) [m] of the least distance, for body poses (B | 1, 4, 4).

        Where bodies overlap the bounds only have the true sign, and no meaning as depths. Distances above
        ``limit`` are not worked out: both bounds are then infinite or above it. Unless ``both`` are asked
        for, upper bounds are infinite.
        """
        placed = self._placed(poses)
        lower, upper = np.full(placed.rows, np.inf), np.full(placed.rows, np.inf)
        open_ = np.arange(placed.rows)
        if not both and limit > FIRST_LIMIT_M:  # what is beyond the least of a row need not be looked at
            lower = self._least_within(placed, FIRST_LIMIT_M)
            open_ = np.flatnonzero(~(lower < FIRST_LIMIT_M))
        if len(open_):
            rest = placed if len(open_) == placed.rows else placed.some(open_)
            lower[open_] = self._least_within(rest, limit, upper if both else None)
        return lower, upper

    def _least_within(self, placed: "_Placed", limit: float, upper: FloatArray | None = None) -> FloatArray:
        """The lower bounds (B,) of :meth:`least`; takes upper ones into ``upper`` where it is given."""
        lower = np.full(placed.rows, np.inf)
        boxes = self._near_boxes(placed, limit)
        row, a, b = self._near(placed, limit, np.ones(placed.rows, dtype=np.bool_))
        if upper is not None:
            np.minimum.at(upper, boxes.row, self._at_most(boxes) + self._box_ease(boxes))
            np.minimum.at(upper, row, self._between(placed, row, a, b, self.inner)[1] + self.ease[a, b])
        self._below_apart(lower, placed, limit, row, a, b)
        self._below(lower, placed, boxes, limit)
        return lower

    def nearest(
        self, poses: Mapping[str, FloatArray], limit: float
    ) -> tuple[FloatArray, IndexArray, BoolArray]:
        """Least distances (B,) [m] for finite body poses (B | 1, 4, 4), ``limit`` where none is below it; the
        places in ``given`` of the two solids (B, 2) of each, -1 where there are none; and whether their cores
        overlap (B,), so that the depth is only bounded.

        Distances, but for what ``ease`` adds, are at most 1e-7 m below the truth and never above it.
        """
        placed, row, first, second, low = self._near_pairs(poses, limit)
        best = np.full(placed.rows, limit)
        pair = np.full((placed.rows, 2), -1, dtype=np.intp)
        deep = np.zeros(placed.rows, dtype=np.bool_)
        leading = np.flatnonzero(np.diff(row, prepend=-1))
        rest = np.ones(len(row), dtype=np.bool_)
        rest[leading] = False
        for look in (leading, None):  # what is likely the nearest first: it rules out most of the others
            some = np.flatnonzero(rest & (low < best[row])) if look is None else look
            if not len(some):
                continue
            at, one, other = row[some], first[some], second[some]
            gap, way, _ = self._measured(placed, at, one, other)
            gap = gap + self.ease[one, other]
            closest = np.lexsort((gap, at))
            closest = closest[np.diff(at[closest], prepend=-1) != 0]
            closest = closest[gap[closest] < best[at[closest]]]
            best[at[closest]] = gap[closest]
            pair[at[closest]] = np.stack([one, other], axis=1)[closest]
            deep[at[closest]] = ~way[closest].any(axis=1)
        return best, pair, deep

    def apart(self, poses: Mapping[str, FloatArray], padding: float) -> BoolArray:
        """Whether all solids are farther apart than ``padding`` [m], as (B,), for finite poses."""
        placed = self._placed(poses)
        boxes = self._near_boxes(placed, padding + AGREED_M)
        out = np.ones(placed.rows, dtype=np.bool_)
        out[boxes.row[self._at_most(boxes) + self._box_ease(boxes) <= padding]] = False
        row, first, second, _ = self._pairs_within(placed, boxes, padding + AGREED_M, out)
        return out & self._all_apart(placed, row, first, second, padding - self.ease[first, second])

    def stay_apart(
        self, poses: Mapping[str, FloatArray], padding: float, change: FloatArray, lever: FloatArray
    ) -> BoolArray:
        """Whether all solids stay farther apart than ``padding`` [m] for sure while joints change by up to
        ``change`` (B, D) [rad] either way from finite poses, as (B,). ``lever`` (S + K, D) [m/rad]: how far a
        joint carries any point of a solid of ``given`` at most, 0 for solids that it does not move.

        What moves both solids of a pair brings them no nearer, so each pair has a room of its own to keep.
        """
        placed, count = self._placed(poses), len(self.pairs)
        pairs = np.concatenate([self.pairs, self.box_pairs + np.array([0, len(self.solids)])])
        one, other = lever[pairs[:, 0]], lever[pairs[:, 1]]
        room = padding - self.ease[tuple(pairs.T)]
        room = room + change @ np.where((one > 0.0) & (other > 0.0), 0.0, one + other).T
        a, b = self.pairs.T
        apart = lengths(placed.centre[:, a] - placed.centre[:, b])
        over = apart - self.inner[1][a] - self.inner[1][b]
        sure = np.asarray((over > room[:, :count]).all(axis=1))
        rows = np.flatnonzero(sure)
        if not len(rows):
            return sure
        placed, room, reach = placed.some(rows), room[rows], self.outer[0] + self.outer[1]
        row, pair = np.nonzero(apart[rows] < reach[a] + reach[b] + room[:, :count])
        boxes = self._near_boxes(placed, float(room[:, count:].max(initial=padding)))
        column = np.zeros((len(self.solids), len(self.boxes)), dtype=np.intp)
        column[tuple(self.box_pairs.T)] = np.arange(count, len(pairs))
        own = column[boxes.solid, boxes.box]
        near = np.flatnonzero(boxes.apart < reach[boxes.solid] + room[boxes.row, own])
        boxes, own = boxes.some(near), own[near]
        low = self._apart(placed, room[row, pair], row, a[pair], b[pair])
        low = np.concatenate([low, self._along_axis(boxes)[0]])
        row, pair = np.append(row, boxes.row), np.append(pair, own)
        beyond = low - room[row, pair]
        order = np.flatnonzero(beyond < AGREED_M)
        order = order[np.lexsort((beyond[order], row[order]))]
        row, pair = row[order], pair[order]
        first, second = pairs[pair].T
        sure[rows] = self._all_apart(placed, row, first, second, room[row, pair])
        return sure

    def _all_apart(
        self, placed: "_Placed", row: IndexArray, first: IndexArray, second: IndexArray, room: FloatArray
    ) -> BoolArray:
        """Whether all pairs (M,), by row, likely the nearest one of each first, are farther apart than
        ``room`` (M,) [m], as (B,)."""
        out = np.ones(placed.rows, dtype=np.bool_)
        leading = np.diff(row, prepend=-1) != 0
        for some in (np.flatnonzero(leading), None):
            look = np.flatnonzero(~leading & out[row]) if some is None else some
            if len(look):
                at, one, other = row[look], first[look], second[look]
                gap = self._measured(placed, at, one, other, room[look])[0]
                out[at[gap <= room[look]]] = False
        return out

    def every(
        self, poses: Mapping[str, FloatArray], limit: float
    ) -> tuple[IndexArray, IndexArray, FloatArray, FloatArray, FloatArray]:
        """All pairs of solids nearer than ``limit`` [m]: row (M,), places in ``given`` of both (M, 2),
        distance (M,) as in :meth:`nearest`, and the line that it lies on, as in :func:`distances`."""
        placed, row, first, second, _ = self._near_pairs(poses, limit)
        gap, way, place = self._measured(placed, row, first, second)
        gap = gap + self.ease[first, second]
        near = np.flatnonzero(gap < limit)
        return row[near], np.stack([first, second], axis=1)[near], gap[near], way[near], place[near]

    def _near_pairs(
        self, poses: Mapping[str, FloatArray], limit: float
    ) -> "tuple[_Placed, IndexArray, IndexArray, IndexArray, FloatArray]":
        """The solids as they are placed; row, both solids and lower bound (M,) of pairs that may be nearer
        than ``limit``, by row, the least bound of each row first."""
        placed = self._placed(poses)
        boxes = self._near_boxes(placed, limit)
        return placed, *self._pairs_within(placed, boxes, limit, np.ones(placed.rows, dtype=np.bool_))

    def _pairs_within(
        self, placed: "_Placed", boxes: "_NearBox", limit: float, rows: BoolArray
    ) -> tuple[IndexArray, IndexArray, IndexArray, FloatArray]:
        """The pairs of :meth:`_near_pairs` in the ``rows`` (B,) named."""
        row, first, second = self._near(placed, limit, rows)
        boxes = boxes if rows.all() else boxes.some(np.flatnonzero(rows[boxes.row]))
        from_boxes = self._along_axis(boxes)[0]
        touch = np.flatnonzero(from_boxes < limit)
        from_boxes[touch] = np.maximum(from_boxes[touch], self._shadows(placed, boxes.some(touch)))
        low = np.concatenate([self._apart(placed, limit, row, first, second), from_boxes])
        row, first = np.concatenate([row, boxes.row]), np.concatenate([first, boxes.solid])
        second = np.concatenate([second, boxes.box + len(self.solids)])
        order = np.flatnonzero(low < limit)
        order = order[np.lexsort((low[order], row[order]))]
        return row[order], first[order], second[order], low[order]

    def _measured(
        self,
        placed: "_Placed",
        row: IndexArray,
        one: IndexArray,
        other: IndexArray,
        settled: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distances (M,) of solids in rows (M,), and their lines, as :func:`distances` has them."""
        first, second = (self._solid_poses(placed, row, which) for which in (one, other))
        return distances(self.cores, one, other, first, second, settled)

    def _placed(self, poses: Mapping[str, FloatArray]) -> "_Placed":
        rows = max(len(pose) for pose in poses.values())
        both = np.empty((rows, 3, len(self.bodies), 4))
        for k, body in enumerate(self.bodies):
            both[:, :, k] = poses[body][:, :3]
        found = (both.reshape(3 * rows, -1) @ self._columns).reshape(rows, 3, -1)
        if not np.isfinite(found).all():  # of a pose that is not finite only what is in its own body is lost
            lost: BoolArray = np.asarray(~np.isfinite(both).all(axis=(1, 3)))
            known = np.where(lost[:, None, :, None], 0.0, both)
            found = (known.reshape(3 * rows, -1) @ self._columns).reshape(rows, 3, -1)
            own = np.concatenate([self.part, self.part, np.arange(len(self.bodies))])
            np.copyto(found, np.nan, where=lost[:, None, own])
        ends = [len(self.solids), 2 * len(self.solids)]
        parts = np.split(np.swapaxes(found, 1, 2), ends, axis=1)
        centre, axis, ball = map(np.ascontiguousarray, parts)
        fixed = np.array([poses[box.body][0] for box in self.boxes]).reshape(-1, 4, 4)
        turns, places = np.moveaxis(both[..., :3], 1, 2), np.moveaxis(both[..., 3], 1, 2)
        return _Placed(turns, places, centre, axis, ball, fixed)

    @functools.cached_property
    def _columns(self) -> FloatArray:
        """(4 P, 2 S + P) by which rows of the poses of all bodies, side by side, are multiplied for
        centres and axes of capsules and for the centres of the bodies' balls."""
        solids, bodies = len(self.solids), len(self.bodies)
        out = np.zeros((bodies, 4, 2 * solids + bodies))
        at = np.arange(solids)
        out[self.part, :3, at], out[self.part, 3, at] = self.centre, 1.0
        out[self.part, :3, solids + at] = self.axis
        at = np.arange(bodies)
        out[at, :3, 2 * solids + at], out[at, 3, 2 * solids + at] = self._balls[0], 1.0
        return out.reshape(4 * bodies, -1)

    def _solid_poses(self, placed: "_Placed", row: IndexArray, which: IndexArray) -> FloatArray:
        """World poses (M, 4, 4) of solids of ``given`` in rows (M,)."""
        body = np.zeros((len(row), 4, 4))
        body[:, 3, 3] = 1.0
        moving = which < len(self.solids)
        at = row[moving], self.part[which[moving]]
        body[moving, :3, :3], body[moving, :3, 3] = placed.turns[at], placed.places[at]
        body[~moving] = placed.fixed[which[~moving] - len(self.solids)]
        return np.asarray(body @ self.own[which])

    def _between(
        self,
        placed: "_Placed",
        row: IndexArray,
        a: IndexArray,
        b: IndexArray,
        size: tuple[FloatArray, FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Ways (M, 3) between the axes of capsules whose half lengths and radii are ``size``, and their
        distances (M,)."""
        w = placed.centre[row, a] - placed.centre[row, b]
        way, _ = between_segments(w, placed.axis[row, a], placed.axis[row, b], size[0][a], size[0][b])
        return way, lengths(way) - size[1][a] - size[1][b]

    def _apart(
        self, placed: "_Placed", limit: float | FloatArray, row: IndexArray, a: IndexArray, b: IndexArray
    ) -> FloatArray:
        """Lower bounds (M,) of the distances of moving solids: of their outer capsules, and where these are
        nearer than ``limit``, of all or of each (M,), of their shadows."""
        way, gap = self._between(placed, row, a, b, self.outer)
        touch = np.flatnonzero(gap < limit)
        gap[touch] = self._shadowed(placed, gap, way, row, a, b, touch)
        return gap

    def _shadowed(
        self,
        placed: "_Placed",
        gap: FloatArray,
        way: FloatArray,
        row: IndexArray,
        a: IndexArray,
        b: IndexArray,
        some: IndexArray,
    ) -> FloatArray:
        """Lower bounds of ``some`` (K,) of the pairs, by their capsules' distances (M,) and their shadows."""
        at, first, second = row[some], a[some], b[some]
        one, two = (
            (placed.turns[at, self.part[k]] @ self.frame[k], self.support[k]) for k in (first, second)
        )
        w = placed.centre[at, first] - placed.centre[at, second]
        return np.maximum(gap[some], separation(w, way[some], one, two))

    def _below_apart(
        self,
        lower: FloatArray,
        placed: "_Placed",
        limit: float,
        row: IndexArray,
        a: IndexArray,
        b: IndexArray,
    ) -> None:
        """Takes the lower bounds of :meth:`_apart`, as they count, into ``lower`` (B,). Shadows only raise
        bounds: those of a row's least bound first, then of what is still below what that leaves."""
        way, gap = self._between(placed, row, a, b, self.outer)
        ease = self.ease[a, b]
        value, open_ = gap + ease, gap < limit
        order = np.lexsort((value, row))
        leading = order[np.diff(row[order], prepend=-1) != 0]
        for look in (leading, None):
            some = leading if look is not None else np.flatnonzero(open_ & (value < lower[row]))
            some = some[open_[some]]
            if len(some):
                value[some] = self._shadowed(placed, gap, way, row, a, b, some) + ease[some]
            open_[some] = False
            settled = leading if look is not None else np.arange(len(row))
            np.minimum.at(lower, row[settled], value[settled])

    def _near(
        self, placed: "_Placed", limit: float, rows: BoolArray
    ) -> tuple[IndexArray, IndexArray, IndexArray]:
        """Row and both capsules of the pairs whose bounding spheres come within ``limit``, in the rows
        named: of bodies whose own spheres do, which lie around those of their capsules."""
        which = np.flatnonzero(rows)
        near = self._body_pairs
        ball, centre = placed.ball[which], placed.centre[which]
        apart = ball[:, near.one] - ball[:, near.other]
        row, both = np.nonzero(dots(apart, apart) < (near.reach + limit) ** 2)
        count = near.count[both]
        row = np.repeat(row, count)
        pair = np.arange(len(row)) + np.repeat(near.start[both] - np.cumsum(count) + count, count)
        pair = near.pair[pair]
        reach = self.outer[0] + self.outer[1]
        first, second = self.pairs[pair, 0], self.pairs[pair, 1]
        apart = centre[row, first] - centre[row, second]
        some = np.flatnonzero(dots(apart, apart) < (reach[first] + reach[second] + limit) ** 2)
        some = some[np.argsort(row[some] * len(self.pairs) + pair[some])]
        return which[row[some]], first[some], second[some]

    @functools.cached_property
    def _balls(self) -> tuple[FloatArray, FloatArray]:
        """Spheres around those of the capsules of each of ``bodies``: centres (P, 3) in it and radii (P,)."""
        middle, radius = np.zeros((len(self.bodies), 3)), np.zeros(len(self.bodies))
        for k in range(len(self.bodies)):
            own = np.flatnonzero(self.part == k)
            reach = (self.outer[0] + self.outer[1])[own]
            low, high = (
                (self.centre[own] - reach[:, None]).min(axis=0),
                (self.centre[own] + reach[:, None]).max(axis=0),
            )
            middle[k] = 0.5 * (low + high)
            radius[k] = (lengths(self.centre[own] - middle[k]) + reach).max()
        return middle, radius

    @functools.cached_property
    def _body_pairs(self) -> "_BodyPairs":
        body = self.part[self.pairs]
        code = body[:, 0] * len(self.bodies) + body[:, 1]
        order = np.argsort(code, kind="stable")
        codes, start, count = np.unique(code[order], return_index=True, return_counts=True)
        one, other = np.divmod(codes, max(len(self.bodies), 1))
        radius = self._balls[1] + ROUNDING_M
        return _BodyPairs(one, other, radius[one] + radius[other], start, count, order)

    def _near_boxes(self, placed: "_Placed", limit: float) -> "_NearBox":
        """Pairs of capsules and boxes that come within ``limit`` by the capsules' spheres: first of rows that
        follow each other, which are mostly near each other, then of each."""
        count = len(self.boxes)
        if not count or not len(self.box_pairs):
            none, nowhere = np.zeros(0, dtype=np.intp), np.zeros((0, 3))
            return _NearBox(none, none, none, nowhere, nowhere, nowhere, np.zeros(0))
        centre, axis = placed.centre, placed.axis
        pose = placed.fixed @ np.array([box.shape.pose for box in self.boxes])
        place, turn = pose[:, :3, 3], pose[:, :3, :3]
        reach = self.outer[0] + self.outer[1]
        held = np.zeros((len(reach), count), dtype=bool)
        held[self.box_pairs[:, 0], self.box_pairs[:, 1]] = True
        first = np.arange(0, len(centre), ROWS_AT_ONCE)
        low, high = (end.reduceat(centre, first, axis=0) for end in (np.minimum, np.maximum))
        middle = (0.5 * (low + high)).reshape(-1, 3)
        apart = _box((middle - place[:, None]) @ turn, self.half[:, None]).T.reshape(*low.shape[:2], count)
        room = reach + 0.5 * np.linalg.norm(high - low, axis=2) + limit
        # a group with a row that is not finite has no distances, and may be near everything
        group, solid, box = np.nonzero(held & ~(apart >= room[..., None]))
        row = (first[group][:, None] + np.arange(ROWS_AT_ONCE)).ravel()
        solid, box = np.repeat(solid, ROWS_AT_ONCE), np.repeat(box, ROWS_AT_ONCE)
        there = row < len(centre)
        row, solid, box = row[there], solid[there], box[there]
        local = np.einsum("mc,mcd->md", centre[row, solid] - place[box], turn[box])
        apart = _box(local, self.half[box])
        kept = np.flatnonzero(apart < reach[solid] + limit)
        row, solid, box = row[kept], solid[kept], box[kept]
        along = np.einsum("mc,mcd->md", axis[row, solid], turn[box])
        return _NearBox(row, solid, box, local[kept], along, self.half[box], apart[kept])

    def _shadows(self, placed: "_Placed", near: "_NearBox") -> FloatArray:
        """Lower bounds (M,) of distances of solids to boxes, as :func:`separation` has them: of a flat disc
        above a floor, where its capsule is a ball that reaches far into it."""
        pose = placed.fixed @ np.array([box.shape.pose for box in self.boxes]).reshape(-1, 4, 4)
        turn = pose[near.box][:, :3, :3]
        one = placed.turns[near.row, self.part[near.solid]] @ self.frame[near.solid]
        half = np.concatenate([near.half, np.zeros((len(near.half), 2))], axis=1)
        off = near.place - np.clip(near.place, -near.half, near.half)
        w, gap = (np.einsum("mab,mb->ma", turn, v) for v in (near.place, off))
        return separation(w, gap, (one, self.support[near.solid]), (turn, half))

    def _below(self, lower: FloatArray, placed: "_Placed", near: "_NearBox", limit: float) -> None:
        """Takes lower bounds of the distances of solids to the boxes into ``lower`` (B,).

        Bounds are worked out as far as it takes to know the least of each row below ``limit``: of the capsule
        whose ball is nearest, then of what a few points of its axis do not show to be farther than that,
        again the likely nearest first.
        """
        ease = self._box_ease(near)
        low = near.apart - self.outer[0][near.solid] - self.outer[1][near.solid] + ease
        for stage in range(3):
            near, low, ease = self._still_open(lower, near, low, ease, limit)
            if stage == 1:
                low = self._along_axis(near)[0] + ease
                near, low, ease = self._still_open(lower, near, low, ease, limit)
            if not len(low):
                return
            least = np.full(len(lower), np.inf)
            np.minimum.at(least, near.row, low)
            first = low == least[near.row] if stage < 2 else np.ones(len(low), dtype=np.bool_)
            some, own = near.some(np.flatnonzero(first)), ease[first]
            value = self._to_box(some) + own
            touch = np.flatnonzero(value < np.minimum(lower, limit)[some.row])  # shadows only raise it
            value[touch] = np.maximum(value[touch], self._shadows(placed, some.some(touch)) + own[touch])
            np.minimum.at(lower, some.row, value)
            near, low, ease = near.some(np.flatnonzero(~first)), low[~first], ease[~first]

    @staticmethod
    def _still_open(
        lower: FloatArray, near: "_NearBox", low: FloatArray, ease: FloatArray, limit: float
    ) -> "tuple[_NearBox, FloatArray, FloatArray]":
        """Pairs, with their bounds ``low`` and ``ease`` (M,), that may yet be the least of their row."""
        some = np.flatnonzero(low < np.minimum(lower, limit)[near.row])
        return near.some(some), low[some], ease[some]

    def _box_ease(self, near: "_NearBox") -> FloatArray:
        """How much farther (M,) [m] from their boxes solids count than they are."""
        return self.ease[near.solid, near.box + len(self.solids)]

    def _at_most(self, near: "_NearBox") -> FloatArray:
        """Upper bounds (M,) of distances to boxes, of inner capsules; infinite to what only lies in a box."""
        out = np.full(len(near.row), np.inf)
        exact = np.flatnonzero(self.exact[near.box])
        some = near.some(exact)
        out[exact] = self._on_axis(some, self.inner[0]).min(axis=1) - self.inner[1][some.solid]
        return out

    def _to_box(self, near: "_NearBox") -> FloatArray:
        """Distances (M,) of outer capsules to boxes; only the sign tells of those that overlap."""
        nearest = nearest_to_box(near.place, near.along, self.outer[0][near.solid], near.half)
        value = _box(near.place + nearest[:, None] * near.along, near.half)
        return np.asarray(value - self.outer[1][near.solid])

    def _along_axis(self, near: "_NearBox") -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (M,) of the distances of outer capsules to boxes by a few points of their
        axes: distance changes by the way at most."""
        value = self._on_axis(near, self.outer[0])
        step = 2.0 * self.outer[0][near.solid] / (AXIS_SAMPLES - 1)
        between = 0.5 * (value[:, 1:] + value[:, :-1] - step[:, None])
        radius = self.outer[1][near.solid]
        return between.min(axis=1) - radius, value.min(axis=1) - radius

    def _on_axis(self, near: "_NearBox", length: FloatArray) -> FloatArray:
        """Distances (M, SAMPLES) to the boxes of points along the axes, out to the half lengths ``length``
        (S,)."""
        t = length[near.solid][:, None] * np.linspace(-1.0, 1.0, AXIS_SAMPLES)
        return _box(near.place[:, None] + t[..., None] * near.along[:, None], near.half[:, None])


@dataclasses.dataclass(frozen=True, eq=False)
class _Placed:
    """Solids in B rows: rotations (B, P, 3, 3) and places (B, P, 3) of moving bodies, centres and axes
    (B, S, 3) of their capsules, centres (B, P, 3) of the balls around bodies, poses (K, 4, 4) of the bodies
    of fixed boxes."""

    turns: FloatArray
    places: FloatArray
    centre: FloatArray
    axis: FloatArray
    ball: FloatArray
    fixed: FloatArray

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.turns)

    def some(self, rows: IndexArray) -> "_Placed":
        """Some of the rows."""
        turns, places, centre, axis, ball = (
            array[rows] for array in (self.turns, self.places, self.centre, self.axis, self.ball)
        )
        return _Placed(turns, places, centre, axis, ball, self.fixed)


@dataclasses.dataclass(frozen=True, eq=False)
class _BodyPairs:
    """Pairs of moving bodies: ``one`` and ``other`` (N,), the sum of their balls' radii ``reach`` (N,), and
    where the places (M,) in ``Bounds.pairs`` of their capsules ``start`` in ``pair``, and how many there are
    (N,)."""

    one: IndexArray
    other: IndexArray
    reach: FloatArray
    start: IndexArray
    count: IndexArray
    pair: IndexArray


@dataclasses.dataclass(frozen=True, eq=False)
class _NearBox:
    """Capsules near boxes: row, solid and box (M,), centre and axis (M, 3) in the box's frame, its half size
    (M, 3), and the distance (M,) of the centre."""

    row: IndexArray
    solid: IndexArray
    box: IndexArray
    place: FloatArray
    along: FloatArray
    half: FloatArray
    apart: FloatArray

    def some(self, chosen: IndexArray) -> "_NearBox":
        """Some of them."""
        return _NearBox(*(getattr(self, field.name)[chosen] for field in dataclasses.fields(self)))


def prepare(
    solids: Sequence[Solid],
    filtered: Sequence[tuple[str, str, str]],
    holder: str | None = None,
    riding: Collection[str] = (),
) -> Bounds:
    """The bounds of a cell's solids; ``filtered`` are pairs of bodies that are not held apart, ``holder`` is
    the arm that holds the stock, if any, and ``riding`` are bodies that stand elsewhere from row to row."""
    skip = {frozenset(pair[:2]) for pair in filtered}
    still = [is_fixed(s.body, holder) and s.body not in riding for s in solids]
    boxed = [own and s.shape.kind in ("box", "mesh") for own, s in zip(still, solids, strict=True)]
    boxes = [s for s, fixed in zip(solids, boxed, strict=True) if fixed]
    rows = [_capsule(s) for s, fixed in zip(solids, boxed, strict=True) if not fixed]
    capsules = tuple(_as_box(s) for s, fixed in zip(solids, boxed, strict=True) if not fixed)
    pairs = [
        (a, b)
        for a, one in enumerate(capsules)
        for b, other in enumerate(capsules[a + 1 :], start=a + 1)
        if one.body != other.body and frozenset((one.body, other.body)) not in skip
    ]
    box_pairs = [
        (a, b)
        for a, one in enumerate(capsules)
        for b, other in enumerate(boxes)
        if one.body != other.body and frozenset((one.body, other.body)) not in skip
    ]
    bodies = tuple(dict.fromkeys(s.body for s in capsules))
    ready = [_as_box(s) for s in boxes]
    given = [s for s, fixed in zip(solids, boxed, strict=True) if not fixed] + boxes
    return Bounds(
        given=tuple(given),
        own=np.array([solid.shape.pose for solid in given]).reshape(-1, 4, 4),
        cores=cores(given),
        ease=np.zeros((len(given), len(given))),
        solids=capsules,
        bodies=bodies,
        part=np.array([bodies.index(s.body) for s in capsules], dtype=np.intp),
        centre=np.array([s.shape.pose[:3, 3] for s in capsules]),
        axis=np.array([s.shape.pose[:3, :3] @ row[0] for s, row in zip(capsules, rows, strict=True)]),
        outer=(np.array([r[1] for r in rows]), np.array([r[2] for r in rows])),
        inner=(np.array([r[3] for r in rows]), np.array([r[4] for r in rows])),
        frame=np.array([s.shape.pose[:3, :3] for s in capsules]),
        support=np.array([support(s) for s in capsules]),
        boxes=tuple(ready),
        exact=np.array([s.shape.kind == "box" for s in boxes], dtype=bool),
        half=np.array([0.5 * np.asarray(s.shape.size) for s in ready]).reshape(-1, 3),
        pairs=np.array(pairs, dtype=np.intp).reshape(-1, 2),
        box_pairs=np.array(box_pairs, dtype=np.intp).reshape(-1, 2),
    )


def _as_box(solid: Solid) -> Solid:
    """A mesh as the box around it, in the axes of its own frame; other solids as they are."""
    if solid.shape.vertices is None:
        return solid
    low, high = solid.shape.vertices.min(axis=0), solid.shape.vertices.max(axis=0)
    pose = solid.shape.pose @ from_parts(np.eye(3), 0.5 * (low + high))
    size = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    return Solid(
        solid.body, dataclasses.replace(solid.shape, kind="box", size=size, pose=pose, vertices=None)
    )


def _capsule(solid: Solid) -> tuple[FloatArray, float, float, float, float]:
    """Axis (3,) in the shape's frame; half length and radius of the capsule around a solid, then of the one
    inside.

    The inner radius is -inf for a mesh, whose inside is not known.
    """
    kind = solid.shape.kind
    if kind in ("sphere", "capsule"):
        half = 0.5 * solid.shape.size[1] if kind == "capsule" else 0.0
        return np.array([0.0, 0.0, 1.0]), half, solid.shape.size[0], half, solid.shape.size[0]
    if kind == "cylinder":
        radius, half = solid.shape.size[0], 0.5 * solid.shape.size[1]
        axis, thin = np.array([0.0, 0.0, 1.0]), min(radius, half)
    else:
        size = 0.5 * extent(_as_box(solid))
        order = np.argsort(size)
        axis = np.eye(3)[order[2]]
        half, radius = float(size[order[2]]), float(np.hypot(size[order[0]], size[order[1]]))
        thin = float(size[order[0]]) if kind == "box" else -np.inf
    around = max(0.0, half - 0.4 * radius)
    return axis, around, float(np.hypot(radius, half - around)), max(0.0, half - max(thin, 0.0)), thin


def _box(points: FloatArray, half: FloatArray) -> FloatArray:
    """Signed distances (...,) of points (..., 3) to boxes about the origin of half sizes (..., 3)."""
    x, y, z = (np.abs(points[..., i]) - half[..., i] for i in range(3))
    inside = np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
    x, y, z = np.maximum(x, 0.0), np.maximum(y, 0.0), np.maximum(z, 0.0)
    return np.asarray(np.sqrt(x * x + y * y + z * z) + inside)
