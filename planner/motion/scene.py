"""Where things stand for one operation: the arms that take part, the stock, and what may not be touched."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from planner.cell import clearance
from planner.cell.clearance import Against, LeastClearance, Pairs
from planner.cell.clearance import edge as edge_clearance
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.rigid import interpolate, inverse, transform
from planner.motion.arm_kinematics import Chain
from planner.problem import Cell, Settings
from planner.targets import Targets
from planner.tooling import FormingTool, working_solid

SKIPPED_END_LENGTH = 0.05
"""Arc length [m] at either end of the flexible edge that is not held against the tool which holds it."""

TRANSIT_KIND = "transit"
"""Kind of segments in which joined TCPs go from one work to the next and keep their relative pose."""

HELD_PREFIX = "held:"
"""Work frames that another arm's tool carries are named by this and that arm."""


DISTANCE_BATCH = 64
"""Targets that are asked for their least distance at a time, nearest bounds first."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """Arms of one operation with the stock at ``stock`` (4, 4) in the world.

    ``model`` is the cell's collision model, or None for kinematics alone.
    """

    chains: Mapping[str, Chain]
    stock: FloatArray
    settings: Settings
    model: CellModel | None = None

    @staticmethod
    def of(
        cell: Cell,
        arms: tuple[str, ...],
        stock: FloatArray,
        settings: Settings,
        model: CellModel | None = None,
        bases: Mapping[str, FloatArray] | None = None,
    ) -> Scene:
        """The scene of the named arms of a cell; ``bases`` replaces base poses."""
        moved = bases or {}
        chains = {name: Chain.of(cell.arm(name), moved.get(name)) for name in arms}
        return Scene(chains, stock, settings, model)

    def world(self, targets: Targets, poses: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """TCP poses in the world of poses {arm: (..., 4, 4)} in the work frames of the targets."""
        done: dict[str, FloatArray] = {}
        for arm, holder in holders(targets):
            if holder is not None:
                done[arm] = done[holder] @ poses[arm]
            else:
                done[arm] = poses[arm] if targets.frame.get(arm) == "world" else self.stock @ poses[arm]
        return done

    def tcp(
        self, targets: Targets, values: FloatArray, index: IndexArray | None = None
    ) -> dict[str, FloatArray]:
        """TCP poses in the world {arm: (..., 4, 4)} at freedom values (..., F), as :meth:`Targets.poses`."""
        return self.world(targets, targets.poses(values, index))

    def edge(self, targets: Targets, index: IndexArray) -> FloatArray | None:
        """Points (B, P, 3) of the flexible edge in the world at targets ``index`` (B,), or None without an
        edge."""
        if targets.edge is None:
            return None
        frame = targets.frame.get(targets.arms[0], "stock")
        points = targets.edge.points[index]
        return points if frame == "world" else transform(self.stock, points)

    @functools.cached_property
    def last_reach(self) -> dict[str, tuple[FloatArray, tuple[int, int], object]]:
        """What was found last of each arm's reach: the poses, how many targets and samples, and the table."""
        return {}

    @functools.cached_property
    def passing(self) -> Pairs:
        """Pairs of bodies that may meet in working segments: the stock and the rigid edges of the tools that
        take part, and the heads of two tools that form one sheet."""
        if self.model is None:
            return frozenset()
        tools = {arm: self.model.cell.arm(arm).tool for arm in self.chains}
        works = [arm for arm, tool in tools.items() if working_solid(tool) is not None]
        pairs = {frozenset((f"{arm}/edge", "stock")) for arm in works}
        heads = [f"{arm}/edge" for arm, tool in tools.items() if isinstance(tool, FormingTool)]
        return frozenset(pairs | ({frozenset(heads)} if len(heads) > 1 else set()))

    def by_kind(self, targets: Targets, move: IndexArray) -> list[tuple[Pairs, IndexArray]]:
        """Rows of ``move`` (B,), targets that moves lead to, with the pairs of bodies that may meet there."""
        if not self.passing:
            return [(frozenset(), np.arange(len(move)))]
        cuts = cutting(targets)[move]
        parts = [(self.passing, np.flatnonzero(cuts)), (frozenset(), np.flatnonzero(~cuts))]
        return [(pairs, rows) for pairs, rows in parts if len(rows)]

    def free(
        self,
        targets: Targets,
        q: Mapping[str, FloatArray],
        index: IndexArray,
        move: IndexArray | None = None,
        ignored: Pairs = frozenset(),
    ) -> BoolArray:
        """(B,) whether joints {arm: (B, 6)} at targets ``index`` (B,) keep the wanted clearance, edges
        included.

        ``move`` (B,) are the targets that the moves lead to on which the joints lie, where that is not
        ``index``. Pairs of bodies in ``ignored`` are not looked at.
        """
        if self.model is None or len(index) == 0:
            return np.ones(len(index), dtype=bool)
        ok = np.zeros(len(index), dtype=bool)
        for ignore, part in self.by_kind(targets, index if move is None else move):
            some = {arm: v[part] for arm, v in q.items()}
            ok[part] = clearance.free(self.model, some, self.settings.clearance, ignore | ignored)
        rows = np.flatnonzero(ok)
        distance, _ = self.edge_clearance(targets, {arm: v[rows] for arm, v in q.items()}, index[rows])
        ok[rows] = distance >= self.settings.clearance
        return ok

    def least(
        self, targets: Targets, q: Mapping[str, FloatArray], move: IndexArray, reach: float
    ) -> LeastClearance:
        """Least distances (B,) between bodies at joints {arm: (B, 6)} on the moves to targets ``move`` (B,),
        of those within ``reach`` [m]; without the flexible edge."""
        distance, pair = np.full(len(move), reach), [("", "")] * len(move)
        if self.model is None:
            return LeastClearance(distance, tuple(pair))
        for ignore, rows in self.by_kind(targets, move):
            part = {arm: v[rows] for arm, v in q.items()}
            found = clearance.least(self.model, part, reach, ignore)
            distance[rows] = found.distance
            for row, names in zip(rows, found.pair, strict=True):
                pair[row] = names
        return LeastClearance(distance, tuple(pair))

    def nearest(
        self, targets: Targets, q: Mapping[str, FloatArray], reach: float
    ) -> tuple[float, tuple[str, str], int]:
        """The least distance [m] between bodies over all targets, if within ``reach`` [m], its pair and its
        target; exact, though only targets are looked at whose cheap lower bounds leave room for less."""
        best, pair, where = reach, ("", ""), 0
        if self.model is None:
            return best, pair, where
        for ignore, rows in self.by_kind(targets, np.arange(targets.count)):
            part = {arm: v[rows] for arm, v in q.items()}
            lower = clearance.at_least(self.model, part, reach, ignore)
            order = np.argsort(lower, kind="stable")
            for start in range(0, len(order), DISTANCE_BATCH):
                some = order[start : start + DISTANCE_BATCH]
                some = some[lower[some] < best]
                if not len(some):
                    break
                found = clearance.least(self.model, {arm: v[some] for arm, v in part.items()}, best, ignore)
                k = found.worst()
                if found.distance[k] < best:
                    best, pair, where = float(found.distance[k]), found.pair[k], int(rows[some[k]])
        return best, pair, where

    def between(
        self,
        targets: Targets,
        start: Mapping[str, FloatArray],
        end: Mapping[str, FloatArray],
        share: FloatArray,
    ) -> dict[str, FloatArray]:
        """TCP poses in the world {arm: (..., 4, 4)} at ``share`` (...,) of linear moves between world poses.

        A TCP whose work frame is held by another arm moves straight in that frame, which itself moves.
        """
        out: dict[str, FloatArray] = {}
        for arm, holder in holders(targets):
            if holder is None:
                out[arm] = interpolate(start[arm], end[arm], share)
            else:
                first, last = inverse(start[holder]) @ start[arm], inverse(end[holder]) @ end[arm]
                out[arm] = out[holder] @ interpolate(first, last, share)
        return {arm: out[arm] for arm in targets.arms}

    def edge_clearance(
        self, targets: Targets, q: Mapping[str, FloatArray], index: IndexArray
    ) -> tuple[FloatArray, list[tuple[str, str]]]:
        """Least distances (B,) [m] of the flexible edge to what it may not touch, and the pairs.

        The stock counts except in cut segments. Infinite without an edge.
        """
        distance, pairs = np.full(len(index), np.inf), [("", "")] * len(index)
        points = self.edge(targets, index)
        if points is None or targets.edge is None or self.model is None:
            return distance, pairs
        cuts = cutting(targets)[index]
        choices: tuple[tuple[Against, IndexArray], ...] = (
            ("no_stock", np.flatnonzero(cuts)),
            ("all", np.flatnonzero(~cuts)),
        )
        for against, rows in choices:
            if len(rows):
                part = {arm: q[arm][rows] for arm in targets.arms}
                found = edge_clearance(
                    self.model, part, points[rows], targets.edge.radius, SKIPPED_END_LENGTH, against
                )
                distance[rows] = found.distance
                for row, pair in zip(rows, found.pair, strict=True):
                    pairs[row] = pair
        return distance, pairs


def holders(targets: Targets) -> list[tuple[str, str | None]]:
    """Arms, each with the arm that holds its work frame or None, holders first."""
    frames = {arm: targets.frame.get(arm, "stock") for arm in targets.arms}
    pairs = [
        (arm, f.removeprefix(HELD_PREFIX) if f.startswith(HELD_PREFIX) else None) for arm, f in frames.items()
    ]
    return sorted(pairs, key=lambda pair: pair[1] is not None)


def cutting(targets: Targets) -> BoolArray:
    """(N,) whether an edge works the stock on the move to each target."""
    return np.array([segment.works for segment in targets.segment], dtype=bool)
