"""Sections of a face across the sweep, and the smooth family of elasticas with weight that meets them.

**Planes.** All planes across the sweep contain the wire's direction, which is level in the block. Plane
frame: x along the wire from the first arm to the second, y up in the plane, z = x cross y, which is opposite
to the sweep. Everything is in the stock frame.

**Family**: one parameter, one smooth spline over the sweep. The state of the wire's middle (x, y, theta, k,
Fx, Fy) is a cubic B-spline of the sweep position p. The shapes, including the free ends of the wire,
therefore change smoothly, and sections that cover the face only in part are completed by their neighbours.
The coefficients minimise squared normal distances (as in ``fit``) by Gauss-Newton. Each section is weighted
by the area of the face that it represents. Small penalties discourage bent free ends and differences between
neighbouring coefficients. Inside this module the unit of length is the length of the wire.

**Ends.** A face can be slanted at an end, as that of a panel whose block is tilted towards it. Its sections
become shorter towards the corner, over a distance that may be less than the section spacing. The spacing
therefore decreases towards both ends, so that corners are met like the rest.
"""

import dataclasses

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from planner.geometry.arrays import FloatArray, IndexArray, IntArray, from_parts
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import slice_mesh
from planner.processes.hotwire.plan.elastica.equations import (
    PicardStart,
    WireSolution,
    gauss_nodes,
    integrate_wire,
    legendre,
    node_counts,
)
from planner.processes.hotwire.plan.elastica.fit import TAIL_WEIGHT, CurveFit, fit_curves

SECTION_POINTS = 41
"""Number of points per section in the fit."""
_END_HALVINGS = 4
"""Number of halved spacings at both ends of a face: sections at 1/2, 1/4, ... of a step from the end."""
_POSITION_ITERATIONS = 12
"""Number of fixed-point iterations that find the tilted plane through a point. Each reduces the error."""


