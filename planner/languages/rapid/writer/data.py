"""The data module of a task: all that its moves refer to, declared once, and the check of it.

A module of its own compares, before anything moves, what the controller has with what was planned:
base frame, tools and work objects.
"""

import itertools
import textwrap
from collections.abc import Iterable

import numpy as np

from planner.geometry.arrays import FloatArray, to_quaternion
from planner.issues import refusal
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.writer.syntax import identifier, jointtarget, own_zones, pose, quoted, vector
from planner.languages.writing import layout
from planner.languages.writing.outer_axes import outer_names, outer_speeds
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.problem import BLIND_SPEED, OUTER_DECIMALS, Problem
from planner.tooling import Tool

TASK_LIST = "all_tasks"
"""Name of the list of all motion tasks."""
ENTRY_SPEED_NAME = "v_entry"
"""Name of the speed of joint moves."""
_ENTRY_TURN_RATE = 45
"""Highest turning [deg/s] of joint moves."""
_TOOL_NAME_LENGTH = 26
"""Letters of a tool's name, with the number where two are called alike: identifiers may have 32, but the
longest moves would then have more than the 206 characters of lines that are known to load."""


def meet(n: int) -> str:
    """Name of a meeting point of all tasks."""
    return f"meet_{n}"


def block(n: int, end: str) -> str:
    """Name of the start (``on``) or end (``off``) of a synchronised block."""
    return f"block_{n}_{end}"


def wobj_name(frame: str, setup: int) -> str:
    """Name of the wobjdata of a work frame of the targets in a setup; the world has a predefined one."""
    if frame == "world":
        return "wobj0"
    return ("w_stock" if frame == "stock" else "w_held") + _number(setup)


def load_name(load: layout.Load | None) -> str:
    """Name of the loaddata of what is carried."""
    return "load0" if load is None else f"load_block{_number(load.setup)}"


def _number(setup: int) -> str:
    return "" if setup == 1 else f"_{setup}"


class Tools:
    """Names for the tools of a task, a tool's data under one name in all setups."""

    def __init__(self, task: layout.TaskProgram) -> None:
        self.names: dict[tuple[str, str], str] = {}
        for operation in task.operations:
            self.of(operation.arm.tool)

    def of(self, tool: Tool) -> str:
        """Name of a tool's tooldata."""
        key = (tool.name, _tool(tool))
        if key not in self.names:
            stem = identifier(f"t_{tool.name}"[:_TOOL_NAME_LENGTH])
            taken = {name.lower() for name in self.names.values()}
            tails = (f"_{n}" for n in itertools.count(2))
            names = itertools.chain([stem], (stem[: _TOOL_NAME_LENGTH - len(tail)] + tail for tail in tails))
            self.names[key] = next(name for name in names if name.lower() not in taken)
        return self.names[key]

    def lines(self) -> list[str]:
        """The declarations."""
        return [f"TASK PERS tooldata {name}:={data};" for (_, data), name in self.names.items()]


class Stations:
    """Names for the joint targets of a task; equal joints of one kind share a name."""

    def __init__(self, task: layout.TaskProgram) -> None:
        self.task = task
        self.names: dict[str, tuple[str, FloatArray]] = {}
        self.of(layout.Joints(task.arm.home, "home", station=task.home_station), 0)
        for number_, operation in enumerate(task.operations, 1):
            for step in operation.steps:
                if isinstance(step, layout.Joints):
                    self.of(step, number_)

    def of(self, step: layout.Joints, operation: int) -> str:
        """The name for a step of an operation, counted from 1."""
        text = jointtarget(np.rad2deg(self.task.robot.to_controller(step.q)), step.station)
        if text not in self.names:
            stem = "j_home" if step.place == "home" else f"j_{operation}_{step.place}"
            count = sum(name.startswith(stem) for name, _ in self.names.values())
            self.names[text] = (stem if step.place in ("home", "start") else f"{stem}_{count + 1}", step.q)
        return self.names[text][0]

    def lines(self) -> list[str]:
        """The declarations."""
        return [f"CONST jointtarget {name}:={text};" for text, (name, _) in self.names.items()]


