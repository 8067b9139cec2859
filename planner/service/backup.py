"""Backups of a store, made while it is used, and restored into an empty one.

A backup is a folder: ``tandem.db``, the database at one moment as an SQLite file; ``files``, all that it
names, each under its SHA-256; and ``backup.json``, which says what it is and is written last, when all else
is there. The moment of an SQLite store is that of one step of its online backup; that of a PostgreSQL one is
a single transaction that is ``REPEATABLE READ``. So either can be restored into either.

Files are copied after that moment, because they never change and are only ever added before a job names
them. What may go meanwhile are files of jobs that are deleted: all are marked as wanted first, and where one
is gone all the same, another moment is taken, at which its job is gone too. Each file is hashed as it is
copied, here and there, so that a store that is damaged is told and not handed on.
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

from planner.files import write_whole
from planner.issues import TandemError, refusal
from planner.runtime.version import __version__
from planner.service.models import (
    METADATA,
    SCHEMA,
    Database,
    cannot_open,
    default_url,
    open_engine,
    reason,
    shown,
)
from planner.service.schema import VERSION, NoVersionError, create_or_check, has_store, version_of
from planner.service.service import lock_data
from planner.service.storage import GRACE_S, Files, is_sha

DATABASE: Final = "tandem.db"
"""The database in a backup."""
FILES: Final = "files"
"""The folder of the files in it."""
ABOUT: Final = "backup.json"
"""What says that a folder is a backup, and a whole one."""
FORMAT: Final = 1
"""Version of what is in the folder."""
MOMENTS: Final = 10
"""So many moments are taken until all files of one are there."""
ROWS: Final = 1000
"""Rows of a table that are held at once."""
LOGS: Final = ("-wal", "-shm", "-journal")
"""What SQLite adds to a database's name for its logs (https://www.sqlite.org/tempfiles.html)."""


@dataclasses.dataclass(frozen=True)
class Backup:
    """What is in a backup: version of its tables, jobs, files and their size [bytes]."""

    version: int
    jobs: int
    files: int
    size: int


def back_up(data: Path, database: str | None, folder: Path) -> Backup:
    """Back a store up into a new ``folder``: that of the data folder, or of ``database`` with the files in
    the data folder. It may be in use.

    Raises ``TandemError``: ``service.backup``, or ``service.database`` where it cannot be opened.
    """
    with _told(folder):
        if folder.exists() and any(folder.iterdir()):
            raise _refused(f"folder {folder}: is not empty; name a new one, or remove what is in it")
        if not (data / FILES).is_dir():
            raise _refused(f"data folder {data}: there is no store in it; give --data as the service has it")
        _make_private(folder)
        try:
            made = _backed_up(data, database or default_url(data), folder)
        except BaseException:  # nothing stands in the way of another try
            shutil.rmtree(folder / FILES, ignore_errors=True)
            (folder / DATABASE).unlink(missing_ok=True)
            raise
        about = dataclasses.asdict(made) | {"format": FORMAT, "program": __version__}
        about["made"] = dt.datetime.now(dt.UTC).isoformat(timespec="seconds")
        write_whole(folder / ABOUT, json.dumps(about, indent=1))
        return made


def restore(folder: Path, data: Path, database: str | None) -> Backup:
    """Restore a backup into an empty data folder, and into ``database`` where one is given.

    Nothing is overwritten. Files come first and the database last, all at once. Raises ``TandemError`` as
    :func:`back_up`.
    """
    _check_about(folder)
    with _told(folder), lock_data(data, database is None):
        if database is None and (data / DATABASE).exists():
            raise _refused(f"data folder {data}: a store is in it already; give --data a new folder")
        _check_no_log(data / DATABASE)
        if database is not None:
            with _begun(database) as connection:
                _check_empty(connection)
        with tempfile.TemporaryDirectory(prefix=".restore-", dir=data) as room:
            copy = Path(room) / DATABASE
            copy.touch(mode=0o600)  # and so are its logs, which SQLite makes like it
            shutil.copyfile(folder / DATABASE, copy)
            _read(copy)
            _check_tables(folder, copy)
            made, named = _read(copy)  # again, because checking the tables switched the log on
            lost = _copied(named, Files(folder / FILES), Files(data / FILES))
            if lost is not None:
                raise _refused(f"backup {folder}: file {lost} is missing; it is damaged, take another one")
            if database is None:
                copy.rename(data / DATABASE)
            else:
                _fill(database, copy)
        return made


