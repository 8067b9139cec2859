"""Content-addressed files: storage of uploads, and limits for the files of a token and of the service.

Each file is stored once, under its SHA-256, and whole or not at all. Equal content therefore counts once,
however many jobs use it. A token is charged for the content of its jobs, and for an hour for uploads
without a job, because they stay on the disk for that time. Results are never refused: they are charged once
they exist.

An upload is a problem and its files. All faults of an upload are reported at once.
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
from planner.service.security import MB, RefusedError, ServiceLimits, too_large

CHUNK_BYTES: Final = 1 << 20
"""Bytes of a file that are read at a time."""
GRACE_S: Final = 3600.0
"""Time [s] for which an unused file is kept, because its job may not have been written yet."""
_SHA: Final = re.compile(r"[0-9a-f]{64}")
"""A SHA-256 in hexadecimal digits."""


class Blob(NamedTuple):
    """A stored file.

    Attributes:
        sha: SHA-256 in hexadecimal digits.
        size: Size [bytes].
    """

    sha: str
    size: int


class ContentStore:
    """Content-addressed files in a folder, with subfolders by the first two digits of the hash."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._incoming = root / "incoming"
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._lock = threading.Lock()
        self.used = self._total_size()
        """Size of all files [bytes]. Files of other hosts are included after the next sweep."""

    def put(self, stream: BinaryIO, known: Blob | None = None) -> Blob:
        """Store the rest of a stream.

        Args:
            stream: Stream.
            known: Hash and size from :func:`blob_of`, if known. Then the content is not hashed again, and
                is read only if it is new.

        Raises:
            OSError: The content has another size than ``known``, or the disk is full.
        """
        if known is not None and self._touch(known.sha):
            return known
        digest, size = hashlib.sha256(), 0
        handle, temporary_path = tempfile.mkstemp(dir=self._incoming)
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
            if size != blob.size:  # a hash must not name other content
                raise OSError(f"read {size} bytes of a file of {blob.size}")
            target = self.path(blob.sha)
            with self._lock:
                is_new = not self._touch(blob.sha)
                if is_new:
                    target.parent.mkdir(exist_ok=True)
                    Path(temporary_path).replace(target)
                    self.used += size
            if is_new:
                _sync_folder(target.parent)
        finally:
            Path(temporary_path).unlink(missing_ok=True)
        return blob

    def put_file(self, path: Path) -> Blob:
        """Store a file of the disk."""
        with path.open("rb") as stream:
            return self.put(stream)

    def path(self, sha: str) -> Path:
        """Return the path of the file with a hash.

        Args:
            sha: SHA-256 in hexadecimal digits.

        Raises:
            ValueError: Not a SHA-256.
        """
        if not is_sha(sha):
            raise ValueError(f"{sha!r} is not a SHA-256")
        return self.root / sha[:2] / sha

    def has(self, sha: str) -> bool:
        """Report whether a file is stored."""
        return self.path(sha).is_file()

    def read(self, sha: str) -> bytes:
        """Return the content of a file."""
        return self.path(sha).read_bytes()

    def sweep(self, used_shas: Callable[[list[str]], set[str]]) -> int:
        """Remove files that are older than `GRACE_S` and unused, and what interrupted uploads left.

        Args:
            used_shas: Function that returns those of some hashes that a job or draft references.

        Returns:
            Number of removed files.
        """
        limit_time, removed = time.time() - GRACE_S, 0
        for folder in sorted(self.root.iterdir()):
            old_paths = [path for path in folder.iterdir() if _is_older(path, limit_time)]
            if folder == self._incoming:
                used: set[str] = set()
            else:
                old_paths = [path for path in old_paths if _SHA.fullmatch(path.name)]
                used = used_shas([path.name for path in old_paths]) if old_paths else set()
            for path in old_paths:
                if path.name not in used and _is_older(path, limit_time):
                    path.unlink(missing_ok=True)
                    removed += 1
        with self._lock:
            self.used = self._total_size()
        return removed

    def _touch(self, sha: str) -> bool:
        """Report whether a file is stored, and protect it from the next sweep."""
        try:
            os.utime(self.path(sha))
        except FileNotFoundError:
            return False
        return True

    def _total_size(self) -> int:
        """Return the size of all stored files [bytes], without uploads in progress."""
        folders = [folder for folder in self.root.iterdir() if folder != self._incoming and folder.is_dir()]
        return sum(_size(path) for folder in folders for path in folder.iterdir())


