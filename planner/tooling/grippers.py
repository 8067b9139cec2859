"""Tools that hold a block of foam by its bottom face: a plate with needles, and a vacuum cup."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.rigid import from_rpy
from planner.geometry.shapes import Shape
from planner.tooling.base import OnFlange

PLATE: Final = 0.012
"""[m] thickness of the plate that lies on the foam."""
LINE_DENSITY: Final = 2700.0
"""[kg/m^3] of aluminium."""
NEEDLE_PRESSURE: Final = 8e3
"""[Pa] what slanted needles hold per area of their plate in foam, assumed."""
SUCTION: Final = 25e3
"""[Pa] below the air's pressure under a cup on foam, which leaks, assumed."""
HEAD_MASS: Final = 0.25
"""[kg] flange plate and needle drive or suction unit, assumed."""


@dataclasses.dataclass(frozen=True)
class Gripper(OnFlange):
    """A tool that holds a block by its bottom face: ``footprint``, width and depth [m] of the face that does,
    centred on the TCP in its x and y, and ``holding``, the force [N] it holds with."""

    footprint: tuple[float, float]
    holding: float


def gripper_plate(
    width: float, depth: float, reach: float = 0.080, holding: float | None = None, name: str | None = None
) -> Gripper:
    """A plate ``width`` x ``depth`` [m] with slanted needles that holds a block by its bottom face, with the
    force ``holding`` [N] or what its area gives.

    The TCP is the middle of the plate's face, ``reach`` [m] from the flange; z points into the block, x along
    the width. Raises ``ValueError`` for sizes that make no gripper.
    """
    if not (0.02 <= width <= 2.0 and 0.02 <= depth <= 2.0 and 0.03 <= reach <= 0.5):
        raise ValueError(
            f"a gripper plate of {width * 1e3:g} x {depth * 1e3:g} mm at {reach * 1e3:g} mm; the plate goes "
            "from 20 to 2000 mm, its distance from the flange from 30 to 500 mm"
        )
    shapes = (
        _flange(),
        Shape("box", (0.050, 0.050, reach - PLATE), from_rpy((0.0, 0.0, 0.5 * (reach - PLATE)), (0, 0, 0))),
        Shape("box", (width, depth, PLATE), from_rpy((0.0, 0.0, reach - 0.5 * PLATE), (0.0, 0.0, 0.0))),
    )
    plate = LINE_DENSITY * width * depth * PLATE
    force = NEEDLE_PRESSURE * width * depth if holding is None else holding
    return _tool(name or "gripper_plate", reach, shapes, plate, (width, depth), force)


def vacuum_cup(
    radius: float, reach: float = 0.080, holding: float | None = None, name: str | None = None
) -> Gripper:
    """A suction cup of ``radius`` [m] with its TCP in the middle of the lip, ``reach`` [m] from the flange,
    that holds with the force ``holding`` [N] or what its area gives.

    z points into the block. Raises ``ValueError`` for sizes that make no cup.
    """
    if not (0.01 <= radius <= 0.5 and 0.03 <= reach <= 0.5):
        raise ValueError(
            f"a cup of radius {radius * 1e3:g} mm at {reach * 1e3:g} mm; the radius goes from 10 to 500 mm, "
            "its distance from the flange from 30 to 500 mm"
        )
    shapes = (
        _flange(),
        Shape("cylinder", (0.020, reach - PLATE), from_rpy((0.0, 0.0, 0.5 * (reach - PLATE)), (0, 0, 0))),
        Shape("cylinder", (radius, PLATE), from_rpy((0.0, 0.0, reach - 0.5 * PLATE), (0.0, 0.0, 0.0))),
    )
    plate = 0.5 * LINE_DENSITY * np.pi * radius**2 * PLATE
    force = SUCTION * np.pi * radius**2 if holding is None else holding
    return _tool(name or "vacuum_cup", reach, shapes, plate, (2.0 * radius, 2.0 * radius), float(force))


def _flange() -> Shape:
    return Shape("cylinder", (0.034, 0.010), from_rpy((0.0, 0.0, 0.005), (0.0, 0.0, 0.0)))


def _tool(
    name: str,
    reach: float,
    shapes: tuple[Shape, ...],
    plate: float,
    footprint: tuple[float, float],
    holding: float,
) -> Gripper:
    mass = HEAD_MASS + plate
    return Gripper(
        name=name,
        tcp=from_rpy((0.0, 0.0, reach), (0.0, 0.0, 0.0)),
        mass=round(float(mass), 3),
        cog=np.array([0.0, 0.0, round(float((HEAD_MASS * 0.03 + plate * (reach - 0.006)) / mass), 6)]),
        shapes=shapes,
        footprint=footprint,
        holding=holding,
    )
