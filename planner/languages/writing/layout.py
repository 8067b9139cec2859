"""What all robot languages share: a plan as steps of each task, and which moves go into which module.

Tasks go through the same operations side by side. Outside synchronised blocks one arm works while
the others wait at the next :class:`Meet`; inside, the tasks have equal runs of moves, pair by pair.
An action always stands outside a block. Modules are split at the same moves for all tasks, at stops.

Two controllers that share digital signals only (:class:`planner.claims.handshake.Handshake`) meet
inside blocks too: at the moves that :attr:`OperationProgram.meets` numbers.
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
from planner.claims.sentences import SPELT
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import refusal
from planner.problem import Arm, Controller, Turntable
from planner.targets import Action

LINE_END = "\r\n"
"""Ends the lines of all files for controllers: a RAPID program list with bare line feeds does not load, and
the others are written alike."""
POSITION_DECIMALS = 4
"""Decimals of positions in mm; what is equal after rounding is the same place."""
QUATERNION_DECIMALS = 8
"""Decimals of quaternions."""
TIME_DECIMALS = 5
"""Decimals of the times of moves in s."""


Outer = tuple[tuple[int, float], ...]
"""External axes of a target: their columns [from 0], each with its value [mm or deg], rounded as written."""
TRACK_COLUMN = 0
"""Column of a track among external axes: the first one, eax_a or E1."""


@dataclasses.dataclass(frozen=True)
class Joints:
    """The arm goes to the joints ``q`` (6,) [rad, serial], straight in joint space, and stops: alone, or in a
    synchronised block by the move ``id`` at once with the other arms. ``station``: values of the external
    axes that its program moves, None where nothing is said of them yet."""

    q: FloatArray
    place: str
    id: int | None = None
    station: Outer | None = None


@dataclasses.dataclass(frozen=True)
class AxesLook:
    """The program ends unless the external axes that it moves stand at ``station``, before its first move."""

    station: Outer


@dataclasses.dataclass(frozen=True)
class Meet:
    """All tasks wait here for each other; ``number`` from 1. ``reached``: what is then so. ``seconds``: what
    another one does alone before takes so long by the plan, as far as the plan says."""

    number: int
    reached: str
    seconds: float = 0.0


@dataclasses.dataclass(frozen=True)
class SyncOn:
    """From here to the :class:`SyncOff` of the same number the moves of all tasks run in pairs."""

    number: int


@dataclasses.dataclass(frozen=True)
class SyncOff:
    """The end of a synchronised block."""

    number: int


@dataclasses.dataclass(frozen=True)
class Do:
    """An action of the process, done by one task."""

    action: Action


@dataclasses.dataclass(frozen=True)
class Load:
    """What an arm's tool holds in a setup, in its TCP frame: ``mass`` [kg], centre ``cog`` (3,) [m], and the
    moments of inertia ``inertia`` (3,) [kg m^2] about the axes ``axes`` (3, 3) through the centre."""

    setup: int
    mass: float
    cog: FloatArray
    axes: FloatArray
    inertia: FloatArray


@dataclasses.dataclass(frozen=True)
class Carry:
    """From here on the arm carries ``load``, or nothing."""

    load: Load | None


@dataclasses.dataclass(frozen=True)
class Track:
    """Moves of one arm in one operation, one row a target that is moved to.

    ``position`` (M, 3) [mm, rounded] and ``quaternion`` (M, 4) [rounded, sign continuous] in the work frame
    ``frame``; ``q`` (M, 6) [rad, serial]; ``duration`` (M,) [s, rounded]; ``distance`` (M,) [mm] of the TCP;
    ``reach`` (M,) [mm] and ``reach_turn`` (M,) [rad]: the most that a zone at the target may take. ``outer``
    (M,) [mm, rounded]: values of the arm's track, where it goes along; None where external axes stand.
    """

    position: FloatArray
    quaternion: FloatArray
    q: FloatArray
    duration: FloatArray
    distance: FloatArray
    reach: FloatArray
    reach_turn: FloatArray
    frame: str
    outer: FloatArray | None = None


@dataclasses.dataclass(frozen=True)
class Run:
    """Rows ``first`` to ``last`` - 1 of the operation's track: one visit of ``segment``."""

    operation: int
    segment: Segment
    first: int
    last: int
    synchronised: bool


Step = Joints | AxesLook | Meet | SyncOn | SyncOff | Do | Carry | Run


@dataclasses.dataclass(frozen=True)
class OperationProgram:
    """One operation of one task; ``ids``, ``stop``: (M,) of the moves, ``targets`` (M,) of the plan that they
    go to. An arm that waits has no ``track``.

    ``meets`` (M,): the number of the handshake behind each move, counted with the :class:`Meet` of the job; 0
    for none. ``setup`` counts from 1; ``arm`` is the arm with the tool that it carries then; ``station``:
    where the external axes stand that its program moves.
    """

    name: str
    setup: int
    arm: Arm
    track: Track | None
    ids: IntArray
    stop: BoolArray
    meets: IntArray
    segments: tuple[Segment, ...]
    targets: IntArray
    steps: tuple[Step, ...]
    station: Outer | None = None


