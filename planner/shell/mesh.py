"""Triangles of a formed sheet by rings: contours from the top edge to the floor's edge, kinks on mesh lines.

Walls become bands between rows along the contours, so that no triangle lies across the top edge, the floor's
edge, a kink of the profile or a corner: a triangle across a kink makes the sheet too stiff by percents
however small it is. Floor and flange are flat and filled with rows at growing distances from their rims."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np
import shapely
from scipy.spatial import Delaunay, cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths

FLANGE, WALL, FLOOR = 0, 1, 2
"""Where a triangle lies."""
PLACES_AROUND = 1024
"""Places at which contours are matched to one another."""
EVEN = 0.7
"""Share of a contour's own length in where its places are."""
CORNER = np.radians(25.0)
"""Turn of a contour [rad] from which it has a corner, along which a mesh line goes down the wall."""
CORNER_WINDOW = 5e-4
"""Length of a contour [m], to both sides, over which turns are added up: one that is noisy has no corners."""
KINK = np.radians(8.0)
"""Turn of the profile at a contour [rad] from which this is a mesh line."""
GROWTH = 0.3
"""How much larger elements of the flange become by metre of distance from the top edge."""
COARSEST = 5.0
"""Elements of the flange over those of the wall at most."""
LEVEL = 1e-6
"""By how much heights of the first and the last contour may differ [m]."""
OFF_RING = 5e-4
"""How far from a contour a point of a wall may be to become a node of it [m]."""
LEAST_STEP = 1e-3
"""Distance down the wall [m] from which contours between kinks are worked with."""
_ROW = 0.866
"""Distance of rows of a flat region, in sizes of elements: that of equal-sided triangles."""
_MOST_ROWS = 1000
_SLIVER = 1e-4
"""Area of a triangle over the square of a side, below which it lies along a straight rim and is none."""
_APART = 0.62
"""Distance between points of a flat region at least, in sizes of elements."""
_ROUNDS = 10
"""Sizes that are tried for a wanted number of triangles."""
_ENOUGH = 0.95
"""Share of the triangles allowed with which a mesh is taken at once."""
_SMALLER = 0.85
"""By how much elements become smaller that did not fit."""


@dataclasses.dataclass(frozen=True)
class SheetMesh:
    """``nodes`` (n, 3) [m], ``triangles`` (m, 3), counterclockwise from above; ``zone`` (m,) of each
    triangle: FLANGE, WALL or FLOOR."""

    nodes: FloatArray
    triangles: IntArray
    zone: IntArray


def mesh_sheet(
    rings: Sequence[FloatArray], window: FloatArray, triangles: int, places: FloatArray | None = None
) -> SheetMesh:
    """A sheet clamped along a rectangle, formed to ``rings``, of at most ``triangles`` triangles.

    ``rings``: closed contours (k, 3) [m] (first point not repeated) from the top edge inwards, each inside of
    the one before as seen from above; the first and the last are level, the flange lies around the first and
    a floor in the last. None: a flat sheet at z = 0. ``window`` (2, 2) [m]: least and largest x and y of the
    clamp. ``places`` (p, 2 or more) [m]: x, y of points that become nodes, on flange, floor or within
    `OFF_RING` of a ring. Raises ValueError where a ring crosses another or the window, is not level where it
    has to be, a place is elsewhere, or so few triangles do not do."""
    outlines = [_counterclockwise(ring) for ring in rings]
    _check(outlines, window)
    places = (
        np.empty((0, 2)) if places is None else np.asarray(places, dtype=np.float64).reshape(len(places), -1)
    )
    layout = _laid_out(outlines, window, places[:, :2])
    size = float(np.sqrt(np.prod(window[1] - window[0]) / triangles))
    best: SheetMesh | None = None
    why = "none could be made"
    for _ in range(_ROUNDS):
        try:
            made = _meshed(layout, size)
        except _UnfilledError as unfilled:
            why = str(unfilled)
            size *= _SMALLER
            continue
        count = len(made.triangles)
        if count <= triangles and (best is None or count > len(best.triangles)):
            best = made
        if best is made and count > _ENOUGH * triangles:
            break
        why = f"allow about {count}"
        size *= float(np.sqrt(2.0 * count / ((1.0 + _ENOUGH) * triangles)))
    if best is None:
        raise ValueError(f"got {triangles} triangles for {len(rings)} rings: {why}")
    return best


