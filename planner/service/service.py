"""The running service: its parts, its options, and the operations that combine several parts."""

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

from planner.batch.job import PROBLEM_FILE, all_versions
from planner.issue_codes import format_message
from planner.issues import Issue, issue_error
from planner.service.drafts import DraftStore
from planner.service.elements import ElementStore
from planner.service.estimates import Estimates
from planner.service.idempotency import IdempotencyKey
from planner.service.jobs import SERVICE_LIMITS_ONLY, ElementRole, EventBroker, Jobs, NewJob, PlanningLimits
from planner.service.links import Links
from planner.service.models import Database, JobOut, default_url
from planner.service.rate_limits import FAILURES_PER_S, RateLimiter
from planner.service.reading_parts import Pieces, ReadResult
from planner.service.reading_result import PROBLEM_ONLY, ReadingOptions, ReadingResult
from planner.service.releases import Releases
from planner.service.runner import JobQueue, JobRunner, RetentionPolicy, WorkerPool, WorkerSetup
from planner.service.security import LOCAL, LOOPBACK, Auth, RefusedError, ServiceLimits, too_many
from planner.service.storage import Blob, ContentStore, ProblemUpload, StorageQuota
from planner.service.upload_processes import ReaderPool, UploadReading, connection_closed
from planner.service.user_texts import truncated_line
from planner.service.webhooks import Webhooks, WebhookSender

if TYPE_CHECKING:
    from planner.service.oidc import LogIn, OidcSettings

PID_SEPARATOR: Final = ".pid-"
"""Separator before the process id in the name of a service's work folder."""
PANELS_PER_TURN: Final = 20
"""Number of panels of an element that are read before other requests get a turn."""
MAX_CACHED_RESULTS: Final = 256
"""Number of results of reading that are cached."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options with which a service is started.

    Attributes:
        data: Folder of the files, and of the database if no URL is given.
        host: Address to listen on.
        port: Port to listen on.
        database: URL of the database, or None for SQLite in the data folder.
        workers: Number of worker processes that plan jobs.
        examiners: Number of processes that read uploads.
        cluster: Address of a cluster, or None to plan on this machine.
        require_token: Require tokens even on loopback.
        trusted_proxies: Addresses or networks of proxies whose forwarding headers are trusted.
        lease_s: Duration of leases of jobs [s].
        oidc: Log-in through a provider, or None.
        webhook_hosts: Hosts that webhooks may notify.
        limits: Limits.
    """

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
    oidc: OidcSettings | None = None
    webhook_hosts: tuple[str, ...] = ()
    limits: ServiceLimits = dataclasses.field(default_factory=ServiceLimits)

    @property
    def tokens_required(self) -> bool:
        """Whether tokens are required: by an option, for a log-in provider, or beyond loopback."""
        return self.require_token or self.oidc is not None or self.host not in LOOPBACK

    @property
    def url(self) -> str:
        """URL of the database."""
        return self.database or default_url(self.data)


@dataclasses.dataclass(frozen=True)
class FieldSweep:
    """Values that a field of a problem takes, one for each job.

    Attributes:
        field: Path of the field.
        values: Values.
        tag: Tag of the jobs.
    """

    field: str
    values: Sequence[Any]
    tag: str


