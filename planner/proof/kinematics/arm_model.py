"""A robot as the proof sees it: its chain of joints and its shape by the text of its URDF.

Limits and speeds are the catalogue's. The proof's own kinematics: the chain of six turning joints
is read from the URDF's text and followed in batches. What the closed form needs of an arm, its
lengths, offsets and signs, follows from the axes of that chain. The form is that of Brandstoetter,
Angerer, Hofbaur (2014), ortho-parallel basis and spherical wrist; the way from axes to its
parameters is worked out here. No figure comes from the catalogue.
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
from planner.issues import refusal
from planner.proof.kinematics import offset_arm, parallel_arm, seven_arm
from planner.proof.kinematics.chain import Chain

BASE_LINK: Final = "base_link"
"""The link that the chain goes from, the robot's foot."""
TIP_LINK: Final = "tool0"
"""The link that the chain goes to, the robot's flange."""


def read_chain(text: str, base: str = BASE_LINK, tip: str = TIP_LINK, own: bool = False) -> Chain:
    """The chain from ``base`` to ``tip`` in the text of a URDF file; joints that are fixed are part of
    the way. In a file of the user's ``own`` there may be seven joints, other ones may move, and angles of
    frames count as the multiple of 15 degrees that they round (:data:`ROUNDED`). Raises ``ValueError`` that
    says what is wrong: no XML, no such chain, not six turning joints, other joints that move, numbers that
    are none.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"is not XML ({error})") from None
    if root.tag != "robot":
        raise ValueError(f"begins with <{root.tag}>; a URDF begins with <robot>")
    above: dict[str, ET.Element] = {}
    for joint in root.findall("joint"):  # those within others are of simulators and the like
        child = _link(joint, "child")
        if child in above:
            raise ValueError(f"hangs link {child} on two joints; one is allowed")
        above[child] = joint
    way = _way(above, base, tip)
    turning = [joint for joint in way if joint.get("type") in ("revolute", "continuous")]
    moving = [joint for joint in above.values() if joint.get("type") != "fixed"]
    if own:
        moving = [joint for joint in way if joint.get("type") != "fixed"]
    if len(turning) != len(moving) or len(turning) not in ((6, 7) if own else (6,)):
        what = f"has {len(moving)} joints that move, {len(turning)} of them turning on the way"
        raise ValueError(f"{what} from {base} to {tip}; six are needed, and no others")
    return _chain(way, own)


def _way(above: dict[str, ET.Element], base: str, tip: str) -> list[ET.Element]:
    way: list[ET.Element] = []
    link = tip
    while link != base:
        if link not in above or len(way) > len(above):
            raise ValueError(f"has no chain of joints from {base} to {tip}: nothing holds {link}")
        way.append(above[link])
        link = _link(above[link], "parent")
    return way[::-1]


def _chain(way: list[ET.Element], own: bool) -> Chain:
    links, zero, axes, limits, steps, lays = [], [], [], [], [], []
    pose, step = np.eye(4), np.eye(4)
    for joint in way:
        origin = joint.find("origin")
        moved = np.eye(4)
        if origin is not None:
            rpy = _numbers(joint, origin, "rpy", "0 0 0")
            moved[:3, :3] = _rotation(_meant(rpy) if own else rpy)
            moved[:3, 3] = _numbers(joint, origin, "xyz", "0 0 0")
        pose, step = pose @ moved, step @ moved
        if joint.get("type") == "fixed":
            continue
        if joint.find("mimic") is not None:
            raise ValueError(f"has a joint {joint.get('name')} that follows another one; none may")
        element = joint.find("axis")
        axis = np.array([1.0, 0.0, 0.0]) if element is None else _numbers(joint, element, "xyz", "1 0 0")
        if not np.linalg.norm(axis) > 1e-3:
            raise ValueError(f"has a joint {joint.get('name')} with the axis {axis.tolist()}, which is none")
        axis = axis / np.linalg.norm(axis)
        lay = np.eye(4)
        lay[:3, :3] = _laid(axis)
        links.append(_link(joint, "child"))
        zero.append(pose)
        axes.append(pose[:3, :3] @ axis)
        limits.append(_limits(joint))
        steps.append(step @ lay)
        lays.append(lay[:3, :3])
        step = lay.T
    lower, upper, velocity = np.array(limits).T
    return Chain(
        links=(*links, _link(way[-1], "child")),
        zero=np.array([*zero, pose]),
        axis=np.array(axes),
        lower=lower,
        upper=upper,
        velocity=velocity,
        step=np.array([*steps, step]),
        lay=np.array(lays),
    )


def _laid(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose z is ``axis`` (3,); exact for axes along x, y or z."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(other, axis)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


ROUNDED: Final = 2e-4
"""Angles in a file of the user's own that are so near to a multiple of 15 degrees [rad] are that: 1.5708."""


