"""What a task does, one step after the other, in any robot language. SI units; `line` counts from 1 in the
file of `module`; `kind` is always the language's own word.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planner.verify.krl_words import WORLD
from planner.verify.values import JointTarget, Load, RobTarget, Speed, StatusTarget, Tool, WorkObject, Zone


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """`condition`: text of the run-time condition the step hangs on, "" for none (only in handlers is it
    ever set).
    """

    module: str
    procedure: str
    line: int
    condition: str


@dataclass(frozen=True, slots=True, eq=False)
class MoveStep(Step):
    """`time` [s] and `velocity` [m/s] where the move states them; names are "" for values in place."""

    kind: str
    target: RobTarget | JointTarget | StatusTarget
    target_name: str
    id: int | None
    time: float | None
    velocity: float | None
    speed: Speed
    zone: Zone
    zone_name: str
    tool: Tool
    tool_name: str
    wobj: WorkObject
    wobj_name: str
    switches: tuple[str, ...]

    @property
    def in_world(self) -> bool:
        """Whether the frame is the world by its name: the controller's own, or the one that KRL programs
        have for it."""
        return self.wobj_name.lower() in ("wobj0", WORLD)

    @property
    def by_joints(self) -> bool:
        """Whether the move is straight in joint space."""
        return isinstance(self.target, JointTarget | StatusTarget)


@dataclass(frozen=True, slots=True, eq=False)
class SignalStep(Step):
    """`delay` [s]; `synchronous`: waits for the signal."""

    kind: str
    signal: str
    value: float
    delay: float
    synchronous: bool


@dataclass(frozen=True, slots=True, eq=False)
class WaitStep(Step):
    """A wait for `seconds`, for an input `signal` to be `value` within `seconds`, or (neither) for the arm to
    stand. `standing`: the arm stands before time counts; `flag`: the variable that tells whether the limit
    was over, "" where that is an error.
    """

    kind: str
    seconds: float | None
    signal: str
    value: float | None
    standing: bool
    flag: str = ""

    @property
    def pause(self) -> float:
        """Time [s] that passes for certain."""
        return 0.0 if self.signal else self.seconds or 0.0


@dataclass(frozen=True, slots=True, eq=False)
class MessageStep(Step):
    """`confirm`: waits for the operator; `panel`: it shows a "line" on the operator's panel or does "clear"
    it, "" for anything else.

    `text`: what is shown without a box's `header`; `certain`: goes on only when the operator has pressed OK,
    the one button, not by a time limit or another button. `options`: what else is shown or done, by the
    option's name, with the name that stands behind it where one does.
    """

    kind: str
    lines: tuple[str, ...]
    confirm: bool
    text: str = ""
    certain: bool = False
    panel: Literal["line", "clear", ""] = ""
    header: str = ""
    options: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SyncStep(Step):
    """Tasks of one controller meet: `kind` WaitSyncTask, SyncMoveOn, SyncMoveOff or SyncMoveUndo; `tasks`
    empty where none are named. ``limited``: it waits for a stated time only, and raises an error then.
    """

    kind: str
    ident: str
    tasks: tuple[str, ...]
    limited: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LoadStep(Step):
    """`kind` Load or UnLoad of the module file `path`."""

    kind: str
    path: str


@dataclass(frozen=True, slots=True, eq=False)
class CarryStep(Step):
    """What the tool carries from here on; `name` is "" for a value in place."""

    load: Load
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class CallStep(Step):
    """A call of `name` that is bound while the program runs; its steps follow."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class SettingStep(Step):
    """Motion settings and stops. `stops`: the program stands still here until it is started again."""

    kind: str
    switches: tuple[str, ...]
    values: tuple[float, ...]
    stops: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceStep(Step):
    """A branch or loop on `condition` that only talks, waits or stops: its `steps` are not part of the
    straight way. ``repeats``: it is a loop, and nothing says how often it runs.
    """

    steps: tuple[Step, ...]
    repeats: bool = False
