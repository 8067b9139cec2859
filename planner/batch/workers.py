"""Worker processes that plan jobs: a crash, a timeout or too much memory ends only that job.

Memory is monitored from outside. A limit of the address space (``RLIMIT_AS``) would count what Drake maps and
never uses, and a failed allocation ends its C++ code without a message, which looks like a crash. This module
has the parent's view of a worker process: orders, answers, memory, end. :mod:`planner.batch.worker` is the
other side.
"""

import collections
import contextlib
import dataclasses
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from planner.batch.job import (
    BatchJob,
    JobEvent,
    JobFinished,
    JobIssues,
    JobProgress,
    JobRecord,
    JobResult,
    JobState,
    ResultFolder,
    cancelled_issue,
)
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.runtime.second_process import module_path

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that limit the threads of linear algebra libraries.

They are set to one thread, as in ``tandem plan``, unless the environment of the parent sets them.
"""
WORKER_MODULE = "planner.batch.worker"
"""Module that a worker process runs."""
CHUNK_BYTES = 1 << 16
"""Number of bytes of a worker's output that are read at once."""
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
"""Size of a page of memory [bytes]."""
MAX_ERROR_TAIL_BYTES = 4000
"""Number of bytes at the end of a worker's error output that are examined when it died."""


class WorkerProcess:
    """One worker process.

    It must be created by a thread that lives as long as the worker: the kernel ends the worker with that
    thread. ``jobs`` counts the jobs that it has started.

    Args:
        module: Module that it runs.
        unset: Environment variables that it does not inherit.
    """

    def __init__(self, module: str = WORKER_MODULE, unset: Collection[str] = ()) -> None:
        self.jobs = 0
        self._partial_line = b""
        self._error_output = tempfile.TemporaryFile()  # noqa: SIM115 (closed by `end`)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._error_output,
            env=_environment(unset),
            process_group=0,  # Ctrl-C goes to the parent, which ends its workers
        )
        os.set_blocking(self.fileno(), False)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def fileno(self) -> int:
        """Return the descriptor that is readable if there are answers, or the process has ended."""
        if self._process.stdout is None:
            raise RuntimeError("a worker without a pipe")
        return self._process.stdout.fileno()

    def send_order(self, order: Mapping[str, Any]) -> None:
        """Send an order. A worker that has just died is detected by :meth:`read_answers`."""
        if self._process.stdin is None:
            raise RuntimeError("a worker without a pipe")
        self.jobs += 1
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.flush()

    def read_answers(self) -> tuple[list[dict[str, Any]], bool]:
        """Return the answers that have arrived, without waiting, and whether the process has ended."""
        ended = False
        try:
            while chunk := os.read(self.fileno(), CHUNK_BYTES):
                self._partial_line += chunk
            ended = True
        except BlockingIOError:
            pass
        *lines, self._partial_line = self._partial_line.split(b"\n")
        return [json.loads(line) for line in lines], ended

    def memory_mb(self) -> float:
        """Return the present memory [MB], 0 if the process has ended."""
        try:
            return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * PAGE_BYTES / 1e6
        except (OSError, IndexError):
            return 0.0

    def end(self) -> str:
        """End the process if it still runs.

        Returns:
            How it ended, and the last line of its error output, as the predicate of a message.
        """
        self._process.kill()
        code = self._process.wait()
        outcome = f"ended with code {code}" if code >= 0 else f"was ended by {_signal_name(-code)}"
        error_line = self._last_error_line()
        self._close()
        return f"{outcome} ({error_line})" if error_line else outcome

    def _last_error_line(self) -> str:
        """Return the last line that the worker wrote to standard error, cut to 200 characters."""
        size = self._error_output.seek(0, os.SEEK_END)
        self._error_output.seek(max(0, size - MAX_ERROR_TAIL_BYTES))
        lines = [line.strip() for line in self._error_output.read().decode("utf-8", "replace").splitlines()]
        nonempty_lines = [line for line in lines if line]
        return nonempty_lines[-1][:200] if nonempty_lines else ""

    def _close(self) -> None:
        for stream in (self._process.stdin, self._process.stdout, self._error_output):
            if stream is not None:
                with suppress(OSError):  # data left in the pipe to a dead worker
                    stream.close()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _environment(unset: Collection[str]) -> dict[str, str]:
    inherited = {name: value for name, value in os.environ.items() if name not in unset}
    return {**dict.fromkeys(THREAD_VARIABLES, "1"), **inherited, "PYTHONPATH": module_path()}


