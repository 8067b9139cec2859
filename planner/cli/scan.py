"""``tandem scan-fit`` and ``adjust``: measure a formed part, and form it again.

``tandem scan-fit OUT SCAN``: deviation of a scan from the planned part. ``tandem adjust OUT SCAN -o
PROBLEM``: the problem again, with each target moved by the deviation in the scan.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.table import Table

from planner.cli.console import plain_out as out
from planner.cli.console import require_suffix, write_output
from planner.files import format_csv
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, issue_error

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.problem import Problem
    from planner.shopfloor.align.probing import ProbedPoints
    from planner.shopfloor.scan.adjustment import AdjustedPass
    from planner.shopfloor.scan.cloud import Cloud
    from planner.shopfloor.scan.deviation import Deviation
    from planner.shopfloor.scan.registration import ScanPose

MAX_DRAWN_POINTS = 40_000
"""Maximum number of points in a picture."""


@dataclasses.dataclass(frozen=True)
class ScanOptions:
    """Description of a scan."""

    unit: Literal["mm", "cm", "m", "in"] = "mm"
    """unit of the lengths in the scan"""
    marks: Path | None = None
    """CSV of three or more marks, on the clamp or the sheet: name, sheet.x_mm, sheet.y_mm, sheet.z_mm (in the
    sheet's frame), scan.x_mm, scan.y_mm, scan.z_mm (as in the scan); without it the scan is in the sheet's
    frame except for height and tilt
    """
    face: Literal["top", "bottom"] = "top"
    """the face of the sheet that was scanned"""


@dataclasses.dataclass(frozen=True)
class ScanFit:
    """Measure the deviation of a scan from the planned part, point by point along the normal.

    The scan is aligned with the flat around the part, never with what was formed, which springs back when it
    is released.
    """

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`"""
    scan: tyro.conf.Positional[Path]
    """points or a mesh: .ply, .xyz, .txt, .stl, .obj"""
    options: tyro.conf.OmitArgPrefixes[ScanOptions]
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """file to write: .csv (points with their deviation) or .html (map and histogram)"""


@dataclasses.dataclass(frozen=True)
class Adjust:
    """Write the problem of a formed part again with adjusted targets.

    Each target is moved by the deviation in a scan of the part.
    """

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`, with whose programs the part was formed"""
    scan: tyro.conf.Positional[Path]
    """points or a mesh of that part: .ply, .xyz, .txt, .stl, .obj"""
    options: tyro.conf.OmitArgPrefixes[ScanOptions]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """the problem to write, .yaml, with its files next to it"""
    gain: float = 1.0
    """fraction of the deviation by which targets are moved, 0.1 to 1.2"""
    operation: str | None = None
    """name of the forming operation; else the first"""
    page: Path | None = None
    """an .html page to write: deviation of the part, and prediction for the next one"""


def run_scan_fit(request: ScanFit) -> tuple[Issue, ...]:
    """Register a scan of a formed part, and print and write its deviation from the nominal face.

    Returns:
        Warnings.

    Raises:
        TandemError: The folder or the scan is not usable.
    """
    from planner import pipeline
    from planner.shopfloor.scan import deviation, freedoms

    require_suffix(request.output, "a file is .csv or .html", (".csv", ".html"))
    problem = pipeline.load_result(request.folder)
    cloud, _, pose, deviations = _measure(problem, request.scan, request.options)
    _print_deviation(cloud, pose, deviations)
    if request.output is not None:
        is_page = request.output.suffix.lower() == ".html"
        exhibits_by_name = {
            "off": _deviation_map(
                deviations.point, deviations.deviation, "Deviation of the scan from the nominal face"
            )
        }
        title = f"Scan of {problem.name}"
        text = _scan_page(title, problem, cloud, exhibits_by_name) if is_page else _deviation_csv(deviations)
        write_output(request.output, text)
    return (*freedoms.issues(deviations, pose, cloud.file), *deviation.issues(deviations, cloud.file))


def run_adjust(request: Adjust) -> tuple[Issue, ...]:
    """Register a scan of a formed part, move the targets by its deviation, and write the new problem.

    The next part is formed from this problem. The deviation and the shifts of the tools are printed. A page
    with maps of both is written if it is requested.

    Returns:
        Warnings about the accuracy of the scan.

    Raises:
        TandemError: An option is out of range (``forming.loop_law`` for the gain), the folder or the scan is
            not usable, a shift is too large, or the problem cannot be written.
    """
    from planner import pipeline
    from planner.cli.forming import forming_job
    from planner.processes.forming.plan.operation import Springback
    from planner.processes.forming.plan.process_plan import make_tool_paths
    from planner.processes.forming.plan.springback.compensation_file import job_identity
    from planner.shopfloor.scan import adjustment, deviation, freedoms

    require_suffix(request.output, "a file is .yaml or .yml", (".yaml", ".yml"))
    require_suffix(request.page, "a file is .html", (".html",), "page")
    if not 0.1 <= request.gain <= 1.2:
        message = f"got {request.gain:g}, allowed 0.1 to 1.2"
        raise issue_error("forming.loop_law", message, field="gain", hint="correct it")
    problem = pipeline.load_result(request.folder)
    job = forming_job(problem, request.operation)
    cloud, marks, pose, deviations = _measure(problem, request.scan, request.options)
    _print_deviation(cloud, pose, deviations)
    # without marks the scan must not look as if it were offset in the plane
    freedoms.require_place(deviations, pose, cloud.file)
    compensation = job.read_compensation()
    springback_section = job.operation.springback
    # A problem without springback compensation gets the default limits of shifts. The file is not used.
    limits = Springback(file=request.output) if springback_section is None else springback_section
    scan = adjustment.RegisteredScan(cloud, marks, pose, deviations, top=request.options.face == "top")
    step = adjustment.AdjustmentStep(compensation, request.gain, limits)
    adjusted_passes = adjustment.adjusted(job.planned, make_tool_paths(job.planned), scan, step)
    identity = job_identity(job.planned, job.setup.stock, job.part)
    text = adjustment.text(problem.name, job.operation.name, identity, scan, step, adjusted_passes)
    _print_adjusted(adjusted_passes)
    path = _write_problem(request, problem, job.operation.name, text, limits)
    out.print(f"written to {path}; next: tandem plan {path} -o FOLDER", markup=False)
    if request.page is not None:
        exhibits_by_name = _adjustment_exhibits(adjusted_passes)
        write_output(request.page, _scan_page(f"{problem.name} adjusted", problem, cloud, exhibits_by_name))
    return (*freedoms.issues(deviations, pose, cloud.file), *deviation.issues(deviations, cloud.file))


def _measure(
    problem: Problem, scan: Path, options: ScanOptions
) -> tuple[Cloud, ProbedPoints | None, ScanPose, Deviation]:
    """Read and register a scan.

    Returns:
        Points of the scan, marks or None, pose of the scan, and its deviations from the part.

    Raises:
        TandemError: A file is not usable, or the scan does not fit the part.
    """
    from planner.shopfloor.align import probing
    from planner.shopfloor.scan import cloud, deviation, registration

    marks = None if options.marks is None else probing.read(options.marks, registration.NAMES)
    points = cloud.read(scan, LENGTH_UNITS[options.unit])
    pose, deviations = deviation.of_part(
        points, problem.part, problem.stock.size, marks, options.face == "top"
    )
    return points, marks, pose, deviations


def _write_problem(request: Adjust, problem: Problem, operation: str, text: str, limits: Any) -> Path:
    """Write the problem with the adjustment as the springback section of its forming operation.

    ``text`` is the content of the adjustment file, and ``limits`` a section with the limits of the shifts.
    """
    from planner import pipeline
    from planner.cli.next_level import require_free
    from planner.processes import registry
    from planner.reading import strict_yaml
    from planner.reading.problem import build_problem

    require_free(request.output, problem, "springback")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "adjustment.json"
        file.write_text(text, encoding="utf-8")
        section = {
            "file": str(file),
            "scan": {"file": str(request.scan.resolve())},
            "slope": limits.slope,
            "most_mm": limits.most_mm,
        }
        source = {**problem.source}
        source["operations"] = [
            {**operation_source, "springback": section}
            if operation_source.get("name") == operation
            else operation_source
            for operation_source in source["operations"]
        ]
        # file names in the source are relative to the working directory
        document = strict_yaml.Document(Path(problem.path.name), source, None, b"", file=False)
        return pipeline.save(build_problem(document, registry.readers()), request.output, True)


def _print_deviation(cloud: Cloud, pose: ScanPose, deviations: Deviation) -> None:
    """Print how a scan was registered, and statistics of its deviation from the nominal face."""
    import numpy as np

    from planner.shopfloor.scan.registration import describe_pose

    out.print(f"{cloud.file}: {describe_pose(pose)}", markup=False)
    deviations_mm = deviations.deviation[np.isfinite(deviations.deviation)] / MM
    table = Table("mm along the normal", "min", "5 %", "median", "95 %", "max", "rms")
    low, p5, middle, p95, high = np.percentile(deviations_mm, (0, 5, 50, 95, 100))
    statistics = (low, p5, middle, p95, high, float(np.sqrt(np.mean(deviations_mm**2))))
    table.add_row("scan minus nominal face", *(f"{value:.3f}" for value in statistics))
    out.print(table)
    seen_percent = 100.0 * len(deviations_mm) / len(deviations.deviation)
    out.print(
        f"{len(deviations.deviation)} places, {seen_percent:.1f} % of them seen, from {deviations.used} "
        f"points; noise of a point {deviations.noise / MM:.3f} mm",
        markup=False,
    )


def _print_adjusted(adjusted_passes: Sequence[AdjustedPass]) -> None:
    """Print the depth deficit of each pass, its prediction for the next part, and the shifts of the tools."""
    import numpy as np

    table = Table("pass", "too shallow mm, along z", "predicted mm", "tools deeper mm")
    for adjusted_pass in adjusted_passes:
        is_seen = np.isfinite(adjusted_pass.shallowness)
        measured_and_predicted = (
            [adjusted_pass.shallowness[is_seen] / MM, adjusted_pass.foretold[is_seen] / MM]
            if is_seen.any()
            else []
        )
        spans = [f"{values.min():.2f} to {values.max():.2f}" for values in measured_and_predicted] or [
            "not on the scan",
            "unchanged",
        ]
        shift = adjusted_pass.tool_path.shift / MM
        table.add_row(adjusted_pass.tool_path.name, *spans, f"{shift.min():.2f} to {shift.max():.2f}")
    out.print(table)


def _deviation_map(points: FloatArray, deviation: FloatArray, title: str) -> dict[str, Any]:
    """Return a heat map of deviations (N,) [m] at points (N, 3) [m]. Points that were not scanned are NaN.

    At most about `MAX_DRAWN_POINTS` are drawn. The scale ends at the 98 % quantile.
    """
    import numpy as np

    seen_indices = np.flatnonzero(np.isfinite(deviation))
    # -(-a // b) is a / b rounded up: every n-th point, so that at most MAX_DRAWN_POINTS remain
    seen_indices = seen_indices[:: max(1, -(-len(seen_indices) // MAX_DRAWN_POINTS))]
    values = deviation[seen_indices] / MM
    limit = max(float(np.percentile(np.abs(values), 98)), 0.01)
    return {
        "kind": "heatmap",
        "title": title,
        "points": points[seen_indices],
        "value": values,
        "unit": "mm",
        "limit": limit,
    }


def _adjustment_exhibits(adjusted_passes: Sequence[AdjustedPass]) -> dict[str, Any]:
    """Return maps of the measured and the predicted depth deficit on one scale, and of the tool shifts."""
    import numpy as np

    from planner.processes.forming.plan.springback.compensation import compensation_exhibit

    points, deficit, predicted = (
        np.concatenate(
            [getattr(adjusted_pass, name) for adjusted_pass in adjusted_passes if adjusted_pass.seen]
        )
        for name in ("point", "shallowness", "foretold")
    )
    measured_map = _deviation_map(points, deficit, "Depth deficit of the part, along z")
    predicted_map = _deviation_map(points, predicted, "Predicted depth deficit of the next part, along z")
    color_limit = max(float(np.abs(exhibit["value"]).max()) for exhibit in (measured_map, predicted_map))
    return {
        "before": {**measured_map, "limit": color_limit},
        "next": {**predicted_map, "limit": color_limit},
        "deeper": compensation_exhibit([adjusted_pass.tool_path for adjusted_pass in adjusted_passes]),
    }


def _deviation_csv(deviations: Deviation) -> str:
    """Return points, normals and deviations as CSV. Points that were not scanned have an empty deviation."""
    import numpy as np

    rows = [["x_mm", "y_mm", "z_mm", "nx", "ny", "nz", "off_mm"]]
    for point, normal, deviation in zip(
        deviations.point / MM, deviations.normal, deviations.deviation / MM, strict=True
    ):
        deviation_text = f"{deviation:.4f}" if np.isfinite(deviation) else ""
        rows.append(
            [
                *(f"{coordinate:.4f}" for coordinate in point),
                *(f"{coordinate:.5f}" for coordinate in normal),
                deviation_text,
            ]
        )
    return format_csv(rows)


def _scan_page(title: str, problem: Problem, cloud: Cloud, exhibits_by_name: dict[str, Any]) -> str:
    """Return the page with maps of a scan, with the name and the digest of its file."""
    import numpy as np

    from planner.report import exhibits

    block = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * problem.stock.size
    about = (
        f"{cloud.file}, SHA-256 {cloud.digest[:16]}, {len(cloud.points)} points, aligned with the flat "
        "around the part. Positive is above the nominal face, or too shallow."
    )
    return exhibits.exhibits_page(title, ("scan", "Scan"), exhibits_by_name, about, block)
