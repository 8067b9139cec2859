"""The data list of a KUKA arm's program: tools, loads, bases and targets, each under one name.

A KUKA controller takes one load, for the tool together with the block that it holds.

Status and turn select one of the arm's postures for a PTP to a pose. S bit 0 (1): the wrist centre is behind
axis 1. Bit 1 (2): axis 3 is on the positive side of the posture in which shoulder, elbow and wrist centre
are in line. Bit 2 (4): axis 5 is negative. T bit i - 1: axis i is negative. Sources: KUKA's expert
programming manual as cited in a forum (bit 0); points taught on real robots (bits 1, 2).
"""

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import FloatArray, IntArray, from_parts, inverse
from planner.issues import issue_error
from planner.languages.krl.writer.syntax import (
    MAX_NAME_LENGTH,
    aggregate,
    e6axis,
    e6pos,
    frame,
    identifier,
    rounded_pose,
)
from planner.languages.writing.layout import HeldLoad, JointMove, OperationProgram, TaskProgram, format_fixed
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.tooling import Tool


def load_data(tool: Tool, held: HeldLoad | None) -> str:
    """Format a LOAD: mass [kg], centre in the flange frame [mm, deg], moments of inertia about its axes.

    A tool is a point mass, as the problem states it; ``held`` has its own axes and moments. The LOAD of
    both has the common centre of mass, with principal axes and moments by the parallel axis theorem.

    Args:
        tool: The tool.
        held: Load of the block that the tool holds, or None.

    Raises:
        TandemError: ``post.tool`` for a tool without mass.
    """
    require_mass(tool)
    mass, centre, axes, moments = tool.mass, np.asarray(tool.cog), np.eye(3), np.zeros(3)
    if held is not None:
        mass, centre, axes, moments = _combined_load(tool, held)
    pose = frame(from_parts(axes, centre), decimals=3)
    inertia = aggregate(dict(zip("XYZ", (format_fixed(v, 6) for v in moments), strict=True)))
    return aggregate({"M": format_fixed(mass, 3), "CM": pose, "J": inertia})


def _combined_load(tool: Tool, held: HeldLoad) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Return the load of the tool, as a point mass, together with the block, in the flange frame.

    Returns:
        Mass [kg], centre (3,) [m], principal axes (3, 3) and principal moments (3,) [kg m^2] of inertia.
    """
    held_axes = tool.tcp[:3, :3] @ held.axes
    held_centre = tool.tcp[:3, :3] @ held.cog + tool.tcp[:3, 3]
    mass = tool.mass + held.mass
    centre = (tool.mass * tool.cog + held.mass * held_centre) / mass
    tensor = held_axes @ np.diag(held.inertia) @ held_axes.T
    for weight, point in ((tool.mass, tool.cog), (held.mass, held_centre)):
        lever = point - centre
        tensor = tensor + weight * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))  # makes the axes right-handed
    return mass, centre, axes, moments


DEGREE_DECIMALS: Final = 4
"""Decimals to which joints in degrees are rounded, so that numerical noise near 0 does not decide a bit."""
TURN_BIT_TOLERANCE_RAD: Final = np.deg2rad(2.0)
"""Joint angle [rad] up to which a controller may ignore the turn bit of an axis."""


def status(robot: RobotData, q: FloatArray) -> IntArray:
    """Return the Status S (...,) of joints. Together with the Turn it selects a posture for a PTP to a pose.

    Bit 0 (1): the wrist centre is behind axis 1. Bit 1 (2): axis 3 is on the positive side of the posture in
    which shoulder, elbow and wrist centre are in line. Bit 2 (4): axis 5 is negative.

    Args:
        robot: The robot.
        q: Serial joint angles, (..., 6) [rad].
    """
    rounded = _rounded(robot, q)
    p = robot.opw
    theta = p.signs * robot.from_controller(rounded) - p.offsets
    upper, elbow = theta[..., 1], theta[..., 2]
    # wrist centre across and along the upper arm, then horizontally ahead of axis 1
    wrist_across = p.a2 * np.cos(elbow) + p.c3 * np.sin(elbow)
    wrist_along = p.c2 + p.c3 * np.cos(elbow) - p.a2 * np.sin(elbow)
    wrist_ahead = p.a1 + wrist_along * np.sin(upper) + wrist_across * np.cos(upper)
    return np.asarray(
        (wrist_ahead < 0.0) + 2 * (wrist_across >= 0.0) + 4 * (rounded[..., 4] < 0.0), dtype=np.int64
    )


def turn(robot: RobotData, q: FloatArray) -> IntArray:
    """Return the Turn T (...,) of joints: bit i - 1 is set if axis i is negative.

    Args:
        robot: The robot.
        q: Serial joint angles, (..., 6) [rad].
    """
    return np.asarray((_rounded(robot, q) < 0.0) @ (1 << np.arange(6)), dtype=np.int64)


def axes_near_zero(robot: RobotData, q: FloatArray) -> IntArray:
    """Return the axes, from 1, whose turn bit a controller may ignore.

    Args:
        robot: The robot.
        q: Serial joint angles, (6,) [rad].
    """
    return np.flatnonzero(np.abs(robot.to_controller(q)) <= TURN_BIT_TOLERANCE_RAD) + 1


def _rounded(robot: RobotData, q: FloatArray) -> FloatArray:
    """Return the controller's joint values (..., 6) [rad], rounded to ``DEGREE_DECIMALS`` in degrees."""
    return np.deg2rad(np.round(np.rad2deg(robot.to_controller(q)), DEGREE_DECIMALS))


