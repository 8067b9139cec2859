"""Two balls opposite each other across the sheet: where the supporting one is along the way.

The line between the centres follows what the forming ball leans on, as smoothly as the proof's
allowance permits. In a sharp corner the ball stands still, as its centre has a corner there, and
leans on one wall when it comes and on another one when it goes: there the path waits while the
support goes round it. Between targets both balls go straight, so each move is looked at in its
middle, and gets a target there if the gap or the line is off by more than a part of what is
allowed.

**What the ball leans on** (`Touching`) at a place of its centre: the direction across the sheet,
and its thickness. Both are asked of the face at the ball's centre, not at the place that the path
wanted, as the proof does. A mesh has normals that are smooth over its facets, but the place that is
nearest to the ball hops from facet to facet, the more so the less the radius of the ball is below
that of the face. So all facets count that are nearly as near, and the ones that turn away the
farthest are the first that do not count. Walls that meet in a crease are told apart thus.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import DEG, MM
from planner.processes.forming.plan.contact import ContactPath, Face, Pass, ToolPath
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.sheet_mechanics import by_corner
from planner.processes.forming.plan.support.clearance import FIRST_POINTS, MOST_POINTS, FarFace, clear_tilt
from planner.processes.forming.plan.support.directions import (
    axes,
    below_flat,
    insert_at,
    leaned,
    mixed,
    nearest_between,
    off_fan,
    off_upright,
    shares,
    steady_below,
    steady_normals,
    turned,
    turned_at_most,
)
from planner.tooling import FormingHead

NEAREST_WITHIN: Final = 2e-5
"""Facets that are farther from the centre by so much [m] than the nearest one count for nothing."""
TURNED_ANGLE: Final = 5.0 * DEG
"""Those that turn from the nearest one by more [rad] count up to less: as far as the ball has gone along."""
TIED_WITHIN: Final = 4e-6
"""The gap is between those at the places that are as near but for so much [m]."""
SMOOTH_TURN: Final = 8.0 * DEG
"""Facets stand for a smooth face while its normal is off theirs by less than this [rad]."""
CREASE_THICKNESS_SHARE: Final = 0.15
"""Thicknesses on both sides of a crease differ by more than this share of the flat sheet's."""
TOUCHED_WITHIN: Final = 4e-6
"""Places that are as near as the nearest one but for so much [m] are touched at once; the proof counts a
little more of them."""


