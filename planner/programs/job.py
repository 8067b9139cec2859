"""The job as its programs state it: the tasks of all arms and their stages.

The programs of all tasks are read side by side. A stage is what happens between two synchronisation
points. In a synchronised stage the moves of all tasks run in pairs. In any other stage at most one task
may move, so that no order of events depends on chance. Two controllers that meet by signals are treated
in the same way: a stage is what happens between their meetings.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Final

from planner.issues import TandemError
from planner.languages.krl.reader import reader
from planner.languages.rapid.reader.program_text import RapidText
from planner.languages.rapid.reader.reader import MOST_KEPT, Flow, Limits, flow, read_task
from planner.languages.trajectories.reader import flow as trajectory_flow
from planner.languages.trajectories.reader import rows as trajectory_rows
from planner.languages.trajectories.reader.program_text import TrajectoryText
from planner.languages.urscript.reader import flow as script_flow
from planner.languages.urscript.reader import reader as script_reader
from planner.problem import Arm, Problem, setups_of
from planner.programs import text as program_text
from planner.programs.handshake import automata
from planner.programs.handshake.automata import Reading
from planner.programs.signals import krl_signals
from planner.programs.stages import (
    MODULES,
    JobText,
    Stage,
    TaskText,
    beside,
    parts,
    readings,
    split_into_stages,
    wiring,
)
from planner.programs.steps import (
    Fault,
    FlowError,
    Step,
)
from planner.proof.kinematics.arm_model import machine_of


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
        one = task.text.language in ("rapid", "trajectories")
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
    stages = split_into_stages(tasks, asked)
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


def _followed(
    files: tuple[tuple[str, str], ...], most_bytes: int
) -> tuple[RapidText, Flow, tuple[Fault, ...]]:
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
    task = TaskText(name, unit, problem.cell.arms[number], text, *parts, files)
    return task, text.faults, lost


def _krl_task(problem: Problem, number: int, name: str, files: Mapping[str, str]) -> _Read:
    controller, arm = problem.cell.controller, problem.cell.arms[number]
    text = reader.read(files, controller.max_bytes, controller.dialect)
    steps, entered, lost = tuple[Step, ...](), frozenset[str](), tuple[Fault, ...]()
    if not text.faults:
        declared = text.base_of(arm)
        base = arm.base if declared is None else declared
        try:
            others = [other.name for other in problem.cell.arms if other.name != arm.name]
            signals = krl_signals(problem, arm)
            steps, entered = reader.flow(text, base, signals, arm.name, others, _along(arm))
        except FlowError as wrong:
            lost = wrong.faults
    called = frozenset(("", program) for program in entered)
    return TaskText(name, "", arm, text, steps, {}, {}, called, files), text.faults, lost


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
    task = TaskText(name, "", arm, text, steps, {}, {}, frozenset(), files)
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
            tasks.append(TaskText(row.arm, row.arm, arms[row.arm], text, way, {}, {}, none, files))
    return tasks, faults, lost


def joint_names(problem: Problem, arm: Arm) -> tuple[str, ...]:
    """What a controller of trajectories calls the joints of an arm: the names of its URDF behind the prefix
    that the cell states."""
    prefix = problem.cell.controller.joint_prefix.get(arm.name, "")
    return tuple(f"{prefix}{name}" for name in arm.data.joints)
