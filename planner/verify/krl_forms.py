"""Statements of KRL that are understood as fixed rows only: what is asked and told on the panel, and what a
program looks at before it moves anything.

Each row of a form is compared word by word, blanks and case aside; whatever else stands in it is a fault. A
dialog goes on by its first key alone: the loop around it begins anew by any other key, and where the
controller cannot show it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from planner.verify.krl_ast import (
    Cleared,
    Dialog,
    Foot,
    NotExternal,
    Notice,
    Prepared,
    Statement,
    StopInterrupt,
)
from planner.verify.krl_values import KrlValueError

Found = Sequence[re.Match[str]]
TEXT_LENGTH = 80
"""Characters of a message's text."""
_PARAMETER = re.compile(r"%\d")
_PLACES = {"<text>": r'"([^"]*)"', "<number>": r"(\d+(?:\.\d+)?)", "<whole>": r"\d+"}

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
    make: Callable[[int, Found], Statement]


def _row(code: str) -> re.Pattern[str]:
    """The pattern of a row: <text> stands for a string, <number> for a number, <whole> for a whole one."""
    words = re.findall(r'<[\w|]+>|"[^"]*"|==|<>|\d+\.\d+|[$#]?\w+|[^\w\s]', code)
    out = ""
    for before, word in zip(["", *words], words, strict=False):
        if before and "." not in (before, word):
            out += r"\s+" if re.match(r"[\w$#]", word) and re.search(r"\w$", before) else r"\s*"
        out += _PLACES.get(word, re.escape(word))
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


_LOOKED = (
    "tm_shift=SQRT($ROBROOT.X*$ROBROOT.X+$ROBROOT.Y*$ROBROOT.Y+$ROBROOT.Z*$ROBROOT.Z)",
    "tm_turn=ABS($ROBROOT.A)+ABS($ROBROOT.B)+ABS($ROBROOT.C)",
)
_AWAY = "WHILE (tm_shift><number>) OR (tm_turn><number>)"
_SHOWN = (
    "tm_par[1].Par_Type=#VALUE",
    "tm_par[1].Par_Real=tm_shift",
    "tm_par[2].Par_Type=#VALUE",
    "tm_par[2].Par_Real=tm_turn",
    'tm_msg={Modul[] "Tandem",Nr <whole>,Msg_txt[] <text>}',
    "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
)
_AFTER = ("tm_par[1].Par_Type=#EMPTY", "tm_par[2].Par_Type=#EMPTY")


def _dialog(line: int, found: Found) -> Statement:
    yes, other = found[3][1].lower(), found[4][1]
    if (yes == "yes") != (other is not None):
        what = f"a dialog has the keys Yes and No, or Next or Read alone; got {found[3][1]} and {other}"
        raise KrlValueError("syntax", what)
    return Dialog(line, _text(found[2][1]), yes)


_ASKED = _rows(
    "tm_answer=0",
    "WHILE tm_answer<>1",
    'tm_msg={Modul[] "Tandem",Nr <whole>,Msg_txt[] <text>}',
    "tm_key[1]={SK_type #VALUE,SK_txt[] <text>}",
    "tm_key[2]=",
    "tm_ticket=Set_KrlDlg(tm_msg,tm_par[],tm_key[],tm_opt)",
    "WHILE Exists_KrlDlg(tm_ticket,tm_answer)",
    "WAIT SEC 0.1",
    "ENDWHILE",
    "WAIT SEC 0.1",
    "ENDWHILE",
)
_KEY = re.compile(
    r'tm_key\s*\[\s*1\s*\]\s*=\s*\{\s*SK_type\s+#VALUE\s*,\s*SK_txt\s*\[\s*\]\s*"(Yes|Next|Read)"\s*\}',
    re.IGNORECASE | re.ASCII,
)
_OTHER_KEY = re.compile(
    r"tm_key\s*\[\s*2\s*\]\s*=\s*"
    r'\{\s*SK_type\s+(?:#EMPTY|#VALUE\s*,\s*SK_txt\s*\[\s*\]\s*"(No)")\s*\}',
    re.IGNORECASE | re.ASCII,
)


def _foot(line: int, found: Found, text: str) -> Statement:
    return Foot(line, float(found[2][1]), float(found[2][2]), text)


FORMS: tuple[Form, ...] = (
    Form(
        "the interrupt of stop messages",
        _rows("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM()"),
        lambda line, _: StopInterrupt(line, False),
    ),
    Form(
        "the interrupt of stop messages", _rows("INTERRUPT ON 3"), lambda line, _: StopInterrupt(line, True)
    ),
    Form(
        "the refusal of automatic external",
        _rows("WHILE $MODE_OP==#EX", "HALT", "ENDWHILE"),
        lambda line, _: NotExternal(line),
    ),
    Form("a dialog", (*_ASKED[:3], _KEY, _OTHER_KEY, *_ASKED[5:]), _dialog),
    Form(
        "the options of messages",
        _rows(
            "tm_opt={VL_Stop TRUE,Clear_P_Reset TRUE,Clear_P_SAW TRUE,Log_To_DB FALSE}",
            *(f"tm_par[{i}]={{Par_Type #EMPTY}}" for i in range(1, 4)),
            *(f"tm_key[{i}]={{SK_type #EMPTY}}" for i in range(3, 8)),
        ),
        lambda line, _: Prepared(line),
    ),
    Form(
        "a message",
        (
            _row('tm_msg={Modul[] "Tandem",Nr <whole>,Msg_txt[] <text>}'),
            re.compile(
                _row("tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)").pattern
                + "|("
                + _row("tm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)").pattern
                + ")",
                re.IGNORECASE | re.ASCII,
            ),
        ),
        lambda line, found: Notice(line, _text(found[0][1]), found[1][1] is not None),
    ),
    Form(
        "the end of a state",
        _rows("tm_gone=Clear_KrlMsg(tm_state)"),
        lambda line, _: Cleared(line),
    ),
    Form(
        "the look at $ROBROOT",
        _rows(*_LOOKED, _AWAY, "HALT", *_LOOKED, "ENDWHILE"),
        lambda line, found: _foot(line, found, ""),
    ),
    Form(
        "the look at $ROBROOT",
        _rows(*_LOOKED, _AWAY, *_SHOWN, "HALT", *_LOOKED, "ENDWHILE", *_AFTER),
        lambda line, found: _foot(line, found, found[7][1]),
    ),
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
