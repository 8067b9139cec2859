"""``tandem kerf fit | width | speed | power``: kerfs at the command line."""

from __future__ import annotations

import dataclasses
import datetime as dt
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from planner.issues import Issue, TandemError
from planner.units import MM

if TYPE_CHECKING:
    from planner.catalogue.materials import Foam
    from planner.hotwire.kerf.calibration import CutFile, FitReport
    from planner.hotwire.kerf.width import KerfEstimate

out = Console(highlight=False, soft_wrap=True)


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit a foam of your own from test cuts, and write a foam file that problems may name.

    The CSV file has columns power_w, speed_mm_s, and either kerf_mm or measured_side_mm with
    nominal_side_mm; also wire_length_mm, thickness_mm, and face (ok, burnt, dragging) where you have them.
    Cuts of no stated face are left out where the fit gives them a kerf outside 0.8 to 3 mm.
    """

    tests: tyro.conf.Positional[Path]
    """the file of test cuts, CSV"""
    density_kg_m3: float
    """density of the foam: weigh a block"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("my_foam.yaml")
    """the foam file to write"""
    name: str = "my_foam"
    """name of the foam: a letter first, then letters, digits and underscores"""
    thickness_mm: float | None = None
    """thickness of the foam in the tests, unless the file has it"""
    wire_length_mm: float | None = None
    """heated length of the wire, unless the file has it"""
    wire_diameter_mm: float = 0.4
    """diameter of the wire"""
    specific_heat_j_kg_k: float = 1450.0
    """chi makes up for an error in it"""
    melt_temperature_c: float = 280.0
    """chi makes up for an error in it"""
    conductivity_w_m_k: float | None = None
    """kept in the foam file; the fit has no use for it"""


@dataclasses.dataclass(frozen=True)
class _Question:
    foam: tyro.conf.Positional[str]
    """a built-in foam, or a foam file"""
    thickness_mm: float = 50.0
    """thickness of the foam along the wire"""
    wire_length_mm: float = 430.0
    """heated length of the wire, over which its power is spread"""
    wire_diameter_mm: float = 0.4
    """diameter of the wire"""
    model: Literal["energy", "general", "measured", "dissertation"] = "energy"
    """which model answers"""


@dataclasses.dataclass(frozen=True)
class Width(_Question):
    """Kerf at a power and a speed."""

    power_w: float = tyro.MISSING
    """power of the whole heated wire"""
    speed_mm_s: float = tyro.MISSING
    """speed of the wire across itself"""


@dataclasses.dataclass(frozen=True)
class Speed(_Question):
    """Speed for a wanted kerf at a power."""

    power_w: float = tyro.MISSING
    """power of the whole heated wire"""
    kerf_mm: float = tyro.MISSING
    """wanted width of the slot"""


@dataclasses.dataclass(frozen=True)
class Power(_Question):
    """Power for a wanted kerf at a speed."""

    speed_mm_s: float = tyro.MISSING
    """speed of the wire across itself"""
    kerf_mm: float = tyro.MISSING
    """wanted width of the slot"""


Action = tyro.conf.OmitSubcommandPrefixes[
    Annotated[Fit, tyro.conf.subcommand("fit")]
    | Annotated[Width, tyro.conf.subcommand("width")]
    | Annotated[Speed, tyro.conf.subcommand("speed")]
    | Annotated[Power, tyro.conf.subcommand("power")]
]


def run(action: Fit | Width | Speed | Power) -> None:
    """Answer, or fit and write. Raises `TandemError` with codes in the room ``kerf``."""
    if isinstance(action, Fit):
        _fit(action)
    else:
        _width_at(action)


def _width_at(question: Width | Speed | Power) -> None:
    from planner.hotwire.kerf import width as kerf

    foam = _foam(question.foam)
    wire = kerf.HotWire(question.wire_diameter_mm * MM, question.wire_length_mm * MM)
    thickness = question.thickness_mm * MM
    if isinstance(question, Speed):
        power, kerf_width = question.power_w, question.kerf_mm * MM
        speed = float(kerf.speed_for(foam, wire, power, kerf_width, thickness, question.model))
    elif isinstance(question, Power):
        speed, kerf_width = question.speed_mm_s * MM, question.kerf_mm * MM
        power = float(kerf.power_for(foam, wire, speed, kerf_width, thickness, question.model))
    else:
        power, speed = question.power_w, question.speed_mm_s * MM
    _print(kerf.width(foam, wire, power, speed, thickness, question.model), power, speed)


def _print(estimate: KerfEstimate, power: float, speed: float) -> None:
    from planner.hotwire.kerf.width import explain

    low, middle, high = (float(value) / MM for value in (estimate.low, estimate.width, estimate.high))
    out.print(f"kerf {middle:.2f} mm ({low:.2f} to {high:.2f} mm in 9 of 10 cuts)")
    out.print(f"at {power:.1f} W and {speed / MM:.2f} mm/s")
    for text in explain(int(estimate.flag)):
        out.print(f"mind: {text}")


def _foam(text: str) -> Foam:
    from planner.catalogue.materials import foam
    from planner.reading import materials as material_file

    return material_file.read_foam(Path(text)) if text.endswith((".yaml", ".yml")) else foam(text)


def _fit(request: Fit) -> None:
    from planner.hotwire.kerf import calibration
    from planner.reading import materials as material_file

    given: dict[str, object] = {
        "density_kg_m3": request.density_kg_m3,
        "specific_heat_j_kg_k": request.specific_heat_j_kg_k,
        "melt_temperature_c": request.melt_temperature_c,
        "name": request.name,
    }
    if request.conductivity_w_m_k is not None:
        given["conductivity_w_m_k"] = request.conductivity_w_m_k
    foam = material_file.make_foam(given)
    diameter = _metres("wire_diameter_mm", request.wire_diameter_mm)
    length = None if request.wire_length_mm is None else _metres("wire_length_mm", request.wire_length_mm)
    thickness = None if request.thickness_mm is None else _metres("thickness_mm", request.thickness_mm)
    read = calibration.read_cuts(request.tests, diameter, length, thickness)
    report = calibration.robust(
        foam, read.cuts, read.burnt, read.dragging, read.good, read.thickness, diameter
    )
    today = dt.date.today().isoformat()
    source = f"{report.fit.count} of {len(read.cuts)} test cuts in {request.tests.name}, fitted {today}"
    material_file.write_foam(request.output, dataclasses.replace(foam, kerf=report.fit), source)
    _print_fit(report, read, request.output)


def _metres(name: str, value_mm: float) -> float:
    if not (math.isfinite(value_mm) and value_mm > 0.0):
        text = f"got {value_mm:g}, allowed a number above 0"
        raise TandemError(Issue("kerf.input", text, field=name, hint="correct it"))
    return value_mm * MM


def _print_fit(report: FitReport, read: CutFile, path: Path) -> None:
    from planner.hotwire.kerf import models as kerf_models

    fit, size = report.fit, abs(report.residuals[report.kept]) / MM
    half = float(kerf_models.margin(fit, fit.mean_ideal)) / MM
    out.print(f"chi {fit.chi:.3f}, offset {fit.offset / MM:.3f} mm")
    out.print(
        f"{fit.count} cuts used; left out as too hot {report.hot.sum()}, as too cold {report.cold.sum()}"
    )
    out.print(f"residual {size.mean():.3f} mm in the mean, {size.max():.3f} mm at worst")
    out.print(f"9 of 10 cuts within {half:.2f} mm of the fit, in foam {read.thickness / MM:g} mm thick")
    out.print(f"written to {path}: tandem kerf width {path} --power-w ... --speed-mm-s ...")
