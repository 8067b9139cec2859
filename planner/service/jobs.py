"""Jobs in the store, as the API sees them: made, found, listed, cancelled, deleted; their events.

Events come as they happen, for any number of listeners: one question to the store for all of them.
"""

import asyncio
import contextlib
import dataclasses
import json
import secrets
import time
from bisect import bisect_left
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence, Set
from typing import Any, Final, NamedTuple

import anyio.to_thread
from sqlalchemy import (
    Connection,
    RowMapping,
    Select,
    and_,
    delete,
    exists,
    func,
    insert,
    not_,
    or_,
    select,
    union,
    update,
)
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from planner.files import THUMBNAIL
from planner.issues import Issue
from planner.service import audit, finding, idempotency, metrics, webhooks
from planner.service.finding import Wanted
from planner.service.idempotency import Once
from planner.service.logs import about
from planner.service.models import (
    CANCELLED,
    DELETED,
    DRAFTS,
    ELEMENT_JOBS,
    EVENTS,
    FILES,
    JOBS,
    KEYS,
    LINKS,
    MARKS,
    OPEN,
    RELEASES,
    SETTLED,
    TOKENS,
    Act,
    Database,
    JobOut,
    Release,
    Role,
    Withdrawal,
    utc,
)
from planner.service.security import LOCAL, Auth, Limits, RefusedError, issue_json, too_many, unknown_job
from planner.service.storage import Blob

STORE: Final = "store"
"""Source of the outcome of a job that was answered from the store."""
AGAIN: Final = ("crashed", "timeout", "memory", "cancelled")
"""States of jobs that may end otherwise when they are planned again."""


@dataclasses.dataclass(frozen=True)
class OfElement:
    """What a job is to an ``element``, by its id, none for a division, which is one; ``panel``, ``like`` and
    ``about`` as the store has them."""

    role: Role
    element: str | None = None
    panel: str = ""
    like: str | None = None
    about: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class NewJob:
    """What a job is made of: ``files`` by the names of a result folder; its answer depends on ``key``. Its
    ``id`` is made where none is given."""

    owner: str
    name: str
    digest: str
    key: str
    processes: tuple[str, ...]
    files: Mapping[str, Blob]
    timeout_s: float
    memory_mb: float
    issues: tuple[Issue, ...] = ()
    of: OfElement | None = None
    title: str = ""
    tags: tuple[str, ...] = ()
    notes: str = ""
    id: str = dataclasses.field(default_factory=lambda: secrets.token_hex(16))


