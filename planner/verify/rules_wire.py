"""Rules on the wire: length, stability, curvature, contact, stops, feed, mounting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims import WireJoins
from planner.issues import Issue
from planner.verify.context import Context, Outcome, Phase, mm
from planner.verify.findings import at_sample
from planner.verify.speed import steps_across
from planner.verify.steps import MessageStep, SignalStep, WaitStep
from planner.verify.wire import Wire, held_lengths

FloatArray = NDArray[np.float64]

SNAP = 1e-3
RESIDUAL = 1e-6
FEED_SLACK = 1.05
"""The replay's ramps and corners may pass the feed window by this factor."""
TAUT = 0.9999
MELTS = 1e-3
"""A wire that stands nearer to foam than this melts it [m]."""


def wire_length(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The ends of the wire are never farther apart than it is long, and it can be mounted."""
    issues, worst, where = [], 0.0, ""
    for wire in wires:
        claim = wire.claim
        if wire.fault:
            issues.append(Issue("verify.wire_length", f"the wire cannot be followed: {wire.fault}"))
            continue
        if wire.path is None or wire.phase is None or not isinstance(claim, WireJoins):
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
                wire_issue(
                    context,
                    wire,
                    "verify.wire_length",
                    "no shape of the wire meets both clamps",
                    int(np.argmax(wire.path.residual)),
                )
            )
    if len(context.phases) < len(context.wires):
        what = (
            f"{len(context.wires)} bent wires are claimed; the programs move {len(context.phases)} together"
        )
        issues.append(Issue("verify.wire_length", what))
    if not context.phases:
        return Outcome(tuple(issues), where="no bent wire")
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
                wire_issue(
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
            wire_issue(context, wire, "verify.wire_stability", lost, int(k))
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
        claim = wire.claim
        if not isinstance(claim, WireJoins):
            continue
        bend = np.linalg.norm(wire.path.curvature, axis=2).max(axis=1)
        limit = min(limit, claim.max_curvature)
        worst = max(worst, float(bend.max()))
        for k in np.flatnonzero(bend > claim.max_curvature)[:200]:
            message = (
                f"the wire is bent to a radius of {mm(1 / bend[k]):.1f} mm; allowed: "
                f"{mm(1 / claim.max_curvature):.1f} mm"
            )
            issues.append(
                wire_issue(
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
    if not np.isfinite(limit):
        return Outcome(where="no bent wire")
    return Outcome(tuple(issues), worst, limit, "1/m")


def contact(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire touches the stock only in segments that cut, each of them claimed by an operation of its
    setup."""
    issues, worst = [], -np.inf
    for wire in wires:
        other = ~wire.cutting
        if not len(other) or not other.any():
            continue
        worst = max(worst, float(wire.depth[other].max()))
        for k in np.flatnonzero(other & (wire.depth > 0.0))[:200]:
            message = (
                f"the wire is {mm(wire.depth[k]):.2f} mm inside the block in segment {wire.labels[k]}; "
                f"setup {wire.setup + 1} cuts nothing there"
            )
            measure = mm(float(wire.depth[k])), 0.0, "mm"
            issues.append(wire_issue(context, wire, "verify.contact", message, int(k), *measure))
    if not np.isfinite(worst):
        return Outcome(tuple(issues), where="no wire")
    return Outcome(tuple(issues), mm(worst), 0.0, "mm")


def stop_in_foam(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The wire never stands still inside the block, or so near to it that it melts foam."""
    issues = []
    motion = context.motion
    for wire in wires:
        stops = np.isin(wire.sample, motion.node_sample[motion.node_stop])
        for k in np.flatnonzero(stops & (wire.depth > -MELTS)):
            side = "inside" if wire.depth[k] > 0.0 else "off"
            message = f"the wire stops {mm(abs(wire.depth[k])):.2f} mm {side} the block"
            issues.append(wire_issue(context, wire, "verify.stop_in_foam", message, int(k)))
    return Outcome(tuple(issues))


def feed(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The fastest point of the wire inside the block moves within the feed window."""
    issues: list[Issue] = []
    worst, limit, where = 0.0, None, ""
    for wire in wires:
        speed = feed_speed(context, wire)
        for claim in context.feeds:
            if wire.setup != context.setup_of(claim):
                continue
            here = wire.labels[1:] == claim.segment.key
            rows = np.flatnonzero(here & np.isfinite(speed[1:])) + 1
            if not len(rows):
                continue
            share = np.maximum(speed[rows] / claim.upper, claim.lower / np.maximum(speed[rows], 1e-9))
            if share.max() > worst:
                worst, limit, where = float(share.max()), FEED_SLACK, str(claim.segment)
            for k in rows[share > FEED_SLACK][:200]:
                message = (
                    f"the wire cuts at {mm(speed[k]):.2f} mm/s; allowed: {mm(claim.lower):g} to "
                    f"{mm(claim.upper):g} mm/s"
                )
                issues.append(
                    wire_issue(
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
    if len(out) < 2 or not wire.inside.any():
        return out
    step = steps_across(wire.points)
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
        confirms = context.confirms(phase)
        here = moving(context, phase)
        if not confirms or confirms[0] > here[0]:
            issues.append(
                Issue(
                    "verify.wire_mount",
                    f"wire {number + 1} is moved before anyone confirms that it is mounted",
                    hint="ask the operator first",
                )
            )
        if not confirms or confirms[-1] < here[1]:
            message = f"wire {number + 1}: nobody confirms that it is off before the arms move alone again"
            issues.append(Issue("verify.wire_mount", message, hint="ask the operator first"))
    return Outcome(tuple(issues), where="" if context.phases else "no wire")


def moving(context: Context, phase: Phase) -> tuple[int, int]:
    """Positions of the first and last step of synchronised stages among a phase's steps."""
    synchronised = [
        i
        for i, (number, _, step) in enumerate(context.mounted_steps(phase))
        if context.job.stages[number].synchronised
        and not isinstance(step, MessageStep | SignalStep | WaitStep)
    ]
    return (synchronised[0], synchronised[-1]) if synchronised else (0, 0)


def wire_issue(
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
    return at_sample(code, message, context.motion, wire.arms[0], int(wire.sample[k]), measure)
