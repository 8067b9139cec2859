"""Rules on cutters that pass ruled surfaces with their sides: the issues that make part of
``verify.mill_path``, and the feeds of their ways in and out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner.claims_milling import MillsFlank
from planner.issues import Issue
from planner.segments import Phase, Segment
from planner.verify import mill_flank
from planner.verify.context import Context, mm
from planner.verify.findings import at_sample
from planner.verify.mill_flank import Way
from planner.verify.mill_follow import looks
from planner.verify.mill_track import Milling, Track, in_block

FloatArray = NDArray[np.float64]

CODE = "verify.mill_path"
SHOWN = 50


def flanks(context: Context, milling: Milling) -> tuple[list[Issue], float, str]:
    """Issues of all passes along ruled surfaces, and the worst of what is allowed, with its segment."""
    issues: list[Issue] = []
    worst, where = 0.0, ""
    for index, claim in milling.flanks:
        for number, segment in enumerate(claim.segments):
            track = milling.track(index, claim.arm, (segment.key,))
            if len(track.rows) < 2:
                issues.append(Issue(CODE, f"{segment} is not milled", field=str(segment)))
                continue
            some = looks(track.tip, track.axis, claim.tolerance)
            found = mill_flank.passed(claim, number, track.tip[some], track.axis[some])
            if found.off.max() > worst:
                worst, where = float(found.off.max()), str(segment)
            issues += [Issue(CODE, f"{segment}: {fault}", field=str(segment)) for fault in found.faults]
            bad = np.flatnonzero(found.off > 1.0)
            for i in bad[:: max(1, len(bad) // SHOWN)]:
                what = f"in {segment} the cutter is {found.worst[i]}, {found.off[i]:.2f} times as far as "
                what += f"allowed, {mm(claim.tolerance):g} mm"
                row = int(track.rows[some[i]])
                issues.append(at_sample(CODE, what, context.motion, claim.arm, row))
            for phase, _ in _fast(claim):
                issues += _way(context, milling, index, claim, number, phase)
    return issues, worst, where


def _way(
    context: Context, milling: Milling, index: int, claim: MillsFlank, number: int, phase: Phase
) -> Iterator[Issue]:
    """Issues of one way in or out."""
    segment = claim.segments[number].at(phase)
    known = _known(milling, index, claim, number, phase)
    if known is None:
        yield Issue(CODE, f"{segment} is not there", field=str(segment))
        return
    track, rows, found = known
    yield from (Issue(CODE, f"{segment}: {fault}", field=str(segment)) for fault in found.faults)
    bad = np.flatnonzero(found.off > 1.0)
    for i in bad[:: max(1, len(bad) // SHOWN)]:
        what = f"in {segment} the tip is neither on the straight going on of its pass nor on its way up "
        what += f"along the axis: {found.off[i]:.2f} times as far off as allowed"
        yield at_sample(CODE, what, context.motion, claim.arm, int(track.rows[rows[i]]))
    if claim.lead is None:
        own = context.stock(index)
        inside = in_block(track, claim.cutter.overhang, claim.cutter.radius, own)[rows]
        for i in np.flatnonzero(inside & found.up & ~found.aside)[:1]:
            what = (
                f"in {segment} the cutter comes into the block along its axis; it is to come from beside it"
            )
            yield at_sample(CODE, what, context.motion, claim.arm, int(track.rows[rows[i]]))


def _known(
    milling: Milling, index: int, claim: MillsFlank, number: int, phase: Phase
) -> tuple[Track, NDArray[np.int64], Way] | None:
    """The track of a way in or out, its rows away from the pass, and how it keeps to what is asked."""
    segment = claim.segments[number]
    main = milling.track(index, claim.arm, (segment.key,))
    track = milling.track(index, claim.arm, (segment.at(phase).key,))
    if len(main.rows) < 2 or len(track.rows) < 2:
        return None
    back = slice(None, None, -1)
    order = slice(None) if phase == "in" else back
    tip, axis = main.tip[order], main.axis[order]
    on = int(np.argmax(np.append(np.linalg.norm(tip[1:] - tip[0], axis=1) > mill_flank.CHORD, True))) + 1
    pair = [0, min(on, len(tip) - 1)]
    rows = np.arange(len(track.rows))[back if phase == "in" else slice(None)]
    return (
        track,
        rows,
        mill_flank.ways(claim, number, (tip[pair], axis[pair]), track.tip[rows], track.axis[rows]),
    )


def feed(milling: Milling, index: int, segment: Segment, count: int) -> FloatArray:
    """The feed (T - 1,) [m/s] from each of T samples of a way in or out to the next; without bounds where the
    segment is none."""
    out = np.full(count - 1, np.inf)
    for setup, claim in milling.flanks:
        for number, own in enumerate(claim.segments):
            for phase, fast in _fast(claim):
                if setup != index or segment.key != own.at(phase).key:
                    continue
                known = _known(milling, index, claim, number, phase)
                if known is None:
                    continue
                _, rows, way = known
                limit = np.empty(count)
                limit[rows] = np.where(way.up, np.where(way.aside, max(claim.feed, fast), fast), claim.feed)
                out = np.maximum(limit[1:], limit[:-1])
    return out


def _fast(claim: MillsFlank) -> tuple[tuple[Phase, float], ...]:
    """How fast [m/s] a tool may be along its axis on its way in and out."""
    return (("in", claim.safe.plunge), ("out", claim.safe.rapid))
