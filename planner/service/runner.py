"""Planning of the queued jobs: hosts claim jobs for a limited time and plan them on worker processes.

A host holds a job by a lease that it renews. If the host fails, another one takes its jobs over. Every
change first checks that the job is still held, so that a host that was given up changes nothing. One thread
plans as many jobs at once as there are worker processes.
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

from planner.batch.job import (
    REFERENCE_FOLDER,
    BatchJob,
    JobEvent,
    JobFinished,
    JobIssues,
    JobProgress,
    JobResult,
)
from planner.files import THUMBNAIL
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError
from planner.report.thumbnail import thumbnail
from planner.service import audit, idempotency, metrics, webhooks
from planner.service.jobs import (
    FROM_STORE,
    answer_from_store,
    delete_job,
    issues_json,
    job_files,
    put_files,
    record_event,
)
from planner.service.models import DELETED, ELEMENT_JOBS, JOBS, OPEN_STATES, SESSIONS, Database, State
from planner.service.schema import SchemaVersionError
from planner.service.security import MB, issue_json
from planner.service.storage import Blob, ContentStore

MAX_LEASE_S: Final = 86400.0
"""Maximum remaining time [s] of a lease.

A longer lease was written by a clock that has been set back since.
"""
MAX_ATTEMPTS: Final = 3
"""Number of times that a host may fail while it plans a job, before the job is taken to be the cause."""


@dataclasses.dataclass(frozen=True)
class ClaimedJob:
    """A job that this host plans.

    Attributes:
        id: Id of the job.
        name: Name of the problem.
        attempt: Number of the attempt, from 1.
        files: Files by name.
        timeout_s: Time limit [s].
        memory_mb: Memory limit [MB].
    """

    id: str
    name: str
    attempt: int
    files: Mapping[str, Blob]
    timeout_s: float
    memory_mb: float


class JobQueue:
    """Queue of the jobs of one database, for one host."""

    def __init__(self, database: Database, host: str, lease_s: float) -> None:
        self._database, self._host, self._lease_s = database, host, lease_s

    @property
    def lease_s(self) -> float:
        """Duration of the leases [s]."""
        return self._lease_s

    def claim(self) -> ClaimedJob | None:
        """Claim the next queued job for this host. Returns None if there is none.

        Owners with fewer running jobs come first, then divisions and reports of elements, because somebody
        waits for them, then jobs by turn. A job waits while an identical one is running, and gets the answer
        of an identical one that has ended. A panel waits for the panel whose plan is its reference plan.
        """
        # Most polls find an empty queue. A read-only query for that does not block the writers.
        waiting = select(JOBS.c.id).where(JOBS.c.state == "queued").limit(1)
        while True:
            with self._database.read() as db:
                if db.execute(waiting).first() is None:
                    return None
            with self._database.write() as db:
                row = db.execute(self._next_query()).mappings().first()
                if row is None:
                    return None
                job = row["id"]
                if answer_from_store(db, job, row["key"]):
                    metrics.count_outcome(
                        db.execute(select(JOBS.c.state).where(JOBS.c.id == job)).scalar_one(), FROM_STORE
                    )
                    continue
                attempt = row["attempts"] + 1
                db.execute(
                    update(JOBS)
                    .where(JOBS.c.id == job)
                    .values(
                        state="running",
                        host=self._host,
                        lease=self._lease_end(),
                        attempts=attempt,
                        started=time.time(),
                        stage="",
                        fraction=0.0,
                    )
                )
                record_event(db, job, "state", {"state": "running", "attempt": attempt})
                files = {**job_files(db, job), **_reference_files(db, job)}
                metrics.observe_wait(time.time() - row["created"])
                return ClaimedJob(job, row["name"], attempt, files, row["timeout_s"], row["memory_mb"])

    def _next_query(self) -> Select[Any]:
        """Return the query of the next job to claim, as :meth:`claim` orders them. It locks the row."""
        other = JOBS.alias()
        running = (
            select(func.count())
            .where(other.c.owner == JOBS.c.owner, other.c.state == "running")
            .scalar_subquery()
        )
        identical = JOBS.alias()
        running_keys = select(identical.c.key).where(identical.c.state == "running")
        reference = JOBS.alias()
        waiting_panels = (
            select(ELEMENT_JOBS.c.job)
            .join_from(ELEMENT_JOBS, reference, ELEMENT_JOBS.c.like == reference.c.id)
            .where(reference.c.state.in_(OPEN_STATES))
        )
        prioritised = select(ELEMENT_JOBS.c.job).where(ELEMENT_JOBS.c.role != "panel")
        return (
            select(JOBS)
            .where(
                JOBS.c.state == "queued", JOBS.c.key.not_in(running_keys), JOBS.c.id.not_in(waiting_panels)
            )
            .order_by(running, case((JOBS.c.id.in_(prioritised), 0), else_=1), JOBS.c.turn, JOBS.c.id)
            .limit(1)
            .with_for_update(of=JOBS, skip_locked=True)
        )

    def renew(self) -> None:
        """Renew the leases of this host.

        Raises:
            SchemaVersionError: The tables have a newer version.
        """
        mine = and_(JOBS.c.host == self._host, JOBS.c.state == "running")
        with self._database.write() as db:
            self._database.check_version(db)
            db.execute(update(JOBS).where(mine).values(lease=self._lease_end()))

    def requeue_unplanned(self, held: Collection[str]) -> None:
        """Queue jobs again that the store assigns to this host although it does not plan them.

        This happens if the host fails while it claims a job. Such an attempt does not count.

        Args:
            held: Ids of the jobs that this host plans.
        """
        mine = and_(JOBS.c.host == self._host, JOBS.c.state == "running", JOBS.c.id.not_in(held))
        with self._database.write() as db:
            for row in db.execute(select(JOBS).where(mine)).mappings().all():
                self._requeue(db, row["id"], row["attempts"] - 1, row["cancel"])

    def requeue_orphans(self, alone: bool = False) -> int:
        """Queue the jobs of failed hosts again.

        Args:
            alone: No other host can be running, so that the leases of others need not expire first.

        Returns:
            Number of jobs.
        """
        orphans = and_(JOBS.c.state == "running", JOBS.c.host != self._host)
        if not alone:
            now, max_lease = self._database.clock(), max(self._lease_s, MAX_LEASE_S)
            # a lease beyond the maximum was written by a clock that has been set back since
            orphans = and_(orphans, or_(JOBS.c.lease < now, JOBS.c.lease > now + max_lease))
        with self._database.write() as db:
            rows = db.execute(select(JOBS).where(orphans).with_for_update(skip_locked=True)).mappings().all()
            for row in rows:
                self._requeue(db, row["id"], row["attempts"], row["cancel"])
        return len(rows)

    def requeue(self, claimed: ClaimedJob) -> None:
        """Queue a job of this host again, because the service stops or the disk is full.

        The attempt does not count.
        """
        with self._database.write() as db:
            if self._is_held(db, claimed):
                self._requeue(db, claimed.id, claimed.attempt - 1, 0)

    def _requeue(self, db: Connection, job: str, attempts: int, cancel: int) -> None:
        """End the attempt at a running job: queue, cancel or delete it, or give it up as crashed.

        Args:
            db: Open write transaction.
            job: Id of the job.
            attempts: Number of attempts that count.
            cancel: Column ``cancel`` of the job, 0 if its owner has not cancelled it.
        """
        if cancel == DELETED:
            delete_job(db, job)
            return
        state: State = "queued"
        issues: tuple[Issue, ...] = ()
        if cancel:
            state = "cancelled"
        elif attempts >= MAX_ATTEMPTS:
            state = "crashed"
            message = format_message("service.gave_up", attempt_count=attempts)
            issues = (Issue("service.gave_up", message, value=attempts, limit=MAX_ATTEMPTS),)
        values = {"state": state, "host": None, "lease": None, "stage": "", "fraction": 0.0}
        values["attempts"] = attempts
        if issues:
            values["issues"] = issues_json(issues)
            record_event(db, job, "issues", {"issues": [issue_json(issue) for issue in issues]})
        if state != "queued":
            values["finished"] = time.time()
            metrics.count_outcome(state)
        db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
        record_event(db, job, "state", {"state": state})

    def cancelled(self) -> set[str]:
        """Return the ids of this host's jobs that must stop."""
        cancel_filter = and_(JOBS.c.host == self._host, JOBS.c.state == "running", JOBS.c.cancel > 0)
        with self._database.read() as db:
            return set(db.execute(select(JOBS.c.id).where(cancel_filter)).scalars())

    def record_progress(self, claimed: ClaimedJob, stage: str, fraction: float) -> None:
        """Record the progress of a job.

        Args:
            claimed: Job.
            stage: Present stage.
            fraction: Completed fraction of the stage.
        """
        with self._database.write() as db:
            if self._is_held(db, claimed):
                values = {"stage": stage[:64], "fraction": fraction}
                db.execute(update(JOBS).where(JOBS.c.id == claimed.id).values(**values))
                record_event(db, claimed.id, "progress", {"stage": stage, "fraction": round(fraction, 4)})

    def record_issues(self, claimed: ClaimedJob, issues: Collection[Issue]) -> None:
        """Record new issues of a running job."""
        with self._database.write() as db:
            if issues and self._is_held(db, claimed):
                record_event(db, claimed.id, "issues", {"issues": [issue_json(issue) for issue in issues]})

    def finish(
        self,
        claimed: ClaimedJob,
        state: State,
        issues: tuple[Issue, ...],
        metrics: Mapping[str, float],
        seconds: float,
        files: Mapping[str, Blob],
    ) -> bool:
        """Store the end of a job, whole or not at all.

        Args:
            claimed: Job.
            state: Final state.
            issues: All issues.
            metrics: Metrics.
            seconds: Planning time [s].
            files: Result files by name.

        Returns:
            False if this host no longer holds the job.
        """
        with self._database.write() as db:
            if not self._is_held(db, claimed):
                return False
            cancel_state = db.execute(select(JOBS.c.cancel).where(JOBS.c.id == claimed.id)).scalar_one()
            if cancel_state == DELETED:
                delete_job(db, claimed.id)
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

    def delete_old(self, older_s: float | None, audit_s: float | None = None) -> None:
        """Delete old jobs, expired sessions, old idempotency keys and old entries of the audit log.

        Args:
            older_s: Minimum age [s] of deleted jobs, or None to keep all.
            audit_s: Minimum age [s] of deleted audit entries, or None to keep all.
        """
        now = self._database.clock()
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.expires < now))
            idempotency.delete_old_keys(self._database, db)
            webhooks.drop_old_deliveries(self._database, db)
            if older_s is not None:
                old = and_(JOBS.c.state.not_in(OPEN_STATES), JOBS.c.finished < now - older_s)
                old_jobs = db.execute(select(JOBS.c.id).where(old).order_by(JOBS.c.id)).scalars().all()
                # Another host may delete the same jobs. Only those that this host deleted are recorded.
                deleted_jobs = [deleted for job in old_jobs for deleted in delete_job(db, job)]
                for deleted in deleted_jobs:  # last, because audit entries take a lock until the end
                    details = {"name": deleted.name}
                    event = audit.AuditEvent("deleted", deleted.id, details)
                    audit.record_act(self._database, db, deleted.owner, event, audit.DELETED_BY_AGE)
            if audit_s is not None:
                audit.delete_old_entries(self._database, db, audit_s)

    def _lease_end(self) -> ColumnElement[float]:
        return self._database.clock() + self._lease_s

    def _is_held(self, db: Connection, claimed: ClaimedJob) -> bool:
        """Report whether this host still holds a job in the same attempt. Locks the row of the job."""
        mine = and_(
            JOBS.c.id == claimed.id,
            JOBS.c.state == "running",
            JOBS.c.host == self._host,
            JOBS.c.attempts == claimed.attempt,
        )
        return db.execute(select(JOBS.c.id).where(mine).with_for_update()).first() is not None


