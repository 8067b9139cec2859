"""Correspondence between the closed contours of a wall.

Matching positions on all contours face each other. Corners of successive contours form lines down the wall.
"""

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry import curves
from planner.geometry.arrays import FloatArray, IntArray, dots, lengths

POSITIONS_AROUND = 1024
"""Number of positions around a contour at which contours are matched."""
EVEN_WEIGHT = 0.7
"""Weight of even spacing along the contour in matched positions. The rest is that of the nearest points."""
CORNER_ANGLE = np.radians(25.0)
"""Turning angle [rad] of a contour above which it has a corner, along which a mesh line runs down the
wall.
"""
OUTER_WINDOW_RATIO = 6.0
"""Ratio of the window that shows how much a contour turns around a corner to the corner's own window."""
CORNER_WINDOW = 5e-4
"""Contour length [m] to both sides over which turning angles are added, so that a noisy contour has no
corners.
"""


def counterclockwise(ring: FloatArray) -> FloatArray:
    """Orient a closed contour (k, 3) counterclockwise as seen from above."""
    ring = np.asarray(ring, dtype=np.float64)
    return ring if _area(ring) > 0.0 else ring[::-1]


def _area(ring: FloatArray) -> float:
    """Return the area [m^2] of a contour as seen from above, negative if clockwise (shoelace formula)."""
    after = np.roll(ring, -1, axis=0)
    return 0.5 * float(np.sum(ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]))