@dataclasses.dataclass(frozen=True)
class Spine:
    """A one-parameter family of planes.

    Attributes:
        direction: Direction of the sweep (3,). The parameter p [m] is the position along it.
        across: Position of the planes' origins along the direction of the wire [m].
        height: Spline of the spine's height over p on [lower, upper], extrapolated linearly. None for upright
            parallel planes.
        lower: Lower end of the spline [m].
        upper: Upper end of the spline [m].
    """

    direction: FloatArray
    across: float
    height: BSpline | None = None
    lower: float = 0.0
    upper: float = 0.0

    @property
    def wire(self) -> FloatArray:
        """Unit vector (3,) along the wire, from the first arm to the second."""
        return np.array([self.direction[1], -self.direction[0], 0.0])

    def frames(self, p: FloatArray) -> FloatArray:
        """Return the frames (K, 4, 4) of the planes at sweep positions p (K,) [m]."""
        up = np.array([0.0, 0.0, 1.0])
        level, slope = self._height(p)
        size = np.hypot(1.0, slope)[:, None]
        y = (up - slope[:, None] * self.direction) / size
        x = np.broadcast_to(self.wire, y.shape)
        rotation = np.stack([x, y, np.cross(x, y)], axis=-1)
        origin = p[:, None] * self.direction + self.across * self.wire + level[:, None] * up
        return from_parts(rotation, origin)

    def _height(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the height (K,) [m] of the spine at p (K,), and its slope (K,)."""
        if self.height is None:
            return np.zeros_like(p), np.zeros_like(p)
        inside = np.clip(p, self.lower, self.upper)
        slope = self.height(inside, nu=1)
        return self.height(inside) + slope * (p - inside), slope

    def positions(self, points: FloatArray) -> FloatArray:
        """Return the sweep positions (V,) [m] of the planes through points (V, 3)."""
        projected = np.asarray(points @ self.direction)
        p = projected
        for _ in range(0 if self.height is None else _POSITION_ITERATIONS):
            level, slope = self._height(p)
            p = projected + slope * (points[:, 2] - level)
        return p


@dataclasses.dataclass(frozen=True)
class SectionSet:
    """Sections of a face in K planes.

    Attributes:
        p: Sweep positions (K,) [m].
        points: Points in plane coordinates, along increasing x (K, m, 2) [m].
        length: Length (K,) [m], 0 where the plane misses the face. The points are meaningless then.
        polyline_count: Number of separate polylines of each section (K,).
    """

    p: FloatArray
    points: FloatArray
    length: FloatArray
    polyline_count: IntArray

    def select(self, rows: IndexArray) -> "SectionSet":
        """Return a subset of the sections in the same order."""
        return SectionSet(self.p[rows], self.points[rows], self.length[rows], self.polyline_count[rows])

    @property
    def area(self) -> FloatArray:
        """Area (K,) [m^2] of the face that each section represents.

        It is the length of the section times the part of the sweep nearest to it.
        """
        bounds = np.concatenate([self.p[:1], 0.5 * (self.p[1:] + self.p[:-1]), self.p[-1:]])
        return self.length * np.diff(bounds)

    def distance_at_fraction(self, distance: FloatArray, fraction: float) -> float:
        """Return the distance [m] that a fraction of the face's area does not exceed.

        Args:
            distance: Distances of the points of the sections (K, m) [m].
            fraction: Fraction of the area.
        """
        order = np.argsort(distance, axis=None)
        weight = np.repeat(self.area, distance.shape[1])[order]
        middle = np.cumsum(weight) - 0.5 * weight
        return float(np.interp(fraction * weight.sum(), middle, distance.reshape(-1)[order]))


def sweep_direction(degrees: float) -> FloatArray:
    """Return the unit vector (3,) of a sweep at an angle from the block's x."""
    angle = np.deg2rad(degrees)
    return np.round(np.array([np.cos(angle), np.sin(angle), 0.0]), 15)


def make_spine(face: TriangleMesh, direction: FloatArray, normal: bool) -> Spine:
    """Return planes across the sweep over a face: upright, or normal to the face's spine.

    The spine is a least-squares spline through the mean heights of the face's upright sections. Sections
    shorter than half the median length do not count.

    Args:
        face: Surface of the face.
        direction: Direction of the sweep (3,).
        normal: Whether the planes are normal to the spine.
    """
    middle = 0.5 * (face.vertices.min(axis=0) + face.vertices.max(axis=0))
    upright = Spine(direction, float(middle @ np.array([direction[1], -direction[0], 0.0])))
    if not normal:
        return upright
    projected = face.vertices @ direction
    lower, upper = float(projected.min()), float(projected.max())
    p = np.linspace(lower, upper, 62)[1:-1]
    cut = cut_sections(face, upright, p)
    is_full = cut.length > 0.5 * np.median(cut.length[cut.length > 0])
    heights = cut.points[..., 1].mean(axis=1)
    knots = np.concatenate(
        [[p[is_full][0]] * 4, np.linspace(p[is_full][0], p[is_full][-1], 6)[1:-1], [p[is_full][-1]] * 4]
    )
    height = make_lsq_spline(p[is_full], heights[is_full], knots, k=3)
    return dataclasses.replace(
        upright, height=height, lower=float(p[is_full][0]), upper=float(p[is_full][-1])
    )


def section_positions(lower: float, upper: float, step: float, min_count: int, max_count: int) -> FloatArray:
    """Return sweep positions (K,) [m] for the sections of a face.

    The spacing is halved repeatedly towards both ends. No section lies at the ends themselves.

    Args:
        lower: Start of the face [m].
        upper: End of the face [m].
        step: Approximate spacing [m].
        min_count: Minimum number of spacings over the face.
        max_count: Maximum number of spacings over the face.
    """
    count = int(np.clip(np.ceil((upper - lower) / step), min_count, max_count))
    end_steps = 0.5 ** np.arange(_END_HALVINGS, -1, -1)
    steps = np.concatenate([end_steps, np.arange(2.0, count - 1.0), count - end_steps[::-1]])
    return lower + (upper - lower) / count * steps


def cut_sections(face: TriangleMesh, spine: Spine, p: FloatArray) -> SectionSet:
    """Return the sections of a face in the planes at p (K,) [m], sampled evenly over their length.

    If a plane meets the face in several polylines, they are joined to one curve in the order of x.
    """
    frames = spine.frames(p)
    cut = slice_mesh(face, frames[:, :3, 3], frames[:, :3, 2])
    points = np.zeros((len(p), SECTION_POINTS, 2))
    length = np.zeros(len(p))
    pieces = np.bincount(cut.plane, minlength=len(p)).astype(np.int64)
    first_polyline = np.searchsorted(cut.plane, np.arange(len(p) + 1))
    for k in np.nonzero(pieces)[0]:
        lines = [
            (cut.polyline(i) - frames[k, :3, 3]) @ frames[k, :3, :2]
            for i in range(first_polyline[k], first_polyline[k + 1])
        ]
        lines = [line if line[-1, 0] >= line[0, 0] else line[::-1] for line in lines]
        lines.sort(key=lambda line: float(line[:, 0].mean()))
        length[k], points[k] = _resample(lines)
    return SectionSet(p, points, length, pieces)


def _resample(lines: list[FloatArray]) -> tuple[float, FloatArray]:
    """Return the total length of polylines, and points (`SECTION_POINTS`, 2) evenly spaced along them.

    Gaps between polylines have no length.
    """
    steps = [np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T)]) for line in lines]
    arc_length = np.cumsum(np.concatenate(steps))
    line = np.concatenate(lines)
    samples = np.linspace(0.0, arc_length[-1], SECTION_POINTS)
    return float(arc_length[-1]), np.stack(
        [np.interp(samples, arc_length, line[:, i]) for i in range(2)], axis=-1
    )