@dataclasses.dataclass(frozen=True)
class TaskProgram:
    """The program of one arm; ``number`` counts the tasks from 1. ``arm`` is as the first setup has it.
    ``table``: the turntable that it moves, if any; ``home_station``: its external axes before anything
    moves."""

    number: int
    task: str
    unit: str
    arm: Arm
    robot: RobotData
    base: FloatArray
    operations: tuple[OperationProgram, ...]
    table: Turntable | None = None
    home_station: Outer | None = None


@dataclasses.dataclass(frozen=True)
class Drift:
    """What arms that meet by handshake may be off while one is ahead of the other in operation ``name``.

    ``change`` (M,) [m] of the moves: the most by which the distance of the TCPs may differ from the planned
    one in the interval between meetings that the move belongs to. ``worst`` [m] at the move ``row``, of the
    ``segment``.
    """

    name: str
    change: FloatArray
    worst: float
    row: int
    segment: Segment


@dataclasses.dataclass(frozen=True)
class Job:
    """All tasks. ``coupled``: the arms are joined in some operation; ``signals``: what actions switch.

    ``handshake``: each task runs on a controller of its own, and this is how they meet; ``meets`` then counts
    all meetings, the first one in ``main`` too. ``drifts``: of the operations with both arms.
    """

    tasks: tuple[TaskProgram, ...]
    meets: int
    blocks: int
    coupled: bool
    signals: tuple[str, ...]
    handshake: Handshake | None = None
    drifts: tuple[Drift, ...] = ()

    def switched(self, task: TaskProgram) -> tuple[str, ...]:
        """The signals that a task can switch: all, or those that its own controller's actions switch."""
        if self.handshake is None:
            return self.signals
        steps = (step for operation in task.operations for step in operation.steps)
        own = {step.action.signal for step in steps if isinstance(step, Do)}
        return tuple(signal for signal in self.signals if signal in own)


_UNBROKEN = frozenset({"cut", "trim"})
"""Kinds of segments in which a hot wire or a burning arc would wait for the next module."""


def splittable(program: OperationProgram) -> BoolArray:
    """(M,) whether a program may be split behind a move: at stops that do not lie inside one cut, where a hot
    wire or an arc would wait, and where the arms meet anyway."""
    out = program.stop.copy()
    for i in np.flatnonzero(out[:-1] & (program.meets[:-1] == 0)):
        inside = program.segments[i] == program.segments[i + 1] and program.segments[i].kind in _UNBROKEN
        out[i] = not inside
    return out


def number(value: float, decimals: int) -> str:
    """A number with a fixed count of decimals and no negative zero."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def short(value: float, decimals: int = 6) -> str:
    """A number without zeros at its end."""
    text = number(value, decimals)
    return text.rstrip("0").rstrip(".") if "." in text else text


def plain(text: str) -> str:
    """Text in printable ASCII on one line: accents are dropped, letters such as ß spelt, other foreign
    characters become "?"."""
    flat = unicodedata.normalize("NFKD", " ".join(text.translate(SPELT).split()))
    kept = "".join(c for c in flat if not unicodedata.combining(c))
    return "".join(c if 32 <= ord(c) < 127 else "?" for c in kept)


def mark(segment: Segment) -> str:
    """The label by which a program says which segment begins, where no procedure does; names that have more
    than letters, digits and underscores as programs can tell them."""
    label = str(segment)
    return label if re.fullmatch(r"[\w/]+", label, re.ASCII) else segment.key


def confirms(step: Step | None) -> bool:
    """Whether a step is a question."""
    return isinstance(step, Do) and step.action.kind == "confirm"


def question_follows(steps: Sequence[Step]) -> bool:
    """Whether the next step that is more than a message is a question."""
    rest = (step for step in steps if not (isinstance(step, Do) and step.action.kind == "message"))
    return confirms(next(rest, None))


_LEAST_PART_MOVES = 200
"""Where arms meet at every move a part has so many moves at least, or what a module takes."""


@dataclasses.dataclass(frozen=True)
class Part:
    """Rows ``first`` to ``last`` - 1 of an operation's tracks, of one segment; ``module`` counts from 1."""

    segment: Segment
    operation: int
    first: int
    last: int
    module: int


