"""Processes that read uploads, with limits of time and memory. Requests and answers are lines of JSON.

A process that takes too long, needs too much memory or dies costs only the request that it was reading.
Readers are forked from a parent that has imported what reading needs, and Drake when it is needed.
Cancelling a reading, as each edit of a problem cancels the check of the previous version, therefore costs
only a fork.
"""

import dataclasses
import gc
import json
import os
import queue
import resource
import select
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, TextIO

from planner.batch.workers import THREAD_VARIABLES
from planner.issue_codes import format_message
from planner.issues import Issue
from planner.runtime.second_process import module_path
from planner.service.reading_result import PROBLEM_ONLY, ReadingOptions, ReadingResult
from planner.service.security import RefusedError

MB: Final = 1 << 20
"""Bytes of a megabyte in memory limits (2^20)."""
CACHE_FOLDER: Final = "targets"
"""Name of the folder of cached targets, next to the folders of readings."""


class UploadReader:
    """A process that reads one upload at a time, and its parent, which forks the next one.

    Requests are numbered, and an answer carries the number of its request. A new reader states how many
    readers were killed before it. A reader may end by itself just before it is killed, and the signal then
    kills the next one. The number shows which reader is the last.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._is_ready = False  # a reader has started, and no line of an earlier reading is left
        self._is_asked = self._is_cancelled = self._is_ending = False
        self._number = self._killed_count = 0  # number of the reading; number of readers that were killed
        self._turn = threading.Lock()  # between the request and its cancellation

    @property
    def alive(self) -> bool:
        """Whether the process accepts requests."""
        return self._process.poll() is None

    def cancel(self) -> None:
        """Cancel the present request by killing the reader. Its parent forks another one.

        A request that was not sent yet will not be sent. In this case the reader is not killed, because the
        lines that it has already written would be taken for those of the next reader.
        """
        with self._turn:
            self._is_cancelled = True
            if self._is_asked and not self._is_ending:
                self._kill_reader()

    def kill(self) -> None:
        """Kill the reader and its parent."""
        self._process.kill()
        self._process.wait()

    def ask(self, what: str) -> list[Any] | None:
        """Send a request and wait for its answer.

        Args:
            what: Request as one line of JSON.

        Returns:
            Answer, or None if the reader has died or the request was cancelled.
        """
        if not self._is_ready and not self._wait_for_reader():
            return None
        if self._process.stdin is None:
            raise RuntimeError("a reader has no pipes")
        with self._turn:
            if self._is_cancelled:
                return None
            self._is_asked = True
            self._number += 1
            try:
                self._process.stdin.write(f"{self._number} {what}\n")
                self._process.stdin.flush()
            except OSError:
                self._is_ready = False
                return None
        number, _, answer = self._read_line().partition(" ")
        answer_data = _parse_answer(answer) if number == str(self._number) else None
        with self._turn:
            self._is_asked = False
        self._is_ready = answer_data is not None
        return answer_data

    def settle(self) -> None:
        """Wait for the reader that replaces a killed one. Nobody calls :meth:`cancel` any more.

        If there was no answer, the present reader is killed too, so that neither its request nor its output
        is left. If no reader starts, the parent is killed.
        """
        if self._is_ending or not self._is_ready:
            if not self._is_ending:
                self._kill_reader()
            self._is_ready = False
            if not self._wait_for_reader():
                self.kill()
        self._is_asked = self._is_cancelled = self._is_ending = False

    def _kill_reader(self) -> None:
        """Make the parent kill the present reader and fork another one."""
        self._is_ending = True
        self._killed_count += 1
        self._process.send_signal(signal.SIGUSR2)

    def _wait_for_reader(self) -> bool:
        """Wait for the next reader. Return whether there is one."""
        while not self._is_ready:
            line = self._read_line()
            if not line:
                return False
            self._is_ready = line == f"{START_MARK} {self._killed_count}\n"
        return True

    def _read_line(self) -> str:
        if self._process.stdout is None:
            raise RuntimeError("a reader has no pipes")
        return self._process.stdout.readline()


START_MARK: Final = "reading"
"""First word of the line that a new reader writes, followed by the number of readers killed before it."""


def _parse_answer(line: str) -> list[Any] | None:
    """Parse a complete answer. None if it is incomplete."""
    if not line.endswith("\n"):
        return None
    try:
        answer = json.loads(line)
    except ValueError:
        return None
    return answer if isinstance(answer, list) else None


class UploadReading:
    """A reading of an upload, which another thread can cancel."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reader: UploadReader | None = None
        self.cancelled = False

    def set_reader(self, reader: UploadReader | None) -> bool:
        """Set the reader that :meth:`cancel` kills, or None when it is done.

        Returns:
            False if the reading was cancelled before. Then nothing is set.
        """
        with self._lock:
            self._reader = None if self.cancelled else reader
            return not self.cancelled

    def cancel(self) -> None:
        """Cancel the reading and kill its reader."""
        with self._lock:
            self.cancelled = True
            if self._reader is not None:
                self._reader.cancel()


