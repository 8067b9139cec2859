"""Rules on milling: milled surfaces and spared faces, the path of the cutter, its feed and its spindle.

- verify.milled, verify.mill_gouge: surfaces that are milled, and faces that are spared.
- verify.mill_path: curves that the cutter follows; ruled surfaces along which it passes with its flank, leads
  included; faces over which it passes with its end.
- verify.mill_feed: the feed of the tip.
- verify.spindle: the spindle is up to speed where the cutter is in the block.
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
from planner.processes.milling.proof.path_following import (
    WRITTEN_ROUNDING_M,
    PathDeviation,
    max_feeds,
    rows_to_check,
)
from planner.processes.milling.proof.surface_passes import LeadResult, MilledFace, plan_area
from planner.processes.milling.proof.tool_motion import (
    BEND_FRACTION,
    MAX_FACE_POINTS,
    MAX_QUERY_DISTANCE_M,
    MILLING,
    GougeQuery,
    GougeResult,
    MillingMotion,
    ToolSolid,
    edge_slices,
    edge_step,
    evaluate_queries,
    in_block,
    may_touch,
    solids,
    track_distance,
)
from planner.proof.context import Context
from planner.proof.faces import subdivide
from planner.proof.findings import (
    Findings,
    evenly_spaced_rows,
    format_point_mm,
    measure_in_mm,
    measure_in_percent,
)
from planner.proof.replay.tool_track import ReplayedToolPath
from planner.proof.rule import MAX_FEED_FACTOR, RuleOutcome, mm, rule
from planner.proof.verdict import CutFace
from planner.runtime.executor import SERIAL
from planner.tooling import Mill

MILL_PATH = "verify.mill_path"
"""Code of the rule about paths of cutters."""
MAX_ISSUES = 50
"""Maximum number of issues of one segment."""


def _check_flanks(findings: Findings, milling: MillingMotion) -> None:
    """Check all passes along ruled surfaces and their leads, and add what is wrong to the findings."""
    for index, claim in milling.flanks:
        for number, segment in enumerate(claim.segments):
            track = milling.track(index, claim.arm, (segment.key,))
            if len(track.rows) < 2:
                findings.add(f"{segment} is not milled", field=str(segment))
                continue
            rows = rows_to_check(track.tip, track.axis, claim.tolerance)
            result = surface_passes.check_pass(claim, number, track.tip[rows], track.axis[rows])
            findings.note_highest(result.deviation.max(), segment)
            for fault in result.faults:
                findings.add(f"{segment}: {fault}", field=str(segment))
            for i in evenly_spaced_rows(result.deviation > 1.0, MAX_ISSUES):
                message = (
                    f"in {segment} the cutter is {result.criterion[i]}, {result.deviation[i]:.2f} times what "
                    "is "
                )
                message += f"allowed, {mm(claim.tolerance):g} mm"
                findings.add_at_sample(message, claim.arm, track.rows[rows[i]])
            for phase, _ in _axial_speeds(claim):
                _check_lead(findings, milling, index, claim, number, phase)


def _check_lead(
    findings: Findings, milling: MillingMotion, index: int, claim: MillsFlank, number: int, phase: Phase
) -> None:
    """Check the lead-in or lead-out (``phase``) of pass ``number`` along a ruled surface.

    If no length of the leads is stated, the cutter must enter and leave the block from the side, and not
    along its own axis.
    """
    segment = claim.segments[number].at(phase)
    lead = _find_lead(milling, index, claim, number, phase)
    if lead is None:
        findings.add(f"{segment} is missing", field=str(segment))
        return
    track, rows, result = lead
    for fault in result.faults:
        findings.add(f"{segment}: {fault}", field=str(segment))
    for i in evenly_spaced_rows(result.deviation > 1.0, MAX_ISSUES):
        message = (
            f"in {segment} the tip is neither on the straight continuation of its pass nor on the move up "
        )
        message += f"along the axis: deviation {result.deviation[i]:.2f} times what is allowed"
        findings.add_at_sample(message, claim.arm, track.rows[rows[i]])
    if claim.lead_length is None:
        stock = findings.context.stock_at(index)
        inside = in_block(track.tip, track.axis, claim.cutter.overhang, claim.cutter.radius, stock)[rows]
        for i in np.flatnonzero(inside & result.is_axial & ~result.is_lateral)[:1]:
            message = (
                f"in {segment} the cutter enters the block along its axis, but it has to enter from the side"
            )
            findings.add_at_sample(message, claim.arm, track.rows[rows[i]])


def _find_lead(
    milling: MillingMotion, index: int, claim: MillsFlank, number: int, phase: Phase
) -> tuple[ReplayedToolPath, IntArray, LeadResult] | None:
    """Return the track of a lead, the indices of its samples in the order away from the pass, and its result.

    The result compares the samples with the claim (`surface_passes.check_lead`).

    It is None if the motion does not have the pass or its lead.
    """
    segment = claim.segments[number]
    pass_track = milling.track(index, claim.arm, (segment.key,))
    track = milling.track(index, claim.arm, (segment.at(phase).key,))
    if len(pass_track.rows) < 2 or len(track.rows) < 2:
        return None
    forward, back = slice(None), slice(None, None, -1)
    order, outward = (forward, back) if phase == "in" else (back, forward)
    tip, axis = pass_track.tip[order], pass_track.axis[order]
    is_beyond = np.linalg.norm(tip[1:] - tip[0], axis=1) > surface_passes.END_LENGTH_M
    end_rows = [0, min(int(np.argmax(np.append(is_beyond, True))) + 1, len(tip) - 1)]
    rows = np.arange(len(track.rows))[outward]
    result = surface_passes.check_lead(
        claim, number, (tip[end_rows], axis[end_rows]), track.tip[rows], track.axis[rows]
    )
    return track, rows, result


def lead_feeds(milling: MillingMotion, index: int, segment: Segment, count: int) -> FloatArray:
    """Return the maximum feed (T - 1,) [m/s] from each of T samples of a flank cut's lead to the next.

    It is infinite if the segment is not such a lead. On the continuation of the surface the feed of the cut
    holds, on the move along the axis the speed of plunging or of rapid moves, and where both parts meet the
    larger one.

    Args:
        milling: Milling of the proof.
        index: Index of the setup.
        segment: Segment.
        count: Number of samples T.
    """
    out = np.full(count - 1, np.inf)
    for setup, claim in milling.flanks:
        for number, pass_segment in enumerate(claim.segments):
            for phase, axial_speed in _axial_speeds(claim):
                if setup != index or segment.key != pass_segment.at(phase).key:
                    continue
                found_lead = _find_lead(milling, index, claim, number, phase)
                if found_lead is None:
                    continue
                _, rows, lead = found_lead
                limit = np.empty(count)
                limit[rows] = np.where(
                    lead.is_axial,
                    np.where(lead.is_lateral, max(claim.feed, axial_speed), axial_speed),
                    claim.feed,
                )
                out = np.maximum(limit[1:], limit[:-1])
    return out


def _axial_speeds(claim: MillsFlank) -> tuple[tuple[Phase, float], ...]:
    """Return the maximum speed [m/s] of a tool along its axis in its lead-in and lead-out."""
    return (("in", claim.safe.plunge), ("out", claim.safe.rapid))


FACE_STEP_M = 1e-3
"""Distance of samples [m] at which a cutter is compared with its face."""


def _check_faces(findings: Findings, milling: MillingMotion) -> None:
    """Check all passes over faces, and add what is wrong to the findings."""
    for index, claim in milling.faces:
        face = MilledFace(claim)
        for segment in claim.segments:
            labels = (segment.key,)
            if not len(milling.track(index, claim.arm, labels).rows):
                findings.add(f"{segment} is not milled", field=str(segment))
                continue
            tip, axis, rows = milling.spaced_samples(index, claim.arm, labels, FACE_STEP_M, claim.tolerance)
            for criterion, deviation in face.deviations(tip, axis).items():
                findings.note_highest(deviation.max(), segment)
                for i in evenly_spaced_rows(deviation > 1.0, MAX_ISSUES):
                    message = (
                        f"in {segment} the cutter is {criterion}, {deviation[i]:.2f} times what is allowed, "
                    )
                    message += f"{mm(claim.tolerance):g} mm"
                    findings.add_at_sample(message, claim.arm, rows[i])


NOTHING_MILLED = "nothing is milled"
"""Reason why rules about milling examine nothing."""
FACET_ERROR_M = 5e-5
"""Penetration [m] that is allowed in addition, because facets and the track between samples are
approximations.
"""
_MAX_FACE_POINTS = 30_000
"""Approximate maximum number of points at which a milled surface is examined."""
_MIN_SPACING_M = 0.4e-3
"""Minimum distance of face points [m]."""
_GOUGE_SPACING_FACTOR = 1.6
"""Distance of samples for gouges as a factor of that of :func:`_sample_step`. Between them the tool may be
deeper by a quarter of the tolerance.
"""


@rule("verify.milled", MillsSurface)
def milled(context: Context) -> RuleOutcome:
    """The swept cutter makes a stated fraction of the required surface within the tolerance.

    The cutter is the one that is mounted, and nothing is milled that is not claimed.
    """
    milling, findings = context.get(MILLING), Findings("verify.milled", context)
    _check_unclaimed(findings, milling)
    faces: list[CutFace] = []
    for index, claim in milling.surfaces:
        findings.issues += _cutter_issues(milling, index, claim)
        face = cut_face(milling, index, claim)
        faces.append(face)
        if face.share < claim.min_fraction:
            message = (
                f"{face.title}: {100 * face.share:.2f} % of the surface are within "
                f"{mm(claim.tolerance):g} mm, required {100 * claim.min_fraction:g} %"
            )
            findings.add(message, measure_in_percent(face.share, claim.min_fraction), field=face.title)
    if not faces:
        return findings.outcome_without_value(NOTHING_MILLED)
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    percent, required_percent, issues = 100 * worst.share, 100 * worst.wanted_share, tuple(findings.issues)
    return RuleOutcome(
        issues, percent, required_percent, "% within tolerance", worst.title, faces=tuple(faces)
    )


def cut_face(milling: MillingMotion, index: int, claim: MillsSurface) -> CutFace:
    """Return the simulated surface with its deviation from a claimed surface.

    The deviation is positive where the swept cutting part leaves material, negative where it cuts too deep,
    and NaN where it never comes near.

    Args:
        milling: Milling of the proof.
        index: Index of the setup.
        claim: Claim on the surface.
    """
    corners = claim.vertices[claim.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    size = max(float(np.sqrt(area.sum() / _MAX_FACE_POINTS)) * 2.0, _MIN_SPACING_M)
    pieces, _ = subdivide(corners, size)
    area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    points = pieces.mean(axis=1)
    if claim.margin:
        area_in_plan = plan_area(corners, claim.margin + 0.5 * size)
        is_inside = shapely.contains_xy(area_in_plan, points[:, 0], points[:, 1])
        points, area = points[is_inside], area[is_inside]
    labels = tuple(segment.key for segment in claim.segments)
    track = milling.track(index, claim.arm, labels)
    solid = solids(claim.cutter)[0]
    tip, axis, _ = track.spaced(_sample_step(solid, claim.tolerance), BEND_FRACTION * claim.tolerance)
    distances, _ = track_distance(points, tip, axis, solid)
    is_near = distances < MAX_QUERY_DISTANCE_M
    fraction = float(
        area[is_near & (np.abs(distances) <= claim.tolerance)].sum() / max(float(area.sum()), 1e-30)
    )
    weight = max(float(area[is_near].sum()), 1e-30)
    rms = float(np.sqrt((area[is_near] * distances[is_near] ** 2).sum() / weight))
    largest = float(np.abs(distances[is_near]).max(initial=0.0))
    deviation = np.where(is_near, distances, np.nan)
    first, *more = claim.segments
    measure = (claim.tolerance, fraction, claim.min_fraction, rms, largest)
    return CutFace(first, points, deviation, area, *measure, more=len(more))


def _sample_step(solid: ToolSolid, tolerance: float) -> float:
    """Return the distance between samples [m] of a round tool along its path.

    Between samples at the distance s a tool of radius r leaves ridges of the height s^2 / (8 r), here a tenth
    of the tolerance.
    """
    radius = solid.radius if solid.corner == 0.0 else 0.5 * solid.radius
    return float(np.clip(np.sqrt(0.8 * radius * tolerance), 0.3e-3, 3e-3))


@rule("verify.mill_gouge", SparesPart)
def mill_gouge(context: Context) -> RuleOutcome:
    """Cutter, shank, holder and spindle never enter a face of the part by more than the tolerance.

    It holds at every instant, leads included. A cutter that engraves may be as deep as required.
    """
    milling, findings = context.get(MILLING), Findings("verify.mill_gouge", context)
    queries = [(index, claim, list(_gouge_queries(milling, index, claim))) for index, claim in milling.spared]
    results = _evaluate_queries(milling, [query for _, _, group in queries for query, _ in group])
    for index, claim, group in queries:
        findings.issues += _cutter_issues(milling, index, claim)
        for query, rows in group:
            solid, allowed, result = query.solid, query.allowed, next(results)
            if isinstance(result, int):
                findings.issues.append(_too_many(claim, solid, result, query.spacing))
                findings.excess, findings.limit = max(findings.excess, 0.0), allowed
                findings.where = str(claim.segments[0])
                continue
            segment = context.motion.node_segment[context.motion.node[rows[result.min_sample]]]
            findings.note_excess(-result.min_distance, allowed, f"{solid.name} in {segment}")
            for i in range(0, len(result.distances), max(1, len(result.distances) // MAX_ISSUES)):
                message = f"the {solid.name} is {mm(-result.distances[i]):.3f} mm in the part at "
                message += f"{format_point_mm(result.points[i])} mm, allowed {mm(allowed):.3f} mm"
                findings.add_at_sample(
                    message, claim.arm, rows[result.samples[i]], measure_in_mm(-result.distances[i], allowed)
                )
    return findings.excess_outcome(NOTHING_MILLED)


def _gouge_queries(
    milling: MillingMotion, index: int, claim: SparesPart
) -> Iterator[tuple[GougeQuery, IntArray]]:
    """Yield the queries of a spared face, one for each piece and sharp edge of the tool.

    Each comes with the samples of the motion for its positions.
    """
    labels = tuple(part.key for segment in claim.segments for part in segment.all_phases)
    track = milling.track(index, claim.arm, labels)
    if not len(track.rows):
        return
    pieces = solids(claim.cutter)
    for solid, sharp in [
        *((piece, False) for piece in pieces),
        *((piece, True) for piece in edge_slices(pieces)),
    ]:
        is_near = may_touch(claim.vertices, track.tip, track.axis, solid)
        if sharp and not is_near:
            continue
        step = (
            edge_step(claim.tolerance)
            if sharp
            else _GOUGE_SPACING_FACTOR * _sample_step(solid, claim.tolerance)
        )
        tip, axis, rows = milling.spaced_samples(index, claim.arm, labels, step, claim.tolerance)
        allowed = claim.tolerance + FACET_ERROR_M + (claim.depth if solid.name == "cutter" else 0.0)
        measure = (claim.tolerance, allowed)
        yield GougeQuery(claim.vertices, claim.faces, solid, sharp, is_near, tip, axis, *measure), rows


def _evaluate_queries(milling: MillingMotion, queries: Sequence[GougeQuery]) -> Iterator[GougeResult | int]:
    """Yield the results of queries in order.

    Every other query is submitted to the executor, which may run it in another process.
    """
    submitted = (milling.executor if len(queries) > 1 else SERIAL).submit(evaluate_queries, queries[1::2])
    results = list(evaluate_queries(queries[::2]))
    for k, result in enumerate(results):
        yield result
        if 2 * k + 1 < len(queries):
            yield next(submitted)


def _too_many(claim: SparesPart, solid: ToolSolid, count: int, size: float) -> Issue:
    """Return the issue of a face that is too large to be checked as closely as required.

    Nothing is proven of such a face.
    """
    message = (
        f"near the {solid.name} the face would have to be checked at {count} points, {mm(size):.2f} mm "
        f"apart, allowed {MAX_FACE_POINTS}. Split the cut, or use a larger tolerance"
    )
    name = str(claim.segments[0])
    return Issue("verify.mill_gouge", message, field=name, value=float(count), limit=float(MAX_FACE_POINTS))


@rule("verify.mill_path", MillsAlong, MillsProgram, Engraves, MillsFlank, MillsOver)
def mill_path(context: Context) -> RuleOutcome:
    """Tip and axis follow the required path within the tolerances, leads included.

    The path is that of the G-code file, the curves, the ruled surface or the face. All of it is passed, and
    nothing else is milled.
    """
    milling, findings = context.get(MILLING), Findings(MILL_PATH, context, worst=0.0)
    findings.issues += context.reading_issues
    _check_flanks(findings, milling)
    _check_faces(findings, milling)
    for index, claim in milling.curves:
        track = milling.track(index, claim.arm, (claim.segment.key,))
        comparison = milling.path_deviation(index, claim)
        if comparison is None and _is_short(claim):
            continue
        if comparison is None:
            findings.add(f"{claim.segment} is not milled", field=str(claim.segment))
            continue
        rows, result = comparison
        distance, angle = result.distance, result.angle
        allowed_distance = claim.tolerance + WRITTEN_ROUNDING_M
        findings.note_highest(max(distance.max() / allowed_distance, angle.max() / claim.turn), claim.segment)
        for i in evenly_spaced_rows((distance > allowed_distance) | (angle > claim.turn), MAX_ISSUES):
            message = (
                f"in {claim.segment} the tip is {mm(distance[i]):.3f} mm off its "
                f"curve{_line_text(claim, result, i)} and the axis {np.rad2deg(angle[i]):.2f} deg, allowed "
                f"{mm(claim.tolerance):g} mm, {np.rad2deg(claim.turn):.2f} deg"
            )
            findings.add_at_sample(
                message, claim.arm, track.rows[rows[i]], measure_in_mm(distance[i], claim.tolerance)
            )
        if result.missed_count:
            fault = f"{result.missed_count} of {len(claim.tip)} points are never passed, or not in order"
            findings.add(f"{claim.segment}: {fault}", field=str(claim.segment))
    out = findings.outcome(float, "of what is allowed", 1.0 if findings.where else None)
    return dataclasses.replace(out, nothing="" if findings.where else NOTHING_MILLED)


def _is_short(claim: MillsAlong) -> bool:
    """Return whether a path is so short that standing still follows it."""
    tips = float(np.linalg.norm(claim.tip - claim.tip[0], axis=1).max())
    return tips <= claim.tolerance and float((claim.axis @ claim.axis[0]).min()) >= np.cos(claim.turn)


def _line_text(claim: MillsAlong, deviation: PathDeviation, i: int) -> str:
    """Return a text with the line of the G-code file at sample ``i``, "" if the path comes from no file."""
    if claim.line is None:
        return ""
    point = min(int(np.searchsorted(deviation.point_positions, deviation.position[i])), len(claim.line) - 1)
    return f" by line {claim.line[point]} of {claim.file}"


def _check_unclaimed(findings: Findings, milling: MillingMotion) -> None:
    """Report segments that mill without a claim, and segments with a claim on a surface that never occur."""
    motion, arm = findings.context.motion, findings.context.job.tasks[0].arm.name
    seen: set[str] = set()
    for node, (segment, name) in enumerate(zip(motion.node_segment, motion.node_label, strict=True)):
        if segment.kind == MILL and name not in milling.labels and name not in seen:
            message = f"the programs mill in {segment}, but the problem has no claim on it"
            findings.add_at_node(message, arm, node)
        seen.add(name)
    for name in sorted({segment.key for _, c in milling.surfaces for segment in c.segments} - seen):
        findings.add(f"{name} is never milled", field=name)


def _cutter_issues(milling: MillingMotion, index: int, claim: MillsSurface | SparesPart) -> list[Issue]:
    """Return an issue if the mounted cutter differs from the claimed one."""
    mounted, claimed = milling.mounted_cutter(index, claim.arm), claim.cutter
    if (
        mounted is not None
        and mounted.kind == claimed.kind
        and all(
            np.allclose(getattr(mounted, name), getattr(claimed, name), atol=1e-9)
            for name in ("radius", "corner", "flute", "overhang", "shank", "holder_outline")
            if np.shape(getattr(mounted, name)) == np.shape(getattr(claimed, name))
        )
        and np.shape(mounted.holder_outline) == np.shape(claimed.holder_outline)
    ):
        return []
    message = f"the cutter of the tool of {claim.arm} in setup {index + 1} differs from the claimed one"
    return [Issue("verify.milled", message, arm=claim.arm)]


@rule("verify.mill_feed", FeedWindow, MillsAlong, MillsProgram, Engraves, MillsFlank, MillsOver)
def mill_feed(context: Context) -> RuleOutcome:
    """The tip never exceeds the maximum feed at its position on the path, leads included."""
    milling, findings = context.get(MILLING), Findings("verify.mill_feed", context, worst=0.0)
    claims = [claim for claim in context.feeds if claim.segment.kind == MILL]
    for claim in claims:
        index = context.setup_of(claim)
        arm = _milling_arm(milling, index, claim)
        track = milling.track(index, arm, (claim.segment.key,)) if arm else None
        if track is None or not len(track.joined):
            continue
        time = np.diff(track.time)
        speed = np.linalg.norm(np.diff(track.tip, axis=0), axis=1) / np.maximum(time, 1e-6)
        speed = np.where(track.joined, speed, 0.0)
        path_limit = _path_feeds(milling, index, claim.segment, len(speed) + 1)
        path_limit = np.minimum(path_limit, lead_feeds(milling, index, claim.segment, len(speed) + 1))
        limit = np.minimum(path_limit, claim.upper)
        fraction = speed / limit
        findings.note_highest(fraction.max(), claim.segment, MAX_FEED_FACTOR)
        for k in evenly_spaced_rows(fraction > MAX_FEED_FACTOR, MAX_ISSUES):
            speed_mm, allowed_mm = mm(float(speed[k])), mm(float(limit[k]))
            message = f"the tip moves at {speed_mm:.2f} mm/s in {claim.segment}, allowed {allowed_mm:g}"
            findings.add_at_sample(message, arm, track.rows[k + 1], (speed_mm, allowed_mm, "mm/s"))
    with_feed = {claim.segment.key for claim in claims}
    for label in sorted(_milled_labels(context) - with_feed):
        findings.add(f"{label} has no feed", field=label)
    out = findings.outcome(float, "of the feed")
    return out if findings.measured else dataclasses.replace(out, worst=None, nothing=NOTHING_MILLED)


def _path_feeds(milling: MillingMotion, index: int, segment: Segment, count: int) -> FloatArray:
    """Return the maximum feed (T - 1,) [m/s] from each of T samples of a segment to the next, by its claimed
    path.

    It is infinite without a claimed path.
    """
    out = np.full(count - 1, np.inf)
    for setup, claim in milling.curves:
        if setup != index or claim.segment.key != segment.key or len(claim.feed) < 2:
            continue
        comparison = milling.path_deviation(index, claim)
        if comparison is not None:
            out = np.minimum(out, max_feeds(claim, comparison[0], comparison[1], count))
    return out


@rule("verify.spindle", ContactOnlyIn, MillsProgram)
def spindle(context: Context) -> RuleOutcome:
    """The cutter is in the block only in segments that mill, after its spindle was on for long enough."""
    milling, findings = context.get(MILLING), Findings("verify.spindle", context)
    motion = context.motion
    seen = False
    for index, setup in enumerate(context.setups):
        claims = [claim for claim in context.setup_claims[index].contacts if MILL in claim.kinds]
        for arm in setup.cell.arms:
            if not isinstance(arm.tool, Mill) or arm.name not in motion.tcp:
                continue
            rows, node, time = milling.samples_in_block(index, arm.name, arm.tool.cutter)
            # The spindle in segments of these kinds is checked by a rule of another process.
            kinds_with_rule = [
                claim.spindle_rule[1]
                for claim in context.claims
                if claim.spindle_rule and claim.spindle_rule[0] == arm.name
            ]
            if kinds_with_rule:
                other = ~np.isin(motion.node_kind[motion.node[rows]], kinds_with_rule)
                rows, node, time = rows[other], node[other], time[other]
            if not len(rows):
                continue
            seen = True
            for i in np.flatnonzero(motion.node_kind[motion.node[rows]] != MILL)[:1]:
                message = (
                    f"the cutter is in the block in {motion.node_label[node[i]]}, where nothing is milled"
                )
                findings.add_at_sample(message, arm.name, rows[i])
            if not claims:
                message = f"{arm.name} mills in setup {index + 1}, which has no claim on the spindle"
                findings.add_at_sample(message, arm.name, rows[0])
            for claim in claims:
                on = motion.signal_on_time(claim.signal, context.controller_task_names((arm.name,)), time)
                for i in np.flatnonzero(on < claim.heat_up - 1e-6)[:1]:
                    duration = f"for {on[i]:.1f} s" if on[i] >= 0.0 else "not"
                    message = f"the cutter is in the block and {claim.signal} is {duration} on, required "
                    message += f"{claim.heat_up:g} s"
                    measure = (float(max(on[i], 0.0)), claim.heat_up, "s")
                    findings.add_at_sample(message, arm.name, rows[i], measure)
    return findings.outcome_without_value("" if seen else NOTHING_MILLED)


def _milling_arm(milling: MillingMotion, index: int, claim: FeedWindow) -> str:
    """Return the name of the arm that mills a segment according to the claims of a setup, "" if none does."""
    segment = claim.segment.key
    for setup, claim_of_setup in milling.by_setup:
        names = (
            (claim_of_setup.segment,) if isinstance(claim_of_setup, MillsAlong) else claim_of_setup.segments
        )
        if setup == index and any(segment == part.key for name in names for part in name.all_phases):
            return claim_of_setup.arm
    return ""


def _milled_labels(context: Context) -> set[str]:
    return {str(segment) for segment in context.motion.node_segment if segment.kind == MILL}
