"""The faces that passes are claimed to form, as heights over the sheet's plane.

How far each one moves the sheet at places in plan is what they have in common with the part and
with each other. `Overhead` sees triangles along z: which of them lie over a place in plan, and
where on them it is.
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
from planner.geometry.mesh import closest_on_triangles
from planner.processes.forming.claims import FormsByTable, FormsInOrder, FormsPart, FormsSheet

_PLASTIC_STEPS = (0.7548776662466927, 0.5698402909980532)
"""Steps of the plastic number's powers, whose multiples fill a square evenly (Roberts 2018)."""


class Overhead:
    """Triangles ``corners`` (T, 3, 3) [m] of which each place in plan is asked."""

    def __init__(self, corners: FloatArray) -> None:
        self.plan = corners * np.array([1.0, 1.0, 0.0])
        rings = np.concatenate([corners[:, :, :2], corners[:, :1, :2]], axis=1)
        self._low = corners[:, :, :2].min(axis=(0, 1), initial=np.inf)
        self._high = corners[:, :, :2].max(axis=(0, 1), initial=-np.inf)
        self._tree = shapely.STRtree(shapely.polygons(rings))

    def at(self, places: FloatArray, within: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Which of ``places`` (N, 2) [m] are over which triangles, or beside them by no more than ``within``
        [m]: rows (M,) ascending, triangles (M,), and the barycentric weights (M, 3) of the nearest place
        there."""
        near = ((places >= self._low - within) & (places <= self._high + within)).all(axis=1)
        some = np.flatnonzero(near)
        points = shapely.points(places[some])
        row, triangle = self._tree.query(points, predicate="dwithin", distance=within)
        row = some[row]
        order = np.lexsort((triangle, row))
        row, triangle = row[order].astype(np.int64), triangle[order].astype(np.int64)
        flat = np.column_stack([places[row], np.zeros(len(row))])
        return row, triangle, closest_on_triangles(flat, *np.moveaxis(self.plan[triangle], 1, 0))


def spread_over(corners: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """Places (``count``, 3) spread evenly by area over triangles (T, 3, 3), always the same ones, and the
    triangle (``count``,) of each."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.cumsum(np.linalg.norm(cross, axis=1))
    number = np.arange(count)
    owner = np.minimum(np.searchsorted(area, (number + 0.5) / count * area[-1]), len(area) - 1)
    u, v = np.mod(number * _PLASTIC_STEPS[0], 1.0), np.mod(number * _PLASTIC_STEPS[1], 1.0)
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    return np.einsum("pk,pkd->pd", np.stack([1.0 - u - v, u, v], axis=1), corners[owner]), owner


Passed = FormsSheet | FormsByTable

LEAST_MOTION = 1e-6
"""What a pass moves by less [m] it leaves where it is."""
FLAT_NOISE = 6e-5
"""What is off the flat by less [m] may be noise of its mesh."""
WALL_NOISE = 1e-4
"""A wall that turns back by less [m] is noise of its mesh."""
NOISE_WIDTH = 2.5e-3
"""What turns back over less [m] is noise too."""
PART_PLACES, FEATURE_PLACES = 6_000, 2_000
"""Places at which part and passes are held against each other: of the part, and of each feature."""
_PASS_NAME = re.compile(r"f(\d+)(?:_p\d+)?")
"""Name of a segment of forming: its feature, and its pass where it has several."""
_OVERHANG_LEVELS = 12
"""Levels at which a feature's contours are looked at for walls that turn back."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shape:
    """One face that is formed, by ``claims`` one after the other (repeats).

    ``corners`` (T, 3, 3) [m] with normals up; ``base`` [m] the level of the flat around it, ``far`` [m] that
    of its farthest place, as claimed.
    """

    claims: tuple[Passed, ...]
    base: float
    far: float

    @property
    def claim(self) -> Passed:
        """The first of the claims."""
        return self.claims[0]

    @cached_property
    def corners(self) -> FloatArray:
        """The face's triangles (T, 3, 3)."""
        return np.asarray(self.claim.vertices[self.claim.faces])

    @cached_property
    def moved(self) -> BoolArray:
        """Triangles (T,) with a corner that is off the level around."""
        return np.asarray((np.abs(self.corners[:, :, 2] - self.base) > LEAST_MOTION).any(axis=1))

    @cached_property
    def raised(self) -> BoolArray:
        """Triangles (T,) with a corner that is off the level around by more than noise."""
        return np.asarray((np.abs(self.corners[:, :, 2] - self.base) > FLAT_NOISE).any(axis=1))

    @cached_property
    def over(self) -> Overhead:
        """What of it lies over places in plan."""
        return Overhead(self.corners[self.moved])

    @cached_property
    def lean(self) -> tuple[FloatArray, FloatArray]:
        """Angles (M,) [rad] and areas (M,) [m^2] of the moved triangles."""
        corners = self.corners[self.moved]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=1)
        return np.arccos(np.clip(cross[:, 2] / np.maximum(size, 1e-300), -1.0, 1.0)), 0.5 * size

    def shift(self, places: FloatArray) -> FloatArray:
        """How far (N,) [m] along z the sheet is moved at places in plan (N, 2)."""
        row, triangle, share = self.over.at(places, LEAST_MOTION * 1e-3)
        height = (share * self.corners[self.moved][triangle][:, :, 2]).sum(axis=1)
        out = np.zeros(len(places))
        first = np.flatnonzero(np.diff(row, prepend=-1) != 0)
        out[row[first]] = height[first] - self.base
        return out

    def steepest(self, share: float) -> float:
        """Wall angle [rad] that ``share`` of the walls' area stays below."""
        angle, area = self.lean
        area = np.where(angle > np.deg2rad(0.5), area, 0.0)
        order = np.argsort(angle)
        passed = np.cumsum(area[order])
        return float(angle[order[int(np.searchsorted(passed, share * passed[-1]))]]) if len(angle) else 0.0

    def spread(self, count: int) -> FloatArray:
        """Places (``count``, 3) all over what is moved, by area."""
        return spread_over(self.corners[self.moved], count)[0]

    @cached_property
    def rim(self) -> FloatArray:
        """Places (R, 2) in plan where what is moved begins."""
        corners = self.corners[self.raised].reshape(-1, 3)
        return np.unique(corners[np.abs(corners[:, 2] - self.base) <= FLAT_NOISE, :2], axis=0)

    def turns_back(self, sign: float) -> FloatArray | None:
        """A place (3,) where a wall that goes ``sign`` turns back, or where it parts in two, by more than the
        noise of its mesh; None for one wall that goes one way."""
        vertices, faces = self.claim.vertices, self.claim.faces
        _, one = np.unique(vertices[:, :2].round(8), axis=0, return_inverse=True)
        node = np.asarray(one).reshape(-1)
        depth = np.zeros(int(node.max()) + 1)
        depth[node] = np.maximum(sign * (vertices[:, 2] - self.base), 0.0)
        where = np.zeros((len(depth), 3))
        where[node] = vertices
        edge = np.unique(
            np.sort(node[np.stack([faces, np.roll(faces, -1, axis=1)], -1)].reshape(-1, 2)), axis=0
        )
        edge = edge[edge[:, 0] != edge[:, 1]]
        for level in np.linspace(0.0, float(depth.max()), _OVERHANG_LEVELS + 2)[1:-1].tolist():
            for deep, inside in ((False, depth < level), (True, depth > level)):
                size, label = _pieces(inside, edge)
                reach = np.zeros(size)
                np.maximum.at(reach, label[inside], np.abs(depth[inside] - level))
                wide = _extent(where[inside], label[inside], size)
                real = (reach > WALL_NOISE) & (wide > NOISE_WIDTH)
                if not deep:  # what is left around, at its start, is no island
                    real[np.unique(label[inside & (depth <= FLAT_NOISE)])] = False
                if real.sum() > int(deep):
                    rows = np.flatnonzero(inside & (label == np.flatnonzero(real)[-1]))
                    return np.asarray(where[rows[int(np.argmax(np.abs(depth[rows] - level)))]])
        return None


