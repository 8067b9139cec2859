"""Materials of wires, foams and sheets, from data files: values with their sources, in SI units.

Wires and blocks are in ``data/materials.yaml``, metals of sheets in ``data/sheets.yaml``. Temperatures are
in degrees Celsius.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import yaml

from planner.geometry.units import DEG, MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, issue_error

_MATERIALS_FILE: Final = Path(__file__).resolve().parents[1] / "data" / "materials.yaml"
"""Data file of the built-in foams and wires."""
ROOM_TEMPERATURE_C: Final = 20.0
"""Temperature [C] of the air and of a block before the cut."""
REFERENCE_TEMPERATURE_C: Final = 20.0
"""Temperature [C] at which cold lengths and sections are measured."""

Table = tuple[tuple[float, float], ...]
"""Pairs (argument, value) of a property, with ascending arguments."""
_Kind = TypeVar("_Kind")
"""Kind of a material."""


@dataclasses.dataclass(frozen=True)
class WireMaterial:
    """A wire's material. The arguments of its tables are temperatures [C].

    Attributes:
        name: Name in problem files.
        title: Name for people.
        density: Density [kg/m^3].
        poisson: Poisson's ratio.
        yield_stress: Yield stress [Pa] at 20 C.
        resistivity: Resistivity [ohm m] at 20 C.
        limit_temperature: Maximum temperature [C].
        young_table: Young's modulus [Pa].
        expansion_table: Mean thermal expansion [1/K] from 20 C.
        resistance_table: Resistivity relative to that at 20 C.
        sources: Source of each value, by its key in the data file.
    """

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
        """Return Young's modulus [Pa] at a temperature [C], constant beyond the ends of the table."""
        return _interpolate(self.young_table, temperature)

    def thermal_strain(self, temperature: float) -> float:
        """Return the elongation per length between 20 C and a temperature [C]."""
        return _interpolate(self.expansion_table, temperature) * (temperature - REFERENCE_TEMPERATURE_C)

    def resistivity_at(self, temperature: float) -> float:
        """Return the resistivity [ohm m] at a temperature [C]."""
        return self.resistivity * _interpolate(self.resistance_table, temperature)

    @property
    def elastic_strain(self) -> float:
        """Largest strain without permanent bend: yield stress over Young's modulus, both at 20 C.

        It is used for hot wires, too: yield stress and modulus both fall with temperature, and no table of
            the
        yield stress is known.
        """
        return self.yield_stress / self.young(REFERENCE_TEMPERATURE_C)


@dataclasses.dataclass(frozen=True)
class KerfTests:
    """Conditions under which test cuts in a foam were made.

    Attributes:
        power_per_length: Lowest and highest power per length [W/m].
        speed: Lowest and highest speed [m/s].
        thickness: Thickness [m] of the foam.
        wire_diameter: Diameter [m] of the round wire.
        burnt_speed: Speed [m/s] up to which faces were burnt, None if they never were.
    """

    power_per_length: tuple[float, float]
    speed: tuple[float, float]
    thickness: float
    wire_diameter: float
    burnt_speed: float | None = None


@dataclasses.dataclass(frozen=True)
class KerfFit:
    """Straight line fitted to test cuts of a foam: the width of the slot that a hot wire melts in it.

    Kerf = ``chi`` * ideal kerf - ``offset``, where the ideal kerf is the width of foam that the wire's whole
    power would just heat to melting.

    Attributes:
        chi: Slope of the fit.
        offset: Offset [m] of the fit.
        spread: Standard deviation [m] of the residuals.
        count: Number of cuts.
        mean_ideal: Mean [m] of the ideal kerfs of the cuts.
        scatter: Sum of the squared deviations [m^2] of the ideal kerfs from their mean.
        tests: Conditions of the cuts.
    """

    chi: float
    offset: float
    spread: float
    count: int
    mean_ideal: float
    scatter: float
    tests: KerfTests


