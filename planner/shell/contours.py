"""Correspondence between the closed contours of a wall.

It consists of matching positions and the lines of corners down the wall.
"""

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry import curves
from planner.geometry.arrays import FloatArray, IntArray, dots, lengths

POSITIONS_AROUND = 1024
"""Number of positions around a contour at which contours are matched."""
EVEN_WEIGHT = 0.7
"""Weight of even spacing along the contour in the positions, against the nearest points."""
CORNER_ANGLE = np.radians(25.0)
"""Turning angle [rad] of a contour above which it has a corner, along which a mesh line runs down the
wall.
"""
OUTER_WINDOW_RATIO = 6.0
"""Ratio of the window in which the turning beside a point is measured to that of a corner."""
CORNER_WINDOW = 5e-4
"""Contour length [m] to both sides over which turning angles are added, so that a noisy contour has no
corners.
"""


def counterclockwise(ring: FloatArray) -> FloatArray:
    """Orient a closed contour (k, 3) counterclockwise as seen from above."""
    ring = np.asarray(ring, dtype=np.float64)
    return ring if _area(ring) > 0.0 else ring[::-1]


def _area(ring: FloatArray) -> float:
    """Signed area [m^2] of a contour from above, positive if counterclockwise (shoelace formula)."""
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float(np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))


