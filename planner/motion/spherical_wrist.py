"""Inverse kinematics of ortho-parallel arms with spherical wrists, batched over poses.

One branch of a thousand poses takes about half a millisecond, so that an optimiser may call it in every step.

Source: Brandstoetter, Angerer, Hofbaur, "An analytical solution of the inverse kinematics problem of
industrial serial manipulators with an ortho-parallel basis and a spherical wrist", 2014.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from planner.catalogue.robots import OpwParameters
from planner.geometry.arrays import FloatArray


def inverse_kinematics(opw: OpwParameters, flange: FloatArray, branches: Sequence[int]) -> FloatArray:
    """Compute the joint angles of flange poses on given branches.

    Args:
        opw: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the base.
        branches: Branch numbers as in :func:`planner.motion.planning_scene.inverse_kinematics`.

    Returns:
        Joint angles (..., len(branches), 6) [rad], not wrapped into limits; NaN where no solution exists.
    """
    flange = opw.inner(flange)
    r = flange[..., :3, :3]
    position = flange[..., :3, 3] - opw.c4 * r[..., :, 2]
    cx, cy, up = position[..., 0], position[..., 1], position[..., 2] - opw.c1
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(cx * cx + cy * cy - opw.b * opw.b)
    centre = _WristCentre(np.arctan2(cy, cx), np.arctan2(opw.b, radial), radial, up)
    # Theta 1 to 3 and the wrist depend on shoulder and elbow only, so each choice of both is solved once.
    arm_solutions = {
        choice: _arm_angles(opw, centre, *choice) for choice in {_shoulder_and_elbow(b) for b in branches}
    }
    wrist_solutions = {choice: _wrist_angles(r, *angles) for choice, angles in arm_solutions.items()}
    out = np.empty((len(branches), 6, *flange.shape[:-2]))  # one block per joint, since callers work by joint
    for slot, branch in enumerate(branches):
        choice = _shoulder_and_elbow(branch)
        theta4, theta5, theta6 = wrist_solutions[choice]
        flip = branch >= 4
        columns = (
            *arm_solutions[choice],
            theta4 + np.pi * flip,
            -theta5 if flip else theta5,
            theta6 - np.pi * flip,
        )
        for j, column in enumerate(columns):
            np.multiply(column + opw.offsets[j], opw.signs[j], out=out[slot, j])
    return np.moveaxis(out, (0, 1), (-2, -1))


def _shoulder_and_elbow(branch: int) -> tuple[int, int]:
    """Return the choice of the shoulder (0 front, 1 back) and of the elbow (0 or 1) of a branch number."""
    return (branch % 4) // 2, branch % 2


@dataclasses.dataclass(frozen=True)
class _WristCentre:
    """Wrist centres in cylindrical coordinates about axis 1.

    Attributes:
        azimuth: (...,) [rad] directions about axis 1.
        skew: (...,) [rad] angles from the plane of the arm, which is at the distance b from axis 1, to these
            directions.
        radial: (...,) [m] distances from axis 1 along the plane of the arm; NaN if the wrist centre is closer
            to axis 1 than b.
        up: (...,) [m] heights above axis 2.
    """

    azimuth: FloatArray
    skew: FloatArray
    radial: FloatArray
    up: FloatArray


def _arm_angles(
    opw: OpwParameters, centre: _WristCentre, shoulder: int, elbow: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute theta 1 to 3, each (...,) [rad], for one choice of shoulder and elbow.

    With the back shoulder, axis 1 is rotated by half a turn, and the arm reaches backwards.
    """
    azimuth, skew, radial, up = centre.azimuth, centre.skew, centre.radial, centre.up
    forearm = np.hypot(opw.a2, opw.c3)
    # horizontal distance from axis 2 to the wrist centre, and the square of its whole distance
    horizontal = radial - opw.a1 if shoulder == 0 else -(radial + opw.a1)
    theta1 = azimuth - skew if shoulder == 0 else azimuth + skew - np.pi
    square = horizontal * horizontal + up * up
    sign = -1.0 if elbow == 0 else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        lift = np.arccos((square + opw.c2**2 - forearm**2) / (2.0 * np.sqrt(square) * opw.c2))
        bend = np.arccos((square - opw.c2**2 - forearm**2) / (2.0 * opw.c2 * forearm))
    theta2 = np.arctan2(horizontal, up) + sign * lift
    theta3 = -sign * bend - np.arctan2(opw.a2, opw.c3)
    return theta1 + 0.0 * bend, theta2, theta3  # NaN of bend: a branch exists completely or not at all


def _wrist_angles(
    r: FloatArray, theta1: FloatArray, theta2: FloatArray, theta3: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute theta 4 to 6, each (...,) [rad], with theta 5 >= 0.

    Args:
        r: (..., 3, 3) rotation of the flange in the base.
        theta1: (...,) [rad] angle of joint 1.
        theta2: (...,) [rad] angle of joint 2.
        theta3: (...,) [rad] angle of joint 3.
    """
    c1, s1 = np.cos(theta1), np.sin(theta1)
    # rows of the rotation that remains after joints 1 to 3, as far as they are needed
    c, s = np.cos(theta2 + theta3), np.sin(theta2 + theta3)
    front = c1[..., None] * r[..., 0, :] + s1[..., None] * r[..., 1, :]
    side = c1[..., None] * r[..., 1, :] - s1[..., None] * r[..., 0, :]
    along = s[..., None] * front + c[..., None] * r[..., 2, :]
    across = c * front[..., 2] - s * r[..., 2, 2]
    theta4 = np.arctan2(side[..., 2], across)
    theta5 = np.arctan2(np.hypot(side[..., 2], across), along[..., 2])
    theta6 = np.arctan2(along[..., 1], -along[..., 0])
    return theta4, theta5, theta6
