"""Reads a URDF file's text: the chain of joints from a base link to a tip, its frames, limits and bodies.

Strict, with the standard library's XML alone: what a robot here cannot have (joints that follow
others or slide, limits that are missing, links on two joints) is told by joint, all faults at once.
Fixed joints are folded in. Angles of frames within 2e-4 rad of a multiple of 15 degrees are taken
as that: files write 1.5708. :mod:`planner.reading.opw` makes an arm of the chain.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np

from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, from_rpy
from planner.geometry.mesh_files import LARGEST_EXTENT
from planner.geometry.units import DEG
from planner.issues import Issue, TandemError, refusal

MAX_URDF_BYTES: Final = 5_000_000
"""Larger files are refused: a URDF is a few ten kilobytes."""
MOST_LINKS: Final = 2000
"""Links of a file at most, and geometries of its arm: an arm has some ten of them."""
SNAP_STEP: Final = 15.0 * DEG
"""Angles of frames are multiples of this [rad], ..."""
SNAP: Final = 2e-4
"""... where they lie so near to one [rad]."""
TIPS: Final = ("tool0", "flange")
"""Links that are the tip where none is named, the first one that there is."""
_XACRO: Final = "xacro FILE.xacro -o FILE.urdf makes it; without ROS: pip install xacro"
_MOVING: Final = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclasses.dataclass(frozen=True)
class UrdfShape:
    """A geometry at ``pose`` (4, 4) in the frame of the ``link`` of the chain that carries it: a box
    (x, y, z), a cylinder or Drake's capsule (radius, length), a sphere (radius,) [m], or a mesh of a
    ``file``, as the URDF names it, stretched by ``size`` (3,) along its axes. ``owner``: the link that states
    it, which is fixed to ``link`` or is that; ``color``: red, green, blue in 0..1 where a material says."""

    link: str
    kind: str
    size: tuple[float, ...]
    pose: FloatArray
    file: str = ""
    owner: str = ""
    color: tuple[float, ...] | None = None


@dataclasses.dataclass(frozen=True)
class UrdfChain:
    """Turning joints in a row, by the text of a URDF.

    ``joints``: their names; ``links``: the base and the links that they
    turn; ``tip_link``: the tip. ``zero`` (N + 2, 4, 4): frames
    of these links and of the tip in the base with all joints at zero; ``written``: the same by the angles as
    they are written, not snapped. ``axis`` (N, 3): unit vectors in the base at zero; axis i goes through the
    origin of frame i + 1. ``lower``, ``upper`` [rad], ``velocity`` [rad/s] (N,), NaN where none is stated.
    ``kinds``: the joints' types. ``shapes``: what is fixed to the base and to the links, for collision.
    ``visuals``: the same to be seen; ``unseen``: links with one that is not well stated, and why.
    ``beside``: joints that move something else on the base or on these links, which is not followed.
    ``notes``: what the file states that is not used. ``behind``: joints that turn or slide hang on the tip.
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
    beside: tuple[str, ...]
    notes: tuple[str, ...]
    visuals: tuple[UrdfShape, ...] = ()
    unseen: tuple[tuple[str, str], ...] = ()
    behind: bool = False

    def tip(self, q: FloatArray, written: bool = False) -> FloatArray:
        """Poses (..., 4, 4) of the tip in the base at joint angles ``q`` (..., N) [rad], by a product of
        turns about the axes at zero (Murray, Li, Sastry 1994, section 3.2); by the angles as written or
        snapped."""
        zero, axis = (self.written, self.written_axis) if written else (self.zero, self.axis)
        pose = zero[-1]
        for i in reversed(range(len(axis))):
            turn = exp_rotation(np.asarray(q)[..., i, None] * axis[i])
            point = zero[i + 1, :3, 3]
            pose = from_parts(turn, point - turn @ point) @ pose
        return np.asarray(pose)


class CoupledError(TandemError):
    """Joints of a chain follow others (mimic), which is all that is wrong with it; ``chain``: with these
    fixed."""

    def __init__(self, issues: Sequence[Issue], chain: UrdfChain) -> None:
        super().__init__(issues)
        self.chain = chain


