"""From centres and axes of forming tools to poses and to what motion may choose: spin, and tilt in a cone."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts
from planner.targets import ScrewFreedom

FloatArray = NDArray[np.float64]

ALIGNED: Final = 0.95
"""Cosine beyond which the sheet's x axis is too near to a tool's axis to fix its spin by."""


def poses(centre: FloatArray, axis: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) in the sheet's frame of tools whose z axis is ``axis`` (N, 3) and whose TCP is
    ``centre`` (N, 3) [m]; x as near to the sheet's x as may be, so that it turns no more than it must."""
    reference = np.array([1.0, 0.0, 0.0])
    if np.abs(axis @ reference).max() > ALIGNED:
        reference = np.array([0.0, 1.0, 0.0])
    x = reference - (axis @ reference)[:, None] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return from_parts(np.stack([x, np.cross(axis, x), axis], axis=-1), centre)


def freedoms(arms: tuple[str, ...], cone: float, count: int) -> tuple[ScrewFreedom, ...]:
    """Spin of every tool about its axis, and tilts about its x and y that stay within a cone of half angle
    ``cone`` [rad]: the square of tilts within the circle. All turn about the ball's centre, which never
    moves."""
    out = []
    tilt = np.full(count, cone / np.sqrt(2.0))
    turn = np.full(count, np.pi)
    for arm in arms:
        if cone > 0.0:
            for name, k in (("tilt_x", 0), ("tilt_y", 1)):
                twist = np.zeros(6)
                twist[k] = 1.0
                out.append(ScrewFreedom(f"{name}_{arm}", {arm: twist}, -tilt, tilt))
        twist = np.zeros(6)
        twist[2] = 1.0
        out.append(ScrewFreedom(f"spin_{arm}", {arm: twist}, -turn, turn, None, True))
    return tuple(out)