def _reference_files(db: Connection, job: str) -> dict[str, Blob]:
    """Return problem and plan of the job whose plan is the reference plan of a panel, as input files.

    If that job is not verified, its own reference plan is used instead, and so on. The result is empty if
    none is verified, or if the job has no reference plan.
    """
    query = select(ELEMENT_JOBS.c.like, JOBS.c.state).join_from(
        ELEMENT_JOBS, JOBS, ELEMENT_JOBS.c.like == JOBS.c.id
    )
    row = db.execute(query.where(ELEMENT_JOBS.c.job == job)).first()
    while row is not None and row.state != "verified":
        row = db.execute(query.where(ELEMENT_JOBS.c.job == row.like)).first()
    if row is None:
        return {}
    plan_files = ("plan.json", "plan.npz")
    return {
        f"problem/{REFERENCE_FOLDER}/{name}": blob
        for name, blob in job_files(db, row.like).items()
        if name in plan_files or name.startswith("problem/")
    }


LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
EVENT_WAIT_S: Final = 0.2
"""Time [s] of one wait for events of the workers."""
CANCEL_POLL_S: Final = 0.5
"""Interval [s] of queries for cancelled jobs."""
MIN_PROGRESS_INTERVAL_S: Final = 0.5
"""Minimum interval [s] of progress records within a stage."""
SWEEP_INTERVAL_S: Final = 600.0
"""Interval [s] of the deletion of old data."""
CLOCK_JUMP_S: Final = 3600.0
"""Difference [s] between clock and elapsed time above which the clock has jumped."""
CLOCK_SETTLE_S: Final = 86400.0
"""Time [s] after a jump of the clock in which nothing is deleted by age.

By a clock that runs ahead, new entries seem old.
"""
RETRY_WAIT_S: Final = 2.0
"""Time [s] to wait after an error of the database or the workers."""
MIN_FREE_MB: Final = 32.0
"""Minimum free disk space [MB] for starting a job."""
DISK_FULL_PAUSE_S: Final = 20.0
"""Time [s] in which no job starts after one has found the disk full."""


