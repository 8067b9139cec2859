"""One cut from air to air: the way in through the foam, the wires beside the surface, the way out.

For a closed cut, also: where it begins, which way round it goes, and the slit by which the wire
comes to it (`choose`).
"""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, Ruled
from planner.geometry.rulings import outward_sides, resample
from planner.geometry.units import MM
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.operation import Straight, SurfaceCut, TrimCut
from planner.processes.hotwire.plan.straight.offset import VERTEX_TURN, Beside, Row, followed, make_row
from planner.processes.hotwire.plan.straight.order import Lines, Wanted, exit_length, fastest, grown, join
from planner.targets import FEED_SHARE

START_RULINGS: Final = 48
"""Rulings that are tried as the beginning of a contour without corners."""
SLIT_DIRECTIONS: Final = 48
"""Directions that are tried for the slit at each of them."""
LAST_PART: Final = 0.25
"""Share of a contour that holds the piece until last."""

THROUGH_PART: Final = 1000.0
"""What a slit through the part costs, against one through waste of its length: more than all the rest."""
TURN_COST: Final = 0.05
"""What a sharp turn between slit and contour costs, as a share of the block's diagonal."""
HELD_COST: Final = 0.6
"""What it costs to cut the wrong side last, as a share of the block's diagonal."""
BELOW_COST: Final = 3.0
"""What a slit costs that leaves the block below, where its support stands, as a share of its diagonal,"""
BELOW_LENGTH_COST: Final = 1.2
"""and by how much one elsewhere may be longer in the part than that: the proof allows somewhat more."""
ROOM_BELOW: Final = 0.04
"""[m] so far below the block there must be room for a way that leaves it there."""
LEAST_OUTWARD: Final = 0.05
"""Least cosine between a slit and the outward normal: a flatter one would graze the part."""


@dataclasses.dataclass(frozen=True)
class Start:
    """A closed cut from ruling ``first`` on, ``backward`` or not. ``way`` (3,): from there out of the block,
    along the slit; ``length`` of the slit in the block and ``through`` of it in the part [m]."""

    first: int
    backward: bool
    way: FloatArray
    length: float
    through: float


@dataclasses.dataclass(frozen=True)
class _Tries:
    """Candidates: ruling, slit's way (K, 3), its length and the length in the part (K,)."""

    first: IndexArray
    way: FloatArray
    length: FloatArray
    through: FloatArray


def choose(
    ruled: Ruled,
    contours: tuple[Ruled, ...],
    cut: SurfaceCut,
    box: FloatArray,
    up: FloatArray,
    down: FloatArray | None = None,
) -> Start:
    """The beginning of a closed cut with the shortest slit that spares the part, does not come from where the
    block stands, turns little, and leaves the wanted side for last.

    ``contours`` are all closed surfaces of the part, ``up`` (3,) the direction that ``last: top`` means,
    ``down`` (3,) that in which the block stands on something, if it does.
    """
    tries = _tries(ruled, contours, cut, box)
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    cost = tries.length + THROUGH_PART * tries.through
    if down is not None:
        below = _below(Lines(ruled.start[tries.first], ruled.end[tries.first]), tries, box, down)
        more = (BELOW_LENGTH_COST - 1.0) * THROUGH_PART * tries.through + BELOW_COST * diagonal
        cost = cost + np.where(below, more, 0.0)
    best: tuple[float, Start] | None = None
    for backward in (False, True):
        held = HELD_COST * diagonal * (1.0 - _held(ruled, tries.first, backward, cut, up))
        turn = TURN_COST * diagonal * _sharpness(ruled, tries, backward)
        total = cost + held + turn
        k = int(np.argmin(total))
        start = Start(
            int(tries.first[k]), backward, tries.way[k], float(tries.length[k]), float(tries.through[k])
        )
        if best is None or total[k] < best[0] - 1e-9:
            best = (float(total[k]), start)
    if best is None:
        raise ValueError("no beginning was tried")
    return best[1]


def _below(lines: Lines, tries: _Tries, box: FloatArray, down: FloatArray) -> BoolArray:
    """Which slits (K,) from ``lines`` (K) leave the block by its lower side: those that would be longer in a
    block that reached farther down."""
    lower = np.stack(
        [box[0] + ROOM_BELOW * np.minimum(down, 0.0), box[1] + ROOM_BELOW * np.maximum(down, 0.0)]
    )
    return np.asarray(exit_length(lines, tries.way, lower) - tries.length > 0.5 * ROOM_BELOW)