def parts(
    job: Job, sizes: Sequence[IntArray], frame: int, max_moves: int, max_bytes: int
) -> tuple[Part, ...]:
    """The parts of a job in the order in which they run.

    ``sizes``: for each operation the bytes (M,) that its moves take in the largest task; ``frame``: bytes of
    a part without its moves. Raises :class:`TandemError` (``post.no_split``).
    """
    out: list[Part] = []
    load = _Load(frame, max_moves, max_bytes)
    for number, runs in enumerate(_runs(job)):
        program = next(t.operations[number] for t in job.tasks if t.operations[number].track is not None)
        begins = [run.first for run in runs]
        largest = max(1, int(max(sizes[number], default=1)))
        grain = max(1, min(_LEAST_PART_MOVES, max_moves // 4, max_bytes // (4 * largest)))
        for first, last in _spans(runs, program, grain):
            load.add(program, first, last, sizes[number][first:last])
            inside = slice(bisect.bisect_right(begins, first) - 1, bisect.bisect_left(begins, last))
            for run in runs[inside]:
                low, high = max(run.first, first), min(run.last, last)
                if low >= high:
                    continue
                before = out[-1] if out else None
                if (
                    before
                    and (before.operation, before.last, before.module) == (number, low, load.module)
                    and (low > run.first)
                ):
                    out[-1] = dataclasses.replace(before, last=high)
                else:
                    out.append(Part(run.segment, number, low, high, load.module))
    return tuple(out)


def kilobytes(text: str) -> int:
    """How many kilobytes a file of that text has, rounded up."""
    return math.ceil(len(text.encode()) / 1000)


def require_sizes(files: Mapping[str, str], limits: Controller, what: str) -> None:
    """Raise :class:`TandemError` (``post.no_split``) for a file that is larger than the controller takes;
    ``what``: the files in the hint."""
    for path, text in files.items():
        if len(text.encode()) > limits.max_bytes:
            message = f"{path} has {len(text.encode())} bytes; allowed: {limits.max_bytes}"
            hint = f"allow larger {what}: controller: {{max_kilobytes: {kilobytes(text)}}}"
            raise refusal("post.no_split", message, file=path, hint=hint)


def require_one_file(path: str, text: str, limits: Controller, moves: int, what: str) -> None:
    """Raise :class:`TandemError` (``post.no_split``) for a program that cannot be split and has more moves
    or bytes than the controller takes; ``what``: its moves in the message."""
    if moves > limits.max_moves or len(text.encode()) > limits.max_bytes:
        got = f"{path} has {moves} {what} and {len(text.encode())} bytes"
        message = f"{got}; allowed: {limits.max_moves} and {limits.max_bytes}, for it is one program"
        most = max(moves, limits.max_moves), max(kilobytes(text), limits.max_bytes // 1000)
        hint = f"allow it: controller: {{max_moves: {most[0]}, max_kilobytes: {most[1]}}}"
        raise refusal("post.no_split", message, file=path, hint=hint)


class _Load:
    """Fills modules one after the other."""

    def __init__(self, frame: int, max_moves: int, max_bytes: int) -> None:
        self.frame, self.max_moves, self.max_bytes = frame, max_moves, max_bytes
        self.module, self.moves, self.bytes = 1, 0, frame

    def add(self, program: OperationProgram, first: int, last: int, sizes: IntArray) -> None:
        """Place a span of moves that must stay together; sets ``module``."""
        segments = 1 + sum(program.segments[i] != program.segments[i - 1] for i in range(first + 1, last))
        need = int(sizes.sum()) + self.frame * segments
        if last - first > self.max_moves or need + self.frame > self.max_bytes:
            got = f"operation {program.name}: {last - first} moves ({need} bytes) from target row {first} on"
            message = (
                f"{got} have no stop outside the work to split at; a module takes {self.max_moves} moves and "
            )
            message += f"{self.max_bytes} bytes"
            most = max(self.max_moves, last - first), max(self.max_bytes, need + self.frame)
            hint = "let the motion stop between two cuts, or allow larger modules: controller: "
            hint += f"{{max_moves: {most[0]}, max_kilobytes: {math.ceil(most[1] / 1000)}}}"
            raise refusal("post.no_split", message, index=first, hint=hint)
        if self.moves and (self.moves + last - first > self.max_moves or self.bytes + need > self.max_bytes):
            self.module, self.moves, self.bytes = self.module + 1, 0, self.frame
        self.moves += last - first
        self.bytes += need


def _runs(job: Job) -> list[list[Run]]:
    """Runs of each operation, from a task that takes part in it."""
    out = []
    for programs in zip(*(task.operations for task in job.tasks), strict=True):
        moving = next(program for program in programs if program.track is not None)
        out.append([step for step in moving.steps if isinstance(step, Run)])
    return out


def _spans(runs: Sequence[Run], program: OperationProgram, grain: int) -> list[tuple[int, int]]:
    """Spans of moves between places where a program may be split; every operation starts at one. Of meeting
    places within work one at every ``grain`` moves will do."""
    if not runs:
        return []
    places = splittable(program)
    edges = [0]
    for row in np.flatnonzero(places).tolist():
        inside = (
            program.meets[row]
            and row + 1 < len(places)
            and program.segments[row] == program.segments[row + 1]
        )
        if not inside or row + 1 - edges[-1] >= grain:
            edges.append(row + 1)
    return list(itertools.pairwise(edges))
