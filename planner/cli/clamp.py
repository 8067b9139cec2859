"""``tandem calibrate-clamp CSV``: what a clamp does to its sheet, by readings on a flat one."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from planner.cli.console import plain_out as out
from planner.cli.console import require_suffix, write_output
from planner.geometry.units import MM
from planner.issues import Issue, refusal

if TYPE_CHECKING:
    from planner.problem import Problem
    from planner.processes.forming.plan.springback.clamp_calibration import (
        Calibration,
        Estimate,
        Plate,
        Readings,
    )


@dataclasses.dataclass(frozen=True)
class CalibrateClamp:
    """Find what a clamp's border does in plane, how thick the sheet is, how much softer than the shell it is.

    Clamp a flat sheet as for the job, press it down with known forces in one place, and read a dial there.
    """

    readings: tyro.conf.Positional[Path]
    """the readings, CSV: columns force_n and dial_mm"""
    problem: Path
    """the problem file whose sheet and clamp were pressed; or a bundled problem"""
    thickness_tol_mm: float | None = None
    """by how much the sheet may be off its thickness; else 5 %, which is told as assumed"""
    dial_mm: float = 0.02
    """error of a reading of the dial, one standard deviation"""
    place_mm: tuple[float, float] = (0.0, 0.0)
    """where it was pressed, in the sheet's frame"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """an .html page to write: readings and the fitted curve"""


def run_calibrate_clamp(request: CalibrateClamp, problem: Problem) -> tuple[Issue, ...]:
    """Work out, print and write; warnings come back. Raises `TandemError`."""
    import numpy as np
    import shapely

    from planner.processes.forming.plan.springback import clamp_calibration
    from planner.shell.newton import LimitLoadError

    sheet = problem.stock.sheet
    if sheet is None:
        what = f"{problem.name}: has a block and no sheet; give the problem whose clamp was pressed"
        raise refusal("forming.no_sheet", what, field="problem")
    require_suffix(request.output, "a page is .html", (".html",))
    thickness = float(problem.stock.size[2])
    tolerance = 0.05 * thickness if request.thickness_tol_mm is None else request.thickness_tol_mm * MM
    place = np.array(request.place_mm) * MM
    _require("thickness_tol_mm", tolerance / thickness, 1e-3, 0.2, "of the thickness")
    _require("dial_mm", request.dial_mm, 1e-4, 1.0, "mm")
    if not shapely.Polygon(sheet.opening).buffer(-clamp_calibration.COLUMN).contains(shapely.Point(place)):
        got = f"place_mm: got {request.place_mm[0]:g}, {request.place_mm[1]:g}, which is not in the opening"
        raise refusal("forming.plate_test", f"{got}; say where it was pressed", field="place_mm")
    readings = clamp_calibration.read_readings(request.readings, request.dial_mm * MM)
    plate = clamp_calibration.Plate(
        sheet.opening, place, sheet.metal.young, sheet.metal.poisson, thickness, tolerance
    )
    try:
        response = clamp_calibration.respond(plate, float(readings.force.max()), float(readings.force.min()))
    except (LimitLoadError, ValueError) as error:
        what = f"{request.readings.name}: the sheet of {problem.name} does not bear these forces ({error})"
        raise refusal("forming.plate_test", what, file=str(request.readings)) from error
    found = clamp_calibration.calibrate(plate, readings, response)
    _print(found, plate, request.thickness_tol_mm is None)
    if request.output is not None:
        write_output(request.output, _page(request, problem, plate, readings, found))
    return clamp_calibration.unclear(found, plate, readings, request.thickness_tol_mm is None)


def _require(name: str, value: float, least: float, most: float, unit: str) -> None:
    if not least <= value <= most:
        what = f"{name}: got {value:g} {unit}, allowed {least:g} to {most:g}; correct it"
        raise refusal("forming.plate_test", what, field=name)


def _print(found: Calibration, plate: Plate, assumed: bool) -> None:
    table = Table("figure", "value", "95 % from", "to")
    _row(table, "border, 0 slides, 1 does not move", found.grip, 1.0, 2)
    _row(table, "its spring, N/mm for each mm", found.spring, MM**2, 2)
    _row(table, "thickness, mm", found.thickness, 1.0 / MM, 3)
    _row(table, "kappa, of the sheet over the shell", found.kappa, 1.0, 3)
    out.print(table)
    worst = float(abs(found.left).max()) / MM
    out.print(f"readings are off the fit by {worst:.3f} mm at most")
    lines = {
        "sliding": "clamp: {border: sliding}",
        "immovable": "clamp: {border: immovable}",
        "spring": f"clamp: {{border: spring, spring_n_mm2: {found.spring.value * MM**2:.4g}}}",
        "unknown": "clamp: not told by these readings",
    }
    out.print(f"for the problem: {lines[found.border]}", markup=False)
    told = f"assumed: Young's modulus {plate.young / 1e9:g} GPa, Poisson's ratio {plate.poisson:g}"
    told += ", thickness within 5 %" if assumed else ""
    out.print(f"{told}; what the modulus is off goes into kappa", markup=False)


def _row(table: Table, name: str, one: Estimate, unit: float, digits: int) -> None:
    table.add_row(name, *(f"{value * unit:.{digits}f}" for value in (one.value, one.low, one.high)))


def _page(
    request: CalibrateClamp, problem: Problem, plate: Plate, readings: Readings, found: Calibration
) -> str:
    from planner.report import exhibits

    shown = {
        "test": {
            "kind": "curve",
            "title": "Deflection of the flat sheet over force",
            "x": readings.force,
            "x_label": "force [N]",
            "y_label": "deflection [mm]",
            "series": (
                {"name": "readings", "y": readings.dial / MM, "style": "dots"},
                {"name": "fit", "y": (readings.dial - found.left) / MM},
            ),
        }
    }
    about = (
        f"Fit: border {found.border}, thickness {found.thickness.value / MM:.3f} mm of "
        f"{plate.thickness / MM:g} ordered, kappa {found.kappa.value:.3f}."
    )
    title = f"Plate test {request.readings.name} of {problem.name}"
    return exhibits.page(title, ("test", "Plate test"), shown, about)
