"""Where to put the stock, and bases that may be moved, so that the whole job is reachable with the best
margin.

A seeded search from coarse to fine over few targets and few spins, batched over candidates: random places and
heuristic ones, then generations of shrinking steps around the best. Places of round figures, which people can
clamp by, are refined from the best ones on and go before them where they cost next to nothing. What collides
is sorted out afterwards on the best ones.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell import clearance, support
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, IndexArray, IntArray, exp_rotation, from_parts, log_rotation
from planner.geometry.units import DEG
from planner.motion.place_margin import choice_scores, margin, margins_at, most_free
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.subsampling import Few, few_of, many_of, shifts
from planner.problem import Cell, Settings, Stock
from planner.targets import Targets

FIRST_CANDIDATES: Final = 384
"""Places that are drawn first, from a fixed seed."""
GENERATIONS: Final = 7
"""Rounds of a search that draws places about the best ones, ever nearer to them."""
PARENTS: Final = 8
"""Best places that the next round starts from."""
CHILDREN: Final = 10
"""Places drawn about each of them."""
MOST_CHECKED_PLACES: Final = 60
"""Places that are looked at for collisions at most; the search ends with so many that are free:"""

MOST_FREE_PLACES: Final = 6
"""Free places with which the search ends."""
MOST_SOON: Final = 12
"""Places of the first draw that a first look tries at most,"""
PLACES_SOON: Final = 2
"""until so many of them are free."""
FREEST_PLACES: Final = 3
"""Places that are kept where none is free for all of a few targets."""
ROOM_SHARE: Final = 0.5
"""Where no place is free, those free for so many of a few targets at least are looked at again, with more
samples and on all branches,"""
ROOM_TARGETS: Final = 60
"""by so many targets of an operation: with little room a few are not telling,"""
ROOM_PARENTS: Final = 4
"""the freest so many of them,"""
ROOM_CHILDREN: Final = 5
"""and places drawn about each of the freest then,"""
ROOM_GENERATIONS: Final = 2
"""in so many rounds, ever nearer to them,"""
ROOM_PLACES: Final = 3
"""until so many are free."""
COARSE_TARGETS: Final = 10
"""Targets of an operation by which places are compared first."""
FINE_TARGETS: Final = 20
"""Targets by which the best of them are compared again."""
QUARTER_TURN: Final = 0.5 * np.pi
"""A quarter of a turn [rad]."""
SIDE_UP_TURNS: Final = np.array(
    [
        [0, 0, 0],
        [QUARTER_TURN, 0, 0],
        [-QUARTER_TURN, 0, 0],
        [0, QUARTER_TURN, 0],
        [0, -QUARTER_TURN, 0],
        [np.pi, 0, 0],
    ],
    dtype=np.float64,
)
"""Turns [rad] that bring each of a held block's six sides up."""

ROUND_POSITION_M: Final = 0.005
"""[m] round figures of a place: positions are multiples of this,"""

ROUND_TURN_RAD: Final = np.deg2rad(15.0)
"""turns [rad] of this; turns by quarters to a base go before them."""

ROUND_TURN_SHARES: Final = ((QUARTER_TURN, 0.98), (ROUND_TURN_RAD, 0.985))
"""Steps of turns with the share of the best margin for which places with them are taken."""

ROUND_GENERATIONS: Final = 3
"""Rounds among places with round figures."""
ROUND_CHILDREN: Final = 6
"""Places drawn about each of the best ones in these."""

SAME_POSE: Final = 1e-6
"""Poses whose entries differ by no more than this [-, m] are the same."""

LEAST_APART_M: Final = 0.08
"""Places that are tried one after the other differ by at least this much [m, or rad of yaw times 0.3 m]."""


@dataclasses.dataclass(frozen=True)
class Place:
    """A candidate: stock pose (4, 4) and base poses {arm: (4, 4)} in the world; ``score`` [rad] is the least
    margin."""

    stock: FloatArray
    bases: dict[str, FloatArray]
    score: float
    number: int


def _freest(shares: Sequence[tuple[float, Place]]) -> tuple[tuple[float, Place], ...]:
    """The best of places with any share, the first of equals first."""
    return tuple(sorted((item for item in shares if item[0]), key=lambda item: -item[0])[:FREEST_PLACES])


