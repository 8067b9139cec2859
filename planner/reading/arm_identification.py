"""Identification of the closed-form kinematics of an arm from its chain of joints.

Lengths, offsets and signs follow from the axes alone, never from names or other files. The forms are:

- Brandstoetter, Angerer, Hofbaur (2014): ortho-parallel basis and spherical wrist;
- the same with an offset wrist, whose axis 6 misses the intersection of axes 4 and 5;
- three parallel axes, as UR arms;
- seven axes, as Panda and iiwa.

The result is verified against the chain on 1,000 postures. Arms of other forms are refused with their class.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue.robots import (
    ArmForm,
    OffsetParameters,
    OpwParameters,
    ParallelParameters,
    SevenParameters,
)
from planner.cell.kinematics import flange_poses, form_jacobian
from planner.geometry.arrays import FloatArray, from_parts, from_rpy, inverse, log_rotation
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.reading.urdf import SNAP_STEP_RAD, CoupledError, UrdfChain, limit_faults, read_chain

INTERSECTION_TOLERANCE_M: Final = 3e-3
"""Maximum distance [m] between axes that count as intersecting, to classify an arm.

Smaller deviations from the exact form are refused by their effect on the TCP.
"""
PARALLELISM_TOLERANCE_RAD: Final = 1e-3
"""Maximum angle error [rad] of axes that count as parallel or perpendicular, to classify an arm."""
MAX_DEVIATION_M: Final = 5e-10
"""Maximum deviation [m] of the closed form from the tip on all tested postures.

Half of what the proof allows.
"""
MAX_DEVIATION_RAD: Final = 5e-10
"""Maximum deviation [rad] of the closed form from the tip on all tested postures."""
TEST_POSTURES: Final = 1000
"""Number of tested postures within the limits, from a fixed seed."""
_ANGLE_ROUNDING_RAD: Final = 1e-4
"""Offsets within this [rad] of a multiple of 15 degrees are rounded to it."""
_LENGTH_ROUNDING_M: Final = 1e-10
"""Lengths within this [m] of a multiple of 1e-7 m are rounded to it, to remove noise of sums of decimals."""
_SEED: Final = 19


@dataclasses.dataclass(frozen=True)
class ArmFit:
    """Closed form of a chain with its deviations.

    Attributes:
        form: Closed form.
        deviation: Maximum deviation of the closed form from the tip of the chain, [m] and [rad].
        snapped: Maximum deviation of the chain, with snapped angles, from the file as written, [m] and [rad].
    """

    form: ArmForm
    deviation: tuple[float, float]
    snapped: tuple[float, float]


def fit_arm(chain: UrdfChain) -> ArmFit:
    """Identify the closed form of a chain.

    Raises:
        TandemError: ``robot.not_opw`` with the class of the arm, ``robot.limits``, or ``robot.deviation`` if
            the form deviates by more than allowed.
    """
    issues = [issue for issue in (_class_fault(chain),) if issue is not None] + limit_faults(chain)
    if issues:
        raise TandemError(issues)
    form = _identify_form(chain)
    rng = np.random.default_rng(_SEED)
    q = rng.uniform(chain.lower, chain.upper, size=(TEST_POSTURES, form.count))
    tip = chain.tip(q)
    deviation = _max_pose_difference(flange_poses(form, q), tip)
    if not (deviation[0] <= MAX_DEVIATION_M and deviation[1] <= MAX_DEVIATION_RAD):
        message = format_message(
            "robot.deviation",
            kinematic_class=_KINDS[type(form)],
            deviation_mm=deviation[0] / MM,
            deviation_rad=deviation[1],
            posture_count=TEST_POSTURES,
            max_deviation_mm=MAX_DEVIATION_M / MM,
            max_deviation_rad=MAX_DEVIATION_RAD,
        )
        hint = "its dimensions have noise, as if measured on meshes: use those of the manufacturer's drawing"
        hint += _first_deviation_hint(chain, form)
        raise issue_error(
            "robot.deviation",
            message,
            field="urdf",
            **measurement(deviation[0] / MM, MAX_DEVIATION_M / MM, "mm"),
            hint=hint,
        )
    return ArmFit(form, deviation, _max_pose_difference(chain.tip(q, written=True), tip))


def read_custom_chain(text: str, base: str, tip: str | None) -> UrdfChain:
    """Read a chain as :func:`planner.reading.urdf.read_chain`.

    If joints are coupled, the error also says whether the arm with these joints fixed is of an unsupported
    class.

    Raises:
        TandemError: With the issues of ``read_chain``.
    """
    try:
        return read_chain(text, base, tip)
    except CoupledError as error:
        arm_class = _unsupported_class(error.chain.axis, error.chain.zero[1:-1, :3, 3], error.chain)
        if arm_class is None:
            raise
        class_text, hint = arm_class
        first, *rest = error.issues
        message = (
            f"{first.message.rpartition('; ')[0]}; if fixed, the arm is {class_text}: {hint}; for a parallel "
        )
        message += "rod give the serial arm and its coupled_deg"
        raise TandemError([dataclasses.replace(first, message=message), *rest]) from None


def _first_deviation_hint(chain: UrdfChain, form: ArmForm) -> str:
    """Return a hint on the first joint whose axis at zero deviates from the form; empty if only the tip does.

    The columns of both Jacobians at zero are compared.
    """
    tip, points = chain.zero[-1, :3, 3], chain.zero[1:-1, :3, 3]
    jacobian = np.concatenate([chain.axis, np.cross(chain.axis, tip - points)], axis=1)
    rotation_error, translation_error = (
        np.abs(form_jacobian(form, np.zeros(form.count)).T - jacobian).reshape(-1, 2, 3).max(2).T
    )
    deviating = np.flatnonzero((translation_error > MAX_DEVIATION_M) | (rotation_error > MAX_DEVIATION_RAD))
    if not len(deviating):
        return ""
    first = deviating[0]
    amount = (
        f"{translation_error[first] / MM:.3g} mm"
        if rotation_error[first] <= MAX_DEVIATION_RAD
        else f"{rotation_error[first]:.3g} rad"
    )
    return f"; at zero they first deviate from that form at joint {chain.joints[first]!r}, by {amount}"


def _identify_form(chain: UrdfChain) -> ArmForm:
    if len(chain.axis) == 7:
        return _fit_seven_axis_arm(chain)
    return _fit_parallel_arm(chain) if _are_parallel(chain.axis[2], chain.axis[3]) else _fit_wrist_arm(chain)


def _max_pose_difference(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return the maximum distance [m] and angle [rad] between poses (B, 4, 4)."""
    distance = np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1)
    angle = np.linalg.norm(log_rotation(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3]), axis=1)
    return float(distance.max()), float(angle.max())


