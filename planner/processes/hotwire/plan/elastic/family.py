"""Sections of a face across the sweep, and the smooth family of heavy elasticas that meets them.

**Planes.** All planes across the sweep contain the wire's direction, which is level in the block.
Plane frame: x along the wire from the first arm to the second, y up in the plane, z = x cross y,
which is against the sweep. Everything is in the stock frame.

**Family**: one parameter, one smooth spline over the sweep. The state of the wire's middle (x, y,
theta, k, Fx, Fy) is a cubic B-spline of the place p, so the shapes, the wire's free ends included,
change smoothly, and what sections that cover the face only in part leave open follows from their
neighbours. The coefficients minimise squared normal distances (as in ``fit``) by Gauss-Newton, each
section weighed by the part of the face that it stands for, with small prices on bent free ends and on
unsteady coefficients. Lengths are in wire lengths inside.

**Ends.** A face that is slanted at an end, as a panel's is whose block leans to it, ends in sections that
grow shorter to its corner, over a way that may be less than the step between sections: towards both ends
they stand closer and closer, so corners are met as the rest is.
"""

import dataclasses

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from planner.geometry.arrays import FloatArray, IndexArray, IntArray, from_parts
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import slice_mesh
from planner.processes.hotwire.plan.elastica.equations import Flow, flow, legendre, node_counts, nodes
from planner.processes.hotwire.plan.elastica.fit import TAIL_WEIGHT, CurveFit, fit_curves

SECTION_POINTS = 41
"""Points per section that the fit sees."""
_END_HALVINGS = 4
"""At both ends of a face a section stands half a step from the end, a quarter, ... as often as this."""
_PLACE_ROUNDS = 12
"""Steps to the plane through a point where planes lean: each leaves a small part of the error."""


@dataclasses.dataclass(frozen=True)
class Spine:
    """A one-parameter family of planes: p [m] is the place along the sweep ``direction`` (3,).

    ``height``: spline of the spine's height over p on [lower, upper], straight beyond; None for upright
    parallel planes. ``across`` [m]: where along the wire's direction the planes have their origin.
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
        """Plane frames (K, 4, 4) at p (K,)."""
        up = np.array([0.0, 0.0, 1.0])
        level, slope = self._height(p)
        size = np.hypot(1.0, slope)[:, None]
        y = (up - slope[:, None] * self.direction) / size
        x = np.broadcast_to(self.wire, y.shape)
        rotation = np.stack([x, y, np.cross(x, y)], axis=-1)
        origin = p[:, None] * self.direction + self.across * self.wire + level[:, None] * up
        return from_parts(rotation, origin)

    def _height(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.height is None:
            return np.zeros_like(p), np.zeros_like(p)
        inside = np.clip(p, self.lower, self.upper)
        slope = self.height(inside, nu=1)
        return self.height(inside) + slope * (p - inside), slope

    def places(self, points: FloatArray) -> FloatArray:
        """Places (V,) [m] of the planes through points (V, 3)."""
        along = np.asarray(points @ self.direction)
        p = along
        for _ in range(0 if self.height is None else _PLACE_ROUNDS):
            level, slope = self._height(p)
            p = along + slope * (points[:, 2] - level)
        return p


@dataclasses.dataclass(frozen=True)
class SectionSet:
    """A face's sections in K planes: ``points`` (K, m, 2) [m] in plane coordinates, along growing x.

    ``length`` (K,) [m]; 0 where the plane misses the face (its points are then meaningless). ``pieces``
    (K,): polylines.
    """

    p: FloatArray
    points: FloatArray
    length: FloatArray
    pieces: IntArray

    def take(self, rows: IndexArray) -> "SectionSet":
        """Some of the sections, in the same order."""
        return SectionSet(self.p[rows], self.points[rows], self.length[rows], self.pieces[rows])

    @property
    def area(self) -> FloatArray:
        """How much (K,) [m2] of the face each section stands for: its length by the part of the sweep that is
        nearest to it."""
        bounds = np.concatenate([self.p[:1], 0.5 * (self.p[1:] + self.p[:-1]), self.p[-1:]])
        return self.length * np.diff(bounds)

    def within(self, distance: FloatArray, share: float) -> float:
        """What ``share`` of the face is within [m], where its sections are ``distance`` (K, m) off."""
        order = np.argsort(distance, axis=None)
        weight = np.repeat(self.area, distance.shape[1])[order]
        middle = np.cumsum(weight) - 0.5 * weight
        return float(np.interp(share * weight.sum(), middle, distance.reshape(-1)[order]))


def direction_of(degrees: float) -> FloatArray:
    """Unit vector (3,) of a sweep at an angle from the block's x."""
    angle = np.deg2rad(degrees)
    return np.round(np.array([np.cos(angle), np.sin(angle), 0.0]), 15)


