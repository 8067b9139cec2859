"""Springback at one point, recalculated on a mesh of the proof's own.

The sheet while a point is formed follows from the claimed faces: previous features complete, the pass's own
face down to the point's level, and earlier shapes of the feature where they are deeper. Points are on
contours of these faces, cut here, and on grids that are fine at the tool and coarse far away; Delaunay
triangulation joins them. Membranes are constant strain triangles, whereas the planner's have drilling
freedoms. Common with the planner are the bending of the elements, the corotational frame and the equilibrium
search (`planner.shell`), which are validated with plates, cones and CalculiX.
"""

import dataclasses

import numpy as np
import shapely
from scipy.spatial import Delaunay, cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.proof.formed_shapes import FormedShape, PartShapes
from planner.shell.element import ShellSheet
from planner.shell.newton import LimitLoadError, Loading, clamped, pressure_weights

FINE_SPACING_M = 1.5e-3
"""Spacing [m] of the points where the tool presses."""
COARSE_SPACING_M = 7e-3
"""Maximum spacing [m] of the points."""
FINE_REACH_M = 6e-3
"""Distance [m] from the tool up to which points are fine."""
SPACING_GROWTH = 0.13
"""Growth of the spacing per distance from there."""
PROFILE_CONTOURS = 41
"""Number of contours from which a wall's profile is read."""
MAX_PROFILE_TURN_RAD, MAX_CONTOUR_DISTANCE_M = np.deg2rad(20.0), 4e-3
"""A contour is kept where the profile has turned by the angle [rad], or advanced by the distance [m]
in plan.
"""
MAX_CONTOURS = 16
"""Maximum number of contours of a wall, except the first."""
MIN_DISTANCE_FRACTION = 0.65
"""Points are nearer to each other than this fraction of the spacing only on edges."""
CONTOUR_SPACING_FACTOR = 2.0
"""Maximum spacing of the points of a contour, as a multiple of the distance of the contours in plan: then
most edges of triangles run along the contour.
"""
EDGE_OFFSET_M = 2e-5
"""Distance [m] inside its edges at which a wall is cut."""
MIN_DEPTH_M = 1e-4
"""Depth [m] below which sheet counts as flat."""
LOAD_FRACTIONS = np.array([0.4, 0.7, 1.0])
"""Load steps up to the required load, as fractions of it."""
COARSENING_FACTORS = np.array([1.0, 1.3, 1.7, 2.2])
"""Factors by which points are farther apart, until there are few enough."""
MAX_POINTS, MAX_POINTS_FINER = 2_200, 4_500
"""Points of a mesh, unless the coarsest has more: two seconds of a processor; and the number where that is
insufficient.
"""
PRESSED_WIDTH_M = 3e-3
"""Width [m] of the square on which the tool presses."""


@dataclasses.dataclass(frozen=True)
class ClampedSheet:
    """A flat sheet in its clamp.

    Attributes:
        thickness: Thickness [m].
        young: Young's modulus [Pa].
        poisson: Poisson's ratio.
        opening: Convex opening (K, 2) [m].
        border: Stiffness [N/m^2] of the border, 0 if it slides, infinite if it does not move.
    """

    thickness: float
    young: float
    poisson: float
    opening: FloatArray
    border: float