_KINDS: Final = {
    OpwParameters: "a spherical wrist",
    OffsetParameters: "an offset wrist",
    ParallelParameters: "three parallel axes, as UR arms",
    SevenParameters: "seven axes, as a Panda or an iiwa",
}


# ---- classes -----------------------------------------------------------------------------------------


def _class_fault(chain: UrdfChain) -> Issue | None:
    """Return the reason why a chain has no closed form, by its class; None if it has."""
    w, p = chain.axis, chain.zero[1 : len(chain.axis) + 1, :3, 3]
    arm_class = _unsupported_class(w, p, chain)
    if arm_class is None:
        return None
    class_text, hint = arm_class
    return Issue(
        "robot.not_opw",
        format_message("robot.not_opw", first_link=chain.links[0], arm_class=class_text),
        field="urdf",
        hint=hint,
    )


_OTHER_CLASS_HINT: Final = (
    "use an arm with a spherical or an offset wrist, or one like UR arms; this class is not supported yet"
)
_FIVE_AXES_TIP_HINT: Final = (
    "name the flange after the sixth axis as tip; moving joints follow the present tip"
)
_FIVE_AXES_HINT: Final = (
    "its tool axis always stays in a plane through axis 1; use the version with six "
    "axes, which most manufacturers of such arms offer"
)
_POSITIONER_HINT: Final = (
    "state it separately, under the block (turntable: or positioner: of the cell), with its centre, axes "
    "and ranges; for a robot, name the base and the flange of an arm"
)
_SEVEN_AXES_HINT: Final = (
    "make the third joint fixed in a copy of the URDF: the arm can be planned with the other six joints if "
    "they are of a supported class"
)


