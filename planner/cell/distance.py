"""Distances of convex solids in batches: closed forms where they exist, else GJK with a certificate.

A solid is a core, enlarged by a rounding: a sphere's core is its centre, a capsule's its axis. Boxes,
cylinders and convex meshes are their own cores. Two segments have Ericson's closed form (Real-Time Collision
Detection, 2005, section 5.1.9). For a segment and a box the squared distance is quadratic between the points
where the segment crosses a face's plane. Its slope is linear there and gives the minimum exactly. All others
use the algorithm of Gilbert, Johnson and Keerthi (IEEE J. Robotics and Automation, 1988) on the difference of
the cores: with v its point nearest to the origin so far, and w the support against v, v.w / |v| is a lower
bound of the distance by convexity, and |v| an upper one. The lower one is returned once both agree.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.cell.bodies import Solid
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, dots, lengths

DISTANCE_TOLERANCE_M: Final = 1e-7
"""Difference [m] at which the bounds of a distance agree."""
MAX_GJK_STEPS: Final = 200
"""Maximum number of GJK steps. A pair that has not converged keeps its lower bound."""
OVERLAP_TOLERANCE_M: Final = 1e-9
"""Cores closer than this [m] overlap."""
_EDGES: Final = np.array(list(itertools.combinations(range(4), 2)))
"""Corners (6, 2) of the edges of a tetrahedron."""
_TRIANGLES: Final = np.array(list(itertools.combinations(range(4), 3)))
"""Corners (4, 3) of the faces of a tetrahedron."""


@dataclasses.dataclass(frozen=True, eq=False)
class Cores:
    """Cores of S solids in their shapes' frames.

    A core is a mesh, or the sum of a box and a disc. The solid is the core enlarged by a ball.

    Attributes:
        half: Half sizes of the box (S, 3) [m], 0 for a mesh.
        disc: Radius of the disc across z (S,) [m], 0 unless the solid is a cylinder.
        rounding: Radius of the ball (S,) [m], 0 unless the solid is a sphere or capsule.
        mesh: Corners of meshes (S, V, 3) [m]. A mesh with fewer corners repeats its first one.
        is_mesh: Whether the core is a mesh (S,).
        is_segment: Whether the core is a point or segment (S,). Segments and boxes have closed forms.
        is_box: Whether the core is a box (S,).
    """

    half: FloatArray
    disc: FloatArray
    rounding: FloatArray
    mesh: FloatArray
    is_mesh: BoolArray
    is_segment: BoolArray
    is_box: BoolArray

    def support(self, which: IndexArray, direction: FloatArray) -> FloatArray:
        """Return the farthest points (M, 3) of cores ``which`` (M,) along directions (M, 3).

        Directions and points are in the frames of the cores.
        """
        out = np.where(direction < 0.0, -1.0, 1.0) * self.half[which]
        flat = direction[:, :2]
        length = np.sqrt(flat[:, 0] ** 2 + flat[:, 1] ** 2)
        out[:, :2] += (self.disc[which] / np.maximum(length, 1e-300))[:, None] * flat
        meshed = np.flatnonzero(self.is_mesh[which])
        if len(meshed):
            corners = self.mesh[which[meshed]]
            best = np.einsum("mvc,mc->mv", corners, direction[meshed]).argmax(axis=1)
            out[meshed] = corners[np.arange(len(meshed)), best]
        return out


def make_cores(solids: Sequence[Solid]) -> Cores:
    """Return the cores of solids, which :func:`measure_distances` compares."""
    count = len(solids)
    half, disc, rounding = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    kind = [solid.shape.kind for solid in solids]
    max_corners = max((len(s.shape.vertices) for s in solids if s.shape.vertices is not None), default=1)
    mesh = np.zeros((count, max_corners, 3)) if "mesh" in kind else np.zeros((count, 0, 3))
    for k, solid in enumerate(solids):
        size, corners = solid.shape.size, solid.shape.vertices
        if corners is not None:
            mesh[k] = np.concatenate([corners, np.repeat(corners[:1], max_corners - len(corners), axis=0)])
        elif kind[k] == "box":
            half[k] = 0.5 * np.asarray(size)
        else:
            half[k, 2] = 0.5 * size[1] if len(size) > 1 else 0.0
            (disc if kind[k] == "cylinder" else rounding)[k] = size[0]
    meshed = np.array([name == "mesh" for name in kind], dtype=np.bool_)
    segment = np.array([name in ("sphere", "capsule") for name in kind], dtype=np.bool_)
    box = np.array([name == "box" for name in kind], dtype=np.bool_)
    return Cores(half, disc, rounding, mesh, meshed, segment, box)


def measure_distances(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    pose: FloatArray,
    other_pose: FloatArray,
    threshold: float | FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measure the distances of pairs of solids and the lines along which they are measured.

    Distances are at most :data:`DISTANCE_TOLERANCE_M` below the truth and never above it. If solids overlap
    but their cores do not, the distance is minus the depth. If the cores overlap, the distance only bounds
    that value from above, and the direction is 0.

    Args:
        cores: Cores of all solids.
        first: Indices of the first solids (M,).
        second: Indices of the second solids (M,).
        pose: Poses of the first solids (M, 4, 4).
        other_pose: Poses of the second solids (M, 4, 4).
        threshold: Threshold [m], one or (M,). If given, the caller only needs to know whether a distance is
            above it, so any value on the right side is sufficient.

    Returns:
        Distances (M,) [m], unit vectors from the second to the first (M, 3), and points on these lines (M, 3)
        [m].
    """
    thresholds = None if threshold is None else np.broadcast_to(np.asarray(threshold), first.shape)
    gap, direction, point = np.empty(len(first)), np.zeros((len(first), 3)), np.zeros((len(first), 3))
    segments = cores.is_segment[first] & cores.is_segment[second]
    boxed = cores.is_box[first] & cores.is_segment[second] | cores.is_segment[first] & cores.is_box[second]
    for selected, kernel in (
        (segments, _segment_distances),
        (boxed, _segment_box_distances),
        (~(segments | boxed), _gjk_distances),
    ):
        rows = np.flatnonzero(selected)
        if len(rows):
            kernel_thresholds = None if thresholds is None else thresholds[rows]
            gap[rows], direction[rows], point[rows] = kernel(
                cores, first[rows], second[rows], pose[rows], other_pose[rows], kernel_thresholds
            )
    return gap - cores.rounding[first] - cores.rounding[second], direction, point


