"""Comparison of what programs require of an ABB controller with what the controller reports.

Requirements are read from the text of the programs and from the cell.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.languages.rapid.reader.program_text import modules_of
from planner.problem import Arm, Problem
from planner.programs.stages import TaskText
from planner.programs.steps import SignalStep, WaitStep, poses
from planner.proof.context import Context
from planner.shopfloor.loading.literals import difference, turn_deg
from planner.shopfloor.loading.rws import Rws

BASE_SHIFT, BASE_TURN = 0.1, 0.02
"""Maximum deviation of a base frame [mm] and [deg].

Chosen: what the programs themselves allow when they start.
"""
TURN_LENGTH: Final = 0.01
"""Maximum difference of a quaternion's norm from 1."""
NEEDS: Final = (
    (r"\bSyncMove(?:On|Off|Undo)\b|\bMove\w+\b[^;!]*\\ID:=", ("MultiMove Coordinated",)),
    (r"\bWaitSyncTask\b", ("MultiMove Coordinated", "MultiMove Independent", "Multitasking")),
    (r"\bSyncMove(?:Suspend|Resume)\b|\bPath(?:Rec\w+|Level)\b", ("Path Recovery",)),
    (r"\bWZ\w+", ("World Zones",)),
)
r"""Patterns of RAPID instructions that require an option, each with the alternative options.

Options are named without their numbers, in which RobotWare 6 and 7 differ. Sources: Application manual
MultiMove, 3HAC050961-001 (SyncMoveOn and \ID need Coordinated; MultiMove includes Multitasking); Application
manual Controller software IRC5, 3HAC050798-001 (Multitasking, Path Recovery, World Zones). PathAccLim,
StorePath and everything else that Tandem's programs use is part of every RobotWare.
"""
WITHOUT: Final = "no controller reports the wiring of signals, the calibration of axes or the mounted parts"
"""What no comparison covers."""
DATA: Final = ("tooldata", "wobjdata", "loaddata")
"""Types of data that are compared if the controller has data of the same name."""
_LITERAL: Final = re.compile(r':=\s*((?:"[^"\n]*"|[^;"])*);')


_SIGNALS: Final = (
    ("DO", re.compile(r"\bSetDO\b\s*(?:\\[^,;]+,\s*)*(\w+)\s*,", re.IGNORECASE)),
    ("DO", re.compile(r"\b(?:Set|Reset)\s+(\w+)\s*;", re.IGNORECASE)),
    ("DO", re.compile(r"\bDOutput\s*\(\s*(\w+)", re.IGNORECASE)),
    ("DI", re.compile(r"\bWaitDI\s+(\w+)", re.IGNORECASE)),
    ("DI", re.compile(r"\b(?:DInput|TestDI)\s*\(\s*(\w+)", re.IGNORECASE)),
)
"""Types of digital signals, with patterns of RAPID text in which their names occur."""


@dataclasses.dataclass(frozen=True)
class ComparisonResult:
    """Result of a comparison.

    Attributes:
        differs: Differences, with values.
        not_looked_at: What was not compared, and why.
        agreed: Names of what agrees.
    """

    differs: tuple[Issue, ...]
    not_looked_at: tuple[Issue, ...]
    agreed: tuple[str, ...]


def compare(rws: Rws, problem: Problem, programs: Mapping[str, str], arms: Sequence[Arm]) -> ComparisonResult:
    """Compare the data of an ABB controller with the programs before they are loaded.

    Compared are RobotWare, options, tasks, base frames, robot types, signals, tools, work objects and loads.
    If one of them cannot be read, that is reported and the others are still compared.

    Args:
        rws: Controller.
        problem: Problem of the programs.
        programs: Texts of the programs by name.
        arms: Arms of this controller.

    Raises:
        TandemError: The login is refused.
    """
    context = Context(problem, {}, programs)
    tasks = [task for task in context.job.tasks if task.arm.name in {arm.name for arm in arms}]
    text = "\n".join(file_text for task in tasks for file_text in task.files.values())
    comparisons: dict[str, Callable[[], list[str]]] = {
        "RobotWare": lambda: _robotware(rws.robotware, problem),
        "options": lambda: missing_options(rws.options, problem, text),
        "tasks": lambda: _tasks(rws.tasks, problem, tasks),
        "base frames and robot types": lambda: _robots(rws.robots, context, tasks),
        "signals": lambda: _signals(rws.signals, tasks),
    }
    differs: list[Issue] = []
    not_looked_at: list[Issue] = []
    agreed: list[str] = []
    for name, compare_aspect in comparisons.items():
        try:
            faults = compare_aspect()
        except TandemError as error:
            if any(issue.code == "upload.login" for issue in error.issues):
                raise
            not_looked_at.append(unread(f"{name}: {error.issues[0].message}"))
            continue
        differs += [Issue("upload.differs", fault, field=name) for fault in faults]
        if not faults:
            agreed.append(name)
    for task in tasks:
        faults, not_compared, same = _data(rws, problem, task)
        hint = "unload the module if an earlier program left it; measured values belong in the cell file"
        differs += [Issue("upload.differs", fault, arm=task.arm.name, hint=hint) for fault in faults]
        not_looked_at += [unread(reason) for reason in not_compared]
        agreed += same
    return ComparisonResult(tuple(differs), tuple(not_looked_at), tuple(agreed))