def match_contours(outlines: list[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Resample contours so that equal positions face each other, and find the lines of corners.

    Each position is a blend of the nearest one on the previous contour and of even spacing, with weight
    `EVEN_WEIGHT`, which an arc needs that grows out of a point. A corner takes the position of a nearby
    corner of the previous contour.

    Args:
        outlines: Contours (k, 3) [m], from the outside inwards.

    Returns:
        Contours (r, PLACES_AROUND, 3) and the positions of corners.
    """
    out: list[FloatArray] = []
    share = np.arange(POSITIONS_AROUND) / POSITIONS_AROUND
    lines = np.empty(0, dtype=np.int64)
    nearest_positions: FloatArray = POSITIONS_AROUND * share
    snap_distance = 0.0
    for index, ring in enumerate(outlines):
        if out:
            ring = np.roll(ring, -int(np.argmin(lengths(ring[:, :2] - out[-1][0, :2]))), axis=0)
        whole = along_contour(ring)
        along = whole / whole[-1]
        if out:
            nearest = cKDTree(out[-1][:, :2]).query(points_at(ring, along, share)[:, :2])[1]
            nearest_positions = np.asarray(nearest, dtype=np.float64)
            # positions increase around the contour; the first may be slightly below 0
            step = np.diff(nearest_positions, prepend=nearest_positions[0])
            turns = np.cumsum(np.round(step / POSITIONS_AROUND)) + np.round(
                nearest_positions[0] / POSITIONS_AROUND
            )
            nearest_positions = np.asarray(nearest_positions - POSITIONS_AROUND * turns)
            snap_distance = 4.0 * mean_gap(outlines[index - 1], ring) / whole[-1] * POSITIONS_AROUND
        corner = along[:-1][_corners(ring)]
        even = POSITIONS_AROUND * share + float(np.mean(nearest_positions - POSITIONS_AROUND * share))
        positions = (1.0 - EVEN_WEIGHT) * np.maximum.accumulate(nearest_positions) + EVEN_WEIGHT * even
        at = np.interp(corner, np.append(share, 1.0), np.append(positions, positions[0] + POSITIONS_AROUND))
        snapped, lines = _snap_corners(at, lines, max(snap_distance, 4.0))
        fractions = share
        if len(corner):
            shift = np.interp(share, corner, snapped - at, period=1.0)
            fractions, positions = (
                np.concatenate([share, corner]),
                np.concatenate([positions + shift, snapped]),
            )
            order = np.argsort(fractions, kind="stable")
            fractions, positions = fractions[order], np.maximum.accumulate(positions[order])
        positions = np.concatenate([positions + POSITIONS_AROUND * turn for turn in (-1, 0, 1)])
        fractions = np.concatenate([fractions + turn for turn in (-1, 0, 1)])
        out.append(points_at(ring, along, np.interp(POSITIONS_AROUND * share, positions, fractions) % 1.0))
    return np.array(out), np.unique(lines)


def mean_gap(outer: FloatArray, inner: FloatArray) -> float:
    """Mean distance [m] between two contours as seen from above.

    It is the area between them over their mean length.
    """
    between = abs(_area(outer) - _area(inner))
    return 2.0 * between / float(along_contour(outer[:, :2])[-1] + along_contour(inner[:, :2])[-1])


def _corners(ring: FloatArray) -> IntArray:
    """Indices of the corners of a contour.

    A corner is the point with the largest turning angle within `CORNER_WINDOW`, if the contour turns more
    there than beside it by `CORNER_ANGLE`. A small circle of few points has none.
    """
    ahead = (np.roll(ring, -1, axis=0) - ring)[:, :2]
    previous = np.roll(ahead, 1, axis=0)
    turn = np.arctan2(previous[:, 0] * ahead[:, 1] - previous[:, 1] * ahead[:, 0], dots(previous, ahead))
    along = along_contour(ring)
    arc_lengths = np.concatenate([along[:-1] - along[-1], along[:-1], along[:-1] + along[-1]])
    total = np.concatenate([[0.0], np.cumsum(np.tile(turn, 3))])

    def turning_within(window: float) -> FloatArray:
        low = np.searchsorted(arc_lengths, along[:-1] - window - 1e-12)
        high = np.searchsorted(arc_lengths, along[:-1] + window + 1e-12)
        return np.asarray(np.abs(total[high] - total[low]))

    within, outer = turning_within(CORNER_WINDOW), turning_within(OUTER_WINDOW_RATIO * CORNER_WINDOW)
    within -= np.maximum(outer - within, 0.0) / (OUTER_WINDOW_RATIO - 1.0)
    corners: list[int] = []
    for index in np.flatnonzero(within > CORNER_ANGLE)[
        np.argsort(-np.abs(turn[within > CORNER_ANGLE]), kind="stable")
    ]:
        distance = np.abs(along[corners] - along[index])
        if not len(distance) or np.minimum(distance, along[-1] - distance).min() > 2.0 * CORNER_WINDOW:
            corners.append(int(index))
    return np.array(sorted(corners), dtype=np.int64)


def _snap_corners(at: FloatArray, lines: IntArray, max_distance: float) -> tuple[FloatArray, IntArray]:
    """Round the positions of corners to integers, and move them to existing lines of corners nearby.

    Args:
        at: Positions (c,) of corners.
        lines: Positions of the lines of corners so far.
        max_distance: Maximum distance, in positions.

    Returns:
        Integer positions (c,), and all lines of corners including new ones.
    """
    out = np.round(at)
    for index, position in enumerate(at):
        distance = (lines - position + 0.5 * POSITIONS_AROUND) % POSITIONS_AROUND - 0.5 * POSITIONS_AROUND
        if len(distance) and np.abs(distance).min() < max_distance:
            out[index] = position + distance[np.argmin(np.abs(distance))]
        else:
            lines = np.append(lines, int(out[index]) % POSITIONS_AROUND)
    return np.round(out), lines


def along_contour(ring: FloatArray) -> FloatArray:
    """Arc length (k + 1,) [m] of a closed contour at each point and back at the first."""
    return curves.arc_length(np.concatenate([ring, ring[:1]]))


def points_at(ring: FloatArray, positions: FloatArray, query: FloatArray) -> FloatArray:
    """Interpolate a closed contour.

    Args:
        ring: Points (k, 3) [m].
        positions: Positions (k + 1,) of these points, including the first again.
        query: Positions (w,) to evaluate.

    Returns:
        Points (w, 3) [m].
    """
    return curves.interpolate_polyline(np.concatenate([ring, ring[:1]]), positions, query)


def nearest_point_on(ring: FloatArray, point: FloatArray) -> tuple[float, float]:
    """Distance [m] from a point to a contour (k, 2), and the nearest position as a fractional point index."""
    ahead = np.roll(ring, -1, axis=0) - ring
    fraction = np.clip(dots(point - ring, ahead) / np.maximum(dots(ahead, ahead), 1e-30), 0.0, 1.0)
    distance = lengths(ring + fraction[:, None] * ahead - point)
    index = int(np.argmin(distance))
    return float(distance[index]), float(index + fraction[index]) % len(ring)
