"""Online backup of a store, and restore into an empty one.

A backup is a folder with

- ``tandem.db``: snapshot of the database as an SQLite file,
- ``files``: every file that the database references, under its SHA-256,
- ``backup.json``: description of the backup. It is written last, so that its presence means the backup is
  complete.

The snapshot of an SQLite store is taken in one step of SQLite's online backup. That of a PostgreSQL store
is taken in one ``REPEATABLE READ`` transaction. A backup of either can be restored into either.

Files are copied after the snapshot. They never change, and they are added before a job references them.
Files of jobs that are deleted meanwhile may disappear. Therefore all files are marked as used first, and if
one is missing nevertheless, another snapshot is taken, in which its job no longer exists. Each file is
hashed while it is copied, on backup and on restore, so that a damaged store is reported and not passed on.
"""

import contextlib
import dataclasses
import datetime as dt
import json
import os
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from sqlalchemy import Connection, Engine, insert, inspect, select, text
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from planner.files import write_atomic
from planner.issues import TandemError, issue_error
from planner.runtime.version import __version__
from planner.service.models import (
    METADATA,
    SCHEMA,
    Database,
    cannot_open,
    default_url,
    error_reason,
    open_engine,
    redacted_url,
)
from planner.service.schema import VERSION, NoVersionError, create_or_check, has_store, version_of
from planner.service.service import lock_data
from planner.service.storage import GRACE_S, ContentStore, is_sha

DATABASE_FILE: Final = "tandem.db"
"""Name of the database file in a backup and in a data folder."""
FILES_FOLDER: Final = "files"
"""Name of the folder with the files."""
DESCRIPTION_FILE: Final = "backup.json"
"""Name of the file whose presence marks a complete backup."""
FORMAT_VERSION: Final = 1
"""Version of the backup format."""
MAX_SNAPSHOTS: Final = 10
"""Maximum number of snapshots taken until all files of one exist."""
ROWS_PER_BATCH: Final = 1000
"""Rows of a table that are held in memory at a time."""
JOURNAL_SUFFIXES: Final = ("-wal", "-shm", "-journal")
"""Suffixes of SQLite's journal files (https://www.sqlite.org/tempfiles.html)."""


@dataclasses.dataclass(frozen=True)
class Backup:
    """Summary of a backup.

    Attributes:
        version: Version of the tables.
        jobs: Number of jobs.
        files: Number of files.
        size: Total size of the files [bytes].
    """

    version: int
    jobs: int
    files: int
    size: int


def back_up(data: Path, database: str | None, folder: Path) -> Backup:
    """Back up a store, which may be in use, into a new folder.

    Args:
        data: Data folder of the service.
        database: URL of the database, or None for the SQLite file in the data folder.
        folder: Folder of the backup. It must be missing or empty.

    Raises:
        TandemError: ``service.backup``, or ``service.database`` if the database cannot be opened.
    """
    with _errors_as_issues(folder):
        if folder.exists() and any(folder.iterdir()):
            raise _backup_error(f"folder {folder}: is not empty. Name a new folder, or empty this one.")
        if not (data / FILES_FOLDER).is_dir():
            raise _backup_error(
                f"data folder {data}: contains no store. Give the same --data as to the service."
            )
        _make_private(folder)
        try:
            backup = _copy_snapshot(data, database or default_url(data), folder)
        except BaseException:  # leave no files that would prevent another attempt
            shutil.rmtree(folder / FILES_FOLDER, ignore_errors=True)
            (folder / DATABASE_FILE).unlink(missing_ok=True)
            raise
        description = dataclasses.asdict(backup) | {"format": FORMAT_VERSION, "program": __version__}
        description["made"] = dt.datetime.now(dt.UTC).isoformat(timespec="seconds")
        write_atomic(folder / DESCRIPTION_FILE, json.dumps(description, indent=1))
        return backup