class ReaderPool:
    """Pool of readers. They start on demand, and end with :meth:`close`.

    Args:
        count: Number of readers.
        scratch: Folder for work in progress.
        seconds: Time limit of a reading [s].
        memory_mb: Memory limit of a reading [MB].
        mesh_facets: Maximum number of facets of one mesh.
    """

    def __init__(self, count: int, scratch: Path, seconds: float, memory_mb: float, mesh_facets: int) -> None:
        self._scratch, self._seconds, self._memory = scratch, seconds, memory_mb
        self._facets = mesh_facets
        self._idle: queue.LifoQueue[UploadReader | None] = queue.LifoQueue()  # warm readers are used first
        for _ in range(count):
            self._idle.put(None)
        self._all: set[UploadReader] = set()
        self._cache_folder = scratch / CACHE_FOLDER
        self._closed = False
        # PR_SET_PDEATHSIG kills a child when the thread that forked it ends, so one lasting thread forks all
        self._starter = ThreadPoolExecutor(1, "tandem-examiners")

    def examine(
        self,
        problem: Path,
        uploads: Mapping[str, Path],
        options: ReadingOptions = PROBLEM_ONLY,
        reading: UploadReading | None = None,
    ) -> ReadingResult:
        """Run :func:`planner.service.upload_reader.examine` in a reader process.

        Args:
            problem: Problem file.
            uploads: Files by the names that the user gave.
            options: What is computed, and which fields are replaced.
            reading: Reading, which another thread can cancel.

        Raises:
            RefusedError: 503 if the service stops, 499 if the reading is cancelled.
        """
        arguments: dict[str, Any] = {"problem": str(problem), "facets": self._facets}
        arguments |= {"reach": options.reach, "draw": options.draw, "targets": options.targets}
        arguments |= {"kept": str(self._cache_folder), "cell": options.cell, "fields": options.fields}
        return self._run("examine", uploads, arguments, reading)[0]

    def examine_element(
        self,
        element: Path,
        uploads: Mapping[str, Path],
        fields: Mapping[str, Any],
        reading: UploadReading | None = None,
    ) -> ReadingResult:
        """Run :func:`planner.service.upload_reader.examine_element` in a reader process.

        Args:
            element: Element file.
            uploads: Files by the names that the user gave.
            fields: New values by field path.
            reading: Reading, which another thread can cancel.

        Raises:
            RefusedError: 503 if the service stops, 499 if the reading is cancelled.
        """
        arguments = {"element": str(element), "facets": self._facets, "fields": dict(fields)}
        return self._run("examine_element", uploads, arguments, reading)[0]

    def examine_panels(
        self, files: Mapping[str, Path], panels: Sequence[str], reading: UploadReading | None = None
    ) -> list[ReadingResult]:
        """Run :func:`planner.service.upload_reader.examine_panels` in a reader process.

        Args:
            files: Files of the element by name.
            panels: Ids of panels.
            reading: Reading, which another thread can cancel.

        Returns:
            One result for each panel, or a single one with errors if a limit was reached.

        Raises:
            RefusedError: 503 if the service stops, 499 if the reading is cancelled.
        """
        return self._run("examine_panels", files, {"panels": list(panels)}, reading)

    def _run(
        self,
        action: str,
        files: Mapping[str, Path],
        arguments: Mapping[str, Any],
        reading: UploadReading | None,
    ) -> list[ReadingResult]:
        """Wait for an idle reader, and let it run a function in a temporary folder.

        ``action`` is the name of a function of :mod:`planner.service.upload_reader`.
        """
        reading = reading or UploadReading()
        reader = self._idle.get()
        try:
            if self._closed:
                raise _stopping_refusal()
            with tempfile.TemporaryDirectory(dir=self._scratch, prefix="examine-") as folder:
                if reader is None or not reader.alive:
                    reader = self._start_reader()
                paths = {name: str(path) for name, path in files.items()}
                return self._ask_reader(
                    reader, {"what": action, "folder": folder, "files": paths, **arguments}, reading
                )
        finally:
            self._idle.put(reader)

    def close(self) -> None:
        """Kill all processes, and with them the requests in progress."""
        self._closed = True
        self._starter.shutdown(cancel_futures=True)
        for reader in list(self._all):
            reader.kill()

    def _start_reader(self) -> UploadReader:
        """Start a reader process in the thread that starts all of them."""
        try:
            reader = self._starter.submit(self._start_process).result()
        except (RuntimeError, CancelledError):  # closed meanwhile
            raise _stopping_refusal() from None
        if self._closed:  # it started while the others were killed
            reader.kill()
        return reader

    def _start_process(self) -> UploadReader:
        """Start the process of a reader, and forget readers that have ended."""
        self._all = {reader for reader in self._all if reader.alive}
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
            env={**os.environ, **dict.fromkeys(THREAD_VARIABLES, "1"), "PYTHONPATH": module_path()},
            process_group=0,  # Ctrl-C must reach only the service, which ends the readers
        )
        reader = UploadReader(process)
        self._all.add(reader)
        return reader

    def _ask_reader(
        self, reader: UploadReader, request: Mapping[str, Any], reading: UploadReading
    ) -> list[ReadingResult]:
        """Send a request to a reader and return its results, or one result with an issue if it failed."""
        time_limit = UploadReading()  # cancels the reading when time is up, as a disconnection does
        timer = threading.Timer(self._seconds, time_limit.cancel)
        timer.daemon = True
        if not reading.set_reader(reader):
            raise connection_closed()
        time_limit.set_reader(reader)
        timer.start()
        try:
            answer = reader.ask(json.dumps(request))
        finally:
            reading.set_reader(None)
            time_limit.set_reader(None)
            timer.cancel()
        if answer is not None:
            if not self._closed:
                reader.settle()
            return [_from_json(result) for result in answer]
        if self._closed:
            raise _stopping_refusal()
        reader.settle()
        if reading.cancelled:
            raise connection_closed()
        exceeded_limit = (
            f"took more than {self._seconds:g} s"
            if time_limit.cancelled
            else f"needs more than {self._memory:g} MB to read, or its reader failed"
        )
        message = format_message("service.check_stopped", exceeded_limit=exceeded_limit)
        return [ReadingResult((Issue("service.check_stopped", message, field="problem"),))]


