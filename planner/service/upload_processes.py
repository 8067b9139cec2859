"""Processes that read what users upload, with limits of time and memory; a JSON line to and fro for each.

A process that takes too long, too much memory or dies costs the one request that it was at. Who reads is
forked from a parent that has imported what reading needs, Drake once it is asked for: a reading that is
broken off, as each change of an edited problem breaks off the check of the one before, costs a fork.
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

from planner.batch.workers import THREADS
from planner.issues import Issue
from planner.runtime.second_process import module_path
from planner.service.examined import Examined
from planner.service.security import RefusedError

MB: Final = 1 << 20
"""Bytes of a megabyte, as limits of memory are counted (2^20)."""
KEPT: Final = "targets"
"""The folder of targets that are kept, beside those of readings."""


class Reader:
    """A process that reads what it is asked, one at a time, and its parent, which forks the next one.

    Readings are numbered, and an answer has the number of its own. Who reads says how many were ended before
    it: the one that was wanted to be ended may have ended by itself, and the next one in its place.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._clean = False  # somebody has begun to read, and no line of a former reading is left
        self._asked = self._unwanted = self._ending = False
        self._number = self._ended = 0  # of the reading; of those who read, how many were to be ended
        self._turn = threading.Lock()  # of who asks and who breaks that off

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._process.poll() is None

    def renew(self) -> None:
        """End what is asked, and with it who reads that; another one takes its place. What was not asked yet
        will not be: who is ended before it was asked, or before it has begun, would leave lines behind that
        are taken for others."""
        with self._turn:
            self._unwanted = True
            if self._asked and not self._ending:
                self._end_who_reads()

    def end(self) -> None:
        """End both."""
        self._process.kill()
        self._process.wait()

    def ask(self, what: str) -> list[Any] | None:
        """The answer to one line; None where who reads has ended, or nobody wants to know any more."""
        if not self._clean and not self._wait():
            return None
        if self._process.stdin is None:
            raise RuntimeError("a reader has no pipes")
        with self._turn:
            if self._unwanted:
                return None
            self._asked = True
            self._number += 1
            try:
                self._process.stdin.write(f"{self._number} {what}\n")
                self._process.stdin.flush()
            except OSError:
                self._clean = False
                return None
        number, _, answer = self._line().partition(" ")
        found = _json_of(answer) if number == str(self._number) else None
        with self._turn:
            self._asked = False
        self._clean = found is not None
        return found

    def settle(self) -> None:
        """Wait for the one that takes the place of who was ended; nobody calls :meth:`renew` any more. Where
        there was no answer, who reads now may have begun before, and is ended, too: what it was sent, and
        what it has said, goes with it."""
        if self._ending or not self._clean:
            if not self._ending:
                self._end_who_reads()
            self._clean = False
            if not self._wait():
                self.end()
        self._asked = self._unwanted = self._ending = False

    def _end_who_reads(self) -> None:
        self._ending = True
        self._ended += 1
        self._process.send_signal(signal.SIGUSR2)

    def _wait(self) -> bool:
        """Whether somebody reads from now on."""
        while not self._clean:
            line = self._line()
            if not line:
                return False
            self._clean = line == f"{BEGUN} {self._ended}\n"
        return True

    def _line(self) -> str:
        if self._process.stdout is None:
            raise RuntimeError("a reader has no pipes")
        return self._process.stdout.readline()


BEGUN: Final = "reading"
"""The line with which a process that reads begins, with how many were ended before."""


def _json_of(line: str) -> list[Any] | None:
    """A whole answer; None of what is broken off."""
    if not line.endswith("\n"):
        return None
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, list) else None


