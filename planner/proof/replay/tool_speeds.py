"""How fast tools that trajectories drive are on the way to each target, at every instant."""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.kinematics.arm_model import Machine, machine_of
from planner.proof.replay.driven_speed import Ends, Seen, from_holder, in_world, peak_speeds
from planner.proof.replay.moves import cubic, driven_knots

STANDS: Final = 0.1e-3
"""A tool that goes less than this [m] from point to point stands."""
SLOW: Final = 0.1
"""Below this share of the mean speeds beside it a point stands still, as a piece of the way between points
does."""
MARK: Final = 0.3
"""How far [m] from the TCP points are that tell how a tool stands."""
SOON: Final = 1e-6
"""Time [s] over which the speed of such points is taken."""
_PIECES: Final = 8
"""Pieces of the way between two points that are looked at."""
LEAST_PART: Final = 0.3
"""Of several tools those tell how fast what they hold goes that go this part of the longest way at least."""


@dataclasses.dataclass(frozen=True)
class ToolSpeeds:
    """Of an arm's N moves: ``world`` (N,) [m/s] that its tool keeps within at every instant, and ``peak``
    (N,) as seen from the arm that holds the block, where one does. As seen so: ``length`` (N,) [m] straight
    from where it is before, ``mean`` (N,) [m/s] of that, how far it goes ``back`` (N,) [m] on it in an eighth
    of the time, and, where one holds the block, whether it ``creeps`` (N,), as good as still, on the way or
    at its end. ``node`` (N,): the motion's nodes."""

    moves: tuple[MoveStep, ...]
    node: IntArray
    world: FloatArray
    peak: FloatArray
    length: FloatArray
    mean: FloatArray
    back: FloatArray
    creeps: BoolArray


@dataclasses.dataclass(frozen=True)
class _Arm:
    """An arm that is driven: joints ``q`` and velocities ``v`` (N + 1, J) between its moves, and their
    nodes."""

    task: TaskText
    machine: Machine
    moves: tuple[MoveStep, ...]
    node: IntArray
    q: FloatArray
    v: FloatArray

    def ends(self, rows: IntArray) -> Ends:
        """Joints and velocities at the two ends of the moves ``rows`` (M,)."""
        return self.q[rows], self.q[rows + 1], self.v[rows], self.v[rows + 1]

    def at(self, nodes: IntArray) -> Ends:
        """The same on the way to ``nodes`` (M,): where the arm has no move it stands where the one before has
        left it."""
        rows = np.searchsorted(self.node, nodes)
        moves = np.append(self.node, -1)[rows] == nodes
        a, still = self.q[rows], np.zeros_like(self.q[rows])
        rows = np.where(moves, rows, -1)
        b, before, behind = self.q[rows + 1], self.v[rows], self.v[rows + 1]
        own = moves[:, None]
        return a, np.where(own, b, a), np.where(own, before, still), np.where(own, behind, still)


def tool_speeds(context: Context) -> Mapping[str, ToolSpeeds]:
    """By arm, of those that trajectories drive."""
    key = "_tool_speeds"
    if key not in context.__dict__:
        arms = {task.arm.name: _arm(context, task) for task in context.job.tasks if task.text.is_trajectory}
        context.__dict__[key] = {name: _speeds(context, arm, arms) for name, arm in arms.items()}
    found: Mapping[str, ToolSpeeds] = context.__dict__[key]
    return found


def _arm(context: Context, task: TaskText) -> _Arm:
    moves = tuple(step for step in task.steps if isinstance(step, MoveStep))
    q, v = driven_knots(task.arm.data, moves, task.arm.home)
    node = np.flatnonzero(context.motion.node_line[task.arm.name] > 0)
    return _Arm(task, machine_of(task.arm.data), moves, node, q, v)


