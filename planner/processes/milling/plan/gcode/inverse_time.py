"""Writer of G-code for a five-axis machine: inverse time feed (G93), tip and rotary axes in every block.

X Y Z are those of the tip in the stock frame, so the machine has to control the tool centre point (switchable
kinematics on LinuxCNC, elsewhere G43.4 or TRAORI). The program asks its operator to switch this control on.
Rotary axes are counted as :mod:`planner.processes.milling.plan.gcode.state` states. Each block takes the time
that the move takes in the plan. The machine's limits and bodies are not known here, and the program says so.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.issues import issue_error
from planner.processes.milling.plan.gcode.state import ROTARY_NAMES, Convention
from planner.processes.milling.plan.operation import GCodeCut, Milling
from planner.targets import TargetAction, Targets

AXIS_TOLERANCE_RAD: Final = 0.02 * DEG
"""Allowed deviation [rad] of the tool's axis from the plan between two blocks.

Chosen: equal to that of the reader of such files.
"""
MAX_BISECTIONS: Final = 12
"""Maximum number of bisections of a move whose axis passes near that of a rotary axis."""
POLE_SINE: Final = 5e-5
"""Sine of the tilt below which the tilt counts as zero.

There the angle of the axis that carries the tilt is arbitrary, and noise of a mesh or of a plan must not
change it.
"""
MAX_FEED_PER_MIN: Final = 9999.0
"""Maximum feed word of a move [1/min].

