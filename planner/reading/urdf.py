"""Reader of URDF text: the chain of joints from a base link to a tip, with frames, limits and shapes.

Strict, with the XML parser of the standard library. Unsupported features (mimic or prismatic joints, missing
limits, links on two joints) are reported by joint, all faults at once. Fixed joints are folded in. Angles of
frames within 2e-4 rad of a multiple of 15 degrees are rounded to it, because files write 1.5708.
:mod:`planner.reading.arm_identification` derives the closed form of the chain.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np

from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, from_rpy
from planner.geometry.mesh_files import MAX_EXTENT_M
from planner.geometry.units import DEG
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error

MAX_URDF_BYTES: Final = 5_000_000
"""Maximum file size [bytes]. A URDF has a few tens of kilobytes."""
MAX_LINKS: Final = 2000
"""Maximum number of links of a file, and of geometries of its arm. An arm has about ten."""
SNAP_STEP_RAD: Final = 15.0 * DEG
"""Angles of frames are rounded to multiples of this [rad] if they are within :data:`SNAP_TOLERANCE_RAD`."""
SNAP_TOLERANCE_RAD: Final = 2e-4
"""Maximum rounding of an angle of a frame [rad]."""
DEFAULT_TIPS: Final = ("tool0", "flange")
"""Default names of the tip link; the first one that exists is used."""
_XACRO: Final = "convert it with xacro FILE.xacro -o FILE.urdf; without ROS: pip install xacro"
_MOVING: Final = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclasses.dataclass(frozen=True)
class UrdfShape:
    """A geometry of a URDF.

    Attributes:
        link: Link of the chain that carries it.
        kind: Kind of the geometry.
        size: Box (x, y, z), cylinder or Drake's capsule (radius, length), sphere (radius,) [m], or scale (3,)
            of a mesh along its axes.
        pose: Pose (4, 4) in the frame of ``link``.
        file: Mesh file as the URDF names it.
        owner: Link that states it, which is ``link`` or fixed to it.
        color: Red, green, blue in 0..1, if a material states them.
    """

    link: str
    kind: str
    size: tuple[float, ...]
    pose: FloatArray
    file: str = ""
    owner: str = ""
    color: tuple[float, ...] | None = None


@dataclasses.dataclass(frozen=True)
class UrdfChain:
    """A chain of N moving joints of a URDF.

    Attributes:
        joints: Names of the joints.
        kinds: Types of the joints.
        links: Base and the links that the joints move.
        tip_link: Tip.
        zero: Frames (N + 2, 4, 4) of these links and of the tip in the base, with all joints at zero.
        written: The same frames by the angles as written, without rounding.
        axis: Unit vectors (N, 3) of the axes in the base at zero. Axis i passes through the origin of frame i
            + 1.
        written_axis: The same axes by the angles as written.
        lower: Lower limits (N,) [rad], NaN if not stated.
        upper: Upper limits (N,) [rad], NaN if not stated.
        velocity: Maximum speeds (N,) [rad/s], NaN if not stated.
        shapes: Collision geometries fixed to base and links.
        other_joints: Moving joints on the base or these links outside the chain, which are ignored.
        notes: Data of the file that are not used.
        visuals: Visual geometries fixed to base and links.
        invalid_visuals: Links with an invalid visual, and the reason.
        has_joints_after_tip: Whether moving joints are attached to the tip.
    """

    joints: tuple[str, ...]
    kinds: tuple[str, ...]
    links: tuple[str, ...]
    tip_link: str
    zero: FloatArray
    written: FloatArray
    axis: FloatArray
    written_axis: FloatArray
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    shapes: tuple[UrdfShape, ...]
    other_joints: tuple[str, ...]
    notes: tuple[str, ...]
    visuals: tuple[UrdfShape, ...] = ()
    invalid_visuals: tuple[tuple[str, str], ...] = ()
    has_joints_after_tip: bool = False

    def tip(self, q: FloatArray, written: bool = False) -> FloatArray:
        """Return poses (..., 4, 4) of the tip in the base, by the product of exponentials.

        T(q) = prod_i exp([S_i] q_i) T(0), with S_i the axes at zero.

        Args:
            q: Joint angles (..., N) [rad].
            written: Whether to use the angles of the file as written instead of rounded ones.

        Source: Murray, Li, Sastry (1994), section 3.2.
        """
        zero, axis = (self.written, self.written_axis) if written else (self.zero, self.axis)
        # exp([S_i] q_i) is a rotation R about an axis through p: x -> R x + (p - R p)
        pose = zero[-1]
        for i in reversed(range(len(axis))):
            rotation = exp_rotation(np.asarray(q)[..., i, None] * axis[i])
            point = zero[i + 1, :3, 3]
            pose = from_parts(rotation, point - rotation @ point) @ pose
        return np.asarray(pose)


class CoupledError(TandemError):
    """Mimic joints are the only fault of a chain.

    Attributes:
        chain: Chain with these joints fixed.
    """

    def __init__(self, issues: Sequence[Issue], chain: UrdfChain) -> None:
        super().__init__(issues)
        self.chain = chain


def read_chain(text: str, base: str, tip: str | None) -> UrdfChain:
    """Read the chain from a base link to a tip link.

    Args:
        text: Text of the URDF.
        base: Name of the base link.
        tip: Name of the tip link; None for the first of :data:`DEFAULT_TIPS`.

    Raises:
        TandemError: With all faults: ``robot.urdf`` for a text that is not a URDF, ``robot.chain`` for an
            unsupported chain (:class:`CoupledError` for mimic joints), ``robot.limits`` for joints without a
            range or a speed.
    """
    root = _parse_root(text)
    links = _links_by_name(root)
    joint_by_child = _joints_by_child(root, links)
    tip = _find_tip(links, joint_by_child, base, tip)
    for role, name in (("base", base), ("tip", tip)):
        if name not in links:
            message = f"{role}: the URDF has no link {name!r}, it has {_list_names(sorted(links))}"
            raise issue_error("robot.chain", message, field=role, hint=f"name one of these as {role}")
    joints = _joints_between(joint_by_child, base, tip)
    issues = list(_joint_faults(joints))
    if issues:
        mimic_joints = [joint for joint in joints if joint.find("mimic") is not None]
        if len(issues) > len(mimic_joints):
            raise TandemError(issues)
        for joint in mimic_joints:
            joint.set("type", "fixed")
        raise CoupledError(issues, _build_chain(root, joints, joint_by_child, base, tip))
    return _build_chain(root, joints, joint_by_child, base, tip)


def limit_faults(chain: UrdfChain) -> list[Issue]:
    """Return the faults (``robot.limits``) of ranges and speeds of the joints of a chain."""
    return [
        Issue(
            "robot.limits",
            format_message("robot.limits", joint=name, fault=fault, remedy=hint),
            field="urdf",
            bodies=(name,),
        )
        for i, name in enumerate(chain.joints)
        for fault, hint in _limit_faults(chain, i)
    ]


def _limit_faults(chain: UrdfChain, i: int) -> Iterator[tuple[str, str]]:
    """Yield faults and remedies of the range and the speed of joint ``i``."""
    lower, upper, velocity = chain.lower[i], chain.upper[i], chain.velocity[i]
    if chain.kinds[i] == "continuous":
        yield (
            "got type continuous, which has no limits; allowed are revolute ones with limits",
            'write type="revolute" and the range that the manufacturer states, such as -6.98 to 6.98 rad',
        )
    elif not (np.isfinite(lower) and np.isfinite(upper)):
        yield (
            'has no <limit lower="" upper="">; every joint needs its range',
            "add it in rad, from the manufacturer's data sheet",
        )
    elif not lower < upper:
        fault = f"got a range from {lower:g} to {upper:g} rad; lower has to be below upper"
        yield fault, "correct it by the manufacturer's data sheet"
    elif upper - lower > 100.0:
        fault = f"got a range of {upper - lower:g} rad; allowed are 100"
        yield fault, "a URDF is in rad: correct it"
    if not velocity > 0.0:
        fault = "no speed" if np.isnan(velocity) else f"a speed of {velocity:g} rad/s"
        yield (
            f"got {fault}; allowed: a positive speed",
            "add velocity to its <limit>, from the manufacturer's data sheet",
        )
    elif velocity > 50.0:
        fault = f"got a speed of {velocity:g} rad/s; allowed are 50"
        yield fault, "a URDF is in rad/s: correct it"


def _parse_root(text: str) -> ET.Element:
    """Return the <robot> element. Raises ``robot.urdf`` for a text that is not a URDF."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise _urdf_error("has a <!DOCTYPE> or an <!ENTITY>, which is not allowed", "remove it")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise _urdf_error(f"is not XML ({error})", "write it again") from None
    if any(_is_xacro(element) for element in root.iter()):
        raise _urdf_error("is a xacro file, not a URDF", _XACRO)
    if root.tag != "robot":
        raise _urdf_error(f"begins with <{root.tag}>; a URDF begins with <robot>", "give the URDF of a robot")
    return root


