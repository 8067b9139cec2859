"""KRL as text: numbers, names, aggregates, straight moves, and what a controller shows on its panel.

Dialogs are krc4, comments and HALT krc2. HALT is no confirmation: in automatic external a PLC that
pulses its start signal goes on behind it. Dialogs are answered at the panel in every mode; where
there are none (krc2), that mode is refused.

**Straight moves** of whole tracks at once (`Rows`, `lines`): poses, speeds, corners, and their
text. KRL states no times: a move's speeds are those that its planned time asks for, rounded down.
"""

import dataclasses
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, from_quaternion
from planner.geometry.corner_rounding import FINE_ZONES
from planner.issues import refusal
from planner.languages.krl import sentences as krl_sentences
from planner.languages.writing.layout import (
    POSITION_DECIMALS,
    TRACK_COLUMN,
    Outer,
    Track,
    number,
    plain,
    short,
)
from planner.problem import OUTER_DECIMALS, KrlDialect

NAME_LENGTH: Final = 24
"""Longest name in KRL [characters]."""
ANGLE_DECIMALS: Final = 5
"""Decimals of A, B, C of targets in degrees."""
_FRAME_ANGLE_DECIMALS: Final = 6
"""Decimals of the angles of a FRAME in degrees."""
_POLE_COSINE: Final = 1e-7
"""Below this cosine of B, A and C turn about one axis, and C is 0."""
_OUTER_AXES: Final = 6
"""External axes of a structure, E1 to E6."""

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
        raise refusal("post.name", message, hint="a letter first, no reserved word")
    return out


def comment(text: str) -> list[str]:
    """Comment lines of plain text, wrapped."""
    return [f"; {line}" for line in textwrap.wrap(plain(text), 100)]


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


def e6pos(
    position: FloatArray, angles: FloatArray, status: int, turn: int, station: Outer | None = None
) -> str:
    """An E6POS of a position (3,) [mm] and angles (3,) [deg] as targets are written, external axes at
    ``station``."""
    values = [*(number(v, 4) for v in position), *(number(v, ANGLE_DECIMALS) for v in angles)]
    fields = dict(zip("XYZABC", values, strict=True)) | {"S": str(status), "T": str(turn)}
    return aggregate(fields | _all_outer(station))


def e6axis(degrees: FloatArray, station: Outer | None = None) -> str:
    """An E6AXIS of the controller's joint values (6,) [deg], external axes at ``station``."""
    fields = {f"A{i}": number(v, 6) for i, v in enumerate(degrees, 1)}
    return aggregate(fields | _all_outer(station))


def _all_outer(station: Outer | None) -> dict[str, str]:
    """E1 to E6 [mm or deg] at a station; axes that are not there are 0."""
    values = dict(station or ())
    columns = range(_OUTER_AXES)
    return {f"E{i + 1}": number(values[i], OUTER_DECIMALS) if i in values else "0.0" for i in columns}


def outer(station: Outer | None) -> str:
    """What a target in place has behind its pose: the external axes that the program moves."""
    return "".join(f",E{column + 1} {number(value, OUTER_DECIMALS)}" for column, value in station or ())


def ridden(station: Outer | None, value: float) -> Outer:
    """A station with another value [mm] of the track."""
    return tuple({**dict(station or ()), TRACK_COLUMN: value}.items())


def aggregate(fields: Mapping[str, str]) -> str:
    """``{X 1.0,Y 2.0}``"""
    return "{" + ",".join(f"{key} {value}" for key, value in fields.items()) + "}"


KRC2_FOOT: Final = "Arm {arm}: $ROBROOT is off zero by tm_shift mm, tm_turn deg."
"""As `planner.languages.krl.sentences.FOOT`, where a message has no parameters."""
KRC2_FOOT_RIDES: Final = "Arm {arm}: $ROBROOT_C is off track by tm_shift mm, tm_turn deg."
"""The same of `FOOT_RIDES`."""
EXTERNAL_REFUSAL: Final = (
    "In automatic external a PLC would answer. Take another mode of operation, then Start."
)
"""Shown where a question would be asked in automatic external."""
YES, NO, NEXT, READ = "Yes", "No", "Next", "Read"
"""Keys of dialogs; the first key of each goes on."""
TEXT_LENGTH: Final = 80
"""Characters of a message's text."""
ALONG_DECIMALS: Final = 6
"""Decimals of a track's direction: some 0.005 mm over 10 m."""
FOOT_SHIFT, FOOT_TURN = "0.1", "0.02"
"""How far the robot's foot may be off zero: [mm], [deg]."""

AXIS_AWAY: Final = {"mm": "1.0", "deg": "0.1"}
"""How far an external axis may be off home before the first move, by the unit of its values."""

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


