"""Targets on a curve of contact: as few as the turn of its tangent, the straight moves of the ball's centre
and the longest move allow."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.forming.contact import Face
from planner.forming.path_options import PathOptions
from planner.forming.paths_tool import Creases, refuse
from planner.forming.spiral import Curve
from planner.geometry.vectors import dots

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_Put = Callable[[FloatArray], "Targets"]

NEAREST: Final = 5e-5
"""Targets are at least so far apart [m]."""
_CORNER: Final = np.radians(15.0)
_ROUNDS: Final = 8
_HALVINGS: Final = 10
_CLOSED: Final = 3e-4
"""Where a crease keeps the ball off a piece of the curve whose ends are so near [m], the piece is a corner
and the ball goes from end to end."""
_LOOKS: Final = (0.5, 0.3, 0.7)
"""Shares of a move at which is looked how deep it cuts into the face."""
_SPARE: Final = 0.9
_FIRST: Final = 40


@dataclasses.dataclass(frozen=True)
class Targets:
    """N targets: ``at`` (N,) row of the curve, with fractions; ``point``, ``normal``, ``centre`` (N, 3) as in
    ``ContactPath``; ``loop``, ``piece`` (N,); ``kept`` (N,): ends of loops; ``missed`` (N,): a crease keeps
    the ball off the wanted place."""

    at: FloatArray
    point: FloatArray
    normal: FloatArray
    centre: FloatArray
    loop: IntArray
    piece: IntArray
    kept: BoolArray
    missed: BoolArray

    def __getitem__(self, rows: IntArray | BoolArray) -> Targets:
        return Targets(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


def targets(curve: Curve, face: Face, creases: Creases, options: PathOptions, name: str) -> Targets:
    """Targets on a curve, at least 0.05 mm apart.

    Raises ``TooNarrow`` where the face is too narrow for the ball.
    """

    def put(at: FloatArray) -> Targets:
        return _put(at, curve, face, creases, options.missed, name)

    at = _spread(curve, face.radius, options)
    # a tool that is far too large is told soon, by a few places
    wanted, normal = places(curve, face, creases, at[:: -(-len(at) // _FIRST)])
    contact = face.clear(wanted, normal, rounds=3)
    narrow = (contact.gap > 0.02 * face.radius) & ~creases.near(wanted)
    if narrow.any():
        raise refuse(name, face, wanted[narrow], normal[narrow], contact.gap[narrow], options.missed)
    found = put(at)
    found = _corners(found, put)
    found = _halved(found, put, face, options)
    return _apart(found)


def places(curve: Curve, face: Face, creases: Creases, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Wanted places (N, 3) [m] and unit normals (N, 3) at rows ``at`` (N,) of a curve."""
    row = np.clip(np.floor(at).astype(np.int64), 0, len(curve.point) - 2)
    share = (at - row)[:, None]
    point = (1.0 - share) * curve.point[row] + share * curve.point[row + 1]
    normal = (1.0 - share) * curve.normal[row] + share * curve.normal[row + 1]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # rows themselves may be off the face too, inside a spiral
    ends = np.concatenate([[False], curve.off]), np.concatenate([curve.off, [False]])
    inner = ends[0] & ends[1]
    loose = np.where(
        share[:, 0] == 0.0, inner[row], np.where(share[:, 0] == 1.0, inner[row + 1], curve.off[row])
    )
    rows = np.flatnonzero(loose)
    if len(rows):
        place, on, weights = face.nearest(point[rows])
        point[rows] = place
        own = face.normal_at(on, weights)
        # in a fillet that is low for the step the normals of the loops beside are far from its own
        smooth = (dots(own, normal[rows]) > np.cos(_CORNER)) | ~creases.near(place)
        normal[rows] = np.where(smooth[:, None], own, normal[rows])
    return point, normal


