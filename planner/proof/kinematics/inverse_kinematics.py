"""Joint angles of a tool pose in closed form, and the solution that a controller selects among them.

The solution is derived here from the closed form in :class:`planner.proof.kinematics.arm_model.ArmShape`,
whose dimensions are those of the URDF's axes, by intersecting two circles in the plane of axis 1. It shares
no code with the planner's solver. Each solution is put through the chain of the URDF and counts only if that
leads back to its pose. A branch is the number 4 * (wrist centre behind axis 1) + 2 * (wrist centre behind the
lower arm) + (axis 5 negative), ABB's cfx of serial arms.

ABB's confdata select the branch by cfx and the quadrants of axes 1, 4 and 6. Quadrant n covers n * 90 to (n
+ 1) * 90 degrees (ABB, Technical reference manual RAPID, confdata), so a value also fixes the whole turns
of an axis that turns more than once.

KUKA's Status (expert manual, as cited in public posts): bit 0 is set if the wrist's centre lies behind axis
1 (x < 0 in the frame that turns with axis 1), bit 1 if axis 3 is at or beyond the angle at which shoulder,
elbow and wrist are in line, bit 2 if axis 5 is negative. Turn: bit i - 1 is set if axis i is negative.
"""

import dataclasses
import itertools

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, inverse
from planner.proof.kinematics import offset_arm, parallel_arm, seven_arm
from planner.proof.kinematics.arm_model import RobotMachine

FULL_TURN_RAD = 2.0 * np.pi
"""One turn of a joint [rad]."""
POSE_TOLERANCE = 1e-9
"""Tolerance [m, and each entry of the rotation] between a pose and its solution in the URDF's chain."""


def solve(machine: RobotMachine, flange: FloatArray, branch: IntArray) -> FloatArray:
    """Return serial joint angles of flange poses on given branches.

    Axes 1, 4 and 6 have the turn in which the angles theta of the closed form are within (-pi, pi]. The
    caller adds whole turns (:func:`nearest_turns`).
    Arms with three parallel axes have branches of their own (:mod:`planner.proof.kinematics.parallel_arm`).

    Args:
        machine: The robot.
        flange: Flange poses (B, 4, 4) in the base.
        branch: Branches (B,).

    Returns:
        Angles (B, 6) [rad]. They are NaN if the pose is out of reach, if the URDF's chain does not lead to
        the pose, and for arms with an offset wrist, whose branches no text names.
    """
    if machine.is_followed:
        return np.full((len(flange), 6), np.nan)
    if machine.spherical_shape is None:
        q = parallel_arm.solve(machine.table, flange, branch)
        return _verified(machine, q, flange)
    p = machine.shape
    form_pose = inverse(p.left) @ flange @ inverse(p.right)
    rotation = form_pose[:, :3, :3]
    wrist = form_pose[:, :3, 3] - p.c4 * rotation[:, :, 2]
    behind_axis_1, below, negative = (branch & 4) > 0, (branch & 2) > 0, (branch & 1) > 0
    with np.errstate(invalid="ignore"):
        radial = np.sqrt(wrist[:, 0] ** 2 + wrist[:, 1] ** 2 - p.b**2)
        shoulder_angle = np.arctan2(p.b, radial)
        t1 = np.arctan2(wrist[:, 1], wrist[:, 0]) + np.where(
            behind_axis_1, shoulder_angle - np.pi, -shoulder_angle
        )
        x = np.where(behind_axis_1, -radial, radial) - p.a1
        z = wrist[:, 2] - p.c1
        forearm = np.hypot(p.a2, p.c3)
        # Elbow by the cosine rule, with links c2 and hypot(a2, c3).
        bend = np.arccos(_clipped_cosine((x * x + z * z - p.c2**2 - forearm**2) / (2.0 * p.c2 * forearm)))
        bend = np.where(below, -bend, bend)
    t3 = bend - np.arctan2(p.a2, p.c3)
    t2 = np.arctan2(x, z) - np.arctan2(forearm * np.sin(bend), p.c2 + forearm * np.cos(bend))
    c1, s1, c23, s23 = np.cos(t1), np.sin(t1), np.cos(t2 + t3), np.sin(t2 + t3)
    # e0, e1, e2 are the columns of R = Rz(t1) Ry(t2 + t3). The wrist's rotation is R^T times the flange's.
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
    # Axis 3 of some arms reaches below -180 degrees, so axes 2 and 3 take the turn next to their middle.
    middle = 0.5 * (machine.data.lower + machine.data.upper)
    q[:, 1:3] = middle[1:3] + wrapped(q[:, 1:3] - middle[1:3])
    return _verified(machine, q, flange)


