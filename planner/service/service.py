"""All that a running service is made of, and what it was started with."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import functools
import hashlib
import io
import json
import os
import secrets
import shutil
import socket
import threading
from collections import Counter, OrderedDict
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import anyio
import anyio.to_thread
from sqlalchemy.exc import SQLAlchemyError
from starlette.requests import Request

from planner.batch.job import PROBLEM, all_versions
from planner.issues import Issue, refusal
from planner.service.drafts import Drafts
from planner.service.elements import Elements
from planner.service.estimates import Estimates
from planner.service.examined import Examined
from planner.service.idempotency import Once
from planner.service.jobs import Hub, Jobs, NewJob, OfElement
from planner.service.links import Links
from planner.service.models import Database, JobOut, default_url
from planner.service.pieces import Pieces, Read
from planner.service.rates import FAILURES_PER_S, Rates
from planner.service.releases import Releases
from planner.service.runner import Runner, Team, Work
from planner.service.security import LOCAL, LOOPBACK, Auth, Limits, RefusedError, too_many
from planner.service.storage import Blob, Files, Storage, Upload
from planner.service.texts import begin
from planner.service.upload_processes import Examiners, Reading, connection_closed
from planner.service.webhooks import Sender, Webhooks

if TYPE_CHECKING:
    from planner.service.oidc import LogIn, Oidc

PID_MARK: Final = ".pid-"
"""Stands before the process identifier in the name of a service's folder."""
PANELS_AT_ONCE: Final = 20
"""Panels of an element that are read before others have their turn."""
REMEMBERED: Final = 256
"""So many uploads that were read are known again."""


@dataclasses.dataclass(frozen=True)
class Options:
    """How a service is started. ``data``: folder of the files, and of the database where no URL is given.
    ``trusted_proxies``: addresses, or networks, whose word is taken on how a request came to them.
    ``webhook_hosts``: hosts that may be told of jobs that end."""

    data: Path
    host: str = "127.0.0.1"
    port: int = 8000
    database: str | None = None
    workers: int = 1
    examiners: int = 2
    cluster: str | None = None
    require_token: bool = False
    trusted_proxies: tuple[str, ...] = ("127.0.0.1", "::1")
    lease_s: float = 30.0
    oidc: Oidc | None = None
    webhook_hosts: tuple[str, ...] = ()
    limits: Limits = dataclasses.field(default_factory=Limits)

    @property
    def tokens_required(self) -> bool:
        """Off loopback always, and where people log in."""
        return self.require_token or self.oidc is not None or self.host not in LOOPBACK

    @property
    def url(self) -> str:
        """The database."""
        return self.database or default_url(self.data)


