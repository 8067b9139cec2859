"""Rules on trimmed sheets: what is cut and what stays, a torch and its arc, order, feed and room.

verify.trim_cut: each outline is cut, closed but for its joints, by a knife through both faces.
verify.trim_kept: nothing is cut off the part. verify.trim_torch: stand-off and lean. verify.trim_arc:
when it burns. verify.trim_order, trim_feed, trim_clear.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.issues import Issue
from planner.processes.trim.claims import TrimBlade, TrimsSheet, slot_names
from planner.processes.trim.proof.blade_motion import CORNER_ERROR, blade_way, sharp
from planner.processes.trim.proof.outlines import TRIM, Curve, winding
from planner.processes.trim.proof.rules.arc_waits import (
    LEAST_STRETCH,
    LINGER,
    LINGER_KERFS,
    LINGER_TIME,
    WAIT_ROUNDING,
    unguarded,
    waits,
)
from planner.processes.trim.proof.torch_motion import (
    PLACE_ERROR,
    PLACE_STEP,
    STANDING,
    TRIMMING,
    Trimming,
    TrimWork,
    Way,
    begins,
    off_sheet,
)
from planner.proof.context import Context
from planner.proof.findings import Findings, coordinates, evenly, in_mm, percent
from planner.proof.part_files import UnreadError
from planner.proof.rule import FEED_SLACK, Outcome, issue, mm, rule
from planner.tooling import Knife, Mill, Torch

TRIM_CUT = "verify.trim_cut"
"""Code of the rule about outlines."""
NOTHING_TRIMMED = "nothing is trimmed"
"""Why rules about trimming have not run."""
ANGLE_ERROR = np.deg2rad(0.5)
"""What facets of a mesh may turn its normals by [rad]."""
AVERAGE_SLACK = 0.95
"""Share of the least average feed that is accepted, as ramps of the replay are those of no controller."""
SAME_PLACE = 1e-9
"""Places along a curve that are nearer [m] are one."""
FILLED_SHARE = 0.5
"""Places of a knife's cut are no farther apart than this part of what it may be off."""
LEAST_JOINT = 0.5
"""Share of its width that a micro-joint has at least."""
GOING_DOWN = 2.0
"""A mill that is higher by more than so many tolerances is still on its way down."""
SLOPE_DOWN = 0.1
"""and so is one that gets deeper by more than this share of its way."""
CLEAR_SHARE = 0.1
"""How much less than the wanted room is accepted between targets, as a share of it."""
ISSUES_SHOWN = 20
"""Issues of one slot at most."""


@rule("verify.trim_cut", TrimsSheet)
def trim_cut(context: Context) -> Outcome:
    """Each outline, as the proof reads it and the part once more, is cut all the way round with the slot's
    edge within the tolerance of it, but for as many micro-joints as wanted, as wide as wanted; nothing else
    is trimmed."""
    trimming, findings = context.get(TRIMMING), Findings(TRIM_CUT, context)
    findings.issues += trimming.issues
    findings.issues += (one for one in context.unread if one.code == TRIM_CUT)
    _unclaimed(findings, trimming)
    for work in trimming.works:
        for curve in work.curves:
            name, ways = curve.one.name, [way for way in work.ways(curve).values() if way is not None]
            if len(ways) < len(work.ways(curve)) or not ways:
                findings.add(f"a slot of {name} is not cut" if ways else f"{name} is not cut", field=name)
                continue
            if work.claim.knife is not None:
                left, found = _sliced(work, curve, work.claim.knife)
            else:
                left, found = _closed(work, curve, ways)
            findings.issues += found
            findings.highest(left, name, work.claim.tolerance + work.sheet.tolerance)
    if not findings.measured:
        return findings.outcome_without_value("" if findings.issues else NOTHING_TRIMMED)
    return findings.outcome(mm, "mm")