@dataclasses.dataclass(frozen=True)
class FoamMaterial:
    """A block's material. Values are None if they are unknown.

    Attributes:
        name: Name in problem files.
        title: Name for people.
        density: Density [kg/m^3].
        sources: Source of each value, by its key in the data file.
        specific_heat: Specific heat [J/(kg K)].
        melt_temperature: Temperature [C] that cutting requires.
        conductivity: Thermal conductivity [W/(m K)].
        kerf: Fit of test cuts, None without test cuts.
        radiation: Fraction of the wire's radiation that the dissertation's kerf formula counts.
        wire_rise: Wire temperature above room temperature in that formula: pairs (power per length [W/m],
            rise [K]).
    """

    name: str
    title: str
    density: float
    sources: dict[str, str]
    specific_heat: float | None = None
    melt_temperature: float | None = None
    conductivity: float | None = None
    kerf: KerfFit | None = None
    radiation: float | None = None
    wire_rise: Table | None = None


@functools.lru_cache(maxsize=1)
def wire_materials() -> dict[str, WireMaterial]:
    """Return all wire materials by name."""
    return {name: _wire_material(name, entry) for name, entry in _read()["wires"].items()}


@functools.lru_cache(maxsize=1)
def foams() -> dict[str, FoamMaterial]:
    """Return all foams by name."""
    return {name: _foam(name, entry) for name, entry in _read()["foams"].items()}


def foam(name: str) -> FoamMaterial:
    """Return the foam of that name.

    Raises:
        TandemError: The name is unknown (``kerf.unknown_foam``).
    """
    hint = "use a built-in foam, or fit your own test cuts: tandem kerf fit"
    return _find(name, foams(), "foam", "kerf.unknown_foam", hint)


def wire_material(name: str) -> WireMaterial:
    """Return the wire material of that name.

    Raises:
        TandemError: The name is unknown (``wire.unknown_material``).
    """
    hint = "use a built-in material"
    return _find(name, wire_materials(), "wire material", "wire.unknown_material", hint)


def _find(name: str, materials: dict[str, _Kind], kind: str, code: str, hint: str) -> _Kind:
    """Return the material of that name, or raise an error with that code and hint if it is unknown."""
    if name not in materials:
        text = f"{kind}: got {name!r}, allowed {', '.join(sorted(materials))}"
        raise issue_error(code, text, hint=hint)
    return materials[name]


def figures() -> list[tuple[str, str, str, str, str]]:
    """Return all values of wires and foams for people.

    Returns:
        For each value: name and title of the material, key of the value, text of the value with its unit,
        and source.
    """
    data = _read()
    return [
        (name, str(entry["title"]), key, figure_text(value), str(value["source"]))
        for kind in ("wires", "foams")
        for name, entry in data[kind].items()
        for key, value in entry.items()
        if isinstance(value, dict)
    ]


def figure_text(entry: dict[str, Any]) -> str:
    """Format the value, range, table or fit of an entry of the data file, with its unit."""
    if "chi" in entry:
        tests = (
            f"{_span(entry['power_per_length_w_m'])} W/m at {_span(entry['speed_mm_s'])} mm/s, "
            f"{entry['thickness_mm']:g} mm of foam, wire of {entry['wire_diameter_mm']:g} mm"
        )
        fit = (
            f"chi {entry['chi']:.4g}, offset {entry['offset_mm']:.3g} mm, spread {entry['spread_mm']:.3g} mm"
        )
        return f"{fit}; {entry['count']} cuts at {tests}"
    unit = str(entry["unit"])
    table, value = entry.get("table"), entry.get("value")
    if table:
        numbers = [float(row[1]) for row in table]
    else:
        numbers = np.ravel(np.asarray(value, float)).tolist()
    scale, prefix = 1.0, ""
    if unit == "Pa" and max(numbers) >= 1e6:
        scale, prefix = (1e9, "G") if max(numbers) >= 1e10 else (1e6, "M")
    texts = [f"{number / scale:.4g}" for number in numbers]
    if table:
        argument_unit = "W/m" if unit.endswith("over W/m") else "C"
        unit = unit.removesuffix(" over W/m")
        pairs = ", ".join(f"{text} at {float(row[0]):.4g}" for row, text in zip(table, texts, strict=True))
        return f"{pairs} {argument_unit}{'' if unit == '1' else f', in {prefix}{unit}'}"
    return f"{' to '.join(texts)}{'' if unit == '1' else f' {prefix}{unit}'}"


