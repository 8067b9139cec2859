"""A robot as the proof sees it: its joint chain and its dimensions from the text of its URDF.

Limits and speeds are the catalogue's. The kinematics are the proof's own: the chain of six revolute joints
is read from the URDF's text and evaluated in batches. The lengths, offsets and signs of the closed form
follow from the axes of that chain. No dimension comes from the catalogue. The form is that of Brandstoetter,
Angerer, Hofbaur (2014), ortho-parallel basis and spherical wrist. How its parameters follow from the axes
is derived here.
"""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from planner.catalogue.robots import (
    OffsetParameters,
    OpwParameters,
    ParallelParameters,
    RobotData,
    SevenParameters,
    urdf_path,
)
from planner.geometry.arrays import FloatArray, inverse
from planner.issues import issue_error
from planner.proof.kinematics import offset_arm, parallel_arm, seven_arm
from planner.proof.kinematics.chain import SerialChain

BASE_LINK: Final = "base_link"
"""Link at which the chain starts, the robot's foot."""
TIP_LINK: Final = "tool0"
"""Link at which the chain ends, the robot's flange."""


def read_chain(text: str, base: str = BASE_LINK, tip: str = TIP_LINK, user_file: bool = False) -> SerialChain:
    """Read the joint chain from the text of a URDF file. Fixed joints are part of it.

    Args:
        text: Text of the file.
        base: Link at which the chain starts.
        tip: Link at which the chain ends.
        user_file: Whether the file is the user's. It may have seven joints in the chain and moving joints
            beside it. Frame angles close to a multiple of 15 degrees count as this multiple
            (:data:`ANGLE_ROUNDING_RAD`).

    Raises:
        ValueError: The text is not a URDF, has no such chain, another number of revolute joints, other moving
            joints, or invalid numbers. The message continues "the URDF ...".
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"is not XML ({error})") from None
    if root.tag != "robot":
        raise ValueError(f"begins with <{root.tag}>; a URDF begins with <robot>")
    parent_joints: dict[str, ET.Element] = {}
    for joint in root.findall("joint"):  # nested ones belong to simulators
        child = _link(joint, "child")
        if child in parent_joints:
            raise ValueError(f"attaches link {child} to two joints; allowed: one")
        parent_joints[child] = joint
    chain_joints = _chain_joints(parent_joints, base, tip)
    revolute = [joint for joint in chain_joints if joint.get("type") in ("revolute", "continuous")]
    moving = [joint for joint in parent_joints.values() if joint.get("type") != "fixed"]
    if user_file:
        moving = [joint for joint in chain_joints if joint.get("type") != "fixed"]
    if len(revolute) != len(moving) or len(revolute) not in ((6, 7) if user_file else (6,)):
        counts = f"has {len(moving)} moving joints, {len(revolute)} of them revolute in the chain"
        raise ValueError(f"{counts} from {base} to {tip}; required: six, and no others")
    return _build_chain(chain_joints, user_file)


def _chain_joints(parent_joints: dict[str, ET.Element], base: str, tip: str) -> list[ET.Element]:
    """Return the joints from link ``base`` to link ``tip``, in order."""
    joints: list[ET.Element] = []
    link = tip
    while link != base:
        if link not in parent_joints or len(joints) > len(parent_joints):
            raise ValueError(f"has no chain of joints from {base} to {tip}: {link} has no parent joint")
        joints.append(parent_joints[link])
        link = _link(parent_joints[link], "parent")
    return joints[::-1]


def _build_chain(joints: list[ET.Element], user_file: bool) -> SerialChain:
    """Return the chain of joints, which are in order from the base to the tip, with fixed joints merged.

    In a ``user_file``, rounded frame angles are replaced (:func:`_unrounded`).

    Raises:
        ValueError: A joint mimics another one, has an invalid axis, or has invalid numbers.
    """
    links, zero, axes, limits, steps, alignments = [], [], [], [], [], []
    # The pose in the base, and that in the previous joint frame with its axis along z.
    pose, step = np.eye(4), np.eye(4)
    for joint in joints:
        origin = joint.find("origin")
        origin_pose = np.eye(4)
        if origin is not None:
            rpy = _numbers(joint, origin, "rpy", "0 0 0")
            origin_pose[:3, :3] = _rotation(_unrounded(rpy) if user_file else rpy)
            origin_pose[:3, 3] = _numbers(joint, origin, "xyz", "0 0 0")
        pose, step = pose @ origin_pose, step @ origin_pose
        if joint.get("type") == "fixed":
            continue
        if joint.find("mimic") is not None:
            raise ValueError(f"has a joint {joint.get('name')} that mimics another joint (unsupported)")
        element = joint.find("axis")
        axis = np.array([1.0, 0.0, 0.0]) if element is None else _numbers(joint, element, "xyz", "1 0 0")
        if not np.linalg.norm(axis) > 1e-3:
            raise ValueError(f"has a joint {joint.get('name')} with the invalid axis {axis.tolist()}")
        axis = axis / np.linalg.norm(axis)
        alignment = np.eye(4)
        alignment[:3, :3] = _frame_with_z(axis)
        links.append(_link(joint, "child"))
        zero.append(pose)
        axes.append(pose[:3, :3] @ axis)
        limits.append(_limits(joint))
        steps.append(step @ alignment)
        alignments.append(alignment[:3, :3])
        step = alignment.T  # its inverse, as it is a rotation alone
    lower, upper, velocity = np.array(limits).T
    return SerialChain(
        links=(*links, _link(joints[-1], "child")),
        zero=np.array([*zero, pose]),
        axis=np.array(axes),
        lower=lower,
        upper=upper,
        velocity=velocity,
        step=np.array([*steps, step]),
        axis_alignment=np.array(alignments),
    )


def _frame_with_z(axis: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) with z along the unit vector ``axis`` (3,), exact for axes along x, y or z."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(other, axis)  # other: the coordinate axis that is farthest from the given one
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


ANGLE_ROUNDING_RAD: Final = 2e-4
"""Distance [rad] up to which angles in a user's file count as a multiple of 15 degrees (1.5708)."""