def _sliced(work: TrimWork, curve: Curve, own: TrimBlade) -> tuple[float, list[Issue]]:
    """The same of a knife, at both faces of the sheet. Past the end of a cut it goes on at the near face by
    what its edge slants within the sheet, and may by as much at the joints."""
    slant = float(own.blade.front(work.claim.thickness + own.below) - own.blade.front(own.below))
    worst, issues = 0.0, list[Issue]()
    for far in (True, False):
        cuts = [getattr(blade_way(work, own, key), "far" if far else "near") for key in work.ways(curve)]
        ways = [way for cut in cuts for way in cut.ways]
        if not ways:
            what = f"the knife is nowhere through the sheet along {curve.one.name}"
            return worst, [Issue(TRIM_CUT, what, field=curve.one.name)]
        left, found = _closed(work, curve, ways, slant if far else 0.0)
        worst, issues = max(worst, left), found
        if found:
            side = "at the far face of the sheet" if far else "at its near face"
            issues = [dataclasses.replace(one, message=f"{one.message} ({side})") for one in found]
            break
    return worst, issues


def _closed(work: TrimWork, curve: Curve, ways: list[Way], wider: float = 0.0) -> tuple[float, list[Issue]]:
    """How far [m] the slot's edge is off the outline where it is cut, and what is wrong with its joints,
    which may be ``wider`` [m] than wanted."""
    claim, one, half = work.claim, curve.one, 0.5 * work.claim.kerf
    near = work.near
    foot = np.concatenate([way.feet.foot for way in ways])
    off, at = (np.concatenate([getattr(way, name) for way in ways]) for name in ("off", "at"))
    on = np.abs(off - half) <= near
    apart = np.asarray(cKDTree(_filled(ways, half, near)).query(curve.ring)[0]) - half
    if not on.any():
        what = f"the slot is nowhere within {mm(claim.tolerance):g} mm of {one.name}, on the side that "
        what += f"drops; the nearest place of it is {mm(float(np.abs(off - half).min())):.2f} mm off"
        left = float(np.abs(apart[apart <= near]).max(initial=0.0))
        return left, [Issue(TRIM_CUT, what, field=one.name)]
    issues = []
    gaps = []
    held = np.zeros(len(curve.ring), dtype=bool)
    for first, last in uncut(curve, ways, half, near):
        before = foot[on][int(np.argmin((first + SAME_PLACE - at[on]) % curve.length))]
        behind = foot[on][int(np.argmin((at[on] - last + SAME_PLACE) % curve.length))]
        width = float(np.linalg.norm(behind - before)) - 2.0 * half
        if width > PLACE_ERROR:  # else its round ends meet
            gaps.append((first, last, width))
            held |= (curve.along - first) % curve.length < last - first
    bare = _runs((apart > near) & ~held)
    left = float(np.abs(apart[(apart <= near) & ~held]).max(initial=0.0))
    if bare or len(gaps) != one.joints:
        count = len(gaps) + len(bare)
        what = f"{one.name} is left uncut in {count} places, wanted: {one.joints}"
        if count:
            x, y, _ = curve.place(gaps[0][0] if gaps else float(curve.along[bare[0][0]])) / 1e-3
            what += f"; the first is at ({x:.1f}, {y:.1f}) mm"
        issues.append(issue(TRIM_CUT, what, (float(count), float(one.joints), None), field=one.name))
    for first, last, width in gaps if one.joints else ():
        x, y, _ = curve.place(first) / 1e-3
        said = f"the micro-joint of {one.name} at ({x:.1f}, {y:.1f}) mm"
        if not one.width - near <= width <= one.width + near + wider or width < LEAST_JOINT * one.width:
            what = f"{said} is {mm(width):.2f} mm wide; wanted: {mm(one.width):g} mm within "
            what += f"{mm(claim.tolerance):g}"
            issues.append(issue(TRIM_CUT, what, (mm(width), mm(one.width), None), field=one.name))
        if any(_passes(curve, way, first, last) for way in ways):
            what = f"{said} is cut off behind, in what drops, so that it holds nothing"
            issues.append(Issue(TRIM_CUT, what, field=one.name))
    return left, issues


