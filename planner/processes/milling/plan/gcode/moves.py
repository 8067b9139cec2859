"""Moves of G-code lines: straight moves, and arcs in the three planes, collected as arrays.

Arcs are given by centre or by radius, and become points within a chord error. Arrays (`MoveRows`) have
positions and angles in the file's frame. Faults are collected line by line: of repeated faults, the first
lines are kept and all are counted.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.units import DEG
from planner.issues import Issue, Severity, has_errors
from planner.processes.milling.plan.gcode.state import (
    CLOCKWISE,
    KINEMATICS,
    LINEAR,
    RAPID,
    Dialect,
    Modal,
    Triple,
    uses_tool,
)
from planner.processes.milling.plan.tool_path import ARC, CUT
from planner.processes.milling.plan.tool_path import RAPID as RAPID_MOVE

EventKind = Literal["pause", "dwell"]
"""Kind of an event: a pause, which the operator ends, or a dwell of a stated time."""

RAPID_ROW, CUT_ROW, ARC_ROW = 0, 1, 2
"""Numbers of the kinds of moves in arrays."""
ROW_KINDS = (RAPID_MOVE, CUT, ARC)
"""Kinds of moves, indexed by these numbers."""


@dataclasses.dataclass(frozen=True)
class GCodeEvent:
    """A pause or dwell between two moves.

    Attributes:
        row: Number of moves before it.
        kind: ``pause``, which the operator ends (M0, M1), or ``dwell`` (G4).
        line: Line of the file, from 1.
        seconds: Duration of a dwell [s].
    """

    row: int
    kind: EventKind
    line: int
    seconds: float = 0.0


@dataclasses.dataclass(frozen=True)
class MoveRows:
    """N moves as arrays.

    Attributes:
        position: Positions at their ends (N, 3) [m] in the file's frame.
        turn: I J K or angles [rad] at their ends (N, 3).
        feed: Speeds (N,) [m/s], infinite for rapid moves.
        kind: Index of ``ROW_KINDS`` (N,).
        spindle: Spindle speeds (N,) [rad/s].
        tool: Tool numbers (N,).
        line: Lines of the file (N,), from 1.
    """

    position: FloatArray
    turn: FloatArray
    feed: FloatArray
    kind: IntArray
    spindle: FloatArray
    tool: IntArray
    line: IntArray


class MoveRecorder:
    """Collects the moves and events of a block of lines, from single moves and from whole stretches."""

    def __init__(self) -> None:
        self.events: list[GCodeEvent] = []
        self._batches: list[MoveRows] = []
        self._count = 0
        self._pending: list[tuple[float, ...]] = []

    def __len__(self) -> int:
        return self._count + len(self._pending)

    def add(self, position: Triple, turn: Triple, feed: float, kind: int, modal: Modal, line: int) -> None:
        """Add one move.

        Args:
            position: Position at its end (3,) [m] in the file's frame.
            turn: I J K or angles [rad] at its end (3,).
            feed: Speed [m/s], infinite for a rapid move.
            kind: Index of ``ROW_KINDS``.
            modal: State of the controller, with the spindle speed and the tool.
            line: Line of the file, from 1.
        """
        self._pending.append((*position, *turn, feed, kind, modal.spindle, modal.tool, line))

    def extend(self, rows: MoveRows) -> None:
        """Add a whole stretch of moves."""
        self._flush()
        self._batches.append(rows)
        self._count += len(rows.line)

    def event(self, kind: EventKind, line: int, seconds: float = 0.0) -> None:
        """Add an event that happens after the moves so far."""
        self.events.append(GCodeEvent(len(self), kind, line, seconds))

    def rows(self) -> MoveRows:
        """Return all moves so far, in order."""
        self._flush()
        if not self._batches:
            no_values, no_numbers = np.zeros(0), np.zeros(0, dtype=np.int64)
            return MoveRows(
                np.zeros((0, 3)), np.zeros((0, 3)), no_values, no_numbers, no_values, no_numbers, no_numbers
            )
        return MoveRows(
            **{
                field.name: np.concatenate([getattr(rows, field.name) for rows in self._batches])
                for field in dataclasses.fields(MoveRows)
            }
        )

    def _flush(self) -> None:
        """Convert the single moves that were added to arrays."""
        if self._pending:
            table = np.array(self._pending, dtype=np.float64)
            kind, tool, line = (table[:, i].astype(np.int64) for i in (7, 9, 10))
            rows = MoveRows(table[:, 0:3], table[:, 3:6], table[:, 6], kind, table[:, 8], tool, line)
            self._batches.append(rows)
            self._count += len(table)
            self._pending = []


MAX_LINES_NAMED: Final = 3
"""Maximum number of lines that a fault names. The others are counted."""
MAX_FAULTS: Final = 50
"""Maximum number of different faults of one file that are reported.