def _unrounded(angles: FloatArray) -> FloatArray:
    """Return angles, with those that round a multiple of 15 degrees replaced by this multiple."""
    multiples = np.rint(angles * 12.0 / np.pi) * np.pi / 12.0
    return np.where(np.abs(angles - multiples) <= ANGLE_ROUNDING_RAD, multiples, angles)


def _rotation(rpy: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) by roll, pitch, yaw [rad] about the fixed axes x, y, z, as in URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(yaw @ pitch @ roll)


def _limits(joint: ET.Element) -> list[float]:
    """Return lower limit, upper limit and speed of a joint [rad, rad/s], NaN where none is stated."""
    limit = joint.find("limit")
    if limit is None:
        return [np.nan] * 3
    return [float(_numbers(joint, limit, key, "nan")[0]) for key in ("lower", "upper", "velocity")]


def _link(joint: ET.Element, role: str) -> str:
    """Return the name of the ``parent`` or ``child`` link of a joint."""
    element = joint.find(role)
    name = None if element is None else element.get("link")
    if not name:
        raise ValueError(f"has a joint {joint.get('name')} without a {role} link")
    return name


def _numbers(joint: ET.Element, element: ET.Element, key: str, default: str) -> FloatArray:
    """Return the numbers of attribute ``key`` of an element in a joint.

    There must be as many as in ``default``. Numbers that are stated must be finite; the default may be NaN.
    """
    text, count = element.get(key), len(default.split())
    try:
        values = np.array([float(word) for word in (text or default).split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or (text is not None and not np.isfinite(values).all()):
        attribute = f"<{element.tag} {key}={text!r}> in joint {joint.get('name')}"
        raise ValueError(f"has {attribute}; required: {count} finite numbers")
    return values


AXIS_TOLERANCE: Final = 1e-9
"""Tolerance [m] for axes that meet, and [rad] for parallel or perpendicular axes, because files round."""

_LENGTH_DECIMALS: Final = 11
"""Number of decimals of lengths [m], so that sums of a file's decimals get no noise."""


@dataclasses.dataclass(frozen=True, eq=False)
class ArmShape:
    """Dimensions of an arm with a spherical wrist, for the closed form of its inverse kinematics.

    The angles theta = (t1, ..., t6) of the closed form follow from joints q by theta = signs * q - offsets.
    The tip in the base is ``left`` Rz(t1) T(a1, b, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4) Ry(t5)
    Rz(t6) T(0, 0, c4) ``right``. Lengths a1 to c4 are in m.

    Attributes:
        offsets: Joint offsets (6,) [rad].
        signs: Joint signs (6,).
        left: Base transform (4, 4), the identity except for robots from a user's file.
        right: Tip transform (4, 4), the identity except for robots from a user's file.
    """

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float
    offsets: FloatArray
    signs: FloatArray
    left: FloatArray = dataclasses.field(default_factory=lambda: np.eye(4))
    right: FloatArray = dataclasses.field(default_factory=lambda: np.eye(4))


def shape_of(chain: SerialChain, user_file: bool = False) -> ArmShape:
    """Return the dimensions of a chain with a spherical wrist.

    Args:
        chain: The chain.
        user_file: Whether the chain is from a user's file. Its base and tip may have any pose relative to
            those of the closed form (:class:`ArmShape`).

    Raises:
        ValueError: The axes are not arranged as in the closed form.
    """
    if not user_file:
        return _shape_of(chain)
    left = _form_base(chain)
    back = inverse(left)
    chain = dataclasses.replace(chain, zero=back @ chain.zero, axis=chain.axis @ back[:3, :3].T)
    right = _form_tip(chain)
    zero = np.concatenate([chain.zero[:6], chain.zero[6:] @ inverse(right)])
    shape = _shape_of(dataclasses.replace(chain, zero=zero))
    if np.abs(right - np.eye(4)).max() > AXIS_TOLERANCE:
        # The tip does not define the zero of axis 6, so the offset of axis 6 becomes part of the tip.
        offset = shape.offsets[5]
        rotation = np.eye(4)
        rotation[:2, :2] = [[np.cos(offset), np.sin(offset)], [-np.sin(offset), np.cos(offset)]]
        right = rotation @ right
        shape = dataclasses.replace(shape, offsets=np.array([*shape.offsets[:5], 0.0]))
    return dataclasses.replace(shape, left=left, right=right)


MIN_AXIS_DISTANCE_M: Final = 3e-3
"""Distance [m] from an axis below which a point does not define the direction of an arm's base frame."""


def _form_base(chain: SerialChain) -> FloatArray:
    """Return the base frame (4, 4) of the closed form in that of the chain.

    z is along axis 1, toward axis 2 as seen from the base. If both are at one height, z points up. y is along
    axis 2. Its sign lets x point from axis 1 toward axis 2. If axis 2 meets axis 1, x points toward the
    wrist, or in an arbitrary direction if the wrist is also on axis 1. Distances up to
    :data:`MIN_AXIS_DISTANCE_M` count as 0.
    """
    w, point = chain.axis, chain.zero[:6, :3, 3]
    rise = float(point[1] @ w[0])
    up = w[0] * np.sign(rise if abs(rise) > MIN_AXIS_DISTANCE_M else w[0][2] or 1.0)
    origin = point[0] - (point[0] @ up) * up
    wrist = _nearest_point(point[3], w[3], point[4], w[4])
    ahead = np.cross(w[1], up)
    distances = [float(offset @ ahead) for offset in (point[1] - origin, wrist - origin)]
    # Without any such distance, an arbitrary direction that is not along an axis decides the sign.
    distances = [distance for distance in distances if abs(distance) > MIN_AXIS_DISTANCE_M] or [
        float(np.array([1.0, 0.5, 0.25]) @ ahead)
    ]
    side = w[1] if distances[0] > 0.0 else -w[1]
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(side, up), side, up], axis=1)
    pose[:3, 3] = origin
    return pose


