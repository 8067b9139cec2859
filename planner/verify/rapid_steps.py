"""What a task does, one step after the other. SI units; `line` counts from 1 in the file of `module`."""

from __future__ import annotations

from dataclasses import dataclass

from planner.verify.rapid_values import JointTarget, Load, RobTarget, Speed, Tool, WorkObject, Zone


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
    """`kind` MoveAbsJ, MoveJ or MoveL; `time` \\T [s], `velocity` \\V [m/s]; names are "" for values in
    place.
    """

    kind: str
    target: RobTarget | JointTarget
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


@dataclass(frozen=True, slots=True, eq=False)
class SignalStep(Step):
    """`kind` SetDO, Set or Reset; `delay` [s]; `synchronous`: waits for the signal."""

    kind: str
    signal: str
    value: float
    delay: float
    synchronous: bool


@dataclass(frozen=True, slots=True, eq=False)
class WaitStep(Step):
    """`kind` WaitTime, WaitRob or WaitDI; `seconds` for WaitTime and as the limit of WaitDI; `standing`:
    \\InPos; `flag`: the variable that tells whether WaitDI's limit was over, "" where that is an error.
    """

    kind: str
    seconds: float | None
    signal: str
    value: float | None
    standing: bool
    flag: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MessageStep(Step):
    """`kind` TPWrite, TPErase, UIMsgBox, TPReadFK, ErrWrite; `confirm`: waits for the operator.

    `text`: what is shown without a box's header; `certain`: goes on only when the operator has pressed OK,
    the one button, not by a time limit or another button.
    """

    kind: str
    lines: tuple[str, ...]
    confirm: bool
    text: str = ""
    certain: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SyncStep(Step):
    """`kind` WaitSyncTask, SyncMoveOn, SyncMoveOff or SyncMoveUndo; `tasks` empty where none are named."""

    kind: str
    ident: str
    tasks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LoadStep(Step):
    """`kind` Load or UnLoad of the module file `path`."""

    kind: str
    path: str


@dataclass(frozen=True, slots=True, eq=False)
class CarryStep(Step):
    """GripLoad: what the tool carries from here on; `name` is "" for a value in place."""

    load: Load
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class CallStep(Step):
    """A late-bound call (`%"..."%`) of `name`; its steps follow."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class SettingStep(Step):
    """Motion settings and stops: ConfL, ConfJ, SingArea, AccSet, VelSet, StopMove, ClearPath,
    Stop, EXIT...
    """

    kind: str
    switches: tuple[str, ...]
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceStep(Step):
    """A branch or loop on `condition` that only talks, waits or stops: its `steps` are not part of the
    straight way.
    """

    steps: tuple[Step, ...]
