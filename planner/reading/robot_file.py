"""A robot of the user's own: its URDF and a few lines beside it, as a problem file states them.

The geometry is that of the URDF's axes (:mod:`planner.reading.opw`); what a URDF does not say is
stated with its source, or assumed and shown as that. Bodies for collision are the URDF's, meshes by
their convex hulls; none is left out silently. What is seen are its visuals
(:mod:`planner.reading.link_visuals`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError
from scipy.spatial import ConvexHull, QhullError

from planner.catalogue.robots import (
    ArmForm,
    Family,
    OffsetParameters,
    OpwParameters,
    RobotData,
    RobotFile,
    RodCoupling,
    SevenParameters,
)
from planner.files import is_file
from planner.geometry.arrays import FloatArray, Shape, read_only
from planner.geometry.mesh_files import PLAIN_SUFFIXES, read_mesh
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.reading.link_visuals import carried, looks
from planner.reading.strict_yaml import Angle, FileName, Name, Strict
from planner.reading.urdf import MAX_URDF_BYTES, UrdfChain, UrdfShape, read_chain

if TYPE_CHECKING:
    from planner.reading.opw import ArmFit

FULL_SPEED_AFTER: Final = 0.4
"""Time [s] from rest to full speed of every axis where none is stated: that of the largest arms built in."""
LEAN: Final = 15.0 * DEG
"""How far [rad] the upper arm of an arm with seven axes leans at home where none is stated."""
FAMILIES: Final[Mapping[str, tuple[Family, str]]] = {
    "abb": ("ABB", "IRC5"),
    "kuka": ("KUKA", "KRC4"),
    "ur": ("UR", "e-Series"),
    "generic": ("generic", "not stated"),
}
"""Families of controllers, with the controller where none is stated."""


Posture = Annotated[tuple[Angle, ...], Field(min_length=6, max_length=7)]
"""Joints of an arm: one angle for each of its axes."""


class LinkMeshFile(Strict):
    """Where a mesh of a URDF lies."""

    name: FileName = Field(description="as the URDF names it")
    file: FileName


class OwnRobotFile(Strict):
    """A robot of one's own: its URDF, and what a URDF does not say."""

    urdf: FileName
    name: Name = Field(description="what it is called; not that of a robot that is built in")
    title: str | None = Field(default=None, max_length=100, description="none: its name")
    base: str = Field(default="base_link", description="link that stands where the arm's `base` is")
    tip: str | None = Field(default=None, description="link that tools are on; none: `tool0`, else `flange`")
    family: Literal["abb", "kuka", "ur", "generic"] = Field(
        description="of its controller: RAPID, KRL or URScript; `generic`: trajectories of ROS 2 alone"
    )
    controller: str | None = Field(
        default=None, max_length=50, description="none: IRC5, KRC4, e-Series, not stated"
    )
    payload_kg: float = Field(ge=0.1, le=5000)
    full_speed_after_s: float | None = Field(
        default=None, ge=0.01, le=5, description="of every axis from rest; none: 0.4, assumed"
    )
    coupled_deg: tuple[Angle, Angle] | None = Field(
        default=None,
        description="of a parallel rod: range of the controller's axis 3, which is axis 2 + axis 3",
    )
    home_deg: Posture | None = Field(
        default=None, description="serial joints at home; none: the upper arm upright, the forearm level"
    )
    left_out: tuple[str, ...] = Field(
        default=(), description="joints beside the chain whose bodies do not count: rods"
    )
    meshes: tuple[LinkMeshFile, ...] = Field(
        default=(), description="where meshes lie that are not found from the URDF"
    )
    visuals: tuple[LinkMeshFile, ...] = Field(
        default=(), description="the same of meshes of <visual>, which are seen and do not count for anything"
    )
    sources: dict[str, str] = Field(
        default_factory=dict, description="where figures come from, by key: urdf, payload_kg ..."
    )


_STATED: Final = ("payload_kg", "coupled_deg", "home_deg", "full_speed_after_s")
"""Keys whose figures have a source, or are shown as assumed."""