def _verified(machine: RobotMachine, q: FloatArray, flange: FloatArray) -> FloatArray:
    """Return joints ``q`` (B, 6), NaN where the URDF's chain does not lead to the poses ``flange`` (B, 4, 4).

    ``q`` is changed in place.
    """
    deviation = np.abs(machine.flange(q) - flange).max(axis=(1, 2), initial=0.0)
    q[~(deviation <= POSE_TOLERANCE)] = np.nan
    return q


def branch_of(machine: RobotMachine, q: FloatArray) -> IntArray:
    """Return the branch (...,) of serial joint angles (..., 6), 0 for an arm with an offset wrist."""
    if machine.is_followed:
        return np.zeros(q.shape[:-1], dtype=np.int64)
    if machine.spherical_shape is None:
        return parallel_arm.branch_of(machine.table, q)
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm, forearm_angle = np.hypot(p.a2, p.c3), np.arctan2(p.a2, p.c3)
    radial = (
        p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + forearm_angle)
    )
    below = np.sin(theta[..., 2] + forearm_angle) < 0.0
    return np.asarray(4 * (radial < 0.0) + 2 * below + (q[..., 4] < 0.0), dtype=np.int64)


def nearest_turns(q: FloatArray, reference: FloatArray) -> FloatArray:
    """Return joints ``q`` (..., 6) [rad] with whole turns added to axes 1, 4 and 6.

    The turns bring them as near as possible to ``reference`` (..., 6) [rad].
    """
    out = np.array(q)
    for axis in (0, 3, 5):
        out[..., axis] += FULL_TURN_RAD * np.round((reference[..., axis] - q[..., axis]) / FULL_TURN_RAD)
    return out


def unwrapped_path(machine: RobotMachine, q: FloatArray, start: FloatArray) -> FloatArray:
    """Return joint angles ``q`` (B, 6) [rad] along a path with whole turns added, so that they do not jump.

    The first posture takes the turns nearest to ``start`` (6,). Each other posture takes the turns nearest to
    the posture before it. Turns are added to axes 1, 4 and 6, and to all axes of an arm without a spherical
    wrist.
    """
    out = np.array(q)
    for axis in range(6) if machine.spherical_shape is None else (0, 3, 5):
        column = np.concatenate([start[None, axis], q[:, axis]])
        steps = np.diff(column)
        steps = steps - FULL_TURN_RAD * np.round(steps / FULL_TURN_RAD)
        out[:, axis] = start[axis] + np.cumsum(steps)
    return out


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % FULL_TURN_RAD - np.pi)