def is_sha(value: object) -> bool:
    """Report whether a value is a SHA-256, as in the names of stored files."""
    return isinstance(value, str) and _SHA.fullmatch(value) is not None


def blob_of(stream: BinaryIO) -> Blob:
    """Return hash and size of the rest of a stream. The position of the stream is restored."""
    position, digest, size = stream.tell(), hashlib.sha256(), 0
    while chunk := stream.read(CHUNK_BYTES):
        digest.update(chunk)
        size += len(chunk)
    stream.seek(position)
    return Blob(digest.hexdigest(), size)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # removed by another host's sweep
        return 0


def _is_older(path: Path, limit_time: float) -> bool:
    try:
        return path.stat().st_mtime < limit_time
    except FileNotFoundError:
        return False


def _sync_folder(folder: Path) -> None:
    """Synchronise a folder, so that a rename in it is on disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


MIN_FREE_MB: Final = 256.0
"""Disk space [MB] that is reserved for the database and for the results of running jobs."""
USAGE_CACHE_S: Final = 10.0
"""Time [s] for which the size of a token's files is cached, unless the result would be a refusal."""


class StorageQuota:
    """The stored files with their limits.

    Args:
        files: Stored files.
        read_owned: Function that returns a token's content: sizes [bytes] by SHA-256.
        limits: Limits.
    """

    def __init__(
        self, files: ContentStore, read_owned: Callable[[str], Mapping[str, int]], limits: ServiceLimits
    ) -> None:
        self._files, self._read_owned, self._limits = files, read_owned, limits
        self._lock = threading.Lock()
        self._usage: dict[str, tuple[float, Mapping[str, int]]] = {}
        self._sent: dict[str, dict[str, tuple[int, float]]] = {}
        self._incoming: Counter[Blob] = Counter()

    def put(self, owner: str, streams: Sequence[BinaryIO]) -> list[Blob]:
        """Store streams, all or none.

        Args:
            owner: Token that is charged.
            streams: Streams.

        Raises:
            RefusedError: 507.
        """
        blobs = [blob_of(stream) for stream in streams]
        with self._reserved_space(owner, blobs):
            return [self._files.put(*item) for item in zip(streams, blobs, strict=True)]

    def check_space(self) -> None:
        """Check that there is disk space at all.

        Raises:
            RefusedError: 507.
        """
        with self._lock:
            self._check_disk_limits([])

    def check_owner_space(self, owner: str, blobs: Sequence[Blob]) -> None:
        """Check that the owner of a draft has space for files that another person saves.

        Args:
            owner: Owner of the draft.
            blobs: Files.

        Raises:
            RefusedError: 507.
        """
        self._check_owner_limit(
            owner, {blob.sha: blob.size for blob in blobs}, "the files of the draft's owner"
        )

    def used(self, owner: str) -> int:
        """Return the size of a token's files [bytes]."""
        return sum(self._charged(owner, fresh=True).values())

    @contextmanager
    def _reserved_space(self, owner: str, blobs: Sequence[Blob]) -> Iterator[None]:
        """Check the limits for files and reserve their space on the disk while they are stored."""
        sizes = {blob.sha: blob.size for blob in blobs}
        self._check_owner_limit(owner, sizes)
        with self._lock:
            self._check_disk_limits([blob for blob in set(blobs) if not self._files.has(blob.sha)])
            self._incoming.update(blobs)
            now = time.monotonic()
            self._sent.setdefault(owner, {}).update({sha: (size, now) for sha, size in sizes.items()})
        try:
            yield
        except OSError as error:
            if is_disk_full(error):
                raise _disk_full() from error
            raise
        finally:
            with self._lock:
                self._incoming.subtract(blobs)
                self._incoming += Counter()  # drops zero counts

    def _check_owner_limit(self, owner: str, sizes: Mapping[str, int], whose: str = "your files") -> None:
        """Check that an owner's content stays within its limit with new content: sizes [bytes] by SHA-256.

        ``whose`` is the subject of the message.
        """
        limit = self._limits.token_disk_mb * MB
        # A cached size may be too large, so a refusal is based on the size that is read again.
        for fresh in (False, True):
            total = sum((dict(self._charged(owner, fresh)) | dict(sizes)).values())
            if total <= limit:
                return
        message = f"{whose} would be too large (got {_mb(total)}, allowed {_mb(limit)})"
        hint = "Delete jobs and drafts that are no longer needed. Checked uploads are removed after an hour."
        raise _storage_refusal(message, total / MB, limit / MB, hint)

    def _check_disk_limits(self, new: Sequence[Blob]) -> None:
        """Check that new files fit into the limit of the service and on the disk."""
        incoming = sum(blob.size for blob in self._incoming if not self._files.has(blob.sha))
        new_bytes = sum(blob.size for blob in new)
        limit = self._limits.disk_mb
        total = self._files.used + incoming + new_bytes
        if limit is not None and total > limit * MB:
            message = f"all files of the service would be too large (got {_mb(total)}, allowed {limit:g} MB)"
            raise _storage_refusal(message, total / MB, limit)
        free = shutil.disk_usage(self._files.root).free - incoming - new_bytes
        if free < MIN_FREE_MB * MB:  # also for content that is already stored
            message = (
                f"too little free disk space would remain (got {_mb(max(free, 0))}, required {MIN_FREE_MB:g} "
                "MB)"
            )
            raise _storage_refusal(message, free / MB, MIN_FREE_MB)

    def _charged(self, owner: str, fresh: bool) -> Mapping[str, int]:
        """Return the sizes [bytes] of the content that an owner is charged for, by SHA-256.

        This is the content of its jobs and drafts, cached unless ``fresh``, and its recent uploads.
        """
        cached_at, owned_sizes = self._usage.get(owner, (-USAGE_CACHE_S, {}))
        now = time.monotonic()
        if fresh or now - cached_at >= USAGE_CACHE_S:
            owned_sizes = self._read_owned(owner)
            with self._lock:
                self._usage[owner] = (now, owned_sizes)
        with self._lock:
            recent_uploads = {
                sha: size_and_time
                for sha, size_and_time in self._sent.get(owner, {}).items()
                if now - size_and_time[1] < GRACE_S
            }
            self._sent[owner] = recent_uploads
        return {sha: size for sha, (size, _) in recent_uploads.items()} | dict(owned_sizes)


