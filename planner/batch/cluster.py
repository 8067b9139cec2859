"""Jobs on a Dask cluster: the same jobs and results as on worker processes, on any number of machines.

Files are sent with a job and return with its result, as bytes: workers need no shared disk. Dask pickles what
it sends, so a cluster must be one that its users trust; see docs/batch.md.

**A worker of the cluster** (`plan_on_worker`, `cancel_on_worker`) plans in a separate process, as on one
machine. A crash, a timeout or too much memory fails a single job here too, and Dask only notices the end of a
worker if the worker itself has gone. Planning code is not imported into the Dask worker.
"""

import contextlib
import dataclasses
import functools
import importlib.util
import json
import logging
import queue
import tempfile
import threading
import time
import uuid
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Self

from planner.batch.job import (
    BatchJob,
    JobEvent,
    JobFinished,
    JobIssues,
    JobProgress,
    JobRecord,
    JobResult,
    ResultFolder,
    all_versions,
    cancelled_issue,
)
from planner.batch.workers import WORKER_MODULE, BatchWorkers
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error

CONNECT_TIMEOUT_S: Final = 20.0
"""Time [s] within which the scheduler of the cluster must answer."""
WORKERS_TIMEOUT_S: Final = 120.0
"""Maximum time [s] to wait for a first worker."""
MIN_SUBMITTED_JOBS: Final = 4
"""Minimum number of submitted jobs, however few threads the cluster has."""
SUBMITTED_JOBS_PER_THREAD: Final = 2
"""Number of submitted jobs for each thread of the cluster."""
INSTALL_COMMAND: Final = "pip install 'tandem-planner[cluster]'"
"""Command that installs the extra that a cluster needs."""


@dataclasses.dataclass(frozen=True)
class _SubmittedJob:
    """A job on the cluster. ``token`` is the key of its future, unique for each submission.

    ``start_time`` is the time of the submission [s, monotonic clock].
    """

    job: BatchJob
    result_folder: ResultFolder
    future: Any
    token: str
    start_time: float