def _form_tip(chain: SerialChain) -> FloatArray:
    """Return the chain's tip (4, 4) in the flange of the closed form.

    The flange of the closed form lies on axis 6, with z along this axis, out of the wrist.
    The result is the identity if the tip is such a flange itself.
    """
    w, point, tip = chain.axis, chain.zero[:6, :3, 3], chain.zero[6]
    wrist = _nearest_point(point[3], w[3], point[4], w[4])
    reach = float((tip[:3, 3] - wrist) @ w[5])
    out = w[5] * (1.0 if (reach if abs(reach) > 1e-6 else float(tip[:3, 2] @ w[5])) >= 0.0 else -1.0)
    origin = wrist + abs(reach) * out
    if tip[:3, 2] @ out > 1.0 - 1e-6 and np.linalg.norm(tip[:3, 3] - origin) <= MODEL_TOLERANCE:
        return np.eye(4)
    x = w[4]  # perpendicular to axis 6; any such direction is valid
    flange = np.eye(4)
    flange[:3, :3] = np.stack([x, np.cross(out, x), out], axis=1)
    flange[:3, 3] = origin
    return np.asarray(inverse(flange) @ tip)


def _shape_of(chain: SerialChain) -> ArmShape:
    """Return the dimensions of a chain whose base and tip are those of the closed form.

    The axes at zero joints give the angles theta of the closed form there, so that offsets = -theta.

    Raises:
        ValueError: The axes are not arranged as in the closed form, or a link has no length.
    """
    w, point = chain.axis, chain.zero[:6, :3, 3]
    flange = chain.zero[6]
    up = np.array([0.0, 0.0, 1.0])
    _check_parallel(w[0], up, "axis 1", "the base's z")
    _check_meeting(point[0][:2], "axis 1", "the base's origin")
    _check_square(w[1], w[0], "axis 2", "axis 1")
    _check_parallel(w[2], w[1], "axis 3", "axis 2")
    _check_square(w[3], w[2], "axis 4", "axis 3")
    _check_square(w[4], w[3], "axis 5", "axis 4")
    _check_square(w[5], w[4], "axis 6", "axis 5")
    _check_parallel(flange[:3, 2], w[5], "the flange's z", "axis 6")
    wrist = _nearest_point(point[3], w[3], point[4], w[4])
    for axis in (3, 4, 5):
        _check_meeting(np.cross(wrist - point[axis], w[axis]), f"axis {axis + 1}", "the wrist's centre")
    wrist_to_flange = flange[:3, 3] - wrist
    _check_meeting(np.cross(wrist_to_flange, w[5]), "the flange's origin", "axis 6")

    # side: axis 2, with the sign that is nearest to the base's y. front: across axes 1 and 2, x after t1.
    side, sign2 = _aligned(w[1], np.array([0.0, 1.0, 0.0]))
    front = np.cross(side, up)
    plane = np.stack([front, side, up])  # rows of the frame that turns with axis 1
    shoulder, elbow, centre = (plane @ position for position in (point[1], point[2], wrist))
    upper, elbow_to_wrist = elbow - shoulder, centre - elbow
    lengthwise = plane @ w[3]
    sign4 = 1.0 if elbow_to_wrist @ lengthwise > 0.0 else -1.0
    lengthwise = sign4 * lengthwise
    across = np.array(
        [lengthwise[2], 0.0, -lengthwise[0]]
    )  # x axis of Ry(t2 + t3), whose z axis is lengthwise
    rotated = np.stack([across, [0.0, 1.0, 0.0], lengthwise], axis=1)  # Ry(t2 + t3)
    tilt, sign5 = _aligned(rotated.T @ plane @ w[4], np.array([0.0, 1.0, 0.0]))
    t2 = np.arctan2(upper[0], upper[2])
    t3 = np.arctan2(lengthwise[0], lengthwise[2]) - t2
    t4 = np.arctan2(-tilt[0], tilt[1])
    swivel = np.array([[np.cos(t4), -np.sin(t4), 0.0], [np.sin(t4), np.cos(t4), 0.0], [0.0, 0.0, 1.0]])
    hand = swivel.T @ rotated.T @ plane @ flange[:3, :3]  # Ry(t5) Rz(t6)
    t5, t6 = np.arctan2(hand[0, 2], hand[2, 2]), np.arctan2(hand[1, 0], hand[1, 1])
    theta = np.array([np.arctan2(-side[0], side[1]), t2, t3, t4, t5, t6])
    shape = ArmShape(
        a1=_metres(shoulder[0]),
        a2=_metres(elbow_to_wrist @ across),
        b=_metres(centre[1]),
        c1=_metres(shoulder[2]),
        c2=_metres(np.hypot(upper[0], upper[2])),
        c3=_metres(elbow_to_wrist @ lengthwise),
        c4=_metres(wrist_to_flange @ flange[:3, 2]),
        offsets=-theta,
        signs=np.array(
            [np.sign(w[0] @ up), sign2, np.sign(w[2] @ side), sign4, sign5, np.sign(w[5] @ flange[:3, 2])]
        ),
    )
    if not (shape.c2 > AXIS_TOLERANCE and np.hypot(shape.a2, shape.c3) > AXIS_TOLERANCE):
        raise ValueError(
            f"has an upper arm of {shape.c2:g} m and a forearm of {shape.c3:g} m; both must be positive"
        )
    return shape


