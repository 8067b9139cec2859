"""How fast a PTP may be: whole percents of the axes' speeds at which the TCP keeps its limit."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData
from planner.cell.robots import forward

FloatArray = NDArray[np.float64]

UNKNOWN: Final = 10
"""Percents of a PTP from a place that is not known: the first one of a program."""
_SAMPLES: Final = 400
_SAFE: Final = 0.99


def percent(
    robot: RobotData, start: FloatArray, end: FloatArray, tcp: FloatArray, limit: float, most: float
) -> int:
    """Percents of a PTP between joints (6,) [rad] with the TCP ``tcp`` (4, 4) on the flange.

    The slowest axis runs at its share of the catalogue's speed and the others keep pace, so at the share p
    the TCP's speed is p times what it is at full speed: at most ``limit`` [m/s]. ``most`` [-]: the
    largest share. At least 1.
    """
    q = start + np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None] * (end - start)
    point = (forward(robot, q) @ tcp)[:, :3, 3]
    fastest = float(np.linalg.norm(np.diff(point, axis=0), axis=1).max()) * _SAMPLES
    seconds = float((np.abs(end - start) / robot.velocity).max())
    share = most if fastest <= 0.0 else min(most, _SAFE * limit * seconds / fastest)
    return max(1, int(np.floor(100.0 * share + 1e-9)))