def refusal_of_error(error: Exception) -> RefusedError | None:
    """Return the refusal for an error of the disk or the database.

    Args:
        error: Error.

    Returns:
        507 if the disk is full, 503 while the database is unavailable, None for faults of the service
        itself.
    """
    if is_disk_full(error) or (isinstance(error, DBAPIError) and _is_full(error.orig)):
        return _disk_full()
    if isinstance(error, OperationalError | InterfaceError | NoConnectionError) or (
        isinstance(error, DBAPIError) and error.connection_invalidated
    ):
        issue = Issue("service.database", "the database of this service is unavailable. Try again.")
        return RefusedError(503, issue, {"Retry-After": "5"})
    return None


def _is_full(error: BaseException | None) -> bool:
    """Report whether a database error means a full disk (codes of SQLite and PostgreSQL)."""
    code = getattr(error, "sqlite_errorcode", None)
    return code == sqlite3.SQLITE_FULL or getattr(error, "sqlstate", None) == "53100"


def _mb(size: float) -> str:
    return f"{size / MB:,.1f} MB"


def _disk_full() -> RefusedError:
    """Return the refusal for a full disk: 507. It contains no path."""
    return _storage_refusal("the disk of this service is full", None, None)


def _storage_refusal(
    message: str, value: float | None, limit: float | None, hint: str | None = None
) -> RefusedError:
    """Return the refusal for missing space: 507. Value and limit are in MB."""
    hint = hint or "Ask the operator of the service to delete old jobs or to add disk space."
    issue = Issue("service.storage", message, field="files", value=value, limit=limit, unit="MB", hint=hint)
    return RefusedError(507, issue)


