"""Data structures that all writers share: a plan as steps of each task, and the split of moves into modules.

All tasks execute the same operations in parallel. Outside synchronised blocks one arm works while the others
wait at the next :class:`Meeting`. Inside a block all tasks have the same number of moves, which run in pairs.
An action is always outside a block. The moves of all tasks are split into modules at the same stops.

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
"""External axes of a target: pairs of column, from 0, and value [mm or deg], rounded as written."""
TRACK_COLUMN = 0
"""Column of a track among external axes: the first one, eax_a or E1."""


@dataclasses.dataclass(frozen=True)
class JointMove:
    """A joint move that ends in a stop.

    Attributes:
        q: Joints of the serial chain at its end, (6,) [rad].
        role: Role of the move: home, entry, start, exit or station.
        id: Number of the move in a synchronised block, in which all arms move at once; None if one arm moves
            alone.
        axis_setpoint: Values of the external axes that its program moves. None before they are known, and for
            an arm whose program moves none.
    """

    q: FloatArray
    role: str
    id: int | None = None
    axis_setpoint: ExternalAxisValues | None = None


@dataclasses.dataclass(frozen=True)
class AxesCheck:
    """Ends the program unless the external axes are at ``axis_setpoint``; precedes the first move."""

    axis_setpoint: ExternalAxisValues


@dataclasses.dataclass(frozen=True)
class Meeting:
    """All tasks wait here for each other.

    Attributes:
        number: Number of the meeting, from 1.
        reached: State that holds after the meeting, as a clause for comments.
        seconds: Planned time [s] for which another arm acts alone before the meeting, as far as it is known.
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
    """Moves of one arm in one operation, one for each target that is moved to.

    The index of all arrays is that of the move. The first target of an operation has no move: the arm gets
    there by a joint move.

    Attributes:
        position: Positions of the targets in the work frame, rounded as written, (M, 3) [mm].
        quaternion: Orientations in the work frame, rounded as written, with continuous signs, (M, 4).
        q: Joints of the serial chain at the targets, (M, 6) [rad].
        duration: Times of the moves, rounded as written, (M,) [s].
        distance: Straight distance from the previous target to that of each move, (M,) [mm].
        max_zone: Maximum distance of a zone at the target, (M,) [mm].
        max_zone_rotation: Maximum rotation of a zone at the target, (M,) [rad].
        frame: Name of the work frame.
        track_positions: Values of a coordinated track at the targets, rounded as written, (M,) [mm]; None if
            external axes stand still.
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
    """Consecutive moves of one segment: those of an operation with indices ``first`` to ``last`` - 1."""

    operation: int
    segment: Segment
    first: int
    last: int
    synchronised: bool


TaskStep = JointMove | AxesCheck | Meeting | SyncOn | SyncOff | ActionStep | CarryLoad | SegmentRun
"""One step of a task, independent of the robot language."""


@dataclasses.dataclass(frozen=True)
class OperationProgram:
    """One operation of one task.

    Attributes:
        name: Name of the operation.
        setup: Number of its setup, from 1.
        arm: The arm with the tool that it carries in this operation.
        moves: Moves of the arm, None for an arm that waits.
        ids: Numbers of the moves, (M,).
        stop: Whether each move ends in a stop, (M,).
        meets: Number of the handshake meeting after each move, (M,), counted from 1 over the whole job; 0 if
            no meeting follows the move.
        segments: Segment of each move.
        targets: Index in the plan of the target of each move, (M,).
        steps: Steps of the operation.
        axis_setpoint: Values of the external axes that the program moves, during this operation.
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
        worst: Maximum of ``change`` [m].
        row: Index of the move with this maximum.
        segment: Segment of that move.
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
        meets: Number of meetings, including the first one in ``main`` if there is a handshake.
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
        """Return the signals that a task can switch: all or, with a handshake, those of its own actions."""
        if self.handshake is None:
            return self.signals
        steps = (step for operation in task.operations for step in operation.steps)
        task_signals = {step.action.signal for step in steps if isinstance(step, ActionStep)}
        return tuple(signal for signal in self.signals if signal in task_signals)


_UNSPLIT_KINDS = frozenset({"cut", "trim"})
"""Kinds of segments within which programs are not split at stops.

A hot wire or a burning arc would wait there for the next module.
"""