def singularity_distance(machine: RobotMachine, q: FloatArray) -> FloatArray:
    """Return the angle (...,) [rad] of serial angles (..., 6) to the nearest singularity.

    It is the smallest of three angles: of axis 5 from 0 or 180 degrees (wrist), of the bend between lower arm
    and forearm from 0 or 180 degrees (elbow), and the angle whose tangent is the distance of the wrist centre
    from axis 1 divided by the length of the forearm (shoulder). Arms with three parallel axes, an offset
    wrist or seven axes (..., 7) have measures of their own.
    """
    if machine.spherical_shape is None:
        if machine.is_followed:
            return offset_arm.singularity_distance(machine.chain, q)
        if len(machine.chain.axis) == 7:
            return seven_arm.singularity_distance(machine.chain, q)
        return parallel_arm.singularity_distance(machine.table, q)
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm, forearm_angle = np.hypot(p.a2, p.c3), np.arctan2(p.a2, p.c3)
    wrist = np.abs(wrapped(theta[..., 4]))
    wrist = np.minimum(wrist, np.pi - wrist)
    bend = np.abs(wrapped(theta[..., 2] + forearm_angle))
    elbow = np.minimum(bend, np.pi - bend)
    radial = (
        p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + forearm_angle)
    )
    shoulder = np.arctan2(np.abs(radial), forearm)
    return np.asarray(np.minimum(np.minimum(wrist, elbow), shoulder))


def _clipped_cosine(cosine: FloatArray) -> FloatArray:
    """Clip cosines that are a rounding error beyond 1. Those farther beyond are out of reach (NaN)."""
    return np.where(np.abs(cosine) < 1.0 + 1e-12, np.clip(cosine, -1.0, 1.0), np.nan)


QUADRANT_ANGLE_RAD = 0.5 * np.pi
"""A quarter of a turn [rad]."""
_CONF_AXES = (0, 3, 5)
"""Axes 1, 4 and 6, whose quadrants confdata name."""
QUADRANT_TOLERANCE_RAD = np.deg2rad(0.01)
"""Tolerance [rad] at a quadrant's border. Rounding of a target may put an axis at exactly 90 degrees on
either side of the border.
"""


def select_by_confdata(machine: RobotMachine, flange: FloatArray, conf: IntArray) -> FloatArray:
    """Return the joint angles (B, 6) [rad] that confdata alone select, NaN where no solution fits.

    verify.confdata compares them with the motion.

    Args:
        machine: The robot, with a spherical wrist or parallel axes.
        flange: Flange poses (B, 4, 4) in the base.
        conf: Confdata (B, 4): quadrants of axes 1, 4 and 6, and the branch (cfx, 0 to 7).
    """
    q = solve(machine, flange, conf[:, 3])
    for column, axis in enumerate(_CONF_AXES):
        # Add the whole turns that bring the axis nearest to the middle of its quadrant. If it does not lie
        # in the quadrant then, no solution fits.
        middle = (conf[:, column] + 0.5) * QUADRANT_ANGLE_RAD
        q[:, axis] += FULL_TURN_RAD * np.round((middle - q[:, axis]) / FULL_TURN_RAD)
        outside = np.abs(q[:, axis] - middle) > 0.5 * QUADRANT_ANGLE_RAD + QUADRANT_TOLERANCE_RAD
        q[outside] = np.nan
    q[(conf[:, 3] < 0) | (conf[:, 3] > 7)] = np.nan
    return q


def fits_confdata(machine: RobotMachine, q: FloatArray, conf: IntArray) -> BoolArray:
    """Return flags (B,): whether joint angles ``q`` (B, 6) [rad] fit confdata ``conf`` (B, 4).

    They must have the stated quadrants of axes 1, 4 and 6, with a tolerance at borders, and the branch.
    """
    middle = (conf[:, :3] + 0.5) * QUADRANT_ANGLE_RAD
    quadrant = np.all(
        np.abs(q[:, _CONF_AXES] - middle) <= 0.5 * QUADRANT_ANGLE_RAD + QUADRANT_TOLERANCE_RAD, axis=-1
    )
    return np.asarray(quadrant & (branch_of(machine, q) == conf[:, 3]))


NEAR_ZERO_ANGLE_RAD = np.deg2rad(2.0)
"""Angle [rad] from zero below which a controller may ignore the bit of an axis in Turn."""
_ZERO_TOLERANCE_RAD = np.deg2rad(1e-4)
"""Tolerance [rad] of the sign of an axis against its bit in Turn, because poses are rounded."""
_SOLUTION_TOLERANCE_RAD = np.deg2rad(1e-3)
"""Joint difference [rad] up to which solutions are equal."""