def make_spine(face: TriangleMesh, direction: FloatArray, normal: bool) -> Spine:
    """Upright planes, or planes normal to the face's spine: the line of its sections' mean points,
    smoothed.
    """
    middle = 0.5 * (face.vertices.min(axis=0) + face.vertices.max(axis=0))
    upright = Spine(direction, float(middle @ np.array([direction[1], -direction[0], 0.0])))
    if not normal:
        return upright
    along = face.vertices @ direction
    lower, upper = float(along.min()), float(along.max())
    p = np.linspace(lower, upper, 62)[1:-1]
    cut = cut_sections(face, upright, p)
    full = cut.length > 0.5 * np.median(cut.length[cut.length > 0])
    level = cut.points[..., 1].mean(axis=1)
    knots = np.concatenate(
        [[p[full][0]] * 4, np.linspace(p[full][0], p[full][-1], 6)[1:-1], [p[full][-1]] * 4]
    )
    height = make_lsq_spline(p[full], level[full], knots, k=3)
    return dataclasses.replace(upright, height=height, lower=float(p[full][0]), upper=float(p[full][-1]))


def section_places(lower: float, upper: float, step: float, least: int, most: int) -> FloatArray:
    """Places (K,) [m] for sections of a face that ends at ``lower`` and ``upper``: about ``step`` [m] apart,
    ``least`` to ``most`` of them, and towards both ends at halves, quarters ... of that."""
    count = int(np.clip(np.ceil((upper - lower) / step), least, most))
    near = 0.5 ** np.arange(_END_HALVINGS, -1, -1)
    at = np.concatenate([near, np.arange(2.0, count - 1.0), count - near[::-1]])
    return lower + (upper - lower) / count * at


def cut_sections(face: TriangleMesh, spine: Spine, p: FloatArray) -> SectionSet:
    """Sections of a face in the planes at p (K,), sampled evenly over their length; several pieces count as
    one curve.
    """
    frames = spine.frames(p)
    cut = slice_mesh(face, frames[:, :3, 3], frames[:, :3, 2])
    points = np.zeros((len(p), SECTION_POINTS, 2))
    length = np.zeros(len(p))
    pieces = np.bincount(cut.plane, minlength=len(p)).astype(np.int64)
    first = np.searchsorted(cut.plane, np.arange(len(p) + 1))
    for k in np.nonzero(pieces)[0]:
        lines = [
            (cut.polyline(i) - frames[k, :3, 3]) @ frames[k, :3, :2] for i in range(first[k], first[k + 1])
        ]
        lines = [line if line[-1, 0] >= line[0, 0] else line[::-1] for line in lines]
        lines.sort(key=lambda line: float(line[:, 0].mean()))
        length[k], points[k] = _resample(lines)
    return SectionSet(p, points, length, pieces)


def _resample(lines: list[FloatArray]) -> tuple[float, FloatArray]:
    steps = [np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T)]) for line in lines]
    place = np.cumsum(np.concatenate(steps))
    line = np.concatenate(lines)
    wanted = np.linspace(0.0, place[-1], SECTION_POINTS)
    return float(place[-1]), np.stack([np.interp(wanted, place, line[:, i]) for i in range(2)], axis=-1)


