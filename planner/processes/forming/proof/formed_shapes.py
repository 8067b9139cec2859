"""The faces that passes are claimed to form, as heights above the sheet's plane.

The displacement of the sheet by each one at points in plan is what they have in common with the part and with
each other. `PlanLookup` sees triangles along z: which of them are over a point in plan, and where on them the
point is.
"""

import dataclasses
import re
from collections.abc import Sequence
from functools import cached_property

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planner.claims.claim import Claim
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.mesh import closest_weights
from planner.processes.forming.claims import FormsByTable, FormsInOrder, FormsPart, FormsSheet

_PLASTIC_STEPS = (0.7548776662466927, 0.5698402909980532)
"""Powers of the inverse plastic number, whose multiples fill a square evenly (Roberts 2018)."""


class PlanLookup:
    """Triangles that are queried by points in plan.

    Args:
        corners: Triangles (T, 3, 3) [m].
    """

    def __init__(self, corners: FloatArray) -> None:
        self.plan = corners * np.array([1.0, 1.0, 0.0])
        rings = np.concatenate([corners[:, :, :2], corners[:, :1, :2]], axis=1)
        self._low = corners[:, :, :2].min(axis=(0, 1), initial=np.inf)
        self._high = corners[:, :, :2].max(axis=(0, 1), initial=-np.inf)
        self._tree = shapely.STRtree(shapely.polygons(rings))

    def locate(self, points: FloatArray, within: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Return all pairs of a point and a triangle that contains it in plan, or is near it.

        Args:
            points: Points (N, 2) [m] in plan.
            within: Maximum distance [m] in plan of a point from its triangle.

        Returns:
            Indices (M,) of the points, ascending; triangles (M,); and the barycentric weights (M, 3) of the
            point of the triangle that is nearest in plan.
        """
        in_bounds = ((points >= self._low - within) & (points <= self._high + within)).all(axis=1)
        candidates = np.flatnonzero(in_bounds)
        plan_points = shapely.points(points[candidates])
        row, triangle = self._tree.query(plan_points, predicate="dwithin", distance=within)
        row = candidates[row]
        order = np.lexsort((triangle, row))
        row, triangle = row[order].astype(np.int64), triangle[order].astype(np.int64)
        flat = np.column_stack([points[row], np.zeros(len(row))])
        return row, triangle, closest_weights(flat, *np.moveaxis(self.plan[triangle], 1, 0))


def spread_points(corners: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """Return points spread evenly by area over triangles, always the same ones.

    Args:
        corners: Triangles (T, 3, 3).
        count: Number of points.

    Returns:
        Points (``count``, 3) and the triangle (``count``,) of each.
    """
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.cumsum(np.linalg.norm(cross, axis=1))
    number = np.arange(count)
    owner = np.minimum(np.searchsorted(area, (number + 0.5) / count * area[-1]), len(area) - 1)
    u, v = np.mod(number * _PLASTIC_STEPS[0], 1.0), np.mod(number * _PLASTIC_STEPS[1], 1.0)
    is_outside = u + v > 1.0  # the other half of the unit square is folded onto the triangle
    u, v = np.where(is_outside, 1.0 - u, u), np.where(is_outside, 1.0 - v, v)
    return np.einsum("pk,pkd->pd", np.stack([1.0 - u - v, u, v], axis=1), corners[owner]), owner


PassClaim = FormsSheet | FormsByTable
"""Claim on a pass."""

MIN_DISPLACEMENT_M = 1e-6
"""Minimum displacement [m] of the sheet by a pass that counts as a displacement."""
FLAT_NOISE_M = 6e-5
"""Sheet within this distance [m] of the flat may be noise of its mesh."""
WALL_NOISE_M = 1e-4
"""A wall that turns back by less than this [m] is noise of its mesh."""
NOISE_WIDTH_M = 2.5e-3
"""A wall that turns back over less than this [m] is noise, too."""
PART_POINTS, FEATURE_POINTS = 6_000, 2_000
"""Number of points at which part and passes are compared: of the part, and of each feature."""
_PASS_NAME = re.compile(r"f(\d+)(?:_p\d+)?")
"""Name of a forming segment: its feature, and its pass if it has several."""
_OVERHANG_LEVELS = 12
"""Number of levels at which a feature's contours are checked for walls that turn back."""


@dataclasses.dataclass(frozen=True, eq=False)
class FormedShape:
    """One face that is formed, by one claim after the other (repeats).

    Attributes:
        claims: Claims on it.
        base: Level [m] of the surrounding flat.
        end_level: Level [m] of its farthest point, as claimed.
    """

    claims: tuple[PassClaim, ...]
    base: float
    end_level: float

    @property
    def claim(self) -> PassClaim:
        """The first of the claims."""
        return self.claims[0]

    @cached_property
    def corners(self) -> FloatArray:
        """Corners (T, 3, 3) [m] of the face's triangles, whose normals point up."""
        return np.asarray(self.claim.vertices[self.claim.faces])

    @cached_property
    def moved(self) -> BoolArray:
        """Whether (T,) each triangle has a corner off the surrounding level."""
        return np.asarray((np.abs(self.corners[:, :, 2] - self.base) > MIN_DISPLACEMENT_M).any(axis=1))

    @cached_property
    def raised(self) -> BoolArray:
        """Whether (T,) each triangle has a corner off the surrounding level by more than noise."""
        return np.asarray((np.abs(self.corners[:, :, 2] - self.base) > FLAT_NOISE_M).any(axis=1))

    @cached_property
    def lookup(self) -> PlanLookup:
        """Lookup of the moved triangles alone, numbered among themselves, by points in plan."""
        return PlanLookup(self.corners[self.moved])

    @cached_property
    def angles_and_areas(self) -> tuple[FloatArray, FloatArray]:
        """Wall angles (M,) [rad] and areas (M,) [m^2] of the moved triangles."""
        corners = self.corners[self.moved]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=1)
        return np.arccos(np.clip(cross[:, 2] / np.maximum(size, 1e-300), -1.0, 1.0)), 0.5 * size

    def displacement(self, points: FloatArray) -> FloatArray:
        """Return the displacement (N,) [m] of the sheet along z at points in plan (N, 2), 0 outside."""
        row, triangle, weight = self.lookup.locate(points, MIN_DISPLACEMENT_M * 1e-3)
        height = (weight * self.corners[self.moved][triangle][:, :, 2]).sum(axis=1)
        out = np.zeros(len(points))
        first = np.flatnonzero(np.diff(row, prepend=-1) != 0)
        out[row[first]] = height[first] - self.base
        return out

    def wall_angle(self, fraction: float) -> float:
        """Return the wall angle [rad] that a fraction of the walls' area does not exceed, 0 without walls."""
        angle, area = self.angles_and_areas
        area = np.where(angle > np.deg2rad(0.5), area, 0.0)
        order = np.argsort(angle)
        total = np.cumsum(area[order])
        return float(angle[order[int(np.searchsorted(total, fraction * total[-1]))]]) if len(angle) else 0.0

    def spread_points(self, count: int) -> FloatArray:
        """Return points (``count``, 3) [m] spread evenly by area over the moved triangles."""
        return spread_points(self.corners[self.moved], count)[0]

    @cached_property
    def rim(self) -> FloatArray:
        """Points (R, 2) [m] in plan on the edge of the moved area, where its walls start from the flat."""
        corners = self.corners[self.raised].reshape(-1, 3)
        return np.unique(corners[np.abs(corners[:, 2] - self.base) <= FLAT_NOISE_M, :2], axis=0)

    def turn_back_point(self, sign: float) -> FloatArray | None:
        """Return a point (3,) [m] where a wall turns back or splits in two, None for one monotonic wall.

        At each of several levels, all that is deeper must be one connected piece, and all that is less deep
        must be connected to the surroundings. Deviations within the noise of the mesh do not count.

        Args:
            sign: Direction in which the shape is formed, +1 up or -1 down along z.
        """
        vertices, faces = self.claim.vertices, self.claim.faces
        _, vertex_index = np.unique(vertices[:, :2].round(8), axis=0, return_inverse=True)
        node = np.asarray(vertex_index).reshape(-1)
        depth = np.zeros(int(node.max()) + 1)
        depth[node] = np.maximum(sign * (vertices[:, 2] - self.base), 0.0)
        position = np.zeros((len(depth), 3))
        position[node] = vertices
        edge = np.unique(
            np.sort(node[np.stack([faces, np.roll(faces, -1, axis=1)], -1)].reshape(-1, 2)), axis=0
        )
        edge = edge[edge[:, 0] != edge[:, 1]]
        for level in np.linspace(0.0, float(depth.max()), _OVERHANG_LEVELS + 2)[1:-1].tolist():
            for is_deeper, inside in ((False, depth < level), (True, depth > level)):
                size, label = _connected_pieces(inside, edge)
                reach = np.zeros(size)
                np.maximum.at(reach, label[inside], np.abs(depth[inside] - level))
                extent = _extent(position[inside], label[inside], size)
                real = (reach > WALL_NOISE_M) & (extent > NOISE_WIDTH_M)
                if not is_deeper:  # the surroundings at its start are not an island
                    real[np.unique(label[inside & (depth <= FLAT_NOISE_M)])] = False
                if real.sum() > int(is_deeper):  # one deeper piece is permitted, and no island
                    nodes = np.flatnonzero(inside & (label == np.flatnonzero(real)[-1]))
                    return np.asarray(position[nodes[int(np.argmax(np.abs(depth[nodes] - level)))]])
        return None


