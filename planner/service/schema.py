"""The version of the store's tables, and the steps from older ones.

A store says its version in ``tandem_schema``; one of before there were versions has no such table and is
version 1. At start an older store is brought up to date by the steps that it lacks, in the transaction that
looked, so that all of it happens or nothing; a newer one is refused. Steps are literal SQL that SQLite and
PostgreSQL both read: they stay as they were when the tables in :mod:`planner.service.models` move on.

What Alembic would add to them are branches, ways back and steps derived from tables, none of which a store
that only goes forward, in one transaction at start, has a use for.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from sqlalchemy import Connection, MetaData, inspect, text

VERSION: Final = 8
"""Version of the tables that this program reads and writes."""
UNNUMBERED: Final = 1
"""Version of a store that has jobs and does not say which it is."""
_NUMBER: Final = "CREATE TABLE tandem_schema (version INTEGER NOT NULL, PRIMARY KEY (version))"
STEPS: Final[Mapping[int, tuple[str, ...]]] = {
    1: (
        # tables that the earliest stores got at their next start
        "CREATE TABLE IF NOT EXISTS tandem_secrets (name VARCHAR(32) NOT NULL, value VARCHAR(64) NOT NULL, "
        "PRIMARY KEY (name))",
        "CREATE TABLE IF NOT EXISTS tandem_element_jobs (job VARCHAR(32) NOT NULL, "
        "element VARCHAR(32) NOT NULL, role VARCHAR(16) NOT NULL, panel VARCHAR(32) NOT NULL, "
        '"like" VARCHAR(32), about TEXT NOT NULL, PRIMARY KEY (job))',
        "CREATE INDEX IF NOT EXISTS ix_tandem_element_jobs_element ON tandem_element_jobs (element)",
        _NUMBER,
    ),
    2: (
        "CREATE TABLE tandem_keys (owner VARCHAR(32) NOT NULL, hash VARCHAR(64) NOT NULL, "
        "number INTEGER NOT NULL, job VARCHAR(32) NOT NULL, content VARCHAR(64) NOT NULL, "
        "created FLOAT NOT NULL, PRIMARY KEY (owner, hash, number))",
        "CREATE INDEX ix_tandem_keys_job ON tandem_keys (job)",
    ),
    3: (
        "CREATE TABLE tandem_webhooks (id VARCHAR(32) NOT NULL, owner VARCHAR(32) NOT NULL, "
        "url VARCHAR(500) NOT NULL, secret VARCHAR(128) NOT NULL, created FLOAT NOT NULL, told FLOAT, "
        "outcome VARCHAR(200), off FLOAT, PRIMARY KEY (id))",
        "CREATE INDEX ix_tandem_webhooks_owner ON tandem_webhooks (owner)",
        "CREATE TABLE tandem_deliveries (id VARCHAR(64) NOT NULL, webhook VARCHAR(32) NOT NULL, "
        "body TEXT NOT NULL, due FLOAT NOT NULL, attempts INTEGER NOT NULL, PRIMARY KEY (id))",
        "CREATE INDEX ix_tandem_deliveries_webhook ON tandem_deliveries (webhook)",
        "CREATE INDEX ix_tandem_deliveries_due ON tandem_deliveries (due)",
    ),
    4: (
        # tokens of before there were roles could do all, and go on so
        "ALTER TABLE tandem_tokens ADD COLUMN role VARCHAR(16) NOT NULL DEFAULT 'release'",
        "ALTER TABLE tandem_tokens ADD COLUMN team VARCHAR(64)",
        "ALTER TABLE tandem_tokens ADD COLUMN expires FLOAT",
        "ALTER TABLE tandem_jobs ADD COLUMN releases INTEGER NOT NULL DEFAULT 0",
        "CREATE TABLE tandem_releases (job VARCHAR(32) NOT NULL, number INTEGER NOT NULL, "
        "token VARCHAR(32) NOT NULL, who VARCHAR(200) NOT NULL, at FLOAT NOT NULL, note TEXT NOT NULL, "
        "digest VARCHAR(64) NOT NULL, proof VARCHAR(64) NOT NULL, programs TEXT NOT NULL, "
        "withdrawn FLOAT, withdrawn_token VARCHAR(32), withdrawn_who VARCHAR(200), reason TEXT, "
        "PRIMARY KEY (job, number))",
        "CREATE TABLE tandem_audit (number INTEGER NOT NULL, at FLOAT NOT NULL, token VARCHAR(32) NOT NULL, "
        "who VARCHAR(200) NOT NULL, team VARCHAR(64), act VARCHAR(16) NOT NULL, job VARCHAR(32) NOT NULL, "
        "about TEXT NOT NULL, PRIMARY KEY (number))",
        "CREATE INDEX ix_tandem_audit_token ON tandem_audit (token)",
        "CREATE INDEX ix_tandem_audit_team ON tandem_audit (team)",
        "CREATE INDEX ix_tandem_audit_job ON tandem_audit (job)",
        "ALTER TABLE tandem_jobs ADD COLUMN title VARCHAR(200) NOT NULL DEFAULT ''",
        "ALTER TABLE tandem_jobs ADD COLUMN tags TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE tandem_jobs ADD COLUMN notes TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE tandem_jobs ADD COLUMN label VARCHAR(200) NOT NULL DEFAULT ''",
        "ALTER TABLE tandem_jobs ADD COLUMN sought TEXT NOT NULL DEFAULT ''",
        "UPDATE tandem_jobs SET label = lower(name), sought = lower(name)",  # names are plain letters
    ),
    5: (
        "ALTER TABLE tandem_jobs ADD COLUMN turn FLOAT NOT NULL DEFAULT 0",
        "UPDATE tandem_jobs SET turn = created",
        "CREATE TABLE tandem_drafts (id VARCHAR(32) NOT NULL, owner VARCHAR(32) NOT NULL, "
        "kind VARCHAR(16) NOT NULL, title VARCHAR(200) NOT NULL, version INTEGER NOT NULL, "
        "created FLOAT NOT NULL, changed FLOAT NOT NULL, PRIMARY KEY (id))",
        "CREATE INDEX ix_tandem_drafts_owner ON tandem_drafts (owner)",
        "CREATE TABLE tandem_draft_versions (draft VARCHAR(32) NOT NULL, number INTEGER NOT NULL, "
        "at FLOAT NOT NULL, who VARCHAR(200) NOT NULL, problem VARCHAR(64) NOT NULL, files TEXT NOT NULL, "
        "PRIMARY KEY (draft, number))",
        "CREATE TABLE tandem_links (id VARCHAR(32) NOT NULL, job VARCHAR(32) NOT NULL, "
        "token VARCHAR(32) NOT NULL, who VARCHAR(200) NOT NULL, created FLOAT NOT NULL, "
        "expires FLOAT NOT NULL, PRIMARY KEY (id))",
        "CREATE INDEX ix_tandem_links_job ON tandem_links (job)",
    ),
    6: (
        "ALTER TABLE tandem_drafts ADD COLUMN job VARCHAR(32)",
        "ALTER TABLE tandem_drafts ADD COLUMN sent INTEGER",
    ),
    7: (
        "ALTER TABLE tandem_tokens ADD COLUMN scope VARCHAR(16)",
        "ALTER TABLE tandem_tokens ADD COLUMN tag VARCHAR(40)",
    ),
}
"""What brings a store of each version to the next one."""


class NewerError(Exception):
    """A store of a version that this program does not know."""

    def __init__(self, version: int) -> None:
        self.version = version
        super().__init__(
            f"has tables of version {version}, this program knows {VERSION} and older ones; "
            "update tandem-planner on this machine, or take the copy of the data that was made before"
        )


class NoVersionError(Exception):
    """A store that does not say its version: it is damaged, or no store."""

    def __init__(self) -> None:
        super().__init__(
            "its table tandem_schema has no whole number as version; it is damaged: take a copy, or a backup"
        )


def version_of(connection: Connection) -> int | None:
    """The version of a store; None where there is none yet. Raises :class:`NoVersionError`."""
    there = set(inspect(connection).get_table_names())
    if "tandem_schema" in there:
        found = connection.execute(text("SELECT max(version) FROM tandem_schema")).scalar_one()
        if not isinstance(found, int) or found < UNNUMBERED:
            raise NoVersionError
        return found
    return UNNUMBERED if "tandem_jobs" in there else None


def bring_up_to_date(connection: Connection, tables: MetaData) -> None:
    """Make the tables of an empty store, or take the steps that one lacks, in the connection's transaction;
    others wait meanwhile. Raises :class:`NewerError` and :class:`NoVersionError`."""
    found = version_of(connection)
    if found is not None and found > VERSION:
        raise NewerError(found)
    if found is None:
        tables.create_all(connection)
    else:
        for version in range(found, VERSION):
            for step in STEPS[version]:
                connection.execute(text(step))
    if found != VERSION:
        connection.execute(text("DELETE FROM tandem_schema"))
        connection.execute(text("INSERT INTO tandem_schema (version) VALUES (:v)"), {"v": VERSION})
