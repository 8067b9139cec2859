"""Deviation of a tool from a claimed path of tips and axes, and its maximum speed at each position.

The tool must pass the points of the path in order, also where the path crosses itself, reverses, or rotates
the tool in place. The feed may change along a path.
"""

import dataclasses
import math
from bisect import bisect_left
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.milling.claims import MillsAlong
from planner.proof.replay.moves import PATH_ACCURACY_M

Row = list[float]
"""Coordinates x, y, z as Python numbers."""

AXIS_LEVER_M = 0.05
"""Length that converts rotation of the axis to distance along the path [m/rad]."""
SEARCH_DISTANCE_M = 0.05
"""Distance along the path within which the tool's position is searched [m]."""
WRITTEN_ROUNDING_M = 1e-7
"""Deviation [m] of positions in programs from their exact values: half of the last digit along each axis.

A corner that is rounded by the whole tolerance may deviate by this distance more.
"""
_MAX_PAIRS = 200_000
"""Maximum number of pairs of a point and a piece of a track in one array."""
_MAX_SAMPLES = 16_384
"""Maximum number of samples of a track that exist as Python numbers at once."""


@dataclasses.dataclass(frozen=True)
class PathDeviation:
    """Deviation of T samples of a track from a claimed path with K points.

    Attributes:
        distance: Distance of the tip from the path (T,) [m].
        angle: Angle between the axis and the required one (T,) [rad].
        missed_count: Number of points of the path that the track does not pass, or not in order.
        position: Position of each sample along the path (T,) [m], never decreasing. Rotations count with the
            lever ``AXIS_LEVER_M``.
        point_positions: Position of each point along the path (K,) [m].
    """

    distance: FloatArray
    angle: FloatArray
    missed_count: int
    position: FloatArray
    point_positions: FloatArray


def match_path(
    claim: MillsAlong, tip: FloatArray, axis: FloatArray, sample_rows: IntArray | None = None
) -> PathDeviation:
    """Compare a track with a claimed path, and find the position of each sample along it.

    A stretch of the path leads from one of its points to the next. The search for a sample starts at the
    match of the previous sample. The sample is matched to the first stretch whose tolerances it keeps, or to
    the nearest of the stretches that follow as long as it keeps their tolerances. A sample that keeps no
    tolerance is compared with the nearest stretch, and the search for the next sample starts at the same
    position as its own.

    Each point of the path that the match passes between two samples must be near the track between these
    samples, or between the adjacent ones: at a corner the point may be nearer to the leg that the tool has
    left.

    Args:
        claim: Claimed path.
        tip: Tips of the track (N, 3) [m]; it is straight between samples.
        axis: Axes of the track (N, 3).
        sample_rows: Indices (T,) of the samples to compare, None for all.
    """
    path = _ClaimedPath(claim)
    rows = np.arange(len(tip)) if sample_rows is None else sample_rows
    count = len(rows)
    distance, angle, position = np.empty(count), np.empty(count), np.empty(count)
    passed = np.zeros(len(claim.tip), dtype=np.int64)
    stretch, fraction = 0, 0.0
    for i, (sample_tip, sample_axis) in enumerate(_as_numbers(tip, axis, rows)):
        match = path.match(sample_tip, sample_axis, stretch, fraction)
        distance[i], angle[i] = match.distance, match.angle
        if match.cost > 1.0:
            position[i] = path.position(stretch, fraction)
            continue
        passed[stretch + 1 : match.stretch + 1] = i
        stretch, fraction = match.stretch, match.fraction
        position[i] = path.position(stretch, fraction)
    passed[stretch + 1 :] = count
    # A tool that reverses sharply stays matched to the stretch that it leaves until it is out of tolerance.
    advances = np.flatnonzero(np.append(True, np.diff(position) > 0.0))
    last_waits = advances[np.searchsorted(advances, np.maximum(passed - 1, 0), side="right") - 1]
    low = rows[np.maximum(last_waits - 1, 0)]
    high = rows[np.minimum(passed + 1, count - 1)]
    missed = _count_missed(claim, tip, axis, low, high)
    return PathDeviation(distance, angle, missed, position, np.array(path.along))


def _as_numbers(tip: FloatArray, axis: FloatArray, rows: IntArray) -> Iterator[tuple[Row, Row]]:
    """Yield tip and axis of each of the samples ``rows`` (T,) as Python numbers.

    They are converted in batches, because they take ten times the memory of arrays.
    """
    for first in range(0, len(rows), _MAX_SAMPLES):
        batch = rows[first : first + _MAX_SAMPLES]
        yield from zip(tip[batch].tolist(), axis[batch].tolist(), strict=True)


