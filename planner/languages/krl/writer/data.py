"""The data list of a KUKA arm's program: all that its moves refer to, under one name each.

Loads: a KUKA controller is told one load, of the tool and of the block that it holds together.

Status and turn say which of the arm's postures a PTP to a pose means. S bit 0 (1): the wrist's
centre lies behind axis 1. Bit 1 (2): axis 3 is bent to the positive side of the posture in which
shoulder, elbow and wrist's centre are in line. Bit 2 (4): axis 5 is negative. T bit i - 1: axis i
is negative. Sources: KUKA's expert programming manual as cited in a forum (bit 0); points taught on
real robots (bits 1, 2).
"""

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward
from planner.geometry.arrays import FloatArray, IntArray, from_parts, inverse
from planner.issues import refusal
from planner.languages.krl.writer.syntax import NAME_LENGTH, aggregate, e6axis, e6pos, frame, name, written
from planner.languages.writing.layout import Joints, Load, OperationProgram, TaskProgram, number
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.tooling import Tool


def load_data(tool: Tool, held: Load | None) -> str:
    """A LOAD: mass [kg], centre in the flange's frame [mm, deg], moments of inertia about the axes there.

    A tool is a point mass, as the problem states it; ``held`` has its axes and moments. Both together have
    the centre of mass, and the principal axes and moments by the parallel axis theorem. Raises
    :class:`TandemError` (``post.tool``) for a tool without mass.
    """
    require_mass(tool)
    mass, centre, axes, moments = tool.mass, np.asarray(tool.cog), np.eye(3), np.zeros(3)
    if held is not None:
        mass, centre, axes, moments = _together(tool, held)
    pose = frame(from_parts(axes, centre), millimetres=3)
    inertia = aggregate(dict(zip("XYZ", (number(v, 6) for v in moments), strict=True)))
    return aggregate({"M": number(mass, 3), "CM": pose, "J": inertia})


def _together(tool: Tool, held: Load) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Mass, centre (3,), axes (3, 3) and moments (3,) of tool and block in the flange's frame."""
    turned = tool.tcp[:3, :3] @ held.axes
    place = tool.tcp[:3, :3] @ held.cog + tool.tcp[:3, 3]
    mass = tool.mass + held.mass
    centre = (tool.mass * tool.cog + held.mass * place) / mass
    tensor = turned @ np.diag(held.inertia) @ turned.T
    for weight, at in ((tool.mass, tool.cog), (held.mass, place)):
        arm = at - centre
        tensor = tensor + weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return mass, centre, axes, moments


DEGREE_DECIMALS: Final = 4
"""Joints are rounded so before they are looked at, so that one on a border is not settled by noise."""
TURN_IGNORED: Final = np.deg2rad(2.0)
"""A controller may leave the turn bit of an axis so near to zero alone [rad]."""


def status(robot: RobotData, q: FloatArray) -> IntArray:
    """S (...,) of serial joint angles q (..., 6) [rad]."""
    rounded = _rounded(robot, q)
    p = robot.opw
    theta = p.signs * robot.from_controller(rounded) - p.offsets
    upper, elbow = theta[..., 1], theta[..., 2]
    across = p.a2 * np.cos(elbow) + p.c3 * np.sin(elbow)
    along = p.c2 + p.c3 * np.cos(elbow) - p.a2 * np.sin(elbow)
    ahead = p.a1 + along * np.sin(upper) + across * np.cos(upper)
    return np.asarray((ahead < 0.0) + 2 * (across >= 0.0) + 4 * (rounded[..., 4] < 0.0), dtype=np.int64)


def turn(robot: RobotData, q: FloatArray) -> IntArray:
    """T (...,) of serial joint angles q (..., 6) [rad]."""
    return np.asarray((_rounded(robot, q) < 0.0) @ (1 << np.arange(6)), dtype=np.int64)


def near_zero(robot: RobotData, q: FloatArray) -> IntArray:
    """Axes, from 1, of joints (6,) [rad] whose turn bit a controller may leave alone."""
    return np.flatnonzero(np.abs(robot.to_controller(q)) <= TURN_IGNORED) + 1


def _rounded(robot: RobotData, q: FloatArray) -> FloatArray:
    """Return the joints (..., 6) [rad] as the controller stores them, rounded."""
    return np.deg2rad(np.round(np.rad2deg(robot.to_controller(q)), DEGREE_DECIMALS))


_STEM_LENGTH = NAME_LENGTH - 3
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
        self.joint(Joints(task.arm.home, "home", station=task.home_station), 0)

    def declare(self, kind: str, word: str, value: str) -> str:
        """A declaration of ``word``; returns it. Raises ``TandemError`` (``post.name``) for two values."""
        line = f"DECL {kind} {word}={value}"
        if self.lines.setdefault(word, line) != line:
            message = f"two things of arm {self.task.arm.name} would be called {word}"
            raise refusal("post.name", message, hint="give the tool another name")
        return word

    def tool(self, tool: Tool) -> str:
        """Name of a tool's frame."""
        key = (tool.name, frame(tool.tcp) + load_data(tool, None))
        if key not in self.tools:
            stem = name(f"t_{tool.name}", _STEM_LENGTH)[2:]
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
        raise refusal("post.frame", message, hint="allowed: stock, world")

    def joint(self, step: Joints, operation: int) -> str:
        """Name of the joints of a step of an operation, counted from 1."""
        text = e6axis(np.rad2deg(self.task.robot.to_controller(step.q)), step.station)
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
        axes = operation.station
        value = e6pos(position, angles, int(status(robot, q)), int(turn(robot, q)), axes)
        return self.declare("E6POS", f"p_{number}_start", value)

    def start_pose(self, operation: OperationProgram, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [mm] and A, B, C (3,) [deg] of the TCP at joints (6,), as written."""
        flange = forward(self.task.robot, q)
        if operation.arm.axes:  # the base is seen from where the foot is at values 0
            flange = inverse(self.task.base) @ operation.arm.base @ flange
        return written(inverse(self.base_pose(operation)[0]) @ flange @ operation.arm.tool.tcp)

    def list(self, stem: str, header: list[str], digest: Mapping[str, str]) -> list[str]:
        """The lines of the data list ``stem``; ``digest``: text constants by name."""
        out = [f"DEFDAT {stem} PUBLIC", *header]
        for word, value in digest.items():
            out += [f"DECL CHAR {word}[{len(value)}]", f'{word}[]="{value}"']
        return [*out, *self.lines.values(), "ENDDAT"]