_DistanceLines = tuple[FloatArray, FloatArray, FloatArray]
"""Distances (M,) of cores, directions (M, 3) from the second to the first, and points (M, 3) of the lines."""


def _segment_distances(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    pose: FloatArray,
    other_pose: FloatArray,
    threshold: FloatArray | None,
) -> _DistanceLines:
    """Measure the distances of cores that are points or segments along the z of their frames.

    The arguments are those of :func:`measure_distances`, for pairs of this kind only.
    """
    del threshold  # closed forms need no search
    along = pose[:, :3, 2]
    half = cores.half[first, 2], cores.half[second, 2]
    ray, s = segment_vectors(pose[:, :3, 3] - other_pose[:, :3, 3], along, other_pose[:, :3, 2], *half)
    gap, direction = _normalise(ray)
    return gap, direction, pose[:, :3, 3] + s[:, None] * along


def segment_vectors(
    w: FloatArray, along: FloatArray, across: FloatArray, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the shortest vectors (M, 3) from second to first segments, and positions (M,) on the first.

    Positions count from the middle of the first segment.

    Args:
        w: Vectors from middle to middle (M, 3) [m].
        along: Unit axes of the first segments (M, 3).
        across: Unit axes of the second segments (M, 3).
        a: Half lengths of the first segments (M,) [m].
        b: Half lengths of the second segments (M,) [m].

    Source: Ericson, Real-Time Collision Detection, 2005, section 5.1.9.
    """
    # |w + s u - t v|^2 is least at s = (c v.w - u.w) / (1 - c^2) with c = u.v, for a given t at
    # s = c t - u.w, for a given s at t = c s + v.w. Candidates with s or t at its end cover all cases.
    cosine, ca, cb = dots(along, across), dots(along, w), dots(across, w)
    sine2 = 1.0 - cosine * cosine
    is_parallel = sine2 < 1e-12  # nearly parallel: below 1e-6 rad
    inner = np.clip(np.where(is_parallel, -ca, (cosine * cb - ca) / np.where(is_parallel, 1.0, sine2)), -a, a)
    # for nearly parallel segments the formula cancels out; then the ends are as close as any point
    s = np.stack([inner, a, -a, np.clip(cosine * b - ca, -a, a), np.clip(-cosine * b - ca, -a, a)])
    t = np.clip(cosine * s + cb, -b, b)
    s = np.clip(cosine * t - ca, -a, a)
    square = s * s + t * t - 2.0 * cosine * s * t + 2.0 * ca * s - 2.0 * cb * t
    best = square.argmin(axis=0)
    s, t = s[best, np.arange(len(best))], t[best, np.arange(len(best))]
    return np.asarray(w + s[:, None] * along - t[:, None] * across), s


def _segment_box_distances(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    pose: FloatArray,
    other_pose: FloatArray,
    threshold: FloatArray | None,
) -> _DistanceLines:
    """Measure the distances of pairs of a segment and a box. In a pair, either of them may come first.

    They are computed in the frame of the box, and the results are in the world. The arguments are those of
    :func:`measure_distances`.
    """
    del threshold  # closed forms need no search
    is_box_first = cores.is_box[first]
    segment, box = np.where(is_box_first, second, first), np.where(is_box_first, first, second)
    segment_pose, box_pose = (
        np.where(is_box_first[:, None, None], x, y) for x, y in ((other_pose, pose), (pose, other_pose))
    )
    box_axes = box_pose[:, :3, :3]
    middle = np.einsum("mc,mcd->md", segment_pose[:, :3, 3] - box_pose[:, :3, 3], box_axes)
    along = np.einsum("mc,mcd->md", segment_pose[:, :3, 2], box_axes)
    half = cores.half[box]
    position = nearest_position_to_box(middle, along, cores.half[segment, 2], half)
    point = middle + position[:, None] * along
    ray = np.sign(point) * np.maximum(np.abs(point) - half, 0.0)
    gap, direction = _normalise(np.einsum("md,mcd->mc", ray, box_axes))
    world_point = segment_pose[:, :3, 3] + position[:, None] * segment_pose[:, :3, 2]
    return gap, np.where(is_box_first[:, None], -direction, direction), world_point


def nearest_position_to_box(
    start: FloatArray, along: FloatArray, reach: FloatArray, half: FloatArray
) -> FloatArray:
    """Return the positions (M,) [m] on segments, from their middles, nearest to boxes about the origin.

    Args:
        start: Middles of the segments (M, 3) [m].
        along: Unit axes of the segments (M, 3).
        reach: Half lengths of the segments (M,) [m].
        half: Half sizes of the boxes (M, 3) [m].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate([(half - start) / along, (-half - start) / along], axis=1)
    crossings = np.where(np.isfinite(crossings), crossings, 0.0)
    t = np.clip(
        np.concatenate([crossings, reach[:, None], -reach[:, None]], axis=1), -reach[:, None], reach[:, None]
    )
    t.sort(axis=1)
    points = start[:, None] + t[..., None] * along[:, None]
    beyond = np.sign(points) * np.maximum(np.abs(points) - half[:, None], 0.0)
    # half the slope of the squared distance, linear between crossings: its root is the nearest point
    slope = np.einsum("mkc,mc->mk", beyond, along)
    right = np.clip((slope < 0.0).sum(axis=1), 1, t.shape[1] - 1)  # slopes ascend: the distance is convex
    rows = np.arange(len(t))
    low, high = slope[rows, right - 1], slope[rows, right]
    fraction = np.where(high > low, np.clip(-low / np.where(high > low, high - low, 1.0), 0.0, 1.0), 0.0)
    return np.asarray(t[rows, right - 1] + fraction * (t[rows, right] - t[rows, right - 1]))


def _normalise(ray: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lengths (M,) of vectors (M, 3) and their unit vectors, 0 if the cores overlap."""
    length = lengths(ray)
    return length, ray / np.where(length > OVERLAP_TOLERANCE_M, length, np.inf)[:, None]


def _gjk_distances(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    pose: FloatArray,
    other_pose: FloatArray,
    threshold: FloatArray | None,
) -> _DistanceLines:
    """Measure the distances of cores by GJK, for pairs without a closed form.

    The results are lower bounds with their directions and points. Distance and direction are 0 if the cores
    overlap. With thresholds (M,) [m], a pair is done once it is known on which side of its threshold the
    distance of the solids lies.
    """
    count = len(first)
    gap, direction, point = np.zeros(count), np.zeros((count, 3)), pose[:, :3, 3].copy()
    active = np.arange(count)
    core_threshold = (
        (0.0 if threshold is None else threshold) + cores.rounding[first] + cores.rounding[second]
    )
    nearest = pose[:, :3, 3] - other_pose[:, :3, 3]
    nearest[lengths(nearest) < OVERLAP_TOLERANCE_M] = [1.0, 0.0, 0.0]
    # corners of the simplex in the difference of the cores, and their points on the first core
    corner, first_corner = np.zeros((count, 4, 3)), np.zeros((count, 4, 3))
    used = np.zeros((count, 4), dtype=np.bool_)
    for _ in range(MAX_GJK_STEPS):
        # lower bound v.w / |v|, with w the support of the difference of the cores against v
        v = nearest[active]
        norm = lengths(v)
        first_support = _support(cores, first[active], pose[active], -v)
        support = first_support - _support(cores, second[active], other_pose[active], v)
        low = dots(v, support) / norm
        better = low > gap[active]
        gap[active[better]], direction[active[better]] = low[better], v[better] / norm[better, None]
        started = used[active].any(axis=1)  # in the first step ``nearest`` is only a guess, not a point
        # a pair is done if both bounds agree, or if one of them decides on which side of the threshold it is
        continues = ~(started & (norm - gap[active] < DISTANCE_TOLERANCE_M))
        if threshold is not None:
            continues &= ~(started & (norm <= core_threshold[active])) & (
                gap[active] <= core_threshold[active]
            )
        active, support, first_support = active[continues], support[continues], first_support[continues]
        if not len(active):
            break
        # add w to the simplex, and reduce it to the corners around its point nearest to the origin
        free = used[active].argmin(axis=1)
        corner[active, free], first_corner[active, free] = support, first_support
        used[active, free] = True
        nearest_point, weights, inside = _nearest_on_simplex(corner[active], used[active])
        nearest[active], used[active] = nearest_point, weights > 0.0
        point[active] = np.einsum("mk,mkc->mc", weights, first_corner[active])
        gap[active[inside]] = 0.0
        direction[active[inside]] = 0.0
        active = active[~inside & (lengths(nearest_point) > OVERLAP_TOLERANCE_M)]
    return gap, direction, point


def _support(cores: Cores, which: IndexArray, pose: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the farthest points (M, 3) along directions (M, 3) of placed cores ``which`` (M,)."""
    local = np.einsum("mc,mcd->md", direction, pose[:, :3, :3])
    return np.asarray(np.einsum("mcd,md->mc", pose[:, :3, :3], cores.support(which, local)) + pose[:, :3, 3])


def _nearest_on_simplex(corner: FloatArray, used: BoolArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Find the points of simplices nearest to the origin.

    Args:
        corner: Corners of the simplices (M, 4, 3).
        used: Whether a corner belongs to its simplex (M, 4).

    Returns:
        Points (M, 3), barycentric weights of the corners (M, 4), and whether the origin is inside (M,).
    """
    count = len(corner)
    weights = np.zeros((count, 4))
    max_corners = int(used.sum(axis=1).max(initial=0))
    if max_corners < 2:  # first step: single corners
        which = used.argmax(axis=1)
        weights[np.arange(count), which] = 1.0
        return corner[np.arange(count), which], weights, np.zeros(count, dtype=np.bool_)
    a, b = corner[:, _EDGES[:, 0]], corner[:, _EDGES[:, 1]]
    # point of an edge nearest to the origin: a + t (b - a), t = -a.(b - a) / |b - a|^2
    edge = b - a
    square = np.einsum("mkc,mkc->mk", edge, edge)
    t = -np.einsum("mkc,mkc->mk", a, edge) / np.where(square > 0.0, square, 1.0)
    edge_valid = used[:, _EDGES].all(axis=2) & (t > 0.0) & (t < 1.0) & (square > 0.0)
    on_edge = a + t[..., None] * edge
    if max_corners < 3:  # second step: edges
        points = np.concatenate([corner, on_edge], axis=1)
        valid = np.concatenate([used, edge_valid], axis=1)
        best = np.where(valid, np.einsum("mkc,mkc->mk", points, points), np.inf).argmin(axis=1)
        _write_edge_weights(weights, best, t)
        return points[np.arange(count), best], weights, np.zeros(count, dtype=np.bool_)

    x, y, z = (corner[:, _TRIANGLES[:, k]] for k in range(3))
    # Corners p, q, r of a face: n = (q - p) x (r - p) = q x r + r x p + p x q. The point of the plane is
    # n (p.n) / |n|^2, with the weights (q x r).n / |n|^2 at p, and so on.
    opposite = _cross(np.stack([y, z, x]), np.stack([z, x, y]))
    normal = opposite.sum(axis=0)
    area = np.einsum("mkc,mkc->mk", normal, normal)
    divisor = np.where(area > 0.0, area, 1.0)
    face_weights = np.einsum("nmkc,mkc->nmk", opposite, normal) / divisor
    on_face = normal * (np.einsum("mkc,mkc->mk", x, normal) / divisor)[..., None]
    face_valid = used[:, _TRIANGLES].all(axis=2) & (face_weights > 0.0).all(axis=0) & (area > 1e-30)

    points = np.concatenate([corner, on_edge, on_face], axis=1)
    valid = np.concatenate([used, edge_valid, face_valid], axis=1)
    # of all valid points the nearest: index 0 to 3 is a corner, 4 to 9 on an edge, 10 to 13 on a face
    best = np.where(valid, np.einsum("mkc,mkc->mk", points, points), np.inf).argmin(axis=1)
    _write_edge_weights(weights, best, t)
    rows = np.flatnonzero(best >= 10)
    which = best[rows] - 10
    weights[rows[:, None], _TRIANGLES[which]] = face_weights[:, rows, which].T
    # the origin is inside if its volumes with all four faces have one sign
    volumes = np.einsum("mkc,mkc->mk", opposite[2], z) * np.array([1.0, -1.0, 1.0, -1.0])
    inside = used.all(axis=1) & ((volumes > 0.0).all(axis=1) | (volumes < 0.0).all(axis=1))
    return points[np.arange(count), best], weights, inside


def _write_edge_weights(weights: FloatArray, best: IndexArray, t: FloatArray) -> None:
    """Write the weights (M, 4) of corners where the nearest point is a corner or on an edge.

    Args:
        weights: Barycentric weights (M, 4), changed in place.
        best: Index of the nearest point (M,): 0 to 3 for corners, 4 to 9 for edges.
        t: Position of the nearest point on each edge (M, 6), 0 to 1.
    """
    rows = np.flatnonzero(best < 4)
    weights[rows, best[rows]] = 1.0
    rows = np.flatnonzero((best >= 4) & (best < 10))
    which = best[rows] - 4
    weights[rows[:, None], _EDGES[which]] = np.stack([1.0 - t[rows, which], t[rows, which]], axis=1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return cross products (..., 3). NumPy's own takes several times as long for small arrays."""
    out = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out
