"""The dissertation's form of the kerf: air that streams past the wire carries the heat into the foam.

Equations (8) to (19) of its chapter 3, as its calculated columns use them (docs/kerf.md lists what the print
has otherwise): Nusselt number of a cylinder in cross flow (Churchill and Bernstein's, without their last
factor), air at the film temperature, a share of the wire's radiation, all of it spread over the foam's
thickness, less the wire's diameter. The wire's temperature is looked up over power per length; it is not
derived.
"""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from planner.hotwire import kerf_cuts
from planner.hotwire.kerf_energy import LEVEL, heat
from planner.hotwire.kerf_wire import HotWire
from planner.materials import ROOM, Foam, Table

STEFAN_BOLTZMANN: Final = 5.670374419e-8
"""[W/(m^2 K^4)], CODATA 2018."""
EMISSIVITY: Final = 0.7
"""Of an oxidised Kanthal wire; the dissertation's figure."""
RADIATING_PART: Final = 0.900
"""Factor on the radiation that its calculated columns imply and its text does not state."""
MAX_POWER_PER_LENGTH: Final = 1000.0
"""Beyond this [W/m] a thin wire melts; no power above it is looked for."""

Array = NDArray[np.float64]


def estimate(
    foam: Foam, wire: HotWire, power: Array, speed: Array, thickness: Array
) -> tuple[Array, Array, Array]:
    """Kerf expected, low and high [m]; the interval is the error in the foam's own valid cells."""
    middle = width(foam, wire, power, speed, thickness)
    error, count = spread(foam.name)
    half = float(stdtrit(count, 0.5 + 0.5 * LEVEL)) * error
    return middle, middle - half, middle + half


def width(foam: Foam, wire: HotWire, power: Array, speed: Array, thickness: Array) -> Array:
    """Kerf [m] at ``power`` [W], ``speed`` [m/s] and foam ``thickness`` [m]; they broadcast. It may be
    negative, as the form is."""
    still, moving = _heat_flows(foam, wire, power)
    return (still / speed + moving / np.sqrt(speed)) / (heat(foam) * thickness) - wire.diameter


def speed_for(foam: Foam, wire: HotWire, power: Array, wanted: Array, thickness: Array) -> Array:
    """Speed [m/s] that gives the kerf ``wanted`` [m]: the form is quadratic in 1 / sqrt(speed)."""
    still, moving = _heat_flows(foam, wire, power)
    needed = (wanted + wire.diameter) * heat(foam) * thickness
    root = (np.sqrt(moving**2 + 4.0 * still * needed) - moving) / (2.0 * still)
    return np.asarray(root**-2.0)


def power_for(foam: Foam, wire: HotWire, speed: Array, wanted: Array, thickness: Array) -> Array:
    """Power [W] that gives the kerf ``wanted`` [m], by bisection: the form has no closed inverse in power,
    but grows with it. NaN where no power up to `MAX_POWER_PER_LENGTH` does."""
    shape = np.broadcast_shapes(speed.shape, wanted.shape, thickness.shape)
    low, high = np.full(shape, 1e-3 * wire.length), np.full(shape, MAX_POWER_PER_LENGTH * wire.length)
    reached = width(foam, wire, high, speed, thickness) >= wanted
    started = width(foam, wire, low, speed, thickness) <= wanted
    for _ in range(60):
        middle = 0.5 * (low + high)
        wide = width(foam, wire, middle, speed, thickness) >= wanted
        low, high = np.where(wide, low, middle), np.where(wide, middle, high)
    return np.where(reached & started, 0.5 * (low + high), np.nan)


@functools.lru_cache(maxsize=16)
def spread(foam: str) -> tuple[float, int]:
    """Root mean square [m] of calculated less measured over a foam's valid cells, and how many these are."""
    table = kerf_cuts.dissertation_tables()[foam]
    error = (table.calculated - table.cuts.width)[table.valid]
    return float(np.sqrt(np.mean(error**2))), len(error)


def wire_rise(table: Table, power_per_length: Array) -> Array:
    """Temperature [K] of the wire above the room's over power per length [W/m]: linear between the tests'
    four powers, and on along the outermost pieces beyond them."""
    places, values = (np.array(column) for column in zip(*table, strict=True))
    piece = np.clip(np.searchsorted(places, power_per_length) - 1, 0, len(places) - 2)
    slope = np.diff(values) / np.diff(places)
    return np.asarray(values[piece] + slope[piece] * (power_per_length - places[piece]))


def _heat_flows(foam: Foam, wire: HotWire, power: Array) -> tuple[Array, Array]:
    """Heat [W] that goes into the foam at any speed, and what comes to it per sqrt(speed) [W sqrt(s/m)]."""
    if foam.wire_rise is None or foam.radiation is None:
        raise ValueError(f"foam {foam.name} has no data of the dissertation's form")
    rise = wire_rise(foam.wire_rise, power / wire.length)
    film = ROOM + 0.5 * rise
    air = kerf_cuts.air_table()
    density, capacity, conductivity, viscosity = (
        np.interp(film, air["temperature"], air[name])
        for name in ("density", "heat", "conductivity", "viscosity")
    )
    prandtl = capacity * density * viscosity / conductivity
    flow = 0.62 * np.cbrt(prandtl) / (1.0 + (0.4 / prandtl) ** (2.0 / 3.0)) ** 0.25
    conducted = wire.length * conductivity * rise
    surface = math.pi * wire.diameter * wire.length
    radiated = foam.radiation * RADIATING_PART * EMISSIVITY * surface * STEFAN_BOLTZMANN * rise**4
    return 0.3 * conducted + radiated, conducted * flow * np.sqrt(wire.diameter / viscosity)
