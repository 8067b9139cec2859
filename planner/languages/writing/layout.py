"""Data structures that all writers share: a plan as steps of each task, and the split of moves into modules.

All tasks execute the same operations in parallel. Outside synchronised blocks one arm works while the others
wait at the next :class:`Meeting`. Inside a block, the tasks have equal runs of moves, in pairs. An action is
always outside a block. Modules are split at the same moves for all tasks, at stops.

Two controllers that only share digital signals (:class:`planner.claims.handshake.Handshake`) also meet
inside blocks: at the moves that :attr:`OperationProgram.meets` numbers.
"""

import bisect
import dataclasses
import itertools
import math
import re
import unicodedata
from collections.abc import Mapping, Sequence

import numpy as np

from planner.catalogue.robots import RobotData
from planner.claims.handshake import Handshake
from planner.claims.segments import Segment
from planner.claims.sentences import ASCII_REPLACEMENTS
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import issue_error
from planner.problem import Arm, Controller, Turntable
from planner.targets import TargetAction

LINE_END = "\r\n"
"""Line end of all files for controllers. A RAPID program list with bare line feeds does not load."""
POSITION_DECIMALS = 4
"""Decimals of positions in mm. Positions that are equal after rounding count as the same."""
QUATERNION_DECIMALS = 8
"""Decimals of quaternions."""
TIME_DECIMALS = 5
"""Decimals of the times of moves in s."""


ExternalAxisValues = tuple[tuple[int, float], ...]
"""External axes of a target: column from 0 and value [mm or deg] of each, rounded as written."""
TRACK_COLUMN = 0
"""Column of a track among external axes: the first one, eax_a or E1."""


@dataclasses.dataclass(frozen=True)
class JointMove:
    """A joint move that ends in a stop.

    Attributes:
        q: Joints at its end, (6,) [rad, serial].
        role: Role of the move: home, entry, start, exit or station.
        id: Number of the move in a synchronised block, in which all arms move at once; None for a move of
            one arm.
        axis_setpoint: Values of the external axes that its program moves, None if not stated yet.
    """

    q: FloatArray
    role: str
    id: int | None = None
    axis_setpoint: ExternalAxisValues | None = None


@dataclasses.dataclass(frozen=True)
class AxesCheck:
    """Ends the program unless its external axes are at ``axis_setpoint`` before its first move."""

    axis_setpoint: ExternalAxisValues


@dataclasses.dataclass(frozen=True)
class Meeting:
    """All tasks wait here for each other.

    Attributes:
        number: Number of the meeting, from 1.
        reached: What holds after the meeting.
        seconds: Planned time [s] that another arm needs alone before, as far as it is known.
    """

    number: int
    reached: str
    seconds: float = 0.0


@dataclasses.dataclass(frozen=True)
class SyncOn:
    """From here to the :class:`SyncOff` of the same number the moves of all tasks run in pairs."""

    number: int


@dataclasses.dataclass(frozen=True)
class SyncOff:
    """End of a synchronised block."""

    number: int


@dataclasses.dataclass(frozen=True)
class ActionStep:
    """An action of the process, executed by one task."""

    action: TargetAction


@dataclasses.dataclass(frozen=True)
class HeldLoad:
    """What an arm's tool holds in a setup, in its TCP frame.

    Attributes:
        setup: Number of the setup, from 1.
        mass: Mass [kg].
        cog: Centre of mass, (3,) [m].
        axes: Principal axes of inertia through the centre, (3, 3).
        inertia: Principal moments of inertia, (3,) [kg m^2].
    """

    setup: int
    mass: float
    cog: FloatArray
    axes: FloatArray
    inertia: FloatArray


@dataclasses.dataclass(frozen=True)
class CarryLoad:
    """From here on the arm carries ``load``, or nothing (None)."""

    load: HeldLoad | None


