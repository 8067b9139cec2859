"""What one KRL program asks and says on its panel, and what it has to look at before it moves.

These statements are understood as fixed rows only. Each row of a form is compared word by word,
blanks and case aside; whatever else stands in it is a fault. A dialog goes on by its first key
alone: the loop around it begins anew by any other key, and where the controller cannot show it.

Then their order counts, whatever stands between them. A question is certain where nothing but the
operator answers it: a dialog (krc4), or HALT in a mode of operation in which no PLC starts programs
(krc2), which the statement behind it sees to.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from planner.claims import sentences
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.reader import syntax_tree
from planner.languages.krl.reader.values import KrlValueError
from planner.programs.steps import letters

_EXTERNAL_REASON = "in automatic external a PLC that starts the program again answers it"
"""What speaks against questions in automatic external."""


class PanelError(Exception):
    """A statement stands where it may not."""


class Message(NamedTuple):
    """What is shown: the statement's own word, the text, whether it is a question, and whether it stays on
    the panel as a line."""

    kind: str
    text: str
    confirm: bool = False
    panel: Literal["line", "clear", ""] = ""


class Panel:
    """Follows the statements of a program. ``arm``, ``others``: the names of its arm and of those that it may
    wait for; ``along`` {column: direction in $WORLD} of the external axes that take it. `looked`: at the
    robot's foot; `prepared`: messages have their options."""

    def __init__(
        self,
        dialect: str,
        arm: str,
        others: Sequence[str],
        along: Mapping[int, tuple[float, float, float]] | None = None,
    ) -> None:
        self.dialect, self.arm, self.others, self.along = dialect, arm, others, dict(along or {})
        self.looked = False
        self._question: list[str] = []
        self._reading = False
        self._open = False
        """Whether a HALT has asked, and the mode of operation is not looked at yet."""
        self._external = False
        self.prepared = False
        self._shown = ""
        self._waited = False
        self._told = ""
        """What was shown right before, in letters."""

    def check(self, statement: syntax_tree.Statement | None, depth: int) -> None:
        """Raises `PanelError` where the statement, or the program's end, may not come next."""
        if isinstance(statement, syntax_tree.Said):
            return
        answer: type[syntax_tree.Statement] = (
            syntax_tree.Dialog if self.dialect == "krc4" else syntax_tree.Halt
        )
        if self._question and not isinstance(statement, answer):
            behind = "dialog with the key Yes" if answer is syntax_tree.Dialog else "HALT"
            raise PanelError(f"a question that no {behind} follows")
        if self._reading and not isinstance(statement, syntax_tree.Dialog):
            raise PanelError("a text that is to be read before a question, and no question follows")
        if self._open and not isinstance(statement, syntax_tree.NotExternal):
            raise PanelError(
                f"HALT is no question by itself: {_EXTERNAL_REASON}; refuse that mode right behind it"
            )
        if (
            self._shown
            and depth == 0
            and not isinstance(statement, syntax_tree.Listen | syntax_tree.Call | syntax_tree.Cleared)
        ):
            raise PanelError(f"the panel says {self._shown!r} here, which is not so")

    def halts(self, statement: syntax_tree.Statement) -> bool:
        """Whether the program may halt at the statement without having asked anything."""
        alone = isinstance(statement, syntax_tree.Halt) and self.dialect == "krc4"
        return (
            alone
            or isinstance(statement, syntax_tree.Foot | syntax_tree.AxisLook)
            or (isinstance(statement, syntax_tree.NotExternal) and not self._open)
        )

    def take(self, statement: syntax_tree.Statement, depth: int) -> Message | None:
        """What a statement shows. Raises `PanelError`."""
        said = self._take(statement, depth)
        if not isinstance(statement, syntax_tree.Said):
            self._told += letters(said.text) if said is not None and said.kind == "#NOTIFY" else ""
            self._told = self._told if isinstance(statement, syntax_tree.Notice) else ""
        return said

    def _take(self, statement: syntax_tree.Statement, depth: int) -> Message | None:
        match statement:
            case syntax_tree.Said(kind="question", text=text) if self.dialect == "krc2":
                self._main(depth, "a question (;?)")
                self._question.append(text)
            case syntax_tree.Said(kind="told", text=text) if self.dialect == "krc2":
                return Message(";*", text, panel="line")
            case syntax_tree.Halt():
                return self._halt(depth)
            case syntax_tree.NotExternal():
                self._main(depth, "the refusal of automatic external")
                if self.dialect == "krc4" or (self._external and not self._open):
                    raise PanelError("automatic external is refused where nothing is asked; HALT stops there")
                self._external, self._open = True, False
            case syntax_tree.Prepared():
                self._new("messages")
                self.prepared = True
            case syntax_tree.Dialog(text=text, key=key):
                self._ready(depth, "a dialog")
                return self._dialog(text, key)
            case syntax_tree.Notice(text=text, state=False):
                self._ready(depth, "a message")
                return Message("#NOTIFY", text, panel="line")
            case syntax_tree.Notice(text=text):
                self._ready(depth, "a message")
                return self._state(text)
            case syntax_tree.Cleared():
                if not self._shown or not self._waited:
                    raise PanelError("a state is taken back that is not shown, or was none of waiting")
                self._shown = ""
            case syntax_tree.Listen() if self.dialect == "krc4":
                self._listens(depth)
            case syntax_tree.Foot():
                self._main(depth, "the look at $ROBROOT")
                self._foot(statement)
            case syntax_tree.AxisLook(text=text):
                self._main(depth, "the look at an external axis")
                if bool(text) != (self.dialect == "krc4"):
                    raise PanelError(f"an external axis is looked at, and the panel shows {text!r}")
                if text and not self.prepared:
                    raise PanelError("a message, and tm_opt is not set before")
        return None

    def _main(self, depth: int, what: str) -> None:
        if depth:
            raise PanelError(f"{what} stands elsewhere than in the main program")

    def _new(self, what: str) -> None:
        if self.dialect != "krc4":
            raise PanelError(f"{what} are not of the dialect {self.dialect}, which the cell's controller has")

    def _ready(self, depth: int, what: str) -> None:
        self._new("messages")
        self._main(depth, what)
        if not self.prepared:
            raise PanelError(f"{what}, and tm_opt is not set before")

    def _halt(self, depth: int) -> Message | None:
        """A question of krc2; in krc4 the stop in which the program of another arm is started."""
        self._main(depth, "HALT")
        if self.dialect == "krc4":
            calls = (letters(sentences.START_PARTNER.filled(other=arm)) for arm in self.others)
            if self._told in calls:
                return None
            raise PanelError(f"HALT is no question: {_EXTERNAL_REASON}; ask by a dialog")
        if not self._question:
            raise PanelError("HALT without a question (;?) above it")
        if not self._external:
            raise PanelError("a question before automatic external is refused")
        text, self._question, self._open = " ".join(self._question), [], True
        return Message("HALT", text, True)

    def _dialog(self, text: str, key: str) -> Message | None:
        if key == "next":
            self._question.append(text)
            return None
        if key == "read":
            if self._question:
                raise PanelError("a text that is to be read stands within a question")
            self._reading = True
            return Message("Set_KrlDlg", text, panel="line")
        whole, self._question, self._reading = " ".join([*self._question, text]), [], False
        return Message("Set_KrlDlg", whole, True)

    def _state(self, text: str) -> Message:
        forms = (krl_sentences.WAITING, krl_sentences.TOGETHER)
        known = [form.filled(arm=arm) for arm in self.others for form in forms]
        if text not in known:
            wanted = " or ".join(map(repr, known)) or "nothing"
            raise PanelError(f"the panel says {text!r} while it waits; wanted: {wanted}")
        self._shown, self._waited = text, False
        return Message("#STATE", text)

    def _listens(self, depth: int) -> None:
        forms = (krl_sentences.TOGETHER,) if depth else (krl_sentences.WAITING,)
        if self._shown not in [form.filled(arm=arm) for arm in self.others for form in forms]:
            raise PanelError("the program waits for the other arm, and the panel does not say so")
        self._waited = True

    def _foot(self, look: syntax_tree.Foot) -> None:
        shift, turn, text = look.shift, look.turn, look.text
        self._aligned(look.along)
        says = krl_sentences.FOOT_RIDES if self.along else krl_sentences.FOOT
        wanted = says.filled(arm=self.arm) if self.dialect == "krc4" else ""
        if text != wanted:
            raise PanelError(f"$ROBROOT is looked at with the text {text!r}; wanted: {wanted!r}")
        if text and not self.prepared:
            raise PanelError("a message, and tm_opt is not set before")
        if shift > syntax_tree.FOOT_SHIFT_MM or turn > syntax_tree.FOOT_TURN_DEG:
            allowed = f"{syntax_tree.FOOT_SHIFT_MM:g} mm and {syntax_tree.FOOT_TURN_DEG:g} deg"
            raise PanelError(f"$ROBROOT may be off by {shift:g} mm and {turn:g} deg; allowed: {allowed}")
        self.looked = True

    def _aligned(self, along: Sequence[tuple[int, tuple[float, float, float]]]) -> None:
        """Refuse a look that takes the arm for standing, or for going in other directions, or by others."""
        if not self.along:
            if along:
                raise PanelError("$ROBROOT_C is looked at, and the arm stands on no track; wanted: $ROBROOT")
            return
        if not along:
            by = _directions(self.along.items())
            raise PanelError(f"$ROBROOT is looked at, and axes move the arm along {by}")
        columns = [column for column, _ in along]
        same = sorted(columns) == sorted(self.along) and all(
            max(abs(a - b) for a, b in zip(way, self.along[column], strict=True)) <= syntax_tree.ALONG_ERROR
            for column, way in along
        )
        if not same:
            got, wanted = _directions(along), _directions(self.along.items())
            raise PanelError(f"$ROBROOT_C is looked at along {got}; axes move the arm along {wanted}")


