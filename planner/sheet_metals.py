"""Metals of sheets that are formed, from `data/sheets.yaml`: figures with their sources, in SI units."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any, Final

import yaml

from planner.issues import Issue, Severity, TandemError
from planner.materials import said
from planner.units import DEG, MM

_FILE: Final = Path(__file__).resolve().parent / "data" / "sheets.yaml"


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
    with _FILE.open(encoding="utf-8") as stream:
        data: dict[str, Any] = yaml.safe_load(stream)
    return {name: _sheet_metal(name, entry, data["limits"]) for name, entry in data["sheets"].items()}


def figures() -> list[tuple[str, str, str, str, str]]:
    """All figures as people read them: metal's name and title, figure, value with its unit, source."""
    with _FILE.open(encoding="utf-8") as stream:
        data: dict[str, Any] = yaml.safe_load(stream)
    out = []
    for name, entry in data["sheets"].items():
        angles = entry["wall_angle"]
        angles = data["limits"][angles] if isinstance(angles, str) else angles
        own = {key: value for key, value in entry.items() if _is_figure(value)}
        own |= {f"wall_angle_{key}": value for key, value in angles.items()}
        out += [(name, str(entry["title"]), key, said(v), str(v["source"])) for key, v in own.items()]
    return out


def sheet_metal(name: str) -> SheetMetal:
    """The sheet metal of that name; raises `TandemError` (forming.unknown_metal)."""
    known = sheet_metals()
    if name not in known:
        text = f"sheet metal: got {name!r}, allowed {', '.join(sorted(known))}"
        raise TandemError(
            Issue("forming.unknown_metal", text, hint="take the nearest one and state your own figures")
        )
    return known[name]


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


def _sheet_metal(name: str, entry: dict[str, Any], limits: dict[str, Any]) -> SheetMetal:
    def number(key: str) -> float:
        return float(entry[key]["value"])

    def pair(key: str) -> tuple[float, float]:
        low, high = entry[key]["value"]
        return float(low), float(high)

    angles = entry["wall_angle"]
    if isinstance(angles, str):
        angles = limits[angles]
    sources = {key: str(value["source"]) for key, value in entry.items() if _is_figure(value)}
    sources |= {f"wall_angle_{key}": str(value["source"]) for key, value in angles.items()}
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
        wall_angle_single=float(angles["single"]["value"]) * DEG,
        wall_angle_supported=float(angles["supported"]["value"]) * DEG,
        thickness_range=(thickness[0] * MM, thickness[1] * MM),
        sources=sources,
    )


def _is_figure(value: object) -> bool:
    return isinstance(value, dict) and "source" in value
