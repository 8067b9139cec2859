"""Rules on two forming tools in one sheet: gap, support of a border, opposite tool, accumulative forming.

verify.gap, border, opposite (the tool that follows). verify.adsif: both tools compared with the required face
and the response table.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.processes.forming.claims import FollowsOpposite, FormsByTable, SupportsBorder, ToolGap
from planner.processes.forming.proof.accumulative import AccumulativePath, TableSolution, solve_table
from planner.processes.forming.proof.face import NearestPoints, ProofFace
from planner.processes.forming.proof.forming_facts import (
    FORMING,
    TOUCH_TOLERANCE_M,
    TRACK_CHORD_FRACTION,
    GapTrack,
)
from planner.processes.forming.proof.rules.tool import MAX_SHOWN_ISSUES, NOTHING_FORMED_REASON, first_of_runs
from planner.processes.forming.proof.tracks import ToolTrack, straight_pieces
from planner.proof.context import Context
from planner.proof.findings import (
    Findings,
    format_point_mm,
    measure_in_degrees,
    measure_in_mm,
    measure_in_percent,
)
from planner.proof.rule import RuleOutcome, mm, rule

MAX_CHECK_ROTATION_RAD = np.deg2rad(0.5)
"""Maximum rotation [rad] of a tool between two checks."""
MAX_BORDER_CUT_M = 1e-4
"""Maximum depth [m] to which straight moves between targets may cut a curved border."""


@rule("verify.gap", ToolGap)
def check_gap(context: Context) -> RuleOutcome:
    """At and between targets the gap between two forming tools is the required thickness of the sheet between
    them, and they face each other as required; for two controllers, whichever is one step ahead.
    """
    forming, findings = context.get(FORMING), Findings("verify.gap", context)
    for gap_track in forming.gaps:
        claim, tool_track, low, high = gap_track.claim, gap_track.track, gap_track.low, gap_track.high
        pieces = gap_track.pieces
        first, last, distance_error = pieces.first, pieces.last, pieces.distance_error
        if not len(first):
            message = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            findings.add(message, field=str(claim.segment))
            continue
        start, end = np.searchsorted(gap_track.knots, first), np.searchsorted(gap_track.knots, last)
        min_distance, max_distance = _distance_range(tool_track, first, last)
        radii = sum(claim.radii)
        # within a piece the required gap is between those at its ends
        excess = max_distance - radii - np.maximum(high[start], high[end])
        shortfall = np.minimum(low[start], low[end]) - (min_distance - radii)
        error = np.maximum(excess, shortfall) + distance_error
        findings.note_excess(error, claim.tolerance, claim.segment)
        for i in first_of_runs(error > claim.tolerance):
            direction = "wide" if excess[i] >= shortfall[i] else "narrow"
            message = f"the gap is {mm(error[i]):.3f} mm too {direction} in {claim.segment}"
            message += f", allowed: {mm(claim.tolerance):g} mm"
            findings.add_at_sample(
                message, claim.arms[0], tool_track.rows[last[i]], measure_in_mm(error[i], claim.tolerance)
            )
        _check_facing(findings, gap_track)
        _check_unsynchronised_gap(findings, gap_track)
    return findings.excess_outcome("no gap is claimed" if forming.formed else NOTHING_FORMED_REASON)


def _distance_range(tool_track: ToolTrack, first: IntArray, last: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum and maximum distance (K,) [m] between the centres of both tools on each of K pieces.

    A piece is straight for both tools, from row ``first[k]`` of the track to row ``last[k]``. The tools are
    those of the first two arms of the track.
    """
    start = tool_track.centre[first, 0] - tool_track.centre[first, 1]
    end = tool_track.centre[last, 0] - tool_track.centre[last, 1]
    change = end - start
    fraction = -dots(start, change) / np.maximum(dots(change, change), 1e-30)
    minimum = np.linalg.norm(start + np.clip(fraction, 0.0, 1.0)[:, None] * change, axis=1)
    return minimum, np.maximum(np.linalg.norm(start, axis=1), np.linalg.norm(end, axis=1))


