"""Timing of 100 random smooth two-arm paths on grids of 400, 1000 and 2000, against Drake's Toppra in the
same run."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from planner.motion.trajectory.timing import compute_profile, solve_drake

PATHS = 100
DRAKE_PATHS = 20
JOINTS = 12


def smooth_path(seed: int) -> CubicSpline:
    """A random path of 12 joints through seven points."""
    rng = np.random.default_rng(seed)
    return CubicSpline(np.linspace(0.0, 1.0, 7), rng.uniform(-1.5, 1.5, (7, JOINTS)))


def run() -> list[dict[str, Any]]:
    """One row a grid."""
    return [_grid(count) for count in (400, 1000, 2000)]


def _grid(count: int) -> dict[str, Any]:
    grid = np.linspace(0.0, 1.0, count + 1)
    speed, strength, bound = np.full(JOINTS, 3.0), np.full(JOINTS, 9.0), np.full(count + 1, 100.0)
    ours, theirs, done, drake_done, solvers = [], [], 0, 0, []
    for seed in range(PATHS):
        spline = smooth_path(seed)
        start = time.process_time()
        result, used = compute_profile(spline, grid, bound, speed, strength)
        ours.append(time.process_time() - start)
        done += result is not None
        solvers.append(used)
        if seed < DRAKE_PATHS:
            limit = np.minimum(bound, np.min(speed / np.abs(spline(grid, 1)), axis=1))
            start = time.process_time()
            drake_done += solve_drake(spline, grid, limit, strength) is not None
            theirs.append(time.process_time() - start)
    note = (
        f"timed {done} of {PATHS} (toppra {solvers.count('toppra')}); "
        f"Drake {np.median(theirs):.3f} s, timed {drake_done} of {DRAKE_PATHS}"
    )
    median = float(np.median(ours))
    return {
        "name": f"timing, 12 joints, grid {count}",
        "median_s": median,
        "spread": max(ours) - min(ours),
        "ratio": median / float(np.median(theirs)),
        "note": note,
    }
