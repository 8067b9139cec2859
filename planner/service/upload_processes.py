"""Processes that read what users upload, with limits of time and memory; a JSON line to and fro for each.

A process that takes too long, too much memory or dies costs the one request that it was at.
"""

from __future__ import annotations

import dataclasses
import json
import os
import queue
import resource
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from planner.batch.workers import THREADS, module_path
from planner.issues import Issue
from planner.service.security import RefusedError

MB: Final = 1 << 20
"""Bytes of a megabyte, as limits of memory are counted (2^20)."""


@dataclasses.dataclass(frozen=True)
class Examined:
    """What is known of an upload. Where it can be read: ``text``, the problem as it stands alone, ``files``
    {name in it: SHA-256}, its ``name``, ``digest``, ``processes`` and ``summary``; else errors alone."""

    issues: tuple[Issue, ...]
    name: str = ""
    digest: str = ""
    processes: tuple[str, ...] = ()
    text: str = ""
    files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    summary: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    shapes: tuple[Mapping[str, Any], ...] = ()

    @property
    def readable(self) -> bool:
        """Whether the problem can be planned, as far as its file says."""
        return bool(self.text)


class Reading:
    """One reading of an upload, which another thread can break off."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self.off = False

    def by(self, process: subprocess.Popen[str] | None) -> None:
        """Name the process that reads, or None when it has read."""
        with self._lock:
            self._process = process
            if self.off and process is not None:
                process.kill()

    def break_off(self) -> None:
        """End the reading, and the process with it."""
        with self._lock:
            self.off = True
            if self._process is not None:
                self._process.kill()


class Examiners:
    """A few processes that serve in turn; start on use, end with :meth:`close`."""

    def __init__(self, count: int, scratch: Path, seconds: float, memory_mb: float, mesh_facets: int) -> None:
        self._scratch, self._seconds, self._memory = scratch, seconds, memory_mb
        self._facets = mesh_facets
        self._idle: queue.Queue[subprocess.Popen[str] | None] = queue.Queue()
        for _ in range(count):
            self._idle.put(None)
        self._all: set[subprocess.Popen[str]] = set()
        self._closed = False
        # the kernel ends a process with the thread that made it, so one thread makes them all and stays
        self._maker = ThreadPoolExecutor(1, "tandem-examiners")

    def examine(
        self,
        problem: Path,
        uploads: Mapping[str, Path],
        reach: bool = False,
        draw: bool = False,
        reading: Reading | None = None,
    ) -> Examined:
        """As :func:`planner.service.upload_reader.examine`, in a process of its own; raises
        :class:`RefusedError`, 503, where the service stops meanwhile, 499 where ``reading`` is broken off."""
        more = {"problem": str(problem), "reach": reach, "draw": draw, "facets": self._facets}
        return self._asked("examine", uploads, more, reading)[0]

    def examine_element(
        self,
        element: Path,
        uploads: Mapping[str, Path],
        fields: Mapping[str, Any],
        reading: Reading | None = None,
    ) -> Examined:
        """As :func:`planner.service.upload_reader.examine_element`, in the same way."""
        more = {"element": str(element), "facets": self._facets, "fields": dict(fields)}
        return self._asked("examine_element", uploads, more, reading)[0]

    def examine_panels(
        self, files: Mapping[str, Path], panels: Sequence[str], reading: Reading | None = None
    ) -> list[Examined]:
        """As :func:`planner.service.upload_reader.examine_panels`, in the same way; one with errors alone
        where reading was stopped."""
        return self._asked("examine_panels", files, {"panels": list(panels)}, reading)

    def _asked(
        self, what: str, files: Mapping[str, Path], more: Mapping[str, Any], reading: Reading | None
    ) -> list[Examined]:
        reading = reading or Reading()
        process = self._idle.get()
        try:
            if self._closed:
                raise _stopping()
            with tempfile.TemporaryDirectory(dir=self._scratch, prefix="examine-") as folder:
                if process is None or process.poll() is not None:
                    process = self._started()
                given = {name: str(path) for name, path in files.items()}
                return self._ask(process, {"what": what, "folder": folder, "files": given, **more}, reading)
        finally:
            self._idle.put(process)

    def close(self) -> None:
        """End the processes, and with them what they are asked."""
        self._closed = True
        self._maker.shutdown(cancel_futures=True)
        for process in list(self._all):
            process.kill()
            process.wait()

    def _started(self) -> subprocess.Popen[str]:
        try:
            process = self._maker.submit(self._start).result()
        except (RuntimeError, CancelledError):  # closed meanwhile
            raise _stopping() from None
        if self._closed:  # it began while the others were ended
            process.kill()
            process.wait()
        return process

    def _start(self) -> subprocess.Popen[str]:
        self._all = {process for process in self._all if process.poll() is None}
        process = subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "planner.service.upload_processes",
                str(os.getpid()),
                str(self._memory),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": module_path()},
            process_group=0,  # Ctrl-C is for the service, which ends them
        )
        self._all.add(process)
        return process

    def _ask(
        self, process: subprocess.Popen[str], asked: Mapping[str, Any], reading: Reading
    ) -> list[Examined]:
        late = threading.Event()

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(self._seconds, stop)
        timer.daemon = True
        timer.start()
        reading.by(process)
        try:
            answer = _exchange(process, json.dumps(asked))
        finally:
            reading.by(None)
            timer.cancel()
        if answer:
            return [_from_json(one) for one in json.loads(answer)]
        process.kill()
        process.wait()
        if self._closed:
            raise _stopping()
        if reading.off:
            raise connection_closed()
        what = (
            f"took more than {self._seconds:g} s"
            if late.is_set()
            else f"needs more than the {self._memory:g} MB that reading may take, or broke off"
        )
        message = f"the problem {what}; make its meshes, tables and step counts smaller"
        return [Examined((Issue("service.check_stopped", message, field="problem"),))]


def _stopping() -> RefusedError:
    what = "the service is stopping; send the request again when it runs"
    return RefusedError(503, Issue("service.stopping", what), {"Retry-After": "10"})


def connection_closed() -> RefusedError:
    """What nobody is there to be told: who asked has gone."""
    return RefusedError(499, Issue("service.request", "the connection was closed; send the request again"))


def _exchange(process: subprocess.Popen[str], line: str) -> str:
    """The answer to one line; nothing where the process is gone."""
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("an examiner has no pipes")
    try:
        process.stdin.write(line + "\n")
        process.stdin.flush()
    except OSError:
        return ""
    answer = process.stdout.readline()
    return answer if answer.endswith("\n") else ""


def _to_json(examined: Examined) -> dict[str, Any]:
    return {**dataclasses.asdict(examined), "issues": [issue.to_dict() for issue in examined.issues]}


def _from_json(data: dict[str, Any]) -> Examined:
    issues = tuple(Issue.from_dict(issue) for issue in data["issues"])
    tuples = {key: tuple(data[key]) for key in ("processes", "shapes")}
    return Examined(**{**data, **tuples, "issues": issues})


def serve() -> None:
    """Answer requests from standard input until it ends."""
    from planner.batch.worker import end_with
    from planner.service.upload_reader import examine, examine_element, examine_panels

    end_with(int(sys.argv[1]))
    limit = int(float(sys.argv[2]) * MB)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        asked = json.loads(line)
        folder, files = Path(asked["folder"]), {name: Path(path) for name, path in asked["files"].items()}
        try:
            if asked["what"] == "examine_panels":
                found = examine_panels(folder, files, asked["panels"])
            elif asked["what"] == "examine_element":
                element = Path(asked["element"])
                found = [examine_element(folder, element, files, asked["facets"], asked["fields"])]
            else:
                problem = Path(asked["problem"])
                found = [examine(folder, problem, files, asked["facets"], asked["reach"], asked["draw"])]
            answer = json.dumps([_to_json(one) for one in found])
        except MemoryError:
            os._exit(1)  # who asked says what it means
        answers.write(answer + "\n")
        answers.flush()


if __name__ == "__main__":
    serve()
