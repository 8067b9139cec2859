"""A store of an older version is brought up to date at start, with what it holds; a newer one is refused."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import create_engine, inspect

from planner.issues import TandemError
from planner.service import schema
from planner.service.models import Database, default_url
from tests.service import postgres
from tests.service.support import InProcess

STORES = {
    int(path.stem.rpartition("_")[2]): path.read_text()
    for path in (Path(__file__).parent / "stores").glob("version_*.sql")
}
"""Stores of all older versions, as SQL."""
TOKEN = "tandem_0123456789abcdef_" + "a" * 43


def old_store(data: Path, version: int = 1) -> Path:
    data.mkdir()
    with sqlite3.connect(data / "tandem.db") as db:
        db.executescript(STORES[version])
    return data


def tables(url: str) -> dict[str, Any]:
    """Columns, keys and indexes, as the database itself tells them."""
    engine = create_engine(url)
    seen = inspect(engine)
    found = {
        name: (
            sorted((c["name"], str(c["type"]), c["nullable"]) for c in seen.get_columns(name)),
            sorted(seen.get_pk_constraint(name)["constrained_columns"]),
            sorted((str(i["name"]), i["column_names"]) for i in seen.get_indexes(name)),
        )
        for name in seen.get_table_names()
    }
    engine.dispose()
    return found


def version(data: Path) -> list[tuple[int]]:
    with sqlite3.connect(data / "tandem.db") as db:
        return db.execute("SELECT version FROM tandem_schema").fetchall()


def test_there_is_a_store_of_each_older_version() -> None:
    assert sorted(STORES) == sorted(schema.STEPS) == list(range(1, schema.VERSION))


@pytest.mark.parametrize("old", STORES)
def test_an_old_store_becomes_what_a_new_one_is_and_is_served(tmp_path: Path, old: int) -> None:
    data, new = old_store(tmp_path / "old", old), tmp_path / "new"
    new.mkdir()
    with InProcess(data, require_token=True) as here:
        auth = {"Authorization": f"Bearer {TOKEN}"}
        (job,) = here.http.get("/v1/jobs", headers=auth).json()["jobs"]
        assert (job["id"], job["name"], job["state"]) == ("ab" * 16, "panel", "infeasible")
    Database(default_url(new)).close()
    assert tables(default_url(data)) == tables(default_url(new))
    assert version(data) == version(new) == [(schema.VERSION,)]
    Database(default_url(data)).close()  # once more: nothing is left to do
    assert version(data) == [(schema.VERSION,)]


@pytest.mark.parametrize("of", STORES)
def test_the_same_on_postgresql(tmp_path: Path, of: int) -> None:
    old, new = postgres.fresh(tmp_path), postgres.fresh(tmp_path)
    import psycopg

    with psycopg.connect(old) as connection:
        for one in STORES[of].split(";\n"):
            begin = max(one.find("CREATE"), one.find("INSERT"))
            if begin >= 0:
                connection.execute(one[begin:].encode())
    for url in (old, new):
        Database(url).close()
    driver = "postgresql+psycopg://"
    assert tables(old.replace("postgresql://", driver)) == tables(new.replace("postgresql://", driver))
    with psycopg.connect(old) as connection:
        assert connection.execute("SELECT name FROM tandem_jobs").fetchall() == [("panel",)]


def test_a_step_that_fails_leaves_the_store_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = old_store(tmp_path / "old")
    before = tables(default_url(data))
    monkeypatch.setattr(schema, "STEPS", {1: (*schema.STEPS[1], "CREATE TABLE tandem_jobs (id INTEGER)")})
    with pytest.raises(TandemError, match="already exists"):
        Database(default_url(data))
    assert tables(default_url(data)) == before


def test_a_newer_store_is_refused_and_left_alone(tmp_path: Path) -> None:
    Database(default_url(tmp_path)).close()
    with sqlite3.connect(tmp_path / "tandem.db") as db:
        db.execute("UPDATE tandem_schema SET version = 99")
    with pytest.raises(TandemError) as caught:
        Database(default_url(tmp_path))
    (issue,) = caught.value.issues
    assert issue.code == "service.database"
    for said in ("version 99", f"knows {schema.VERSION}", "update tandem-planner", "copy of the data"):
        assert said in issue.message
    assert version(tmp_path) == [(99,)]
