"""Reads the functions and threads that are defined before the statements of a URScript program.

The text of each of them is fixed. Only the numbers of inputs and outputs, a popup's text, and times differ.
"""

import re
from typing import Final

from planner.languages.urscript.reader import syntax_tree
from planner.languages.urscript.reader.words import (
    OUTPUT_WORDS,
    Rows,
    ScriptError,
    ScriptLine,
    expect_lines,
    input_read,
    next_code,
    next_line,
    output_read,
    popup,
    positive_number,
    switched_output,
)

WAIT_STEP: Final = "0.01"
"""Time [s] between two checks of a wait, as written."""
SETTLING_TIME: Final = "0.1"
"""Time [s] that the thread of a torch waits before it first reads the torch's output back, as written."""
ARC_LOST_TIME: Final = "0.2"
"""Time [s] for which the torch's input may be low, as written."""
_WAIT_LOOP_END: Final = (f"sleep({WAIT_STEP})", f"passed=passed+{WAIT_STEP}", "end", "end")
"""Lines that continue the loop of a wait and end its function."""
MAX_READ_TRAVEL_M: Final = 0.01
"""Maximum distance [m] that a program may require a torch to move so that it does not count as standing."""
MAX_READ_DWELL_S: Final = 600.0
"""Maximum time [s] for which a program may let a torch stand."""


def read_function(
    line: int, words: ScriptLine, rows: Rows
) -> tuple[str, syntax_tree.EndingFunction | syntax_tree.ArcFunction]:
    """Read a function or thread and return its name and definition.

    Args:
        line: Line of its head.
        words: Words of its head.
        rows: The rows after it, of which those of the function are taken.
    """
    is_thread = words.next_word.text == "thread"
    (word,) = words.values("thread" if is_thread else "def", ScriptLine.name)
    match = re.fullmatch(syntax_tree.ARC_FUNCTION, word)
    if match and is_thread == (match[1] == syntax_tree.WATCH_ARC):
        return word, (_read_arc_watch if is_thread else _read_arc_wait)(line, words, rows)
    if is_thread:
        if word != syntax_tree.WATCH:
            raise ScriptError("syntax", f"{word}: not a thread of these programs")
        return word, _read_watch(line, words, rows)
    if word == syntax_tree.STAND:
        words.rest("(seconds):")
        expect_lines(rows, "sleep(seconds)", "end")
        return word, syntax_tree.EndingFunction(line, (), -1, (), "")
    if word == syntax_tree.CHECK:
        return word, _read_check(line, words, rows)
    if word not in (syntax_tree.AWAIT_LINE, syntax_tree.AWAIT_RUNNING):
        raise ScriptError("syntax", f"{word}: not a function of these programs")
    return word, _read_wait(line, word, words, rows)


