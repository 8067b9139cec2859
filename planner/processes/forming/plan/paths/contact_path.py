"""The path of the contact on the face of a pass, of the ball's centre, and targets along it.

Targets on the curve of contact are as few as the turn of its tangent, the straight moves of the
ball's centre and the longest move allow.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from shapely import Polygon

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError, refusal
from planner.processes.forming.plan.contact import MIRROR, ContactPath, Face, Pass
from planner.processes.forming.plan.paths.level_lines import (
    FLAT_MARGIN,
    Loop,
    constant_levels,
    cut,
    scallop_levels,
    scallop_width,
)
from planner.processes.forming.plan.paths.level_lines import loops as closed_lines
from planner.processes.forming.plan.paths.spiral import Curve, PathOptions, in_order, loop_curve, spiral_curve
from planner.processes.forming.plan.paths.tool_radius import (
    Creases,
    TooNarrow,
    largest,
    lowest_reached,
    refuse,
)

_Put = Callable[[FloatArray], "Targets"]

LEAST_SPACING: Final = 5e-5
"""Targets are at least so far apart [m]."""
_CORNER_TURN: Final = np.radians(15.0)
"""Normals that turn by more than this [rad] from place to place do so at a corner, which gets no targets
within."""
_SPLIT_ROUNDS: Final = 8
"""Moves are halved so often at most where they leave the way of the ball's centre."""
_END_HALVINGS: Final = 10
"""Halvings by which the end of a piece that the ball does not reach is found."""
_CLOSED_GAP: Final = 3e-4
"""Where a crease keeps the ball off a piece of the curve whose ends are so near [m], the piece is a corner
and the ball goes from end to end."""
_TRIED_SHARES: Final = np.array([0.25, 0.5, 0.75])
"""Places of a straight move at which it is tried whether it cuts in."""
_CHORD_SHARE: Final = 0.9
"""Share of the chord that the spacing of targets is worked out with."""
_TRIED_PLACES: Final = 40
"""Places about that tell soon of a ball that is far too large."""


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

    def __getitem__(self, rows: IntArray | BoolArray) -> "Targets":
        return Targets(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


def targets(curve: Curve, face: Face, creases: Creases, options: PathOptions, name: str) -> Targets:
    """Targets on a curve, at least 0.05 mm apart.

    Raises ``TooNarrow`` where the face is too narrow for the ball.
    """

    def put(at: FloatArray) -> Targets:
        return _put(at, curve, face, creases, options.missed, name)

    at = _spread(curve, face.radius, options)
    # a tool that is far too large is told soon, by a few places
    wanted, normal = places(curve, face, creases, at[:: -(-len(at) // _TRIED_PLACES)])
    contact = face.clear(wanted, normal, rounds=3)
    narrow = (contact.gap > max(0.02 * face.radius, options.missed)) & ~creases.near(wanted)
    if narrow.any():
        raise refuse(name, face, wanted[narrow], normal[narrow], contact.gap[narrow], options.missed)
    found = put(at)
    found = _corners(found, put)
    found = _halved(found, put, face, options)
    found = _rolled(found, face, options.cut)
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
        smooth = (dots(own, normal[rows]) > np.cos(_CORNER_TURN)) | ~creases.near(place)
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
    corner = turn > max(_CORNER_TURN, 1.01 * options.tangent_angle)
    bend = np.where(corner, 0.0, bend)
    width = np.maximum(0.5 * (np.append(pace, 0.0) + np.append(0.0, pace)), 1e-9)
    # a move of length L over a polyline that turns by b at rows w apart is off it by L (b L / w + b) / 8
    chord = 0.5 * (bend + np.sqrt(bend * bend + 32.0 * _CHORD_SHARE * options.chord * bend / width))
    chord *= width / (8.0 * _CHORD_SHARE * options.chord)
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
    for _ in range(_END_HALVINGS):
        middle = 0.5 * (good + bad)
        out = put(middle).missed
        good, bad = np.where(out, good, middle), np.where(out, middle, bad)
    found = _merged(found, put(good))
    run = np.cumsum(np.append(0, found.missed[1:] != found.missed[:-1]))
    first = np.searchsorted(run, run, side="left")
    last = np.searchsorted(run, run, side="right") - 1
    before, after = np.maximum(first - 1, 0), np.minimum(last + 1, len(run) - 1)
    whole = (first > 0) & (last < len(run) - 1) & (found.piece[before] == found.piece[after])
    near = np.linalg.norm(found.centre[after] - found.centre[before], axis=1) < _CLOSED_GAP
    return found[~(found.missed & whole & near)]


def _halved(found: Targets, put: _Put, face: Face, options: PathOptions) -> Targets:
    """Targets put between those whose straight move leaves the way of the centre."""
    check = np.ones(len(found.at) - 1, dtype=np.bool_)
    for _ in range(_SPLIT_ROUNDS):
        length = np.linalg.norm(np.diff(found.centre, axis=0), axis=1)
        check &= (found.piece[1:] == found.piece[:-1]) & (length > 2.0 * LEAST_SPACING)
        rows = np.flatnonzero(check)
        if not len(rows):
            break
        middle = put(0.5 * (found.at[rows] + found.at[rows + 1]))
        off = _off_line(middle.centre, found.centre[rows], found.centre[rows + 1])
        straight = 0.5 * (found.centre[rows] + found.centre[rows + 1])
        # at a corner the middle is not where the ball goes; only what it cuts there counts
        odd = np.flatnonzero(middle.missed)
        cuts = dots(middle.centre - straight, middle.normal) > options.cut
        if len(odd):
            cuts[odd] = face.clearance(straight[odd]) < face.radius - min(options.chord, options.cut)
        more = cuts | (~middle.missed & (off > options.chord)) | (length[rows] > 1.001 * options.longest)
        if not more.any():
            break
        fresh = np.zeros(len(found.at), dtype=np.bool_)
        fresh[rows[more]] = True
        slots = np.flatnonzero(fresh) + np.arange(1, int(more.sum()) + 1)
        found = _merged(found, middle[more])
        check = np.zeros(len(found.at) - 1, dtype=np.bool_)
        check[slots - 1] = check[slots] = True
    return found


def _rolled(found: Targets, face: Face, cut: float) -> Targets:
    """Targets put where the ball rolls over a convex edge: on the way from loop to loop the nearest place of
    the face hops over it, however near targets are, and the straight move from one side to the other cuts
    into the edge by more than ``cut`` [m]. There the place nearest to the move is on the edge."""
    check = np.ones(len(found.at) - 1, dtype=np.bool_)
    share = _TRIED_SHARES[:, None, None]
    for _ in range(_SPLIT_ROUNDS):
        turned = dots(found.normal[1:], found.normal[:-1]) < 1.0 - cut / face.radius
        rows = np.flatnonzero(check & turned & (found.piece[1:] == found.piece[:-1]))
        if not len(rows):
            break
        one, two = found.centre[rows], found.centre[rows + 1]
        way = ((1.0 - share) * one + share * two).reshape(-1, 3)
        clear = face.clearance(way).reshape(len(share), len(rows))
        rows = rows[clear.min(axis=0) < face.radius - cut]
        if not len(rows):
            break
        _, place, away = face.deepest(0.5 * (found.centre[rows] + found.centre[rows + 1]))
        over = face.clear(place, away)
        still = np.zeros(len(rows), dtype=np.bool_)
        middle = Targets(
            0.5 * (found.at[rows] + found.at[rows + 1]),
            over.point,
            over.normal,
            over.centre,
            found.loop[rows + 1],
            found.piece[rows],
            still,
            still,
        )
        found = _merged(found, middle)
        check = np.zeros(len(found.at) - 1, dtype=np.bool_)
        slots = rows + np.arange(1, len(rows) + 1)
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
        near = np.linalg.norm(np.diff(found.centre, axis=0), axis=1) < LEAST_SPACING
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


MOST_LEVEL_LINES: Final = 20_000
"""Level lines of a path at most."""


def make_path(one: Pass, radius: float, options: PathOptions) -> ContactPath:
    """The way of the contact of a ball of ``radius`` [m] over the face of a pass, level by level from its
    start to its end.

    The ball touches the face (to 3 um) at every target and cuts into it nowhere (to 2 um), nor by more than
    ``options.cut`` on the straight moves between targets of its centre. Targets are at least 0.05 mm apart.
    Concave creases, where no ball fits, are left with a fillet of the ball's own radius: the path keeps off
    them as far as it must. Rows whose ``working`` is False are the ends of moves that do not form (lifts to
    another loop; the move along the sheet of kind "stepped"): at those in the air ``point`` is the nearest
    place of the face.

    Raises ``TandemError``: ``forming.path_options`` for a step, chord ... that is out of range,
    ``forming.no_contour`` if nothing of the face is between its levels, ``forming.open_contour`` where the
    mesh ends, ``forming.tool_radius`` where a smooth place is narrower than the ball.
    """
    _check(one, radius, options)
    try:
        return _path(one, radius, options)
    except TooNarrow as narrow:
        fits = largest(narrow, lambda smaller: _path(one, smaller, options), options.scallop or 0.0)
        raise narrow.error(fits) from None


def _path(one: Pass, radius: float, options: PathOptions) -> ContactPath:
    """The path; raises ``TooNarrow`` where it is too narrow for the ball."""
    vertices = one.vertices if one.side > 0 else one.vertices * MIRROR  # features that rise: upside down
    start, end = one.side * one.start, one.side * one.end
    region = _region(one)
    box = np.stack([one.region.min(axis=0), one.region.max(axis=0)])[:, :2]
    face = Face(TriangleMesh(vertices, one.faces), radius, box)
    levels = _levels(face, region, start, end, radius, options)
    centre = np.asarray(Polygon(one.region[:, :2]).centroid.coords[0])

    def sliced(heights: FloatArray) -> list[list[Loop]]:
        mesh = face.mesh
        found = closed_lines(cut(mesh.vertices, mesh.faces, face.smooth, heights), region, one.name)
        groups: list[list[Loop]] = [[] for _ in heights]
        for loop in found:
            groups[loop.level].append(loop)
        return groups

    creases = Creases(face)
    wider = Face(face.mesh, radius + options.spare, box) if options.spare > 0.0 else None
    groups = lowest_reached(
        sliced(levels), levels, sliced, face, creases, options.chord, wider, options.missed
    )
    loops, ways = in_order([group for group in groups if group], options, centre)
    if not loops:
        what = f"{one.name}: no closed level line of the face lies in the feature's outline between z = "
        what += f"{1e3 * one.start:.3f} and {1e3 * one.end:.3f} mm; check that levels and outline belong to "
        what += "the face"
        raise refusal("forming.no_contour", what)
    helical = options.kind == "helical"
    curve = spiral_curve(loops, ways, options.seams) if helical else loop_curve(loops, ways)
    return _contact_path(targets(curve, face, creases, options, one.name), curve, face, options, one.side)


def _levels(
    face: Face, region: Polygon | None, start: float, end: float, radius: float, options: PathOptions
) -> FloatArray:
    if options.scallop is not None:
        width = scallop_width(radius, options.scallop)
        mesh = face.mesh
        levels = scallop_levels(mesh.vertices, mesh.faces, face.smooth, region, start, end, width)
    else:
        levels = constant_levels(start, end, options.stepdown or start - end)
    levels = np.append(start, levels)  # the first turn is flat, at the flat around the feature
    # levels of the flat have no lines of their own
    return np.asarray(np.clip(levels, end + FLAT_MARGIN, start - FLAT_MARGIN))


def _region(one: Pass) -> Polygon:
    """The outline of the feature and a little more, as the first lines run along it."""
    wide = float(np.ptp(one.region, axis=0).max())
    return Polygon(one.region[:, :2]).buffer(0.0).buffer(2e-4 + 1e-3 * wide)


def _contact_path(found: Targets, curve: Curve, face: Face, options: PathOptions, side: int) -> ContactPath:
    """The targets with what lies between pieces, turned back to the side that forms."""
    point, normal, centre, loop = found.point, found.normal, found.centre, found.loop
    working = np.ones(len(point), dtype=np.bool_)
    working[0] = False
    breaks = np.flatnonzero(np.diff(found.piece)) + 1
    high = float(face.mesh.vertices[:, 2].max()) + face.radius + options.lift
    at, between, labels = [], [], []
    for row in breaks:
        one, two = centre[row - 1], centre[row]
        if curve.ways[found.piece[row - 1]] == "step":
            over = [np.array([two[0], two[1], max(one[2], two[2])])]
        else:
            over = [np.array([one[0], one[1], high]), np.array([two[0], two[1], high])]
            working[row] = False
        at += [row] * len(over)
        between += over
        labels += [loop[row]] * len(over)
    if at:
        air = np.array(between)
        near, on, weights = face.nearest(air)
        centre, point = np.insert(centre, at, air, axis=0), np.insert(point, at, near, axis=0)
        normal = np.insert(normal, at, face.normal_at(on, weights), axis=0)
        loop = np.insert(loop, at, labels)
        working = np.insert(working, at, False)
    back = np.array([1.0, 1.0, float(side)])
    return ContactPath(
        point=point * back,
        normal=normal * np.array([side, side, 1.0]),
        centre=centre * back,
        angle=np.arccos(np.clip(normal[:, 2], -1.0, 1.0)),
        loop=loop,
        working=working,
    )


def _check(one: Pass, radius: float, options: PathOptions) -> None:
    depth = one.side * (one.start - one.end)
    wrong = []
    step = options.stepdown if options.stepdown is not None else options.scallop
    if (options.stepdown is None) == (options.scallop is None):
        wrong.append("state stepdown or scallop, one of both")
    elif step is None or not step > 0.0 or not np.isfinite(step):
        wrong.append("stepdown and scallop must be above 0")
    elif options.stepdown is not None and depth / options.stepdown > MOST_LEVEL_LINES:
        wrong.append(
            f"stepdown {1e3 * options.stepdown:.4g} mm makes {depth / options.stepdown:.0f} levels, up to "
            f"{MOST_LEVEL_LINES} are planned; take a stepdown of "
            f"{1e3 * depth / MOST_LEVEL_LINES + 1e-5:.5f} mm at "
            "least"
        )
    elif options.scallop is not None and not options.scallop < radius:
        wrong.append(f"scallop {1e3 * options.scallop:.4g} mm must be below the ball's radius")
    wrong += [
        f"{name} is {getattr(options, name):.4g}, it must be above 0"
        for name in ("tangent_angle", "chord", "cut", "longest", "lift", "missed")
        if not getattr(options, name) > 0.0
    ]
    if not radius > 0.0:
        wrong.append(f"the ball's radius is {1e3 * radius:.4g} mm, it must be above 0")
    if not depth > 2.0 * FLAT_MARGIN:
        wrong.append(
            f"the face goes from z = {1e3 * one.start:.4g} to {1e3 * one.end:.4g} mm, its end must lie "
            f"{'below' if one.side > 0 else 'above'} its start"
        )
    if wrong:
        raise TandemError([Issue("forming.path_options", f"{one.name}: {what}") for what in wrong])
