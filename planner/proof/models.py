"""Models of the cell as the programs have it, setup by setup."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from planner.cell.plant import CellModel, build
from planner.geometry.arrays import FloatArray
from planner.problem import TILT, Problem, setups_of
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.kinematics.external_axes import moved_on

Models = Callable[[int], CellModel]
"""The cell of a setup, by the setup's index."""


@dataclasses.dataclass(frozen=True)
class Standing:
    """Where the programs have what stands still, one value for each setup.

    Attributes:
        places: Frames (4, 4) of the stock, or None where nothing states one.
        bases: Base poses (4, 4) by arm.
        tilts: Values [rad] of the tilt axis of a positioner.
        axes: Values [m] of the axes under arms, by the name of the axis.
    """

    places: tuple[FloatArray | None, ...]
    bases: tuple[Mapping[str, FloatArray], ...]
    tilts: tuple[float, ...]
    axes: tuple[Mapping[str, float], ...]

    @staticmethod
    def of(context: Context) -> "Standing":
        """Read it from the programs."""
        return Standing(context.places, context.bases_by_setup, context.tilts, context.stands)


def cell_models(problem: Problem, standing: Standing, kept: dict[str, Any] | None = None) -> Models:
    """Return a function that gives the cell of a setup, with stock, bases and axes where the programs have
    them.

    Args:
        problem: Problem as it was given, from whose stations the axes are moved.
        standing: Where the programs have what stands still.
        kept: Models that were built before. It is filled.
    """
    built: dict[int, CellModel] = {} if kept is None else kept.setdefault("models", {})

    def model(index: int) -> CellModel:
        setup, place, bases = setups_of(problem)[index], standing.places[index], standing.bases[index]
        place = np.eye(4) if place is None else place
        if index not in built:
            built[index] = build(setup.cell, setup.stock, place, bases)
        found, table = built[index].with_stock(place).with_bases(bases), setup.cell.turntable
        here = {name: value for arm in setup.cell.arms for name, value in arm.stands.items()}
        found = found.with_moved(moved_on(setup.cell, standing.axes[index], here))
        if table is None or table.tilt is None:
            return found
        leans = found.stock.tilt or 0.0
        return found.with_moved({TILT: table.tilt.turned(np.eye(4), standing.tilts[index] - leans)})

    return functools.cache(model)


def _of_context(context: Context) -> Models:
    return cell_models(context.given, Standing.of(context), context.kept)


MODELS: Final[Fact[Context, Models]] = Fact("models", _of_context)
"""The models of a proof. Drake's part of them is kept between proofs."""
