"""Plans the jobs of the store: hosts claim them for a time and plan on worker processes.

A host holds a job by a lease that it renews; when a host is gone, another one takes its jobs over.
Every change asks whether the job is still held, so that a host that was given up changes nothing.
A thread plans as many jobs at once as there are worker processes.
"""

import contextlib
import dataclasses
import json
import logging
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

from sqlalchemy import ColumnElement, Connection, Select, and_, case, delete, func, or_, select, update
from sqlalchemy.exc import SQLAlchemyError

from planner.batch.job import LIKE, Done, Event, Finished, Found, Job, Progress
from planner.files import THUMBNAIL
from planner.issues import Issue, TandemError
from planner.report.thumbnail import thumbnail
from planner.service import audit, idempotency, metrics, webhooks
from planner.service.jobs import (
    STORE,
    answer_from_store,
    issues_json,
    job_files,
    put_files,
    record_event,
    remove,
)
from planner.service.models import DELETED, ELEMENT_JOBS, JOBS, OPEN, SESSIONS, Database, State
from planner.service.schema import SchemaVersionError
from planner.service.security import MB, issue_json
from planner.service.storage import Blob, Files

LONGEST_LEASE_S: Final = 86400.0
"""No host's jobs are its own for longer [s] without a word of it."""
MOST_ATTEMPTS: Final = 3
"""So often a job may be at hand when a host goes down; then it is taken to be the cause."""


@dataclasses.dataclass(frozen=True)
class Claimed:
    """A job that this host is to plan; ``name`` of its problem, ``files`` by name."""

    id: str
    name: str
    attempt: int
    files: Mapping[str, Blob]
    timeout_s: float
    memory_mb: float


