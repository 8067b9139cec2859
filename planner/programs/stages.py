"""Stages of a job: what happens between two synchronisation points."""

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
        synchronised: Whether both arms move in it.
        ident: The meeting at which it starts.
        steps: Steps by arm.
        ends: Indices of the moves after which the arms meet in it.
    """

    synchronised: bool
    ident: str
    steps: Mapping[str, tuple[ProgramStep, ...]]
    ends: tuple[int, ...]


def program_automata(
    problem: Problem, steps: Mapping[str, Sequence[ProgramStep]], sections: Mapping[str, Sequence[Sections]]
) -> dict[str, ProgramAutomaton]:
    """Return what the programs do with the wires between their controllers, by arm.

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
    """Return the stages between meetings, empty if the programs have different numbers of meetings.

    Consecutive intervals in which both arms only move, equally often, are one stage.

    Args:
        automata_by_arm: What each program does with the wires.
        steps: Steps of the programs by arm.
    """
    out: list[HandshakeStage] = []
    consecutive: list[dict[str, list[ProgramStep]]] = []
    ends: list[int] = []
    intervals = automata.intervals(automata_by_arm, steps)
    for number, interval in enumerate(intervals):
        counts = [sum(isinstance(step, MoveStep) for step in part) for part in interval.values()]
        together = len(counts) > 1 and all(counts)
        plain = len(set(counts)) == 1 and all(
            _needs_no_rest(step) for part in interval.values() for step in part
        )
        if together and plain:
            consecutive.append(interval)
            ends.append((ends[-1] if ends else -1) + counts[0])
            continue
        out += _merge_intervals(consecutive, ends, number)
        consecutive, ends = [], []
        whole = {arm: tuple(part) for arm, part in interval.items()}
        out.append(
            HandshakeStage(together, f"meeting_{number}", whole, (min(counts) - 1,) if together else ())
        )
    return (*out, *_merge_intervals(consecutive, ends, len(intervals)))


def _merge_intervals(
    intervals: Sequence[Mapping[str, Sequence[ProgramStep]]], ends: Sequence[int], next_number: int
) -> list[HandshakeStage]:
    if not intervals:
        return []
    steps = {arm: tuple(step for interval in intervals for step in interval[arm]) for arm in intervals[0]}
    return [HandshakeStage(True, f"meeting_{next_number - len(intervals)}", steps, tuple(ends))]


def _needs_no_rest(step: ProgramStep) -> bool:
    """Whether a step is a move, or does not require the other arm to be at rest."""
    is_plain_message = isinstance(step, MessageStep) and not step.confirm
    return is_plain_message or isinstance(step, MoveStep | CallStep | SettingStep)


CONTROLLER_FOLDER = "controller"
"""Folder of the files for controllers, which are no programs."""
Handlers = Mapping[tuple[str, str], tuple[ProgramStep, ...]]


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
        handlers: Error handlers by module and procedure (RAPID only).
        undos: UNDO sections by module and procedure (RAPID only).
        called: Procedures, as (module, name), that ever run.
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
        ident: Synchronisation point at which it starts, None for the first stage.
        steps: Steps by task.
        ends: For two controllers that meet by handshake the indices of the moves after which they do, else
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
        """Whether all arms make joint moves at once in it, as in an approach or retreat.

        Nothing may join the arms then, and no work is done.
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
    """All tasks and their stages.

    Attributes:
        tasks: The tasks.
        stages: The stages that they share, empty if the synchronisation points do not match.
        faults: Faults of the texts.
        flow_faults: Why tasks whose texts have no faults have no steps.
        strays: Paths of files that belong to no task.
        lists: Texts of program lists by path.
        automata_by_arm: What each program does with the wires between two controllers. None for one
            controller, and for a single program that does not use them.
        notes: Corrections of files before they were read.
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
    """Return whether a file is for a controller and no program."""
    return PurePosixPath(path).parts[0].lower() == CONTROLLER_FOLDER


def sync_points(task: TaskText) -> tuple[SyncStep, ...]:
    """Return the synchronisation points of a task in order."""
    return tuple(step for step in task.steps if isinstance(step, SyncStep))


def split_into_stages(tasks: list[TaskText], confirmations: set[str]) -> tuple[JobStage, ...]:
    """Return the stages if all tasks pass the same synchronisation points, else none.

    A single task meets no other. There the confirmations of setups also separate stages.

    Args:
        tasks: The tasks.
        confirmations: Confirmations of setups.
    """
    rows = [[(step.kind, step.ident) for step in sync_points(task)] for task in tasks]
    if any(row != rows[0] for row in rows):
        return ()
    cuts = [_split_steps(task, confirmations if len(tasks) == 1 else set()) for task in tasks]
    return tuple(
        JobStage(
            inside, ident, {task.name: tuple(cut[number][2]) for task, cut in zip(tasks, cuts, strict=True)}
        )
        for number, (inside, ident, _) in enumerate(cuts[0] if cuts else ())
    )


def _split_steps(task: TaskText, confirmations: set[str]) -> list[tuple[bool, str | None, list[ProgramStep]]]:
    """Steps of a task between synchronisation points, or confirmations that are ``confirmations``.

    Each part states whether all tasks move together in it, and at which point it starts.
    """
    stages: list[tuple[bool, str | None, list[ProgramStep]]] = [(False, None, [])]
    for step in task.steps:
        inside, ident, last = stages[-1]
        if isinstance(step, SyncStep):
            opens, closes = step.kind == "SyncMoveOn", step.kind in ("SyncMoveOff", "SyncMoveUndo")
            stages.append((opens or (inside and not closes), step.ident, []))
        elif isinstance(step, MessageStep) and step.confirm and step.text in confirmations:
            stages += [(inside, ident, [step]), (inside, ident, [])]
        else:
            last.append(step)
    return stages
