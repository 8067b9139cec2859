"""Simulation of the correction from level to level on a plant: remaining errors of many sheets at once."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.loops import level_correction
from planner.loops.level_correction import CorrectionLaw
from planner.loops.loop_plan import LoopPlan
from planner.loops.plant import (
    MAX_CONTOUR_DISTANCE_M,
    PlantFile,
    PlantSheets,
    contour_distance,
    corner_fraction,
    plant_truth,
)

RUN_IN_DEPTH_M: Final = 2.0 * MM
"""Depth [m] down to which errors do not count, because the tool runs into the sheet."""
MAX_POSITIONS: Final = 48
"""Maximum number of positions around a sheet at which forming is simulated."""
DEPTH_TOLERANCE_M: Final = 1e-6
"""Maximum difference of depths that count as equal [m]."""


@dataclasses.dataclass(frozen=True)
class LoopRun:
    """Result of a simulation of N sheets, formed in M levels at J positions.

    Attributes:
        depth: Nominal depth of each level (M,) [m].
        error: Formed minus nominal depth after the tool has released the sheet (N, M, J) [m].
        offset: Offset of the path (N, M, J) [m].
        force: Force (N, M, J) [N].
        corner: Weight of a corner's springback at each position, 0 at walls (M, J) [-].
        kappa: Measured springback over that of the model, at the end (N,) [-].
        lost_contact: Whether a tool lost contact below `RUN_IN_DEPTH_M` (N,).
    """

    depth: FloatArray
    error: FloatArray
    offset: FloatArray
    force: FloatArray
    corner: FloatArray
    kappa: FloatArray
    lost_contact: BoolArray

    def max_error(self) -> FloatArray:
        """Return the largest absolute error (N,) [m] of each sheet below `RUN_IN_DEPTH_M`."""
        return np.asarray(np.abs(self.error[:, self.depth > RUN_IN_DEPTH_M]).max(axis=(1, 2)))

    def mean_error(self) -> FloatArray:
        """Return the mean absolute error (N,) [m] of each sheet below `RUN_IN_DEPTH_M`."""
        return np.asarray(np.abs(self.error[:, self.depth > RUN_IN_DEPTH_M]).mean(axis=(1, 2)))

    def final_mean_error(self) -> FloatArray:
        """Return the mean absolute error (N,) [m] of the last level."""
        return np.asarray(np.abs(self.error[:, -1]).mean(axis=1))


def run_loop(
    plan: LoopPlan,
    plant: PlantFile,
    law: CorrectionLaw | None,
    seeds: list[int],
    lifts: Sequence[float] = (),
    springback_shift: Sequence[FloatArray] | None = None,
) -> LoopRun:
    """Simulate the forming of sheets level by level, corrected by a law or not at all.

    Args:
        plan: The pass.
        plant: The plant.
        law: Correction law, or None for no correction.
        seeds: Seeds of the sheets (N,).
        lifts: Depths [m] at which the tool is lifted, so that the springback is measured there. Each time it
            is lifted a quarter of the path further along. The ratio of measured to modelled springback then
            corrects the following levels.
        springback_shift: For each level the amount by which a springback file has made its path deeper (K,)
            [m]; None without such a file. Offsets of the correction are added.

    Raises:
        TandemError: The levels do not have the shape of the plant (``forming.loop_plant``).
    """
    require_shape(plan, plant)
    levels = plan.levels
    path_indices = np.unique(np.linspace(0, len(levels[0].path), MAX_POSITIONS, endpoint=False).astype(int))
    # positions of each level: those nearest to the positions of the level before
    positions = [levels[0].path[path_indices]]
    position_indices = [path_indices]
    for level in levels[1:]:
        position_indices.append(_nearest_indices(level.path, positions[-1]))
        positions.append(level.path[position_indices[-1]])
    sheets = PlantSheets(plant, seeds, positions[0][:, :2])
    truth, count = plant_truth(plant), len(seeds)
    measured: list[FloatArray] = []
    measured_lifts: list[FloatArray] = []
    model_lifts: list[FloatArray] = []
    kappa = np.ones(count)
    last_offset: FloatArray | None = None
    out = np.zeros((3, count, len(levels), len(path_indices)))
    lost_contact = np.zeros(count, dtype=np.bool_)
    depth = np.array([level.depth for level in levels])
    for k, level in enumerate(levels):
        step = float(depth[k] - (depth[k - 1] if k else 0.0))
        plan_positions = positions[k][:, :2]
        shift = np.zeros(len(level.path)) if springback_shift is None else springback_shift[k]
        total_offset = np.broadcast_to(shift, (count, len(level.path)))
        if law is not None:
            path_offsets = level_correction.PathOffsets(last_offset, shift)
            correction = level_correction.level_correction(plan, law, k, measured, kappa, path_offsets)
            total_offset = total_offset + correction.offset
        last_offset, offset = total_offset[:, -1], total_offset[:, position_indices[k]]
        # no_contact (N, J): positions at which the tools do not touch the sheet
        no_contact = sheets.form_level(level.depth, step, level.depth + offset, plan_positions)
        if level.depth > RUN_IN_DEPTH_M:
            lost_contact |= no_contact.any(axis=1)
        out[:, :, k] = sheets.depth - level.depth, offset, sheets.force
        if law is None:
            continue
        # force is measured at the points of the level; the plant has it at its own positions
        nearest_position = _nearest_indices(positions[k], level.path[level.path_index])
        measured.append(sheets.measured_force()[:, nearest_position])
        if any(level.depth - step < lift - DEPTH_TOLERANCE_M <= level.depth for lift in lifts):
            point = len(measured_lifts) * max(len(nearest_position) // 4, 1) % len(nearest_position)
            model_lifts.append(
                level_correction.model_springback(level, np.minimum(measured[-1], level.loads[:, -1]))[
                    :, point
                ]
            )
            measured_lifts.append(
                sheets.measured_lift(level.depth, plan_positions)[:, nearest_position[point]]
            )
            kappa = level_correction.springback_ratio(
                np.stack(measured_lifts, axis=1), np.stack(model_lifts, axis=1)
            )
    corner = np.stack([corner_fraction(truth, level_positions[:, :2]) for level_positions in positions])
    return LoopRun(depth, out[0], out[1], out[2], corner, kappa, lost_contact)


def _nearest_indices(points: FloatArray, queries: FloatArray) -> IntArray:
    """Return the indices (W,) of the points (S, 3) that are nearest in plan view to each query (W, 3)."""
    return np.asarray(cKDTree(points[:, :2]).query(queries[:, :2])[1], dtype=np.int64)


def require_shape(plan: LoopPlan, plant: PlantFile) -> None:
    """Check that the first, middle and last level of a pass are on the contours of the plant's shape.

    Raises:
        TandemError: A level is too far from the contour at its depth (``forming.loop_plant``).
    """
    truth = plant_truth(plant)
    for number in (0, len(plan.levels) // 2, len(plan.levels) - 1):
        level = plan.levels[number]
        deviation = contour_distance(truth, level.path[:, :2], level.depth)
        if deviation > MAX_CONTOUR_DISTANCE_M:
            message = (
                f"{plant.name}: level {number} of {plan.name} is up to {deviation / MM:.1f} mm from the "
                f"contour of the plant's {plant.sheet} at z = {level.depth / MM:.1f} mm, allowed "
                f"{MAX_CONTOUR_DISTANCE_M / MM:g} mm"
            )
            hint = "state curves of your part in the plant instead of sheet"
            raise issue_error("forming.loop_plant", message, field="sheet", hint=hint)
