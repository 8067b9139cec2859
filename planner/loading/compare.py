"""What the programs need of an ABB controller, from their own text, against what the controller says."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.issues import Issue, Severity, TandemError
from planner.loading.rws import Rws
from planner.problem import Arm, Problem
from planner.verify.context import Context
from planner.verify.job import TaskText
from planner.verify.programs.steps import SignalStep, WaitStep, poses
from planner.verify.rapid.syntax_tree import Data, Literal

BASE_SHIFT, BASE_TURN = 0.1, 0.02
"""How far a base frame may be off [mm], [deg]: what the programs themselves allow when they start."""
DATUM_SHIFT: Final = 0.001
"""How far numbers of a datum may be off: print of single precision [in the datum's own units]."""
OPTIONS_BY_WORD: Final = {
    r"\bWZ\w+": "World Zones",
    r"\bSyncMoveOn\b|\bWaitSyncTask\b": "MultiMove",
    r"\bSocket\w+": "PC Interface",
    r"\bPath(?:Rec|AccLim)\w*": "Path Recovery",
}
"""A word of an option's name, by what of RAPID needs it."""
_NUMBER: Final = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclasses.dataclass(frozen=True)
class Found:
    """``differs`` with figures, and what was ``not_looked_at`` with why."""

    differs: tuple[Issue, ...]
    not_looked_at: tuple[Issue, ...]
    agreed: tuple[str, ...]


def compare(rws: Rws, problem: Problem, programs: Mapping[str, str], arms: Sequence[Arm]) -> Found:
    """Bases, tools, work objects, signals, tasks, options and robots, each for itself: what cannot be read is
    told and stops no other. Raises ``TandemError`` for a login that is refused."""
    context = Context(problem, {}, programs)
    tasks = [task for task in context.job.tasks if task.arm.name in {arm.name for arm in arms}]
    text = "\n".join(programs.values())
    looks: dict[str, Callable[[], list[str]]] = {
        "RobotWare": lambda: _robotware(rws.robotware, problem),
        "options": lambda: _options(rws.options, problem, text),
        "tasks": lambda: _tasks(rws.tasks, problem, tasks),
        "base frames and robot types": lambda: _robots(rws.robots, context, tasks),
        "signals": lambda: _signals(rws.signals, tasks),
    }
    differs: list[Issue] = []
    unread: list[Issue] = []
    agreed: list[str] = []
    for name, look in looks.items():
        try:
            faults = look()
        except TandemError as error:
            if any(issue.code == "upload.login" for issue in error.issues):
                raise
            unread.append(_unread(f"{name}: {error.issues[0].message}"))
            continue
        differs += [Issue("upload.differs", fault, field=name) for fault in faults]
        agreed += [] if faults else [name]
    for task in tasks:
        faults, lost, same = _data(rws, problem, task)
        differs += [Issue("upload.differs", fault, arm=task.arm.name) for fault in faults]
        unread += [_unread(what) for what in lost]
        agreed += same
    unread += [_unread("loads, speed data, and the wiring behind signals"), _unread("joint calibration")]
    return Found(tuple(differs), tuple(unread), tuple(agreed))


def _unread(what: str) -> Issue:
    return Issue("upload.not_looked_at", f"not looked at: {what}", Severity.WARNING)


def _robotware(version: str, problem: Problem) -> list[str]:
    wanted = problem.cell.controller.robotware
    if version.split(".")[0] == str(wanted):
        return []
    return [f"RobotWare is {version}, the programs are for RobotWare {wanted}; set robotware and plan again"]


def _options(installed: Sequence[str], problem: Problem, text: str) -> list[str]:
    own = [option.lower() for option in installed]
    needed = [name for word, name in OPTIONS_BY_WORD.items() if re.search(word, text)]
    stated = [name for name in problem.cell.controller.options or () if name.lower() not in own]
    out = [
        f"option {name} is needed by the programs and not installed ({len(own)} options are)"
        for name in needed
        if not any(name.lower() in option for option in own)
    ]
    return out + [f"option {name} stands in the cell and is not installed" for name in stated]


def _tasks(there: Sequence[str], problem: Problem, tasks: Sequence[TaskText]) -> list[str]:
    order = [arm.name for arm in problem.cell.arms]
    wanted = [problem.cell.controller.tasks[order.index(task.arm.name)] for task in tasks]
    lost = [name for name in wanted if name.lower() not in {one.lower() for one in there}]
    return [f"task {name} is not there; the controller has {', '.join(there)}" for name in lost]


def _robots(there: Mapping[str, Mapping[str, str]], context: Context, tasks: Sequence[TaskText]) -> list[str]:
    out = []
    order = [arm.name for arm in context.problem.cell.arms]
    named = {name.lower(): values for name, values in there.items()}
    for task in tasks:
        name = context.problem.cell.controller.robot(order.index(task.arm.name))
        values = {key.lower(): value for key, value in named.get(name.lower(), {}).items()}
        wanted = context.declared_bases.get(task.arm.name)
        if not values:
            out.append(f"robot {name} is not in MOC; there are {', '.join(there) or 'none'}")
            continue
        try:
            place = np.array([float(values[f"base_frame_pos_{axis}"]) for axis in "xyz"])
            turn = np.array([float(values[f"base_frame_orient_u{k}"]) for k in range(4)])
        except (KeyError, ValueError) as error:
            what = f"the base frame of {name} cannot be read from MOC ({error})"
            raise TandemError(Issue("upload.controller", what)) from error
        if wanted is None:
            out.append(f"the program of {task.arm.name} states no base frame")
            continue
        shift, angle = _apart(poses(place, turn), wanted)
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


def _apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Distance [mm] and turn [deg] between two poses (4, 4)."""
    turn = a[:3, :3].T @ b[:3, :3]
    sine = 0.5 * np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.degrees(np.arctan2(sine, 0.5 * (np.trace(turn) - 1.0)))
    return 1e3 * float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(angle)


def _signals(there: Mapping[str, str], tasks: Sequence[TaskText]) -> list[str]:
    named = {name.lower(): kind.upper() for name, kind in there.items()}
    out = []
    for task in tasks:
        inside = [step for steps in (*task.handlers.values(), *task.undos.values()) for step in steps]
        wanted: dict[str, str] = {}
        for step in (*task.steps, *inside):
            if isinstance(step, SignalStep) and step.signal:
                wanted[step.signal] = "DO"
            if isinstance(step, WaitStep) and step.signal:
                wanted.setdefault(step.signal, "DI")
        for name, kind in sorted(wanted.items()):
            got = named.get(name.lower())
            if got is None:
                out.append(f"signal {name} ({kind}) of {task.arm.name} is not on the controller")
            elif got and got != kind:
                out.append(f"signal {name} of {task.arm.name} is {got} on the controller, wanted is {kind}")
    return out


def _data(rws: Rws, problem: Problem, task: TaskText) -> tuple[list[str], list[str], list[str]]:
    """Tools and work objects that the controller has now under the same names: differences, what is not
    there to compare, what agreed."""
    order = [arm.name for arm in problem.cell.arms]
    name = problem.cell.controller.tasks[order.index(task.arm.name)]
    out, lost, same = list[str](), list[str](), list[str]()
    for module in task.modules:
        for datum in module.data:
            if datum.kind not in ("tooldata", "wobjdata") or datum.size is not None:
                continue
            try:
                text = rws.datum(name, module.name, datum.name)
            except TandemError as error:
                lost.append(f"{datum.kind} {datum.name}: {error.issues[0].message}")
                continue
            if text is None:
                lost.append(f"{datum.kind} {datum.name}: {name} has none yet, the program brings its own")
                continue
            if not isinstance(datum.initial, Literal):
                lost.append(f"{datum.kind} {datum.name}: the program works its value out")
                continue
            far = difference(datum_text(datum), text)
            if far is None:
                same.append(f"{datum.kind} {datum.name}")
            else:
                out.append(f"{datum.kind} {datum.name} of {name} on the controller is another one: {far}")
    return out, lost, same


def datum_text(datum: Data) -> str:
    """The literal of a datum as text of the same form as a controller's."""
    value = datum.initial.value if isinstance(datum.initial, Literal) else datum.initial
    return _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ",".join(_text(one) for one in value) + "]"
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def difference(planned: str, there: str) -> str | None:
    """In what two RAPID values differ, by words and by the largest difference of numbers; None if not."""
    words = [_NUMBER.sub("#", t).upper().split() for t in (planned, there)]
    first, second = ([float(n) for n in _NUMBER.findall(t)] for t in (planned, there))
    if "".join(words[0]) != "".join(words[1]) or len(first) != len(second):
        return f"{there[:120]}, planned is {planned[:120]}"
    far = max((abs(a - b) for a, b in zip(first, second, strict=True)), default=0.0)
    if far <= DATUM_SHIFT:
        return None
    return f"a number is {far:.4g} off (there {there[:160]}, planned {planned[:160]})"