def robot_of(spec: OwnRobotFile, folder: Path) -> RobotData:
    """The robot of a file; names start at ``folder``. Raises :class:`TandemError` as
    :func:`planner.reading.urdf.read_chain` and :func:`planner.reading.opw.fit`, ``robot.bodies`` for bodies
    that are not known, ``problem.field`` for lines that contradict one another."""
    from planner.reading.opw import fit, own_chain  # with kinematics, which other problems are read without

    path = folder / spec.urdf
    text = read_urdf(path)
    chain = own_chain(text, spec.base, spec.tip)
    found = fit(chain)
    issues = [*_key_faults(spec, chain, found.form)]
    if spec.home_deg is not None and (short := posture_fault(spec.home_deg, found.form.count)):
        issues.append(Issue("problem.field", f"home_deg: {short}", field="home_deg"))
    shapes = _shapes(spec, chain, path, folder, issues)
    if issues:
        raise TandemError(issues)
    shown, unseen = looks(chain, shapes, _visual_files(spec, chain, path, folder))
    coupling = None if spec.coupled_deg is None else RodCoupling(*(v * DEG for v in spec.coupled_deg))
    rise = spec.full_speed_after_s or FULL_SPEED_AFTER
    family, controller = FAMILIES[spec.family]
    form = found.form
    home = _home(form, chain) if spec.home_deg is None else np.array(spec.home_deg) * DEG
    data = RobotData(
        name=spec.name,
        title=spec.title or spec.name,
        family=family,
        controller=spec.controller or controller,
        form=form,
        lower=chain.lower,
        upper=chain.upper,
        velocity=chain.velocity,
        acceleration=chain.velocity / rise,
        payload=spec.payload_kg,
        reach=float(np.hypot(form.stretched, form.b)),
        coupling=coupling,
        home=home,
        sources=tuple(f"{key}: {source}" for key, source in sorted(spec.sources.items())),
        assumed=tuple(_assumed(spec, chain, found)),
        file=RobotFile(
            text, spec.base, chain.tip_link, chain.zero, chain.axis, shapes, chain.joints, shown, unseen
        ),
    )
    read_only(data)
    if not float(data.limit_margin(home)) >= 0.0:
        got = ", ".join(f"{v:g}" for v in np.round(home / DEG, 3))
        what = f"home_deg: [{got}] is beyond the limits of the URDF or of coupled_deg; correct them"
        raise refusal("problem.field", what, field="home_deg")
    return data


def posture_fault(joints: Sequence[float], axes: int) -> str | None:
    """What is wrong with how many joints a posture has, for an arm of so many axes; None where nothing is."""
    if len(joints) == axes:
        return None
    return f"got {len(joints)} angles, the robot has {axes} axes; state one angle for each"


def read_urdf(path: Path) -> str:
    """The text of a file. Raises :class:`TandemError`: ``problem.missing_file``, ``problem.too_large``, or
    ``robot.urdf`` for what is not UTF-8."""
    if not is_file(path):
        what = f"no file {path}; check the path"
        raise refusal("problem.missing_file", what, field="urdf")
    size = path.stat().st_size
    if size > MAX_URDF_BYTES:
        what = f"{size / 1e6:.0f} MB, up to {MAX_URDF_BYTES / 1e6:.0f} MB are read"
        raise refusal("problem.too_large", what, field="urdf", hint="give the URDF of one arm")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        what = f"the file is not UTF-8 ({error})"
        raise refusal("robot.urdf", what, field="urdf", hint="save it as UTF-8") from None


def _key_faults(spec: OwnRobotFile, chain: UrdfChain, form: ArmForm) -> Iterator[Issue]:
    kinds = {"abb": OpwParameters | OffsetParameters, "kuka": OpwParameters}
    if spec.family in kinds and not isinstance(form, kinds[spec.family]):
        what = (
            f"family: got {spec.family}, whose programs name postures of arms with a spherical wrist; this "
        )
        what += (
            "arm has none; write generic"
            if isinstance(form, SevenParameters)
            else "arm has none; write ur or generic"
        )
        yield Issue("problem.field", what, field="family")
    if spec.family == "ur" and isinstance(form, SevenParameters):
        what = "family: got ur, whose arms have six axes; this one has seven: write generic"
        yield Issue("problem.field", what, field="family")
    if spec.coupled_deg is not None and isinstance(form, OffsetParameters | SevenParameters):
        kind = "an offset wrist" if isinstance(form, OffsetParameters) else "seven axes"
        what = f"coupled_deg: no arm with {kind} has a parallel rod; leave it out"
        yield Issue("problem.field", what, field="coupled_deg")
    beside = [name for name in chain.beside if name not in spec.left_out]
    if beside:
        names = ", ".join(repr(name) for name in beside)
        what = f"{len(beside)} joints move beside the chain from {spec.base!r} to the tip: {names}"
        hint = "fix them, name the base of this arm alone, or name rods and pistons under left_out"
        yield Issue("robot.chain", what, field="urdf", hint=hint)
    if spec.coupled_deg is not None:
        low, high = spec.coupled_deg
        sums = (chain.lower[1:3].sum() / DEG, chain.upper[1:3].sum() / DEG)
        if not (low < high and low < sums[1] and high > sums[0]):
            what = f"coupled_deg: got {low:g} to {high:g}, by the limits of axes 2 and 3 their sum is within "
            what += f"{sums[0]:g} to {sums[1]:g} deg; correct one of them"
            yield Issue("problem.field", what, field="coupled_deg")
    for key in sorted(set(spec.sources) - set(OwnRobotFile.model_fields)):
        yield Issue("problem.field", f"sources: {key!r} is no key of a robot; correct it", field="sources")


