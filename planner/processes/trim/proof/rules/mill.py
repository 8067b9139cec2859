"""Rules on sheets that a mill trims, and what of them holds of a knife, too.

verify.trim_mill: how deep the cutter is, how it leans, where and how fast it goes into the sheet, that it
comes straight out again, and what it cuts beside its slot. verify.trim_spindle: up to speed, and in slots,
wherever it is in the sheet, also of a knife.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, IntArray
from planner.geometry.swept_body import least_distances, places_near
from planner.issues import Issue
from planner.processes.trim.claims import TrimCutter, TrimsSheet
from planner.processes.trim.proof.outlines import TRIM, Curve
from planner.processes.trim.proof.rules.slots import ANGLE_ERROR, ISSUES_SHOWN, NOTHING_TRIMMED, every
from planner.processes.trim.proof.torch_motion import (
    PLACE_ERROR,
    TRIMMING,
    Trimming,
    TrimWork,
    Way,
    behind,
    cylinder,
)
from planner.proof.context import Context
from planner.proof.rule import FEED_SLACK, Outcome, at_sample, mm, rule

MILL, SPINDLE = "verify.trim_mill", "verify.trim_spindle"
"""Codes of the rules."""
PLACES_AT_ONCE = 1000
"""Places of a way, ``PLACE_STEP`` apart, at which the cutter is held against the part together,"""
PART_SPACING = 0.3e-3
"""against places of both faces that are no farther from one another than this [m],"""
MOST_PLACES = 1_000_000
"""and at most so many."""
DEEPER_SHARE = 0.5
"""Chords, rounded corners and facets may take it deeper by this part of the tolerances, and of its depth."""
START_SHARE = 0.5
"""Its way into the sheet begins no lower than this part of its height over the sheet."""


@rule("verify.trim_mill", TrimsSheet)
def trim_mill(context: Context) -> Outcome:
    """Along its outline the tip of a mill is through the sheet as far as wanted, and the cutter leans no
    farther than its cone; it goes into the waste, far enough off all curves, no faster than it may, comes out
    along its axis, and cuts nothing of the part where that is bent."""
    trimming = context.get(TRIMMING)
    issues: list[Issue] = []
    worst, where = -np.inf, ""
    for work, curve, key, way in every(trimming):
        own = work.claim.mill
        if own is None:
            continue
        for value, some in (
            depth(context, work, MILL, key, way, way.off <= 0.5 * work.claim.kerf + work.near),
            leans(context, work, MILL, key, way),
            _entry(context, work, own, key, way),
            leaves(context, work, MILL, key),
            _beside(context, work, curve, own, key, way),
        ):
            issues += some
            if value > worst:
                worst, where = value, key
    issues += _dies(context, trimming)
    if not where:
        return Outcome(tuple(issues), nothing=NOTHING_TRIMMED)
    return Outcome(tuple(issues), 100.0 * worst, 100.0, "% of what is allowed", where)


Found = tuple[float, list[Issue]]
"""The worst share of what is allowed, and what is beyond it."""


def told(context: Context, work: TrimWork, code: str, key: str, what: str, row: int) -> Issue:
    """An issue of a slot at a sample of the motion."""
    return at_sample(code, f"in {key} {what}", context.motion, work.claim.arm, row)


def _word(work: TrimWork) -> str:
    return "cutter" if work.claim.knife is None else "knife"


def some_of(bad: IntArray) -> list[int]:
    """Some of the rows, ``ISSUES_SHOWN`` about."""
    return [int(k) for k in bad[:: max(1, len(bad) // ISSUES_SHOWN)]]


def depth(context: Context, work: TrimWork, code: str, key: str, way: Way, cuts: BoolArray) -> Found:
    """Where it ``cuts`` (N,), through the far face by what is wanted at least, and nowhere deeper than a
    sheet of its whole thickness wants it."""
    claim, own = work.claim, work.claim.through
    if own is None:
        return 0.0, []
    near = claim.height + work.sheet.tolerance + PLACE_ERROR
    through = behind(work.other, way.tip, way.axis)
    high = np.where(cuts, own.below - through, 0.0) / near
    low = (way.deep - claim.thickness - own.below) / near
    out = []
    for k in some_of(np.flatnonzero(np.maximum(high, low) > 1.0)):
        what = (
            f"the tip is {mm(float(through[k])):.2f} mm through the sheet, {mm(float(way.deep[k])):.2f} mm "
        )
        what += f"behind its face; wanted: {mm(own.below):g} mm through it within {mm(claim.height):g}"
        out.append(told(context, work, code, key, what, int(way.rows[k])))
    return float(max(high.max(), low.max())), out


def leans(context: Context, work: TrimWork, code: str, key: str, way: Way) -> Found:
    """No farther off the sheet's normal than its cone."""
    lean = np.arccos(np.clip((way.axis * way.feet.normal).sum(axis=1), -1.0, 1.0))
    share = lean / (work.claim.cone + ANGLE_ERROR + work.sheet.turn)
    out = []
    for k in some_of(np.flatnonzero(share > 1.0)):
        what = f"the {_word(work)} leans {np.rad2deg(lean[k]):.1f} deg off the sheet's normal; allowed: "
        what += f"{np.rad2deg(work.claim.cone):g} deg"
        out.append(told(context, work, code, key, what, int(way.rows[k])))
    return float(share.max()), out