@dataclasses.dataclass(frozen=True)
class PartlyFormedSheet:
    """The sheet while a shape of a feature is formed down to a depth.

    Attributes:
        part: Shapes of the part.
        feature: Index of the feature.
        number: Number of the shape.
        depth: Depth [m].
    """

    part: PartShapes
    feature: int
    number: int
    depth: float

    @property
    def shapes(self) -> tuple[FormedShape, ...]:
        """The feature's shapes up to the one that is formed."""
        return self.part.features[self.feature].shapes[: self.number + 1]

    @property
    def sign(self) -> float:
        """-1 if the feature goes down, +1 if it goes up."""
        return -1.0 if self.shapes[-1].end_level < self.shapes[-1].base else 1.0

    def height(self, plan: FloatArray) -> FloatArray:
        """Return the height (N,) [m] of the sheet's lower face at points in plan (N, 2)."""
        displacement = np.minimum(np.maximum(self.sign * self.shapes[-1].displacement(plan), 0.0), self.depth)
        for earlier in self.shapes[:-1]:
            displacement = np.maximum(displacement, self.sign * earlier.displacement(plan))
        return self.part.sheet_height(np.arange(self.feature), plan) + self.sign * displacement

    def contour_edges(self) -> list[tuple[FloatArray, float]]:
        """Return contours of all walls of the sheet in plan, on which the mesh has points.

        Returns:
            For each contour its edges (M, 2, 2) [m], and the approximate distance [m] in plan to the adjacent
            contours of its wall.
        """
        previous_shapes = (feature.final for feature in self.part.features[: self.feature])
        walls = [(shape, abs(shape.end_level - shape.base), 0.0) for shape in previous_shapes]
        walls.append((self.shapes[-1], self.depth, 0.0))
        # of earlier shapes of this feature only the walls below the current depth remain
        walls += [
            (shape_before, abs(shape_before.end_level - shape_before.base), self.depth)
            for shape_before in self.shapes[:-1]
        ]
        out: list[tuple[FloatArray, float]] = []
        for shape, end, start in walls:
            if end - start > MIN_DEPTH_M:
                out += _wall_contours(shape, start, min(end, abs(shape.end_level - shape.base)))
        return out

    def thickness_fraction(self, plan: FloatArray) -> FloatArray:
        """Return the fraction (N,) of the flat thickness that earlier shapes leave, by the sine law."""
        out = np.ones(len(plan))
        for earlier in self.shapes[:-1]:
            row, triangle, _ = earlier.lookup.locate(plan, 1e-7)
            corners = earlier.corners[earlier.moved][triangle]
            np.minimum.at(out, row, _normal_cosine(corners))
        return out