def _assumed(spec: OwnRobotFile, chain: UrdfChain, found: ArmFit) -> Iterator[str]:
    if spec.full_speed_after_s is None:
        yield f"acceleration: assumed, every axis reaches its full speed in {FULL_SPEED_AFTER:g} s from rest"
    for key in _STATED:
        if getattr(spec, key) is not None and key not in spec.sources:
            yield f"{key}: stated without a source"
    if "urdf" not in spec.sources:
        yield "dimensions, limits and speeds: of a URDF without a source"
    if spec.coupled_deg is None:
        yield "coupling: assumed, none"
    if spec.home_deg is None:
        yield f"home: assumed, {home_words(found.form)}"
    if max(found.snapped) > 1e-9:
        off = f"{found.snapped[0] / MM:.2g} mm, {found.snapped[1]:.2g} rad at the tip"
        yield f"angles of the URDF: taken as multiples of 15 deg where they are nearly that, at most {off}"
    for name in chain.beside:
        yield f"bodies: what the joint {name} moves is left out"
    yield from chain.notes


def home_words(form: ArmForm) -> str:
    """What the posture at home is like where none is stated."""
    if isinstance(form, SevenParameters):
        return f"the upper arm leant by {LEAN / DEG:g} deg, the elbow square and the flange downwards"
    return "the upper arm upright and the forearm level"


def _home(form: ArmForm, chain: UrdfChain) -> FloatArray:
    """Serial joints (J,) [rad]: upper arm upright, forearm level, all others at zero; of an arm without a
    spherical wrist the flange downwards; in the limits. Of one with seven axes all as in that form, the upper
    arm leant by :data:`LEAN` off the posture in which axes 1 and 3 are in line."""
    if isinstance(form, SevenParameters):
        theta = (0.0, LEAN, 0.0, 0.5 * np.pi, 0.0, 0.5 * np.pi - LEAN, 0.0)
        bent = form.signs * (np.array(theta) + form.offsets)
        q = np.arctan2(np.sin(bent), np.cos(bent)) + 0.0
        q[-1] = 0.5 * (chain.lower[-1] + chain.upper[-1])
        return np.clip(q, chain.lower, chain.upper)
    q = np.zeros(form.count)
    hand: tuple[tuple[int, float], ...] = ((3, 0.0), (4, -0.5 * np.pi))
    if isinstance(form, OpwParameters):
        hand = ()
    if isinstance(form, OffsetParameters):
        hand = ((3, 0.0), (4, 0.5 * np.pi))
    for axis, wanted in ((1, 0.0), (2, 0.5 * np.pi), *hand):
        angle = form.signs[axis] * (wanted + form.offsets[axis])
        q[axis] = np.arctan2(np.sin(angle), np.cos(angle)) + 0.0
    return np.clip(q, chain.lower, chain.upper)


