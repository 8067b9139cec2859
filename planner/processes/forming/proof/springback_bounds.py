"""Springback at points of a pass, interpolated by the proof from the control points of a file.

On each level it is interpolated from one control point to the next around the loop, for the force at the
point, and between levels by height. The planner has its own interpolation. Both assume that the elastic
springback between control points is near the interpolated one; `verify.springback` recalculates it at some
points.
"""

import dataclasses
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.proof.face import ProofFace
from planner.processes.forming.proof.springback_file import FileControlPoint, FilePath

POINT_SPACING_M = 1e-3
"""Spacing [m] of the points of a path at which its shifts are checked."""


@dataclasses.dataclass(frozen=True, eq=False)
class FilePass:
    """A pass of a springback file, at P points.

    Attributes:
        claim: Claim on the pass.
        face: Its face.
        path: Path of the file.
        controls: Control points.
        arc: Arc lengths (P,) [m] of the points.
        touch: Points (P, 3) [m] at which the forming tool touches the claimed face.
        angle: Wall angles (P,) [rad] there.
        force: Minimum and maximum force (2, P) [N] there.
        ring: Index (P,) of the ring, a loop of the path, of each point.
        rise: Height range (P,) [m] of the touched points of the ring, as in a spiral.
    """

    claim: FormsSheet
    face: ProofFace
    path: FilePath
    controls: tuple[FileControlPoint, ...]
    arc: FloatArray
    touch: FloatArray
    angle: FloatArray
    force: FloatArray
    ring: IntArray
    rise: FloatArray

    @property
    def shift(self) -> FloatArray:
        """Shifts (P,) [m] that the file states."""
        return np.asarray(np.interp(self.arc, arc_lengths(self.path.point), self.path.shift))

    @cached_property
    def springback_bounds(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Result of :func:`springback_bounds_at`, calculated once."""
        return springback_bounds_at(self)

    def level_groups(self) -> tuple[dict[int, float], dict[int, list[FileControlPoint]]]:
        """Return the mean height z [m] of the control points of each level, and these points, by level."""
        groups: dict[int, list[FileControlPoint]] = {}
        for control in self.controls:
            groups.setdefault(control.level, []).append(control)
        return {k: float(np.mean([c.point[2] for c in group])) for k, group in groups.items()}, groups


def arc_lengths(points: FloatArray) -> FloatArray:
    """Return the arc length (N,) [m] along a polyline (N, 3)."""
    step = points[1:] - points[:-1]
    return np.append(0.0, np.cumsum(np.sqrt((step * step).sum(axis=1))))


def springback_bounds_at(file_pass: FilePass) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the bounds of the springback at the points of a pass, by the control points of its file.

    On each level it is interpolated from one control point to the next around the loop, for the minimum and
    the maximum force, and between levels by height. The height is varied by the height range of the ring.

    Returns:
        Minimum and maximum springback (P,) [m], and the maximum difference (P,) [m] of the adjacent levels.
    """
    count = len(file_pass.arc)
    level_height, groups = file_pass.level_groups()
    order = sorted(groups, key=lambda level: level_height[level])
    height = np.array([level_height[level] for level in order])
    table = np.empty((len(order), 2, count))  # springback by level, force bound and point
    for k in np.unique(file_pass.ring):
        rows = np.flatnonzero(file_pass.ring == k)
        along = file_pass.arc[rows] - file_pass.arc[rows[0]]
        loop_length = float(along[-1]) + POINT_SPACING_M
        tree = cKDTree(file_pass.touch[rows, :2])
        for row, level in enumerate(order):
            group = groups[level]
            control_plan = np.array([control.point[:2] for control in group])
            knot_arc = along[np.asarray(tree.query(control_plan)[1])]
            table[row, :, rows] = _interpolate_on_loop(
                along, knot_arc, group, file_pass.force[:, rows], loop_length
            ).T
    candidates, column = [], np.arange(count)
    level_difference = np.zeros(count)
    for direction in (-1.0, 0.0, 1.0):
        z = np.clip(file_pass.touch[:, 2] + direction * file_pass.rise, height[0], height[-1])
        above = np.clip(np.searchsorted(height, z), 1, max(len(height) - 1, 1))
        below = np.minimum(above - 1, len(height) - 1)
        above = np.minimum(above, len(height) - 1)
        level_step = np.where(above > below, height[above] - height[below], 1.0)
        fraction = np.clip((z - height[below]) / level_step, 0.0, 1.0)
        for low, high in zip(
            (table[below, end, column] for end in (0, 1)),
            (table[above, end, column] for end in (0, 1)),
            strict=True,
        ):
            candidates.append(low * (1.0 - fraction) + high * fraction)
            level_difference = np.maximum(level_difference, np.abs(high - low))
    return np.min(candidates, axis=0), np.max(candidates, axis=0), level_difference


def _interpolate_on_loop(
    along: FloatArray,
    knot_arc: FloatArray,
    controls: list[FileControlPoint],
    force: FloatArray,
    loop_length: float,
) -> FloatArray:
    """Return the springback (2, R) [m] at points of a closed loop, linear from one control point to the next.

    The points are at the arc lengths ``along`` (R,) [m] of ``loop_length`` [m], under the minimum and maximum
    force ``force`` (2, R) [N]; the control points are at ``knot_arc`` (C,) [m].
    """
    order = np.argsort(knot_arc)
    knots = knot_arc[order]
    previous = (np.searchsorted(knots, along, side="right") - 1) % len(knots)
    following = (previous + 1) % len(knots)
    gap = (knots[following] - knots[previous]) % loop_length
    gap = np.where(gap > 0.0, gap, loop_length)
    fraction = ((along - knots[previous]) % loop_length) / gap
    out = np.zeros_like(force)
    for k, row in enumerate(order):
        for end, weight in ((previous, 1.0 - fraction), (following, fraction)):
            selected = end == k
            out[:, selected] += weight[selected] * controls[row].springback_under(force[:, selected])
    return out


def limit_slope(arc: FloatArray, value: FloatArray, slope: float) -> FloatArray:
    """Return the largest curve (P,) below a given one that starts at 0 and has a limited slope.

    Args:
        arc: Arc lengths (P,) [m].
        value: Given curve (P,), not negative.
        slope: Maximum slope.
    """
    out = value.tolist()
    arc_list = arc.tolist()
    out[0] = 0.0
    for k in range(1, len(out)):
        out[k] = min(out[k], out[k - 1] + slope * (arc_list[k] - arc_list[k - 1]))
    for k in range(len(out) - 2, -1, -1):
        out[k] = min(out[k], out[k + 1] + slope * (arc_list[k + 1] - arc_list[k]))
    return np.array(out)


def moving_mean(arc: FloatArray, value: FloatArray, half: float) -> FloatArray:
    """Return the moving mean (P,) of a curve over ``half`` [m] on either side, less near its ends."""
    area = np.append(0.0, np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(arc)))
    reach = np.minimum(half, np.minimum(arc - arc[0], arc[-1] - arc))
    window_area = np.interp(arc + reach, arc, area) - np.interp(arc - reach, arc, area)
    return np.asarray(np.where(reach > 1e-9, window_area / np.maximum(2.0 * reach, 1e-12), value))


def adjacent_controls(file_pass: FilePass, row: int) -> tuple[FileControlPoint, ...]:
    """Return the control points nearest in plan to point ``row`` of a pass on the levels around it."""
    height, groups = file_pass.level_groups()
    order = sorted(groups, key=lambda level: height[level])
    above = int(np.searchsorted([height[level] for level in order], file_pass.touch[row, 2]))
    levels = {order[min(above, len(order) - 1)], order[max(above - 1, 0)]}

    def plan_distance(control: FileControlPoint) -> float:
        return float(((control.point[:2] - file_pass.touch[row, :2]) ** 2).sum())

    return tuple(min(groups[level], key=plan_distance) for level in sorted(levels))
