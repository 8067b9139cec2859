"""The job as its programs tell it: stages between synchronisation points, and the setups in force.

The programs of all tasks are laid side by side. A stage is what happens between two synchronisation
points. In a synchronised one the moves of all tasks run in pairs; in any other one at most one task
may move, so that no order of events depends on chance. Two controllers that meet by signals are
laid side by side in the same way: what happens between their meetings.

A setup with steps begins at the stage where the operator confirms it (`spans`).
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Final, NamedTuple

import numpy as np

from planner.claims.claim import Claim, ContactOnlyIn, FeedWindow, HoldsStock
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import TandemError
from planner.languages.krl.reader import reader
from planner.languages.krl.reader.flow import Signals
from planner.languages.krl.reader.reader import KrlText
from planner.languages.rapid.reader.reader import MOST_KEPT, Flow, Limits, Task, flow, read_task
from planner.languages.rapid.reader.syntax_tree import Module
from planner.languages.trajectories.reader import flow as trajectory_flow
from planner.languages.trajectories.reader import rows as trajectory_rows
from planner.languages.urscript.reader import flow as script_flow
from planner.languages.urscript.reader import reader as script_reader
from planner.languages.urscript.reader.reader import ScriptText
from planner.problem import Arm, Problem, Setup
from planner.processes.forming.claims import SheetState
from planner.processes.hotwire.claims import StraightWire, WireJoins
from planner.processes.milling.claims import MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.processes.trim.claims import TrimsSheet, slot_names
from planner.programs import text as program_text
from planner.programs.handshake import automata
from planner.programs.handshake.automata import Reading, Sections
from planner.programs.steps import (
    CallStep,
    Fault,
    FlowError,
    MessageStep,
    MoveStep,
    SettingStep,
    Step,
    SyncStep,
    letters,
)
from planner.proof.kinematics.arm_model import machine_of


@dataclasses.dataclass(frozen=True, eq=False)
class TrajectoryText:
    """The program that moves an arm, perhaps with others, and the arm's ``base`` (4, 4) by it."""

    program: trajectory_rows.Program
    base: FloatArray

    @property
    def digest(self) -> str:
        """The problem that the program names."""
        return self.program.digest


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


MODULES = (".mod", ".modx", ".sys", ".sysx")
"""Endings of the names of RAPID modules."""
CONTROLLER = "controller"
"""Folder of the files for controllers, which are no programs."""

Handlers = Mapping[tuple[str, str], tuple[Step, ...]]


@dataclasses.dataclass(frozen=True, eq=False)
class TaskText:
    """One task: its arm, its modules, its straight way, its error handlers and UNDO sections, and the
    procedures (module, name) that ever run. A KRL task has ``krl`` in place of modules, and no sections; so
    has one of URScript its ``script``, and an arm of a trajectory file its ``trajectory``."""

    name: str
    unit: str
    arm: Arm
    modules: tuple[Module, ...]
    steps: tuple[Step, ...]
    handlers: Handlers
    undos: Handlers
    called: frozenset[tuple[str, str]]
    files: Mapping[str, str]
    krl: KrlText | None = None
    script: ScriptText | None = None
    trajectory: TrajectoryText | None = None

    @property
    def rapid(self) -> bool:
        """Whether the task is RAPID."""
        return self.krl is None and self.script is None and self.trajectory is None


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


def task_names(problem: Problem) -> tuple[str, ...]:
    """What the tasks of the arms are called here: those of two controllers may have one name, and KUKA's and
    UR's have none, so by arm."""
    controller = problem.cell.controller
    alone = controller.sync == "handshake"
    tasks = (*controller.tasks, *("" for _ in problem.cell.arms))
    own = [
        alone or speaks_krl(arm) or speaks_urscript(arm) or speaks_trajectories(arm)
        for arm in problem.cell.arms
    ]
    return tuple(
        arm.name if by_arm else task
        for arm, task, by_arm in zip(problem.cell.arms, tasks, own, strict=False)
        if task or by_arm
    )


def speaks_krl(arm: Arm) -> bool:
    """Whether the arm's programs are KRL."""
    return arm.data.family == "KUKA"


def speaks_urscript(arm: Arm) -> bool:
    """Whether the arm's programs are URScript."""
    return arm.data.family == "UR"


def speaks_trajectories(arm: Arm) -> bool:
    """Whether the arm is driven by joint trajectories of ROS 2."""
    return arm.data.family == "ROS"


