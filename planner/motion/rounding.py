"""What corners between moves ask of the clock.

A controller gives each move a speed of its own and rounds off the corners, so joint speeds change within what
a corner takes of the moves beside it. Where a zone is small, or a corner sharp, they change faster there than
on the spline that the clock follows.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planner import corners
from planner.geometry.rigid import to_quaternion
from planner.motion.joints import Dense, in_work_frames
from planner.motion.plain_toppra import LinearConstraint
from planner.motion.scene import Scene
from planner.targets import Targets
from planner.units import MM

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

WHOLE: Final = 0.5
"""Share of a move that a corner takes at most: corners at both its ends meet in the middle."""
LEAST: Final = 1e-4
"""Least share of a move that a corner counts with."""
MOST_RAMP: Final = 2.0
"""A move from or to a stop ends or begins at most so many times as fast as it is on average."""
LOOKS: Final = 65
"""Moments at which a move from or to a stop is looked at."""


def shares(scene: Scene, targets: Targets, samples: Dense, duration: FloatArray) -> FloatArray:
    """At least which share (N,) of the shorter move beside it the corner at each target is rounded over, for
    moves to the targets whose times are in proportion to ``duration`` (N,)."""
    rows = np.flatnonzero(samples.share == 1.0)
    poses = {arm: scene.chains[arm].pose(samples.q[arm][rows]) for arm in targets.arms}
    deviation = corners.deviations(targets, targets.segment[1:])
    zone, own = np.full((2, targets.count), WHOLE)
    for arm, pose in in_work_frames(targets, poses).items():
        levers: FloatArray = np.full(3, corners.LEVER)
        if scene.model is not None:
            levers = corners.levers(targets, arm, scene.model.cell.arm(arm).tool)
        quaternion = to_quaternion(pose[:, :3, :3])
        found = corners.shares(pose[:, :3, 3] / MM, quaternion, duration[1:], levers, deviation)
        zone[1:-1] = np.minimum(zone[1:-1], found[0])
        own[1:-1] = np.minimum(own[1:-1], found[1])
    if scene.model is not None and scene.model.cell.controller.path == "spline":
        zone[1:-1] = 0.0  # blocks have none: the proof rounds their corners as it does where there is no zone
    return np.asarray(np.maximum(np.maximum(zone, own), LEAST))


def from_stop_to_stop(spline: CubicSpline, acceleration: FloatArray) -> float:
    """Least time [s] of a path that is one move, within the joint accelerations (J,): controllers take such a
    move by a cubic, whose ends ask for more than a clock that brakes as late as it can."""
    return float(np.sqrt(_cubic(spline(spline.x), 0.0, acceleration)))


def ramps(
    spline: CubicSpline, knots: FloatArray, duration: FloatArray, acceleration: FloatArray
) -> tuple[float, float]:
    """Shares of the joint accelerations (J,) that the first move from a stop and the last one to a stop ask
    for, if the moves between the positions ``knots`` last ``duration`` (n,) [s]: each is a cubic too, which
    is as fast at its other end as its neighbour is."""
    at, mean = np.searchsorted(spline.x, knots), np.diff(knots) / duration
    values = spline(spline.x)
    first, last = values[: at[1] + 1], values[at[-2] :][::-1]
    starts, ends = (
        float(np.clip(next_to / own, 1.0, MOST_RAMP)) for own, next_to in (mean[:2], mean[:-3:-1])
    )
    begins = _cubic(first, starts, acceleration) / duration[0] ** 2
    return begins, _cubic(last, ends, acceleration) / duration[-1] ** 2


def _ramp(half: float, duration: float, step: float, neighbour: float) -> tuple[float, float]:
    """Path speed at ``half`` [s] from the moving end of a ramp, and the way from there to that end: of a move
    over ``step`` that lasts ``duration`` [s], whose other neighbour goes at the speed ``neighbour``."""
    rate = float(np.clip(neighbour * duration / step, 1.0, MOST_RAMP))
    x, c2, c3 = 1.0 - half / duration, 3.0 - rate, rate - 2.0
    return x * (2.0 * c2 + 3.0 * c3 * x) * step / duration, (1.0 - x * x * (c2 + c3 * x)) * step


def _cubic(values: FloatArray, end: float, acceleration: FloatArray) -> float:
    """The most that a move over the joints ``values`` (K, J), which part it evenly in space, asks for of the
    accelerations (J,) if it lasts a second: from rest to ``end`` times as fast as it is on average."""
    way = CubicSpline(np.linspace(0.0, 1.0, len(values)), values)
    x = np.linspace(0.0, 1.0, LOOKS)
    c2, c3 = 3.0 - end, end - 2.0
    share, rate, change = x * x * (c2 + c3 * x), x * (2.0 * c2 + 3.0 * c3 * x), 2.0 * c2 + 6.0 * c3 * x
    asked = np.abs(way(share, 1) * change[:, None] + way(share, 2) * rate[:, None] ** 2) / acceleration
    return float(asked.max())


@dataclasses.dataclass(frozen=True)
class Corners:
    """Corners at the inner targets (n,) of a piece: ``before``, ``after`` (n, J) the slopes of the joints
    over the path just before and behind each at an even speed in space, ``step`` (n + 1,) the lengths of the
    moves, ``taken`` (n,) the share of the shorter one of two that their corner is rounded over on each side.
    """

    before: FloatArray
    after: FloatArray
    step: FloatArray
    taken: FloatArray

    @staticmethod
    def of(spline: CubicSpline, knots: FloatArray, taken: FloatArray) -> Corners:
        """Of a path with targets at the positions ``knots`` (n + 2,), among the breaks of the spline, which
        part each move evenly in space: there it goes at an even speed, whatever the joints do."""
        at = np.searchsorted(spline.x, knots)
        parts, step = np.diff(at), np.diff(knots)
        slope = np.diff(spline(spline.x), axis=0) * np.repeat(parts / step, parts)[:, None]
        return Corners(slope[at[1:-1] - 1], slope[at[1:-1]], step, taken)

    def asked(self, duration: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Shares (n,) of the limits ``acceleration`` (J,) that the corners ask for if the moves last
        ``duration`` (n + 1,) [s]: each is rounded by the cubic that goes on from the moves beside it, of
        which those from and to stops are ramps."""
        mean = self.step / duration
        half = self.taken * np.minimum(duration[:-1], duration[1:])
        comes, goes = mean[:-1].copy(), mean[1:].copy()
        behind, ahead = comes * half, goes * half
        if len(half):
            comes[0], behind[0] = _ramp(half[0], duration[0], self.step[0], mean[1])
            goes[-1], ahead[-1] = _ramp(half[-1], duration[-1], self.step[-1], mean[-2])
        way = self.before * behind[:, None] + self.after * ahead[:, None]
        first, last = self.before * comes[:, None], self.after * goes[:, None]
        span = 2.0 * half[:, None]
        begins = 6.0 * way / span**2 - (4.0 * first + 2.0 * last) / span
        ends = (2.0 * first + 4.0 * last) / span - 6.0 * way / span**2
        return np.asarray((np.maximum(np.abs(begins), np.abs(ends)) / acceleration).max(axis=1))

    def demand(self) -> tuple[FloatArray, FloatArray]:
        """``slope`` and ``bend`` (n, J): at the path's acceleration u and squared speed x a corner asks for
        the joint accelerations slope u + bend x."""
        shorter = np.minimum(self.step[:-1], self.step[1:])
        window = (2.0 * self.taken * shorter)[:, None]
        middle = 0.5 * (self.step[:-1] + self.step[1:])[:, None]
        return 0.5 * (self.before + self.after) * middle / window, (self.after - self.before) / window


