"""How far the sheet comes back at one place, once more: on a mesh of the proof's own.

The sheet while a place is formed follows from the claimed faces: features before it whole, the pass's own
face down to the place's level, earlier shapes of the feature where they are deeper. Points lie on contours of
these faces, cut here, and on grids that are fine where the tool is and coarse far away; Delaunay's triangles
join them. Membranes are triangles of constant strain, where the planner's have drilling freedoms. Common with
the planner are the elements' bending, the corotational frame and the search for balance (`planner.shell`),
which plates, cones and CalculiX are held against.
"""

import dataclasses

import numpy as np
import shapely
from scipy.spatial import Delaunay, cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.proof.shapes import PartShapes, Shape
from planner.shell.element import Sheet
from planner.shell.newton import LimitLoadError, Loading, clamped, pressure

FINE = 1.5e-3
"""Points are so far apart [m] where the tool presses."""
COARSE = 7e-3
"""And so far [m] at most."""
FINE_REACH = 6e-3
"""How far [m] from the tool they are fine."""
GROWTH = 0.13
"""How much farther apart they are by the way from there."""
PROFILE = 41
"""Contours that a wall's profile is read from."""
TURN, WIDE = np.deg2rad(20.0), 4e-3
"""A contour is kept where the profile has turned by so much [rad], or gone on by so much [m] in plan."""
CONTOURS = 16
"""Contours of a wall at most, but for the first."""
APART = 0.65
"""Points are nearer than this share of the spacing only on edges."""
ALONG = 2.0
"""Points of a contour are no farther apart than this share of how far contours are apart in plan: then$
most edges of triangles run along it."""
EDGE = 2e-5
"""How far inside of its edges [m] a wall is cut."""
LEAST_DEPTH = 1e-4
"""What is less deep [m] is flat."""
LOADS = np.array([0.4, 0.7, 1.0])
"""Loads on the way to the wanted one, as shares of it."""
COARSER = np.array([1.0, 1.3, 1.7, 2.2])
"""Factors by which points are farther apart, until there are few enough."""
MOST_POINTS, MANY_POINTS = 2_200, 4_500
"""Points of a mesh, if the coarsest has no more: two seconds of a processor; and where that is not enough."""
PRESSED = 3e-3
"""Width [m] of the square that the tool presses on."""


@dataclasses.dataclass(frozen=True)
class Clamped:
    """A flat sheet as it is clamped: ``thickness`` [m], ``young`` [Pa], ``poisson``, the ``opening`` (K, 2)
    [m], convex, and the ``border`` [N/m^2], 0 where it slides and infinite where it does not move."""

    thickness: float
    young: float
    poisson: float
    opening: FloatArray
    border: float


@dataclasses.dataclass(frozen=True)
class Formed:
    """The sheet while shape ``number`` of feature ``feature`` is formed down to ``depth`` [m]."""

    made: PartShapes
    feature: int
    number: int
    depth: float

    @property
    def own(self) -> tuple[Shape, ...]:
        """The feature's shapes up to the one that is formed."""
        return self.made.features[self.feature].shapes[: self.number + 1]

    @property
    def sign(self) -> float:
        """-1 where the feature goes down."""
        return -1.0 if self.own[-1].far < self.own[-1].base else 1.0

    def height(self, plan: FloatArray) -> FloatArray:
        """Height (N,) [m] of the sheet's lower face at places in plan (N, 2)."""
        deep = np.minimum(np.maximum(self.sign * self.own[-1].shift(plan), 0.0), self.depth)
        for before in self.own[:-1]:
            deep = np.maximum(deep, self.sign * before.shift(plan))
        return self.made.sheet(np.arange(self.feature), plan) + self.sign * deep

    def contours(self) -> list[tuple[FloatArray, float]]:
        """Edges (M, 2, 2) [m] in plan of contours, and how far [m] in plan the next ones are about."""
        before = (feature.final for feature in self.made.features[: self.feature])
        walls = [(shape, abs(shape.far - shape.base), 0.0) for shape in before]
        walls.append((self.own[-1], self.depth, 0.0))
        walls += [(one, abs(one.far - one.base), self.depth) for one in self.own[:-1]]
        out: list[tuple[FloatArray, float]] = []
        for shape, end, begin in walls:
            if end - begin > LEAST_DEPTH:
                out += _contours(shape, begin, min(end, abs(shape.far - shape.base)))
        return out

    def thinned(self, plan: FloatArray) -> FloatArray:
        """The least share (N,) of the flat sheet's thickness that earlier shapes of the feature leave."""
        out = np.ones(len(plan))
        for before in self.own[:-1]:
            row, triangle, _ = before.over.at(plan, 1e-7)
            corners = before.corners[before.moved][triangle]
            np.minimum.at(out, row, _upright(corners))
        return out