@dataclasses.dataclass(frozen=True)
class MoveTable:
    """Moves of one arm in one operation, one row for each target that is moved to.

    Attributes:
        position: Positions in the work frame, (M, 3) [mm, rounded].
        quaternion: Orientations in the work frame, (M, 4) [rounded, continuous sign].
        q: Joints, (M, 6) [rad, serial].
        duration: Times of the moves, (M,) [s, rounded].
        distance: Distances of the TCP, (M,) [mm].
        max_zone: Maximum distance of a zone at the target, (M,) [mm].
        max_zone_rotation: Maximum rotation of a zone at the target, (M,) [rad].
        frame: Name of the work frame.
        track_positions: Values of a coordinated track, (M,) [mm, rounded]; None if external axes stand
            still.
    """

    position: FloatArray
    quaternion: FloatArray
    q: FloatArray
    duration: FloatArray
    distance: FloatArray
    max_zone: FloatArray
    max_zone_rotation: FloatArray
    frame: str
    track_positions: FloatArray | None = None


@dataclasses.dataclass(frozen=True)
class SegmentRun:
    """Rows ``first`` to ``last`` - 1 of the operation's moves: one visit of ``segment``."""

    operation: int
    segment: Segment
    first: int
    last: int
    synchronised: bool


TaskStep = JointMove | AxesCheck | Meeting | SyncOn | SyncOff | ActionStep | CarryLoad | SegmentRun


@dataclasses.dataclass(frozen=True)
class OperationProgram:
    """One operation of one task.

    Attributes:
        name: Name of the operation.
        setup: Number of its setup, from 1.
        arm: The arm with the tool that it carries then.
        moves: Its moves, None for an arm that waits.
        ids: Numbers of the moves, (M,).
        stop: Whether each move ends in a stop, (M,).
        meets: Number of the handshake after each move, (M,), counted with the meetings of the job; 0 for
            none.
        segments: Segment of each move.
        targets: Index in the plan of the target of each move, (M,).
        steps: Steps of the operation.
        axis_setpoint: Values of the external axes that its program moves.
    """

    name: str
    setup: int
    arm: Arm
    moves: MoveTable | None
    ids: IntArray
    stop: BoolArray
    meets: IntArray
    segments: tuple[Segment, ...]
    targets: IntArray
    steps: tuple[TaskStep, ...]
    axis_setpoint: ExternalAxisValues | None = None


@dataclasses.dataclass(frozen=True)
class TaskProgram:
    """Program of one arm.

    Attributes:
        number: Number of the task, from 1.
        task: Name of the task.
        unit: Name of the mechanical unit.
        arm: The arm as in the first setup.
        robot: Data of the robot.
        base: Base of the arm in the world, (4, 4) [m].
        operations: Its operations.
        table: Turntable that it moves, or None.
        home_setpoint: Values of its external axes before anything moves.
    """

    number: int
    task: str
    unit: str
    arm: Arm
    robot: RobotData
    base: FloatArray
    operations: tuple[OperationProgram, ...]
    table: Turntable | None = None
    home_setpoint: ExternalAxisValues | None = None


@dataclasses.dataclass(frozen=True)
class Drift:
    """Change of the TCP distance if one arm is ahead of the other between two meetings of operation ``name``.

    Attributes:
        change: Maximum difference of the TCP distance from the planned one, in the interval between meetings
            to which each move belongs, (M,) [m].
        worst: Its maximum [m].
        row: Move with the maximum.
        segment: Segment of this move.
    """

    name: str
    change: FloatArray
    worst: float
    row: int
    segment: Segment


@dataclasses.dataclass(frozen=True)
class JobPrograms:
    """Programs of all tasks.

    Attributes:
        tasks: The tasks.
        meets: Number of meetings, with the first one in ``main`` if there is a handshake.
        blocks: Number of synchronised blocks.
        coupled: Whether the arms are joined in some operation.
        signals: Signals that actions switch.
        handshake: How the tasks meet if each runs on its own controller, else None.
        drifts: Drift of the operations with both arms.
    """

    tasks: tuple[TaskProgram, ...]
    meets: int
    blocks: int
    coupled: bool
    signals: tuple[str, ...]
    handshake: Handshake | None = None
    drifts: tuple[Drift, ...] = ()

    def switched_signals(self, task: TaskProgram) -> tuple[str, ...]:
        """Return the signals that a task can switch: all, or those of its own controller's actions."""
        if self.handshake is None:
            return self.signals
        steps = (step for operation in task.operations for step in operation.steps)
        task_signals = {step.action.signal for step in steps if isinstance(step, ActionStep)}
        return tuple(signal for signal in self.signals if signal in task_signals)


_UNSPLIT_KINDS = frozenset({"cut", "trim"})
"""Kinds of segments in which a hot wire or a burning arc would wait for the next module."""


