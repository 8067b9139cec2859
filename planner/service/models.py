"""Data models of the service: tables of its store, and models of the API.

**Store** (`Database`): tables, the connection to SQLite or PostgreSQL, and the clock that all hosts share.
The tables are the same on both databases. Times are seconds since 1970 (UTC). A transaction is on disk when
it ends.

**API** (`Sent`): models from which the OpenAPI document is generated. Problems are read by the models of
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

from planner.issues import Issue, TandemError, issue_error
from planner.service.schema import VERSION, NoVersionError, SchemaVersionError, create_or_check

MAX_TAG_LENGTH: Final = 40
"""Maximum number of characters of a tag."""
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
    Column("tag", String(MAX_TAG_LENGTH)),
)
"""API tokens and what they permit. Only the SHA-256 of a token is stored."""

SESSIONS: Final = Table(
    "tandem_sessions",
    METADATA,
    Column("hash", String(64), primary_key=True),
    Column("token", String(32), nullable=False),
    Column("expires", Float, nullable=False),
)
"""Sessions of browsers that sent a token once: the SHA-256 of their cookie."""

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
"""Jobs.

- ``key``: hash of all that the answer depends on: the digest of the problem and the program versions.
- ``host`` works on the job until ``lease``.
- ``seq``: number of the last event.
- ``cancel``: 1 cancelled, 2 deleted too.
- ``releases``: number of the last release.
- ``tags``: each between line ends.
- ``label``: case-folded title or name, by which jobs are sorted.
- ``sought``: case-folded text that is searched.
- ``turn``: order in which queued jobs are planned. It is the creation time unless the owner has changed it.
"""

CANCELLED: Final = 1
"""Value of the column `cancel`: the owner wants the job to stop."""
DELETED: Final = 2
"""Value of the column `cancel`: the owner wants the job to stop and to be deleted."""

FILES: Final = Table(
    "tandem_files",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("name", String(255), primary_key=True),
    Column("sha", String(64), nullable=False, index=True),
    Column("size", Integer, nullable=False),
)
"""Problem (``problem/...``) and results of a job, by the names of a result folder."""

SECRETS: Final = Table(
    "tandem_secrets",
    METADATA,
    Column("name", String(32), primary_key=True),
    Column("value", String(64), nullable=False),
)
"""Secrets with which all hosts of a store sign, by purpose."""
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
"""Jobs of building elements, by ``role``.

- ``division``: divides the element, whose id is that of this job. ``about`` contains the fields that may be
  changed.
- ``panel``: plans the panel or raw-block job with that id. ``like`` is the job whose plan is the reference
  plan.
- ``report``: reports on planned panels.
"""

EVENTS: Final = Table(
    "tandem_events",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("seq", Integer, primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("data", Text, nullable=False),
    Column("at", Float, nullable=False),
)
"""Numbered events of jobs, for event streams."""

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
"""Jobs that a request with an idempotency key created, by ``number``.

Stored are the SHA-256 of the key, and of the ``content`` of the request.
"""

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
"""Addresses that are notified when a job of the owner has ended.

- ``told``: time of the last attempt. ``outcome``: its result.
- ``off``: time since which the address has answered that it is gone.
"""

DELIVERIES: Final = Table(
    "tandem_deliveries",
    METADATA,
    Column("id", String(64), primary_key=True),
    Column("webhook", String(32), nullable=False, index=True),
    Column("body", Text, nullable=False),
    Column("due", Float, nullable=False, index=True),
    Column("attempts", Integer, nullable=False),
)
"""Pending notifications of webhooks, the time from which each is due, and the number of attempts."""

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
"""Releases of the programs of a job, by ``number`` from 1.

A release records who released, the digest of the problem, the SHA-256 of the proof and of each program by
name, and who withdrew it. Only the last release of a job can be in force.
"""

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
"""Audit log in the order of ``number``. Entries outlive jobs and tokens."""

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
"""View links of jobs that were not withdrawn: creator and expiry time."""

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
"""Drafts: unfinished problems, and kept cells, tools and templates, by ``kind``.

