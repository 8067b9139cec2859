"""``tandem springback`` and ``control``: what a sheet and a machine give way by, before anything is formed.

``tandem springback PROBLEM``: how far a formed part comes back when the tools let go.
``tandem control PROBLEM --machine FILE``: gains of force control and of compensation, and what they keep.
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
from planner.files import csv_text
from planner.geometry.units import MM
from planner.issues import Issue, refusal

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.loops.machine import Found, MachineFile
    from planner.problem import Problem
    from planner.processes.forming.plan.job import FormingJob
    from planner.processes.forming.plan.process_plan import Work
    from planner.processes.forming.plan.springback.compensation import Way
    from planner.processes.forming.plan.springback.control_points import ControlPoints
    from planner.processes.forming.plan.springback.curves import Curve, PassSpringback, Point


LEAST_TRIANGLES = 300
"""Triangles of an elastic sheet that say anything at all."""
LEAST_WRITTEN = 3000
"""Triangles of the sheets of a springback file at least, and of those that a finer one is held against."""
FINER = 2.25
"""Triangles of the finer sheet, over those of the other: edges are two thirds as long."""
SETTLED = 0.015
"""Share by which both may differ: half of what the proof takes."""
MOST_TRIANGLES = 20_000
"""Triangles of an elastic sheet at most."""
MOST_ROWS = 24
"""Rows of a printed table at most."""


@dataclasses.dataclass(frozen=True)
class Springback:
    """Foretell how far a formed part comes back when the tools let go: by places, forces and levels.

    The sheet as formed at each place is an elastic shell with large displacements. Forces are those that the
    operation states (force_n or force_by, less support_force_n), or of a formula for one tool.
    """

    problem: tyro.conf.Positional[Path]
    """the problem file; or a bundled problem"""
    operation: str | None = None
    """which forming operation; else the first"""
    most_points: int = 60
    """control points of a pass at most; at least three levels get some"""
    triangles: int | None = None
    """of the elastic sheet at most: 4000, with --write as many as a finer sheet agrees with; 1500 take a
    quarter of the time and are some 2 percent off"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """what to write: .csv (control points with their curves) or .html (map, curves, clusters)"""
    write: Path | None = None
    """a springback file to write (.json): with `springback: {file: ...}` in the operation, tools go deeper by
    what it says"""
    curves: Path | None = None
    """a .json file of curves at every level of the path to write, for `tandem next-loop`"""


def run_springback(request: Springback, problem: Problem) -> tuple[Issue, ...]:
    """Work out, print and write; warnings come back. Raises `TandemError`."""
    from planner.processes.forming.plan.process_plan import lay_all
    from planner.processes.forming.plan.springback import forecast, released
    from planner.processes.forming.plan.springback.curves import TRIANGLES

    require_suffix(request.output, "a page is .html, a table .csv", (".csv", ".html"))
    require_suffix(request.curves, "a file of curves is .json", (".json",), "curves")
    for name, value, least in (
        ("most_points", request.most_points, 1),
        ("triangles", request.triangles, LEAST_TRIANGLES),
    ):
        if value is not None and value < least:
            what = f"got {value}, allowed {least} at least"
            raise refusal("forming.springback_mode", what, field=name, hint="correct it")
    if request.write is not None and (request.triangles or LEAST_WRITTEN) < LEAST_WRITTEN:
        what = f"got {request.triangles}, allowed {LEAST_WRITTEN} at least with --write: the proof "
        what += "works some of a springback file out on finer meshes and takes 3 percent"
        raise refusal("forming.springback_mode", what, field="triangles", hint="leave it out")
    require_suffix(request.write, "a springback file is .json", (".json",), "write")
    job = forming_job(problem, request.operation)
    work = job.planned
    forecast.require_mode(work)
    started = time.perf_counter()
    laid = lay_all(work)
    control = forecast.points(work, laid, request.most_points)
    every = [point for _, rows in control for point in rows]
    triangles = request.triangles or TRIANGLES
    if request.write is not None and request.triangles is None:
        triangles = _settled(work, control)
    found = forecast.forecast(laid, control, _solved(work, every, triangles))
    _print(work, found, time.perf_counter() - started)
    finer = [curve.allowed for one in found for curve in one.curves if curve.allowed > triangles]
    if finer:
        told = f"{triangles} triangles make no mesh of the sheet at {len(finer)} of them"
        out.print(f"{told}: up to {max(finer)} were allowed there")
    ways = () if request.write is None else _write_shifts(request.write, problem, job, found, laid)
    if request.output is not None:
        page = request.output.suffix.lower() == ".html"
        shown = {**released.maps(work, laid, found, ways), **forecast.exhibits(found)} if page else {}
        write_output(request.output, _page(problem, work, shown) if page else _csv(found))
    if request.curves is not None:
        from planner.processes.forming.plan.springback.levels import file_data

        data = file_data(problem.name, problem.digest, work, laid, found)
        write_output(request.curves, json.dumps(data, separators=(",", ":")) + "\n")
    stated = job.operation.springback
    if stated is None:
        return tuple(forecast.issues(found))
    out.print(
        f"{job.operation.name} goes deeper by {stated.file.name}: the above is without it", markup=False
    )
    return tuple(issue for issue in forecast.issues(found) if issue.code != "forming.springback")


def _write_shifts(
    path: Path, problem: Problem, job: FormingJob, found: Sequence[PassSpringback], laid: Sequence[Any]
) -> tuple[Way, ...]:
    """Write the springback file; say what the slope leaves of the forecast. The ways with their shifts."""
    from planner.processes.forming.plan.operation import Springback as Section
    from planner.processes.forming.plan.springback import compensation, compensation_file

    compensation.require_mode(job.planned)
    limits = job.operation.springback or Section(file=path)
    ways, left = compensation.ways(job.planned, laid, found, limits.slope)
    for way in ways:
        most = float(way.shift.max()) / MM
        if most > limits.most_mm:
            what = (
                f"pass {way.name}: a shift of {most:.2f} mm is wanted, most_mm allows {limits.most_mm:g} mm"
            )
            hint = "hold the sheet nearer to the part, or allow more: springback: {most_mm: ...}"
            raise refusal("forming.compensation", what, field="springback.most_mm", hint=hint)
    identity = compensation_file.belongs_to(job.planned, job.setup.stock, job.part)
    text = compensation_file.text(problem.name, job.planned, identity, found, ways, limits.slope)
    write_output(path, text, "springback file written to")
    for line in compensation_file.assumed(job.planned):
        out.print(f"assumed: {line}", markup=False)
    for way, rest in zip(ways, left, strict=True):
        out.print(
            f"pass {way.name}: tools go up to {float(way.shift.max()) / MM:.2f} mm deeper; where the shift "
            f"grows from 0, by {limits.slope:g} mm/mm at most, up to {rest.max() / MM:.2f} mm are left",
            markup=False,
        )
    out.print(
        f"use it: springback: {{file: {path.name}}} in operation {job.operation.name}, with the path as seen "
        "from the problem file's folder",
        markup=False,
    )
    return ways


def forming_job(problem: Problem, name: str | None) -> FormingJob:
    """The forming operation of a problem of that name, or the first. Raises ``TandemError``
    (forming.no_sheet) where there is none."""
    from planner.processes import registry
    from planner.processes.forming.plan.job import FormingJob

    jobs = [job for job in registry.jobs(problem) if isinstance(job, FormingJob)]
    chosen = [job for job in jobs if name in (None, job.operation.name)]
    if not chosen:
        have = ", ".join(job.operation.name for job in jobs) or "none"
        what = f"{problem.name}: got operation {name or 'of forming'}, forming operations are: {have}"
        raise refusal("forming.no_sheet", what, field="operation")
    return chosen[0]


def _settled(work: Work, control: Sequence[tuple[ControlPoints, list[Point]]]) -> int:
    """Triangles with which some points of each pass, from its first level to its last, come back as with more
    of them."""
    from planner.processes.forming.plan.springback import forecast

    asked = forecast.some_points(control)
    triangles, found = LEAST_WRITTEN, _solved(work, asked, LEAST_WRITTEN, forecast.ESTIMATE_SHARES)
    while triangles < MOST_TRIANGLES:
        finer = min(int(FINER * triangles), MOST_TRIANGLES)
        better = _solved(work, asked, finer, forecast.ESTIMATE_SHARES)
        off = forecast.apart(asked, found, better)
        if off <= SETTLED:
            break
        out.print(
            f"with {triangles} triangles places come back by up to {100.0 * off:.1f} % other than with "
            f"{finer}: {finer} are taken"
        )
        triangles, found = finer, better
    return triangles


def _solved(
    work: Work, points: Sequence[Point], triangles: int, shares: FloatArray | None = None
) -> list[Curve]:
    """The curves of all points, on all cores: each process works out every so manieth. At ``shares`` of the
    expected forces, or at those of a whole curve."""
    from planner.pipeline import WARM_UP
    from planner.processes.forming.plan.springback.curves import LOAD_SHARES
    from planner.processes.forming.plan.springback.forecast import curves
    from planner.runtime.second_process import SecondProcess

    loads = LOAD_SHARES if shares is None else shares
    count = max(1, min(usable_cores(), len(points)))
    with contextlib.ExitStack() as stack:
        executors = [stack.enter_context(SecondProcess(WARM_UP)) for _ in range(count - 1)]
        others = [
            executor.submit(curves, work, points[k + 1 :: count], triangles, loads)
            for k, executor in enumerate(executors)
        ]
        parts = [list(curves(work, points[::count], triangles, loads)), *(list(other) for other in others)]
    found: list[Curve | None] = [None] * len(points)
    for k, part in enumerate(parts):
        found[k::count] = part
    return [curve for curve in found if curve is not None]


def _print(work: Work, found: Sequence[PassSpringback], seconds: float) -> None:
    from planner.processes.forming.plan.springback.forecast import forces_told

    count = sum(len(one.curves) for one in found)
    table = Table("pass", "z mm", "points", "wall deg", "force N", "springback mm")
    rows = [row for one in found for row in _levels(one)]
    step = -(-len(rows) // MOST_ROWS)
    for row in rows[::step] if step > 1 else rows:
        table.add_row(*row)
    out.print(table)
    border = work.sheet.border
    kind = (
        "slides in its plane"
        if border == 0.0
        else "does not move"
        if border == float("inf")
        else (f"gives way by a spring of {border * MM**2:g} N/mm for each mm")
    )
    force = "; ".join(forces_told(work))
    out.print(f"{count} control points in {seconds:.1f} s; {force}; assumed: the sheet's edge {kind}")


def _levels(one: PassSpringback) -> Iterator[tuple[str, ...]]:
    import numpy as np

    from planner.geometry.units import DEG

    for level in range(len(one.control.rings)):
        mine = one.control.level == level
        yield (
            one.one.name,
            f"{float(one.control.point[mine, 2].mean()) / MM:.2f}",
            f"{np.count_nonzero(mine)}",
            _span(one.control.angle[mine] / DEG, 1),
            _span(one.force[mine], 0),
            _span(one.springback[mine] / MM, 2),
        )


def _span(values: Any, digits: int) -> str:
    if (values != values).any():
        return "snaps"
    low, high = f"{values.min():.{digits}f}", f"{values.max():.{digits}f}"
    return low if low == high else f"{low} to {high}"


def _csv(found: Sequence[PassSpringback]) -> str:
    from planner.processes.forming.plan.springback.forecast import rows

    data = rows(found)
    plain = [[" ".join(map(str, v)) if isinstance(v, list) else v for v in row.values()] for row in data]
    return csv_text([[*data[0]], *plain])


def _page(problem: Problem, work: Work, shown: dict[str, Any]) -> str:
    import numpy as np

    from planner.report import exhibits

    block = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * problem.stock.size
    about = (
        "The sheet as formed so far is an elastic shell, loaded where the tool is; nothing of what happens "
        "when it is unclamped or trimmed is in this."
    )
    title = f"Springback of {work.operation.name}"
    section = ("springback", "Springback")
    return exhibits.page(title, section, shown, about, block, f"{problem.name}: {title}")


@dataclasses.dataclass(frozen=True)
class ControlRequest:
    """Gains of force control of the support and of compensation of the former, for a machine of yours.

    What the loops do with them is run in time: a step of the force, and a gap that changes.
    """

    problem: tyro.conf.Positional[Path]
    """the problem file; or a bundled problem"""
    machine: Path
    """stiffness, bandwidth and delay of both arms, the sensor, and the wanted force, YAML"""
    operation: str | None = None
    """which forming operation; else the first"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """an .html page to write: both responses over time"""


def run_control(request: ControlRequest, problem: Problem) -> tuple[Issue, ...]:
    """Work out, run, print and write; warnings come back. Raises `TandemError`."""
    from planner.loops import machine

    require_suffix(request.output, "a page is .html", (".html",))
    file = machine.read_machine(request.machine)
    operation = forming_job(problem, request.operation).operation
    if len(operation.arms) != 2:
        what = f"{operation.name}: mode {operation.mode} has one arm, force control wants a support beside it"
        raise refusal("control.machine", what, field="operation", hint="take a mode of two arms")
    feed = operation.feed_mm_s * MM
    found = machine.tried(file, feed)
    _print_control(file, found, feed)
    if request.output is not None:
        write_output(request.output, _control_page(operation.name, file, found))
    return tuple(machine.issues(file, found, feed))


def _print_control(file: MachineFile, found: Found, feed: float) -> None:
    from planner.loops.machine import INTERFACES

    machine = file.value()
    stiff, late = machine.felt(found.control.share)
    table = Table("figure", "value")
    for name, value in (
        ("stiffness of the contact", f"{machine.contact * MM:.0f} N/mm"),
        ("as the support's loop feels it", f"{stiff * MM:.0f} N/mm, lags {late * 1e3:.1f} ms"),
        (
            "integral gain",
            f"{found.control.gain * 1e6:.2f} um/(N s), unstable from {found.most_gain * 1e6:.2f}",
        ),
        (
            "loop gain of the compensation",
            f"{found.control.share * machine.compliance_gain:.2f}, below 1 allowed",
        ),
        ("deflection that is left", f"{100.0 * found.left:.0f} % of the former's"),
        (
            "step: overshoot, to 90 %",
            f"{100.0 * found.response.overshoot[0]:.1f} %, {found.response.rise[0]:.2f} s",
        ),
        (f"force at {feed / MM:g} mm/s", f"{file.force_n:g} N, off by up to {found.error:.1f} N"),
        (f"feed for {file.band_n:g} N", f"{found.feed / MM:.3g} mm/s, without noise"),
        ("correction by compensation", f"{found.correction / MM:.2f} mm"),
    ):
        table.add_row(name, value)
    out.print(table)
    if file.interface is not None:
        out.print(f"{file.interface.upper()}: {INTERFACES[file.interface]}", markup=False)
    out.print(f"assumed: all of {file.name}'s figures, as its file states them", markup=False)


def _control_page(name: str, file: MachineFile, found: Found) -> str:
    from planner.report import exhibits

    band = [{"name": f"{sign:+g} N", "value": file.force_n + sign} for sign in (-file.band_n, file.band_n)]
    runs = (
        ("step", "Step of the wanted force", found.step),
        ("ramp", f"Gap that changes by {found.gap_speed / MM:.3g} mm/s", found.ramp),
    )
    shown = {
        key: {
            "kind": "curve",
            "title": title,
            "x": run.time,
            "x_label": "time [s]",
            "y_label": "force [N]",
            "series": (
                {"name": "as measured", "y": run.measured[0], "colour": 1},
                {"name": "force", "y": run.force[0], "colour": 0},
                {"name": "commanded", "y": run.wanted[0], "colour": 2},
            ),
            "limits": band,
        }
        for key, title, run in runs
    } | {
        f"{key}_way": {
            "kind": "curve",
            "title": f"{title}: what the arms do",
            "x": run.time,
            "x_label": "time [s]",
            "y_label": "way [mm]",
            "series": (
                {"name": "support, from where it began", "y": (run.support[0] - run.support[0, 0]) / MM},
                {"name": "former gives way, uncompensated", "y": run.deflection[0] / MM},
            ),
        }
        for key, title, run in runs
    }
    about = "A simulation with the figures of the machine's file; nothing was measured here."
    title = f"Force control of {name} with {file.name}"
    return exhibits.page(title, ("control", "Force over time"), shown, about)