def _unsupported_class(w: FloatArray, p: FloatArray, chain: UrdfChain) -> tuple[str, str] | None:
    """Return the class of an arm that has no closed form here, with a hint; None if it has one.

    Its axes at zero have the directions w (J, 3) and pass through the points p (J, 3) [m].
    """
    count = len(w)
    if count == 7:
        difference = _difference_from_panda(w, p)
        return None if difference is None else (f"an arm with seven axes {difference}", _SEVEN_AXES_HINT)
    if count == 5:
        return "an arm with five axes", _FIVE_AXES_TIP_HINT if chain.has_joints_after_tip else _FIVE_AXES_HINT
    if count > 7:
        return (
            f"an arm with {count} axes",
            "name the first link of the arm itself as base, after external axes",
        )
    if count < 5:
        if count in (1, 2) and not chain.has_joints_after_tip:
            return f"a positioner with {count} ax{'is' if count == 1 else 'es'}", _POSITIONER_HINT
        return f"a chain with {count} axes", "name the base and the flange of an arm"
    if not _are_parallel(w[1], w[2]):
        return "an arm with six axes whose axes 2 and 3 are not parallel", _OTHER_CLASS_HINT
    if _are_parallel(w[2], w[3]):
        difference = _difference_from_ur(w, p)
        return (
            None
            if difference is None
            else (f"an arm with three parallel axes (2, 3 and 4), {difference}", _OTHER_CLASS_HINT)
        )
    if not _do_intersect(w, p, (3, 4)):
        return "an arm whose axes 4 and 5 do not meet", _OTHER_CLASS_HINT
    for a, b in ((0, 1), (2, 3), (3, 4), (4, 5)):
        if abs(float(w[a] @ w[b])) > PARALLELISM_TOLERANCE_RAD:
            angle = np.arccos(abs(float(w[a] @ w[b]))) / DEG
            return f"an arm whose axes {a + 1} and {b + 1} are at {angle:.4g} degrees", _OTHER_CLASS_HINT
    offset = float((_common_perpendicular_midpoint(p[3], w[3], p[4], w[4]) - p[0]) @ w[1])
    if not _do_intersect(w, p, (3, 4, 5)) and abs(offset) > INTERSECTION_TOLERANCE_M:
        description = f"axes 4 and 5 intersect {abs(offset) / MM:.4g} mm off the plane of axis 1"
        return f"an arm with an offset wrist, and {description}", _OTHER_CLASS_HINT
    return None


def _difference_from_ur(w: FloatArray, p: FloatArray) -> str | None:
    """Return how an arm with three parallel axes differs from UR arms; None if it does not."""
    for a, b in ((0, 1), (3, 4), (4, 5)):
        if abs(float(w[a] @ w[b])) > PARALLELISM_TOLERANCE_RAD:
            return f"whose axes {a + 1} and {b + 1} are not square"
        if not _do_intersect(w, p, (a, b)):
            return f"whose axes {a + 1} and {b + 1} do not meet"
    return None


def _difference_from_panda(w: FloatArray, p: FloatArray) -> str | None:
    """Return how an arm with seven axes differs from a Panda or an iiwa; None if it does not."""
    for a in range(6):
        if abs(float(w[a] @ w[a + 1])) > PARALLELISM_TOLERANCE_RAD:
            return f"whose axes {a + 1} and {a + 2} are not square"
    # axes 1 and 3 are collinear at zero, so the pair that is not parallel is intersected
    if not _do_intersect(w, p, (0, 1, 2)):
        return "whose axes 1, 2 and 3 do not meet"
    if not _do_intersect(w, p, (4, 5)):
        return "whose axes 5 and 6 do not meet"
    shoulder = _common_perpendicular_midpoint(p[1], w[1], p[2], w[2])
    wrist = _common_perpendicular_midpoint(p[4], w[4], p[5], w[5])
    offsets = [abs(float((wrist - shoulder) @ w[3])), abs(float((p[6] - wrist) @ w[5]))]
    if offsets[0] > INTERSECTION_TOLERANCE_M:
        return f"whose axis 5 passes {offsets[0] / MM:.4g} mm beside the upper arm, along axis 4"
    return (
        f"whose axis 7 is {offsets[1] / MM:.4g} mm off along axis 6"
        if offsets[1] > INTERSECTION_TOLERANCE_M
        else None
    )


