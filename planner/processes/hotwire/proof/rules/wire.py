"""Rules on the wire and its power.

verify.wire_length, wire_stability, curvature, contact, stop_in_foam, feed, wire_mount.
verify.wire_power, signals: on and hot in the foam, off at hands, switched in one plain way.
"""

import dataclasses

import numpy as np

from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.geometry.arrays import FloatArray, inverse
from planner.processes.hotwire.claims import WireJoins
from planner.processes.hotwire.proof.wire_motion import WIRES, Wire, end_distances, mounted
from planner.programs.steps import MessageStep, SignalStep, WaitStep
from planner.proof.context import Context
from planner.proof.findings import Findings, in_mm, percent
from planner.proof.replay import standing
from planner.proof.replay.motion import steps_across
from planner.proof.replay.tool_speeds import LEAST_PART, STANDS, tool_speeds
from planner.proof.rule import FEED_SLACK, Measure, Outcome, mm, rule
from planner.proof.rules.power import all_steps
from planner.proof.setups import Phase

MOST_RESIDUAL = 1e-6
"""A wire's shape is in balance where no residual of its equations is larger than this."""
TAUT_SHARE = 0.9999
"""Ends that are farther apart than this share of the wire's length leave it no bow."""
MOST_ROUND = 2.0
"""A way round a corner counts as so many times the straight one at most."""
MELTING_DISTANCE = 1e-3
"""A wire that stands nearer to foam than this melts it [m]."""


@rule("verify.wire_length", WireJoins)
def wire_length(context: Context) -> Outcome:
    """The ends of the wire are never farther apart than it is long, and it can be mounted."""
    findings = Findings("verify.wire_length", context, worst=0.0)
    for wire in context.get(WIRES):
        claim = wire.claim
        if wire.fault:
            findings.add(f"the wire cannot be followed: {wire.fault}")
            continue
        if wire.path is None or wire.phase is None or not isinstance(claim, WireJoins):
            continue
        share = end_distances(context, wire.phase) / claim.length
        k = int(np.argmax(share))
        findings.highest(share[k])
        if share[k] >= TAUT_SHARE:
            apart = share[k] * claim.length
            message = f"the ends are {mm(apart):.3f} mm apart; the wire is {mm(claim.length):.3f} mm long"
            findings.add(message, in_mm(apart, claim.length), index=k)
        if wire.path.residual.max() > MOST_RESIDUAL:
            what = "no shape of the wire meets both clamps"
            at_wire(findings, wire, what, int(np.argmax(wire.path.residual)))
    claimed, there = len(context.of(WireJoins)), len(mounted(context))
    if there < claimed:
        findings.add(f"{claimed} bent wires are claimed; the programs move {there} together")
    if not context.phases:
        return findings.outcome_without_value("no bent wire")
    return findings.outcome(percent, "% of its length", TAUT_SHARE)


@rule("verify.wire_stability", WireJoins)
def wire_stability(context: Context) -> Outcome:
    """The wire's shape is stable all along and never snaps to another one."""
    findings = Findings("verify.wire_stability", context, worst=np.inf)
    bent = [(wire, wire.path) for wire in context.get(WIRES) if wire.path is not None]
    for wire, path in bent:
        findings.lowest(path.min_eig.min())
        for k in np.flatnonzero(path.jump)[:50]:
            message = f"the wire snaps to another shape and moves by {mm(path.moved[k]):.1f} mm"
            at_wire(findings, wire, message, k, in_mm(path.moved[k], 0.0))
        for k in np.flatnonzero(~path.stable)[:50]:
            at_wire(findings, wire, "the wire has no stable shape near the one it had", k)
    out = findings.outcome(float, "of the first mode", 0.0)
    worst = out.worst if findings.measured else None
    return dataclasses.replace(out, worst=worst, nothing="" if bent else "no bent wire")


