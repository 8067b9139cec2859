"""A job of two arms that face each other: the left one along its track, the right one about one point."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import planner
from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import to_quaternion
from tests.following_job import FOLLOWING, POSTURE
from tests.track_job import ARM, COLUMNS

ACROSS_MM = 2200.0
"""The right arm stands so far before the track, and looks at it."""
BOTH, RIGHT, LEFT = ("left", "right"), ("right",), ("left",)
"""Arms of an operation."""


def problem(
    folder: Path,
    operations: Sequence[tuple[str, Sequence[str], tuple[float, float]]],
    right: dict[str, Any] | None = None,
    count: int = 19,
    left: dict[str, Any] | None = None,
    controller: dict[str, Any] | None = None,
    obstacles: Sequence[dict[str, Any]] = (),
    scale: float = 1.0,
) -> planner.Problem:
    """Return poses at 200 mm/s for two arms.

    The left arm moves along its track between the points [mm] of an operation, the right one around a point.
    ``scale`` is the reach of the arms relative to an IRB 140.
    """
    arms = {
        "left": {**ARM, "track": FOLLOWING, **(left or {})},
        "right": {"name": "right", "robot": "irb140", "tool": {"kind": "ball_tool"}, **(right or {})},
    }
    arms["right"]["base"] = {"xyz_mm": [scale * ACROSS_MM, 0, 0], "rpy_deg": [0, 0, 180]}
    turns = {}
    for arm, half in (("left", 1.0), ("right", -1.0)):
        turn = forward_kinematics(robot(arms[arm]["robot"]), np.array([POSTURE]))[0, :3, :3]
        turns[arm] = to_quaternion(np.diag([half, half, 1.0]) @ turn)
    listed = []
    for name, own, ends in operations:
        rows = [",".join([COLUMNS[: COLUMNS.index(",feed")].replace("left", arm) for arm in own])]
        rows[0] += ",feed_mm_s,segment"
        for k, y in enumerate(np.linspace(*ends, count)):
            left_at = (500.0 + 15.0 * np.sin(y / 300.0), y / scale, 450.0 + 20.0 * np.cos(y / 200.0))
            right_at = (ACROSS_MM - 550.0, 60.0 * np.sin(k / 3.0), 650.0 + 30.0 * np.cos(k / 3.0))
            at = {"left": left_at, "right": right_at}
            values = [v for arm in own for v in (*(scale * np.array(at[arm])), *turns[arm])]
            rows.append(",".join(str(round(float(v), 9)) for v in (*values, 200.0)) + ",move")
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
        listed.append(
            {"name": name, "process": "targets", "arms": [*own], "file": f"{name}.csv", "frame": "world"}
        )
    cell: dict[str, Any] = {"name": "hall", "arms": [*arms.values()], "obstacles": [*obstacles]}
    if controller is not None:
        cell["controller"] = controller
    data = {
        "tandem": 1,
        "name": "two_arms",
        "cell": cell,
        "stock": {"size_mm": [100, 100, 50], "place": {"xyz_mm": [0, -4500, 0]}},
        "operations": listed,
    }
    (folder / "problem.yaml").write_text(yaml.safe_dump(data))
    return planner.load(folder / "problem.yaml")
