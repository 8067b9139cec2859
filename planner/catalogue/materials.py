"""Materials of wires, foams and sheets, from data files: figures with their sources, in SI units.

Wires and blocks are in ``data/materials.yaml``, metals of sheets in ``data/sheets.yaml``.
Temperatures are in degrees Celsius.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import yaml

from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, refusal

_MATERIALS_FILE: Final = Path(__file__).resolve().parents[1] / "data" / "materials.yaml"
"""Foams and wires that are built in."""
ROOM_TEMPERATURE: Final = 20.0
"""Temperature [C] of the air and of a block before the cut."""
REFERENCE_TEMPERATURE: Final = 20.0
"""Temperature [C] at which cold lengths and sections are measured."""

Table = tuple[tuple[float, float], ...]
_Kind = TypeVar("_Kind")


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
class KerfTests:
    """What test cuts tried: ``power_per_length`` [W/m] and ``speed`` [m/s], each from lowest to highest, in
    foam of ``thickness`` [m] with a round wire of ``wire_diameter`` [m]; up to ``burnt_speed`` [m/s] the
    faces were burnt (None: nowhere)."""

    power_per_length: tuple[float, float]
    speed: tuple[float, float]
    thickness: float
    wire_diameter: float
    burnt_speed: float | None = None


@dataclasses.dataclass(frozen=True)
class KerfFit:
    """What test cuts of a foam say of the slot that a hot wire melts in it.

    Kerf = ``chi`` * ideal - ``offset`` [m], where the ideal is the width whose foam the wire's whole power
    would just heat to melting. ``spread`` [m] is the residuals' standard deviation over ``count`` cuts whose
    ideals have the mean ``mean_ideal`` [m] and the sum of squares ``scatter`` [m^2] about it.
    """

    chi: float
    offset: float
    spread: float
    count: int
    mean_ideal: float
    scatter: float
    tests: KerfTests


@dataclasses.dataclass(frozen=True)
class Foam:
    """A block's material: ``density`` [kg/m^3], ``specific_heat`` [J/(kg K)], ``melt_temperature`` [C] that
    cutting takes, ``conductivity`` [W/(m K)]; None where unknown.

    ``kerf`` is None without test cuts. ``radiation`` is the share of the wire's radiation that the
    dissertation's kerf formula counts, ``wire_rise`` its wire temperature above the room's: pairs (power per
    length [W/m], rise [K])."""

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
    """All wire materials by name."""
    return {name: _wire_material(name, entry) for name, entry in _read()["wires"].items()}


@functools.lru_cache(maxsize=1)
def foams() -> dict[str, Foam]:
    """All foams by name."""
    return {name: _foam(name, entry) for name, entry in _read()["foams"].items()}


def foam(name: str) -> Foam:
    """The foam of that name; raises `TandemError` (kerf.unknown_foam)."""
    hint = "take a foam that is built in, or fit your own test cuts: tandem kerf fit"
    return _named(name, foams(), "foam", "kerf.unknown_foam", hint)


def wire_material(name: str) -> WireMaterial:
    """The wire material of that name; raises `TandemError` (wire.unknown_material)."""
    hint = "take a material that is built in"
    return _named(name, wire_materials(), "wire material", "wire.unknown_material", hint)


def _named(name: str, known: dict[str, _Kind], what: str, code: str, hint: str) -> _Kind:
    if name not in known:
        text = f"{what}: got {name!r}, allowed {', '.join(sorted(known))}"
        raise refusal(code, text, hint=hint)
    return known[name]


def figures() -> list[tuple[str, str, str, str, str]]:
    """All figures as people read them: material's name and title, figure, value with its unit, source."""
    data = _read()
    return [
        (name, str(entry["title"]), key, figure_text(value), str(value["source"]))
        for kind in ("wires", "foams")
        for name, entry in data[kind].items()
        for key, value in entry.items()
        if isinstance(value, dict)
    ]


def figure_text(entry: dict[str, Any]) -> str:
    """A figure's value, range, table or fit, as the data file has it, with its unit."""
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
    numbers = [float(row[1]) for row in table] if table else np.ravel(np.asarray(value, float)).tolist()
    scale, prefix = 1.0, ""
    if unit == "Pa" and max(numbers) >= 1e6:
        scale, prefix = (1e9, "G") if max(numbers) >= 1e10 else (1e6, "M")
    shown = [f"{number / scale:.4g}" for number in numbers]
    if table:
        over = "W/m" if unit.endswith("over W/m") else "C"
        unit = unit.removesuffix(" over W/m")
        pairs = ", ".join(f"{one} at {float(row[0]):.4g}" for row, one in zip(table, shown, strict=True))
        return f"{pairs} {over}{'' if unit == '1' else f', in {prefix}{unit}'}"
    return f"{' to '.join(shown)}{'' if unit == '1' else f' {prefix}{unit}'}"


def _span(pair: list[float]) -> str:
    return f"{pair[0]:.3g} to {pair[1]:.3g}"


def _read(file: Path = _MATERIALS_FILE) -> dict[str, Any]:
    with file.open(encoding="utf-8") as stream:
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