Controllers often have four digits for the feed word (unverified). A move therefore takes at least 6 ms, even
if it takes less time in the plan.
"""


class UnreachedAxisError(ValueError):
    """The machine cannot point the tool in a required direction.

    Attributes:
        row: Index of the direction on the path.
        deviation: Angle [rad] between this direction and the nearest one of the machine.
    """

    def __init__(self, row: int, deviation: float) -> None:
        super().__init__(
            f"row {row}: the axis is {deviation / DEG:.3f} deg from the nearest one of the machine"
        )
        self.row, self.deviation = row, deviation


@dataclasses.dataclass(frozen=True)
class MachinePath:
    """One operation as a path of the tip in the stock frame.

    Attributes:
        name: Name of the operation.
        tip: Positions of the tip (N, 3) [m].
        axis: Unit vectors from the tip to the spindle (N, 3).
        time: Times (N,) [s].
        names: Names of the N targets.
        actions: Actions at targets, in order.
        spindle_rpm: Spindle speed [1/min].
        signal: Output that switches the spindle.
    """

    name: str
    tip: FloatArray
    axis: FloatArray
    time: FloatArray
    names: Sequence[str]
    actions: Sequence[TargetAction]
    spindle_rpm: float
    signal: str


def machine_path(operation: object, targets: Targets, values: FloatArray, time: FloatArray) -> MachinePath:
    """Return the path of the tip in a milling operation.

    Args:
        operation: Operation of the problem.
        targets: Its targets.
        values: Values of their freedoms (N, F).
        time: Times of the targets (N,) [s].

    Raises:
        TandemError: ``problem.field`` if the operation has another process, works on a block that an arm
            holds, or has a cut from a G-code file.
    """
    if not isinstance(operation, Milling):
        named = f"'{getattr(operation, 'name', operation)}' ({getattr(operation, 'process', '?')})"
        message = f"G-code is written for milling only, got the operation {named}; export that as .3dm"
        raise issue_error("problem.field", message, field="output")
    arm = operation.arms[0]
    if file_names := [cut.gcode.file.name for cut in operation.cuts if isinstance(cut, GCodeCut)]:
        message = f"the operation '{operation.name}' cuts by {file_names[0]}, which is G-code; use that file"
        raise issue_error("problem.field", message, field="output")
    if targets.frame[arm] != "stock":
        message = (
            f"the operation '{operation.name}': its targets are in the frame {targets.frame[arm]}, not stock"
        )
        raise issue_error("problem.field", message, field="output")
    pose = targets.poses(values)[arm]
    names = [targets.name(i) for i in range(targets.count)]
    tip, axis = pose[:, :3, 3], -pose[:, :3, 2]  # z of the tool points out of the spindle
    rpm, signal = operation.spindle_rpm, operation.signal
    return MachinePath(operation.name, tip, axis, time, names, targets.actions, rpm, signal)


def write_program(title: str, paths: Iterable[MachinePath], machine: Convention) -> str:
    """Write the text of all paths, one after the other.

    Args:
        title: Name of the job.
        paths: Paths in order.
        machine: Rotary axes of the machine.

    Raises:
        TandemError: ``problem.field`` if the machine cannot point the tool as the plan does.
    """
    body: list[str] = []
    for path in paths:
        try:
            body += _operation_lines(path, machine)
        except UnreachedAxisError as error:
            deviation = (
                f"{error.deviation / DEG:.2f} deg at {path.names[error.row]}, allowed "
                f"{AXIS_TOLERANCE_RAD / DEG:g} deg"
            )
            message = (
                f"a machine {machine.name} cannot point the tool as '{path.name}' does: deviation {deviation}"
            )
            hint = "name a machine with two rotary axes"
            raise issue_error("problem.field", message, field="machine", hint=hint) from error
    head = [
        f"(job {_comment_text(title)})",
        f"(for a machine {machine.name}, rotary axes {' '.join(machine.letters)} in degrees)",
        *(
            f"({letter} counts as it turns the {'tool' if sign > 0 else 'part'} about +{about}, right hand)"
            for letter, about in zip(ROTARY_NAMES, "xyz", strict=True)
            for name, sign in machine.chain
            if name == letter
        ),
        "(X Y Z mm: the tip in the frame of the stock; tool centre point control has to be on)",
        "(NOT proven for this machine: its limits, its bodies and its clamping are not known)",
        "(P of G4 is in seconds)",
        "G21 G90 G94 G17 G40 G80",
    ]
    return "\n".join([*head, *body, "G94", "M2", ""])


def rotary_angles(axis: FloatArray, machine: Convention) -> FloatArray:
    """Return the angles (N, 3) [rad] of A, B and C that point the tool along a path of directions.

    Angles are continuous from one direction to the next. Of the two solutions for the start, the one with
    less total rotation is used. Axes that do not exist have the angle 0.

    Args:
        axis: Unit vectors (N, 3) from the tip to the spindle.
        machine: Rotary axes of the machine.

    Raises:
        UnreachedAxisError: The machine has one rotary axis, which cannot take a direction.
    """
    best = min(
        (_track_angles(axis, machine, side) for side in (0, 1)),
        key=lambda solution: (
            round(float(np.abs(np.diff(solution, axis=0)).sum()), 9),
            float(np.abs(solution[0]).sum()),
        ),
    )
    deviation = np.arccos(np.clip(np.einsum("ni,ni->n", machine.axis(best), axis), -1.0, 1.0))
    if deviation.max() > AXIS_TOLERANCE_RAD:
        row = int(deviation.argmax())
        raise UnreachedAxisError(row, float(deviation[row]))
    return best


def _track_angles(axis: FloatArray, machine: Convention, side: int) -> FloatArray:
    """Return angles (N, 3) [rad] along a path of directions (N, 3) that starts with one of two solutions.

    ``side`` (0 or 1) selects the solution for the first direction that is not at a pole. At a pole, where the
    tilt is zero, the axis that carries the tilt rotates evenly to its next required angle. At poles at the
    start of the path it has this angle already.
    """
    out = np.zeros((len(axis), 3))
    at_pole = _at_pole(axis, machine)
    tilted_rows = np.flatnonzero(~at_pole)
    last = np.zeros(3)
    for row in tilted_rows:
        candidates = _nearest_solutions(axis[row], machine, last)
        chosen = min(side, len(candidates) - 1)
        if row > tilted_rows[0]:
            chosen = int(np.argmin([np.abs(candidate - last).sum() for candidate in candidates]))
        out[row] = last = candidates[chosen]
    for row in np.flatnonzero(at_pole):
        last = (
            np.array([np.interp(row, tilted_rows, out[tilted_rows, k]) for k in range(3)])
            if len(tilted_rows)
            else last
        )
        candidates = _nearest_solutions(axis[row], machine, last)
        out[row] = last = candidates[
            int(np.argmin([np.abs(candidate - last).sum() for candidate in candidates]))
        ]
    return out


def _nearest_solutions(vector: FloatArray, machine: Convention, last: FloatArray) -> list[FloatArray]:
    """Return the solutions (3,) [rad] for a direction, shifted by full turns to be close to ``last`` (3,)."""
    solutions = _solutions(vector, machine, last)
    return [solution + 2.0 * np.pi * np.round((last - solution) / (2.0 * np.pi)) for solution in solutions]


def _at_pole(axis: FloatArray, machine: Convention) -> NDArray[np.bool_]:
    """Return whether (N,) the tool is along the axis that carries the tilt; never with one rotary axis."""
    if len(machine.chain) == 1:
        return np.zeros(len(axis), dtype=np.bool_)
    about = ROTARY_NAMES.index(machine.chain[0][0])
    return np.asarray(np.linalg.norm(np.delete(axis, about, axis=1), axis=1) <= POLE_SINE)


def _solutions(vector: FloatArray, machine: Convention, last: FloatArray) -> list[FloatArray]:
    """Return all solutions for a direction, as angles (3,) [rad] of A, B and C.

    First the tilt, the axis next to the spindle, follows from the direction, then the carrier, the axis that
    carries the tilt. Two rotary axes have two solutions. At the pole of the carrier its ``last`` angle is
    kept.
    """
    x, y, z = vector.tolist()
    letters = [letter for letter, _ in machine.chain]
    signs = dict(machine.chain)
    solutions: list[dict[str, float]]
    if letters == ["A"]:
        solutions = [{"A": np.arctan2(-y, z)}]
    elif letters == ["B"]:
        solutions = [{"B": np.arctan2(x, z)}]
    elif letters[0] == "C":
        horizontal = float(np.hypot(x, y))
        tilt = float(np.arctan2(horizontal if horizontal > POLE_SINE else 0.0, z))
        last_carrier = signs["C"] * float(last[2])
        # A tilts +z towards -y, B towards +x. C then rotates the result to the required direction.
        carrier = (
            (np.arctan2(x, -y) if letters[1] == "A" else np.arctan2(y, x))
            if horizontal > POLE_SINE
            else last_carrier
        )
        solutions = [
            {letters[1]: tilt, "C": carrier},
            {letters[1]: -tilt, "C": carrier + np.pi if horizontal > POLE_SINE else carrier},
        ]
    elif letters == ["A", "B"]:
        cross = float(np.hypot(y, z))
        first = np.arctan2(-y, z) if cross > POLE_SINE else signs["A"] * float(last[0])
        solutions = [
            {"B": np.arctan2(x, cross), "A": first},
            {"B": np.arctan2(x, -cross), "A": first + np.pi},
        ]
    else:
        cross = float(np.hypot(x, z))
        first = np.arctan2(x, z) if cross > POLE_SINE else signs["B"] * float(last[1])
        solutions = [
            {"A": np.arctan2(-y, cross), "B": first},
            {"A": np.arctan2(-y, -cross), "B": first + np.pi},
        ]
    return [
        np.array([signs.get(name, 1) * solution.get(name, 0.0) for name in ROTARY_NAMES])
        for solution in solutions
    ]


def divide_path(
    path: MachinePath, machine: Convention
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Divide a path into blocks.

    Moves are bisected until the axis, whose angles change evenly, is within :data:`AXIS_TOLERANCE_RAD` of the
    plan's axis, which moves on great circles.

    Args:
        path: Path of an operation.
        machine: Rotary axes of the machine.

    Returns:
        Start of the program and ends of its blocks: tips (B, 3) [m], angles (B, 3) [rad], times (B,) [s], and
        the index (B,) of the target that each block leads to. The first one is the first target, to which no
        block leads.
    """
    positions = np.arange(len(path.tip), dtype=np.float64)
    block_angles = rotary_angles(path.axis, machine)
    for _ in range(MAX_BISECTIONS):
        middle = 0.5 * (positions[1:] + positions[:-1])
        straight = machine.axis(0.5 * (block_angles[1:] + block_angles[:-1]))
        deviation = np.linalg.norm(straight - _interpolate_axis(path, middle), axis=1)
        too_far = deviation > AXIS_TOLERANCE_RAD
        if not too_far.any():
            break
        positions = np.sort(np.concatenate([positions, middle[too_far]]))
        block_angles = rotary_angles(_interpolate_axis(path, positions), machine)
    rows = np.arange(len(path.tip))
    tip = np.stack([np.interp(positions, rows, path.tip[:, k]) for k in range(3)], axis=1)
    return tip, block_angles, np.interp(positions, rows, path.time), np.ceil(positions - 1e-12)