A file that is not G-code may have a different fault on each line.
"""


@dataclasses.dataclass
class _LineFault:
    """One kind of fault: its first message, the first lines (from 1) that have it, and their number."""

    message: str
    severity: Severity
    lines: list[int]
    count: int


class LineFaults:
    """Collects faults in bounded memory, whatever the length of the file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.omitted = 0
        self._faults: dict[tuple[str, str], _LineFault] = {}

    def add(
        self,
        code: str,
        word: str,
        line: int,
        message: str,
        count: int = 1,
        severity: Severity = Severity.ERROR,
    ) -> None:
        """Add a fault. Faults with the same code and word are merged.

        Args:
            code: Code of the issue.
            word: Word of the line at fault.
            line: First line that has it.
            message: Problem and remedy.
            count: Number of lines that have it.
            severity: Severity of the issue.
        """
        earlier_fault = self._faults.get((code, word))
        if earlier_fault is not None:
            earlier_fault.count += count
            if len(earlier_fault.lines) < MAX_LINES_NAMED:
                earlier_fault.lines.append(line)
        elif len(self._faults) < MAX_FAULTS:
            self._faults[code, word] = _LineFault(message, severity, [line], count)
        else:
            self.omitted += count

    @property
    def errors(self) -> bool:
        """Whether the file is refused."""
        return has_errors(self.issues())

    def issues(self) -> tuple[Issue, ...]:
        """Return all faults in the order of the file, each with its first line."""
        out = [self._issue(*key, fault) for key, fault in self._faults.items()]
        if self.omitted:
            message = f"{self.omitted} more faults of other kinds are not listed; correct these first"
            out.append(Issue("gcode.syntax", message, file=str(self.file)))
        return tuple(out)

    def _issue(self, code: str, word: str, fault: _LineFault) -> Issue:
        """Return a fault as an issue, with its first lines and the number of others."""
        message = fault.message
        if fault.count > 1:
            other_count = fault.count - len(fault.lines)
            shown = ", ".join(str(line) for line in fault.lines)
            message += f" [lines {shown}{f' and {other_count} more' if other_count else ''}]"
        return Issue(
            code,
            message,
            fault.severity,
            file=str(self.file),
            line=fault.lines[0],
            field=word or None,
            count=fault.count,
        )


Point = Sequence[float]
"""Coordinates x, y, z [m] of a point."""

RADIUS_TOLERANCE_M: Final = 2e-5
"""Allowed difference of the radii at both ends of an arc [m]."""
RADIUS_TOLERANCE_FRACTION: Final = 1e-3
"""Allowed difference of the radii as a fraction of the radius, if that is more than
:data:`RADIUS_TOLERANCE_M`.

Files are rounded to 1 um or 0.0001 inch. A wrong centre differs by millimetres.
"""
POINT_TOLERANCE_M: Final = 1e-9
"""Distance [m] up to which positions count as equal."""
MAX_ARC_PIECE_RAD: Final = math.radians(30.0)
"""Maximum angle of a piece of an arc [rad]."""


class ArcError(ValueError):
    """An arc that does not exist. The message says why and what to do."""


