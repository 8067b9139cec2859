"""Inverse kinematics of ortho-parallel arms with spherical wrists, batched over poses.

Formulas: Brandstoetter, Angerer, Hofbaur, "An analytical solution of the inverse kinematics problem
of industrial serial manipulators with an ortho-parallel basis and a spherical wrist", 2014. One
branch of a thousand poses costs about half a millisecond, so that an optimiser may call it in every
step.
"""

from collections.abc import Sequence

import numpy as np

from planner.catalogue.robots import OpwParameters
from planner.geometry.arrays import FloatArray


def inverse_kinematics(opw: OpwParameters, flange: FloatArray, branches: Sequence[int]) -> FloatArray:
    """As :func:`planner.motion.planning_scene.inverse_kinematics`."""
    flange = opw.inner(flange)
    r = flange[..., :3, :3]
    centre = flange[..., :3, 3] - opw.c4 * r[..., :, 2]
    cx, cy, up = centre[..., 0], centre[..., 1], centre[..., 2] - opw.c1
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(cx * cx + cy * cy - opw.b * opw.b)
    turn, skew = np.arctan2(cy, cx), np.arctan2(opw.b, radial)
    arms = {pair: _first_three(opw, turn, skew, radial, up, *pair) for pair in {_pair(b) for b in branches}}
    wrists = {pair: _wrist(r, *angles) for pair, angles in arms.items()}
    out = np.empty((len(branches), 6, *flange.shape[:-2]))  # one block per joint: what follows works by joint
    for slot, branch in enumerate(branches):
        pair = _pair(branch)
        theta4, theta5, theta6 = wrists[pair]
        flip = branch >= 4
        columns = (*arms[pair], theta4 + np.pi * flip, -theta5 if flip else theta5, theta6 - np.pi * flip)
        for j, column in enumerate(columns):
            np.multiply(column + opw.offsets[j], opw.signs[j], out=out[slot, j])
    return np.moveaxis(out, (0, 1), (-2, -1))


def _pair(branch: int) -> tuple[int, int]:
    return (branch % 4) // 2, branch % 2


def _first_three(
    opw: OpwParameters,
    turn: FloatArray,
    skew: FloatArray,
    radial: FloatArray,
    up: FloatArray,
    shoulder: int,
    elbow: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Theta 1 to 3 for one choice of shoulder and elbow; the back shoulder is the front one mirrored."""
    forearm = np.hypot(opw.a2, opw.c3)
    out = radial - opw.a1 if shoulder == 0 else -(radial + opw.a1)
    theta1 = turn - skew if shoulder == 0 else turn + skew - np.pi
    square = out * out + up * up
    sign = -1.0 if elbow == 0 else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        lift = np.arccos((square + opw.c2**2 - forearm**2) / (2.0 * np.sqrt(square) * opw.c2))
        bend = np.arccos((square - opw.c2**2 - forearm**2) / (2.0 * opw.c2 * forearm))
    theta2 = np.arctan2(out, up) + sign * lift
    theta3 = -sign * bend - np.arctan2(opw.a2, opw.c3)
    return theta1 + 0.0 * bend, theta2, theta3  # a branch exists as a whole or not at all


def _wrist(
    r: FloatArray, theta1: FloatArray, theta2: FloatArray, theta3: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Theta 4 to 6 with theta 5 >= 0, from the rotation that the first three leave over."""
    c1, s1 = np.cos(theta1), np.sin(theta1)
    c, s = np.cos(theta2 + theta3), np.sin(theta2 + theta3)
    front = c1[..., None] * r[..., 0, :] + s1[..., None] * r[..., 1, :]
    side = c1[..., None] * r[..., 1, :] - s1[..., None] * r[..., 0, :]
    along = s[..., None] * front + c[..., None] * r[..., 2, :]
    across = c * front[..., 2] - s * r[..., 2, 2]
    theta4 = np.arctan2(side[..., 2], across)
    theta5 = np.arctan2(np.hypot(side[..., 2], across), along[..., 2])
    theta6 = np.arctan2(along[..., 1], -along[..., 0])
    return theta4, theta5, theta6
