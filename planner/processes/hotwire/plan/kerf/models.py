"""Models of the kerf: energy balance, general, measured, convection; and a wire's largest power.

**energy**: the energy balance in the foam; what the wire gives off melts a slot. A wire that gives
P / L [W/m] and moves at V melts at most the ideal width P / (L rho Cp (Tp - Ta) V). Test cuts say
how far the real slot is from it: kerf = chi * ideal - offset, with both numbers per foam. The
interval is that of simple linear regression for one new cut (Student's t, residual spread, distance
from the tests' mean).

**general**: a kerf from a foam's properties alone, for foams that nobody has cut yet. As the energy
balance, but what the wire loses into the foam that stays is taken off first: near a moving line
source that loss per length goes with conductivity times the rise to melting, the only [W/m] that
the foam offers. kerf = chi (P / L - lambda k (Tp - Ta)) / (rho Cp (Tp - Ta) V), with chi and lambda
the same for all foams: least squares, which is linear here, over all valid cells of the
dissertation's tables. The interval comes from leaving one foam out at a time, because that is how
the form is used.

**measured**: the energy balance plus what the measured cells near by still differ from it. The
residuals of a foam's cells are taken as a Gaussian process over the logarithms of power per length
and speed, with one amplitude, noise and pair of lengths for all foams, chosen by the likelihood of
the residuals. It follows the tables more closely than any smooth law, and with them their bumps
over speed; so it has no inverse and only serves cuts like the tests'. Far from the cells it becomes
the energy balance. After Rasmussen and Williams, Gaussian Processes for Machine Learning (2006),
section 2.2.

**convection**, the dissertation's form: air that streams past the wire carries the heat into the
foam. Equations (8) to (19) of its chapter 3, as its calculated columns use them (docs/kerf.md lists
what the print has otherwise): Nusselt number of a cylinder in cross flow (Churchill and
Bernstein's, without their last factor), air at the film temperature, a share of the wire's
radiation, all of it spread over the foam's thickness, less the wire's diameter. The wire's
temperature is looked up over power per length; it is not derived.

**Largest power** (`most_power`): the power at which a hot wire fails; no program, slot or advice
asks for more. A wire that is not in foam gives its whole power to the air, and on its ways between
cuts it is there for seconds. At its limit temperature T it gives off, per length,

    emissivity sigma pi d (T^4 - Ta^4) + pi Nu k (T - Ta)

by radiation (Stefan and Boltzmann) and to air of conductivity k, with a Nusselt number of 1: thin
wires in still air have 0.4 to 0.8, so that the bound is a generous one. T is the highest limit
temperature of the wire materials that are built in, k that of the hottest air in the data.
"""

import dataclasses
import functools
import math
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri, stdtrit

from planner.catalogue import materials
from planner.catalogue.materials import ROOM_TEMPERATURE, Foam, KerfFit, Table
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.units import MM
from planner.issues import refusal
from planner.processes.hotwire.plan.kerf import test_cuts
from planner.processes.hotwire.plan.kerf.test_cuts import Cuts, HotWire

CONFIDENCE: Final = 0.90
"""Share of new cuts that an interval is meant to hold."""


