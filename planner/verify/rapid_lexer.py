"""Words of a RAPID text, read one at a time with their places.

The cursor is lazy: it looks one token ahead and leaves the text as it is, so that the parser can take whole
move instructions and whole number lists in one step where they have their usual form.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from typing import NamedTuple

_SKIP = re.compile(r"(?:[ \t\r\n]+|![^\n]*)*")
_TOKEN = re.compile(
    r"""(?P<name>[A-Za-z][A-Za-z0-9_]*)
    |(?P<number>(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.\#]))
    |(?P<string>"(?:[^"\n]|"")*")
    |(?P<symbol>:=|<>|<=|>=|[\\\[\]{}(),;:=<>+\-*/%])
    |(?P<bad>[\d_][\w.\#]*|"[^\n]*|[^\W\d]\w*|.)""",
    re.VERBOSE,
)


class Token(NamedTuple):
    """One word: `kind` is name, number, string, symbol, bad or end; `word` is `text` in lower case; `start`
    an offset.
    """

    kind: str
    text: str
    word: str
    start: int


class RapidSyntaxError(Exception):
    """Reading of one statement gave up; the parser turns it into a `Fault` and goes on behind the
    statement.
    """

    def __init__(self, start: int, code: str, message: str) -> None:
        super().__init__(message)
        self.start = start
        self.code = code
        self.message = message


class Cursor:
    """A place in a RAPID text with one token of look-ahead (`token`)."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._starts = [0, *(found.end() for found in re.finditer("\n", text))]
        self.end = 0  # offset behind the last token taken
        self.operators = 0  # of the expression that is being read
        self.token = Token("end", "", "", 0)
        self.jump(0)

    def jump(self, offset: int) -> None:
        """Go on at `offset`, which must not lie inside a string or a comment."""
        self.end = offset
        self.token = self._scan(offset)

    def _scan(self, offset: int) -> Token:
        skipped = _SKIP.match(self.text, offset)
        start = skipped.end() if skipped else offset
        found = _TOKEN.match(self.text, start)
        if found is None:
            return Token("end", "", "", len(self.text))
        text = found.group()
        return Token(found.lastgroup or "bad", text, text.lower(), start)

    def take(self) -> Token:
        """The current token; moves on to the next."""
        token = self.token
        self.end = token.start + len(token.text)
        self.token = self._scan(self.end)
        return token

    def take_symbol(self, symbol: str) -> bool:
        """Take the token if it is this symbol."""
        if self.token.kind == "symbol" and self.token.text == symbol:
            self.take()
            return True
        return False

    def take_word(self, *words: str) -> str | None:
        """Take the token if it is one of these words (lower case); gives the word taken."""
        if self.token.kind == "name" and self.token.word in words:
            return self.take().word
        return None

    def expect_symbol(self, symbol: str, where: str) -> None:
        """Take this symbol or raise `RapidSyntaxError`."""
        if not self.take_symbol(symbol):
            raise self.fault(f'"{symbol}" {where}')

    def expect_word(self, word: str, where: str) -> None:
        """Take this word or raise `RapidSyntaxError`."""
        if self.take_word(word) is None:
            raise self.fault(f"{word.upper()} {where}")

    def fault(self, allowed: str) -> RapidSyntaxError:
        """What to raise when the current token is not what is `allowed` here."""
        token = self.token
        if token.kind == "end":
            return RapidSyntaxError(token.start, "rapid.syntax", f"the text ends here; expected {allowed}")
        if token.kind == "bad":
            return bad_token(token)
        return RapidSyntaxError(token.start, "rapid.syntax", f"got {shown(token.text)}; expected {allowed}")

    def place(self, offset: int) -> tuple[int, int]:
        """Line and column, from 1, of an offset."""
        row = bisect_right(self._starts, offset)
        return row, offset - self._starts[row - 1] + 1

    @property
    def starts(self) -> tuple[int, ...]:
        """Offsets of the lines."""
        return tuple(self._starts)

    def line(self, offset: int) -> int:
        """Line, from 1, of an offset."""
        return bisect_right(self._starts, offset)


def shown(text: str) -> str:
    """Text for a message, cut to a readable length."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def bad_token(token: Token) -> RapidSyntaxError:
    """The fault of a token that no RAPID text may contain."""
    text, first = token.text, token.text[0]
    if first == '"':
        return RapidSyntaxError(
            token.start, "rapid.syntax", f"the string {shown(text)} is not closed on its line"
        )
    if first.isdigit() and re.fullmatch(r"[\d.]+(?:[eE][\w.#]*)?|\d[\d.]*#\w*", text):
        return RapidSyntaxError(
            token.start, "rapid.number", f"{shown(text)} is not a number; allowed: 12, 12.5, 1.2E3"
        )
    if first.isdigit():
        return RapidSyntaxError(
            token.start, "rapid.name_form", f"{shown(text)}: a name must not start with a digit"
        )
    return RapidSyntaxError(
        token.start, "rapid.syntax", f"{shown(text)} is not part of RAPID; names use A-Z, 0-9 and _"
    )
