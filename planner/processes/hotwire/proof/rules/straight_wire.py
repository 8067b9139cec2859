"""Rules on straight wires: the bow, the kerf, the rulings of the surface, the ways to cuts.

verify.bow: its clamps. verify.kerf: at the actual speeds. verify.rulings: of the surface.
verify.slit: where a straight wire comes from, and what its slit takes of the part.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, inverse
from planner.problem import Stock
from planner.processes.hotwire.claims import (
    CutsSurface,
    FollowsRulings,
    KerfWithin,
    LeadsFrom,
    SlitsAllowed,
    StraightWire,
)
from planner.processes.hotwire.proof.cut_surface import unreached
from planner.processes.hotwire.proof.rules.cut_part import CUT_FACES
from planner.processes.hotwire.proof.rules.wire import at_wire
from planner.processes.hotwire.proof.slits import SLIT_ROUNDING, Slit, off_lead, slits, way_at
from planner.processes.hotwire.proof.wire_motion import WIRES, Wire, straight_claims
from planner.proof.context import Context
from planner.proof.findings import Findings, coordinates, in_mm
from planner.proof.replay.motion import during, local
from planner.proof.rule import FEED_SLACK, Outcome, mm, rule
from planner.tooling import Bow, Tool

CLAMP_ROUNDING = 1e-4
"""What rounded targets may take from a margin [m]."""
GUIDE_SLACK = 1e-4
"""How much farther than half a kerf and the tolerance the wire may pass a guide line [m]."""
BOW_DIFFERENCE = 1e-6
"""How far a claimed wire may be off the bow's own [m]."""
GUIDE_STEP = 0.002
"""Distance of the places of a guide line that must be passed [m]."""
RULING_STEP = 0.001
"""Way of the wire's ends between looks at its rulings [m]."""
_PAIRS_AT_ONCE = 400_000
"""Pairs of a point and a piece of a guide that are worked on at once."""


@rule("verify.bow", StraightWire)
def bow(context: Context) -> Outcome:
    """Wherever a straight wire is in the foam, both its clamps are outside by the wanted length of wire; it
    is the wire of the bow that is mounted."""
    findings = Findings("verify.bow", context, worst=np.inf)
    for wire in context.get(WIRES):
        claim = wire.claim
        if not isinstance(claim, StraightWire) or wire.fault:
            continue
        if not _is_edge(claim, context.setups[wire.setup].cell.arm(claim.arm).tool):
            what = f"the tool of {claim.arm} in setup {wire.setup + 1} has another wire than the claimed one"
            findings.add(what, arm=claim.arm)
        margin = max(c.margin for c in straight_claims(context.setup_claims[wire.setup])[claim.arm])
        free = free_lengths(wire.points[:, 0], wire.points[:, -1], context.stock(wire.setup))
        short = free.min(axis=1)
        rows = np.flatnonzero(np.isfinite(short))
        findings.lowest(short[rows].min(initial=np.inf), limit=margin)
        for k in rows[short[rows] < margin - CLAMP_ROUNDING][:50]:
            what = (
                f"the {'start' if free[k, 0] < free[k, 1] else 'end'} of the wire is free for "
                f"{mm(short[k]):.2f} mm beside the block; allowed: {mm(margin):g} mm"
            )
            at_wire(findings, wire, what, k, in_mm(short[k], margin))
    return findings.outcome(mm, "mm", nothing="no straight wire in the foam")


def _is_edge(claim: StraightWire, tool: Tool) -> bool:
    """Whether a claimed wire is that of the tool, a bow, either way round."""
    if not isinstance(tool, Bow):
        return False
    wire = tool.wire
    half = 0.5 * wire.size[1] * wire.pose[:3, 2]
    ends = np.stack([wire.pose[:3, 3] - half, wire.pose[:3, 3] + half])
    back = inverse(tool.tcp)
    ends = ends @ back[:3, :3].T + back[:3, 3]
    said = np.stack([claim.start, claim.end])
    off = min(float(np.abs(ends - said).max()), float(np.abs(ends[::-1] - said).max()))
    return off <= BOW_DIFFERENCE and abs(wire.size[0] - claim.radius) <= BOW_DIFFERENCE