def _pieces(inside: BoolArray, edge: IntArray) -> tuple[int, IntArray]:
    """Number of pieces that the nodes ``inside`` (V,) make, and the piece (V,) of each."""
    both = edge[inside[edge].all(axis=1)]
    count = len(inside)
    graph = coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))
    size, label = connected_components(graph, directed=False)
    return int(size), np.asarray(label, dtype=np.int64)


def _extent(points: FloatArray, label: IntArray, size: int) -> FloatArray:
    low, high = np.full((size, 2), np.inf), np.full((size, 2), -np.inf)
    np.minimum.at(low, label, points[:, :2])
    np.maximum.at(high, label, points[:, :2])
    return np.asarray(np.where(np.isfinite(low).all(axis=1), np.linalg.norm(high - low, axis=1), 0.0))


@dataclasses.dataclass(frozen=True, eq=False)
class Feature:
    """What is formed as one feature: the number in its name, and its ``shapes`` in the order of forming, of
    which the last one stays."""

    number: int
    shapes: tuple[Shape, ...]

    @property
    def final(self) -> Shape:
        """What stays."""
        return self.shapes[-1]


class PartShapes:
    """Part and passes of one operation. ``features`` in the order of forming, the ``first`` of which earlier
    operations form; ``places`` (N, 2) all over part and passes, ``wanted`` (N,) [m] how far the part is off
    the flat there, ``moved`` (F, N) [m] how far each feature moves it, ``steep`` (N,) the part's normal
    along z."""

    def __init__(self, part: FormsPart, passes: tuple[Passed, ...], before: tuple[Feature, ...] = ()) -> None:
        self.part = part
        self.first = len(before)
        self.features = (*before, *_features(part, passes))
        corners = part.vertices[part.faces]
        self.level = _rim_level(part)
        own = [
            spread_over(corners, PART_PLACES)[0],
            *(feature.final.spread(FEATURE_PLACES) for feature in self.features),
        ]
        # places of flats are of no interest: the sheet is flat there as long as nothing moves it
        self.places = np.concatenate(own)[:, :2]
        self.wanted, self.steep = self._over(corners)
        self.moved = np.array([feature.final.shift(self.places) for feature in self.features])
        self.moved = self.moved.reshape(len(self.features), len(self.places))

    def _over(self, corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        row, triangle, share = Overhead(corners).at(self.places, LEAST_MOTION * 1e-3)
        first = np.flatnonzero(np.diff(row, prepend=-1) != 0)
        row, triangle, share = row[first], triangle[first], share[first]
        height, steep = np.zeros(len(self.places)), np.ones(len(self.places))
        height[row] = (share * corners[triangle][:, :, 2]).sum(axis=1) - self.level
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        steep[row] = np.abs(cross[triangle, 2]) / np.maximum(np.linalg.norm(cross[triangle], axis=1), 1e-300)
        return height, steep

    @property
    def own(self) -> list[tuple[int, Feature]]:
        """The features of the operation itself, with their places among all."""
        return list(enumerate(self.features))[self.first :]

    @cached_property
    def inside(self) -> BoolArray:
        """(F, F): whether the first feature stands inside what the second one moves."""
        own = np.abs(self.moved) > FLAT_NOISE
        count = np.maximum(own.sum(axis=1), 1)
        shared = (own[:, None] & own[None]).sum(axis=2) / count[:, None]
        larger = self.area[:, None] < self.area[None]
        return np.asarray((shared > 0.5) & larger)

    @cached_property
    def area(self) -> FloatArray:
        """Area (F,) [m^2] in plan that each feature moves."""
        out = []
        for feature in self.features:
            plan = feature.final.over.plan
            a, b = plan[:, 1] - plan[:, 0], plan[:, 2] - plan[:, 0]
            out.append(0.5 * float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()))
        return np.array(out)

    def sheet(self, done: IntArray, places: FloatArray) -> FloatArray:
        """Height (N,) [m] of the sheet's lower face at places in plan (N, 2) once features (K,) are done."""
        height = np.full(len(places), self.level)
        for k in done.tolist():
            height = height + self.features[k].final.shift(places)
        return height