_FIT_ROUNDS = 25
"""Steps of the fit of a family at most."""
_END_WEIGHT = 3.0
"""Weight of the ends of a section, where neighbours meet, in that of its other points."""
_SECOND_DIFFERENCE_WEIGHT = np.array([1e-4, 1e-4, 1e-4, 3e-5, 1e-5, 1e-5])
"""Weight of second differences along the sweep, for each of the six parameters of a wire."""
_FIRST_DIFFERENCE_WEIGHT = np.array([0.0, 0.0, 3e-3, 1e-3, 3e-4, 3e-4])
"""Weight of first differences along it where no section leads the wire."""
_CENTRE_WEIGHT = 1e-2
"""Weight of the wire's middle being off the block's middle: a wire that slides along itself meets a section
as well, so this costs no shape, and keeps both ends as far outside of the block where sections end early."""
_TAIL = 0.3 * TAIL_WEIGHT  # less straight ends hold better against end errors


@dataclasses.dataclass(frozen=True)
class Family:
    """Wires of ``length`` [m] over places p in [lower, upper] [m]: ``spline`` gives the middle's state in
    wire lengths.
    """

    spline: BSpline
    length: float
    lower: float
    upper: float

    def state(self, p: FloatArray) -> FloatArray:
        """Middle states (K, 6) [m, rad, 1/m, 1/m^2] in the planes at p (K,), steady outside the range."""
        inside = np.clip(p, self.lower, self.upper)
        value = self.spline(inside)
        value[:, :2] += self.spline(inside, nu=1)[:, :2] * (p - inside)[:, None]
        return np.asarray(value * _unit(self.length))


@dataclasses.dataclass(frozen=True)
class FamilyFit:
    """``residual`` (K, m): signed distances [m] of the sections' points from the wires (0 where there is no
    section); ``foot`` (K, m): arc length [m] of their feet from the wires' start.
    """

    family: Family
    residual: FloatArray
    foot: FloatArray


@dataclasses.dataclass(frozen=True)
class _Job:
    table: FloatArray  # (K, c) basis of the spline at the sections
    points: FloatArray  # (K, m, 2)
    share: FloatArray  # (K,) weight of a section, sum 1
    load: FloatArray  # (K, 2) weight of the wire
    tail: FloatArray  # (K,) price of bent ends
    reach: FloatArray  # (K, 2) arc lengths from the middle that the section covers
    centre: float
    ends: float  # weight of the ends of a section
    steady: FloatArray  # (c 6, c 6)


@dataclasses.dataclass(frozen=True)
class FirstFit:
    """Single fits to some sections, ``rows`` (R,) of the planes: they show early whether a wire meets the
    face at all."""

    rows: IndexArray
    fit: CurveFit


def fit_first(sections: SectionSet, load: FloatArray, length: float, count: int = 9) -> FirstFit:
    """Fit up to ``count`` of the sections that cover the face well, each for itself."""
    good = np.nonzero(sections.length > 0.6 * np.median(sections.length[sections.length > 0.0]))[0]
    rows = good[np.unique(np.linspace(0, len(good) - 1, count).astype(np.intp))]
    fit = fit_curves(sections.points[rows], np.full(len(rows), length), load[rows], None, 0.5, TAIL_WEIGHT)
    return FirstFit(rows, fit)


