"""A kerf from a foam's properties alone, for foams that nobody has cut yet.

As the energy balance, but what the wire loses into the foam that stays is taken off first: near a moving
line source that loss per length goes with conductivity times the rise to melting, the only [W/m] that the
foam offers. kerf = chi (P / L - lambda k (Tp - Ta)) / (rho Cp (Tp - Ta) V), with chi and lambda the same for
all foams: least squares, which is linear here, over all valid cells of the dissertation's tables. The
interval comes from leaving one foam out at a time, because that is how the form is used.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from planner import materials
from planner.hotwire import kerf_cuts
from planner.hotwire.kerf_energy import LEVEL, ideal
from planner.hotwire.kerf_wire import HotWire
from planner.materials import Foam

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Constants:
    """``chi``, and ``chi_lambda`` its product with lambda; ``spread`` [m], root mean square of the error in
    foams left out, over ``count`` cells."""

    chi: float
    chi_lambda: float
    spread: float
    count: int


def width(
    foam: Foam, wire: HotWire, power: Array, speed: Array, thickness: Array
) -> tuple[Array, Array, Array]:
    """Kerf expected, low and high [m] at a power [W] and speed [m/s]; the foam's thickness plays no part."""
    found = constants()
    middle = found.chi * ideal(foam, power / wire.length, speed) - found.chi_lambda * conducted(foam, speed)
    half = float(stdtrit(found.count - 2, 0.5 + 0.5 * LEVEL)) * found.spread
    low, middle, high = (np.maximum(middle + s * half, wire.diameter) for s in (-1.0, 0.0, 1.0))
    return middle, low, high


def speed_for(foam: Foam, wire: HotWire, power: Array, wanted: Array, thickness: Array) -> Array:
    """Speed [m/s] of a kerf [m]; not above 0 where none gives it."""
    one, found = np.ones(()), constants()
    here = found.chi * ideal(foam, power / wire.length, one) - found.chi_lambda * conducted(foam, one)
    return here / wanted


def power_for(foam: Foam, wire: HotWire, speed: Array, wanted: Array, thickness: Array) -> Array:
    """Power [W] of a kerf [m]."""
    found = constants()
    needed = (wanted + found.chi_lambda * conducted(foam, speed)) / found.chi
    return needed / ideal(foam, np.ones(()), speed) * wire.length


def conducted(foam: Foam, speed: Array) -> Array:
    """Width [m] of foam that the heat k (Tp - Ta) [W/m] would melt."""
    if foam.conductivity is None or foam.melt_temperature is None:
        raise ValueError(f"foam {foam.name} has no conductivity or no melting temperature")
    return ideal(foam, np.asarray(foam.conductivity * (foam.melt_temperature - materials.ROOM)), speed)


@functools.lru_cache(maxsize=1)
def constants() -> Constants:
    """Fitted to the tables that come with Tandem."""
    cells = {name: table.valid for name, table in kerf_cuts.dissertation_tables().items()}
    every = fit(cells)
    errors = np.concatenate(
        [_error(fit({n: mask for n, mask in cells.items() if n != one}), one, cells[one]) for one in cells]
    )
    return Constants(*every, float(np.sqrt(np.mean(errors**2))), len(errors))


def fit(cells: dict[str, NDArray[np.bool_]]) -> tuple[float, float]:
    """chi and chi * lambda by least squares on some cells (foam to mask) of the dissertation's tables."""
    rows, widths = zip(*(_rows(name, mask) for name, mask in cells.items()), strict=True)
    chi, minus = np.linalg.lstsq(np.concatenate(rows), np.concatenate(widths))[0]
    return float(chi), -float(minus)


def _rows(name: str, mask: NDArray[np.bool_]) -> tuple[Array, Array]:
    table, foam = kerf_cuts.dissertation_tables()[name], materials.foam(name)
    cuts = table.cuts.only(mask)
    columns = (ideal(foam, cuts.power_per_length, cuts.speed), conducted(foam, cuts.speed))
    return np.stack(columns, axis=1), cuts.width


def _error(found: tuple[float, float], name: str, mask: NDArray[np.bool_]) -> Array:
    rows, widths = _rows(name, mask)
    return np.asarray(rows @ np.array([found[0], -found[1]]) - widths)
