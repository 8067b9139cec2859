"""The data module of a task, and the module that checks the cell.

The data module declares everything that moves refer to, once. The check module compares, before anything
moves, base frame, tools and work objects of the controller with the plan.
"""

import itertools
import textwrap
from collections.abc import Iterable

import numpy as np

from planner.geometry.arrays import FloatArray, to_quaternion
from planner.issues import issue_error
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.writer.syntax import (
    identifier,
    jointtarget,
    pose,
    quoted,
    vector,
    zone_declarations,
)
from planner.languages.writing import layout
from planner.languages.writing.external_axes import external_axis_names, external_axis_speeds
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.problem import EXTERNAL_AXIS_DECIMALS, MAX_BLIND_SPEED_M_S, Problem
from planner.tooling import Tool

TASK_LIST = "all_tasks"
"""Name of the persistent list of all motion tasks, with which synchronisation points are stated."""
ENTRY_SPEED_NAME = "v_entry"
"""Name of the speeddata of joint moves."""
_ENTRY_ROTATION_SPEED_DEG_S = 45
"""Maximum reorientation speed of joint moves [deg/s]."""
_TOOL_NAME_LENGTH = 26
"""Maximum length of a tool's name [characters], including the number that tells equal names apart.

Identifiers may have 32 characters, but the longest moves would then exceed the 206 characters of lines that
are known to load.
"""


def meeting_name(n: int) -> str:
    """Return the name of meeting point ``n`` of all tasks."""
    return f"meet_{n}"


def block_name(n: int, end: str) -> str:
    """Return the name of the start or end of a synchronised block.

    Args:
        n: Number of the block, from 1.
        end: ``on`` for the start, ``off`` for the end.
    """
    return f"block_{n}_{end}"


def wobj_name(frame: str, setup: int) -> str:
    """Return the name of the wobjdata of a work frame; the world has the predefined wobj0.

    Args:
        frame: Frame of the targets: ``world``, ``stock`` or ``held:<arm>``.
        setup: Number of the setup, from 1.
    """
    if frame == "world":
        return "wobj0"
    return ("w_stock" if frame == "stock" else "w_held") + _setup_suffix(setup)


def load_name(load: layout.HeldLoad | None) -> str:
    """Return the name of the loaddata of what is carried, load0 for None."""
    return "load0" if load is None else f"load_block{_setup_suffix(load.setup)}"


def _setup_suffix(setup: int) -> str:
    """Return the suffix of names that differ between setups, "" for the first setup."""
    return "" if setup == 1 else f"_{setup}"


class ToolNames:
    """Names of the tooldata of a task, by tool name and tooldata. A tool has one name in all setups."""

    def __init__(self, task: layout.TaskProgram) -> None:
        self.names: dict[tuple[str, str], str] = {}
        for operation in task.operations:
            self.of(operation.arm.tool)

    def of(self, tool: Tool) -> str:
        """Return the name of a tool's tooldata, a new one at the first call for this tool."""
        key = (tool.name, _tooldata(tool))
        if key not in self.names:
            stem = identifier(f"t_{tool.name}"[:_TOOL_NAME_LENGTH])
            taken = {name.lower() for name in self.names.values()}
            tails = (f"_{n}" for n in itertools.count(2))
            names = itertools.chain([stem], (stem[: _TOOL_NAME_LENGTH - len(tail)] + tail for tail in tails))
            self.names[key] = next(name for name in names if name.lower() not in taken)
        return self.names[key]

    def lines(self) -> list[str]:
        """Return the declarations of the tooldata."""
        return [f"TASK PERS tooldata {name}:={data};" for (_, data), name in self.names.items()]


class JointTargetNames:
    """Names of the jointtargets of a task, by their text. Targets with equal text share a name."""

    def __init__(self, task: layout.TaskProgram) -> None:
        self.task = task
        self.names: dict[str, tuple[str, FloatArray]] = {}
        self.of(layout.JointMove(task.arm.home, "home", axis_setpoint=task.home_setpoint), 0)
        for number, operation in enumerate(task.operations, 1):
            for step in operation.steps:
                if isinstance(step, layout.JointMove):
                    self.of(step, number)

    def of(self, step: layout.JointMove, operation: int) -> str:
        """Return the name of the target of a joint move, a new one at the first call for these values.

        Args:
            step: The joint move.
            operation: Number of its operation, from 1.
        """
        text = jointtarget(np.rad2deg(self.task.robot.to_controller(step.q)), step.axis_setpoint)
        if text not in self.names:
            stem = "j_home" if step.role == "home" else f"j_{operation}_{step.role}"
            count = sum(name.startswith(stem) for name, _ in self.names.values())
            name = stem if step.role in ("home", "start") else f"{stem}_{count + 1}"
            self.names[text] = (name, step.q)
        return self.names[text][0]

    def lines(self) -> list[str]:
        """Return the declarations of the jointtargets."""
        return [f"CONST jointtarget {name}:={text};" for text, (name, _) in self.names.items()]


