"""Cheap bounds of least distances, which settle most configurations before Drake is asked.

Every moving solid has a capsule around it and one inside it, with the same axis. The distance of the outer
capsules is a lower bound of the true one, that of the inner capsules an upper bound. Fixed boxes (stock,
table, bases) stay boxes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.cell.distance import Solid, extent
from planner.geometry.rigid import from_parts

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

SAMPLES: Final = 5
"""Points on a capsule's axis whose distances to a box bound that of the whole axis."""


@dataclasses.dataclass(frozen=True, eq=False)
class Bounds:
    """Solids as capsules and as blunt cylinders about the same axis.

    Capsules: centre (S, 3), unit axis (S, 3) in their body; half lengths and radii (S,), outer and inner.
    ``round`` (S, 3) are a half length, the radius of flat ends and that of a rounding around all, which
    hold the solid too.

    ``boxes`` (K,) are boxes of fixed bodies, of half size (K, 3), or stand for meshes within them where not
    ``exact``. ``pairs`` (M, 2) are pairs of capsules,
    ``box_pairs`` (N, 2) of a capsule and a box, that are held apart.
    """

    solids: tuple[Solid, ...]
    centre: FloatArray
    axis: FloatArray
    outer: tuple[FloatArray, FloatArray]
    inner: tuple[FloatArray, FloatArray]
    round: FloatArray
    boxes: tuple[Solid, ...]
    half: FloatArray
    exact: NDArray[np.bool_]
    pairs: IntArray
    box_pairs: IntArray

    def among(self, ignore: frozenset[frozenset[str]]) -> Bounds:
        """The same without the pairs of bodies in ``ignore``."""
        if not ignore:
            return self
        first = [[frozenset((self.solids[a].body, self.solids[b].body)) not in ignore] for a, b in self.pairs]
        second = [
            [frozenset((self.solids[a].body, self.boxes[b].body)) not in ignore] for a, b in self.box_pairs
        ]
        keep = np.array(first, dtype=bool).reshape(-1), np.array(second, dtype=bool).reshape(-1)
        return dataclasses.replace(self, pairs=self.pairs[keep[0]], box_pairs=self.box_pairs[keep[1]])

    def least(self, poses: Mapping[str, FloatArray], limit: float) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (B,) [m] of the least distance, for body poses (B | 1, 4, 4).

        Where bodies overlap the bounds only have the true sign, and no meaning as depths. Distances above
        ``limit`` are not worked out: both bounds are then infinite or above it.
        """
        rows = max(len(pose) for pose in poses.values())
        centre = np.empty((rows, len(self.solids), 3))
        axis = np.empty((rows, len(self.solids), 3))
        for k, solid in enumerate(self.solids):
            pose = poses[solid.body]
            centre[:, k] = pose[:, :3, :3] @ self.centre[k] + pose[:, :3, 3]
            axis[:, k] = pose[:, :3, :3] @ self.axis[k]
        lower, upper = np.full(rows, np.inf), np.full(rows, np.inf)
        self._capsules(centre, axis, limit, lower, upper)
        self._boxes(centre, axis, poses, limit, lower, upper)
        return lower, upper

    def _capsules(
        self, centre: FloatArray, axis: FloatArray, limit: float, lower: FloatArray, upper: FloatArray
    ) -> None:
        reach = self.outer[0] + self.outer[1]
        count = len(reach)
        near = np.full((count, count), -np.inf)
        first, second = self.pairs[:, 0], self.pairs[:, 1]
        near[first, second] = (reach[first] + reach[second] + limit) ** 2
        square = np.einsum("rsc,rsc->rs", centre, centre)
        apart = square[:, :, None] + square[:, None, :] - 2.0 * (centre @ np.swapaxes(centre, 1, 2))
        row, code = np.divmod(np.flatnonzero(apart < near), count * count)
        a, b = np.divmod(code, count)
        w, da, db = centre[row, a] - centre[row, b], axis[row, a], axis[row, b]
        cosine, ca, cb = _dot(da, db), _dot(da, w), _dot(db, w)
        dots = (cosine, ca, cb)
        for (length, radius), out in ((self.outer, lower), (self.inner, upper)):
            gap = _segments(w, da, db, dots, length[a], length[b]) - radius[a] - radius[b]
            if out is lower:
                k = np.flatnonzero(gap < limit)
                shadow = _separation(w[k], da[k], db[k], self.round[a[k]], self.round[b[k]])
                gap[k] = np.maximum(gap[k], shadow)
            np.minimum.at(out, row, gap)

    def _boxes(
        self,
        centre: FloatArray,
        axis: FloatArray,
        poses: Mapping[str, FloatArray],
        limit: float,
        lower: FloatArray,
        upper: FloatArray,
    ) -> None:
        reach = self.outer[0] + self.outer[1]
        for k, box in enumerate(self.boxes):
            a = self.box_pairs[self.box_pairs[:, 1] == k, 0]
            pose = poses[box.body][0] @ box.shape.pose
            local = (centre[:, a] - pose[:3, 3]) @ pose[:3, :3]
            row, which = np.nonzero(_box(local, self.half[k]) < reach[a] + limit)
            place, along = local[row, which], axis[row, a[which]] @ pose[:3, :3]
            length, radius = self.outer[0][a[which]], self.outer[1][a[which]]
            value = self._on_axis(place, along, length, k)
            step = 2.0 * length / (SAMPLES - 1)
            low = 0.5 * (value[:, 1:] + value[:, :-1] - step[:, None])
            np.minimum.at(lower, row, np.minimum(low.min(axis=1), value.min(axis=1)) - radius)
            if not self.exact[k]:
                continue
            length, radius = self.inner[0][a[which]], self.inner[1][a[which]]
            np.minimum.at(upper, row, self._on_axis(place, along, length, k).min(axis=1) - radius)

    def _on_axis(self, place: FloatArray, along: FloatArray, length: FloatArray, k: int) -> FloatArray:
        t = np.linspace(-1.0, 1.0, SAMPLES)
        points = place[:, None] + (length[:, None] * t)[..., None] * along[:, None]
        return _box(points, self.half[k])


def prepare(solids: Sequence[Solid], filtered: Sequence[tuple[str, str, str]]) -> Bounds:
    """The bounds of a cell's solids; ``filtered`` are pairs of bodies that are not held apart."""
    skip = {frozenset(pair[:2]) for pair in filtered}
    boxed = [_is_fixed(s.body) and s.shape.kind in ("box", "mesh") for s in solids]
    boxes = [s for s, fixed in zip(solids, boxed, strict=True) if fixed]
    rows = [_capsule(s) for s, fixed in zip(solids, boxed, strict=True) if not fixed]
    capsules = tuple(_as_box(s) for s, fixed in zip(solids, boxed, strict=True) if not fixed)
    pairs = [
        (a, b)
        for a, one in enumerate(capsules)
        for b, other in enumerate(capsules[a + 1 :], start=a + 1)
        if one.body != other.body and frozenset((one.body, other.body)) not in skip
    ]
    box_pairs = [
        (a, b)
        for a, one in enumerate(capsules)
        for b, other in enumerate(boxes)
        if one.body != other.body and frozenset((one.body, other.body)) not in skip
    ]
    ready = [_as_box(s) for s in boxes]
    return Bounds(
        solids=capsules,
        centre=np.array([s.shape.pose[:3, 3] for s in capsules]),
        axis=np.array([s.shape.pose[:3, :3] @ row[0] for s, row in zip(capsules, rows, strict=True)]),
        outer=(np.array([r[1] for r in rows]), np.array([r[2] for r in rows])),
        inner=(np.array([r[3] for r in rows]), np.array([r[4] for r in rows])),
        round=np.array([_blunt(s) for s in capsules]),
        boxes=tuple(ready),
        exact=np.array([s.shape.kind == "box" for s in boxes], dtype=bool),
        half=np.array([0.5 * np.asarray(s.shape.size) for s in ready]).reshape(-1, 3),
        pairs=np.array(pairs, dtype=np.intp).reshape(-1, 2),
        box_pairs=np.array(box_pairs, dtype=np.intp).reshape(-1, 2),
    )


