"""Directions of forming tools: how they lean, and how far the one opposite may lean.

All is for a forming tool above the sheet; for one below, mirror in z first.
"""

from __future__ import annotations

import numpy as np

from planner.forming.values import FloatArray
from planner.geometry.vectors import dots


def leaned(normal: FloatArray, angle: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) at ``angle`` (N,) [rad] from +z in the plane of +z and ``normal`` (N, 3)."""
    flat = normal[:, :2]
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    way = np.where(length > 1e-9, flat / np.maximum(length, 1e-9), 0.0)
    upright = length[:, 0] <= 1e-9
    angle = np.where(upright, 0.0, angle)
    return np.column_stack([np.sin(angle)[:, None] * way, np.cos(angle)])


def axes(normal: FloatArray, lean: float) -> FloatArray:
    """Unit vectors (N, 3) out of a tool above the sheet: from -z toward the surface by ``lean`` [rad], no
    more than its wall angle is. ``normal`` (N, 3) up."""
    angle = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
    return -leaned(normal, np.minimum(angle, lean))


def below_flat(height: FloatArray, apart: FloatArray, level: float, radius: float) -> FloatArray:
    """Largest angle (N,) [rad] from the vertical of the line from the forming ball's centre, at ``height``
    (N,) [m], down to that of the ball opposite, ``apart`` (N,) [m] away, at which the latter, of ``radius``
    [m], does not cut into the flat around the feature, whose far face is at ``level`` [m]."""
    return np.asarray(np.arccos(np.clip((height - level + radius) / apart, -1.0, 1.0)))


def nozzle_below_flat(height: FloatArray, level: float, standoff: float, radius: float) -> FloatArray:
    """Largest lean (N,) [rad] of a nozzle of ``radius`` [m], ``standoff`` [m] behind the place at ``height``
    (N,) [m] that it heats from below, at which its edge stays under the flat at ``level`` [m]."""
    long = np.hypot(standoff, radius)
    most = np.arccos(np.clip((height - level) / long, -1.0, 1.0)) - np.arctan2(radius, standoff)
    return np.asarray(np.maximum(most, 0.0))


def off_upright(line: FloatArray, normal: FloatArray) -> FloatArray:
    """Angles (N,) [rad] of unit vectors ``line`` (N, 3) to the nearest of the directions on the arc from
    ``normal`` (N, 3) to +z."""
    flat = np.linalg.norm(normal[:, :2], axis=1)
    way = normal[:, :2] / np.maximum(flat, 1e-12)[:, None]
    # in the frame of the arc: out along it in plan, beside it, and up
    along = dots(line[:, :2], way)
    beside = np.abs(way[:, 0] * line[:, 1] - way[:, 1] * line[:, 0])
    steep = np.clip(np.arctan2(along, line[:, 2]), 0.0, np.arctan2(flat, normal[:, 2]))
    cosine = along * np.sin(steep) + line[:, 2] * np.cos(steep)
    return np.asarray(
        np.arctan2(np.hypot(beside, along * np.cos(steep) - line[:, 2] * np.sin(steep)), cosine)
    )


def turned_at_most(one: FloatArray, two: FloatArray, most: float | FloatArray) -> FloatArray:
    """Unit vectors ``two`` (N, 3) where they are within ``most`` [rad], one angle or (N,), of unit vectors
    ``one`` (N, 3), else those so far from ``one`` toward them."""
    angle = np.arccos(np.clip(dots(one, two), -1.0, 1.0))
    across = two - dots(one, two)[:, None] * one
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-12)
    part = np.minimum(angle, most)[:, None]
    return np.asarray(np.cos(part) * one + np.sin(part) * across)


def nearest_between(line: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Of the unit vectors on the shorter arcs from ``one`` to ``two`` (N, 3) those (N, 3) nearest to unit
    vectors ``line`` (N, 3)."""
    pole = np.cross(one, two)
    length = np.linalg.norm(pole, axis=1, keepdims=True)
    pole = pole / np.maximum(length, 1e-12)
    flat = line - dots(line, pole)[:, None] * pole
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    flat = flat / np.maximum(size, 1e-12)
    inside = (dots(np.cross(one, flat), pole) >= 0.0) & (dots(np.cross(flat, two), pole) >= 0.0)
    inside &= (length[:, 0] > 1e-9) & (size[:, 0] > 1e-9)
    nearer = dots(line, one) >= dots(line, two)
    return np.where(inside[:, None], flat, np.where(nearer[:, None], one, two))


def off_fan(line: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Angles (N,) [rad] of unit vectors ``line`` (N, 3) to the triangle on the sphere between ``one``,
    ``two`` (N, 3) and +z."""
    off = np.minimum(off_upright(line, one), off_upright(line, two))
    cosine = dots(line, nearest_between(line, one, two))
    off = np.minimum(off, np.arccos(np.clip(cosine, -1.0, 1.0)))
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), line.shape)
    sides = [dots(np.cross(a, b), line) for a, b in ((one, two), (two, up), (up, one))]
    turn = np.sign(dots(np.cross(one, two), up))
    inside = (turn != 0.0) & (np.min([turn * side for side in sides], axis=0) >= 0.0)
    return np.asarray(np.where(inside, 0.0, off))