def in_order(group: Sequence[Claim]) -> tuple[Passed, ...]:
    """The passes of a group of claims, in the order that it claims."""
    found = {c.segment: c for c in group if isinstance(c, FormsSheet | FormsByTable)}
    names = [name for c in group if isinstance(c, FormsInOrder) for name in c.segments if name in found]
    return tuple(found[name] for name in (*names, *(name for name in found if name not in names)))


def _features(part: FormsPart, passes: tuple[Passed, ...]) -> tuple[Feature, ...]:
    out: list[tuple[int, list[Shape]]] = []
    for claim in passes:
        found = _PASS_NAME.fullmatch(claim.segment.name)
        number = int(found.group(1)) if found else -1
        base, far = (claim.end, claim.start) if part.male else (claim.start, claim.end)
        same = bool(out) and out[-1][0] == number
        last = out[-1][1][-1] if same else None
        if last is not None and _alike(last.claim, claim):
            out[-1][1][-1] = dataclasses.replace(last, claims=(*last.claims, claim))
        elif same:
            out[-1][1].append(Shape((claim,), base, far))
        else:
            out.append((number, [Shape((claim,), base, far)]))
    return tuple(Feature(number, tuple(shapes)) for number, shapes in out)


def _alike(one: Passed, two: Passed) -> bool:
    return np.array_equal(one.vertices, two.vertices) and np.array_equal(one.faces, two.faces)


def _rim_level(part: FormsPart) -> float:
    """Return the level [m] of the edge of the part."""
    edge = np.sort(np.stack([part.faces, np.roll(part.faces, -1, axis=1)], -1).reshape(-1, 2), axis=1)
    found, count = np.unique(edge, axis=0, return_counts=True)
    rim = np.unique(found[count == 1])
    return float(np.median(part.vertices[rim, 2])) if len(rim) else 0.0
