"""Control points of a path: a few points whose springback represents that of their neighbourhood.

A loop of the path is divided where its shape changes. The features of a point are dimensionless: wall angle
over 45 deg, curvature in plan and curvature across the loop, both times the tool's radius (curvature, not
radius, so that a straight wall is 0; positive where the part is convex). Neighbours on the ring are merged by
Ward's distance

    d(A, B) = n_A n_B / (n_A + n_B) |mean_A - mean_B|^2,

and the number of clusters K is that of the largest index of Calinski and Harabasz, "A dendrite method for
cluster analysis", Communications in Statistics 3 (1974) 1,

    CH(K) = [B / (K - 1)] / [(W + n f^2) / (n - K)],

with W the spread within clusters, B that between them, and a floor f. Without the floor a clean shape is
divided until only its smeared corners are left. A spread below the floor is one cluster, as that of a cone.
Where a pass starts or ends, tools roll over an edge, and the rolling hides the shape in a loop there. So a
loop that has at most half as many clusters as most loops of its pass is divided as the next one below that is
not affected.
"""

import dataclasses
import heapq
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.units import DEG, MM
from planner.processes.forming.plan.features.surface import plan_area

ANGLE_UNIT: Final = 45.0 * DEG
"""Wall angle [rad] that counts as 1 among the features."""
SPREAD_FLOOR: Final = 0.1
"""Spread of dimensionless features that counts as none."""
POINTS_PER_RADIUS: Final = 5
"""Points of a loop per tool radius of its length; curvature is fitted to as many on either side."""
MIN_RING_POINTS: Final = 4 * POINTS_PER_RADIUS
"""Minimum number of points of a loop, however short it is."""
FEW_CLUSTERS_FRACTION: Final = 0.5
"""Number of clusters of a loop, as a fraction of that of most loops of its pass, that is too small."""
MAX_CLUSTERS: Final = 24
"""Maximum number of clusters of a loop."""
MAX_CONTROL_POINTS: Final = 60
"""Maximum number of control points of a pass, except as required by `MIN_LEVELS`."""
MIN_LEVELS: Final = 3
"""Minimum number of levels of a pass with control points, if it has as many loops."""
TURN_DEPTH_FRACTION: Final = 0.25
"""Fraction of a pass' depth to which a change of the wall angle by `ANGLE_UNIT` is equivalent in the choice
of levels.
"""
MIN_LEVEL_DISTANCE_M: Final = 0.05 * MM
"""Minimum depth [m] between any two levels with control points: loops of one floor are one level."""
LEVEL_SPACING_M: Final = 1.0 * MM
"""Minimum mean depth [m] between levels with control points: springback changes slowly with depth."""


@dataclasses.dataclass(frozen=True)
class ClusterRing:
    """A loop as N equidistant points, closed.

    Attributes:
        point: Points (N, 3) [m].
        angle: Wall angles (N,) [rad].
        label: Cluster (N,) of each point, counted along the ring.
    """

    point: FloatArray
    angle: FloatArray
    label: IntArray


@dataclasses.dataclass(frozen=True)
class ControlPoints:
    """C control points of a pass.

    Attributes:
        point: Points (C, 3) [m] on the contact's path.
        angle: Wall angles (C,) [rad] there.
        level: Index (C,) of their ring in ``rings``.
        ring_index: Index (C,) of their point on the ring.
        cluster: Cluster (C,) on the ring.
        rings: Rings with control points, L of them.
        loop: Loop (L,) of the path of each ring.
        clusters: Number (M,) of clusters of each of the path's M loops.
    """

    point: FloatArray
    angle: FloatArray
    level: IntArray
    ring_index: IntArray
    cluster: IntArray
    rings: tuple[ClusterRing, ...]
    loop: IntArray
    clusters: IntArray


