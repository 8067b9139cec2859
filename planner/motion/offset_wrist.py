"""Inverse kinematics of arms with an offset wrist, batched over poses.

These arms have six axes. Axes 1 to 3 are those of an ortho-parallel arm, axes 4 and 5 meet, and axis 6 passes
at an offset from that point. Examples are ABB's GoFa and Fanuc's CRX.

No closed form exists, so one angle is searched. Theta 6 determines the point where axes 4 and 5 meet. Given
that point, theta 1 (two solutions: shoulder) and theta 2 and 3 (two solutions: elbow) follow in closed form.
One condition remains:

    f(theta 6) = z4 . y5 = 0, axis 5 is perpendicular to axis 4.

For each of the four combinations f is smooth in theta 6, up to the ends of the elbow's reach, where two
combinations take the same value. f is sampled at :data:`SAMPLE_ANGLES` angles and at these ends, and densely
where the wrist centre passes close to axis 1, because theta 1 changes rapidly there. Sign changes are
refined, and so are local minima of |f| that may hold two roots. A pose has up to 16 solutions.

The branch number is 4 * (f rises) + 2 * shoulder + elbow + 8 * rank. f rises or falls as the determinant of
the Jacobian is positive or negative. A branch number therefore continues as long as the arm passes no
singularity and no stretched elbow. If several solutions share the first three, rank counts them, closest to
the wrist's centre line first. The rank is not a property of an arm in motion, so :func:`follow_branch`
follows a path from posture to posture.
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import OffsetParameters
from planner.cell.kinematics import flange_poses, form_jacobian
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, log_rotation

MAX_RANKS: Final = OffsetParameters.branches // 8
"""Number of solutions with the same direction, shoulder and elbow that have a branch each."""
SAMPLE_ANGLES: Final = 180
"""Number of angles of theta 6 at which the condition is sampled first."""
POSE_TOLERANCE: Final = 1e-10
"""Maximum pose error [m and rad] of a solution. Solutions with a larger error are refined until they meet
it.
"""
POSE_BATCH_SIZE: Final = 256
"""Number of poses that are processed together, which bounds the memory for samples."""
_MAX_ROOT_STEPS: Final = 60
"""Maximum number of iterations of the root search between two angles."""


def inverse_kinematics(form: OffsetParameters, flange: FloatArray, branches: Sequence[int]) -> FloatArray:
    """Compute the joint angles of flange poses on given branches.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the base.
        branches: Branch numbers.

    Returns:
        Joint angles (..., len(branches), 6) [rad], not wrapped into limits; NaN where no solution exists.
    """
    poses = form.inner(flange).reshape(-1, 4, 4)
    slot_by_branch = np.full(8 * MAX_RANKS, -1)
    slot_by_branch[list(branches)] = np.arange(len(branches))
    out = np.full((len(poses), len(branches), 6), np.nan)
    for first in range(0, len(poses), POSE_BATCH_SIZE):
        row, branch, theta = _all_solutions(form, poses[first : first + POSE_BATCH_SIZE])
        selected = np.flatnonzero(slot_by_branch[branch] >= 0)
        out[first + row[selected], slot_by_branch[branch[selected]]] = (
            theta[selected] + form.offsets
        ) * form.signs
    return out.reshape(*flange.shape[:-2], len(branches), 6)


class _WristCondition:
    """The wrist condition f at poses (P, 4, 4), or at a selection of them.

    The poses are those of the form's inner flange (:meth:`OffsetParameters.inner`). In all methods ``angle``
    are values of theta 6, (P, K) or (K,) [rad]. ``shoulder`` is 1 in front of axis 1 and -1 behind it, and
    ``elbow`` is 1 or -1.
    """

    def __init__(self, form: OffsetParameters, pose: FloatArray) -> None:
        self.form = form
        self.ex, self.ey = pose[:, :3, 0].T[..., None], pose[:, :3, 1].T[..., None]
        self.wrist_base = (pose[:, :3, 3] - form.c4 * pose[:, :3, 2] - np.array([0.0, 0.0, form.c1])).T[
            ..., None
        ]
        self.forearm = float(np.hypot(form.a2, form.c3))

    def at_poses(self, rows: IndexArray) -> "_WristCondition":
        """Return the condition at some of the poses, which may repeat."""
        subset = object.__new__(_WristCondition)
        subset.form, subset.forearm = self.form, self.forearm
        subset.ex, subset.ey, subset.wrist_base = self.ex[:, rows], self.ey[:, rows], self.wrist_base[:, rows]
        return subset

    def components(
        self, angle: FloatArray, shoulder: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the components of the condition.

        Returns:
            Three arrays (P, K). The first is the cosine of the angle between the line from elbow to wrist
            centre and the line from shoulder to wrist centre; beyond 1 the wrist centre is out of reach. The
            others are the components of axis 5 along and across the line from shoulder to wrist centre, both
            rotated by the constant angle between axis 4 and the line from elbow to wrist centre.
        """
        p = self.form
        c, s = np.cos(angle), np.sin(angle)
        y = s * self.ex + c * self.ey
        centre = self.wrist_base - p.a3 * (c * self.ex - s * self.ey) - p.b3 * y
        x, side, up = centre
        # law of cosines in the triangle shoulder, elbow, wrist centre: cos = (d^2 + l^2 - c2^2) / (2 l d)
        with np.errstate(invalid="ignore", divide="ignore"):
            radius = shoulder * np.sqrt(x * x + side * side)
            axis5_radial = (x * y[0] + side * y[1]) / radius
            shoulder_x = radius - p.a1
            distance_squared = shoulder_x * shoulder_x + up * up
            distance = np.sqrt(distance_squared)
            cosine = (distance_squared + self.forearm**2 - p.c2**2) / (2.0 * self.forearm * distance)
            u, v = shoulder_x / distance, up / distance
        forearm_cos, forearm_sin = p.c3 / self.forearm, p.a2 / self.forearm
        # the line from elbow to wrist centre is inclined to axis 4 by atan2(a2, c3)
        along_forearm = forearm_cos * axis5_radial + forearm_sin * y[2]
        across_forearm = forearm_cos * y[2] - forearm_sin * axis5_radial
        return cosine, along_forearm * u + across_forearm * v, along_forearm * v - across_forearm * u

    def offset_from_axis1(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the offset (2, P, K) [m] of the wrist centre from axis 1, and its derivative by theta 6.

        The offset has the components x and y, in the plane perpendicular to axis 1.
        """
        p = self.form
        c, s = np.cos(angle), np.sin(angle)
        cos_terms = p.a3 * self.ex[:2] + p.b3 * self.ey[:2]
        sin_terms = p.b3 * self.ex[:2] - p.a3 * self.ey[:2]
        return np.asarray(self.wrist_base[:2] - c * cos_terms - s * sin_terms), np.asarray(
            s * cos_terms - c * sin_terms
        )

    def radial_rate(self, angle: FloatArray) -> FloatArray:
        """Return values (P, K) that are positive where the wrist centre moves away from axis 1.

        That is the motion as theta 6 grows.
        """
        offset, derivative = self.offset_from_axis1(angle)
        return np.asarray((offset * derivative).sum(axis=0))

    def reach_measure(self, angle: FloatArray, shoulder: FloatArray) -> FloatArray:
        """Return 1 - cosine^2 (P, K): positive where the wrist centre is within reach, negative outside."""
        return _reach_measure(self.components(angle, shoulder)[0])

    def value(self, angle: FloatArray, shoulder: FloatArray, elbow: FloatArray) -> FloatArray:
        """Return f (P, K). Out of reach, the term with the sine is 0, as at the end of the reach."""
        cosine, along, across = self.components(angle, shoulder)
        sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
        return np.asarray(cosine * along + elbow * sine * across)

    def joints(self, angle: FloatArray, shoulder: FloatArray, elbow: FloatArray) -> FloatArray:
        """Return theta 1 to 6 (P, 6) [rad] of each pose, for a root (P, 1) of f as ``angle``."""
        p = self.form
        c, s = np.cos(angle), np.sin(angle)
        x5, y5 = c * self.ex - s * self.ey, s * self.ex + c * self.ey
        x, side, up = self.wrist_base - p.a3 * x5 - p.b3 * y5
        radius = shoulder * np.sqrt(x * x + side * side)
        theta1 = np.arctan2(shoulder * side, shoulder * x)
        cosine = self.components(angle, shoulder)[0]
        line_angle = np.arctan2(radius - p.a1, up) + elbow * np.arccos(np.clip(cosine, -1.0, 1.0))
        theta2 = np.arctan2(
            radius - p.a1 - self.forearm * np.sin(line_angle), up - self.forearm * np.cos(line_angle)
        )
        tilt = line_angle - np.arctan2(p.a2, p.c3)
        c1, s1, ct, st = np.cos(theta1), np.sin(theta1), np.cos(tilt), np.sin(tilt)
        axis4 = np.stack([c1 * st, s1 * st, ct])
        across = np.stack([c1 * ct, s1 * ct, -st])
        theta4 = np.arctan2(-np.sum(across * y5, axis=0), -s1 * y5[0] + c1 * y5[1])
        z5 = np.cross(x5, y5, axis=0)
        theta5 = np.arctan2(-np.sum(axis4 * x5, axis=0), np.sum(axis4 * z5, axis=0))
        return np.concatenate([theta1, theta2, tilt - theta2, theta4, theta5, angle], axis=1)


def _reach_measure(cosine: FloatArray) -> FloatArray:
    """Return 1 - cosine^2, or -1 if the cosine is undefined because the wrist centre is at axis 2."""
    return np.where(np.isnan(cosine), -1.0, 1.0 - cosine * cosine)


_Brackets = tuple[IndexArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Poses, shoulders, elbows and two angles (M,) between which f changes its sign once."""


def _all_solutions(form: OffsetParameters, pose: FloatArray) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Compute all solutions of poses (P, 4, 4) of the form's inner flange.

    Returns:
        Pose index (M,), branch number (M,) and theta (M, 6) [rad] of each solution.
    """
    # Bracket all sign changes of f for both shoulders, and refine them to roots.
    condition = _WristCondition(form, pose)
    passes = _axis1_passes(condition)
    bracket_sets = [_sign_brackets(condition, shoulder, passes) for shoulder in (1.0, -1.0)]
    row, shoulder, elbow, low, high = (np.concatenate(parts) for parts in zip(*bracket_sets, strict=True))
    at_rows, s, e = condition.at_poses(row), shoulder[:, None], elbow[:, None]
    angle = _find_roots(lambda t, k: at_rows.at_poses(k).value(t, s[k], e[k]), low, high)
    theta = at_rows.joints(angle[:, None], s, e)
    # The sign of the slope is that of the determinant of the Jacobian, which is part of the branch number.
    step = 1e-6
    slope = at_rows.value(angle[:, None] + step, s, e) - at_rows.value(angle[:, None] - step, s, e)
    slope = slope[:, 0] / (2.0 * step)
    theta, is_exact = _refine(form, theta, pose[row])
    branch = 4 * (slope > 0.0) + 2 * (shoulder < 0.0) + (elbow > 0.0)
    order = np.lexsort((-np.abs(slope), branch, row))
    order = order[is_exact[order]]
    row, branch, theta = row[order], branch[order], theta[order]
    # Remove duplicates: a root at the border of regular and dense samples may have been found in both.
    is_duplicate = (np.diff(row) == 0) & (
        np.abs(np.diff(theta, axis=0)).max(axis=1, initial=0.0) < _SOLUTION_TOLERANCE_RAD
    )
    is_new = np.append(True, ~is_duplicate)[: len(row)]  # the slice matters if there are no solutions
    row, branch, theta = row[is_new], branch[is_new], theta[is_new]
    # Solutions of one pose with the same number get ranks 0, 1, ...
    same = np.append(False, (np.diff(row) == 0) & (np.diff(branch) == 0))
    first_of_group = np.maximum.accumulate(np.where(same, 0, np.arange(len(row))))
    rank = np.arange(len(row)) - first_of_group
    kept = rank < MAX_RANKS
    return row[kept], (branch + 8 * rank)[kept], theta[kept]


_Axis1Passes = tuple[IndexArray, IndexArray, FloatArray, FloatArray]
"""Passes (M,) of the wrist centre close to axis 1, as theta 6 grows.

Each pass has the index of its pose, the index of the regular sample before it, theta 6 [rad] where the
wrist centre is closest to axis 1, and the width [rad] of theta 6 over which the wrist centre rotates about
axis 1 by 45 degrees.
"""


def _axis1_passes(condition: _WristCondition) -> _Axis1Passes:
    """Find the passes close to axis 1 for which the regular samples are too coarse.

    The width of a pass is the smallest distance of the wrist centre from axis 1, divided by its speed there
    per change of theta 6. A pass is close if its width is below :data:`_MAX_CLOSE_PASS_GAPS` gaps between
    samples.
    """
    angle = _FIRST_ANGLE_RAD + 2.0 * np.pi * np.arange(SAMPLE_ANGLES) / SAMPLE_ANGLES
    step = 2.0 * np.pi / SAMPLE_ANGLES
    # The distance from axis 1 has a minimum where the wrist centre approaches it and then moves away.
    moves_away = condition.radial_rate(angle) > 0.0
    row, column = np.nonzero(~moves_away & np.roll(moves_away, -1, axis=1))
    at_rows = condition.at_poses(row)
    middle = _find_roots(lambda t, k: at_rows.at_poses(k).radial_rate(t), angle[column], angle[column] + step)
    offset, derivative = (
        np.linalg.norm(part[..., 0], axis=0) for part in at_rows.offset_from_axis1(middle[:, None])
    )
    is_close = offset < _MAX_CLOSE_PASS_GAPS * step * derivative
    row, column, middle = row[is_close], column[is_close], middle[is_close]
    offset, derivative = offset[is_close], derivative[is_close]
    return row, column, middle, np.maximum(offset / derivative, _MIN_PASS_WIDTH_RAD)


def _sign_brackets(condition: _WristCondition, shoulder: float, axis1_passes: _Axis1Passes) -> _Brackets:
    """Bracket all sign changes of f for one shoulder, so that each bracket can be refined to a solution.

    Args:
        condition: Condition at P poses.
        shoulder: 1 in front of axis 1, -1 behind it.
        axis1_passes: Passes close to axis 1, which are sampled densely.
    """
    angle = _FIRST_ANGLE_RAD + 2.0 * np.pi * np.arange(SAMPLE_ANGLES) / SAMPLE_ANGLES
    step = 2.0 * np.pi / SAMPLE_ANGLES
    side = np.array(shoulder)
    cosine, along, across = condition.components(angle, side)
    reach = _reach_measure(cosine)
    inside = reach >= 0.0
    with np.errstate(invalid="ignore"):
        sine = np.sqrt(reach)
    out: list[_Brackets] = []

    def add(row: IndexArray, elbow: float, low: FloatArray, high: FloatArray) -> None:
        out.append((row, np.full(len(row), shoulder), np.full(len(row), elbow), low, high))

    ends = _reach_ends(condition, shoulder, angle, reach, inside)
    dense, dense_row, dense_column = _dense_angles(condition, shoulder, axis1_passes)
    at_dense_rows = condition.at_poses(dense_row)
    # Dense samples cover the gaps between regular samples from one before a pass to two after it.
    in_dense_gap, near_dense_gap = np.zeros_like(inside), np.zeros_like(inside)
    for shift in (-1, 0, 1, 2):
        near_dense_gap[dense_row, (dense_column + shift) % SAMPLE_ANGLES] = True
        in_dense_gap[dense_row, (dense_column + min(shift, 1)) % SAMPLE_ANGLES] = True
    # Regular samples first, then dense samples at passes by axis 1, then samples toward the ends of reach.
    for elbow in (-1.0, 1.0):
        value = cosine * along + elbow * sine * across
        next_value = np.roll(value, -1, axis=1)
        changes = ((value > 0.0) != (next_value > 0.0)) & inside & np.roll(inside, -1, axis=1)
        row, column = np.nonzero(changes & ~in_dense_gap)
        add(row, elbow, angle[column], angle[column] + step)
        may_dip = _may_cross_zero(np.stack([np.roll(value, 1, axis=1), value, next_value], axis=2))[..., 0]
        row, column = np.nonzero(may_dip & ~near_dense_gap)
        for rows, low, high in _dip_brackets(
            condition, row, angle[column] - step, angle[column] + step, shoulder, elbow
        ):
            add(rows, elbow, low, high)
        value = at_dense_rows.value(dense, side, np.array(elbow))
        value[at_dense_rows.reach_measure(dense, side) < 0.0] = np.nan
        row_index, column = np.nonzero((value[:, 2:-1] > 0.0) != (value[:, 1:-2] > 0.0))
        add(dense_row[row_index], elbow, dense[row_index, column + 1], dense[row_index, column + 2])
        row_index, column = np.nonzero(_may_cross_zero(value, dense))
        low, high = dense[row_index, column], dense[row_index, column + 2]
        for rows, first, second in _dip_brackets(condition, dense_row[row_index], low, high, shoulder, elbow):
            add(rows, elbow, first, second)
        for row, inner_angle, end in ends:
            # samples that are denser toward the end, where f behaves like a square root, and on to the
            # previous angle
            samples = end[:, None] + (inner_angle - end)[:, None] * np.linspace(0.0, 1.0, _END_SAMPLES) ** 2
            back_samples = (
                inner_angle[:, None]
                + np.where(inner_angle > end, step, -step)[:, None]
                * np.arange(1, _END_BACK_SAMPLES + 1)
                / _END_BACK_SAMPLES
            )
            samples = np.concatenate([samples, back_samples], axis=1)
            value = condition.at_poses(row).value(samples, side, np.array(elbow))
            value[:, _END_SAMPLES:][condition.at_poses(row).reach_measure(back_samples, side) < 0.0] = np.nan
            above = value > 0.0
            changes = (above[:, 1:] != above[:, :-1]) & np.isfinite(value[:, 1:]) & np.isfinite(value[:, :-1])
            # between two regular samples one sign change has been found already
            changes[:, _END_SAMPLES - 1 :] &= (above[:, _END_SAMPLES - 1] == above[:, -1])[:, None]
            row_index, column = np.nonzero(changes)
            add(row[row_index], elbow, samples[row_index, column], samples[row_index, column + 1])
            row_index, column = np.nonzero(_may_cross_zero(value, samples))
            low, high = samples[row_index, column], samples[row_index, column + 2]
            for rows, first, second in _dip_brackets(condition, row[row_index], low, high, shoulder, elbow):
                add(rows, elbow, first, second)
    return tuple(np.concatenate(parts) for parts in zip(*out, strict=True))  # type: ignore[return-value]


def _dense_angles(
    condition: _WristCondition, shoulder: float, axis1_passes: _Axis1Passes
) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Choose dense angles theta 6 over the three gaps between regular samples around each pass.

    They are evenly spaced in the angle of the wrist centre about axis 1. The next regular sample before and
    after these gaps is added at both ends. Passes at which the reach ends are left out.

    Returns:
        Angles (M, K) [rad], index (M,) of the pose, and index (M,) of the regular sample before the pass.
    """
    row, column, middle, width = axis1_passes
    step = 2.0 * np.pi / SAMPLE_ANGLES
    low = _FIRST_ANGLE_RAD + step * (column - 1)
    start, end = (np.arctan((bound - middle) / width) for bound in (low, low + 3.0 * step))
    angles_about_axis1 = start[:, None] + (end - start)[:, None] * np.linspace(0.0, 1.0, _PASS_SAMPLES)
    angle = middle[:, None] + width[:, None] * np.tan(angles_about_axis1)
    angle[:, 0], angle[:, -1] = low, low + 3.0 * step
    angle = np.concatenate([low[:, None] - step, angle, low[:, None] + 4.0 * step], axis=1)
    reach = condition.at_poses(row).reach_measure(angle, np.array(shoulder))
    is_inside = (reach[:, 1:-1] >= 0.0).all(axis=1)
    return angle[is_inside], row[is_inside], column[is_inside]


def _may_cross_zero(value: FloatArray, angle: FloatArray | None = None) -> BoolArray:
    """Return for each inner sample whether f may cross zero twice next to it without a change of sign.

    The result is (..., K - 2). Two crossings are possible at a local minimum of |f| if the slope on one side,
    extrapolated to the other side, would cross zero.

    Args:
        value: (..., K) values of f at consecutive angles. The first and the last are not examined.
        angle: (..., K) [rad] angles of the values. None: evenly spaced.
    """
    previous, current, following = value[..., :-2], value[..., 1:-1], value[..., 2:]
    size, size_previous, size_next = np.abs(current), np.abs(previous), np.abs(following)
    with np.errstate(invalid="ignore", divide="ignore"):
        gaps = None if angle is None else np.abs(np.diff(angle, axis=-1))
        gap_ratio = 1.0 if gaps is None else gaps[..., 1:] / gaps[..., :-1]
        dip = (
            (current * following > 0.0)
            & (current * previous > 0.0)
            & (size <= size_previous)
            & (size <= size_next)
        )
        return np.asarray(
            dip & (size < np.fmax((size_previous - size) * gap_ratio, (size_next - size) / gap_ratio))
        )


def _reach_ends(
    condition: _WristCondition, shoulder: float, angle: FloatArray, reach: FloatArray, inside: BoolArray
) -> list[tuple[IndexArray, FloatArray, FloatArray]]:
    """Find the ends of the reach, which are the bounds of the intervals of theta 6 within reach.

    Args:
        condition: Condition at P poses.
        shoulder: 1 in front of axis 1, -1 behind it.
        angle: (K,) [rad] regular samples of theta 6.
        reach: (P, K) :meth:`_WristCondition.reach_measure` at the samples.
        inside: (P, K) whether the samples are within reach.

    Returns:
        List of arrays (M,): index of the pose, an angle [rad] next to the end that is within reach, and the
        end [rad].
    """
    step = 2.0 * np.pi / SAMPLE_ANGLES
    out = []
    for direction in (1, -1):
        row, column = np.nonzero(inside & ~np.roll(inside, -direction, axis=1))
        inner_angle = angle[column]
        at_rows = condition.at_poses(row)
        outer_angle = inner_angle + direction * step
        end = _find_roots(
            lambda t, k: at_rows.at_poses(k).reach_measure(t, np.array(shoulder)),  # noqa: B023
            inner_angle,
            outer_angle,
        )
        out.append((row, inner_angle, end))
    # narrow intervals within reach between two angles out of reach
    previous, following = np.roll(reach, 1, axis=1), np.roll(reach, -1, axis=1)
    row, column = np.nonzero(
        ~inside & (reach >= previous) & (reach >= following) & (reach > -_NARROW_REACH_TOLERANCE)
    )
    if len(row):
        at_rows = condition.at_poses(row)
        best_angle = _golden_minimum(
            lambda t: -at_rows.reach_measure(t, np.array(shoulder)),
            angle[column] - step,
            angle[column] + step,
        )
        is_reached = at_rows.reach_measure(best_angle[:, None], np.array(shoulder))[:, 0] > 0.0
        row, best_angle = row[is_reached], best_angle[is_reached]
        at_rows = condition.at_poses(row)
        for sign in (1.0, -1.0):
            end = _find_roots(
                lambda t, k: at_rows.at_poses(k).reach_measure(t, np.array(shoulder)),
                best_angle,
                best_angle + sign * step,
            )
            out.append((row, best_angle, end))
    return out


def _dip_brackets(
    condition: _WristCondition,
    row: IndexArray,
    low: FloatArray,
    high: FloatArray,
    shoulder: float,
    elbow: float,
) -> list[tuple[IndexArray, FloatArray, FloatArray]]:
    """Bracket both roots of f in intervals where |f| has a minimum and crosses zero twice.

    Intervals in which f does not cross zero are left out.

    Args:
        condition: Condition at all poses.
        row: (M,) index of the pose of each interval.
        low: (M,) [rad] start of each interval.
        high: (M,) [rad] end of each interval.
        shoulder: 1 in front of axis 1, -1 behind it.
        elbow: 1 or -1.

    Returns:
        The brackets of the first roots, then those of the second roots: index of the pose and both angles.
    """
    if not len(row):
        return []
    at_rows, s, e = condition.at_poses(row), np.array(shoulder), np.array(elbow)
    sign = np.sign(at_rows.value(low[:, None], s, e))
    extremum = _golden_minimum(lambda t: at_rows.value(t, s, e) * sign, low, high)
    crosses = (at_rows.value(extremum[:, None], s, e) * sign)[:, 0] <= 0.0
    return [(row[crosses], low[crosses], extremum[crosses]), (row[crosses], extremum[crosses], high[crosses])]


_FIRST_ANGLE_RAD: Final = 0.0123
"""First sampled angle [rad]. The offset keeps the solutions of symmetric arms, at whole fractions of a turn,
off the grid.
"""
_END_SAMPLES: Final = 10
"""Number of samples between the end of reach and the angle next to it."""
_END_BACK_SAMPLES: Final = 4
"""Number of further samples from there to the previous angle."""
_MAX_CLOSE_PASS_GAPS: Final = 3.0
"""Width of a pass by axis 1, in sample gaps, below which the pass gets samples of its own."""
_MIN_PASS_WIDTH_RAD: Final = 1e-9
"""Minimum width [rad] of a pass by axis 1. Below it theta 1 is practically undetermined."""
_PASS_SAMPLES: Final = 48
"""Number of samples around a pass by axis 1."""
_SOLUTION_TOLERANCE_RAD: Final = 1e-8
"""Joint distance [rad] below which two solutions are the same."""
_NARROW_REACH_TOLERANCE: Final = 0.02
"""Maximum excess of the squared cosine over 1 at which a narrow reach is searched between two samples."""
_GOLDEN_FRACTION: Final = 0.5 * (3.0 - 5.0**0.5)
"""Fraction of the interval at which golden-section search evaluates the function."""


def _golden_minimum(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Minimise M functions of one angle (M, 1), each between two angles (M,), by golden-section search.

    Returns the angles (M,) of the minima.
    """
    for _ in range(30):
        inner_low, inner_high = low + _GOLDEN_FRACTION * (high - low), high - _GOLDEN_FRACTION * (high - low)
        keep_low = function(inner_low[:, None])[:, 0] < function(inner_high[:, None])[:, 0]
        low, high = np.where(keep_low, low, inner_low), np.where(keep_low, inner_high, high)
    return np.asarray(0.5 * (low + high))


def _find_roots(
    function: Callable[[FloatArray, IndexArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Find the roots (M,) of M functions between angles (M,) at which their signs differ.

    Uses the Illinois variant of regula falsi, with a bisection step every fourth iteration. ``function``
    takes angles (K, 1) and the indices (K,) of the functions.
    """
    low, high = low.copy(), high.copy()
    all_indices = np.arange(len(low))
    at_low, at_high = function(low[:, None], all_indices)[:, 0], function(high[:, None], all_indices)[:, 0]
    out = np.where(at_low == 0.0, low, high)
    side = np.zeros(len(low), dtype=np.intp)
    active = np.flatnonzero((at_low != 0.0) & (at_high != 0.0))
    for count in range(_MAX_ROOT_STEPS):
        if not len(active):
            break
        a, b, fa, fb = low[active], high[active], at_low[active], at_high[active]
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = b - fb * (b - a) / (fb - fa)
        if count % 4 == 3:
            middle = 0.5 * (a + b)
        middle = np.where(np.isfinite(middle), middle, 0.5 * (a + b))
        value = function(middle[:, None], active)[:, 0]
        same_sign_as_high = (value > 0.0) == (fb > 0.0)
        repeated_side = np.where(same_sign_as_high, 1, -1) == side[active]
        low[active] = np.where(same_sign_as_high, a, middle)
        high[active] = np.where(same_sign_as_high, middle, b)
        # Illinois: if the same end stays twice in a row, its function value is halved.
        at_low[active] = np.where(same_sign_as_high, np.where(repeated_side, 0.5 * fa, fa), value)
        at_high[active] = np.where(same_sign_as_high, value, np.where(repeated_side, 0.5 * fb, fb))
        side[active] = np.where(same_sign_as_high, 1, -1)
        out[active] = middle
        # keep the functions whose bracket and value still exceed rounding errors
        active = active[
            (value != 0.0) & (np.abs(high[active] - low[active]) > 1e-15) & (np.abs(value) > 1e-16)
        ]
    return out


def _refine(form: OffsetParameters, theta: FloatArray, pose: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Refine theta (M, 6) [rad] by Newton's method where its pose error is too large.

    ``pose`` (M, 4, 4) are the poses of the inner flange that theta has to reach.

    Returns theta, and whether (M,) its pose error is at most :data:`POSE_TOLERANCE`.
    """
    inner = dataclasses.replace(form, left=None, right=None, offsets=np.zeros(6), signs=np.ones(6))
    error = np.abs(flange_poses(inner, theta) - pose).max(axis=(1, 2), initial=0.0)
    inexact = np.flatnonzero(error > 0.01 * POSE_TOLERANCE)  # False for NaN, so missing solutions stay out
    if len(inexact):
        theta, error = theta.copy(), error.copy()
        theta[inexact], error[inexact] = _newton_inverse(inner, theta[inexact], pose[inexact])
    return theta, error <= POSE_TOLERANCE


def _newton_inverse(form: OffsetParameters, q: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Move joints (M, 6) [rad] toward flange poses (M, 4, 4) by Newton's method.

    Returns the joints and the largest remaining error (M,) of any entry of the pose matrices.
    """
    q = q.copy()
    error = np.full(len(q), np.inf)
    active = np.arange(len(q))
    for _ in range(_MAX_NEWTON_STEPS):
        current = flange_poses(form, q[active])
        error[active] = np.abs(current - pose[active]).max(axis=(1, 2))
        unconverged = ~(error[active] <= 0.01 * POSE_TOLERANCE)
        active, current = active[unconverged], current[unconverged]
        if not len(active):
            break
        rotation = (
            current[:, :3, :3]
            @ log_rotation(np.swapaxes(current[:, :3, :3], 1, 2) @ pose[active, :3, :3])[..., None]
        )
        twist = np.concatenate([rotation[..., 0], pose[active, :3, 3] - current[:, :3, 3]], axis=1)
        jac = form_jacobian(form, q[active])
        step = np.einsum("mij,mj->mi", np.linalg.pinv(jac, rcond=1e-9), twist)
        q[active] += (
            step
            * np.minimum(1.0, _MAX_NEWTON_CHANGE_RAD / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        )
    return q, error


def follow_branch(form: OffsetParameters, flange: FloatArray, seed: FloatArray) -> FloatArray:
    """Compute the joints of flange poses that continue from given joints.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the base.
        seed: (..., 6) [rad] joints from which Newton's method starts.

    Returns:
        Joints (..., 6) [rad]; NaN where Newton's method finds none within :data:`MAX_FOLLOW_STEP_RAD` of the
        seed.
    """
    start = np.broadcast_to(seed, (*flange.shape[:-2], 6))
    q, error = _newton_inverse(form, start.reshape(-1, 6), flange.reshape(-1, 4, 4))
    with np.errstate(invalid="ignore"):
        lost = ~(
            (error <= POSE_TOLERANCE)
            & (np.abs(q - start.reshape(-1, 6)).max(axis=1, initial=0.0) <= MAX_FOLLOW_STEP_RAD)
        )
    q[lost] = np.nan
    return q.reshape(start.shape)


def match_ranks(q: FloatArray) -> FloatArray:
    """Renumber solutions that differ only in their rank so that a rank continues as closely as possible.

    Ranks continue from target to target, and at the first target from sample to sample.

    Args:
        q: (N, S, branches, 6) [rad] joints of :func:`inverse_kinematics` at N targets with S samples.

    Returns:
        The joints, reordered along the axis of branches.
    """
    out = q.copy()
    by_rank = out.reshape(*q.shape[:2], MAX_RANKS, 8, 6)
    first_target = by_rank[0]
    for s in range(1, q.shape[1]):
        first_target[s] = _match_ranks_to(first_target[None, s - 1], first_target[None, s])[0]
    last_known = first_target.copy()
    for row in by_rank[1:]:
        row[:] = _match_ranks_to(last_known, row)
        last_known = np.where(np.isnan(row), last_known, row)
    return out


def _match_ranks_to(previous: FloatArray, current: FloatArray) -> FloatArray:
    """Return joints ``current`` (S, MAX_RANKS, 8, 6) with ranks permuted to be closest to ``previous``.

    For each sample and each of the 8 combinations of slope, shoulder and elbow all permutations of the ranks
    are compared. The distance of two solutions is their largest joint change modulo full turns, at most 1.
    """
    difference = np.abs(previous[:, :, None] - current[:, None])
    gap = np.minimum(
        np.abs(difference - 2.0 * np.pi * np.round(difference / (2.0 * np.pi))).max(axis=-1), 1.0
    )
    # a missing solution is as far as any distant one, 1 rad, so that it does not decide the order
    gap = np.where(np.isnan(gap), 1.0, gap)  # (S, previous rank, current rank, 8)
    permutations = list(itertools.permutations(range(MAX_RANKS)))
    cost = np.stack(
        [
            np.sum([gap[:, k, permutation[k]] for k in range(MAX_RANKS)], axis=0)
            for permutation in permutations
        ]
    )
    best = np.array(permutations)[np.argmin(cost, axis=0)]  # (S, 8, RANKS)
    return np.take_along_axis(current, np.moveaxis(best, 2, 1)[..., None], axis=1)


def singularities(form: OffsetParameters, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the angles from singularities of the wrist, the elbow and the shoulder.

    - Wrist: arcsine of the Jacobian's determinant divided by its factors of the elbow and the shoulder. If
      axis 6 passed through the point where axes 4 and 5 meet, it would be the angle of axis 5.
    - Elbow: angle from stretched or folded.
    - Shoulder: angle under which the stretched arm would see the distance from axis 1 of the point where axes
      4 and 5 meet.

    Args:
        form: Kinematic parameters.
        q: (..., 6) [rad] joints.

    Returns:
        Three arrays (...,) [rad]: wrist, elbow, shoulder.
    """
    theta = form.signs * q - form.offsets
    forearm = float(np.hypot(form.a2, form.c3))
    bend = theta[..., 2] + np.arctan2(form.a2, form.c3)
    reach_x = form.a1 + form.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + bend)
    wrist = np.full(q.shape[:-1], np.nan)
    exists = np.isfinite(theta).all(axis=-1)  # most branches of most poses have no solution
    size = np.abs(np.linalg.det(form_jacobian(form, q[exists])))
    scale = form.c2 * forearm * np.abs(np.sin(bend[exists]) * reach_x[exists])
    with np.errstate(divide="ignore"):
        wrist[exists] = np.arcsin(np.minimum(1.0, size / np.maximum(scale, 1e-300)))
    elbow = np.abs(np.arcsin(np.sin(bend)))
    return wrist, elbow, np.arcsin(np.minimum(1.0, np.abs(reach_x) / (form.c2 + forearm)))


def reach_gap(form: OffsetParameters, flange: FloatArray) -> FloatArray:
    """Return a lower bound (...,) [m] of the distance of the wrist centre from its reachable region.

    The wrist centre is the point where axes 4 and 5 meet. Theta 6 is free, so its offset from axis 6 counts
    as additional reach.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the form's base.
    """
    wrist_base = flange[..., :3, 3] - form.c4 * flange[..., :3, 2]
    distance = np.hypot(np.hypot(wrist_base[..., 0], wrist_base[..., 1]), wrist_base[..., 2] - form.c1)
    forearm = float(np.hypot(form.a2, form.c3))
    wrist_offset = float(np.hypot(form.a3, form.b3)) + abs(form.a1)
    outer_gap = distance - (form.c2 + forearm + wrist_offset)
    return np.asarray(
        np.maximum(np.maximum(outer_gap, abs(form.c2 - forearm) - wrist_offset - distance), 0.0)
    )


def wrist_gap(form: OffsetParameters, flange: FloatArray) -> FloatArray:
    """Return the distance (...,) [m] of the point where axes 4 and 5 meet from the reach of the arm.

    The reach is that of upper arm and forearm. Axis 6 takes the best of :data:`SAMPLE_ANGLES` angles. If the
    distance is 0 and the pose has no solution, the wrist cannot take the required orientation.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the form's base.
    """
    # each sampled angle with and without the offset of the grid
    angle = np.append(0.0, _FIRST_ANGLE_RAD) + 2.0 * np.pi * np.arange(SAMPLE_ANGLES)[:, None] / SAMPLE_ANGLES
    c, s = np.cos(angle.reshape(-1)), np.sin(angle.reshape(-1))
    ex, ey = flange[..., None, :3, 0], flange[..., None, :3, 1]
    wrist_base = flange[..., :3, 3] - form.c4 * flange[..., :3, 2] - np.array([0.0, 0.0, form.c1])
    wrist_offset = form.a3 * (c[:, None] * ex - s[:, None] * ey) + form.b3 * (
        s[:, None] * ex + c[:, None] * ey
    )
    x, y, up = np.moveaxis(wrist_base[..., None, :] - wrist_offset, -1, 0)
    forearm, radius = float(np.hypot(form.a2, form.c3)), np.hypot(x, y)
    gaps = []
    for shoulder_x in (radius - form.a1, -radius - form.a1):  # in front of axis 1 and behind it
        distance = np.hypot(shoulder_x, up)
        gaps.append(
            np.maximum(distance - (form.c2 + forearm), abs(form.c2 - forearm) - distance).min(axis=-1)
        )
    return np.asarray(np.maximum(np.minimum(*gaps), 0.0))


MAX_FOLLOW_STEP_RAD: Final = 0.5
"""Maximum joint change [rad] of :func:`follow_branch`."""
_MAX_NEWTON_STEPS: Final = 12
"""Maximum number of Newton steps."""
_MAX_NEWTON_CHANGE_RAD: Final = 0.2
"""Maximum change [rad] of a joint in one Newton step."""
