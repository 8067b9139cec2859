"""Lexer of RAPID text, and the table of words and instructions that a program may use.

The cursor is lazy: it looks one token ahead and leaves the text unchanged, so that the parser can take whole
move instructions and number lists in one step if they have their usual form.

Forms of instructions with their arguments: ABB, Technical reference manual RAPID Instructions, Functions and
Data types, 3HAC16581-1.
"""

import re
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import NamedTuple

_SKIP = re.compile(r"(?:[ \t\r\n]+|![^\n]*)*")
"""Blanks, line ends and comments, which are skipped before a token."""
_TOKEN = re.compile(
    r"""(?P<name>[A-Za-z][A-Za-z0-9_]*)
    |(?P<number>(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.\#]))
    |(?P<string>"(?:[^"\n]|"")*")
    |(?P<symbol>:=|<>|<=|>=|[\\\[\]{}(),;:=<>+\-*/%])
    |(?P<bad>[\d_][\w.\#]*|"[^\n]*|[^\W\d]\w*|.)""",
    re.VERBOSE,
)


class RapidToken(NamedTuple):
    """One token.

    Attributes:
        kind: name, number, string, symbol, bad or end.
        text: As written.
        word: ``text`` in lower case.
        start: Offset in the text.
    """

    kind: str
    text: str
    word: str
    start: int


class RapidSyntaxError(Exception):
    """Parsing of one statement failed. The parser turns it into a `Fault` and resumes after the statement.

    Attributes:
        start: Offset of the fault.
        code: Issue code.
        message: What is wrong.
    """

    def __init__(self, start: int, code: str, message: str) -> None:
        super().__init__(message)
        self.start = start
        self.code = code
        self.message = message


