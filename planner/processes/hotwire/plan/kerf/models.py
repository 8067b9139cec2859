"""Models of the kerf (energy balance, general, measured, convection) and the largest power of a wire.

**energy**: energy balance in the foam. The heat of the wire melts a slot. A wire that emits P / L [W/m] and
moves at V melts at most the ideal width P / (L rho Cp (Tp - Ta) V). Test cuts show how the real slot differs:
kerf = chi * ideal - offset, with both numbers per foam. The interval is that of simple linear regression for
one new cut (Student's t, residual spread, distance from the mean of the tests).

**general**: kerf from the properties of a foam alone, for foams without test cuts. It is the energy balance
after subtraction of the heat that the wire loses into the foam that stays. Near a moving line source that
loss per length is proportional to conductivity times the rise to melting, which is the only quantity in [W/m]
that the foam offers. kerf = chi (P / L - lambda k (Tp - Ta)) / (rho Cp (Tp - Ta) V), with the same chi and
lambda for all foams: linear least squares over all valid cells of the dissertation's tables. The interval
comes from leaving one foam out at a time, because this is how the model is used.

**measured**: the energy balance plus a correction from measured cells nearby. The residuals of a foam's cells
are a Gaussian process over the logarithms of power per length and speed. Amplitude, noise and the pair of
correlation lengths are common to all foams and maximise the likelihood of the residuals. The model follows
the tables more closely than any smooth law, including their bumps over speed. It therefore has no inverse and
only serves cuts like those of the tests. Far from the cells it becomes the energy balance.
Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), section 2.2.

**convection**, the model of the dissertation: air that flows past the wire carries the heat into the foam.
Equations (8) to (19) of its chapter 3, as its calculated columns use them (docs/kerf.md lists where the print
differs): Nusselt number of a cylinder in cross flow (Churchill and Bernstein, without their last factor), air
at the film temperature, a fraction of the wire's radiation. All of it is spread over the thickness of the
foam, less the wire's diameter. The temperature of the wire is looked up over power per length. It is not
derived.

**Largest power** (`max_power`): the power at which a hot wire fails. No program, slot or hint asks for more.
A wire outside foam emits its whole power into air, and between cuts it is there for seconds. At its limit
temperature T it emits, per length,

    emissivity sigma pi d (T^4 - Ta^4) + pi Nu k (T - Ta)

by radiation (Stefan and Boltzmann) and to air of conductivity k, with a Nusselt number of 1. Thin wires in
still air have 0.4 to 0.8, so the bound is generous. T is the highest limit temperature of the built-in wire
materials, and k is that of the hottest air in the data.
"""

import dataclasses
import functools
import math
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri, stdtrit

from planner.catalogue import materials
from planner.catalogue.materials import ROOM_TEMPERATURE_C, FoamMaterial, KerfFit, Table
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issue_codes import format_message
from planner.issues import issue_error
from planner.processes.hotwire.plan.kerf import cut_measurements
from planner.processes.hotwire.plan.kerf.cut_measurements import CutMeasurements, HotWire

CONFIDENCE: Final = 0.90
"""Fraction of new cuts that an interval is meant to contain."""


