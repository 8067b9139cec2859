"""The data module of a task: everything that its moves refer to, declared once and named for a reader."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.post.program import Job, Joints, TaskProgram
from planner.post.rapid_format import identifier, jointtarget, number, pose, quoted, short, vector
from planner.post.rapid_moves import own_zones
from planner.problem import Problem, Tool

FloatArray = NDArray[np.float64]

TASKS = "all_tasks"
ENTRY_SPEED = "v_entry"
_ENTRY_TURN = 45
_TOOL_NAME = 12
_LEAST_MASS = 0.001


def meet(n: int) -> str:
    """Name of a meeting point of all tasks."""
    return f"meet_{n}"


def block(n: int, end: str) -> str:
    """Name of the start (``on``) or end (``off``) of a synchronised block."""
    return f"block_{n}_{end}"


def tool_name(tool: Tool) -> str:
    """Name of the tooldata."""
    return identifier(f"t_{tool.name}"[:_TOOL_NAME])


def wobj_name(frame: str) -> str:
    """Name of the wobjdata of a work frame of the targets; the world has a predefined one."""
    return "wobj0" if frame == "world" else identifier("w_stock" if frame == "stock" else "w_held")


class Stations:
    """Names for the joint targets of a task; equal joints of one kind share a name."""

    def __init__(self, task: TaskProgram) -> None:
        self.task = task
        self.names: dict[str, tuple[str, FloatArray]] = {}
        self.of(Joints(task.arm.home, "home"), 0)
        for number_, operation in enumerate(task.operations, 1):
            for step in operation.steps:
                if isinstance(step, Joints):
                    self.of(step, number_)

    def of(self, step: Joints, operation: int) -> str:
        """The name for a step of an operation, counted from 1."""
        text = jointtarget(np.rad2deg(self.task.robot.to_controller(step.q)))
        if text not in self.names:
            stem = "j_home" if step.place == "home" else f"j_{operation}_{step.place}"
            count = sum(name.startswith(stem) for name, _ in self.names.values())
            self.names[text] = (stem if step.place in ("home", "start") else f"{stem}_{count + 1}", step.q)
        return self.names[text][0]

    def lines(self) -> list[str]:
        """The declarations."""
        return [f"CONST jointtarget {name}:={text};" for text, (name, _) in self.names.items()]


def data_lines(
    task: TaskProgram, job: Job, plan: Plan, problem: Problem, stations: Stations, zones: Iterable[str]
) -> list[str]:
    """The declarations of a task, without indentation; empty strings are blank lines."""
    out = ["! what this program was planned for; the proof starts from these"]
    for i, part in enumerate(textwrap.wrap(plan.digest, 80) or [""], 1):
        out.append(f"CONST string problem_digest{'' if i == 1 else f'_{i}'}:={quoted(part)};")
    out += ["! base frame that the controller must have for this arm, in the world"]
    out += [f"CONST pose base_frame:={pose(task.base)};", ""]
    out += [
        "! tool and work objects",
        f"TASK PERS tooldata {tool_name(task.arm.tool)}:={_tool(task.arm.tool)};",
    ]
    out += [*_wobjs(task, job, plan), ""]
    speed = short(problem.settings.tcp_speed * 1e3, 3)
    out += ["! on the way to the first target and home again"]
    out += [
        f"CONST speeddata {ENTRY_SPEED}:=[{speed},{_ENTRY_TURN},{speed},{_ENTRY_TURN}];",
        *stations.lines(),
    ]
    own = own_zones(set(zones))
    if own:
        out += ["", "! zones that fit the distances of the targets", *own]
    if len(job.tasks) > 1:
        names = ",".join(f"[{quoted(other.task)}]" for other in job.tasks)
        out += ["", "! where the tasks meet; each point is used once"]
        out += [f"PERS tasks {TASKS}{{{len(job.tasks)}}}:=[{names}];"]
        out += [f"VAR syncident {meet(n)};" for n in range(1, job.meets + 1)]
        out += [f"VAR syncident {block(n, end)};" for n in range(1, job.blocks + 1) for end in ("on", "off")]
    return out


def _tool(tool: Tool) -> str:
    if not tool.mass >= _LEAST_MASS:
        message = f"tool {tool.name!r} has a mass of {tool.mass} kg; RAPID needs at least {_LEAST_MASS} kg"
        raise TandemError(Issue("post.tool", message, hint="state the tool's mass"))
    load = f"[{number(tool.mass, 3)},{vector(tool.cog * 1e3, 3)},[1,0,0,0],0,0,0]"
    return f"[TRUE,{pose(tool.tcp)},{load}]"


def _wobjs(task: TaskProgram, job: Job, plan: Plan) -> list[str]:
    """Work objects of the frames that the task's targets are in.

    ``TASK PERS``, though equal in all tasks: a shared ``PERS`` keeps the value of a program loaded before.
    """
    identity = pose(np.eye(4))
    out = []
    for frame in dict.fromkeys(item.track.frame for item in task.operations if item.track is not None):
        if frame == "stock":
            out.append(
                f'TASK PERS wobjdata {wobj_name(frame)}:=[FALSE,TRUE,"",{pose(plan.stock_pose)},{identity}];'
            )
        elif frame.startswith("held:"):
            holder = next((t for t in job.tasks if t.arm.name == frame.removeprefix("held:")), None)
            if holder is None:
                message = f"targets of {task.arm.name} lie in {frame!r}, but that arm has no program"
                raise TandemError(Issue("post.frame", message, hint="name an arm that takes part"))
            # the user frame rides on the other arm's flange; the held work's frame is that arm's tool frame
            unit = f"[FALSE,FALSE,{quoted(holder.unit)},{pose(holder.arm.tool.tcp)},{identity}]"
            out.append(f"TASK PERS wobjdata {wobj_name(frame)}:={unit};")
        elif frame != "world":
            message = f"targets of {task.arm.name} lie in the unknown frame {frame!r}"
            raise TandemError(Issue("post.frame", message, hint="allowed: stock, world, held:<arm>"))
    return out
