"""Whole jobs, cold: a fresh process each, from problem file to verified programs with report and replay."""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

JOBS = (
    "column_capital/faces.yaml",
    "column_capital",
    "wave_wall",
    "hypar_panel",
    "large_arms",
    "wing",
    "shell_piece_held/small.yaml",
    "shell_piece_held",
)
RUNS = 3
GOAL = {
    "column_capital/faces.yaml": 20.0,
    "wing": 10.0,
    "shell_piece_held/small.yaml": 20.0,
    "shell_piece_held": 20.0,
}
"""Wanted wall time [s] on one core."""


def run() -> list[dict[str, Any]]:
    """Rows of median wall time [s], its spread, and a note with processor time, memory, targets and proof."""
    return [_row(name) for name in JOBS]


def _row(name: str) -> dict[str, Any]:
    walls, processors, peaks = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        for _ in range(RUNS):
            wall, processor, peak = _cold(name, out)
            walls.append(wall)
            processors.append(processor)
            peaks.append(peak)
        proof = json.loads((out / "proof.json").read_text()) if (out / "proof.json").exists() else {}
        proven = (out / "programs").is_dir()
    median = statistics.median(walls)
    goal = GOAL.get(name)
    load = f"load {os.getloadavg()[0]:.1f}"
    note = (
        f"processor {statistics.median(processors):.1f} s, peak memory {max(peaks):.0f} MB, "
        f"{len(proof.get('rules', []))} rules, {'proven' if proven else 'NOT proven'}, {load}"
    )
    return {
        "name": f"{name}, cold",
        "median_s": median,
        "spread": max(walls) - min(walls),
        "ratio": None if goal is None else median / goal,
        "note": note if goal is None else f"{note}; ratio is to the goal of {goal:.0f} s",
    }


def _cold(name: str, out: Path) -> tuple[float, float, float]:
    """Wall and processor seconds and peak memory [MB] of one run in a fresh process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    command = [sys.executable, "-m", "planner", "plan", name, "-o", str(out)]
    subprocess.run(command, check=False, capture_output=True, timeout=900)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, processor, after.ru_maxrss / 1e3
