"""Program and controller files as text: characters, line ends, names of segments, and file names by
content.

Readers accept only characters that a controller reads in the same way. The names of procedures and the
marks of KRL state the segment that a program runs. The files that a result folder carries are named by
the first digits of the SHA-256 of their content.
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
from planner.programs.steps import Fault
from planner.runtime import plugins
from planner.runtime.plugins import Language

BYTE_ORDER_MARK = "\ufeff"
"""The byte order mark that some editors put before UTF-8."""
_CONTROL_CHARACTER = re.compile(r"[^\t\n\r -~]|\r(?!\n)")
"""Characters that no program has."""
STRING = re.compile(r'"[^"\n]*"')
"""A string in quotes."""


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
    if text.startswith(BYTE_ORDER_MARK) and not _utf_8(file):
        text = text[1:]
        what = "the file begins with a byte order mark, which controllers do not expect; save it without"
        notes.append(Fault(1, 1, "text.encoding", what, file))
    if "\r" in text and "\n" not in text:
        text = text.replace("\r", "\n")
        what = "lines end with a lone carriage return; save the file with CR LF"
        notes.append(Fault(1, 1, "text.encoding", what, file))
    return text, tuple(notes)


def _utf_8(file: str) -> bool:
    """Whether the controller that loads a file reads UTF-8 without a mark, as RobotWare 7 does."""
    ending = PurePosixPath(file).suffix.lower()
    return any(ending in one.utf_8 for one in plugins.usable(Language).values())


def _comment_sign(file: str) -> str:
    """The sign that begins a comment in a file. Other files are configurations of ABB controllers."""
    ending = PurePosixPath(file).suffix.lower()
    signs = (one.comment for one in plugins.usable(Language).values() if ending in one.file_endings)
    return next(signs, "!")


def strange(file: str, text: str) -> list[Fault]:
    """The first character that a controller may take for something else, such as a lone carriage return,
    which would end a comment. Letters of any alphabet may stand in comments, and there alone."""
    mark = _comment_sign(file)
    for found in _CONTROL_CHARACTER.finditer(text):
        letter = found.group()
        if not _takes_only_place(letter):
            what = f"character {ord(letter)} in the text: it may end or hide a line; take it out"
        elif _commented(text, found.start(), mark):
            continue
        else:
            what = f"character {ord(letter)} stands outside of a comment; write ASCII there"
        return [Fault(text.count("\n", 0, found.start()) + 1, 1, "text.encoding", what, file)]
    return []


def _takes_only_place(letter: str) -> bool:
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
    return mark in STRING.sub("", before).partition('"')[0]


_REPEATED_NAME: Final = re.compile(r"__[0-9]+$")
"""Ends the name of a procedure that is not the first one of its segment."""
_LONG_KIND: Final = "__k"
"""Stands behind a kind that has underscores of its own, which else ends at the first one."""


@functools.lru_cache(maxsize=65536)
def segment_of_name(procedure: str) -> Segment:
    """The segment of a RAPID procedure, or of the label that stands in a KRL comment; in lower case.

    ``cut_front`` and ``cut_front__2``, its second visit, are the cut of ``front``, ``cut_front_in`` the way
    in to it, and ``cut_way_in_on`` the cut of ``way_in``. Labels have a ``/`` behind the kind, or no name.
    """
    name = procedure.strip().lower()
    if "/" in name:
        kind, _, rest = name.partition("/")
        return _phased(kind, rest)
    name = _REPEATED_NAME.sub("", name)
    kind, long, rest = name.partition(_LONG_KIND)
    if long and rest[:1] in ("", "_"):
        return _phased(kind, rest[1:])
    kind, _, rest = name.partition("_")
    return _phased(kind, rest)


def _phased(kind: str, rest: str) -> Segment:
    """A kind and what stands behind it: a name, and perhaps a word for the phase; each run of signs that are
    neither letters nor digits counts as one underscore."""
    for word in ("in", "out", "on"):
        before = rest.removesuffix(f"_{word}")
        if before and before != rest:
            return Segment(
                _plain_name(kind),
                _plain_name(before),
                "in" if word == "in" else "out" if word == "out" else "",
            )
    return Segment(_plain_name(kind), _plain_name(rest))


def _plain_name(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


@dataclass(frozen=True)
class Partner:
    """The ends of the running wires at the controller of ``arm``, which another one stands beside."""

    controller: Controller
    arm: str
    seen: str = "TANDEM_SEEN"

    @property
    def running(self) -> str:
        """The output that is 1 while the program of this arm runs."""
        return self.controller.handshake.of(self.arm).running

    @property
    def given(self) -> str:
        """The input that is 1 while the other arm's program runs."""
        return self.controller.handshake.of(self.arm).partner_running

    @property
    def lost(self) -> str:
        """Of ABB, the signal whose rise stops this arm."""
        return f"{self.given}_lost"

    @property
    def signals(self) -> list[dict[str, str]]:
        """Of ABB, the signals by attribute: an output that nobody sets by hand, two inputs."""
        rows = [
            {"name": self.running, "signaltype": "DO", "access": "ReadOnly"},
            {"name": self.given, "signaltype": "DI"},
            {"name": self.lost, "signaltype": "DI"},
        ]
        for row in rows[:2]:
            place = self.controller.interlock.place(self.arm, row["name"])
            if place is not None:
                row |= {"device": place.device, "devicemap": str(place.bit)}
        return rows

    @property
    def input(self) -> str:
        """Of KUKA, the input that is 1 while the other arm's program runs."""
        return f"$IN[{self.controller.number(self.arm, self.given)}]"

    def watched(self, runs: str) -> list[str]:
        """Of KUKA, the lines of the submit interpreter: the output says what ``runs``; moves are free unless
        the other one, which was seen to run since this program started, does not run any more."""
        own = self.controller.handshake.of(self.arm)
        out, free = (self.controller.number(self.arm, name) for name in (own.running, own.move_enable))
        return [
            f"$OUT[{out}]={runs}",
            *("IF NOT $PRO_ACT THEN", f"{self.seen}=FALSE", "ENDIF"),
            *(f"IF $PRO_ACT AND {self.input} THEN", f"{self.seen}=TRUE", "ENDIF"),
            f"$OUT[{free}]={self.input} OR NOT {self.seen}",
        ]


_DIGEST: Final = re.compile(r"[0-9a-f]{16}")
"""The digest that a program carries."""
_FILE_KEYS: Final = ("file", "urdf")
"""Keys of a problem whose text is the name of a file."""


def changed(source: Any) -> tuple[str, ...]:
    """Names of carried files of a problem's source that are not what they were when they were carried."""
    out: list[str] = []
    if isinstance(source, Mapping):
        for key, value in source.items():
            path = Path(value) if key in _FILE_KEYS and isinstance(value, str) else None
            if path is None:
                out += changed(value)
            elif path.parent.name == "files" and _DIGEST.fullmatch(_stated(path)) and _other(path):
                out.append(f"{path.parent.name}/{path.name}")
    elif isinstance(source, list | tuple):
        for value in source:
            out += changed(value)
    return tuple(dict.fromkeys(out))


def _stated(path: Path) -> str:
    """The digest in the name of a carried file: all of it, or what follows the user's name."""
    return path.stem.rpartition("-")[2]


def _other(path: Path) -> bool:
    """Whether a file has other contents than its name says."""
    return path.is_file() and not hashlib.sha256(path.read_bytes()).hexdigest().startswith(_stated(path))
