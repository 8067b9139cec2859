"""A milling tool as a body of revolution: how far points are off it, and how deep the part stands in it along
a path."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.tool_heads import Cutter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NEAR: Final = 6
"""Places of the path that each point of the part is held against: the nearest ones along the tool's axis."""
DENSE: Final = 0.15
"""Distance of places along the path, over the radius of the section; along the
axis they are a radius apart."""
LEAST: Final = 0.5e-3
"""The same at least [m]."""
MOST: Final = 2_000_000
SIGHT: Final = 2e-3
"""Points that are farther off than this [m] are as good as any other."""
LEAF: Final = 16
CHUNK: Final = 4000
"""Points that are looked at at once."""


@dataclasses.dataclass(frozen=True)
class Section:
    """A cylinder about the axis from ``start`` to ``end`` [m] behind the tip with ``radius`` [m], its front
    edge rounded by ``corner`` [m]."""

    name: str
    start: float
    end: float
    radius: float
    corner: float = 0.0

    def off(self, back: FloatArray, beside: FloatArray) -> FloatArray:
        """Distance [m] of points ``back`` behind the tip and ``beside`` the axis from the section, below zero
        inside, in the shape of both."""
        radial = beside - (self.radius - self.corner)
        front = self.start + self.corner - back
        # a rounded edge at the front, a sharp one behind
        outer = np.hypot(np.maximum(radial, 0.0), np.maximum(front, 0.0)) - self.corner
        inner = np.minimum(np.maximum(radial, front), 0.0)
        rear = back - self.end
        body = outer + inner
        both = np.hypot(np.maximum(body, 0.0), np.maximum(rear, 0.0))
        return np.asarray(np.where((body > 0.0) & (rear > 0.0), both, np.maximum(body, rear)))


def sections(cutter: Cutter) -> tuple[Section, ...]:
    """The tool's cylinders from the tip to the end of the spindle."""
    out = [Section("cutter", 0.0, cutter.flute, cutter.radius, cutter.corner)]
    if cutter.overhang > cutter.flute:
        out.append(Section("shank", cutter.flute, cutter.overhang, cutter.shank))
    pairs = list(zip(cutter.behind[::2], cutter.behind[1::2], strict=True))
    for k, (a, b) in enumerate(pairs):
        name = "spindle" if k == len(pairs) - 1 else "holder"
        out.append(Section(name, float(a[0]), float(b[0]), float(a[1])))
    return tuple(out)


def between(
    tip: FloatArray, axis: FloatArray, reach: float, step: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Tips and axes (M, 3) along straight moves between N places, at most ``step`` [m] of the faster end of a
    tool of length ``reach`` [m] apart, and the place (M,) that each move leads to."""
    ends = np.stack([tip, tip + reach * axis], axis=1)
    way = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)
    count = np.maximum(np.ceil(way / step).astype(np.int64), 1)
    to = np.repeat(np.arange(1, len(tip)), count)
    share = (np.arange(len(to)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[to - 1]
    tips = tip[to - 1] + share[:, None] * (tip[to] - tip[to - 1])
    axes = axis[to - 1] + share[:, None] * (axis[to] - axis[to - 1])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    tips, axes = np.concatenate([tip[:1], tips]), np.concatenate([axis[:1], axes])
    return tips, axes, np.concatenate([[0], to])


def comes_near(vertices: FloatArray, tip: FloatArray, axis: FloatArray, section: Section) -> bool:
    """Whether a section on a path (N,) may come within ``SIGHT`` of a face of ``vertices`` (V, 3), by the
    boxes around both. On moves it stays in that of their ends, but for what a turning axis goes beyond."""
    turns = np.linalg.norm(0.5 * (axis[1:] + axis[:-1]), axis=1)
    room = section.radius + SIGHT + section.end * (1.0 - float(turns.min(initial=1.0)))
    ends = np.stack([tip + section.start * axis, tip + section.end * axis])
    low, high = ends.min(axis=(0, 1)) - room, ends.max(axis=(0, 1)) + room
    return bool(((low <= vertices.max(axis=0)) & (high >= vertices.min(axis=0))).all())


def off(
    points: FloatArray, tip: FloatArray, axis: FloatArray, section: Section
) -> tuple[FloatArray, IntArray]:
    """Least distance (P,) [m] of points (P, 3) from a section along a path (N,), negative inside, and the
    place (P,) that the move leads to at which it is least; no more than ``SIGHT`` is told."""
    step = max(DENSE * section.radius, LEAST)
    tips, axes, to = between(tip, axis, section.end, step)
    levels = max(int(np.ceil((section.end - section.start) / max(section.radius, LEAST))), 1)
    back = section.start + (np.arange(levels) + 0.5) / levels * (section.end - section.start)
    if len(tips) * levels > MOST:
        keep = np.unique(np.linspace(0, len(tips) - 1, MOST // levels).astype(np.int64))
        tips, axes, to = tips[keep], axes[keep], to[keep]
    centre = (tips[:, None] + back[None, :, None] * axes[:, None]).reshape(-1, 3)
    reach = float(np.hypot(section.radius, 0.6 * max(section.radius, LEAST))) + SIGHT
    best, where = np.full(len(points), SIGHT), np.zeros(len(points), dtype=np.int64)
    near = ((points >= centre.min(axis=0) - reach) & (points <= centre.max(axis=0) + reach)).all(axis=1)
    some = np.flatnonzero(near)
    if not len(some):
        return best, where
    # what is within sight of a section is within reach of one of its centres; the index behind the last
    # stands for nothing there
    some = some[np.lexsort(np.floor(points[some] / max(section.radius, LEAST)).T)]
    tree = cKDTree(centre, leafsize=LEAF)
    for rows in np.array_split(some, max(1, len(some) // CHUNK)):
        index = tree.query(points[rows], k=min(NEAR, len(centre)), distance_upper_bound=reach)[1]
        index = index.reshape(len(rows), -1)
        near_rows = np.flatnonzero(index[:, 0] < len(centre))
        index, rows = index[near_rows], rows[near_rows]
        if not len(rows):
            continue
        place = np.where(index < len(centre), index, index[:, :1]) // levels
        behind, beside = _cylindrical(points[rows], tips, axes, place)
        here = beside - section.radius  # no section is nearer than one without ends
        here[:, 0] = section.off(behind[:, 0], beside[:, 0])
        nearer = np.nonzero(here < here[:, :1])
        here[nearer] = section.off(behind[nearer], beside[nearer])
        column = here.argmin(axis=1)[:, None]
        least = np.take_along_axis(here, column, axis=1)[:, 0]
        better = least < SIGHT
        best[rows[better]] = least[better]
        where[rows[better]] = to[np.take_along_axis(place, column, axis=1)[better, 0]]
    return best, where


def _cylindrical(
    points: FloatArray, tips: FloatArray, axes: FloatArray, place: IntArray
) -> tuple[FloatArray, FloatArray]:
    """How far (N, K) [m] points (N, 3) are behind the tips and beside the axes at places (N, K)."""
    rest = [points[:, d, None] - tips[:, d][place] for d in range(3)]
    behind = sum(r * axes[:, d][place] for d, r in enumerate(rest))
    square = rest[0] * rest[0] + rest[1] * rest[1] + rest[2] * rest[2] - behind * behind
    return np.asarray(behind), np.sqrt(np.maximum(square, 0.0))
