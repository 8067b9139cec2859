"""Cells that several tests of this folder use."""

from __future__ import annotations

import numpy as np

from planner.catalogue import robots
from planner.geometry.arrays import Shape, from_rpy
from planner.problem import Arm, Cell, Controller, Obstacle, Stock
from planner.tooling import Tool, plain_tool, wire_holder

BLOCK = Stock(np.array([0.16, 0.70, 0.10]), None, np.eye(3))
UP = (0.0, 0.0, 0.0)
TABLE = Obstacle("table", (Shape("box", (0.5, 0.9, 0.5), from_rpy((0.0, 0.0, 0.25), UP)),))
WIDE = np.deg2rad([120.0, 60.0, 50.0, 150.0, 100.0, 150.0])


def facing(robot: str = "irb140", half: float = 0.85) -> Cell:
    """Two arms that face each other, with wire holders and a table between them."""
    home = np.deg2rad([0.0, -10.0, 10.0, 0.0, 90.0, 0.0])
    arms = (
        Arm("left", robot, from_rpy((-half, 0.0, 0.0), UP), wire_holder("across", "start"), home),
        Arm(
            "right", robot, from_rpy((half, 0.0, 0.0), (0.0, 0.0, np.pi)), wire_holder("across", "end"), home
        ),
    )
    return Cell("facing", arms, (TABLE,), Controller())


def ball(radius: float = 0.03, out: float = 0.30) -> Tool:
    """A ball on the flange axis, whose distances to boxes are known in closed form."""
    place = from_rpy((0.0, 0.0, out), UP)
    return plain_tool("ball", place, (Shape("sphere", (radius,), place),), 0.5)


def alone(robot: str, tool: Tool | None = None, obstacles: tuple[Obstacle, ...] = ()) -> Cell:
    """One arm at the origin, at its own home: upper arm upright, forearm level."""
    arm = Arm("arm", robot, np.eye(4), tool or ball(), robots.robot(robot).home)
    return Cell("alone", (arm,), obstacles, Controller())


def random_joints(seed: int, count: int) -> dict[str, np.ndarray]:
    """``count`` rows of joints of both arms, wide of home."""
    rng = np.random.default_rng(seed)
    return {arm: rng.uniform(-WIDE, WIDE, (count, 6)) for arm in ("left", "right")}