def _is_xacro(element: ET.Element) -> bool:
    """Whether an element is one of xacro, or an attribute has a ``${...}`` or ``$(...)`` of it."""
    if str(element.tag).startswith("{") and "xacro" in str(element.tag):
        return True
    return any("${" in value or "$(" in value for value in element.attrib.values())


def _urdf_error(message: str, hint: str) -> TandemError:
    return issue_error("robot.urdf", f"the file {message}", field="urdf", hint=hint)


def _links_by_name(root: ET.Element) -> dict[str, ET.Element]:
    """Return all links by name. Raises ``robot.urdf`` for missing and repeated names, or too many links."""
    out: dict[str, ET.Element] = {}
    for link in root.findall("link"):
        name = link.get("name") or ""
        if not name or name in out:
            raise _urdf_error(
                f"has two links {name!r}" if name else "has a link without a name", "give each its own name"
            )
        out[name] = link
    if not out:
        raise _urdf_error("has no <link>", "give the URDF of an arm")
    if len(out) > MAX_LINKS:
        raise _urdf_error(f"has {len(out)} links; up to {MAX_LINKS} are read", "give the URDF of one arm")
    return out


def _joints_by_child(root: ET.Element, links: dict[str, ET.Element]) -> dict[str, ET.Element]:
    """Return the joint that carries each link, by the link's name. Raises ``robot.urdf`` for invalid ones."""
    joint_by_child: dict[str, ET.Element] = {}
    names: set[str] = set()
    for joint in root.findall("joint"):
        joint_name = joint.get("name") or ""
        if not joint_name or joint_name in names:
            raise _urdf_error(
                f"has two joints {joint_name!r}" if joint_name else "has a joint without a name",
                "give each its own name",
            )
        names.add(joint_name)
        ends = [_linked_name(joint, role) for role in ("parent", "child")]
        for name in ends:
            if name not in links:
                raise _urdf_error(f"has a joint {joint.get('name')!r} at a missing link {name!r}", "add it")
        if ends[1] in joint_by_child:
            text = (
                f"attaches the link {ends[1]!r} to two joints, {joint_by_child[ends[1]].get('name')!r} and "
            )
            raise _urdf_error(f"{text}{joint.get('name')!r}", "keep one of them")
        if joint.get("type") not in (*_MOVING, "fixed"):
            text = f"has a joint {joint.get('name')!r} of the type {joint.get('type')!r}"
            raise _urdf_error(f"{text}; allowed are revolute and fixed", "correct it")
        joint_by_child[ends[1]] = joint
    return joint_by_child