def _count_missed(claim: MillsAlong, tip: FloatArray, axis: FloatArray, low: IntArray, high: IntArray) -> int:
    """Return the number of points of the path that the track does not pass, or not in order.

    Point k has to be passed between the samples ``low[k]`` and ``high[k]``, and not before the previous
    points. The order matters, because a step back that the tool leaves out is near the track, too.
    """
    # reached: position on the track, as the index of a sample plus a fraction, at which the last point was
    # passed
    missed, reached = 0, 0.0
    ends = np.cumsum(np.maximum(high - low, 1))
    start = 0
    while start < len(low):
        stop = max(start + 1, int(np.searchsorted(ends, ends[start] + _MAX_PAIRS)))
        points, first, last = _near_stretches(claim, tip, axis, low[start:stop], high[start:stop], start)
        bounds = np.searchsorted(points, np.arange(start, stop + 1))
        first_positions, last_positions = first.tolist(), last.tolist()
        for start_row, end in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
            passing = next((k for k in range(start_row, end) if last_positions[k] >= reached), None)
            if passing is None:
                missed += 1
            else:
                reached = max(reached, first_positions[passing])
        start = stop
    return missed


def _near_stretches(
    claim: MillsAlong, tip: FloatArray, axis: FloatArray, low: IntArray, high: IntArray, start: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the stretches of a track that are near points of a path, from that with index ``start`` on.

    Each of these K points is searched between the samples ``low`` and ``high`` (K,).

    Returns:
        M stretches, sorted by point and then along the track: the index of the point (M,), and start and end
        (M,) as the index of a sample plus the fraction of the way to the next sample.
    """
    number = np.maximum(high - low, 1)
    row_starts = np.cumsum(number) - number
    rows = np.repeat(np.arange(len(low)), number)
    piece = low[rows] + np.arange(len(rows)) - row_starts[rows]
    next_piece = np.minimum(piece + 1, len(tip) - 1)
    points = start + rows
    distance = passing_tolerance(claim)
    ends = [
        _fractions_within(tip[piece] - claim.tip[points], tip[next_piece] - tip[piece], distance),
        _fractions_within(axis[piece] - claim.axis[points], axis[next_piece] - axis[piece], claim.turn),
    ]
    first, last = np.maximum(ends[0][0], ends[1][0]), np.minimum(ends[0][1], ends[1][1])
    is_near = np.flatnonzero(first <= last)
    return points[is_near], piece[is_near] + first[is_near], piece[is_near] + last[is_near]


def _fractions_within(offset: FloatArray, step: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return the first and last fraction (M,) between which steps (M, 3) are within a distance of points.

    Each step starts at its ``offset`` (M, 3) from the point. The fractions are infinity and -infinity if no
    part of it is near enough.
    """
    square = np.maximum((step * step).sum(axis=1), 1e-30)
    middle = -(offset * step).sum(axis=1) / square
    nearest = offset + middle[:, None] * step
    margin = (radius * radius - (nearest * nearest).sum(axis=1)) / square
    half = np.sqrt(np.maximum(margin, 0.0))
    first, last = np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)
    is_empty = (margin < 0.0) | (first > last)
    return np.where(is_empty, np.inf, first), np.where(is_empty, -np.inf, last)


def passing_tolerance(claim: MillsAlong) -> float:
    """Return the distance [m] within which a tool has to pass each point of its path.

    A rounded corner that keeps the tolerance from both legs has the distance sqrt(2) times the tolerance from
    the corner point at 90 degrees. At wider corners it is less, and at sharper ones, where it would be more,
    arms stop. The tolerance is at least the accuracy with which arms are assumed to follow the legs. The
    rounding of written positions is added.
    """
    return math.sqrt(2.0) * max(claim.tolerance, PATH_ACCURACY_M) + WRITTEN_ROUNDING_M


def rows_to_check(tip: FloatArray, axis: FloatArray, tolerance: float) -> IntArray:
    """Return the indices (K,) of the samples at which a track is compared with the claim.

    They are two tolerances apart, and include both ends. Between them a tool deviates by at most one
    tolerance more.

    Args:
        tip: Tips (T, 3) [m].
        axis: Axes (T, 3).
        tolerance: Tolerance [m].
    """
    if len(tip) < 2:
        return np.arange(len(tip))
    lengths = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    lengths = np.maximum(lengths, AXIS_LEVER_M * np.linalg.norm(np.diff(axis, axis=0), axis=1))
    number = np.floor(np.append(0.0, np.cumsum(lengths)) / (2.0 * tolerance))
    # The first sample after each mark, and the last one before it if a mark is skipped.
    marks = np.diff(number)
    return np.flatnonzero(np.append(True, marks > 0.0) | np.append(marks > 1.0, True))


