"""The energy balance in the foam: what the wire gives off melts a slot.

A wire that gives P / L [W/m] and moves at V melts at most the ideal width P / (L rho Cp (Tp - Ta) V). Test
cuts say how far the real slot is from it: kerf = chi * ideal - offset, with both numbers per foam. The
interval is that of simple linear regression for one new cut (Student's t, residual spread, distance from the
tests' mean).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from planner.hotwire.kerf_wire import HotWire
from planner.materials import ROOM, Foam, KerfFit

LEVEL: Final = 0.90
"""Share of new cuts that an interval is meant to hold."""

Array = NDArray[np.float64]


def width(
    foam: Foam, wire: HotWire, power: Array, speed: Array, thickness: Array
) -> tuple[Array, Array, Array]:
    """Kerf expected, low and high [m] at a power [W] and speed [m/s], nowhere below the wire's diameter; the
    foam's thickness plays no part."""
    fit, melted = _fit(foam), ideal(foam, power / wire.length, speed)
    middle, half = fit.chi * melted - fit.offset, margin(fit, melted)
    low, middle, high = (np.maximum(middle + s * half, wire.diameter) for s in (-1.0, 0.0, 1.0))
    return middle, low, high


def speed_for(foam: Foam, wire: HotWire, power: Array, wanted: Array, thickness: Array) -> Array:
    """Speed [m/s] of a kerf [m]; not above 0 where none gives it."""
    return power / wire.length / (heat(foam) * _ideal_for(foam, wanted))


def power_for(foam: Foam, wire: HotWire, speed: Array, wanted: Array, thickness: Array) -> Array:
    """Power [W] of a kerf [m]; not above 0 where none gives it."""
    return _ideal_for(foam, wanted) * heat(foam) * speed * wire.length


def heat(foam: Foam) -> float:
    """Heat [J/m^3] that takes the foam from the room's temperature to melting."""
    if foam.specific_heat is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no specific heat or no melting temperature")
    return foam.density * foam.specific_heat * (foam.melt_temperature - ROOM)


def ideal(foam: Foam, power_per_length: Array, speed: Array) -> Array:
    """Width [m] of the foam that the whole power [W/m] heats to melting at the speed [m/s]; they
    broadcast."""
    return power_per_length / (heat(foam) * speed)


def margin(fit: KerfFit, ideal_width: Array | float) -> Array:
    """Half the interval [m] for one new cut of an ideal width [m]."""
    quantile = float(stdtrit(fit.count - 2, 0.5 + 0.5 * LEVEL))
    away = (ideal_width - fit.mean_ideal) ** 2 / fit.scatter
    return np.asarray(quantile * fit.spread * np.sqrt(1.0 + 1.0 / fit.count + away))


def _ideal_for(foam: Foam, wanted: Array) -> Array:
    fit = _fit(foam)
    return (wanted + fit.offset) / fit.chi


def _fit(foam: Foam) -> KerfFit:
    if foam.kerf is None:
        raise ValueError(f"foam {foam.name} has no test cuts")
    return foam.kerf