def _check_facing(findings: Findings, gap_track: GapTrack) -> None:
    """Check at the knots that the line through both centres is between the face's normal and the vertical."""
    claim, tool_track, knots = gap_track.claim, gap_track.track, gap_track.knots
    angle = _line_angle(tool_track, knots, gap_track.face, gap_track.nearest, claim.side, upright=True)
    for k in first_of_runs(angle > claim.turn):
        message = (
            f"in {claim.segment} the line of the tools is {np.rad2deg(angle[k]):.2f} deg off the directions "
            f"between the face's normal and the vertical, allowed: {np.rad2deg(claim.turn):g} deg"
        )
        findings.add_at_sample(
            message, claim.arms[0], tool_track.rows[knots[k]], measure_in_degrees(angle[k], claim.turn)
        )


_KNOTS_AT_ONCE = 16_384
"""Number of knots that are processed at once, to bound memory."""


def _line_angle(
    tool_track: ToolTrack, knots: IntArray, face: ProofFace, nearest: NearestPoints, side: int, upright: bool
) -> FloatArray:
    """Return the angle (K,) [rad] of the line through both centres to the face's normal.

    It is measured as in `_direction_angle`.
    """
    between = tool_track.centre[knots, 0] - tool_track.centre[knots, 1]
    between /= np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-12)
    out = np.empty(len(knots))
    for start in range(0, len(knots), _KNOTS_AT_ONCE):
        chunk = np.arange(start, min(start + _KNOTS_AT_ONCE, len(knots)))
        out[chunk] = _direction_angle(
            between[chunk], tool_track.centre[knots[chunk], 0], face, nearest.subset(chunk), side, upright
        )
    return out


def _direction_angle(
    line: FloatArray, centre: FloatArray, face: ProofFace, nearest: NearestPoints, side: int, upright: bool
) -> FloatArray:
    """Return the angle (K,) [rad] of directions to the face's normal.

    If ``upright``, it is the angle to the nearest direction between the normal and the vertical instead.

    The smallest angle over all points that the ball touches is returned. Each point has two normals: the
    direction from it to the ball's centre, and the normal of the smooth face that the facets represent. The
    normals of the facets themselves are not used, because they jump from one facet to the next.

    Where the ball touches two points at once, the sheet extends around it from one to the other. Its normal
    is then any direction between the normals at both points. This occurs in a sharp crease, and where facets
    represent a hollow that is hardly wider than the ball.

    Args:
        line: Unit directions (K, 3).
        centre: Centres (K, 3) [m] of the forming ball.
        face: Face.
        nearest: Points of the face nearest to the centres.
        side: +1 if the forming ball is above the face, -1 below.
        upright: Whether directions between the normal and the vertical are permitted, too.
    """
    angle = np.full(len(centre), np.inf)
    smooth = side * np.einsum("nk,nkd->nd", nearest.weight, face.smooth_normals[nearest.triangle])
    for normal in (centre[nearest.row] - nearest.tied, smooth):
        unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        end = np.broadcast_to(np.array([0.0, 0.0, float(side)]), unit.shape) if upright else unit
        np.minimum.at(angle, nearest.row, _arc_angle(line[nearest.row], unit, end))
        first, second = _most_different_normals(unit, nearest.row, len(centre))
        between = (
            _triangle_angle(line, first, second, float(side)) if upright else _arc_angle(line, first, second)
        )
        angle = np.minimum(angle, between)
    return angle