class Work:
    """The jobs of one database for one host."""

    def __init__(self, database: Database, host: str, lease_s: float) -> None:
        self._database, self._host, self._lease_s = database, host, lease_s

    def claim(self) -> Claimed | None:
        """The next job that waits, now held by this host; None where there is none.

        Owners with fewer running jobs come first, then elements to divide or to report on, which somebody
        looks at, then the job whose turn is earlier. A job whose like is running waits, and one whose like is
        done gets that answer. A panel waits for the one beside it that it is planned like.
        """
        waiting = select(JOBS.c.id).where(JOBS.c.state == "queued").limit(1)
        while True:
            with self._database.read() as db:
                if db.execute(waiting).first() is None:
                    return None
            with self._database.write() as db:
                row = db.execute(self._next()).mappings().first()
                if row is None:
                    return None
                job = row["id"]
                if answer_from_store(db, job, row["key"]):
                    metrics.ended(
                        db.execute(select(JOBS.c.state).where(JOBS.c.id == job)).scalar_one(), STORE
                    )
                    continue
                attempt = row["attempts"] + 1
                db.execute(
                    update(JOBS)
                    .where(JOBS.c.id == job)
                    .values(
                        state="running",
                        host=self._host,
                        lease=self._until(),
                        attempts=attempt,
                        started=time.time(),
                        stage="",
                        fraction=0.0,
                    )
                )
                record_event(db, job, "state", {"state": "running", "attempt": attempt})
                files = {**job_files(db, job), **_like(db, job)}
                metrics.waited(time.time() - row["created"])
                return Claimed(job, row["name"], attempt, files, row["timeout_s"], row["memory_mb"])

    def _next(self) -> Select[Any]:
        other = JOBS.alias()
        running = (
            select(func.count())
            .where(other.c.owner == JOBS.c.owner, other.c.state == "running")
            .scalar_subquery()
        )
        like = JOBS.alias()
        same = select(like.c.key).where(like.c.state == "running")
        beside = JOBS.alias()
        after = (
            select(ELEMENT_JOBS.c.job)
            .join_from(ELEMENT_JOBS, beside, ELEMENT_JOBS.c.like == beside.c.id)
            .where(beside.c.state.in_(OPEN))
        )
        seen = select(ELEMENT_JOBS.c.job).where(ELEMENT_JOBS.c.role != "panel")
        return (
            select(JOBS)
            .where(JOBS.c.state == "queued", JOBS.c.key.not_in(same), JOBS.c.id.not_in(after))
            .order_by(running, case((JOBS.c.id.in_(seen), 0), else_=1), JOBS.c.turn, JOBS.c.id)
            .limit(1)
            .with_for_update(of=JOBS, skip_locked=True)
        )

    def renew(self) -> None:
        """Hold on to this host's jobs. Raises ``SchemaVersionError`` where the tables have become those of a
        newer version."""
        mine = and_(JOBS.c.host == self._host, JOBS.c.state == "running")
        with self._database.write() as db:
            self._database.look(db)
            db.execute(update(JOBS).where(mine).values(lease=self._until()))

    def drop_others(self, held: Collection[str]) -> None:
        """Queue jobs that this host has by the store and does not plan: it failed as it took them. Such an
        attempt does not count."""
        mine = and_(JOBS.c.host == self._host, JOBS.c.state == "running", JOBS.c.id.not_in(held))
        with self._database.write() as db:
            for row in db.execute(select(JOBS).where(mine)).mappings().all():
                self._give_back(db, row["id"], row["attempts"] - 1, row["cancel"])

    def take_over(self, alone: bool = False) -> int:
        """Queue the jobs of hosts that are gone; ``alone``: no other host can be at work. Their number."""
        gone = and_(JOBS.c.state == "running", JOBS.c.host != self._host)
        if not alone:
            now, most = self._database.clock(), max(self._lease_s, LONGEST_LEASE_S)
            # a lease that ends later than any was given by a clock that has been set back since
            gone = and_(gone, or_(JOBS.c.lease < now, JOBS.c.lease > now + most))
        with self._database.write() as db:
            rows = db.execute(select(JOBS).where(gone).with_for_update(skip_locked=True)).mappings().all()
            for row in rows:
                self._give_back(db, row["id"], row["attempts"], row["cancel"])
        return len(rows)

    def give_back(self, claimed: Claimed) -> None:
        """Queue a job of this host again, because the service stops or has no room for its result; this
        attempt does not count."""
        with self._database.write() as db:
            if self._held(db, claimed):
                self._give_back(db, claimed.id, claimed.attempt - 1, 0)

    def _give_back(self, db: Connection, job: str, attempts: int, cancel: int) -> None:
        if cancel == DELETED:
            remove(db, job)
            return
        state: State = "queued"
        issues: tuple[Issue, ...] = ()
        if cancel:
            state = "cancelled"
        elif attempts >= MOST_ATTEMPTS:
            state = "crashed"
            message = (
                f"the service stopped {attempts} times while it planned this job, and does not try again"
            )
            issues = (Issue("service.gave_up", message, value=attempts, limit=MOST_ATTEMPTS),)
        values = {"state": state, "host": None, "lease": None, "stage": "", "fraction": 0.0}
        values["attempts"] = attempts
        if issues:
            values["issues"] = issues_json(issues)
            record_event(db, job, "issues", {"issues": [issue_json(issue) for issue in issues]})
        if state != "queued":
            values["finished"] = time.time()
            metrics.ended(state)
        db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
        record_event(db, job, "state", {"state": state})

    def cancelled(self) -> set[str]:
        """This host's jobs that are to stop."""
        asked = and_(JOBS.c.host == self._host, JOBS.c.state == "running", JOBS.c.cancel > 0)
        with self._database.read() as db:
            return set(db.execute(select(JOBS.c.id).where(asked)).scalars())

    def progress(self, claimed: Claimed, stage: str, fraction: float) -> None:
        """Tell how far a job is."""
        with self._database.write() as db:
            if self._held(db, claimed):
                values = {"stage": stage[:64], "fraction": fraction}
                db.execute(update(JOBS).where(JOBS.c.id == claimed.id).values(**values))
                record_event(db, claimed.id, "progress", {"stage": stage, "fraction": round(fraction, 4)})

    def found(self, claimed: Claimed, issues: Collection[Issue]) -> None:
        """Tell of issues as they appear."""
        with self._database.write() as db:
            if issues and self._held(db, claimed):
                record_event(db, claimed.id, "issues", {"issues": [issue_json(issue) for issue in issues]})

    def finish(
        self,
        claimed: Claimed,
        state: State,
        issues: tuple[Issue, ...],
        metrics: Mapping[str, float],
        seconds: float,
        files: Mapping[str, Blob],
    ) -> bool:
        """Store the end of a job, whole or not at all; False where the job is no longer this host's."""
        with self._database.write() as db:
            if not self._held(db, claimed):
                return False
            asked = db.execute(select(JOBS.c.cancel).where(JOBS.c.id == claimed.id)).scalar_one()
            if asked == DELETED:
                remove(db, claimed.id)
                return True
            values = {
                "state": state,
                "issues": issues_json(issues),
                "metrics": json.dumps(dict(metrics)),
                "seconds": seconds,
                "finished": time.time(),
                "host": None,
                "lease": None,
            }
            put_files(db, claimed.id, files)
            db.execute(update(JOBS).where(JOBS.c.id == claimed.id).values(**values))
            if issues:
                content = {"issues": [issue_json(issue) for issue in issues], "all": True}
                record_event(db, claimed.id, "issues", content)
            record_event(db, claimed.id, "state", {"state": state})
            return True

    def forget(self, older_s: float | None, audit_s: float | None = None) -> None:
        """Delete jobs that were finished so long ago, sessions that are over, old idempotency keys, and
        entries of the audit log that are older than ``audit_s``."""
        now = self._database.clock()
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.expires < now))
            idempotency.forget(self._database, db)
            webhooks.forget(self._database, db)
            if older_s is not None:
                old = and_(JOBS.c.state.not_in(OPEN), JOBS.c.finished < now - older_s)
                found = db.execute(select(JOBS.c.id).where(old).order_by(JOBS.c.id)).scalars().all()
                gone = [one for job in found for one in remove(db, job)]  # other hosts do the same
                for one in gone:  # behind: who writes entries waits for nothing else
                    said = {"name": one.name}
                    audit.note(self._database, db, one.owner, "deleted", one.id, said, audit.AGED)
            if audit_s is not None:
                audit.forget(self._database, db, audit_s)

    def _until(self) -> ColumnElement[float]:
        return self._database.clock() + self._lease_s

    def _held(self, db: Connection, claimed: Claimed) -> bool:
        mine = and_(
            JOBS.c.id == claimed.id,
            JOBS.c.state == "running",
            JOBS.c.host == self._host,
            JOBS.c.attempts == claimed.attempt,
        )
        return db.execute(select(JOBS.c.id).where(mine).with_for_update()).first() is not None


