"""Files by their content: uploads taken in, and room for what a token's files, and all, may take.

Each file is stored once, under its SHA-256, and whole or not at all; so content counts once,
however often it is named. A token is charged with the content of its jobs, and for an hour with
what it sent without making a job of it, because that stays on the disk for so long. Results are
never refused: they are charged when they are there.

What a user uploads (`take`), a problem and its files, is told all at once what is wrong with it.
"""

import dataclasses
import hashlib
import io
import os
import re
import shutil
import sqlite3
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import anyio.to_thread
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnectionError
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

from planner.files import base_name, is_disk_full
from planner.issues import Issue
from planner.reading.strict_yaml import MAX_YAML_BYTES
from planner.service.security import MB, Limits, RefusedError, too_large

CHUNK_BYTES: Final = 1 << 20
"""Bytes of a file that are read at once."""
GRACE_S: Final = 3600.0
"""A file that nobody names is kept for so long: the job that it belongs to may be about to be written."""
_SHA: Final = re.compile(r"[0-9a-f]{64}")
"""A SHA-256 in hexadecimal digits."""


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
                while chunk := stream.read(CHUNK_BYTES):
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
        if not is_sha(sha):
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


def is_sha(value: object) -> bool:
    """Whether it is a SHA-256 as a name of a stored file has it."""
    return isinstance(value, str) and _SHA.fullmatch(value) is not None


def blob_of(stream: BinaryIO) -> Blob:
    """What storing the rest of ``stream`` would give; the stream is where it was afterwards."""
    begin, digest, size = stream.tell(), hashlib.sha256(), 0
    while chunk := stream.read(CHUNK_BYTES):
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


FREE_MB: Final = 256.0
"""So much of the disk is left to the database and to the results of jobs that run."""
KNOWN_S: Final = 10.0
"""So long a token's use is taken to be what it was, unless that would be a refusal."""


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

    def allow(self) -> None:
        """Raises :class:`RefusedError`, 507, where there is no room for anything."""
        with self._lock:
            self._allow_all([])

    def allow_of_other(self, owner: str, blobs: Sequence[Blob]) -> None:
        """Raises :class:`RefusedError`, 507, where somebody whose draft these become has no room for them."""
        self._allow_owner(owner, {blob.sha: blob.size for blob in blobs}, "the files of the draft's owner")

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
            if is_disk_full(error):
                raise _disk_full() from error
            raise
        finally:
            with self._lock:
                self._coming.subtract(blobs)
                self._coming += Counter()  # drops what is at zero

    def _allow_owner(self, owner: str, wanted: Mapping[str, int], whose: str = "your files") -> None:
        limit = self._limits.token_disk_mb * MB
        for fresh in (False, True):
            total = sum((dict(self._charged(owner, fresh)) | dict(wanted)).values())
            if total <= limit:
                return
        what = f"with this upload {whose} take {_mb(total)}, at most {_mb(limit)} may be kept"
        hint = "delete jobs and drafts that are not needed any more; what was only checked goes in an hour"
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
        if free < FREE_MB * MB:  # what is stored already is asked about again all the same
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


def store_refusal(error: Exception) -> RefusedError | None:
    """What to answer where the disk or the database fails: 507 where there is no room, 503 while the database
    is away; None for faults of ours."""
    if is_disk_full(error) or (isinstance(error, DBAPIError) and _is_full(error.orig)):
        return _disk_full()
    if isinstance(error, OperationalError | InterfaceError | NoConnectionError) or (
        isinstance(error, DBAPIError) and error.connection_invalidated
    ):
        issue = Issue("service.database", "the database of this service is away; send the request again")
        return RefusedError(503, issue, {"Retry-After": "5"})
    return None


def _is_full(error: BaseException | None) -> bool:
    """By SQLite's code, and PostgreSQL's (disk_full)."""
    code = getattr(error, "sqlite_errorcode", None)
    return code == sqlite3.SQLITE_FULL or getattr(error, "sqlstate", None) == "53100"


