"""Start-up: the command, the package and a problem that is refused, beside an empty Python process."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from typing import Any

import numpy as np

from planner.catalogue.robots import data_dir

REPEATS = 15
"""Runs of each start; they alternate, so that a busy machine slows all of them."""


def run() -> list[dict[str, Any]]:
    """Return rows with name, median_s, spread (p90 - p10), ratio (empty Python over ours) and note."""
    refused = data_dir("problems") / "infeasible" / "unknown_key.yaml"
    starts = {
        "python -c pass": ["-c", "pass"],
        "python -c 'import planner'": ["-c", "import planner"],
        "tandem --help": ["-m", "planner", "--help"],
        "tandem check, unknown key": ["-m", "planner", "check", str(refused)],
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in starts}
    for arguments in starts.values():
        _seconds(arguments)  # compiles modules and fills the file cache
    for _ in range(REPEATS):
        for name, arguments in starts.items():
            times[name].append(_seconds(arguments))
    empty = float(np.median([elapsed for elapsed, _ in times["python -c pass"]]))
    return [_row(name, values, empty) for name, values in times.items()]


def _seconds(arguments: list[str]) -> tuple[float, float]:
    """Return elapsed and processor time [s] of one process."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *arguments], capture_output=True, check=False)
    elapsed, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return elapsed, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _row(name: str, seconds: list[tuple[float, float]], empty: float) -> dict[str, Any]:
    low, median, high = (float(v) for v in np.percentile([elapsed for elapsed, _ in seconds], [10, 50, 90]))
    note = f"{1e3 * float(np.median([processor for _, processor in seconds])):.0f} ms of processor time"
    return {"name": name, "median_s": median, "spread": high - low, "ratio": empty / median, "note": note}
