"""Claims on poses that the user supplies."""

import dataclasses
from typing import ClassVar, Final

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class FollowsPoses(Claim):
    """The TCP of an arm passes given poses in order.

    Attributes:
        arm: Name of the arm.
        frame: Frame of the poses: ``stock`` or ``world``.
        poses: Poses (M, 4, 4) [m].
        free: Twists (6,) in the pose's own frame, angular part first, along which the TCP may differ from a
            pose.
        position_tol: Allowed distance [m].
        angle_tol: Allowed angle [rad].
    """

    on_curves: ClassVar[bool] = True

    arm: str
    frame: str
    poses: FloatArray
    free: tuple[FloatArray, ...]
    position_tol: float
    angle_tol: float


@dataclasses.dataclass(frozen=True)
class FreeAxisRange:
    """A free axis of poses: rotation about, or translation along, an axis of the pose within a range.

    Attributes:
        arms: Arms that have it; if there are several, they share its value.
        axis: x, y or z (0, 1, 2).
        is_rotation: Whether it is a rotation.
        lower: Lower bound [rad or m].
        upper: Upper bound [rad or m].
    """

    arms: tuple[str, ...]
    axis: int
    is_rotation: bool
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class FollowsTable(Claim):
    """The TCPs of arms pass the poses of a table in order, up to free axes.

    From each pose to the next the TCP that moves farthest is no faster than the feed and no slower than the
    minimum feed. From and to stops, and where the minimum feed starts and ends, the TCPs reach it over
    ``run_up``. In sections with a minimum feed the tools stop only where the table has a stop.

    Attributes:
        operation: Name of the operation, whose file has the table.
        arms: Names of the arms.
        frame: Frame of the poses: ``stock`` or ``world``.
        free: Free axes; later ones act after earlier ones.
        position_tol: Allowed distance [m].
        angle_tol: Allowed angle [rad].
        feed: Feed of rows without their own [m/s], None if each row has one.
        feed_min: Minimum feed of rows without their own [m/s], 0 for none.
        run_up: Length over which the TCPs accelerate to the minimum feed [m].
    """

    on_curves: ClassVar[bool] = True

    operation: str
    arms: tuple[str, ...]
    frame: str
    free: tuple[FreeAxisRange, ...]
    position_tol: float
    angle_tol: float
    feed: float | None
    feed_min: float = 0.0
    run_up: float = 0.0


CLAIMS: Final[tuple[type[Claim], ...]] = (FollowsPoses, FollowsTable)
"""Kinds of claims on supplied poses."""
