"""Straight wires in space as batches of lines: how they move across themselves and where they pass a box."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import dots

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_PARALLEL: Final = 1e-12
"""Components of a direction below this do not leave the slab between two faces."""


@dataclasses.dataclass(frozen=True)
class Lines:
    """Wires through the points ``start`` and ``end`` (N, 3) [m], which are the guide points of a cut; the
    wire goes on beyond both."""

    start: FloatArray
    end: FloatArray

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | list[int] | NDArray[np.intp] | BoolArray) -> Lines:
        return Lines(self.start[rows], self.end[rows])

    @property
    def direction(self) -> FloatArray:
        """Unit vectors (N, 3) from start to end."""
        way = self.end - self.start
        return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))

    def at(self, length: FloatArray) -> FloatArray:
        """Points (N, 3) [m] at signed lengths (N,) [m] from the starts."""
        return self.start + length[:, None] * self.direction

    def moved(self, shift: FloatArray) -> Lines:
        """The lines shifted by (3,) or (N, 3) [m]."""
        return Lines(self.start + shift, self.end + shift)

    def reversed(self) -> Lines:
        """The lines in the opposite order."""
        return Lines(self.start[::-1], self.end[::-1])

    def abreast(self, points: FloatArray) -> FloatArray:
        """Signed lengths (N,) from the starts to the points of the lines nearest to ``points`` (N, 3)."""
        return np.asarray(np.sum((points - self.start) * self.direction, axis=1))


def join(parts: list[Lines]) -> Lines:
    """All lines in one batch."""
    return Lines(np.concatenate([p.start for p in parts]), np.concatenate([p.end for p in parts]))


def chord(lines: Lines, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed lengths (N,), (N,) [m] from the starts at which the lines enter and leave a box (2, 3); NaN
    where they pass it by (the slab method)."""
    way = lines.direction
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = ((box[k] - lines.start) / way for k in (0, 1))
    still = np.abs(way) < _PARALLEL
    between = (lines.start > box[0]) & (lines.start < box[1])
    first = np.where(still, np.where(between, -np.inf, np.inf), np.fmin(a, b)).max(axis=1)
    last = np.where(still, np.where(between, np.inf, -np.inf), np.fmax(a, b)).min(axis=1)
    passes = first < last
    return np.where(passes, first, np.nan), np.where(passes, last, np.nan)


def grown(box: FloatArray, margin: float) -> FloatArray:
    """A box (2, 3) that is larger by ``margin`` [m] on all sides."""
    return box + margin * np.array([[-1.0], [1.0]])


def move_across(lines: Lines, points: FloatArray) -> FloatArray:
    """How far (N - 1,) [m] each line moves across itself to the next one, at ``points`` (N - 1, 3) near it.

    Measured in the plane through the point across the mean direction of both.
    """
    way = lines.direction
    mean = way[:-1] + way[1:]
    mean = mean / np.linalg.norm(mean, axis=1, keepdims=True)

    def crossing(start: FloatArray, direction: FloatArray) -> FloatArray:
        share = np.sum((points - start) * mean, axis=1) / np.sum(direction * mean, axis=1)
        return np.asarray(start + share[:, None] * direction)

    gap = crossing(lines.start[1:], way[1:]) - crossing(lines.start[:-1], way[:-1])
    return np.asarray(np.linalg.norm(gap, axis=1))


def fastest(lines: Lines, box: FloatArray) -> FloatArray:
    """How far (N,) [m] the fastest point inside the box moves across the wire on the way to each line; NaN
    where none is inside, 0 for the first.

    The move is linear along the wire, so that it is largest at an end of the stretch inside.
    """
    enter, leave = chord(lines, box)
    out = np.full(len(lines), np.nan)
    for rows in (slice(None, -1), slice(1, None)):  # the stretch of either line: both count
        here = lines[rows]
        for length in (enter[rows], leave[rows]):
            inside = np.isfinite(length)
            points = here.at(np.where(inside, length, 0.0))
            out[1:] = np.fmax(out[1:], np.where(inside, move_across(lines, points), np.nan))
    out[:1] = 0.0
    return out


def exit_length(lines: Lines, way: FloatArray, box: FloatArray) -> FloatArray:
    """How far (N,) [m] each line must go along ``way`` (N, 3) until it has left the box for good, 0 where it
    never meets it that way.

    A line shifted by s meets the box where six half planes in (s, length along the line) have a common
    point; the farthest is one of their corners.
    """
    far = np.zeros(len(lines))
    direction = lines.direction
    rows = [
        (sign * way[:, k], sign * direction[:, k], sign * (box[end, k] - lines.start[:, k]))
        for k in range(3)
        for end, sign in ((0, -1.0), (1, 1.0))
    ]
    for (a, b, c), (d, e, f) in itertools.combinations(rows, 2):
        det = a * e - b * d
        good = np.abs(det) > _PARALLEL
        whole = np.where(good, det, 1.0)
        s, t = (c * e - b * f) / whole, (a * f - c * d) / whole
        for g, h, k in rows:
            good &= g * s + h * t <= k + 1e-9
        far = np.where(good, np.maximum(far, s), far)
    return far


def distance_to_polyline(points: FloatArray, polyline: FloatArray) -> FloatArray:
    """Distance (N,) [m] of points (N, 3) to a polyline (M, 3)."""
    out = np.full(len(points), np.inf)
    base, way = polyline[:-1], np.diff(polyline, axis=0)
    square = np.maximum(np.sum(way * way, axis=1), 1e-30)
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) * len(base) // 1_000_000)):
        gap = points[chunk, None] - base
        share = np.clip(np.einsum("nmi,mi->nm", gap, way) / square, 0.0, 1.0)
        gap -= share[..., None] * way
        out[chunk] = np.sqrt(dots(gap, gap).min(axis=1))
    return out