def _filled(ways: list[Way], half: float, near: float) -> FloatArray:
    """The feet (M, 3) of ways; of a knife's, which have no width, with places between them, so that these do
    not seem to be off the curve that lie between two."""
    if half > 0.0:
        return np.concatenate([way.feet.foot for way in ways])
    out = []
    for way in ways:
        foot = way.feet.foot
        size = np.linalg.norm(np.diff(foot, axis=0), axis=1)
        count = np.where(size < 3.0 * PLACE_STEP, np.ceil(size / (FILLED_SHARE * near)), 1).astype(np.int64)
        row = np.repeat(np.arange(len(size)), np.maximum(count, 1))
        share = (np.arange(len(row)) - np.searchsorted(row, row)) / np.maximum(count, 1)[row]
        out += [foot[row] + share[:, None] * np.diff(foot, axis=0)[row], foot[-1:]]
    return np.concatenate(out)


def uncut(curve: Curve, ways: list[Way], half: float, near: float) -> list[tuple[float, float]]:
    """From where to where [m] along a closed curve no slot is ``half`` its width within ``near`` [m] off it.
    Between two places next to each other it goes on, also across an inner corner."""
    jump = 2.0 * np.sqrt((half + near) ** 2 - half**2) + 4.0 * PLACE_STEP
    begin, size = [np.zeros(0)], [np.zeros(0)]
    for way in ways:
        on = np.abs(way.off - half) <= near
        step = (np.diff(way.at) + 0.5 * curve.length) % curve.length - 0.5 * curve.length
        goes_on = np.linalg.norm(np.diff(way.feet.foot, axis=0), axis=1) < 3.0 * PLACE_STEP
        step = np.append(np.where(on[1:] & goes_on & (np.abs(step) <= jump), step, 0.0), 0.0)[on]
        begin.append((way.at[on] + np.minimum(step, 0.0)) % curve.length)
        size.append(np.abs(step))
    order = np.argsort(np.concatenate(begin), kind="stable")
    low, high = np.concatenate(begin)[order], (np.concatenate(begin) + np.concatenate(size))[order]
    if not len(low):
        return [(0.0, curve.length)]
    # three times round, of which the second one has all that goes over the end
    turns = curve.length * np.arange(3)[:, None]
    low, high = (low + turns).ravel(), np.maximum.accumulate((high + turns).ravel())
    ends = (high[:-1] >= curve.length) & (high[:-1] < 2.0 * curve.length) & (low[1:] > high[:-1] + SAME_PLACE)
    return [(float(a), float(b)) for a, b in zip(high[:-1][ends], low[1:][ends], strict=True)]


def _passes(curve: Curve, way: Way, first: float, last: float) -> bool:
    """Whether a slot goes past the middle of a joint from ``first`` to ``last`` [m] along its curve, however
    far off."""
    beside = (way.at - 0.5 * (first + last) + 0.5 * curve.length) % curve.length - 0.5 * curve.length
    there = np.abs(beside) < max(0.5 * (last - first), 2.0 * PLACE_STEP)
    return bool((there[1:] & there[:-1] & (beside[1:] * beside[:-1] <= 0.0)).any())


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """First and last places of runs of a closed row of flags."""
    rows = np.flatnonzero(flags)
    if not len(rows):
        return []
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    if len(groups) > 1 and groups[0][0] == 0 and groups[-1][-1] == len(flags) - 1:
        groups = [np.concatenate([groups[-1], groups[0]]), *groups[1:-1]]
    return [(int(group[0]), int(group[-1])) for group in groups]


def _unclaimed(findings: Findings, trimming: Trimming) -> None:
    """Segments that trim, of which nothing is claimed."""
    known = {
        Segment(TRIM, name).key
        for work in trimming.works
        for curve in work.curves
        for name in slot_names(work.claim, curve.one)
    }
    for segment in dict.fromkeys(findings.context.motion.node_segment):
        if segment.kind == TRIM and segment.at("").key not in known:
            what = f"the programs trim in {segment}, of which the problem claims nothing"
            findings.add(what, field=str(segment))


