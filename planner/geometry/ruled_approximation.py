"""Free-form surfaces as ruled ones: rulings of a nearly ruled surface, strips of any other.

Surfaces are defined over the unit square: a region of a loft, or a flattened mesh with four corners. A mesh
is flattened by mean value coordinates (M. S. Floater, Mean value coordinates, CAGD 20, 2003): its boundary
goes around the square by arc length, every inner vertex is the weighted mean of its neighbours, and no facet
folds over.

Rulings minimise their distance from the surface. Strips are ruled between neighbouring curves of one family
of parameter lines.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
import shapely
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import spsolve

from planner.geometry.arrays import FloatArray, IntArray, RuledSurface
from planner.geometry.curves import (
    CORNER_ANGLE_RAD,
    LoftSurface,
    RuledGuide,
    arc_length,
    interpolate_polyline,
    polyline_guide,
    turning_angles,
)
from planner.geometry.matching import best_path
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.nurbs import NurbsSurface
from planner.geometry.part_placement import reversed_rulings
from planner.geometry.rulings import boundary_rings, outward_normals, resample, ruling_points, tessellate
from planner.geometry.units import DEG, MM, measurement
from planner.issues import TandemError, issue_error

_PARAMETER_TOLERANCE = 1e-5
"""Parameters that differ by less are equal."""


@dataclasses.dataclass(frozen=True)
class Patch:
    """A surface over the unit square.

    Attributes:
        points: Function that returns points (..., 3) at u and v (...,) in [0, 1].
        mesh: The same surface as a mesh with normals away from the part.
        outward: Whether dS/du x dS/dv points away from the part.
        edges: u and v of both ends of the edges between its facets (E, 2, 2), if it has facets.
    """

    points: Callable[[FloatArray, FloatArray], FloatArray]
    mesh: TriangleMesh
    outward: bool
    edges: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 2, 2)))

    def folds(self, across: int, at: float) -> tuple[FloatArray, FloatArray]:
        """Return where (K,) a parameter line crosses edges, and its angles (K,) [rad] there.

        Args:
            across: The constant parameter (0 or 1).
            at: Its value.

        Returns:
            The other parameter at the crossings, ascending, and the angles.
        """
        a, b = self.edges[..., across], self.edges[..., 1 - across]
        over = (a[:, 0] - at) * (a[:, 1] - at) <= 0.0
        over &= np.abs(a[:, 1] - a[:, 0]) > _PARAMETER_TOLERANCE
        a, b = a[over], b[over]
        crossings = np.sort(b[:, 0] + (at - a[:, 0]) / (a[:, 1] - a[:, 0]) * (b[:, 1] - b[:, 0]))
        crossings = crossings[
            (crossings > 2.0 * _PARAMETER_TOLERANCE) & (crossings < 1.0 - 2.0 * _PARAMETER_TOLERANCE)
        ]
        crossings = crossings[np.diff(crossings, prepend=-1.0) > 2.0 * _PARAMETER_TOLERANCE]
        constant = np.full((len(crossings), 3), at)
        other = crossings[:, None] + _PARAMETER_TOLERANCE * np.array([-1.0, 0.0, 1.0])
        samples = self.points(constant, other) if across == 0 else self.points(other, constant)
        steps = np.diff(samples, axis=1)
        cross = np.linalg.norm(np.cross(steps[:, 0], steps[:, 1]), axis=1)
        return crossings, np.arctan2(cross, np.sum(steps[:, 0] * steps[:, 1], axis=1))


def patch_of_surface(
    surface: LoftSurface | NurbsSurface,
    u: tuple[float, float],
    v: tuple[float, float],
    mesh: TriangleMesh,
    flip: bool,
) -> Patch:
    """Return a rectangular region of a surface as a patch.

    Args:
        surface: The surface.
        u: Range of u.
        v: Range of v.
        mesh: Tessellation of the region, with normals away from the part.
        flip: Whether dS/du x dS/dv points into the part.
    """

    def points(a: FloatArray, b: FloatArray) -> FloatArray:
        a, b = np.broadcast_arrays(a, b)
        return surface.points(u[0] + a * (u[1] - u[0]), v[0] + b * (v[1] - v[0]))

    return Patch(points, mesh, not flip)


def patch_of_mesh(mesh: TriangleMesh, field: str) -> Patch:
    """Return a mesh with one boundary and four corners as a patch.

    Corners are where the boundary turns most, by 20 degrees or more. u = 0 is the first side of the longer
    pair.

    Args:
        mesh: The mesh.
        field: Field of the issue.

    Raises:
        TandemError: The mesh has several boundaries, or not exactly four such corners (``part.patch``).
    """
    rings = boundary_rings(mesh)
    if len(rings) != 1:
        text = f"the mesh has {len(rings)} boundaries, a patch has 1; close its holes, or cut it open if it "
        raise _refuse(field, text + "is closed around an axis")
    ring = rings[0]
    angles = turning_angles(mesh.vertices[ring], True)
    order = np.argsort(-angles, kind="stable")
    count = int((angles >= 20.0 * DEG).sum())
    text = f"the boundary has {count} corners of 20 degrees or more, a patch has 4"
    if len(ring) < 4 or count < 4:
        raise _refuse(field, f"{text}; cut it so that it has four sides")
    if len(ring) > 4 and angles[order[4]] > 0.7 * angles[order[3]] and angles[order[4]] > 20.0 * DEG:
        raise _refuse(field, f"{text}; smooth the others, or cut it so that it has four sides")
    corner = np.sort(order[:4])
    ring = np.roll(ring, -int(corner[0]))
    corner = np.append(corner - corner[0], len(ring))
    flat = _rim_coordinates(mesh, ring, corner)
    uv = _flattened(mesh, ring, flat)
    inside = _facet_points(mesh, uv)
    sides = []
    for a, b in itertools.pairwise(corner):
        side = mesh.vertices[ring[np.arange(a, b + 1) % len(ring)]]
        lengths = arc_length(side)
        sides.append((side, lengths / lengths[-1]))

    def points(u: FloatArray, v: FloatArray) -> FloatArray:
        u, v = (np.asarray(w, dtype=np.float64) for w in np.broadcast_arrays(u, v))
        out = inside(np.stack([u, v], axis=-1))
        # the square's sides counterclockwise: v = 0, u = 1, v = 1, u = 0
        rims = ((v <= 1e-9, u), (u >= 1 - 1e-9, v), (v >= 1 - 1e-9, 1 - u), (u <= 1e-9, 1 - v))
        for (on_side, fractions), (side, side_fractions) in zip(rims, sides, strict=True):
            if on_side.any():
                out[on_side] = interpolate_polyline(side, side_fractions, fractions[on_side])
        return out

    pairs = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, use_count = np.unique(pairs, axis=0, return_counts=True)
    return Patch(points, mesh, True, uv[edges[use_count > 1]])


def _facet_points(mesh: TriangleMesh, uv: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return a function that returns points (..., 3) of the mesh's own facets at (..., 2).

    Another triangulation of the same vertices would be another surface.

    Args:
        mesh: The mesh.
        uv: Flat layout of its vertices (V, 2).
    """
    flat = uv[mesh.faces]
    tree = shapely.STRtree(shapely.polygons(flat))
    side = flat[:, 1:] - flat[:, :1]
    area = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]

    def points_at(coordinates: FloatArray) -> FloatArray:
        flat_points = coordinates.reshape(-1, 2)
        facet = tree.nearest(shapely.points(flat_points))
        offsets = flat_points - flat[facet, 0]
        first, second = side[facet, 0], side[facet, 1]
        size = np.where(np.abs(area[facet]) > 1e-300, area[facet], 1e-300)
        b = (offsets[:, 0] * second[:, 1] - offsets[:, 1] * second[:, 0]) / size
        c = (first[:, 0] * offsets[:, 1] - first[:, 1] * offsets[:, 0]) / size
        weight = np.stack([1.0 - b - c, b, c], axis=1)[..., None]
        out = np.sum(weight * mesh.vertices[mesh.faces[facet]], axis=1)
        return np.asarray(out.reshape(*coordinates.shape[:-1], 3))

    return points_at


