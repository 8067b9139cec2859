"""URScript text to statements: words of a line, then the one form that each statement may have.

Whatever is not of such a form is a fault with its line. Numbers are plain or with an exponent,
smaller than a controller's largest. Words count with their case. Comments begin with # and say
nothing, but for the head of a segment.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal, NoReturn

from planner.verify.programs.steps import LARGEST_NUMBER, Fault
from planner.verify.urscript.syntax_tree import (
    LINE_LENGTH,
    NAME_LENGTH,
    RESERVED,
    TEXT_LENGTH,
    Begins,
    Data,
    Joint,
    Look,
    Output,
    Pause,
    Popup,
    Program,
    SetPayload,
    SetTcp,
    Six,
    Statement,
    Straight,
)

_WORD: Final = re.compile(
    r"\s*(?:(?P<number>-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?(?![\w.]))|(?P<name>[A-Za-z_]\w*)"
    r'|(?P<text>"[^"\\]*")|(?P<sign>[\[\]():,=>]))',
    re.ASCII,
)
"""A word of a line: a number, a name, a text, or a sign."""
_SEGMENT: Final = re.compile(r"#\s*Segment\s+([\w/]+):.*", re.ASCII)
"""The comment with which a segment begins."""
_TITLES: Final[dict[tuple[str, bool], Literal["question", "read", "note"]]] = {
    ("Tandem asks", True): "question",
    ("Tandem tells", True): "read",
    ("Tandem", False): "note",
}
"""What a popup is by its title, and whether it holds the program."""
OUTPUT_WORDS: Final = {"set_standard_digital_out": 0, "set_configurable_digital_out": 8}
"""Functions that switch digital outputs, and the number of their first one here."""
_OUTPUTS_EACH: Final = 8
"""How many outputs each of them has."""
MOST_SECONDS: Final = 3600.0
"""Longest move or pause that is read [s]."""


class ScriptError(Exception):
    """A line is no statement. `kind` is a fault's code without the language."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind, self.message = kind, message


@dataclass(frozen=True, slots=True)
class Word:
    """`kind` number, name, text or sign, and the word as written."""

    kind: str
    text: str


class _Line:
    """The words of a line, taken one by one."""

    def __init__(self, code: str) -> None:
        self.words: list[Word] = []
        self.at, place = 0, 0
        code = code.rstrip()
        while place < len(code):
            found = _WORD.match(code, place)
            if found is None or found.lastgroup is None:
                raise ScriptError(
                    "syntax", f"{code[place : place + 20].strip()!r}: no word of these programs"
                )
            self.words.append(Word(found.lastgroup, found[found.lastgroup]))
            place = found.end()

    @property
    def next(self) -> Word:
        return self.words[self.at] if self.at < len(self.words) else Word("end", "the line's end")

    def fail(self, wanted: str) -> NoReturn:
        raise ScriptError("syntax", f"{self.next.text}: {wanted} must stand here")

    def take(self, kind: str, text: str = "", what: str = "") -> str:
        """The next word, which has to be of a kind, and if stated the very text."""
        word = self.next
        if word.kind != kind or (text and word.text != text):
            self.fail(what or (repr(text) if text else f"a {kind}"))
        self.at += 1
        return word.text

    def signs(self, *texts: str) -> None:
        for text in texts:
            self.take("name" if text[0].isalpha() else "sign", text)

    def number(self) -> float:
        text = self.take("number")
        value = float(text)
        if not abs(value) < LARGEST_NUMBER:
            raise ScriptError("number", f"{text:.40} is no number that a controller holds")
        return value or 0.0

    def above(self, least: float, most: float, what: str) -> float:
        """A number of a range, its lower end left out."""
        value = self.number()
        if not least < value <= most:
            raise ScriptError("type", f"{what} is {value:g}; allowed: above {least:g}, to {most:g}")
        return value

    def flag(self) -> bool:
        word = self.take("name", what="True or False")
        if word not in ("True", "False"):
            raise ScriptError("syntax", f"{word}: True or False must stand here")
        return word == "True"

    def text(self) -> str:
        text = self.take("text")[1:-1]
        if len(text) > TEXT_LENGTH:
            raise ScriptError("string_length", f"a text of {len(text)} characters; allowed: {TEXT_LENGTH}")
        return text

    def numbers(self, count: int) -> tuple[float, ...]:
        """A list of so many numbers."""
        self.take("sign", "[")
        out = [self.number()]
        while self.next.text == ",":
            self.take("sign", ",")
            out.append(self.number())
        self.take("sign", "]")
        if len(out) != count:
            raise ScriptError("type", f"a list of {len(out)} numbers; {count} are needed")
        return tuple(out)

    def pose(self) -> Six:
        self.take("name", "p", "a pose p[...]")
        x, y, z, rx, ry, rz = self.numbers(6)
        return x, y, z, rx, ry, rz

    def keyed(self, key: str) -> None:
        """A comma, the name of a parameter, and its sign."""
        self.take("sign", ",")
        self.take("name", key, f"the parameter {key}=")
        self.take("sign", "=")

    def done(self) -> None:
        if self.next.kind != "end":
            self.fail("nothing more")