def _job_extra(claimed: ClaimedJob) -> dict[str, Any]:
    return {"jobs": [claimed.id]}


class WorkerPool(Protocol):
    """Interface of the workers: :class:`planner.batch.workers.BatchWorkers`, or a cluster."""

    def start(self, job: BatchJob, folder: Path) -> None:
        """Start a job that writes its result to a folder."""

    def cancel(self, name: str) -> bool:
        """Cancel a job, and return whether it was known."""

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        """Yield what happens to jobs; wait up to ``timeout_s`` for the first event."""

    def close(self) -> None:
        """Stop all workers and cancel their jobs."""


@dataclasses.dataclass(frozen=True)
class WorkerSetup:
    """Worker processes of a runner.

    Attributes:
        make_pool: Factory of the workers.
        count: Number of worker processes.
        scratch: Folder for work in progress.
    """

    make_pool: Callable[[], WorkerPool]
    count: int
    scratch: Path


@dataclasses.dataclass(frozen=True)
class RetentionPolicy:
    """What a runner keeps, and how long.

    Attributes:
        keep_s: Age [s] at which ended jobs are deleted, or None.
        audit_s: Age [s] at which audit entries are deleted, or None.
        used_shas: Function that returns those of some hashes that a job or draft references. Other files are
            deleted.
    """

    keep_s: float | None
    audit_s: float | None
    used_shas: Callable[[list[str]], set[str]]