def _entry(context: Context, work: TrimWork, own: TrimCutter, key: str, way: Way) -> Found:
    """It begins over the sheet, in the waste, off all curves, and goes down no faster than it may; a ramp
    ends before the outline."""
    claim, out = work.claim, list[Issue]()
    foot = way.feet.foot[:1]
    off = np.array([float(curve.off(foot)[0][0]) for curve in work.curves])
    waste = any(bool(curve.in_waste(foot)[0]) for curve in work.curves)
    least = claim.pierce_off - work.sheet.tolerance - PLACE_ERROR
    if not waste or off.min() < least:
        what = f"the cutter goes into the sheet {'in the part, ' if not waste else ''}"
        what += (
            f"{mm(float(off.min())):.2f} mm off {work.curves[int(off.argmin())].one.name}; wanted: in the "
        )
        what += f"waste, {mm(claim.pierce_off):g} mm off"
        out.append(told(context, work, MILL, key, what, int(way.rows[0])))
    share, found = goes_down(context, work, MILL, key, way)
    out += found
    if not own.ramp:
        out += straight_down(context, work, MILL, key, way)
    return share, out


def goes_down(context: Context, work: TrimWork, code: str, key: str, way: Way) -> Found:
    """It begins over the sheet, and goes down no faster than it may."""
    claim, own, out = work.claim, work.claim.through, list[Issue]()
    if own is None:
        return 0.0, out
    if way.deep[0] > -own.start + min(claim.height + work.sheet.tolerance, START_SHARE * own.start):
        what = f"the way into the sheet begins {mm(-float(way.deep[0])):.2f} mm over it; wanted: "
        what += f"{mm(own.start):g} mm"
        if way.deep[0] > PLACE_ERROR:
            what = (
                f"the {_word(work)} is {mm(float(way.deep[0])):.2f} mm in the sheet at its beginning: it was "
            )
            what += f"not lifted out before; wanted: {mm(own.start):g} mm over the sheet"
        out.append(told(context, work, code, key, what, int(way.rows[0])))
    share = 0.0
    track = work.of_slot(key)
    deep = work.feet(track.tip, track.axis)[1]
    jitter = DEEPER_SHARE * min(claim.tolerance, claim.height, claim.thickness + own.below)
    jitter += work.sheet.tolerance + PLACE_ERROR
    for run in np.split(np.arange(len(deep)), np.flatnonzero(~track.joined) + 1):
        # how deep it would be at most had it gone down no faster than it may from anywhere before
        gained = deep[run] - FEED_SLACK * own.plunge * track.time[run]
        ahead = gained - np.minimum.accumulate(gained)
        share = max(share, float(ahead.max(initial=0.0)) / jitter)
        for k in some_of(np.flatnonzero(ahead > jitter)):
            what = (
                f"the {_word(work)} is {mm(float(ahead[k])):.2f} mm deeper than at {mm(own.plunge):g} mm/s; "
            )
            what += f"allowed: {mm(jitter):.2f} mm"
            out.append(told(context, work, code, key, what, int(track.rows[run[k]])))
    return share, out


def straight_down(context: Context, work: TrimWork, code: str, key: str, way: Way) -> Iterator[Issue]:
    """It goes nowhere before it is through the sheet."""
    claim = work.claim
    gone = np.linalg.norm(way.feet.foot - way.feet.foot[:1], axis=1)
    early = np.flatnonzero((gone > claim.tolerance) & (way.deep < claim.thickness - work.sheet.tolerance))
    for k in early[:1]:
        what = f"the {_word(work)} goes aside before it is through the sheet; wanted: straight down"
        yield told(context, work, code, key, what, int(way.rows[k]))


def leaves(context: Context, work: TrimWork, code: str, key: str) -> Found:
    """On the way in the tool is over the sheet, and the way out is along its axis until it is."""
    claim, through, out, worst = work.claim, work.claim.through, list[Issue](), 0.0
    if through is None:
        return worst, out
    own = Segment(TRIM, key.split("/", 1)[1])
    for phase in ("in", "out"):
        track = work.of_slot(own.at(phase).key)
        if not len(track.rows):
            continue
        feet, deep = work.feet(track.tip, track.axis)
        within = np.flatnonzero(deep > (0.0 if phase == "out" else PLACE_ERROR))
        if phase == "in":
            for k in within[:1]:
                what = f"the {_word(work)} comes down {mm(float(deep[k])):.2f} mm into the sheet on its way "
                what += "to it"
                out.append(told(context, work, code, key, what, int(track.rows[k])))
            continue
        most = claim.thickness + through.below + claim.height + work.sheet.tolerance + PLACE_ERROR
        for k in np.flatnonzero(deep > most)[:1]:
            what = f"the {_word(work)} is {mm(float(deep[k])):.2f} mm behind the face; allowed: "
            what += f"{mm(most):.2f} mm"
            out.append(told(context, work, code, key, what, int(track.rows[k])))
        aside = np.linalg.norm(feet.foot - feet.foot[0], axis=1)[within]
        worst = float(aside.max(initial=0.0)) / (claim.tolerance + PLACE_ERROR)
        for k in within[aside > claim.tolerance + PLACE_ERROR][:1]:
            what = f"the {_word(work)} goes aside before it is out of the sheet"
            out.append(told(context, work, code, key, what, int(track.rows[k])))
    return worst, out


