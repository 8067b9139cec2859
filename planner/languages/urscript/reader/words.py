"""Splits lines of URScript into words and matches them with expected forms.

The readers of statements and of functions share this. Numbers may have an exponent, and must be within the
range of a controller.
"""

import functools
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from planner.languages.urscript.reader.syntax_tree import TEXT_LENGTH, SixNumbers
from planner.programs.steps import MAX_NUMBER

_WORD: Final = re.compile(
    r"\s*(?:(?P<number>-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?(?![\w.]))|(?P<name>[A-Za-z_]\w*)"
    r'|(?P<text>"[^"\\]*")|(?P<sign>!=|==|<=|[\[\]():,=>+]))',
    re.ASCII,
)
"""A word of a line: a number, a name, a text, or a sign."""
OUTPUT_WORDS: Final = {"set_standard_digital_out": 0, "set_configurable_digital_out": 8}
"""Functions that switch digital outputs; the value is added to their argument to number all outputs."""
OUTPUTS_READ: Final = {"get_standard_digital_out": 0, "get_configurable_digital_out": 8}
"""Functions that read outputs back; the value is added to their argument to number all outputs."""
OUTPUTS_EACH: Final = 8
"""Number of inputs or outputs that each of these functions accesses."""


class ScriptError(Exception):
    """A line does not have the expected form. `kind` is the fault's code without the prefix "urscript."."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.message = message


@dataclass(frozen=True, slots=True)
class ScriptWord:
    """A word as written, with its `kind`: number, name, text or sign."""

    kind: str
    text: str


def _words(code: str) -> tuple[ScriptWord, ...]:
    """Split a line into words; raise a ScriptError at text that is not a word."""
    out: list[ScriptWord] = []
    position = 0
    code = code.rstrip()
    while position < len(code):
        match = _WORD.match(code, position)
        if match is None or match.lastgroup is None:
            raise ScriptError(
                "syntax", f"{code[position : position + 20].strip()!r}: not a word of these programs"
            )
        out.append(ScriptWord(match.lastgroup, match[match.lastgroup]))
        position = match.end()
    return tuple(out)


@functools.cache
def _fixed_words(code: str) -> tuple[tuple[ScriptWord, str], ...]:
    """Return the words of a fixed part of a line, each with a description for faults.

    A description of "" stands for the word itself.
    """
    out: list[tuple[ScriptWord, str]] = []
    words = _words(code)
    for index, word in enumerate(words):
        description = word.text if word.kind == "number" else ""
        if word.kind == "name" and words[index + 1 : index + 2] == (ScriptWord("sign", "="),):
            description = f"the parameter {word.text}="
        out.append((word, description))
    return tuple(out)


class ScriptLine:
    """The words of a line, taken one by one."""

    def __init__(self, code: str) -> None:
        self.words = _words(code)
        self.position = 0

    @property
    def next_word(self) -> ScriptWord:
        """The next word, which is not taken; of kind ``end`` at the end of the line."""
        return (
            self.words[self.position]
            if self.position < len(self.words)
            else ScriptWord("end", "the line's end")
        )

    def fail(self, expected: str) -> NoReturn:
        """Raise a syntax error that names the next word and the expected text."""
        raise ScriptError("syntax", f"{self.next_word.text}: expected {expected}")

    def take(self, kind: str, text: str = "", what: str = "") -> str:
        """Take the next word, which must have a kind and, if given, a text; return its text.

        Args:
            kind: number, name, text or sign.
            text: Required text, "" for any.
            what: Description of the expected word in a fault, "" for the default one.
        """
        word = self.next_word
        if word.kind != kind or (text and word.text != text):
            self.fail(what or (repr(text) if text else f"a {kind}"))
        self.position += 1
        return word.text

    def values(self, *parts: "Part") -> list[Any]:
        """Take the next words, which must match ``parts``; return the values that functions among them read.

        Raises:
            ScriptError: A word is not the expected one.
        """
        out = []
        for part in parts:
            if isinstance(part, str):
                for word, description in _fixed_words(part):
                    self.take(word.kind, word.text, description)
            else:
                out.append(part(self))
        return out

    def rest(self, *parts: "Part") -> list[Any]:
        """Take the rest of the line, which must match ``parts``, and return its values as `values` does."""
        out = self.values(*parts)
        if self.next_word.kind != "end":
            self.fail("nothing more")
        return out

    def name(self) -> str:
        """Take a name."""
        return self.take("name")

    def number(self) -> float:
        """Take a number within the range of a controller."""
        text = self.take("number")
        value = float(text)
        if not abs(value) < MAX_NUMBER:
            raise ScriptError("number", f"{text:.40} is too large for a controller")
        return value or 0.0  # 0.0 for -0.0

    def flag(self) -> bool:
        """Take ``True`` or ``False``."""
        word = self.take("name", what="True or False")
        if word not in ("True", "False"):
            raise ScriptError("syntax", f"{word}: expected True or False")
        return word == "True"

    def text(self) -> str:
        """Take a string literal and return its content."""
        text = self.take("text")[1:-1]
        if len(text) > TEXT_LENGTH:
            raise ScriptError("string_length", f"a text of {len(text)} characters; allowed: {TEXT_LENGTH}")
        return text

    def numbers(self, count: int) -> tuple[float, ...]:
        """Take a list of ``count`` numbers."""
        self.take("sign", "[")
        out = [self.number()]
        while self.next_word.text == ",":
            self.take("sign", ",")
            out.append(self.number())
        self.take("sign", "]")
        if len(out) != count:
            raise ScriptError("type", f"a list of {len(out)} numbers; required: {count}")
        return tuple(out)

    def pose(self) -> SixNumbers:
        """Take a pose ``p[x, y, z, rx, ry, rz]``."""
        self.take("name", "p", "a pose p[...]")
        x, y, z, rx, ry, rz = self.numbers(6)
        return x, y, z, rx, ry, rz


Part = str | Callable[[ScriptLine], Any]
"""A part of a line: fixed words, or a function that reads a value."""


def positive_number(maximum: float, what: str) -> Callable[[ScriptLine], float]:
    """Return a function that reads a number above 0, up to a maximum; ``what`` names it in a fault."""

    def read(words: ScriptLine) -> float:
        value = words.number()
        if not 0.0 < value <= maximum:
            raise ScriptError("type", f"{what} is {value:g}; allowed: above 0, to {maximum:g}")
        return value

    return read


def popup(error: bool) -> tuple[Part, ...]:
    """Return the form of a popup's arguments: text, title, the required value of ``error``, and blocking."""
    return (ScriptLine.text, ",", ScriptLine.text, f",False,{error},blocking=", ScriptLine.flag)