def _most_different_normals(unit: FloatArray, row: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return for each of K balls the two unit normals (K, 3) at its touched points that differ the most.

    ``unit`` (M, 3) are the normals at all touched points, ``row`` (M,) their balls, ascending.
    """
    first = np.searchsorted(row, np.arange(count))
    first_index = first
    for _ in range(2):  # the farthest from the first vector, and the farthest from that
        cosine = dots(unit, unit[first_index[row]])
        order = np.lexsort((cosine, row))
        first_index, second_index = order[first], first_index
    return unit[first_index], unit[second_index]


def _triangle_angle(line: FloatArray, a: FloatArray, b: FloatArray, up: float) -> FloatArray:
    """Return the angles (K,) [rad] of unit vectors ``line`` (K, 3) to spherical triangles, 0 inside of them.

    The corners of the triangles are ``a`` (K, 3), ``b`` (K, 3) and the vertical, +1 or -1 along z.
    """
    c = np.broadcast_to(np.array([0.0, 0.0, up]), a.shape)
    orientation = np.sign(dots(np.cross(a, b), c))
    arcs = (a, b), (b, c), (c, a)
    inside = (np.min([orientation * dots(np.cross(i, j), line) for i, j in arcs], axis=0) >= 0.0) & (
        orientation != 0.0
    )
    return np.asarray(np.where(inside, 0.0, np.min([_arc_angle(line, i, j) for i, j in arcs], axis=0)))


def _rotation_rows(tool_track: ToolTrack, knots: IntArray) -> IntArray:
    """Return the rows of a track at which the direction of its second arm's tool is checked.

    They are the knots, and a row after each ``MAX_CHECK_ROTATION_RAD`` by which that tool rotates.
    """
    step = tool_track.axis_steps(1)
    has_rotated = (
        np.diff(np.floor(np.concatenate([[0.0], np.cumsum(step)]) / MAX_CHECK_ROTATION_RAD), prepend=0.0)
        > 0.0
    )
    return np.unique(np.concatenate([knots, np.flatnonzero(has_rotated & tool_track.is_forming)]))


def _arc_angle(line: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles (N,) [rad] of unit vectors to arcs.

    Each is the angle to the nearest direction on the shorter arc between two other directions.
    """
    ends = [np.arccos(np.clip(dots(line, end), -1.0, 1.0)) for end in (first, second)]
    pole = np.cross(first, second)
    length = np.linalg.norm(pole, axis=1)
    pole /= np.maximum(length, 1e-12)[:, None]
    arc_distance = np.arcsin(np.clip(np.abs(dots(line, pole)), 0.0, 1.0))
    is_after_start = dots(np.cross(first, line), pole) >= 0.0
    is_before_end = dots(np.cross(line, second), pole) >= 0.0
    within = is_after_start & is_before_end & (length > 1e-9)
    nearest = np.minimum(ends[0], ends[1])
    return np.asarray(np.where(within, np.minimum(arc_distance, nearest), nearest))


def _check_unsynchronised_gap(findings: Findings, gap_track: GapTrack) -> None:
    """Check the gap of two controllers that synchronise by handshake, only at some targets.

    Between two of these meetings either arm may be ahead, so the gap is checked for all positions of one arm
    combined with all positions of the other.
    """
    if findings.context.problem.cell.controller.sync != "handshake":
        return
    claim, tool_track, knots = gap_track.claim, gap_track.track, gap_track.knots
    low, high = gap_track.low, gap_track.high
    radii, count = sum(claim.radii), 0
    for rows in _meeting_intervals(findings.context, tool_track, knots):
        # tools as commanded, with springback shifts, because these differ between two instants
        forming, other = tool_track.commanded_tcp(0, knots[rows]), tool_track.commanded_tcp(1, knots[rows])
        distance = np.linalg.norm(forming[:, None] - other[None], axis=2) - radii
        error = np.maximum(distance - high[rows, None], low[rows, None] - distance).max(axis=1)
        k = int(np.argmax(error))
        if error[k] > claim.handshake and count < MAX_SHOWN_ISSUES:
            count += 1
            message = (
                f"with one arm ahead in {claim.segment} the gap is {mm(error[k]):.3f} mm off, "
                f"allowed between meetings: {mm(claim.handshake):g} mm"
            )
            row = tool_track.rows[knots[rows[k]]]
            findings.add_at_sample(message, claim.arms[0], row, measure_in_mm(error[k], claim.handshake))


def _meeting_intervals(context: Context, tool_track: ToolTrack, knots: IntArray) -> Iterator[IntArray]:
    """Yield the indices of the knots from one meeting of two controllers to the next, both included."""
    motion = context.motion
    node = motion.node[tool_track.rows[knots]]
    stage = motion.node_stage[node]
    for number in np.unique(stage):
        stage_knots = np.flatnonzero(stage == number)
        stage_nodes = np.flatnonzero(motion.node_stage == number)
        ends = np.asarray(context.job.stages[number].ends, dtype=np.int64)
        interval = np.searchsorted(ends, node[stage_knots] - stage_nodes[0])
        for part in np.split(stage_knots, np.flatnonzero(np.diff(interval)) + 1):
            # the knot before the first one is the previous meeting
            yield part if part[0] == stage_knots[0] else np.concatenate([[part[0] - 1], part])


@rule("verify.border", SupportsBorder)
def check_border(context: Context) -> RuleOutcome:
    """The tool that supports a border stays on it within the tolerance, and never cuts across it."""
    forming, findings = context.get(FORMING), Findings("verify.border", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, SupportsBorder):
            continue
        tool_track = forming.get_track(claim.segment, index, (claim.arm,))
        pieces = straight_pieces(
            tool_track, min(TRACK_CHORD_FRACTION * claim.tolerance, 0.1 * MAX_BORDER_CUT_M)
        )
        is_forming = tool_track.is_forming[pieces.first]
        rows = np.unique(np.concatenate([pieces.first[is_forming], pieces.last[is_forming]]))
        if not len(rows):
            findings.add(
                f"{claim.arm} never supports the border of {claim.segment}", field=str(claim.segment)
            )
            continue
        points, row_index = _densify(tool_track.centre[rows, 0])
        piece = np.minimum(
            np.searchsorted(row_index, np.arange(len(points)), side="right") - 1, len(rows) - 1
        )
        distance, inside = _border_distance(points, claim.border)
        deviation = float(pieces.deviation.max(initial=0.0))
        for excess, limit, description in (
            (distance + deviation, claim.tolerance, "off the border"),
            (np.where(inside, distance, 0.0) - deviation, MAX_BORDER_CUT_M, "inside of the border"),
        ):
            findings.note_excess(excess, limit, claim.segment)
            for i in first_of_runs(excess > limit):
                message = f"{claim.arm} is {mm(excess[i]):.3f} mm {description} of {claim.segment}"
                findings.add_at_sample(
                    message, claim.arm, tool_track.rows[rows[piece[i]]], measure_in_mm(excess[i], limit)
                )
    return findings.excess_outcome("no border is supported")


MAX_EDGE_PIECE_M = 0.002
"""Maximum length [m] of the pieces into which an edge is divided."""
_NEAREST_MARKS = 4
"""Number of nearest pieces of edges among which the nearest edge is searched."""


def _densify(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Insert points into a polyline (N, 3) [m], so that they are at most ``MAX_EDGE_PIECE_M`` apart.

    Returns all points (M, 3), and the index (N,) of each given point among them.
    """
    move = np.diff(points, axis=0)
    count = np.maximum(np.ceil(np.linalg.norm(move, axis=1) / MAX_EDGE_PIECE_M).astype(np.int64), 1)
    first = np.concatenate([[0], np.cumsum(count)])
    piece = np.repeat(np.arange(len(move)), count)
    fraction = (np.arange(len(piece)) - first[piece]) / count[piece]
    return np.concatenate([points[piece] + fraction[:, None] * move[piece], points[-1:]]), first


def _border_distance(points: FloatArray, border: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return the distances (N,) [m] of points (N, 3) from a closed polyline (K, 3).

    The second result is whether the points are inside of it in plan. A point is inside if a ray along x
    crosses the polyline an odd number of times.
    """
    a = border
    b = np.roll(border, -1, axis=0)
    distance, inside = np.empty(len(points)), np.zeros(len(points), dtype=np.bool_)
    along = b - a
    square = np.maximum(dots(along, along), 1e-30)
    marks, owner = _edge_marks(a, b)
    neighbours = np.asarray(cKDTree(marks).query(points, k=min(_NEAREST_MARKS, len(marks)))[1]).reshape(
        len(points), -1
    )
    distance[:] = np.inf
    for column in owner[neighbours].T:
        rest = points - a[column]
        fraction = np.clip(dots(rest, along[column]) / square[column], 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(rest - fraction[:, None] * along[column], axis=1))
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) * len(a) // 2_000_000)):
        y = points[rows, 1, None]
        spans = (a[None, :, 1] > y) != (b[None, :, 1] > y)
        y_step = np.where(spans, b[:, 1] - a[:, 1], 1.0)
        x = a[None, :, 0] + (y - a[None, :, 1]) / y_step * (b[None, :, 0] - a[None, :, 0])
        inside[rows] = (np.sum(spans & (points[rows, 0, None] < x), axis=1) % 2).astype(np.bool_)
    return distance, inside


def _edge_marks(a: FloatArray, b: FloatArray) -> tuple[FloatArray, IntArray]:
    """Middles (M, 3) of pieces of straight edges from ``a`` to ``b`` (K, 3), and the edge (M,) of each.

    Pieces are at most ``MAX_EDGE_PIECE_M`` long. The edges of the few marks nearest to a point are compared
    with it; if the nearest edge is missed, the distance is too large, so never too small.
    """
    count = np.maximum(np.ceil(np.linalg.norm(b - a, axis=1) / MAX_EDGE_PIECE_M).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(a)), count)
    fraction = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[owner]
    return a[owner] + fraction[:, None] * (b - a)[owner], owner


