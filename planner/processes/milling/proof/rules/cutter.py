"""Rules on milling: what the swept cutter leaves and takes, its path, the feed, the spindle.

verify.milled, mill_gouge. verify.mill_path: the curves that it follows; cutters that pass ruled
surfaces with their flanks, with their ways in and out; and those that pass faces with their ends.
verify.mill_feed: the feed of the tip. verify.spindle: up to speed wherever the cutter is in the
block.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import shapely

from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.claims.segments import Phase, Segment
from planner.geometry.arrays import FloatArray, IntArray
from planner.issues import Issue
from planner.processes.milling.claims import (
    MILL,
    Engraves,
    MillsAlong,
    MillsFlank,
    MillsOver,
    MillsProgram,
    MillsSurface,
    SparesPart,
)
from planner.processes.milling.proof import surface_passes
from planner.processes.milling.proof.following import WRITTEN_ROUNDING, Followed, allowed, rows_to_check
from planner.processes.milling.proof.surface_passes import OverFace, Way, within
from planner.processes.milling.proof.tool_motion import (
    BEND_SHARE,
    MILLING,
    MOST_FACE_POINTS,
    SIGHT_DISTANCE,
    Held,
    Inside,
    Milling,
    Solid,
    comes_near,
    edges,
    in_block,
    insides,
    rim_step,
    solids,
    sweep,
)
from planner.proof.context import Context
from planner.proof.faces import divided
from planner.proof.findings import Findings, coordinates, evenly, in_mm, in_percent
from planner.proof.replay.tool_track import Track
from planner.proof.rule import FEED_SLACK, Outcome, mm, rule
from planner.proof.verdict import CutFace
from planner.runtime.executor import SERIAL
from planner.tooling import Mill

MILL_PATH = "verify.mill_path"
"""Code of the rule about ways of cutters."""
ISSUES_SHOWN = 50
"""Issues of one segment at most."""


def _flanks(findings: Findings, milling: Milling) -> None:
    """All passes along ruled surfaces."""
    for index, claim in milling.flanks:
        for number, segment in enumerate(claim.segments):
            track = milling.track(index, claim.arm, (segment.key,))
            if len(track.rows) < 2:
                findings.add(f"{segment} is not milled", field=str(segment))
                continue
            some = rows_to_check(track.tip, track.axis, claim.tolerance)
            found = surface_passes.passed(claim, number, track.tip[some], track.axis[some])
            findings.highest(found.off.max(), segment)
            for fault in found.faults:
                findings.add(f"{segment}: {fault}", field=str(segment))
            for i in evenly(found.off > 1.0, ISSUES_SHOWN):
                what = f"in {segment} the cutter is {found.worst[i]}, {found.off[i]:.2f} times as far as "
                what += f"allowed, {mm(claim.tolerance):g} mm"
                findings.at_sample(what, claim.arm, track.rows[some[i]])
            for phase, _ in _fast(claim):
                _way(findings, milling, index, claim, number, phase)


def _way(
    findings: Findings, milling: Milling, index: int, claim: MillsFlank, number: int, phase: Phase
) -> None:
    segment = claim.segments[number].at(phase)
    known = _known(milling, index, claim, number, phase)
    if known is None:
        findings.add(f"{segment} is not there", field=str(segment))
        return
    track, rows, found = known
    for fault in found.faults:
        findings.add(f"{segment}: {fault}", field=str(segment))
    for i in evenly(found.off > 1.0, ISSUES_SHOWN):
        what = f"in {segment} the tip is neither on the straight going on of its pass nor on its way up "
        what += f"along the axis: {found.off[i]:.2f} times as far off as allowed"
        findings.at_sample(what, claim.arm, track.rows[rows[i]])
    if claim.lead is None:
        own = findings.context.stock(index)
        inside = in_block(track.tip, track.axis, claim.cutter.overhang, claim.cutter.radius, own)[rows]
        for i in np.flatnonzero(inside & found.up & ~found.aside)[:1]:
            what = (
                f"in {segment} the cutter comes into the block along its axis; it is to come from beside it"
            )
            findings.at_sample(what, claim.arm, track.rows[rows[i]])


def _known(
    milling: Milling, index: int, claim: MillsFlank, number: int, phase: Phase
) -> tuple[Track, IntArray, Way] | None:
    """The track of a way in or out, its rows away from the pass, and how it keeps to what is asked."""
    segment = claim.segments[number]
    main = milling.track(index, claim.arm, (segment.key,))
    track = milling.track(index, claim.arm, (segment.at(phase).key,))
    if len(main.rows) < 2 or len(track.rows) < 2:
        return None
    forward, back = slice(None), slice(None, None, -1)
    order, away = (forward, back) if phase == "in" else (back, forward)
    tip, axis = main.tip[order], main.axis[order]
    far = np.linalg.norm(tip[1:] - tip[0], axis=1) > surface_passes.END_LENGTH
    pair = [0, min(int(np.argmax(np.append(far, True))) + 1, len(tip) - 1)]
    rows = np.arange(len(track.rows))[away]
    way = surface_passes.ways(claim, number, (tip[pair], axis[pair]), track.tip[rows], track.axis[rows])
    return track, rows, way


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


FACE_STEP = 1e-3
"""Way between places [m] at which a cutter is held against its face."""


def _over(findings: Findings, milling: Milling) -> None:
    for index, claim in milling.over:
        face = OverFace(claim)
        for segment in claim.segments:
            labels = (segment.key,)
            if not len(milling.track(index, claim.arm, labels).rows):
                findings.add(f"{segment} is not milled", field=str(segment))
                continue
            tip, axis, rows = milling.spaced(index, claim.arm, labels, FACE_STEP, claim.tolerance)
            for asked, off in face.off(tip, axis).items():
                findings.highest(off.max(), segment)
                for i in evenly(off > 1.0, ISSUES_SHOWN):
                    what = f"in {segment} the cutter is {asked}, {off[i]:.2f} times as far as allowed, "
                    what += f"{mm(claim.tolerance):g} mm"
                    findings.at_sample(what, claim.arm, rows[i])


NOTHING_MILLED = "nothing is milled"
"""Why rules about milling have not run."""
FACET_ERROR = 5e-5
"""What facets, and places between which nothing is looked at, may hide [m]."""
_FACE_PLACES = 30_000
"""Places of a face, about, at most."""
_FINEST_SPACING = 0.4e-3
"""Places of a face are no nearer to one another than this [m]."""
_GOUGE_SPACING = 1.6
"""Gouges are looked for at places so much farther apart, of which a quarter of the tolerance is hidden."""


@rule("verify.milled", MillsSurface)
def milled(context: Context) -> Outcome:
    """The swept cutter makes the wanted surface within the tolerance, but for a stated share of it, with the
    cutter that is mounted, and nothing is milled that is not claimed."""
    milling, findings = context.get(MILLING), Findings("verify.milled", context)
    _unclaimed(findings, milling)
    faces: list[CutFace] = []
    for index, claim in milling.surfaces:
        findings.issues += _same_cutter(milling, index, claim)
        face = cut_face(milling, index, claim)
        faces.append(face)
        if face.share < claim.share:
            what = (
                f"{face.title}: {100 * face.share:.2f} % of the surface are within "
                f"{mm(claim.tolerance):g} mm; wanted: {100 * claim.share:g} %"
            )
            findings.add(what, in_percent(face.share, claim.share), field=face.title)
    if not faces:
        return findings.outcome_without_value(NOTHING_MILLED)
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    share, wanted, issues = 100 * worst.share, 100 * worst.wanted_share, tuple(findings.issues)
    return Outcome(issues, share, wanted, "% within tolerance", worst.title, faces=tuple(faces))


def cut_face(milling: Milling, index: int, claim: MillsSurface) -> CutFace:
    """What the swept cutting part leaves of a surface (positive) or takes too much (negative); NaN where it
    never comes near."""
    corners = claim.vertices[claim.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    size = max(float(np.sqrt(area.sum() / _FACE_PLACES)) * 2.0, _FINEST_SPACING)
    pieces, _ = divided(corners, size)
    area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    points = pieces.mean(axis=1)
    if claim.margin:
        kept = shapely.contains_xy(within(corners, claim.margin + 0.5 * size), points[:, 0], points[:, 1])
        points, area = points[kept], area[kept]
    labels = tuple(segment.key for segment in claim.segments)
    track = milling.track(index, claim.arm, labels)
    solid = solids(claim.cutter)[0]
    tip, axis, _ = track.spaced(_step(solid, claim.tolerance), BEND_SHARE * claim.tolerance)
    off, _ = sweep(points, tip, axis, solid)
    known = off < SIGHT_DISTANCE
    share = float(area[known & (np.abs(off) <= claim.tolerance)].sum() / max(float(area.sum()), 1e-30))
    weight = max(float(area[known].sum()), 1e-30)
    rms = float(np.sqrt((area[known] * off[known] ** 2).sum() / weight))
    largest = float(np.abs(off[known]).max(initial=0.0))
    deviation = np.where(known, off, np.nan)
    first, *more = claim.segments
    measure = (claim.tolerance, share, claim.share, rms, largest)
    return CutFace(first, points, deviation, area, *measure, more=len(more))


def _step(solid: Solid, tolerance: float) -> float:
    """Way between places [m] of which a round tool hides a tenth of the tolerance at most: s^2 / 8 r."""
    narrow = solid.radius if solid.corner == 0.0 else 0.5 * solid.radius
    return float(np.clip(np.sqrt(0.8 * narrow * tolerance), 0.3e-3, 3e-3))


@rule("verify.mill_gouge", SparesPart)
def mill_gouge(context: Context) -> Outcome:
    """At every instant, also on its ways in and out, neither cutter nor shank, holder and spindle are in a
    face of the part by more than the tolerance; a cutter that engraves is as deep as wanted."""
    milling, findings = context.get(MILLING), Findings("verify.mill_gouge", context)
    asked = [(index, claim, list(_held(milling, index, claim))) for index, claim in milling.spared]
    found = _insides(milling, [one for _, _, group in asked for one, _ in group])
    for index, claim, group in asked:
        findings.issues += _same_cutter(milling, index, claim)
        for one, rows in group:
            solid, allowed, there = one.solid, one.allowed, next(found)
            if isinstance(there, int):
                findings.issues.append(_too_many(claim, solid, there, one.size))
                findings.excess, findings.limit = max(findings.excess, 0.0), allowed
                findings.where = str(claim.segments[0])
                continue
            at = context.motion.node_segment[context.motion.node[rows[there.at]]]
            findings.beyond(-there.least, allowed, f"{solid.name} in {at}")
            for i in range(0, len(there.off), max(1, len(there.off) // ISSUES_SHOWN)):
                what = f"the {solid.name} is {mm(-there.off[i]):.3f} mm in the part at "
                what += f"{coordinates(there.points[i])} mm; allowed: {mm(allowed):.3f} mm"
                findings.at_sample(what, claim.arm, rows[there.place[i]], in_mm(-there.off[i], allowed))
    return findings.outcome_beyond(NOTHING_MILLED)


def _held(milling: Milling, index: int, claim: SparesPart) -> Iterator[tuple[Held, IntArray]]:
    """What a face is held against, and the rows of the motion at the places of each."""
    labels = tuple(way.key for segment in claim.segments for way in segment.ways)
    track = milling.track(index, claim.arm, labels)
    if not len(track.rows):
        return
    pieces = solids(claim.cutter)
    for solid, sharp in [*((one, False) for one in pieces), *((one, True) for one in edges(pieces))]:
        near = comes_near(claim.vertices, track.tip, track.axis, solid)
        if sharp and not near:
            continue
        step = rim_step(claim.tolerance) if sharp else _GOUGE_SPACING * _step(solid, claim.tolerance)
        tip, axis, rows = milling.spaced(index, claim.arm, labels, step, claim.tolerance)
        allowed = claim.tolerance + FACET_ERROR + (claim.depth if solid.name == "cutter" else 0.0)
        measure = (claim.tolerance, allowed)
        yield Held(claim.vertices, claim.faces, solid, sharp, near, tip, axis, *measure), rows


def _insides(milling: Milling, held: Sequence[Held]) -> Iterator[Inside | int]:
    """What is inside of each, in their order; every other one is begun, perhaps in another process."""
    begun = (milling.executor if len(held) > 1 else SERIAL).submit(insides, held[1::2])
    own = list(insides(held[::2]))
    for k, one in enumerate(own):
        yield one
        if 2 * k + 1 < len(held):
            yield next(begun)


def _too_many(claim: SparesPart, solid: Solid, count: int, size: float) -> Issue:
    """Nothing is proven of a face that is too large to be looked at as closely as it has to be."""
    what = (
        f"beside the {solid.name} the face would have to be looked at in {count} places, {mm(size):.2f} mm "
        f"apart; allowed: {MOST_FACE_POINTS}: split the cut, or take a larger tolerance"
    )
    name = str(claim.segments[0])
    return Issue("verify.mill_gouge", what, field=name, value=float(count), limit=float(MOST_FACE_POINTS))


@rule("verify.mill_path", MillsAlong, MillsProgram, Engraves, MillsFlank, MillsOver)
def mill_path(context: Context) -> Outcome:
    """Tip and axis stay within the tolerances on the way that the G-code file, the curves, the ruled surface
    or the face asks for, all of which is passed, ways in and out too, and mill nothing beside it."""
    milling, findings = context.get(MILLING), Findings(MILL_PATH, context, worst=0.0)
    findings.issues += context.unread
    _flanks(findings, milling)
    _over(findings, milling)
    for index, claim in milling.curves:
        track = milling.track(index, claim.arm, (claim.segment.key,))
        known = milling.followed(index, claim)
        if known is None and _small(claim):
            continue
        if known is None:
            findings.add(f"{claim.segment} is not milled", field=str(claim.segment))
            continue
        some, found = known
        off, turn = found.off, found.turn
        allowed_off = claim.tolerance + WRITTEN_ROUNDING
        findings.highest(max(off.max() / allowed_off, turn.max() / claim.turn), claim.segment)
        for i in evenly((off > allowed_off) | (turn > claim.turn), ISSUES_SHOWN):
            what = (
                f"in {claim.segment} the tip is {mm(off[i]):.3f} mm off its curve{_line(claim, found, i)} "
                f"and the axis {np.rad2deg(turn[i]):.2f} deg; allowed: {mm(claim.tolerance):g} mm, "
                f"{np.rad2deg(claim.turn):.2f} deg"
            )
            findings.at_sample(what, claim.arm, track.rows[some[i]], in_mm(off[i], claim.tolerance))
        if found.missed:
            word = f"{found.missed} of {len(claim.tip)} places are never passed, or not in order"
            findings.add(f"{claim.segment}: {word}", field=str(claim.segment))
    out = findings.outcome(float, "of what is allowed", 1.0 if findings.where else None)
    return dataclasses.replace(out, nothing="" if findings.where else NOTHING_MILLED)


def _small(claim: MillsAlong) -> bool:
    """Whether a way is so short that standing still follows it."""
    tips = float(np.linalg.norm(claim.tip - claim.tip[0], axis=1).max())
    return tips <= claim.tolerance and float((claim.axis @ claim.axis[0]).min()) >= np.cos(claim.turn)


def _line(claim: MillsAlong, found: Followed, i: int) -> str:
    if claim.line is None:
        return ""
    place = min(int(np.searchsorted(found.along, found.at[i])), len(claim.line) - 1)
    return f" by line {claim.line[place]} of {claim.file}"


def _unclaimed(findings: Findings, milling: Milling) -> None:
    """Moves of segments that mill, of which nothing is claimed, and claimed ones that never come."""
    motion, arm = findings.context.motion, findings.context.job.tasks[0].arm.name
    seen: set[str] = set()
    for node, (segment, name) in enumerate(zip(motion.node_segment, motion.node_label, strict=True)):
        if segment.kind == MILL and name not in milling.labels and name not in seen:
            what = f"the programs mill in {segment}, of which the problem claims nothing"
            findings.at_node(what, arm, node)
        seen.add(name)
    for name in sorted({segment.key for _, c in milling.surfaces for segment in c.segments} - seen):
        findings.add(f"{name} is never milled", field=name)


def _same_cutter(milling: Milling, index: int, claim: MillsSurface | SparesPart) -> list[Issue]:
    own, said = milling.mounted(index, claim.arm), claim.cutter
    if (
        own is not None
        and own.kind == said.kind
        and all(
            np.allclose(getattr(own, name), getattr(said, name), atol=1e-9)
            for name in ("radius", "corner", "flute", "overhang", "shank", "behind")
            if np.shape(getattr(own, name)) == np.shape(getattr(said, name))
        )
        and np.shape(own.behind) == np.shape(said.behind)
    ):
        return []
    what = f"the tool of {claim.arm} in setup {index + 1} has another cutter than the claimed one"
    return [Issue("verify.milled", what, arm=claim.arm)]


@rule("verify.mill_feed", FeedWindow, MillsAlong, MillsProgram, Engraves, MillsFlank, MillsOver)
def mill_feed(context: Context) -> Outcome:
    """While it mills, and on its ways in and out, the tip moves no faster than it may at each place of its
    way."""
    milling, findings = context.get(MILLING), Findings("verify.mill_feed", context, worst=0.0)
    claims = [c for c in context.feeds if c.segment.kind == MILL]
    for claim in claims:
        index = context.setup_of(claim)
        arm = _arm(milling, index, claim)
        track = milling.track(index, arm, (claim.segment.key,)) if arm else None
        if track is None or not len(track.joined):
            continue
        time = np.diff(track.time)
        speed = np.linalg.norm(np.diff(track.tip, axis=0), axis=1) / np.maximum(time, 1e-6)
        speed = np.where(track.joined, speed, 0.0)
        there = _there(milling, index, claim.segment, len(speed) + 1)
        there = np.minimum(there, feed(milling, index, claim.segment, len(speed) + 1))
        limit = np.minimum(there, claim.upper)
        share = speed / limit
        findings.highest(share.max(), claim.segment, FEED_SLACK)
        for k in evenly(share > FEED_SLACK, ISSUES_SHOWN):
            got, most = mm(float(speed[k])), mm(float(limit[k]))
            what = f"the tip moves at {got:.2f} mm/s in {claim.segment}; allowed there: {most:g}"
            findings.at_sample(what, arm, track.rows[k + 1], (got, most, "mm/s"))
    fed = {claim.segment.key for claim in claims}
    for label in sorted(_labels(context) - fed):
        findings.add(f"{label} has no feed", field=label)
    out = findings.outcome(float, "of the feed")
    return out if findings.measured else dataclasses.replace(out, worst=None, nothing=NOTHING_MILLED)


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


@rule("verify.spindle", ContactOnlyIn, MillsProgram)
def spindle(context: Context) -> Outcome:
    """The cutter is in the block only while its spindle has been on for long enough, and on segments that
    mill."""
    milling, findings = context.get(MILLING), Findings("verify.spindle", context)
    motion = context.motion
    seen = False
    for index, setup in enumerate(context.setups):
        claims = [c for c in context.setup_claims[index].contacts if MILL in c.kinds]
        for arm in setup.cell.arms:
            if not isinstance(arm.tool, Mill) or arm.name not in motion.tcp:
                continue
            rows, node, time = milling.inside(index, arm.name, arm.tool.cutter)
            judged = [
                c.spindle_rule[1] for c in context.claims if c.spindle_rule and c.spindle_rule[0] == arm.name
            ]
            if judged:
                other = ~np.isin(motion.node_kind[motion.node[rows]], judged)
                rows, node, time = rows[other], node[other], time[other]
            if not len(rows):
                continue
            seen = True
            for i in np.flatnonzero(motion.node_kind[motion.node[rows]] != MILL)[:1]:
                what = f"the cutter is in the block in {motion.node_label[node[i]]}, where nothing is milled"
                findings.at_sample(what, arm.name, rows[i])
            if not claims:
                what = f"{arm.name} mills in setup {index + 1}, which claims no spindle"
                findings.at_sample(what, arm.name, rows[0])
            for claim in claims:
                on = motion.on_for(claim.signal, context.switching((arm.name,)), time)
                for i in np.flatnonzero(on < claim.heat_up - 1e-6)[:1]:
                    got = f"for {on[i]:.1f} s" if on[i] >= 0.0 else "not"
                    what = f"the cutter is in the block and {claim.signal} is {got} on; wanted: "
                    what += f"{claim.heat_up:g} s"
                    measure = (float(max(on[i], 0.0)), claim.heat_up, "s")
                    findings.at_sample(what, arm.name, rows[i], measure)
    return findings.outcome_without_value("" if seen else NOTHING_MILLED)


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