class ClusterPlanners:
    """Plans jobs on a Dask cluster. A context manager, used like `planner.batch.workers.BatchWorkers`.

    A job whose worker disappears is planned again on another one. It counts as crashed if that happened as
    often as Dask allows (``distributed.scheduler.allowed-failures``).

    Args:
        address: Address of the scheduler (``tcp://`` or ``tls://``), or ``local``.
        count: Number of workers of a local cluster.
        memory_mb: Memory limit of jobs that have none [MB].
        module: Module that the planning processes run.

    Raises:
        TandemError: ``batch.install`` without Dask, ``batch.field`` for an invalid address,
            ``batch.cluster`` if the cluster cannot be reached.
    """

    def __init__(
        self, address: str, count: int = 1, memory_mb: float | None = None, module: str = WORKER_MODULE
    ) -> None:
        if importlib.util.find_spec("distributed") is None:
            message = "a cluster needs Dask, which is not installed"
            raise issue_error("batch.install", message, hint=f"install it: {INSTALL_COMMAND}")
        if address != "local" and not address.startswith(("tcp://", "tls://")):
            message = f"--cluster: got {address!r}; give tcp://HOST:PORT of a scheduler, or local"
            raise issue_error("batch.field", message, field="--cluster")
        self._memory_mb, self._module = memory_mb, module
        self._submitted: dict[str, _SubmittedJob] = {}
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._topic = f"tandem-{uuid.uuid4().hex}"
        self._resources = contextlib.ExitStack()
        self._versions = all_versions()
        try:
            self._client = self._connect(address, count)
        except BaseException:
            self._resources.close()
            raise

    def _connect(self, address: str, count: int) -> Any:
        """Return a client of the cluster, which receives the events of the workers.

        ``address`` is that of a scheduler, or "local" to start a cluster of ``count`` workers on this
        machine.

        Raises:
            TandemError: ``batch.cluster`` if the cluster cannot be reached or has no workers.
        """
        import dask
        from distributed import Client, LocalCluster

        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        config = {
            "distributed.admin.large-graph-warning-threshold": "1GB",
            "distributed.comm.timeouts.connect": f"{CONNECT_TIMEOUT_S:g}s",
        }
        self._resources.enter_context(dask.config.set(config))
        try:
            target: Any = address
            if address == "local":
                target = self._resources.enter_context(
                    LocalCluster(
                        n_workers=count,
                        threads_per_worker=1,
                        processes=True,
                        memory_limit=0,  # memory is monitored in the planning process
                        dashboard_address=None,
                        silence_logs=logging.CRITICAL,
                    )
                )
            client = self._resources.enter_context(
                Client(target, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
            )
            client.wait_for_workers(1, timeout=WORKERS_TIMEOUT_S)
        except (OSError, TimeoutError, ValueError) as error:
            message = f"cluster {address}: cannot be reached, or has no workers ({error})"
            hint = "start `dask scheduler` and `dask worker`, and give the scheduler's address"
            raise issue_error("batch.cluster", message, hint=hint) from error
        client.subscribe_topic(self._topic, lambda event: self._messages.put(("event", event)))
        return client

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def busy(self) -> bool:
        """Whether any job has not ended."""
        return bool(self._submitted)

    @property
    def ahead(self) -> int:
        """Number of submitted jobs that keeps the cluster busy."""
        threads = sum(int(count) for count in self._client.nthreads().values())
        return max(MIN_SUBMITTED_JOBS, SUBMITTED_JOBS_PER_THREAD * threads)

    def start(self, job: BatchJob, folder: Path, record: JobRecord | None = None) -> None:
        """Plan a job into a folder, as `planner.batch.workers.BatchWorkers.start`."""
        if job.name in self._submitted:
            raise ValueError(f"a job {job.name!r} is running; wait for its end or use another name")

        if self._client.status != "running":
            raise TandemError(_connection_lost_issue(job.name))
        result_folder = ResultFolder.claim(folder, record)
        token = f"tandem-{uuid.uuid4().hex}"
        fields = {
            "name": job.name,
            "timeout_s": job.timeout_s,
            "memory_mb": job.memory_mb if job.memory_mb is not None else self._memory_mb,
            "origins": dict(job.origins),
            "reports": job.reports,
            "module": self._module,
        }
        arguments = (token, self._topic, dict(job.files), fields, self._versions)
        future = self._client.submit(plan_on_worker, *arguments, key=token, pure=False)
        self._submitted[job.name] = _SubmittedJob(job, result_folder, future, token, time.monotonic())
        future.add_done_callback(lambda _: self._messages.put(("ended", (job.name, token))))

    def cancel(self, name: str) -> bool:
        """Cancel a job, as `planner.batch.workers.BatchWorkers.cancel`."""
        submitted = self._submitted.pop(name, None)
        if submitted is None:
            return False
        if self._client.status == "running":
            with contextlib.suppress(OSError, TimeoutError):  # if the workers are gone, so is the job
                self._client.run(cancel_on_worker, submitted.token, on_error="ignore")
                submitted.future.cancel(force=True)
        result = JobResult(
            name, "cancelled", (cancelled_issue(name),), {}, time.monotonic() - submitted.start_time
        )
        self._messages.put(("cancelled", JobFinished(name, result)))
        return True

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        """Yield events, as `planner.batch.workers.BatchWorkers.events`.

        Raises:
            TandemError: ``batch.cluster``, ``batch.versions``, if the cluster has become unusable.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                kind, content = self._messages.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                return
            for event in self._events_in(kind, content):
                yield event
                deadline = time.monotonic()  # deliver what is available, without waiting

    def close(self) -> None:
        """Disconnect from the cluster. Running jobs are cancelled."""
        for name in tuple(self._submitted):
            self.cancel(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._resources.close()

    def _events_in(self, kind: str, content: Any) -> Iterator[JobEvent]:
        """Yield the events that a message of the queue stands for.

        Args:
            kind: ``cancelled``, ``event`` (published by a worker) or ``ended`` (a future is done).
            content: A `JobFinished`, a time and a JSON text, or name and token of the job.
        """
        if kind == "cancelled":
            yield content
        elif kind == "event":
            message = json.loads(content[1])
            event: JobEvent
            if "progress" in message:
                event = JobProgress(*message["progress"])
            else:
                name, issues = message["found"]
                event = JobIssues(name, tuple(Issue.from_dict(issue) for issue in issues))
            if event.name in self._submitted:  # it may arrive after the end of its job
                yield event
        else:
            name, token = content
            if name in self._submitted and self._submitted[name].token == token:
                yield self._finish(self._submitted.pop(name))

    def _finish(self, submitted: _SubmittedJob) -> JobFinished:
        """Return the end of a job whose future is done, and publish its result."""
        status = submitted.future.status
        if status == "finished":
            result = self._collect_result(submitted)
        elif status == "error":
            result = self._failure_result(submitted)
        else:  # cancelled or lost by the scheduler, which no longer knows this client
            raise TandemError(_connection_lost_issue(submitted.job.name))
        return JobFinished(submitted.job.name, result)

    def _collect_result(self, submitted: _SubmittedJob) -> JobResult:
        """Write the result folder that a worker has returned, and return the result."""
        with _connection_errors_reported(submitted.job.name):
            answer = submitted.future.result()
        submitted.future.release()
        if "versions" in answer:
            raise TandemError(self._other_versions(answer))
        result = JobResult.from_dict(answer["done"])
        if result.state == "cancelled":
            return result
        try:
            if answer["files"]:
                from planner.batch.results import write_result

                write_result(submitted.result_folder.prepare({})[1], answer["files"])
        except TandemError as error:
            return dataclasses.replace(result, state="crashed", issues=(*result.issues, *error.issues))
        return submitted.result_folder.publish(result)

    def _failure_result(self, submitted: _SubmittedJob) -> JobResult:
        """Publish and return the result "crashed" of a job whose worker disappeared or raised an error."""
        name = submitted.job.name
        with _connection_errors_reported(name):
            error = submitted.future.exception()
        if type(error).__name__ == "KilledWorker":
            text = f"{name}: the workers that planned it disappeared one after another; other jobs continue"
            issue = Issue("batch.crashed", text, hint="check the memory of the workers, and plan it again")
        elif isinstance(error, TandemError):
            issue = error.issues[0]
        else:
            text = f"{name}: {type(error).__name__}: {error}; please report this"
            issue = Issue("internal.error", text)
        return submitted.result_folder.publish(
            JobResult(name, "crashed", (issue,), {}, time.monotonic() - submitted.start_time)
        )

    def _other_versions(self, answer: dict[str, Any]) -> Issue:
        """Return the issue of a worker with other versions, from the answer of `plan_on_worker`."""
        worker_versions = answer["versions"]
        names = sorted({*worker_versions, *self._versions})
        differing = ", ".join(
            f"{name} {worker_versions.get(name, 'none')} instead of {self._versions.get(name, 'none')}"
            for name in names
            if worker_versions.get(name) != self._versions.get(name)
        )
        message = format_message("batch.versions", worker=answer["worker"], differences=differing)
        return Issue("batch.versions", message, hint="install the same versions on all machines")


@contextlib.contextmanager
def _connection_errors_reported(job: str) -> Iterator[None]:
    """Report errors of Dask as an issue if the connection is lost between the end of a job and its result."""
    from distributed.client import FutureCancelledError

    try:
        yield
    except (FutureCancelledError, OSError, TimeoutError) as error:
        raise TandemError(_connection_lost_issue(job)) from error


def _connection_lost_issue(job: str) -> Issue:
    message = f"{job}: the connection to the cluster's scheduler is lost"
    return Issue("batch.cluster", message, hint="start it again, and a batch with --resume")


PROGRESS_INTERVAL_S: Final = 0.5
"""Minimum interval [s] between progress events of a stage."""
NANNY_VARIABLES: Final = ("MALLOC_TRIM_THRESHOLD_",)
"""Variables that Dask's nanny sets for its workers, so that freed memory is returned at once.

A planner requests the same memory again all the time, and would take 1.4 times as long.
"""


class _WorkerState:
    """State of a worker of the cluster. Dask calls functions by name, so it cannot be passed to them.

    Attributes:
        cancelled: Tokens of the jobs that the client has cancelled and that have not ended yet.
    """

    def __init__(self) -> None:
        self.cancelled: set[str] = set()
        self._thread = threading.local()

    def planning_process(self, module: str) -> BatchWorkers:
        """Return the planning process of this thread, which keeps its Drake models from job to job."""
        if getattr(self._thread, "module", None) != module:
            self.close_planning_process()
            self._thread.process = BatchWorkers(1, module=module, reports=False, unset=NANNY_VARIABLES)
            self._thread.module = module
        process: BatchWorkers = self._thread.process
        return process

    def close_planning_process(self) -> None:
        """End the planning process of this thread, if there is one."""
        if hasattr(self._thread, "process"):
            self._thread.process.close()
        self._thread.__dict__.clear()


@functools.cache
def _worker_state() -> _WorkerState:
    return _WorkerState()


def plan_on_worker(
    token: str, topic: str, files: Mapping[str, bytes], fields: Mapping[str, Any], versions: Mapping[str, str]
) -> dict[str, Any]:
    """Plan one job on a worker of the cluster.

    Args:
        token: Identifies the job in this cluster.
        topic: Topic to which events are published.
        files: Files of the job.
        fields: Its other fields, and the ``module`` of its worker.
        versions: Required versions.

    Returns:
        ``done`` (plain data) and ``files`` (the result folder's, by name), or ``versions`` and ``worker`` if
        this worker's versions differ.
    """
    from distributed import get_worker

    own_versions = all_versions()
    if own_versions != dict(versions):
        return {"versions": own_versions, "worker": get_worker().address}
    limits = fields["timeout_s"], fields["memory_mb"]
    job = BatchJob(fields["name"], files, *limits, fields["origins"], fields["reports"])
    with tempfile.TemporaryDirectory(prefix="tandem-") as folder:
        result = Path(folder) / "result"
        finished = _run_job(token, topic, job, result, fields["module"])
        result_files = {
            path.relative_to(result).as_posix(): path.read_bytes() for path in _files_below(result)
        }
        return {"done": finished.done.to_dict(), "files": result_files}


def cancel_on_worker(token: str) -> None:
    """Cancel a job if it is planned on this worker."""
    _worker_state().cancelled.add(token)


def _run_job(token: str, topic: str, job: BatchJob, result: Path, module: str) -> JobFinished:
    """Plan a job in the planning process of this thread, publish its events, and return its end.

    The job stops when its token is cancelled. The planning process runs ``module``.
    """
    state = _worker_state()
    process = state.planning_process(module)
    process.start(job, result)
    last_progress: tuple[str, float] = ("", 0.0)
    try:
        while True:
            for event in process.events(0.2):
                if isinstance(event, JobFinished):
                    return event
                if isinstance(event, JobProgress):
                    if (
                        event.stage == last_progress[0]
                        and time.monotonic() - last_progress[1] < PROGRESS_INTERVAL_S
                    ):
                        continue
                    last_progress = event.stage, time.monotonic()
                _publish(topic, event)
            if token in state.cancelled:
                process.cancel(job.name)
    except BaseException:
        state.close_planning_process()  # its unfinished work belongs to no later job
        raise
    finally:
        state.cancelled.discard(token)


def _publish(topic: str, event: JobEvent) -> None:
    """Publish an event as JSON. Dask accepts only plain data."""
    from distributed import get_worker

    if isinstance(event, JobProgress):
        get_worker().log_event(topic, json.dumps({"progress": dataclasses.astuple(event)}))
    elif isinstance(event, JobIssues):
        issues = [issue.to_dict() for issue in event.issues]
        get_worker().log_event(topic, json.dumps({"found": [event.name, issues]}))


def _files_below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())
