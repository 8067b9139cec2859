"""Passes for the loop from level to level: round walls with power-law springback, and their files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from planner.geometry.units import MM
from planner.loops.loop_plan import FormingLevel, LoopPlan

LOADS = np.concatenate([[0.0], np.geomspace(20.0, 2400.0, 25)])


def power_plan(
    levels: int = 20,
    step: float = 1.0 * MM,
    springback: float = 5.0 * MM,
    exponent: float = 0.6,
    force: float = 600.0,
    force_exponent: float = 0.18,
    points_per_level: int = 24,
    points: int = 6,
    radius: float = 50.0 * MM,
) -> LoopPlan:
    """A wall straight down, S = ``springback`` (F / ``force``)^``exponent`` everywhere."""
    turn = 2.0 * np.pi * np.arange(points_per_level) / points_per_level
    curve = np.tile(springback * (LOADS / force) ** exponent, (points, 1))
    some = []
    for depth in step * np.arange(1, levels + 1):
        path = np.column_stack(
            [radius * np.cos(turn), radius * np.sin(turn), np.full(points_per_level, -depth)]
        )
        place = np.arange(points) * (points_per_level // points)
        some.append(
            FormingLevel(
                path, float(depth), place, np.tile(LOADS, (points, 1)), curve, np.full(points, force)
            )
        )
    return LoopPlan("wall", "d" * 64, 1, 5.0 * MM, force_exponent, tuple(some))


def file_data(plan: LoopPlan) -> dict[str, Any]:
    """A plan as its file has it."""
    levels = [
        {
            "depth_mm": level.depth / MM,
            "path_mm": (level.path / MM).tolist(),
            "points": [
                {
                    "place": int(level.path_index[k]),
                    "forces_n": level.loads[k].tolist(),
                    "springback_mm": (level.springback[k] / MM).tolist(),
                    "expected_n": float(level.force[k]),
                }
                for k in range(len(level.path_index))
            ],
        }
        for level in plan.levels
    ]
    one = {
        "name": plan.name,
        "side": plan.side,
        "ball_radius_mm": plan.radius / MM,
        "force_exponent": plan.force_exponent,
        "levels": levels,
    }
    return {"tandem_loop": 1, "problem": "wall", "digest": plan.digest, "passes": [one]}


def write(path: Path, data: dict[str, Any]) -> Path:
    path.write_text(json.dumps(data))
    return path


def forces(levels: int, points: int = 6, value: float = 500.0) -> str:
    """A file of equal forces."""
    rows = [f"{k},{p},{value}" for k in range(levels) for p in range(points)]
    return "\n".join(["level,point,force_n", *rows]) + "\n"
