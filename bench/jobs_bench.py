"""Whole commands, cold: a fresh process each. Jobs from problem file to verified programs with report and
replay, and what the first moments of a command take.

``BENCH_BASELINE=FOLDER python -m bench jobs`` runs each also in the tree of another version, turn by turn,
and gives the ratio to that. ``BENCH_JOBS="wing, wave_wall"`` runs some of the jobs only, ``,`` none.
"""

from __future__ import annotations

import json
import os
import pty
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
    "flank_wall",
    "shell_piece_held/small.yaml",
    "shell_piece_held",
)
RUNS = 3
GOAL = {
    "column_capital/faces.yaml": 9.0,
    "column_capital": 15.0,
    "wave_wall": 9.0,
    "wing": 5.0,
    "flank_wall": 8.0,
    "shell_piece_held/small.yaml": 20.0,
    "shell_piece_held": 20.0,
}
"""Target wall time [s] on two cores."""
FIRST_MOMENTS = {
    "start to first message": (0.4, ("-m", "planner", "plan", "wing", "-o")),
    "tandem robots": (0.4, ("-m", "planner", "robots")),
    "planner.load('wing')": (1.0, ("-c", "import planner; planner.load('wing')")),
}
"""Target wall time [s] and arguments of commands before they plan."""
BASELINE = os.environ.get("BENCH_BASELINE")
"""Tree of another version for comparison."""


def run() -> list[dict[str, Any]]:
    """Rows of median wall time [s], its spread, and a note with processor time, memory, targets and proof."""
    subset = os.environ.get("BENCH_JOBS")
    jobs = JOBS if subset is None else [name.strip() for name in subset.split(",") if name.strip()]
    return [*(_first_moment(name) for name in FIRST_MOMENTS), *(_row(name) for name in jobs)]


def _first_moment(name: str) -> dict[str, Any]:
    goal, arguments = FIRST_MOMENTS[name]
    walls, processors, before = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        command = [*arguments, folder] if arguments[-1] == "-o" else list(arguments)
        _moment(command)  # its modules are compiled
        for _ in range(2 * RUNS + 1):
            wall, processor = _moment(command)
            walls.append(wall)
            processors.append(processor)
            before += [_moment(command, BASELINE)[0]] if BASELINE else []
    return _measured_row(name, walls, before, goal, f"processor {statistics.median(processors):.2f} s")


def _moment(arguments: list[str], tree: str | None = None) -> tuple[float, float]:
    """Return the wall time [s] until a process ends, or, if it plans, until its first output to a terminal.

    Also returns the processor time [s] of the whole process.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ours, theirs = pty.openpty()
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-P", *arguments], stdout=subprocess.DEVNULL, stderr=theirs, env=_environment(tree)
    )
    if "plan" in arguments:
        os.read(ours, 1)
        wall = time.perf_counter() - start
        process.kill()
        process.wait()
    else:
        process.wait()
        wall = time.perf_counter() - start
    for end in (ours, theirs):
        os.close(end)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _environment(tree: str | None) -> dict[str, str]:
    """That of a command, in which ``tree`` is the version that runs."""
    return {**os.environ, "PYTHONPATH": str(Path(tree).resolve() if tree else Path(__file__).parents[1])}


def _measured_row(
    name: str, walls: list[float], baseline: list[float], goal: float | None, note: str
) -> dict[str, Any]:
    """Return a row of the table; the ratio is to the baseline if there is one, else to the goal."""
    median = statistics.median(walls)
    note += "" if goal is None else f"; wanted {goal:g} s"
    peer = goal
    if baseline:
        peer = statistics.median(baseline)
        note += f"; ratio is to {peer:.2f} s of the baseline"
    row = {"name": f"{name}, cold", "median_s": median, "spread": max(walls) - min(walls), "note": note}
    return {**row, "ratio": None if peer is None else median / peer}


def _row(name: str) -> dict[str, Any]:
    walls, processors, peaks, before = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        for _ in range(RUNS):
            if BASELINE:
                before.append(_cold(name, Path(folder) / "before", BASELINE)[0])
            wall, processor, peak = _cold(name, out)
            walls.append(wall)
            processors.append(processor)
            peaks.append(peak)
        proof = json.loads((out / "proof.json").read_text()) if (out / "proof.json").exists() else {}
        proven = (out / "programs").is_dir()
    note = (
        f"processor {statistics.median(processors):.1f} s, peak memory of a process {max(peaks):.0f} MB, "
        f"{len(proof.get('rules', []))} rules, {'proven' if proven else 'NOT proven'}, "
        f"load {os.getloadavg()[0]:.1f}"
    )
    return _measured_row(name, walls, before, GOAL.get(name), note)


def _cold(name: str, out: Path, tree: str | None = None) -> tuple[float, float, float]:
    """Wall and processor seconds and peak memory [MB] of one run in a fresh process; ``tree`` as above."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    command = [sys.executable, "-P", "-m", "planner", "plan", name, "-o", str(out)]
    subprocess.run(command, check=False, capture_output=True, timeout=900, env=_environment(tree))
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, processor, after.ru_maxrss / 1e3
