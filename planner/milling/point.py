"""Point milling: from places on a surface to tips and axes of a cutter whose end touches it there."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import dots
from planner.tooling import Cutter

FloatArray = NDArray[np.float64]

UPRIGHT: Final = 1e-3
"""A flat end that leans off the normal by less than this [rad] touches with its middle."""


def leant(normal: FloatArray, feed: FloatArray, lead: float, tilt: float) -> FloatArray:
    """Axes (N, 3): normals leant forward along the feed by ``lead`` and to its left by ``tilt`` [rad]."""
    along = _unit(feed - dots(feed, normal)[:, None] * normal)
    left = np.cross(normal, along)
    return _unit(normal + np.tan(lead) * along + np.tan(tilt) * left)


def tips(contact: FloatArray, normal: FloatArray, axis: FloatArray, cutter: Cutter) -> FloatArray:
    """Tips (N, 3) [m] of cutters with ``axis`` (N, 3) that touch planes with ``normal`` (N, 3) at ``contact``
    (N, 3).

    The end of every cutter is a torus, of tube radius r (its corner) about a circle of radius R - r; a ball
    has no circle, a cylinder no tube. The tube's middle is r above the contact along the normal, and the
    circle's middle is beside that, to the side to which the normal leans off the axis.
    """
    across = normal - dots(normal, axis)[:, None] * axis
    lean = np.linalg.norm(across, axis=1, keepdims=True)
    side = np.where(lean > UPRIGHT, across / np.maximum(lean, 1e-15), 0.0)
    circle = cutter.radius - cutter.corner
    return np.asarray(contact + cutter.corner * (normal - axis) + circle * side)


def ridge_step(height: float, radius: float, bend: FloatArray) -> FloatArray:
    """Distance (N,) [m] between neighbouring lines of a ball of ``radius`` [m] that leave ridges of
    ``height`` [m] on a surface that bends across them by ``bend`` (N,) [1/m], above zero where it is convex:
    h = s^2 / 8 (1 / R + k), the difference of two parabolas. In hollows it is twice that of a flat at most:
    such a place is small, and the next one bends otherwise."""
    return np.asarray(np.sqrt(8.0 * height / np.maximum(1.0 / radius + bend, 0.25 / radius)))


def ridge_height(step: float, radius: float, bend: FloatArray) -> FloatArray:
    """Height (N,) [m] of the ridges that lines ``step`` [m] apart leave, as :func:`ridge_step` has it;
    0 of a flat end, where ``radius`` is 0."""
    if radius == 0.0:
        return np.zeros(len(bend))
    return np.asarray(step**2 / 8.0 * np.maximum(1.0 / radius + bend, 0.0))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15))
