"""Rules on straight wires.

- verify.bow: the clamps stay outside the block.
- verify.kerf: the slot has the required width at the actual speeds.
- verify.rulings: the wire is half a kerf from the guide lines of the surface.
- verify.slit: direction of lead-ins, and length of slits in the part.
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
from planner.processes.hotwire.proof.cut_surface import unreachable_distance
from planner.processes.hotwire.proof.rules.cut_part import CUT_FACES
from planner.processes.hotwire.proof.rules.wire import at_wire
from planner.processes.hotwire.proof.slits import SLIT_ROUNDING_M, Slit, find_slits, lead_deviation, lead_path
from planner.processes.hotwire.proof.wire_motion import WIRES, WireMotion, straight_claims
from planner.proof.context import Context
from planner.proof.findings import Findings, format_point_mm, measure_in_mm
from planner.proof.replay.motion import wire_speed, with_start_stations
from planner.proof.rule import MAX_FEED_FACTOR, RuleOutcome, mm, rule
from planner.tooling import Bow, Tool

CLAMP_ROUNDING_M = 1e-4
"""Amount [m] that rounded targets may take from a margin."""
GUIDE_TOLERANCE_M = 1e-4
"""Tolerance [m] of the distance at which a wire passes points of a guide line.

It is added to half a kerf and the tolerance of the surface.
"""
BOW_TOLERANCE_M = 1e-6
"""Allowed deviation [m] of a claimed wire from the wire of the bow."""
GUIDE_POINT_SPACING_M = 0.002
"""Spacing [m] of the points of a guide line that the wire must pass."""
MAX_RULING_STEP_M = 0.001
"""Largest path [m] of the wire's ends between checks of its rulings."""
_PAIR_BATCH_SIZE = 400_000
"""Number of pairs of a point and a piece of a guide that are processed in one batch."""


@rule("verify.bow", StraightWire)
def bow(context: Context) -> RuleOutcome:
    """Wherever a straight wire is in the foam, both its clamps are outside by the required length of wire.
    The wire is that of the mounted bow.
    """
    findings = Findings("verify.bow", context, worst=np.inf)
    for wire in context.get(WIRES):
        claim = wire.claim
        if not isinstance(claim, StraightWire) or wire.fault:
            continue
        if not _is_wire_of_tool(claim, context.setups[wire.setup].cell.arm(claim.arm).tool):
            message = f"the wire of the tool of {claim.arm} in setup {wire.setup + 1} is not the claimed one"
            findings.add(message, arm=claim.arm)
        margin = max(c.margin for c in straight_claims(context.setup_claims[wire.setup])[claim.arm])
        free_length = free_lengths(wire.points[:, 0], wire.points[:, -1], context.stock_at(wire.setup))
        shorter_length = free_length.min(axis=1)
        in_foam = np.flatnonzero(np.isfinite(shorter_length))
        findings.note_lowest(shorter_length[in_foam].min(initial=np.inf), limit=margin)
        for k in in_foam[shorter_length[in_foam] < margin - CLAMP_ROUNDING_M][:50]:
            message = (
                f"the {'start' if free_length[k, 0] < free_length[k, 1] else 'end'} of the wire is free for "
                f"{mm(shorter_length[k]):.2f} mm outside the block; allowed: {mm(margin):g} mm or more"
            )
            at_wire(findings, wire, message, k, measure_in_mm(shorter_length[k], margin))
    return findings.outcome(mm, "mm", nothing="no straight wire in the foam")


def _is_wire_of_tool(claim: StraightWire, tool: Tool) -> bool:
    """Return whether a claimed wire is that of the tool, a bow, in either direction."""
    if not isinstance(tool, Bow):
        return False
    wire = tool.wire
    half = 0.5 * wire.size[1] * wire.pose[:3, 2]
    ends = np.stack([wire.pose[:3, 3] - half, wire.pose[:3, 3] + half])
    to_tcp = inverse(tool.tcp)
    ends = ends @ to_tcp[:3, :3].T + to_tcp[:3, 3]
    claimed = np.stack([claim.start, claim.end])
    deviation = min(float(np.abs(ends - claimed).max()), float(np.abs(ends[::-1] - claimed).max()))
    return deviation <= BOW_TOLERANCE_M and abs(wire.size[0] - claim.radius) <= BOW_TOLERANCE_M