def _directions(along: Iterable[tuple[int, tuple[float, float, float]]]) -> str:
    """Directions of external axes, in words."""
    parts = (f"({', '.join(f'{v:g}' for v in way)}) by E{column + 1}" for column, way in along)
    return " and ".join(parts)


Found = Sequence[re.Match[str]]
TEXT_LENGTH = 80
"""Characters of a message's text."""
_PARAMETER = re.compile(r"%\d")
"""Place of a parameter in a message's text."""
_PLACEHOLDERS = {"<text>": r'"([^"]*)"', "<number>": r"(\d+(?:\.\d+)?)", "<whole>": r"\d+"}
"""What stands for figures and texts in the forms below, as patterns."""

VARIABLES = {
    "krc4": {
        "tm_msg": "krlmsg_t",
        "tm_par[3]": "krlmsgpar_t",
        "tm_opt": "krlmsgopt_t",
        "tm_key[7]": "krlmsgdlgsk_t",
        "tm_ticket": "int",
        "tm_state": "int",
        "tm_answer": "int",
        "tm_gone": "bool",
        "tm_shift": "real",
        "tm_turn": "real",
    },
    "krc2": {"tm_shift": "real", "tm_turn": "real"},
}
"""The variables of a main program by dialect: {name with its size: type}."""