def _is_fixed(body: str) -> bool:
    return "/" not in body or body.endswith("/base_link")


def _as_box(solid: Solid) -> Solid:
    """A mesh as the box around it, in the axes of its own frame; other solids as they are."""
    if solid.shape.vertices is None:
        return solid
    low, high = solid.shape.vertices.min(axis=0), solid.shape.vertices.max(axis=0)
    pose = solid.shape.pose @ from_parts(np.eye(3), 0.5 * (low + high))
    size = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    return Solid(
        solid.body, dataclasses.replace(solid.shape, kind="box", size=size, pose=pose, vertices=None)
    )


def _capsule(solid: Solid) -> tuple[FloatArray, float, float, float, float]:
    """Axis (3,) in the shape's frame; half length and radius of the capsule around a solid, then of the one
    inside.

    The inner radius is -inf for a mesh, whose inside is not known.
    """
    kind = solid.shape.kind
    if kind in ("sphere", "capsule"):
        half = 0.5 * solid.shape.size[1] if kind == "capsule" else 0.0
        return np.array([0.0, 0.0, 1.0]), half, solid.shape.size[0], half, solid.shape.size[0]
    if kind == "cylinder":
        radius, half = solid.shape.size[0], 0.5 * solid.shape.size[1]
        axis, thin = np.array([0.0, 0.0, 1.0]), min(radius, half)
    else:
        size = 0.5 * extent(_as_box(solid))
        order = np.argsort(size)
        axis = np.eye(3)[order[2]]
        half, radius = float(size[order[2]]), float(np.hypot(size[order[0]], size[order[1]]))
        thin = float(size[order[0]]) if kind == "box" else -np.inf
    around = max(0.0, half - 0.4 * radius)
    return axis, around, float(np.hypot(radius, half - around)), max(0.0, half - max(thin, 0.0)), thin