@rule("verify.opposite", FollowsOpposite)
def check_opposite(context: Context) -> RuleOutcome:
    """A tool that follows the forming one across the sheet is at the required distance, along the face's
    normal, and points at it from between that normal and the vertical.
    """
    forming, findings = context.get(FORMING), Findings("verify.opposite", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, FollowsOpposite):
            continue
        tool_track, arm = forming.get_track(claim.segment, index, claim.arms), claim.arms[1]
        pieces = straight_pieces(tool_track, TRACK_CHORD_FRACTION * claim.tolerance)
        is_forming = tool_track.is_forming[pieces.first]
        first, last, deviation = (
            pieces.first[is_forming],
            pieces.last[is_forming],
            pieces.deviation[is_forming],
        )
        if not len(first):
            message = f"{' and '.join(claim.arms)} never work on {claim.segment} together"
            findings.add(message, field=str(claim.segment))
            continue
        min_distance, max_distance = _distance_range(tool_track, first, last)
        error = np.maximum(max_distance - claim.distance, claim.distance - min_distance) + 2.0 * deviation
        findings.note_excess(error, claim.tolerance, claim.segment)
        for i in first_of_runs(error > claim.tolerance):
            message = f"{arm} is {mm(error[i]):.3f} mm off its distance in {claim.segment}"
            findings.add_at_sample(
                message, arm, tool_track.rows[last[i]], measure_in_mm(error[i], claim.tolerance)
            )
        knots = np.unique(np.concatenate([first, last]))
        face = ProofFace(claim.vertices, claim.faces, 0.01)
        nearest = face.nearest(tool_track.centre[knots, 0], TOUCH_TOLERANCE_M)
        angle = _line_angle(tool_track, knots, face, nearest, claim.side, upright=False)
        for i in first_of_runs(angle > claim.turn):
            message = f"{arm} is {np.rad2deg(angle[i]):.2f} deg off the normal in {claim.segment}"
            findings.add_at_sample(
                message, arm, tool_track.rows[knots[i]], measure_in_degrees(angle[i], claim.turn)
            )
        rows = _rotation_rows(tool_track, knots)
        centre = tool_track.centre[rows, 0]
        nearest = face.nearest(centre, TOUCH_TOLERANCE_M)
        pointing_error = _direction_angle(
            tool_track.axis(1, rows), centre, face, nearest, claim.side, upright=True
        )
        for i in first_of_runs(pointing_error > claim.aim):
            message = (
                f"{arm} points {np.rad2deg(pointing_error[i]):.2f} deg off the directions between the face's "
                f"normal and the vertical in {claim.segment}, allowed: {np.rad2deg(claim.aim):g} deg"
            )
            findings.add_at_sample(
                message, arm, tool_track.rows[rows[i]], measure_in_degrees(pointing_error[i], claim.aim)
            )
    return findings.excess_outcome("no tool follows another")