def _linked_name(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    name = None if element is None else element.get("link")
    if not name:
        raise _urdf_error(f"has a joint {joint.get('name')!r} that names no {role} link", "name it")
    return name


def _find_tip(
    links: dict[str, ET.Element], joint_by_child: dict[str, ET.Element], base: str, tip: str | None
) -> str:
    """Return the stated tip, else the first of `DEFAULT_TIPS` that exists, else raise ``robot.chain``."""
    if tip is not None:
        return tip
    for name in DEFAULT_TIPS:
        if name in links:
            return name
    text = (
        f"tip: not stated, and the URDF has no link {' or '.join(DEFAULT_TIPS)}; it has "
        f"{_list_names(sorted(links))}"
    )
    carried = {_linked_name(joint, "parent") for joint in joint_by_child.values()}
    moving_counts = {
        name: sum(joint.get("type") in _MOVING for joint in _joints_between(joint_by_child, base, name))
        for name in _descendants(joint_by_child, base)
        if name not in carried
    }
    ends = [name for name, count in moving_counts.items() if count == max(moving_counts.values()) > 0]
    hint = "name the flange's link as tip"
    hint += f"; the longest chain from {base} ends at {_list_names(sorted(ends))}" if ends else ""
    raise issue_error("robot.chain", text, field="tip", hint=hint)


def _joints_between(joint_by_child: dict[str, ET.Element], base: str, tip: str) -> list[ET.Element]:
    """Return the joints from base to tip in order. Raises ``robot.chain`` if they are not connected."""
    joints: list[ET.Element] = []
    link = tip
    while link != base:
        if link not in joint_by_child or len(joints) > len(joint_by_child):
            chain_text = _list_names([tip, *(_linked_name(joint, "parent") for joint in joints)])
            text = (
                f"tip: the link {tip!r} is not connected to the base {base!r}: the chain from it is "
                f"{chain_text}"
            )
            raise issue_error(
                "robot.chain", text, field="tip", hint="name a base and a tip that are on one chain"
            )
        joints.append(joint_by_child[link])
        link = _linked_name(joint_by_child[link], "parent")
    return joints[::-1]


def _joint_faults(joints: list[ET.Element]) -> Iterator[Issue]:
    """Yield issues of joints that follow others (mimic), or are of unsupported types."""

    def fault(joint: ET.Element, message: str, hint: str) -> Issue:
        name = joint.get("name") or ""
        return Issue("robot.chain", f"joint {name!r}: {message}; {hint}", field="urdf", bodies=(name,))

    for joint in joints:
        kind = joint.get("type")
        if joint.find("mimic") is not None:
            leader = joint.find("mimic").get("joint")  # type: ignore[union-attr]
            yield fault(
                joint,
                f"follows {leader!r} (mimic); allowed are joints with their own drive",
                "fix it, or give the serial arm and its coupled_deg",
            )
        elif kind in ("prismatic", "planar", "floating"):
            yield fault(
                joint,
                f"is of the type {kind}; allowed are revolute ones",
                "name the link after a track or a gantry as base",
            )


def _descendants(joint_by_child: dict[str, ET.Element], base: str) -> set[str]:
    """Return the links attached to the base by any joints, without the base itself."""
    carried: dict[str, list[str]] = {}
    for link, joint in joint_by_child.items():
        carried.setdefault(_linked_name(joint, "parent"), []).append(link)
    descendants: set[str] = set()
    queue = [base]
    while queue:
        new_links = [
            link for link in carried.get(queue.pop(), ()) if link not in descendants and link != base
        ]
        descendants.update(new_links)
        queue += new_links
    return descendants


def _build_chain(
    root: ET.Element, joints: list[ET.Element], joint_by_child: dict[str, ET.Element], base: str, tip: str
) -> UrdfChain:
    """Return the chain of the moving joints among ``joints``, which lead from base to tip."""
    poses, written = [np.eye(4)], [np.eye(4)]
    axes, written_axes, limits, names, kinds, links = [], [], [], [], [], [base]
    pose, written_pose = np.eye(4), np.eye(4)
    for joint in joints:
        pose, written_pose = (
            pose @ _origin(joint, joint.get("name")),
            written_pose @ _origin(joint, joint.get("name"), False),
        )
        if joint.get("type") == "fixed":
            continue
        axis = _axis(joint)
        axes.append(pose[:3, :3] @ axis)
        written_axes.append(written_pose[:3, :3] @ axis)
        poses.append(pose)
        written.append(written_pose)
        limits.append(_limits(joint))
        names.append(joint.get("name") or "")
        kinds.append(joint.get("type") or "")
        links.append(_linked_name(joint, "child"))
    lower, upper, velocity = np.array(limits).reshape(-1, 3).T
    descendants = _descendants(joint_by_child, base)
    shapes, notes = _collision_shapes(root, joint_by_child, links)
    visuals, invalid_visuals = _visual_shapes(root, joint_by_child, links)
    return UrdfChain(
        joints=tuple(names),
        kinds=tuple(kinds),
        links=tuple(links),
        tip_link=tip,
        zero=np.array([*poses, pose]),
        written=np.array([*written, written_pose]),
        axis=np.array(axes).reshape(-1, 3),
        written_axis=np.array(written_axes).reshape(-1, 3),
        lower=lower,
        upper=upper,
        velocity=velocity,
        shapes=tuple(shapes),
        other_joints=tuple(
            joint.get("name") or ""
            for link, joint in joint_by_child.items()
            if link in descendants and joint not in joints and joint.get("type") in _MOVING
        ),
        notes=tuple(notes),
        visuals=tuple(visuals),
        invalid_visuals=tuple(invalid_visuals),
        has_joints_after_tip=any(
            joint_by_child[link].get("type") in _MOVING for link in _descendants(joint_by_child, tip)
        ),
    )


def _collision_shapes(
    root: ET.Element, joint_by_child: dict[str, ET.Element], links: list[str]
) -> tuple[list[UrdfShape], list[str]]:
    """Return collision geometries of the links of the chain and of all that is fixed to them, and notes."""
    shapes, notes = [], []
    for link, name, carrier, pose in _rigidly_attached(root, joint_by_child, links):
        if _is_inertia_invalid(link):
            notes.append(f"inertia: that of the link {name} is invalid; it is not used")
        shapes += [_read_shape(collision, name, carrier, pose) for collision in link.findall("collision")]
        if len(shapes) > MAX_LINKS:
            message = f"has more than {MAX_LINKS} <collision> geometries on one arm"
            raise _urdf_error(message, "export fewer parts, or the hull of each link")
    return shapes, notes


def _rigidly_attached(
    root: ET.Element, joint_by_child: dict[str, ET.Element], links: list[str]
) -> Iterator[tuple[ET.Element, str, str, FloatArray]]:
    """Yield links that belong to the chain or are fixed to it.

    Each has its name, the link of the chain that carries it, and its pose (4, 4) there.
    """
    placed = {link: (link, np.eye(4)) for link in links}
    for link in root.findall("link"):
        name = link.get("name") or ""
        ancestors = [name]
        while (
            ancestors[-1] not in placed
            and ancestors[-1] in joint_by_child
            and joint_by_child[ancestors[-1]].get("type") == "fixed"
        ):
            ancestors.append(_linked_name(joint_by_child[ancestors[-1]], "parent"))
            if len(ancestors) > len(joint_by_child) + 1:
                break  # a closed loop of links outside the arm
        if ancestors[-1] not in placed:
            continue
        for link_name in ancestors[-2::-1]:  # each pose is computed once, however long the chain
            carrier, pose = placed[_linked_name(joint_by_child[link_name], "parent")]
            placed[link_name] = (
                carrier,
                pose @ _origin(joint_by_child[link_name], joint_by_child[link_name].get("name")),
            )
        yield link, name, *placed[name]


def _visual_shapes(
    root: ET.Element, joint_by_child: dict[str, ET.Element], links: list[str]
) -> tuple[list[UrdfShape], list[tuple[str, str]]]:
    """Return visuals of the chain and of all that is fixed to it, and links with invalid visuals.

    Invalid visuals never refuse a URDF.
    """
    visuals, invalid = [], []
    colors = {
        material_element.get("name"): _color(material_element)
        for material_element in root.findall("material")
    }
    for link, name, carrier, pose in _rigidly_attached(root, joint_by_child, links):
        for visual in link.findall("visual"):
            material = visual.find("material")
            color = None
            if material is not None:
                color = _color(material) or colors.get(material.get("name"))
            try:
                shape = _read_shape(visual, name, carrier, pose)
            except TandemError as error:
                invalid.append((name, error.issues[0].message))
            else:
                visuals.append(dataclasses.replace(shape, color=color))
    return visuals, invalid


def _color(material: ET.Element) -> tuple[float, ...] | None:
    """Return red, green, blue in 0..1 of a material, None if it states none."""
    element = material.find("color")
    try:
        values = [] if element is None else _numbers(element, "rgba", 4, material.get("name"))
    except TandemError:
        return None
    return tuple(min(max(v, 0.0), 1.0) for v in values[:3]) or None


def _read_shape(element: ET.Element, name: str, carrier: str, pose: FloatArray) -> UrdfShape:
    """Return the geometry of a <collision> or a <visual>.

    Raises:
        TandemError: ``robot.urdf``.
    """
    placed = pose @ _origin(element, name)
    geometry = element.find("geometry")
    geometry_element = None if geometry is None else next(iter(geometry), None)
    if geometry_element is None:
        raise _urdf_error(f"has a <{element.tag}> without a geometry in the link {name!r}", "give it one")
    kind = str(geometry_element.tag).partition("}")[2] or str(geometry_element.tag)
    if kind == "box":
        size = tuple(_numbers(geometry_element, "size", 3, name))
    elif kind in ("cylinder", "capsule"):
        size = (
            _numbers(geometry_element, "radius", 1, name)[0],
            _numbers(geometry_element, "length", 1, name)[0],
        )
    elif kind == "sphere":
        size = (_numbers(geometry_element, "radius", 1, name)[0],)
    elif kind == "mesh":
        size = tuple(_numbers(geometry_element, "scale", 3, name, [1.0, 1.0, 1.0]))
    else:
        text = f"has a {element.tag} <{kind}> in the link {name!r}"
        raise _urdf_error(f"{text}; allowed are box, cylinder, capsule, sphere and mesh", "use one of these")
    if (kind != "mesh" and not min(size) > 0.0) or not all(size):
        text = f"has a {kind} of the size {size} in the link {name!r}; all must be positive"
        raise _urdf_error(text, "correct it")
    if kind != "mesh":
        _require_metres(max(size), f"a {kind}", name)
    return UrdfShape(carrier, kind, size, placed, geometry_element.get("filename") or "", name)


def _is_inertia_invalid(link: ET.Element) -> bool:
    """Return whether the mass or a moment of inertia of a link is negative or not a number."""
    inertial = link.find("inertial")
    inertia = None if inertial is None else inertial.find("inertia")
    mass = None if inertial is None else inertial.find("mass")
    try:
        values = (
            [float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz")] if inertia is not None else []
        )
        values += [float(mass.get("value", "0"))] if mass is not None else []
    except ValueError:
        return True
    return any(not value >= 0.0 for value in values)


def _origin(element: ET.Element, name: str | None, snap: bool = True) -> FloatArray:
    """Return the pose (4, 4) that the <origin> of an element states."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz, rpy = (np.array(_numbers(origin, key, 3, name, [0.0] * 3)) for key in ("xyz", "rpy"))
    _require_metres(np.abs(xyz).max(), "an <origin>", name)
    if snap:
        rounded = SNAP_STEP_RAD * np.round(rpy / SNAP_STEP_RAD)
        rpy = np.where(np.abs(rpy - rounded) <= SNAP_TOLERANCE_RAD, rounded, rpy)
    return from_rpy(xyz, rpy)


def _require_metres(length: float, subject: str, name: str | None) -> None:
    """Raise ``robot.urdf`` for a length [m] larger than any arm."""
    if length > MAX_EXTENT_M:
        fault = f"has {subject} of {length:g} m at {name!r}; allowed are {MAX_EXTENT_M:g} m"
        raise _urdf_error(fault, "a URDF is in metres: correct it")


def _axis(joint: ET.Element) -> FloatArray:
    """Return the unit vector (3,) of a joint's axis in its own frame, x if none is stated."""
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0] if element is None else _numbers(element, "xyz", 3, joint.get("name")))
    length = float(np.linalg.norm(axis))
    if not length > 1e-3:
        raise _urdf_error(
            f"has a joint {joint.get('name')!r} with the invalid axis {axis.tolist()}", "correct it"
        )
    return np.asarray(axis / length)


def _limits(joint: ET.Element) -> list[float]:
    """Return lower limit, upper limit [rad] and speed [rad/s] of a joint, NaN for those not stated."""
    limit = joint.find("limit")
    if limit is None:
        return [np.nan] * 3
    return [_numbers(limit, k, 1, joint.get("name"), [np.nan])[0] for k in ("lower", "upper", "velocity")]


def _numbers(
    element: ET.Element, key: str, count: int, name: str | None, default: Sequence[float] | None = None
) -> list[float]:
    """Return ``count`` finite numbers of an attribute; ``default`` if it is not stated."""
    text = element.get(key)
    if text is None and default is not None:
        return list(default)
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        message = f"has <{element.tag} {key}={text!r}> at {name!r}; {count} finite numbers are required"
        raise _urdf_error(message, "correct it")
    return values


def _list_names(names: Sequence[str], max_count: int = 12) -> str:
    return ", ".join(names[:max_count]) + (
        f" and {len(names) - max_count} more" if len(names) > max_count else ""
    )
