"""Where a knife's blade cuts both faces of a sheet, and how the blade is aligned with its curve.

The blade is represented by lines parallel to its axis, from its back to its edge. A line has cut a face of
the sheet if its lower end is behind that face. Headings follow from the x axis of the TCP in the program
text. They are compared with directions of the curve along the blade.
"""

import dataclasses
from functools import cached_property

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.trim.claims import TrimBlade
from planner.processes.trim.proof.outlines import OutlineCurve
from planner.processes.trim.proof.torch_motion import (
    BEND_FRACTION,
    SAMPLE_STEP_M,
    SlotPath,
    TrimmedSheet,
    face_distance,
)

BLADE_LINES = 9
"""Number of lines of a blade that are followed along the whole path."""
END_SPACING_M = 0.04e-3
"""Distance of the lines where the blade enters and leaves the sheet [m]."""
FACE_TOLERANCE_M = 1e-6
"""A line that ends no farther above a face than this [m] has cut it."""
MIN_PLAN_CORNER_RAD = np.deg2rad(1.0)
"""Minimum angle of a corner, seen from above [rad]."""
CORNER_ERROR_RAD = np.deg2rad(1.0)
"""Possible difference of the angles of a corner as the planner and the proof read it [rad]."""
MIN_CHORD_M = 0.3e-3
"""Minimum length of chords that define directions [m]."""
DIRECTION_SAMPLES = 7
"""Number of directions of a curve with which a blade is compared at one point."""
MIN_ADVANCE_M = 0.1e-3
"""A knife that has moved along the face by less than this [m] has only entered the sheet."""


@dataclasses.dataclass(frozen=True)
class SharpCorners:
    """Sharp corners of a curve on the face, in order.

    Attributes:
        points: Points (C, 3) [m].
        normal: Normals (C, 3).
        incoming: Directions of the curve before them (C, 3).
        outgoing: Directions after them (C, 3).
        lengths: Lengths along the curve (C,) [m].
    """

    points: FloatArray
    normal: FloatArray
    incoming: FloatArray
    outgoing: FloatArray
    lengths: FloatArray

    def distance_past(self, points: FloatArray, max_distance: float) -> FloatArray:
        """Return how far (N,) [m] points are past the corner that they are least past.

        A point is past a corner if it is within ``max_distance`` of the straight continuation of one of its
        sides. The result is infinite for points that are past no corner.

        Args:
            points: Points (N, 3) [m].
            max_distance: Maximum distance from the continuation [m].
        """
        out = np.full(len(points), np.inf)
        for corner, normal, incoming, outgoing in zip(
            self.points, self.normal, self.incoming, self.outgoing, strict=True
        ):
            rest = points - corner
            for direction in (incoming, -outgoing):
                along, lateral = rest @ direction, np.abs(rest @ np.cross(normal, direction))
                out = np.where(
                    (lateral <= max_distance) & (along >= -max_distance), np.minimum(out, along), out
                )
        return out


def find_corners(work: TrimmedSheet, curve: OutlineCurve, min_angle: float) -> SharpCorners:
    """Return the corners of a curve at which a knife is lifted or may overcut.

    The angle of a corner is that between the two directions of the curve in the tangent plane of the face.
    Corners are in order of their length along the curve.

    Args:
        work: Claim with the motion.
        curve: Curve.
        min_angle: Minimum angle of a corner [rad].
    """
    flat = curve.plan_vertices
    step = np.roll(flat, -1, axis=0) - flat
    following = step / np.linalg.norm(step, axis=1, keepdims=True)
    previous = np.roll(following, 1, axis=0)
    plan_angle = np.arccos(np.clip((previous * following).sum(axis=1), -1.0, 1.0))
    candidates = np.flatnonzero(plan_angle > MIN_PLAN_CORNER_RAD)
    points, normal = work.sheet.at(flat[candidates])
    directions = []
    for plan_direction in (previous[candidates], following[candidates]):
        # z component that makes the direction tangential to the face; the bound avoids a division by 0
        up = -(plan_direction * normal[:, :2]).sum(axis=1) / np.maximum(normal[:, 2], 0.02)
        along = np.column_stack([plan_direction, up])
        directions.append(along / np.linalg.norm(along, axis=1, keepdims=True))
    angles = np.arccos(np.clip((directions[0] * directions[1]).sum(axis=1), -1.0, 1.0))
    lengths = curve.distance(points)[1]
    rows = np.flatnonzero(angles > min_angle)
    rows = rows[np.argsort(lengths[rows], kind="stable")]
    return SharpCorners(points[rows], normal[rows], directions[0][rows], directions[1][rows], lengths[rows])