class _PathMatch(NamedTuple):
    """Match of a sample with a path.

    Attributes:
        stretch: Index of the stretch.
        fraction: Position on the stretch, from 0 to 1.
        distance: Distance [m] of the sample from this position.
        angle: Angle [rad] between the axis of the sample and the required one.
        cost: The larger one of distance and angle, each as a fraction of its limit.
    """

    stretch: int
    fraction: float
    distance: float
    angle: float
    cost: float


class _ClaimedPath:
    """A claimed path: from point to point, the tip moves straight and the axis rotates evenly."""

    def __init__(self, claim: MillsAlong) -> None:
        self.claim = claim
        self.tip, self.axis = claim.tip, claim.axis
        self.step, axis_step = np.diff(claim.tip, axis=0), np.diff(claim.axis, axis=0)
        square = np.maximum((self.step * self.step).sum(axis=1), 1e-24)
        axis_square = np.maximum((axis_step * axis_step).sum(axis=1), 1e-24)
        angle = 2.0 * np.arcsin(np.clip(0.5 * np.sqrt(axis_square), 0.0, 1.0))
        # Samples are matched one by one with few stretches each, so Python numbers are faster than arrays.
        self.along: Row = np.append(0.0, np.cumsum(np.sqrt(square + AXIS_LEVER_M**2 * axis_square))).tolist()
        self.points: list[tuple[Row, Row]] = list(zip(claim.tip.tolist(), claim.axis.tolist(), strict=True))
        self.steps: list[Row] = self.step.tolist()
        self.axis_steps: list[Row] = axis_step.tolist()
        half_angle, whole_angle = np.maximum(0.5 * angle, 1e-12), np.maximum(angle, 1e-9)
        # Squares of the step and of the change of the axis; half of the rotation and all of it, with sines.
        sizes = [square, axis_square, half_angle, np.sin(half_angle), whole_angle, np.sin(whole_angle)]
        self.sizes: list[Row] = np.stack(sizes, axis=1).tolist()

    def position(self, stretch: int, fraction: float) -> float:
        """Return the position along the path [m] of a fraction of a stretch."""
        return self.along[stretch] + fraction * (self.along[stretch + 1] - self.along[stretch])

    def match(self, tip: Row, axis: Row, stretch: int, fraction: float) -> _PathMatch:
        """Match a sample with the path from ``fraction`` of ``stretch`` on, as :func:`match_path` describes.

        If the sample keeps no tolerance, the match is the nearest stretch within the search distance.
        """
        current = self.position(stretch, fraction)
        end = bisect_left(self.along, current + SEARCH_DISTANCE_M + 20.0 * self.claim.tolerance)
        end = min(max(end, stretch + 1), len(self.step))
        candidate = best = self._match_stretch(tip, axis, stretch, fraction)
        for number in range(stretch + 1, end):
            if candidate.cost <= 1.0:
                break
            candidate = self._match_stretch(tip, axis, number)
            best = candidate if candidate.cost < best.cost else best
        return self._advance(tip, axis, candidate, end) if candidate.cost <= 1.0 else best

    def _advance(self, tip: Row, axis: Row, first: _PathMatch, end: int) -> _PathMatch:
        """Return the nearest match among the stretch of ``first`` and those that follow, up to ``end``.

        The search ends where the sample does not keep the tolerances of a stretch, or of the point before it.
        Of equally near matches the first one is returned.
        """
        matches = [first]
        for number in range(first.stretch + 1, end):
            candidate = self._match_stretch(tip, axis, number)
            if candidate.cost > 1.0 or self._cost(*_deviation(tip, axis, *self.points[number])) > 1.0:
                break
            matches.append(candidate)
        min_cost = min(candidate.cost for candidate in matches)
        return next(candidate for candidate in matches if candidate.cost <= min_cost + 1e-6)

    def _match_stretch(self, tip: Row, axis: Row, number: int, min_fraction: float = 0.0) -> _PathMatch:
        """Return the nearest match of a sample with a stretch, not before ``min_fraction`` of it.

        One candidate is nearest to the tip, another one to the axis, because tip or axis may stand still on
        the stretch. The better candidate is used.
        """
        start, axis_start = self.points[number]
        square, axis_square, half_angle, sine_of_half, _, _ = self.sizes[number]
        by_tip = _dot(_subtract(tip, start), self.steps[number]) / square
        chord = min(max(_dot(_subtract(axis, axis_start), self.axis_steps[number]) / axis_square, 0.0), 1.0)
        # Fraction of the rotation from the fraction of its chord.
        by_axis = 0.5 + 0.5 * math.asin((2.0 * chord - 1.0) * sine_of_half) / half_angle
        first, second = (max(min(max(guess, 0.0), 1.0), min_fraction) for guess in (by_tip, by_axis))
        match = self._compare(tip, axis, number, first)
        if second == first:
            return match
        other = self._compare(tip, axis, number, second)
        return other if other.cost < match.cost else match

    def _compare(self, tip: Row, axis: Row, number: int, fraction: float) -> _PathMatch:
        """Compare a sample with a position on a stretch."""
        start, axis_start = self.points[number]
        axis_end, step = self.points[number + 1][1], self.steps[number]
        *_, whole_angle, sine = self.sizes[number]
        # Weights of the spherical interpolation between the axes.
        start_weight = math.sin((1.0 - fraction) * whole_angle) / sine
        end_weight = math.sin(fraction * whole_angle) / sine
        distance, angle = _deviation(
            tip,
            axis,
            _combine(start, 1.0, step, fraction),
            _combine(axis_start, start_weight, axis_end, end_weight),
        )
        return _PathMatch(number, fraction, distance, angle, self._cost(distance, angle))

    def _cost(self, distance: float, angle: float) -> float:
        """Return the larger one of distance [m] and angle [rad], each as a fraction of its limit."""
        return max(distance / (self.claim.tolerance + WRITTEN_ROUNDING_M), angle / self.claim.turn)