def choose_control_points(
    point: FloatArray, angle: FloatArray, loop: IntArray, radius: float, max_points: int = MAX_CONTROL_POINTS
) -> ControlPoints:
    """Return the points of a path at which springback is solved: the middle of each cluster on some levels.

    A cluster is a section of a loop with similar wall angle and curvature, whose springback the point
    represents. The levels are evenly spaced in depth and wall angle.

    Args:
        point: Contact points (N, 3) [m] of the targets.
        angle: Wall angles (N,) [rad] there.
        loop: Loop (N,) of each target.
        radius: Radius [m] of the tool.
        max_points: Maximum number of points, as far as `MIN_LEVELS` permits.
    """
    numbers = np.unique(loop)
    rings = [_resample_ring(point[loop == k], angle[loop == k], radius) for k in numbers]
    rings = _divide_like_neighbours(_label_rings(rings, radius))
    clusters = np.array([int(ring.label.max()) + 1 for ring in rings])
    depth = np.array([float(ring.point[:, 2].mean()) for ring in rings])
    mean_angle = np.array([float(ring.angle.mean()) for ring in rings])
    chosen = _choose_levels(depth, mean_angle, clusters, max_points)
    entries = [
        (level, ring_index, cluster)
        for level, k in enumerate(chosen)
        for cluster, ring_index in enumerate(cluster_middles(rings[k].label))
    ]
    level, ring_index, cluster = np.array(entries, dtype=np.int64).T
    chosen_rings = tuple(rings[k] for k in chosen)
    return ControlPoints(
        point=np.stack([chosen_rings[i].point[j] for i, j in zip(level, ring_index, strict=True)]),
        angle=np.array([chosen_rings[i].angle[j] for i, j in zip(level, ring_index, strict=True)]),
        level=level,
        ring_index=ring_index,
        cluster=cluster,
        rings=chosen_rings,
        loop=numbers[chosen],
        clusters=clusters,
    )


def _choose_levels(
    depth: FloatArray, mean_angle: FloatArray, clusters: IntArray, max_points: int
) -> IntArray:
    """Return the indices of the loops that get control points: the first, the last, and others between.

    The loops are evenly spaced in the sum of the changes of depth and wall angle, because force and sheet
    change with both. They are on average at least LEVEL_SPACING_M apart in depth.

    Args:
        depth: Mean height z (M,) [m] of each loop.
        mean_angle: Mean wall angle (M,) [rad] of each loop.
        clusters: Number (M,) of clusters of each loop.
        max_points: Maximum number of clusters of all chosen loops together. It does not reduce the number of
            loops below `MIN_LEVELS`.
    """
    distance_down = np.abs(depth - depth[0])
    total_depth = max(float(distance_down.max()), 1e-12)
    progress = np.append(
        0.0,
        np.cumsum(
            np.abs(np.diff(depth)) / total_depth
            + TURN_DEPTH_FRACTION * np.abs(np.diff(mean_angle)) / ANGLE_UNIT
        ),
    )
    max_levels = 1 + int(np.ceil(float(distance_down.max()) / LEVEL_SPACING_M))
    for count in range(min(max_levels, len(depth)), 0, -1):
        goals = np.linspace(0.0, float(progress[-1]), count) if count > 1 else progress[-1:]
        chosen = _distinct_depths(depth, np.unique(np.abs(progress[:, None] - goals).argmin(axis=0)))
        if clusters[chosen].sum() <= max_points or count <= MIN_LEVELS:
            break
    return np.asarray(chosen)


def _distinct_depths(depth: FloatArray, chosen: IntArray) -> IntArray:
    """Return those of the ``chosen`` loops that have distinct depths; ``depth`` (M,) [m] is of all loops."""
    kept: list[int] = []
    for k in chosen.tolist():
        if all(abs(float(depth[k] - depth[other])) > MIN_LEVEL_DISTANCE_M for other in kept):
            kept.append(k)
    return np.array(kept, dtype=np.int64)