class _UnfilledError(ValueError):
    """Elements of a size do not fit."""


def cone_rings(top_radius: float, wall_angle: float, depth: float, sides: int = 360) -> list[FloatArray]:
    """Top and floor edge (sides, 3) of a cone about z, ``wall_angle`` [rad] from level, ``depth`` [m]
    down."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    level = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
    low = top_radius - depth / np.tan(wall_angle)
    if low <= 0.0:
        raise ValueError(f"depth: got {depth:g} m; this cone has its tip above")
    return [top_radius * level, low * level - [0.0, 0.0, depth]]


def border_edges(triangles: IntArray) -> IntArray:
    """Edges (b, 2) that one triangle alone has."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[count == 1]])


def _counterclockwise(ring: FloatArray) -> FloatArray:
    ring = np.asarray(ring, dtype=np.float64)
    return ring if _area(ring) > 0.0 else ring[::-1]


def _area(ring: FloatArray) -> float:
    """Area [m^2] of a contour from above, positive counterclockwise."""
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float(np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))


def _check(outlines: list[FloatArray], window: FloatArray) -> None:
    box = shapely.box(*window[0], *window[1])
    outer = box
    for index, ring in enumerate(outlines):
        inner = shapely.Polygon(ring[:, :2])
        if (
            not inner.is_valid
            or not outer.buffer(1e-9).contains(inner)
            or (outer is box and box.touches(inner))
        ):
            raise ValueError(
                f"ring {index}: crosses itself, or is not inside of the one before or the window"
            )
        outer = inner
    for name, level in (("first", outlines[:1]), ("last", outlines[-1:])):
        if level and np.ptp(level[0][:, 2]) > LEVEL:
            off = np.ptp(level[0][:, 2])
            raise ValueError(f"{name} ring: heights differ by {off:.2g} m; allowed {LEVEL:g}")