def free_lengths(start: FloatArray, end: FloatArray, stock: Stock) -> FloatArray:
    """Return the lengths (T, 2) [m] of straight wires between each clamp and the block.

    A length is 0 for a clamp inside the block. Both are infinite for a wire that does not meet the block.

    Args:
        start: Starts of the wires (T, 3) [m].
        end: Ends of the wires (T, 3) [m].
        stock: The block.
    """
    vector = end - start
    length = np.linalg.norm(vector, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        first_side, second_side = (stock.lower - start) / vector, (stock.upper - start) / vector
    is_parallel = vector == 0.0
    within = (start >= stock.lower) & (start <= stock.upper)
    low = np.where(is_parallel, np.where(within, -np.inf, np.inf), np.minimum(first_side, second_side)).max(
        axis=1
    )
    high = np.where(is_parallel, np.where(within, np.inf, -np.inf), np.maximum(first_side, second_side)).min(
        axis=1
    )
    is_hit = (low < high) & (high > 0.0) & (low < 1.0)
    free = np.stack([np.clip(low, 0.0, 1.0), np.clip(1.0 - high, 0.0, 1.0)], axis=1) * length[:, None]
    return np.asarray(np.where(is_hit[:, None], free, np.inf))


@rule("verify.kerf", KerfWithin)
def kerf(context: Context) -> RuleOutcome:
    """The slot has the required width wherever the wire passes the part's surface, at its speed there."""
    faces, wires = context.get(CUT_FACES), context.get(WIRES)
    findings = Findings("verify.kerf", context, worst=0.0)
    for claim in context.claims_of(KerfWithin):
        passed = [face for face in faces if face.segment.key == claim.segment.key]
        speeds = [face.speed[np.isfinite(face.speed)] for face in passed]
        if not passed:
            speeds = [_speeds_in_foam(context, wire, claim) for wire in wires if not wire.fault]
        speed = np.concatenate([*speeds, np.zeros(0)])
        if not len(speed):
            message = f"{claim.segment} is not cut, so that its slot has no width"
            findings.add(message, field=str(claim.segment))
            continue
        width = claim.kerf.at(speed)
        # ramps and corners of the replay may differ from the planned speed as far as the feed may
        narrow = claim.kerf.at(speed / MAX_FEED_FACTOR) < claim.lower
        wide = claim.kerf.at(speed * MAX_FEED_FACTOR) > claim.upper
        fraction = np.maximum(width / claim.upper, claim.lower / np.maximum(width, 1e-9))
        findings.note_highest(fraction.max(), claim.segment, 1.0)
        for is_faulty, word in ((narrow, "narrow: the wire drags"), (wide, "wide: the foam burns")):
            if is_faulty.any():
                k = int(np.argmax(np.where(is_faulty, fraction, 0.0)))
                message = (
                    f"at {mm(speed[k]):.2f} mm/s the slot of {claim.segment} is {mm(width[k]):.3f} mm "
                    f"{word}; allowed: {mm(claim.lower):g} to {mm(claim.upper):g} mm"
                )
                measure = measure_in_mm(width[k], claim.upper if is_faulty is wide else claim.lower)
                findings.add(message, measure, field=str(claim.segment))
    out = findings.outcome(float, "of the bounds")
    return dataclasses.replace(out, nothing="" if findings.where else "no such claim")


def _speeds_in_foam(context: Context, wire: WireMotion, claim: KerfWithin) -> FloatArray:
    """Return the speeds (K,) [m/s] of a wire's points inside the block in a segment."""
    is_in_foam = (wire.labels == claim.segment.key)[:, None] & wire.inside
    return np.asarray(wire_speed(wire.points, context.motion.time[wire.sample], wire.inside)[is_in_foam])


@rule("verify.rulings", FollowsRulings)
def rulings(context: Context) -> RuleOutcome:
    """All along a ruled surface, at and between targets, the straight wire is half a kerf from both guide
    lines, on their outer side, and passes all of both as closely as a round wire can.
    """
    findings = Findings("verify.rulings", context)
    for claim in context.claims_of(FollowsRulings):
        label = claim.segment.key
        is_cut = False
        for wire in context.get(WIRES):
            stations = np.flatnonzero(wire.labels == label)
            if wire.fault or wire.setup != context.setup_of(claim) or len(stations) < 2:
                continue
            is_cut = True
            speed = wire_speed(wire.points, context.motion.time[wire.sample], wire.inside)
            points, speed, stations = interpolate_moves(wire.points, speed, stations)
            normal = guide_normals(claim)
            for name, guide, side in zip(("start", "end"), (claim.start, claim.end), normal, strict=True):
                deviation, half = guide_deviation(points, speed, guide, side, claim)
                findings.note_highest(deviation.max(), claim.segment, claim.tolerance)
                for i in np.flatnonzero(deviation > claim.tolerance)[:20]:
                    message = (
                        f"the distance of the wire to the {name} line of {claim.segment} deviates by "
                        f"{mm(deviation[i]):.3f} mm; allowed: {mm(claim.tolerance):g} mm"
                    )
                    at_wire(
                        findings, wire, message, stations[i], measure_in_mm(deviation[i], claim.tolerance)
                    )
                sheet_stations = np.flatnonzero(with_start_stations(wire.labels == label))
                passes = wire.points[sheet_stations], np.diff(sheet_stations) == 1
                _add_missed_points(findings, claim, name, guide, float(half.max()), passes)
        if not is_cut:
            findings.add(f"{claim.segment} is not cut", field=str(claim.segment))
    out = findings.outcome(mm, "mm")
    return out if findings.where else dataclasses.replace(out, worst=0.0, nothing="no such claim")


def interpolate_moves(
    points: FloatArray, speed: FloatArray, rows: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return wires at stations and on the straight moves to them from the previous ones.

    The move to the first station of each visit is left out, because it belongs to the previous segment.

    Args:
        points: Wires (T, P, 3) [m].
        speed: Their speeds (T, P) [m/s].
        rows: Indices of the stations (S,).

    Returns:
        Wires (N, P, 3) [m] and speeds (N, P) [m/s] at most ``MAX_RULING_STEP_M`` apart, and the index of the
        station at the end of each one's move (N,).
    """
    previous = np.maximum(rows - 1, 0)
    step_length = np.linalg.norm(points[rows][:, [0, -1]] - points[previous][:, [0, -1]], axis=2).max(axis=1)
    # the move to the first station of a visit belongs to the previous segment
    step_length[np.concatenate([[True], np.diff(rows) > 1])] = 0.0
    count = np.maximum(np.ceil(step_length / MAX_RULING_STEP_M).astype(np.int64), 1)
    row_index = np.repeat(np.arange(len(rows)), count)
    step = np.arange(len(row_index)) - np.repeat(np.cumsum(count) - count, count)
    fraction = ((step + 1) / count[row_index])[:, None]
    a, b = previous[row_index], rows[row_index]
    wires = points[a] + fraction[..., None] * (points[b] - points[a])
    return wires, speed[a] + fraction * (speed[b] - speed[a]), b


def guide_normals(claim: FollowsRulings) -> tuple[FloatArray, FloatArray]:
    """Return unit normals (M - 1, 3) away from the part along both guide lines.

    They are 0 where a line has no length.
    """
    along = claim.end - claim.start
    along = along[:-1] + along[1:]
    out = []
    for guide in (claim.start, claim.end):
        normal = np.cross(np.diff(guide, axis=0), along)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        out.append(np.where(size > 1e-14, normal / np.maximum(size, 1e-14), 0.0))
    return out[0], out[1]


def _points_outward(
    vector: FloatArray, k: IntArray, fraction: FloatArray, normal: FloatArray, closed: bool
) -> BoolArray:
    """Return whether vectors (T, 3) from points on a guide line point away from the part.

    At a corner of the guide line the sum of the normals of both its pieces decides.

    Args:
        vector: Vectors (T, 3).
        k: Index of the piece of the guide line on which each point is (T,).
        fraction: Position of each point on its piece, 0 to 1 (T,).
        normal: Unit normals of the pieces away from the part, 0 for pieces without length (M - 1, 3).
        closed: Whether the guide line is closed.
    """
    pieces = np.flatnonzero(normal.any(axis=1))
    if not len(pieces):
        return np.ones(len(k), dtype=np.bool_)
    # where only the other guide line turns a blunt edge, pieces have no length: their neighbours' normals
    # count
    previous = np.searchsorted(pieces, np.where(fraction <= 0.0, k - 1, k), side="right") - 1
    following = np.searchsorted(pieces, np.where(fraction >= 1.0, k + 1, k), side="left")
    if closed:
        previous, following = previous % len(pieces), following % len(pieces)
    else:
        previous, following = np.clip(previous, 0, len(pieces) - 1), np.clip(following, 0, len(pieces) - 1)
    return np.asarray(dots(vector, normal[pieces[previous]] + normal[pieces[following]]) >= -1e-12)


def guide_deviation(
    points: FloatArray, speed: FloatArray, guide: FloatArray, normal: FloatArray, claim: FollowsRulings
) -> tuple[FloatArray, FloatArray]:
    """Return the deviation (T,) [m] of wires from half their kerf at a guide line, and half the kerf (T,).

    The deviation is the difference between the signed distance of the wire from the guide line, negative on
    the part's side, and half the kerf. The kerf is that at the point of the wire that is nearest to the guide
    line.

    Args:
        points: Wires (T, P, 3) [m].
        speed: Their speeds (T, P) [m/s].
        guide: Guide line (M, 3) [m].
        normal: Normals on the side on which the wire has to be (M - 1, 3).
        claim: Claim on the rulings.
    """
    closed = bool(np.abs(guide[0] - guide[-1]).max() < 1e-9)
    start = points[:, 0]
    vector = points[:, -1] - start
    length = np.linalg.norm(vector, axis=1)
    along = vector / length[:, None]
    deviation, half = np.zeros(len(points)), np.zeros(len(points))
    step = max(1, _PAIR_BATCH_SIZE // max(len(guide), 1))
    for low in range(0, len(points), step):
        batch = slice(low, low + step)
        relative = guide[None] - start[batch, None]
        on_wire = np.einsum("tmi,ti->tm", relative, along[batch])
        across = relative - on_wire[..., None] * along[batch, None]
        a, b = across[:, :-1], across[:, 1:]
        edge = b - a
        fraction = -dots(a, edge) / np.maximum(dots(edge, edge), 1e-30)
        fraction = np.clip(fraction, 0.0, 1.0)
        distance = np.linalg.norm(a + fraction[..., None] * edge, axis=2)
        row, k = np.arange(len(a)), np.argmin(distance, axis=1)
        wire_position = on_wire[row, k] + fraction[row, k] * (on_wire[row, k + 1] - on_wire[row, k])
        at = np.clip(wire_position / length[batch], 0.0, 1.0) * (points.shape[1] - 1)
        left = np.minimum(at.astype(np.int64), points.shape[1] - 2)
        batch_speed = speed[batch]
        local_speed = batch_speed[row, left] + (at - left) * (
            batch_speed[row, left + 1] - batch_speed[row, left]
        )
        half[batch] = 0.5 * claim.kerf.at(local_speed)
        outward = -(a[row, k] + fraction[row, k, None] * edge[row, k])
        sign = np.where(_points_outward(outward, k, fraction[row, k], normal, closed), 1.0, -1.0)
        deviation[batch] = np.abs(sign * distance[row, k] - half[batch])
    return deviation, half


def _add_missed_points(
    findings: Findings,
    claim: FollowsRulings,
    name: str,
    guide: FloatArray,
    half: float,
    passes: tuple[FloatArray, BoolArray],
) -> None:
    """Report points of a guide line that the wire does not pass as closely as a round wire can.

    Points at which a round wire leaves more foam than is allowed are also reported.

    Args:
        findings: Findings of the rule.
        claim: Claim on the rulings.
        name: Name of the guide line, ``start`` or ``end``.
        guide: Guide line (M, 3) [m].
        half: Half the widest slot [m].
        passes: Wires (T, P, 3) [m], and whether each wire and the next one are joined (T - 1,).
    """
    points, point_length = _guide_points(guide)
    distance = _sheet_distance(*passes, points)
    within = claim.tolerance + GUIDE_TOLERANCE_M
    distant = np.flatnonzero(distance > half + within)
    unreachable = unreachable_distance(claim, points[distant], half)
    missed = distant[distance[distant] > half + within + unreachable]
    if len(missed):
        missed_length = mm(len(missed) * point_length)
        message = f"the wire does not pass {missed_length:.1f} mm of the {name} line of {claim.segment}"
        findings.add(message, field=str(claim.segment))
    remaining = float(unreachable.max(initial=0.0))
    if remaining > claim.max_left + GUIDE_TOLERANCE_M:
        k = int(distant[int(np.argmax(unreachable))])
        message = (
            f"at [{format_point_mm(points[k])}] mm of {claim.segment} a round wire leaves "
            f"{mm(min(remaining, 1.0)):.2f} mm or more on the part; allowed: {mm(claim.max_left):g} mm"
        )
        findings.add(message, measure_in_mm(min(remaining, 1.0), claim.max_left), field=str(claim.segment))


def _guide_points(guide: FloatArray) -> tuple[FloatArray, float]:
    """Return even points (K, 3) along a guide line with its ends, and the length [m] that each represents."""
    step = np.linalg.norm(np.diff(guide, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    count = max(int(np.ceil(along[-1] / GUIDE_POINT_SPACING_M)), 1)
    marks = np.linspace(0.0, along[-1], count + 1)
    points = np.stack([np.interp(marks, along, guide[:, i]) for i in range(3)], axis=1)
    return points, float(along[-1]) / len(points)


def _sheet_distance(points: FloatArray, joined: BoolArray, queries: FloatArray) -> FloatArray:
    """Return the distance (K,) [m] from each point (K, 3) to the sheet that a straight wire sweeps.

    The sheet consists of the moves between joined stations.
    """
    start, end = points[:, 0], points[:, -1]
    directions = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    nearest = np.empty(len(queries))
    chunk = max(1, _PAIR_BATCH_SIZE // len(points))
    for low in range(0, len(queries), chunk):
        relative = queries[low : low + chunk, None] - start[None]
        transverse = relative - np.einsum("nti,ti->nt", relative, directions)[..., None] * directions[None]
        a, b = transverse[:, :-1], transverse[:, 1:]
        edge = b - a
        fraction = -dots(a, edge) / np.maximum(dots(edge, edge), 1e-30)
        distance = np.linalg.norm(a + np.clip(fraction, 0.0, 1.0)[..., None] * edge, axis=2)
        nearest[low : low + chunk] = np.where(joined, distance, np.inf).min(axis=1)
    return nearest


MIN_SLIT_LENGTH_M = 1e-4
"""Minimum length [m] of a slit in the part. Shorter ones do not count."""


@rule("verify.slit", SlitsAllowed, LeadsFrom)
def slit(context: Context) -> RuleOutcome:
    """The wire reaches a cut from the direction that the problem states. A slit through the part is one plane
    for both leads, is no longer there than necessary, and removes nothing along other contours.
    """
    wires, findings = context.get(WIRES), Findings("verify.slit", context, worst=0.0)
    leads = [claim for claim in context.claims if isinstance(claim, LeadsFrom)]
    for claim in leads:
        _add_lead_issues(findings, wires, claim)
    for wire in wires:
        for found_slit in find_slits(context, wire).values():
            if found_slit.length_in_part <= MIN_SLIT_LENGTH_M:
                continue
            findings.note_highest(found_slit.length_in_part / found_slit.max_length, found_slit.segment)
            for message, station, value, limit in _slit_faults(found_slit, found_slit.max_length):
                at_wire(findings, wire, message, station, measure_in_mm(value, limit))
    if not findings.where and not leads:
        return findings.outcome_without_value("no slit through the part and no stated lead")
    out = findings.outcome(float, "of what is allowed", 1.0)
    return dataclasses.replace(out, where=out.where or str(leads[0].segment))


def _add_lead_issues(findings: Findings, wires: tuple[WireMotion, ...], claim: LeadsFrom) -> None:
    """Report a lead-in that deviates from its stated direction, or that is missing."""
    context = findings.context
    surface = next((c for c in context.claims_of(CutsSurface) if c.segment == claim.segment), None)
    setup = context.setup_of(claim)
    setup_wires = [wire for wire in wires if not wire.fault and wire.setup == setup]
    has_lead = False
    for wire in setup_wires:
        lead_in = None if surface is None else lead_path(context, wire, surface, "in")
        if lead_in is None:
            continue
        has_lead = True
        deviation, k = lead_deviation(claim, wire, lead_in)
        limit = claim.tolerance + SLIT_ROUNDING_M
        if deviation > limit:
            message = (
                f"the wire reaches {claim.segment} {mm(deviation):.2f} mm from the stated direction; "
                f"allowed: {mm(limit):g} mm"
            )
            at_wire(findings, wire, message, k, measure_in_mm(deviation, limit))
    if not has_lead:
        findings.add(f"nothing leads to {claim.segment}", field=str(claim.segment))


def _slit_faults(slit: Slit, allowed: float) -> Iterator[tuple[str, int, float, float]]:
    """Yield the faults of a slit: message, index of the station, value [m] and limit [m]."""
    first, last = int(slit.into.rows[0]), int(slit.out.rows[0])
    if slit.length_in_part > allowed:
        message = (
            f"the slit to {slit.segment} is {mm(slit.length_in_part):.1f} mm long in the part; allowed, "
            f"because shorter slits exist: {mm(allowed):.1f} mm"
        )
        yield message, first, slit.length_in_part, allowed
    along = slit.excess_length_alongside
    if along > SLIT_ROUNDING_M:
        message = (
            f"the slit to {slit.segment} runs {mm(along):.1f} mm farther along another contour than a "
            f"crossing needs; allowed: {mm(SLIT_ROUNDING_M):g} mm"
        )
        yield message, first, along, SLIT_ROUNDING_M
    max_deviation = 2.0 * max(slit.into.half, slit.out.half) + SLIT_ROUNDING_M
    if slit.lead_out_deviation > max_deviation:
        message = (
            f"the wire leaves {slit.segment} through the part {mm(slit.lead_out_deviation):.2f} mm from the "
            f"slit by which it came; allowed: {mm(max_deviation):.2f} mm"
        )
        yield message, last, slit.lead_out_deviation, max_deviation
