"""``tandem batch`` and ``tandem compare``: many problems, and what came out side by side.

``tandem batch PROBLEMS... -o OUT`` plans each one as ``tandem plan`` would. ``tandem compare A B``
shows two plans or two batches side by side, and in which fields two problems differ, as their files
state them.
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
from planner.issues import Issue, TandemError, accepted, refusal

if TYPE_CHECKING:
    from planner.batch.compare import JobPair, Pair, Plans
    from planner.batch.job import Event
    from planner.batch.rows import Item, Row
    from planner.batch.run import Planners
    from planner.problem import Problem

out = Console(highlight=False)
err = Console(stderr=True)
STATE_STYLE = {"verified": "green", "infeasible": "yellow", "bad_input": "yellow"}
"""Colours of states in the terminal; red for all others."""
NEIGHBOUR: Final = "neighbour"
"""What ``--like`` says where panels are planned like those beside them."""
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
    like: str | None = None
    """neighbour: plan each panel of an element like one beside it; or the folder of an earlier batch: plan
    each problem like its result there"""
    reports: Literal["all", "failed"] = "all"
    """failed: only what is not verified gets report and replay; tandem report makes those of the others"""


def usable_cores() -> int:
    """Cores that this process may run on."""
    able = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(able(0)) if able is not None else os.cpu_count() or 1


def run_batch(request: Batch) -> int:
    """Plan, print and write the summary; the exit code. Raises `TandemError` for what cannot begin."""
    from planner.batch import run as batch
    from planner.batch.run import collect

    _check(request)
    done, seconds = _planned(request, lambda: collect(request.problems, request.output))
    _print(done, request.output, seconds)
    return batch.exit_code(done)


def _planned(request: Batch, wanted: Callable[[], list[Item]]) -> tuple[list[Row], float]:
    """All that is wanted planned, with progress, and the summary written; the rows, and the time [s]."""
    from planner.batch import rows as batch_rows
    from planner.batch import run as batch
    from planner.batch.job import Finished

    start = time.perf_counter()
    rows: dict[str, Row] = {}
    with batch.claimed_folder(request.output):
        items = wanted()
        count = min(request.workers or usable_cores(), len(items))
        items, former = _like(request, items)
        limits = request.timeout, request.memory
        settings = batch.Settings(*limits, request.resume, former, request.reports)
        known = {item.name: item for item in items}
        with _planners(request, count) as planners, _progress(items) as shown:

            def on_event(event: Event) -> None:
                if isinstance(event, Finished):
                    rows[event.name] = batch_rows.Row(known[event.name], event.done)
                shown.show(event)

            try:
                done = batch.run(items, request.output, planners, settings, on_event)
            except BaseException:
                so_far = [rows[item.name] for item in items if item.name in rows]
                _write(request, so_far, time.perf_counter() - start)
                raise
        _write(request, done, time.perf_counter() - start)
    return done, time.perf_counter() - start


def _like(request: Batch, items: list[Item]) -> tuple[list[Item], Path | None]:
    """The items with those that they are planned like, and the folder of an earlier batch. Raises
    ``TandemError`` (``batch.field``)."""
    if request.like is None:
        return items, None
    if request.like == NEIGHBOUR:
        from planner.batch.neighbours import like_neighbours

        return like_neighbours(items), None
    from planner.plans import DATA_FILE

    folder = Path(request.like)
    new = [item.name for item in items if not is_file(folder / item.name / DATA_FILE)]
    if len(new) == len(items):
        what = f"--like {folder}: it holds no plan of any of these problems"
        hint = f"name the folder of an earlier batch of them, or say {NEIGHBOUR}"
        raise refusal("batch.field", what, field="--like", hint=hint)
    if new:
        err.print(f"{len(new)} of {len(items)} have no plan in {folder}: {', '.join(new[:5])}", markup=False)
    return items, folder


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


@dataclasses.dataclass(frozen=True)
class Fit:
    """Which robots for this part: plan a problem in its own cell and in each cell of a folder, and rank them.

    First those that are proven, of these those with ample margins, of these the fastest; of the others why.
    """

    problem: tyro.conf.Positional[Path]
    """a problem file, or a bundled problem"""
    cells: Path
    """folder of cell files (YAML with arms); their arms take the names of the problem's, in their order"""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """folder for a result folder of each cell, summary.csv and summary.html"""
    workers: int | None = None
    """worker processes; by default one for each processor"""
    resume: bool = False
    """keep what an earlier run finished, and plan the rest"""
    timeout: float | None = None
    """longest planning in one cell, in seconds"""


