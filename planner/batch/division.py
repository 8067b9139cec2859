"""A building element from its file to the files of its folder, and to those that tell what became of its
panels; as `tandem element` and the workers of the service make them."""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from planner.batch.job import ELEMENT, PLANNED, Done
from planner.batch.rows import Item, Row
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
from planner.element.elastic import Judge
from planner.element.elastic_panel import JOINT_SHARE, ElasticPanel, joints
from planner.element.element_file import ElasticElement, HexagonElement, StripsElement, WallElement
from planner.element.jobs import panel_files
from planner.element.run_report import ElementRun
from planner.files import each_file, is_file, write_folder, write_whole
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.report import rhino_file

if TYPE_CHECKING:
    from planner.pipeline import Progress
    from planner.problem import Problem

REPORT: Final = ("element.html", "report.csv", "joints.csv")
"""What a report on an element holds."""
FROM_PANELS: Final = "../problem/"
"""The way from ``panels/`` to the files that the job was given."""
AnyElement = TypeVar("AnyElement", bound=element_file.Element)
AnyTemplate = TypeVar("AnyTemplate", bound=element_file.Template)
Made = tuple[dict[str, str], tuple[Issue, ...], str]


@dataclasses.dataclass(frozen=True)
class Divided:
    """``files`` of an element's folder by their names, what is to be said, and what it came out as."""

    files: Mapping[str, str | bytes]
    issues: tuple[Issue, ...]
    said: str


def divide(element: element_file.Element, on_progress: Progress, folder: Path | None = None) -> Divided:
    """All files of an element. Where it lies in the ``folder`` of a job, panels name the files of their
    templates from ``panels/`` on, by way of ``../problem/``, as the result of that job holds them.

    Raises ``TandemError`` as the divisions do.
    """
    on_progress("division", 0.0)
    if isinstance(element, element_file.HexagonElement):
        files, told, said = _hexagons(element, folder)
    elif isinstance(element, element_file.WallElement):
        files, told, said = _wall(element, folder)
    elif isinstance(element, element_file.StripsElement):
        files, told, said = _strips(element, folder)
    elif isinstance(element, element_file.ElasticElement):
        files, told, said = _elastic(element, folder)
    else:
        raise TypeError(f"an element of no kind, {type(element).__name__}")
    on_progress("page", 0.0)
    data = json.loads(files["element.json"])
    files["element.html"] = element_page.element_page(run_report.unplanned(data), files.get("blocks.svg"))
    files["labels.svg"] = labels.label_sheets(data)
    files["labels.pdf"] = labels_pdf.label_document(files["labels.svg"])
    cad = (
        {"element.3dm": rhino_panels.panels_3dm(data, files["element.obj"])} if rhino_file.installed() else {}
    )
    return Divided({**files, **cad}, told, said)


def _written(element: AnyElement, folder: Path | None) -> AnyElement:
    """The element with file names of its templates from ``panels/`` on, where they are in the ``folder`` of a
    job."""
    if folder is None:
        return element

    def carried(path: Path) -> str:
        return FROM_PANELS + path.relative_to(folder).as_posix()

    def named(template: AnyTemplate) -> AnyTemplate:
        return dataclasses.replace(template, data=each_file(template.data, carried))

    saw = None if element.saw is None else named(element.saw)
    return dataclasses.replace(element, templates=tuple(map(named, element.templates)), saw=saw)


def _elastic(element: ElasticElement, folder: Path | None) -> Made:
    """All files of elastic panels, what is to be said, and what they came out as."""
    made = elastic.search(element.surface, element.cells, element.rules)
    judge = _judge(element) if element.judged else None
    panels = elastic.divide_elastic(made, judge, held=element.wanted.check != "none")
    files, told = output.folder(_written(element, folder), panels)
    steps = np.concatenate([joint.steps.ravel() for joint in joints(panels)] or [np.zeros(1)]) / MM
    off = max(panel.misfit for panel in panels) / MM
    said = (
        f"{len(panels)} panels, at most {off:.2f} mm off the surface; "
        f"steps at joints {np.percentile(steps, JOINT_SHARE):.2f} mm at "
        f"{JOINT_SHARE:g} %, {steps.max():.2f} mm at most"
    )
    return files, told, said


