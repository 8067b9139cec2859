"""What a straight cut must leave alone: other surfaces, other pieces, and the part at ways in and out.

The claims of a job say how each surface comes out, not what a way in takes from another one, so
that is looked at here, on the planned wires. `check_neighbours` looks at what the slot beside one
surface takes from others that the section across the wire does not show: strips, and surfaces whose
wires run another way.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, Ruled, dots
from planner.geometry.rulings import resample, tessellate
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.hotwire.plan.operation import Straight, SurfaceCut
from planner.processes.hotwire.plan.straight.cut import Cut
from planner.processes.hotwire.plan.straight.order import (
    Lines,
    Piece,
    alike,
    chord,
    contour,
    grown,
    join,
    pieces_across,
    place_text,
    section,
)

GRAZE_SHARE: Final = 0.3
"""Share of the tolerance that a slot may take from another surface or piece, and a way in from its own."""
CELL: Final = 4e-3
"""[m] size of the cells in which near places of a surface are looked for."""
FINE_CELL: Final = 5e-4
"""[m] size of the cells there."""
EVEN_GAP: Final = 1e-4
"""[m] cells at whose corners and middle distances differ by less are looked at there alone."""
SURFACE_CHORD: Final = 2e-5
"""[m] surfaces are looked at as near as this."""
CELLS_AT_ONCE: Final = 2_000
"""So many cells are looked at more closely together."""
BENEATH_COSINE: Final = 0.7
"""Least cosine of the way to the wire against the normal of a surface that the wire is beneath or above."""
FACING_COSINE: Final = -0.5
"""Surfaces face one another over a gap where the cosine of their normals is below this."""
CROSSING_DISTANCE: Final = 1e-5
"""[m] a surface crosses another where it is on both sides of it by more than this."""
MEETING_DISTANCE: Final = 1e-7
"""[m] of rounding, where surfaces meet."""
CROSSING_PLACES: Final = 700
"""So many places tell whether one does."""
_PAIRS_AT_ONCE: Final = 300_000
"""Pairs of a point and a ruling that are worked on at once."""


def check_neighbours(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """``straight.crossing`` where the slot of a cut takes from another surface of the part, cut before it or
    after it. Surfaces that cross bound the part together: what is outside of one is no part."""
    own, lines, half = cut.wanted.ruled, cut.on.lines, cut.on.half
    reach, allowed = float(half.max()) + CROSSING_DISTANCE, GRAZE_SHARE * op.shape_tol_mm * MM
    for other in ruled:
        if other.name == own.name or (own.closed and other.closed and alike(own, other)):
            continue
        cells = _near(_cells(other), lines, half, box, reach + CELL)
        uneven = _uneven(cells, lines, half)
        coarse = cells[uneven]
        finer = [
            _near(_finer(coarse[k : k + CELLS_AT_ONCE]), lines, half, box, reach)
            for k in range(0, len(coarse), CELLS_AT_ONCE)
        ]
        cells = np.concatenate([cells[~uneven], *finer])
        if not len(cells):
            continue
        places, normal = cells.mean(axis=1), _normals(cells)
        far, foot, wide = _nearest(places, lines, half)
        along = dots(foot - places, normal)
        # a slot from the foam beyond its own surface takes all it passes, one from within what it reaches
        beyond = (along <= -BENEATH_COSINE * far) & (far < wide + CROSSING_DISTANCE)
        beyond[beyond] = _side(own, places[beyond])[0] > -MEETING_DISTANCE
        depth = wide - np.where(beyond, along, far)
        bad = np.flatnonzero(depth > allowed)
        bad = bad[_of_the_part(places[bad], other, ruled, box)]
        if len(bad):
            k = int(bad[np.argmax(depth[bad])])
            facing = float(_side(own, places[[k]])[1][0] @ normal[k]) < FACING_COSINE
            yield _issue(op, cut, other, (depth[k], wide[k]), places[k], facing)
            return


def _issue(
    op: Straight, cut: Cut, other: Ruled, figures: tuple[float, float], place: FloatArray, facing: bool
) -> Issue:
    depth, slot = figures[0] / MM, 2.0 * figures[1] / MM
    where = "[" + ", ".join(f"{value / MM:.1f}" for value in place) + "] mm"
    what = (
        f"they are {slot - depth:.2f} mm apart there and the slot needs {slot:.2f} mm; move them apart by "
        f"{depth:.2f} mm or take a thinner slot"
        if facing
        else f"the slot is {slot:.2f} mm wide; make both one surface with a corner, or move them apart"
    )
    return Issue(
        "straight.crossing",
        f"{op.name}: the slot of {cut.wanted.segment} takes {depth:.2f} mm off {other.name} at {where}: "
        f"{what}",
        field=str(cut.wanted.segment),
        **measurement(depth, GRAZE_SHARE * op.shape_tol_mm, "mm"),
    )


def _cells(ruled: Ruled) -> FloatArray:
    """A surface in patches (N, 4, 3) [m] with edges of no more than ``CELL``."""
    fine = resample(ruled, SURFACE_CHORD, CELL)
    a, b = (np.concatenate([p, p[:1]]) if ruled.closed else p for p in (fine.start, fine.end))
    count = max(int(np.ceil(np.linalg.norm(b - a, axis=1).max() / CELL)), 1)
    share = np.linspace(0.0, 1.0, count + 1)[None, :, None]
    grid = a[:, None] + share * (b - a)[:, None]
    return np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)


def _finer(cells: FloatArray) -> FloatArray:
    """Each patch (N, 4, 3) in such of ``FINE_CELL``."""
    count = int(np.ceil(CELL / FINE_CELL))
    u, v = np.meshgrid(np.arange(count) / count, np.arange(count) / count)
    corners = []
    for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
        x, y = (u + du / count).ravel()[:, None], (v + dv / count).ravel()[:, None]
        a, b, c, d = (cells[:, None, k] for k in range(4))
        corners.append((1 - x) * (1 - y) * a + x * (1 - y) * b + x * y * c + (1 - x) * y * d)
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def _uneven(cells: FloatArray, lines: Lines, half: FloatArray) -> BoolArray:
    """Patches (N,) to and from whose corners the distance to the wires is not much the same."""
    far = np.stack(
        [_nearest(cells[:, k], lines, half)[0] for k in range(4)]
        + [_nearest(cells.mean(axis=1), lines, half)[0]]
    )
    return np.asarray(np.ptp(far, axis=0) > EVEN_GAP)


def _normals(cells: FloatArray) -> FloatArray:
    """Unit normals (N, 3) of patches, away from the part; 0 at tips."""
    way = cells[:, 1] + cells[:, 2] - cells[:, 0] - cells[:, 3]
    normal = np.cross(way, cells[:, 2] + cells[:, 3] - cells[:, 0] - cells[:, 1])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))


def _near(cells: FloatArray, lines: Lines, half: FloatArray, box: FloatArray, reach: float) -> FloatArray:
    """The patches in the box with wires within ``reach`` [m] of their middles."""
    middle = cells.mean(axis=1)
    first, last = chord(lines, grown(box, CELL))
    meets = np.isfinite(first)
    if not meets.any():
        return cells[:0]
    ends = [lines[meets].at(length[meets]) for length in (first, last)]
    low, high = np.min(ends, axis=(0, 1)) - reach, np.max(ends, axis=(0, 1)) + reach
    good = ((middle > box[0]) & (middle < box[1]) & (middle > low) & (middle < high)).all(axis=1)
    rows = np.flatnonzero(good)
    count = int(np.ceil(np.linalg.norm(ends[1] - ends[0], axis=1).max() / CELL)) + 1
    points = np.linspace(ends[0], ends[1], count, axis=1)
    step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(initial=0.0)
    gap = 0.5 * float(np.hypot(CELL, step))
    tree = cKDTree(points.reshape(-1, 3))
    rows = rows[np.isfinite(tree.query(middle[rows], distance_upper_bound=reach + gap)[0])]
    if len(rows):
        rows = rows[_nearest(middle[rows], lines, half)[0] < reach]
    return cells[rows]


def _nearest(points: FloatArray, lines: Lines, half: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each of points (N, 3): the distance (N,) [m] to the wires and the straight ways between them, the
    nearest place (N, 3) there, half the slot (N,) [m]."""
    return _abreast(points, lines, half, False)[:3]