def split_points(program: OperationProgram) -> BoolArray:
    """Return after which moves (M,) a program may be split.

    These are stops that are not inside one cut, where a hot wire or an arc would wait, and meetings of the
    arms.
    """
    out = program.stop.copy()
    for i in np.flatnonzero(out[:-1] & (program.meets[:-1] == 0)):
        inside = program.segments[i] == program.segments[i + 1] and program.segments[i].kind in _UNSPLIT_KINDS
        out[i] = not inside
    return out


def format_fixed(value: float, decimals: int) -> str:
    """Format a number with a fixed number of decimals and without negative zero.

    Args:
        value: The number.
        decimals: Number of decimals.
    """
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def format_short(value: float, decimals: int = 6) -> str:
    """Format a number without trailing zeros.

    Args:
        value: The number.
        decimals: Maximum number of decimals.
    """
    text = format_fixed(value, decimals)
    return text.rstrip("0").rstrip(".") if "." in text else text


def to_ascii(text: str) -> str:
    """Return text as one line of printable ASCII.

    Accents are dropped, letters such as ß are spelt out, and other characters become "?".
    """
    flat = unicodedata.normalize("NFKD", " ".join(text.translate(ASCII_REPLACEMENTS).split()))
    kept = "".join(c for c in flat if not unicodedata.combining(c))
    return "".join(c if 32 <= ord(c) < 127 else "?" for c in kept)


def segment_mark(segment: Segment) -> str:
    """Return the label of a segment in programs without procedures.

    A name with more than letters, digits and underscores is reduced to what programs can distinguish.
    """
    label = str(segment)
    return label if re.fullmatch(r"[\w/]+", label, re.ASCII) else segment.key


def is_question(step: TaskStep | None) -> bool:
    """Return whether a step is a question."""
    return isinstance(step, ActionStep) and step.action.kind == "confirm"


def question_follows(steps: Sequence[TaskStep]) -> bool:
    """Return whether the next step that is no message is a question."""
    rest = (step for step in steps if not (isinstance(step, ActionStep) and step.action.kind == "message"))
    return is_question(next(rest, None))


_MIN_PART_MOVES = 200
"""Minimum number of moves of a part if the arms meet at every move, unless a module takes fewer."""


@dataclasses.dataclass(frozen=True)
class ModulePart:
    """Rows ``first`` to ``last`` - 1 of an operation's moves, of one segment; ``module`` counts from 1."""

    segment: Segment
    operation: int
    first: int
    last: int
    module: int


