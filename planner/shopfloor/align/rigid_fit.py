"""Pose of a second robot from points that both robots probed: the best rigid motion in closed form.

Least squares after Kabsch (1976) with Umeyama's sign (1991), which excludes reflections. Bad points are the
smallest set without which the others agree.
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
"""Extent [m] below which points count as one position."""
LINE_WIDTH_RATIO, NARROW_WIDTH_RATIO = 0.01, 0.1
"""Ratio of width to length of the points: below the first they are on one line, below the second nearly."""
MAX_LEFT_OUT_SETS: Final = 5000
"""Maximum number of sets of points that are left out in turn. Beyond it, points are left out one after the
other.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class Alignment:
    """Result of an alignment.

    Attributes:
        pose: (4, 4) base of the second robot in that of the first.
        residual: (N, 3) [m] points of the first robot minus those of the second, in the first's base; also of
            unused points.
        used: (N,) whether a point was used.
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
        """Length (N,) [m] of the residuals."""
        length: FloatArray = np.linalg.norm(self.residual, axis=-1)
        return length


def rigid_fit(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    """Least-squares poses (..., 4, 4) that map points ``b`` (N, 3) onto ``a`` (N, 3).

    Args:
        a: (N, 3) target points.
        b: (N, 3) points to move.
        weight: (..., N) weights.
    """
    return _fit(a, b, weight, mirrored=False)


def align(
    a: FloatArray, b: FloatArray, names: Sequence[str], arms: tuple[str, str], used: BoolArray | None = None
) -> Alignment:
    """Compute the second robot's base in that of the first.

    Args:
        a: (N, 3) [m] points in the base of the first robot.
        b: (N, 3) [m] the same points in the base of the second robot.
        names: Names of the points.
        arms: Names of both arms.
        used: (N,) which points are used; None for all.

    Raises:
        TandemError: align.few_points, align.same_points, align.collinear, align.units, align.mirrored.
    """
    use = np.ones(len(a), dtype=bool) if used is None else used
    _require_points(a[use], b[use], [n for n, u in zip(names, use, strict=True) if u], arms)
    pose = rigid_fit(a, b, use.astype(np.float64))
    residual = a - (b @ pose[:3, :3].T + pose[:3, 3])
    count = int(use.sum())
    sigma = math.sqrt(float((residual[use] ** 2).sum()) / (3 * count - 6))
    middle = a[use].mean(axis=0)
    c = a[use] - middle
    spread = np.linalg.inv((c**2).sum() * np.eye(3) - c.T @ c)
    x, y, z = pose[:3, 3] - middle
    lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    place = np.eye(3) / count + lever @ spread @ lever.T
    turn_sigma = sigma * math.sqrt(float(np.linalg.eigvalsh(spread)[-1]))
    return Alignment(
        pose, residual, use, sigma, sigma * math.sqrt(float(np.linalg.eigvalsh(place)[-1])), turn_sigma
    )


def collinearity_warnings(a: FloatArray, b: FloatArray, arms: tuple[str, str]) -> tuple[Issue, ...]:
    """Return ``align.collinear`` for points nearly on one line.

    Such points hardly determine the rotation about it.
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
    """Errors for points that are farther than ``tolerance`` [m] from their fit.

    align.bad_point for each of the smallest set of points without which the others agree;
    align.large_residual if no such set can be determined.
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
    """Smallest set of points without which all others are within ``tolerance`` [m] of their fit.

    None if there is none, or if several sets do almost equally well.
    """
    count = len(a)
    for size in range(1, count - 2):
        if math.comb(count, size) > MAX_LEFT_OUT_SETS:
            return _left_out_one_by_one(a, b, tolerance)
        sets = np.array(list(itertools.combinations(range(count), size)))
        weight = np.ones((len(sets), count))
        np.put_along_axis(weight, sets, 0.0, axis=1)
        worst, mean = _misfit(a, b, weight)
        agree = np.flatnonzero(worst <= tolerance)
        if not len(agree):
            continue
        order = agree[np.argsort(mean[agree])]
        if len(order) > 1 and mean[order[1]] < 3.0 * mean[order[0]] + 1e-3 * tolerance:
            return None
        return [int(k) for k in sets[order[0]]]
    return None


def _left_out_one_by_one(a: FloatArray, b: FloatArray, tolerance: float) -> list[int] | None:
    """Leave out the point whose absence helps most, repeatedly, up to a third of all."""
    weight, out = np.ones(len(a)), []
    for _ in range(len(a) // 3):
        trial = weight * (1.0 - np.eye(len(a)))
        worst, mean = _misfit(a, b, trial)
        mean[weight == 0.0] = np.inf
        k = int(np.argmin(mean))
        weight[k] = 0.0
        out.append(k)
        if worst[k] <= tolerance:
            return sorted(out)
    return None


def _misfit(a: FloatArray, b: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Largest and RMS distance (M,) [m] of the points of weight 1 from their fits, for weights (M, N).

    Both are infinite where the points are on one line.
    """
    pose = rigid_fit(a, b, weight)
    moved = np.einsum("mij,nj->mni", pose[:, :3, :3], b) + pose[:, None, :3, 3]
    square = ((a - moved) ** 2).sum(axis=-1) * weight
    worst, mean = np.sqrt(square.max(axis=1)), np.sqrt(square.sum(axis=1) / weight.sum(axis=1))
    middle = weight @ a / weight.sum(axis=1, keepdims=True)
    sizes = np.linalg.svd((a - middle[:, None]) * weight[..., None], compute_uv=False)
    line = sizes[:, 1] < LINE_WIDTH_RATIO * sizes[:, 0]
    return np.where(line, np.inf, worst), np.where(line, np.inf, mean)


