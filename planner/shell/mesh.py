"""Triangle meshes of formed sheets, from the contours of their walls.

Walls are meshed in bands between rows, which are closed loops of nodes at constant distances down the wall.
No triangle crosses the top edge, the floor's edge, a kink of the profile or a corner: a triangle across a
kink, however small, makes the sheet too stiff by several percent. Floor and flange are flat and are filled
with rows at growing distances from their rims.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import shapely
from scipy.spatial import Delaunay, cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, lengths
from planner.shell.bisection import bisect
from planner.shell.contours import (
    POSITIONS_AROUND,
    along_contour,
    counterclockwise,
    match_contours,
    mean_gap,
    nearest_point_on,
)

FLANGE, WALL, FLOOR = 0, 1, 2
"""Zones of triangles."""
KINK_ANGLE = np.radians(8.0)
"""Bend [rad] of the profile at a contour above which the contour is a mesh line."""
GROWTH = 0.3
"""Growth of the size of flange elements [m] per metre of distance from the top edge."""
MAX_COARSENING = 5.0
"""Maximum ratio of the size of flange elements to that of wall elements."""
LEVEL_TOLERANCE_M = 1e-6
"""Tolerance [m] of the heights of the first and last contour."""
MAX_RING_DISTANCE_M = 5e-4
"""Maximum distance [m] from a contour of a given point that becomes a node on it."""
MIN_STEP_M = 1e-3
"""Minimum distance [m] down the wall between contours that are used, except at kinks."""
MIN_SIZE_RATIO = 0.2
"""Minimum ratio of the size of elements near given points to that of the others."""
NEAR_GROWTH = 0.3
"""Growth of the size of elements [m] per metre of distance from the given points."""
MAX_BEND_PER_ROW = np.radians(15.0)
"""Maximum bend [rad] of the profile per row between kinks."""
_ROW = 0.866
"""Distance between rows of a flat region in element sizes, as in equilateral triangles."""
_MAX_ROWS = 1000
"""Maximum number of rows in a flat region."""
_SLIVER = 1e-4
"""Ratio of area to squared side length below which a triangle lies along a straight rim and is dropped."""
_MIN_SPACING_RATIO = 0.62
"""Minimum distance between points of a flat region, in element sizes."""
_SIZE_SAMPLES = 16
"""Number of size samples along a straight rim per length of the smallest element."""
_ROUNDS = 10
"""Maximum number of element sizes tried for a requested number of triangles."""
_ACCEPTED_FRACTION = 0.95
"""Fraction of the allowed triangles above which a mesh is accepted at once."""
_LARGER = 1.03
"""Minimum factor by which elements grow after too many triangles."""
_NEAR_SHARE = 0.4
"""Maximum fraction of the triangles that refinement near given points may add if there are too many."""
_LARGER_NEAR = 1.4
"""Factor by which elements near given points grow beyond that fraction."""
_SMALLER = 0.85
"""Factor by which elements shrink if they did not fit."""


@dataclasses.dataclass(frozen=True)
class ShellMesh:
    """Triangle mesh of a sheet.

    Attributes:
        nodes: Nodes (n, 3) [m].
        triangles: Node indices (m, 3), counterclockwise from above.
        zone: FLANGE, WALL or FLOOR for each triangle (m,).
    """

    nodes: FloatArray
    triangles: IntArray
    zone: IntArray


@dataclasses.dataclass(frozen=True)
class Wall:
    """A wall of a sheet.

    Attributes:
        rings: Closed contours (k, 3) [m], first point not repeated, from the outer edge inwards. As seen from
            above, each lies inside the previous one. The first and last are level. The first is surrounded by
            the flange or another wall's floor. The last surrounds the wall's own floor.
        inside: Walls on this wall's floor. Their first contours have the height of the floor.
    """

    rings: Sequence[FloatArray]
    inside: "Sequence[Wall]" = ()


def mesh_sheet(
    rings: Sequence[FloatArray],
    window: FloatArray,
    triangles: int,
    points: FloatArray | None = None,
    near_size: float = np.inf,
) -> ShellMesh:
    """Mesh a sheet that is clamped along a rectangle and has at most one wall.

    Args:
        rings: Contours of the wall, or none.
        window: Smallest and largest x and y of the clamp (2, 2) [m].
        triangles: See `mesh_walls`.
        points: See `mesh_walls`.
        near_size: See `mesh_walls`.

    Raises:
        ValueError: See `mesh_walls`.
    """
    low, high = np.asarray(window, dtype=np.float64)
    outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return mesh_walls([Wall(rings)] if len(rings) else [], outline, triangles, points, near_size)


def mesh_walls(
    walls: Sequence[Wall],
    outline: FloatArray,
    triangles: int,
    points: FloatArray | None = None,
    near_size: float = np.inf,
) -> ShellMesh:
    """Mesh a sheet that is clamped along its outline.

    The size of elements is adjusted until the number of triangles is just below its maximum. If refinement
    near the given points takes too many of the triangles, it is made coarser or left out.

    Args:
        walls: Walls that begin on the flange. Without walls the sheet is flat at z = 0.
        outline: Clamped outline (k, 2) [m].
        triangles: Maximum number of triangles.
        points: Points (p, 2 or more) [m] whose x, y become nodes, on the flange, on floors or within
            `MAX_RING_DISTANCE_M` of a contour.
        near_size: Element size [m] at these points, at least `MIN_SIZE_RATIO` times that elsewhere. It grows
            with the distance.

    Raises:
        ValueError: If contours cross each other or the outline, contours are not level, a point lies
            elsewhere, or the triangles are too few.
    """
    fixed_points = (
        np.empty((0, 2)) if points is None else np.asarray(points, dtype=np.float64).reshape(len(points), -1)
    )
    frame = shapely.Polygon(counterclockwise(np.asarray(outline, dtype=np.float64)))
    layout = _lay_out_region(frame, [_Outlines.of(wall) for wall in walls], fixed_points[:, :2])
    size = float(np.sqrt(frame.area / triangles))
    best: ShellMesh | None = None
    reason = "no mesh was possible"
    for _ in range(_ROUNDS):
        try:
            mesh, count_unrefined = _mesh_with_size(frame, layout, size, near_size)
        except _UnfilledError as unfilled:
            reason = str(unfilled)
            size *= _SMALLER
            continue
        count = len(mesh.triangles)
        if count <= triangles and (best is None or count > len(best.triangles)):
            best = mesh
        if best is mesh and count > _ACCEPTED_FRACTION * triangles:
            break
        reason = f"allow about {count}"
        # count_unrefined: before refinement near the given points, which adds a number of triangles that
        # hardly depends on the size of the others
        count_added = count - count_unrefined
        if count > triangles and count_added > _NEAR_SHARE * triangles:
            near_size = _LARGER_NEAR * max(near_size, MIN_SIZE_RATIO * size)
        # size ~ 1 / sqrt(number of triangles)
        target = max(0.5 * (1.0 + _ACCEPTED_FRACTION) * triangles - count_added, 0.5 * triangles)
        factor = float(np.sqrt(count_unrefined / target))
        size *= max(factor, _LARGER) if count > triangles else factor
    if best is None and np.isfinite(near_size):
        wider = 2.0 * max(near_size, MIN_SIZE_RATIO * size)
        return mesh_walls(walls, outline, triangles, points, wider if wider < size else np.inf)
    if best is None:
        raise ValueError(f"got {triangles} triangles: {reason}")
    return best


class _UnfilledError(ValueError):
    """A region cannot be meshed with elements of the current size."""


def cone_rings(top_radius: float, wall_angle: float, depth: float, sides: int = 360) -> list[FloatArray]:
    """Return the top and floor edge (sides, 3) [m] of a truncated cone about z that tapers downwards.

    Args:
        top_radius: Radius [m] at z = 0.
        wall_angle: Angle [rad] of the wall from horizontal.
        depth: Depth [m].
        sides: Number of points of each edge.

    Raises:
        ValueError: If the tip of the cone lies above the depth.
    """
    angle = 2.0 * np.pi * np.arange(sides) / sides
    unit_circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sides)])
    floor_radius = top_radius - depth / np.tan(wall_angle)
    if floor_radius <= 0.0:
        raise ValueError(f"depth: got {depth:g} m, below the tip of this cone")
    return [top_radius * unit_circle, floor_radius * unit_circle - [0.0, 0.0, depth]]


@dataclasses.dataclass(frozen=True)
class _Outlines:
    """A wall with counterclockwise contours.

    Attributes:
        rings: Contours (k, 3) [m].
        top: First contour as a polygon.
        floor: Last contour as a polygon.
        inside: Walls on the floor.
    """

    rings: list[FloatArray]
    top: shapely.Polygon
    floor: shapely.Polygon
    inside: "list[_Outlines]"

    @staticmethod
    def of(wall: Wall) -> "_Outlines":
        """Check and orient the contours of a wall.

        Raises:
            ValueError: See `mesh_walls`.
        """
        rings = [counterclockwise(np.asarray(ring, dtype=np.float64)) for ring in wall.rings]
        shapes = [shapely.Polygon(ring[:, :2]) for ring in rings]
        for index, shape in enumerate(shapes):
            if not shape.is_valid or (index and not shapes[index - 1].buffer(1e-9).contains(shape)):
                raise ValueError(f"ring {index}: crosses itself, or is not inside the one before")
        for name, level in (("first", rings[0]), ("last", rings[-1])):
            if np.ptp(level[:, 2]) > LEVEL_TOLERANCE_M:
                height_range = np.ptp(level[:, 2])
                raise ValueError(
                    f"{name} ring: heights differ by {height_range:.2g} m, allowed {LEVEL_TOLERANCE_M:g} m"
                )
        return _Outlines(rings, shapes[0], shapes[-1], [_Outlines.of(other) for other in wall.inside])


@dataclasses.dataclass(frozen=True)
class _FlatRegion:
    """A flat region: flange or floor.

    Attributes:
        height: z [m].
        fixed: Points (f, 2) [m] that become nodes.
        walls: Walls that begin on the region.
    """

    height: float
    fixed: FloatArray
    walls: "list[_WallLayout]"


@dataclasses.dataclass(frozen=True)
class _WallLayout:
    """Parts of a wall's mesh that do not depend on the element size.

    Attributes:
        around: Points (r, POSITIONS_AROUND, 3) [m] of the matched contours, from the outer edge inwards.
            Points of equal index on adjacent contours belong together.
        corners: Positions (c,) of the lines of corners.
        fixed: Positions of given points that become nodes, by index of the contour.
        kept: Indices of the contours that become rows, ascending.
        floor: Floor of the wall.
    """

    around: FloatArray
    corners: IntArray
    fixed: dict[int, list[float]]
    kept: list[int]
    floor: _FlatRegion

    @functools.cached_property
    def reach(self) -> FloatArray:
        """Mean distance (r,) [m] down the wall from the first contour to each contour."""
        step = lengths(np.diff(self.around, axis=0)).mean(axis=1)
        return np.concatenate([[0.0], np.cumsum(step)])

    @functools.cached_property
    def accumulated_bend(self) -> FloatArray:
        """Accumulated bend (r,) [rad] of the profile up to each contour, without kinks at kept contours.

        Half of the bend at each contour counts for the band above it, half for the band below.
        """
        down = np.diff(self.around, axis=0)
        slope = np.arctan2(-down[:, :, 2].mean(axis=1), lengths(down[:, :, :2]).mean(axis=1))
        bend = np.abs(np.diff(slope, prepend=slope[:1], append=slope[-1:]))
        bend[self.kept] = 0.0
        return np.cumsum(0.5 * np.append(0.0, bend[1:] + bend[:-1]))

    def points(self, reach: FloatArray, position: FloatArray) -> FloatArray:
        """Return points (n, 3) [m] of the wall by bilinear interpolation between contours and positions.

        Args:
            reach: Distances (n,) [m] down the wall from its first contour, as :attr:`reach`.
            position: Positions (n,) around the wall, as fractional indices along a contour. They may be
                outside of the range of indices, because contours are closed.
        """
        # indices of the contours above and below each point, and of the positions to both sides of it
        upper = np.clip(np.searchsorted(self.reach, reach, side="right") - 1, 0, max(len(self.reach) - 2, 0))
        lower = np.minimum(upper + 1, len(self.reach) - 1)
        step = np.where(lower > upper, self.reach[lower] - self.reach[upper], 1.0)
        before = np.floor(position).astype(np.int64)
        down = ((reach - self.reach[upper]) / step)[:, None]
        along = (position - before)[:, None]
        after = (before + 1) % POSITIONS_AROUND
        before = before % POSITIONS_AROUND
        on_upper = (1.0 - along) * self.around[upper, before] + along * self.around[upper, after]
        on_lower = (1.0 - along) * self.around[lower, before] + along * self.around[lower, after]
        return (1.0 - down) * on_upper + down * on_lower


def _lay_out_region(
    region: shapely.Polygon, walls: list[_Outlines], points: FloatArray, height: float = 0.0
) -> _FlatRegion:
    """Assign points to a flat region or its walls, and lay out the walls.

    Args:
        region: Region.
        walls: Walls that begin on it.
        points: Points (p, 2) [m] in the region or on its walls.
        height: z [m] of a region without walls.

    Raises:
        ValueError: See `mesh_walls`.
    """
    tops = [wall.top for wall in walls]
    for index, top in enumerate(tops):
        others = shapely.union_all([*tops[:index], region.exterior])
        if not region.contains(top) or others.intersects(top):
            raise ValueError(f"wall {index}: its first ring is not inside the window or floor around it")
    wall_points: list[list[FloatArray]] = [[] for _ in walls]
    fixed = []
    for xy in points:
        distances = [min(nearest_point_on(ring[:, :2], xy)[0] for ring in wall.rings) for wall in walls]
        point = shapely.Point(xy)
        candidates = [
            k
            for k, wall in enumerate(walls)
            if wall.top.contains(point) or distances[k] <= MAX_RING_DISTANCE_M
        ]
        if candidates:
            wall_points[min(candidates, key=lambda k: distances[k])].append(xy)
        elif region.contains(point):
            fixed.append(xy)
        else:
            raise ValueError(f"point ({xy[0]:.4g}, {xy[1]:.4g}) m: not within the outline of the sheet")
    layouts = [_lay_out_wall(wall, on_wall) for wall, on_wall in zip(walls, wall_points, strict=True)]
    level = float(walls[0].rings[0][:, 2].mean()) if walls else height
    if any(abs(float(wall.rings[0][:, 2].mean()) - level) > LEVEL_TOLERANCE_M for wall in walls):
        raise ValueError("walls: first rings on the same flat region differ in height")
    return _FlatRegion(level, np.array(fixed).reshape(-1, 2), layouts)


def _lay_out_wall(wall: _Outlines, given_points: Sequence[FloatArray]) -> _WallLayout:
    """Choose the contours of a wall that become rows, match the contours, and lay out the floor.

    Given points become nodes of the nearest contour or of the floor.

    Raises:
        ValueError: See `mesh_walls`.
    """
    outlines = wall.rings
    gap = np.array([mean_gap(outer, inner) for outer, inner in itertools.pairwise(outlines)])
    rise = np.diff([ring[:, 2].mean() for ring in outlines])
    slope = np.arctan2(rise, gap)
    kept = {0, *(np.flatnonzero(np.abs(np.diff(slope)) > KINK_ANGLE) + 1).tolist(), len(outlines) - 1}
    points_by_ring: dict[int, list[FloatArray]] = {}
    floor_points = []
    for point in given_points:
        distances = [nearest_point_on(ring[:, :2], point)[0] for ring in outlines]
        ring = int(np.argmin(distances))
        if distances[ring] <= MAX_RING_DISTANCE_M:
            points_by_ring.setdefault(ring, []).append(point)
            kept.add(ring)
        elif wall.floor.contains(shapely.Point(point)):
            floor_points.append(point)
        else:
            raise ValueError(
                f"point ({point[0]:.4g}, {point[1]:.4g}) m: {distances[ring]:.2g} m from the nearest contour,"
                f" outside of floor and flange, allowed {MAX_RING_DISTANCE_M:g} m; add a contour through it"
            )
    # contours much closer than the element size would only add matching errors
    reach = np.concatenate([[0.0], np.cumsum(np.hypot(gap, rise))])
    used: list[int] = []
    for index in range(len(outlines)):
        if index in kept or reach[index] - reach[used[-1]] >= MIN_STEP_M:
            used.append(index)
    around, corners = match_contours([outlines[index] for index in used])
    number = {index: k for k, index in enumerate(used)}
    fixed = {
        number[index]: [nearest_point_on(around[number[index], :, :2], point)[1] for point in points]
        for index, points in points_by_ring.items()
    }
    rows = sorted(number[index] for index in kept)
    height = float(outlines[-1][:, 2].mean())
    floor = _lay_out_region(wall.floor, wall.inside, np.array(floor_points).reshape(-1, 2), height)
    if abs(floor.height - height) > LEVEL_TOLERANCE_M:
        raise ValueError("walls: a first ring differs in height from the floor below it")
    return _WallLayout(around, corners, fixed, rows, floor)


def _rows(layout: _WallLayout, size: float) -> tuple[FloatArray, list[list[float]]]:
    """Return the distances (r,) [m] of the rows down the wall, and the positions of fixed nodes in each row.

    The rows include the kept contours. Between two of these, rows are evenly spaced in element sizes, and
    closer where the profile bends more than `MAX_BEND_PER_ROW` per row. ``size`` is the element size [m].
    """
    reach = layout.reach
    distances, fixed = [reach[:1]], [layout.fixed.get(0, [])]
    for low, high in zip(layout.kept, layout.kept[1:], strict=False):
        part = slice(low, high + 1)
        bend = layout.accumulated_bend[part] - layout.accumulated_bend[low]
        elements = np.append(
            0.0, np.cumsum(np.maximum(np.diff(reach[part]) / size, np.diff(bend) / MAX_BEND_PER_ROW))
        )
        count = max(1, round(elements[-1]))
        distances.append(np.interp(np.linspace(0.0, elements[-1], count + 1)[1:], elements, reach[part]))
        fixed += [[]] * (count - 1) + [layout.fixed.get(high, [])]
    return np.concatenate(distances), fixed


def _row_positions(row: FloatArray, ends: FloatArray, size: float) -> FloatArray:
    """Return ascending positions of the nodes of a row, with ``ends`` (e,) among them.

    The nodes of the row become corners of triangles. A row has at least 12 nodes, about ``size`` [m] apart.
    ``row`` are its points at all positions (`POSITIONS_AROUND`, 3) [m].
    """
    # arc length by position, twice around, because the part after the last end goes on to the first one
    along = along_contour(row)
    twice_around = np.concatenate([along[:-1], along + along[-1]])
    number = np.arange(len(twice_around))
    min_count = int(np.ceil(12.0 / len(ends)))
    ends = np.interp(np.append(ends, ends[0] + POSITIONS_AROUND), number, twice_around)
    parts = []
    for low, high in itertools.pairwise(ends):
        count = max(min_count, round((high - low) / size))
        parts.append(np.interp(np.linspace(low, high, count + 1)[:-1], twice_around, number))
    return np.sort(np.concatenate(parts) % POSITIONS_AROUND)


def _band(outer: FloatArray, inner: FloatArray, first: int, second: int) -> IntArray:
    """Return the triangles (a + b, 3) of the closed band between two rows of a wall.

    Each edge of a row forms a triangle with the node of the other row that faces its middle.

    Args:
        outer: Ascending positions (a,) of the nodes of the outer row around the wall.
        inner: Ascending positions (b,) of the nodes of the next row inwards.
        first: Index of the first node of the outer row. The others follow.
        second: Index of the first node of the inner row. The others follow.
    """

    def edge_middles(positions: FloatArray) -> FloatArray:
        return np.asarray(0.5 * (positions + np.append(positions[1:], positions[0] + POSITIONS_AROUND)))

    a, b = edge_middles(outer), edge_middles(inner)
    i, j = np.arange(len(a)), np.arange(len(b))
    facing_a = np.searchsorted(b, a, side="left") % len(b)
    facing_b = np.searchsorted(a, b, side="right") % len(a)
    return np.concatenate(
        [
            np.column_stack([first + i, first + (i + 1) % len(a), second + facing_a]),
            np.column_stack([second + j, first + facing_b, second + (j + 1) % len(b)]),
        ]
    )


def _spots(flat: _FlatRegion) -> Iterator[FloatArray]:
    """Yield the given points (p, 3) [m] that become nodes: of a flat region, then of the walls on it."""
    yield np.column_stack([flat.fixed, np.full(len(flat.fixed), flat.height)])
    for wall in flat.walls:
        for ring, positions in wall.fixed.items():
            yield wall.points(np.full(len(positions), wall.reach[ring]), np.array(positions))
        yield from _spots(wall.floor)


class _MeshParts:
    """Nodes and triangles of a mesh under construction.

    Args:
        size: Element size [m].
        spots: Points (p, 3) [m] around which elements are smaller.
        near_size: Element size [m] at these points.

    A node has 6 values: x, y, z [m], index of its wall (-1 for none), distance down the wall [m], position.
    """

    def __init__(self, size: float, spots: FloatArray, near_size: float) -> None:
        self.size = size
        near_size = max(near_size, MIN_SIZE_RATIO * size)
        tree = cKDTree(spots) if near_size < size and len(spots) else None

        def size_at(points: FloatArray) -> FloatArray:
            """Return the maximum edge length at points near the given ones, infinite elsewhere."""
            if tree is None:
                return np.full(len(points), np.inf)
            max_length = near_size + NEAR_GROWTH * np.asarray(tree.query(points)[0])
            return np.where(max_length < size, max_length, np.inf)

        self.size_at = size_at
        self.even = tree is None  # no refinement near given points
        self.walls: list[_WallLayout] = []
        self.nodes: list[FloatArray] = []
        self.triangles: list[IntArray] = []
        self.zones: list[IntArray] = []
        self._count = 0

    def add_wall(self, layout: _WallLayout) -> int:
        """Add a wall and return its index."""
        self.walls.append(layout)
        return len(self.walls) - 1

    def add(
        self,
        nodes: FloatArray,
        wall: int = -1,
        reach: FloatArray | float = 0.0,
        position: FloatArray | float = 0.0,
    ) -> IntArray:
        """Add nodes.

        Args:
            nodes: Points (n, 3) [m].
            wall: Index of their wall, or -1.
            reach: Distances (n,) [m] down the wall.
            position: Positions (n,) around the wall.

        Returns:
            Indices (n,) of the nodes.
        """
        wall_values = np.column_stack(np.broadcast_arrays(np.full(len(nodes), wall), reach, position))
        self.nodes.append(np.column_stack([nodes, wall_values]))
        self._count += len(nodes)
        return np.arange(self._count - len(nodes), self._count)

    def join(self, triangles: IntArray, zone: int) -> None:
        """Add triangles (m, 3) of node indices."""
        self.triangles.append(triangles)
        self.zones.append(np.full(len(triangles), zone))

    def refine(self) -> tuple[FloatArray, IntArray, IntArray]:
        """Return nodes (n, 6), triangles (m, 3) and zones (m,), refined near the given points."""
        nodes, triangles = np.concatenate(self.nodes), np.concatenate(self.triangles).astype(np.int64)
        zones = np.concatenate(self.zones)
        if self.even:
            return nodes, triangles, zones

        def middle(first: FloatArray, second: FloatArray, adjacent: IntArray) -> FloatArray:
            """Return the nodes (k, 6) in the middles of edges, as `bisect` expects it.

            They are on the surface of the wall if a triangle of a wall is adjacent.
            """
            new = 0.5 * (first + second)
            new[:, 3] = np.where((zones[adjacent] == WALL).any(axis=1), first[:, 3], -1)
            around = second[:, 5] - first[:, 5]
            around -= POSITIONS_AROUND * np.round(around / POSITIONS_AROUND)
            new[:, 5] = (first[:, 5] + 0.5 * around) % POSITIONS_AROUND
            for number, wall in enumerate(self.walls):
                is_on_wall = new[:, 3] == number
                new[is_on_wall, :3] = wall.points(new[is_on_wall, 4], new[is_on_wall, 5])
            return new

        nodes, triangles, owner = bisect(nodes, triangles, self.size_at, middle)
        return nodes, triangles, zones[owner]


def _mesh_with_size(
    frame: shapely.Polygon, layout: _FlatRegion, size: float, near_size: float
) -> tuple[ShellMesh, int]:
    """Mesh a sheet with a given element size.

    Args:
        frame: Outline of the sheet.
        layout: Layout of the flange.
        size: Element size [m] of walls and floors.
        near_size: Element size [m] at the given points.

    Returns:
        The mesh, and the number of triangles before refinement near the given points.

    Raises:
        _UnfilledError: If elements of this size do not fit.
    """
    parts = _MeshParts(size, np.concatenate(list(_spots(layout))), near_size)
    tops = [_add_wall(wall, parts) for wall in layout.walls]
    corners = np.array(frame.exterior.coords[:-1])
    size_at, zone = _even(size), FLOOR
    if tops:
        holes = shapely.union_all([shapely.Polygon(points) for _, points in tops])

        def graded(distance: FloatArray) -> FloatArray:
            return np.minimum(size + GROWTH * distance, MAX_COARSENING * size)

        rim = _space_along(
            corners, size, lambda points: graded(shapely.distance(holes, shapely.points(points)))
        )
        size_at, zone = graded, FLANGE
    else:
        rim = _space_along(corners, size, lambda points: np.full(len(points), size))
    number = parts.add(np.column_stack([rim, np.full(len(rim), layout.height)]))
    _add_flat_region(_FlatOutline(frame, (number, rim), tops), layout, size_at, zone, parts)
    nodes, joined, zones = parts.refine()
    if _folded(nodes, joined).any():
        raise _UnfilledError(_FOLDS)
    return ShellMesh(nodes[:, :3], joined, zones), sum(map(len, parts.triangles))


_FOLDS = "a wall folds over between two rows; add contours or allow more triangles"


def _folded(nodes: FloatArray, triangles: IntArray) -> BoolArray:
    """Return whether each triangle (m,) is folded over: clockwise or without area as seen from above."""
    a, b, c = (nodes[triangles[:, k], :2] for k in range(3))
    return np.asarray((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] <= 0.0)


def _even(size: float) -> Callable[[FloatArray], FloatArray]:
    """Return a function from distances to element sizes that is ``size`` [m] everywhere."""
    return lambda distance: np.full_like(distance, size)


_Rim = tuple[IntArray, FloatArray]
"""Indices (n,) of the nodes along a rim, and their x, y (n, 2) [m]."""


def _add_wall(layout: _WallLayout, parts: _MeshParts) -> _Rim:
    """Add a wall and its floor to a mesh, and return the nodes of the wall's first row.

    Raises:
        _UnfilledError: If elements of this size do not fit.
    """
    rows, fixed = _rows(layout, parts.size)
    number = np.arange(POSITIONS_AROUND, dtype=np.float64)
    positions: list[FloatArray] = []
    numbers: list[IntArray] = []
    wall = parts.add_wall(layout)
    for reach, fixed_positions in zip(rows, fixed, strict=True):
        ends = np.unique(np.concatenate([layout.corners, fixed_positions]))
        row = layout.points(np.full(POSITIONS_AROUND, reach), number)
        positions.append(_row_positions(row, ends if len(ends) else np.zeros(1), parts.size))
        down = np.full(len(positions[-1]), reach)
        numbers.append(parts.add(layout.points(down, positions[-1]), wall, down, positions[-1]))
    first = len(parts.nodes) - len(rows)
    for k in range(len(rows) - 1):
        band = _band(positions[k], positions[k + 1], int(numbers[k][0]), int(numbers[k + 1][0]))
        band_nodes = np.concatenate(parts.nodes[first + k : first + k + 2])
        band_triangles = band - numbers[k][0]
        folded = band_triangles[_folded(band_nodes, band_triangles)]
        # refinement near given points may remove a fold; elsewhere it remains
        if len(folded) and np.isinf(parts.size_at(band_nodes[folded, :3].mean(axis=1))).any():
            raise _UnfilledError(_FOLDS)
        parts.join(band, WALL)
    top, last = parts.nodes[first][:, :2], parts.nodes[-1][:, :2]
    tops = [_add_wall(wall, parts) for wall in layout.floor.walls]
    outline = _FlatOutline(shapely.Polygon(last), (numbers[-1], last), tops)
    _add_flat_region(outline, layout.floor, _even(parts.size), FLOOR, parts)
    return numbers[0], top


@dataclasses.dataclass(frozen=True, eq=False)
class _FlatOutline:
    """Outlines of a flat region: its rim, and those of the walls on it.

    Attributes:
        region: Region within the rim.
        rim: Nodes along the rim.
        tops: First rows of the walls on the region.
    """

    region: shapely.Polygon
    rim: _Rim
    tops: Sequence[_Rim]


def _add_flat_region(
    outline: _FlatOutline,
    flat: _FlatRegion,
    size_at: Callable[[FloatArray], FloatArray],
    zone: int,
    parts: _MeshParts,
) -> None:
    """Add the nodes and triangles of a flat region between its outlines to a mesh.

    Args:
        outline: Outlines of the region, whose nodes already belong to the mesh.
        flat: Height and given points of the region.
        size_at: Function for the element sizes (d,) [m] at distances (d,) [m] from the walls on the region,
            or from its rim if there are none.
        zone: `FLANGE` or `FLOOR`.
        parts: The mesh.

    Raises:
        _UnfilledError: If elements of this size do not fit.
    """
    rim, tops = outline.rim, outline.tops
    numbers = np.concatenate([rim[0], *(number for number, _ in tops)])
    around = np.concatenate([rim[1], *(points for _, points in tops)])
    holes = shapely.union_all([shapely.Polygon(points) for _, points in tops]) if tops else None
    points, triangles = _fill(outline.region, around, flat.fixed, size_at, holes)
    new = points[len(around) :]
    numbers = np.concatenate([numbers, parts.add(np.column_stack([new, np.full(len(new), flat.height)]))])
    parts.join(numbers[triangles], zone)


def _space_along(
    polygon: FloatArray, min_spacing: float, size_at: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Return points (p, 2) [m] along a closed polygon, including its corners.

    Args:
        polygon: Corners (k, 2) [m].
        min_spacing: Minimum distance [m] between points.
        size_at: Requested distance (n,) [m] at points (n, 2).
    """
    side = np.roll(polygon, -1, axis=0) - polygon
    side_length = lengths(side)
    sample_counts = np.clip(np.ceil(_SIZE_SAMPLES * side_length / min_spacing), 8, 200).astype(np.int64) + 1
    fractions_by_side = [np.linspace(0.0, 1.0, count) for count in sample_counts]
    points = np.repeat(polygon, sample_counts, axis=0) + np.concatenate(fractions_by_side)[
        :, None
    ] * np.repeat(side, sample_counts, axis=0)
    sizes = np.split(size_at(points), np.cumsum(sample_counts)[:-1])
    parts = []
    for start, step, length, fractions, size in zip(
        polygon, side, side_length, fractions_by_side, sizes, strict=True
    ):
        density = length / size
        cumulative = np.concatenate(
            [[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fractions))]
        )
        count = max(2, round(cumulative[-1]))
        node_fractions = np.interp(np.arange(count) * cumulative[-1] / count, cumulative, fractions)
        parts.append(start + node_fractions[:, None] * step)
    return np.concatenate(parts)