def _meant(angles: FloatArray) -> FloatArray:
    twelfths = np.rint(angles * 12.0 / np.pi) * np.pi / 12.0
    return np.where(np.abs(angles - twelfths) <= ROUNDED, twelfths, angles)


def _rotation(rpy: FloatArray) -> FloatArray:
    """Rotation (3, 3) by roll, pitch, yaw [rad] about the fixed axes x, y, z in this order, as in URDF."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(yaw @ pitch @ roll)


def _limits(joint: ET.Element) -> list[float]:
    limit = joint.find("limit")
    if limit is None:
        return [np.nan] * 3
    return [float(_numbers(joint, limit, key, "nan")[0]) for key in ("lower", "upper", "velocity")]


def _link(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    name = None if element is None else element.get("link")
    if not name:
        raise ValueError(f"has a joint {joint.get('name')} that names no {role} link")
    return name


def _numbers(joint: ET.Element, element: ET.Element, key: str, default: str) -> FloatArray:
    """The numbers of an attribute: as many as its default has; NaN only by default."""
    text, count = element.get(key), len(default.split())
    try:
        values = np.array([float(word) for word in (text or default).split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or (text is not None and not np.isfinite(values).all()):
        what = f"<{element.tag} {key}={text!r}> in joint {joint.get('name')}"
        raise ValueError(f"has {what}; {count} finite numbers are needed")
    return values


AXIS_ERROR: Final = 1e-9
"""How far [m] axes may be off from meeting, and [rad] from being parallel or square: files round so far."""

_LENGTH_DECIMALS: Final = 11
"""Lengths count to so many decimals of a metre: sums of a file's decimals get no noise."""


@dataclasses.dataclass(frozen=True, eq=False)
class ArmShape:
    """Lengths [m], ``offsets`` (6,) [rad] and ``signs`` (6,) of the arm: theta = signs * q - offsets.

    Tip in the base: ``left`` Rz(t1) T(a1, b, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4) Ry(t5) Rz(t6)
    T(0, 0, c4) ``right``, both (4, 4) and the identity but for arms of the user's own.
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


def shape_of(chain: Chain, own: bool = False) -> ArmShape:
    """The shape of a chain; base and tip of one of the user's ``own`` may stand in any way to the form's.
    Raises ``ValueError`` that says which axes are not as the form has them."""
    if not own:
        return _shape_of(chain)
    left = _form_base(chain)
    back = inverse(left)
    chain = dataclasses.replace(chain, zero=back @ chain.zero, axis=chain.axis @ back[:3, :3].T)
    right = _form_tip(chain)
    zero = np.concatenate([chain.zero[:6], chain.zero[6:] @ inverse(right)])
    shape = _shape_of(dataclasses.replace(chain, zero=zero))
    if np.abs(right - np.eye(4)).max() > AXIS_ERROR:  # the tip says nothing of axis 6: its angle is 0 at zero
        by = shape.offsets[5]
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(by), np.sin(by)], [-np.sin(by), np.cos(by)]]
        right = turn @ right
        shape = dataclasses.replace(shape, offsets=np.array([*shape.offsets[:5], 0.0]))
    return dataclasses.replace(shape, left=left, right=right)


APART: Final = 3e-3
"""What is nearer to an axis than this [m] says nothing of where an arm stands or faces."""


def _form_base(chain: Chain) -> FloatArray:
    """The form's base (4, 4) in that of the chain: z along axis 1 to where axis 2 lies from the base, else
    up; y along axis 2, so that x points to where axis 2 is off axis 1, else to the wrist, else ahead."""
    w, point = chain.axis, chain.zero[:6, :3, 3]
    rise = float(point[1] @ w[0])
    up = w[0] * np.sign(rise if abs(rise) > APART else w[0][2] or 1.0)
    foot = point[0] - (point[0] @ up) * up
    wrist = _meeting(point[3], w[3], point[4], w[4])
    ahead = np.cross(w[1], up)
    ways = [float(at @ ahead) for at in (point[1] - foot, wrist - foot)]
    ways = [way for way in ways if abs(way) > APART] or [float(np.array([1.0, 0.5, 0.25]) @ ahead)]
    side = w[1] if ways[0] > 0.0 else -w[1]
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(side, up), side, up], axis=1)
    pose[:3, 3] = foot
    return pose


def _form_tip(chain: Chain) -> FloatArray:
    """The chain's tip (4, 4) in a flange that stands on axis 6 with z out of the wrist."""
    w, point, tip = chain.axis, chain.zero[:6, :3, 3], chain.zero[6]
    wrist = _meeting(point[3], w[3], point[4], w[4])
    reach = float((tip[:3, 3] - wrist) @ w[5])
    out = w[5] * (1.0 if (reach if abs(reach) > 1e-6 else float(tip[:3, 2] @ w[5])) >= 0.0 else -1.0)
    foot = wrist + abs(reach) * out
    if tip[:3, 2] @ out > 1.0 - 1e-6 and np.linalg.norm(tip[:3, 3] - foot) <= MODEL_AGREEMENT:
        return np.eye(4)
    x = w[4]  # square to axis 6: any frame on it does
    flange = np.eye(4)
    flange[:3, :3] = np.stack([x, np.cross(out, x), out], axis=1)
    flange[:3, 3] = foot
    return np.asarray(inverse(flange) @ tip)