def _make_private(folder: Path) -> None:
    """Make a folder that only its owner may enter, or make one that is there such."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    folder.chmod(0o700)
    mode = folder.stat().st_mode & 0o777
    if mode & 0o077:  # some mounted disks take the call and keep the mode
        what = f"got mode {mode:o}, so others may read the backup, and its disk does not let that be changed"
        raise _refused(f"folder {folder}: {what}; name one on a disk that keeps permissions")


def _backed_up(data: Path, url: str, folder: Path) -> Backup:
    """Copy the database of a moment and all files that it names."""
    source, target, copy = Files(data / FILES), Files(folder / FILES), folder / DATABASE
    for _ in range(MOMENTS):
        copy.unlink(missing_ok=True)
        copy.touch(mode=0o600)
        _moment(url, copy)
        made, named = _read(copy)
        lost = _copied(named, source, target)
        if lost is None:
            return made
    what = f"data folder {data}: file {lost} of a job is not there, however often it is looked for; "
    raise _refused(what + "the store is damaged: find the file, or delete that job")


def _moment(url: str, copy: Path) -> None:
    """Write the database as it is at one moment."""
    try:
        engine = open_engine(url)
    except (SQLAlchemyError, ImportError) as error:
        raise TandemError(cannot_open(url, error)) from error
    if engine.dialect.name == "sqlite":
        path = Path(engine.url.database or "")
        with contextlib.closing(_opened(path)) as source, contextlib.closing(sqlite3.connect(copy)) as target:
            source.backup(target)  # in one step, so in one transaction
        return
    try:
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as guard:
            # services take this lock while they create the tables, so the transaction below sees all or none
            guard.execute(text("SELECT pg_advisory_lock_shared(7223)"))
            _moment_of_postgresql(engine, url, copy)
    except SQLAlchemyError as error:
        raise TandemError(cannot_open(url, error)) from error
    finally:
        engine.dispose()


def _moment_of_postgresql(engine: Engine, url: str, copy: Path) -> None:
    options = {"isolation_level": "REPEATABLE READ", "postgresql_readonly": True}
    with engine.connect().execution_options(**options) as source, source.begin():
        found = version_of(source)
        if found != VERSION:
            if found is None:
                raise _refused(f"database {shown(url)}: contains no store. Correct --database.")
            problem = f"has tables of version {found} (expected {VERSION})"
            remedy = "Use pg_dump, or the version of tandem-planner that created the store."
            raise _refused(f"database {shown(url)}: {problem}. {remedy}")
        target = Database(_sqlite(copy))
        with target.write() as written:
            _copy_rows(source, written)
        target.close()


def _fill(url: str, copy: Path) -> None:
    """Make the tables of an empty database, with the rows of the copy."""
    source = Database(_sqlite(copy))
    with _begun(url) as written, source.read() as read:
        _check_empty(written)
        create_or_check(written, METADATA)
        _copy_rows(read, written)
    source.close()


def _copy_rows(source: Connection, target: Connection) -> None:
    for table in METADATA.sorted_tables:
        if table is SCHEMA:
            continue
        rows = source.execute(select(table), execution_options={"yield_per": ROWS}).mappings()
        for part in rows.partitions():
            target.execute(insert(table), [dict(row) for row in part])


@contextlib.contextmanager
def _begun(url: str) -> Iterator[Connection]:
    """A transaction that has a database to itself while its tables are made."""
    try:
        engine = open_engine(url)
        try:
            if engine.dialect.name == "sqlite":
                _check_no_log(Path(engine.url.database or ""))
            with engine.begin() as connection:
                if engine.dialect.name != "sqlite":
                    connection.execute(text("SELECT pg_advisory_xact_lock(7223)"))
                yield connection
        finally:
            engine.dispose()
    except (SQLAlchemyError, ImportError) as error:
        raise TandemError(cannot_open(url, error)) from error


def _check_no_log(path: Path) -> None:
    """See that a database that is not there left no log: SQLite would write what that has over the one that
    is made under its name, or remove it."""
    if path.exists() and path.stat().st_size:
        return  # they are its own
    left = [f"{path.name}{end}" for end in LOGS if os.path.lexists(f"{path}{end}")]
    if left:
        what = f"got {', '.join(left)}, which belong to a {path.name} that is not there"
        way = "give --data or --database a new place, or move them to where that database is now"
        raise _refused(f"folder {path.parent}: {what}; {way}")


def _check_empty(connection: Connection) -> None:
    if has_store(connection):
        raise _refused("the database has Tandem's tables already; give --database an empty one")


def _opened(path: Path) -> sqlite3.Connection:
    if not path.is_file():
        raise _refused(f"database {path}: there is none; give --data and --database as the service has them")
    return sqlite3.connect(path, timeout=60.0)


def _read(copy: Path) -> tuple[Backup, dict[str, int]]:
    """What is in the database of a backup, and the sizes of files that it names; it is one file afterwards,
    without a log beside it."""
    with contextlib.closing(_opened(copy)) as db:
        db.execute("PRAGMA journal_mode=DELETE")
        (said,) = db.execute("PRAGMA quick_check(1)").fetchone()
        if said != "ok":
            raise _refused(f"database {copy}: is damaged ({said}); take another backup")
    engine = open_engine(_sqlite(copy))
    try:
        with engine.connect() as connection:
            version, jobs = _jobs_of(connection, copy)
            named = _files_of(connection, copy)
    finally:  # closing the last connection removes the logs
        engine.dispose()
    with contextlib.closing(_opened(copy)) as db:
        db.execute("PRAGMA journal_mode=DELETE")
    return Backup(version, jobs, len(named), sum(named.values())), named


def _jobs_of(connection: Connection, copy: Path) -> tuple[int, int]:
    """Check the version of a copied store; return the version and the number of jobs."""
    version = version_of(connection)
    if version is None:
        raise _refused(f"database {copy}: there is no store in it; give --data as the service has it")
    if version != VERSION:
        problem = f"has tables of version {version} (expected {VERSION})"
        remedy = "Use the version of tandem-planner that created the store."
        raise _refused(f"database {copy}: {problem}. {remedy}")
    return version, int(connection.execute(text("SELECT count(*) FROM tandem_jobs")).scalar_one())


def _files_of(connection: Connection, copy: Path) -> dict[str, int]:
    """Read the sizes [bytes] of the files of a copied store, by SHA-256."""
    sizes: dict[str, int] = {}
    for sha, size in connection.execute(text("SELECT DISTINCT sha, size FROM tandem_files ORDER BY sha")):
        if not is_sha(sha) or not isinstance(size, int) or size < 0:
            got = f"got the name {str(sha)[:80]!r} and the size {str(size)[:20]!r}"
            way = "a SHA-256 of 64 hexadecimal digits and bytes are allowed; it is damaged, take another"
            raise _refused(f"database {copy.name}: table tandem_files: {got}; {way} backup")
        sizes[sha] = size
    return sizes


def _check_tables(folder: Path, copy: Path) -> None:
    """See that a database of this version has all that this version's has."""
    engine = open_engine(_sqlite(copy))
    try:
        seen = inspect(engine)
        there = set(seen.get_table_names())
        for table in METADATA.sorted_tables:
            has = {one["name"] for one in seen.get_columns(table.name)} if table.name in there else set()
            lost = [one.name for one in table.columns if one.name not in has]
            if lost:
                what = f"table {table.name} has no {', '.join(lost)}" if has else f"has no table {table.name}"
                raise _refused(f"backup {folder}: {what}; it is damaged, take another one")
    finally:
        engine.dispose()


