"""Rules on two forming tools in one sheet: gap, support of a border, opposite, accumulative forming.

verify.gap, border, opposite (the tool that follows). verify.adsif: both tools against the wanted
face and the response table.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.processes.forming.claims import FollowsOpposite, FormsByTable, SupportsBorder, ToolGap
from planner.processes.forming.proof.accumulative import Wanted, Way, wanted_conditions
from planner.processes.forming.proof.face import Face, Nearest
from planner.processes.forming.proof.rules.tool import ISSUES_SHOWN, NOTHING_FORMED, spread
from planner.processes.forming.proof.state import FORMING, TOUCHED_WITHIN, TRACK_CHORD_SHARE, Opened
from planner.processes.forming.proof.tracks import Track, pieces
from planner.proof.context import Context
from planner.proof.findings import Findings, coordinates, in_degrees, in_mm, in_percent
from planner.proof.rule import Outcome, mm, rule

LOOK_TURN = np.deg2rad(0.5)
"""How far [rad] a tool turns at most between two looks at it."""
BORDER_CUT_IN = 1e-4
"""Straight moves between targets may cut a bent border by so much [m]."""


@rule("verify.gap", ToolGap)
def gap(context: Context) -> Outcome:
    """At and between targets the gap between two forming tools is what the sheet between them is wanted to be
    thick, and they face each other as wanted; of two controllers, whichever is a step ahead."""
    forming, findings = context.get(FORMING), Findings("verify.gap", context)
    for one in forming.opened:
        claim, way, low, high = one.claim, one.track, one.low, one.high
        first, last, off = one.pieces.first, one.pieces.last, one.pieces.apart
        if not len(first):
            what = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            findings.add(what, field=str(claim.segment))
            continue
        start, end = np.searchsorted(one.knots, first), np.searchsorted(one.knots, last)
        least, most = _between(way, first, last)
        both = sum(claim.radii)
        # within a piece the wanted gap is between those at its ends
        wide = most - both - np.maximum(high[start], high[end])
        narrow = np.minimum(low[start], low[end]) - (least - both)
        error = np.maximum(wide, narrow) + off
        findings.beyond(error, claim.tolerance, claim.segment)
        for i in spread(error > claim.tolerance):
            way_off = "wide" if wide[i] >= narrow[i] else "narrow"
            what = f"the gap is {mm(error[i]):.3f} mm too {way_off} in {claim.segment}"
            what += f"; allowed: {mm(claim.tolerance):g} mm"
            findings.at_sample(what, claim.arms[0], way.rows[last[i]], in_mm(error[i], claim.tolerance))
        _facing(findings, one)
        _a_step_apart(findings, one)
    return findings.outcome_beyond("no gap is claimed" if forming.formed else NOTHING_FORMED)


def _between(way: Track, first: IntArray, last: IntArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest distance (K,) [m] of both centres within the straight pieces from one row to
    another."""
    one = way.centre[first, 0] - way.centre[first, 1]
    two = way.centre[last, 0] - way.centre[last, 1]
    turn = two - one
    share = -dots(one, turn) / np.maximum(dots(turn, turn), 1e-30)
    least = np.linalg.norm(one + np.clip(share, 0.0, 1.0)[:, None] * turn, axis=1)
    return least, np.maximum(np.linalg.norm(one, axis=1), np.linalg.norm(two, axis=1))


def _facing(findings: Findings, one: Opened) -> None:
    """Knots at which the line of the centres does not lie between the face's normal and the vertical."""
    claim, way, knots = one.claim, one.track, one.knots
    off = _turned(way, knots, one.face, one.near, claim.side, upright=True)
    for k in spread(off > claim.turn):
        what = (
            f"in {claim.segment} the line of the tools is {np.rad2deg(off[k]):.2f} deg off what lies between "
            f"the face's normal and the vertical; allowed: {np.rad2deg(claim.turn):g} deg"
        )
        findings.at_sample(what, claim.arms[0], way.rows[knots[k]], in_degrees(off[k], claim.turn))


_KNOTS_AT_ONCE = 16_384
"""Knots that are looked at at once."""


