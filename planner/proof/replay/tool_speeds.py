"""Speeds of trajectory-driven tools on the path to each target, at every instant."""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.kinematics.arm_model import RobotMachine, robot_machine
from planner.proof.replay.moves import hermite, trajectory_knots
from planner.proof.replay.trajectory_speed import (
    CubicEnds,
    RelativeTool,
    peak_speeds,
    tool_in_base,
    tool_in_holder,
)

STANDSTILL_M: Final = 0.1e-3
"""Distance [m] from point to point below which a tool stands still."""
STANDSTILL_FRACTION: Final = 0.1
"""Fraction of the mean speed of the adjacent moves below which a point or a piece of the path counts as a
standstill.
"""
MARKER_DISTANCE_M: Final = 0.3
"""Distance [m] from the TCP of the marker points by whose motion rotations of a tool are measured."""
SPEED_INTERVAL_S: Final = 1e-6
"""Time [s] over which the speed of the marker points is taken."""
_PIECES: Final = 8
"""Number of pieces into which the path between two points is divided."""
MIN_PATH_FRACTION: Final = 0.3
"""Fraction of the longest tool path above which a tool determines the speed of the work on a held block."""


@dataclasses.dataclass(frozen=True)
class ToolSpeeds:
    """Speeds of an arm's tool on its N moves.

    If another arm holds the block, all but ``world`` are relative to that arm's tool.

    Attributes:
        moves: The moves.
        node: Indices (N,) of the moves among the nodes of the motion.
        world: Upper bounds (N,) [m/s] of the speed in the world at every instant.
        peak: Upper bounds (N,) [m/s] of the relative speed at every instant.
        length: Distance (N,) [m] between the two ends of each move.
        mean: Mean speed (N,) [m/s] along this distance.
        back: Largest motion (N,) [m] against this direction in an eighth of the move's time, 0 if there is
            none.
        is_near_standstill: Whether the tool nearly stands still on the path or at its end (N,). It is False
            if no arm holds the block.
    """

    moves: tuple[MoveStep, ...]
    node: IntArray
    world: FloatArray
    peak: FloatArray
    length: FloatArray
    mean: FloatArray
    back: FloatArray
    is_near_standstill: BoolArray


@dataclasses.dataclass(frozen=True)
class _DrivenArm:
    """A trajectory-driven arm.

    Attributes:
        task: Its task.
        machine: Its kinematics.
        moves: Its N moves.
        node: Indices (N,) of the moves among the nodes of the motion.
        q: Joints (N + 1, J) before and after the moves.
        v: Joint velocities (N + 1, J) before and after the moves.
    """

    task: TaskText
    machine: RobotMachine
    moves: tuple[MoveStep, ...]
    node: IntArray
    q: FloatArray
    v: FloatArray

    def move_ends(self, rows: IntArray) -> CubicEnds:
        """Return joints and velocities at the two ends of the moves ``rows`` (M,)."""
        return self.q[rows], self.q[rows + 1], self.v[rows], self.v[rows + 1]

    def ends_at_nodes(self, nodes: IntArray) -> CubicEnds:
        """Return joints and velocities at the two ends of the paths to ``nodes`` (M,).

        Where the arm has no move, it stands still at the end of its previous move.
        """
        rows = np.searchsorted(self.node, nodes)
        is_move = np.append(self.node, -1)[rows] == nodes
        a, still = self.q[rows], np.zeros_like(self.q[rows])
        rows = np.where(is_move, rows, -1)
        b, start_velocity, end_velocity = self.q[rows + 1], self.v[rows], self.v[rows + 1]
        has_move = is_move[:, None]
        return (
            a,
            np.where(has_move, b, a),
            np.where(has_move, start_velocity, still),
            np.where(has_move, end_velocity, still),
        )


def tool_speeds(context: Context) -> Mapping[str, ToolSpeeds]:
    """Return the tool speeds of trajectory-driven arms, by the name of the arm, for rules on speed and feed.

    They are cached in the context.
    """
    key = "_tool_speeds"
    if key not in context.__dict__:
        arms = {
            task.arm.name: _driven_arm(context, task) for task in context.job.tasks if task.text.is_trajectory
        }
        context.__dict__[key] = {name: _arm_speeds(context, arm, arms) for name, arm in arms.items()}
    speeds: Mapping[str, ToolSpeeds] = context.__dict__[key]
    return speeds


def _driven_arm(context: Context, task: TaskText) -> _DrivenArm:
    """Return the moves of a task that is driven by trajectories, with joints and velocities at their ends."""
    moves = tuple(step for step in task.steps if isinstance(step, MoveStep))
    q, v = trajectory_knots(task.arm.data, moves, task.arm.home)
    node = np.flatnonzero(context.motion.node_line[task.arm.name] > 0)
    return _DrivenArm(task, robot_machine(task.arm.data), moves, node, q, v)