class RapidCursor:
    """Position in a RAPID text with one token of look-ahead.

    Attributes:
        text: The text.
        end: Offset after the last token taken.
        operators: Number of operators so far in the current expression.
        token: The next token.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]
        self.end = 0
        self.operators = 0
        self.token = RapidToken("end", "", "", 0)
        self.jump(0)

    def jump(self, offset: int) -> None:
        """Continue parsing at ``offset``, which must not be inside a string or a comment."""
        self.end = offset
        self.token = self._scan(offset)

    def _scan(self, offset: int) -> RapidToken:
        """Return the first token at or after ``offset``, without moving the cursor."""
        skipped = _SKIP.match(self.text, offset)
        start = skipped.end() if skipped else offset
        match = _TOKEN.match(self.text, start)
        if match is None:
            return RapidToken("end", "", "", len(self.text))
        text = match.group()
        return RapidToken(match.lastgroup or "bad", text, text.lower(), start)

    def take(self) -> RapidToken:
        """Return the current token and move to the next one."""
        token = self.token
        self.end = token.start + len(token.text)
        self.token = self._scan(self.end)
        return token

    def take_symbol(self, symbol: str) -> bool:
        """Take the token if it is this symbol, and return whether it was."""
        if self.token.kind == "symbol" and self.token.text == symbol:
            self.take()
            return True
        return False

    def take_word(self, *words: str) -> str | None:
        """Take the token if it is one of these lower-case words, and return the word or None."""
        if self.token.kind == "name" and self.token.word in words:
            return self.take().word
        return None

    def expect_symbol(self, symbol: str, where: str) -> None:
        """Take a symbol.

        Args:
            symbol: The symbol.
            where: Its place in the statement, for the message, such as "after the declaration".

        Raises:
            RapidSyntaxError: The current token is another one.
        """
        if not self.take_symbol(symbol):
            raise self.fault(f'"{symbol}" {where}')

    def expect_word(self, word: str, where: str) -> None:
        """Take a word.

        Args:
            word: The word in lower case.
            where: Its place in the statement, for the message, such as "after TASK".

        Raises:
            RapidSyntaxError: The current token is another one.
        """
        if self.take_word(word) is None:
            raise self.fault(f"{word.upper()} {where}")

    def fault(self, allowed: str) -> RapidSyntaxError:
        """Return the exception for a current token that is not what is ``allowed`` here."""
        token = self.token
        if token.kind == "end":
            return RapidSyntaxError(token.start, "rapid.syntax", f"the text ends here; expected {allowed}")
        if token.kind == "bad":
            return bad_token_error(token)
        return RapidSyntaxError(token.start, "rapid.syntax", f"got {shorten(token.text)}; expected {allowed}")

    def line_and_column(self, offset: int) -> tuple[int, int]:
        """Return line and column of an offset, both from 1."""
        line = bisect_right(self._starts, offset)
        return line, offset - self._starts[line - 1] + 1

    @property
    def starts(self) -> tuple[int, ...]:
        """Offset of the start of each line."""
        return tuple(self._starts)

    def line(self, offset: int) -> int:
        """Return the line of an offset, from 1."""
        return bisect_right(self._starts, offset)


def shorten(text: str) -> str:
    """Return text in quotes for a message, cut to 40 characters."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def bad_token_error(token: RapidToken) -> RapidSyntaxError:
    """Return the exception for a token of kind "bad", with a message for the probable mistake."""
    text, first = token.text, token.text[0]
    if first == '"':
        return RapidSyntaxError(
            token.start, "rapid.syntax", f"the string {shorten(text)} is not closed on its line"
        )
    if first.isdigit() and re.fullmatch(r"[\d.]+(?:[eE][\w.#]*)?|\d[\d.]*#\w*", text):
        return RapidSyntaxError(
            token.start, "rapid.number", f"{shorten(text)} is not a number; allowed: 12, 12.5, 1.2E3"
        )
    if first.isdigit():
        return RapidSyntaxError(
            token.start, "rapid.name_form", f"{shorten(text)}: a name must not start with a digit"
        )
    return RapidSyntaxError(
        token.start, "rapid.syntax", f"{shorten(text)} is not part of RAPID; names use A-Z, 0-9 and _"
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
class InstructionForm:
    """Form of an instruction.

    Attributes:
        name: Official spelling.
        required: Types of the required arguments. Arguments of "signal..." types are names that the
            controller's configuration declares. "variable <type>" stands for a VAR or PERS of that type.
        options: Options by name, as (slot, type). Slot n means after the n-th required argument. Type
            "switch" takes no value.
    """

    name: str
    required: tuple[str, ...] = ()
    options: dict[str, tuple[int, str]] = field(default_factory=dict)


def _move(name: str, target: str, extra: dict[str, tuple[int, str]]) -> InstructionForm:
    """Return the form of a move with a target of type ``target``.

    ``extra`` are the options that other moves lack.
    """
    options: dict[str, tuple[int, str]] = {
        "conc": (0, "switch"),
        "id": (1, "num"),
        "v": (2, "num"),
        "t": (2, "num"),
        "z": (3, "num"),
        "wobj": (4, "wobjdata"),
        "tload": (4, "loaddata"),
    }
    return InstructionForm(name, (target, "speeddata", "zonedata", "tooldata"), options | extra)


_BOX_LINES: dict[str, tuple[int, str]] = {f"msgline{n}": (1, "string") for n in range(2, 6)}
"""Options of a message box for its lines after the first."""
_BOX_OPTIONS = {
    "header": (0, "string"),
    **_BOX_LINES,
    "wrap": (1, "switch"),
    "buttons": (1, "num"),
    "icon": (1, "num"),
}
"""All options of a message box."""
_BOX_OPTIONS |= {"result": (1, "variable num"), "maxtime": (1, "num")}

_FORMS = (
    _move("MoveAbsJ", "jointtarget", {"noeoffs": (1, "switch")}),
    _move("MoveJ", "robtarget", {}),
    _move("MoveL", "robtarget", {"corr": (4, "switch")}),
    InstructionForm("SetDO", ("signaldo", "num"), {"sdelay": (0, "num"), "sync": (0, "switch")}),
    InstructionForm("Set", ("signaldo",)),
    InstructionForm("Reset", ("signaldo",)),
    InstructionForm("WaitTime", ("num",), {"inpos": (0, "switch")}),
    InstructionForm("WaitRob", (), {"inpos": (0, "switch"), "zerospeed": (0, "switch")}),
    InstructionForm("WaitDI", ("signaldi", "num"), {"maxtime": (2, "num"), "timeflag": (2, "variable bool")}),
    InstructionForm("TPErase"),
    InstructionForm(
        "TPWrite",
        ("string",),
        {"num": (1, "num"), "bool": (1, "bool"), "pos": (1, "pos"), "orient": (1, "orient")},
    ),
    InstructionForm("UIMsgBox", ("string",), _BOX_OPTIONS),
    InstructionForm("TPReadFK", ("variable num", *("string",) * 6), {"maxtime": (7, "num")}),
    InstructionForm("WaitSyncTask", ("syncident", "tasks"), {"inpos": (0, "switch"), "timeout": (2, "num")}),
    InstructionForm("SyncMoveOn", ("syncident", "tasks"), {"timeout": (2, "num")}),
    InstructionForm("SyncMoveOff", ("syncident",), {"timeout": (1, "num")}),
    InstructionForm("SyncMoveUndo"),
    InstructionForm("StopMove", (), {"quick": (0, "switch"), "allmotiontasks": (0, "switch")}),
    InstructionForm("StartMove", (), {"allmotiontasks": (0, "switch")}),
    InstructionForm("ClearPath"),
    InstructionForm("StorePath", (), {"keepsync": (0, "switch")}),
    InstructionForm("RestoPath"),
    InstructionForm("ConfL", (), {"on": (0, "switch"), "off": (0, "switch")}),
    InstructionForm("ConfJ", (), {"on": (0, "switch"), "off": (0, "switch")}),
    InstructionForm("SingArea", (), {"off": (0, "switch"), "wrist": (0, "switch")}),
    InstructionForm("AccSet", ("num", "num")),
    InstructionForm("VelSet", ("num", "num")),
    InstructionForm("ActUnit", ("mecunit",)),
    InstructionForm("DeactUnit", ("mecunit",)),
    InstructionForm("EOffsOff"),
    InstructionForm("GripLoad", ("loaddata",)),
    InstructionForm("ClkReset", ("clock",)),
    InstructionForm("ClkStart", ("clock",)),
    InstructionForm("ClkStop", ("clock",)),
    InstructionForm(
        "Load", ("string",), {"dynamic": (0, "switch"), "file": (1, "string"), "checkref": (1, "switch")}
    ),
    InstructionForm(
        "UnLoad", ("string",), {"errifchanged": (0, "switch"), "save": (0, "switch"), "file": (1, "string")}
    ),
    InstructionForm("Stop", (), {"noregain": (0, "switch"), "allmovetasks": (0, "switch")}),
    InstructionForm(
        "ErrWrite",
        ("string", "string"),
        {f"rl{n}": (2, "string") for n in range(2, 5)} | {"w": (0, "switch")},
    ),
    # statements of one word; the parser reads them the same way
    InstructionForm("EXIT"),
    InstructionForm("RETURN"),
    InstructionForm("RAISE"),
    InstructionForm("RETRY"),
    InstructionForm("TRYNEXT"),
)
INSTRUCTIONS: dict[str, InstructionForm] = {form.name.lower(): form for form in _FORMS}
"""Instructions by lower-case name."""
MOVE_INSTRUCTIONS = frozenset({"moveabsj", "movej", "movel"})
"""Instructions that move an arm."""
IN_HANDLER_ONLY = frozenset({"retry", "trynext"})
"""Instructions that are allowed in error handlers only."""
EXCLUSIVE_OPTIONS = (
    ("v", "t"),
    ("on", "off"),
    ("off", "wrist"),
    ("sdelay", "sync"),
    ("conc", "id"),
    ("errifchanged", "save"),
)
"""Options that exclude each other."""

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
"""Functions by lower-case name: types of the arguments, and type of the result."""