@dataclasses.dataclass(frozen=True)
class Lean:
    """Of N places of the ball's centre: unit ``normal`` (N, 3) of the face that it leans on, up, and ``gap``
    (N,) [m] wanted between the tools there.

    ``ends`` (N, 4, 3): of all places that it touches at once, the two unit ways to its centre that differ the
    most, and the two normals there of the smooth face: the sheet lies around the ball from one to the other.
    """

    normal: FloatArray
    gap: FloatArray
    ends: FloatArray

    def __getitem__(self, rows: IntArray) -> "Lean":
        return Lean(self.normal[rows], self.gap[rows], self.ends[rows])

    def inserted(self, row: IntArray, other: "Lean") -> "Lean":
        """With others before rows (M,)."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in dataclasses.fields(self))
        return Lean(*(np.insert(mine, row, new, axis=0) for mine, new in pairs))

    def off(self, line: FloatArray) -> FloatArray:
        """Angles (N,) [rad] of unit vectors ``line`` (N, 3) to what lies between the normals of what is
        touched and the vertical, by the ways or by the smooth face, whichever is nearer."""
        return np.minimum(*(off_fan(line, self.ends[:, k], self.ends[:, k + 1]) for k in (0, 2)))

    def nearest(self, normal: FloatArray, most: float) -> FloatArray:
        """Unit ``normal`` (N, 3) turned as little as brings it within ``most`` [rad] of those touched."""
        near = [nearest_between(normal, self.ends[:, k], self.ends[:, k + 1]) for k in (0, 2)]
        nearer = dots(near[0], normal) > dots(near[1], normal)
        return turned_at_most(np.where(nearer[:, None], *near), normal, most)


class Touching:
    """The face of a pass that is formed from above, asked by a ball of ``radius`` [m]; the gap is ``squeeze``
    times the thickness of the sheet, ``thickness`` [m] where it is flat."""

    def __init__(self, one: Pass, radius: float, squeeze: float, thickness: float) -> None:
        self.radius = radius
        self._face = Face(TriangleMesh(one.vertices, one.faces), radius)
        self._gap = squeeze * by_corner(one, thickness)[2].reshape(-1, 3)
        self._jump = CREASE_THICKNESS_SHARE * squeeze * thickness

    def lean(self, centres: FloatArray) -> Lean:
        """What balls about ``centres`` (N, 3) [m] lean on. Where two walls or a wall and a floor are touched
        that are not of one thickness, it is the thinner one."""
        row, face, weights, place, apart = self._face.touched(centres, NEAREST_WITHIN)
        ends = self._ends(row, centres[row] - place, face, weights, apart)
        first = np.searchsorted(row, np.arange(len(centres)))[row]
        normal = _rolled(centres[row] - place, self._face.normal_at(face, weights))
        gap = dots(weights, self._gap[face])
        turn = np.arccos(np.clip(dots(normal, normal[first]), -1.0, 1.0))
        count = 1.0 - (apart - apart[first]) * np.maximum(turn, TURNED_ANGLE) / (
            TURNED_ANGLE * NEAREST_WITHIN
        )
        use = count > 0.0
        least = np.full(len(centres), np.inf)
        np.minimum.at(least, row[use], gap[use])
        use &= gap <= least[row] + self._jump
        row = row[use]
        count, normal, gap, apart = (part[use] for part in (count, normal, gap, apart - apart[first]))
        tied = apart <= TIED_WITHIN
        low, high = np.full(len(centres), np.inf), np.full(len(centres), -np.inf)
        np.minimum.at(low, row[tied], gap[tied])
        np.maximum.at(high, row[tied], gap[tied])
        total, mean = np.zeros((len(centres), 3)), np.zeros(len(centres))
        np.add.at(total, row, count[:, None] * normal)
        np.add.at(mean, row, count * gap)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        mean /= np.bincount(row, count, len(centres))
        # a thinner wall that the ball is about to touch counts alone
        clipped = np.where(high >= low, np.clip(mean, low, high), mean)
        return Lean(total / np.maximum(length, 1e-300), clipped, ends)

    def _ends(
        self, row: IntArray, way: FloatArray, face: IntArray, weights: FloatArray, apart: FloatArray
    ) -> FloatArray:
        """``Lean.ends`` (N, 4, 3) of M pairs by point ``row`` (M,), the nearest first: ``way`` (M, 3) [m] to
        the centre, ``face`` (M,) with ``weights`` (M, 3), and how far (M,) [m] it is."""
        start = np.flatnonzero(np.diff(row, prepend=-1) > 0)
        use = np.flatnonzero(
            apart <= np.repeat(apart[start], np.diff(np.append(start, len(row)))) + TOUCHED_WITHIN
        )
        row, start = row[use], np.searchsorted(row[use], np.arange(len(start)))
        length = np.linalg.norm(way[use], axis=1, keepdims=True)
        smooth = self._face.normal_at(face[use], weights[use])
        kinds = np.where(length > 0.0, way[use] / np.maximum(length, 1e-300), smooth), smooth
        return np.stack([end for kind in kinds for end in _farthest(kind, row, start)], axis=1)


def _farthest(unit: FloatArray, row: IntArray, start: IntArray) -> tuple[FloatArray, FloatArray]:
    """The two (N, 3) each of unit vectors (M, 3) of N rows, beginning at ``start`` (N,), that differ most."""
    one = start
    for _ in range(2):  # the farthest from any one, and the farthest from that
        order = np.lexsort((dots(unit, unit[one[row]]), row))
        one, other = order[start], one
    return unit[one], unit[other]


def _rolled(way: FloatArray, normal: FloatArray) -> FloatArray:
    """Unit ``normal`` (M, 3) of facets, but over an edge, where those are off the ``way`` (M, 3) from there
    to the ball's centre, this: there the ball rolls from one facet to the next."""
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = np.where(length > 0.0, way / np.maximum(length, 1e-300), normal)
    off = np.arccos(np.clip(dots(way, normal), -1.0, 1.0))
    return turned_at_most(way, normal, off * np.clip(2.0 - off / SMOOTH_TURN, 0.0, 1.0))


BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

SUPPORT_LIFT: Final = 5e-3
"""How far [m] the support draws back from the sheet where the forming tool goes over in the air."""
AIR_DISTANCE: Final = 3e-3
"""Distance [m] of the forming ball from the face beyond which it is in the air."""
CHORD_SHARE: Final = 0.3
"""Part of the gap's tolerance that straight moves between targets may take."""
DRIFT_SHARE: Final = 0.8
"""Part of what the user lets the gap be off with one controller ahead that is planned for."""
FACING_TURN: Final = 4.0 * DEG
"""The line of two tools is between the face's normal and the vertical, to which the support is turned where
it would cut into the flat or where a shift is stated, and off that by this [rad] at most."""
STEADY_TURN: Final = 1.2 * DEG
"""What of that [rad] goes to steadying the line at targets; between them it may be off twice as far."""
TARGET_TURN: Final = 2.5 * DEG
"""The line's direction is within this [rad] of what lies between all places that the ball touches at a
target."""
MIDWAY_TURN: Final = 3.0 * DEG
"""The same [rad] between targets."""
WAITING_TURN: Final = 8.0 * DEG
"""Where what the ball leans on turns by more than this [rad] at once, it waits for the support."""
_CORNER_HALVINGS: Final = 14
"""Moves are at most some millimetres long, and a corner's place is to be known to a micrometre."""
AT_TARGET: Final = 5e-6
"""A corner that is so near [m] to a target is at it."""
_SHORT_MOVE: Final = 5e-5
"""Moves of both tools that are not longer [m] are not parted."""
_STANDING_MOVE: Final = 3e-6
"""A ball that goes no farther [m] while what it leans on turns stands at a corner."""
_SPLIT_ROUNDS: Final = 40
"""Moves are parted so often at most. Where the line has to turn steadily, a finer move leaves less of a turn
to its neighbour, which is next; rounds with few of them cost little."""


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """N targets: ``contact``; ``lean`` at them; ``still`` (N,): the forming ball stands still on the way to
    the target; ``middle``: what it leans on halfway there, of which the first row has no meaning; ``off``
    (N,): 1 where the ball steps over, off the face but not in the air, 0 on it, and between on the way from
    one to the other."""

    contact: ContactPath
    lean: Lean
    still: BoolArray
    middle: Lean
    off: FloatArray