def _like(db: Connection, job: str) -> dict[str, Blob]:
    """What a panel begins with: the plan of the panel that it is like, or where that has none, of the one
    which that is like, and so on."""
    asked = select(ELEMENT_JOBS.c.like, JOBS.c.state).join_from(
        ELEMENT_JOBS, JOBS, ELEMENT_JOBS.c.like == JOBS.c.id
    )
    row = db.execute(asked.where(ELEMENT_JOBS.c.job == job)).first()
    while row is not None and row.state != "verified":
        row = db.execute(asked.where(ELEMENT_JOBS.c.job == row.like)).first()
    if row is None:
        return {}
    plan = ("plan.json", "plan.npz")
    return {
        f"problem/{LIKE}/{name}": blob
        for name, blob in job_files(db, row.like).items()
        if name in plan or name.startswith("problem/")
    }


LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
LISTEN_S: Final = 0.2
"""Time [s] for which events of the workers are waited for at once."""
ASK_S: Final = 0.5
"""Cancelled jobs, and jobs of other hosts, are looked for so often."""
PROGRESS_EVERY_S: Final = 0.5
"""Progress within a stage is told so often."""
SWEEP_S: Final = 600.0
"""Time [s] between two looks for what is old enough to be forgotten."""
JUMP_S: Final = 3600.0
"""A clock that has gone so much faster or slower than time [s] between two looks has jumped."""
STEADY_S: Final = 86400.0
"""Nothing is forgotten for so long [s] after a clock has jumped: by a wrong one all would be old."""
AGAIN_S: Final = 2.0
"""After an error of the database or the workers it is tried again so much later."""
ROOM_MB: Final = 32.0
"""With less room on the disk no job is begun."""
ROOM_S: Final = 20.0
"""After a job that found the disk full, none is begun for so long."""


def _of(claimed: Claimed) -> dict[str, Any]:
    return {"jobs": [claimed.id]}


class Team(Protocol):
    """What plans: :class:`planner.batch.workers.Workers`, or a cluster."""

    def start(self, job: Job, folder: Path) -> None: ...

    def cancel(self, name: str) -> bool: ...

    def events(self, timeout_s: float) -> Iterator[Event]: ...

    def close(self) -> None: ...


