"""Paths from and to home of bundled two-arm jobs: one arm after the other by a tree, and as they are planned.

Degrees are the sum over all joints, seconds those at the speed of programs' joint moves (250 mm/s and
45 deg/s). Times are processor time of the whole search.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from planner import pipeline
from planner.motion import homing, solve
from planner.motion.homing import HomeMotion, _MovingArms
from planner.motion.path_shortcutting import path_travel
from planner.motion.planning_scene import Scene
from planner.problem import Problem
from planner.processes import registry
from planner.targets import Job

JOBS = (
    "shell_piece_held/small",
    "shell_piece_held/problem",
    "column_capital/problem",
    "column_capital/panel_3",
)
"""Bundled jobs whose paths have detours, or whose arms could move at once."""
PROBLEMS = Path(__file__).parents[1] / "problems"


def run() -> list[dict[str, Any]]:
    """A row for each way, and one for all."""
    rows = [row for name in JOBS for row in _path_rows(name)]
    before, after = (sum(row[key] for row in rows) for key in ("before_deg", "after_deg"))
    both = [row for row in rows if row["together"]]
    slow, fast = (sum(row[key] for row in both) for key in ("before_s", "after_s"))
    note = f"travel {before:.0f} -> {after:.0f} deg ({after / before:.2f}); "
    note += f"both arms at once: {slow:.1f} -> {fast:.1f} s ({fast / max(slow, 1e-9):.2f})"
    return [*rows, {"name": "ways, all", "median_s": sum(row["median_s"] for row in rows), "note": note}]


def _path_rows(name: str) -> Iterator[dict[str, Any]]:
    """Plans a job and takes notes of each of its ways, and of those by a tree alone."""
    out: list[dict[str, Any]] = []
    result = homing._plan_motion

    def record_paths(
        scene: Scene,
        goal: Any,
        order: tuple[str, ...],
        synchronised: bool,
        reference_paths: HomeMotion | None,
    ) -> Iterator[Any]:
        start = time.process_time()
        steps = list(result(scene, goal, order, synchronised, reference_paths))
        took = time.process_time() - start
        tree, better = homing._plan_in_order(scene, goal, order), steps[-1]
        if isinstance(tree, HomeMotion) and isinstance(better, HomeMotion):
            before, after = _figures(scene, tree), _figures(scene, better)
            moves = {arm: len(path) - 1 for arm, path in better.paths.items()}
            text = (
                f"{before[0]:.0f} -> {after[0]:.0f} deg, {before[1]:.1f} -> {after[1]:.1f} s, moves {moves}"
            )
            row = {"name": f"ways, {name} {len(out) + 1}", "median_s": took, "together": better.together}
            row |= {
                "before_deg": before[0],
                "after_deg": after[0],
                "before_s": before[1],
                "after_s": after[1],
            }
            how = "at once" if better.together else "one after the other"
            out.append({**row, "note": f"{text}, {how}"})
        yield from steps

    problem: Problem = pipeline.load(PROBLEMS / f"{name}.yaml")
    jobs: list[Job[Any]] = list(registry.jobs(problem))
    with mock.patch.object(homing, "_plan_motion", record_paths):
        solve.solve(problem, [job.targets() for job in jobs])
    yield from out


def _figures(scene: Scene, paths: HomeMotion) -> tuple[float, float]:
    """Travel [deg] and time [s] of ways."""
    far = float(np.rad2deg(sum(path_travel(path) for path in paths.paths.values())))
    if paths.together:
        whole = np.concatenate([paths.paths[arm] for arm in paths.order], axis=1)
        return far, _MovingArms(scene, {}, paths.order).duration(whole)
    return far, sum(_MovingArms(scene, {}, (arm,)).duration(path) for arm, path in paths.paths.items())
