"""Steps of a task in a form that all robot languages share, with values in SI units.

The reader of a language converts its statements to these steps, with their targets, speeds, zones, tools and
frames. The replay and the rules use nothing else. In all steps `kind` is the language's own word for the
statement. `TextFault` is a fault of a program text in any language.
"""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from planner.geometry.arrays import FloatArray

BASE_FRAME = "base_frame"
"""Name of the data in a program, in any language, that states the base of its arm."""
DIGEST = "problem_digest"
"""Name of the data in a program, in any language, that states the digest of its problem."""
UNUSED_AXIS = 9e9
"""Value of an external axis that does not exist or that a target does not state."""
MAX_EXTERNAL_VALUE = 1e6
"""Maximum value of an external axis [mm, deg]. Larger values mean an unused axis (9E9)."""


@dataclass(frozen=True, slots=True, eq=False)
class RobTarget:
    """A pose that is the target of a straight move.

    Attributes:
        position: Position, (3,) [m].
        quaternion: Orientation, (4,) wxyz as written.
        conf: Configuration cf1, cf4, cf6, cfx (RAPID); None if the arm keeps its posture.
        external: Values of the external axes as written, (6,) [mm or deg].
    """

    position: FloatArray
    quaternion: FloatArray
    conf: tuple[int, int, int, int] | None
    external: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StatusTarget:
    """A pose that is the target of a joint move.

    Attributes:
        position: Position, (3,) [m].
        quaternion: Orientation, (4,) wxyz.
        status: Status bits, which select the joint solution together with ``turn``.
        turn: Turn bits.
        external: Values of the external axes as written, (6,) [mm or deg].
    """

    position: FloatArray
    quaternion: FloatArray
    status: int
    turn: int
    external: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class JointTarget:
    """A joint target.

    Attributes:
        joints: Joints as the controller counts them, (6,) [rad]; a coupled axis 3 is as written.
        external: Values of the external axes as written, (6,) [mm or deg].
    """

    joints: FloatArray
    external: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PassedTarget:
    """Joints that the arm passes with a velocity, on a cubic in joint space from the previous target.

    Attributes:
        joints: Joints of the serial chain, (J,) [rad].
        rates: Joint velocities, (J,) [rad/s].
        external: Values of the external axes as written, (6,) [mm or deg].
    """

    joints: FloatArray
    rates: FloatArray
    external: FloatArray


@dataclass(frozen=True, slots=True)
class MoveSpeed:
    """Speeds of a move.

    Attributes:
        tcp: Speed of the TCP [m/s], inf for no limit.
        turn: Rotation speed [rad/s].
        linear: Speed of linear external axes [m/s].
        rotary: Speed of rotary external axes [rad/s].
        axes: Fractions of the axes' maximum speeds, if a joint move states them, else None.
        external: Fractions of the external axes' maximum speeds, (6,), 0 for axes without one; None if the
            language does not state them.
    """

    tcp: float
    turn: float
    linear: float
    rotary: float
    axes: tuple[float, ...] | None = None
    external: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Zone:
    """How the controller rounds the corner at the end of a move.

    Attributes:
        fine: Whether the arm stops there.
        tcp: Radius on the path [m].
        turn: Radius of the rotation [m].
        external: Radius of the external axes [m].
        turn_angle: Angle of the rotation [rad].
        linear: Distance of linear external axes [m].
        rotary: Angle of rotary external axes [rad].
    """

    fine: bool
    tcp: float
    turn: float
    external: float
    turn_angle: float
    linear: float
    rotary: float


@dataclass(frozen=True, slots=True, eq=False)
class LoadData:
    """A load that a flange carries.

    Attributes:
        mass: Mass [kg].
        centre: Centre of mass, (3,) [m].
        axes: Quaternion of the principal axes of inertia, (4,) wxyz.
        inertia: Principal moments of inertia, (3,) [kg m^2].
    """

    mass: float
    centre: FloatArray
    axes: FloatArray
    inertia: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """A tool.

    Attributes:
        held: Whether the robot holds the tool.
        pose: TCP in the flange frame, (4, 4) [m].
        load: Load of the tool, in the flange frame.
    """

    held: bool
    pose: FloatArray
    load: LoadData


@dataclass(frozen=True, slots=True, eq=False)
class WorkObject:
    """Frame in which targets are stated: work object in RAPID, base in KRL, feature in PolyScope.

    Attributes:
        held: Whether the robot holds the work object.
        fixed: Whether the user frame is fixed; otherwise ``unit`` moves it.
        unit: Mechanical unit that moves the user frame, "" for none.
        user: User frame in the world or, if a unit moves it, in the frame of the unit, (4, 4) [m].
        object: Object frame in the user frame, (4, 4) [m].
    """

    held: bool
    fixed: bool
    unit: str
    user: FloatArray
    object: FloatArray