def data_lines(
    task: layout.TaskProgram,
    job: layout.JobPrograms,
    plan: Plan,
    problem: Problem,
    names: tuple[ToolNames, JointTargetNames],
    zones: Iterable[str],
) -> list[str]:
    """Return the declarations of a task, without indentation; empty strings are blank lines.

    Args:
        task: The task.
        job: All tasks.
        plan: The plan that is written.
        problem: Its problem.
        names: Names of tools and jointtargets.
        zones: Names of the zones that the moves use.
    """
    out = ["! problem that this program was planned for; the proof starts from this digest"]
    for i, part in enumerate(textwrap.wrap(plan.digest, 80) or [""], 1):
        out.append(f"CONST string problem_digest{'' if i == 1 else f'_{i}'}:={quoted(part)};")
    out += ["! base frame that the controller must have for this arm, in the world"]
    out += [f"CONST pose base_frame:={pose(task.base)};", ""]
    tools, joint_targets = names
    out += ["! tool and work objects" if len(tools.names) == 1 else "! tools and work objects"]
    out += [*tools.lines(), *_wobj_declarations(task, job, plan), *_load_declarations(task), ""]
    # speeddata of joint moves [mm/s, deg/s]: those of external axes are lowered if the arm has any
    speed = linear_speed = layout.format_short(
        min(problem.settings.tcp_speed * 1e3, MAX_BLIND_SPEED_M_S * 1e3), 3
    )
    rotary_speed = str(_ENTRY_ROTATION_SPEED_DEG_S)
    speeds = external_axis_speeds(task, plan, problem)
    if task.arm.linear_axes:
        linear_speed = layout.format_short(
            min(speeds[axis.column].travel for axis in task.arm.linear_axes) * 1e3, 3
        )
    if task.table is not None:
        max_speed = min(speeds[axis.column].travel for axis in task.table.axes.values())
        rate = min(np.rad2deg(max_speed), _ENTRY_ROTATION_SPEED_DEG_S)
        rotary_speed = layout.format_short(np.floor(rate * 1e3) / 1e3, 3)  # rounded down
    out += ["! moves from home to the first target and back"]
    out += [
        "CONST speeddata "
        f"{ENTRY_SPEED_NAME}:=[{speed},{_ENTRY_ROTATION_SPEED_DEG_S},{linear_speed},{rotary_speed}];",
        *joint_targets.lines(),
    ]
    declared_zones = zone_declarations(set(zones))
    if declared_zones:
        out += ["", "! zones sized for the distances of the targets", *declared_zones]
    if len(job.tasks) > 1 and job.handshake is None:
        listed = ",".join(f"[{quoted(other.task)}]" for other in job.tasks)
        out += ["", "! meeting points of the tasks; each is used once"]
        out += [f"PERS tasks {TASK_LIST}{{{len(job.tasks)}}}:=[{listed}];"]
        out += [f"VAR syncident {meeting_name(n)};" for n in range(1, job.meets + 1)]
        out += [
            f"VAR syncident {block_name(n, end)};" for n in range(1, job.blocks + 1) for end in ("on", "off")
        ]
    return out


def _tooldata(tool: Tool) -> str:
    """Return the tooldata of a tool on the flange as RAPID text, without moments of inertia.

    Raises:
        TandemError: The tool has no mass (``post.tool``).
    """
    require_mass(tool, "RAPID needs at least {} kg")
    load = f"[{layout.format_fixed(tool.mass, 3)},{vector(tool.cog * 1e3, 3)},[1,0,0,0],0,0,0]"
    return f"[TRUE,{pose(tool.tcp)},{load}]"


