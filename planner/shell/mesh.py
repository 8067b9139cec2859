"""Triangles of a formed sheet by rings: contours from the top edge to the floor's edge, kinks on mesh lines.

Walls become bands between rows along the contours, so that no triangle lies across the top edge, the floor's
edge, a kink of the profile or a corner: a triangle across a kink makes the sheet too stiff by percents
however small it is. Floor and flange are flat and filled with rows at growing distances from their rims."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import shapely
from scipy.spatial import Delaunay, cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths
from planner.shell.bisection import bisected
from planner.shell.contours import (
    PLACES_AROUND,
    along_contour,
    counterclockwise,
    matched_contours,
    mean_gap,
    nearest_on,
)

FLANGE, WALL, FLOOR = 0, 1, 2
"""Where a triangle lies."""
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
NEAREST = 0.2
"""Elements about places over others at least."""
NEAR_GROWTH = 0.3
"""How much larger elements about places become by metre of distance from there."""
ROUND = np.radians(15.0)
"""Turn of a profile [rad] between kinks for each row at least."""
_ROW = 0.866
"""Distance of rows of a flat region, in sizes of elements: that of equal-sided triangles."""
_MOST_ROWS = 1000
_SLIVER = 1e-4
"""Area of a triangle over the square of a side, below which it lies along a straight rim and is none."""
_APART = 0.62
"""Distance between points of a flat region at least, in sizes of elements."""
_SPACED_LOOKS = 16
"""Places at which sizes along a straight rim are asked for, in each length of the smallest element."""
_ROUNDS = 10
"""Sizes that are tried for a wanted number of triangles."""
_ENOUGH = 0.95
"""Share of the triangles allowed with which a mesh is taken at once."""
_LARGER = 1.03
"""By how much elements become larger at least that were too many."""
_NEAR_SHARE = 0.4
"""Share of the triangles that those about places may be more where there are too many."""
_LARGER_NEAR = 1.4
"""By how much elements about places become larger then."""
_SMALLER = 0.85
"""By how much elements become smaller that did not fit."""


@dataclasses.dataclass(frozen=True)
class SheetMesh:
    """``nodes`` (n, 3) [m], ``triangles`` (m, 3), counterclockwise from above; ``zone`` (m,) of each
    triangle: FLANGE, WALL or FLOOR."""

    nodes: FloatArray
    triangles: IntArray
    zone: IntArray


@dataclasses.dataclass(frozen=True)
class Wall:
    """A wall of a sheet: ``rings``, closed contours (k, 3) [m] (first point not repeated) from its edge
    inwards, each inside of the one before as seen from above; the first and the last are level. Around the
    first there is flange, or another wall's floor, in the last its own floor, on which other walls may begin:
    those ``inside``, whose first rings are as high."""

    rings: Sequence[FloatArray]
    inside: "Sequence[Wall]" = ()


def mesh_sheet(
    rings: Sequence[FloatArray],
    window: FloatArray,
    triangles: int,
    places: FloatArray | None = None,
    near: float = np.inf,
) -> SheetMesh:
    """A sheet that is clamped along a rectangle and has one wall of these ``rings``, or none.

    ``window`` (2, 2) [m]: least and largest x and y of the clamp; otherwise as `mesh_walls`.
    """
    low, high = np.asarray(window, dtype=np.float64)
    outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return mesh_walls([Wall(rings)] if len(rings) else [], outline, triangles, places, near)


def mesh_walls(
    walls: Sequence[Wall],
    outline: FloatArray,
    triangles: int,
    places: FloatArray | None = None,
    near: float = np.inf,
) -> SheetMesh:
    """A sheet clamped along an ``outline`` (k, 2) [m], with ``walls`` that begin on its flange, of at most so
    many ``triangles``; without walls a flat one at z = 0.

    ``places`` (p, 2 or more) [m]: x, y of points that become nodes, on flange, floors or within `OFF_RING` of
    a ring; about them elements are of ``near`` [m], or `NEAREST` of the others, and grow from there, but
    larger, or as the others, where they do not do with a share of the triangles. Raises ValueError where a
    ring crosses another or the outline, is not level where it has to be, a place is elsewhere, or so few
    triangles do not do.
    """
    some = (
        np.empty((0, 2)) if places is None else np.asarray(places, dtype=np.float64).reshape(len(places), -1)
    )
    frame = shapely.Polygon(counterclockwise(np.asarray(outline, dtype=np.float64)))
    layout = _flat(frame, [_Outlines.of(wall) for wall in walls], some[:, :2])
    size = float(np.sqrt(frame.area / triangles))
    best: SheetMesh | None = None
    why = "none could be made"
    for _ in range(_ROUNDS):
        try:
            made, even = _meshed(frame, layout, size, near)
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
        # those about places stay as many when others become larger
        more = count - even
        if count > triangles and more > _NEAR_SHARE * triangles:
            near = _LARGER_NEAR * max(near, NEAREST * size)
        larger = float(np.sqrt(even / max(0.5 * (1.0 + _ENOUGH) * triangles - more, 0.5 * triangles)))
        size *= max(larger, _LARGER) if count > triangles else larger
    if best is None and np.isfinite(near):
        wider = 2.0 * max(near, NEAREST * size)
        return mesh_walls(walls, outline, triangles, places, wider if wider < size else np.inf)
    if best is None:
        raise ValueError(f"got {triangles} triangles: {why}")
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


@dataclasses.dataclass(frozen=True)
class _Outlines:
    """A wall whose ``rings`` run counterclockwise, ``top`` and ``floor`` as polygons."""

    rings: list[FloatArray]
    top: shapely.Polygon
    floor: shapely.Polygon
    inside: "list[_Outlines]"

    @staticmethod
    def of(wall: Wall) -> "_Outlines":
        """Raises ValueError as `mesh_walls`."""
        rings = [counterclockwise(np.asarray(ring, dtype=np.float64)) for ring in wall.rings]
        shapes = [shapely.Polygon(ring[:, :2]) for ring in rings]
        for index, shape in enumerate(shapes):
            if not shape.is_valid or (index and not shapes[index - 1].buffer(1e-9).contains(shape)):
                raise ValueError(f"ring {index}: crosses itself, or is not inside of the one before")
        for name, level in (("first", rings[0]), ("last", rings[-1])):
            if np.ptp(level[:, 2]) > LEVEL:
                off = np.ptp(level[:, 2])
                raise ValueError(f"{name} ring: heights differ by {off:.2g} m; allowed {LEVEL:g}")
        return _Outlines(rings, shapes[0], shapes[-1], [_Outlines.of(other) for other in wall.inside])


@dataclasses.dataclass(frozen=True)
class _Flat:
    """A flat region, flange or floor, at ``height`` [m]: ``fixed`` (f, 2) points in it that become nodes, and
    ``walls`` that begin there."""

    height: float
    fixed: FloatArray
    walls: "list[_Layout]"


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Where meshes of a wall agree, whatever their size: matched contours ``around`` (r, PLACES_AROUND, 3),
    places of ``corners``, ``fixed``: by contour, places on it of points that become nodes, ``kept``: contours
    that are rows, and its ``floor``."""

    around: FloatArray
    corners: IntArray
    fixed: dict[int, list[float]]
    kept: list[int]
    floor: _Flat

    @functools.cached_property
    def reach(self) -> FloatArray:
        """Mean way (r,) [m] down the wall to each contour."""
        step = lengths(np.diff(self.around, axis=0)).mean(axis=1)
        return np.concatenate([[0.0], np.cumsum(step)])

    @functools.cached_property
    def turn(self) -> FloatArray:
        """By how much (r,) [rad] the profile has turned on the way to each contour, kinks at kept ones left
        out."""
        down = np.diff(self.around, axis=0)
        slope = np.arctan2(-down[:, :, 2].mean(axis=1), lengths(down[:, :, :2]).mean(axis=1))
        turn = np.abs(np.diff(slope, prepend=slope[:1], append=slope[-1:]))
        turn[self.kept] = 0.0
        return np.cumsum(0.5 * np.append(0.0, turn[1:] + turn[:-1]))

    def points(self, reach: FloatArray, place: FloatArray) -> FloatArray:
        """Points (n, 3) [m] at ways down the wall (n,) [m] and places around it (n,), linear between."""
        ring = np.clip(np.searchsorted(self.reach, reach, side="right") - 1, 0, max(len(self.reach) - 2, 0))
        inner = np.minimum(ring + 1, len(self.reach) - 1)
        step = np.where(inner > ring, self.reach[inner] - self.reach[ring], 1.0)
        low = np.floor(place).astype(np.int64)
        down, on = ((reach - self.reach[ring]) / step)[:, None], (place - low)[:, None]
        high = (low + 1) % PLACES_AROUND
        low = low % PLACES_AROUND
        outer = (1.0 - on) * self.around[ring, low] + on * self.around[ring, high]
        return (1.0 - down) * outer + down * (
            (1.0 - on) * self.around[inner, low] + on * self.around[inner, high]
        )