def _shape_of(chain: Chain) -> ArmShape:
    w, point = chain.axis, chain.zero[:6, :3, 3]
    flange = chain.zero[6]
    up = np.array([0.0, 0.0, 1.0])
    _parallel(w[0], up, "axis 1", "the base's z")
    _met(point[0][:2], "axis 1", "the base's origin")
    _square(w[1], w[0], "axis 2", "axis 1")
    _parallel(w[2], w[1], "axis 3", "axis 2")
    _square(w[3], w[2], "axis 4", "axis 3")
    _square(w[4], w[3], "axis 5", "axis 4")
    _square(w[5], w[4], "axis 6", "axis 5")
    _parallel(flange[:3, 2], w[5], "the flange's z", "axis 6")
    wrist = _meeting(point[3], w[3], point[4], w[4])
    for axis in (3, 4, 5):
        _met(np.cross(wrist - point[axis], w[axis]), f"axis {axis + 1}", "the wrist's centre")
    out = flange[:3, 3] - wrist
    _met(np.cross(out, w[5]), "the flange's origin", "axis 6")

    side, sign2 = _along(w[1], np.array([0.0, 1.0, 0.0]))
    front = np.cross(side, up)
    plane = np.stack([front, side, up])  # rows: seen in the plane that turns with axis 1
    shoulder, elbow, centre = (plane @ place for place in (point[1], point[2], wrist))
    upper, rest = elbow - shoulder, centre - elbow
    lengthwise = plane @ w[3]
    sign4 = 1.0 if rest @ lengthwise > 0.0 else -1.0
    lengthwise = sign4 * lengthwise
    across = np.array(
        [lengthwise[2], 0.0, -lengthwise[0]]
    )  # of Ry(t2 + t3): its x, where its z is lengthwise
    turned = np.stack([across, [0.0, 1.0, 0.0], lengthwise], axis=1)  # Ry(t2 + t3)
    tilt, sign5 = _along(turned.T @ plane @ w[4], np.array([0.0, 1.0, 0.0]))
    t2 = np.arctan2(upper[0], upper[2])
    t3 = np.arctan2(lengthwise[0], lengthwise[2]) - t2
    t4 = np.arctan2(-tilt[0], tilt[1])
    swivel = np.array([[np.cos(t4), -np.sin(t4), 0.0], [np.sin(t4), np.cos(t4), 0.0], [0.0, 0.0, 1.0]])
    hand = swivel.T @ turned.T @ plane @ flange[:3, :3]  # Ry(t5) Rz(t6)
    t5, t6 = np.arctan2(hand[0, 2], hand[2, 2]), np.arctan2(hand[1, 0], hand[1, 1])
    theta = np.array([np.arctan2(-side[0], side[1]), t2, t3, t4, t5, t6])
    shape = ArmShape(
        a1=_metres(shoulder[0]),
        a2=_metres(rest @ across),
        b=_metres(centre[1]),
        c1=_metres(shoulder[2]),
        c2=_metres(np.hypot(upper[0], upper[2])),
        c3=_metres(rest @ lengthwise),
        c4=_metres(out @ flange[:3, 2]),
        offsets=-theta,
        signs=np.array(
            [np.sign(w[0] @ up), sign2, np.sign(w[2] @ side), sign4, sign5, np.sign(w[5] @ flange[:3, 2])]
        ),
    )
    if not (shape.c2 > AXIS_ERROR and np.hypot(shape.a2, shape.c3) > AXIS_ERROR):
        raise ValueError(
            f"has an upper arm of {shape.c2:g} m and a forearm of {shape.c3:g} m; both need length"
        )
    return shape


