"""URScript text to statements: words of a line, then the one form that each statement may have.

Whatever is not of such a form is a fault with its line. Words count with their case. Comments begin
with # and say nothing, but for the head of a segment.
"""

import functools
import re
from collections.abc import Callable
from typing import Final, Literal

from planner.languages.urscript.reader import syntax_tree
from planner.languages.urscript.reader.functions import awaits_arc, ended, function, switched_off
from planner.languages.urscript.reader.words import (
    OUTPUT_WORDS,
    OUTPUTS_READ,
    Line,
    Part,
    Rows,
    ScriptError,
    Word,
    above_zero,
    must_be,
    next_line,
    output_read,
    parted,
    popup,
    shown_code,
    switched,
)
from planner.programs.steps import Fault

_SEGMENT: Final = re.compile(r"#\s*Segment\s+([\w/]+):.*", re.ASCII)
"""The comment with which a segment begins."""
_TITLES: Final[dict[tuple[str, bool], Literal["question", "read", "note"]]] = {
    ("Tandem asks", True): "question",
    ("Tandem tells", True): "read",
    ("Tandem", False): "note",
}
"""What a popup is by its title, and whether it holds the program."""
_KILL: Final = re.compile(rf"kill\s+({syntax_tree.WATCHING}|{syntax_tree.WATCHING_ARC}((?:_\d+)?))")
_RUN_WATCH: Final = re.compile(rf"{syntax_tree.WATCHING}\s*=\s*run\s+{syntax_tree.WATCH}\s*\(\s*\)")
_RUN_ARC: Final = re.compile(
    rf"{syntax_tree.WATCHING_ARC}((?:_\d+)?)\s*=\s*run\s+{syntax_tree.WATCH_ARC}((?:_\d+)?)\s*\(\s*\)"
)
"""Statements that end and begin threads."""
MOST_SECONDS: Final = 3600.0
"""Longest move or pause that is read [s]."""
MOST_WAIT: Final = 1e6
"""Longest wait for the other program that is read [s]."""


def _radius(words: Line) -> float:
    radius = words.number()
    if not 0.0 <= radius <= 1.0:
        raise ScriptError("type", f"r is {radius:g}; allowed: 0 to 1 (m)")
    return radius


def _popup(line: int, text: str, title: str, blocking: bool) -> syntax_tree.Statement:
    kind = _TITLES.get((title, blocking))
    if kind is None:
        told = "blocking" if blocking else "not blocking"
        raise ScriptError("syntax", f"a popup with the title {title!r}, {told}: none of these programs")
    return syntax_tree.Popup(line, kind, text)


def _thread(line: int, row: str) -> syntax_tree.Statement | None:
    """The statement that begins or ends a thread, None for another one."""
    if found := _KILL.fullmatch(row):
        if found[1] == syntax_tree.WATCHING:
            return syntax_tree.Watch(line, False)
        return syntax_tree.GuardArc(line, syntax_tree.WATCH_ARC + found[2], False)
    if _RUN_WATCH.fullmatch(row):
        return syntax_tree.Watch(line, True)
    if found := _RUN_ARC.fullmatch(row):
        thread = syntax_tree.WATCH_ARC + found[2]
        if found[1] != found[2]:
            raise ScriptError("syntax", f"{thread} is held by another one's variable")
        return syntax_tree.GuardArc(line, thread, True)
    return None


_CALLS: Final[dict[str, tuple[Callable[..., syntax_tree.Statement], tuple[Part, ...]]]] = {
    "movel": (
        syntax_tree.Straight,
        ("pose_trans(", Line.name, ",", Line.pose, "),t=", above_zero(MOST_SECONDS, "t"), ",r=", _radius),
    ),
    "movej": (syntax_tree.Joint, (Line.name, ",a=", above_zero(100.0, "a"), ",v=", above_zero(10.0, "v"))),
    "set_tcp": (syntax_tree.SetTcp, (Line.name,)),
    "set_payload": (
        syntax_tree.SetPayload,
        (above_zero(1000.0, "the mass"), ",", lambda words: words.numbers(3)),
    ),
    "sleep": (syntax_tree.Pause, (above_zero(MOST_SECONDS, "a pause"),)),
    "popup": (_popup, popup(error=False)),
    syntax_tree.CHECK: (syntax_tree.Check, (Line.flag, ",", Line.flag)),
    syntax_tree.STAND: (syntax_tree.Stand, (above_zero(MOST_SECONDS, "a move's time"),)),
    **{
        word: (
            functools.partial(syntax_tree.Await, name=word),
            (Line.flag, ",", above_zero(MOST_WAIT, "the longest wait")),
        )
        for word in (syntax_tree.AWAIT_LINE, syntax_tree.AWAIT_RUNNING)
    },
    **{word: (syntax_tree.Output, switched(first)) for word, first in OUTPUT_WORDS.items()},
}
"""Statements by the function that they call: what they become, and the form of the parameters."""


