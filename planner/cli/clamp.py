"""``tandem calibrate-clamp CSV``: effect of a clamp on its sheet, from readings on a flat sheet."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from planner.cli.console import plain_out as out
from planner.cli.console import require_suffix, write_output
from planner.geometry.units import MM
from planner.issues import Issue, issue_error

if TYPE_CHECKING:
    from planner.problem import Problem
    from planner.processes.forming.plan.springback.clamp_calibration import (
        ClampCalibration,
        IntervalEstimate,
        PlateReadings,
        TestPlate,
    )


@dataclasses.dataclass(frozen=True)
class CalibrateClamp:
    """Find how a clamp's border acts, the sheet thickness, and how much softer the sheet is than the shell.

    Clamp a flat sheet as for the job, press it down at one point with known forces, and read a dial gauge
    there.
    """

    readings: tyro.conf.Positional[Path]
    """the readings, CSV: columns force_n and dial_mm"""
    problem: Path
    """the problem file whose sheet and clamp were tested; or a bundled problem"""
    thickness_tol_mm: float | None = None
    """thickness tolerance of the sheet; else 5 % is assumed and reported"""
    dial_mm: float = 0.02
    """standard deviation of a dial reading"""
    place_mm: tuple[float, float] = (0.0, 0.0)
    """position of the load, in the sheet's frame"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """an .html page to write: readings and the fitted curve"""


def run_calibrate_clamp(request: CalibrateClamp, problem: Problem) -> tuple[Issue, ...]:
    """Compute, print and write the calibration of a clamp. Return warnings.

    Raises:
        TandemError: The test or its files are not usable.
    """
    import numpy as np
    import shapely

    from planner.processes.forming.plan.springback import clamp_calibration
    from planner.shell.newton import LimitLoadError

    sheet = problem.stock.sheet
    if sheet is None:
        message = f"{problem.name}: has a block and no sheet; state the problem whose clamp was tested"
        raise issue_error("forming.no_sheet", message, field="problem")
    require_suffix(request.output, "a page is .html", (".html",))
    thickness = float(problem.stock.size[2])
    tolerance = 0.05 * thickness if request.thickness_tol_mm is None else request.thickness_tol_mm * MM
    position = np.array(request.place_mm) * MM
    _require_range("thickness_tol_mm", tolerance / thickness, 1e-3, 0.2, "of the thickness")
    _require_range("dial_mm", request.dial_mm, 1e-4, 1.0, "mm")
    if (
        not shapely.Polygon(sheet.opening)
        .buffer(-clamp_calibration.PRESSED_WIDTH_M)
        .contains(shapely.Point(position))
    ):
        problem_text = (
            f"place_mm: got {request.place_mm[0]:g}, {request.place_mm[1]:g}, which is not in the opening"
        )
        raise issue_error(
            "forming.plate_test", f"{problem_text}; state the position of the load", field="place_mm"
        )
    readings = clamp_calibration.read_readings(request.readings, request.dial_mm * MM)
    plate = clamp_calibration.TestPlate(
        sheet.opening, position, sheet.metal.young, sheet.metal.poisson, thickness, tolerance
    )
    try:
        response = clamp_calibration.plate_response(
            plate, float(readings.force.max()), float(readings.force.min())
        )
    except (LimitLoadError, ValueError) as error:
        message = f"{request.readings.name}: the sheet of {problem.name} does not bear these forces ({error})"
        raise issue_error("forming.plate_test", message, file=str(request.readings)) from error
    calibration = clamp_calibration.calibrate(plate, readings, response)
    _print_calibration(calibration, plate, request.thickness_tol_mm is None)
    if request.output is not None:
        write_output(request.output, _calibration_page(request, problem, plate, readings, calibration))
    return clamp_calibration.clarity_issues(calibration, plate, readings, request.thickness_tol_mm is None)


def _require_range(name: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:
        message = f"{name}: got {value:g} {unit}, allowed {low:g} to {high:g}; correct it"
        raise issue_error("forming.plate_test", message, field=name)


def _print_calibration(calibration: ClampCalibration, plate: TestPlate, is_tolerance_assumed: bool) -> None:
    """Print the estimates with their intervals, the line for the problem file, and the assumptions."""
    table = Table("figure", "value", "95 % from", "to")
    _add_row(table, "border, 0 slides, 1 is immovable", calibration.grip, 1.0, 2)
    _add_row(table, "its spring, N/mm per mm", calibration.spring, MM**2, 2)
    _add_row(table, "thickness, mm", calibration.thickness, 1.0 / MM, 3)
    _add_row(table, "kappa, sheet over shell", calibration.kappa, 1.0, 3)
    out.print(table)
    max_deviation = float(abs(calibration.residuals).max()) / MM
    out.print(f"readings deviate from the fit by at most {max_deviation:.3f} mm")
    lines = {
        "sliding": "clamp: {border: sliding}",
        "immovable": "clamp: {border: immovable}",
        "spring": f"clamp: {{border: spring, spring_n_mm2: {calibration.spring.value * MM**2:.4g}}}",
        "unknown": "clamp: not determined by these readings",
    }
    out.print(f"for the problem: {lines[calibration.border]}", markup=False)
    assumptions = f"assumed: Young's modulus {plate.young / 1e9:g} GPa, Poisson's ratio {plate.poisson:g}"
    assumptions += ", thickness within 5 %" if is_tolerance_assumed else ""
    out.print(f"{assumptions}; kappa includes the error of the modulus", markup=False)


def _add_row(table: Table, name: str, estimate: IntervalEstimate, unit: float, digits: int) -> None:
    """Add an estimate and its 95 % interval to a table. ``unit`` is a factor from SI to the printed unit."""
    table.add_row(
        name, *(f"{value * unit:.{digits}f}" for value in (estimate.value, estimate.low, estimate.high))
    )


def _calibration_page(
    request: CalibrateClamp,
    problem: Problem,
    plate: TestPlate,
    readings: PlateReadings,
    calibration: ClampCalibration,
) -> str:
    """Return the page with the readings of the plate test, the fitted curve and the estimates."""
    from planner.report import exhibits

    exhibits_by_name = {
        "test": {
            "kind": "curve",
            "title": "Deflection of the flat sheet over force",
            "x": readings.force,
            "x_label": "force [N]",
            "y_label": "deflection [mm]",
            "series": (
                {"name": "readings", "y": readings.dial / MM, "style": "dots"},
                {"name": "fit", "y": (readings.dial - calibration.residuals) / MM},
            ),
        }
    }
    about = (
        f"Fit: border {calibration.border}, thickness {calibration.thickness.value / MM:.3f} mm of "
        f"{plate.thickness / MM:g} ordered, kappa {calibration.kappa.value:.3f}."
    )
    title = f"Plate test {request.readings.name} of {problem.name}"
    return exhibits.exhibits_page(title, ("test", "Plate test"), exhibits_by_name, about)
