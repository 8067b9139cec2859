"""How stiff and how heavy a bent wire is that a claim speaks of: from its section and its material's
constants, by code of its own. What plans has the same figures from ``hotwire/wire.py``; neither uses the
other.

Figures of materials come from ``data/materials.yaml``, which both sides read.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np

from planner.issues import Issue, TandemError
from planner.materials import REFERENCE_TEMPERATURE, WireMaterial
from planner.units import GRAVITY

TERMS: Final = 40
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
    odd = 2.0 * np.arange(TERMS) + 1.0
    series = float(np.sum(np.tanh(0.5 * odd * math.pi * width / thickness) / odd**5))
    return width * thickness**3 / 3.0 * (1.0 - 192.0 / math.pi**5 * thickness / width * series)


def _at(table: tuple[tuple[float, float], ...], temperature: float) -> float:
    """A table's value at a temperature [C], straight between its rows and constant beyond them."""
    rows = np.array(table)
    return float(np.interp(temperature, rows[:, 0], rows[:, 1]))