def free_lengths(start: FloatArray, end: FloatArray, stock: Stock) -> FloatArray:
    """Lengths (T, 2) [m] of straight wires from ``start`` to ``end`` (T, 3) outside the block, from either
    clamp to where the wire enters; 0 for a clamp inside, infinite for a wire that meets no foam."""
    way = end - start
    length = np.linalg.norm(way, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (stock.lower - start) / way, (stock.upper - start) / way
    aside = way == 0.0
    within = (start >= stock.lower) & (start <= stock.upper)
    low = np.where(aside, np.where(within, -np.inf, np.inf), np.minimum(one, other)).max(axis=1)
    high = np.where(aside, np.where(within, np.inf, -np.inf), np.maximum(one, other)).min(axis=1)
    meets = (low < high) & (high > 0.0) & (low < 1.0)
    free = np.stack([np.clip(low, 0.0, 1.0), np.clip(1.0 - high, 0.0, 1.0)], axis=1) * length[:, None]
    return np.asarray(np.where(meets[:, None], free, np.inf))


@rule("verify.kerf", KerfWithin)
def kerf(context: Context) -> Outcome:
    """The slot is as wide as wanted wherever the wire passes the part's surface, at its speed there."""
    faces, wires = context.get(CUT_FACES), context.get(WIRES)
    findings = Findings("verify.kerf", context, worst=0.0)
    for claim in context.of(KerfWithin):
        passed = [face for face in faces if face.segment.key == claim.segment.key]
        speeds = [face.speed[np.isfinite(face.speed)] for face in passed]
        if not passed:
            speeds = [_in_foam(context, wire, claim) for wire in wires if not wire.fault]
        speed = np.concatenate([*speeds, np.zeros(0)])
        if not len(speed):
            what = f"{claim.segment} is not cut, so that its slot has no width"
            findings.add(what, field=str(claim.segment))
            continue
        width = claim.kerf.at(speed)
        # ramps and corners of the replay may differ from the planned speed as far as the feed may
        narrow = claim.kerf.at(speed / FEED_SLACK) < claim.lower
        wide = claim.kerf.at(speed * FEED_SLACK) > claim.upper
        share = np.maximum(width / claim.upper, claim.lower / np.maximum(width, 1e-9))
        findings.highest(share.max(), claim.segment, 1.0)
        for bad, word in ((narrow, "narrow: the wire drags"), (wide, "wide: the foam burns")):
            if bad.any():
                k = int(np.argmax(np.where(bad, share, 0.0)))
                what = (
                    f"at {mm(speed[k]):.2f} mm/s the slot of {claim.segment} is {mm(width[k]):.3f} mm "
                    f"{word}; allowed: {mm(claim.lower):g} to {mm(claim.upper):g} mm"
                )
                measure = in_mm(width[k], claim.upper if bad is wide else claim.lower)
                findings.add(what, measure, field=str(claim.segment))
    out = findings.outcome(float, "of the bounds")
    return dataclasses.replace(out, nothing="" if findings.where else "no such claim")


def _in_foam(context: Context, wire: Wire, claim: KerfWithin) -> FloatArray:
    """Speeds (K,) of a wire's points inside the block in a segment."""
    here = (wire.labels == claim.segment.key)[:, None] & wire.inside
    return np.asarray(local(wire.points, context.motion.time[wire.sample], wire.inside)[here])


@rule("verify.rulings", FollowsRulings)
def rulings(context: Context) -> Outcome:
    """All along a ruled surface, at and between targets, the straight wire is half a kerf off both guide
    lines, on their outer side, and passes all of both as near as a round wire can."""
    findings = Findings("verify.rulings", context)
    for claim in context.of(FollowsRulings):
        label = claim.segment.key
        seen = False
        for wire in context.get(WIRES):
            rows = np.flatnonzero(wire.labels == label)
            if wire.fault or wire.setup != context.setup_of(claim) or len(rows) < 2:
                continue
            seen = True
            speed = local(wire.points, context.motion.time[wire.sample], wire.inside)
            points, speed, rows = between(wire.points, speed, rows)
            normal = guide_normals(claim)
            for name, guide, side in zip(("start", "end"), (claim.start, claim.end), normal, strict=True):
                off, half = off_guide(points, speed, guide, side, claim)
                findings.highest(off.max(), claim.segment, claim.tolerance)
                for i in np.flatnonzero(off > claim.tolerance)[:20]:
                    what = (
                        f"the wire is {mm(off[i]):.3f} mm off its distance to the {name} line of "
                        f"{claim.segment}; allowed: {mm(claim.tolerance):g} mm"
                    )
                    at_wire(findings, wire, what, rows[i], in_mm(off[i], claim.tolerance))
                whole = np.flatnonzero(during(wire.labels == label))
                passes = wire.points[whole], np.diff(whole) == 1
                _missed(findings, claim, name, guide, float(half.max()), passes)
        if not seen:
            findings.add(f"{claim.segment} is not cut", field=str(claim.segment))
    out = findings.outcome(mm, "mm")
    return out if findings.where else dataclasses.replace(out, worst=0.0, nothing="no such claim")


def between(points: FloatArray, speed: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Wires (N, P, 3) and their speeds (N, P) at stations ``rows`` and every ``RULING_STEP`` on the way to
    each from the station before, which is straight; the station (N,) that each leads to."""
    before = np.maximum(rows - 1, 0)
    way = np.linalg.norm(points[rows][:, [0, -1]] - points[before][:, [0, -1]], axis=2).max(axis=1)
    # the way to the first station of a visit belongs to what was before
    way[np.concatenate([[True], np.diff(rows) > 1])] = 0.0
    count = np.maximum(np.ceil(way / RULING_STEP).astype(np.int64), 1)
    at = np.repeat(np.arange(len(rows)), count)
    step = np.arange(len(at)) - np.repeat(np.cumsum(count) - count, count)
    share = ((step + 1) / count[at])[:, None]
    a, b = before[at], rows[at]
    wires = points[a] + share[..., None] * (points[b] - points[a])
    return wires, speed[a] + share * (speed[b] - speed[a]), b


def guide_normals(claim: FollowsRulings) -> tuple[FloatArray, FloatArray]:
    """Unit normals (M - 1, 3) away from the part along both guide lines; 0 where a line stands still."""
    along = claim.end - claim.start
    along = along[:-1] + along[1:]
    out = []
    for guide in (claim.start, claim.end):
        normal = np.cross(np.diff(guide, axis=0), along)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        out.append(np.where(size > 1e-14, normal / np.maximum(size, 1e-14), 0.0))
    return out[0], out[1]


def _outside(out: FloatArray, k: IntArray, share: FloatArray, normal: FloatArray, closed: bool) -> BoolArray:
    """Whether ways (T, 3) from places on a guide line, at ``share`` (T,) of pieces ``k`` (T,), lead away from
    the part; at a corner the normals of both its pieces count."""
    live = np.flatnonzero(normal.any(axis=1))
    if not len(live):
        return np.ones(len(k), dtype=np.bool_)
    # a line may stand still in pieces, where the other one turns a blunt edge: those beside them count
    before = np.searchsorted(live, np.where(share <= 0.0, k - 1, k), side="right") - 1
    behind = np.searchsorted(live, np.where(share >= 1.0, k + 1, k), side="left")
    if closed:
        before, behind = before % len(live), behind % len(live)
    else:
        before, behind = np.clip(before, 0, len(live) - 1), np.clip(behind, 0, len(live) - 1)
    return np.asarray(dots(out, normal[live[before]] + normal[live[behind]]) >= -1e-12)


def off_guide(
    points: FloatArray, speed: FloatArray, guide: FloatArray, normal: FloatArray, claim: FollowsRulings
) -> tuple[FloatArray, FloatArray]:
    """How far (T,) [m] the wire's line is off half its kerf from a guide line (M, 3), on the side that
    ``normal`` (M - 1, 3) points to, and that half kerf (T,) at the place of the wire that is nearest to
    it."""
    closed = bool(np.abs(guide[0] - guide[-1]).max() < 1e-9)
    start = points[:, 0]
    way = points[:, -1] - start
    length = np.linalg.norm(way, axis=1)
    along = way / length[:, None]
    off, half = np.zeros(len(points)), np.zeros(len(points))
    step = max(1, _PAIRS_AT_ONCE // max(len(guide), 1))
    for low in range(0, len(points), step):
        part = slice(low, low + step)
        relative = guide[None] - start[part, None]
        on_wire = np.einsum("tmi,ti->tm", relative, along[part])
        across = relative - on_wire[..., None] * along[part, None]
        a, b = across[:, :-1], across[:, 1:]
        edge = b - a
        share = -dots(a, edge) / np.maximum(dots(edge, edge), 1e-30)
        share = np.clip(share, 0.0, 1.0)
        distance = np.linalg.norm(a + share[..., None] * edge, axis=2)
        row, k = np.arange(len(a)), np.argmin(distance, axis=1)
        place = on_wire[row, k] + share[row, k] * (on_wire[row, k + 1] - on_wire[row, k])
        at = np.clip(place / length[part], 0.0, 1.0) * (points.shape[1] - 1)
        left = np.minimum(at.astype(np.int64), points.shape[1] - 2)
        fast = speed[part]
        here = fast[row, left] + (at - left) * (fast[row, left + 1] - fast[row, left])
        half[part] = 0.5 * claim.kerf.at(here)
        out = -(a[row, k] + share[row, k, None] * edge[row, k])
        sign = np.where(_outside(out, k, share[row, k], normal, closed), 1.0, -1.0)
        off[part] = np.abs(sign * distance[row, k] - half[part])
    return off, half


def _missed(
    findings: Findings,
    claim: FollowsRulings,
    name: str,
    guide: FloatArray,
    half: float,
    passes: tuple[FloatArray, BoolArray],
) -> None:
    """Places of a guide line that no sheet between two stations passes as near as a round wire can with half
    a slot of ``half`` [m], and those at which that leaves more than is allowed."""
    places, share = _marks(guide)
    far = _passed(*passes, places)
    within = claim.tolerance + GUIDE_SLACK
    rows = np.flatnonzero(far > half + within)
    more = unreached(claim, places[rows], half)
    missed = rows[far[rows] > half + within + more]
    if len(missed):
        long = mm(len(missed) * share)
        what = f"the wire does not pass {long:.1f} mm of the {name} line of {claim.segment}"
        findings.add(what, field=str(claim.segment))
    left = float(more.max(initial=0.0))
    if left > claim.left + GUIDE_SLACK:
        k = int(rows[int(np.argmax(more))])
        what = (
            f"at [{coordinates(places[k])}] mm of {claim.segment} a round wire leaves "
            f"{mm(min(left, 1.0)):.2f} mm or more on the part; allowed: {mm(claim.left):g} mm"
        )
        findings.add(what, in_mm(min(left, 1.0), claim.left), field=str(claim.segment))


def _marks(guide: FloatArray) -> tuple[FloatArray, float]:
    """Places (K, 3) along a guide line and the length [m] that each stands for."""
    step = np.linalg.norm(np.diff(guide, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    count = max(int(np.ceil(along[-1] / GUIDE_STEP)), 1)
    marks = np.linspace(0.0, along[-1], count + 1)
    places = np.stack([np.interp(marks, along, guide[:, i]) for i in range(3)], axis=1)
    return places, float(along[-1]) / len(places)


def _passed(points: FloatArray, joined: BoolArray, places: FloatArray) -> FloatArray:
    """How near (K,) [m] a sheet between two stations that belong together passes each place (K, 3)."""
    start, end = points[:, 0], points[:, -1]
    way = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    far = np.empty(len(places))
    chunk = max(1, _PAIRS_AT_ONCE // len(points))
    for low in range(0, len(places), chunk):
        relative = places[low : low + chunk, None] - start[None]
        off = relative - np.einsum("nti,ti->nt", relative, way)[..., None] * way[None]
        a, b = off[:, :-1], off[:, 1:]
        edge = b - a
        share = -dots(a, edge) / np.maximum(dots(edge, edge), 1e-30)
        distance = np.linalg.norm(a + np.clip(share, 0.0, 1.0)[..., None] * edge, axis=2)
        far[low : low + chunk] = np.where(joined, distance, np.inf).min(axis=1)
    return far


LEAST_SLIT = 1e-4
"""A slit that is in the part for less [m] is none."""


@rule("verify.slit", SlitsAllowed, LeadsFrom)
def slit(context: Context) -> Outcome:
    """The wire comes to a cut from where the problem says; a slit through the part is one plane for both
    ways, not longer there than it has to be, and takes nothing along other contours."""
    wires, findings = context.get(WIRES), Findings("verify.slit", context, worst=0.0)
    leads = [claim for claim in context.claims if isinstance(claim, LeadsFrom)]
    for claim in leads:
        _lead(findings, wires, claim)
    for wire in wires:
        for one in slits(context, wire).values():
            if one.used <= LEAST_SLIT:
                continue
            findings.highest(one.used / one.allowed, one.segment)
            for what, row, got, limit in _faults(one, one.allowed):
                at_wire(findings, wire, what, row, in_mm(got, limit))
    if not findings.where and not leads:
        return findings.outcome_without_value("no slit through the part and no stated lead")
    out = findings.outcome(float, "of what is allowed", 1.0)
    return dataclasses.replace(out, where=out.where or str(leads[0].segment))


def _lead(findings: Findings, wires: tuple[Wire, ...], claim: LeadsFrom) -> None:
    """What is wrong with the way in to a cut whose direction is stated."""
    context = findings.context
    surface = next((c for c in context.of(CutsSurface) if c.segment == claim.segment), None)
    setup = context.setup_of(claim)
    here = [wire for wire in wires if not wire.fault and wire.setup == setup]
    found = False
    for wire in here:
        way = None if surface is None else way_at(context, wire, surface, "in")
        if way is None:
            continue
        found = True
        off, k = off_lead(claim, wire, way)
        limit = claim.tolerance + SLIT_ROUNDING
        if off > limit:
            what = (
                f"the wire comes to {claim.segment} {mm(off):.2f} mm beside the stated direction; "
                f"allowed: {mm(limit):g} mm"
            )
            at_wire(findings, wire, what, k, in_mm(off, limit))
    if not found:
        findings.add(f"nothing leads to {claim.segment}", field=str(claim.segment))


def _faults(one: Slit, allowed: float) -> Iterator[tuple[str, int, float, float]]:
    """What is wrong with a slit: text, station, length [m] and what is allowed."""
    first, last = int(one.into.rows[0]), int(one.out.rows[0])
    if one.used > allowed:
        what = (
            f"the slit to {one.segment} is {mm(one.used):.1f} mm long in the part; allowed, as others are "
            f"shorter: {mm(allowed):.1f} mm"
        )
        yield what, first, one.used, allowed
    along = one.along
    if along > SLIT_ROUNDING:
        what = (
            f"the slit to {one.segment} runs {mm(along):.1f} mm farther beside another contour than it takes "
            f"to cross it; allowed: {mm(SLIT_ROUNDING):g} mm"
        )
        yield what, first, along, SLIT_ROUNDING
    wide = 2.0 * max(one.into.half, one.out.half) + SLIT_ROUNDING
    if one.apart > wide:
        what = (
            f"the wire leaves {one.segment} through the part {mm(one.apart):.2f} mm beside the slit by which "
            f"it came; allowed: {mm(wide):.2f} mm"
        )
        yield what, last, one.apart, wide
