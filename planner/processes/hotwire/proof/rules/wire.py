"""Rules on the shape, contact, speed and mounting of wires, and on their power.

The rules are verify.wire_length, wire_stability, curvature, contact, stop_in_foam, feed, wire_mount and
wire_power.
"""

import dataclasses

import numpy as np

from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.geometry.arrays import FloatArray, inverse
from planner.processes.hotwire.claims import WireJoins
from planner.processes.hotwire.proof.wire_motion import WIRES, WireMotion, end_distances, mounted_phases
from planner.programs.steps import MessageStep, SignalStep, WaitStep
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_mm, to_percent
from planner.proof.replay import standstill
from planner.proof.replay.motion import motion_across_wire
from planner.proof.replay.tool_speeds import MIN_PATH_FRACTION, STANDSTILL_M, tool_speeds
from planner.proof.rule import MAX_FEED_FACTOR, Measure, RuleOutcome, mm, rule
from planner.proof.rules.power import all_steps
from planner.proof.setups import JoinedPhase

MAX_END_RESIDUAL_M = 1e-6
"""A wire's shape meets both clamps if the position error of its end is at most this [m]."""
MAX_CHORD_FRACTION = 0.9999
"""Maximum distance of the ends as a fraction of the wire's length. Beyond it the wire is practically taut."""
MAX_PATH_RATIO = 2.0
"""Maximum ratio of the path round a corner to the straight path that the speed bounds assume."""
MELTING_DISTANCE_M = 1e-3
"""A stopped wire that is closer to foam than this [m] melts it."""


@rule("verify.wire_length", WireJoins)
def wire_length(context: Context) -> RuleOutcome:
    """The ends of the wire are never farther apart than it is long, and it can be mounted."""
    findings = Findings("verify.wire_length", context, worst=0.0)
    for wire in context.get(WIRES):
        claim = wire.claim
        if wire.fault:
            findings.add(f"the wire cannot be followed: {wire.fault}")
            continue
        if wire.path is None or wire.phase is None or not isinstance(claim, WireJoins):
            continue
        fraction = end_distances(context, wire.phase) / claim.length
        k = int(np.argmax(fraction))
        findings.note_highest(fraction[k])
        if fraction[k] >= MAX_CHORD_FRACTION:
            distance = fraction[k] * claim.length
            message = f"the ends are {mm(distance):.3f} mm apart; the wire is {mm(claim.length):.3f} mm long"
            findings.add(message, measure_in_mm(distance, claim.length), index=k)
        if wire.path.residual.max() > MAX_END_RESIDUAL_M:
            message = "no shape of the wire meets both clamps"
            at_wire(findings, wire, message, int(np.argmax(wire.path.residual)))
    claimed, mounted_count = len(context.claims_of(WireJoins)), len(mounted_phases(context))
    if mounted_count < claimed:
        findings.add(f"{claimed} bent wires are claimed; the programs move {mounted_count} together")
    if not context.phases:
        return findings.outcome_without_value("no bent wire")
    return findings.outcome(to_percent, "% of its length", MAX_CHORD_FRACTION)


@rule("verify.wire_stability", WireJoins)
def wire_stability(context: Context) -> RuleOutcome:
    """The wire's shape is stable all along and never snaps to another one."""
    findings = Findings("verify.wire_stability", context, worst=np.inf)
    bent = [(wire, wire.path) for wire in context.get(WIRES) if wire.path is not None]
    for wire, path in bent:
        findings.note_lowest(path.min_eigenvalue.min())
        for k in np.flatnonzero(path.has_jumped)[:50]:
            message = f"the wire snaps to another shape and moves by {mm(path.jump_distance[k]):.1f} mm"
            at_wire(findings, wire, message, k, measure_in_mm(path.jump_distance[k], 0.0))
        for k in np.flatnonzero(~path.is_stable)[:50]:
            at_wire(findings, wire, "the wire has no stable shape near the one it had", k)
    out = findings.outcome(float, "of the first mode", 0.0)
    worst = out.worst if findings.measured else None
    return dataclasses.replace(out, worst=worst, nothing="" if bent else "no bent wire")


@rule("verify.curvature", WireJoins)
def curvature(context: Context) -> RuleOutcome:
    """The wire is never bent beyond its elastic limit."""
    findings, limit = Findings("verify.curvature", context, worst=0.0), np.inf
    for wire in context.get(WIRES):
        claim = wire.claim
        if wire.path is None or not isinstance(claim, WireJoins):
            continue
        wire_curvature = np.linalg.norm(wire.path.curvature, axis=2).max(axis=1)
        limit = min(limit, claim.max_curvature)
        findings.note_highest(wire_curvature.max())
        for k in np.flatnonzero(wire_curvature > claim.max_curvature)[:200]:
            message = (
                f"the wire is bent to a radius of {mm(1 / wire_curvature[k]):.1f} mm; allowed: "
                f"{mm(1 / claim.max_curvature):.1f} mm"
            )
            at_wire(findings, wire, message, k, (float(wire_curvature[k]), claim.max_curvature, "1/m"))
    if not np.isfinite(limit):
        return RuleOutcome(nothing="no bent wire")
    return findings.outcome(float, "1/m", limit)


