"""``tandem batch``, ``fit`` and ``compare``: many problems, and results side by side.

``tandem batch PROBLEMS... -o OUT`` plans each problem as ``tandem plan`` would. ``tandem fit`` plans one
problem in several cells. ``tandem compare A B`` shows two plans or two batches side by side. This module also
lists the fields in which two problems differ, as their files state them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Column, Table

from planner.files import FILE_KEYS, is_file
from planner.issues import Issue, TandemError, accepted_codes, issue_error

if TYPE_CHECKING:
    from planner.batch.compare import JobPair, MetricPair, PlanComparison
    from planner.batch.job import JobEvent
    from planner.batch.rows import BatchItem, BatchRow
    from planner.batch.run import Planners
    from planner.problem import Problem

out = Console(highlight=False)
err = Console(stderr=True)
STATE_STYLE = {"verified": "green", "infeasible": "yellow", "bad_input": "yellow"}
"""Colours of states in the terminal; red for all others."""
NEIGHBOUR: Final = "neighbour"
"""Value of ``--like`` with which panels are planned like adjacent ones."""
TABLE_FIGURES = ("targets", "cycle_s", "clearance_mm")
"""Values of a job that fit in the printed table. ``summary.csv`` and ``summary.html`` have all of them."""


@dataclasses.dataclass(frozen=True)
class Batch:
    """Plan many problems, each into its own folder, with a summary; exit code 0 only if all are verified.

    A folder stands for every problem file in it. A batch file varies fields of one problem.
    """

    problems: tyro.conf.Positional[tuple[Path, ...]]
    """problem files, folders of them, bundled problems, or batch files"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for a result folder of each problem, summary.csv and summary.html"""
    workers: int | None = None
    """worker processes; default: one per processor, at most one per problem"""
    resume: bool = False
    """keep what an earlier run finished for the same problems, and plan the rest"""
    timeout: float | None = None
    """time limit for planning one problem, in seconds"""
    memory: float | None = None
    """memory limit of one worker, in MB"""
    cluster: str | None = None
    """plan on a Dask cluster: tcp://HOST:PORT of its scheduler, or local"""
    like: str | None = None
    """neighbour: plan each panel of an element like an adjacent one; or the folder of an earlier batch: plan
    each problem like its result there
    """
    reports: Literal["all", "failed"] = "all"
    """failed: only results that are not verified get report and replay; tandem report writes those of the
    others
    """


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    get_affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(get_affinity(0)) if get_affinity is not None else os.cpu_count() or 1


def run_batch(request: Batch) -> int:
    """Plan, print and write the summary; returns the exit code.

    Raises:
        TandemError: The batch cannot start.
    """
    from planner.batch import run as batch
    from planner.batch.run import collect_items

    _require_options(request)
    rows, seconds = _plan_items(request, lambda: collect_items(request.problems, request.output))
    _print_rows(rows, request.output, seconds)
    return batch.exit_code(rows)


def _plan_items(request: Batch, collect_items: Callable[[], list[BatchItem]]) -> tuple[list[BatchRow], float]:
    """Plan all items with progress and write the summary. Returns the rows and the duration [s]."""
    from planner.batch import rows as batch_rows
    from planner.batch import run as batch
    from planner.batch.job import JobFinished

    start = time.perf_counter()
    rows_by_name: dict[str, BatchRow] = {}
    with batch.claimed_folder(request.output):
        items = collect_items()
        count = min(request.workers or usable_cores(), len(items))
        items, reference_folder = _with_references(request, items)
        limits = request.timeout, request.memory
        settings = batch.BatchSettings(*limits, request.resume, reference_folder, request.reports)
        items_by_name = {item.name: item for item in items}
        with _make_planners(request, count) as planners, _show_progress(items) as display:

            def on_event(event: JobEvent) -> None:
                if isinstance(event, JobFinished):
                    rows_by_name[event.name] = batch_rows.BatchRow(items_by_name[event.name], event.done)
                display.show(event)

            try:
                rows = batch.run_batch(items, request.output, planners, settings, on_event)
            except BaseException:
                finished_rows = [rows_by_name[item.name] for item in items if item.name in rows_by_name]
                _write_summary(request, finished_rows, time.perf_counter() - start)
                raise
        _write_summary(request, rows, time.perf_counter() - start)
    return rows, time.perf_counter() - start