def arc_centre(start: Point, end: Point, radius: float, normal: int, clockwise: bool) -> tuple[float, float]:
    """Return the centre (2,) [m] of an arc by radius, in the plane normal to axis ``normal``.

    Args:
        start: Start of the arc [m].
        end: End of the arc [m].
        radius: Radius [m]; positive for at most half a revolution, negative for at least half.
        normal: Index of the plane's normal.
        clockwise: Direction of the arc.

    Raises:
        ArcError: The ends are farther apart than the diameter, or coincide.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    across, up = end[a] - start[a], end[b] - start[b]
    chord = math.hypot(across, up)
    if chord <= POINT_TOLERANCE_M:
        raise ArcError("an arc by R with coincident ends has no centre; give a full circle by I J K")
    size = abs(radius)
    if chord > 2.0 * size + max(RADIUS_TOLERANCE_M, RADIUS_TOLERANCE_FRACTION * size):
        raise ArcError(
            f"R is {size * 1e3:.4f} mm, but the ends are {chord * 1e3:.4f} mm apart, allowed is twice R; "
            f"correct the end, or give an R of {math.ceil(0.5e7 * chord) / 1e4:.4f} mm or more"
        )
    # The centre is at this height above the chord, on the left of it for positive ``side``.
    height = math.sqrt(max(size * size - 0.25 * chord * chord, 0.0))
    side = height if (radius > 0.0) != clockwise else -height
    return (0.5 * (start[a] + end[a]) - side * up / chord, 0.5 * (start[b] + end[b]) + side * across / chord)


def arc_sweep(start: Point, end: Point, centre: tuple[float, float], normal: int, clockwise: bool) -> float:
    """Return the angle [rad] of an arc from start to end, positive counterclockwise seen from +``normal``.

    It is a full revolution if start and end coincide.

    Args:
        start: Start of the arc [m].
        end: End of the arc [m].
        centre: Centre in the plane [m].
        normal: Index of the plane's normal.
        clockwise: Direction of the arc.

    Raises:
        ArcError: The radii at both ends differ, or are zero.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    first = math.hypot(start[a] - centre[0], start[b] - centre[1])
    last = math.hypot(end[a] - centre[0], end[b] - centre[1])
    if min(first, last) <= POINT_TOLERANCE_M:
        raise ArcError("the centre is at an end of the arc; correct I J K, which lead from the start to it")
    if abs(last - first) > max(RADIUS_TOLERANCE_M, RADIUS_TOLERANCE_FRACTION * first):
        raise ArcError(
            f"the radius is {first * 1e3:.4f} mm at the start and {last * 1e3:.4f} mm at the end, allowed "
            f"difference {max(RADIUS_TOLERANCE_M, RADIUS_TOLERANCE_FRACTION * first) * 1e3:.4f} mm; correct "
            f"the centre{_centre_hint(start, end, centre, a, b)}, or state whether centres are incremental "
            "or absolute (arc_centre, G90.1, G91.1)"
        )
    if math.hypot(end[a] - start[a], end[b] - start[b]) <= POINT_TOLERANCE_M:
        return -2.0 * math.pi if clockwise else 2.0 * math.pi
    start_angle = math.atan2(start[b] - centre[1], start[a] - centre[0])
    end_angle = math.atan2(end[b] - centre[1], end[a] - centre[0])
    sweep = (start_angle - end_angle if clockwise else end_angle - start_angle) % (2.0 * math.pi)
    return -sweep if clockwise else sweep


def _centre_hint(start: Point, end: Point, centre: tuple[float, float], a: int, b: int) -> str:
    """Return a text with the nearest centre at equal distance from both ends, as incremental words I J K.

    ``a`` and ``b`` are the indices of the axes of the plane. The text is "" if start and end coincide.
    """
    chord = end[a] - start[a], end[b] - start[b]
    square = chord[0] ** 2 + chord[1] ** 2
    if square <= POINT_TOLERANCE_M**2:
        return ""
    offset = centre[0] - 0.5 * (start[a] + end[a]), centre[1] - 0.5 * (start[b] + end[b])
    fraction = (offset[0] * chord[0] + offset[1] * chord[1]) / square
    start_offset = centre[0] - fraction * chord[0] - start[a], centre[1] - fraction * chord[1] - start[b]
    words = " ".join(f"{'IJK'[k]}{v * 1e3:.4f}" for k, v in sorted(zip((a, b), start_offset, strict=True)))
    return f" (the nearest that fits is {words} mm from the start)"


