"""Windows of a long path: the stretches of it that a program over the freedoms may better most.

A program over all of tens of thousands of targets would take longer than all the rest. A few windows of it
are left free instead, first where those joints that freedoms move accelerate or jerk hardest on the clock of
the path, then where these joints cost most; between windows, and at a few targets at their ends, the path
stays, with its slopes.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import subset
from planner.motion.trajectory.differences import Band, bands
from planner.motion.trajectory.hinges import margin_rows, preference_rows
from planner.motion.trajectory.trajopt import Improved, PathProblem, Weights, weights_of
from planner.targets import Targets

MOST_WINDOWS: Final = 8
"""Windows of a path at most."""
WINDOW: Final = 300
"""Targets of a window."""
HELD: Final = 3
"""Targets that stay at both ends of a window: as many as a jerk needs beside one that is free."""
SETTLED: Final = 12
"""A peak so many targets from the end of a window counts as one that the window may lower."""
LOOKED_AT: Final = 256
"""At about so many targets it is looked which joints the freedoms move."""
STILL: Final = 1e-9
"""Joints that go by less than this [rad] for a freedom's rad or m are not moved by it."""
WORTH_SHARE: Final = 0.02
"""Peaks that could come down by less than this share are left."""
LEAST_SHARE: Final = 1e-5
"""Where freedoms can change less than this share of the cost, and no peak, there are no windows."""