def _blunt(solid: Solid) -> tuple[float, float, float]:
    """Half length, flat radius and rounding of the cylinder or capsule around a solid, about the axis of
    _capsule."""
    size = solid.shape.size
    if solid.shape.kind == "sphere":
        return 0.0, 0.0, size[0]
    if solid.shape.kind == "capsule":
        return 0.5 * size[1], 0.0, size[0]
    if solid.shape.kind == "cylinder":
        return 0.5 * size[1], size[0], 0.0
    half = np.sort(0.5 * extent(solid))
    return float(half[2]), float(np.hypot(half[0], half[1])), 0.0


def _separation(
    w: FloatArray, da: FloatArray, db: FloatArray, one: FloatArray, two: FloatArray
) -> FloatArray:
    """Lower bounds (M,) of distances: the gap between the shadows of two blunt cylinders on the best of
    four lines."""
    best = np.full(len(w), -np.inf)
    turned = np.cross(da, np.cross(da, w))
    for line in (da, db, w, turned):
        norm = np.sqrt(_dot(line, line))
        n = line / np.where(norm > 1e-12, norm, 1.0)[:, None]
        gap = np.abs(_dot(n, w))
        for axis, (length, radius, rounding) in ((da, one.T), (db, two.T)):
            c = np.abs(_dot(n, axis))
            gap -= length * c + radius * np.sqrt(np.maximum(1.0 - c * c, 0.0)) + rounding
        best = np.where(norm > 1e-12, np.maximum(best, gap), best)
    return best


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("mc,mc->m", a, b))


def _segments(
    w: FloatArray,
    da: FloatArray,
    db: FloatArray,
    dots: tuple[FloatArray, FloatArray, FloatArray],
    ha: FloatArray,
    hb: FloatArray,
) -> FloatArray:
    """Distances (M,) of segments by centre difference w, unit axes and half lengths (Ericson 2005, section
    5.1.9)."""
    cosine, ca, cb = dots
    sine2 = 1.0 - cosine * cosine
    level = sine2 < 1e-9
    s = np.where(level, 0.0, (cosine * cb - ca) / np.where(level, 1.0, sine2))
    s = np.clip(s, -ha, ha)
    t = np.clip(cosine * s + cb, -hb, hb)
    s = np.clip(cosine * t - ca, -ha, ha)
    gap = w + s[:, None] * da - t[:, None] * db
    return np.asarray(np.sqrt(_dot(gap, gap)))


def _box(points: FloatArray, half: FloatArray) -> FloatArray:
    """Signed distances (...,) of points (..., 3) to a box about the origin."""
    x, y, z = (np.abs(points[..., i]) - half[i] for i in range(3))
    inside = np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
    x, y, z = np.maximum(x, 0.0), np.maximum(y, 0.0), np.maximum(z, 0.0)
    return np.asarray(np.sqrt(x * x + y * y + z * z) + inside)
