"""KRL files as read: statements and declarations, each with its line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal


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
class Joint(Statement):
    """PTP to the data `name`."""

    name: str


@dataclass(frozen=True, slots=True)
class Straight(Statement):
    """LIN or SLIN (`word`) to X, Y, Z [mm], A, B, C [deg], in single precision; `corner` C_DIS, C_ORI, C_SPL,
    or "" for an exact stop."""

    word: str
    place: tuple[float, float, float, float, float, float]
    corner: str


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
    [deg]. `text` is shown, "" where nothing is."""

    shift: float
    turn: float
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
    time."""

    place: tuple[float, float, float, float, float, float]
    part: float


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
