"""Planar panels near a surface by guided projection.

Unknowns are the knots, the displacement of each knot for a unit offset of all planes, and the planes. All
requirements are at most quadratic in them, so a few iterations of sparse Gauss-Newton solve them. Lengths are
in spacings during the solution.

Source: C. Tang et al., Form-finding with polyhedral meshes made simple, ACM TOG 33, 2014.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import LinearOperator, SuperLU, cg, splu
from scipy.spatial import KDTree

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, column_dots, dots, unit
from planner.geometry.even_points import FineSurface
from planner.geometry.panel_pattern import PanelPattern, panel_joints
from planner.geometry.rulings import boundary_rings

MAX_OFFSET_LENGTH_FACTOR: Final = 1.15
"""Maximum length of offset edges, in thicknesses."""
COPLANAR_TOLERANCE: Final = 1e-7
"""Panels whose normals differ by less than this [rad] are coplanar."""
_OFFSET_LENGTH_GOAL: Final = 1.10
"""Length of offset edges that the iterations aim at, so that the exact planes keep the limit."""
_MAX_EXACT_ITERATIONS: Final = 12
"""Maximum number of Newton iterations onto exact planes."""
_GROUND_TOLERANCE: Final = 0.1
"""Rim knots that start nearer to the ground than this, in spacings, stay on it."""


@dataclasses.dataclass(frozen=True)
class PlanarityWeights:
    """Weights of the requirements, for lengths in spacings and unit directions.

    Attributes:
        plane: Panels are planar.
        close: Knots are on the surface.
        normal: Panels have the surface's normals, so that they do not fold.
        offset: Offset edges are upright.
        fairness: Knots are at the centre of their neighbours.
        position: Knots stay where they started.
        hinge: Limits are kept.
        damping: Unknowns change slowly.
        even: Offset planes of quads meet at one point, which is not necessary.
        max_iterations: Maximum number of iterations.
    """

    plane: float = 20.0
    close: float = 1.0
    normal: float = 1.5
    offset: float = 0.1
    fairness: float = 0.02
    position: float = 0.2
    hinge: float = 4.0
    damping: float = 0.2
    even: float = 0.0
    max_iterations: int = 40


_WEIGHTS: Final = PlanarityWeights()


@dataclasses.dataclass(frozen=True)
class PlanarFaces:
    """Planes of a pattern's panels.

    Attributes:
        pattern: The pattern.
        normal: Unit normals (N, 3).
        distance: Distances (N,) [m]: normal . x = distance.
        knot: Knots (K, 3) [m] in the planes of their panels.
        offset_direction: Displacement of each knot for a unit offset of the planes (K, 3).
        on_ground: Knots that are kept level (K,).
        sharp: Rim knots at which a quad ends in a point (K,). Sides on the rim next to them must not tilt
            beyond the displacements.
    """

    pattern: PanelPattern
    normal: FloatArray
    distance: FloatArray
    knot: FloatArray
    offset_direction: FloatArray
    on_ground: BoolArray
    sharp: BoolArray


@dataclasses.dataclass(frozen=True, eq=False)
class PanelCells:
    """Cells of a surface, one for each of N panels.

    Attributes:
        centre: Centres (N, 3) [m].
        normal: Unit normals of the surface at the centres (N, 3).
        is_convex: Whether each panel should be convex (N,).
    """

    centre: FloatArray
    normal: FloatArray
    is_convex: BoolArray


@dataclasses.dataclass(frozen=True)
class PanelRequirements:
    """Requirements on thick planar panels.

    Attributes:
        thickness: Thickness along the normals of the surface [m], negative against them.
        min_edge: Minimum length of edges of both faces [m].
        ground: Height [m] at which a rim on the ground is kept level, None without ground.
    """

    thickness: float
    min_edge: float = 0.05
    ground: float | None = None


def planarise(
    surface: FineSurface,
    pattern: PanelPattern,
    cells: PanelCells,
    required: PanelRequirements,
    weights: PlanarityWeights = _WEIGHTS,
) -> PlanarFaces:
    """Return exact planes of the panels of a pattern on a surface.

    Limits are soft here. A check of the panels decides whether they are kept.

    Args:
        surface: The surface.
        pattern: Pattern of the panels.
        cells: Cells of the panels.
        required: Requirements on the panels.
        weights: Weights of the requirements.
    """
    solver = _ProjectionSolver(surface, pattern, cells, required, weights)
    for _ in range(weights.max_iterations):
        changes = solver.iterate()
        if (
            np.quantile(changes, 1.0 - _OSCILLATING_FRACTION) < _CONVERGENCE_LIMIT
            and changes.max() < 10.0 * _CONVERGENCE_LIMIT
        ):
            break
    solver.exact()
    x, w, n, d = solver.split(solver.unknowns)
    distance = solver.scale * (d + dots(n, solver.centre))
    w = w if pattern.quads else _square_offsets(pattern, n, x, w)
    on_ground = np.zeros(solver.knots, dtype=np.bool_)
    on_ground[solver.ground_knots] = True
    sharp = pattern.pointed_knots & pattern.quads
    return PlanarFaces(pattern, n, distance, solver.scale * x, w, on_ground, sharp)


def _square_offsets(
    pattern: PanelPattern, normal: FloatArray, knot: FloatArray, offsets: FloatArray
) -> FloatArray:
    """Return the displacements (K, 3), with square sides between coplanar panels.

    Planes of coplanar panels do not define the plane of the side between them. Here it is normal to both, so
    the displacements at its ends are in the plane of the edge and the panels' normal.
    """
    squared = offsets.copy()
    for a, b, start, end in panel_joints(pattern).tolist():
        if np.linalg.norm(normal[a] - normal[b]) > COPLANAR_TOLERANCE:
            continue
        side = unit(np.cross(knot[end] - knot[start], normal[a]))
        for k in (start, end):
            third_panel = next((p for p in pattern.panels[k].tolist() if p >= 0 and p not in (a, b)), None)
            if third_panel is not None:
                matrix = np.stack([normal[a], normal[third_panel], side])
                # three coplanar panels determine only one component, which least squares find
                squared[k] = np.linalg.lstsq(matrix, np.array([1.0, 1.0, 0.0]), rcond=COPLANAR_TOLERANCE)[0]
    return squared


class _JacobianRows:
    """Rows of a sparse Jacobian with their residuals, collected in order.

    Attributes:
        column: Columns of all terms, row by row.
        value: Values of these terms.
        size: Number of terms of each row.
        residual: Residual of each row.
    """

    def __init__(self) -> None:
        self.column: list[IntArray] = []
        self.value: list[FloatArray] = []
        self.size: list[IntArray] = []
        self.residual: list[FloatArray] = []

    def add(self, residual: FloatArray, *terms: tuple[IntArray, FloatArray], weight: float = 1.0) -> None:
        """Add rows with residuals (M,). Each of the terms has columns (M, C) and values (M, C)."""
        columns = np.concatenate([column for column, _ in terms], axis=1)
        self.column.append(columns.reshape(-1))
        self.value.append(weight * np.concatenate([value for _, value in terms], axis=1).reshape(-1))
        self.size.append(np.full(len(residual), columns.shape[1]))
        self.residual.append(weight * residual)

    def add_uneven(self, residual: FloatArray, size: IntArray, column: IntArray, value: FloatArray) -> None:
        """Add rows with residuals (M,) and ``size`` (M,) terms each, whose lists follow each other."""
        self.column.append(column)
        self.value.append(value)
        self.size.append(size)
        self.residual.append(residual)

    def matrix(self, columns: int) -> tuple[csr_array, FloatArray]:
        """Return the Jacobian, with unsorted columns, and the residuals."""
        residual = np.concatenate(self.residual)
        start = np.concatenate([[0], np.cumsum(np.concatenate(self.size))])
        parts = np.concatenate(self.value), np.concatenate(self.column), start
        return csr_array(parts, shape=(len(residual), columns)), residual


def normal_equations(matrix: csr_array, steady: float) -> csc_array:
    """Return ``matrix.T @ matrix`` plus the square of ``steady`` on its diagonal, with sorted columns.

    Args:
        matrix: Jacobian.
        steady: Damping.
    """
    count = matrix.shape[1]
    damping_rows = csr_array(
        (np.full(count, steady), np.arange(count), np.arange(count + 1)), shape=(count, count)
    )
    damped = vstack([matrix, damping_rows], format="csr")
    # the conversion to CSC sorts the indices that the product leaves unsorted
    return csc_array(csr_array(damped.T.tocsr() @ damped).tocsc())


class _ProjectionSolver:
    """Gauss-Newton solver for the planes of a pattern.

    The vector of unknowns has the knots x, their displacements w for a unit offset, the normals n of the
    planes, and the distances d of the planes from the centres of their cells along n. Lengths are in
    spacings.
    """

    def __init__(
        self,
        surface: FineSurface,
        pattern: PanelPattern,
        cells: PanelCells,
        required: PanelRequirements,
        weights: PlanarityWeights,
    ) -> None:
        centre, normal, ground = cells.centre, cells.normal, required.ground
        scale = self.scale = surface.spacing
        self.weights, self.pattern = weights, pattern
        self.thickness, self.min_edge = required.thickness / scale, required.min_edge / scale
        self.centre, self.target_normal = centre / scale, normal
        self.knots, self.panels = len(pattern.position), len(centre)
        self.face = np.repeat(np.arange(self.panels), [len(ring) for ring in pattern.ring])
        self.knot = np.concatenate(pattern.ring)
        self.factor: SuperLU | None = None
        self.tree = KDTree(surface.mesh.vertices / scale)
        self.surface_points, self.surface_normals = surface.mesh.vertices / scale, surface.normal
        self.rim = np.flatnonzero(pattern.on_rim)
        rings = boundary_rings(surface.mesh)
        curve = np.concatenate([surface.mesh.vertices[ring] for ring in rings]) / scale
        step = np.concatenate(
            [np.roll(surface.mesh.vertices[ring], -1, axis=0) - surface.mesh.vertices[ring] for ring in rings]
        )
        self.curve, self.curve_tangent, self.rim_tree = curve, unit(step), KDTree(curve)
        self.ground = 0.0 if ground is None else ground / scale
        height = np.abs(pattern.position[self.rim, 2] / scale - self.ground)
        self.ground_knots = self.rim[(height < _GROUND_TOLERANCE) & (ground is not None)]
        self.level_knots = self.ground_knots[pattern.pointed_knots[self.ground_knots]]
        self.corner = pattern.corner[self.rim]
        self.joint = panel_joints(pattern)
        across = centre[self.joint[:, 1]] - centre[self.joint[:, 0]]
        self.reference = unit(np.cross(normal[self.joint[:, 0]] + normal[self.joint[:, 1]], across))
        self._prepare_smoothing()
        triples = [np.stack([np.roll(ring, 1), ring, np.roll(ring, -1)], axis=1) for ring in pattern.ring]
        self.corner_triples = np.concatenate(triples)
        self.convex_corners = np.flatnonzero(cells.is_convex[self.face])
        x = pattern.position / scale
        self.unknowns = np.concatenate(
            [x.reshape(-1), self._upright(x).reshape(-1), normal.reshape(-1), np.zeros(self.panels)]
        )

    def _prepare_smoothing(self) -> None:
        """Prepare the means of neighbours of inner knots, and of neighbours along the rim of rim knots."""
        ends = np.concatenate([np.stack([ring, np.roll(ring, -1)], axis=1) for ring in self.pattern.ring])
        side = np.concatenate(self.pattern.across)
        on_rim = np.zeros(self.knots, dtype=np.bool_)
        on_rim[self.rim] = True
        directed = np.concatenate([ends, ends[:, ::-1]])
        keep = ~on_rim[directed[:, 0]] | np.concatenate([side < 0, side < 0])
        directed = np.unique(directed[keep], axis=0)
        count = np.bincount(directed[:, 0], minlength=self.knots)
        mean = csr_array(
            (1.0 / count[directed[:, 0]], (directed[:, 0], directed[:, 1])), shape=(self.knots, self.knots)
        )
        self.smooth = csr_array(diags_array(np.ones(self.knots)) - mean)

    def _upright(self, x: FloatArray) -> FloatArray:
        """Return the normals of the surface at its vertices nearest to points (N, 3)."""
        return self.surface_normals[self.tree.query(x)[1]]

    def split(self, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x (K, 3), w (K, 3), n (N, 3) and d (N,) of a vector of unknowns, as views."""
        k, n = 3 * self.knots, 3 * self.panels
        return (
            z[:k].reshape(-1, 3),
            z[k : 2 * k].reshape(-1, 3),
            z[2 * k : 2 * k + n].reshape(-1, 3),
            z[2 * k + n :],
        )

    def _x(self, knot: IntArray) -> IntArray:
        """Return the columns (M, 3) of knots."""
        return 3 * knot[:, None] + np.arange(3)

    def _w(self, knot: IntArray) -> IntArray:
        """Return the columns (M, 3) of displacements of knots."""
        return 3 * (self.knots + knot[:, None]) + np.arange(3)

    def _n(self, face: IntArray) -> IntArray:
        """Return the columns (M, 3) of normals."""
        return 3 * (2 * self.knots + face[:, None]) + np.arange(3)

    def _d(self, face: IntArray) -> IntArray:
        """Return the columns (M, 1) of distances."""
        return (6 * self.knots + 3 * self.panels + face)[:, None]

    def _planes(self, rows: _JacobianRows, z: FloatArray, weight: float) -> None:
        """Add rows: knots in their planes, unit offsets, the ground, unit normals."""
        x, w, n, d = self.split(z)
        f, k = self.face, self.knot
        offset = x[k] - self.centre[f]
        minus = -np.ones((len(f), 1))
        rows.add(
            dots(n[f], offset) - d[f],
            (self._x(k), n[f]),
            (self._n(f), offset),
            (self._d(f), minus),
            weight=weight,
        )
        if self.pattern.quads:
            self._sides(rows, x, w, weight)
        else:
            rows.add(dots(n[f], w[k]) - 1.0, (self._w(k), n[f]), (self._n(f), w[k]), weight=weight)
        ones = np.ones((len(self.ground_knots), 1))
        rows.add(
            x[self.ground_knots, 2] - self.ground, (self._x(self.ground_knots)[:, [2]], ones), weight=weight
        )
        rows.add(0.5 * (dots(n, n) - 1.0), (self._n(np.arange(len(n))), n), weight=weight)

    def _sides(self, rows: _JacobianRows, x: FloatArray, w: FloatArray, weight: float) -> None:
        """Add rows of quads: the displacements of both ends of a joint are coplanar with it.

        Those of pointed knots on the ground are level.
        """
        start, end = self.joint[:, 2:].T
        e, a, b = x[end] - x[start], w[start], w[end]
        across = np.cross(a, b)
        terms = [(self._x(start), -across), (self._x(end), across)]
        terms += [(self._w(start), np.cross(b, e)), (self._w(end), np.cross(e, a))]
        rows.add(dots(e, across), *terms, weight=weight)
        level = self.level_knots
        rows.add(w[level, 2], (self._w(level)[:, [2]], np.ones((len(level), 1))), weight=weight)

    def iterate(self) -> FloatArray:
        """Do one Gauss-Newton iteration over all requirements, and return the change of each unknown."""
        x, w, n, _ = self.split(self.unknowns)
        rows, g = _JacobianRows(), self.weights
        self._planes(rows, self.unknowns, g.plane)
        nearest = self.tree.query(x)[1]
        up = self.surface_normals[nearest]
        all_knots = np.arange(self.knots)
        rows.add(dots(up, x - self.surface_points[nearest]), (self._x(all_knots), up), weight=g.close)
        self._rims(rows, x)
        if self.pattern.quads:
            f, k = self.face, self.knot
            rows.add(dots(n[f], w[k]) - 1.0, (self._w(k), n[f]), (self._n(f), w[k]), weight=g.even)
        for i in range(3):
            ones = np.ones((self.panels, 1))
            rows.add(
                n[:, i] - self.target_normal[:, i],
                (self._n(np.arange(self.panels))[:, [i]], ones),
                weight=g.normal,
            )
            ones = np.ones((self.knots, 1))
            rows.add(w[:, i] - up[:, i], (self._w(all_knots)[:, [i]], ones), weight=g.offset)
        self._fair(rows, x, up)
        self._limits(rows, x, w, n)
        matrix, residual = rows.matrix(len(self.unknowns))
        square, gradient = normal_equations(matrix, g.damping), matrix.T @ residual
        step = None if self.factor is None else _solve_preconditioned(square, gradient, self.factor)
        if step is None:
            self.factor = factor_symmetric(square)
            step = self.factor.solve(gradient)
        self.unknowns = self.unknowns - step
        return np.abs(step)

    def _rims(self, rows: _JacobianRows, x: FloatArray) -> None:
        """Add rows: rim knots are on the tangents of the surface's boundary, and corners stay in place."""
        nearest = self.rim_tree.query(x[self.rim])[1]
        goal = np.where(
            self.corner[:, None], self.pattern.position[self.rim] / self.scale, self.curve[nearest]
        )
        tangent = np.where(self.corner[:, None], 0.0, self.curve_tangent[nearest])
        residual = x[self.rim] - goal
        residual = residual - dots(residual, tangent)[:, None] * tangent
        for i in range(3):
            value = np.eye(3)[i] - tangent[:, [i]] * tangent
            rows.add(residual[:, i], (self._x(self.rim), value), weight=2.0 * self.weights.close)

    def _fair(self, rows: _JacobianRows, x: FloatArray, up: FloatArray) -> None:
        """Add rows: knots at the centre of their neighbours, seen from above."""
        smooth, laplacian = self.smooth, np.asarray(self.smooth @ x)
        column = (3 * smooth.indices[:, None] + np.arange(3)).reshape(-1)
        row, size = np.repeat(np.arange(self.knots), np.diff(smooth.indptr)), 3 * np.diff(smooth.indptr)
        moved, all_knots = x - self.pattern.position / self.scale, np.arange(self.knots)
        axis = np.eye(3)[np.argmin(np.abs(up), axis=1)]
        first_tangent = unit(np.cross(up, axis))
        for tangent in (first_tangent, np.cross(up, first_tangent)):
            value = self.weights.fairness * (smooth.data[:, None] * tangent[row]).reshape(-1)
            rows.add_uneven(self.weights.fairness * dots(laplacian, tangent), size, column, value)
            rows.add(dots(moved, tangent), (self._x(all_knots), tangent), weight=self.weights.position)

    def _limits(self, rows: _JacobianRows, x: FloatArray, w: FloatArray, n: FloatArray) -> None:
        """Add rows of violated limits: long displacements, short or inverted edges, concave corners."""
        gain, t = self.weights.hinge, self.thickness
        size = np.linalg.norm(w, axis=1)
        over = np.flatnonzero(size > _OFFSET_LENGTH_GOAL)
        rows.add(size[over] - _OFFSET_LENGTH_GOAL, (self._w(over), w[over] / size[over, None]), weight=gain)
        start, end, u = self.joint[:, 2], self.joint[:, 3], self.reference
        for height in (0.0, t):
            edge_length = dots(x[end] - x[start] + height * (w[end] - w[start]), u)
            short = np.flatnonzero(edge_length < 1.3 * self.min_edge)  # a margin, because limits are soft
            start_knots, end_knots, v = start[short], end[short], u[short]
            terms = [(self._x(start_knots), -v), (self._x(end_knots), v)]
            if height:
                terms += [(self._w(start_knots), -height * v), (self._w(end_knots), height * v)]
            rows.add(edge_length[short] - 1.3 * self.min_edge, *terms, weight=gain)
        self._visible_sides(rows, x, w, n)
        previous, at, following = self.corner_triples[self.convex_corners].T
        up = n[self.face[self.convex_corners]]
        e, h = x[at] - x[previous], x[following] - x[at]
        size = np.maximum(np.linalg.norm(e, axis=1) * np.linalg.norm(h, axis=1), 1e-3)
        sine = column_dots(np.cross(e, h).T, up.T) / size
        concave = np.flatnonzero(sine < _MIN_CONVEX_SINE)
        by_e = np.cross(h, up)[concave] / size[concave, None]
        by_h = np.cross(up, e)[concave] / size[concave, None]
        b, a, c = previous[concave], at[concave], following[concave]
        terms = [(self._x(a), by_e - by_h), (self._x(b), -by_e), (self._x(c), by_h)]
        rows.add(sine[concave] - _MIN_CONVEX_SINE, *terms, weight=0.5 * gain)

    def _visible_sides(self, rows: _JacobianRows, x: FloatArray, w: FloatArray, n: FloatArray) -> None:
        """Add rows: every side of both faces is visible from the centre of its corners.

        Then no outline crosses itself.
        """
        start, end, f = self.knot, self.corner_triples[:, 2], self.face
        for offset_height in (0.0, self.thickness):
            y = x + offset_height * w
            sums = np.stack([np.bincount(f, weights=y[start, i]) for i in range(3)], axis=1)
            centre = (sums / np.bincount(f)[:, None])[f]
            p, q = y[start] - centre, y[end] - centre
            size = np.maximum(np.linalg.norm(q - p, axis=1), 0.1)
            height = column_dots(np.cross(p, q).T, n[f].T) / size
            low = np.flatnonzero(height < _MIN_SIDE_HEIGHT)
            up = n[f[low]]
            by_start = np.cross(q[low], up) / size[low, None]
            by_end = np.cross(up, p[low]) / size[low, None]
            terms = [(self._x(start[low]), by_start), (self._x(end[low]), by_end)]
            if offset_height:
                terms += [
                    (self._w(start[low]), offset_height * by_start),
                    (self._w(end[low]), offset_height * by_end),
                ]
            rows.add(height[low] - _MIN_SIDE_HEIGHT, *terms, weight=self.weights.hinge)

    def exact(self) -> None:
        """Run Newton's method with minimum-norm steps onto planes that contain their knots up to rounding."""
        min_residual = np.inf
        for _ in range(_MAX_EXACT_ITERATIONS):
            rows = _JacobianRows()
            self._planes(rows, self.unknowns, 1.0)
            matrix, residual = rows.matrix(len(self.unknowns))
            max_residual = float(np.abs(residual).max())
            if max_residual >= 0.5 * min_residual and max_residual < 1e-13:
                break
            min_residual = min(min_residual, max_residual)
            square = normal_equations(csr_array(matrix.T.tocsr()), 1e-6)
            self.unknowns = self.unknowns - matrix.T @ factor_symmetric(square).solve(residual)
        n = self.split(self.unknowns)[2]
        n /= np.linalg.norm(n, axis=1, keepdims=True)


