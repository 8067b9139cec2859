"""An arm with three parallel axes as the proof sees it: where its axes and its tip are by the lengths that
were planned with, line by line, against those of the joints in its URDF.

Programs of such arms are not read yet; one may stand in a cell in which others work.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.catalogue.robots import ParallelParameters
from planner.geometry.arrays import FloatArray

_ABOUT: Final = (2, 1, 1, 1, 2, 1)
"""Axes of the links, by number, about which the joints turn."""


def differences(
    planned: ParallelParameters, zero: FloatArray, axis: FloatArray, most: float
) -> Iterator[str]:
    """Where axes (6, 3) through the first six frames ``zero`` (7, 4, 4) of a chain at zero, and the tip, its
    last one, are not as planned within ``most`` [m] and [rad]."""
    p = planned
    pose = np.eye(4) if p.left is None else np.array(p.left)
    steps = ((0.0, 0.0), (0.0, p.c1), (0.0, p.c2), (0.0, p.c3), (p.b, p.c4), (0.0, 0.0))
    for i, (about, step) in enumerate(zip(_ABOUT, steps, strict=True)):
        pose = pose @ _moved(*step) @ _turned(about, -float(p.offsets[i]))
        line = p.signs[i] * pose[:3, about]
        turn = float(np.linalg.norm(np.cross(line, axis[i]))) if line @ axis[i] > 0.0 else np.pi
        off = float(np.linalg.norm(np.cross(zero[i, :3, 3] - pose[:3, 3], line)))
        if not turn <= most:
            yield f"axis {i + 1} is {np.rad2deg(turn):.6f} deg beside that of the URDF"
        if not off <= most:
            yield f"axis {i + 1} is {1e3 * off:.6f} mm beside that of the URDF"
    tip = pose @ _moved(p.c5, 0.0) @ _turned(0, -0.5 * np.pi)
    apart = float(np.abs((tip if p.right is None else tip @ p.right) - zero[6]).max())
    if not apart <= most:
        yield f"the tip stands elsewhere than in the URDF, or turned, by {apart:.3g}"


def _moved(aside: float, up: float) -> FloatArray:
    pose = np.eye(4)
    pose[1:3, 3] = aside, up
    return pose


def _turned(about: int, angle: float) -> FloatArray:
    """Rotation (4, 4) about x, y or z, by number."""
    pose = np.eye(4)
    one, two = (about + 1) % 3, (about + 2) % 3
    pose[one, one] = pose[two, two] = np.cos(angle)
    pose[two, one], pose[one, two] = np.sin(angle), -np.sin(angle)
    return pose
