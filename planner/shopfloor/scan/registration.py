"""Registration of a scan: coarse by probed marks, fine by the flat of the sheet around the part.

Marks are positions that are known in the sheet's frame and in the scan, on the clamp or on the sheet. Their
rigid fit is the first pose. Then the flat is fitted to its plane, point to plane, over the best fraction of
the points within a few millimetres of it, with the marks as further rows of the same least squares. A flat
determines only height and tilt; the marks determine the rest. What is formed springs back when it is
released, so it is not used: a fit to the whole part would hide the deviation by tilting it.
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
"""Prefixes of the columns of a file of marks."""
MARKED: Final = 3.0 * MM
"""Initial distance [m] from the flat within which points belong to it, after a fit of marks."""
UNMARKED: Final = 8.0 * MM
"""Initial distance [m] from the flat within which points belong to it, without marks."""
TRIMMED: Final = 0.8
"""Fraction of the nearest points that is used."""
ROUNDS: Final = 30
"""Maximum number of rounds of the fine fit."""
SETTLED: Final = 1e-8
"""Motion [m] of the scan below which a round is the last one."""
MIN_FLAT_POINTS: Final = 200
"""Minimum number of points of the flat."""
MAX_FLAT_POINTS: Final = 200_000
"""Maximum number of points of the flat. Larger scans are decimated."""
MIN_NOISE_M: Final = 5e-6
"""Minimum standard deviation [m] assumed for scans and marks."""
MAX_NOISE_M: Final = 0.5 * MM
"""Maximum standard deviation [m] of the flat from a plane. Beyond it only stray points were found."""
MIN_FLAT_DISTANCE_M: Final = 0.2 * MM
"""Distance [m] from the flat within which points belong to it in any case."""
AGREE: Final = 0.15 * MM
"""Residual [m] of marks above which they disagree. The doubtful ones are reported."""
MAD: Final = 1.4826
"""Ratio of standard deviation to median absolute deviation, for a normal distribution."""
FEW: Final = 50_000
"""Number of points of a scan with which a mirror image is tried."""
MIRRORED_SHARE: Final = 0.05
"""Fraction of these points on the flat above which the scan is mirrored."""
MIN_EXTENT_RATIO: Final = 0.25
"""Minimum extent of the flat's points in both directions, as a fraction of the sheet's shorter side."""


@dataclasses.dataclass(frozen=True, eq=False)
class ScanPose:
    """Pose of a scan.

    Attributes:
        matrix: (4, 4) maps points of the scan into the sheet's frame.
        flat: Number of points of the flat that were used.
        noise: Standard deviation [m] of these points from the flat.
        marks: {name: residual [m]}; empty if the scan was taken to be in the sheet's frame.
        within: (6,) standard deviations of its rotations about x, y and z [rad] and translations along them
            [m], at the sheet's origin; infinite if undetermined.
        doubtful: Smallest set of marks without which the others agree, if they do not.
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
        area: Its area in its plane [m].
        level: Height [m] of the scanned face.
        side: Shorter side [m] of the sheet.
    """

    area: shapely.Geometry
    level: float
    side: float

    def holds(self, points: FloatArray, within: float) -> BoolArray:
        """Whether points (N, 3) are above or below the area, and within a distance [m] of its height."""
        within_height = np.abs(points[:, 2] - self.level) <= within
        out = np.zeros(len(points), dtype=bool)
        candidates = np.flatnonzero(within_height)
        out[candidates] = shapely.contains_xy(self.area, points[candidates, 0], points[candidates, 1])
        return out


def register(points: FloatArray, flat: Flat, marks: ProbedPoints | None) -> ScanPose:
    """Compute the pose of a scan.

    Args:
        points: (N, 3) [m] points of the scan.
        flat: Flat around the part.
        marks: Marks in both frames.

    Raises:
        TandemError: scan.flat if the scan shows too little of the flat, and for marks what
            `align.rigid_fit.align` raises.
    """
    pose = np.eye(4)
    names: tuple[str, ...] = ()
    known = np.zeros((0, 3)), np.zeros((0, 3))
    if marks is not None:
        known, names = (marks.first, marks.second), marks.names
        pose = align(*known, names, NAMES).pose
    shapely.prepare(flat.area)
    max_distance = MARKED if names else UNMARKED
    flat_points = points[flat.holds(transform(pose, points), max_distance)]
    if names and len(flat_points) < MIN_FLAT_POINTS:
        raise _no_flat_at_marks(points, flat, pose, len(flat_points))
    flat_points = flat_points[:: max(1, -(-len(flat_points) // MAX_FLAT_POINTS))]
    noise, count, within = max_distance, 0, np.full(6, np.inf)
    for _ in range(ROUNDS):
        moved_points = transform(pose, flat_points)
        rows = np.flatnonzero(flat.holds(moved_points, max_distance))
        _require_flat(moved_points[rows], flat, max_distance)
        heights = moved_points[rows, 2] - flat.level
        heights = np.abs(heights - np.median(heights))
        noise = max(MAD * float(np.median(heights)), MIN_NOISE_M)
        best = moved_points[rows[np.argsort(heights, kind="stable")[: int(TRIMMED * len(rows))]]]
        turn, shift, within = _step(best, flat.level, noise, pose, known)
        pose, count = from_parts(exp_rotation(turn), shift) @ pose, len(best)
        if float(np.abs(shift).max() + np.abs(turn).max() * flat.side) < SETTLED:
            break
        max_distance = max(6.0 * noise, MIN_FLAT_DISTANCE_M)
    if noise > MAX_NOISE_M:
        what = (
            f"the flat around the part is not plane: {noise / MM:.2f} mm off, allowed {MAX_NOISE_M / MM:g} mm"
        )
        raise _no_flat(what, noise / MM, MAX_NOISE_M / MM)
    rest = lengths(known[0] - transform(pose, known[1]))
    left = {name: float(value) for name, value in zip(names, rest, strict=True)}
    bad = bad_points(*known, AGREE) if len(names) > 3 and float(rest.max()) > AGREE else None
    return ScanPose(pose, count, noise, left, within, tuple(names[k] for k in bad or ()))


def _step(
    flat: FloatArray, level: float, noise: float, pose: FloatArray, known: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Least-squares step: small rotation (3,) [rad] and translation (3,) [m].

    Their standard deviations (6,) are returned, too. The step moves points (N, 3) to the plane z = ``level``
    and the marks to their positions, each weighted by its noise. Standard deviations are infinite where
    nothing determines a component.
    """
    rows = np.zeros((len(flat), 6))
    rows[:, 0], rows[:, 1], rows[:, 5] = flat[:, 1], -flat[:, 0], 1.0  # (p x n, n) with n = z
    normal = rows.T @ rows / noise**2
    right = -rows.T @ (flat[:, 2] - level) / noise**2
    out = np.zeros(6)
    some = [0, 1, 5]  # without marks the position in the plane is unknown
    if len(known[0]):
        some = list(range(6))
        there = transform(pose, known[1])
        left = there - known[0]
        loose = max(float(np.sqrt((left**2).sum() / max(3 * len(left) - 6, 1))), MIN_NOISE_M)
        for place, rest in zip(there, left, strict=True):
            mark = np.hstack([-skew(place), np.eye(3)])
            normal += mark.T @ mark / loose**2
            right -= mark.T @ rest / loose**2
    spread = np.linalg.inv(normal[np.ix_(some, some)])
    out[some] = spread @ right[some]
    within = np.full(6, np.inf)
    within[some] = np.sqrt(np.diag(spread))
    return out[:3], out[3:], within


