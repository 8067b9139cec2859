"""Formats KRL: numbers, names, aggregates, straight moves, and panel output.

Questions are dialogs in krc4, and comments with HALT in krc2. HALT alone is not a confirmation: in automatic
external a PLC that pulses its start signal resumes after it. Programs of krc2 therefore refuse that mode.
Dialogs are answered at the panel in every mode.

**Straight moves** of an operation are formatted together (`KrlMoves`, `move_text`): poses, speeds, corners,
and their text. KRL states no times: the speeds of a move follow from its planned time, rounded down.
"""

import dataclasses
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, from_quaternion
from planner.geometry.corner_rounding import FINE_ZONE_SIZES
from planner.issues import issue_error
from planner.languages.krl import sentences as krl_sentences
from planner.languages.writing.layout import (
    POSITION_DECIMALS,
    TRACK_COLUMN,
    ExternalAxisValues,
    MoveTable,
    format_fixed,
    format_short,
    to_ascii,
)
from planner.problem import EXTERNAL_AXIS_DECIMALS, KrlDialect

MAX_NAME_LENGTH: Final = 24
"""Maximum length of a KRL name [characters]."""
ANGLE_DECIMALS: Final = 5
"""Decimals of A, B, C of targets in degrees."""
_FRAME_ANGLE_DECIMALS: Final = 6
"""Decimals of the angles of a FRAME in degrees."""
_POLE_COSINE: Final = 1e-7
"""Cosine of B below which A and C rotate about the same axis, so that C is set to 0."""
_EXTERNAL_AXIS_COUNT: Final = 6
"""Number of external axes in an aggregate, E1 to E6."""

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
"""Words that cannot be names."""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words of the language, components of its structures, names that every controller has, and our variables."""


def identifier(text: str, length: int = MAX_NAME_LENGTH) -> str:
    """Return a lower-case name made from text: letters, digits and single underscores, with a letter first.

    Args:
        text: The text.
        length: Maximum length; longer names are cut.

    Raises:
        TandemError: ``post.name`` if the result is not a valid KRL name.
    """
    out = re.sub(r"[^a-z0-9]+", "_", to_ascii(text).lower()).strip("_")[:length].rstrip("_")
    if not re.match(r"[a-z]", out) or out in RESERVED:
        message = f"{text!r} gives no valid KRL name (got {out!r})"
        raise issue_error("post.name", message, hint="a letter first, no reserved word")
    return out


def comment(text: str) -> list[str]:
    """Return a text as comment lines, wrapped and in ASCII."""
    return [f"; {line}" for line in textwrap.wrap(to_ascii(text), 100)]


def abc(rotation: FloatArray) -> FloatArray:
    """Return KUKA's A, B, C (..., 3) [deg] of rotations R = Rz(A) Ry(B) Rx(C), (..., 3, 3).

    If B is +-90, A and C rotate about the same axis, and C is set to 0.
    """
    r = np.asarray(rotation, dtype=np.float64)
    cosine_of_b = np.hypot(r[..., 0, 0], r[..., 1, 0])
    pole = cosine_of_b < _POLE_COSINE
    a = np.where(pole, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    b = np.arctan2(-r[..., 2, 0], cosine_of_b)
    c = np.where(pole, 0.0, np.arctan2(r[..., 2, 1], r[..., 2, 2]))
    return np.asarray(np.rad2deg(np.stack([a, b, c], axis=-1)))


def rotation(degrees: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) of KUKA's A, B, C (..., 3) [deg]."""
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    (ca, cb, cc), (sa, sb, sc) = np.moveaxis(cos, -1, 0), np.moveaxis(sin, -1, 0)
    matrix = [
        [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
        [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
        [-sb, cb * sc, cb * cc],
    ]
    return np.stack([np.stack(row, axis=-1) for row in matrix], axis=-2)


def frame(pose: FloatArray, decimals: int = 4) -> str:
    """Format a FRAME: X, Y, Z [mm] and A, B, C [deg], the angles with 6 decimals.

    Args:
        pose: The pose, (4, 4) [m].
        decimals: Decimals of the position in mm.
    """
    position = [format_fixed(1e3 * v, decimals) for v in pose[:3, 3]]
    angles = [format_fixed(v, _FRAME_ANGLE_DECIMALS) for v in abc(pose[:3, :3])]
    return aggregate(dict(zip("XYZABC", [*position, *angles], strict=True)))


def e6pos(
    position: FloatArray,
    angles: FloatArray,
    status: int,
    turn: int,
    station: ExternalAxisValues | None = None,
) -> str:
    """Format an E6POS: a pose with Status, Turn and all external axes.

    Args:
        position: Position, rounded as in targets, (3,) [mm].
        angles: A, B, C, (3,) [deg].
        status: Status S.
        turn: Turn T.
        station: Values of the external axes, or None if the cell has none.
    """
    values = [*(format_fixed(v, 4) for v in position), *(format_fixed(v, ANGLE_DECIMALS) for v in angles)]
    fields = dict(zip("XYZABC", values, strict=True)) | {"S": str(status), "T": str(turn)}
    return aggregate(fields | _all_external_axes(station))


def e6axis(degrees: FloatArray, station: ExternalAxisValues | None = None) -> str:
    """Format an E6AXIS: joint values and all external axes.

    Args:
        degrees: Joint values as the controller counts them, (6,) [deg].
        station: Values of the external axes, or None if the cell has none.
    """
    fields = {f"A{i}": format_fixed(v, 6) for i, v in enumerate(degrees, 1)}
    return aggregate(fields | _all_external_axes(station))


def _all_external_axes(station: ExternalAxisValues | None) -> dict[str, str]:
    """Return E1 to E6 [mm or deg] at a station as text by name; unused axes are 0."""
    values = dict(station or ())
    columns = range(_EXTERNAL_AXIS_COUNT)
    return {
        f"E{i + 1}": format_fixed(values[i], EXTERNAL_AXIS_DECIMALS) if i in values else "0.0"
        for i in columns
    }


def stated_external_axes(station: ExternalAxisValues | None) -> str:
    """Return the text of the external axes after the pose of a target: of those that the program moves."""
    return "".join(
        f",E{column + 1} {format_fixed(value, EXTERNAL_AXIS_DECIMALS)}" for column, value in station or ()
    )


def with_track_position(station: ExternalAxisValues | None, value: float) -> ExternalAxisValues:
    """Return a station in which the track has another value.

    Args:
        station: Values of the external axes, or None.
        value: Value of the track [mm].
    """
    return tuple({**dict(station or ()), TRACK_COLUMN: value}.items())


def aggregate(fields: Mapping[str, str]) -> str:
    """Format an aggregate, such as ``{X 1.0,Y 2.0}``."""
    return "{" + ",".join(f"{key} {value}" for key, value in fields.items()) + "}"


KRC2_ROBROOT_DEVIATION: Final = "Arm {arm}: $ROBROOT is off zero by tm_shift mm, tm_turn deg."
"""`planner.languages.krl.sentences.ROBROOT_DEVIATION` for krc2, whose messages have no parameters."""
KRC2_ROBROOT_TRACK_DEVIATION: Final = "Arm {arm}: $ROBROOT_C is off track by tm_shift mm, tm_turn deg."
"""`planner.languages.krl.sentences.ROBROOT_TRACK_DEVIATION` for krc2, whose messages have no parameters."""
EXTERNAL_MODE_REFUSAL: Final = (
    "In automatic external a PLC would answer. Select another mode of operation, then Start."
)
"""Shown instead of a question in automatic external."""
YES, NO, NEXT, READ = "Yes", "No", "Next", "Read"
"""Keys of dialogs; the program continues after the first key of each."""
MAX_TEXT_LENGTH: Final = 80
"""Maximum length of a message's text [characters]."""
DIRECTION_DECIMALS: Final = 6
"""Decimals of a track's direction: about 0.005 mm over 10 m."""
ROBROOT_POSITION_TOLERANCE_MM, ROBROOT_ROTATION_TOLERANCE_DEG = "0.1", "0.02"
"""Tolerance of the robot's foot: distance [mm] and rotation [deg] from zero."""
AXIS_HOME_TOLERANCE: Final = {"mm": "1.0", "deg": "0.1"}
"""Tolerance of an external axis at home before the first move, by the unit of its values."""

STOP_INTERRUPT: Final = ("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )", "INTERRUPT ON 3")
"""Statements that enable the stop reactions of IR_STOPM.src, as in every program from KUKA's template."""
EXT_BAS: Final = "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
"""Declaration of the controller's BAS."""
_ROBROOT_DECLARATION: Final = "DECL REAL tm_shift,tm_turn"
"""Variables that `KRC2_ROBROOT_DEVIATION` shows."""
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
"""Maximum length of a comment line [characters]."""


def declarations(dialect: KrlDialect) -> list[str]:
    """Return the declarations of the variables of a main program."""
    return [*(_MESSAGE_DECLARATIONS if dialect == "krc4" else ()), _ROBROOT_DECLARATION]


def message_setup(dialect: KrlDialect) -> list[str]:
    """Return the statements that precede the first message or question of a program.

    In krc4 they set the options of messages, and clear the parameters and keys. In krc2 they refuse automatic
    external, the mode in which a PLC starts programs.
    """
    if dialect == "krc2":
        return _refuse_external_mode()
    return [
        "tm_opt={VL_Stop TRUE,Clear_P_Reset TRUE,Clear_P_SAW TRUE,Log_To_DB FALSE}",
        *(f"tm_par[{i}]={{Par_Type #EMPTY}}" for i in range(1, 4)),
        *(f"tm_key[{i}]={{SK_type #EMPTY}}" for i in range(3, 8)),
    ]


def question_lines(text: str, dialect: KrlDialect) -> list[str]:
    """Return a question: the program continues if the operator answers yes, and asks again otherwise.

    krc4 shows the parts of the text in dialogs: the last one has the keys Yes and No, all others the key
    Next. krc2 has marked comments and HALT, and then refuses automatic external, in which a PLC could answer.

    Args:
        text: The question.
        dialect: KRL dialect.
    """
    if dialect == "krc2":
        return [*_marked_comment("?", text), "HALT", *_refuse_external_mode()]
    *first, last = _message_parts(text)
    return [*(line for part in first for line in _dialog(part, NEXT)), *_dialog(last, YES, NO)]


def message_lines(text: str, dialect: KrlDialect, before_question: bool = False) -> list[str]:
    """Return the statements that show a message.

    Args:
        text: The message.
        dialect: KRL dialect.
        before_question: Whether a question follows whose answer depends on the message. The operator must
            then confirm that he has read it (krc4: dialogs with the key Read).
    """
    if dialect == "krc2":
        return _marked_comment("*", text)
    parts = _message_parts(text)
    if before_question:
        return [line for part in parts for line in _dialog(part, READ)]
    shown = ([_message(part, 2), "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)"] for part in parts)
    return [line for lines in shown for line in lines]


def with_state(text: str, lines: list[str], dialect: KrlDialect) -> list[str]:
    """Return statements during which the panel shows a text (krc4); in krc2 the statements alone.

    Args:
        text: The text.
        lines: The statements.
        dialect: KRL dialect.
    """
    if dialect == "krc2":
        return lines
    (part,) = _message_parts(text)
    shown = [_message(part, 3), "tm_state=Set_KrlMsg(#STATE,tm_msg,tm_par[],tm_opt)"]
    return [*shown, *lines, "tm_gone=Clear_KrlMsg(tm_state)"]


def end_program(text: str, dialect: KrlDialect) -> list[str]:
    """Return statements that end the program: they show a reason and then halt again after every start.

    The reason is a message on the panel in krc4 and a comment in krc2.

    Args:
        text: The reason.
        dialect: KRL dialect.
    """
    shown = comment(text)
    if dialect == "krc4":
        shown = [_message(text, 5), "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)"]
    return [*shown, "LOOP", "HALT", "ENDLOOP"]


def robroot_check(
    arm: str, dialect: KrlDialect, axis_directions: Mapping[int, FloatArray] | None = None
) -> list[str]:
    """Return statements that halt, again after every start, until the robot's foot is where the plan has it.

    ``$ROBROOT`` must be zero. The program compares the length of its position, and the sum of its angles,
    which bounds every rotation. For an arm on external axes ``$ROBROOT`` has no effect, and ``$ROBROOT_C`` is
    the pose of the foot (KR C2 machine data, 2.1.9 $ERSYSROOT). Its position must equal the axis values times
    their directions. The program compares the sum of the deviations along the axes of ``$WORLD``.

    Args:
        arm: Name of the arm.
        dialect: KRL dialect.
        axis_directions: Directions in ``$WORLD`` in which external axes move the arm, {column: (3,)}.
    """
    root = "$ROBROOT_C" if axis_directions else "$ROBROOT"
    rotation_line = f"tm_turn={'+'.join(f'ABS({root}.{a})' for a in 'ABC')}"
    if not axis_directions:
        squares = "+".join(f"{root}.{axis}*{root}.{axis}" for axis in "XYZ")
        shift_lines = [f"tm_shift=SQRT({squares})"]
    else:
        deviations = []
        for row, axis in enumerate("XYZ"):
            parts = {
                column: round(float(direction[row]), DIRECTION_DECIMALS)
                for column, direction in axis_directions.items()
            }
            axis_terms = "".join(
                f"{'+' if part < 0.0 else '-'}{abs(part):.{DIRECTION_DECIMALS}f}*$AXIS_ACT.E{column + 1}"
                for column, part in sorted(parts.items())
            )
            deviations.append(f"ABS({root}.{axis}{axis_terms})")
        shift_lines = [
            f"tm_shift={deviations[0]}",
            *(f"tm_shift=tm_shift+{deviation}" for deviation in deviations[1:]),
        ]
    deviation_lines = [*shift_lines, rotation_line]
    text = (
        krl_sentences.ROBROOT_TRACK_DEVIATION if axis_directions else krl_sentences.ROBROOT_DEVIATION
    ).format(arm=arm)
    if dialect == "krc2":
        shown = comment(
            (KRC2_ROBROOT_TRACK_DEVIATION if axis_directions else KRC2_ROBROOT_DEVIATION).format(arm=arm)
        )
        parameter_reset: list[str] = []
    else:
        shown = [
            "tm_par[1].Par_Type=#VALUE",
            "tm_par[1].Par_Real=tm_shift",
            "tm_par[2].Par_Type=#VALUE",
            "tm_par[2].Par_Real=tm_turn",
            _message(text, 4),
            "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
        ]
        parameter_reset = ["tm_par[1].Par_Type=#EMPTY", "tm_par[2].Par_Type=#EMPTY"]
    loop = f"WHILE (tm_shift>{ROBROOT_POSITION_TOLERANCE_MM}) OR (tm_turn>{ROBROOT_ROTATION_TOLERANCE_DEG})"
    return [*deviation_lines, loop, *shown, "HALT", *deviation_lines, "ENDWHILE", *parameter_reset]


def axis_check(axis: tuple[str, str], column: int, home: float, dialect: KrlDialect) -> list[str]:
    """Return statements that stop the program for good if an external axis is not at home.

    Args:
        axis: Name of the axis, and unit of its values: "mm" or "deg".
        column: Number of the axis, from 0.
        home: Its home [mm or deg].
        dialect: KRL dialect.
    """
    name, unit = axis
    home_text = format_fixed(home, EXTERNAL_AXIS_DECIMALS)
    offset = f"{'+' if home_text.startswith('-') else '-'}{home_text.removeprefix('-')}"
    text = krl_sentences.KRL_AXIS_NOT_HOME.format(unit=name, sign=unit, home=home_text)
    shown = comment(text.replace("%1", "tm_shift"))
    if dialect == "krc4":
        shown = [
            "tm_par[1].Par_Type=#VALUE",
            "tm_par[1].Par_Real=tm_shift",
            _message(text, 6),
            "tm_ticket=Set_KrlMsg(#NOTIFY,tm_msg,tm_par[],tm_opt)",
        ]
    tolerance = AXIS_HOME_TOLERANCE[unit]
    deviation_line = f"tm_shift=ABS($AXIS_ACT.E{column + 1}{offset})"
    return [deviation_line, f"IF tm_shift>{tolerance} THEN", *shown, "LOOP", "HALT", "ENDLOOP", "ENDIF"]


def _refuse_external_mode() -> list[str]:
    """Return statements that halt while the mode of operation is automatic external."""
    return ["WHILE $MODE_OP==#EX", *comment(EXTERNAL_MODE_REFUSAL), "HALT", "ENDWHILE"]


def _marked_comment(mark: str, text: str) -> list[str]:
    """Return a text as comment lines that the reader recognises by their mark: "?" or "*"."""
    return [
        f";{mark} {line}" for line in textwrap.wrap(to_ascii(text), _COMMENT_WIDTH, break_on_hyphens=False)
    ]


def _message_parts(text: str) -> list[str]:
    """Split a text at blanks into parts that fit into a message.

    Raises :class:`planner.issues.TandemError` (``post.name``) for texts that cannot be shown: long words,
    quotes, parameter marks.
    """
    ascii_text = to_ascii(text)
    longest_word = max(ascii_text.split(), key=len, default="")
    if len(longest_word) > MAX_TEXT_LENGTH or '"' in ascii_text or re.search(r"%\d", ascii_text):
        got = (
            f"{longest_word[:20]}... of {len(longest_word)} characters"
            if len(longest_word) > MAX_TEXT_LENGTH
            else repr(ascii_text)
        )
        message = f"the panel of a KUKA controller cannot show {got}"
        hint = f"give names of at most {MAX_TEXT_LENGTH} characters, without quotes and %"
        raise issue_error("post.name", message, hint=hint)
    return textwrap.wrap(ascii_text, MAX_TEXT_LENGTH, break_on_hyphens=False, break_long_words=False)


def _message(text: str, number: int) -> str:
    return f'tm_msg={{Modul[] "Tandem",Nr {number},Msg_txt[] "{text}"}}'


def _dialog(text: str, yes: str, no: str = "") -> list[str]:
    """Return a dialog that reappears until its first key is pressed, also if it cannot be shown."""
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


MIN_LINEAR_DISTANCE_MM: Final = 0.01
"""Minimum distance [mm] of a move whose TCP speed determines its time."""
MIN_SPEED_M_S: Final = 1e-4
"""Minimum $VEL.CP [m/s]."""
MIN_MOVE_TIME_S: Final = 6e-3
"""Minimum time in which a controller plans a move [s]."""
MIN_ROTATION_SPEED_DEG_S: Final = 0.1
"""Minimum $VEL.ORI [deg/s]."""
FREE_ROTATION_SPEED_DEG_S: Final = 200.0
"""$VEL.ORI [deg/s] of moves whose distance determines the time."""
SPEED_DECIMALS: Final = 8
"""Decimals of $VEL.CP in m/s."""
ROTATION_SPEED_DECIMALS: Final = 5
"""Decimals of $VEL.ORI1 and $VEL.ORI2 in deg/s."""
APPROXIMATION_DISTANCES: Final = (15.0, 10.0, 7.0, 5.0, 3.0, 2.0, 1.5, 1.0, *FINE_ZONE_SIZES)
"""Values of $APO.CDIS [mm]."""
APPROXIMATION_ANGLES: Final = (1.0, *FINE_ZONE_SIZES)
"""Values of $APO.CORI [deg]."""
FREE_APPROXIMATION_ANGLE_DEG: Final = 180.0
"""$APO.CORI [deg] of corners that only $APO.CDIS rounds."""
_MODAL_SETTINGS: Final = ("$VEL.CP", "$VEL.ORI1", "$VEL.ORI2", "$APO.CDIS", "$APO.CORI")
"""Variables that each move may set, in this order."""


@dataclasses.dataclass(frozen=True)
class KrlMoves:
    """M moves of an operation, with all values as KRL states them.

    Attributes:
        position: Positions of the targets in $BASE, (M, 3) [mm].
        angles: A, B, C of the targets, (M, 3) [deg].
        length: Distance from the previous pose, (M,) [mm].
        rotation: Rotation from the previous pose, (M,) [rad].
        duration: Planned time, (M,) [s].
        speed: Speed of the TCP, (M,) [m/s].
        rotation_speed: Rotation speed, (M,) [deg/s].
        distance: Approximation distance of the corner, (M,) [mm].
        angle: Approximation angle of the corner, (M,) [deg].
        stop: Whether the move ends in an exact stop, (M,).
        still: Whether the target equals the previous pose, so that the arm does not move, (M,).
    """

    position: FloatArray
    angles: FloatArray
    length: FloatArray
    rotation: FloatArray
    duration: FloatArray
    speed: FloatArray
    rotation_speed: FloatArray
    distance: FloatArray
    angle: FloatArray
    stop: BoolArray
    still: BoolArray


def rounded_pose(pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (..., 3) [mm] and A, B, C (..., 3) [deg] of poses (..., 4, 4) [m].

    They are rounded to the decimals with which targets are written.
    """
    position = np.round(1e3 * pose[..., :3, 3], POSITION_DECIMALS) + 0.0
    return position, np.round(abc(pose[..., :3, :3]), ANGLE_DECIMALS) + 0.0


def krl_moves(track: MoveTable, stop: BoolArray, start: tuple[FloatArray, FloatArray]) -> KrlMoves:
    """Return the moves of an operation, with speeds that take at least the planned time.

    If the TCP moves by at least ``MIN_LINEAR_DISTANCE_MM``, at ``MIN_SPEED_M_S`` or faster, the TCP speed
    determines the time of the move. Otherwise the rotation speed determines it. A move in which the arm
    stands still ends in a stop, and so does the move before it.

    Args:
        track: Targets of one operation, with their durations.
        stop: Which moves end in a stop, (M,).
        start: Position (3,) [mm] and angles (3,) [deg] before the first move, as written.
    """
    angles = np.round(abc(from_quaternion(track.quaternion)), ANGLE_DECIMALS) + 0.0
    position, angles = np.concatenate([start[0][None], track.position]), np.vstack([start[1], angles])
    _snap_in_place(position, angles)
    length = np.linalg.norm(np.diff(position, axis=0), axis=1)
    rotation_angle = _rotation_angles(angles)
    still = np.all(np.diff(position, axis=0) == 0.0, axis=1) & (rotation_angle == 0.0)
    stop = stop | still | np.append(still[1:], False)
    planned_speed = 1e-3 * length / track.duration
    is_linear = (length >= MIN_LINEAR_DISTANCE_MM) & (planned_speed >= MIN_SPEED_M_S)
    rotation_speed = _round_down(
        np.rad2deg(rotation_angle) / (np.sqrt(2.0) * track.duration), ROTATION_SPEED_DECIMALS
    )
    distance, angle = _corners(track)
    return KrlMoves(
        position=position[1:],
        angles=angles[1:],
        length=length,
        rotation=rotation_angle,
        duration=track.duration,
        speed=np.maximum(_round_down(planned_speed, SPEED_DECIMALS), MIN_SPEED_M_S),
        rotation_speed=np.where(
            is_linear, FREE_ROTATION_SPEED_DEG_S, np.maximum(rotation_speed, MIN_ROTATION_SPEED_DEG_S)
        ),
        distance=distance,
        angle=angle,
        stop=stop,
        still=still,
    )


def snap_poses(position: FloatArray, quaternion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and quaternions in which each pose that is too close to the previous one equals it.

    KRL cannot state a speed that is low enough for a move between such poses. An orientation is replaced only
    together with its position.

    Args:
        position: Positions, (N, 3) [mm].
        quaternion: Orientations, (N, 4).
    """
    snapped, angles = position.copy(), np.round(abc(from_quaternion(quaternion)), ANGLE_DECIMALS) + 0.0
    _snap_in_place(snapped, angles)
    out = quaternion.copy()
    for row in np.flatnonzero((np.diff(np.hstack([snapped, angles]), axis=0) == 0.0).all(axis=1)).tolist():
        out[row + 1] = out[row]
    return snapped, out


def _snap_in_place(position: FloatArray, angles: FloatArray) -> None:
    """Set positions (N, 3) [mm], and angles (N, 3) [deg], to the previous ones if the move is too short.

    The limit of a position is the distance that the minimum speed covers in the minimum time of a move. An
    orientation is set only together with the position, and has a corresponding limit.
    """
    position_tolerance = 1e3 * MIN_SPEED_M_S * MIN_MOVE_TIME_S
    # both rotation speeds of a path act together, so a rotation may take only 0.7 of the time of one alone
    angle_tolerance = 2.0 * MIN_ROTATION_SPEED_DEG_S * MIN_MOVE_TIME_S
    # the previous row may have been snapped back by as much, hence the factor 2
    for row in np.flatnonzero(
        np.abs(np.diff(position, axis=0)).max(axis=1) < 2.0 * position_tolerance
    ).tolist():
        distance, angle = (np.abs(values[row + 1] - values[row]).max() for values in (position, angles))
        if distance < position_tolerance:
            position[row + 1] = position[row]
            angles[row + 1] = angles[row] if angle < angle_tolerance else angles[row + 1]


@dataclasses.dataclass(frozen=True)
class MoveText:
    """KRL text of M moves with their settings.

    Attributes:
        move: Text of each move without settings.
        settings: Statements before each move for the settings that change there; "" if none changes.
        values: Values of the settings ``_MODAL_SETTINGS`` in force at each move, (M, 5).
    """

    move: list[str]
    settings: list[str]
    values: FloatArray

    def sizes(self) -> IntArray:
        """Return the size (M,) of each move with its settings [characters]; a line end counts as two."""
        settings_and_moves = zip(self.settings, self.move, strict=True)
        return np.array(
            [
                len(settings) + settings.count("\n") + len(move) + move.count("\n") + 2
                for settings, move in settings_and_moves
            ],
            dtype=np.int64,
        )

    def lines(self, row: int, fresh: bool) -> list[str]:
        """Return the lines of a move with the settings that it needs.

        Args:
            row: Index of the move.
            fresh: Whether to state all settings, as for the first move of a file.
        """
        head = _setting_lines(self.values[row].tolist()) if fresh else self.settings[row]
        return [*head.splitlines(), *self.move[row].splitlines()]

    def replaced(self, move: list[str], values: FloatArray) -> "MoveText":
        """Return the same moves with other text, perhaps of several lines for a move, and other settings.

        Args:
            move: Text of each move.
            values: Values of the settings in force at each move, (M, 5).
        """
        return MoveText(move, _setting_changes(values), values)


def move_text(
    moves: KrlMoves,
    dialect: KrlDialect,
    station: ExternalAxisValues | None = None,
    track_positions: FloatArray | None = None,
) -> MoveText:
    """Return the text of all moves as straight moves; a move in which the arm stands still is a WAIT SEC.

    Args:
        moves: The moves.
        dialect: KRL dialect.
        station: Values of the external axes, or None if the cell has none.
        track_positions: Values of a coordinated track at the targets, (M,) [mm], or None.
    """
    axes = [stated_external_axes(station)] * len(moves.stop)
    if track_positions is not None:
        axes = [
            stated_external_axes(with_track_position(station, value)) for value in track_positions.tolist()
        ]
    move_word = "SLIN" if dialect == "krc4" else "LIN"
    values = _values_in_force(moves)
    settings = _setting_changes(values)
    poses = zip(moves.position.tolist(), moves.angles.tolist(), axes, _end_words(moves, dialect), strict=True)
    move = [
        f"{move_word} {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}{external}}}{end}"
        for (x, y, z), (a, b, c), external, end in poses
    ]
    for row in np.flatnonzero(moves.still).tolist():
        move[row] = f"WAIT SEC {format_short(float(moves.duration[row]), 5)}"
    return MoveText(move, settings, values)


def _setting_changes(values: FloatArray) -> list[str]:
    """Return the statements for settings that change before each of M moves, given the values (M, 5)."""
    changed = np.diff(values, axis=0, prepend=np.nan) != 0.0
    return [
        _setting_lines(row, new) if any_new else ""
        for row, new, any_new in zip(
            values.tolist(), changed.tolist(), changed.any(axis=1).tolist(), strict=True
        )
    ]


def _values_in_force(moves: KrlMoves) -> FloatArray:
    """Return the values (M, 5) of the settings in force at each move.

    A move in which the arm stands still keeps the speeds of the move before it. A move that ends in a stop
    keeps the approximation of the move before it, because it has no corner. The values of the first move are
    its own.
    """
    table = np.stack(
        [moves.speed, moves.rotation_speed, moves.rotation_speed, moves.distance, moves.angle], axis=1
    )
    keep = np.stack([moves.still] * 3 + [moves.stop] * 2, axis=1)
    # for each value the index of the latest move, up to this one, that states it itself
    source = np.where(keep, 0, np.arange(len(table))[:, None])
    latest = np.maximum.accumulate(source, axis=0) if len(table) else source
    return np.take_along_axis(table, latest, axis=0)


def _setting_lines(values: Sequence[float], new: Sequence[bool] = (True,) * len(_MODAL_SETTINGS)) -> str:
    """Return the statements, each with a line end, that set some of the settings.

    Args:
        values: Values of ``_MODAL_SETTINGS``.
        new: Whether each of them changes and must be set.
    """
    decimals = (SPEED_DECIMALS, ROTATION_SPEED_DECIMALS, ROTATION_SPEED_DECIMALS, 3, 3)
    return "".join(
        f"{word}={_real(value, digits)}\n"
        for word, value, changed, digits in zip(_MODAL_SETTINGS, values, new, decimals, strict=True)
        if changed
    )


def _real(value: float, decimals: int) -> str:
    """Return a number with a decimal point, as KRL needs it for a REAL."""
    text = format_short(value, decimals)
    return text if "." in text else f"{text}.0"


def _end_words(moves: KrlMoves, dialect: KrlDialect) -> list[str]:
    """Return the word after each move for its corner, with a leading blank; "" for a stop."""
    krc2_word = np.where(moves.angle == FREE_APPROXIMATION_ANGLE_DEG, " C_DIS", " C_ORI")
    word = np.full(len(moves.stop), " C_SPL") if dialect == "krc4" else krc2_word
    return [str(end) for end in np.where(moves.stop, "", word)]


def _corners(track: MoveTable) -> tuple[FloatArray, FloatArray]:
    """Return the approximation distances (M,) [mm] and angles (M,) [deg] of the corners.

    If the TCP moves, the distance bounds the corner, and the angle has no effect. If the TCP does not move,
    the angle bounds the corner.
    """
    rotates_only = track.max_zone <= 0.0  # also for a move of some micrometres without rotation
    distance = _largest_fitting(APPROXIMATION_DISTANCES, track.max_zone)
    angle = _largest_fitting(APPROXIMATION_ANGLES, np.rad2deg(track.max_zone_rotation))
    return np.where(rotates_only, APPROXIMATION_DISTANCES[-1], distance), np.where(
        rotates_only, angle, FREE_APPROXIMATION_ANGLE_DEG
    )


def _largest_fitting(sizes: Sequence[float], available: FloatArray) -> FloatArray:
    """Return for each available size (M,) the largest of the descending ``sizes`` that fits into it.

    If none fits, it is the smallest one.
    """
    # the negative sizes ascend, as the search requires; 1e-9 is for rounding
    index: IntArray = np.searchsorted(-np.array(sizes), -available - 1e-9)
    return np.asarray(np.array(sizes)[np.minimum(index, len(sizes) - 1)])


def _rotation_angles(angles: FloatArray) -> FloatArray:
    """Return the angles (M,) [rad] between consecutive ones of M + 1 orientations A, B, C (M + 1, 3) [deg].

    They follow from the chord of the matrices, |R1 - R0| = 2 sqrt(2) sin(w / 2) in the Frobenius norm, which
    is also exact for small rotations. Equal orientations give exactly 0.
    """
    r = rotation(angles)
    chord = np.linalg.norm(np.diff(r, axis=0), axis=(1, 2)) / (2.0 * np.sqrt(2.0))
    return np.asarray(2.0 * np.arcsin(np.minimum(chord, 1.0)))


def _round_down(value: FloatArray, decimals: int) -> FloatArray:
    """Return the values rounded down to a number of decimals."""
    return np.asarray(np.floor(value * 10.0**decimals) / 10.0**decimals)