@dataclass(frozen=True)
class Form:
    """Rows that follow one another, comments between them left out, as one statement: `what` it is to a
    person, `make` {line, matches of the rows} its value."""

    what: str
    rows: tuple[re.Pattern[str], ...]
    make: Callable[[int, Found], syntax_tree.Statement]


def _row(code: str) -> re.Pattern[str]:
    """The pattern of a row: <text> stands for a string, <number> for a number, <whole> for a whole one."""
    words = re.findall(r'<[\w|]+>|"[^"]*"|==|<>|\d+\.\d+|[$#]?\w+|[^\w\s]', code)
    out = ""
    for before, word in zip(["", *words], words, strict=False):
        if before and "." not in (before, word):
            out += r"\s+" if re.match(r"[\w$#]", word) and re.search(r"\w$", before) else r"\s*"
        out += _PLACEHOLDERS.get(word, re.escape(word))
    return re.compile(out, re.IGNORECASE | re.ASCII)


def _rows(*code: str) -> tuple[re.Pattern[str], ...]:
    return tuple(map(_row, code))


def _text(text: str) -> str:
    """A text as the panel shows it; raises `KrlValueError` for one that it cuts or puts something into."""
    if len(text) > TEXT_LENGTH:
        what = f"a text of {len(text)} characters; allowed: {TEXT_LENGTH}"
        raise KrlValueError("string_length", what)
    if _PARAMETER.search(text):
        raise KrlValueError("syntax", f"{text!r:.40} has a place for a parameter, and none is given")
    return text


