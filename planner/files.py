"""Atomic writing of files and folders, file queries that do not raise, and versions of dependencies.

A file is written under a temporary name and renamed. The content of a folder is first written to a hidden
staging folder inside it. A run locks its staging folder for as long as the run lives. The next run removes
staging folders that are not locked, because their runs were killed.
"""

import csv
import errno
import fcntl
import hashlib
import io
import os
import re
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final

from planner.issues import TandemError, issue_error

STAGING = ".tandem-"
"""Prefix of the names of staging folders."""
STATEMENT, SIGNATURE = "statement.json", "statement.json.sig"
"""Names of the file of a result that is signed and of the file with its signature."""
RELEASE = "release.json"
"""Name of the file in which a service states who released the programs.

It is in the result folder or next to the programs.
"""
THUMBNAIL = "thumbnail.png"
"""Small picture of the cell from the report, which a service shows in its lists."""
RESULT_ENTRIES = (
    "programs",
    "problem",
    "plan.npz",
    "plan.json",
    "motion.json",
    "proof.json",
    "report.html",
    "replay.html",
    "simulated_part.obj",
    THUMBNAIL,
    RELEASE,
    STATEMENT,
    SIGNATURE,
)
"""Entries of a result folder that a run owns. Anything else in the folder is left alone."""


PAGES = ("report.html", "replay.html")
"""Pages of a result folder for people. They can be made from the other files."""

FILE_KEYS: Final = ("file", "urdf")
"""Keys of problem files whose value is a file name."""


DISK_FULL_ERRNOS: Final = (errno.ENOSPC, errno.EDQUOT)
"""System errors for a full disk or an exceeded user quota."""


def is_disk_full(error: BaseException | None) -> bool:
    """Whether an error, or an error that caused it, says that the disk is full or the quota is used up."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in DISK_FULL_ERRNOS:
            return True
        error = error.__cause__ or error.__context__
    return False


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file. False also for invalid names and for folders without access."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def missing_file_reason(path: Path) -> str:
    """Return why ``path`` is not a file, as a phrase for a message. Call it if :func:`is_file` is False."""
    try:
        return "is a folder, not a file" if path.is_dir() else "no such file"
    except (OSError, ValueError):
        return "no such file"


def separator_hint(header: str) -> str | None:
    """Return a hint if the columns of a CSV file's header line are not separated by commas, else None."""
    for mark, name in ((";", "';'"), ("\t", "tabs")):
        if mark in header and "," not in header:
            return f"columns are separated by {name}; separate them by commas, and write decimals with points"
    return None


def format_csv(rows: Iterable[Iterable[object]]) -> str:
    """Format rows as CSV whose lines end in a line feed."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write a file atomically: readers see either the old file or the new one.

    The content goes to a temporary file in the same folder, which is then renamed.

    Args:
        path: File to write. Its folder is created if it is missing.
        content: Text, written as UTF-8, or bytes.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    data = content.encode("utf-8") if isinstance(content, str) else content
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def prepare_folder(folder: Path, owned: tuple[str, ...], keep: Path | None = None) -> None:
    """Create ``folder`` if it is missing, check that it is writable, and remove what killed runs left there.

    Args:
        folder: Output folder.
        owned: Names of entries in ``folder`` that a run replaces.
        keep: File that must not be lost, so it must not lie inside the ``owned`` entries.

    Raises:
        TandemError: ``output.folder`` if the folder cannot be written or ``keep`` is in an owned entry.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_abandoned_staging(folder)
        with staging(folder):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise _folder_error(folder, f"cannot be written ({reason}); choose another folder") from error
    if keep is not None:
        for name in owned:
            if keep.resolve().is_relative_to((folder / name).resolve()):
                raise _folder_error(
                    folder,
                    f"the problem file {keep} is in its '{name}', which a run replaces; choose another",
                )