def _interpolate_axis(path: MachinePath, positions: FloatArray) -> FloatArray:
    """Return unit vectors (B, 3) at fractional indices (B,) of the path, on great circles between targets."""
    last = len(path.axis) - 1
    previous = np.minimum(positions.astype(np.intp), max(last - 1, 0))
    start, end = path.axis[previous], path.axis[np.minimum(previous + 1, last)]
    fraction = (positions - previous)[:, None]
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", start, end), -1.0, 1.0))[:, None]
    sine = np.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        spherical = (np.sin((1.0 - fraction) * angle) * start + np.sin(fraction * angle) * end) / sine
    mixed = np.where(sine > 1e-9, spherical, (1.0 - fraction) * start + fraction * end)
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def _operation_lines(path: MachinePath, machine: Convention) -> Iterator[str]:
    """Yield the lines of one operation: questions, rapid moves to the start, then moves with actions.

    Actions of a target follow the last block that leads to it.
    """
    tip, block_angles, time, target = divide_path(path, machine)
    used = [(letter, ROTARY_NAMES.index(letter)) for letter in machine.letters]
    degrees = block_angles / DEG

    def rotary(row: int) -> str:
        """Return the words of the rotary axes of block ``row``."""
        return " ".join(f"{letter}{degrees[row, k]:.5f}" for letter, k in used)

    span = ", ".join(f"{letter} {degrees[:, k].min():.3f} to {degrees[:, k].max():.3f}" for letter, k in used)
    feed = 60.0 / np.maximum(np.diff(time), 60.0 / MAX_FEED_PER_MIN)
    rates = np.abs(np.diff(degrees, axis=0)) * feed[:, None] / 60.0
    max_rates = rates.max(axis=0) if len(rates) else np.zeros(3)
    yield f"({_comment_text(path.name)}: {span} deg)"
    yield f"(fastest rotary axes: {', '.join(f'{letter} {max_rates[k]:.2f} deg/s' for letter, k in used)})"
    pending = list(path.actions)
    while pending and pending[0].target == 0 and pending[0].kind in ("message", "confirm"):
        yield from _action_lines(pending.pop(0), path)
    yield from _pause_lines("tool centre point control on, tool high above the stock?")
    x, y, z = (tip[0] / MM).tolist()
    yield f"G94 G0 {rotary(0)}"
    yield f"G0 X{x:.5f} Y{y:.5f}"
    yield f"G0 Z{z:.5f}"
    while pending and pending[0].target == 0:  # all questions come before the spindle starts
        yield from _action_lines(pending.pop(0), path)
    for i in range(1, len(tip)):
        yield from _segment_comment(path, int(target[i]), int(target[i - 1]))
        coordinates = " ".join(f"{word}{value:.5f}" for word, value in zip("XYZ", tip[i] / MM, strict=True))
        yield f"G93 G1 {coordinates} {rotary(i)} F{feed[i - 1]:.6f}"
        if i + 1 == len(tip) or target[i + 1] > target[i]:
            while pending and pending[0].target <= target[i]:
                yield from _action_lines(pending.pop(0), path)


