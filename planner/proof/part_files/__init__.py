"""The proof's own readers of part files, and the surfaces that follow from them.

Nothing here is shared with the readers and the geometry of the planner.

What all readers use stands here: the user's numbers as the problem's source states them, in SI,
with what holds where no number is stated; places spread over surfaces, evenly and the same ones
each time; `UnreadError`, which is what is wrong with a part file.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray

Said = Mapping[str, Any]
"""A mapping of a problem file, as it was read."""

UNITS: Final = {"mm": 1 / 1000, "cm": 1 / 100, "m": 1.0, "in": 254 / 10000, "ft": 3048 / 10000}
"""Length units [m]."""


def metres(value: Any) -> float:
    """A length given in mm."""
    return float(value) / 1000.0


def radians(value: Any) -> float:
    """An angle given in degrees."""
    return float(value) * np.pi / 180.0


def row(values: Any) -> FloatArray:
    """A row of points (N, D) [m] given in mm."""
    return np.array([[float(v) for v in point] for point in values], dtype=np.float64) / 1000.0


def file_of(said: Said) -> Path:
    """The file that is named."""
    return Path(str(said["file"]))


def pose(said: Said) -> FloatArray:
    """A place (4, 4) of ``xyz_mm`` and ``rpy_deg``, turns about fixed x, then y, then z."""
    a, b, c = (radians(v) for v in said.get("rpy_deg") or (0.0, 0.0, 0.0))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    out = np.eye(4)
    out[:3, :3] = about_z @ about_y @ about_x
    out[:3, 3] = [metres(v) for v in said.get("xyz_mm") or (0.0, 0.0, 0.0)]
    return out


class UnreadError(ValueError):
    """A part file that the second reader cannot read; the message says why, without the file's name."""


_GOLDEN: Final = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of the evenest known row of points in a square (M. Roberts, 2018)."""


@dataclasses.dataclass(frozen=True)
class Samples:
    """Places ``points`` (N, 3) [m] of a surface with ``normals`` (N, 3) away from the part; ``row`` (N,):
    number of the facet or ruling that each is on, from 1; ``area`` [m^2] of the surface."""

    points: FloatArray
    normals: FloatArray
    row: IntArray
    area: float

    def moved(self, pose: FloatArray) -> "Samples":
        """The same, moved by ``pose`` (4, 4)."""
        turn = pose[:3, :3].T
        points, normals = self.points @ turn + pose[:3, 3], self.normals @ turn
        return Samples(points, normals, self.row, self.area)

    def some(self, chosen: BoolArray) -> "Samples":
        """Those that are chosen (N,)."""
        return Samples(self.points[chosen], self.normals[chosen], self.row[chosen], self.area)


def on_triangles(corners: FloatArray, row: IntArray, count: int) -> Samples:
    """``count`` places on triangles (F, 3, 3), anticlockwise from outside; ``row`` (F,) their numbers."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    which, a, b = _spread(size, count)
    over = a + b > 1.0
    a, b = np.where(over, 1.0 - a, a)[:, None], np.where(over, 1.0 - b, b)[:, None]
    own = corners[which]
    points = own[:, 0] + a * (own[:, 1] - own[:, 0]) + b * (own[:, 2] - own[:, 0])
    return Samples(points, cross[which] / size[which][:, None], row[which], 0.5 * float(size.sum()))


def on_rulings(start: FloatArray, end: FloatArray, count: int, guides_alone: bool = False) -> Samples:
    """``count`` places between each of the rulings from ``start`` to ``end`` (M, 3) and the next one;
    ``guides_alone``: on the guides themselves. Away from the part is start's direction x the rulings."""
    along = np.diff(start, axis=0) + np.diff(end, axis=0)
    across = (end - start)[1:] + (end - start)[:-1]
    which, s, t = _spread(np.linalg.norm(np.cross(along, across), axis=1), count)
    if guides_alone:
        t = np.where(t < 0.5, 0.0, 1.0)
    s, t = s[:, None], t[:, None]
    low, high = start[which], start[which + 1]
    far_low, far_high = end[which], end[which + 1]
    points = (1 - t) * ((1 - s) * low + s * high) + t * ((1 - s) * far_low + s * far_high)
    normal = np.cross(
        (1 - t) * (high - low) + t * (far_high - far_low), (1 - s) * (far_low - low) + s * (far_high - high)
    )
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    area = 0.25 * float(np.linalg.norm(np.cross(along, across), axis=1).sum())
    return Samples(points, normal / np.maximum(size, 1e-300), which + 1, area)


def _spread(size: FloatArray, count: int) -> tuple[IntArray, FloatArray, FloatArray]:
    """Which of some areas (K,) ``count`` places are on, even over all, and where in a square each is."""
    total = np.cumsum(size)
    which = np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1], side="right")
    a, b = (np.outer(np.arange(1, count + 1), _GOLDEN) % 1.0).T
    return np.minimum(which, len(size) - 1), a, b
