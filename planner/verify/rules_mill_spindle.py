"""Rules on milling: the feed of the tip, and a spindle that is up to speed
wherever the cutter is in the block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims import FeedWindow
from planner.claims_milling import MillsAlong
from planner.issues import Issue
from planner.segments import Segment
from planner.tooling import Mill
from planner.verify import rules_mill_flank
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.mill_pace import allowed
from planner.verify.mill_track import Milling, in_block
from planner.verify.setups import MILL
from planner.verify.steps import SignalStep

FloatArray = NDArray[np.float64]

NONE = "nothing is milled"
SHOWN = 50
"""Issues of one segment at most."""
FEED_SLACK = 1.05
"""The replay's ramps and corners may pass the feed by this factor."""


def mill_feed(context: Context, milling: Milling) -> Outcome:
    """While it mills, and on its ways in and out, the tip moves no faster than it may at each place of its
    way."""
    motion = context.motion
    issues: list[Issue] = []
    worst, where = 0.0, ""
    claims = [c for c in context.feeds if c.segment.kind == MILL]
    for claim in claims:
        index = context.setup_of(claim)
        arm = _arm(milling, index, claim)
        track = milling.track(index, arm, (claim.segment.key,)) if arm else None
        if track is None or not len(track.joined):
            continue
        time = np.diff(motion.time[track.rows])
        speed = np.linalg.norm(np.diff(track.tip, axis=0), axis=1) / np.maximum(time, 1e-6)
        speed = np.where(track.joined, speed, 0.0)
        there = _there(milling, index, claim.segment, len(speed) + 1)
        there = np.minimum(there, rules_mill_flank.feed(milling, index, claim.segment, len(speed) + 1))
        limit = np.minimum(there, claim.upper)
        share = speed / limit
        if share.max() > worst:
            worst, where = float(share.max()), str(claim.segment)
        bad = np.flatnonzero(share > FEED_SLACK)
        for k in bad[:: max(1, len(bad) // SHOWN)]:
            what = f"the tip moves at {mm(speed[k]):.2f} mm/s in {claim.segment}; "
            what += f"allowed there: {mm(limit[k]):g}"
            measure = (mm(float(speed[k])), mm(float(limit[k])), "mm/s")
            issues.append(at_sample("verify.mill_feed", what, motion, arm, int(track.rows[k + 1]), measure))
    fed = {claim.segment.key for claim in claims}
    lacks = sorted(label for label in _labels(context) if label not in fed)
    issues += [Issue("verify.mill_feed", f"{label} has no feed", field=label) for label in lacks]
    return Outcome(tuple(issues), worst or None, FEED_SLACK if worst else None, "of the feed", where or NONE)


def _there(milling: Milling, index: int, segment: Segment, count: int) -> FloatArray:
    """The feed (T - 1,) [m/s] from each of T samples of a segment to the next, by the way that is claimed of
    it; without bounds where none is."""
    out = np.full(count - 1, np.inf)
    for setup, claim in milling.curves:
        if setup != index or claim.segment.key != segment.key or len(claim.feed) < 2:
            continue
        known = milling.followed(index, claim)
        if known is not None:
            out = np.minimum(out, allowed(claim, known[0], known[1], count))
    return out


def spindle(context: Context, milling: Milling) -> Outcome:
    """The cutter is in the block only while its spindle has been on for long enough, and on segments that
    mill."""
    motion = context.motion
    issues: list[Issue] = []
    seen = False
    for index, setup in enumerate(context.setups):
        claims = [c for c in context.setup_claims[index].contacts if MILL in c.kinds]
        for arm in setup.cell.arms:
            if not isinstance(arm.tool, Mill) or arm.name not in motion.tcp:
                continue
            cutter = arm.tool.cutter
            labels = tuple(sorted(set(motion.node_label.tolist())))
            track = milling.track(index, arm.name, labels)
            inside = np.flatnonzero(in_block(track, cutter.overhang, cutter.radius, context.stock(index)))
            if not len(inside):
                continue
            seen = True
            stray = inside[motion.node_kind[motion.node[track.rows[inside]]] != MILL]
            for i in stray[:1]:
                what = f"the cutter is in the block in {track.label[i]}, where nothing is milled"
                issues.append(at_sample("verify.spindle", what, motion, arm.name, int(track.rows[i])))
            if not claims:
                what = f"{arm.name} mills in setup {index + 1}, which claims no spindle"
                issues.append(at_sample("verify.spindle", what, motion, arm.name, int(track.rows[inside[0]])))
            for claim in claims:
                on = _on_for(context, claim.signal, motion.time[track.rows[inside]])
                for i in np.flatnonzero(on < claim.heat_up - 1e-6)[:1]:
                    got = f"for {on[i]:.1f} s" if on[i] >= 0.0 else "not"
                    what = f"the cutter is in the block and {claim.signal} is {got} on; wanted: "
                    what += f"{claim.heat_up:g} s"
                    measure = (float(max(on[i], 0.0)), claim.heat_up, "s")
                    row = int(track.rows[inside[i]])
                    issues.append(at_sample("verify.spindle", what, motion, arm.name, row, measure))
    return Outcome(tuple(issues), where="" if seen else NONE)


def _on_for(context: Context, signal: str, time: FloatArray) -> FloatArray:
    """How long (T,) [s] a signal has been on at some times; -1 where it is off."""
    steps = [
        (at, step.value)
        for at, _, _, step in context.motion.step_time
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower()
    ]
    steps.sort(key=lambda item: item[0])
    out = np.full(len(time), -1.0)
    since = None
    for k, (at, value) in enumerate(steps):
        since = (at if since is None else since) if value else None
        until = steps[k + 1][0] if k + 1 < len(steps) else np.inf
        if since is not None:
            rows = (time >= at) & (time < until)
            out[rows] = time[rows] - since
    return out


def _arm(milling: Milling, index: int, claim: FeedWindow) -> str:
    """The arm that mills a segment in a setup, by the claims on it; empty for none."""
    segment = claim.segment.key
    for setup, own in milling.by_setup:
        names = (own.segment,) if isinstance(own, MillsAlong) else own.segments
        if setup == index and any(segment == way.key for name in names for way in name.ways):
            return own.arm
    return ""


def _labels(context: Context) -> set[str]:
    return {str(segment) for segment in context.motion.node_segment if segment.kind == MILL}
