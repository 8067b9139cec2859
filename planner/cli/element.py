"""``tandem element FILE -o OUT``: one building element into panels, each an ordinary problem of its own."""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console

from planner.files import claim_folder, is_file, write_folder, write_whole
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError

if TYPE_CHECKING:
    from planner.element.elastic import Judge
    from planner.element.element_file import ElasticElement, HexagonElement, StripsElement, WallElement

out = Console(highlight=False, soft_wrap=True)


@dataclasses.dataclass(frozen=True)
class ElementRequest:
    """Divide a building element into panels and write a problem for each, with a table and a drawing.

    What is written is planned by `tandem batch OUT/panels -o RUN`, where cut_blocks is stated with
    OUT/blocks.
    """

    file: tyro.conf.Positional[Path]
    """the element file"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for panels/, panels.csv, panels.svg, element.html, element.obj, labels.svg, element.json, and
    where raw blocks are stated blocks.csv, blocks.svg, stock.csv and, with cut_blocks, blocks/"""
    resume: bool = False
    """keep the folder as it is where it holds this very element, its surface moved by 1e-5 mm at most; else
    say how many problems stayed as they were"""


def run_element(request: ElementRequest) -> tuple[Issue, ...]:
    """Divide, write and print; what is to be said. Raises ``TandemError``."""
    from planner.element import element_file, element_page, kept, labels, output, run_report

    start = time.perf_counter()
    claim_folder(request.output, output.OWNED, keep=request.file)
    element = element_file.read(request.file)
    raw = element.file.raw_blocks
    if raw is not None and raw.stock is not None:
        claim_folder(request.output, output.OWNED, keep=request.file.parent / raw.stock)
    before = kept.problems_in(request.output) if request.resume else {}
    if request.resume and kept.holds(request.output, element, request.file):
        data = json.loads((request.output / "element.json").read_text("utf-8"))
        out.print(f"{element.file.name}: as before, {len(data['panels'])} panels", markup=False)
        return tuple(Issue.from_dict(one) for one in data["issues"])
    if isinstance(element, element_file.HexagonElement):
        files, told, said = _hexagons(element)
    elif isinstance(element, element_file.WallElement):
        files, told, said = _wall(element)
    elif isinstance(element, element_file.StripsElement):
        files, told, said = _strips(element)
    else:
        files, told, said = _elastic(element)
    data = json.loads(files["element.json"])
    files["element.html"] = element_page.element_page(run_report.unplanned(data), files.get("blocks.svg"))
    files["labels.svg"] = labels.label_sheets(data)
    made_from = kept.made_from(element, request.file, files)
    write_folder(request.output, {**files, kept.FILE: made_from}, output.OWNED)
    out.print(f"{element.file.name}: {said}", markup=False)
    if before:
        same, count = kept.stayed(before, files)
        out.print(f"{same} of {count} problems are as before: tandem batch --resume plans the others")
    seconds = time.perf_counter() - start
    out.print(f"divided in {seconds:.1f} s; see {request.output / 'element.html'}", markup=False)
    return told


def _elastic(element: ElasticElement) -> tuple[dict[str, str], tuple[Issue, ...], str]:
    """All files of elastic panels, what is to be said, and what they came out as."""
    from planner.element import elastic, output

    made = elastic.search(element.surface, element.cells, element.rules)
    judge = _judge(element) if element.judged else None
    panels = elastic.divide_elastic(made, judge, held=element.wanted.check != "none")
    files, told = output.folder(element, panels)
    steps = np.concatenate([joint.steps.ravel() for joint in elastic.joints(panels)] or [np.zeros(1)]) / MM
    off = max(panel.misfit for panel in panels) / MM
    said = (
        f"{len(panels)} panels, at most {off:.2f} mm off the surface; "
        f"steps at joints {np.percentile(steps, output.JOINT_SHARE):.2f} mm at "
        f"{output.JOINT_SHARE:g} %, {steps.max():.2f} mm at most"
    )
    return files, told, said


def _hexagons(element: HexagonElement) -> tuple[dict[str, str], tuple[Issue, ...], str]:
    """All files of planar panels, what is to be said, and what they came out as."""
    from planner.element import hexagon_files, hexagons

    panels = hexagons.divide_hexagons(element)
    files, told = hexagon_files.folder(element, panels)
    off = max(panel.off for panel in panels) / MM
    lean = max(panel.lean for panel in panels) / DEG
    said = (
        f"{len(panels)} panels, at most {off:.1f} mm off the surface; edges from face to face lean "
        f"{lean:.1f} degrees at most"
    )
    return files, told, said