def _put(at: FloatArray, curve: Curve, face: Face, creases: Creases, missed: float, name: str) -> Targets:
    wanted, normal = places(curve, face, creases, at)
    contact = face.clear(wanted, normal)
    narrow = creases.too_narrow(wanted, contact, missed)
    if narrow.any():
        raise refuse(name, face, wanted[narrow], normal[narrow], contact.gap[narrow], missed)
    row = np.round(at).astype(np.int64)
    return Targets(
        at,
        contact.point,
        contact.normal,
        contact.centre,
        curve.loop[np.ceil(at - 1e-9).astype(np.int64)],
        curve.piece[row],
        curve.keep[row] & (row == at),
        creases.misses(wanted, contact),
    )


def _spread(curve: Curve, radius: float, options: PathOptions) -> FloatArray:
    """Rows, with fractions, at which targets are put first."""
    point, centre = curve.point, curve.point + radius * curve.normal
    gap = np.diff(curve.piece) != 0
    turn, _ = _turns(point, gap)
    bend, pace = _turns(centre, gap)
    length = np.maximum(np.linalg.norm(np.diff(point, axis=0), axis=1), pace)
    corner = turn > max(_CORNER, 1.01 * options.tangent_angle)
    bend = np.where(corner, 0.0, bend)
    width = np.maximum(0.5 * (np.append(pace, 0.0) + np.append(0.0, pace)), 1e-9)
    # a move of length L over a polyline that turns by b at rows w apart is off it by L (b L / w + b) / 8
    chord = 0.5 * (bend + np.sqrt(bend * bend + 32.0 * _SPARE * options.chord * bend / width))
    chord *= width / (8.0 * _SPARE * options.chord)
    demand = np.maximum(np.where(corner, 0.0, turn) / options.tangent_angle, chord)
    # half of a row's demand lies on either side of it
    between = np.maximum(0.5 * (demand[1:] + demand[:-1]), length / options.longest)
    between[gap] = 0.0
    keep = curve.keep | corner
    keep[0] = keep[-1] = True
    keep[:-1] |= gap
    keep[1:] |= gap
    total = np.concatenate([[0.0], np.cumsum(between)])
    rows = np.flatnonzero(keep)
    need = np.diff(total[rows])
    parts = np.maximum(np.ceil(need - 1e-9), 1).astype(np.int64)
    section = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(section)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[section]
    wanted = total[rows[section]] + share * need[section]
    at = np.interp(wanted, total, np.arange(len(total)))
    at[share == 0.0] = rows[section[share == 0.0]]
    # what spreads over the way between two pieces is on no piece
    inside = ~gap[np.minimum(at.astype(np.int64), len(gap) - 1)] | (share == 0.0)
    return np.append(at[inside], float(rows[-1]))


def _turns(point: FloatArray, gap: BoolArray) -> tuple[FloatArray, FloatArray]:
    """By how much (K,) [rad] a polyline turns at its rows, and how long (K - 1,) its moves are."""
    move = np.diff(point, axis=0)
    length = np.linalg.norm(move, axis=1)
    good = (length > 1e-7) & ~gap
    turn = np.zeros(len(point))
    rows = np.flatnonzero(good)
    way = move[rows] / length[rows, None]
    cosine = dots(way[1:], way[:-1])
    sine = np.linalg.norm(np.cross(way[1:], way[:-1]), axis=1)
    bent = np.arctan2(sine, cosine)
    broken = np.cumsum(gap)[rows[1:]] != np.cumsum(gap)[rows[:-1]]
    turn[rows[1:]] = np.where(broken, 0.0, bent)
    return turn, length


