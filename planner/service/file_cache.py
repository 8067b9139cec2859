"""Cache of values in files, shared by several processes.

No other program writes into the folder, so that the pickles can be trusted. If a process is killed, the
cache stays intact.
"""

import os
import pickle
import secrets
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

MAX_CACHE_BYTES: Final = 300_000_000
"""Maximum size [bytes] of the cache. The least recently used files are removed first."""


class FileCache:
    """Cache of named values in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, name: str) -> Any | None:
        """Return the value under a name and mark it as used. None if it is missing or incomplete."""
        path = self._folder / name
        with suppress(OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError):
            value = pickle.loads(path.read_bytes())
            os.utime(path)
            return value
        return None

    def put(self, name: str, value: Any, others: Sequence[str] = ()) -> None:
        """Store a value under one or more names. Each file is written whole or not at all.

        Values larger than half the cache are not stored. Errors of the disk are ignored.

        Args:
            name: Name.
            value: Value that can be pickled.
            others: Further names of the same value, as hard links.
        """
        content = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        if len(content) > MAX_CACHE_BYTES // 2:
            return
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True, mode=0o700)
            self._evict(len(content))
            for entry_name in (name, *others):
                temporary = self._folder / f".{secrets.token_hex(8)}"
                if entry_name is name:
                    temporary.write_bytes(content)
                else:
                    temporary.hardlink_to(self._folder / name)
                temporary.replace(self._folder / entry_name)

    def _evict(self, size: int) -> None:
        """Remove the least recently used files until ``size`` more bytes fit."""
        entries = []
        for path in self._folder.iterdir():
            with suppress(OSError):  # another process has removed it
                status = path.stat()
                # Names of the same value share its size.
                entries.append((status.st_mtime, status.st_size / status.st_nlink, path))
        total = sum(file_size for _, file_size, _ in entries)
        for _, file_size, path in sorted(entries):
            if total + size <= MAX_CACHE_BYTES:
                break
            path.unlink(missing_ok=True)
            total -= file_size