@rule("verify.contact", ContactOnlyIn)
def contact(context: Context) -> RuleOutcome:
    """The wire touches the stock only in segments that cut, each of them claimed by an operation of its
    setup.
    """
    findings = Findings("verify.contact", context)
    for wire in context.get(WIRES):
        not_cutting = ~wire.is_cutting
        if not len(not_cutting) or not not_cutting.any():
            continue
        findings.note_highest(wire.depth[not_cutting].max())
        for k in np.flatnonzero(not_cutting & (wire.depth > 0.0))[:200]:
            message = (
                f"the wire is {mm(wire.depth[k]):.2f} mm inside the block in segment {wire.labels[k]}; "
                f"setup {wire.setup + 1} cuts nothing there"
            )
            at_wire(findings, wire, message, k, measure_in_mm(wire.depth[k], 0.0))
    return findings.outcome(mm, "mm", 0.0, nothing="no wire")


@rule("verify.stop_in_foam")
def stop_in_foam(context: Context) -> RuleOutcome:
    """The wire never stops inside the block, or so close to it that it melts foam, nor does it almost stop
    where trajectories state velocities.
    """
    wires, findings = context.get(WIRES), Findings("verify.stop_in_foam", context)
    motion = context.motion
    is_stop = motion.node_stop | standstill.standstill_nodes(context)
    for wire in wires:
        stops = np.isin(wire.sample, motion.node_sample[is_stop])
        for k in np.flatnonzero(stops & (wire.depth > -MELTING_DISTANCE_M)):
            side = "inside" if wire.depth[k] > 0.0 else "from"
            message = f"the wire stops {mm(abs(wire.depth[k])):.2f} mm {side} the block"
            at_wire(findings, wire, message, k)
    return findings.outcome_without_value("" if wires else "no wire")


@rule("verify.feed", FeedWindow)
def feed(context: Context) -> RuleOutcome:
    """The fastest point of the wire inside the block moves within the feed window. On the cubics of
    trajectories the upper limit holds at every instant, by the ratio of the tools' peak speeds to their mean.
    """
    findings = Findings("verify.feed", context, worst=0.0)
    for wire in context.get(WIRES):
        speed = feed_speed(context, wire)
        fastest, slowest = _speed_bounds(context, wire, speed)
        for claim in context.feeds:
            if wire.setup != context.setup_of(claim):
                continue
            in_segment = wire.labels[1:] == claim.segment.key
            stations = np.flatnonzero(in_segment & np.isfinite(speed[1:])) + 1
            if not len(stations):
                continue
            ratio = np.maximum(
                fastest[stations] / claim.upper, claim.lower / np.maximum(slowest[stations], 1e-9)
            )
            findings.note_highest(ratio.max(), claim.segment, MAX_FEED_FACTOR)
            for k in stations[ratio > MAX_FEED_FACTOR][:200]:
                actual, upper = mm(_worse_speed(float(slowest[k]), float(fastest[k]), claim)), mm(claim.upper)
                message = (
                    f"the wire cuts at {actual:.2f} mm/s; allowed: {mm(claim.lower):g} to {upper:g} mm/s"
                )
                at_wire(findings, wire, message, k, (actual, upper, "mm/s"))
    out = findings.outcome(float, "of the window")
    return dataclasses.replace(out, nothing="" if context.feeds else "no feed is claimed")


def feed_speed(context: Context, wire: WireMotion) -> FloatArray:
    """Return the speed (T,) [m/s] of the wire's fastest point inside the block, on the move to each station.

    Motion of the wire along itself does not count. The speed is NaN for the first station, and where no point
    is inside at both ends of the move.
    """
    out = np.full(len(wire.sample), np.nan)
    if len(out) < 2 or not wire.inside.any():
        return out
    step = motion_across_wire(wire.points)
    is_inside = wire.inside[1:] & wire.inside[:-1]
    time = np.diff(context.motion.time[wire.sample])
    fastest = np.where(is_inside, step, -np.inf).max(axis=1)
    is_valid = np.isfinite(fastest) & (time > 0.0)
    out[1:][is_valid] = fastest[is_valid] / time[is_valid]
    return out


def _worse_speed(slowest: float, fastest: float, claim: FeedWindow) -> float:
    """Return the one of two speeds [m/s] that is farther outside the feed window, as a ratio to its limit."""
    return float(fastest if fastest / claim.upper > claim.lower / max(slowest, 1e-9) else slowest)