def ended(text: str, dialect: KrlDialect) -> list[str]:
    """The program says why, on the panel (krc4) or where it stands, and never goes on."""
    shown = comment(text)
    if dialect == "krc4":
        shown = [_message(text, 5), "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)"]
    return [*shown, "LOOP", "HALT", "ENDLOOP"]


def robroot_check(arm: str, dialect: KrlDialect, along: Mapping[int, FloatArray] | None = None) -> list[str]:
    """The program halts, whatever is started, until ``$ROBROOT`` is zero: by the length of its way, and by
    the sum of its angles, which no turn exceeds.

    ``along`` {column: (3,)}: directions in ``$WORLD`` in which external axes take the arm. There ``$ROBROOT``
    counts for nothing, and ``$ROBROOT_C`` is where the foot is (KR C2 machine data, 2.1.9 $ERSYSROOT): it has
    to be what the values make of these directions, by the sum of what is off along the axes of ``$WORLD``.
    """
    root = "$ROBROOT_C" if along else "$ROBROOT"
    turned = f"tm_turn={'+'.join(f'ABS({root}.{a})' for a in 'ABC')}"
    if not along:
        squares = "+".join(f"{root}.{axis}*{root}.{axis}" for axis in "XYZ")
        shifts = [f"tm_shift=SQRT({squares})"]
    else:
        off = []
        for row, axis in enumerate("XYZ"):
            parts = {column: round(float(way[row]), ALONG_DECIMALS) for column, way in along.items()}
            taken = "".join(
                f"{'+' if part < 0.0 else '-'}{abs(part):.{ALONG_DECIMALS}f}*$AXIS_ACT.E{column + 1}"
                for column, part in sorted(parts.items())
            )
            off.append(f"ABS({root}.{axis}{taken})")
        shifts = [f"tm_shift={off[0]}", *(f"tm_shift=tm_shift+{one}" for one in off[1:])]
    looked = [*shifts, turned]
    names = (krl_sentences.FOOT_RIDES if along else krl_sentences.FOOT).filled(arm=arm)
    if dialect == "krc2":
        shown = comment((KRC2_FOOT_RIDES if along else KRC2_FOOT).format(arm=arm))
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


def axis_check(axis: tuple[str, str], column: int, home: float, dialect: KrlDialect) -> list[str]:
    """The program never goes on where an external axis, number ``column`` [from 0], is off its ``home`` [mm
    or deg]; ``axis``: its name, and the unit of its values."""
    unit, sign = axis
    wanted = number(home, OUTER_DECIMALS)
    off = f"{'+' if wanted.startswith('-') else '-'}{wanted.removeprefix('-')}"
    text = krl_sentences.KRL_AXIS_AWAY.filled(unit=unit, sign=sign, home=wanted)
    shown = comment(text.replace("%1", "tm_shift"))
    if dialect == "krc4":
        shown = [
            "tm_par[1].Par_Type=#VALUE",
            "tm_par[1].Par_Real=tm_shift",
            _message(text, 6),
            "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
        ]
    most = AXIS_AWAY[sign]
    looked = f"tm_shift=ABS($AXIS_ACT.E{column + 1}{off})"
    return [looked, f"IF tm_shift>{most} THEN", *shown, "LOOP", "HALT", "ENDLOOP", "ENDIF"]


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
        raise refusal("post.name", what, hint=hint)
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


LED_BY_WAY_MM: Final = 0.01
"""Least way [mm] of a move whose speed along it sets the time."""
LEAST_SPEED: Final = 1e-4
"""Least $VEL.CP [m/s]."""
LEAST_MOVE_TIME: Final = 6e-3
"""No controller plans a move in less [s]."""
LEAST_TURN_RATE: Final = 0.1
"""Least $VEL.ORI [deg/s]."""
FREE_TURN_RATE: Final = 200.0
"""$VEL.ORI [deg/s] of moves whose way sets the time."""
SPEED_DECIMALS: Final = 8
"""Decimals of $VEL.CP in m/s."""
TURN_DECIMALS: Final = 5
"""Decimals of $VEL.ORI1 and $VEL.ORI2 in deg/s."""
APPROXIMATION_DISTANCES: Final = (15.0, 10.0, 7.0, 5.0, 3.0, 2.0, 1.5, 1.0, *FINE_ZONES)
"""$APO.CDIS [mm]."""
APPROXIMATION_ANGLES: Final = (1.0, *FINE_ZONES)
"""$APO.CORI [deg]."""
FREE_ANGLE: Final = 180.0
"""$APO.CORI [deg] of corners that $APO.CDIS alone rounds."""
_MODAL: Final = ("$VEL.CP", "$VEL.ORI1", "$VEL.ORI2", "$APO.CDIS", "$APO.CORI")
"""Variables that each move may set anew, in this order."""


