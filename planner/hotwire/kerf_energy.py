"""The energy balance in the foam: what the wire gives off melts a slot.

A wire that gives q [W/m] and moves at V melts at most the ideal width q / (rho Cp (Tp - Ta) V). Test cuts
say how far the real slot is from it: kerf = chi * ideal - offset, with both numbers per foam. The interval
is that of simple linear regression for one new cut (Student's t, residual spread, distance from the tests'
mean).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from planner.materials import Foam, KerfFit

ROOM: Final = 20.0
"""Temperature [C] of the air and the foam before the cut."""
LEVEL: Final = 0.90
"""Share of new cuts that an interval is meant to hold."""

Array = NDArray[np.float64]


def heat(foam: Foam) -> float:
    """Heat [J/m^3] that takes the foam from the room's temperature to melting."""
    if foam.specific_heat is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no specific heat or no melting temperature")
    return foam.density * foam.specific_heat * (foam.melt_temperature - ROOM)


def ideal(foam: Foam, power_per_length: Array, speed: Array) -> Array:
    """Width [m] of the foam that the whole power [W/m] heats to melting at the speed [m/s]; they
    broadcast."""
    return power_per_length / (heat(foam) * speed)


def width(fit: KerfFit, ideal_width: Array) -> Array:
    """Kerf [m] of an ideal width [m]; below 0 where no cut is possible."""
    return fit.chi * ideal_width - fit.offset


def margin(fit: KerfFit, ideal_width: Array) -> Array:
    """Half the interval [m] for one new cut of an ideal width [m]."""
    quantile = float(stdtrit(fit.count - 2, 0.5 + 0.5 * LEVEL))
    away = (ideal_width - fit.mean_ideal) ** 2 / fit.scatter
    return np.asarray(quantile * fit.spread * np.sqrt(1.0 + 1.0 / fit.count + away))


def ideal_for(fit: KerfFit, wanted: Array) -> Array:
    """Ideal width [m] whose kerf is ``wanted`` [m]; not above 0 where no cut gives it."""
    return (wanted + fit.offset) / fit.chi