class Jobs:
    """The jobs of one database."""

    def __init__(self, database: Database, limits: Limits) -> None:
        self._database, self._limits = database, limits

    def create(self, new: NewJob, once: Once | None = None) -> JobOut:
        """Store a job; one whose problem was planned before has its answer at once. The job of a request that
        was done ``once`` is that one.

        Raises :class:`RefusedError`, 422 for a key of another request, 429 where the owner has too many.
        """
        return self.create_all([new], once)[0]

    def create_all(self, jobs: Sequence[NewJob], once: Once | None = None) -> list[JobOut]:
        """Store jobs of one owner, all or none; panels count as one job for each element. Raises as
        :meth:`create`."""
        with self._database.write() as db:
            self._database.one_at_a_time(db, jobs[0].owner)
            known = self._made(db, once)
            if known:
                return known
            self._allow(db, jobs)
            created = [self._created(db, new) for new in jobs]
            if once is not None:
                idempotency.keep(self._database, db, once, [job.id for job in created])
            for job in created:
                said = {"name": job.name, "digest": job.digest}
                audit.note(self._database, db, jobs[0].owner, "submitted", job.id, said)
        about(*(job.id for job in created))
        for job in created:
            if job.from_store:
                metrics.ended(job.state, STORE)
        return created

    def made(self, once: Once | None) -> list[JobOut]:
        """The jobs, as they are now, that a request made which is to be done ``once``; empty where it made
        none yet. Raises :class:`RefusedError`, 422."""
        if once is None:
            return []
        with self._database.read() as db:
            return self._made(db, once)

    def _made(self, db: Connection, once: Once | None) -> list[JobOut]:
        known = [] if once is None else idempotency.made(db, once)
        about(*known)
        return [job_out(job_row(db, job), self._ahead(db, job)) for job in known]

    def _created(self, db: Connection, new: NewJob) -> JobOut:
        job, now = new.id, time.time()
        row = {
            "id": job,
            "owner": new.owner,
            "name": new.name,
            "digest": new.digest,
            "key": new.key,
            "processes": json.dumps(new.processes),
            "state": "queued",
            "created": now,
            "turn": now,
            "timeout_s": new.timeout_s,
            "memory_mb": new.memory_mb,
            "issues": issues_json(new.issues),
            **finding.described(new.name, new.title, new.tags, new.notes),
        }
        db.execute(insert(JOBS).values(row))
        put_files(db, job, new.files)
        if new.of is not None:
            kept = {"element": new.of.element or job, "role": new.of.role, "panel": new.of.panel}
            about = {"like": new.of.like, "about": json.dumps(new.of.about)}
            db.execute(insert(ELEMENT_JOBS).values({"job": job, **kept, **about}))
        record_event(db, job, "state", {"state": "queued"})
        if new.issues:
            record_event(db, job, "issues", {"issues": [issue_json(issue) for issue in new.issues]})
        answer_from_store(db, job, new.key)
        return job_out(job_row(db, job), self._ahead(db, job))

    def get(self, job: str) -> tuple[str, JobOut]:
        """Owner and job; raises :class:`RefusedError`, 404."""
        with self._database.read() as db:
            row = job_row(db, job)
            return row["owner"], job_out(row, self._ahead(db, job) if row["state"] == "queued" else None)

    def owner(self, job: str) -> str | None:
        """Whose job it is; None where there is none of that id, or it is being deleted."""
        with self._database.read() as db:
            found: str | None = db.execute(
                select(JOBS.c.owner).where(JOBS.c.id == job, JOBS.c.cancel != DELETED)
            ).scalar()
        return found

    def page(
        self, owners: Sequence[str], wanted: Wanted, count: int, role: Role | None = None
    ) -> tuple[list[JobOut], str | None]:
        """Up to ``count`` jobs of the owners, and the cursor of what follows, if anything does: jobs of that
        ``role`` in an element, or such as plan a problem. Raises :class:`RefusedError`, 422."""
        query = jobs_to_send().where(JOBS.c.owner.in_(owners), JOBS.c.cancel != DELETED)
        of = select(ELEMENT_JOBS.c.job)
        if role is None:
            query = query.where(JOBS.c.id.not_in(of.where(ELEMENT_JOBS.c.role != "panel")))
        else:
            query = query.where(JOBS.c.id.in_(of.where(ELEMENT_JOBS.c.role == role)))
        with self._database.read() as db:
            rows = db.execute(finding.chosen(query, wanted).limit(count + 1)).mappings().all()
            turns = select(JOBS.c.turn).where(JOBS.c.state == "queued").order_by(JOBS.c.turn)
            waiting = db.execute(turns).scalars().all() if any(r["state"] == "queued" for r in rows) else ()
        last = finding.cursor(wanted.sort, rows[count - 1]) if len(rows) > count else None
        places = [bisect_left(waiting, row["turn"]) if row["state"] == "queued" else None for row in rows]
        return [job_out(*one) for one in zip(rows[:count], places, strict=False)], last

    def describe(self, job: str, change: Mapping[str, Any]) -> JobOut:
        """Give a job the ``title``, ``tags`` and ``notes`` of a change; what it does not have stays. Raises
        :class:`RefusedError`, 404."""
        with self._database.write() as db:
            self._database.one_at_a_time(db, job)
            row = job_row(db, job)
            said = {"title": row["title"], "tags": finding.tags_of(row), "notes": row["notes"], **change}
            values = finding.described(row["name"], said["title"], said["tags"], said["notes"])
            db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
            return job_out(job_row(db, job), self._ahead(db, job))

    def cancel(self, job: str, by: str, also_delete: bool = False) -> JobOut:
        """Cancel a job, as the token ``by`` asks: at once if it waits, else its worker is told; no more
        happens to one that is done."""
        with self._database.write() as db:
            self._database.one_at_a_time(db, job)
            row = job_row(db, job)
            if row["state"] == "queued":
                changed = db.execute(
                    update(JOBS)
                    .where(JOBS.c.id == job, JOBS.c.state == "queued")
                    .values(state="cancelled", finished=time.time(), cancel=CANCELLED)
                )
                if changed.rowcount:
                    record_event(db, job, "state", {"state": "cancelled"})
            wanted = DELETED if also_delete else max(CANCELLED, row["cancel"])
            db.execute(update(JOBS).where(JOBS.c.id == job, JOBS.c.state == "running").values(cancel=wanted))
            done = job_out(job_row(db, job, deleted_too=True))
            act: Act = "deleted" if also_delete else "cancelled"
            told = {}
            if also_delete and done.state not in OPEN:
                told = {one.id: one.name for one in remove(db, job)}
            elif also_delete or (row["state"] in OPEN and not row["cancel"]):
                told = {job: done.name}
            for one, name in told.items():
                audit.note(self._database, db, by, act, one, {"name": name})
        if row["state"] == "queued" and done.state == "cancelled":
            metrics.ended("cancelled")
        return done

    def first(self, job: str) -> JobOut:
        """Let a job take the first turn of those of its owner that wait; each of those before it takes the
        next one's. Raises :class:`RefusedError`, 404, 409 where it does not wait."""
        with self._database.write() as db:
            owner = job_row(db, job)["owner"]
            self._database.one_at_a_time(db, f"turns {owner}")
            row = job_row(db, job)
            if row["state"] != "queued":
                what = f"job {job}: it is {row['state']}; only jobs that wait can come first"
                raise RefusedError(409, Issue("service.state", what, field="state"))
            waits = (JOBS.c.owner == owner, JOBS.c.state == "queued", JOBS.c.turn <= row["turn"])
            query = select(JOBS.c.id, JOBS.c.turn).where(*waits).order_by(JOBS.c.turn, JOBS.c.id)
            rows = db.execute(query).all()
            before = [one.id for one in rows if one.id != job]
            for one, turn in zip([job, *before], [row.turn for row in rows], strict=True):
                db.execute(update(JOBS).where(JOBS.c.id == one).values(turn=turn))
            return job_out(job_row(db, job), self._ahead(db, job))

    def retry(self, job: str, by: str) -> JobOut:
        """Let a job wait again as if it had come now, its results gone, as the token ``by`` asks. Raises
        :class:`RefusedError`, 404, 409 where its state is not one of `AGAIN`, 429 as :meth:`create`."""
        with self._database.write() as db:
            owner = job_row(db, job)["owner"]
            self._database.one_at_a_time(db, owner)
            self._database.one_at_a_time(db, job)
            row = job_row(db, job)
            if row["state"] not in AGAIN:
                ways = "wait for its end" if row["state"] in OPEN else "change the problem and send it anew"
                what = f"job {job}: it is {row['state']}; tried again are those that are {', '.join(AGAIN)}"
                issue = Issue("service.state", f"{what}; {ways}", field="state")
                raise RefusedError(409, issue)
            self._allow_open(db, owner)
            kept = or_(FILES.c.name.startswith("problem/"), FILES.c.name == MARKS)
            db.execute(delete(FILES).where(FILES.c.job == job, not_(kept)))
            fresh = {"state": "queued", "stage": "", "fraction": 0.0, "issues": "[]", "metrics": "{}"}
            none = dict.fromkeys(("started", "finished", "seconds", "host", "lease"))
            zero = dict.fromkeys(("attempts", "cancel", "from_store"), 0)
            now = time.time()
            values = {**fresh, **none, **zero, "created": now, "turn": now}
            db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
            record_event(db, job, "issues", {"issues": [], "all": True})
            record_event(db, job, "state", {"state": "queued"})
            answered = answer_from_store(db, job, row["key"])
            done = job_out(job_row(db, job), self._ahead(db, job))
            audit.note(self._database, db, by, "retried", job, {"name": done.name})
        if answered:
            metrics.ended(done.state, STORE)
        return done

    def files(self, job: str) -> dict[str, Blob]:
        """The files of a job by name."""
        with self._database.read() as db:
            return job_files(db, job)

    def shas(self, shas: list[str]) -> set[str]:
        """Those of the hashes that a job names."""
        with self._database.read() as db:
            return set(db.execute(select(FILES.c.sha).where(FILES.c.sha.in_(shas)).distinct()).scalars())

    def owned(self, owner: str) -> dict[str, int]:
        """The content that an owner's jobs and drafts name: sizes [bytes] by SHA-256."""
        named = (
            select(FILES.c.sha, FILES.c.size)
            .join_from(FILES, table, FILES.c.job == table.c.id)
            .where(table.c.owner == owner)
            for table in (JOBS, DRAFTS)
        )
        query = union(*named)
        with self._database.read() as db:
            return dict(row.tuple() for row in db.execute(query).all())

    def counts(self) -> dict[str, int]:
        """The number of jobs in each state."""
        with self._database.read() as db:
            rows = db.execute(select(JOBS.c.state, func.count()).group_by(JOBS.c.state))
            return dict(tuple(row) for row in rows)

    def oldest_waiting(self) -> float | None:
        """When the job that has waited longest came [s since 1970]; None without one."""
        with self._database.read() as db:
            came: float | None = db.execute(
                select(func.min(JOBS.c.created)).where(JOBS.c.state == "queued")
            ).scalar()
        return came

    def _ahead(self, db: Connection, job: str) -> int | None:
        row = job_row(db, job)
        if row["state"] != "queued":
            return None
        earlier = and_(JOBS.c.state == "queued", JOBS.c.turn < row["turn"])
        return int(db.execute(select(func.count()).select_from(JOBS).where(earlier)).scalar_one())

    def _allow(self, db: Connection, new: Sequence[NewJob]) -> None:
        owner = new[0].owner
        self._allow_open(db, owner, sum(one.of is None for one in new))
        mine = select(func.count()).select_from(JOBS).where(JOBS.c.owner == owner)
        kept = int(db.execute(mine).scalar_one())
        if kept + len(new) > self._limits.kept_jobs:
            more = f", {len(new)} more are wanted" if len(new) > 1 else ""
            what = f"{kept} jobs are kept{more}, at most {self._limits.kept_jobs} may be; delete old ones"
            raise too_many(what, 60, self._limits.kept_jobs)

    def _allow_open(self, db: Connection, owner: str, more: int = 1) -> None:
        mine = select(func.count()).select_from(JOBS).where(JOBS.c.owner == owner)
        panels = select(ELEMENT_JOBS.c.job).where(ELEMENT_JOBS.c.role == "panel")
        opened = and_(JOBS.c.owner == owner, JOBS.c.state.in_(OPEN))
        elements = (
            select(func.count(ELEMENT_JOBS.c.element.distinct()))
            .join_from(ELEMENT_JOBS, JOBS, ELEMENT_JOBS.c.job == JOBS.c.id)
            .where(opened, ELEMENT_JOBS.c.role == "panel")
        )
        waiting = int(db.execute(mine.where(opened, JOBS.c.id.not_in(panels))).scalar_one())
        waiting += int(db.execute(elements).scalar_one())
        if waiting + max(more, 1) > self._limits.open_jobs:
            wanted = f", {more} more are wanted" if more > 1 else ""
            most = self._limits.open_jobs
            what = f"{waiting} jobs wait or run{wanted}, at most {most} may; wait for some, or cancel"
            raise too_many(what, 10, most)