def _rim_coordinates(mesh: TriangleMesh, ring: IntArray, corner: IntArray) -> FloatArray:
    """Return coordinates (n, 2) of the boundary's vertices on the square, counterclockwise from (0, 0)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    out = np.empty((len(ring), 2))
    for k in range(4):
        index = np.arange(corner[k], corner[k + 1] + 1)
        lengths = arc_length(mesh.vertices[ring[index % len(ring)]])
        fractions = (lengths / lengths[-1])[:-1, None]
        out[index[:-1]] = (1.0 - fractions) * square[k] + fractions * square[k + 1]
    return out


def _flattened(mesh: TriangleMesh, ring: IntArray, flat: FloatArray) -> FloatArray:
    """Return coordinates (V, 2) of all vertices from those of the boundary (n, 2), by mean value weights."""
    count = len(mesh.vertices)
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    length = np.maximum(np.linalg.norm(edge, axis=2), 1e-300)
    unit = edge / length[..., None]
    cosine = np.clip(-np.sum(unit * np.roll(unit, 1, axis=1), axis=2), -1.0, 1.0)
    tangent = np.tan(0.5 * np.arccos(cosine))  # of the angle at every corner
    vertices = mesh.faces
    following, previous = np.roll(vertices, -1, axis=1), np.roll(vertices, 1, axis=1)
    row = np.concatenate([vertices.ravel(), vertices.ravel()])
    column = np.concatenate([following.ravel(), previous.ravel()])
    weight = np.concatenate([(tangent / length).ravel(), (tangent / np.roll(length, 1, axis=1)).ravel()])
    matrix = csr_array(coo_array((weight, (row, column)), shape=(count, count)))
    total = np.asarray(matrix.sum(axis=1)).ravel()
    free = np.setdiff1d(np.arange(count), ring)
    uv = np.zeros((count, 2))
    uv[ring] = flat
    if len(free):
        free_rows = matrix[free]
        diagonal = np.arange(len(free))
        left = coo_array((total[free], (diagonal, diagonal))).tocsc() - free_rows[:, free].tocsc()
        uv[free] = np.stack([spsolve(left, free_rows[:, ring] @ flat[:, k]) for k in range(2)], axis=1)
    return uv


def _refuse(field: str, message: str) -> TandemError:
    return issue_error("part.patch", message, field=field)


Across = Literal["u", "v"]

MAX_STRIPS: Final = 200
"""Maximum number of strips of a surface."""
_CELLS_ACROSS: Final = 128
"""Number of cells across the strips at which a surface is evaluated."""
_RULINGS_PER_STRIP: Final = 240
"""Number of intervals between the rulings of a strip."""
_FOLD_TOLERANCE: Final = 2e-5
"""Maximum difference of the parameter of two curves' folds that are on one ruling."""
KINK_ANGLE_RAD: Final = 2.0 * DEG
"""Angle of a curve at one edge between facets, beyond which it is a kink [rad]."""
SMOOTH_FACET_LENGTH_M: Final = 3e-3
"""Maximum length of facets that represent a smooth surface [m]."""