def _wall(element: WallElement) -> tuple[dict[str, str], tuple[Issue, ...], str]:
    """All files of a ruled wall, what is to be said, and what it came out as."""
    from planner.element import wall_files, walls

    panels = walls.divide_wall(element)
    files, told = wall_files.folder(element, panels)
    heights = np.array([panel.box[1] for panel in panels]) / MM
    off = max(panel.off for panel in panels) / MM
    said = (
        f"{len(panels)} panels, {heights.min():.0f} to {heights.max():.0f} mm high; backs at most {off:.2f} "
        "mm off one thickness behind the front"
    )
    return files, told, said


def _strips(element: StripsElement) -> tuple[dict[str, str], tuple[Issue, ...], str]:
    """All files of a surface in ruled strips, what is to be said, and what it came out as."""
    from planner.element import strips, wall_files

    found = strips.divide_strips(element)
    files, told = wall_files.strips_folder(element, found)
    tried = "; ".join(f"across {one}: {p} in {s} strips" for one, (s, p) in found.tried.items())
    said = (
        f"{len(found.panels)} panels in {len(found.cuts) - 1} ruled strips across {found.across} ({tried}), "
        f"at most {found.off.max() / MM:.2f} mm off the surface; kinks of at most "
        f"{found.kinks.max(initial=0.0) / DEG:.1f} degrees between neighbours"
    )
    return files, told, said


@dataclasses.dataclass(frozen=True)
class ElementReport:
    """Show what became of an element's panels in a batch: verdicts, robot hours, joints of what is cut.

    Writes element.html, report.csv and joints.csv into OUT.
    """

    element: tyro.conf.Positional[Path]
    """folder that `tandem element FILE -o OUT` wrote"""
    run: tyro.conf.Positional[Path]
    """folder that `tandem batch OUT/panels -o RUN` wrote"""


def run_element_report(request: ElementReport) -> tuple[Issue, ...]:
    """Read, measure, write and print; what is to be said. Raises ``TandemError``."""
    from planner.element import element_page, run_page, run_report

    found = run_report.read_run(request.element, request.run)
    write_whole(request.element / "report.csv", run_report.panel_rows(found))
    write_whole(request.element / "joints.csv", run_report.joint_rows(found))
    blocks = request.element / "blocks.svg"
    drawn = blocks.read_text("utf-8") if is_file(blocks) else None
    write_whole(request.element / "element.html", element_page.element_page(found, drawn))
    proven = sum(panel.proven for panel in found.panels)
    hours = ", ".join(f"{arm} {s / run_page.HOUR:.2f} h" for arm, s in found.all_seconds().items())
    blocks_cut = f", {sum(one.proven for one in found.saw)} of {len(found.saw)} jobs of raw blocks"
    out.print(
        f"{found.data['name']}: {proven} of {len(found.panels)} panels{blocks_cut if found.saw else ''} "
        f"proven; robots: {hours or 'none'}; "
        f"{len(found.measured)} of {len(found.joints)} joints measured, "
        f"{sum(joint.over for joint in found.joints)} over the limit; see {request.element / 'element.html'}",
        markup=False,
    )
    return found.issues()


@dataclasses.dataclass(frozen=True)
class ElementMark:
    """Keep which panels of an element are cut, glued or broken; says what to cut next, and from what a broken
    one is cut again.

    Written to progress.csv in OUT, which stays where the element is divided again.
    """

    element: tyro.conf.Positional[Path]
    """folder that `tandem element FILE -o OUT` wrote"""
    panel: tyro.conf.Positional[str]
    """the id of a panel"""
    state: tyro.conf.Positional[Literal["cut", "glued", "broken"]]
    """what it is now"""


def run_element_mark(request: ElementMark) -> tuple[Issue, ...]:
    """Read, mark, write and print; what is to be said. Raises ``TandemError``."""
    from planner.element import progress

    found = progress.marked(progress.read(request.element), request.panel, request.state)
    lines = list(progress.told(found, request.element))
    write_whole(request.element / progress.FILE, progress.text(found))
    for line in lines:
        out.print(line, markup=False)
    return progress.issues(found)


def _judge(element: ElasticElement) -> Judge:
    """The check of a panel's problem as it will be written; what no template is for is told with its id at
    the end."""
    from planner import pipeline, processes
    from planner.element.elastic import ElasticPanel
    from planner.element.jobs import panel_files

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
                    found += [issue for job in processes.jobs(problem) for issue in job.targets().issues]
            except TandemError as error:
                found += error.issues
        return next((issue for issue in found if issue.severity is Severity.ERROR), None)

    return refusal
