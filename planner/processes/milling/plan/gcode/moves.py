"""Moves of lines of G-code: straight ones, and arcs in the three planes, gathered as arrays.

Arcs are given by centre or by radius, and become points within a chord error. Arrays (`Rows`) are
in the file's own words. Faults are collected line by line: repeats are counted, first lines kept.
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
    wanted,
)
from planner.processes.milling.plan.tool_path import ARC, CUT
from planner.processes.milling.plan.tool_path import RAPID as RAPID_MOVE

EventKind = Literal["pause", "dwell"]

RAPID_ROW, CUT_ROW, ARC_ROW = 0, 1, 2
ROW_KINDS = (RAPID_MOVE, CUT, ARC)
"""Kinds of moves by their numbers in arrays."""


@dataclasses.dataclass(frozen=True)
class Event:
    """Something between two moves: ``at`` rows came before it. ``pause``: the operator goes on (M0, M1);
    ``dwell``: a wait of ``seconds`` (G4). ``line`` of the file, from 1."""

    at: int
    kind: EventKind
    line: int
    seconds: float = 0.0


@dataclasses.dataclass(frozen=True)
class Rows:
    """N moves: ``place`` (N, 3) [m] in the file's frame and ``turn`` (N, 3), I J K or angles [rad], at their
    ends; ``feed`` (N,) [m/s], infinite for rapid moves; ``kind`` (N,) index of ``ROW_KINDS``; ``spindle``
    (N,) [rad/s]; ``tool`` (N,), ``line`` (N,)."""

    place: FloatArray
    turn: FloatArray
    feed: FloatArray
    kind: IntArray
    spindle: FloatArray
    tool: IntArray
    line: IntArray


class Gathered:
    """Rows and events of a block, from single moves and from whole stretches."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._done: list[Rows] = []
        self._count = 0
        self._open: list[tuple[float, ...]] = []

    def __len__(self) -> int:
        return self._count + len(self._open)

    def add(
        self, place: Triple, turn: Triple, feed: float, kind: int, spindle: float, tool: int, line: int
    ) -> None:
        """One move."""
        self._open.append((*place, *turn, feed, kind, spindle, tool, line))

    def extend(self, rows: Rows) -> None:
        """A whole stretch."""
        self._close()
        self._done.append(rows)
        self._count += len(rows.line)

    def event(self, kind: EventKind, line: int, seconds: float = 0.0) -> None:
        """Something that happens after the moves so far."""
        self.events.append(Event(len(self), kind, line, seconds))

    def rows(self) -> Rows:
        """All moves so far, in order."""
        self._close()
        if not self._done:
            empty, whole = np.zeros(0), np.zeros(0, dtype=np.int64)
            return Rows(np.zeros((0, 3)), np.zeros((0, 3)), empty, whole, empty, whole, whole)
        return Rows(
            **{
                field.name: np.concatenate([getattr(rows, field.name) for rows in self._done])
                for field in dataclasses.fields(Rows)
            }
        )

    def _close(self) -> None:
        if self._open:
            table = np.array(self._open, dtype=np.float64)
            kind, tool, line = (table[:, i].astype(np.int64) for i in (7, 9, 10))
            rows = Rows(table[:, 0:3], table[:, 3:6], table[:, 6], kind, table[:, 8], tool, line)
            self._done.append(rows)
            self._count += len(table)
            self._open = []


LINES_NAMED: Final = 3
"""Lines that a fault names at most; the others are counted."""
MOST_FAULTS: Final = 50
"""Different faults of one file that are told; a file that is no G-code at all has one on each line."""


@dataclasses.dataclass
class _Fault:
    """One kind of fault: its first message, the first lines (from 1) that have it, and how many do."""

    message: str
    severity: Severity
    lines: list[int]
    count: int


