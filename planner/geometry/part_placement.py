"""Poses of parts in their block, and checks of parts made of ruled surfaces.

A part of faces lies front up, with its long side along the block's and with the least height.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from shapely import LinearRing

from planner.geometry.arrays import FloatArray, RuledSurface, exp_rotation, from_parts
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.geometry.rulings import ruling_points
from planner.geometry.units import MM
from planner.issues import Issue

_FACES_OVERHANG_M = 1e-7
"""Maximum overhang of a part of faces that fits its block [m]."""


def pose_in_block(front: TriangleMesh, points: FloatArray, size: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of the part's frame in the stock frame.

    The front's mean normal decides which side is up. The part is tilted to the least height, rotated about
    the vertical to the smallest rectangle, and centred. The least height may need more width. A part that
    then overhangs the block is placed with the nearest of its frame's axes up, or with a tilt that fits, if
    there is one.

    Args:
        front: The part's front.
        points: Points of the part (V, 3).
        size: Size of the block (3,) [m].
    """
    normal = np.sum(face_normals(front) * face_areas(front)[:, None], axis=0)
    up = normal / np.linalg.norm(normal)
    hull = points[ConvexHull(points, qhull_options="QJ").vertices]
    start = _upright(up)

    def tilted(tilt: FloatArray) -> FloatArray:
        return np.asarray(exp_rotation(np.array([tilt[0], tilt[1], 0.0])) @ start)

    def height_mm(tilt: FloatArray) -> float:
        return float(np.ptp(hull @ tilted(tilt)[2])) * 1e3

    flattest_tilt = minimize(
        height_mm,
        np.zeros(2),
        method="Nelder-Mead",
        options={
            "xatol": 1e-7,
            "fatol": 1e-7,
            "initial_simplex": np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05]]),
        },
    )
    flattest = tilted(flattest_tilt.x) if np.linalg.norm(flattest_tilt.x) < 0.8 else start
    axis = int(np.argmax(np.abs(up)))
    axis_up = _upright(np.sign(up[axis]) * np.eye(3)[axis])

    def overhang_and_pose(rotation: FloatArray) -> tuple[float, FloatArray]:
        pose = _centred_pose(hull, rotation, size)
        return float(overhang(hull @ pose[:3, :3].T + pose[:3, 3], size).max()), pose

    def overhang_mm(tilt: FloatArray) -> float:
        return overhang_and_pose(tilted(tilt))[0] * 1e3

    max_overhang, pose = overhang_and_pose(flattest)
    for rotation in (axis_up, start):
        if (
            max_overhang > _FACES_OVERHANG_M
            and (alternative := overhang_and_pose(rotation))[0] <= _FACES_OVERHANG_M
        ):
            max_overhang, pose = alternative
    if max_overhang > _FACES_OVERHANG_M:
        smallest = minimize(
            overhang_mm,
            flattest_tilt.x,
            method="Nelder-Mead",
            options={"initial_simplex": flattest_tilt.x + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05]])},
        )
        alternative = overhang_and_pose(tilted(smallest.x))
        pose = alternative[1] if alternative[0] <= _FACES_OVERHANG_M else pose
    return pose


