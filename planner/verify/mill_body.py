"""A milling tool as solids of revolution, as the proof sees it: how far points are off it along a track."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.tool_heads import Cutter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGHT = 3e-3
"""Points farther off than this [m] are not told apart."""
_FINEST = 0.25e-3
_MOST = 3_000_000
_CHUNK = 4_000


@dataclasses.dataclass(frozen=True)
class Solid:
    """One piece of a tool: the profile of its half section, ``back`` and ``beside`` (K,) [m] from the tip and
    from the axis, closed along the axis; ``name`` as a person calls it."""

    name: str
    back: FloatArray
    beside: FloatArray

    @property
    def widest(self) -> float:
        """Largest radius [m]."""
        return float(self.beside.max())


def solids(cutter: Cutter, corners: int = 33) -> tuple[Solid, ...]:
    """Cutting part, shank, and the pieces of holder and spindle. Round corners are polygons around them of so
    many places, so that a solid is never smaller than the tool, by 3e-4 of the corner at most."""
    turn = np.linspace(0.0, 0.5 * np.pi, corners)
    half = 0.5 * (turn[1] - turn[0])
    middle = turn[:-1] + half
    big = cutter.corner / np.cos(half)
    flat = cutter.radius - cutter.corner
    end = np.concatenate([[0.0], cutter.corner - big * np.cos(middle), [cutter.corner]])
    aside = np.concatenate([[flat], flat + big * np.sin(middle), [cutter.radius]])
    if cutter.corner == 0.0:
        end, aside = np.zeros(1), np.array([cutter.radius])
    out = [Solid("cutter", np.append(end, cutter.flute), np.append(aside, cutter.radius))]
    if cutter.overhang > cutter.flute:
        out.append(_cylinder("shank", cutter.flute, cutter.overhang, cutter.shank))
    count = len(cutter.behind) // 2
    for k in range(count):
        a, b = cutter.behind[2 * k], cutter.behind[2 * k + 1]
        out.append(
            _cylinder("spindle" if k == count - 1 else "holder", float(a[0]), float(b[0]), float(a[1]))
        )
    return tuple(out)


def _cylinder(name: str, start: float, end: float, radius: float) -> Solid:
    return Solid(name, np.array([start, end]), np.array([radius, radius]))


def signed(solid: Solid, back: FloatArray, beside: FloatArray) -> FloatArray:
    """Distance [m] of points from a solid, below zero inside, in the shape of ``back`` and ``beside``:
    the distance to the polygon of its half section, which is convex."""
    b = np.concatenate([[solid.back[0]], solid.back, [solid.back[-1]]])
    r = np.concatenate([[0.0], solid.beside, [0.0]])
    least = np.full(back.shape, np.inf)
    inside = np.ones(back.shape, dtype=bool)
    for k in range(len(b) - 1):
        way = np.array([b[k + 1] - b[k], r[k + 1] - r[k]])
        square = float(way @ way)
        if square < 1e-24:
            continue
        x, y = back - b[k], beside - r[k]
        share = np.clip((x * way[0] + y * way[1]) / square, 0.0, 1.0)
        inside &= x * way[1] - y * way[0] >= 0.0  # the inside is on the right, seen from the front back
        x -= share * way[0]
        y -= share * way[1]
        np.minimum(least, x * x + y * y, out=least)
    out = np.sqrt(least)
    return np.asarray(np.where(inside, -out, out))


def comes_near(vertices: FloatArray, tip: FloatArray, axis: FloatArray, solid: Solid) -> bool:
    """Whether a solid at places (M, 3) of a track may come within ``SIGHT`` of a face with ``vertices``
    (V, 3), by the boxes around both."""
    ends = np.concatenate([tip + solid.back[0] * axis, tip + solid.back[-1] * axis])
    room = solid.widest + SIGHT
    apart = (ends.min(axis=0) - room > vertices.max(axis=0)) | (
        ends.max(axis=0) + room < vertices.min(axis=0)
    )
    return not bool(apart.any())


def sweep(
    points: FloatArray, tip: FloatArray, axis: FloatArray, solid: Solid, near: int = 8
) -> tuple[FloatArray, IntArray]:
    """Least distance (P,) [m] of points (P, 3) from a solid at any of the places (M, 3) of a track, below
    zero inside, and the index (P,) of that place; at most ``SIGHT`` is told."""
    best, where = np.full(len(points), SIGHT), np.zeros(len(points), dtype=np.int64)
    # places of one level along the axis are told apart by their distance from the point, whatever the level
    step = max(solid.widest, _FINEST)
    levels = max(int(np.ceil((solid.back[-1] - solid.back[0]) / step)), 1)
    levels = max(1, min(levels, _MOST // max(len(tip), 1)))
    depth = solid.back[0] + (np.arange(levels) + 0.5) / levels * (solid.back[-1] - solid.back[0])
    centre = (tip[:, None] + depth[None, :, None] * axis[:, None]).reshape(-1, 3)
    if not len(centre):
        return best, where
    half = 0.5 * float(solid.back[-1] - solid.back[0]) / levels
    reach = float(np.hypot(solid.widest, half)) + SIGHT
    box = ((points > centre.min(axis=0) - reach) & (points < centre.max(axis=0) + reach)).all(axis=1)
    rows = np.flatnonzero(box)
    if not len(rows):
        return best, where
    # neighbours one after the other find their places in what is at hand
    rows = rows[np.lexsort(np.floor(points[rows] / solid.widest).T)]
    tree = cKDTree(centre, leafsize=16)
    for part in np.array_split(rows, max(1, len(rows) // _CHUNK)):
        index = tree.query(points[part], k=min(near, len(centre)), distance_upper_bound=reach)[1]
        index = index.reshape(len(part), -1)
        found = index < len(centre)  # the index behind the last stands for nothing within reach
        seen = found[:, 0]
        part, index, found = part[seen], index[seen], found[seen]
        if not len(part):
            continue
        place = np.minimum(index, len(centre) - 1) // levels
        back, square = np.zeros(place.shape), np.zeros(place.shape)
        for d in range(3):
            rest = points[part, d, None] - tip[:, d][place]
            back += rest * axis[:, d][place]
            square += rest * rest
        beside = np.sqrt(np.maximum(square - back * back, 0.0))
        beside[~found] = np.inf
        # nothing is nearer to a solid than to a cylinder as wide as it without ends
        here = beside - solid.widest
        here[:, 0] = signed(solid, back[:, 0], beside[:, 0])
        open_ = np.nonzero(here < np.minimum(here[:, :1], SIGHT))
        here[open_] = signed(solid, back[open_], beside[open_])
        column = here.argmin(axis=1)
        row = np.arange(len(part))
        least, place = here[row, column], place[row, column]
        better = least < SIGHT
        best[part[better]], where[part[better]] = least[better], place[better]
    return best, where
