"""External axes as the proof knows them.

They are the axes that a task of the text moves, and the resulting poses of bases and bodies. The poses are
sums that the proof computes independently of the planner.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.problem import STOCK_AXIS, TILT_AXIS, Arm, Cell, Turntable
from planner.programs.steps import MoveStep

AXIS_VALUE_TOLERANCE = 1e-6
"""Tolerance [m, rad] within which axis values are the same station."""


@dataclasses.dataclass(frozen=True)
class TaskAxis:
    """An external axis that a task of the text moves. Values are in m or rad.

    Attributes:
        station_name: Name of its value among stations: that of an arm's axis, :data:`STOCK_AXIS` or
            :data:`TILT_AXIS`.
        mechanical_unit: Name of its mechanical unit.
        label: Mechanical unit of that name, or one of its axes.
        column: Index of its value among the external axes of targets.
        scale: Factor from the values of targets to m or rad.
        unit_symbol: Unit of values in texts.
        low: Lower limit.
        high: Upper limit.
        home: Home value.
        speed: Maximum speed.
        acceleration: Maximum acceleration, infinite if none is stated.
        follow_fraction: Fraction of the tool's path that a coordinated track follows, None for other axes.
        direction: Unit vector (3,) of a linear axis in the world.
    """

    station_name: str
    mechanical_unit: str
    label: str
    column: int
    scale: float
    unit_symbol: str
    low: float
    high: float
    home: float
    speed: float
    acceleration: float
    follow_fraction: float | None = None
    direction: tuple[float, float, float] | None = None

    @property
    def arm(self) -> str | None:
        """The arm that the axis carries, None for an axis under the block."""
        return None if self.station_name in (STOCK_AXIS, TILT_AXIS) else self.station_name.partition("/")[0]

    def speed_in(self, move: MoveStep) -> float:
        """Return the speed [m/s, rad/s] that the text gives the axis in a move."""
        if move.speed.external is not None:  # KRL: a fraction of the axis' own speed
            return move.speed.external[self.column] * self.speed
        return move.speed.rotary if self.station_name in (STOCK_AXIS, TILT_AXIS) else move.speed.linear

    def format_value(self, value: float) -> str:
        """Format a value [m, rad] for messages."""
        return f"{round(value / self.scale, 6):g} {self.unit_symbol}"


def task_axes(arm: Arm, table: Turntable | None) -> tuple[TaskAxis, ...]:
    """Return the external axes that the task of an arm moves.

    They are those under the arm from the floor up, then the turntable or the turn axis of a positioner,
    then its tilt axis.
    """
    out = []
    for name, rail in arm.axes_by_name.items():
        ends = (rail.low, rail.high, rail.home, rail.speed, rail.acceleration)
        x, y, z = rail.axis.tolist()
        identity = (rail.unit, rail.label, rail.column)
        out.append(TaskAxis(name, *identity, 1e-3, "mm", *ends, rail.follow_fraction, (x, y, z)))
    for name, axis in table.axes.items() if table is not None and table.arm == arm.name else ():
        ends = (axis.low, axis.high, axis.home, axis.speed, axis.acceleration)
        identity = (axis.unit, axis.label, axis.column)
        out.append(TaskAxis(name, *identity, np.pi / 180.0, "deg", *ends))
    return tuple(out)


def motion_order(axes: Sequence[TaskAxis], axis: TaskAxis, start: float, end: float) -> tuple[int, int]:
    """Return the sort key of an axis motion among those of a task, which run one after the other.

    Axes under an arm that come nearer to home move first, from the arm down, then the others, from the
    floor up. Under the block the turn axis moves before the tilt axis.

    Args:
        axes: Axes of the task.
        axis: Axis that moves.
        start: Its value [m, rad] before.
        end: Its value [m, rad] after.
    """
    rank = axes.index(axis)
    nearer = abs(start - axis.home) - abs(end - axis.home) > AXIS_VALUE_TOLERANCE
    return (0, -rank) if axis.arm is not None and nearer else (1, rank)


def axis_translation(arm: Arm, values: Mapping[str, float], last: str | None = None) -> FloatArray:
    """Return the translation (3,) [m] of what stands on the axes under an arm.

    That is its base, or what stands on the axis ``last``. ``values`` [m] are by axis name, 0 for axes that
    are not named.
    """
    out = np.zeros(3)
    for name, rail in arm.axes_by_name.items():
        out = out + values.get(name, 0.0) * np.asarray(rail.axis)
        if name == last:
            break
    return out


def carried_motions(
    cell: Cell, end: Mapping[str, float], start: Mapping[str, float]
) -> dict[str, FloatArray]:
    """Return the motions (4, 4) of what stands on axes under arms, by axis name, between axis values [m]."""
    out = {}
    for arm in cell.arms:
        for name, rail in arm.axes_by_name.items():
            if rail.carries:
                out[name] = np.eye(4)
                out[name][:3, 3] = axis_translation(arm, end, name) - axis_translation(arm, start, name)
    return out


def axis_values(arm: Arm, external: FloatArray) -> dict[str, float]:
    """Return the values [m] of the axes under an arm by name, from the external axes (6,) of a target."""
    return {axis.station_name: axis.scale * float(external[axis.column]) for axis in task_axes(arm, None)}


def floor_height(cell: Cell) -> float:
    """Return the height [m] of the floor.

    It is 0, or the foot of the lowest upright arm with the axes under it at 0.
    """
    foot_heights = [
        arm.base[2, 3] - axis_translation(arm, arm.axis_values)[2]
        for arm in cell.arms
        if arm.base[2, 2] > 0.5
    ]
    return float(min([0.0, *foot_heights]))
