"""Any one line of G-code: its words, its G and M codes by modal group, and what they do.

Modes first, then dwell, motion and stop, as controllers do it. Words are letters with numbers,
without comments and white space. For codes that are not read there is a reason (`why_not`).
"""

import dataclasses
import math
import re
from typing import Any, Final

from planner.issues import Severity
from planner.processes.milling.plan.gcode.moves import (
    AXIS_LETTERS,
    CENTRE_LETTERS,
    ROTARY_LETTERS,
    Faults,
    Gathered,
    Step,
    move,
)
from planner.processes.milling.plan.gcode.state import INCH, Dialect, Modal, wanted

Word = tuple[str, float]

MOST_CHARACTERS: Final = 256
"""Characters of a line's words, as controllers allow (RS274/NGC); no number is too large then."""
COMMENT_PATTERN: Final = re.compile(r"\([^()]*\)|;.*")
"""Comments: in parentheses, or from a semicolon to the end of the line."""
WORD_PATTERN: Final = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
"""A letter and its number."""


class LineError(ValueError):
    """A line that is no G-code: ``word`` is the text at fault, the message says what to do."""

    def __init__(self, word: str, message: str) -> None:
        super().__init__(message)
        self.word = word


def bare(line: str) -> str:
    """The line in capitals, without comments and white space, which mean nothing anywhere in a line.

    Raises :class:`LineError` where a comment is not closed.
    """
    if "(" in line or ";" in line or ")" in line:
        line = COMMENT_PATTERN.sub("", line)
        if "(" in line or ")" in line:
            raise LineError("(", "a comment is opened or closed but not both; pair ( and ) within the line")
    return "".join(line.split()).upper()


def words(text: str) -> list[Word]:
    """The words of a bare line, in order, their numbers as they stand. Raises :class:`LineError`."""
    found = WORD_PATTERN.findall(text)
    if sum(len(number) for _, number in found) + len(found) != len(text):
        raise _refuse(text)
    if len(text) > MOST_CHARACTERS:
        raise LineError(
            "", f"{len(text)} characters of words on a line, at most {MOST_CHARACTERS} are read; part it"
        )
    return [(letter, float(number)) for letter, number in found]


def code(letter: str, value: float) -> str:
    """The usual name of a code, ``G1``, ``G90.1``."""
    return f"{letter}{value:g}"


def _refuse(text: str) -> LineError:
    place = 0
    while (met := WORD_PATTERN.match(text, place)) is not None:
        place = met.end()
    rest = text[place : place + 12]
    if rest[0] in "#[]=*<" or (len(rest) > 1 and rest[1] in "#["):
        what = "parameters and expressions are not computed; let the CAM system write plain numbers"
        return LineError(rest[0], f"got {rest!r}: {what}")
    if rest[0].isalpha() and rest[0].isascii():
        what = "the word has no number, or one that is not written as 12, 12., .5 or -1.5; correct it"
        return LineError(rest[0], f"got {rest!r}: {what}")
    return LineError("", f"got {rest!r}, which is no word of G-code (a letter and a number); correct it")


MOTION_CODES: Final = {"G0": 0, "G1": 1, "G2": 2, "G3": 3}
"""Modes of motion: rapid, straight, arc clockwise, arc counterclockwise."""
PLANE_CODES: Final = {"G17": 2, "G18": 1, "G19": 0}
"""Planes by their normals: xy, zx, yz."""

MODAL_GROUPS: Final[dict[str, str]] = {
    **dict.fromkeys(MOTION_CODES, "motion"),
    **dict.fromkeys(PLANE_CODES, "plane"),
    **dict.fromkeys(("G20", "G21"), "unit"),
    **dict.fromkeys(("G90", "G91"), "distance"),
    **dict.fromkeys(("G90.1", "G91.1"), "centre"),
    **dict.fromkeys(("G93", "G94", "G95"), "feed"),
    **dict.fromkeys(("G54", "G55", "G56", "G57", "G58", "G59"), "offset"),
    **dict.fromkeys(("G43", "G43.4", "G49"), "length"),
    "G40": "radius",
    "G80": "cycle",
    "G4": "dwell",
    **dict.fromkeys(("M0", "M1", "M2", "M30"), "stop"),
    **dict.fromkeys(("M3", "M4", "M5"), "spindle"),
    "M6": "tool",
}
"""Two codes of one group on a line contradict each other."""

