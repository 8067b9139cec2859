"""Stages of a job: the steps of all tasks between two synchronisation points."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import NamedTuple

from planner.problem import Arm, Problem
from planner.programs.handshake import automata
from planner.programs.handshake.automata import ProgramAutomaton, Sections
from planner.programs.program_text import ProgramText
from planner.programs.steps import (
    CallStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    SettingStep,
    SyncStep,
    TextFault,
)


class HandshakeStage(NamedTuple):
    """One stage of two controllers that meet by handshake.

    Attributes:
        synchronised: Whether both arms move in this stage.
        ident: Name of the meeting at which it starts.
        steps: Steps by arm.
        ends: Indices of the moves of the stage after which the arms meet.
    """

    synchronised: bool
    ident: str
    steps: Mapping[str, tuple[ProgramStep, ...]]
    ends: tuple[int, ...]


def program_automata(
    problem: Problem, steps: Mapping[str, Sequence[ProgramStep]], sections: Mapping[str, Sequence[Sections]]
) -> dict[str, ProgramAutomaton]:
    """Return the automata of the programs, which state what each does with the wires, by arm.

    Args:
        problem: The problem.
        steps: Steps of the programs by arm.
        sections: ERROR and UNDO sections of the programs by arm.
    """
    handshake = problem.cell.controller.handshake
    return automata.program_automata(
        list(steps), steps, sections, controller_wiring(problem), handshake.kind, handshake.timeout
    )


def controller_wiring(problem: Problem) -> automata.Wiring:
    """Return the wires between the controllers of the cell."""
    arms = [arm.name for arm in problem.cell.arms]
    handshake = problem.cell.controller.handshake
    return automata.Wiring.of(handshake.meeting_wires(arms), arms, handshake.running_wires(arms))


def handshake_stages(
    automata_by_arm: Mapping[str, ProgramAutomaton], steps: Mapping[str, Sequence[ProgramStep]]
) -> tuple[HandshakeStage, ...]:
    """Return the stages of programs that meet by handshake, from which the replay gets the motion.

    Each interval between two meetings is a stage, with one exception: consecutive intervals are one stage if
    in each of them both arms move, with equal numbers of moves, and no step requires that the other arm
    rests. There are no stages if the programs have different numbers of meetings.

    Args:
        automata_by_arm: Automata of the programs.
        steps: Steps of the programs by arm.
    """
    out: list[HandshakeStage] = []
    consecutive: list[dict[str, list[ProgramStep]]] = []
    ends: list[int] = []
    intervals = automata.intervals(automata_by_arm, steps)
    for number, interval in enumerate(intervals):
        counts = [sum(isinstance(step, MoveStep) for step in part) for part in interval.values()]
        together = len(counts) > 1 and all(counts)
        needs_no_rest = len(set(counts)) == 1 and all(
            _needs_no_rest(step) for part in interval.values() for step in part
        )
        if together and needs_no_rest:
            consecutive.append(interval)
            ends.append((ends[-1] if ends else -1) + counts[0])
            continue
        out += _merge_intervals(consecutive, ends, number)
        consecutive, ends = [], []
        stage_steps = {arm: tuple(part) for arm, part in interval.items()}
        out.append(
            HandshakeStage(together, f"meeting_{number}", stage_steps, (min(counts) - 1,) if together else ())
        )
    return (*out, *_merge_intervals(consecutive, ends, len(intervals)))


def _merge_intervals(
    intervals: Sequence[Mapping[str, Sequence[ProgramStep]]], ends: Sequence[int], next_number: int
) -> list[HandshakeStage]:
    """Return consecutive intervals as one synchronised stage, in a list; an empty list for no interval.

    Args:
        intervals: Steps of each interval, by arm.
        ends: Index, among the moves of the stage, of the last move of each interval.
        next_number: Number of the interval after them.
    """
    if not intervals:
        return []
    steps = {arm: tuple(step for interval in intervals for step in interval[arm]) for arm in intervals[0]}
    return [HandshakeStage(True, f"meeting_{next_number - len(intervals)}", steps, tuple(ends))]


def _needs_no_rest(step: ProgramStep) -> bool:
    """Return whether the other arm may move during a step.

    It may move during a move, a message without a question, a call or a setting, but not during a wait, a
    question or a change of an output.
    """
    is_plain_message = isinstance(step, MessageStep) and not step.confirm
    return is_plain_message or isinstance(step, MoveStep | CallStep | SettingStep)


CONTROLLER_FOLDER = "controller"
"""Folder of the files for the configuration of controllers, which are not programs."""
Handlers = Mapping[tuple[str, str], tuple[ProgramStep, ...]]
"""Steps of error handlers or UNDO sections by (module, procedure)."""


@dataclasses.dataclass(frozen=True, eq=False)
class TaskText:
    """Program of one arm as read.

    Attributes:
        name: Name of the task.
        arm: The arm that the task moves.
        text: Text of the program.
        steps: Steps that the program executes if no error occurs, in order.
        files: Texts of the files by path.
        unit: Mechanical unit of the arm, by which work objects of another arm refer to it if it carries them.
        handlers: Error handlers by module and procedure (RAPID only).
        undos: UNDO sections by module and procedure (RAPID only).
        called: Procedures, as (module, name), that the program ever calls.
    """

    name: str
    arm: Arm
    text: ProgramText
    steps: tuple[ProgramStep, ...]
    files: Mapping[str, str]
    unit: str = ""
    handlers: Handlers = dataclasses.field(default_factory=dict)
    undos: Handlers = dataclasses.field(default_factory=dict)
    called: frozenset[tuple[str, str]] = frozenset()


@dataclasses.dataclass(frozen=True)
class JobStage:
    """Steps of each task between two synchronisation points.

    Attributes:
        synchronised: Whether the moves of all tasks run in pairs.
        ident: Name of the synchronisation point at which the stage starts, None for the first stage.
        steps: Steps by task.
        ends: For two controllers that meet by handshake the indices of the moves after which they meet, else
            empty.
    """

    synchronised: bool
    ident: str | None
    steps: Mapping[str, tuple[ProgramStep, ...]]
    ends: tuple[int, ...] = ()

    def moves(self, task: str) -> tuple[MoveStep, ...]:
        """Return the moves of one task."""
        return self._moves[task]

    @functools.cached_property
    def is_synchronised_approach(self) -> bool:
        """Whether all arms make joint moves at once in this stage, as in an approach or retreat.

        No wire or block may join the arms then, and they do no work.
        """
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
    """All tasks of a job as read, and their stages.

    Attributes:
        tasks: The tasks.
        stages: Stages of all tasks, empty if the synchronisation points of the tasks do not match.
        faults: Faults of the texts.
        flow_faults: Reasons why tasks have no steps although their texts have no faults.
        strays: Paths of files that belong to no task.
        lists: Texts of program lists by path.
        automata_by_arm: Automata of the programs, which state what each does with the wires between two
            controllers. None for one controller, and for a single program that does not use the wires.
        notes: Corrections that were made to files before they were read.
    """

    tasks: tuple[TaskText, ...]
    stages: tuple[JobStage, ...]
    faults: tuple[TextFault, ...]
    flow_faults: tuple[TextFault, ...]
    strays: tuple[str, ...]
    lists: Mapping[str, str]
    automata_by_arm: Mapping[str, ProgramAutomaton] | None = None
    notes: tuple[TextFault, ...] = ()


def is_controller_file(path: str) -> bool:
    """Return whether a file is for the configuration of a controller, and not a program."""
    return PurePosixPath(path).parts[0].lower() == CONTROLLER_FOLDER


def sync_points(task: TaskText) -> tuple[SyncStep, ...]:
    """Return the synchronisation points of a task in order."""
    return tuple(step for step in task.steps if isinstance(step, SyncStep))


def split_into_stages(tasks: list[TaskText], confirmations: set[str]) -> tuple[JobStage, ...]:
    """Return the stages if all tasks pass the same synchronisation points, else none.

    A single task has no synchronisation points. There the confirmations of setups separate stages.

    Args:
        tasks: The tasks.
        confirmations: Texts of the questions with which operators confirm setups.
    """
    points_by_task = [[(step.kind, step.ident) for step in sync_points(task)] for task in tasks]
    if any(points != points_by_task[0] for points in points_by_task):
        return ()
    parts_by_task = [_split_steps(task, confirmations if len(tasks) == 1 else set()) for task in tasks]
    return tuple(
        JobStage(
            synchronised,
            ident,
            {task.name: tuple(parts[number][2]) for task, parts in zip(tasks, parts_by_task, strict=True)},
        )
        for number, (synchronised, ident, _) in enumerate(parts_by_task[0] if parts_by_task else ())
    )


def _split_steps(task: TaskText, confirmations: set[str]) -> list[tuple[bool, str | None, list[ProgramStep]]]:
    """Split the steps of a task at synchronisation points and at questions whose text is a confirmation.

    A question is a part by itself.

    Returns:
        For each part: whether all tasks move together in it, the name of the synchronisation point at which
        it starts (None before the first one), and its steps.
    """
    parts: list[tuple[bool, str | None, list[ProgramStep]]] = [(False, None, [])]
    for step in task.steps:
        synchronised, ident, current_steps = parts[-1]
        if isinstance(step, SyncStep):
            opens, closes = step.kind == "SyncMoveOn", step.kind in ("SyncMoveOff", "SyncMoveUndo")
            parts.append((opens or (synchronised and not closes), step.ident, []))
        elif isinstance(step, MessageStep) and step.confirm and step.text in confirmations:
            parts += [(synchronised, ident, [step]), (synchronised, ident, [])]
        else:
            current_steps.append(step)
    return parts
