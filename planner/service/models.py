"""Data models of the service: the tables of its store, and what the API sends.

**Store** (`Database`): tables, the connection to SQLite or PostgreSQL, and the clock all hosts
share. Tables are the same on both. Times are seconds since 1970 (UTC). A transaction is on the disk
when it ends.

**API** (`Sent`): models that give its OpenAPI too. Problems are read by the models of
:mod:`planner.reading.problem`.
"""

import datetime as dt
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import (
    Column,
    Connection,
    Engine,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    cast,
    create_engine,
    event,
    extract,
    func,
    literal,
    text,
)
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError
from sqlalchemy.sql.elements import ColumnElement

from planner.issues import Issue, TandemError, refusal
from planner.service.schema import VERSION, NoVersionError, SchemaVersionError, create_or_check

LONGEST_TAG: Final = 40
"""Characters of a tag of jobs."""
METADATA: Final = MetaData()
"""The tables of the service."""

TOKENS: Final = Table(
    "tandem_tokens",
    METADATA,
    Column("id", String(32), primary_key=True),
    Column("name", String(64), nullable=False, unique=True),
    Column("hash", String(64), nullable=False, unique=True),
    Column("created", Float, nullable=False),
    Column("revoked", Float),
    Column("role", String(16), nullable=False),
    Column("team", String(64)),
    Column("expires", Float),
    Column("scope", String(16)),
    Column("tag", String(LONGEST_TAG)),
)
"""Who may use the service, and for what. Only the SHA-256 of a token is kept."""

SESSIONS: Final = Table(
    "tandem_sessions",
    METADATA,
    Column("hash", String(64), primary_key=True),
    Column("token", String(32), nullable=False),
    Column("expires", Float, nullable=False),
)
"""Browsers that showed a token once: the SHA-256 of their cookie."""

JOBS: Final = Table(
    "tandem_jobs",
    METADATA,
    Column("id", String(32), primary_key=True),
    Column("owner", String(32), nullable=False),
    Column("name", String(64), nullable=False),
    Column("digest", String(64), nullable=False),
    Column("key", String(64), nullable=False, index=True),
    Column("processes", Text, nullable=False),
    Column("state", String(16), nullable=False, index=True),
    Column("stage", String(64), nullable=False, default=""),
    Column("fraction", Float, nullable=False, default=0.0),
    Column("issues", Text, nullable=False, default="[]"),
    Column("metrics", Text, nullable=False, default="{}"),
    Column("created", Float, nullable=False),
    Column("started", Float),
    Column("finished", Float),
    Column("seconds", Float),
    Column("attempts", Integer, nullable=False, default=0),
    Column("host", String(96)),
    Column("lease", Float),
    Column("seq", Integer, nullable=False, default=0),
    Column("cancel", Integer, nullable=False, default=0),
    Column("from_store", Integer, nullable=False, default=0),
    Column("timeout_s", Float, nullable=False),
    Column("memory_mb", Float, nullable=False),
    Column("releases", Integer, nullable=False, default=0),
    Column("title", String(200), nullable=False, default=""),
    Column("tags", Text, nullable=False, default=""),
    Column("notes", Text, nullable=False, default=""),
    Column("label", String(200), nullable=False, default=""),
    Column("sought", Text, nullable=False, default=""),
    Column("turn", Float, nullable=False, default=0.0),
    Index("tandem_jobs_by_owner", "owner", "created", "id"),
)
"""``key``: what the answer depends on, the problem's digest and the versions. ``host`` works on the job until
``lease``. ``seq`` is the number of the job's last event. ``cancel``: 1 cancelled, 2 deleted too. ``releases``
is the number of the job's last release. ``tags`` are framed by line ends. Without capitals, ``label`` is the
title, or name, by which jobs are sorted, and ``sought`` all words by which they are found. Jobs that wait
are planned in the order of ``turn``, which is when they came unless their owner has changed it."""

CANCELLED: Final = 1
"""In a job's column `cancel`: its owner wants it to end."""
DELETED: Final = 2
"""In a job's column `cancel`: its owner wants it to end and to go."""