def _centred_pose(hull: FloatArray, rotation: FloatArray, size: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of points (V, 3), rotated about the vertical and centred in the block."""
    yaw = _yaw(hull @ rotation[:2].T, bool(size[1] >= size[0]))
    rotation = exp_rotation(np.array([0.0, 0.0, yaw])) @ rotation
    rotated = hull @ rotation.T
    centre = 0.5 * (rotated.min(axis=0) + rotated.max(axis=0))
    return from_parts(rotation, np.array([0.0, 0.0, 0.5 * size[2]]) - centre)


def overhang(points: FloatArray, size: FloatArray) -> FloatArray:
    """Return by how much (3,) [m] the block must be larger along each axis to contain the points."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    floor = np.array([-0.5 * size[0], -0.5 * size[1], 0.0])
    return np.asarray(np.maximum(floor - lower, 0.0) + np.maximum(upper - (floor + size), 0.0))


def _upright(up: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes ``up`` to z."""
    other = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = np.cross(other, up)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _yaw(flat: FloatArray, long_along_y: bool) -> float:
    """Return the angle about z [rad] of the smallest rectangle around points (V, 2).

    Its long side is along y or x.
    """
    corner = flat[ConvexHull(flat, qhull_options="QJ").vertices]
    edge = np.roll(corner, -1, axis=0) - corner
    angle = -np.arctan2(edge[:, 1], edge[:, 0])
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    width = np.ptp(corner[:, 0] * c - corner[:, 1] * s, axis=1)
    height = np.ptp(corner[:, 0] * s + corner[:, 1] * c, axis=1)
    best_edge = int(np.argmin(np.round(width * height, 12)))
    yaw = float(angle[best_edge])
    if (height[best_edge] >= width[best_edge]) != long_along_y:
        yaw += 0.5 * np.pi
    return float((yaw + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


MIN_RULING_LENGTH_M: Final = 1e-3
"""Minimum length of a ruling [m]."""
MAX_EXTENT_M: Final = 20.0
"""Maximum extent of a part [m]."""
_RULED_OVERHANG_M: Final = 1e-6
"""Maximum overhang of a part of ruled surfaces that fits its block [m]."""
_ALIGNED_ANGLE_RAD: Final = float(np.deg2rad(35.0))
"""Maximum angle to an axis of the part's frame at which that axis is tried as direction [rad]."""


def pose_along_rulings(parts: Sequence[RuledSurface], size: FloatArray, longest_first: bool) -> FloatArray:
    """Return the pose (4, 4) of the part's frame in the stock frame, with rulings along a block axis.

    The direction is the rulings' mean, or the axis of the part's frame within 35 degrees of it if the part
    then fits. The first block axis is taken along which the part fits, with its z axis as far up as possible,
    else with a tilt. If nothing fits, the pose overhangs least. The part is centred in the block.

    Args:
        parts: Ruled surfaces of the part.
        size: Size of the block (3,) [m].
        longest_first: Whether the block's longest axis is tried first, else its shortest.
    """
    points = np.concatenate([line for part in parts for line in (part.start, part.end)])
    hull = points[ConvexHull(points, qhull_options="QJ").vertices]
    direction = np.concatenate([part.end - part.start for part in parts]).mean(axis=0)
    if np.linalg.norm(direction) < 1e-9:
        direction = parts[0].end[0] - parts[0].start[0]
    order = np.argsort(-size, kind="stable") if longest_first else np.argsort(size, kind="stable")
    frame_axis = np.sign(direction) * np.eye(3)[int(np.argmax(np.abs(direction)))]
    directions = [direction]
    if frame_axis @ direction >= np.cos(_ALIGNED_ANGLE_RAD) * np.linalg.norm(direction):
        directions.insert(0, frame_axis)  # planes of the part's frame stay planes of the block if it fits
    rotations = [_rotation_onto_axis(candidate, int(axis)) for axis in order for candidate in directions]
    for rotation in rotations:
        if _excess(rotation, hull, size) <= _RULED_OVERHANG_M:
            return _box_centred_pose(rotation, hull, size)
    tilted = [_tilted(rotation, hull, size) for rotation in rotations]
    excesses = [_excess(rotation, hull, size) for rotation in tilted]
    chosen = next(
        (i for i, excess in enumerate(excesses) if excess <= _RULED_OVERHANG_M), int(np.argmin(excesses))
    )
    return _box_centred_pose(tilted[chosen], hull, size)


def _rotation_onto_axis(direction: FloatArray, axis: int) -> FloatArray:
    """Return a rotation (3, 3) that takes ``direction`` along a block axis and keeps z up if possible."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-12)
    up = np.eye(3)[2] if abs(unit[2]) < 0.8 else np.eye(3)[0]
    up = up - (up @ unit) * unit
    up = up / np.linalg.norm(up)
    source = np.stack([unit, up, np.cross(unit, up)])
    target_up = np.eye(3)[2] if axis != 2 else np.eye(3)[0]
    target = np.stack([np.eye(3)[axis], target_up, np.cross(np.eye(3)[axis], target_up)])
    return np.asarray(target.T @ source)


def _excess(rotation: FloatArray, hull: FloatArray, size: FloatArray) -> float:
    """Return by how much [m] rotated points exceed the block's size, along the worst axis."""
    return float((np.ptp(hull @ rotation.T, axis=0) - size).max())


def _tilted(rotation: FloatArray, hull: FloatArray, size: FloatArray) -> FloatArray:
    """Return the rotation with a local tilt that minimises the part's overhang."""
    simplex = np.vstack([np.zeros(3), 0.1 * np.eye(3)])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-6, "fatol": 1e-6}

    def excess_mm(tilt: FloatArray) -> float:
        return 1e3 * _excess(np.asarray(exp_rotation(tilt) @ rotation), hull, size)

    best = minimize(excess_mm, np.zeros(3), method="Nelder-Mead", options=options)
    return np.asarray(exp_rotation(best.x) @ rotation)


def _box_centred_pose(rotation: FloatArray, hull: FloatArray, size: FloatArray) -> FloatArray:
    """Return the pose (4, 4) with a rotation that centres points (V, 3) in the block."""
    rotated = hull @ rotation.T
    centre = 0.5 * (rotated.min(axis=0) + rotated.max(axis=0))
    return from_parts(rotation, np.array([0.0, 0.0, 0.5 * size[2]]) - centre)


def surfaces_overhang(parts: Sequence[RuledSurface], size: FloatArray) -> FloatArray:
    """Return by how much (3,) [m] the block must be larger along each axis to contain the surfaces."""
    return overhang(np.concatenate([p for part in parts for p in (part.start, part.end)]), size)


def check_ruled(part: RuledSurface, field: str) -> Iterator[Issue]:
    """Yield issues of a surface: size, rulings without length, rings that cross themselves, folds."""
    samples = ruling_points(part, np.array([0.0, 0.5, 1.0]))
    extent = float(np.ptp(samples.reshape(-1, 3), axis=0).max())
    length = np.linalg.norm(part.end - part.start, axis=1)
    if extent > MAX_EXTENT_M or length.min() < MIN_RULING_LENGTH_M:
        text = (
            f"surface {part.name} is too long or has too short rulings (got an extent of "
            f"{extent / MM:.4g} mm and rulings from {length.min() / MM:.3g} mm, allowed up to "
            f"{MAX_EXTENT_M / MM:g} mm and rulings of at least {MIN_RULING_LENGTH_M / MM:g} mm); "
            "correct its dimensions, or separate its guides"
        )
        yield Issue("part.ruled_shape", text, field=field)
        return
    steps = np.diff(samples[:, 1], axis=0)
    area = float(np.linalg.norm(np.cross(steps, (part.end - part.start)[1:]), axis=1).sum())
    if area < 1e-4 * extent * extent:
        text = f"surface {part.name} has hardly any area: its guides and rulings lie in one line; correct it"
        yield Issue("part.ruled_shape", text, field=field)
        return
    direction = (part.end - part.start).mean(axis=0)
    if part.closed and np.linalg.norm(direction) > 1e-9:
        flat = samples @ _normal_plane(direction)
        for column, name in ((0, "start"), (1, "middle"), (2, "end")):
            if not _is_simple(flat[:, column]):
                text = (
                    f"surface {part.name}: its ring at the {name} of the rulings crosses itself; correct it"
                )
                yield Issue("part.guide", text, field=field)
                return
    fold = _first_fold(part)
    if fold is not None:
        position_mm = samples[fold, 1] / MM
        text = (
            f"surface {part.name} folds over itself near ({position_mm[0]:.1f}, {position_mm[1]:.1f}, "
            f"{position_mm[2]:.1f}) mm, where its guides run in opposite directions; reverse one of them, "
            "or use another matching"
        )
        yield Issue("part.ruled_shape", text, field=field)


def _is_simple(ring: FloatArray) -> bool:
    """Return whether a ring (N, 2) does not cross itself. An end that stands still is one point."""
    step = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1)
    moving = ring[step > 1e-6]
    return len(moving) < 3 or bool(LinearRing(moving).is_simple)