``version`` is the number of the last version, ``sent`` the one that was submitted last, and ``job`` its
job. The content is in `FILES` under the id of the draft, by its hash.
"""

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
"""Versions of drafts: SHA-256 of the ``problem``, and of the ``files`` by name."""

SCHEMA: Final = Table(
    "tandem_schema", METADATA, Column("version", Integer, primary_key=True, autoincrement=False)
)
"""Version of these tables, :data:`planner.service.schema.VERSION`."""

POOL_SIZE: Final = 20
"""Number of database connections that stay open. As many more may be opened temporarily."""
MAX_WAIT_S: Final = 120.0
"""Maximum time [s] that a request waits for a connection or for another writer."""
MAX_CONNECT_S: Final = 10
"""Maximum time [s] of a new connection to PostgreSQL."""


class Database:
    """One database. Threads may share it."""

    def __init__(self, url: str) -> None:
        """Open the database and create or check its tables.

        Args:
            url: URL of the database.

        Raises:
            TandemError: ``service.database``, it cannot be opened.
        """
        self._lock = threading.Lock()
        self.newer_version: SchemaVersionError | None = None
        """Set once another program has changed the tables to a newer version."""
        try:
            self._engine = open_engine(url)
            self.sqlite = self._engine.dialect.name == "sqlite"
            with self._engine.execution_options(write=True).begin() as connection:
                if not self.sqlite:  # one host at a time may create the tables
                    connection.execute(text("SELECT pg_advisory_xact_lock(7223)"))
                create_or_check(connection, METADATA)
        except (SchemaVersionError, NoVersionError) as error:
            self._engine.dispose()
            remedy = error.remedy if isinstance(error, SchemaVersionError) else "Restore a backup."
            message = f"database {redacted_url(url)}: {error}. {remedy}"
            raise issue_error("service.database", message, field="database") from error
        except (DBAPIError, ArgumentError, NoSuchModuleError, ImportError) as error:
            raise TandemError(cannot_open(url, error)) from error
        self._writer = self._engine.execution_options(write=True)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Open a read-only transaction."""
        with self._engine.begin() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Open a transaction that writes all or nothing."""
        if self.sqlite:  # has a single writer, for which threads of this process wait in turn
            with self._lock, self._writer.begin() as connection:
                yield connection
        else:
            with self._writer.begin() as connection:
                yield connection

    def ping(self) -> None:
        """Run a trivial query.

        Raises:
            SQLAlchemyError: The database is unavailable.
        """
        with self.read() as db:
            db.execute(text("SELECT 1"))

    def check_version(self, connection: Connection) -> None:
        """Check that no other program has changed the tables to a newer version.

        Raises:
            SchemaVersionError: The tables have a newer version.
        """
        version = connection.execute(text("SELECT max(version) FROM tandem_schema")).scalar()
        if isinstance(version, int) and version > VERSION:
            self.newer_version = SchemaVersionError(version)
            raise self.newer_version

    def clock(self) -> ColumnElement[float]:
        """Return the present time [s since 1970] by the clock that all hosts of this database share."""
        if self.sqlite:
            return literal(time.time(), Float)
        return cast(extract("epoch", func.clock_timestamp()), Float)

    def lock(self, connection: Connection, name: str) -> None:
        """Take an advisory lock until the transaction ends. SQLite has a single writer anyway.

        Args:
            connection: Open transaction.
            name: Name of the lock.
        """
        if not self.sqlite:
            number = zlib.crc32(name.encode())
            connection.execute(text("SELECT pg_advisory_xact_lock(7224, :n)"), {"n": number - 2**31})

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


def utc(seconds: float) -> dt.datetime:
    """Convert a time of the store [s since 1970] to a time of the API."""
    return dt.datetime.fromtimestamp(seconds, dt.UTC)


def format_time(at: dt.datetime) -> str:
    """Format a time for messages."""
    return f"{at:%Y-%m-%d %H:%M:%S UTC}"


def default_url(data: Path) -> str:
    """Return the URL of the SQLite file in the data folder."""
    return f"sqlite:///{data.resolve() / 'tandem.db'}"


def open_engine(url: str) -> Engine:
    """Create the connection pool of a database. Its tables are not touched.

    Args:
        url: URL of the database.

    Raises:
        ArgumentError: Not a URL, or an SQLite database in memory.
        NoSuchModuleError: Unknown driver.
        ImportError: The driver is not installed.
    """
    if url.startswith(("postgres://", "postgresql://")):
        url = "postgresql+psycopg://" + url.split("://", 1)[1]
    try:
        parts = make_url(url)
        kind = parts.get_backend_name()
        if kind not in ("sqlite", "postgresql"):
            raise ArgumentError(f"got {kind}")
        name = parts.database or ""
        if "\0" in url or (kind == "sqlite" and name in ("", ":memory:")):
            raise ArgumentError("names no file")  # an in-memory database ends with its connection
        connect_args = {"timeout": MAX_WAIT_S} if kind == "sqlite" else {"connect_timeout": MAX_CONNECT_S}
        engine = create_engine(
            url,
            pool_size=POOL_SIZE,
            max_overflow=POOL_SIZE,
            pool_timeout=MAX_WAIT_S,
            pool_pre_ping=kind != "sqlite",
            connect_args=connect_args,
            hide_parameters=True,  # keeps token hashes and user data out of logged errors
        )
    except (ValueError, TypeError) as error:  # a port or an option that is not a number
        raise ArgumentError("has a part that cannot be read") from error
    if kind == "sqlite":
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: Any, record: Any) -> None:
    """Enable the write-ahead log and full synchronisation.

    Readers never wait, and commits survive a power cut. The driver must not start transactions of its own.
    """
    del record
    connection.isolation_level = None
    for pragma in ("journal_mode=WAL", "synchronous=FULL"):
        connection.execute(f"PRAGMA {pragma}").close()


def _begin_sqlite(connection: Connection) -> None:
    """Begin a transaction. One that writes takes the lock at once, so that it cannot fail half-way."""
    writes = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def error_reason(error: DBAPIError) -> str:
    """Return the error text of a database in one line, without the statement and its values."""
    return (str(error.orig).splitlines() or [type(error.orig).__name__])[0][:200]


def cannot_open(url: str, error: Exception) -> Issue:
    """Return the issue for a database that cannot be opened.

    Args:
        url: URL of the database.
        error: Error of the database.
    """
    if isinstance(error, ImportError):
        message = "the PostgreSQL driver is missing. Run pip install 'tandem-planner[service,postgres]'."
    elif isinstance(error, DBAPIError):
        message = f"cannot be opened ({error_reason(error)}). Check that it is running and writable."
    else:
        message = "invalid URL. Give sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME."
    return Issue("service.database", f"database {redacted_url(url)}: {message}", field="database")


def redacted_url(url: str) -> str:
    """Return a database URL for messages, without user, password and options.

    Options may contain a password too.
    """
    return url.split("@")[-1].split("?")[0]


API: Final = 17
"""Number of the API under ``/v1``. It is increased when something is added.

