"""Where a scan lies: coarse by probed marks, fine by the flat of the sheet around the part.

The marks are places that both the sheet's frame and the scan know, in the clamp or on the sheet. Their rigid
fit is the first pose. Then the flat is put on its plane, point to plane, over the points within a few
millimetres of it and the best share of these, with the marks as further rows of the same least squares: a
flat holds height and tilt alone, the marks hold the rest. What is formed comes back when it is let go of, so
nothing of it is used; a fit to the whole part would hide what is to be measured by tilting it.
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
from planner.issues import TandemError, refusal
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.align.rigid_fit import align, bad_points

NAMES: Final = ("sheet", "scan")
"""What columns of a file of marks begin with."""
MARKED: Final = 3.0 * MM
"""Points of the flat are within this [m] of it after marks, at first."""
UNMARKED: Final = 8.0 * MM
"""The same without marks."""
TRIMMED: Final = 0.8
"""Share of the nearest points that decides."""
ROUNDS: Final = 30
"""Rounds of the fine fit at most."""
SETTLED: Final = 1e-8
"""A round that moves the scan by less [m] is the last one."""
LEAST_POINTS: Final = 200
"""Points of the flat at least."""
MOST_POINTS: Final = 200_000
"""Points of the flat that are used at most; of more every so manieth."""
LEAST_NOISE: Final = 5e-6
"""Scans and marks are no better than this [m]."""
MOST_NOISE: Final = 0.5 * MM
"""The flat is off a plane by no more [m], one standard deviation: stray points alone are."""
LEAST_NEAR: Final = 0.2 * MM
"""Points within this [m] of the flat are of it in any case."""
AGREE: Final = 0.15 * MM
"""Marks that are off by more [m] do not agree: which of them is doubted is told."""
MAD: Final = 1.4826
"""A standard deviation over the median of absolute deviations, of a normal distribution."""
FEW: Final = 50_000
"""Points of a scan at which a mirror image is tried."""
MIRRORED_SHARE: Final = 0.05
"""Of its points that lie on the flat, if it was one."""
LEAST_SPREAD: Final = 0.25
"""The flat's points are spread over this share of the sheet's shorter side at least, both ways."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pose:
    """``matrix`` (4, 4) carries points of the scan into the sheet's frame. ``flat``: how many points of the
    flat decide, ``noise`` [m] how far they are off it, one standard deviation; ``marks`` by name with what is
    left of each [m], none where the scan was taken to be in the sheet's frame.

    ``within`` (6,): standard deviations of its turns about x, y and z [rad] and its ways along them [m], at
    the sheet's origin; infinite where nothing holds it. ``doubtful``: the fewest marks without which the
    others agree, where they do not."""

    matrix: FloatArray
    flat: int
    noise: float
    marks: dict[str, float]
    within: FloatArray
    doubtful: tuple[str, ...] = ()

    @property
    def beside(self) -> float:
        """How well [m] the place in the sheet's plane is known, one standard deviation."""
        return float(np.hypot(self.within[3], self.within[4]))

    @property
    def turned(self) -> float:
        """How well [rad] the turn is known, one standard deviation."""
        return float(np.linalg.norm(self.within[:3]))


@dataclasses.dataclass(frozen=True, eq=False)
class Flat:
    """The flat of a sheet around what is formed: the ``area`` in its plane [m] at the height ``level`` [m] of
    the face that is scanned, of a sheet whose shorter side is ``side`` [m]."""

    area: shapely.Geometry
    level: float
    side: float

    def holds(self, points: FloatArray, within: float) -> BoolArray:
        """Which of the points (N, 3) are over or under the area, and within so much [m] of its height."""
        near = np.abs(points[:, 2] - self.level) <= within
        out = np.zeros(len(points), dtype=bool)
        some = np.flatnonzero(near)
        out[some] = shapely.contains_xy(self.area, points[some, 0], points[some, 1])
        return out