class Service:
    """One instance of the service. The server calls :meth:`start` and :meth:`close`."""

    def __init__(self, options: Options, make_team: Callable[[], WorkerPool]) -> None:
        """Open the data folder and the database.

        Args:
            options: Options.
            make_team: Factory of the workers that plan jobs.

        Raises:
            TandemError: The folder or the database is unavailable, or there are no tokens.
        """
        self.options, self.limits = options, options.limits
        self._lock = lock_data(options.data, options.database is None)
        self.database = Database(options.url)
        self.auth = Auth(self.database)
        if options.tokens_required and options.oidc is None and not self.auth.has_valid_token():
            self.database.close()
            message = f"host {options.host}: tokens are required, and there is none yet"
            hint = f"Create one: tandem token add NAME --data {options.data}"
            raise issue_error("service.start", message, field="host", hint=hint)
        self.links = Links(self.database)
        self.log_in = None if options.oidc is None else _create_log_in(self.database, self.auth, options.oidc)
        self.rates, self.failures = RateLimiter(options.limits.requests_per_s), RateLimiter(FAILURES_PER_S)
        self.files = ContentStore(options.data / "files")
        self.host = f"{socket.gethostname()}{PID_SEPARATOR}{os.getpid()}-{secrets.token_hex(4)}"
        self.scratch = _work_folder(options.data / "work", options.database is None, self.host)
        self.jobs = Jobs(self.database, self.limits)
        self.storage = StorageQuota(self.files, self.jobs.owned_sizes, self.limits)
        self.hub = EventBroker(self.database, self.limits, self.auth)
        limits = self.limits
        self._examiners = ReaderPool(
            options.examiners, self.scratch, limits.check_s, limits.check_memory_mb, limits.mesh_facets
        )
        self.webhooks = Webhooks(self.database, options.webhook_hosts)
        self._sender = WebhookSender(self.webhooks)
        self.runner = JobRunner(
            JobQueue(self.database, self.host, options.lease_s),
            self.files,
            WorkerSetup(make_team, options.workers, self.scratch),
            RetentionPolicy(
                keep_s=None if limits.keep_days is None else limits.keep_days * 86400.0,
                audit_s=None if limits.audit_days is None else limits.audit_days * 86400.0,
                used_shas=self.jobs.used_shas,
            ),
            alone=options.database is None,
            on_newer=self._sender.stop,
        )
        self.elements = ElementStore(self)
        self.estimates = Estimates(self.database)
        self.drafts = DraftStore(self.database, self.limits)
        self.releases = Releases(self.database, self.files)
        self._turns: dict[str, anyio.Semaphore] = {}
        self._readers = anyio.Semaphore(options.examiners)  # first come, first served
        self._long_readings: dict[str, anyio.Lock] = {}
        self._waiting: Counter[str] = Counter()
        self._results: OrderedDict[str, ReadingResult] = OrderedDict()
        self._read_lock = threading.Lock()

    async def create_idempotent(
        self,
        request: Request,
        owner: str,
        idempotency_key: IdempotencyKey | None,
        make: Callable[[UploadReading], Pieces[Sequence[JobOut]]],
    ) -> Sequence[JobOut]:
        """Return the jobs that an earlier request with the key created, else create them.

        Args:
            request: Request.
            owner: Token.
            idempotency_key: Idempotency key, or None.
            make: Function that creates the jobs, as a reading in parts.

        Raises:
            RefusedError: As :meth:`run_in_turns`, and 422 for a key of another request.
        """
        earlier_jobs = await anyio.to_thread.run_sync(self.jobs.created_before, idempotency_key)
        return earlier_jobs or await self.run_in_turns(request, owner, make)

    async def run_in_turn(
        self, request: Request, owner: str, read: Callable[[UploadReading], ReadResult]
    ) -> ReadResult:
        """Run a reading in one part, in the owner's turn.

        Args:
            request: Request.
            owner: Token.
            read: Function that reads in one part.

        Raises:
            RefusedError: As :meth:`run_in_turns`.
        """

        def in_one_piece(reading: UploadReading) -> Pieces[ReadResult]:
            yield
            return read(reading)

        return await self.run_in_turns(request, owner, in_one_piece)

    async def run_in_turns(
        self, request: Request, owner: str, read: Callable[[UploadReading], Pieces[ReadResult]]
    ) -> ReadResult:
        """Run a reading in parts, each in a thread and in the owner's turn.

        One token never occupies all readers: others wait for one part of a long reading, not for all of it.
        The number of waiting requests per token is limited. Closing the connection ends the reading. The
        body of the request must have been received.

        Args:
            request: Request.
            owner: Token.
            read: Function that reads in parts.

        Returns:
            Result of the reading.

        Raises:
            RefusedError: 429, too many requests wait. 499, the client has disconnected.
            Exception: Any exception of ``read``.
        """
        reading = UploadReading()
        results: list[ReadResult] = []
        errors: list[Exception] = []
        async with anyio.create_task_group() as tasks:

            async def wait_and_read() -> None:
                try:
                    async with self._waiting_slot(owner):
                        results.extend(await self._read_in_turns(owner, read(reading)))
                except Exception as error:  # a task group would wrap it in a group
                    errors.append(error)
                tasks.cancel_scope.cancel()

            tasks.start_soon(wait_and_read)
            while (await request.receive())["type"] != "http.disconnect":
                pass
            # Only a disconnected client gets here: after an end of the reading, the scope is cancelled above.
            reading.cancel()  # the thread cannot be cancelled, it ends with its reader process
            tasks.cancel_scope.cancel()
        if errors:
            raise errors[0]
        if not results:
            raise connection_closed()
        return results[0]

    async def _read_in_turns(self, owner: str, pieces: Pieces[ReadResult]) -> list[ReadResult]:
        """Run the parts of a reading.

        Of several long readings of one owner only one proceeds, because each holds its results in memory
        until its end.

        Returns:
            List with the result of the reading.
        """
        # A token leaves one reader to others, if there are several.
        readers = self.options.examiners if owner == LOCAL else max(1, self.options.examiners - 1)
        owner_turns = self._turns.setdefault(owner, anyio.Semaphore(readers))

        async def run_piece() -> list[ReadResult]:
            async with owner_turns, self._readers:
                return await anyio.to_thread.run_sync(_advance, pieces)

        if result := _advance(pieces) or await run_piece():
            return result
        async with self._long_readings.setdefault(owner, anyio.Lock()):
            while not (result := await run_piece()):
                pass
        return result

    @contextlib.asynccontextmanager
    async def _waiting_slot(self, owner: str) -> AsyncIterator[None]:
        """Count a queued or running reading of an owner."""
        max_readings = self.limits.readings
        if owner != LOCAL and self._waiting[owner] >= max_readings:
            message = (
                f"too many uploads of this token wait to be read (allowed {max_readings}). Try again later."
            )
            raise too_many(message, 5, max_readings)
        self._waiting[owner] += 1
        try:
            yield
        finally:
            self._waiting[owner] -= 1

    def start(self) -> None:
        """Start planning and sending of webhooks."""
        self.runner.start()
        self._sender.start()

    def closed_refusal(self) -> RefusedError | None:
        """Return the refusal if no requests are accepted at all, else None."""
        if self.database.newer_version is None:
            return None
        remedy = "Update tandem-planner on this host, or use another host of the service."
        message = f"the database {self.database.newer_version}. {remedy}"
        return RefusedError(503, Issue("service.database", message), {"Retry-After": "60"})

    def unready_issues(self) -> list[Issue]:
        """Return the reasons why jobs are not accepted or not planned now."""
        issues = []
        try:
            self.database.ping()
        except SQLAlchemyError:
            issues.append(Issue("service.database", "the database is unavailable"))
        try:
            self.storage.check_space()
        except RefusedError as refused:
            issues += refused.issues
        if closed := self.closed_refusal():
            issues = list(closed.issues)
        elif not issues and not self.runner.working:
            issues.append(Issue("service.not_planning", format_message("service.not_planning")))
        return issues

    def stop_reading(self) -> None:
        """Stop reading uploads. Requests that wait for it are refused."""
        self._examiners.close()

    def close(self) -> None:
        """Stop the service. Running jobs are queued until the next start."""
        self.hub.close()
        self.runner.stop()
        self._sender.stop()
        self._examiners.close()
        self.database.close()
        shutil.rmtree(self.scratch, ignore_errors=True)
        self._lock.close()

    def examine(
        self,
        upload: ProblemUpload,
        options: ReadingOptions = PROBLEM_ONLY,
        reading: UploadReading | None = None,
    ) -> ReadingResult:
        """Read an upload. Results are cached, except drawings.

        Args:
            upload: Problem and its files.
            options: What is computed, and which fields are replaced.
            reading: Reading, which another thread can cancel.

        Raises:
            RefusedError: 413, 422, or 499 if the reading is cancelled.
        """
        inputs = [
            upload.problem.sha,
            options.reach,
            options.draw,
            options.targets,
            sorted((options.cell or {}).items()),
            sorted((options.fields or {}).items()),
            sorted((name, blob.sha) for name, blob in upload.files.items()),
        ]
        key = hashlib.sha256(json.dumps(inputs).encode()).hexdigest()
        with self._read_lock:
            result = self._results.get(key)
        if result is None:
            uploads = {name: self.files.path(blob.sha) for name, blob in upload.files.items()}
            problem = self.files.path(upload.problem.sha)
            result = _check_readable(self._examiners.examine(problem, uploads, options, reading))
            if options.draw or options.cell:  # drawings are large and requested once
                return result
            with self._read_lock:
                self._results[key] = result
                while len(self._results) > MAX_CACHED_RESULTS:
                    self._results.popitem(last=False)
        return result

    def create(
        self,
        owner: str,
        upload: ProblemUpload,
        limits: PlanningLimits,
        reading: UploadReading | None = None,
        idempotency_key: IdempotencyKey | None = None,
    ) -> Pieces[list[JobOut]]:
        """Create the job for an upload.

        Args:
            owner: Token.
            upload: Problem and its files.
            limits: Requested limits.
            reading: Reading, which another thread can cancel.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: 413, 422, 429, 499 or 507.
        """
        yield
        result = self.examine(upload, reading=reading)
        files = self.store_job_files(owner, {PROBLEM_FILE: result}, upload.files)[PROBLEM_FILE]
        new_job = self.new_job(owner, result.name, result, files, limits)
        return [self.jobs.create(new_job, idempotency_key)]

    def sweep(
        self,
        owner: str,
        upload: ProblemUpload,
        field_sweep: FieldSweep,
        reading: UploadReading,
        idempotency_key: IdempotencyKey | None = None,
    ) -> Pieces[list[JobOut]]:
        """Create a job for each value of a field, all or none.

        Args:
            owner: Token.
            upload: Problem and its files.
            field_sweep: Field, and its values.
            reading: Reading, which another thread can cancel.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: As :meth:`create`.
        """
        field, values = field_sweep.field, field_sweep.values
        results: dict[str, ReadingResult] = {}
        for number, value in enumerate(values):
            yield
            prefix = f"{field} = {json.dumps(value, ensure_ascii=False)[:80]}: "
            with _prefixed_refusals(prefix):
                results[str(number)] = self.examine(upload, ReadingOptions(fields={field: value}), reading)
        files = self.store_job_files(owner, results, upload.files, PROBLEM_FILE)
        jobs = []
        for (name, result), value in zip(results.items(), values, strict=True):
            value_text = value if isinstance(value, str) else json.dumps(value)
            title = truncated_line(f"{result.name}: {field} = {value_text}")
            new_job = self.new_job(owner, result.name, result, files[name])
            jobs.append(dataclasses.replace(new_job, title=title, tags=(field_sweep.tag,)))
        return self.jobs.create_all(jobs, idempotency_key)

    def batch(
        self,
        owner: str,
        uploads: Mapping[str, ProblemUpload],
        tag: str,
        reading: UploadReading,
        idempotency_key: IdempotencyKey | None = None,
    ) -> Pieces[list[JobOut]]:
        """Create a job for each of several problems with common files, all or none.

        Args:
            owner: Token.
            uploads: Problems by file name.
            tag: Tag of the jobs.
            reading: Reading, which another thread can cancel.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: As :meth:`create`, with the issues of all problems that cannot be read.
        """
        results: dict[str, ReadingResult] = {}
        refused: list[tuple[int, Issue]] = []
        for number, (name, upload) in enumerate(uploads.items()):
            yield
            try:
                with _prefixed_refusals(f"{name[:80]}: "):
                    results[name] = self.examine(upload, reading=reading)
            except RefusedError as error:
                if error.status != 422:
                    raise
                refused += [(number, issue) for issue in error.issues]
        if refused:
            raise RefusedError(422, [issue for _, issue in refused], of=[number for number, _ in refused])
        files = {name: blob for upload in uploads.values() for name, blob in upload.files.items()}
        stored = self.store_job_files(owner, results, files, PROBLEM_FILE)
        name_counts = Counter(result.name for result in results.values())
        jobs = []
        for name, result in results.items():  # jobs with equal names get their file name as a title
            title = truncated_line(f"{result.name}: {name}") if name_counts[result.name] > 1 else ""
            new_job = self.new_job(owner, result.name, result, stored[name])
            jobs.append(dataclasses.replace(new_job, title=title, tags=(tag,)))
        return self.jobs.create_all(jobs, idempotency_key)

    def examine_element(
        self, sha: str, uploads: Mapping[str, Blob], fields: Mapping[str, Any], reading: UploadReading
    ) -> ReadingResult:
        """Read an uploaded element.

        Args:
            sha: SHA-256 of the element file.
            uploads: Files by name.
            fields: New values by field path.
            reading: Reading, which another thread can cancel.

        Raises:
            RefusedError: As :meth:`examine`.
        """
        paths = {name: self.files.path(blob.sha) for name, blob in uploads.items()}
        return _check_readable(self._examiners.examine_element(self.files.path(sha), paths, fields, reading))

    def examine_panels(
        self, files: Mapping[str, Blob], panels: Sequence[str], reading: UploadReading
    ) -> Pieces[dict[str, ReadingResult]]:
        """Read panels of a divided element.

        Args:
            files: Files of the element by name.
            panels: Ids of panels.
            reading: Reading, which another thread can cancel.

        Returns:
            Results by panel.

        Raises:
            RefusedError: As :meth:`examine`.
        """
        paths = {name: self.files.path(blob.sha) for name, blob in files.items()}
        results: dict[str, ReadingResult] = {}
        for start in range(0, len(panels), PANELS_PER_TURN):
            yield
            batch = panels[start : start + PANELS_PER_TURN]
            batch_results = self._examiners.examine_panels(paths, batch, reading)
            results |= dict(zip(batch, map(_check_readable, batch_results), strict=True))
        return results

    def store_job_files(
        self,
        owner: str,
        results: Mapping[str, ReadingResult],
        uploads: Mapping[str, Blob],
        document: str | None = None,
    ) -> dict[str, dict[str, Blob]]:
        """Store the files of the jobs for results of reading.

        Args:
            owner: Token.
            results: Results of reading by name.
            uploads: Stored uploads by name.
            document: Name of the problem file of each job, or None for the name of the result.

        Returns:
            For each name the files of its job.

        Raises:
            RefusedError: 507.
        """
        sizes = {blob.sha: blob.size for blob in uploads.values()}
        texts = self.storage.put(owner, [io.BytesIO(result.text.encode()) for result in results.values()])
        files_by_name = {}
        for (name, result), text in zip(results.items(), texts, strict=True):
            files = {f"problem/{file}": Blob(sha, sizes[sha]) for file, sha in result.files.items()}
            files_by_name[name] = {f"problem/{document or name}": text, **files}
        return files_by_name

    def new_job(
        self,
        owner: str,
        name: str,
        result: ReadingResult,
        files: Mapping[str, Blob],
        limits: PlanningLimits = SERVICE_LIMITS_ONLY,
        of: ElementRole | None = None,
    ) -> NewJob:
        """Describe the job for a result of reading.

        The answer of a job depends on the problem, on the names of its files, because results contain them,
        and on the key of the job whose plan is the reference plan. Its key combines these.

        Args:
            owner: Token.
            name: Name of the job.
            result: Result of reading.
            files: Stored files by name.
            limits: Requested limits.
            of: Role in an element, or None.
        """
        reference_key = "" if of is None else of.reference_key
        return NewJob(
            owner=owner,
            name=name,
            digest=result.digest,
            key=_answer_key(" ".join((result.digest, *sorted(result.files), reference_key)).strip()),
            processes=result.processes,
            files=files,
            timeout_s=min(limits.timeout_s or self.limits.job_s, self.limits.job_s),
            memory_mb=min(limits.memory_mb or self.limits.job_memory_mb, self.limits.job_memory_mb),
            issues=result.issues,
            of=of,
        )