def _metres(value: float) -> float:
    return round(float(value), _LENGTH_DECIMALS) + 0.0


def _along(axis: FloatArray, wanted: FloatArray) -> tuple[FloatArray, float]:
    """The axis or its opposite, whichever is nearer to ``wanted``, and the sign that makes it so."""
    sign = -1.0 if axis @ wanted < 0.0 else 1.0
    return sign * axis, sign


def _meeting(a: FloatArray, u: FloatArray, b: FloatArray, v: FloatArray) -> FloatArray:
    """The point of the line through ``a`` along ``u`` that is nearest to the line through ``b`` along ``v``,
    which is square to it."""
    return np.asarray(a + ((b - a) @ u) * u)


def _parallel(a: FloatArray, b: FloatArray, one: str, other: str) -> None:
    off = float(np.linalg.norm(np.cross(a, b)))
    if not off <= AXIS_ERROR:
        raise ValueError(_not_so(one, other, "parallel to", off))


def _square(a: FloatArray, b: FloatArray, one: str, other: str) -> None:
    off = abs(float(a @ b))
    if not off <= AXIS_ERROR:
        raise ValueError(_not_so(one, other, "square to", off))


def _not_so(one: str, other: str, word: str, off: float) -> str:
    degrees = np.rad2deg(np.arcsin(min(off, 1.0)))
    most = np.rad2deg(AXIS_ERROR)
    return f"has {one} {degrees:.6f} deg off from being {word} {other}; {most:.0e} deg is allowed"


def _met(gap: FloatArray, one: str, other: str) -> None:
    off = float(np.linalg.norm(gap))
    if not off <= AXIS_ERROR:
        raise ValueError(f"has {one} {1e3 * off:.6f} mm beside {other}; {1e3 * AXIS_ERROR:g} mm is allowed")


ROBOT_MODEL: Final = "verify.robot_model"
"""Code of the rule about robot data."""
MODEL_AGREEMENT: Final = 1e-8
"""How far catalogue and URDF may differ, in m, rad and rad/s: files round to 1e-9."""
REINSTALL_HINT: Final = "install tandem-planner again, or restore the file"
"""What to do where robot data do not agree."""
_LINK_LENGTHS: Final = ("a1", "a2", "b", "c1", "c2", "c3", "c4")
"""Lengths of an arm with a spherical wrist, as the catalogue names them."""


@dataclasses.dataclass(frozen=True, eq=False)
class Machine:
    """One robot: ``data`` for its limits, speeds, coupling and home alone; ``chain`` and ``spherical`` from
    its URDF, the latter None where it is planned as an arm with three parallel axes, an offset wrist or
    seven axes."""

    data: RobotData
    chain: Chain
    spherical: ArmShape | None

    @property
    def followed(self) -> bool:
        """Whether no text names its postures, so that straight moves go on from the joints before them
        (:mod:`planner.proof.kinematics.offset_arm`)."""
        return isinstance(self.data.form, OffsetParameters)

    @functools.cached_property
    def table(self) -> parallel_arm.Table:
        """The table of an arm of UR. Raises ``TandemError`` (``verify.robot_model``) for any other arm with
        parallel axes, of which no programs are read."""
        chain = self.chain
        try:
            return parallel_arm.table_of(chain.zero, chain.axis, chain.tip)
        except ValueError as error:
            message = f"the robot {self.data.name}: its URDF {error}"
            hint = "take UR's own URDF with base: base_link and tip: tool0"
            raise refusal(ROBOT_MODEL, message, hint=hint) from None

    @property
    def shape(self) -> ArmShape:
        """Its shape, which what reads RAPID and KRL asks for. Raises ``TandemError`` (``verify.robot_model``)
        for an arm without a spherical wrist."""
        if self.spherical is None:
            message = f"the robot {self.data.name} has no spherical wrist, by which this text names postures"
            raise refusal(ROBOT_MODEL, message, hint="plan with an arm of ABB or KUKA")
        return self.spherical

    def flange(self, q: FloatArray) -> FloatArray:
        """Flange poses (..., 4, 4) in the base at serial joint angles ``q`` (..., J) [rad]."""
        return self.chain.tip(q)


def machine_of(data: RobotData) -> Machine:
    """The robot as its URDF has it, that of the catalogue or the user's own. Raises ``TandemError``
    (``verify.robot_model``) for a file that cannot be read or is of no arm with a spherical wrist, and as
    :func:`planner.catalogue.robots.urdf_path`."""
    path = urdf_path(data.name) if data.file is None else None
    wrist = isinstance(data.form, OpwParameters)
    try:
        if path is not None:
            chain, shape = _read(path.read_text(encoding="utf-8"), BASE_LINK, TIP_LINK, False, wrist)
        elif data.file is not None:
            chain, shape = _read(data.file.text, data.file.base, data.file.tip, True, wrist)
    except (OSError, ValueError) as error:
        message = f"the robot {data.name}: its URDF {error}"
        file = None if path is None else str(path)
        raise refusal(ROBOT_MODEL, message, file=file, hint=hint_of(data)) from None
    return Machine(data, chain, shape)