def _flat(region: shapely.Polygon, walls: list[_Outlines], places: FloatArray, height: float = 0.0) -> _Flat:
    """A flat region with the walls that begin on it, and the ``places`` (p, 2) in it or in them."""
    tops = [wall.top for wall in walls]
    for index, top in enumerate(tops):
        others = shapely.union_all([*tops[:index], region.exterior])
        if not region.contains(top) or others.intersects(top):
            raise ValueError(f"wall {index}: its first ring is not inside of the window or floor around it")
    own: list[list[FloatArray]] = [[] for _ in walls]
    fixed = []
    for place in places:
        off = [min(nearest_on(ring[:, :2], place)[0] for ring in wall.rings) for wall in walls]
        point = shapely.Point(place)
        near = [k for k, wall in enumerate(walls) if wall.top.contains(point) or off[k] <= OFF_RING]
        if near:
            own[min(near, key=lambda k: off[k])].append(place)
        elif region.contains(point):
            fixed.append(place)
        else:
            raise ValueError(f"place ({place[0]:.4g}, {place[1]:.4g}) m: not within the outline of the sheet")
    layouts = [_laid_out(wall, some) for wall, some in zip(walls, own, strict=True)]
    level = float(walls[0].rings[0][:, 2].mean()) if walls else height
    if any(abs(float(wall.rings[0][:, 2].mean()) - level) > LEVEL for wall in walls):
        raise ValueError("walls: first rings on one flat are not equally high")
    return _Flat(level, np.array(fixed).reshape(-1, 2), layouts)


