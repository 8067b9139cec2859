"""Numbers, texts and names as RAPID writes them."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.dialogue import HEADER
from planner.geometry.rigid import to_quaternion
from planner.issues import Issue, TandemError
from planner.post.text import number, plain, short
from planner.targets import Action

FloatArray = NDArray[np.float64]

NAME_LENGTH: Final = 32
LINE_LENGTH: Final = 200
STRING_LENGTH: Final = 80
BOX_LINE: Final = 55
"""Characters of one line of a message box, which has five."""
BOX_LINES: Final = 5
UNUSED_AXES: Final = "[9E9,9E9,9E9,9E9,9E9,9E9]"

_WORDS: Final = """
alias and backward case connect const default div do else elseif endfor endfunc endif endmodule endproc
endrecord endtest endtrap endwhile error exit false for from func goto if inout local mod module
nostepin not noview or pers proc raise readonly record retry return step sysmodule task test then to
trap true trynext undo var viewonly while with xor load stop set reset main tool0 wobj0 fine load0 errno
high low edge pi intno
"""
RESERVED: Final = frozenset(_WORDS.split())
"""Reserved words of the language and built-in names that a label could be taken for."""


def vector(values: Iterable[float], decimals: int) -> str:
    """``[a,b,...]``"""
    return "[" + ",".join(number(float(value), decimals) for value in values) + "]"


def pose(matrix: FloatArray) -> str:
    """RAPID's pose of (4, 4) [m]: position in mm with 4 decimals, unit quaternion with 8."""
    return f"[{vector(matrix[:3, 3] * 1e3, 4)},{vector(to_quaternion(matrix[:3, :3]), 8)}]"


def jointtarget(degrees: FloatArray) -> str:
    """RAPID's jointtarget of the controller's joint values (6,) [deg]."""
    return f"[{vector(degrees, 6)},{UNUSED_AXES}]"


def quoted(text: str) -> str:
    """A string literal of plain text of at most 80 characters; quotes and backslashes are doubled."""
    return '"' + text.replace("\\", "\\\\").replace('"', '""') + '"'


def comment(text: str, indent: str = "") -> list[str]:
    """Comment lines of plain text, wrapped."""
    return [f"{indent}! {line}" for line in textwrap.wrap(plain(text), 100)]


def identifier(text: str) -> str:
    """A name from text: letters, digits and single underscores, a letter first.

    Raises :class:`TandemError` (``post.name``) when that gives no name that RAPID takes.
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain(text)).strip("_")
    if not re.match(r"[A-Za-z]", name) or len(name) > NAME_LENGTH - 4 or name.lower() in RESERVED:
        message = f"{text!r} cannot name anything in RAPID (it gives {name!r})"
        hint = f"a letter first, at most {NAME_LENGTH - 4} characters, no reserved word"
        raise TandemError(Issue("post.name", message, hint=hint))
    return name


def write_lines(text: str) -> list[str]:
    """Instructions that show text on the operator's panel."""
    return [f"TPWrite {quoted(line)};" for line in textwrap.wrap(plain(text), STRING_LENGTH // 2)]


def box(header: str, text: str) -> list[str]:
    """Instructions that show text and wait until the operator presses OK; long text takes several boxes."""
    lines = textwrap.wrap(plain(text), BOX_LINE) or [""]
    out = []
    for first in range(0, len(lines), BOX_LINES):
        shown = [quoted(line) for line in lines[first : first + BOX_LINES]]
        out += [f"UIMsgBox\\Header:={quoted(header)},{shown[0]}"]
        out += [f"    \\MsgLine{i}:={line}" for i, line in enumerate(shown[1:], 2)]
        out += ["    \\Buttons:=btnOK\\Icon:=iconInfo;"]
    return out


def action_lines(action: Action) -> list[str]:
    """The instructions of an action of the process."""
    match action.kind:
        case "message":
            return write_lines(action.text)
        case "confirm":
            return box(HEADER, action.text)
        case "on":
            return [f"SetDO {identifier(action.signal)},1;"]
        case "off":
            return [f"SetDO {identifier(action.signal)},0;"]
        case "wait":
            return [f"WaitTime {short(action.seconds, 3)};"]
