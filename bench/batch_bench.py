"""Batches: throughput of 64 small problems on 1 and 2 workers, on this machine's processes and on Dask.

Start-up is excluded: each team first plans one problem per worker. The gain of a second worker is compared
with what the machine can give: two processes that only count, against one.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.proc import child_processes
from planner import pipeline
from planner.batch.cluster import ClusterPlanners
from planner.batch.job import BatchJob, JobFinished
from planner.batch.run import make_bundled_job
from planner.batch.workers import BatchWorkers
from tests import small_problem

JOBS = int(os.environ.get("BATCH_BENCH_JOBS", "64"))
WANTED_EFFICIENCY = 0.9
WANTED_MB = 600.0
COUNTED = 20_000_000


def run() -> list[dict[str, Any]]:
    """Rows of the time [s] of a batch, with problems an hour, efficiency and memory in the note."""
    machine = _machine()
    rows = []
    for name, team in (("processes", _processes), ("dask", _dask)):
        item, one_mb = _batch(team, 1)
        two, two_mb = _batch(team, 2)
        efficiency = item / (2.0 * two)
        for count, seconds, peak in ((1, item, one_mb), (2, two, two_mb)):
            note = f"{3600 * JOBS / seconds:.0f} problems an hour, at most {peak:.0f} MB a worker"
            if count == 2:
                note += f"; efficiency {efficiency:.2f}, that of the machine {machine:.2f}"
            rows.append(
                {
                    "name": f"batch of {JOBS}, {count} worker{'s' if count > 1 else ''}, {name}",
                    "median_s": seconds,
                    "ratio": WANTED_EFFICIENCY / efficiency if count == 2 else peak / WANTED_MB,
                    "note": f"{note}; ratio is to the goal; load {os.getloadavg()[0]:.1f}",
                }
            )
    return rows


@contextmanager
def _processes(count: int) -> Iterator[BatchWorkers]:
    with BatchWorkers(count) as team:
        yield team


@contextmanager
def _dask(count: int) -> Iterator[ClusterPlanners]:
    with ClusterPlanners("local", count) as team:
        yield team


def _batch(make: Callable[[int], Any], count: int) -> tuple[float, float]:
    """Wall time [s] of all jobs when the workers have started, and the most memory [MB] of one of them."""
    with tempfile.TemporaryDirectory() as folder:
        jobs = _jobs(Path(folder), JOBS)
        with make(count) as team, _watch_memory() as peak:
            _plan(team, [dataclasses.replace(jobs[i], name=f"warm-{i}") for i in range(count)], Path(folder))
            start = time.perf_counter()
            _plan(team, jobs, Path(folder))
            return time.perf_counter() - start, peak[0]


def _jobs(folder: Path, count: int) -> list[BatchJob]:
    """So many problems of one cell, each with its own poses."""
    out = []
    for i in range(count):
        rows = [f"450,{y + 0.1 * i:.1f},500,0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]
        path = small_problem.write(folder, table="\n".join([small_problem.COLUMNS, *rows]))
        out.append(make_bundled_job(f"job-{i:02d}", pipeline.load(path)))
    return out


def _plan(team: Any, jobs: list[BatchJob], folder: Path) -> None:
    waiting, ended = list(jobs[::-1]), 0
    under_way = 0
    while ended < len(jobs):
        while waiting and under_way < team.ahead:
            one = waiting.pop()
            team.start(one, folder / "out" / one.name)
            under_way += 1
        for event in team.events(1.0):
            if isinstance(event, JobFinished):
                ended, under_way = ended + 1, under_way - 1
                if event.done.state != "verified":
                    raise RuntimeError(f"{event.name}: {event.done.state} {event.done.issues}")


@contextmanager
def _watch_memory() -> Iterator[list[float]]:
    """Record the peak memory [MB] of a single child process, sampled ten times a second."""
    peak, stop = [0.0], threading.Event()

    def sample_memory() -> None:
        while not stop.wait(0.1):
            peak[0] = max([peak[0], *(_memory_mb(pid) for pid in child_processes(os.getpid()))])

    thread = threading.Thread(target=sample_memory, daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        stop.set()
        thread.join()


def _memory_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, IndexError):
        return 0.0


def _machine() -> float:
    """Return half of the work that two busy processes do in the time of one: 1 on two free processors."""
    context = multiprocessing.get_context("spawn")
    times = []
    for count in (1, 2):
        with context.Pool(count) as pool:
            pool.map(_count, [1000] * count)
            start = time.perf_counter()
            pool.map(_count, [COUNTED] * count, chunksize=1)
            times.append(time.perf_counter() - start)
    return times[0] / times[1]


def _count(until: int) -> int:
    total = 0
    for i in range(until):
        total += i
    return total