TRAJECTORY: Final = ".jsonl"
"""Ending of the name of the one file of all arms that are driven by trajectories."""


def endings(arm: Arm) -> tuple[str, ...]:
    """Endings of the names of the files of an arm's programs."""
    if speaks_krl(arm):
        return (".src", ".dat")
    if speaks_trajectories(arm):
        return (TRAJECTORY,)
    return (".script",) if speaks_urscript(arm) else MODULES


def task_files(problem: Problem, programs: Mapping[str, str]) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Files of each task by the task's name in the path, of an arm with a controller of its own by the arm's
    folder, and the files that belong to none."""
    names = task_names(problem)
    found: dict[str, dict[str, str]] = {task: {} for task in names}
    arms = dict(zip(names, problem.cell.arms, strict=False))
    folders = {name for name, arm in arms.items() if speaks_krl(arm) or speaks_urscript(arm)}
    folders |= set(names) if problem.cell.controller.sync == "handshake" else set()
    driven = [name for name, arm in arms.items() if speaks_trajectories(arm)]
    strays: list[str] = []
    for path, text in sorted(programs.items()):
        suffix = PurePosixPath(path).suffix.lower()
        if suffix == ".pgf":
            continue
        if driven and suffix == TRAJECTORY:
            for name in driven:
                found[name][path] = text
            continue
        where = [part.lower() for part in PurePosixPath(path).parent.parts]
        words = [
            task
            for task in found
            if task not in driven
            and suffix in endings(arms[task])
            and (
                task.lower() in where
                if task in folders
                else re.search(rf"(?i)(?<![a-z0-9]){re.escape(task)}(?![a-z0-9])", path)
            )
        ]
        if len(words) == 1:
            found[words[0]][path] = text
        else:
            strays.append(path)
    return found, strays


def controllers(problem: Problem, tasks: Sequence[TaskText]) -> tuple[tuple[TaskText, ...], ...]:
    """The tasks by the controllers that run them, which alone have their signals: those of one ABB controller
    together, those of one file of trajectories, each of KUKA and UR, and of two controllers that share
    signals by wires, by itself."""
    alone = problem.cell.controller.sync == "handshake"
    out: dict[str, list[TaskText]] = {}
    for task in tasks:
        one = task.rapid or task.trajectory is not None
        out.setdefault("" if one and not alone else task.arm.name, []).append(task)
    return tuple(map(tuple, out.values()))


def read(problem: Problem, programs: Mapping[str, str]) -> JobText:
    """Read everything. Faults are collected, never raised; a task that cannot be read has no steps."""
    controller = problem.cell.controller
    plain = {path: program_text.settled(path, text) for path, text in programs.items() if not beside(path)}
    programs = {path: text for path, (text, _) in plain.items()}
    notes = tuple(note for _, found in plain.values() for note in found)
    files, strays = task_files(problem, programs)
    tasks: list[TaskText] = []
    faults: list[Fault] = []
    no_way: list[Fault] = []
    names = task_names(problem)
    driven = [name for name, arm in zip(names, problem.cell.arms, strict=False) if speaks_trajectories(arm)]
    if driven and files[driven[0]]:
        found_tasks, wrong, lost = _trajectory_tasks(problem, files[driven[0]])
        tasks += found_tasks
        faults += wrong
        no_way += lost
    for number, arm in enumerate(problem.cell.arms):
        if number >= len(names) or not files[names[number]] or names[number] in driven:
            continue
        one = _krl_task if speaks_krl(arm) else _script_task if speaks_urscript(arm) else _rapid_task
        task, wrong, lost = one(problem, number, names[number], files[names[number]])
        tasks.append(task)
        faults += wrong
        no_way += lost
    lists = {path: text for path, text in programs.items() if path.lower().endswith(".pgf")}
    asked = {setup.confirmation for setup in setups_of(problem) if setup.steps}
    found: Mapping[str, Reading] | None = None
    stages = _stages(tasks, asked)
    if controller.sync == "handshake":
        ways = {task.name: task.steps for task in tasks}
        aside = {task.name: (task.handlers, task.undos) for task in tasks}
        if not (len(tasks) == 1 and _alone(problem, tasks[0])):
            found = readings(problem, ways, aside)
        if found is not None and len(tasks) > 1:
            stages = tuple(Stage(*part) for part in parts(found, ways))
    return JobText(tuple(tasks), stages, tuple(faults), tuple(no_way), tuple(strays), lists, found, notes)


def _alone(problem: Problem, task: TaskText) -> bool:
    """Whether the job needs one arm of a cell of two controllers, and its program leaves the other one's
    wires alone."""
    holders = (setup.stock.held_by for setup in problem.setups)
    needed = {arm for operation in problem.operations for arm in operation.arms} | set(filter(None, holders))
    aside = task.handlers, task.undos
    touches = automata.touches(task.name, task.steps, aside, wiring(problem))
    return needed <= {task.arm.name} and not touches


_Read = tuple[TaskText, Sequence[Fault], Sequence[Fault]]
"""A task, faults of its texts, and why it has no straight way."""


def _followed(files: tuple[tuple[str, str], ...], most_bytes: int) -> tuple[Task, Flow, tuple[Fault, ...]]:
    """Modules of a task by their names, all that they may do, and why they have no straight way."""
    text = read_task(dict(files), Limits(bytes=most_bytes))
    way, lost = Flow((), {}, {}, frozenset()), tuple[Fault, ...]()
    if not text.faults:
        try:
            way = flow(text.modules)
        except FlowError as wrong:
            lost = wrong.faults
    return text, way, lost


_kept = functools.lru_cache(maxsize=8)(_followed)
"""Remembered: where programs differ in one task, the others are followed once."""


def _rapid_task(problem: Problem, number: int, name: str, files: Mapping[str, str]) -> _Read:
    controller = problem.cell.controller
    short = sum(map(len, files.values())) <= MOST_KEPT
    text, way, lost = (_kept if short else _followed)(tuple(files.items()), controller.max_bytes)
    unit = controller.units[number] if number < len(controller.units) else ""
    parts = (way.steps, way.handlers, way.undos, way.called)
    task = TaskText(name, unit, problem.cell.arms[number], text.modules, *parts, files)
    return task, text.faults, lost


def _krl_task(problem: Problem, number: int, name: str, files: Mapping[str, str]) -> _Read:
    controller, arm = problem.cell.controller, problem.cell.arms[number]
    text = reader.read(files, controller.max_bytes, controller.dialect)
    steps, entered, lost = tuple[Step, ...](), frozenset[str](), tuple[Fault, ...]()
    if not text.faults:
        base = arm.base if text.base is None else text.base
        try:
            others = [other.name for other in problem.cell.arms if other.name != arm.name]
            signals = krl_signals(problem, arm)
            steps, entered = reader.flow(text, base, signals, arm.name, others, _along(arm))
        except FlowError as wrong:
            lost = wrong.faults
    called = frozenset(("", program) for program in entered)
    return TaskText(name, "", arm, (), steps, {}, {}, called, files, text), text.faults, lost


def _along(arm: Arm) -> dict[int, tuple[float, float, float]]:
    """The unit vectors, in the axes of an arm's foot, along which external axes move it, by their columns."""
    out = {}
    for rail in arm.axes:
        x, y, z = (float(column @ rail.axis) for column in arm.base[:3, :3].T)
        out[rail.column] = (x, y, z)
    return out