MAX_TOOL_LINE_ANGLE_RAD = np.deg2rad(1.0)
"""Maximum angle [rad], seen along z, between the line through both tools and the direction in which the wall
goes down: faces consist of facets.
"""
MAX_LOOP_GAP_FRACTION = 0.75
"""Maximum distance of points of the wall from the path, as a fraction of the distance between loops there.

It is half if all loops are evenly spaced, and 1 where a loop is missing.
"""
CHORD_ERROR_M = 1e-5
"""Additional distance [m] by which straight moves may miss points."""
MAX_BACKWARD_LOOPS = 1.5
"""Maximum height, as a multiple of that between loops, by which the path may go back toward the inside."""
MAX_PLAN_DEVIATION_M = 1e-4
"""Maximum distance [m] in plan, on approach and retreat in the sheet, from where the segment starts
or ends.
"""
LENGTH_TOLERANCE_FRACTION = 0.02
"""Relative tolerance of lengths compared with those that a table is valid for."""
MIN_TURN_FRACTION = 0.9
"""Minimum fraction of the area swept around the middle of the feature that has the required direction."""


@rule("verify.adsif", FormsByTable)
def check_adsif(context: Context) -> RuleOutcome:
    """In accumulative forming both tools are, at and between targets, where the response table requires them
    for the wall of the required face at each point, at the sheet's level, and pass all of it from the inside
    out; on approach and retreat they press into the sheet nowhere else.
    """
    forming, findings = context.get(FORMING), Findings("verify.adsif", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, FormsByTable):
            continue
        path = AccumulativePath(context, claim, index)
        if len(path.rows) < 2:
            message = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            findings.add(message, field=str(claim.segment))
            continue
        table = solve_table(claim.table, claim.prefer)
        _check_conditions(findings, claim, table)
        table_distance, plane_distance, touched = path.table_fit(table)
        level = path.start - claim.projection + claim.radii[0]
        height_error = np.abs(path.centre[:, 0][:, 2] - level)
        across = np.hypot(*(path.centre[:, 1] - path.centre[:, 0])[:, :2].T)
        error = np.maximum(
            np.maximum(table_distance, height_error),
            plane_distance - np.sin(MAX_TOOL_LINE_ANGLE_RAD) * across,
        )
        error = error + CHECK_ERROR_FRACTION * claim.tolerance
        findings.note_excess(error, claim.tolerance, claim.segment)
        for i in first_of_runs(error > claim.tolerance):
            _add_position_issue(findings, path, i, float(error[i]), bool(height_error[i] > claim.tolerance))
        _check_coverage(findings, path, touched)
        _check_tilt(findings, path)
        _check_approach_retreat(findings, path)
    return findings.excess_outcome("no table is followed")