def _foam(name: str, entry: dict[str, Any]) -> Foam:
    def number(key: str) -> float | None:
        return float(entry[key]["value"]) if key in entry else None

    rise = entry["wire_rise"]["table"] if "wire_rise" in entry else None
    return Foam(
        name=name,
        title=str(entry["title"]),
        density=float(entry["density"]["value"]),
        sources=_sources(entry),
        specific_heat=number("specific_heat"),
        melt_temperature=number("melt_temperature"),
        conductivity=number("conductivity"),
        kerf=_kerf_fit(entry["kerf"]) if "kerf" in entry else None,
        radiation=number("radiation"),
        wire_rise=None if rise is None else tuple((float(q), float(dt)) for q, dt in rise),
    )


def _kerf_fit(entry: dict[str, Any]) -> KerfFit:
    (least, most), (slowest, fastest) = entry["power_per_length_w_m"], entry["speed_mm_s"]
    burnt = entry.get("burnt_speed_mm_s")
    return KerfFit(
        chi=float(entry["chi"]),
        offset=float(entry["offset_mm"]) * MM,
        spread=float(entry["spread_mm"]) * MM,
        count=int(entry["count"]),
        mean_ideal=float(entry["mean_ideal_mm"]) * MM,
        scatter=float(entry["scatter_mm2"]) * MM * MM,
        tests=KerfTests(
            power_per_length=(float(least), float(most)),
            speed=(float(slowest) * MM, float(fastest) * MM),
            thickness=float(entry["thickness_mm"]) * MM,
            wire_diameter=float(entry["wire_diameter_mm"]) * MM,
            burnt_speed=None if burnt is None else float(burnt) * MM,
        ),
    )


def _look_up(table: Table, temperature: float) -> float:
    places, values = zip(*table, strict=True)
    return float(np.interp(temperature, places, values))


_SHEETS_FILE: Final = Path(__file__).resolve().parents[1] / "data" / "sheets.yaml"
"""Sheet metals that are built in."""


@dataclasses.dataclass(frozen=True)
class SheetMetal:
    """A sheet's metal; ``sources`` names the source of each figure.

    ``young`` [Pa], ``yield_stress`` [Pa] and ``density`` [kg/m^3] are at room temperature. The tensile
    strength is ``tensile_stress`` [Pa], the middle of ``tensile_range`` [Pa]. Steeper walls than
    ``wall_angle_single`` [rad] tear in one pass; ``wall_angle_supported`` [rad] is the same with a tool
    opposite. ``thickness_range`` [m] is what forming tests are known of. Metals of one ``family`` are
    compared with the same trials.
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
        """Steepest wall [rad] of one pass, with a tool opposite or without."""
        return self.wall_angle_supported if supported else self.wall_angle_single


@functools.lru_cache(maxsize=1)
def sheet_metals() -> dict[str, SheetMetal]:
    """All sheet metals by name."""
    return {name: _sheet_metal(name, *entry) for name, entry in _sheets().items()}


def sheet_metal_figures() -> list[tuple[str, str, str, str, str]]:
    """All figures as people read them: metal's name and title, figure, value with its unit, source."""
    return [
        (name, str(entry["title"]), key, figure_text(value), str(value["source"]))
        for name, (entry, own) in _sheets().items()
        for key, value in own.items()
    ]


def _sheets() -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """The entry of each metal, and its figures with those of its wall angles."""
    data = _read(_SHEETS_FILE)
    out = {}
    for name, entry in data["sheets"].items():
        angles = entry["wall_angle"]
        angles = data["limits"][angles] if isinstance(angles, str) else angles
        own = {key: value for key, value in entry.items() if isinstance(value, dict) and "source" in value}
        out[name] = entry, own | {f"wall_angle_{key}": value for key, value in angles.items()}
    return out


def sheet_metal(name: str) -> SheetMetal:
    """The sheet metal of that name; raises `TandemError` (forming.unknown_metal)."""
    hint = "take the nearest one and state your own figures"
    return _named(name, sheet_metals(), "sheet metal", "forming.unknown_metal", hint)


def thickness_doubt(metal: SheetMetal, thickness: float) -> Issue | None:
    """A warning where no forming test of the metal in that ``thickness`` [m] is known
    (forming.thickness_untested)."""
    least, most = metal.thickness_range
    if least * (1.0 - 1e-9) <= thickness <= most * (1.0 + 1e-9):
        return None
    allowed = f"{least / MM:g} mm" if least == most else f"{least / MM:g} to {most / MM:g} mm"
    return Issue(
        "forming.thickness_untested",
        f"thickness: got {thickness / MM:g} mm, tests of {metal.title} are known for {allowed}; "
        "its wall angle limit and forces are guesses beyond that",
        Severity.WARNING,
        value=thickness / MM,
        limit=(most if thickness > most else least) / MM,
        unit="mm",
        hint="form a test cone first, and state the wall angle and force that you found",
    )


def _sheet_metal(name: str, entry: dict[str, Any], values: dict[str, Any]) -> SheetMetal:
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
