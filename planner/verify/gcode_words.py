"""The proof's own reading of G-code, from bytes to words: all words of a file as arrays.

It shares nothing with the reader that plans: that one goes line by line, this one works on the whole file at
once. See docs/gcode.md for what the words mean.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

COMMENT = re.compile(rb"\([^()\n]*\)|;[^\n]*")
SLASH = re.compile(rb"^[ \t]*/", re.MULTILINE)
DELETED = re.compile(rb"^[ \t]*/[^\n]*", re.MULTILINE)
NUMBERED = re.compile(rb"^O\d+$", re.MULTILINE)
BLANK = b" \t\v\f\x1c\x1d\x1e\x1f\x85\xa0"
MARK = ord("%")
END = ord("\n")
_UPPER = bytes(range(256)).upper()


class UnreadableError(ValueError):
    """A file that the proof cannot read, at ``line`` (from 1, 0 for none)."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(reason)
        self.line = line


@dataclasses.dataclass(frozen=True)
class Words:
    """T words in order: ``letter`` (T,) as bytes' codes, ``value`` (T,), ``line`` (T,) from 1; ``marks``:
    lines that are a single %."""

    letter: NDArray[np.uint8]
    value: FloatArray
    line: IntArray
    marks: IntArray


def read(path: Path, block_delete: bool | None) -> Words:
    """The words of a file; ``block_delete``: leave out lines that begin with a slash. Raises
    ``UnreadableError``."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise UnreadableError(0, f"cannot be opened: {error.strerror or error}") from error
    return words(text, block_delete)


def words(text: bytes, block_delete: bool | None) -> Words:
    """The words of a text. Raises ``UnreadableError``."""
    text = text.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    slash = SLASH.search(text)
    if slash is not None:
        if block_delete is None:
            raise UnreadableError(
                _line(text, slash.end() - 1), "a line with / and no block_delete that says more"
            )
        text = DELETED.sub(b"", text) if block_delete else SLASH.sub(b"", text)
    text = COMMENT.sub(b"", text).translate(_UPPER, BLANK)
    text = NUMBERED.sub(b"", text) + b"\n"
    signs = np.frombuffer(text, dtype=np.uint8)
    number = np.cumsum(signs == END)  # of the lines that are over before a sign, but at the line's own end
    alone = np.flatnonzero(signs == MARK)
    edge = np.concatenate([[END], signs, [END]])
    for at in alone.tolist():
        if edge[at] != END or edge[at + 2] != END:
            raise UnreadableError(int(number[at]) + 1, "% amid a line")
    marks = number[alone] + 1
    if len(alone):
        text = text.replace(b"%", b"")
        signs = np.frombuffer(text, dtype=np.uint8)
        number = np.cumsum(signs == END)
    capital = (signs >= ord("A")) & (signs <= ord("Z"))
    digit = ((signs >= ord("0")) & (signs <= ord("9"))) | np.isin(signs, list(b"+-."))
    _all(~(capital | digit | (signs == END)), number, "a sign that is no part of a word of G-code")
    before = np.concatenate([[END], signs[:-1]])
    _all(digit & (before == END), number, "a number without a letter before it")
    letters = np.flatnonzero(capital)
    _all(capital & ~np.append(digit[1:], False), number, "a letter without a number behind it")
    line = number[letters] + 1
    values = text.translate(
        bytes(32 if chr(k).isascii() and chr(k).isupper() else k for k in range(256))
    ).split()
    return Words(signs[letters], _numbers(values, line), line, marks)


def _numbers(values: list[bytes], line: IntArray) -> FloatArray:
    """Numbers (T,) as they are written. Raises ``UnreadableError``."""
    try:
        return np.array(values).astype(np.float64) if values else np.zeros(0)
    except ValueError:
        for value, at in zip(values, line.tolist(), strict=True):
            try:
                float(value)
            except ValueError as error:
                raise UnreadableError(at, f"{value.decode()} is no number") from error
        raise


def _all(wrong: NDArray[np.bool_], number: IntArray, reason: str) -> None:
    if wrong.any():
        raise UnreadableError(int(number[int(np.argmax(wrong))]) + 1, reason)


def _line(text: bytes, at: int) -> int:
    return text.count(b"\n", 0, at) + 1
