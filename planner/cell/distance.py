"""Distances of convex solids in batches: closed forms where there are some, else GJK with a certificate.

A solid is a core, moved out by a rounding: a sphere's core is its centre, a capsule's its axis; boxes,
cylinders and convex meshes are their own. Two segments have Ericson's closed form (Real-Time Collision
Detection, 2005, section 5.1.9). Of a segment and a box the squared distance is quadratic between the places
where the segment crosses a face's plane, so that its slope, which is linear there, gives the least one
exactly. All others go through the algorithm of Gilbert, Johnson and Keerthi (IEEE J. Robotics and Automation,
1988) on the difference of the cores: with v its point nearest to the origin so far, and w the support against
v, v.w / |v| is a lower bound of the distance by convexity, |v| an upper one. The lower one is returned, once
both agree.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.cell.bodies import Solid
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, dots, lengths

AGREED_M: Final = 1e-7
"""Bounds of a distance agree within this [m]."""
MOST_STEPS: Final = 200
"""Steps of GJK at most; a pair that has not converged keeps its lower bound."""
TOUCHING_M: Final = 1e-9
"""Cores nearer than this [m] overlap."""
_EDGES: Final = np.array(list(itertools.combinations(range(4), 2)))
_TRIANGLES: Final = np.array(list(itertools.combinations(range(4), 3)))


@dataclasses.dataclass(frozen=True, eq=False)
class Cores:
    """Cores of S solids in their shapes' frames: half sizes ``half`` (S, 3), the radius of a disc across z
    ``disc`` (S,), corners ``mesh`` (S, V, 3) of those that are ``meshed`` (S,), and the ``rounding`` (S,)
    [m]. ``segment`` and ``box`` (S,) say which cores have closed forms."""

    half: FloatArray
    disc: FloatArray
    rounding: FloatArray
    mesh: FloatArray
    meshed: BoolArray
    segment: BoolArray
    box: BoolArray

    def support(self, which: IndexArray, direction: FloatArray) -> FloatArray:
        """The farthest points (M, 3) of cores ``which`` (M,) along directions (M, 3), in their frames."""
        out = np.where(direction < 0.0, -1.0, 1.0) * self.half[which]
        flat = direction[:, :2]
        length = np.sqrt(flat[:, 0] ** 2 + flat[:, 1] ** 2)
        out[:, :2] += (self.disc[which] / np.maximum(length, 1e-300))[:, None] * flat
        meshed = np.flatnonzero(self.meshed[which])
        if len(meshed):
            corners = self.mesh[which[meshed]]
            best = np.einsum("mvc,mc->mv", corners, direction[meshed]).argmax(axis=1)
            out[meshed] = corners[np.arange(len(meshed)), best]
        return out


def cores(solids: Sequence[Solid]) -> Cores:
    """The cores of solids."""
    count = len(solids)
    half, disc, rounding = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    kind = [solid.shape.kind for solid in solids]
    most = max((len(s.shape.vertices) for s in solids if s.shape.vertices is not None), default=1)
    mesh = np.zeros((count, most, 3)) if "mesh" in kind else np.zeros((count, 0, 3))
    for k, solid in enumerate(solids):
        size, corners = solid.shape.size, solid.shape.vertices
        if corners is not None:
            mesh[k] = np.concatenate([corners, np.repeat(corners[:1], most - len(corners), axis=0)])
        elif kind[k] == "box":
            half[k] = 0.5 * np.asarray(size)
        else:
            half[k, 2] = 0.5 * size[1] if len(size) > 1 else 0.0
            (disc if kind[k] == "cylinder" else rounding)[k] = size[0]
    meshed = np.array([one == "mesh" for one in kind], dtype=np.bool_)
    segment = np.array([one in ("sphere", "capsule") for one in kind], dtype=np.bool_)
    box = np.array([one == "box" for one in kind], dtype=np.bool_)
    return Cores(half, disc, rounding, mesh, meshed, segment, box)


def distances(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    one: FloatArray,
    other: FloatArray,
    settled: float | FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances (M,) [m] of solids ``first`` and ``second`` (M,) at poses (M, 4, 4), unit vectors (M, 3) from
    the second to the first along which they are, and points (M, 3) on these lines.

    At most :data:`AGREED_M` below the truth and never above it; where roundings overlap it is the depth below
    zero, and where cores do, a bound of it, with no direction. Where one is only to be held against
    ``settled`` [m], of all or of each (M,), a lower bound above that, or any number below it, will do.
    """
    enough = None if settled is None else np.broadcast_to(np.asarray(settled), first.shape)
    gap, way, place = np.empty(len(first)), np.zeros((len(first), 3)), np.zeros((len(first), 3))
    segments = cores.segment[first] & cores.segment[second]
    boxed = cores.box[first] & cores.segment[second] | cores.segment[first] & cores.box[second]
    for chosen, kernel in ((segments, _segments), (boxed, _segment_box), (~(segments | boxed), _gjk)):
        at = np.flatnonzero(chosen)
        if len(at):
            own = None if enough is None else enough[at]
            gap[at], way[at], place[at] = kernel(cores, first[at], second[at], one[at], other[at], own)
    return gap - cores.rounding[first] - cores.rounding[second], way, place