class Faults:
    """Collects faults in bounded memory, whatever the length of the file."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.left_out = 0
        self._found: dict[tuple[str, str], _Fault] = {}

    def add(
        self,
        code: str,
        word: str,
        line: int,
        message: str,
        count: int = 1,
        severity: Severity = Severity.ERROR,
    ) -> None:
        """Note ``count`` lines, the first of which is ``line``; those of one code and word are one fault."""
        known = self._found.get((code, word))
        if known is not None:
            known.count += count
            if len(known.lines) < LINES_NAMED:
                known.lines.append(line)
        elif len(self._found) < MOST_FAULTS:
            self._found[code, word] = _Fault(message, severity, [line], count)
        else:
            self.left_out += count

    @property
    def errors(self) -> bool:
        """Whether the file is refused."""
        return has_errors(self.issues())

    def issues(self) -> tuple[Issue, ...]:
        """All faults, in the order in which the file has them, each with its first line."""
        out = [self._issue(*key, fault) for key, fault in self._found.items()]
        if self.left_out:
            what = f"{self.left_out} more faults of other kinds; see to these first"
            out.append(Issue("gcode.syntax", what, file=str(self.file)))
        return tuple(out)

    def _issue(self, code: str, word: str, fault: _Fault) -> Issue:
        message = fault.message
        if fault.count > 1:
            more = fault.count - len(fault.lines)
            shown = ", ".join(str(line) for line in fault.lines)
            message += f" [lines {shown}{f' and {more} more' if more else ''}]"
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

RADIUS_TOLERANCE: Final = 2e-5
"""How far [m] the radii at both ends of an arc may differ."""
RADIUS_SHARE: Final = 1e-3
"""The same as a share of the radius, where that is more. Files are rounded to 1 um or 0.0001 inch; a wrong
centre is off by millimetres."""
SAME_PLACE: Final = 1e-9
"""Places nearer to each other than this [m] are one."""
WIDEST_ARC_PIECE: Final = math.radians(30.0)
"""Longest piece [rad] of an arc."""


class ArcError(ValueError):
    """An arc that is none; the message says why and what to do."""


def centre_of(start: Point, end: Point, radius: float, normal: int, clockwise: bool) -> tuple[float, float]:
    """Centre [m] in the plane across axis ``normal`` of the arc of ``radius`` [m]: at most half a turn above
    zero, at least half a turn below.

    Raises :class:`ArcError` where the ends are farther apart than the diameter, or in one place.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    across, up = end[a] - start[a], end[b] - start[b]
    chord = math.hypot(across, up)
    if chord <= SAME_PLACE:
        raise ArcError("an arc by R whose ends are in one place has no centre; give a full circle by I J K")
    size = abs(radius)
    if chord > 2.0 * size + max(RADIUS_TOLERANCE, RADIUS_SHARE * size):
        raise ArcError(
            f"R is {size * 1e3:.4f} mm, but the ends are {chord * 1e3:.4f} mm apart, at most twice R is "
            f"allowed; correct the end, or give an R of {math.ceil(0.5e7 * chord) / 1e4:.4f} mm or more"
        )
    height = math.sqrt(max(size * size - 0.25 * chord * chord, 0.0))
    side = height if (radius > 0.0) != clockwise else -height
    return (0.5 * (start[a] + end[a]) - side * up / chord, 0.5 * (start[b] + end[b]) + side * across / chord)


