"""Directions of forming tools along a path: their tilt, and how they are smoothed.

All is for a forming tool above the sheet; for one below, mirror in z first.

The contact jumps over facets, and a tool that is far from it would jerk: `smooth_directions` smooths the
directions along the path. `insert_targets` adds targets on the straight moves of a contact's path, where the
other tool needs them.
"""

from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d, uniform_filter1d

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.units import DEG
from planner.processes.forming.plan.contact import ContactPath


def tilt_from_vertical(normal: FloatArray, angle: FloatArray) -> FloatArray:
    """Return unit vectors (N, 3) at an angle from +z, in the direction in which normals tilt.

    Args:
        normal: Unit normals (N, 3); each result is in the plane of +z and its normal. A vertical one gives
            +z.
        angle: Angles (N,) [rad].
    """
    plan = normal[:, :2]
    length = np.linalg.norm(plan, axis=1, keepdims=True)
    direction = np.where(length > 1e-9, plan / np.maximum(length, 1e-9), 0.0)
    is_vertical = length[:, 0] <= 1e-9
    angle = np.where(is_vertical, 0.0, angle)
    return np.column_stack([np.sin(angle)[:, None] * direction, np.cos(angle)])


def tool_axes(normal: FloatArray, tilt: float) -> FloatArray:
    """Return unit vectors (N, 3) along the axis of a tool above the sheet, from the tool to the sheet.

    They tilt from -z toward the opposite of ``normal`` (N, 3), which points up, by ``tilt`` [rad], at most by
    the wall angle.
    """
    angle = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    return -tilt_from_vertical(normal, np.minimum(angle, tilt))


def max_angle_below_flat(height: FloatArray, distance: FloatArray, level: float, radius: float) -> FloatArray:
    """Return the largest tilts (N,) [rad] of the line of the balls that keep the support off the flat.

    The tilt is the angle from the vertical of the line from the forming ball's centre down to the supporting
    one. The flat is that around the feature.

    Args:
        height: Heights (N,) [m] of the forming ball's centre.
        distance: Distances (N,) [m] of the balls.
        level: Level [m] of the far face of the flat.
        radius: Radius [m] of the support.
    """
    return np.asarray(np.arccos(np.clip((height - level + radius) / distance, -1.0, 1.0)))


def max_nozzle_tilt(height: FloatArray, level: float, standoff: float, radius: float) -> FloatArray:
    """Return the largest tilt (N,) [rad] of a nozzle at which its edge stays under the flat.

    Args:
        height: Heights (N,) [m] of the point that it heats from below.
        level: Level [m] of the flat.
        standoff: Distance [m] of the nozzle from that point.
        radius: Radius [m] of the nozzle.
    """
    edge_distance = np.hypot(standoff, radius)
    max_tilt = np.arccos(np.clip((height - level) / edge_distance, -1.0, 1.0)) - np.arctan2(radius, standoff)
    return np.asarray(np.maximum(max_tilt, 0.0))


def angle_to_vertical_arc(line: FloatArray, normal: FloatArray) -> FloatArray:
    """Return angles (N,) [rad] of unit vectors to the arc from ``normal`` (N, 3) to +z.

    The angle is that to the nearest direction on the arc.

    Args:
        line: Unit vectors (N, 3).
        normal: Unit vectors (N, 3).
    """
    plan_length = np.linalg.norm(normal[:, :2], axis=1)
    direction = normal[:, :2] / np.maximum(plan_length, 1e-12)[:, None]
    # components in the frame of the arc: along it in plan, across it, and up
    along = dots(line[:, :2], direction)
    across = np.abs(direction[:, 0] * line[:, 1] - direction[:, 1] * line[:, 0])
    arc_angle = np.clip(np.arctan2(along, line[:, 2]), 0.0, np.arctan2(plan_length, normal[:, 2]))
    cosine = along * np.sin(arc_angle) + line[:, 2] * np.cos(arc_angle)
    return np.asarray(
        np.arctan2(np.hypot(across, along * np.cos(arc_angle) - line[:, 2] * np.sin(arc_angle)), cosine)
    )


def limit_rotation(first: FloatArray, second: FloatArray, max_angle: float | FloatArray) -> FloatArray:
    """Return unit vectors ``second`` (N, 3), limited to a given angle from unit vectors ``first`` (N, 3).

    ``max_angle`` [rad] is one angle or (N,). Vectors beyond it are replaced by those at that angle from
    ``first`` toward them.
    """
    angle = np.arccos(np.clip(dots(first, second), -1.0, 1.0))
    across = second - dots(first, second)[:, None] * first
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-12)
    limited = np.minimum(angle, max_angle)[:, None]
    return np.asarray(np.cos(limited) * first + np.sin(limited) * across)