@dataclasses.dataclass(frozen=True)
class RuledStrips:
    """Strips in order.

    Attributes:
        strips: The strips.
        deviation: Largest distance of each from the surface (N,) [m].
        kink: Largest angle between neighbours along their common curve (N - 1,) [rad].
        breaks: Values of the parameter across them at which they begin and end (N + 1,).
    """

    strips: tuple[RuledSurface, ...]
    deviation: FloatArray
    kink: FloatArray
    breaks: FloatArray


def cut_strips(patch: Patch, across: Across, tolerance: float, count: int | None, field: str) -> RuledStrips:
    """Return the surface in consecutive ruled strips.

    Rulings join equal values of the other parameter. If the facets of a mesh fold a strip, a ruling is there
    as a corner. Curves between strips are dense where the surface is bent across them.

    Args:
        patch: The surface.
        across: Parameter along which strips follow one another.
        tolerance: Maximum distance from the surface [m].
        count: Number of strips, None for as few as the tolerance permits.
        field: Field of the issue.

    Raises:
        TandemError: 200 strips are not enough (``part.strips``).
    """
    nearness = MeshDistance(patch.mesh, float(np.ptp(patch.mesh.vertices, axis=0).max()) / 150.0)
    fractions = _strip_fractions(patch, across)
    if count is not None:
        return _with_fold_rulings(patch, across, _measured_strips(patch, across, fractions, count, nearness))
    number, low = 1, 0
    while True:  # doubled until enough, then bisected
        strips = _measured_strips(patch, across, fractions, number, nearness)
        if strips.deviation.max() <= tolerance:
            break
        if number >= MAX_STRIPS:
            message = (
                f"{MAX_STRIPS} strips deviate too far from the surface (got "
                f"{strips.deviation.max() / MM:.3g} mm, allowed {tolerance / MM:g} mm); "
                "increase the tolerance, or cut a smaller region"
            )
            raise issue_error(
                "part.strips",
                message,
                field=field,
                **measurement(float(strips.deviation.max() / MM), tolerance / MM, "mm"),
            )
        low, number = number, min(MAX_STRIPS, 2 * number)
    while number - low > 1:
        middle = (number + low) // 2
        trial = _measured_strips(patch, across, fractions, middle, nearness)
        if trial.deviation.max() <= tolerance:
            number, strips = middle, trial
        else:
            low = middle
    return _with_fold_rulings(patch, across, strips)


