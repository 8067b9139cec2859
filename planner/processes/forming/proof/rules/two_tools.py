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
        first, last, distance_error = (
            gap_track.pieces.first,
            gap_track.pieces.last,
            gap_track.pieces.distance_error,
        )
        if not len(first):
            what = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            findings.add(what, field=str(claim.segment))
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
            way_off = "wide" if excess[i] >= shortfall[i] else "narrow"
            what = f"the gap is {mm(error[i]):.3f} mm too {way_off} in {claim.segment}"
            what += f", allowed: {mm(claim.tolerance):g} mm"
            findings.add_at_sample(
                what, claim.arms[0], tool_track.rows[last[i]], measure_in_mm(error[i], claim.tolerance)
            )
        _check_facing(findings, gap_track)
        _check_unsynchronised_gap(findings, gap_track)
    return findings.excess_outcome("no gap is claimed" if forming.formed else NOTHING_FORMED_REASON)


def _distance_range(tool_track: ToolTrack, first: IntArray, last: IntArray) -> tuple[FloatArray, FloatArray]:
    """Minimum and maximum distance (K,) [m] of both centres within the straight pieces from one row to
    another.
    """
    start = tool_track.centre[first, 0] - tool_track.centre[first, 1]
    end = tool_track.centre[last, 0] - tool_track.centre[last, 1]
    change = end - start
    fraction = -dots(start, change) / np.maximum(dots(change, change), 1e-30)
    minimum = np.linalg.norm(start + np.clip(fraction, 0.0, 1.0)[:, None] * change, axis=1)
    return minimum, np.maximum(np.linalg.norm(start, axis=1), np.linalg.norm(end, axis=1))


def _check_facing(findings: Findings, gap_track: GapTrack) -> None:
    """Check at the knots that the line of the centres is between the face's normal and the vertical."""
    claim, tool_track, knots = gap_track.claim, gap_track.track, gap_track.knots
    angle = _line_angle(tool_track, knots, gap_track.face, gap_track.nearest, claim.side, upright=True)
    for k in first_of_runs(angle > claim.turn):
        what = (
            f"in {claim.segment} the line of the tools is {np.rad2deg(angle[k]):.2f} deg off the directions "
            f"between the face's normal and the vertical, allowed: {np.rad2deg(claim.turn):g} deg"
        )
        findings.add_at_sample(
            what, claim.arms[0], tool_track.rows[knots[k]], measure_in_degrees(angle[k], claim.turn)
        )


_KNOTS_AT_ONCE = 16_384
"""Knots that are processed at once."""


