"""A single line of G-code: its words, its G and M codes by modal group, and their effect.

The effects of a line are executed in the order of controllers: first modes, then dwell, motion and stop. A
word is a letter with a number. Comments and white space are removed. Codes that are not supported are refused
with a reason (`refusal_reason`).
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
    LineFaults,
    LineStep,
    MoveRecorder,
    execute_move,
)
from planner.processes.milling.plan.gcode.state import INCH_M, Dialect, Modal, uses_tool

Word = tuple[str, float]
"""Letter and number of a word."""

MAX_CHARACTERS: Final = 256
"""Maximum number of characters of a line's words, which is that of controllers (RS274/NGC).

It also bounds the length of numbers.
"""
COMMENT_PATTERN: Final = re.compile(r"\([^()]*\)|;.*")
"""Comments: in parentheses, or from a semicolon to the end of the line."""
WORD_PATTERN: Final = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
"""Pattern of a word: a letter and its number."""


class LineError(ValueError):
    """A line that is not G-code. ``word`` is the text at fault, the message says what to do."""

    def __init__(self, word: str, message: str) -> None:
        super().__init__(message)
        self.word = word


def strip_line(line: str) -> str:
    """Return a line in capitals, without comments and white space, which have no meaning.

    Raises:
        LineError: A comment is not closed.
    """
    if "(" in line or ";" in line or ")" in line:
        line = COMMENT_PATTERN.sub("", line)
        if "(" in line or ")" in line:
            raise LineError("(", "a parenthesis of a comment has no partner; pair ( and ) within the line")
    return "".join(line.split()).upper()


def parse_words(text: str) -> list[Word]:
    """Return the words of a line that :func:`strip_line` returned, in order, with their numbers.

    Raises:
        LineError: The text is not a list of words, or too long.
    """
    matches = WORD_PATTERN.findall(text)
    if sum(len(number) for _, number in matches) + len(matches) != len(text):
        raise _syntax_error(text)
    if len(text) > MAX_CHARACTERS:
        raise LineError(
            "", f"{len(text)} characters of words on a line, allowed {MAX_CHARACTERS}; split the line"
        )
    return [(letter, float(number)) for letter, number in matches]


def code_name(letter: str, value: float) -> str:
    """Return the usual name of a code, such as ``G1`` or ``G90.1``."""
    return f"{letter}{value:g}"


def _syntax_error(text: str) -> LineError:
    """Return the error about the first text of a line that is not a word."""
    position = 0
    while (match := WORD_PATTERN.match(text, position)) is not None:
        position = match.end()
    rest = text[position : position + 12]
    if rest[0] in "#[]=*<" or (len(rest) > 1 and rest[1] in "#["):
        reason = "parameters and expressions are not computed; let the CAM system write plain numbers"
        return LineError(rest[0], f"got {rest!r}: {reason}")
    if rest[0].isalpha() and rest[0].isascii():
        reason = "the word has no number, or one that is not written as 12, 12., .5 or -1.5; correct it"
        return LineError(rest[0], f"got {rest!r}: {reason}")
    return LineError("", f"got {rest!r}, which is not a G-code word (a letter and a number); correct it")


MOTION_CODES: Final = {"G0": 0, "G1": 1, "G2": 2, "G3": 3}
"""Motion modes: rapid, straight, arc clockwise, arc counterclockwise."""
PLANE_CODES: Final = {"G17": 2, "G18": 1, "G19": 0}
"""Index of the normal of each plane: G17 is xy, G18 zx, G19 yz."""

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
"""Modal group of each code. Two codes of one group on a line contradict each other."""

CODES_WITH_AXES: Final = frozenset({"G10", "G28", "G30", "G52", "G53", "G92"})
"""Codes that use the axis words of their line. Skipping such a code also skips these words."""

ARGUMENT_LETTERS: Final = "DEHLPQ"
"""Words that belong to codes. They are skipped with a code that is not executed."""

# Reasons why codes of each kind are refused, with the remedy.
_CYCLE_REASON = "canned cycles are not supported; let the CAM system write them as moves"
_OFFSET_REASON = "positions of the file are stated in the problem (origin, offsets); remove it"
_HOME_REASON = "the robot moves home on its own safe path; remove the line, or name the code in skip"
_COMPENSATION_REASON = (
    "cutter radius compensation is not supported; let the CAM system write the path of the tip"
)
_PATH_MODE_REASON = "the accuracy of corners follows from the problem's tolerances; name it in skip"
_COOLANT_REASON = "there is no signal for coolant; name it in skip and switch coolant by hand"
_SPLINE_REASON = "only straight moves and arcs are read; let the CAM system write these"
_SUBPROGRAM_REASON = "subprograms and variables are not read; let the CAM system write one plain program"

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
"""Reason why each of these codes is refused, with the remedy."""


def refusal_reason(name: str) -> str:
    """Return the reason why a code is not executed, with the remedy."""
    return REFUSALS.get(name, "this code is not known; remove it, or name it in skip if it may be ignored")


SECONDS_PER_MINUTE: Final = 60.0
"""Number of seconds in a minute, because feeds are stated per minute."""
RADIANS_PER_REVOLUTION: Final = 2.0 * math.pi
"""Angle [rad] of a revolution, because spindle speeds are stated in revolutions per minute."""


def execute(
    text: str, line: int, modal: Modal, dialect: Dialect, faults: LineFaults, out: MoveRecorder
) -> Modal:
    """Execute a line and return the state after it.

    Args:
        text: The line.
        line: Its number in the file, from 1.
        modal: State before the line.
        dialect: What the problem states about the file.
        faults: Collects faults.
        out: Collects moves and events.
    """
    stripped = text.strip()
    if stripped.startswith("/"):
        if dialect.block_delete is None:
            message = "whether a line with / runs depends on a switch; set block_delete, true to leave it out"
            faults.add("gcode.mode", "/", line, message)
        if dialect.block_delete:
            return modal
        stripped = stripped[1:]
    try:
        content = strip_line(stripped)
        if content == "%":  # the first % starts the program, the second one ends it
            is_over = modal.started or modal.marks > 0
            return dataclasses.replace(modal, marks=modal.marks + 1, ended=is_over)
        if not content or (content[0] == "O" and content[1:].isdigit()):
            return modal
        line_words = parse_words(content)
    except LineError as error:
        faults.add("gcode.syntax", error.word, line, str(error))
        return modal
    if modal.ended:
        message = "the program ends before this line (M2, M30 or %), so it does not run; remove it"
        faults.add("gcode.after_end", "", line, message, severity=Severity.WARNING)
        return modal
    return _execute_words(line_words, line, _updated(modal, {"started": True}), dialect, faults, out)


def _execute_words(
    line_words: list[Word], line: int, modal: Modal, dialect: Dialect, faults: LineFaults, out: MoveRecorder
) -> Modal:
    """Execute the words of a line in the order of controllers, and return the state after them."""
    names, values = _split_words(line_words, line, dialect, faults)
    step = LineStep(values, line, dialect, faults, out)
    modal = _updated(modal, _mode_changes(names, modal, step))
    modal = _updated(modal, _number_changes(modal, step))
    modal = _change_tool(names, modal, step)
    modal = _updated(modal, _spindle_change(names, modal, step))
    if "G4" in names:
        _add_dwell(modal, step)
    moving = any(word in values for word in AXIS_LETTERS + ROTARY_LETTERS + CENTRE_LETTERS + "R")
    _check_stray_words(names, modal, step, moving)
    if moving:
        modal = execute_move(modal, step)
    if ("M0" in names or "M1" in names) and uses_tool(modal, dialect):
        out.event("pause", line)
    if "M2" in names or "M30" in names:
        modal = dataclasses.replace(modal, ended=True)
    return modal


def _updated(modal: Modal, change: dict[str, Any]) -> Modal:
    """Return the state with some fields changed; the same object if nothing changes, as on most lines."""
    if all(getattr(modal, name) == value for name, value in change.items()):
        return modal
    return dataclasses.replace(modal, **change)


def _split_words(
    line_words: list[Word], line: int, dialect: Dialect, faults: LineFaults
) -> tuple[tuple[str, ...], dict[str, float]]:
    """Return the names of the line's codes that are executed, and the values of its other words.

    Words that belong to a code that is not executed are left out. Faults are recorded.
    """
    names: dict[str, str] = {}
    values: dict[str, float] = {}
    # Whether a code is not executed, and whether it takes the axis words of the line with it.
    refused = dropped = False
    for letter, value in line_words:
        if letter in "GM":
            name = code_name(letter, value)
            if name in dialect.skip:
                message = f"{name} is skipped, as the problem states"
                faults.add("gcode.skipped", name, line, message, severity=Severity.NOTE)
                refused, dropped = True, dropped or name in CODES_WITH_AXES
            elif name not in MODAL_GROUPS:
                faults.add("gcode.word", name, line, f"{name}: {refusal_reason(name)}")
                refused, dropped = True, dropped or name in CODES_WITH_AXES
            elif MODAL_GROUPS[name] in names and names[MODAL_GROUPS[name]] != name:
                other = names[MODAL_GROUPS[name]]
                message = f"{other} and {name} on one line contradict each other; keep one"
                faults.add("gcode.word", name, line, message)
            else:
                names[MODAL_GROUPS[name]] = name
        elif letter in values:
            message = f"{letter} occurs twice on a line; keep one, or split the line"
            faults.add("gcode.syntax", letter, line, message)
        else:
            values[letter] = value
    left_out = (AXIS_LETTERS + ROTARY_LETTERS if dropped else "") + (ARGUMENT_LETTERS if refused else "")
    values = (
        {letter: value for letter, value in values.items() if letter not in left_out} if left_out else values
    )
    return tuple(names.values()), values


def _mode_changes(names: tuple[str, ...], modal: Modal, step: LineStep) -> dict[str, Any]:
    """Return the changes of modes by the G codes of a line."""
    change: dict[str, Any] = {}
    for name in names:
        if name in MOTION_CODES:
            change["motion"] = MOTION_CODES[name]
        elif name in PLANE_CODES:
            change["plane"] = PLANE_CODES[name]
        elif name in ("G20", "G21"):
            change["unit"] = INCH_M if name == "G20" else 1e-3
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
            change["offset"] = _find_offset(name, modal, step)
    return change


def _find_offset(name: str, modal: Modal, step: LineStep) -> Any:
    """Return the offset (3,) [m] of a code such as G54.

    If the problem does not state it, this is reported and the active offset is returned.
    """
    offset = step.dialect.offsets.get(int(name[1:]))
    if offset is None:
        message = f"{name}: the problem does not state this offset; add it to offsets, or remove the code"
        step.fault("gcode.offset", name, message)
        return modal.offset
    return offset


def _number_changes(modal: Modal, step: LineStep) -> dict[str, Any]:
    """Return the changes of the state by the words F, S and T of a line.

    With inverse time (G93), F belongs to its line alone and changes no state.
    """
    change: dict[str, Any] = {}
    feed, speed, tool = (step.values.get(word) for word in "FST")
    if feed is not None and feed <= 0.0:
        step.fault("gcode.feed", "F", f"feed must be positive, got F{feed:g}; correct it")
    elif feed is not None:
        if modal.feed_mode is None:
            message = (
                "F without G93, G94 or G95 before; write one, or state the field feed_mode: per_minute, "
                "inverse_time or per_rev"
            )
            step.fault("gcode.feed", "feed_mode", message)
            change["feed_mode"] = "per_minute"
        if modal.feed_mode != "inverse_time" and modal.unit is None:
            message = "F without a unit; write G20 or G21 before, or state the field unit: mm or in"
            step.fault("gcode.unit", "unit", message)
            change["unit"] = 1e-3
        unit = modal.unit or 1e-3
        if modal.feed_mode != "inverse_time":
            change["feed"] = feed * (unit if modal.feed_mode == "per_rev" else unit / SECONDS_PER_MINUTE)
    if speed is not None and speed < 0.0:
        step.fault("gcode.spindle", "S", f"got S{speed:g}; give the speed in 1/min, 0 or above")
    elif speed is not None:
        change["speed"] = speed * RADIANS_PER_REVOLUTION / SECONDS_PER_MINUTE
    if tool is not None:
        if tool < 0 or tool != int(tool):
            step.fault("gcode.tool", "T", f"got T{tool:g}; tool numbers are integers from 0")
        else:
            change["chosen"] = int(tool)
    return change


def _change_tool(names: tuple[str, ...], modal: Modal, step: LineStep) -> Modal:
    """Return the state after M6, if the line has it. The spindle then runs as the problem states."""
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


def _spindle_change(names: tuple[str, ...], modal: Modal, step: LineStep) -> dict[str, Any]:
    """Return the change of the spindle's speed by a line. While it runs, a new S applies immediately."""
    direction = math.copysign(1.0, modal.spindle) if modal.spindle else 0.0
    if "M5" in names:
        return {"spindle": 0.0}
    if "M3" in names or "M4" in names:
        direction = 1.0 if "M3" in names else -1.0
        if not modal.speed:
            message = "the spindle is switched on without a speed; write S, or state spindle_rpm"
            step.fault("gcode.spindle", "S", message)
            return {"spindle": direction}
    return {"spindle": direction * (modal.speed or 0.0)} if direction else {}


