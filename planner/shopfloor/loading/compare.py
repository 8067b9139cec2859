"""What the programs need of an ABB controller, from their own text, against what the controller says."""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.issues import Issue, Severity, TandemError, refusal
from planner.languages.rapid.reader.program_text import modules_of
from planner.problem import Arm, Problem
from planner.programs.stages import TaskText
from planner.programs.steps import SignalStep, WaitStep, poses
from planner.proof.context import Context
from planner.shopfloor.loading.literals import difference, turn_deg
from planner.shopfloor.loading.rws import Rws

BASE_SHIFT, BASE_TURN = 0.1, 0.02
"""How far a base frame may be off [mm], [deg]: what the programs themselves allow when they start."""
TURN_LENGTH: Final = 0.01
"""How far a quaternion's length may be off 1 where it is a turn at all."""
NEEDS: Final = (
    (r"\bSyncMove(?:On|Off|Undo)\b|\bMove\w+\b[^;!]*\\ID:=", ("MultiMove Coordinated",)),
    (r"\bWaitSyncTask\b", ("MultiMove Coordinated", "MultiMove Independent", "Multitasking")),
    (r"\bSyncMove(?:Suspend|Resume)\b|\bPath(?:Rec\w+|Level)\b", ("Path Recovery",)),
    (r"\bWZ\w+", ("World Zones",)),
)
"""What of RAPID needs an option, and which do, by their names without numbers, which RobotWare 6 and 7 have
different: Application manual MultiMove, 3HAC050961-001 (SyncMoveOn and \\ID need Coordinated; MultiMove has
Multitasking in it), Application manual Controller software IRC5, 3HAC050798-001 (Multitasking, Path Recovery,
World Zones). PathAccLim, StorePath and all else that programs of ours use is in every RobotWare."""
WITHOUT: Final = "no controller tells the wiring behind its signals, the calibration of axes, what is mounted"
"""What is never read."""
DATA: Final = ("tooldata", "wobjdata", "loaddata")
"""Types of data that are compared, where the controller has them under the same name."""
_LITERAL: Final = re.compile(r':=\s*((?:"[^"\n]*"|[^;"])*);')


_SIGNALS: Final = (
    ("DO", re.compile(r"\bSetDO\b\s*(?:\\[^,;]+,\s*)*(\w+)\s*,", re.IGNORECASE)),
    ("DO", re.compile(r"\b(?:Set|Reset)\s+(\w+)\s*;", re.IGNORECASE)),
    ("DO", re.compile(r"\bDOutput\s*\(\s*(\w+)", re.IGNORECASE)),
    ("DI", re.compile(r"\bWaitDI\s+(\w+)", re.IGNORECASE)),
    ("DI", re.compile(r"\b(?:DInput|TestDI)\s*\(\s*(\w+)", re.IGNORECASE)),
)
"""Where RAPID names digital signals."""


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
    text = "\n".join(one for task in tasks for one in task.files.values())
    looks: dict[str, Callable[[], list[str]]] = {
        "RobotWare": lambda: _robotware(rws.robotware, problem),
        "options": lambda: missing_options(rws.options, problem, text),
        "tasks": lambda: _tasks(rws.tasks, problem, tasks),
        "base frames and robot types": lambda: _robots(rws.robots, context, tasks),
        "signals": lambda: _signals(rws.signals, tasks),
    }
    differs: list[Issue] = []
    lost: list[Issue] = []
    agreed: list[str] = []
    for name, look in looks.items():
        try:
            faults = look()
        except TandemError as error:
            if any(issue.code == "upload.login" for issue in error.issues):
                raise
            lost.append(unread(f"{name}: {error.issues[0].message}"))
            continue
        differs += [Issue("upload.differs", fault, field=name) for fault in faults]
        agreed += [] if faults else [name]
    for task in tasks:
        faults, untold, same = _data(rws, problem, task)
        hint = (
            "unload the module if an earlier program left it; what was measured there belongs into the cell"
        )
        differs += [Issue("upload.differs", fault, arm=task.arm.name, hint=hint) for fault in faults]
        lost += [unread(what) for what in untold]
        agreed += same
    return Found(tuple(differs), tuple(lost), tuple(agreed))