def _first_fold(part: RuledSurface) -> int | None:
    """Return the index of the first ruling whose ends face opposite sides, or None."""
    following = np.roll(np.arange(len(part.start)), -1)
    rows = np.arange(len(part.start)) if part.closed else np.arange(len(part.start) - 1)
    next_rows = following[rows]
    rulings = part.end[rows] - part.start[rows]
    first, last = (np.cross(e[next_rows] - e[rows], rulings) for e in (part.start, part.end))
    size = np.linalg.norm(first, axis=1) * np.linalg.norm(last, axis=1)
    opposite = np.sum(first * last, axis=1) < -1e-6 * size
    moving = size > (1e-7 * np.linalg.norm(rulings, axis=1)) ** 2
    folded = np.flatnonzero(opposite & moving)
    return int(rows[folded[0]]) if len(folded) else None


def _normal_plane(direction: FloatArray) -> FloatArray:
    """Return two unit vectors as (3, 2) normal to ``direction``, counterclockwise about it."""
    unit_direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(unit_direction)))], unit_direction)
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    return np.stack([x, np.cross(unit_direction, x)], axis=1)


def facing_outwards(part: RuledSurface) -> RuledSurface:
    """Return a closed surface ordered so that its normals point away from the part.

    They point out of the ring, or into a hole.
    """
    direction = (part.end - part.start).mean(axis=0)
    flat = ruling_points(part, np.array([0.5]))[:, 0] @ _normal_plane(direction)
    following = np.roll(flat, -1, axis=0)
    area = float(np.sum(flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]))
    return reversed_rulings(part) if (area < 0.0) != part.hole else part


def reversed_rulings(part: RuledSurface) -> RuledSurface:
    """Return the surface with its rulings in reverse order, so that its normals are reversed."""
    order = np.arange(len(part.start))[::-1]
    if part.closed:
        order = np.roll(order, 1)
    return RuledSurface(
        part.name, part.start[order], part.end[order], part.corner[order], part.closed, part.hole
    )
