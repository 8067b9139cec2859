"""External axes in programs: their values, speeds and paths between stations."""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

from planner.cell import axis_way
from planner.geometry.units import DEG, MM
from planner.languages.writing.layout import Joints, Outer, Step, TaskProgram
from planner.plans import Plan
from planner.problem import OUTER_DECIMALS, Arm, Cell, Problem, Turntable, in_turn


def table_of(arm: Arm, cell: Cell) -> Turntable | None:
    """The turntable that the program of an arm moves."""
    return cell.turntable if cell.turntable is not None and cell.turntable.arm == arm.name else None


class OuterSpeed(NamedTuple):
    """Of an external axis: the highest speed on the way to a station, and its ``own`` [m/s, rad/s]."""

    most: float
    own: float


def outer_speeds(task: TaskProgram, plan: Plan, problem: Problem) -> dict[int, OuterSpeed]:
    """Speeds of the external axes that a task moves, by column: what they carry goes at most at
    :data:`planner.problem.BLIND_SPEED`."""
    out: dict[int, OuterSpeed] = {}
    speeds = axis_way.travel_speeds(problem, plan.places)
    for name, rail in task.arm.rails.items():
        out[rail.column] = OuterSpeed(speeds[name], rail.speed)
    if (table := task.table) is not None:
        for name, axis in table.axes.items():
            out[axis.column] = OuterSpeed(speeds[name], axis.speed)
    return out


def outer_names(task: TaskProgram) -> dict[int, tuple[str, str]]:
    """Names of the external axes that a task moves, and the units of their values in texts, by column."""
    out = {axis.column: (axis.label, "mm") for axis in task.arm.axes}
    if (table := task.table) is not None:
        out |= {axis.column: (axis.label, "deg") for axis in table.axes.values()}
    return out


def outer_values(arm: Arm, cell: Cell, values: Mapping[str, float]) -> Outer | None:
    """The external axes that the program of an arm moves, at ``values`` [m, rad] by their names; None where
    it moves none."""
    out = {axis.column: values[name] / MM for name, axis in arm.rails.items()}
    table = table_of(arm, cell)
    if table is not None:
        out |= {axis.column: values[name] / DEG for name, axis in table.axes.items()}
    return tuple((column, round(value, OUTER_DECIMALS)) for column, value in sorted(out.items())) or None


def legs_between(before: Outer, station: Outer, arm: Arm, table: Turntable | None) -> list[Outer]:
    """The stands that external axes go through from one to the other, one after the other: those of a gantry
    as :func:`planner.problem.in_turn` has them, the turn of a positioner before its tilt."""
    out, at, there = list[Outer](), dict(before), dict(station)
    rails = arm.rails
    ends = [{name: MM * some[axis.column] for name, axis in rails.items()} for some in (at, there)]
    columns = [rails[name].column for name in in_turn(rails, *ends)]
    columns += [] if table is None else [axis.column for axis in table.axes.values()]
    for column in columns:
        if at[column] != there[column]:
            at[column] = there[column]
            out.append(tuple(sorted(at.items())))
    return out


def at_station(step: Step, station: Outer | None) -> Step:
    """A joint move that says nothing of external axes is one where they stand."""
    if isinstance(step, Joints) and step.station is None:
        return dataclasses.replace(step, station=station)
    return step