def _tries(ruled: Ruled, contours: tuple[Ruled, ...], cut: SurfaceCut, box: FloatArray) -> _Tries:
    places = _places(ruled)
    lines = Lines(ruled.start[places], ruled.end[places])
    direction = lines.direction
    if cut.lead == "auto":
        angle = 2.0 * np.pi * np.arange(SLIT_DIRECTIONS) / SLIT_DIRECTIONS
        first = np.stack(outward_sides(ruled))[:, places].mean(axis=(0, 2))
        first = first - np.sum(first * direction, axis=1, keepdims=True) * direction
        size = np.linalg.norm(first, axis=1, keepdims=True)
        first = np.where(size > 1e-6, first / np.maximum(size, 1e-6), _normal_pair(direction)[0])
        second = np.cross(direction, first)
        fan = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    else:
        lead = np.array(cut.lead)
        lead = lead - np.sum(lead * direction, axis=1, keepdims=True) * direction
        fan = (lead / np.maximum(np.linalg.norm(lead, axis=1, keepdims=True), 1e-12))[:, None]
    row = np.repeat(np.arange(len(places)), fan.shape[1])
    way = fan.reshape(-1, 3)
    sides = np.stack(outward_sides(ruled), axis=1)[places].mean(axis=2)  # (K, before and after, 3)
    outward = np.einsum("ksi,ki->ks", sides[row], way)
    # a slit to a hole comes through the part, one to an outline must not
    good = (outward < -0.3).all(axis=1) if ruled.hole else (outward > LEAST_OUTWARD).any(axis=1)
    if not good.any():
        good[:] = True
    row, way = row[good], way[good]
    length = exit_length(lines[row], way, box)
    return _Tries(places[row], way, length, _through(lines[row], way, length, contours, box))


def _places(ruled: Ruled) -> IndexArray:
    """Rulings at which a cut may begin: convex corners, or places all around where there are none, but no
    inner corner, whose two sides cannot both be reached from there."""
    before, after = outward_sides(ruled)
    direction = (ruled.end - ruled.start)[:, None]
    convex = np.sum(np.cross(before, after) * direction, axis=2).mean(axis=1) > 0.0
    convex |= np.sum(before * after, axis=2).mean(axis=1) < -0.9  # a cusp
    corners = np.flatnonzero(ruled.corner & convex)
    if len(corners) and not ruled.hole:
        return corners
    count = len(ruled.start)
    way = np.linalg.norm(np.diff(_middle(ruled), axis=0, append=_middle(ruled)[:1]), axis=1)
    along = np.concatenate([[0.0], np.cumsum(way)[:-1]])
    even = np.arange(min(START_RULINGS, count)) * way.sum() / min(START_RULINGS, count)
    found = np.unique(np.searchsorted(along, even).clip(0, count - 1))
    smooth = found[~(ruled.corner & ~convex)[found]]
    return smooth if len(smooth) else found


def _middle(ruled: Ruled) -> FloatArray:
    return np.asarray(0.5 * (ruled.start + ruled.end))