def match_contours(outlines: list[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Resample contours so that equal positions face each other, and find the lines of corners.

    Rows of the mesh are interpolated between the resampled contours, and no triangle crosses a line of
    corners.

    Each position is a mean of the nearest position on the previous contour and of even spacing, with weight
    `EVEN_WEIGHT`. Even spacing is needed where an arc grows out of a point. A corner takes the position of a
    nearby line of corners of previous contours.

    Args:
        outlines: Contours (k, 3) [m], from the outside inwards.

    Returns:
        Contours (r, `POSITIONS_AROUND`, 3) [m], and the positions (c,) of the lines of corners.
    """
    out: list[FloatArray] = []
    fraction = np.arange(POSITIONS_AROUND) / POSITIONS_AROUND
    lines = np.empty(0, dtype=np.int64)
    nearest_positions: FloatArray = POSITIONS_AROUND * fraction
    snap_distance = 0.0
    for index, ring in enumerate(outlines):
        if out:
            ring = np.roll(ring, -int(np.argmin(lengths(ring[:, :2] - out[-1][0, :2]))), axis=0)
        arc_length = along_contour(ring)
        along = arc_length / arc_length[-1]
        if out:
            nearest = cKDTree(out[-1][:, :2]).query(points_at(ring, along, fraction)[:, :2])[1]
            nearest_positions = np.asarray(nearest, dtype=np.float64)
            # positions increase around the contour; the first may be slightly below 0
            step = np.diff(nearest_positions, prepend=nearest_positions[0])
            # full turns by which each position is ahead, to be subtracted
            turns = np.cumsum(np.round(step / POSITIONS_AROUND)) + np.round(
                nearest_positions[0] / POSITIONS_AROUND
            )
            nearest_positions = np.asarray(nearest_positions - POSITIONS_AROUND * turns)
            snap_distance = 4.0 * mean_gap(outlines[index - 1], ring) / arc_length[-1] * POSITIONS_AROUND
        corner = along[:-1][_corners(ring)]
        even = POSITIONS_AROUND * fraction + float(np.mean(nearest_positions - POSITIONS_AROUND * fraction))
        positions = (1.0 - EVEN_WEIGHT) * np.maximum.accumulate(nearest_positions) + EVEN_WEIGHT * even
        corner_position = np.interp(
            corner, np.append(fraction, 1.0), np.append(positions, positions[0] + POSITIONS_AROUND)
        )
        # snap distance in positions: four times the mean gap to the previous contour, at least 4 positions
        snapped, lines = _snap_corners(corner_position, lines, max(snap_distance, 4.0))
        fractions = fraction
        if len(corner):
            shift = np.interp(fraction, corner, snapped - corner_position, period=1.0)
            fractions = np.concatenate([fraction, corner])
            positions = np.concatenate([positions + shift, snapped])
            order = np.argsort(fractions, kind="stable")
            fractions, positions = fractions[order], np.maximum.accumulate(positions[order])
        # periodic continuation by one turn to both sides, then inversion: fraction at each integer position
        positions = np.concatenate([positions + POSITIONS_AROUND * turn for turn in (-1, 0, 1)])
        fractions = np.concatenate([fractions + turn for turn in (-1, 0, 1)])
        out.append(points_at(ring, along, np.interp(POSITIONS_AROUND * fraction, positions, fractions) % 1.0))
    return np.array(out), np.unique(lines)


def mean_gap(outer: FloatArray, inner: FloatArray) -> float:
    """Return the mean distance [m] between two contours as seen from above.

    It is the area between them over their mean length.
    """
    between = abs(_area(outer) - _area(inner))
    return 2.0 * between / float(along_contour(outer[:, :2])[-1] + along_contour(inner[:, :2])[-1])


def _corners(ring: FloatArray) -> IntArray:
    """Return the indices (c,) of the corners of a contour.

    A corner is the point with the largest turning angle within `CORNER_WINDOW`. Within this window the
    contour turns by at least `CORNER_ANGLE` more than in a window of equal length beside it. A small circle
    of few points therefore has no corners.
    """
    ahead = (np.roll(ring, -1, axis=0) - ring)[:, :2]
    previous = np.roll(ahead, 1, axis=0)
    turn = np.arctan2(previous[:, 0] * ahead[:, 1] - previous[:, 1] * ahead[:, 0], dots(previous, ahead))
    along = along_contour(ring)
    arc_lengths = np.concatenate([along[:-1] - along[-1], along[:-1], along[:-1] + along[-1]])
    cumulative_turn = np.concatenate([[0.0], np.cumsum(np.tile(turn, 3))])

    def turning_within(window: float) -> FloatArray:
        """Return by how much [rad] the contour turns within a distance [m] of each point."""
        low = np.searchsorted(arc_lengths, along[:-1] - window - 1e-12)
        high = np.searchsorted(arc_lengths, along[:-1] + window + 1e-12)
        return np.asarray(np.abs(cumulative_turn[high] - cumulative_turn[low]))

    turning, outer_turning = turning_within(CORNER_WINDOW), turning_within(OUTER_WINDOW_RATIO * CORNER_WINDOW)
    turning -= np.maximum(outer_turning - turning, 0.0) / (OUTER_WINDOW_RATIO - 1.0)
    corners: list[int] = []
    for index in np.flatnonzero(turning > CORNER_ANGLE)[
        np.argsort(-np.abs(turn[turning > CORNER_ANGLE]), kind="stable")
    ]:
        distance = np.abs(along[corners] - along[index])
        if not len(distance) or np.minimum(distance, along[-1] - distance).min() > 2.0 * CORNER_WINDOW:
            corners.append(int(index))
    return np.array(sorted(corners), dtype=np.int64)


def _snap_corners(at: FloatArray, lines: IntArray, max_distance: float) -> tuple[FloatArray, IntArray]:
    """Round the positions of corners to integers, and move them to existing lines of corners nearby.

    Args:
        at: Positions (c,) of the corners of one contour.
        lines: Positions of the lines of corners of previous contours.
        max_distance: Maximum distance, in positions.

    Returns:
        Integer positions (c,), and all lines of corners including new ones.
    """
    snapped = np.round(at)
    for index, position in enumerate(at):
        distance = (lines - position + 0.5 * POSITIONS_AROUND) % POSITIONS_AROUND - 0.5 * POSITIONS_AROUND
        if len(distance) and np.abs(distance).min() < max_distance:
            snapped[index] = position + distance[np.argmin(np.abs(distance))]
        else:
            lines = np.append(lines, int(snapped[index]) % POSITIONS_AROUND)
    return np.round(snapped), lines


def along_contour(ring: FloatArray) -> FloatArray:
    """Return the arc length (k + 1,) [m] of a closed contour at each point, and back at the first one."""
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
    """Return the distance [m] of a point to a contour (k, 2), and the nearest position as a point index."""
    ahead = np.roll(ring, -1, axis=0) - ring
    fraction = np.clip(dots(point - ring, ahead) / np.maximum(dots(ahead, ahead), 1e-30), 0.0, 1.0)
    distance = lengths(ring + fraction[:, None] * ahead - point)
    index = int(np.argmin(distance))
    return float(distance[index]), float(index + fraction[index]) % len(ring)