def _connected_pieces(inside: BoolArray, edge: IntArray) -> tuple[int, IntArray]:
    """Label the connected pieces of the graph with nodes ``inside`` (V,) and the edges (E, 2) between them.

    Returns the number of pieces and the piece (V,) of each node. A node that is not inside is its own piece.
    """
    inner_edges = edge[inside[edge].all(axis=1)]
    count = len(inside)
    graph = coo_array(
        (np.ones(len(inner_edges)), (inner_edges[:, 0], inner_edges[:, 1])), shape=(count, count)
    )
    size, label = connected_components(graph, directed=False)
    return int(size), np.asarray(label, dtype=np.int64)


def _extent(points: FloatArray, label: IntArray, size: int) -> FloatArray:
    """Return the diagonal (``size``,) [m] of the bounding rectangle in plan of the points of each label.

    ``label`` (N,) is the label of each of the ``points`` (N, 3) [m]. The result is 0 for a label without any.
    """
    low, high = np.full((size, 2), np.inf), np.full((size, 2), -np.inf)
    np.minimum.at(low, label, points[:, :2])
    np.maximum.at(high, label, points[:, :2])
    return np.asarray(np.where(np.isfinite(low).all(axis=1), np.linalg.norm(high - low, axis=1), 0.0))


@dataclasses.dataclass(frozen=True, eq=False)
class FormedFeature:
    """The shapes that are formed one after the other as one feature.

    Attributes:
        number: Number in the names of its segments, -1 if they have none.
        shapes: Shapes in the order of forming. The last one remains.
    """

    number: int
    shapes: tuple[FormedShape, ...]

    @property
    def final(self) -> FormedShape:
        """The shape that remains."""
        return self.shapes[-1]


