"""Control points of a path: few places whose springback stands for that of their neighbours.

A loop of the path is divided where its shape changes. Features of a place, each without a unit:
wall angle over 45 deg, curvature in plan and curvature across the loop, both times the tool's
radius (curvature, not radius, so that a straight wall is 0; positive where the part is convex).
Neighbours on the ring are merged by Ward's distance

    d(A, B) = n_A n_B / (n_A + n_B) |mean_A - mean_B|^2,

and the number of clusters K is that of the largest index of Calinski and Harabasz, "A dendrite
method for cluster analysis", Communications in Statistics 3 (1974) 1,

    CH(K) = [B / (K - 1)] / [(W + n f^2) / (n - K)],

with W the spread within clusters, B that between them, and a floor f: without it a clean shape is
divided until nothing but its smeared corners is left. A spread below the floor is one cluster, as
that of a cone. Where a pass begins or ends tools roll over an edge, and a loop there shows little of the
shape beside the rolling: one that is divided half as much as most loops of its pass is divided as the next
one below that is not.
"""

import dataclasses
import heapq
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.curves import along, arc_length
from planner.geometry.units import DEG, MM
from planner.processes.forming.plan.features.surface import plan_area

ANGLE_UNIT: Final = 45.0 * DEG
"""Wall angle [rad] that counts as 1 among the features."""
FLOOR: Final = 0.1
"""Spread of features, each without a unit, that counts as none."""
PLACES_PER_RADIUS: Final = 5
"""Places of a loop in one tool radius of its length; curvature is fitted to as many on either side."""
LEAST_PLACES: Final = 4 * PLACES_PER_RADIUS
"""Places of a loop at least, however short it is."""
FEW: Final = 0.5
"""Clusters of a loop, as a share of what most loops of its pass have, that are too few."""
MOST_CLUSTERS: Final = 24
"""Clusters of a loop at most."""
MOST_POINTS: Final = 60
"""Control points of a pass at most, but for `LEAST_LEVELS`."""
LEAST_LEVELS: Final = 3
"""Levels of a pass that get control points at least, if it has as many loops."""
TURNING: Final = 0.25
"""A turn of the wall by `ANGLE_UNIT` counts as this share of a pass' depth where levels are chosen."""
LEVELS_APART: Final = 0.05 * MM
"""Depth between any two levels with control points at least [m]: loops of one floor are one level."""
LEVEL_SPACING: Final = 1.0 * MM
"""Depth between levels with control points at least [m]: springback changes slowly with depth."""


@dataclasses.dataclass(frozen=True)
class Ring:
    """A loop as N places equally far apart along it, closed: ``point`` (N, 3) [m], ``angle`` (N,) [rad] of
    the wall; ``label`` (N,) the cluster of each, counted along the ring."""

    point: FloatArray
    angle: FloatArray
    label: IntArray


@dataclasses.dataclass(frozen=True)
class ControlPoints:
    """C control points of a pass: ``point`` (C, 3) [m] on the contact's path, ``angle`` (C,) [rad] of the
    wall there, ``level`` (C,) which of ``rings`` they are on, ``place`` (C,) and ``cluster`` (C,) which of
    its places and clusters; ``loop`` (L,) which loop of the path each ring is, ``clusters`` (M,) how many
    clusters each of the path's M loops has."""

    point: FloatArray
    angle: FloatArray
    level: IntArray
    place: IntArray
    cluster: IntArray
    rings: tuple[Ring, ...]
    loop: IntArray
    clusters: IntArray


def control_points(
    point: FloatArray, angle: FloatArray, loop: IntArray, radius: float, most: int = MOST_POINTS
) -> ControlPoints:
    """Control points of a path: the middle of each cluster on levels that are evenly deep.

    ``point`` (N, 3) [m] of contact, ``angle`` (N,) [rad] of the wall and ``loop`` (N,) of each target, tool
    ``radius`` [m]. At most ``most`` points, as long as `LEAST_LEVELS` allow.
    """
    numbers = np.unique(loop)
    rings = [_even(point[loop == k], angle[loop == k], radius) for k in numbers]
    rings = _as_neighbours(_labelled(rings, radius))
    clusters = np.array([int(ring.label.max()) + 1 for ring in rings])
    depth = np.array([float(ring.point[:, 2].mean()) for ring in rings])
    steep = np.array([float(ring.angle.mean()) for ring in rings])
    chosen = _levels(depth, steep, clusters, most)
    rows = [
        (level, place, cluster)
        for level, k in enumerate(chosen)
        for cluster, place in enumerate(middles(rings[k].label))
    ]
    level, place, cluster = np.array(rows, dtype=np.int64).T
    kept = tuple(rings[k] for k in chosen)
    return ControlPoints(
        point=np.stack([kept[i].point[j] for i, j in zip(level, place, strict=True)]),
        angle=np.array([kept[i].angle[j] for i, j in zip(level, place, strict=True)]),
        level=level,
        place=place,
        cluster=cluster,
        rings=kept,
        loop=numbers[chosen],
        clusters=clusters,
    )