def _are_parallel(a: FloatArray, b: FloatArray) -> bool:
    return float(np.linalg.norm(np.cross(a, b))) < PARALLELISM_TOLERANCE_RAD


def _do_intersect(w: FloatArray, p: FloatArray, axes: Sequence[int]) -> bool:
    """Whether axes pass through one point, the intersection of the first two that are not parallel."""
    first = axes[0]
    other = next((i for i in axes[1:] if not _are_parallel(w[first], w[i])), None)
    if other is None:
        return False
    point = _common_perpendicular_midpoint(p[first], w[first], p[other], w[other])
    distances = [float(np.linalg.norm(np.cross(point - p[i], w[i]))) for i in axes]
    return max(distances) < INTERSECTION_TOLERANCE_M


def _common_perpendicular_midpoint(a: FloatArray, u: FloatArray, b: FloatArray, v: FloatArray) -> FloatArray:
    """Return the midpoint (3,) of the common perpendicular of two lines.

    The lines pass through ``a`` along ``u`` and through ``b`` along ``v`` (unit vectors).
    """
    # a + s u and b + t v are closest for c = u.v, s = ((b-a).u - c (b-a).v) / (1 - c^2)
    # and t = (c (b-a).u - (b-a).v) / (1 - c^2)
    c = float(u @ v)
    s = ((b - a) @ u - c * ((b - a) @ v)) / (1.0 - c * c)
    t = (c * ((b - a) @ u) - (b - a) @ v) / (1.0 - c * c)
    return np.asarray(0.5 * (a + s * u + b + t * v))


# ---- parameters --------------------------------------------------------------------------------------