FILES: Final = Table(
    "tandem_files",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("name", String(255), primary_key=True),
    Column("sha", String(64), nullable=False, index=True),
    Column("size", Integer, nullable=False),
)
"""A job's problem (``problem/...``) and its results, by the names of a result folder."""

SECRETS: Final = Table(
    "tandem_secrets",
    METADATA,
    Column("name", String(32), primary_key=True),
    Column("value", String(64), nullable=False),
)
"""What all hosts of a store sign with, by what it is for."""
ELEMENT_JOBS: Final = Table(
    "tandem_element_jobs",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("element", String(32), nullable=False, index=True),
    Column("role", String(16), nullable=False),
    Column("panel", String(32), nullable=False, default=""),
    Column("like", String(32)),
    Column("about", Text, nullable=False, default="{}"),
)
"""Jobs of building elements, by ``role``: ``division``, by whose job the element is called and which has
``about`` it what may be changed; ``panel``, that plans the panel or the job of a raw block of that id,
``like`` the job of one beside it; ``report`` on what was planned."""

EVENTS: Final = Table(
    "tandem_events",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("seq", Integer, primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("data", Text, nullable=False),
    Column("at", Float, nullable=False),
)
"""What happened to jobs, numbered, for the streams of events."""

KEYS: Final = Table(
    "tandem_keys",
    METADATA,
    Column("owner", String(32), primary_key=True),
    Column("hash", String(64), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("job", String(32), nullable=False, index=True),
    Column("content", String(64), nullable=False),
    Column("created", Float, nullable=False),
)
"""The jobs, by ``number``, that a request with an idempotency key made: SHA-256 of the key, and of the
request's ``content``."""

WEBHOOKS: Final = Table(
    "tandem_webhooks",
    METADATA,
    Column("id", String(32), primary_key=True),
    Column("owner", String(32), nullable=False, index=True),
    Column("url", String(500), nullable=False),
    Column("secret", String(128), nullable=False),
    Column("created", Float, nullable=False),
    Column("told", Float),
    Column("outcome", String(200)),
    Column("off", Float),
)
"""Addresses that are told when a job of the owner has ended: when the last one was ``told`` and its
``outcome``; ``off`` since it answered that it is gone."""

DELIVERIES: Final = Table(
    "tandem_deliveries",
    METADATA,
    Column("id", String(64), primary_key=True),
    Column("webhook", String(32), nullable=False, index=True),
    Column("body", Text, nullable=False),
    Column("due", Float, nullable=False, index=True),
    Column("attempts", Integer, nullable=False),
)
"""What webhooks are still to be told, from when on, and how often that was tried."""

RELEASES: Final = Table(
    "tandem_releases",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("token", String(32), nullable=False),
    Column("who", String(200), nullable=False),
    Column("at", Float, nullable=False),
    Column("note", Text, nullable=False),
    Column("digest", String(64), nullable=False),
    Column("proof", String(64), nullable=False),
    Column("programs", Text, nullable=False),
    Column("withdrawn", Float),
    Column("withdrawn_token", String(32)),
    Column("withdrawn_who", String(200)),
    Column("reason", Text),
)
"""Who released the programs of a job, by ``number`` from 1: the problem's digest, the SHA-256 of proof and
of each program by its name; and who took that back. Only the last one may hold."""

AUDIT: Final = Table(
    "tandem_audit",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("at", Float, nullable=False),
    Column("token", String(32), nullable=False, index=True),
    Column("who", String(200), nullable=False),
    Column("team", String(64), index=True),
    Column("act", String(16), nullable=False),
    Column("job", String(32), nullable=False, index=True),
    Column("about", Text, nullable=False),
)
"""Who did what, in the order of ``number``; it outlives jobs and tokens."""

LINKS: Final = Table(
    "tandem_links",
    METADATA,
    Column("id", String(32), primary_key=True),
    Column("job", String(32), nullable=False, index=True),
    Column("token", String(32), nullable=False),
    Column("who", String(200), nullable=False),
    Column("created", Float, nullable=False),
    Column("expires", Float, nullable=False),
)
"""Links to look at a job that were made and not withdrawn, by whom, and until when they are good."""

DRAFTS: Final = Table(
    "tandem_drafts",
    METADATA,
    Column("id", String(32), primary_key=True),
    Column("owner", String(32), nullable=False, index=True),
    Column("kind", String(16), nullable=False),
    Column("title", String(200), nullable=False),
    Column("version", Integer, nullable=False),
    Column("created", Float, nullable=False),
    Column("changed", Float, nullable=False),
    Column("job", String(32)),
    Column("sent", Integer),
)
"""Problems in the making, and cells, tools and templates that people keep, by ``kind``; the number of the
last ``version``, and the one that was ``sent`` last, with its ``job``. Their content is in `FILES`, by its
hash, under the draft's id."""

DRAFT_VERSIONS: Final = Table(
    "tandem_draft_versions",
    METADATA,
    Column("draft", String(32), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("at", Float, nullable=False),
    Column("who", String(200), nullable=False),
    Column("problem", String(64), nullable=False),
    Column("files", Text, nullable=False),
)
"""What a draft was: SHA-256 of its ``problem``, and of its ``files`` by name."""

SCHEMA: Final = Table(
    "tandem_schema", METADATA, Column("version", Integer, primary_key=True, autoincrement=False)
)
"""Version of these tables, :data:`planner.service.schema.VERSION`."""

POOL_SIZE: Final = 20
"""Connections to the database that stay open; as many more may come for a while."""
WAIT_S: Final = 120.0
"""How long a request waits for a connection or for another writer."""
CONNECT_S: Final = 10
"""How long PostgreSQL may take to answer a new connection."""


class Database:
    """One database; threads may share it."""

    def __init__(self, url: str) -> None:
        """Raises ``TandemError`` with ``service.database`` where it cannot be opened."""
        self._lock = threading.Lock()
        self.newer: SchemaVersionError | None = None
        """What is told once the tables have become those of a version that this program does not know."""
        try:
            self._engine = open_engine(url)
            self.sqlite = self._engine.dialect.name == "sqlite"
            with self._engine.execution_options(write=True).begin() as connection:
                if not self.sqlite:
                    connection.execute(text("SELECT pg_advisory_xact_lock(7223)"))
                create_or_check(connection, METADATA)
        except (SchemaVersionError, NoVersionError) as error:
            self._engine.dispose()
            remedy = error.remedy if isinstance(error, SchemaVersionError) else "Restore a backup."
            message = f"database {shown(url)}: {error}. {remedy}"
            raise refusal("service.database", message, field="database") from error
        except (DBAPIError, ArgumentError, NoSuchModuleError, ImportError) as error:
            raise TandemError(cannot_open(url, error)) from error
        self._writer = self._engine.execution_options(write=True)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A transaction that only reads."""
        with self._engine.begin() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """A transaction that writes; all of it is kept, or nothing."""
        if self.sqlite:
            with self._lock, self._writer.begin() as connection:
                yield connection
        else:
            with self._writer.begin() as connection:
                yield connection

    def ping(self) -> None:
        """Ask it something; raises ``SQLAlchemyError`` where it is away."""
        with self.read() as db:
            db.execute(text("SELECT 1"))

    def look(self, connection: Connection) -> None:
        """Raise ``SchemaVersionError`` if another program has changed the tables to a newer version."""
        found = connection.execute(text("SELECT max(version) FROM tandem_schema")).scalar()
        if isinstance(found, int) and found > VERSION:
            self.newer = SchemaVersionError(found)
            raise self.newer

    def clock(self) -> ColumnElement[float]:
        """Seconds since 1970, by the one clock that all hosts of this database share."""
        if self.sqlite:
            return literal(time.time(), Float)
        return cast(extract("epoch", func.clock_timestamp()), Float)

    def one_at_a_time(self, connection: Connection, what: str) -> None:
        """Let other transactions about ``what`` wait until this one ends; SQLite has one writer anyway."""
        if not self.sqlite:
            number = zlib.crc32(what.encode())
            connection.execute(text("SELECT pg_advisory_xact_lock(7224, :n)"), {"n": number - 2**31})

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


def utc(seconds: float) -> dt.datetime:
    """A time of the store as it is sent."""
    return dt.datetime.fromtimestamp(seconds, dt.UTC)


def moment(at: dt.datetime) -> str:
    """A time as people are told it."""
    return f"{at:%Y-%m-%d %H:%M:%S UTC}"


def default_url(data: Path) -> str:
    """The URL of the SQLite file in the data folder."""
    return f"sqlite:///{data.resolve() / 'tandem.db'}"


def open_engine(url: str) -> Engine:
    """Connections to a database as it is. Raises ``ArgumentError``, ``NoSuchModuleError`` or ``ImportError``
    for what is no URL, is an SQLite database in memory, or has no driver."""
    if url.startswith(("postgres://", "postgresql://")):
        url = "postgresql+psycopg://" + url.split("://", 1)[1]
    try:
        parts = make_url(url)
        kind = parts.get_backend_name()
        if kind not in ("sqlite", "postgresql"):
            raise ArgumentError(f"got {kind}")
        name = parts.database or ""
        if "\0" in url or (kind == "sqlite" and name in ("", ":memory:")):
            raise ArgumentError("names no file")  # one in memory goes with its connection
        waits = {"timeout": WAIT_S} if kind == "sqlite" else {"connect_timeout": CONNECT_S}
        engine = create_engine(
            url,
            pool_size=POOL_SIZE,
            max_overflow=POOL_SIZE,
            pool_timeout=WAIT_S,
            pool_pre_ping=kind != "sqlite",
            connect_args=waits,
            hide_parameters=True,  # errors go to the log, hashes of tokens and users' data do not
        )
    except (ValueError, TypeError) as error:  # of a port or an option that is no number
        raise ArgumentError("has a part that cannot be read") from error
    if kind == "sqlite":
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: Any, record: Any) -> None:
    """Write-ahead log, so that readers never wait; what is committed survives a power cut. The driver starts
    no transactions of its own."""
    del record
    connection.isolation_level = None
    for pragma in ("journal_mode=WAL", "synchronous=FULL"):
        connection.execute(f"PRAGMA {pragma}").close()


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def reason(error: DBAPIError) -> str:
    """What a database said, in a line, without the statement and its values."""
    return (str(error.orig).splitlines() or [type(error.orig).__name__])[0][:200]


def cannot_open(url: str, error: Exception) -> Issue:
    """What to say of a database that cannot be opened."""
    if isinstance(error, ImportError):
        what = "PostgreSQL needs its driver; pip install 'tandem-planner[service,postgres]'"
    elif isinstance(error, DBAPIError):
        what = f"cannot be opened ({reason(error)}); see that it runs and may be written"
    else:
        what = "is no such URL; give sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME"
    return Issue("service.database", f"database {shown(url)}: {what}", field="database")


def shown(url: str) -> str:
    """An URL for a message, without user, password and options, which may have a password too."""
    return url.split("@")[-1].split("?")[0]


API: Final = 17
"""Number of the interface under ``/v1``: one more when something is added. 2: links. 3: elements, motions as
data. 4: readiness, jobs that are tried again. 5: first looks, lists that are known.
6: keys of requests that are done once. 7: webhooks. 8: roles and teams of tokens. 9: releases. 10: the audit
log. 11: titles, tags and notes, search, deleting many. 12: what a cell looks like, maps of a freedom.
13: drafts, the order of the queue, sweeps, estimates of what is left, links to look. 14: pages of drafts, and
which of them were sent, releases of panels, several problems at once, titles of elements.
15: pictures for lists, titles of drafts that go with the name of the problem. 16: scopes of tokens, pictures
of panels, first looks at coarser paths. 17: jobs of raw blocks of elements."""
OLDEST_API: Final = 1
"""Clients that were made for this number or a later one are served; one more when something goes."""
State = Literal[
    "queued",
    "running",
    "verified",
    "done",
    "infeasible",
    "bad_input",
    "unproven",
    "crashed",
    "timeout",
    "memory",
    "cancelled",
]
Kind = Literal["robots", "cells", "tools", "materials"]
OPEN: Final = ("queued", "running")
"""States of jobs that have not ended."""
SETTLED: Final = ("verified", "done", "infeasible", "unproven")
"""States that the problem alone decides, so that an identical one needs no planning."""
MARKS: Final = "progress.csv"
"""The file of an element's job that says which panels are cut, glued or broken; no part of its result."""
Role = Literal["division", "panel", "report"]
TokenRole = Literal["view", "plan", "release"]
TOKEN_ROLES: Final[tuple[TokenRole, ...]] = ("view", "plan", "release")
"""Roles of tokens, each of which includes the former: to look at everything; to make, change and delete
jobs, and to hand links out; to release programs."""
TokenScope = Literal["submit", "released"]
"""Scopes of tokens, narrower than a role: to send jobs and read those, for a script; to read what is
released, for a screen at the cell."""
Sort = Literal["newest", "oldest", "title", "turn"]
Mark = Literal["cut", "glued", "broken"]
Act = Literal[
    "submitted",
    "cancelled",
    "retried",
    "deleted",
    "released",
    "withdrew",
    "downloaded",
    "linked",
    "unlinked",
    "passed",
]


class Sent(BaseModel):
    """Base of what is sent."""

    model_config = ConfigDict(frozen=True)


class Refusal(Sent):
    """Why a request was refused, as a problem document (RFC 9457)."""

    type: Literal["about:blank"] = Field(description="the status says the kind, codes of issues the rest")
    title: str = Field(description="the status in words")
    status: int
    detail: str = Field(description="the messages of all issues")
    issues: list[Issue] = Field(description="all that is wrong, by code and field")
    of: list[int] = Field([], description="of several problems, which one each issue is of, from 0")


class Withdrawal(Sent):
    """Who took a release back, when, and why."""

    by: str
    at: dt.datetime
    reason: str


class Release(Sent):
    """Who released the programs of a job; what was withdrawn is no longer released."""

    by: str = Field(description="name of the token, or of who said so where no tokens are asked for")
    at: dt.datetime
    note: str = ""
    withdrawn: Withdrawal | None = None


class ReleaseOut(Release):
    """A release, and what was released."""

    job: str
    name: str = Field(description="the problem's name")
    digest: str = Field(description="SHA-256 over the problem's values and files")
    proof: str = Field(description="SHA-256 of proof.json")
    programs: dict[str, str] = Field(description="SHA-256 of each program by its name")


class ReleaseList(Sent):
    """The releases of a job, the newest first; only that one may hold."""

    releases: list[ReleaseOut]


class JobOut(Sent):
    """A job. ``fraction`` is that of its stage; ``from_store``: an identical problem had been planned."""

    id: str
    name: str = Field(description="the problem's name")
    state: State
    stage: str = Field("", description="what is being done")
    fraction: float = Field(0.0, ge=0, le=1, description="how much of the stage is done")
    processes: list[str] = []
    by: str | None = Field(None, description="name of the token that made it")
    digest: str = Field(description="SHA-256 over the problem's values and files")
    created: dt.datetime
    started: dt.datetime | None = None
    finished: dt.datetime | None = None
    seconds: float | None = Field(None, description="time of planning [s]")
    attempts: int = Field(0, description="how often planning began: more than once after a restart")
    from_store: bool = False
    ahead: int | None = Field(None, description="queued jobs that came before it")
    timeout_s: float
    memory_mb: float
    issues: list[Issue] = []
    metrics: dict[str, float] = {}
    title: str = Field("", description="what people call it, in any language")
    tags: list[str] = []
    notes: str = ""
    released: bool = Field(
        False, description="whether a named person released the programs, and none withdrew"
    )
    release: Release | None = Field(None, description="the last release")
    thumbnail: bool = Field(False, description="whether its file `thumbnail.png` shows the cell")


class Shown(Sent):
    """The job of a panel as it was shown to who releases it."""

    model_config = ConfigDict(extra="forbid")
    job: str = Field(pattern="^[0-9a-f]{32}$", max_length=32)
    digest: str = Field(max_length=64, description="`digest` of the panel")


class PanelRelease(ReleaseOut):
    """The release of the job of a panel."""

    panel: str


class PanelRefused(Sent):
    """Why a panel was not released."""

    panel: str
    issues: list[Issue]


class ElementReleases(Sent):
    """What one act released of an element, and what it did not."""

    releases: list[PanelRelease]
    refused: list[PanelRefused]


class Deleted(Sent):
    """Which of the jobs that were to be deleted were, and which there are not."""

    deleted: list[str]
    unknown: list[str]


class JobList(Sent):
    """A page of jobs, the newest first; ``next`` is the ``cursor`` of the page that follows."""

    jobs: list[JobOut]
    next: str | None = None


class ElementOut(JobOut):
    """An element: the job that divides it, and what may be changed."""

    kind: str = Field("", description="of its panels")
    fields: dict[str, float | list[float]] = Field(
        {}, description="what may be changed, by its place in the element file, as it is"
    )
    planned: int = Field(0, description="panels and jobs of raw blocks that were given to the planner")


class ElementList(Sent):
    """A page of elements, as of jobs."""

    elements: list[ElementOut]
    next: str | None = None


class PlannedOut(Sent):
    """A problem of an element and what became of it."""

    id: str
    cut_min: dict[str, float] = Field({}, description="estimate of the cuts alone [min], by arm")
    job: str | None = Field(None, description="the job that plans it")
    digest: str | None = Field(None, description="SHA-256 over the values and files of its problem")
    state: State | Literal["not_planned"] = "not_planned"
    release: Literal["not-released", "released", "withdrawn"] | None = Field(
        None, description="of its programs, where they are proven"
    )
    stage: str = ""
    cycle_s: float | None = Field(None, description="time from first to last target [s]")
    thumbnail: bool = Field(False, description="whether its job has the file thumbnail.png")
    issue: Issue | None = Field(None, description="the first of what stands in its way")


class PanelOut(PlannedOut):
    """A panel of an element. One that is ``cut_in`` a job together with others has job and state of that."""

    order: int | None = Field(None, description="when it is put in, from 1")
    block_mm: list[float] = Field(description="its block")
    block: str = Field("", description="the raw block that this is cut from")
    cut_in: str | None = Field(
        None, description="the job of a raw block that cuts it together with others, until it has its own"
    )
    mark: Mark | None = None


class BlockJobOut(PlannedOut):
    """A job that cuts a raw block apart, or several panels out of a part of it, together."""

    block: str = Field(description="the raw block")
    said: str = Field(description="what of the block it cuts, and how that lies")
    panels: list[str] = Field([], description="those that it cuts; none where it cuts the block apart")
    mark: Literal["cut"] | None = Field(None, description="done: of panels, when all of them are marked")


class ElementPanels(ElementOut):
    """An element with its panels, once it is divided."""

    panels: list[PanelOut] = []
    block_jobs: list[BlockJobOut] = Field(
        [], description="jobs of raw blocks, those of a block in the order in which it is cut"
    )
    counts: dict[str, int] = Field({}, description="panels by state, and by mark")
    cut_h: dict[str, float] = Field({}, description="estimate of all cuts [h], by arm")
    told: list[str] = Field([], description="how far it is made, what to cut and to glue next")
    report: JobOut | None = Field(None, description="the last report on its panels; its files have it")


class Change(Sent):
    """Fields of an element file by their places, with their new values."""

    model_config = ConfigDict(extra="forbid")
    fields: dict[str, Any] = Field(max_length=100)


class Chosen(Sent):
    """Panels and jobs of raw blocks by their ids; none: all that are not planned yet, each panel that is cut
    together with others by its row."""

    model_config = ConfigDict(extra="forbid")
    panels: list[str] | None = Field(None, max_length=10_000)


class Marking(Sent):
    """A panel and what it is now; ``open`` takes its mark away. The id of a job of a raw block stands for all
    panels that it cuts, or where it cuts the block apart, for itself."""

    model_config = ConfigDict(extra="forbid")
    panel: str = Field(max_length=32)
    state: Literal["cut", "glued", "broken", "open"]


class AuditOut(Sent):
    """Somebody did something. ``about``: the job's name and what else tells it from others: of a release the
    digests, of a download the file and whether it was released then, by a link or not."""

    number: int
    at: dt.datetime
    by: str = Field(description="name of the token, or of who said so where no tokens are asked for")
    team: str | None = None
    act: Act
    job: str
    about: dict[str, Any] = {}


class AuditList(Sent):
    """A page of the log, the newest first; ``next`` is the ``cursor`` of the page that follows."""

    acts: list[AuditOut]
    next: int | None = None


class FileOut(Sent):
    """A file of a job: its problem (``problem/...``) or a result."""

    name: str
    size: int = Field(description="bytes")
    sha256: str
    content_type: str


class FileList(Sent):
    """The files of a job."""

    files: list[FileOut]


class LinkOut(Sent):
    """A link to a file of a job, which asks for no token until it ends."""

    path: str = Field(description="what follows the service's address")
    expires: dt.datetime


class LookLink(Sent):
    """A link to look at a job."""

    id: str
    by: str = Field(description="name of the token that made it")
    created: dt.datetime
    expires: dt.datetime


class LinkMade(LookLink):
    """A new one, with its address."""

    path: str = Field(description="what follows the service's address, told this once")


class LookList(Sent):
    """Links to look at a job, the newest first."""

    links: list[LookLink]


class LookOut(Sent):
    """What a link to look shows of a job."""

    name: str = Field(description="the problem's name")
    title: str = ""
    state: State
    stage: str = ""
    fraction: float = 0.0
    processes: list[str] = []
    created: dt.datetime
    seconds: float | None = Field(None, description="time of planning [s]")
    issues: list[Issue] = []
    metrics: dict[str, float] = {}
    release: str | None = Field(None, description="of its programs: not-released, released or withdrawn")
    files: list[str] = Field([], description="files of the job that this link opens")
    expires: dt.datetime = Field(description="end of the link")


class NewWebhook(Sent):
    """An address to be told of jobs that end."""

    model_config = ConfigDict(extra="forbid")
    url: str = Field(max_length=500, description="https, at a host that the service's operator has named")


class WebhookOut(Sent):
    """An address that is told of jobs that end, and how that went last."""

    id: str
    url: str
    created: dt.datetime
    told: dt.datetime | None = Field(None, description="when it was tried last")
    outcome: str | None = Field(None, description="the status that was answered then, or why there was none")
    off: dt.datetime | None = Field(None, description="since it answered 410: it is told nothing more")
    waiting: int = Field(0, description="what it is still to be told")


class WebhookMade(WebhookOut):
    """A new one, with what its requests are signed with."""

    secret: str = Field(description="`whsec_` and base64, told this once")


class WebhookList(Sent):
    """Webhooks."""

    webhooks: list[WebhookOut]


class LookedAt(Sent):
    """At how many targets a check looked."""

    targets: int = Field(description="targets that were looked at")
    of: int = Field(description="targets that there are")
    placed: bool = Field(
        description="whether the block's place is stated, or found: a first look tries few places"
    )
    thinned: bool = Field(False, description="whether there are fewer targets than the plan will have")


class CheckOut(Sent):
    """What is known of a problem without planning it. ``summary``: arms, operations, and the boxes of stock
    and part [mm] in the stock's frame."""

    ok: bool = Field(description="whether nothing in the way of a plan was found")
    name: str
    digest: str
    processes: list[str]
    summary: dict[str, Any]
    issues: list[Issue]
    looked_at: LookedAt | None = Field(default=None, description="where reach was tested")


class SessionOut(Sent):
    """Who asks. Without tokens there is one user of this name, who may do all."""

    name: str = Field(description="of the token")
    role: TokenRole
    team: str | None = Field(None, description="those of its tokens see one another's jobs")
    tokens: bool = Field(description="whether this service asks for tokens")
    expires: dt.datetime | None = Field(None, description="end of the token")
    scope: TokenScope | None = Field(
        None, description="sends jobs and reads its own; reads what is released; none: all that the role may"
    )
    tag: str | None = Field(None, description="the scope's jobs are those with this tag")


class Health(Sent):
    """Whether the process works. Jobs are not counted while the database is away."""

    status: Literal["ok", "degraded"]
    version: str
    api: int = Field(description="number of this interface; it grows when something is added")
    api_oldest: int = Field(description="the oldest number that clients may be made for")
    workers: int
    queued: int | None = None
    running: int | None = None


class Ready(Sent):
    """Whether jobs are taken in and planned, and what is in the way."""

    ready: bool
    issues: list[Issue]


class Storage(Sent):
    """What a token's files take: those of its jobs, and for an hour what was only checked. Content counts
    once."""

    used_mb: float
    limit_mb: float


class Catalogue(Sent):
    """Entries by name, as plain data."""

    entries: dict[str, dict[str, Any]]