_MAX_FIT_ITERATIONS = 25
"""Maximum number of Gauss-Newton steps."""
_END_WEIGHT = 3.0
"""Weight of the ends of a section, where neighbours meet, relative to its other points."""
_SECOND_DIFFERENCE_WEIGHT = np.array([1e-4, 1e-4, 1e-4, 3e-5, 1e-5, 1e-5])
"""Weight of second differences along the sweep, for each of the six parameters of a wire."""
_FIRST_DIFFERENCE_WEIGHT = np.array([0.0, 0.0, 3e-3, 1e-3, 3e-4, 3e-4])
"""Weight of first differences along the sweep where no section determines the wire."""
_CENTRE_WEIGHT = 1e-2
"""Weight of the distance between the wire's middle and the block's middle.

A wire that slides along itself meets a section equally well, so this costs no accuracy. It keeps both ends
equally far outside the block where sections end early.
"""
_TAIL_WEIGHT = 0.3 * TAIL_WEIGHT  # chosen: less straight ends are less sensitive to end errors


@dataclasses.dataclass(frozen=True)
class WireFamily:
    """Wires over a range of sweep positions.

    Attributes:
        spline: State of the wire's middle over p, with the length of the wire as the unit of length.
        length: Length of the wires [m].
        lower: Lower end of the range of p [m].
        upper: Upper end of the range of p [m].
    """

    spline: BSpline
    length: float
    lower: float
    upper: float

    def state(self, p: FloatArray) -> FloatArray:
        """Return states at the wire's middle (K, 6) [m, rad, 1/m, 1/m^2] in the planes at p (K,) [m].

        Outside the range the shape stays constant, and the position in the plane is extrapolated linearly.
        """
        inside = np.clip(p, self.lower, self.upper)
        value = self.spline(inside)
        value[:, :2] += self.spline(inside, nu=1)[:, :2] * (p - inside)[:, None]
        return np.asarray(value * _state_units(self.length))


