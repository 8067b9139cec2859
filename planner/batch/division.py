"""Division of a building element into files, and the report on its panels.

`tandem element` and the workers of the service use it.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from planner.batch.job import ELEMENT_FILE, PLANNED_FILE, JobResult
from planner.batch.rows import BatchItem, BatchRow
from planner.element import (
    elastic,
    element_file,
    element_page,
    hexagon_files,
    hexagons,
    labels,
    labels_pdf,
    output,
    rhino_panels,
    run_report,
    strips,
    wall_files,
    walls,
)
from planner.element.elastic import PanelCheck
from planner.element.elastic_panel import JOINT_PERCENTILE, ElasticPanel, find_joints
from planner.element.element_file import ElasticElement, HexagonElement, StripsElement, WallElement
from planner.element.jobs import panel_files
from planner.element.run_report import ElementRun
from planner.files import is_file, map_file_names, write_atomic, write_folder
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.report import rhino_file

if TYPE_CHECKING:
    from planner.pipeline import Progress
    from planner.problem import Problem

REPORT_FILES: Final = ("element.html", "report.csv", "joints.csv")
"""Files of a report on an element."""
PANELS_TO_PROBLEM: Final = "../problem/"
"""Relative path from ``panels/`` to the files that the job was given."""
AnyElement = TypeVar("AnyElement", bound=element_file.Element)
AnyTemplate = TypeVar("AnyTemplate", bound=element_file.JobTemplate)
DividedFiles = tuple[dict[str, str], tuple[Issue, ...], str]


@dataclasses.dataclass(frozen=True)
class DividedElement:
    """A divided element.

    Attributes:
        files: Files of its folder by name.
        issues: Issues to report.
        summary: Summary text.
    """

    files: Mapping[str, str | bytes]
    issues: tuple[Issue, ...]
    summary: str


def divide_element(
    element: element_file.Element, on_progress: Progress, folder: Path | None = None
) -> DividedElement:
    """Return all files of an element.

    Args:
        element: The element.
        on_progress: Receives the progress.
        folder: Folder of a job that contains the element, or None. Panels then refer to the files of their
            templates by `PANELS_TO_PROBLEM`, because the result of that job holds them there.

    Raises:
        TandemError: The element cannot be divided.
    """
    on_progress("division", 0.0)
    if isinstance(element, element_file.HexagonElement):
        files, issues, summary = _divide_hexagons(element, folder)
    elif isinstance(element, element_file.WallElement):
        files, issues, summary = _divide_wall(element, folder)
    elif isinstance(element, element_file.StripsElement):
        files, issues, summary = _divide_strips(element, folder)
    elif isinstance(element, element_file.ElasticElement):
        files, issues, summary = _divide_elastic(element, folder)
    else:
        raise TypeError(f"unknown kind of element {type(element).__name__}")
    on_progress("page", 0.0)
    data = json.loads(files["element.json"])
    files["element.html"] = element_page.element_page(run_report.unplanned_run(data), files.get("blocks.svg"))
    files["labels.svg"] = labels.label_sheets(data)
    files["labels.pdf"] = labels_pdf.labels_pdf(files["labels.svg"])
    cad = (
        {"element.3dm": rhino_panels.panels_3dm(data, files["element.obj"])}
        if rhino_file.is_available()
        else {}
    )
    return DividedElement({**files, **cad}, issues, summary)


def _with_relative_templates(element: AnyElement, folder: Path | None) -> AnyElement:
    """Return the element with the file names in its templates relative to ``panels/``.

    Names are unchanged if ``folder``, the folder of a job, is None.
    """
    if folder is None:
        return element

    def relative_name(path: Path) -> str:
        return PANELS_TO_PROBLEM + path.relative_to(folder).as_posix()

    def with_names(template: AnyTemplate) -> AnyTemplate:
        return dataclasses.replace(template, data=map_file_names(template.data, relative_name))

    cutting_template = None if element.saw is None else with_names(element.saw)
    return dataclasses.replace(
        element, templates=tuple(map(with_names, element.templates)), saw=cutting_template
    )


def _divide_elastic(element: ElasticElement, folder: Path | None) -> DividedFiles:
    """Return all files of elastic panels, their issues, and the summary."""
    cells = elastic.prepare_division(element.surface, element.cells, element.rules)
    panel_check = _panel_check(element) if element.are_panels_checked else None
    panels = elastic.divide_elastic(cells, panel_check, held=element.options.check != "none")
    files, issues = output.elastic_folder(_with_relative_templates(element, folder), panels)
    joint_steps = np.concatenate([joint.steps.ravel() for joint in find_joints(panels)] or [np.zeros(1)]) / MM
    max_deviation = max(panel.misfit for panel in panels) / MM
    summary = (
        f"{len(panels)} panels, at most {max_deviation:.2f} mm from the surface; "
        f"steps at joints {np.percentile(joint_steps, JOINT_PERCENTILE):.2f} mm for "
        f"{JOINT_PERCENTILE:g} %, at most {joint_steps.max():.2f} mm"
    )
    return files, issues, summary


def _divide_hexagons(element: HexagonElement, folder: Path | None) -> DividedFiles:
    """Return all files of planar panels, their issues, and the summary."""
    panels = hexagons.divide_hexagons(element)
    files, issues = hexagon_files.hexagon_folder(_with_relative_templates(element, folder), panels)
    max_deviation = max(panel.deviation for panel in panels) / MM
    max_tilt = max(panel.tilt for panel in panels) / DEG
    summary = (
        f"{len(panels)} panels, at most {max_deviation:.1f} mm from the surface; edges between the faces "
        f"are tilted by at most {max_tilt:.1f} degrees"
    )
    return files, issues, summary


def _divide_wall(element: WallElement, folder: Path | None) -> DividedFiles:
    """Return all files of a ruled wall, their issues, and the summary."""
    panels = walls.divide_wall(element)
    files, issues = wall_files.wall_folder(_with_relative_templates(element, folder), panels)
    heights = np.array([panel.box[1] for panel in panels]) / MM
    max_deviation = max(panel.deviation for panel in panels) / MM
    summary = (
        f"{len(panels)} panels, {heights.min():.0f} to {heights.max():.0f} mm high; backs deviate at most "
        f"{max_deviation:.2f} mm from one thickness behind the front"
    )
    return files, issues, summary


def _divide_strips(element: StripsElement, folder: Path | None) -> DividedFiles:
    """Return all files of a surface in ruled strips, their issues, and the summary."""
    division = strips.divide_strips(element)
    files, issues = wall_files.strips_folder(_with_relative_templates(element, folder), division)
    alternatives = "; ".join(
        f"across {direction}: {panel_count} in {strip_count} strips"
        for direction, (strip_count, panel_count) in division.tried.items()
    )
    summary = (
        f"{len(division.panels)} panels in {len(division.cuts) - 1} ruled strips across {division.across} "
        f"({alternatives}), at most {division.deviation.max() / MM:.2f} mm from the surface; kinks of at "
        f"most {division.kinks.max(initial=0.0) / DEG:.1f} degrees between neighbours"
    )
    return files, issues, summary


def _panel_check(element: ElasticElement) -> PanelCheck:
    """Return a function that checks the problem of a panel as it will be written.

    The function returns the first error, or None. It also returns None for a panel without a template, which
    is reported later with its id.
    """
    from planner import pipeline
    from planner.processes import registry  # loads Drake

    checks_all = element.options.check == "all"

    def check_panel(panel: ElasticPanel) -> Issue | None:
        try:
            files = panel_files(element, (panel,), ("panel",))
        except TandemError:
            return None
        with tempfile.TemporaryDirectory() as folder:
            for name, text in files.items():
                path = Path(folder) / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)
            panel_issues: list[Issue] = []
            try:
                problem = pipeline.load(Path(folder) / "panels" / "panel.yaml")
                if checks_all:
                    panel_issues += pipeline.check(problem, advise=False)
                else:
                    panel_issues += [
                        issue for job in registry.jobs(problem) for issue in job.targets().issues
                    ]
            except TandemError as error:
                panel_issues += error.issues
        return next((issue for issue in panel_issues if issue.severity is Severity.ERROR), None)

    return check_panel


def report_files(element_run: ElementRun, out: Path) -> dict[str, str]:
    """Return the files of `REPORT_FILES` for an element.

    Args:
        element_run: The element with the results of its panels.
        out: Folder of the element.
    """
    blocks = out / "blocks.svg"
    drawing = blocks.read_text("utf-8") if is_file(blocks) else None
    contents = (
        element_page.element_page(element_run, drawing),
        run_report.panels_csv(element_run),
        run_report.joints_csv(element_run),
    )
    return dict(zip(REPORT_FILES, contents, strict=True))


def solve_division(source: Path, result: Path, on_progress: Progress) -> tuple[Issue, ...]:
    """Divide the element among the files of a job.

    Args:
        source: Folder with the files of the job.
        result: Result folder.
        on_progress: Receives the progress.

    Raises:
        TandemError: As :func:`divide_element`.
    """
    on_progress("surface", 0.0)
    divided = divide_element(element_file.read_element(source / ELEMENT_FILE), on_progress, source)
    write_folder(result, divided.files, output.OWNED_ENTRIES)
    return divided.issues


def solve_report(source: Path, result: Path, on_progress: Progress) -> tuple[Issue, ...]:
    """Write the report on an element from the files of a job.

    Args:
        source: Folder with the files of the job.
        result: Result folder.
        on_progress: Receives the progress.

    Raises:
        TandemError: A file cannot be read.
    """
    from planner.batch.compare import csv_table

    on_progress("joints", 0.0)
    results = [
        JobResult.from_dict(result_data)
        for result_data in json.loads((source / PLANNED_FILE).read_text("utf-8"))
    ]
    rows = [BatchRow(BatchItem(done.name, done.name, _refuse_reading), done) for done in results]
    write_atomic(source / "run" / "summary.csv", csv_table(rows))
    element_run = run_report.read_run(source / "element", source / "run")
    write_folder(result, report_files(element_run, source / "element"), REPORT_FILES)
    return element_run.issues()


def _refuse_reading() -> Problem:
    raise ValueError("a finished panel is not read again")