_FOOT_VALUES = (
    "tm_shift=SQRT($ROBROOT.X*$ROBROOT.X+$ROBROOT.Y*$ROBROOT.Y+$ROBROOT.Z*$ROBROOT.Z)",
    "tm_turn=ABS($ROBROOT.A)+ABS($ROBROOT.B)+ABS($ROBROOT.C)",
)
"""Statements that work out how far $ROBROOT is off zero."""
_TAKEN = r"[+-]\s*\d(?:\.\d+)?\s*\*\s*\$AXIS_ACT\.E[1-6]"
_RIDDEN = rf"ABS\s*\(\s*\$ROBROOT_C\.%s\s*((?:{_TAKEN}\s*)+)\)"
_PARTS = re.compile(r"([+-])\s*(\d(?:\.\d+)?)\s*\*\s*\$AXIS_ACT\.E([1-6])", re.IGNORECASE | re.ASCII)
_RIDDEN_VALUES = (
    *(
        re.compile(rf"tm_shift\s*=\s*{before}{_RIDDEN % axis}", re.IGNORECASE | re.ASCII)
        for before, axis in (("", "X"), (r"tm_shift\s*\+\s*", "Y"), (r"tm_shift\s*\+\s*", "Z"))
    ),
    _row("tm_turn=ABS($ROBROOT_C.A)+ABS($ROBROOT_C.B)+ABS($ROBROOT_C.C)"),
)
"""The same of an arm on external axes, less what these move it by."""
_FOOT_LOOP = "WHILE (tm_shift><number>) OR (tm_turn><number>)"
"""The loop that goes on while it is."""
_MESSAGE = 'tm_msg={Modul[] "Tandem",Nr <whole>,Msg_txt[] <text>}'
"""The statement that sets a message."""
_FOOT_MESSAGE = (
    "tm_par[1].Par_Type=#VALUE",
    "tm_par[1].Par_Real=tm_shift",
    "tm_par[2].Par_Type=#VALUE",
    "tm_par[2].Par_Real=tm_turn",
    _MESSAGE,
    "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
)
"""Statements that show it."""
_AFTER = ("tm_par[1].Par_Type=#EMPTY", "tm_par[2].Par_Type=#EMPTY")


def _dialog(line: int, found: Found) -> syntax_tree.Statement:
    yes, other = found[3][1].lower(), found[4][1]
    if (yes == "yes") != (other is not None):
        what = f"a dialog has the keys Yes and No, or Next or Read alone; got {found[3][1]} and {other}"
        raise KrlValueError("syntax", what)
    return syntax_tree.Dialog(line, _text(found[2][1]), yes)