def _with_references(request: Batch, items: list[BatchItem]) -> tuple[list[BatchItem], Path | None]:
    """Resolve the option ``--like``.

    Returns:
        Items, each with its reference item if the option is `NEIGHBOUR`, and the folder of the earlier batch
        whose results are reference plans, or None.

    Raises:
        TandemError: ``batch.field``.
    """
    if request.like is None:
        return items, None
    if request.like == NEIGHBOUR:
        from planner.batch.reference_neighbours import assign_reference_neighbours

        return assign_reference_neighbours(items), None
    from planner.plans import DATA_FILE

    folder = Path(request.like)
    new_names = [item.name for item in items if not is_file(folder / item.name / DATA_FILE)]
    if len(new_names) == len(items):
        message = f"--like {folder}: it holds no plan of any of these problems"
        hint = f"name the folder of an earlier batch of them, or use {NEIGHBOUR}"
        raise issue_error("batch.field", message, field="--like", hint=hint)
    if new_names:
        err.print(
            f"{len(new_names)} of {len(items)} have no plan in {folder}: {', '.join(new_names[:5])}",
            markup=False,
        )
    return items, folder


def _require_options(request: Batch) -> None:
    """Require that problems are named and that limits are positive."""
    numbers = {"--workers": request.workers, "--timeout": request.timeout, "--memory": request.memory}
    issues = [
        Issue("batch.field", f"{name}: must be above 0, got {value:g}", field=name)
        for name, value in numbers.items()
        if value is not None and not value > 0
    ]
    if not request.problems:
        issues.append(Issue("batch.field", "no problems are stated; name files, folders or bundled problems"))
    if issues:
        raise TandemError(issues)


@contextmanager
def _make_planners(request: Batch, count: int) -> Iterator[Planners]:
    """Open the cluster, or ``count`` worker processes, that plan the jobs."""
    if request.cluster is not None:
        from planner.batch.cluster import ClusterPlanners

        with ClusterPlanners(request.cluster, count) as cluster:
            yield cluster
    else:
        from planner.batch.workers import BatchWorkers

        with BatchWorkers(count) as workers:
            yield workers


class _ProgressDisplay:
    """Progress of the whole batch and of each running job."""

    def __init__(self, bar: Progress, count: int) -> None:
        self._bar = bar
        self._all = bar.add_task("all", total=count)
        self._jobs: dict[str, TaskID] = {}

    def show(self, event: JobEvent) -> None:
        """Show an event."""
        from planner.batch import compare, job

        if isinstance(event, job.JobFinished):
            if event.name in self._jobs:
                self._bar.remove_task(self._jobs.pop(event.name))
            self._bar.advance(self._all)
            if event.done.state != "verified":
                issue = compare.most_severe_issue(event.done)
                issue_text = f": {issue}" if issue is not None else ""
                text = f"{event.name}: {event.done.state}{issue_text}"
                self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)
        elif isinstance(event, job.JobProgress):
            if event.name not in self._jobs:
                self._jobs[event.name] = self._bar.add_task(event.name, total=1.0)
            text = f"{event.name}: {event.stage}"
            self._bar.update(self._jobs[event.name], description=text, completed=event.fraction)