def sweep_of(start: Point, end: Point, centre: tuple[float, float], normal: int, clockwise: bool) -> float:
    """Angle [rad] from start to end, positive counterclockwise seen from +``normal``; a full turn where both
    are in one place.

    Raises :class:`ArcError` where the radii at both ends differ, or are nothing.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    first = math.hypot(start[a] - centre[0], start[b] - centre[1])
    last = math.hypot(end[a] - centre[0], end[b] - centre[1])
    if min(first, last) <= SAME_PLACE:
        raise ArcError("the centre is at an end of the arc; correct I J K, which lead from the start to it")
    if abs(last - first) > max(RADIUS_TOLERANCE, RADIUS_SHARE * first):
        raise ArcError(
            f"the radius is {first * 1e3:.4f} mm at the start and {last * 1e3:.4f} mm at the end, allowed is "
            f"a difference of {max(RADIUS_TOLERANCE, RADIUS_SHARE * first) * 1e3:.4f} mm; correct the centre"
            f"{_fitting(start, end, centre, a, b)}, or "
            "state whether centres are incremental or absolute (arc_centre, G90.1, G91.1)"
        )
    if math.hypot(end[a] - start[a], end[b] - start[b]) <= SAME_PLACE:
        return -2.0 * math.pi if clockwise else 2.0 * math.pi
    before = math.atan2(start[b] - centre[1], start[a] - centre[0])
    after = math.atan2(end[b] - centre[1], end[a] - centre[0])
    turn = (before - after if clockwise else after - before) % (2.0 * math.pi)
    return -turn if clockwise else turn


def _fitting(start: Point, end: Point, centre: tuple[float, float], a: int, b: int) -> str:
    """The place nearest to the centre that is as far from both ends, as the words of an incremental one."""
    way = end[a] - start[a], end[b] - start[b]
    square = way[0] ** 2 + way[1] ** 2
    if square <= SAME_PLACE**2:
        return ""
    off = centre[0] - 0.5 * (start[a] + end[a]), centre[1] - 0.5 * (start[b] + end[b])
    share = (off[0] * way[0] + off[1] * way[1]) / square
    place = centre[0] - share * way[0] - start[a], centre[1] - share * way[1] - start[b]
    words = " ".join(f"{'IJK'[k]}{v * 1e3:.4f}" for k, v in sorted(zip((a, b), place, strict=True)))
    return f" (the nearest that fits is {words} mm from the start)"


def points(
    start: Point, end: Point, centre: tuple[float, float], sweep: float, normal: int, chord: float
) -> FloatArray:
    """Points (N, 3) [m] of an arc, or of a helix, without its start, within ``chord`` [m] of it between
    them.

    Angle, radius and the way along ``normal`` all grow evenly, so that small differences of the radii leave
    no jump. The last point is ``end`` itself.
    """
    a, b = (normal + 1) % 3, (normal + 2) % 3
    first = math.hypot(start[a] - centre[0], start[b] - centre[1])
    last = math.hypot(end[a] - centre[0], end[b] - centre[1])
    size = max(first, last)
    widest = 2.0 * math.acos(max(1.0 - chord / size, math.cos(0.5 * WIDEST_ARC_PIECE)))
    count = max(math.ceil(abs(sweep) / widest - 1e-9), 1)
    share = np.arange(1, count + 1) / count
    angle = math.atan2(start[b] - centre[1], start[a] - centre[0]) + share * sweep
    radius = first + share * (last - first)
    out = np.empty((count, 3))
    out[:, a] = centre[0] + radius * np.cos(angle)
    out[:, b] = centre[1] + radius * np.sin(angle)
    out[:, normal] = start[normal] + share * (end[normal] - start[normal])
    out[-1] = end
    return out


def length(start: Point, end: Point, centre: tuple[float, float], sweep: float, normal: int) -> float:
    """Length [m] of the arc or helix."""
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
class Step:
    """A line whose modes are set and whose motion is to be made: ``values`` of its words."""

    values: Mapping[str, float]
    line: int
    dialect: Dialect
    faults: Faults
    out: Gathered

    def fault(self, code: str, word: str, message: str) -> None:
        """Note a fault of this line."""
        self.faults.add(code, word, self.line, message)


def move(modal: Modal, step: Step) -> Modal:
    """The state after the line's move, whose rows are added; faults leave the state as if there were none."""
    motion = modal.motion
    if motion is None:
        message = (
            "a place without G0, G1, G2 or G3 before; write one, or state the field motion: rapid or linear"
        )
        step.fault("gcode.mode", "motion", message)
        motion = LINEAR
        modal = dataclasses.replace(modal, motion=LINEAR)
    values = step.values
    if (
        any(axis in values for axis in AXIS_LETTERS) or "I" in values or "R" in values
    ) and modal.unit is None:
        message = "lengths in no stated unit; write G20 or G21 before, or state the field unit: mm or in"
        step.fault("gcode.unit", "unit", message)
        modal = dataclasses.replace(modal, unit=1e-3)
    if modal.absolute is None:
        message = (
            "neither G90 nor G91 before; write one, or state the field distance: absolute or incremental"
        )
        step.fault("gcode.mode", "distance", message)
        modal = dataclasses.replace(modal, absolute=True)
    place = _place(modal, step)
    turn = _turn(modal, step, motion)
    after = dataclasses.replace(modal, place=place, turn=turn)
    if not wanted(modal, step.dialect):
        return dataclasses.replace(after, gap=True)
    if motion != RAPID and not _may_cut(modal, step):
        return after
    if any(math.isnan(value) for value in place):
        if motion != RAPID:
            lost = ", ".join(
                axis for axis, value in zip(AXIS_LETTERS, place, strict=True) if math.isnan(value)
            )
            message = f"a cut to a place of which no line says {lost}; begin with G0 X Y Z, or state start_mm"
            step.fault("gcode.position", "place", message)
        return after
    if motion == RAPID:
        step.out.add(place, turn, math.inf, RAPID_ROW, modal.spindle, modal.tool, step.line)
    elif motion == LINEAR:
        feed = _feed(modal, step, math.dist(modal.place, place))
        step.out.add(place, turn, feed, CUT_ROW, modal.spindle, modal.tool, step.line)
    else:
        _arc(modal, after, step, motion == CLOCKWISE)
    return dataclasses.replace(after, gap=False) if after.gap else after


