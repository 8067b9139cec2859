"""The tables of the store: the same on SQLite and PostgreSQL. Times are seconds since 1970 (UTC)."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Column, Float, Index, Integer, MetaData, String, Table, Text

METADATA: Final = MetaData()

TOKENS: Final = Table(
    "tandem_tokens",
    METADATA,
    Column("id", String(32), primary_key=True),
    Column("name", String(64), nullable=False, unique=True),
    Column("hash", String(64), nullable=False, unique=True),
    Column("created", Float, nullable=False),
    Column("revoked", Float),
)
"""Who may use the service. Only the SHA-256 of a token is kept."""

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
    Index("tandem_jobs_by_owner", "owner", "created", "id"),
)
"""``key``: what the answer depends on, the problem's digest and the versions. ``host`` works on the job until
``lease``. ``seq`` is the number of the job's last event. ``cancel``: 1 cancelled, 2 deleted too."""

FILES: Final = Table(
    "tandem_files",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("name", String(255), primary_key=True),
    Column("sha", String(64), nullable=False, index=True),
    Column("size", Integer, nullable=False),
)
"""A job's problem (``problem/...``) and its results, by the names of a result folder."""

EVENTS: Final = Table(
    "tandem_events",
    METADATA,
    Column("job", String(32), primary_key=True),
    Column("seq", Integer, primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("data", Text, nullable=False),
    Column("at", Float, nullable=False),
)