_Found = tuple[FloatArray, FloatArray, FloatArray]


def _segments(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    one: FloatArray,
    other: FloatArray,
    settled: FloatArray | None,
) -> _Found:
    del settled  # closed forms need no search
    along = one[:, :3, 2]
    half = cores.half[first, 2], cores.half[second, 2]
    ray, s = between_segments(one[:, :3, 3] - other[:, :3, 3], along, other[:, :3, 2], *half)
    gap, way = _with_way(ray)
    return gap, way, one[:, :3, 3] + s[:, None] * along


def between_segments(
    w: FloatArray, along: FloatArray, across: FloatArray, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Shortest ways (M, 3) from second to first segments, and their places (M,) on the first from its middle.

    ``w`` (M, 3) leads from middle to middle, ``along`` and ``across`` (M, 3) are the unit axes of the first
    and the second, ``a`` and ``b`` (M,) their half lengths.
    """
    cosine, ca, cb = dots(along, across), dots(along, w), dots(across, w)
    sine2 = 1.0 - cosine * cosine
    level = sine2 < 1e-12
    inner = np.clip(np.where(level, -ca, (cosine * cb - ca) / np.where(level, 1.0, sine2)), -a, a)
    # where segments are nearly level the formula cancels out: ends, then, are as near as anything
    s = np.stack([inner, a, -a, np.clip(cosine * b - ca, -a, a), np.clip(-cosine * b - ca, -a, a)])
    t = np.clip(cosine * s + cb, -b, b)
    s = np.clip(cosine * t - ca, -a, a)
    square = s * s + t * t - 2.0 * cosine * s * t + 2.0 * ca * s - 2.0 * cb * t
    best = square.argmin(axis=0)
    s, t = s[best, np.arange(len(best))], t[best, np.arange(len(best))]
    return np.asarray(w + s[:, None] * along - t[:, None] * across), s


def _segment_box(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    one: FloatArray,
    other: FloatArray,
    settled: FloatArray | None,
) -> _Found:
    del settled  # closed forms need no search
    swap = cores.box[first]
    segment, box = np.where(swap, second, first), np.where(swap, first, second)
    line, frame = (np.where(swap[:, None, None], x, y) for x, y in ((other, one), (one, other)))
    turn = frame[:, :3, :3]
    start = np.einsum("mc,mcd->md", line[:, :3, 3] - frame[:, :3, 3], turn)
    along = np.einsum("mc,mcd->md", line[:, :3, 2], turn)
    half = cores.half[box]
    best = nearest_to_box(start, along, cores.half[segment, 2], half)
    place = start + best[:, None] * along
    ray = np.sign(place) * np.maximum(np.abs(place) - half, 0.0)
    gap, way = _with_way(np.einsum("md,mcd->mc", ray, turn))
    world = line[:, :3, 3] + best[:, None] * line[:, :3, 2]
    return gap, np.where(swap[:, None], -way, way), world


def nearest_to_box(start: FloatArray, along: FloatArray, reach: FloatArray, half: FloatArray) -> FloatArray:
    """Places (M,) on segments, from their middles ``start`` (M, 3) along unit axes ``along`` (M, 3) as far as
    ``reach`` (M,) either way, that are nearest to boxes about the origin of half sizes (M, 3)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate([(half - start) / along, (-half - start) / along], axis=1)
    crossings = np.where(np.isfinite(crossings), crossings, 0.0)
    t = np.clip(
        np.concatenate([crossings, reach[:, None], -reach[:, None]], axis=1), -reach[:, None], reach[:, None]
    )
    t.sort(axis=1)
    places = start[:, None] + t[..., None] * along[:, None]
    beyond = np.sign(places) * np.maximum(np.abs(places) - half[:, None], 0.0)
    slope = np.einsum("mkc,mc->mk", beyond, along)
    right = np.clip((slope < 0.0).sum(axis=1), 1, t.shape[1] - 1)  # slopes ascend, as distance is convex
    rows = np.arange(len(t))
    low, high = slope[rows, right - 1], slope[rows, right]
    share = np.where(high > low, np.clip(-low / np.where(high > low, high - low, 1.0), 0.0, 1.0), 0.0)
    return np.asarray(t[rows, right - 1] + share * (t[rows, right] - t[rows, right - 1]))


def _with_way(ray: FloatArray) -> tuple[FloatArray, FloatArray]:
    gap = lengths(ray)
    return gap, ray / np.where(gap > TOUCHING_M, gap, np.inf)[:, None]


def _gjk(
    cores: Cores,
    first: IndexArray,
    second: IndexArray,
    one: FloatArray,
    other: FloatArray,
    settled: FloatArray | None,
) -> _Found:
    """Lower bounds of the distance of cores, ways, places; 0 where they overlap."""
    count = len(first)
    gap, way, place = np.zeros(count), np.zeros((count, 3)), one[:, :3, 3].copy()
    live = np.arange(count)
    enough = (0.0 if settled is None else settled) + cores.rounding[first] + cores.rounding[second]
    nearest = one[:, :3, 3] - other[:, :3, 3]
    nearest[lengths(nearest) < TOUCHING_M] = [1.0, 0.0, 0.0]
    corner, own = np.zeros((count, 4, 3)), np.zeros((count, 4, 3))
    used = np.zeros((count, 4), dtype=np.bool_)
    for _ in range(MOST_STEPS):
        v = nearest[live]
        norm = lengths(v)
        far = _support(cores, first[live], one[live], -v)
        support = far - _support(cores, second[live], other[live], v)
        low = dots(v, support) / norm
        better = low > gap[live]
        gap[live[better]], way[live[better]] = low[better], v[better] / norm[better, None]
        started = used[live].any(axis=1)
        going = ~(started & (norm - gap[live] < AGREED_M))
        if settled is not None:
            going &= ~(started & (norm <= enough[live])) & (gap[live] <= enough[live])
        live, support, far = live[going], support[going], far[going]
        if not len(live):
            break
        free = used[live].argmin(axis=1)
        corner[live, free], own[live, free] = support, far
        used[live, free] = True
        found, share, inside = _nearest(corner[live], used[live])
        nearest[live], used[live] = found, share > 0.0
        place[live] = np.einsum("mk,mkc->mc", share, own[live])
        gap[live[inside]] = 0.0
        way[live[inside]] = 0.0
        live = live[~inside & (lengths(found) > TOUCHING_M)]
    return gap, way, place


def _support(cores: Cores, which: IndexArray, pose: FloatArray, direction: FloatArray) -> FloatArray:
    local = np.einsum("mc,mcd->md", direction, pose[:, :3, :3])
    return np.asarray(np.einsum("mcd,md->mc", pose[:, :3, :3], cores.support(which, local)) + pose[:, :3, 3])


def _nearest(corner: FloatArray, used: BoolArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Of simplices (M, 4, 3) whose corners ``used`` (M, 4) count: the point nearest to the origin (M, 3), the
    shares of the corners in it (M, 4), above 0 for those that it lies between, and whether the origin is
    inside (M,)."""
    count = len(corner)
    share = np.zeros((count, 4))
    most = int(used.sum(axis=1).max(initial=0))
    if most < 2:  # as all are in the first step
        which = used.argmax(axis=1)
        share[np.arange(count), which] = 1.0
        return corner[np.arange(count), which], share, np.zeros(count, dtype=np.bool_)
    a, b = corner[:, _EDGES[:, 0]], corner[:, _EDGES[:, 1]]
    edge = b - a
    square = np.einsum("mkc,mkc->mk", edge, edge)
    t = -np.einsum("mkc,mkc->mk", a, edge) / np.where(square > 0.0, square, 1.0)
    edge_good = used[:, _EDGES].all(axis=2) & (t > 0.0) & (t < 1.0) & (square > 0.0)
    on_edge = a + t[..., None] * edge
    if most < 3:  # in the second step
        points, good = np.concatenate([corner, on_edge], axis=1), np.concatenate([used, edge_good], axis=1)
        best = np.where(good, np.einsum("mkc,mkc->mk", points, points), np.inf).argmin(axis=1)
        _share_edges(share, best, t)
        return points[np.arange(count), best], share, np.zeros(count, dtype=np.bool_)

    x, y, z = (corner[:, _TRIANGLES[:, k]] for k in range(3))
    opposite = _cross(np.stack([y, z, x]), np.stack([z, x, y]))
    normal = opposite.sum(axis=0)
    area = np.einsum("mkc,mkc->mk", normal, normal)
    safe = np.where(area > 0.0, area, 1.0)
    across = np.einsum("nmkc,mkc->nmk", opposite, normal) / safe
    on_face = normal * (np.einsum("mkc,mkc->mk", x, normal) / safe)[..., None]
    face_good = used[:, _TRIANGLES].all(axis=2) & (across > 0.0).all(axis=0) & (area > 1e-30)

    points = np.concatenate([corner, on_edge, on_face], axis=1)
    good = np.concatenate([used, edge_good, face_good], axis=1)
    best = np.where(good, np.einsum("mkc,mkc->mk", points, points), np.inf).argmin(axis=1)
    _share_edges(share, best, t)
    rows = np.flatnonzero(best >= 10)
    which = best[rows] - 10
    share[rows[:, None], _TRIANGLES[which]] = across[:, rows, which].T
    volumes = np.einsum("mkc,mkc->mk", opposite[2], z) * np.array([1.0, -1.0, 1.0, -1.0])
    inside = used.all(axis=1) & ((volumes > 0.0).all(axis=1) | (volumes < 0.0).all(axis=1))
    return points[np.arange(count), best], share, inside


def _share_edges(share: FloatArray, best: IndexArray, t: FloatArray) -> None:
    """Writes the shares of corners where these or edges, at ``t`` (M, 6) of them, are ``best`` (M,)."""
    rows = np.flatnonzero(best < 4)
    share[rows, best[rows]] = 1.0
    rows = np.flatnonzero((best >= 4) & (best < 10))
    which = best[rows] - 4
    share[rows[:, None], _EDGES[which]] = np.stack([1.0 - t[rows, which], t[rows, which]], axis=1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (..., 3); NumPy's own takes several times as long for small arrays."""
    out = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out
