"""Small scenes for the motion tests."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bench.motion_jobs import HOME, arc_wire, block, s_curve, two_arms
from planner.cell import plant
from planner.geometry.arrays import FloatArray, Shape, from_parts
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import select_targets
from planner.problem import Obstacle, Problem, Settings
from planner.targets import Targets

HIGH = from_parts(np.eye(3), np.array([0.0, 0.0, 0.5]))
SIZE = (0.16, 0.7, 0.1)

__all__ = [
    "HIGH",
    "HOME",
    "SIZE",
    "arc_wire",
    "block",
    "box",
    "one_arm",
    "pair",
    "problem",
    "s_curve",
    "two_arms",
]


def box(name: str, size: tuple[float, float, float], centre: tuple[float, float, float]) -> Obstacle:
    """Return a box at a fixed pose in the world."""
    return Obstacle(name, (Shape("box", size, from_parts(np.eye(3), np.array(centre))),))


def pair(
    count: int = 60, obstacles: tuple[Obstacle, ...] = (), solid: bool = True, stock: FloatArray = HIGH
) -> tuple[Scene, Targets]:
    """Return two arms with an arc of wire and every n-th target of the whole sweep."""
    cell, targets = two_arms(obstacles=obstacles), arc_wire(count)
    model = plant.build_cell_model(cell, block(SIZE, stock), stock) if solid else None
    return Scene.of(cell, targets.arms, stock, Settings(), model), targets


def one_arm(count: int = 40, settings: Settings | None = None) -> tuple[Scene, Targets]:
    """One arm on an S-curve, without anything around."""
    cell, targets = s_curve(400)
    rows = np.linspace(0, 399, count).round().astype(np.intp)
    few = select_targets(targets, rows)
    points = few.pose["arm"][:, :3, 3]
    travel = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1))
    few = dataclasses.replace(few, travel=travel)
    return Scene.of(cell, few.arms, np.eye(4), settings or Settings()), few


def problem(
    cell, targets: Targets, stock_pose: np.ndarray | None, settings: Settings | None = None
) -> Problem:  # type: ignore[no-untyped-def]
    operation = SimpleNamespace(name="faces", process="elastic_wire", arms=targets.arms, leaves=lambda b: b)
    return Problem(
        "job",
        cell,
        block(SIZE, stock_pose),
        None,
        (operation,),
        settings or Settings(),
        Path("job.yaml"),
        "0",
    )
