"""What the slot beside one surface takes from another one that the section across the wire does not show:
strips, and surfaces whose wires run another way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.rulings import resample
from planner.geometry.vectors import dots
from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_lines import Lines, chord, grown
from planner.hotwire.straight_operation import Straight
from planner.hotwire.straight_section import alike
from planner.issues import Issue
from planner.problem import Ruled
from planner.units import MM

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

GRAZE: Final = 0.3
"""Share of the tolerance that a slot may take from another surface."""
COARSE: Final = 4e-3
"""[m] size of the cells in which near places of a surface are looked for."""
FINE: Final = 5e-4
"""[m] size of the cells there."""
EVEN: Final = 1e-4
"""[m] cells at whose corners and middle distances differ by less are looked at there alone."""
CHORD: Final = 2e-5
"""[m] surfaces are looked at as near as this."""
BATCH: Final = 2_000
"""So many cells are looked at more closely together."""
BENEATH: Final = 0.7
"""Least cosine of the way to the wire against the normal of a surface that the wire is beneath or above."""
FACING: Final = -0.5
"""Surfaces face one another over a gap where the cosine of their normals is below this."""
CROSSES: Final = 1e-5
"""[m] a surface crosses another where it is on both sides of it by more than this."""
MEETS: Final = 1e-7
"""[m] of rounding, where surfaces meet."""
SOME: Final = 700
"""So many places tell whether one does."""
_CHUNK: Final = 300_000


def check_neighbours(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """``straight.crossing`` where the slot of a cut takes from another surface of the part, cut before it or
    after it. Surfaces that cross bound the part together: what is outside of one is no part."""
    own, lines, half = cut.wanted.ruled, cut.on.lines, cut.on.half
    reach, allowed = float(half.max()) + CROSSES, GRAZE * op.shape_tol_mm * MM
    for other in ruled:
        if other.name == own.name or (own.closed and other.closed and alike(own, other)):
            continue
        cells = _near(_cells(other), lines, half, box, reach + COARSE)
        uneven = _uneven(cells, lines, half)
        coarse = cells[uneven]
        finer = [
            _near(_finer(coarse[k : k + BATCH]), lines, half, box, reach)
            for k in range(0, len(coarse), BATCH)
        ]
        cells = np.concatenate([cells[~uneven], *finer])
        if not len(cells):
            continue
        places, normal = cells.mean(axis=1), _normals(cells)
        far, foot, wide = _nearest(places, lines, half)
        along = dots(foot - places, normal)
        # a slot from the foam beyond its own surface takes all it passes, one from within what it reaches
        beyond = (along <= -BENEATH * far) & (far < wide + CROSSES)
        beyond[beyond] = _side(own, places[beyond])[0] > -MEETS
        depth = wide - np.where(beyond, along, far)
        bad = np.flatnonzero(depth > allowed)
        bad = bad[_of_the_part(places[bad], other, ruled, box)]
        if len(bad):
            k = int(bad[np.argmax(depth[bad])])
            facing = float(_side(own, places[[k]])[1][0] @ normal[k]) < FACING
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
        value=depth,
        limit=GRAZE * op.shape_tol_mm,
        unit="mm",
    )


def _cells(ruled: Ruled) -> FloatArray:
    """A surface in patches (N, 4, 3) [m] with edges of no more than ``COARSE``."""
    fine = resample(ruled, CHORD, COARSE)
    a, b = (np.concatenate([p, p[:1]]) if ruled.closed else p for p in (fine.start, fine.end))
    count = max(int(np.ceil(np.linalg.norm(b - a, axis=1).max() / COARSE)), 1)
    share = np.linspace(0.0, 1.0, count + 1)[None, :, None]
    grid = a[:, None] + share * (b - a)[:, None]
    return np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)


def _finer(cells: FloatArray) -> FloatArray:
    """Each patch (N, 4, 3) in such of ``FINE``."""
    count = int(np.ceil(COARSE / FINE))
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
    return np.asarray(np.ptp(far, axis=0) > EVEN)


def _normals(cells: FloatArray) -> FloatArray:
    """Unit normals (N, 3) of patches, away from the part; 0 at tips."""
    way = cells[:, 1] + cells[:, 2] - cells[:, 0] - cells[:, 3]
    normal = np.cross(way, cells[:, 2] + cells[:, 3] - cells[:, 0] - cells[:, 1])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))


def _near(cells: FloatArray, lines: Lines, half: FloatArray, box: FloatArray, reach: float) -> FloatArray:
    """The patches in the box with wires within ``reach`` [m] of their middles."""
    middle = cells.mean(axis=1)
    first, last = chord(lines, grown(box, COARSE))
    meets = np.isfinite(first)
    if not meets.any():
        return cells[:0]
    ends = [lines[meets].at(length[meets]) for length in (first, last)]
    low, high = np.min(ends, axis=(0, 1)) - reach, np.max(ends, axis=(0, 1)) + reach
    good = ((middle > box[0]) & (middle < box[1]) & (middle > low) & (middle < high)).all(axis=1)
    rows = np.flatnonzero(good)
    count = int(np.ceil(np.linalg.norm(ends[1] - ends[0], axis=1).max() / COARSE)) + 1
    points = np.linspace(ends[0], ends[1], count, axis=1)
    step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(initial=0.0)
    gap = 0.5 * float(np.hypot(COARSE, step))
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
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) * len(lines) // _CHUNK)):
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
    fine = resample(ruled, CHORD, 0.05)
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
    points = np.random.default_rng(0).permutation(points)[:SOME]  # every so many would be of one row of cells
    for other in ruled:
        if other.name != own.name:
            off = _side(other, points)[0]
            if (off > CROSSES).any() and (off < -CROSSES).any():
                real &= ~(_side(other, places)[0] > -MEETS)
    return real