def restore(folder: Path, data: Path, database: str | None) -> Backup:
    """Restore a backup into an empty data folder. Nothing is overwritten.

    The files are copied first, and the database last, in one step.

    Args:
        folder: Folder of the backup.
        data: Data folder of the new store.
        database: URL of an empty database, or None for an SQLite file in the data folder.

    Raises:
        TandemError: ``service.backup``, or ``service.database`` if the database cannot be opened.
    """
    _check_description(folder)
    with _errors_as_issues(folder), lock_data(data, database is None):
        if database is None and (data / DATABASE_FILE).exists():
            raise _backup_error(f"data folder {data}: already contains a store. Give --data a new folder.")
        _check_no_journal(data / DATABASE_FILE)
        if database is not None:
            with _exclusive_transaction(database) as connection:
                _check_empty(connection)
        with tempfile.TemporaryDirectory(prefix=".restore-", dir=data) as temporary:
            copy = Path(temporary) / DATABASE_FILE
            copy.touch(mode=0o600)  # SQLite gives its journals the same mode
            shutil.copyfile(folder / DATABASE_FILE, copy)
            _read_database(copy)
            _check_tables(folder, copy)
            backup, sizes = _read_database(copy)  # again, because checking the tables enabled the journal
            missing = _copy_files(
                sizes, ContentStore(folder / FILES_FOLDER), ContentStore(data / FILES_FOLDER)
            )
            if missing is not None:
                raise _backup_error(
                    f"backup {folder}: is damaged: file {missing} is missing. Use another backup."
                )
            if database is None:
                copy.rename(data / DATABASE_FILE)
            else:
                _fill_database(database, copy)
        return backup