@dataclasses.dataclass(frozen=True)
class Windows:
    """Targets ``rows`` (K,) of a path, in their order, of which those ``held`` (K,) stay.

    ``weights`` of their cost; ``bands`` of their accelerations and jerks on the clock of the path, ``tops``
    (J,) the peaks of each of the two on the whole path, by joint, and ``goals`` what the hardest joint has
    where no window is, to which windows may bring it down. ``moved`` (J,): the joints that freedoms move;
    ``share``: of the cost, what these joints and all hinges have, so that no path gains more.
    """

    rows: IndexArray
    held: BoolArray
    weights: Weights
    bands: tuple[Band, ...]
    tops: tuple[FloatArray, ...]
    goals: tuple[float, ...]
    moved: BoolArray
    share: float

    @property
    def count(self) -> int:
        """How many windows there are; those that meet are one."""
        return int((np.diff(self.rows) > 1).sum()) + 1

    def into(self, path: Improved, part: Improved, before: FloatArray) -> Improved:
        """A path of all targets with that of the windows' targets ``part`` in it, which was made from the
        freedoms ``before`` (K, F) there."""
        values, q = path.values.copy(), {arm: angles.copy() for arm, angles in path.q.items()}
        values[self.rows] += part.values - before
        for arm, angles in q.items():
            angles[self.rows] = part.q[arm]
        return dataclasses.replace(path, values=values, q=q)

    def levels(self, joints: FloatArray) -> tuple[float, ...]:
        """How far the peaks of joints (K, J) are from the goals, 1 where they are at the path's own."""
        out = []
        for band, (goal, top) in zip(self.bands, self.bounds, strict=True):
            peak = float(np.abs(band.of(joints)).max(initial=0.0))
            out.append(max(peak - goal, 0.0) / (top - goal) if top > goal else 0.0)
        return tuple(out)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Goal and top of the hardest joint, of each band."""
        return [(goal, float(top.max(initial=0.0))) for goal, top in zip(self.goals, self.tops, strict=True)]


def chosen(
    scene: Scene,
    targets: Targets,
    branch: Mapping[str, int],
    path: Improved,
    duration: FloatArray,
    stop: BoolArray,
) -> Windows | str:
    """The windows of a path whose moves last ``duration`` (N - 1,) [s], with stops ``stop`` (N,); or why
    there are none."""
    if not targets.freedoms:
        return "nothing is free at any target"
    problem = PathProblem(scene, targets, branch, None)
    values, joints = problem.unwrapped(path.values), problem.stack(path.q)
    moved = _moved(scene, targets, branch, values, joints)
    own = bands(duration, stop)
    size = [np.abs(band.of(joints)) for band in own]
    tops = tuple(part.max(axis=0, initial=0.0) for part in size)
    floors = [float(top[~moved].max(initial=0.0)) for top in tops]
    most = [float(top.max(initial=0.0)) for top in tops]
    over = np.zeros(targets.count)
    for band, part, floor, top in zip(own, size, floors, most, strict=True):
        above = (part[:, moved].max(axis=1, initial=0.0) - floor) / max(top, 1e-12)
        np.maximum.at(over, band.first + band.weight.shape[1] // 2, np.where(above > WORTH_SHARE, above, 0.0))
    scaled = (joints / problem.speed)[:, moved]
    cost = _by_target(Weights(problem.stencil, problem.count), scaled)
    hinges = [
        *margin_rows(scene, targets.arms, joints, problem.count, slopes=False),
        *preference_rows(targets, values, problem.rings, problem.count),
    ]
    whole = problem.cost(values, joints)
    share = min(float(cost.sum() + sum(hinge.cost for hinge in hinges)) / max(whole, 1e-12), 1.0)
    if not over.any() and share < LEAST_SHARE:
        return f"its freedoms can change {100.0 * max(share, 0.0):.1g} % of its cost and no peak"
    free, held = _placed(over, cost)
    rows = np.flatnonzero(free)
    goals = [
        max(floor, float(part[_outside(band, free & ~held)][:, moved].max(initial=0.0)))
        for band, part, floor in zip(own, size, floors, strict=True)
    ]
    kept = tuple(_within(band, free) for band in own)
    weights = weights_of(targets, rows)
    return Windows(rows, held[rows], weights, kept, tops, tuple(goals), moved, share)


def _moved(
    scene: Scene, targets: Targets, branch: Mapping[str, int], values: FloatArray, joints: FloatArray
) -> BoolArray:
    """(J,) whether any freedom moves a joint, by a look at some targets."""
    rows = np.arange(0, targets.count, max(targets.count // LOOKED_AT, 1))
    some = PathProblem(scene, subset(targets, rows), branch, None)
    return np.asarray(np.abs(some.rates(values[rows], joints[rows])).max(axis=(0, 2)) > STILL)


def _by_target(weights: Weights, x: FloatArray) -> FloatArray:
    """What each target (N,) has of x' K x: K has rows that sum to 0, so that this is a sum of squares of
    differences."""
    out = np.zeros(len(x))
    for d in (1, 2):
        gap = x[d:] - x[:-d]
        out[d:] -= weights.stencil[d] * np.sum(gap * gap, axis=1)
    return out


def _placed(over: FloatArray, cost: FloatArray) -> tuple[BoolArray, BoolArray]:
    """(N,) the targets of the windows, and those of them that are held: the windows lie about the targets
    that have most ``over`` (N,), the rest where the ``cost`` (N,) is greatest."""
    count = len(over)
    free, inner = np.zeros((2, count), dtype=np.bool_)
    open_peaks = over.copy()
    open_peaks[:SETTLED] = open_peaks[count - SETTLED :] = 0.0  # the ends of the path stay
    width = min(WINDOW, count)
    for _ in range(MOST_WINDOWS):
        if open_peaks.any():
            first = int(np.argmax(open_peaks)) - width // 2
        else:
            sums = np.concatenate([[0.0], np.cumsum(np.where(free, 0.0, cost))])
            first = int(np.argmax(sums[width:] - sums[:-width]))
        first = min(max(first, 0), count - width)
        free[first : first + width] = True
        inner[first + HELD : first + width - HELD] = True
        open_peaks[first + SETTLED : first + width - SETTLED] = 0.0
    return free, free & ~inner


def _outside(band: Band, free: BoolArray) -> BoolArray:
    """(M,) the rows of a band that have no target that is free."""
    at = band.first[:, None] + np.arange(band.weight.shape[1])
    return np.asarray(~free[at].any(axis=1))


def _within(band: Band, free: BoolArray) -> Band:
    """The rows of a band all of whose targets are among those of windows, as rows of these."""
    at = band.first[:, None] + np.arange(band.weight.shape[1])
    kept = free[at].all(axis=1)
    place = np.cumsum(free) - 1
    return Band(place[band.first[kept]], band.weight[kept])
