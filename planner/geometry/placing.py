"""How a part is laid into its block, and checks of what parts that are cut by rulings look like.

A part of faces lies front up, its long side along the block's, with least height.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from shapely import LinearRing

from planner.geometry.arrays import FloatArray, Ruled, exp_rotation, from_parts
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.geometry.rulings import points
from planner.geometry.units import MM
from planner.issues import Issue

_FITS_OUTSIDE = 1e-7
"""[m] what stands out of a block by less than this fits."""


def fit_into_block(front: TriangleMesh, points: FloatArray, size: FloatArray) -> FloatArray:
    """Pose (4, 4) of the part's frame in the stock frame: its ``points`` (V, 3) in a block of ``size`` (3,).

    The front's mean normal decides which side is up; then the part is tilted to the least height, turned
    about the vertical to the smallest rectangle with its long side along the block's, and centred. The least
    height may cost width (a wave lies flattest when it is tilted): a part that stands out of the block then
    is laid with the nearest of its own axes up, or with another tilt that fits, if there is one.
    """
    normal = np.sum(face_normals(front) * face_areas(front)[:, None], axis=0)
    up = normal / np.linalg.norm(normal)
    hull = points[ConvexHull(points, qhull_options="QJ").vertices]
    start = _upright(up)

    def turned(tilt: FloatArray) -> FloatArray:
        return np.asarray(exp_rotation(np.array([tilt[0], tilt[1], 0.0])) @ start)

    def height(tilt: FloatArray) -> float:
        return float(np.ptp(hull @ turned(tilt)[2])) * 1e3

    best = minimize(
        height,
        np.zeros(2),
        method="Nelder-Mead",
        options={
            "xatol": 1e-7,
            "fatol": 1e-7,
            "initial_simplex": np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05]]),
        },
    )
    flattest = turned(best.x) if np.linalg.norm(best.x) < 0.8 else start
    axis = int(np.argmax(np.abs(up)))
    own = _upright(np.sign(up[axis]) * np.eye(3)[axis])

    def laid(rotation: FloatArray) -> tuple[float, FloatArray]:
        pose = _centred(hull, rotation, size)
        return float(overhang(hull @ pose[:3, :3].T + pose[:3, 3], size).max()), pose

    def stands_out(tilt: FloatArray) -> float:
        return laid(turned(tilt))[0] * 1e3

    out, pose = laid(flattest)
    for rotation in (own, start):
        if out > _FITS_OUTSIDE and (other := laid(rotation))[0] <= _FITS_OUTSIDE:
            out, pose = other
    if out > _FITS_OUTSIDE:
        least = minimize(
            stands_out,
            best.x,
            method="Nelder-Mead",
            options={"initial_simplex": best.x + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05]])},
        )
        other = laid(turned(least.x))
        pose = other[1] if other[0] <= _FITS_OUTSIDE else pose
    return pose


def _centred(hull: FloatArray, rotation: FloatArray, size: FloatArray) -> FloatArray:
    """Pose (4, 4) of points (V, 3) with a side up, turned about the vertical and in the block's middle."""
    yaw = _yaw(hull @ rotation[:2].T, bool(size[1] >= size[0]))
    rotation = exp_rotation(np.array([0.0, 0.0, yaw])) @ rotation
    laid = hull @ rotation.T
    middle = 0.5 * (laid.min(axis=0) + laid.max(axis=0))
    return from_parts(rotation, np.array([0.0, 0.0, 0.5 * size[2]]) - middle)