def register(points: FloatArray, flat: Flat, marks: ProbedPoints | None) -> Pose:
    """The pose of a scan's ``points`` (N, 3) [m].

    Raises ``TandemError``: scan.flat where too little of the flat is in the scan, and for marks what
    `align.rigid_fit.align` raises.
    """
    pose = np.eye(4)
    names: tuple[str, ...] = ()
    known = np.zeros((0, 3)), np.zeros((0, 3))
    if marks is not None:
        known, names = (marks.first, marks.second), marks.names
        pose = align(*known, names, NAMES).pose
    shapely.prepare(flat.area)
    near = MARKED if names else UNMARKED
    some = points[flat.holds(transform(pose, points), near)]
    if names and len(some) < LEAST_POINTS:
        raise _beside_marks(points, flat, pose, len(some))
    some = some[:: max(1, -(-len(some) // MOST_POINTS))]
    noise, count, within = near, 0, np.full(6, np.inf)
    for _ in range(ROUNDS):
        there = transform(pose, some)
        rows = np.flatnonzero(flat.holds(there, near))
        _require_flat(there[rows], flat, near)
        off = there[rows, 2] - flat.level
        off = np.abs(off - np.median(off))
        noise = max(MAD * float(np.median(off)), LEAST_NOISE)
        best = there[rows[np.argsort(off, kind="stable")[: int(TRIMMED * len(rows))]]]
        turn, way, within = _step(best, flat.level, noise, pose, known)
        pose, count = from_parts(exp_rotation(turn), way) @ pose, len(best)
        if float(np.abs(way).max() + np.abs(turn).max() * flat.side) < SETTLED:
            break
        near = max(6.0 * noise, LEAST_NEAR)
    if noise > MOST_NOISE:
        what = (
            f"the flat around the part is off a plane by {noise / MM:.2f} mm, allowed {MOST_NOISE / MM:g} mm"
        )
        raise _no_flat(what, noise / MM, MOST_NOISE / MM)
    rest = lengths(known[0] - transform(pose, known[1]))
    left = {name: float(value) for name, value in zip(names, rest, strict=True)}
    bad = bad_points(*known, AGREE) if len(names) > 3 and float(rest.max()) > AGREE else None
    return Pose(pose, count, noise, left, within, tuple(names[k] for k in bad or ()))


def _step(
    flat: FloatArray, level: float, noise: float, pose: FloatArray, known: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A small turn (3,) [rad] and way (3,) [m] that put points (N, 3) on the plane z = ``level`` and the
    marks on their places, in the least squares of both over their noises; and the standard deviations (6,) of
    both, infinite where nothing says them."""
    rows = np.zeros((len(flat), 6))
    rows[:, 0], rows[:, 1], rows[:, 5] = flat[:, 1], -flat[:, 0], 1.0  # (p x n, n) with n = z
    normal = rows.T @ rows / noise**2
    right = -rows.T @ (flat[:, 2] - level) / noise**2
    out = np.zeros(6)
    some = [0, 1, 5]  # without marks nothing says where it lies in the plane
    if len(known[0]):
        some = list(range(6))
        there = transform(pose, known[1])
        left = there - known[0]
        loose = max(float(np.sqrt((left**2).sum() / max(3 * len(left) - 6, 1))), LEAST_NOISE)
        for place, rest in zip(there, left, strict=True):
            mark = np.hstack([-skew(place), np.eye(3)])
            normal += mark.T @ mark / loose**2
            right -= mark.T @ rest / loose**2
    spread = np.linalg.inv(normal[np.ix_(some, some)])
    out[some] = spread @ right[some]
    within = np.full(6, np.inf)
    within[some] = np.sqrt(np.diag(spread))
    return out[:3], out[3:], within


def _require_flat(there: FloatArray, flat: Flat, near: float) -> None:
    spread = np.ptp(there[:, :2], axis=0) if len(there) else np.zeros(2)
    if len(there) >= LEAST_POINTS and float(spread.min()) >= LEAST_SPREAD * flat.side:
        return
    x, y = spread / MM
    what = (
        f"got {len(there)} points within {near / MM:.2g} mm of the flat around the part, {x:.0f} x {y:.0f} "
        f"mm across, allowed {LEAST_POINTS} or more over {LEAST_SPREAD * flat.side / MM:.0f} mm both ways: "
        "where the scan lies is known by what does not come back"
    )
    raise _no_flat(what, float(len(there)), float(LEAST_POINTS))


def _beside_marks(points: FloatArray, flat: Flat, pose: FloatArray, count: int) -> TandemError:
    """A scan that is not where its marks are: another frame or unit than theirs, or an axis that is turned
    round in one of both."""
    what = (
        f"got {count} points of the scan within {MARKED / MM:g} mm of the flat around the part, where the "
        f"marks put it, allowed {LEAST_POINTS} or more: where the scan lies is known by what does not come "
        "back"
    )
    hint = (
        "scan the flat around the part too, say which face is scanned (--face), see that marks and scan are "
    )
    hint += "in one frame and unit"
    some = points[:: max(1, len(points) // FEW)]
    for axis, name in enumerate("xyz"):
        turned = some.copy()
        turned[:, axis] *= -1.0
        if flat.holds(transform(pose, turned), MARKED).mean() >= MIRRORED_SHARE:
            what += f"; with {name} of the scan turned round it would lie there"
            hint = f"look for the wrong sign of {name}, in the scan or in the marks' columns scan.{name}_mm"
            break
    return _no_flat(what, float(count), float(LEAST_POINTS), hint)


def _no_flat(
    what: str,
    got: float,
    limit: float,
    hint: str = "scan the flat around the part too, say which face is scanned (--face), give marks (--marks)",
) -> TandemError:
    return refusal("scan.flat", what, value=got, limit=limit, hint=hint)


def told(pose: Pose) -> str:
    """Where the scan was found, in a line."""
    x, y, z = pose.matrix[:3, 3] / MM
    angle = float(np.linalg.norm(log_rotation(pose.matrix[:3, :3]))) / DEG
    worst = max(pose.marks.values(), default=0.0) / MM
    held = (
        f"{len(pose.marks)} marks, {worst:.3f} mm off at most, so in its plane within {pose.beside / MM:.3f} "
        f"mm, turned within {pose.turned / DEG:.3f} deg (one standard deviation)"
        if pose.marks
        else "no marks, so x, y and the turn about z as the scan has them"
    )
    return (
        f"moved by ({x:.3f}, {y:.3f}, {z:.3f}) mm, turned by {angle:.3f} deg; {held}; {pose.flat} points of "
        f"the flat, {pose.noise / MM:.3f} mm off it (one standard deviation)"
    )
