"""Which target of a path meets each pose that it must pass, in order; the time grows with their number."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import log_rotation

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_MISSED = 100
"""Poses that are missed before the search ends: each one is held against all of the path that is left."""
_WINDOW = 16
_BLOCK = 4096


@dataclasses.dataclass(frozen=True)
class Passing:
    """How poses are passed: the first targets (P,) in order that meet them, or where one is missed the
    nearest target left; the way and the angle (P, 2) [m, rad] that the target is off, and whether it is
    ``met`` (P,). ``looked``: poses looked at, fewer than P where too many were missed."""

    target: IntArray
    off: FloatArray
    met: NDArray[np.bool_]
    looked: int


def passing(
    path: FloatArray, poses: FloatArray, free: tuple[FloatArray, ...], tolerance: tuple[float, float]
) -> Passing:
    """How the path (S, 4, 4), S > 0, passes the poses (P, 4, 4).

    ``free``: twists (6,), angular part first, in the poses' own frames along which the path may be off;
    ``tolerance`` [m, rad]. A target may meet several poses one after the other, but no pose may be met before
    the one before it.
    """
    search = _Search(path, np.asarray(np.linalg.inv(poses)), _basis(free), np.array(tolerance))
    count = len(poses)
    target, off = np.zeros(count, dtype=np.int64), np.full((count, 2), np.nan)
    met = np.zeros(count, dtype=bool)
    i = start = missed = 0
    block = 1
    while i < count and missed < MOST_MISSED:
        # as a rule each pose is met by the target behind that of the pose before, and not yet by that one
        size = min(block, count - i, len(path) - 1 - start)
        run = 0
        if size > 0:
            pose = np.arange(i, i + size)
            here, ahead = search.off(start + pose - i, pose), search.off(start + 1 + pose - i, pose)
            usual = ~search.meets(here) & search.meets(ahead)
            run = size if usual.all() else int(np.argmin(usual))
            target[i : i + run], off[i : i + run] = start + 1 + pose[:run] - i, ahead[:run]
            met[i : i + run] = True
        i, start, block = i + run, start + run, min(max(1, 2 * run), _BLOCK)
        if run == size > 0 or i == count:
            continue
        target[i], off[i], met[i] = search.next(start, i)
        start = int(target[i]) if met[i] else start
        missed += not met[i]
        i += 1
    return Passing(target, off, met, i)


@dataclasses.dataclass(frozen=True)
class _Search:
    """A path, inverse poses, an orthonormal basis (6, F) of what is free, and the tolerances (2,)."""

    path: FloatArray
    back: FloatArray
    basis: FloatArray
    tolerance: FloatArray

    def off(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Way and angle (K, 2) between targets (K,) and poses (K,), without what is free."""
        relative = self.back[pose] @ self.path[target]
        twist = np.concatenate([log_rotation(relative[:, :3, :3]), relative[:, :3, 3]], axis=1)
        twist = twist - (twist @ self.basis) @ self.basis.T
        return np.stack([np.linalg.norm(twist[:, 3:], axis=1), np.linalg.norm(twist[:, :3], axis=1)], axis=1)

    def meets(self, off: FloatArray) -> NDArray[np.bool_]:
        """Whether ways and angles (K, 2) are within the tolerances."""
        return np.asarray((off <= self.tolerance).all(axis=1))

    def next(self, start: int, pose: int) -> tuple[int, FloatArray, bool]:
        """The first target from ``start`` on that meets a pose, else the nearest one; how far it is off."""
        size, first = _WINDOW, start
        found: list[FloatArray] = []
        while first < len(self.path):
            rows = np.arange(first, min(first + size, len(self.path)))
            off = self.off(rows, np.full(len(rows), pose))
            good = np.flatnonzero(self.meets(off))
            if len(good):
                return int(rows[good[0]]), off[good[0]], True
            found.append(off)
            first, size = first + len(rows), 4 * size
        off = np.concatenate(found)
        best = int(np.argmin((off / self.tolerance).max(axis=1)))
        return start + best, off[best], False


def _basis(free: tuple[FloatArray, ...]) -> FloatArray:
    return np.asarray(np.linalg.qr(np.stack(free, axis=1))[0]) if free else np.zeros((6, 0))