def parameter_grid(patch: Patch, across: Across, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return points (A, B, 3) at values a (A,) of the parameter across the strips and b (B,) along them."""
    across_values, along_values = np.meshgrid(a, b, indexing="ij")
    return (
        patch.points(across_values, along_values)
        if across == "u"
        else patch.points(along_values, across_values)
    )


def _strip_fractions(patch: Patch, across: Across) -> FloatArray:
    """Return the fraction (_CELLS_ACROSS + 1,) of all strips up to every value of the parameter.

    Their density is the root of the surface's largest bend across them.
    """
    a = np.linspace(0.0, 1.0, _CELLS_ACROSS + 1)
    grid = parameter_grid(patch, across, a, np.linspace(0.0, 1.0, 33))
    bend = np.zeros(_CELLS_ACROSS + 1)
    middle = grid[1:-1] - 0.5 * (grid[2:] + grid[:-2])
    chords = grid[2:] - grid[:-2]
    unit = chords / np.maximum(np.linalg.norm(chords, axis=2, keepdims=True), 1e-300)
    sagittas = middle - np.sum(middle * unit, axis=2, keepdims=True) * unit
    bend[1:-1] = np.linalg.norm(sagittas, axis=2).max(axis=1)
    bend[0], bend[-1] = bend[1], bend[-2]
    # facets of a mesh bend in jumps: mean over a few cells, and no less than a part of the mean
    bend = np.convolve(np.pad(bend, 3, mode="edge"), np.ones(7) / 7.0, mode="valid")
    density = np.sqrt(bend + 0.05 * bend.mean() + 1e-15)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.asarray(total / total[-1])


def _measured_strips(
    patch: Patch, across: Across, fractions: FloatArray, count: int, nearness: MeshDistance
) -> RuledStrips:
    """Return a surface in ``count`` strips, with their deviations and kinks.

    ``fractions`` are those of :func:`_strip_fractions`.
    """
    breaks = np.interp(np.linspace(0.0, 1.0, count + 1), fractions, np.linspace(0.0, 1.0, len(fractions)))
    breaks[[0, -1]] = 0.0, 1.0
    curves = parameter_grid(patch, across, breaks, np.linspace(0.0, 1.0, _RULINGS_PER_STRIP + 1))
    # tangent x ruling is dS/du x dS/dv for strips across v and its opposite for strips across u
    if (across == "u") == patch.outward:
        curves = curves[:, ::-1]
    is_corner = np.array([turning_angles(curve, False) > CORNER_ANGLE_RAD for curve in curves])
    strips = tuple(
        RuledSurface("strip", curves[k], curves[k + 1], is_corner[k] | is_corner[k + 1]) for k in range(count)
    )
    inner = np.linspace(0.0, 1.0, 7)[1:-1]
    samples = np.concatenate([ruling_points(s, inner)[::8].reshape(-1, 3) for s in strips])
    distances = nearness.distance(samples)[0].reshape(count, -1).max(axis=1)
    normals = [outward_normals(s) for s in strips]
    kink = [_angle(first[1], second[0]).max() for first, second in itertools.pairwise(normals)]
    return RuledStrips(strips, distances, np.array(kink), breaks)


def _with_fold_rulings(patch: Patch, across: Across, strips: RuledStrips) -> RuledStrips:
    """Return the strips with rulings where the mesh folds either of their curves."""
    if not len(patch.edges):
        return strips
    folds = [_kinks(patch, across, float(at)) for at in strips.breaks]
    out = []
    for k, strip in enumerate(strips.strips):
        kinks = np.union1d(folds[k], folds[k + 1])
        kinks = kinks[np.diff(kinks, prepend=-1.0) > _FOLD_TOLERANCE]
        even = np.linspace(0.0, 1.0, len(strip.start))
        near_kink = np.abs(even[:, None] - kinks).min(axis=1, initial=np.inf) < 0.25 / _RULINGS_PER_STRIP
        near_kink[[0, -1]] = False
        parameters = np.sort(np.concatenate([even[~near_kink], kinks]))
        curves = parameter_grid(patch, across, strips.breaks[k : k + 2], parameters)
        corner = np.isin(parameters, kinks)
        if (across == "u") == patch.outward:
            curves, corner = curves[:, ::-1], corner[::-1]
        out.append(RuledSurface(strip.name, curves[0], curves[1], corner))
    return dataclasses.replace(strips, strips=tuple(out))


def _kinks(patch: Patch, across: Across, at: float) -> FloatArray:
    """Return where (K,) the curve at the value ``at`` has folds of more than `KINK_ANGLE_RAD`.

    If all facets are so small that folds are closer together than `SMOOTH_FACET_LENGTH_M`, they represent a
    smooth curve.
    """
    crossings, angles = patch.folds(0 if across == "u" else 1, at)
    crossings, angles = crossings[angles > KINK_ANGLE_RAD], angles[angles > KINK_ANGLE_RAD]
    ends = np.concatenate([[0.0], crossings, [1.0]])
    points = parameter_grid(patch, across, np.array([at]), ends)[0]
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.asarray(
        crossings[
            (np.maximum(lengths[:-1], lengths[1:]) > SMOOTH_FACET_LENGTH_M) | (angles > CORNER_ANGLE_RAD)
        ]
    )


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)))


def strip_notes(strips: RuledStrips) -> str:
    """Return a text about the strips."""
    deviations = ", ".join(f"{v / MM:.3g}" for v in strips.deviation)
    kinks = ", ".join(f"{v / DEG:.2f}" for v in strips.kink) or "none"
    return (
        f"{len(strips.strips)} ruled strips; largest deviation of each from the surface [mm]: {deviations}; "
        f"kinks between neighbours [deg]: {kinks}"
    )


_CURVE_GRID_INTERVALS: Final = 40
"""Number of intervals of the initial search grid over two curves for rulings in a face."""
_RULING_FRACTIONS: Final = np.array([1.0, 2.0, 3.0, 4.0, 5.0]) / 6.0
"""Fractions of a ruling at which its distance from the face is evaluated."""
_INTERVALS_PER_SIDE: Final = 400
"""Number of intervals along each side of a patch."""


@dataclasses.dataclass(frozen=True)
class RuledDeviation:
    """Distance between a ruled surface and the intended one.

    Attributes:
        largest: Largest value [m].
        quantile_95: 95 % quantile [m].
        position: Point of the largest value (3,) [m].
    """

    largest: float
    quantile_95: float
    position: FloatArray


def find_rulings(patch: Patch, name: str) -> tuple[RuledSurface, RuledDeviation]:
    """Return the ruled surface nearest to a patch, between one pair of its opposite sides or the other.

    Rulings join points of both sides so that the mean square distance of the rulings from the surface is
    least. The surface faces the same side as the patch.
    """
    even = np.linspace(0.0, 1.0, _INTERVALS_PER_SIDE + 1)
    zero, ones = np.zeros_like(even), np.ones_like(even)
    nearness, coarse = (MeshDistance(patch.mesh, factor * _spacing(patch.mesh)) for factor in (1.0, 5.0))
    best: tuple[RuledSurface, RuledDeviation] | None = None
    pairs = (
        (patch.points(zero, even), patch.points(ones, even)),
        (patch.points(even, zero), patch.points(even, ones)),
    )
    for first, second in pairs:
        start, end = polyline_guide(first), polyline_guide(second)
        ruled = _facing_like_mesh(_matched(name, start, end, coarse), nearness)
        distance = deviation(ruled, patch.mesh, nearness)
        if best is None or distance.largest < best[1].largest:
            best = ruled, distance
    if best is None:
        raise ValueError("a patch has two pairs of sides")
    return best


def deviation(ruled: RuledSurface, mesh: TriangleMesh, nearness: MeshDistance) -> RuledDeviation:
    """Return the distance between the ruled surface and the mesh, measured from both."""
    resampled = resample(ruled, 1e-4, max(2.0 * deviation_step(mesh), 1e-3))
    samples = ruling_points(resampled, np.linspace(0.0, 1.0, 21)).reshape(-1, 3)
    facets = tessellate(resampled, 1e-5)
    other = MeshDistance(TriangleMesh(facets.vertices, facets.faces), _spacing(mesh))
    points = np.concatenate([samples, mesh.vertices])
    distances = np.concatenate([nearness.distance(samples)[0], other.distance(mesh.vertices)[0]])
    worst_index = int(np.argmax(distances))
    return RuledDeviation(
        float(distances[worst_index]), float(np.quantile(distances, 0.95)), points[worst_index]
    )


def deviation_step(mesh: TriangleMesh) -> float:
    """Return a step [m] for deviations from a mesh: a hundredth of its extent."""
    return 0.01 * float(np.ptp(mesh.vertices, axis=0).max())


def _spacing(mesh: TriangleMesh) -> float:
    """Return the spacing [m] of samples for distances from a mesh."""
    return float(np.ptp(mesh.vertices, axis=0).max()) / 150.0


def _matched(name: str, start: RuledGuide, end: RuledGuide, nearness: MeshDistance) -> RuledSurface:
    """Return the ruled surface between two guides that is nearest to the surface of ``nearness``."""
    fractions = [arc_length(g.points) / g.length for g in (start, end)]
    size = max(start.length, end.length)

    def ruling_distances(s: FloatArray, t: FloatArray) -> FloatArray:
        """Return distances (K, A) of points along rulings from the surface, per length of the guides."""
        a = interpolate_polyline(start.points, fractions[0], s)
        b = interpolate_polyline(end.points, fractions[1], t)
        samples = (1.0 - _RULING_FRACTIONS[:, None]) * a[:, None] + _RULING_FRACTIONS[:, None] * b[:, None]
        return nearness.distance(samples.reshape(-1, 3))[0].reshape(len(s), -1) / size

    even = np.linspace(0.0, 1.0, _CURVE_GRID_INTERVALS + 1)
    s, t = (w.ravel() for w in np.meshgrid(even, even, indexing="ij"))
    cost = np.sum(ruling_distances(s, t) ** 2, axis=1).reshape(
        _CURVE_GRID_INTERVALS + 1, _CURVE_GRID_INTERVALS + 1
    )
    cost += 1e-9 * (even[:, None] - even[None, :]) ** 2
    s, t = best_path(cost, ruling_distances, 1e-9, 1e-11)
    path = np.unique(np.concatenate([s + t, np.linspace(0.0, 2.0, _INTERVALS_PER_SIDE + 1)]))
    path_s, path_t = np.interp(path, s + t, s), np.interp(path, s + t, t)
    no_corner = np.zeros(len(path), dtype=np.bool_)
    ruled = RuledSurface(
        name,
        interpolate_polyline(start.points, fractions[0], path_s),
        interpolate_polyline(end.points, fractions[1], path_t),
        no_corner,
    )
    return resample(ruled, 0.5e-5, 1.0)


def _facing_like_mesh(ruled: RuledSurface, nearness: MeshDistance) -> RuledSurface:
    """Return the surface ordered so that it faces the same side as the mesh."""
    middle = ruling_points(ruled, np.array([0.5]))[:, 0]
    _, face = nearness.distance(middle)
    normal = face_normals(nearness.mesh)[face]
    start, end = outward_normals(ruled)
    return reversed_rulings(ruled) if float(np.sum(normal * (start + end))) < 0.0 else ruled