def _script_task(problem: Problem, number: int, name: str, files: Mapping[str, str]) -> _Read:
    return script_task(problem, problem.cell.arms[number], name, files)


def script_task(problem: Problem, arm: Arm, name: str, files: Mapping[str, str]) -> _Read:
    """The task of an arm of UR, faults of its texts, and why it has no straight way."""
    controller = problem.cell.controller
    text = script_reader.read(files, controller.max_bytes)
    steps, lost = tuple[Step, ...](), tuple[Fault, ...]()
    if not text.faults and text.program is not None:
        names = krl_signals(problem, arm)
        wires = script_flow.Wires(names.outputs, names.inputs)
        others = [other.name for other in problem.cell.arms if other.name != arm.name]
        if controller.sync == "handshake" and others:
            own = controller.handshake.of(arm.name)
            wires = dataclasses.replace(wires, other=others[0], line=own.output, running=own.running)
        try:
            base = arm.base @ machine_of(arm.data).table.base if text.base is None else text.base
            steps = script_flow.flow(text, base, wires, arm.name, arm.robot, arm.data.velocity)
        except FlowError as wrong:
            lost = wrong.faults
        except TandemError as wrong:
            what = wrong.issues[0].message
            lost = (Fault(1, 1, "urscript.flow", what, text.program.file),)
    task = TaskText(name, "", arm, (), steps, {}, {}, frozenset(), files, None, text)
    return task, text.faults, lost