_QUESTION = _rows(
    "tm_answer=0",
    "WHILE tm_answer<>1",
    _MESSAGE,
    "tm_key[1]={SK_type #VALUE,SK_txt[] <text>}",
    "tm_key[2]=",
    "tm_ticket=Set_KrlDlg(tm_msg,tm_par[],tm_key[],tm_opt)",
    "WHILE Exists_KrlDlg(tm_ticket,tm_answer)",
    "WAIT SEC 0.1",
    "ENDWHILE",
    "WAIT SEC 0.1",
    "ENDWHILE",
)
"""Statements that ask a question until it is answered."""
_FIRST_KEY = re.compile(
    r'tm_key\s*\[\s*1\s*\]\s*=\s*\{\s*SK_type\s+#VALUE\s*,\s*SK_txt\s*\[\s*\]\s*"(Yes|Next|Read)"\s*\}',
    re.IGNORECASE | re.ASCII,
)
"""The soft key that answers."""
_SECOND_KEY = re.compile(
    r"tm_key\s*\[\s*2\s*\]\s*=\s*"
    r'\{\s*SK_type\s+(?:#EMPTY|#VALUE\s*,\s*SK_txt\s*\[\s*\]\s*"(No)")\s*\}',
    re.IGNORECASE | re.ASCII,
)
"""The other soft key: of a second answer, or empty."""


def _foot(line: int, found: Found, text: str, moving: bool) -> syntax_tree.Statement:
    rows = len(_RIDDEN_VALUES) if moving else len(_FOOT_VALUES)
    along: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    if moving:
        behind = rows + (2 + len(_FOOT_MESSAGE) if text else 2)
        first, again = (_along(found[k : k + 3]) for k in (0, behind))
        if first != again:
            what = f"$ROBROOT_C is looked at along {first} first, and along {again} then"
            raise KrlValueError("type", what)
        along = first
    return syntax_tree.Foot(line, float(found[rows][1]), float(found[rows][2]), text, along)


def _along(rows: Found) -> tuple[tuple[int, tuple[float, float, float]], ...]:
    """The directions by which rows take off what external axes move, by their columns; raises
    `KrlValueError` where X, Y and Z are not of the same axes, each once."""
    parts = [
        [(int(axis) - 1, (1.0 if sign == "-" else -1.0) * float(size) + 0.0) for sign, size, axis in found]
        for found in (_PARTS.findall(row[1]) for row in rows)
    ]
    columns = [[column for column, _ in own] for own in parts]
    if len(set(columns[0])) < len(columns[0]) or columns[1:] != columns[:1] * 2:
        shown = "; ".join(", ".join(f"E{column + 1}" for column in own) for own in columns)
        raise KrlValueError(
            "type", f"$ROBROOT_C is looked at by {shown}; wanted: each axis once, in X, Y and Z"
        )
    ways = zip(*([size for _, size in own] for own in parts), strict=True)
    return tuple(zip(columns[0], ((x, y, z) for x, y, z in ways), strict=True))


def _foot_forms(what: str, values: tuple[re.Pattern[str], ...], moving: bool = False) -> tuple[Form, Form]:
    """The look at the foot that shows nothing, and the one that shows how far it is off."""
    head, silent, shown = _rows(_FOOT_LOOP), _rows("HALT"), _rows(*_FOOT_MESSAGE, "HALT")
    text = len(values) + len(head) + _FOOT_MESSAGE.index(_MESSAGE)
    return (
        Form(
            what,
            (*values, *head, *silent, *values, *_rows("ENDWHILE")),
            lambda line, found: _foot(line, found, "", moving),
        ),
        Form(
            what,
            (*values, *head, *shown, *values, *_rows("ENDWHILE", *_AFTER)),
            lambda line, found: _foot(line, found, found[text][1], moving),
        ),
    )


