"""KRL files as read: statements and declarations, each with its line, and the words of the language.

Words are names that nothing may take, settings that a program may make, and their ranges. System
variables and their units (m/s, deg/s, mm, deg, percent): KUKA's expert manual as cited in public
posts and grammars; docs/krl.md says which of them were seen where.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

Outer = tuple[tuple[int, float], ...]
"""External axes of a target in place: their columns [from 0], E1 to E6, with values [mm or deg] in single
precision; those that are not stated are left out."""


@dataclass(frozen=True, slots=True)
class Statement:
    """`line` counts from 1 in its file."""

    line: int


@dataclass(frozen=True, slots=True)
class Start(Statement):
    """BAS(#INITMOV,0): all settings as the controller has them."""


@dataclass(frozen=True, slots=True)
class Set(Statement):
    """A setting, its name in lower case; `value` is a number, or a name or #word in lower case."""

    name: str
    value: float | str


@dataclass(frozen=True, slots=True)
class Output(Statement):
    """$OUT[`number`] is switched."""

    number: int
    value: bool


@dataclass(frozen=True, slots=True)
class Listen(Statement):
    """The guarded loop that waits for $IN[`number`] to be `value`; after `seconds` it asks and waits
    again."""

    number: int
    value: bool
    seconds: float


@dataclass(frozen=True, slots=True)
class Await(Statement):
    """The loop that waits for $IN[`number`] to be `value`; after `seconds` it switches the outputs `off`,
    shows `text` ("" where nothing is shown), and never goes on."""

    number: int
    value: bool
    seconds: float
    off: frozenset[int]
    text: str


@dataclass(frozen=True, slots=True)
class Joint(Statement):
    """PTP to the data `name`."""

    name: str


@dataclass(frozen=True, slots=True)
class Straight(Statement):
    """LIN or SLIN (`word`) to X, Y, Z [mm], A, B, C [deg], in single precision; `corner` C_DIS, C_ORI, C_SPL,
    or "" for an exact stop; `outer` as :data:`Outer` has it."""

    word: str
    place: tuple[float, float, float, float, float, float]
    corner: str
    outer: Outer = ()


@dataclass(frozen=True, slots=True)
class Pause(Statement):
    """WAIT SEC [s]."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Halt(Statement):
    """HALT."""


@dataclass(frozen=True, slots=True)
class StopInterrupt(Statement):
    """The interrupt of stop messages is declared, or switched `on`."""

    on: bool


@dataclass(frozen=True, slots=True)
class Foot(Statement):
    """The loop that halts as long as $ROBROOT is off zero: by `shift` [mm] or the sum of its angles by `turn`
    [deg]. `text` is shown, "" where nothing is. `along`: of an arm on external axes, by their columns [from
    0], $ROBROOT_C less these directions times their values, in single steps along the axes of $WORLD, is what
    is looked at."""

    shift: float
    turn: float
    text: str
    along: tuple[tuple[int, tuple[float, float, float]], ...] = ()


@dataclass(frozen=True, slots=True)
class AxisLook(Statement):
    """The program never goes on where the external axis number `column` [from 0] is more than `most` off
    `home` [mm or deg]. `text` is shown, "" where nothing is."""

    column: int
    home: float
    most: float
    text: str


@dataclass(frozen=True, slots=True)
class NotExternal(Statement):
    """The loop that halts as long as the mode of operation is automatic external."""


@dataclass(frozen=True, slots=True)
class Prepared(Statement):
    """Options of messages, without parameters and with no keys but the first two."""


@dataclass(frozen=True, slots=True)
class Dialog(Statement):
    """The loop that shows the dialog `text` until its first key is pressed: "yes" beside No, "next" or
    "read"."""

    text: str
    key: str


@dataclass(frozen=True, slots=True)
class Notice(Statement):
    """A message on the panel: a note, or what is so (`state`) until it is cleared."""

    text: str
    state: bool


@dataclass(frozen=True, slots=True)
class Cleared(Statement):
    """The message of a state is taken back."""


@dataclass(frozen=True, slots=True)
class Call(Statement):
    """A call of the subprogram `name`, in lower case."""

    name: str


@dataclass(frozen=True, slots=True)
class Said(Statement):
    """A comment that the proof reads: one that is to be "told" to the operator, a line of a "question" before
    HALT, or the head of a "segment", whose label is the text."""

    kind: Literal["told", "question", "segment"]
    text: str


@dataclass(frozen=True, slots=True)
class Point(Statement):
    """SPL to X, Y, Z [mm], A, B, C [deg] in a spline block; ``part``: its share, 0 to 1, of the block's
    time; ``outer`` as :data:`Outer` has it."""

    place: tuple[float, float, float, float, float, float]
    part: float
    outer: Outer = ()


@dataclass(frozen=True, slots=True)
class Spline(Statement):
    """SPLINE to ENDSPLINE: its points, with the heads of segments before them, and all its time [s]."""

    points: tuple[Point | Said, ...]
    seconds: float

    @property
    def moves(self) -> int:
        """How many points there are."""
        return sum(isinstance(point, Point) for point in self.points)


@dataclass(frozen=True, slots=True)
class Program:
    """A .src file: its `name` as in DEF, the subprograms that it declares by EXT, its statements, and its
    variables as (type, name), all in lower case."""

    file: str
    name: str
    external: tuple[str, ...]
    body: tuple[Statement, ...]
    variables: tuple[tuple[str, str], ...] = ()

    @property
    def moves(self) -> int:
        """How many straight moves and points of spline blocks there are."""
        splines = sum(statement.moves for statement in self.body if isinstance(statement, Spline))
        return splines + sum(isinstance(statement, Straight) for statement in self.body)


@dataclass(frozen=True, slots=True)
class Data:
    """One declaration of a .dat file: `kind` frame, load, e6pos, e6axis or char, `name` as written."""

    line: int
    kind: str
    name: str
    value: Any


@dataclass(frozen=True, slots=True)
class DataList:
    """A .dat file; `items` by name in lower case."""

    file: str
    name: str
    items: Mapping[str, Data]


NAME_LENGTH: Final = 24
"""Longest name in KRL [characters]."""
LINE_LENGTH: Final = 200
"""Longest line that is read [characters]."""

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
"""Words that no name may be."""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words of the language, names of its own routines and types, and those of our variables."""


class Range(NamedTuple):
    """Values that a setting may have; ``whole``: numbers without decimals only."""

    low: float
    high: float
    whole: bool = False


MOTION_SETTINGS: Final = {
    "$vel.cp": Range(1e-6, 3.0),
    "$vel.ori1": Range(0.01, 1000.0),
    "$vel.ori2": Range(0.01, 1000.0),
    "$apo.cdis": Range(1e-4, 1000.0),
    "$apo.cori": Range(1e-4, 180.0),
}
"""Settings of files with moves; each of these files makes all of them before its first move."""
AXIS_SPEEDS: Final = tuple(f"$vel_axis[{axis}]" for axis in range(1, 7))
"""Speeds of axes [%]."""
OUTER_SPEEDS: Final = tuple(f"$vel_extax[{axis}]" for axis in range(1, 7))
"""Speeds of external axes [%]: whole numbers, of what the machine data allow."""
NUMBER_SETTINGS: Final = {
    **MOTION_SETTINGS,
    **dict.fromkeys((*AXIS_SPEEDS, *OUTER_SPEEDS), Range(1.0, 100.0, True)),
}
"""All settings that are numbers."""
CHOICE_SETTINGS: Final = {"$ipo_mode": ("#base",), "$ori_type": ("#var",), "$advance": ("3",)}
"""Settings with the values that are understood: tools in hand, turns at a constant rate, and an advance run,
without which each corner is a stop."""
FRAME_SETTINGS: Final = {"$tool": "frame", "$base": "frame", "$load": "load"}
"""Settings that name data, with their type."""
FOOT_SHIFT_MM: Final = 0.1
"""How far $ROBROOT may be off zero: its way [mm],"""
FOOT_TURN_DEG: Final = 0.02
"""and the sum of its angles [deg]."""
ALONG_ERROR: Final = 2e-6
"""How far a part of the direction of a track may be off in a look: it is written with 6 decimals."""
SPLINE_MOVE: Final = "SPL"
"""What moves of a spline block are called in steps."""
