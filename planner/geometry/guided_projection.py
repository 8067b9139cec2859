"""Planar panels near a surface by guided projection.

Unknown are the knots, the way of each knot when all planes move by one, and the planes. All that is wanted
is at most quadratic in them, so that a few rounds of sparse Gauss-Newton find it (C. Tang and others,
Form-finding with polyhedral meshes made simple, ACM TOG 33, 2014). Lengths are in spacings while it works.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import LinearOperator, SuperLU, cg, splu
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, columns, dots, unit
from planner.geometry.even_points import FineSurface
from planner.geometry.panel_pattern import Pattern, joints
from planner.geometry.rulings import boundaries

LONGEST_WAY: Final = 1.15
"""Offset edges are no longer than this many thicknesses."""
COPLANAR: Final = 1e-7
"""Panels whose normals differ by less [rad] lie in one plane."""
_AIM: Final = 1.10
"""What the rounds aim at, so that the exact planes keep the limit."""
_EXACT: Final = 12
"""Rounds of Newton's method onto exact planes, at most."""
_ON_GROUND: Final = 0.1
"""Knots of the rim that start nearer to the ground than this, in spacings, stay on it."""


@dataclasses.dataclass(frozen=True)
class Weights:
    """How much each wish counts, in spacings and directions of length one.

    ``plane``: panels are planar; ``close``: knots lie on the surface; ``normal``: panels have its normals, or
    they fold over; ``way``: offset edges are upright; ``fair`` and ``stay``: knots in the middle of their
    neighbours and where they began; ``hinge``: limits; ``steady``: unknowns stay where they are;
    ``even``: planes of quads moved by one meet at one point, though they need not.
    """

    plane: float = 20.0
    close: float = 1.0
    normal: float = 1.5
    way: float = 0.1
    fair: float = 0.02
    stay: float = 0.2
    hinge: float = 4.0
    steady: float = 0.2
    even: float = 0.0
    rounds: int = 40


_WEIGHTS: Final = Weights()


@dataclasses.dataclass(frozen=True)
class Faces:
    """Planes of a pattern's panels: ``normal`` (N, 3) unit, ``distance`` (N,) [m]: normal . x = distance;
    ``knot`` (K, 3) [m] in the planes of its panels; ``way`` (K, 3): where it goes as they move by one;
    ``on_ground`` (K,): knots that are held level; ``sharp`` (K,): those on the rim at which a quad ends in a
    point, so that sides on the rim beside it may not lean out beyond their ways."""

    pattern: Pattern
    normal: FloatArray
    distance: FloatArray
    knot: FloatArray
    way: FloatArray
    on_ground: BoolArray
    sharp: BoolArray


def planarised(
    surface: FineSurface,
    pattern: Pattern,
    middle: FloatArray,
    normal: FloatArray,
    convex: BoolArray,
    thickness: float,
    least_edge: float,
    ground: float | None = None,
    weights: Weights = _WEIGHTS,
) -> Faces:
    """Exact planes of the panels of a pattern on a surface.

    ``middle`` and ``normal`` (N, 3): of the cells; ``convex`` (N,): panels that are to be convex;
    ``thickness`` [m] along the normals (negative: against them) and ``least_edge`` [m]: edges of both faces
    are to be longer; ``ground`` [m]: the height at which a rim that stands on the ground is held level.
    Limits are wishes here: whether they are kept is for a check of the panels to say.
    """
    work = _Work(surface, pattern, middle, normal, convex, thickness, least_edge, ground, weights)
    for _ in range(weights.rounds):
        moved = work.round()
        if np.quantile(moved, 1.0 - _RESTLESS) < _SETTLED and moved.max() < 10.0 * _SETTLED:
            break
    work.exact()
    x, w, n, d = work.split(work.z)
    distance = work.scale * (d + dots(n, work.middle))
    w = w if pattern.quads else _squared(pattern, n, x, w)
    on_ground = np.zeros(work.knots, dtype=np.bool_)
    on_ground[work.foot] = True
    sharp = pattern.pointed & pattern.quads
    return Faces(pattern, n, distance, work.scale * x, w, on_ground, sharp)


