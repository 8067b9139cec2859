"""Intervals in which the tools stand still while they work."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse
from planner.programs.stages import TaskText
from planner.proof.context import Context
from planner.proof.replay.moves import hermite, trajectory_knots
from planner.proof.replay.tool_speeds import STANDSTILL_FRACTION, tool_speeds

_PIECES: Final = 8
"""Number of pieces into which the path between two points is divided to find the slowest one."""
STANDSTILL_RAD_S: Final = 1e-4
"""Speed [rad/s] of the fastest joint below which arms stand still on the whole path to a point."""
SAMPLES_PER_BATCH: Final = 16_384
"""Number of samples per batch."""


def standstill_nodes(context: Context) -> BoolArray:
    """Return flags (K,) of nodes at which, or on the way to which, trajectory-driven arms nearly stop.

    This counts as a standstill, although no velocity in the text is 0. It is the case if

    - all joints together are slow at the node, compared with the mean speeds of the moves before and after;
    - they are slow in one of 8 pieces of the path, compared with the mean speed of the path;
    - the fastest joint is below ``STANDSTILL_RAD_S`` on the whole path;
    - one arm holds the block, and the tool of the other one nearly stands still relative to it.
    """
    motion = context.motion
    out = np.zeros(len(motion.node_stop), dtype=np.bool_)
    fractions = np.linspace(0.0, 1.0, _PIECES + 1)[:, None, None]
    for number, stage in enumerate(context.job.stages):
        tasks = [task for task in context.job.tasks if task.text.is_trajectory and stage.moves(task.name)]
        moves = [stage.moves(task.name) for task in tasks]
        if not tasks:
            continue
        in_stage = motion.node_stage == number
        nodes = np.flatnonzero(in_stage & (motion.node_line[tasks[0].arm.name] > 0))
        span = np.array([move.time or 1.0 for move in moves[0]])[:, None]
        ends, rates = list[FloatArray](), list[FloatArray]()
        for task, task_moves in zip(tasks, moves, strict=True):
            # Joints are relative to their maximum speeds, so that those of all arms are comparable.
            data, start_sample = task.arm.data, np.searchsorted(motion.node, nodes[0])
            q, v = trajectory_knots(data, task_moves, motion.q[task.arm.name][start_sample])
            ends.append(q / data.velocity)
            rates.append(v / data.velocity)
        positions, rate = np.concatenate(ends, axis=1), np.concatenate(rates, axis=1)
        max_speeds = np.concatenate([task.arm.data.velocity for task in tasks])
        mean_speed = np.linalg.norm(np.diff(positions, axis=0) / span, axis=1)
        slow_ends = np.linalg.norm(rate[1:-1], axis=1) < STANDSTILL_FRACTION * np.minimum(
            mean_speed[:-1], mean_speed[1:]
        )
        path = hermite(positions[:-1], positions[1:], rate[:-1], rate[1:], span, fractions)
        min_speed = np.linalg.norm(np.diff(path, axis=0), axis=2).min(axis=0) * _PIECES / span[:, 0]
        stationary = np.abs(np.diff(positions, axis=0) * max_speeds / span).max(axis=1) < STANDSTILL_RAD_S
        out[nodes] = np.append(slow_ends, False) | (min_speed < STANDSTILL_FRACTION * mean_speed) | stationary
    for speeds in tool_speeds(context).values():
        out[speeds.node] |= speeds.is_near_standstill
    return out


def work_nodes(
    context: Context, task: TaskText
) -> tuple[BoolArray, FloatArray, FloatArray, NDArray[np.object_]]:
    """Return the nodes of an arm's straight moves, in which it works, with the tool poses.

    Returns:
        Flags (K,) of the nodes in work, the tool poses (K, 4, 4) before each move, those after it, and the
        name (K,) of the arm that holds the block. The poses are relative to the tool of this arm, or in the
        world if the name is "".
    """
    motion, arm = context.motion, task.arm.name
    count = len(motion.node_segment)
    is_work, holders = np.zeros(count, dtype=bool), np.full(count, "", dtype=object)
    for number, stage in enumerate(context.job.stages):
        moves = stage.moves(task.name)
        nodes = np.flatnonzero((motion.node_stage == number) & (motion.node_line[arm] > 0))
        for node, move in zip(nodes, moves, strict=False):
            is_work[node] = not move.by_joints
            holders[node] = "" if move.wobj.fixed else move.wobj.unit
    # first_nodes: first node of each stage. Before it the pose is that at its first sample.
    first_nodes = np.flatnonzero(np.append(True, motion.node_stage[1:] != motion.node_stage[:-1]))
    ends = {name: motion.node_tcp[name] for name in motion.node_tcp}
    start = {}
    for name, end_poses in ends.items():
        start[name] = np.empty((count, 4, 4))
        start[name][1:] = end_poses[:-1]
        start[name][first_nodes] = motion.tcp[name][np.searchsorted(motion.node, first_nodes)]
    rows = np.arange(count)
    start_poses = tool_in_holder_frame(
        context, arm, holders, rows, lambda name, held_rows: start[name][held_rows]
    )
    end_poses = tool_in_holder_frame(
        context, arm, holders, rows, lambda name, held_rows: ends[name][held_rows]
    )
    return is_work, start_poses, end_poses, holders


def tool_in_holder_frame(
    context: Context,
    arm: str,
    holders: NDArray[np.object_],
    rows: IntArray,
    poses: Callable[[str, IntArray], FloatArray],
) -> FloatArray:
    """Return poses (K, 4, 4) of an arm's tool relative to the tools of the arms that hold the block.

    Args:
        context: The proof.
        arm: Name of the arm with the tool.
        holders: Names (K,) of the arms that hold the block. With "" the pose stays in the world.
        rows: Indices (K,), of nodes or of samples, at which the poses are returned.
        poses: Function for the tool poses of an arm in the world, by its name and such indices.
    """
    out = poses(arm, rows).copy()
    for holder in context.motion.tcp:
        held_rows = np.flatnonzero(holders == holder)
        if len(held_rows):
            out[held_rows] = inverse(poses(holder, rows[held_rows])) @ out[held_rows]
    return out


def first_sample_of_each_node(node: IntArray, rows: IntArray) -> IntArray:
    """Return for each node the first of the samples ``rows`` (M,) that belong to it.

    ``node`` (M,) is the node of each of these samples.
    """
    return np.asarray(rows[np.unique(node, return_index=True)[1]]) if len(rows) else rows