def _span(pair: list[float]) -> str:
    """Format a range, given as its ends."""
    return f"{pair[0]:.3g} to {pair[1]:.3g}"


def _read(file: Path = _MATERIALS_FILE) -> dict[str, Any]:
    """Return the content of a data file."""
    with file.open(encoding="utf-8") as stream:
        data: dict[str, Any] = yaml.safe_load(stream)
    return data


def _sources(entry: dict[str, Any]) -> dict[str, str]:
    """Return the source of each value of an entry, by the key of the value."""
    return {key: str(value["source"]) for key, value in entry.items() if isinstance(value, dict)}


def _wire_material(name: str, entry: dict[str, Any]) -> WireMaterial:
    """Return the wire material of an entry of the data file."""

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


def _foam(name: str, entry: dict[str, Any]) -> FoamMaterial:
    """Return the foam of an entry of the data file, with None for values that the entry lacks."""

    def number(key: str) -> float | None:
        return float(entry[key]["value"]) if key in entry else None

    rise = entry["wire_rise"]["table"] if "wire_rise" in entry else None
    return FoamMaterial(
        name=name,
        title=str(entry["title"]),
        density=float(entry["density"]["value"]),
        sources=_sources(entry),
        specific_heat=number("specific_heat"),
        melt_temperature=number("melt_temperature"),
        conductivity=number("conductivity"),
        kerf=_kerf_fit(entry["kerf"]) if "kerf" in entry else None,
        radiation=number("radiation"),
        wire_rise=None if rise is None else tuple((float(power), float(dt)) for power, dt in rise),
    )


def _kerf_fit(entry: dict[str, Any]) -> KerfFit:
    """Return the fit of an entry of the data file, with lengths and speeds in SI units."""
    (min_power, max_power), (slowest, fastest) = entry["power_per_length_w_m"], entry["speed_mm_s"]
    burnt = entry.get("burnt_speed_mm_s")
    return KerfFit(
        chi=float(entry["chi"]),
        offset=float(entry["offset_mm"]) * MM,
        spread=float(entry["spread_mm"]) * MM,
        count=int(entry["count"]),
        mean_ideal=float(entry["mean_ideal_mm"]) * MM,
        scatter=float(entry["scatter_mm2"]) * MM * MM,
        tests=KerfTests(
            power_per_length=(float(min_power), float(max_power)),
            speed=(float(slowest) * MM, float(fastest) * MM),
            thickness=float(entry["thickness_mm"]) * MM,
            wire_diameter=float(entry["wire_diameter_mm"]) * MM,
            burnt_speed=None if burnt is None else float(burnt) * MM,
        ),
    )


def _interpolate(table: Table, temperature: float) -> float:
    """Return the value of a table at a temperature [C], constant beyond the ends of the table."""
    temperatures, values = zip(*table, strict=True)
    return float(np.interp(temperature, temperatures, values))


_SHEETS_FILE: Final = Path(__file__).resolve().parents[1] / "data" / "sheets.yaml"
"""Data file of the built-in sheet metals."""


@dataclasses.dataclass(frozen=True)
class SheetMetal:
    """A sheet's metal. Stresses, Young's modulus and density are at room temperature.

    Attributes:
        name: Name in problem files.
        title: Name for people.
        family: Family. Metals of one family are compared with the same trials.
        young: Young's modulus [Pa].
        poisson: Poisson's ratio.
        yield_stress: Yield stress [Pa].
        tensile_stress: Tensile strength [Pa], the middle of ``tensile_range``.
        tensile_range: Range [Pa] of the tensile strength.
        density: Density [kg/m^3].
        wall_angle_single: Wall angle [rad] above which walls tear in one pass.
        wall_angle_supported: Wall angle [rad] above which walls tear in one pass with a tool opposite.
        thickness_range: Thickness range [m] of known forming tests.
        sources: Source of each value, by its key in the data file.
    """

    name: str
    title: str
    family: str
    young: float
    poisson: float
    yield_stress: float
    tensile_stress: float
    tensile_range: tuple[float, float]
    density: float
    wall_angle_single: float
    wall_angle_supported: float
    thickness_range: tuple[float, float]
    sources: dict[str, str]

    def wall_angle_limit(self, supported: bool) -> float:
        """Return the maximum wall angle [rad] of one pass.

        ``supported`` says whether a second tool supports the opposite face of the sheet.
        """
        return self.wall_angle_supported if supported else self.wall_angle_single


