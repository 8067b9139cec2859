"""The joint solution that confdata alone select, as the controller does: branch by cfx, quadrants of axes 1,
4 and 6.

Quadrant n covers n * 90 to (n + 1) * 90 degrees (ABB, Technical reference manual RAPID, confdata), so a
value also fixes the whole turns of an axis that turns more than once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.verify.arm_ik import TURN, branch_of, solve
from planner.verify.machines import Machine

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

QUADRANT = 0.5 * np.pi
_AXES = (0, 3, 5)
TOLERANCE = np.deg2rad(0.01)
"""How far past a quadrant's border an axis may be: rounded targets put an axis at exactly 90 degrees on
either side."""


def quadrants(q: FloatArray) -> IntArray:
    """cf1, cf4, cf6 (..., 3) of serial joint angles (..., 6)."""
    return np.floor(q[..., _AXES] / QUADRANT).astype(np.int64)


def select(machine: Machine, flange: FloatArray, conf: IntArray) -> FloatArray:
    """Joint angles (B, 6) that confdata (B, 4) select at flange poses (B, 4, 4) in the base; NaN where they
    select none."""
    q = solve(machine, flange, conf[:, 3])
    for column, axis in enumerate(_AXES):
        middle = (conf[:, column] + 0.5) * QUADRANT
        q[:, axis] += TURN * np.round((middle - q[:, axis]) / TURN)
        off = np.abs(q[:, axis] - middle) > 0.5 * QUADRANT + TOLERANCE
        q[off] = np.nan
    q[(conf[:, 3] < 0) | (conf[:, 3] > 7)] = np.nan
    return q


def fits(machine: Machine, q: FloatArray, conf: IntArray) -> NDArray[np.bool_]:
    """Whether confdata (B, 4) are the true ones of joint angles (B, 6), within ``TOLERANCE`` of a quadrant's
    border."""
    middle = (conf[:, :3] + 0.5) * QUADRANT
    quadrant = np.all(np.abs(q[:, _AXES] - middle) <= 0.5 * QUADRANT + TOLERANCE, axis=-1)
    return np.asarray(quadrant & (branch_of(machine, q) == conf[:, 3]))