def _stopping_refusal() -> RefusedError:
    issue = Issue("service.stopping", format_message("service.stopping"))
    return RefusedError(503, issue, {"Retry-After": "10"})


def connection_closed() -> RefusedError:
    """Return the refusal for a client that has disconnected: 499. Nobody receives it."""
    return RefusedError(499, Issue("service.request", "the connection was closed. Send the request again."))


def _to_json(result: ReadingResult) -> dict[str, Any]:
    return {**dataclasses.asdict(result), "issues": [issue.to_dict() for issue in result.issues]}


def _from_json(data: dict[str, Any]) -> ReadingResult:
    issues = tuple(Issue.from_dict(issue) for issue in data["issues"])
    tuples = {key: tuple(data[key]) for key in ("processes", "shapes")}
    return ReadingResult(**{**data, **tuples, "issues": issues})


def serve() -> None:
    """Keep one reader process until standard input ends: fork it, and fork another whenever it is killed.

    The parent has imported the heavy modules, so that a new reader starts at once. The program's arguments
    are the id of the service's process, and the memory limit [MB]. SIGUSR1 makes the parent import Drake for
    the next readers, SIGUSR2 makes it kill the present reader.
    """
    from planner.runtime.second_process import exit_with_parent
    from planner.service import upload_reader  # noqa: F401

    exit_with_parent(int(sys.argv[1]))
    limit = int(float(sys.argv[2]) * MB)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # output of libraries must not mix with answers
    child_pid = killed_count = 0

    def end_child(*_: object) -> None:
        nonlocal killed_count
        killed_count += 1
        os.kill(child_pid, signal.SIGKILL)  # the child exists, if only as a zombie: else signals are blocked

    signal.pthread_sigmask(signal.SIG_BLOCK, PARENT_SIGNALS)
    signal.signal(signal.SIGUSR1, _import_drake)
    signal.signal(signal.SIGUSR2, end_child)
    parent_pid, status = os.getpid(), -1
    while status != 0:
        gc.freeze()
        child_pid = os.fork()
        if child_pid == 0:
            for number in PARENT_SIGNALS:
                signal.signal(number, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, PARENT_SIGNALS)
            exit_with_parent(parent_pid)
            _drain_request(pipe=0)
            answers.write(
                f"\n{START_MARK} {killed_count}\n"
            )  # terminates an incomplete line of a killed reader
            answers.flush()
            _serve_requests(answers)
            os._exit(0)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, PARENT_SIGNALS)
        os.waitid(os.P_PID, child_pid, os.WEXITED | os.WNOWAIT)
        signal.pthread_sigmask(signal.SIG_BLOCK, PARENT_SIGNALS)
        _, status = os.waitpid(child_pid, 0)


