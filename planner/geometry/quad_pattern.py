"""A pattern of quads on a surface that is laid out along conjugate directions.

Lines of a grid divide the layout. A corner of the grid near the rim is moved onto it, so that there are no
slivers and most panels on the rim have four sides, too. Others have three or five.

The grid's size, the ratio of its sides and its origin are searched for the requested count and the fewest
moved corners. Each panel of the grid counts, so a surface whose rim follows the lines has whole rows, and the
count is the nearest product.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np
import shapely
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.conjugate_field import SurfaceLayout
from planner.geometry.curves import turning_angles
from planner.geometry.panel_pattern import RIM, RIM_CORNER_RAD, PanelPattern, PatternError
from planner.geometry.rulings import boundary_rings

OUT: Final = 0
"""Corners of the grid outside the surface."""
ON: Final = 1
"""Corners of the grid that are moved onto the rim."""
IN: Final = 2
"""Corners of the grid within the surface."""
_RIM_SNAP_FRACTION: Final = 0.42
"""Distance from the rim within which corners of the grid are moved onto it, per cell side."""
_CORNER_SNAP_FRACTION: Final = 0.85
"""Distance from a corner of the rim within which a corner of the grid is moved onto it, per cell side."""
_LOG_SIZE_STEP: Final = 0.025
"""Step of the logarithm of a cell's size, so that close counts try the same sizes."""
_SIZE_STEPS: Final = 8
"""Number of steps smaller and larger than the nominal size."""
_RATIOS: Final = (1.0, 0.93, 1.08, 0.86, 1.16)
"""Ratios of sides that are tried."""
_PHASES: Final = (0.0, 0.25, 0.5, 0.75)
"""Offsets of the grid's lines from the middle that are tried [cells]."""
_WIDTH_FACTOR: Final = 1.15
"""Factor on the minimum width: backs are smaller, and corners move."""
_MAX_PATTERNS: Final = 40
"""Maximum number of grids that are made into patterns, the best first, until one covers the surface."""
_UNEVEN_COST: Final = 0.3
"""Cost of a panel of three or five sides. A corner moved by a cell costs 1."""
_MIN_FILL: Final = 0.5
"""Panels with all corners on the rim fill more than half this fraction of their bounding box."""
_UNCOVERED_FRACTION: Final = 0.15
"""Half the maximum width of uncovered parts of the surface, per cell side."""


@dataclasses.dataclass(frozen=True)
class _Domain:
    """A layout's outline.

    Attributes:
        area: Its area.
        rim: Points on its rim (R, 2).
        tree: Search tree of these points.
        corners: Corners of the rim (C, 2).
    """

    area: shapely.Polygon
    rim: FloatArray
    tree: KDTree
    corners: FloatArray


@dataclasses.dataclass(frozen=True)
class _Grid:
    """A grid over the layout.

    Attributes:
        side: Sides of a cell (2,).
        corners: Corners (A, B, 2).
        moved_corners: Positions to which they are moved (A, B, 2).
        kind: `OUT`, `ON` or `IN` (A, B).
        cells: Cells that are panels (A - 1, B - 1).
        cost: Cost of moved corners and of panels without four sides.
    """

    side: FloatArray
    corners: FloatArray
    moved_corners: FloatArray
    kind: IntArray
    cells: BoolArray
    cost: float


def quad_pattern(layout: SurfaceLayout, count: int, least_width: float = 0.0) -> PanelPattern:
    """Return panels of a surface by its layout, as near to ``count`` as whole cells of a grid permit.

    Args:
        layout: Layout of the surface.
        count: Number of panels.
        least_width: Minimum width of panels [m]. Grids with narrower ones are used only if there are no
            others.

    Raises:
        PatternError: The layout folds, or the surface is narrower than its panels.
    """
    domain = _domain(layout)
    log_size = round(0.5 * float(np.log(domain.area.area / count)) / _LOG_SIZE_STEP)
    steps = range(log_size - _SIZE_STEPS, log_size + _SIZE_STEPS + 1)
    candidates: list[tuple[int, float, int, _Grid]] = []
    for step, ratio, p, q in itertools.product(steps, _RATIOS, _PHASES, _PHASES):
        side = np.exp(_LOG_SIZE_STEP * step) * np.array([np.sqrt(ratio), 1.0 / np.sqrt(ratio)])
        grid = _grid(domain, side, (p, q))
        candidates.append((abs(int(grid.cells.sum()) - count), grid.cost, len(candidates), grid))
    patterns: list[tuple[float, PanelPattern]] = []
    error: PatternError | None = None
    for *_, grid in sorted(candidates, key=lambda row: row[:3])[:_MAX_PATTERNS]:
        try:
            pattern = _pattern(layout, domain, grid)
        except PatternError as pattern_error:
            error = error or pattern_error
            continue
        patterns.append((min(_least_width(pattern.position[ring]) for ring in pattern.ring), pattern))
        if patterns[-1][0] >= _WIDTH_FACTOR * least_width:
            return pattern
    if patterns:
        return max(patterns, key=lambda width_and_pattern: width_and_pattern[0])[1]
    raise error or PatternError("the surface has no room for panels with four sides: request more panels")