def _upright(corners: FloatArray) -> FloatArray:
    """Cosines (M,) of the angles of triangles (M, 3, 3) to the flat."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.abs(cross[:, 2]) / np.maximum(np.linalg.norm(cross, axis=1), 1e-300))


def _contours(shape: Shape, begin: float, end: float) -> list[tuple[FloatArray, float]]:
    """Contours of a wall between two depths [m] below (above) the level that it begins at."""
    sign = -1.0 if shape.far < shape.base else 1.0
    edge = min(EDGE, 0.05 * (end - begin))
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, PROFILE))  # more of them beside both edges
    depth = begin + edge + share * (end - begin - 2.0 * edge)
    every = [_cut(shape, sign * one) for one in depth.tolist()]
    if any(not len(one) for one in every):
        return []
    first = cKDTree(every[0].reshape(-1, 2))
    across = np.array([float(np.median(first.query(one.reshape(-1, 2))[0])) for one in every])
    across = np.maximum.accumulate(across) + 1e-9 * np.arange(PROFILE)
    angle = np.arctan2(np.diff(depth), np.diff(across))
    turn = np.concatenate([[0.0], np.abs(np.diff(angle)), [0.0]])
    number = np.cumsum(turn / TURN) + across / WIDE
    count = int(np.clip(np.ceil(number[-1]), 1, CONTOURS))
    chosen = np.unique(np.abs(number[:, None] - np.linspace(0.0, number[-1], count + 1)).argmin(axis=0))
    gap = np.maximum(np.diff(across[chosen]), 0.25 * FINE)
    near = np.minimum(np.append(gap[0], gap), np.append(gap, gap[-1]))
    return [(every[k], float(one)) for k, one in zip(chosen, near, strict=True)]


def _cut(shape: Shape, depth: float) -> FloatArray:
    """Edges (M, 2, 2) [m] in plan of the contour of a face at ``depth`` [m] from its base, along z."""
    corners = shape.corners[shape.moved]
    high = corners[:, :, 2] - shape.base - depth
    crossed = (high > 0.0).any(axis=1) & (high <= 0.0).any(axis=1)
    corners, high = corners[crossed], high[crossed]
    ends = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        over = (high[:, i] > 0.0) != (high[:, j] > 0.0)
        share = np.where(over, high[:, i] / np.where(over, high[:, i] - high[:, j], 1.0), 0.0)
        ends.append((over, corners[:, i, :2] + share[:, None] * (corners[:, j, :2] - corners[:, i, :2])))
    over = np.stack([one for one, _ in ends], axis=1)
    place = np.stack([one for _, one in ends], axis=1)
    order = np.argsort(~over, axis=1, kind="stable")[:, :2]
    return np.take_along_axis(place, order[:, :, None], axis=1)


def _spacing(plan: FloatArray, place: FloatArray, fine: float) -> FloatArray:
    """How far apart (N,) [m] points are wanted at places in plan (N, 2), ``fine`` [m] at the tool."""
    away = np.linalg.norm(plan - place, axis=1) - FINE_REACH
    return np.asarray(np.clip(fine + GROWTH * away, fine, COARSE / FINE * fine))


def _points(formed: Formed, opening: FloatArray, place: FloatArray, fine: float = FINE) -> FloatArray:
    """Points (N, 2) [m] in plan of a mesh, as far apart as ``fine`` [m] at the tool."""
    outline = shapely.Polygon(opening)
    rim = []
    for one, two in zip(opening, np.roll(opening, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(two - one) / COARSE)))
        rim.append(one + (two - one) * (np.arange(count) / count)[:, None])
    fixed = np.concatenate(rim)
    kept = [fixed, place[None]]
    for edges, gap in formed.contours():
        kept += [_evenly(line, place, ALONG * gap * fine / FINE, fine) for line in _lines(edges)]
    points = np.concatenate(kept)
    points = points[_first_of_near(points, 0.2 * fine)]
    size = float(np.abs(opening - place).max())
    spacing, grids = fine, []
    while spacing <= COARSE / FINE * fine:
        count = int(np.ceil(size / spacing))
        axis = np.arange(-count, count + 1) * spacing
        x, y = np.meshgrid(place[0] + axis, place[1] + axis)
        grid = np.column_stack([x.ravel(), y.ravel()])
        wanted = _spacing(grid, place, fine)
        grid = grid[(wanted >= spacing) & (wanted < 2.0 * spacing)]
        grid = grid[shapely.contains_xy(outline.buffer(-0.5 * spacing), grid[:, 0], grid[:, 1])]
        grids.append(grid)
        spacing *= 2.0
    free = np.concatenate(grids)
    off = cKDTree(points).query(free)[0]
    return np.concatenate([points, free[off > APART * _spacing(free, place, fine)]])


def _lines(edges: FloatArray) -> list[FloatArray]:
    """Edges (M, 2, 2) [m] in a row: polylines (K, 2)."""
    if not len(edges):
        return []
    joined = shapely.line_merge(shapely.multilinestrings(shapely.linestrings(np.round(edges, 8))))
    return [shapely.get_coordinates(line) for line in shapely.get_parts(joined)]


def _evenly(line: FloatArray, place: FloatArray, most: float, fine: float) -> FloatArray:
    """Points (N, 2) of a polyline (K, 2) [m] as far apart as is wanted there, at ``most`` [m]."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    dense = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / (0.3 * fine)))))
    points = np.stack([np.interp(dense, way, line[:, k]) for k in (0, 1)], axis=1)
    need = np.minimum(_spacing(points, place, fine), most)
    number = np.concatenate([[0.0], np.cumsum(np.diff(dense) * 0.5 * (1.0 / need[1:] + 1.0 / need[:-1]))])
    at = np.linspace(0.0, number[-1], max(2, int(np.ceil(number[-1])) + 1))
    return np.stack([np.interp(at, number, points[:, k]) for k in (0, 1)], axis=1)