@dataclasses.dataclass(frozen=True)
class FamilyFit:
    """A family fitted to K sections.

    Attributes:
        family: The wires.
        residual: Signed distances of the sections' points from the wires (K, m) [m], 0 where there is no
            section.
        foot: Arc lengths of the nearest points from the start of the wires (K, m) [m].
    """

    family: WireFamily
    residual: FloatArray
    foot: FloatArray


@dataclasses.dataclass(frozen=True)
class _FamilyProblem:
    """Least-squares problem of a family with c spline coefficients, in wire lengths."""

    table: FloatArray  # (K, c) basis of the spline at the sections
    points: FloatArray  # (K, m, 2) points of the sections
    weight: FloatArray  # (K,) weight of a section in the cost, sum 1
    load: FloatArray  # (K, 2) weight of the wire, q L^3
    tail_penalty: FloatArray  # (K,) penalty on bent ends
    covered: FloatArray  # (K, 2) arc lengths from the middle between which the wire is fitted to the section
    centre: float  # preferred x of the wire's middle
    end_weight: float  # weight of the first and last point of a section relative to the others
    smoothness_penalty: FloatArray  # (6 c, 6 c) penalty on differences of coefficients


@dataclasses.dataclass(frozen=True)
class FirstFit:
    """Single fits to some sections. They show early whether a wire meets the face at all.

    Attributes:
        rows: Indices of the fitted sections (R,).
        fit: Their fits.
    """

    rows: IndexArray
    fit: CurveFit


@dataclasses.dataclass(frozen=True)
class SectionWire:
    """A wire of one length in K planes.

    Attributes:
        load: Weight of the wire in the planes (K, 2) [1/m^3].
        length: Length of the wire [m].
    """

    load: FloatArray
    length: float


def fit_single_sections(sections: SectionSet, wire: SectionWire, count: int = 9) -> FirstFit:
    """Fit the wire separately to some of the sections, evenly distributed over the sweep.

    Sections shorter than 60 % of the median length are left out, because they determine the wire poorly.

    Args:
        sections: K sections.
        wire: The wire in their planes.
        count: Maximum number of fits.
    """
    covering = np.nonzero(sections.length > 0.6 * np.median(sections.length[sections.length > 0.0]))[0]
    selected = covering[np.unique(np.linspace(0, len(covering) - 1, count).astype(np.intp))]
    fit = fit_curves(
        sections.points[selected],
        np.full(len(selected), wire.length),
        wire.load[selected],
        None,
        0.5,
        TAIL_WEIGHT,
    )
    return FirstFit(selected, fit)


@dataclasses.dataclass(frozen=True)
class FamilyExtent:
    """Extent of a family of wires along the sweep, and its position along the wires.

    Attributes:
        lower: Lower end of the range of p that the family covers at least [m].
        upper: Upper end of that range [m].
        centre: Preferred position of the wire's middle along the wire's direction [m].
    """

    lower: float
    upper: float
    centre: float