def _speeds(context: Context, arm: _Arm, arms: Mapping[str, _Arm]) -> ToolSpeeds:
    span = np.array([max(move.time or 0.0, 1e-9) for move in arm.moves])
    world, peak, length, back, going, rate = (np.zeros(len(span)) for _ in range(6))
    creeps = np.zeros(len(span), dtype=np.bool_)
    groups: dict[tuple[int, str, int], list[int]] = {}
    stages = context.spans.of_stage[context.motion.node_stage[arm.node]]
    for k, move in enumerate(arm.moves):
        holder = "" if move.wobj.fixed else move.wobj.unit
        groups.setdefault((id(move.tool), holder, int(stages[k])), []).append(k)
    for (_, holder, setup), rows in groups.items():
        tool, other = arm.moves[rows[0]].tool.pose, arms.get(holder)
        some = np.array(rows)
        ends = arm.ends(some)
        seen = in_world(arm.machine, tool)
        world[some] = peak[some] = peak_speeds(seen, ends, span[some])
        if other is not None:
            bases = context.based(setup)
            last = np.searchsorted(other.node, arm.node[some[-1]], side="right") - 1
            grip = other.moves[int(last)].tool.pose if last >= 0 else other.task.arm.tool.tcp
            seen = from_holder(
                (arm.machine, tool, bases[arm.task.arm.name]), (other.machine, grip, bases[holder])
            )
            held = other.at(arm.node[some])
            both = [np.concatenate([h[:, ::-1], e], axis=1) for h, e in zip(held, ends, strict=True)]
            ends = (both[0], both[1], both[2], both[3])
            peak[some] = peak_speeds(seen, ends, span[some])
            creeps[some], going[some], rate[some] = _slow(seen, ends, span[some])
        length[some], back[some] = _straight(seen, ends, span[some])
    passed = arm.v[1:].any(axis=1)
    beside = np.minimum(going, np.append(going[1:], np.inf))
    creeps |= passed & (rate < SLOW * beside)
    return ToolSpeeds(arm.moves, arm.node, world, peak, length, length / span, back, creeps)


def _looks(seen: Seen, ends: Ends, span: FloatArray) -> FloatArray:
    """Poses (M, S, 4, 4) at even times on cubics."""
    share = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    a, b, va, vb = (one[:, None] for one in ends)
    return seen.poses(cubic(a, b, va, vb, span[:, None, None], share))


def _straight(seen: Seen, ends: Ends, span: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far (M,) [m] it is from one end to the other, and how far it goes back on that way."""
    place = _looks(seen, ends, span)[..., :3, 3]
    way = place[:, -1] - place[:, 0]
    length = np.linalg.norm(way, axis=1)
    along = np.einsum("spi,si->sp", np.diff(place, axis=1), way) / np.maximum(length, 1e-9)[:, None]
    return length, np.maximum(0.0, -along.min(axis=1))


def _slow(seen: Seen, ends: Ends, span: FloatArray) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Cubics (M,) on which a tool comes near to a standstill, by three of its points, the mean speeds of
    these [m/s], and their speeds at the end."""
    marks = _marks(_looks(seen, ends, span))
    mean = np.linalg.norm(marks[:, -1] - marks[:, 0], axis=1) / span
    least = np.linalg.norm(np.diff(marks, axis=1), axis=2).min(axis=1) * _PIECES / span
    soon = _marks(seen.poses(ends[1] + SOON * ends[3])) - _marks(seen.poses(ends[1]))
    return least < SLOW * mean, mean, np.linalg.norm(soon, axis=1) / SOON


def _marks(pose: FloatArray) -> FloatArray:
    """Places (..., 9) [m] of the TCP of poses (..., 4, 4) and of points on two of its axes."""
    points = [pose[..., :3, 3] + far * pose[..., :3, axis] for far, axis in ((0.0, 0), (MARK, 0), (MARK, 1))]
    return np.concatenate(points, axis=-1)


def peaks(context: Context) -> FloatArray:
    """Speeds (K,) [m/s] that no driven tool exceeds on the way to each node; 0 where none is driven."""
    out = np.zeros(len(context.motion.node_stop))
    for own in tool_speeds(context).values():
        out[own.node] = np.maximum(out[own.node], own.peak)
    return out