MAX_NUMBER = 3.4e38
"""Upper bound on numbers of a controller: single precision."""


def to_single(number: float) -> float:
    """Return a number below `MAX_NUMBER` in single precision, as a controller holds it."""
    return float(np.float32(number))


def to_singles(numbers: Any) -> FloatArray:
    """Return numbers below `MAX_NUMBER` in single precision, as a controller holds them."""
    return np.array(numbers, dtype=np.float32).astype(np.float64)


def rotation(quaternion: FloatArray) -> FloatArray:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz of any nonzero length."""
    q = np.asarray(quaternion, dtype=float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    matrix = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(matrix), (0, 1), (-2, -1))


def poses(position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return the poses (..., 4, 4) [m] of positions (..., 3) [m] and quaternions (..., 4) wxyz."""
    pose = np.zeros((*np.shape(position)[:-1], 4, 4))
    pose[..., :3, :3] = rotation(quaternion)
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1.0
    return pose


@dataclass(frozen=True, slots=True, eq=False)
class ProgramStep:
    """A step of a program: a statement (instruction) in a form that all robot languages share.

    Attributes:
        module: Name of the module or file.
        procedure: Name of the procedure or segment.
        line: Line in the file of ``module``, from 1.
        condition: Run-time condition on which the step depends, "" for none. It is set in handlers only.
    """

    module: str
    procedure: str
    line: int
    condition: str


@dataclass(frozen=True, slots=True, eq=False)
class MoveStep(ProgramStep):
    """A move. Names are "" for values that the statement itself contains.

    Attributes:
        kind: Word of the language.
        target: The target.
        target_name: Name of the target.
        id: Number of the move in a synchronised block, or None.
        time: Stated time [s], or None.
        velocity: Stated speed of the TCP [m/s], or None.
        speed: Speeds in force.
        zone: Zone at the target.
        zone_name: Name of the zone.
        tool: Tool in force.
        tool_name: Name of the tool.
        wobj: Work object in force.
        wobj_name: Name of the work object.
        switches: Options without value, in lower case.
        acceleration: Stated acceleration of the leading axis [rad/s^2], or None.
    """

    kind: str
    target: RobTarget | JointTarget | StatusTarget | PassedTarget
    target_name: str
    id: int | None
    time: float | None
    velocity: float | None
    speed: MoveSpeed
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
        """Whether the work object is the world by its name: wobj0, or `WORLD_FRAME` (KRL, URScript)."""
        return self.wobj_name.lower() in ("wobj0", WORLD_FRAME)

    @property
    def by_joints(self) -> bool:
        """Whether the move is a joint move: straight in joint space."""
        return isinstance(self.target, JointTarget | StatusTarget)


@dataclass(frozen=True, slots=True, eq=False)
class SignalStep(ProgramStep):
    """Switches an output.

    Attributes:
        kind: Word of the language.
        signal: Name of the output.
        value: Its new value, 0 or 1 for a digital output.
        delay: Delay [s].
        synchronous: Whether the program waits until the output has its new value.
    """

    kind: str
    signal: str
    value: float
    delay: float
    synchronous: bool


@dataclass(frozen=True, slots=True, eq=False)
class WaitStep(ProgramStep):
    """A wait: for ``seconds``, for an input within ``seconds``, or, with neither, for the arm to stop.

    Attributes:
        kind: Word of the language.
        seconds: Waiting time or, for an input, timeout [s]; None for none.
        signal: Name of the input, or "".
        value: Expected value of the input, or None.
        after_stop: Whether the arm stops before the time counts.
        flag: Name of the variable that states whether the wait timed out, "" if a timeout is an error.
        repeats: Whether the program asks and repeats the wait on a timeout.
    """

    kind: str
    seconds: float | None
    signal: str
    value: float | None
    after_stop: bool
    flag: str = ""
    repeats: bool = False

    @property
    def pause(self) -> float:
        """Minimum waiting time [s]: a wait for an input may end at once."""
        return 0.0 if self.signal else self.seconds or 0.0


