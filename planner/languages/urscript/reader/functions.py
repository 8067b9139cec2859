"""Functions and threads before the statements of a URScript program.

Each has one form, except for inputs, outputs, a text, and times.
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
"""Time [s] for which the thread that monitors a torch waits before it reads its output back, as
written.
"""
ARC_LOST_TIME: Final = "0.2"
"""Time [s] for which the torch's input may be low, as written."""
_WAIT_LOOP_END: Final = (f"sleep({WAIT_STEP})", f"passed=passed+{WAIT_STEP}", "end", "end")
"""Lines that continue the loop of a wait and end its function."""
MAX_READ_TRAVEL_M: Final = 0.01
"""Maximum readable distance [m] that a torch has to move so that it does not count as standing."""
MAX_READ_STANDING_S: Final = 600.0
"""Maximum readable time [s] for which a torch may stand."""


def read_function(
    line: int, words: ScriptLine, rows: Rows
) -> tuple[str, syntax_tree.EndingFunction | syntax_tree.ArcFunction]:
    """Read a function or thread from its head. Return its name and what it does."""
    thread = words.next_word.text == "thread"
    (word,) = words.values("thread" if thread else "def", ScriptLine.name)
    if (match := re.fullmatch(syntax_tree.ARC_FUNCTION, word)) and thread == (
        match[1] == syntax_tree.WATCH_ARC
    ):
        return word, (_read_arc_watch if thread else _read_arc_wait)(line, words, rows)
    if thread:
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
    """Read the function that checks the other program."""
    words.rest("(level,own):")
    *numbers, running = next_line(rows).rest(
        "if", input_read, "!=level or", input_read, "==False or", output_read, "!=own:"
    )
    if numbers[0] == numbers[1]:
        what = f"{syntax_tree.CHECK} compares input {numbers[0]} twice; line and running wire need one each"
        raise ScriptError("syntax", what)
    switched_outputs, text = read_switched_off(rows, blocking=True)
    expect_lines(rows, "end", "end")
    return syntax_tree.EndingFunction(line, tuple(numbers), running, switched_outputs, text)


def _read_wait(line: int, word: str, words: ScriptLine, rows: Rows) -> syntax_tree.EndingFunction:
    """Read a function that waits for the other program."""
    words.rest("(level,limit):")
    expect_lines(rows, "local passed=0.0")
    number, running = next_line(rows).rest("while", input_read, "!=level or", output_read, "==False:")
    again = next_line(rows)
    if again.values("if passed>limit or", output_read) != [running]:
        raise ScriptError("syntax", f"{word} reads two outputs; allowed: one")
    again.rest("==False:")
    switched_outputs, text = read_switched_off(rows, blocking=True)
    expect_lines(rows, "end", *_WAIT_LOOP_END)
    return syntax_tree.EndingFunction(line, (number,), running, switched_outputs, text)


def _read_watch(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.EndingFunction:
    words.rest("():")
    number, running = next_line(rows).rest("while", input_read, "and", output_read, ":")
    expect_lines(rows, "sync()", "end")
    switched_outputs, text = read_switched_off(rows, blocking=False)
    expect_lines(rows, "end")
    return syntax_tree.EndingFunction(line, (number,), running, switched_outputs, text)


def _read_arc_wait(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.ArcFunction:
    """Read the function that waits for a torch to burn."""
    words.rest("(limit):")
    expect_lines(rows, "local passed=0.0")
    (given,) = next_line(rows).rest("while", input_read, "==False:")
    expect_lines(rows, "if passed>limit:")
    switched_outputs, text = read_switched_off(rows, blocking=True)
    expect_lines(rows, "end", *_WAIT_LOOP_END)
    return syntax_tree.ArcFunction(line, given, None, switched_outputs, text)


def _read_arc_watch(line: int, words: ScriptLine, rows: Rows) -> syntax_tree.ArcFunction:
    """Read the thread that monitors a burning torch.

    It reads the torch's output, its input if it has one, and checks whether the torch stands.
    """
    words.rest("():")
    code = next_code(rows)
    lost = ScriptLine(code).words == ScriptLine("local arc_lost=0.0").words
    if lost:
        code = next_code(rows)
    if ScriptLine(code).words != ScriptLine("local arc_stood=0.0").words:
        raise ScriptError("syntax", f"{code!r}: expected local arc_stood=0.0")
    expect_lines(rows, "local arc_place=get_actual_tcp_pose()", f"sleep({SETTLING_TIME})")
    burning = f"and arc_lost<={ARC_LOST_TIME}" if lost else ""
    longest = positive_number(MAX_READ_STANDING_S, "the standing time")
    torch_output, max_standing_time = next_line(rows).rest(
        "while", output_read, burning, "and arc_stood<=", longest, ":"
    )
    expect_lines(rows, f"sleep({WAIT_STEP})")
    given: int | None = None
    if lost:
        expect_lines(rows, f"arc_lost=arc_lost+{WAIT_STEP}")
        (given,) = next_line(rows).rest("if", input_read, ":")
        expect_lines(rows, "arc_lost=0.0", "end")
    expect_lines(rows, f"arc_stood=arc_stood+{WAIT_STEP}")
    condition = "if point_dist(get_actual_tcp_pose(),arc_place)>"
    (min_travel,) = next_line(rows).rest(
        condition, positive_number(MAX_READ_TRAVEL_M, "the distance to move"), ":"
    )
    expect_lines(rows, "arc_place=get_actual_tcp_pose()", "arc_stood=0.0", "end", "end")
    switched_outputs, text = read_switched_off(rows, blocking=False)
    expect_lines(rows, "end")
    return syntax_tree.ArcFunction(
        line, given, torch_output, switched_outputs, text, max_standing_time, min_travel
    )


def awaits_arc(word: str) -> bool:
    """Return whether a name is that of a function that waits for a torch to burn."""
    match = re.fullmatch(syntax_tree.ARC_FUNCTION, word)
    return match is not None and match[1] == syntax_tree.AWAIT_ARC


def read_switched_off(rows: Rows, blocking: bool) -> tuple[tuple[int, ...], str]:
    """Return the outputs that are switched off, and the text that is shown before the program ends."""
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
    """Return the text of a popup after which the program ends."""
    text, title, holds = words.rest("popup(", *popup(error=True), ")")
    if holds != blocking or title != "Tandem":
        how = "hold the program" if blocking else "not hold the program"
        raise ScriptError("syntax", f"the popup before halt has to {how}")
    expect_lines(rows, "halt")
    return str(text)
