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
from planner.batch.batch_file import BATCH_KEY, read_batch
from planner.batch.job import (
    PROBLEM_FILE,
    REFERENCE_FOLDER,
    BatchJob,
    JobEvent,
    JobFinished,
    JobRecord,
    JobResult,
    Reports,
    ResultFolder,
    all_versions,
    make_safe_names,
)
from planner.batch.rows import RECORDS_FOLDER, BatchItem, BatchRow
from planner.batch.workers import BatchWorkers
from planner.catalogue.robots import bundled_path
from planner.files import FILE_KEYS, STAGING, is_file, prepare_folder
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.plans import ARRAYS_FILE, DATA_FILE
from planner.problem import Problem
from planner.reading import problem as problem_file
from planner.reading import strict_yaml

YAML_SUFFIXES = (".yaml", ".yml")
"""Suffixes of problem and batch files."""


def collect_items(paths: Sequence[Path], excluded_folder: Path) -> list[BatchItem]:
    """Return the items of all given paths.

    A folder stands for every problem file beneath it, and for every YAML file that cannot be read.

    Args:
        paths: Files, folders and bundled names.
        excluded_folder: Folder of the results, which is skipped.

    Raises:
        TandemError: All errors: nothing there (``problem.missing_file``), or errors of batch files.
    """
    items: list[BatchItem] = []
    issues: list[Issue] = []
    for path in paths:
        try:
            items += _items_at(path, excluded_folder.resolve())
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    names = make_safe_names(item.name for item in items)
    return [dataclasses.replace(item, name=name) for item, name in zip(items, names, strict=True)]


def _items_at(path: Path, excluded_folder: Path) -> list[BatchItem]:
    """Return the items of one path: a folder, a file, or a bundled name."""
    if path.is_dir():
        files = [file for file in _files(path) if not file.resolve().is_relative_to(excluded_folder)]
        items = [
            item for file in files for item in _items_in_file(file, path) if _file_kind(file) is not None
        ]
        if not items:
            message = f"{path}: no problem file in this folder; a problem file is YAML with 'tandem: 1'"
            raise issue_error("problem.missing_file", message, file=str(path))
        return items
    for file in (path, bundled_path(path), bundled_path(path / PROBLEM_FILE)):
        if is_file(file):
            return _items_in_file(file, file.parent.parent if file.name == PROBLEM_FILE else file.parent)
    message = f"{path}: no such file, folder or bundled problem; check the name"
    raise issue_error("problem.missing_file", message, file=str(path))