def run_fit(request: Fit) -> int:
    """Plan in all cells, print the ranking and write it; the exit code: whether one is proven. Raises
    `TandemError`."""
    from planner import pipeline
    from planner.batch import fit
    from planner.batch import run as batch

    problem = pipeline.load(request.problem)
    about = Batch(
        (request.problem,), request.output, request.workers, request.resume, request.timeout, reports="failed"
    )
    _check(about)
    rows, seconds = _planned(about, lambda: fit.items(problem, request.cells))
    rows = fit.ranked(rows, problem.settings)
    _write(about, rows, seconds)
    _print_fit(rows, problem, seconds, request.output)
    return 0 if any(row.done.state == "verified" for row in rows) else batch.exit_code(rows)


def _print_fit(rows: Sequence[Row], problem: Problem, seconds: float, folder: Path) -> None:
    from planner.batch import compare

    names = ("cycle_s", "clearance_mm", "joint_limits_deg", "singularity_deg")
    cell = Column("cell", overflow="fold")
    table = Table("", cell, "status", *(compare.FIGURES[name] for name in names))
    for number, row in enumerate(rows, 1):
        table.add_row(
            str(number) if row.done.state == "verified" else "",
            row.item.name,
            compare.STATES[row.done.state],
            *(compare.figure_text(name, row.done.metrics.get(name)) for name in names),
            style=STATE_STYLE.get(row.done.state, "red"),
        )
    out.print(table)
    for row in rows:
        issue = compare.gravest_issue(row.done)
        if row.done.state != "verified" and issue is not None:
            out.print(f"{row.item.name}: {issue}", markup=False, soft_wrap=True)
    verified = sum(row.done.state == "verified" for row in rows)
    where = folder / "summary.html"
    what = f"{problem.name} is proven in {verified} of {len(rows)} cells; {seconds:.1f} s; see {where}"
    out.print(what, markup=False)


COMPARED_FIGURES = ("cycle_s", "clearance_mm", "path_cost", "planning_s")
"""Figures of each job of two batches."""


@dataclasses.dataclass(frozen=True)
class Compare:
    """Show two result folders side by side: cycle time, margins, path cost, changed segments, issues.

    Two folders that `tandem batch` wrote are compared job by job.
    """

    first: tyro.conf.Positional[Path]
    """a result folder, or the folder of a batch"""
    second: tyro.conf.Positional[Path]
    """what to compare it with, of the same kind"""


def run_compare(request: Compare) -> None:
    """Print the comparison. Raises `TandemError` for what cannot be read."""
    from planner.batch import compare

    if compare.is_batch(request.first) or compare.is_batch(request.second):
        _batches(compare.compare_batches(request.first, request.second))
    else:
        _plans(compare.compare_plans(request.first, request.second))


def _plans(found: Plans) -> None:
    from planner.batch.compare import FIGURES

    table = Table("figure", "first", "second", "change")
    verdicts = [_verdict(side.ok) for side in (found.first, found.second)]
    table.add_row("proof", *verdicts, "" if verdicts[0] == verdicts[1] else "differs")
    for pair in found.figures:
        table.add_row(FIGURES.get(pair.name, pair.name), *_cells(pair))
    out.print(table)
    if found.first.plan.digest == found.second.plan.digest:
        out.print("both are plans of the same problem")
    if found.segments:
        table = Table("changed segment", "targets", "seconds", "joints deg", "poses mm")
        for s in found.segments:
            targets = f"{_text(s.targets[0])} to {_text(s.targets[1])}"
            seconds = f"{_text(s.seconds[0])} to {_text(s.seconds[1])}"
            table.add_row(
                f"{s.operation}/{s.segment}", targets, seconds, _text(s.joints_deg), _text(s.poses_mm)
            )
        out.print(table)
    else:
        out.print("no segment changed")
    _issues(found.issues)