def _metres(value: float) -> float:
    """Round a length [m] to the decimals of files, without a negative zero."""
    return round(float(value), _LENGTH_DECIMALS) + 0.0


def _aligned(axis: FloatArray, reference: FloatArray) -> tuple[FloatArray, float]:
    """Return the axis or its opposite, whichever is nearer to ``reference``, and the sign."""
    sign = -1.0 if axis @ reference < 0.0 else 1.0
    return sign * axis, sign


def _nearest_point(a: FloatArray, u: FloatArray, b: FloatArray, v: FloatArray) -> FloatArray:
    """Return the point of one line that is nearest to a second line, which is perpendicular to it.

    The first line passes through ``a`` along ``u``, the second one through ``b`` along ``v``.
    """
    return np.asarray(a + ((b - a) @ u) * u)


def _check_parallel(a: FloatArray, b: FloatArray, name: str, other_name: str) -> None:
    """Raise ``ValueError`` unless two unit vectors (3,) are parallel, in either direction."""
    deviation = float(np.linalg.norm(np.cross(a, b)))
    if not deviation <= AXIS_TOLERANCE:
        raise ValueError(_angle_message(name, other_name, "parallel to", deviation))


def _check_square(a: FloatArray, b: FloatArray, name: str, other_name: str) -> None:
    """Raise ``ValueError`` unless two unit vectors (3,) are perpendicular."""
    deviation = abs(float(a @ b))
    if not deviation <= AXIS_TOLERANCE:
        raise ValueError(_angle_message(name, other_name, "square to", deviation))


