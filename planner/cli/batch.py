"""``tandem batch PROBLEMS... -o OUT``: many problems, each planned as ``tandem plan`` would."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from planner.issues import Issue, TandemError, accepted

if TYPE_CHECKING:
    from planner.batch.job import Event
    from planner.batch.run import Item, Planners, Row

out = Console(highlight=False)
err = Console(stderr=True)
STATE_STYLE = {"verified": "green", "infeasible": "yellow", "bad_input": "yellow"}
"""Colours of states in the terminal; red for all others."""
TABLE_FIGURES = ("targets", "cycle_s", "clearance_mm")
"""Figures that the table has room for; ``summary.csv`` and ``summary.html`` have them all."""


@dataclasses.dataclass(frozen=True)
class Batch:
    """Plan many problems, each into a folder of its own, with a summary; exit 0 only if all are verified.

    A folder stands for every problem file beneath it; a batch file varies fields of one problem.
    """

    problems: tyro.conf.Positional[tuple[Path, ...]]
    """problem files, folders of them, bundled problems, or batch files"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for a result folder of each problem, summary.csv and summary.html"""
    workers: int | None = None
    """worker processes; by default one for each processor, at most one for each problem"""
    resume: bool = False
    """keep what an earlier run finished for the same problems, and plan the rest"""
    timeout: float | None = None
    """longest planning of one problem, in seconds"""
    memory: float | None = None
    """largest memory of one worker, in MB"""
    cluster: str | None = None
    """plan on a Dask cluster: tcp://HOST:PORT of its scheduler, or local"""


def run(request: Batch) -> int:
    """Plan, print and write the summary; the exit code. Raises `TandemError` for what cannot begin."""
    from planner.batch import run as batch
    from planner.batch.job import Finished
    from planner.batch.run import collect

    _check(request)
    start = time.perf_counter()
    rows: dict[str, Row] = {}
    with batch.claimed_folder(request.output):
        items = collect(request.problems, request.output)
        count = min(request.workers or len(os.sched_getaffinity(0)), len(items))
        settings = batch.Settings(request.timeout, request.memory, request.resume)
        known = {item.name: item for item in items}
        with _planners(request, count) as planners, _progress(items) as shown:

            def on_event(event: Event) -> None:
                if isinstance(event, Finished):
                    rows[event.name] = batch.Row(known[event.name], event.done)
                shown.show(event)

            try:
                done = batch.run(items, request.output, planners, settings, on_event)
            except BaseException:
                so_far = [rows[item.name] for item in items if item.name in rows]
                _write(request, so_far, time.perf_counter() - start)
                raise
        _write(request, done, time.perf_counter() - start)
    _print(done, request.output, time.perf_counter() - start)
    return batch.exit_code(done)


def _check(request: Batch) -> None:
    numbers = {"--workers": request.workers, "--timeout": request.timeout, "--memory": request.memory}
    issues = [
        Issue("batch.field", f"{name}: got {value:g}; give a number above 0", field=name)
        for name, value in numbers.items()
        if value is not None and not value > 0
    ]
    if not request.problems:
        issues.append(Issue("batch.field", "no problems are given; name files, folders or bundled problems"))
    if issues:
        raise TandemError(issues)


@contextmanager
def _planners(request: Batch, count: int) -> Iterator[Planners]:
    if request.cluster is not None:
        from planner.batch.cluster import Cluster

        with Cluster(request.cluster, count) as cluster:
            yield cluster
    else:
        from planner.batch.workers import Workers

        with Workers(count) as workers:
            yield workers


class _Shown:
    """Progress of the whole batch and of each job that is under way."""

    def __init__(self, bar: Progress, count: int) -> None:
        self._bar = bar
        self._all = bar.add_task("all", total=count)
        self._jobs: dict[str, TaskID] = {}

    def show(self, event: Event) -> None:
        """Show an event."""
        from planner.batch import compare, job

        if isinstance(event, job.Finished):
            if event.name in self._jobs:
                self._bar.remove_task(self._jobs.pop(event.name))
            self._bar.advance(self._all)
            if event.done.state != "verified":
                issue = compare.gravest_issue(event.done)
                said = f": {issue}" if issue is not None else ""
                text = f"{event.name}: {event.done.state}{said}"
                self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)
        elif isinstance(event, job.Progress):
            if event.name not in self._jobs:
                self._jobs[event.name] = self._bar.add_task(event.name, total=1.0)
            text = f"{event.name}: {event.stage}"
            self._bar.update(self._jobs[event.name], description=text, completed=event.fraction)


@contextmanager
def _progress(items: Sequence[Item]) -> Iterator[_Shown]:
    columns = (
        TextColumn("{task.description:<32}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        yield _Shown(bar, len(items))


def _write(request: Batch, rows: Sequence[Row], seconds: float) -> None:
    from planner.batch import compare
    from planner.files import write_whole

    title = f"Batch {request.output.resolve().name}"
    write_whole(request.output / "summary.csv", compare.csv_table(rows))
    write_whole(request.output / "summary.html", compare.summary_page(title, rows, request.output, seconds))


def _print(rows: Sequence[Row], folder: Path, seconds: float) -> None:
    from planner.batch import compare

    table = Table(
        "name", "status", *(compare.FIGURES[name] for name in TABLE_FIGURES), "planned in s", "issues"
    )
    for row in rows:
        issue = compare.gravest_issue(row.done)
        remark = " ".join(filter(None, (compare.issue_counts(row), issue.code if issue is not None else "")))
        table.add_row(
            row.item.name,
            compare.STATES[row.done.state],
            *(compare.figure_text(name, row.done.metrics.get(name)) for name in TABLE_FIGURES),
            f"{row.done.seconds:.1f}",
            remark,
            style=STATE_STYLE.get(row.done.state, "red"),
        )
    out.print(table)
    for row in rows:
        taken = accepted(row.done.issues)
        if taken:
            what = f"{row.item.name}: accepted by the problem, not by Tandem: {', '.join(taken)}"
            out.print(what, markup=False, soft_wrap=True)
    verified = sum(row.done.state == "verified" for row in rows)
    kept = sum(row.kept for row in rows)
    again = f", {kept} of them finished before" if kept else ""
    where = folder / "summary.html"
    out.print(f"{verified} of {len(rows)} verified{again}; {seconds:.1f} s; see {where}", markup=False)
