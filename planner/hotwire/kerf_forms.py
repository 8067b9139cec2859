"""The kerf models by name, and what each needs to know of a foam."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from planner import materials
from planner.hotwire import kerf_convection, kerf_cuts, kerf_energy, kerf_general, kerf_measured
from planner.hotwire.kerf_wire import HotWire
from planner.issues import Issue, TandemError
from planner.materials import Foam

Model = Literal["energy", "general", "measured", "dissertation"]
Array = NDArray[np.float64]


def _no_inverse(foam: Foam, wire: HotWire, given: Array, wanted: Array, thickness: Array) -> Array:
    raise ValueError("this model has no inverse")


@dataclasses.dataclass(frozen=True)
class Form:
    """A model: ``needs`` names fields of `Foam`, ``tables`` asks for a foam of the dissertation's."""

    width: Callable[[Foam, HotWire, Array, Array, Array], tuple[Array, Array, Array]]
    speed_for: Callable[[Foam, HotWire, Array, Array, Array], Array]
    power_for: Callable[[Foam, HotWire, Array, Array, Array], Array]
    needs: tuple[str, ...]
    tables: bool = False


_HEAT: Final = ("specific_heat", "melt_temperature")
MEANT: Final = {
    "specific_heat": "specific heat",
    "melt_temperature": "melting temperature",
    "kerf": "test cuts",
    "radiation": "share of radiation",
    "wire_rise": "wire temperatures",
}
FORMS: Final[dict[str, Form]] = {
    "energy": Form(kerf_energy.width, kerf_energy.speed_for, kerf_energy.power_for, ("kerf", *_HEAT)),
    "general": Form(
        kerf_general.width, kerf_general.speed_for, kerf_general.power_for, (*_HEAT, "conductivity")
    ),
    "measured": Form(kerf_measured.width, _no_inverse, _no_inverse, ("kerf", *_HEAT), tables=True),
    "dissertation": Form(
        kerf_convection.estimate,
        kerf_convection.speed_for,
        kerf_convection.power_for,
        (*_HEAT, "radiation", "wire_rise"),
        tables=True,
    ),
}
"""The models by name."""


def choose(foam: str | Foam, model: str, backward: bool = False) -> tuple[Foam, Form]:
    """The foam's data and the model's functions; refuses what the model lacks."""
    if model not in FORMS:
        text = f"kerf model: got {model!r}, allowed {', '.join(FORMS)}"
        raise TandemError(Issue("kerf.model", text, field="model", hint="take energy"))
    data, form = materials.foam(foam) if isinstance(foam, str) else foam, FORMS[model]
    missing = [name for name in form.needs if getattr(data, name) is None]
    if form.tables and data.name not in kerf_cuts.dissertation_tables():
        missing.append("cells in the dissertation's tables")
    if missing:
        known = ", ".join(sorted(name for name, one in materials.foams().items() if one.kerf is not None))
        lacks = " and ".join(MEANT.get(name, name) for name in missing)
        text = f"kerf in {data.name} by model {model}: got no {lacks}, allowed {known} or a foam of your own"
        hint = "cut the four squares of problems/kerf_test and run: tandem kerf fit tests.csv"
        raise TandemError(Issue("kerf.no_data", text, field="foam", hint=hint))
    if backward and form.speed_for is _no_inverse:
        text = f"kerf model for a wanted kerf: got {model}, whose kerf rises and falls with speed"
        raise TandemError(Issue("kerf.model", text, field="model", hint="take energy"))
    return data, form