def _angle_message(name: str, other_name: str, word: str, deviation: float) -> str:
    """Return the message about an angle. ``deviation`` is the sine of its deviation."""
    degrees = np.rad2deg(np.arcsin(min(deviation, 1.0)))
    tolerance = np.rad2deg(AXIS_TOLERANCE)
    return f"has {name} {degrees:.6f} deg away from being {word} {other_name}; allowed: {tolerance:.0e} deg"


def _check_meeting(gap: FloatArray, name: str, other_name: str) -> None:
    """Raise ``ValueError`` unless two lines or points meet, by the vector ``gap`` [m] between them."""
    distance = float(np.linalg.norm(gap))
    if not distance <= AXIS_TOLERANCE:
        raise ValueError(
            f"has {name} {1e3 * distance:.6f} mm away from {other_name}; allowed: {1e3 * AXIS_TOLERANCE:g} mm"
        )


ROBOT_MODEL: Final = "verify.robot_model"
"""Code of the rule on robot data."""
MODEL_TOLERANCE: Final = 1e-8
"""Tolerance [m, rad, rad/s] between catalogue and URDF, because files round to 1e-9."""
REINSTALL_HINT: Final = "install tandem-planner again, or restore the file"
"""Remedy if robot data of the catalogue do not agree."""
_LINK_LENGTHS: Final = ("a1", "a2", "b", "c1", "c2", "c3", "c4")
"""Lengths of an arm with a spherical wrist, as the catalogue names them."""


