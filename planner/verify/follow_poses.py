"""Which target of a path meets each pose that it must pass, in order; the time grows with their number."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import exp_twist, inverse, log_pose, log_rotation

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_MISSED = 100
"""Poses that are missed before the search ends: each one is held against all of the path that is left."""
_WINDOW = 16
_BLOCK = 4096
_ROUNDS = 8
_START = 2.1  # rad: a third of a turn
_FAR = 1e-3
_AGAIN = 2
_NEAR = 1e-6


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
    paths: Sequence[FloatArray],
    poses: Sequence[FloatArray],
    free: Sequence[Sequence[FloatArray]],
    tolerance: tuple[float, float],
    bounds: Sequence[FloatArray] | None = None,
) -> Passing:
    """How tools that move together pass poses together: for each tool its path (S, 4, 4), S > 0, its poses
    (P, 4, 4) and what it is free in.

    ``free``: twists (6,), angular part first, along which a tool may be off in the pose's own frame, the
    later ones after the earlier ones; ``tolerance`` [m, rad]. A target may meet several poses one after the
    other, but no pose may be met before the one before it.

    ``bounds``: for each tool the range (F, 2) of each twist; what a tool moves beyond it is then off too, and
    a target of its own is taken for each pose wherever the next one meets it: along a free slide, or within
    a wide tolerance, one target meets many poses.
    """
    limits: Sequence[FloatArray | None] = [None] * len(paths) if bounds is None else bounds
    tools = zip(paths, poses, free, limits, strict=True)
    search = _Search(tuple(_Tool(a, inverse(b), tuple(c), d) for a, b, c, d in tools), np.array(tolerance))
    count, length = len(poses[0]), len(paths[0])
    target, off = np.zeros(count, dtype=np.int64), np.full((count, 2), np.nan)
    met = np.zeros(count, dtype=bool)
    i = start = missed = 0
    block = 1
    while i < count and missed < MOST_MISSED:
        # as a rule each pose is met by the target behind that of the pose before, and not yet by that one
        size = min(block, count - i, length - 1 - start)
        run = 0
        if size > 0:
            pose = np.arange(i, i + size)
            here, ahead = search.off(start + pose - i, pose), search.off(start + 1 + pose - i, pose)
            usual = search.meets(ahead) & (~search.meets(here) if bounds is None else pose > 0)
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
class _Tool:
    """A path, inverse poses, and what is free."""

    path: FloatArray
    back: FloatArray
    free: tuple[FloatArray, ...]
    bounds: FloatArray | None = None

    def off(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Way and angle (K, 2) between targets (K,) and poses (K,), without what is free."""
        value, twist = values(self.back[pose] @ self.path[target], self.free)
        off = np.stack([np.linalg.norm(twist[:, 3:], axis=1), np.linalg.norm(twist[:, :3], axis=1)], axis=1)
        if self.bounds is None or not self.free:
            return off
        turns = np.linalg.norm(np.stack(self.free)[:, :3], axis=1) > 0.0
        apart = value - self.bounds.mean(axis=1)
        apart = np.abs(apart - np.where(turns, 2.0 * np.pi * np.round(apart / (2.0 * np.pi)), 0.0))
        beyond = np.maximum(apart - 0.5 * np.diff(self.bounds, axis=1)[:, 0], 0.0)
        return np.asarray(
            off + np.stack([beyond[:, ~turns].sum(axis=1), beyond[:, turns].sum(axis=1)], axis=1)
        )