CHECK_ERROR_FRACTION = 0.1
"""Maximum deviation of the path between checks, as a fraction of the tolerance."""


def _add_position_issue(
    findings: Findings, path: AccumulativePath, check_row: int, error: float, is_height_error: bool
) -> None:
    """Add an issue on a position ``error`` [m] at index ``check_row`` of the checked rows.

    ``is_height_error`` tells that the forming ball is at a wrong height. An infinite error means that it
    touches no wall in the table.
    """
    claim = path.claim
    if not np.isfinite(error):
        message = f"{claim.arms[0]} touches no wall of the required face, or one that is not in the table"
    elif is_height_error:
        message = f"{claim.arms[0]} is {mm(error):.3f} mm off the level at which it forms"
    else:
        message = f"{claim.arms[1]} is {mm(error):.3f} mm off the table's position for the wall there"
    message += f" in {claim.segment}, allowed: {mm(claim.tolerance):g} mm"
    row = path.track.rows[path.rows[check_row]]
    findings.add_at_sample(message, claim.arms[0], row, measure_in_mm(min(error, 1.0), claim.tolerance))


def _check_conditions(findings: Findings, claim: FormsByTable, table: TableSolution) -> None:
    """Check that the conditions for which the table is valid are those of the sheet and the tools."""
    claimed_lengths = {
        "thickness_mm": claim.thickness,
        "tool_radius_mm": claim.radii[0],
        "pitch_mm": claim.pitch,
        "projection_mm": claim.projection,
    }
    if table.conditions.get("metal") != claim.metal or claim.radii[0] != claim.radii[1]:
        message = f"the response table is valid for {table.conditions.get('metal')} and tools of one radius"
        findings.add(message, field=str(claim.segment))
    for name, value in claimed_lengths.items():
        table_value = table.conditions.get(name, "nan")
        if not abs(mm(value) - float(table_value)) <= LENGTH_TOLERANCE_FRACTION * float(table_value):
            message = f"the response table is valid for {name} {table_value}, not for {mm(value):g}"
            findings.add(message, (mm(value), float(table_value), None), field=str(claim.segment))