JOBS_PER_WORKER = 2
"""Number of submitted jobs for each worker."""
WATCH_INTERVAL_S = 0.1
"""Interval of checks of timeouts and memory [s]."""
MAX_FAILED_STARTS = 3
"""Maximum number of consecutive workers that may die while they start."""


@dataclasses.dataclass(frozen=True)
class _QueuedJob:
    """A job that waits for a worker. If it is ``fresh``, the worker must not have had another job."""

    job: BatchJob
    result_folder: ResultFolder
    fresh: bool = False


@dataclasses.dataclass(frozen=True)
class _RunningJob:
    """A job that a worker plans, since ``start_time`` [s, monotonic clock].

    If ``is_first_job`` is set, it is the worker's first job, so that all memory belongs to the job.
    """

    order: _QueuedJob
    process: WorkerProcess
    start_time: float
    is_first_job: bool


class BatchWorkers:
    """Worker processes that plan one job at a time each. A context manager.

    All methods must be called from one thread. Timeouts, memory and results are handled inside
    :meth:`events`, so call it continuously.

    Args:
        count: Number of workers.
        memory_mb: Memory limit of jobs that have none [MB].
        module: Module that the workers run.
        reports: Whether a stopped job gets a result folder.
        unset: Environment variables that the workers do not inherit.
    """

    def __init__(
        self,
        count: int,
        memory_mb: float | None = None,
        module: str = WORKER_MODULE,
        reports: bool = True,
        unset: Collection[str] = (),
    ) -> None:
        if count < 1:
            raise ValueError(f"workers: got {count}; give at least 1")
        self._count, self._limit_mb = count, memory_mb
        self._module, self._reports, self._unset = module, reports, unset
        self._idle: list[WorkerProcess] = []
        self._starting: list[WorkerProcess] = []
        self._running: dict[str, _RunningJob] = {}
        self._queue: collections.deque[_QueuedJob] = collections.deque()
        self._events: collections.deque[JobEvent] = collections.deque()
        self._failed_starts = 0
        self._selector = selectors.DefaultSelector()
        # the kernel ends a worker with the thread that created it, so one permanent thread creates all
        self._spawner = ThreadPoolExecutor(1, "tandem-workers")
        self._last_watch = 0.0

    def __enter__(self) -> Self:
        self._start_missing()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def busy(self) -> bool:
        """Whether any job is queued or running, or any event has not been delivered."""
        return bool(self._queue or self._running or self._events)

    @property
    def ahead(self) -> int:
        """Number of submitted jobs that keeps all workers busy."""
        return JOBS_PER_WORKER * self._count

    @property
    def ready(self) -> int:
        """Number of workers that have started: they plan or wait for jobs."""
        return len(self._idle) + len(self._running)

    @property
    def pids(self) -> tuple[int, ...]:
        """Ids of the worker processes."""
        return tuple(process.pid for process in self._processes())

    def memory_mb(self) -> float:
        """Return the present memory [MB] of the largest worker."""
        return max((process.memory_mb() for process in self._processes()), default=0.0)

    def start(self, job: BatchJob, folder: Path, record: JobRecord | None = None) -> None:
        """Plan a job into a result folder as soon as a worker is free.

        The folder appears completely or not at all. It replaces an older result.

        Args:
            job: The job.
            folder: Result folder.
            record: Record that is written just before the folder appears.

        Raises:
            ValueError: If a job of this name has not ended.
            TandemError: ``output.folder``, if ``folder`` contains something else than a result.
        """
        if job.name in self._running or any(order.job.name == job.name for order in self._queue):
            raise ValueError(f"a job {job.name!r} is running; wait for its end or use another name")
        self._queue.append(_QueuedJob(job, ResultFolder.claim(folder, record)))

    def cancel(self, name: str) -> bool:
        """Cancel a queued or running job, without a result. Returns whether there was one of that name."""
        order = next((order for order in self._queue if order.job.name == name), None)
        if order is not None:
            self._queue.remove(order)
            self._report_end(order, self._end_issue("cancelled", order), 0.0)
            return True
        if name not in self._running:
            return False
        self._end_job(self._running[name], "cancelled")
        return True

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        """Yield events as they happen.

        Ends if no more are available after some were, or if nothing happens for ``timeout_s`` [s].

        Raises:
            TandemError: ``batch.worker``, if workers do not start.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            self._start_missing()
            self._dispatch()
            if not self._events:
                self._listen(max(0.0, min(WATCH_INTERVAL_S, deadline - time.monotonic())))
                self._check_limits()
            yielded = bool(self._events)
            while self._events:
                yield self._events.popleft()
            if yielded or time.monotonic() >= deadline:
                return

    def close(self) -> None:
        """End all workers and their jobs. Existing results stay."""
        for process in self._processes():
            with contextlib.suppress(KeyError):
                self._selector.unregister(process)
            process.end()
        for running in self._running.values():
            running.order.result_folder.release()
        self._idle, self._starting, self._running = [], [], {}
        self._queue.clear()
        self._selector.close()
        self._spawner.shutdown()

    def _processes(self) -> tuple[WorkerProcess, ...]:
        return (*self._starting, *self._idle, *(running.process for running in self._running.values()))

    def _start_missing(self) -> None:
        """Start workers until there are as many as required."""
        for _ in range(self._count - len(self._processes())):
            process = self._spawner.submit(WorkerProcess, self._module, self._unset).result()
            self._starting.append(process)
            self._selector.register(process, selectors.EVENT_READ)

    def _dispatch(self) -> None:
        """Give queued jobs to idle workers, in order."""
        for order in tuple(self._queue):
            suitable = [process for process in self._idle if process.jobs == 0 or not order.fresh]
            if order.fresh and not suitable and self._idle:
                self._remove_process(self._idle[0])  # it is replaced by a fresh one
            if suitable:
                self._queue.remove(order)
                self._start_job(order, suitable[0])
            if not self._idle:
                return

    def _start_job(self, order: _QueuedJob, process: WorkerProcess) -> None:
        """Write the files of a job and send it to an idle worker. The job ends here if that fails."""
        try:
            source, result = order.result_folder.prepare(order.job.files)
        except TandemError as error:
            self._events.append(
                JobFinished(order.job.name, JobResult(order.job.name, "crashed", error.issues))
            )
            return
        self._idle.remove(process)
        is_first_job = process.jobs == 0
        self._running[order.job.name] = _RunningJob(order, process, time.monotonic(), is_first_job)
        process.send_order(
            {
                "name": order.job.name,
                "source": str(source),
                "result": str(result),
                "origins": dict(order.job.origins),
                "reports": order.job.reports,
            }
        )

    def _listen(self, timeout_s: float) -> None:
        """Wait up to ``timeout_s`` for output of the workers, and handle it."""
        for key, _ in self._selector.select(timeout_s):
            process = key.fileobj
            if not isinstance(process, WorkerProcess):
                raise TypeError(f"expected a worker, got {type(process).__name__}")
            answers, ended = process.read_answers()
            for answer in answers:
                self._take_answer(process, answer)
            if ended:
                self._handle_exit(process)

    def _take_answer(self, process: WorkerProcess, answer: dict[str, Any]) -> None:
        """Handle one answer of a worker: it is ready, or reports progress, issues or the end of its job."""
        if "ready" in answer:
            self._failed_starts = 0
            self._starting.remove(process)
            self._idle.append(process)
            return
        job_in_worker = next(
            running_job for running_job in self._running.values() if running_job.process is process
        )
        name = job_in_worker.order.job.name
        if "progress" in answer:
            stage, fraction = answer["progress"]
            self._events.append(JobProgress(name, stage, fraction))
        elif "found" in answer:
            self._events.append(JobIssues(name, tuple(Issue.from_dict(issue) for issue in answer["found"])))
        else:
            result = JobResult.from_dict(answer["done"])
            del self._running[name]
            self._idle.append(process)
            self._events.append(JobFinished(name, job_in_worker.order.result_folder.publish(result)))

    def _handle_exit(self, process: WorkerProcess) -> None:
        """Handle a worker that has ended by itself. Its job, if any, counts as crashed.

        Raises:
            TandemError: ``batch.worker``, if `MAX_FAILED_STARTS` workers in a row ended while they started.
        """
        running_job = next(
            (running_job for running_job in self._running.values() if running_job.process is process), None
        )
        if running_job is not None:
            self._end_job(running_job, "crashed")
            return
        starting = process in self._starting
        exit_reason = self._remove_process(process)
        self._failed_starts += starting
        if self._failed_starts >= MAX_FAILED_STARTS:
            self._failed_starts = 0
            message = format_message(
                "batch.worker", failed_start_count=MAX_FAILED_STARTS, exit_reason=exit_reason
            )
            raise issue_error("batch.worker", message, hint="check memory and the installation")

    def _check_limits(self) -> None:
        """End jobs that exceed their limit of time or memory. This is checked once per `WATCH_INTERVAL_S`.

        A job that exceeds its memory in a worker with earlier jobs is started again in a fresh worker.
        """
        if time.monotonic() - self._last_watch < WATCH_INTERVAL_S:
            return
        self._last_watch = time.monotonic()
        for running in tuple(self._running.values()):
            limit = self._limit(running.order.job)
            timeout_s = running.order.job.timeout_s
            if timeout_s is not None and self._last_watch - running.start_time > timeout_s:
                self._end_job(running, "timeout")
            elif limit is not None and running.process.memory_mb() > limit:
                if running.is_first_job:
                    self._end_job(running, "memory")
                else:  # memory of earlier jobs may be included: try again in a fresh worker
                    self._stop(running)
                    self._queue.appendleft(dataclasses.replace(running.order, fresh=True))

    def _limit(self, job: BatchJob) -> float | None:
        return job.memory_mb if job.memory_mb is not None else self._limit_mb

    def _end_job(self, running: _RunningJob, state: JobState) -> None:
        """End a running job with a failure."""
        seconds = time.monotonic() - running.start_time
        exit_reason = self._stop(running)
        self._report_end(running.order, self._end_issue(state, running.order, exit_reason), seconds, state)

    def _stop(self, running: _RunningJob) -> str:
        """End the worker of a running job and release its result folder. Return how the worker ended."""
        del self._running[running.order.job.name]
        self._idle.append(running.process)
        exit_reason = self._remove_process(running.process)
        running.order.result_folder.release()
        return exit_reason

    def _remove_process(self, process: WorkerProcess) -> str:
        """End an idle or starting worker. Return how it ended."""
        self._selector.unregister(process)
        for processes in (self._idle, self._starting):
            if process in processes:
                processes.remove(process)
        return process.end()

    def _report_end(
        self, order: _QueuedJob, issue: Issue, seconds: float, state: JobState = "cancelled"
    ) -> None:
        """Append the events of a job that this process has ended. Cancelled jobs get no result folder."""
        result = JobResult(order.job.name, state, (issue,), {}, seconds)
        if state != "cancelled" and self._reports:
            result = order.result_folder.publish(result)
        self._events.append(JobIssues(order.job.name, result.issues))
        self._events.append(JobFinished(order.job.name, result))

    def _end_issue(self, state: JobState, order: _QueuedJob, exit_reason: str = "") -> Issue:
        """Return the issue of a job that reached a limit, was cancelled, or crashed.

        ``exit_reason`` says how the worker of a crashed job ended, as part of a sentence.
        """
        job = order.job
        if state == "timeout":
            message = f"{job.name}: planning was stopped at its time limit of {job.timeout_s:g} s"
            hint = "allow more time, or plan a smaller problem"
            return Issue("batch.timeout", message, limit=job.timeout_s, unit="s", hint=hint)
        if state == "memory":
            limit = self._limit(job)
            message = f"{job.name}: planning was stopped at its memory limit of {limit:g} MB"
            hint = "allow more, or plan a smaller problem: fewer targets, coarser meshes"
            return Issue("batch.memory", message, limit=limit, unit="MB", hint=hint)
        if state == "cancelled":
            return cancelled_issue(job.name)
        message = f"{job.name}: the process that planned it {exit_reason}; other jobs continue"
        hint = (
            "plan it again; if that fails too, report it; after SIGKILL check whether memory is insufficient"
        )
        return Issue("batch.crashed", message, hint=hint)