PARENT_SIGNALS: Final = (signal.SIGUSR1, signal.SIGUSR2)
"""Signals to the parent of a reader: that Drake is needed, and that the reader must be killed."""


def _drain_request(pipe: int) -> None:
    """Read and drop a request that was sent to a killed reader, so that the next reader does not get it.

    Args:
        pipe: File descriptor of the requests.
    """
    last_byte = b"\n"
    while last_byte != b"\n" or select.select([pipe], [], [], 0.0)[0]:
        chunk = os.read(pipe, 1 << 16)
        if not chunk:
            break
        last_byte = chunk[-1:]


def _import_drake(*_: object) -> None:
    """Import Drake in the parent (signal handler), so that the next readers have it when they are forked."""
    signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # a second signal would start the imports recursively
    from planner import pipeline

    pipeline.import_dependencies()


def _serve_requests(answers: TextIO) -> None:
    """Answer requests to read uploads from standard input until it ends.

    A request is a line with a number and JSON text. Its answer is a line with this number and the results.
    """
    from planner.cell import plant
    from planner.service.upload_reader import examine, examine_element, examine_panels

    models = plant.ModelCache[plant.CellModel]()
    for line in sys.stdin:
        number, _, request_text = line.partition(" ")
        request = json.loads(request_text)
        # Drake is needed here, and probably again. The parent imports it for the next readers.
        if (request.get("reach") or request.get("cell")) and "planner.motion.solve" not in sys.modules:
            os.kill(os.getppid(), signal.SIGUSR1)
        folder, files = Path(request["folder"]), {name: Path(path) for name, path in request["files"].items()}
        try:
            with models.job():
                if request["what"] == "examine_panels":
                    results = examine_panels(folder, files, request["panels"])
                elif request["what"] == "examine_element":
                    element = Path(request["element"])
                    results = [examine_element(folder, element, files, request["facets"], request["fields"])]
                else:
                    inputs = (folder, Path(request["problem"]), files, request["facets"])
                    options = ReadingOptions(
                        reach=request["reach"],
                        draw=request["draw"],
                        targets=request["targets"],
                        cell=request["cell"],
                        fields=request["fields"],
                    )
                    results = [examine(*inputs, options, Path(request["kept"]))]
            answer = json.dumps([_to_json(result) for result in results])
        except MemoryError:
            os._exit(1)  # the parent reports the memory limit
        answers.write(f"{number} {answer}\n")
        answers.flush()


if __name__ == "__main__":
    serve()