def _advance(pieces: Pieces[ReadResult]) -> list[ReadResult]:
    """Run a reading to its next wait. Return its result in a list, or an empty list if it continues."""
    try:
        next(pieces)
    except StopIteration as end:
        return [end.value]
    return []


def _create_log_in(database: Database, auth: Auth, oidc: OidcSettings) -> LogIn:
    from planner.service.oidc import LogIn

    return LogIn(database, auth, oidc)


@contextlib.contextmanager
def _prefixed_refusals(prefix: str) -> Iterator[None]:
    """Prefix the messages of refusals, to name the item that they concern."""
    try:
        yield
    except RefusedError as refused:
        issues = [dataclasses.replace(issue, message=prefix + issue.message) for issue in refused.issues]
        raise RefusedError(refused.status, issues, refused.headers) from refused


def _check_readable(result: ReadingResult) -> ReadingResult:
    """Return a result of reading unchanged if the upload could be read.

    Raises:
        RefusedError: 413 or 422.
    """
    if not result.readable:
        is_too_large = all(issue.code == "service.too_large" for issue in result.issues)
        raise RefusedError(413 if is_too_large else 422, result.issues)
    return result


def _answer_key(digest: str) -> str:
    """Return the hash of all that an answer depends on: problem and program versions."""
    return hashlib.sha256(f"{digest} {_versions()}".encode()).hexdigest()


