"""The rule on tracks that go along while their arms work: by their law, within what they can.

The values are those of the text's targets, the tool's places those of its poses in its work objects; between
targets the track has the clock of the tool. The law's offset is the planner's to choose, so the proof asks
whether there is one for all targets. What the planner smooths it by is bounded by its kind alone: means over
the tool's way, of which each weighs what is farther off less.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.findings import Findings, percent
from planner.proof.kinematics.external_axes import SAME_VALUE, OuterAxis, outer_axes
from planner.proof.replay.motion import differences
from planner.proof.rule import Outcome, at_node, at_sample, mm, rule

_CODE = "verify.track_along"
"""Code of the rule."""
MEAN_OVER = 0.1
"""A value may be the mean of those on so much [m] of the tool's way before and behind, which weigh the less
the farther off they are."""
LEAST_SPEED = 1e-9
"""Speeds [m/s] of a track that are 0 count as this one."""
NOISE = 6e-3
"""Values [m] that differ by no more fit one law: tools may slide a little where poses leave them free."""


@rule("verify.track_along")
def track_along(context: Context) -> Outcome:
    """A track that goes along has at each target the value that its law has for where the tool is, with one
    offset for all of an operation, and keeps its range, speed and acceleration everywhere; in KRL it goes no
    faster than the share of its speed that is in force lets it."""
    findings = Findings(_CODE, context, worst=0.0)
    for index, riding in enumerate(context.riding):
        for task in context.job.tasks:
            how = riding.get(task.arm.name)
            axis = next((one for one in outer_axes(task.arm, None) if one.follow is not None), None)
            if how is None or axis is None:
                continue
            rows = np.flatnonzero(context.sample_setup == index)
            if not len(rows):
                continue
            astray = list(_off_law(context, index, task, axis, how.axis))
            findings.issues += astray or _beyond(context, axis, task.arm.name, rows, how.station)
            for word, value, limits in _shares(context, task, axis, rows):
                share = value / limits
                k = int(np.argmax(share))
                limit = float(limits[k])
                findings.highest(share[k], f"{word} of {axis.unit}")
                if share[k] > 1.0 + SAME_VALUE and not astray:  # which asks for more than it can besides
                    unit = {"speed": "mm/s", "acceleration": "mm/s^2"}[word]
                    what = f"{axis.unit} would need the {word} {mm(value[k]):.1f} {unit} as it goes along; "
                    what += f"allowed: {mm(limit):g}"
                    what += ", by its $VEL_EXTAX" if limit < axis.speed and word == "speed" else ""
                    findings.at_sample(what, task.arm.name, rows[k], (mm(value[k]), mm(limit), unit))
    found = findings.outcome(percent, "% of the limit", 1.0)
    return dataclasses.replace(found, nothing="" if found.where else "no track goes along")


def _shares(
    context: Context, task: TaskText, axis: OuterAxis, rows: IntArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Speed and acceleration of a track at samples ``rows`` (K,) of a setup: word, sizes (K,), limits
    (K,)."""
    motion = context.motion
    time, gone = motion.time[rows], motion.ridden[task.arm.name][rows]
    speed = _let(context, task, axis)[motion.node[rows]]
    for order, (word, limit) in enumerate(
        (("speed", speed), ("acceleration", np.full(len(rows), axis.acceleration))), start=1
    ):
        yield word, np.abs(differences(time, gone, order)), limit


def _let(context: Context, task: TaskText, axis: OuterAxis) -> FloatArray:
    """Speeds [m/s] that a text lets a track have on the way to each node (N,): its own, and in KRL no more
    than the share of it that is in force."""
    motion = context.motion
    out = np.full(len(motion.node_stage), axis.speed)
    for rows, moves in _nodes(context, task):
        free = [move.by_joints or move.speed.outer is None for move in moves]
        told = [axis.speed if own else axis.told(move) for own, move in zip(free, moves, strict=True)]
        out[rows[: len(told)]] = np.clip(told[: len(rows)], LEAST_SPEED, axis.speed)
    return out


def _beyond(context: Context, axis: OuterAxis, arm: str, rows: IntArray, station: float) -> Iterator[Issue]:
    """Samples at which a track would be out of its range, the worst one."""
    value = station + context.motion.ridden[arm][rows]
    off = np.maximum(axis.low - value, value - axis.high)
    k = int(np.argmax(off))
    if off[k] > SAME_VALUE:
        span = f"{axis.shown(axis.low)} to {axis.shown(axis.high)}"
        what = f"{axis.unit} is at {axis.shown(float(value[k]))} as it goes along; its range is {span}"
        yield at_sample(_CODE, what, context.motion, arm, int(rows[k]))


def _off_law(
    context: Context, index: int, task: TaskText, axis: OuterAxis, direction: FloatArray
) -> Iterator[Issue]:
    """Targets of straight moves at which a track is not where its law has it: no offset c is there with which
    clip(k p.d + c) is within what a mean may leave it by at all of them."""
    nodes, value = _straight(context, index, task, axis)
    if not len(nodes):
        return
    share, arm = axis.follow or 0.0, task.arm.name
    place = context.motion.node_tcp[arm][nodes][:, :3, 3] @ direction
    # of means with weights that fall evenly to 0 at W, no one is off a slope of k by more than k W / 3
    room = share * MEAN_OVER / 3.0 + NOISE
    rest = value - share * place
    high, low = value >= axis.high - room, value <= axis.low + room
    least = np.where(low, -np.inf, rest - room)
    most = np.where(high, np.inf, rest + room)
    if least.max() <= most.min():
        return
    inner = ~(high | low)
    offset = float(np.median(rest[inner] if inner.any() else rest))
    wanted = np.clip(share * place + offset, axis.low, axis.high)
    off = np.abs(value - wanted)
    k = int(np.argmax(off))
    stands = float(np.ptp(value)) <= SAME_VALUE
    what = (
        f"{axis.unit} {'stands' if stands else 'is'} at {axis.shown(float(value[k]))}, where it is to be at "
    )
    what += f"{axis.shown(round(float(wanted[k]), 4))} as it goes along by {share:g} of the tool's way"
    yield at_node(_CODE, what, context.motion, arm, int(nodes[k]))


def _straight(context: Context, index: int, task: TaskText, axis: OuterAxis) -> tuple[IntArray, FloatArray]:
    """Nodes (K,) of setup ``index`` that a task reaches by straight moves, and the values (K,) [m] that its
    targets have there."""
    nodes: list[int] = []
    values: list[float] = []
    for rows, moves in _nodes(context, task, index):
        for row, move in zip(rows.tolist(), moves, strict=False):
            if not move.by_joints:
                nodes.append(row)
                values.append(axis.scale * float(move.target.external[axis.column]))
    return np.array(nodes, dtype=np.int64), np.array(values)


def _nodes(
    context: Context, task: TaskText, index: int | None = None
) -> Iterator[tuple[IntArray, tuple[MoveStep, ...]]]:
    """Nodes (K,) of each stage and the moves of a task that reach them, of setup ``index`` or of all."""
    motion = context.motion
    for number, stage in enumerate(context.job.stages):
        if index is None or int(context.spans.of_stage[number]) == index:
            rows = (motion.node_stage == number) & (motion.node_line[task.arm.name] > 0)
            yield np.flatnonzero(rows), stage.moves(task.name)
