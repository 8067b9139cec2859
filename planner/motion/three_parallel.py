"""Inverse kinematics of arms whose axes 2, 3 and 4 are parallel, as those of UR, batched over poses.

The derivation follows the form in :class:`planner.catalogue.robots.ParallelParameters`. The point where axes
5 and 6 meet is fixed in the flange. Only joint 1 changes its component along axis 2, which gives theta 1 (two
solutions). The angle between axis 6 and axis 2 gives theta 5 (two solutions). Theta 6 and the sum of theta 2
to 4 follow. Theta 2 and 3 are those of two links in a plane (two solutions).

Singularities: if sin(theta 5) = 0, axis 6 is parallel to axis 4 and only the sum of their rotations is
determined; theta 6 is set to 0. If the elbow is stretched or folded, its two branches coincide. So do those
of the shoulder if the point above lies at distance b from axis 1.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import ParallelParameters
from planner.geometry.arrays import FloatArray

PARALLEL_SINE_TOLERANCE: Final = 1e-9
"""Sine of theta 5 below which axes 4 and 6 count as parallel."""
COSINE_TOLERANCE: Final = 1e-12
"""Maximum excess over 1 of the cosine of the elbow angle that is treated as rounding."""


def inverse_kinematics(form: ParallelParameters, flange: FloatArray, branches: Sequence[int]) -> FloatArray:
    """Compute the joint angles of flange poses on given branches.

    The branch number of a solution is continuous in the pose while the arm passes no singularity.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the base.
        branches: Branch numbers as in :func:`planner.motion.planning_scene.inverse_kinematics`.

    Returns:
        Joint angles (..., len(branches), 6) [rad], not wrapped into limits; NaN where no solution exists.
    """
    flange = form.inner(flange)
    r = flange[..., :3, :3]
    meeting = flange[..., :3, 3] - form.c5 * r[..., :, 2]
    x, y, up = meeting[..., 0], meeting[..., 1], meeting[..., 2] - form.c1
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(x * x + y * y - form.b * form.b)
    azimuth, skew = np.arctan2(y, x), np.arctan2(form.b, radial)
    wrist_solutions = {}
    # branch number: elbow = b % 2, shoulder = (b % 4) // 2, wrist = b // 4; each choice is solved once
    for shoulder in {(b % 4) // 2 for b in branches}:
        theta1 = azimuth - skew if shoulder == 0 else azimuth + skew - np.pi
        c, s = np.cos(theta1)[..., None], np.sin(theta1)[..., None]
        front, side = c * r[..., 0, :] + s * r[..., 1, :], c * r[..., 1, :] - s * r[..., 0, :]
        axes = _FlangeAxes(front, side, r[..., 2, :])
        radius = radial if shoulder == 0 else -radial
        for wrist in {b // 4 for b in branches if (b % 4) // 2 == shoulder}:
            wrist_solutions[shoulder, wrist] = theta1, *_wrist_solution(form, axes, radius, up, wrist)
    result = np.empty((len(branches), 6, *flange.shape[:-2]))  # one block per joint
    for slot, branch in enumerate(branches):
        theta1, tilt, theta5, theta6, bend, lift = wrist_solutions[(branch % 4) // 2, branch // 4]
        theta3 = -bend if branch % 2 else bend
        theta2 = lift - np.arctan2(form.c3 * np.sin(theta3), form.c2 + form.c3 * np.cos(theta3))
        nan_mask = 0.0 * bend  # propagates NaN, so that a branch exists completely or not at all
        columns = (
            theta1 + nan_mask,
            theta2,
            theta3,
            tilt - theta2 - theta3,
            theta5 + nan_mask,
            theta6 + nan_mask,
        )
        for j, column in enumerate(columns):
            result[slot, j] = (column + form.offsets[j]) * form.signs[j]
    return np.moveaxis(result, (0, 1), (-2, -1))


@dataclasses.dataclass(frozen=True)
class _FlangeAxes:
    """Components of the three flange axes along the axes of link 1.

    Attributes:
        front: (..., 3) components along the horizontal direction of the arm.
        side: (..., 3) components along axis 2.
        rise: (..., 3) components along axis 1.
    """

    front: FloatArray
    side: FloatArray
    rise: FloatArray


def _wrist_solution(
    form: ParallelParameters, axes: _FlangeAxes, radius: FloatArray, up: FloatArray, wrist: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute the angles of the wrist and the elbow for one choice of shoulder and wrist.

    Args:
        form: Kinematic parameters.
        axes: Axes of the flange.
        radius: (...,) [m] horizontal position of the point where axes 5 and 6 meet, relative to axis 2.
        up: (...,) [m] height of that point, relative to axis 2.
        wrist: Choice of the wrist, 0 or 1.

    Returns:
        The sum of theta 2 to 4, theta 5, theta 6, the absolute elbow angle, and the angle from vertical at
        which axis 4 is seen from axis 2, each (...,) [rad].
    """
    front, side, rise = axes.front, axes.side, axes.rise
    sine = np.hypot(front[..., 2], rise[..., 2])
    theta5 = np.arctan2(sine, side[..., 2])
    sign = -1.0 if wrist else 1.0
    is_singular = sine < PARALLEL_SINE_TOLERANCE
    theta6 = np.where(is_singular, 0.0, np.arctan2(-sign * side[..., 1], sign * side[..., 0]))
    c6, s6 = np.cos(theta6), np.sin(theta6)
    # axis 5 in the flange's axes: exact near a singularity too, whatever value theta 6 has
    tilt = np.arctan2(-s6 * front[..., 0] - c6 * front[..., 1], -s6 * rise[..., 0] - c6 * rise[..., 1])
    horizontal, vertical = radius - form.c4 * np.sin(tilt), up - form.c4 * np.cos(tilt)  # of axis 4
    # law of cosines: cos(theta 3) = (d^2 - c2^2 - c3^2) / (2 c2 c3)
    cosine = (horizontal * horizontal + vertical * vertical - form.c2**2 - form.c3**2) / (
        2.0 * form.c2 * form.c3
    )
    clipped = np.clip(cosine, -1.0, 1.0)
    bend = np.arccos(np.where(np.abs(cosine - clipped) > COSINE_TOLERANCE, np.nan, clipped))
    return tilt, sign * theta5, theta6, bend, np.arctan2(horizontal, vertical)