def record_event(db: Connection, job: str, kind: str, data: Mapping[str, Any]) -> None:
    """Add an event to a job; its number is the next one, because the job's row is held until the end."""
    db.execute(update(JOBS).where(JOBS.c.id == job).values(seq=JOBS.c.seq + 1))
    number = db.execute(select(JOBS.c.seq).where(JOBS.c.id == job)).scalar_one()
    row = {"job": job, "seq": number, "kind": kind, "data": json.dumps(data), "at": time.time()}
    db.execute(insert(EVENTS).values(row))
    if kind == "state" and data["state"] not in OPEN:
        webhooks.record_end(db, job, data["state"])


def put_files(db: Connection, job: str, files: Mapping[str, Blob]) -> None:
    """Name a job's files, in place of those of the same names."""
    if files:
        db.execute(delete(FILES).where(FILES.c.job == job, FILES.c.name.in_(list(files))))
        rows = [{"job": job, "name": n, "sha": blob.sha, "size": blob.size} for n, blob in files.items()]
        db.execute(insert(FILES), rows)


def job_files(db: Connection, job: str) -> dict[str, Blob]:
    """The files of a job by name."""
    rows = db.execute(select(FILES).where(FILES.c.job == job).order_by(FILES.c.name)).mappings()
    return {row["name"]: Blob(row["sha"], row["size"]) for row in rows}


