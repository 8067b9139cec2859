"""Files by their content: each is stored once, under its SHA-256, and whole or not at all."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

CHUNK: Final = 1 << 20
GRACE_S: Final = 3600.0
"""A file that nobody names is kept for so long: the job that it belongs to may be about to be written."""
_SHA: Final = re.compile(r"[0-9a-f]{64}")


class Blob(NamedTuple):
    """A stored file: its SHA-256 in hex, and its size [bytes]."""

    sha: str
    size: int


class Files:
    """The stored files under ``root``, in folders by the first two digits of their hash."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._incoming = root / "incoming"
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self.used = self._measured()
        """What all files take [bytes]; what other hosts store is known after the next sweep."""

    def put(self, stream: BinaryIO, known: Blob | None = None) -> Blob:
        """Store what ``stream`` holds from here on. With ``known``, what :func:`blob_of` said of it, it is
        not hashed again, and only read if it is new.
        """
        if known is not None and self._wanted_again(known.sha):
            return known
        digest, size = hashlib.sha256(), 0
        handle, name = tempfile.mkstemp(dir=self._incoming)
        try:
            with os.fdopen(handle, "wb") as out:
                while chunk := stream.read(CHUNK):
                    if known is None:
                        digest.update(chunk)
                    size += len(chunk)
                    out.write(chunk)
                out.flush()
                os.fsync(out.fileno())
            blob = known or Blob(digest.hexdigest(), size)
            if size != blob.size:  # no name may stand for other content
                raise OSError(f"{size} bytes were read of a file of {blob.size}")
            target = self.path(blob.sha)
            with self._lock:
                new = not self._wanted_again(blob.sha)
                if new:
                    target.parent.mkdir(exist_ok=True)
                    Path(name).replace(target)
                    self.used += size
            if new:
                _to_disk(target.parent)
        finally:
            Path(name).unlink(missing_ok=True)
        return blob

    def put_file(self, path: Path) -> Blob:
        """Store a file of the disk."""
        with path.open("rb") as stream:
            return self.put(stream)

    def path(self, sha: str) -> Path:
        """Where the file with that hash lies; raises ``ValueError`` for what is no hash."""
        if not _SHA.fullmatch(sha):
            raise ValueError(f"{sha!r} is no SHA-256")
        return self.root / sha[:2] / sha

    def has(self, sha: str) -> bool:
        """Whether it is stored."""
        return self.path(sha).is_file()

    def read(self, sha: str) -> bytes:
        """The content."""
        return self.path(sha).read_bytes()

    def sweep(self, wanted: Callable[[list[str]], set[str]]) -> int:
        """Remove files that ``wanted`` does not keep, a folder at a time, and what killed uploads left; their
        number.
        """
        before, removed = time.time() - GRACE_S, 0
        for folder in sorted(self.root.iterdir()):
            old = [path for path in folder.iterdir() if _older(path, before)]
            if folder == self._incoming:
                kept: set[str] = set()
            else:
                old = [path for path in old if _SHA.fullmatch(path.name)]
                kept = wanted([path.name for path in old]) if old else set()
            for path in old:
                if path.name not in kept and _older(path, before):
                    path.unlink(missing_ok=True)
                    removed += 1
        with self._lock:
            self.used = self._measured()
        return removed

    def _wanted_again(self, sha: str) -> bool:
        """Whether it is stored; the sweep leaves it from now on."""
        try:
            os.utime(self.path(sha))
        except FileNotFoundError:
            return False
        return True

    def _measured(self) -> int:
        folders = [folder for folder in self.root.iterdir() if folder != self._incoming and folder.is_dir()]
        return sum(_size(path) for folder in folders for path in folder.iterdir())


def blob_of(stream: BinaryIO) -> Blob:
    """What storing the rest of ``stream`` would give; the stream is where it was afterwards."""
    begin, digest, size = stream.tell(), hashlib.sha256(), 0
    while chunk := stream.read(CHUNK):
        digest.update(chunk)
        size += len(chunk)
    stream.seek(begin)
    return Blob(digest.hexdigest(), size)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # another host's sweep
        return 0


def _older(path: Path, before: float) -> bool:
    try:
        return path.stat().st_mtime < before
    except FileNotFoundError:
        return False


def _to_disk(folder: Path) -> None:
    """A rename is on the disk when its folder is."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