@functools.cache
def _versions() -> str:
    return json.dumps(all_versions(), sort_keys=True)


def lock_data(data: Path, exclusive: bool) -> IO[str]:
    """Create the data folder. Lock it if the database is in it.

    Args:
        data: Data folder.
        exclusive: Lock out other services until the returned file is closed.

    Raises:
        TandemError: The folder is not writable or in use.
    """
    try:
        data.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = (data / "service.lock").open("w")
    except OSError as error:
        message = f"data folder {data}: not writable ({error.strerror}). Give another folder."
        raise issue_error("service.start", message, field="data") from error
    try:
        if exclusive:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        message = f"data folder {data}: in use by a running service. Stop it, or give another folder."
        raise issue_error("service.start", message, field="data") from error
    return lock


def _work_folder(work: Path, exclusive: bool, host: str) -> Path:
    """Create the work folder of this instance, and remove those of failed instances of this machine.

    Args:
        work: Folder of the work folders.
        exclusive: No other instance uses the data folder, so that all other folders are removed.
        host: Name of this instance.
    """
    work.mkdir(exist_ok=True, mode=0o700)
    for folder_of_instance in work.iterdir():
        name, _, process = folder_of_instance.name.partition(PID_SEPARATOR)
        is_orphaned = name == socket.gethostname() and not Path("/proc", process.split("-")[0]).exists()
        if exclusive or is_orphaned:
            shutil.rmtree(folder_of_instance, ignore_errors=True)
    folder = work / host
    folder.mkdir(mode=0o700)
    return folder
