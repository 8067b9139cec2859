"""A small job of an arm on a gantry, a bridge with a lift.

It has two operations that no single value of either axis reaches.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import planner
from planner.pipeline import Outcome
from tests.track_job import write_posed_job

BRIDGE: dict[str, Any] = {
    "name": "bridge",
    "axis": [0, 1, 0],
    "range_mm": [-1500, 1500],
    "unit": "GANTRY_1",
    "speed_mm_s": 1000,
    "acceleration_mm_s2": 1000,
    "carries": ["column"],
}
LIFT: dict[str, Any] = {
    "name": "lift",
    "axis": [0, 0, 1],
    "range_mm": [-300, 900],
    "unit": "GANTRY_1",
    "speed_mm_s": 500,
    "acceleration_mm_s2": 500,
    "carries": ["console"],
}
RAILS = {
    "name": "rails",
    "shapes": [{"kind": "box", "size_mm": [300, 4000, 100], "pose": {"xyz_mm": [-700, 0, 50]}}],
}
COLUMN = {
    "name": "column",
    "shapes": [{"kind": "box", "size_mm": [200, 300, 2600], "pose": {"xyz_mm": [-700, 0, 1401]}}],
}
CONSOLE = {
    "name": "console",
    "shapes": [{"kind": "box", "size_mm": [799, 300, 100], "pose": {"xyz_mm": [-200, 0, 949]}}],
}
ARM: dict[str, Any] = {
    "name": "left",
    "robot": "irb140",
    "tool": {"kind": "ball_tool"},
    "base": {"xyz_mm": [0, 0, 1000]},
    "axes": [BRIDGE, LIFT],
}


def problem(
    folder: Path,
    axes: Any = (BRIDGE, LIFT),
    obstacles: Any = (RAILS, COLUMN, CONSOLE),
    rise: float = 700.0,
    controller: Any = None,
    **arm: Any,
) -> planner.Problem:
    """Poses to the one side in operation ``a``, and to the other, higher by ``rise`` [mm], in ``b``."""
    one = {**ARM, "axes": None if axes is None else list(axes), **arm}
    cell: dict[str, Any] = {"name": "gantry", "arms": [one], "obstacles": list(obstacles)}
    if controller is not None:
        cell["controller"] = controller
    k = np.linspace(0.0, 4.0, 5)
    places = {
        name: np.stack([np.full(5, 500.0), side + 40.0 * k, 1350.0 + up + 20.0 * np.sin(k)], axis=1)
        for name, side, up in (("a", -1200.0, 0.0), ("b", 1200.0, rise))
    }
    return write_posed_job(folder, cell, places, str(one["robot"]))


KUKA: dict[str, Any] = {"robot": "kr6_r900", "base": {"xyz_mm": [0, 0, 1000], "rpy_deg": [0, 0, 30]}}
"""An arm that stands askew to its axes."""


def write_problem(folder: Path, **arm: Any) -> Path:
    """The problem's file."""
    problem(folder, **arm)
    return folder / "problem.yaml"


FOLDER = tempfile.TemporaryDirectory()
"""Where the files of the planned job lie as long as tests run."""


@functools.cache
def planned_job() -> Outcome:
    """The job, planned and proven."""
    return planner.plan(problem(Path(FOLDER.name)))


@functools.cache
def planned_krl_job(**controller: str) -> Outcome:
    """The job for a KUKA arm, planned and proven; ``controller`` of its cell."""
    folder = Path(FOLDER.name) / "-".join(["krl", *controller.values()])
    folder.mkdir()
    return planner.plan(problem(folder, controller=controller or None, **KUKA))