def _abreast(
    points: FloatArray, lines: Lines, half: FloatArray, ends: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """As :func:`_nearest`, and the place (N,) among the lines; NaN with ``ends``, for points beyond these."""
    way, length = lines.direction, np.linalg.norm(lines.end - lines.start, axis=1)
    base = dots(lines.start, way)
    far, wide, place = np.zeros(len(points)), np.zeros(len(points)), np.zeros(len(points))
    foot = np.zeros((len(points), 3))
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) * len(lines) // _PAIRS_AT_ONCE)):
        along = points[rows] @ way.T - base
        at = lines.start + along[..., None] * way
        move = np.diff(at, axis=1)
        gap = points[rows, None] - at[:, :-1]
        share = np.clip(dots(gap, move) / np.maximum(dots(move, move), 1e-30), 0.0, 1.0)
        gap = gap - share[..., None] * move
        off = np.sqrt(dots(gap, gap))
        n, k = np.arange(len(rows)), np.argmin(off, axis=1)
        part = share[n, k]
        far[rows], foot[rows], place[rows] = off[n, k], points[rows] - gap[n, k], k + part
        level = (1.0 - part) * along[n, k] / length[k] + part * along[n, k + 1] / length[k + 1]
        level_in = np.clip(level, 0.0, 1.0)
        one, two = ((1.0 - level_in) * half[k + i, 0] + level_in * half[k + i, 1] for i in (0, 1))
        wide[rows] = (1.0 - part) * one + part * two
        if ends:
            place[rows] = np.where((level < 0.0) | (level > 1.0), np.nan, place[rows])
    return far, foot, wide, place