def fit_family(
    sections: SectionSet,
    first: FirstFit,
    wire: SectionWire,
    extent: FamilyExtent,
    cells: int = 16,
    end_weight: float = _END_WEIGHT,
) -> FamilyFit:
    """Fit a family of wires to sections.

    Args:
        sections: K sections.
        first: Single fits to some of them.
        wire: The wire in the planes of the sections.
        extent: Range of p that the family covers at least, and its position along the wires.
        cells: Number of cells of the spline.
        end_weight: Weight of the ends of sections relative to their other points.

    Raises:
        ValueError: If no section can be fitted at all (see ``fit.fit_curves``).
    """
    length = wire.length
    lower = min(extent.lower, float(sections.p[0]))
    upper = max(extent.upper, float(sections.p[-1]))
    unit = _state_units(length)
    # even knots beyond both ends too, so that equal differences of coefficients form a straight line
    knots = lower + (upper - lower) / cells * np.arange(-3, cells + 4, dtype=np.float64)
    # knots[3] to knots[-4] is the range of the spline: set exactly, so that rounding excludes no section
    knots[3], knots[-4] = lower, upper
    table = BSpline.design_matrix(sections.p, knots, 3).toarray()
    has_section = sections.length > 0.0
    median_length = float(np.median(sections.length[has_section]))
    weight = sections.area / sections.area.sum()
    coefficient = _smoothing_coefficients(table[first.rows], first.fit.middle / unit)
    covered = np.nonzero(has_section)[0]
    job = _FamilyProblem(
        table,
        sections.points / length,
        weight,
        wire.load * length**3,
        _TAIL_WEIGHT**2 * (np.maximum(sections.length, 0.3 * median_length) / length) ** 3 * weight,
        np.zeros((len(sections.p), 2)),  # _gauss_newton replaces it
        extent.centre / length,
        end_weight,
        _smoothness_matrix(knots, float(sections.p[covered[0]]), float(sections.p[covered[-1]])),
    )
    coefficient, residual, foot = _gauss_newton(job, coefficient)
    spline = BSpline(knots, coefficient, 3, extrapolate=True)
    family = WireFamily(spline, length, float(sections.p[covered[0]]), float(sections.p[covered[-1]]))
    return FamilyFit(family, residual * length * has_section[:, None], (foot + 0.5) * length)


def _state_units(length: float) -> FloatArray:
    """Return the factors (6,) that convert a state (x, y, theta, k, Fx, Fy) from wire lengths to metres."""
    return np.array([length, length, 1.0, 1.0 / length, length**-2, length**-2])


def _smoothing_coefficients(table: FloatArray, values: FloatArray) -> FloatArray:
    """Return coefficients (c, 6) of the smoothing spline near values (K, 6), the first guess of a family.

    ``table`` (K, c) has the basis functions of the spline at the values. Squared second differences of the
    coefficients are penalised with a factor of 1e-2.
    """
    count = table.shape[1]
    second_difference = np.diff(np.eye(count), 2, axis=0)
    normal_matrix = table.T @ table + 1e-2 * second_difference.T @ second_difference
    return np.asarray(np.linalg.solve(normal_matrix, table.T @ values))


def _smoothness_matrix(knots: FloatArray, first: float, last: float) -> FloatArray:
    """Return the matrix (6 c, 6 c) of the quadratic penalty on differences of the c spline coefficients.

    The penalty keeps the shapes of neighbouring wires alike. Second differences are penalised everywhere.
    First differences of angle, curvature and force are penalised only more than two spline cells beyond the
    face.

    Args:
        knots: Knots of the spline [m].
        first: Sweep position of the first section that meets the face [m].
        last: Sweep position of the last one [m].
    """
    count = len(knots) - 4
    second_difference = np.diff(np.eye(count), 2, axis=0)
    first_difference = np.diff(np.eye(count), 1, axis=0)
    # sweep position of each coefficient: the mean of the inner knots of its basis function
    positions = np.array([knots[i + 1 : i + 4].mean() for i in range(count)])
    cell = positions[1] - positions[0]  # the first two cells beyond the face continue smoothly
    is_uncovered = ((positions[1:] < first - 2.0 * cell) | (positions[:-1] > last + 2.0 * cell)).astype(
        np.float64
    )
    penalty = np.zeros((count, 6, count, 6))
    for j in range(6):
        penalty[:, j, :, j] = (
            _SECOND_DIFFERENCE_WEIGHT[j] ** 2 * second_difference.T @ second_difference
            + _FIRST_DIFFERENCE_WEIGHT[j] ** 2 * (first_difference.T * is_uncovered) @ first_difference
        )
    return penalty.reshape(count * 6, count * 6)