def _files(folder: Path) -> Iterator[Path]:
    """Yield problem and batch files beneath a folder, sorted, without hidden files and unfinished results."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith((".", STAGING)):
            continue
        if path.is_dir() and not path.is_symlink():
            yield from _files(path)
        elif path.suffix.lower() in YAML_SUFFIXES and path.is_file() and _file_kind(path) is not None:
            yield path


def _file_kind(path: Path) -> str | None:
    """Return ``tandem`` for a problem file, ``batch`` for a batch file, by a top-level key; None for others.

    A file that cannot be read counts as a problem file. Its row states what is wrong.
    """
    try:
        data = strict_yaml.read(path).data
    except TandemError:
        return "tandem"
    return next((key for key in (BATCH_KEY, "tandem") if key in data), None)


def _items_in_file(path: Path, root: Path) -> list[BatchItem]:
    """Return the items of a batch file, or one item for a problem file. ``root`` is as for :func:`_name`."""
    name = _name(path, root)
    if _file_kind(path) == BATCH_KEY:
        return [
            BatchItem(f"{name}-{variant.name}", f"{path} {variant.name}", variant.read, variant.values)
            for variant in read_batch(path)
        ]
    return [BatchItem(name, str(path), lambda: pipeline.load(path))]


def _name(path: Path, root: Path) -> str:
    """Return the name of an item relative to a root folder.

    If ``root`` contains ``wing``, the name of ``wing/problem.yaml`` is ``wing``, and that of
    ``wing/small.yaml`` is ``wing-small``.
    """
    try:
        parts = list(path.relative_to(root).with_suffix("").parts)
    except ValueError:
        parts = [path.stem]
    if parts[-1] == Path(PROBLEM_FILE).stem:
        parts = parts[:-1] or [path.resolve().parent.name]
    return "-".join(parts)


def make_bundled_job(
    name: str,
    problem: Problem,
    timeout_s: float | None = None,
    memory_mb: float | None = None,
    reference: Path | None = None,
    reports: Reports = "all",
) -> BatchJob:
    """Return a self-contained job that plans a problem. Its issues name files as the problem file does.

    Args:
        name: Name of the job.
        problem: The problem.
        timeout_s: Maximum planning time [s].
        memory_mb: Maximum memory [MB].
        reference: Result folder with the reference plan. Its plan and problem are part of the job, so that
            equal jobs have equal results.
        reports: Which jobs get report and replay.
    """
    files = problem_file.bundle(problem)
    bundle_data = yaml.safe_load(files[PROBLEM_FILE])
    origins = dict(_file_name_pairs(bundle_data, problem.source))
    if reference is not None:
        reference_files = [
            reference / ARRAYS_FILE,
            reference / DATA_FILE,
            *sorted((reference / "problem").rglob("*")),
        ]
        files |= {
            f"{REFERENCE_FOLDER}/{path.relative_to(reference).as_posix()}": path.read_bytes()
            for path in reference_files
            if path.is_file()
        }
    return BatchJob(name, files, timeout_s, memory_mb, origins, reports)


def _file_name_pairs(bundle_data: Any, source: Any) -> Iterator[tuple[str, str]]:
    """Yield the name of each file in a bundle and its name in the problem.

    Args:
        bundle_data: Data of the bundled problem file, at any level.
        source: Data of the problem at the same level.
    """
    if isinstance(bundle_data, dict):
        for key, value in bundle_data.items():
            if key in FILE_KEYS and isinstance(value, str):
                yield value, str(Path(source[key]))
            else:
                yield from _file_name_pairs(value, source[key])
    elif isinstance(bundle_data, list):
        for bundle_item, source_item in zip(bundle_data, source, strict=True):
            yield from _file_name_pairs(bundle_item, source_item)


class Planners(Protocol):
    """Plans jobs: `planner.batch.workers.BatchWorkers` or `planner.batch.cluster.ClusterPlanners`."""

    @property
    def busy(self) -> bool:
        """Whether any job has not ended."""

    @property
    def ahead(self) -> int:
        """Number of jobs to submit before one has ended."""

    def start(self, job: BatchJob, folder: Path, record: JobRecord | None = None) -> None:
        """Plan a job into a folder."""

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        """Yield events."""


@dataclasses.dataclass(frozen=True)
class BatchSettings:
    """Settings of a batch.

    Attributes:
        timeout_s: Maximum planning time of each job [s].
        memory_mb: Maximum memory of each job [MB].
        resume: Whether results of earlier runs are kept.
        reference_folder: Folder of an earlier batch. Its results of the same names are reference plans of
            problems that have none.
        reports: Which jobs get report and replay.
    """

    timeout_s: float | None = None
    memory_mb: float | None = None
    resume: bool = False
    reference_folder: Path | None = None
    reports: Reports = "all"


OnEvent = Callable[[JobEvent], None]


def run_batch(
    items: Sequence[BatchItem], out: Path, planners: Planners, settings: BatchSettings, on_event: OnEvent
) -> list[BatchRow]:
    """Plan all items into ``out`` and return their rows of the summary, in the order of the items.

    An item waits for the item whose plan is its reference plan. Items on which the longest chains of others
    wait are planned first. If the batch is interrupted, only running jobs are lost.

    Args:
        items: The items.
        out: Folder of the results.
        planners: Plans the jobs.
        settings: Settings of the batch.
        on_event: Receives every event, also a :class:`JobFinished` of kept results.

    Raises:
        TandemError: Nothing can be written or planned (``output.folder``, ``batch.worker``,
            ``batch.cluster``, ``batch.versions``).
    """
    rows: dict[str, BatchRow] = {}
    waiting = collections.deque(_longest_first(items))
    running: dict[str, BatchItem] = {}
    items_by_name = {item.name: item for item in items}
    versions = all_versions()

    def record_row(row: BatchRow) -> None:
        rows[row.item.name] = row
        running.pop(row.item.name, None)
        on_event(JobFinished(row.item.name, row.done))

    while waiting or planners.busy:
        while len(running) < planners.ahead:
            item = _next_item(waiting, rows, running)
            if item is None:
                break
            waiting.remove(item)
            reference = _reference_folder(item, items_by_name, rows, out, settings)
            row = _submit(item, out, planners, settings, versions, reference)
            if row is not None:
                record_row(row)
            else:
                running[item.name] = item
        for event in planners.events(1.0) if planners.busy else ():
            if isinstance(event, JobFinished):
                record_row(BatchRow(items_by_name[event.name], event.done))
            else:
                on_event(event)
    return [rows[item.name] for item in items]


def _longest_first(items: Sequence[BatchItem]) -> list[BatchItem]:
    """Sort the items by the length of the chain of items that wait for them, the longest first.

    Otherwise one worker could be left with a long chain while the others are idle. Items with equal lengths
    keep their order.
    """
    waiting_count = {item.name: 0 for item in items}
    references = {item.name: item.reference for item in items}
    for item in items:
        chain_length, name = 1, item.reference
        while name is not None and waiting_count.get(name, chain_length) < chain_length <= len(items):
            waiting_count[name] = chain_length
            chain_length, name = chain_length + 1, references[name]
    return sorted(items, key=lambda item: -waiting_count[item.name])


def _next_item(
    waiting: Iterable[BatchItem], rows: Mapping[str, BatchRow], running: Mapping[str, BatchItem]
) -> BatchItem | None:
    """Return the first item whose reference has a result, or that has none.

    If there is no such item and nothing is running, the references form a cycle, and the first item is
    returned.
    """
    ready = (item for item in waiting if item.reference is None or item.reference in rows)
    return next(ready, None if running else next(iter(waiting), None))


def _reference_folder(
    item: BatchItem,
    items_by_name: Mapping[str, BatchItem],
    rows: Mapping[str, BatchRow],
    out: Path,
    settings: BatchSettings,
) -> Path | None:
    """Return the result folder with the reference plan of an item, or None.

    It is that of the item's reference, or if that is not verified, of the reference of the reference, and so
    on. Otherwise it is the result of the same name in an earlier batch.
    """
    name = item.reference
    for _ in items_by_name:
        if name is None or name not in rows:
            break
        if rows[name].done.state == "verified":
            return out / name
        name = items_by_name[name].reference
    folder = None if settings.reference_folder is None else settings.reference_folder / item.name
    return folder if folder is not None and is_file(folder / DATA_FILE) else None


def plan_all(
    problems: Mapping[str, Problem | spec.Problem],
    out: str | Path,
    workers: int = 2,
    settings: BatchSettings | None = None,
    on_event: Callable[[JobEvent], None] | None = None,
) -> dict[str, JobResult]:
    """Plan problems by name, as ``tandem batch`` plans files.

    Args:
        problems: Problems by name.
        out: Folder of the results, one folder for each name.
        workers: Number of parallel processes.
        settings: Settings of the batch.
        on_event: Receives every event.

    Returns:
        Result of each problem by its name, also if it was refused or crashed.

    Raises:
        ValueError: ``workers`` is below 1.
        TandemError: As :func:`run_batch` and :func:`claimed_folder`.
    """
    folder, names = Path(out), make_safe_names(problems)
    items = [
        BatchItem(safe_name, name, functools.partial(pipeline.ensure_problem, problem))
        for safe_name, (name, problem) in zip(names, problems.items(), strict=True)
    ]
    with claimed_folder(folder), BatchWorkers(workers) as planners:
        rows = run_batch(items, folder, planners, settings or BatchSettings(), on_event or (lambda _: None))
    return {row.item.origin: row.done for row in rows}


@contextmanager
def claimed_folder(out: Path) -> Iterator[None]:
    """Lock ``out`` for this batch: it can be written, and no other batch writes to it.

    Raises:
        TandemError: ``output.folder``, ``batch.in_use``.
    """
    prepare_folder(out, ())
    records = out / RECORDS_FOLDER
    records.mkdir(exist_ok=True)
    handle = os.open(records, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            message = format_message("batch.in_use", folder=out)
            raise issue_error("batch.in_use", message, file=str(out)) from error
        prepare_folder(out, ())  # remove what the previous holder of the lock left
        prepare_folder(records, ())
        for partial_record in records.glob(".*.json.*"):  # half-written records of killed batches
            partial_record.unlink(missing_ok=True)
        yield
    finally:
        os.close(handle)


def _submit(
    item: BatchItem,
    out: Path,
    planners: Planners,
    settings: BatchSettings,
    versions: Mapping[str, str],
    reference: Path | None,
) -> BatchRow | None:
    """Submit an item to the planners, with the result folder of its reference plan or None.

    Returns:
        None if the item was submitted. If it cannot be read or written, or if an earlier result is kept, its
        row in the summary.
    """
    folder, record_path = out / item.name, out / RECORDS_FOLDER / f"{item.name}.json"
    try:
        problem = item.read()
    except TandemError as error:
        result = JobResult(item.name, "bad_input", error.issues)
        try:
            return BatchRow(item, ResultFolder.claim(folder, JobRecord(record_path)).publish(result))
        except TandemError as claim_error:
            return BatchRow(item, dataclasses.replace(result, issues=(*result.issues, *claim_error.issues)))
    job = make_bundled_job(
        item.name, problem, settings.timeout_s, settings.memory_mb, reference, reports=settings.reports
    )
    identity = job.identity(versions)
    if settings.resume:
        earlier_result = _earlier_result(record_path, folder, identity, settings)
        if earlier_result is not None:
            return BatchRow(item, earlier_result, is_kept=True)
    limits = {"timeout_s": settings.timeout_s, "memory_mb": settings.memory_mb}
    try:
        planners.start(job, folder, JobRecord(record_path, {"identity": identity, **limits}))
    except TandemError as error:
        return BatchRow(item, JobResult(item.name, "bad_input", error.issues))
    return None


def _earlier_result(
    record_path: Path, folder: Path, identity: str, settings: BatchSettings
) -> JobResult | None:
    """Return the recorded result of a job if another attempt would end in the same way, else None.

    The job must be identical, and its result complete: with a report, or with a plan if verified jobs get no
    reports. A crashed or cancelled job is planned again. A job that reached a limit is planned again if the
    limit is higher now, absent, or was not recorded.
    """
    record = JobRecord.read(record_path)
    if record is None or record[1].get("identity") != identity:
        return None
    result, data = record
    required_file = (
        DATA_FILE if settings.reports == "failed" and result.state == "verified" else "report.html"
    )
    if not (folder / required_file).is_file():
        return None
    if result.state in ("crashed", "cancelled"):
        return None
    for state, key, limit in (
        ("timeout", "timeout_s", settings.timeout_s),
        ("memory", "memory_mb", settings.memory_mb),
    ):
        earlier_limit = data.get(key)
        if result.state == state and (
            limit is None or not isinstance(earlier_limit, int | float) or limit > earlier_limit
        ):
            return None
    return result


def exit_code(rows: Sequence[BatchRow]) -> int:
    """Return the exit code of a batch: 0 if all jobs are verified or done, else the code of the worst state.

    The code is 1 if any job crashed, was cancelled or reached a limit. Otherwise it is 4, 3 or 2 as for
    ``tandem plan``: planned but not proven, no feasible plan, bad input.
    """
    states = {row.done.state for row in rows}
    if states & {"crashed", "timeout", "memory", "cancelled"}:
        return 1
    return next(
        (code for state, code in (("unproven", 4), ("infeasible", 3), ("bad_input", 2)) if state in states), 0
    )