@rule("verify.curvature", WireJoins)
def curvature(context: Context) -> Outcome:
    """The wire is never bent beyond its elastic limit."""
    findings, limit = Findings("verify.curvature", context, worst=0.0), np.inf
    for wire in context.get(WIRES):
        claim = wire.claim
        if wire.path is None or not isinstance(claim, WireJoins):
            continue
        bend = np.linalg.norm(wire.path.curvature, axis=2).max(axis=1)
        limit = min(limit, claim.max_curvature)
        findings.highest(bend.max())
        for k in np.flatnonzero(bend > claim.max_curvature)[:200]:
            message = (
                f"the wire is bent to a radius of {mm(1 / bend[k]):.1f} mm; allowed: "
                f"{mm(1 / claim.max_curvature):.1f} mm"
            )
            at_wire(findings, wire, message, k, (float(bend[k]), claim.max_curvature, "1/m"))
    if not np.isfinite(limit):
        return Outcome(nothing="no bent wire")
    return findings.outcome(float, "1/m", limit)


@rule("verify.contact", ContactOnlyIn)
def contact(context: Context) -> Outcome:
    """The wire touches the stock only in segments that cut, each of them claimed by an operation of its
    setup."""
    findings = Findings("verify.contact", context)
    for wire in context.get(WIRES):
        other = ~wire.cutting
        if not len(other) or not other.any():
            continue
        findings.highest(wire.depth[other].max())
        for k in np.flatnonzero(other & (wire.depth > 0.0))[:200]:
            message = (
                f"the wire is {mm(wire.depth[k]):.2f} mm inside the block in segment {wire.labels[k]}; "
                f"setup {wire.setup + 1} cuts nothing there"
            )
            at_wire(findings, wire, message, k, in_mm(wire.depth[k], 0.0))
    return findings.outcome(mm, "mm", 0.0, nothing="no wire")


@rule("verify.stop_in_foam")
def stop_in_foam(context: Context) -> Outcome:
    """The wire never stands still inside the block, or so near to it that it melts foam; nor as good as
    still, where trajectories state velocities."""
    wires, findings = context.get(WIRES), Findings("verify.stop_in_foam", context)
    motion = context.motion
    stands = motion.node_stop | standing.standing(context)
    for wire in wires:
        stops = np.isin(wire.sample, motion.node_sample[stands])
        for k in np.flatnonzero(stops & (wire.depth > -MELTING_DISTANCE)):
            side = "inside" if wire.depth[k] > 0.0 else "off"
            message = f"the wire stops {mm(abs(wire.depth[k])):.2f} mm {side} the block"
            at_wire(findings, wire, message, k)
    return findings.outcome_without_value("" if wires else "no wire")


@rule("verify.feed", FeedWindow)
def feed(context: Context) -> Outcome:
    """The fastest point of the wire inside the block moves within the feed window; on the cubics of
    trajectories at every instant no faster, by what the tools' speeds there are to their mean."""
    findings = Findings("verify.feed", context, worst=0.0)
    for wire in context.get(WIRES):
        speed = feed_speed(context, wire)
        fastest, slowest = _driven_feed(context, wire, speed)
        for claim in context.feeds:
            if wire.setup != context.setup_of(claim):
                continue
            here = wire.labels[1:] == claim.segment.key
            rows = np.flatnonzero(here & np.isfinite(speed[1:])) + 1
            if not len(rows):
                continue
            share = np.maximum(fastest[rows] / claim.upper, claim.lower / np.maximum(slowest[rows], 1e-9))
            findings.highest(share.max(), claim.segment, FEED_SLACK)
            for k in rows[share > FEED_SLACK][:200]:
                got, upper = mm(_told(float(slowest[k]), float(fastest[k]), claim)), mm(claim.upper)
                message = f"the wire cuts at {got:.2f} mm/s; allowed: {mm(claim.lower):g} to {upper:g} mm/s"
                at_wire(findings, wire, message, k, (got, upper, "mm/s"))
    out = findings.outcome(float, "of the window")
    return dataclasses.replace(out, nothing="" if context.feeds else "no feed is claimed")