class Gone(NamedTuple):
    """A job that was deleted."""

    id: str
    owner: str
    name: str


def remove(db: Connection, job: str) -> list[Gone]:
    """Delete a job with its files and events; of an element, reports too, and its panels become jobs like any
    others. Stored content goes with a later sweep. What went is told, for who writes it down: nothing where
    another transaction was first."""
    own = and_(ELEMENT_JOBS.c.element == job, ELEMENT_JOBS.c.role == "report")
    reports = db.execute(select(ELEMENT_JOBS.c.job).where(own)).scalars().all()
    gone = []
    for one in dict.fromkeys((job, *reports)):
        row = db.execute(select(JOBS.c.id, JOBS.c.owner, JOBS.c.name).where(JOBS.c.id == one)).first()
        done = db.execute(delete(JOBS).where(JOBS.c.id == one))  # first, for who releases it holds it
        if row is not None and done.rowcount:
            gone.append(Gone(*row))
        for table in (EVENTS, FILES, KEYS, LINKS, RELEASES):
            db.execute(delete(table).where(table.c.job == one))
    db.execute(delete(ELEMENT_JOBS).where(or_(ELEMENT_JOBS.c.job == job, ELEMENT_JOBS.c.element == job)))
    return gone


def answer_from_store(db: Connection, job: str, key: str) -> bool:
    """Give a job the answer of one with the same key, if there is one."""
    query = (
        select(JOBS)
        .where(JOBS.c.key == key, JOBS.c.state.in_(SETTLED), JOBS.c.id != job)
        .order_by(JOBS.c.created)
        .limit(1)
    )
    found = db.execute(query).mappings().first()
    if found is None:
        return False
    kept = {name: found[name] for name in ("state", "issues", "metrics", "seconds", "stage", "fraction")}
    db.execute(update(JOBS).where(JOBS.c.id == job).values(**kept, from_store=1, finished=time.time()))
    files = job_files(db, found["id"])
    put_files(db, job, {name: blob for name, blob in files.items() if name != MARKS})
    if found["issues"] != "[]":
        record_event(db, job, "issues", {"issues": json.loads(found["issues"])})
    record_event(db, job, "state", {"state": found["state"], "from_store": True})
    return True