def fit_family(
    sections: SectionSet,
    first: FirstFit,
    load: FloatArray,
    length: float,
    lower: float,
    upper: float,
    centre: float,
    cells: int = 16,
    end_weight: float = _END_WEIGHT,
) -> FamilyFit:
    """Fit wires of ``length`` [m] to sections whose weight in the planes is ``load`` (K, 2) [1/m^3].

    ``lower``, ``upper``: range of p that the family is to cover; ``centre`` [m]: where along the wire's
    direction its middle should be; ``end_weight``: of the ends of sections in that of their other points.
    Raises ``ValueError`` where no section can be fitted at all (see
    ``fit.fit_curves``).
    """
    lower, upper = min(lower, float(sections.p[0])), max(upper, float(sections.p[-1]))
    unit = _unit(length)
    # even knots beyond both ends too: equal differences of coefficients are then a straight line
    knots = lower + (upper - lower) / cells * np.arange(-3, cells + 4, dtype=np.float64)
    knots[3], knots[-4] = lower, upper
    table = BSpline.design_matrix(sections.p, knots, 3).toarray()
    has = sections.length > 0.0
    long = float(np.median(sections.length[has]))
    share = sections.area / sections.area.sum()
    coefficient = _smooth(table[first.rows], first.fit.middle / unit)
    covered = np.nonzero(has)[0]
    job = _Job(
        table,
        sections.points / length,
        share,
        load * length**3,
        _TAIL**2 * (np.maximum(sections.length, 0.3 * long) / length) ** 3 * share,
        np.zeros((len(sections.p), 2)),
        centre / length,
        end_weight,
        _steadiness(knots, float(sections.p[covered[0]]), float(sections.p[covered[-1]])),
    )
    coefficient, residual, foot = _gauss_newton(job, coefficient)
    spline = BSpline(knots, coefficient, 3, extrapolate=True)
    family = Family(spline, length, float(sections.p[covered[0]]), float(sections.p[covered[-1]]))
    return FamilyFit(family, residual * length * has[:, None], (foot + 0.5) * length)


def _unit(length: float) -> FloatArray:
    return np.array([length, length, 1.0, 1.0 / length, length**-2, length**-2])


def _smooth(table: FloatArray, values: FloatArray) -> FloatArray:
    """Coefficients (c, 6) of the smoothing spline through values (K, 6)."""
    count = table.shape[1]
    bend = np.diff(np.eye(count), 2, axis=0)
    left = table.T @ table + 1e-2 * bend.T @ bend
    return np.asarray(np.linalg.solve(left, table.T @ values))


def _steadiness(knots: FloatArray, first: float, last: float) -> FloatArray:
    """Quadratic price (6 c, 6 c): second differences everywhere; first ones of the shape where there is no
    face.
    """
    count = len(knots) - 4
    bend = np.diff(np.eye(count), 2, axis=0)
    step = np.diff(np.eye(count), 1, axis=0)
    places = np.array([knots[i + 1 : i + 4].mean() for i in range(count)])
    cell = places[1] - places[0]  # the first cells beyond the face go on as they came
    free = ((places[1:] < first - 2.0 * cell) | (places[:-1] > last + 2.0 * cell)).astype(np.float64)
    total = np.zeros((count, 6, count, 6))
    for j in range(6):
        total[:, j, :, j] = (
            _SECOND_DIFFERENCE_WEIGHT[j] ** 2 * bend.T @ bend
            + _FIRST_DIFFERENCE_WEIGHT[j] ** 2 * (step.T * free) @ step
        )
    return total.reshape(count * 6, count * 6)


