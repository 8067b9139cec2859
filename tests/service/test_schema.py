"""A store with another schema version is refused and is not changed."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

import pytest
from sqlalchemy import Engine, create_engine, text

from planner.cli.command_line import app
from planner.issues import TandemError
from planner.service.models import METADATA, Database, default_url
from planner.service.schema import VERSION, version_of
from tests.service import postgres

REMEDIES = {
    VERSION - 1: "Older versions are not migrated. Use an empty data folder or database",
    VERSION + 1: "Update tandem-planner on this machine",
}
"""Versions that are refused, and the remedy that the message states."""


def store(tmp_path: Path, kind: str) -> str:
    """Create a store, and return the URL of its database."""
    url = postgres.fresh(tmp_path) if kind == "postgresql" else default_url(tmp_path)
    Database(url).close()
    return url


def make_engine(url: str) -> Engine:
    return create_engine(url.replace("postgresql://", "postgresql+psycopg://"))


def change(url: str, statement: str) -> None:
    """Execute one statement in a database."""
    engine = make_engine(url)
    with engine.begin() as connection:
        connection.execute(text(statement))
    engine.dispose()


def version(url: str) -> int | None:
    """Read the version of a store."""
    engine = make_engine(url)
    with engine.connect() as connection:
        result = version_of(connection)
    engine.dispose()
    return result


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_new_store_has_the_current_version_and_opens_again(tmp_path: Path, kind: str) -> None:
    url = store(tmp_path, kind)
    assert version(url) == VERSION
    Database(url).close()
    assert version(url) == VERSION


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
@pytest.mark.parametrize("number", REMEDIES)
def test_a_store_of_another_version_is_refused_and_not_changed(
    tmp_path: Path, kind: str, number: int
) -> None:
    url = store(tmp_path, kind)
    change(url, f"UPDATE tandem_schema SET version = {number}")
    with pytest.raises(TandemError) as caught:
        Database(url)
    (issue,) = caught.value.issues
    assert (issue.code, issue.field) == ("service.database", "database")
    assert f"has tables of version {number} (expected {VERSION}). {REMEDIES[number]}" in issue.message
    assert version(url) == number


def test_a_store_without_a_version_table_is_refused_and_not_changed(tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / "tandem.db")) as db:
        db.execute("CREATE TABLE tandem_jobs (id VARCHAR(32) NOT NULL, PRIMARY KEY (id))")
    with pytest.raises(TandemError, match=r"has no valid version number\. Restore a backup\."):
        Database(default_url(tmp_path))
    with contextlib.closing(sqlite3.connect(tmp_path / "tandem.db")) as db:
        names = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    assert names == ["tandem_jobs"]
    assert len(METADATA.tables) > 1


@pytest.mark.parametrize("number", REMEDIES)
@pytest.mark.parametrize("command", [["serve"], ["token", "list"]])
def test_commands_state_the_remedy_and_exit_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str], number: int
) -> None:
    change(store(tmp_path, "sqlite"), f"UPDATE tandem_schema SET version = {number}")
    assert app.cli(args=[*command, "--data", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    output = " ".join((captured.out + captured.err).split())
    assert "service.database" in output
    assert REMEDIES[number] in output