def unread(what: str) -> Issue:
    """Return a warning that something was not compared; ``what`` names it and the reason."""
    return Issue("upload.not_looked_at", f"not looked at: {what}", Severity.WARNING)


def _robotware(version: str, problem: Problem) -> list[str]:
    """Return a difference if the controller has another major version of RobotWare than the cell."""
    required = problem.cell.controller.robotware
    if version.split(".")[0] == str(required):
        return []
    return [f"RobotWare is {version}, the programs are for RobotWare {required}; correct robotware, replan"]


def missing_options(installed: Sequence[str], problem: Problem, text: str) -> list[str]:
    """Return a difference for each option that ``text`` needs or the cell states and is not ``installed``."""
    lowercase_options = [option.lower() for option in installed]
    without_comments = re.sub(r"![^\n]*", "", text)
    out = [
        f"option {' or '.join(names)} is needed by the programs but not installed ({len(lowercase_options)} "
        "are)"
        for word, names in NEEDS
        if re.search(word, without_comments)
        and not any(name.lower() in option for name in names for option in lowercase_options)
    ]
    stated = [name for name in problem.cell.controller.options or () if name.lower() not in lowercase_options]
    return out + [f"option {name} is stated in the cell but not installed" for name in stated]


def _tasks(reported: Sequence[str], problem: Problem, tasks: Sequence[TaskText]) -> list[str]:
    """Return a difference for each task that the controller does not have."""
    order = [arm.name for arm in problem.cell.arms]
    required = [problem.cell.controller.tasks[order.index(task.arm.name)] for task in tasks]
    missing = [name for name in required if name.lower() not in {task.lower() for task in reported}]
    return [f"task {name} does not exist; the controller has {', '.join(reported)}" for name in missing]


def _robots(
    reported: Mapping[str, Mapping[str, str]], context: Context, tasks: Sequence[TaskText]
) -> list[str]:
    """Return the differences of base frames and robot types between programs and controller, as sentences.

    ``reported`` has the configuration values of the controller (MOC) by robot and key.

    Raises:
        TandemError: ``upload.controller`` if a reported base frame cannot be read or is invalid.
    """
    out = []
    order = [arm.name for arm in context.problem.cell.arms]
    named = {name.lower(): values for name, values in reported.items()}
    for task in tasks:
        name = context.problem.cell.controller.robot_name(order.index(task.arm.name))
        values = {key.lower(): value for key, value in named.get(name.lower(), {}).items()}
        required = context.declared_bases.get(task.arm.name)
        if not values:
            out.append(f"robot {name} is not in MOC; MOC has {', '.join(reported) or 'none'}")
            continue
        try:
            position = np.array([float(values[f"base_frame_pos_{axis}"]) for axis in "xyz"])
            quaternion = np.array([float(values[f"base_frame_orient_u{k}"]) for k in range(4)])
        except (KeyError, ValueError) as error:
            text = f"the base frame of {name} cannot be read from MOC ({error})"
            raise issue_error("upload.controller", text) from error
        if required is None:
            out.append(f"the program of {task.arm.name} contains no base frame")
            continue
        if not (np.isfinite(position).all() and abs(float(np.linalg.norm(quaternion)) - 1.0) <= TURN_LENGTH):
            text = (
                f"the base frame of {name} in MOC is invalid: position {position} m, quaternion {quaternion}"
            )
            raise issue_error("upload.controller", text)
        shift, angle = _pose_difference(poses(position, quaternion), required)
        if shift > BASE_SHIFT or angle > BASE_TURN:
            text = (
                f"base of {task.arm.name} ({name}): the controller's is {shift:.3f} mm and {angle:.4f} deg "
            )
            out.append(text + f"off the program's, allowed {BASE_SHIFT} mm and {BASE_TURN} deg")
        model = values.get("use_robot_type", "")
        # the first two numbers of the robot's name, such as payload and reach
        model_numbers = re.findall(r"\d+", task.arm.robot)[:2]
        if (
            model
            and model_numbers
            and not all(re.search(rf"(?<!\d){number}(?!\d)", model) for number in model_numbers)
        ):
            out.append(f"robot {name} is {model}, the program is for {task.arm.robot}")
    return out


