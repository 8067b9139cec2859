"""A second process that runs calls of generator functions for its parent, one after the other.

``python -m planner.runtime.second_process PARENT WARM_UP`` reads pickled calls from standard input and writes
the pickled items of each call to standard output. Output of libraries goes to standard error instead.
``PARENT`` is the process id of the parent. ``WARM_UP`` is ``module:function``. The process calls this
function first, for example to import heavy modules, so this module does not depend on the code that it runs.
The process ends with its parent, however the parent ends.
"""

import ctypes
import json
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Self, TypeVar

from planner.runtime.executor import SERIAL, Executor
from planner.runtime.memory import gc_frozen, mark_own_process

Item = TypeVar("Item")

MODULE: Final = "planner.runtime.second_process"
"""Module that the second process runs."""
PR_SET_PDEATHSIG: Final = 1
"""Option of prctl(2): the signal that this process gets when its parent ends."""
OOM_SCORE: Final = "500"
"""Score (oom_score_adj) that makes the kernel kill a worker before its parent when memory runs out."""
SMALL_BYTES: Final = 1 << 16
"""Size [bytes] below which arrays are part of the pickle. Larger ones follow it without a copy."""


def main(arguments: Sequence[str]) -> int:
    """Serve calls until standard input ends. The arguments are the parent's process id and ``WARM_UP``."""
    parent, warm_up = arguments
    exit_with_parent(int(parent))
    mark_own_process()
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # whatever a library prints goes to standard error
        with gc_frozen():
            module, _, function = warm_up.partition(":")
            getattr(import_module(module), function)()
        while (order := _receive(sys.stdin.buffer)) is not None:
            generator_function, call_arguments = order
            try:
                parts = _pack((True, tuple(generator_function(*call_arguments))))
            except BaseException:  # Drake raises SystemExit; the parent repeats the call and gets the error
                parts = _pack((False, ()))
            del order, generator_function, call_arguments  # release memory before the wait for the next call
            _send(answers, parts)
    return 0


def exit_with_parent(parent: int) -> None:
    """Ask the kernel to kill this process when its parent ends, and before its parent if memory runs out.

    A thread that waits for the pipe to close would not run while a solver holds the interpreter.

    Args:
        parent: Process id of the parent. This process exits at once if the parent has ended already.

    Raises:
        OSError: The kernel refuses the request.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # the parent ended before the call above
        os._exit(1)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)


def module_path() -> str:
    """Return the module path of this process, so that a child process imports the same code."""
    return os.pathsep.join(entry for entry in sys.path if entry)


class SecondProcess:
    """An :class:`~planner.runtime.executor.Executor` that runs calls in a second process; a context manager.

    The items are the same, bit by bit, as in this process. A call runs in this process instead if it cannot
    be pickled, if it has not started in the second process when its items are requested, if it fails there,
    or if the second process was killed. Exceptions are therefore raised in this process. The same thread must
    enter and exit the context.
    """

    parallel: Final = True

    def __init__(self, warm_up: str) -> None:
        """Start the process; it calls the function ``warm_up`` (``module:function``) first."""
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", MODULE, str(os.getpid()), warm_up],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": module_path()},
            process_group=0,  # Ctrl-C is for the parent, which ends this process
        )
        self._thread = ThreadPoolExecutor(1)  # one call after the other

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._thread.shutdown(cancel_futures=True)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(OSError):  # data left in the pipe to a dead process
                    stream.close()

    def submit(self, work: Callable[..., Iterator[Item]], *arguments: Any) -> Iterator[Item]:
        """Start a call with its arguments as they are now; the first request for an item waits for all."""
        try:
            parts = _pack((work, arguments))
        except Exception:  # pickling objects of an installed process may raise anything
            return work(*arguments)
        return self._items(self._thread.submit(self._call, parts), work, arguments)

    def _call(self, parts: Sequence[Any]) -> tuple[bool, tuple[Any, ...]]:
        """Run a pickled call in the second process, and return whether it succeeded, and its items."""
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("the second process has no pipes")
        try:
            _send(self._process.stdin, parts)
            answer: tuple[bool, tuple[Any, ...]] | None = _receive(self._process.stdout)
        except (OSError, EOFError, ValueError):  # the second process has ended
            return False, ()
        return (False, ()) if answer is None else answer

    @staticmethod
    def _items(
        pending: Future[tuple[bool, tuple[Any, ...]]], work: Callable[..., Iterator[Item]], arguments: Any
    ) -> Iterator[Item]:
        """Yield the items of a call; run it in this process if it has not started, or has failed."""
        succeeded, items = (False, ()) if pending.cancel() else pending.result()
        yield from items if succeeded else work(*arguments)


@contextmanager
def open_executor(processes: int, warm_up: str) -> Iterator[Executor]:
    """Open an executor: a second process if two processes are allowed, else this process.

    Args:
        processes: Number of processes, including this one. At most one more is started.
        warm_up: Function that the second process calls first (``module:function``).

    Raises:
        ValueError: ``processes`` is less than one.
    """
    if processes < 1:
        raise ValueError(f"got {processes} processes; required: at least 1")
    if processes == 1:
        yield SERIAL
        return
    with SecondProcess(warm_up) as second:
        yield second


def _pack(content: object) -> list[Any]:
    """Return the pickle of an object, followed by its large arrays as buffers that are not copied."""
    large_arrays: list[memoryview] = []

    def in_band(buffer: pickle.PickleBuffer) -> bool:
        """Return whether an array is part of the pickle; keep it otherwise."""
        raw = buffer.raw()
        if raw.nbytes >= SMALL_BYTES:
            large_arrays.append(raw)
        return raw.nbytes < SMALL_BYTES

    return [pickle.dumps(content, protocol=5, buffer_callback=in_band), *large_arrays]


def _send(stream: Any, parts: Sequence[Any]) -> None:
    """Write a packed object: a line with the sizes of its parts [bytes], and the parts."""
    stream.write(json.dumps([len(part) for part in parts]).encode() + b"\n")
    for part in parts:
        stream.write(part)
    stream.flush()


def _receive(stream: Any) -> Any:
    """Read an object that the other process sent; None at the end of the stream.

    Raises:
        EOFError: The stream ends in the middle of an object.
    """
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
