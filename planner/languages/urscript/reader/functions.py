"""Functions and threads that stand before the statements of a URScript program: each has one form but for
inputs, outputs, a text, and times.
"""

from __future__ import annotations

import re
from typing import Final

from planner.languages.urscript.reader import syntax_tree
from planner.languages.urscript.reader.words import (
    INPUTS,
    OUTPUT_WORDS,
    OUTPUTS_READ,
    Line,
    Rows,
    ScriptError,
    flag_of,
    must_be,
    next_code,
    numbered,
    shown,
)

WAIT_STEP: Final = "0.01"
"""Time [s] between two looks of a wait, as it is written."""
SETTLED: Final = "0.1"
"""Time [s] for which the thread that watches a torch waits before it reads its output back, as written."""
LOST: Final = "0.2"
"""Time [s] for which its input may be low, as written."""
MOST_FAR: Final = 0.01
"""How far [m] a torch has to get so that it does not stand, at most what is read."""
MOST_STOOD: Final = 600.0
"""Longest time [s] for which a torch may stand that is read."""


def function(line: int, words: Line, rows: Rows) -> tuple[str, syntax_tree.Ending | syntax_tree.ArcFunction]:
    """The name of a function or thread whose head has these ``words``, and what it does."""
    thread = words.next.text == "thread"
    words.signs("thread" if thread else "def")
    word = words.take("name")
    if (found := re.fullmatch(syntax_tree.ARC_FUNCTION, word)) and thread == (
        found[1] == syntax_tree.WATCH_ARC
    ):
        return word, (_watch_arc if thread else _await_arc)(line, words, rows)
    if thread:
        if word != syntax_tree.WATCH:
            raise ScriptError("syntax", f"{word}: no thread of these programs")
        return word, _watch(line, words, rows)
    if word == syntax_tree.STAND:
        words.signs("(", "seconds", ")", ":")
        words.done()
        must_be(rows, "sleep(seconds)", "end")
        return syntax_tree.STAND, syntax_tree.Ending(line, (), -1, (), "")
    if word not in (syntax_tree.AWAIT_LINE, syntax_tree.AWAIT_RUNNING, syntax_tree.CHECK):
        raise ScriptError("syntax", f"{word}: no function of these programs")
    return word, _of_partner(line, word, words, rows)


def _of_partner(line: int, word: str, words: Line, rows: Rows) -> syntax_tree.Ending:
    """A function that waits for the other program, or looks at it."""
    words.signs("(", "level", ",", "own" if word == syntax_tree.CHECK else "limit", ")", ":")
    words.done()
    if word == syntax_tree.CHECK:
        numbers, own = _condition(rows, "if", "==", "False", "or", "!=", "own")
        off, text = switched_off(rows, blocking=True)
        must_be(rows, "end", "end")
        return syntax_tree.Ending(line, numbers, own, off, text)
    must_be(rows, "local passed=0.0")
    numbers, own = _condition(rows, "while", "==", "False")
    again = Line(next_code(rows))
    again.signs("if", "passed", ">", "limit", "or")
    if numbered(again, OUTPUTS_READ) != own:
        raise ScriptError("syntax", f"{word} looks at two outputs; it has one to look at")
    again.signs("==", "False", ":")
    again.done()
    off, text = switched_off(rows, blocking=True)
    must_be(rows, "end", f"sleep({WAIT_STEP})", f"passed=passed+{WAIT_STEP}", "end", "end")
    return syntax_tree.Ending(line, numbers, own, off, text)


def _watch(line: int, words: Line, rows: Rows) -> syntax_tree.Ending:
    """The thread that watches the other program."""
    words.signs("(", ")", ":")
    words.done()
    head = Line(next_code(rows))
    head.signs("while")
    number = numbered(head, INPUTS)
    head.signs("and")
    own = numbered(head, OUTPUTS_READ)
    head.signs(":")
    head.done()
    must_be(rows, "sync()", "end")
    off, text = switched_off(rows, blocking=False)
    must_be(rows, "end")
    return syntax_tree.Ending(line, (number,), own, off, text)


def _await_arc(line: int, words: Line, rows: Rows) -> syntax_tree.ArcFunction:
    """The function that waits for a torch to burn."""
    words.signs("(", "limit", ")", ":")
    words.done()
    must_be(rows, "local passed=0.0")
    head = Line(next_code(rows))
    head.signs("while")
    given = numbered(head, INPUTS)
    head.signs("==", "False", ":")
    head.done()
    must_be(rows, "if passed>limit:")
    off, text = switched_off(rows, blocking=True)
    must_be(rows, "end", f"sleep({WAIT_STEP})", f"passed=passed+{WAIT_STEP}", "end", "end")
    return syntax_tree.ArcFunction(line, given, None, off, text)


