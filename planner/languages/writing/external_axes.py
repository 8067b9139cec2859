"""External axes in programs: their values, speeds and motion between stations."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

from planner.cell import external_axis_motion
from planner.geometry.units import DEG, MM
from planner.languages.writing.layout import ExternalAxisValues, JointMove, TaskProgram, TaskStep
from planner.plans import Plan
from planner.problem import EXTERNAL_AXIS_DECIMALS, Arm, Cell, Problem, Turntable, motion_order


def table_of(arm: Arm, cell: Cell) -> Turntable | None:
    """Return the turntable that the program of an arm moves, or None.

    Args:
        arm: The arm.
        cell: The cell.
    """
    return cell.turntable if cell.turntable is not None and cell.turntable.arm == arm.name else None


class ExternalAxisSpeed(NamedTuple):
    """Speeds of an external axis [m/s, rad/s].

    Attributes:
        travel: Maximum speed between stations.
        rated: Maximum speed of the axis.
    """

    travel: float
    rated: float


def external_axis_speeds(task: TaskProgram, plan: Plan, problem: Problem) -> dict[int, ExternalAxisSpeed]:
    """Return the speeds of the external axes that a task moves, by column from 0.

    Between stations no point of an arm or block on these axes moves faster than
    :data:`planner.problem.MAX_BLIND_SPEED_M_S`.

    Args:
        task: The task.
        plan: The plan.
        problem: Problem of the plan.
    """
    out: dict[int, ExternalAxisSpeed] = {}
    speeds = external_axis_motion.travel_speeds(problem, plan.stock_poses)
    for name, rail in task.arm.axes_by_name.items():
        out[rail.column] = ExternalAxisSpeed(speeds[name], rail.speed)
    if (table := task.table) is not None:
        for name, axis in table.axes.items():
            out[axis.column] = ExternalAxisSpeed(speeds[name], axis.speed)
    return out


def external_axis_names(task: TaskProgram) -> dict[int, tuple[str, str]]:
    """Return label and unit, "mm" or "deg", of the external axes that a task moves, by column from 0."""
    out = {axis.column: (axis.label, "mm") for axis in task.arm.linear_axes}
    if (table := task.table) is not None:
        out |= {axis.column: (axis.label, "deg") for axis in table.axes.values()}
    return out


def external_axis_values(arm: Arm, cell: Cell, values: Mapping[str, float]) -> ExternalAxisValues | None:
    """Return the values of the external axes that the program of an arm moves, None if it moves none.

    They are in mm or deg, rounded as written, in the order of the columns.

    Args:
        arm: The arm.
        cell: The cell.
        values: Values of the axes [m, rad] by name.
    """
    out = {axis.column: values[name] / MM for name, axis in arm.axes_by_name.items()}
    table = table_of(arm, cell)
    if table is not None:
        out |= {axis.column: values[name] / DEG for name, axis in table.axes.items()}
    return (
        tuple((column, round(value, EXTERNAL_AXIS_DECIMALS)) for column, value in sorted(out.items())) or None
    )


def axis_legs(
    start: ExternalAxisValues, end: ExternalAxisValues, arm: Arm, table: Turntable | None
) -> list[ExternalAxisValues]:
    """Return the values of all external axes after each leg of the motion from one station to another.

    In each leg one axis moves; axes whose value does not change have no leg. The axes of a gantry move in the
    order of :func:`planner.problem.motion_order`. The turn axis of a positioner moves before its tilt axis.

    Args:
        start: Values at the start.
        end: Values at the end.
        arm: The arm.
        table: Turntable that its program moves, or None.
    """
    out: list[ExternalAxisValues] = []
    current, target_values = dict(start), dict(end)
    rails = arm.axes_by_name
    ends = [
        {name: MM * values[axis.column] for name, axis in rails.items()}
        for values in (current, target_values)
    ]
    columns = [rails[name].column for name in motion_order(rails, *ends)]
    if table is not None:
        columns += [axis.column for axis in table.axes.values()]
    for column in columns:
        if current[column] != target_values[column]:
            current[column] = target_values[column]
            out.append(tuple(sorted(current.items())))
    return out


def with_axis_setpoint(step: TaskStep, axis_setpoint: ExternalAxisValues | None) -> TaskStep:
    """Return a joint move that states no external axes with their values, and any other step unchanged.

    Args:
        step: The step.
        axis_setpoint: Values of the external axes, or None.
    """
    if isinstance(step, JointMove) and step.axis_setpoint is None:
        return dataclasses.replace(step, axis_setpoint=axis_setpoint)
    return step
