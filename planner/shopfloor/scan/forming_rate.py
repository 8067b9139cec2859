"""Change of springback if a step formed more or less of the depth than planned.

A tool that forms more of the wall in one step needs more force, so more springs back. Consider a wall that
rises by ``drop`` over a short distance up from a place. The scan shows that the part is too shallow by e at
the place and by e' above. Then

    rate = 1 - (e - e') / drop

is the fraction of the depth that was formed there. It is near 0 if the sheet sprang back completely, and
above 1 if the tools formed in one step what the walls above had left. Force is proportional to h^0.09 of the
scallop h, so to the 0.18th power of the step, and springback to about the 0.55th power of the force. If a
part sprang back by S, the next one, formed as planned, springs back by S rate^(-0.18 0.55).
"""

from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.forming.plan.sheet_mechanics import SCALLOP_EXPONENT

UP_DISTANCE_M: Final = 2.5 * MM
"""Distance [m] up the wall of the place above.

Chosen: larger than the radius around a place whose points determine its deviation.
"""
MIN_DROP_M: Final = 0.5 * MM
"""Minimum rise [m] of the wall over that distance, so that noise on a level floor is not taken for a rate."""
FORCE_EXPONENT: Final = 0.55
"""Exponent of the force in the springback: 1 for bending, 1/3 for stretching.

Computed: elastic shells of 0.85 to 1.1 mm with walls of 45 degrees have 0.52 to 0.56 (`bench.plant_shells`).
"""
EXPONENT: Final = 2.0 * SCALLOP_EXPONENT * FORCE_EXPONENT
"""Exponent of the rate in the springback, with opposite sign: a scallop grows with the square of the step."""
MIN_RATE: Final = 0.1
"""Lower bound of the rate, with which a quarter more springs back."""
MAX_RATE: Final = 4.0
"""Upper bound of the rate."""


def up_the_wall(normal: FloatArray, side: int) -> FloatArray:
    """Return displacements (N, 3) [m] of `UP_DISTANCE_M` up walls, from their upward unit normals (N, 3).

    Up is against the direction in which a tool on ``side`` (1: above the sheet, -1: below) forms.
    """
    horizontal = np.hypot(normal[:, 0], normal[:, 1])
    up = np.column_stack([-normal[:, :2] * normal[:, 2:], horizontal**2])
    return np.asarray(side * UP_DISTANCE_M * up / np.maximum(horizontal, 1e-9)[:, None])


def as_wanted(springback: FloatArray, depth_difference: FloatArray, drop: FloatArray) -> FloatArray:
    """Return the additional springback (N,) [m] of a sheet that is formed as planned.

    Args:
        springback: Springback (N,) [m] of the scanned part.
        depth_difference: By how much (N,) [m] it is shallower than at the place above: e - e'.
        drop: Rise (N,) [m] of the wall up to that place.
    """
    rate = 1.0 - depth_difference / np.maximum(drop, MIN_DROP_M)
    return np.asarray(np.maximum(springback, 0.0) * (np.clip(rate, MIN_RATE, MAX_RATE) ** -EXPONENT - 1.0))
