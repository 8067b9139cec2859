"""A worker process as its parent sees it: orders in, answers out, memory, end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Threads of the linear algebra: one of each, as for ``tandem plan``, unless the environment says more."""
MODULE = "planner.batch.worker"
CHUNK = 1 << 16
PAGE = os.sysconf("SC_PAGE_SIZE")
LAST_WORDS = 4000


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
            while chunk := os.read(self.fileno(), CHUNK):
                self._rest += chunk
            ended = True
        except BlockingIOError:
            pass
        *lines, self._rest = self._rest.split(b"\n")
        return [json.loads(line) for line in lines], ended

    def memory_mb(self) -> float:
        """Memory that it holds now [MB]; 0 when it has ended."""
        try:
            return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * PAGE / 1e6
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
        self._words.seek(max(0, size - LAST_WORDS))
        lines = [line.strip() for line in self._words.read().decode("utf-8", "replace").splitlines()]
        told = [line for line in lines if line]
        return told[-1][:200] if told else ""

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
    return {**dict.fromkeys(THREADS, "1"), **kept, "PYTHONPATH": _path()}


def _path() -> str:
    """The module path of this process, so that a worker imports the same code."""
    return os.pathsep.join(entry for entry in sys.path if entry)
