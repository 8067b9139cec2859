"""Worker processes that plan jobs: a crash, a time-out or too much memory ends that job alone.

Memory is watched from outside. A limit of the address space (``RLIMIT_AS``) would count what Drake
maps and never touches, and a failed allocation ends its C++ without a word, so that nobody could
tell it from a crash. A worker process is known here as its parent sees it: orders in, answers out,
memory, end (:mod:`planner.batch.worker` is the other side).
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

from planner.batch.job import Done, Event, Finished, Found, Job, Place, Progress, Record, State, cancelled
from planner.issues import Issue, TandemError, refusal
from planner.runtime.second_process import module_path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Threads of the linear algebra: one of each, as for ``tandem plan``, unless the environment says more."""
MODULE = "planner.batch.worker"
"""What a worker process runs."""
CHUNK_BYTES = 1 << 16
"""Bytes of a worker's words that are read at once."""
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
"""Bytes of a page of memory."""
LAST_WORDS_BYTES = 4000
"""Bytes at the end of a worker's error output that are looked at when it died."""


class Process:
    """One worker, running ``module``; ``jobs`` counts what it has begun. It does not inherit the variables
    ``unset`` of the environment.

    To be made by a thread that lives as long as the worker shall: the kernel ends it with that thread.
    """

    def __init__(self, module: str = MODULE, unset: Collection[str] = ()) -> None:
        self.jobs = 0
        self._rest = b""
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 (closed by `end`)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            env=_environment(unset),
            process_group=0,  # Ctrl-C is for the parent, which ends its workers
        )
        os.set_blocking(self.fileno(), False)

    @property
    def pid(self) -> int:
        """The process's id."""
        return self._process.pid

    def fileno(self) -> int:
        """The descriptor that is readable when there are answers, or the process has ended."""
        if self._process.stdout is None:
            raise RuntimeError("a worker without a pipe")
        return self._process.stdout.fileno()

    def order(self, order: Mapping[str, Any]) -> None:
        """Tell it what to do; a worker that has just died is found by :meth:`answers`."""
        if self._process.stdin is None:
            raise RuntimeError("a worker without a pipe")
        self.jobs += 1
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.flush()

    def answers(self) -> tuple[list[dict[str, Any]], bool]:
        """What it has said since, and whether it has ended."""
        ended = False
        try:
            while chunk := os.read(self.fileno(), CHUNK_BYTES):
                self._rest += chunk
            ended = True
        except BlockingIOError:
            pass
        *lines, self._rest = self._rest.split(b"\n")
        return [json.loads(line) for line in lines], ended

    def memory_mb(self) -> float:
        """Memory that it holds now [MB]; 0 when it has ended."""
        try:
            return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * PAGE_BYTES / 1e6
        except (OSError, IndexError):
            return 0.0

    def end(self) -> str:
        """End it now, if it has not ended; how it ended, and its last words, as people read them."""
        self._process.kill()
        code = self._process.wait()
        how = f"ended with code {code}" if code >= 0 else f"was ended by {_signal_name(-code)}"
        words = self._last_words()
        self._close()
        return f"{how} ({words})" if words else how

    def _last_words(self) -> str:
        size = self._words.seek(0, os.SEEK_END)
        self._words.seek(max(0, size - LAST_WORDS_BYTES))
        lines = [line.strip() for line in self._words.read().decode("utf-8", "replace").splitlines()]
        said = [line for line in lines if line]
        return said[-1][:200] if said else ""

    def _close(self) -> None:
        for stream in (self._process.stdin, self._process.stdout, self._words):
            if stream is not None:
                with suppress(OSError):  # what is still in the pipe to a dead worker
                    stream.close()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _environment(unset: Collection[str]) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name not in unset}
    return {**dict.fromkeys(THREADS, "1"), **kept, "PYTHONPATH": module_path()}


AHEAD = 2
"""Jobs at hand for each worker."""
WATCH = 0.1
"""Time-outs and memory are looked at so often [s]."""
STARTS = 3
"""So many workers in a row may die while they start."""


@dataclasses.dataclass(frozen=True)
class _Order:
    job: Job
    place: Place
    fresh: bool = False


@dataclasses.dataclass(frozen=True)
class _Running:
    order: _Order
    process: Process
    since: float
    first: bool
    """whether it is the worker's first job, whose memory is the job's own"""


