"""What a task does, one step after the other, in any robot language, as values in SI units.

`line` counts from 1 in the file of `module`; `kind` is always the language's own word. A reader of
a language turns its numbers into these targets, speeds, corners, tools and frames; the replay and
the rules see nothing else. `Fault` is what is wrong with a program text, whatever its language.
`letters` makes texts comparable as operators read them.
"""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray

BASE_FRAME = "base_frame"
"""The datum of a program that says where its arm's base is,"""
DIGEST = "problem_digest"
"""and the one that says from which problem it was made, in any language."""
UNUSED_AXIS = 9e9
"""Value of an external axis that is not there, or of which a target says nothing."""
MOST_OUTER = 1e6
"""Values of external axes [mm, deg] beyond are none: 9E9 is an axis that is not there."""


@dataclass(frozen=True, slots=True, eq=False)
class RobTarget:
    """A pose that an arm goes straight to: `position` (3,) [m], `quaternion` (4,) wxyz as written, `external`
    (6,) as written. `conf` (cf1, cf4, cf6, cfx), None where the arm keeps the posture that it has.
    """

    position: FloatArray
    quaternion: FloatArray
    conf: tuple[int, int, int, int] | None
    external: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StatusTarget:
    """A pose whose joints an arm goes to: `position` (3,) [m], `quaternion` (4,) wxyz, `external` (6,) as
    written; `status` and `turn` are the bits that choose among the joint solutions.
    """

    position: FloatArray
    quaternion: FloatArray
    status: int
    turn: int
    external: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class JointTarget:
    """`joints` (6,) [rad] as the controller counts them (a coupled axis 3 stays as written), `external`
    (6,) as written.
    """

    joints: FloatArray
    external: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PassedTarget:
    """`joints` [rad, serial] that are passed at `rates` [rad/s], both (J,), on a cubic in joint space from
    the target before; `external` (6,) as written.
    """

    joints: FloatArray
    rates: FloatArray
    external: FloatArray


@dataclass(frozen=True, slots=True)
class Speed:
    """`tcp` [m/s] (inf for no limit), `turn` [rad/s], external axes `linear` [m/s] and `rotary` [rad/s];
    `axes`: for a move by joints that states it so, the share of each axis' own speed; `outer`: the same (6,)
    of external axes, 0 where nothing is stated.
    """

    tcp: float
    turn: float
    linear: float
    rotary: float
    axes: tuple[float, ...] | None = None
    outer: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Zone:
    """`fine` stops the arm; else radii of path `tcp` [m], of turning `turn` [m], `external` [m], and the
    zone's own angles and lengths for turning [rad], linear [m] and rotary [rad] external axes.
    """

    fine: bool
    tcp: float
    turn: float
    external: float
    turn_angle: float
    linear: float
    rotary: float


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """`mass` [kg], `centre` (3,) [m], `axes` quaternion (4,), `inertia` (3,) [kg m^2]."""

    mass: float
    centre: FloatArray
    axes: FloatArray
    inertia: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """`held` by the robot or not, TCP `pose` (4,4) [m] in the flange frame, `load`."""

    held: bool
    pose: FloatArray
    load: Load


@dataclass(frozen=True, slots=True, eq=False)
class WorkObject:
    """`held` by the robot or not, `fixed` user frame or moved by `unit`, `user` and `object` frames (4,4)
    [m].
    """

    held: bool
    fixed: bool
    unit: str
    user: FloatArray
    object: FloatArray


LARGEST_NUMBER = 3.4e38
"""Numbers of a controller are smaller."""


def single(number: float) -> float:
    """A number as a controller holds it, in single precision; `number` is below `LARGEST_NUMBER`."""
    return float(np.float32(number))


def singles(numbers: Any) -> FloatArray:
    """Numbers as a controller holds them, in single precision; all below `LARGEST_NUMBER`."""
    return np.array(numbers, dtype=np.float32).astype(np.float64)


def rotation(quaternion: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz of any length but zero."""
    q = np.asarray(quaternion, dtype=float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def poses(position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) of positions (..., 3) and quaternions (..., 4)."""
    pose = np.zeros((*np.shape(position)[:-1], 4, 4))
    pose[..., :3, :3] = rotation(quaternion)
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose


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
    """`time` [s], `velocity` [m/s] and `acceleration` [rad/s^2] of the leading axis where the move states
    them; names are "" for values in place."""

    kind: str
    target: RobTarget | JointTarget | StatusTarget | PassedTarget
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
    acceleration: float | None = None

    @property
    def in_world(self) -> bool:
        """Whether the frame is the world by its name: the controller's own, or the one that KRL
        and URScript programs have for it."""
        return self.wobj_name.lower() in ("wobj0", WORLD_FRAME)

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
    was over, "" where that is an error; `again`: where it is over the program asks, and waits on.
    """

    kind: str
    seconds: float | None
    signal: str
    value: float | None
    standing: bool
    flag: str = ""
    again: bool = False

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
    option's name, with the name that stands behind it where one does. `stands`: the program counts as
    standing meanwhile: its running wire is low.
    """

    kind: str
    lines: tuple[str, ...]
    confirm: bool
    text: str = ""
    certain: bool = False
    panel: Literal["line", "clear", ""] = ""
    header: str = ""
    options: tuple[tuple[str, str], ...] = ()
    stands: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class WatchStep(Step):
    """From here on (`on`), or no more, the program ends when the input `signal` falls."""

    signal: str
    on: bool


@dataclass(frozen=True, slots=True, eq=False)
class GuardStep(Step):
    """What ends the program where a torch is to burn and its output `signal` or its input `given` ("" for
    none) says that it does not, or where it gets no farther than `far` [m] in `stood` [s], begins or ends."""

    signal: str
    given: str
    stood: float
    far: float
    on: bool


@dataclass(frozen=True, slots=True, eq=False)
class RunningStep(Step):
    """The program switches its own running wire. ``waited`` [s]: how long it stood right before its rise."""

    on: bool
    waited: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CheckStep(Step):
    """The program ends unless at this instant the other one's line, the input ``signal``, is ``value``, the
    input ``runs`` is 1, and its own running wire is ``own``."""

    signal: str
    value: int
    runs: str
    own: bool


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
    """Motion settings and stops. `stops`: the program stands still here until it is started again. `unit`:
    the mechanical unit that is meant, in small letters."""

    kind: str
    switches: tuple[str, ...]
    values: tuple[float, ...]
    stops: bool = False
    unit: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceStep(Step):
    """A branch or loop on `condition` that only talks, waits or stops: its `steps` are not part of the
    straight way. ``repeats``: it is a loop, and nothing says how often it runs.
    """

    steps: tuple[Step, ...]
    repeats: bool = False


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong with a text. `line` and `column` count from 1; `code` is stable: the language's name,
    a dot, and a word that all languages share; `message` is for people.
    """

    line: int
    column: int
    code: str
    message: str
    file: str = ""

    @property
    def kind(self) -> str:
        """The code without the language."""
        return self.code.partition(".")[2]


class FlowError(ValueError):
    """The programs have no single straight way; `faults` says where and why."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        super().__init__("; ".join(f"{fault.file}:{fault.line}: {fault.message}" for fault in faults))
        self.faults = tuple(faults)


def letters(text: str) -> str:
    """Letters and digits of a text, without accents and case: what survives wrapping and a panel's
    alphabet."""
    return re.sub(r"[^a-z0-9]", "", unicodedata.normalize("NFKD", text).lower())


WORLD_FRAME: Final = "b_world"
"""What the frame is called that is the cell's world, as the robot's foot sees it."""