def _wobj_declarations(task: layout.TaskProgram, job: layout.JobPrograms, plan: Plan) -> list[str]:
    """Return declarations of the work objects in whose frames the task's targets are.

    They are in the order of operations. They are ``TASK PERS`` although they are equal in all tasks: a shared
    ``PERS`` keeps the value of a program that was loaded before.
    """
    data_by_name: dict[str, str] = {}
    for index, operation in enumerate(task.operations):
        if operation.moves is None or operation.moves.frame == "world":
            continue
        frame = operation.moves.frame
        if frame == "stock":
            data = f'[FALSE,TRUE,"",{pose(plan.stock_poses[operation.setup - 1])},{pose(np.eye(4))}]'
        elif frame.startswith("held:"):
            holder = next(
                (other for other in job.tasks if other.arm.name == frame.removeprefix("held:")), None
            )
            if holder is None:
                message = f"targets of {task.arm.name} are in {frame!r}, but that arm has no program"
                raise issue_error("post.frame", message, hint="name an arm that has a program")
            data = _held_wobjdata(holder, holder.operations[index])
        else:
            message = f"targets of {task.arm.name} are in the unknown frame {frame!r}"
            raise issue_error("post.frame", message, hint="allowed: stock, world, held:<arm>")
        data_by_name[wobj_name(frame, operation.setup)] = data
    return [f"TASK PERS wobjdata {name}:={data};" for name, data in data_by_name.items()]


def _held_wobjdata(holder: layout.TaskProgram, operation: layout.OperationProgram) -> str:
    """Return the wobjdata of a work object on the holder's flange as RAPID text.

    The controller itself keeps the user frame at the flange of the named mechanical unit. The planner does
    not rely on the value that a program states for it. The object frame is the holder's TCP frame, stated in
    its flange frame.
    """
    return f"[FALSE,FALSE,{quoted(holder.unit)},{pose(np.eye(4))},{pose(operation.arm.tool.tcp)}]"


def _load_declarations(task: layout.TaskProgram) -> list[str]:
    """Return the declarations of the loads that the arm carries; their values are in the tool frame."""
    steps = (step for operation in task.operations for step in operation.steps)
    out = []
    for load in (step.load for step in steps if isinstance(step, layout.CarryLoad) and step.load is not None):
        axes = vector(to_quaternion(load.axes), 8)
        cog = vector(load.cog * 1e3, 3)
        moments = ",".join(layout.format_fixed(float(value), 6) for value in load.inertia)
        data = f"[{layout.format_fixed(load.mass, 4)},{cog},{axes},{moments}]"
        out.append(f"TASK PERS loaddata {load_name(load)}:={data};")
    return out


CELL_CHECK = "check_cell"
"""Name of the procedure that compares the cell with the problem."""
_AXES = "xyz"
"""Components of a position."""


def cell_check_statements(
    task: layout.TaskProgram, job: layout.JobPrograms, plan: Plan, tools: ToolNames, robot: str
) -> list[str]:
    """Return the statements of the procedure :data:`CELL_CHECK`.

    Args:
        task: The task.
        job: All tasks.
        plan: The plan that is written.
        tools: Names of the task's tools.
        robot: Name of the robot in the controller's configuration.
    """
    config_path = quoted(f"/MOC/ROBOT/{robot}")
    out = ["VAR pose cfg_base;", "VAR num cfg_value;"]
    for axis in _AXES:
        out += [f'ReadCfgData {config_path},"base_frame_pos_{axis}",cfg_value;']
        out += [f"cfg_base.trans.{axis}:=1000*cfg_value;"]
    for part in range(4):
        out += [f'ReadCfgData {config_path},"base_frame_orient_u{part}",cfg_value;']
        out += [f"cfg_base.rot.q{part + 1}:=cfg_value;"]
    out += [_pose_check(rapid_sentences.BASE_OF.format(arm=task.arm.name), "cfg_base", "base_frame")]
    tool_frames = {tools.of(operation.arm.tool): operation.arm.tool.tcp for operation in task.operations}
    for name, tcp in tool_frames.items():
        out += [_pose_check(rapid_sentences.FRAME_OF.format(name=name), f"{name}.tframe", pose(tcp))]
        out += [f"check_true {quoted(rapid_sentences.HOLDER_OF.format(name=name))},{name}.robhold;"]
    return [*out, *_wobj_checks(task, job, plan)]


