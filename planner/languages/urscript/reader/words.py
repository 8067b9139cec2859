"""The words of a line of URScript, taken one by one, and lines of one form: what the readers of statements
and of functions have in common. Numbers are plain or with an exponent, smaller than a controller's largest.
"""

import functools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NoReturn

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


def _words(code: str) -> tuple[Word, ...]:
    out: list[Word] = []
    place = 0
    code = code.rstrip()
    while place < len(code):
        found = _WORD.match(code, place)
        if found is None or found.lastgroup is None:
            raise ScriptError("syntax", f"{code[place : place + 20].strip()!r}: no word of these programs")
        out.append(Word(found.lastgroup, found[found.lastgroup]))
        place = found.end()
    return tuple(out)


@functools.cache
def _fixed(code: str) -> tuple[tuple[Word, str], ...]:
    """Words that have to stand as they are, and what faults call them: "" for themselves in quotes."""
    out: list[tuple[Word, str]] = []
    words = _words(code)
    for index, word in enumerate(words):
        what = word.text if word.kind == "number" else ""
        if word.kind == "name" and words[index + 1 : index + 2] == (Word("sign", "="),):
            what = f"the parameter {word.text}="
        out.append((word, what))
    return tuple(out)


class Line:
    """The words of a line, taken one by one."""

    def __init__(self, code: str) -> None:
        self.words = _words(code)
        self.at = 0

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

    def values(self, *parts: "Part") -> list[Any]:
        """The values of what stands next, which has to be of this form."""
        out = []
        for part in parts:
            if isinstance(part, str):
                for word, what in _fixed(part):
                    self.take(word.kind, word.text, what)
            else:
                out.append(part(self))
        return out

    def rest(self, *parts: "Part") -> list[Any]:
        """The values of all that is left of the line, which has to be of this form."""
        out = self.values(*parts)
        if self.next.kind != "end":
            self.fail("nothing more")
        return out

    def name(self) -> str:
        return self.take("name")

    def number(self) -> float:
        text = self.take("number")
        value = float(text)
        if not abs(value) < LARGEST_NUMBER:
            raise ScriptError("number", f"{text:.40} is no number that a controller holds")
        return value or 0.0

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


Part = str | Callable[[Line], Any]
"""A part of a line: words as they are, or what reads a value."""


def above_zero(most: float, what: str) -> Callable[[Line], float]:
    """Reads a number above 0, to ``most``."""

    def read(words: Line) -> float:
        value = words.number()
        if not 0.0 < value <= most:
            raise ScriptError("type", f"{what} is {value:g}; allowed: above 0, to {most:g}")
        return value

    return read


def popup(error: bool) -> tuple[Part, ...]:
    """Text, title, and whether it holds the program, of a popup."""
    return (Line.text, ",", Line.text, f",False,{error},blocking=", Line.flag)


Rows = Iterator[tuple[int, str]]
"""Rows of a file that are still to be read, with their numbers."""


def next_code(rows: Rows) -> str:
    """The code of the next row that has any, empty behind the last one."""
    return next((code for _, row in rows if (code := parted(row)[0])), "")


def next_line(rows: Rows) -> Line:
    """The words of the next row that has any."""
    return Line(next_code(rows))


def must_be(rows: Rows, *wanted: str) -> None:
    """The next lines, which have to be these very ones but for spaces."""
    for one in wanted:
        code = next_code(rows)
        if Line(code).words != Line(one).words:
            raise ScriptError("syntax", f"{shown_code(code)}: {one} must stand here")


def _number_of(words: Line, what: str) -> int:
    text = words.take("number")
    if not text.isdigit() or int(text) >= OUTPUTS_EACH:
        raise ScriptError("type", f"{what}{text}; allowed: whole numbers from 0 to {OUTPUTS_EACH - 1}")
    return int(text)


def _reads(known: Mapping[str, int]) -> Callable[[Line], int]:
    def read(words: Line) -> int:
        word = words.take("name", what=" or ".join(known))
        if word not in known:
            raise ScriptError("syntax", f"{word}: {' or '.join(known)} must stand here")
        words.values("(")
        number = known[word] + _number_of(words, f"{word} of ")
        words.values(")")
        return number

    return read


input_read = _reads({"get_standard_digital_in": 0, "get_configurable_digital_in": 8})
"""Reads the number of an input that a function reads."""
output_read = _reads(OUTPUTS_READ)
"""Reads the number of an output that a function reads back."""


def switched(first: int) -> tuple[Part, ...]:
    """The number of an output that is switched, counted on from ``first``, and its value."""
    return (lambda words: first + _number_of(words, "output "), ",", Line.flag)


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