def _segment_comment(path: MachinePath, target: int, previous: int) -> Iterator[str]:
    """Yield a comment with the segment of a target if the segment starts there."""
    segment = path.names[target].rpartition("/")[0]
    if target == previous:
        return
    if previous == 0 or segment != path.names[previous].rpartition("/")[0]:
        yield f"({_comment_text(segment)})"


def _action_lines(action: TargetAction, path: MachinePath) -> Iterator[str]:
    """Yield the lines of an action at a target, in standard G-code."""
    if action.kind in ("on", "off") and action.signal == path.signal:
        yield f"M3 S{round(path.spindle_rpm, 3):.10g}" if action.kind == "on" else "M5"
    elif action.kind == "wait":
        yield f"G94 G4 P{action.seconds:.3f}"
    elif action.kind == "confirm":
        yield from _pause_lines(action.text)
    elif action.kind == "message":
        yield f"(MSG, {_comment_text(action.text)})"
    else:
        yield from _pause_lines(f"switch {action.signal or action.kind} {action.kind} by hand")


def _pause_lines(text: str) -> Iterator[str]:
    yield f"(MSG, {_comment_text(text)})"
    yield "M0"


def _comment_text(text: str) -> str:
    """Return text that a comment can contain: printable ASCII without parentheses, on one line."""
    allowed = "".join(c if " " <= c <= "~" and c not in "()" else " " for c in text)
    return " ".join(allowed.split())
