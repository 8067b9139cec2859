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
