"""Free-form surfaces as ruled ones: rulings of a nearly ruled surface, strips of any other.

Surfaces lie over the unit square: a region of a loft, or a mesh with four corners laid out flat. A
mesh is laid out by mean value coordinates (M. S. Floater, Mean value coordinates, CAGD 20, 2003):
its boundary goes round the square by arc length, every inner vertex is the weighted mean of its
neighbours, and no facet folds over.

Rulings are found by what they leave between themselves and the surface. Strips are ruled between
neighbouring curves of one family of parameter lines.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
import shapely
from scipy.sparse import coo_array, csr_array
from scipy.sparse.linalg import spsolve

from planner.geometry.arrays import FloatArray, IntArray, Ruled
from planner.geometry.curves import CORNER_ANGLE, Guide, Loft, along, arc_length, polyline, turns
from planner.geometry.matching import best_path
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.mesh_queries import Nearness
from planner.geometry.nurbs import NurbsSurface
from planner.geometry.placing import backwards
from planner.geometry.rulings import boundaries, outward, points, resample, tessellate
from planner.geometry.units import DEG, MM, measurement
from planner.issues import TandemError, refusal

_SAME_PARAMETER = 1e-5
"""Parameters that differ by less are one place."""


@dataclasses.dataclass(frozen=True)
class Patch:
    """A surface: ``points`` gives (..., 3) at u and v (...,) in [0, 1]; ``mesh`` is the same surface with
    normals away from the part. ``right``: dS/du x dS/dv points away from the part. ``edges`` (E, 2, 2): u and
    v of both ends of the edges between its facets, where it has such.
    """

    points: Callable[[FloatArray, FloatArray], FloatArray]
    mesh: TriangleMesh
    right: bool
    edges: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 2, 2)))

    def folds(self, across: int, at: float) -> tuple[FloatArray, FloatArray]:
        """Where (K,), ascending in the other parameter, the line of the value ``at`` of parameter ``across``
        (0 or 1) passes edges, and by which angles (K,) [rad] it turns there."""
        a, b = self.edges[..., across], self.edges[..., 1 - across]
        over = (a[:, 0] - at) * (a[:, 1] - at) <= 0.0
        over &= np.abs(a[:, 1] - a[:, 0]) > _SAME_PARAMETER
        a, b = a[over], b[over]
        place = np.sort(b[:, 0] + (at - a[:, 0]) / (a[:, 1] - a[:, 0]) * (b[:, 1] - b[:, 0]))
        place = place[(place > 2.0 * _SAME_PARAMETER) & (place < 1.0 - 2.0 * _SAME_PARAMETER)]
        place = place[np.diff(place, prepend=-1.0) > 2.0 * _SAME_PARAMETER]
        own = np.full((len(place), 3), at)
        other = place[:, None] + _SAME_PARAMETER * np.array([-1.0, 0.0, 1.0])
        sight = self.points(own, other) if across == 0 else self.points(other, own)
        way = np.diff(sight, axis=1)
        cross = np.linalg.norm(np.cross(way[:, 0], way[:, 1]), axis=1)
        return place, np.arctan2(cross, np.sum(way[:, 0] * way[:, 1], axis=1))


def of_surface(
    surface: Loft | NurbsSurface,
    u: tuple[float, float],
    v: tuple[float, float],
    mesh: TriangleMesh,
    flip: bool,
) -> Patch:
    """The region of a surface, with its tessellation."""

    def points(a: FloatArray, b: FloatArray) -> FloatArray:
        a, b = np.broadcast_arrays(a, b)
        return surface.points(u[0] + a * (u[1] - u[0]), v[0] + b * (v[1] - v[0]))

    return Patch(points, mesh, not flip)


def of_mesh(mesh: TriangleMesh, field: str) -> Patch:
    """A mesh with one boundary and four corners, those where the boundary turns most, by 20 degrees at least.

    u = 0 is the longer pair's first side; raises ``TandemError`` with ``part.patch``.
    """
    rings = boundaries(mesh)
    if len(rings) != 1:
        what = (
            f"the mesh has {len(rings)} boundaries, a patch has 1; close its holes, or cut it open where it "
        )
        raise _refuse(field, what + "goes all round")
    ring = rings[0]
    turn = turns(mesh.vertices[ring], True)
    order = np.argsort(-turn, kind="stable")
    count = int((turn >= 20.0 * DEG).sum())
    what = f"the boundary has {count} corners of 20 degrees or more, a patch has 4"
    if len(ring) < 4 or count < 4:
        raise _refuse(field, f"{what}; cut it so that it has four sides")
    if len(ring) > 4 and turn[order[4]] > 0.7 * turn[order[3]] and turn[order[4]] > 20.0 * DEG:
        raise _refuse(field, f"{what}; smooth the others, or cut it so that it has four sides")
    corner = np.sort(order[:4])
    ring = np.roll(ring, -int(corner[0]))
    corner = np.append(corner - corner[0], len(ring))
    flat = _rim(mesh, ring, corner)
    uv = _inner(mesh, ring, flat)
    inside = _facets(mesh, uv)
    sides = []
    for a, b in itertools.pairwise(corner):
        own = mesh.vertices[ring[np.arange(a, b + 1) % len(ring)]]
        way = arc_length(own)
        sides.append((own, way / way[-1]))

    def points(u: FloatArray, v: FloatArray) -> FloatArray:
        u, v = (np.asarray(w, dtype=np.float64) for w in np.broadcast_arrays(u, v))
        out = inside(np.stack([u, v], axis=-1))
        # the square is run round counterclockwise: v = 0, u = 1, v = 1, u = 0
        rims = ((v <= 1e-9, u), (u >= 1 - 1e-9, v), (v >= 1 - 1e-9, 1 - u), (u <= 1e-9, 1 - v))
        for (at, share), (own, place) in zip(rims, sides, strict=True):
            if at.any():
                out[at] = along(own, place, share[at])
        return out

    pairs = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    once, used = np.unique(pairs, axis=0, return_counts=True)
    return Patch(points, mesh, True, uv[once[used > 1]])


def _facets(mesh: TriangleMesh, uv: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Points (..., 3) of the mesh's own facets at places (..., 2) of the flat layout ``uv`` (V, 2). Another
    triangulation of the same vertices would be another surface.
    """
    flat = uv[mesh.faces]
    tree = shapely.STRtree(shapely.polygons(flat))
    side = flat[:, 1:] - flat[:, :1]
    area = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]

    def at(places: FloatArray) -> FloatArray:
        rows = places.reshape(-1, 2)
        facet = tree.nearest(shapely.points(rows))
        off = rows - flat[facet, 0]
        one, two = side[facet, 0], side[facet, 1]
        size = np.where(np.abs(area[facet]) > 1e-300, area[facet], 1e-300)
        b = (off[:, 0] * two[:, 1] - off[:, 1] * two[:, 0]) / size
        c = (one[:, 0] * off[:, 1] - one[:, 1] * off[:, 0]) / size
        weight = np.stack([1.0 - b - c, b, c], axis=1)[..., None]
        out = np.sum(weight * mesh.vertices[mesh.faces[facet]], axis=1)
        return np.asarray(out.reshape(*places.shape[:-1], 3))

    return at


