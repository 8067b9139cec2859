"""Status and turn of KUKA's arms: which of its postures a PTP to a pose means.

S bit 0 (1): the wrist's centre lies behind axis 1. Bit 1 (2): axis 3 is bent to the positive side of the
posture in which shoulder, elbow and wrist's centre are in line. Bit 2 (4): axis 5 is negative. T bit i - 1:
axis i is negative. Sources: KUKA's expert programming manual as cited in a forum (bit 0); points taught on
real robots (bits 1, 2).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DEGREE_DECIMALS: Final = 4
"""Joints are rounded so before they are looked at, so that one on a border is not settled by noise."""
TURN_IGNORED: Final = np.deg2rad(2.0)
"""A controller may leave the turn bit of an axis so near to zero alone [rad]."""


def status(robot: RobotData, q: FloatArray) -> IntArray:
    """S (...,) of serial joint angles q (..., 6) [rad]."""
    rounded = _rounded(robot, q)
    p = robot.opw
    theta = p.signs * robot.from_controller(rounded) - p.offsets
    upper, elbow = theta[..., 1], theta[..., 2]
    across = p.a2 * np.cos(elbow) + p.c3 * np.sin(elbow)
    along = p.c2 + p.c3 * np.cos(elbow) - p.a2 * np.sin(elbow)
    ahead = p.a1 + along * np.sin(upper) + across * np.cos(upper)
    return np.asarray((ahead < 0.0) + 2 * (across >= 0.0) + 4 * (rounded[..., 4] < 0.0), dtype=np.int64)


def turn(robot: RobotData, q: FloatArray) -> IntArray:
    """T (...,) of serial joint angles q (..., 6) [rad]."""
    return np.asarray((_rounded(robot, q) < 0.0) @ (1 << np.arange(6)), dtype=np.int64)


def near_zero(robot: RobotData, q: FloatArray) -> IntArray:
    """Axes, from 1, of joints (6,) [rad] whose turn bit a controller may leave alone."""
    return np.flatnonzero(np.abs(robot.to_controller(q)) <= TURN_IGNORED) + 1


def _rounded(robot: RobotData, q: FloatArray) -> FloatArray:
    """The controller's joints (..., 6) [rad], rounded."""
    return np.deg2rad(np.round(np.rad2deg(robot.to_controller(q)), DEGREE_DECIMALS))
