"""Registration of a scan: coarse by probed marks, fine by the flat of the sheet around the part.

Marks are positions that are known in the sheet's frame and in the scan, on the clamp or on the sheet. Their
rigid fit is the first pose. Then points of the flat within a few millimetres of it are fitted to its plane,
point to plane. Only the nearest fraction of them is used, and the marks are further equations of the same
least squares. A flat determines only height and tilt; the marks determine the rest. The formed part is not
used, because it springs back: a fit to the whole part would hide the deviation by tilting it.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    exp_rotation,
    from_parts,
    lengths,
    log_rotation,
    skew,
    transform,
)
from planner.geometry.units import DEG, MM
from planner.issues import TandemError, issue_error
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.align.rigid_fit import align, bad_points

NAMES: Final = ("sheet", "scan")
"""Prefixes of the columns of a file of marks: positions in the sheet's frame, and in the scan."""
MARKED: Final = 3.0 * MM
"""Initial distance [m] from the flat within which points belong to it, if the first pose is by marks."""
UNMARKED: Final = 8.0 * MM
"""Initial distance [m] from the flat within which points belong to it, without marks."""
TRIMMED: Final = 0.8
"""Fraction of the points of the flat that is used, nearest to its median height first."""
ROUNDS: Final = 30
"""Maximum number of rounds of the fine fit."""
SETTLED: Final = 1e-8
"""Motion [m] of the scan in a round below which the fit has converged."""
MIN_FLAT_POINTS: Final = 200
"""Minimum number of points of the flat."""
MAX_FLAT_POINTS: Final = 200_000
"""Maximum number of points of the flat. Larger scans are decimated."""
MIN_NOISE_M: Final = 5e-6
"""Minimum standard deviation [m] that is assumed for scans and marks."""
MAX_NOISE_M: Final = 0.5 * MM
"""Maximum standard deviation [m] of the points of the flat from its plane. Beyond it they are not a flat."""
MIN_FLAT_DISTANCE_M: Final = 0.2 * MM
"""Distance [m] from the flat within which points belong to it, however small their noise is."""
AGREE: Final = 0.15 * MM
"""Residual [m] of marks above which they disagree. The doubtful ones are reported."""
MAD: Final = 1.4826
"""Ratio of standard deviation to median absolute deviation, for a normal distribution."""
FEW: Final = 50_000
"""Approximate number of points of a scan with which mirror images are tried."""
MIRRORED_SHARE: Final = 0.05
"""Fraction of these points on the flat above which the scan is mirrored."""
MIN_EXTENT_RATIO: Final = 0.25
"""Minimum extent of the flat's points in both directions, as a fraction of the sheet's shorter side."""


@dataclasses.dataclass(frozen=True, eq=False)
class ScanPose:
    """Pose of a scan.

    Attributes:
        matrix: Pose (4, 4) that maps points of the scan into the sheet's frame.
        flat: Number of points of the flat that were used.
        noise: Standard deviation [m] of these points from the flat.
        marks: Residuals [m] of the marks by name; empty if the position in the plane is that of the scan's
            file.
        within: Standard deviations (6,) of rotations about x, y and z [rad] and translations along them [m],
            at the sheet's origin; infinite if undetermined.
        doubtful: If the marks disagree, the smallest set of marks without which the others agree.
    """

    matrix: FloatArray
    flat: int
    noise: float
    marks: dict[str, float]
    within: FloatArray
    doubtful: tuple[str, ...] = ()

    @property
    def position_sigma(self) -> float:
        """Standard deviation [m] of the position in the sheet's plane."""
        return float(np.hypot(self.within[3], self.within[4]))

    @property
    def rotation_sigma(self) -> float:
        """Standard deviation [rad] of the rotation."""
        return float(np.linalg.norm(self.within[:3]))


@dataclasses.dataclass(frozen=True, eq=False)
class Flat:
    """Flat of a sheet around what is formed.

    Attributes:
        area: Its area in the sheet's plane [m].
        level: Height [m] of the scanned face.
        side: Shorter side [m] of the sheet.
    """

    area: shapely.Geometry
    level: float
    side: float

    def holds(self, points: FloatArray, within: float) -> BoolArray:
        """Return whether points (N, 3) [m] are above or below the area, and ``within`` [m] of its height."""
        is_near = np.abs(points[:, 2] - self.level) <= within
        out = np.zeros(len(points), dtype=bool)
        candidates = np.flatnonzero(is_near)
        out[candidates] = shapely.contains_xy(self.area, points[candidates, 0], points[candidates, 1])
        return out


