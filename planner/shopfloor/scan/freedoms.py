"""How well a scan's place is known: by marks that agree, or by none.

A flat holds height and tilt. Where the scan lies in the flat's plane, and how it is turned there, marks say
and nothing else: the formed part would too, but it comes back by what is to be measured. So without marks the
scan is taken as it lies, and told is what that may hide: which move and turn in the plane would explain most
of what the part is off, how much of it, and what each millimetre and degree puts on the field.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, refusal
from planner.shopfloor.scan.deviation import Deviation
from planner.shopfloor.scan.registration import AGREE, Pose

WANTED_WAY: Final = 0.05 * MM
WANTED_TURN: Final = 0.05 * DEG
"""Places of scans by marks that are known less well, one standard deviation, are told."""
SIDEWAYS: Final = 0.2 * MM
"""A scan that may lie farther [m] beside the part than this is no scan to adjust by,"""
SIDEWAYS_SHARE: Final = 0.1
"""where this explains more than such a share of what it is off."""
WEAK: Final = 0.05
"""Moves that change the field by less than such a share of what the strongest one does do not show on it."""
STEEPEST: Final = 98.0
"""Percentile of the places that says what a move or turn puts on the field."""
NEEDED: Final = "give three marks or more (--marks)"


@dataclasses.dataclass(frozen=True, eq=False)
class Sideways:
    """A move (2,) [m] along x and y and a turn [rad] about the part's middle that explain what a scan is off,
    by least squares, and what ``share`` of its sum of squares. A metre beside puts ``per_way`` [m] on the
    field, a radian ``per_turn`` [m]; ``hidden``: which of them do not show on this part. ``radius`` [m] is
    the distance of its places from the middle, in the mean."""

    move: FloatArray
    turn: float
    share: float
    per_way: float
    per_turn: float
    radius: float
    hidden: tuple[str, ...]

    @property
    def beside(self) -> bool:
        """Whether the scan may well lie beside the part, by more than what comes back lets expect."""
        far = max(float(np.hypot(*self.move)), abs(self.turn) * self.radius)
        return self.share > SIDEWAYS_SHARE and far > SIDEWAYS


def sideways(found: Deviation) -> Sideways:
    """What a measured part says of a move and a turn in the sheet's plane."""
    known = np.isfinite(found.off)
    off, normal = found.off[known], found.normal[known]
    arm = found.point[known, :2] - found.point[known, :2].mean(axis=0)
    radius = float(np.sqrt((arm**2).sum(axis=1).mean()))
    lever = arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]
    u, size, v = np.linalg.svd(np.column_stack([normal[:, :2], lever / radius]), full_matrices=False)
    shows = size > WEAK * size[0]
    # a part that is round about its middle is the same after a turn, a channel after a move along it
    kept = (v[shows] ** 2).sum(axis=0)
    hidden = [name for name, one in zip(("x", "y", "the turn"), kept, strict=True) if one < 0.5]
    best = v[shows].T @ ((u.T @ off)[shows] / size[shows])
    left = off - u[:, shows] @ (u.T @ off)[shows]
    share = 1.0 - float(left @ left) / max(float(off @ off), 1e-30)
    steep = float(np.percentile(lengths(normal[:, :2]), STEEPEST))
    return Sideways(
        best[:2],
        float(best[2]) / radius,
        share,
        steep,
        float(np.percentile(np.abs(lever), STEEPEST)),
        radius,
        tuple(hidden),
    )


def issues(found: Deviation, pose: Pose, file: str) -> list[Issue]:
    """Warnings where a scan's place is not known, or less well than a part is measured."""
    if not pose.marks:
        return [_no_marks(found, file)]
    if pose.beside <= WANTED_WAY and pose.turned <= WANTED_TURN:
        return []
    name, worst = max(pose.marks.items(), key=lambda item: item[1])
    what = (
        f"{file}: by its marks the scan lies within {pose.beside / MM:.3f} mm in the sheet's plane and is "
        f"turned within {pose.turned / DEG:.3f} deg (one standard deviation), wanted {WANTED_WAY / MM:g} mm "
        f"and {WANTED_TURN / DEG:g} deg; {name!r} is {worst / MM:.2f} mm off, most of all"
    )
    if pose.doubtful:
        which = ", ".join(map(repr, pose.doubtful))
        what += f"; without {which} the others agree within {AGREE / MM:g} mm"
    hint = "measure the marks again, in the sheet and in the scan, or give more of them, farther apart"
    value, limit = pose.beside / MM, WANTED_WAY / MM
    return [Issue("scan.marks", what, Severity.WARNING, value=value, limit=limit, unit="mm", hint=hint)]


def _no_marks(found: Deviation, file: str) -> Issue:
    seen = sideways(found)
    what = (
        f"{file}: no marks are given. The flat around the part says the scan's height and tilt; x, y and the "
        "turn about z it leaves free: they are taken as the scan has them, and how far off they are is not "
        f"known. Each mm beside puts up to {seen.per_way:.2f} mm on what the part is off, each degree up to "
        f"{seen.per_turn * DEG / MM:.2f} mm. {_as_if(seen)}"
    )
    hint = f"{NEEDED}, unless the scanner is calibrated to the sheet's frame"
    value = float(np.hypot(*seen.move)) / MM
    return Issue("scan.no_marks", what, Severity.WARNING, value=value, unit="mm", hint=hint)


def _as_if(seen: Sideways) -> str:
    x, y = seen.move / MM
    told = (
        f"{100.0 * seen.share:.0f} % of it (squared) is as if the scan lay ({x:.2f}, {y:.2f}) mm beside the "
        f"part, turned by {seen.turn / DEG:.2f} deg about its middle"
    )
    return told + (f"; of {' and '.join(seen.hidden)} this part shows nothing" if seen.hidden else "")


def require_place(found: Deviation, pose: Pose, file: str) -> None:
    """Raise ``TandemError`` (scan.no_marks) where no marks are given and a scan looks as if it lay beside its
    part: targets would be moved by that."""
    if pose.marks:
        return
    seen = sideways(found)
    if not seen.beside:
        return
    what = (
        f"{file}: no marks are given, and {_as_if(seen)}; allowed are {SIDEWAYS / MM:g} mm, or "
        f"{100.0 * SIDEWAYS_SHARE:g} %: targets would be moved by where the scan lies, not by what came back"
    )
    hint = f"{NEEDED}; of a scanner that is calibrated to the sheet's frame they are the same in both frames"
    value, limit = float(np.hypot(*seen.move)) / MM, SIDEWAYS / MM
    raise refusal("scan.no_marks", what, value=value, limit=limit, unit="mm", hint=hint)
