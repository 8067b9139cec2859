"""A dish of 80 mm with a hole in its wall and a sump in its floor, formed in two stages by one IRB 140."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.geometry.units import MM
from planner.problem import Problem
from tests.processes.forming.plan.shapes import revolved
from tests.processes.trim.plan.small_trim import data
from tests.small_forming import write

DEPTHS = (8.0, 3.0)
"""Depths [mm] of the dish and of the sump below it."""
HOLE: dict[str, Any] = {"name": "hole", "circle": {"at_mm": [36, 0], "diameter_mm": 5}}
BALL = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
FORM: dict[str, Any] = {"process": "forming", "arms": ["robot"], "mode": "spif", "stepdown_mm": 2}
SUMP_RADIUS = 16.0
"""Radius [mm] in plan at which the sump begins."""


def wall(start_radius: float, depth: float, angle: float, fillet: float) -> list[tuple[float, float]]:
    """Radius and height [mm] of a wall of one angle [deg] that begins at a radius, rounded at both edges."""
    a = np.deg2rad(angle)
    turn = np.linspace(0.0, a, 13)
    top = [(start_radius - fillet * np.sin(t), fillet * (np.cos(t) - 1.0)) for t in turn]
    run = (depth - 2.0 * fillet * (1.0 - np.cos(a))) / np.tan(a)
    end = start_radius - 2.0 * fillet * np.sin(a) - run
    low = [(end + fillet * np.sin(t), fillet * (1.0 - np.cos(t)) - depth) for t in turn[::-1]]
    between = [
        tuple((1.0 - s) * np.array(top[-1]) + s * np.array(low[0])) for s in np.linspace(0, 1, 6)[1:-1]
    ]
    return [(float(r), float(z)) for r, z in (*top, *between, *low)]


def part() -> Mesh:
    """The part [m]."""
    dish, sump = wall(42.0, DEPTHS[0], 35.0, 7.0), wall(SUMP_RADIUS, DEPTHS[1], 25.0, 8.0)
    sunk = [(r, z - DEPTHS[0]) for r, z in sump]
    floor = [(fraction * sunk[-1][0], sunk[-1][1]) for fraction in (0.5, 0.0)]
    flat = [(r, -DEPTHS[0]) for r in (22.0, 19.0)]
    profile = [(48.0, 0.0), *dish, *flat, *sunk, *floor]
    return revolved([(r * MM, z * MM) for r, z in profile], 96)


def problem(
    folder: Path,
    hole: dict[str, Any] = HOLE,
    first: dict[str, Any] | None = None,
    second: dict[str, Any] | None = None,
    cut: dict[str, Any] | None = None,
) -> Problem:
    """The problem, read: dish, hole, sump; ``first``, ``second`` and ``cut`` are fields of operations."""
    whole = data(outlines=[copy.deepcopy(hole)])
    (trim,) = whole["operations"]
    torch = whole["cell"]["arms"][0]["tool"]
    whole["cell"]["arms"][0]["tool"] = BALL
    whole["sheet"] |= {"opening_mm": 130, "size_mm": [180, 180]}
    whole["accept"] = ["forming.force"]
    whole["operations"] = [
        {"name": "dish", **FORM, "features": [1], **(first or {})},
        {**trim, **(cut or {}), "setup": {"tools": {"robot": torch}}},
        {"name": "sump", **FORM, "features": [2], "stepdown_mm": 1, **(second or {})}
        | {"setup": {"tools": {"robot": BALL}}},
    ]
    for operation in whole["operations"]:
        for name in [name for name, value in operation.items() if value is None]:
            del operation[name]
    return pipeline.load(write(folder, whole, part()))