def _corners(found: Targets, put: _Put) -> Targets:
    """Where creases keep the ball off: the last places that it reaches on either side, and nothing between if
    they have become one."""
    same = found.piece[1:] == found.piece[:-1]
    edge = np.flatnonzero(same & (found.missed[1:] != found.missed[:-1]))
    if not len(edge):
        return found
    good = np.where(found.missed[edge], found.at[edge + 1], found.at[edge])
    bad = np.where(found.missed[edge], found.at[edge], found.at[edge + 1])
    for _ in range(_HALVINGS):
        middle = 0.5 * (good + bad)
        out = put(middle).missed
        good, bad = np.where(out, good, middle), np.where(out, middle, bad)
    found = _merged(found, put(good))
    run = np.cumsum(np.append(0, found.missed[1:] != found.missed[:-1]))
    first = np.searchsorted(run, run, side="left")
    last = np.searchsorted(run, run, side="right") - 1
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(run) - 1)
    whole = (first > 0) & (last < len(run) - 1) & (found.piece[before] == found.piece[after])
    near = np.linalg.norm(found.centre[after] - found.centre[before], axis=1) < _CLOSED
    return found[~(found.missed & whole & near)]


def _halved(found: Targets, put: _Put, face: Face, options: PathOptions) -> Targets:
    """Targets put between those whose straight move leaves the way of the centre."""
    check = np.ones(len(found.at) - 1, dtype=np.bool_)
    for _ in range(_ROUNDS):
        length = np.linalg.norm(np.diff(found.centre, axis=0), axis=1)
        check &= (found.piece[1:] == found.piece[:-1]) & (length > 2.0 * NEAREST)
        rows = np.flatnonzero(check)
        if not len(rows):
            break
        middle = put(0.5 * (found.at[rows] + found.at[rows + 1]))
        off = _off_line(middle.centre, found.centre[rows], found.centre[rows + 1])
        # at a corner the middle is not where the ball goes; only what it cuts there counts
        more = ~middle.missed & (off > options.chord) | (length[rows] > 1.001 * options.longest)
        may = np.flatnonzero(~more & (middle.missed | (off > options.cut)))
        for share in _LOOKS if len(may) else ():
            way = found.centre[rows[may] + 1] - found.centre[rows[may]]
            more[may] |= face.clearance(found.centre[rows[may]] + share * way) < face.radius - options.cut
        if not more.any():
            break
        fresh = np.zeros(len(found.at), dtype=np.bool_)
        fresh[rows[more]] = True
        slots = np.flatnonzero(fresh) + np.arange(1, int(more.sum()) + 1)
        found = _merged(found, middle[more])
        check = np.zeros(len(found.at) - 1, dtype=np.bool_)
        check[slots - 1] = check[slots] = True
    return found


def _off_line(points: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    way, rest = two - one, points - one
    share = dots(rest, way) / np.maximum(dots(way, way), 1e-300)
    return np.asarray(np.linalg.norm(rest - np.clip(share, 0.0, 1.0)[:, None] * way, axis=1))


def _merged(one: Targets, two: Targets) -> Targets:
    order = np.argsort(np.concatenate([one.at, two.at]), kind="stable")
    both = (np.concatenate([getattr(one, f.name), getattr(two, f.name)]) for f in dataclasses.fields(one))
    return Targets(*(part[order] for part in both))


def _apart(found: Targets) -> Targets:
    """Without targets whose centres are nearer than 0.05 mm to the one before; ends of pieces stay."""
    while len(found.at) > 2:
        near = np.linalg.norm(np.diff(found.centre, axis=0), axis=1) < NEAREST
        same = found.piece[1:] == found.piece[:-1]
        if not (near & same).any():
            break
        pair = np.flatnonzero(near & same)
        end = np.append(~same, True)[pair + 1] | (found.kept[pair + 1] & ~found.kept[pair])
        victim = np.zeros(len(found.at), dtype=np.bool_)
        victim[np.where(end, pair, pair + 1)] = True
        start = np.concatenate([[True], ~same])
        victim &= ~(start & ~np.append(~same, True))  # a piece of one target stays
        if not victim.any():
            break
        run = np.cumsum(np.append(0, victim[1:] != victim[:-1]))
        place = np.arange(len(run)) - np.searchsorted(run, run, side="left")
        found = found[~(victim & (place % 2 == 0))]
    return found
