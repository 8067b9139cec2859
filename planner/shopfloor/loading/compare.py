"""Comparison of what the programs need of an ABB controller with what the controller reports.

The needs are those of the programs' own text.
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
"""Maximum deviation of a base frame [mm], [deg]: what the programs themselves allow when they start."""
TURN_LENGTH: Final = 0.01
"""Maximum deviation of a quaternion's length from 1."""
NEEDS: Final = (
    (r"\bSyncMove(?:On|Off|Undo)\b|\bMove\w+\b[^;!]*\\ID:=", ("MultiMove Coordinated",)),
    (r"\bWaitSyncTask\b", ("MultiMove Coordinated", "MultiMove Independent", "Multitasking")),
    (r"\bSyncMove(?:Suspend|Resume)\b|\bPath(?:Rec\w+|Level)\b", ("Path Recovery",)),
    (r"\bWZ\w+", ("World Zones",)),
)
r"""RAPID instructions that need an option, with the alternatives. Options are named without their numbers, in
which RobotWare 6 and 7 differ. Sources: Application manual MultiMove, 3HAC050961-001 (SyncMoveOn and \ID
need Coordinated; MultiMove includes Multitasking); Application manual Controller software IRC5,
3HAC050798-001 (Multitasking, Path Recovery, World Zones). PathAccLim, StorePath and everything else that
Tandem's programs use is part of every RobotWare.
"""
WITHOUT: Final = "no controller reports the wiring of signals, the calibration of axes or the mounted parts"
"""Data that is never read."""
DATA: Final = ("tooldata", "wobjdata", "loaddata")
"""Data types that are compared if the controller has data of the same name."""
_LITERAL: Final = re.compile(r':=\s*((?:"[^"\n]*"|[^;"])*);')


_SIGNALS: Final = (
    ("DO", re.compile(r"\bSetDO\b\s*(?:\\[^,;]+,\s*)*(\w+)\s*,", re.IGNORECASE)),
    ("DO", re.compile(r"\b(?:Set|Reset)\s+(\w+)\s*;", re.IGNORECASE)),
    ("DO", re.compile(r"\bDOutput\s*\(\s*(\w+)", re.IGNORECASE)),
    ("DI", re.compile(r"\bWaitDI\s+(\w+)", re.IGNORECASE)),
    ("DI", re.compile(r"\b(?:DInput|TestDI)\s*\(\s*(\w+)", re.IGNORECASE)),
)
"""Patterns of digital signals in RAPID."""


@dataclasses.dataclass(frozen=True)
class ComparisonResult:
    """Result of a comparison.

    Attributes:
        differs: Differences with figures.
        not_looked_at: What was not compared, and why.
        agreed: What agrees.
    """

    differs: tuple[Issue, ...]
    not_looked_at: tuple[Issue, ...]
    agreed: tuple[str, ...]


def compare(rws: Rws, problem: Problem, programs: Mapping[str, str], arms: Sequence[Arm]) -> ComparisonResult:
    """Compare bases, tools, work objects, signals, tasks, options and robots, each on its own.

    What cannot be read is reported and does not prevent the other comparisons.

    Args:
        rws: Controller.
        problem: Problem of the programs.
        programs: {name: text}.
        arms: Arms of this controller.

    Raises:
        TandemError: The login is refused.
    """
    context = Context(problem, {}, programs)
    tasks = [task for task in context.job.tasks if task.arm.name in {arm.name for arm in arms}]
    text = "\n".join(one for task in tasks for one in task.files.values())
    comparisons: dict[str, Callable[[], list[str]]] = {
        "RobotWare": lambda: _robotware(rws.robotware, problem),
        "options": lambda: missing_options(rws.options, problem, text),
        "tasks": lambda: _tasks(rws.tasks, problem, tasks),
        "base frames and robot types": lambda: _robots(rws.robots, context, tasks),
        "signals": lambda: _signals(rws.signals, tasks),
    }
    differs: list[Issue] = []
    lost: list[Issue] = []
    agreed: list[str] = []
    for name, compare_aspect in comparisons.items():
        try:
            faults = compare_aspect()
        except TandemError as error:
            if any(issue.code == "upload.login" for issue in error.issues):
                raise
            lost.append(unread(f"{name}: {error.issues[0].message}"))
            continue
        differs += [Issue("upload.differs", fault, field=name) for fault in faults]
        agreed += [] if faults else [name]
    for task in tasks:
        faults, untold, same = _data(rws, problem, task)
        hint = "unload the module if an earlier program left it; measured values belong in the cell file"
        differs += [Issue("upload.differs", fault, arm=task.arm.name, hint=hint) for fault in faults]
        lost += [unread(what) for what in untold]
        agreed += same
    return ComparisonResult(tuple(differs), tuple(lost), tuple(agreed))


def unread(what: str) -> Issue:
    """Issue for something that was not compared, and why."""
    return Issue("upload.not_looked_at", f"not looked at: {what}", Severity.WARNING)


def _robotware(version: str, problem: Problem) -> list[str]:
    required = problem.cell.controller.robotware
    if version.split(".")[0] == str(required):
        return []
    return [f"RobotWare is {version}, the programs are for RobotWare {required}; correct robotware, replan"]


def missing_options(installed: Sequence[str], problem: Problem, text: str) -> list[str]:
    """Options that the programs' ``text`` needs or the cell states, and that are not ``installed``."""
    lowercase_options = [option.lower() for option in installed]
    plain = re.sub(r"![^\n]*", "", text)
    out = [
        f"option {' or '.join(names)} is needed by the programs but not installed ({len(lowercase_options)} "
        "are)"
        for word, names in NEEDS
        if re.search(word, plain)
        and not any(name.lower() in option for name in names for option in lowercase_options)
    ]
    stated = [name for name in problem.cell.controller.options or () if name.lower() not in lowercase_options]
    return out + [f"option {name} is stated in the cell but not installed" for name in stated]