def _gauss_newton(job: _Job, coefficient: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    damp = 1e-6
    foot = _nearest(job, job.table @ coefficient)
    job = dataclasses.replace(job, reach=np.stack([foot.min(axis=1), foot.max(axis=1)], axis=1))
    cost, gradient, hessian, residual, foot = _evaluate(job, coefficient, foot)
    for _ in range(_FIT_ROUNDS):
        scale = np.diag(hessian)
        damped = hessian + np.diag(damp * scale + 1e-13 * scale.max())
        step = -np.linalg.solve(damped, gradient).reshape(coefficient.shape)
        trial = _evaluate(job, coefficient + step, foot)
        if trial[0] < cost:
            fall = (cost - trial[0]) / cost
            coefficient = coefficient + step
            cost, gradient, hessian, residual, foot = trial
            damp = max(damp * 0.1, 1e-12)
            if fall < 1e-4:
                break
        else:
            damp *= 30.0
            if damp > 1e6:
                break
    return coefficient, residual, foot


def _nearest(job: _Job, state: FloatArray) -> FloatArray:
    """Arc length from the middle (K, m) of the wire's points nearest to the sections' points."""
    sigma = np.linspace(0.0, 1.0, 121)
    wire = flow(state, np.ones(len(state)), job.load, anchor=0.5)
    at = wire.at(sigma)[..., :2]
    gap = np.sum((job.points[:, :, None] - at[:, None]) ** 2, axis=-1)
    return np.asarray(sigma[np.argmin(gap, axis=2)] - 0.5)


def _evaluate(
    job: _Job, coefficient: FloatArray, foot: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Cost, its gradient and Gauss-Newton matrix by the coefficients, distances (K, m) and feet (K, m)."""
    state = job.table @ coefficient
    count = int(np.max(node_counts(state, np.ones(len(state)), job.load, base=14.0, per_wave=3.6)))
    grid = nodes(count)
    wire = flow(state, np.ones(len(state)), job.load, anchor=0.5, derivatives=True, count=count)
    foot, across, here, table = _feet(job.points, wire, foot)
    cos, sin = np.cos(here[..., 2]), np.sin(here[..., 2])
    d = table @ (grid.series @ np.concatenate([wire.d_x, wire.d_y], axis=-1))
    slope = np.empty((*across.shape, 6))
    slope[..., 0], slope[..., 1] = sin, -cos
    slope[..., 2:] = sin[..., None] * d[..., :4] - cos[..., None] * d[..., 4:]
    weight = np.ones(across.shape[1])
    weight[[0, -1]] = job.ends
    part = job.share[:, None] * (weight / weight.sum())

    place = grid.sigma - 0.5
    outer = (place < job.reach[:, :1]) | (place > job.reach[:, 1:])
    price = job.tail[:, None] * grid.weight * outer
    block = np.einsum("km,kmi,kmj->kij", np.broadcast_to(part, across.shape), slope, slope)
    vector = np.einsum("km,kmi->ki", part * across, slope)
    block[:, 2:, 2:] += np.einsum("kn,kni,knj->kij", price, wire.d_curvature, wire.d_curvature)
    vector[:, 2:] += np.einsum("kn,kni->ki", price * wire.curvature, wire.d_curvature)
    off = state[:, 0] - job.centre
    block[:, 0, 0] += _CENTRE_WEIGHT**2 / len(state)
    vector[:, 0] += _CENTRE_WEIGHT**2 / len(state) * off

    flat = coefficient.reshape(-1)
    hessian = np.einsum("ka,kij,kb->aibj", job.table, block, job.table, optimize=True).reshape(
        flat.size, flat.size
    )
    gradient = (job.table.T @ vector).reshape(-1) + job.steady @ flat
    cost = float(
        np.sum(part * across**2)
        + np.sum(price * wire.curvature**2)
        + _CENTRE_WEIGHT**2 * np.mean(off**2)
        + flat @ job.steady @ flat
    )
    return (cost if np.isfinite(cost) else np.inf), gradient, hessian + job.steady, across, foot


def _feet(
    points: FloatArray, wire: Flow, foot: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Feet (K, m) of points (K, m, 2) on the wires, distances (K, m) along the normal, and x, y, theta, k (K,
    m, 4) there with the table (K, m, n) that interpolates to them; next to the feet given."""
    series = nodes(wire.count).series @ np.stack([wire.x, wire.y, wire.theta, wire.curvature], axis=-1)
    for turn in range(3):
        table = legendre(foot + 0.5, wire.count)
        here = table @ series
        gap = points - here[..., :2]
        cos, sin = np.cos(here[..., 2]), np.sin(here[..., 2])
        across = gap[..., 1] * cos - gap[..., 0] * sin
        if turn < 2:
            along = gap[..., 0] * cos + gap[..., 1] * sin
            bend = np.maximum(1.0 - here[..., 3] * across, 0.3)
            foot = np.clip(foot + np.clip(along / bend, -0.1, 0.1), -0.5, 0.5)
    return foot, across, here, table