def feed_speed(context: Context, wire: Wire) -> FloatArray:
    """Speed (T,) [m/s] across the wire of its fastest point inside the block on the way to each station; NaN
    where none is inside. A wire that also slides along itself cuts no faster for it."""
    out = np.full(len(wire.sample), np.nan)
    if len(out) < 2 or not wire.inside.any():
        return out
    step = steps_across(wire.points)
    both = wire.inside[1:] & wire.inside[:-1]
    time = np.diff(context.motion.time[wire.sample])
    fastest = np.where(both, step, -np.inf).max(axis=1)
    good = np.isfinite(fastest) & (time > 0.0)
    out[1:][good] = fastest[good] / time[good]
    return out


def _told(mean: float, fastest: float, claim: FeedWindow) -> float:
    """The one of two speeds that is farther out of a window."""
    return float(fastest if fastest / claim.upper > claim.lower / max(mean, 1e-9) else mean)


def _driven_feed(context: Context, wire: Wire, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The speeds (T,) [m/s] between which the wire's fastest point in the block goes to each station:
    ``speed`` (T,), or where trajectories drive it as many times that as a tool is faster at an instant there
    than on the mean from station to station, and as its way there is longer than the straight one: stations
    stand on both sides of a corner."""
    if len(speed) < 2:  # no way from one station to the next
        return speed, speed
    motion, times, longer = context.motion, np.ones(len(speed)), np.ones(len(speed))
    longest = np.zeros(len(speed) - 1)
    for arm, own in tool_speeds(context).items():
        if arm not in wire.arms:
            continue
        rows = np.arange(wire.sample[0], wire.sample[-1] + 1)
        seen = inverse(context.stock_poses(wire.setup, rows)) @ motion.poses(arm, rows)
        fast = np.linalg.norm(np.diff(seen[:, :3, 3], axis=0), axis=1)
        fast /= np.maximum(np.diff(motion.time[rows]), 1e-9)
        most = np.zeros(len(motion.node_stop))
        np.maximum.at(most, motion.node[rows[1:]], fast)  # by samples, of each node
        bound = np.ones(len(most))
        bound[own.node] = own.peak / np.maximum(most[own.node], 1e-9)
        here = wire.sample - wire.sample[0]
        way = np.linalg.norm(np.diff(seen[here, :3, 3], axis=0), axis=1)
        mean = way / np.maximum(np.diff(motion.time[wire.sample]), 1e-9)
        peak = np.maximum.reduceat(fast, here[:-1]) * np.maximum(bound[motion.node[wire.sample[1:]]], 1.0)
        goes = (way > LEAST_PART * longest) & (way > STANDS)
        times[1:] = np.where(goes, np.maximum(times[1:], peak / np.maximum(mean, 1e-9)), times[1:])
        looks, at = motion.looks, wire.sample + np.searchsorted(motion.between.sample, wire.sample)
        there = looks.row[at[0] : at[-1] + 1]
        seen = inverse(context.stock_poses(wire.setup, there)) @ motion.poses(arm, there)
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(seen[:, :3, 3], axis=0), axis=1)))
        gone = np.diff(gone[at - at[0]])
        round_ = np.where(way > LEAST_PART * longest, gone / np.maximum(way, 1e-9), 1.0)
        longer[1:] = np.where(way > 0.0, np.clip(round_, 1.0, MOST_ROUND), 1.0)
        longest = np.maximum(longest, way)
    return speed * times, speed * longer


@rule("verify.wire_mount")
def wire_mount(context: Context) -> Outcome:
    """The operator confirms that the wire is mounted before the arms move together, and that it is off
    before one moves alone."""
    findings = Findings("verify.wire_mount", context)
    for number, phase in enumerate(context.phases, 1):
        confirms = context.confirms(phase)
        here = moving(context, phase)
        if not confirms or confirms[0] > here[0]:
            message = f"wire {number} is moved before anyone confirms that it is mounted"
            findings.add(message, hint="ask the operator first")
        if not confirms or confirms[-1] < here[1]:
            message = f"wire {number}: nobody confirms that it is off before the arms move alone again"
            findings.add(message, hint="ask the operator first")
    return findings.outcome_without_value("" if context.phases else "no wire")


def moving(context: Context, phase: Phase) -> tuple[int, int]:
    """Positions of the first and last step of synchronised stages among a phase's steps."""
    synchronised = [
        i
        for i, (number, _, step) in enumerate(context.mounted_steps(phase))
        if context.job.stages[number].synchronised
        and not context.job.stages[number].is_way
        and not isinstance(step, MessageStep | SignalStep | WaitStep)
    ]
    return (synchronised[0], synchronised[-1]) if synchronised else (0, 0)


def at_wire(
    findings: Findings, wire: Wire, message: str, k: int | np.integer, measure: Measure | None = None
) -> None:
    """Add an issue about a wire at its station ``k``."""
    findings.at_sample(message, wire.arms[0], wire.sample[k], measure)


@rule("verify.wire_power", ContactOnlyIn)
def wire_power(context: Context) -> Outcome:
    """The power is on and the wire hot before it touches the block, on until it has left, and off when hands
    are near it."""
    wires, findings = context.get(WIRES), Findings("verify.wire_power", context)
    for wire in wires:
        for claim in context.setup_claims[wire.setup].contacts:
            _power_in_contact(findings, wire, claim.signal, claim.heat_up)
            if wire.phase is not None:
                _power_at_hands(findings, wire.phase, claim.signal)
    for signal in sorted({claim.signal for claim in context.contacts}):
        _power_elsewhere(findings, signal)
    return findings.outcome_without_value("" if wires else "no wire")


def _switching(context: Context, wire: Wire, signal: str) -> list[tuple[float, float]]:
    """Times and values of a wire's signal in order; off at first."""
    return [(-np.inf, 0.0), *context.motion.switched(signal, context.switching(wire.arms))]


def _power_in_contact(findings: Findings, wire: Wire, signal: str, heat_up: float) -> None:
    touching = np.flatnonzero(wire.depth > 0.0)
    if not len(touching):
        return
    switching = _switching(findings.context, wire, signal)
    for run in np.split(touching, np.flatnonzero(np.diff(touching) > 1) + 1):
        first, last = findings.context.motion.time[wire.sample[run[[0, -1]]]]
        before = [(time, value) for time, value in switching if time <= first]
        on = next((i for i in range(len(before), 0, -1) if not before[i - 1][1]), 0)
        if on == len(before):
            at_wire(findings, wire, f"{signal} is not on when the wire touches the block", run[0])
        elif first - before[on][0] < heat_up - 1e-6:
            hot = float(first - before[on][0])
            what = f"the wire touches the block {hot:.1f} s after {signal} is on; it needs {heat_up:g} s"
            at_wire(findings, wire, what, run[0], (hot, heat_up, "s"))
        if any(not value and first < time < last for time, value in switching):
            at_wire(findings, wire, f"{signal} goes off while the wire is in the block", run[-1])


def _power_at_hands(findings: Findings, phase: Phase, signal: str) -> None:
    """Off at the first confirmation (mounting) and the last one (taking off), and heated up by waiting, not
    by moving."""
    confirms = findings.context.confirms(phase)
    state: list[float] = []
    value = 0.0
    for _, _, step in findings.context.mounted_steps(phase):
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        state.append(value)
    if confirms:
        first, last = moving(findings.context, phase)
        if state[confirms[0]] and confirms[0] < first:
            findings.add(f"{signal} is on when the operator mounts the wire")
        if any(state[i] and first < i < last for i in confirms):
            what = f"{signal} is on while the operator is asked something on the way"
            findings.add(what, hint="ask before the arms move, or switch it off")
        if state[confirms[-1]] and confirms[-1] > last:
            findings.add(f"{signal} is on when the operator takes the wire off")
    if value:
        findings.add(f"{signal} is still on when the arms move alone again")


def _power_elsewhere(findings: Findings, signal: str) -> None:
    """Off at every question that is no part of mounting a bent wire, and at the end of the job."""
    phases = findings.context.phases
    mounted = {number for phase in phases for number in range(phase.first, phase.last + 1)}
    value = 0.0
    for number, task, step in all_steps(findings.context):
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        if isinstance(step, MessageStep) and step.confirm and value and number not in mounted:
            what = f"{signal} is on while the operator is asked something"
            findings.at_step(what, task, step, "switch it off first")
    if value:
        findings.add(f"{signal} is on when the programs end")
