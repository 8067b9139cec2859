"""Small panels for tests of the bent wire: an arch, a wave, a saddle, each in a block."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from planner.problem import Cell, Controller, Part, Setup, Stock
from planner.processes.hotwire.plan.operation import ElasticWire
from planner.reading.part import PartFile, build_part

ARCH = ((-70.0, 0.0), (-25.0, 21.0), (25.0, 21.0), (70.0, 0.0))
LEVEL = np.eye(3)


def loft(profile: tuple[tuple[float, float], ...], rises: tuple[float, ...] = (0.0, 0.0)) -> dict[str, Any]:
    """A loft of one profile [x, z] over y from -100 to 100, lifted by ``rises``, in mm."""
    at = np.linspace(0.0, 1.0, len(rises))
    sections = [
        {"at": float(a), "bezier_mm": [[x, -100.0 + 200.0 * float(a), z + rise] for x, z in profile]}
        for a, rise in zip(at, rises, strict=True)
    ]
    return {"loft": {"sections": sections, "flip": True, "chord_mm": 0.01}}


def stock(attitude: np.ndarray = LEVEL, size: tuple[float, float, float] = (0.16, 0.23, 0.10)) -> Stock:
    """A block."""
    return Stock(np.array(size), None, attitude)


def setup(block: Stock | None = None) -> Setup:
    """A block in a cell without arms, which a process does not look at."""
    return Setup(1, Cell("none", (), (), Controller()), block or stock(), (0,))


def part(front: dict[str, Any] | None = None, back: float | None = 15.0, block: Stock | None = None) -> Part:
    """Return a part placed in the block."""
    spec: dict[str, Any] = {"front": front or loft(ARCH)}
    if back is not None:
        spec["back"] = {"offset_mm": back}
    return build_part(PartFile.model_validate(spec), Path(), block or stock())


def operation(wire: dict[str, Any] | None = None, **more: Any) -> ElasticWire:
    """An operation with a steel wire of 1.5 mm."""
    steel = {"material": "spring_steel", "diameter_mm": 1.5, "length_mm": 520, "temperature_c": 300}
    base = {
        "name": "faces",
        "process": "elastic_wire",
        "arms": ("left", "right"),
        "wire": wire or steel,
        "kerf_mm": 2.4,
        "sweep": "y",
        "step_mm": 5,
    }
    return ElasticWire.model_validate(base | more)