CODES_WITH_AXES: Final = frozenset({"G10", "G28", "G30", "G52", "G53", "G92"})
"""Codes that take the axis words of their line, so that these are passed over with them."""

ARGUMENT_LETTERS: Final = "DEHLPQ"
"""Words that belong to codes; beside one that is not carried out they are passed over with it."""

_CYCLE_REASON = "canned cycles are not carried out; let the CAM system write them as moves"
_OFFSET_REASON = "places of the file are stated in the problem (origin, offsets); take it out"
_HOME_REASON = "the robot goes home its own safe way; take the line out, or name the code in skip"
_COMPENSATION_REASON = (
    "the radius of the tool is not offset here; let the CAM system write the path of the tip"
)
_PATH_MODE_REASON = "how exactly corners are passed is for the problem's tolerances to say; name it in skip"
_COOLANT_REASON = "no signal is known for coolant; name it in skip and switch it by hand"
_SPLINE_REASON = "only straight moves and arcs are read; let the CAM system write these"
_SUBPROGRAM_REASON = "subprograms and variables are not read; let the CAM system write one plain program"
"""Why codes of each kind are refused, and what to do."""

REFUSALS: Final[dict[str, str]] = {
    **{f"G{n}": _CYCLE_REASON for n in (73, 74, 76, 81, 82, 83, 84, 85, 86, 87, 88, 89)},
    **dict.fromkeys(("G10", "G52", "G92"), _OFFSET_REASON),
    **dict.fromkeys(("G53", "G28", "G30"), _HOME_REASON),
    **dict.fromkeys(("G41", "G42"), _COMPENSATION_REASON),
    **dict.fromkeys(("G61", "G64"), _PATH_MODE_REASON),
    **dict.fromkeys(("M7", "M8", "M9"), _COOLANT_REASON),
    **dict.fromkeys(("G5", "G5.1", "G5.2", "G6.2"), _SPLINE_REASON),
    **dict.fromkeys(("G65", "G66", "M98", "M99"), _SUBPROGRAM_REASON),
    "G70": "inches are G20; write that",
    "G71": "millimetres are G21; write that",
}
"""Why each of these codes is refused, and what to do."""


def why_not(name: str) -> str:
    """Why a code is not carried out, and what to do."""
    return REFUSALS.get(
        name, "this code is not known; take it out, or name it in skip if it may be passed over"
    )


SECONDS_PER_MINUTE: Final = 60.0
"""Feeds are stated per minute."""
RADIANS_PER_TURN: Final = 2.0 * math.pi
"""Spindle speeds are stated in turns a minute."""


def execute(text: str, line: int, modal: Modal, dialect: Dialect, faults: Faults, out: Gathered) -> Modal:
    """The state after line ``line`` of the file; its moves and events are added to ``out``."""
    stripped = text.strip()
    if stripped.startswith("/"):
        if dialect.block_delete is None:
            message = (
                "a line with / is run or not as a switch stands; state block_delete, true to leave it out"
            )
            faults.add("gcode.mode", "/", line, message)
        if dialect.block_delete:
            return modal
        stripped = stripped[1:]
    try:
        content = bare(stripped)
        if content == "%":
            over = modal.started or modal.marks > 0
            return dataclasses.replace(modal, marks=modal.marks + 1, ended=over)
        if not content or (content[0] == "O" and content[1:].isdigit()):
            return modal
        found = words(content)
    except LineError as error:
        faults.add("gcode.syntax", error.word, line, str(error))
        return modal
    if modal.ended:
        message = "the program is over before this line (M2, M30 or %), which is not run; take it out"
        faults.add("gcode.after_end", "", line, message, severity=Severity.WARNING)
        return modal
    return _run(found, line, _changed(modal, {"started": True}), dialect, faults, out)