def _squared(pattern: Pattern, normal: FloatArray, knot: FloatArray, way: FloatArray) -> FloatArray:
    """The ways of knots with a joint of two panels in one plane, which leave the side between them open: made
    square to both."""
    found = way.copy()
    for a, b, one, two in joints(pattern).tolist():
        if np.linalg.norm(normal[a] - normal[b]) > COPLANAR:
            continue
        side = unit(np.cross(knot[two] - knot[one], normal[a]))
        for k in (one, two):
            third = next((p for p in pattern.panels[k].tolist() if p >= 0 and p not in (a, b)), None)
            if third is not None:
                matrix = np.stack([normal[a], normal[third], side])
                # three panels in one plane leave one way alone, which least squares find
                found[k] = np.linalg.lstsq(matrix, np.array([1.0, 1.0, 0.0]), rcond=COPLANAR)[0]
    return found


class _Rows:
    """Rows of a Jacobian, gathered in their order."""

    def __init__(self) -> None:
        self.column: list[IntArray] = []
        self.value: list[FloatArray] = []
        self.size: list[IntArray] = []
        self.rest: list[FloatArray] = []

    def add(self, rest: FloatArray, *terms: tuple[IntArray, FloatArray], weight: float = 1.0) -> None:
        """Rows with what is left ``rest`` (M,) and terms of columns (M, C) and values (M, C)."""
        columns = np.concatenate([column for column, _ in terms], axis=1)
        self.column.append(columns.reshape(-1))
        self.value.append(weight * np.concatenate([value for _, value in terms], axis=1).reshape(-1))
        self.size.append(np.full(len(rest), columns.shape[1]))
        self.rest.append(weight * rest)

    def add_uneven(self, rest: FloatArray, size: IntArray, column: IntArray, value: FloatArray) -> None:
        """Rows of ``size`` (M,) terms each, one after the other."""
        self.column.append(column)
        self.value.append(value)
        self.size.append(size)
        self.rest.append(rest)

    def matrix(self, columns: int) -> tuple[csr_array, FloatArray]:
        """The Jacobian, its columns in no order, and what is left."""
        rest = np.concatenate(self.rest)
        start = np.concatenate([[0], np.cumsum(np.concatenate(self.size))])
        parts = np.concatenate(self.value), np.concatenate(self.column), start
        return csr_array(parts, shape=(len(rest), columns)), rest


def normal_equations(matrix: csr_array, steady: float) -> csc_array:
    """``matrix.T @ matrix`` with the square of ``steady`` added to its diagonal, columns in order."""
    count = matrix.shape[1]
    held = csr_array((np.full(count, steady), np.arange(count), np.arange(count + 1)), shape=(count, count))
    whole = vstack([matrix, held], format="csr")
    # a conversion sorts in one go what the product leaves unsorted
    return csc_array(csr_array(whole.T.tocsr() @ whole).tocsc())