def _arm_speeds(context: Context, arm: _DrivenArm, arms: Mapping[str, _DrivenArm]) -> ToolSpeeds:
    """Return the tool speeds of one of the trajectory-driven ``arms``, which are given by name.

    They are computed in groups of moves with one tool, one holder of the block and one setup.
    """
    span = np.array([max(move.time or 0.0, 1e-9) for move in arm.moves])
    world, peak, length, back, mean_speeds, end_speeds = (np.zeros(len(span)) for _ in range(6))
    creeps = np.zeros(len(span), dtype=np.bool_)
    groups: dict[tuple[int, str, int], list[int]] = {}
    stages = context.spans.of_stage[context.motion.node_stage[arm.node]]
    for k, move in enumerate(arm.moves):
        holder = "" if move.wobj.fixed else move.wobj.unit
        groups.setdefault((id(move.tool), holder, int(stages[k])), []).append(k)
    for (_, holder, setup), rows in groups.items():
        tool, other = arm.moves[rows[0]].tool.pose, arms.get(holder)
        move_rows = np.array(rows)
        ends = arm.move_ends(move_rows)
        tool_motion = tool_in_base(arm.machine, tool)
        world[move_rows] = peak[move_rows] = peak_speeds(tool_motion, ends, span[move_rows])
        # Another arm holds the block: speeds relative to its tool, over the joints of both arms.
        if other is not None:
            bases = context.base_poses(setup)
            last = np.searchsorted(other.node, arm.node[move_rows[-1]], side="right") - 1
            grip = other.moves[int(last)].tool.pose if last >= 0 else other.task.arm.tool.tcp
            tool_motion = tool_in_holder(
                (arm.machine, tool, bases[arm.task.arm.name]), (other.machine, grip, bases[holder])
            )
            holder_ends = other.ends_at_nodes(arm.node[move_rows])
            # The holder's joints come first, from its last to its first (tool_in_holder).
            joint_ends = [
                np.concatenate([h[:, ::-1], e], axis=1) for h, e in zip(holder_ends, ends, strict=True)
            ]
            ends = (joint_ends[0], joint_ends[1], joint_ends[2], joint_ends[3])
            peak[move_rows] = peak_speeds(tool_motion, ends, span[move_rows])
            creeps[move_rows], mean_speeds[move_rows], end_speeds[move_rows] = _near_standstill(
                tool_motion, ends, span[move_rows]
            )
        length[move_rows], back[move_rows] = _length_and_backward(tool_motion, ends, span[move_rows])
    # A target that is passed without a stop is a standstill if the tool is slow there, compared with the
    # moves before and after it.
    passed = arm.v[1:].any(axis=1)
    adjacent_speed = np.minimum(mean_speeds, np.append(mean_speeds[1:], np.inf))
    creeps |= passed & (end_speeds < STANDSTILL_FRACTION * adjacent_speed)
    return ToolSpeeds(arm.moves, arm.node, world, peak, length, length / span, back, creeps)


def _pose_samples(tool: RelativeTool, ends: CubicEnds, span: FloatArray) -> FloatArray:
    """Return tool poses (M, S, 4, 4) at equal time steps on M cubics with durations ``span`` (M,) [s].

    S is ``_PIECES`` + 1, with both ends of the cubic.
    """
    fractions = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    a, b, va, vb = (values[:, None] for values in ends)
    return tool.poses(hermite(a, b, va, vb, span[:, None, None], fractions))


def _length_and_backward(
    tool: RelativeTool, ends: CubicEnds, span: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distance (M,) [m] between the ends of M cubics, and the largest backward motion (M,) [m].

    Backward is against the direction from end to end, in one of ``_PIECES`` equal time steps.
    """
    positions = _pose_samples(tool, ends, span)[..., :3, 3]
    chord = positions[:, -1] - positions[:, 0]
    length = np.linalg.norm(chord, axis=1)
    along = np.einsum("spi,si->sp", np.diff(positions, axis=1), chord) / np.maximum(length, 1e-9)[:, None]
    return length, np.maximum(0.0, -along.min(axis=1))


def _near_standstill(
    tool: RelativeTool, ends: CubicEnds, span: FloatArray
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Find the cubics on which a tool comes close to a standstill, by three marker points of it.

    Returns:
        Flags (M,) of these cubics, and the mean speed (M,) and the speed at the end (M,) of the marker points
        [m/s] on each cubic.
    """
    marks = _marker_positions(_pose_samples(tool, ends, span))
    mean = np.linalg.norm(marks[:, -1] - marks[:, 0], axis=1) / span
    min_speed = np.linalg.norm(np.diff(marks, axis=1), axis=2).min(axis=1) * _PIECES / span
    shift = _marker_positions(tool.poses(ends[1] + SPEED_INTERVAL_S * ends[3])) - _marker_positions(
        tool.poses(ends[1])
    )
    return min_speed < STANDSTILL_FRACTION * mean, mean, np.linalg.norm(shift, axis=1) / SPEED_INTERVAL_S


def _marker_positions(pose: FloatArray) -> FloatArray:
    """Return the positions (..., 9) [m] of the TCP of poses (..., 4, 4) and of points on two of its axes."""
    points = [
        pose[..., :3, 3] + distance * pose[..., :3, axis]
        for distance, axis in ((0.0, 0), (MARKER_DISTANCE_M, 0), (MARKER_DISTANCE_M, 1))
    ]
    return np.concatenate(points, axis=-1)


def peak_tool_speeds(context: Context) -> FloatArray:
    """Return upper bounds (K,) [m/s] of the speed of trajectory-driven tools on the path to each node.

    They are 0 where no tool is trajectory-driven.
    """
    out = np.zeros(len(context.motion.node_stop))
    for speeds in tool_speeds(context).values():
        out[speeds.node] = np.maximum(out[speeds.node], speeds.peak)
    return out
