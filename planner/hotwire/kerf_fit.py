"""chi and offset of a foam from test cuts."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from planner.hotwire import kerf_energy
from planner.hotwire.kerf_cuts import Cuts
from planner.hotwire.kerf_flag import DOMAIN
from planner.issues import Issue, TandemError
from planner.materials import Foam, KerfFit, KerfTests
from planner.units import MM

HUBER: Final = 1.345
"""Residuals beyond so many standard deviations count less: 95 % as good as least squares where none is wrong
(Huber, Robust Statistics, 1981)."""
TUKEY: Final = 4.685
"""Residuals beyond so many do not count, at the same efficiency (Beaton and Tukey, 1974)."""
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
    ideal = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    hot, cold = burnt, dragging & ~burnt
    known_hot, known_cold, known = hot, cold, hot | cold | good
    seen: set[bytes] = set()
    while True:
        kept = ~(hot | cold)
        fit = _draw(foam, cuts.only(kept), thickness, diameter, (int(hot.sum()), int(cold.sum())))
        expected = fit.chi * ideal - fit.offset
        now_hot = np.where(known, known_hot, expected > DOMAIN[1])
        now_cold = np.where(known, known_cold, expected < DOMAIN[0])
        if np.array_equal(now_hot, hot) and np.array_equal(now_cold, cold):
            break
        key = now_hot.tobytes() + now_cold.tobytes()
        if key in seen:  # it goes round: out stays what was out before or after
            now_hot, now_cold = now_hot | hot, (now_cold | cold) & ~(now_hot | hot)
            known_hot, known_cold, known = now_hot, now_cold, np.ones_like(known)
        seen.add(key)
        hot, cold = now_hot, now_cold
    slowest = cuts.speed[burnt].max() if np.any(burnt) else -np.inf
    burnt_speed = float(slowest) if np.any(burnt) and slowest < cuts.speed[kept].min() else None
    fit = dataclasses.replace(fit, tests=dataclasses.replace(fit.tests, burnt_speed=burnt_speed))
    return FitReport(fit, hot, cold, cuts.width - expected)


def _draw(foam: Foam, cuts: Cuts, thickness: float, diameter: float, left_out: tuple[int, int]) -> KerfFit:
    """Iteratively reweighted least squares, residuals scaled by their median: with Huber's weights from a
    plain line, then with Tukey's, under which readings far off do not count at all."""
    if len(cuts) < FEWEST:
        raise TandemError(_few(len(cuts), left_out))
    ideal = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    fit = _line(foam, cuts, np.ones(len(cuts)), thickness, diameter, left_out)
    scale = _scale(fit, ideal, cuts)
    for weigh in (_huber, _tukey):
        for _ in range(100):
            if scale < 1e-9:
                break
            weights = weigh((cuts.width - (fit.chi * ideal - fit.offset)) / scale)
            before, fit = fit, _line(foam, cuts, weights, thickness, diameter, left_out)
            scale = _scale(fit, ideal, cuts)
            if abs(fit.chi - before.chi) < 1e-9:
                break
    if fit.chi <= 0.0:
        text = f"test cuts: got a kerf that falls with power over speed (chi {fit.chi:.2f}), allowed a rise"
        raise TandemError(Issue("kerf.no_trend", text, hint="see to the columns and units of the file"))
    clipped = np.clip(cuts.width - (fit.chi * ideal - fit.offset), -HUBER * scale, HUBER * scale)
    spread = np.sqrt(np.sum(clipped**2) / (len(cuts) - 2) / _clipped_variance(HUBER))
    return dataclasses.replace(fit, spread=float(spread))


def _scale(fit: KerfFit, ideal: Array, cuts: Cuts) -> float:
    """Standard deviation [m] of normal residuals, from the median of their sizes."""
    return 1.4826 * float(np.median(np.abs(cuts.width - (fit.chi * ideal - fit.offset))))


def _huber(scaled: Array) -> Array:
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(np.abs(scaled), 1e-12)))


def _tukey(scaled: Array) -> Array:
    return np.asarray(np.maximum(1.0 - (scaled / TUKEY) ** 2, 0.0) ** 2)


def _clipped_variance(bound: float) -> float:
    """Variance of a standard normal value that is clipped at both sides."""
    inside = 2.0 * float(ndtr(bound)) - 1.0
    density = math.exp(-0.5 * bound**2) / math.sqrt(2.0 * math.pi)
    return inside - 2.0 * bound * density + bound**2 * (1.0 - inside)


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
