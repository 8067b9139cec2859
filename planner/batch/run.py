"""A batch: every item is planned into a folder of its own, and none twice that was finished before."""

from __future__ import annotations

import collections
import dataclasses
import fcntl
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Protocol

from planner.batch import bundles
from planner.batch.collect import Item
from planner.batch.job import Done, Event, Finished, Job, all_versions
from planner.batch.place import Place, Record
from planner.files import claim_folder
from planner.issues import Issue, TandemError

RECORDS: Final = ".records"
"""The folder, beside the results, of what a batch remembers of its jobs."""


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
class Row:
    """One item of a batch and how it ended; ``kept``: in an earlier run."""

    item: Item
    done: Done
    kept: bool = False


@dataclasses.dataclass(frozen=True)
class Settings:
    """How a batch runs: limits of each job, and whether what was finished before is kept (``resume``)."""

    timeout_s: float | None = None
    memory_mb: float | None = None
    resume: bool = False


Tell = Callable[[Event], None]


def run(items: Sequence[Item], out: Path, planners: Planners, settings: Settings, tell: Tell) -> list[Row]:
    """Plan all items into ``out``; the rows in the order of the items, as far as it came when interrupted
    nothing is lost but what was under way.

    ``tell`` hears every event, a :class:`Finished` of what was kept too. Raises ``TandemError`` where nothing
    can be written or planned (``output.folder``, ``batch.worker``, ``batch.cluster``, ``batch.versions``).
    """
    rows: dict[str, Row] = {}
    waiting = collections.deque(items)
    under_way: dict[str, Item] = {}
    known = {item.name: item for item in items}
    versions = all_versions()

    def ended(row: Row) -> None:
        rows[row.item.name] = row
        under_way.pop(row.item.name, None)
        tell(Finished(row.item.name, row.done))

    while waiting or planners.busy:
        while waiting and len(under_way) < planners.ahead:
            item = waiting.popleft()
            row = _begin(item, out, planners, settings, versions)
            if row is not None:
                ended(row)
            else:
                under_way[item.name] = item
        for event in planners.events(1.0) if planners.busy else ():
            if isinstance(event, Finished):
                ended(Row(known[event.name], event.done))
            else:
                tell(event)
    return [rows[item.name] for item in items]


@contextmanager
def claimed(out: Path) -> Iterator[None]:
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
            raise TandemError(Issue("batch.in_use", what, file=str(out))) from error
        claim_folder(out, ())  # what the last holder of the lock left
        claim_folder(records, ())
        for stale in records.glob(".*.json.*"):  # half-written records of killed batches
            stale.unlink(missing_ok=True)
        yield
    finally:
        os.close(handle)


def _begin(
    item: Item, out: Path, planners: Planners, settings: Settings, versions: Mapping[str, str]
) -> Row | None:
    """Hand an item over; its row instead where it has ended before it began."""
    folder, path = out / item.name, out / RECORDS / f"{item.name}.json"
    try:
        problem = item.read()
    except TandemError as error:
        done = Done(item.name, "bad_input", error.issues)
        try:
            return Row(item, Place.claim(folder, Record(path)).publish(done))
        except TandemError as foreign:
            return Row(item, dataclasses.replace(done, issues=(*done.issues, *foreign.issues)))
    job = bundles.job(item.name, problem, settings.timeout_s, settings.memory_mb)
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
    if read is None or read[1].get("identity") != identity or not (folder / "report.html").is_file():
        return None
    done, more = read
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
