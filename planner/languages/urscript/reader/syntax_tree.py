"""Syntax tree of URScript: statements and data, each with its line, in the language's units: m, s, rad."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

SixNumbers = tuple[float, float, float, float, float, float]
"""A pose (position [m], rotation vector [rad]) or joints [rad]."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement. `line` counts from 1."""

    line: int


@dataclass(frozen=True, slots=True)
class SetTcp(Statement):
    """set_tcp: the TCP is the pose variable `name`, in the flange frame."""

    name: str


@dataclass(frozen=True, slots=True)
class SetPayload(Statement):
    """set_payload: `mass` [kg] and `centre` [m] in the flange's frame."""

    mass: float
    centre: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SetOutput(Statement):
    """A digital output is switched. `number` is 0 to 7 for standard outputs, from 8 for configurable ones."""

    number: int
    value: bool


@dataclass(frozen=True, slots=True)
class SleepStatement(Statement):
    """sleep [s]."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Popup(Statement):
    """A popup.

    Attributes:
        kind: "question" waits for the operator's answer, "read" is a text that the operator confirms before
            a question, and "note" is shown while the program continues.
        text: Its text.
    """

    kind: Literal["question", "read", "note"]
    text: str


@dataclass(frozen=True, slots=True)
class PoseCheck(Statement):
    """The program ends unless a point of the flange is where it is expected.

    Attributes:
        name: Variable with the joints at which the forward kinematics is computed.
        tip: The point, as a pose in the flange frame.
        position: Expected position, as a pose in the controller's base frame.
        tolerance: Tolerance [m].
        text: Text that is shown before the program ends.
    """

    name: str
    tip: SixNumbers
    position: SixNumbers
    tolerance: float
    text: str


@dataclass(frozen=True, slots=True)
class ScriptJointMove(Statement):
    """movej to the variable `name`; `acceleration` [rad/s^2] and `speed` [rad/s] are of the leading axis."""

    name: str
    acceleration: float
    speed: float


@dataclass(frozen=True, slots=True)
class ScriptLinearMove(Statement):
    """movel.

    Attributes:
        frame: Pose variable with the frame of the target.
        target: Target pose in that frame.
        seconds: Time [s].
        radius: Blend radius [m], 0 for an exact stop.
    """

    frame: str
    target: SixNumbers
    seconds: float
    radius: float


@dataclass(frozen=True, slots=True)
class OutputLowCheck(Statement):
    """The program ends if an output is on.

    Attributes:
        number: The output.
        switched_off: Outputs that are switched off before the end.
        text: Text that is shown before the end.
    """

    number: int
    switched_off: tuple[int, ...]
    text: str


@dataclass(frozen=True, slots=True)
class AwaitSignal(Statement):
    """A call of the function `name`.

    It waits until its input has the level `value`, for at most `seconds`.
    """

    value: bool
    seconds: float
    name: str


@dataclass(frozen=True, slots=True)
class DwellMove(Statement):
    """A call of the function that replaces a move of zero length, in `seconds`."""

    seconds: float


@dataclass(frozen=True, slots=True)
class WatchdogThread(Statement):
    """The thread that watches the other program starts, or is killed."""

    on: bool


@dataclass(frozen=True, slots=True)
class PartnerCheck(Statement):
    """A call of the function that ends the program unless the other one runs and the signals are as expected.

    Attributes:
        value: Expected level of the other program's line.
        running: Expected level of this program's running wire.
    """

    value: bool
    running: bool


@dataclass(frozen=True, slots=True)
class EndingFunction(Statement):
    """A function or thread that ends the program because of inputs or of its running wire.

    Attributes:
        numbers: Inputs that it reads.
        running: Output of this program's running wire, which it reads back; -1 for none.
        switched_off: Outputs that are switched off before the end.
        text: Text that is shown before the end.
    """

    numbers: tuple[int, ...]
    running: int
    switched_off: tuple[int, ...]
    text: str


@dataclass(frozen=True, slots=True)
class AwaitArc(Statement):
    """A call of the function `name`, which waits until a torch burns, for at most `seconds`."""

    seconds: float
    name: str


@dataclass(frozen=True, slots=True)
class ArcWatchdog(Statement):
    """The thread `name`, which monitors a burning torch, starts or is killed."""

    name: str
    on: bool


@dataclass(frozen=True, slots=True)
class ArcFunction(Statement):
    """The function that waits for a torch to burn, or the thread that monitors it.

    It ends the program if the input does not show in time that the torch burns, or no longer shows it, if
    the output is off, or if the torch stands.

    Attributes:
        given: Number of the torch's input, None for a thread without one.
        torch_output: Number of the torch's output that the thread reads back, None for the function.
        switched_off: Outputs that are switched off before the end.
        text: Text that is shown before the end.
        max_standing_time: Time [s] for which the torch may stand.
        min_travel: Distance [m] that it has to move in that time.
    """

    given: int | None
    torch_output: int | None
    switched_off: tuple[int, ...]
    text: str
    max_standing_time: float = 0.0
    min_travel: float = 0.0


@dataclass(frozen=True, slots=True)
class SegmentComment(Statement):
    """A comment with the label of the segment that starts."""

    label: str


@dataclass(frozen=True, slots=True)
class ScriptVariable:
    """A variable: `kind` pose, joints or text."""

    line: int
    kind: str
    value: Any


@dataclass(frozen=True, slots=True)
class ScriptProgram:
    """A file.

    Attributes:
        file: Name of the file.
        name: Name of the program.
        data: Its data by name.
        body: Its statements after the data.
        endings: Functions and thread that end the program because of a second controller, by name; empty
            without one.
        torches: Functions and threads of torches, by name.
    """

    file: str
    name: str
    data: Mapping[str, ScriptVariable]
    body: tuple[Statement, ...]
    endings: Mapping[str, EndingFunction] = field(default_factory=dict)
    torches: Mapping[str, ArcFunction] = field(default_factory=dict)

    @property
    def moves(self) -> int:
        """Number of straight moves."""
        return sum(isinstance(statement, ScriptLinearMove) for statement in self.body)


NAME_LENGTH: Final = 32
"""Maximum length [characters] of a name."""
LINE_LENGTH: Final = 400
"""Maximum length [characters] of a line that is read."""
TEXT_LENGTH: Final = 255
"""Maximum length [characters] of a popup's text."""
CHECK_POINT: Final = (0.1, 0.2, 0.3)
"""Point of the flange [m] that programs check. It is on no axis: its position reveals any rotation."""
MAX_CHECK_TOLERANCE_M: Final = 0.01
"""Maximum tolerance [m] for the controller's flange, because arms are calibrated individually."""

