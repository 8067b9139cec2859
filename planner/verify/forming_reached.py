"""What of a face is there already while it is being formed: all of it down to the lowest place that the
forming ball has touched. Below, the sheet still hangs from the ball, nearer to the forming tool than the face
will be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.geometry.closest import closest_on_triangles
from planner.verify.forming_face import Face, apart
from planner.verify.forming_state import Formed

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CHUNK = 10_000


def levels(one: Formed) -> FloatArray:
    """The height (K + 1,) [m] toward the forming tool down to which a face is formed at the knots of a pass:
    that of the start before the ball touches it. Of places that it touches at once the lowest counts."""
    claim, near = one.claim, one.near
    own = one.track.own[one.knots]
    low = np.full(len(one.knots), np.inf)
    np.minimum.at(low, near.row, claim.side * near.tied[:, 2])
    start = claim.side * claim.start
    return np.minimum(np.minimum.accumulate(np.where(own & one.touches, low, np.inf)), start)


def least(
    face: Face, start: FloatArray, end: FloatArray, need: FloatArray, side: int, level: FloatArray
) -> FloatArray:
    """How near (K,) [m] straight ways from ``start`` to ``end`` (K, 3), ends included, come to what of a face
    is at ``level`` (K,) [m] or higher toward ``side``; infinite where it is ``need`` (K,) or more."""
    out = np.full(len(start), np.inf)
    for rows in np.array_split(np.arange(len(start)), max(1, len(start) // _CHUNK)):
        if not len(rows):
            continue
        which, triangle = face.near_ways(start[rows], end[rows], need[rows])
        which = rows[which]
        kept, corners = _above(face.corners[triangle], side, level[which])
        which = which[kept]
        np.minimum.at(out, which, _to_triangles(start[which], end[which], corners))
    return np.where(out < need, out, np.inf)


def _to_triangles(start: FloatArray, end: FloatArray, corners: FloatArray) -> FloatArray:
    """Distances (M,) [m] of straight ways (M, 3) from triangles (M, 3, 3), their ends included."""
    found = apart(start, end, corners)
    for point in (start, end):
        weights = closest_on_triangles(point, *np.moveaxis(corners, 1, 0))
        foot = np.einsum("nk,nkd->nd", weights, corners)
        found = np.minimum(found, np.linalg.norm(point - foot, axis=1))
    return found


def _above(corners: FloatArray, side: int, level: FloatArray) -> tuple[IntArray, FloatArray]:
    """What of triangles (M, 3, 3) is at ``level`` (M,) or higher toward ``side``, as triangles (L, 3, 3), and
    the rows (L,) that they come from."""
    height = side * corners[:, :, 2] - level[:, None]
    order = np.argsort(-height, axis=1, kind="stable")
    height = np.take_along_axis(height, order, axis=1)
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    many = (height >= 0.0).sum(axis=1)

    def crossing(rows: IntArray, high: int, low: int) -> FloatArray:
        share = height[rows, high] / (height[rows, high] - height[rows, low])
        way = corners[rows, low] - corners[rows, high]
        return np.asarray(corners[rows, high] + share[:, None] * way)

    whole, two, one = (np.flatnonzero(many == count) for count in (3, 2, 1))
    first, second = crossing(two, 0, 2), crossing(two, 1, 2)
    parts = [
        corners[whole],
        np.stack([corners[two, 0], corners[two, 1], second], axis=1),
        np.stack([corners[two, 0], second, first], axis=1),
        np.stack([corners[one, 0], crossing(one, 0, 1), crossing(one, 0, 2)], axis=1),
    ]
    return np.concatenate([whole, two, two, one]), np.concatenate(parts)
