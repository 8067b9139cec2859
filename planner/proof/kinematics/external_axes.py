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
"""Tolerance [m, rad] within which two values of an axis count as equal."""


@dataclasses.dataclass(frozen=True)
class TaskAxis:
    """An external axis that a task of the text moves. Values are in m or rad.

    Attributes:
        station_name: Name of its value among stations: that of an arm's axis, :data:`STOCK_AXIS` or
            :data:`TILT_AXIS`.
        mechanical_unit: Name of its mechanical unit.
        label: Name in messages: that of the mechanical unit, or of one of its axes.
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

    Axes that carry the arm come first, from the floor up. The turntable, or turn axis and tilt axis of the
    positioner, follow if this task moves them.
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
    """Return a sort key for the motion of an external axis.

    A task moves its axes one after the other, in ascending order of this key. Axes that carry an arm and move
    toward home come first, from the uppermost axis down. All other motions follow in the order of ``axes``:
    from the floor up, then the turn axis and then the tilt axis of a positioner.

    Args:
        axes: Axes of the task, in the order of :func:`task_axes`.
        axis: Axis that moves.
        start: Value [m, rad] of the axis before the motion.
        end: Value [m, rad] of the axis after the motion.
    """
    rank = axes.index(axis)
    toward_home = abs(start - axis.home) - abs(end - axis.home) > AXIS_VALUE_TOLERANCE
    return (0, -rank) if axis.arm is not None and toward_home else (1, rank)


def axis_translation(arm: Arm, values: Mapping[str, float], last: str | None = None) -> FloatArray:
    """Return the translation (3,) [m] in the world by the linear axes that carry an arm.

    Args:
        arm: The arm.
        values: Axis values [m] by name, 0 for axes that are not named.
        last: Name of the last axis that counts, from the floor up. By default all axes count, so that the
            result is the translation of the arm's base.
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
    """Return the motions (4, 4) in the world of bodies that stand on axes that carry arms, by axis name.

    They lead from the axis values ``start`` to ``end`` [m], by axis name.
    """
    out = {}
    for arm in cell.arms:
        for name, rail in arm.axes_by_name.items():
            if rail.carries:
                out[name] = np.eye(4)
                out[name][:3, 3] = axis_translation(arm, end, name) - axis_translation(arm, start, name)
    return out


def axis_values(arm: Arm, external: FloatArray) -> dict[str, float]:
    """Return the values [m] of the axes that carry an arm, by name, from a target's external axes (6,)."""
    return {axis.station_name: axis.scale * float(external[axis.column]) for axis in task_axes(arm, None)}


def floor_height(cell: Cell) -> float:
    """Return the height [m] of the floor.

    It is 0, or the height of the lowest foot of an upright arm, with its external axes at 0, if that is
    lower.
    """
    foot_heights = [
        arm.base[2, 3] - axis_translation(arm, arm.axis_values)[2]
        for arm in cell.arms
        if arm.base[2, 2] > 0.5
    ]
    return float(min([0.0, *foot_heights]))