def _matched(outlines: list[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Contours (r, PLACES_AROUND, 3) whose places face one another, and the places of corners.

    Each place is nearest to that of the contour before, up to the share `EVEN`, which an arc needs that grows
    out of a point; a corner is at a place, at that of a corner which the contour before has near it.
    """
    out: list[FloatArray] = []
    share = np.arange(PLACES_AROUND) / PLACES_AROUND
    lines = np.empty(0, dtype=np.int64)
    found: FloatArray = PLACES_AROUND * share
    near = 0.0
    for index, ring in enumerate(outlines):
        if out:
            ring = np.roll(ring, -int(np.argmin(lengths(ring[:, :2] - out[-1][0, :2]))), axis=0)
        whole = _along(ring)
        along = whole / whole[-1]
        if out:
            nearest = cKDTree(out[-1][:, :2]).query(_at(ring, along, share)[:, :2])[1]
            found = np.asarray(nearest, dtype=np.float64)
            # places grow around the ring; the first may lie a little before 0
            step = np.diff(found, prepend=found[0])
            turns = np.cumsum(np.round(step / PLACES_AROUND)) + np.round(found[0] / PLACES_AROUND)
            found = np.asarray(found - PLACES_AROUND * turns)
            near = 4.0 * _gap(outlines[index - 1], ring) / whole[-1] * PLACES_AROUND
        corner = along[:-1][_corners(ring)]
        even = PLACES_AROUND * share + float(np.mean(found - PLACES_AROUND * share))
        place = (1.0 - EVEN) * np.maximum.accumulate(found) + EVEN * even
        at = np.interp(corner, np.append(share, 1.0), np.append(place, place[0] + PLACES_AROUND))
        snapped, lines = _snapped(at, lines, max(near, 4.0))
        own = share
        if len(corner):
            shift = np.interp(share, corner, snapped - at, period=1.0)
            own, place = np.concatenate([share, corner]), np.concatenate([place + shift, snapped])
            order = np.argsort(own, kind="stable")
            own, place = own[order], np.maximum.accumulate(place[order])
        place = np.concatenate([place + PLACES_AROUND * turn for turn in (-1, 0, 1)])
        own = np.concatenate([own + turn for turn in (-1, 0, 1)])
        out.append(_at(ring, along, np.interp(PLACES_AROUND * share, place, own) % 1.0))
    return np.array(out), np.unique(lines)


def _gap(outer: FloatArray, inner: FloatArray) -> float:
    """Mean distance [m], seen from above, of two contours: the area between them over their mean length."""
    between = abs(_area(outer) - _area(inner))
    return 2.0 * between / float(_along(outer[:, :2])[-1] + _along(inner[:, :2])[-1])


def _corners(ring: FloatArray) -> IntArray:
    """Points of a contour at which it has a corner: the most turned of those within `CORNER_WINDOW`."""
    ahead = (np.roll(ring, -1, axis=0) - ring)[:, :2]
    before = np.roll(ahead, 1, axis=0)
    turn = np.arctan2(before[:, 0] * ahead[:, 1] - before[:, 1] * ahead[:, 0], dots(before, ahead))
    along = _along(ring)
    place = np.concatenate([along[:-1] - along[-1], along[:-1], along[:-1] + along[-1]])
    total = np.concatenate([[0.0], np.cumsum(np.tile(turn, 3))])
    low = np.searchsorted(place, along[:-1] - CORNER_WINDOW - 1e-12)
    high = np.searchsorted(place, along[:-1] + CORNER_WINDOW + 1e-12)
    within = np.abs(total[high] - total[low])
    found: list[int] = []
    for index in np.flatnonzero(within > CORNER)[np.argsort(-np.abs(turn[within > CORNER]), kind="stable")]:
        off = np.abs(along[found] - along[index])
        if not len(off) or np.minimum(off, along[-1] - off).min() > 2.0 * CORNER_WINDOW:
            found.append(int(index))
    return np.array(sorted(found), dtype=np.int64)


def _snapped(at: FloatArray, lines: IntArray, near: float) -> tuple[FloatArray, IntArray]:
    """Whole places (c,), near places ``at``, for corners, and all lines of corners with those that are
    new."""
    out = np.round(at)
    for index, place in enumerate(at):
        off = (lines - place + 0.5 * PLACES_AROUND) % PLACES_AROUND - 0.5 * PLACES_AROUND
        if len(off) and np.abs(off).min() < near:
            out[index] = place + off[np.argmin(np.abs(off))]
        else:
            lines = np.append(lines, int(out[index]) % PLACES_AROUND)
    return np.round(out), lines


def _along(ring: FloatArray) -> FloatArray:
    """Length (k + 1,) of a closed contour up to each point and back to the first."""
    return np.concatenate([[0.0], np.cumsum(lengths(np.roll(ring, -1, axis=0) - ring))])


def _at(ring: FloatArray, place: FloatArray, wanted: FloatArray) -> FloatArray:
    """Points (w, 3) of a closed contour at ``wanted``, where its own points are at ``place`` (k + 1,)."""
    closed = np.concatenate([ring, ring[:1]])
    return np.column_stack([np.interp(wanted, place, closed[:, axis]) for axis in range(3)])


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Where meshes of any size agree: matched contours ``around`` (r, PLACES_AROUND, 3), places of
    ``corners``, ``fixed``: by contour, places on it of points that become nodes, ``floor`` and ``flange`` (.,
    2): such points there; ``kept``: contours that are rows."""

    around: FloatArray
    corners: IntArray
    box: shapely.Polygon
    fixed: dict[int, list[float]]
    floor: FloatArray
    flange: FloatArray
    kept: list[int]


def _laid_out(outlines: list[FloatArray], window: FloatArray, places: FloatArray) -> _Layout:
    """Which contours are rows, and where the points lie that become nodes."""
    box = shapely.box(*window[0], *window[1])
    if not outlines:
        return _Layout(
            np.empty((0, PLACES_AROUND, 3)), np.empty(0, np.int64), box, {}, places, places[:0], []
        )
    gap = np.array([_gap(*pair) for pair in itertools.pairwise(outlines)])
    rise = np.diff([ring[:, 2].mean() for ring in outlines])
    slope = np.arctan2(rise, gap)
    kept = {0, *(np.flatnonzero(np.abs(np.diff(slope)) > KINK) + 1).tolist(), len(outlines) - 1}
    top, low = (shapely.Polygon(outlines[k][:, :2]) for k in (0, -1))
    on: dict[int, list[FloatArray]] = {}
    floor, flange = [], []
    for place in places:
        off = [_nearest(ring[:, :2], place)[0] for ring in outlines]
        ring = int(np.argmin(off))
        point = shapely.Point(place)
        if off[ring] <= OFF_RING:
            on.setdefault(ring, []).append(place)
            kept.add(ring)
        elif low.contains(point):
            floor.append(place)
        elif box.contains(point) and not top.contains(point):
            flange.append(place)
        else:
            raise ValueError(
                f"place ({place[0]:.4g}, {place[1]:.4g}) m: {off[ring]:.2g} m from the nearest contour,"
                f" beyond floor and flange; allowed {OFF_RING:g}: give a contour that goes through it"
            )
    # contours closer than elements are small would only be matched to one another
    reach = np.concatenate([[0.0], np.cumsum(np.hypot(gap, rise))])
    used: list[int] = []
    for index in range(len(outlines)):
        if index in kept or reach[index] - reach[used[-1]] >= LEAST_STEP:
            used.append(index)
    around, corners = _matched([outlines[index] for index in used])
    number = {index: place for place, index in enumerate(used)}
    fixed = {
        number[index]: [_nearest(around[number[index], :, :2], point)[1] for point in points]
        for index, points in on.items()
    }
    flat = [np.array(points).reshape(-1, 2) for points in (floor, flange)]
    rows = sorted(number[index] for index in kept)
    return _Layout(around, corners, box, fixed, flat[0], flat[1], rows)


def _nearest(ring: FloatArray, point: FloatArray) -> tuple[float, float]:
    """Distance [m] of a point to a contour (k, 2), and where along it, in its points."""
    ahead = np.roll(ring, -1, axis=0) - ring
    share = np.clip(dots(point - ring, ahead) / np.maximum(dots(ahead, ahead), 1e-30), 0.0, 1.0)
    off = lengths(ring + share[:, None] * ahead - point)
    index = int(np.argmin(off))
    return float(off[index]), float(index + share[index]) % len(ring)


def _rows(layout: _Layout, size: float) -> tuple[FloatArray, list[list[float]]]:
    """Rows (r, PLACES_AROUND, 3) down the wall, kept contours among them, and places of their fixed nodes."""
    around = layout.around
    if len(around) == 1:
        return around, [layout.fixed.get(0, [])]
    step = lengths(np.diff(around, axis=0)).mean(axis=1)
    reach = np.concatenate([[0.0], np.cumsum(step)])
    at, fixed = [reach[:1]], [layout.fixed.get(0, [])]
    for low, high in zip(layout.kept, layout.kept[1:], strict=False):
        count = max(1, round((reach[high] - reach[low]) / size))
        at.append(np.linspace(reach[low], reach[high], count + 1)[1:])
        fixed += [[]] * (count - 1) + [layout.fixed.get(high, [])]
    wanted = np.concatenate(at)
    ring = np.clip(np.searchsorted(reach, wanted, side="right") - 1, 0, len(reach) - 2)
    share = ((wanted - reach[ring]) / step[ring])[:, None, None]
    return (1.0 - share) * around[ring] + share * around[ring + 1], fixed


def _places(row: FloatArray, ends: FloatArray, size: float) -> FloatArray:
    """Where along a row (in places around, rising) its nodes are, ``ends`` (e,) among them."""
    along = _along(row)
    long = np.concatenate([along[:-1], along + along[-1]])
    number = np.arange(len(long))
    least = int(np.ceil(12.0 / len(ends)))
    ends = np.interp(np.append(ends, ends[0] + PLACES_AROUND), number, long)
    found = []
    for low, high in itertools.pairwise(ends):
        count = max(least, round((high - low) / size))
        found.append(np.interp(np.linspace(low, high, count + 1)[:-1], long, number))
    return np.sort(np.concatenate(found) % PLACES_AROUND)


def _band(outer: FloatArray, inner: FloatArray, first: int, second: int) -> IntArray:
    """Triangles between two rows, by the places of their nodes; nodes are numbered from first and second."""

    def middles(places: FloatArray) -> FloatArray:
        return np.asarray(0.5 * (places + np.append(places[1:], places[0] + PLACES_AROUND)))

    a, b = middles(outer), middles(inner)
    i, j = np.arange(len(a)), np.arange(len(b))
    facing_a = np.searchsorted(b, a, side="left") % len(b)
    facing_b = np.searchsorted(a, b, side="right") % len(a)
    return np.concatenate(
        [
            np.column_stack([first + i, first + (i + 1) % len(a), second + facing_a]),
            np.column_stack([second + j, first + facing_b, second + (j + 1) % len(b)]),
        ]
    )


def _meshed(layout: _Layout, size: float) -> SheetMesh:
    """The sheet with elements of a ``size`` [m] on wall and floor."""

    def even(distance: FloatArray) -> FloatArray:
        return np.full_like(distance, size)

    box = layout.box
    corners_of_box = np.array(box.exterior.coords[:-1])[::-1]
    if len(layout.around) == 0:
        rim = _spaced(corners_of_box, lambda points: np.full(len(points), size))
        points, triangles = _fill(box, rim, layout.floor, even, None)
        flat_sheet = np.column_stack([points, np.zeros(len(points))])
        return SheetMesh(flat_sheet, triangles, np.full(len(triangles), FLOOR))
    rows, fixed = _rows(layout, size)
    places: list[FloatArray] = []
    nodes: list[FloatArray] = []
    number = np.arange(PLACES_AROUND + 1, dtype=np.float64)
    for row, own in zip(rows, fixed, strict=True):
        ends = np.unique(np.concatenate([layout.corners, own]))
        places.append(_places(row, ends if len(ends) else np.zeros(1), size))
        nodes.append(_at(row, number, places[-1]))
    starts = np.concatenate([[0], np.cumsum([len(row) for row in nodes])])
    parts = [
        _band(places[k], places[k + 1], int(starts[k]), int(starts[k + 1])) for k in range(len(rows) - 1)
    ]
    zones = [np.full(len(part), WALL) for part in parts]
    last = nodes[-1][:, :2]
    points, triangles = _fill(shapely.Polygon(last), last, layout.floor, even, None)
    parts.append(_renumbered(triangles, len(last), int(starts[-2]), int(starts[-1])))
    zones.append(np.full(len(triangles), FLOOR))
    inside = points[len(last) :]
    first = nodes[0][:, :2]
    hole = shapely.Polygon(first)

    def graded(distance: FloatArray) -> FloatArray:
        return np.minimum(size + GROWTH * distance, COARSEST * size)

    rim = _spaced(corners_of_box, lambda points: graded(shapely.distance(hole, shapely.points(points))))
    points, triangles = _fill(box, np.concatenate([first, rim]), layout.flange, graded, hole)
    parts.append(_renumbered(triangles, len(first), 0, int(starts[-1]) + len(inside)))
    zones.append(np.full(len(triangles), FLANGE))
    outside = points[len(first) :]
    flat = [
        np.column_stack([some, np.full(len(some), row[:, 2].mean())])
        for some, row in ((inside, rows[-1]), (outside, rows[0]))
    ]
    whole, joined = np.concatenate([*nodes, *flat]), np.concatenate(parts).astype(np.int64)
    a, b, c = (whole[joined[:, k], :2] for k in range(3))
    if np.min((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) <= 0.0:
        raise _UnfilledError("a wall folds between two rows; give more contours or allow more triangles")
    return SheetMesh(whole, joined, np.concatenate(zones))


def _renumbered(triangles: IntArray, shared: int, first: int, new: int) -> IntArray:
    """Triangles whose first ``shared`` nodes are those from ``first``, and the others from ``new``."""
    return np.where(triangles < shared, triangles + first, triangles - shared + new)


def _spaced(polygon: FloatArray, size_at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Points (p, 2) along a closed polygon, its corners among them, as far apart as ``size_at`` says."""
    found = []
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        share = np.linspace(0.0, 1.0, 201)
        points = start + share[:, None] * (end - start)
        density = lengths(end - start) / size_at(points)
        total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(share))])
        count = max(2, round(total[-1]))
        at = np.interp(np.arange(count) * total[-1] / count, total, share)
        found.append(start + at[:, None] * (end - start))
    return np.concatenate(found)


def _fill(
    region: shapely.Polygon,
    rim: FloatArray,
    fixed: FloatArray,
    size_at: Callable[[FloatArray], FloatArray],
    hole: shapely.Polygon | None,
) -> tuple[FloatArray, IntArray]:
    """Points (rim, ``fixed``, others) and triangles of a flat region: rows around its ``hole``, or in its
    rim.

    Points keep so far from the rim that its edges are those of triangles; Delaunay's triangles of all points
    are kept where they lie in the region, and their areas have to add up to it.
    """
    points = [rim, fixed]
    taken = cKDTree(np.concatenate(points))
    distance = 0.0
    across = float(np.hypot(*np.subtract(region.bounds[2:], region.bounds[:2])))
    for row in range(_MOST_ROWS):
        distance += _ROW * float(size_at(np.array([distance]))[0])
        if hole is None:
            shape = region.buffer(-distance, join_style="mitre")
        else:
            shape = hole.buffer(distance, quad_segs=32)
        if shape.is_empty or distance > across:
            break
        size = float(size_at(np.array([distance]))[0])
        loops = [np.array(part.exterior.coords[:-1]) for part in shapely.get_parts(shape)]
        new = np.concatenate([_loop(loop, size, 0.5 * (row % 2)) for loop in loops])
        new = new[shapely.contains_xy(region, new[:, 0], new[:, 1])]
        new = new[shapely.distance(region.exterior, shapely.points(new)) > _APART * size]
        new = new[taken.query(new)[0] > _APART * size] if len(new) else new
        if len(new):
            points.append(_thinned(new, _APART * size))
            taken = cKDTree(np.concatenate(points))
    whole = np.concatenate(points)
    triangles = Delaunay(whole).simplices.astype(np.int64)
    a, b, c = (whole[triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    triangles = np.where((area < 0.0)[:, None], triangles[:, ::-1], triangles)
    area, middle = np.abs(area), (a + b + c) / 3.0
    kept = (area > _SLIVER * dots(b - a, b - a)) & shapely.contains_xy(region, middle[:, 0], middle[:, 1])
    wanted = region.area
    if hole is not None:
        kept &= ~shapely.contains_xy(hole, middle[:, 0], middle[:, 1])
        wanted -= hole.area
    used = np.unique(triangles[kept])
    if abs(float(area[kept].sum()) - wanted) > 1e-6 * wanted or len(used) < len(whole):
        raise _UnfilledError(
            "a flat region cannot be filled with elements of this size; allow more triangles"
        )
    return whole, triangles[kept]


def _loop(loop: FloatArray, size: float, shift: float) -> FloatArray:
    """Points (p, 2) evenly along a closed line."""
    along = np.concatenate([[0.0], np.cumsum(lengths(np.roll(loop, -1, axis=0) - loop))])
    count = max(3, round(along[-1] / size))
    wanted = (np.arange(count) + shift) / count * along[-1]
    closed = np.concatenate([loop, loop[:1]])
    return np.column_stack([np.interp(wanted, along, closed[:, axis]) for axis in range(2)])


def _thinned(points: FloatArray, apart: float) -> FloatArray:
    """Points without those that are too near to one before them."""
    pairs = cKDTree(points).query_pairs(apart, output_type="ndarray")
    keep: BoolArray = np.ones(len(points), dtype=bool)
    for i, j in pairs[np.lexsort(pairs.T[::-1])]:
        if keep[i]:
            keep[j] = False
    return points[keep]