def _fit(a: FloatArray, b: FloatArray, weight: FloatArray, mirrored: bool) -> FloatArray:
    share = weight / weight.sum(axis=-1, keepdims=True)
    ma, mb = share @ a, share @ b
    cross = np.einsum("...n,ni,nj->...ij", share, a, b) - ma[..., :, None] * mb[..., None, :]
    u, _, vt = np.linalg.svd(cross)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.linalg.det(u) * np.linalg.det(vt) * (-1.0 if mirrored else 1.0)
    rotation = (u * sign[..., None, :]) @ vt
    return from_parts(rotation, ma - np.einsum("...ij,...j->...i", rotation, mb))


def _extents(points: FloatArray) -> FloatArray:
    """RMS extents (3,) [m] of the points along their principal axes, largest first."""
    c = points - points.mean(axis=0)
    values: FloatArray = np.linalg.svd(c, compute_uv=False) / math.sqrt(len(points))
    return values if len(points) >= 3 else np.pad(values, (0, 3 - len(values)))


def _require_points(a: FloatArray, b: FloatArray, names: Sequence[str], arms: tuple[str, str]) -> None:
    if len(a) < 3:
        what = f"{len(a)} probed point{'' if len(a) == 1 else 's'} ({', '.join(names)})"
        raise _refuse("align.few_points", f"{what}, allowed three or more", "probe four or more, far apart")
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
            away = max(NARROW_WIDTH_RATIO * 3 * length / MM, 10)
            hint = f"probe one more point off the line by {away:.0f} mm or more"
            raise _refuse("align.collinear", text, hint)
    ratio = float(np.sqrt(((b - b.mean(axis=0)) ** 2).sum() / ((a - a.mean(axis=0)) ** 2).sum()))
    if not 0.8 < ratio < 1.25:
        raise _refuse(
            "align.units",
            f"the points of {arms[1]} are {ratio:.4g} times as far apart as those of {arms[0]}, "
            "allowed about 1" + _unit_guess(ratio),
            "give the points of both robots in mm, row by row the same point",
        )
    one, other = (
        a - (b @ pose[:3, :3].T + pose[:3, 3])
        for pose in (_fit(a, b, np.ones(len(a)), m) for m in (False, True))
    )
    rms, mirrored = (float(np.sqrt((r**2).sum() / len(a))) for r in (one, other))
    if rms > 5.0 * MM and mirrored < 0.2 * rms:
        text = (
            f"the points of {arms[1]} are a mirror image of those of {arms[0]}: {mirrored / MM:.2f} mm off "
            f"as an image, {rms / MM:.0f} mm off as they are (in the mean)"
        )
        raise _refuse("align.mirrored", text, "check for an axis with the wrong sign, or two swapped columns")


def _unit_guess(ratio: float) -> str:
    for name, unit in LENGTH_UNITS.items():
        for factor, text in ((unit / MM, "those of the first"), (MM / unit, "those of the second")):
            if name != "mm" and abs(ratio / factor - 1.0) < 0.05:
                return f"; {text} seem to be in {name!r}, not mm"
    return ""


def _disagreeing_pair(
    alignment: Alignment, a: FloatArray, b: FloatArray, names: Sequence[str], tolerance: float
) -> Issue:
    """Issue if no single point is to blame.

    It names the two points whose distance the robots disagree on most.
    """
    i, j = np.triu_indices(len(a), 1)
    gap = np.linalg.norm(a[i] - a[j], axis=1) - np.linalg.norm(b[i] - b[j], axis=1)
    k = int(np.argmax(np.abs(gap)))
    worst = float(alignment.distance[alignment.used].max()) / MM
    return Issue(
        "align.large_residual",
        format_message(
            "align.large_residual",
            max_distance_mm=worst,
            tolerance_mm=tolerance / MM,
            disagreement_mm=abs(gap[k]) / MM,
            first_point=names[i[k]],
            second_point=names[j[k]],
        ),
        value=worst,
        limit=tolerance / MM,
        unit="mm",
        hint="probe them again and a few more, check both TCPs, or allow more: --tolerance-mm",
    )


def _refuse(code: str, text: str, hint: str) -> TandemError:
    return issue_error(code, text, hint=hint)