def split_points(program: OperationProgram) -> BoolArray:
    """Return after which moves the moves of an operation may be split into two modules, (M,).

    They may be split after each stop, with one exception: a stop between two moves of the same cut or trim
    segment, where a hot wire or an arc would wait for the next module. After a stop at which the arms meet by
    handshake they may be split also there, because the arms wait at it anyway.
    """
    out = program.stop.copy()
    for i in np.flatnonzero(out[:-1] & (program.meets[:-1] == 0)):
        inside_cut = (
            program.segments[i] == program.segments[i + 1] and program.segments[i].kind in _UNSPLIT_KINDS
        )
        out[i] = not inside_cut
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
    decomposed = unicodedata.normalize("NFKD", " ".join(text.translate(ASCII_REPLACEMENTS).split()))
    kept = "".join(c for c in decomposed if not unicodedata.combining(c))
    return "".join(c if 32 <= ord(c) < 127 else "?" for c in kept)


def segment_mark(segment: Segment) -> str:
    """Return the text that names a segment in a program, from which the proof reads it.

    Languages without a procedure for each segment use it. The text is the label of the segment, such as
    ``cut/wall`` or ``cut/wall_in``. If the label contains other characters than ASCII letters, digits,
    underscores and slashes, the text is the key of the segment: the label in lower-case ASCII.
    """
    label = str(segment)
    return label if re.fullmatch(r"[\w/]+", label, re.ASCII) else segment.key


def is_question(step: TaskStep | None) -> bool:
    """Return whether a step is a question."""
    return isinstance(step, ActionStep) and step.action.kind == "confirm"


def question_follows(steps: Sequence[TaskStep]) -> bool:
    """Return whether the steps start with a question, or with messages that a question follows directly.

    The operator must read such messages before he answers.
    """
    other_steps = (
        step for step in steps if not (isinstance(step, ActionStep) and step.action.kind == "message")
    )
    return is_question(next(other_steps, None))


_MIN_PART_MOVES = 200
"""Minimum number of moves between two meetings at which a segment is split, unless a module takes fewer."""


@dataclasses.dataclass(frozen=True)
class ModulePart:
    """Moves ``first`` to ``last`` - 1 of an operation, of one segment; ``module`` counts from 1."""

    segment: Segment
    operation: int
    first: int
    last: int
    module: int