def energy_width(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the kerf of the energy balance: expected, low and high [m], at least the diameter of the wire.

    Args:
        foam: Foam with test cuts.
        wire: The wire.
        power: Power over the heated length [W].
        speed: Speed of the wire [m/s].
        thickness: Not used by this model.
    """
    fit, melted = _required_fit(foam), ideal_width(foam, power / wire.length, speed)
    middle, half = fit.chi * melted - fit.offset, interval_half_width(fit, melted)
    low, middle, high = (np.maximum(middle + sign * half, wire.diameter) for sign in (-1.0, 0.0, 1.0))
    return middle, low, high


def energy_speed(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the speed [m/s] at which the energy balance gives a kerf. It is not positive if there is none.

    Args:
        foam: Foam with test cuts.
        wire: The wire.
        power: Power over the heated length [W].
        required: Required kerf [m].
        thickness: Not used by this model.
    """
    return power / wire.length / (heat_per_volume(foam) * _ideal_width_for(foam, required))


def energy_power(
    foam: FoamMaterial, wire: HotWire, speed: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the power [W] at which the energy balance gives a kerf. It is not positive if there is none.

    Args:
        foam: Foam with test cuts.
        wire: The wire.
        speed: Speed of the wire [m/s].
        required: Required kerf [m].
        thickness: Not used by this model.
    """
    return _ideal_width_for(foam, required) * heat_per_volume(foam) * speed * wire.length


def heat_per_volume(foam: FoamMaterial) -> float:
    """Return the heat per volume rho Cp (Tp - Ta) [J/m^3] from room temperature to melting."""
    if foam.specific_heat is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no specific heat or no melting temperature")
    return foam.density * foam.specific_heat * (foam.melt_temperature - ROOM_TEMPERATURE_C)


def ideal_width(foam: FoamMaterial, power_per_length: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the width of foam [m] that the whole power [W/m] heats to melting at a speed [m/s].

    The arguments broadcast.
    """
    return power_per_length / (heat_per_volume(foam) * speed)


def interval_half_width(fit: KerfFit, ideal_width: FloatArray | float) -> FloatArray:
    """Return half the length of the interval [m] that contains the kerf of one new cut of an ideal width [m].

    t s sqrt(1 + 1/n + (x - mean)^2 / scatter), with Student's t for n - 2 degrees of freedom.
    """
    quantile = float(stdtrit(fit.count - 2, 0.5 + 0.5 * CONFIDENCE))
    leverage = (ideal_width - fit.mean_ideal) ** 2 / fit.scatter
    return np.asarray(quantile * fit.spread * np.sqrt(1.0 + 1.0 / fit.count + leverage))


def _ideal_width_for(foam: FoamMaterial, required: FloatArray) -> FloatArray:
    """Return the ideal width [m] at which the fitted line gives a required kerf [m]."""
    fit = _required_fit(foam)
    return (required + fit.offset) / fit.chi


def _required_fit(foam: FoamMaterial) -> KerfFit:
    if foam.kerf is None:
        raise ValueError(f"foam {foam.name} has no test cuts")
    return foam.kerf


@dataclasses.dataclass(frozen=True)
class GeneralModelConstants:
    """Constants of the general model.

    Attributes:
        chi: Efficiency: factor from the ideal width to the kerf.
        chi_lambda: Product of chi and lambda, the factor on the heat that is lost into the foam.
        spread: Root mean square error [m] in the foams that were left out.
        count: Number of cells.
    """

    chi: float
    chi_lambda: float
    spread: float
    count: int


def general_width(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the kerf of the general model: expected, low and high [m], at least the diameter of the wire.

    Args:
        foam: Foam with its properties.
        wire: The wire.
        power: Power over the heated length [W].
        speed: Speed of the wire [m/s].
        thickness: Not used by this model.
    """
    fitted = general_constants()
    middle = fitted.chi * ideal_width(foam, power / wire.length, speed) - fitted.chi_lambda * conducted_width(
        foam, speed
    )
    half = float(stdtrit(fitted.count - 2, 0.5 + 0.5 * CONFIDENCE)) * fitted.spread
    low, middle, high = (np.maximum(middle + sign * half, wire.diameter) for sign in (-1.0, 0.0, 1.0))
    return middle, low, high


def general_speed(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the speed [m/s] at which the general model gives a kerf. It is not positive if there is none.

    Args:
        foam: Foam with its properties.
        wire: The wire.
        power: Power over the heated length [W].
        required: Required kerf [m].
        thickness: Not used by this model.
    """
    unit_speed, fitted = np.ones(()), general_constants()
    width_at_unit_speed = fitted.chi * ideal_width(
        foam, power / wire.length, unit_speed
    ) - fitted.chi_lambda * conducted_width(foam, unit_speed)
    return width_at_unit_speed / required


def general_power(
    foam: FoamMaterial, wire: HotWire, speed: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the power [W] at which the general model gives a kerf.

    Args:
        foam: Foam with its properties.
        wire: The wire.
        speed: Speed of the wire [m/s].
        required: Required kerf [m].
        thickness: Not used by this model.
    """
    fitted = general_constants()
    needed = (required + fitted.chi_lambda * conducted_width(foam, speed)) / fitted.chi
    return needed / ideal_width(foam, np.ones(()), speed) * wire.length


def conducted_width(foam: FoamMaterial, speed: FloatArray) -> FloatArray:
    """Return the width of foam [m] that the heat k (Tp - Ta) [W/m] would melt at a speed [m/s]."""
    if foam.conductivity is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no conductivity or no melting temperature")
    return ideal_width(
        foam, np.asarray(foam.conductivity * (foam.melt_temperature - materials.ROOM_TEMPERATURE_C)), speed
    )


@functools.lru_cache(maxsize=1)
def general_constants() -> GeneralModelConstants:
    """Return the constants fitted to all valid cells of the dissertation's tables.

    The spread is the error in each foam of a fit to the other foams.
    """
    cells = {name: table.valid for name, table in cut_measurements.dissertation_tables().items()}
    all_cells = fit_general(cells)
    errors = np.concatenate(
        [
            _held_out_error(
                fit_general({n: mask for n, mask in cells.items() if n != held_out}),
                held_out,
                cells[held_out],
            )
            for held_out in cells
        ]
    )
    return GeneralModelConstants(*all_cells, float(np.sqrt(np.mean(errors**2))), len(errors))


def fit_general(cells: dict[str, BoolArray]) -> tuple[float, float]:
    """Return chi and chi * lambda by least squares.

    Args:
        cells: Mask of the cells of the dissertation's tables to use, by foam.
    """
    rows, widths = zip(*(_regression_rows(name, mask) for name, mask in cells.items()), strict=True)
    chi, minus_chi_lambda = np.linalg.lstsq(np.concatenate(rows), np.concatenate(widths))[0]
    return float(chi), -float(minus_chi_lambda)


def _regression_rows(name: str, mask: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return ideal and conducted widths (N, 2) [m] of a foam's cells, and measured widths (N,) [m]."""
    table = cut_measurements.dissertation_tables()[name]
    foam = materials.foam(name)
    cuts = table.cuts.select(mask)
    columns = (ideal_width(foam, cuts.power_per_length, cuts.speed), conducted_width(foam, cuts.speed))
    return np.stack(columns, axis=1), cuts.width


def _held_out_error(fitted: tuple[float, float], name: str, mask: BoolArray) -> FloatArray:
    """Return model minus measured width (N,) [m] of a foam's cells, for chi and chi * lambda of others."""
    rows, widths = _regression_rows(name, mask)
    return np.asarray(rows @ np.array([fitted[0], -fitted[1]]) - widths)


@dataclasses.dataclass(frozen=True)
class GaussianProcessPrior:
    """Covariance parameters of the Gaussian process.

    Attributes:
        amplitude: Standard deviation of the residuals [m].
        noise: Standard deviation of a single cut [m].
        power_length: Correlation length in the natural logarithm of the power.
        speed_length: Correlation length in the natural logarithm of the speed.
    """

    amplitude: float
    noise: float
    power_length: float
    speed_length: float


CANDIDATE_AMPLITUDES_M: Final = (0.1e-3, 0.15e-3, 0.2e-3, 0.25e-3, 0.3e-3, 0.4e-3)
"""Candidate standard deviations of the model error [m]."""
CANDIDATE_NOISES_M: Final = (0.08e-3, 0.12e-3, 0.16e-3, 0.2e-3, 0.25e-3, 0.3e-3)
"""Candidate standard deviations of single cuts [m]."""
CANDIDATE_POWER_LENGTHS: Final = (0.15, 0.3, 0.6, 1.2)
"""Candidate correlation lengths in the logarithm of the power."""
CANDIDATE_SPEED_LENGTHS: Final = (0.1, 0.2, 0.3, 0.5, 0.8, 1.5)
"""Candidate correlation lengths in the logarithm of the speed."""


@dataclasses.dataclass(frozen=True)
class ResidualProcess:
    """Residuals of N cuts as a Gaussian process.

    Attributes:
        prior: Covariance parameters.
        inputs: Logarithms of power per length and speed (N, 2).
        weights: Inverse covariance times residuals (N,) [1/m].
        inverse: Inverse of the covariance of the residuals (N, N) [1/m^2].
    """

    prior: GaussianProcessPrior
    inputs: FloatArray
    weights: FloatArray
    inverse: FloatArray

    def at(self, power_per_length: FloatArray, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the expected residual [m] of one new cut and its standard deviation [m].

        The inputs broadcast. The deviation includes the noise of the cut. mean = K* C^-1 r, variance = a^2 -
        K* C^-1 K*^T + noise^2.
        """
        power, speed = np.broadcast_arrays(power_per_length, speed)
        query = _log_inputs(power.ravel(), speed.ravel())
        mean, variance = np.empty(len(query)), np.empty(len(query))
        for first in range(0, len(query), 4096):  # blocks that fit the processor's cache
            block = slice(first, first + 4096)
            covariance = _covariance(self.prior, query[block], self.inputs)
            mean[block] = covariance @ self.weights
            variance[block] = self.prior.amplitude**2 - np.sum(
                (covariance @ self.inverse) * covariance, axis=1
            )
        deviation = np.sqrt(np.maximum(variance, 0.0) + self.prior.noise**2)
        return mean.reshape(power.shape), deviation.reshape(power.shape)


def measured_width(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the kerf of the measured model: expected, low and high [m], at least the diameter of the wire.

    Args:
        foam: Foam of the dissertation's tables.
        wire: The wire.
        power: Power over the heated length [W].
        speed: Speed of the wire [m/s].
        thickness: Not used by this model.
    """
    if foam.kerf is None:
        raise ValueError(f"foam {foam.name} has no test cuts")
    law = foam.kerf.chi * ideal_width(foam, power / wire.length, speed) - foam.kerf.offset
    residual, deviation = residual_process(foam.name).at(power / wire.length, speed)
    half = float(ndtri(0.5 + 0.5 * CONFIDENCE)) * deviation
    low, middle, high = (np.maximum(law + residual + sign * half, wire.diameter) for sign in (-1.0, 0.0, 1.0))
    return middle, low, high


@functools.lru_cache(maxsize=16)
def residual_process(name: str) -> ResidualProcess:
    """Return the process of a built-in foam's residuals over its valid cells."""
    return fit_process(_valid_cuts(name), _residuals(name), prior())


@functools.lru_cache(maxsize=1)
def prior() -> GaussianProcessPrior:
    """Return the prior of maximum likelihood for all valid cells of the dissertation's tables."""
    names = cut_measurements.dissertation_tables()
    return max_likelihood_prior([(_valid_cuts(name), _residuals(name)) for name in names])


def fit_process(cuts: CutMeasurements, residuals: FloatArray, prior: GaussianProcessPrior) -> ResidualProcess:
    """Return the Gaussian process that is conditioned on the residuals (N,) [m] of N cuts."""
    inputs = _log_inputs(cuts.power_per_length, cuts.speed)
    covariance = _covariance(prior, inputs, inputs) + prior.noise**2 * np.eye(len(inputs))
    factor = cho_factor(covariance, lower=True)
    return ResidualProcess(
        prior, inputs, cho_solve(factor, residuals), cho_solve(factor, np.eye(len(inputs)))
    )


def max_likelihood_prior(sets: list[tuple[CutMeasurements, FloatArray]]) -> GaussianProcessPrior:
    """Return the combination of candidate parameters that maximises the likelihood of all residuals.

    Args:
        sets: Cuts and their residuals (N,) [m], for each foam.
    """
    best, best_score = None, np.inf
    for power_length in CANDIDATE_POWER_LENGTHS:
        for speed_length in CANDIDATE_SPEED_LENGTHS:
            # eigenvalues of the unit covariance, so that amplitude and noise need no new decomposition
            spectra = []
            for cuts, residuals in sets:
                inputs = _log_inputs(cuts.power_per_length, cuts.speed)
                unit = _covariance(GaussianProcessPrior(1.0, 0.0, power_length, speed_length), inputs, inputs)
                values, vectors = np.linalg.eigh(unit)
                spectra.append((values, (vectors.T @ residuals) ** 2))
            for amplitude in CANDIDATE_AMPLITUDES_M:
                for noise in CANDIDATE_NOISES_M:
                    score = sum(_negative_log_likelihood(v * amplitude**2 + noise**2, r) for v, r in spectra)
                    if score < best_score:
                        best = GaussianProcessPrior(amplitude, noise, power_length, speed_length)
                        best_score = score
    if best is None:
        raise ValueError("no residuals to choose a prior by")
    return best


def _negative_log_likelihood(variances: FloatArray, squares: FloatArray) -> float:
    """Return twice the negative log likelihood, up to a constant, of squared independent values."""
    return float(np.sum(np.log(variances) + squares / variances))


def _covariance(prior: GaussianProcessPrior, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the covariance (N, M) [m^2] of the model error, without noise, for inputs (N, 2) and (M, 2)."""
    power_gap, speed_gap = (first[:, None, k] - second[None, :, k] for k in (0, 1))
    squared_distance = (power_gap / prior.power_length) ** 2 + (speed_gap / prior.speed_length) ** 2
    return np.asarray(prior.amplitude**2 * np.exp(-0.5 * squared_distance))


def _log_inputs(power_per_length: FloatArray, speed: FloatArray) -> FloatArray:
    return np.stack([np.log(power_per_length), np.log(speed)], axis=1)


def _valid_cuts(name: str) -> CutMeasurements:
    table = cut_measurements.dissertation_tables()[name]
    return table.cuts.select(table.valid)


def _residuals(name: str) -> FloatArray:
    """Return measured width minus energy balance (N,) [m] of a foam's valid cells."""
    foam = materials.foam(name)
    cuts = _valid_cuts(name)
    if foam.kerf is None:
        raise ValueError(f"foam {name} has no test cuts")
    melted = ideal_width(foam, cuts.power_per_length, cuts.speed)
    return cuts.width - (foam.kerf.chi * melted - foam.kerf.offset)


STEFAN_BOLTZMANN: Final = 5.670374419e-8
"""Stefan-Boltzmann constant [W/(m^2 K^4)]. Source: CODATA 2018."""
EMISSIVITY: Final = 0.7
"""Emissivity of an oxidised Kanthal wire. Source: the dissertation."""
RADIATION_FRACTION: Final = 0.900
"""Factor on the radiation that the dissertation's calculated columns imply. Its text does not state it."""
MAX_POWER_PER_LENGTH_W_M: Final = 1000.0
"""Upper end of the search for a power [W/m]. Above it a thin wire melts."""


def convection_estimate(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the kerf of the convection model: expected, low and high [m].

    The interval follows from the RMS error of the model in the valid cells of the foam.

    Args:
        foam: Foam of the dissertation's tables.
        wire: The wire.
        power: Power over the heated length [W].
        speed: Speed of the wire [m/s].
        thickness: Thickness of the foam along the wire [m].
    """
    middle = convection_width(foam, wire, power, speed, thickness)
    error, count = calculated_width_rms(foam.name)
    half = float(stdtrit(count, 0.5 + 0.5 * CONFIDENCE)) * error
    return middle, middle - half, middle + half


def convection_width(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the kerf [m] of the convection model. It can be negative.

    A wire of diameter d that moves at v emits the heat q0 + q1 sqrt(v) into foam of thickness h and melting
    heat e per volume. The kerf is (q0 / v + q1 / sqrt(v)) / (e h) - d.

    Args:
        foam: Foam of the dissertation's tables.
        wire: The wire.
        power: Power over the heated length [W].
        speed: Speed of the wire [m/s].
        thickness: Thickness of the foam along the wire [m]. It broadcasts with power and speed.
    """
    heat_at_rest, heat_per_root_speed = _heat_flows(foam, wire, power)
    return (heat_at_rest / speed + heat_per_root_speed / np.sqrt(speed)) / (
        heat_per_volume(foam) * thickness
    ) - wire.diameter


def convection_speed(
    foam: FoamMaterial, wire: HotWire, power: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the speed [m/s] at which the convection model gives a kerf. It is quadratic in 1 / sqrt(speed).

    Args:
        foam: Foam of the dissertation's tables.
        wire: The wire.
        power: Power over the heated length [W].
        required: Required kerf [m].
        thickness: Thickness of the foam along the wire [m].
    """
    heat_at_rest, heat_per_root_speed = _heat_flows(foam, wire, power)
    needed = (required + wire.diameter) * heat_per_volume(foam) * thickness
    root = (np.sqrt(heat_per_root_speed**2 + 4.0 * heat_at_rest * needed) - heat_per_root_speed) / (
        2.0 * heat_at_rest
    )
    return np.asarray(root**-2.0)


def convection_power(
    foam: FoamMaterial, wire: HotWire, speed: FloatArray, required: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Return the power [W] at which the convection model gives a kerf, by bisection.

    It is NaN if no power per length up to `MAX_POWER_PER_LENGTH_W_M` gives this kerf.

    Args:
        foam: Foam of the dissertation's tables.
        wire: The wire.
        speed: Speed of the wire [m/s].
        required: Required kerf [m].
        thickness: Thickness of the foam along the wire [m].
    """
    shape = np.broadcast_shapes(speed.shape, required.shape, thickness.shape)
    low, high = np.full(shape, 1e-3 * wire.length), np.full(shape, MAX_POWER_PER_LENGTH_W_M * wire.length)
    upper_ok = convection_width(foam, wire, high, speed, thickness) >= required
    lower_ok = convection_width(foam, wire, low, speed, thickness) <= required
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_wide_enough = convection_width(foam, wire, middle, speed, thickness) >= required
        low, high = np.where(is_wide_enough, low, middle), np.where(is_wide_enough, middle, high)
    return np.where(upper_ok & lower_ok, 0.5 * (low + high), np.nan)


@functools.lru_cache(maxsize=16)
def calculated_width_rms(foam: str) -> tuple[float, int]:
    """Return the RMS [m] of calculated minus measured width over a foam's valid cells, and their number."""
    table = cut_measurements.dissertation_tables()[foam]
    error = (table.calculated - table.cuts.width)[table.valid]
    return float(np.sqrt(np.mean(error**2))), len(error)


def wire_rise(table: Table, power_per_length: FloatArray) -> FloatArray:
    """Return the temperature of the wire above room temperature [K].

    It is interpolated linearly between the powers of the tests, and extrapolated linearly beyond them.

    Args:
        table: Power per length [W/m] and temperature rise [K] of the tests.
        power_per_length: Power per length [W/m].
    """
    powers, rises = (np.array(column) for column in zip(*table, strict=True))
    piece = np.clip(np.searchsorted(powers, power_per_length) - 1, 0, len(powers) - 2)
    slope = np.diff(rises) / np.diff(powers)
    return np.asarray(rises[piece] + slope[piece] * (power_per_length - powers[piece]))


def _heat_flows(foam: FoamMaterial, wire: HotWire, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the two parts of the heat into the foam, q0 + q1 sqrt(v) at the speed v of the wire.

    Returns:
        q0 [W], which does not depend on the speed, and q1 [W sqrt(s/m)].
    """
    if foam.wire_rise is None or foam.radiation is None:
        raise ValueError(f"foam {foam.name} has no data of the dissertation's form")
    # air at the film temperature, the mean of room and wire
    temperature_rise = wire_rise(foam.wire_rise, power / wire.length)
    film = ROOM_TEMPERATURE_C + 0.5 * temperature_rise
    air = cut_measurements.air_table()
    density, capacity, conductivity, viscosity = (
        np.interp(film, air["temperature"], air[name])
        for name in ("density", "heat", "conductivity", "viscosity")
    )
    # Nu = 0.3 + 0.62 Re^1/2 Pr^1/3 / (1 + (0.4 / Pr)^2/3)^1/4 (Churchill and Bernstein, no last factor)
    prandtl = capacity * density * viscosity / conductivity
    reynolds_factor = 0.62 * np.cbrt(prandtl) / (1.0 + (0.4 / prandtl) ** (2.0 / 3.0)) ** 0.25
    conducted = wire.length * conductivity * temperature_rise
    surface = math.pi * wire.diameter * wire.length
    radiated = (
        foam.radiation * RADIATION_FRACTION * EMISSIVITY * surface * STEFAN_BOLTZMANN * temperature_rise**4
    )
    return 0.3 * conducted + radiated, conducted * reynolds_factor * np.sqrt(wire.diameter / viscosity)


STILL_AIR_NUSSELT: Final = 1.0
"""Nusselt number of the wire in still air. Assumed: thin wires have 0.4 to 0.8, so the bound is generous."""
ZERO_CELSIUS_K: Final = 273.15
"""Zero degrees Celsius [K]."""


def max_power(wire: HotWire) -> float:
    """Return the power [W] over the heated length that no wire material withstands in still air."""
    limit = most_heat_resistant_wire().limit_temperature
    hot, room = limit + ZERO_CELSIUS_K, materials.ROOM_TEMPERATURE_C + ZERO_CELSIUS_K
    conductivity = float(cut_measurements.air_table()["conductivity"].max())
    radiated = EMISSIVITY * STEFAN_BOLTZMANN * wire.diameter * (hot**4 - room**4)
    return math.pi * (radiated + STILL_AIR_NUSSELT * conductivity * (hot - room)) * wire.length


def most_heat_resistant_wire() -> materials.WireMaterial:
    """Return the wire material with the highest limit temperature."""
    return max(materials.wire_materials().values(), key=lambda wire: wire.limit_temperature)


def refuse_melting(foam: FoamMaterial, wire: HotWire, power: float) -> None:
    """Refuse a power [W] over the heated length that is above :func:`max_power`.

    Raises:
        TandemError: ``kerf.melts``.
    """
    limit = max_power(wire)
    if power <= limit:
        return
    best = most_heat_resistant_wire()
    text = format_message(
        "kerf.melts",
        power_w=power,
        diameter_mm=wire.diameter / MM,
        length_mm=wire.length / MM,
        max_power_w=limit,
        limit_temperature_c=best.limit_temperature,
        material=best.title,
    )
    hint = "use less power, or a longer or thicker wire"
    if foam.kerf is not None:
        low, high = (value * wire.length for value in foam.kerf.tests.power_per_length)
        hint += f"; over this length the test cuts in {foam.name} had {low:.3g} to {high:.3g} W"
    raise issue_error("kerf.melts", text, field="power_w", value=power, limit=limit, unit="W", hint=hint)