- 2: links
- 3: elements, motion as data
- 4: readiness, retry
- 5: quick checks, ETags of lists
- 6: idempotency keys
- 7: webhooks
- 8: roles and teams of tokens
- 9: releases
- 10: audit log
- 11: titles, tags and notes, search, deletion of many jobs
- 12: drawing of a cell, maps of a freedom
- 13: drafts, order of the queue, sweeps, estimates, view links
- 14: pages of drafts and which were submitted, releases of panels, batches, titles of elements
- 15: thumbnails of jobs, titles of drafts that follow the name of the problem
- 16: scopes of tokens, thumbnails of panels, quick checks of coarser paths
- 17: raw-block jobs of elements
"""
MIN_CLIENT_API: Final = 1
"""Smallest API number of clients that are served. It is increased when something is removed."""
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
OPEN_STATES: Final = ("queued", "running")
"""States of jobs that have not ended."""
FINAL_STATES: Final = ("verified", "done", "infeasible", "unproven")
"""States that depend on the problem alone, so that an identical problem needs no planning."""
MARKS_FILE: Final = "progress.csv"
"""File of an element's job that records which panels are cut, glued or broken.

It is not part of the result.
"""
Role = Literal["division", "panel", "report"]
TokenRole = Literal["view", "plan", "release"]
TOKEN_ROLES: Final[tuple[TokenRole, ...]] = ("view", "plan", "release")
"""Roles of tokens. Each role includes the previous ones.