class Reader:
    """Reads one file; `faults` are filled meanwhile."""

    def __init__(self, text: str, file: str) -> None:
        self.rows = text.split("\n")
        self.file = file
        self.faults: list[Fault] = []

    def fault(self, line: int, kind: str, message: str) -> None:
        self.faults.append(Fault(line, 1, f"urscript.{kind}", message, self.file))

    def program(self) -> syntax_tree.Program | None:
        """The file's program, None where it has no head."""
        name, data, body, closed = "", dict[str, syntax_tree.Data](), list[syntax_tree.Statement](), False
        endings: dict[str, syntax_tree.Ending | syntax_tree.ArcFunction] = {}
        rows = iter(enumerate(self.rows, 1))
        for line, row in rows:
            if len(row.rstrip()) > syntax_tree.LINE_LENGTH:
                self.fault(line, "line_length", f"{len(row)} characters; allowed: {syntax_tree.LINE_LENGTH}")
            code, comment = parted(row)
            try:
                if (segment := _SEGMENT.fullmatch(comment)) and not code and name and not closed:
                    body.append(syntax_tree.Begins(line, segment[1]))
                if not code:
                    continue
                if closed:
                    raise ScriptError("syntax", f"{shown_code(code)}: nothing stands behind the program")
                words = Line(code)
                if not name:
                    name = _head(words)
                elif code == "end":
                    closed = True
                elif words.next in (Word("name", "def"), Word("name", "thread")):
                    if any(not isinstance(statement, syntax_tree.Begins) for statement in body):
                        raise ScriptError("syntax", "a function or thread stands behind the first statement")
                    word, ending = function(line, words, rows)
                    if word in endings:
                        raise ScriptError(
                            "name_duplicate", f"{word} stands in line {endings[word].line} already"
                        )
                    endings[word] = ending
                elif (watch := _thread(line, code)) is not None:
                    body.append(watch)
                elif code.startswith("if"):
                    body.append(self._branch(line, words, rows))
                elif words.words[1:2] == (Word("sign", "="),):
                    self._datum(line, words, data, body)
                else:
                    body.append(_call(line, words))
            except ScriptError as wrong:
                self.fault(line, wrong.kind, wrong.message)
                if not name:
                    return None
        if not name:
            self.fault(len(self.rows), "syntax", "the file has no program: def NAME(): must stand here")
            return None
        if not closed:
            self.fault(len(self.rows), "syntax", "the program has no end")
        met = {word: one for word, one in endings.items() if isinstance(one, syntax_tree.Ending)}
        torches = {word: one for word, one in endings.items() if isinstance(one, syntax_tree.ArcFunction)}
        return syntax_tree.Program(self.file, name, data, tuple(body), met, torches)

    def _datum(
        self, line: int, words: Line, data: dict[str, syntax_tree.Data], body: list[syntax_tree.Statement]
    ) -> None:
        (name,) = words.values(Line.name, "=")
        _named(name)
        if name in data:
            raise ScriptError("name_duplicate", f"{name} has a value in line {data[name].line} already")
        if any(not isinstance(statement, syntax_tree.Begins) for statement in body):
            raise ScriptError("syntax", f"{name} gets its value behind the first statement")
        if words.next.kind == "text":
            found = syntax_tree.Data(line, "text", words.text())
        elif words.next.text == "p":
            found = syntax_tree.Data(line, "pose", words.pose())
        else:
            found = syntax_tree.Data(line, "joints", words.numbers(6))
        words.rest()
        data[name] = found

    def _branch(self, line: int, words: Line, rows: Rows) -> syntax_tree.Look | syntax_tree.StaysLow:
        """The two branches there are: both show a text and end the program."""
        words.values("if")
        if words.next.text in OUTPUTS_READ:
            (number,) = words.rest(output_read, ":")
            off, text = switched_off(rows, blocking=True)
            must_be(rows, "end")
            return syntax_tree.StaysLow(line, number, off, text)
        looked: tuple[Part, ...] = (Line.name, ",", Line.pose, "),", Line.pose)
        name, tip, place, most = words.rest(
            "point_dist(get_forward_kin(", *looked, ")>", above_zero(1.0, "the distance"), ":"
        )
        text = ended(next_line(rows), rows, blocking=True)
        must_be(rows, "end")
        return syntax_tree.Look(line, name, tip, place, most, text)


def _head(words: Line) -> str:
    (name,) = words.rest("def", Line.name, "():")
    _named(name)
    return str(name)


def _named(name: str) -> None:
    if len(name) > syntax_tree.NAME_LENGTH:
        raise ScriptError(
            "name_length", f"{name} has {len(name)} characters; allowed: {syntax_tree.NAME_LENGTH}"
        )
    if (
        name in syntax_tree.RESERVED
        or re.fullmatch(syntax_tree.ARC_FUNCTION, name)
        or re.fullmatch(syntax_tree.ARC_VARIABLE, name)
    ):
        raise ScriptError("name_reserved", f"{name} is a word of URScript; take another name")


def _call(line: int, words: Line) -> syntax_tree.Statement:
    word = words.take("name", what="a statement")
    if awaits_arc(word):
        make: Callable[..., syntax_tree.Statement] = functools.partial(syntax_tree.AwaitArc, name=word)
        parts: tuple[Part, ...] = (above_zero(MOST_SECONDS, "the longest wait"),)
    elif word in _CALLS:
        make, parts = _CALLS[word]
    else:
        raise ScriptError("syntax", f"{word}: no statement of these programs")
    out = make(line, *words.values("(", *parts))
    words.rest(")")
    return out