def arc_points(
    start: Point, end: Point, centre: tuple[float, float], sweep: float, normal: int, chord: float
) -> FloatArray:
    """Return points (N, 3) [m] of an arc or helix, without its start.

    Angle, radius and the coordinate along ``normal`` change linearly, so that small differences of the radii
    leave no jump. The last point is ``end`` itself.

    Args:
        start: Start of the arc [m].
        end: End of the arc [m].
        centre: Centre in the plane [m].
        sweep: Angle from start to end [rad].
        normal: Index of the plane's normal.
        chord: Chord error between the points [m].
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    first = math.hypot(start[a] - centre[0], start[b] - centre[1])
    last = math.hypot(end[a] - centre[0], end[b] - centre[1])
    size = max(first, last)
    max_piece = 2.0 * math.acos(max(1.0 - chord / size, math.cos(0.5 * MAX_ARC_PIECE_RAD)))
    count = max(math.ceil(abs(sweep) / max_piece - 1e-9), 1)
    fraction = np.arange(1, count + 1) / count
    angle = math.atan2(start[b] - centre[1], start[a] - centre[0]) + fraction * sweep
    radius = first + fraction * (last - first)
    out = np.empty((count, 3))
    out[:, a] = centre[0] + radius * np.cos(angle)
    out[:, b] = centre[1] + radius * np.sin(angle)
    out[:, normal] = start[normal] + fraction * (end[normal] - start[normal])
    out[-1] = end
    return out


def arc_length(start: Point, end: Point, centre: tuple[float, float], sweep: float, normal: int) -> float:
    """Return the length [m] of an arc or helix. For the arguments see :func:`arc_points`."""
    a, b = (normal + 1) % 3, (normal + 2) % 3
    radius = math.hypot(start[a] - centre[0], start[b] - centre[1])
    return math.hypot(radius * sweep, end[normal] - start[normal])


AXIS_LETTERS: Final = "XYZ"
"""Words of positions."""
CENTRE_LETTERS: Final = "IJK"
"""Words of arc centres."""
ROTARY_LETTERS: Final = "ABC"
"""Words of rotary axes."""
PLANE_NAMES: Final = {2: "xy (G17)", 1: "zx (G18)", 0: "yz (G19)"}
"""Planes in words, by their normals."""


@dataclasses.dataclass(frozen=True)
class LineStep:
    """A line while it is executed.

    Attributes:
        values: Values of its words by their letters, without codes.
        line: Number of the line, from 1.
        dialect: What the problem states about the file.
        faults: Collects faults.
        out: Collects moves and events.
    """

    values: Mapping[str, float]
    line: int
    dialect: Dialect
    faults: LineFaults
    out: MoveRecorder

    def fault(self, code: str, word: str, message: str) -> None:
        """Add a fault of this line."""
        self.faults.add(code, word, self.line, message)


def execute_move(modal: Modal, step: LineStep) -> Modal:
    """Execute the move of a line, record it, and return the state after it.

    Values that are missing are reported and replaced by usual ones, so that the next lines can be read. Moves
    of tools that are not used, and moves to an unknown position, are not recorded.

    Args:
        modal: State before the move.
        step: The line.
    """
    motion = modal.motion
    if motion is None:
        message = (
            "a position without G0, G1, G2 or G3 before; write one, or state the field motion: rapid or "
            "linear"
        )
        step.fault("gcode.mode", "motion", message)
        motion = LINEAR
        modal = dataclasses.replace(modal, motion=LINEAR)
    values = step.values
    if (
        any(axis in values for axis in AXIS_LETTERS) or "I" in values or "R" in values
    ) and modal.unit is None:
        message = "lengths without a unit; write G20 or G21 before, or state the field unit: mm or in"
        step.fault("gcode.unit", "unit", message)
        modal = dataclasses.replace(modal, unit=1e-3)
    if modal.absolute is None:
        message = (
            "neither G90 nor G91 before; write one, or state the field distance: absolute or incremental"
        )
        step.fault("gcode.mode", "distance", message)
        modal = dataclasses.replace(modal, absolute=True)
    position = _target_position(modal, step)
    rotation = _target_rotation(modal, step, motion)
    after = dataclasses.replace(modal, position=position, turn=rotation)
    if not uses_tool(modal, step.dialect):
        return dataclasses.replace(after, gap=True)
    if motion != RAPID and not _check_cut(modal, step):
        return after
    if any(math.isnan(value) for value in position):
        if motion != RAPID:
            unknown = ", ".join(
                axis for axis, value in zip(AXIS_LETTERS, position, strict=True) if math.isnan(value)
            )
            message = f"a cut to a position with unknown {unknown}; start with G0 X Y Z, or state start_mm"
            step.fault("gcode.position", "place", message)
        return after
    if motion == RAPID:
        step.out.add(position, rotation, math.inf, RAPID_ROW, modal, step.line)
    elif motion == LINEAR:
        feed = _cut_feed(modal, step, math.dist(modal.position, position))
        step.out.add(position, rotation, feed, CUT_ROW, modal, step.line)
    else:
        _add_arc(modal, after, step, motion == CLOCKWISE)
    return dataclasses.replace(after, gap=False) if after.gap else after


def _target_position(modal: Modal, step: LineStep) -> Triple:
    """Return the position [m] at the end of a line's move. Axes without a word keep their coordinate."""
    unit = modal.unit or 1e-3
    out = []
    for axis, old, shift in zip(AXIS_LETTERS, modal.position, modal.offset, strict=True):
        value = step.values.get(axis)
        if value is None:
            out.append(old)
        elif modal.absolute:
            out.append(value * unit + shift)
        else:
            if math.isnan(old):
                message = f"{axis} by G91 from an unknown position; give it by G90, or state start_mm"
                step.fault("gcode.position", axis, message)
                old = 0.0
            out.append(old + value * unit)
    return (out[0], out[1], out[2])