class Service:
    """One instance of the service; :meth:`start` and :meth:`close` belong to its server's life."""

    def __init__(self, options: Options, make_team: Callable[[], Team]) -> None:
        """Raises ``TandemError``: the folder or the database cannot be had, or tokens are missing."""
        self.options, self.limits = options, options.limits
        self._lock = lock_data(options.data, options.database is None)
        self.database = Database(options.url)
        self.auth = Auth(self.database)
        if options.tokens_required and options.oidc is None and not self.auth.any():
            self.database.close()
            message = f"host {options.host}: whoever can reach it needs a token, and there is none yet"
            hint = f"make one: tandem token add NAME --data {options.data}"
            raise refusal("service.start", message, field="host", hint=hint)
        self.links = Links(self.database)
        self.log_in = None if options.oidc is None else _log_in(self.database, self.auth, options.oidc)
        self.rates, self.failures = Rates(options.limits.requests_per_s), Rates(FAILURES_PER_S)
        self.files = Files(options.data / "files")
        self.host = f"{socket.gethostname()}{PID_MARK}{os.getpid()}-{secrets.token_hex(4)}"
        self.scratch = _work_folder(options.data / "work", options.database is None, self.host)
        self.jobs = Jobs(self.database, self.limits)
        self.storage = Storage(self.files, self.jobs.owned, self.limits)
        self.hub = Hub(self.database, self.limits, self.auth)
        limits = self.limits
        self._examiners = Examiners(
            options.examiners, self.scratch, limits.check_s, limits.check_memory_mb, limits.mesh_facets
        )
        self.webhooks = Webhooks(self.database, options.webhook_hosts)
        self._sender = Sender(self.webhooks)
        self.runner = Runner(
            Work(self.database, self.host, options.lease_s),
            self.files,
            make_team,
            options.workers,
            self.scratch,
            lease_s=options.lease_s,
            alone=options.database is None,
            keep_s=None if limits.keep_days is None else limits.keep_days * 86400.0,
            audit_s=None if limits.audit_days is None else limits.audit_days * 86400.0,
            shas=self.jobs.shas,
            on_newer=self._sender.stop,
        )
        self.elements = Elements(self)
        self.estimates = Estimates(self.database)
        self.drafts = Drafts(self.database, self.limits)
        self.releases = Releases(self.database, self.files)
        self._turns: dict[str, anyio.Semaphore] = {}
        self._readers = anyio.Semaphore(options.examiners)  # in the order of who asks
        self._long: dict[str, anyio.Lock] = {}
        self._waiting: Counter[str] = Counter()
        self._read: OrderedDict[str, Examined] = OrderedDict()
        self._read_lock = threading.Lock()

    async def made_once(
        self,
        request: Request,
        owner: str,
        once: Once | None,
        make: Callable[[Reading], Pieces[Sequence[JobOut]]],
    ) -> Sequence[JobOut]:
        """The jobs that a request made which is to be done ``once``, else those that are made now; raises as
        :meth:`in_turns`, and 422 for a key that came with another request."""
        known = await anyio.to_thread.run_sync(self.jobs.made, once)
        return known or await self.in_turns(request, owner, make)

    async def in_turn(self, request: Request, owner: str, read: Callable[[Reading], Read]) -> Read:
        """What ``read`` gives, in one piece; raises as :meth:`in_turns`."""

        def whole(reading: Reading) -> Pieces[Read]:
            yield
            return read(reading)

        return await self.in_turns(request, owner, whole)

    async def in_turns(self, request: Request, owner: str, read: Callable[[Reading], Pieces[Read]]) -> Read:
        """What ``read`` gives, each of its pieces in a thread when it is the owner's turn: one token never
        keeps all readers from the others, who wait for one piece of a long reading and not for the whole, and
        has so many requests waiting at most. A connection that is closed meanwhile ends its reading. The
        request's body has come in.

        Raises what ``read`` does, and :class:`RefusedError`: 429 where too many wait, 499 where who asked
        has gone.
        """
        reading = Reading()
        found: list[Read] = []
        failed: list[Exception] = []
        async with anyio.create_task_group() as tasks:

            async def wait_and_read() -> None:
                try:
                    async with self._waits(owner):
                        found.extend(await self._read_in_turns(owner, read(reading)))
                except Exception as error:  # a task group would wrap it
                    failed.append(error)
                tasks.cancel_scope.cancel()

            tasks.start_soon(wait_and_read)
            while (await request.receive())["type"] != "http.disconnect":
                pass
            reading.break_off()  # the thread is not given up: it ends with its process
            tasks.cancel_scope.cancel()
        if failed:
            raise failed[0]
        if not found:
            raise connection_closed()
        return found[0]

    async def _read_in_turns(self, owner: str, pieces: Pieces[Read]) -> list[Read]:
        """What was read. Of several long readings of one owner one goes on, for what was read of each is held
        in memory until its end."""
        readers = self.options.examiners if owner == LOCAL else max(1, self.options.examiners - 1)
        own = self._turns.setdefault(owner, anyio.Semaphore(readers))

        async def piece() -> list[Read]:
            async with own, self._readers:
                return await anyio.to_thread.run_sync(_go_on, pieces)

        if found := _go_on(pieces) or await piece():
            return found
        async with self._long.setdefault(owner, anyio.Lock()):
            while not (found := await piece()):
                pass
        return found

    @contextlib.asynccontextmanager
    async def _waits(self, owner: str) -> AsyncIterator[None]:
        most = self.limits.readings
        if owner != LOCAL and self._waiting[owner] >= most:
            what = f"{most} uploads of this token wait to be read, as many as may; send this one later"
            raise too_many(what, 5, most)
        self._waiting[owner] += 1
        try:
            yield
        finally:
            self._waiting[owner] -= 1

    def start(self) -> None:
        """Begin to plan."""
        self.runner.start()
        self._sender.start()

    def closed(self) -> RefusedError | None:
        """Why no request is taken, whoever asks; None where some are."""
        if self.database.newer is None:
            return None
        remedy = "Update tandem-planner on this host, or use another host of the service."
        message = f"the database {self.database.newer}. {remedy}"
        return RefusedError(503, Issue("service.database", message), {"Retry-After": "60"})

    def unready(self) -> list[Issue]:
        """Why jobs are not taken in or not planned now; nothing where they are."""
        issues = []
        try:
            self.database.ping()
        except SQLAlchemyError:
            issues.append(Issue("service.database", "the database is away"))
        try:
            self.storage.allow()
        except RefusedError as refused:
            issues += refused.issues
        if closed := self.closed():
            issues = list(closed.issues)
        elif not issues and not self.runner.working:
            issues.append(Issue("service.not_planning", "jobs are taken in, and none is planned now"))
        return issues

    def stop_reading(self) -> None:
        """End the reading of uploads; requests that wait for it are told."""
        self._examiners.close()

    def close(self) -> None:
        """Stop: jobs that run wait for the next start."""
        self.hub.close()
        self.runner.stop()
        self._sender.stop()
        self._examiners.close()
        self.database.close()
        shutil.rmtree(self.scratch, ignore_errors=True)
        self._lock.close()

    def examine(
        self,
        upload: Upload,
        reach: bool = False,
        draw: bool = False,
        reading: Reading | None = None,
        targets: int | None = None,
        cell: Mapping[str, Any] | None = None,
        fields: Mapping[str, Any] | None = None,
    ) -> Examined:
        """Read an upload, with ``fields`` in place of its own; one that was read is known again. Raises
        :class:`RefusedError`, 413, 422, or 499 where ``reading`` is broken off."""
        rows = [
            upload.problem.sha,
            reach,
            draw,
            targets,
            sorted((cell or {}).items()),
            sorted((fields or {}).items()),
            sorted((name, blob.sha) for name, blob in upload.files.items()),
        ]
        key = hashlib.sha256(json.dumps(rows).encode()).hexdigest()
        with self._read_lock:
            known = self._read.get(key)
        if known is None:
            uploads = {name: self.files.path(blob.sha) for name, blob in upload.files.items()}
            problem = self.files.path(upload.problem.sha)
            known = _readable(
                self._examiners.examine(problem, uploads, reach, draw, reading, targets, cell, fields)
            )
            if draw or cell:  # pictures are large, and asked for once
                return known
            with self._read_lock:
                self._read[key] = known
                while len(self._read) > REMEMBERED:
                    self._read.popitem(last=False)
        return known

    def create(
        self,
        owner: str,
        upload: Upload,
        timeout_s: float | None,
        memory_mb: float | None,
        reading: Reading | None = None,
        once: Once | None = None,
    ) -> Pieces[list[JobOut]]:
        """The one job for an upload; raises :class:`RefusedError`, 413, 422, 429, 499 or 507."""
        yield
        read = self.examine(upload, reading=reading)
        files = self.stored(owner, {PROBLEM: read}, upload.files)[PROBLEM]
        return [self.jobs.create(self.new_job(owner, read.name, read, files, timeout_s, memory_mb), once)]

    def sweep(
        self,
        owner: str,
        upload: Upload,
        field: str,
        values: Sequence[Any],
        tag: str,
        reading: Reading,
        once: Once | None = None,
    ) -> Pieces[list[JobOut]]:
        """A job for each value of a field, all or none; raises as :meth:`create`."""
        read: dict[str, Examined] = {}
        for number, value in enumerate(values):
            yield
            said = f"{field} = {json.dumps(value, ensure_ascii=False)[:80]}: "
            with _said_of(said):
                read[str(number)] = self.examine(upload, reading=reading, fields={field: value})
        files = self.stored(owner, read, upload.files, PROBLEM)
        jobs = []
        for (name, one), value in zip(read.items(), values, strict=True):
            shown = value if isinstance(value, str) else json.dumps(value)
            title = begin(f"{one.name}: {field} = {shown}")
            new = self.new_job(owner, one.name, one, files[name])
            jobs.append(dataclasses.replace(new, title=title, tags=(tag,)))
        return self.jobs.create_all(jobs, once)

    def batch(
        self, owner: str, uploads: Mapping[str, Upload], tag: str, reading: Reading, once: Once | None = None
    ) -> Pieces[list[JobOut]]:
        """A job for each of several problems with common files, all or none; raises as :meth:`create`, for
        all problems that cannot be read at once."""
        read: dict[str, Examined] = {}
        refused: list[tuple[int, Issue]] = []
        for number, (name, upload) in enumerate(uploads.items()):
            yield
            try:
                with _said_of(f"{name[:80]}: "):
                    read[name] = self.examine(upload, reading=reading)
            except RefusedError as error:
                if error.status != 422:
                    raise
                refused += [(number, issue) for issue in error.issues]
        if refused:
            raise RefusedError(422, [one for _, one in refused], of=[number for number, _ in refused])
        files = {name: blob for upload in uploads.values() for name, blob in upload.files.items()}
        stored = self.stored(owner, read, files, PROBLEM)
        same = Counter(one.name for one in read.values())
        jobs = []
        for name, one in read.items():  # those that have one name are told apart by their files
            title = begin(f"{one.name}: {name}") if same[one.name] > 1 else ""
            new = self.new_job(owner, one.name, one, stored[name])
            jobs.append(dataclasses.replace(new, title=title, tags=(tag,)))
        return self.jobs.create_all(jobs, once)

    def examine_element(
        self, sha: str, uploads: Mapping[str, Blob], fields: Mapping[str, Any], reading: Reading
    ) -> Examined:
        """Read an uploaded element; raises as :meth:`examine`."""
        paths = {name: self.files.path(blob.sha) for name, blob in uploads.items()}
        return _readable(self._examiners.examine_element(self.files.path(sha), paths, fields, reading))

    def examine_panels(
        self, files: Mapping[str, Blob], panels: Sequence[str], reading: Reading
    ) -> Pieces[dict[str, Examined]]:
        """Panels out of the files of a divided element, by their ids; raises as :meth:`examine`."""
        paths = {name: self.files.path(blob.sha) for name, blob in files.items()}
        read: dict[str, Examined] = {}
        for start in range(0, len(panels), PANELS_AT_ONCE):
            yield
            some = panels[start : start + PANELS_AT_ONCE]
            found = self._examiners.examine_panels(paths, some, reading)
            read |= dict(zip(some, map(_readable, found), strict=True))
        return read

    def stored(
        self,
        owner: str,
        read: Mapping[str, Examined],
        uploads: Mapping[str, Blob],
        document: str | None = None,
    ) -> dict[str, dict[str, Blob]]:
        """Files of the jobs for what was read, by the same names; these are those of the document too, where
        none is named. Raises :class:`RefusedError`, 507."""
        sizes = {blob.sha: blob.size for blob in uploads.values()}
        texts = self.storage.put(owner, [io.BytesIO(one.text.encode()) for one in read.values()])
        out = {}
        for (name, one), text in zip(read.items(), texts, strict=True):
            files = {f"problem/{file}": Blob(sha, sizes[sha]) for file, sha in one.files.items()}
            out[name] = {f"problem/{document or name}": text, **files}
        return out

    def new_job(
        self,
        owner: str,
        name: str,
        read: Examined,
        files: Mapping[str, Blob],
        timeout_s: float | None = None,
        memory_mb: float | None = None,
        of: OfElement | None = None,
        after: str = "",
    ) -> NewJob:
        """A job for what was read; its answer depends on that, on what the files are called, for results name
        them, and on the key of the one that it comes ``after``."""
        return NewJob(
            owner=owner,
            name=name,
            digest=read.digest,
            key=_key(" ".join((read.digest, *sorted(read.files), after)).strip()),
            processes=read.processes,
            files=files,
            timeout_s=min(timeout_s or self.limits.job_s, self.limits.job_s),
            memory_mb=min(memory_mb or self.limits.job_memory_mb, self.limits.job_memory_mb),
            issues=read.issues,
            of=of,
        )


