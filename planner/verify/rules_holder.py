"""The rule on a clamp that sinks with the sheet's rim: its signal against the level the tool has reached.

The clamp is told by its signal alone: it is as many steps below its start as there were pulses. The level of
the tool is that of the replayed motion.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.claims_forming import SinksHolder
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.forming_state import Forming
from planner.verify.forming_track import Track, track
from planner.verify.steps import SignalStep

FloatArray = NDArray[np.float64]

SLACK = 2e-5
"""What the written targets and the replay may add [m]."""
SOON = 1e-6
SHOWN = 20


def holder(context: Context, forming: Forming) -> Outcome:
    """The signal of a clamp that sinks is pulsed once for each step, within one step of the level that the
    forming tool has reached, and switched at no other time."""
    issues: list[Issue] = []
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, SinksHolder)]
    worst, limit, where = 0.0, None, ""
    for index, claim in claims:
        way = track(context, claim.segment, index, (claim.arm,))
        if not way.own.any():
            issues.append(Issue("verify.holder", f"{claim.arm} never forms {claim.segment}"))
            continue
        edges = _edges(context, claim.signal)
        issues += _pulses(claim, edges)
        issues += _outside(context, claim, way, edges)
        off, far = _off(context, claim, way, [edge.time for edge in edges if edge.value > 0.0])
        issues += far
        if limit is None or off - claim.step > worst - limit:
            worst, limit, where = off, claim.step, str(claim.segment)
    if limit is None:
        return Outcome(tuple(issues), where="no clamp sinks")
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm", where)


@dataclasses.dataclass(frozen=True)
class _Edge:
    """The signal goes to ``value`` at ``time`` [s]."""

    time: float
    value: float


def _edges(context: Context, signal: str) -> list[_Edge]:
    """When a signal that is off at first goes on and off, in order; holders see its edges alone."""
    found = [
        _Edge(time, float(step.value))
        for time, _, _, step in context.motion.step_time
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower()
    ]
    found.sort(key=lambda edge: edge.time)
    before = [0.0, *(edge.value for edge in found)]
    return [edge for edge, value in zip(found, before, strict=False) if edge.value != value]


def _pulses(claim: SinksHolder, edges: list[_Edge]) -> list[Issue]:
    """On and off for long enough, as many times as there are whole steps, off at last."""
    issues = []
    before: _Edge | None = None
    for edge in edges:
        if before is not None and edge.time - before.time < claim.pulse - SOON:
            state = "on" if before.value else "off"
            what = (
                f"{claim.signal} is {state} for {edge.time - before.time:.3f} s at {before.time:.2f} s; "
                f"wanted: {claim.pulse:g} s"
            )
            issues.append(Issue("verify.holder", what, time=edge.time))
        before = edge
    if before is not None and before.value:
        issues.append(Issue("verify.holder", f"{claim.signal} is still on when the programs end"))
    count = sum(edge.value > 0.0 for edge in edges)
    wanted = int(np.floor(abs(claim.start - claim.end) / claim.step + 1e-3))
    if count != wanted:
        what = (
            f"{claim.signal} is pulsed {count} times; {mm(abs(claim.start - claim.end)):g} mm in steps of "
            f"{mm(claim.step):g} mm are {wanted}"
        )
        issues.append(Issue("verify.holder", what, value=count, limit=wanted))
    return issues[:SHOWN]


def _outside(context: Context, claim: SinksHolder, way: Track, edges: list[_Edge]) -> list[Issue]:
    """What is switched outside of the pass, which lasts from the end of the way in to the way out."""
    own = np.flatnonzero(way.own)
    span = way.rows[[max(int(own[0]) - 1, 0), min(int(own[-1]) + 1, len(way.rows) - 1)]]
    first, last = context.motion.time[span]
    return [
        Issue(
            "verify.holder",
            f"{claim.signal} is switched at {edge.time:.2f} s, while {claim.segment} is not formed",
            time=edge.time,
        )
        for edge in edges
        if not first - SOON <= edge.time <= last + SOON
    ][:SHOWN]


def _off(context: Context, claim: SinksHolder, way: Track, pulses: list[float]) -> tuple[float, list[Issue]]:
    """How far [m] the clamp is off the tip's lowest level at most, and where by more than a step."""
    motion = context.motion
    rows = np.flatnonzero(way.own)
    tip = claim.side * (claim.start - way.centre[: rows[-1] + 1, 0, 2]) + claim.radius
    sunk = np.maximum(np.maximum.accumulate(tip), 0.0)[rows]
    now = motion.time[way.rows[rows]]
    at = np.array(pulses)
    # at the very instant of a pulse the clamp is on its way: both levels count
    before = claim.step * np.searchsorted(at, now - SOON, side="left")
    after = claim.step * np.searchsorted(at, now + SOON, side="right")
    off = np.maximum(np.abs(sunk - before), np.abs(sunk - after))
    bad = np.flatnonzero(off > claim.step + SLACK)
    bad = bad[np.diff(bad, prepend=-2) > 1][:SHOWN]
    issues = []
    for k in bad:
        what = (
            f"the clamp is {mm(off[k]):.3f} mm off the level that the tool has reached in {claim.segment}; "
            f"allowed is one step, {mm(claim.step):g} mm"
        )
        measure = (mm(float(off[k])), mm(claim.step), "mm")
        issues.append(at_sample("verify.holder", what, motion, claim.arm, int(way.rows[rows[k]]), measure))
    return float(off.max()), issues
