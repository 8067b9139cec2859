"""verify.track_along: coordinated tracks follow their motion law, within their limits.

The track values are those of the text's targets. The tool positions are those of its poses in its work
objects. Between targets the track runs on the clock of the tool. The planner may choose the offset of the
law, so the proof checks that one offset fits all targets. The planner may also smooth the values by weighted
means over the tool path, with weights that decrease with the distance. The tolerance of the law allows for
any such mean.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import Issue
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.findings import Findings, to_percent
from planner.proof.kinematics.external_axes import AXIS_VALUE_TOLERANCE, TaskAxis, task_axes
from planner.proof.replay.motion import finite_differences
from planner.proof.rule import RuleOutcome, mm, node_issue, rule, sample_issue

_CODE = "verify.track_along"
"""Code of the rule."""
MEAN_HALF_WIDTH_M = 0.1
"""Half width W [m] of the weighted mean: a track value may be the mean of the values up to W before and after
it on the tool path, with weights that decrease with the distance.
"""
MIN_TRACK_SPEED_M_S = 1e-9
"""Limit [m/s] that replaces 0 where a speed is divided by its limit."""
LAW_TOLERANCE_M = 6e-3
"""Tolerance [m] of the law, because a tool may slide a little along free directions of its target."""


@rule("verify.track_along")
def coordinated_track(context: Context) -> RuleOutcome:
    """A coordinated track has at each target the value of its motion law for the tool position.
    One offset holds for a whole operation. The track keeps its range, speed and acceleration everywhere.
    In KRL it is no faster than the speed fraction in force allows.
    """
    findings = Findings(_CODE, context, worst=0.0)
    for index, tracks in enumerate(context.coordinated_tracks):
        for task in context.job.tasks:
            track = tracks.get(task.arm.name)
            axis = next(
                (
                    candidate
                    for candidate in task_axes(task.arm, None)
                    if candidate.follow_fraction is not None
                ),
                None,
            )
            if track is None or axis is None:
                continue
            rows = np.flatnonzero(context.sample_setup == index)
            if not len(rows):
                continue
            law_issues = list(_law_issues(context, index, task, axis, track.axis))
            findings.issues += law_issues or _range_issues(context, axis, task.arm.name, rows, track.station)
            for word, value, limits in _speed_and_acceleration(context, task, axis, rows):
                ratio = value / limits
                k = int(np.argmax(ratio))
                limit = float(limits[k])
                findings.note_highest(ratio[k], f"{word} of {axis.label}")
                if (
                    ratio[k] > 1.0 + AXIS_VALUE_TOLERANCE and not law_issues
                ):  # off its law it would exceed limits anyway
                    unit = {"speed": "mm/s", "acceleration": "mm/s^2"}[word]
                    message = f"{axis.label} would need the {word} {mm(value[k]):.1f} {unit} with the tool; "
                    message += f"allowed: {mm(limit):g}"
                    message += ", by its $VEL_EXTAX" if limit < axis.speed and word == "speed" else ""
                    findings.add_at_sample(message, task.arm.name, rows[k], (mm(value[k]), mm(limit), unit))
    outcome = findings.outcome(to_percent, "% of the limit", 1.0)
    return dataclasses.replace(outcome, nothing="" if outcome.where else "no coordinated track")


def _speed_and_acceleration(
    context: Context, task: TaskText, axis: TaskAxis, rows: IntArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield first the speed and then the acceleration of a track at samples ``rows`` (K,) of a setup.

    Each item has the word ``speed`` or ``acceleration``, the absolute values (K,) and the limits (K,), in
    [m/s] or [m/s^2].
    """
    motion = context.motion
    time, positions = motion.time[rows], motion.track_positions[task.arm.name][rows]
    speed = _allowed_speeds(context, task, axis)[motion.node[rows]]
    for order, (word, limit) in enumerate(
        (("speed", speed), ("acceleration", np.full(len(rows), axis.acceleration))), start=1
    ):
        yield word, np.abs(finite_differences(time, positions, order)), limit


def _allowed_speeds(context: Context, task: TaskText, axis: TaskAxis) -> FloatArray:
    """Return the maximum speed (N,) [m/s] that the text allows a track on the path to each of N nodes.

    It is the maximum speed of the track. In straight moves of KRL it is multiplied by the speed fraction in
    force ($VEL_EXTAX). It is at least ``MIN_TRACK_SPEED_M_S``, because speeds are divided by it.
    """
    motion = context.motion
    out = np.full(len(motion.node_stage), axis.speed)
    for rows, moves in _stage_nodes(context, task):
        unrestricted = [move.by_joints or move.speed.external is None for move in moves]
        speeds = [
            axis.speed if is_free else axis.speed_in(move)
            for is_free, move in zip(unrestricted, moves, strict=True)
        ]
        out[rows[: len(speeds)]] = np.clip(speeds[: len(rows)], MIN_TRACK_SPEED_M_S, axis.speed)
    return out