PROBLEM_TYPES: Final = ("application/json", "application/yaml", "application/x-yaml", "text/yaml")
"""Content types of a body that is the problem itself."""
MESH_SUFFIXES: Final = (".obj", ".stl", ".ply", ".glb", ".3mf")
"""Suffixes of mesh files, which have a limit of their own."""
FORM_FIELDS: Final = ("problem", "files")
"""Fields of a multipart form that uploads a problem."""
MAX_NAME_LENGTH: Final = 255
"""Maximum number of characters of a file name."""


@dataclasses.dataclass(frozen=True)
class ProblemUpload:
    """A stored problem file and its files, by the names that the user gave."""

    problem: Blob
    files: Mapping[str, Blob]

    @property
    def content(self) -> list[Any]:
        """Hashes that identify the upload, as plain data."""
        return [self.problem.sha, {name: blob.sha for name, blob in self.files.items()}]


async def store_upload(
    request: Request, storage: StorageQuota, owner: str, limits: ServiceLimits
) -> ProblemUpload:
    """Store the upload of a request.

    The body is ``multipart/form-data`` with ``problem`` and ``files``, or the problem alone as JSON or
    YAML.

    Args:
        request: Request.
        storage: Stored files.
        owner: Token that is charged.
        limits: Limits.

    Raises:
        RefusedError: 413, 422 or 507.
    """
    (upload,) = (await store_uploads(request, storage, owner, limits, 1)).values()
    return upload


