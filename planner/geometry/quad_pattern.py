"""A pattern of quads on a surface that is laid out along conjugate directions.

Lines of a grid divide the layout; where a corner of the grid lies near the rim it is moved onto it, so that
no slivers are left and most panels on the rim have four sides, too. Others have three or five.

The size of the grid, the ratio of its sides and where it begins are searched for the count that is asked and
the fewest corners to move: each panel of the grid counts, so a surface whose rim follows the lines has whole
rows, and the count is the nearest product.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np
import shapely
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.conjugate_field import Layout
from planner.geometry.curves import turns
from planner.geometry.panel_pattern import RIM, RIM_CORNER, Pattern, PatternError
from planner.geometry.rulings import boundaries

OUT: Final = 0
"""Corners of the grid that lie off the surface."""
ON: Final = 1
"""Corners of the grid that are moved onto the rim."""
IN: Final = 2
"""Corners of the grid within the surface."""
_NEAR: Final = 0.42
"""Corners of the grid nearer to the rim than this share of a cell are moved onto it."""
_CORNER: Final = 0.85
"""The same, where the rim has a corner."""
_SIZES: Final = 0.025
"""Steps of the logarithm of a cell's size: counts near to each other try the same ones,"""
_TRIED: Final = 8
"""up to so many steps smaller and larger than what is asked."""
_RATIOS: Final = (1.0, 0.93, 1.08, 0.86, 1.16)
"""Ratios of sides that are tried."""
_PHASES: Final = (0.0, 0.25, 0.5, 0.75)
"""Where lines of the grid are tried, in cells from the middle."""
_SPARE: Final = 1.15
"""Panels are chosen to be so much wider than they have to be: backs are smaller, and corners move."""
_MOST: Final = 40
"""Grids that are made into patterns, the best first, until one covers the surface."""
_UNEVEN: Final = 0.3
"""What a panel of three or five sides costs, in corners moved by a whole cell, squared."""
_FLAT: Final = 0.5
"""Panels with all corners on the rim fill more than half this share of their box."""
_BARE: Final = 0.15
"""Panels leave no part of the surface bare that is wider than twice this share of a cell."""


@dataclasses.dataclass(frozen=True)
class _Domain:
    """A layout's outline: ``area`` of it, points on its rim (R, 2), where the rim has ``corners`` (C, 2)."""

    area: shapely.Polygon
    rim: FloatArray
    tree: KDTree
    corners: FloatArray


@dataclasses.dataclass(frozen=True)
class _Grid:
    """Corners (A, B, 2) of a grid whose cells have ``side`` (2,); ``kind`` (A, B): off, on or in, ``near``
    (A, B, 2): where they are moved to; ``cells`` (A - 1, B - 1): those that are panels."""

    side: FloatArray
    at: FloatArray
    near: FloatArray
    kind: IntArray
    cells: BoolArray
    cost: float


def quad_pattern(made: Layout, count: int, least_width: float = 0.0) -> Pattern:
    """Panels of a surface by its layout, as nearly ``count`` as whole cells of a grid can be.

    Grids that leave panels narrower than ``least_width`` [m] are passed over, as long as there are others.

    Raises ``PatternError`` where the layout folds, or the surface is narrower than its panels.
    """
    domain = _domain(made)
    size = round(0.5 * float(np.log(domain.area.area / count)) / _SIZES)
    steps = range(size - _TRIED, size + _TRIED + 1)
    tried: list[tuple[int, float, int, _Grid]] = []
    for step, ratio, p, q in itertools.product(steps, _RATIOS, _PHASES, _PHASES):
        side = np.exp(_SIZES * step) * np.array([np.sqrt(ratio), 1.0 / np.sqrt(ratio)])
        grid = _grid(domain, side, (p, q))
        tried.append((abs(int(grid.cells.sum()) - count), grid.cost, len(tried), grid))
    found: list[tuple[float, Pattern]] = []
    error: PatternError | None = None
    for *_, grid in sorted(tried, key=lambda row: row[:3])[:_MOST]:
        try:
            pattern = _pattern(made, domain, grid)
        except PatternError as fault:
            error = error or fault
            continue
        found.append((min(_width(pattern.place[ring]) for ring in pattern.ring), pattern))
        if found[-1][0] >= _SPARE * least_width:
            return pattern
    if found:
        return max(found, key=lambda pair: pair[0])[1]
    raise error or PatternError("the surface has no room for panels with four sides: ask for more panels")


def _width(ring: FloatArray) -> float:
    """The least width [m] of a panel: the least height over one of its sides."""
    side = np.roll(ring, -1, axis=0) - ring
    rest = ring[None] - ring[:, None]
    apart = np.linalg.norm(np.cross(side[:, None], rest), axis=2)
    return float((apart.max(axis=1) / np.maximum(np.linalg.norm(side, axis=1), 1e-9)).min())


