"""Blocks, bows and ruled parts for tests of the straight wire."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from planner.geometry.arrays import RuledSurface
from planner.problem import Arm, Cell, Controller, Part, Setup, Stock
from planner.processes.hotwire.plan.operation import Straight
from planner.tooling import bow, gripper_plate, wire_holder
from tests.processes.hotwire.plan import foam_blocks as blocks

SIZE = (0.30, 0.20, 0.10)


def stock(size: tuple[float, float, float] = SIZE, **more: Any) -> Stock:
    """A level block."""
    return Stock(np.array(size), None, np.eye(3), **more)


def setup(block: Stock | None = None, span: float = 0.4, throat: float = 0.4, plate: float = 0.08) -> Setup:
    """A cell whose left arm has a bow and whose right arm has a gripper; ``spare`` has neither."""
    tools = {"left": bow(span, throat), "right": gripper_plate(plate, plate), "spare": wire_holder()}
    arms = tuple(Arm(n, "irb140", np.eye(4), tool, np.zeros(6)) for n, tool in tools.items())
    return Setup(1, Cell("test", arms, (), Controller()), block or stock(), (0,))


def operation(**more: Any) -> Straight:
    """An operation, by default with a slot of 1.5 mm."""
    base: dict[str, Any] = {"name": "shape", "process": "straight_wire", "arms": ["left"]}
    heat = {} if "power_w" in more else {"kerf_mm": 1.5}
    return Straight.model_validate_json(json.dumps(base | heat | more), strict=True)


def prism(
    name: str,
    points: list[tuple[float, float]] | np.ndarray,
    y: tuple[float, float] = (-0.1, 0.1),
    corner: np.ndarray | bool = True,
    **more: Any,
) -> RuledSurface:
    """Rulings along y through points [x, z], outward to the left of the way in x and z seen against y."""
    xz = np.asarray(points, dtype=np.float64)
    start = np.column_stack([xz[:, 0], np.full(len(xz), y[0]), xz[:, 1]])
    end = start.copy()
    end[:, 1] = y[1]
    return RuledSurface(name, start, end, np.broadcast_to(corner, len(xz)).copy(), **more)


def part(*ruled: RuledSurface) -> Part:
    """A part of ruled surfaces alone."""
    return Part(ruled=ruled)


def twisted() -> Part:
    """A strip whose rulings turn by 25 degrees within 6 mm, about their middles."""
    x = np.concatenate([np.linspace(-0.1, -0.003, 30), np.linspace(0.003, 0.1, 30)])
    turn = np.deg2rad(12.5) * np.clip(x / 0.003, -1.0, 1.0)
    half = np.stack([0.1 * np.sin(turn), -0.1 * np.cos(turn), 0.0 * x], axis=1)
    middle = np.stack([x + 0.04 * np.sign(x), 0.0 * x, np.full_like(x, 0.06)], axis=1)
    middle[:, 0] = np.clip(x, -0.1, 0.1)
    return blocks.part(RuledSurface("fan", middle + half, middle - half, np.zeros(len(x), dtype=np.bool_)))