def _turned(way: Track, knots: IntArray, face: Face, found: Nearest, side: int, upright: bool) -> FloatArray:
    """How far (K,) [rad] the line of the centres is off the face's normal, as `_off_directions`."""
    between = way.centre[knots, 0] - way.centre[knots, 1]
    between /= np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-12)
    out = np.empty(len(knots))
    for begin in range(0, len(knots), _KNOTS_AT_ONCE):
        own = np.arange(begin, min(begin + _KNOTS_AT_ONCE, len(knots)))
        out[own] = _off_directions(between[own], way, knots[own], face, found.at(own), side, upright)
    return out


def _off_directions(
    line: FloatArray, way: Track, knots: IntArray, face: Face, found: Nearest, side: int, upright: bool
) -> FloatArray:
    """How far (K,) [rad] directions ``line`` (K, 3) are off the face's normal, or, where they may stand
    ``upright``, off all directions between that and the vertical. Of all places that the ball touches, one
    has to fit: by the way from there to the ball's centre, or by the normal of the smooth face that the
    facets stand for, whose own normals flicker.

    Where the ball touches two places at once the sheet lies around it from one to the other, so that its
    normal there is any between theirs: the line may be along those, or stand upright off them. So it is in a
    sharp crease, and where facets stand for a hollow that is hardly wider than the ball."""
    off = np.full(len(knots), np.inf)
    centre = way.centre[knots, 0]
    smooth = side * np.einsum("nk,nkd->nd", found.share, face.smooth[found.triangle])
    for normal in (centre[found.row] - found.tied, smooth):
        unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        end = np.broadcast_to(np.array([0.0, 0.0, float(side)]), unit.shape) if upright else unit
        np.minimum.at(off, found.row, _off_arc(line[found.row], unit, end))
        one, other = _farthest(unit, found.row, len(knots))
        between = _off_between(line, one, other, float(side)) if upright else _off_arc(line, one, other)
        off = np.minimum(off, between)
    return off