def read_chain(text: str, base: str, tip: str | None) -> UrdfChain:
    """The chain from the link ``base`` to the link ``tip``, the first of :data:`TIPS` where it is None.

    Raises :class:`TandemError` with all faults: ``robot.urdf`` for what is no URDF, ``robot.chain`` for a
    chain that an arm cannot have (:class:`CoupledError` for joints that follow others), ``robot.limits`` for
    joints without a range or a speed.
    """
    root = _root(text)
    links = _links(root)
    above = _joints(root, links)
    tip = _tip(links, above, base, tip)
    for word, name in (("base", base), ("tip", tip)):
        if name not in links:
            what = f"{word}: the URDF has no link {name!r}, it has {_listed(sorted(links))}"
            raise refusal("robot.chain", what, field=word, hint=f"name one of these as {word}")
    way = _way(above, base, tip)
    issues = list(_faults(way))
    if issues:
        following = [joint for joint in way if joint.find("mimic") is not None]
        if len(issues) > len(following):
            raise TandemError(issues)
        for joint in following:
            joint.set("type", "fixed")
        raise CoupledError(issues, _chain(root, way, above, base, tip))
    return _chain(root, way, above, base, tip)


def limit_faults(chain: UrdfChain) -> list[Issue]:
    """Faults (``robot.limits``) of the ranges and speeds of a chain's joints."""
    return [
        Issue("robot.limits", f"joint {name!r}: {what}; {hint}", field="urdf", bodies=(name,))
        for i, name in enumerate(chain.joints)
        for what, hint in _limit_faults(chain, i)
    ]


def _limit_faults(chain: UrdfChain, i: int) -> Iterator[tuple[str, str]]:
    lower, upper, velocity = chain.lower[i], chain.upper[i], chain.velocity[i]
    if chain.kinds[i] == "continuous":
        yield (
            "got type continuous, which has no end; allowed are revolute ones with limits",
            'write type="revolute" and the range that the maker states, such as -6.98 to 6.98 rad',
        )
    elif not (np.isfinite(lower) and np.isfinite(upper)):
        yield (
            'has no <limit lower="" upper="">; every joint needs its range',
            "add it in rad, from the maker's data sheet",
        )
    elif not lower < upper:
        got = f"got a range from {lower:g} to {upper:g} rad; lower has to be below upper"
        yield got, "correct it by the maker's data sheet"
    elif upper - lower > 100.0:
        got = f"got a range of {upper - lower:g} rad; allowed are 100"
        yield got, "a URDF has rad: correct it"
    if not velocity > 0.0:
        got = "no speed" if np.isnan(velocity) else f"a speed of {velocity:g} rad/s"
        yield (
            f"got {got}; allowed is what is above 0",
            "add velocity to its <limit>, by the maker's data sheet",
        )
    elif velocity > 50.0:
        got = f"got a speed of {velocity:g} rad/s; allowed are 50"
        yield got, "a URDF has rad/s: correct it"


def _root(text: str) -> ET.Element:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise _no_urdf("has a <!DOCTYPE> or an <!ENTITY>, which no URDF needs", "remove it")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise _no_urdf(f"is not XML ({error})", "write it again") from None
    if any(_of_xacro(element) for element in root.iter()):
        raise _no_urdf("is a xacro file, of which a URDF is still to be made", _XACRO)
    if root.tag != "robot":
        raise _no_urdf(f"begins with <{root.tag}>; a URDF begins with <robot>", "give the URDF of a robot")
    return root


def _of_xacro(element: ET.Element) -> bool:
    """Whether an element is one of xacro, or an attribute has a ``${...}`` or ``$(...)`` of it."""
    if str(element.tag).startswith("{") and "xacro" in str(element.tag):
        return True
    return any("${" in value or "$(" in value for value in element.attrib.values())


def _no_urdf(what: str, hint: str) -> TandemError:
    return refusal("robot.urdf", f"the file {what}", field="urdf", hint=hint)


def _links(root: ET.Element) -> dict[str, ET.Element]:
    out: dict[str, ET.Element] = {}
    for link in root.findall("link"):
        name = link.get("name") or ""
        if not name or name in out:
            raise _no_urdf(
                f"has two links {name!r}" if name else "has a link without a name", "name them apart"
            )
        out[name] = link
    if not out:
        raise _no_urdf("has no <link>", "give the URDF of an arm")
    if len(out) > MOST_LINKS:
        raise _no_urdf(f"has {len(out)} links; up to {MOST_LINKS} are read", "give the URDF of one arm")
    return out