def _least_width(ring: FloatArray) -> float:
    """Return the least width [m] of a panel, which is its smallest height above one of its sides."""
    side = np.roll(ring, -1, axis=0) - ring
    offsets = ring[None] - ring[:, None]
    heights = np.linalg.norm(np.cross(side[:, None], offsets), axis=2)
    return float((heights.max(axis=1) / np.maximum(np.linalg.norm(side, axis=1), 1e-9)).min())


def _domain(layout: SurfaceLayout) -> _Domain:
    """Return the outline of a layout. Raises `PatternError` if the layout folds or overlaps itself."""
    mesh = layout.surface.mesh
    if len(folded := layout.folded_faces()):
        raise PatternError(
            f"lines of panels cross near {_format_mm(mesh.vertices[mesh.faces[folded[0]]].mean(axis=0))}"
        )
    rings = boundary_rings(mesh)
    outlines = [layout.coordinates[ring] for ring in rings]
    size = [shapely.Polygon(line).area for line in outlines]
    outer = int(np.argmax(size))
    area = shapely.Polygon(outlines[outer], [line for k, line in enumerate(outlines) if k != outer])
    if not area.is_valid:
        # GEOS says where, as in Self-intersection[1.5 2]
        at = np.array([[float(v) for v in shapely.is_valid_reason(area).split("[")[1].rstrip("]").split()]])
        position_text = _format_mm(_surface_points(layout, at)[0])
        raise PatternError(f"the layout along the lines of panels overlaps itself near {position_text}")
    shapely.prepare(area)
    corners = [
        line[np.flatnonzero(turning_angles(mesh.vertices[ring], True) > RIM_CORNER_RAD)]
        for ring, line in zip(rings, outlines, strict=True)
    ]
    step = 0.05 * layout.surface.spacing
    rim_points = shapely.get_coordinates(shapely.segmentize(area.boundary, step))
    return _Domain(area, rim_points, KDTree(rim_points), np.concatenate(corners))


def _grid(domain: _Domain, side: FloatArray, phase: tuple[float, float]) -> _Grid:
    """Return a grid over the layout, with corners near the rim moved onto it.

    ``side`` (2,) are the sides of a cell, ``phase`` the offset of a line from the layout's middle [cells].
    """
    low, high = domain.rim.min(axis=0), domain.rim.max(axis=0)
    middle = 0.5 * (low + high) + np.array(phase) * side
    first, last = np.floor((low - middle) / side - 0.5), np.ceil((high - middle) / side + 0.5)
    u, v = (middle[k] + side[k] * np.arange(first[k], last[k] + 1.0) for k in range(2))
    corners = np.stack(np.meshgrid(u, v, indexing="ij"), axis=2)
    flat = corners.reshape(-1, 2)
    kind = np.where(shapely.contains_xy(domain.area, flat[:, 0], flat[:, 1]), IN, OUT)
    rim_distance, nearest = domain.tree.query(flat)
    shorter_side = float(side.min())
    is_on_rim = np.asarray(rim_distance < _RIM_SNAP_FRACTION * shorter_side)
    moved_corners = np.where(is_on_rim[:, None], domain.rim[nearest], flat)
    if len(domain.corners):
        # each corner of the rim takes the corner of the grid that is nearest to it
        corner_distance = np.linalg.norm(flat[:, None] - domain.corners, axis=2)
        nearest_corner = corner_distance.argmin(axis=0)
        for k in np.flatnonzero(corner_distance.min(axis=0) < _CORNER_SNAP_FRACTION * shorter_side).tolist():
            is_on_rim[nearest_corner[k]] = True
            moved_corners[nearest_corner[k]] = domain.corners[k]
    kind[is_on_rim] = ON
    kind, moved_corners = kind.reshape(corners.shape[:2]), moved_corners.reshape(corners.shape)
    ring = np.stack([kind[:-1, :-1], kind[1:, :-1], kind[1:, 1:], kind[:-1, 1:]], axis=2)
    crossing_count = ((ring == IN) & (np.roll(ring, -1, axis=2) == OUT)).sum(axis=2)
    crossing_count += ((ring == OUT) & (np.roll(ring, -1, axis=2) == IN)).sum(axis=2)
    knots = (ring > OUT).sum(axis=2) + crossing_count
    cells = (knots >= 3) & ((ring == IN).any(axis=2) | _has_surface_between(domain, ring, moved_corners))
    displacement = np.linalg.norm(moved_corners - corners, axis=2) / shorter_side
    is_used = np.zeros(kind.shape, dtype=np.bool_)
    for i, j in itertools.product((0, 1), (0, 1)):
        is_used[i : i + cells.shape[0], j : j + cells.shape[1]] |= cells
    cost = float((displacement[is_used] ** 2).sum() + _UNEVEN_COST * (cells & (knots != 4)).sum())
    return _Grid(side, corners, moved_corners, kind, cells, cost)


