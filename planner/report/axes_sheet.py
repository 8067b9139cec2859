"""Rows of the setup sheet about external axes that do not depend on the language of the controller."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from planner.geometry.arrays import inverse, transform
from planner.geometry.units import DEG
from planner.problem import Arm, LinearAxis, Problem, RotaryAxis, Turntable
from planner.report import markup
from planner.report.contribution import Check
from planner.report.pose_text import point, pose_cells


@dataclasses.dataclass(frozen=True)
class AxisTerms:
    """What the configuration of a controller calls things.

    Attributes:
        start: When a program has not started yet.
        limits: From the number of an external axis, from 1: the name of its limits, and a note on its speed.
        frame: Name of the frame in the foot of an arm, in which the controller states positions.
        load: Where the load of a positioner is entered, to follow other words.
    """

    start: str
    limits: Callable[[int], tuple[str, str]]
    frame: str = ""
    load: str = ""


def rail_checks(rail: LinearAxis) -> list[Check]:
    """Check the bodies that stand on an axis, and how it moves while the arm works."""
    out = list[Check]()
    if rail.carries:
        what = f"{', '.join(rail.carries)}: at 0 mm where the cell has them; measure two corners of each"
        out.append((f"{rail.label} carries", what))
    if rail.follow is not None:
        what = f"by {rail.follow:g} of the tool's way along it, within its range, coordinated with the arm"
        out.append((f"{rail.unit} while the arm works goes along", what))
    return out


def rail_zero(arm: Arm) -> str:
    """State the axes under an arm at zero."""
    words = f"{', '.join(rail.word for rail in arm.axes)} at " if arm.track is None else ""
    return f"{words}0 mm"


def jogged(home: str) -> str:
    """State where an external axis must be before a program starts."""
    return f"jogged home, to {home}: a program looks before its first move, and goes no further elsewhere"


def turntable(problem: Problem, table: Turntable, terms: AxisTerms, units: Sequence[Check]) -> list[Check]:
    """Check the configuration of a turntable or positioner, and how the block is clamped.

    Args:
        problem: Problem with the stock on the table.
        table: Turntable or positioner.
        terms: Terms of the controller.
        units: Checks of the mechanical unit in the configuration. They come first.
    """
    sense = "counter-clockwise" if table.axis[2] > 0.0 else "clockwise"
    place, turn, _ = pose_cells(np.asarray(problem.stock.place))
    mover, tilt = problem.cell.arm(table.arm), table.tilt
    root = f"its axis goes upright through {point(table.centre)} mm of the world"
    root += "" if tilt is None else f", with {tilt.label} at 0 deg"
    if terms.frame:
        root += f", {point(transform(inverse(mover.base), table.centre))} mm of {terms.frame}"
    home = ", ".join(f"{axis.word} {axis.home / DEG:g}".strip() for axis in table.axes.values())
    return [
        *units,
        *([] if tilt is None else _tilt(problem, table, tilt, terms)),
        (f"{table.label}: base frame", root),
        (f"{table.label}: sense", f"seen from above, growing values turn it {sense}"),
        _joint(table, terms),
        (f"{table.unit} {terms.start}", jogged(f"{home} deg")),
        (f"block with {table.unit} at 0 deg", f"at {place} mm, roll, pitch, yaw {turn} deg"),
    ]


def _joint(axis: RotaryAxis, terms: AxisTerms) -> Check:
    """The range of an axis under the block, its speed and acceleration, and its home."""
    name, note = terms.limits(axis.column + 1)
    ends = f"{axis.low / DEG:g} to {axis.high / DEG:g} deg, at most {axis.speed / DEG:g} deg/s{note}"
    fast = f", {axis.acceleration / DEG:g} deg/s²" if np.isfinite(axis.acceleration) else ""
    return f"{axis.label}: {name}", f"{ends}{fast}; home {axis.home / DEG:g} deg"


def _tilt(problem: Problem, table: Turntable, tilt: RotaryAxis, terms: AxisTerms) -> list[Check]:
    """What the configuration must say of the tilt axis of a positioner and of its load."""
    base = inverse(problem.cell.arm(table.arm).base)
    frames = [("the world", tilt.axis, tilt.centre)]
    if terms.frame:
        frames.append((terms.frame, base[:3, :3] @ tilt.axis, transform(base, tilt.centre)))
    lies = "; ".join(
        f"it goes along ({', '.join(markup.fixed(float(v), 6) for v in axis)}) of {name}, {point(at)} mm is "
        "on it"
        for name, axis, at in frames
    )
    masses = [setup.stock.mass for setup in problem.setups if setup.stock.mass is not None]
    most = "not stated" if table.load is None else f"{table.load:g} kg"
    block = f"the block weighs {max(masses):.1f} kg" if masses else "weigh the block"
    carried = f"carries: {most}; {block}, with its support{terms.load}"
    return [
        (f"{tilt.label}: base frame", lies),
        (f"{tilt.label}: zero", "with 0 deg the plate lies flat, its top upwards: measure with a level"),
        (f"{tilt.label}: sense", "growing values tilt it by the right hand about that direction"),
        _joint(tilt, terms),
        (f"{table.unit}: load", carried),
    ]