def nearest_on_arc(line: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the vectors on arcs that are nearest to given unit vectors.

    Args:
        line: Unit vectors (N, 3).
        first: Starts (N, 3) of the shorter arcs.
        second: Ends (N, 3) of the arcs.
    """
    pole = np.cross(first, second)
    length = np.linalg.norm(pole, axis=1, keepdims=True)
    pole = pole / np.maximum(length, 1e-12)
    projected = line - dots(line, pole)[:, None] * pole
    size = np.linalg.norm(projected, axis=1, keepdims=True)
    projected = projected / np.maximum(size, 1e-12)
    is_inside = (dots(np.cross(first, projected), pole) >= 0.0) & (
        dots(np.cross(projected, second), pole) >= 0.0
    )
    is_inside &= (length[:, 0] > 1e-9) & (size[:, 0] > 1e-9)
    is_first_nearer = dots(line, first) >= dots(line, second)
    return np.where(is_inside[:, None], projected, np.where(is_first_nearer[:, None], first, second))


def angle_to_fan(line: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return angles (N,) [rad] of unit vectors ``line`` (N, 3) to spherical triangles.

    The corners of the triangles are ``first``, ``second`` (N, 3) and +z.
    """
    angle = np.minimum(angle_to_vertical_arc(line, first), angle_to_vertical_arc(line, second))
    cosine = dots(line, nearest_on_arc(line, first, second))
    angle = np.minimum(angle, np.arccos(np.clip(cosine, -1.0, 1.0)))
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), line.shape)
    sides = [dots(np.cross(a, b), line) for a, b in ((first, second), (second, up), (up, first))]
    orientation = np.sign(dots(np.cross(first, second), up))
    is_inside = (orientation != 0.0) & (np.min([orientation * side for side in sides], axis=0) >= 0.0)
    return np.asarray(np.where(is_inside, 0.0, angle))


SMOOTHING_STEP_M: Final = 1e-3
"""Spacing [m] at which a path is sampled."""
SMOOTHING_WIDTH_M: Final = 4e-3
"""Length [m] of the path over which directions are smoothed: a few facets of a usual mesh."""
MAX_SAMPLES: Final = 2_000_000
"""Maximum number of samples of a path."""


def smooth_directions(normal: FloatArray, centre: FloatArray, max_angle: float = 2.5 * DEG) -> FloatArray:
    """Return unit normals (N, 3) smoothed along a path.

    Normals change by at most ``max_angle`` [rad], so that real corners stay.

    Args:
        normal: Unit normals (N, 3).
        centre: Points (N, 3) [m] of the path.
        max_angle: Maximum change [rad].
    """
    arc, grid = _arc_grid(centre)
    if len(grid) < 3:
        return normal
    sampled = np.stack([np.interp(grid, arc, normal[:, axis]) for axis in range(3)], axis=1)
    width = SMOOTHING_WIDTH_M / _grid_step(grid)
    sampled = gaussian_filter1d(sampled, width, axis=0, mode="nearest")
    mean = np.stack([np.interp(arc, grid, sampled[:, axis]) for axis in range(3)], axis=1)
    # the mean of directions around a curve is less steep than they are, so steepness is averaged separately
    wall_angle = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    wall_angle = np.interp(
        arc, grid, gaussian_filter1d(np.interp(grid, arc, wall_angle), width, mode="nearest")
    )
    return limit_rotation(normal, tilt_from_vertical(mean, wall_angle), max_angle)