@dataclasses.dataclass(frozen=True, eq=False)
class RobotMachine:
    """One robot as the proof uses it.

    Attributes:
        data: Catalogue data, used only for limits, speeds, coupling and home.
        chain: Joint chain of its URDF.
        spherical_shape: Dimensions from its URDF, None for arms with three parallel axes, an offset wrist or
            seven axes.
    """

    data: RobotData
    chain: SerialChain
    spherical_shape: ArmShape | None

    @property
    def is_followed(self) -> bool:
        """Whether the joints of straight moves are followed step by step from the joints before them.

        This is so for an arm with an offset wrist, because no program text names the branches of its inverse
        kinematics (:mod:`planner.proof.kinematics.offset_arm`).
        """
        return isinstance(self.data.form, OffsetParameters)

    @functools.cached_property
    def table(self) -> parallel_arm.DhTable:
        """The DH table of a UR arm.

        Raises:
            TandemError: The arm has parallel axes, but does not follow UR's convention
                (``verify.robot_model``).
        """
        chain = self.chain
        try:
            return parallel_arm.dh_table(chain.zero, chain.axis, chain.tip)
        except ValueError as error:
            message = f"the robot {self.data.name}: its URDF {error}"
            hint = "use UR's own URDF with base: base_link and tip: tool0"
            raise issue_error(ROBOT_MODEL, message, hint=hint) from None

    @property
    def shape(self) -> ArmShape:
        """Dimensions of the arm, with whose closed form RAPID and KRL targets are solved.

        Raises:
            TandemError: The arm has no spherical wrist (``verify.robot_model``).
        """
        if self.spherical_shape is None:
            message = f"the robot {self.data.name} has no spherical wrist, which this text requires"
            raise issue_error(ROBOT_MODEL, message, hint="plan with an arm of ABB or KUKA")
        return self.spherical_shape

    def flange(self, q: FloatArray) -> FloatArray:
        """Return flange poses (..., 4, 4) in the base at serial joint angles ``q`` (..., J) [rad]."""
        return self.chain.tip(q)


def robot_machine(data: RobotData) -> RobotMachine:
    """Return a robot according to its URDF, which is that of the catalogue or the user's.

    Raises:
        TandemError: The file cannot be read, or describes an unsupported arm (``verify.robot_model``). Also
            the errors of :func:`planner.catalogue.robots.urdf_path`.
    """
    path = urdf_path(data.name) if data.file is None else None
    has_spherical_wrist = isinstance(data.form, OpwParameters)
    try:
        if path is not None:
            text = path.read_text(encoding="utf-8")
            chain, shape = _read_robot(text, BASE_LINK, TIP_LINK, user_file=False, wrist=has_spherical_wrist)
        elif data.file is not None:
            chain, shape = _read_robot(
                data.file.text, data.file.base, data.file.tip, user_file=True, wrist=has_spherical_wrist
            )
    except (OSError, ValueError) as error:
        message = f"the robot {data.name}: its URDF {error}"
        file = None if path is None else str(path)
        raise issue_error(ROBOT_MODEL, message, file=file, hint=robot_hint(data)) from None
    return RobotMachine(data, chain, shape)


@functools.lru_cache(maxsize=32)
def _read_robot(
    text: str, base: str, tip: str, user_file: bool, wrist: bool
) -> tuple[SerialChain, ArmShape | None]:
    """Return chain and dimensions from the text of a URDF, the dimensions for a spherical wrist only."""
    chain = read_chain(text, base, tip, user_file)
    return chain, shape_of(chain, user_file) if wrist else None


def robot_hint(data: RobotData) -> str:
    """Return the remedy if a robot's data do not agree."""
    return REINSTALL_HINT if data.file is None else "plan the problem again from its own files"