def opposite_path(
    one: Pass,
    contact: ContactPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead,
    thickness: float,
    every: int = 0,
    between: bool = True,
) -> ToolPath:
    """Both tools along ``contact`` over a pass formed from above, for dsif and dpif_l; two controllers meet
    after so many moves, where ``every`` is not 0. If not ``between``, no target is added."""
    points = MOST_POINTS if between else FIRST_POINTS
    level, far = one.start - thickness, FarFace(one, thickness, contact, former.radius, points)
    touching = Touching(one, former.radius, operation.squeeze, thickness)
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    radii, allowed = former.radius + support.radius, CHORD_SHARE * operation.gap_tol_mm * MM
    slack = operation.gouge_tol_mm * MM
    way = waited(contact, touching, slack) if between else straight(contact, touching, slack)
    for left in range(_SPLIT_ROUNDS if between else 0, -1, -1):
        contact, gap = way.contact, way.lean.gap
        apart = gap + radii
        # far from the face the support goes farther than the former, in a corner by far
        about = contact.centre - radii * way.lean.normal
        normal = way.lean.nearest(steady_normals(way.lean.normal, about, STEADY_TURN), TARGET_TURN)
        steep = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
        # off the face it cannot be opposite that: it is below what the ball stands on
        tilt = (1.0 - way.off) * np.maximum(steep - shift, 0.0)
        tilt = np.minimum(tilt, below_flat(contact.centre[:, 2], apart, level, support.radius))
        squeezed = np.maximum(thickness * np.cos(contact.angle) - gap, 0.0)
        inner = support.radius - squeezed - operation.gouge_tol_mm * MM
        facing = dataclasses.replace(contact, normal=normal)
        tilt = steady_below(clear_tilt(far, facing, tilt, apart, inner), about)
        across = apart[:, None] * leaned(normal, tilt)
        air = np.linalg.norm(contact.centre - contact.point, axis=1) > former.radius + AIR_DISTANCE
        if not between:
            count = np.ones(len(air), dtype=np.int64)
            break
        count = np.maximum(
            _pieces(way, across, radii, allowed), _uneven(way, across, radii, allowed, touching)
        )
        if every:
            ahead = DRIFT_SHARE * operation.handshake_gap_mm * MM
            count = np.maximum(count, _drifting(contact.centre, across, gap + radii, every, ahead))
        count[1:][air[1:] | air[:-1]] = 1
        if left == 0 or count.max() == 1:
            break
        way = parted(way, count, touching)
    place = contact.centre - across
    _draw_back(place, air, one, thickness, support.radius)
    lean = operation.lean_deg * DEG
    return ToolPath(
        former=contact.centre,
        axis=axes(contact.normal, lean),
        support=place,
        support_axis=leaned(normal, np.minimum(tilt, lean)),
        gap=np.where(air, np.nan, gap),
        contact=contact,
        loose=count > 1,
    )


def waited(contact: ContactPath, touching: Touching, slack: float, spread: float = 0.0) -> Way:
    """The way with two targets at one place wherever what the ball leans on jumps: as it comes and as it
    goes, ``spread`` [m] before and behind. Where it does not touch within ``slack`` [m] it is off the
    face."""
    aloft = _aloft(contact, touching, slack)
    at = touching.lean(contact.centre)
    step = np.linalg.norm(np.diff(contact.centre, axis=0), axis=1)
    rows = np.flatnonzero((_angle(at.normal[1:], at.normal[:-1]) > WAITING_TURN) & (step > 0.0)) + 1
    one, two = at[rows - 1], at[rows]
    low, high = np.zeros(len(rows)), np.ones(len(rows))
    for _ in range(_CORNER_HALVINGS):  # keeping the half over which it turns the more
        middle = 0.5 * (low + high)
        found = touching.lean(mixed(contact.centre[rows - 1], contact.centre[rows], middle))
        first = _angle(one.normal, found.normal) > _angle(found.normal, two.normal)
        low, high = np.where(first, low, middle), np.where(first, middle, high)
        one, two = _either(first, one, found), _either(first, found, two)
    middle = 0.5 * (low + high)
    if spread:  # beside a crease it leans a little on either wall
        aside = spread / step[rows - 1]
        low, high = np.maximum(low - aside, 0.0), np.minimum(high + aside, 1.0)
        way = contact.centre[rows - 1], contact.centre[rows]
        one, two = touching.lean(mixed(*way, low)), touching.lean(mixed(*way, high))
    jump = np.flatnonzero(_angle(one.normal, two.normal) > WAITING_TURN)
    place, row, pair = middle[jump], rows[jump], (one[jump], two[jump])
    # where that is at a target already, this is one of the two
    apart = step[row - 1] * place, step[row - 1] * (1.0 - place)
    own = [
        (apart[k] < AT_TARGET) & (_angle(pair[k].normal, at.normal[row - 1 + k]) < STEADY_TURN)
        for k in range(2)
    ]
    row, place = np.repeat(row, 2), np.repeat(place, 2)
    kept = ~np.column_stack(own).ravel()
    normal = np.stack([part.normal for part in pair], axis=1).reshape(-1, 3)
    gap = np.column_stack([part.gap for part in pair]).ravel()
    ends = np.stack([part.ends for part in pair], axis=1).reshape(-1, 4, 3)
    path = insert_at(contact, row[kept], place[kept], normal[kept], touching.radius)
    lean = at.inserted(row[kept], Lean(normal, gap, ends)[kept])
    # the second of each pair is reached without a way, be it new or the target behind
    new = np.insert(np.arange(len(step) + 1), row[kept], -1 - np.flatnonzero(kept))
    still = np.isin(new, -1 - np.flatnonzero(kept)[np.flatnonzero(kept) % 2 == 1])
    still |= np.isin(new, row[1::2][own[1]])
    between = np.concatenate([path.centre[:1], 0.5 * (path.centre[1:] + path.centre[:-1])])
    off = np.insert(aloft, row[kept], aloft[row[kept]] | aloft[row[kept] - 1]).astype(np.float64)
    return Way(path, lean, still, touching.lean(between), off)