def _fill(
    region: shapely.Polygon,
    rim: FloatArray,
    fixed: FloatArray,
    size_at: Callable[[FloatArray], FloatArray],
    hole: shapely.Geometry | None,
) -> tuple[FloatArray, IntArray]:
    """Triangulate a flat region with rows around its holes, or along its rim if there are none.

    Rows of points are laid at growing distances until they leave the region. Points keep enough distance from
    the rim that its edges are triangle edges. Delaunay triangles are kept if they lie in the region. Their
    areas must add up to its area, and each point must belong to one.

    Args:
        region: Region within the outer rim.
        rim: Points (n, 2) [m] on the outer rim and around the holes.
        fixed: Points (f, 2) [m] that become nodes.
        size_at: Function for the element sizes (d,) [m] at distances (d,) [m] from the holes, or from the
            rim.
        hole: Union of the holes of the region, or None.

    Returns:
        Points (p, 2) [m] in the order ``rim``, ``fixed``, others, and triangles (m, 3).

    Raises:
        _UnfilledError: If the region cannot be filled.
    """
    border = region.exterior
    shapely.prepare(region)
    shapely.prepare(border)
    points = [rim, fixed]
    taken = cKDTree(np.concatenate(points))
    distance = 0.0
    across = float(np.hypot(*np.subtract(region.bounds[2:], region.bounds[:2])))
    for row in range(_MAX_ROWS):
        distance += _ROW * float(size_at(np.array([distance]))[0])
        if hole is None:
            shape = region.buffer(-distance, join_style="mitre")
        else:
            shape = hole.buffer(distance, quad_segs=32)
        if shape.is_empty or distance > across:
            break
        size = float(size_at(np.array([distance]))[0])
        # where rows around several holes meet, the parts of the shape have holes, hence all rings
        rings = shapely.get_rings(shapely.get_parts(shape))
        loops = [shapely.get_coordinates(ring)[:-1] for ring in rings]
        # every other row is shifted by half a step, as in equilateral triangles
        new = np.concatenate([_loop(loop, size, 0.5 * (row % 2)) for loop in loops])
        new = new[shapely.contains_xy(region, new[:, 0], new[:, 1])]
        new = new[~shapely.dwithin(border, shapely.points(new), _MIN_SPACING_RATIO * size)]
        new = new[taken.query(new)[0] > _MIN_SPACING_RATIO * size] if len(new) else new
        if len(new):
            points.append(_thin_out(new, _MIN_SPACING_RATIO * size))
            taken = cKDTree(np.concatenate(points))
    whole = np.concatenate(points)
    triangles = Delaunay(whole).simplices.astype(np.int64)
    a, b, c = (whole[triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    triangles = np.where((area < 0.0)[:, None], triangles[:, ::-1], triangles)
    area, middle = np.abs(area), (a + b + c) / 3.0
    kept = (area > _SLIVER * dots(b - a, b - a)) & shapely.contains_xy(region, middle[:, 0], middle[:, 1])
    region_area = region.area
    if hole is not None:
        kept &= ~shapely.contains_xy(hole, middle[:, 0], middle[:, 1])
        region_area -= hole.area
    used = np.unique(triangles[kept])
    if abs(float(area[kept].sum()) - region_area) > 1e-6 * region_area or len(used) < len(whole):
        raise _UnfilledError(
            "a flat region cannot be filled with elements of this size; allow more triangles"
        )
    return whole, triangles[kept]


def _loop(loop: FloatArray, size: float, shift: float) -> FloatArray:
    """Return evenly spaced points (p, 2) [m] along a closed line, from ``shift`` steps after its start on.

    They are about ``size`` [m] apart. There are at least 3 points.
    """
    along = np.concatenate([[0.0], np.cumsum(lengths(np.roll(loop, -1, axis=0) - loop))])
    count = max(3, round(along[-1] / size))
    query = (np.arange(count) + shift) / count * along[-1]
    closed = np.concatenate([loop, loop[:1]])
    return np.column_stack([np.interp(query, along, closed[:, axis]) for axis in range(2)])


def _thin_out(points: FloatArray, min_distance: float) -> FloatArray:
    """Return the points without those closer than ``min_distance`` [m] to an earlier one that is kept."""
    pairs = cKDTree(points).query_pairs(min_distance, output_type="ndarray")
    keep: BoolArray = np.ones(len(points), dtype=bool)
    for i, j in pairs[np.lexsort(pairs.T[::-1])]:
        if keep[i]:
            keep[j] = False
    return points[keep]