def _side(ruled: Ruled, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (N,) [m] of points (N, 3) to a surface, negative on the part's side, NaN beyond its rims; and
    its normals (N, 3) there."""
    fine = resample(ruled, SURFACE_CHORD, 0.05)
    start, end = (np.concatenate([p, p[:1]]) if ruled.closed else p for p in (fine.start, fine.end))
    lines = Lines(start, end)
    far, foot, _, place = _abreast(points, lines, np.zeros((len(start), 2)), True)
    normal = _normals(np.stack([start[:-1], start[1:], end[1:], end[:-1]], axis=1))
    last = len(normal) - 1
    known = np.isfinite(place)
    if not ruled.closed:
        known &= (place > 0.0) & (place < last + 1)
    at = np.where(np.isfinite(place), place, 0.0)
    low, high = np.ceil(at).astype(np.intp) - 1, np.floor(at).astype(np.intp)
    ring = (low % (last + 1), high % (last + 1)) if ruled.closed else (low.clip(0, last), high.clip(0, last))
    mean = normal[ring[0]] + normal[ring[1]]
    outside = dots(points - foot, mean) >= 0.0
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-30)
    return np.where(known, np.where(outside, far, -far), np.nan), mean


def _of_the_part(places: FloatArray, own: Ruled, ruled: tuple[Ruled, ...], box: FloatArray) -> BoolArray:
    """Which places (N, 3) of a surface bound the part: those not outside of another that it crosses in the
    box."""
    real = np.ones(len(places), dtype=np.bool_)
    if not len(places):
        return real
    points = np.concatenate([_cells(own).mean(axis=1), places])
    points = points[((points > box[0]) & (points < box[1])).all(axis=1)]
    points = np.random.default_rng(0).permutation(points)[
        :CROSSING_PLACES
    ]  # every so many would be of one row of cells
    for other in ruled:
        if other.name != own.name:
            off = _side(other, points)[0]
            if (off > CROSSING_DISTANCE).any() and (off < -CROSSING_DISTANCE).any():
                real &= ~(_side(other, places)[0] > -MEETING_DISTANCE)
    return real


def _going_on(ruled: Ruled, box: FloatArray) -> Ruled:
    """A strip that goes straight on from both of its ends till it is out of the block (2, 3)."""
    if ruled.closed:
        return ruled
    far = float(np.linalg.norm(np.ptp(box, axis=0)))
    ends = np.stack([ruled.start, ruled.end])
    way = (ends[:, [0, -1]] - ends[:, [1, -2]]).sum(axis=0)
    on = ends[:, [0, -1]] + far * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-30)
    ends = np.concatenate([on[:, :1], ends, on[:, 1:]], axis=1)
    corner = np.concatenate([[True], ruled.corner, [True]])
    return dataclasses.replace(ruled, start=ends[0], end=ends[1], corner=corner)


LENGTH_SHARES: Final = (0.02, 0.5, 0.98)
"""Shares of the common length of all rulings at which slots are held against other pieces."""
STEEP_WAY: Final = 6.0
"""Half slots of way beside another contour that a slit may take wherever it crosses it: at 20 degrees or
more."""
LEAD_SHARES: Final = np.linspace(0.01, 0.99, 9)
"""Shares of the wire in the foam at which its way in and out is followed."""
LEAD_CHORD: Final = 2e-4
"""[m] surfaces that ways in and out might pass are as near as this."""


def check_spared(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """Issues of one cut: ``straight.crossing`` and ``straight.lead`` where it takes from other surfaces of
    the part, or from its own on the way in or out."""
    found: list[Issue] = []
    if cut.wanted.ruled.closed:
        found += [*_beside(op, cut, ruled, box), *_along(op, cut, ruled, box)]
    elif isinstance(cut.wanted.cut, SurfaceCut):
        found += [*_own_side(op, cut), *_through(op, cut, ruled, box)]
    yield from found or check_neighbours(op, cut, ruled, box)


def _beside(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """No slot of a closed cut reaches another closed surface that is cut in the same direction."""
    allowed = GRAZE_SHARE * op.shape_tol_mm * MM
    for level in LENGTH_SHARES:
        pieces = pieces_across(cut.wanted.ruled, ruled, box, level)
        if not pieces.others:
            continue
        ways = (
            ("straight.crossing", cut.on.lines, cut.on.half),
            ("straight.lead", cut.into, cut.on.half[:1]),
            ("straight.lead", cut.out, cut.on.half[-1:]),
        )
        for code, lines, half in ways:
            if code == "straight.lead" and (cut.wanted.ruled.hole or pieces.enclosed):
                continue  # its slit is told
            others = [p for p in pieces.others if code == "straight.crossing" or not p.around]
            found = _taken(section(lines, pieces.plane), half.max(axis=1), others, allowed)
            if found is None:
                continue
            depth, place, other = found
            point = pieces.plane.point(place)
            what = "the slot" if code == "straight.crossing" else "the way in or out"
            yield Issue(
                code,
                f"{op.name}: {what} of {cut.wanted.segment} takes {depth / MM:.2f} mm off {other.name} at "
                f"{place_text(point)}; move the pieces apart, take a thinner slot"
                + ("" if code == "straight.crossing" else " or give another lead"),
                field=str(cut.wanted.segment),
                **measurement(depth / MM, allowed / MM, "mm"),
            )
            return


def _along(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """A slit through the part crosses other contours steeply, and runs beside none of them."""
    if cut.start is None or cut.start.through < 1e-4:
        return
    pieces = pieces_across(cut.wanted.ruled, ruled, box, 0.5)
    half = float(cut.on.half[[0, -1]].max())
    allowed = GRAZE_SHARE * op.shape_tol_mm * MM
    for lines in (cut.into, cut.out):
        way = shapely.LineString(section(lines, pieces.plane)[[0, -1]])
        for other in ruled:
            if not other.closed or other.name == cut.wanted.ruled.name:
                continue
            border = shapely.boundary(contour(other, pieces.plane))
            beside = way.intersection(shapely.buffer(border, half)).length
            crossed = shapely.get_num_geometries(way.intersection(border)) if way.intersects(border) else 0
            if beside > STEEP_WAY * half * crossed + allowed:
                yield Issue(
                    "straight.lead",
                    f"{op.name}: the slit to {cut.wanted.segment} runs along {other.name} for "
                    f"{beside / MM:.1f} mm and takes from it; give another lead",
                    field=str(cut.wanted.segment),
                    **measurement(beside / MM, STEEP_WAY * half * crossed / MM, "mm"),
                )
                return


def _taken(
    way: FloatArray, half: FloatArray, others: list[Piece], allowed: float
) -> tuple[float, FloatArray, Piece] | None:
    """How deep [m] the slot about a way (N, 2) reaches into the pieces at most, where and which; None where
    it takes no more than ``allowed``."""
    if len(way) < 2 or not others:
        return None
    moves = shapely.linestrings(np.stack([way[:-1], way[1:]], axis=1))
    half = np.broadcast_to(half, (len(way),))
    wide = np.maximum(half[:-1], half[1:])
    tree = shapely.STRtree([piece.shape for piece in others])
    move, piece = tree.query(moves, predicate="dwithin", distance=np.maximum(wide - allowed, 0.0))
    if not len(move):
        return None
    depth = wide[move] - shapely.distance(moves[move], tree.geometries[piece])
    k = int(np.argmax(depth))
    return float(depth[k]), way[move[k]], others[int(piece[k])]


def _own_side(op: Straight, cut: Cut) -> Iterator[Issue]:
    """A lead that is given for a strip comes from outside the part, or straight on."""
    foot, into = cut.on.row.foot, cut.into
    if len(into) < 2:
        return
    way = into.start[0] + into.end[0] - into.start[-1] - into.end[-1]
    normal = cut.on.row.normal[0].mean(axis=0)
    depth = -0.5 * float(way @ normal) / max(float(np.linalg.norm(normal)), 1e-12)
    if depth <= GRAZE_SHARE * op.shape_tol_mm * MM:
        return
    # a strip that bends away beyond its end may be followed straight on
    ahead = foot.start[0] + foot.end[0] - foot.start[1] - foot.end[1]
    if isinstance(cut.wanted.cut, SurfaceCut) and cut.wanted.cut.lead == "auto" and way @ ahead > 0.0:
        return
    what = f"{op.name}: the lead of {cut.wanted.segment} comes through the part, {depth / MM:.1f} mm below "
    what += f"its surface, to {place_text(foot.start[0])}; give a lead on the outer side, or auto"
    yield Issue("straight.lead", what, field=str(cut.wanted.segment), **measurement(depth / MM, 0.0, "mm"))


def _through(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """The ways in and out of a strip do not enter the part through another surface that the strip itself does
    not cross. (Surfaces that cross bound the part together: what is beyond one is no part, nor what is beyond
    a strip that would go straight on, as that way does.)"""
    on = cut.on.lines
    bounds = tuple(_going_on(one, box) for one in ruled)
    near = 4.0 * float(cut.on.half.max())
    for other in ruled:
        if other.name == cut.wanted.ruled.name:
            continue
        mesh = tessellate(resample(other, LEAD_CHORD, 0.05), LEAD_CHORD)
        triangles = mesh.vertices[mesh.faces]
        inner = _between(on, near)
        few = inner[:: max(1, len(inner) // 40)]
        if len(inner) > 1 and any(map(len, _passed(few, triangles, box, both=True))):
            continue
        out = cut.out[: cut.turns] if cut.turns else cut.out
        for lines, word in ((cut.into.reversed(), "in"), (out, "out")):
            # from the wire before, since the last one may stand exactly in the other surface
            ends = join([on[[1 if word == "in" else -2]], lines[[-1]]])
            places = np.concatenate(list(_passed(ends, triangles, box, both=False)))
            places = places[_of_the_part(places, other, bounds, box)]
            if len(places):
                what = f"{op.name}: the way {word} of {cut.wanted.segment} goes straight on through the "
                what += f"part, into which it comes through {other.name} at {place_text(places[0])}; make "
                what += "both one surface with a corner, or move them apart"
                yield Issue("straight.lead", what, field=str(cut.wanted.segment))
                return


def _between(lines: Lines, near: float) -> Lines:
    """The lines that are farther than ``near`` [m] from the first and the last one."""
    middle = 0.5 * (lines.start + lines.end)
    far = [np.linalg.norm(middle - middle[k], axis=1) > near for k in (0, -1)]
    return lines[far[0] & far[1]]


def _passed(lines: Lines, triangles: FloatArray, box: FloatArray, both: bool) -> Iterator[FloatArray]:
    """For each point of the wire in the foam, from line to line, the places (K, 3) where it passes triangles
    (T, 3, 3) from outside to inside, or either way (Moller and Trumbore's test)."""
    # wires outside the block are followed between their guide points
    length = np.linalg.norm(lines.end - lines.start, axis=1)
    first, last = chord(lines, box)
    first, last = np.nan_to_num(first), np.where(np.isfinite(last), last, length)
    along = first[:, None] + (last - first)[:, None] * LEAD_SHARES
    base = lines.start[:, None] + lines.direction[:, None] * along[..., None]
    origin, way = base[:-1].reshape(-1, 3), np.diff(base, axis=0).reshape(-1, 3)
    a, one, two = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    for start, move in zip(origin, way, strict=True):
        cross = np.cross(move, two)
        det = np.sum(one * cross, axis=1)
        size = np.where(np.abs(det) > 1e-18, det, np.inf)
        off = start - a
        u = np.sum(off * cross, axis=1) / size
        turned = np.cross(off, one)
        v = turned @ move / size
        t = np.sum(two * turned, axis=1) / size
        hit = (u > 0.0) & (v > 0.0) & (u + v < 1.0) & (t > 0.0) & (t < 1.0)
        if not both:
            hit &= np.cross(one, two) @ move < 0.0
        yield start + t[hit, None] * move