def module_parts(
    job: JobPrograms, sizes: Sequence[IntArray], frame: int, max_moves: int, max_bytes: int
) -> tuple[ModulePart, ...]:
    """Split the moves of a job into modules that the controllers accept.

    Args:
        job: Programs of all tasks.
        sizes: For each operation the size of each move in the task in which it is largest, (M,) [bytes].
        frame: Size of a part without its moves, such as headers and settings [bytes].
        max_moves: Maximum number of moves of a module.
        max_bytes: Maximum size of a module [bytes].

    Returns:
        The parts in the order in which they are executed. A segment that is split has several parts.

    Raises:
        TandemError: Moves between two positions at which a split is allowed do not fit into a module
            (``post.no_split``).
    """
    out: list[ModulePart] = []
    packer = _ModulePacker(frame, max_moves, max_bytes)
    for number, runs in enumerate(_operation_runs(job)):
        programs = (task.operations[number] for task in job.tasks)
        program = next(program for program in programs if program.moves is not None)
        run_starts = [run.first for run in runs]
        max_move_size = max(1, int(max(sizes[number], default=1)))
        # a quarter of a module at most, so that parts fill modules well
        min_part_moves = max(1, min(_MIN_PART_MOVES, max_moves // 4, max_bytes // (4 * max_move_size)))
        for first, end in _split_spans(runs, program, min_part_moves):
            packer.add(program, first, end, sizes[number][first:end])
            overlapping = slice(
                bisect.bisect_right(run_starts, first) - 1, bisect.bisect_left(run_starts, end)
            )
            for run in runs[overlapping]:
                low, high = max(run.first, first), min(run.last, end)
                if low >= high:
                    continue
                previous = out[-1] if out else None
                # the run continues in the same module: extend its last part instead of starting a new one
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
        TandemError: A file is too large (``post.no_split``).
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
        TandemError: The program has too many moves or bytes (``post.no_split``).
    """
    if moves > limits.max_moves or len(text.encode()) > limits.max_bytes:
        size_text = f"{path} has {moves} {what} and {len(text.encode())} bytes"
        message = (
            f"{size_text}; allowed: {limits.max_moves} and {limits.max_bytes}, because it is one program"
        )
        required = max(moves, limits.max_moves), max(kilobytes(text), limits.max_bytes // 1000)
        hint = f"allow it: controller: {{max_moves: {required[0]}, max_kilobytes: {required[1]}}}"
        raise issue_error("post.no_split", message, file=path, hint=hint)


class _ModulePacker:
    """Fills modules one after the other.

    Attributes:
        module: Number of the current module, from 1.
        moves: Number of moves in it.
        bytes: Size of it [bytes].
    """

    def __init__(self, frame: int, max_moves: int, max_bytes: int) -> None:
        self.frame, self.max_moves, self.max_bytes = frame, max_moves, max_bytes
        self.module, self.moves, self.bytes = 1, 0, frame

    def add(self, program: OperationProgram, first: int, last: int, sizes: IntArray) -> None:
        """Add moves that must stay together to the current module, or to a new one if they do not fit there.

        Their size includes ``frame`` for each of their segments.

        Args:
            program: The operation.
            first: Index of the first move.
            last: Index of the move after the last one.
            sizes: Sizes of the moves to add, (last - first,) [bytes].

        Raises:
            TandemError: The moves do not fit into any module (``post.no_split``).
        """
        segment_count = 1 + sum(
            program.segments[i] != program.segments[i - 1] for i in range(first + 1, last)
        )
        required_bytes = int(sizes.sum()) + self.frame * segment_count
        if last - first > self.max_moves or required_bytes + self.frame > self.max_bytes:
            message = (
                f"operation {program.name}: {last - first} moves ({required_bytes} bytes) from target row "
                f"{first} on have no stop outside the work to split at; a module takes {self.max_moves} "
                f"moves and {self.max_bytes} bytes"
            )
            required = max(self.max_moves, last - first), max(self.max_bytes, required_bytes + self.frame)
            hint = "stop the motion between two cuts, or allow larger modules: controller: "
            hint += f"{{max_moves: {required[0]}, max_kilobytes: {math.ceil(required[1] / 1000)}}}"
            raise issue_error("post.no_split", message, index=first, hint=hint)
        if self.moves and (
            self.moves + last - first > self.max_moves or self.bytes + required_bytes > self.max_bytes
        ):
            self.module, self.moves, self.bytes = self.module + 1, 0, self.frame
        self.moves += last - first
        self.bytes += required_bytes


def _operation_runs(job: JobPrograms) -> list[list[SegmentRun]]:
    """Return the runs of segments of each operation.

    They are those of one task with moves, because all tasks with moves in the operation have equal runs.
    """
    out = []
    for programs in zip(*(task.operations for task in job.tasks), strict=True):
        moving = next(program for program in programs if program.moves is not None)
        out.append([step for step in moving.steps if isinstance(step, SegmentRun)])
    return out


def _split_spans(
    runs: Sequence[SegmentRun], program: OperationProgram, min_moves: int
) -> list[tuple[int, int]]:
    """Return the spans of moves (first, end) of an operation that stay together in one module.

    An operation is split at all points of :func:`split_points` but some of those inside a segment, at which
    the arms meet by handshake. Such a point is used only if the span before it has at least ``min_moves``
    moves.

    Args:
        runs: Runs of the operation.
        program: The operation, in a task with moves.
        min_moves: Minimum number of moves of a span that ends inside a segment.

    Returns:
        Index of the first move of each span, and of the move after its last one.
    """
    if not runs:
        return []
    is_split_point = split_points(program)
    edges = [0]
    for index in np.flatnonzero(is_split_point).tolist():
        inside_segment = (
            program.meets[index]
            and index + 1 < len(is_split_point)
            and program.segments[index] == program.segments[index + 1]
        )
        if not inside_segment or index + 1 - edges[-1] >= min_moves:
            edges.append(index + 1)
    return list(itertools.pairwise(edges))
