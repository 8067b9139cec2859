"""The wire holder: a sliding clamp that holds one end of an elastic wire."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts, from_rpy
from planner.geometry.shapes import Shape
from planner.tooling.base import OnFlange

FloatArray = NDArray[np.float64]
Mounting = Literal["along", "across", "diagonal"]
Side = Literal["start", "end"]

TILT_DEG: Final[dict[Mounting, float]] = {"along": 0.0, "diagonal": 45.0, "across": 90.0}
REACH: Final[dict[Mounting, float]] = {"along": 0.120, "diagonal": 0.110, "across": 0.100}
"""Distance [m] of the TCP from the flange's face, on the flange axis, with the slide at zero."""

HOLDER_MASS: Final = 0.6
"""[kg], assumed: an aluminium plate and post, a ceramic block and a brass clamp of the sizes below."""


@dataclasses.dataclass(frozen=True)
class WireHolder(OnFlange):
    """A holder for the ``side`` end of a wire, which leaves it as the ``mounting`` says; ``slide`` [m]: how
    far its clamp is moved outward."""

    mounting: Mounting
    side: Side
    slide: float


def wire_holder(
    mounting: Mounting = "across",
    side: Side = "start",
    slide: float = 0.0,
    reach: float | None = None,
    plate_radius: float = 0.034,
    mass: float = HOLDER_MASS,
    name: str | None = None,
) -> WireHolder:
    """A holder for one end of a wire: flange plate, post, insulated slide block, clamp.

    The TCP is where the wire leaves the clamp. Its x axis is the wire's tangent from the start arm to the
    end arm, so it points out of the start arm's holder and into the end arm's. The wire leaves along the
    flange's z axis ("along"), along its -x axis ("across"), or between the two ("diagonal"): with two arms
    that face each other, forearms level and ("across") hands down, axis 6 is then near zero on both. The
    TCP's y axis points from the wire back to the flange ("across") or along the flange's -x ("along"),
    which is up in these postures; z = x cross y.

    ``slide`` [m] moves the clamp and the TCP outward along the wire; ``reach`` [m] replaces the TCP's
    distance from the flange. Raises ``KeyError`` for another mounting and ``ValueError`` for another side,
    or sizes that do not fit.
    """
    if side not in ("start", "end"):
        raise ValueError(f"side is {side!r}; it must be 'start' or 'end'")
    distance = REACH[mounting] if reach is None else reach
    if not distance >= 0.080:
        raise ValueError(f"reach is {distance * 1e3:g} mm; the holder needs at least 80 mm")
    if not 0.0 <= slide <= 0.040:
        raise ValueError(f"slide is {slide * 1e3:g} mm; the clamp moves from 0 to 40 mm")
    tilt = np.deg2rad(TILT_DEG[mounting])
    out = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
    up = np.array([-np.cos(tilt), 0.0, -np.sin(tilt)])
    tangent = out if side == "start" else -out
    turn = np.stack([tangent, up, np.cross(tangent, up)], axis=-1).round(15) + 0.0
    corner = np.array([0.0, 0.0, distance])
    along = np.stack([np.cross(up, out), up, out], axis=-1)
    clamp = 0.028 + slide
    block = corner - 0.046 * out
    post = 0.72 * block[0]
    shapes = (
        Shape("cylinder", (plate_radius, 0.010), from_rpy((0.0, 0.0, 0.005), (0.0, 0.0, 0.0))),
        Shape(
            "box",
            (0.026, 0.034, block[2] - 0.010),
            from_rpy((post, 0.0, (block[2] + 0.010) / 2), (0.0, 0.0, 0.0)),
        ),
        Shape("box", (0.036, 0.036, 0.040), from_parts(along, block)),
        Shape("cylinder", (0.008, clamp), from_parts(along, corner + (slide - 0.5 * clamp) * out)),
    )
    return WireHolder(
        name=name or f"wire_holder_{mounting}_{side}",
        tcp=from_parts(turn, corner + slide * out),
        mass=mass,
        cog=np.array([0.45 * block[0], 0.0, 0.45 * distance]),
        shapes=shapes,
        mounting=mounting,
        side=side,
        slide=slide,
    )