@dataclasses.dataclass(frozen=True)
class Trace:
    """All candidates looked at: ``positions`` (K, 3) of the stock [m] and ``score`` (K,) [rad]. ``freest``
    are a few with free postures for most targets, the best first, and their shares."""

    positions: FloatArray
    score: FloatArray
    freest: tuple[tuple[float, Place], ...] = ()

    def with_more(self, more: "Trace") -> "Trace":
        """These candidates with ``more`` behind them."""
        positions = np.concatenate([self.positions, more.positions])
        score = np.concatenate([self.score, more.score])
        return Trace(positions, score, _freest([*self.freest, *more.freest]))

    def metrics(self, chosen: int | None) -> dict[str, Any]:
        """The search as the report reads it, in degrees; candidates that fail have no score."""
        score = np.where(self.score > 0.0, self.score / DEG, np.nan)
        return {
            "positions": self.positions,
            "score": score,
            "chosen": chosen,
            "unit": "deg",
            "name": "least margin to limits and singularities",
        }


class Search:
    """The search for one cell and the targets of all operations on one stock."""

    def __init__(
        self,
        cell: Cell,
        stock: Stock,
        jobs: Sequence[Targets],
        settings: Settings,
        start: FloatArray | None = None,
        seed: int | None = None,
        cells: Sequence[Cell] | None = None,
        in_air: bool = False,
    ) -> None:
        """``start`` (4,) is a first guess x, y, z [m], yaw [rad] around which some lie; ``cells`` are
        the cells of the jobs where their tools differ; ``in_air``: a support, or a block
        without one, may end above the floor."""
        self._cell, self._stock, self._jobs, self._settings = cell, stock, jobs, settings
        self._movable = tuple(arm for arm in cell.arms if arm.base_auto)
        self._rng = np.random.default_rng(settings.seed if seed is None else seed)
        self._fixed = stock.place is not None
        self._leans = stock.leans_freely
        self._own = 7 if self._leans else 4
        self._start = start
        stands = not self._fixed and stock.held_by is None and stock.sheet is None
        self._levels = support.levels(cell, stock) if stands else np.zeros(0)
        self._borne = stands and bool(stock.support) and not in_air
        self._ground = support.Ground.of(cell)
        # nothing is stated: it stands on what is below it, where there is anything but the floor
        bare = stands and not stock.support and stock.pedestal is None and not in_air
        self._drops = bare and self._ground.bears
        self._each = list(zip(cells or [cell] * len(jobs), jobs, strict=True))
        self._barred: set[int] = set()
        self._looked: list[tuple[float, FloatArray]] = []
        self._failed: dict[int, IntArray] = {}
        self._look(shifted=False)

    def _look(self, shifted: bool) -> None:
        self._coarse = [few_of(c, t, COARSE_TARGETS, shifted) for c, t in self._each]
        self._fine = [few_of(c, t, FINE_TARGETS, shifted) for c, t in self._each]

    @functools.cached_property
    def _many(self) -> list[Few]:
        return [many_of(c, t, ROOM_TARGETS) for c, t in self._each]

    def run(self, models: Sequence[CellModel] = ()) -> tuple[list[Place], Trace]:
        """Places in the order in which to try them, and the trace; the list is empty if none is reachable.

        ``models`` are the collision models of the jobs; without them nothing is checked for collisions. Where
        no place is reachable with what is shifted in its middle, shifts are sampled as well, which is slower.
        Where all of the best places collide, which often face one way alone, the search goes on among those
        that face another.
        """
        places, trace, faced = self._places(models)
        if not places and not trace.score.max() > 0.0 and any(shifts(t).any() for _, t in self._each):
            self._look(shifted=True)
            places, trace, faced = self._places(models)
        while not places and not self._fixed and faced - self._barred:
            self._barred |= faced
            places, more, faced = self._places(models)
            places = [dataclasses.replace(p, number=p.number + len(trace.score)) for p in places]
            trace = trace.with_more(more)
        if not places and models:
            self._barred = set()
            places, trace = self._with_room(models, trace)
        return places, trace

    def _with_room(self, models: Sequence[CellModel], trace: Trace) -> tuple[list[Place], Trace]:
        """Places about the freest at which a few targets have free postures on any branch, among more
        samples, the best first, and the trace with all that were looked at so. Places that leave a job most
        margin often leave bodies little room."""
        near = sorted((item for item in self._looked if item[0] >= ROOM_SHARE), key=lambda item: -item[0])
        if not near:
            return [], trace
        points = self._clamped(np.stack([point for _, point in near]))
        points = points[self._apart(points, ROOM_PARENTS)]
        spread = self._spread()
        every, scores, shares = points[:0], np.zeros(0), np.zeros(0)
        for generation in range(ROOM_GENERATIONS + 1):
            if generation:
                parents = every[np.argsort(-shares, kind="stable")[:ROOM_PARENTS]]
                steps = self._rng.normal(size=(len(parents), ROOM_CHILDREN, every.shape[1])) * spread
                points = self._clamped(
                    (parents[:, None] + steps * 0.7**generation).reshape(-1, steps.shape[2])
                )
            for point, least in zip(points, self._score(points, self._fine), strict=True):
                if least > 0.0 and (shares == 1.0).sum() < ROOM_PLACES:
                    share = self._share_free(models, self._place(point, least, 0), self._many)
                    every, scores = np.concatenate([every, point[None]]), np.append(scores, least)
                    shares = np.append(shares, share)
            if not len(every) or (shares == 1.0).sum() >= ROOM_PLACES:
                break
        first = len(trace.score)
        if not len(every):
            return [], trace
        looked = [
            (share, self._place(every[k], float(scores[k]), first + k))
            for k, share in enumerate(shares.tolist())
        ]
        positions = np.stack([place.stock[:3, 3] for _, place in looked])
        places = sorted((p for share, p in looked if share == 1.0), key=lambda p: -p.score)
        more = trace.with_more(Trace(positions, scores))
        return places, dataclasses.replace(more, freest=_freest(looked) or trace.freest)

    def soon(self, models: Sequence[CellModel]) -> Iterator[Place]:
        """The first places of those drawn first at which a few targets have free postures, the best before
        the others; they may be none although :meth:`run` has some."""
        points = self._first()
        fine = self._score(points, self._coarse)
        looked = 0
        for k in self._distinct(points, fine)[:MOST_SOON]:
            place = self._place(points[k], float(fine[k]), k)
            if self._share_free(models, place) == 1.0:
                yield place
                looked += 1
            if looked == PLACES_SOON:
                return

    def judged(
        self, stock: FloatArray, bases: Mapping[str, FloatArray], models: Sequence[CellModel]
    ) -> Place | str:
        """A known place of the stock (4, 4), with bases {arm: (4, 4)} of arms that may be moved, as this
        search finds it: on what the stock stands on, with its margin; or why it is none for these jobs."""
        point = self._point(stock, bases)
        if point is None:
            return "the block lay otherwise"
        score = float(self._score(point[None], self._fine)[0])
        if score <= 0.0 and any(shifts(t).any() for _, t in self._each):
            self._look(shifted=True)
            score = float(self._score(point[None], self._fine)[0])
        if score <= 0.0:
            return "not all targets are in reach there with all margins"
        place = self._place(point, score, 0)
        free = any(self._share_free(models, place, few) == 1.0 for few in (self._coarse, self._many))
        return place if free else "bodies are too near to one another there"

    def _places(self, models: Sequence[CellModel]) -> tuple[list[Place], Trace, set[int]]:
        """Places, the trace, and the quarters of a turn (see `_quarters`) that the best places face."""
        points = self._first()
        scores = self._score(points, self._coarse)
        seen, known = [points], [scores]
        spread = self._spread()
        for generation in range(GENERATIONS):
            best = np.argsort(-scores, kind="stable")[:PARENTS]
            points, scores = points[best], scores[best]
            size = spread * 0.55**generation
            steps = self._rng.normal(size=(len(points), CHILDREN, points.shape[1])) * size
            children = (points[:, None] + steps).reshape(-1, points.shape[1])
            offered = self._score(children, self._coarse)
            seen.append(children)
            known.append(offered)
            points, scores = np.concatenate([points, children]), np.concatenate([scores, offered])
        groups = [(np.concatenate(seen), np.concatenate(known), 1.0)]
        if not self._fixed and self._stock.held_by is None:
            groups += [(*self._rounded(*groups[0][:2], step), worth) for step, worth in ROUND_TURN_SHARES]
        every, all_scores = np.concatenate([g[0] for g in groups]), np.concatenate([g[1] for g in groups])
        places: list[tuple[float, Place]] = []
        faced: set[int] = set()
        first = 0
        for points, scores, worth in groups:
            finalists = self._distinct(points, scores)
            faced |= set(_quarters(points[finalists]).tolist())
            fine = self._score(points[finalists], self._fine)
            places += [
                (-s / worth, self._place(points[k], float(s), first + k))
                for k, s in zip(finalists, fine.tolist(), strict=True)
                if s > 0.0
            ]
            first += len(points)
        places.sort(key=lambda item: item[0])
        ordered = [place for _, place in places]
        trace = Trace(self._stock_poses(every)[:, :3, 3], all_scores)
        if models:
            looked, ordered = ordered[: 2 * MOST_CHECKED_PLACES], []
            shares: list[tuple[float, Place]] = []
            for place in looked:
                share = self._share_free(models, place)
                shares.append((share, place))
                if share == 1.0:
                    ordered.append(place)
                if len(ordered) == MOST_FREE_PLACES:
                    break
            trace = dataclasses.replace(trace, freest=_freest(shares))
            self._looked += [(share, every[place.number]) for share, place in shares]
        return ordered, trace, faced

    def _rounded(self, points: FloatArray, scores: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
        """Points with round figures and their scores, refined from the best of ``points`` on; they turn by
        multiples of ``step`` [rad]."""
        points = self._snapped(points[np.argsort(-scores, kind="stable")[:PARENTS]], step)
        scores = self._score(points, self._coarse)
        seen, known = [points], [scores]
        for generation in range(ROUND_GENERATIONS):
            best = np.argsort(-scores, kind="stable")[:PARENTS]
            size = 0.3 * self._spread() * 0.5**generation
            steps = self._rng.normal(size=(len(best), ROUND_CHILDREN, points.shape[1])) * size
            children = (points[best][:, None] + steps).reshape(-1, points.shape[1])
            children = np.unique(self._snapped(children, step), axis=0)
            offered = self._score(children, self._coarse)
            seen.append(children)
            known.append(offered)
            points, scores = np.concatenate([points[best], children]), np.concatenate([scores[best], offered])
        return np.concatenate(seen), np.concatenate(known)

    def _clamped(self, points: FloatArray) -> FloatArray:
        """Points with round figures where people clamp a block by them."""
        by_hand = not self._fixed and self._stock.held_by is None
        return self._snapped(points, ROUND_TURN_RAD) if by_hand else points

    def _snapped(self, points: FloatArray, step: float) -> FloatArray:
        """Points whose block turns by multiples of ``step`` against the first arm's base, with a corner a
        round way along x and y from that base, and its underside a round way above the floor; bases
        likewise."""
        base = self._cell.arms[0].base
        ahead = float(np.arctan2(base[1, 0], base[0, 0]))
        axes = np.array([[np.cos(ahead), -np.sin(ahead)], [np.sin(ahead), np.cos(ahead)]])
        out = points.copy()
        out[:, 3] = ahead + np.round((points[:, 3] - ahead) / step) * step
        for k in range(len(self._movable)):
            at = self._own + 3 * k
            out[:, at : at + 2] = np.round(points[:, at : at + 2] / ROUND_POSITION_M) * ROUND_POSITION_M
            out[:, at + 2] = np.round(points[:, at + 2] / step) * step
        for row in out:
            pose = self._stock_pose(row)
            corner = (pose @ np.append(self._stock.lower, 1.0))[:3]
            seen = axes.T @ (corner[:2] - base[:2, 3])
            row[:2] += axes @ (np.round(seen / ROUND_POSITION_M) * ROUND_POSITION_M - seen)
            under = float(support.underside(self._stock, pose[None])[0]) - self._ground.floor
            row[2] = pose[2, 3] + (
                0.0
                if len(self._levels) or self._drops
                else np.round(under / ROUND_POSITION_M) * ROUND_POSITION_M - under
            )
        return out

    def _first(self) -> FloatArray:
        """Random places within the arms' reach, some with the block's edges along the world's axes."""
        centre = np.mean([arm.base[:3, 3] for arm in self._cell.arms], axis=0)
        reach = max(Chain.of(arm).robot.reach for arm in self._cell.arms)
        count = FIRST_CANDIDATES
        if self._fixed:
            columns = [np.zeros((count, 4))]
        else:
            place = centre + self._rng.uniform(
                [-reach, -reach, -0.3 * reach], [reach, reach, 1.2 * reach], (count, 3)
            )
            place[: count // 3, :2] = centre[:2] + 0.25 * (place[: count // 3, :2] - centre[:2])
            yaw = self._rng.uniform(-np.pi, np.pi, count)
            yaw[::2] = np.round(yaw[::2] / (np.pi / 2.0)) * (np.pi / 2.0)
            if self._start is not None:
                near = slice(2 * count // 3, count)
                place[near] = self._start[:3] + 0.1 * self._rng.normal(size=place[near].shape)
                yaw[near] = self._start[3]
            columns = [np.column_stack([place, yaw])]
            if self._leans:
                lean = self._rng.uniform(-np.pi, np.pi, (count, 3))
                lean[::2] = self._rng.choice(SIDE_UP_TURNS, len(lean[::2]))
                columns.append(lean)
        for _ in self._movable:
            shift = self._rng.uniform(-0.5 * reach, 0.5 * reach, (count, 2))
            turn = self._rng.choice([-np.pi / 2.0, 0.0, 0.0, np.pi / 2.0, np.pi], count)
            columns.append(np.column_stack([shift, turn + 0.2 * self._rng.normal(size=count)]))
            columns[-1][: count // 6] = 0.0
        return np.concatenate(columns, axis=1)

    def _spread(self) -> FloatArray:
        stock = [0.0] * 4 if self._fixed else [0.2, 0.2, 0.15, 0.4]
        lean = [0.3] * 3 if self._leans else []
        return np.array(stock + lean + [0.2, 0.2, 0.3] * len(self._movable))

    def _stock_pose(self, point: FloatArray) -> FloatArray:
        return np.asarray(self._stock_poses(point[None])[0])

    def _stock_poses(self, points: FloatArray) -> FloatArray:
        """Poses (K, 4, 4) of the stock at points (K, P)."""
        if self._stock.place is not None:
            return np.repeat(self._stock.place[None], len(points), axis=0)
        about = np.zeros((len(points), 3))
        about[:, 2] = points[:, 3]
        turn = exp_rotation(about)
        turn = turn @ (exp_rotation(points[:, 4:7]) if self._leans else self._stock.attitude)
        places = from_parts(turn, points[:, :3])
        if len(self._levels):
            places[:, 2, 3] = self._levels[np.abs(self._levels - points[:, 2:3]).argmin(axis=1)]
        if self._drops:
            places[:, 2, 3] -= support.air(self._ground, self._stock, places)
        return places

    def _place(self, point: FloatArray, score: float, number: int) -> Place:
        return Place(self._stock_pose(point), self._bases(point), score, number)

    def _bases(self, point: FloatArray) -> dict[str, FloatArray]:
        """Bases of the movable arms: moved in the world, turned about their own vertical."""
        out = {}
        for k, arm in enumerate(self._movable):
            dx, dy, turn = point[self._own + 3 * k : self._own + 3 * k + 3]
            pose = arm.base.copy()
            pose[:3, :3] = exp_rotation(np.array([0.0, 0.0, turn])) @ pose[:3, :3]
            pose[:2, 3] += (dx, dy)
            out[arm.name] = pose
        return out

    def _point(self, stock: FloatArray, bases: Mapping[str, FloatArray]) -> FloatArray | None:
        """The point (P,) at which :meth:`_stock_pose` and :meth:`_bases` give these, None where there is
        none."""
        parts = [np.zeros(4)]
        if not self._fixed:
            turn = stock[:3, :3] @ self._stock.attitude.T
            yaw = 0.0 if self._leans else float(np.arctan2(turn[1, 0], turn[0, 0]))
            parts = [np.append(stock[:3, 3], yaw)]
            if self._leans:
                parts.append(log_rotation(stock[:3, :3]))
            elif np.abs(turn - exp_rotation(np.array([0.0, 0.0, yaw]))).max() > SAME_POSE:
                return None
        for arm in self._movable:
            turn = bases[arm.name][:3, :3] @ arm.base[:3, :3].T
            off = bases[arm.name][:2, 3] - arm.base[:2, 3]
            parts.append(np.append(off, np.arctan2(turn[1, 0], turn[0, 0])))
        return np.concatenate(parts)

    def _score(self, points: FloatArray, few: Sequence[Few]) -> FloatArray:
        """Score (K,) [rad] of candidates: the least margin over all targets with the best branches; below 0:
        not reachable, those that face a way that is not looked at any more among them."""
        out = np.full(len(points), -np.inf)
        asked = np.flatnonzero(~np.isin(_quarters(points), list(self._barred)))
        for first in range(0, len(asked), 64):
            rows = asked[first : first + 64]
            part = points[rows]
            stock = self._stock_poses(part)[:, None]
            moved = [self._bases(p) for p in part]
            bases = {a.name: np.array([m[a.name] for m in moved])[:, None] for a in self._movable}
            scores = [margin(f, stock, bases, self._settings) for f in few]
            out[rows] = np.min(scores, axis=0)
            if self._borne:  # a support that does not reach the floor bears nothing
                off = support.air(self._ground, self._stock, stock[:, 0]) - support.FOOT_HEIGHT
                out[rows] = np.where(off > 1e-9, np.minimum(out[rows], -1.0 - off), out[rows])
        return out

    def _distinct(self, points: FloatArray, scores: FloatArray) -> list[int]:
        """Indices of the best candidates that lie apart."""
        order = np.argsort(-scores, kind="stable")
        order = order[scores[order] > 0.0]
        return [int(order[k]) for k in self._apart(points[order], MOST_CHECKED_PLACES)]

    def _apart(self, points: FloatArray, most: int) -> list[int]:
        """Indices of ``most`` points that lie apart, earlier ones first."""
        out: list[int] = []
        lean = [0.3] * (self._own - 4)
        weight = np.array([1.0, 1.0, 1.0, 0.3] + lean + [1.0, 1.0, 0.3] * len(self._movable))
        for k in range(len(points)):
            if len(out) == most:
                break
            if all(np.abs((points[k] - points[j]) * weight).max() > LEAST_APART_M for j in out):
                out.append(k)
        return out

    def _share_free(
        self, models: Sequence[CellModel], place: Place, few: Sequence[Few] | None = None
    ) -> float:
        """The least share over the jobs of ``few`` targets, or those by which places are compared first, that
        have a free posture; 0 where what stands overlaps."""
        jobs = list(zip(models, few or self._coarse, strict=True))
        placed = {id(m): m.with_stock(place.stock).with_bases(place.bases) for m, _ in jobs}
        if any(clearance.overlaps(m) for m in placed.values()):
            return 0.0
        if any(
            support.made_in(m.cell, m.stock, place.stock)[1] > support.FOOT_HEIGHT for m in placed.values()
        ):
            return 0.0
        return min(self._few_free(placed[id(model)], place, few) for model, few in jobs)

    def _few_free(self, model: CellModel, place: Place, few: Few) -> float:
        """The share of a few targets with a free posture on the branches with most margin, or on any choice
        of branches that reaches all of them."""
        scene = Scene.of(few.cell, few.targets.arms, place.stock, self._settings, model, place.bases)
        margins, q = margins_at(scene, few, place.stock[None, None], self._settings)
        scores = choice_scores(margins, few.index)[0]
        choices = np.argsort(-scores, kind="stable")
        choices = choices[scores[choices] > 0.0] if few.every_branch else choices[:1]
        offered = []
        for pair in choices:
            choice = np.unravel_index(pair, [margins[arm].shape[-1] for arm in few.targets.arms])
            least = np.min(
                [margins[a][0, :, b] for a, b in zip(few.targets.arms, choice, strict=True)], axis=0
            )
            own = {a: q[a][0, :, b] for a, b in zip(few.targets.arms, choice, strict=True)}
            offered.append((own, least))
        failed = self._failed.setdefault(id(few), np.zeros(few.targets.count, dtype=np.int64))
        return most_free(scene, few, offered, failed) / few.targets.count


def _quarters(points: FloatArray) -> IndexArray:
    """The quarter of a turn (K,), 0 to 3, that is next to the yaw of candidates (K, 4 or more)."""
    return np.round(points[:, 3] / QUARTER_TURN).astype(np.int64) % 4