def _wobj_checks(task: layout.TaskProgram, job: layout.JobPrograms, plan: Plan) -> list[str]:
    """Return the statements that check work objects.

    A moving user frame is not compared: the controller sets it.
    """
    lines_by_name: dict[str, list[str]] = {}
    for index, operation in enumerate(task.operations):
        if operation.moves is None or operation.moves.frame == "world":
            continue
        frame = operation.moves.frame
        name = wobj_name(frame, operation.setup)
        holder_text = quoted(rapid_sentences.HOLDER_OF.format(name=name))
        if frame == "stock":
            user_frame = pose(plan.stock_poses[operation.setup - 1])
            object_frame = pose(np.eye(4))
            lines = [
                _pose_check(rapid_sentences.USER_FRAME_OF.format(name=name), f"{name}.uframe", user_frame)
            ]
            lines += [f"check_true {holder_text},NOT {name}.robhold AND {name}.ufprog;"]
        else:
            holder = next(other for other in job.tasks if other.arm.name == frame.removeprefix("held:"))
            object_frame = pose(holder.operations[index].arm.tool.tcp)
            condition = f"NOT {name}.robhold AND NOT {name}.ufprog AND {name}.ufmec={quoted(holder.unit)}"
            lines = [f"check_true {holder_text},{condition};"]
        title = rapid_sentences.OBJECT_FRAME_OF.format(name=name)
        lines_by_name[name] = [_pose_check(title, f"{name}.oframe", object_frame), *lines]
    return [line for lines in lines_by_name.values() for line in lines]


def _pose_check(title: str, actual: str, expected: str) -> str:
    """Return the statement that compares two poses, given as RAPID text.

    ``title`` names the pose in the text that is shown if they differ.
    """
    return f"check_pose {quoted(title)},{actual},{expected};"


AXES_CHECK = "check_axes"
"""Name of the procedure that checks, right before the first move, that tracks and turntables are at home."""
AXIS_HOME_TOLERANCE = {"mm": "1", "deg": "0.1"}
"""Tolerance of the home position of a track or turntable as RAPID text, by the unit of its values."""


def axes_check_statements(task: layout.TaskProgram) -> list[str]:
    """Return the statements of the procedure :data:`AXES_CHECK`, or none if the task moves no external axis.

    An axis that is not active has the value 9E9, so that it fails the check, too.
    """
    if task.home_setpoint is None:
        return []
    out = ["VAR jointtarget cfg_here;", "cfg_here:=CJointT();"]
    for column, home in task.home_setpoint:
        label, unit = external_axis_names(task)[column]
        name = quoted(rapid_sentences.AXIS_OF.format(unit=label))
        value = f"cfg_here.extax.eax_{'abcdef'[column]}"
        out.append(
            f"check_axis {name},{value},{layout.format_fixed(home, EXTERNAL_AXIS_DECIMALS)},"
            f"{AXIS_HOME_TOLERANCE[unit]};"
        )
    return out


def check_helpers(multiple_tasks: bool, with_axes: bool) -> list[str]:
    """Return the procedures that compare values and, on a difference, report it and stop for good.

    Args:
        multiple_tasks: Whether several tasks of one controller must be stopped.
        with_axes: Whether the task checks external axes.
    """
    axis = [
        "PROC check_axis(string what,num got,num wanted,num most)",
        "  IF Abs(got-wanted)>most THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(rapid_sentences.HOME_DEVIATION)}\\Num:=got-wanted;",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
    ]
    squares = [f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in range(1, 5)]
    dot_product = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in range(1, 5))
    return [
        "! small rotation angle: twice the distance of the quaternions, in degrees",
        "PROC check_pose(string what,pose got,pose wanted)",
        "  VAR num off_sign:=1;",
        "  VAR num off_turn;",
        f"  IF {dot_product}<0 THEN",
        "    off_sign:=-1;",
        "  ENDIF",
        f"  off_turn:=114.591559*Sqrt({squares[0]}+{squares[1]}",
        f"    +{squares[2]}+{squares[3]});",
        "  IF Distance(got.trans,wanted.trans)>0.1 OR off_turn>0.02 THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(rapid_sentences.POSITION_DEVIATION)}\\Num:=Distance(got.trans,wanted.trans);",
        f"    TPWrite {quoted(rapid_sentences.ROTATION_DEVIATION)}\\Num:=off_turn;",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
        "PROC check_true(string what,bool same)",
        "  IF NOT same THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(rapid_sentences.DIFFERS_FROM_PLAN)};",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
        *(axis if with_axes else ()),
        "! a restart stays in this loop",
        "PROC check_stop()",
        *(f"  TPWrite {quoted(line)};" for line in rapid_sentences.MOTION_BLOCKED),
        "  WHILE TRUE DO",
        "    Stop\\AllMoveTasks;" if multiple_tasks else "    Stop;",
        "  ENDWHILE",
        "ENDPROC",
    ]