def _beside(context: Context, work: TrimWork, curve: Curve, own: TrimCutter, key: str, way: Way) -> Found:
    """What of the part is in the flute where the sheet is bent: on both faces, farther from the outline than
    its edge may be. The far face is the near one moved along z, so that its edge is off by the thickness."""
    claim, cutter = work.claim, own.cutter
    out, worst, allowed = list[Issue](), 0.0, work.near
    flute = cylinder(0.0, cutter.flute, cutter.radius)
    corners = work.sheet.vertices[work.sheet.faces]
    drop = np.array([0.0, 0.0, claim.side * claim.thickness])
    for first in range(0, len(way.tip), PLACES_AT_ONCE):
        tip, axis = (row[first : first + PLACES_AT_ONCE] for row in (way.tip, way.axis))
        near, _, count = places_near(corners, tip, axis, flute, claim.thickness, PART_SPACING, MOST_PLACES)
        if count > MOST_PLACES:
            what = f"the sheet would have to be looked at in {count} places; {MOST_PLACES} may be"
            return np.inf, [told(context, work, MILL, key, what, int(way.rows[first]))]
        part = near[~curve.in_waste(near)] if len(near) else near
        if not len(part):
            continue
        off = curve.off(part)[0]
        both, over = np.concatenate([part, part - drop]), np.concatenate([off, off - claim.thickness])
        inside, where = least_distances(both, tip, axis, flute, PART_SPACING)
        most = np.where(inside < 0.0, over, 0.0)
        worst = max(worst, float(most.max()) / allowed)
        for k in some_of(np.flatnonzero(most > allowed)):
            what = f"the cutter goes {mm(float(most[k])):.2f} mm over the outline into the part; allowed: "
            what += f"{mm(allowed):.2f} mm"
            out.append(told(context, work, MILL, key, what, int(way.rows[first + where[k]])))
    return worst, out[:ISSUES_SHOWN]


def _dies(context: Context, trimming: Trimming) -> Iterator[Issue]:
    """Nothing says that a die was taken out from under the sheet."""
    said = context.problem.source.get("operations") or ()
    dies = [one for one in said if isinstance(one, dict) and one.get("die")]
    for work in trimming.works:
        if work.claim.through is not None and dies:
            what = f"{dies[0].get('name')} has a die behind the sheet, into which the {_word(work)} would go"
            yield Issue(MILL, what, arm=work.claim.arm)


@rule("verify.trim_spindle", TrimsSheet)
def trim_spindle(context: Context) -> Outcome:
    """A mill or a knife is in the sheet only in its slots and on its ways out of them, and only while its
    spindle or drive, if it has one, has been on for long enough."""
    trimming = context.get(TRIMMING)
    issues: list[Issue] = []
    count = 0
    for work in trimming.works:
        claim, own, motion = work.claim, work.claim.through, context.motion
        if own is None:
            continue
        track = work.track
        size = 0.5 * np.asarray(context.stock(work.index).size)[:2] + claim.kerf
        over = (np.abs(track.tip[:, :2]) <= size).all(axis=1)
        rows = np.flatnonzero(over)
        height = work.sheet.feet(track.tip[rows]).height
        rows = rows[height < 0.5 * own.start]
        count += len(work.slots)
        good = set(work.slots) | {Segment(TRIM, key.split("/", 1)[1]).at("out").key for key in work.slots}
        for i in rows[~np.isin(track.label[rows], list(good))][:1]:
            what = (
                f"the {_word(work)} is in the sheet, or just over it, in {track.label[i]}, where nothing is "
            )
            what += "cut"
            issues.append(at_sample(SPINDLE, what, motion, claim.arm, int(track.rows[i])))
        if not claim.signal:
            continue
        on = motion.on_for(claim.signal, context.switching((claim.arm,)), track.time[rows])
        for i in np.flatnonzero(on < own.spin_up - 1e-6)[:1]:
            got = f"for {on[i]:.1f} s" if on[i] >= 0.0 else "not"
            what = (
                f"the {_word(work)} is in the sheet and {claim.signal} is {got} on; wanted: {own.spin_up:g} s"
            )
            measure = (float(max(on[i], 0.0)), own.spin_up, "s")
            row = int(track.rows[rows[i]])
            issues.append(at_sample(SPINDLE, what, motion, claim.arm, row, measure))
    return Outcome(tuple(issues), where=f"{count} slots", nothing="" if count else NOTHING_TRIMMED)