def _normal_cosine(corners: FloatArray) -> FloatArray:
    """Return the cosines (M,) of the angles of triangles (M, 3, 3) to the flat."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.abs(cross[:, 2]) / np.maximum(np.linalg.norm(cross, axis=1), 1e-300))


def _wall_contours(shape: FormedShape, start: float, end: float) -> list[tuple[FloatArray, float]]:
    """Return contours of a wall between two depths [m] from its starting level, on which the mesh has points.

    `PROFILE_CONTOURS` contours are evaluated. As many are kept as the turns of the profile and its length in
    plan require. The result is empty if any contour is empty.

    Args:
        shape: Shape with the wall.
        start: Depth [m] at which the contours start, downward or upward as the shape goes.
        end: Depth [m] at which they end.

    Returns:
        For each contour its edges (M, 2, 2) [m] in plan, and its distance [m] in plan from adjacent contours.
    """
    sign = -1.0 if shape.end_level < shape.base else 1.0
    edge = min(EDGE_OFFSET_M, 0.05 * (end - start))
    fraction = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, PROFILE_CONTOURS))  # denser near both edges
    depth = start + edge + fraction * (end - start - 2.0 * edge)
    contours = [_contour_edges(shape, sign * level) for level in depth.tolist()]
    if any(not len(contour) for contour in contours):
        return []
    first = cKDTree(contours[0].reshape(-1, 2))
    across = np.array([float(np.median(first.query(contour.reshape(-1, 2))[0])) for contour in contours])
    across = np.maximum.accumulate(across) + 1e-9 * np.arange(PROFILE_CONTOURS)
    angle = np.arctan2(np.diff(depth), np.diff(across))
    angle_change = np.concatenate([[0.0], np.abs(np.diff(angle)), [0.0]])
    # number of contours that are needed up to each one; those nearest to whole numbers are kept
    number = np.cumsum(angle_change / MAX_PROFILE_TURN_RAD) + across / MAX_CONTOUR_DISTANCE_M
    count = int(np.clip(np.ceil(number[-1]), 1, MAX_CONTOURS))
    chosen = np.unique(np.abs(number[:, None] - np.linspace(0.0, number[-1], count + 1)).argmin(axis=0))
    gap = np.maximum(np.diff(across[chosen]), 0.25 * FINE_SPACING_M)
    distance = np.minimum(np.append(gap[0], gap), np.append(gap, gap[-1]))
    return [(contours[k], float(spacing)) for k, spacing in zip(chosen, distance, strict=True)]


def _contour_edges(shape: FormedShape, depth: float) -> FloatArray:
    """Return the edges (M, 2, 2) [m] in plan of the contour of a face.

    The contour is at the height ``depth`` [m] above the base of the face.
    """
    corners = shape.corners[shape.moved]
    height = corners[:, :, 2] - shape.base - depth
    crossed = (height > 0.0).any(axis=1) & (height <= 0.0).any(axis=1)
    corners, height = corners[crossed], height[crossed]
    ends = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        is_crossed = (height[:, i] > 0.0) != (height[:, j] > 0.0)
        fraction = np.where(
            is_crossed, height[:, i] / np.where(is_crossed, height[:, i] - height[:, j], 1.0), 0.0
        )
        ends.append(
            (is_crossed, corners[:, i, :2] + fraction[:, None] * (corners[:, j, :2] - corners[:, i, :2]))
        )
    is_crossed = np.stack([crossing for crossing, _ in ends], axis=1)
    points = np.stack([point for _, point in ends], axis=1)
    order = np.argsort(~is_crossed, axis=1, kind="stable")[:, :2]  # exactly two edges of each are crossed
    return np.take_along_axis(points, order[:, :, None], axis=1)


def _point_spacing(plan: FloatArray, tool_point: FloatArray, fine: float) -> FloatArray:
    """Return the required spacing (N,) [m] of mesh points at positions in plan (N, 2).

    It is ``fine`` [m] around the tool and grows with the distance from it.
    """
    away = np.linalg.norm(plan - tool_point, axis=1) - FINE_REACH_M
    return np.asarray(np.clip(fine + SPACING_GROWTH * away, fine, COARSE_SPACING_M / FINE_SPACING_M * fine))


def _mesh_points(
    formed: PartlyFormedSheet, opening: FloatArray, tool_point: FloatArray, fine: float = FINE_SPACING_M
) -> FloatArray:
    """Return the points (N, 2) [m] in plan of a mesh, with spacing ``fine`` [m] at the tool.

    They are on the edge of the opening, at the tool, on contours of the walls, and on square grids whose
    spacing doubles with the distance from the tool.
    """
    outline = shapely.Polygon(opening)
    rim = []
    for corner, next_corner in zip(opening, np.roll(opening, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(next_corner - corner) / COARSE_SPACING_M)))
        rim.append(corner + (next_corner - corner) * (np.arange(count) / count)[:, None])
    fixed = np.concatenate(rim)
    kept = [fixed, tool_point[None]]
    for edges, gap in formed.contour_edges():
        kept += [
            _resample(line, tool_point, CONTOUR_SPACING_FACTOR * gap * fine / FINE_SPACING_M, fine)
            for line in _polylines(edges)
        ]
    points = np.concatenate(kept)
    points = points[_drop_duplicates(points, 0.2 * fine)]
    size = float(np.abs(opening - tool_point).max())
    spacing, grids = fine, []
    while spacing <= COARSE_SPACING_M / FINE_SPACING_M * fine:
        count = int(np.ceil(size / spacing))
        axis = np.arange(-count, count + 1) * spacing
        x, y = np.meshgrid(tool_point[0] + axis, tool_point[1] + axis)
        grid = np.column_stack([x.ravel(), y.ravel()])
        spacing_at = _point_spacing(grid, tool_point, fine)
        grid = grid[(spacing_at >= spacing) & (spacing_at < 2.0 * spacing)]
        grid = grid[shapely.contains_xy(outline.buffer(-0.5 * spacing), grid[:, 0], grid[:, 1])]
        grids.append(grid)
        spacing *= 2.0
    free = np.concatenate(grids)
    distance = cKDTree(points).query(free)[0]
    return np.concatenate(
        [points, free[distance > MIN_DISTANCE_FRACTION * _point_spacing(free, tool_point, fine)]]
    )


def _polylines(edges: FloatArray) -> list[FloatArray]:
    """Join edges (M, 2, 2) [m] that share ends to polylines (K, 2)."""
    if not len(edges):
        return []
    joined = shapely.line_merge(shapely.multilinestrings(shapely.linestrings(np.round(edges, 8))))
    return [shapely.get_coordinates(line) for line in shapely.get_parts(joined)]


def _resample(line: FloatArray, tool_point: FloatArray, max_spacing: float, fine: float) -> FloatArray:
    """Return points (N, 2) [m] of a polyline (K, 2) [m] at the required spacing.

    The spacing is at most ``max_spacing`` [m].
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    dense = np.linspace(0.0, arc[-1], max(2, int(np.ceil(arc[-1] / (0.3 * fine)))))
    points = np.stack([np.interp(dense, arc, line[:, k]) for k in (0, 1)], axis=1)
    need = np.minimum(_point_spacing(points, tool_point, fine), max_spacing)
    number = np.concatenate([[0.0], np.cumsum(np.diff(dense) * 0.5 * (1.0 / need[1:] + 1.0 / need[:-1]))])
    sample_number = np.linspace(0.0, number[-1], max(2, int(np.ceil(number[-1])) + 1))
    return np.stack([np.interp(sample_number, number, points[:, k]) for k in (0, 1)], axis=1)