_CONVERGENCE_LIMIT: Final = 1e-4
"""Convergence limit of the unknowns: of knots in spacings of panels, about 0.1 mm."""
_OSCILLATING_FRACTION: Final = 1e-3
"""Fraction of the unknowns that may change by up to ten times more.

Knots half-way between two vertices of the surface oscillate forever.
"""
_CG_TOLERANCE: Final = 1e-9
"""Relative residual at which a linear system counts as solved."""
_MAX_CG_STEPS: Final = 10
"""Maximum number of conjugate gradient steps. That many cost less than a factorisation."""
_MIN_SIDE_HEIGHT: Final = 0.1
"""Minimum height of a panel's centre over the lines of its sides, in spacings."""
_MIN_CONVEX_SINE: Final = 0.08
"""Sine of the minimum angle at a corner of a convex panel."""


def _solve_preconditioned(square: csc_array, right_side: FloatArray, factor: SuperLU) -> FloatArray | None:
    """Solve a symmetric positive system by conjugate gradients, preconditioned by an earlier factorisation.

    Returns None if that takes longer than a new factorisation.
    """
    preconditioner = LinearOperator(square.shape, factor.solve, dtype=np.float64)
    step, not_converged = cg(square, right_side, rtol=_CG_TOLERANCE, maxiter=_MAX_CG_STEPS, M=preconditioner)
    return None if not_converged else np.asarray(step)


def factor_symmetric(square: csc_array) -> SuperLU:
    """Return the factorisation of a symmetric positive matrix."""
    return splu(square, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