def _target_rotation(modal: Modal, step: LineStep, motion: int) -> Triple:
    """Return I J K, or the angles of A B C [rad], at the end of a line's move.

    I J K of a straight move is the tool axis, that of an arc its centre.
    """
    dialect, values = step.dialect, step.values
    out = list(modal.turn)  # the last I J K, or angles of A B C
    if motion in (RAPID, LINEAR):
        for i, word in enumerate(CENTRE_LETTERS):
            if word in values:
                if dialect.rotation_words == "IJK":
                    out[i] = values[word]
                else:
                    message = (
                        f"{word} with a straight move, but no tool axis by I J K is stated; state "
                        "tool_axis: ijk, or remove the word"
                    )
                    step.fault("gcode.rotary", word, message)
    for i, word in enumerate(ROTARY_LETTERS):
        if word in values:
            if word in dialect.rotation_words:
                relative = 0.0 if modal.absolute else modal.turn[i]
                out[i] = relative + values[word] * DEG
            else:
                step.fault("gcode.rotary", word, _rotary_reason(word, dialect))
    return (out[0], out[1], out[2])


def _rotary_reason(word: str, dialect: Dialect) -> str:
    """Return the message about a rotary word that the stated machine does not have."""
    letters = "" if dialect.convention is None else dialect.convention.letters
    suitable = " or ".join(
        name for name, convention in KINEMATICS.items() if {word, *letters} <= {*convention.letters}
    )
    if dialect.convention is None:
        return (
            f"{word} belongs to a machine that the problem does not state; state tool_axis: rotary and its "
            f"convention: {suitable}, which says which axis carries which"
        )
    remedy = (
        f"state another convention: {suitable}"
        if suitable
        else "let the CAM system write I J K (tool_axis: ijk)"
    )
    return f"{word} is not an axis of a machine {dialect.convention.name}, which has {letters}; {remedy}"


def _check_cut(modal: Modal, step: LineStep) -> bool:
    """Report faults of a cut before its move, and return whether its start is known.

    It is unknown if the tool was changed and has not been positioned since (``modal.gap``).
    """
    if modal.spindle == 0.0:
        message = "a cut while the spindle is stopped; write M3 or M4 with S before, or state spindle_rpm"
        step.fault("gcode.spindle", "cut", message)
    if modal.gap:
        message = (
            f"tool {modal.tool} cuts before a rapid move takes it there from where it was changed; "
            "start with G0 X Y Z after M6"
        )
        step.fault("gcode.position", "tool", message)
        return False
    return True