def _drop_duplicates(points: FloatArray, within: float) -> IntArray:
    """Return the indices of those points (N, 2) that remain without duplicates.

    A point is dropped if an earlier one is within a distance [m].
    """
    close_pairs = cKDTree(points).query_pairs(within, output_type="ndarray")
    return np.setdiff1d(np.arange(len(points)), close_pairs.max(axis=1, initial=-1))


def springback_at(
    formed: PartlyFormedSheet,
    sheet: ClampedSheet,
    point: FloatArray,
    force: float,
    max_points: int = MAX_POINTS,
) -> tuple[float, int]:
    """Return the springback at a point when a force is released, from a shell model of the sheet.

    The proof compares it with the springback that a file states. The mesh is coarsened until it has at most
    ``max_points`` points.

    Args:
        formed: Sheet while the point is formed.
        sheet: Flat sheet in its clamp.
        point: Position (2,) [m] in plan.
        force: Force [N] in the direction of the feature.
        max_points: Maximum number of points, unless the coarsest mesh has more.

    Returns:
        Springback [m], infinite if there is no equilibrium, and the number of triangles.

    Raises:
        ValueError: If the point is not on the sheet, or the mesh or a value of ``sheet`` is invalid.
    """
    for fine in FINE_SPACING_M * COARSENING_FACTORS:
        points = _mesh_points(formed, sheet.opening, point, float(fine))
        if len(points) <= max_points:
            break
    triangles = np.asarray(Delaunay(points).simplices, dtype=np.int64)
    corners = points[triangles]
    edge_a, edge_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double_area = edge_a[:, 0] * edge_b[:, 1] - edge_a[:, 1] * edge_b[:, 0]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    # Delaunay triangulation leaves slivers along straight rows of points
    is_sound = np.abs(double_area) > 1e-3 * longest**2
    triangles = np.where((double_area < 0.0)[:, None], triangles[:, [0, 2, 1]], triangles)[is_sound]
    used, index = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], np.asarray(index).reshape(-1, 3)
    nodes = np.column_stack([points, formed.height(points)])
    # sine law: thickness over flat thickness is the cosine of the steepest wall angle so far
    thickness_ratio = np.minimum(
        _normal_cosine(nodes[triangles]), formed.thickness_fraction(points[triangles].mean(axis=1))
    )
    elastic = ShellSheet(
        nodes, triangles, sheet.thickness * thickness_ratio, sheet.young, sheet.poisson, "constant strain"
    )
    border: str | float = sheet.border
    border = "sliding" if border == 0.0 else "immovable" if np.isinf(sheet.border) else border
    direction = np.array([0.0, 0.0, formed.sign])
    pressed_point = np.append(point, 0.0)
    try:
        weights = pressure_weights(elastic, pressed_point, PRESSED_WIDTH_M)
        displacement = Loading(elastic, clamped(elastic, border)).curve(
            weights, (force * LOAD_FRACTIONS)[:, None] * direction
        )
    except LimitLoadError:
        return np.inf, len(triangles)
    return float(displacement[-1] @ direction), len(triangles)
