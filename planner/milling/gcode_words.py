"""One line of G-code as words: letters with numbers, without comments and white space."""

from __future__ import annotations

import re
from typing import Final

Word = tuple[str, float]

LONGEST: Final = 256
"""Characters of a line's words, as controllers allow (RS274/NGC); no number is too large then."""
COMMENT: Final = re.compile(r"\([^()]*\)|;.*")
WORD: Final = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")


class LineError(ValueError):
    """A line that is no G-code: ``word`` is the text at fault, the message says what to do."""

    def __init__(self, word: str, message: str) -> None:
        super().__init__(message)
        self.word = word


def bare(line: str) -> str:
    """The line in capitals, without comments and white space, which mean nothing anywhere in a line.

    Raises :class:`LineError` where a comment is not closed.
    """
    if "(" in line or ";" in line or ")" in line:
        line = COMMENT.sub("", line)
        if "(" in line or ")" in line:
            raise LineError("(", "a comment is opened or closed but not both; pair ( and ) within the line")
    return "".join(line.split()).upper()


def words(text: str) -> list[Word]:
    """The words of a bare line, in order, their numbers as they stand. Raises :class:`LineError`."""
    found = WORD.findall(text)
    if sum(len(number) for _, number in found) + len(found) != len(text):
        raise _refuse(text)
    if len(text) > LONGEST:
        raise LineError("", f"{len(text)} characters of words on a line, at most {LONGEST} are read; part it")
    return [(letter, float(number)) for letter, number in found]


def code(letter: str, value: float) -> str:
    """The usual name of a code, ``G1``, ``G90.1``."""
    return f"{letter}{value:g}"


def _refuse(text: str) -> LineError:
    place = 0
    while (met := WORD.match(text, place)) is not None:
        place = met.end()
    rest = text[place : place + 12]
    if rest[0] in "#[]=*<" or (len(rest) > 1 and rest[1] in "#["):
        what = "parameters and expressions are not computed; let the CAM system write plain numbers"
        return LineError(rest[0], f"got {rest!r}: {what}")
    if rest[0].isalpha() and rest[0].isascii():
        what = "the word has no number, or one that is not written as 12, 12., .5 or -1.5; correct it"
        return LineError(rest[0], f"got {rest!r}: {what}")
    return LineError("", f"got {rest!r}, which is no word of G-code (a letter and a number); correct it")