def smooth_lower_envelope(value: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the smooth lower envelope (N,) of values along a path, never above them.

    Args:
        value: Values (N,).
        centre: Points (N, 3) [m] of the path.
    """
    arc, grid = _arc_grid(centre)
    if len(grid) < 3:
        return value
    # between two targets the lower value counts
    target = np.clip(np.searchsorted(arc, grid, side="right") - 1, 0, len(arc) - 2)
    sampled = np.minimum(value[target], value[target + 1])
    window = 2 * round(SMOOTHING_WIDTH_M / _grid_step(grid)) + 1
    window_minimum = minimum_filter1d(sampled, window, mode="nearest")
    mean = uniform_filter1d(window_minimum, window, mode="nearest")
    return np.asarray(np.minimum(np.interp(arc, grid, mean), value))


def _grid_step(grid: FloatArray) -> float:
    """Return the spacing [m] of an even grid."""
    return float(grid[1] - grid[0])


def _arc_grid(centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the arc lengths (N,) [m] of a path at its targets, and an even grid of arc lengths over it."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    count = int(min(arc[-1] / SMOOTHING_STEP_M, MAX_SAMPLES)) + 1
    return arc, np.linspace(0.0, arc[-1], count)


_MIN_NORM = 1e-12
"""Minimum divisor in the normalisation of a direction."""


def insert_targets(
    contact: ContactPath, radius: float, side: int, row: IntArray, fraction: FloatArray
) -> ContactPath:
    """Return the path with more targets, at which the second tool then gets its own positions.

    The centre of the forming ball stays on the straight move. The normal rotates evenly, and the contact is
    where that normal leaves the ball.

    Args:
        contact: Path.
        radius: Radius [m] of the forming ball.
        side: +1 if the tool above the sheet forms, else -1.
        row: Indices (M,), ascending, of the targets at which the moves with new targets end.
        fraction: Position (M,) of each new target, as a fraction of its move.
    """
    if len(row) == 0:
        return contact
    normal = interpolate_rotation(contact.normal[row - 1], contact.normal[row], fraction)
    return insert_targets_at(contact, row, fraction, normal, radius, side)


def insert_targets_at(
    contact: ContactPath,
    row: IntArray,
    fraction: FloatArray,
    normal: FloatArray,
    radius: float,
    side: int = 1,
) -> ContactPath:
    """Return the path with more targets, with given normals of the face there.

    Args:
        contact: Path.
        row: Indices (M,), ascending, of the targets at which the moves with new targets end.
        fraction: Position (M,) of each new target, as a fraction of its move.
        normal: Normals (M, 3) at the new targets.
        radius: Radius [m] of the forming ball.
        side: +1 if the tool above the sheet forms, else -1.
    """
    centre = interpolate(contact.centre[row - 1], contact.centre[row], fraction)
    point = interpolate(contact.point[row - 1], contact.point[row], fraction)
    touching = np.linalg.norm(centre - point, axis=1) < 1.5 * radius
    point = np.where(touching[:, None], centre - side * radius * normal, point)
    return ContactPath(
        point=np.insert(contact.point, row, point, axis=0),
        normal=np.insert(contact.normal, row, normal, axis=0),
        centre=np.insert(contact.centre, row, centre, axis=0),
        angle=np.insert(contact.angle, row, np.arccos(np.clip(normal[:, 2], -1.0, 1.0))),
        loop=np.insert(contact.loop, row, contact.loop[row]),
        working=np.insert(contact.working, row, contact.working[row]),
    )


def interpolate(first: FloatArray, second: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return the interpolation between ``first`` and ``second`` (M, 3) at ``fraction`` (M,)."""
    return np.asarray(first + fraction[:, None] * (second - first))


def interpolate_rotation(first: FloatArray, second: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return unit vectors (M, 3) rotated by a fraction of an angle (slerp).

    Args:
        first: Unit vectors (M, 3) at fraction 0.
        second: Unit vectors (M, 3) at fraction 1.
        fraction: Fractions (M,).
    """
    angle = np.arccos(np.clip(dots(first, second), -1.0, 1.0))
    sine = np.sin(angle)
    is_same = sine < 1e-9
    base = np.where(is_same, 1.0, sine)
    weight_a = np.where(is_same, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / base)
    weight_b = np.where(is_same, fraction, np.sin(fraction * angle) / base)
    rotated = weight_a[:, None] * first + weight_b[:, None] * second
    return np.asarray(rotated / np.maximum(np.linalg.norm(rotated, axis=1, keepdims=True), _MIN_NORM))


def subdivision(count: IntArray) -> tuple[IntArray, FloatArray]:
    """Return the targets that divide moves into equal pieces.

    Args:
        count: Number (N,) of pieces of the move to each target; 1 leaves it whole.

    Returns:
        Indices (M,) of the targets at which the divided moves end, and fractions (M,) of these moves, as
        `insert_targets` expects them.
    """
    extra = np.maximum(count - 1, 0)
    row = np.repeat(np.arange(len(count)), extra)
    piece = np.arange(len(row)) - np.repeat(np.cumsum(extra) - extra, extra) + 1
    return row, piece / count[row]