@dataclass(frozen=True, slots=True, eq=False)
class MessageStep(ProgramStep):
    """Shows a text to the operator.

    Attributes:
        kind: Word of the language.
        lines: The lines as written.
        confirm: Whether the program waits for an answer of the operator.
        text: The text that is shown, without the header of a box.
        certain: Whether the program continues only after the operator has pressed the one button that
            confirms the text, and not after a timeout.
        panel: "line" for a line on the operator's panel, "clear" to clear it, "" for anything else.
        header: Header of a box.
        options: Other options of the statement, as pairs (option, name that follows it or "").
        counts_as_stopped: Whether the program counts as stopped meanwhile: its running wire is low.
    """

    kind: str
    lines: tuple[str, ...]
    confirm: bool
    text: str = ""
    certain: bool = False
    panel: Literal["line", "clear", ""] = ""
    header: str = ""
    options: tuple[tuple[str, str], ...] = ()
    counts_as_stopped: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class WatchStep(ProgramStep):
    """Starts (`on`) or ends the monitoring of the input `signal`; the program ends when this input falls."""

    signal: str
    on: bool


@dataclass(frozen=True, slots=True, eq=False)
class GuardStep(ProgramStep):
    """Starts or ends the torch watchdog.

    It ends the program if the torch should burn but its output or its input is low, or if the torch moves
    too little.

    Attributes:
        signal: Output of the torch.
        input: Input of the torch, "" for none.
        max_still_time: Time [s] within which the torch must move.
        min_distance: Distance [m] that it must move.
        on: Whether the watchdog starts.
    """

    signal: str
    input: str
    max_still_time: float
    min_distance: float
    on: bool


@dataclass(frozen=True, slots=True, eq=False)
class RunningStep(ProgramStep):
    """The program switches its own running wire.

    Attributes:
        on: New level of the wire.
        waited: Time for which the program has waited directly before the rise [s].
    """

    on: bool
    waited: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CheckStep(ProgramStep):
    """Ends the program unless the wires of both programs have the required levels at this instant.

    Attributes:
        signal: Input with the other program's line.
        value: Required level of that line.
        runs: Input with the other program's running wire, which must be 1.
        own_level: Required level of the program's own running wire.
    """

    signal: str
    value: int
    runs: str
    own_level: bool


@dataclass(frozen=True, slots=True, eq=False)
class SyncStep(ProgramStep):
    """Meeting of the tasks of one controller.

    Attributes:
        kind: WaitSyncTask, SyncMoveOn, SyncMoveOff or SyncMoveUndo.
        ident: Name of the meeting.
        tasks: Names of the tasks that meet, empty if the statement names none.
        limited: Whether the task waits only for a stated time, and then raises an error.
    """

    kind: str
    ident: str
    tasks: tuple[str, ...]
    limited: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LoadStep(ProgramStep):
    """Loads or unloads (`kind`) the module file `path`."""

    kind: str
    path: str


@dataclass(frozen=True, slots=True, eq=False)
class CarryStep(ProgramStep):
    """Sets what the tool carries from here on; `name` is "" for a value in the statement itself."""

    load: LoadData
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class CallStep(ProgramStep):
    """Calls the procedure `name`, which is bound at run time; the steps of the procedure follow this step."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class SettingStep(ProgramStep):
    """A motion setting or a stop.

    Attributes:
        kind: Word of the language.
        switches: Options and texts of the statement.
        values: Numbers of the statement.
        stops: Whether the program stops here until it is started again.
        unit: Mechanical unit that the statement concerns, in lower case.
    """

    kind: str
    switches: tuple[str, ...]
    values: tuple[float, ...]
    stops: bool = False
    unit: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceStep(ProgramStep):
    """A branch or loop on a run-time condition, which only shows texts, waits or stops.

    Attributes:
        steps: Steps of the branch or loop, which are not part of the main flow.
        repeats: Whether it is a loop, with an unknown number of iterations.
    """

    steps: tuple[ProgramStep, ...]
    repeats: bool = False


@dataclass(frozen=True, slots=True)
class TextFault:
    """A fault of a program text.

    Attributes:
        line: Line, from 1.
        column: Column, from 1.
        code: Stable code: the language's name, a dot, and a word that all languages share.
        message: Explanation for people.
        file: Path of the file.
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
    """The order in which statements are executed is not unique; `faults` states where and why."""

    def __init__(self, faults: Sequence[TextFault]) -> None:
        super().__init__("; ".join(f"{fault.file}:{fault.line}: {fault.message}" for fault in faults))
        self.faults = tuple(faults)


def normalised_text(text: str) -> str:
    """Return the letters and digits of a text in lower case, without accents.

    Line breaks and the character set of a panel do not change them, so that texts can be compared as
    operators read them.
    """
    return re.sub(r"[^a-z0-9]", "", unicodedata.normalize("NFKD", text).lower())


WORLD_FRAME: Final = "b_world"
"""Name of the frame in KRL and URScript programs that is the cell's world, relative to the robot's foot."""