def _run(
    found: list[Word], line: int, modal: Modal, dialect: Dialect, faults: Faults, out: Gathered
) -> Modal:
    names, values = _sorted(found, line, dialect, faults)
    step = Step(values, line, dialect, faults, out)
    modal = _changed(modal, _modes(names, modal, step))
    modal = _changed(modal, _numbers(modal, step))
    modal = _tool(names, modal, step)
    modal = _changed(modal, _spindle(names, modal, step))
    if "G4" in names:
        _dwell(modal, step)
    moving = any(word in values for word in AXIS_LETTERS + ROTARY_LETTERS + CENTRE_LETTERS + "R")
    _strays(names, modal, step, moving)
    if moving:
        modal = move(modal, step)
    if ("M0" in names or "M1" in names) and wanted(modal, dialect):
        out.event("pause", line)
    if "M2" in names or "M30" in names:
        modal = dataclasses.replace(modal, ended=True)
    return modal


def _changed(modal: Modal, change: dict[str, Any]) -> Modal:
    """The state with some fields changed; the same one where they are as they were, as on most lines."""
    if all(getattr(modal, name) == value for name, value in change.items()):
        return modal
    return dataclasses.replace(modal, **change)


def _sorted(
    found: list[Word], line: int, dialect: Dialect, faults: Faults
) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names of the line's codes that are carried out, and the values of its other words."""
    names: dict[str, str] = {}
    values: dict[str, float] = {}
    refused = dropped = False
    for letter, value in found:
        if letter in "GM":
            name = code(letter, value)
            if name in dialect.skip:
                message = f"{name} is passed over, as the problem says"
                faults.add("gcode.skipped", name, line, message, severity=Severity.NOTE)
                refused, dropped = True, dropped or name in CODES_WITH_AXES
            elif name not in MODAL_GROUPS:
                faults.add("gcode.word", name, line, f"{name}: {why_not(name)}")
                refused, dropped = True, dropped or name in CODES_WITH_AXES
            elif MODAL_GROUPS[name] in names and names[MODAL_GROUPS[name]] != name:
                other = names[MODAL_GROUPS[name]]
                message = f"{other} and {name} on one line contradict each other; keep one"
                faults.add("gcode.word", name, line, message)
            else:
                names[MODAL_GROUPS[name]] = name
        elif letter in values:
            message = f"{letter} stands twice on a line; keep one, or part the line"
            faults.add("gcode.syntax", letter, line, message)
        else:
            values[letter] = value
    out = (AXIS_LETTERS + ROTARY_LETTERS if dropped else "") + (ARGUMENT_LETTERS if refused else "")
    values = {letter: value for letter, value in values.items() if letter not in out} if out else values
    return tuple(names.values()), values


def _modes(names: tuple[str, ...], modal: Modal, step: Step) -> dict[str, Any]:
    """Changes of modes by the G codes of a line."""
    change: dict[str, Any] = {}
    for name in names:
        if name in MOTION_CODES:
            change["motion"] = MOTION_CODES[name]
        elif name in PLANE_CODES:
            change["plane"] = PLANE_CODES[name]
        elif name in ("G20", "G21"):
            change["unit"] = INCH if name == "G20" else 1e-3
        elif name in ("G90", "G91"):
            change["absolute"] = name == "G90"
        elif name in ("G90.1", "G91.1"):
            change["absolute_centre"] = name == "G90.1"
        elif name in ("G93", "G94", "G95"):
            mode = {"G93": "inverse_time", "G94": "per_minute", "G95": "per_rev"}[name]
            change["feed_mode"] = mode
            if mode != (modal.feed_mode or "per_minute"):  # the problem states feeds a minute
                change["feed"] = None
        elif MODAL_GROUPS[name] == "offset":
            change["offset"] = _offset(name, modal, step)
    return change


def _offset(name: str, modal: Modal, step: Step) -> Any:
    known = step.dialect.offsets.get(int(name[1:]))
    if known is None:
        message = f"{name}: the problem does not say where that is; add it to offsets, or take it out"
        step.fault("gcode.offset", name, message)
        return modal.offset
    return known