def _joints(root: ET.Element, links: dict[str, ET.Element]) -> dict[str, ET.Element]:
    above: dict[str, ET.Element] = {}
    names: set[str] = set()
    for joint in root.findall("joint"):
        own = joint.get("name") or ""
        if not own or own in names:
            raise _no_urdf(
                f"has two joints {own!r}" if own else "has a joint without a name", "name them apart"
            )
        names.add(own)
        ends = [_link(joint, role) for role in ("parent", "child")]
        for name in ends:
            if name not in links:
                raise _no_urdf(
                    f"has a joint {joint.get('name')!r} at a link {name!r}, which is not there", "add it"
                )
        if ends[1] in above:
            what = f"hangs the link {ends[1]!r} on two joints, {above[ends[1]].get('name')!r} and "
            raise _no_urdf(f"{what}{joint.get('name')!r}", "leave one of them")
        if joint.get("type") not in (*_MOVING, "fixed"):
            what = f"has a joint {joint.get('name')!r} of the type {joint.get('type')!r}"
            raise _no_urdf(f"{what}; allowed are revolute and fixed", "correct it")
        above[ends[1]] = joint
    return above


def _link(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    name = None if element is None else element.get("link")
    if not name:
        raise _no_urdf(f"has a joint {joint.get('name')!r} that names no {role} link", "name it")
    return name


def _tip(links: dict[str, ET.Element], above: dict[str, ET.Element], base: str, tip: str | None) -> str:
    if tip is not None:
        return tip
    for name in TIPS:
        if name in links:
            return name
    what = (
        f"tip: none is named, and the URDF has no link {' or '.join(TIPS)}; it has {_listed(sorted(links))}"
    )
    carried = {_link(joint, "parent") for joint in above.values()}
    turned = {
        name: sum(joint.get("type") in _MOVING for joint in _way(above, base, name))
        for name in _hung(above, base)
        if name not in carried
    }
    ends = [name for name, count in turned.items() if count == max(turned.values()) > 0]
    hint = "name the flange's link as tip"
    hint += f"; the longest chain from {base} ends at {_listed(sorted(ends))}" if ends else ""
    raise refusal("robot.chain", what, field="tip", hint=hint)


def _way(above: dict[str, ET.Element], base: str, tip: str) -> list[ET.Element]:
    way: list[ET.Element] = []
    link = tip
    while link != base:
        if link not in above or len(way) > len(above):
            seen = _listed([tip, *(_link(joint, "parent") for joint in way)])
            what = f"tip: the link {tip!r} does not hang on the base {base!r}: from it the chain goes {seen}"
            raise refusal(
                "robot.chain", what, field="tip", hint="name a base and a tip that are on one chain"
            )
        way.append(above[link])
        link = _link(above[link], "parent")
    return way[::-1]


def _faults(way: list[ET.Element]) -> Iterator[Issue]:
    def fault(joint: ET.Element, what: str, hint: str) -> Issue:
        name = joint.get("name") or ""
        return Issue("robot.chain", f"joint {name!r}: {what}; {hint}", field="urdf", bodies=(name,))

    for joint in way:
        kind = joint.get("type")
        if joint.find("mimic") is not None:
            follows = joint.find("mimic").get("joint")  # type: ignore[union-attr]
            yield fault(
                joint,
                f"follows {follows!r} (mimic); allowed are joints with a drive of their own",
                "fix it, or give the serial arm and its coupled_deg",
            )
        elif kind in ("prismatic", "planar", "floating"):
            yield fault(
                joint,
                f"is of the type {kind}; allowed are revolute ones",
                "name the link behind a track or a gantry as base",
            )


def _hung(above: dict[str, ET.Element], base: str) -> set[str]:
    """The links that hang on the base, by any joints; the base itself is not one."""
    carried: dict[str, list[str]] = {}
    for link, joint in above.items():
        carried.setdefault(_link(joint, "parent"), []).append(link)
    found: set[str] = set()
    open_ = [base]
    while open_:
        new = [link for link in carried.get(open_.pop(), ()) if link not in found and link != base]
        found.update(new)
        open_ += new
    return found


def _chain(
    root: ET.Element, way: list[ET.Element], above: dict[str, ET.Element], base: str, tip: str
) -> UrdfChain:
    poses, written = [np.eye(4)], [np.eye(4)]
    axes, raw_axes, limits, names, kinds, links = [], [], [], [], [], [base]
    pose, raw = np.eye(4), np.eye(4)
    for joint in way:
        pose, raw = pose @ _origin(joint, joint.get("name")), raw @ _origin(joint, joint.get("name"), False)
        if joint.get("type") == "fixed":
            continue
        axis = _axis(joint)
        axes.append(pose[:3, :3] @ axis)
        raw_axes.append(raw[:3, :3] @ axis)
        poses.append(pose)
        written.append(raw)
        limits.append(_limits(joint))
        names.append(joint.get("name") or "")
        kinds.append(joint.get("type") or "")
        links.append(_link(joint, "child"))
    lower, upper, velocity = np.array(limits).reshape(-1, 3).T
    hung = _hung(above, base)
    shapes, notes = _bodies(root, above, links)
    visuals, unseen = _visuals(root, above, links)
    return UrdfChain(
        joints=tuple(names),
        kinds=tuple(kinds),
        links=tuple(links),
        tip_link=tip,
        zero=np.array([*poses, pose]),
        written=np.array([*written, raw]),
        axis=np.array(axes).reshape(-1, 3),
        written_axis=np.array(raw_axes).reshape(-1, 3),
        lower=lower,
        upper=upper,
        velocity=velocity,
        shapes=tuple(shapes),
        beside=tuple(
            joint.get("name") or ""
            for link, joint in above.items()
            if link in hung and joint not in way and joint.get("type") in _MOVING
        ),
        notes=tuple(notes),
        visuals=tuple(visuals),
        unseen=tuple(unseen),
        behind=any(above[link].get("type") in _MOVING for link in _hung(above, tip)),
    )


def _bodies(
    root: ET.Element, above: dict[str, ET.Element], links: list[str]
) -> tuple[list[UrdfShape], list[str]]:
    """Collision geometries of the chain's links and of all that is fixed to them, and notes."""
    shapes, notes = [], []
    for link, name, carrier, pose in _carried(root, above, links):
        if _bad_inertia(link):
            notes.append(f"inertia: that of the link {name} is not of a body; it is not used")
        shapes += [_shape(collision, name, carrier, pose) for collision in link.findall("collision")]
        if len(shapes) > MOST_LINKS:
            what = f"has more than {MOST_LINKS} <collision> geometries on one arm"
            raise _no_urdf(what, "export its parts as fewer, or as the hull of each link")
    return shapes, notes


def _carried(
    root: ET.Element, above: dict[str, ET.Element], links: list[str]
) -> Iterator[tuple[ET.Element, str, str, FloatArray]]:
    """Links that are the chain's or fixed to it: each with its name, the link of the chain that carries it,
    and its pose (4, 4) there."""
    placed = {link: (link, np.eye(4)) for link in links}
    for link in root.findall("link"):
        name = link.get("name") or ""
        way = [name]
        while way[-1] not in placed and way[-1] in above and above[way[-1]].get("type") == "fixed":
            way.append(_link(above[way[-1]], "parent"))
            if len(way) > len(above) + 1:
                break  # a ring of links, none of which is the arm's
        if way[-1] not in placed:
            continue
        for one in way[-2::-1]:  # each is worked out once, however long the row
            carrier, pose = placed[_link(above[one], "parent")]
            placed[one] = carrier, pose @ _origin(above[one], above[one].get("name"))
        yield link, name, *placed[name]


def _visuals(
    root: ET.Element, above: dict[str, ET.Element], links: list[str]
) -> tuple[list[UrdfShape], list[tuple[str, str]]]:
    """What is to be seen of the chain's links and of all that is fixed to them, and links with what cannot
    be: nothing here refuses a URDF."""
    visuals, unseen = [], []
    colors = {one.get("name"): _color(one) for one in root.findall("material")}
    for link, name, carrier, pose in _carried(root, above, links):
        for visual in link.findall("visual"):
            material = visual.find("material")
            color = None
            if material is not None:
                color = _color(material) or colors.get(material.get("name"))
            try:
                shape = _shape(visual, name, carrier, pose)
            except TandemError as error:
                unseen.append((name, error.issues[0].message))
            else:
                visuals.append(dataclasses.replace(shape, color=color))
    return visuals, unseen


def _color(material: ET.Element) -> tuple[float, ...] | None:
    """Red, green, blue in 0..1 of a material, None where it states none."""
    element = material.find("color")
    try:
        values = [] if element is None else _numbers(element, "rgba", 4, material.get("name"))
    except TandemError:
        return None
    return tuple(min(max(v, 0.0), 1.0) for v in values[:3]) or None


def _shape(element: ET.Element, name: str, carrier: str, pose: FloatArray) -> UrdfShape:
    """The geometry of a <collision> or a <visual>. Raises :class:`TandemError` (``robot.urdf``)."""
    placed = pose @ _origin(element, name)
    geometry = element.find("geometry")
    one = None if geometry is None else next(iter(geometry), None)
    if one is None:
        raise _no_urdf(f"has a <{element.tag}> without a geometry in the link {name!r}", "give it one")
    kind = str(one.tag).partition("}")[2] or str(one.tag)
    if kind == "box":
        size = tuple(_numbers(one, "size", 3, name))
    elif kind in ("cylinder", "capsule"):
        size = (_numbers(one, "radius", 1, name)[0], _numbers(one, "length", 1, name)[0])
    elif kind == "sphere":
        size = (_numbers(one, "radius", 1, name)[0],)
    elif kind == "mesh":
        size = tuple(_numbers(one, "scale", 3, name, [1.0, 1.0, 1.0]))
    else:
        what = f"has a {element.tag} <{kind}> in the link {name!r}"
        raise _no_urdf(f"{what}; allowed are box, cylinder, capsule, sphere and mesh", "take one of these")
    if (kind != "mesh" and not min(size) > 0.0) or not all(size):
        what = f"has a {kind} of the size {size} in the link {name!r}; all have to be above 0"
        raise _no_urdf(what, "correct it")
    if kind != "mesh":
        _require_metres(max(size), f"a {kind}", name)
    return UrdfShape(carrier, kind, size, placed, one.get("filename") or "", name)


def _bad_inertia(link: ET.Element) -> bool:
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
        near = SNAP_STEP * np.round(rpy / SNAP_STEP)
        rpy = np.where(np.abs(rpy - near) <= SNAP, near, rpy)
    return from_rpy(xyz, rpy)


def _require_metres(length: float, what: str, name: str | None) -> None:
    """Raises :class:`TandemError` (``robot.urdf``) for a length [m] that no arm has."""
    if length > LARGEST_EXTENT:
        got = f"has {what} of {length:g} m at {name!r}; allowed are {LARGEST_EXTENT:g} m"
        raise _no_urdf(got, "a URDF has metres: correct it")


def _axis(joint: ET.Element) -> FloatArray:
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0] if element is None else _numbers(element, "xyz", 3, joint.get("name")))
    length = float(np.linalg.norm(axis))
    if not length > 1e-3:
        raise _no_urdf(
            f"has a joint {joint.get('name')!r} with the axis {axis.tolist()}, which is none", "correct it"
        )
    return np.asarray(axis / length)


def _limits(joint: ET.Element) -> list[float]:
    limit = joint.find("limit")
    if limit is None:
        return [np.nan] * 3
    return [_numbers(limit, k, 1, joint.get("name"), [np.nan])[0] for k in ("lower", "upper", "velocity")]


def _numbers(
    element: ET.Element, key: str, count: int, name: str | None, default: Sequence[float] | None = None
) -> list[float]:
    """``count`` finite numbers of an attribute; ``default`` where it is not stated."""
    text = element.get(key)
    if text is None and default is not None:
        return list(default)
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        what = f"has <{element.tag} {key}={text!r}> at {name!r}; {count} finite numbers are needed"
        raise _no_urdf(what, "correct it")
    return values


def _listed(names: Sequence[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
