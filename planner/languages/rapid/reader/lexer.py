"""Words of a RAPID text, read one at a time with their places, and the words that a program may use.

The cursor is lazy: it looks one token ahead and leaves the text as it is, so that the parser can
take whole move instructions and whole number lists in one step where they have their usual form.

Forms of instructions, with what arguments they take: ABB, Technical reference manual RAPID
Instructions, Functions and Data types, 3HAC16581-1.
"""

import re
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import NamedTuple

_SKIP = re.compile(r"(?:[ \t\r\n]+|![^\n]*)*")
"""Blanks, line ends and comments."""
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


# every reserved word of the language, also those that are not in the subset: none may name anything
_RESERVED = (
    "alias and backward case connect const default div do else elseif endfor endfunc endif endmodule "
    "endproc endrecord endtest endtrap endwhile error exit false for from func goto if inout local mod "
    "module nostepin not noview or pers proc raise readonly record retry return step sysmodule task test "
    "then to trap true trynext undo var viewonly while with xor "
)
RESERVED = frozenset(_RESERVED.split())
"""Words of the language."""
MODULE_ATTRIBUTES = frozenset({"sysmodule", "noview", "nostepin", "viewonly", "readonly"})
"""Attributes that a module may have."""


@dataclass(frozen=True)
class Form:
    """An instruction: official `name`, types of the required arguments, options as name -> (slot, type).

    Slot n means: behind the n-th required argument. Type "switch" takes no value. "signal..." types are
    names that the controller's configuration declares. "variable <type>" must be a VAR or PERS.
    """

    name: str
    required: tuple[str, ...] = ()
    options: dict[str, tuple[int, str]] = field(default_factory=dict)


def _move(name: str, target: str, extra: dict[str, tuple[int, str]]) -> Form:
    options: dict[str, tuple[int, str]] = {
        "conc": (0, "switch"),
        "id": (1, "num"),
        "v": (2, "num"),
        "t": (2, "num"),
        "z": (3, "num"),
        "wobj": (4, "wobjdata"),
        "tload": (4, "loaddata"),
    }
    return Form(name, (target, "speeddata", "zonedata", "tooldata"), options | extra)


_BOX_LINES: dict[str, tuple[int, str]] = {f"msgline{n}": (1, "string") for n in range(2, 6)}
"""Options of a message box: its lines but for the first,"""
_BOX_OPTIONS = {
    "header": (0, "string"),
    **_BOX_LINES,
    "wrap": (1, "switch"),
    "buttons": (1, "num"),
    "icon": (1, "num"),
}
"""and all others."""
_BOX_OPTIONS |= {"result": (1, "variable num"), "maxtime": (1, "num")}

_FORMS = (
    _move("MoveAbsJ", "jointtarget", {"noeoffs": (1, "switch")}),
    _move("MoveJ", "robtarget", {}),
    _move("MoveL", "robtarget", {"corr": (4, "switch")}),
    Form("SetDO", ("signaldo", "num"), {"sdelay": (0, "num"), "sync": (0, "switch")}),
    Form("Set", ("signaldo",)),
    Form("Reset", ("signaldo",)),
    Form("WaitTime", ("num",), {"inpos": (0, "switch")}),
    Form("WaitRob", (), {"inpos": (0, "switch"), "zerospeed": (0, "switch")}),
    Form("WaitDI", ("signaldi", "num"), {"maxtime": (2, "num"), "timeflag": (2, "variable bool")}),
    Form("TPErase"),
    Form(
        "TPWrite",
        ("string",),
        {"num": (1, "num"), "bool": (1, "bool"), "pos": (1, "pos"), "orient": (1, "orient")},
    ),
    Form("UIMsgBox", ("string",), _BOX_OPTIONS),
    Form("TPReadFK", ("variable num", *("string",) * 6), {"maxtime": (7, "num")}),
    Form("WaitSyncTask", ("syncident", "tasks"), {"inpos": (0, "switch"), "timeout": (2, "num")}),
    Form("SyncMoveOn", ("syncident", "tasks"), {"timeout": (2, "num")}),
    Form("SyncMoveOff", ("syncident",), {"timeout": (1, "num")}),
    Form("SyncMoveUndo"),
    Form("StopMove", (), {"quick": (0, "switch"), "allmotiontasks": (0, "switch")}),
    Form("StartMove", (), {"allmotiontasks": (0, "switch")}),
    Form("ClearPath"),
    Form("StorePath", (), {"keepsync": (0, "switch")}),
    Form("RestoPath"),
    Form("ConfL", (), {"on": (0, "switch"), "off": (0, "switch")}),
    Form("ConfJ", (), {"on": (0, "switch"), "off": (0, "switch")}),
    Form("SingArea", (), {"off": (0, "switch"), "wrist": (0, "switch")}),
    Form("AccSet", ("num", "num")),
    Form("VelSet", ("num", "num")),
    Form("ActUnit", ("mecunit",)),
    Form("DeactUnit", ("mecunit",)),
    Form("EOffsOff"),
    Form("GripLoad", ("loaddata",)),
    Form("ClkReset", ("clock",)),
    Form("ClkStart", ("clock",)),
    Form("ClkStop", ("clock",)),
    Form("Load", ("string",), {"dynamic": (0, "switch"), "file": (1, "string"), "checkref": (1, "switch")}),
    Form(
        "UnLoad", ("string",), {"errifchanged": (0, "switch"), "save": (0, "switch"), "file": (1, "string")}
    ),
    Form("Stop", (), {"noregain": (0, "switch"), "allmovetasks": (0, "switch")}),
    Form(
        "ErrWrite",
        ("string", "string"),
        {f"rl{n}": (2, "string") for n in range(2, 5)} | {"w": (0, "switch")},
    ),
    # statements of one word; the parser reads them the same way
    Form("EXIT"),
    Form("RETURN"),
    Form("RAISE"),
    Form("RETRY"),
    Form("TRYNEXT"),
)
INSTRUCTIONS: dict[str, Form] = {form.name.lower(): form for form in _FORMS}
"""Instructions by name, in small letters."""
MOVE_INSTRUCTIONS = frozenset({"moveabsj", "movej", "movel"})
"""Instructions that move an arm."""
IN_HANDLER_ONLY = frozenset({"retry", "trynext"})
"""Instructions of error handlers alone."""
EXCLUSIVE_OPTIONS = (
    ("v", "t"),
    ("on", "off"),
    ("off", "wrist"),
    ("sdelay", "sync"),
    ("conc", "id"),
    ("errifchanged", "save"),
)
"""Options that exclude each other."""

# functions: types of the arguments and of the result
FUNCTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "issyncmoveon": ((), "bool"),
    "clkread": (("clock",), "num"),
    "numtostr": (("num", "num"), "string"),
    "doutput": (("signaldo",), "num"),
    "dinput": (("signaldi",), "num"),
    "testdi": (("signaldi",), "bool"),
    "gettaskname": ((), "string"),
    "ctime": ((), "string"),
    "cdate": ((), "string"),
    "abs": (("num",), "num"),
}