def _make_private(folder: Path) -> None:
    """Create a folder that only its owner may enter, or restrict an existing one."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.chmod(0o700)
    mode = folder.stat().st_mode & 0o777
    if mode & 0o077:  # some mounted disks accept the call but keep the mode
        problem = f"other users may read it (got mode {mode:o}), and its disk does not allow a change"
        raise _backup_error(f"folder {folder}: {problem}. Name a folder on a disk that keeps permissions.")


def _copy_snapshot(data: Path, url: str, folder: Path) -> Backup:
    """Copy a snapshot of the database and all files that it references into a backup.

    If a file disappears meanwhile, another snapshot is taken, at most `MAX_SNAPSHOTS` times.
    """
    source = ContentStore(data / FILES_FOLDER)
    target = ContentStore(folder / FILES_FOLDER)
    copy = folder / DATABASE_FILE
    for _ in range(MAX_SNAPSHOTS):
        copy.unlink(missing_ok=True)
        copy.touch(mode=0o600)
        _write_snapshot(url, copy)
        backup, sizes = _read_database(copy)
        missing = _copy_files(sizes, source, target)
        if missing is None:
            return backup
    problem = f"data folder {data}: the store is damaged: file {missing} of a job is missing. "
    raise _backup_error(problem + "Restore the file, or delete the job.")


def _write_snapshot(url: str, copy: Path) -> None:
    """Write the content of the database at ``url`` at one instant into the SQLite file ``copy``."""
    try:
        engine = open_engine(url)
    except (SQLAlchemyError, ImportError) as error:
        raise TandemError(cannot_open(url, error)) from error
    if engine.dialect.name == "sqlite":
        path = Path(engine.url.database or "")
        with (
            contextlib.closing(_connect(path)) as source,
            contextlib.closing(sqlite3.connect(copy)) as target,
        ):
            source.backup(target)  # one step, therefore one transaction
        return
    try:
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as guard:
            # Services hold this lock while they create the tables, so the transaction below sees all or none.
            guard.execute(text("SELECT pg_advisory_lock_shared(7223)"))
            _write_postgresql_snapshot(engine, url, copy)
    except SQLAlchemyError as error:
        raise TandemError(cannot_open(url, error)) from error
    finally:
        engine.dispose()


def _write_postgresql_snapshot(engine: Engine, url: str, copy: Path) -> None:
    """Copy all tables of a PostgreSQL store in one transaction. ``url`` appears in error messages only."""
    options = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with engine.connect().execution_options(**options) as source, source.begin():
        version = version_of(source)
        if version != VERSION:
            if version is None:
                raise _backup_error(f"database {redacted_url(url)}: contains no store. Correct --database.")
            problem = f"has tables of version {version} (expected {VERSION})"
            remedy = "Use pg_dump, or the version of tandem-planner that created the store."
            raise _backup_error(f"database {redacted_url(url)}: {problem}. {remedy}")
        target = Database(_sqlite_url(copy))
        with target.write() as snapshot:
            _copy_rows(source, snapshot)
        target.close()


def _fill_database(url: str, copy: Path) -> None:
    """Create the tables of an empty database and copy all rows into them."""
    source = Database(_sqlite_url(copy))
    with _exclusive_transaction(url) as target_connection, source.read() as source_connection:
        _check_empty(target_connection)
        create_or_check(target_connection, METADATA)
        _copy_rows(source_connection, target_connection)
    source.close()


def _copy_rows(source: Connection, target: Connection) -> None:
    """Copy all tables except the version of the tables, which the target already has."""
    for table in METADATA.sorted_tables:
        if table is SCHEMA:
            continue
        rows = source.execute(select(table), execution_options={"yield_per": ROWS_PER_BATCH}).mappings()
        for batch in rows.partitions():
            target.execute(insert(table), [dict(row) for row in batch])


@contextlib.contextmanager
def _exclusive_transaction(url: str) -> Iterator[Connection]:
    """Open a transaction during which no service creates or changes the tables of the database."""
    try:
        engine = open_engine(url)
        try:
            if engine.dialect.name == "sqlite":
                _check_no_journal(Path(engine.url.database or ""))
            with engine.begin() as connection:
                if engine.dialect.name != "sqlite":
                    connection.execute(text("SELECT pg_advisory_xact_lock(7223)"))
                yield connection
        finally:
            engine.dispose()
    except (SQLAlchemyError, ImportError) as error:
        raise TandemError(cannot_open(url, error)) from error


def _check_no_journal(path: Path) -> None:
    """Check that a missing database has left no journal files.

    SQLite would write their content over a new database of this name, or remove them.
    """
    if path.exists() and path.stat().st_size:
        return  # the journals belong to it
    journals = [f"{path.name}{suffix}" for suffix in JOURNAL_SUFFIXES if os.path.lexists(f"{path}{suffix}")]
    if journals:
        problem = f"{', '.join(journals)} belong to a {path.name} that is missing"
        remedy = "Give --data or --database another path, or move these files to that database."
        raise _backup_error(f"folder {path.parent}: {problem}. {remedy}")


def _check_empty(connection: Connection) -> None:
    """Check that a database contains no tables of a store."""
    if has_store(connection):
        raise _backup_error("the database already contains tables of Tandem. Give --database an empty one.")


def _connect(path: Path) -> sqlite3.Connection:
    if not path.is_file():
        raise _backup_error(
            f"database {path}: not found. Give the same --data and --database as to the service."
        )
    return sqlite3.connect(path, timeout=60.0)


def _read_database(copy: Path) -> tuple[Backup, dict[str, int]]:
    """Read the summary of a backup's database and the sizes of the files that it references, by SHA-256.

    Afterwards the database is a single file without a journal.
    """
    with contextlib.closing(_connect(copy)) as db:
        db.execute("PRAGMA journal_mode=DELETE")
        (check_result,) = db.execute("PRAGMA quick_check(1)").fetchone()
        if check_result != "ok":
            raise _backup_error(f"database {copy}: is damaged ({check_result}). Use another backup.")
    engine = open_engine(_sqlite_url(copy))
    try:
        with engine.connect() as connection:
            version, jobs = _read_version_and_job_count(connection, copy)
            sizes = _read_file_sizes(connection, copy)
    finally:  # closing the last connection removes the logs
        engine.dispose()
    with contextlib.closing(_connect(copy)) as db:
        db.execute("PRAGMA journal_mode=DELETE")
    return Backup(version, jobs, len(sizes), sum(sizes.values())), sizes


def _read_version_and_job_count(connection: Connection, copy: Path) -> tuple[int, int]:
    """Check the version of a copied store. Return the version and the number of jobs."""
    version = version_of(connection)
    if version is None:
        raise _backup_error(f"database {copy}: contains no store. Give the same --data as to the service.")
    if version != VERSION:
        problem = f"has tables of version {version} (expected {VERSION})"
        remedy = "Use the version of tandem-planner that created the store."
        raise _backup_error(f"database {copy}: {problem}. {remedy}")
    return version, int(connection.execute(text("SELECT count(*) FROM tandem_jobs")).scalar_one())


def _read_file_sizes(connection: Connection, copy: Path) -> dict[str, int]:
    """Read the sizes [bytes] of the files of a copied store, by SHA-256. Refuse invalid rows."""
    sizes: dict[str, int] = {}
    for sha, size in connection.execute(text("SELECT DISTINCT sha, size FROM tandem_files ORDER BY sha")):
        if not is_sha(sha) or not isinstance(size, int) or size < 0:
            problem = f"invalid row (got name {str(sha)[:80]!r} and size {str(size)[:20]!r}, "
            remedy = "allowed a SHA-256 of 64 hexadecimal digits and a number of bytes). Use another"
            raise _backup_error(f"database {copy.name}: table tandem_files: {problem}{remedy} backup.")
        sizes[sha] = size
    return sizes


def _check_tables(folder: Path, copy: Path) -> None:
    """Check that a copied database has all tables and columns of this version."""
    engine = open_engine(_sqlite_url(copy))
    try:
        inspector = inspect(engine)
        table_names = set(inspector.get_table_names())
        for table in METADATA.sorted_tables:
            columns = (
                {column["name"] for column in inspector.get_columns(table.name)}
                if table.name in table_names
                else set()
            )
            missing = [column.name for column in table.columns if column.name not in columns]
            if missing:
                problem = (
                    f"table {table.name} has no {', '.join(missing)}"
                    if columns
                    else f"has no table {table.name}"
                )
                raise _backup_error(f"backup {folder}: is damaged: {problem}. Use another backup.")
    finally:
        engine.dispose()


def _copy_files(sizes: Mapping[str, int], source: ContentStore, target: ContentStore) -> str | None:
    """Copy the files that the target does not have yet, and verify their hashes.

    Args:
        sizes: Sizes of the files [bytes], by SHA-256. Only the hashes are used.
        source: Store to copy from.
        target: Store to copy to.

    Returns:
        SHA-256 of the first file that the source does not have, or None.
    """
    # All files are marked as used before the first copy, and again long before a sweep may delete them.
    marked_at = -GRACE_S
    for sha in sizes:
        if time.monotonic() - marked_at > GRACE_S / 4:
            marked_at = time.monotonic()
            for used_sha in sizes:
                with contextlib.suppress(OSError):  # nobody deletes files of a read-only store either
                    os.utime(source.path(used_sha))
        if target.has(sha):
            continue
        try:
            stored = target.put_file(source.path(sha))
        except FileNotFoundError:
            return sha
        if stored.sha != sha:
            target.path(stored.sha).unlink(missing_ok=True)
            problem = f"file {source.path(sha)}: is damaged: its content does not match its name"
            raise _backup_error(f"{problem}. Take it from another backup, or delete the job that uses it.")
    return None


def _check_description(folder: Path) -> None:
    """Check that a backup is complete and has a supported format."""
    try:
        description = json.loads((folder / DESCRIPTION_FILE).read_text("utf-8"))
        format_version = description["format"]
    except FileNotFoundError as error:
        problem = f"folder {folder}: is not a complete backup: it has no {DESCRIPTION_FILE}"
        raise _backup_error(f"{problem}. Name a folder that `tandem backup` created.") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _backup_error(
            f"backup {folder}: {DESCRIPTION_FILE} cannot be read. Use another backup."
        ) from error
    if format_version != FORMAT_VERSION:
        problem = (
            f"backup {folder}: unsupported format (got {str(format_version)[:20]}, allowed {FORMAT_VERSION})"
        )
        raise _backup_error(f"{problem}. Update tandem-planner on this machine.")


@contextlib.contextmanager
def _errors_as_issues(folder: Path) -> Iterator[None]:
    """Convert errors of the disk and of the database into issues."""
    try:
        yield
    except OSError as error:
        location = error.filename or folder
        raise _backup_error(
            f"{location}: {error.strerror or error}. Check the disk and its permissions."
        ) from error
    except sqlite3.Error as error:
        problem = f"its database cannot be read or written ({str(error)[:200]})"
        raise _backup_error(f"backup {folder}: is damaged: {problem}. Use another backup.") from error
    except NoVersionError as error:
        raise _backup_error(
            f"backup {folder}: {error}. The database is damaged. Use another backup."
        ) from error
    except SQLAlchemyError as error:
        detail = error_reason(error) if isinstance(error, DBAPIError) else type(error).__name__
        problem = f"its database cannot be read or written ({detail})"
        raise _backup_error(f"backup {folder}: is damaged: {problem}. Use another backup.") from error


def _sqlite_url(path: Path) -> str:
    return f"sqlite:///{path.resolve()}"


def _backup_error(message: str) -> TandemError:
    return issue_error("service.backup", message)