def _normal_pair(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors (K, 3) each that are normal to unit vectors (K, 3) and to one another."""
    axis = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(direction, first)


def _through(
    lines: Lines, way: FloatArray, length: FloatArray, contours: tuple[Ruled, ...], box: FloatArray
) -> FloatArray:
    """Lengths (K,) [m] of the slits that lie in the part, as seen along the wire."""
    out = np.zeros(len(lines))
    directions, which = np.unique(lines.direction.round(9), axis=0, return_inverse=True)
    for number, direction in enumerate(directions):
        first, second = _normal_pair(direction[None])
        plane = np.stack([first[0], second[0]], axis=1)
        solid = _solid(contours, plane, box)
        rows = np.flatnonzero(which.ravel() == number)
        at = 0.5 * (lines.start + lines.end)[rows] @ plane
        step = way[rows] @ plane
        slits = shapely.linestrings(np.stack([at + 1e-6 * step, at + length[rows, None] * step], axis=1))
        out[rows] = shapely.length(shapely.intersection(slits, solid))
    return out


def _solid(contours: tuple[Ruled, ...], plane: FloatArray, box: FloatArray) -> shapely.Geometry:
    """The part as seen along a wire: outlines, or the whole block, less their holes, with the pieces in
    those, in the coordinates of ``plane`` (3, 2)."""
    shapes = [(c.hole, shapely.make_valid(shapely.Polygon(_middle(c) @ plane))) for c in contours]
    corners = np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3) @ plane
    block = shapely.MultiPoint(corners).convex_hull
    solid = block if all(hole for hole, _ in shapes) else shapely.Polygon()
    for hole, shape in sorted(shapes, key=lambda own: -own[1].area):  # what lies in another is smaller
        solid = shapely.difference(solid, shape) if hole else shapely.union(solid, shape)
    return solid


def _held(ruled: Ruled, first: IndexArray, backward: bool, cut: SurfaceCut, up: FloatArray) -> FloatArray:
    """How much (K,) the last part of the cut faces the side that is to hold, from -1 to 1; 1 where any will
    do."""
    if cut.last == "any":
        return np.ones(len(first))
    wanted = (
        up if cut.last == "top" else -up if cut.last == "bottom" else np.array(cut.last, dtype=np.float64)
    )
    wanted = wanted / max(float(np.linalg.norm(wanted)), 1e-12)
    before, after = outward_sides(ruled)
    facing = np.mean((before + after) @ wanted, axis=1) * 0.5 * (-1.0 if ruled.hole else 1.0)
    middle = _middle(ruled)
    way = np.linalg.norm(np.diff(middle, axis=0, append=middle[:1]), axis=1)
    facing = 0.5 * (facing + np.roll(facing, -1)) * way  # of the stretch behind each ruling
    total = np.concatenate([[0.0], np.cumsum(np.tile(facing, 2))])
    along = np.concatenate([[0.0], np.cumsum(np.tile(way, 2))])
    part = LAST_PART * way.sum()
    low = along[first] if backward else along[first + len(way)] - part
    return np.asarray((np.interp(low + part, along, total) - np.interp(low, along, total)) / part)


def _sharpness(ruled: Ruled, tries: _Tries, backward: bool) -> FloatArray:
    """How sharply (K,) the wire turns from the slit into the cut and back, 0 straight on to 1 about face."""
    middle, count = _middle(ruled), len(ruled.start)
    sense = -1 if backward else 1
    onward = middle[(tries.first + sense) % count] - middle[tries.first]
    home = middle[tries.first] - middle[(tries.first - sense) % count]
    turns = []
    for inward, way in ((onward, -tries.way), (home, tries.way)):
        cosine = np.sum(inward * way, axis=1) / np.maximum(np.linalg.norm(inward, axis=1), 1e-12)
        turns.append(0.5 - 0.5 * cosine)
    return np.asarray(0.5 * (turns[0] + turns[1]))


CHORD_SHARE: Final = 0.1
"""Share of the tolerance that straight moves between rulings may cost."""
CORNER_SHARE: Final = 0.6
"""Share of the tolerance that corners of the polygon around a convex corner may cost."""
LEAST_LEAD: Final = 2e-3
"""[m] least way in and out, where the surface itself begins in the air."""
PLAIN_STEP_FACTOR: Final = 3.0
"""Where the wire only goes straight on (sides of the block, ways in and out) steps are longer by this."""
TURNING_ROOM: Final = 1e-3
"""[m] the wire's surface is out of the block by this where it turns to go back through its slot."""


@dataclasses.dataclass(frozen=True)
class Cut:
    """A cut: ``into``, ``on`` and ``out`` in order. ``start`` is None for an open strip. ``turns``: number of
    lines of ``out`` after which the wire stands, in the air, and goes back through its slot; 0 for none."""

    wanted: Wanted
    into: Lines
    on: Beside
    out: Lines
    start: Start | None
    turns: int = 0


def make_cut(
    op: Straight,
    wanted: Wanted,
    contours: tuple[Ruled, ...],
    kerf: KerfCurve,
    radius: float,
    box: FloatArray,
    up: FloatArray,
    down: FloatArray | None = None,
) -> Cut:
    """The cut of one surface in the block ``box`` (2, 3); ``radius`` [m] is the wire's, ``contours`` are all
    closed surfaces of the part; ``up`` and ``down`` as for
    :func:`planner.processes.hotwire.plan.straight.cut.choose`."""
    step, feed = op.step_mm * MM, FEED_SHARE * op.feed(wanted.cut)
    plain = step * PLAIN_STEP_FACTOR
    step = plain if isinstance(wanted.cut, TrimCut) else step
    ruled = resample(wanted.ruled, CHORD_SHARE * op.shape_tol_mm * MM, step)
    start = None
    if wanted.ruled.closed and isinstance(wanted.cut, SurfaceCut):
        start = choose(ruled, contours, wanted.cut, box, up, down)
    allowed = op.shape_tol_mm * MM, op.left_mm * MM
    sharpest = _sharpest(0.5 * float(kerf.at(np.array([feed]))[0]), allowed[0])
    on = followed(_row(ruled, wanted, start, sharpest), wanted.ruled, kerf, feed, box, allowed)
    gone = fastest(on.lines, box)
    longest = float(np.nanmax(gone, initial=0.0))
    if longest > 1.05 * step and on.settled:  # the wire in the foam moves farther than its guide points
        ruled = resample(wanted.ruled, CHORD_SHARE * op.shape_tol_mm * MM, step * step / longest)
        if start is not None and isinstance(wanted.cut, SurfaceCut):
            start = choose(ruled, contours, wanted.cut, box, up, down)
        on = followed(_row(ruled, wanted, start, sharpest), wanted.ruled, kerf, feed, box, allowed)
    clear = op.margin_mm * MM + radius
    if start is not None:
        return _closed(wanted, on, start, plain, clear, box)
    return _open(wanted, on, plain, clear, radius, box)


def _row(ruled: Ruled, wanted: Wanted, start: Start | None, sharpest: float) -> Row:
    if start is not None:
        return make_row(ruled, start.first, start.backward, sharpest)
    return make_row(ruled, 0, wanted.cut.reverse, sharpest)


def _sharpest(half: float, tolerance: float) -> float:
    """The largest turn [rad] at one vertex around a convex corner, at which the wire stands off by 1 / cos of
    half of it: no more than ``CORNER_SHARE`` of the tolerance [m] farther than ``half`` a slot."""
    return float(min(VERTEX_TURN, 2.0 * np.arccos(half / (half + CORNER_SHARE * tolerance))))


def _closed(wanted: Wanted, on: Beside, start: Start, step: float, clear: float, box: FloatArray) -> Cut:
    """In through the slit, beyond the first corner by half a kerf on both sides of it, and out again."""
    legs = []
    for k, after in ((0, 1), (-1, -2)):
        corner = _gap(on) > 0.5 * float(on.half[k].max())
        end = _beyond(on, k, after) if corner else on.lines[[k]]
        leg = _straight(end, start.way, step, clear, box)
        legs.append(join([end, leg]) if corner else leg)
    return Cut(wanted, legs[0].reversed(), on, legs[1], start)


def _beyond(on: Beside, k: int, after: int) -> Lines:
    """The wire (1) beyond line ``k``, farther on by half its kerf: both ends at their own speeds, so that the
    slot keeps its width up to the end of the surface."""
    lines = on.lines
    move = np.stack([lines.start[k] - lines.start[after], lines.end[k] - lines.end[after]])
    move *= float(on.half[k].max()) / max(float(np.linalg.norm(move, axis=1).max()), 1e-12)
    return Lines(lines.start[[k]] + move[0], lines.end[[k]] + move[1])


def _gap(on: Beside) -> float:
    """Distance [m] between the first and the last wire of a closed cut, which are apart at a corner."""
    lines = on.lines
    return float(
        np.linalg.norm(lines.start[0] - lines.start[-1]) + np.linalg.norm(lines.end[0] - lines.end[-1])
    )


def _open(wanted: Wanted, on: Beside, step: float, clear: float, radius: float, box: FloatArray) -> Cut:
    """Straight on from both ends of the strip, or back through the slot."""
    lines = on.lines
    ends = [_beyond(on, 0, 1), _beyond(on, -1, -2)]
    first, last = _way(on.row.foot, 0, 1), _way(on.row.foot, -1, -2)
    if isinstance(wanted.cut, SurfaceCut) and wanted.cut.lead != "auto":
        first = -_unit_across(np.array(wanted.cut.lead), lines.direction[0])
    into = join([ends[0], _straight(ends[0], -first, step, clear, box)]).reversed()
    if wanted.cut.leave == "onwards":
        return Cut(wanted, into, on, join([ends[1], _straight(ends[1], -last, step, clear, box)]), None)
    through = radius + float(on.half[-1].max()) + TURNING_ROOM
    away = join([ends[1], _straight(ends[1], -last, step, through, box)])
    out = join([away, away.reversed()[1:], lines.reversed(), into.reversed()])
    return Cut(wanted, into, on, out, None, len(away))


def _way(foot: Lines, k: int, next_one: int) -> FloatArray:
    """Unit vector (3,) from ruling ``k`` to ``next_one``, across the wire."""
    move = foot.start[next_one] - foot.start[k] + foot.end[next_one] - foot.end[k]
    return _unit_across(move, foot.direction[k])


def _unit_across(way: FloatArray, direction: FloatArray) -> FloatArray:
    way = way - (way @ direction) * direction
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def _straight(line: Lines, way: FloatArray, step: float, clear: float, box: FloatArray) -> Lines:
    """Wires from one (1) along ``way`` (3,) until it is ``clear`` [m] of the block, at most ``step`` apart,
    the first one left out."""
    length = max(float(exit_length(line, way[None], grown(box, clear))[0]), LEAST_LEAD)
    count = max(1, int(np.ceil(length / step - 1e-9)))
    share = length * np.arange(1, count + 1) / count
    return Lines(line.start + share[:, None] * way, line.end + share[:, None] * way)
