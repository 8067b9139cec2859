"""Claims of poses that the user supplies."""

import dataclasses
from typing import ClassVar, Final

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class FollowsPoses(Claim):
    """The TCP of ``arm`` passes the poses (M, 4, 4) in its work frame ``frame`` in order, up to the free axes
    ``free``.

    ``free`` are twists (6,) in the tool frame along which the pose may differ.
    """

    on_curves: ClassVar[bool] = True

    arm: str
    frame: str
    poses: FloatArray
    free: tuple[FloatArray, ...]
    position_tol: float
    angle_tol: float


@dataclasses.dataclass(frozen=True)
class FreeAxis:
    """What a user leaves open about poses: a turn about, or a slide along, the ``axis`` x, y or z (0, 1, 2)
    of the pose, from ``lower`` to ``upper`` [rad or m]. ``arms`` that are named share its value."""

    arms: tuple[str, ...]
    axis: int
    turns: bool
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class FollowsTable(Claim):
    """The TCPs of ``arms`` pass the poses of the table that ``operation`` names, in order and in ``frame``,
    but for what is ``free``, the later axes after the earlier ones.

    Each pose holds within ``position_tol`` [m] and ``angle_tol`` [rad]. From each pose to the next the TCPs
    take so long that the farthest one moves no faster than the row's feed, or ``feed`` [m/s] where it has
    none; and no slower than the row's least feed, or ``feed_min`` [m/s], 0 for none. From and to stops, and
    where the least feed begins and ends, they come up to it over ``run_up`` [m]; stops are those of the table
    alone.
    """

    on_curves: ClassVar[bool] = True

    operation: str
    arms: tuple[str, ...]
    frame: str
    free: tuple[FreeAxis, ...]
    position_tol: float
    angle_tol: float
    feed: float | None
    feed_min: float = 0.0
    run_up: float = 0.0


CLAIMS: Final[tuple[type[Claim], ...]] = (FollowsPoses, FollowsTable)
"""Kinds of claims of supplied poses."""