def _fit_wrist_arm(chain: UrdfChain) -> OpwParameters | OffsetParameters:
    """Return lengths, offsets and signs of an arm with a spherical or offset wrist.

    They follow from axes w and points p at zero. The base of the form has z along axis 1, from the base of
    the URDF to axis 2, y along axis 2, and x in the direction that the arm faces.
    """
    w, p, tip = chain.axis, chain.zero[1:7, :3, 3], chain.zero[7]
    centre = _common_perpendicular_midpoint(p[3], w[3], p[4], w[4])
    foot, side, up = _base_axes(w, p[0], p[1])
    side = side if _is_facing(np.cross(side, up), p[1] - foot, centre - foot) else -side
    left = _base(foot, side, up)
    frame = inverse(left)
    axes = w @ frame[:3, :3].T
    shoulder, elbow, wrist = (frame[:3, :3] @ x + frame[:3, 3] for x in (p[1], p[2], centre))
    # arm: theta_2 = atan2(upper_x, upper_z); theta_2 + theta_3 from the direction of axis 4
    upper, fore = elbow - shoulder, wrist - elbow
    sign4 = 1.0 if fore @ axes[3] >= 0.0 else -1.0
    along = sign4 * axes[3]
    across = np.array([along[2], 0.0, -along[0]])
    theta2 = np.arctan2(upper[0], upper[2])
    theta3 = np.arctan2(along[0], along[2]) - theta2
    elbow_frame = np.stack([across, [0.0, 1.0, 0.0], along], axis=1)  # Ry(t2 + t3)
    # wrist: each angle at zero from the direction of the next axis in the frame of the previous one
    axis_5 = elbow_frame.T @ axes[4]
    sign5 = 1.0 if axis_5[1] > 1e-9 or (abs(axis_5[1]) <= 1e-9 and axis_5[0] < 0.0) else -1.0
    theta4 = np.arctan2(-sign5 * axis_5[0], sign5 * axis_5[1])
    cos, sin = np.cos(theta4), np.sin(theta4)
    hand_frame = elbow_frame @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    flange = frame @ tip
    reach = (flange[:3, 3] - wrist) @ axes[5]
    forward = reach if abs(reach) > 1e-6 else flange[:3, 2] @ axes[5]
    sign6 = 1.0 if forward >= 0.0 else -1.0
    axis_6 = hand_frame.T @ (sign6 * axes[5])
    theta5 = np.arctan2(axis_6[0], axis_6[2])
    wrist_frame = hand_frame @ np.array(
        [[np.cos(theta5), 0.0, np.sin(theta5)], [0.0, 1.0, 0.0], [-np.sin(theta5), 0.0, np.cos(theta5)]]
    )
    flange_rotation = wrist_frame.T @ flange[:3, :3]
    theta6 = (
        np.arctan2(flange_rotation[1, 0], flange_rotation[0, 0])
        if flange_rotation[2, 2] > 1.0 - PARALLELISM_TOLERANCE_RAD
        else 0.0
    )
    theta = np.array([0.0, theta2, theta3, theta4, theta5, theta6])
    signs = np.array([np.sign(w[0] @ up), np.sign(axes[1, 1]), np.sign(axes[2, 1]), sign4, sign5, sign6])
    # axis 6 relative to the point where axes 4 and 5 meet
    axis_offset = wrist_frame.T @ (frame[:3, :3] @ p[5] + frame[:3, 3] - wrist)
    offset = float(np.hypot(axis_offset[0], axis_offset[1])) >= INTERSECTION_TOLERANCE_M
    kind: Any = OffsetParameters if offset else OpwParameters
    wrist_lengths = (
        {"a3": _round_length(axis_offset[0]), "b3": _round_length(axis_offset[1])}
        if offset
        else {"b": _round_length(wrist[1])}
    )
    form: OpwParameters | OffsetParameters = kind(
        a1=_round_length(shoulder[0]),
        a2=_round_length(fore @ across),
        c1=_round_length(shoulder[2]),
        c2=_round_length(np.hypot(upper[0], upper[2])),
        c3=_round_length(fore @ along),
        c4=_round_length(sign6 * reach),
        offsets=_round_angles(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=signs,
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH_ROUNDING_M else left,
        **wrist_lengths,
    )
    right = _round_pose(inverse(flange_poses(form, np.zeros(6))) @ tip)
    is_identity = np.abs(right - np.eye(4)).max() < MAX_DEVIATION_M
    return form if is_identity else dataclasses.replace(form, right=right)


def _fit_parallel_arm(chain: UrdfChain) -> ParallelParameters:
    """Return lengths, offsets and signs of an arm with three parallel axes.

    They follow from axes w and points p at zero. The base of the form has z along axis 1, from the base of
    the URDF to axis 2, and y along axis 2, to the side on which axes 5 and 6 intersect.
    """
    w, p, tip = chain.axis, chain.zero[1:7, :3, 3], chain.zero[7]
    shoulder = _common_perpendicular_midpoint(p[0], w[0], p[1], w[1])
    wrist, meeting = (
        _common_perpendicular_midpoint(p[3], w[3], p[4], w[4]),
        _common_perpendicular_midpoint(p[4], w[4], p[5], w[5]),
    )
    foot, side, up = _base_axes(w, p[0], shoulder)
    side_offset = (meeting - shoulder) @ side
    # a wrist in the plane of axis 1 defines no side: then y is on the side of the URDF's y
    left = _base(
        foot,
        side if (side_offset if abs(side_offset) > INTERSECTION_TOLERANCE_M else side[1]) >= 0.0 else -side,
        up,
    )
    frame = inverse(left)
    axes = w @ frame[:3, :3].T
    shoulder, elbow, wrist, meeting = (
        frame[:3, :3] @ x + frame[:3, 3] for x in (shoulder, p[2], wrist, meeting)
    )
    # all of theta_2, theta_3, theta_4 turn about y: angles from x and z components in the plane of the arm
    upper, fore, hand = elbow - shoulder, wrist - elbow, meeting - wrist
    along = hand @ axes[4]
    sign5 = -1.0 if along < 0.0 else 1.0
    theta2 = np.arctan2(upper[0], upper[2])
    theta3 = np.arctan2(fore[0], fore[2]) - theta2
    tilt = np.arctan2(sign5 * axes[4, 0], sign5 * axes[4, 2])
    tilt_rotation = from_rpy([0.0, 0.0, 0.0], [0.0, tilt, 0.0])[:3, :3]
    flange = frame @ tip
    reach = (flange[:3, 3] - meeting) @ axes[5]
    sign6 = 1.0 if (reach if abs(reach) > 1e-6 else flange[:3, 2] @ axes[5]) >= 0.0 else -1.0
    axis_6 = tilt_rotation.T @ (sign6 * axes[5])
    theta5 = np.arctan2(-axis_6[0], axis_6[1])
    local = (tilt_rotation @ from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, theta5])[:3, :3]).T @ flange[:3, :3]
    theta6 = np.arctan2(-local[2, 0], local[0, 0]) if local[1, 2] > 1.0 - PARALLELISM_TOLERANCE_RAD else 0.0
    theta = np.array([0.0, theta2, theta3, tilt - theta2 - theta3, theta5, theta6])
    form = ParallelParameters(
        b=_round_length(meeting[1]),
        c1=_round_length(shoulder[2]),
        c2=_round_length(np.hypot(upper[0], upper[2])),
        c3=_round_length(np.hypot(fore[0], fore[2])),
        c4=_round_length(abs(along)),
        c5=_round_length(sign6 * reach),
        offsets=_round_angles(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=np.array([np.sign(w[0] @ left[:3, 2]), *np.sign(axes[1:4, 1]), sign5, sign6]),
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH_ROUNDING_M else left,
    )
    right = _round_pose(inverse(flange_poses(form, np.zeros(6))) @ tip)
    is_identity = np.abs(right - np.eye(4)).max() < MAX_DEVIATION_M
    return form if is_identity else dataclasses.replace(form, right=right)


def _fit_seven_axis_arm(chain: UrdfChain) -> SevenParameters:
    """Return lengths, offsets and signs of an arm with seven axes.

    They follow from axes w and points p at zero. The base of the form has z along axis 1, from the base of
    the URDF to the shoulder, and y along axis 2.
    """
    w, p, tip = chain.axis, chain.zero[1:8, :3, 3], chain.zero[8]
    shoulder, wrist = (
        _common_perpendicular_midpoint(p[1], w[1], p[2], w[2]),
        _common_perpendicular_midpoint(p[4], w[4], p[5], w[5]),
    )
    foot, side, up = _base_axes(w, p[0], shoulder)
    left = _base(foot, side if side[1] >= 0.0 else -side, up)
    frame = inverse(left)
    axes = w @ frame[:3, :3].T
    points = p @ frame[:3, :3].T + frame[:3, 3]
    shoulder, wrist = (frame[:3, :3] @ x + frame[:3, 3] for x in (shoulder, wrist))
    flange = frame @ tip
    theta, signs, rotation = np.zeros(7), np.ones(7), np.eye(3)  # of the previous link
    signs[0], signs[1] = np.sign(w[0] @ up), np.sign(axes[1, 1])

    def next_z(axis: FloatArray, sign: float) -> float:
        """Return the rotation of the frame about its y that aligns its z with an axis."""
        local = rotation.T @ (sign * axis)
        return float(np.arctan2(local[0], local[2]))

    def next_y(axis: FloatArray, sign: float) -> float:
        """Return the rotation of the frame about its z that aligns its y with an axis."""
        local = rotation.T @ (sign * axis)
        return float(np.arctan2(-local[0], local[1]))

    def rotated(about: str, angle: float) -> FloatArray:
        """Return the rotation of the next link, by an angle about the y or z axis of the previous one."""
        rpy = [0.0, angle, 0.0] if about == "y" else [0.0, 0.0, angle]
        return np.asarray(rotation @ from_rpy([0.0, 0.0, 0.0], rpy)[:3, :3])

    # the upper arm is along axis 3 from the shoulder, the forearm along axis 5 from elbow to wrist
    signs[2] = 1.0 if (points[3] - shoulder) @ axes[2] >= 0.0 else -1.0
    theta[1] = next_z(axes[2], signs[2])
    rotation = rotated("y", theta[1])
    signs[3] = 1.0 if axes[3] @ rotation[:, 1] >= -1e-9 else -1.0  # for the smallest value of joint 3 at zero
    theta[2] = next_y(axes[3], signs[3])
    rotation = rotated("z", theta[2])
    upper = rotation.T @ (points[3] - shoulder)
    signs[4] = 1.0 if (wrist - points[3]) @ axes[4] >= 0.0 else -1.0
    theta[3] = next_z(axes[4], signs[4])
    rotation = rotated("y", theta[3])
    fore = rotation.T @ (wrist - points[3])
    reach = float((flange[:3, 3] - wrist) @ axes[6])
    signs[6] = 1.0 if (reach if abs(reach) > 1e-6 else flange[:3, 2] @ axes[6]) >= 0.0 else -1.0
    signs[5] = 1.0 if axes[5] @ rotation[:, 1] >= -1e-9 else -1.0
    theta[4] = next_y(axes[5], signs[5])
    rotation = rotated("z", theta[4])
    theta[5] = next_z(axes[6], signs[6])
    rotation = rotated("y", theta[5])
    hand = rotation.T @ (points[6] - wrist)
    local = rotation.T @ flange[:3, :3]
    theta[6] = np.arctan2(local[1, 0], local[0, 0]) if local[2, 2] > 1.0 - PARALLELISM_TOLERANCE_RAD else 0.0
    form = SevenParameters(
        a2=_round_length(upper[0]),
        a3=_round_length(fore[0]),
        a4=_round_length(hand[0]),
        c1=_round_length(shoulder[2]),
        c2=_round_length(upper[2]),
        c3=_round_length(fore[2]),
        c4=_round_length(signs[6] * reach),
        offsets=_round_angles(-np.arctan2(np.sin(theta), np.cos(theta))),
        signs=signs,
        left=None if np.abs(left - np.eye(4)).max() < _LENGTH_ROUNDING_M else left,
    )
    right = _round_pose(inverse(flange_poses(form, np.zeros(7))) @ tip)
    is_identity = np.abs(right - np.eye(4)).max() < MAX_DEVIATION_M
    return form if is_identity else dataclasses.replace(form, right=right)


def _base_axes(
    w: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the foot of axis 1, the direction along axis 2 and the direction up axis 1, (3,) each.

    Args:
        w: Directions of the axes.
        first: Point on the first axis.
        second: Point on the second axis.
    """
    rise = second @ w[0] if abs(float(second @ w[0])) > INTERSECTION_TOLERANCE_M else w[0][2]
    up = w[0] if rise >= 0.0 else -w[0]
    side = w[1] - (w[1] @ up) * up
    side /= np.linalg.norm(side)
    return first - (first @ up) * up, side, up


def _base(foot: FloatArray, side: FloatArray, up: FloatArray) -> FloatArray:
    """Return the base (4, 4) of the closed form."""
    return _round_pose(from_parts(np.stack([np.cross(side, up), side, up], axis=1), foot))


def _is_facing(ahead: FloatArray, shoulder: FloatArray, wrist: FloatArray) -> bool:
    """Whether ``ahead`` (3,) is the direction that the arm faces.

    That is the direction in which axis 2 is offset from axis 1, else that in which the wrist is offset, else
    the x axis of the base.
    """
    for point in (shoulder, wrist, np.array([1.0, 0.5, 0.25])):
        if abs(float(point @ ahead)) > INTERSECTION_TOLERANCE_M:
            return bool(point @ ahead > 0.0)
    return True


def _round_length(value: float) -> float:
    rounded = round(float(value), 7)
    return (rounded if abs(rounded - value) < _LENGTH_ROUNDING_M else float(value)) + 0.0


def _round_angles(angle: FloatArray) -> FloatArray:
    rounded = SNAP_STEP_RAD * np.round(angle / SNAP_STEP_RAD)
    return np.where(np.abs(angle - rounded) <= _ANGLE_ROUNDING_RAD, rounded, angle) + 0.0


def _round_pose(pose: FloatArray) -> FloatArray:
    """Return the pose with entries close to an integer rounded to it."""
    rounded = np.round(pose)
    return np.where(np.abs(pose - rounded) < 1e-12, rounded, pose) + 0.0