def _laid_out(wall: _Outlines, places: Sequence[FloatArray]) -> _Layout:
    """Which contours of a wall are rows, and where the points lie that become nodes."""
    outlines = wall.rings
    gap = np.array([mean_gap(*pair) for pair in itertools.pairwise(outlines)])
    rise = np.diff([ring[:, 2].mean() for ring in outlines])
    slope = np.arctan2(rise, gap)
    kept = {0, *(np.flatnonzero(np.abs(np.diff(slope)) > KINK) + 1).tolist(), len(outlines) - 1}
    on: dict[int, list[FloatArray]] = {}
    inner = []
    for place in places:
        off = [nearest_on(ring[:, :2], place)[0] for ring in outlines]
        ring = int(np.argmin(off))
        if off[ring] <= OFF_RING:
            on.setdefault(ring, []).append(place)
            kept.add(ring)
        elif wall.floor.contains(shapely.Point(place)):
            inner.append(place)
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
    around, corners = matched_contours([outlines[index] for index in used])
    number = {index: place for place, index in enumerate(used)}
    fixed = {
        number[index]: [nearest_on(around[number[index], :, :2], point)[1] for point in points]
        for index, points in on.items()
    }
    rows = sorted(number[index] for index in kept)
    height = float(outlines[-1][:, 2].mean())
    floor = _flat(wall.floor, wall.inside, np.array(inner).reshape(-1, 2), height)
    if abs(floor.height - height) > LEVEL:
        raise ValueError("walls: a first ring is not as high as the floor it is on")
    return _Layout(around, corners, fixed, rows, floor)