def _gauss_newton(job: _FamilyProblem, coefficient: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit the family: minimise its cost from a first guess of the spline coefficients (c, 6).

    The ends beyond the sections, whose curvature the cost penalises, follow from the first guess and stay
    fixed.

    Returns:
        Coefficients (c, 6), signed distances of the sections' points from the wires (K, m), and arc lengths
        of the nearest points from the middles of the wires (K, m). Lengths are in wire lengths.
    """
    # Levenberg-Marquardt: (H + damp diag H) step = -gradient
    damping = 1e-6
    foot = _coarse_nearest_points(job, job.table @ coefficient)
    job = dataclasses.replace(job, covered=np.stack([foot.min(axis=1), foot.max(axis=1)], axis=1))
    cost, gradient, hessian, residual, foot = _evaluate(job, coefficient, foot)
    for _ in range(_MAX_FIT_ITERATIONS):
        scale = np.diag(hessian)
        damped = hessian + np.diag(damping * scale + 1e-13 * scale.max())
        step = -np.linalg.solve(damped, gradient).reshape(coefficient.shape)
        trial = _evaluate(job, coefficient + step, foot)
        if trial[0] < cost:  # the first item is the cost
            decrease = (cost - trial[0]) / cost
            coefficient = coefficient + step
            cost, gradient, hessian, residual, foot = trial
            damping = max(damping * 0.1, 1e-12)
            if decrease < 1e-4:
                break
        else:
            damping *= 30.0
            if damping > 1e6:
                break
    return coefficient, residual, foot


def _coarse_nearest_points(job: _FamilyProblem, state: FloatArray) -> FloatArray:
    """Return the arc lengths (K, m) of the wires' points nearest to the sections' points, as a first guess.

    They are counted from the middle of each wire, in wire lengths, and accurate to 1/240: the nearest of 121
    points along the wire is taken.

    Args:
        job: Sections and wires.
        state: States at the middles of the wires (K, 6).
    """
    sigma = np.linspace(0.0, 1.0, 121)
    wire = integrate_wire(state, np.ones(len(state)), job.load, anchor=0.5)
    points = wire.at(sigma)[..., :2]
    gap = np.sum((job.points[:, :, None] - points[:, None]) ** 2, axis=-1)
    return np.asarray(sigma[np.argmin(gap, axis=2)] - 0.5)


def _evaluate(
    job: _FamilyProblem, coefficient: FloatArray, foot: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Evaluate the cost of spline coefficients and its derivatives, for one iteration of the fit.

    The cost is the sum of weighted squared distances of the sections' points, of squared curvature of the
    free ends, of squared displacements of the middles from the centre, and of the penalty on differences.

    Args:
        job: Sections, weights and penalties.
        coefficient: Coefficients (c, 6).
        foot: Guess of the arc lengths of the nearest points from the middles of the wires (K, m).

    Returns:
        Cost (infinite if the wires diverge), half of its gradient (6 c,), Gauss-Newton matrix (6 c, 6 c),
        signed distances (K, m), and improved arc lengths of the nearest points (K, m).
    """
    # residuals n.(p - r) at the nearest points, and their derivatives with respect to the middle states
    state = job.table @ coefficient
    count = int(np.max(node_counts(state, np.ones(len(state)), job.load, base=14.0, per_wave=3.6)))
    grid = gauss_nodes(count)
    wire = integrate_wire(
        state, np.ones(len(state)), job.load, anchor=0.5, derivatives=True, start=PicardStart(count=count)
    )
    foot, distance, at_foot, table = _nearest_points(job.points, wire, foot)
    cos, sin = np.cos(at_foot[..., 2]), np.sin(at_foot[..., 2])
    position_derivatives = table @ (grid.to_coefficients @ np.concatenate([wire.d_x, wire.d_y], axis=-1))
    slope = np.empty((*distance.shape, 6))
    slope[..., 0], slope[..., 1] = sin, -cos
    slope[..., 2:] = (
        sin[..., None] * position_derivatives[..., :4] - cos[..., None] * position_derivatives[..., 4:]
    )
    weight = np.ones(distance.shape[1])
    weight[[0, -1]] = job.end_weight  # first and last point of each section
    point_weight = job.weight[:, None] * (weight / weight.sum())

    # per section: distances, curvature of the ends beyond the section, offset of the middle from the centre
    arc_length = grid.sigma - 0.5
    is_free_end = (arc_length < job.covered[:, :1]) | (arc_length > job.covered[:, 1:])
    penalty = job.tail_penalty[:, None] * grid.weight * is_free_end
    block = np.einsum("km,kmi,kmj->kij", np.broadcast_to(point_weight, distance.shape), slope, slope)
    vector = np.einsum("km,kmi->ki", point_weight * distance, slope)
    block[:, 2:, 2:] += np.einsum("kn,kni,knj->kij", penalty, wire.d_curvature, wire.d_curvature)
    vector[:, 2:] += np.einsum("kn,kni->ki", penalty * wire.curvature, wire.d_curvature)
    centre_error = state[:, 0] - job.centre
    block[:, 0, 0] += _CENTRE_WEIGHT**2 / len(state)
    vector[:, 0] += _CENTRE_WEIGHT**2 / len(state) * centre_error

    # chain rule to the spline coefficients, plus the quadratic penalty
    flat = coefficient.reshape(-1)
    hessian = np.einsum("ka,kij,kb->aibj", job.table, block, job.table, optimize=True).reshape(
        flat.size, flat.size
    )
    gradient = (job.table.T @ vector).reshape(-1) + job.smoothness_penalty @ flat
    cost = float(
        np.sum(point_weight * distance**2)
        + np.sum(penalty * wire.curvature**2)
        + _CENTRE_WEIGHT**2 * np.mean(centre_error**2)
        + flat @ job.smoothness_penalty @ flat
    )
    return (cost if np.isfinite(cost) else np.inf), gradient, hessian + job.smoothness_penalty, distance, foot


def _nearest_points(
    points: FloatArray, wire: WireSolution, foot: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Find the points of wires that are nearest to the points of their sections, by two Newton steps.

    The fit measures its residuals at these points. All lengths are in wire lengths. A nearest point is given
    by its arc length from the middle of its wire ("foot"), -0.5 to 0.5.

    Args:
        points: Points of the sections (K, m, 2).
        wire: The wires, solved on n Gauss nodes.
        foot: Guess of the arc lengths of the nearest points (K, m).

    Returns:
        ``foot``, the improved arc lengths (K, m); signed distances along the wire's normal (K, m);
        ``at_foot``, the states (x, y, theta, k) of the wire there (K, m, 4); and ``table`` (K, m, n), the
        values of the n Legendre polynomials there. The product of ``table`` with the Legendre coefficients of
        a function of arc length interpolates this function to the nearest points.
    """
    series = gauss_nodes(wire.count).to_coefficients @ np.stack(
        [wire.x, wire.y, wire.theta, wire.curvature], axis=-1
    )
    for iteration in range(3):
        table = legendre(foot + 0.5, wire.count)
        at_foot = table @ series
        gap = points - at_foot[..., :2]
        cos, sin = np.cos(at_foot[..., 2]), np.sin(at_foot[..., 2])
        distance = gap[..., 1] * cos - gap[..., 0] * sin
        if iteration < 2:
            along = gap[..., 0] * cos + gap[..., 1] * sin
            # Newton for along = 0 with d(along)/ds = -(1 - k distance). Near the centre of curvature the
            # derivative vanishes or changes its sign, so 1 - k distance is limited to 0.3 or more, and the
            # step to 0.1 wire lengths (both chosen).
            newton_scale = np.maximum(1.0 - at_foot[..., 3] * distance, 0.3)
            foot = np.clip(foot + np.clip(along / newton_scale, -0.1, 0.1), -0.5, 0.5)
    return foot, distance, at_foot, table