def _batches(found: list[JobPair]) -> None:
    from planner.batch.compare import FIGURES, STATES

    table = Table(
        "job", "status", *(FIGURES.get(name, "planned in s") for name in COMPARED_FIGURES), "issues"
    )
    for job in found:
        states = [STATES[done.state] if done is not None else "not there" for done in (job.first, job.second)]
        status = states[0] if states[0] == states[1] else f"{states[0]} to {states[1]}"
        codes = "; ".join(f"{code} {one} to {other}" for code, (one, other) in job.issues.items())
        table.add_row(job.name, status, *(_both(job.figure(name)) for name in COMPARED_FIGURES), codes)
    out.print(table)
    both = [job for job in found if job.first is not None and job.second is not None]
    for name in COMPARED_FIGURES:
        pairs = [job.figure(name) for job in both]
        known = [(p.first, p.second) for p in pairs if p.first is not None and p.second is not None]
        if known:
            sums = sum(one for one, _ in known), sum(other for _, other in known)
            title = FIGURES.get(name, "planned in s")
            if not name.endswith("_mm"):  # a sum of distances says nothing
                out.print(f"{title}, sum over {len(known)} jobs: {_text(sums[0])} to {_text(sums[1])}")
    changed = sum(
        job.first is None or job.second is None or job.first.state != job.second.state for job in found
    )
    out.print(f"{len(found)} jobs, the status of {changed} differs")


def _issues(found: Mapping[str, tuple[int, int]]) -> None:
    if not found:
        out.print("the same issues")
        return
    table = Table("issues", "first", "second")
    for code, (one, other) in found.items():
        table.add_row(code, str(one), str(other))
    out.print(table)


def _verdict(ok: bool | None) -> str:
    return "no proof" if ok is None else "proven" if ok else "NOT proven"


def _cells(pair: Pair) -> tuple[str, str, str]:
    change = pair.change
    said = "" if change is None else "same" if change == 0.0 else f"{change:+.4g}"
    if change and pair.first:
        said += f" ({100 * change / abs(pair.first):+.1f} %)"
    return _text(pair.first), _text(pair.second), said


def _both(pair: Pair) -> str:
    one, other = _text(pair.first), _text(pair.second)
    return one if one == other else f"{one} to {other}"


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


NOT_GIVEN: Final = "not given"
"""What is shown for a field that one side does not have."""
LONGEST_SHOWN: Final = 60
"""Longer values are cut for display."""
_ABSENT: Final = object()
"""Stands for a field that a side does not have; None is a value."""


@dataclasses.dataclass(frozen=True)
class Difference:
    """A field in which two problems differ, such as ``settings.clearance_mm``, and its values as text."""

    field: str
    first: str
    second: str


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Where the values of two problems' sources differ, field by field in the order of the files; files that
    they name count by their contents."""
    return tuple(_compare("", first, second))


def _compare(field: str, a: Any, b: Any) -> Iterator[Difference]:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            name = f"{field}.{key}" if field else str(key)
            if key in FILE_KEYS:
                yield from _files(name, a.get(key, _ABSENT), b.get(key, _ABSENT))
            else:
                yield from _compare(name, a.get(key, _ABSENT), b.get(key, _ABSENT))
    elif isinstance(a, list) and isinstance(b, list):
        for i in range(max(len(a), len(b))):
            own, other = (rows[i] if i < len(rows) else _ABSENT for rows in (a, b))
            yield from _compare(f"{field}[{i}]", own, other)
    elif type(a) is not type(b) or a != b:
        yield Difference(field, _short_value(a), _short_value(b))


def _files(field: str, a: Any, b: Any) -> Iterator[Difference]:
    if not isinstance(a, str) or not isinstance(b, str):
        yield from _compare(field, a, b)
    elif (own := _content(a)) != (other := _content(b)):
        yield Difference(field, f"{Path(a).name}, {own}", f"{Path(b).name}, {other}")


def _content(name: str) -> str:
    path = Path(name)
    return f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()}" if is_file(path) else "missing"


def _short_value(value: Any) -> str:
    if value is _ABSENT:
        return NOT_GIVEN
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."