def data_lines(
    task: layout.TaskProgram,
    job: layout.Job,
    plan: Plan,
    problem: Problem,
    names: tuple[Tools, Stations],
    zones: Iterable[str],
) -> list[str]:
    """The declarations of a task, without indentation; empty strings are blank lines."""
    out = ["! what this program was planned for; the proof starts from these"]
    for i, part in enumerate(textwrap.wrap(plan.digest, 80) or [""], 1):
        out.append(f"CONST string problem_digest{'' if i == 1 else f'_{i}'}:={quoted(part)};")
    out += ["! base frame that the controller must have for this arm, in the world"]
    out += [f"CONST pose base_frame:={pose(task.base)};", ""]
    tools, stations = names
    out += ["! tool and work objects" if len(tools.names) == 1 else "! tools and work objects"]
    out += [*tools.lines(), *_wobjs(task, job, plan), *_loads(task), ""]
    speed = outer = layout.short(min(problem.settings.tcp_speed * 1e3, BLIND_SPEED * 1e3), 3)
    turning = str(_ENTRY_TURN_RATE)
    moved = outer_speeds(task, plan, problem)
    if task.arm.axes:
        outer = layout.short(min(moved[axis.column].most for axis in task.arm.axes) * 1e3, 3)
    if task.table is not None:
        most = min(moved[axis.column].most for axis in task.table.axes.values())
        rate = min(np.rad2deg(most), _ENTRY_TURN_RATE)
        turning = layout.short(np.floor(rate * 1e3) / 1e3, 3)
    out += ["! on the way to the first target and home again"]
    out += [
        f"CONST speeddata {ENTRY_SPEED_NAME}:=[{speed},{_ENTRY_TURN_RATE},{outer},{turning}];",
        *stations.lines(),
    ]
    own = own_zones(set(zones))
    if own:
        out += ["", "! zones that fit the distances of the targets", *own]
    if len(job.tasks) > 1 and job.handshake is None:
        listed = ",".join(f"[{quoted(other.task)}]" for other in job.tasks)
        out += ["", "! where the tasks meet; each point is used once"]
        out += [f"PERS tasks {TASK_LIST}{{{len(job.tasks)}}}:=[{listed}];"]
        out += [f"VAR syncident {meet(n)};" for n in range(1, job.meets + 1)]
        out += [f"VAR syncident {block(n, end)};" for n in range(1, job.blocks + 1) for end in ("on", "off")]
    return out


def _tool(tool: Tool) -> str:
    require_mass(tool, "RAPID needs at least {} kg")
    load = f"[{layout.number(tool.mass, 3)},{vector(tool.cog * 1e3, 3)},[1,0,0,0],0,0,0]"
    return f"[TRUE,{pose(tool.tcp)},{load}]"


def _wobjs(task: layout.TaskProgram, job: layout.Job, plan: Plan) -> list[str]:
    """Work objects of the frames that the task's targets are in, setup by setup.

    ``TASK PERS``, though equal in all tasks: a shared ``PERS`` keeps the value of a program loaded before.
    """
    out: dict[str, str] = {}
    for index, operation in enumerate(task.operations):
        if operation.track is None or operation.track.frame == "world":
            continue
        frame = operation.track.frame
        if frame == "stock":
            data = f'[FALSE,TRUE,"",{pose(plan.places[operation.setup - 1])},{pose(np.eye(4))}]'
        elif frame.startswith("held:"):
            holder = next((t for t in job.tasks if t.arm.name == frame.removeprefix("held:")), None)
            if holder is None:
                message = f"targets of {task.arm.name} lie in {frame!r}, but that arm has no program"
                raise refusal("post.frame", message, hint="name an arm that takes part")
            data = _held(holder, holder.operations[index])
        else:
            message = f"targets of {task.arm.name} lie in the unknown frame {frame!r}"
            raise refusal("post.frame", message, hint="allowed: stock, world, held:<arm>")
        out[wobj_name(frame, operation.setup)] = data
    return [f"TASK PERS wobjdata {name}:={data};" for name, data in out.items()]


def _held(holder: layout.TaskProgram, operation: layout.OperationProgram) -> str:
    """A work object that rides on the holder's flange, its object frame being the holder's TCP frame.

    The controller itself keeps a moving user frame at the flange of the unit named; what a program states
    for it is not relied on. The offset from there to the work therefore stands in the object frame.
    """
    return f"[FALSE,FALSE,{quoted(holder.unit)},{pose(np.eye(4))},{pose(operation.arm.tool.tcp)}]"


def _loads(task: layout.TaskProgram) -> list[str]:
    """What the arm carries; the centre and the axes of the moments of inertia are in the tool's frame."""
    steps = (step for operation in task.operations for step in operation.steps)
    out = []
    for load in (step.load for step in steps if isinstance(step, layout.Carry) and step.load is not None):
        axes, cog = vector(to_quaternion(load.axes), 8), vector(load.cog * 1e3, 3)
        moments = ",".join(layout.number(float(value), 6) for value in load.inertia)
        data = f"[{layout.number(load.mass, 4)},{cog},{axes},{moments}]"
        out.append(f"TASK PERS loaddata {load_name(load)}:={data};")
    return out


CELL_CHECK = "check_cell"
"""Name of the procedure that holds the cell's set-up against the problem."""
_AXES = "xyz"
"""Components of a position."""