def _domain(made: Layout) -> _Domain:
    mesh = made.surface.mesh
    if len(folded := made.folded()):
        raise PatternError(
            f"lines of panels cross near {_said(mesh.vertices[mesh.faces[folded[0]]].mean(axis=0))}"
        )
    rings = boundaries(mesh)
    outlines = [made.at[ring] for ring in rings]
    size = [shapely.Polygon(line).area for line in outlines]
    outer = int(np.argmax(size))
    area = shapely.Polygon(outlines[outer], [line for k, line in enumerate(outlines) if k != outer])
    if not area.is_valid:
        # GEOS says where, as in Self-intersection[1.5 2]
        at = np.array([[float(v) for v in shapely.is_valid_reason(area).split("[")[1].rstrip("]").split()]])
        where = _said(_places(made, at)[0])
        raise PatternError(f"laid out along its lines of panels the surface overlaps itself near {where}")
    shapely.prepare(area)
    corners = [
        line[np.flatnonzero(turns(mesh.vertices[ring], True) > RIM_CORNER)]
        for ring, line in zip(rings, outlines, strict=True)
    ]
    step = 0.05 * made.surface.spacing
    dense = shapely.get_coordinates(shapely.segmentize(area.boundary, step))
    return _Domain(area, dense, KDTree(dense), np.concatenate(corners))


def _grid(domain: _Domain, side: FloatArray, phase: tuple[float, float]) -> _Grid:
    low, high = domain.rim.min(axis=0), domain.rim.max(axis=0)
    middle = 0.5 * (low + high) + np.array(phase) * side
    first, last = np.floor((low - middle) / side - 0.5), np.ceil((high - middle) / side + 0.5)
    u, v = (middle[k] + side[k] * np.arange(first[k], last[k] + 1.0) for k in range(2))
    at = np.stack(np.meshgrid(u, v, indexing="ij"), axis=2)
    flat = at.reshape(-1, 2)
    kind = np.where(shapely.contains_xy(domain.area, flat[:, 0], flat[:, 1]), IN, OUT)
    apart, nearest = domain.tree.query(flat)
    least = float(side.min())
    on = np.asarray(apart < _NEAR * least)
    near = np.where(on[:, None], domain.rim[nearest], flat)
    if len(domain.corners):
        # each corner of the rim takes the corner of the grid that is nearest to it
        far = np.linalg.norm(flat[:, None] - domain.corners, axis=2)
        mine = far.argmin(axis=0)
        for k in np.flatnonzero(far.min(axis=0) < _CORNER * least).tolist():
            on[mine[k]] = True
            near[mine[k]] = domain.corners[k]
    kind[on] = ON
    kind, near = kind.reshape(at.shape[:2]), near.reshape(at.shape)
    ring = np.stack([kind[:-1, :-1], kind[1:, :-1], kind[1:, 1:], kind[:-1, 1:]], axis=2)
    crossed = ((ring == IN) & (np.roll(ring, -1, axis=2) == OUT)).sum(axis=2)
    crossed += ((ring == OUT) & (np.roll(ring, -1, axis=2) == IN)).sum(axis=2)
    knots = (ring > OUT).sum(axis=2) + crossed
    cells = (knots >= 3) & ((ring == IN).any(axis=2) | _between(domain, ring, near))
    moved = np.linalg.norm(near - at, axis=2) / least
    used = np.zeros(kind.shape, dtype=np.bool_)
    for i, j in itertools.product((0, 1), (0, 1)):
        used[i : i + cells.shape[0], j : j + cells.shape[1]] |= cells
    cost = float((moved[used] ** 2).sum() + _UNEVEN * (cells & (knots != 4)).sum())
    return _Grid(side, at, near, kind, cells, cost)


def _between(domain: _Domain, ring: IntArray, near: FloatArray) -> BoolArray:
    """Cells (A, B) whose corners on the rim, of kinds ``ring`` (A, B, 4) all around, have some of the surface
    between them."""
    corner = np.stack([near[:-1, :-1], near[1:, :-1], near[1:, 1:], near[:-1, 1:]], axis=2)
    on = (ring == ON)[..., None]
    middle = (corner * on).sum(axis=2) / np.maximum(on.sum(axis=2), 1)
    # corners off the surface count as the ones before them
    corner = np.where(on, corner, np.roll(corner, 1, axis=2))
    after = np.roll(corner, -1, axis=2)
    double = (corner[..., 0] * after[..., 1] - corner[..., 1] * after[..., 0]).sum(axis=2)
    size = np.ptp(corner[..., 0], axis=2) * np.ptp(corner[..., 1], axis=2)
    within = shapely.contains_xy(domain.area, middle[..., 0], middle[..., 1])
    return np.asarray(within & (double > _FLAT * size))