def _add_dwell(modal: Modal, step: LineStep) -> None:
    """Record the dwell of a G4, or its fault."""
    wait, unit = step.values.get("P"), step.dialect.dwell
    if wait is None or wait < 0.0:
        step.fault("gcode.mode", "G4", "G4 needs a P of 0 or above; add it")
    elif unit is None:
        message = (
            "P of a G4 is in seconds on some controllers, in milliseconds on others; state the field dwell: "
            "s or ms"
        )
        step.fault("gcode.mode", "dwell", message)
    elif uses_tool(modal, step.dialect):
        step.out.event("dwell", step.line, wait * unit)


def _check_stray_words(names: tuple[str, ...], modal: Modal, step: LineStep, moving: bool) -> None:
    """Report words that have no meaning on their line. ``moving``: whether the line has words of a move."""
    is_arc = modal.motion in (2, 3)
    allowed = set(AXIS_LETTERS + ROTARY_LETTERS + CENTRE_LETTERS + "FNST") | (
        {"P"} if "G4" in names else set()
    )
    allowed |= {"R"} if is_arc else set()
    allowed |= {"H", "D"} if any(MODAL_GROUPS[name] == "length" for name in names) else set()
    for letter in sorted(step.values.keys() - allowed):
        message = f"{letter} has no meaning here; remove it, or correct the codes of its line"
        step.fault("gcode.word", letter, message)
    if "G4" in names and moving:
        step.fault("gcode.word", "G4", "a dwell and a move are on one line; separate them")
