"""A small job of an arm with a coordinated track.

It has a row of poses four times as long as the arm reaches, and a shorter row on the way back.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import planner
from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import to_quaternion
from planner.pipeline import Outcome
from tests.track_job import ARM, COLUMNS, KUKA, TRACK

FOLLOWING: dict[str, Any] = {**TRACK, "range_mm": [-1500, 1500], "follow": 1.0}
POSTURE = (0.0, 0.0, 0.0, 0.0, 0.9, 0.0)
"""The tool is turned as in this one [rad], with axis 5 bent."""
SIDE_MM = 1800.0
"""The row goes so far to either side."""


def problem(
    folder: Path,
    track: dict[str, Any] | None = None,
    obstacles: Any = (),
    count: int = 61,
    sway: float = 1.0,
    depth: float = 500.0,
    controller: Any = None,
    **arm: Any,
) -> planner.Problem:
    """Poses at 200 mm/s along y, so deep [mm] before the track, which sway a little."""
    one = {**ARM, "track": FOLLOWING if track is None else track, **arm}
    turn = to_quaternion(forward_kinematics(robot("irb140"), np.array([POSTURE]))[0, :3, :3])
    for name, ends, number in (("row", (-SIDE_MM, SIDE_MM), count), ("back", (1000.0, 400.0), 11)):
        rows = [COLUMNS]
        for y in np.linspace(*ends, number):
            place = (depth + sway * 15.0 * np.sin(y / 300.0), y, 450.0 + sway * 20.0 * np.cos(y / 200.0))
            rows.append(",".join(str(round(float(v), 9)) for v in (*place, *turn, 200.0)) + ",move")
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
    operations = [
        {"name": name, "process": "targets", "arms": ["left"], "file": f"{name}.csv", "frame": "world"}
        for name in ("row", "back")
    ]
    cell: dict[str, Any] = {"name": "track", "arms": [one], "obstacles": list(obstacles)}
    if controller is not None:
        cell["controller"] = controller
    data = {
        "tandem": 1,
        "name": "row",
        "cell": cell,
        "stock": {"size_mm": [100, 100, 50], "place": {"xyz_mm": [0, -4500, 0]}},
        "operations": operations,
    }
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(data))
    return planner.load(path)


FOLDER = tempfile.TemporaryDirectory()
"""Where the files of the planned job lie as long as tests run."""


@functools.cache
def planned_job() -> Outcome:
    """The job, planned and proven."""
    return planner.plan(problem(Path(FOLDER.name)))


@functools.cache
def planned_krl_job(**controller: str) -> Outcome:
    """The job for a KUKA arm that is askew to its track, planned and proven; ``controller`` of its cell."""
    folder = Path(FOLDER.name) / "-".join(["krl", *controller.values()])
    folder.mkdir()
    return planner.plan(problem(folder, depth=1000.0, controller=controller or None, **KUKA))