def _movel(line: int, words: _Line) -> Statement:
    words.signs("pose_trans", "(")
    frame = words.take("name")
    words.signs(",")
    place = words.pose()
    words.signs(")")
    words.keyed("t")
    seconds = words.above(0.0, MOST_SECONDS, "t")
    words.keyed("r")
    radius = words.number()
    if not 0.0 <= radius <= 1.0:
        raise ScriptError("type", f"r is {radius:g}; allowed: 0 to 1 (m)")
    return Straight(line, frame, place, seconds, radius)


def _movej(line: int, words: _Line) -> Statement:
    name = words.take("name")
    words.keyed("a")
    acceleration = words.above(0.0, 100.0, "a")
    words.keyed("v")
    return Joint(line, name, acceleration, words.above(0.0, 10.0, "v"))


def _payload(line: int, words: _Line) -> Statement:
    mass = words.above(0.0, 1000.0, "the mass")
    words.signs(",")
    x, y, z = words.numbers(3)
    return SetPayload(line, mass, (x, y, z))


def _popup(line: int, words: _Line) -> Statement:
    text, title, blocking = _shown(words, error=False)
    kind = _TITLES.get((title, blocking))
    if kind is None:
        told = "blocking" if blocking else "not blocking"
        raise ScriptError("syntax", f"a popup with the title {title!r}, {told}: none of these programs")
    return Popup(line, kind, text)


def _shown(words: _Line, error: bool) -> tuple[str, str, bool]:
    """Text, title, and whether it holds the program, of a popup."""
    text = words.text()
    words.signs(",")
    title = words.text()
    words.signs(",", "False", ",", "True" if error else "False")
    words.keyed("blocking")
    return text, title, words.flag()


def _output(first: int) -> Callable[[int, _Line], Statement]:
    def read(line: int, words: _Line) -> Statement:
        text = words.take("number")
        if not text.isdigit() or int(text) >= _OUTPUTS_EACH:
            raise ScriptError("type", f"output {text}; allowed: whole numbers from 0 to {_OUTPUTS_EACH - 1}")
        words.signs(",")
        return Output(line, first + int(text), words.flag())

    return read


_CALLS: Final[dict[str, Callable[[int, _Line], Statement]]] = {
    "movel": _movel,
    "movej": _movej,
    "set_tcp": lambda line, words: SetTcp(line, words.take("name")),
    "set_payload": _payload,
    "sleep": lambda line, words: Pause(line, words.above(0.0, MOST_SECONDS, "a pause")),
    "popup": _popup,
    **{word: _output(first) for word, first in OUTPUT_WORDS.items()},
}
"""Statements by the function that they call: its name and what reads its parameters."""