@functools.lru_cache(maxsize=32)
def _read(text: str, base: str, tip: str, own: bool, wrist: bool) -> tuple[Chain, ArmShape | None]:
    chain = read_chain(text, base, tip, own)
    return chain, shape_of(chain, own) if wrist else None


def hint_of(data: RobotData) -> str:
    """What to do where a robot's data do not agree."""
    return REINSTALL_HINT if data.file is None else "plan the problem again from its own files"


def stated_otherwise(stated: Mapping[str, Any], data: RobotData) -> list[str]:
    """Where the robot of a file, which programs were planned with, is not what the problem states: its URDF
    is read once more."""
    file, out = data.file, []
    if file is None:
        return []
    try:
        text = Path(str(stated.get("urdf", ""))).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        return [f"its URDF cannot be read ({error})"]
    if text != file.text:
        out.append("its URDF is not the one that programs were planned with")
    usual_tip = next((name for name in (TIP_LINK, "flange") if name in _link_names(file.text)), "")
    for key, own, usual in (("base", file.base, BASE_LINK), ("tip", file.tip, usual_tip)):
        wanted = stated.get(key) or usual
        if own != wanted:
            out.append(f"its {key} is the link {wanted!r} in the problem, {own!r} in what was planned with")
    return out


def _link_names(text: str) -> set[str]:
    """The names of the links in the text of a URDF file; none where it is not XML."""
    try:
        return {link.get("name", "") for link in ET.fromstring(text).findall("link")}
    except ET.ParseError:
        return set()


def differences(machine: Machine) -> list[str]:
    """Where the catalogue's dimensions and limits, which programs are planned with, are not the URDF's."""
    chain, data = machine.chain, machine.data
    if isinstance(data.form, ParallelParameters):
        out = list(parallel_arm.differences(data.form, chain.zero, chain.axis, MODEL_AGREEMENT))
    elif isinstance(data.form, OffsetParameters):
        out = list(offset_arm.differences(data.form, chain.zero, chain.axis, MODEL_AGREEMENT))
    elif isinstance(data.form, SevenParameters):
        out = list(seven_arm.differences(data.form, chain.zero, chain.axis, MODEL_AGREEMENT))
    else:
        out = list(_of_spherical(machine.shape, data.opw))
    for word, here, there in (
        ("lower limit", chain.lower, data.lower),
        ("upper limit", chain.upper, data.upper),
        ("speed", chain.velocity, data.velocity),
    ):
        for i in np.flatnonzero(np.abs(here - there) > MODEL_AGREEMENT):
            one, other = np.rad2deg([here[i], there[i]])
            out.append(
                f"the {word} of axis {i + 1} is {one:.6f} deg in the URDF, {other:.6f} in the catalogue"
            )
    return out


def _of_spherical(shape: ArmShape, planned: OpwParameters) -> list[str]:
    """Where lengths, offsets, base, tip and signs are not the URDF's."""
    out = []
    for key in _LINK_LENGTHS:
        here, there = getattr(shape, key), getattr(planned, key)
        if not abs(here - there) <= MODEL_AGREEMENT:
            out.append(
                f"{key} is {1e3 * here:.6f} mm by the axes of the URDF, {1e3 * there:.6f} in the catalogue"
            )
    turn = np.abs((shape.offsets - planned.offsets + np.pi) % (2.0 * np.pi) - np.pi)
    for i in np.flatnonzero(~(turn <= MODEL_AGREEMENT)):
        here, there = np.rad2deg([shape.offsets[i], planned.offsets[i]])
        out.append(f"the offset of axis {i + 1} is {here:.6f} deg in the URDF, {there:.6f} in the catalogue")
    for word, mine, planners in (("base", shape.left, planned.left), ("tip", shape.right, planned.right)):
        off = np.abs(mine - (np.eye(4) if planners is None else planners)).max()
        if not off <= MODEL_AGREEMENT:
            out.append(f"the {word} stands elsewhere by the axes of the URDF, or turned, by {off:.3g}")
    turned = np.flatnonzero(shape.signs != planned.signs)
    out += [f"axis {i + 1} turns the other way in the URDF than in the catalogue" for i in turned]
    return out
