"""The power at which a hot wire fails: no program, slot or advice asks for more.

A wire that is not in foam gives its whole power to the air, and on its ways between cuts it is there for
seconds. At its limit temperature T it gives off, per length,

    emissivity sigma pi d (T^4 - Ta^4) + pi Nu k (T - Ta)

by radiation (Stefan and Boltzmann) and to air of conductivity k, with a Nusselt number of 1: thin wires in
still air have 0.4 to 0.8, so that the bound is a generous one. T is the highest limit temperature of the wire
materials that are built in, k that of the hottest air in the data.
"""

from __future__ import annotations

import math
from typing import Final

from planner import materials
from planner.hotwire import kerf_cuts
from planner.hotwire.kerf_convection import EMISSIVITY, STEFAN_BOLTZMANN
from planner.hotwire.kerf_wire import HotWire
from planner.issues import Issue, TandemError
from planner.materials import Foam
from planner.units import MM

NUSSELT: Final = 1.0
KELVIN: Final = 273.15


def most_power(wire: HotWire) -> float:
    """Power [W] over the wire's heated length that no wire material bears in still air."""
    limit = hottest().limit_temperature
    hot, room = limit + KELVIN, materials.ROOM + KELVIN
    conductivity = float(kerf_cuts.air_table()["conductivity"].max())
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
    raise TandemError(
        Issue("kerf.melts", text, field="power_w", value=power, limit=most, unit="W", hint=hint)
    )
