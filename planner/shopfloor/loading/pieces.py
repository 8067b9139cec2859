"""Programs split into statements that a person may change.

RAPID is split by statements, KRL by lines, each with its place.

Nothing is judged and no text is refused here: whatever was typed at a pendant is split. Whether it is a valid
program is for the proof.
"""

import dataclasses
import re
from pathlib import PurePosixPath
from typing import Final

from planner.languages.krl import LANGUAGE as KRL
from planner.languages.rapid import LANGUAGE as RAPID
from planner.shopfloor.loading.literals import TextShape, text_shape

_RAPID_PART: Final = re.compile(r'"[^"\n]*"|![^\n]*|;|\n|[^"!;\n]+|"')
_RAPID_HEADER: Final = re.compile(r"\s*(?:%%%|VERSION:\s*\d+|LANGUAGE:\s*\w+)\s*", re.IGNORECASE)
"""Lines that controllers add before a module when they save it."""
_RAPID_BLOCK: Final = re.compile(
    r"(?:MODULE|ENDMODULE|(?:LOCAL\s+)?(?:PROC|FUNC|TRAP)|END(?:PROC|FUNC|TRAP|IF|WHILE|FOR|TEST)|ERROR|UNDO"
    r"|BACKWARD|IF\b.*\bTHEN|ELSEIF\b.*\bTHEN|ELSE|WHILE\b.*\bDO|FOR\b.*\bDO|TEST|CASE|DEFAULT)\b[^;]*",
    re.IGNORECASE | re.DOTALL,
)
"""Block keywords that end without a semicolon."""
_OPENS: Final = re.compile(
    r"(?:LOCAL\s+)?(?:PROC|FUNC\s+\w+|TRAP|GLOBAL\s+DEF|DEF|DEFFCT\s+\w+)\s+(\w+)", re.I
)
_CLOSES: Final = re.compile(r"(?:ENDPROC|ENDFUNC|ENDTRAP|END|ENDFCT)\b", re.IGNORECASE)
MOVE: Final = re.compile(
    r"(?:Move\w+|Trigg[LJC]\w*|PTP|LIN|CIRC|SPTP|SLIN|SCIRC|SPL)(?:_REL)?\b(?!\s*=)", re.I
)
"""Start of a statement that moves to a target."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """A statement.

    Attributes:
        line: Its first line, from 1.
        text: Its text in one line.
        shape: Its shape.
        routine: The routine that contains it; "" outside of any.
        target: For a move its number in the routine, from 1.
    """

    line: int
    text: str
    shape: TextShape
    routine: str = ""
    target: int | None = None

    @property
    def location(self) -> str:
        """Place of the statement for users."""
        inside = f"{self.routine}, " if self.routine else ""
        return (
            f"{inside}target {self.target} (line {self.line})" if self.target else f"{inside}line {self.line}"
        )

    @property
    def comment(self) -> bool:
        """Whether it is a comment."""
        return self.text.startswith(("!", ";"))


def kind(name: str) -> str:
    """Return ``rapid`` or ``krl`` by a file's suffix, "" for files that are compared as bytes."""
    ending = PurePosixPath(name).suffix.lower()
    return "rapid" if ending in RAPID.endings else "krl" if ending in KRL.file_endings else ""


def pieces(name: str, text: str) -> list[Piece]:
    """Statements of a program file, in order; any line ends."""
    plain = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    found = _rapid(plain) if kind(name) == "rapid" else _lines(plain)
    out: list[Piece] = []
    routine, count = "", 0
    for line, statement in found:
        one = " ".join(statement.split())
        if opened := _OPENS.match(one):
            routine, count = opened.group(1), 0
        move = MOVE.match(one) is not None
        count += move
        out.append(Piece(line, one, text_shape(one), routine, count if move else None))
        if _CLOSES.match(one):
            routine = ""
    return out


def _lines(text: str) -> list[tuple[int, str]]:
    """KRL lines, without empty ones and the header (&REL, with which the controller counts revisions)."""
    lines = enumerate(text.split("\n"), 1)
    return [(k, line) for k, line in lines if line.strip() and not line.lstrip().startswith("&")]


def _rapid(text: str) -> list[tuple[int, str]]:
    """RAPID statements and comments with their first lines.

    A controller may break and join lines when it saves a module.
    """
    out: list[tuple[int, str]] = []
    line, start, open_text = 1, 1, ""

    def close() -> None:
        nonlocal open_text
        if open_text.strip() and not (not out and _RAPID_HEADER.fullmatch(open_text)):
            out.append((start, open_text))
        open_text = ""

    for part in _RAPID_PART.findall(text):
        if part == "\n":
            ended = _RAPID_BLOCK.fullmatch(open_text.strip()) or _RAPID_HEADER.fullmatch(open_text)
            if ended:
                close()
            elif open_text.strip():
                open_text += " "
            line += 1
        elif part == ";":
            open_text += part
            close()
        elif part.startswith("!"):
            if not open_text.strip():
                open_text = ""
                out.append((line, part))
            elif _RAPID_BLOCK.fullmatch(open_text.strip()):
                close()
                out.append((line, part))
            else:
                out.append((line, part))  # the statement continues
        else:
            if not open_text.strip():
                start = line
            open_text += part
    close()
    return out