class Reading:
    """One reading of an upload, which another thread can break off."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reader: Reader | None = None
        self.off = False

    def by(self, reader: Reader | None) -> bool:
        """Name who reads, or None when it has read; whether the reading is still wanted."""
        with self._lock:
            self._reader = None if self.off else reader
            return not self.off

    def break_off(self) -> None:
        """End the reading, and who reads with it."""
        with self._lock:
            self.off = True
            if self._reader is not None:
                self._reader.renew()


class Examiners:
    """A few processes that serve in turn; start on use, end with :meth:`close`."""

    def __init__(self, count: int, scratch: Path, seconds: float, memory_mb: float, mesh_facets: int) -> None:
        self._scratch, self._seconds, self._memory = scratch, seconds, memory_mb
        self._facets = mesh_facets
        self._idle: queue.LifoQueue[Reader | None] = queue.LifoQueue()  # the warm one before the others
        for _ in range(count):
            self._idle.put(None)
        self._all: set[Reader] = set()
        self._kept = scratch / KEPT
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
        targets: int | None = None,
        cell: Mapping[str, Any] | None = None,
        fields: Mapping[str, Any] | None = None,
    ) -> Examined:
        """As :func:`planner.service.upload_reader.examine`, in a process of its own; raises
        :class:`RefusedError`, 503, where the service stops meanwhile, 499 where ``reading`` is broken off."""
        more = {"problem": str(problem), "reach": reach, "draw": draw, "facets": self._facets}
        more |= {"targets": targets, "kept": str(self._kept), "cell": cell, "fields": fields}
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
        reader = self._idle.get()
        try:
            if self._closed:
                raise _stopping()
            with tempfile.TemporaryDirectory(dir=self._scratch, prefix="examine-") as folder:
                if reader is None or not reader.alive:
                    reader = self._started()
                given = {name: str(path) for name, path in files.items()}
                return self._ask(reader, {"what": what, "folder": folder, "files": given, **more}, reading)
        finally:
            self._idle.put(reader)

    def close(self) -> None:
        """End the processes, and with them what they are asked."""
        self._closed = True
        self._maker.shutdown(cancel_futures=True)
        for reader in list(self._all):
            reader.end()

    def _started(self) -> Reader:
        try:
            reader = self._maker.submit(self._start).result()
        except (RuntimeError, CancelledError):  # closed meanwhile
            raise _stopping() from None
        if self._closed:  # it began while the others were ended
            reader.end()
        return reader

    def _start(self) -> Reader:
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
            env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": module_path()},
            process_group=0,  # Ctrl-C is for the service, which ends them
        )
        reader = Reader(process)
        self._all.add(reader)
        return reader

    def _ask(self, reader: Reader, asked: Mapping[str, Any], reading: Reading) -> list[Examined]:
        limit = Reading()  # ends the reading as somebody who hangs up does
        timer = threading.Timer(self._seconds, limit.break_off)
        timer.daemon = True
        if not reading.by(reader):
            raise connection_closed()
        limit.by(reader)
        timer.start()
        try:
            answer = reader.ask(json.dumps(asked))
        finally:
            reading.by(None)
            limit.by(None)
            timer.cancel()
        if answer is not None:
            if not self._closed:
                reader.settle()
            return [_from_json(one) for one in answer]
        if self._closed:
            raise _stopping()
        reader.settle()
        if reading.off:
            raise connection_closed()
        what = (
            f"took more than {self._seconds:g} s"
            if limit.off
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


def _to_json(examined: Examined) -> dict[str, Any]:
    return {**dataclasses.asdict(examined), "issues": [issue.to_dict() for issue in examined.issues]}


def _from_json(data: dict[str, Any]) -> Examined:
    issues = tuple(Issue.from_dict(issue) for issue in data["issues"])
    tuples = {key: tuple(data[key]) for key in ("processes", "shapes")}
    return Examined(**{**data, **tuples, "issues": issues})


def serve() -> None:
    """Fork who reads, and another one whenever it is ended, until standard input ends."""
    from planner.runtime.second_process import exit_with_parent
    from planner.service import upload_reader  # noqa: F401

    exit_with_parent(int(sys.argv[1]))
    limit = int(float(sys.argv[2]) * MB)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    child = ended = 0

    def end_child(*_: object) -> None:
        nonlocal ended
        ended += 1
        os.kill(child, signal.SIGKILL)  # it is there, perhaps at its end: signals are blocked else

    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    signal.signal(signal.SIGUSR1, _get_ready)
    signal.signal(signal.SIGUSR2, end_child)
    own, status = os.getpid(), -1
    while status != 0:
        gc.freeze()
        child = os.fork()
        if child == 0:
            for number in SIGNALS:
                signal.signal(number, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
            exit_with_parent(own)
            _drain(0)
            answers.write(f"\n{BEGUN} {ended}\n")  # what another one had begun to write ends here
            answers.flush()
            _read_on(answers)
            os._exit(0)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        _, status = os.waitpid(child, 0)


SIGNALS: Final = (signal.SIGUSR1, signal.SIGUSR2)
"""What the parent of who reads is told: that Drake is wanted, and that who reads is to be ended."""


def _drain(pipe: int) -> None:
    """Drop the request that was on its way to another one that has been ended."""
    last = b"\n"
    while last != b"\n" or select.select([pipe], [], [], 0.0)[0]:
        read = os.read(pipe, 1 << 16)
        if not read:
            break
        last = read[-1:]


def _get_ready(*_: object) -> None:
    signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # again in their midst they would begin within themselves
    from planner import pipeline

    pipeline.ready()


def _read_on(answers: TextIO) -> None:
    """Answer requests from standard input until it ends."""
    from planner.cell import plant
    from planner.service.upload_reader import examine, examine_element, examine_panels

    models = plant.keep_models()
    for line in sys.stdin:
        number, _, text = line.partition(" ")
        asked = json.loads(text)
        if (asked.get("reach") or asked.get("cell")) and "planner.motion.solve" not in sys.modules:
            os.kill(os.getppid(), signal.SIGUSR1)
        folder, files = Path(asked["folder"]), {name: Path(path) for name, path in asked["files"].items()}
        models.next_job()
        try:
            if asked["what"] == "examine_panels":
                found = examine_panels(folder, files, asked["panels"])
            elif asked["what"] == "examine_element":
                element = Path(asked["element"])
                found = [examine_element(folder, element, files, asked["facets"], asked["fields"])]
            else:
                given = (folder, Path(asked["problem"]), files, asked["facets"])
                more = (asked["reach"], asked["draw"], asked["targets"], Path(asked["kept"]))
                found = [examine(*given, *more, cell=asked["cell"], fields=asked["fields"])]
            answer = json.dumps([_to_json(one) for one in found])
        except MemoryError:
            os._exit(1)  # who asked says what it means
        answers.write(f"{number} {answer}\n")
        answers.flush()


if __name__ == "__main__":
    serve()