def _place(modal: Modal, step: Step) -> Triple:
    unit = modal.unit or 1e-3
    out = []
    for axis, old, shift in zip(AXIS_LETTERS, modal.place, modal.offset, strict=True):
        value = step.values.get(axis)
        if value is None:
            out.append(old)
        elif modal.absolute:
            out.append(value * unit + shift)
        else:
            if math.isnan(old):
                message = f"{axis} by G91 from a place that no line says; give it by G90, or state start_mm"
                step.fault("gcode.position", axis, message)
                old = 0.0
            out.append(old + value * unit)
    return (out[0], out[1], out[2])


def _turn(modal: Modal, step: Step, motion: int) -> Triple:
    """The new I J K or angles; a straight move's I J K is the tool axis, an arc's its centre."""
    dialect, values = step.dialect, step.values
    out = list(modal.turn)
    if motion in (RAPID, LINEAR):
        for i, word in enumerate(CENTRE_LETTERS):
            if word in values:
                if dialect.turns == "IJK":
                    out[i] = values[word]
                else:
                    message = (
                        f"{word} with a straight move, where no tool axis by I J K is stated; state "
                        "tool_axis: ijk, or take it out"
                    )
                    step.fault("gcode.rotary", word, message)
    for i, word in enumerate(ROTARY_LETTERS):
        if word in values:
            if word in dialect.turns:
                relative = 0.0 if modal.absolute else modal.turn[i]
                out[i] = relative + values[word] * DEG
            else:
                step.fault("gcode.rotary", word, _no_convention(word, dialect))
    return (out[0], out[1], out[2])


def _no_convention(word: str, dialect: Dialect) -> str:
    letters = "" if dialect.convention is None else dialect.convention.letters
    fit = " or ".join(name for name, own in KINEMATICS.items() if {word, *letters} <= {*own.letters})
    if dialect.convention is None:
        return (
            f"{word} turns a machine that is stated nowhere; state tool_axis: rotary and its "
            f"convention: {fit}, which says what carries what"
        )
    do = f"state another convention: {fit}" if fit else "let the CAM system write I J K (tool_axis: ijk)"
    return f"{word} is no axis of a machine {dialect.convention.name}, which has {letters}; {do}"