@dataclasses.dataclass(frozen=True)
class _Search:
    """Tools that move together, and the tolerances (2,)."""

    tools: tuple[_Tool, ...]
    tolerance: FloatArray

    def off(self, target: IntArray, pose: IntArray) -> FloatArray:
        """Way and angle (K, 2) of the tool that is farther off."""
        return np.asarray(np.max([tool.off(target, pose) for tool in self.tools], axis=0))

    def meets(self, off: FloatArray) -> NDArray[np.bool_]:
        """Whether ways and angles (K, 2) are within the tolerances."""
        return np.asarray((off <= self.tolerance).all(axis=1))

    def next(self, start: int, pose: int) -> tuple[int, FloatArray, bool]:
        """The first target from ``start`` on that meets a pose, else the nearest one; how far it is off."""
        size, first, length = _WINDOW, start, len(self.tools[0].path)
        found: list[FloatArray] = []
        while first < length:
            rows = np.arange(first, min(first + size, length))
            off = self.off(rows, np.full(len(rows), pose))
            good = np.flatnonzero(self.meets(off))
            if len(good):
                return int(rows[good[0]]), off[good[0]], True
            found.append(off)
            first, size = first + len(rows), 4 * size
        off = np.concatenate(found)
        best = int(np.argmin((off / self.tolerance).max(axis=1)))
        return start + best, off[best], False


def values(relative: FloatArray, free: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """The values (K, F) by which poses ``relative`` (K, 4, 4) have moved along the F free twists, one after
    the other, and what is left: twists (K, 6), angular part first.

    One twist is what the logarithm has of it. More than one are found by Newton's method, for turns do not
    commute; where that ends far off it starts again from other turns.
    """
    count = len(relative)
    if not free:
        return np.zeros((count, 0)), _twist(relative)
    axes = np.stack(free)
    if len(free) == 1:
        twist = _twist(relative)
        found = twist @ axes.T / (axes[0] @ axes[0])
        return found, twist - found @ axes
    best, left = _newton(relative, axes, _twist(relative) @ np.linalg.pinv(axes))
    turning = np.linalg.norm(axes[:, :3], axis=1) > 0.0
    for start in itertools.product(*((0.0, -_START, _START) if turns else (0.0,) for turns in turning)):
        far = np.flatnonzero(np.linalg.norm(left, axis=1) > _FAR)
        if not len(far):
            break
        again, off = _newton(relative[far], axes, np.tile(start, (len(far), 1)))
        nearer = np.linalg.norm(off, axis=1) < np.linalg.norm(left[far], axis=1)
        best[far[nearer]], left[far[nearer]] = again[nearer], off[nearer]
    for _ in range(_AGAIN):  # slow where two axes are nearly one
        far = np.flatnonzero(np.linalg.norm(left, axis=1) > _NEAR)
        if not len(far):
            break
        again, off = _newton(relative[far], axes, best[far])
        nearer = np.linalg.norm(off, axis=1) < np.linalg.norm(left[far], axis=1)
        best[far[nearer]], left[far[nearer]] = again[nearer], off[nearer]
    return best, left


def _newton(relative: FloatArray, axes: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    found = np.array(start, dtype=np.float64)
    for _ in range(_ROUNDS):
        behind = np.broadcast_to(np.eye(4), relative.shape)
        columns: list[FloatArray] = []
        for j in range(len(axes) - 1, -1, -1):  # the twist of each axis, seen from behind the later ones
            columns.insert(0, _seen(inverse(behind), axes[j]))
            behind = exp_twist(found[:, j, None] * axes[j]) @ behind
        left = log_pose(inverse(behind) @ relative)
        step = np.linalg.pinv(np.stack(columns, axis=2)) @ left[..., None]
        found = found + step[..., 0]
    for axis in range(len(axes)):
        relative = exp_twist(-found[:, axis, None] * axes[axis]) @ relative
    return found, _twist(relative)


def _seen(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """A twist (6,) as poses (K, 4, 4) see it: by the adjoint of each (Lynch and Park, "Modern Robotics",
    2017, definition 3.20)."""
    angular = pose[:, :3, :3] @ twist[:3]
    linear = pose[:, :3, :3] @ twist[3:] + np.cross(pose[:, :3, 3], angular)
    return np.concatenate([angular, linear], axis=1)


def _twist(relative: FloatArray) -> FloatArray:
    """Turn and way (K, 6) of poses (K, 4, 4)."""
    return np.concatenate([log_rotation(relative[:, :3, :3]), relative[:, :3, 3]], axis=1)