def _mb(size: float) -> str:
    return f"{size / MB:,.1f} MB"


def _disk_full() -> RefusedError:
    """507, with nothing of where on the disk."""
    return _full("the disk of this service is full", None, None)


def _full(what: str, value: float | None, limit: float | None, hint: str | None = None) -> RefusedError:
    hint = hint or "ask who runs the service to delete old jobs or to give it more room"
    issue = Issue("service.storage", what, field="files", value=value, limit=limit, unit="MB", hint=hint)
    return RefusedError(507, issue)


PLAIN: Final = ("application/json", "application/yaml", "application/x-yaml", "text/yaml")
"""Content types of a body that is the problem itself."""
MESHES: Final = (".obj", ".stl", ".ply", ".glb", ".3mf")
"""Endings of files that are meshes, which have a limit of their own."""
FIELDS: Final = ("problem", "files")
"""Fields of a form that uploads a problem."""
LONGEST_NAME: Final = 255
"""Characters that the name of a file may have."""


@dataclasses.dataclass(frozen=True)
class Upload:
    """A stored problem file and the files that came with it, by the user's names."""

    problem: Blob
    files: Mapping[str, Blob]

    @property
    def content(self) -> list[Any]:
        """What tells it from others, as plain data."""
        return [self.problem.sha, {name: blob.sha for name, blob in self.files.items()}]


async def take_upload(request: Request, storage: Storage, owner: str, limits: Limits) -> Upload:
    """The upload of a request: ``multipart/form-data`` with ``problem`` and ``files``, or the problem alone
    as JSON or YAML.

    Raises :class:`RefusedError`, 413, 422 or 507.
    """
    (found,) = (await take_uploads(request, storage, owner, limits, 1)).values()
    return found


async def take_uploads(
    request: Request, storage: Storage, owner: str, limits: Limits, most: int
) -> dict[str, Upload]:
    """The uploads of a request that may have up to ``most`` parts ``problem``, by the names of these, with
    the ``files`` in common; raises as :func:`take_upload`."""
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind in PLAIN:
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_YAML_BYTES:
                raise too_large("the problem", MAX_YAML_BYTES / MB, "problem")
        (blob,) = await anyio.to_thread.run_sync(storage.put, owner, [io.BytesIO(body)])
        return {"problem": Upload(blob, {})}
    if kind != "multipart/form-data":
        what = f"got the content type {kind[:80]!r}; send multipart/form-data, or {', '.join(PLAIN)}"
        raise RefusedError(422, _fault("Content-Type", what))
    try:
        async with request.form(
            max_files=limits.files + most,
            max_fields=len(FIELDS) - 1 + most,
            max_part_size=MAX_YAML_BYTES // most,  # texts are held in memory, files are not
        ) as form:
            problems, uploads = _sorted(form, limits, most)
            return await anyio.to_thread.run_sync(_store, storage, owner, problems, uploads)
    except HTTPException as error:
        what = f"the form cannot be read: {error.detail}"
        more = "; send problems as files" if most > 1 else ""
        raise RefusedError(422, _fault("body", what + more)) from error
    except ClientDisconnect as error:
        raise RefusedError(422, _fault("body", "the upload broke off; send it again")) from error
    except OSError as error:
        if not is_disk_full(error):
            raise
        raise _disk_full() from error
    except (ValueError, LookupError) as error:  # charsets that are none, and the like
        raise RefusedError(422, _fault("body", "the form cannot be read; send UTF-8")) from error


