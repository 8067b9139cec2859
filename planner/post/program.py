"""What all robot languages share: a plan as steps of each task, before any word of a language is chosen.

Tasks go through the same operations side by side. Outside synchronised blocks one arm works while the others
wait at the next :class:`Meet`; inside, the tasks have equal runs of moves, pair by pair. An action always
stands outside a block.

Two controllers that share digital signals only (:class:`planner.handshake.Handshake`) meet inside blocks too:
at the moves that :attr:`OperationProgram.meets` numbers.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import RobotData
from planner.handshake import Handshake
from planner.problem import Arm
from planner.segments import Segment
from planner.targets import Action

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

POSITION_DECIMALS = 4
"""Decimals of positions in mm; what is equal after rounding is the same place."""
QUATERNION_DECIMALS = 8
TIME_DECIMALS = 5
"""Decimals of the times of moves in s."""


@dataclasses.dataclass(frozen=True)
class Joints:
    """The arm goes alone to the joints ``q`` (6,) [rad, serial], straight in joint space, and stops."""

    q: FloatArray
    place: str


@dataclasses.dataclass(frozen=True)
class Meet:
    """All tasks wait here for each other; ``number`` from 1. ``reached``: what is then so. ``seconds``: what
    one of them does alone before takes so long by the plan, as far as the plan says."""

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
    ``reach`` (M,) [mm] and ``reach_turn`` (M,) [rad]: the most that a zone at the target may take.
    """

    position: FloatArray
    quaternion: FloatArray
    q: FloatArray
    duration: FloatArray
    distance: FloatArray
    reach: FloatArray
    reach_turn: FloatArray
    frame: str


@dataclasses.dataclass(frozen=True)
class Run:
    """Rows ``first`` to ``last`` - 1 of the operation's track: one visit of ``segment``."""

    operation: int
    segment: Segment
    first: int
    last: int
    synchronised: bool


Step = Joints | Meet | SyncOn | SyncOff | Do | Carry | Run


@dataclasses.dataclass(frozen=True)
class OperationProgram:
    """One operation of one task; ``ids``, ``stop``: (M,) of the moves. An arm that waits has no ``track``.

    ``meets`` (M,): the number of the handshake behind each move, counted with the :class:`Meet` of the job; 0
    for none. ``setup`` counts from 1; ``arm`` is the arm with the tool that it carries then.
    """

    name: str
    setup: int
    arm: Arm
    track: Track | None
    ids: IntArray
    stop: BoolArray
    meets: IntArray
    segments: tuple[Segment, ...]
    steps: tuple[Step, ...]


@dataclasses.dataclass(frozen=True)
class TaskProgram:
    """The program of one arm; ``number`` counts the tasks from 1. ``arm`` is as the first setup has it."""

    number: int
    task: str
    unit: str
    arm: Arm
    robot: RobotData
    base: FloatArray
    operations: tuple[OperationProgram, ...]


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


def splittable(program: OperationProgram) -> BoolArray:
    """(M,) whether a program may be split behind a move: at stops that do not lie inside one cut, where a hot
    wire would wait, and where the arms meet anyway."""
    out = program.stop.copy()
    for i in np.flatnonzero(out[:-1] & (program.meets[:-1] == 0)):
        inside = program.segments[i] == program.segments[i + 1] and program.segments[i].kind == "cut"
        out[i] = not inside
    return out