@rule("verify.trim_kept", TrimsSheet)
def trim_kept(context: Context) -> Outcome:
    """What must stay stays: the slot of a tool, with its pierce point and its ways in and out, lies in what
    its outline lets drop, and reaches no farther over the outline than the tolerance, of a knife also past
    sharp corners by what is stated."""
    findings = Findings("verify.trim_kept", context)
    for work, curve, key, way in every(context.get(TRIMMING)):
        near = work.near
        if work.claim.knife is not None:
            _sliced_off(findings, work, curve, work.claim.knife, key)
            continue
        deep = 0.5 * work.claim.kerf - way.off
        findings.highest(deep.max(), key, near)
        for i in evenly(deep > near, ISSUES_SHOWN):
            what = f"in {key} the slot is {mm(float(deep[i])):.2f} mm in the part, over {curve.one.name}, at "
            what += f"({coordinates(way.feet.foot[i])}) mm; allowed: {mm(near):.2f} mm"
            findings.at_sample(what, work.claim.arm, way.rows[i], in_mm(deep[i], near))
    return findings.outcome(mm, "mm", nothing=NOTHING_TRIMMED)


def _sliced_off(findings: Findings, work: TrimWork, curve: Curve, own: TrimBlade, key: str) -> None:
    """How far [m] a blade is in the part beside its curve, and where by more than the tolerance; past sharp
    corners it may by what is stated of them."""
    near, blade = work.near, blade_way(work, own, key)
    ends = sharp(work, curve, own.turns - CORNER_ERROR - work.sheet.turn)
    for cut, face in ((blade.near, "near"), (blade.far, "far")):
        deep = np.maximum(-cut.off, 0.0)
        past = ends.past(cut.foot, near)
        deep[past <= own.overcut + near] = 0.0
        findings.highest(deep.max(initial=0.0), key, near)
        for i in evenly(deep > near, ISSUES_SHOWN):
            what = (
                f"in {key} the blade is {mm(float(deep[i])):.2f} mm in the part, over {curve.one.name}, "
                f"at ({coordinates(cut.foot[i])}) mm of the {face} face; allowed: {mm(near):.2f} mm"
            )
            if np.isfinite(past[i]):
                what += f", and straight on past a corner {mm(own.overcut):g} mm; it is "
                what += f"{mm(float(past[i])):.2f} mm past one"
            findings.at_sample(what, work.claim.arm, cut.rows[i], in_mm(deep[i], near))


@rule("verify.trim_torch", TrimsSheet)
def trim_torch(context: Context) -> Outcome:
    """While it cuts the nozzle is off the sheet by its stand-off within the tolerance, no higher than its
    pierce height where it leads in, and the torch leans off the sheet's normal no farther than its cone."""
    findings = Findings("verify.trim_torch", context, worst=0.0)
    for work, _, key, way in every(context.get(TRIMMING)):
        claim, torch = work.claim, work.claim.torch
        if torch is None:
            continue
        near = claim.height + work.sheet.tolerance
        lift = max(claim.pierce_height - torch.standoff, 0.0)
        drop = min(claim.pierce_height - torch.standoff, 0.0)
        leads = way.off > 0.5 * claim.kerf + work.near
        high = near + PLACE_ERROR + np.where(leads, lift, 0.0)
        low = -near - PLACE_ERROR + np.where(leads, drop, 0.0)
        lean = np.arccos(np.clip((way.axis * way.feet.normal).sum(axis=1), -1.0, 1.0))
        share = np.maximum(way.feet.height / high, way.feet.height / low)
        turned = lean / (claim.cone + ANGLE_ERROR + work.sheet.turn)
        pierced = abs(float(way.feet.height[0]) - (claim.pierce_height - torch.standoff)) / near
        for rate, kind in ((share, "height"), (turned, "lean"), (np.array([pierced]), "pierce")):
            findings.highest(rate.max(), f"{kind} in {key}")
            for i in evenly(rate > 1.0, ISSUES_SHOWN):
                nozzle = mm(float(way.feet.height[i]) + torch.standoff)
                said = {
                    "height": f"the nozzle is {nozzle:.2f} mm off the sheet; wanted: "
                    f"{mm(torch.standoff):g} mm within {mm(claim.height):g}",
                    "lean": f"the torch leans {np.rad2deg(lean[i]):.1f} deg off the sheet's normal; allowed: "
                    f"{np.rad2deg(claim.cone):g} deg",
                    "pierce": f"the sheet is pierced from {nozzle:.2f} mm; wanted: "
                    f"{mm(claim.pierce_height):g} mm within {mm(claim.height):g}",
                }[kind]
                findings.at_sample(f"in {key} {said}", claim.arm, way.rows[i])
    return findings.outcome(percent, "% of what is allowed", 1.0, nothing=NOTHING_TRIMMED)


