"""Jobs in the store, as the hosts that plan them see them: claimed for a time, told about, finished once.

A host holds a job by a lease that it renews; when a host is gone, another one takes its jobs over. Every
change asks whether the job is still held, so that a host that was given up changes nothing.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Collection, Mapping
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Select, and_, delete, func, select, update

from planner.issues import Issue
from planner.service.database import Database
from planner.service.files import Blob
from planner.service.jobs import (
    DELETED,
    answer_from_store,
    issues_json,
    job_files,
    note,
    put_files,
    remove,
)
from planner.service.models import OPEN, State
from planner.service.refusals import plain
from planner.service.tables import JOBS, SESSIONS

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

        Owners with fewer running jobs come first, then the older job. A job whose like is running waits, and
        one whose like is done gets that answer.
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
                note(db, job, "state", {"state": "running", "attempt": attempt})
                files = job_files(db, job)
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
        return (
            select(JOBS)
            .where(JOBS.c.state == "queued", JOBS.c.key.not_in(same))
            .order_by(running, JOBS.c.created, JOBS.c.id)
            .limit(1)
            .with_for_update(of=JOBS, skip_locked=True)
        )

    def renew(self) -> None:
        """Hold on to this host's jobs."""
        mine = and_(JOBS.c.host == self._host, JOBS.c.state == "running")
        with self._database.write() as db:
            db.execute(update(JOBS).where(mine).values(lease=self._until()))

    def take_over(self, alone: bool = False) -> int:
        """Queue the jobs of hosts that are gone; ``alone``: no other host can be at work. Their number."""
        gone = and_(JOBS.c.state == "running", JOBS.c.host != self._host)
        if not alone:
            gone = and_(gone, JOBS.c.lease < self._database.clock())
        with self._database.write() as db:
            rows = db.execute(select(JOBS).where(gone).with_for_update(skip_locked=True)).mappings().all()
            for row in rows:
                self._give_back(db, row["id"], row["attempts"], row["cancel"])
        return len(rows)

    def give_back(self, claimed: Claimed) -> None:
        """Queue a job of this host again, because the service stops; this attempt does not count."""
        with self._database.write() as db:
            if self._held(db, claimed):
                db.execute(update(JOBS).where(JOBS.c.id == claimed.id).values(attempts=claimed.attempt - 1))
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
        if issues:
            values["issues"] = issues_json(issues)
            note(db, job, "issues", {"issues": [plain(issue) for issue in issues]})
        if state != "queued":
            values["finished"] = time.time()
        db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
        note(db, job, "state", {"state": state})

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
                note(db, claimed.id, "progress", {"stage": stage, "fraction": round(fraction, 4)})

    def found(self, claimed: Claimed, issues: Collection[Issue]) -> None:
        """Tell of issues as they appear."""
        with self._database.write() as db:
            if issues and self._held(db, claimed):
                note(db, claimed.id, "issues", {"issues": [plain(issue) for issue in issues]})

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
                told = {"issues": [plain(issue) for issue in issues], "all": True}
                note(db, claimed.id, "issues", told)
            note(db, claimed.id, "state", {"state": state})
            return True

    def forget(self, older_s: float | None) -> None:
        """Delete jobs that were finished so long ago, and sessions that are over."""
        now = time.time()
        with self._database.write() as db:
            db.execute(delete(SESSIONS).where(SESSIONS.c.expires < now))
            if older_s is not None:
                old = and_(JOBS.c.state.not_in(OPEN), JOBS.c.finished < now - older_s)
                for job in db.execute(select(JOBS.c.id).where(old)).scalars().all():
                    remove(db, job)

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