@functools.lru_cache(maxsize=1)
def sheet_metals() -> dict[str, SheetMetal]:
    """Return all sheet metals by name."""
    return {name: _sheet_metal(name, *entry) for name, entry in _sheets().items()}


def sheet_metal_figures() -> list[tuple[str, str, str, str, str]]:
    """Return all values of sheet metals for people, in the form of :func:`figures`."""
    return [
        (name, str(entry["title"]), key, figure_text(value), str(value["source"]))
        for name, (entry, metal_values) in _sheets().items()
        for key, value in metal_values.items()
    ]


def _sheets() -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """Return, for each metal by name, its entry in the data file and its values.

    The wall angles are added to the values. The entry states them itself or names an entry of ``limits``.
    """
    data = _read(_SHEETS_FILE)
    sheets = {}
    for name, entry in data["sheets"].items():
        angles = entry["wall_angle"]
        angles = data["limits"][angles] if isinstance(angles, str) else angles
        metal_values = {
            key: value for key, value in entry.items() if isinstance(value, dict) and "source" in value
        }
        sheets[name] = entry, metal_values | {f"wall_angle_{key}": value for key, value in angles.items()}
    return sheets


def sheet_metal(name: str) -> SheetMetal:
    """Return the sheet metal of that name.

    Raises:
        TandemError: The name is unknown (``forming.unknown_metal``).
    """
    hint = "use the nearest one and state your own figures"
    return _find(name, sheet_metals(), "sheet metal", "forming.unknown_metal", hint)


def untested_thickness_warning(metal: SheetMetal, thickness: float) -> Issue | None:
    """Return ``forming.thickness_untested`` if no forming test of the metal in that thickness is known.

    Args:
        metal: Metal of the sheet.
        thickness: Thickness [m] of the sheet.
    """
    min_thickness, max_thickness = metal.thickness_range
    if min_thickness * (1.0 - 1e-9) <= thickness <= max_thickness * (1.0 + 1e-9):
        return None
    allowed = (
        f"{min_thickness / MM:g} mm"
        if min_thickness == max_thickness
        else f"{min_thickness / MM:g} to {max_thickness / MM:g} mm"
    )
    return Issue(
        "forming.thickness_untested",
        format_message(
            "forming.thickness_untested", thickness_mm=thickness / MM, metal=metal.title, tested_range=allowed
        ),
        Severity.WARNING,
        value=thickness / MM,
        limit=(max_thickness if thickness > max_thickness else min_thickness) / MM,
        unit="mm",
        hint="form a test cone first, and state the wall angle and force that you found",
    )


def _sheet_metal(name: str, entry: dict[str, Any], values: dict[str, Any]) -> SheetMetal:
    """Return the sheet metal of an entry of the data file and its values (:func:`_sheets`), in SI units."""

    def number(key: str) -> float:
        return float(values[key]["value"])

    def pair(key: str) -> tuple[float, float]:
        low, high = values[key]["value"]
        return float(low), float(high)

    tensile, thickness = pair("tensile"), pair("thickness")
    return SheetMetal(
        name=name,
        title=str(entry["title"]),
        family=str(entry["family"]),
        young=number("young"),
        poisson=number("poisson"),
        yield_stress=number("yield"),
        tensile_stress=0.5 * (tensile[0] + tensile[1]),
        tensile_range=tensile,
        density=number("density"),
        wall_angle_single=number("wall_angle_single") * DEG,
        wall_angle_supported=number("wall_angle_supported") * DEG,
        thickness_range=(thickness[0] * MM, thickness[1] * MM),
        sources={key: str(value["source"]) for key, value in values.items()},
    )
