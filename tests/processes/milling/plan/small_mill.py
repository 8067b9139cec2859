"""Small milling jobs for an IRB 4600: a twisted wall, and a pattern on a curved panel."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import yaml

from planner import pipeline
from planner.problem import Problem

MILL: dict[str, Any] = {
    "kind": "mill",
    "cutter": "cylinder",
    "diameter_mm": 12,
    "flute_mm": 50,
    "overhang_mm": 80,
    "spindle_diameter_mm": 90,
    "tilt_deg": 90,
}
CELL: dict[str, Any] = {
    "name": "one",
    "arms": [{"name": "robot", "robot": "irb4600_40", "tool": MILL, "home_deg": [0, -20, 20, 0, 40, 0]}],
    "controller": {"tasks": ["T_ROB1"], "units": ["ROB_1"]},
}
WALL: dict[str, Any] = {
    "tandem": 1,
    "name": "wall",
    "accept": ["stock.hangs"],
    "cell": CELL,
    "stock": {"size_mm": [120, 80, 50], "place": {"xyz_mm": [1300, 0, 800]}},
    "part": {
        "ruled": [
            {
                "name": "wall",
                "start": {"bspline_mm": [[-60, 0, 12], [-20, 10, 12], [20, -8, 12], [60, 0, 12]]},
                "end": {"bspline_mm": [[-60, 2, 50], [-20, -4, 50], [20, 6, 50], [60, -2, 50]]},
            }
        ],
        "in_stock": {},
    },
    "settings": {"clearance_mm": 5},
    "operations": [
        {
            "name": "mill",
            "process": "milling",
            "arms": ["robot"],
            "feed_mm_s": 30,
            "spin_up_s": 1,
            "spin_down_s": 1,
            "cuts": [{"flank": "wall"}],
        }
    ],
}
BALL: dict[str, Any] = {**MILL, "cutter": "ball", "diameter_mm": 6, "flute_mm": 12, "overhang_mm": 60}
PANEL: dict[str, Any] = {
    **WALL,
    "name": "panel",
    "stock": {"size_mm": [120, 80, 30], "place": {"xyz_mm": [1300, 0, 800]}},
    "part": {
        "front": {
            "loft": {
                "rail": {"radius_mm": 300, "start_deg": -9, "end_deg": 9},
                "profiles": [
                    {"at": 0.0, "bezier_mm": [[0, -30], [6, -10], [6, 10], [0, 30]]},
                    {"at": 1.0, "bezier_mm": [[0, -30], [6, -10], [6, 10], [0, 30]]},
                ],
            }
        }
    },
}


def write(folder: Path, base: dict[str, Any], tool: dict[str, Any] | None = None, **fields: Any) -> Path:
    """A problem file: ``fields`` replace those of its operation, ``tool`` those of the tool, and fields with
    ``part``, ``stock`` or ``settings`` as their names those of the problem."""
    data = copy.deepcopy(base)
    for name in ("part", "stock", "settings"):
        if name in fields:
            data[name] = fields.pop(name)
    data["operations"][0].update(fields)
    if tool is not None:
        data["cell"]["arms"][0]["tool"] = {**data["cell"]["arms"][0]["tool"], **tool}
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def problem(folder: Path, base: dict[str, Any], tool: dict[str, Any] | None = None, **fields: Any) -> Problem:
    """The problem of :func:`write`, read."""
    return pipeline.load(write(folder, base, tool, **fields))
