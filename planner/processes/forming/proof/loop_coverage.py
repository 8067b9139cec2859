"""Distance of the loops of a forming ball down a wall, compared with steps of a stated size.

A window slightly higher than a step contains a whole loop wherever it is: a path as long as the contour of
the wall there. The depth at which the ball works is that of the nearest point of the face. A loop that is
left out makes the next step twice as deep, which ridges hardly reveal: on steep walls they are small, on flat
ones they are a small fraction of the whole.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.mesh import TriangleMesh, face_normals
from planner.processes.forming.proof.face import min_ball_distance
from planner.processes.forming.proof.forming_facts import FormedPass
from planner.processes.forming.proof.swept_volume import (
    CONTOUR_STEP_M,
    MAX_CORNER_GAP_M,
    contour_points,
    is_wall,
)

WINDOW_HEIGHT_STEPS: Final = 1.4
"""Height of the window in steps: a loop may be one slice lower or higher than nominal, due to its chords."""
MIN_LOOP_FRACTION: Final = 0.6
"""Fraction of the shortest contour within a window that the ball has to go along: at corners it stays away
from the wall and takes a shorter path.
"""
_SLICES_PER_STEP: Final = 5
"""Number of slices of a step where the wall is steep."""
_FLAT_WALL_SINE: Final = 0.2
"""Sine of the walls on which steps along the wall have as many slices."""
_MAX_SLICES: Final = 20_000
"""Maximum number of slices of a wall."""
_ITEMS_AT_ONCE: Final = 4_000
"""Triangles whose contours, and pieces of the path, are processed at once, because long motions fill the
memory.
"""


@dataclasses.dataclass(frozen=True)
class DepthWindow:
    """A range of depths on a wall.

    Attributes:
        start: Start [m] below the flat around the feature.
        end: End [m] below it.
        path_length: Length [m] in plan of the ball's path while it touches the wall there.
        contour: Length [m] of the shortest contour of the wall there.
    """

    start: float
    end: float
    path_length: float
    contour: float

    @property
    def fraction(self) -> float:
        """Path length divided by the contour."""
        return self.path_length / self.contour


def sparsest_window(formed: FormedPass, steps: tuple[float | None, float | None]) -> DepthWindow | None:
    """Return the window in which the ball goes along the smallest fraction of the contour.

    The fraction reveals a missing loop. The wall is divided into thin slices by height, and a window of
    consecutive slices, `WINDOW_HEIGHT_STEPS` steps high, starts at each of them. The length of the ball's
    path in a window is compared with its shortest contour. Parts of contours that no ball of that size
    reaches do not count.

    If the step-down is given, a step is a height. If the scallop h is given, a step is a distance along the
    wall: that of loops that leave ridges of height h, 2 sqrt(2 R h - h^2) for the radius R. The mean slope of
    the wall all around converts it to a height.

    Args:
        formed: Pass with its track.
        steps: Step-down [m] and scallop [m], one of which is None.

    Returns:
        The window, or None if no step is given or no window fits on the wall.
    """
    claim, (step, scallop) = formed.claim, steps
    if step is None and scallop is None:
        return None
    ridge = min(scallop or 0.0, claim.radius)
    loop_distance = step or 2.0 * float(np.sqrt(ridge * (2.0 * claim.radius - ridge)))
    depth_of_pass = abs(claim.end - claim.start)
    min_slice = loop_distance / _SLICES_PER_STEP * (1.0 if step is not None else _FLAT_WALL_SINE)
    slices = min(max(int(np.ceil(depth_of_pass / min_slice - 1e-6)), 1), _MAX_SLICES)
    size = depth_of_pass / slices
    middle = np.float64(claim.start) - claim.side * size * (np.arange(slices, dtype=np.float64) + 0.5)
    rows = np.flatnonzero(is_wall(claim))
    corners = claim.vertices[claim.faces[rows]]
    normals = face_normals(TriangleMesh(claim.vertices, claim.faces[rows]))
    sine = np.maximum(np.hypot(normals[:, 0], normals[:, 1]), 1e-9)
    contour, slope = np.zeros(slices), np.zeros(slices)
    for chunk in np.array_split(np.arange(len(corners)), len(corners) // _ITEMS_AT_ONCE + 1):
        _, length, owner, level = contour_points(corners[chunk], middle, np.inf)
        np.add.at(contour, level, length)
        np.add.at(slope, level, length / sine[chunk[owner]])
    # distance down the wall of each slice, in the unit of a step: a height, or a length along the wall
    down = np.full(slices, size)
    if step is None:
        down *= np.where(contour > 0.0, slope / np.maximum(contour, 1e-12), 1.0)
    depth = np.concatenate([[0.0], np.cumsum(down)])
    last = np.searchsorted(depth, depth[:-1] + WINDOW_HEIGHT_STEPS * loop_distance - 1e-9)
    first = np.flatnonzero(last <= slices)
    if not len(first):
        return None
    spans = [slice(int(i), int(last[i])) for i in first]
    path_length = _path_lengths(formed, size, slices)
    window_length = np.array([path_length[span].sum() for span in spans])
    to_check = np.zeros(slices, dtype=np.bool_)
    for k in np.flatnonzero(
        window_length < MIN_LOOP_FRACTION * np.array([contour[span].min() for span in spans])
    ):
        to_check[spans[k]] = True
    if to_check.any():  # no ball may reach part of the wall, so its contour does not count
        points, length, owner, level = contour_points(corners, middle[to_check], CONTOUR_STEP_M)
        is_reachable = (
            min_ball_distance(formed.face, points, normals[owner], claim.radius, claim.side)
            <= MAX_CORNER_GAP_M
        )
        contour[to_check] = np.bincount(
            level[is_reachable], weights=length[is_reachable], minlength=int(to_check.sum())
        )
    min_contour = np.array([contour[span].min() for span in spans])
    measurable = np.flatnonzero(min_contour > 0.0)
    if not len(measurable):
        return None
    worst_index = int(measurable[np.argmin(window_length[measurable] / min_contour[measurable])])
    span = spans[worst_index]
    return DepthWindow(
        span.start * size,
        span.stop * size,
        float(window_length[worst_index]),
        float(min_contour[worst_index]),
    )


def _path_lengths(formed: FormedPass, size: float, slices: int) -> FloatArray:
    """Return the length (S,) [m] in plan of the ball's path along the wall, by height.

    There is one length for each slice of height ``size`` [m].
    """
    claim, nearest, touches = formed.claim, formed.nearest, formed.is_touching
    out = np.zeros(slices)
    forming_pieces = np.flatnonzero(formed.track.is_forming[formed.pieces.first])
    for chunk in np.array_split(forming_pieces, len(forming_pieces) // _ITEMS_AT_ONCE + 1):
        first_row, last_row = formed.pieces.first[chunk], formed.pieces.last[chunk]
        first, last = (np.searchsorted(formed.knots, rows) for rows in (first_row, last_row))
        move = formed.track.centre[last_row, 0] - formed.track.centre[first_row, 0]
        along = np.where(touches[first] & touches[last], lengths(move[:, :2]), 0.0)
        height = 0.5 * (nearest.point[first, 2] + nearest.point[last, 2])
        np.add.at(out, _slice_index(claim.side * (claim.start - height), size, slices), along)
    return out


def _slice_index(depth: FloatArray, size: float, slices: int) -> IntArray:
    """Return the indices (N,) of the slices that contain depths (N,) [m]."""
    return np.clip((depth / size).astype(np.int64), 0, slices - 1)