def _trajectory_tasks(
    problem: Problem, files: Mapping[str, str]
) -> tuple[list[TaskText], Sequence[Fault], Sequence[Fault]]:
    """The tasks of all arms that one file of trajectories moves, faults of its rows, and why they have no
    straight way."""
    file = sorted(files)[0]
    program, faults = trajectory_rows.read(file, files[file], problem.cell.controller.max_bytes)
    arms = {arm.name: arm for arm in problem.cell.arms if speaks_trajectories(arm)}
    lost: list[Fault] = []
    if len(files) > 1:
        what = f"{len(files)} files of trajectories, {', '.join(sorted(files))}; one clock moves all arms, "
        what += "so that one file is wanted"
        faults = (*faults, Fault(1, 1, "trajectory.name_file", what, sorted(files)[1]))
    if program is None:
        return [], faults, lost
    steps: Mapping[str, tuple[Step, ...]] = {}
    wanted = {name: joint_names(problem, arm) for name, arm in arms.items()}
    for row in program.arms:
        if row.arm not in wanted:
            what = f"there is no arm {row.arm} that trajectories move; known are {', '.join(wanted)}"
            lost.append(Fault(row.line, 1, "trajectory.flow", what, file))
        elif row.robot != arms[row.arm].robot:
            what = f"arm {row.arm} is said to be {row.robot}; wanted: {arms[row.arm].robot}"
            lost.append(Fault(row.line, 1, "trajectory.flow", what, file))
        elif row.joints != wanted[row.arm]:
            what = f"the joints of {row.arm} ({row.robot}) are {', '.join(row.joints)}; wanted: "
            what += f"{', '.join(wanted[row.arm])}, in this order"
            lost.append(Fault(row.line, 1, "trajectory.flow", what, file))
    order = [row.arm for row in program.arms]
    if order != [name for name in wanted if name in order]:
        what = f"the arms stand as {', '.join(order)}; wanted: the cell's order"
        lost.append(Fault(program.arms[0].line, 1, "trajectory.flow", what, file))
    if not lost:
        try:
            steps = trajectory_flow.flow(program, {name: arm.data for name, arm in arms.items()})
        except FlowError as wrong:
            lost += wrong.faults
    tasks = []
    for row in program.arms:
        if row.arm in arms:
            text = TrajectoryText(program, trajectory_flow.pose(row.base))
            way, none = steps.get(row.arm, ()), frozenset[tuple[str, str]]()
            tasks.append(
                TaskText(row.arm, row.arm, arms[row.arm], (), way, {}, {}, none, files, trajectory=text)
            )
    return tasks, faults, lost


def joint_names(problem: Problem, arm: Arm) -> tuple[str, ...]:
    """What a controller of trajectories calls the joints of an arm: the names of its URDF behind the prefix
    that the cell states."""
    prefix = problem.cell.controller.joint_prefix.get(arm.name, "")
    return tuple(f"{prefix}{name}" for name in arm.data.joints)


def krl_signals(problem: Problem, arm: Arm) -> Signals:
    """Names of the inputs and outputs of a KUKA or UR controller by number, as the cell states them; inputs
    are those of a handshake and those that operations wait for. A number that two names of one kind share has
    both for a name: which one is meant is not known."""
    controller = problem.cell.controller
    own = controller.handshake.of(arm.name)
    reads = {own.input.lower(), own.partner_running.lower()} if controller.sync == "handshake" else set()
    waits = (getattr(operation, "ok_signal", None) for operation in problem.operations)
    reads |= {name.lower() for name in waits if isinstance(name, str)}
    tables: tuple[dict[int, str], dict[int, str]] = ({}, {})
    for name, value in controller.io.get(arm.name, {}).items():
        table = tables[name.lower() in reads]
        table[value] = f"{table[value]} and {name}" if value in table else name
    return Signals(*tables)


def sync_points(task: TaskText) -> tuple[SyncStep, ...]:
    """The synchronisation points of a task in order."""
    return tuple(step for step in task.steps if isinstance(step, SyncStep))


