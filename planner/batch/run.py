"""A batch: collect its items, make a self-contained job of each, and plan the jobs into result folders.

Items are files, folders, bundled names and batch files, in a fixed order. Jobs that an earlier run finished
are not planned again.
"""

import collections
import dataclasses
import fcntl
import functools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import yaml

from planner import pipeline, spec
from planner.batch.batch_file import BATCH, read_batch
from planner.batch.job import (
    LIKE,
    PROBLEM,
    Done,
    Event,
    Finished,
    Job,
    Place,
    Record,
    Reports,
    all_versions,
    safe_names,
)
from planner.batch.rows import RECORDS, Item, Row
from planner.batch.workers import Workers
from planner.catalogue.robots import bundled
from planner.files import FILE_KEYS, STAGING, claim_folder, is_file
from planner.issues import Issue, TandemError, refusal
from planner.plans import ARRAYS_FILE, DATA_FILE
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.reading import strict_yaml

SUFFIXES = (".yaml", ".yml")
"""Endings of problem and batch files."""


def collect(given: Sequence[Path], leave_out: Path) -> list[Item]:
    """Items of all that is given; what lies in ``leave_out``, where results go, is none.

    A folder stands for every problem file beneath it, and for every YAML file that cannot be read. Raises
    ``TandemError`` with all faults found: nothing
    there (``problem.missing_file``), or a batch file's own.
    """
    found: list[Item] = []
    issues: list[Issue] = []
    for path in given:
        try:
            found += _items(path, leave_out.resolve())
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    names = safe_names(item.name for item in found)
    return [dataclasses.replace(item, name=name) for item, name in zip(found, names, strict=True)]


def _items(path: Path, leave_out: Path) -> list[Item]:
    if path.is_dir():
        files = [file for file in _files(path) if not file.resolve().is_relative_to(leave_out)]
        items = [item for file in files for item in _in_file(file, path) if _file_kind(file) is not None]
        if not items:
            what = f"{path}: no problem file in this folder; a problem file is YAML with 'tandem: 1'"
            raise refusal("problem.missing_file", what, file=str(path))
        return items
    for file in (path, bundled(path), bundled(path / PROBLEM)):
        if is_file(file):
            return _in_file(file, file.parent.parent if file.name == PROBLEM else file.parent)
    what = f"{path}: no such file, folder or bundled problem; check the name"
    raise refusal("problem.missing_file", what, file=str(path))