def write_folder(folder: Path, files: Mapping[str, str | bytes], owned: tuple[str, ...]) -> None:
    """Replace all entries of ``folder`` with names in ``owned`` by ``files``. Other entries stay.

    Everything is first written to a staging folder inside ``folder``. Then the old owned entries are moved
    out and the new ones in, one rename each. The first entry of ``owned`` leaves first and arrives last.
    While it exists, all owned entries therefore belong to the same run, even if a run is killed between two
    renames. Ctrl-C is deferred during the renames.

    Args:
        folder: Output folder.
        files: Content by path relative to ``folder``.
        owned: Names of files or subfolders at the top of ``folder`` that are replaced.

    Raises:
        TandemError: ``output.folder`` if the folder cannot be written.
    """
    prepare_folder(folder, owned)
    try:
        with staging(folder) as hidden:
            new, old = hidden / "new", hidden / "old"
            for subfolder in (new, old):
                subfolder.mkdir()
            for name, content in files.items():
                write_atomic(new / name, content)
            with deferred_sigint():
                for name in owned:
                    if os.path.lexists(folder / name):
                        (folder / name).replace(old / name)
                for name in reversed(owned):
                    if (new / name).exists():
                        (new / name).replace(folder / name)
    except OSError as error:
        reason = f"cannot be written ({error.strerror or error}); check the disk and run again"
        raise _folder_error(folder, reason) from error


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Create a hidden folder in ``folder``, lock and yield it, and remove it at the end.

    Finished files may be renamed out of it. The lock ends with the process even if this is killed, and
    :func:`prepare_folder` then removes the folder.
    """
    path, handle = None, None
    try:
        with deferred_sigint():
            path = Path(tempfile.mkdtemp(prefix=STAGING, dir=folder))
            handle = os.open(path, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield path
    finally:
        with deferred_sigint():
            if path is not None:
                shutil.rmtree(path, ignore_errors=True)
            if handle is not None:
                os.close(handle)


def _remove_abandoned_staging(folder: Path) -> None:
    """Remove the staging folders in ``folder`` that are not locked, because their runs were killed."""
    for path in folder.glob(f"{STAGING}*"):
        with suppress(OSError):
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(handle)


@contextmanager
def deferred_sigint() -> Iterator[None]:
    """Defer Ctrl-C to the end of the block.

    Does nothing outside the main thread, because only the main thread receives the signal.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pending = False

    def note_signal(number: int, frame: FrameType | None) -> None:
        nonlocal pending
        pending = True

    previous_handler = signal.signal(signal.SIGINT, note_signal)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
    if pending:
        raise KeyboardInterrupt


def _folder_error(folder: Path, reason: str) -> TandemError:
    return issue_error("output.folder", f"output folder {folder}: {reason}", file=str(folder))


REPORTED_PACKAGES: Final = ("tandem-planner", "drake", "numpy", "scipy", "toppra")
"""Distributions whose versions are stated in results."""


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a plan depends on."""
    import importlib.metadata  # lazy: the command line imports this module first
    import platform

    version_by_name = {"python": platform.python_version()}
    for name in REPORTED_PACKAGES:
        try:
            version_by_name[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            version_by_name[name] = "not installed"
    return version_by_name


MAX_BUNDLED_STEM_LENGTH: Final = 60
"""Maximum number of characters of the user's file name that is kept in a bundled name."""


def bundled_name(name: str, sha: str) -> str:
    """Return the name under which a file is bundled with its problem.

    It is the user's name reduced to letters, digits, "-" and "_", followed by the first 16 digits of the hash
    and the suffix. A name that this function returned stays the same.

    Args:
        name: File name as the user gave it.
        sha: SHA-256 of the file, in hex.
    """
    base = base_name(name)
    stem, dot, suffix = base.rpartition(".") if "." in base[1:] else (base, "", "")
    stem = "" if stem == sha[:16] else stem.removesuffix(f"-{sha[:16]}")
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", stem)[:MAX_BUNDLED_STEM_LENGTH].strip("-")
    return f"{plain}{'-' if plain else ''}{sha[:16]}{dot}{re.sub('[^a-z0-9]', '', suffix.lower())[:8]}"


def map_file_names(data: Any, change: Callable[[Path], str]) -> Any:
    """Return a copy of plain data with ``change`` applied to every file name in it.

    File names are the texts of the keys :data:`FILE_KEYS`, at any depth.
    """
    if isinstance(data, Mapping):
        return {
            k: change(Path(v)) if k in FILE_KEYS and isinstance(v, str) else map_file_names(v, change)
            for k, v in data.items()
        }
    if isinstance(data, list):
        return [map_file_names(v, change) for v in data]
    return data


def referenced_file_hashes(source: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 (hex) of the existing files that a problem refers to, by their bundled names."""
    hashes: dict[str, str] = {}

    def record_file(path: Path) -> str:
        if is_file(path):
            sha = hashlib.sha256(path.read_bytes()).hexdigest()
            hashes[bundled_name(path.name, sha)] = sha
        return str(path)

    map_file_names(source, record_file)
    return hashes


def base_name(name: str) -> str:
    """Return the last component of a file name, with separators of any operating system."""
    return re.split(r"[/\\]", name)[-1]
