"""Inverse kinematics of arms with seven axes, in closed form for a given last joint, batched over poses.

Axes 1, 2 and 3 meet in the shoulder, and axes 5 and 6 meet, as on KUKA's iiwa and Franka's Panda. The
derivation follows the form in :class:`planner.catalogue.robots.SevenParameters`.

The flange and the last joint determine link 6: the point where axes 5 and 6 meet, and the direction of axis
6. The distance of that point from the shoulder gives theta 4 (two solutions). Axis 5 passes through the
point, perpendicular to axis 6. From there the shoulder is seen at an angle to axis 5 that theta 4 determines.
This gives theta 6 (two solutions). Theta 5 follows, and theta 1 to 3 from the remaining rotation (two
solutions).

Singularities with the last joint held: the elbow stretched or folded, or axis 5 through the shoulder; axes 1
and 3 aligned; axis 4 perpendicular to axis 6, where both solutions of theta 6 coincide. The arm itself may
well move there, but no path with the last joint as a freedom passes through.

Source: That a given last joint leaves a closed form for a Panda is from He and Liu, "Analytical inverse
kinematics for Franka Emika Panda", 2021.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import SevenParameters
from planner.geometry.arrays import FloatArray

COSINE_TOLERANCE: Final = 1e-12
"""Maximum excess of a cosine over 1 that is treated as rounding."""


def inverse_kinematics(
    form: SevenParameters, flange: FloatArray, last_joint: FloatArray, branches: Sequence[int]
) -> FloatArray:
    """Compute the joint angles of flange poses for a given last joint.

    The branch number of a solution is continuous in the pose and the last joint while the arm passes no
    singularity.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the base.
        last_joint: (...,) [rad] last joint.
        branches: Branch numbers as in :func:`planner.motion.planning_scene.inverse_kinematics`.

    Returns:
        Joint angles (..., len(branches), 7) [rad]; joints 1 to 6 are not wrapped into limits. NaN where no
        solution exists.
    """
    flange = form.inner(flange)
    r = flange[..., :3, :3]
    theta7 = form.signs[6] * last_joint - form.offsets[6]
    c, s = np.cos(theta7)[..., None], np.sin(theta7)[..., None]
    # axes of link 6 in the base, and its position relative to the shoulder
    x6, y6, z6 = c * r[..., 0] - s * r[..., 1], s * r[..., 0] + c * r[..., 1], r[..., 2]
    from_shoulder = flange[..., :3, 3] - form.c4 * z6 - form.a4 * x6
    from_shoulder[..., 2] -= form.c1
    # the shoulder in the frame of link 6, and the rows of the rotation of link 6
    shoulder_in_link6 = [-np.sum(from_shoulder * axis, axis=-1) for axis in (x6, y6, z6)]
    rotation_rows = [np.stack([x6[..., k], y6[..., k], z6[..., k]]) for k in range(3)]
    # law of cosines in the triangle shoulder, elbow, wrist: cos(bend) = (d^2 - u^2 - f^2) / (2 u f)
    upper, fore = form.upper, form.fore
    square = np.sum(from_shoulder * from_shoulder, axis=-1)
    bend = _arccos((square - upper**2 - fore**2) / (2.0 * upper * fore))
    across = np.hypot(shoulder_in_link6[0], shoulder_in_link6[2])
    offset_angle = np.arctan2(shoulder_in_link6[0], shoulder_in_link6[2])
    wrist_solutions = {}
    # branch number: elbow = b % 2, shoulder = (b % 4) // 2, wrist = b // 4; each choice is solved once
    for elbow in {b % 2 for b in branches}:
        theta4 = form.straight + (bend if elbow else -bend)
        c4, s4 = np.cos(theta4), np.sin(theta4)
        # x and z of the shoulder in the frame of the forearm
        shoulder_x = -(form.a2 * c4 - form.c2 * s4 + form.a3)
        shoulder_z = -(form.a2 * s4 + form.c2 * c4 + form.c3)
        with np.errstate(invalid="ignore", divide="ignore"):
            half_angle = _arccos(shoulder_z / across)
        for wrist in {b // 4 for b in branches if b % 2 == elbow}:
            theta6 = (half_angle if wrist == 0 else -half_angle) - offset_angle
            c6, s6 = np.cos(theta6), np.sin(theta6)
            side = np.where(shoulder_x < 0.0, -1.0, 1.0)
            theta5 = np.arctan2(
                -side * shoulder_in_link6[1], side * (c6 * shoulder_in_link6[0] + s6 * shoulder_in_link6[2])
            )
            c5, s5 = np.cos(theta5), np.sin(theta5)
            # rotation of link 3: that of link 6 with the rotations of joints 6, 5 and 4 removed
            link3_rotation = []
            for x, y, z in rotation_rows:
                x, z = c6 * x + s6 * z, c6 * z - s6 * x
                x, y = c5 * x - s5 * y, s5 * x + c5 * y
                link3_rotation.append((c4 * x + s4 * z, y, c4 * z - s4 * x))
            wrist_solutions[elbow, wrist] = theta4, theta5, theta6, link3_rotation
    out = np.empty((len(branches), 7, *flange.shape[:-2]))  # one block per joint
    for slot, branch in enumerate(branches):
        theta4, theta5, theta6, ((_, _, xz), (_, _, yz), (zx, zy, zz)) = wrist_solutions[
            branch % 2, branch // 4
        ]
        flip = (branch % 4) // 2
        theta2 = np.arctan2(np.hypot(xz, yz), zz)
        columns = (
            np.arctan2(yz, xz) - np.pi * flip,
            -theta2 if flip else theta2,
            np.arctan2(zy, -zx) + np.pi * flip,
            theta4 + 0.0 * theta6,  # propagates NaN, so that a branch exists completely or not at all
            theta5,
            theta6,
        )
        for j, column in enumerate(columns):
            np.multiply(column + form.offsets[j], form.signs[j], out=out[slot, j, ...])
        out[slot, 6, ...] = last_joint + 0.0 * theta6
    return np.moveaxis(out, (0, 1), (-2, -1))


def _arccos(cosine: FloatArray) -> FloatArray:
    """Return the arc cosine [rad], NaN where the cosine exceeds 1 by more than rounding."""
    clipped = np.clip(cosine, -1.0, 1.0)
    return np.arccos(np.where(np.abs(cosine - clipped) > COSINE_TOLERANCE, np.nan, clipped))


def singularities(form: SevenParameters, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the angles from singularities of the wrist, the elbow and the shoulder.

    - Wrist: angle by which axis 4 differs from perpendicular to axis 6.
    - Elbow: angle from stretched or folded; or, if it is smaller, the angle under which the upper arm would
      see the distance of axis 5 from the shoulder.
    - Shoulder: angle between axes 1 and 3.

    Args:
        form: Kinematic parameters.
        q: (..., 7) [rad] joints.

    Returns:
        Three arrays (...,) [rad]: wrist, elbow, shoulder.
    """
    theta = form.signs * q - form.offsets
    bend = np.abs(np.arcsin(np.sin(theta[..., 3] - form.straight)))
    axis5_distance = form.a2 * np.cos(theta[..., 3]) - form.c2 * np.sin(theta[..., 3]) + form.a3
    elbow = np.minimum(bend, np.arcsin(np.minimum(1.0, np.abs(axis5_distance) / form.upper)))
    wrist = np.abs(np.arcsin(np.cos(theta[..., 4])))
    return wrist, elbow, np.abs(np.arcsin(np.sin(theta[..., 1])))


def reach_gap(form: SevenParameters, flange: FloatArray) -> FloatArray:
    """Return a lower bound (...,) [m] of the distance of flange poses from the reachable region.

    Only the distance from the shoulder counts, not the rotation. The last joint is free.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the form's base.
    """
    # centre of the circle of radius a4 on which link 6 lies as the last joint turns
    circle_centre = flange[..., :3, 3] - form.c4 * flange[..., :3, 2]
    distance = np.hypot(
        np.hypot(circle_centre[..., 0], circle_centre[..., 1]), circle_centre[..., 2] - form.c1
    )
    outer_radius = form.upper + form.fore + abs(form.a4)
    inner_radius = abs(form.upper - form.fore) - abs(form.a4)
    return np.asarray(np.maximum(np.maximum(distance - outer_radius, inner_radius - distance), 0.0))