def register(points: FloatArray, flat: Flat, marks: ProbedPoints | None) -> ScanPose:
    """Compute the pose of a scan in the sheet's frame, from the flat around the part and from marks.

    The pose starts from the marks, or from the scan's own frame. It is improved in steps that move the points
    of the flat to its plane. Points farther from the plane than the rest are left out.

    Args:
        points: Points (N, 3) [m] of the scan.
        flat: Flat around the part.
        marks: Marks in both frames; None without.

    Raises:
        TandemError: ``scan.flat`` if the scan shows too little of the flat or it is not plane; errors of
            `align.rigid_fit.align` for marks.
    """
    pose = np.eye(4)
    names: tuple[str, ...] = ()
    mark_pairs = np.zeros((0, 3)), np.zeros((0, 3))
    if marks is not None:
        mark_pairs = (marks.first, marks.second)
        names = marks.names
        pose = align(*mark_pairs, names, NAMES).pose
    shapely.prepare(flat.area)
    max_distance = MARKED if names else UNMARKED
    flat_points = points[flat.holds(transform(pose, points), max_distance)]
    if names and len(flat_points) < MIN_FLAT_POINTS:
        raise _no_flat_at_marks(points, flat, pose, len(flat_points))
    # -(-a // b) is a / b rounded up: every n-th point, so that at most MAX_FLAT_POINTS remain
    flat_points = flat_points[:: max(1, -(-len(flat_points) // MAX_FLAT_POINTS))]
    noise, count, within = max_distance, 0, np.full(6, np.inf)
    for _ in range(ROUNDS):
        moved_points = transform(pose, flat_points)
        near = np.flatnonzero(flat.holds(moved_points, max_distance))
        _require_flat(moved_points[near], flat, max_distance)
        heights = moved_points[near, 2] - flat.level
        heights = np.abs(heights - np.median(heights))
        noise = max(MAD * float(np.median(heights)), MIN_NOISE_M)
        best = moved_points[near[np.argsort(heights, kind="stable")[: int(TRIMMED * len(near))]]]
        rotation, shift, within = _step(best, flat.level, noise, pose, mark_pairs)
        pose = from_parts(exp_rotation(rotation), shift) @ pose
        count = len(best)
        if float(np.abs(shift).max() + np.abs(rotation).max() * flat.side) < SETTLED:
            break
        max_distance = max(6.0 * noise, MIN_FLAT_DISTANCE_M)
    if noise > MAX_NOISE_M:
        message = (
            f"the flat around the part is not plane: {noise / MM:.2f} mm off, allowed {MAX_NOISE_M / MM:g} mm"
        )
        raise _no_flat(message, noise / MM, MAX_NOISE_M / MM)
    residuals = lengths(mark_pairs[0] - transform(pose, mark_pairs[1]))
    residual_by_mark = {name: float(value) for name, value in zip(names, residuals, strict=True)}
    # with only three marks no bad one can be identified
    bad = bad_points(*mark_pairs, AGREE) if len(names) > 3 and float(residuals.max()) > AGREE else None
    return ScanPose(pose, count, noise, residual_by_mark, within, tuple(names[k] for k in bad or ()))


def _step(
    flat: FloatArray, level: float, noise: float, pose: FloatArray, mark_pairs: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute a least-squares step of a scan's pose.

    It moves points ``flat`` (N, 3) [m] with a standard deviation ``noise`` [m] to the plane z = ``level``,
    and the marks to their positions. ``mark_pairs`` are marks (M, 3) [m] in the sheet's frame, and in the
    scan.

    Returns:
        Rotation vector (3,) [rad], translation (3,) [m], and their standard deviations (6,), which are
            infinite for components that nothing determines.
    """
    jacobian = np.zeros((len(flat), 6))
    # (p x n, n) with n = z
    jacobian[:, 0], jacobian[:, 1], jacobian[:, 5] = flat[:, 1], -flat[:, 0], 1.0
    normal_matrix = jacobian.T @ jacobian / noise**2
    right_side = -jacobian.T @ (flat[:, 2] - level) / noise**2
    step = np.zeros(6)
    determined = [0, 1, 5]  # without marks the position in the plane is unknown
    if len(mark_pairs[0]):
        determined = list(range(6))
        mark_positions = transform(pose, mark_pairs[1])
        residuals = mark_positions - mark_pairs[0]
        # 3 M coordinates determine 6 unknowns
        mark_noise = max(float(np.sqrt((residuals**2).sum() / max(3 * len(residuals) - 6, 1))), MIN_NOISE_M)
        for position, residual in zip(mark_positions, residuals, strict=True):
            mark_jacobian = np.hstack([-skew(position), np.eye(3)])
            normal_matrix += mark_jacobian.T @ mark_jacobian / mark_noise**2
            right_side -= mark_jacobian.T @ residual / mark_noise**2
    covariance = np.linalg.inv(normal_matrix[np.ix_(determined, determined)])
    step[determined] = covariance @ right_side[determined]
    within = np.full(6, np.inf)
    within[determined] = np.sqrt(np.diag(covariance))
    return step[:3], step[3:], within


def _require_flat(points: FloatArray, flat: Flat, max_distance: float) -> None:
    """Raise ``scan.flat`` if points (N, 3) [m] of the flat are too few or cover too little of the sheet."""
    extent = np.ptp(points[:, :2], axis=0) if len(points) else np.zeros(2)
    if len(points) >= MIN_FLAT_POINTS and float(extent.min()) >= MIN_EXTENT_RATIO * flat.side:
        return
    x, y = extent / MM
    message = (
        f"got {len(points)} points within {max_distance / MM:.2g} mm of the flat around the part, {x:.0f} x "
        f"{y:.0f} mm across, allowed {MIN_FLAT_POINTS} or more over {MIN_EXTENT_RATIO * flat.side / MM:.0f} "
        "mm both ways: the scan is located by the flat, which does not spring back"
    )
    raise _no_flat(message, float(len(points)), float(MIN_FLAT_POINTS))


def _no_flat_at_marks(points: FloatArray, flat: Flat, pose: FloatArray, count: int) -> TandemError:
    """Return the error of a scan that is not on the flat when its marks are at their positions.

    Then scan and marks have different frames or units, or an axis of one of them is inverted.
    """
    message = (
        f"got {count} points of the scan within {MARKED / MM:g} mm of the flat around the part, where the "
        f"marks put it, allowed {MIN_FLAT_POINTS} or more: the scan is located by the flat, which does not "
        "spring back"
    )
    hint = (
        "scan the flat around the part too, state which face is scanned (--face), check that marks and scan "
    )
    hint += "are in the same frame and unit"
    sample = points[:: max(1, len(points) // FEW)]
    for axis, name in enumerate("xyz"):
        mirrored_points = sample.copy()
        mirrored_points[:, axis] *= -1.0
        if flat.holds(transform(pose, mirrored_points), MARKED).mean() >= MIRRORED_SHARE:
            message += f"; with the sign of {name} reversed in the scan it would fit"
            hint = f"check for a wrong sign of {name}, in the scan or in the marks' columns scan.{name}_mm"
            break
    return _no_flat(message, float(count), float(MIN_FLAT_POINTS), hint)


def _no_flat(
    message: str,
    got: float,
    limit: float,
    hint: str = "scan the flat around the part too, state the scanned face (--face), give marks (--marks)",
) -> TandemError:
    return issue_error("scan.flat", message, value=got, limit=limit, hint=hint)


def describe_pose(pose: ScanPose) -> str:
    """Return a description of a scan's pose and its accuracy, in one line."""
    x, y, z = pose.matrix[:3, 3] / MM
    angle = float(np.linalg.norm(log_rotation(pose.matrix[:3, :3]))) / DEG
    worst_mm = max(pose.marks.values(), default=0.0) / MM
    basis = (
        f"{len(pose.marks)} marks, {worst_mm:.3f} mm off at most, so known to {pose.position_sigma / MM:.3f} "
        f"mm in its plane and {pose.rotation_sigma / DEG:.3f} deg (one standard deviation)"
        if pose.marks
        else "no marks, so x, y and the rotation about z are those of the scan"
    )
    return (
        f"moved by ({x:.3f}, {y:.3f}, {z:.3f}) mm, turned by {angle:.3f} deg; {basis}; {pose.flat} points of "
        f"the flat, {pose.noise / MM:.3f} mm off it (one standard deviation)"
    )
