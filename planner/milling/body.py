"""A milling tool as a body of revolution: how far points are off it, and how deep the part stands in it along
a path."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.round_body import Round
from planner.geometry.swept import least
from planner.tooling import Cutter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DENSE: Final = 0.15
"""Distance of places along the path, over the radius of the section."""
LEAST: Final = 0.5e-3
"""The same at least [m]."""
SIGHT: Final = 2e-3
"""Points that are farther off than this [m] are as good as any other."""


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

    @property
    def round(self) -> Round:
        """The section as a body of revolution."""
        return Round(self.start, self.end, self.radius, self.off, self.corner == 0.0)


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


def places(tip: FloatArray, axis: FloatArray, section: Section) -> tuple[FloatArray, FloatArray, IntArray]:
    """Tips and axes (M, 3) at which a section on a path (N,) is looked at, and the place (M,) that each move
    leads to."""
    return between(tip, axis, section.end, max(DENSE * section.radius, LEAST))


def off(
    points: FloatArray, tip: FloatArray, axis: FloatArray, section: Section, below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Least distance (P,) [m] of points (P, 3) from a section along a path (N,), negative inside, and the
    place (P,) that the move leads to at which it is least; no more than ``SIGHT`` is told. With ``below`` [m]
    what is not less may be told too large, but for the least of all."""
    tips, axes, to = places(tip, axis, section)
    best, place = least(points, tips, axes, section.round, SIGHT, below)
    return best, np.where(best < SIGHT, to[place], 0)