class _Work:
    """The unknowns of a pattern, in spacings."""

    def __init__(
        self,
        surface: FineSurface,
        pattern: Pattern,
        middle: FloatArray,
        normal: FloatArray,
        convex: BoolArray,
        thickness: float,
        least_edge: float,
        ground: float | None,
        weights: Weights,
    ) -> None:
        scale = self.scale = surface.spacing
        self.weights, self.pattern = weights, pattern
        self.thickness, self.least = thickness / scale, least_edge / scale
        self.middle, self.wanted = middle / scale, normal
        self.knots, self.panels = len(pattern.place), len(middle)
        self.face = np.repeat(np.arange(self.panels), [len(ring) for ring in pattern.ring])
        self.knot = np.concatenate(pattern.ring)
        self.factor: SuperLU | None = None
        self.tree = KDTree(surface.mesh.vertices / scale)
        self.place, self.upright = surface.mesh.vertices / scale, surface.normal
        self.rim = np.flatnonzero(pattern.on_rim)
        rings = boundaries(surface.mesh)
        curve = np.concatenate([surface.mesh.vertices[ring] for ring in rings]) / scale
        step = np.concatenate(
            [np.roll(surface.mesh.vertices[ring], -1, axis=0) - surface.mesh.vertices[ring] for ring in rings]
        )
        self.curve, self.along, self.rim_tree = curve, unit(step), KDTree(curve)
        self.ground = 0.0 if ground is None else ground / scale
        height = np.abs(pattern.place[self.rim, 2] / scale - self.ground)
        self.foot = self.rim[(height < _ON_GROUND) & (ground is not None)]
        self.level = self.foot[pattern.pointed[self.foot]]
        self.corner = pattern.corner[self.rim]
        self.joint = joints(pattern)
        across = middle[self.joint[:, 1]] - middle[self.joint[:, 0]]
        self.reference = unit(np.cross(normal[self.joint[:, 0]] + normal[self.joint[:, 1]], across))
        self._neighbours()
        turn = [np.stack([np.roll(ring, 1), ring, np.roll(ring, -1)], axis=1) for ring in pattern.ring]
        self.turn = np.concatenate(turn)
        self.bent = np.flatnonzero(convex[self.face])
        x = pattern.place / scale
        self.z = np.concatenate(
            [x.reshape(-1), self._upright(x).reshape(-1), normal.reshape(-1), np.zeros(self.panels)]
        )

    def _neighbours(self) -> None:
        """Means of the knots beside inner knots, and beside rim knots along the rim."""
        ends = np.concatenate([np.stack([ring, np.roll(ring, -1)], axis=1) for ring in self.pattern.ring])
        side = np.concatenate(self.pattern.across)
        on_rim = np.zeros(self.knots, dtype=np.bool_)
        on_rim[self.rim] = True
        both = np.concatenate([ends, ends[:, ::-1]])
        keep = ~on_rim[both[:, 0]] | np.concatenate([side < 0, side < 0])
        both = np.unique(both[keep], axis=0)
        count = np.bincount(both[:, 0], minlength=self.knots)
        shares = csr_array(
            (1.0 / count[both[:, 0]], (both[:, 0], both[:, 1])), shape=(self.knots, self.knots)
        )
        self.smooth = csr_array(diags_array(np.ones(self.knots)) - shares)

    def _upright(self, x: FloatArray) -> FloatArray:
        return self.upright[self.tree.query(x)[1]]

    def split(self, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        k, n = 3 * self.knots, 3 * self.panels
        return (
            z[:k].reshape(-1, 3),
            z[k : 2 * k].reshape(-1, 3),
            z[2 * k : 2 * k + n].reshape(-1, 3),
            z[2 * k + n :],
        )

    def _x(self, knot: IntArray) -> IntArray:
        return 3 * knot[:, None] + np.arange(3)

    def _w(self, knot: IntArray) -> IntArray:
        return 3 * (self.knots + knot[:, None]) + np.arange(3)

    def _n(self, face: IntArray) -> IntArray:
        return 3 * (2 * self.knots + face[:, None]) + np.arange(3)

    def _d(self, face: IntArray) -> IntArray:
        return (6 * self.knots + 3 * self.panels + face)[:, None]

    def _planes(self, rows: _Rows, z: FloatArray, weight: float) -> None:
        """Knots in their planes, ways that move planes by one, the ground, normals of length one."""
        x, w, n, d = self.split(z)
        f, k = self.face, self.knot
        off = x[k] - self.middle[f]
        minus = -np.ones((len(f), 1))
        rows.add(
            dots(n[f], off) - d[f], (self._x(k), n[f]), (self._n(f), off), (self._d(f), minus), weight=weight
        )
        if self.pattern.quads:
            self._sides(rows, x, w, weight)
        else:
            rows.add(dots(n[f], w[k]) - 1.0, (self._w(k), n[f]), (self._n(f), w[k]), weight=weight)
        one = np.ones((len(self.foot), 1))
        rows.add(x[self.foot, 2] - self.ground, (self._x(self.foot)[:, [2]], one), weight=weight)
        rows.add(0.5 * (dots(n, n) - 1.0), (self._n(np.arange(len(n))), n), weight=weight)

    def _sides(self, rows: _Rows, x: FloatArray, w: FloatArray, weight: float) -> None:
        """The ways of both ends of a joint in one plane with it; those of points on the ground are level."""
        one, two = self.joint[:, 2:].T
        e, a, b = x[two] - x[one], w[one], w[two]
        across = np.cross(a, b)
        terms = [(self._x(one), -across), (self._x(two), across)]
        terms += [(self._w(one), np.cross(b, e)), (self._w(two), np.cross(e, a))]
        rows.add(dots(e, across), *terms, weight=weight)
        level = self.level
        rows.add(w[level, 2], (self._w(level)[:, [2]], np.ones((len(level), 1))), weight=weight)

    def round(self) -> FloatArray:
        """One round of Gauss-Newton over all wishes; how far each unknown moved."""
        x, w, n, _ = self.split(self.z)
        rows, g = _Rows(), self.weights
        self._planes(rows, self.z, g.plane)
        near = self.tree.query(x)[1]
        up = self.upright[near]
        every = np.arange(self.knots)
        rows.add(dots(up, x - self.place[near]), (self._x(every), up), weight=g.close)
        self._rims(rows, x)
        if self.pattern.quads:
            f, k = self.face, self.knot
            rows.add(dots(n[f], w[k]) - 1.0, (self._w(k), n[f]), (self._n(f), w[k]), weight=g.even)
        for i in range(3):
            one = np.ones((self.panels, 1))
            rows.add(
                n[:, i] - self.wanted[:, i], (self._n(np.arange(self.panels))[:, [i]], one), weight=g.normal
            )
            one = np.ones((self.knots, 1))
            rows.add(w[:, i] - up[:, i], (self._w(every)[:, [i]], one), weight=g.way)
        self._fair(rows, x, up)
        self._hinges(rows, x, w, n)
        matrix, rest = rows.matrix(len(self.z))
        square, right = normal_equations(matrix, g.steady), matrix.T @ rest
        step = None if self.factor is None else _by_former(square, right, self.factor)
        if step is None:
            self.factor = symmetric_factor(square)
            step = self.factor.solve(right)
        self.z = self.z - step
        return np.abs(step)

    def _rims(self, rows: _Rows, x: FloatArray) -> None:
        at = self.rim_tree.query(x[self.rim])[1]
        goal = np.where(self.corner[:, None], self.pattern.place[self.rim] / self.scale, self.curve[at])
        way = np.where(self.corner[:, None], 0.0, self.along[at])
        left = x[self.rim] - goal
        left = left - dots(left, way)[:, None] * way
        for i in range(3):
            value = np.eye(3)[i] - way[:, [i]] * way
            rows.add(left[:, i], (self._x(self.rim), value), weight=2.0 * self.weights.close)

    def _fair(self, rows: _Rows, x: FloatArray, up: FloatArray) -> None:
        """Knots in the middle of their neighbours, as seen from above."""
        smooth, off = self.smooth, np.asarray(self.smooth @ x)
        column = (3 * smooth.indices[:, None] + np.arange(3)).reshape(-1)
        row, size = np.repeat(np.arange(self.knots), np.diff(smooth.indptr)), 3 * np.diff(smooth.indptr)
        moved, every = x - self.pattern.place / self.scale, np.arange(self.knots)
        axis = np.eye(3)[np.argmin(np.abs(up), axis=1)]
        one = unit(np.cross(up, axis))
        for way in (one, np.cross(up, one)):
            value = self.weights.fair * (smooth.data[:, None] * way[row]).reshape(-1)
            rows.add_uneven(self.weights.fair * dots(off, way), size, column, value)
            rows.add(dots(moved, way), (self._x(every), way), weight=self.weights.stay)

    def _hinges(self, rows: _Rows, x: FloatArray, w: FloatArray, n: FloatArray) -> None:
        """What counts only where it is not kept: long ways, short or turned edges, hollow corners."""
        gain, t = self.weights.hinge, self.thickness
        size = np.linalg.norm(w, axis=1)
        over = np.flatnonzero(size > _AIM)
        rows.add(size[over] - _AIM, (self._w(over), w[over] / size[over, None]), weight=gain)
        start, end, u = self.joint[:, 2], self.joint[:, 3], self.reference
        for share in (0.0, t):
            long = dots(x[end] - x[start] + share * (w[end] - w[start]), u)
            short = np.flatnonzero(long < 1.3 * self.least)
            one, two, v = start[short], end[short], u[short]
            terms = [(self._x(one), -v), (self._x(two), v)]
            if share:
                terms += [(self._w(one), -share * v), (self._w(two), share * v)]
            rows.add(long[short] - 1.3 * self.least, *terms, weight=gain)
        self._open(rows, x, w, n)
        before, at, after = self.turn[self.bent].T
        up = n[self.face[self.bent]]
        e, h = x[at] - x[before], x[after] - x[at]
        size = np.maximum(np.linalg.norm(e, axis=1) * np.linalg.norm(h, axis=1), 1e-3)
        sine = columns(np.cross(e, h).T, up.T) / size
        hollow = np.flatnonzero(sine < _CONVEX)
        one, two = np.cross(h, up)[hollow] / size[hollow, None], np.cross(up, e)[hollow] / size[hollow, None]
        b, a, c = before[hollow], at[hollow], after[hollow]
        terms = [(self._x(a), one - two), (self._x(b), -one), (self._x(c), two)]
        rows.add(sine[hollow] - _CONVEX, *terms, weight=0.5 * gain)

    def _open(self, rows: _Rows, x: FloatArray, w: FloatArray, n: FloatArray) -> None:
        """Every side of both faces is seen from the middle of its corners, so that no outline crosses."""
        one, two, f = self.knot, self.turn[:, 2], self.face
        for share in (0.0, self.thickness):
            y = x + share * w
            sums = np.stack([np.bincount(f, weights=y[one, i]) for i in range(3)], axis=1)
            centre = (sums / np.bincount(f)[:, None])[f]
            p, q = y[one] - centre, y[two] - centre
            size = np.maximum(np.linalg.norm(q - p, axis=1), 0.1)
            height = columns(np.cross(p, q).T, n[f].T) / size
            low = np.flatnonzero(height < _SEEN)
            up = n[f[low]]
            by_one = np.cross(q[low], up) / size[low, None]
            by_two = np.cross(up, p[low]) / size[low, None]
            terms = [(self._x(one[low]), by_one), (self._x(two[low]), by_two)]
            if share:
                terms += [(self._w(one[low]), share * by_one), (self._w(two[low]), share * by_two)]
            rows.add(height[low] - _SEEN, *terms, weight=self.weights.hinge)

    def exact(self) -> None:
        """Newton's method, each step the shortest, onto planes that hold their knots to rounding."""
        best = np.inf
        for _ in range(_EXACT):
            rows = _Rows()
            self._planes(rows, self.z, 1.0)
            matrix, rest = rows.matrix(len(self.z))
            worst = float(np.abs(rest).max())
            if worst >= 0.5 * best and worst < 1e-13:
                break
            best = min(best, worst)
            square = normal_equations(csr_array(matrix.T.tocsr()), 1e-6)
            self.z = self.z - matrix.T @ symmetric_factor(square).solve(rest)
        n = self.split(self.z)[2]
        n /= np.linalg.norm(n, axis=1, keepdims=True)


_SETTLED: Final = 1e-4
"""Rounds end when unknowns move by no more: knots in spacings of panels; some 0.1 mm."""
_RESTLESS: Final = 1e-3
"""Share of the unknowns that may move up to ten times as far then: knots half-way between two vertices of the
surface go to and fro for ever."""
_SOLVED: Final = 1e-9
"""What is left of a system, over its right side, where it counts as solved."""
_MOST_STEPS: Final = 10
"""Steps of conjugate gradients at most: so many cost less than factors."""
_SEEN: Final = 0.1
"""Height of the middle of a panel over the lines of its sides, in spacings."""
_CONVEX: Final = 0.08
"""Sine of the least turn at a corner of a panel that is to be convex."""


def _by_former(square: csc_array, right: FloatArray, factor: SuperLU) -> FloatArray | None:
    """The solution of a symmetric positive system by conjugate gradients, led by the factors of a former one
    much like it, or None where that takes longer than factors of its own."""
    former = LinearOperator(square.shape, factor.solve, dtype=np.float64)
    step, missed = cg(square, right, rtol=_SOLVED, maxiter=_MOST_STEPS, M=former)
    return None if missed else np.asarray(step)


def symmetric_factor(square: csc_array) -> SuperLU:
    """Factors of a symmetric positive matrix."""
    return splu(square, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
