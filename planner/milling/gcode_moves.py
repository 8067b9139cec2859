"""Moves of one line of G-code: straight ones, and arcs in the three planes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Final

from planner.milling import gcode_arcs
from planner.milling.gcode_faults import Faults
from planner.milling.gcode_rotary import CONVENTIONS
from planner.milling.gcode_rows import ARC_ROW, CUT_ROW, RAPID_ROW, Gathered
from planner.milling.gcode_state import CLOCKWISE, LINEAR, RAPID, Dialect, Modal, Triple, wanted
from planner.units import DEG

AXES: Final = "XYZ"
CENTRE: Final = "IJK"
ROTARY: Final = "ABC"
PLANES: Final = {2: "xy (G17)", 1: "zx (G18)", 0: "yz (G19)"}


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
    if (any(axis in values for axis in AXES) or "I" in values or "R" in values) and modal.unit is None:
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
            lost = ", ".join(axis for axis, value in zip(AXES, place, strict=True) if math.isnan(value))
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
    for axis, old, shift in zip(AXES, modal.place, modal.offset, strict=True):
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
        for i, word in enumerate(CENTRE):
            if word in values:
                if dialect.turns == "IJK":
                    out[i] = values[word]
                else:
                    message = (
                        f"{word} with a straight move, where no tool axis by I J K is stated; state "
                        "tool_axis: ijk, or take it out"
                    )
                    step.fault("gcode.rotary", word, message)
    for i, word in enumerate(ROTARY):
        if word in values:
            if word in dialect.turns:
                relative = 0.0 if modal.absolute else modal.turn[i]
                out[i] = relative + values[word] * DEG
            else:
                step.fault("gcode.rotary", word, _no_convention(word, dialect))
    return (out[0], out[1], out[2])


def _no_convention(word: str, dialect: Dialect) -> str:
    letters = "" if dialect.convention is None else dialect.convention.letters
    fit = " or ".join(name for name, own in CONVENTIONS.items() if {word, *letters} <= {*own.letters})
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
        sweep = gcode_arcs.sweep_of(start, end, centre, normal, clockwise)
    except gcode_arcs.ArcError as error:
        step.fault("gcode.arc", "arc", str(error))
        return
    feed = _feed(modal, step, gcode_arcs.length(start, end, centre, sweep, normal))
    found = gcode_arcs.points(start, end, centre, sweep, normal, step.dialect.chord).tolist()
    for number, (x, y, z) in enumerate(found, start=1):
        share = number / len(found)
        turn = [old + share * (new - old) for old, new in zip(modal.turn, after.turn, strict=True)]
        turned = (turn[0], turn[1], turn[2])
        step.out.add((x, y, z), turned, feed, ARC_ROW, modal.spindle, modal.tool, step.line)


def _centre(modal: Modal, step: Step, normal: int, end: Triple, clockwise: bool) -> tuple[float, float]:
    """The centre [m] in the plane; raises ``ArcError``."""
    unit, values = modal.unit or 1e-3, step.values
    plane = (normal + 1) % 3, (normal + 2) % 3
    if CENTRE[normal] in values:
        raise gcode_arcs.ArcError(
            f"{CENTRE[normal]} is no direction of the plane {PLANES[normal]}; take it out, or select "
            "the plane"
        )
    given = [i for i in plane if CENTRE[i] in values]
    if "R" in values:
        if given:
            raise gcode_arcs.ArcError("both R and a centre by I J K are given; keep one of them")
        return gcode_arcs.centre_of(modal.place, end, values["R"] * unit, normal, clockwise)
    if not given:
        raise gcode_arcs.ArcError("an arc without centre; give I J K or R")
    if modal.absolute_centre and len(given) < 2:
        both = " and ".join(CENTRE[i] for i in sorted(plane))
        raise gcode_arcs.ArcError(
            f"an absolute centre (G90.1) needs both {both}; add the one that is missing"
        )
    base = modal.offset if modal.absolute_centre else modal.place
    first, second = (base[i] + values.get(CENTRE[i], 0.0) * unit for i in plane)
    return first, second