def issues_json(issues: Sequence[Issue]) -> str:
    """Issues for the store."""
    return json.dumps([issue_json(issue) for issue in issues])


_AS_STORED: Final = (
    *("id", "name", "state", "stage", "digest", "seconds", "attempts"),
    *("timeout_s", "memory_mb", "title", "notes"),
)
"""What is sent of a job as the store has it."""


def job_out(row: RowMapping, ahead: int | None = None) -> JobOut:
    """A row as it is sent."""
    return JobOut(
        **{name: row[name] for name in _AS_STORED},
        fraction=min(max(row["fraction"], 0.0), 1.0),
        processes=json.loads(row["processes"]),
        by=row["made_by"],
        created=utc(row["created"]),
        started=None if row["started"] is None else utc(row["started"]),
        finished=None if row["finished"] is None else utc(row["finished"]),
        from_store=bool(row["from_store"]),
        ahead=ahead,
        issues=[Issue.from_dict(issue) for issue in json.loads(row["issues"])],
        metrics=json.loads(row["metrics"]),
        tags=finding.tags_of(row),
        released=row["release_who"] is not None and row["release_withdrawn"] is None,
        release=_release(row),
        thumbnail=bool(row["thumbnail"]),
    )


def _release(row: RowMapping) -> Release | None:
    if row["release_who"] is None:
        return None
    return release_of({name: row[f"release_{name}"] for name in _RELEASE})