def _levels(depth: FloatArray, steep: FloatArray, clusters: IntArray, most: int) -> IntArray:
    """Which loops get control points, by their mean z (M,) [m] and wall angle (M,) [rad]: the first, the
    last, and others between, evenly by depth and by how the wall turns: there force and sheet change."""
    down = np.abs(depth - depth[0])
    whole = max(float(down.max()), 1e-12)
    gone = np.append(
        0.0, np.cumsum(np.abs(np.diff(depth)) / whole + TURNING * np.abs(np.diff(steep)) / ANGLE_UNIT)
    )
    wanted = 1 + int(np.ceil(float(down.max()) / LEVEL_SPACING))
    for count in range(min(wanted, len(depth)), 0, -1):
        goals = np.linspace(0.0, float(gone[-1]), count) if count > 1 else gone[-1:]
        chosen = _apart(depth, np.unique(np.abs(gone[:, None] - goals).argmin(axis=0)))
        if clusters[chosen].sum() <= most or count <= LEAST_LEVELS:
            break
    return np.asarray(chosen)


def _apart(depth: FloatArray, chosen: IntArray) -> IntArray:
    """Those of the ``chosen`` loops that are at a depth of their own, by ``depth`` (M,) [m] of all."""
    kept: list[int] = []
    for k in chosen.tolist():
        if all(abs(float(depth[k] - depth[other])) > LEVELS_APART for other in kept):
            kept.append(k)
    return np.array(kept, dtype=np.int64)


def middles(label: IntArray) -> IntArray:
    """The middle place of each cluster of a ring by its labels (N,), which are counted along it."""
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


def _even(point: FloatArray, angle: FloatArray, radius: float) -> Ring:
    """A loop as places that are equally far apart; targets are not."""
    ends = np.vstack([point, point[:1]])
    places = arc_length(ends)
    count = max(LEAST_PLACES, round(float(places[-1]) / (radius / PLACES_PER_RADIUS)))
    at = np.arange(count) * (places[-1] / count)
    even = along(ends, places, at)
    return Ring(even, np.interp(at, places, np.append(angle, angle[0])), np.zeros(count, dtype=np.int64))


def _labelled(rings: Sequence[Ring], radius: float) -> list[Ring]:
    across = curvature_across(rings)
    out = []
    for ring, turn in zip(rings, across, strict=True):
        plan = curvature_in_plan(ring.point[:, :2], PLACES_PER_RADIUS)
        features = np.stack([ring.angle / ANGLE_UNIT, plan * radius, turn * radius], axis=1)
        out.append(dataclasses.replace(ring, label=ring_clusters(features)))
    return out


def _as_neighbours(rings: Sequence[Ring]) -> list[Ring]:
    """Rings of which those with few clusters beside most are divided at the places that are nearest in plan
    to where the next ring that has as many as most is divided: of those below, or else above."""
    count = np.array([int(ring.label.max()) + 1 for ring in rings])
    usual = float(np.median(count))
    full = np.flatnonzero(count >= usual)
    out = list(rings)
    for k in np.flatnonzero(count <= FEW * usual).tolist():
        ahead = full[full > k]
        like = rings[int(ahead[0] if len(ahead) else full[-1])]
        own = rings[k].point[:, :2]
        begins = like.point[like.label != np.roll(like.label, 1), :2]
        starts = np.zeros(len(own), dtype=np.bool_)
        starts[lengths(own[:, None] - begins[None]).argmin(axis=0)] = True
        label = (np.cumsum(starts) - 1) % np.count_nonzero(starts)
        out[k] = dataclasses.replace(rings[k], label=label)
    return out