def _watch_arc(line: int, words: Line, rows: Rows) -> syntax_tree.ArcFunction:
    """The thread that watches a torch which burns: its output, its input if it has one, and whether it
    stands."""
    words.signs("(", ")", ":")
    words.done()
    code = next_code(rows)
    lost = Line(code).words == Line("local arc_lost=0.0").words
    if lost:
        code = next_code(rows)
    if Line(code).words != Line("local arc_stood=0.0").words:
        raise ScriptError("syntax", f"{code!r}: local arc_stood=0.0 must stand here")
    must_be(rows, "local arc_place=get_actual_tcp_pose()", f"sleep({SETTLED})")
    head = Line(next_code(rows))
    head.signs("while")
    own = numbered(head, OUTPUTS_READ)
    head.signs("and")
    if lost:
        head.signs("arc_lost", "<=")
        head.exactly(LOST)
        head.signs("and")
    head.signs("arc_stood", "<=")
    stood = head.above(0.0, MOST_STOOD, "the longest stand")
    head.signs(":")
    head.done()
    must_be(rows, f"sleep({WAIT_STEP})")
    given: int | None = None
    if lost:
        must_be(rows, f"arc_lost=arc_lost+{WAIT_STEP}")
        burns = Line(next_code(rows))
        burns.signs("if")
        given = numbered(burns, INPUTS)
        burns.signs(":")
        burns.done()
        must_be(rows, "arc_lost=0.0", "end")
    must_be(rows, f"arc_stood=arc_stood+{WAIT_STEP}")
    gone = Line(next_code(rows))
    gone.signs("if", "point_dist", "(", "get_actual_tcp_pose", "(", ")", ",", "arc_place", ")", ">")
    far = gone.above(0.0, MOST_FAR, "how far it has to get")
    gone.signs(":")
    gone.done()
    must_be(rows, "arc_place=get_actual_tcp_pose()", "arc_stood=0.0", "end", "end")
    off, text = switched_off(rows, blocking=False)
    must_be(rows, "end")
    return syntax_tree.ArcFunction(line, given, own, off, text, stood, far)


def awaits_arc(word: str) -> bool:
    """Whether a name is that of a function that waits for a torch to burn."""
    found = re.fullmatch(syntax_tree.ARC_FUNCTION, word)
    return found is not None and found[1] == syntax_tree.AWAIT_ARC


def _condition(rows: Rows, word: str, *behind: str) -> tuple[tuple[int, ...], int]:
    """Inputs and the output of the head of a loop or branch: that an input is not the level asked for, with
    two of them that the second one is 0, or that an output is as ``behind`` says."""
    words = Line(next_code(rows))
    words.signs(word)
    numbers = [numbered(words, INPUTS)]
    words.signs("!=", "level", "or")
    if "or" in behind:
        numbers.append(numbered(words, INPUTS))
        words.signs(*behind[: behind.index("or") + 1])
        behind = behind[behind.index("or") + 1 :]
    own = numbered(words, OUTPUTS_READ)
    words.signs(*behind, ":")
    words.done()
    return tuple(numbers), own


def switched_off(rows: Rows, blocking: bool) -> tuple[tuple[int, ...], str]:
    """Outputs that are switched off, and the text that is shown before the program ends."""
    off: list[int] = []
    while True:
        words = Line(next_code(rows))
        word = words.next.text
        if word not in OUTPUT_WORDS:
            return tuple(off), ended(rows, blocking, words)
        words.take("name")
        words.signs("(")
        number, value = flag_of(words, OUTPUT_WORDS[word])
        words.signs(")")
        words.done()
        if value:
            raise ScriptError("syntax", "outputs go off where the program ends")
        off.append(number)


def ended(rows: Rows, blocking: bool, words: Line | None = None) -> str:
    """The text of a popup, behind which the program ends."""
    inner = Line(next_code(rows)) if words is None else words
    inner.signs("popup", "(")
    text, title, holds = shown(inner, error=True)
    inner.signs(")")
    inner.done()
    if holds != blocking or title != "Tandem":
        how = "hold the program" if blocking else "not hold the program"
        raise ScriptError("syntax", f"the popup before halt has to {how}")
    must_be(rows, "halt")
    return text