def release_of(row: Mapping[Any, Any]) -> Release:
    """A release as it is sent, from the columns that `_RELEASE` names."""
    by, at, withdrawn = row["withdrawn_who"], row["withdrawn"], None
    if at is not None:
        withdrawn = Withdrawal(by=by, at=utc(at), reason=row["reason"])
    return Release(by=row["who"], at=utc(row["at"]), note=row["note"], withdrawn=withdrawn)


LAST_RELEASE: Final = and_(RELEASES.c.job == JOBS.c.id, RELEASES.c.number == JOBS.c.releases)
"""The last release of a job."""
_RELEASE: Final = ("who", "at", "note", "withdrawn", "withdrawn_who", "reason")
"""What is told of it with its job."""
PICTURED: Final = (
    exists().where(FILES.c.job == JOBS.c.id, FILES.c.name == THUMBNAIL).correlate(JOBS).label("thumbnail")
)
"""Whether a job has a picture for lists."""


def jobs_to_send() -> Select[Any]:
    """Jobs as the store has them, with what else :func:`job_out` tells."""
    more = [TOKENS.c.name.label("made_by"), *(RELEASES.c[name].label(f"release_{name}") for name in _RELEASE)]
    with_names = select(JOBS, PICTURED, *more).outerjoin_from(JOBS, TOKENS, JOBS.c.owner == TOKENS.c.id)
    return with_names.outerjoin(RELEASES, LAST_RELEASE)


def job_row(db: Connection, job: str, deleted_too: bool = False) -> RowMapping:
    """A job as the store has it; raises :class:`RefusedError`, 404."""
    row = db.execute(jobs_to_send().where(JOBS.c.id == job)).mappings().first()
    if row is None or (row["cancel"] == DELETED and not deleted_too):
        raise unknown_job(job)
    return row


POLL_S: Final = 0.25
"""Time [s] between two looks for new events."""
ALIVE_S: Final = 15.0
"""A comment is sent so often, so that proxies do not take a stream for dead."""
MAY_S: Final = 5.0
"""Time [s] between two looks whether those who listen may still see their jobs."""
JOBS_PER_QUERY: Final = 500
"""Jobs that one query of the database asks for."""


class Event(NamedTuple):
    """The event ``seq`` of a job; ``data`` is JSON."""

    seq: int
    kind: str
    data: str


@dataclasses.dataclass(eq=False)
class _Listener:
    """Who listens to a job, by his token, and the last event that he has."""

    token: str
    seen: int
    woken: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)
    over: bool = False