def _read_check(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.EndingFunction:
    """Read the function that checks the other program's line and running wire, and the own running wire.

    ``line`` is the line of its head, ``words`` are the rest of the head, and ``rows`` the lines after it.
    """
    words.rest("(level,own):")
    *numbers, running = next_line(rows).rest(
        "if", input_read, "!=level or", input_read, "==False or", output_read, "!=own:"
    )
    if numbers[0] == numbers[1]:
        message = (
            f"{syntax_tree.CHECK} compares input {numbers[0]} twice; line and running wire need one each"
        )
        raise ScriptError("syntax", message)
    switched_outputs, text = read_switched_off_outputs(rows, blocking=True)
    expect_lines(rows, "end", "end")
    return syntax_tree.EndingFunction(line, tuple(numbers), running, switched_outputs, text)


def _read_wait(line: int, word: str, words: ScriptLine, rows: Rows) -> syntax_tree.EndingFunction:
    """Read a function that waits until an input has a level, and ends the program after a time limit."""
    words.rest("(level,limit):")
    expect_lines(rows, "local passed=0.0")
    number, running = next_line(rows).rest("while", input_read, "!=level or", output_read, "==False:")
    repeated_check = next_line(rows)
    if repeated_check.values("if passed>limit or", output_read) != [running]:
        raise ScriptError("syntax", f"{word} reads two outputs; allowed: one")
    repeated_check.rest("==False:")
    switched_outputs, text = read_switched_off_outputs(rows, blocking=True)
    expect_lines(rows, "end", *_WAIT_LOOP_END)
    return syntax_tree.EndingFunction(line, (number,), running, switched_outputs, text)


def _read_watch(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.EndingFunction:
    """Read the thread that ends the program when the other one no longer runs."""
    words.rest("():")
    number, running = next_line(rows).rest("while", input_read, "and", output_read, ":")
    expect_lines(rows, "sync()", "end")
    switched_outputs, text = read_switched_off_outputs(rows, blocking=False)
    expect_lines(rows, "end")
    return syntax_tree.EndingFunction(line, (number,), running, switched_outputs, text)


def _read_arc_wait(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.ArcFunction:
    """Read the function that waits until a torch's input shows that it burns."""
    words.rest("(limit):")
    expect_lines(rows, "local passed=0.0")
    (input_number,) = next_line(rows).rest("while", input_read, "==False:")
    expect_lines(rows, "if passed>limit:")
    switched_outputs, text = read_switched_off_outputs(rows, blocking=True)
    expect_lines(rows, "end", *_WAIT_LOOP_END)
    return syntax_tree.ArcFunction(line, input_number, None, switched_outputs, text)


def _read_arc_watch(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.ArcFunction:
    """Read the thread that monitors a burning torch.

    It ends the program if the torch's output falls, if its input (if it has one) is low for too long, or if
    the torch stands.
    """
    words.rest("():")
    code = next_code(rows)
    has_input = ScriptLine(code).words == ScriptLine("local arc_lost=0.0").words
    if has_input:
        code = next_code(rows)
    if ScriptLine(code).words != ScriptLine("local arc_stood=0.0").words:
        raise ScriptError("syntax", f"{code!r}: expected local arc_stood=0.0")
    expect_lines(rows, "local arc_place=get_actual_tcp_pose()", f"sleep({SETTLING_TIME})")
    burning = f"and arc_lost<={ARC_LOST_TIME}" if has_input else ""
    standing_time = positive_number(MAX_READ_DWELL_S, "the standing time")
    torch_output, max_standing_time = next_line(rows).rest(
        "while", output_read, burning, "and arc_stood<=", standing_time, ":"
    )
    expect_lines(rows, f"sleep({WAIT_STEP})")
    input_number: int | None = None
    if has_input:
        expect_lines(rows, f"arc_lost=arc_lost+{WAIT_STEP}")
        (input_number,) = next_line(rows).rest("if", input_read, ":")
        expect_lines(rows, "arc_lost=0.0", "end")
    expect_lines(rows, f"arc_stood=arc_stood+{WAIT_STEP}")
    condition = "if point_dist(get_actual_tcp_pose(),arc_place)>"
    (min_travel,) = next_line(rows).rest(
        condition, positive_number(MAX_READ_TRAVEL_M, "the distance to move"), ":"
    )
    expect_lines(rows, "arc_place=get_actual_tcp_pose()", "arc_stood=0.0", "end", "end")
    switched_outputs, text = read_switched_off_outputs(rows, blocking=False)
    expect_lines(rows, "end")
    return syntax_tree.ArcFunction(
        line, input_number, torch_output, switched_outputs, text, max_standing_time, min_travel
    )


def awaits_arc(word: str) -> bool:
    """Return whether a name is that of a function that waits for a torch to burn."""
    match = re.fullmatch(syntax_tree.ARC_FUNCTION, word)
    return match is not None and match[1] == syntax_tree.AWAIT_ARC


def read_switched_off_outputs(rows: Rows, blocking: bool) -> tuple[tuple[int, ...], str]:
    """Read statements that switch outputs off, and the popup and halt after them.

    Args:
        rows: The rows from the first statement on.
        blocking: Whether the popup must hold the program.

    Returns:
        Numbers of the outputs in their order, and the text of the popup.
    """
    outputs: list[int] = []
    while True:
        words = next_line(rows)
        word = words.next_word.text
        if word not in OUTPUT_WORDS:
            return tuple(outputs), read_ending(words, rows, blocking)
        number, value = words.rest(f"{word}(", *switched_output(OUTPUT_WORDS[word]), ")")
        if value:
            raise ScriptError("syntax", "outputs must be switched off where the program ends")
        outputs.append(number)


def read_ending(words: ScriptLine, rows: Rows, blocking: bool) -> str:
    """Read a popup, whose first words are given, and the halt after it; return the popup's text."""
    text, title, holds = words.rest("popup(", *popup(error=True), ")")
    if holds != blocking or title != "Tandem":
        requirement = "hold the program" if blocking else "not hold the program"
        raise ScriptError("syntax", f"the popup before halt has to {requirement}")
    expect_lines(rows, "halt")
    return str(text)
