"""The energy balance plus what the measured cells near by still differ from it.

The residuals of a foam's cells are taken as a Gaussian process over the logarithms of power per length and
speed, with one amplitude, noise and pair of lengths for all foams, chosen by the likelihood of the
residuals. It follows the tables more closely than any smooth law, and with them their bumps over speed; so
it has no inverse and only serves cuts like the tests'. Far from the cells it becomes the energy balance.
After Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), section 2.2.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri

from planner import materials
from planner.hotwire import kerf_cuts, kerf_energy
from planner.hotwire.kerf_cuts import Cuts
from planner.hotwire.kerf_wire import HotWire
from planner.materials import Foam

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Prior:
    """``amplitude`` and ``noise`` [m]; lengths over the natural logarithms of power and speed."""

    amplitude: float
    noise: float
    power_length: float
    speed_length: float


AMPLITUDES: Final = (0.1e-3, 0.15e-3, 0.2e-3, 0.25e-3, 0.3e-3, 0.4e-3)
NOISES: Final = (0.08e-3, 0.12e-3, 0.16e-3, 0.2e-3, 0.25e-3, 0.3e-3)
POWER_LENGTHS: Final = (0.15, 0.3, 0.6, 1.2)
SPEED_LENGTHS: Final = (0.1, 0.2, 0.3, 0.5, 0.8, 1.5)
"""The priors among which the likelihood chooses."""


@dataclasses.dataclass(frozen=True)
class Field:
    """Residuals as a process: ``places`` (N, 2) logarithms of power per length and speed, ``weights`` (N,)
    [1/m] and ``inverse`` (N, N) [1/m^2] of the residuals' covariance."""

    prior: Prior
    places: Array
    weights: Array
    inverse: Array

    def at(self, power_per_length: Array, speed: Array) -> tuple[Array, Array]:
        """Expected residual [m] and its standard deviation with the noise of one new cut [m]."""
        power, speed = np.broadcast_arrays(power_per_length, speed)
        new = _places(power.ravel(), speed.ravel())
        mean, variance = np.empty(len(new)), np.empty(len(new))
        for first in range(0, len(new), 4096):  # what fits the processor's cache goes at once
            some = slice(first, first + 4096)
            near = _covariance(self.prior, new[some], self.places)
            mean[some] = near @ self.weights
            variance[some] = self.prior.amplitude**2 - np.sum((near @ self.inverse) * near, axis=1)
        deviation = np.sqrt(np.maximum(variance, 0.0) + self.prior.noise**2)
        return mean.reshape(power.shape), deviation.reshape(power.shape)


def width(
    foam: Foam, wire: HotWire, power: Array, speed: Array, thickness: Array
) -> tuple[Array, Array, Array]:
    """Kerf expected, low and high [m] at a power [W] and speed [m/s]; the foam's thickness plays no part."""
    if foam.kerf is None:
        raise ValueError(f"foam {foam.name} has no test cuts")
    law = foam.kerf.chi * kerf_energy.ideal(foam, power / wire.length, speed) - foam.kerf.offset
    residual, deviation = field(foam.name).at(power / wire.length, speed)
    half = float(ndtri(0.5 + 0.5 * kerf_energy.LEVEL)) * deviation
    low, middle, high = (np.maximum(law + residual + s * half, wire.diameter) for s in (-1.0, 0.0, 1.0))
    return middle, low, high


@functools.lru_cache(maxsize=16)
def field(name: str) -> Field:
    """The process of a built-in foam's residuals, over its valid cells."""
    return process(_cuts(name), _residuals(name), prior())


@functools.lru_cache(maxsize=1)
def prior() -> Prior:
    """The likeliest prior for all valid cells of the tables that come with Tandem."""
    names = kerf_cuts.dissertation_tables()
    return likeliest([(_cuts(name), _residuals(name)) for name in names])


def process(cuts: Cuts, residuals: Array, chosen: Prior) -> Field:
    """The process of the residuals (N,) [m] of cuts (N,)."""
    places = _places(cuts.power_per_length, cuts.speed)
    total = _covariance(chosen, places, places) + chosen.noise**2 * np.eye(len(places))
    factor = cho_factor(total, lower=True)
    return Field(chosen, places, cho_solve(factor, residuals), cho_solve(factor, np.eye(len(places))))


def likeliest(sets: list[tuple[Cuts, Array]]) -> Prior:
    """Of the priors on the grid, the one under which the residuals of all foams are likeliest."""
    best, least = None, np.inf
    for power_length in POWER_LENGTHS:
        for speed_length in SPEED_LENGTHS:
            shapes = []
            for cuts, residuals in sets:
                places = _places(cuts.power_per_length, cuts.speed)
                unit = _covariance(Prior(1.0, 0.0, power_length, speed_length), places, places)
                values, vectors = np.linalg.eigh(unit)
                shapes.append((values, (vectors.T @ residuals) ** 2))
            for amplitude in AMPLITUDES:
                for noise in NOISES:
                    score = sum(_unlikely(v * amplitude**2 + noise**2, r) for v, r in shapes)
                    if score < least:
                        best, least = Prior(amplitude, noise, power_length, speed_length), score
    if best is None:
        raise ValueError("no residuals to choose a prior by")
    return best


def _unlikely(variances: Array, squares: Array) -> float:
    return float(np.sum(np.log(variances) + squares / variances))


def _covariance(chosen: Prior, first: Array, second: Array) -> Array:
    power, speed = (first[:, None, k] - second[None, :, k] for k in (0, 1))
    away = (power / chosen.power_length) ** 2 + (speed / chosen.speed_length) ** 2
    return np.asarray(chosen.amplitude**2 * np.exp(-0.5 * away))


def _places(power_per_length: Array, speed: Array) -> Array:
    return np.stack([np.log(power_per_length), np.log(speed)], axis=1)


def _cuts(name: str) -> Cuts:
    table = kerf_cuts.dissertation_tables()[name]
    return table.cuts.only(table.valid)


def _residuals(name: str) -> Array:
    foam, cuts = materials.foam(name), _cuts(name)
    if foam.kerf is None:
        raise ValueError(f"foam {name} has no test cuts")
    melted = kerf_energy.ideal(foam, cuts.power_per_length, cuts.speed)
    return cuts.width - (foam.kerf.chi * melted - foam.kerf.offset)