def _check_coverage(findings: Findings, path: AccumulativePath, touched: FloatArray) -> None:
    """Check that the forming ball passes all of the wall, from the inside out, in the required direction.

    A point of the wall is missed if it is farther from the path than adjacent loops permit. The path may go
    back toward the inside by at most `MAX_BACKWARD_LOOPS` loops. ``touched`` (K, 3) [m] are the points that
    the ball touches, NaN where it touches no wall.
    """
    claim = path.claim
    touched = touched[np.isfinite(touched[:, 0])]
    if len(touched) < 2:
        return
    points, distance, loop_distance = path.wall_distances(touched)
    loop_height = path.loop_height(touched[:, 2])
    is_last_loop = path.start - points[:, 2] < path.loop_height(points[:, 2])
    # loops start from the inside, whole pitches apart; at the last loop, chords of a round part deviate to
    # the inside by up to sag, which no further loop compensates
    allowed = (
        np.where(is_last_loop, 1.0 + claim.sag / claim.pitch, MAX_LOOP_GAP_FRACTION) * loop_distance
        + CHORD_ERROR_M
    )
    k = int(np.argmax(distance - allowed))
    if distance[k] > allowed[k]:
        position = format_point_mm(points[k] * [1.0, 1.0, float(claim.side)])
        message = f"{claim.segment} misses the wall at ({position}) mm by {mm(distance[k]):.3f} mm"
        message += f", loops are {mm(loop_distance[k]):.3f} mm apart there"
        findings.add(message, measure_in_mm(distance[k], allowed[k]), field=str(claim.segment))
    back = np.maximum.accumulate(touched[:, 2]) - touched[:, 2]
    if (back > MAX_BACKWARD_LOOPS * loop_height).any():
        k = int(np.argmax(back - MAX_BACKWARD_LOOPS * loop_height))
        message = f"{claim.segment} goes back toward the inside by {mm(back[k]):.3f} mm of height"
        value, limit, _ = measure_in_mm(back[k], MAX_BACKWARD_LOOPS * loop_height[k])
        findings.add(message, (value, limit, None), field=str(claim.segment))
    middle = points.mean(axis=0)
    radius_vector, move = (touched - middle)[:-1, :2], np.diff(touched[:, :2], axis=0)
    swept_area = claim.turning * (radius_vector[:, 0] * move[:, 1] - radius_vector[:, 1] * move[:, 0])
    turn_fraction = float(np.maximum(swept_area, 0.0).sum() / max(float(np.abs(swept_area).sum()), 1e-30))
    if turn_fraction < MIN_TURN_FRACTION:
        message = (
            f"{claim.segment} goes round in the wrong direction for {100 * (1 - turn_fraction):.0f} % of its "
            "path"
        )
        findings.add(message, measure_in_percent(turn_fraction, MIN_TURN_FRACTION), field=str(claim.segment))


def _check_tilt(findings: Findings, path: AccumulativePath) -> None:
    """Check that both tools are square to the sheet."""
    claim = path.claim
    for column, toward in ((0, -1.0), (1, 1.0)):
        tilt = np.arccos(np.clip(toward * path.axis(column)[path.rows, 2], -1.0, 1.0))
        for i in first_of_runs(tilt > claim.lean):
            arm = claim.arms[column]
            message = f"{arm} is tilted by {np.rad2deg(tilt[i]):.2f} deg in {claim.segment}"
            message += f", allowed: {np.rad2deg(claim.lean):.2f} deg"
            findings.add_at_sample(
                message, arm, path.track.rows[path.rows[i]], measure_in_degrees(tilt[i], claim.lean)
            )


def _check_approach_retreat(findings: Findings, path: AccumulativePath) -> None:
    """Check the approach and retreat of both tools.

    A ball may be in the sheet only straight above or below the point at which its segment starts or ends, and
    no deeper than there.
    """
    claim, track = path.claim, path.track
    forming_rows = np.flatnonzero(track.is_forming)
    first, last = max(int(forming_rows[0]) - 1, 0), int(forming_rows[-1])
    centres = path.all_centres
    for column, flat, outward in ((0, path.start, 1.0), (1, path.start - claim.thickness, -1.0)):
        for rows, end_row in ((np.arange(first), first), (np.arange(last + 1, len(centres)), last)):
            if not len(rows):
                continue
            centre, end_centre = centres[rows, column], centres[end_row, column]
            inside = claim.radii[column] - outward * (centre[:, 2] - flat)  # depth of the ball in the sheet
            deepest = claim.radii[column] - outward * (end_centre[2] - flat)
            plan_distance = np.hypot(*(centre - end_centre)[:, :2].T)
            is_wrong = (inside > claim.tolerance) & (
                (plan_distance > MAX_PLAN_DEVIATION_M) | (inside > deepest + claim.tolerance)
            )
            for i in first_of_runs(is_wrong):
                arm = claim.arms[column]
                message = (
                    f"on approach or retreat of {claim.segment} {arm} is {mm(inside[i]):.3f} mm in the "
                    f"sheet, {mm(plan_distance[i]):.3f} mm away from where it starts or ends"
                )
                findings.add_at_sample(message, arm, track.rows[rows[i]])