def _require_flat(points: FloatArray, flat: Flat, max_distance: float) -> None:
    spread = np.ptp(points[:, :2], axis=0) if len(points) else np.zeros(2)
    if len(points) >= MIN_FLAT_POINTS and float(spread.min()) >= MIN_EXTENT_RATIO * flat.side:
        return
    x, y = spread / MM
    what = (
        f"got {len(points)} points within {max_distance / MM:.2g} mm of the flat around the part, {x:.0f} x "
        f"{y:.0f} mm across, allowed {MIN_FLAT_POINTS} or more over {MIN_EXTENT_RATIO * flat.side / MM:.0f} "
        "mm both ways: the scan is located by the flat, which does not spring back"
    )
    raise _no_flat(what, float(len(points)), float(MIN_FLAT_POINTS))


def _no_flat_at_marks(points: FloatArray, flat: Flat, pose: FloatArray, count: int) -> TandemError:
    """Issue of a scan that is not where its marks are.

    It has another frame or unit, or an inverted axis in one of them.
    """
    what = (
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
            what += f"; with the sign of {name} reversed in the scan it would fit"
            hint = f"check for a wrong sign of {name}, in the scan or in the marks' columns scan.{name}_mm"
            break
    return _no_flat(what, float(count), float(MIN_FLAT_POINTS), hint)


def _no_flat(
    what: str,
    got: float,
    limit: float,
    hint: str = "scan the flat around the part too, state the scanned face (--face), give marks (--marks)",
) -> TandemError:
    return issue_error("scan.flat", what, value=got, limit=limit, hint=hint)


def describe_pose(pose: ScanPose) -> str:
    """Describe the pose of a scan in one line."""
    x, y, z = pose.matrix[:3, 3] / MM
    angle = float(np.linalg.norm(log_rotation(pose.matrix[:3, :3]))) / DEG
    worst = max(pose.marks.values(), default=0.0) / MM
    held = (
        f"{len(pose.marks)} marks, {worst:.3f} mm off at most, so known to {pose.position_sigma / MM:.3f} "
        f"mm in its plane and {pose.rotation_sigma / DEG:.3f} deg (one standard deviation)"
        if pose.marks
        else "no marks, so x, y and the rotation about z are those of the scan"
    )
    return (
        f"moved by ({x:.3f}, {y:.3f}, {z:.3f}) mm, turned by {angle:.3f} deg; {held}; {pose.flat} points of "
        f"the flat, {pose.noise / MM:.3f} mm off it (one standard deviation)"
    )