_STEM_LENGTH = MAX_NAME_LENGTH - 3
"""Maximum length of a tool's name, without the number that tells equal names apart."""


class TaskDeclarations:
    """Names and declarations of one task; equal values have one name.

    Attributes:
        task: The task.
        plan: The plan that is written.
        lines: Declarations by name.
        tools: Names of tools without their prefix, by tool name and text of frame and load.
        joints: Names of joint positions, by text of the position.
        loads: Names of loads.
    """

    def __init__(self, task: TaskProgram, plan: Plan) -> None:
        self.task, self.plan = task, plan
        self.lines: dict[str, str] = {}
        self.tools: dict[tuple[str, str], str] = {}
        self.joints: dict[str, str] = {}
        self.loads: dict[tuple[str, str], str] = {}
        self.declare("FRAME", "base_frame", frame(task.base))
        self.joint(JointMove(task.arm.home, "home", axis_setpoint=task.home_setpoint), 0)

    def declare(self, kind: str, name: str, value: str) -> str:
        """Declare a name, unless it is declared already with the same value, and return it.

        Args:
            kind: KRL type.
            name: The name.
            value: The aggregate as text.

        Raises:
            TandemError: ``post.name`` if the name has another value already.
        """
        line = f"DECL {kind} {name}={value}"
        if self.lines.setdefault(name, line) != line:
            message = f"arm {self.task.arm.name} would use the name {name} twice"
            raise issue_error("post.name", message, hint="give the tool another name")
        return name

    def tool(self, tool: Tool) -> str:
        """Return the name of a tool's frame, after declaring its frame and its load at first use."""
        key = (tool.name, frame(tool.tcp) + load_data(tool, None))
        if key not in self.tools:
            stem = identifier(f"t_{tool.name}", _STEM_LENGTH)[2:]
            names = itertools.chain([stem], (f"{stem}_{n}" for n in itertools.count(2)))
            unique_name = next(candidate for candidate in names if candidate not in self.tools.values())
            self.tools[key] = unique_name
            self.declare("FRAME", f"t_{unique_name}", frame(tool.tcp))
            self.declare("LOAD", f"l_{unique_name}", load_data(tool, None))
        return f"t_{self.tools[key]}"

    def load(self, tool: Tool, held: HeldLoad | None) -> str:
        """Return the name of the load of a tool together with what it holds, after declaring it at first use.

        Args:
            tool: The tool.
            held: Load of the block that it holds, or None.
        """
        if held is None:
            return f"l_{self.tool(tool)[2:]}"
        return self.declare("LOAD", f"l_block_{held.setup}", load_data(tool, held))

    def base(self, operation: OperationProgram) -> str:
        """Return the name of the base of an operation's moves: the world if the operation has no moves."""
        pose, word = self.base_pose(operation)
        return self.declare("FRAME", word, frame(pose))

    def base_pose(self, operation: OperationProgram) -> tuple[FloatArray, str]:
        """Return the base of an operation's moves in the robot's foot frame, (4, 4) [m], and its name.

        Raises:
            TandemError: ``post.frame`` if the moves are in a frame other than world and stock.
        """
        kind = "world" if operation.moves is None else operation.moves.frame
        foot = inverse(self.task.base)
        if kind == "world":
            return foot, "b_world"
        if kind == "stock":
            stock_pose = self.plan.stock_poses[operation.setup - 1]
            return foot @ stock_pose, "b_stock" if operation.setup == 1 else f"b_stock_{operation.setup}"
        message = f"targets of {self.task.arm.name} are in {kind!r}, for which KRL has no base"
        raise issue_error("post.frame", message, hint="allowed: stock, world")

    def joint(self, step: JointMove, operation: int) -> str:
        """Return the name of the target of a joint move, after declaring it at first use.

        Equal targets share the name of the first one: ``x_home``, or ``x_2_entry_1`` for the first target
        with the role entry in operation 2.

        Args:
            step: The joint move.
            operation: Number of its operation, from 1.
        """
        text = e6axis(np.rad2deg(self.task.robot.to_controller(step.q)), step.axis_setpoint)
        if text not in self.joints:
            stem = "x_home" if step.role == "home" else f"x_{operation}_{step.role}"
            count = sum(name.startswith(stem) for name in self.joints.values())
            name = stem if step.role == "home" else f"{stem}_{count + 1}"
            self.joints[text] = self.declare("E6AXIS", name, text)
        return self.joints[text]

    def start(self, operation: OperationProgram, q: FloatArray, number: int) -> str:
        """Declare the first target of an operation and return its name: pose in the base, status and turn.

        Args:
            operation: The operation.
            q: Serial joint angles there, (6,) [rad].
            number: Number of the operation, from 1.
        """
        position, angles = self.start_pose(operation, q)
        robot = self.task.robot
        axes = operation.axis_setpoint
        value = e6pos(position, angles, int(status(robot, q)), int(turn(robot, q)), axes)
        return self.declare("E6POS", f"p_{number}_start", value)

    def start_pose(self, operation: OperationProgram, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [mm] and A, B, C (3,) [deg] of the TCP in the operation's base, as written.

        Args:
            operation: The operation.
            q: Serial joint angles, (6,) [rad].
        """
        flange = forward_kinematics(self.task.robot, q)
        if operation.arm.linear_axes:  # the base is relative to the foot at axis values 0
            flange = inverse(self.task.base) @ operation.arm.base @ flange
        return rounded_pose(inverse(self.base_pose(operation)[0]) @ flange @ operation.arm.tool.tcp)

    def data_list(self, stem: str, header: list[str], digest: Mapping[str, str]) -> list[str]:
        """Return the lines of the data list.

        Args:
            stem: Name of the data list.
            header: Comment lines.
            digest: Texts by name, such as the digest of the problem.
        """
        out = [f"DEFDAT {stem} PUBLIC", *header]
        for word, value in digest.items():
            out += [f"DECL CHAR {word}[{len(value)}]", f'{word}[]="{value}"']
        return [*out, *self.lines.values(), "ENDDAT"]
