"""What a sheet comes back by where more or less of it was formed at once than was to be.

A tool that takes more of the wall in one step needs more force, and more comes back. Of a wall that rises by
``drop`` over a short way up from a place, and of which the scan shows e at the place and e' above,

    rate = 1 - (e - e') / drop

is the share of its depth that was formed there: near 0 where the sheet gave way and came back whole, above
1 where tools made up in one step for what walls above had left. Force goes with the scallop, h^0.09, and so
with the step's 0.18th power, and springback with about the 0.55th of the force. So of a part that came back
by S the next one, which is to be formed as it is wanted, comes back by S rate^(-0.18 0.55).
"""

from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.forming.plan.sheet_mechanics import OF_SCALLOP

UP: Final = 2.5 * MM
"""The place above is so far up the wall [m]: beyond the points that say what is off at one place."""
LEAST_DROP: Final = 0.5 * MM
"""Where a wall rises by less over that way [m] it is nearly a floor, and noise is not taken for a rate."""
OF_FORCE: Final = 0.55
"""Exponent of the force in what comes back: 1 where a sheet bends, 1/3 where it is stretched; elastic shells
of 0.85 to 1.1 mm with walls of 45 degrees have 0.52 to 0.56 (`bench.plant_shells`)."""
EXPONENT: Final = 2.0 * OF_SCALLOP * OF_FORCE
LEAST_RATE: Final = 0.1
MOST_RATE: Final = 4.0
"""Rates are taken as no smaller and no larger: where nothing was formed a quarter more comes back."""


def up_the_wall(normal: FloatArray, side: int) -> FloatArray:
    """Ways (N, 3) [m] up walls with ``normal`` (N, 3), away from where a tool on ``side`` goes."""
    flat = np.hypot(normal[:, 0], normal[:, 1])
    up = np.column_stack([-normal[:, :2] * normal[:, 2:], flat**2])
    return np.asarray(side * UP * up / np.maximum(flat, 1e-9)[:, None])


def as_wanted(back: FloatArray, less: FloatArray, drop: FloatArray) -> FloatArray:
    """By how much (N,) [m] more than ``back`` (N,) [m] a sheet comes back by where it is formed as wanted, of
    one that is too shallow by ``less`` (N,) [m] more than where the wall is ``drop`` (N,) [m] higher."""
    rate = 1.0 - less / np.maximum(drop, LEAST_DROP)
    return np.asarray(np.maximum(back, 0.0) * (np.clip(rate, LEAST_RATE, MOST_RATE) ** -EXPONENT - 1.0))
