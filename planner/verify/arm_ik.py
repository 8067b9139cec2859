"""Joint angles of a tool pose in closed form, per branch: the proof's own inverse kinematics.

Derived here from the form in :class:`planner.verify.arm_shape.ArmShape`, whose figures are those of the
URDF's axes, by intersecting two circles in the plane of axis 1; shares no code with the planner's solver.
Each solution is put through the chain of the URDF and counts only where that leads back to its pose. A
branch is the number 4 * (wrist centre behind axis 1) + 2 * (wrist centre behind the lower arm) + (axis 5
negative), ABB's cfx of serial arms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.geometry.vectors import dots
from planner.verify.machines import Machine

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TURN = 2.0 * np.pi
REPRODUCED = 1e-9
"""How far off its pose [m, and in each entry of the rotation] a solution may be by the URDF's chain."""


def solve(machine: Machine, flange: FloatArray, branch: IntArray) -> FloatArray:
    """Serial joint angles (B, 6) [rad] of flange poses (B, 4, 4) in the base, on branches (B,); NaN out of
    reach, and where the URDF's chain does not lead to the pose.

    Axes 1, 4 and 6 are in (-pi, pi] of the OPW angle; whole turns are for the caller (:func:`nearest_turns`).
    """
    p = machine.shape
    rotation = flange[:, :3, :3]
    wrist = flange[:, :3, 3] - p.c4 * rotation[:, :, 2]
    behind, below, negative = (branch & 4) > 0, (branch & 2) > 0, (branch & 1) > 0
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(wrist[:, 0] ** 2 + wrist[:, 1] ** 2 - p.b**2)
        lean = np.arctan2(p.b, radial)
        t1 = np.arctan2(wrist[:, 1], wrist[:, 0]) + np.where(behind, lean - np.pi, -lean)
        x = np.where(behind, -radial, radial) - p.a1
        z = wrist[:, 2] - p.c1
        forearm = np.hypot(p.a2, p.c3)
        bend = np.arccos(_unit((x * x + z * z - p.c2**2 - forearm**2) / (2.0 * p.c2 * forearm)))
        bend = np.where(below, -bend, bend)
    t3 = bend - np.arctan2(p.a2, p.c3)
    t2 = np.arctan2(x, z) - np.arctan2(forearm * np.sin(bend), p.c2 + forearm * np.cos(bend))
    c1, s1, c23, s23 = np.cos(t1), np.sin(t1), np.cos(t2 + t3), np.sin(t2 + t3)
    # columns of Rz(t1) Ry(t2 + t3): the wrist's rotation is its transpose times the flange's
    e0 = np.stack([c1 * c23, s1 * c23, -s23], axis=-1)
    e1 = np.stack([-s1, c1, np.zeros_like(c1)], axis=-1)
    e2 = np.stack([c1 * s23, s1 * s23, c23], axis=-1)
    z0, z1, z2 = (dots(e, rotation[:, :, 2]) for e in (e0, e1, e2))
    x2, y2 = (dots(e2, rotation[:, :, k]) for k in (0, 1))
    sign = np.where(negative ^ (p.signs[4] < 0), -1.0, 1.0)
    t5 = sign * np.arctan2(np.hypot(z0, z1), z2)
    t4 = np.arctan2(sign * z1, sign * z0)
    t6 = np.arctan2(sign * y2, -sign * x2)
    theta = np.stack([t1, t2, t3, t4, t5, t6], axis=-1)
    theta[:, [1, 2, 4]] = wrapped(theta[:, [1, 2, 4]] + p.offsets[[1, 2, 4]]) - p.offsets[[1, 2, 4]]
    q = p.signs * (theta + p.offsets)
    # axis 3 of some arms reaches below -180 degrees: take the turn that lies within its limits
    middle = 0.5 * (machine.data.lower + machine.data.upper)
    q[:, 1:3] = middle[1:3] + wrapped(q[:, 1:3] - middle[1:3])
    off = np.abs(machine.flange(q) - flange).max(axis=(1, 2), initial=0.0)
    q[~(off <= REPRODUCED)] = np.nan
    return q


def branch_of(machine: Machine, q: FloatArray) -> IntArray:
    """Branch (...,) of serial joint angles (..., 6)."""
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm, lean = np.hypot(p.a2, p.c3), np.arctan2(p.a2, p.c3)
    radial = p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + lean)
    below = np.sin(theta[..., 2] + lean) < 0.0
    return np.asarray(4 * (radial < 0.0) + 2 * below + (q[..., 4] < 0.0), dtype=np.int64)


def nearest_turns(q: FloatArray, near: FloatArray) -> FloatArray:
    """``q`` (..., 6) with whole turns added to axes 1, 4 and 6 so that they are nearest to ``near``."""
    out = np.array(q)
    for axis in (0, 3, 5):
        out[..., axis] += TURN * np.round((near[..., axis] - q[..., axis]) / TURN)
    return out


def continued(q: FloatArray, start: FloatArray) -> FloatArray:
    """Angles (B, 6) along a path, axes 1, 4 and 6 unwrapped from row to row, beginning at the turns of
    ``start`` (6,)."""
    out = np.array(q)
    for axis in (0, 3, 5):
        column = np.concatenate([start[None, axis], q[:, axis]])
        steps = np.diff(column)
        steps = steps - TURN * np.round(steps / TURN)
        out[:, axis] = start[axis] + np.cumsum(steps)
    return out


def wrapped(angle: FloatArray) -> FloatArray:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % TURN - np.pi)


def singularity_distance(machine: Machine, q: FloatArray) -> FloatArray:
    """Angle (...,) [rad] to the nearest singularity of serial angles (..., 6): wrist, stretched elbow, wrist
    above axis 1.

    The wrist's is |axis 5|; the elbow's the bend between lower arm and forearm; the shoulder's the angle at
    which the wrist centre is seen from the shoulder's height off axis 1.
    """
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm, lean = np.hypot(p.a2, p.c3), np.arctan2(p.a2, p.c3)
    wrist = np.abs(wrapped(theta[..., 4]))
    wrist = np.minimum(wrist, np.pi - wrist)
    bend = np.abs(wrapped(theta[..., 2] + lean))
    elbow = np.minimum(bend, np.pi - bend)
    radial = p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + lean)
    shoulder = np.arctan2(np.abs(radial), forearm)
    return np.asarray(np.minimum(np.minimum(wrist, elbow), shoulder))


def _unit(cosine: FloatArray) -> FloatArray:
    """Cosines a rounding beyond 1 count as 1; farther ones as out of reach."""
    return np.where(np.abs(cosine) < 1.0 + 1e-12, np.clip(cosine, -1.0, 1.0), np.nan)