@dataclasses.dataclass(frozen=True)
class BladeCut:
    """Points at which lines of a blade have cut one face of the sheet.

    Attributes:
        paths: Path of each line, and the lines along the blade where it enters and where it leaves.
        foot: Points of all paths, projected onto the near face (M, 3) [m].
        distances: Distances from the curve (M,) [m], negative on the part.
        at: Lengths along the curve (M,) [m].
        rows: Indices of the samples of the motion (M,).
    """

    paths: tuple[SlotPath, ...]
    foot: FloatArray
    distances: FloatArray
    at: FloatArray
    rows: IntArray


class BladePath:
    """Path of a knife in the slot with the key ``key``, with samples at most ``SAMPLE_STEP_M`` apart.

    Attributes:
        tip: Tips (N, 3) [m].
        axis: Directions from the TCP into the tool (N, 3).
        ahead: Cutting directions (N, 3), the x axes of the TCP.
        rows: Indices of the samples of the motion (N,).
        feet: Points at which the axis intersects the near face.
        deep: Depth of the tip behind the near face along the axis (N,) [m].
    """

    def __init__(self, work: TrimmedSheet, knife: TrimBlade, key: str) -> None:
        self.work, self.knife, self.curve = work, knife, work.slots[key]
        track, claim = work.slot_track(key), work.claim
        bend = BEND_FRACTION * claim.tolerance
        tip, axis, ahead, rows = track.spaced_with_x_axes(SAMPLE_STEP_M, bend, knife.blade.width)
        order = np.argsort(rows, kind="stable")
        self.tip, self.axis, self.ahead = tip[order], axis[order], ahead[order]
        self.rows = rows[order]
        self.feet, self.deep = work.project(self.tip, self.axis)

    @cached_property
    def has_advanced(self) -> BoolArray:
        """Whether (N,) the knife has moved along the face, not only into it."""
        return np.asarray(np.linalg.norm(self.feet.foot - self.feet.foot[0], axis=1) > MIN_ADVANCE_M)

    @cached_property
    def near_cut(self) -> BladeCut:
        """Cut of the near face."""
        return self._face_cut(False)

    @cached_property
    def far_cut(self) -> BladeCut:
        """Cut of the far face."""
        return self._face_cut(True)

    def _face_cut(self, is_far: bool) -> BladeCut:
        """Calculate where the blade has cut one face, ``is_far`` for the far one.

        ``BLADE_LINES`` lines of the blade are followed along the whole path. Where the blade reaches its
        depth and at the last sample, lines at most ``END_SPACING_M`` apart show how far the cut extends.
        """
        blade = self.knife.blade
        front = float(
            blade.front(min(float(self.deep.max()) + self.work.claim.height_tolerance, blade.length))
        )
        offsets = np.unique(np.append(np.linspace(-blade.end, front, BLADE_LINES), 0.0))
        all_rows = np.arange(len(self.tip))
        paths = [self._cut_lines(all_rows, np.full(len(all_rows), x), is_far) for x in offsets]
        end_offsets = np.linspace(
            -blade.end, front, max(int(np.ceil((blade.end + front) / END_SPACING_M)), 2)
        )
        # first sample at which the tip is at its depth within half of the height tolerance
        inside = int(np.argmax(self.deep >= self.deep.max() - 0.5 * self.work.claim.height_tolerance))
        ends = (np.full(len(end_offsets), row) for row in (inside, len(all_rows) - 1))
        paths += [self._cut_lines(row, end_offsets, is_far) for row in ends]
        foot = np.concatenate([path.feet.foot for path in paths])
        distances = np.concatenate([path.curve_distance for path in paths])
        at = np.concatenate([path.at for path in paths])
        rows = np.concatenate([path.rows for path in paths])
        return BladeCut(tuple(path for path in paths if len(path.rows)), foot, distances, at, rows)

    def _cut_lines(self, index: IntArray, offsets: FloatArray, is_far: bool) -> SlotPath:
        """Return where lines of a blade have cut a face, without those lines that have not.

        The lines are ``offsets`` (M,) [m] ahead of the TCP, at the samples ``index`` (M,) of the path.
        """
        blade, work = self.knife.blade, self.work
        axis = self.axis[index]
        base = self.tip[index] + offsets[:, None] * self.ahead[index]
        height = face_distance(work.other_side if is_far else work.sheet, base, axis)
        # before its straight end the edge rises linearly, by the ground height over the rest of the width
        front, slanted_width = np.maximum(offsets, 0.0), blade.width - blade.end
        lower_end = front / slanted_width * blade.ground if slanted_width > 0.0 else np.zeros(len(offsets))
        has_cut = (lower_end <= height + FACE_TOLERANCE_M) & (height <= blade.length)
        index, axis, points = index[has_cut], axis[has_cut], (base + height[:, None] * axis)[has_cut]
        feet = work.sheet.project(points)
        distances, at = self.curve.distance(feet.foot)
        distances = np.where(self.curve.in_waste(feet.foot), distances, -distances)
        return SlotPath(points, axis, feet, self.rows[index], distances, at, np.zeros(len(index)))

    def heading_errors(self) -> FloatArray:
        """Return by which angle (N,) [rad] the blade deviates from its curve, at each sample of the path.

        The curve has a range of directions within half of the blade's width on either side. The result is 0
        if the blade's direction is in this range, otherwise the angle to the nearest end of the range. Near a
        sharp corner the range is that before or that after the corner, whichever fits better.
        """
        work, curve, blade = self.work, self.curve, self.knife.blade
        normal, foot = self.feet.normal, self.feet.foot
        at = curve.distance(foot)[1]
        ends = find_corners(
            work, curve, self.knife.max_corner + CORNER_ERROR_RAD + work.sheet.normal_error
        ).lengths
        width_in_sheet = blade.end + float(blade.front(min(float(np.max(self.deep)), blade.length)))
        reach, best = max(0.5 * width_in_sheet, MIN_CHORD_M), np.full(len(at), np.inf)
        # low, high: section of the curve between two corners to which each sample may belong
        for low, high in _sides(at, ends, curve.length, width_in_sheet + work.edge_tolerance):
            low_angle, high_angle = np.full(len(at), np.inf), np.full(len(at), -np.inf)
            for x in np.linspace(-reach, reach, DIRECTION_SAMPLES):
                first = np.clip(at + x - 0.5 * MIN_CHORD_M, low, high - MIN_CHORD_M)
                last = np.maximum(np.minimum(first + MIN_CHORD_M, high), first + MIN_CHORD_M)
                angle = _line_angles(self.ahead, curve.points_at(last) - curve.points_at(first), normal)
                # range of the signed angles from the blade to the directions; it contains 0 if one fits
                low_angle, high_angle = np.minimum(low_angle, angle), np.maximum(high_angle, angle)
            best = np.minimum(best, np.maximum(np.maximum(low_angle, -high_angle), 0.0))
        return best


