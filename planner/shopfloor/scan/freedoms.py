"""Uncertainty of a scan's pose: with marks that agree, or without marks.

A flat determines height and tilt. Position and rotation in the plane of the flat follow from marks only. The
formed part would determine them too, but it springs back by what is to be measured. Without marks the scan's
own pose is used, and a warning states what that may hide: the translation and rotation in the plane that
explain most of the deviation, how much of it, and the effect of each millimetre and degree on the field.
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
"""Offset [m] of a scan beside the part above which it cannot be used for adjustment."""
SIDEWAYS_SHARE: Final = 0.1
"""Fraction of the deviation that the offset must explain for that."""
WEAK: Final = 0.05
"""Relative effect on the field below which a motion is not observable, compared with the strongest one."""
STEEPEST: Final = 98.0
"""Percentile of the places that determines the effect of a translation or rotation on the field."""
NEEDED: Final = "give three marks or more (--marks)"


@dataclasses.dataclass(frozen=True, eq=False)
class InPlaneMotion:
    """In-plane motion that explains the deviation of a scan by least squares.

    Attributes:
        move: (2,) [m] translation along x and y.
        turn: Rotation [rad] about the part's centre.
        fraction: Fraction of the sum of squares that it explains.
        per_way: Effect [m] on the field per metre of translation.
        per_turn: Effect [m] on the field per radian of rotation.
        radius: RMS distance [m] of the places from the centre.
        hidden: Components that are not observable on this part.
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
        """Whether the scan may well be offset from the part, by more than springback explains."""
        far = max(float(np.hypot(*self.move)), abs(self.turn) * self.radius)
        return self.fraction > SIDEWAYS_SHARE and far > SIDEWAYS


def in_plane_motion(measured: Deviation) -> InPlaneMotion:
    """Estimate the in-plane motion from a measured part."""
    known = np.isfinite(measured.deviation)
    deviations, normal = measured.deviation[known], measured.normal[known]
    arm = measured.point[known, :2] - measured.point[known, :2].mean(axis=0)
    radius = float(np.sqrt((arm**2).sum(axis=1).mean()))
    lever = arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]
    u, size, v = np.linalg.svd(np.column_stack([normal[:, :2], lever / radius]), full_matrices=False)
    shows = size > WEAK * size[0]
    # a rotation of a round part about its middle is not observable, nor a motion of a channel along its axis
    kept = (v[shows] ** 2).sum(axis=0)
    hidden = [name for name, one in zip(("x", "y", "the rotation"), kept, strict=True) if one < 0.5]
    best = v[shows].T @ ((u.T @ deviations)[shows] / size[shows])
    left = deviations - u[:, shows] @ (u.T @ deviations)[shows]
    explained = 1.0 - float(left @ left) / max(float(deviations @ deviations), 1e-30)
    steep = float(np.percentile(lengths(normal[:, :2]), STEEPEST))
    return InPlaneMotion(
        best[:2],
        float(best[2]) / radius,
        explained,
        steep,
        float(np.percentile(np.abs(lever), STEEPEST)),
        radius,
        tuple(hidden),
    )


def issues(measured: Deviation, pose: ScanPose, file: str) -> list[Issue]:
    """Warnings if the pose of a scan is unknown, or less accurate than the measurement of a part."""
    if not pose.marks:
        return [_no_marks(measured, file)]
    if pose.position_sigma <= MAX_POSITION_SIGMA_M and pose.rotation_sigma <= MAX_ROTATION_SIGMA:
        return []
    name, worst = max(pose.marks.items(), key=lambda item: item[1])
    what = (
        f"{file}: by its marks the scan is known to {pose.position_sigma / MM:.3f} mm in the sheet's plane "
        f"and {pose.rotation_sigma / DEG:.3f} deg of rotation (one standard deviation), allowed "
        f"{MAX_POSITION_SIGMA_M / MM:g} mm and {MAX_ROTATION_SIGMA / DEG:g} deg; {name!r} is "
        f"{worst / MM:.2f} mm off, the most of all"
    )
    if pose.doubtful:
        which = ", ".join(map(repr, pose.doubtful))
        what += f"; without {which} the others agree within {AGREE / MM:g} mm"
    hint = "measure the marks again, on the sheet and in the scan, or give more of them, farther apart"
    value, limit = pose.position_sigma / MM, MAX_POSITION_SIGMA_M / MM
    return [Issue("scan.marks", what, Severity.WARNING, value=value, limit=limit, unit="mm", hint=hint)]


def _no_marks(measured: Deviation, file: str) -> Issue:
    seen = in_plane_motion(measured)
    what = (
        f"{file}: no marks are given. The flat around the part fixes the scan's height and tilt; x, y and "
        "the rotation about z are taken as the scan has them, with unknown errors. "
        f"Each mm of offset adds up to {seen.per_way:.2f} mm to the deviation, each degree up to "
        f"{seen.per_turn * DEG / MM:.2f} mm. {_describe_motion(seen)}"
    )
    hint = f"{NEEDED}, unless the scanner is calibrated to the sheet's frame"
    value = float(np.hypot(*seen.move)) / MM
    return Issue("scan.no_marks", what, Severity.WARNING, value=value, unit="mm", hint=hint)


def _describe_motion(seen: InPlaneMotion) -> str:
    x, y = seen.move / MM
    text = (
        f"{100.0 * seen.fraction:.0f} % of the squared deviation looks as if the scan were offset by "
        f"({x:.2f}, {y:.2f}) mm from the part and rotated by {seen.turn / DEG:.2f} deg about its middle"
    )
    return text + (f"; {' and '.join(seen.hidden)} cannot be observed on this part" if seen.hidden else "")


def require_place(measured: Deviation, pose: ScanPose, file: str) -> None:
    """Require that a scan without marks does not look offset from its part.

    Targets would move by that offset.

    Raises:
        TandemError: scan.no_marks.
    """
    if pose.marks:
        return
    seen = in_plane_motion(measured)
    if not seen.is_offset:
        return
    what = (
        f"{file}: no marks are given, and {_describe_motion(seen)}; allowed are {SIDEWAYS / MM:g} mm, or "
        f"{100.0 * SIDEWAYS_SHARE:g} %: targets would be moved by the scan's offset, not by the springback"
    )
    hint = f"{NEEDED}; with a scanner calibrated to the sheet's frame they are the same in both frames"
    value, limit = float(np.hypot(*seen.move)) / MM, SIDEWAYS / MM
    raise issue_error("scan.no_marks", what, value=value, limit=limit, unit="mm", hint=hint)