Rows = Iterator[tuple[int, str]]
"""Lines of a file that are still to be read, with their numbers from 1."""


def next_code(rows: Rows) -> str:
    """Take rows up to the next one with code, and return that code; empty after the last one."""
    return next((code for _, row in rows if (code := split_comment(row)[0])), "")


def next_line(rows: Rows) -> ScriptLine:
    """Take rows up to the next one with code, and return its words."""
    return ScriptLine(next_code(rows))


def expect_lines(rows: Rows, *expected: str) -> None:
    """Take the next lines with code, which must be exactly these, except for spaces and comments."""
    for line in expected:
        code = next_code(rows)
        if ScriptLine(code).words != ScriptLine(line).words:
            raise ScriptError("syntax", f"{format_code(code)}: expected {line}")


def _number_of(words: ScriptLine, what: str) -> int:
    text = words.take("number")
    if not text.isdigit() or int(text) >= OUTPUTS_EACH:
        raise ScriptError("type", f"{what}{text}; allowed: whole numbers from 0 to {OUTPUTS_EACH - 1}")
    return int(text)


def _reads(offsets: Mapping[str, int]) -> Callable[[ScriptLine], int]:
    """Return a function that reads a call of one of ``offsets`` and returns its argument plus the offset."""

    def read(words: ScriptLine) -> int:
        word = words.take("name", what=" or ".join(offsets))
        if word not in offsets:
            raise ScriptError("syntax", f"{word}: expected {' or '.join(offsets)}")
        words.values("(")
        number = offsets[word] + _number_of(words, f"{word} of ")
        words.values(")")
        return number

    return read


input_read = _reads({"get_standard_digital_in": 0, "get_configurable_digital_in": 8})
"""Reads a call that reads an input, and returns the input's number."""
output_read = _reads(OUTPUTS_READ)
"""Reads a call that reads an output back, and returns the output's number."""


def switched_output(first: int) -> tuple[Part, ...]:
    """Return the form of the arguments that switch an output: ``first`` plus the number, and the value."""
    return (lambda words: first + _number_of(words, "output "), ",", ScriptLine.flag)


def split_comment(row: str) -> tuple[str, str]:
    """Return a row's code and its comment.

    No text contains a quote, so the first # outside of quotes starts the comment.
    """
    in_text = False
    for i, character in enumerate(row):
        if character == '"':
            in_text = not in_text
        elif character == "#" and not in_text:
            return row[:i].strip(), row[i:].strip()
    return row.strip(), ""


def without_comments(content: str) -> list[str]:
    """Return the rows of a file without comments, surrounding white space, and empty rows."""
    return [code for row in content.split("\n") if (code := split_comment(row)[0])]


def format_code(code: str) -> str:
    """Format a line for a message."""
    return repr(code if len(code) <= 60 else code[:57] + "...") if code else "the file's end"