def _pose_difference(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return the distance [mm] and the angle [deg] between two poses (4, 4) [m]."""
    return 1e3 * float(np.linalg.norm(a[:3, 3] - b[:3, 3])), turn_deg(a[:3, :3], b[:3, :3])


def _signals(reported: Mapping[str, str], tasks: Sequence[TaskText]) -> list[str]:
    """Return a sentence for each signal of the programs that the controller does not have with that type.

    A signal that a program sets has to be an output (DO), one that it waits for an input (DI). ``reported``
    has the types of the controller's signals by name.

    Raises:
        TandemError: ``upload.controller`` if the type of a required signal is empty.
    """
    type_by_name = {name.lower(): kind.upper() for name, kind in reported.items()}
    out = []
    for task in tasks:
        handler_steps = [step for steps in (*task.handlers.values(), *task.undos.values()) for step in steps]
        required: dict[str, str] = {}
        for step in (*task.steps, *handler_steps):
            if isinstance(step, SignalStep) and step.signal:
                required[step.signal] = "DO"
            if isinstance(step, WaitStep) and step.signal:
                required.setdefault(step.signal, "DI")
        arm_signals = {name.lower() for name in required}
        for kind, name in _signals_in_text("\n".join(task.files.values())):
            if name.lower() not in arm_signals:
                arm_signals.add(name.lower())
                required[name] = kind
        for name, kind in sorted(required.items()):
            got = type_by_name.get(name.lower())
            if got is None:
                message = f"signal {name} ({kind}) of {task.arm.name} is not on the controller; "
                out.append(message + "if programs/controller/ defines it, load that first")
            elif not got:
                message = f"the type of signal {name} is not reported, required is {kind}"
                raise issue_error("upload.controller", message)
            elif got != kind:
                out.append(f"signal {name} of {task.arm.name} is {got} on the controller, required is {kind}")
    return out


def _signals_in_text(text: str) -> list[tuple[str, str]]:
    """Return types and names of the signals in RAPID text, also outside of the nominal sequence of steps."""
    without_strings = re.sub(r'"[^"\n]*"', '""', text)
    code = re.sub(r"![^\n]*", "", without_strings)
    return [(kind, name) for kind, pattern in _SIGNALS for name in pattern.findall(code)]


def _data(rws: Rws, problem: Problem, task: TaskText) -> tuple[list[str], list[str], list[str]]:
    """Compare tools, work objects and loads of a task on the controller with those in the sent module.

    Returns:
        Differences, what could not be compared and why, and what agrees.
    """
    order = [arm.name for arm in problem.cell.arms]
    name = problem.cell.controller.tasks[order.index(task.arm.name)]
    differs, not_compared, same = list[str](), list[str](), list[str]()
    try:
        loaded = {module.lower() for module in rws.modules(name)}
    except TandemError as error:
        return [], [f"tools and work objects of {name}: {error.issues[0].message}"], []
    for module in modules_of(task.text):
        for datum in module.data:
            if datum.kind not in DATA or datum.size is not None:
                continue
            title = f"{datum.kind} {datum.name}"
            if module.name.lower() not in loaded:
                same.append(f"{title} (not loaded yet, the program defines it)")
                continue
            written = _LITERAL.search(task.files[module.file], datum.start)
            try:
                actual = rws.datum(name, module.name, datum.name)
            except TandemError as error:
                not_compared.append(f"{title}: {error.issues[0].message}")
                continue
            if actual is None or written is None:
                reason = (
                    "the controller reports no value" if actual is None else "the program contains no value"
                )
                not_compared.append(f"{title} of {name}: module {module.name} is loaded, but {reason}")
            elif difference_text := difference(written.group(1), actual):
                differs.append(
                    f"{title} of {name} differs in the loaded module {module.name}: {difference_text}"
                )
            else:
                same.append(title)
    return differs, not_compared, same
