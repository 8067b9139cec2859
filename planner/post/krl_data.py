"""The data list of a KUKA arm's program: everything that its moves refer to, under one name each."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planner.cell.robots import forward
from planner.geometry.rigid import inverse
from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.post.krl_format import NAME_LENGTH, e6axis, e6pos, frame, name
from planner.post.krl_load import load_data
from planner.post.krl_moves import written
from planner.post.krl_status import status, turn
from planner.post.program import Joints, Load, OperationProgram, TaskProgram
from planner.tooling import Tool

FloatArray = NDArray[np.float64]

_STEM = NAME_LENGTH - 3
"""A number may follow where two tools are called alike."""


class Data:
    """Names and declarations of one task; things with equal values have one name."""

    def __init__(self, task: TaskProgram, plan: Plan) -> None:
        self.task, self.plan = task, plan
        self.lines: dict[str, str] = {}
        self.tools: dict[tuple[str, str], str] = {}
        self.joints: dict[str, str] = {}
        self.loads: dict[tuple[str, str], str] = {}
        self.declare("FRAME", "base_frame", frame(task.base))
        self.joint(Joints(task.arm.home, "home"), 0)

    def declare(self, kind: str, word: str, value: str) -> str:
        """A declaration of ``word``; returns it. Raises ``TandemError`` (``post.name``) for two values."""
        line = f"DECL {kind} {word}={value}"
        if self.lines.setdefault(word, line) != line:
            message = f"two things of arm {self.task.arm.name} would be called {word}"
            raise TandemError(Issue("post.name", message, hint="give the tool another name"))
        return word

    def tool(self, tool: Tool) -> str:
        """Name of a tool's frame."""
        key = (tool.name, frame(tool.tcp) + load_data(tool, None))
        if key not in self.tools:
            stem = name(f"t_{tool.name}", _STEM)[2:]
            names = itertools.chain([stem], (f"{stem}_{n}" for n in itertools.count(2)))
            own = next(one for one in names if one not in self.tools.values())
            self.tools[key] = own
            self.declare("FRAME", f"t_{own}", frame(tool.tcp))
            self.declare("LOAD", f"l_{own}", load_data(tool, None))
        return f"t_{self.tools[key]}"

    def load(self, tool: Tool, held: Load | None) -> str:
        """Name of the load of a tool with what it holds."""
        if held is None:
            return f"l_{self.tool(tool)[2:]}"
        return self.declare("LOAD", f"l_block_{held.setup}", load_data(tool, held))

    def base(self, operation: OperationProgram) -> str:
        """Name of the base of an operation's moves, or of the cell's world where it has none."""
        pose, word = self.base_pose(operation)
        return self.declare("FRAME", word, frame(pose))

    def base_pose(self, operation: OperationProgram) -> tuple[FloatArray, str]:
        """The base (4, 4) of an operation's moves as the robot's foot sees it, and its name."""
        kind = "world" if operation.track is None else operation.track.frame
        foot = inverse(self.task.base)
        if kind == "world":
            return foot, "b_world"
        if kind == "stock":
            place = self.plan.places[operation.setup - 1]
            return foot @ place, "b_stock" if operation.setup == 1 else f"b_stock_{operation.setup}"
        message = f"targets of {self.task.arm.name} lie in {kind!r}, which KRL has no base for"
        raise TandemError(Issue("post.frame", message, hint="allowed: stock, world"))

    def joint(self, step: Joints, operation: int) -> str:
        """Name of the joints of a step of an operation, counted from 1."""
        text = e6axis(np.rad2deg(self.task.robot.to_controller(step.q)))
        if text not in self.joints:
            stem = "x_home" if step.place == "home" else f"x_{operation}_{step.place}"
            count = sum(word.startswith(stem) for word in self.joints.values())
            word = stem if step.place == "home" else f"{stem}_{count + 1}"
            self.joints[text] = self.declare("E6AXIS", word, text)
        return self.joints[text]

    def start(self, operation: OperationProgram, q: FloatArray, number: int) -> str:
        """Name of the first target of an operation, counted from 1: its pose in the base, status and turn."""
        position, angles = self.start_pose(operation, q)
        robot = self.task.robot
        value = e6pos(position, angles, int(status(robot, q)), int(turn(robot, q)))
        return self.declare("E6POS", f"p_{number}_start", value)

    def start_pose(self, operation: OperationProgram, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [mm] and A, B, C (3,) [deg] of the TCP at joints (6,), as written."""
        flange = forward(self.task.robot, q)
        return written(inverse(self.base_pose(operation)[0]) @ flange @ operation.arm.tool.tcp)

    def list(self, stem: str, header: list[str], digest: Mapping[str, str]) -> list[str]:
        """The lines of the data list ``stem``; ``digest``: text constants by name."""
        out = [f"DEFDAT {stem} PUBLIC", *header]
        for word, value in digest.items():
            out += [f"DECL CHAR {word}[{len(value)}]", f'{word}[]="{value}"']
        return [*out, *self.lines.values(), "ENDDAT"]
