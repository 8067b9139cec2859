"""How KRL writes numbers, names and aggregates, and what a KUKA controller shows and asks on its panel.

Dialogs are krc4, comments and HALT krc2. HALT is no confirmation: in automatic external a PLC that
pulses its start signal goes on behind it. Dialogs are answered at the panel in every mode; where
there are none (krc2), that mode is refused.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.claims import dialogue
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, TandemError
from planner.post.program import number, plain
from planner.problem import KrlDialect

NAME_LENGTH: Final = 24
"""Longest name in KRL [characters]."""
ANGLE_DECIMALS: Final = 5
"""Decimals of A, B, C of targets in degrees."""
_FRAME_ANGLE_DECIMALS: Final = 6
"""Decimals of the angles of a FRAME in degrees."""
_POLE_COSINE: Final = 1e-7
"""Below this cosine of B, A and C turn about one axis, and C is 0."""
_ZERO_AXES: Final = ",".join(f"E{i} 0.0" for i in range(1, 7))
"""External axes, which stand."""

_RESERVED_TEXT: Final = """
and anin anout b_and b_exor b_not b_or bool brake c_dis c_ori c_ptp c_spl c_vel case char circ circ_rel
confirm const continue cont cycflag decl def default deffct defdat delay delete direction distance do
else end enddat endfct endfor endif endloop endspline endswitch endwhile enum exit exor ext extfct false
flag for frame global goto halt if imp import in inout input int interrupt is ldat lin lin_rel load loop
maximum minimum not off on or out output pdat pos axis e6pos e6axis fdat prio ptp ptp_rel public pulse
real repeat resume return scirc sec seq signal slin spl spline sptp step struc switch sync then timer to
trigger true until var vel wait when while with x y z a b c s t bas home sps cell p00 ir_stopm msglib
user_grp user_saf config krlmsg_t krlmsgpar_t krlmsgopt_t krlmsgdlgsk_t set_krlmsg set_krldlg exists_krlmsg
exists_krldlg clear_krlmsg tm_msg tm_par tm_opt tm_key tm_ticket tm_state tm_answer tm_gone tm_shift tm_turn
"""
"""Words that no name may be."""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words of the language, components of its structures, names that every controller has, and those of our own
variables."""


def name(text: str, length: int = NAME_LENGTH) -> str:
    """A name from text, in small letters: letters, digits and single underscores, a letter first, cut to
    ``length``.

    Raises :class:`TandemError` (``post.name``) when that gives no name that KRL takes.
    """
    out = re.sub(r"[^a-z0-9]+", "_", plain(text).lower()).strip("_")[:length].rstrip("_")
    if not re.match(r"[a-z]", out) or out in RESERVED:
        message = f"{text!r} cannot name anything in KRL (it gives {out!r})"
        raise TandemError(Issue("post.name", message, hint="a letter first, no reserved word"))
    return out


def comment(text: str) -> list[str]:
    """Comment lines of plain text, wrapped."""
    return [f"; {line}" for line in textwrap.wrap(plain(text), 100)]


def mark(segment: Segment) -> str:
    """The label by which a comment says which segment begins; names that have more than letters, digits and
    underscores as programs can tell them."""
    label = str(segment)
    return label if re.fullmatch(r"[\w/]+", label, re.ASCII) else segment.key