def _line_angle(
    tool_track: ToolTrack, knots: IntArray, face: ProofFace, nearest: NearestPoints, side: int, upright: bool
) -> FloatArray:
    """Angle (K,) [rad] of the line of the centres to the face's normal, as in `_direction_angle`."""
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
    """Angle (K,) [rad] of directions ``line`` (K, 3) to the face's normal, or, with ``upright``, to all
    directions between that and the vertical. ``centre`` (K, 3) [m] are the centres of the forming ball.

    Of all points that the ball touches, one has to fit: by the direction from there to the ball's centre, or
    by the normal of the smooth face that the facets represent, whose own normals flicker.

    Where the ball touches two points at once, the sheet extends around it from one to the other, so its
    normal there is any between theirs: the line may be along those, or between them and the vertical. This
    occurs in a sharp crease, and where facets represent a hollow that is hardly wider than the ball.
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
    """The two normals (K, 3) of touched points that differ the most: ``unit`` (M, 3), their ``row`` (M,) of
    ``count`` K.
    """
    first = np.searchsorted(row, np.arange(count))
    first_index = first
    for _ in range(2):  # the farthest from the first vector, and the farthest from that
        cosine = dots(unit, unit[first_index[row]])
        order = np.lexsort((cosine, row))
        first_index, second_index = order[first], first_index
    return unit[first_index], unit[second_index]


def _triangle_angle(line: FloatArray, a: FloatArray, b: FloatArray, up: float) -> FloatArray:
    """Angles (K,) [rad] of unit vectors ``line`` (K, 3) to spherical triangles with the corners ``a``, ``b``
    (K, 3) and the vertical.
    """
    c = np.broadcast_to(np.array([0.0, 0.0, up]), a.shape)
    turn = np.sign(dots(np.cross(a, b), c))
    arcs = (a, b), (b, c), (c, a)
    inside = (np.min([turn * dots(np.cross(i, j), line) for i, j in arcs], axis=0) >= 0.0) & (turn != 0.0)
    return np.asarray(np.where(inside, 0.0, np.min([_arc_angle(line, i, j) for i, j in arcs], axis=0)))


def _rotation_rows(tool_track: ToolTrack, knots: IntArray) -> IntArray:
    """The knots and, where the other tool rotates in between, rows after each ``MAX_CHECK_ROTATION_RAD`` of
    rotation.
    """
    step = tool_track.axis_steps(1)
    has_rotated = (
        np.diff(np.floor(np.concatenate([[0.0], np.cumsum(step)]) / MAX_CHECK_ROTATION_RAD), prepend=0.0)
        > 0.0
    )
    return np.unique(np.concatenate([knots, np.flatnonzero(has_rotated & tool_track.is_forming)]))


def _arc_angle(line: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Angles (N,) [rad] of unit vectors to the nearest direction on the shorter arcs between two others."""
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
    """Check the gap of two controllers that meet only occasionally.

    The gap is checked for all instants of one arm combined with all instants of the other between two
    meetings.
    """
    if findings.context.problem.cell.controller.sync != "handshake":
        return
    claim, tool_track, knots, low, high = (
        gap_track.claim,
        gap_track.track,
        gap_track.knots,
        gap_track.low,
        gap_track.high,
    )
    radii, count = sum(claim.radii), 0
    for rows in _meeting_intervals(findings.context, tool_track, knots):
        # as commanded: at two instants springback shifts differ, and the gap is between the actual tools
        forming, other = tool_track.commanded_tcp(0, knots[rows]), tool_track.commanded_tcp(1, knots[rows])
        distance = np.linalg.norm(forming[:, None] - other[None], axis=2) - radii
        error = np.maximum(distance - high[rows, None], low[rows, None] - distance).max(axis=1)
        k = int(np.argmax(error))
        if error[k] > claim.handshake and count < MAX_SHOWN_ISSUES:
            count += 1
            what = (
                f"with one arm ahead in {claim.segment} the gap is {mm(error[k]):.3f} mm off, "
                f"allowed between meetings: {mm(claim.handshake):g} mm"
            )
            row = tool_track.rows[knots[rows[k]]]
            findings.add_at_sample(what, claim.arms[0], row, measure_in_mm(error[k], claim.handshake))


def _meeting_intervals(context: Context, tool_track: ToolTrack, knots: IntArray) -> Iterator[IntArray]:
    """Rows of the knots between one meeting of two controllers and the next, both included."""
    motion = context.motion
    node = motion.node[tool_track.rows[knots]]
    stage = motion.node_stage[node]
    for number in np.unique(stage):
        stage_knots = np.flatnonzero(stage == number)
        stage_nodes = np.flatnonzero(motion.node_stage == number)
        ends = np.asarray(context.job.stages[number].ends, dtype=np.int64)
        interval = np.searchsorted(ends, node[stage_knots] - stage_nodes[0])
        for part in np.split(stage_knots, np.flatnonzero(np.diff(interval)) + 1):
            yield part if part[0] == stage_knots[0] else np.concatenate([[part[0] - 1], part])


@rule("verify.border", SupportsBorder)
def check_border(context: Context) -> RuleOutcome:
    """The tool that supports a border stays on it within the tolerance, and never cuts across it."""
    forming, findings = context.get(FORMING), Findings("verify.border", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, SupportsBorder):
            continue
        tool_track = forming.get_track(claim.segment, index, (claim.arm,))
        parts = straight_pieces(
            tool_track, min(TRACK_CHORD_FRACTION * claim.tolerance, 0.1 * MAX_BORDER_CUT_M)
        )
        is_forming = tool_track.is_forming[parts.first]
        rows = np.unique(np.concatenate([parts.first[is_forming], parts.last[is_forming]]))
        if not len(rows):
            findings.add(
                f"{claim.arm} never supports the border of {claim.segment}", field=str(claim.segment)
            )
            continue
        points = _densify(tool_track.centre[rows, 0])
        which = np.minimum(
            np.searchsorted(points[1], np.arange(len(points[0])), side="right") - 1, len(rows) - 1
        )
        distance, inside = _border_distance(points[0], claim.border)
        slack = float(parts.deviation.max(initial=0.0))
        for excess, limit, what in (
            (distance + slack, claim.tolerance, "off the border"),
            (np.where(inside, distance, 0.0) - slack, MAX_BORDER_CUT_M, "inside of the border"),
        ):
            findings.note_excess(excess, limit, claim.segment)
            for i in first_of_runs(excess > limit):
                message = f"{claim.arm} is {mm(excess[i]):.3f} mm {what} of {claim.segment}"
                findings.add_at_sample(
                    message, claim.arm, tool_track.rows[rows[which[i]]], measure_in_mm(excess[i], limit)
                )
    return findings.excess_outcome("no border is supported")