class Runner(threading.Thread):
    """Claims jobs, hands them to a team, stores what comes back. ``shas`` tells which files are wanted.
    It ends, and calls ``on_newer``, where the tables have become those of a newer version."""

    def __init__(
        self,
        work: Work,
        files: Files,
        make_team: Callable[[], Team],
        count: int,
        scratch: Path,
        *,
        lease_s: float,
        alone: bool,
        keep_s: float | None,
        audit_s: float | None,
        shas: Callable[[list[str]], set[str]],
        on_newer: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name="tandem-runner", daemon=True)
        self._work, self._files, self._make_team, self._count = work, files, make_team, count
        self._lease_s, self._alone, self._keep_s, self._shas = lease_s, alone, keep_s, shas
        self._scratch, self._audit_s, self._on_newer = scratch, audit_s, on_newer
        self._ending = threading.Event()
        self._claimed: dict[str, Claimed] = {}
        self._last_progress: dict[str, tuple[str, float]] = {}
        self._stages: dict[str, tuple[str, float]] = {}
        self._folders: dict[str, Path] = {}
        self._due: dict[str, float] = {}
        self._clock: tuple[float, float] | None = None
        self._steady_at = 0.0
        self.alive_at = time.monotonic()
        self._troubled = False
        self._room_at = 0.0

    @property
    def healthy(self) -> bool:
        """Whether it has come round lately, be it to find the database away."""
        return self.is_alive() and time.monotonic() - self.alive_at < max(30.0, self._lease_s)

    @property
    def working(self) -> bool:
        """Whether jobs are begun and their ends stored."""
        return self.healthy and not self._troubled

    def stop(self) -> None:
        """End the team; jobs that run wait again."""
        self._ending.set()
        if self.is_alive():
            self.join(30.0)

    def run(self) -> None:
        """Until :meth:`stop`; the team belongs to this thread."""
        team: Team | None = None
        while not self._ending.is_set():
            try:
                team = team or self._make_team()
                self._round(team)
                self._troubled = False
            except SchemaVersionError as error:
                LOG.error(
                    "the database %s. This host stops accepting requests and jobs. %s", error, error.remedy
                )
                self._claimed.clear()  # their leases come to an end, and a host that knows the tables goes on
                self._on_newer()
                break
            except TandemError:  # of the team: what it had under way nobody plans any more
                self._without(team)
                team = None
                self._wait_again("what plans is started anew in %g s", AGAIN_S)
            except (SQLAlchemyError, OSError):
                self._wait_again("the runner tries again in %g s", AGAIN_S)
        self._without(team)

    def _without(self, team: Team | None) -> None:
        """Let go of a team; what it had under way waits again."""
        if team is not None:
            team.close()
        for claimed in self._claimed.values():
            try:
                self._work.give_back(claimed)
            except SQLAlchemyError:
                LOG.exception("job %s waits until its lease is over", claimed.id, extra=_of(claimed))
        for folder in self._folders.values():
            shutil.rmtree(folder, ignore_errors=True)
        for known in (self._claimed, self._folders, self._last_progress, self._stages):
            known.clear()

    def _wait_again(self, what: str, told: object) -> None:
        LOG.exception(what, told)
        self._troubled = True
        self._ending.wait(AGAIN_S)
        self.alive_at = time.monotonic()

    def _round(self, team: Team) -> None:
        if self._is_due("lease", self._lease_s / 4):
            self._work.renew()
            self._work.drop_others([claimed.id for claimed in self._claimed.values()])
            if self._work.take_over(alone=self._alone):
                LOG.warning("jobs of a service that is gone wait again")
        if self._is_due("sweep", SWEEP_S):
            if self._is_steady():
                self._work.forget(self._keep_s, self._audit_s)
            self._files.sweep(self._shas)
        while len(self._claimed) < self._count and self._has_room():
            claimed = self._work.claim()
            if claimed is None:
                break
            self._begin(team, claimed)
        if self._claimed and self._is_due("cancel", ASK_S):
            for job in self._work.cancelled():
                names = [name for name, claimed in self._claimed.items() if claimed.id == job]
                for name in names:
                    team.cancel(name)
        for event in team.events(LISTEN_S):
            self._take(event)
        self.alive_at = time.monotonic()

    def _begin(self, team: Team, claimed: Claimed) -> None:
        name = f"{claimed.name}-{claimed.id[:12]}"
        prefix = "problem/"
        bundle = {
            file.removeprefix(prefix): self._files.read(blob.sha)
            for file, blob in claimed.files.items()
            if file.startswith(prefix)
        }
        folder = Path(tempfile.mkdtemp(dir=self._scratch, prefix="job-"))
        self._claimed[name], self._folders[name] = claimed, folder
        job = Job(name, bundle, timeout_s=claimed.timeout_s, memory_mb=claimed.memory_mb)
        LOG.info("job %s begins, attempt %d", claimed.id, claimed.attempt, extra=_of(claimed))
        team.start(job, folder / "result")

    def _take(self, event: Event) -> None:
        claimed = self._claimed.get(event.name)
        if claimed is None:
            return
        if isinstance(event, Progress):
            if self._stages.get(event.name, ("", 0.0))[0] != event.stage:
                self._stage_ended(event.name)
                self._stages[event.name] = (event.stage, time.monotonic())
            stage, at = self._last_progress.get(event.name, ("", 0.0))
            if event.stage != stage or time.monotonic() - at >= PROGRESS_EVERY_S:
                self._last_progress[event.name] = (event.stage, time.monotonic())
                self._work.progress(claimed, event.stage, event.fraction)
        elif isinstance(event, Found):
            self._work.found(claimed, self._told(event.issues))
        elif isinstance(event, Finished):
            self._finish(claimed, event.name, event.done)

    def _finish(self, claimed: Claimed, name: str, done: Done) -> None:
        """Store the end of a job, however long the database is away or its disk full."""
        folder = self._folders[name]
        while not self._ending.is_set():
            try:
                if any(issue.code == "output.disk_full" for issue in done.issues):
                    LOG.warning("job %s waits for room on the disk", claimed.id, extra=_of(claimed))
                    self._room_at = time.monotonic() + ROOM_S
                    self._work.give_back(claimed)
                    break
                stored, told = self._stored(folder / "result", done.state), self._told(done.issues)
                kept = self._work.finish(claimed, done.state, told, done.metrics, done.seconds, stored)
                if not kept:
                    what = "job %s was taken over; what was planned here is dropped"
                    LOG.warning(what, claimed.id, extra=_of(claimed))
                else:
                    LOG.info("job %s ended: %s", claimed.id, done.state, extra=_of(claimed))
                    self._stage_ended(name)
                    metrics.ended(done.state)
                break
            except (SQLAlchemyError, OSError):
                self._wait_again("the end of job %s cannot be stored now", claimed.id)
                with contextlib.suppress(SQLAlchemyError):
                    self._work.renew()
        else:
            return  # it is planned again
        del self._claimed[name], self._folders[name]
        self._last_progress.pop(name, None)
        self._stages.pop(name, None)
        shutil.rmtree(folder, ignore_errors=True)

    def _stage_ended(self, name: str) -> None:
        stage, began = self._stages.pop(name, ("", 0.0))
        if stage:
            metrics.staged(stage, time.monotonic() - began)

    def _told(self, issues: Collection[Issue]) -> tuple[Issue, ...]:
        """Without where on this host it was: users have no use for that, and others might."""

        def without(text: str) -> str:
            return text.replace(str(self._scratch), "the service's folder")

        return tuple(
            dataclasses.replace(
                one,
                message=without(one.message),
                file=one.file and without(one.file),
                hint=one.hint and without(one.hint),
            )
            for one in issues
        )

    def _has_room(self) -> bool:
        free = shutil.disk_usage(self._scratch).free
        return free >= ROOM_MB * MB and time.monotonic() >= self._room_at

    def _stored(self, result: Path, state: State) -> dict[str, Blob]:
        small = thumbnail(result / "report.html") if state == "verified" else None
        if small is not None:  # lists show the outcome of the others alone
            (result / THUMBNAIL).write_bytes(small)
        paths = sorted(path for path in result.rglob("*") if path.is_file() and not path.is_symlink())
        return {path.relative_to(result).as_posix(): self._files.put_file(path) for path in paths}

    def _is_steady(self) -> bool:
        """Whether the clock has not jumped lately; not known at first: machines set it after they start."""
        boot, clock = time.clock_gettime(time.CLOCK_BOOTTIME), time.time()  # it goes on in suspended machines
        before, self._clock = self._clock, (boot, clock)
        if before is not None and abs((clock - before[1]) - (boot - before[0])) > JUMP_S:
            LOG.warning("the clock has jumped; nothing is forgotten by its age for a day")
            self._steady_at = boot + STEADY_S
        return before is not None and boot >= self._steady_at

    def _is_due(self, what: str, every_s: float) -> bool:
        now = time.monotonic()
        if now < self._due.get(what, 0.0):
            return False
        self._due[what] = now + every_s
        return True
