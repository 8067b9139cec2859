"""Change of springback where more or less of a sheet was formed at once than planned.

A tool that takes more of the wall in one step needs more force, and more springs back. Consider a wall that
rises by ``drop`` over a short distance up from a place, where the scan shows e at the place and e' above.
Then

    rate = 1 - (e - e') / drop

is the fraction of its depth that was formed there: near 0 where the sheet yielded and sprang back completely,
above 1 where tools made up in one step for what the walls above had left. Force goes with the scallop as
h^0.09, thus with the 0.18th power of the step, and springback with about the 0.55th power of the force. If a
part sprang back by S, the next one, formed as planned, springs back by S rate^(-0.18 0.55).
"""

from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.forming.plan.sheet_mechanics import SCALLOP_EXPONENT

UP_DISTANCE_M: Final = 2.5 * MM
"""Distance [m] up the wall of the place above, beyond the points that determine the deviation at one
place.
"""
MIN_DROP_M: Final = 0.5 * MM
"""Rise [m] of the wall over that distance below which it is nearly a floor, where noise must not look like a
rate.
"""
FORCE_EXPONENT: Final = 0.55
"""Exponent of the force in the springback: 1 for bending, 1/3 for stretching. Computed: elastic shells of
0.85 to 1.1 mm with walls of 45 degrees have 0.52 to 0.56 (`bench.plant_shells`).
"""
EXPONENT: Final = 2.0 * SCALLOP_EXPONENT * FORCE_EXPONENT
MIN_RATE: Final = 0.1
MAX_RATE: Final = 4.0
"""Bounds of the rate. Where nothing was formed, a quarter more springs back."""


def up_the_wall(normal: FloatArray, side: int) -> FloatArray:
    """Displacements (N, 3) [m] up walls with ``normal`` (N, 3).

    They are against the direction of a tool on ``side``.
    """
    flat = np.hypot(normal[:, 0], normal[:, 1])
    up = np.column_stack([-normal[:, :2] * normal[:, 2:], flat**2])
    return np.asarray(side * UP_DISTANCE_M * up / np.maximum(flat, 1e-9)[:, None])


def as_wanted(springback: FloatArray, depth_difference: FloatArray, drop: FloatArray) -> FloatArray:
    """Additional springback (N,) [m] of a sheet that is formed as planned.

    Args:
        springback: (N,) [m] springback of the scanned part.
        depth_difference: (N,) [m] by how much it is shallower than at the place above.
        drop: (N,) [m] rise of the wall up to that place.
    """
    rate = 1.0 - depth_difference / np.maximum(drop, MIN_DROP_M)
    return np.asarray(np.maximum(springback, 0.0) * (np.clip(rate, MIN_RATE, MAX_RATE) ** -EXPONENT - 1.0))
