"""Rows of the setup sheet about external axes that do not depend on the controller language."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from planner.geometry.arrays import inverse, transform
from planner.geometry.units import DEG
from planner.problem import Arm, LinearAxis, Problem, RotaryAxis, Turntable
from planner.report import markup
from planner.report.plugin_contributions import ControllerCheck
from planner.report.pose_text import point_text, pose_cells


@dataclasses.dataclass(frozen=True)
class AxisTerms:
    """Terms in which the configuration of a controller describes external axes.

    Attributes:
        start: Phrase for "before a program has started".
        limits: Function from the number of an external axis, from 1, to the name of its limits and a note
            on its speed.
        frame: Name of the frame in the foot of an arm in which the controller states positions.
        load: Phrase that says where the load of a positioner is entered. It is appended to a sentence.
    """

    start: str
    limits: Callable[[int], tuple[str, str]]
    frame: str = ""
    load: str = ""


def rail_checks(rail: LinearAxis) -> list[ControllerCheck]:
    """Return checks of the bodies that a linear axis carries, and of its coordinated motion.

    Empty if it carries no body and does not move while the arm works.

    Args:
        rail: Track or gantry axis.
    """
    out = list[ControllerCheck]()
    if rail.carries:
        requirement = (
            f"{', '.join(rail.carries)}: at 0 mm at their pose in the cell; measure two corners of each"
        )
        out.append((f"{rail.label} carries", requirement))
    if rail.follow_fraction is not None:
        requirement = f"by {rail.follow_fraction:g} of the tool's motion along it, within its range"
        out.append((f"{rail.unit} moves in coordination while the arm works", requirement))
    return out


def rail_zero(arm: Arm) -> str:
    """Return the zero position of the linear axes that carry an arm, as text. Gantry axes are named."""
    axis_names = f"{', '.join(rail.axis_name for rail in arm.linear_axes)} at " if arm.track is None else ""
    return f"{axis_names}0 mm"


def home_check(home: str) -> str:
    """Return the required state of an external axis before a program starts, as text.

    Args:
        home: Home position of the axis as text.
    """
    return f"jogged home, to {home}: a program checks this before its first move, and stops elsewhere"


def turntable(
    problem: Problem, table: Turntable, terms: AxisTerms, units: Sequence[ControllerCheck]
) -> list[ControllerCheck]:
    """Return checks of the configuration of a turntable or positioner, and of the clamping of the block.

    Args:
        problem: Problem with the stock on the table. Its stated place is that at angle 0.
        table: Turntable or positioner.
        terms: Terms of the controller.
        units: Checks of the table as a mechanical unit in the configuration. They come first in the result.
    """
    sense = "counter-clockwise" if table.axis[2] > 0.0 else "clockwise"
    position, rotation, _ = pose_cells(np.asarray(problem.stock.place))
    arm = problem.cell.arm(table.arm)
    tilt = table.tilt
    base_text = f"its axis is vertical through {point_text(table.centre)} mm in the world"
    base_text += "" if tilt is None else f", with {tilt.label} at 0 deg"
    if terms.frame:
        base_text += f", {point_text(transform(inverse(arm.base), table.centre))} mm in {terms.frame}"
    home = ", ".join(f"{axis.axis_name} {axis.home / DEG:g}".strip() for axis in table.axes.values())
    return [
        *units,
        *([] if tilt is None else _tilt(problem, table, tilt, terms)),
        (f"{table.label}: base frame", base_text),
        (f"{table.label}: direction", f"seen from above, increasing values rotate it {sense}"),
        _joint(table, terms),
        (f"{table.unit} {terms.start}", home_check(f"{home} deg")),
        (f"block with {table.unit} at 0 deg", f"at {position} mm, roll, pitch, yaw {rotation} deg"),
    ]


def _joint(axis: RotaryAxis, terms: AxisTerms) -> ControllerCheck:
    """Return the check of a rotary axis under the block: range, speed, acceleration and home."""
    name, note = terms.limits(axis.column + 1)
    range_text = f"{axis.low / DEG:g} to {axis.high / DEG:g} deg, at most {axis.speed / DEG:g} deg/s{note}"
    acceleration_text = f", {axis.acceleration / DEG:g} deg/s²" if np.isfinite(axis.acceleration) else ""
    return f"{axis.label}: {name}", f"{range_text}{acceleration_text}; home {axis.home / DEG:g} deg"


def _tilt(problem: Problem, table: Turntable, tilt: RotaryAxis, terms: AxisTerms) -> list[ControllerCheck]:
    """Return the checks of the tilt axis of a positioner and of its load, for the setup sheet.

    The direction of the axis is stated in the world, and in the frame that the controller uses if
    ``terms.frame`` names one.
    """
    to_base = inverse(problem.cell.arm(table.arm).base)
    frames = [("the world", tilt.axis, tilt.centre)]
    if terms.frame:
        frames.append((terms.frame, to_base[:3, :3] @ tilt.axis, transform(to_base, tilt.centre)))
    axis_text = "; ".join(
        f"its direction is ({', '.join(markup.fixed_decimals(float(v), 6) for v in axis)}) in {name}, "
        f"through {point_text(at)} mm"
        for name, axis, at in frames
    )
    masses = [setup.stock.mass for setup in problem.setups if setup.stock.mass is not None]
    max_load = "not stated" if table.load is None else f"{table.load:g} kg"
    block_text = f"the block weighs {max(masses):.1f} kg" if masses else "weigh the block"
    load_text = f"carries: {max_load}; {block_text}, with its support{terms.load}"
    return [
        (f"{tilt.label}: base frame", axis_text),
        (f"{tilt.label}: zero", "at 0 deg the plate is level, its top upwards: measure with a level"),
        (f"{tilt.label}: direction", "increasing values tilt it by the right-hand rule about its direction"),
        _joint(tilt, terms),
        (f"{table.unit}: load", load_text),
    ]