def _has_surface_between(domain: _Domain, ring: IntArray, moved_corners: FloatArray) -> BoolArray:
    """Return cells (A, B) whose corners on the rim have part of the surface between them.

    Args:
        domain: Outline of the layout.
        ring: Kinds of the cells' corners (A, B, 4).
        moved_corners: Positions of the grid's corners.
    """
    corner = np.stack(
        [moved_corners[:-1, :-1], moved_corners[1:, :-1], moved_corners[1:, 1:], moved_corners[:-1, 1:]],
        axis=2,
    )
    is_on_rim = (ring == ON)[..., None]
    middle = (corner * is_on_rim).sum(axis=2) / np.maximum(is_on_rim.sum(axis=2), 1)
    # corners off the surface count as the ones before them
    corner = np.where(is_on_rim, corner, np.roll(corner, 1, axis=2))
    following = np.roll(corner, -1, axis=2)
    double_area = (corner[..., 0] * following[..., 1] - corner[..., 1] * following[..., 0]).sum(axis=2)
    size = np.ptp(corner[..., 0], axis=2) * np.ptp(corner[..., 1], axis=2)
    within = shapely.contains_xy(domain.area, middle[..., 0], middle[..., 1])
    return np.asarray(within & (double_area > _MIN_FILL * size))


def _pattern(layout: SurfaceLayout, domain: _Domain, grid: _Grid) -> PanelPattern:
    """Return the panels of a grid. Knots are its corners, and its lines' crossings with the rim."""
    knots: dict[tuple[int, ...], int] = {}
    positions: list[FloatArray] = []

    def knot(key: tuple[int, ...], at: FloatArray) -> int:
        """Return the number of the knot at a corner, or between two corners, which is added if it is new."""
        if key not in knots:
            knots[key] = len(positions)
            positions.append(at)
        return knots[key]

    rings: list[list[int]] = []
    panel_of_cell: dict[tuple[int, int], int] = {}
    for i, j in np.argwhere(grid.cells).tolist():
        ring: list[int] = []
        cell_corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        for start, end in zip(cell_corners, [*cell_corners[1:], cell_corners[0]], strict=True):
            if grid.kind[start] != OUT:
                ring.append(knot((*start, 0, 0), grid.moved_corners[start]))
            if {int(grid.kind[start]), int(grid.kind[end])} == {IN, OUT}:
                a, b = (start, end) if grid.kind[start] == IN else (end, start)
                ring.append(knot((*a, *b), _crossing(domain, grid.corners[a], grid.corners[b])))
        panel_of_cell[i, j] = len(rings)
        rings.append(ring)
    corner = _mark_corners(domain, grid, panel_of_cell, rings, positions)
    rings = _trimmed(rings, corner)
    _check_covered(layout, domain, grid, rings, positions)
    beyond = {
        (a, b): p for p, ring in enumerate(rings) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
    }
    across = [
        np.array([beyond.get((b, a), RIM) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)])
        for ring in rings
    ]
    panels: list[list[int]] = [[] for _ in positions]
    for p, ring in enumerate(rings):
        for k in ring:
            panels[k].append(p)
    padded = np.array([[*cells, *[-1] * (4 - len(cells))] for cells in panels], dtype=np.int64)
    return PanelPattern(
        _surface_points(layout, np.array(positions)),
        padded,
        tuple(np.array(r, dtype=np.int64) for r in rings),
        tuple(across),
        corner,
        True,
    )