async def store_uploads(
    request: Request, storage: StorageQuota, owner: str, limits: ServiceLimits, max_problems: int
) -> dict[str, ProblemUpload]:
    """Store the uploads of a request with several parts ``problem`` and common ``files``.

    Args:
        request: Request.
        storage: Stored files.
        owner: Token that is charged.
        limits: Limits.
        max_problems: Maximum number of problems.

    Returns:
        Uploads by the names of the problems.

    Raises:
        RefusedError: As :func:`store_upload`.
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind in PROBLEM_TYPES:
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_YAML_BYTES:
                raise too_large("the problem", MAX_YAML_BYTES / MB, "problem")
        (blob,) = await anyio.to_thread.run_sync(storage.put, owner, [io.BytesIO(body)])
        return {"problem": ProblemUpload(blob, {})}
    if kind != "multipart/form-data":
        message = f"unsupported (got {kind[:80]!r}, allowed multipart/form-data, {', '.join(PROBLEM_TYPES)})"
        raise RefusedError(422, _request_issue("Content-Type", message))
    try:
        async with request.form(
            max_files=limits.files + max_problems,
            max_fields=len(FORM_FIELDS) - 1 + max_problems,
            max_part_size=MAX_YAML_BYTES // max_problems,  # text parts are held in memory, files are not
        ) as form:
            problems, uploads = _sort_form(form, limits, max_problems)
            return await anyio.to_thread.run_sync(_store_form, storage, owner, problems, uploads)
    except HTTPException as error:
        message = f"the form cannot be read: {error.detail}"
        advice = " Send problems as files." if max_problems > 1 else ""
        raise RefusedError(422, _request_issue("body", message + advice)) from error
    except ClientDisconnect as error:
        raise RefusedError(
            422, _request_issue("body", "the upload was interrupted. Send it again.")
        ) from error
    except OSError as error:
        if not is_disk_full(error):
            raise
        raise _disk_full() from error
    except (ValueError, LookupError) as error:  # unknown charsets, for example
        raise RefusedError(422, _request_issue("body", "the form cannot be read. Send UTF-8.")) from error


def _sort_form(
    form: FormData, limits: ServiceLimits, max_problems: int
) -> tuple[dict[str, UploadFile | str], dict[str, UploadFile]]:
    """Check the parts of an upload form, and return its problems and its files, each by name.

    A problem may be a text field, which has no name. It is then called "problem N", with N from 1.

    Raises:
        RefusedError: 422 with all faults of the form, or 413, a mesh is too large.
    """
    faults = [
        _request_issue(name[:80], f"unknown field (got {name[:80]!r}, allowed {', '.join(FORM_FIELDS)})")
        for name in dict.fromkeys(form)
        if name not in FORM_FIELDS
    ]
    problem_parts, file_parts = form.getlist("problem"), form.getlist("files")
    if not 1 <= len(problem_parts) <= max_problems:
        remedy = (
            "allowed one). Add the problem file."
            if max_problems == 1
            else f"allowed 1 to {max_problems}). Use several requests."
        )
        faults.append(
            _request_issue("problem", f"wrong number of problems (got {len(problem_parts)}, {remedy}")
        )
    problems: dict[str, UploadFile | str] = {}
    for number, problem in enumerate(problem_parts, 1):
        stated_name = problem if isinstance(problem, str) else problem.filename
        problem_name = f"problem {number}" if isinstance(problem, str) or not stated_name else stated_name
        if max_problems > 1 and (
            len(problem_name) > MAX_NAME_LENGTH or not problem_name.isprintable()
        ):  # a single name is unused
            faults.append(_name_issue(problem_name, "problem"))
        elif problem_name in problems:
            faults.append(
                _request_issue("problem", f"two problems have the name {problem_name[:80]!r}. Rename one.")
            )
        problems[problem_name] = problem
    files: dict[str, UploadFile] = {}
    for number, upload in enumerate(file_parts):
        field = f"files.{number}"
        if isinstance(upload, str):
            faults.append(_request_issue(field, "is a text field. Send it as a file with a name."))
            continue
        name = upload.filename or ""
        if not base_name(name) or len(name) > MAX_NAME_LENGTH or not name.isprintable():
            faults.append(_name_issue(name, field))
        elif name in files:
            message = f"two files have the name {name[:80]!r}. Rename one."
            faults.append(Issue("service.file_name", f"{field}: {message}", field=field))
        else:
            files[name] = upload
            if name.lower().endswith(MESH_SUFFIXES) and (upload.size or 0) > limits.mesh_mb * MB:
                raise too_large(f"{name[:80]!r}", limits.mesh_mb, field)
    if faults:
        raise RefusedError(422, faults)
    return problems, files


def _store_form(
    storage: StorageQuota,
    owner: str,
    problems: Mapping[str, UploadFile | str],
    uploads: Mapping[str, UploadFile],
) -> dict[str, ProblemUpload]:
    """Store the parts of a form, all or none. All problems get all files."""
    streams: list[BinaryIO] = [
        io.BytesIO(part.encode()) if isinstance(part, str) else part.file for part in problems.values()
    ]
    blobs = storage.put(owner, [*streams, *(part.file for part in uploads.values())])
    files = dict(zip(uploads, blobs[len(problems) :], strict=True))
    return {name: ProblemUpload(blob, files) for name, blob in zip(problems, blobs, strict=False)}


def _name_issue(name: str, field: str) -> Issue:
    problem = (
        f"invalid file name (got {name[:80]!r} with {len(name)} characters, allowed 1 to {MAX_NAME_LENGTH} "
    )
    problem += "printable characters that do not name a folder). Rename the file."
    return Issue("service.file_name", f"{field}: {problem}", field=field)


def _request_issue(field: str, problem: str) -> Issue:
    return Issue("service.request", f"{field}: {problem}", field=field)


def request_body_schema(problem: Mapping[str, Any], max_problems: int = 1) -> dict[str, Any]:
    """Return the OpenAPI description of a request body with problems.

    Args:
        problem: Schema of a problem file.
        max_problems: Maximum number of problems.
    """
    max_text_length = MAX_YAML_BYTES // max_problems
    text = {"type": "string", "maxLength": max_text_length, "description": "the problem as YAML or JSON text"}
    form: dict[str, Any] = {
        "type": "object",
        "required": ["problem"],
        "additionalProperties": False,
        "properties": {
            "problem": {"anyOf": [dict(problem), text]},
            "files": {
                "type": "array",
                "items": {"type": "string", "format": "binary"},
                "description": "the files that the problem uses, each under the name that it states; folders "
                "in names are ignored",
            },
        },
    }
    encoding = {"problem": {"contentType": "application/json"}}
    content: dict[str, Any] = {"multipart/form-data": {"schema": form, "encoding": encoding}}
    if max_problems > 1:
        problem_list = {
            "type": "array",
            "items": form["properties"]["problem"],
            "minItems": 1,
            "maxItems": max_problems,
        }
        form["properties"] = {**form["properties"], "problem": problem_list}
        return {"required": True, "content": content}
    content["application/json"] = {"schema": dict(problem)}
    content["application/yaml"] = {"schema": dict(problem)}
    return {"required": True, "content": content}