def _shapes(
    spec: OwnRobotFile, chain: UrdfChain, path: Path, folder: Path, issues: list[Issue]
) -> tuple[tuple[Shape, ...], ...]:
    """What is held apart, of the base and of each link."""
    out: dict[str, list[Shape]] = {link: [] for link in chain.links}
    lost, unread = [], []
    for one in chain.shapes:
        if one.kind != "mesh":
            out[one.link].append(Shape(one.kind, one.size, one.pose))  # type: ignore[arg-type]
            continue
        file = mesh_file(one.file, spec.meshes, path, folder)
        if file is None:
            lost.append(one.file)
        elif file.suffix.lower() not in PLAIN_SUFFIXES:
            unread.append(one.file)
        else:
            out[one.link].append(_hull(one, file))
    if lost:
        what = f"{len(lost)} meshes of the URDF are not there: {', '.join(sorted(set(lost))[:7])}"
        hint = "lay them beside the URDF as its package has them, or say under meshes where each of them "
        hint += "lies: tandem robots add URDF --meshes FOLDER writes that"
        issues.append(Issue("robot.bodies", what, field="urdf", hint=hint))
    if unread:
        what = (
            f"{len(unread)} meshes of the URDF are no OBJ, STL or PLY: {', '.join(sorted(set(unread))[:7])}"
        )
        hint = "convert them, in metres, and say under meshes which file stands for each, as "
        hint += "tandem robots add URDF --meshes FOLDER writes it"
        issues.append(Issue("robot.bodies", what, field="urdf", hint=hint))
    bare = [link for link in chain.links if not out[link]]
    if bare and not lost and not unread:
        what = f"the links {', '.join(bare)} have no <collision> geometry, so nothing would keep off them"
        hint = "give each one a <collision>: a box, cylinder, sphere or mesh"
        issues.append(Issue("robot.bodies", what, field="urdf", hint=hint))
    return tuple(tuple(shapes) for shapes in out.values())


def _hull(one: UrdfShape, file: Path) -> Shape:
    """The convex hull of a mesh, whose file is in metres times the URDF's scale."""
    most = max(abs(v) for v in one.size)
    vertices = read_mesh(file, 1.0, most).vertices * (np.array(one.size) / most)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        what = f"the mesh {one.file} is flat and bounds nothing"
        raise refusal(
            "robot.bodies", what, field="urdf", hint="export it as a solid, or state a box"
        ) from None
    points = vertices[hull.vertices]
    faces = np.searchsorted(hull.vertices, hull.simplices)
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normal * hull.equations[:, :3], axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return Shape("mesh", (), one.pose, points, faces.astype(np.int64))


def _visual_files(spec: OwnRobotFile, chain: UrdfChain, urdf: Path, folder: Path) -> dict[str, Path | None]:
    """Files of the meshes of <visual> by their names, None of those that are not there."""
    named = dict.fromkeys(one.file for one in chain.visuals if one.kind == "mesh" and len(one.file) <= 1000)
    return {name: mesh_file(name, (*spec.visuals, *spec.meshes), urdf, folder) for name in named}


def mesh_file(name: str, stated: Sequence[LinkMeshFile], urdf: Path, folder: Path) -> Path | None:
    """The file of a mesh, as it is stated, else beside the URDF or in its package; None if it is not there.
    Names that are stated start at the folder of the URDF, or at ``folder``, that of the file that states
    them, from which they may have been made absolute."""
    for one in stated:
        if one.name == name:
            named = Path(one.file)
            places = [urdf.parent / named, folder / named]
            if named.is_relative_to(folder):
                places[1:] = [urdf.parent / named.relative_to(folder), folder / named, named]
            return next((path for path in places if is_file(path)), None)
    rest = Path(name.partition("://")[2] or name)
    if rest.is_absolute() or ".." in rest.parts or not rest.parts:
        return None
    package = name.startswith("package://")
    for folder in (urdf.parent, *urdf.parent.parents) if package else (urdf.parent,):
        inside = folder.joinpath(*rest.parts[1:]) if package and folder.name == rest.parts[0] else None
        for file in (folder / rest, inside):
            if file is not None and is_file(file):
                return file
    return None


def with_meshes(robot: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """What a problem states of a robot in ``folder``, every file name absolute, with all meshes of the URDF
    named, of those that are only seen the ones that can be carried; as it is where it is not well stated,
    which whoever reads it says."""
    try:
        spec = OwnRobotFile.model_validate(dict(robot))
    except ValidationError:
        return dict(robot)
    path = Path(spec.urdf)
    chain = read_chain(read_urdf(path), spec.base, spec.tip)
    named = dict.fromkeys(one.file for one in chain.shapes if one.kind == "mesh")
    files = [(name, mesh_file(name, spec.meshes, path, folder)) for name in named]
    meshes = [{"name": name, "file": str(file)} for name, file in files if file is not None]
    visuals = [
        {"name": name, "file": str(file)}
        for name, file in carried(_visual_files(spec, chain, path, folder)).items()
    ]
    stated = {key: value for key, value in robot.items() if key != "visuals"}
    return {**stated, **({"meshes": meshes} if meshes else {}), **({"visuals": visuals} if visuals else {})}
