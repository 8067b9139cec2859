"""``tandem element FILE -o OUT``: one building element into panels, each an ordinary problem of its own."""

import dataclasses
import json
import time
from pathlib import Path
from typing import Annotated, Literal

import tyro

from planner.cli.console import plain_out as out
from planner.files import claim_folder, write_folder, write_whole
from planner.issues import Issue


@dataclasses.dataclass(frozen=True)
class ElementRequest:
    """Divide a building element into panels and write a problem for each, with a table and a drawing.

    What is written is planned by `tandem batch OUT/panels -o RUN`, where cut_blocks is stated with
    OUT/blocks.
    """

    file: tyro.conf.Positional[Path]
    """the element file"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for panels/, panels.csv, panels.svg, element.html, element.obj, element.3dm (with the extra
    cad), labels.svg, labels.pdf, element.json, and where raw blocks are stated blocks.csv, blocks.svg,
    stock.csv and, with cut_blocks, blocks/"""
    resume: bool = False
    """keep the folder as it is where it holds this very element, its surface moved by 1e-5 mm at most; else
    say how many problems stayed as they were"""


def run_element(request: ElementRequest) -> tuple[Issue, ...]:
    """Divide, write and print; what is to be said. Raises ``TandemError``."""
    from planner.batch.division import divide
    from planner.element import element_file, kept, output

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
    made = divide(element, lambda stage, fraction: None)
    made_from = kept.made_from(element, request.file, made.files)
    write_folder(request.output, {**made.files, kept.FILE: made_from}, output.OWNED)
    out.print(f"{element.file.name}: {made.said}", markup=False)
    if before:
        same, count = kept.stayed(before, made.files)
        out.print(f"{same} of {count} problems are as before: tandem batch --resume plans the others")
    seconds = time.perf_counter() - start
    out.print(f"divided in {seconds:.1f} s; see {request.output / 'element.html'}", markup=False)
    return made.issues


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
    from planner.batch.division import report_files
    from planner.element import run_page, run_report

    found = run_report.read_run(request.element, request.run)
    for name, text in report_files(found, request.element).items():
        write_whole(request.element / name, text)
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
    one is cut again; open takes a mark away.

    Written to progress.csv in OUT, which stays where the element is divided again.
    """

    element: tyro.conf.Positional[Path]
    """folder that `tandem element FILE -o OUT` wrote"""
    panel: tyro.conf.Positional[str]
    """the id of a panel, or of a job of a raw block, for the panels that it cuts"""
    state: tyro.conf.Positional[Literal["cut", "glued", "broken", "open"]]
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