def _numbers(modal: Modal, step: Step) -> dict[str, Any]:
    change: dict[str, Any] = {}
    feed, speed, tool = (step.values.get(word) for word in "FST")
    if feed is not None and feed <= 0.0:
        step.fault("gcode.feed", "F", f"got F{feed:g}, a feed is above 0; correct it")
    elif feed is not None:
        if modal.feed_mode is None:
            message = (
                "F without G93, G94 or G95 before; write one, or state the field feed_mode: per_minute, "
                "inverse_time or per_rev"
            )
            step.fault("gcode.feed", "feed_mode", message)
            change["feed_mode"] = "per_minute"
        if modal.feed_mode != "inverse_time" and modal.unit is None:
            message = "F in no stated unit; write G20 or G21 before, or state the field unit: mm or in"
            step.fault("gcode.unit", "unit", message)
            change["unit"] = 1e-3
        unit = modal.unit or 1e-3
        if modal.feed_mode != "inverse_time":
            change["feed"] = feed * (unit if modal.feed_mode == "per_rev" else unit / SECONDS_PER_MINUTE)
    if speed is not None and speed < 0.0:
        step.fault("gcode.spindle", "S", f"got S{speed:g}; give the speed in turns a minute, 0 or above")
    elif speed is not None:
        change["speed"] = speed * RADIANS_PER_TURN / SECONDS_PER_MINUTE
    if tool is not None:
        if tool < 0 or tool != int(tool):
            step.fault("gcode.tool", "T", f"got T{tool:g}; tools have whole numbers from 0")
        else:
            change["chosen"] = int(tool)
    return change


def _tool(names: tuple[str, ...], modal: Modal, step: Step) -> Modal:
    if "M6" not in names:
        return modal
    if modal.chosen is None:
        step.fault("gcode.tool", "M6", "M6 without a T that says which tool; add it")
        return modal
    if modal.chosen == modal.tool:
        return modal
    if modal.tool != 0 and step.dialect.tool is None:
        message = (
            f"tool {modal.chosen} after tool {modal.tool}: an operation has one tool; make an operation for "
            "each, with its number in the field tool"
        )
        step.fault("gcode.tool", f"T{modal.chosen}", message)
    return dataclasses.replace(modal, tool=modal.chosen, spindle=step.dialect.spindle or 0.0)


def _spindle(names: tuple[str, ...], modal: Modal, step: Step) -> dict[str, Any]:
    """The spindle's speed after the line; a new S counts at once while it runs."""
    way = math.copysign(1.0, modal.spindle) if modal.spindle else 0.0
    if "M5" in names:
        return {"spindle": 0.0}
    if "M3" in names or "M4" in names:
        way = 1.0 if "M3" in names else -1.0
        if not modal.speed:
            message = "the spindle is switched on at no speed; write S, or state spindle_rpm"
            step.fault("gcode.spindle", "S", message)
            return {"spindle": way}
    return {"spindle": way * (modal.speed or 0.0)} if way else {}


def _dwell(modal: Modal, step: Step) -> None:
    wait, unit = step.values.get("P"), step.dialect.dwell
    if wait is None or wait < 0.0:
        step.fault("gcode.mode", "G4", "G4 waits for a P of 0 or above; add it")
    elif unit is None:
        message = (
            "P of a G4 is seconds to some controllers, milliseconds to others; state the field dwell: s or ms"
        )
        step.fault("gcode.mode", "dwell", message)
    elif wanted(modal, step.dialect):
        step.out.event("dwell", step.line, wait * unit)


def _strays(names: tuple[str, ...], modal: Modal, step: Step, moving: bool) -> None:
    """Words that mean nothing on their line."""
    arc = modal.motion in (2, 3)
    allowed = set(AXIS_LETTERS + ROTARY_LETTERS + CENTRE_LETTERS + "FNST") | (
        {"P"} if "G4" in names else set()
    )
    allowed |= {"R"} if arc else set()
    allowed |= {"H", "D"} if any(MODAL_GROUPS[name] == "length" for name in names) else set()
    for letter in sorted(step.values.keys() - allowed):
        message = f"{letter} means nothing here; take it out, or correct the codes of its line"
        step.fault("gcode.word", letter, message)
    if "G4" in names and moving:
        step.fault("gcode.word", "G4", "a dwell and a move on one line; part them")