def straight(contact: ContactPath, touching: Touching, slack: float) -> Way:
    """The way with the targets of ``contact`` alone, as if what the ball leans on jumped nowhere."""
    at, still = touching.lean(contact.centre), np.zeros(len(contact.centre), dtype=np.bool_)
    return Way(contact, at, still, at, _aloft(contact, touching, slack).astype(np.float64))


def _aloft(contact: ContactPath, touching: Touching, slack: float) -> BoolArray:
    """Whether (N,) the ball steps over, off the face by more than ``slack`` [m] but not in the air."""
    away = np.linalg.norm(contact.centre - contact.point, axis=1) - touching.radius
    return np.asarray(~contact.working & (away > slack) & (away <= AIR_DISTANCE))


def _either(first: BoolArray, one: Lean, two: Lean) -> Lean:
    rows = np.where(first, np.arange(len(first)), len(first) + np.arange(len(first)))
    return one.inserted(np.full(len(first), len(first)), two)[rows]


def _pieces(way: Way, across: FloatArray, radii: float, allowed: float) -> IntArray:
    """Into how many (N,) pieces the move to each target is to be parted: more than one where in its middle
    the gap is off by more than ``allowed`` [m] or the line by too much, or where the forming ball stands
    still; then as many as the turn of the line needs. ``across`` (N, 3) [m]: from the support to the former.
    """
    length = np.linalg.norm(across, axis=1)
    middle = 0.5 * (across[1:] + across[:-1])
    least = np.linalg.norm(middle, axis=1)
    off = np.maximum(np.abs(least - radii - way.middle.gap[1:]), 0.5 * (length[1:] + length[:-1]) - least)
    line = middle / least[:, None]
    turned_off = off_upright(line, way.middle.normal[1:]) > 2.0 * STEADY_TURN
    turned_off |= way.middle[np.arange(1, len(length))].off(line) > MIDWAY_TURN
    step = np.linalg.norm(np.diff(way.contact.centre, axis=0), axis=1)
    moved = np.maximum(step, np.linalg.norm(np.diff(way.contact.centre - across, axis=0), axis=1))
    two = ((off > allowed) | turned_off) & (moved > _SHORT_MOVE)
    finest = 2.0 * np.arccos(1.0 - 0.5 * allowed / length[1:])
    arc = np.ceil(_angle(across[1:] / length[1:, None], across[:-1] / length[:-1, None]) / finest)
    count = np.where(way.still[1:], np.maximum(arc, 1.0), np.where(two, np.maximum(arc, 2.0), 1.0))
    return np.concatenate([[1], count]).astype(np.int64)


def _uneven(way: Way, across: FloatArray, radii: float, allowed: float, touching: Touching) -> IntArray:
    """Into how many (N,) pieces the move to each target is to be parted: two where the gap that is wanted
    changes on it by more than ``allowed`` [m], and is off by as much at a quarter of it from either end."""
    gap, centre = way.lean.gap, way.contact.centre
    rows = np.flatnonzero(np.abs(np.diff(gap)) > allowed) + 1
    step = np.linalg.norm(centre[rows] - centre[rows - 1], axis=1)
    rows = rows[(step > _SHORT_MOVE) & ~way.still[rows]]
    count = np.ones(len(gap), dtype=np.int64)
    for share in (0.25, 0.75) if len(rows) else ():
        look = np.full(len(rows), share)
        wanted = touching.lean(mixed(centre[rows - 1], centre[rows], look)).gap
        made = np.linalg.norm(mixed(across[rows - 1], across[rows], look), axis=1) - radii
        count[rows[np.abs(made - wanted) > allowed]] = 2
    return count