def _sides(
    at: FloatArray, ends: FloatArray, length: float, reach: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the sections between sharp corners to which points of a closed curve may belong.

    The points are at lengths ``at`` (N,) [m] of the curve, the corners at ``ends`` (C,) [m]. A point within
    ``reach`` [m] of a corner may also belong to the section on its other side. Each of the three alternatives
    has the start (N,) and end (N,) [m] of the section of each point.
    """
    if not len(ends):
        return [(np.full(len(at), -np.inf), np.full(len(at), np.inf))]
    corners = np.concatenate([ends + revolution * length for revolution in (-2.0, -1.0, 0.0, 1.0, 2.0)])
    k = np.searchsorted(corners, at, side="right")
    near_previous, near_next = at - corners[k - 1] < reach, corners[k] - at < reach
    return [
        (corners[k - 1], corners[k]),
        (
            np.where(near_previous, corners[k - 2], corners[k - 1]),
            np.where(near_previous, corners[k - 1], corners[k]),
        ),
        (np.where(near_next, corners[k], corners[k - 1]), np.where(near_next, corners[k + 1], corners[k])),
    ]


def _line_angles(ahead: FloatArray, direction: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the signed angle (N,) [rad] from ``ahead`` to ``direction`` about a normal, all (N, 3).

    Both are undirected lines, so the angle is within a quarter revolution.
    """
    across = (np.cross(ahead, direction) * normal).sum(axis=1)
    cosine_part = (ahead * direction).sum(axis=1) - (ahead * normal).sum(axis=1) * (direction * normal).sum(
        axis=1
    )
    return np.asarray(np.arctan2(np.where(cosine_part < 0.0, -across, across), np.abs(cosine_part)))


def blade_path(work: TrimmedSheet, knife: TrimBlade, key: str) -> BladePath:
    """Return the path of a knife in one slot, which is computed once and cached in ``work``.

    Args:
        work: Claim with the motion.
        knife: Knife.
        key: Key of the slot's segment.
    """
    if key not in work.cache:
        work.cache[key] = BladePath(work, knife, key)
    return work.cache[key]  # type: ignore[no-any-return]
