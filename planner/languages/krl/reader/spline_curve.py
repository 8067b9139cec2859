"""Bounds the deviation of a spline block's curve from the straight segments between its points.

The controller's rule for SPL is not published, so the bound covers a family of curves. Known facts of SPL
(KSS 8.x, docs/krl.md): the curve goes through every point, is of degree five from one point to the next, and
its shape at a point depends on two neighbours on each side. The family contains all curves with these
properties that satisfy the conditions below. None of this was observed on a controller.

Poses are six numbers: the TCP's position in the base, and the rotation as a rotation vector in the tool's
axes at the start of the segment, times ``ROTATION_LEVER_M_PER_RAD`` [m/rad]. c_k is the step of segment k,
which has the knot interval g_k. With d_k = c_k / g_k and s_k = d_k - d_(k-1), a curve of the family on
segment i, for u from 0 to 1, is the quintic Hermite form

    x(u) = u c_i + g_i (H1(u) (V_i - d_i) + H4(u) (V_(i+1) - d_i)) + g_i^2 (H2(u) A_i + H3(u) A_(i+1))

    H1 = u - 6u^3 + 8u^4 - 3u^5      H2 = u^2/2 - 3u^3/2 + 3u^4/2 - u^5/2
    H4 = -4u^3 + 7u^4 - 3u^5         H3 = u^3/2 - u^4 + u^5/2

(the Hermite interpolant of degree 5, E. Hairer and G. Wanner, Analysis by Its History, II.2; it is unique,
as six conditions have one solution). At each point, and independently on its two sides:

- V_i is between the adjacent slopes, plus at most OUTER_FRACTION of the two outer changes of slope:
  V_i = (1 - t) d_(i-1) + t d_i + a s_(i-1) + b s_(i+1), t in [0, 1], |a|, |b| <= OUTER_FRACTION;
- A_i = (p s_(i-1) + q s_i + r s_(i+1)) 2 / (g_(i-1) + g_i), |p| + |q| + |r| <= MAX_BEND_WEIGHT, each s_k
  with its own 2 / (g_(k-1) + g_k);
- knots: each g_k / g_i is between 1 and the ratio of the lengths (uniform, by chord length, centripetal, or
  anything in between): the path of a spline does not depend on its speed;
- at the two ends of the block V is the one adjacent slope, plus at most END_FRACTION instead of
  OUTER_FRACTION (one-sided differences), and A is at most the one adjacent change of slope; changes of slope
  that would need a neighbour beyond an end are 0. As the arm stands there, V and A together may be any
  fraction of that, from all to nothing.

Members of the family are, among others, Catmull-Rom and finite differences with 3 and with 5 even points (a
= -b = 1/12, A: -1/12, 7/6, -1/12), Akima's (t by weights), natural minimum-jerk splines of five even points
(a = 0.103, A: -0.175, 1.35, -0.175), and flat points (A = 0). The speed between points is bounded by the
members with knots by time that are at rest, V = A = 0, at the block's ends.

The bound: x(u) is linear in V and A. Its part across c_i is therefore at most the sum of the |H| times the
largest parts across of V and A, which are at corners of the family. Along c_i an interval bounds by how much
the curve may overrun its ends. The overrun deviates from the next segment, within that segment's length, by
the difference of their directions over this distance, and by all of it if there is no next segment. Suprema
over u are taken on a grid, with a reserve for the values between its points. The position of the curve along
its segment is not bounded, because it does not deviate from the path. Segments rotate by MAX_ROTATION_RAD at
most: the error of adding rotation vectors as numbers is then of third order, and smaller than the reserve of
the grid factor.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, log_rotation

ROTATION_LEVER_M_PER_RAD: Final = 0.1
"""Lever arm that converts rotations to lengths [m/rad]."""
OUTER_FRACTION: Final = 0.125
"""Maximum fraction of the outer changes of slope in V_i."""
MAX_BEND_WEIGHT: Final = 2.0
"""Bound on the sum of the weights of the changes of slope in A_i."""
END_FRACTION: Final = 0.5
"""Maximum fraction of the next change of slope in V at an end of a block."""
MAX_ROTATION_RAD: Final = 0.1
"""Maximum rotation of a segment [rad]."""
_GRID: Final = np.linspace(0.0, 1.0, 257)
"""Curve parameters, from 0 to 1, at which curves are bounded."""
_GRID_FACTOR: Final = 1.002
"""Upper bound on the ratio of the maximum between grid points to that on the grid."""
_MAX_SECOND_DERIVATIVE: Final = 4.0
"""Upper bound on the second derivatives of H1 and H4; those of H2 and H3 do not exceed 1."""

_U = _GRID
"""The grid, with the symbol of the formulas."""
_H1 = _U - 6 * _U**3 + 8 * _U**4 - 3 * _U**5
"""Quintic Hermite form of the slope at the start."""
_H2 = (_U**2 - 3 * _U**3 + 3 * _U**4 - _U**5) / 2
"""Quintic Hermite form of the second derivative at the start."""
_H3 = (_U**3 - 2 * _U**4 + _U**5) / 2
"""Quintic Hermite form of the second derivative at the end."""
_H4 = -4 * _U**3 + 7 * _U**4 - 3 * _U**5
"""Quintic Hermite form of the slope at the end."""
HERMITE_FORMS: Final = np.stack([_H1, _H4, _H2, _H3])
"""Weights of V_i, V_(i+1), A_i, A_(i+1) on the grid, (4, G)."""
HERMITE_RATES: Final = np.stack(
    [
        1 - 18 * _U**2 + 32 * _U**3 - 15 * _U**4,
        -12 * _U**2 + 28 * _U**3 - 15 * _U**4,
        (2 * _U - 9 * _U**2 + 12 * _U**3 - 5 * _U**4) / 2,
        (3 * _U**2 - 8 * _U**3 + 5 * _U**4) / 2,
    ]
)
"""Derivatives of these weights by the curve parameter u, (4, G)."""


@dataclasses.dataclass(frozen=True)
class SplineCurveBounds:
    """Bounds on the N segments of a block, for every curve of the family.

    Attributes:
        deviation: Deviation from the straight segment, (N,) [m]; rotations are times
            ``ROTATION_LEVER_M_PER_RAD``.
        translation: Its translational part, (N,) [m].
        rotation: Its rotational part, (N,) [rad].
        speed: Speed of the TCP, (N,) [m/s].
        speed_change: Difference of the velocity from its mean on the segment, (N,) [m/s], rotations times
            ``ROTATION_LEVER_M_PER_RAD``.
    """

    deviation: FloatArray
    translation: FloatArray
    rotation: FloatArray
    speed: FloatArray
    speed_change: FloatArray


def bound_curves(pose: FloatArray, duration: FloatArray) -> SplineCurveBounds:
    """Bound the deviation and the speed of all curves of the family on a block.

    The proof uses the bounds in place of the controller's unknown curve. For the deviation each ratio of knot
    intervals is between 1 and that of the lengths of the segments. For the speed the knot intervals are
    proportional to the times, and the arm is at rest at both ends of the block.

    Args:
        pose: Points in the base, (N + 1, 4, 4) [m].
        duration: Times of the segments, (N,) [s].
    """
    step = segment_steps(pose)
    times = _neighbours(duration)
    missing = times == 0.0
    ratio = duration[:, None] / np.where(missing, duration[:, None], times)
    size = np.linalg.norm(step, axis=2)
    length = np.maximum(size[:, 2:3], 1e-12)
    length_ratio = np.where(size > 1e-12, length / np.maximum(size, 1e-12), 1.0)
    deviation, translation, rotation = _deviations(
        step, np.minimum(1.0, length_ratio), np.maximum(1.0, length_ratio), missing
    )
    in_time = _term_bounds(step, ratio, ratio, missing).at_rest(missing)
    tcp = _term_bounds(step[:, :, :3], ratio, ratio, missing).at_rest(missing)
    return SplineCurveBounds(
        deviation,
        translation,
        rotation / ROTATION_LEVER_M_PER_RAD,
        tcp.rate() / duration,
        in_time.change() / duration,
    )


def _deviations(
    step: FloatArray, min_ratio: FloatArray, max_ratio: FloatArray, missing: BoolArray
) -> tuple[FloatArray, ...]:
    """Return the deviations of curves in all six numbers, in position, and in rotation, (N,) [m] each.

    At an end of the block the larger one of two cases counts: V and A at full size, or the arm at rest with
    both zero. A segment that rotates by more than ``MAX_ROTATION_RAD`` has an infinite deviation, unless it
    is the whole block.

    Args:
        step: Five steps for each segment, (N, 5, 6) [m], see :func:`segment_steps`.
        min_ratio: Smallest ratio of the segment's knot interval to that of each step, (N, 5).
        max_ratio: Largest such ratio, (N, 5).
        missing: Steps that are beyond the ends of the block, (N, 5).
    """
    rotates_too_far = np.linalg.norm(step[:, 2, 3:], axis=1) > ROTATION_LEVER_M_PER_RAD * MAX_ROTATION_RAD
    # steps 1 and 3 are the segments directly before and after: both are missing if the segment is the block
    unbounded = rotates_too_far & ~missing[:, 1:4:2].all(axis=1)
    out = []
    for components in (slice(0, 6), slice(0, 3), slice(3, 6)):
        curve = _term_bounds(step, min_ratio, max_ratio, missing, components)
        cases = [curve, *(curve.at_rest(missing, ends) for ends in ((1,), (3,), (1, 3)))]
        out.append(
            np.where(
                unbounded,
                np.inf,
                np.max([_max_deviation(curve_bounds, step, components) for curve_bounds in cases], axis=0),
            )
        )
    return tuple(out)


def segment_steps(pose: FloatArray) -> FloatArray:
    """Return for each segment five steps (N, 5, 6) [m]: of the two previous ones, itself, and the two next.

    A step is a translation and a rotation vector times ``ROTATION_LEVER_M_PER_RAD``, in the tool's axes at
    the start of the middle segment. Steps of missing neighbours are 0.

    Args:
        pose: Points in the base, (N + 1, 4, 4) [m].
    """
    count = len(pose) - 1
    index = np.clip(np.arange(count)[:, None] + np.arange(-2, 4), 0, count)
    neighbour_poses = pose[index]
    rotation = log_rotation(np.swapaxes(pose[:-1, None, :3, :3], 2, 3) @ neighbour_poses[..., :3, :3])
    coordinates = np.concatenate([neighbour_poses[..., :3, 3], ROTATION_LEVER_M_PER_RAD * rotation], axis=2)
    return np.diff(coordinates, axis=1)


def _neighbours(values: FloatArray) -> FloatArray:
    """Return for each of N values the two previous ones, itself and the two next, (N, 5); 0 if missing."""
    padded = np.concatenate([np.zeros(2), values, np.zeros(2)])
    return np.stack([padded[k : k + len(values)] for k in range(5)], axis=1)


@dataclasses.dataclass(frozen=True)
class _TermBounds:
    """Bounds on V_i, V_(i+1), A_i, A_(i+1) of N segments, by their parts across and along the segment.

    V is a slope times the segment's knot interval, less the segment's own step; A is times its square.

    Attributes:
        across: Largest parts across the segment, (N, 4) [m].
        low: Smallest parts along the segment, relative to its length, (N, 4) [-].
        high: Largest parts along it, relative to its length, (N, 4) [-].
        size: Length of the segment, (N,) [m].
    """

    across: FloatArray
    low: FloatArray
    high: FloatArray
    size: FloatArray

    def at_rest(self, missing: BoolArray, ends: tuple[int, ...] = (1, 3)) -> "_TermBounds":
        """Return the bounds with the arm at rest, V = A = 0, at one or both ends of the block.

        Args:
            missing: Neighbours that are beyond the ends of the block, (N, 5).
            ends: 1 for the start of the block, 3 for its end: the index of the step that is missing there.
        """
        across, low, high = self.across.copy(), self.low.copy(), self.high.copy()
        for end in ends:
            end_segments = np.flatnonzero(missing[:, end])
            # V = 0 is -1 along the segment, because its own step is subtracted
            for k, value in ((end // 2, -1.0), (2 + end // 2, 0.0)):
                across[end_segments, k], low[end_segments, k], high[end_segments, k] = 0.0, value, value
        return _TermBounds(across, low, high, self.size)

    def along(self, forms: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the smallest and largest sums of the terms along the segment, (N, G) each; forms: (4, G)."""
        up, down = np.maximum(forms, 0.0), np.minimum(forms, 0.0)
        return self.low @ up + self.high @ down, self.high @ up + self.low @ down

    def rate(self) -> FloatArray:
        """Return the maximum (N,) [m] of |dx/du|, which includes the segment's own step."""
        low, high = self.along(HERMITE_RATES)
        along_rate = np.maximum(np.abs(1.0 + low), np.abs(1.0 + high)) * self.size[:, None]
        return np.asarray(
            _GRID_FACTOR * np.hypot(along_rate, self.across @ np.abs(HERMITE_RATES)).max(axis=1)
        )

    def change(self) -> FloatArray:
        """Return the maximum (N,) [m] of the difference between dx/du and the segment's own step."""
        low, high = self.along(HERMITE_RATES)
        along_change = np.maximum(np.abs(low), np.abs(high)) * self.size[:, None]
        return np.asarray(
            _GRID_FACTOR * np.hypot(along_change, self.across @ np.abs(HERMITE_RATES)).max(axis=1)
        )


