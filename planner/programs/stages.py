"""Stages of a job: what happens between two synchronisation points."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import NamedTuple

from planner.problem import Arm, Problem
from planner.programs.handshake import automata
from planner.programs.handshake.automata import Reading, Sections
from planner.programs.program_text import ProgramText
from planner.programs.steps import CallStep, Fault, MessageStep, MoveStep, SettingStep, Step, SyncStep


class Part(NamedTuple):
    """One stage: whether both arms move in it, the meeting it begins with, steps by arm, and the moves behind
    which the arms meet in it, by index."""

    together: bool
    ident: str
    steps: Mapping[str, tuple[Step, ...]]
    ends: tuple[int, ...]


def readings(
    problem: Problem, steps: Mapping[str, Sequence[Step]], sections: Mapping[str, Sequence[Sections]]
) -> dict[str, Reading]:
    """What the programs of the arms in ``steps`` do with the wires between their controllers."""
    own = problem.cell.controller.handshake
    return automata.read(list(steps), steps, sections, wiring(problem), own.kind, own.timeout)


def wiring(problem: Problem) -> automata.Wiring:
    """The wires between the controllers of the cell."""
    arms = [arm.name for arm in problem.cell.arms]
    own = problem.cell.controller.handshake
    return automata.Wiring.of(own.wired(arms), arms, own.wired_running(arms))


def parts(found: Mapping[str, Reading], steps: Mapping[str, Sequence[Step]]) -> tuple[Part, ...]:
    """Intervals between meetings; those in a row in which both arms do nothing but move, as often, are one
    stage. None where the programs have different numbers of meetings."""
    out: list[Part] = []
    row: list[dict[str, list[Step]]] = []
    ends: list[int] = []
    intervals = automata.intervals(found, steps)
    for number, interval in enumerate(intervals):
        counts = [sum(isinstance(step, MoveStep) for step in part) for part in interval.values()]
        together = len(counts) > 1 and all(counts)
        plain = len(set(counts)) == 1 and all(_plain(step) for part in interval.values() for step in part)
        if together and plain:
            row.append(interval)
            ends.append((ends[-1] if ends else -1) + counts[0])
            continue
        out += _joined(row, ends, number)
        row, ends = [], []
        whole = {arm: tuple(part) for arm, part in interval.items()}
        out.append(Part(together, f"meeting_{number}", whole, (min(counts) - 1,) if together else ()))
    return (*out, *_joined(row, ends, len(intervals)))


def _joined(row: Sequence[Mapping[str, Sequence[Step]]], ends: Sequence[int], behind: int) -> list[Part]:
    if not row:
        return []
    steps = {arm: tuple(step for interval in row for step in interval[arm]) for arm in row[0]}
    return [Part(True, f"meeting_{behind - len(row)}", steps, tuple(ends))]


def _plain(step: Step) -> bool:
    """Whether a step is a move, or nothing that needs the other arm to be at rest."""
    talks = isinstance(step, MessageStep) and not step.confirm
    return talks or isinstance(step, MoveStep | CallStep | SettingStep)


CONTROLLER = "controller"
"""Folder of the files for controllers, which are no programs."""
Handlers = Mapping[tuple[str, str], tuple[Step, ...]]


@dataclasses.dataclass(frozen=True, eq=False)
class TaskText:
    """A task.

    Attributes:
        name: Name of the task.
        arm: The arm that the task moves.
        text: Text of the program.
        steps: What the program does without errors, in order.
        files: Texts of the files by path.
        unit: Name of the arm in work objects of other arms that it carries.
        handlers: Error handlers by module and procedure. RAPID alone has them.
        undos: UNDO sections by module and procedure. RAPID alone has them.
        called: Procedures, as (module, name), that ever run.
    """

    name: str
    arm: Arm
    text: ProgramText
    steps: tuple[Step, ...]
    files: Mapping[str, str]
    unit: str = ""
    handlers: Handlers = dataclasses.field(default_factory=dict)
    undos: Handlers = dataclasses.field(default_factory=dict)
    called: frozenset[tuple[str, str]] = frozenset()


@dataclasses.dataclass(frozen=True)
class Stage:
    """Steps of each task between two synchronisation points. ``opened`` by ``ident`` (None for the first
    stage). ``ends``: where two controllers meet by handshake, the moves in it behind which they do, by
    index; else empty."""

    synchronised: bool
    ident: str | None
    steps: Mapping[str, tuple[Step, ...]]
    ends: tuple[int, ...] = ()

    def moves(self, task: str) -> tuple[MoveStep, ...]:
        """The moves of one task."""
        return self._moves[task]

    @functools.cached_property
    def is_way(self) -> bool:
        """Whether it is synchronised for a way that all arms go at once, each by joints: nothing may join
        them there, and no work is done."""
        moves = [move for task in self.steps for move in self._moves[task]]
        return self.synchronised and not self.ends and bool(moves) and all(move.by_joints for move in moves)

    @functools.cached_property
    def _moves(self) -> dict[str, tuple[MoveStep, ...]]:
        return {
            task: tuple(step for step in steps if isinstance(step, MoveStep))
            for task, steps in self.steps.items()
        }


@dataclasses.dataclass(frozen=True)
class JobText:
    """All tasks, the stages they share (empty where the synchronisation points do not match), and faults of
    reading. ``readings``: what each program does with the wires between two controllers, None for one, and
    for a program alone that has nothing to do with them;
    ``notes``: what was put right in files before they were read."""

    tasks: tuple[TaskText, ...]
    stages: tuple[Stage, ...]
    faults: tuple[Fault, ...]
    flow: tuple[Fault, ...]
    strays: tuple[str, ...]
    lists: Mapping[str, str]
    readings: Mapping[str, Reading] | None = None
    notes: tuple[Fault, ...] = ()


def beside(path: str) -> bool:
    """Whether a file is for a controller, and no program."""
    return PurePosixPath(path).parts[0].lower() == CONTROLLER


def sync_points(task: TaskText) -> tuple[SyncStep, ...]:
    """The synchronisation points of a task in order."""
    return tuple(step for step in task.steps if isinstance(step, SyncStep))


def split_into_stages(tasks: list[TaskText], asked: set[str]) -> tuple[Stage, ...]:
    """Stages where all tasks pass the same synchronisation points, else none.

    A task that is alone meets nobody: there the confirmations ``asked`` of setups part the stages too.
    """
    rows = [[(step.kind, step.ident) for step in sync_points(task)] for task in tasks]
    if any(row != rows[0] for row in rows):
        return ()
    cuts = [_cut(task, asked if len(tasks) == 1 else set()) for task in tasks]
    return tuple(
        Stage(
            inside, ident, {task.name: tuple(cut[number][2]) for task, cut in zip(tasks, cuts, strict=True)}
        )
        for number, (inside, ident, _) in enumerate(cuts[0] if cuts else ())
    )


def _cut(task: TaskText, asked: set[str]) -> list[tuple[bool, str | None, list[Step]]]:
    """The steps of a task from one synchronisation point, or confirmation that is ``asked``, to the next:
    whether all tasks move together there, and by what that begins."""
    stages: list[tuple[bool, str | None, list[Step]]] = [(False, None, [])]
    for step in task.steps:
        inside, ident, last = stages[-1]
        if isinstance(step, SyncStep):
            opens, closes = step.kind == "SyncMoveOn", step.kind in ("SyncMoveOff", "SyncMoveUndo")
            stages.append((opens or (inside and not closes), step.ident, []))
        elif isinstance(step, MessageStep) and step.confirm and step.text in asked:
            stages += [(inside, ident, [step]), (inside, ident, [])]
        else:
            last.append(step)
    return stages
