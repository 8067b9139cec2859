"""A worker process: ``python -m planner.batch.worker PARENT`` plans what it is told, one problem at a time;
with ``calls`` behind, it works out functions for one plan beside its parent (:class:`Second`).

It reads orders from standard input and answers on standard output: one JSON object a line, or for calls
pickles that nobody else writes to. Whatever libraries print goes to standard error instead. It ends with its
parent, however that ends.
"""

from __future__ import annotations

import ctypes
import gc
import json
import logging
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, TextIO, TypeVar

from planner.runtime.memory import gc_frozen, mark_own_process, release_memory

if TYPE_CHECKING:
    from planner.batch.job import Done, Reports
    from planner.issues import Issue
    from planner.verify.context import Begin

    OnProgress = Callable[[str, float], None]
    OnIssues = Callable[[Sequence[Issue]], None]
    Solve = Callable[[str, Path, Path, Mapping[str, str], OnProgress, OnIssues, Reports], Done]

Result = TypeVar("Result")

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that this process gets when its parent ends."""
OOM_SCORE = "500"
"""Where memory runs out, the kernel ends a worker rather than what watches it."""
CALLS: Final = "calls"
"""The argument by which a worker works out calls."""
SMALL_BYTES: Final = 1 << 16
"""Arrays of fewer bytes go within a pickle, longer ones behind it without a copy."""


def main(arguments: Sequence[str], get: Callable[[], Solve] | None = None) -> int:
    """Serve until standard input ends; ``get`` gives what solves a job, by default the real thing."""
    end_with(int(arguments[0]))
    mark_own_process()
    if CALLS in arguments:
        _work_out()
        return 0
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)
        solve = (get or _planning)()
        _answer(answers, "ready", True)
        for line in sys.stdin:
            _work(json.loads(line), answers, solve)
            _tidy()
    return 0


def _work(order: dict[str, Any], answers: TextIO, solve: Solve) -> None:
    def on_progress(stage: str, fraction: float) -> None:
        _answer(answers, "progress", [stage, float(fraction)])

    def on_issues(issues: Sequence[Issue]) -> None:
        if issues:
            _answer(answers, "found", [issue.to_dict() for issue in issues])

    source, result = Path(order["source"]), Path(order["result"])
    done = solve(order["name"], source, result, order["origins"], on_progress, on_issues, order["reports"])
    _answer(answers, "done", done.to_dict())


def _answer(answers: TextIO, kind: str, content: object) -> None:
    answers.write(json.dumps({kind: content}) + "\n")
    answers.flush()


def _planning() -> Solve:
    """All that planning needs; importing it takes longer than many a job."""
    with gc_frozen():
        from planner import pipeline
        from planner.batch.run import solve
        from planner.cell import plant

        pipeline.ready()

    models = plant.keep_models()

    def with_kept_models(
        name: str,
        source: Path,
        result: Path,
        origins: Mapping[str, str],
        on_progress: OnProgress,
        on_issues: OnIssues,
        reports: Reports,
    ) -> Done:
        models.next_job()
        return solve(name, source, result, origins, on_progress, on_issues, reports)

    logging.getLogger("drake").setLevel(logging.WARNING)
    return with_kept_models


def end_with(parent: int) -> None:
    """Ask the kernel to end this process when its parent does: a thread that waits for the pipe to close
    would not run while a solver holds the interpreter.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # it ended before it could be asked
        os._exit(1)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)


def _work_out() -> None:
    """Work out calls until standard input ends: a generator and its arguments, for all that it yields."""
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        with gc_frozen():
            from planner import pipeline

            pipeline.ready()
        logging.getLogger("drake").setLevel(logging.WARNING)
        while (order := _received(sys.stdin.buffer)) is not None:
            work, arguments = order
            try:
                parts = _packed((True, tuple(work(*arguments))))
            except BaseException:  # Drake raises SystemExit; the parent does it again, and sees what it is
                parts = _packed((False, ()))
            del order, work, arguments
            _send(answers, parts)


class Second:
    """A second process for one plan, which works out calls while this one goes on; a context manager.

    What a call yields is what it yields here, bit by bit. One that fails there, that cannot be told, whose
    process is ended, or that is not begun when it is asked for, since the machine has other things to do, is
    worked out here, where it raises what it raises. One thread enters and leaves it.
    """

    def __init__(self) -> None:
        from planner.batch.workers import MODULE, module_path

        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", MODULE, str(os.getpid()), CALLS],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": module_path()},
            process_group=0,  # Ctrl-C is for the parent, which ends it
        )
        self._talk = ThreadPoolExecutor(1)  # one call after the other

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._talk.shutdown(cancel_futures=True)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(OSError):  # what is still in the pipe to a dead process
                    stream.close()

    def begin(self, work: Callable[..., Iterator[Result]], *arguments: Any) -> Iterator[Result]:
        """Begin a call of a generator function, with its arguments as they are now; what it yields is waited
        for where it is first asked for."""
        try:
            parts = _packed((work, arguments))
        except Exception:  # what a process of a user's own makes of it
            return work(*arguments)
        return self._answered(self._talk.submit(self._asked, parts), work, arguments)

    def _asked(self, parts: Sequence[Any]) -> tuple[bool, tuple[Any, ...]]:
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("a process without pipes")
        try:
            _send(self._process.stdin, parts)
            answer: tuple[bool, tuple[Any, ...]] | None = _received(self._process.stdout)
        except (OSError, EOFError, ValueError):  # its process has ended
            return False, ()
        return (False, ()) if answer is None else answer

    @staticmethod
    def _answered(
        told: Future[tuple[bool, tuple[Any, ...]]], work: Callable[..., Iterator[Result]], arguments: Any
    ) -> Iterator[Result]:
        done, found = (False, ()) if told.cancel() else told.result()
        yield from found if done else work(*arguments)


@contextmanager
def beginning(processes: int) -> Iterator[Begin]:
    """What begins calls: in a second process where there may be two, else here, when they are asked for.

    Raises ``ValueError`` where ``processes`` is less than one.
    """
    if processes < 1:
        raise ValueError(f"got {processes} processes, at least one has to plan")
    if processes == 1:
        from planner.verify.context import at_once

        yield at_once
        return
    with Second() as second:
        yield second.begin


def _packed(content: object) -> list[Any]:
    """A pickle, and behind it the long arrays of what it holds, as bytes that are not copied."""
    long: list[memoryview] = []

    def stays(buffer: pickle.PickleBuffer) -> bool:
        raw = buffer.raw()
        if raw.nbytes >= SMALL_BYTES:
            long.append(raw)
        return raw.nbytes < SMALL_BYTES

    return [pickle.dumps(content, protocol=5, buffer_callback=stays), *long]


def _send(stream: Any, parts: Sequence[Any]) -> None:
    stream.write(json.dumps([len(part) for part in parts]).encode() + b"\n")
    for part in parts:
        stream.write(part)
    stream.flush()


def _received(stream: Any) -> Any:
    """What the other side has sent, None at the end. Raises ``EOFError`` where it ends in the middle."""
    sizes = stream.readline()
    if not sizes:
        return None
    parts = []
    for size in json.loads(sizes):
        part = bytearray(size)
        if stream.readinto(part) != size:
            raise EOFError
        parts.append(part)
    return pickle.loads(parts[0], buffers=parts[1:])


def _tidy() -> None:
    """Give memory of the last job back, so that it is not counted as the next one's."""
    gc.collect()
    release_memory()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