def _sorted(
    form: FormData, limits: Limits, most: int
) -> tuple[dict[str, UploadFile | str], dict[str, UploadFile]]:
    """Up to ``most`` problems, and the files, by their names; raises :class:`RefusedError` with every fault
    of the form."""
    faults = [
        _fault(name[:80], f"unknown field {name[:80]!r}; the fields are {', '.join(FIELDS)}")
        for name in dict.fromkeys(form)
        if name not in FIELDS
    ]
    problems, uploads = form.getlist("problem"), form.getlist("files")
    if not 1 <= len(problems) <= most:
        wanted = (
            "one is wanted; add the problem file" if most == 1 else f"1 to {most} may be; send others apart"
        )
        faults.append(_fault("problem", f"got {len(problems)} problems, {wanted}"))
    jobs: dict[str, UploadFile | str] = {}
    for number, problem in enumerate(problems, 1):
        called = problem if isinstance(problem, str) else problem.filename
        own = f"problem {number}" if isinstance(problem, str) or not called else called
        if most > 1 and (len(own) > LONGEST_NAME or not own.isprintable()):  # of one, nobody asks its name
            faults.append(_unnamed(own, "problem"))
        elif own in jobs:
            faults.append(_fault("problem", f"two problems have the name {own[:80]!r}; rename one"))
        jobs[own] = problem
    named: dict[str, UploadFile] = {}
    for number, one in enumerate(uploads):
        field = f"files.{number}"
        if isinstance(one, str):
            faults.append(_fault(field, "is text, a file with a name is wanted; send it as a file"))
            continue
        name = one.filename or ""
        if not base_name(name) or len(name) > LONGEST_NAME or not name.isprintable():
            faults.append(_unnamed(name, field))
        elif name in named:
            what = f"two files have the name {name[:80]!r}; rename one"
            faults.append(Issue("service.file_name", f"{field}: {what}", field=field))
        else:
            named[name] = one
            if name.lower().endswith(MESHES) and (one.size or 0) > limits.mesh_mb * MB:
                raise too_large(f"{name[:80]!r}", limits.mesh_mb, field)
    if faults:
        raise RefusedError(422, faults)
    return jobs, named


def _store(
    storage: Storage, owner: str, problems: Mapping[str, UploadFile | str], uploads: Mapping[str, UploadFile]
) -> dict[str, Upload]:
    streams: list[BinaryIO] = [
        io.BytesIO(one.encode()) if isinstance(one, str) else one.file for one in problems.values()
    ]
    blobs = storage.put(owner, [*streams, *(one.file for one in uploads.values())])
    files = dict(zip(uploads, blobs[len(problems) :], strict=True))
    return {name: Upload(blob, files) for name, blob in zip(problems, blobs, strict=False)}


def _unnamed(name: str, field: str) -> Issue:
    what = f"the name {name[:80]!r} of {len(name)} characters is empty, has more than {LONGEST_NAME} "
    what += "or one that is not printable, or ends as a folder does; rename the file"
    return Issue("service.file_name", f"{field}: {what}", field=field)


def _fault(field: str, what: str) -> Issue:
    return Issue("service.request", f"{field}: {what}", field=field)


def documented(problem: Mapping[str, Any], most: int = 1) -> dict[str, Any]:
    """The request body for OpenAPI, of up to ``most`` problems; ``problem`` is the schema of their files."""
    longest = MAX_YAML_BYTES // most
    text = {"type": "string", "maxLength": longest, "description": "the same as YAML or JSON text"}
    form: dict[str, Any] = {
        "type": "object",
        "required": ["problem"],
        "additionalProperties": False,
        "properties": {
            "problem": {"anyOf": [dict(problem), text]},
            "files": {
                "type": "array",
                "items": {"type": "string", "format": "binary"},
                "description": "the files that the problem names, each under the name that it uses; folders "
                "in names do not matter",
            },
        },
    }
    encoding = {"problem": {"contentType": "application/json"}}
    content: dict[str, Any] = {"multipart/form-data": {"schema": form, "encoding": encoding}}
    if most > 1:
        many = {"type": "array", "items": form["properties"]["problem"], "minItems": 1, "maxItems": most}
        form["properties"] = {**form["properties"], "problem": many}
        return {"required": True, "content": content}
    content["application/json"] = {"schema": dict(problem)}
    content["application/yaml"] = {"schema": dict(problem)}
    return {"required": True, "content": content}