def singularities(form: ParallelParameters, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the angles from singularities of the wrist, the elbow and the shoulder.

    - Wrist: angle between axes 4 and 6.
    - Elbow: angle from stretched or folded.
    - Shoulder: the two shoulder branches coincide if the point where axes 5 and 6 meet lies in the plane of
      axes 1 and 2. The angle is that under which the stretched arm would see its distance from this plane.

    Args:
        form: Kinematic parameters.
        q: (..., 6) [rad] joints.

    Returns:
        Three arrays (...,) [rad]: wrist, elbow, shoulder.
    """
    theta = form.signs * q - form.offsets
    wrist, elbow = (np.abs(np.arcsin(np.sin(theta[..., j]))) for j in (4, 2))
    sums = np.cumsum(theta[..., 1:4], axis=-1)
    radius = np.sin(sums) @ np.array([form.c2, form.c3, form.c4])  # horizontal position of the point
    return wrist, elbow, np.arcsin(np.minimum(1.0, np.abs(radius) / (form.c2 + form.c3 + abs(form.c4))))


def reach_gap(form: ParallelParameters, flange: FloatArray) -> FloatArray:
    """Return a lower bound (...,) [m] of the distance from reach of the point where axes 5 and 6 meet.

    The tilt of the wrist is free, so the link between axes 4 and 5 counts as additional reach.

    Args:
        form: Kinematic parameters.
        flange: (..., 4, 4) flange poses in the form's base.
    """
    meeting = flange[..., :3, 3] - form.c5 * flange[..., :3, 2]
    square = meeting[..., 0] ** 2 + meeting[..., 1] ** 2
    axis_gap = form.b - np.sqrt(square)
    distance = np.hypot(np.sqrt(np.maximum(square - form.b**2, 0.0)), meeting[..., 2] - form.c1)
    inner_radius = abs(form.c2 - form.c3) - abs(form.c4)
    gap = np.maximum(distance - (form.c2 + form.c3 + abs(form.c4)), inner_radius - distance)
    return np.asarray(np.maximum(np.maximum(gap, axis_gap), 0.0))
