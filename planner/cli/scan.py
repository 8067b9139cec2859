"""``tandem scan-fit`` and ``adjust``: a formed part measured, and formed again.

``tandem scan-fit OUT SCAN``: how far a scan is off the part that a plan was made for.
``tandem adjust OUT SCAN -o PROBLEM``: the problem again, each target moved by what the scan has shown.
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
from planner.files import csv_text
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, refusal

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.problem import Problem
    from planner.shopfloor.align.probing import ProbedPoints
    from planner.shopfloor.scan.adjustment import Adjusted
    from planner.shopfloor.scan.cloud import Cloud
    from planner.shopfloor.scan.deviation import Deviation
    from planner.shopfloor.scan.registration import Pose

MOST_DRAWN = 40_000
"""Places of a picture at most."""


@dataclasses.dataclass(frozen=True)
class ScanOptions:
    """What a scan is of."""

    unit: Literal["mm", "cm", "m", "in"] = "mm"
    """of the scan's lengths"""
    marks: Path | None = None
    """CSV of three marks or more, on the clamp or the sheet: name, sheet.x_mm, sheet.y_mm, sheet.z_mm (in the
    sheet's frame), scan.x_mm, scan.y_mm, scan.z_mm (as the scanner has them); without it the scan lies in the
    sheet's frame already, but for height and tilt"""
    face: Literal["top", "bottom"] = "top"
    """the face of the sheet that the scanner sees"""