def compare_with_problem(stated: Mapping[str, Any], data: RobotData) -> list[str]:
    """Return the differences between a user's robot file and the data with which programs were planned.

    The URDF that the problem names is read again, and its text and the links of base and tip are compared
    with those in ``data``. ``stated`` is the problem's entry, with ``urdf``, ``base`` and ``tip``. A robot of
    the catalogue has no differences.
    """
    file, out = data.file, []
    if file is None:
        return []
    try:
        text = Path(str(stated.get("urdf", ""))).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        return [f"its URDF cannot be read ({error})"]
    if text != file.text:
        out.append("its URDF differs from the one with which programs were planned")
    usual_tip = next((name for name in (TIP_LINK, "flange") if name in _link_names(file.text)), "")
    for key, planned, usual in (("base", file.base, BASE_LINK), ("tip", file.tip, usual_tip)):
        expected = stated.get(key) or usual
        if planned != expected:
            out.append(f"its {key} is the link {expected!r} in the problem, but {planned!r} when planned")
    return out


def _link_names(text: str) -> set[str]:
    """Return the link names in the text of a URDF file, none if it is not XML."""
    try:
        return {link.get("name", "") for link in ET.fromstring(text).findall("link")}
    except ET.ParseError:
        return set()


def compare_with_catalogue(machine: RobotMachine) -> list[str]:
    """Return the differences between the URDF and the catalogue, with whose data programs are planned.

    Compared are dimensions, joint limits and joint speeds.
    """
    chain, data = machine.chain, machine.data
    if isinstance(data.form, ParallelParameters):
        out = list(parallel_arm.compare_with_plan(data.form, chain, MODEL_TOLERANCE))
    elif isinstance(data.form, OffsetParameters):
        out = list(offset_arm.compare_with_plan(data.form, chain, MODEL_TOLERANCE))
    elif isinstance(data.form, SevenParameters):
        out = list(seven_arm.compare_with_plan(data.form, chain, MODEL_TOLERANCE))
    else:
        out = list(_compare_spherical(machine.shape, data.opw))
    for word, in_urdf, in_catalogue in (
        ("lower limit", chain.lower, data.lower),
        ("upper limit", chain.upper, data.upper),
        ("speed", chain.velocity, data.velocity),
    ):
        for i in np.flatnonzero(np.abs(in_urdf - in_catalogue) > MODEL_TOLERANCE):
            urdf_deg, catalogue_deg = np.rad2deg([in_urdf[i], in_catalogue[i]])
            out.append(
                f"the {word} of axis {i + 1} is {urdf_deg:.6f} deg in the URDF, {catalogue_deg:.6f} in the "
                "catalogue"
            )
    return out


def _compare_spherical(shape: ArmShape, planned: OpwParameters) -> list[str]:
    """Return the differences between the dimensions of the URDF (``shape``) and those of the catalogue."""
    out = []
    for key in _LINK_LENGTHS:
        in_urdf, in_catalogue = getattr(shape, key), getattr(planned, key)
        if not abs(in_urdf - in_catalogue) <= MODEL_TOLERANCE:
            out.append(
                f"{key} is {1e3 * in_urdf:.6f} mm by the axes of the URDF, {1e3 * in_catalogue:.6f} in the "
                "catalogue"
            )
    offset_deviation = np.abs((shape.offsets - planned.offsets + np.pi) % (2.0 * np.pi) - np.pi)
    for i in np.flatnonzero(~(offset_deviation <= MODEL_TOLERANCE)):
        in_urdf, in_catalogue = np.rad2deg([shape.offsets[i], planned.offsets[i]])
        out.append(
            f"the offset of axis {i + 1} is {in_urdf:.6f} deg in the URDF, {in_catalogue:.6f} in the "
            "catalogue"
        )
    for word, urdf_pose, catalogue_pose in (
        ("base", shape.left, planned.left),
        ("tip", shape.right, planned.right),
    ):
        deviation = np.abs(urdf_pose - (np.eye(4) if catalogue_pose is None else catalogue_pose)).max()
        if not deviation <= MODEL_TOLERANCE:
            out.append(f"the {word} differs from that by the axes of the URDF by {deviation:.3g} [m, -]")
    opposite = np.flatnonzero(shape.signs != planned.signs)
    out += [f"axis {i + 1} turns in opposite directions in the URDF and the catalogue" for i in opposite]
    return out