def _max_deviation(curve: _TermBounds, step: FloatArray, components: slice) -> FloatArray:
    """Return the maximum deviation (N,) [m] of a curve from the straight segments.

    It is the deviation across the segment plus that of an overrun of its ends, both in ``components`` of the
    steps (N, 5, D).
    """
    size = np.linalg.norm(step, axis=2)
    unit = step / np.maximum(size, 1e-12)[:, :, None]
    across = _GRID_FACTOR * (curve.across @ np.abs(HERMITE_FORMS)).max(axis=1)
    low, high = curve.along(HERMITE_FORMS)
    second_derivative = np.maximum(np.abs(curve.low), np.abs(curve.high)) @ np.array(
        [_MAX_SECOND_DERIVATIVE, _MAX_SECOND_DERIVATIVE, 1.0, 1.0]
    )
    between_grid_points = second_derivative * (_U[1] - _U[0]) ** 2 / 8.0
    overrun_deviation = np.zeros(len(step))
    # k is the neighbour into which the curve overruns: the previous segment (1) or the next one (3)
    for k, overrun in ((1, -(_U + low)), (3, _U + high - 1.0)):
        beyond = (np.maximum(overrun.max(axis=1), 0.0) + between_grid_points) * size[:, 2]
        ends_in_neighbour = beyond <= size[:, k]
        direction_change = np.linalg.norm((unit[:, k] - unit[:, 2])[:, components], axis=1)
        overrun_deviation = np.maximum(
            overrun_deviation,
            beyond
            * np.where(ends_in_neighbour, direction_change, np.linalg.norm(unit[:, 2, components], axis=1)),
        )
    return np.asarray(across + overrun_deviation)


