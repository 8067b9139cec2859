"""Rules on sheets that a mill trims, and what of them holds of a knife, too.

verify.trim_mill: how deep the cutter is, how it leans, where and how fast it goes into the sheet, that it
comes straight out again, and what it cuts beside its slot. verify.trim_spindle: up to speed, and in slots,
wherever it is in the sheet, also of a knife.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray
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
from planner.proof.findings import Findings, evenly, percent
from planner.proof.rule import FEED_SLACK, Outcome, mm, rule

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
    trimming, findings = context.get(TRIMMING), Findings(MILL, context)
    for work, curve, key, way in every(trimming):
        own = work.claim.mill
        if own is None:
            continue
        slot = MeasuredCut(findings, work, key, way)
        depth(slot, way.off <= 0.5 * work.claim.kerf + work.near)
        leans(slot)
        _entry(slot, own)
        leaves(slot)
        _beside(slot, curve, own)
    findings.issues += _dies(context, trimming)
    return findings.outcome(percent, "% of what is allowed", 1.0, nothing=NOTHING_TRIMMED)


@dataclasses.dataclass(frozen=True)
class MeasuredCut:
    """A slot that a tool cut.

    Attributes:
        findings: What the rule finds in it.
        work: The operation.
        key: Name of the segment.
        way: The path of the tool in it.
    """

    findings: Findings
    work: TrimWork
    key: str
    way: Way

    def add(self, what: str, row: int) -> None:
        """Add an issue at a sample of the motion."""
        self.findings.at_sample(f"in {self.key} {what}", self.work.claim.arm, row)

    def note(self, value: float) -> None:
        """Note a measured value as a fraction of what is allowed."""
        self.findings.highest(value, self.key)


def _word(work: TrimWork) -> str:
    return "cutter" if work.claim.knife is None else "knife"


def depth(slot: MeasuredCut, cuts: BoolArray) -> None:
    """Where it ``cuts`` (N,), through the far face by what is wanted at least, and nowhere deeper than a
    sheet of its whole thickness wants it."""
    work, way, claim, own = slot.work, slot.way, slot.work.claim, slot.work.claim.through
    if own is None:
        return
    near = claim.height + work.sheet.tolerance + PLACE_ERROR
    through = behind(work.other, way.tip, way.axis)
    high = np.where(cuts, own.below - through, 0.0) / near
    low = (way.deep - claim.thickness - own.below) / near
    for k in evenly(np.maximum(high, low) > 1.0, ISSUES_SHOWN):
        what = (
            f"the tip is {mm(float(through[k])):.2f} mm through the sheet, {mm(float(way.deep[k])):.2f} mm "
            f"behind its face; wanted: {mm(own.below):g} mm through it within {mm(claim.height):g}"
        )
        slot.add(what, way.rows[k])
    slot.note(max(high.max(), low.max()))


def leans(slot: MeasuredCut) -> None:
    """No farther off the sheet's normal than its cone."""
    work, way = slot.work, slot.way
    lean = np.arccos(np.clip((way.axis * way.feet.normal).sum(axis=1), -1.0, 1.0))
    share = lean / (work.claim.cone + ANGLE_ERROR + work.sheet.turn)
    for k in evenly(share > 1.0, ISSUES_SHOWN):
        what = f"the {_word(work)} leans {np.rad2deg(lean[k]):.1f} deg off the sheet's normal; allowed: "
        slot.add(f"{what}{np.rad2deg(work.claim.cone):g} deg", way.rows[k])
    slot.note(share.max())


def _entry(slot: MeasuredCut, own: TrimCutter) -> None:
    """It begins over the sheet, in the waste, off all curves, and goes down no faster than it may; a ramp
    ends before the outline."""
    work, claim = slot.work, slot.work.claim
    foot = slot.way.feet.foot[:1]
    off = np.array([float(curve.off(foot)[0][0]) for curve in work.curves])
    waste = any(bool(curve.in_waste(foot)[0]) for curve in work.curves)
    least = claim.pierce_off - work.sheet.tolerance - PLACE_ERROR
    if not waste or off.min() < least:
        what = (
            f"the cutter goes into the sheet {'in the part, ' if not waste else ''}"
            f"{mm(float(off.min())):.2f} mm off {work.curves[int(off.argmin())].one.name}; wanted: in the "
            f"waste, {mm(claim.pierce_off):g} mm off"
        )
        slot.add(what, slot.way.rows[0])
    goes_down(slot)
    if not own.ramp:
        straight_down(slot)


def goes_down(slot: MeasuredCut) -> None:
    """It begins over the sheet, and goes down no faster than it may."""
    work, way, claim, own = slot.work, slot.way, slot.work.claim, slot.work.claim.through
    if own is None:
        return
    if way.deep[0] > -own.start + min(claim.height + work.sheet.tolerance, START_SHARE * own.start):
        what = f"the way into the sheet begins {mm(-float(way.deep[0])):.2f} mm over it; wanted: "
        what += f"{mm(own.start):g} mm"
        if way.deep[0] > PLACE_ERROR:
            what = (
                f"the {_word(work)} is {mm(float(way.deep[0])):.2f} mm in the sheet at its beginning: it was "
                f"not lifted out before; wanted: {mm(own.start):g} mm over the sheet"
            )
        slot.add(what, way.rows[0])
    share = 0.0
    track = work.of_slot(slot.key)
    deep = work.feet(track.tip, track.axis)[1]
    jitter = DEEPER_SHARE * min(claim.tolerance, claim.height, claim.thickness + own.below)
    jitter += work.sheet.tolerance + PLACE_ERROR
    for run in np.split(np.arange(len(deep)), np.flatnonzero(~track.joined) + 1):
        # how deep it would be at most had it gone down no faster than it may from anywhere before
        gained = deep[run] - FEED_SLACK * own.plunge * track.time[run]
        ahead = gained - np.minimum.accumulate(gained)
        share = max(share, float(ahead.max(initial=0.0)) / jitter)
        for k in evenly(ahead > jitter, ISSUES_SHOWN):
            what = (
                f"the {_word(work)} is {mm(float(ahead[k])):.2f} mm deeper than at {mm(own.plunge):g} mm/s; "
                f"allowed: {mm(jitter):.2f} mm"
            )
            slot.add(what, track.rows[run[k]])
    slot.note(share)