_AXIS_OFF = (
    re.compile(
        r"tm_shift\s*=\s*ABS\s*\(\s*\$AXIS_ACT\.E([1-6])\s*([+-])\s*(\d+(?:\.\d+)?)\s*\)",
        re.IGNORECASE | re.ASCII,
    ),
    re.compile(r"IF\s+tm_shift\s*>\s*(\d+(?:\.\d+)?)\s+THEN", re.IGNORECASE | re.ASCII),
)
"""Statements that work out how far an external axis is off home, and begin what follows where it is."""
_AXIS_MESSAGE = _rows(*_FOOT_MESSAGE[:2], *_FOOT_MESSAGE[4:])
_NEVER_ON = _rows("LOOP", "HALT", "ENDLOOP", "ENDIF")


def _axis_look(line: int, found: Found, text: str) -> syntax_tree.Statement:
    home = float(found[0][3]) * (1.0 if found[0][2] == "-" else -1.0)
    return syntax_tree.AxisLook(line, int(found[0][1]) - 1, home + 0.0, float(found[1][1]), text)


PANEL_FORMS: tuple[Form, ...] = (
    Form(
        "the interrupt of stop messages",
        _rows("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM()"),
        lambda line, _: syntax_tree.StopInterrupt(line, False),
    ),
    Form(
        "the interrupt of stop messages",
        _rows("INTERRUPT ON 3"),
        lambda line, _: syntax_tree.StopInterrupt(line, True),
    ),
    Form(
        "the refusal of automatic external",
        _rows("WHILE $MODE_OP==#EX", "HALT", "ENDWHILE"),
        lambda line, _: syntax_tree.NotExternal(line),
    ),
    Form("a dialog", (*_QUESTION[:3], _FIRST_KEY, _SECOND_KEY, *_QUESTION[5:]), _dialog),
    Form(
        "the options of messages",
        _rows(
            "tm_opt={VL_Stop TRUE,Clear_P_Reset TRUE,Clear_P_SAW TRUE,Log_To_DB FALSE}",
            *(f"tm_par[{i}]={{Par_Type #EMPTY}}" for i in range(1, 4)),
            *(f"tm_key[{i}]={{SK_type #EMPTY}}" for i in range(3, 8)),
        ),
        lambda line, _: syntax_tree.Prepared(line),
    ),
    Form(
        "a message",
        (
            _row(_MESSAGE),
            re.compile(
                _row("tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)").pattern
                + "|("
                + _row("tm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)").pattern
                + ")",
                re.IGNORECASE | re.ASCII,
            ),
        ),
        lambda line, found: syntax_tree.Notice(line, _text(found[0][1]), found[1][1] is not None),
    ),
    Form(
        "the look at an external axis",
        (*_AXIS_OFF, *_NEVER_ON),
        lambda line, found: _axis_look(line, found, ""),
    ),
    Form(
        "the look at an external axis",
        (*_AXIS_OFF, *_AXIS_MESSAGE, *_NEVER_ON),
        lambda line, found: _axis_look(line, found, found[4][1]),
    ),
    Form(
        "the end of a state",
        _rows("tm_gone=Clear_KrlMsg(tm_state)"),
        lambda line, _: syntax_tree.Cleared(line),
    ),
    *_foot_forms("the look at $ROBROOT", _rows(*_FOOT_VALUES)),
    *_foot_forms("the look at $ROBROOT_C", _RIDDEN_VALUES, moving=True),
)
"""All forms; of those that begin alike the one counts that goes on as the text does."""


def variables(code: str) -> tuple[tuple[str, str], ...] | None:
    """The (type, name) pairs of a DECL in a program, in lower case; None for any other row."""
    found = re.fullmatch(
        r"DECL\s+(\w+)\s+(\w+(?:\[\d+\])?(?:\s*,\s*\w+(?:\[\d+\])?)*)", code, re.IGNORECASE | re.ASCII
    )
    if found is None:
        return None
    kind = found[1].lower()
    return tuple((kind, name.strip().lower()) for name in found[2].split(","))