@dataclasses.dataclass(frozen=True)
class ScanFit:
    """How far a scan is off the part that a plan was made for: along the normal, place by place.

    The scan is laid on the flat around the part, never on what was formed, which comes back when the tools
    let go.
    """

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`"""
    scan: tyro.conf.Positional[Path]
    """points or a mesh: .ply, .xyz, .txt, .stl, .obj"""
    options: tyro.conf.OmitArgPrefixes[ScanOptions]
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """what to write: .csv (places with how far they are off) or .html (the map, how often)"""


@dataclasses.dataclass(frozen=True)
class Adjust:
    """The problem of a formed part again, each target moved by what a scan of the part has shown."""

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`, by whose programs the part was formed"""
    scan: tyro.conf.Positional[Path]
    """points or a mesh of that part: .ply, .xyz, .txt, .stl, .obj"""
    options: tyro.conf.OmitArgPrefixes[ScanOptions]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """the problem to write, .yaml, with its files beside it"""
    gain: float = 1.0
    """share of what the part is off by that targets are moved by, 0.1 to 1.2"""
    operation: str | None = None
    """which forming operation; else the first"""
    page: Path | None = None
    """an .html page to write: what the part was off by, what is foretold of the next one"""


def run_scan_fit(request: ScanFit) -> tuple[Issue, ...]:
    """Register, measure, print and write; warnings come back. Raises `TandemError`."""
    from planner import pipeline
    from planner.shopfloor.scan import deviation, freedoms

    require_suffix(request.output, "a file is .csv or .html", (".csv", ".html"))
    problem = pipeline.load_result(request.folder)
    cloud, _, pose, found = _measured(problem, request.scan, request.options)
    _print(cloud, pose, found)
    if request.output is not None:
        page = request.output.suffix.lower() == ".html"
        shown = {"off": _map(found.point, found.off, "How far the scan is off the wanted face")}
        title = f"Scan of {problem.name}"
        text = _page(title, problem, cloud, shown) if page else _csv(found)
        write_output(request.output, text)
    return (*freedoms.issues(found, pose, cloud.file), *deviation.issues(found, cloud.file))


def run_adjust(request: Adjust) -> tuple[Issue, ...]:
    """Register, measure, adjust, print and write; warnings come back. Raises `TandemError`."""
    from planner import pipeline
    from planner.cli.forming import forming_job
    from planner.processes.forming.plan.operation import Springback
    from planner.processes.forming.plan.process_plan import lay_all
    from planner.processes.forming.plan.springback.compensation_file import belongs_to
    from planner.shopfloor.scan import adjustment, deviation, freedoms

    require_suffix(request.output, "a file is .yaml or .yml", (".yaml", ".yml"))
    require_suffix(request.page, "a file is .html", (".html",), "page")
    if not 0.1 <= request.gain <= 1.2:
        what = f"got {request.gain:g}, allowed 0.1 to 1.2"
        raise refusal("forming.loop_law", what, field="gain", hint="correct it")
    problem = pipeline.load_result(request.folder)
    job = forming_job(problem, request.operation)
    top = request.options.face == "top"
    cloud, marks, pose, found = _measured(problem, request.scan, request.options)
    _print(cloud, pose, found)
    freedoms.require_place(found, pose, cloud.file)
    given = job.compensated()
    stated = job.operation.springback
    limits = Springback(file=request.output) if stated is None else stated
    made = adjustment.adjusted(job.planned, lay_all(job.planned), given, found, top, request.gain, limits)
    text = adjustment.text(
        problem.name,
        job.operation.name,
        belongs_to(job.planned, job.setup.stock, job.part),
        cloud,
        LENGTH_UNITS[request.options.unit],
        top,
        pose,
        marks,
        request.gain,
        given,
        made,
        limits.slope,
    )
    _print_adjusted(made)
    path = _write(request, problem, job.operation.name, text, limits)
    out.print(f"written to {path}; next: tandem plan {path} -o FOLDER", markup=False)
    if request.page is not None:
        shown = _rounds(made)
        write_output(request.page, _page(f"{problem.name} adjusted", problem, cloud, shown))
    return (*freedoms.issues(found, pose, cloud.file), *deviation.issues(found, cloud.file))


def _measured(
    problem: Problem, scan: Path, options: ScanOptions
) -> tuple[Cloud, ProbedPoints | None, Pose, Deviation]:
    from planner.shopfloor.align import probing
    from planner.shopfloor.scan import cloud, deviation, registration

    marks = None if options.marks is None else probing.read(options.marks, registration.NAMES)
    points = cloud.read(scan, LENGTH_UNITS[options.unit])
    pose, found = deviation.of_part(points, problem.part, problem.stock.size, marks, options.face == "top")
    return points, marks, pose, found


def _write(request: Adjust, problem: Problem, operation: str, text: str, limits: Any) -> Path:
    from planner import pipeline
    from planner.cli.next_level import require_free
    from planner.processes import registry
    from planner.reading import strict_yaml
    from planner.reading.problem import build

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
            {**one, "springback": section} if one.get("name") == operation else one
            for one in source["operations"]
        ]
        # file names in what was read start where the process does
        document = strict_yaml.Document(Path(problem.path.name), source, None, b"", file=False)
        return pipeline.save(build(document, registry.readers()), request.output, True)


def _print(cloud: Cloud, pose: Pose, found: Deviation) -> None:
    import numpy as np

    from planner.shopfloor.scan.registration import told

    out.print(f"{cloud.file}: {told(pose)}", markup=False)
    off = found.off[np.isfinite(found.off)] / MM
    table = Table("mm along the normal", "least", "5 %", "median", "95 %", "most", "rms")
    low, p5, middle, p95, high = np.percentile(off, (0, 5, 50, 95, 100))
    figures = (low, p5, middle, p95, high, float(np.sqrt(np.mean(off**2))))
    table.add_row("scan less wanted face", *(f"{value:.3f}" for value in figures))
    out.print(table)
    known = 100.0 * len(off) / len(found.off)
    out.print(
        f"{len(found.off)} places, {known:.1f} % of them known, from {found.used} points; noise of a point "
        f"{found.noise / MM:.3f} mm",
        markup=False,
    )


def _print_adjusted(made: Sequence[Adjusted]) -> None:
    import numpy as np

    table = Table("pass", "too shallow mm, along z", "foretold mm", "tools deeper mm")
    for one in made:
        seen = np.isfinite(one.before)
        both = [one.before[seen] / MM, one.foretold[seen] / MM] if seen.any() else []
        spans = [f"{row.min():.2f} to {row.max():.2f}" for row in both] or ["not on the scan", "as it was"]
        shift = one.way.shift / MM
        table.add_row(one.way.name, *spans, f"{shift.min():.2f} to {shift.max():.2f}")
    out.print(table)


def _map(points: FloatArray, off: FloatArray, title: str) -> dict[str, Any]:
    import numpy as np

    seen = np.flatnonzero(np.isfinite(off))
    seen = seen[:: max(1, -(-len(seen) // MOST_DRAWN))]
    value = off[seen] / MM
    limit = max(float(np.percentile(np.abs(value), 98)), 0.01)
    return {
        "kind": "heatmap",
        "title": title,
        "points": points[seen],
        "value": value,
        "unit": "mm",
        "limit": limit,
    }


def _rounds(made: Sequence[Adjusted]) -> dict[str, Any]:
    """What the part was off and what is foretold of the next one, on one scale, and what tools do for it."""
    import numpy as np

    from planner.processes.forming.plan.springback.compensation import exhibit

    points, before, foretold = (
        np.concatenate([getattr(one, name) for one in made if one.seen])
        for name in ("point", "before", "foretold")
    )
    first = _map(points, before, "How much too shallow the part was, along z")
    next_one = _map(points, foretold, "How much too shallow the next one is foretold to be, along z")
    limit = max(float(np.abs(one["value"]).max()) for one in (first, next_one))
    return {
        "before": {**first, "limit": limit},
        "next": {**next_one, "limit": limit},
        "deeper": exhibit([one.way for one in made]),
    }


def _csv(found: Deviation) -> str:
    import numpy as np

    rows = [["x_mm", "y_mm", "z_mm", "nx", "ny", "nz", "off_mm"]]
    for point, normal, off in zip(found.point / MM, found.normal, found.off / MM, strict=True):
        shown = f"{off:.4f}" if np.isfinite(off) else ""
        rows.append([*(f"{v:.4f}" for v in point), *(f"{v:.5f}" for v in normal), shown])
    return csv_text(rows)


def _page(title: str, problem: Problem, cloud: Cloud, shown: dict[str, Any]) -> str:
    import numpy as np

    from planner.report import exhibits

    block = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * problem.stock.size
    about = (
        f"{cloud.file}, SHA-256 {cloud.digest[:16]}, {len(cloud.points)} points, laid on the flat around the "
        "part. Positive is above the wanted face, or too shallow."
    )
    return exhibits.page(title, ("scan", "Scan"), shown, about, block)