def _rim(mesh: TriangleMesh, ring: IntArray, corner: IntArray) -> FloatArray:
    """Places (n, 2) of the boundary's vertices on the square, counterclockwise from (0, 0)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    out = np.empty((len(ring), 2))
    for k in range(4):
        index = np.arange(corner[k], corner[k + 1] + 1)
        way = arc_length(mesh.vertices[ring[index % len(ring)]])
        share = (way / way[-1])[:-1, None]
        out[index[:-1]] = (1.0 - share) * square[k] + share * square[k + 1]
    return out


def _inner(mesh: TriangleMesh, ring: IntArray, flat: FloatArray) -> FloatArray:
    """Places (V, 2) of all vertices, by mean value weights."""
    count = len(mesh.vertices)
    corner = mesh.vertices[mesh.faces]
    edge = np.roll(corner, -1, axis=1) - corner
    length = np.maximum(np.linalg.norm(edge, axis=2), 1e-300)
    unit = edge / length[..., None]
    cosine = np.clip(-np.sum(unit * np.roll(unit, 1, axis=1), axis=2), -1.0, 1.0)
    half = np.tan(0.5 * np.arccos(cosine))  # tangent of half the angle at every corner
    here = mesh.faces
    ahead, behind = np.roll(here, -1, axis=1), np.roll(here, 1, axis=1)
    row = np.concatenate([here.ravel(), here.ravel()])
    column = np.concatenate([ahead.ravel(), behind.ravel()])
    weight = np.concatenate([(half / length).ravel(), (half / np.roll(length, 1, axis=1)).ravel()])
    matrix = csr_array(coo_array((weight, (row, column)), shape=(count, count)))
    total = np.asarray(matrix.sum(axis=1)).ravel()
    free = np.setdiff1d(np.arange(count), ring)
    uv = np.zeros((count, 2))
    uv[ring] = flat
    if len(free):
        own = matrix[free]
        place = np.arange(len(free))
        left = coo_array((total[free], (place, place))).tocsc() - own[:, free].tocsc()
        uv[free] = np.stack([spsolve(left, own[:, ring] @ flat[:, k]) for k in range(2)], axis=1)
    return uv


def _refuse(field: str, what: str) -> TandemError:
    return refusal("part.patch", what, field=field)


Across = Literal["u", "v"]

MOST_STRIPS: Final = 200
"""Most strips of a surface."""
_CELLS_ACROSS: Final = 128
"""Cells in which a surface is looked at across the strips."""
_RULINGS_PER_STRIP: Final = 240
"""Intervals between the rulings of a strip."""
_SAME_FOLD: Final = 2e-5
"""Folds of two curves that differ by less of the parameter are on one ruling."""
KINK_ANGLE: Final = 2.0 * DEG
"""A curve that turns by more than this [rad] at one edge between facets has a kink there."""
SMOOTH_FACET_LENGTH: Final = 3e-3
"""[m] facets shorter than this stand for a smooth surface."""


@dataclasses.dataclass(frozen=True)
class Strips:
    """Strips in order; ``deviation`` (N,) [m] is the largest of each from the surface, ``kink`` (N - 1,)
    [rad] the largest angle between neighbours along the curve that they share. ``breaks`` (N + 1,) are the
    values of the parameter across them at which they begin and end.
    """

    strips: tuple[Ruled, ...]
    deviation: FloatArray
    kink: FloatArray
    breaks: FloatArray


def cut_strips(patch: Patch, across: Across, tolerance: float, count: int | None, field: str) -> Strips:
    """The surface in ``count`` strips that follow one another in the direction of the parameter ``across``,
    or in as few as keep within ``tolerance`` [m] of it. Rulings join equal values of the other parameter;
    where the facets of a mesh fold a strip, a ruling stands as a corner.

    The curves between strips are dense where the surface is bent across them. Raises ``TandemError`` with
    ``part.strips`` where 200 strips are not enough.
    """
    near = Nearness(patch.mesh, float(np.ptp(patch.mesh.vertices, axis=0).max()) / 150.0)
    share = _shares(patch, across)
    if count is not None:
        return _folded(patch, across, _measured(patch, across, share, count, near))
    number, low = 1, 0
    while True:  # doubled until it is enough, then the least number between
        found = _measured(patch, across, share, number, near)
        if found.deviation.max() <= tolerance:
            break
        if number >= MOST_STRIPS:
            what = (
                f"{MOST_STRIPS} strips are {found.deviation.max() / MM:.3g} mm off the surface, "
                f"{tolerance / MM:g} mm are allowed; allow more, or cut a smaller region"
            )
            raise refusal(
                "part.strips",
                what,
                field=field,
                **measurement(float(found.deviation.max() / MM), tolerance / MM, "mm"),
            )
        low, number = number, min(MOST_STRIPS, 2 * number)
    while number - low > 1:
        middle = (number + low) // 2
        tried = _measured(patch, across, share, middle, near)
        if tried.deviation.max() <= tolerance:
            number, found = middle, tried
        else:
            low = middle
    return _folded(patch, across, found)


def parameter_grid(patch: Patch, across: Across, a: FloatArray, b: FloatArray) -> FloatArray:
    """Points (A, B, 3) at values a (A,) of the parameter across the strips and b (B,) along them."""
    one, two = np.meshgrid(a, b, indexing="ij")
    return patch.points(one, two) if across == "u" else patch.points(two, one)


def _shares(patch: Patch, across: Across) -> FloatArray:
    """Share (_FINE + 1,) of all strips up to every value of the parameter: as the roots of the surface's
    largest bends across them.
    """
    a = np.linspace(0.0, 1.0, _CELLS_ACROSS + 1)
    grid = parameter_grid(patch, across, a, np.linspace(0.0, 1.0, 33))
    bend = np.zeros(_CELLS_ACROSS + 1)
    middle = grid[1:-1] - 0.5 * (grid[2:] + grid[:-2])
    way = grid[2:] - grid[:-2]
    unit = way / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-300)
    off = middle - np.sum(middle * unit, axis=2, keepdims=True) * unit
    bend[1:-1] = np.linalg.norm(off, axis=2).max(axis=1)
    bend[0], bend[-1] = bend[1], bend[-2]
    # facets of a mesh bend in jumps: mean over a few cells, and no less than a part of the mean
    bend = np.convolve(np.pad(bend, 3, mode="edge"), np.ones(7) / 7.0, mode="valid")
    density = np.sqrt(bend + 0.05 * bend.mean() + 1e-15)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.asarray(total / total[-1])


def _measured(patch: Patch, across: Across, share: FloatArray, count: int, near: Nearness) -> Strips:
    breaks = np.interp(np.linspace(0.0, 1.0, count + 1), share, np.linspace(0.0, 1.0, len(share)))
    breaks[[0, -1]] = 0.0, 1.0
    rows = parameter_grid(patch, across, breaks, np.linspace(0.0, 1.0, _RULINGS_PER_STRIP + 1))
    # tangent x ruling is dS/du x dS/dv for strips across v and its opposite for strips across u
    if (across == "u") == patch.right:
        rows = rows[:, ::-1]
    bent = np.array([turns(row, False) > CORNER_ANGLE for row in rows])
    strips = tuple(Ruled("strip", rows[k], rows[k + 1], bent[k] | bent[k + 1]) for k in range(count))
    inner = np.linspace(0.0, 1.0, 7)[1:-1]
    sight = np.concatenate([points(s, inner)[::8].reshape(-1, 3) for s in strips])
    apart = near.distance(sight)[0].reshape(count, -1).max(axis=1)
    normals = [outward(s) for s in strips]
    kink = [_angle(one[1], two[0]).max() for one, two in itertools.pairwise(normals)]
    return Strips(strips, apart, np.array(kink), breaks)


def _folded(patch: Patch, across: Across, found: Strips) -> Strips:
    """The strips with rulings where the mesh folds either of their curves."""
    if not len(patch.edges):
        return found
    folds = [_kinks(patch, across, float(at)) for at in found.breaks]
    out = []
    for k, strip in enumerate(found.strips):
        kinks = np.union1d(folds[k], folds[k + 1])
        kinks = kinks[np.diff(kinks, prepend=-1.0) > _SAME_FOLD]
        even = np.linspace(0.0, 1.0, len(strip.start))
        near = np.abs(even[:, None] - kinks).min(axis=1, initial=np.inf) < 0.25 / _RULINGS_PER_STRIP
        near[[0, -1]] = False
        place = np.sort(np.concatenate([even[~near], kinks]))
        rows = parameter_grid(patch, across, found.breaks[k : k + 2], place)
        corner = np.isin(place, kinks)
        if (across == "u") == patch.right:
            rows, corner = rows[:, ::-1], corner[::-1]
        out.append(Ruled(strip.name, rows[0], rows[1], corner))
    return dataclasses.replace(found, strips=tuple(out))


def _kinks(patch: Patch, across: Across, at: float) -> FloatArray:
    """Where (K,) the curve at the value ``at`` has kinks of its own: folds of more than ``KINK_ANGLE``.
    Where all facets are so small that folds lie closer together than ``SMOOTH_FACET_LENGTH``, they stand for
    a smooth curve."""
    place, turn = patch.folds(0 if across == "u" else 1, at)
    place, turn = place[turn > KINK_ANGLE], turn[turn > KINK_ANGLE]
    ends = np.concatenate([[0.0], place, [1.0]])
    points = parameter_grid(patch, across, np.array([at]), ends)[0]
    way = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.asarray(place[(np.maximum(way[:-1], way[1:]) > SMOOTH_FACET_LENGTH) | (turn > CORNER_ANGLE)])


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)))


def strip_notes(found: Strips) -> str:
    """What is found, in words."""
    off = ", ".join(f"{v / MM:.3g}" for v in found.deviation)
    kinks = ", ".join(f"{v / DEG:.2f}" for v in found.kink) or "none"
    return (
        f"{len(found.strips)} ruled strips; largest deviation of each from the surface [mm]: {off}; "
        "kinks between "
        f"neighbours [deg]: {kinks}"
    )


_CURVE_GRID: Final = 40
"""Intervals of the grid over two curves on which rulings that lie in a face are looked for first."""
_RULING_SHARES: Final = np.array([1.0, 2.0, 3.0, 4.0, 5.0]) / 6.0
"""Places along a ruling whose distance from the face counts."""
_POINTS_PER_SIDE: Final = 400
"""Points along each side of a patch."""


@dataclasses.dataclass(frozen=True)
class Deviation:
    """How far a ruled surface and the wanted one are apart: largest and 95 % value [m], and where (3,)
    [m].
    """

    largest: float
    usual: float
    where: FloatArray


def find_rulings(patch: Patch, name: str) -> tuple[Ruled, Deviation]:
    """The ruled surface nearest to a patch, between one pair of its opposite sides or the other.

    Rulings join points of both sides so that the mean square distance of the rulings from the surface is
    least. It looks the way that the patch does.
    """
    even = np.linspace(0.0, 1.0, _POINTS_PER_SIDE + 1)
    zero, one = np.zeros_like(even), np.ones_like(even)
    near, coarse = (Nearness(patch.mesh, share * _spacing(patch.mesh)) for share in (1.0, 5.0))
    best: tuple[Ruled, Deviation] | None = None
    pairs = (
        (patch.points(zero, even), patch.points(one, even)),
        (patch.points(even, zero), patch.points(even, one)),
    )
    for first, second in pairs:
        start, end = polyline(first), polyline(second)
        ruled = _facing(_matched(name, start, end, coarse), near)
        found = deviation(ruled, patch.mesh, near)
        if best is None or found.largest < best[1].largest:
            best = ruled, found
    if best is None:
        raise ValueError("a patch has two pairs of sides")
    return best


def deviation(ruled: Ruled, mesh: TriangleMesh, near: Nearness) -> Deviation:
    """How far the ruled surface and the mesh are apart, looked at from both."""
    own = resample(ruled, 1e-4, max(2.0 * near_step(mesh), 1e-3))
    sight = points(own, np.linspace(0.0, 1.0, 21)).reshape(-1, 3)
    facets = tessellate(own, 1e-5)
    other = Nearness(TriangleMesh(facets.vertices, facets.faces), _spacing(mesh))
    seen = np.concatenate([sight, mesh.vertices])
    apart = np.concatenate([near.distance(sight)[0], other.distance(mesh.vertices)[0]])
    worst = int(np.argmax(apart))
    return Deviation(float(apart[worst]), float(np.quantile(apart, 0.95)), seen[worst])


def near_step(mesh: TriangleMesh) -> float:
    """A step [m] in which deviations from a mesh are looked at: a hundredth of its extent."""
    return 0.01 * float(np.ptp(mesh.vertices, axis=0).max())


def _spacing(mesh: TriangleMesh) -> float:
    return float(np.ptp(mesh.vertices, axis=0).max()) / 150.0


def _matched(name: str, start: Guide, end: Guide, near: Nearness) -> Ruled:
    places = [arc_length(g.points) / g.length for g in (start, end)]
    size = max(start.length, end.length)

    def ruling(s: FloatArray, t: FloatArray) -> FloatArray:
        """Distances (K, A) of points along rulings from the surface, per size."""
        a, b = along(start.points, places[0], s), along(end.points, places[1], t)
        sight = (1.0 - _RULING_SHARES[:, None]) * a[:, None] + _RULING_SHARES[:, None] * b[:, None]
        return near.distance(sight.reshape(-1, 3))[0].reshape(len(s), -1) / size

    even = np.linspace(0.0, 1.0, _CURVE_GRID + 1)
    s, t = (w.ravel() for w in np.meshgrid(even, even, indexing="ij"))
    cost = np.sum(ruling(s, t) ** 2, axis=1).reshape(_CURVE_GRID + 1, _CURVE_GRID + 1)
    cost += 1e-9 * (even[:, None] - even[None, :]) ** 2
    s, t = best_path(cost, ruling, 1e-9, 1e-11)
    path = np.unique(np.concatenate([s + t, np.linspace(0.0, 2.0, _POINTS_PER_SIDE + 1)]))
    own_s, own_t = np.interp(path, s + t, s), np.interp(path, s + t, t)
    smooth = np.zeros(len(path), dtype=np.bool_)
    ruled = Ruled(name, along(start.points, places[0], own_s), along(end.points, places[1], own_t), smooth)
    return resample(ruled, 0.5e-5, 1.0)


def _facing(ruled: Ruled, near: Nearness) -> Ruled:
    """The surface looking the way that the mesh does."""
    middle = points(ruled, np.array([0.5]))[:, 0]
    _, face = near.distance(middle)
    normal = face_normals(near.mesh)[face]
    start, end = outward(ruled)
    return backwards(ruled) if float(np.sum(normal * (start + end))) < 0.0 else ruled