class Workers:
    """``count`` worker processes, each planning one job at a time; a context manager.

    All methods belong to one thread. Time-outs, memory and results are looked after while :meth:`events` is
    asked, so ask it all the time. ``memory_mb`` is the limit of jobs that have none of their own, ``module``
    what the workers run, ``unset`` variables of the environment that they do not inherit. Without ``reports``
    a job that was stopped gets no result folder.
    """

    def __init__(
        self,
        count: int,
        memory_mb: float | None = None,
        module: str = MODULE,
        reports: bool = True,
        unset: Collection[str] = (),
    ) -> None:
        if count < 1:
            raise ValueError(f"workers: got {count}; give at least 1")
        self._count, self._limit_mb = count, memory_mb
        self._module, self._reports, self._unset = module, reports, unset
        self._idle: list[Process] = []
        self._starting: list[Process] = []
        self._running: dict[str, _Running] = {}
        self._queue: collections.deque[_Order] = collections.deque()
        self._events: collections.deque[Event] = collections.deque()
        self._dead_starts = 0
        self._selector = selectors.DefaultSelector()
        # the kernel ends a worker with the thread that made it, so one thread makes them all and stays
        self._maker = ThreadPoolExecutor(1, "tandem-workers")
        self._watched = 0.0

    def __enter__(self) -> Self:
        self._fill()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def busy(self) -> bool:
        """Whether any job is queued or under way, or something of one has not been told."""
        return bool(self._queue or self._running or self._events)

    @property
    def ahead(self) -> int:
        """So many jobs at hand keep all workers busy."""
        return AHEAD * self._count

    @property
    def ready(self) -> int:
        """How many workers have started: they plan or wait for jobs."""
        return len(self._idle) + len(self._running)

    @property
    def pids(self) -> tuple[int, ...]:
        """Ids of the worker processes that there are."""
        return tuple(process.pid for process in self._processes())

    def memory_mb(self) -> float:
        """Memory [MB] that the largest worker holds now."""
        return max((process.memory_mb() for process in self._processes()), default=0.0)

    def start(self, job: Job, folder: Path, record: Record | None = None) -> None:
        """Plan a job, as soon as a worker is free, into the result folder ``folder``, which appears whole or
        not at all; an older result there is replaced then.

        ``record``: what is written of the :class:`Done` just before the folder appears. Raises
        ``ValueError`` for the name of a job that has not ended, and ``TandemError`` (``output.folder``) where
        ``folder`` holds what is no result.
        """
        if job.name in self._running or any(order.job.name == job.name for order in self._queue):
            raise ValueError(f"a job {job.name!r} is under way; wait for its end or name this one otherwise")
        self._queue.append(_Order(job, Place.claim(folder, record)))

    def cancel(self, name: str) -> bool:
        """End a job, queued or under way, without a result; whether there was one of that name."""
        order = next((order for order in self._queue if order.job.name == name), None)
        if order is not None:
            self._queue.remove(order)
            self._report_end(order, self._issue("cancelled", order), 0.0)
            return True
        if name not in self._running:
            return False
        self._end(self._running[name], "cancelled")
        return True

    def events(self, timeout_s: float) -> Iterator[Event]:
        """What happens, as it happens. Ends when nothing more is at hand after something was, or when nothing
        happened for ``timeout_s`` [s].

        Raises ``TandemError`` (``batch.worker``) where workers do not start.
        """
        until = time.monotonic() + timeout_s
        while True:
            self._fill()
            self._dispatch()
            if not self._events:
                self._listen(max(0.0, min(WATCH, until - time.monotonic())))
                self._watch()
            yielded = bool(self._events)
            while self._events:
                yield self._events.popleft()
            if yielded or time.monotonic() >= until:
                return

    def close(self) -> None:
        """End all workers and what they do; results that are there stay."""
        for process in self._processes():
            with contextlib.suppress(KeyError):
                self._selector.unregister(process)
            process.end()
        for running in self._running.values():
            running.order.place.leave()
        self._idle, self._starting, self._running = [], [], {}
        self._queue.clear()
        self._selector.close()
        self._maker.shutdown()

    def _processes(self) -> tuple[Process, ...]:
        return (*self._starting, *self._idle, *(running.process for running in self._running.values()))

    def _fill(self) -> None:
        for _ in range(self._count - len(self._processes())):
            process = self._maker.submit(Process, self._module, self._unset).result()
            self._starting.append(process)
            self._selector.register(process, selectors.EVENT_READ)

    def _dispatch(self) -> None:
        for order in tuple(self._queue):
            fit = [p for p in self._idle if p.jobs == 0 or not order.fresh]
            if order.fresh and not fit and self._idle:
                self._drop(self._idle[0])  # its place is filled by a fresh one
            if fit:
                self._queue.remove(order)
                self._begin(order, fit[0])
            if not self._idle:
                return

    def _begin(self, order: _Order, process: Process) -> None:
        try:
            source, result = order.place.prepare(order.job.files)
        except TandemError as error:
            self._events.append(Finished(order.job.name, Done(order.job.name, "crashed", error.issues)))
            return
        self._idle.remove(process)
        first = process.jobs == 0
        self._running[order.job.name] = _Running(order, process, time.monotonic(), first)
        process.order(
            {
                "name": order.job.name,
                "source": str(source),
                "result": str(result),
                "origins": dict(order.job.origins),
                "reports": order.job.reports,
            }
        )

    def _listen(self, timeout_s: float) -> None:
        for key, _ in self._selector.select(timeout_s):
            process = key.fileobj
            if not isinstance(process, Process):
                raise TypeError(f"expected a worker, got {type(process).__name__}")
            answers, ended = process.answers()
            for answer in answers:
                self._take_answer(process, answer)
            if ended:
                self._lost(process)

    def _take_answer(self, process: Process, answer: dict[str, Any]) -> None:
        if "ready" in answer:
            self._dead_starts = 0
            self._starting.remove(process)
            self._idle.append(process)
            return
        running = next(r for r in self._running.values() if r.process is process)
        name = running.order.job.name
        if "progress" in answer:
            stage, fraction = answer["progress"]
            self._events.append(Progress(name, stage, fraction))
        elif "found" in answer:
            self._events.append(Found(name, tuple(Issue.from_dict(issue) for issue in answer["found"])))
        else:
            done = Done.from_dict(answer["done"])
            del self._running[name]
            self._idle.append(process)
            self._events.append(Finished(name, running.order.place.publish(done)))

    def _lost(self, process: Process) -> None:
        """A worker has ended by itself."""
        running = next((r for r in self._running.values() if r.process is process), None)
        if running is not None:
            self._end(running, "crashed")
            return
        starting = process in self._starting
        how = self._drop(process)
        self._dead_starts += starting
        if self._dead_starts >= STARTS:
            self._dead_starts = 0
            what = f"{STARTS} worker processes in a row did not start: the last one {how}"
            raise refusal("batch.worker", what, hint="see to memory and the installation")

    def _watch(self) -> None:
        if time.monotonic() - self._watched < WATCH:
            return
        self._watched = time.monotonic()
        for running in tuple(self._running.values()):
            limit = self._limit(running.order.job)
            timeout_s = running.order.job.timeout_s
            if timeout_s is not None and self._watched - running.since > timeout_s:
                self._end(running, "timeout")
            elif limit is not None and running.process.memory_mb() > limit:
                if running.first:
                    self._end(running, "memory")
                else:  # what earlier jobs left may be in it: tried again where nothing was before
                    self._stop(running)
                    self._queue.appendleft(dataclasses.replace(running.order, fresh=True))

    def _limit(self, job: Job) -> float | None:
        return job.memory_mb if job.memory_mb is not None else self._limit_mb

    def _end(self, running: _Running, state: State) -> None:
        """End a running job with a failure."""
        seconds = time.monotonic() - running.since
        how = self._stop(running)
        self._report_end(running.order, self._issue(state, running.order, how), seconds, state)

    def _stop(self, running: _Running) -> str:
        del self._running[running.order.job.name]
        self._idle.append(running.process)
        how = self._drop(running.process)
        running.order.place.leave()
        return how

    def _drop(self, process: Process) -> str:
        self._selector.unregister(process)
        for group in (self._idle, self._starting):
            if process in group:
                group.remove(process)
        return process.end()

    def _report_end(self, order: _Order, issue: Issue, seconds: float, state: State = "cancelled") -> None:
        done = Done(order.job.name, state, (issue,), {}, seconds)
        if state != "cancelled" and self._reports:
            done = order.place.publish(done)
        self._events.append(Found(order.job.name, done.issues))
        self._events.append(Finished(order.job.name, done))

    def _issue(self, state: State, order: _Order, how: str = "") -> Issue:
        job = order.job
        if state == "timeout":
            what = f"{job.name}: planning was stopped after {job.timeout_s:g} s, which is all it was allowed"
            hint = "give it more time, or plan a smaller problem"
            return Issue("batch.timeout", what, limit=job.timeout_s, unit="s", hint=hint)
        if state == "memory":
            limit = self._limit(job)
            what = f"{job.name}: planning was stopped at {limit:g} MB of memory, which is all it was allowed"
            hint = "allow more, or plan a smaller problem: fewer targets, coarser meshes"
            return Issue("batch.memory", what, limit=limit, unit="MB", hint=hint)
        if state == "cancelled":
            return cancelled(job.name)
        what = f"{job.name}: the process that planned it {how}; other jobs go on"
        hint = (
            "plan it again; if that fails too, report it; after SIGKILL look whether the machine lacks memory"
        )
        return Issue("batch.crashed", what, hint=hint)
