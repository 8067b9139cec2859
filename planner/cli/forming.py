"""``tandem springback`` and ``control``: springback and force control, before anything is formed.

``tandem springback PROBLEM``: springback of a formed part when it is released from the tools. ``tandem
control PROBLEM --machine FILE``: gains of force control and of compensation, and their accuracy.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table

from planner.cli.batch import usable_cores
from planner.cli.console import plain_out as out
from planner.cli.console import require_suffix, write_output
from planner.files import format_csv
from planner.geometry.units import MM
from planner.issues import Issue, issue_error

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.loops.machine import MachineBehaviour, MachineFile
    from planner.problem import Problem
    from planner.processes.forming.plan.job import FormingJob
    from planner.processes.forming.plan.process_plan import FormingWork
    from planner.processes.forming.plan.springback.compensation import ShiftedPath
    from planner.processes.forming.plan.springback.control_points import ControlPoints
    from planner.processes.forming.plan.springback.curves import (
        PassSpringback,
        SpringbackCurve,
        SpringbackPoint,
    )


MIN_TRIANGLES = 300
"""Minimum number of triangles of an elastic sheet for a meaningful result."""
MIN_WRITTEN_TRIANGLES = 3000
"""Minimum number of triangles for a springback file, and the first number in the convergence check."""
REFINEMENT_RATIO = 2.25
"""Ratio of triangles of the finer sheet in the convergence check: edges are two thirds as long."""
CONVERGENCE_TOLERANCE = 0.015
"""Relative difference below which both sheets agree. Chosen: half of what the proof allows."""
MAX_TRIANGLES = 20_000
"""Maximum number of triangles of an elastic sheet."""
MAX_ROWS = 24
"""Maximum number of rows of a printed table."""


@dataclasses.dataclass(frozen=True)
class SpringbackCommand:
    """Predict the springback of a formed part when it is released from the tools.

    It is predicted by position, force and level. The sheet as formed at each position is an elastic shell
    with large displacements. Forces are those that the operation states (force_n or force_by, less
    support_force_n), or those of a formula for one tool.
    """

    problem: tyro.conf.Positional[Path]
    """the problem file; or a bundled problem"""
    operation: str | None = None
    """name of the forming operation; else the first"""
    most_points: int = 60
    """maximum number of control points of a pass; at least three levels get some"""
    triangles: int | None = None
    """maximum number of triangles of the elastic sheet: default 4000, with --write as many as agree with a
    finer sheet; 1500 take a quarter of the time and deviate by about 2 percent
    """
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """file to write: .csv (control points with their curves) or .html (map, curves, clusters)"""
    write: Path | None = None
    """a springback file to write (.json): with `springback: {file: ...}` in the operation, tools go deeper by
    the shifts in it
    """
    curves: Path | None = None
    """a .json file to write, with curves at every level of the path, for `tandem next-loop`"""


def run_springback(request: SpringbackCommand, problem: Problem) -> tuple[Issue, ...]:
    """Predict the springback of a forming operation, print it and write the requested files. Return warnings.

    Raises:
        TandemError: Options or the operation are not suitable.
    """
    from planner.processes.forming.plan.process_plan import make_tool_paths
    from planner.processes.forming.plan.springback import forecast, released_part
    from planner.processes.forming.plan.springback.curves import MAX_TRIANGLES

    require_suffix(request.output, "a page is .html, a table .csv", (".csv", ".html"))
    require_suffix(request.curves, "a file of curves is .json", (".json",), "curves")
    for name, value, min_value in (
        ("most_points", request.most_points, 1),
        ("triangles", request.triangles, MIN_TRIANGLES),
    ):
        if value is not None and value < min_value:
            text = f"got {value}, allowed at least {min_value}"
            raise issue_error("forming.springback_mode", text, field=name, hint="correct it")
    if request.write is not None and (request.triangles or MIN_WRITTEN_TRIANGLES) < MIN_WRITTEN_TRIANGLES:
        text = f"got {request.triangles}, allowed at least {MIN_WRITTEN_TRIANGLES} with --write: the proof "
        text += "checks parts of a springback file on finer meshes and allows 3 percent"
        raise issue_error("forming.springback_mode", text, field="triangles", hint="omit it")
    require_suffix(request.write, "a springback file is .json", (".json",), "write")
    job = forming_job(problem, request.operation)
    work = job.planned
    forecast.require_forecast_mode(work)
    started = time.perf_counter()
    planned_passes = make_tool_paths(work)
    control = forecast.forecast_points(work, planned_passes, request.most_points)
    all_points = [point for _, rows in control for point in rows]
    triangles = request.triangles or MAX_TRIANGLES
    # a springback file is proven with finer meshes, so its mesh has to be fine enough
    if request.write is not None and request.triangles is None:
        triangles = _converged_triangles(work, control)
    forecasts = forecast.make_forecast(planned_passes, control, _solve_curves(work, all_points, triangles))
    _print_forecast(work, forecasts, time.perf_counter() - started)
    allowed_counts = [
        curve.allowed
        for pass_forecast in forecasts
        for curve in pass_forecast.curves
        if curve.allowed > triangles
    ]
    if allowed_counts:
        mesh_text = (
            f"{triangles} triangles are too few for a mesh of the sheet at {len(allowed_counts)} of them"
        )
        out.print(f"{mesh_text}: up to {max(allowed_counts)} are allowed there")
    shifted_paths = (
        () if request.write is None else _write_shifts(request.write, problem, job, forecasts, planned_passes)
    )
    if request.output is not None:
        is_page = request.output.suffix.lower() == ".html"
        exhibits_by_name = (
            {
                **released_part.springback_maps(work, planned_passes, forecasts, shifted_paths),
                **forecast.forecast_exhibits(forecasts),
            }
            if is_page
            else {}
        )
        write_output(
            request.output,
            _forecast_page(problem, work, exhibits_by_name) if is_page else _forecast_csv(forecasts),
        )
    if request.curves is not None:
        from planner.processes.forming.plan.springback.levels import loop_file_data

        data = loop_file_data(problem.name, problem.digest, work, planned_passes, forecasts)
        write_output(request.curves, json.dumps(data, separators=(",", ":")) + "\n")
    springback_section = job.operation.springback
    if springback_section is None:
        return tuple(forecast.forecast_issues(forecasts))
    out.print(
        f"{job.operation.name} goes deeper by {springback_section.file.name}: figures above are without it",
        markup=False,
    )
    return tuple(issue for issue in forecast.forecast_issues(forecasts) if issue.code != "forming.springback")


def _write_shifts(
    path: Path,
    problem: Problem,
    job: FormingJob,
    forecasts: Sequence[PassSpringback],
    planned_passes: Sequence[Any],
) -> tuple[ShiftedPath, ...]:
    """Write the springback file, and print the shifts and the springback that remains uncompensated.

    Some springback remains where the shift grows from 0, because its slope along the path is limited.

    Returns:
        The paths with their shifts.

    Raises:
        TandemError: ``forming.compensation``, a shift is too large, or the mode is not supported.
    """
    from planner.processes.forming.plan.operation import Springback as Section
    from planner.processes.forming.plan.springback import compensation, compensation_file

    compensation.require_compensation_mode(job.planned)
    limits = job.operation.springback or Section(file=path)
    paths, remainders = compensation.compensated_paths(job.planned, planned_passes, forecasts, limits.slope)
    for tool_path in paths:
        max_shift = float(tool_path.shift.max()) / MM
        if max_shift > limits.most_mm:
            message = (
                f"pass {tool_path.name}: a shift of {max_shift:.2f} mm is needed, most_mm allows "
                f"{limits.most_mm:g} mm"
            )
            hint = "support the sheet closer to the part, or allow more: springback: {most_mm: ...}"
            raise issue_error("forming.compensation", message, field="springback.most_mm", hint=hint)
    identity = compensation_file.job_identity(job.planned, job.setup.stock, job.part)
    text = compensation_file.springback_file_text(
        problem.name, job.planned, identity, forecasts, paths, limits.slope
    )
    write_output(path, text, "springback file written to")
    for line in compensation_file.assumptions(job.planned):
        out.print(f"assumed: {line}", markup=False)
    for tool_path, rest in zip(paths, remainders, strict=True):
        out.print(
            f"pass {tool_path.name}: tools go up to {float(tool_path.shift.max()) / MM:.2f} mm deeper; "
            f"where the shift grows from 0, by at most {limits.slope:g} mm/mm, up to {rest.max() / MM:.2f} "
            "mm remain",
            markup=False,
        )
    out.print(
        f"use it: springback: {{file: {path.name}}} in operation {job.operation.name}, path relative "
        "to the problem file's folder",
        markup=False,
    )
    return paths


def forming_job(problem: Problem, name: str | None) -> FormingJob:
    """Return the forming operation with that name, or the first one.

    Raises:
        TandemError: ``forming.no_sheet``, there is no such operation.
    """
    from planner.processes import registry
    from planner.processes.forming.plan.job import FormingJob

    jobs = [job for job in registry.jobs(problem) if isinstance(job, FormingJob)]
    matching_jobs = [job for job in jobs if name in (None, job.operation.name)]
    if not matching_jobs:
        names = ", ".join(job.operation.name for job in jobs) or "none"
        message = f"{problem.name}: got operation {name or 'of forming'}, allowed forming operations: {names}"
        raise issue_error("forming.no_sheet", message, field="operation")
    return matching_jobs[0]


def _converged_triangles(
    work: FormingWork, control_points: Sequence[tuple[ControlPoints, list[SpringbackPoint]]]
) -> int:
    """Find the number of triangles of the sheet with which the springback of sample points has converged.

    The number is increased until the springback differs from that with a finer sheet by at most
    `CONVERGENCE_TOLERANCE`, or `MAX_TRIANGLES` is reached. The sample points of a pass are spread from its
    first to its last level.
    """
    from planner.processes.forming.plan.springback import forecast

    points = forecast.comparison_points(control_points)
    triangles = MIN_WRITTEN_TRIANGLES
    curves = _solve_curves(work, points, MIN_WRITTEN_TRIANGLES, forecast.ESTIMATE_LOAD_FACTORS)
    while triangles < MAX_TRIANGLES:
        finer = min(int(REFINEMENT_RATIO * triangles), MAX_TRIANGLES)
        finer_curves = _solve_curves(work, points, finer, forecast.ESTIMATE_LOAD_FACTORS)
        deviation = forecast.max_relative_difference(points, curves, finer_curves)
        if deviation <= CONVERGENCE_TOLERANCE:
            break
        out.print(
            f"with {triangles} triangles the springback differs by up to {100.0 * deviation:.1f} % from "
            f"that with {finer}: {finer} are used"
        )
        triangles, curves = finer, finer_curves
    return triangles


def _solve_curves(
    work: FormingWork, points: Sequence[SpringbackPoint], triangles: int, fractions: FloatArray | None = None
) -> list[SpringbackCurve]:
    """Compute the springback curves of points of the sheet, on all cores.

    This process and n - 1 others compute every n-th point each.

    Args:
        work: Plan of the forming operation.
        points: Points of the sheet.
        triangles: Maximum number of triangles of the elastic sheet.
        fractions: Fractions of the expected forces at which a curve is computed, or None for `LOAD_FACTORS`.

    Returns:
        Curves in the order of the points.
    """
    from planner.pipeline import WARM_UP
    from planner.processes.forming.plan.springback.curves import LOAD_FACTORS
    from planner.processes.forming.plan.springback.forecast import solve_curves
    from planner.runtime.second_process import SecondProcess

    load_factors = LOAD_FACTORS if fractions is None else fractions
    count = max(1, min(usable_cores(), len(points)))
    with contextlib.ExitStack() as stack:
        executors = [stack.enter_context(SecondProcess(WARM_UP)) for _ in range(count - 1)]
        submitted = [
            executor.submit(solve_curves, work, points[process_index + 1 :: count], triangles, load_factors)
            for process_index, executor in enumerate(executors)
        ]
        curves_by_process = [
            list(solve_curves(work, points[::count], triangles, load_factors)),
            *(list(result) for result in submitted),
        ]
    curves_in_order: list[SpringbackCurve | None] = [None] * len(points)
    for process_index, curves in enumerate(curves_by_process):
        curves_in_order[process_index::count] = curves
    return [curve for curve in curves_in_order if curve is not None]


def _print_forecast(work: FormingWork, forecasts: Sequence[PassSpringback], seconds: float) -> None:
    """Print the springback at each level of each pass, and the assumptions."""
    from planner.processes.forming.plan.springback.forecast import describe_forces

    count = sum(len(pass_forecast.curves) for pass_forecast in forecasts)
    table = Table("pass", "z mm", "points", "wall deg", "force N", "springback mm")
    rows = [row for pass_forecast in forecasts for row in _level_rows(pass_forecast)]
    step = -(-len(rows) // MAX_ROWS)  # rounded up, so that at most MAX_ROWS rows are printed
    for row in rows[::step] if step > 1 else rows:
        table.add_row(*row)
    out.print(table)
    border = work.sheet.border
    border_text = (
        "slides in its plane"
        if border == 0.0
        else "is immovable"
        if border == float("inf")
        else (f"yields with a spring of {border * MM**2:g} N/mm per mm")
    )
    force = "; ".join(describe_forces(work))
    out.print(f"{count} control points in {seconds:.1f} s; {force}; assumed: the sheet's edge {border_text}")


def _level_rows(pass_forecast: PassSpringback) -> Iterator[tuple[str, ...]]:
    """Yield the table row of each level of a pass, with the ranges over its control points."""
    import numpy as np

    from planner.geometry.units import DEG

    for level in range(len(pass_forecast.control.rings)):
        on_level = pass_forecast.control.level == level
        yield (
            pass_forecast.forming_pass.name,
            f"{float(pass_forecast.control.point[on_level, 2].mean()) / MM:.2f}",
            f"{np.count_nonzero(on_level)}",
            _format_span(pass_forecast.control.angle[on_level] / DEG, 1),
            _format_span(pass_forecast.force[on_level], 0),
            _format_span(pass_forecast.springback[on_level] / MM, 2),
        )


def _format_span(values: Any, digits: int) -> str:
    """Format the range of an array. A value that is not a number means that the sheet snaps through."""
    if (values != values).any():  # only NaN differs from itself
        return "snaps"
    low, high = f"{values.min():.{digits}f}", f"{values.max():.{digits}f}"
    return low if low == high else f"{low} to {high}"


def _forecast_csv(forecasts: Sequence[PassSpringback]) -> str:
    """Return a springback forecast as CSV: a heading, and a row for each control point.

    Values that are lists become one cell, separated by spaces.
    """
    from planner.processes.forming.plan.springback.forecast import forecast_rows

    data = forecast_rows(forecasts)
    cells = [
        [" ".join(map(str, value)) if isinstance(value, list) else value for value in row.values()]
        for row in data
    ]
    return format_csv([[*data[0]], *cells])


def _forecast_page(problem: Problem, work: FormingWork, exhibits_by_name: dict[str, Any]) -> str:
    """Return the page with the predicted springback of an operation."""
    import numpy as np

    from planner.report import exhibits

    block = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * problem.stock.size
    about = (
        "The sheet as formed so far is an elastic shell, loaded at the tool. Effects of unclamping and "
        "trimming are not included."
    )
    title = f"Springback of {work.operation.name}"
    section = ("springback", "Springback")
    return exhibits.exhibits_page(title, section, exhibits_by_name, about, block, f"{problem.name}: {title}")


@dataclasses.dataclass(frozen=True)
class ControlRequest:
    """Compute gains of force control of the support and of compensation of the forming arm, for your machine.

    The control loops are simulated: a step of the force, and a gap that changes.
    """

    problem: tyro.conf.Positional[Path]
    """the problem file; or a bundled problem"""
    machine: Path
    """stiffness, bandwidth and delay of both arms, the sensor, and the required force, YAML"""
    operation: str | None = None
    """name of the forming operation; else the first"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """an .html page to write: both responses over time"""


def run_control(request: ControlRequest, problem: Problem) -> tuple[Issue, ...]:
    """Compute the gains of force control, simulate the loops, and print and write the results.

    Returns:
        Warnings.

    Raises:
        TandemError: The machine file or the operation is not suitable.
    """
    from planner.loops import machine

    require_suffix(request.output, "a page is .html", (".html",))
    file = machine.read_machine(request.machine)
    operation = forming_job(problem, request.operation).operation
    if len(operation.arms) != 2:
        message = f"{operation.name}: mode {operation.mode} has one arm, force control needs a support arm"
        raise issue_error("control.machine", message, field="operation", hint="use a mode with two arms")
    feed = operation.feed_mm_s * MM
    simulation = machine.simulate_machine(file, feed)
    _print_control(file, simulation, feed)
    if request.output is not None:
        write_output(request.output, _control_page(operation.name, file, simulation))
    return tuple(machine.machine_warnings(file, simulation, feed))


def _print_control(file: MachineFile, simulation: MachineBehaviour, feed: float) -> None:
    """Print gains and simulated accuracy of force control at a feed [m/s]."""
    from planner.loops.machine import INTERFACES

    machine = file.value()
    effective_stiffness, lag = machine.effective_contact(simulation.control.fraction)
    table = Table("figure", "value")
    for name, value in (
        ("stiffness of the contact", f"{machine.contact * MM:.0f} N/mm"),
        ("as seen by the support's loop", f"{effective_stiffness * MM:.0f} N/mm, lag {lag * 1e3:.1f} ms"),
        (
            "integral gain",
            f"{simulation.control.gain * 1e6:.2f} um/(N s), unstable from {simulation.max_gain * 1e6:.2f}",
        ),
        (
            "loop gain of the compensation",
            f"{simulation.control.fraction * machine.compliance_gain:.2f}, must be below 1",
        ),
        ("remaining deflection", f"{100.0 * simulation.remaining_deflection:.0f} % of the forming arm's"),
        (
            "step: overshoot, to 90 %",
            f"{100.0 * simulation.response.overshoot[0]:.1f} %, {simulation.response.rise[0]:.2f} s",
        ),
        (f"force at {feed / MM:g} mm/s", f"{file.force_n:g} N, error up to {simulation.error:.1f} N"),
        (f"feed for {file.band_n:g} N", f"{simulation.feed / MM:.3g} mm/s, without noise"),
        ("correction by compensation", f"{simulation.correction / MM:.2f} mm"),
    ):
        table.add_row(name, value)
    out.print(table)
    if file.interface is not None:
        out.print(f"{file.interface.upper()}: {INTERFACES[file.interface]}", markup=False)
    out.print(f"assumed: all figures of {file.name}, as its file states them", markup=False)


def _control_page(name: str, file: MachineFile, simulation: MachineBehaviour) -> str:
    """Return the page with forces and motions of the simulated responses over time."""
    from planner.report import exhibits

    band = [{"name": f"{sign:+g} N", "value": file.force_n + sign} for sign in (-file.band_n, file.band_n)]
    responses = (
        ("step", "Step of the required force", simulation.step),
        ("ramp", f"Gap that changes by {simulation.gap_speed / MM:.3g} mm/s", simulation.ramp),
    )
    exhibits_by_name = {
        key: {
            "kind": "curve",
            "title": title,
            "x": response.time,
            "x_label": "time [s]",
            "y_label": "force [N]",
            "series": (
                {"name": "as measured", "y": response.measured[0], "colour": 1},
                {"name": "force", "y": response.force[0], "colour": 0},
                {"name": "commanded", "y": response.commanded[0], "colour": 2},
            ),
            "limits": band,
        }
        for key, title, response in responses
    } | {
        f"{key}_way": {
            "kind": "curve",
            "title": f"{title}: motion of the arms",
            "x": response.time,
            "x_label": "time [s]",
            "y_label": "displacement [mm]",
            "series": (
                {"name": "support, from its start", "y": (response.support[0] - response.support[0, 0]) / MM},
                {"name": "uncompensated deflection of the forming arm", "y": response.deflection[0] / MM},
            ),
        }
        for key, title, response in responses
    }
    about = "A simulation with the figures of the machine's file, without measurements."
    title = f"Force control of {name} with {file.name}"
    return exhibits.exhibits_page(title, ("control", "Force over time"), exhibits_by_name, about)
