"""Processes below one, as Linux reports them (proc(5)): which exist, and what they have used.

Also whole commands, with the time and memory of each of their processes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ONE_THREAD: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment variables that limit linear algebra libraries to one thread."""
_MEMORY_SAMPLE_S: Final = 0.05
"""Interval [s] between memory samples of a command's processes."""


def child_processes(pid: int) -> Iterator[int]:
    """All that a process has started and what these have, parents first; none of what has ended."""
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = [int(child) for child in path.read_text().split()]
        except OSError:
            continue
        for child in children:
            yield child
            yield from child_processes(child)


def processor_time(pid: int) -> float:
    """Return user and system time [s] of a process so far (stat, fields 14 and 15).

    Raises:
        OSError: The process has ended.
    """
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(what: str, pid: int | str = "self") -> float:
    """Memory [MB] of a process: ``VmRSS`` now, ``VmHWM`` the peak since it was last forgotten."""
    rows = Path(f"/proc/{pid}/status").read_text().splitlines()
    return float(next(row for row in rows if row.startswith(what)).split()[1]) / 1e3


@dataclasses.dataclass(frozen=True)
class ProcessRun:
    """A command that has ended: its wall time [s], and of each of its processes, the first one first, the
    processor time [s] and the peak of memory [MB]; the most of all together; the load before; its output."""

    wall: float
    code: int
    times: tuple[float, ...]
    peaks: tuple[float, ...]
    together: float
    load: float
    output: str

    @property
    def note(self) -> str:
        """As part of a note."""
        proven = "proven" if self.code == 0 else "NOT proven"
        processor = " + ".join(f"{value:.1f}" for value in self.times)
        peaks = " and ".join(f"{value:.0f}" for value in self.peaks)
        what = (
            f"{proven}, processor time {processor} s, peak memory {peaks} MB, together {self.together:.0f} MB"
        )
        return f"{what}, load before {self.load:.1f}"


def run_plan(problem: str | Path, folder: str | Path) -> ProcessRun:
    """``tandem plan`` of a problem into a folder, cold, with its second process."""
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-P", "-m", "planner", "plan", str(problem), "-o", str(folder)]
    time_of: dict[int, float] = {}
    peak_of: dict[int, float] = {}
    together, load, start = 0.0, os.getloadavg()[0], time.perf_counter()
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(command, stdout=said, stderr=subprocess.DEVNULL, env=environment)
        while process.poll() is None:
            now = 0.0
            for pid in (process.pid, *child_processes(process.pid)):
                with contextlib.suppress(OSError, StopIteration):  # one that has just ended
                    time_of[pid] = processor_time(pid)
                    peak_of[pid] = memory("VmHWM", pid)
                    now += memory("VmRSS", pid)
            together = max(together, now)
            time.sleep(_MEMORY_SAMPLE_S)
        wall = time.perf_counter() - start
        said.seek(0)
        output = said.read()
    spans, peaks = tuple(time_of.values()), tuple(peak_of.values())
    return ProcessRun(wall, process.returncode, spans, peaks, together, load, output)