class PartShapes:
    """Part and passes of one operation.

    Attributes:
        part: Claim on the part.
        features: Features in the order of forming, including those of earlier operations.
        first: Number of features that earlier operations form.
        level: Height z [m] of the flat around the part.
        points: Points (N, 2) [m] in plan all over part and passes.
        nominal: Height (N,) [m] of the part above the flat there.
        moved: Displacement (F, N) [m] by each feature there.
        steep: z component (N,) of the part's normal there, 1 where it is flat.
    """

    def __init__(
        self, part: FormsPart, passes: tuple[PassClaim, ...], previous: tuple[FormedFeature, ...] = ()
    ) -> None:
        self.part = part
        self.first = len(previous)
        self.features = (*previous, *_group_features(part, passes))
        corners = part.vertices[part.faces]
        self.level = _rim_level(part)
        point_sets = [
            spread_points(corners, PART_POINTS)[0],
            *(feature.final.spread_points(FEATURE_POINTS) for feature in self.features),
        ]
        # flats need no points: the sheet is flat there unless something moves it
        self.points = np.concatenate(point_sets)[:, :2]
        self.nominal, self.steep = self._height_and_steepness(corners)
        self.moved = np.array([feature.final.displacement(self.points) for feature in self.features])
        self.moved = self.moved.reshape(len(self.features), len(self.points))

    def _height_and_steepness(self, corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Calculate ``nominal`` and ``steep`` from the part's triangles (T, 3, 3)."""
        row, triangle, weight = PlanLookup(corners).locate(self.points, MIN_DISPLACEMENT_M * 1e-3)
        first = np.flatnonzero(np.diff(row, prepend=-1) != 0)
        row, triangle, weight = row[first], triangle[first], weight[first]
        height, steep = np.zeros(len(self.points)), np.ones(len(self.points))
        height[row] = (weight * corners[triangle][:, :, 2]).sum(axis=1) - self.level
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        steep[row] = np.abs(cross[triangle, 2]) / np.maximum(np.linalg.norm(cross[triangle], axis=1), 1e-300)
        return height, steep

    @property
    def own_features(self) -> list[tuple[int, FormedFeature]]:
        """The features of the operation itself, with their indices among all."""
        return list(enumerate(self.features))[self.first :]

    @cached_property
    def inside(self) -> BoolArray:
        """Whether (F, F) a feature is inside another one; ``inside[i, j]`` means that i is inside j.

        Feature j then moves more than half of the points that feature i moves, and its area is larger.
        """
        is_moved = np.abs(self.moved) > FLAT_NOISE_M
        count = np.maximum(is_moved.sum(axis=1), 1)
        shared = (is_moved[:, None] & is_moved[None]).sum(axis=2) / count[:, None]
        larger = self.area[:, None] < self.area[None]
        return np.asarray((shared > 0.5) & larger)

    @cached_property
    def area(self) -> FloatArray:
        """Area (F,) [m^2] in plan that each feature moves."""
        out = []
        for feature in self.features:
            plan = feature.final.lookup.plan
            a, b = plan[:, 1] - plan[:, 0], plan[:, 2] - plan[:, 0]
            out.append(0.5 * float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()))
        return np.array(out)

    def sheet_height(self, done: IntArray, points: FloatArray) -> FloatArray:
        """Return the height (N,) [m] of the sheet's lower face once some features are done.

        Args:
            done: Indices (K,) of the features.
            points: Points (N, 2) [m] in plan.
        """
        height = np.full(len(points), self.level)
        for k in done.tolist():
            height = height + self.features[k].final.displacement(points)
        return height


