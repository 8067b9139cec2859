"""Uncertainty of a scan's pose, with and without marks.

A flat determines height and tilt. Position and rotation in the plane of the flat follow from marks only. The
formed part would determine them too, but its springback is what is measured. Without marks, the pose that the
scan has in its file is used. A warning states what that may hide: the translation and rotation in the plane
that explain most of the deviation, which fraction of it, and the effect of each millimetre and degree.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, issue_error
from planner.shopfloor.scan.deviation import Deviation
from planner.shopfloor.scan.registration import AGREE, ScanPose

MAX_POSITION_SIGMA_M: Final = 0.05 * MM
"""Standard deviation of the position [m] above which a pose by marks gets a warning."""
MAX_ROTATION_SIGMA: Final = 0.05 * DEG
"""Standard deviation of the rotation [rad] above which a pose by marks gets a warning."""
SIDEWAYS: Final = 0.2 * MM
"""In-plane offset [m] of a scan from the part above which it cannot be used for adjustment."""
SIDEWAYS_SHARE: Final = 0.1
"""Fraction of the squared deviation that such an offset must also explain."""
WEAK: Final = 0.05
"""Effect of a motion on the deviation, relative to the strongest one, below which it is not observable."""
STEEPEST: Final = 98.0
"""Percentile over the places by which the effect of a translation or rotation on the deviation is stated."""
NEEDED: Final = "give three marks or more (--marks)"


@dataclasses.dataclass(frozen=True, eq=False)
class InPlaneMotion:
    """In-plane motion that explains the deviation of a scan by least squares.

    Attributes:
        move: Translation (2,) [m] along x and y.
        turn: Rotation [rad] about the centroid of the places.
        fraction: Fraction of the sum of squared deviations that it explains.
        per_way: Effect [m] on the deviation per metre of translation.
        per_turn: Effect [m] on the deviation per radian of rotation.
        radius: RMS distance [m] of the places from their centroid.
        hidden: Names of the components that are not observable on this part.
    """

    move: FloatArray
    turn: float
    fraction: float
    per_way: float
    per_turn: float
    radius: float
    hidden: tuple[str, ...]

    @property
    def is_offset(self) -> bool:
        """Whether the scan is probably offset from the part: the motion is large and explains enough."""
        distance = max(float(np.hypot(*self.move)), abs(self.turn) * self.radius)
        return self.fraction > SIDEWAYS_SHARE and distance > SIDEWAYS


def in_plane_motion(measured: Deviation) -> InPlaneMotion:
    """Estimate the in-plane motion of a scan that explains its deviations best.

    A scan that is registered at the wrong place in the plane shows such deviations. Only the components of
    the motion that change the deviations are estimated. The names of the others are in the result.
    """
    is_known = np.isfinite(measured.deviation)
    deviations, normal = measured.deviation[is_known], measured.normal[is_known]
    offsets = measured.point[is_known, :2] - measured.point[is_known, :2].mean(axis=0)
    radius = float(np.sqrt((offsets**2).sum(axis=1).mean()))
    # change of the deviation per rotation about z; divided by the radius it is comparable to translations
    rotation_effect = offsets[:, 0] * normal[:, 1] - offsets[:, 1] * normal[:, 0]
    u, size, v = np.linalg.svd(
        np.column_stack([normal[:, :2], rotation_effect / radius]), full_matrices=False
    )
    # not observable: a rotation of a round part about its middle, a motion of a channel along its axis
    is_shown = size > WEAK * size[0]
    observability = (v[is_shown] ** 2).sum(axis=0)
    hidden = [
        name
        for name, component in zip(("x", "y", "the rotation"), observability, strict=True)
        if component < 0.5  # less than half of this component is in the observable directions
    ]
    best = v[is_shown].T @ ((u.T @ deviations)[is_shown] / size[is_shown])
    residual = deviations - u[:, is_shown] @ (u.T @ deviations)[is_shown]
    explained = 1.0 - float(residual @ residual) / max(float(deviations @ deviations), 1e-30)
    steepness = float(np.percentile(lengths(normal[:, :2]), STEEPEST))
    return InPlaneMotion(
        best[:2],
        float(best[2]) / radius,
        explained,
        steepness,
        float(np.percentile(np.abs(rotation_effect), STEEPEST)),
        radius,
        tuple(hidden),
    )


def issues(measured: Deviation, pose: ScanPose, file: str) -> list[Issue]:
    """Return a warning if the pose of a scan has no marks, or is less accurate by them than required."""
    if not pose.marks:
        return [_no_marks(measured, file)]
    if pose.position_sigma <= MAX_POSITION_SIGMA_M and pose.rotation_sigma <= MAX_ROTATION_SIGMA:
        return []
    name, max_residual = max(pose.marks.items(), key=lambda item: item[1])
    message = (
        f"{file}: by its marks the scan is known to {pose.position_sigma / MM:.3f} mm in the sheet's plane "
        f"and {pose.rotation_sigma / DEG:.3f} deg of rotation (one standard deviation), allowed "
        f"{MAX_POSITION_SIGMA_M / MM:g} mm and {MAX_ROTATION_SIGMA / DEG:g} deg; {name!r} is "
        f"{max_residual / MM:.2f} mm off, the most of all"
    )
    if pose.doubtful:
        doubtful = ", ".join(map(repr, pose.doubtful))
        message += f"; without {doubtful} the others agree within {AGREE / MM:g} mm"
    hint = "measure the marks again, on the sheet and in the scan, or give more of them, farther apart"
    value, limit = pose.position_sigma / MM, MAX_POSITION_SIGMA_M / MM
    return [Issue("scan.marks", message, Severity.WARNING, value=value, limit=limit, unit="mm", hint=hint)]


def _no_marks(measured: Deviation, file: str) -> Issue:
    """Return the warning for a scan without marks, with the in-plane motion that its deviation looks like."""
    motion = in_plane_motion(measured)
    message = (
        f"{file}: no marks are given. The flat around the part fixes the scan's height and tilt; x, y and "
        "the rotation about z are taken as the scan has them, with unknown errors. "
        f"Each mm of offset adds up to {motion.per_way:.2f} mm to the deviation, each degree up to "
        f"{motion.per_turn * DEG / MM:.2f} mm. {_describe_motion(motion)}"
    )
    hint = f"{NEEDED}, unless the scanner is calibrated to the sheet's frame"
    value = float(np.hypot(*motion.move)) / MM
    return Issue("scan.no_marks", message, Severity.WARNING, value=value, unit="mm", hint=hint)


def _describe_motion(motion: InPlaneMotion) -> str:
    """Describe an in-plane motion as a sentence of a warning, with the components that cannot be observed."""
    x, y = motion.move / MM
    text = (
        f"{100.0 * motion.fraction:.0f} % of the squared deviation looks as if the scan were offset by "
        f"({x:.2f}, {y:.2f}) mm from the part and rotated by {motion.turn / DEG:.2f} deg about its middle"
    )
    return text + (
        f"; {' and '.join(motion.hidden)} cannot be observed on this part" if motion.hidden else ""
    )


def require_place(measured: Deviation, pose: ScanPose, file: str) -> None:
    """Require that a scan without marks does not look offset from its part.

    An adjustment would otherwise move targets by that offset.

    Raises:
        TandemError: ``scan.no_marks`` if it does.
    """
    if pose.marks:
        return
    motion = in_plane_motion(measured)
    if not motion.is_offset:
        return
    message = (
        f"{file}: no marks are given, and {_describe_motion(motion)}; allowed are {SIDEWAYS / MM:g} mm, or "
        f"{100.0 * SIDEWAYS_SHARE:g} %: targets would be moved by the scan's offset, not by the springback"
    )
    hint = f"{NEEDED}; with a scanner calibrated to the sheet's frame they are the same in both frames"
    value, limit = float(np.hypot(*motion.move)) / MM, SIDEWAYS / MM
    raise issue_error("scan.no_marks", message, value=value, limit=limit, unit="mm", hint=hint)
