"""Program and controller files as text: characters, line ends, names of segments, and file names by content.

Readers accept only characters that a controller reads in the same way. The names of procedures and the marks
of KRL state the segment that a program runs. The files that a result folder carries are named by the first
digits of the SHA-256 of their content.
"""

import functools
import hashlib
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from planner.claims.segments import Segment
from planner.problem import Controller
from planner.programs.steps import TextFault
from planner.runtime import plugins
from planner.runtime.plugins import Language

BYTE_ORDER_MARK = "\ufeff"
"""Byte order mark that some editors write before UTF-8."""
_CONTROL_CHARACTER = re.compile(r"[^\t\n\r -~]|\r(?!\n)")
"""Characters that no program contains."""
STRING = re.compile(r'"[^"\n]*"')
"""A string in quotes."""


def decode(data: bytes, file: str = "") -> str:
    """Decode a file as UTF-8, keeping a byte order mark, or else as ISO 8859-1, which accepts any bytes.

    Args:
        data: Its bytes.
        file: Its path.

    Raises:
        UnicodeDecodeError: The bytes are no UTF-8, but the controller that loads the file reads only UTF-8.
    """
    if _requires_utf_8(file):
        return data.decode("utf-8")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def normalise_text(file: str, text: str) -> tuple[str, tuple[TextFault, ...]]:
    """Return a file's text without byte order mark and with known line ends, and the corrections.

    Lone carriage returns end lines only if the text has no line feeds. With both, a controller may see other
    lines than the readers, and :func:`unexpected_characters` refuses the text.

    Args:
        file: Its path.
        text: Its text.
    """
    notes = []
    if text.startswith(BYTE_ORDER_MARK) and not _requires_utf_8(file):
        text = text[1:]
        what = "the file starts with a byte order mark, which controllers do not expect; save it without"
        notes.append(TextFault(1, 1, "text.encoding", what, file))
    if "\r" in text and "\n" not in text:
        text = text.replace("\r", "\n")
        what = "lines end with a lone carriage return; save the file with CR LF"
        notes.append(TextFault(1, 1, "text.encoding", what, file))
    return text, tuple(notes)


def _requires_utf_8(file: str) -> bool:
    """Whether the controller that loads a file reads UTF-8 without a mark, as RobotWare 7 does."""
    ending = PurePosixPath(file).suffix.lower()
    return any(ending in language.utf_8 for language in plugins.usable(Language).values())


def _comment_sign(file: str) -> str:
    """Sign that starts a comment in a file. Files of no language are configurations of ABB controllers."""
    ending = PurePosixPath(file).suffix.lower()
    signs = (
        language.comment for language in plugins.usable(Language).values() if ending in language.file_endings
    )
    return next(signs, "!")


def unexpected_characters(file: str, text: str) -> list[TextFault]:
    """Return a fault for the first character that a controller may interpret differently, if there is one.

    An example is a lone carriage return, which would end a comment. Letters of any alphabet are allowed, but
    only in comments.

    Args:
        file: Path of the file.
        text: Its text.
    """
    mark = _comment_sign(file)
    for match in _CONTROL_CHARACTER.finditer(text):
        character = match.group()
        if not _is_harmless(character):
            what = f"character {ord(character)} in the text may end or hide a line; remove it"
        elif _is_in_comment(text, match.start(), mark):
            continue
        else:
            what = f"character {ord(character)} is outside a comment; use ASCII there"
        return [TextFault(text.count("\n", 0, match.start()) + 1, 1, "text.encoding", what, file)]
    return []


def _is_harmless(letter: str) -> bool:
    """Whether a character that is not ASCII occupies a position on its line and has no other effect.

    Those of 0x80 to 0x9F are letters in files of Windows; NEL (0x85) ends lines.
    """
    if "\x80" <= letter <= "\x9f":
        return letter != "\x85"
    return letter > "\x7f" and unicodedata.category(letter) not in ("Cf", "Zl", "Zp", "Cs", "Cc", "Cn")


def _is_in_comment(text: str, offset: int, mark: str) -> bool:
    """Whether an offset is inside a comment on its line; a mark in a string starts none."""
    line_start = text[text.rfind("\n", 0, offset) + 1 : offset]
    if mark == ";" and line_start.lstrip().startswith("&"):
        return True  # a line of KRL's header
    return mark in STRING.sub("", line_start).partition('"')[0]


_VISIT_SUFFIX: Final = re.compile(r"__[0-9]+$")
"""Suffix of the name of a procedure that is not the first one of its segment."""
_LONG_KIND_MARK: Final = "__k"
"""Follows a kind that contains underscores; other kinds end at the first underscore."""


