"""A loop from level to level, run against a plant: what is left of springback on many sheets at once."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.units import MM
from planner.issues import refusal
from planner.loops import next_loop
from planner.loops.loop_plan import LoopPlan
from planner.loops.next_loop import Law
from planner.loops.plant import ON_CONTOUR, PlantFile, Sheets, cornered, off_contour, truth

FIRST: Final = 2.0 * MM
"""Depth [m] below which errors count: above, the tool runs in."""
PLACES: Final = 48
"""Places around a sheet at most that are formed."""
SAME_DEPTH: Final = 1e-6
"""Depths nearer than this [m] are the same."""


@dataclasses.dataclass(frozen=True)
class Run:
    """N sheets formed in M levels at J places: ``error`` (N, M, J) [m] formed less wanted after the tool has
    let go, ``offset`` (N, M, J) [m], ``force`` (N, M, J) [N]; ``depth`` (M,) [m] wanted; ``corner`` (M, J)
    how much of a corner each place is; ``kappa`` (N,) at the end; ``lost`` (N,): contact was lost."""

    depth: FloatArray
    error: FloatArray
    offset: FloatArray
    force: FloatArray
    corner: FloatArray
    kappa: FloatArray
    lost: BoolArray

    def largest(self) -> FloatArray:
        """Largest error (N,) [m] of each sheet below `FIRST`, either sign."""
        return np.asarray(np.abs(self.error[:, self.depth > FIRST]).max(axis=(1, 2)))

    def mean(self) -> FloatArray:
        """Mean error (N,) [m] of each sheet below `FIRST`, without its sign."""
        return np.asarray(np.abs(self.error[:, self.depth > FIRST]).mean(axis=(1, 2)))

    def at_depth(self) -> FloatArray:
        """Mean error (N,) [m] of the last level, without its sign."""
        return np.asarray(np.abs(self.error[:, -1]).mean(axis=1))


def run(
    plan: LoopPlan,
    plant: PlantFile,
    law: Law | None,
    seeds: list[int],
    lifts: Sequence[float] = (),
    already: Sequence[FloatArray] | None = None,
) -> Run:
    """Form sheets by their ``seeds`` (N,), corrected by ``law``, or not at all; the tool is lifted at the
    depths ``lifts`` [m], each time a quarter round further. ``already``: of each level (K,) [m] by how much
    its programs are deeper by a springback file; offsets of the loop are added to that.

    Raises ``TandemError`` (forming.loop_plant) where the plan's levels are not of the plant's shape."""
    require_shape(plan, plant)
    levels = plan.levels
    chosen = np.unique(np.linspace(0, len(levels[0].path), PLACES, endpoint=False).astype(int))
    places = [levels[0].path[chosen]]
    where = [chosen]
    for level in levels[1:]:
        where.append(_nearest(level.path, places[-1]))
        places.append(level.path[where[-1]])
    sheets = Sheets(plant, seeds, places[0][:, :2])
    known, count = truth(plant), len(seeds)
    measured: list[FloatArray] = []
    came_back: list[FloatArray] = []
    model: list[FloatArray] = []
    kappa = np.ones(count)
    before: FloatArray | None = None
    out = np.zeros((3, count, len(levels), len(chosen)))
    lost = np.zeros(count, dtype=np.bool_)
    depth = np.array([level.depth for level in levels])
    for k, level in enumerate(levels):
        step = float(depth[k] - (depth[k - 1] if k else 0.0))
        at = places[k][:, :2]
        shift = np.zeros(len(level.path)) if already is None else already[k]
        whole = np.broadcast_to(shift, (count, len(level.path)))
        if law is not None:
            told = next_loop.offsets(plan, law, k, measured, kappa, before, shift)
            whole = whole + told.offset
        before, offset = whole[:, -1], whole[:, where[k]]
        none = sheets.form(level.depth, step, level.depth + offset, at)
        if level.depth > FIRST:
            lost |= none.any(axis=1)
        out[:, :, k] = sheets.depth - level.depth, offset, sheets.force
        if law is None:
            continue
        # force is measured at the points of the level; the plant knows it at its own places
        near = _nearest(places[k], level.path[level.place])
        measured.append(sheets.measured()[:, near])
        if any(level.depth - step < lift - SAME_DEPTH <= level.depth for lift in lifts):
            point = len(came_back) * max(len(near) // 4, 1) % len(near)
            model.append(next_loop.springback(level, np.minimum(measured[-1], level.loads[:, -1]))[:, point])
            came_back.append(sheets.lifted(level.depth, at)[:, near[point]])
            kappa = next_loop.kappa(np.stack(came_back, axis=1), np.stack(model, axis=1))
    corner = np.stack([cornered(known, one[:, :2]) for one in places])
    return Run(depth, out[0], out[1], out[2], corner, kappa, lost)


def _nearest(some: FloatArray, wanted: FloatArray) -> IntArray:
    """Which of ``some`` (S, 3) are nearest in plan to each of ``wanted`` (W, 3)."""
    return np.asarray(cKDTree(some[:, :2]).query(wanted[:, :2])[1], dtype=np.int64)


def require_shape(plan: LoopPlan, plant: PlantFile) -> None:
    """Raise ``TandemError`` (forming.loop_plant) where levels are not on the contours of a plant's shape."""
    known = truth(plant)
    for number in (0, len(plan.levels) // 2, len(plan.levels) - 1):
        level = plan.levels[number]
        off = off_contour(known, level.path[:, :2], level.depth)
        if off > ON_CONTOUR:
            what = (
                f"{plant.name}: level {number} of {plan.name} is up to {off / MM:.1f} mm off the contour of "
                f"the plant's {plant.sheet} at z = {level.depth / MM:.1f} mm, allowed {ON_CONTOUR / MM:g} mm"
            )
            hint = "give the plant curves of your part instead of sheet"
            raise refusal("forming.loop_plant", what, field="sheet", hint=hint)