def _rows(layout: _Layout, size: float) -> tuple[FloatArray, list[list[float]]]:
    """Ways down the wall (r,) [m] of its rows, kept contours among them, and places of their fixed nodes."""
    reach = layout.reach
    at, fixed = [reach[:1]], [layout.fixed.get(0, [])]
    for low, high in zip(layout.kept, layout.kept[1:], strict=False):
        part = slice(low, high + 1)
        turn = layout.turn[part] - layout.turn[low]
        elements = np.append(0.0, np.cumsum(np.maximum(np.diff(reach[part]) / size, np.diff(turn) / ROUND)))
        count = max(1, round(elements[-1]))
        at.append(np.interp(np.linspace(0.0, elements[-1], count + 1)[1:], elements, reach[part]))
        fixed += [[]] * (count - 1) + [layout.fixed.get(high, [])]
    return np.concatenate(at), fixed


def _places(row: FloatArray, ends: FloatArray, size: float) -> FloatArray:
    """Where along a row (in places around, rising) its nodes are, ``ends`` (e,) among them."""
    along = along_contour(row)
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


def _spots(flat: _Flat) -> Iterator[FloatArray]:
    """Points (p, 3) [m] of a sheet that become nodes: of a flat region, and of the walls on it."""
    yield np.column_stack([flat.fixed, np.full(len(flat.fixed), flat.height)])
    for wall in flat.walls:
        for ring, places in wall.fixed.items():
            yield wall.points(np.full(len(places), wall.reach[ring]), np.array(places))
        yield from _spots(wall.floor)


class _Parts:
    """Nodes and triangles, as they are made: of a ``size`` [m], of ``near`` [m] at ``spots`` (p, 3) [m] and
    growing from there."""

    def __init__(self, size: float, spots: FloatArray, near: float) -> None:
        self.size = size
        near = max(near, NEAREST * size)
        tree = cKDTree(spots) if near < size and len(spots) else None

        def size_at(points: FloatArray) -> FloatArray:
            if tree is None:
                return np.full(len(points), np.inf)
            wanted = near + NEAR_GROWTH * np.asarray(tree.query(points)[0])
            return np.where(wanted < size, wanted, np.inf)

        self.size_at, self.even = size_at, tree is None
        self.walls: list[_Layout] = []
        self.nodes: list[FloatArray] = []
        self.triangles: list[IntArray] = []
        self.zones: list[IntArray] = []
        self._count = 0

    def begin(self, layout: _Layout) -> int:
        """Add a wall; its number."""
        self.walls.append(layout)
        return len(self.walls) - 1

    def add(
        self,
        nodes: FloatArray,
        wall: int = -1,
        reach: FloatArray | float = 0.0,
        place: FloatArray | float = 0.0,
    ) -> IntArray:
        """Add nodes (n, 3), where they are on a ``wall``: ``reach`` (n,) [m] down, ``place`` (n,) around it;
        their numbers."""
        on = np.column_stack(np.broadcast_arrays(np.full(len(nodes), wall), reach, place))
        self.nodes.append(np.column_stack([nodes, on]))
        self._count += len(nodes)
        return np.arange(self._count - len(nodes), self._count)

    def join(self, triangles: IntArray, zone: int) -> None:
        """Add triangles (m, 3) of nodes' numbers."""
        self.triangles.append(triangles)
        self.zones.append(np.full(len(triangles), zone))

    def finer(self) -> tuple[FloatArray, IntArray, IntArray]:
        """Nodes, triangles and their zones, cut where they are larger than they may be about spots."""
        nodes, triangles = np.concatenate(self.nodes), np.concatenate(self.triangles).astype(np.int64)
        zones = np.concatenate(self.zones)
        if self.even:
            return nodes, triangles, zones

        def middle(one: FloatArray, two: FloatArray, beside: IntArray) -> FloatArray:
            new = 0.5 * (one + two)
            new[:, 3] = np.where((zones[beside] == WALL).any(axis=1), one[:, 3], -1)
            around = two[:, 5] - one[:, 5]
            around -= PLACES_AROUND * np.round(around / PLACES_AROUND)
            new[:, 5] = (one[:, 5] + 0.5 * around) % PLACES_AROUND
            for number, wall in enumerate(self.walls):
                mine = new[:, 3] == number
                new[mine, :3] = wall.points(new[mine, 4], new[mine, 5])
            return new

        nodes, triangles, owner = bisected(nodes, triangles, self.size_at, middle)
        return nodes, triangles, zones[owner]


