"""Programs split into pieces that a person may change: RAPID into statements, KRL into lines.

Any text is accepted, whatever was typed at a pendant. Whether it is a valid program is decided by the proof.
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
"""Block keywords, which have no semicolon at their end."""
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
    """A statement or a comment.

    Attributes:
        line: Number of its first line, from 1.
        text: Its text in one line.
        shape: Shape of its text.
        routine: Name of the routine that contains it; "" outside of any.
        target: For a move, its number among the moves of the routine, from 1; else None.
    """

    line: int
    text: str
    shape: TextShape
    routine: str = ""
    target: int | None = None

    @property
    def location(self) -> str:
        """Location of the statement, for users."""
        prefix = f"{self.routine}, " if self.routine else ""
        return (
            f"{prefix}target {self.target} (line {self.line})" if self.target else f"{prefix}line {self.line}"
        )

    @property
    def comment(self) -> bool:
        """Whether it is a comment."""
        return self.text.startswith(("!", ";"))


def kind(name: str) -> str:
    """Return the language of a file, ``rapid`` or ``krl``, by its suffix; "" if it is not a program."""
    ending = PurePosixPath(name).suffix.lower()
    return "rapid" if ending in RAPID.endings else "krl" if ending in KRL.file_endings else ""


def pieces(name: str, text: str) -> list[Piece]:
    """Split the text of a program file ``name``, with any line ends, into its statements in order."""
    normalised = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    statements = _rapid(normalised) if kind(name) == "rapid" else _lines(normalised)
    out: list[Piece] = []
    routine, count = "", 0
    for line, raw in statements:
        statement = " ".join(raw.split())
        if opened := _OPENS.match(statement):
            routine, count = opened.group(1), 0
        is_move = MOVE.match(statement) is not None
        count += is_move
        out.append(Piece(line, statement, text_shape(statement), routine, count if is_move else None))
        if _CLOSES.match(statement):
            routine = ""
    return out


def _lines(text: str) -> list[tuple[int, str]]:
    """Return the numbered lines of KRL text without empty ones and the header, whose lines start with &."""
    lines = enumerate(text.split("\n"), 1)
    return [(k, line) for k, line in lines if line.strip() and not line.lstrip().startswith("&")]


def _rapid(text: str) -> list[tuple[int, str]]:
    """Return the statements and comments of RAPID text with the numbers of their first lines.

    They do not depend on line breaks, because a controller may break and join lines when it saves a module.
    """
    out: list[tuple[int, str]] = []
    line, start, open_text = 1, 1, ""

    def close() -> None:
        """End the statement ``open_text``, unless it is empty or a header."""
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