@dataclasses.dataclass(frozen=True)
class Rows:
    """M moves as KRL has them, all as written.

    ``position`` (M, 3) [mm], ``angles`` (M, 3) [deg]; ``way`` (M,) [mm] and ``turn`` (M,) [rad] from the pose
    before; ``duration`` (M,) [s] planned; ``speed`` (M,) [m/s] and ``turning`` (M,) [deg/s] allowed;
    ``distance`` (M,) [mm] and ``angle`` (M,) [deg] of the corners; ``stop``, ``still`` (M,): the move ends in
    an exact stop, goes nowhere.
    """

    position: FloatArray
    angles: FloatArray
    way: FloatArray
    turn: FloatArray
    duration: FloatArray
    speed: FloatArray
    turning: FloatArray
    distance: FloatArray
    angle: FloatArray
    stop: BoolArray
    still: BoolArray


def written(pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (..., 3) [mm] and A, B, C (..., 3) [deg] of poses (..., 4, 4) [m], rounded as written."""
    position = np.round(1e3 * pose[..., :3, 3], POSITION_DECIMALS) + 0.0
    return position, np.round(abc(pose[..., :3, :3]), ANGLE_DECIMALS) + 0.0


def rows(track: Track, stop: BoolArray, start: tuple[FloatArray, FloatArray]) -> Rows:
    """The moves of a track; ``start``: position (3,) [mm] and angles (3,) [deg] before them, as written."""
    angles = np.round(abc(from_quaternion(track.quaternion)), ANGLE_DECIMALS) + 0.0
    position, angles = np.concatenate([start[0][None], track.position]), np.vstack([start[1], angles])
    _settle(position, angles)
    way = np.linalg.norm(np.diff(position, axis=0), axis=1)
    turn = _turns(angles)
    still = np.all(np.diff(position, axis=0) == 0.0, axis=1) & (turn == 0.0)
    stop = stop | still | np.append(still[1:], False)
    wanted = 1e-3 * way / track.duration
    led = (way >= LED_BY_WAY_MM) & (wanted >= LEAST_SPEED)
    turning = _down(np.rad2deg(turn) / (np.sqrt(2.0) * track.duration), TURN_DECIMALS)
    distance, angle = _corners(track)
    return Rows(
        position=position[1:],
        angles=angles[1:],
        way=way,
        turn=turn,
        duration=track.duration,
        speed=np.maximum(_down(wanted, SPEED_DECIMALS), LEAST_SPEED),
        turning=np.where(led, FREE_TURN_RATE, np.maximum(turning, LEAST_TURN_RATE)),
        distance=distance,
        angle=angle,
        stop=stop,
        still=still,
    )


def settled(position: FloatArray, quaternion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 3) [mm] and quaternions (N, 4) with those that KRL has as the place before as that one:
    a move between them would go nowhere."""
    at, angles = position.copy(), np.round(abc(from_quaternion(quaternion)), ANGLE_DECIMALS) + 0.0
    _settle(at, angles)
    out = quaternion.copy()
    for row in np.flatnonzero((np.diff(np.hstack([at, angles]), axis=0) == 0.0).all(axis=1)).tolist():
        out[row + 1] = out[row]
    return at, out


def _settle(position: FloatArray, angles: FloatArray) -> None:
    """Places that are no farther from the one before than the least speed goes in the least time of a move
    are that one, and so are poses that are no farther turned, either."""
    # both turning speeds of a path run together, so that a turn may take but 0.7 of what one alone takes
    near, alike = 1e3 * LEAST_SPEED * LEAST_MOVE_TIME, 2.0 * LEAST_TURN_RATE * LEAST_MOVE_TIME
    # the one before may have been put back by as much
    for row in np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1) < 2.0 * near).tolist():
        far, turned = (np.abs(values[row + 1] - values[row]).max() for values in (position, angles))
        if far < near:
            position[row + 1] = position[row]
            angles[row + 1] = angles[row] if turned < alike else angles[row + 1]


@dataclasses.dataclass(frozen=True)
class Lines:
    """The text of M moves: ``move`` without settings, ``settings`` that change before each one, each a line
    with its end, and ``values`` (M, 5) in force then."""

    move: list[str]
    settings: list[str]
    values: FloatArray

    def sizes(self) -> IntArray:
        """Characters (M,) of each move with its settings; ends of lines count twice."""
        pairs = zip(self.settings, self.move, strict=True)
        return np.array(
            [len(a) + a.count("\n") + len(b) + b.count("\n") + 2 for a, b in pairs], dtype=np.int64
        )

    def of(self, row: int, fresh: bool) -> list[str]:
        """The lines of a move; ``fresh``: with all settings, for the first one of a file."""
        head = _settings(self.values[row].tolist()) if fresh else self.settings[row]
        return [*head.splitlines(), *self.move[row].splitlines()]

    def replaced(self, move: list[str], values: FloatArray) -> "Lines":
        """With other text for the moves, which may have several lines, and other values in force."""
        return Lines(move, _changes(values), values)


