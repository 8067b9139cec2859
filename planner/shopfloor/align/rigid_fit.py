"""Pose of a second robot from points that both robots probed: the best rigid motion in closed form.

The fit is that of least squares after Kabsch (1976) with the sign after Umeyama (1991), which excludes
reflections. Bad points are the smallest set of points without which the others agree.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, from_parts
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error

MIN_SPREAD_M: Final = 10.0 * MM
"""RMS extent [m] below which points count as one position."""
LINE_WIDTH_RATIO, NARROW_WIDTH_RATIO = 0.01, 0.1
"""Ratio of width to length of the points: below the first they are on one line, below the second nearly."""
MAX_LEFT_OUT_SETS: Final = 5000
"""Maximum number of sets of equal size that are left out in turn.

If there are more, points are left out one after another.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class Alignment:
    """Result of an alignment.

    Attributes:
        pose: Pose (4, 4) of the second robot's base in that of the first.
        residual: Positions (N, 3) [m] by the first robot minus those by the second, in the base of the first;
            also of unused points.
        used: Whether each point (N,) was used.
        sigma: Standard deviation [m] of a coordinate, from the residuals.
        position_sigma: Standard deviation [m] of the second base's position, in the worst direction.
        turn_sigma: Standard deviation [rad] of its rotation, in the worst direction.
    """

    pose: FloatArray
    residual: FloatArray
    used: BoolArray
    sigma: float
    position_sigma: float
    turn_sigma: float

    @property
    def distance(self) -> FloatArray:
        """Lengths (N,) [m] of the residuals."""
        length: FloatArray = np.linalg.norm(self.residual, axis=-1)
        return length