def module_parts(
    job: JobPrograms, sizes: Sequence[IntArray], frame: int, max_moves: int, max_bytes: int
) -> tuple[ModulePart, ...]:
    """Return the parts of a job in the order in which they are executed.

    Args:
        job: Programs of all tasks.
        sizes: For each operation the sizes (M,) of its moves in the largest task [bytes].
        frame: Size of a part without its moves [bytes].
        max_moves: Maximum number of moves of a module.
        max_bytes: Maximum size of a module [bytes].

    Raises:
        TandemError: ``post.no_split``.
    """
    out: list[ModulePart] = []
    packer = _ModulePacker(frame, max_moves, max_bytes)
    for number, runs in enumerate(_operation_runs(job)):
        program = next(t.operations[number] for t in job.tasks if t.operations[number].moves is not None)
        run_starts = [run.first for run in runs]
        largest = max(1, int(max(sizes[number], default=1)))
        grain = max(1, min(_MIN_PART_MOVES, max_moves // 4, max_bytes // (4 * largest)))
        for first, last in _split_spans(runs, program, grain):
            packer.add(program, first, last, sizes[number][first:last])
            inside = slice(bisect.bisect_right(run_starts, first) - 1, bisect.bisect_left(run_starts, last))
            for run in runs[inside]:
                low, high = max(run.first, first), min(run.last, last)
                if low >= high:
                    continue
                previous = out[-1] if out else None
                if (
                    previous
                    and (previous.operation, previous.last, previous.module) == (number, low, packer.module)
                    and (low > run.first)
                ):
                    out[-1] = dataclasses.replace(previous, last=high)
                else:
                    out.append(ModulePart(run.segment, number, low, high, packer.module))
    return tuple(out)


def kilobytes(text: str) -> int:
    """Return the size of a text in kilobytes, rounded up."""
    return math.ceil(len(text.encode()) / 1000)


def require_sizes(files: Mapping[str, str], limits: Controller, what: str) -> None:
    """Check that no file exceeds the size that the controller takes.

    Args:
        files: Texts by path.
        limits: Limits of the controller.
        what: Name of the files in the hint.

    Raises:
        TandemError: ``post.no_split``.
    """
    for path, text in files.items():
        if len(text.encode()) > limits.max_bytes:
            message = f"{path} has {len(text.encode())} bytes; allowed: {limits.max_bytes}"
            hint = f"allow larger {what}: controller: {{max_kilobytes: {kilobytes(text)}}}"
            raise issue_error("post.no_split", message, file=path, hint=hint)


def require_one_file(path: str, text: str, limits: Controller, moves: int, what: str) -> None:
    """Check that a program that cannot be split has no more moves and bytes than the controller takes.

    Args:
        path: Path of the program.
        text: Its text.
        limits: Limits of the controller.
        moves: Number of its moves.
        what: Name of the moves in the message.

    Raises:
        TandemError: ``post.no_split``.
    """
    if moves > limits.max_moves or len(text.encode()) > limits.max_bytes:
        got = f"{path} has {moves} {what} and {len(text.encode())} bytes"
        message = f"{got}; allowed: {limits.max_moves} and {limits.max_bytes}, because it is one program"
        required = max(moves, limits.max_moves), max(kilobytes(text), limits.max_bytes // 1000)
        hint = f"allow it: controller: {{max_moves: {required[0]}, max_kilobytes: {required[1]}}}"
        raise issue_error("post.no_split", message, file=path, hint=hint)


class _ModulePacker:
    """Fills modules one after the other."""

    def __init__(self, frame: int, max_moves: int, max_bytes: int) -> None:
        self.frame, self.max_moves, self.max_bytes = frame, max_moves, max_bytes
        self.module, self.moves, self.bytes = 1, 0, frame

    def add(self, program: OperationProgram, first: int, last: int, sizes: IntArray) -> None:
        """Add a span of moves that must stay together; sets ``module``.

        Args:
            program: The operation.
            first: First move.
            last: Move after the last one.
            sizes: Sizes of the moves [bytes].
        """
        segments = 1 + sum(program.segments[i] != program.segments[i - 1] for i in range(first + 1, last))
        need = int(sizes.sum()) + self.frame * segments
        if last - first > self.max_moves or need + self.frame > self.max_bytes:
            got = f"operation {program.name}: {last - first} moves ({need} bytes) from target row {first} on"
            message = (
                f"{got} have no stop outside the work to split at; a module takes {self.max_moves} moves and "
            )
            message += f"{self.max_bytes} bytes"
            required = max(self.max_moves, last - first), max(self.max_bytes, need + self.frame)
            hint = "stop the motion between two cuts, or allow larger modules: controller: "
            hint += f"{{max_moves: {required[0]}, max_kilobytes: {math.ceil(required[1] / 1000)}}}"
            raise issue_error("post.no_split", message, index=first, hint=hint)
        if self.moves and (self.moves + last - first > self.max_moves or self.bytes + need > self.max_bytes):
            self.module, self.moves, self.bytes = self.module + 1, 0, self.frame
        self.moves += last - first
        self.bytes += need


def _operation_runs(job: JobPrograms) -> list[list[SegmentRun]]:
    """Runs of each operation, from a task that takes part in it."""
    out = []
    for programs in zip(*(task.operations for task in job.tasks), strict=True):
        moving = next(program for program in programs if program.moves is not None)
        out.append([step for step in moving.steps if isinstance(step, SegmentRun)])
    return out


def _split_spans(runs: Sequence[SegmentRun], program: OperationProgram, grain: int) -> list[tuple[int, int]]:
    """Spans of moves between positions at which a program may be split; every operation starts at one.

    Of meetings inside a segment, only one in every ``grain`` moves is used.
    """
    if not runs:
        return []
    is_split_point = split_points(program)
    edges = [0]
    for row in np.flatnonzero(is_split_point).tolist():
        inside = (
            program.meets[row]
            and row + 1 < len(is_split_point)
            and program.segments[row] == program.segments[row + 1]
        )
        if not inside or row + 1 - edges[-1] >= grain:
            edges.append(row + 1)
    return list(itertools.pairwise(edges))
