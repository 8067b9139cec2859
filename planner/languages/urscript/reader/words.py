"""The words of a line of URScript, taken one by one, and lines of one form: what the readers of statements
and of functions have in common. Numbers are plain or with an exponent, smaller than a controller's largest.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NoReturn

from planner.languages.urscript.reader.syntax_tree import TEXT_LENGTH, Six
from planner.programs.steps import LARGEST_NUMBER

_WORD: Final = re.compile(
    r"\s*(?:(?P<number>-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?(?![\w.]))|(?P<name>[A-Za-z_]\w*)"
    r'|(?P<text>"[^"\\]*")|(?P<sign>!=|==|<=|[\[\]():,=>+]))',
    re.ASCII,
)
"""A word of a line: a number, a name, a text, or a sign."""
OUTPUT_WORDS: Final = {"set_standard_digital_out": 0, "set_configurable_digital_out": 8}
"""Functions that switch digital outputs, and the number of their first one here."""
INPUTS: Final = {"get_standard_digital_in": 0, "get_configurable_digital_in": 8}
"""Those that read inputs."""
OUTPUTS_READ: Final = {"get_standard_digital_out": 0, "get_configurable_digital_out": 8}
"""Those that read outputs."""
OUTPUTS_EACH: Final = 8
"""How many outputs each of them has."""


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


class Line:
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

    def exactly(self, text: str) -> None:
        """The next number, which has to be written so."""
        if self.next.text != text:
            self.fail(text)
        self.take("number")

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


def shown(words: Line, error: bool) -> tuple[str, str, bool]:
    """Text, title, and whether it holds the program, of a popup."""
    text = words.text()
    words.signs(",")
    title = words.text()
    words.signs(",", "False", ",", "True" if error else "False")
    words.keyed("blocking")
    return text, title, words.flag()


Rows = Iterator[tuple[int, str]]
"""Rows of a file that are still to be read, with their numbers."""


def next_code(rows: Rows) -> str:
    """The code of the next row that has any, empty behind the last one."""
    return next((code for _, row in rows if (code := parted(row)[0])), "")


def must_be(rows: Rows, *wanted: str) -> None:
    """The next lines, which have to be these very ones but for spaces."""
    for one in wanted:
        code = next_code(rows)
        if Line(code).words != Line(one).words:
            raise ScriptError("syntax", f"{shown_code(code)}: {one} must stand here")


def numbered(words: Line, known: Mapping[str, int]) -> int:
    """The number of an input or output that one of these functions names."""
    word = words.take("name", what=" or ".join(known))
    if word not in known:
        raise ScriptError("syntax", f"{word}: {' or '.join(known)} must stand here")
    words.signs("(")
    text = words.take("number")
    if not text.isdigit() or int(text) >= OUTPUTS_EACH:
        raise ScriptError("type", f"{word} of {text}; allowed: whole numbers from 0 to {OUTPUTS_EACH - 1}")
    words.signs(")")
    return known[word] + int(text)


def flag_of(words: Line, first: int) -> tuple[int, bool]:
    """The number of an output that is switched, counted on from ``first``, and its value."""
    text = words.take("number")
    if not text.isdigit() or int(text) >= OUTPUTS_EACH:
        raise ScriptError("type", f"output {text}; allowed: whole numbers from 0 to {OUTPUTS_EACH - 1}")
    words.signs(",")
    return first + int(text), words.flag()


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


def shown_code(code: str) -> str:
    """A line as a message shows it."""
    return repr(code if len(code) <= 60 else code[:57] + "...") if code else "the file's end"
