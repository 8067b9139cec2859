"""Values that are kept as files for a while, in a folder that nobody else writes into: several processes
share them, and one that is ended loses none. They are pickles of this service's own."""

import os
import pickle
import secrets
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

MOST_BYTES: Final = 300_000_000
"""Files that are kept at most; those that were not asked for the longest time go first."""


class KeptFiles:
    """Values by names, in ``folder``."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, name: str) -> Any | None:
        """What is kept under that name, which is used now; None where there is nothing, or half of it."""
        path = self._folder / name
        with suppress(OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError):
            made = pickle.loads(path.read_bytes())
            os.utime(path)
            return made
        return None

    def put(self, name: str, value: Any, others: Sequence[str] = ()) -> None:
        """Keep a value under a name, and ``others``, each whole or not at all; on a full disk, under none."""
        content = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        if len(content) > MOST_BYTES // 2:
            return
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True, mode=0o700)
            self._make_room(len(content))
            for one in (name, *others):
                new = self._folder / f".{secrets.token_hex(8)}"
                if one is name:
                    new.write_bytes(content)
                else:
                    new.hardlink_to(self._folder / name)
                new.replace(self._folder / one)

    def _make_room(self, size: int) -> None:
        """Remove what was asked for the longest time ago until ``size`` bytes more have room."""
        known = []
        for path in self._folder.iterdir():
            with suppress(OSError):  # another process has removed it
                about = path.stat()
                known.append((about.st_mtime, about.st_size / about.st_nlink, path))
        total = sum(own for _, own, _ in known)
        for _, own, path in sorted(known):
            if total + size <= MOST_BYTES:
                break
            path.unlink(missing_ok=True)
            total -= own