class Hub:
    """Wakes listeners when their jobs have news, and ends the streams of those who may see them no more."""

    def __init__(self, database: Database, limits: Limits, auth: Auth) -> None:
        self._database, self._limits, self._auth = database, limits, auth
        self._listening: dict[str, set[_Listener]] = {}
        self._of_owner: dict[str, int] = {}
        self._closing = False

    async def run(self) -> None:
        """Ask the store for news until cancelled; errors of the store are passed over, it is asked again."""
        due = 0.0
        while True:
            await asyncio.sleep(POLL_S)
            if not self._listening:
                continue
            if self._database.newer is not None:  # another host knows how it goes on
                self.close()
                return
            with contextlib.suppress(Exception):
                self._wake(await anyio.to_thread.run_sync(self._numbers, list(self._listening)))
            if time.monotonic() >= due:
                due = time.monotonic() + MAY_S
                asked = {(one.token, job) for job, own in self._listening.items() for one in own}
                with contextlib.suppress(Exception):
                    self._end(await anyio.to_thread.run_sync(self._unseen, asked))

    def close(self) -> None:
        """End all streams."""
        self._closing = True
        for listeners in self._listening.values():
            for one in listeners:
                one.woken.set()

    @contextlib.contextmanager
    def slot(self, owner: str) -> Iterator[None]:
        """A stream of an owner; raises :class:`RefusedError`, 429, where there are too many."""
        if self._of_owner.get(owner, 0) >= self._limits.streams:
            what = f"{self._limits.streams} streams of events are open, and no more may be; close some"
            raise too_many(what, 10)
        self._of_owner[owner] = self._of_owner.get(owner, 0) + 1
        try:
            yield
        finally:
            self._of_owner[owner] -= 1
            if not self._of_owner[owner]:
                del self._of_owner[owner]

    async def stream(self, job: str, after: int, token: str) -> AsyncIterator[str]:
        """The events of a job after number ``after`` as server-sent events, until it has ended or is gone, or
        the token may see it no more: then without the event ``end``, and who comes again is refused."""
        own = _Listener(token, after)
        self._listening.setdefault(job, set()).add(own)
        try:
            yield ": tandem\n\n"
            while not (self._closing or own.over):
                own.woken.clear()
                events, is_open = await anyio.to_thread.run_sync(self._news, job, own.seen)
                for event in events:
                    own.seen = event.seq
                    yield f"id: {event.seq}\nevent: {event.kind}\ndata: {event.data}\n\n"
                if not is_open:
                    yield f"id: {own.seen}\nevent: end\ndata: {json.dumps({'seq': own.seen})}\n\n"
                    return
                try:
                    await asyncio.wait_for(own.woken.wait(), ALIVE_S)
                except TimeoutError:
                    yield ": still here\n\n"
        finally:
            listeners = self._listening.get(job, set())
            listeners.discard(own)
            if not listeners:
                self._listening.pop(job, None)

    def _wake(self, numbers: dict[str, int]) -> None:
        for job, listeners in self._listening.items():
            for one in listeners:
                if numbers.get(job, -1) != one.seen:
                    one.woken.set()

    def _end(self, unseen: Set[tuple[str, str]]) -> None:
        for job, listeners in self._listening.items():
            for one in listeners:
                if (one.token, job) in unseen:
                    one.over = True
                    one.woken.set()

    def _unseen(self, asked: Set[tuple[str, str]]) -> set[tuple[str, str]]:
        """Those of the tokens with jobs whose token is over, or sees that job no more; two questions for all
        of them. A job that is gone ends its streams itself."""
        asked = {(token, job) for token, job in asked if token != LOCAL}
        good = self._auth.teams(sorted({token for token, _ in asked}))
        jobs = sorted({job for _, job in asked})
        whose: dict[str, tuple[str, str | None]] = {}
        query = select(JOBS.c.id, JOBS.c.owner, TOKENS.c.team).outerjoin_from(
            JOBS, TOKENS, JOBS.c.owner == TOKENS.c.id
        )
        with self._database.read() as db:
            for start in range(0, len(jobs), JOBS_PER_QUERY):
                some = query.where(JOBS.c.id.in_(jobs[start : start + JOBS_PER_QUERY]))
                whose |= {row.id: (row.owner, row.team) for row in db.execute(some)}

        def sees(token: str, job: str) -> bool:
            owner, team = whose.get(job, (token, None))
            return token in good and (owner == token or (team is not None and team == good[token]))

        return {(token, job) for token, job in asked if not sees(token, job)}

    def _numbers(self, jobs: list[str]) -> dict[str, int]:
        found: dict[str, int] = {}
        with self._database.read() as db:
            for start in range(0, len(jobs), JOBS_PER_QUERY):
                query = select(JOBS.c.id, JOBS.c.seq).where(
                    JOBS.c.id.in_(jobs[start : start + JOBS_PER_QUERY])
                )
                found |= dict(tuple(row) for row in db.execute(query))
        return found

    def _news(self, job: str, after: int) -> tuple[list[Event], bool]:
        """Events after number ``after``, and whether more may come."""
        with self._database.read() as db:
            state: Any = db.execute(select(JOBS.c.state).where(JOBS.c.id == job)).scalar()
            query = select(EVENTS).where(EVENTS.c.job == job, EVENTS.c.seq > after).order_by(EVENTS.c.seq)
            rows = db.execute(query).mappings().all()
        return [Event(row["seq"], row["kind"], row["data"]) for row in rows], state in OPEN


class Stream(StreamingResponse):
    """The events of a job as an answer, which holds a slot of its owner for as long as it is sent."""

    def __init__(self, hub: Hub, owner: str, job: str, after: int) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(hub.stream(job, after, owner), media_type="text/event-stream", headers=headers)
        self._hub, self._owner = hub, owner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI; raises :class:`RefusedError`, 429."""
        with self._hub.slot(self._owner):
            await super().__call__(scope, receive, send)
