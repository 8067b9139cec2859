"""chi and offset of a foam from test cuts."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.hotwire import kerf_energy
from planner.hotwire.kerf_cuts import Cuts
from planner.hotwire.kerf_flag import DOMAIN
from planner.issues import Issue, TandemError
from planner.materials import Foam, KerfFit, KerfTests
from planner.units import MM

HUBER: Final = 1.345
"""Residuals beyond so many standard deviations count less: 95 % as good as least squares where none is wrong
(Huber, Robust Statistics, 1981)."""
FEWEST: Final = 4

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class FitReport:
    """``fit`` and how it came about: masks (N,) of the cuts left out as ``hot`` or ``cold``, ``residuals``
    (N,) [m], measured less fitted, of all cuts."""

    fit: KerfFit
    hot: Mask
    cold: Mask
    residuals: Array

    @property
    def kept(self) -> Mask:
        """The cuts that count."""
        return ~(self.hot | self.cold)


def least_squares(foam: Foam, cuts: Cuts, thickness: float, diameter: float) -> KerfFit:
    """Straight line through kerf over ideal width: every cut counts.

    ``foam`` gives density and heat, ``thickness`` and ``diameter`` [m] are those of the tests. Raises
    `TandemError`: kerf.few_cuts.
    """
    return _line(foam, cuts, np.ones(len(cuts)), thickness, diameter)


def robust(
    foam: Foam, cuts: Cuts, burnt: Mask, dragging: Mask, good: Mask, thickness: float, diameter: float
) -> FitReport:
    """Straight line that a few wrong readings do not turn, over the cuts that are neither ``burnt`` nor
    ``dragging`` (N,).

    Cuts that are not known to be ``good`` (N,) are left out too where the line itself gives a kerf outside
    0.8 to 3 mm, as too cold or too hot, and the line is drawn again until none is left; by the line and not
    by the reading, because choosing cuts by their readings would bend the line. Raises `TandemError`:
    kerf.few_cuts, kerf.no_trend.
    """
    hot, cold = burnt.copy(), dragging & ~burnt
    ideal = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    while True:
        kept = ~(hot | cold)
        fit = _huber(foam, cuts.only(kept), thickness, diameter, (int(hot.sum()), int(cold.sum())))
        expected = fit.chi * ideal - fit.offset
        newly_hot, newly_cold = kept & ~good & (expected > DOMAIN[1]), kept & ~good & (expected < DOMAIN[0])
        if not np.any(newly_hot | newly_cold):
            break
        hot, cold = hot | newly_hot, cold | newly_cold
    slowest = cuts.speed[burnt].max() if np.any(burnt) else -np.inf
    burnt_speed = float(slowest) if np.any(burnt) and slowest < cuts.speed[kept].min() else None
    fit = dataclasses.replace(fit, tests=dataclasses.replace(fit.tests, burnt_speed=burnt_speed))
    return FitReport(fit, hot, cold, cuts.width - expected)


def _huber(foam: Foam, cuts: Cuts, thickness: float, diameter: float, left_out: tuple[int, int]) -> KerfFit:
    """Iteratively reweighted least squares from a plain line, with the median of residuals as their
    scale."""
    if len(cuts) < FEWEST:
        raise TandemError(_few(len(cuts), left_out))
    weights = np.ones(len(cuts))
    ideal = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    fit = _line(foam, cuts, weights, thickness, diameter, left_out)
    for _ in range(100):
        size = np.abs(cuts.width - (fit.chi * ideal - fit.offset))
        scale = 1.4826 * float(np.median(size))
        if scale < 1e-9:
            break
        weights = np.minimum(1.0, HUBER * scale / np.maximum(size, 1e-12))
        before, fit = fit, _line(foam, cuts, weights, thickness, diameter, left_out)
        if abs(fit.chi - before.chi) < 1e-9:
            break
    if fit.chi <= 0.0:
        text = f"test cuts: got a kerf that falls with power over speed (chi {fit.chi:.2f}), allowed a rise"
        raise TandemError(Issue("kerf.no_trend", text, hint="see to the columns and units of the file"))
    return fit


def _line(
    foam: Foam,
    cuts: Cuts,
    weights: Array,
    thickness: float,
    diameter: float,
    left_out: tuple[int, int] = (0, 0),
) -> KerfFit:
    if len(cuts) < 3:
        raise TandemError(_few(len(cuts), left_out))
    ideal = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    total = float(weights.sum())
    mean, mean_width = float(weights @ ideal) / total, float(weights @ cuts.width) / total
    scatter = float(weights @ (ideal - mean) ** 2)
    if scatter <= 1e-6 * total * mean**2:
        raise TandemError(_few(len(cuts), left_out))
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


def _few(count: int, left_out: tuple[int, int]) -> Issue:
    hot, cold = left_out
    text = (
        f"test cuts: got {count} that can be used ({hot} too hot, {cold} too cold left out), "
        f"allowed {FEWEST} or more, at two speeds or powers at least"
    )
    wanted = f"{DOMAIN[0] / MM:g} to {DOMAIN[1] / MM:g} mm"
    hint = f"cut squares whose kerf is {wanted}, at two powers and four speeds"
    return Issue("kerf.few_cuts", text, value=float(count), limit=float(FEWEST), hint=hint)
