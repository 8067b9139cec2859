"""From tips and axes to poses of the TCP and to what motion may choose: the spin about the tool."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import from_parts
from planner.milling.operation import Orient
from planner.targets import Aim, ScrewFreedom

FloatArray = NDArray[np.float64]


def poses(tip: FloatArray, axis: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) of tools whose TCP is ``tip`` (N, 3) [m] and whose z axis points out of the spindle,
    against ``axis`` (N, 3); x is as near as may be to that axis of the block that no tool comes near to."""
    reference = np.eye(3)[int(np.abs(axis).max(axis=0).argmin())]
    z = -axis
    x = reference - (z @ reference)[:, None] * z
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return from_parts(np.stack([x, np.cross(z, x), z], axis=-1), tip)


def spin(arm: str, orient: Orient, count: int) -> ScrewFreedom:
    """A whole turn about the tool's axis at each target; its x axis may aim at the robot's base, or what that
    would be worth is told."""
    twist = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    turn = np.full(count, np.pi)
    aim = Aim(arm, np.array([1.0, 0.0, 0.0]), wanted=orient == "base")
    return ScrewFreedom(f"spin_{arm}", {arm: twist}, -turn, turn, None, True, aim)