def _stages(tasks: list[TaskText], asked: set[str]) -> tuple[Stage, ...]:
    """Stages where all tasks pass the same synchronisation points, else none.

    A task that is alone meets nobody: there the confirmations ``asked`` of setups part the stages too.
    """
    if not tasks:
        return ()
    if len(tasks) == 1:
        return _lone_stages(tasks[0], asked)
    rows = [[(step.kind, step.ident) for step in sync_points(task)] for task in tasks]
    if any(row != rows[0] for row in rows):
        return ()
    cut: list[list[tuple[Step, ...]]] = []
    for task in tasks:
        parts: list[list[Step]] = [[]]
        for step in task.steps:
            if isinstance(step, SyncStep):
                parts.append([])
            else:
                parts[-1].append(step)
        cut.append([tuple(part) for part in parts])
    stages = []
    inside = False
    for i in range(len(rows[0]) + 1):
        kind, ident = rows[0][i - 1] if i else ("", None)
        inside = kind == "SyncMoveOn" or (inside and kind not in ("SyncMoveOff", "SyncMoveUndo"))
        stages.append(Stage(inside, ident, {task.name: cut[n][i] for n, task in enumerate(tasks)}))
    return tuple(stages)


def _lone_stages(task: TaskText, asked: set[str]) -> tuple[Stage, ...]:
    stages: list[tuple[bool, str | None, list[Step]]] = [(False, None, [])]
    for step in task.steps:
        inside, ident, last = stages[-1]
        if isinstance(step, SyncStep):
            inside = step.kind == "SyncMoveOn" or (
                inside and step.kind not in ("SyncMoveOff", "SyncMoveUndo")
            )
            stages.append((inside, step.ident, []))
        elif isinstance(step, MessageStep) and step.confirm and step.text in asked:
            stages += [(inside, ident, [step]), (inside, ident, [])]
        else:
            last.append(step)
    return tuple(Stage(inside, ident, {task.name: tuple(steps)}) for inside, ident, steps in stages)


MILL = "mill"
"""The kind of segments in which a cutter mills."""


@dataclasses.dataclass(frozen=True)
class Asked:
    """A question to the operator in the straight way of a task: stage, task, and place among its steps."""

    stage: int
    task: TaskText
    place: int
    step: MessageStep


@dataclasses.dataclass(frozen=True)
class Spans:
    """``of_stage`` (stages,): index of the setup in force; ``asked``: for each setup the places where its
    confirmation is asked for, none for a setup without steps."""

    of_stage: IntArray
    asked: tuple[tuple[Asked, ...], ...]


def setups_of(problem: Problem) -> tuple[Setup, ...]:
    """How the cell stands, setup by setup, and at last, without operations, with all axes home again."""
    return problem.setups if problem.closing is None else (*problem.setups, problem.closing)


def spans(setups: tuple[Setup, ...], job: JobText) -> Spans:
    """Setups by stage. A setup begins at the first stage that asks for its confirmation; where that is
    missing or out of order ``verify.setup`` says so, and nothing else is to be concluded."""
    questions = all_asked(job)
    asked = tuple(
        tuple(q for q in questions if setup.steps and one_line(q.step.text) == one_line(setup.confirmation))
        for setup in setups
    )
    of_stage = np.zeros(len(job.stages), dtype=np.int64)
    for index, places in enumerate(asked):
        if places and index:
            of_stage[places[0].stage :] = index
    return Spans(of_stage, asked)


def all_asked(job: JobText) -> list[Asked]:
    """All questions to the operator in the straight ways, stage by stage."""
    return [
        Asked(number, task, place, step)
        for number, stage in enumerate(job.stages)
        for task in job.tasks
        for place, step in enumerate(stage.steps[task.name])
        if isinstance(step, MessageStep) and step.confirm
    ]


def shown_letters(job: JobText, asked: Asked) -> str:
    """All that the task shows since its last move, question or clearing of the panel, as letters and
    digits."""
    lines: list[str] = []
    for number in range(asked.stage, -1, -1):
        steps = job.stages[number].steps[asked.task.name]
        before = steps[: asked.place] if number == asked.stage else steps
        for step in reversed(before):
            if isinstance(step, MoveStep) or (
                isinstance(step, MessageStep) and (step.confirm or step.panel == "clear")
            ):
                return letters(" ".join(reversed(lines)))
            if isinstance(step, MessageStep) and step.panel == "line":
                lines.append(step.text)
    return letters(" ".join(reversed(lines)))


def one_line(text: str) -> str:
    """Text with single spaces, as a panel's lines give it back."""
    return " ".join(text.split())