def _farthest(unit: FloatArray, row: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Those two (K, 3) of the normals ``unit`` (M, 3) of the places that the ball touches, of its ``row``
    (M,) of ``count`` K, that differ the most."""
    first = np.searchsorted(row, np.arange(count))
    one = first
    for _ in range(2):  # the farthest from any one, and the farthest from that
        cosine = dots(unit, unit[one[row]])
        order = np.lexsort((cosine, row))
        one, other = order[first], one
    return unit[one], unit[other]


def _off_between(line: FloatArray, a: FloatArray, b: FloatArray, up: float) -> FloatArray:
    """Angles (K,) [rad] of unit vectors ``line`` (K, 3) to the triangle on the sphere between the vertical
    and two others ``a`` and ``b`` (K, 3)."""
    c = np.broadcast_to(np.array([0.0, 0.0, up]), a.shape)
    turn = np.sign(dots(np.cross(a, b), c))
    arcs = (a, b), (b, c), (c, a)
    inside = (np.min([turn * dots(np.cross(i, j), line) for i, j in arcs], axis=0) >= 0.0) & (turn != 0.0)
    return np.asarray(np.where(inside, 0.0, np.min([_off_arc(line, i, j) for i, j in arcs], axis=0)))


def _turning(way: Track, knots: IntArray) -> IntArray:
    """The knots and, where the other tool turns in between, rows after each ``LOOK_TURN`` of turning."""
    step = way.turning(1)
    turned = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(step)]) / LOOK_TURN), prepend=0.0) > 0.0
    return np.unique(np.concatenate([knots, np.flatnonzero(turned & way.own)]))


def _off_arc(line: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Angles (N,) [rad] of unit vectors to the nearest direction on the shorter arcs between two others."""
    ends = [np.arccos(np.clip(dots(line, end), -1.0, 1.0)) for end in (one, two)]
    pole = np.cross(one, two)
    length = np.linalg.norm(pole, axis=1)
    pole /= np.maximum(length, 1e-12)[:, None]
    beside = np.arcsin(np.clip(np.abs(dots(line, pole)), 0.0, 1.0))
    after = dots(np.cross(one, line), pole) >= 0.0
    before = dots(np.cross(line, two), pole) >= 0.0
    within = after & before & (length > 1e-9)
    nearest = np.minimum(ends[0], ends[1])
    return np.asarray(np.where(within, np.minimum(beside, nearest), nearest))


def _a_step_apart(findings: Findings, one: Opened) -> None:
    """Where two controllers meet only now and then: the gap for all instants of one arm and of the other
    between two meetings."""
    if findings.context.problem.cell.controller.sync != "handshake":
        return
    claim, way, knots, low, high = one.claim, one.track, one.knots, one.low, one.high
    both, count = sum(claim.radii), 0
    for rows in _intervals(findings.context, way, knots):
        # as they are moved: at two instants the sheet gives way by two amounts, and the gap is between tools
        former, other = way.commanded(0, knots[rows]), way.commanded(1, knots[rows])
        apart = np.linalg.norm(former[:, None] - other[None], axis=2) - both
        error = np.maximum(apart - high[rows, None], low[rows, None] - apart).max(axis=1)
        k = int(np.argmax(error))
        if error[k] > claim.handshake and count < ISSUES_SHOWN:
            count += 1
            what = (
                f"with one arm ahead in {claim.segment} the gap is {mm(error[k]):.3f} mm off; "
                f"allowed between meetings: {mm(claim.handshake):g} mm"
            )
            row = way.rows[knots[rows[k]]]
            findings.at_sample(what, claim.arms[0], row, in_mm(error[k], claim.handshake))


def _intervals(context: Context, way: Track, knots: IntArray) -> Iterator[IntArray]:
    """Rows of the knots between one meeting of two controllers and the next, both included."""
    motion = context.motion
    node = motion.node[way.rows[knots]]
    stage = motion.node_stage[node]
    for number in np.unique(stage):
        here = np.flatnonzero(stage == number)
        own = np.flatnonzero(motion.node_stage == number)
        ends = np.asarray(context.job.stages[number].ends, dtype=np.int64)
        interval = np.searchsorted(ends, node[here] - own[0])
        for part in np.split(here, np.flatnonzero(np.diff(interval)) + 1):
            yield part if part[0] == here[0] else np.concatenate([[part[0] - 1], part])


@rule("verify.border", SupportsBorder)
def border(context: Context) -> Outcome:
    """The tool that supports a border stays on it within the tolerance, and never cuts across it."""
    forming, findings = context.get(FORMING), Findings("verify.border", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, SupportsBorder):
            continue
        way = forming.track(claim.segment, index, (claim.arm,))
        parts = pieces(way, min(TRACK_CHORD_SHARE * claim.tolerance, 0.1 * BORDER_CUT_IN))
        own = way.own[parts.first]
        rows = np.unique(np.concatenate([parts.first[own], parts.last[own]]))
        if not len(rows):
            findings.add(
                f"{claim.arm} never supports the border of {claim.segment}", field=str(claim.segment)
            )
            continue
        points = _dense(way.centre[rows, 0])
        which = np.minimum(
            np.searchsorted(points[1], np.arange(len(points[0])), side="right") - 1, len(rows) - 1
        )
        off, inside = _off_border(points[0], claim.border)
        slack = float(parts.off.max(initial=0.0))
        for wrong, limit, what in (
            (off + slack, claim.tolerance, "off the border"),
            (np.where(inside, off, 0.0) - slack, BORDER_CUT_IN, "inside of the border"),
        ):
            findings.beyond(wrong, limit, claim.segment)
            for i in spread(wrong > limit):
                told = f"{claim.arm} is {mm(wrong[i]):.3f} mm {what} of {claim.segment}"
                findings.at_sample(told, claim.arm, way.rows[rows[which[i]]], in_mm(wrong[i], limit))
    return findings.outcome_beyond("no border is supported")


EDGE_STEP = 0.002
"""Longest piece [m] that an edge is divided into."""
_NEAREST_MARKS = 4
"""Nearest pieces of edges among which the nearest edge is looked for."""


def _dense(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Points of the chain (N, 3) no more than 2 mm apart, and where each of the chain's own is among them."""
    way = np.diff(points, axis=0)
    count = np.maximum(np.ceil(np.linalg.norm(way, axis=1) / EDGE_STEP).astype(np.int64), 1)
    first = np.concatenate([[0], np.cumsum(count)])
    which = np.repeat(np.arange(len(way)), count)
    share = (np.arange(len(which)) - first[which]) / count[which]
    return np.concatenate([points[which] + share[:, None] * way[which], points[-1:]]), first


def _off_border(points: FloatArray, border: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Distances (N,) [m] of points (N, 3) from a closed curve (K, 3), and whether they are inside of it as
    seen along z."""
    a = border
    b = np.roll(border, -1, axis=0)
    off, inside = np.empty(len(points)), np.zeros(len(points), dtype=np.bool_)
    along = b - a
    square = np.maximum(dots(along, along), 1e-30)
    marks, owner = _marks(a, b)
    near = np.asarray(cKDTree(marks).query(points, k=min(_NEAREST_MARKS, len(marks)))[1]).reshape(
        len(points), -1
    )
    off[:] = np.inf
    for column in owner[near].T:
        rest = points - a[column]
        share = np.clip(dots(rest, along[column]) / square[column], 0.0, 1.0)
        off = np.minimum(off, np.linalg.norm(rest - share[:, None] * along[column], axis=1))
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) * len(a) // 2_000_000)):
        y = points[rows, 1, None]
        spans = (a[None, :, 1] > y) != (b[None, :, 1] > y)
        down = np.where(spans, b[:, 1] - a[:, 1], 1.0)
        x = a[None, :, 0] + (y - a[None, :, 1]) / down * (b[None, :, 0] - a[None, :, 0])
        inside[rows] = (np.sum(spans & (points[rows, 0, None] < x), axis=1) % 2).astype(np.bool_)
    return off, inside


def _marks(a: FloatArray, b: FloatArray) -> tuple[FloatArray, IntArray]:
    """Middles (M, 3) of pieces of straight edges from ``a`` to ``b`` (K, 3), at most ``EDGE_STEP`` long, and
    the edge (M,) of each. The nearest of a few of them tells a distance that is never too small."""
    count = np.maximum(np.ceil(np.linalg.norm(b - a, axis=1) / EDGE_STEP).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(a)), count)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[owner]
    return a[owner] + share[:, None] * (b - a)[owner], owner


@rule("verify.opposite", FollowsOpposite)
def opposite(context: Context) -> Outcome:
    """A tool that follows the forming one across the sheet is at the wanted distance, along the face's
    normal, and points at it from between that normal and the vertical."""
    forming, findings = context.get(FORMING), Findings("verify.opposite", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, FollowsOpposite):
            continue
        way, arm = forming.track(claim.segment, index, claim.arms), claim.arms[1]
        parts = pieces(way, TRACK_CHORD_SHARE * claim.tolerance)
        own = way.own[parts.first]
        first, last, off = parts.first[own], parts.last[own], parts.off[own]
        if not len(first):
            what = f"{' and '.join(claim.arms)} never work on {claim.segment} together"
            findings.add(what, field=str(claim.segment))
            continue
        least, most = _between(way, first, last)
        error = np.maximum(most - claim.distance, claim.distance - least) + 2.0 * off
        findings.beyond(error, claim.tolerance, claim.segment)
        for i in spread(error > claim.tolerance):
            what = f"{arm} is {mm(error[i]):.3f} mm off its distance in {claim.segment}"
            findings.at_sample(what, arm, way.rows[last[i]], in_mm(error[i], claim.tolerance))
        knots = np.unique(np.concatenate([first, last]))
        face = Face(claim.vertices, claim.faces, 0.01)
        found = face.nearest(way.centre[knots, 0], TOUCHED_WITHIN)
        turned = _turned(way, knots, face, found, claim.side, upright=False)
        for i in spread(turned > claim.turn):
            what = f"{arm} is {np.rad2deg(turned[i]):.2f} deg off the normal in {claim.segment}"
            findings.at_sample(what, arm, way.rows[knots[i]], in_degrees(turned[i], claim.turn))
        rows = _turning(way, knots)
        found = face.nearest(way.centre[rows, 0], TOUCHED_WITHIN)
        aside = _off_directions(way.axis(1, rows), way, rows, face, found, claim.side, upright=True)
        for i in spread(aside > claim.aim):
            what = (
                f"{arm} points {np.rad2deg(aside[i]):.2f} deg off what lies between the face's "
                f"normal and the vertical in {claim.segment}; allowed: {np.rad2deg(claim.aim):g} deg"
            )
            findings.at_sample(what, arm, way.rows[rows[i]], in_degrees(aside[i], claim.aim))
    return findings.outcome_beyond("no tool follows another")


TOOL_LINE_TURN = np.deg2rad(1.0)
"""How far [rad] the line of the tools, seen along z, may turn from the wall's slope: faces are facets."""
LOOP_GAP_SHARE = 0.75
"""Places of the wall are no farther from the way than this share of what loops are apart there: half would do
where all loops are even, and one that is missing leaves as much as they are apart."""
CHORD_ERROR = 1e-5
"""How far [m] straight moves may go past places besides."""
BACKWARD_LOOPS = 1.5
"""The way goes back toward the inside by so many of what loops are apart at most."""
WAY_STAYS_WITHIN = 1e-4
"""On its ways in and out a tool in the sheet stays within this [m] of where its segment begins and ends."""
TABLE_LENGTH_SHARE = 0.02
"""Share by which lengths may differ from those that a table holds for."""
WANTED_TURN_SHARE = 0.9
"""Share of all turning that has to go the wanted way round."""


@rule("verify.adsif", FormsByTable)
def by_table(context: Context) -> Outcome:
    """In accumulative forming both tools are, at and between targets, where the response table wants them for
    the wall of the wanted face at each place, at the sheet's level, and pass all of it from the inside out;
    on their ways in and out they press into it nowhere else."""
    forming, findings = context.get(FORMING), Findings("verify.adsif", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, FormsByTable):
            continue
        way = Way(context, claim, index)
        if len(way.rows) < 2:
            what = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            findings.add(what, field=str(claim.segment))
            continue
        table = wanted_conditions(claim.table, claim.prefer)
        _conditions(findings, claim, table)
        off, aside, place = way.fitting(table)
        level = way.start - claim.projection + claim.radii[0]
        high = np.abs(way.centre[:, 0][:, 2] - level)
        across = np.hypot(*(way.centre[:, 1] - way.centre[:, 0])[:, :2].T)
        error = np.maximum(np.maximum(off, high), aside - np.sin(TOOL_LINE_TURN) * across)
        error = error + LOOK_ERROR_SHARE * claim.tolerance
        findings.beyond(error, claim.tolerance, claim.segment)
        for i in spread(error > claim.tolerance):
            _off(findings, way, i, float(error[i]), bool(high[i] > claim.tolerance))
        _passed(findings, way, place)
        _upright(findings, way)
        _ways(findings, way)
    return findings.outcome_beyond("no table is followed")


LOOK_ERROR_SHARE = 0.1
"""What the way between looks may be off, as a share of the tolerance."""


def _off(findings: Findings, way: Way, look: int, error: float, level: bool) -> None:
    claim = way.claim
    if not np.isfinite(error):
        what = f"{claim.arms[0]} touches no wall of the wanted face, or one that is not in the table"
    elif level:
        what = f"{claim.arms[0]} is {mm(error):.3f} mm off the level at which it forms"
    else:
        what = f"{claim.arms[1]} is {mm(error):.3f} mm off where the table wants it for the wall there"
    what += f" in {claim.segment}; allowed: {mm(claim.tolerance):g} mm"
    row = way.track.rows[way.rows[look]]
    findings.at_sample(what, claim.arms[0], row, in_mm(min(error, 1.0), claim.tolerance))


def _conditions(findings: Findings, claim: FormsByTable, table: Wanted) -> None:
    """What the table holds for, against what the sheet and the tools are."""
    wanted_of = {
        "thickness_mm": claim.thickness,
        "tool_radius_mm": claim.radii[0],
        "pitch_mm": claim.pitch,
        "projection_mm": claim.projection,
    }
    if table.conditions.get("metal") != claim.metal or claim.radii[0] != claim.radii[1]:
        what = f"the response table holds for {table.conditions.get('metal')} and tools of one radius"
        findings.add(what, field=str(claim.segment))
    for name, value in wanted_of.items():
        held = table.conditions.get(name, "nan")
        if not abs(mm(value) - float(held)) <= TABLE_LENGTH_SHARE * float(held):
            what = f"the response table holds for {name} {held}, not for {mm(value):g}"
            findings.add(what, (mm(value), float(held), None), field=str(claim.segment))


def _passed(findings: Findings, way: Way, place: FloatArray) -> None:
    """Whether all of the wall is passed, from the inside out, the wanted way round."""
    claim = way.claim
    place = place[np.isfinite(place[:, 0])]
    if len(place) < 2:
        return
    points, far, apart = way.passed(place)
    step = way.rise(place[:, 2])
    last = way.start - points[:, 2] < way.rise(points[:, 2])
    # loops come from the inside, whole pitches apart; beyond the last loop, straight moves of a round part
    # are off to the inside, and none makes up for it
    allowed = np.where(last, 1.0 + claim.sag / claim.pitch, LOOP_GAP_SHARE) * apart + CHORD_ERROR
    k = int(np.argmax(far - allowed))
    if far[k] > allowed[k]:
        at = coordinates(points[k] * [1.0, 1.0, float(claim.side)])
        what = f"{claim.segment} passes the wall at ({at}) mm by {mm(far[k]):.3f} mm"
        what += f"; loops are {mm(apart[k]):.3f} mm apart there"
        findings.add(what, in_mm(far[k], allowed[k]), field=str(claim.segment))
    back = np.maximum.accumulate(place[:, 2]) - place[:, 2]
    if (back > BACKWARD_LOOPS * step).any():
        k = int(np.argmax(back - BACKWARD_LOOPS * step))
        what = f"{claim.segment} goes back to the inside by {mm(back[k]):.3f} mm of height"
        value, limit, _ = in_mm(back[k], BACKWARD_LOOPS * step[k])
        findings.add(what, (value, limit, None), field=str(claim.segment))
    middle = points.mean(axis=0)
    arm, move = (place - middle)[:-1, :2], np.diff(place[:, :2], axis=0)
    area = claim.turning * (arm[:, 0] * move[:, 1] - arm[:, 1] * move[:, 0])
    share = float(np.maximum(area, 0.0).sum() / max(float(np.abs(area).sum()), 1e-30))
    if share < WANTED_TURN_SHARE:
        what = f"{claim.segment} goes round the wrong way for {100 * (1 - share):.0f} % of its way"
        findings.add(what, in_percent(share, WANTED_TURN_SHARE), field=str(claim.segment))


def _upright(findings: Findings, way: Way) -> None:
    """Whether both tools are square to the sheet."""
    claim = way.claim
    for column, toward in ((0, -1.0), (1, 1.0)):
        lean = np.arccos(np.clip(toward * way.axis(column)[way.rows, 2], -1.0, 1.0))
        for i in spread(lean > claim.lean):
            arm = claim.arms[column]
            what = f"{arm} leans {np.rad2deg(lean[i]):.2f} deg in {claim.segment}"
            what += f"; allowed: {np.rad2deg(claim.lean):.2f} deg"
            findings.at_sample(what, arm, way.track.rows[way.rows[i]], in_degrees(lean[i], claim.lean))


def _ways(findings: Findings, way: Way) -> None:
    """Whether tools are in the sheet, on their ways in and out, only where their segment begins and ends, and
    no deeper than there."""
    claim, track = way.claim, way.track
    own = np.flatnonzero(track.own)
    first, last = max(int(own[0]) - 1, 0), int(own[-1])
    centres = way.all_centres
    for column, flat, outward in ((0, way.start, 1.0), (1, way.start - claim.thickness, -1.0)):
        for rows, at in ((np.arange(first), first), (np.arange(last + 1, len(centres)), last)):
            if not len(rows):
                continue
            here, there = centres[rows, column], centres[at, column]
            inside = claim.radii[column] - outward * (here[:, 2] - flat)  # how deep the ball is
            deepest = claim.radii[column] - outward * (there[2] - flat)
            gone = np.hypot(*(here - there)[:, :2].T)
            wrong = (inside > claim.tolerance) & (
                (gone > WAY_STAYS_WITHIN) | (inside > deepest + claim.tolerance)
            )
            for i in spread(wrong):
                arm = claim.arms[column]
                what = (
                    f"on its way to or from {claim.segment} {arm} is {mm(inside[i]):.3f} mm in the sheet, "
                    f"{mm(gone[i]):.3f} mm beside the place where it begins or ends"
                )
                findings.at_sample(what, arm, track.rows[rows[i]])