MAX_EDGE_PIECE_M = 0.002
"""Maximum length [m] of the pieces into which an edge is divided."""
_NEAREST_MARKS = 4
"""Number of nearest pieces of edges among which the nearest edge is searched."""


def _densify(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Points of the chain (N, 3) at most 2 mm apart, and the index of each point of the chain among them."""
    move = np.diff(points, axis=0)
    count = np.maximum(np.ceil(np.linalg.norm(move, axis=1) / MAX_EDGE_PIECE_M).astype(np.int64), 1)
    first = np.concatenate([[0], np.cumsum(count)])
    which = np.repeat(np.arange(len(move)), count)
    fraction = (np.arange(len(which)) - first[which]) / count[which]
    return np.concatenate([points[which] + fraction[:, None] * move[which], points[-1:]]), first


def _border_distance(points: FloatArray, border: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Distances (N,) [m] of points (N, 3) from a closed curve (K, 3), and whether they are inside of it seen
    along z.
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
        down = np.where(spans, b[:, 1] - a[:, 1], 1.0)
        x = a[None, :, 0] + (y - a[None, :, 1]) / down * (b[None, :, 0] - a[None, :, 0])
        inside[rows] = (np.sum(spans & (points[rows, 0, None] < x), axis=1) % 2).astype(np.bool_)
    return distance, inside


def _edge_marks(a: FloatArray, b: FloatArray) -> tuple[FloatArray, IntArray]:
    """Middles (M, 3) of pieces of straight edges from ``a`` to ``b`` (K, 3), at most ``MAX_EDGE_PIECE_M``
    long, and the edge (M,) of each.

    The nearest of a few of them gives a distance that is never too small.
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
        parts = straight_pieces(tool_track, TRACK_CHORD_FRACTION * claim.tolerance)
        is_forming = tool_track.is_forming[parts.first]
        first, last, deviation = parts.first[is_forming], parts.last[is_forming], parts.deviation[is_forming]
        if not len(first):
            what = f"{' and '.join(claim.arms)} never work on {claim.segment} together"
            findings.add(what, field=str(claim.segment))
            continue
        min_distance, max_distance = _distance_range(tool_track, first, last)
        error = np.maximum(max_distance - claim.distance, claim.distance - min_distance) + 2.0 * deviation
        findings.note_excess(error, claim.tolerance, claim.segment)
        for i in first_of_runs(error > claim.tolerance):
            what = f"{arm} is {mm(error[i]):.3f} mm off its distance in {claim.segment}"
            findings.add_at_sample(
                what, arm, tool_track.rows[last[i]], measure_in_mm(error[i], claim.tolerance)
            )
        knots = np.unique(np.concatenate([first, last]))
        face = ProofFace(claim.vertices, claim.faces, 0.01)
        nearest = face.nearest(tool_track.centre[knots, 0], TOUCH_TOLERANCE_M)
        angle = _line_angle(tool_track, knots, face, nearest, claim.side, upright=False)
        for i in first_of_runs(angle > claim.turn):
            what = f"{arm} is {np.rad2deg(angle[i]):.2f} deg off the normal in {claim.segment}"
            findings.add_at_sample(
                what, arm, tool_track.rows[knots[i]], measure_in_degrees(angle[i], claim.turn)
            )
        rows = _rotation_rows(tool_track, knots)
        centre = tool_track.centre[rows, 0]
        nearest = face.nearest(centre, TOUCH_TOLERANCE_M)
        pointing_error = _direction_angle(
            tool_track.axis(1, rows), centre, face, nearest, claim.side, upright=True
        )
        for i in first_of_runs(pointing_error > claim.aim):
            what = (
                f"{arm} points {np.rad2deg(pointing_error[i]):.2f} deg off the directions between the face's "
                f"normal and the vertical in {claim.segment}, allowed: {np.rad2deg(claim.aim):g} deg"
            )
            findings.add_at_sample(
                what, arm, tool_track.rows[rows[i]], measure_in_degrees(pointing_error[i], claim.aim)
            )
    return findings.excess_outcome("no tool follows another")


MAX_TOOL_LINE_ANGLE_RAD = np.deg2rad(1.0)
"""Maximum angle [rad] of the line of the tools, seen along z, to the wall's slope: faces consist of
facets.
"""
MAX_LOOP_GAP_FRACTION = 0.75
"""Maximum distance of points of the wall from the path, as a fraction of the distance of loops there.

Half would be sufficient if all loops were even, and a missing one leaves the whole distance.
"""
CHORD_ERROR_M = 1e-5
"""Additional distance [m] by which straight moves may miss points."""
MAX_BACKWARD_LOOPS = 1.5
"""Maximum distance, in loop distances, that the path may go back toward the inside."""
MAX_PLAN_DEVIATION_M = 1e-4
"""Maximum distance [m] in plan, on approach and retreat in the sheet, from where the segment starts
or ends.
"""
LENGTH_TOLERANCE_FRACTION = 0.02
"""Relative tolerance of lengths compared with those that a table is valid for."""
MIN_TURN_FRACTION = 0.9
"""Minimum fraction of all turning that has to have the required direction."""


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
            what = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            findings.add(what, field=str(claim.segment))
            continue
        table = solve_table(claim.table, claim.prefer)
        _check_conditions(findings, claim, table)
        table_distance, plane_distance, touched = path.table_fit(table)
        level = path.start - claim.projection + claim.radii[0]
        high = np.abs(path.centre[:, 0][:, 2] - level)
        across = np.hypot(*(path.centre[:, 1] - path.centre[:, 0])[:, :2].T)
        error = np.maximum(
            np.maximum(table_distance, high), plane_distance - np.sin(MAX_TOOL_LINE_ANGLE_RAD) * across
        )
        error = error + CHECK_ERROR_FRACTION * claim.tolerance
        findings.note_excess(error, claim.tolerance, claim.segment)
        for i in first_of_runs(error > claim.tolerance):
            _add_position_issue(findings, path, i, float(error[i]), bool(high[i] > claim.tolerance))
        _check_coverage(findings, path, touched)
        _check_tilt(findings, path)
        _check_approach_retreat(findings, path)
    return findings.excess_outcome("no table is followed")


CHECK_ERROR_FRACTION = 0.1
"""Maximum deviation of the path between checks, as a fraction of the tolerance."""


def _add_position_issue(
    findings: Findings, path: AccumulativePath, check_row: int, error: float, level: bool
) -> None:
    claim = path.claim
    if not np.isfinite(error):
        what = f"{claim.arms[0]} touches no wall of the required face, or one that is not in the table"
    elif level:
        what = f"{claim.arms[0]} is {mm(error):.3f} mm off the level at which it forms"
    else:
        what = f"{claim.arms[1]} is {mm(error):.3f} mm off the table's position for the wall there"
    what += f" in {claim.segment}, allowed: {mm(claim.tolerance):g} mm"
    row = path.track.rows[path.rows[check_row]]
    findings.add_at_sample(what, claim.arms[0], row, measure_in_mm(min(error, 1.0), claim.tolerance))


def _check_conditions(findings: Findings, claim: FormsByTable, table: TableSolution) -> None:
    """Compare the conditions of the table with the sheet and the tools."""
    claimed_lengths = {
        "thickness_mm": claim.thickness,
        "tool_radius_mm": claim.radii[0],
        "pitch_mm": claim.pitch,
        "projection_mm": claim.projection,
    }
    if table.conditions.get("metal") != claim.metal or claim.radii[0] != claim.radii[1]:
        what = f"the response table is valid for {table.conditions.get('metal')} and tools of one radius"
        findings.add(what, field=str(claim.segment))
    for name, value in claimed_lengths.items():
        table_value = table.conditions.get(name, "nan")
        if not abs(mm(value) - float(table_value)) <= LENGTH_TOLERANCE_FRACTION * float(table_value):
            what = f"the response table is valid for {name} {table_value}, not for {mm(value):g}"
            findings.add(what, (mm(value), float(table_value), None), field=str(claim.segment))


def _check_coverage(findings: Findings, path: AccumulativePath, touched: FloatArray) -> None:
    """Check that all of the wall is passed, from the inside out, in the required direction."""
    claim = path.claim
    touched = touched[np.isfinite(touched[:, 0])]
    if len(touched) < 2:
        return
    points, distance, loop_distance = path.wall_distances(touched)
    step = path.loop_height(touched[:, 2])
    last = path.start - points[:, 2] < path.loop_height(points[:, 2])
    # loops start from the inside, whole pitches apart; at the last loop, chords of a round part deviate to
    # the inside by up to sag, which no further loop compensates
    allowed = (
        np.where(last, 1.0 + claim.sag / claim.pitch, MAX_LOOP_GAP_FRACTION) * loop_distance + CHORD_ERROR_M
    )
    k = int(np.argmax(distance - allowed))
    if distance[k] > allowed[k]:
        at = format_point_mm(points[k] * [1.0, 1.0, float(claim.side)])
        what = f"{claim.segment} misses the wall at ({at}) mm by {mm(distance[k]):.3f} mm"
        what += f", loops are {mm(loop_distance[k]):.3f} mm apart there"
        findings.add(what, measure_in_mm(distance[k], allowed[k]), field=str(claim.segment))
    back = np.maximum.accumulate(touched[:, 2]) - touched[:, 2]
    if (back > MAX_BACKWARD_LOOPS * step).any():
        k = int(np.argmax(back - MAX_BACKWARD_LOOPS * step))
        what = f"{claim.segment} goes back toward the inside by {mm(back[k]):.3f} mm of height"
        value, limit, _ = measure_in_mm(back[k], MAX_BACKWARD_LOOPS * step[k])
        findings.add(what, (value, limit, None), field=str(claim.segment))
    middle = points.mean(axis=0)
    radius_vector, move = (touched - middle)[:-1, :2], np.diff(touched[:, :2], axis=0)
    area = claim.turning * (radius_vector[:, 0] * move[:, 1] - radius_vector[:, 1] * move[:, 0])
    turn_fraction = float(np.maximum(area, 0.0).sum() / max(float(np.abs(area).sum()), 1e-30))
    if turn_fraction < MIN_TURN_FRACTION:
        what = (
            f"{claim.segment} goes round in the wrong direction for {100 * (1 - turn_fraction):.0f} % of its "
            "path"
        )
        findings.add(what, measure_in_percent(turn_fraction, MIN_TURN_FRACTION), field=str(claim.segment))


def _check_tilt(findings: Findings, path: AccumulativePath) -> None:
    """Check that both tools are square to the sheet."""
    claim = path.claim
    for column, toward in ((0, -1.0), (1, 1.0)):
        tilt = np.arccos(np.clip(toward * path.axis(column)[path.rows, 2], -1.0, 1.0))
        for i in first_of_runs(tilt > claim.lean):
            arm = claim.arms[column]
            what = f"{arm} is tilted by {np.rad2deg(tilt[i]):.2f} deg in {claim.segment}"
            what += f", allowed: {np.rad2deg(claim.lean):.2f} deg"
            findings.add_at_sample(
                what, arm, path.track.rows[path.rows[i]], measure_in_degrees(tilt[i], claim.lean)
            )


def _check_approach_retreat(findings: Findings, path: AccumulativePath) -> None:
    """Check the approach and retreat of the tools.

    In the sheet they may only be where their segment starts and ends, and no deeper than there.
    """
    claim, track = path.claim, path.track
    forming_rows = np.flatnonzero(track.is_forming)
    first, last = max(int(forming_rows[0]) - 1, 0), int(forming_rows[-1])
    centres = path.all_centres
    for column, flat, outward in ((0, path.start, 1.0), (1, path.start - claim.thickness, -1.0)):
        for rows, at in ((np.arange(first), first), (np.arange(last + 1, len(centres)), last)):
            if not len(rows):
                continue
            centre, end_centre = centres[rows, column], centres[at, column]
            inside = claim.radii[column] - outward * (centre[:, 2] - flat)  # how deep the ball is
            deepest = claim.radii[column] - outward * (end_centre[2] - flat)
            plan_distance = np.hypot(*(centre - end_centre)[:, :2].T)
            is_wrong = (inside > claim.tolerance) & (
                (plan_distance > MAX_PLAN_DEVIATION_M) | (inside > deepest + claim.tolerance)
            )
            for i in first_of_runs(is_wrong):
                arm = claim.arms[column]
                what = (
                    f"on approach or retreat of {claim.segment} {arm} is {mm(inside[i]):.3f} mm in the "
                    f"sheet, {mm(plan_distance[i]):.3f} mm away from where it starts or ends"
                )
                findings.add_at_sample(what, arm, track.rows[rows[i]])