class Reader:
    """Reads one file; `faults` are filled meanwhile."""

    def __init__(self, text: str, file: str) -> None:
        self.rows = text.split("\n")
        self.file = file
        self.faults: list[Fault] = []

    def fault(self, line: int, kind: str, message: str) -> None:
        self.faults.append(Fault(line, 1, f"urscript.{kind}", message, self.file))

    def program(self) -> Program | None:
        """The file's program, None where it has no head."""
        name, data, body, ended = "", dict[str, Data](), list[Statement](), False
        rows = iter(enumerate(self.rows, 1))
        for line, row in rows:
            if len(row.rstrip()) > LINE_LENGTH:
                self.fault(line, "line_length", f"{len(row)} characters; allowed: {LINE_LENGTH}")
            code, comment = parted(row)
            try:
                if (segment := _SEGMENT.fullmatch(comment)) and not code and name and not ended:
                    body.append(Begins(line, segment[1]))
                if not code:
                    continue
                if ended:
                    raise ScriptError("syntax", f"{_shown_code(code)}: nothing stands behind the program")
                words = _Line(code)
                if not name:
                    name = _head(words)
                elif code == "end":
                    ended = True
                elif code.startswith("if"):
                    body.append(self._look(line, words, rows))
                elif words.words[1:2] == [Word("sign", "=")]:
                    self._datum(line, words, data, body)
                else:
                    body.append(_statement(line, words))
            except ScriptError as wrong:
                self.fault(line, wrong.kind, wrong.message)
                if not name:
                    return None
        if not name:
            self.fault(len(self.rows), "syntax", "the file has no program: def NAME(): must stand here")
            return None
        if not ended:
            self.fault(len(self.rows), "syntax", "the program has no end")
        return Program(self.file, name, data, tuple(body))

    def _datum(self, line: int, words: _Line, data: dict[str, Data], body: list[Statement]) -> None:
        name = words.take("name")
        words.signs("=")
        _named(name)
        if name in data:
            raise ScriptError("name_duplicate", f"{name} has a value in line {data[name].line} already")
        if any(not isinstance(statement, Begins) for statement in body):
            raise ScriptError("syntax", f"{name} gets its value behind the first statement")
        if words.next.kind == "text":
            found = Data(line, "text", words.text())
        elif words.next.text == "p":
            found = Data(line, "pose", words.pose())
        else:
            found = Data(line, "joints", words.numbers(6))
        words.done()
        data[name] = found

    def _look(self, line: int, words: _Line, rows: Iterator[tuple[int, str]]) -> Look:
        words.signs("if", "point_dist", "(", "get_forward_kin", "(")
        name = words.take("name")
        words.signs(",")
        tip = words.pose()
        words.signs(")", ",")
        place = words.pose()
        words.signs(")", ">")
        most = words.above(0.0, 1.0, "the distance")
        words.signs(":")
        words.done()
        text = ""
        for wanted in ("popup", "halt", "end"):
            code = next((code for _, row in rows if (code := parted(row)[0])), "")
            if wanted != "popup":
                if code != wanted:
                    raise ScriptError("syntax", f"{_shown_code(code)}: {wanted} must stand here")
                continue
            inner = _Line(code)
            inner.signs("popup", "(")
            text, title, blocking = _shown(inner, error=True)
            inner.signs(")")
            inner.done()
            if not blocking or title != "Tandem":
                raise ScriptError("syntax", "the popup before halt has to hold the program")
        return Look(line, name, tip, place, most, text)


def _head(words: _Line) -> str:
    words.signs("def")
    name = words.take("name")
    words.signs("(", ")", ":")
    words.done()
    _named(name)
    return name


def _named(name: str) -> None:
    if len(name) > NAME_LENGTH:
        raise ScriptError("name_length", f"{name} has {len(name)} characters; allowed: {NAME_LENGTH}")
    if name in RESERVED:
        raise ScriptError("name_reserved", f"{name} is a word of URScript; take another name")


def _statement(line: int, words: _Line) -> Statement:
    word = words.take("name", what="a statement")
    read = _CALLS.get(word)
    if read is None:
        raise ScriptError("syntax", f"{word}: no statement of these programs")
    words.signs("(")
    out = read(line, words)
    words.signs(")")
    words.done()
    return out


def parted(row: str) -> tuple[str, str]:
    """A row's code and its comment; no text holds a quote, so that the first # outside of quotes begins
    it."""
    inside = False
    for i, letter in enumerate(row):
        if letter == '"':
            inside = not inside
        elif letter == "#" and not inside:
            return row[:i].strip(), row[i:].strip()
    return row.strip(), ""


def without_comments(content: str) -> list[str]:
    """The rows of a file without comments, white space around them, and empty rows."""
    return [code for row in content.split("\n") if (code := parted(row)[0])]


def _shown_code(code: str) -> str:
    return repr(code if len(code) <= 60 else code[:57] + "...") if code else "the file's end"