@rule("verify.trim_arc", TrimsSheet)
def trim_arc(context: Context) -> Outcome:
    """The arc starts with the torch at rest in the waste, far enough off all curves, and the program then
    waits for it, no longer than it may; it burns all along its slot and nowhere else. A program of UR watches
    all along that it does, and ends where it does not, or the torch stands."""
    trimming, findings = context.get(TRIMMING), Findings("verify.trim_arc", context)
    count = 0
    torches = [work for work in trimming.works if work.claim.torch is not None]
    for work in torches:
        claim = work.claim
        others = {key for other in torches if other is not work for key in other.slots} - set(work.slots)
        findings.issues += [*waits(context, work, others), *unguarded(context, work, others)]
        track, burning = work.track, work.burning
        for begin, end in zip(burning.begin, burning.end, strict=True):
            moved, start = _under_way(work, begin, end)
            if not (moved & np.isin(track.label, list(work.slots))).any() and any(
                np.isin(other.track.label[_under_way(other, begin, end)[0]], list(other.slots)).any()
                for other in torches
            ):
                continue  # another operation cuts with it
            stray = np.flatnonzero(moved & ~np.isin(track.label, list(work.slots)))
            for i in stray[:1]:
                what = f"{claim.signal} is on in {track.label[i]}, where nothing is cut"
                findings.at_sample(what, claim.arm, track.rows[i])
            _pierced(findings, work, track.tip[start], int(track.rows[start]), begin)
        for key in work.slots:
            own = work.of_slot(key)
            if len(own.time) < 2:
                continue
            count += 1
            # a torch may stand at the slot's ends, for the arc and for the other arm, longer than it burns
            ends = [np.linalg.norm(own.tip - own.tip[k], axis=1) > STANDING for k in (0, -1)]
            for i in np.flatnonzero(~burning.at(own.time) & ends[0] & ends[1])[:1]:
                what = f"{claim.signal} is off in {key}: nothing is cut there"
                findings.at_sample(what, claim.arm, own.rows[i])
    return findings.outcome_without_value("" if torches else NOTHING_TRIMMED, f"{count} slots")


def _under_way(work: TrimWork, begin: float, end: float) -> tuple[BoolArray, int]:
    """Rows (T,) of a torch's track in a time [s], but for those where it still stands, and the one from which
    that is."""
    track = work.track
    inside = (track.time > begin + 1e-6) & (track.time < end - 1e-6)
    start = min(int(np.searchsorted(track.time, begin, side="right")), len(track.time)) - 1
    return inside & (np.linalg.norm(track.tip - track.tip[start], axis=1) > STANDING), start


def _pierced(findings: Findings, work: TrimWork, tip: FloatArray, row: int, begin: float) -> None:
    """Where the arc starts: in the waste of some outline, off all curves; and for how long it stands."""
    claim = work.claim
    foot = work.sheet.feet(tip[None]).foot
    off = np.array([float(curve.off(foot)[0][0]) for curve in work.curves])
    waste = any(bool(curve.in_waste(foot)[0]) for curve in work.curves)
    least = claim.pierce_off - work.sheet.tolerance - PLACE_ERROR
    if not waste or off.min() < least:
        what = f"the arc starts {'in the part, ' if not waste else ''}{mm(float(off.min())):.2f} mm off "
        what += f"{work.curves[int(off.argmin())].one.name}; wanted: in the waste, "
        what += f"{mm(claim.pierce_off):g} mm off"
        findings.at_sample(what, claim.arm, row)
    moving = np.flatnonzero(
        (work.track.time > begin) & (np.linalg.norm(work.track.tip - tip, axis=1) > STANDING)
    )
    stood = float(work.track.time[moving[0]]) - begin if len(moving) else 0.0
    if stood < claim.pierce_seconds - WAIT_ROUNDING:
        what = (
            f"the torch moves {stood:.3f} s after {claim.signal} goes on; wanted: {claim.pierce_seconds:g} s"
        )
        findings.at_sample(what, claim.arm, row)


