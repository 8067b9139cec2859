"""How a part is laid into its block: front up, long side along the block's, least height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.geometry.rigid import exp_rotation, from_parts

FloatArray = NDArray[np.float64]

_OUT = 1e-7
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
        if out > _OUT and (other := laid(rotation))[0] <= _OUT:
            out, pose = other
    if out > _OUT:
        least = minimize(
            stands_out,
            best.x,
            method="Nelder-Mead",
            options={"initial_simplex": best.x + np.array([[0.0, 0.0], [0.05, 0.0], [0.0, 0.05]])},
        )
        other = laid(turned(least.x))
        pose = other[1] if other[0] <= _OUT else pose
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
