"""Texts of program and controller files: encoding, line ends, segment names, and files named by content.

Readers accept only characters that a controller reads in the same way. Names of procedures and marked
comments of KRL state the segment that a program runs. Files that a result folder carries are named by the
first digits of the SHA-256 of their content.
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
"""Characters that no program may contain, unless they are harmless in a comment."""
STRING = re.compile(r'"[^"\n]*"')
"""A string in quotes."""


def decode(data: bytes, file: str = "") -> str:
    """Decode a file as UTF-8, keeping a byte order mark, or else as ISO 8859-1, which accepts any bytes.

    Args:
        data: Content of the file.
        file: Path of the file, whose suffix decides whether only UTF-8 is allowed.

    Raises:
        UnicodeDecodeError: The bytes are not UTF-8, but the controller that loads the file reads only UTF-8.
    """
    if _requires_utf_8(file):
        return data.decode("utf-8")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def normalise_text(file: str, text: str) -> tuple[str, tuple[TextFault, ...]]:
    """Return a file's text without byte order mark and with line feeds, and a note for each correction.

    Lone carriage returns become line feeds only if the text has no line feeds. If a text has both, a
    controller may see other lines than the readers, and :func:`unexpected_characters` refuses it.

    Args:
        file: Path of the file.
        text: Text of the file.
    """
    notes = []
    if text.startswith(BYTE_ORDER_MARK) and not _requires_utf_8(file):
        text = text[1:]
        message = "the file starts with a byte order mark, which controllers do not expect; save it without"
        notes.append(TextFault(1, 1, "text.encoding", message, file))
    if "\r" in text and "\n" not in text:
        text = text.replace("\r", "\n")
        message = "lines end with a lone carriage return; save the file with CR LF"
        notes.append(TextFault(1, 1, "text.encoding", message, file))
    return text, tuple(notes)


def _requires_utf_8(file: str) -> bool:
    """Return whether the controller that loads a file reads only UTF-8, as RobotWare 7 does."""
    suffix = PurePosixPath(file).suffix.lower()
    return any(suffix in language.utf_8 for language in plugins.usable(Language).values())


def _comment_sign(file: str) -> str:
    """Return the mark that starts a comment in a file; files of no language are configurations (ABB)."""
    suffix = PurePosixPath(file).suffix.lower()
    marks = (
        language.comment for language in plugins.usable(Language).values() if suffix in language.file_endings
    )
    return next(marks, "!")


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
            message = f"character {ord(character)} in the text may end or hide a line; remove it"
        elif _is_in_comment(text, match.start(), mark):
            continue
        else:
            message = f"character {ord(character)} is outside a comment; use ASCII there"
        return [TextFault(text.count("\n", 0, match.start()) + 1, 1, "text.encoding", message, file)]
    return []


def _is_harmless(character: str) -> bool:
    """Return whether a character is not ASCII, occupies a position on its line, and has no other effect.

    Characters from 0x80 to 0x9F are letters in files of Windows, except NEL (0x85), which ends lines.
    """
    if "\x80" <= character <= "\x9f":
        return character != "\x85"
    return character > "\x7f" and unicodedata.category(character) not in ("Cf", "Zl", "Zp", "Cs", "Cc", "Cn")


def _is_in_comment(text: str, offset: int, mark: str) -> bool:
    """Return whether an offset is in a comment on its line. A mark in a string does not start a comment."""
    line_start = text[text.rfind("\n", 0, offset) + 1 : offset]
    if mark == ";" and line_start.lstrip().startswith("&"):
        return True  # a line of KRL's header
    return mark in STRING.sub("", line_start).partition('"')[0]


_VISIT_SUFFIX: Final = re.compile(r"__[0-9]+$")
"""Suffix of the name of a procedure for a later visit of its segment."""
_LONG_KIND_MARK: Final = "__k"
"""Mark after a kind that contains underscores; any other kind ends at the first underscore."""


@functools.lru_cache(maxsize=65536)
def segment_of_name(procedure: str) -> Segment:
    """Return the segment of a RAPID procedure, or of the label in a KRL comment, in lower case.

    ``cut_front`` and its second visit ``cut_front__2`` are the cut of ``front``, ``cut_front_in`` is its
    lead-in, and ``cut_way_in_on`` the cut of ``way_in``. Labels have a ``/`` after the kind, or no name.
    """
    name = procedure.strip().lower()
    if "/" in name:
        kind, _, name_and_phase = name.partition("/")
        return _segment_of(kind, name_and_phase)
    name = _VISIT_SUFFIX.sub("", name)
    kind, mark, name_and_phase = name.partition(_LONG_KIND_MARK)
    if mark and name_and_phase[:1] in ("", "_"):
        return _segment_of(kind, name_and_phase[1:])
    kind, _, name_and_phase = name.partition("_")
    return _segment_of(kind, name_and_phase)


def _segment_of(kind: str, name_and_phase: str) -> Segment:
    """Return the segment of a kind and the text after it: a name, and perhaps a word for the phase.

    The words are "in", "out", and "on" for a segment without phase whose name ends like a phase. Each run of
    characters that are neither letters nor digits counts as one underscore.
    """
    for word in ("in", "out", "on"):
        name = name_and_phase.removesuffix(f"_{word}")
        if name and name != name_and_phase:
            return Segment(
                _plain_name(kind), _plain_name(name), "in" if word == "in" else "out" if word == "out" else ""
            )
    return Segment(_plain_name(kind), _plain_name(name_and_phase))


def _plain_name(text: str) -> str:
    """Return a text with each run of other characters than letters and digits as one underscore."""
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


@dataclass(frozen=True)
class ControllerPartner:
    """Names, at the controller of ``arm``, for the running wires between it and another controller.

    KUKA: the variable ``seen_flag`` is TRUE after both programs have run since the last start.
    """

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
        """ABB: keys and values of the signals in EIO.cfg: an output that nobody sets by hand, two inputs."""
        entries = [
            {"name": self.running, "signaltype": "DO", "access": "ReadOnly"},
            {"name": self.partner_running, "signaltype": "DI"},
            {"name": self.lost, "signaltype": "DI"},
        ]
        for entry in entries[:2]:
            connection = self.controller.interlock.device_bit(self.arm, entry["name"])
            if connection is not None:
                entry |= {"device": connection.device, "devicemap": str(connection.bit)}
        return entries

    @property
    def input(self) -> str:
        """KUKA: input that is 1 while the other arm's program runs."""
        return f"$IN[{self.controller.signal_number(self.arm, self.partner_running)}]"

    def submit_lines(self, runs: str) -> list[str]:
        """KUKA: return the expected lines of the submit interpreter.

        The output states the condition ``runs``. Motion is disabled if the other program, which has run since
        this program started, no longer runs.
        """
        signals = self.controller.handshake.of(self.arm)
        running, enable = (
            self.controller.signal_number(self.arm, name) for name in (signals.running, signals.move_enable)
        )
        return [
            f"$OUT[{running}]={runs}",
            *("IF NOT $PRO_ACT THEN", f"{self.seen_flag}=FALSE", "ENDIF"),
            *(f"IF $PRO_ACT AND {self.input} THEN", f"{self.seen_flag}=TRUE", "ENDIF"),
            f"$OUT[{enable}]={self.input} OR NOT {self.seen_flag}",
        ]


_DIGEST: Final = re.compile(r"[0-9a-f]{16}")
"""Digest in the name of a file that a result folder carries: the first digits of SHA-256."""
_FILE_KEYS: Final = ("file", "urdf")
"""Keys of a problem file whose values are names of files."""


def changed_files(source: Any) -> tuple[str, ...]:
    """Return the names of the files of a result folder that were changed after the result was written.

    The folder carries the files that the problem refers to. The name of such a file contains a digest of its
    content, which no longer matches. Files that do not exist are left out.

    Args:
        source: The problem as data, or any part of it.
    """
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
    """Return the digest in the name of a carried file: all of the name, or the part after the user's name."""
    return path.stem.rpartition("-")[2]


def _has_changed(path: Path) -> bool:
    """Return whether a file exists and its content does not match the digest in its name."""
    return path.is_file() and not hashlib.sha256(path.read_bytes()).hexdigest().startswith(
        _digest_in_name(path)
    )
