"""Rules on the mounted wire: length, stability, curvature, contact, feed, power and the operator's steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue
from planner.verify.context import Context, Outcome, Phase, mm
from planner.verify.findings import at_sample
from planner.verify.rapid_steps import MessageStep, SignalStep, WaitStep
from planner.verify.wire import Wire, held_lengths

FloatArray = NDArray[np.float64]

SNAP = 1e-3
RESIDUAL = 1e-6
FEED_SLACK = 1.05
"""The replay's ramps and corners may pass the feed window by this factor."""
TAUT = 0.9999


def wire_length(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The ends of the wire are never farther apart than it is long, and it can be mounted."""
    issues, worst, where = [], 0.0, ""
    for wire in wires:
        claim = wire.phase.claim
        if wire.path is None:
            issues.append(Issue("verify.wire_length", f"the wire cannot be followed: {wire.fault}"))
            continue
        share = held_lengths(context, wire.phase) / claim.length
        worst = max(worst, float(share.max()))
        if share.max() >= TAUT:
            message = (
                f"the ends are {mm(share.max() * claim.length):.3f} mm apart; the wire is "
                f"{mm(claim.length):.3f} mm long"
            )
            k = int(np.argmax(share))
            issues.append(
                Issue(
                    "verify.wire_length",
                    message,
                    index=k,
                    value=mm(share.max() * claim.length),
                    limit=mm(claim.length),
                    unit="mm",
                )
            )
        if wire.path.residual.max() > RESIDUAL:
            issues.append(
                _wire_issue(
                    context,
                    wire,
                    "verify.wire_length",
                    "no shape of the wire meets both clamps",
                    int(np.argmax(wire.path.residual)),
                )
            )
    if not wires:
        return _none(context, issues, "verify.wire_length")
    return Outcome(tuple(issues), 100.0 * worst, 100.0 * TAUT, "% of its length", where)


def wire_stability(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire's shape is stable all along and never snaps to another one."""
    issues, least = [], np.inf
    for wire in wires:
        if wire.path is None:
            continue
        least = min(least, float(wire.path.min_eig.min()))
        for k in np.flatnonzero(wire.path.jump)[:50]:
            message = f"the wire snaps to another shape and moves by {mm(wire.path.moved[k]):.1f} mm"
            issues.append(
                _wire_issue(
                    context,
                    wire,
                    "verify.wire_stability",
                    message,
                    int(k),
                    mm(float(wire.path.moved[k])),
                    0.0,
                    "mm",
                )
            )
        lost = "the wire has no stable shape near the one it had"
        issues += [
            _wire_issue(context, wire, "verify.wire_stability", lost, int(k))
            for k in np.flatnonzero(~wire.path.stable)[:50]
        ]
    return Outcome(
        tuple(issues),
        None if not np.isfinite(least) else least,
        0.0,
        "of the first mode",
        "" if wires else "no wire",
    )


def curvature(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire is never bent beyond its elastic limit."""
    issues, worst, limit = [], 0.0, np.inf
    for wire in wires:
        if wire.path is None:
            continue
        claim = wire.phase.claim
        bend = np.linalg.norm(wire.path.curvature, axis=2).max(axis=1)
        limit = min(limit, claim.max_curvature)
        worst = max(worst, float(bend.max()))
        for k in np.flatnonzero(bend > claim.max_curvature)[:200]:
            message = (
                f"the wire is bent to a radius of {mm(1 / bend[k]):.1f} mm; allowed: "
                f"{mm(1 / claim.max_curvature):.1f} mm"
            )
            issues.append(
                _wire_issue(
                    context,
                    wire,
                    "verify.curvature",
                    message,
                    int(k),
                    float(bend[k]),
                    claim.max_curvature,
                    "1/m",
                )
            )
    if not wires:
        return Outcome(where="no wire")
    return Outcome(tuple(issues), worst, limit, "1/m")


def contact(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire touches the stock only in segments that cut."""
    issues, worst = [], -np.inf
    for wire in wires:
        for claim in context.contacts:
            other = np.array([label.split("/")[0] not in claim.kinds for label in wire.labels], dtype=bool)
            if not len(other) or not other.any():
                continue
            worst = max(worst, float(wire.depth[other].max()))
            for k in np.flatnonzero(other & (wire.depth > 0.0))[:200]:
                message = (
                    f"the wire is {mm(wire.depth[k]):.2f} mm inside the block in segment {wire.labels[k]}"
                )
                issues.append(
                    _wire_issue(
                        context, wire, "verify.contact", message, int(k), mm(float(wire.depth[k])), 0.0, "mm"
                    )
                )
    if not np.isfinite(worst):
        return Outcome(tuple(issues), where="no wire")
    return Outcome(tuple(issues), mm(worst), 0.0, "mm")


def stop_in_foam(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire never stands still inside the block."""
    issues = []
    motion = context.motion
    for wire in wires:
        stops = np.isin(wire.sample, motion.node_sample[motion.node_stop])
        for k in np.flatnonzero(stops & (wire.depth > 0.0)):
            message = f"the wire stops {mm(wire.depth[k]):.2f} mm inside the block"
            issues.append(_wire_issue(context, wire, "verify.stop_in_foam", message, int(k)))
    return Outcome(tuple(issues))


def feed(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The fastest point of the wire inside the block moves within the feed window."""
    issues: list[Issue] = []
    worst, limit, where = 0.0, None, ""
    for wire in wires:
        speed = feed_speed(context, wire)
        for claim in context.feeds:
            rows = np.flatnonzero((wire.labels[1:] == claim.segment) & np.isfinite(speed[1:])) + 1
            if not len(rows):
                continue
            share = np.maximum(speed[rows] / claim.upper, claim.lower / np.maximum(speed[rows], 1e-9))
            if share.max() > worst:
                worst, limit, where = float(share.max()), FEED_SLACK, claim.segment
            for k in rows[share > FEED_SLACK][:200]:
                message = (
                    f"the wire cuts at {mm(speed[k]):.2f} mm/s; allowed: {mm(claim.lower):g} to "
                    f"{mm(claim.upper):g} mm/s"
                )
                issues.append(
                    _wire_issue(
                        context,
                        wire,
                        "verify.feed",
                        message,
                        int(k),
                        mm(float(speed[k])),
                        mm(claim.upper),
                        "mm/s",
                    )
                )
    return Outcome(tuple(issues), worst, limit, "of the window", where)


def feed_speed(context: Context, wire: Wire) -> FloatArray:
    """Speed (T,) [m/s] across the wire of its fastest point inside the block on the way to each station; NaN
    where none is inside. A wire that also slides along itself cuts no faster for it."""
    out = np.full(len(wire.sample), np.nan)
    if len(out) < 2:
        return out
    way = np.diff(wire.points, axis=0)
    along = np.gradient(wire.points[:-1] + wire.points[1:], axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    step = np.linalg.norm(way - (way * along).sum(axis=2, keepdims=True) * along, axis=2)
    both = wire.inside[1:] & wire.inside[:-1]
    time = np.diff(context.motion.time[wire.sample])
    fastest = np.where(both, step, -np.inf).max(axis=1)
    good = np.isfinite(fastest) & (time > 0.0)
    out[1:][good] = fastest[good] / time[good]
    return out


def wire_mount(context: Context) -> Outcome:
    """The operator confirms that the wire is mounted before the arms move together, and that it is off
    before one moves alone."""
    issues = []
    for number, phase in enumerate(context.phases):
        steps = context.mounted_steps(phase)
        confirms = context.confirms(phase)
        moving = _moving(context, phase)
        if not confirms or confirms[0] > moving[0]:
            issues.append(
                Issue(
                    "verify.wire_mount",
                    f"wire {number + 1} is moved before anyone confirms that it is mounted",
                    hint="ask the operator first",
                )
            )
        if not confirms or confirms[-1] < moving[1]:
            message = f"wire {number + 1}: nobody confirms that it is off before the arms move alone again"
            issues.append(Issue("verify.wire_mount", message, hint="ask the operator first"))
        del steps
    return Outcome(tuple(issues), where="" if context.phases else "no wire")


def wire_power(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The power is on and the wire hot before it touches the block, on until it has left, and off when hands
    are near it."""
    issues: list[Issue] = []
    for wire in wires:
        for claim in context.contacts:
            issues += _power_in_contact(context, wire, claim.signal, claim.heat_up)
            issues += _power_at_hands(context, wire.phase, claim.signal)
    return Outcome(tuple(issues), where="" if wires else "no wire")


def _switching(context: Context, signal: str) -> list[tuple[float, float]]:
    """Times and values of a signal in order; off at first."""
    found = [
        (time, step.value)
        for time, _, _, step in context.motion.step_time
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower()
    ]
    return [(-np.inf, 0.0), *sorted(found, key=lambda item: item[0])]


def _power_in_contact(context: Context, wire: Wire, signal: str, heat_up: float) -> list[Issue]:
    touching = np.flatnonzero(wire.depth > 0.0)
    if not len(touching):
        return []
    times = context.motion.time[wire.sample[touching]]
    switching = _switching(context, signal)
    on = [i for i, (time, value) in enumerate(switching) if value > 0.0 and time <= times[0]]
    if not on or any(value == 0.0 and switching[on[-1]][0] < time <= times[0] for time, value in switching):
        return [
            _wire_issue(
                context,
                wire,
                "verify.wire_power",
                f"{signal} is not on when the wire touches the block",
                int(touching[0]),
            )
        ]
    issues = []
    start = next(
        t
        for i, (t, v) in enumerate(switching)
        if v > 0.0 and all(w > 0.0 for _, w in switching[i : on[-1] + 1])
    )
    if times[0] - start < heat_up - 1e-6:
        message = (
            f"the wire touches the block {times[0] - start:.1f} s after {signal} is on; it needs "
            f"{heat_up:g} s"
        )
        issues.append(
            _wire_issue(
                context, wire, "verify.wire_power", message, int(touching[0]), times[0] - start, heat_up, "s"
            )
        )
    if any(value == 0.0 and times[0] < time < times[-1] for time, value in switching):
        issues.append(
            _wire_issue(
                context,
                wire,
                "verify.wire_power",
                f"{signal} goes off while the wire is in the block",
                int(touching[-1]),
            )
        )
    return issues


def _power_at_hands(context: Context, phase: Phase, signal: str) -> list[Issue]:
    """Off at the first confirmation (mounting) and the last one (taking off), and heated up by waiting, not
    by moving."""
    issues = []
    steps = context.mounted_steps(phase)
    confirms = context.confirms(phase)
    state: list[float] = []
    value = 0.0
    for _, _, step in steps:
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        state.append(value)
    if confirms:
        moving = _moving(context, phase)
        if state[confirms[0]] and confirms[0] < moving[0]:
            issues.append(Issue("verify.wire_power", f"{signal} is on when the operator mounts the wire"))
        if state[confirms[-1]] and confirms[-1] > moving[1]:
            issues.append(Issue("verify.wire_power", f"{signal} is on when the operator takes the wire off"))
    if value:
        issues.append(Issue("verify.wire_power", f"{signal} is still on when the arms move alone again"))
    return issues


def _moving(context: Context, phase: Phase) -> tuple[int, int]:
    """Positions of the first and last step of synchronised stages among a phase's steps."""
    synchronised = [
        i
        for i, (number, _, step) in enumerate(context.mounted_steps(phase))
        if context.job.stages[number].synchronised
        and not isinstance(step, MessageStep | SignalStep | WaitStep)
    ]
    return (synchronised[0], synchronised[-1]) if synchronised else (0, 0)


def _none(context: Context, issues: list[Issue], code: str) -> Outcome:
    if context.wires and not context.phases:
        issues.append(Issue(code, "a wire is claimed, but the programs have no synchronised moves"))
    return Outcome(tuple(issues), where="no wire")


def _wire_issue(
    context: Context,
    wire: Wire,
    code: str,
    message: str,
    k: int,
    value: float | None = None,
    limit: float = 0.0,
    unit: str = "",
) -> Issue:
    measure = None if value is None else (value, limit, unit)
    return at_sample(code, message, context.motion, wire.phase.claim.arms[0], int(wire.sample[k]), measure)
