"""A service for tests: in this process with a fake team, or a real service as a separate process."""

from __future__ import annotations

import collections
import hashlib
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from fastapi.testclient import TestClient
from sqlalchemy import select

from planner.batch.job import BatchJob, JobEvent, JobFinished, JobIssues, JobProgress, JobResult, JobState
from planner.issues import Issue, Severity
from planner.service import service as service_module
from planner.service.app import create_app
from planner.service.models import JOBS
from planner.service.security import ServiceLimits
from planner.service.service import Options, Service
from planner.service.upload_processes import ReaderPool, UploadReader
from tests import small_problem

ROOT = Path(__file__).resolve().parents[2]
TABLE = "\n".join([small_problem.COLUMNS, *small_problem.ROWS]).encode()
BASE_URL = "http://127.0.0.1"
NOTE = Issue("problem.field", "a note of the pretended plan", Severity.NOTE)


class FakeTeam:
    """Ends each job at once with a small result, or holds all while ``hold`` is set."""

    report = "<script>1</script>"
    state: JobState = "verified"

    def __init__(self) -> None:
        self.digest: Callable[[str], str] = lambda name: ""  # of the problem of a job, by the job's name here
        self.hold = threading.Event()
        self.started: list[str] = []
        self.cancelled: list[str] = []
        self._events: collections.deque[JobEvent] = collections.deque()
        self._open: dict[str, Path] = {}

    def start(self, job: BatchJob, folder: Path) -> None:
        self.started.append(job.name)
        self._open[job.name] = folder
        self._events.append(JobProgress(job.name, "motion", 0.5))
        self._events.append(JobIssues(job.name, (NOTE,)))

    def cancel(self, name: str) -> bool:
        self.cancelled.append(name)
        if name in self._open:
            del self._open[name]
            self._events.append(JobFinished(name, JobResult(name, "cancelled", (), {}, 0.1)))
        return True

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        if not self.hold.is_set():
            for name, folder in self._open.items():
                (folder / "programs").mkdir(parents=True)
                (folder / "programs" / "main.mod").write_text("MODULE main")
                named = {"main.mod": hashlib.sha256(b"MODULE main").hexdigest()}
                proof = {"ok": True, "problem_digest": self.digest(name), "programs": named}
                (folder / "proof.json").write_text(json.dumps(proof))
                (folder / "report.html").write_text(self.report)
                (folder / "plan.json").write_text("{}")
                self._events.append(
                    JobFinished(name, JobResult(name, self.state, (NOTE,), {"cycle_s": 1.0}, 0.1))
                )
            self._open.clear()
        if not self._events:
            time.sleep(min(timeout_s, 0.02))
        while self._events:
            yield self._events.popleft()

    def close(self) -> None:
        self._open.clear()


class PooledExaminers(ReaderPool):
    """Readers of uploads that take over what the service of an earlier test has left idle: each that starts
    imports the planner, which takes a second. How they start and end is for services as a process."""

    _left: dict[float, list[UploadReader]] = collections.defaultdict(list)  # noqa: RUF012
    _makes = ThreadPoolExecutor(1, "tandem-examiners")

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._starter.shutdown()
        self._starter = self._makes

    def _start_process(self) -> UploadReader:
        while self._left[self._memory]:
            reader = self._left[self._memory].pop()
            if reader.alive:
                self._all.add(reader)
                return reader
        return super()._start_process()

    def close(self) -> None:
        """Return idle readers to the pool, end busy ones."""
        self._closed = True
        idle: set[UploadReader] = set()
        for _ in range(self._idle.qsize()):
            try:
                reader = self._idle.get_nowait()
            except queue.Empty:
                break
            self._idle.put(None) if reader is None else idle.add(reader)
        for reader in self._all - idle:
            reader.kill()
        self._all = set()
        for _ in idle:
            self._idle.put(None)  # tells waiting threads that the service stops
        self._left[self._memory] += idle


service_module.ReaderPool = PooledExaminers  # type: ignore[misc]


class InProcess:
    """A service with a pretended team, and a client that speaks to it."""

    def __init__(self, data: Path, limits: ServiceLimits | None = None, **options: Any) -> None:
        self.team = FakeTeam()
        made = Options(data=data, limits=limits or ServiceLimits(), **options)
        self.service = Service(made, lambda: self.team)
        self.team.digest = self._digest
        self.http = TestClient(create_app(self.service), base_url=BASE_URL, raise_server_exceptions=False)

    def _digest(self, name: str) -> str:
        query = select(JOBS.c.digest).where(JOBS.c.id.startswith(name[-12:]))
        with self.service.database.read() as db:
            return str(db.execute(query).scalar_one())

    def __enter__(self) -> InProcess:
        self.http.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.team.hold.clear()
        self.http.__exit__(None, None, None)

    def post(self, problem: str = small_problem.PROBLEM, path: str = "/v1/jobs", **more: Any) -> Any:
        """Upload the small problem, or another one with the same table."""
        files = [("problem", ("p.yaml", problem)), ("files", ("targets.csv", TABLE))]
        return self.http.post(path, files=files, **more)

    def wait_for_end(self, job: str, timeout_s: float = 120.0, **more: Any) -> dict[str, Any]:
        """The job when it has ended."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            body: dict[str, Any] = self.http.get(f"/v1/jobs/{job}", **more).json()
            if body["state"] not in ("queued", "running"):
                return body
            time.sleep(0.02)
        raise TimeoutError(f"job {job} does not end")


def named_problem(name: str) -> str:
    """The small problem under another name: another problem."""
    return small_problem.PROBLEM.replace("name: small", f"name: {name}")


def issue_codes(answer: Any) -> list[tuple[str, str | None]]:
    """Code and field of every issue in an answer."""
    return [(issue["code"], issue.get("field")) for issue in answer.json()["issues"]]


def wait_until(condition: Callable[[], object], timeout_s: float = 120.0) -> None:
    """Wait until it is so."""
    ending = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > ending:
            raise TimeoutError(f"not so within {timeout_s:g} s")
        time.sleep(0.02)


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Process:
    """``tandem serve`` as a separate process."""

    def __init__(
        self,
        data: Path,
        *options: str,
        port: int = 0,
        module: str = "planner",
        arguments: tuple[str, ...] | None = None,
    ) -> None:
        self.port = port or free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.log = data.parent / f"{data.name}-{self.port}.log"
        usual = ("serve", "--data", str(data), "--port", str(self.port), *options)
        given = usual if arguments is None else (str(self.port), *arguments)
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *given],
                stdout=log,
                stderr=log,
                env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
                cwd=data.parent,
            )

    def wait(self, timeout_s: float = 120.0) -> Process:
        """Until it answers."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            try:
                with urllib.request.urlopen(f"{self.url}/v1/health", timeout=5):
                    return self
            except OSError:
                if self._process.poll() is not None:
                    break
                time.sleep(0.1)
        raise TimeoutError(self.log.read_text())

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        """kill -9."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()

    def stop(self) -> int:
        """As an operator does."""
        self._process.send_signal(signal.SIGTERM)
        try:
            return self._process.wait(timeout=40)
        finally:
            self._process.kill()
            self._process.wait()
