"""Files and folders, asked for without surprises, written whole or not at all; versions of packages.

A file is written under a temporary name and renamed; a folder is staged in a hidden one inside of
it, which is locked while its run lives and swept by the next run where that was killed. `versions`
are those of what plans depend on.
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

from planner.issues import TandemError, refusal

STAGING = ".tandem-"
"""How the names of unfinished folders begin."""
STATEMENT, SIGNATURE = "statement.json", "statement.json.sig"
"""What is signed of a result, and its signature."""
RELEASE = "release.json"
"""What a service says of who released the programs of a result, in its folder or beside the programs."""
THUMBNAIL = "thumbnail.png"
"""The small picture of the cell that a service shows in its lists, taken from the report."""
RESULT = (
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
"""What a result folder holds; anything else in the folder is left alone."""


PAGES = ("report.html", "replay.html")
"""What of a result folder people look at, and can be made of the rest."""

FILE_KEYS: Final = ("file", "urdf")
"""Keys of problem files whose text is the name of a file."""


DISK_FULL: Final = (errno.ENOSPC, errno.EDQUOT)
"""Errors of the system when a disk, or what a user may have of it, is full."""


def is_disk_full(error: BaseException | None) -> bool:
    """Whether an error is, or comes from, a disk that is full."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in DISK_FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file; False also for names that no file can have and folders that are closed."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def no_file(path: Path) -> str:
    """What is wrong with ``path``, of which :func:`is_file` says no, for a message."""
    try:
        return "is a folder, not a file" if path.is_dir() else "no such file"
    except (OSError, ValueError):
        return "no such file"


def not_by_commas(header: str) -> str | None:
    """What to say of a CSV whose first line has no commas but another separator, else None."""
    for mark, name in ((";", "';'"), ("\t", "tabs")):
        if mark in header and "," not in header:
            return f"columns are separated by {name}; separate them by commas, and write decimals with points"
    return None


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Format rows as CSV with line ends of one character."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file through a temporary name in its folder, then rename: readers see the old file or the new
    one.
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


def claim_folder(folder: Path, owned: tuple[str, ...], keep: Path | None = None) -> None:
    """Make ``folder`` if it is missing, see that it can be written, and clear what killed runs left there.

    ``keep`` is a file that must not be among the ``owned`` entries, because those are replaced. Raises
    ``TandemError`` with ``output.folder``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _sweep(folder)
        with staging(folder):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise _refuse(folder, f"cannot be written ({reason}); choose a folder of your own") from error
    if keep is not None:
        for name in owned:
            if keep.resolve().is_relative_to((folder / name).resolve()):
                raise _refuse(
                    folder,
                    f"the problem file {keep} lies in its '{name}', which a run replaces; choose another",
                )


def write_folder(folder: Path, files: Mapping[str, str | bytes], owned: tuple[str, ...]) -> None:
    """Make ``folder`` hold exactly ``files`` among the names ``owned`` (files or subfolders at its top).

    Everything is first written to a hidden folder inside ``folder``; only then are the old owned entries
    replaced, one rename each. The first of ``owned`` goes first and comes last: while it is there, all that
    stands beside it belongs to it, at whatever moment a run is killed. Ctrl-C waits for the renames. Other
    people's files in the folder stay. Raises ``TandemError`` with ``output.folder``.
    """
    claim_folder(folder, owned)
    try:
        with staging(folder) as hidden:
            new, old = hidden / "new", hidden / "old"
            for side in (new, old):
                side.mkdir()
            for name, content in files.items():
                write_whole(new / name, content)
            with deferred_sigint():
                for name in owned:
                    if os.path.lexists(folder / name):
                        (folder / name).replace(old / name)
                for name in reversed(owned):
                    if (new / name).exists():
                        (new / name).replace(folder / name)
    except OSError as error:
        what = f"cannot be written ({error.strerror or error}); see to the disk and run again"
        raise _refuse(folder, what) from error


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """A hidden folder in ``folder`` that is gone at the end; what is whole may be renamed out of it.

    Its lock ends with the process, however that ends, and :func:`claim_folder` clears what nobody locks.
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


def _sweep(folder: Path) -> None:
    """Remove the hidden folders that nobody holds locked: their runs were killed."""
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
    """Defer Ctrl-C to the end of the block. Does nothing outside the main thread, which alone gets it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pending = False

    def remember(number: int, frame: FrameType | None) -> None:
        nonlocal pending
        pending = True

    usual = signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if pending:
        raise KeyboardInterrupt


def _refuse(folder: Path, what: str) -> TandemError:
    return refusal("output.folder", f"output folder {folder}: {what}", file=str(folder))


REPORTED_PACKAGES: Final = ("tandem-planner", "drake", "numpy", "scipy", "toppra")
"""Distributions whose versions results state."""


def versions() -> dict[str, str]:
    """Versions of what the plan depends on."""
    import importlib.metadata  # where they are used: the command begins by importing this module
    import platform

    out = {"python": platform.python_version()}
    for name in REPORTED_PACKAGES:
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out


MOST_CARRIED: Final = 60
"""Characters of a user's name that a file keeps in a bundle."""


def carried_name(name: str, sha: str) -> str:
    """What a file of that name and SHA-256 (in hex) is called where it is carried with its problem: as the
    user called it, by plain letters, with its hash. A name of this kind stays as it is."""
    own = base_name(name)
    stem, dot, suffix = own.rpartition(".") if "." in own[1:] else (own, "", "")
    stem = "" if stem == sha[:16] else stem.removesuffix(f"-{sha[:16]}")
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", stem)[:MOST_CARRIED].strip("-")
    return f"{plain}{'-' if plain else ''}{sha[:16]}{dot}{re.sub('[^a-z0-9]', '', suffix.lower())[:8]}"


def each_file(data: Any, change: Callable[[Path], str]) -> Any:
    """A copy of plain data with every value of a key ``file`` or ``urdf`` changed."""
    if isinstance(data, Mapping):
        return {
            k: change(Path(v)) if k in FILE_KEYS and isinstance(v, str) else each_file(v, change)
            for k, v in data.items()
        }
    if isinstance(data, list):
        return [each_file(v, change) for v in data]
    return data


def named_files(source: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 in hex of the files that a problem's values name, by the names that they are carried under."""
    found: dict[str, str] = {}

    def note(path: Path) -> str:
        if is_file(path):
            sha = hashlib.sha256(path.read_bytes()).hexdigest()
            found[carried_name(path.name, sha)] = sha
        return str(path)

    each_file(source, note)
    return found


def base_name(name: str) -> str:
    """The last step of a file name, whatever system wrote it."""
    return re.split(r"[/\\]", name)[-1]