def _hexagons(element: HexagonElement, folder: Path | None) -> Made:
    """All files of planar panels, what is to be said, and what they came out as."""
    panels = hexagons.divide_hexagons(element)
    files, told = hexagon_files.folder(_written(element, folder), panels)
    off = max(panel.off for panel in panels) / MM
    lean = max(panel.lean for panel in panels) / DEG
    said = (
        f"{len(panels)} panels, at most {off:.1f} mm off the surface; edges from face to face lean "
        f"{lean:.1f} degrees at most"
    )
    return files, told, said


def _wall(element: WallElement, folder: Path | None) -> Made:
    """All files of a ruled wall, what is to be said, and what it came out as."""
    panels = walls.divide_wall(element)
    files, told = wall_files.folder(_written(element, folder), panels)
    heights = np.array([panel.box[1] for panel in panels]) / MM
    off = max(panel.off for panel in panels) / MM
    said = (
        f"{len(panels)} panels, {heights.min():.0f} to {heights.max():.0f} mm high; backs at most {off:.2f} "
        "mm off one thickness behind the front"
    )
    return files, told, said


def _strips(element: StripsElement, folder: Path | None) -> Made:
    """All files of a surface in ruled strips, what is to be said, and what it came out as."""
    found = strips.divide_strips(element)
    files, told = wall_files.strips_folder(_written(element, folder), found)
    tried = "; ".join(f"across {one}: {p} in {s} strips" for one, (s, p) in found.tried.items())
    said = (
        f"{len(found.panels)} panels in {len(found.cuts) - 1} ruled strips across {found.across} ({tried}), "
        f"at most {found.off.max() / MM:.2f} mm off the surface; kinks of at most "
        f"{found.kinks.max(initial=0.0) / DEG:.1f} degrees between neighbours"
    )
    return files, told, said


def _judge(element: ElasticElement) -> Judge:
    """The check of a panel's problem as it will be written; what no template is for is told with its id at
    the end."""
    from planner import pipeline
    from planner.processes import registry  # loads Drake

    whole = element.wanted.check == "all"

    def refusal(panel: ElasticPanel) -> Issue | None:
        try:
            files = panel_files(element, (panel,), ("panel",))
        except TandemError:
            return None
        with tempfile.TemporaryDirectory() as folder:
            for name, text in files.items():
                path = Path(folder) / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)
            found: list[Issue] = []
            try:
                problem = pipeline.load(Path(folder) / "panels" / "panel.yaml")
                if whole:
                    found += pipeline.check(problem, advise=False)
                else:
                    found += [issue for job in registry.jobs(problem) for issue in job.targets().issues]
            except TandemError as error:
                found += error.issues
        return next((issue for issue in found if issue.severity is Severity.ERROR), None)

    return refusal


def report_files(found: ElementRun, out: Path) -> dict[str, str]:
    """What `REPORT` names, of an element whose folder is ``out``."""
    blocks = out / "blocks.svg"
    drawn = blocks.read_text("utf-8") if is_file(blocks) else None
    made = element_page.element_page(found, drawn), run_report.panel_rows(found), run_report.joint_rows(found)
    return dict(zip(REPORT, made, strict=True))


def solve_division(source: Path, result: Path, on_progress: Progress) -> tuple[Issue, ...]:
    """Divide the element among the files of a job, into ``result``; what is to be said. Raises
    ``TandemError``."""
    on_progress("surface", 0.0)
    made = divide(element_file.read(source / ELEMENT), on_progress, source)
    write_folder(result, made.files, output.OWNED)
    return made.issues


def solve_report(source: Path, result: Path, on_progress: Progress) -> tuple[Issue, ...]:
    """Write the report on an element from the files of a job into ``result``; what is to be said. Raises
    ``TandemError``."""
    from planner.batch.compare import csv_table

    on_progress("joints", 0.0)
    ended = [Done.from_dict(one) for one in json.loads((source / PLANNED).read_text("utf-8"))]
    rows = [Row(Item(done.name, done.name, _never), done) for done in ended]
    write_whole(source / "run" / "summary.csv", csv_table(rows))
    found = run_report.read_run(source / "element", source / "run")
    write_folder(result, report_files(found, source / "element"), REPORT)
    return found.issues()


def _never() -> Problem:
    raise ValueError("a panel that has ended is not read again")