class JobRunner(threading.Thread):
    """Thread that claims jobs, hands them to workers and stores the results.

    It ends if the tables have been changed to a newer version.

    Args:
        work: Queue.
        files: Stored files.
        workers: Worker processes.
        retention: What is kept, and how long.
        alone: No other host uses the database.
        on_newer: Called when the tables have a newer version.
    """

    def __init__(
        self,
        work: JobQueue,
        files: ContentStore,
        workers: WorkerSetup,
        retention: RetentionPolicy,
        *,
        alone: bool,
        on_newer: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name="tandem-runner", daemon=True)
        self._work, self._files, self._workers, self._retention = work, files, workers, retention
        self._alone, self._on_newer = alone, on_newer
        self._ending = threading.Event()
        self._claimed: dict[str, ClaimedJob] = {}
        self._last_progress: dict[str, tuple[str, float]] = {}
        self._stages: dict[str, tuple[str, float]] = {}
        self._folders: dict[str, Path] = {}
        self._due: dict[str, float] = {}
        self._clock: tuple[float, float] | None = None
        self._clock_trusted_at = 0.0
        self.alive_at = time.monotonic()
        self._has_failed = False
        self._start_allowed_at = 0.0

    @property
    def healthy(self) -> bool:
        """Whether the thread has completed a cycle lately, even if the database is unavailable."""
        return self.is_alive() and time.monotonic() - self.alive_at < max(30.0, self._work.lease_s)

    @property
    def working(self) -> bool:
        """Whether jobs are started and their results stored."""
        return self.healthy and not self._has_failed

    def stop(self) -> None:
        """Stop the workers. Running jobs are queued again."""
        self._ending.set()
        if self.is_alive():
            self.join(30.0)

    def run(self) -> None:
        """Plan jobs until :meth:`stop`. The workers belong to this thread."""
        pool: WorkerPool | None = None
        while not self._ending.is_set():
            try:
                pool = pool or self._workers.make_pool()
                self._run_cycle(pool)
                self._has_failed = False
            except SchemaVersionError as error:
                LOG.error(
                    "the database %s. This host stops accepting requests and jobs. %s", error, error.remedy
                )
                self._claimed.clear()  # their leases expire, and a host of the newer version takes them over
                self._on_newer()
                break
            except TandemError:  # the workers failed with all jobs that they were planning
                self._close_pool(pool)
                pool = None
                self._log_and_wait("the workers are restarted in %g s", RETRY_WAIT_S)
            except (SQLAlchemyError, OSError):
                self._log_and_wait("the runner tries again in %g s", RETRY_WAIT_S)
        self._close_pool(pool)

    def _close_pool(self, pool: WorkerPool | None) -> None:
        """Close the workers and queue their jobs again."""
        if pool is not None:
            pool.close()
        for claimed in self._claimed.values():
            try:
                self._work.requeue(claimed)
            except SQLAlchemyError:
                LOG.exception("job %s waits until its lease expires", claimed.id, extra=_job_extra(claimed))
        for folder in self._folders.values():
            shutil.rmtree(folder, ignore_errors=True)
        for by_name in (self._claimed, self._folders, self._last_progress, self._stages):
            by_name.clear()

    def _log_and_wait(self, message: str, argument: object) -> None:
        LOG.exception(message, argument)
        self._has_failed = True
        self._ending.wait(RETRY_WAIT_S)
        self.alive_at = time.monotonic()

    def _run_cycle(self, pool: WorkerPool) -> None:
        """Do what is due: renew leases, delete old data, start jobs, cancel jobs and handle events."""
        if self._is_due("lease", self._work.lease_s / 4):
            self._work.renew()
            self._work.requeue_unplanned([claimed.id for claimed in self._claimed.values()])
            if self._work.requeue_orphans(alone=self._alone):
                LOG.warning("jobs of a failed host are queued again")
        if self._is_due("sweep", SWEEP_INTERVAL_S):
            if self._is_clock_steady():
                self._work.delete_old(self._retention.keep_s, self._retention.audit_s)
            self._files.sweep(self._retention.used_shas)
        while len(self._claimed) < self._workers.count and self._has_disk_space():
            claimed = self._work.claim()
            if claimed is None:
                break
            self._start_job(pool, claimed)
        if self._claimed and self._is_due("cancel", CANCEL_POLL_S):
            for job in self._work.cancelled():
                names = [name for name, claimed in self._claimed.items() if claimed.id == job]
                for name in names:
                    pool.cancel(name)
        for event in pool.events(EVENT_WAIT_S):
            self._handle_event(event)
        self.alive_at = time.monotonic()

    def _start_job(self, pool: WorkerPool, claimed: ClaimedJob) -> None:
        """Hand a claimed job with its input files to the workers, under a name that is unique among them."""
        name = f"{claimed.name}-{claimed.id[:12]}"
        prefix = "problem/"
        bundle = {
            file.removeprefix(prefix): self._files.read(blob.sha)
            for file, blob in claimed.files.items()
            if file.startswith(prefix)
        }
        folder = Path(tempfile.mkdtemp(dir=self._workers.scratch, prefix="job-"))
        self._claimed[name], self._folders[name] = claimed, folder
        job = BatchJob(name, bundle, timeout_s=claimed.timeout_s, memory_mb=claimed.memory_mb)
        LOG.info("job %s starts, attempt %d", claimed.id, claimed.attempt, extra=_job_extra(claimed))
        pool.start(job, folder / "result")

    def _handle_event(self, event: JobEvent) -> None:
        """Store what a worker reports about a job. Progress within a stage is stored at intervals only."""
        claimed = self._claimed.get(event.name)
        if claimed is None:
            return
        if isinstance(event, JobProgress):
            if self._stages.get(event.name, ("", 0.0))[0] != event.stage:
                self._stage_ended(event.name)
                self._stages[event.name] = (event.stage, time.monotonic())
            stage, recorded_at = self._last_progress.get(event.name, ("", 0.0))
            if event.stage != stage or time.monotonic() - recorded_at >= MIN_PROGRESS_INTERVAL_S:
                self._last_progress[event.name] = (event.stage, time.monotonic())
                self._work.record_progress(claimed, event.stage, event.fraction)
        elif isinstance(event, JobIssues):
            self._work.record_issues(claimed, self._without_paths(event.issues))
        elif isinstance(event, JobFinished):
            self._finish(claimed, event.name, event.done)

    def _finish(self, claimed: ClaimedJob, name: str, result: JobResult) -> None:
        """Store the end of a job. While the database is unavailable, this is tried again.

        If the disk was full during planning, the job is queued again instead.

        Args:
            claimed: Job.
            name: Name of the job among the workers.
            result: State, issues and metrics. The result files are in the folder of the job.
        """
        folder = self._folders[name]
        while not self._ending.is_set():
            try:
                if any(issue.code == "output.disk_full" for issue in result.issues):
                    LOG.warning("job %s waits for disk space", claimed.id, extra=_job_extra(claimed))
                    self._start_allowed_at = time.monotonic() + DISK_FULL_PAUSE_S
                    self._work.requeue(claimed)
                    break
                stored = self._store_results(folder / "result", result.state)
                issues = self._without_paths(result.issues)
                was_held = self._work.finish(
                    claimed, result.state, issues, result.metrics, result.seconds, stored
                )
                if not was_held:
                    message = "job %s was taken over by another host, its result is dropped"
                    LOG.warning(message, claimed.id, extra=_job_extra(claimed))
                else:
                    LOG.info("job %s ended: %s", claimed.id, result.state, extra=_job_extra(claimed))
                    self._stage_ended(name)
                    metrics.count_outcome(result.state)
                break
            except (SQLAlchemyError, OSError):
                self._log_and_wait("the end of job %s cannot be stored now", claimed.id)
                with contextlib.suppress(SQLAlchemyError):
                    self._work.renew()
        else:
            return  # the service stops, and the job is planned again
        del self._claimed[name], self._folders[name]
        self._last_progress.pop(name, None)
        self._stages.pop(name, None)
        shutil.rmtree(folder, ignore_errors=True)

    def _stage_ended(self, name: str) -> None:
        """Record the duration of the present stage of a job in the metrics."""
        stage, started_at = self._stages.pop(name, ("", 0.0))
        if stage:
            metrics.observe_stage(stage, time.monotonic() - started_at)

    def _without_paths(self, issues: Collection[Issue]) -> tuple[Issue, ...]:
        """Remove paths of this host from issues. Users have no use for them, and attackers might."""

        def hide_folder(text: str) -> str:
            return text.replace(str(self._workers.scratch), "the service's folder")

        return tuple(
            dataclasses.replace(
                issue,
                message=hide_folder(issue.message),
                file=issue.file and hide_folder(issue.file),
                hint=issue.hint and hide_folder(issue.hint),
            )
            for issue in issues
        )

    def _has_disk_space(self) -> bool:
        free = shutil.disk_usage(self._workers.scratch).free
        return free >= MIN_FREE_MB * MB and time.monotonic() >= self._start_allowed_at

    def _store_results(self, result: Path, state: State) -> dict[str, Blob]:
        """Store the files of a result folder, with a thumbnail if the job is verified."""
        image = thumbnail(result / "report.html") if state == "verified" else None
        if image is not None:  # lists show thumbnails of verified jobs only
            (result / THUMBNAIL).write_bytes(image)
        paths = sorted(path for path in result.rglob("*") if path.is_file() and not path.is_symlink())
        return {path.relative_to(result).as_posix(): self._files.put_file(path) for path in paths}

    def _is_clock_steady(self) -> bool:
        """Report whether the clock has not jumped in the last `CLOCK_SETTLE_S`.

        The first call returns False, because machines set their clock after they start.
        """
        boot, clock = time.clock_gettime(time.CLOCK_BOOTTIME), time.time()  # boot time includes suspension
        previous, self._clock = self._clock, (boot, clock)
        if previous is not None and abs((clock - previous[1]) - (boot - previous[0])) > CLOCK_JUMP_S:
            LOG.warning("the clock has jumped, nothing is deleted by age for a day")
            self._clock_trusted_at = boot + CLOCK_SETTLE_S
        return previous is not None and boot >= self._clock_trusted_at

    def _is_due(self, action: str, every_s: float) -> bool:
        """Report whether an action is due again, and if so, schedule the next time in ``every_s`` [s]."""
        now = time.monotonic()
        if now < self._due.get(action, 0.0):
            return False
        self._due[action] = now + every_s
        return True
