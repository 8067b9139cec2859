"""chi and offset of a foam from test cuts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.hotwire import kerf_energy
from planner.hotwire.kerf_cuts import Cuts
from planner.issues import Issue, TandemError
from planner.materials import Foam, KerfFit, KerfTests

Array = NDArray[np.float64]


def least_squares(foam: Foam, cuts: Cuts, thickness: float, diameter: float) -> KerfFit:
    """Straight line through kerf over ideal width: every cut counts.

    ``foam`` gives density and heat, ``thickness`` and ``diameter`` [m] are those of the tests. Raises
    `TandemError` (kerf.few_cuts) without three cuts of two ideals.
    """
    ideal = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    return _line(cuts, ideal, np.ones(len(cuts)), thickness, diameter)


def _line(cuts: Cuts, ideal: Array, weights: Array, thickness: float, diameter: float) -> KerfFit:
    total = float(weights.sum())
    mean, mean_width = (float(weights @ values) / total if total else 0.0 for values in (ideal, cuts.width))
    scatter = float(weights @ (ideal - mean) ** 2)
    if len(cuts) < 3 or scatter <= 1e-6 * mean**2:
        raise TandemError(few(len(cuts)))
    chi = float(weights @ ((ideal - mean) * (cuts.width - mean_width))) / scatter
    residuals = cuts.width - mean_width - chi * (ideal - mean)
    return KerfFit(
        chi=chi,
        offset=chi * mean - mean_width,
        spread=float(np.sqrt(weights @ residuals**2 / (len(cuts) - 2))),
        count=len(cuts),
        mean_ideal=mean,
        scatter=scatter,
        tests=KerfTests(
            power_per_length=(float(cuts.power_per_length.min()), float(cuts.power_per_length.max())),
            speed=(float(cuts.speed.min()), float(cuts.speed.max())),
            thickness=thickness,
            wire_diameter=diameter,
        ),
    )


def few(count: int) -> Issue:
    """The refusal of too few cuts."""
    text = f"test cuts: got {count} that can be used, allowed at least 4 at two speeds or powers"
    return Issue("kerf.few_cuts", text, hint="cut the four squares of problems/kerf_test at two powers")