def _meshed(frame: shapely.Polygon, layout: _Flat, size: float, near: float) -> tuple[SheetMesh, int]:
    """The sheet with elements of a ``size`` [m] on walls and floors, of ``near`` [m] about places; and how
    many triangles it would have without those."""
    parts = _Parts(size, np.concatenate(list(_spots(layout))), near)
    tops = [_wall(wall, parts) for wall in layout.walls]
    corners = np.array(frame.exterior.coords[:-1])
    size_at, zone = _even(size), FLOOR
    if tops:
        holes = shapely.union_all([shapely.Polygon(points) for _, points in tops])

        def graded(distance: FloatArray) -> FloatArray:
            return np.minimum(size + GROWTH * distance, COARSEST * size)

        rim = _spaced(corners, size, lambda points: graded(shapely.distance(holes, shapely.points(points))))
        size_at, zone = graded, FLANGE
    else:
        rim = _spaced(corners, size, lambda points: np.full(len(points), size))
    number = parts.add(np.column_stack([rim, np.full(len(rim), layout.height)]))
    _filled(frame, (number, rim), tops, layout, size_at, zone, parts)
    nodes, joined, zones = parts.finer()
    if _folded(nodes, joined).any():
        raise _UnfilledError(_FOLDS)
    return SheetMesh(nodes[:, :3], joined, zones), sum(map(len, parts.triangles))


_FOLDS = "a wall folds between two rows; give more contours or allow more triangles"


def _folded(nodes: FloatArray, triangles: IntArray) -> BoolArray:
    """Triangles (m,) that do not run counterclockwise seen from above."""
    a, b, c = (nodes[triangles[:, k], :2] for k in range(3))
    return np.asarray((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] <= 0.0)


def _even(size: float) -> Callable[[FloatArray], FloatArray]:
    """Elements of one ``size`` [m] at any distance."""
    return lambda distance: np.full_like(distance, size)


_Rim = tuple[IntArray, FloatArray]
"""Numbers (n,) of nodes along a rim, and where they are in plan (n, 2)."""