def _deviation(tip: Row, axis: Row, point: Row, required_axis: Row) -> tuple[float, float]:
    """Return the distance [m] and angle [rad] between a sample and a position with its required axis."""
    return math.dist(tip, point), 2.0 * math.asin(min(0.5 * math.dist(axis, required_axis), 1.0))


def _subtract(a: Row, b: Row) -> Row:
    return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]


def _combine(a: Row, a_weight: float, b: Row, b_weight: float) -> Row:
    return [
        a_weight * a[0] + b_weight * b[0],
        a_weight * a[1] + b_weight * b[1],
        a_weight * a[2] + b_weight * b[2],
    ]


def _dot(a: Row, b: Row) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


FEED_TOLERANCE_FACTOR = 2.0
"""Distance along the path, as a factor of the tolerance, within which feeds before and after a sample also
count.

Corners are rounded, and the position along the path is not known more accurately.
"""


def max_feeds(claim: MillsAlong, sample_rows: IntArray, deviation: PathDeviation, count: int) -> FloatArray:
    """Return the maximum feed (T - 1,) [m/s] from each of T samples to the next.

    It is the highest feed of all stretches of the path on which the tool may be: from the matched sample
    before the move to the one after it, and `FEED_TOLERANCE_FACTOR` tolerances to both sides.

    Args:
        claim: Claimed path.
        sample_rows: Indices (K,) of the samples that were matched.
        deviation: Result of :func:`match_path` for these samples.
        count: Number T of samples.
    """
    previous = np.clip(
        np.searchsorted(sample_rows, np.arange(count - 1), side="right") - 1, 0, len(sample_rows) - 1
    )
    following = np.clip(
        np.searchsorted(sample_rows, np.arange(1, count), side="left"), 0, len(sample_rows) - 1
    )
    distance = FEED_TOLERANCE_FACTOR * claim.tolerance
    last = len(deviation.point_positions) - 2
    first = (
        np.searchsorted(deviation.point_positions, deviation.position[previous] - distance, side="right") - 1
    )
    end = (
        np.searchsorted(deviation.point_positions, deviation.position[following] + distance, side="left") - 1
    )
    first = np.clip(first, 0, last)
    return range_maxima(claim.feed[1:], first, np.clip(end, first, last))


def range_maxima(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the maximum (M,) of the values from ``first`` (M,) to ``last`` (M,), both included.

    A sparse table of the maxima over 1, 2, 4 ... values is used.

    Args:
        values: Values (N,).
        first: First indices (M,).
        last: Last indices (M,).
    """
    level = np.floor(np.log2(last - first + 1)).astype(np.int64)
    out, table = np.empty(len(first)), values
    for k in range(int(level.max(initial=0)) + 1):
        rows = np.flatnonzero(level == k)
        out[rows] = np.maximum(table[first[rows]], table[last[rows] - (1 << k) + 1])
        table = np.maximum(table[: -(1 << k) or None], table[1 << k :]) if len(table) > 1 << k else table
    return out