@contextmanager
def _show_progress(items: Sequence[BatchItem]) -> Iterator[_ProgressDisplay]:
    """Show the progress of a batch on standard error."""
    columns = (
        TextColumn("{task.description:<32}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        yield _ProgressDisplay(bar, len(items))


def _write_summary(request: Batch, rows: Sequence[BatchRow], seconds: float) -> None:
    from planner.batch import compare
    from planner.files import write_atomic

    title = f"Batch {request.output.resolve().name}"
    write_atomic(request.output / "summary.csv", compare.csv_table(rows))
    write_atomic(request.output / "summary.html", compare.summary_page(title, rows, request.output, seconds))


def _print_rows(rows: Sequence[BatchRow], folder: Path, seconds: float) -> None:
    """Print the results of a batch as a table, its accepted issues, and a summary with the duration [s]."""
    from planner.batch import compare

    table = Table(
        "name", "status", *(compare.FIGURE_HEADINGS[name] for name in TABLE_FIGURES), "planned in s", "issues"
    )
    for row in rows:
        issue = compare.most_severe_issue(row.done)
        remark = " ".join(filter(None, (compare.issue_counts(row), issue.code if issue is not None else "")))
        table.add_row(
            row.item.name,
            compare.STATE_LABELS[row.done.state],
            *(compare.figure_text(name, row.done.metrics.get(name)) for name in TABLE_FIGURES),
            f"{row.done.seconds:.1f}",
            remark,
            style=STATE_STYLE.get(row.done.state, "red"),
        )
    out.print(table)
    for row in rows:
        accepted = accepted_codes(row.done.issues)
        if accepted:
            message = f"{row.item.name}: accepted by the problem, not by Tandem: {', '.join(accepted)}"
            out.print(message, markup=False, soft_wrap=True)
    verified_count = sum(row.done.state == "verified" for row in rows)
    kept_count = sum(row.is_kept for row in rows)
    kept_text = f", {kept_count} of them finished before" if kept_count else ""
    summary_page = folder / "summary.html"
    out.print(
        f"{verified_count} of {len(rows)} verified{kept_text}; {seconds:.1f} s; see {summary_page}",
        markup=False,
    )


@dataclasses.dataclass(frozen=True)
class Fit:
    """Find robots for a part: plan a problem in its own cell and in each cell of a folder.

    The cells are ranked. Proven cells come first, then cells with ample margins, then the fastest. For the
    others the reasons are shown.
    """

    problem: tyro.conf.Positional[Path]
    """a problem file, or a bundled problem"""
    cells: Path
    """folder of cell files (YAML with arms); their arms get the names of the problem's arms, in order"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for a result folder of each cell, summary.csv and summary.html"""
    workers: int | None = None
    """worker processes; default: one per processor"""
    resume: bool = False
    """keep what an earlier run finished, and plan the rest"""
    timeout: float | None = None
    """time limit for planning in one cell, in seconds"""


def run_fit(request: Fit) -> int:
    """Plan in all cells, print the ranking and write it; returns the exit code, 0 if a cell is proven.

    Raises:
        TandemError: The run cannot start.
    """
    from planner import pipeline
    from planner.batch import cell_ranking
    from planner.batch import run as batch

    problem = pipeline.load(request.problem)
    batch_request = Batch(
        (request.problem,), request.output, request.workers, request.resume, request.timeout, reports="failed"
    )
    _require_options(batch_request)
    rows, seconds = _plan_items(batch_request, lambda: cell_ranking.cell_items(problem, request.cells))
    rows = cell_ranking.rank_cells(rows, problem.settings)
    _write_summary(batch_request, rows, seconds)
    _print_ranking(rows, problem, seconds, request.output)
    return 0 if any(row.done.state == "verified" for row in rows) else batch.exit_code(rows)


def _print_ranking(rows: Sequence[BatchRow], problem: Problem, seconds: float, folder: Path) -> None:
    """Print ranked cells as a table, the reasons why others are not proven, and a summary."""
    from planner.batch import compare

    names = ("cycle_s", "clearance_mm", "joint_limits_deg", "singularity_deg")
    cell = Column("cell", overflow="fold")
    table = Table("", cell, "status", *(compare.FIGURE_HEADINGS[name] for name in names))
    for number, row in enumerate(rows, 1):
        table.add_row(
            str(number) if row.done.state == "verified" else "",
            row.item.name,
            compare.STATE_LABELS[row.done.state],
            *(compare.figure_text(name, row.done.metrics.get(name)) for name in names),
            style=STATE_STYLE.get(row.done.state, "red"),
        )
    out.print(table)
    for row in rows:
        issue = compare.most_severe_issue(row.done)
        if row.done.state != "verified" and issue is not None:
            out.print(f"{row.item.name}: {issue}", markup=False, soft_wrap=True)
    proven = sum(row.done.state == "verified" for row in rows)
    page = folder / "summary.html"
    message = f"{problem.name} is proven in {proven} of {len(rows)} cells; {seconds:.1f} s; see {page}"
    out.print(message, markup=False)


COMPARED_FIGURES = ("cycle_s", "clearance_mm", "path_cost", "planning_s")
"""Values of each job that are compared between two batches."""


@dataclasses.dataclass(frozen=True)
class Compare:
    """Show two result folders side by side: cycle time, margins, path cost, changed segments, issues.

    Two folders that `tandem batch` wrote are compared job by job.
    """

    first: tyro.conf.Positional[Path]
    """a result folder, or the folder of a batch"""
    second: tyro.conf.Positional[Path]
    """the folder to compare with, of the same kind"""


def run_compare(request: Compare) -> None:
    """Print the comparison.

    Raises:
        TandemError: A folder cannot be read.
    """
    from planner.batch import compare

    if compare.is_batch(request.first) or compare.is_batch(request.second):
        _print_batches(compare.compare_batches(request.first, request.second))
    else:
        _print_plans(compare.compare_plans(request.first, request.second))


def _print_plans(plans: PlanComparison) -> None:
    """Print verdicts and values of two plans, changed segments, and numbers of issues that differ."""
    from planner.batch.compare import FIGURE_HEADINGS

    table = Table("figure", "first", "second", "change")
    verdicts = [_verdict(result.ok) for result in (plans.first, plans.second)]
    table.add_row("proof", *verdicts, "" if verdicts[0] == verdicts[1] else "differs")
    for pair in plans.figures:
        table.add_row(FIGURE_HEADINGS.get(pair.name, pair.name), *_figure_cells(pair))
    out.print(table)
    if plans.first.plan.digest == plans.second.plan.digest:
        out.print("both are plans of the same problem")
    if plans.segments:
        table = Table("changed segment", "targets", "seconds", "joints deg", "poses mm")
        for segment in plans.segments:
            targets = f"{_format_value(segment.targets[0])} to {_format_value(segment.targets[1])}"
            seconds = f"{_format_value(segment.seconds[0])} to {_format_value(segment.seconds[1])}"
            table.add_row(
                f"{segment.operation}/{segment.segment}",
                targets,
                seconds,
                _format_value(segment.joints_deg),
                _format_value(segment.poses_mm),
            )
        out.print(table)
    else:
        out.print("no segment changed")
    _print_issue_counts(plans.issues)


def _print_batches(jobs: list[JobPair]) -> None:
    """Print status and values of each job in two batches, and the sums over the jobs that both have."""
    from planner.batch.compare import FIGURE_HEADINGS, STATE_LABELS

    table = Table(
        "job", "status", *(FIGURE_HEADINGS.get(name, "planned in s") for name in COMPARED_FIGURES), "issues"
    )
    for job in jobs:
        states = [
            STATE_LABELS[result.state] if result is not None else "missing"
            for result in (job.first, job.second)
        ]
        status = states[0] if states[0] == states[1] else f"{states[0]} to {states[1]}"
        codes = "; ".join(f"{code} {first} to {second}" for code, (first, second) in job.issues.items())
        table.add_row(job.name, status, *(_both_values(job.figure(name)) for name in COMPARED_FIGURES), codes)
    out.print(table)
    jobs_in_both = [job for job in jobs if job.first is not None and job.second is not None]
    for name in COMPARED_FIGURES:
        pairs = [job.figure(name) for job in jobs_in_both]
        known_values = [
            (pair.first, pair.second) for pair in pairs if pair.first is not None and pair.second is not None
        ]
        if known_values:
            sums = sum(first for first, _ in known_values), sum(second for _, second in known_values)
            title = FIGURE_HEADINGS.get(name, "planned in s")
            if not name.endswith("_mm"):  # a sum of distances has no meaning
                out.print(
                    f"{title}, sum over {len(known_values)} jobs: {_format_value(sums[0])} to "
                    f"{_format_value(sums[1])}"
                )
    changed = sum(
        job.first is None or job.second is None or job.first.state != job.second.state for job in jobs
    )
    out.print(f"{len(jobs)} jobs, the status of {changed} differs")


def _print_issue_counts(issue_counts: Mapping[str, tuple[int, int]]) -> None:
    """Print the issue codes whose numbers differ between two plans."""
    if not issue_counts:
        out.print("the same issues")
        return
    table = Table("issues", "first", "second")
    for code, (first, second) in issue_counts.items():
        table.add_row(code, str(first), str(second))
    out.print(table)


def _verdict(ok: bool | None) -> str:
    return "no proof" if ok is None else "proven" if ok else "NOT proven"


def _figure_cells(pair: MetricPair) -> tuple[str, str, str]:
    """Return both values and their change, also in percent, as text."""
    change = pair.change
    change_text = "" if change is None else "same" if change == 0.0 else f"{change:+.4g}"
    if change and pair.first:
        change_text += f" ({100 * change / abs(pair.first):+.1f} %)"
    return _format_value(pair.first), _format_value(pair.second), change_text


def _both_values(pair: MetricPair) -> str:
    first, second = _format_value(pair.first), _format_value(pair.second)
    return first if first == second else f"{first} to {second}"


def _format_value(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


NOT_GIVEN: Final = "not given"
"""Text for a field that one side does not have."""
MAX_SHOWN_LENGTH: Final = 60
"""Maximum length of displayed values. Longer ones are truncated."""
_ABSENT: Final = object()
"""Stands for a field that a side does not have, because None is a value."""


@dataclasses.dataclass(frozen=True)
class Difference:
    """A field in which two problems differ, such as ``settings.clearance_mm``, with its values as text."""

    field: str
    first: str
    second: str


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[Difference, ...]:
    """List the fields in which two problem sources differ, in the order of the first source.

    Files that the sources name are compared by content.
    """
    return tuple(_compare_values("", first, second))


def _compare_values(field: str, a: Any, b: Any) -> Iterator[Difference]:
    """Yield the differences of two values and of all values in them. ``field`` is their path."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            name = f"{field}.{key}" if field else str(key)
            if key in FILE_KEYS:
                yield from _compare_files(name, a.get(key, _ABSENT), b.get(key, _ABSENT))
            else:
                yield from _compare_values(name, a.get(key, _ABSENT), b.get(key, _ABSENT))
    elif isinstance(a, list) and isinstance(b, list):
        for index in range(max(len(a), len(b))):
            first_item, second_item = (side[index] if index < len(side) else _ABSENT for side in (a, b))
            yield from _compare_values(f"{field}[{index}]", first_item, second_item)
    elif type(a) is not type(b) or a != b:
        yield Difference(field, _format_field(a), _format_field(b))


def _compare_files(field: str, a: Any, b: Any) -> Iterator[Difference]:
    """Yield a difference if the files with the names ``a`` and ``b`` have different content."""
    if not isinstance(a, str) or not isinstance(b, str):
        yield from _compare_values(field, a, b)
    elif (first_content := _content_digest(a)) != (second_content := _content_digest(b)):
        yield Difference(field, f"{Path(a).name}, {first_content}", f"{Path(b).name}, {second_content}")


def _content_digest(name: str) -> str:
    path = Path(name)
    return f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()}" if is_file(path) else "missing"


def _format_field(value: Any) -> str:
    if value is _ABSENT:
        return NOT_GIVEN
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= MAX_SHOWN_LENGTH else f"{text[: MAX_SHOWN_LENGTH - 3]}..."
