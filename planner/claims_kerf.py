"""The slot that a claim counts with, read from the problem's numbers by code of its own: what plans takes its
kerf from ``hotwire/kerf*``, of which nothing is used here, and nothing that plans uses this.

A slot is either the stated width, or the energy balance of docs/kerf.md: a wire that gives off P / L [W/m]
and moves across itself at v [m/s] leaves

    max(chi P / (L rho c (T - 20 C) v) - offset, diameter)

with chi, offset and the density rho, heat c and melting temperature T of the block's foam. Between 1 and 50
mm/s it follows the speed, beyond them it stays: a wire that hardly moves has no width of its own.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.claims import KerfCurve
from planner.issues import Issue, TandemError
from planner.materials import ROOM, Foam
from planner.units import MM

SLOWEST: Final = 1e-3
"""[m/s] a slower wire counts as this fast."""
FASTEST: Final = 50e-3
"""[m/s] a faster wire counts as this fast."""
STEPS: Final = 2000
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
    speed = np.geomspace(SLOWEST, FASTEST, STEPS)
    melted = power_w / length / (foam.density * heat * (melts - ROOM)) / speed
    width = np.maximum(fit.chi * melted - fit.offset, diameter)
    return KerfCurve(speed, width, width, width)