def _tasks(reported: Sequence[str], problem: Problem, tasks: Sequence[TaskText]) -> list[str]:
    order = [arm.name for arm in problem.cell.arms]
    required = [problem.cell.controller.tasks[order.index(task.arm.name)] for task in tasks]
    lost = [name for name in required if name.lower() not in {one.lower() for one in reported}]
    return [f"task {name} does not exist; the controller has {', '.join(reported)}" for name in lost]


def _robots(
    reported: Mapping[str, Mapping[str, str]], context: Context, tasks: Sequence[TaskText]
) -> list[str]:
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
            turn = np.array([float(values[f"base_frame_orient_u{k}"]) for k in range(4)])
        except (KeyError, ValueError) as error:
            what = f"the base frame of {name} cannot be read from MOC ({error})"
            raise issue_error("upload.controller", what) from error
        if required is None:
            out.append(f"the program of {task.arm.name} contains no base frame")
            continue
        if not (np.isfinite(position).all() and abs(float(np.linalg.norm(turn)) - 1.0) <= TURN_LENGTH):
            what = f"the base frame of {name} in MOC is invalid: position {position} m, quaternion {turn}"
            raise issue_error("upload.controller", what)
        shift, angle = _pose_difference(poses(position, turn), required)
        if shift > BASE_SHIFT or angle > BASE_TURN:
            what = (
                f"base of {task.arm.name} ({name}): the controller's is {shift:.3f} mm and {angle:.4f} deg "
            )
            out.append(what + f"off the program's, allowed {BASE_SHIFT} mm and {BASE_TURN} deg")
        model = values.get("use_robot_type", "")
        figures = re.findall(r"\d+", task.arm.robot)[:2]
        if model and figures and not all(re.search(rf"(?<!\d){f}(?!\d)", model) for f in figures):
            out.append(f"robot {name} is {model}, the program is for {task.arm.robot}")
    return out


def _pose_difference(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Distance [mm] and angle [deg] between two poses (4, 4) [m]."""
    return 1e3 * float(np.linalg.norm(a[:3, 3] - b[:3, 3])), turn_deg(a[:3, :3], b[:3, :3])


def _signals(reported: Mapping[str, str], tasks: Sequence[TaskText]) -> list[str]:
    named = {name.lower(): kind.upper() for name, kind in reported.items()}
    out = []
    for task in tasks:
        inside = [step for steps in (*task.handlers.values(), *task.undos.values()) for step in steps]
        required: dict[str, str] = {}
        for step in (*task.steps, *inside):
            if isinstance(step, SignalStep) and step.signal:
                required[step.signal] = "DO"
            if isinstance(step, WaitStep) and step.signal:
                required.setdefault(step.signal, "DI")
        arm_signals = {name.lower() for name in required}
        for kind, name in _read("\n".join(task.files.values())):
            if name.lower() not in arm_signals:
                arm_signals.add(name.lower())
                required[name] = kind
        for name, kind in sorted(required.items()):
            got = named.get(name.lower())
            if got is None:
                what = f"signal {name} ({kind}) of {task.arm.name} is not on the controller; "
                out.append(what + "if programs/controller/ defines it, load that first")
            elif not got:
                what = f"the type of signal {name} is not reported, required is {kind}"
                raise issue_error("upload.controller", what)
            elif got != kind:
                out.append(f"signal {name} of {task.arm.name} is {got} on the controller, required is {kind}")
    return out


def _read(text: str) -> list[tuple[str, str]]:
    """Types and names of the signals in RAPID text.

    They include those outside of the nominal sequence of steps.
    """
    plain = re.sub(r'"[^"\n]*"', '""', text)
    plain = re.sub(r"![^\n]*", "", plain)
    return [(kind, name) for kind, pattern in _SIGNALS for name in pattern.findall(plain)]


def _data(rws: Rws, problem: Problem, task: TaskText) -> tuple[list[str], list[str], list[str]]:
    """Compare tools, work objects and loads on the controller with the same data in the module that is sent.

    Returns differences, what could not be compared, and what agrees.
    """
    order = [arm.name for arm in problem.cell.arms]
    name = problem.cell.controller.tasks[order.index(task.arm.name)]
    out, lost, same = list[str](), list[str](), list[str]()
    try:
        loaded = {module.lower() for module in rws.modules(name)}
    except TandemError as error:
        return [], [f"tools and work objects of {name}: {error.issues[0].message}"], []
    for module in modules_of(task.text):
        for datum in module.data:
            if datum.kind not in DATA or datum.size is not None:
                continue
            shown = f"{datum.kind} {datum.name}"
            if module.name.lower() not in loaded:
                same.append(f"{shown} (not loaded yet, the program defines it)")
                continue
            written = _LITERAL.search(task.files[module.file], datum.start)
            try:
                actual = rws.datum(name, module.name, datum.name)
            except TandemError as error:
                lost.append(f"{shown}: {error.issues[0].message}")
                continue
            if actual is None or written is None:
                why = "the controller reports no value" if actual is None else "the program contains no value"
                lost.append(f"{shown} of {name}: module {module.name} is loaded, but {why}")
            elif difference_text := difference(written.group(1), actual):
                out.append(f"{shown} of {name} differs in the loaded module {module.name}: {difference_text}")
            else:
                same.append(shown)
    return out, lost, same
