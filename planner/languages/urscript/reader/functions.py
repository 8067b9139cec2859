"""Functions and threads that stand before the statements of a URScript program: each has one form but for
inputs, outputs, a text, and times.
"""

import re
from typing import Final

from planner.languages.urscript.reader import syntax_tree
from planner.languages.urscript.reader.words import (
    OUTPUT_WORDS,
    Line,
    Rows,
    ScriptError,
    above_zero,
    input_read,
    must_be,
    next_code,
    next_line,
    output_read,
    popup,
    switched,
)

WAIT_STEP: Final = "0.01"
"""Time [s] between two looks of a wait, as it is written."""
SETTLED: Final = "0.1"
"""Time [s] for which the thread that watches a torch waits before it reads its output back, as written."""
LOST: Final = "0.2"
"""Time [s] for which its input may be low, as written."""
_WAITED: Final = (f"sleep({WAIT_STEP})", f"passed=passed+{WAIT_STEP}", "end", "end")
"""Lines with which the loop of a wait goes on, and its function ends."""
MOST_FAR: Final = 0.01
"""How far [m] a torch has to get so that it does not stand, at most what is read."""
MOST_STOOD: Final = 600.0
"""Longest time [s] for which a torch may stand that is read."""


def function(line: int, words: Line, rows: Rows) -> tuple[str, syntax_tree.Ending | syntax_tree.ArcFunction]:
    """The name of a function or thread whose head has these ``words``, and what it does."""
    thread = words.next.text == "thread"
    (word,) = words.values("thread" if thread else "def", Line.name)
    if (found := re.fullmatch(syntax_tree.ARC_FUNCTION, word)) and thread == (
        found[1] == syntax_tree.WATCH_ARC
    ):
        return word, (_watch_arc if thread else _await_arc)(line, words, rows)
    if thread:
        if word != syntax_tree.WATCH:
            raise ScriptError("syntax", f"{word}: no thread of these programs")
        return word, _watch(line, words, rows)
    if word == syntax_tree.STAND:
        words.rest("(seconds):")
        must_be(rows, "sleep(seconds)", "end")
        return word, syntax_tree.Ending(line, (), -1, (), "")
    if word == syntax_tree.CHECK:
        return word, _check(line, words, rows)
    if word not in (syntax_tree.AWAIT_LINE, syntax_tree.AWAIT_RUNNING):
        raise ScriptError("syntax", f"{word}: no function of these programs")
    return word, _await(line, word, words, rows)


def _check(line: int, words: Line, rows: Rows) -> syntax_tree.Ending:
    """The function that looks at the other program."""
    words.rest("(level,own):")
    *numbers, own = next_line(rows).rest(
        "if", input_read, "!=level or", input_read, "==False or", output_read, "!=own:"
    )
    if numbers[0] == numbers[1]:
        what = f"{syntax_tree.CHECK} compares input {numbers[0]} twice; line and running wire have one each"
        raise ScriptError("syntax", what)
    off, text = switched_off(rows, blocking=True)
    must_be(rows, "end", "end")
    return syntax_tree.Ending(line, tuple(numbers), own, off, text)


def _await(line: int, word: str, words: Line, rows: Rows) -> syntax_tree.Ending:
    """A function that waits for the other program."""
    words.rest("(level,limit):")
    must_be(rows, "local passed=0.0")
    number, own = next_line(rows).rest("while", input_read, "!=level or", output_read, "==False:")
    again = next_line(rows)
    if again.values("if passed>limit or", output_read) != [own]:
        raise ScriptError("syntax", f"{word} looks at two outputs; it has one to look at")
    again.rest("==False:")
    off, text = switched_off(rows, blocking=True)
    must_be(rows, "end", *_WAITED)
    return syntax_tree.Ending(line, (number,), own, off, text)


def _watch(line: int, words: Line, rows: Rows) -> syntax_tree.Ending:
    words.rest("():")
    number, own = next_line(rows).rest("while", input_read, "and", output_read, ":")
    must_be(rows, "sync()", "end")
    off, text = switched_off(rows, blocking=False)
    must_be(rows, "end")
    return syntax_tree.Ending(line, (number,), own, off, text)


def _await_arc(line: int, words: Line, rows: Rows) -> syntax_tree.ArcFunction:
    """The function that waits for a torch to burn."""
    words.rest("(limit):")
    must_be(rows, "local passed=0.0")
    (given,) = next_line(rows).rest("while", input_read, "==False:")
    must_be(rows, "if passed>limit:")
    off, text = switched_off(rows, blocking=True)
    must_be(rows, "end", *_WAITED)
    return syntax_tree.ArcFunction(line, given, None, off, text)


def _watch_arc(line: int, words: Line, rows: Rows) -> syntax_tree.ArcFunction:
    """The thread that watches a torch which burns: its output, its input if it has one, and whether it
    stands."""
    words.rest("():")
    code = next_code(rows)
    lost = Line(code).words == Line("local arc_lost=0.0").words
    if lost:
        code = next_code(rows)
    if Line(code).words != Line("local arc_stood=0.0").words:
        raise ScriptError("syntax", f"{code!r}: local arc_stood=0.0 must stand here")
    must_be(rows, "local arc_place=get_actual_tcp_pose()", f"sleep({SETTLED})")
    burning = f"and arc_lost<={LOST}" if lost else ""
    longest = above_zero(MOST_STOOD, "the longest stand")
    own, stood = next_line(rows).rest("while", output_read, burning, "and arc_stood<=", longest, ":")
    must_be(rows, f"sleep({WAIT_STEP})")
    given: int | None = None
    if lost:
        must_be(rows, f"arc_lost=arc_lost+{WAIT_STEP}")
        (given,) = next_line(rows).rest("if", input_read, ":")
        must_be(rows, "arc_lost=0.0", "end")
    must_be(rows, f"arc_stood=arc_stood+{WAIT_STEP}")
    gone = "if point_dist(get_actual_tcp_pose(),arc_place)>"
    (far,) = next_line(rows).rest(gone, above_zero(MOST_FAR, "how far it has to get"), ":")
    must_be(rows, "arc_place=get_actual_tcp_pose()", "arc_stood=0.0", "end", "end")
    off, text = switched_off(rows, blocking=False)
    must_be(rows, "end")
    return syntax_tree.ArcFunction(line, given, own, off, text, stood, far)


def awaits_arc(word: str) -> bool:
    """Whether a name is that of a function that waits for a torch to burn."""
    found = re.fullmatch(syntax_tree.ARC_FUNCTION, word)
    return found is not None and found[1] == syntax_tree.AWAIT_ARC


def switched_off(rows: Rows, blocking: bool) -> tuple[tuple[int, ...], str]:
    """Outputs that are switched off, and the text that is shown before the program ends."""
    off: list[int] = []
    while True:
        words = next_line(rows)
        word = words.next.text
        if word not in OUTPUT_WORDS:
            return tuple(off), ended(words, rows, blocking)
        number, value = words.rest(f"{word}(", *switched(OUTPUT_WORDS[word]), ")")
        if value:
            raise ScriptError("syntax", "outputs go off where the program ends")
        off.append(number)


def ended(words: Line, rows: Rows, blocking: bool) -> str:
    """The text of a popup, behind which the program ends."""
    text, title, holds = words.rest("popup(", *popup(error=True), ")")
    if holds != blocking or title != "Tandem":
        how = "hold the program" if blocking else "not hold the program"
        raise ScriptError("syntax", f"the popup before halt has to {how}")
    must_be(rows, "halt")
    return str(text)
