"""What a springback file's control points say at places of a pass, by the proof's own interpolation: on each
level from one point to the next around the loop, each under the force at the place, and between levels by
height.

The planner has an interpolation of its own; both hold what is between control points for what an elastic
sheet says there, and `verify.springback` works out some of it anew.
"""

import dataclasses
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof.face import Face
from planner.processes.forming.proof.springback_file import Control, Way

STEP = 1e-3
"""Places of a way at which its shifts are looked at are so far apart [m]."""


@dataclasses.dataclass(frozen=True, eq=False)
class FilePass:
    """A pass of a file: its ``claim`` with its ``face``, ``way``, ``controls``. Of P places ``at`` (P,) [m]:
    ``touch`` (P, 3) [m], where the former touches the claimed face, the wall's ``angle`` (P,) [rad] there,
    the least and largest ``force`` (2, P) [N], the ``ring`` (P,) and by how much that goes up and down,
    ``rise`` (P,) [m]."""

    claim: FormsSheet
    face: Face
    way: Way
    controls: tuple[Control, ...]
    at: FloatArray
    touch: FloatArray
    angle: FloatArray
    force: FloatArray
    ring: IntArray
    rise: FloatArray

    @property
    def shift(self) -> FloatArray:
        """Shifts (P,) [m] that the file states."""
        return np.asarray(np.interp(self.at, gone(self.way.point), self.way.shift))

    @cached_property
    def between(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What :func:`bounds` says, worked out once."""
        return bounds(self)

    def levels(self) -> tuple[dict[int, float], dict[int, list[Control]]]:
        """Heights [m] of the levels, and their control points."""
        groups: dict[int, list[Control]] = {}
        for control in self.controls:
            groups.setdefault(control.level, []).append(control)
        return {k: float(np.mean([c.place[2] for c in some])) for k, some in groups.items()}, groups


def gone(points: FloatArray) -> FloatArray:
    """Way (N,) [m] along a polyline (N, 3)."""
    step = points[1:] - points[:-1]
    return np.append(0.0, np.cumsum(np.sqrt((step * step).sum(axis=1))))


def bounds(own: FilePass) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The least and largest springback (P,) [m] that control points say at the places of a pass: on each
    level from one to the next around the loop, each under the force there, between levels by height, and as
    the loop itself goes up or down by its step; and how much (P,) [m] the levels around differ."""
    count = len(own.at)
    known, groups = own.levels()
    order = sorted(groups, key=lambda level: known[level])
    height = np.array([known[level] for level in order])
    table = np.empty((len(order), 2, count))
    for k in np.unique(own.ring):
        rows = np.flatnonzero(own.ring == k)
        along = own.at[rows] - own.at[rows[0]]
        whole = float(along[-1]) + STEP
        tree = cKDTree(own.touch[rows, :2])
        for row, level in enumerate(order):
            some = groups[level]
            wanted = np.array([control.place[:2] for control in some])
            near = along[np.asarray(tree.query(wanted)[1])]
            table[row, :, rows] = _between(along, near, some, own.force[:, rows], whole).T
    either, column = [], np.arange(count)
    apart = np.zeros(count)
    for off in (-1.0, 0.0, 1.0):
        z = np.clip(own.touch[:, 2] + off * own.rise, height[0], height[-1])
        above = np.clip(np.searchsorted(height, z), 1, max(len(height) - 1, 1))
        below = np.minimum(above - 1, len(height) - 1)
        above = np.minimum(above, len(height) - 1)
        wide = np.where(above > below, height[above] - height[below], 1.0)
        share = np.clip((z - height[below]) / wide, 0.0, 1.0)
        for low, high in zip(
            (table[below, end, column] for end in (0, 1)),
            (table[above, end, column] for end in (0, 1)),
            strict=True,
        ):
            either.append(low * (1.0 - share) + high * share)
            apart = np.maximum(apart, np.abs(high - low))
    return np.min(either, axis=0), np.max(either, axis=0), apart


def _between(
    along: FloatArray, near: FloatArray, some: list[Control], force: FloatArray, whole: float
) -> FloatArray:
    """Springback (2, R) [m] at places of a loop, ``along`` (R,) [m] of ``whole`` [m], under ``force`` (2, R)
    [N]: linear from one of ``some`` control points, ``near`` (C,) [m], to the next."""
    order = np.argsort(near)
    knots = near[order]
    before = (np.searchsorted(knots, along, side="right") - 1) % len(knots)
    after = (before + 1) % len(knots)
    gap = (knots[after] - knots[before]) % whole
    gap = np.where(gap > 0.0, gap, whole)
    share = ((along - knots[before]) % whole) / gap
    out = np.zeros_like(force)
    for k, row in enumerate(order):
        for end, weight in ((before, 1.0 - share), (after, share)):
            mine = end == k
            out[:, mine] += weight[mine] * some[row].under(force[:, mine])
    return out


def slower(at: FloatArray, value: FloatArray, slope: float) -> FloatArray:
    """What of a curve (P,) is left that begins at 0 and changes by ``slope`` at most over ``at`` (P,) [m]."""
    out = value.tolist()
    way = at.tolist()
    out[0] = 0.0
    for k in range(1, len(out)):
        out[k] = min(out[k], out[k - 1] + slope * (way[k] - way[k - 1]))
    for k in range(len(out) - 2, -1, -1):
        out[k] = min(out[k], out[k + 1] + slope * (way[k + 1] - way[k]))
    return np.array(out)


def mean(at: FloatArray, value: FloatArray, half: float) -> FloatArray:
    """The mean (P,) of a curve over ``half`` [m] of its way on either side, less at its ends."""
    area = np.append(0.0, np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(at)))
    reach = np.minimum(half, np.minimum(at - at[0], at[-1] - at))
    both = np.interp(at + reach, at, area) - np.interp(at - reach, at, area)
    return np.asarray(np.where(reach > 1e-9, both / np.maximum(2.0 * reach, 1e-12), value))


def around(own: FilePass, row: int) -> tuple[Control, ...]:
    """The control points next to a place of a pass, of the level above it and of the one below."""
    height, groups = own.levels()
    order = sorted(groups, key=lambda level: height[level])
    above = int(np.searchsorted([height[level] for level in order], own.touch[row, 2]))
    levels = {order[min(above, len(order) - 1)], order[max(above - 1, 0)]}

    def away(control: Control) -> float:
        return float(((control.place[:2] - own.touch[row, :2]) ** 2).sum())

    return tuple(min(groups[level], key=away) for level in sorted(levels))
