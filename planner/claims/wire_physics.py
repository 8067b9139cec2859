"""Slot, stiffness and weight of hot wires as claims count with them, by code that plans nothing.

What plans takes the same figures from ``hotwire/kerf/`` and ``hotwire/wire.py``, of which nothing
is used here; nothing that plans uses this. Figures of materials come from ``data/materials.yaml``,
which both sides read.

A slot is either the stated width, or the energy balance of docs/kerf.md: a wire that gives off P /
L [W/m] and moves across itself at v [m/s] leaves

    max(chi P / (L rho c (T - 20 C) v) - offset, diameter)

with chi, offset and the density rho, heat c and melting temperature T of the block's foam. Between
1 and 50 mm/s it follows the speed, beyond them it stays: a wire that hardly moves has no width of
its own.

How stiff and how heavy a bent wire is follows from its section and its material's constants.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np

from planner.catalogue.materials import REFERENCE_TEMPERATURE, ROOM_TEMPERATURE, Foam, WireMaterial
from planner.claims.claim import KerfCurve
from planner.issues import Issue, TandemError
from planner.units import GRAVITY, MM

SLOWEST_WIRE: Final = 1e-3
"""[m/s] a slower wire counts as this fast."""
FASTEST_WIRE: Final = 50e-3
"""[m/s] a faster wire counts as this fast."""
SPEED_STEPS: Final = 2000
"""Speeds of a table, evenly spaced in their logarithms: read linearly it is off by less than 2e-6 of its
width."""


def slot(
    kerf_mm: float | None, power_w: float | None, foam: Foam | None, diameter: float, length: float
) -> KerfCurve:
    """The slot's width over the wire's speed across itself, from what an operation states.

    ``kerf_mm`` [mm] counts alone where it is given; else ``power_w`` [W] over the heated ``length`` [m] of a
    wire of ``diameter`` [m] in ``foam``. The curve's interval is its width: the proof counts with that alone.
    Raises ``TandemError``: stock.foam_missing, kerf.no_data, kerf.input.
    """
    if kerf_mm is not None:
        return KerfCurve.constant(kerf_mm * MM)
    if foam is None or power_w is None:
        raise TandemError(
            Issue(
                "stock.foam_missing",
                "the slot follows from power_w and the block's foam, and one of them is not stated; give "
                "stock.foam, or kerf_mm instead of power_w",
                field="stock.foam",
            )
        )
    fit, heat, melts = foam.kerf, foam.specific_heat, foam.melt_temperature
    if fit is None or heat is None or melts is None:
        what = f"the slot in {foam.name}: got no test cuts, heat or melting point, allowed a foam with them"
        hint = "give kerf_mm, or fit test cuts of your own: tandem kerf fit"
        raise TandemError(Issue("kerf.no_data", what, field="foam", hint=hint))
    if not (diameter > 0.0 and length > 0.0):
        size = f"{diameter / MM:g} x {length / MM:g} mm"
        what = f"a hot wire of {size}: allowed a diameter and a length above 0"
        raise TandemError(Issue("kerf.input", what, field="diameter", hint="give the wire's size"))
    speed = np.geomspace(SLOWEST_WIRE, FASTEST_WIRE, SPEED_STEPS)
    melted = power_w / length / (foam.density * heat * (melts - ROOM_TEMPERATURE)) / speed
    width = np.maximum(fit.chi * melted - fit.offset, diameter)
    return KerfCurve(speed, width, width, width)


TORSION_TERMS: Final = 40
"""Terms of the series of a strip's torsion constant, which fall with the fifth power."""


@dataclasses.dataclass(frozen=True)
class Stiffness:
    """``ei_soft`` and ``ei_stiff`` [N m^2] in and across the plane in which a wire bends, ``gj`` [N m^2],
    ``weight`` [N/m], ``max_curvature`` [1/m] by the elastic limit of the cold wire, ``thickness`` [m] in the
    bending plane."""

    ei_soft: float
    ei_stiff: float
    gj: float
    weight: float
    max_curvature: float
    thickness: float


def stiffness(
    material: WireMaterial, diameter: float | None, width: float | None, thickness: float | None, hot: float
) -> Stiffness:
    """A round wire of ``diameter`` [m], or a strip of ``width`` and ``thickness`` [m] that bends over its
    thin side, at the temperature ``hot`` [C].

    Second moments of area of a disk, pi d^4 / 64, and of a rectangle; torsion constant of a disk, pi d^4 /
    32, and of a rectangle by Saint-Venant's series (Timoshenko and Goodier, Theory of Elasticity, art. 109).
    Raises ``TandemError`` (wire.size)."""
    young = _at(material.young_table, hot)
    shear = young / (2.0 * (1.0 + material.poisson))
    if diameter is not None:
        soft = stiff = math.pi * diameter**4 / 64.0
        twist, area, thick = math.pi * diameter**4 / 32.0, math.pi * diameter**2 / 4.0, diameter
    elif width is not None and thickness is not None:
        soft, stiff = width * thickness**3 / 12.0, thickness * width**3 / 12.0
        twist, area, thick = rectangle_torsion(width, thickness), width * thickness, thickness
    else:
        raise TandemError(
            Issue(
                "wire.size",
                "wire size: got neither a diameter nor a width and a thickness, allowed one of the two",
                hint="give diameter_mm, or width_mm and thickness_mm",
            )
        )
    strain = material.yield_stress / _at(material.young_table, REFERENCE_TEMPERATURE)
    weight = material.density * area * GRAVITY
    return Stiffness(young * soft, young * stiff, shear * twist, weight, 2.0 * strain / thick, thick)


def cold_length(material: WireMaterial, length: float, hot: float) -> float:
    """The length [m] at 20 C of a wire that is ``length`` [m] long at the temperature ``hot`` [C]: the table
    gives the mean expansion from 20 C on."""
    return length / (1.0 + _at(material.expansion_table, hot) * (hot - REFERENCE_TEMPERATURE))


def rectangle_torsion(width: float, thickness: float) -> float:
    """Torsion constant [m^4] of a rectangle, ``width`` >= ``thickness`` [m]."""
    odd = 2.0 * np.arange(TORSION_TERMS) + 1.0
    series = float(np.sum(np.tanh(0.5 * odd * math.pi * width / thickness) / odd**5))
    return width * thickness**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * thickness / width * series)


def _at(table: tuple[tuple[float, float], ...], temperature: float) -> float:
    """A table's value at a temperature [C], straight between its rows and constant beyond them."""
    rows = np.array(table)
    return float(np.interp(temperature, rows[:, 0], rows[:, 1]))
