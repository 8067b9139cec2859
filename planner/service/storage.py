"""Room for files: what a token's, and all, may take. Content counts once, however often it is named.

A token is charged with the content of its jobs, and for an hour with what it sent without making a job of it,
because that stays on the disk for so long. Results are never refused: they are charged when they are there.
"""

from __future__ import annotations

import errno
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import BinaryIO, Final

from planner.issues import Issue
from planner.service.files import GRACE_S, Blob, Files, blob_of
from planner.service.limits import Limits
from planner.service.refusals import RefusedError

MB: Final = 1_000_000
FREE_MB: Final = 256.0
"""So much of the disk is left to the database and to the results of jobs that run."""
KNOWN_S: Final = 10.0
"""So long a token's use is taken to be what it was, unless that would be a refusal."""
FULL: Final = (errno.ENOSPC, errno.EDQUOT)


class Storage:
    """The stored files with their limits. ``owned`` tells a token's content: sizes [bytes] by SHA-256."""

    def __init__(self, files: Files, owned: Callable[[str], Mapping[str, int]], limits: Limits) -> None:
        self._files, self._read, self._limits = files, owned, limits
        self._lock = threading.Lock()
        self._known: dict[str, tuple[float, Mapping[str, int]]] = {}
        self._sent: dict[str, dict[str, tuple[int, float]]] = {}
        self._coming: Counter[Blob] = Counter()

    def put(self, owner: str, streams: Sequence[BinaryIO]) -> list[Blob]:
        """Store what the streams hold, all or nothing where there is no room.

        Raises :class:`RefusedError`, 507.
        """
        blobs = [blob_of(stream) for stream in streams]
        with self._room(owner, blobs):
            return [self._files.put(*one) for one in zip(streams, blobs, strict=True)]

    def used(self, owner: str) -> int:
        """What a token's files take [bytes]."""
        return sum(self._charged(owner, fresh=True).values())

    @contextmanager
    def _room(self, owner: str, blobs: Sequence[Blob]) -> Iterator[None]:
        wanted = {blob.sha: blob.size for blob in blobs}
        self._allow_owner(owner, wanted)
        with self._lock:
            self._allow_all([blob for blob in set(blobs) if not self._files.has(blob.sha)])
            self._coming.update(blobs)
            now = time.monotonic()
            self._sent.setdefault(owner, {}).update({sha: (size, now) for sha, size in wanted.items()})
        try:
            yield
        except OSError as error:
            if error.errno in FULL:
                raise _full("the disk of this service is full", None, None) from error
            raise
        finally:
            with self._lock:
                self._coming.subtract(blobs)
                self._coming += Counter()  # drops what is at zero

    def _allow_owner(self, owner: str, wanted: Mapping[str, int]) -> None:
        limit = self._limits.token_disk_mb * MB
        for fresh in (False, True):
            total = sum((dict(self._charged(owner, fresh)) | dict(wanted)).values())
            if total <= limit:
                return
        what = f"with this upload your files take {_mb(total)}, at most {_mb(limit)} may be kept"
        hint = "delete jobs that are not needed any more; what was only checked goes by itself in an hour"
        raise _full(what, total / MB, limit / MB, hint)

    def _allow_all(self, new: Sequence[Blob]) -> None:
        there = sum(blob.size for blob in self._coming if not self._files.has(blob.sha))
        more = sum(blob.size for blob in new)
        limit = self._limits.disk_mb
        total = self._files.used + there + more
        if limit is not None and total > limit * MB:
            what = (
                f"with this upload all files of this service take {_mb(total)}, at most {limit:g} MB may be"
            )
            raise _full(what, total / MB, limit)
        free = shutil.disk_usage(self._files.root).free - there - more
        if more and free < FREE_MB * MB:
            what = (
                f"this upload would leave {_mb(max(free, 0))} of the service's disk, {FREE_MB:g} MB must be"
            )
            raise _full(what, free / MB, FREE_MB)

    def _charged(self, owner: str, fresh: bool) -> Mapping[str, int]:
        at, known = self._known.get(owner, (-KNOWN_S, {}))
        now = time.monotonic()
        if fresh or now - at >= KNOWN_S:
            known = self._read(owner)
            with self._lock:
                self._known[owner] = (now, known)
        with self._lock:
            sent = {s: v for s, v in self._sent.get(owner, {}).items() if now - v[1] < GRACE_S}
            self._sent[owner] = sent
        return {sha: size for sha, (size, _) in sent.items()} | dict(known)


def _mb(size: float) -> str:
    return f"{size / MB:,.1f} MB"


def _full(what: str, value: float | None, limit: float | None, hint: str | None = None) -> RefusedError:
    hint = hint or "ask who runs the service to delete old jobs or to give it more room"
    issue = Issue("service.storage", what, field="files", value=value, limit=limit, unit="MB", hint=hint)
    return RefusedError(507, issue)
