"""Statements and declarations of KRL files as read, each with its line, and the words of the language.

The words are reserved names, and settings that a program may make, with their ranges. System variables and
their units (m/s, deg/s, mm, deg, percent): KUKA's expert manual as cited in public posts and grammars.
docs/krl.md says which of them were seen where.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

StatedAxisValues = tuple[tuple[int, float], ...]
"""External axes that a target states: pairs of column, from 0 (E1 to E6), and value [mm or deg].

Values are in single precision; axes that are not stated are left out.
"""


@dataclass(frozen=True, slots=True)
class KrlStatement:
    """A statement; `line` counts from 1 in its file."""

    line: int


@dataclass(frozen=True, slots=True)
class InitMotion(KrlStatement):
    """BAS(#INITMOV,0): resets all settings to the controller's values."""


@dataclass(frozen=True, slots=True)
class SettingStatement(KrlStatement):
    """A setting.

    Attributes:
        name: Lower-case name.
        value: A number, or a name or #word in lower case.
    """

    name: str
    value: float | str


@dataclass(frozen=True, slots=True)
class OutputStatement(KrlStatement):
    """Switches $OUT[`number`]."""

    number: int
    value: bool


@dataclass(frozen=True, slots=True)
class InputPoll(KrlStatement):
    """The guarded loop that waits for $IN[`number`] to be `value`; after `seconds` it halts, then repeats."""

    number: int
    value: bool
    seconds: float


@dataclass(frozen=True, slots=True)
class InputWait(KrlStatement):
    """The loop that waits for $IN[`number`] to be `value`, and ends the program on a timeout.

    Attributes:
        seconds: Timeout [s].
        outputs_off: Numbers of the outputs that it switches off on a timeout.
        text: Message that it shows on a timeout, "" for none.
    """

    number: int
    value: bool
    seconds: float
    outputs_off: frozenset[int]
    text: str


@dataclass(frozen=True, slots=True)
class PtpStatement(KrlStatement):
    """PTP to the target `name` of the data list, in lower case."""

    name: str


@dataclass(frozen=True, slots=True)
class LinearStatement(KrlStatement):
    """A straight move.

    Attributes:
        word: LIN or SLIN.
        target: X, Y, Z [mm], A, B, C [deg] in single precision.
        corner: C_DIS, C_ORI, C_SPL, or "" for an exact stop.
        outer: External axes that the target states.
    """

    word: str
    target: tuple[float, float, float, float, float, float]
    corner: str
    outer: StatedAxisValues = ()


@dataclass(frozen=True, slots=True)
class WaitSecStatement(KrlStatement):
    """WAIT SEC `seconds` [s]."""

    seconds: float


@dataclass(frozen=True, slots=True)
class HaltStatement(KrlStatement):
    """HALT."""


@dataclass(frozen=True, slots=True)
class StopInterrupt(KrlStatement):
    """The interrupt of stop messages is declared, or switched `on`."""

    on: bool


@dataclass(frozen=True, slots=True)
class RobrootCheck(KrlStatement):
    """The loop that halts while $ROBROOT is not zero.

    Attributes:
        shift: Tolerance of the position of $ROBROOT [mm].
        turn: Tolerance of the sum of its angles [deg].
        text: Message that it shows, "" for none.
        axis_directions: Directions in $WORLD of the external axes under the arm, by column from 0. If there
            are any, the program checks $ROBROOT_C less these directions times the axis values.
    """

    shift: float
    turn: float
    text: str
    axis_directions: tuple[tuple[int, tuple[float, float, float]], ...] = ()


@dataclass(frozen=True, slots=True)
class ExternalAxisCheck(KrlStatement):
    """The check that stops the program for good unless an external axis is at home.

    Attributes:
        column: Number of the axis, from 0.
        home: Its home [mm or deg].
        tolerance: Maximum distance from home [mm or deg].
        text: Message that it shows, "" for none.
    """

    column: int
    home: float
    tolerance: float
    text: str


@dataclass(frozen=True, slots=True)
class ExternalModeRefusal(KrlStatement):
    """The loop that halts while the mode of operation is automatic external."""


@dataclass(frozen=True, slots=True)
class MessageOptions(KrlStatement):
    """Sets the options of messages, without parameters and with no keys but the first two."""


@dataclass(frozen=True, slots=True)
class DialogStatement(KrlStatement):
    """The loop that shows a dialog until its first key is pressed.

    Attributes:
        text: The text.
        key: The first key: "yes" (beside No), "next" or "read".
    """

    text: str
    key: str


@dataclass(frozen=True, slots=True)
class MessageStatement(KrlStatement):
    """A message on the panel: a note, or a `state` that is shown until it is cleared."""

    text: str
    state: bool


@dataclass(frozen=True, slots=True)
class ClearState(KrlStatement):
    """Clears the message of a state."""


@dataclass(frozen=True, slots=True)
class CallStatement(KrlStatement):
    """A call of the subprogram `name`, in lower case."""

    name: str


@dataclass(frozen=True, slots=True)
class CommentStatement(KrlStatement):
    """A comment that the proof reads.

    Attributes:
        kind: "told" for a message to the operator, "question" for a line of a question before HALT, or
            "segment" for the start of a segment.
        text: The text, or the label of the segment.
    """

    kind: Literal["told", "question", "segment"]
    text: str


@dataclass(frozen=True, slots=True)
class SplinePoint(KrlStatement):
    """SPL in a spline block.

    Attributes:
        target: X, Y, Z [mm], A, B, C [deg].
        part: Fraction of the block's time that the move to this point takes, 0 to 1.
        outer: External axes that the target states.
    """

    target: tuple[float, float, float, float, float, float]
    part: float
    outer: StatedAxisValues = ()


@dataclass(frozen=True, slots=True)
class SplineStatement(KrlStatement):
    """A spline block, from SPLINE to ENDSPLINE.

    Attributes:
        points: Points of the block; a comment starts a segment with the point that follows it.
        seconds: Total time of the block [s].
    """

    points: tuple[SplinePoint | CommentStatement, ...]
    seconds: float

    @property
    def moves(self) -> int:
        """Number of points."""
        return sum(isinstance(point, SplinePoint) for point in self.points)


@dataclass(frozen=True, slots=True)
class KrlProgram:
    """A .src file.

    Attributes:
        file: Its path.
        name: Name as written after DEF.
        external: Names of the subprograms that it declares by EXT, in lower case.
        body: Its statements.
        variables: Its variables as (type, name), in lower case.
    """

    file: str
    name: str
    external: tuple[str, ...]
    body: tuple[KrlStatement, ...]
    variables: tuple[tuple[str, str], ...] = ()

    @property
    def moves(self) -> int:
        """Number of straight moves and points of spline blocks."""
        splines = sum(statement.moves for statement in self.body if isinstance(statement, SplineStatement))
        return splines + sum(isinstance(statement, LinearStatement) for statement in self.body)


@dataclass(frozen=True, slots=True)
class KrlDeclaration:
    """One declaration of a .dat file.

    Attributes:
        kind: Type: frame, load, e6pos, e6axis or char.
        name: Name as written.
        value: Value in SI units; of a char the text, or its length if it has no text yet.
    """

    line: int
    kind: str
    name: str
    value: Any


@dataclass(frozen=True, slots=True)
class DataList:
    """A .dat file. `name` is as written after DEFDAT; `items` are its declarations by lower-case name."""

    file: str
    name: str
    items: Mapping[str, KrlDeclaration]


MAX_NAME_LENGTH: Final = 24
"""Maximum length of a KRL name [characters]."""
MAX_LINE_LENGTH: Final = 200
"""Maximum length of a line that is read [characters]."""

_RESERVED_TEXT = """
and b_and b_exor b_not b_or bool brake c_dis c_ori c_ptp c_spl c_vel case channel char circ circ_rel const
continue ccontinue cwrite decl def default defdat defdt deffct delay distance do else end enddat endfct endfor
endif endloop endspline endswitch endwhile enum exit exor ext extfct fals false for frame global goto halt if
import int interrupt is joint lin lin_rel loop maximum minimum not or p path pos priority private ptp ptp_rel
public pulse real repeat resume return scirc sec signal slin spl spline sptp sref stop struc switch then
time_block to trigger true until wait when while with e6pos e6axis axis load load_data
tool_data base_data main bas ir_stopm krlmsg_t krlmsgpar_t krlmsgopt_t krlmsgdlgsk_t set_krlmsg set_krldlg
exists_krlmsg exists_krldlg clear_krlmsg tm_msg tm_par tm_opt tm_key tm_ticket tm_state tm_answer tm_gone
tm_shift tm_turn
"""
"""Words that cannot be names."""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words of the language, names of its routines and types, and our variables."""


class SettingRange(NamedTuple):
    """Allowed values of a setting, from `low` to `high`. ``whole``: integers only."""

    low: float
    high: float
    whole: bool = False


MOTION_SETTINGS: Final = {
    "$vel.cp": SettingRange(1e-6, 3.0),
    "$vel.ori1": SettingRange(0.01, 1000.0),
    "$vel.ori2": SettingRange(0.01, 1000.0),
    "$apo.cdis": SettingRange(1e-4, 1000.0),
    "$apo.cori": SettingRange(1e-4, 180.0),
}
"""Settings of files with moves; each such file makes all of them before its first move."""
AXIS_SPEEDS: Final = tuple(f"$vel_axis[{axis}]" for axis in range(1, 7))
"""Speeds of axes [%]."""
EXTERNAL_AXIS_SPEEDS: Final = tuple(f"$vel_extax[{axis}]" for axis in range(1, 7))
"""Speeds of external axes [%]: integers, relative to the limits of the machine data."""
NUMBER_SETTINGS: Final = {
    **MOTION_SETTINGS,
    **dict.fromkeys((*AXIS_SPEEDS, *EXTERNAL_AXIS_SPEEDS), SettingRange(1.0, 100.0, True)),
}
"""All settings whose values are numbers."""
CHOICE_SETTINGS: Final = {"$ipo_mode": ("#base",), "$ori_type": ("#var",), "$advance": ("3",)}
"""Settings with their supported values.

They mean, in this order: the tool is on the flange, the orientation changes at a constant rate, and the
controller plans three moves ahead. Without advance run each corner would be a stop.
"""
FRAME_SETTINGS: Final = {"$tool": "frame", "$base": "frame", "$load": "load"}
"""Settings whose values are names of the data list, with the type of the named data."""
ROBROOT_POSITION_TOLERANCE_MM: Final = 0.1
"""Tolerance of the position of $ROBROOT [mm]."""
ROBROOT_ROTATION_TOLERANCE_DEG: Final = 0.02
"""Tolerance of the sum of the angles of $ROBROOT [deg]."""
DIRECTION_TOLERANCE: Final = 2e-6
"""Tolerance of a component of a track's direction in a check: it is written with 6 decimals."""
SPLINE_MOVE: Final = "SPL"
"""Kind of the moves of a spline block in steps."""
