"""``tandem element FILE -o OUT``: divide a building element into panels, each an ordinary problem."""

import dataclasses
import json
import time
from pathlib import Path
from typing import Annotated, Literal

import tyro

from planner.cli.console import plain_out as out
from planner.files import prepare_folder, write_atomic, write_folder
from planner.issues import Issue


@dataclasses.dataclass(frozen=True)
class ElementRequest:
    """Divide a building element into panels and write a problem for each, with a table and a drawing.

    `tandem batch OUT/panels -o RUN` plans what is written; with cut_blocks also OUT/blocks.
    """

    file: tyro.conf.Positional[Path]
    """the element file"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for panels/, panels.csv, panels.svg, element.html, element.obj, element.3dm (with the extra
    cad), labels.svg, labels.pdf, element.json; with raw blocks also blocks.csv, blocks.svg, stock.csv and,
    with cut_blocks, blocks/
    """
    resume: bool = False
    """keep the folder as it is if it holds this very element, with its surface moved by at most 1e-5 mm; else
    report how many problems are unchanged
    """


def run_element(request: ElementRequest) -> tuple[Issue, ...]:
    """Divide an element, write its files and print a summary.

    Returns:
        Issues of the division.

    Raises:
        TandemError: The element cannot be divided or written.
    """
    from planner.batch.division import divide_element
    from planner.element import element_file, output, unchanged

    start = time.perf_counter()
    prepare_folder(request.output, output.OWNED_ENTRIES, keep=request.file)
    element = element_file.read_element(request.file)
    raw_blocks = element.file.raw_blocks
    if raw_blocks is not None and raw_blocks.stock is not None:
        prepare_folder(request.output, output.OWNED_ENTRIES, keep=request.file.parent / raw_blocks.stock)
    previous_problems = unchanged.problems_in(request.output) if request.resume else {}
    if request.resume and unchanged.is_unchanged(request.output, element, request.file):
        data = json.loads((request.output / "element.json").read_text("utf-8"))
        out.print(f"{element.file.name}: unchanged, {len(data['panels'])} panels", markup=False)
        return tuple(Issue.from_dict(issue) for issue in data["issues"])
    division = divide_element(element, lambda stage, fraction: None)
    made_from = unchanged.made_from(element, request.file, division.files)
    write_folder(
        request.output, {**division.files, unchanged.MADE_FROM_FILE: made_from}, output.OWNED_ENTRIES
    )
    out.print(f"{element.file.name}: {division.summary}", markup=False)
    if previous_problems:
        unchanged_count, count = unchanged.count_unchanged(previous_problems, division.files)
        out.print(
            f"{unchanged_count} of {count} problems are unchanged: tandem batch --resume plans the others"
        )
    seconds = time.perf_counter() - start
    out.print(f"divided in {seconds:.1f} s; see {request.output / 'element.html'}", markup=False)
    return division.issues


@dataclasses.dataclass(frozen=True)
class ElementReport:
    """Show the results of an element's panels in a batch: verdicts, robot hours, joints of cut panels.

    Writes element.html, report.csv and joints.csv into OUT.
    """

    element: tyro.conf.Positional[Path]
    """folder that `tandem element FILE -o OUT` wrote"""
    run: tyro.conf.Positional[Path]
    """folder that `tandem batch OUT/panels -o RUN` wrote"""


def run_element_report(request: ElementReport) -> tuple[Issue, ...]:
    """Read the results of an element's panels, write the report and print a summary.

    Returns:
        Issues of the report.

    Raises:
        TandemError: A folder cannot be read.
    """
    from planner.batch.division import report_files
    from planner.element import run_page, run_report

    run_result = run_report.read_run(request.element, request.run)
    for name, text in report_files(run_result, request.element).items():
        write_atomic(request.element / name, text)
    proven = sum(panel.proven for panel in run_result.panels)
    hours = ", ".join(
        f"{arm} {seconds / run_page.HOUR_S:.2f} h" for arm, seconds in run_result.all_seconds().items()
    )
    blocks_cut = f", {sum(job.proven for job in run_result.saw)} of {len(run_result.saw)} jobs of raw blocks"
    out.print(
        f"{run_result.data['name']}: {proven} of {len(run_result.panels)} "
        f"panels{blocks_cut if run_result.saw else ''} proven; robots: {hours or 'none'}; "
        f"{len(run_result.measured)} of {len(run_result.joints)} joints measured, "
        f"{sum(joint.is_over_limit for joint in run_result.joints)} over the limit; see "
        f"{request.element / 'element.html'}",
        markup=False,
    )
    return run_result.issues()


@dataclasses.dataclass(frozen=True)
class ElementMark:
    """Record which panels of an element are cut, glued or broken.

    Prints what to cut next, and from which block a broken panel is cut again. open removes a mark. The marks
    are written to progress.csv in OUT, which is kept when the element is divided again.
    """

    element: tyro.conf.Positional[Path]
    """folder that `tandem element FILE -o OUT` wrote"""
    panel: tyro.conf.Positional[str]
    """the id of a panel, or of a job of a raw block, for the panels that it cuts"""
    state: tyro.conf.Positional[Literal["cut", "glued", "broken", "open"]]
    """its new state"""


def run_element_mark(request: ElementMark) -> tuple[Issue, ...]:
    """Record the state of a panel, and print the progress with the next steps.

    Returns:
        Issues of the progress.

    Raises:
        TandemError: The folder or the panel is unknown.
    """
    from planner.element import progress

    marks = progress.mark(progress.read_progress(request.element), request.panel, request.state)
    lines = list(progress.progress_lines(marks, request.element))
    write_atomic(request.element / progress.PROGRESS_FILE, progress.progress_csv(marks))
    for line in lines:
        out.print(line, markup=False)
    return progress.progress_issues(marks)
