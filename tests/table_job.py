"""A small job of a block on a turntable: two operations on sides that no single angle brings within reach."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import planner
from planner.geometry.arrays import from_parts, to_quaternion
from planner.pipeline import Outcome
from tests.track_job import COLUMNS

TABLE: dict[str, Any] = {
    "unit": "STN_1",
    "centre_mm": [900, 0, 200],
    "range_deg": [-180, 180],
    "speed_deg_s": 20,
    "plate": {"diameter_mm": 500, "height_mm": 200},
}
ARM: dict[str, Any] = {
    "name": "left",
    "robot": "irb140",
    "base": {"xyz_mm": [0, 0, 200]},
    "tool": {"kind": "ball_tool"},
}
STOCK: dict[str, Any] = {
    "size_mm": [600, 400, 50],
    "place": {"xyz_mm": [930, 20, 240], "rpy_deg": [0, 0, 10]},
    "support": [{"kind": "box", "size_mm": [300, 300, 40], "pose": {"xyz_mm": [0, 0, -20]}}],
}


def rows(side: float) -> str:
    """Five poses above one end of the block, in its frame, the ball's axis down."""
    out = [COLUMNS]
    down = from_parts(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    turn = to_quaternion(down[:3, :3])
    for k in range(5):
        x, y, z = side, -40.0 + 20.0 * k, 90.0 + 5.0 * np.sin(k)
        out.append(",".join(str(round(float(v), 9)) for v in (x, y, z, *turn, 50.0)) + ",move")
    return "\n".join(out) + "\n"


def problem(
    folder: Path,
    table: dict[str, Any] | None = TABLE,
    obstacles: Any = (),
    stock: dict[str, Any] = STOCK,
    arms: Any = (ARM,),
    **changes: Any,
) -> planner.Problem:
    """Poses over the block's near end in operation ``a`` and over its far end in ``b``."""
    cell: dict[str, Any] = {"name": "table", "arms": list(arms), "obstacles": list(obstacles)}
    if table is not None:
        cell["turntable"] = table
    for name, side in (("a", -280.0), ("b", 280.0)):
        (folder / f"{name}.csv").write_text(rows(side))
    operations = [
        {"name": name, "process": "targets", "arms": ["left"], "file": f"{name}.csv", "frame": "stock"}
        for name in "ab"
    ]
    data = {"tandem": 1, "name": "table", "cell": cell, "stock": stock, "operations": operations, **changes}
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
def planned_krl_job() -> Outcome:
    """The job for a KUKA arm, its table the second external axis, planned and proven."""
    folder = Path(FOLDER.name) / "krl"
    folder.mkdir()
    arms = ({**ARM, "robot": "kr16_2"},)
    return planner.plan(problem(folder, {**TABLE, "external_axis": 2}, arms=arms))
