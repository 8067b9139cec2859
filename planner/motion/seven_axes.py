"""Inverse kinematics of arms with seven axes of which 1, 2 and 3 meet and 5 and 6 meet, as those of KUKA's
iiwa and Franka's Panda, batched over poses: in closed form, once the angle of the last joint is given.

Worked out here from the form in :class:`planner.catalogue.robots.SevenParameters`; that the last joint of a
Panda leaves a closed form is from He and Liu, "Analytical inverse kinematics for Franka Emika Panda", 2021.
The flange and the last joint say where link 6 is: where axes 5 and 6 meet, and how axis 6 lies. How far that
point is from the one where axes 1 to 3 meet gives theta 4, two ways. Axis 5 passes the point, square to axis
6, and the shoulder is seen from there under an angle to it that theta 4 says: theta 6, two ways. Theta 5
follows, and theta 1 to 3 from the rotation that is left, two ways.

Singular postures, with the last joint held: the elbow stretched or folded, or axis 5 through the shoulder;
axes 1 and 3 in line; axis 4 across axis 6, where both solutions of theta 6 are one. The arm itself may well
be moved there, but no path at which the last joint is a freedom goes through.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import SevenParameters
from planner.geometry.arrays import FloatArray

ROUNDING: Final = 1e-12
"""A cosine that is beyond 1 by no more than this is 1."""


def inverse_kinematics(
    form: SevenParameters, flange: FloatArray, last: FloatArray, branches: Sequence[int]
) -> FloatArray:
    """Joint angles (..., len(branches), 7) [rad] of flange poses (..., 4, 4) in the base with the ``last``
    joint at angles (...,) [rad], branches numbered as
    :func:`planner.motion.planning_scene.inverse_kinematics` says; NaN where none exists.

    Angles of joints 1 to 6 are not wrapped into limits. The branch number of a solution is continuous in the
    pose and the last joint while the arm does not pass a singularity.
    """
    flange = form.inner(flange)
    r = flange[..., :3, :3]
    theta7 = form.signs[6] * last - form.offsets[6]
    c, s = np.cos(theta7)[..., None], np.sin(theta7)[..., None]
    # axes of link 6, and where it is from the shoulder
    x6, y6, z6 = c * r[..., 0] - s * r[..., 1], s * r[..., 0] + c * r[..., 1], r[..., 2]
    away = flange[..., :3, 3] - form.c4 * z6 - form.a4 * x6
    away[..., 2] -= form.c1
    back = [-np.sum(away * axis, axis=-1) for axis in (x6, y6, z6)]  # the shoulder, in link 6
    rows = [np.stack([x6[..., k], y6[..., k], z6[..., k]]) for k in range(3)]  # of its rotation
    upper, fore = form.upper, form.fore
    square = np.sum(away * away, axis=-1)
    bend = _arccos((square - upper**2 - fore**2) / (2.0 * upper * fore))
    across, lean = np.hypot(back[0], back[2]), np.arctan2(back[0], back[2])
    hands = {}
    for elbow in {b % 2 for b in branches}:
        theta4 = form.straight + (bend if elbow else -bend)
        c4, s4 = np.cos(theta4), np.sin(theta4)
        seen_x = -(form.a2 * c4 - form.c2 * s4 + form.a3)  # the shoulder, in the forearm
        seen_z = -(form.a2 * s4 + form.c2 * c4 + form.c3)
        with np.errstate(invalid="ignore", divide="ignore"):
            turn = _arccos(seen_z / across)
        for wrist in {b // 4 for b in branches if b % 2 == elbow}:
            theta6 = (turn if wrist == 0 else -turn) - lean
            c6, s6 = np.cos(theta6), np.sin(theta6)
            side = np.where(seen_x < 0.0, -1.0, 1.0)
            theta5 = np.arctan2(-side * back[1], side * (c6 * back[0] + s6 * back[2]))
            c5, s5 = np.cos(theta5), np.sin(theta5)
            # rotation of link 3: that of link 6, with what joints 6, 5 and 4 turn taken off
            turned = []
            for x, y, z in rows:
                x, z = c6 * x + s6 * z, c6 * z - s6 * x
                x, y = c5 * x - s5 * y, s5 * x + c5 * y
                turned.append((c4 * x + s4 * z, y, c4 * z - s4 * x))
            hands[elbow, wrist] = theta4, theta5, theta6, turned
    out = np.empty((len(branches), 7, *flange.shape[:-2]))  # one block per joint
    for slot, branch in enumerate(branches):
        theta4, theta5, theta6, ((_, _, xz), (_, _, yz), (zx, zy, zz)) = hands[branch % 2, branch // 4]
        flip = (branch % 4) // 2
        theta2 = np.arctan2(np.hypot(xz, yz), zz)
        columns = (
            np.arctan2(yz, xz) - np.pi * flip,
            -theta2 if flip else theta2,
            np.arctan2(zy, -zx) + np.pi * flip,
            theta4 + 0.0 * theta6,  # a branch exists as a whole or not at all
            theta5,
            theta6,
        )
        for j, column in enumerate(columns):
            np.multiply(column + form.offsets[j], form.signs[j], out=out[slot, j, ...])
        out[slot, 6, ...] = last + 0.0 * theta6
    return np.moveaxis(out, (0, 1), (-2, -1))


def _arccos(cosine: FloatArray) -> FloatArray:
    near = np.clip(cosine, -1.0, 1.0)
    return np.arccos(np.where(np.abs(cosine - near) > ROUNDING, np.nan, near))


def singularities(form: SevenParameters, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles (...,) [rad] of joints (..., 7): axis 4 from across axis 6; the elbow from stretched or folded,
    or that under which the upper arm would see how far axis 5 passes the shoulder; axes 1 and 3 from in
    line."""
    theta = form.signs * q - form.offsets
    bend = np.abs(np.arcsin(np.sin(theta[..., 3] - form.straight)))
    beside = form.a2 * np.cos(theta[..., 3]) - form.c2 * np.sin(theta[..., 3]) + form.a3
    elbow = np.minimum(bend, np.arcsin(np.minimum(1.0, np.abs(beside) / form.upper)))
    wrist = np.abs(np.arcsin(np.cos(theta[..., 4])))
    return wrist, elbow, np.abs(np.arcsin(np.sin(theta[..., 1])))


def reach_gap(form: SevenParameters, flange: FloatArray) -> FloatArray:
    """How far (...,) [m] flange poses (..., 4, 4) in the form's base lie outside what the arm reaches, by
    distance alone, whatever the last joint does."""
    foot = flange[..., :3, 3] - form.c4 * flange[..., :3, 2]  # on the circle on which link 6 may be
    distance = np.hypot(np.hypot(foot[..., 0], foot[..., 1]), foot[..., 2] - form.c1)
    most, least = form.upper + form.fore + abs(form.a4), abs(form.upper - form.fore) - abs(form.a4)
    return np.asarray(np.maximum(np.maximum(distance - most, least - distance), 0.0))