@rule("verify.trim_order", TrimsSheet)
def trim_order(context: Context) -> Outcome:
    """An outline that lies in another one is wholly cut before that is begun, which would let it move."""
    findings, pairs = Findings("verify.trim_order", context), 0
    for work in context.get(TRIMMING).works:
        spans: list[tuple[float, float]] = []
        for curve in work.curves:
            tracks = [work.of_slot(key) for key in work.ways(curve)]
            times = np.concatenate([track.time for track in tracks if len(track.time)] or [np.zeros(0)])
            spans.append((float(times.min()), float(times.max())) if len(times) else (np.inf, -np.inf))
        for (a, inner), (b, outer) in itertools.permutations(enumerate(work.curves), 2):
            if not bool(winding(outer.flat, inner.flat[:1])[0]):
                continue
            pairs += 1
            if spans[a][1] > spans[b][0]:
                what = f"{outer.one.name} is begun before {inner.one.name}, which lies in it, is cut"
                findings.add(what, field=outer.one.name, arm=work.claim.arm)
    return findings.outcome_without_value(
        "" if pairs else "no outline within another", f"{pairs} within others"
    )


@rule("verify.trim_feed", TrimsSheet)
def trim_feed(context: Context) -> Outcome:
    """While it cuts the tool goes no faster than its feed over the cosine of the wall's angle, by the
    thickness that the sine law leaves there, and on average, but for a knife, no slower than the wanted share
    of that; a torch is nowhere much slower, where it would burn away more than its slot."""
    findings = Findings("verify.trim_feed", context, worst=0.0)
    for work, _, key, _way in every(context.get(TRIMMING)):
        claim, track = work.claim, work.of_slot(key)
        time, length = np.diff(track.time), np.linalg.norm(np.diff(track.tip, axis=0), axis=1)
        time, length = time[track.joined], length[track.joined]
        feet, deep = work.feet(track.tip, track.axis)
        wall = np.maximum(np.abs(feet.normal[:, 2]), 0.05)
        limit = np.minimum(claim.feed / wall, claim.feed_most)
        there = np.maximum(limit[:-1], limit[1:])[track.joined]
        speed = length / np.maximum(time, 1e-6)
        share = speed / there
        findings.highest(share.max(), key)
        rows = track.rows[1:][track.joined]
        for i in evenly(share > FEED_SLACK, ISSUES_SHOWN):
            got, most = mm(float(speed[i])), mm(float(there[i]))
            what = f"the tool cuts at {got:.2f} mm/s in {key}; allowed there: {most:.2f}"
            findings.at_sample(what, claim.arm, rows[i], (got, most, "mm/s"))
        if claim.torch is not None:
            _lingers(findings, work, key)
        if claim.knife is not None:  # which may be as slow as it likes
            continue
        if claim.mill is not None:  # on its way down another feed counts
            least = claim.thickness + claim.mill.below - GOING_DOWN * claim.height
            low = (deep[1:] >= least)[track.joined] & (np.diff(deep)[track.joined] <= SLOPE_DOWN * length)
            time, length, there = time[low], length[low], there[low]
        else:  # over its pierce point it stands for as long as it takes
            goes = (np.arange(1, len(track.time)) > begins(track))[track.joined]
            time, length, there = time[goes], length[goes], there[goes]
        mean = float((length / there).sum() / max(float(time.sum()), 1e-9))
        if mean < AVERAGE_SLACK * claim.least_feed:
            what = f"the tool cuts at {100 * mean:.0f} % of its feed in {key} on average; wanted: "
            what += f"{100 * claim.least_feed:.0f} %"
            findings.add(what, (mean, claim.least_feed, None), field=key)
    return findings.outcome(float, "of the feed", FEED_SLACK, nothing=NOTHING_TRIMMED)