def ordered_passes(group: Sequence[Claim]) -> tuple[PassClaim, ...]:
    """Return the claims on passes in a group, in the claimed order, then those without a claimed order."""
    by_segment = {c.segment: c for c in group if isinstance(c, FormsSheet | FormsByTable)}
    names = [name for c in group if isinstance(c, FormsInOrder) for name in c.segments if name in by_segment]
    return tuple(by_segment[name] for name in (*names, *(name for name in by_segment if name not in names)))


def _group_features(part: FormsPart, passes: tuple[PassClaim, ...]) -> tuple[FormedFeature, ...]:
    """Group consecutive passes with the same feature number, and within it those with the same face."""
    out: list[tuple[int, list[FormedShape]]] = []
    for claim in passes:
        match = _PASS_NAME.fullmatch(claim.segment.name)
        number = int(match.group(1)) if match else -1
        base, end_level = (claim.end, claim.start) if part.male else (claim.start, claim.end)
        continues = bool(out) and out[-1][0] == number
        last_shape = out[-1][1][-1] if continues else None
        if last_shape is not None and _has_same_face(last_shape.claim, claim):
            out[-1][1][-1] = dataclasses.replace(last_shape, claims=(*last_shape.claims, claim))
        elif continues:
            out[-1][1].append(FormedShape((claim,), base, end_level))
        else:
            out.append((number, [FormedShape((claim,), base, end_level)]))
    return tuple(FormedFeature(number, tuple(shapes)) for number, shapes in out)


def _has_same_face(first: PassClaim, second: PassClaim) -> bool:
    return np.array_equal(first.vertices, second.vertices) and np.array_equal(first.faces, second.faces)


def _rim_level(part: FormsPart) -> float:
    """Return the level [m] of the edge of the part."""
    edge = np.sort(np.stack([part.faces, np.roll(part.faces, -1, axis=1)], -1).reshape(-1, 2), axis=1)
    edges, count = np.unique(edge, axis=0, return_counts=True)
    rim = np.unique(edges[count == 1])
    return float(np.median(part.vertices[rim, 2])) if len(rim) else 0.0
