"""URScript as read: statements and data, each with its line, in the language's units: m, s, rad."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

Six = tuple[float, float, float, float, float, float]
"""A pose (position [m], rotation vector [rad]) or joints [rad]."""


@dataclass(frozen=True, slots=True)
class Statement:
    """`line` counts from 1."""

    line: int


@dataclass(frozen=True, slots=True)
class SetTcp(Statement):
    """set_tcp to the pose `name`."""

    name: str


@dataclass(frozen=True, slots=True)
class SetPayload(Statement):
    """set_payload: `mass` [kg] and `centre` [m] in the flange's frame."""

    mass: float
    centre: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Output(Statement):
    """A digital output by its number, 8 and more for configurable ones, is switched."""

    number: int
    value: bool


@dataclass(frozen=True, slots=True)
class Pause(Statement):
    """sleep [s]."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Popup(Statement):
    """A popup: `kind` a question, a text to be read before one, or one that is shown meanwhile."""

    kind: Literal["question", "read", "note"]
    text: str


@dataclass(frozen=True, slots=True)
class Look(Statement):
    """The program ends unless the point `tip` of the flange is at `place` in the controller's base within
    `most` [m] at the joints `name`; `text` is shown then."""

    name: str
    tip: Six
    place: Six
    most: float
    text: str


@dataclass(frozen=True, slots=True)
class Joint(Statement):
    """movej to the joints `name`; `acceleration` [rad/s^2] and `speed` [rad/s] of the leading axis."""

    name: str
    acceleration: float
    speed: float


@dataclass(frozen=True, slots=True)
class Straight(Statement):
    """movel to `place` in the frame `frame`, in `seconds`, with the blend radius `radius` [m], 0 for an exact
    stop."""

    frame: str
    place: Six
    seconds: float
    radius: float


@dataclass(frozen=True, slots=True)
class StaysLow(Statement):
    """The program ends when the output `number` is on: it switches the outputs `off` and shows `text`
    before."""

    number: int
    off: tuple[int, ...]
    text: str


@dataclass(frozen=True, slots=True)
class Await(Statement):
    """A call of the function `name`, which waits until its input has the level `value`, `seconds` at most."""

    value: bool
    seconds: float
    name: str


@dataclass(frozen=True, slots=True)
class Stand(Statement):
    """A call of the function that is a move of no way, in `seconds`."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Watch(Statement):
    """The thread that watches the other program begins, or is killed."""

    on: bool


@dataclass(frozen=True, slots=True)
class Check(Statement):
    """A call of the function that ends the program unless the other one's line is `value`, that one runs, and
    the own running wire is `own`."""

    value: bool
    own: bool


@dataclass(frozen=True, slots=True)
class Ending(Statement):
    """A function or thread that ends the program over the inputs `numbers`, or where the output `own` is not
    as it should be: it switches the outputs `off` and shows `text` before."""

    numbers: tuple[int, ...]
    own: int
    off: tuple[int, ...]
    text: str


@dataclass(frozen=True, slots=True)
class AwaitArc(Statement):
    """A call of the function `name`, which waits until a torch burns, `seconds` at most."""

    seconds: float
    name: str


@dataclass(frozen=True, slots=True)
class GuardArc(Statement):
    """The thread `name`, which watches a torch that burns, begins or is killed."""

    name: str
    on: bool


@dataclass(frozen=True, slots=True)
class ArcFunction(Statement):
    """The function that waits for a torch to burn, or the thread that watches it: it switches the outputs
    `off`, shows `text` and ends the program where the input `given` does not say in time that it burns, or
    not any more, where the output `own` (None of the function) is off, or where the torch stands for more
    than `stood` [s], no farther than `far` [m] from a place. `given` is None of a thread without an input."""

    given: int | None
    own: int | None
    off: tuple[int, ...]
    text: str
    stood: float = 0.0
    far: float = 0.0


@dataclass(frozen=True, slots=True)
class Begins(Statement):
    """A comment that says which segment begins: its label."""

    label: str


@dataclass(frozen=True, slots=True)
class Data:
    """A variable: `kind` pose, joints or text."""

    line: int
    kind: str
    value: Any


@dataclass(frozen=True, slots=True)
class Program:
    """A file: the `name` as in def, its data by name, and its statements behind them. `endings`: the
    functions and the thread of a program that meets another one, by name; else empty. `torches`: functions
    and threads of torches."""

    file: str
    name: str
    data: Mapping[str, Data]
    body: tuple[Statement, ...]
    endings: Mapping[str, Ending] = field(default_factory=dict)
    torches: Mapping[str, ArcFunction] = field(default_factory=dict)

    @property
    def moves(self) -> int:
        """How many straight moves there are."""
        return sum(isinstance(statement, Straight) for statement in self.body)


NAME_LENGTH: Final = 32
"""Longest name [characters]."""
LINE_LENGTH: Final = 400
"""Longest line that is read [characters]."""
TEXT_LENGTH: Final = 255
"""Longest text of a popup [characters]."""
CHECK_POINT: Final = (0.1, 0.2, 0.3)
"""The point of the flange [m] that programs look at: off all axes, so that its place tells base and flange
turned."""
LOOK_ERROR: Final = 0.01
"""How far [m] a program may let the controller's flange be off at most: arms are calibrated one by one."""

AWAIT_LINE, AWAIT_RUNNING = "await_line", "await_running"
"""The functions that wait for the other controller's line, and for its running wire."""
CHECK = "check_partner"
"""The function that looks at both at one instant."""
STAND = "stand"
"""The function that waits in place of a move."""
WATCH, WATCHING = "watch_partner", "watching"
"""The thread that watches that wire, and the variable that holds it."""
AWAIT_ARC, WATCH_ARC, WATCHING_ARC = "await_arc", "watch_arc", "watching_arc"
"""The function that waits for a torch to burn, the thread that watches it, and what holds that; of further
torches with a number behind."""
ARC_FUNCTION: Final = rf"({AWAIT_ARC}|{WATCH_ARC})(?:_\d+)?"
"""Names of these functions and threads,"""
ARC_VARIABLE: Final = rf"{WATCHING_ARC}(?:_\d+)?"
"""and of what holds them."""

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
"""Words of the language and of its functions, which no variable may hide."""
