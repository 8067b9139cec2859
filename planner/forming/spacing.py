"""From which level to which level loops go: a constant step, or one that leaves ridges of a wanted height.

A ball of radius R leaves ridges of height h between two ways that are d apart along a flat wall,
h = R - sqrt(R^2 - d^2 / 4), so d = 2 sqrt(2 R h - h^2), and levels on a wall at angle a are d sin a apart
(Malhotra and others 2010, who look at the flattest wall of the next contour; here of both). All levels here
fall: for a feature that rises, mirror it first.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon, contains_xy

from planner.forming.paths_slices import Segments, cut

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EDGE: Final = 1e-6
"""The last line is so far above the flat end of a feature [m], where there are no lines."""
_PROFILE: Final = 400
_SHELF: Final = 4.0
"""A shelf between two neighbouring levels counts as so many ridges wide at most."""


def scallop_width(radius: float, scallop: float) -> float:
    """How far apart [m] along a flat wall ways of a ball may be that leave ridges ``scallop`` [m] high."""
    return 2.0 * float(np.sqrt(2.0 * radius * scallop - scallop * scallop))


def scallop_height(radius: float, width: float | FloatArray) -> FloatArray:
    """Height [m] of the ridges between ways ``width`` [m] apart along a flat wall: the inverse."""
    return np.asarray(radius - np.sqrt(np.maximum(radius**2 - 0.25 * np.square(width), 0.0)))


def constant_levels(start: float, end: float, step: float) -> FloatArray:
    """Levels below ``start`` down to ``end``, ``step`` [m] apart, the last step being what is left."""
    count = max(int(np.ceil((start - end) / step - 1e-6)), 1)
    return np.asarray(np.append(start - step * np.arange(1, count), end))


def flattest(segments: Segments, region: Polygon | None, count: int) -> FloatArray:
    """The least wall angle (count,) [rad] on each level, NaN where there is no line."""
    if region is not None:
        middle = 0.5 * (segments.start[:, :2] + segments.stop[:, :2])
        inside = contains_xy(region, middle[:, 0], middle[:, 1])
    else:
        inside = np.ones(len(segments.level), dtype=np.bool_)
    up = np.full(count, -1.0)
    rows = segments.level[inside]
    np.maximum.at(up, rows, np.maximum(segments.start_normal[inside, 2], segments.stop_normal[inside, 2]))
    return np.asarray(np.where(up < 0.0, np.nan, np.arccos(np.clip(up, -1.0, 1.0))))


def scallop_levels(
    vertices: FloatArray,
    faces: IntArray,
    normals: FloatArray,
    region: Polygon | None,
    start: float,
    end: float,
    width: float,
) -> FloatArray:
    """Levels below ``start`` down to ``end`` whose lines are ``width`` [m] apart along the face.

    A step is ``width`` times the sine of the flattest wall of both its lines; where the face turns so flat
    that this comes to little, lines are at least half of ``width`` apart along the face instead, as nothing
    is gained from more of them.
    """
    share = np.linspace(0.0, 1.0, _PROFILE + 1)
    smooth = share * share * (3.0 - 2.0 * share)  # dense at both ends, where faces turn into the flat
    grid = start - EDGE - (start - end - 2.0 * EDGE) * smooth
    angle = flattest(cut(vertices, faces, normals, grid), region, len(grid))
    known = np.isfinite(angle)
    sine = np.interp(-grid, -grid[known], np.sin(angle[known])) if known.any() else np.ones(len(grid))
    way = -np.diff(grid) * 2.0 / np.maximum(sine[1:] + sine[:-1], 1e-9)
    along = np.concatenate([[0.0], np.cumsum(np.minimum(way, _SHELF * width))])
    depth = grid[0] - grid
    levels = []
    at = 0.0
    while at < depth[-1] - EDGE:
        here = float(np.interp(at, depth, sine))
        # the farthest level of the profile to which the step holds, then the place between it and the next
        ahead = depth > at
        flat = np.minimum(np.minimum.accumulate(np.where(ahead, sine, np.inf)), here)
        holds = ahead & (depth - at <= width * flat)
        step = 0.0
        if holds.any():
            last = int(np.flatnonzero(holds)[-1])
            beyond = min(last + 1, len(depth) - 1)
            step = max(depth[last] - at, min(width * flat[beyond], depth[beyond] - at))
        else:
            nearest = int(np.argmax(ahead))
            step = min(width * flat[nearest], depth[nearest] - at)
        least = float(np.interp(np.interp(at, depth, along) + 0.5 * width, along, depth)) - at
        at = at + max(step, least, EDGE)
        levels.append(grid[0] - min(at, depth[-1]))
    levels[-1] = end
    return np.asarray(levels)