def curvature_in_plan(xy: FloatArray, window: int) -> FloatArray:
    """Signed curvatures (N,) [1/m] of a closed polyline (N, 2) [m], positive where it is convex: of circles
    fitted to each place with ``window`` places on either side.

    The fit is Pratt's, "Direct least-squares fitting of algebraic surfaces", SIGGRAPH 21 (1987) 145: of all
    A (x^2 + y^2) + B x + C y + D with B^2 + C^2 - 4 A D = 1 that of the least sum of squares. Its curvature
    is 2 A, and 0 for a straight line.
    """
    n = len(xy)
    rows = (np.arange(n)[:, None] + np.arange(-window, window + 1)) % n
    some = xy[rows] - xy[:, None]
    scale = float(np.sqrt((some**2).sum(axis=2).mean()))
    some = some / scale
    terms = np.concatenate(
        [(some**2).sum(axis=2, keepdims=True), some, np.ones((*some.shape[:2], 1))], axis=2
    )
    moments = np.einsum("nki,nkj->nij", terms, terms) / terms.shape[1]
    # the inverse of the constraint's matrix, whose form in (A, B, C, D) is B^2 + C^2 - 4 A D
    inverse = np.zeros((4, 4))
    inverse[1, 1] = inverse[2, 2] = 1.0
    inverse[0, 3] = inverse[3, 0] = -0.5
    values, vectors = np.linalg.eig(inverse @ moments)
    values, vectors = values.real, vectors.real
    # exact circles have an eigenvalue of 0, which rounding may put below it
    best = np.where(values >= -1e-12, values, np.inf).argmin(axis=1)
    a, b, c, d = np.take_along_axis(vectors, best[:, None, None], axis=2)[:, :, 0].T
    # the gradient at the place itself, against the way along: which side of the circle is inside
    way = np.roll(xy, -1, axis=0) - np.roll(xy, 1, axis=0)
    sign = np.sign(way[:, 1] * b - way[:, 0] * c)
    area = plan_area(np.vstack([xy, xy[:1]]))
    size = np.sqrt(np.maximum(b * b + c * c - 4.0 * a * d, 1e-300))
    return np.asarray(np.sign(area) * sign * 2.0 * a / size / scale)


def curvature_across(rings: Sequence[Ring]) -> list[FloatArray]:
    """Curvatures (N,) [1/m] of the wall across each ring, positive where it grows steeper inward: the change
    of the wall's angle from the ring before to the one after, over the way between them."""
    out = []
    for k, ring in enumerate(rings):
        before, after = rings[max(k - 1, 0)], rings[min(k + 1, len(rings) - 1)]
        (one, at_one), (two, at_two) = (_nearest(ring, other) for other in (before, after))
        way = lengths(ring.point - one) + lengths(two - ring.point)
        out.append(np.where(way > 0.0, (at_two - at_one) / np.maximum(way, 1e-300), 0.0))
    return out


def _nearest(ring: Ring, other: Ring) -> tuple[FloatArray, FloatArray]:
    """Of another ring the nearest place in plan to each of a ring's: points (N, 3), wall angles (N,)."""
    if ring is other:
        return ring.point, ring.angle
    apart = lengths(ring.point[:, None, :2] - other.point[None, :, :2])
    at = apart.argmin(axis=1)
    return other.point[at], other.angle[at]


def ring_clusters(features: FloatArray, most: int = MOST_CLUSTERS, floor: float = FLOOR) -> IntArray:
    """Clusters (N,) of the places of a ring by their ``features`` (N, D), counted along it from the one that
    holds the first place; each is one arc of the ring, at most ``most`` of them."""
    n = len(features)
    spread = float(((features - features.mean(axis=0)) ** 2).sum())
    if spread <= n * floor * floor or n < 3:
        return np.zeros(n, dtype=np.int64)
    ends, gained = _merges(features)
    # the spread within the clusters when K of them are left: merging adds Ward's distance to it
    within = np.cumsum(np.concatenate([[0.0], gained]))[::-1]
    counts = np.arange(2, min(most, n - 1) + 1)
    w = within[counts - 1]
    index = (spread - w) / (counts - 1) / ((w + n * floor * floor) / (n - counts))
    best = int(counts[int(np.argmax(index))])
    starts = np.zeros(n, dtype=np.bool_)
    starts[ends[n - best :]] = True
    return np.asarray((np.cumsum(starts) - 1) % best)


def _merges(features: FloatArray) -> tuple[IntArray, FloatArray]:
    """The order in which arcs of a ring are merged, as the place at which the later of both began (N,), the
    last of which is left when one arc is, and by how much each merge spreads its arc (N - 1,)."""
    n = len(features)
    total = [row.copy() for row in features]
    count, alive, version = [1] * n, [True] * n, [0] * n
    after, before = [(k + 1) % n for k in range(n)], [(k - 1) % n for k in range(n)]

    def cost(a: int, b: int) -> float:
        apart = total[a] / count[a] - total[b] / count[b]
        return float(count[a] * count[b] / (count[a] + count[b]) * (apart @ apart))

    waiting = [(cost(k, after[k]), k, after[k], 0, 0) for k in range(n)]
    heapq.heapify(waiting)
    order: list[int] = []
    gained: list[float] = []
    while len(order) < n - 1:
        value, a, b, old_a, old_b = heapq.heappop(waiting)
        if not (alive[a] and alive[b]) or (version[a], version[b]) != (old_a, old_b):
            continue
        order.append(b)
        gained.append(value)
        total[a] = total[a] + total[b]
        count[a] += count[b]
        alive[b] = False
        version[a] += 1
        after[a] = after[b]
        before[after[b]] = a
        if len(order) < n - 1:
            for one, two in ((before[a], a), (a, after[a])):
                heapq.heappush(waiting, (cost(one, two), one, two, version[one], version[two]))
    order.append(alive.index(True))
    return np.array(order, dtype=np.int64), np.array(gained)