def lines(
    moves: Rows, dialect: KrlDialect, station: Outer | None = None, along: FloatArray | None = None
) -> Lines:
    """The text of all moves, external axes at ``station``; ``along`` (M,) [mm]: values of a track that goes
    along."""
    axes = [outer(station)] * len(moves.stop)
    if along is not None:
        axes = [outer(ridden(station, value)) for value in along.tolist()]
    word = "SLIN" if dialect == "krc4" else "LIN"
    values = _modal(moves)
    settings = _changes(values)
    poses = zip(moves.position.tolist(), moves.angles.tolist(), axes, _ends(moves, dialect), strict=True)
    move = [
        f"{word} {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}{stands}}}{end}"
        for (x, y, z), (a, b, c), stands, end in poses
    ]
    for row in np.flatnonzero(moves.still).tolist():
        move[row] = f"WAIT SEC {short(float(moves.duration[row]), 5)}"
    return Lines(move, settings, values)


def _changes(values: FloatArray) -> list[str]:
    """The settings that change before each of M moves, given the values (M, 5) in force."""
    changed = np.diff(values, axis=0, prepend=np.nan) != 0.0
    return [
        _settings(row, new) if some else ""
        for row, new, some in zip(
            values.tolist(), changed.tolist(), changed.any(axis=1).tolist(), strict=True
        )
    ]


def _modal(moves: Rows) -> FloatArray:
    """(M, 5) values in force at each move; where nothing moves or nothing is rounded those before stay."""
    table = np.stack([moves.speed, moves.turning, moves.turning, moves.distance, moves.angle], axis=1)
    keep = np.stack([moves.still] * 3 + [moves.stop] * 2, axis=1)
    source = np.where(keep, 0, np.arange(len(table))[:, None])
    latest = np.maximum.accumulate(source, axis=0) if len(table) else source
    return np.take_along_axis(table, latest, axis=0)


def _settings(values: Sequence[float], new: Sequence[bool] = (True,) * len(_MODAL)) -> str:
    """Lines, each with its end, that set those of the values that are new."""
    decimals = (SPEED_DECIMALS, TURN_DECIMALS, TURN_DECIMALS, 3, 3)
    return "".join(
        f"{word}={_real(value, digits)}\n"
        for word, value, changed, digits in zip(_MODAL, values, new, decimals, strict=True)
        if changed
    )


def _real(value: float, decimals: int) -> str:
    text = short(value, decimals)
    return text if "." in text else f"{text}.0"


def _ends(moves: Rows, dialect: KrlDialect) -> list[str]:
    """The end word of each move, with a blank before it."""
    by_way = np.where(moves.angle == FREE_ANGLE, " C_DIS", " C_ORI")
    word = np.full(len(moves.stop), " C_SPL") if dialect == "krc4" else by_way
    return [str(end) for end in np.where(moves.stop, "", word)]


def _corners(track: Track) -> tuple[FloatArray, FloatArray]:
    """Distances (M,) [mm] and angles (M,) [deg] that the corners may take."""
    turning = track.reach <= 0.0  # also where a move of some micrometres turns nothing
    distance = _largest(APPROXIMATION_DISTANCES, track.reach)
    angle = _largest(APPROXIMATION_ANGLES, np.rad2deg(track.reach_turn))
    return np.where(turning, APPROXIMATION_DISTANCES[-1], distance), np.where(turning, angle, FREE_ANGLE)


def _largest(sizes: Sequence[float], room: FloatArray) -> FloatArray:
    """(M,) the largest of the descending sizes within the room, or the smallest one."""
    index: IntArray = np.searchsorted(-np.array(sizes), -room - 1e-9)
    return np.asarray(np.array(sizes)[np.minimum(index, len(sizes) - 1)])


def _turns(angles: FloatArray) -> FloatArray:
    """Angles (M,) [rad] between M + 1 orientations A, B, C (M + 1, 3) [deg].

    By the chord of the matrices, |R1 - R0| = 2 sqrt(2) sin(w / 2) in the Frobenius norm: exact also where the
    turn is small. Equal angles turn by exactly 0.
    """
    r = rotation(angles)
    chord = np.linalg.norm(np.diff(r, axis=0), axis=(1, 2)) / (2.0 * np.sqrt(2.0))
    return np.asarray(2.0 * np.arcsin(np.minimum(chord, 1.0)))


def _down(value: FloatArray, decimals: int) -> FloatArray:
    """Rounded down to so many decimals."""
    return np.asarray(np.floor(value * 10.0**decimals) / 10.0**decimals)