def check_procedures(
    task: layout.TaskProgram, job: layout.Job, plan: Plan, tools: Tools, robot: str
) -> list[str]:
    """Statements of the procedure :data:`CELL_CHECK`; ``robot`` is the robot's name in the configuration."""
    place = quoted(f"/MOC/ROBOT/{robot}")
    out = ["VAR pose cfg_base;", "VAR num cfg_value;"]
    for axis in _AXES:
        out += [f'ReadCfgData {place},"base_frame_pos_{axis}",cfg_value;']
        out += [f"cfg_base.trans.{axis}:=1000*cfg_value;"]
    for part in range(4):
        out += [f'ReadCfgData {place},"base_frame_orient_u{part}",cfg_value;']
        out += [f"cfg_base.rot.q{part + 1}:=cfg_value;"]
    out += [_pose(rapid_sentences.BASE_OF.filled(arm=task.arm.name), "cfg_base", "base_frame")]
    for name, matrix in {tools.of(op.arm.tool): op.arm.tool.tcp for op in task.operations}.items():
        out += [_pose(rapid_sentences.FRAME_OF.filled(name=name), f"{name}.tframe", pose(matrix))]
        out += [f"check_true {quoted(rapid_sentences.HOLDER_OF.filled(name=name))},{name}.robhold;"]
    return [*out, *_wobj_checks(task, job, plan)]


def _wobj_checks(task: layout.TaskProgram, job: layout.Job, plan: Plan) -> list[str]:
    """Where the user frame is fixed it is compared too; one that moves is the controller's own."""
    out: dict[str, list[str]] = {}
    for index, operation in enumerate(task.operations):
        if operation.track is None or operation.track.frame == "world":
            continue
        frame = operation.track.frame
        name = wobj_name(frame, operation.setup)
        kind = quoted(rapid_sentences.HOLDER_OF.filled(name=name))
        if frame == "stock":
            place, inner = pose(plan.places[operation.setup - 1]), pose(np.eye(4))
            lines = [_pose(rapid_sentences.USER_FRAME_OF.filled(name=name), f"{name}.uframe", place)]
            lines += [f"check_true {kind},NOT {name}.robhold AND {name}.ufprog;"]
        else:
            holder = next(t for t in job.tasks if t.arm.name == frame.removeprefix("held:"))
            inner = pose(holder.operations[index].arm.tool.tcp)
            moved = f"NOT {name}.robhold AND NOT {name}.ufprog AND {name}.ufmec={quoted(holder.unit)}"
            lines = [f"check_true {kind},{moved};"]
        what = rapid_sentences.OBJECT_FRAME_OF.filled(name=name)
        out[name] = [_pose(what, f"{name}.oframe", inner), *lines]
    return [line for lines in out.values() for line in lines]


def _pose(what: str, got: str, wanted: str) -> str:
    return f"check_pose {quoted(what)},{got},{wanted};"


AXES_CHECK = "check_axes"
"""Name of the procedure that looks whether tracks and turntables are at home, right before the first move."""
AXIS_AWAY = {"mm": "1", "deg": "0.1"}
"""How far one may be off home, by the unit of its values."""


def axes_checks(task: layout.TaskProgram) -> list[str]:
    """Statements of the procedure :data:`AXES_CHECK`, none where the task moves no external axis. One that is
    not active has the value 9E9 and is off, too."""
    if task.home_station is None:
        return []
    out = ["VAR jointtarget cfg_here;", "cfg_here:=CJointT();"]
    for column, home in task.home_station:
        label, sign = outer_names(task)[column]
        name = quoted(rapid_sentences.AXIS_OF.filled(unit=label))
        value = f"cfg_here.extax.eax_{'abcdef'[column]}"
        out.append(f"check_axis {name},{value},{layout.number(home, OUTER_DECIMALS)},{AXIS_AWAY[sign]};")
    return out


def helpers(together: bool, axes: bool) -> list[str]:
    """The procedures that compare and, where something is off, say what and never go on."""
    axis = [
        "PROC check_axis(string what,num got,num wanted,num most)",
        "  IF Abs(got-wanted)>most THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(rapid_sentences.OFF_HOME)}\\Num:=got-wanted;",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
    ]
    apart = [f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in range(1, 5)]
    along = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in range(1, 5))
    return [
        "! a turn is small here: twice the distance of the quaternions, in degrees",
        "PROC check_pose(string what,pose got,pose wanted)",
        "  VAR num off_sign:=1;",
        "  VAR num off_turn;",
        f"  IF {along}<0 THEN",
        "    off_sign:=-1;",
        "  ENDIF",
        f"  off_turn:=114.591559*Sqrt({apart[0]}+{apart[1]}",
        f"    +{apart[2]}+{apart[3]});",
        "  IF Distance(got.trans,wanted.trans)>0.1 OR off_turn>0.02 THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(rapid_sentences.OFF_BY_MM)}\\Num:=Distance(got.trans,wanted.trans);",
        f"    TPWrite {quoted(rapid_sentences.OFF_BY_DEGREES)}\\Num:=off_turn;",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
        "PROC check_true(string what,bool same)",
        "  IF NOT same THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(rapid_sentences.NOT_AS_PLANNED)};",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
        *(axis if axes else ()),
        "! a start does not lead out of here",
        "PROC check_stop()",
        *(f"  TPWrite {quoted(line)};" for line in rapid_sentences.NOTHING_MOVES),
        "  WHILE TRUE DO",
        "    Stop\\AllMoveTasks;" if together else "    Stop;",
        "  ENDWHILE",
        "ENDPROC",
    ]