class CornerConstraint(LinearConstraint):  # type: ignore[misc]
    """Accelerations within ``acceleration`` (J,) at corners: ``slope`` u + ``bend`` x, (G, J) each at the
    grid points; rows of zeros ask for nothing."""

    def __init__(self, slope: FloatArray, bend: FloatArray, acceleration: FloatArray) -> None:
        super().__init__()
        self._slope, self._bend = slope, bend
        eye = np.eye(len(acceleration))
        self._rows, self._most = np.concatenate([eye, -eye]), np.concatenate([acceleration, acceleration])
        self.identical = True

    def compute_constraint_params(self, path: Any, gridpoints: FloatArray, *args: Any) -> tuple[Any, ...]:
        return self._slope, self._bend, np.zeros_like(self._slope), self._rows, self._most, None, None


def on_grid(
    corners: Corners, knots: FloatArray, grid: FloatArray, weaker: FloatArray, acceleration: FloatArray
) -> CornerConstraint:
    """What the corners ask for at the grid points (G,): each half of a move by the corner next to it, and
    nothing in moves from and to stops, which are ramps. ``weaker`` (n,) divides the limits of the corners."""
    slope, bend = corners.demand()
    inner = knots[1:-1]
    middle = 0.5 * (inner[1:] + inner[:-1])
    near = np.searchsorted(middle, grid)
    apart = (grid >= inner[0]) & (grid <= inner[-1])
    scale = np.where(apart, weaker[near], 0.0)[:, None]
    return CornerConstraint(slope[near] * scale, bend[near] * scale, acceleration)