def _lingers(findings: Findings, work: TrimWork, key: str) -> None:
    """Whether a torch, once it moves, takes too long for some short stretch of its slot."""
    claim, track = work.claim, work.of_slot(key)
    ends = [np.linalg.norm(track.tip - track.tip[k], axis=1) > STANDING for k in (0, -1)]
    moved = np.flatnonzero(ends[0])
    if not len(moved) or not ends[1].any():
        return
    some = slice(max(int(moved[0]) - 1, 0), int(np.flatnonzero(ends[1])[-1]) + 2)
    time, rows = track.time[some], track.rows[some]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(track.tip[some], axis=0), axis=1)))
    stretch = max(LINGER_KERFS * claim.kerf, LEAST_STRETCH)
    behind = np.minimum(np.searchsorted(along, along + stretch), len(along) - 1)
    spent, way = time[behind] - time, along[behind] - along
    most = LINGER * way / (claim.least_feed * claim.feed) + LINGER_TIME
    k = int(np.argmax(spent - most))
    if spent[k] > most[k]:
        what = f"the torch takes {spent[k]:.2f} s for {mm(float(way[k])):.2f} mm in {key}; allowed: "
        what += f"{most[k]:.2f} s"
        findings.at_sample(what, claim.arm, rows[k], (float(spent[k]), float(most[k]), "s"))


@rule("verify.trim_clear", TrimsSheet)
def trim_clear(context: Context) -> Outcome:
    """The tool that is mounted is the claimed one, and in slots and on the ways to them and from them no part
    of it, of a mill or a knife none that does not cut, is nearer to the formed sheet than it may be."""
    findings = Findings("verify.trim_clear", context, worst=np.inf)
    for work in context.get(TRIMMING).works:
        claim = work.claim
        _same_tool(findings, work)
        rows = np.flatnonzero(np.char.startswith(work.track.label.astype(str), f"{TRIM}/"))
        if not len(rows):
            continue
        try:
            off, row = off_sheet(work, rows)
        except UnreadError as error:
            findings.add(str(error), hint="take a smaller sheet or a coarser mesh")
            continue
        least = (1.0 - CLEAR_SHARE) * claim.clear - work.sheet.tolerance
        findings.lowest(off, work.track.label[row], least)
        if off < least:
            what = f"in {work.track.label[row]} the tool is {mm(off):.2f} mm off the sheet; wanted: "
            what += f"{mm(claim.clear):g} mm"
            findings.at_sample(what, claim.arm, work.track.rows[row], in_mm(off, least))
    return findings.outcome(mm, "mm", nothing=NOTHING_TRIMMED)


TORCH_SIZES = ("standoff", "kerf", "nozzle", "cone", "body", "back")
"""What of a torch counts,"""
CUTTER_SIZES = ("radius", "corner", "flute", "overhang", "shank", "behind")
"""what of a mill's cutter,"""
BLADE_SIZES = ("thickness", "width", "end", "ground", "length")
"""and what of a knife's blade."""


def _same_tool(findings: Findings, work: TrimWork) -> None:
    """Whether the tool on the arm is the claimed one, and cuts as wide as is claimed."""
    claim = work.claim
    tool = findings.context.setups[work.index].cell.arm(claim.arm).tool
    same = False
    if claim.mill is not None and isinstance(tool, Mill):
        said = claim.mill.cutter
        same = _alike(tool.cutter, said, CUTTER_SIZES) and abs(claim.kerf - 2.0 * said.radius) < SAME_SIZE
    elif claim.knife is not None and isinstance(tool, Knife):
        same = _alike(tool.blade, claim.knife.blade, BLADE_SIZES) and claim.kerf == 0.0
        same = same and _alike(tool, claim.knife, ("body", "back"))
    elif claim.torch is not None and isinstance(tool, Torch):
        same = _alike(tool, claim.torch, TORCH_SIZES) and abs(claim.kerf - claim.torch.kerf) < SAME_SIZE
    if not same:
        what = f"the tool of {claim.arm} in setup {work.index + 1} is another one than the claimed"
        findings.add(what, arm=claim.arm)


SAME_SIZE = 1e-9
"""Sizes that differ by less [m] are the same."""


def _alike(one: object, other: object, sizes: Sequence[str]) -> bool:
    pairs = ([np.asarray(getattr(tool, name), dtype=np.float64) for tool in (one, other)] for name in sizes)
    return all(a.shape == b.shape and bool(np.all(np.abs(a - b) < SAME_SIZE)) for a, b in pairs)


def every(trimming: Trimming) -> Iterator[tuple[TrimWork, Curve, str, Way]]:
    """All slots that are cut."""
    for work in trimming.works:
        for curve in work.curves:
            for key, way in work.ways(curve).items():
                if way is not None:
                    yield work, curve, key, way
