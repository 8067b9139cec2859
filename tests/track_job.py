"""A small job of an arm on a track: two operations that no single base position reaches."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import planner
from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import FloatArray, to_quaternion
from planner.pipeline import Outcome

TRACK: dict[str, Any] = {
    "axis": [0, 1, 0],
    "range_mm": [-3000, 3000],
    "unit": "TRACK_1",
    "speed_mm_s": 1000,
    "acceleration_mm_s2": 1000,
}
ARM: dict[str, Any] = {"name": "left", "robot": "irb140", "tool": {"kind": "ball_tool"}, "track": TRACK}
COLUMNS = "left.x_mm,left.y_mm,left.z_mm,left.qw,left.qx,left.qy,left.qz,feed_mm_s,segment"


def problem(
    folder: Path,
    track: dict[str, Any] | None = TRACK,
    obstacles: Any = (),
    side: float = 1200.0,
    controller: Any = None,
    count: int = 5,
    **arm: Any,
) -> planner.Problem:
    """Poses round that of home, 1.2 m to one side in operation ``a`` and to the other in ``b``."""
    one = {**ARM, **arm} if track is None else {**ARM, "track": track, **arm}
    if track is None:
        one.pop("track")
    cell: dict[str, Any] = {"name": "track", "arms": [one], "obstacles": list(obstacles)}
    if controller is not None:
        cell["controller"] = controller
    k = np.linspace(0.0, 4.0, count)
    places = {
        name: np.stack([np.full(count, 500.0), middle + 40.0 * k, 450.0 + 20.0 * np.sin(k)], axis=1)
        for name, middle in (("a", -side), ("b", side))
    }
    return write_posed_job(folder, cell, places, "irb140")


def write_posed_job(
    folder: Path, cell: dict[str, Any], points_by_operation: Mapping[str, FloatArray], kind: str
) -> planner.Problem:
    """Write a job of arm ``left``.

    Its operations go through ``points_by_operation`` {name: (N, 3) [mm]} at 50 mm/s, with the tool
    orientation of a robot of that ``kind`` at home.
    """
    w = at_home(kind)
    for name, points in points_by_operation.items():
        values = [[str(round(float(v), 9)) for v in (*point, *w, 50.0)] for point in points]
        rows = [COLUMNS, *(",".join(row) + ",move" for row in values)]
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    operations = [
        {"name": name, "process": "targets", "arms": ["left"], "file": f"{name}.csv", "frame": "world"}
        for name in points_by_operation
    ]
    stock = {"size_mm": [100, 100, 50], "place": {"xyz_mm": [0, -4500, 0]}}
    data = {"tandem": 1, "name": cell["name"], "cell": cell, "stock": stock, "operations": operations}
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(data))
    return planner.load(path)


def at_home(kind: str) -> tuple[float, ...]:
    """Return the quaternion of the flange of a robot of that ``kind`` at home."""
    arm = robot(kind)
    pose = forward_kinematics(arm, np.asarray(arm.home)[None])[0]
    return tuple(to_quaternion(pose[:3, :3]).tolist())


FOLDER = tempfile.TemporaryDirectory()
"""Where the files of the planned job lie as long as tests run."""


@functools.cache
def planned_job() -> Outcome:
    """The job, planned and proven."""
    return planner.plan(problem(Path(FOLDER.name)))


KUKA: dict[str, Any] = {"robot": "kr16_2", "base": {"xyz_mm": [0, 0, 0], "rpy_deg": [0, 0, 30]}}
"""An arm that reaches farther, and stands askew to its track."""


@functools.cache
def planned_krl_job(count: int = 5, **controller: str) -> Outcome:
    """The job for a KUKA arm, planned and proven; ``controller`` of its cell, ``count`` targets a side."""
    folder = Path(FOLDER.name) / "-".join(["krl", *controller.values()])
    folder.mkdir()
    return planner.plan(problem(folder, side=2200.0, controller=controller, count=count, **KUKA))