def abc(rotation: FloatArray) -> FloatArray:
    """KUKA's A, B, C (..., 3) [deg] of rotations (..., 3, 3) = Rz(A) Ry(B) Rx(C); C is 0 where B is +-90."""
    r = np.asarray(rotation, dtype=np.float64)
    flat = np.hypot(r[..., 0, 0], r[..., 1, 0])
    pole = flat < _POLE_COSINE
    a = np.where(pole, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    b = np.arctan2(-r[..., 2, 0], flat)
    c = np.where(pole, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    return np.asarray(np.rad2deg(np.stack([a, b, c], axis=-1)))


def rotation(degrees: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of KUKA's A, B, C (..., 3) [deg]."""
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    (ca, cb, cc), (sa, sb, sc) = np.moveaxis(cos, -1, 0), np.moveaxis(sin, -1, 0)
    rows = [
        [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
        [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
        [-sb, cb * sc, cb * cc],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def frame(pose: FloatArray, millimetres: int = 4) -> str:
    """A FRAME of (4, 4) [m]: mm with so many decimals, degrees with 6."""
    position = [number(1e3 * v, millimetres) for v in pose[:3, 3]]
    angles = [number(v, _FRAME_ANGLE_DECIMALS) for v in abc(pose[:3, :3])]
    return aggregate(dict(zip("XYZABC", [*position, *angles], strict=True)))


def e6pos(position: FloatArray, angles: FloatArray, status: int, turn: int) -> str:
    """An E6POS of a position (3,) [mm] and angles (3,) [deg] as targets are written."""
    values = [*(number(v, 4) for v in position), *(number(v, ANGLE_DECIMALS) for v in angles)]
    fields = dict(zip("XYZABC", values, strict=True)) | {"S": str(status), "T": str(turn)}
    return f"{aggregate(fields)[:-1]},{_ZERO_AXES}}}"


def e6axis(degrees: FloatArray) -> str:
    """An E6AXIS of the controller's joint values (6,) [deg]."""
    fields = {f"A{i}": number(v, 6) for i, v in enumerate(degrees, 1)}
    return f"{aggregate(fields)[:-1]},{_ZERO_AXES}}}"


def aggregate(fields: Mapping[str, str]) -> str:
    """``{X 1.0,Y 2.0}``"""
    return "{" + ",".join(f"{key} {value}" for key, value in fields.items()) + "}"


KRC2_FOOT: Final = "Arm {arm}: $ROBROOT is off zero by tm_shift mm, tm_turn deg."
"""As `planner.claims.dialogue.FOOT`, where a message has no parameters."""
EXTERNAL_REFUSAL: Final = (
    "In automatic external a PLC would answer. Take another mode of operation, then Start."
)
"""Shown where a question would be asked in automatic external."""
YES, NO, NEXT, READ = "Yes", "No", "Next", "Read"
"""Keys of dialogs; the first key of each goes on."""
TEXT_LENGTH: Final = 80
"""Characters of a message's text."""
FOOT_SHIFT, FOOT_TURN = "0.1", "0.02"
"""How far the robot's foot may be off zero: [mm], [deg]."""

INTERRUPT: Final = ("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )", "INTERRUPT ON 3")
"""What lets the stop reactions of IR_STOPM.src act, as in every program that KUKA's template makes."""
EXT_BAS: Final = "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
"""Declaration of the controller's BAS."""
_FOOT_DECLARATION: Final = "DECL REAL tm_shift,tm_turn"
"""Variables of what `KRC2_FOOT` shows."""
_MESSAGE_DECLARATIONS: Final = (
    "DECL KrlMsg_T tm_msg",
    "DECL KrlMsgPar_T tm_par[3]",
    "DECL KrlMsgOpt_T tm_opt",
    "DECL KrlMsgDlgSK_T tm_key[7]",
    "DECL INT tm_ticket,tm_state,tm_answer",
    "DECL BOOL tm_gone",
)
"""Variables of messages."""
_COMMENT_WIDTH: Final = 100
"""Comments are wrapped at so many characters."""


def declarations(dialect: KrlDialect) -> list[str]:
    """The variables of a main program."""
    return [*(_MESSAGE_DECLARATIONS if dialect == "krc4" else ()), _FOOT_DECLARATION]


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


def question_lines(text: str, dialect: KrlDialect) -> list[str]:
    """A question: the program goes on when the operator says yes, and asks again else. krc4: dialogs, those
    before the last with the key Next; krc2: comments with their mark, and HALT, in no mode of a PLC."""
    if dialect == "krc2":
        return [*_marked("?", text), "HALT", *_not_external()]
    *first, last = _parts(text)
    return [*(line for part in first for line in _dialog(part, NEXT)), *_dialog(last, YES, NO)]


def message_lines(text: str, dialect: KrlDialect, before_question: bool = False) -> list[str]:
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


def robroot_check(arm: str, dialect: KrlDialect) -> list[str]:
    """The program halts, whatever is started, until ``$ROBROOT`` is zero: by the length of its way, and by
    the sum of its angles, which no turn exceeds."""
    squares = "+".join(f"$ROBROOT.{axis}*$ROBROOT.{axis}" for axis in "XYZ")
    looked = [f"tm_shift=SQRT({squares})", f"tm_turn={'+'.join(f'ABS($ROBROOT.{a})' for a in 'ABC')}"]
    names = dialogue.FOOT.filled(arm=arm)
    if dialect == "krc2":
        shown = comment(KRC2_FOOT.format(arm=arm))
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
    return ["WHILE $MODE_OP==#EX", *comment(EXTERNAL_REFUSAL), "HALT", "ENDWHILE"]


def _marked(mark: str, text: str) -> list[str]:
    return [f";{mark} {line}" for line in textwrap.wrap(plain(text), _COMMENT_WIDTH, break_on_hyphens=False)]


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
