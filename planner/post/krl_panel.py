"""What a KUKA controller shows and asks on its panel: dialogs and messages (krc4), comments and HALT (krc2).

HALT is no confirmation: in automatic external a PLC that pulses its start signal goes on behind it. Dialogs
are answered at the panel in every mode; where there are none (krc2), that mode is refused.
"""

from __future__ import annotations

import re
import textwrap
from typing import Final

from planner import dialogue
from planner.issues import Issue, TandemError
from planner.post.krl_format import comment
from planner.post.text import plain
from planner.problem import KrlDialect

FOOT_OLD: Final = "Arm {arm}: $ROBROOT is off zero by tm_shift mm, tm_turn deg."
EXTERNAL: Final = "In automatic external a PLC would answer. Take another mode of operation, then Start."
YES, NO, NEXT, READ = "Yes", "No", "Next", "Read"
"""Keys of dialogs; the first key of each goes on."""
TEXT_LENGTH: Final = 80
"""Characters of a message's text."""
FOOT_SHIFT, FOOT_TURN = "0.1", "0.02"
"""How far the robot's foot may be off zero: [mm], [deg]."""

INTERRUPT: Final = ("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )", "INTERRUPT ON 3")
"""What lets the stop reactions of IR_STOPM.src act, as in every program that KUKA's template makes."""
EXT_BAS: Final = "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
_FOOT_VALUES: Final = "DECL REAL tm_shift,tm_turn"
_MESSAGES: Final = (
    "DECL KrlMsg_T tm_msg",
    "DECL KrlMsgPar_T tm_par[3]",
    "DECL KrlMsgOpt_T tm_opt",
    "DECL KrlMsgDlgSK_T tm_key[7]",
    "DECL INT tm_ticket,tm_state,tm_answer",
    "DECL BOOL tm_gone",
)
_WRAP: Final = 100


def declarations(dialect: KrlDialect) -> list[str]:
    """The variables of a main program."""
    return [*(_MESSAGES if dialect == "krc4" else ()), _FOOT_VALUES]


def prepared(dialect: KrlDialect) -> list[str]:
    """What stands before the first message: options, and no parameters or keys; krc2: refusal of the mode
    in which a PLC starts programs."""
    if dialect == "krc2":
        return _not_external()
    return [
        "tm_opt={VL_Stop TRUE,Clear_P_Reset TRUE,Clear_P_SAW TRUE,Log_To_DB FALSE}",
        *(f"tm_par[{i}]={{Par_Type #EMPTY}}" for i in range(1, 4)),
        *(f"tm_key[{i}]={{SK_type #EMPTY}}" for i in range(3, 8)),
    ]


def asked(text: str, dialect: KrlDialect) -> list[str]:
    """A question: the program goes on when the operator says yes, and asks again else. krc4: dialogs, those
    before the last with the key Next; krc2: comments with their mark, and HALT, in no mode of a PLC."""
    if dialect == "krc2":
        return [*_marked("?", text), "HALT", *_not_external()]
    *first, last = _parts(text)
    return [*(line for part in first for line in _dialog(part, NEXT)), *_dialog(last, YES, NO)]


def told(text: str, dialect: KrlDialect, before_question: bool = False) -> list[str]:
    """What the operator is told; ``before_question``: a question follows that is answered by it, so that it
    has to be read first (krc4: by dialogs with the key Read)."""
    if dialect == "krc2":
        return _marked("*", text)
    parts = _parts(text)
    if before_question:
        return [line for part in parts for line in _dialog(part, READ)]
    shown = ([_message(part, 2), "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)"] for part in parts)
    return [line for lines in shown for line in lines]


def during(text: str, lines: list[str], dialect: KrlDialect) -> list[str]:
    """The lines with a text on the panel while they run (krc4)."""
    if dialect == "krc2":
        return lines
    (part,) = _parts(text)
    shown = [_message(part, 3), "tm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)"]
    return [*shown, *lines, "tm_gone=Clear_KrlMsg(tm_state)"]


def foot(arm: str, dialect: KrlDialect) -> list[str]:
    """The program halts, whatever is started, until ``$ROBROOT`` is zero: by the length of its way, and by
    the sum of its angles, which no turn exceeds."""
    squares = "+".join(f"$ROBROOT.{axis}*$ROBROOT.{axis}" for axis in "XYZ")
    looked = [f"tm_shift=SQRT({squares})", f"tm_turn={'+'.join(f'ABS($ROBROOT.{a})' for a in 'ABC')}"]
    names = dialogue.FOOT.say(arm=arm)
    if dialect == "krc2":
        shown = comment(FOOT_OLD.format(arm=arm))
        after: list[str] = []
    else:
        shown = [
            "tm_par[1].Par_Type=#VALUE",
            "tm_par[1].Par_Real=tm_shift",
            "tm_par[2].Par_Type=#VALUE",
            "tm_par[2].Par_Real=tm_turn",
            _message(names, 4),
            "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
        ]
        after = ["tm_par[1].Par_Type=#EMPTY", "tm_par[2].Par_Type=#EMPTY"]
    away = f"WHILE (tm_shift>{FOOT_SHIFT}) OR (tm_turn>{FOOT_TURN})"
    return [*looked, away, *shown, "HALT", *looked, "ENDWHILE", *after]


def _not_external() -> list[str]:
    return ["WHILE $MODE_OP==#EX", *comment(EXTERNAL), "HALT", "ENDWHILE"]


def _marked(mark: str, text: str) -> list[str]:
    return [f";{mark} {line}" for line in textwrap.wrap(plain(text), _WRAP, break_on_hyphens=False)]


def _parts(text: str) -> list[str]:
    """A text in parts that a message takes; raises :class:`TandemError` (``post.name``) for what none can
    show: words that are too long, quotes, and marks of parameters."""
    flat = plain(text)
    word = max(flat.split(), key=len, default="")
    if len(word) > TEXT_LENGTH or '"' in flat or re.search(r"%\d", flat):
        got = f"{word[:20]}... of {len(word)} characters" if len(word) > TEXT_LENGTH else repr(flat)
        what = f"the panel of a KUKA controller cannot show {got}"
        hint = f"give names of at most {TEXT_LENGTH} characters, without quotes and %"
        raise TandemError(Issue("post.name", what, hint=hint))
    return textwrap.wrap(flat, TEXT_LENGTH, break_on_hyphens=False, break_long_words=False)


def _message(text: str, number: int) -> str:
    return f'tm_msg={{Modul[] "Tandem",Nr {number},Msg_txt[] "{text}"}}'


def _dialog(text: str, yes: str, no: str = "") -> list[str]:
    """A dialog that comes back until its first key is pressed; if it cannot be shown, too."""
    other = f'{{SK_type #VALUE,SK_txt[] "{no}"}}' if no else "{SK_type #EMPTY}"
    return [
        "tm_answer=0",
        "WHILE tm_answer<>1",
        _message(text, 1),
        f'tm_key[1]={{SK_type #VALUE,SK_txt[] "{yes}"}}',
        f"tm_key[2]={other}",
        "tm_ticket=Set_KrlDlg(tm_msg,tm_par[],tm_key[],tm_opt)",
        "WHILE Exists_KrlDlg(tm_ticket,tm_answer)",
        "WAIT SEC 0.1",
        "ENDWHILE",
        "WAIT SEC 0.1",
        "ENDWHILE",
    ]
