"""The proof's own readers of part files, and the surfaces that follow from them.

Nothing here is shared with the readers and the geometry of the planner.

This file has what all readers use: conversion of the numbers in the problem's source to SI units, points that
are spread evenly and reproducibly over surfaces, and `UnreadError`, which states what is wrong with a part
file.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray

Entry = Mapping[str, Any]
"""A mapping of a problem file, as it was read."""

UNITS: Final = {"mm": 1 / 1000, "cm": 1 / 100, "m": 1.0, "in": 254 / 10000, "ft": 3048 / 10000}
"""Length units [m]."""


def metres(value: Any) -> float:
    """Convert a length from mm to m."""
    return float(value) / 1000.0


def radians(value: Any) -> float:
    """Convert an angle from degrees to radians."""
    return float(value) * np.pi / 180.0


def points_in_metres(values: Any) -> FloatArray:
    """Convert a list of points (N, D) from mm to m."""
    return np.array([[float(v) for v in point] for point in values], dtype=np.float64) / 1000.0


def file_of(entry: Entry) -> Path:
    """Return the path of the file that an entry names."""
    return Path(str(entry["file"]))


def pose_of(entry: Entry) -> FloatArray:
    """Return the pose (4, 4) [m] that an entry states as ``xyz_mm``, and ``rpy_deg`` about fixed x, y, z."""
    a, b, c = (radians(v) for v in entry.get("rpy_deg") or (0.0, 0.0, 0.0))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3] = about_z @ about_y @ about_x
    out[:3, 3] = [metres(v) for v in entry.get("xyz_mm") or (0.0, 0.0, 0.0)]
    return out


class UnreadError(ValueError):
    """A part file that the second reader cannot read. The message says why, without the file's name."""


_R2_STEPS: Final = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of a low-discrepancy sequence in the unit square.
Source: M. Roberts (2018), The Unreasonable Effectiveness of Quasirandom Sequences (R2 sequence).
"""


@dataclasses.dataclass(frozen=True)
class Samples:
    """N points of a surface.

    Attributes:
        points: Points (N, 3) [m].
        normals: Unit normals (N, 3), away from the part.
        row: Number (N,) of the facet of each point, or of the pair of rulings around it, from 1.
        area: Area [m^2] of the whole surface.
    """

    points: FloatArray
    normals: FloatArray
    row: IntArray
    area: float

    def moved(self, pose: FloatArray) -> "Samples":
        """Return the points moved by ``pose`` (4, 4)."""
        transposed_rotation = pose[:3, :3].T
        points, normals = self.points @ transposed_rotation + pose[:3, 3], self.normals @ transposed_rotation
        return Samples(points, normals, self.row, self.area)

    def subset(self, chosen: BoolArray) -> "Samples":
        """Return the points for which ``chosen`` (N,) is set. The area stays that of the whole surface."""
        return Samples(self.points[chosen], self.normals[chosen], self.row[chosen], self.area)


def on_triangles(corners: FloatArray, row: IntArray, count: int) -> Samples:
    """Return ``count`` points spread evenly over triangles (F, 3, 3) with the numbers ``row`` (F,).

    The triangles are anticlockwise seen from outside.
    """
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    which, a, b = _distribute(size, count)
    # Points of the unit square beyond its diagonal are mirrored into the triangle.
    outside = a + b > 1.0
    a, b = np.where(outside, 1.0 - a, a)[:, None], np.where(outside, 1.0 - b, b)[:, None]
    chosen_corners = corners[which]
    points = (
        chosen_corners[:, 0]
        + a * (chosen_corners[:, 1] - chosen_corners[:, 0])
        + b * (chosen_corners[:, 2] - chosen_corners[:, 0])
    )
    return Samples(points, cross[which] / size[which][:, None], row[which], 0.5 * float(size.sum()))


def on_rulings(start: FloatArray, end: FloatArray, count: int, guides_alone: bool = False) -> Samples:
    """Return ``count`` points that are spread evenly over a ruled surface.

    Between two rulings the surface is bilinear. Its side away from the part is that of the cross product of
    the direction of ``start`` and the rulings.

    Args:
        start: Starts (M, 3) [m] of the rulings.
        end: Ends (M, 3) [m] of the rulings.
        count: Number of points.
        guides_alone: Whether the points lie only on the two guides, along ``start`` and ``end``.
    """
    along = np.diff(start, axis=0) + np.diff(end, axis=0)
    across = (end - start)[1:] + (end - start)[:-1]
    which, s, t = _distribute(np.linalg.norm(np.cross(along, across), axis=1), count)
    if guides_alone:
        t = np.where(t < 0.5, 0.0, 1.0)
    s, t = s[:, None], t[:, None]
    low, high = start[which], start[which + 1]
    end_low, end_high = end[which], end[which + 1]
    points = (1 - t) * ((1 - s) * low + s * high) + t * ((1 - s) * end_low + s * end_high)
    normal = np.cross(
        (1 - t) * (high - low) + t * (end_high - end_low), (1 - s) * (end_low - low) + s * (end_high - high)
    )
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    area = 0.25 * float(np.linalg.norm(np.cross(along, across), axis=1).sum())
    return Samples(points, normal / np.maximum(size, 1e-300), which + 1, area)


def _distribute(size: FloatArray, count: int) -> tuple[IntArray, FloatArray, FloatArray]:
    """Distribute ``count`` points evenly over K cells, of areas ``size`` (K,).

    Returns:
        Index (count,) of the cell of each point, and its two coordinates (count,) in the unit square.
    """
    total = np.cumsum(size)
    which = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1], side="right")
    a, b = (np.outer(np.arange(1, count + 1), _R2_STEPS) % 1.0).T
    return np.minimum(which, len(size) - 1), a, b
