"""RAPID's confdata of planned joints: which of the arm's postures a target means.

cf1, cf4, cf6 are the quadrants of axes 1, 4 and 6, floor(angle / 90 deg); cfx = 4 * (wrist centre behind
axis 1) + 2 * (wrist centre behind the lower arm) + (axis 5 negative). Source: ABB, Technical reference
manual RAPID Instructions, Functions and Data types, 3HAC16581-1, data type confdata.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_DEGREE_DECIMALS = 4


def confdata(robot: RobotData, q: FloatArray) -> IntArray:
    """(..., 4) cf1, cf4, cf6, cfx of serial joint angles q (..., 6) [rad].

    Angles are rounded to 0.0001 deg first, about what the rounding of a written target moves an axis by, so
    that an axis on the border of two quadrants gets one number and not the noise of its last digits.
    """
    degrees = np.round(np.rad2deg(robot.to_controller(q)), _DEGREE_DECIMALS)
    out = np.empty((*q.shape[:-1], 4), dtype=np.int64)
    out[..., :3] = np.floor(degrees[..., [0, 3, 5]] / 90.0)
    out[..., 3] = posture(robot, q)
    return out


def posture(robot: RobotData, q: FloatArray) -> IntArray:
    """cfx (...,) of serial joint angles q (..., 6) [rad]."""
    p = robot.opw
    theta = p.signs * q - p.offsets
    lower, elbow = theta[..., 1], theta[..., 2]
    # the wrist centre as the lower arm sees it, and its distance in front of axis 1
    across = p.a2 * np.cos(elbow) + p.c3 * np.sin(elbow)
    ahead = (
        p.a1 + (p.c2 + p.c3 * np.cos(elbow) - p.a2 * np.sin(elbow)) * np.sin(lower) + across * np.cos(lower)
    )
    negative = np.round(np.rad2deg(q[..., 4]), _DEGREE_DECIMALS) < 0.0
    return np.asarray(4 * (ahead < 0.0) + 2 * (across < 0.0) + negative, dtype=np.int64)