def _range_issues(
    context: Context, axis: TaskAxis, arm: str, rows: IntArray, station: float
) -> Iterator[Issue]:
    """Yield one issue if a track is out of its range, at the worst of the samples ``rows`` (K,).

    ``station`` [m] is the track position from which ``track_positions`` of the motion are counted.
    """
    value = station + context.motion.track_positions[arm][rows]
    excess = np.maximum(axis.low - value, value - axis.high)
    k = int(np.argmax(excess))
    if excess[k] > AXIS_VALUE_TOLERANCE:
        span = f"{axis.format_value(axis.low)} to {axis.format_value(axis.high)}"
        message = (
            f"{axis.label} is at {axis.format_value(float(value[k]))} as it follows the tool; its range is "
            f"{span}"
        )
        yield sample_issue(_CODE, message, context.motion, arm, int(rows[k]))


def _law_issues(
    context: Context, index: int, task: TaskText, axis: TaskAxis, direction: FloatArray
) -> Iterator[Issue]:
    """Check the track values of straight moves in setup ``index`` against the motion law of the track.

    One offset c must exist for all targets with which each track value is within the tolerance of
    clip(k p.d + c, low, high). Here k is the fraction of the tool's path that the track follows, p the tool
    position in the world and d the ``direction`` (3,) of the track. If there is none, one issue is reported,
    at the target with the largest deviation from the law with the median offset.
    """
    nodes, value = _straight_values(context, index, task, axis)
    if not len(nodes):
        return
    fraction, arm = axis.follow_fraction or 0.0, task.arm.name
    along_track = context.motion.node_tcp[arm][nodes][:, :3, 3] @ direction
    # Weights that fall linearly to 0 at W have the mean distance W / 3. So a weighted mean of values with
    # slope k deviates from the value itself by at most k W / 3.
    tolerance = fraction * MEAN_HALF_WIDTH_M / 3.0 + LAW_TOLERANCE_M
    offsets = value - fraction * along_track
    # Each target bounds the offset from both sides. At an end of the range the clip leaves one side open.
    high, low = value >= axis.high - tolerance, value <= axis.low + tolerance
    min_offset = np.where(low, -np.inf, offsets - tolerance)
    max_offset = np.where(high, np.inf, offsets + tolerance)
    if min_offset.max() <= max_offset.min():
        return
    inner = ~(high | low)
    offset = float(np.median(offsets[inner] if inner.any() else offsets))
    expected = np.clip(fraction * along_track + offset, axis.low, axis.high)
    deviation = np.abs(value - expected)
    k = int(np.argmax(deviation))
    is_constant = float(np.ptp(value)) <= AXIS_VALUE_TOLERANCE
    message = (
        f"{axis.label} {'stays' if is_constant else 'is'} at {axis.format_value(float(value[k]))}; expected: "
    )
    message += (
        f"{axis.format_value(round(float(expected[k]), 4))} as it follows {fraction:g} of the tool's path"
    )
    yield node_issue(_CODE, message, context.motion, arm, int(nodes[k]))


def _straight_values(
    context: Context, index: int, task: TaskText, axis: TaskAxis
) -> tuple[IntArray, FloatArray]:
    """Return the end nodes (K,) of a task's straight moves in a setup, and their track values (K,) [m]."""
    nodes: list[int] = []
    values: list[float] = []
    for rows, moves in _stage_nodes(context, task, index):
        for row, move in zip(rows.tolist(), moves, strict=False):
            if not move.by_joints:
                nodes.append(row)
                values.append(axis.scale * float(move.target.external[axis.column]))
    return np.array(nodes, dtype=np.int64), np.array(values)


def _stage_nodes(
    context: Context, task: TaskText, index: int | None = None
) -> Iterator[tuple[IntArray, tuple[MoveStep, ...]]]:
    """Yield for each stage the nodes (K,) at which a task's moves end, and these K moves.

    ``index`` is that of the setup whose stages are returned, None for all stages.
    """
    motion = context.motion
    for number, stage in enumerate(context.job.stages):
        if index is None or int(context.spans.of_stage[number]) == index:
            rows = (motion.node_stage == number) & (motion.node_line[task.arm.name] > 0)
            yield np.flatnonzero(rows), stage.moves(task.name)
