"""Program files as text: bytes to characters, ends of lines, and characters that a controller may take for
something else than the readers here do."""

from __future__ import annotations

import re
import unicodedata
from pathlib import PurePosixPath

from planner.verify.faults import Fault

MARK = "\ufeff"
"""The byte order mark that some editors put before UTF-8."""
_CONTROL = re.compile(r"[^\t\n\r -~]|\r(?!\n)")
_STRING = re.compile(r'"[^"\n]*"')
_COMMENT = {".src": ";", ".dat": ";", ".sub": ";"}


def decode(data: bytes, file: str = "") -> str:
    """UTF-8 where the bytes are that, a mark at the start kept, else ISO 8859-1, which any bytes are, unless
    the controller that loads the ``file`` reads UTF-8 alone. Raises ``UnicodeDecodeError``."""
    if _utf_8(file):
        return data.decode("utf-8")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def settled(file: str, text: str) -> tuple[str, tuple[Fault, ...]]:
    """A file's text without a byte order mark and with ends of lines that the readers know, and what was
    put right.

    Lone carriage returns end lines only where no line feed does: where both are there, a controller may see
    other lines than the readers, and :func:`strange` refuses the text.
    """
    notes = []
    if text.startswith(MARK) and not _utf_8(file):
        text = text[1:]
        what = "the file begins with a byte order mark, which controllers do not expect; save it without"
        notes.append(Fault(1, 1, "text.encoding", what, file))
    if "\r" in text and "\n" not in text:
        text = text.replace("\r", "\n")
        what = "lines end with a lone carriage return; save the file with CR LF"
        notes.append(Fault(1, 1, "text.encoding", what, file))
    return text, tuple(notes)


def _utf_8(file: str) -> bool:
    """Whether a module is of RobotWare 7, which reads UTF-8 without a mark."""
    return PurePosixPath(file).suffix.lower() in (".modx", ".sysx")


def strange(file: str, text: str) -> list[Fault]:
    """The first character that a controller may take for something else, such as a lone carriage return,
    which would end a comment. Letters of any alphabet may stand in comments, and there alone."""
    mark = _COMMENT.get(PurePosixPath(file).suffix.lower(), "!")
    for found in _CONTROL.finditer(text):
        letter = found.group()
        if not _plain(letter):
            what = f"character {ord(letter)} in the text: it may end or hide a line; take it out"
        elif _commented(text, found.start(), mark):
            continue
        else:
            what = f"character {ord(letter)} stands outside of a comment; write ASCII there"
        return [Fault(text.count("\n", 0, found.start()) + 1, 1, "text.encoding", what, file)]
    return []


def _plain(letter: str) -> bool:
    """Whether a character that is not ASCII takes a place on its line and does nothing else. Those of 0x80 to
    0x9F are letters in files of Windows; NEL (0x85) ends lines."""
    if "\x80" <= letter <= "\x9f":
        return letter != "\x85"
    return letter > "\x7f" and unicodedata.category(letter) not in ("Cf", "Zl", "Zp", "Cs", "Cc", "Cn")


def _commented(text: str, at: int, mark: str) -> bool:
    """Whether a place is behind the mark of a comment on its line; a mark in a string opens none."""
    before = text[text.rfind("\n", 0, at) + 1 : at]
    if mark == ";" and before.lstrip().startswith("&"):
        return True  # a line of KRL's header
    return mark in _STRING.sub("", before).partition('"')[0]
