"""The elastic sheet: processor time of the curve of five loads at a point of a cone, and of its parts.

Also the curves of sixty points on one sheet, with the peak memory of a separate process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from planner.geometry.arrays import FloatArray, lengths
from planner.shell.corotation import at_rest
from planner.shell.element import ShellSheet
from planner.shell.mesh import cone_rings, mesh_sheet
from planner.shell.newton import Loading, clamped, column_weights

TRIANGLES = 4000
LOAD_POINTS = 60
LOADS = (100.0, 200.0, 300.0, 400.0, 600.0)
ROUNDS = 5
GOAL_CURVE_S, GOAL_PLACES_S, GOAL_MB = 3.0, 180.0, 500.0
WINDOW = 0.125 * np.array([[-1.0, -1.0], [1.0, 1.0]])
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def run() -> list[dict[str, Any]]:
    """Rows of processor time [s], of a fresh process with one thread."""
    command = [sys.executable, "-m", "bench.shell_bench"]
    one = {**os.environ, **dict.fromkeys(_THREADS, "1")}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=one)
    rows: list[dict[str, Any]] = json.loads(done.stdout.splitlines()[-1])
    return rows


def loaded_cone() -> tuple[Loading, FloatArray]:
    """A cone of top radius 50, 45 degrees, 20 mm deep, and ``PLACES`` places around its floor's edge."""
    turn = 2.0 * np.pi * np.arange(LOAD_POINTS) / LOAD_POINTS
    places = 0.03 * np.column_stack([np.cos(turn), np.sin(turn)])
    mesh = mesh_sheet(cone_rings(0.05, np.radians(45.0), 0.02), WINDOW, TRIANGLES, places)
    corners = mesh.nodes[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sheet = ShellSheet(mesh.nodes, mesh.triangles, 1e-3 * normal[:, 2] / lengths(normal), 68e9, 0.3)
    return Loading(sheet, clamped(sheet, "sliding")), places


def rows() -> list[dict[str, Any]]:
    """Return rows of the work in this process."""
    start_s = time.process_time()
    loading, places = loaded_cone()
    made = time.process_time() - start_s
    sheet, assembly = loading.sheet, loading.assembly
    loads = np.column_stack([np.zeros((len(LOADS), 2)), np.negative(LOADS)])
    told = f"{len(sheet.triangles)} triangles"
    out: list[dict[str, Any]] = []

    def timed(name: str, work: Callable[[], object], note: str, goal: float | None = None) -> None:
        times = []
        for _ in range(ROUNDS):
            start = time.process_time()
            work()
            times.append(time.process_time() - start)
        row: dict[str, Any] = {"name": name, "median_s": float(np.median(times)), "p99_s": max(times)}
        row |= {"spread": float(np.ptp(times)), "note": note}
        if goal is not None:
            row |= {"ratio": row["median_s"] / goal}
        out.append(row)

    rest = at_rest(sheet)
    _, matrix = assembly.tangent(rest)
    out.append({"name": "sheet: mesh, elements, first factors", "median_s": made, "note": told})
    timed("forces", lambda: assembly.force(rest), told)
    timed("forces and tangent", lambda: assembly.tangent(rest), f"{matrix.nnz} entries")
    options = {"SymmetricMode": True}
    timed(
        "factors",
        lambda: splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options),
        f"{matrix.shape[0]} freedoms",
    )
    shares = [column_weights(sheet, candidate, 3e-3) for candidate in places]
    before = loading.effort.factors
    sunk = -1e3 * loading.curve(shares[0], loads)[:, 2]
    factors = loading.effort.factors - before
    note = f"{', '.join(f'{value:.3f}' for value in sunk)} mm, {factors} factors; goal {GOAL_CURVE_S:g} s"
    timed("curve of a place, 5 loads", lambda: loading.curve(shares[0], loads), note, GOAL_CURVE_S)
    start = time.process_time()
    result = np.array([loading.curve(fraction, loads)[-1, 2] for fraction in shares])
    took = time.process_time() - start
    note = f"{-1e3 * result.max():.3f} to {-1e3 * result.min():.3f} mm at {LOADS[-1]:g} N; peak memory"
    note += f" {peak():.0f} MB; goals {GOAL_PLACES_S:g} s, {GOAL_MB:g} MB"
    name = f"curves of {LOAD_POINTS} places on one sheet"
    out.append(
        {"name": name, "median_s": took, "ratio": took / GOAL_PLACES_S, "peak_mb": peak(), "note": note}
    )
    return out


def peak() -> float:
    """Peak memory [MB] of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1e3


if __name__ == "__main__":
    print(json.dumps(rows()))