def straight_down(slot: MeasuredCut) -> None:
    """It goes nowhere before it is through the sheet."""
    way, claim = slot.way, slot.work.claim
    gone = np.linalg.norm(way.feet.foot - way.feet.foot[:1], axis=1)
    through = claim.thickness - slot.work.sheet.tolerance
    for k in np.flatnonzero((gone > claim.tolerance) & (way.deep < through))[:1]:
        what = f"the {_word(slot.work)} goes aside before it is through the sheet; wanted: straight down"
        slot.add(what, way.rows[k])


def leaves(slot: MeasuredCut) -> None:
    """On the way in the tool is over the sheet, and the way out is along its axis until it is."""
    work, claim, through, worst = slot.work, slot.work.claim, slot.work.claim.through, 0.0
    if through is None:
        return
    own = Segment(TRIM, slot.key.split("/", 1)[1])
    for phase in ("in", "out"):
        track = work.of_slot(own.at(phase).key)
        if not len(track.rows):
            continue
        feet, deep = work.feet(track.tip, track.axis)
        within = np.flatnonzero(deep > (0.0 if phase == "out" else PLACE_ERROR))
        if phase == "in":
            for k in within[:1]:
                what = f"the {_word(work)} comes down {mm(float(deep[k])):.2f} mm into the sheet on its way "
                slot.add(f"{what}to it", track.rows[k])
            continue
        most = claim.thickness + through.below + claim.height + work.sheet.tolerance + PLACE_ERROR
        for k in np.flatnonzero(deep > most)[:1]:
            what = f"the {_word(work)} is {mm(float(deep[k])):.2f} mm behind the face; allowed: "
            slot.add(f"{what}{mm(most):.2f} mm", track.rows[k])
        aside = np.linalg.norm(feet.foot - feet.foot[0], axis=1)[within]
        worst = float(aside.max(initial=0.0)) / (claim.tolerance + PLACE_ERROR)
        for k in within[aside > claim.tolerance + PLACE_ERROR][:1]:
            slot.add(f"the {_word(work)} goes aside before it is out of the sheet", track.rows[k])
    slot.note(worst)


def _beside(slot: MeasuredCut, curve: Curve, own: TrimCutter) -> None:
    """What of the part is in the flute where the sheet is bent: on both faces, farther from the outline than
    its edge may be. The far face is the near one moved along z, so that its edge is off by the thickness."""
    work, way, claim, cutter = slot.work, slot.way, slot.work.claim, own.cutter
    worst, allowed = 0.0, work.near
    flute = cylinder(0.0, cutter.flute, cutter.radius)
    corners = work.sheet.vertices[work.sheet.faces]
    drop = np.array([0.0, 0.0, claim.side * claim.thickness])
    out: list[tuple[str, int]] = []
    for first in range(0, len(way.tip), PLACES_AT_ONCE):
        tip, axis = (row[first : first + PLACES_AT_ONCE] for row in (way.tip, way.axis))
        near, _, count = places_near(corners, tip, axis, flute, claim.thickness, PART_SPACING, MOST_PLACES)
        if count > MOST_PLACES:
            what = f"the sheet would have to be looked at in {count} places; {MOST_PLACES} may be"
            worst, out = np.inf, [(what, way.rows[first])]
            break
        part = near[~curve.in_waste(near)] if len(near) else near
        if not len(part):
            continue
        off = curve.off(part)[0]
        both, over = np.concatenate([part, part - drop]), np.concatenate([off, off - claim.thickness])
        inside, where = least_distances(both, tip, axis, flute, PART_SPACING)
        most = np.where(inside < 0.0, over, 0.0)
        worst = max(worst, float(most.max()) / allowed)
        for k in evenly(most > allowed, ISSUES_SHOWN):
            what = f"the cutter goes {mm(float(most[k])):.2f} mm over the outline into the part; allowed: "
            out.append((f"{what}{mm(allowed):.2f} mm", way.rows[first + where[k]]))
    for what, row in out[:ISSUES_SHOWN]:
        slot.add(what, row)
    slot.note(worst)


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
    trimming, findings = context.get(TRIMMING), Findings(SPINDLE, context)
    count = 0
    for work in trimming.works:
        claim, own = work.claim, work.claim.through
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
            what = f"the {_word(work)} is in the sheet, or just over it, in {track.label[i]}, where nothing "
            findings.at_sample(f"{what}is cut", claim.arm, track.rows[i])
        if not claim.signal:
            continue
        on = context.motion.on_for(claim.signal, context.switching((claim.arm,)), track.time[rows])
        for i in np.flatnonzero(on < own.spin_up - 1e-6)[:1]:
            got = f"for {on[i]:.1f} s" if on[i] >= 0.0 else "not"
            what = (
                f"the {_word(work)} is in the sheet and {claim.signal} is {got} on; wanted: {own.spin_up:g} s"
            )
            measure = (float(max(on[i], 0.0)), own.spin_up, "s")
            findings.at_sample(what, claim.arm, track.rows[rows[i]], measure)
    return findings.outcome_without_value("" if count else NOTHING_TRIMMED, f"{count} slots")