AWAIT_LINE, AWAIT_RUNNING = "await_line", "await_running"
"""Names of the functions that wait for the other controller's line, and for its running wire."""
CHECK = "check_partner"
"""Name of the function that checks line and running wire of the other controller at one instant."""
STAND = "stand"
"""Name of the function that waits in place of a move."""
WATCH, WATCHING = "watch_partner", "watching"
"""Names of the thread that watches the other controller's running wire, and of its variable."""
AWAIT_ARC, WATCH_ARC, WATCHING_ARC = "await_arc", "watch_arc", "watching_arc"
"""Names of the function that waits for a torch to burn, of the thread that monitors it, and of its variable.

Those of further torches have a number appended.
"""
ARC_FUNCTION: Final = rf"({AWAIT_ARC}|{WATCH_ARC})(?:_\d+)?"
"""Pattern of the names of the functions and threads of torches."""
ARC_VARIABLE: Final = rf"{WATCHING_ARC}(?:_\d+)?"
"""Pattern of the names of the variables that hold threads of torches."""

_RESERVED_TEXT = """
and break continue def elif else end enter_critical exit_critical false False for global halt if in join kill
local not or return run sec struct thread true True while xor movej movel movep movec servoj servoc speedj
speedl stopj stopl force_mode sleep sync popup textmsg pose_trans pose_inv pose_add pose_sub point_dist
pose_dist get_forward_kin get_inverse_kin set_tcp set_payload set_target_payload set_gravity
set_standard_digital_out set_configurable_digital_out set_tool_digital_out set_digital_out p
get_standard_digital_in get_configurable_digital_in get_standard_digital_out get_configurable_digital_out
await_line await_running check_partner watch_partner watching passed level limit own stand seconds
arc_lost arc_stood arc_place get_actual_tcp_pose
"""
RESERVED: Final = frozenset(_RESERVED_TEXT.split())
"""Words of the language and of its functions, which no variable may shadow."""