def _wall(layout: _Layout, parts: _Parts) -> _Rim:
    """Add a wall and its floor; its first row."""
    rows, fixed = _rows(layout, parts.size)
    number = np.arange(PLACES_AROUND, dtype=np.float64)
    places: list[FloatArray] = []
    numbers: list[IntArray] = []
    wall = parts.begin(layout)
    for reach, own in zip(rows, fixed, strict=True):
        ends = np.unique(np.concatenate([layout.corners, own]))
        row = layout.points(np.full(PLACES_AROUND, reach), number)
        places.append(_places(row, ends if len(ends) else np.zeros(1), parts.size))
        down = np.full(len(places[-1]), reach)
        numbers.append(parts.add(layout.points(down, places[-1]), wall, down, places[-1]))
    first = len(parts.nodes) - len(rows)
    for k in range(len(rows) - 1):
        band = _band(places[k], places[k + 1], int(numbers[k][0]), int(numbers[k + 1][0]))
        rows_of_two = np.concatenate(parts.nodes[first + k : first + k + 2])
        own = band - numbers[k][0]
        folded = own[_folded(rows_of_two, own)]
        # about spots they are cut to smaller ones, that may lie flat; elsewhere nothing of it changes
        if len(folded) and np.isinf(parts.size_at(rows_of_two[folded, :3].mean(axis=1))).any():
            raise _UnfilledError(_FOLDS)
        parts.join(band, WALL)
    top, last = parts.nodes[first][:, :2], parts.nodes[-1][:, :2]
    tops = [_wall(wall, parts) for wall in layout.floor.walls]
    rim = (numbers[-1], last)
    _filled(shapely.Polygon(last), rim, tops, layout.floor, _even(parts.size), FLOOR, parts)
    return numbers[0], top


def _filled(
    region: shapely.Polygon,
    rim: _Rim,
    tops: Sequence[_Rim],
    flat: _Flat,
    size_at: Callable[[FloatArray], FloatArray],
    zone: int,
    parts: _Parts,
) -> None:
    """Add the triangles of a flat region between its ``rim`` and the ``tops`` of the walls on it."""
    numbers = np.concatenate([rim[0], *(number for number, _ in tops)])
    around = np.concatenate([rim[1], *(points for _, points in tops)])
    holes = shapely.union_all([shapely.Polygon(points) for _, points in tops]) if tops else None
    points, triangles = _fill(region, around, flat.fixed, size_at, holes)
    new = points[len(around) :]
    numbers = np.concatenate([numbers, parts.add(np.column_stack([new, np.full(len(new), flat.height)]))])
    parts.join(numbers[triangles], zone)


def _spaced(polygon: FloatArray, least: float, size_at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Points (p, 2) along a closed polygon, its corners among them, as far apart as ``size_at`` says: nowhere
    below ``least`` [m]."""
    way = np.roll(polygon, -1, axis=0) - polygon
    long = lengths(way)
    looks = np.clip(np.ceil(_SPACED_LOOKS * long / least), 8, 200).astype(np.int64) + 1
    shares = [np.linspace(0.0, 1.0, count) for count in looks]
    points = np.repeat(polygon, looks, axis=0) + np.concatenate(shares)[:, None] * np.repeat(
        way, looks, axis=0
    )
    sizes = np.split(size_at(points), np.cumsum(looks)[:-1])
    found = []
    for start, step, far, share, size in zip(polygon, way, long, shares, sizes, strict=True):
        density = far / size
        total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(share))])
        count = max(2, round(total[-1]))
        at = np.interp(np.arange(count) * total[-1] / count, total, share)
        found.append(start + at[:, None] * step)
    return np.concatenate(found)


def _fill(
    region: shapely.Polygon,
    rim: FloatArray,
    fixed: FloatArray,
    size_at: Callable[[FloatArray], FloatArray],
    hole: shapely.Geometry | None,
) -> tuple[FloatArray, IntArray]:
    """Points (rim, ``fixed``, others) and triangles of a flat region: rows around its ``hole``, or in its
    rim.

    Points keep so far from the rim that its edges are those of triangles; Delaunay's triangles of all points
    are kept where they lie in the region, and their areas have to add up to it.
    """
    border = region.exterior
    shapely.prepare(region)
    shapely.prepare(border)
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
        rings = shapely.get_rings(
            shapely.get_parts(shape)
        )  # where rows around several holes meet they have holes
        loops = [shapely.get_coordinates(ring)[:-1] for ring in rings]
        new = np.concatenate([_loop(loop, size, 0.5 * (row % 2)) for loop in loops])
        new = new[shapely.contains_xy(region, new[:, 0], new[:, 1])]
        new = new[~shapely.dwithin(border, shapely.points(new), _APART * size)]
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
