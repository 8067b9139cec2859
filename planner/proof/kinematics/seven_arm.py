"""An arm with seven axes, from its URDF.

Trajectory files state its joints, so no inverse kinematics are needed.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.catalogue.robots import SevenParameters
from planner.geometry.arrays import FloatArray
from planner.proof.kinematics import parallel_arm
from planner.proof.kinematics.chain import SerialChain

_ROTATION_AXES: Final = (2, 1, 2, 1, 2, 1, 2)
"""Axis of each joint's frame about which the joint turns: 0 for x, 1 for y, 2 for z."""


def compare_with_plan(planned: SevenParameters, chain: SerialChain, tolerance: float) -> Iterator[str]:
    """Yield the differences of axes and tip from the planned ones, as :func:`parallel_arm.compare_lines`."""
    p = planned
    steps = (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, p.c1),
        (0.0, 0.0, 0.0),
        (p.a2, 0.0, p.c2),
        (p.a3, 0.0, p.c3),
        (0.0, 0.0, 0.0),
        (p.a4, 0.0, 0.0),
    )
    tip = parallel_arm.translation(0.0, 0.0, p.c4)
    return parallel_arm.compare_lines(p, _ROTATION_AXES, steps, tip, chain, tolerance)


def singularity_distance(chain: SerialChain, q: FloatArray) -> FloatArray:
    """Return the angle (...,) [rad] of joints (..., 7) to the nearest singular posture.

    The postures that the planner avoids count as singular: axes 1 and 3 parallel; the arm stretched or
    folded; axis 5 through the shoulder; and axis 4 perpendicular to axis 6. The sine of the angle for axis 5
    is its distance from the shoulder, divided by the length of the upper arm.
    """
    postures = q.reshape(-1, 7)
    frames = chain.frames(postures)
    still = np.einsum("iba,ib->ia", chain.zero[:7, :3, :3], chain.axis)
    line = np.moveaxis(np.einsum("siab,ib->sia", frames[:, :7, :3, :3], still), 1, 0)
    point = np.moveaxis(frames[:, :7, :3, 3], 1, 0)
    shoulder = _intersection(point[0], line[0], point[1])
    wrist = _intersection(point[4], line[4], point[5])
    # Upper arm and forearm in the plane across axis 4. The values below are the sines of the angles.
    upper, fore = (_component_across(v, line[3]) for v in (point[3] - shoulder, wrist - point[3]))
    upper_length = np.linalg.norm(upper, axis=1)
    bend = np.linalg.norm(np.cross(upper, fore), axis=1) / (upper_length * np.linalg.norm(fore, axis=1))
    beside_shoulder = np.linalg.norm(np.cross(shoulder - wrist, line[4]), axis=1) / upper_length
    parallel = np.linalg.norm(np.cross(line[0], line[2]), axis=1)
    across = np.abs(np.einsum("si,si->s", line[3], line[5]))
    min_sine = np.min([bend, beside_shoulder, parallel, across, np.ones(len(postures))], axis=0)
    return np.asarray(np.arcsin(min_sine).reshape(q.shape[:-1]))


def _intersection(a: FloatArray, u: FloatArray, b: FloatArray) -> FloatArray:
    """Return where lines (S, 3) through ``a`` along ``u`` meet perpendicular lines through ``b``, (S, 3)."""
    return np.asarray(a + np.einsum("si,si->s", b - a, u)[:, None] * u)


def _component_across(v: FloatArray, side: FloatArray) -> FloatArray:
    """Return the components (S, 3) of vectors (S, 3) perpendicular to unit vectors ``side`` (S, 3)."""
    return np.asarray(v - np.einsum("si,si->s", v, side)[:, None] * side)