def _copied(named: Mapping[str, int], source: Files, target: Files) -> str | None:
    """Copy files that are not there yet; the first that is gone, or None."""
    marked = -GRACE_S
    for sha in named:
        if time.monotonic() - marked > GRACE_S / 4:
            marked = time.monotonic()
            for one in named:
                with contextlib.suppress(OSError):  # a store that may only be read has no sweep either
                    os.utime(source.path(one))
        if target.has(sha):
            continue
        try:
            stored = target.put_file(source.path(sha))
        except FileNotFoundError:
            return sha
        if stored.sha != sha:
            target.path(stored.sha).unlink(missing_ok=True)
            what = f"file {source.path(sha)}: its content is not that of its name; it is damaged"
            raise _refused(f"{what}: take it from another backup, or delete the job that names it")
    return None


def _check_about(folder: Path) -> None:
    try:
        about = json.loads((folder / ABOUT).read_text("utf-8"))
        known = about["format"]
    except FileNotFoundError as error:
        what = f"folder {folder}: is no backup, or one that did not come to its end: it has no {ABOUT}"
        raise _refused(f"{what}; name one that `tandem backup` made") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _refused(f"backup {folder}: {ABOUT} cannot be read; take another one") from error
    if known != FORMAT:
        what = f"backup {folder}: has format {str(known)[:20]}, this program knows {FORMAT}"
        raise _refused(f"{what}; update tandem-planner on this machine")


@contextlib.contextmanager
def _told(folder: Path) -> Iterator[None]:
    """Errors of disks and of SQLite files as issues."""
    try:
        yield
    except OSError as error:
        where = error.filename or folder
        raise _refused(f"{where}: {error.strerror or error}; see the disk and its permissions") from error
    except sqlite3.Error as error:
        what = f"its database cannot be read or written ({str(error)[:200]})"
        raise _refused(f"backup {folder}: {what}; it is damaged, take another one") from error
    except NoVersionError as error:
        raise _refused(f"backup {folder}: {error}. The database is damaged. Use another backup.") from error
    except SQLAlchemyError as error:
        said = reason(error) if isinstance(error, DBAPIError) else type(error).__name__
        what = f"its database cannot be read or written ({said})"
        raise _refused(f"backup {folder}: {what}; it is damaged, take another one") from error


def _sqlite(path: Path) -> str:
    return f"sqlite:///{path.resolve()}"


def _refused(what: str) -> TandemError:
    return refusal("service.backup", what)
