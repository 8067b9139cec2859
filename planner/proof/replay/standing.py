"""Intervals in which the tools stand while they work."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse
from planner.programs.stages import TaskText
from planner.proof.context import Context
from planner.proof.replay.moves import cubic, driven_knots
from planner.proof.replay.tool_speeds import SLOW, tool_speeds

_PIECES: Final = 8
"""Pieces of the way between two points at which its evenness is looked at."""
STANDS: Final = 1e-4
"""Below this speed [rad/s] of its fastest joint an arm stands on all of the way to a point."""
MAX_SAMPLES_AT_ONCE: Final = 16_384


def standing(context: Context) -> BoolArray:
    """Nodes (K,) at which, or on the way to which, arms that are driven by trajectories come so near to a
    standstill that it is one, though no velocity of the text is 0; of a block that one holds, as it sees the
    other one's tool."""
    motion = context.motion
    out = np.zeros(len(motion.node_stop), dtype=np.bool_)
    share = np.linspace(0.0, 1.0, _PIECES + 1)[:, None, None]
    for number, stage in enumerate(context.job.stages):
        tasks = [t for t in context.job.tasks if t.text.is_trajectory and stage.moves(t.name)]
        moves = [stage.moves(task.name) for task in tasks]
        if not tasks:
            continue
        here = motion.node_stage == number
        nodes = np.flatnonzero(here & (motion.node_line[tasks[0].arm.name] > 0))
        span = np.array([move.time or 1.0 for move in moves[0]])[:, None]
        ends, rates = list[FloatArray](), list[FloatArray]()
        for task, own in zip(tasks, moves, strict=True):
            data, at = task.arm.data, np.searchsorted(motion.node, nodes[0])
            q, v = driven_knots(data, own, motion.q[task.arm.name][at])
            ends.append(q / data.velocity)
            rates.append(v / data.velocity)
        place, rate = np.concatenate(ends, axis=1), np.concatenate(rates, axis=1)
        fastest = np.concatenate([task.arm.data.velocity for task in tasks])
        mean = np.linalg.norm(np.diff(place, axis=0) / span, axis=1)
        slow = np.linalg.norm(rate[1:-1], axis=1) < SLOW * np.minimum(mean[:-1], mean[1:])
        way = cubic(place[:-1], place[1:], rate[:-1], rate[1:], span, share)
        least = np.linalg.norm(np.diff(way, axis=0), axis=2).min(axis=0) * _PIECES / span[:, 0]
        rests = np.abs(np.diff(place, axis=0) * fastest / span).max(axis=1) < STANDS
        out[nodes] = np.append(slow, False) | (least < SLOW * mean) | rests
    for speeds in tool_speeds(context).values():
        out[speeds.node] |= speeds.creeps
    return out


def work_nodes(
    context: Context, task: TaskText
) -> tuple[BoolArray, FloatArray, FloatArray, NDArray[np.object_]]:
    """Which nodes (K,) the arm passes in work, where its tool (K, 4, 4) is before each and there, and which
    arm (K,) holds the block, as seen from whose tool that is; "" in the world."""
    motion, arm = context.motion, task.arm.name
    count = len(motion.node_segment)
    work, holders = np.zeros(count, dtype=bool), np.full(count, "", dtype=object)
    for number, stage in enumerate(context.job.stages):
        moves = stage.moves(task.name)
        nodes = np.flatnonzero((motion.node_stage == number) & (motion.node_line[arm] > 0))
        for node, move in zip(nodes, moves, strict=False):
            work[node] = not move.by_joints
            holders[node] = "" if move.wobj.fixed else move.wobj.unit
    begins = np.flatnonzero(np.append(True, motion.node_stage[1:] != motion.node_stage[:-1]))
    ends = {name: motion.node_tcp[name] for name in motion.node_tcp}
    start = {}
    for name, after in ends.items():
        start[name] = np.empty((count, 4, 4))
        start[name][1:] = after[:-1]
        start[name][begins] = motion.tcp[name][np.searchsorted(motion.node, begins)]
    rows = np.arange(count)
    before = tool_in_holder_frame(context, arm, holders, rows, lambda name, some: start[name][some])
    after = tool_in_holder_frame(context, arm, holders, rows, lambda name, some: ends[name][some])
    return work, before, after, holders


def tool_in_holder_frame(
    context: Context,
    arm: str,
    holders: NDArray[np.object_],
    rows: IntArray,
    poses: Callable[[str, IntArray], FloatArray],
) -> FloatArray:
    """``poses`` (K, 4, 4) of an arm's tool at ``rows`` (K,) as seen from the tools of ``holders`` (K,)."""
    out = poses(arm, rows).copy()
    for holder in context.motion.tcp:
        some = np.flatnonzero(holders == holder)
        if len(some):
            out[some] = inverse(poses(holder, rows[some])) @ out[some]
    return out


def first_of_each_node(node: IntArray, rows: IntArray) -> IntArray:
    return np.asarray(rows[np.unique(node, return_index=True)[1]]) if len(rows) else rows