def _crossing(domain: _Domain, inside: FloatArray, outside: FloatArray) -> FloatArray:
    """Return the point nearest to ``inside`` at which the line to ``outside`` crosses the rim."""
    line = shapely.LineString([inside, outside]).intersection(domain.area.boundary)
    crossings = shapely.get_coordinates(line)
    return (
        crossings[int(np.argmin(np.linalg.norm(crossings - inside, axis=1)))] if len(crossings) else outside
    )


def _mark_corners(
    domain: _Domain,
    grid: _Grid,
    panel_of_cell: dict[tuple[int, int], int],
    rings: list[list[int]],
    positions: list[FloatArray],
) -> BoolArray:
    """Add corners of the rim within a cell to its panel, and return which knots (K,) are corners."""
    for at in domain.corners:
        if min(np.linalg.norm(at - position) for position in positions) < 1e-9:
            continue
        cell = np.floor((at - grid.corners[0, 0]) / grid.side).astype(np.int64)
        panel = panel_of_cell.get((int(cell[0]), int(cell[1])))
        if panel is None:
            continue
        ring = rings[panel]
        # between the two knots where it lengthens the outline least
        detours = [
            np.linalg.norm(at - positions[a])
            + np.linalg.norm(at - positions[b])
            - np.linalg.norm(positions[a] - positions[b])
            for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
        ]
        ring.insert(int(np.argmin(detours)) + 1, len(positions))
        positions.append(at)
    knots = np.array(positions)
    if not len(domain.corners):
        return np.zeros(len(knots), dtype=np.bool_)
    return np.asarray(np.linalg.norm(knots[:, None] - domain.corners, axis=2).min(axis=1) < 1e-9)


def _trimmed(rings: list[list[int]], corner: BoolArray) -> list[list[int]]:
    """Return rings without knots of one panel alone, except at corners of the rim."""
    count = np.bincount(np.concatenate([np.array(ring) for ring in rings]), minlength=len(corner))
    needed = (count > 1) | corner
    shortened = [[k for k in ring if needed[k]] for ring in rings]
    return [new if len(new) > 2 else old for new, old in zip(shortened, rings, strict=True)]


def _check_covered(
    layout: SurfaceLayout, domain: _Domain, grid: _Grid, rings: list[list[int]], positions: list[FloatArray]
) -> None:
    """Raise a `PatternError` if a panel crosses itself or is inverted, or a part of the surface is bare."""
    panels = [shapely.Polygon([positions[k] for k in ring]) for ring in rings]
    faulty = [p for p in panels if not (p.is_valid and p.exterior.is_ccw)]
    bare = domain.area.difference(shapely.union_all([p for p in panels if p.is_valid]))
    bare = bare.buffer(-_UNCOVERED_FRACTION * float(grid.side.min()))
    fault = faulty[0].centroid if faulty else bare.representative_point() if not bare.is_empty else None
    if fault is not None:
        at = _surface_points(layout, shapely.get_coordinates(fault))[0]
        raise PatternError(f"the surface is narrower than its panels near {_format_mm(at)}")


def _surface_points(layout: SurfaceLayout, at: FloatArray) -> FloatArray:
    """Return points (M, 3) of the surface at layout coordinates (M, 2), the nearest ones outside it."""
    mesh = layout.surface.mesh
    corner = layout.coordinates[mesh.faces]
    nearest = np.asarray(KDTree(corner.mean(axis=1)).query(at, k=min(24, len(corner)))[1]).reshape(
        len(at), -1
    )
    a, b, c = (corner[nearest, k] for k in range(3))
    first, second, offset = b - a, c - a, at[:, None] - a
    double_area = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    s = (offset[..., 0] * second[..., 1] - offset[..., 1] * second[..., 0]) / double_area
    t = (first[..., 0] * offset[..., 1] - first[..., 1] * offset[..., 0]) / double_area
    barycentric = np.stack([1.0 - s - t, s, t], axis=2)
    best = barycentric.min(axis=2).argmax(axis=1)
    rows = np.arange(len(at))
    weights = np.clip(barycentric[rows, best], 0.0, None)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("mk,mki->mi", weights, mesh.vertices[mesh.faces[nearest[rows, best]]]))


def _format_mm(at: FloatArray) -> str:
    x, y, z = (1e3 * at).tolist()
    return f"({x:.0f}, {y:.0f}, {z:.0f}) mm"