def _pattern(made: Layout, domain: _Domain, grid: _Grid) -> Pattern:
    knots: dict[tuple[int, ...], int] = {}
    place: list[FloatArray] = []

    def knot(key: tuple[int, ...], at: FloatArray) -> int:
        if key not in knots:
            knots[key] = len(place)
            place.append(at)
        return knots[key]

    rings: list[list[int]] = []
    number: dict[tuple[int, int], int] = {}
    for i, j in np.argwhere(grid.cells).tolist():
        ring: list[int] = []
        around = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        for one, two in zip(around, [*around[1:], around[0]], strict=True):
            if grid.kind[one] != OUT:
                ring.append(knot((*one, 0, 0), grid.near[one]))
            if {int(grid.kind[one]), int(grid.kind[two])} == {IN, OUT}:
                a, b = (one, two) if grid.kind[one] == IN else (two, one)
                ring.append(knot((*a, *b), _crossing(domain, grid.at[a], grid.at[b])))
        number[i, j] = len(rings)
        rings.append(ring)
    corner = _corners(domain, grid, number, rings, place)
    rings = _trimmed(rings, corner)
    _covered(made, domain, grid, rings, place)
    beyond = {
        (a, b): p for p, ring in enumerate(rings) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
    }
    across = [
        np.array([beyond.get((b, a), RIM) for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)])
        for ring in rings
    ]
    panels: list[list[int]] = [[] for _ in place]
    for p, ring in enumerate(rings):
        for k in ring:
            panels[k].append(p)
    padded = np.array([[*own, *[-1] * (4 - len(own))] for own in panels], dtype=np.int64)
    return Pattern(
        _places(made, np.array(place)),
        padded,
        tuple(np.array(r, dtype=np.int64) for r in rings),
        tuple(across),
        corner,
        True,
    )


def _crossing(domain: _Domain, inside: FloatArray, outside: FloatArray) -> FloatArray:
    """Where the way from a corner of the grid within the surface to one off it crosses the rim."""
    line = shapely.LineString([inside, outside]).intersection(domain.area.boundary)
    found = shapely.get_coordinates(line)
    return found[int(np.argmin(np.linalg.norm(found - inside, axis=1)))] if len(found) else outside


def _corners(
    domain: _Domain,
    grid: _Grid,
    number: dict[tuple[int, int], int],
    rings: list[list[int]],
    place: list[FloatArray],
) -> BoolArray:
    """Which knots are corners of the rim; those in the middle of a cell are added to its panel."""
    for at in domain.corners:
        if min(np.linalg.norm(at - one) for one in place) < 1e-9:
            continue
        cell = np.floor((at - grid.at[0, 0]) / grid.side).astype(np.int64)
        panel = number.get((int(cell[0]), int(cell[1])))
        if panel is None:
            continue
        ring = rings[panel]
        # between the two knots where it makes the outline least longer
        longer = [
            np.linalg.norm(at - place[a])
            + np.linalg.norm(at - place[b])
            - np.linalg.norm(place[a] - place[b])
            for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)
        ]
        ring.insert(int(np.argmin(longer)) + 1, len(place))
        place.append(at)
    every = np.array(place)
    if not len(domain.corners):
        return np.zeros(len(every), dtype=np.bool_)
    return np.asarray(np.linalg.norm(every[:, None] - domain.corners, axis=2).min(axis=1) < 1e-9)


def _trimmed(rings: list[list[int]], corner: BoolArray) -> list[list[int]]:
    """Rings without knots of one panel alone, where the rim has no corner."""
    count = np.bincount(np.concatenate([np.array(ring) for ring in rings]), minlength=len(corner))
    needed = (count > 1) | corner
    found = [[k for k in ring if needed[k]] for ring in rings]
    return [new if len(new) > 2 else old for new, old in zip(found, rings, strict=True)]


def _covered(
    made: Layout, domain: _Domain, grid: _Grid, rings: list[list[int]], place: list[FloatArray]
) -> None:
    panels = [shapely.Polygon([place[k] for k in ring]) for ring in rings]
    poor = [p for p in panels if not (p.is_valid and p.exterior.is_ccw)]
    bare = domain.area.difference(shapely.union_all([p for p in panels if p.is_valid]))
    bare = bare.buffer(-_BARE * float(grid.side.min()))
    wrong = poor[0].centroid if poor else bare.representative_point() if not bare.is_empty else None
    if wrong is not None:
        at = _places(made, shapely.get_coordinates(wrong))[0]
        raise PatternError(f"the surface is narrower than its panels near {_said(at)}")


def _places(made: Layout, at: FloatArray) -> FloatArray:
    """Points (M, 3) of the surface by their coordinates (M, 2); the nearest ones where there are none."""
    mesh = made.surface.mesh
    corner = made.at[mesh.faces]
    near = np.asarray(KDTree(corner.mean(axis=1)).query(at, k=min(24, len(corner)))[1]).reshape(len(at), -1)
    a, b, c = (corner[near, k] for k in range(3))
    one, two, rest = b - a, c - a, at[:, None] - a
    double = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    s = (rest[..., 0] * two[..., 1] - rest[..., 1] * two[..., 0]) / double
    t = (one[..., 0] * rest[..., 1] - one[..., 1] * rest[..., 0]) / double
    share = np.stack([1.0 - s - t, s, t], axis=2)
    best = share.min(axis=2).argmax(axis=1)
    rows = np.arange(len(at))
    own = np.clip(share[rows, best], 0.0, None)
    own /= own.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("mk,mki->mi", own, mesh.vertices[mesh.faces[near[rows, best]]]))


def _said(at: FloatArray) -> str:
    x, y, z = (1e3 * at).tolist()
    return f"({x:.0f}, {y:.0f}, {z:.0f}) mm"
