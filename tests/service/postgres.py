"""A real PostgreSQL server for tests, in its own folder.

Tests are skipped with the reason if none is installed.
"""

from __future__ import annotations

import atexit
import functools
import itertools
import os
import pwd
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from tests.service.support import free_port

WHY = "PostgreSQL is not installed: no initdb in PATH or /usr/lib/postgresql"
_NUMBERS = itertools.count()


def fresh(folder: Path) -> str:
    """Return the URL of a new database; skip the test if there is no PostgreSQL."""
    del folder
    url = _server()
    if url is None:
        pytest.skip(WHY)
    name = f"t{os.getpid()}_{next(_NUMBERS)}"
    import psycopg

    with psycopg.connect(f"{url}/postgres", autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return f"{url}/{name}"


def _programs() -> Path | None:
    result = shutil.which("initdb")
    if result:
        return Path(result).resolve().parent
    homes = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda p: int(p.parts[-3]))
    return homes[-1].parent if homes else None


@functools.cache
def _server() -> str | None:
    """Start a server, once; it ends with this process. PostgreSQL refuses to run as root, so root lends it to
    the user postgres."""
    programs = _programs()
    if programs is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="tandem-pg-", dir="/tmp"))
    as_user: list[str] = []
    if os.geteuid() == 0:
        user = pwd.getpwnam("postgres")
        os.chown(folder, user.pw_uid, user.pw_gid)
        as_user = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"]
    data, port = folder / "data", free_port()
    subprocess.run(
        [*as_user, programs / "initdb", "-D", data, "-A", "trust", "-U", "tandem", "--no-sync"],
        check=True,
        stdout=subprocess.DEVNULL,
        cwd=folder,
    )
    options = f"-p {port} -k {folder} -h 127.0.0.1 -c max_connections=200"
    control = [*as_user, programs / "pg_ctl", "-D", data, "-w", "-l", folder / "log"]
    subprocess.run([*control, "-o", options, "start"], check=True, stdout=subprocess.DEVNULL, cwd=folder)

    def stop() -> None:
        subprocess.run([*control, "-m", "immediate", "stop"], stdout=subprocess.DEVNULL, cwd=folder)
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(stop)
    return f"postgresql://tandem@127.0.0.1:{port}"
