"""Where things stand for one operation: the arms that take part, the stock, and what may not be touched."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planner.cell import clearance
from planner.cell.edge import Against
from planner.cell.edge import edge as edge_clearance
from planner.cell.plant import CellModel
from planner.geometry.rigid import transform
from planner.motion.chain import Chain
from planner.problem import Cell, Settings
from planner.targets import Targets, segment_kind

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

SKIP_ENDS = 0.05
"""Arc length [m] at either end of the flexible edge that is not held against the tool which holds it."""

CUTTING = "cut"
"""The kind of segment in which the edge may touch the stock."""


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
        for arm in sorted(targets.arms, key=lambda a: targets.frame.get(a, "stock").startswith("held:")):
            frame = targets.frame.get(arm, "stock")
            if frame.startswith("held:"):
                done[arm] = done[frame.removeprefix("held:")] @ poses[arm]
            else:
                done[arm] = poses[arm] if frame == "world" else self.stock @ poses[arm]
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

    def free(self, targets: Targets, q: Mapping[str, FloatArray], index: IndexArray) -> NDArray[np.bool_]:
        """(B,) whether joints {arm: (B, 6)} at targets ``index`` (B,) keep the wanted clearance, edge
        included."""
        if self.model is None or len(index) == 0:
            return np.ones(len(index), dtype=bool)
        ok = np.asarray(clearance.free(self.model, q, self.settings.clearance), dtype=bool)
        rows = np.flatnonzero(ok)
        distance, _ = self.edge_clearance(targets, {arm: v[rows] for arm, v in q.items()}, index[rows])
        ok[rows] = distance >= self.settings.clearance
        return ok

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
        cuts = np.array([segment_kind(targets.segment[i]) == CUTTING for i in index], dtype=bool)
        choices: tuple[tuple[Against, NDArray[np.intp]], ...] = (
            ("no_stock", np.flatnonzero(cuts)),
            ("all", np.flatnonzero(~cuts)),
        )
        for against, rows in choices:
            if len(rows):
                part = {arm: q[arm][rows] for arm in targets.arms}
                found = edge_clearance(
                    self.model, part, points[rows], targets.edge.radius, SKIP_ENDS, against
                )
                distance[rows] = found.distance
                for row, pair in zip(rows, found.pair, strict=True):
                    pairs[row] = pair
        return distance, pairs