def cluster_middles(label: IntArray) -> IntArray:
    """Return the index of the middle point of each cluster of a ring.

    Args:
        label: Labels (N,) of the points, counted along the ring.
    """
    n = len(label)
    out = []
    for k in range(int(label.max()) + 1):
        inside = label == k
        if inside.all():
            out.append(0)
            continue
        first = int(np.flatnonzero(inside & ~np.roll(inside, 1))[0])
        out.append((first + (int(inside.sum()) - 1) // 2) % n)
    return np.array(out, dtype=np.int64)


def _resample_ring(point: FloatArray, angle: FloatArray, radius: float) -> ClusterRing:
    """Return a loop resampled to equidistant points, as a single cluster."""
    ends = np.vstack([point, point[:1]])
    arc = arc_length(ends)
    count = max(MIN_RING_POINTS, round(float(arc[-1]) / (radius / POINTS_PER_RADIUS)))
    even_arc = np.arange(count) * (arc[-1] / count)
    even_points = interpolate_polyline(ends, arc, even_arc)
    return ClusterRing(
        even_points, np.interp(even_arc, arc, np.append(angle, angle[0])), np.zeros(count, dtype=np.int64)
    )


def _label_rings(rings: Sequence[ClusterRing], radius: float) -> list[ClusterRing]:
    """Return the rings with the clusters of their points by wall angle and both curvatures."""
    across_curvatures = curvature_across(rings)
    out = []
    for ring, across_curvature in zip(rings, across_curvatures, strict=True):
        plan_curvature = curvature_in_plan(ring.point[:, :2], POINTS_PER_RADIUS)
        features = np.stack(
            [ring.angle / ANGLE_UNIT, plan_curvature * radius, across_curvature * radius], axis=1
        )
        out.append(dataclasses.replace(ring, label=ring_clusters(features)))
    return out


def _divide_like_neighbours(rings: Sequence[ClusterRing]) -> list[ClusterRing]:
    """Return the rings, with those that have few clusters divided like another ring.

    They are divided at the points nearest in plan to the divisions of the next ring below with a usual number
    of clusters, or else above.
    """
    count = np.array([int(ring.label.max()) + 1 for ring in rings])
    usual_count = float(np.median(count))
    usual_rings = np.flatnonzero(count >= usual_count)
    out = list(rings)
    for k in np.flatnonzero(count <= FEW_CLUSTERS_FRACTION * usual_count).tolist():
        below = usual_rings[usual_rings > k]
        reference = rings[int(below[0] if len(below) else usual_rings[-1])]
        plan_points = rings[k].point[:, :2]
        divisions = reference.point[reference.label != np.roll(reference.label, 1), :2]
        starts = np.zeros(len(plan_points), dtype=np.bool_)
        starts[lengths(plan_points[:, None] - divisions[None]).argmin(axis=0)] = True
        label = (np.cumsum(starts) - 1) % np.count_nonzero(starts)
        out[k] = dataclasses.replace(rings[k], label=label)
    return out


def curvature_in_plan(xy: FloatArray, window: int) -> FloatArray:
    """Return the signed curvatures (N,) [1/m] of a closed polyline, positive where it is convex.

    A circle is fitted to each point with ``window`` points on either side. The fit is Pratt's, "Direct
    least-squares fitting of algebraic surfaces", SIGGRAPH 21 (1987) 145: of all A (x^2 + y^2) + B x + C y + D
    with B^2 + C^2 - 4 A D = 1 the one with the smallest sum of squares. Its curvature is 2 A, and 0 for a
    straight line.

    Args:
        xy: Points (N, 2) [m].
        window: Number of points on either side.
    """
    n = len(xy)
    indices = (np.arange(n)[:, None] + np.arange(-window, window + 1)) % n
    neighbourhood = xy[indices] - xy[:, None]
    scale = float(np.sqrt((neighbourhood**2).sum(axis=2).mean()))
    neighbourhood = neighbourhood / scale
    terms = np.concatenate(
        [
            (neighbourhood**2).sum(axis=2, keepdims=True),
            neighbourhood,
            np.ones((*neighbourhood.shape[:2], 1)),
        ],
        axis=2,
    )
    moments = np.einsum("nki,nkj->nij", terms, terms) / terms.shape[1]
    # inverse of the matrix of the constraint, the quadratic form B^2 + C^2 - 4 A D in (A, B, C, D)
    inverse = np.zeros((4, 4))
    inverse[1, 1] = inverse[2, 2] = 1.0
    inverse[0, 3] = inverse[3, 0] = -0.5
    values, vectors = np.linalg.eig(inverse @ moments)
    values, vectors = values.real, vectors.real
    # exact circles have an eigenvalue of 0, which rounding may put below it
    best_index = np.where(values >= -1e-12, values, np.inf).argmin(axis=1)
    a, b, c, d = np.take_along_axis(vectors, best_index[:, None, None], axis=2)[:, :, 0].T
    # the gradient at the point itself, relative to the direction of travel, shows the inside of the circle
    direction = np.roll(xy, -1, axis=0) - np.roll(xy, 1, axis=0)
    sign = np.sign(direction[:, 1] * b - direction[:, 0] * c)
    area = plan_area(np.vstack([xy, xy[:1]]))
    constraint_root = np.sqrt(np.maximum(b * b + c * c - 4.0 * a * d, 1e-300))
    return np.asarray(np.sign(area) * sign * 2.0 * a / constraint_root / scale)


def curvature_across(rings: Sequence[ClusterRing]) -> list[FloatArray]:
    """Return the curvatures (N,) [1/m] of the wall across each ring.

    A curvature is the change of the wall angle from the previous ring to the next one, divided by the
    distance between them. It is positive where the wall becomes steeper inward.
    """
    out = []
    for k, ring in enumerate(rings):
        previous, following = rings[max(k - 1, 0)], rings[min(k + 1, len(rings) - 1)]
        (previous_points, previous_angle), (next_points, next_angle) = (
            _nearest_in_plan(ring, other) for other in (previous, following)
        )
        distance = lengths(ring.point - previous_points) + lengths(next_points - ring.point)
        out.append(
            np.where(distance > 0.0, (next_angle - previous_angle) / np.maximum(distance, 1e-300), 0.0)
        )
    return out


def _nearest_in_plan(ring: ClusterRing, other: ClusterRing) -> tuple[FloatArray, FloatArray]:
    """Return the points (N, 3) [m] of another ring nearest in plan to a ring, and their angles (N,) [rad]."""
    if ring is other:
        return ring.point, ring.angle
    distance = lengths(ring.point[:, None, :2] - other.point[None, :, :2])
    nearest = distance.argmin(axis=1)
    return other.point[nearest], other.angle[nearest]


def ring_clusters(
    features: FloatArray, max_clusters: int = MAX_CLUSTERS, floor: float = SPREAD_FLOOR
) -> IntArray:
    """Return the clusters (N,) of the points of a ring, counted along it from the one with the first point.

    Each cluster is one arc of the ring. Neighbouring arcs are merged in turn. The number of clusters is the
    one with the largest index of Calinski and Harabasz, which compares the spread between and within them.

    Args:
        features: Features (N, D) of the points.
        max_clusters: Maximum number of clusters.
        floor: Standard deviation of the features up to which all points belong to one cluster.
    """
    n = len(features)
    spread = float(((features - features.mean(axis=0)) ** 2).sum())
    if spread <= n * floor * floor or n < 3:
        return np.zeros(n, dtype=np.int64)
    ends, gained = _merge_order(features)
    # the spread within the clusters when K of them are left: merging adds Ward's distance to it
    within = np.cumsum(np.concatenate([[0.0], gained]))[::-1]
    counts = np.arange(2, min(max_clusters, n - 1) + 1)
    spread_within = within[counts - 1]
    # index of Calinski and Harabasz
    index = (spread - spread_within) / (counts - 1) / ((spread_within + n * floor * floor) / (n - counts))
    best_count = int(counts[int(np.argmax(index))])
    starts = np.zeros(n, dtype=np.bool_)
    starts[ends[n - best_count :]] = True
    return np.asarray((np.cumsum(starts) - 1) % best_count)


def _merge_order(features: FloatArray) -> tuple[IntArray, FloatArray]:
    """Merge neighbouring arcs of a ring, each time the two with the smallest Ward's distance.

    Each point is an arc at first. Returns the start (N,) of the later arc of each merge (the last one is that
    of the remaining arc), and the increase (N - 1,) of the spread by each merge.
    """
    n = len(features)
    total = [row.copy() for row in features]
    count, alive, version = [1] * n, [True] * n, [0] * n
    following, previous = [(k + 1) % n for k in range(n)], [(k - 1) % n for k in range(n)]

    def ward_distance(a: int, b: int) -> float:
        """Return the increase of the spread within arcs if the arcs with these numbers are merged."""
        difference = total[a] / count[a] - total[b] / count[b]
        return float(count[a] * count[b] / (count[a] + count[b]) * (difference @ difference))

    queue = [(ward_distance(k, following[k]), k, following[k], 0, 0) for k in range(n)]
    heapq.heapify(queue)
    order: list[int] = []
    increase: list[float] = []
    while len(order) < n - 1:
        distance, a, b, old_a, old_b = heapq.heappop(queue)
        if not (alive[a] and alive[b]) or (version[a], version[b]) != (old_a, old_b):
            continue  # one of the arcs has changed since the entry was made
        order.append(b)
        increase.append(distance)
        total[a] = total[a] + total[b]
        count[a] += count[b]
        alive[b] = False
        version[a] += 1
        following[a] = following[b]
        previous[following[b]] = a
        if len(order) < n - 1:
            for first, second in ((previous[a], a), (a, following[a])):
                heapq.heappush(
                    queue, (ward_distance(first, second), first, second, version[first], version[second])
                )
    order.append(alive.index(True))
    return np.array(order, dtype=np.int64), np.array(increase)
