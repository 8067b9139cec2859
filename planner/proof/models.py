"""Models of the cell as the programs have it, setup by setup."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from planner.cell.plant import CellModel, build_cell_model
from planner.geometry.arrays import FloatArray
from planner.problem import TILT_AXIS, Problem, all_setups
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.kinematics.external_axes import carried_motions

Models = Callable[[int], CellModel]
"""Function for the cell model of a setup, by the setup's index."""


@dataclasses.dataclass(frozen=True)
class StationaryPoses:
    """Poses of stationary bodies according to the programs, one value for each setup.

    Attributes:
        stock_frames: Frames (4, 4) of the stock, or None if nothing states one.
        bases: Base poses (4, 4) by arm.
        tilts: Values [rad] of the tilt axis of a positioner.
        axes: Values [m] of the axes that carry arms, by the name of the axis.
    """

    stock_frames: tuple[FloatArray | None, ...]
    bases: tuple[Mapping[str, FloatArray], ...]
    tilts: tuple[float, ...]
    axes: tuple[Mapping[str, float], ...]

    @staticmethod
    def of(context: Context) -> "StationaryPoses":
        """Take the poses from the programs."""
        return StationaryPoses(
            context.stock_frames, context.base_poses_by_setup, context.tilts, context.axis_values
        )


def cell_models(problem: Problem, stationary: StationaryPoses, cache: dict[str, Any] | None = None) -> Models:
    """Return a function for the cell model of a setup.

    In the model, stock, bases and axes have the poses that the programs state.

    Args:
        problem: Problem as it was given. Bodies on axes are moved from its stations to those of the programs.
        stationary: Poses of stationary bodies according to the programs.
        cache: Dictionary that keeps the models between proofs. Models that are built are added.
    """
    built: dict[int, CellModel] = {} if cache is None else cache.setdefault("models", {})

    def model(index: int) -> CellModel:
        """Return the cell model of the setup with this index, with stock and axes where they stand."""
        setup = all_setups(problem)[index]
        frame = stationary.stock_frames[index]
        bases = stationary.bases[index]
        frame = np.eye(4) if frame is None else frame
        if index not in built:
            built[index] = build_cell_model(setup.cell, setup.stock, frame, bases)
        cell_model, table = built[index].with_stock(frame).with_bases(bases), setup.cell.turntable
        axis_values = {name: value for arm in setup.cell.arms for name, value in arm.axis_values.items()}
        cell_model = cell_model.with_axis_motions(
            carried_motions(setup.cell, stationary.axes[index], axis_values)
        )
        if table is None or table.tilt is None:
            return cell_model
        tilt = cell_model.stock.tilt or 0.0
        return cell_model.with_axis_motions(
            {TILT_AXIS: table.tilt.rotate(np.eye(4), stationary.tilts[index] - tilt)}
        )

    return functools.cache(model)


def _of_context(context: Context) -> Models:
    """Return the models of a proof, with stock, bases and axes where its programs have them."""
    return cell_models(context.given_problem, StationaryPoses.of(context), context.cache)


MODELS: Final[Fact[Context, Models]] = Fact("models", _of_context)
"""The models of a proof. Drake's part of them is kept between proofs."""