def unread(what: str) -> Issue:
    """Something that was not looked at, and why."""
    return Issue("upload.not_looked_at", f"not looked at: {what}", Severity.WARNING)


def _robotware(version: str, problem: Problem) -> list[str]:
    wanted = problem.cell.controller.robotware
    if version.split(".")[0] == str(wanted):
        return []
    return [f"RobotWare is {version}, the programs are for RobotWare {wanted}; set robotware and plan again"]


def missing_options(installed: Sequence[str], problem: Problem, text: str) -> list[str]:
    """Options that the programs' ``text`` needs or the cell states, and that are not ``installed``."""
    own = [option.lower() for option in installed]
    plain = re.sub(r"![^\n]*", "", text)
    out = [
        f"option {' or '.join(names)} is needed by the programs and not installed ({len(own)} options are)"
        for word, names in NEEDS
        if re.search(word, plain) and not any(name.lower() in option for name in names for option in own)
    ]
    stated = [name for name in problem.cell.controller.options or () if name.lower() not in own]
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
            raise refusal("upload.controller", what) from error
        if wanted is None:
            out.append(f"the program of {task.arm.name} states no base frame")
            continue
        if not (np.isfinite(place).all() and abs(float(np.linalg.norm(turn)) - 1.0) <= TURN_LENGTH):
            what = f"the base frame of {name} in MOC is none: position {place} m, quaternion {turn}"
            raise refusal("upload.controller", what)
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
    """Distance [mm] and turn [deg] between two poses (4, 4) [m]."""
    return 1e3 * float(np.linalg.norm(a[:3, 3] - b[:3, 3])), turn_deg(a[:3, :3], b[:3, :3])


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
        own = {name.lower() for name in wanted}
        for kind, name in _read("\n".join(task.files.values())):
            if name.lower() not in own:
                own.add(name.lower())
                wanted[name] = kind
        for name, kind in sorted(wanted.items()):
            got = named.get(name.lower())
            if got is None:
                what = f"signal {name} ({kind}) of {task.arm.name} is not on the controller; "
                out.append(what + "where programs/controller/ has it, load that first")
            elif not got:
                what = f"the type of signal {name} is not told, wanted is {kind}"
                raise refusal("upload.controller", what)
            elif got != kind:
                out.append(f"signal {name} of {task.arm.name} is {got} on the controller, wanted is {kind}")
    return out


def _read(text: str) -> list[tuple[str, str]]:
    """Kinds and names of the signals in RAPID text, also where no step of the straight way has them."""
    plain = re.sub(r'"[^"\n]*"', '""', text)
    plain = re.sub(r"![^\n]*", "", plain)
    return [(kind, name) for kind, pattern in _SIGNALS for name in pattern.findall(plain)]


def _data(rws: Rws, problem: Problem, task: TaskText) -> tuple[list[str], list[str], list[str]]:
    """Tools, work objects and loads that the controller has now, against the text of the same datum in the
    module that is sent: differences, what could not be compared, what agreed."""
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
                same.append(f"{shown} (not loaded there yet, the program brings it)")
                continue
            written = _LITERAL.search(task.files[module.file], datum.start)
            try:
                there = rws.datum(name, module.name, datum.name)
            except TandemError as error:
                lost.append(f"{shown}: {error.issues[0].message}")
                continue
            if there is None or written is None:
                why = "the controller tells no value" if there is None else "the program states no value"
                lost.append(f"{shown} of {name}: module {module.name} is loaded, but {why}")
            elif far := difference(written.group(1), there):
                out.append(f"{shown} of {name} is another one in the loaded module {module.name}: {far}")
            else:
                same.append(shown)
    return out, lost, same