def _files(folder: Path) -> Iterator[Path]:
    """YAML files beneath a folder, by name, hidden ones and unfinished results left out."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith((".", STAGING)):
            continue
        if path.is_dir() and not path.is_symlink():
            yield from _files(path)
        elif path.suffix.lower() in SUFFIXES and path.is_file() and _file_kind(path) is not None:
            yield path


def _file_kind(path: Path) -> str | None:
    """``tandem`` for a problem file, ``batch`` for a batch file, by a top-level key; None for others.

    What cannot be read counts as a problem file: nobody can say that it is none, and its row says what is
    wrong with it.
    """
    try:
        data = strict_yaml.read(path).data
    except TandemError:
        return "tandem"
    return next((key for key in (BATCH, "tandem") if key in data), None)


def _in_file(path: Path, root: Path) -> list[Item]:
    name = _name(path, root)
    if _file_kind(path) == BATCH:
        return [Item(f"{name}-{v.name}", f"{path} {v.name}", v.read, v.values) for v in read_batch(path)]
    return [Item(name, str(path), lambda: pipeline.load(path))]


def _name(path: Path, root: Path) -> str:
    """``wing/problem.yaml`` is ``wing``, ``wing/small.yaml`` is ``wing-small`` seen from above ``wing``."""
    try:
        steps = list(path.relative_to(root).with_suffix("").parts)
    except ValueError:
        steps = [path.stem]
    if steps[-1] == Path(PROBLEM).stem:
        steps = steps[:-1] or [path.resolve().parent.name]
    return "-".join(steps)


def bundled_job(
    name: str,
    problem: Problem,
    timeout_s: float | None = None,
    memory_mb: float | None = None,
    like: Path | None = None,
    reports: Reports = "all",
) -> Job:
    """The problem as a job; its issues name files as the problem file does. ``like``: the result folder that
    it is planned like, whose plan and problem go with it, so that equal jobs have equal results."""
    files = problem_file.bundle(problem)
    carried = yaml.safe_load(files[PROBLEM])
    origins = dict(_pairs(carried, problem.source))
    if like is not None:
        kept = [like / ARRAYS_FILE, like / DATA_FILE, *sorted((like / "problem").rglob("*"))]
        files |= {
            f"{LIKE}/{path.relative_to(like).as_posix()}": path.read_bytes()
            for path in kept
            if path.is_file()
        }
    return Job(name, files, timeout_s, memory_mb, origins, reports)


def _pairs(carried: Any, source: Any) -> Iterator[tuple[str, str]]:
    """Names of files in the bundle and in the problem, where both have a value of the key ``file``."""
    if isinstance(carried, dict):
        for key, value in carried.items():
            if key in FILE_KEYS and isinstance(value, str):
                yield value, str(Path(source[key]))
            else:
                yield from _pairs(value, source[key])
    elif isinstance(carried, list):
        for one, other in zip(carried, source, strict=True):
            yield from _pairs(one, other)


class Planners(Protocol):
    """What plans jobs: `planner.batch.workers.Workers` or `planner.batch.cluster.Cluster`."""

    @property
    def busy(self) -> bool:
        """Whether any job has not ended."""

    @property
    def ahead(self) -> int:
        """How many jobs to hand over before one has ended."""

    def start(self, job: Job, folder: Path, record: Record | None = None) -> None:
        """Plan a job into a folder."""

    def events(self, timeout_s: float) -> Iterator[Event]:
        """What happens."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How a batch runs: limits of each job, and whether what was finished before is kept (``resume``).
    ``like``: the folder of an earlier batch, like whose results of the same names problems are planned that
    are planned like no other item. ``reports``: which jobs get report and replay."""

    timeout_s: float | None = None
    memory_mb: float | None = None
    resume: bool = False
    like: Path | None = None
    reports: Reports = "all"


OnEvent = Callable[[Event], None]


def run(
    items: Sequence[Item], out: Path, planners: Planners, settings: Settings, on_event: OnEvent
) -> list[Row]:
    """Plan all items into ``out``; the rows in the order of the items, as far as it came when interrupted
    nothing is lost but what was under way.

    ``on_event`` gets every event, a :class:`Finished` of what was kept too. Raises ``TandemError`` where
    nothing can be written or planned (``output.folder``, ``batch.worker``, ``batch.cluster``,
    ``batch.versions``).
    """
    rows: dict[str, Row] = {}
    waiting = collections.deque(_longest_first(items))
    under_way: dict[str, Item] = {}
    known = {item.name: item for item in items}
    versions = all_versions()

    def ended(row: Row) -> None:
        rows[row.item.name] = row
        under_way.pop(row.item.name, None)
        on_event(Finished(row.item.name, row.done))

    while waiting or planners.busy:
        while len(under_way) < planners.ahead:
            item = _next(waiting, rows, under_way)
            if item is None:
                break
            waiting.remove(item)
            before = _former(item, known, rows, out, settings)
            row = _begin(item, out, planners, settings, versions, before)
            if row is not None:
                ended(row)
            else:
                under_way[item.name] = item
        for event in planners.events(1.0) if planners.busy else ():
            if isinstance(event, Finished):
                ended(Row(known[event.name], event.done))
            else:
                on_event(event)
    return [rows[item.name] for item in items]


def _longest_first(items: Sequence[Item]) -> list[Item]:
    """The items for which most others wait one after the other first, else as they are: so no worker is left
    with a row of them while the others have nothing to do."""
    after = {item.name: 0 for item in items}
    like = {item.name: item.like for item in items}
    for item in items:
        steps, name = 1, item.like
        while name is not None and after.get(name, steps) < steps <= len(items):
            after[name] = steps
            steps, name = steps + 1, like[name]
    return sorted(items, key=lambda item: -after[item.name])


def _next(waiting: Iterable[Item], rows: Mapping[str, Row], under_way: Mapping[str, Item]) -> Item | None:
    """The first item that waits for no other; the first one where none is under way that others wait for."""
    ready = (item for item in waiting if item.like is None or item.like in rows)
    return next(ready, None if under_way else next(iter(waiting), None))


def _former(
    item: Item, known: Mapping[str, Item], rows: Mapping[str, Row], out: Path, settings: Settings
) -> Path | None:
    """The result folder that an item is planned like: of the item that it is like, or where that is not
    verified, of the one which that is like, and so on; else of its name in an earlier batch; None where there
    is none."""
    name = item.like
    for _ in known:
        if name is None or name not in rows:
            break
        if rows[name].done.state == "verified":
            return out / name
        name = known[name].like
    folder = None if settings.like is None else settings.like / item.name
    return folder if folder is not None and is_file(folder / DATA_FILE) else None


def plan_all(
    problems: Mapping[str, Problem | spec.Problem],
    out: str | Path,
    workers: int = 2,
    settings: Settings | None = None,
    on_event: Callable[[Event], None] | None = None,
) -> dict[str, Done]:
    """Plan problems of Python by name, as ``tandem batch`` plans files: ``workers`` processes side by side,
    each result in a folder of that name in ``out``. How each ended, a refused or crashed one too, by name.

    Raises ``ValueError`` for ``workers`` below 1, and ``TandemError`` as :func:`run` and
    :func:`claimed_folder`.
    """
    folder, names = Path(out), safe_names(problems)
    items = [
        Item(name, given, functools.partial(pipeline.built, problem))
        for name, (given, problem) in zip(names, problems.items(), strict=True)
    ]
    with claimed_folder(folder), Workers(workers) as planners:
        rows = run(items, folder, planners, settings or Settings(), on_event or (lambda _: None))
    return {row.item.origin: row.done for row in rows}


@contextmanager
def claimed_folder(out: Path) -> Iterator[None]:
    """``out`` is this batch's own while the block runs: it can be written, and no other batch writes to it.

    Raises ``TandemError`` (``output.folder``, ``batch.in_use``).
    """
    claim_folder(out, ())
    records = out / RECORDS
    records.mkdir(exist_ok=True)
    handle = os.open(records, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            what = f"output folder {out}: another batch is writing to it; wait for it, or choose another"
            raise refusal("batch.in_use", what, file=str(out)) from error
        claim_folder(out, ())  # what the last holder of the lock left
        claim_folder(records, ())
        for stale in records.glob(".*.json.*"):  # half-written records of killed batches
            stale.unlink(missing_ok=True)
        yield
    finally:
        os.close(handle)


def _begin(
    item: Item,
    out: Path,
    planners: Planners,
    settings: Settings,
    versions: Mapping[str, str],
    like: Path | None,
) -> Row | None:
    """Hand an item over, with the result folder that it is planned ``like``; its row instead where it has
    ended before it began."""
    folder, path = out / item.name, out / RECORDS / f"{item.name}.json"
    try:
        problem = item.read()
    except TandemError as error:
        done = Done(item.name, "bad_input", error.issues)
        try:
            return Row(item, Place.claim(folder, Record(path)).publish(done))
        except TandemError as foreign:
            return Row(item, dataclasses.replace(done, issues=(*done.issues, *foreign.issues)))
    job = bundled_job(
        item.name, problem, settings.timeout_s, settings.memory_mb, like, reports=settings.reports
    )
    identity = job.identity(versions)
    if settings.resume:
        kept = _finished(path, folder, identity, settings)
        if kept is not None:
            return Row(item, kept, kept=True)
    limits = {"timeout_s": settings.timeout_s, "memory_mb": settings.memory_mb}
    try:
        planners.start(job, folder, Record(path, {"identity": identity, **limits}))
    except TandemError as error:
        return Row(item, Done(item.name, "bad_input", error.issues))
    return None


def _finished(path: Path, folder: Path, identity: str, settings: Settings) -> Done | None:
    """What a record says of a job, if that was the same job and trying it again has no point."""
    read = Record.read(path)
    if read is None or read[1].get("identity") != identity:
        return None
    done, more = read
    needed = DATA_FILE if settings.reports == "failed" and done.state == "verified" else "report.html"
    if not (folder / needed).is_file():
        return None
    if done.state in ("crashed", "cancelled"):
        return None
    for state, key, now in (
        ("timeout", "timeout_s", settings.timeout_s),
        ("memory", "memory_mb", settings.memory_mb),
    ):
        before = more.get(key)
        if done.state == state and (now is None or not isinstance(before, int | float) or now > before):
            return None
    return done


def exit_code(rows: Sequence[Row]) -> int:
    """0 if all are verified; else 1 if any crashed or met a limit, else 4, 3 or 2 as ``tandem plan`` would
    say of the worst one: planned but not proven, no feasible plan, bad input."""
    states = {row.done.state for row in rows}
    if states & {"crashed", "timeout", "memory", "cancelled"}:
        return 1
    return next((c for s, c in (("unproven", 4), ("infeasible", 3), ("bad_input", 2)) if s in states), 0)