def _go_on(pieces: Pieces[Read]) -> list[Read]:
    """Read up to the next wait: what was read where that was all, else nothing."""
    try:
        next(pieces)
    except StopIteration as end:
        return [end.value]
    return []


def _log_in(database: Database, auth: Auth, oidc: Oidc) -> LogIn:
    from planner.service.oidc import LogIn

    return LogIn(database, auth, oidc)


@contextlib.contextmanager
def _said_of(what: str) -> Iterator[None]:
    """Refusals begin with ``what``: of which of several things they are."""
    try:
        yield
    except RefusedError as refused:
        issues = [dataclasses.replace(one, message=what + one.message) for one in refused.issues]
        raise RefusedError(refused.status, issues, refused.headers) from refused


def _readable(read: Examined) -> Examined:
    """The same; raises :class:`RefusedError`, 413 or 422, for what cannot be read."""
    if not read.readable:
        large = all(issue.code == "service.too_large" for issue in read.issues)
        raise RefusedError(413 if large else 422, read.issues)
    return read


def _key(digest: str) -> str:
    """What a problem's answer depends on: the problem, and the versions that plan it."""
    return hashlib.sha256(f"{digest} {_versions()}".encode()).hexdigest()


@functools.cache
def _versions() -> str:
    return json.dumps(all_versions(), sort_keys=True)


def lock_data(data: Path, alone: bool) -> IO[str]:
    """Make the data folder; where the database lies in it, keep other services out until this one ends."""
    try:
        data.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = (data / "service.lock").open("w")
    except OSError as error:
        message = f"data folder {data}: cannot be written ({error.strerror}); give another one"
        raise refusal("service.start", message, field="data") from error
    try:
        if alone:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        message = f"data folder {data}: a service is running on it; stop it, or give another folder"
        raise refusal("service.start", message, field="data") from error
    return lock


def _work_folder(work: Path, alone: bool, host: str) -> Path:
    """A folder of this instance for what is under way; what killed ones of this machine left is removed."""
    work.mkdir(exist_ok=True, mode=0o700)
    for old in work.iterdir():
        name, _, rest = old.name.partition(PID_MARK)
        gone = name == socket.gethostname() and not Path("/proc", rest.split("-")[0]).exists()
        if alone or gone:
            shutil.rmtree(old, ignore_errors=True)
    folder = work / host
    folder.mkdir(mode=0o700)
    return folder