def _term_bounds(
    step: FloatArray,
    min_ratio: FloatArray,
    max_ratio: FloatArray,
    missing: BoolArray,
    components: slice = slice(None),
) -> _TermBounds:
    """Return bounds on V and A at both ends of each segment, from the corners of the family.

    Args:
        step: Steps, (N, 5, D) [m].
        min_ratio: Smallest ratio g_i / g_k of the knot intervals of the segment i and of each step k, (N, 5).
        max_ratio: Largest such ratio, (N, 5).
        missing: Neighbours that are beyond the ends of the block, (N, 5).
        components: Components of D in which the parts across the segment are measured.
    """
    size = np.linalg.norm(step[:, 2], axis=1)
    direction = step[:, 2] / np.maximum(size, 1e-12)[:, None]
    along = np.einsum("nkd,nd->nk", step, direction)
    across = (step - along[:, :, None] * direction[:, None, :])[:, :, components]
    sizes_across = np.linalg.norm(across, axis=2)
    length = np.maximum(size, 1e-12)[:, None]
    x_low = np.minimum(min_ratio * along, max_ratio * along) / length
    x_high = np.maximum(min_ratio * along, max_ratio * along) / length
    # changes of slope s_k between neighbours k and k + 1: maximum over the corners of both knot intervals
    bend_across, bend_along = np.zeros((2, len(step), 4))
    for k, (first, second) in itertools.product(
        range(4), itertools.product((min_ratio, max_ratio), repeat=2)
    ):
        change = second[:, k + 1, None] * across[:, k + 1] - first[:, k, None] * across[:, k]
        bend_across[:, k] = np.maximum(bend_across[:, k], np.linalg.norm(change, axis=1))
        shift = np.abs(second[:, k + 1] * along[:, k + 1] - first[:, k] * along[:, k]) / length[:, 0]
        bend_along[:, k] = np.maximum(bend_along[:, k], shift)
    has_both_neighbours = ~missing[:, 1:] & ~missing[:, :-1]
    bend_across, bend_along = bend_across * has_both_neighbours, bend_along * has_both_neighbours
    scale = 2.0 / (1.0 / max_ratio[:, :-1] + 1.0 / max_ratio[:, 1:])
    parts, lows, highs = [], [], []
    for k, (previous, following) in ((1, (1, 2)), (2, (2, 3))):  # V between segments k and k + 1
        outer = np.full((len(step), 2), OUTER_FRACTION)
        outer[missing[:, previous], 1] = END_FRACTION  # the block's first point: only the change after it
        outer[missing[:, following], 0] = END_FRACTION
        outer_across, outer_along = bend_across[:, [k - 1, k + 1]], bend_along[:, [k - 1, k + 1]]
        parts.append(
            np.maximum(
                max_ratio[:, previous] * sizes_across[:, previous],
                max_ratio[:, following] * sizes_across[:, following],
            )
            + (outer * outer_across).sum(axis=1)
        )
        outer_slope = (outer * outer_along).sum(axis=1)
        # at an end of the block the one adjacent segment takes the place of both
        first, second = (
            np.where(missing[:, side], other_side, side)
            for side, other_side in ((previous, following), (following, previous))
        )
        row = np.arange(len(step))
        lows.append(np.minimum(x_low[row, first], x_low[row, second]) - outer_slope - 1.0)
        highs.append(np.maximum(x_high[row, first], x_high[row, second]) + outer_slope - 1.0)
    for k in (0, 1):  # A at both ends: bounded by the three changes of slope around it
        weight = np.where(missing[:, 1 + 2 * k], 1.0, MAX_BEND_WEIGHT)
        parts.append(weight * (scale * bend_across)[:, k : k + 3].max(axis=1))
        max_along = weight * (scale * bend_along)[:, k : k + 3].max(axis=1)
        lows.append(-max_along)
        highs.append(max_along)
    across, low, high = (np.stack(columns, axis=1) for columns in (parts, lows, highs))
    return _TermBounds(across, low, high, size)