def _cut_feed(modal: Modal, step: LineStep, length: float) -> float:
    """Return the speed [m/s] of a cut over ``length`` [m], infinite after a fault."""
    no_feed = math.inf
    if modal.feed_mode == "inverse_time":
        if "F" not in step.values:
            step.fault("gcode.feed", "F", "every move with G93 needs its own F; add it")
            return no_feed
        if math.isnan(length):  # the move to the first position is not part of the file
            return no_feed
        if length <= 0.0:
            message = "a rotation in place with G93 cannot be expressed as a feed of the tip; use G94"
            step.fault("gcode.feed", "G93", message)
            return no_feed
        return length * step.values["F"] / 60.0
    if modal.feed is None:
        message = "a cut without a feed; write F before, or state feed_mm_min"
        step.fault("gcode.feed", "F", message)
        return no_feed
    if modal.feed_mode == "per_rev":
        return modal.feed * abs(modal.spindle) / (2.0 * math.pi)
    return modal.feed


def _add_arc(modal: Modal, after: Modal, step: LineStep, clockwise: bool) -> None:
    """Record an arc from the position of state ``modal`` to that of state ``after`` as straight pieces."""
    normal = modal.plane
    if normal is None:
        message = (
            "an arc without a plane; write G17, G18 or G19 before, or state the field plane: xy, zx or yz"
        )
        step.fault("gcode.plane", "plane", message)
        normal = 2
    if any(math.isnan(value) for value in modal.position):
        message = "an arc from an unknown position; start with G0 X Y Z, or state start_mm"
        step.fault("gcode.position", "place", message)
        return
    start, end = modal.position, after.position
    try:
        centre = _find_centre(modal, step, normal, end, clockwise)
        sweep = arc_sweep(start, end, centre, normal, clockwise)
    except ArcError as error:
        step.fault("gcode.arc", "arc", str(error))
        return
    feed = _cut_feed(modal, step, arc_length(start, end, centre, sweep, normal))
    arc = arc_points(start, end, centre, sweep, normal, step.dialect.chord).tolist()
    for number, (x, y, z) in enumerate(arc, start=1):
        fraction = number / len(arc)
        rotation = [old + fraction * (new - old) for old, new in zip(modal.turn, after.turn, strict=True)]
        row_rotation = (rotation[0], rotation[1], rotation[2])
        step.out.add((x, y, z), row_rotation, feed, ARC_ROW, modal, step.line)


def _find_centre(
    modal: Modal, step: LineStep, normal: int, end: Triple, clockwise: bool
) -> tuple[float, float]:
    """Return the two coordinates [m] in the plane of the centre of an arc, from I J K or R.

    Raises:
        ArcError: The centre is missing or contradictory.
    """
    unit, values = modal.unit or 1e-3, step.values
    plane = (normal + 1) % 3, (normal + 2) % 3
    if CENTRE_LETTERS[normal] in values:
        raise ArcError(
            f"{CENTRE_LETTERS[normal]} is not a direction of the plane {PLANE_NAMES[normal]}; remove it, "
            "or select "
            "the plane"
        )
    given_axes = [i for i in plane if CENTRE_LETTERS[i] in values]
    if "R" in values:
        if given_axes:
            raise ArcError("both R and a centre by I J K are given; keep one of them")
        return arc_centre(modal.position, end, values["R"] * unit, normal, clockwise)
    if not given_axes:
        raise ArcError("an arc without a centre; give I J K or R")
    if modal.absolute_centre and len(given_axes) < 2:
        axis_names = " and ".join(CENTRE_LETTERS[i] for i in sorted(plane))
        raise ArcError(f"an absolute centre (G90.1) needs both {axis_names}; add the one that is missing")
    base = modal.offset if modal.absolute_centre else modal.position
    first, second = (base[i] + values.get(CENTRE_LETTERS[i], 0.0) * unit for i in plane)
    return first, second