@dataclasses.dataclass(frozen=True)
class StatusSolutions:
    """Solutions that Status and Turn allow.

    Attributes:
        q: Solutions (K, 6) [rad, serial] within the limits.
        near_zero: Axes (from 1) of the first solution that are so close to zero that Turn may not count for
            them.
    """

    q: FloatArray
    near_zero: tuple[int, ...]


def straight_elbow(machine: RobotMachine) -> float:
    """Return axis 3 [rad] at which shoulder, elbow and wrist are in line with the arm stretched."""
    p = machine.shape
    return float(p.signs[2] * (p.offsets[2] - np.arctan2(p.a2, p.c3)))


def status_of(machine: RobotMachine, q: FloatArray) -> IntArray:
    """Return KUKA's Status (...,), bits 0 to 2, of serial joint angles (..., 6)."""
    p = machine.shape
    theta = p.signs * q - p.offsets
    forearm = np.hypot(p.a2, p.c3)
    forearm_angle = np.arctan2(p.a2, p.c3)
    radial = (
        p.a1 + p.c2 * np.sin(theta[..., 1]) + forearm * np.sin(theta[..., 1] + theta[..., 2] + forearm_angle)
    )
    bent = p.signs[2] * (q[..., 2] - straight_elbow(machine)) >= 0.0
    return np.asarray((radial < 0.0) + 2 * bent + 4 * (q[..., 4] < 0.0), dtype=np.int64)


def select_by_status(machine: RobotMachine, flange: FloatArray, status: int, turn: int) -> StatusSolutions:
    """Return all solutions of a flange pose (4, 4) within the limits that have KUKA's Status and Turn.

    The pose is in the base. Solutions of all eight branches are tried, with all whole turns of all axes that
    the limits allow. An axis within a tolerance of 0 fits both values of its bit in Turn.

    Args:
        machine: The robot, with a spherical wrist.
        flange: Flange pose (4, 4) in the base.
        status: Status: bit 0 for a wrist behind axis 1, bit 1 for axis 3 beyond the stretched elbow, bit 2
            for a negative axis 5.
        turn: Turn: bit i - 1 is set if axis i is negative.
    """
    branch_solutions = solve(machine, np.tile(flange, (8, 1, 1)), np.arange(8))
    branch_solutions = branch_solutions[np.isfinite(branch_solutions).all(axis=1)]
    solutions: list[FloatArray] = []
    for q in (
        branch_solutions[status_of(machine, branch_solutions) == status]
        if len(branch_solutions)
        else branch_solutions
    ):
        values_by_axis = [
            _turns_in_limits(q[axis], machine.data.lower[axis], machine.data.upper[axis]) for axis in range(6)
        ]
        for candidate in itertools.product(*values_by_axis):
            values = np.array(candidate)
            negative = np.array([bool(turn >> axis & 1) for axis in range(6)])
            fits = np.where(negative, values < _ZERO_TOLERANCE_RAD, values >= -_ZERO_TOLERANCE_RAD)
            if fits.all() and not any(
                np.abs(values - other).max() < _SOLUTION_TOLERANCE_RAD for other in solutions
            ):
                solutions.append(values)
    near_zero = (
        tuple(int(i) + 1 for i in np.flatnonzero(np.abs(solutions[0]) < NEAR_ZERO_ANGLE_RAD))
        if solutions
        else ()
    )
    return StatusSolutions(np.array(solutions).reshape(-1, 6), near_zero)


def _turns_in_limits(angle: float, lower: float, upper: float) -> list[float]:
    """Return the angle with all whole turns that lie within the limits, with a small tolerance."""
    low = np.ceil((lower - _ZERO_TOLERANCE_RAD - angle) / FULL_TURN_RAD)
    high = np.floor((upper + _ZERO_TOLERANCE_RAD - angle) / FULL_TURN_RAD)
    return [angle + FULL_TURN_RAD * k for k in range(int(low), int(high) + 1)]