def _may_cut(modal: Modal, step: Step) -> bool:
    if modal.spindle == 0.0:
        message = "a cut while the spindle stands; write M3 or M4 with S before, or state spindle_rpm"
        step.fault("gcode.spindle", "cut", message)
    if modal.gap:
        message = (
            f"tool {modal.tool} cuts before a rapid move leads it there from where it was changed; "
            "begin after M6 with G0 X Y Z"
        )
        step.fault("gcode.position", "tool", message)
        return False
    return True


def _feed(modal: Modal, step: Step, length: float) -> float:
    """Speed [m/s] of a cut of ``length`` [m]."""
    nothing = math.inf
    if modal.feed_mode == "inverse_time":
        if "F" not in step.values:
            step.fault("gcode.feed", "F", "every move with G93 needs an F of its own; add it")
            return nothing
        if math.isnan(length):  # the way to the first place is not the file's
            return nothing
        if length <= 0.0:
            message = "a turn in place within a stated time (G93): feeds of the tip cannot say it; use G94"
            step.fault("gcode.feed", "G93", message)
            return nothing
        return length * step.values["F"] / 60.0
    if modal.feed is None:
        message = "a cut whose feed is stated nowhere; write F before, or state feed_mm_min"
        step.fault("gcode.feed", "F", message)
        return nothing
    if modal.feed_mode == "per_rev":
        return modal.feed * abs(modal.spindle) / (2.0 * math.pi)
    return modal.feed


def _arc(modal: Modal, after: Modal, step: Step, clockwise: bool) -> None:
    normal = modal.plane
    if normal is None:
        message = (
            "an arc in no stated plane; write G17, G18 or G19 before, or state the field plane: xy, zx or yz"
        )
        step.fault("gcode.plane", "plane", message)
        normal = 2
    if any(math.isnan(value) for value in modal.place):
        message = "an arc from a place that no line says; begin with G0 X Y Z, or state start_mm"
        step.fault("gcode.position", "place", message)
        return
    start, end = modal.place, after.place
    try:
        centre = _centre(modal, step, normal, end, clockwise)
        sweep = sweep_of(start, end, centre, normal, clockwise)
    except ArcError as error:
        step.fault("gcode.arc", "arc", str(error))
        return
    feed = _feed(modal, step, length(start, end, centre, sweep, normal))
    found = points(start, end, centre, sweep, normal, step.dialect.chord).tolist()
    for number, (x, y, z) in enumerate(found, start=1):
        share = number / len(found)
        turn = [old + share * (new - old) for old, new in zip(modal.turn, after.turn, strict=True)]
        turned = (turn[0], turn[1], turn[2])
        step.out.add((x, y, z), turned, feed, ARC_ROW, modal.spindle, modal.tool, step.line)


def _centre(modal: Modal, step: Step, normal: int, end: Triple, clockwise: bool) -> tuple[float, float]:
    """The centre [m] in the plane; raises ``ArcError``."""
    unit, values = modal.unit or 1e-3, step.values
    plane = (normal + 1) % 3, (normal + 2) % 3
    if CENTRE_LETTERS[normal] in values:
        raise ArcError(
            f"{CENTRE_LETTERS[normal]} is no direction of the plane {PLANE_NAMES[normal]}; take it out, "
            "or select "
            "the plane"
        )
    given = [i for i in plane if CENTRE_LETTERS[i] in values]
    if "R" in values:
        if given:
            raise ArcError("both R and a centre by I J K are given; keep one of them")
        return centre_of(modal.place, end, values["R"] * unit, normal, clockwise)
    if not given:
        raise ArcError("an arc without centre; give I J K or R")
    if modal.absolute_centre and len(given) < 2:
        both = " and ".join(CENTRE_LETTERS[i] for i in sorted(plane))
        raise ArcError(f"an absolute centre (G90.1) needs both {both}; add the one that is missing")
    base = modal.offset if modal.absolute_centre else modal.place
    first, second = (base[i] + values.get(CENTRE_LETTERS[i], 0.0) * unit for i in plane)
    return first, second