@functools.lru_cache(maxsize=65536)
def segment_of_name(procedure: str) -> Segment:
    """Return the segment of a RAPID procedure, or of the label in a KRL comment, in lower case.

    ``cut_front`` and its second visit ``cut_front__2`` are the cut of ``front``, ``cut_front_in`` is its
    lead-in, and ``cut_way_in_on`` the cut of ``way_in``. Labels have a ``/`` after the kind, or no name.
    """
    name = procedure.strip().lower()
    if "/" in name:
        kind, _, rest = name.partition("/")
        return _segment_of(kind, rest)
    name = _VISIT_SUFFIX.sub("", name)
    kind, long, rest = name.partition(_LONG_KIND_MARK)
    if long and rest[:1] in ("", "_"):
        return _segment_of(kind, rest[1:])
    kind, _, rest = name.partition("_")
    return _segment_of(kind, rest)


def _segment_of(kind: str, rest: str) -> Segment:
    """Segment of a kind and the text after it: a name, and perhaps a word for the phase.

    Each run of characters that are neither letters nor digits counts as one underscore.
    """
    for word in ("in", "out", "on"):
        name = rest.removesuffix(f"_{word}")
        if name and name != rest:
            return Segment(
                _plain_name(kind), _plain_name(name), "in" if word == "in" else "out" if word == "out" else ""
            )
    return Segment(_plain_name(kind), _plain_name(rest))


def _plain_name(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


@dataclass(frozen=True)
class ControllerPartner:
    """Ends of the running wires at the controller of ``arm``, in a cell with another controller."""

    controller: Controller
    arm: str
    seen_flag: str = "TANDEM_SEEN"

    @property
    def running(self) -> str:
        """Output that is 1 while the program of this arm runs."""
        return self.controller.handshake.of(self.arm).running

    @property
    def partner_running(self) -> str:
        """Input that is 1 while the other arm's program runs."""
        return self.controller.handshake.of(self.arm).partner_running

    @property
    def lost(self) -> str:
        """ABB: signal whose rising edge stops this arm."""
        return f"{self.partner_running}_lost"

    @property
    def signals(self) -> list[dict[str, str]]:
        """ABB: rows of the signals, an output that nobody sets by hand and two inputs."""
        rows = [
            {"name": self.running, "signaltype": "DO", "access": "ReadOnly"},
            {"name": self.partner_running, "signaltype": "DI"},
            {"name": self.lost, "signaltype": "DI"},
        ]
        for row in rows[:2]:
            connection = self.controller.interlock.device_bit(self.arm, row["name"])
            if connection is not None:
                row |= {"device": connection.device, "devicemap": str(connection.bit)}
        return rows

    @property
    def input(self) -> str:
        """KUKA: input that is 1 while the other arm's program runs."""
        return f"$IN[{self.controller.signal_number(self.arm, self.partner_running)}]"

    def submit_lines(self, runs: str) -> list[str]:
        """Return the lines of the submit interpreter (KUKA).

        The output states the condition ``runs``. Moves are enabled unless the other program, which was seen
        to run since this program started, no longer runs.
        """
        signals = self.controller.handshake.of(self.arm)
        out, enable = (
            self.controller.signal_number(self.arm, name) for name in (signals.running, signals.move_enable)
        )
        return [
            f"$OUT[{out}]={runs}",
            *("IF NOT $PRO_ACT THEN", f"{self.seen_flag}=FALSE", "ENDIF"),
            *(f"IF $PRO_ACT AND {self.input} THEN", f"{self.seen_flag}=TRUE", "ENDIF"),
            f"$OUT[{enable}]={self.input} OR NOT {self.seen_flag}",
        ]


_DIGEST: Final = re.compile(r"[0-9a-f]{16}")
"""Digest in the name of a carried file."""
_FILE_KEYS: Final = ("file", "urdf")
"""Keys of a problem whose text is the name of a file."""


def changed_files(source: Any) -> tuple[str, ...]:
    """Return the names of a problem's carried files whose content has changed since they were carried."""
    out: list[str] = []
    if isinstance(source, Mapping):
        for key, value in source.items():
            path = Path(value) if key in _FILE_KEYS and isinstance(value, str) else None
            if path is None:
                out += changed_files(value)
            elif (
                path.parent.name == "files"
                and _DIGEST.fullmatch(_digest_in_name(path))
                and _has_changed(path)
            ):
                out.append(f"{path.parent.name}/{path.name}")
    elif isinstance(source, list | tuple):
        for value in source:
            out += changed_files(value)
    return tuple(dict.fromkeys(out))


def _digest_in_name(path: Path) -> str:
    """Digest in the name of a carried file: the whole name, or the part after the user's name."""
    return path.stem.rpartition("-")[2]


def _has_changed(path: Path) -> bool:
    """Whether the content of a file does not match the digest in its name."""
    return path.is_file() and not hashlib.sha256(path.read_bytes()).hexdigest().startswith(
        _digest_in_name(path)
    )