@dataclasses.dataclass(frozen=True)
class SetupClaims:
    """The claims of a setup's operations, one group each."""

    groups: tuple[tuple[Claim, ...], ...]

    @property
    def joined(self) -> tuple[WireJoins, ...]:
        """Wires that join two arms."""
        return tuple(c for group in self.groups for c in group if isinstance(c, WireJoins))

    @property
    def straight(self) -> dict[str, tuple[StraightWire, ...]]:
        """Claims about straight wires by arm."""
        out: dict[str, tuple[StraightWire, ...]] = {}
        for group in self.groups:
            for claim in group:
                if isinstance(claim, StraightWire):
                    out[claim.arm] = (*out.get(claim.arm, ()), claim)
        return out

    @property
    def stock_holders(self) -> tuple[HoldsStock, ...]:
        """Claims about who holds the block, and its weight."""
        return tuple(c for group in self.groups for c in group if isinstance(c, HoldsStock))

    @property
    def contacts(self) -> tuple[ContactOnlyIn, ...]:
        """Where edges may touch the block."""
        return tuple(c for group in self.groups for c in group if isinstance(c, ContactOnlyIn))

    def forms(self, arm: str) -> frozenset[str]:
        """Segments in which the head of the tool of ``arm`` may touch the sheet: those that state what it
        then meets, with their ways in and out."""
        claims = [claim for group in self.groups for claim in group if isinstance(claim, SheetState)]
        own = [claim.segment for claim in claims if arm in claim.arms]
        return frozenset(way.key for segment in own for way in segment.ways)

    def mills(self, arm: str) -> frozenset[str]:
        """Segments in which the cutter on ``arm`` may be in the block: those that state a feed and what they
        mill, or at least what they spare, by an operation whose cutter may touch the block there."""
        out: set[str] = set()
        for group in self.groups:
            kinds = {kind for c in group if isinstance(c, ContactOnlyIn) for kind in c.kinds}
            if MILL not in kinds:
                continue
            own: set[Segment] = set()
            for claim in group:
                if isinstance(claim, MillsSurface | MillsFlank | MillsOver | SparesPart) and claim.arm == arm:
                    own |= set(claim.segments)
                elif isinstance(claim, MillsAlong) and claim.arm == arm:
                    own.add(claim.segment)
            fed = {c.segment.key for c in group if isinstance(c, FeedWindow)}
            out |= {way.key for segment in own for way in segment.ways} & fed
        return frozenset(out)

    def works(self, arm: str) -> bool:
        """Whether the tool of ``arm`` forms, mills or trims in some segment."""
        return bool(self.forms(arm) or self.mills(arm) or self.trims(arm))

    def trims(self, arm: str) -> frozenset[str]:
        """Segments in which what trims on ``arm`` may be near to the sheet: its slots, with their ways in and
        out."""
        claims = [c for group in self.groups for c in group if isinstance(c, TrimsSheet) and c.arm == arm]
        names = [name for claim in claims for one in claim.outlines for name in slot_names(claim, one)]
        return frozenset(way.key for name in names for way in Segment("trim", name).ways)

    def cuts(self, arms: tuple[str, ...]) -> frozenset[str]:
        """Segments in which the wire of ``arms`` may be in the foam: claimed, with a feed, by an operation
        that has this wire and allows contact in segments of that kind."""
        out: set[str] = set()
        for group in self.groups:
            hands: set[tuple[str, ...]] = {c.arms for c in group if isinstance(c, WireJoins)}
            hands |= {(c.arm,) for c in group if isinstance(c, StraightWire)}
            kinds = {kind for c in group if isinstance(c, ContactOnlyIn) for kind in c.kinds}
            if arms in hands:
                fed = (c.segment for c in group if isinstance(c, FeedWindow))
                out |= {segment.key for segment in fed if segment.kind in kinds}
        return frozenset(out)


def claims_of(
    setups: tuple[Setup, ...], problem: Problem, claims: Mapping[str, tuple[Claim, ...]]
) -> tuple[SetupClaims, ...]:
    """The claims of each setup, by the names of its operations; those of no operation belong to the first."""
    names = [operation.name for operation in problem.operations]
    out = []
    for setup in setups:
        own = [names[i] for i in setup.operations]
        groups = [group for name, group in claims.items() if name in own]
        if setup.number == 1:
            groups += [group for name, group in claims.items() if name not in names]
        out.append(SetupClaims(tuple(groups)))
    return tuple(out)


def stays(problem: Problem, setup: Setup) -> bool:
    """Whether the block stands where the setup before had it: nothing that is changed moves it."""
    change = problem.changes.get(setup.operations[0]) if setup.operations else None
    return setup.number > 1 and not (
        change is not None and set(change.stock) & {"place", "support", "held_by", "grip", "attitude"}
    )