def energy_width(
    foam: Foam, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Kerf expected, low and high [m] at a power [W] and speed [m/s], nowhere below the wire's diameter; the
    foam's thickness plays no part."""
    fit, melted = _fit(foam), ideal(foam, power / wire.length, speed)
    middle, half = fit.chi * melted - fit.offset, margin(fit, melted)
    low, middle, high = (np.maximum(middle + s * half, wire.diameter) for s in (-1.0, 0.0, 1.0))
    return middle, low, high


def energy_speed(
    foam: Foam, wire: HotWire, power: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Speed [m/s] of a kerf [m]; not above 0 where none gives it."""
    return power / wire.length / (heat(foam) * _ideal_for(foam, wanted))


def energy_power(
    foam: Foam, wire: HotWire, speed: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Power [W] of a kerf [m]; not above 0 where none gives it."""
    return _ideal_for(foam, wanted) * heat(foam) * speed * wire.length


def heat(foam: Foam) -> float:
    """Heat [J/m^3] that takes the foam from the room's temperature to melting."""
    if foam.specific_heat is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no specific heat or no melting temperature")
    return foam.density * foam.specific_heat * (foam.melt_temperature - ROOM_TEMPERATURE)


def ideal(foam: Foam, power_per_length: FloatArray, speed: FloatArray) -> FloatArray:
    """Width [m] of the foam that the whole power [W/m] heats to melting at the speed [m/s]; they
    broadcast."""
    return power_per_length / (heat(foam) * speed)


def margin(fit: KerfFit, ideal_width: FloatArray | float) -> FloatArray:
    """Half the interval [m] for one new cut of an ideal width [m]."""
    quantile = float(stdtrit(fit.count - 2, 0.5 + 0.5 * CONFIDENCE))
    away = (ideal_width - fit.mean_ideal) ** 2 / fit.scatter
    return np.asarray(quantile * fit.spread * np.sqrt(1.0 + 1.0 / fit.count + away))


def _ideal_for(foam: Foam, wanted: FloatArray) -> FloatArray:
    fit = _fit(foam)
    return (wanted + fit.offset) / fit.chi


def _fit(foam: Foam) -> KerfFit:
    if foam.kerf is None:
        raise ValueError(f"foam {foam.name} has no test cuts")
    return foam.kerf


@dataclasses.dataclass(frozen=True)
class Constants:
    """``chi``, and ``chi_lambda`` its product with lambda; ``spread`` [m], root mean square of the error in
    foams left out, over ``count`` cells."""

    chi: float
    chi_lambda: float
    spread: float
    count: int


def general_width(
    foam: Foam, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Kerf expected, low and high [m] at a power [W] and speed [m/s]; the foam's thickness plays no part."""
    found = constants()
    middle = found.chi * ideal(foam, power / wire.length, speed) - found.chi_lambda * conducted(foam, speed)
    half = float(stdtrit(found.count - 2, 0.5 + 0.5 * CONFIDENCE)) * found.spread
    low, middle, high = (np.maximum(middle + s * half, wire.diameter) for s in (-1.0, 0.0, 1.0))
    return middle, low, high


def general_speed(
    foam: Foam, wire: HotWire, power: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Speed [m/s] of a kerf [m]; not above 0 where none gives it."""
    one, found = np.ones(()), constants()
    here = found.chi * ideal(foam, power / wire.length, one) - found.chi_lambda * conducted(foam, one)
    return here / wanted


def general_power(
    foam: Foam, wire: HotWire, speed: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Power [W] of a kerf [m]."""
    found = constants()
    needed = (wanted + found.chi_lambda * conducted(foam, speed)) / found.chi
    return needed / ideal(foam, np.ones(()), speed) * wire.length


def conducted(foam: Foam, speed: FloatArray) -> FloatArray:
    """Width [m] of foam that the heat k (Tp - Ta) [W/m] would melt."""
    if foam.conductivity is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no conductivity or no melting temperature")
    return ideal(
        foam, np.asarray(foam.conductivity * (foam.melt_temperature - materials.ROOM_TEMPERATURE)), speed
    )


@functools.lru_cache(maxsize=1)
def constants() -> Constants:
    """Fitted to the tables that come with Tandem."""
    cells = {name: table.valid for name, table in test_cuts.dissertation_tables().items()}
    every = fit_general(cells)
    errors = np.concatenate(
        [
            _error(fit_general({n: mask for n, mask in cells.items() if n != one}), one, cells[one])
            for one in cells
        ]
    )
    return Constants(*every, float(np.sqrt(np.mean(errors**2))), len(errors))


def fit_general(cells: dict[str, BoolArray]) -> tuple[float, float]:
    """chi and chi * lambda by least squares on some cells (foam to mask) of the dissertation's tables."""
    rows, widths = zip(*(_rows(name, mask) for name, mask in cells.items()), strict=True)
    chi, minus = np.linalg.lstsq(np.concatenate(rows), np.concatenate(widths))[0]
    return float(chi), -float(minus)


def _rows(name: str, mask: BoolArray) -> tuple[FloatArray, FloatArray]:
    table, foam = test_cuts.dissertation_tables()[name], materials.foam(name)
    cuts = table.cuts.only(mask)
    columns = (ideal(foam, cuts.power_per_length, cuts.speed), conducted(foam, cuts.speed))
    return np.stack(columns, axis=1), cuts.width


def _error(found: tuple[float, float], name: str, mask: BoolArray) -> FloatArray:
    rows, widths = _rows(name, mask)
    return np.asarray(rows @ np.array([found[0], -found[1]]) - widths)


@dataclasses.dataclass(frozen=True)
class Prior:
    """``amplitude`` and ``noise`` [m]; lengths over the natural logarithms of power and speed."""

    amplitude: float
    noise: float
    power_length: float
    speed_length: float


AMPLITUDES: Final = (0.1e-3, 0.15e-3, 0.2e-3, 0.25e-3, 0.3e-3, 0.4e-3)
"""Standard deviations [m] of what the model misses, among which the likelihood chooses."""
NOISES: Final = (0.08e-3, 0.12e-3, 0.16e-3, 0.2e-3, 0.25e-3, 0.3e-3)
"""Standard deviations [m] of single cuts, among which it chooses."""
POWER_LENGTHS: Final = (0.15, 0.3, 0.6, 1.2)
"""Correlation lengths in the logarithm of the power, among which it chooses."""
SPEED_LENGTHS: Final = (0.1, 0.2, 0.3, 0.5, 0.8, 1.5)
"""Correlation lengths in the logarithm of the speed, among which it chooses."""


@dataclasses.dataclass(frozen=True)
class Field:
    """Residuals as a process: ``places`` (N, 2) logarithms of power per length and speed, ``weights`` (N,)
    [1/m] and ``inverse`` (N, N) [1/m^2] of the residuals' covariance."""

    prior: Prior
    places: FloatArray
    weights: FloatArray
    inverse: FloatArray

    def at(self, power_per_length: FloatArray, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
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


def measured_width(
    foam: Foam, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Kerf expected, low and high [m] at a power [W] and speed [m/s]; the foam's thickness plays no part."""
    if foam.kerf is None:
        raise ValueError(f"foam {foam.name} has no test cuts")
    law = foam.kerf.chi * ideal(foam, power / wire.length, speed) - foam.kerf.offset
    residual, deviation = field(foam.name).at(power / wire.length, speed)
    half = float(ndtri(0.5 + 0.5 * CONFIDENCE)) * deviation
    low, middle, high = (np.maximum(law + residual + s * half, wire.diameter) for s in (-1.0, 0.0, 1.0))
    return middle, low, high


@functools.lru_cache(maxsize=16)
def field(name: str) -> Field:
    """The process of a built-in foam's residuals, over its valid cells."""
    return process(_cuts(name), _residuals(name), prior())


@functools.lru_cache(maxsize=1)
def prior() -> Prior:
    """The likeliest prior for all valid cells of the tables that come with Tandem."""
    names = test_cuts.dissertation_tables()
    return likeliest([(_cuts(name), _residuals(name)) for name in names])


def process(cuts: Cuts, residuals: FloatArray, chosen: Prior) -> Field:
    """The process of the residuals (N,) [m] of cuts (N,)."""
    places = _places(cuts.power_per_length, cuts.speed)
    total = _covariance(chosen, places, places) + chosen.noise**2 * np.eye(len(places))
    factor = cho_factor(total, lower=True)
    return Field(chosen, places, cho_solve(factor, residuals), cho_solve(factor, np.eye(len(places))))


def likeliest(sets: list[tuple[Cuts, FloatArray]]) -> Prior:
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


def _unlikely(variances: FloatArray, squares: FloatArray) -> float:
    return float(np.sum(np.log(variances) + squares / variances))


def _covariance(chosen: Prior, first: FloatArray, second: FloatArray) -> FloatArray:
    power, speed = (first[:, None, k] - second[None, :, k] for k in (0, 1))
    away = (power / chosen.power_length) ** 2 + (speed / chosen.speed_length) ** 2
    return np.asarray(chosen.amplitude**2 * np.exp(-0.5 * away))


def _places(power_per_length: FloatArray, speed: FloatArray) -> FloatArray:
    return np.stack([np.log(power_per_length), np.log(speed)], axis=1)


def _cuts(name: str) -> Cuts:
    table = test_cuts.dissertation_tables()[name]
    return table.cuts.only(table.valid)


def _residuals(name: str) -> FloatArray:
    foam, cuts = materials.foam(name), _cuts(name)
    if foam.kerf is None:
        raise ValueError(f"foam {name} has no test cuts")
    melted = ideal(foam, cuts.power_per_length, cuts.speed)
    return cuts.width - (foam.kerf.chi * melted - foam.kerf.offset)


STEFAN_BOLTZMANN: Final = 5.670374419e-8
"""[W/(m^2 K^4)], CODATA 2018."""
EMISSIVITY: Final = 0.7
"""Of an oxidised Kanthal wire; the dissertation's figure."""
RADIATING_SHARE: Final = 0.900
"""Factor on the radiation that its calculated columns imply and its text does not state."""
MAX_POWER_PER_LENGTH: Final = 1000.0
"""Beyond this [W/m] a thin wire melts; no power above it is looked for."""


def convection_estimate(
    foam: Foam, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Kerf expected, low and high [m]; the interval is the error in the foam's own valid cells."""
    middle = convection_width(foam, wire, power, speed, thickness)
    error, count = spread(foam.name)
    half = float(stdtrit(count, 0.5 + 0.5 * CONFIDENCE)) * error
    return middle, middle - half, middle + half


def convection_width(
    foam: Foam, wire: HotWire, power: FloatArray, speed: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Kerf [m] at ``power`` [W], ``speed`` [m/s] and foam ``thickness`` [m]; they broadcast. It may be
    negative, as the form is."""
    still, moving = _heat_flows(foam, wire, power)
    return (still / speed + moving / np.sqrt(speed)) / (heat(foam) * thickness) - wire.diameter


def convection_speed(
    foam: Foam, wire: HotWire, power: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Speed [m/s] that gives the kerf ``wanted`` [m]: the form is quadratic in 1 / sqrt(speed)."""
    still, moving = _heat_flows(foam, wire, power)
    needed = (wanted + wire.diameter) * heat(foam) * thickness
    root = (np.sqrt(moving**2 + 4.0 * still * needed) - moving) / (2.0 * still)
    return np.asarray(root**-2.0)


def convection_power(
    foam: Foam, wire: HotWire, speed: FloatArray, wanted: FloatArray, thickness: FloatArray
) -> FloatArray:
    """Power [W] that gives the kerf ``wanted`` [m], by bisection: the form has no closed inverse in power,
    but grows with it. NaN where no power up to `MAX_POWER_PER_LENGTH` does."""
    shape = np.broadcast_shapes(speed.shape, wanted.shape, thickness.shape)
    low, high = np.full(shape, 1e-3 * wire.length), np.full(shape, MAX_POWER_PER_LENGTH * wire.length)
    reached = convection_width(foam, wire, high, speed, thickness) >= wanted
    started = convection_width(foam, wire, low, speed, thickness) <= wanted
    for _ in range(60):
        middle = 0.5 * (low + high)
        wide = convection_width(foam, wire, middle, speed, thickness) >= wanted
        low, high = np.where(wide, low, middle), np.where(wide, middle, high)
    return np.where(reached & started, 0.5 * (low + high), np.nan)


@functools.lru_cache(maxsize=16)
def spread(foam: str) -> tuple[float, int]:
    """Root mean square [m] of calculated less measured over a foam's valid cells, and how many these are."""
    table = test_cuts.dissertation_tables()[foam]
    error = (table.calculated - table.cuts.width)[table.valid]
    return float(np.sqrt(np.mean(error**2))), len(error)


def wire_rise(table: Table, power_per_length: FloatArray) -> FloatArray:
    """Temperature [K] of the wire above the room's over power per length [W/m]: linear between the tests'
    four powers, and on along the outermost pieces beyond them."""
    places, values = (np.array(column) for column in zip(*table, strict=True))
    piece = np.clip(np.searchsorted(places, power_per_length) - 1, 0, len(places) - 2)
    slope = np.diff(values) / np.diff(places)
    return np.asarray(values[piece] + slope[piece] * (power_per_length - places[piece]))


def _heat_flows(foam: Foam, wire: HotWire, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heat [W] that goes into the foam at any speed, and what comes to it per sqrt(speed) [W sqrt(s/m)]."""
    if foam.wire_rise is None or foam.radiation is None:
        raise ValueError(f"foam {foam.name} has no data of the dissertation's form")
    rise = wire_rise(foam.wire_rise, power / wire.length)
    film = ROOM_TEMPERATURE + 0.5 * rise
    air = test_cuts.air_table()
    density, capacity, conductivity, viscosity = (
        np.interp(film, air["temperature"], air[name])
        for name in ("density", "heat", "conductivity", "viscosity")
    )
    prandtl = capacity * density * viscosity / conductivity
    flow = 0.62 * np.cbrt(prandtl) / (1.0 + (0.4 / prandtl) ** (2.0 / 3.0)) ** 0.25
    conducted = wire.length * conductivity * rise
    surface = math.pi * wire.diameter * wire.length
    radiated = foam.radiation * RADIATING_SHARE * EMISSIVITY * surface * STEFAN_BOLTZMANN * rise**4
    return 0.3 * conducted + radiated, conducted * flow * np.sqrt(wire.diameter / viscosity)


NUSSELT: Final = 1.0
"""Nusselt number of the wire in still air, assumed."""
ZERO_CELSIUS: Final = 273.15
"""Zero degrees Celsius in kelvin."""


def most_power(wire: HotWire) -> float:
    """Power [W] over the wire's heated length that no wire material bears in still air."""
    limit = hottest().limit_temperature
    hot, room = limit + ZERO_CELSIUS, materials.ROOM_TEMPERATURE + ZERO_CELSIUS
    conductivity = float(test_cuts.air_table()["conductivity"].max())
    radiated = EMISSIVITY * STEFAN_BOLTZMANN * wire.diameter * (hot**4 - room**4)
    return math.pi * (radiated + NUSSELT * conductivity * (hot - room)) * wire.length


def hottest() -> materials.WireMaterial:
    """The wire material that bears the most."""
    return max(materials.wire_materials().values(), key=lambda one: one.limit_temperature)


def refuse_melting(foam: Foam, wire: HotWire, power: float) -> None:
    """Raises `TandemError` (kerf.melts) for a power [W] above :func:`most_power`."""
    most = most_power(wire)
    if power <= most:
        return
    best, size = hottest(), f"{wire.diameter / MM:g} mm thick and {wire.length / MM:g} mm long"
    text = (
        f"power: got {power:.4g} W over a wire {size}, allowed up to {most:.3g} W: there it reaches "
        f"{best.limit_temperature:g} C in air, which is the limit of {best.title}"
    )
    hint = "take less power, a longer or a thicker wire"
    if foam.kerf is not None:
        low, high = (value * wire.length for value in foam.kerf.tests.power_per_length)
        hint += f"; the test cuts in {foam.name} had {low:.3g} to {high:.3g} W over this length"
    raise refusal("kerf.melts", text, field="power_w", value=power, limit=most, unit="W", hint=hint)
