"""Materials of wires and blocks, from `data/materials.yaml`: figures with their sources, in SI units and
degrees Celsius."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from planner.issues import Issue, TandemError

_FILE: Final = Path(__file__).resolve().parent / "data" / "materials.yaml"
REFERENCE_TEMPERATURE: Final = 20.0
"""Temperature [C] at which cold lengths and sections are measured."""

Table = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class WireMaterial:
    """A wire's material. Tables are pairs (temperature [C], value); ``sources`` names the source of each
    figure.

    ``density`` [kg/m^3], ``yield_stress`` [Pa] at 20 C, ``resistivity`` [ohm m] at 20 C,
    ``limit_temperature`` [C]."""

    name: str
    title: str
    density: float
    poisson: float
    yield_stress: float
    resistivity: float
    limit_temperature: float
    young_table: Table
    expansion_table: Table
    resistance_table: Table
    sources: dict[str, str]

    def young(self, temperature: float) -> float:
        """Young's modulus [Pa] at a temperature [C]; constant beyond the ends of the table."""
        return _look_up(self.young_table, temperature)

    def thermal_strain(self, temperature: float) -> float:
        """Elongation per length between 20 C and the temperature [C]."""
        return _look_up(self.expansion_table, temperature) * (temperature - REFERENCE_TEMPERATURE)

    def resistivity_at(self, temperature: float) -> float:
        """Resistivity [ohm m] at a temperature [C]."""
        return self.resistivity * _look_up(self.resistance_table, temperature)

    @property
    def elastic_strain(self) -> float:
        """Largest strain without lasting bend: yield over modulus, both at 20 C.

        Taken for hot wires too, because both fall with heat and the yield stress has no table.
        """
        return self.yield_stress / self.young(REFERENCE_TEMPERATURE)


@dataclasses.dataclass(frozen=True)
class Foam:
    """A block's material: ``density`` [kg/m^3]."""

    name: str
    title: str
    density: float
    sources: dict[str, str]


@functools.lru_cache(maxsize=1)
def wire_materials() -> dict[str, WireMaterial]:
    """All wire materials by name."""
    return {name: _wire_material(name, entry) for name, entry in _read()["wires"].items()}


@functools.lru_cache(maxsize=1)
def foams() -> dict[str, Foam]:
    """All foams by name."""
    return {
        name: Foam(name, entry["title"], float(entry["density"]["value"]), _sources(entry))
        for name, entry in _read()["foams"].items()
    }


def wire_material(name: str) -> WireMaterial:
    """The wire material of that name; raises `TandemError` (wire.unknown_material)."""
    known = wire_materials()
    if name not in known:
        text = f"wire material: got {name!r}, allowed {', '.join(sorted(known))}"
        raise TandemError(Issue("wire.unknown_material", text, hint="take a material that is built in"))
    return known[name]


def _read() -> dict[str, Any]:
    with _FILE.open(encoding="utf-8") as stream:
        data: dict[str, Any] = yaml.safe_load(stream)
    return data


def _sources(entry: dict[str, Any]) -> dict[str, str]:
    return {key: str(value["source"]) for key, value in entry.items() if isinstance(value, dict)}


def _wire_material(name: str, entry: dict[str, Any]) -> WireMaterial:
    def number(key: str) -> float:
        return float(entry[key]["value"])

    def table(key: str) -> Table:
        return tuple((float(t), float(v)) for t, v in entry[key]["table"])

    return WireMaterial(
        name=name,
        title=str(entry["title"]),
        density=number("density"),
        poisson=number("poisson"),
        yield_stress=number("yield"),
        resistivity=number("resistivity"),
        limit_temperature=number("limit_temperature"),
        young_table=table("young"),
        expansion_table=table("expansion"),
        resistance_table=table("resistance_factor"),
        sources=_sources(entry),
    )


def _look_up(table: Table, temperature: float) -> float:
    places, values = zip(*table, strict=True)
    return float(np.interp(temperature, places, values))