def rigid_fit(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the least-squares poses (..., 4, 4) that map points ``b`` onto points ``a``.

    Args:
        a: Target points (N, 3) [m].
        b: Points to move (N, 3) [m], paired with ``a``.
        weight: Weights (..., N) of the points, one fit for each set of weights.
    """
    return _fit(a, b, weight, mirrored=False)


def align(
    a: FloatArray, b: FloatArray, names: Sequence[str], arms: tuple[str, str], used: BoolArray | None = None
) -> Alignment:
    """Compute the second robot's base in that of the first, from points that both robots have probed.

    Args:
        a: Points (N, 3) [m] in the base of the first robot.
        b: The same points (N, 3) [m] in the base of the second robot.
        names: Names of the points.
        arms: Names of both arms.
        used: Which points (N,) are used; None for all.

    Raises:
        TandemError: ``align.few_points``, ``align.same_points``, ``align.collinear``, ``align.units`` or
            ``align.mirrored`` if the used points do not determine the base.
    """
    use = np.ones(len(a), dtype=bool) if used is None else used
    _require_points(a[use], b[use], [name for name, is_used in zip(names, use, strict=True) if is_used], arms)
    pose = rigid_fit(a, b, use.astype(np.float64))
    residual = a - (b @ pose[:3, :3].T + pose[:3, 3])
    count = int(use.sum())
    # 3 N coordinates determine 6 unknowns
    sigma = math.sqrt(float((residual[use] ** 2).sum()) / (3 * count - 6))
    middle = a[use].mean(axis=0)
    centred = a[use] - middle
    # covariances in units of sigma^2: that of the rotation about the centroid is the inverse of
    # sum(|c|^2 I - c c^T); the position adds 1/N of the centroid to that of the rotation times its lever
    rotation_covariance = np.linalg.inv((centred**2).sum() * np.eye(3) - centred.T @ centred)
    x, y, z = pose[:3, 3] - middle
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    position_covariance = np.eye(3) / count + lever @ rotation_covariance @ lever.T
    turn_sigma = sigma * math.sqrt(float(np.linalg.eigvalsh(rotation_covariance)[-1]))
    position_sigma = sigma * math.sqrt(float(np.linalg.eigvalsh(position_covariance)[-1]))
    return Alignment(pose, residual, use, sigma, position_sigma, turn_sigma)


def collinearity_warnings(a: FloatArray, b: FloatArray, arms: tuple[str, str]) -> tuple[Issue, ...]:
    """Return a warning ``align.collinear`` if the points are nearly on one line, else nothing.

    Such points hardly determine the rotation about that line.
    """
    width, length = min((_extents(p)[1], _extents(p)[0]) for p in (a, b))
    if width >= NARROW_WIDTH_RATIO * length:
        return ()
    text = (
        f"the probed points of {arms[0]} and {arms[1]} lie within {width / MM:.0f} mm of one line "
        f"{length / MM:.0f} mm long (in the mean); the rotation about it is poorly determined"
    )
    hint = "probe a point farther off that line"
    return (Issue("align.collinear", text, Severity.WARNING, value=width / MM, unit="mm", hint=hint),)


def tolerance_issues(
    alignment: Alignment, a: FloatArray, b: FloatArray, names: Sequence[str], tolerance: float
) -> list[Issue]:
    """Return errors if used points are farther than ``tolerance`` [m] from their fit.

    ``align.bad_point`` for each of the smallest set of points without which the others agree, or one
    ``align.large_residual`` if no such set can be determined.
    """
    use = np.flatnonzero(alignment.used)
    if float(alignment.distance[use].max()) <= tolerance:
        return []
    bad = bad_points(a[use], b[use], tolerance)
    if bad is None:
        return [_disagreeing_pair(alignment, a[use], b[use], [names[k] for k in use.tolist()], tolerance)]
    good = use[~np.isin(np.arange(len(use)), bad)]
    pose = rigid_fit(a[good], b[good], np.ones(len(good)))
    issues = []
    for k in use[bad].tolist():
        offset = a[k] - (pose[:3, :3] @ b[k] + pose[:3, 3])
        size = float(np.linalg.norm(offset)) / MM
        text = format_message(
            "align.bad_point",
            point=names[k],
            distance_mm=size,
            x_mm=offset[0] / MM,
            y_mm=offset[1] / MM,
            z_mm=offset[2] / MM,
            tolerance_mm=tolerance / MM,
        )
        hint = f"probe it again with both robots, or leave it out: --leave-out {names[k]}"
        issues.append(
            Issue(
                "align.bad_point",
                text,
                index=k,
                target=names[k],
                value=size,
                limit=tolerance / MM,
                unit="mm",
                hint=hint,
            )
        )
    return issues


def bad_points(a: FloatArray, b: FloatArray, tolerance: float) -> list[int] | None:
    """Return the indices of the smallest set of points without which all others fit within ``tolerance`` [m].

    None if there is none, or if another set of that size does almost as well. Three points at least remain.
    """
    count = len(a)
    for size in range(1, count - 2):
        if math.comb(count, size) > MAX_LEFT_OUT_SETS:
            return _left_out_one_by_one(a, b, tolerance)
        sets = np.array(list(itertools.combinations(range(count), size)))
        weight = np.ones((len(sets), count))
        np.put_along_axis(weight, sets, 0.0, axis=1)
        max_distance, rms = _misfit(a, b, weight)
        agreeing = np.flatnonzero(max_distance <= tolerance)
        if not len(agreeing):
            continue
        order = agreeing[np.argsort(rms[agreeing])]
        # the best set has to be better than the next one by a factor of 3
        if len(order) > 1 and rms[order[1]] < 3.0 * rms[order[0]] + 1e-3 * tolerance:
            return None
        return [int(k) for k in sets[order[0]]]
    return None


def _left_out_one_by_one(a: FloatArray, b: FloatArray, tolerance: float) -> list[int] | None:
    """Leave out the point whose absence reduces the RMS distance most, repeatedly, up to a third of all.

    Return the indices of these points as soon as the others are within ``tolerance`` [m], else None.
    """
    weight, left_out = np.ones(len(a)), []
    for _ in range(len(a) // 3):
        trial = weight * (1.0 - np.eye(len(a)))
        max_distance, rms = _misfit(a, b, trial)
        rms[weight == 0.0] = np.inf
        k = int(np.argmin(rms))
        weight[k] = 0.0
        left_out.append(k)
        if max_distance[k] <= tolerance:
            return sorted(left_out)
    return None


def _misfit(a: FloatArray, b: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest and the RMS distance (M,) [m] of points of weight 1 from their fits.

    There is one fit for each row of weights (M, N), which are 0 or 1. Both distances are infinite if the
    points of weight 1 are on one line.
    """
    pose = rigid_fit(a, b, weight)
    moved = np.einsum("mij,nj->mni", pose[:, :3, :3], b) + pose[:, None, :3, 3]
    square = ((a - moved) ** 2).sum(axis=-1) * weight
    max_distance, rms = np.sqrt(square.max(axis=1)), np.sqrt(square.sum(axis=1) / weight.sum(axis=1))
    middle = weight @ a / weight.sum(axis=1, keepdims=True)
    sizes = np.linalg.svd((a - middle[:, None]) * weight[..., None], compute_uv=False)
    is_collinear = sizes[:, 1] < LINE_WIDTH_RATIO * sizes[:, 0]
    return np.where(is_collinear, np.inf, max_distance), np.where(is_collinear, np.inf, rms)


def _fit(a: FloatArray, b: FloatArray, weight: FloatArray, mirrored: bool) -> FloatArray:
    """Return the poses of `rigid_fit`; if ``mirrored``, with the best reflection in place of the rotation."""
    fraction = weight / weight.sum(axis=-1, keepdims=True)
    ma, mb = fraction @ a, fraction @ b  # weighted centroids
    cross = np.einsum("...n,ni,nj->...ij", fraction, a, b) - ma[..., :, None] * mb[..., None, :]
    u, _, vt = np.linalg.svd(cross)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.linalg.det(u) * np.linalg.det(vt) * (-1.0 if mirrored else 1.0)
    rotation = (u * sign[..., None, :]) @ vt
    return from_parts(rotation, ma - np.einsum("...ij,...j->...i", rotation, mb))


def _extents(points: FloatArray) -> FloatArray:
    """Return the RMS extents (3,) [m] of points (N, 3) along their principal axes, largest first."""
    centred = points - points.mean(axis=0)
    values: FloatArray = np.linalg.svd(centred, compute_uv=False) / math.sqrt(len(points))
    return values if len(points) >= 3 else np.pad(values, (0, 3 - len(values)))


def _require_points(a: FloatArray, b: FloatArray, names: Sequence[str], arms: tuple[str, str]) -> None:
    """Check that the used points (N, 3) [m] of both robots determine the base of the second one.

    Raises:
        TandemError: ``align.few_points`` for fewer than three, ``align.same_points`` if they are in one
            position, ``align.collinear`` if they are on a line, ``align.units`` if the scales differ, or
            ``align.mirrored`` if one set is a mirror image of the other.
    """
    if len(a) < 3:
        count_text = f"{len(a)} probed point{'' if len(a) == 1 else 's'} ({', '.join(names)})"
        raise _refuse(
            "align.few_points", f"{count_text}, allowed three or more", "probe four or more, far apart"
        )
    for points, arm in ((a, arms[0]), (b, arms[1])):
        length, width, _ = _extents(points)
        if length < MIN_SPREAD_M:
            text = f"the points that {arm} probed lie within {length / MM:.2f} mm of each other (in the mean)"
            raise _refuse(
                "align.same_points",
                f"{text}, allowed {MIN_SPREAD_M / MM:g} mm or more",
                "probe points far apart; if they are, the file is not in mm as its columns say",
            )
        if width < max(LINE_WIDTH_RATIO * length, 0.1 * MIN_SPREAD_M):
            text = (
                f"the points that {arm} probed lie on one line, {width / MM:.2g} mm off it over "
                f"{length / MM:.0f} mm (in the mean); the rotation about that line is unknown"
            )
            min_distance = max(NARROW_WIDTH_RATIO * 3 * length / MM, 10)
            hint = f"probe one more point off the line by {min_distance:.0f} mm or more"
            raise _refuse("align.collinear", text, hint)
    # ratio of the root mean square distances from the centroids
    ratio = float(np.sqrt(((b - b.mean(axis=0)) ** 2).sum() / ((a - a.mean(axis=0)) ** 2).sum()))
    if not 0.8 < ratio < 1.25:
        raise _refuse(
            "align.units",
            f"the points of {arms[1]} are {ratio:.4g} times as far apart as those of {arms[0]}, "
            "allowed about 1" + _unit_guess(ratio),
            "give the points of both robots in mm, row by row the same point",
        )
    direct, mirrored = (
        a - (b @ pose[:3, :3].T + pose[:3, 3])
        for pose in (_fit(a, b, np.ones(len(a)), is_mirrored) for is_mirrored in (False, True))
    )
    rms, mirrored_rms = (float(np.sqrt((r**2).sum() / len(a))) for r in (direct, mirrored))
    if rms > 5.0 * MM and mirrored_rms < 0.2 * rms:
        text = (
            f"the points of {arms[1]} are a mirror image of those of {arms[0]}: {mirrored_rms / MM:.2f} mm "
            f"off as an image, {rms / MM:.0f} mm off as they are (in the mean)"
        )
        raise _refuse("align.mirrored", text, "check for an axis with the wrong sign, or two swapped columns")


def _unit_guess(ratio: float) -> str:
    """Return which points seem to be in which unit, by the ratio of their extents; empty if unknown."""
    for name, unit in LENGTH_UNITS.items():
        for factor, text in ((unit / MM, "those of the first"), (MM / unit, "those of the second")):
            if name != "mm" and abs(ratio / factor - 1.0) < 0.05:
                return f"; {text} seem to be in {name!r}, not mm"
    return ""


def _disagreeing_pair(
    alignment: Alignment, a: FloatArray, b: FloatArray, names: Sequence[str], tolerance: float
) -> Issue:
    """Return the issue if no points can be identified as bad.

    It names the two points whose distance differs most between both robots.
    """
    i, j = np.triu_indices(len(a), 1)
    difference = np.linalg.norm(a[i] - a[j], axis=1) - np.linalg.norm(b[i] - b[j], axis=1)
    k = int(np.argmax(np.abs(difference)))
    max_distance = float(alignment.distance[alignment.used].max()) / MM
    return Issue(
        "align.large_residual",
        format_message(
            "align.large_residual",
            max_distance_mm=max_distance,
            tolerance_mm=tolerance / MM,
            disagreement_mm=abs(difference[k]) / MM,
            first_point=names[i[k]],
            second_point=names[j[k]],
        ),
        value=max_distance,
        limit=tolerance / MM,
        unit="mm",
        hint="probe them again and a few more, check both TCPs, or allow more: --tolerance-mm",
    )


def _refuse(code: str, text: str, hint: str) -> TandemError:
    return issue_error(code, text, hint=hint)
