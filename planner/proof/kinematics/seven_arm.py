"""An arm with seven axes as the proof sees it, by the text of its URDF. Files of trajectories state its
joints, so nothing here solves for them."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.catalogue.robots import SevenParameters
from planner.geometry.arrays import FloatArray
from planner.proof.kinematics import parallel_arm
from planner.proof.kinematics.chain import Chain

_ABOUT: Final = (2, 1, 2, 1, 2, 1, 2)
"""Axes of the links, by number, about which the joints turn."""


def differences(planned: SevenParameters, zero: FloatArray, axis: FloatArray, most: float) -> Iterator[str]:
    """Where axes and tip of a chain are not as planned, as :func:`parallel_arm.lines_apart` says it."""
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
    return parallel_arm.lines_apart(p, _ABOUT, steps, parallel_arm.moved(0.0, 0.0, p.c4), zero, axis, most)


def singularity_distance(chain: Chain, q: FloatArray) -> FloatArray:
    """Angle (...,) [rad] of joints (..., 7) to the nearest posture that the planner keeps off as singular:
    axes 1 and 3 in line; the arm stretched or folded; axis 5 through the shoulder, seen along the upper arm;
    axis 4 across axis 6."""
    rows = q.reshape(-1, 7)
    frames = chain.frames(rows)
    still = np.einsum("iba,ib->ia", chain.zero[:7, :3, :3], chain.axis)
    line = np.moveaxis(np.einsum("siab,ib->sia", frames[:, :7, :3, :3], still), 1, 0)
    point = np.moveaxis(frames[:, :7, :3, 3], 1, 0)
    shoulder = _meeting(point[0], line[0], point[1])
    wrist = _meeting(point[4], line[4], point[5])
    upper, fore = (_across(v, line[3]) for v in (point[3] - shoulder, wrist - point[3]))
    long = np.linalg.norm(upper, axis=1)
    bend = np.linalg.norm(np.cross(upper, fore), axis=1) / (long * np.linalg.norm(fore, axis=1))
    beside = np.linalg.norm(np.cross(shoulder - wrist, line[4]), axis=1) / long
    lined = np.linalg.norm(np.cross(line[0], line[2]), axis=1)
    across = np.abs(np.einsum("si,si->s", line[3], line[5]))
    least = np.min([bend, beside, lined, across, np.ones(len(rows))], axis=0)
    return np.asarray(np.arcsin(least).reshape(q.shape[:-1]))


def _meeting(a: FloatArray, u: FloatArray, b: FloatArray) -> FloatArray:
    """Where lines (S, 3) through ``a`` along ``u`` meet others square to them through ``b``."""
    return np.asarray(a + np.einsum("si,si->s", b - a, u)[:, None] * u)


def _across(v: FloatArray, side: FloatArray) -> FloatArray:
    return np.asarray(v - np.einsum("si,si->s", v, side)[:, None] * side)
