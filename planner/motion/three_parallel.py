"""Inverse kinematics of arms whose axes 2, 3 and 4 are parallel, as those of UR, batched over poses.

Worked out here from the form in :class:`planner.catalogue.robots.ParallelParameters`. Where axis 5
meets axis 6 is fixed in the flange, and how far it lies along axis 2 no joint but the first one
changes: theta 1, two ways. How axis 6 leans to axis 2 gives theta 5, two ways; theta 6 and the sum
of theta 2 to 4 follow, and theta 2 and 3 are those of two links in a plane, two ways.

Singular postures: where sin(theta 5) = 0, axis 6 is parallel to axis 4 and only the sum of what
they turn is certain: theta 6 is taken as 0. Where the elbow is stretched or folded its two branches
are one, and so are those of the shoulder where the point above lies beside axis 1.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import ParallelParameters
from planner.geometry.arrays import FloatArray

LINED_UP: Final = 1e-9
"""Sine of theta 5 below which axes 4 and 6 count as parallel."""
ROUNDING: Final = 1e-12
"""A cosine of the elbow's angle that is beyond 1 by no more than this is 1."""


def inverse_kinematics(form: ParallelParameters, flange: FloatArray, branches: Sequence[int]) -> FloatArray:
    """Joint angles (..., len(branches), 6) [rad] of flange poses (..., 4, 4) in the base, branches numbered
    as :func:`planner.motion.planning_scene.inverse_kinematics` says; NaN where none exists.

    Angles are not wrapped into limits. The branch number of a solution is continuous in the pose while the
    arm does not pass a singularity.
    """
    flange = form.inner(flange)
    r = flange[..., :3, :3]
    meeting = flange[..., :3, 3] - form.c5 * r[..., :, 2]
    x, y, up = meeting[..., 0], meeting[..., 1], meeting[..., 2] - form.c1
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(x * x + y * y - form.b * form.b)
    turn, skew = np.arctan2(y, x), np.arctan2(form.b, radial)
    hands = {}
    for shoulder in {(b % 4) // 2 for b in branches}:
        theta1 = turn - skew if shoulder == 0 else turn + skew - np.pi
        c, s = np.cos(theta1)[..., None], np.sin(theta1)[..., None]
        front, side = c * r[..., 0, :] + s * r[..., 1, :], c * r[..., 1, :] - s * r[..., 0, :]
        out = radial if shoulder == 0 else -radial
        for wrist in {b // 4 for b in branches if (b % 4) // 2 == shoulder}:
            hands[shoulder, wrist] = (theta1, *_hand(form, front, side, r[..., 2, :], out, up, wrist))
    result = np.empty((len(branches), 6, *flange.shape[:-2]))  # one block per joint
    for slot, branch in enumerate(branches):
        theta1, tilt, theta5, theta6, bend, lift = hands[(branch % 4) // 2, branch // 4]
        theta3 = -bend if branch % 2 else bend
        theta2 = lift - np.arctan2(form.c3 * np.sin(theta3), form.c2 + form.c3 * np.cos(theta3))
        whole = 0.0 * bend  # a branch exists as a whole or not at all
        columns = (theta1 + whole, theta2, theta3, tilt - theta2 - theta3, theta5 + whole, theta6 + whole)
        for j, column in enumerate(columns):
            result[slot, j] = (column + form.offsets[j]) * form.signs[j]
    return np.moveaxis(result, (0, 1), (-2, -1))


def _hand(
    form: ParallelParameters,
    front: FloatArray,
    side: FloatArray,
    rise: FloatArray,
    out: FloatArray,
    up: FloatArray,
    wrist: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The sum of theta 2 to 4, theta 5 and 6, the elbow's angle without its sign, and under which angle from
    upright axis 4 is seen from axis 2.

    ``front``, ``side``, ``rise`` (..., 3): what the flange's axes have of those of link 1; ``out``, ``up``:
    where axes 5 and 6 meet, from axis 2.
    """
    sine = np.hypot(front[..., 2], rise[..., 2])
    theta5 = np.arctan2(sine, side[..., 2])
    sign = -1.0 if wrist else 1.0
    free = sine < LINED_UP
    theta6 = np.where(free, 0.0, np.arctan2(-sign * side[..., 1], sign * side[..., 0]))
    c6, s6 = np.cos(theta6), np.sin(theta6)
    # axis 5 by the flange's axes: exact beside a singularity too, whatever theta 6 has come out as
    tilt = np.arctan2(-s6 * front[..., 0] - c6 * front[..., 1], -s6 * rise[..., 0] - c6 * rise[..., 1])
    away, high = out - form.c4 * np.sin(tilt), up - form.c4 * np.cos(tilt)
    cosine = (away * away + high * high - form.c2**2 - form.c3**2) / (2.0 * form.c2 * form.c3)
    near = np.clip(cosine, -1.0, 1.0)
    bend = np.arccos(np.where(np.abs(cosine - near) > ROUNDING, np.nan, near))
    return tilt, sign * theta5, theta6, bend, np.arctan2(away, high)


def singularities(form: ParallelParameters, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles (...,) [rad] of joints (..., 6) from lining up axes 4 and 6, from a stretched or folded elbow,
    and under which the stretched arm would see how far the point where axes 5 and 6 meet is from where its
    two shoulder branches are one."""
    theta = form.signs * q - form.offsets
    wrist, elbow = (np.abs(np.arcsin(np.sin(theta[..., j]))) for j in (4, 2))
    sums = np.cumsum(theta[..., 1:4], axis=-1)
    out = np.sin(sums) @ np.array([form.c2, form.c3, form.c4])
    return wrist, elbow, np.arcsin(np.minimum(1.0, np.abs(out) / (form.c2 + form.c3 + abs(form.c4))))


def reach_gap(form: ParallelParameters, flange: FloatArray) -> FloatArray:
    """How far (...,) [m] the point where axes 5 and 6 meet, of flange poses (..., 4, 4) in the form's base,
    lies outside what the arm reaches, whatever the hand's tilt."""
    meeting = flange[..., :3, 3] - form.c5 * flange[..., :3, 2]
    square = meeting[..., 0] ** 2 + meeting[..., 1] ** 2
    beside = form.b - np.sqrt(square)
    distance = np.hypot(np.sqrt(np.maximum(square - form.b**2, 0.0)), meeting[..., 2] - form.c1)
    least = abs(form.c2 - form.c3) - abs(form.c4)
    gap = np.maximum(distance - (form.c2 + form.c3 + abs(form.c4)), least - distance)
    return np.asarray(np.maximum(np.maximum(gap, beside), 0.0))