def _speed_bounds(context: Context, wire: WireMotion, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return upper and lower bounds (T,), (T,) [m/s] of the speed of the wire's fastest point in the block.

    Both are ``speed`` (T,) unless trajectories drive the wire. Then ``speed`` is multiplied by the ratio of
    the tool's peak speed to its mean between stations for the upper bound. For the lower bound it is
    multiplied by the ratio of the tool's path to the straight one, because stations on both sides of a corner
    are closer than the path between them. Of two arms, the larger peak ratio counts, and the path ratio of
    the last arm.

    Args:
        context: Context of the proof.
        wire: The wire.
        speed: Speed on the move to each station, as `feed_speed` returns it (T,) [m/s].
    """
    if len(speed) < 2:  # no move between stations
        return speed, speed
    motion = context.motion
    peak_ratio, path_ratios = np.ones(len(speed)), np.ones(len(speed))
    longest = np.zeros(len(speed) - 1)
    for arm, speeds in tool_speeds(context).items():
        if arm not in wire.arms:
            continue
        samples = np.arange(wire.sample[0], wire.sample[-1] + 1)
        poses = inverse(context.stock_poses(wire.setup, samples)) @ motion.poses(arm, samples)
        sample_speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        sample_speed /= np.maximum(np.diff(motion.time[samples]), 1e-9)
        # by how much the peak speed of the trajectory exceeds the largest speed from sample to sample, by
        # node
        max_by_node = np.zeros(len(motion.node_stop))
        np.maximum.at(max_by_node, motion.node[samples[1:]], sample_speed)
        bound = np.ones(len(max_by_node))
        bound[speeds.node] = speeds.peak / np.maximum(max_by_node[speeds.node], 1e-9)
        station_samples = wire.sample - wire.sample[0]
        distance = np.linalg.norm(np.diff(poses[station_samples, :3, 3], axis=0), axis=1)
        mean = distance / np.maximum(np.diff(motion.time[wire.sample]), 1e-9)
        peak = np.maximum.reduceat(sample_speed, station_samples[:-1]) * np.maximum(
            bound[motion.node[wire.sample[1:]]], 1.0
        )
        is_moving = (distance > MIN_PATH_FRACTION * longest) & (distance > STANDSTILL_M)
        peak_ratio[1:] = np.where(
            is_moving, np.maximum(peak_ratio[1:], peak / np.maximum(mean, 1e-9)), peak_ratio[1:]
        )
        queries, station_queries = (
            motion.merged_samples,
            wire.sample + np.searchsorted(motion.between.sample, wire.sample),
        )
        query_rows = queries.row[station_queries[0] : station_queries[-1] + 1]
        poses = inverse(context.stock_poses(wire.setup, query_rows)) @ motion.poses(arm, query_rows)
        path_length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)))
        path_length = np.diff(path_length[station_queries - station_queries[0]])
        path_ratio = np.where(
            distance > MIN_PATH_FRACTION * longest, path_length / np.maximum(distance, 1e-9), 1.0
        )
        path_ratios[1:] = np.where(distance > 0.0, np.clip(path_ratio, 1.0, MAX_PATH_RATIO), 1.0)
        longest = np.maximum(longest, distance)
    return speed * peak_ratio, speed * path_ratios


@rule("verify.wire_mount")
def wire_mount(context: Context) -> RuleOutcome:
    """The operator confirms that the wire is mounted before the arms move together, and that it is off before
    one moves alone.
    """
    findings = Findings("verify.wire_mount", context)
    for number, phase in enumerate(context.phases, 1):
        confirms = context.confirmation_positions(phase)
        span = moving_span(context, phase)
        if not confirms or confirms[0] > span[0]:
            message = f"wire {number} is moved before the operator confirms that it is mounted"
            findings.add(message, hint="ask the operator first")
        if not confirms or confirms[-1] < span[1]:
            message = f"wire {number}: the operator does not confirm that it is off before an arm moves alone"
            findings.add(message, hint="ask the operator first")
    return findings.outcome_without_value("" if context.phases else "no wire")


def moving_span(context: Context, phase: JoinedPhase) -> tuple[int, int]:
    """Return the indices of the first and last step with which the arms move the mounted wire.

    These are steps of synchronised stages other than messages, signals and waits. Synchronised approaches and
    retreats are left out, because the wire is not mounted then.

    Returns:
        Indices in :meth:`~planner.proof.context.Context.steps_while_mounted` of this phase, (0, 0) for none.
    """
    moving_indices = [
        index
        for index, (stage_number, _, step) in enumerate(context.steps_while_mounted(phase))
        if context.job.stages[stage_number].synchronised
        and not context.job.stages[stage_number].is_synchronised_approach
        and not isinstance(step, MessageStep | SignalStep | WaitStep)
    ]
    return (moving_indices[0], moving_indices[-1]) if moving_indices else (0, 0)


def at_wire(
    findings: Findings, wire: WireMotion, message: str, k: int | np.integer, measure: Measure | None = None
) -> None:
    """Add an issue about a wire at its station ``k``.

    Args:
        findings: Findings of the rule.
        wire: The wire.
        message: Text of the issue.
        k: Station.
        measure: Value, limit and unit.
    """
    findings.add_at_sample(message, wire.arms[0], wire.sample[k], measure)


@rule("verify.wire_power", ContactOnlyIn)
def wire_power(context: Context) -> RuleOutcome:
    """The power is on and the wire hot before it touches the block, on until it has left, and off when hands
    are near it.
    """
    wires, findings = context.get(WIRES), Findings("verify.wire_power", context)
    for wire in wires:
        for claim in context.setup_claims[wire.setup].contacts:
            _check_power_in_contact(findings, wire, claim.signal, claim.heat_up)
            if wire.phase is not None:
                _check_power_at_hands(findings, wire.phase, claim.signal)
    for signal in sorted({claim.signal for claim in context.contacts}):
        _check_power_elsewhere(findings, signal)
    return findings.outcome_without_value("" if wires else "no wire")


def _switching_times(context: Context, wire: WireMotion, signal: str) -> list[tuple[float, float]]:
    """Return times and values of a wire's signal in order. It is off at first."""
    return [(-np.inf, 0.0), *context.motion.signal_changes(signal, context.controller_task_names(wire.arms))]


def _check_power_in_contact(findings: Findings, wire: WireMotion, signal: str, heat_up: float) -> None:
    """Report a wire that touches the block without power, or before the power is on for ``heat_up`` [s]."""
    touching = np.flatnonzero(wire.depth > 0.0)
    if not len(touching):
        return
    switching = _switching_times(findings.context, wire, signal)
    for run in np.split(touching, np.flatnonzero(np.diff(touching) > 1) + 1):
        first, last = findings.context.motion.time[wire.sample[run[[0, -1]]]]
        switched_before = [(time, value) for time, value in switching if time <= first]
        # the first change after the last one to off: from there the power is on, if there is such a change
        on = next((i for i in range(len(switched_before), 0, -1) if not switched_before[i - 1][1]), 0)
        if on == len(switched_before):
            at_wire(findings, wire, f"{signal} is not on when the wire touches the block", run[0])
        elif first - switched_before[on][0] < heat_up - 1e-6:
            heated_time = float(first - switched_before[on][0])
            message = (
                f"the wire touches the block {heated_time:.1f} s after {signal} is on; it needs {heat_up:g} s"
            )
            at_wire(findings, wire, message, run[0], (heated_time, heat_up, "s"))
        if any(not value and first < time < last for time, value in switching):
            at_wire(findings, wire, f"{signal} goes off while the wire is in the block", run[-1])


def _check_power_at_hands(findings: Findings, phase: JoinedPhase, signal: str) -> None:
    """Report power that is on when the operator mounts the wire, takes it off, or is asked between moves.

    Power that is still on after the phase is also reported. Between mounting and the first move the wire is
    heated, so questions with power are allowed there.
    """
    confirms = findings.context.confirmation_positions(phase)
    state: list[float] = []
    value = 0.0
    for _, _, step in findings.context.steps_while_mounted(phase):
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        state.append(value)
    if confirms:
        first, last = moving_span(findings.context, phase)
        if state[confirms[0]] and confirms[0] < first:
            findings.add(f"{signal} is on when the operator mounts the wire")
        if any(state[i] and first < i < last for i in confirms):
            message = f"{signal} is on while the operator is asked a question between moves"
            findings.add(message, hint="ask before the arms move, or switch it off")
        if state[confirms[-1]] and confirms[-1] > last:
            findings.add(f"{signal} is on when the operator takes the wire off")
    if value:
        findings.add(f"{signal} is still on when an arm moves alone")


def _check_power_elsewhere(findings: Findings, signal: str) -> None:
    """Report power that is on at the end of the job or at a question to the operator.

    `_check_power_at_hands` checks questions while a bent wire is mounted.
    """
    phases = findings.context.phases
    mounted = {number for phase in phases for number in range(phase.first, phase.last + 1)}
    value = 0.0
    for number, task, step in all_steps(findings.context):
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        if isinstance(step, MessageStep) and step.confirm and value and number not in mounted:
            message = f"{signal} is on while the operator is asked a question"
            findings.add_at_step(message, task, step, "switch it off first")
    if value:
        findings.add(f"{signal} is on when the programs end")