def overhang(points: FloatArray, size: FloatArray) -> FloatArray:
    """How much larger (3,) [m] the block must be along each axis to hold the points where they are."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    floor = np.array([-0.5 * size[0], -0.5 * size[1], 0.0])
    return np.asarray(np.maximum(floor - lower, 0.0) + np.maximum(upper - (floor + size), 0.0))


def _upright(up: FloatArray) -> FloatArray:
    """A rotation (3, 3) that takes ``up`` to z."""
    other = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = np.cross(other, up)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _yaw(flat: FloatArray, long_along_y: bool) -> float:
    """Angle about z of the smallest box round points (V, 2), long side along y or x."""
    corner = flat[ConvexHull(flat, qhull_options="QJ").vertices]
    edge = np.roll(corner, -1, axis=0) - corner
    angle = -np.arctan2(edge[:, 1], edge[:, 0])
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    wide = np.ptp(corner[:, 0] * c - corner[:, 1] * s, axis=1)
    high = np.ptp(corner[:, 0] * s + corner[:, 1] * c, axis=1)
    best = int(np.argmin(np.round(wide * high, 12)))
    yaw = float(angle[best])
    if (high[best] >= wide[best]) != long_along_y:
        yaw += 0.5 * np.pi
    return float((yaw + 0.5 * np.pi) % np.pi - 0.5 * np.pi)


SHORTEST_RULING: Final = 1e-3
"""Shortest ruling [m] of a part."""
LONGEST_EXTENT: Final = 20.0
"""Longest extent [m] of a part."""
_FITS_WITHIN: Final = 1e-6
"""A part that stands out of a block by no more than this [m] fits."""
_ALIGNED_ANGLE: Final = float(np.deg2rad(35.0))
"""A direction nearer to an axis of the block than this [rad] is also tried turned onto that axis."""


def lay_along(parts: Sequence[Ruled], size: FloatArray, longest_first: bool) -> FloatArray:
    """Pose (4, 4) of the part's frame in the stock frame, with the rulings along an axis of the block.

    The rulings' mean direction counts, or the axis of the part's frame that is within 35 degrees of it where
    the part fits so. Axes are tried from the block's longest to its shortest (``longest_first`` False: the
    other way round) and the first is taken along which the part fits, its own z up as far as possible;
    failing that, also tilted. Where nothing fits, the pose that stands out least. The part is centred in
    the block.
    """
    cloud = np.concatenate([p for part in parts for p in (part.start, part.end)])
    hull = cloud[ConvexHull(cloud, qhull_options="QJ").vertices]
    direction = np.concatenate([part.end - part.start for part in parts]).mean(axis=0)
    if np.linalg.norm(direction) < 1e-9:
        direction = parts[0].end[0] - parts[0].start[0]
    order = np.argsort(-size, kind="stable") if longest_first else np.argsort(size, kind="stable")
    frame_axis = np.sign(direction) * np.eye(3)[int(np.argmax(np.abs(direction)))]
    ways = [direction]
    if frame_axis @ direction >= np.cos(_ALIGNED_ANGLE) * np.linalg.norm(direction):
        ways.insert(
            0, frame_axis
        )  # so that planes of the part's frame stay planes of the block where it fits
    plain = [_turned(way, int(axis)) for axis in order for way in ways]
    for rotation in plain:
        if _excess(rotation, hull, size) <= _FITS_WITHIN:
            return _box_centred(rotation, hull, size)
    tilted = [_tilted(rotation, hull, size) for rotation in plain]
    worst = [_excess(rotation, hull, size) for rotation in tilted]
    first = next((i for i, w in enumerate(worst) if w <= _FITS_WITHIN), int(np.argmin(worst)))
    return _box_centred(tilted[first], hull, size)


def _turned(direction: FloatArray, axis: int) -> FloatArray:
    """A rotation (3, 3) that takes ``direction`` along a block axis and leaves z up as far as it can."""
    own = direction / max(float(np.linalg.norm(direction)), 1e-12)
    up = np.eye(3)[2] if abs(own[2]) < 0.8 else np.eye(3)[0]
    up = up - (up @ own) * own
    up = up / np.linalg.norm(up)
    here = np.stack([own, up, np.cross(own, up)])
    there_up = np.eye(3)[2] if axis != 2 else np.eye(3)[0]
    there = np.stack([np.eye(3)[axis], there_up, np.cross(np.eye(3)[axis], there_up)])
    return np.asarray(there.T @ here)


def _excess(rotation: FloatArray, hull: FloatArray, size: FloatArray) -> float:
    return float((np.ptp(hull @ rotation.T, axis=0) - size).max())


def _tilted(rotation: FloatArray, hull: FloatArray, size: FloatArray) -> FloatArray:
    """The rotation with a tilt of up to 45 degrees or so that makes the part stand out least."""
    simplex = np.vstack([np.zeros(3), 0.1 * np.eye(3)])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-6, "fatol": 1e-6}

    def out(turn: FloatArray) -> float:
        return 1e3 * _excess(np.asarray(exp_rotation(turn) @ rotation), hull, size)

    best = minimize(out, np.zeros(3), method="Nelder-Mead", options=options)
    return np.asarray(exp_rotation(best.x) @ rotation)


def _box_centred(rotation: FloatArray, hull: FloatArray, size: FloatArray) -> FloatArray:
    laid = hull @ rotation.T
    middle = 0.5 * (laid.min(axis=0) + laid.max(axis=0))
    return from_parts(rotation, np.array([0.0, 0.0, 0.5 * size[2]]) - middle)


def standing_out(parts: Sequence[Ruled], size: FloatArray) -> FloatArray:
    """How much larger (3,) [m] the block must be along each axis to hold the surfaces where they are."""
    return overhang(np.concatenate([p for part in parts for p in (part.start, part.end)]), size)


def check_ruled(part: Ruled, field: str) -> Iterator[Issue]:
    """Issues of a surface: its size, rulings of no length, rings that cross themselves, folds."""
    sight = points(part, np.array([0.0, 0.5, 1.0]))
    extent = float(np.ptp(sight.reshape(-1, 3), axis=0).max())
    length = np.linalg.norm(part.end - part.start, axis=1)
    if extent > LONGEST_EXTENT or length.min() < SHORTEST_RULING:
        what = (
            f"surface {part.name} is {extent / MM:.4g} mm long with rulings from {length.min() / MM:.3g} mm; "
            f"allowed are {LONGEST_EXTENT / MM:g} mm and rulings of at least {SHORTEST_RULING / MM:g} mm; "
            "correct its measures, or let its guides stay apart"
        )
        yield Issue("part.ruled_shape", what, field=field)
        return
    turn = np.diff(sight[:, 1], axis=0)
    area = float(np.linalg.norm(np.cross(turn, (part.end - part.start)[1:]), axis=1).sum())
    if area < 1e-4 * extent * extent:
        what = f"surface {part.name} has hardly any area: its guides and rulings lie in one line; correct it"
        yield Issue("part.ruled_shape", what, field=field)
        return
    direction = (part.end - part.start).mean(axis=0)
    if part.closed and np.linalg.norm(direction) > 1e-9:
        flat = sight @ _across(direction)
        for place, name in ((0, "start"), (1, "middle"), (2, "end")):
            if not _simple(flat[:, place]):
                what = (
                    f"surface {part.name}: its ring at the {name} of the rulings crosses itself; correct it"
                )
                yield Issue("part.guide", what, field=field)
                return
    fold = _folds(part)
    if fold is not None:
        at = sight[fold, 1] / MM
        what = (
            f"surface {part.name} folds over itself near ({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) mm, "
            "where its "
            "guides run against each other; run one of them the other way, or match it otherwise"
        )
        yield Issue("part.ruled_shape", what, field=field)


def _simple(ring: FloatArray) -> bool:
    """Whether a ring (N, 2) does not cross itself; an end that stands still is one point."""
    step = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1)
    own = ring[step > 1e-6]
    return len(own) < 3 or bool(LinearRing(own).is_simple)


def _folds(part: Ruled) -> int | None:
    """The first ruling whose ends look to opposite sides, or None."""
    following = np.roll(np.arange(len(part.start)), -1)
    here = np.arange(len(part.start)) if part.closed else np.arange(len(part.start) - 1)
    next_one = following[here]
    way = part.end[here] - part.start[here]
    first, last = (np.cross(e[next_one] - e[here], way) for e in (part.start, part.end))
    size = np.linalg.norm(first, axis=1) * np.linalg.norm(last, axis=1)
    turned = np.sum(first * last, axis=1) < -1e-6 * size
    moving = size > (1e-7 * np.linalg.norm(way, axis=1)) ** 2
    bad = np.flatnonzero(turned & moving)
    return int(here[bad[0]]) if len(bad) else None


def _across(direction: FloatArray) -> FloatArray:
    """Two unit vectors as (3, 2) at right angles to ``direction``, counterclockwise about it."""
    own = direction / max(float(np.linalg.norm(direction)), 1e-12)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(own)))], own)
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    return np.stack([x, np.cross(own, x)], axis=1)


def outwards(part: Ruled) -> Ruled:
    """A closed surface run so that its normals point away from the part: out of the ring, or into a hole."""
    direction = (part.end - part.start).mean(axis=0)
    flat = points(part, np.array([0.5]))[:, 0] @ _across(direction)
    following = np.roll(flat, -1, axis=0)
    area = float(np.sum(flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]))
    return backwards(part) if (area < 0.0) != part.hole else part


def backwards(part: Ruled) -> Ruled:
    """The surface with its rulings in the opposite order, so that it looks to its other side."""
    order = np.arange(len(part.start))[::-1]
    if part.closed:
        order = np.roll(order, 1)
    return Ruled(part.name, part.start[order], part.end[order], part.corner[order], part.closed, part.hole)
