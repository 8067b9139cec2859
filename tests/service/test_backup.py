"""Backups on both databases.

They are made while jobs arrive, end and disappear, and are restored into another store. They are refused if
something would be lost or is incomplete.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from planner.cli import service as commands
from planner.cli.command_line import app
from planner.issues import TandemError
from planner.service import backup, storage
from planner.service.models import Database, default_url
from planner.service.schema import VERSION
from planner.service.security import Auth, RefusedError, ServiceLimits
from tests.service import postgres
from tests.service.support import InProcess, named_problem


@pytest.fixture(scope="module")
def backup_case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """A backup of a service with a token and a job that has ended; the token and the job."""
    folder = tmp_path_factory.mktemp("backup")
    (folder / "data").mkdir()
    database = Database(default_url(folder / "data"))
    token = Auth(database).create_token("ann")
    database.close()
    auth = {"Authorization": f"Bearer {token}"}
    with InProcess(folder / "data", examiners=1, require_token=True) as running_service:
        job = str(running_service.post(named_problem("kept"), headers=auth).json()["id"])
        running_service.wait_for_end(job, headers=auth)
    backup.back_up(folder / "data", None, folder / "made")
    return folder / "made", token, job


def count_served_files(running_service: InProcess, **more: Any) -> int:
    """Read every file of every job of a service; how many jobs there are."""
    jobs = running_service.http.get("/v1/jobs?limit=200", **more).json()["jobs"]
    for job in jobs:
        for file in running_service.http.get(f"/v1/jobs/{job['id']}/files", **more).json()["files"]:
            content = running_service.http.get(f"/v1/jobs/{job['id']}/files/{file['name']}", **more).content
            assert hashlib.sha256(content).hexdigest() == file["sha256"]
    return len(jobs)


def expect_refusal(folder: Path, data: Path, database: str | None = None) -> str:
    with pytest.raises(TandemError) as caught:
        backup.restore(folder, data, database)
    (issue,) = caught.value.issues
    assert issue.code == "service.backup"
    assert not (data / "tandem.db").exists() or (data / "tandem.db").stat().st_size > 0
    return issue.message


@pytest.mark.parametrize(
    ("kind", "into"), [("sqlite", "postgresql"), pytest.param("postgresql", "sqlite", marks=pytest.mark.long)]
)
def test_backups_under_load_hold_what_they_list(tmp_path: Path, kind: str, into: str) -> None:
    """A backup contains everything that existed before it.

    While backups are made, two threads send and delete jobs, and the service sweeps.
    """
    database, other = (None if item == "sqlite" else postgres.fresh(tmp_path) for item in (kind, into))
    kept_jobs: list[str] = []
    ended = threading.Event()
    with InProcess(
        tmp_path / "data", ServiceLimits(open_jobs=500), examiners=1, database=database
    ) as running_service:

        def work(who: int) -> None:
            number = 0
            while not ended.is_set():
                number += 1
                job = running_service.post(named_problem(f"job{who}x{number}")).json()["id"]
                if number % 3 == 0:
                    running_service.http.delete(f"/v1/jobs/{job}")
                    running_service.service.files.sweep(running_service.service.jobs.used_shas)
                else:
                    kept_jobs.append(job)

        with ThreadPoolExecutor(2) as pool:
            busy = [pool.submit(work, who) for who in range(2)]
            while len(kept_jobs) < 3:
                time.sleep(0.02)
            before = []
            for number in range(3):
                before = list(kept_jobs)
                backup.back_up(tmp_path / "data", database, tmp_path / f"backup{number}")
            ended.set()
        for item in busy:
            item.result()
    backup.restore(tmp_path / "backup2", tmp_path / "new", other)
    with InProcess(tmp_path / "new", examiners=1, database=other) as running_service:
        for job in before:
            assert (
                running_service.wait_for_end(job)["state"] == "verified"
            )  # what ran or waited then is planned now
        assert count_served_files(running_service) >= len(before)


def test_a_job_that_goes_between_the_moment_and_its_files_is_not_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "GRACE_S", -1.0)
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        jobs = [running_service.post(named_problem(name)).json()["id"] for name in ("stays", "goes")]
        for job in jobs:
            running_service.wait_for_end(job)
        moment, moments = backup._write_snapshot, []

        def then_delete(url: str, copy: Path) -> None:
            moment(url, copy)
            moments.append(url)
            if len(moments) == 1:
                running_service.http.delete(f"/v1/jobs/{jobs[1]}")
                assert running_service.service.files.sweep(running_service.service.jobs.used_shas) > 0

        monkeypatch.setattr(backup, "_write_snapshot", then_delete)
        result = backup.back_up(tmp_path / "data", None, tmp_path / "backup")
    assert len(moments) == 2
    assert result.jobs == 1
    backup.restore(tmp_path / "backup", tmp_path / "new", None)
    with InProcess(tmp_path / "new", examiners=1) as running_service:
        assert [item["id"] for item in running_service.http.get("/v1/jobs").json()["jobs"]] == jobs[:1]
        assert count_served_files(running_service) == 1


def test_files_are_marked_as_wanted_before_they_are_copied(
    backup_case: tuple[Path, str, str], tmp_path: Path
) -> None:
    """The sweep keeps them: the job may be deleted while its files are copied."""
    data = shutil.copytree(backup_case[0], tmp_path / "data")
    files = [path for path in (data / "files").rglob("*") if path.is_file()]
    for path in files:
        storage.os.utime(path, (1.0, 1.0))
    backup.back_up(data, None, tmp_path / "backup")
    assert storage.ContentStore(data / "files").sweep(lambda shas: set()) == 0
    assert all(path.exists() for path in files)


def test_tokens_and_links_are_in_it(backup_case: tuple[Path, str, str], tmp_path: Path) -> None:
    folder, token, job = backup_case
    assert (folder.stat().st_mode & 0o077) == 0
    backup.restore(folder, tmp_path / "new", None)
    auth = {"Authorization": f"Bearer {token}"}
    with InProcess(tmp_path / "new", examiners=1, require_token=True) as running_service:
        assert running_service.http.get(f"/v1/jobs/{job}", headers=auth).json()["state"] == "verified"
        assert count_served_files(running_service, headers=auth) == 1
        assert "in use by a running service" in str(_running(folder, tmp_path / "new"))


def _running(folder: Path, data: Path) -> TandemError:
    with pytest.raises(TandemError) as caught:
        backup.restore(folder, data, None)
    return caught.value


def test_what_is_there_is_never_overwritten(backup_case: tuple[Path, str, str], tmp_path: Path) -> None:
    folder = backup_case[0]
    store = tmp_path / "store"
    store.mkdir()
    Database(default_url(store)).close()
    before = (store / "tandem.db").read_bytes()
    assert "already contains a store" in expect_refusal(folder, store)
    assert (store / "tandem.db").read_bytes() == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(TandemError, match="is not empty"):
        backup.back_up(store, None, tmp_path / "mine")
    with pytest.raises(TandemError, match="contains no store"):
        backup.back_up(tmp_path / "mine", None, tmp_path / "more")
    assert not (tmp_path / "more").exists()
    (store / "files").mkdir()
    for url in (
        "nonsense",
        "sqlite://",
        "sqlite:///:memory:",
        "sqlite:////no/such.db?timeout=soon",
        "sqlite:///no\0such.db",
        "postgresql://u:secret@host:abc/d",
        "postgresql://u:secret@127.0.0.1:1/d?password=secret&colour=red",
        "mysql://u:secret@h/d",
        "postgresql://u:secret@127.0.0.1:1/d",
        "sqlite:///no/such.db",
    ):
        with pytest.raises(TandemError) as caught:
            backup.back_up(store, url, tmp_path / "url")
        (issue,) = caught.value.issues
        assert issue.code in ("service.database", "service.backup")
        assert "secret" not in str(issue)
        with pytest.raises(TandemError) as caught:
            backup.restore(backup_case[0], tmp_path / "nowhere", url)
        (issue,) = caught.value.issues
        assert issue.code == "service.database"
        assert "secret" not in str(issue)
        assert list((tmp_path / "url").iterdir()) == []
    backup.back_up(store, None, tmp_path / "url")


def test_only_the_owner_may_read_it(
    backup_case: tuple[Path, str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also in an existing folder that is open to all, and for data that is restored into such a folder."""
    data, folder, fraction = tmp_path / "data", tmp_path / "backup", tmp_path / "share"
    for item in (data, folder, fraction):
        item.mkdir()
        item.chmod(0o755)
    backup.restore(backup_case[0], data, None)
    backup.back_up(data, None, folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    held = [path for path in (data / "files").rglob("*") if path.is_file()]
    assert held
    for path in (*held, data / "tandem.db", folder / "tandem.db"):
        assert path.stat().st_mode & 0o077 == 0, path
    monkeypatch.setattr(Path, "chmod", lambda *asked: None)
    with pytest.raises(TandemError, match="other users may read it"):
        backup.back_up(data, None, fraction)
    assert list(fraction.iterdir()) == []


@pytest.mark.parametrize("end", ["-wal", "-shm", "-journal"])
def test_logs_of_a_database_that_was_moved_away(
    backup_case: tuple[Path, str, str], tmp_path: Path, end: str
) -> None:
    """SQLite's own files: the next open would write the old store over the one that was restored."""
    data = tmp_path / "data"
    data.mkdir()
    with contextlib.closing(sqlite3.connect(data / "tandem.db")) as db:
        db.execute("PRAGMA journal_mode=WAL" if end != "-journal" else "PRAGMA journal_mode=PERSIST")
        db.execute("CREATE TABLE mine (a)")
        db.commit()
        left = data / f"tandem.db{end}"
        kept = left.read_bytes()
    (data / "tandem.db").unlink()
    left.write_bytes(kept)
    for other in {"tandem.db-wal", "tandem.db-shm", "tandem.db-journal"} - {left.name}:
        (data / other).unlink(missing_ok=True)
    for database in (None, f"sqlite:///{data / 'tandem.db'}", f"sqlite:///{tmp_path / 'other.db'}"):
        issues = expect_refusal(backup_case[0], data, database)
        assert f"folder {data}: tandem.db{end} belong to a tandem.db that is missing" in issues
        assert "move these files to that database" in issues
    assert left.read_bytes() == kept
    assert not (data / "tandem.db").exists()
    assert not (tmp_path / "other.db").exists()
    (tmp_path / f"other.db{end}").write_bytes(kept)
    issues = expect_refusal(backup_case[0], tmp_path / "new", f"sqlite:///{tmp_path / 'other.db'}")
    assert f"other.db{end} belong" in issues
    assert (tmp_path / f"other.db{end}").read_bytes() == kept
    left.unlink()
    backup.restore(backup_case[0], data, None)


def test_nor_on_postgresql(backup_case: tuple[Path, str, str], tmp_path: Path) -> None:
    url = postgres.fresh(tmp_path)
    Database(url).close()
    assert "already contains tables of Tandem" in expect_refusal(backup_case[0], tmp_path / "new", url)
    import psycopg

    with psycopg.connect(url) as connection:
        connection.execute("UPDATE tandem_schema SET version = 99")
    (tmp_path / "new" / "files").mkdir(exist_ok=True)
    with pytest.raises(TandemError, match=rf"version 99 \(expected {VERSION}\)\. Use pg_dump") as caught:
        backup.back_up(tmp_path / "new", f"{url}?password=secret", tmp_path / "backup")
    assert "secret" not in str(caught.value)


def test_an_unfinished_and_a_damaged_backup(backup_case: tuple[Path, str, str], tmp_path: Path) -> None:
    def damaged_copy(name: str) -> Path:
        return Path(shutil.copytree(backup_case[0], tmp_path / name))

    unfinished = damaged_copy("unfinished")
    (unfinished / "backup.json").unlink()
    assert "is not a complete backup" in expect_refusal(unfinished, tmp_path / "a")
    assert "is not a complete backup" in expect_refusal(tmp_path / "nowhere", tmp_path / "a")
    for content in ("", "[]", "{", '{"format": 1'):
        (unfinished / "backup.json").write_text(content)
        assert "cannot be read" in expect_refusal(unfinished, tmp_path / "a")
    (unfinished / "backup.json").write_text(json.dumps({"format": 2}))
    assert "got 2, allowed 1" in expect_refusal(unfinished, tmp_path / "a")
    for name, spoil in (("changed", lambda path: path.write_bytes(b"x")), ("lost", Path.unlink)):
        other = damaged_copy(name)
        spoil(next(path for path in (other / "files").rglob("*") if path.is_file()))
        assert "damaged" in expect_refusal(other, tmp_path / name / "new")
    torn = damaged_copy("torn")
    content = (torn / "tandem.db").read_bytes()
    (torn / "tandem.db").write_bytes(content[: len(content) // 2])
    assert "database" in expect_refusal(torn, tmp_path / "b")
    backup.restore(backup_case[0], tmp_path / "a", None)  # what was refused leaves nothing in the way


SPOILT = {
    "UPDATE tandem_files SET sha = '../../../etc/passwd'": "got name '../../../etc/passwd'",
    "UPDATE tandem_files SET sha = ''": "got name ''",
    "UPDATE tandem_files SET sha = upper(sha) || x'0a'": "a SHA-256 of 64 hexadecimal digits",
    "UPDATE tandem_files SET sha = x'00ff'": "table tandem_files: invalid row (got name",
    "UPDATE tandem_files SET size = 'many'": "size 'many'",
    "UPDATE tandem_files SET sha = CAST(x'ff' AS TEXT)": "cannot be read or written",
    "DROP TABLE tandem_files": "cannot be read or written (no such table: tandem_files)",
    "DROP TABLE tandem_jobs": "cannot be read or written (no such table: tandem_jobs)",
    "DROP TABLE tandem_tokens": "has no table tandem_tokens",
    "ALTER TABLE tandem_jobs DROP COLUMN stage": "table tandem_jobs has no stage",
    "DELETE FROM tandem_schema": "table tandem_schema has no valid version number",
    "UPDATE tandem_schema SET version = -3": "table tandem_schema has no valid version number",
}
"""Damage to the database of a backup, accidental or malicious, and the message that reports it."""


@pytest.mark.parametrize("spoil", SPOILT)
def test_a_database_that_is_none_of_a_backup(
    backup_case: tuple[Path, str, str], tmp_path: Path, spoil: str
) -> None:
    folder = shutil.copytree(backup_case[0], tmp_path / "spoilt")
    with contextlib.closing(sqlite3.connect(folder / "tandem.db")) as db:
        db.execute(spoil)
        db.commit()
    issues = expect_refusal(folder, tmp_path / "new")
    assert SPOILT[spoil] in issues
    assert "Use another backup" in issues
    assert "SELECT" not in issues
    assert not (tmp_path / "new" / "tandem.db").exists()
    assert [path for path in (tmp_path / "new").rglob("*") if "passwd" in path.name] == []


def test_a_store_that_says_no_version_is_not_opened(
    backup_case: tuple[Path, str, str], tmp_path: Path
) -> None:
    data = shutil.copytree(backup_case[0], tmp_path / "data")
    with contextlib.closing(sqlite3.connect(data / "tandem.db")) as db:
        db.execute("DELETE FROM tandem_schema")
        db.commit()
    with pytest.raises(TandemError, match=r"has no valid version number\. Restore a backup\.") as caught:
        Database(default_url(data))
    assert [issue.code for issue in caught.value.issues] == ["service.database"]


def test_a_damaged_store_is_told(backup_case: tuple[Path, str, str], tmp_path: Path) -> None:
    data = shutil.copytree(backup_case[0], tmp_path / "data")
    path = next(path for path in (data / "files").rglob("*") if path.is_file())
    path.write_bytes(b"rot")
    with pytest.raises(TandemError, match="its content does not match its name"):
        backup.back_up(data, None, tmp_path / "one")
    path.unlink()
    with pytest.raises(TandemError, match=f"file {path.name} of a job is missing"):
        backup.back_up(data, None, tmp_path / "two")
    assert list((tmp_path / "one").iterdir()) == list((tmp_path / "two").iterdir()) == []


@pytest.mark.parametrize("number", [VERSION - 1, VERSION + 1])
def test_a_store_or_backup_of_another_version_is_refused(
    backup_case: tuple[Path, str, str], tmp_path: Path, number: int
) -> None:
    """``tandem backup`` and ``tandem restore`` read one schema version, and leave no partial result."""
    data = Path(shutil.copytree(backup_case[0], tmp_path / "data"))
    with contextlib.closing(sqlite3.connect(data / "tandem.db")) as db:
        db.execute("UPDATE tandem_schema SET version = ?", (number,))
        db.commit()
    expected = f"version {number} (expected {VERSION}). Use the version of tandem-planner that created"
    assert expected in expect_refusal(data, tmp_path / "new")
    assert not (tmp_path / "new" / "tandem.db").exists()
    with pytest.raises(TandemError) as caught:
        backup.back_up(data, None, tmp_path / "backup")
    (issue,) = caught.value.issues
    assert issue.code == "service.backup"
    assert expected in issue.message
    assert list((tmp_path / "backup").iterdir()) == []


def test_the_commands(
    backup_case: tuple[Path, str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "data"
    assert app.cli(args=["restore", str(backup_case[0]), "--data", str(data)]) == 0
    assert app.cli(args=["backup", str(tmp_path / "again"), "--data", str(data)]) == 0
    assert app.cli(args=["restore", str(backup_case[0]), "--data", str(data)]) == 2
    output = capsys.readouterr()
    assert "restored 1 jobs" in output.out
    assert f"{tmp_path / 'again'}: a backup of 1 jobs" in output.out
    assert "service.backup" in output.out + output.err
    assert commands.DATA_FOLDER == commands.BackUp(tmp_path).data == commands.Serve().data


def test_a_restored_store_names_the_tokens_that_it_brings_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Tokens that were revoked after the backup are in force again; the command names all of them."""
    data = tmp_path / "data"
    data.mkdir()
    database = Database(default_url(data))
    auth = Auth(database)
    token = auth.create_token("left_since")
    auth.create_token("left_before")
    auth.revoke("left_before")
    database.close()
    (data / backup.FILES_FOLDER).mkdir()
    backup.back_up(data, None, tmp_path / "made")
    commands.token(commands.Revoke(name="left_since", data=data))
    capsys.readouterr()
    commands.restore(commands.Restore(folder=tmp_path / "made", data=tmp_path / "new"))
    output = " ".join(capsys.readouterr().out.split())
    assert "valid as at the backup: left_since, with their links" in output
    assert "left_before" not in output
    restored = Database(default_url(tmp_path / "new"))
    assert Auth(restored).authenticate_token(token).name == "left_since"
    restored.close()
    commands.token(commands.Revoke(name="left_since", data=tmp_path / "new"))
    restored = Database(default_url(tmp_path / "new"))
    with pytest.raises(RefusedError, match="revoked"):
        Auth(restored).authenticate_token(token)
    restored.close()