- view: read everything
- plan: create, change and delete jobs, and create links
- release: release programs
"""
TokenScope = Literal["submit", "released"]
"""Scopes of tokens, which are narrower than a role.

- submit: submit jobs and read them, for a script
- released: read released jobs, for a screen at the cell
"""
JobOrder = Literal["newest", "oldest", "title", "turn"]
Mark = Literal["cut", "glued", "broken"]
AuditAct = Literal[
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
    """Base class of API models."""

    model_config = ConfigDict(frozen=True)


class Refusal(Sent):
    """Why a request was refused, as a problem document (RFC 9457)."""

    type: Literal["about:blank"] = Field(description="always about:blank; see status and issue codes")
    title: str = Field(description="the status in words")
    status: int
    detail: str = Field(description="the messages of all issues")
    issues: list[Issue] = Field(description="everything that is wrong, by code and field")
    of: list[int] = Field([], description="index from 0 of the problem of each issue, if several were sent")


class Withdrawal(Sent):
    """Who withdrew a release, when, and why."""

    by: str
    at: dt.datetime
    reason: str


class Release(Sent):
    """Who released the programs of a job. A withdrawn release is no longer in force."""

    by: str = Field(description="name of the token, or the stated name if no tokens are required")
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
    """The releases of a job, newest first. Only the newest can be in force."""

    releases: list[ReleaseOut]


class JobOut(Sent):
    """A job.

    ``fraction`` refers to its stage. ``from_store``: an identical problem had been planned before.
    """

    id: str
    name: str = Field(description="the problem's name")
    state: State
    stage: str = Field("", description="present stage")
    fraction: float = Field(0.0, ge=0, le=1, description="completed fraction of the stage")
    processes: list[str] = []
    by: str | None = Field(None, description="name of the token that submitted it")
    digest: str = Field(description="SHA-256 over the problem's values and files")
    created: dt.datetime
    started: dt.datetime | None = None
    finished: dt.datetime | None = None
    seconds: float | None = Field(None, description="time of planning [s]")
    attempts: int = Field(0, description="number of times planning started; more than one after restarts")
    from_store: bool = False
    ahead: int | None = Field(None, description="number of queued jobs before it")
    timeout_s: float
    memory_mb: float
    issues: list[Issue] = []
    metrics: dict[str, float] = {}
    title: str = Field("", description="title, in any language")
    tags: list[str] = []
    notes: str = ""
    released: bool = Field(
        False, description="whether a named person has released the programs, and nobody has withdrawn it"
    )
    release: Release | None = Field(None, description="the last release")
    thumbnail: bool = Field(False, description="whether its file `thumbnail.png` shows the cell")


class Shown(Sent):
    """The job of a panel as the releasing person saw it."""

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
    """The panels of an element that one act released, and those that it refused."""

    releases: list[PanelRelease]
    refused: list[PanelRefused]


class Deleted(Sent):
    """The jobs that were deleted, and ids that do not exist."""

    deleted: list[str]
    unknown: list[str]


class JobList(Sent):
    """A page of jobs, newest first. ``next`` is the ``cursor`` of the next page."""

    jobs: list[JobOut]
    next: str | None = None


class ElementOut(JobOut):
    """An element: the job that divides it, and the fields that may be changed."""

    kind: str = Field("", description="kind of its panels")
    fields: dict[str, float | list[float]] = Field(
        {}, description="fields that may be changed, by path in the element file, with present values"
    )
    planned: int = Field(0, description="number of panels and raw-block jobs that were submitted")


class ElementList(Sent):
    """A page of elements."""

    elements: list[ElementOut]
    next: str | None = None


class PlannedOut(Sent):
    """A problem of an element and its job."""

    id: str
    cut_min: dict[str, float] = Field({}, description="estimated cutting time [min], by arm")
    job: str | None = Field(None, description="the job that plans it")
    digest: str | None = Field(None, description="SHA-256 over the values and files of its problem")
    state: State | Literal["not_planned"] = "not_planned"
    release: Literal["not-released", "released", "withdrawn"] | None = Field(
        None, description="release state of its programs, if they are proven"
    )
    stage: str = ""
    cycle_s: float | None = Field(None, description="time from first to last target [s]")
    thumbnail: bool = Field(False, description="whether its job has the file thumbnail.png")
    issue: Issue | None = Field(None, description="first error, if it is not proven")


class PanelOut(PlannedOut):
    """A panel of an element.

    A panel that is ``cut_in`` a job together with others has the job and state of that.
    """

    order: int | None = Field(None, description="position in the assembly order, from 1")
    block_mm: list[float] = Field(description="size of its block [mm]")
    block: str = Field("", description="the raw block that its block is cut from")
    cut_in: str | None = Field(
        None, description="raw-block job that cuts it together with others, until it has its own job"
    )
    mark: Mark | None = None


class BlockJobOut(PlannedOut):
    """A job that divides a raw block, or cuts several panels out of a part of it together."""

    block: str = Field(description="the raw block")
    said: str = Field(description="the part of the block that it cuts, and its orientation")
    panels: list[str] = Field([], description="panels that it cuts; empty if it divides the block")
    mark: Literal["cut"] | None = Field(None, description="cut, when all of its panels are marked")


class ElementPanels(ElementOut):
    """An element with its panels, once it is divided."""

    panels: list[PanelOut] = []
    block_jobs: list[BlockJobOut] = Field([], description="raw-block jobs, those of a block in cutting order")
    counts: dict[str, int] = Field({}, description="number of panels by state, and by mark")
    cut_h: dict[str, float] = Field({}, description="estimated time of all cuts [h], by arm")
    told: list[str] = Field([], description="progress, and what to cut and glue next")
    report: JobOut | None = Field(None, description="job of the last report on its panels")


class Change(Sent):
    """New values of fields of an element file, by their paths."""

    model_config = ConfigDict(extra="forbid")
    fields: dict[str, Any] = Field(max_length=100)


class Chosen(Sent):
    """Panels and raw-block jobs by id.

    None: all that are not planned yet; panels that are cut together with others are planned by the job of
    their row.
    """

    model_config = ConfigDict(extra="forbid")
    panels: list[str] | None = Field(None, max_length=10_000)


class Marking(Sent):
    """A panel and its new mark.

    ``open`` removes the mark. The id of a raw-block job means all panels that it cuts, or the job itself if
    it divides the block.
    """

    model_config = ConfigDict(extra="forbid")
    panel: str = Field(max_length=32)
    state: Literal["cut", "glued", "broken", "open"]


class AuditOut(Sent):
    """An action.

    ``about`` contains the name of the job and further details: the digests of a release, or the file of a
    download, whether it was released at that time, and whether a link was used.
    """

    number: int
    at: dt.datetime
    by: str = Field(description="name of the token, or the stated name if no tokens are required")
    team: str | None = None
    act: AuditAct
    job: str
    about: dict[str, Any] = {}


class AuditList(Sent):
    """A page of the audit log, newest first. ``next`` is the ``cursor`` of the next page."""

    acts: list[AuditOut]
    next: int | None = None


class FileOut(Sent):
    """A file of a job: its problem (``problem/...``) or a result."""

    name: str
    size: int = Field(description="size [bytes]")
    sha256: str
    content_type: str


class FileList(Sent):
    """The files of a job."""

    files: list[FileOut]


class LinkOut(Sent):
    """A link to a file of a job, which requires no token until it expires."""

    path: str = Field(description="path to append to the address of the service")
    expires: dt.datetime


class LookLink(Sent):
    """A view link of a job."""

    id: str
    by: str = Field(description="name of the token that created it")
    created: dt.datetime
    expires: dt.datetime


class LinkMade(LookLink):
    """A new view link with its address."""

    path: str = Field(description="path to append to the address of the service; shown only once")


class LookList(Sent):
    """View links of a job, newest first."""

    links: list[LookLink]


class LookOut(Sent):
    """What a view link shows of a job."""

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
    release: str | None = Field(None, description="of its programs: not-released, released, withdrawn")
    files: list[str] = Field([], description="files of the job that this link opens")
    expires: dt.datetime = Field(description="end of the link")


class NewWebhook(Sent):
    """An address to notify when jobs end."""

    model_config = ConfigDict(extra="forbid")
    url: str = Field(max_length=500, description="https URL at a host that the operator has allowed")


class WebhookOut(Sent):
    """An address that is notified when jobs end, and the result of the last attempt."""

    id: str
    url: str
    created: dt.datetime
    told: dt.datetime | None = Field(None, description="time of the last attempt")
    outcome: str | None = Field(None, description="HTTP status of the last attempt, or why there was none")
    off: dt.datetime | None = Field(None, description="when it answered 410, since when it is disabled")
    waiting: int = Field(0, description="number of pending notifications")


class WebhookMade(WebhookOut):
    """A new webhook with the secret that signs its requests."""

    secret: str = Field(description="`whsec_` and base64; shown only once")


class WebhookList(Sent):
    """Webhooks."""

    webhooks: list[WebhookOut]


class LookedAt(Sent):
    """Number of targets that a check sampled."""

    targets: int = Field(description="number of sampled targets")
    of: int = Field(description="number of all targets")
    placed: bool = Field(
        description="whether the block's pose is stated or was found; a quick check tries few poses"
    )
    thinned: bool = Field(False, description="whether the plan will have more targets")


class CheckOut(Sent):
    """Result of a check without planning.

    ``summary``: arms, operations, and the boxes of stock and part [mm] in the frame of the stock.
    """

    ok: bool = Field(description="whether no error was found")
    name: str
    digest: str
    processes: list[str]
    summary: dict[str, Any]
    issues: list[Issue]
    looked_at: LookedAt | None = Field(default=None, description="sampled targets, if reach was tested")


class SessionOut(Sent):
    """The authenticated caller. Without tokens there is one user with this name, who may do everything."""

    name: str = Field(description="name of the token")
    role: TokenRole
    team: str | None = Field(None, description="tokens of a team see one another's jobs")
    tokens: bool = Field(description="whether this service requires tokens")
    expires: dt.datetime | None = Field(None, description="expiry time of the token")
    scope: TokenScope | None = Field(
        None, description="submit: jobs of this token; released: released jobs; none: everything of the role"
    )
    tag: str | None = Field(None, description="the scope is limited to jobs with this tag")


class Health(Sent):
    """Whether the process works. Jobs are not counted while the database is unavailable."""

    status: Literal["ok", "degraded"]
    version: str
    api: int = Field(description="number of this API; it increases when something is added")
    api_oldest: int = Field(description="smallest API number of clients that are served")
    workers: int
    queued: int | None = None
    running: int | None = None


class Ready(Sent):
    """Whether jobs are accepted and planned, and if not, why."""

    ready: bool
    issues: list[Issue]


class Storage(Sent):
    """Size of a token's files: those of its jobs, and for an hour those that were only checked.

    Equal content counts once.
    """

    used_mb: float
    limit_mb: float


class Catalogue(Sent):
    """Entries by name, as plain data."""

    entries: dict[str, dict[str, Any]]