def _drifting(
    centre: FloatArray, across: FloatArray, apart: FloatArray, every: int, allowed: float
) -> IntArray:
    """Into how many (N,) pieces the move to each target is to be parted so that with one arm up to ``every``
    moves ahead of the other the distance of the balls is off ``apart`` (N,) [m] by no more than ``allowed``
    [m]."""
    place = centre - across
    count = np.ones(len(centre), dtype=np.int64)
    for ahead in range(1, min(every, len(centre) - 1) + 1):
        one = np.abs(np.linalg.norm(centre[ahead:] - place[:-ahead], axis=1) - apart[ahead:])
        two = np.abs(np.linalg.norm(centre[:-ahead] - place[ahead:], axis=1) - apart[:-ahead])
        off = np.maximum(one, two)
        many = np.where(off > allowed, np.ceil(np.sqrt(off / allowed)), 1.0).astype(np.int64)
        for step in range(ahead):  # each of the moves between is as short
            np.maximum.at(count, np.arange(1 + step, 1 + step + len(many)), many)
    step = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    moved = np.maximum(step, np.linalg.norm(np.diff(place, axis=0), axis=1))
    return np.where(np.append(0.0, moved) > _SHORT_MOVE, count, 1)


def parted(way: Way, count: IntArray, touching: Touching) -> Way:
    """The way with its moves parted into ``count`` (N,) pieces each."""
    row, share = shares(count)
    still = way.still[row]
    normal = turned(way.lean.normal[row - 1], way.lean.normal[row], share)
    gap = way.lean.gap[row - 1] + share * (way.lean.gap[row] - way.lean.gap[row - 1])
    centre = mixed(way.contact.centre[row - 1], way.contact.centre[row], share)
    found = touching.lean(centre)
    normal = np.where(still[:, None], normal, found.normal)
    gap = np.where(still, gap, found.gap)
    lean = way.lean.inserted(row, Lean(normal, gap, found.ends))
    contact = insert_at(way.contact, row, share, normal, touching.radius)
    fresh = np.flatnonzero(np.insert(count > 1, row, True))
    middle = way.middle.inserted(row, found)
    found = touching.lean(mixed(contact.centre[fresh - 1], contact.centre[fresh], np.full(len(fresh), 0.5)))
    middle.normal[fresh], middle.gap[fresh], middle.ends[fresh] = found.normal, found.gap, found.ends
    step = np.linalg.norm(np.diff(contact.centre, axis=0, prepend=contact.centre[:1]), axis=1)
    turned_far = _angle(lean.normal, np.concatenate([lean.normal[:1], lean.normal[:-1]])) > STEADY_TURN
    still = np.insert(way.still, row, still) | ((step < _STANDING_MOVE) & turned_far)
    off = np.insert(way.off, row, way.off[row - 1] + share * (way.off[row] - way.off[row - 1]))
    return Way(contact, lean, still, middle, off)


def _angle(one: FloatArray, two: FloatArray) -> FloatArray:
    """Angles (N,) [rad] between unit vectors (N, 3)."""
    return np.asarray(np.arccos(np.clip(dots(one, two), -1.0, 1.0)))


def _draw_back(place: FloatArray, air: BoolArray, one: Pass, thickness: float, radius: float) -> None:
    """Where the forming tool goes over in the air the support leaves the sheet straight down, and comes back
    straight up."""
    if not air.any() or air.all():
        return
    low = float(one.vertices[:, 2].min()) - thickness - radius - SUPPORT_LIFT
    rows = np.flatnonzero(air)
    touching = np.flatnonzero(~air)
    after = np.searchsorted(touching, rows)
    first = np.concatenate([[True], np.diff(rows) > 1])
    source = np.where(
        (first & (after > 0)) | (after == len(touching)),
        touching[np.maximum(after - 1, 0)],
        touching[np.minimum(after, len(touching) - 1)],
    )
    place[rows] = np.column_stack([place[source, :2], np.full(len(rows), low)])