def _first_of_near(points: FloatArray, within: float) -> IntArray:
    """Indices of points (N, 2) that have no earlier one within [m]."""
    pairs = cKDTree(points).query_pairs(within, output_type="ndarray")
    return np.setdiff1d(np.arange(len(points)), pairs.max(axis=1, initial=-1))


def comes_back(
    formed: Formed, sheet: Clamped, place: FloatArray, force: float, most: int = MOST_POINTS
) -> tuple[float, int]:
    """How far [m] the sheet comes back at ``place`` (2,) [m] in plan when ``force`` [N] along the feature's
    way lets go, infinite where it has no balance under it; and how many triangles said so: of ``most``
    points, if the coarsest mesh has no more.

    Raises ``ValueError`` where points have no mesh."""
    for fine in FINE * COARSER:
        points = _points(formed, sheet.opening, place, float(fine))
        if len(points) <= most:
            break
    triangles = np.asarray(Delaunay(points).simplices, dtype=np.int64)
    corners = points[triangles]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    good = np.abs(double) > 1e-3 * longest**2
    triangles = np.where((double < 0.0)[:, None], triangles[:, [0, 2, 1]], triangles)[good]
    used, index = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], np.asarray(index).reshape(-1, 3)
    nodes = np.column_stack([points, formed.height(points)])
    upright = np.minimum(_upright(nodes[triangles]), formed.thinned(points[triangles].mean(axis=1)))
    elastic = Sheet(
        nodes, triangles, sheet.thickness * upright, sheet.young, sheet.poisson, "constant strain"
    )
    held: str | float = sheet.border
    held = "sliding" if held == 0.0 else "immovable" if np.isinf(sheet.border) else held
    way = np.array([0.0, 0.0, formed.sign])
    at = np.append(place, 0.0)
    try:
        shares = pressure(elastic, at, PRESSED)
        moved = Loading(elastic, clamped(elastic, held)).curve(shares, (force * LOADS)[:, None] * way)
    except LimitLoadError:
        return np.inf, len(triangles)
    return float(moved[-1] @ way), len(triangles)
