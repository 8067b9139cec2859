"""Custom robots: a URDF and a few keys in the problem file.

The geometry follows from the axes of the URDF (:mod:`planner.reading.arm_identification`). What a URDF does
not state is stated with its source, or assumed and reported as such. Collision shapes are those of the URDF,
meshes by their convex hulls; none is left out silently. Visuals are those of the URDF
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
from planner.issues import Issue, TandemError, issue_error
from planner.reading.link_visuals import link_visuals, visual_meshes_to_bundle
from planner.reading.strict_yaml import Angle, FileName, Name, Strict
from planner.reading.urdf import MAX_URDF_BYTES, UrdfChain, UrdfShape, read_chain

if TYPE_CHECKING:
    from planner.reading.arm_identification import ArmFit

DEFAULT_FULL_SPEED_TIME_S: Final = 0.4
"""Default time [s] from rest to full speed of every axis: that of the largest robots of the catalogue."""
HOME_TILT_RAD: Final = 15.0 * DEG
"""Default tilt [rad] of the upper arm at home, for an arm with seven axes."""
FAMILIES: Final[Mapping[str, tuple[Family, str]]] = {
    "abb": ("ABB", "IRC5"),
    "kuka": ("KUKA", "KRC4"),
    "ur": ("UR", "e-Series"),
    "generic": ("generic", "not stated"),
}
"""Families of controllers, with the default controller."""


Posture = Annotated[tuple[Angle, ...], Field(min_length=6, max_length=7)]
"""Joint values of an arm, one angle for each of its axes."""


class LinkMeshFile(Strict):
    """Location of a mesh of a URDF."""

    name: FileName = Field(description="as the URDF names it")
    file: FileName


class OwnRobotFile(Strict):
    """A custom robot: its URDF, and what a URDF does not state."""

    urdf: FileName
    name: Name = Field(description="name; not that of a built-in robot")
    title: str | None = Field(default=None, max_length=100, description="none: its name")
    base: str = Field(default="base_link", description="link at the arm's `base`")
    tip: str | None = Field(default=None, description="link that carries tools; none: `tool0`, else `flange`")
    family: Literal["abb", "kuka", "ur", "generic"] = Field(
        description="of its controller: RAPID, KRL or URScript; `generic`: ROS 2 trajectories only"
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
        default=(), description="joints outside the chain whose bodies are ignored: rods"
    )
    meshes: tuple[LinkMeshFile, ...] = Field(
        default=(), description="locations of meshes that are not found from the URDF"
    )
    visuals: tuple[LinkMeshFile, ...] = Field(
        default=(), description="locations of meshes of <visual>, which are only displayed"
    )
    sources: dict[str, str] = Field(
        default_factory=dict, description="sources of values, by key: urdf, payload_kg ..."
    )


_SOURCED_KEYS: Final = ("payload_kg", "coupled_deg", "home_deg", "full_speed_after_s")
"""Keys whose values have a source, or are reported as assumed."""


def build_robot(spec: OwnRobotFile, folder: Path) -> RobotData:
    """Build the data of a custom robot from its URDF and the keys of the problem file.

    Args:
        spec: Keys of the robot in the problem file.
        folder: Folder to which file names are relative.

    Raises:
        TandemError: As :func:`planner.reading.arm_identification.read_custom_chain` and
            :func:`planner.reading.arm_identification.fit_arm`; ``robot.bodies`` for unknown collision shapes;
            ``problem.field`` for contradictory keys.
    """
    # lazy: loads kinematics, which other problems do not need
    from planner.reading.arm_identification import fit_arm, read_custom_chain

    path = folder / spec.urdf
    text = read_urdf(path)
    chain = read_custom_chain(text, spec.base, spec.tip)
    arm_fit = fit_arm(chain)
    issues = [*_key_faults(spec, chain, arm_fit.form)]
    if spec.home_deg is not None and (fault := posture_fault(spec.home_deg, arm_fit.form.count)):
        issues.append(Issue("problem.field", f"home_deg: {fault}", field="home_deg"))
    shapes = _collision_shapes(spec, chain, path, folder, issues)
    if issues:
        raise TandemError(issues)
    visuals, missing_visuals = link_visuals(chain, shapes, _visual_files(spec, chain, path, folder))
    coupling = None if spec.coupled_deg is None else RodCoupling(*(v * DEG for v in spec.coupled_deg))
    full_speed_time = spec.full_speed_after_s or DEFAULT_FULL_SPEED_TIME_S
    family, controller = FAMILIES[spec.family]
    form = arm_fit.form
    home = _default_home(form, chain) if spec.home_deg is None else np.array(spec.home_deg) * DEG
    data = RobotData(
        name=spec.name,
        title=spec.title or spec.name,
        family=family,
        controller=spec.controller or controller,
        form=form,
        lower=chain.lower,
        upper=chain.upper,
        velocity=chain.velocity,
        acceleration=chain.velocity / full_speed_time,
        payload=spec.payload_kg,
        reach=float(np.hypot(form.stretched, form.b)),
        coupling=coupling,
        home=home,
        sources=tuple(f"{key}: {source}" for key, source in sorted(spec.sources.items())),
        assumed=tuple(_assumptions(spec, chain, arm_fit)),
        file=RobotFile(
            text,
            spec.base,
            chain.tip_link,
            chain.zero,
            chain.axis,
            shapes,
            chain.joints,
            visuals,
            missing_visuals,
        ),
    )
    read_only(data)
    if not float(data.limit_margin(home)) >= 0.0:
        home_text = ", ".join(f"{v:g}" for v in np.round(home / DEG, 3))
        message = f"home_deg: [{home_text}] is beyond the limits of the URDF or of coupled_deg; correct them"
        raise issue_error("problem.field", message, field="home_deg")
    return data


def posture_fault(joints: Sequence[float], axes: int) -> str | None:
    """Return the fault of a posture with a wrong number of joints, for an arm with ``axes`` axes, or None."""
    if len(joints) == axes:
        return None
    return f"got {len(joints)} angles, the robot has {axes} axes; state one angle for each"


def read_urdf(path: Path) -> str:
    """Read the text of a file.

    Raises:
        TandemError: ``problem.missing_file``; ``problem.too_large``; ``robot.urdf`` if it is not UTF-8.
    """
    if not is_file(path):
        message = f"no file {path}; check the path"
        raise issue_error("problem.missing_file", message, field="urdf")
    size = path.stat().st_size
    if size > MAX_URDF_BYTES:
        message = f"{size / 1e6:.0f} MB, allowed {MAX_URDF_BYTES / 1e6:.0f} MB"
        raise issue_error("problem.too_large", message, field="urdf", hint="give the URDF of one arm")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        message = f"the file is not UTF-8 ({error})"
        raise issue_error("robot.urdf", message, field="urdf", hint="save it as UTF-8") from None


def _key_faults(spec: OwnRobotFile, chain: UrdfChain, form: ArmForm) -> Iterator[Issue]:
    """Yield faults of keys that contradict the URDF or each other."""
    supported_forms = {"abb": OpwParameters | OffsetParameters, "kuka": OpwParameters}
    if spec.family in supported_forms and not isinstance(form, supported_forms[spec.family]):
        text = f"family: got {spec.family}, whose programs require arms with a spherical wrist; this "
        text += (
            "arm has none; write generic"
            if isinstance(form, SevenParameters)
            else "arm has none; write ur or generic"
        )
        yield Issue("problem.field", text, field="family")
    if spec.family == "ur" and isinstance(form, SevenParameters):
        text = "family: got ur, whose arms have six axes; this one has seven: write generic"
        yield Issue("problem.field", text, field="family")
    if spec.coupled_deg is not None and isinstance(form, OffsetParameters | SevenParameters):
        kind = "an offset wrist" if isinstance(form, OffsetParameters) else "seven axes"
        text = f"coupled_deg: no arm with {kind} has a parallel rod; remove it"
        yield Issue("problem.field", text, field="coupled_deg")
    other_joints = [name for name in chain.other_joints if name not in spec.left_out]
    if other_joints:
        names = ", ".join(repr(name) for name in other_joints)
        text = (
            f"{len(other_joints)} moving joints are not on the chain from {spec.base!r} to the tip: {names}"
        )
        hint = "make them fixed, name the base of this arm alone, or list rods and pistons under left_out"
        yield Issue("robot.chain", text, field="urdf", hint=hint)
    if spec.coupled_deg is not None:
        low, high = spec.coupled_deg
        sums = (chain.lower[1:3].sum() / DEG, chain.upper[1:3].sum() / DEG)
        if not (low < high and low < sums[1] and high > sums[0]):
            text = f"coupled_deg: got {low:g} to {high:g}, but the limits of axes 2 and 3 give a sum within "
            text += f"{sums[0]:g} to {sums[1]:g} deg; correct one of them"
            yield Issue("problem.field", text, field="coupled_deg")
    for key in sorted(set(spec.sources) - set(OwnRobotFile.model_fields)):
        yield Issue("problem.field", f"sources: {key!r} is not a key of a robot; correct it", field="sources")


def _assumptions(spec: OwnRobotFile, chain: UrdfChain, arm_fit: ArmFit) -> Iterator[str]:
    """Yield what is assumed about a robot, or stated without a source, in words."""
    if spec.full_speed_after_s is None:
        yield (
            f"acceleration: assumed, every axis reaches its full speed in {DEFAULT_FULL_SPEED_TIME_S:g} s "
            "from rest"
        )
    for key in _SOURCED_KEYS:
        if getattr(spec, key) is not None and key not in spec.sources:
            yield f"{key}: stated without a source"
    if "urdf" not in spec.sources:
        yield "dimensions, limits and speeds: of a URDF without a source"
    if spec.coupled_deg is None:
        yield "coupling: assumed, none"
    if spec.home_deg is None:
        yield f"home: assumed, {home_description(arm_fit.form)}"
    if max(arm_fit.snapped) > 1e-9:
        deviation = f"{arm_fit.snapped[0] / MM:.2g} mm, {arm_fit.snapped[1]:.2g} rad at the tip"
        yield f"angles of the URDF: rounded to close multiples of 15 deg, at most {deviation}"
    for name in chain.other_joints:
        yield f"bodies: those moved by the joint {name} are ignored"
    yield from chain.notes


def home_description(form: ArmForm) -> str:
    """Return a description of the default home posture."""
    if isinstance(form, SevenParameters):
        return (
            f"the upper arm tilted by {HOME_TILT_RAD / DEG:g} deg, the elbow at a right angle and the flange "
            "down"
        )
    return "the upper arm upright and the forearm level"


def _default_home(form: ArmForm, chain: UrdfChain) -> FloatArray:
    """Return the default home posture (J,) [rad], clipped to the limits.

    The upper arm is upright, the forearm level and all other joints are at zero; without a spherical wrist
    the flange points down. With seven axes, the upper arm is tilted by :data:`HOME_TILT_RAD` from the posture
    in which axes 1 and 3 are collinear.
    """
    if isinstance(form, SevenParameters):
        theta = (0.0, HOME_TILT_RAD, 0.0, 0.5 * np.pi, 0.0, 0.5 * np.pi - HOME_TILT_RAD, 0.0)
        joint_values = form.signs * (np.array(theta) + form.offsets)
        q = np.arctan2(np.sin(joint_values), np.cos(joint_values)) + 0.0
        q[-1] = 0.5 * (chain.lower[-1] + chain.upper[-1])
        return np.clip(q, chain.lower, chain.upper)
    q = np.zeros(form.count)
    wrist_angles: tuple[tuple[int, float], ...] = ((3, 0.0), (4, -0.5 * np.pi))
    if isinstance(form, OpwParameters):
        wrist_angles = ()
    if isinstance(form, OffsetParameters):
        wrist_angles = ((3, 0.0), (4, 0.5 * np.pi))
    for axis, form_angle in ((1, 0.0), (2, 0.5 * np.pi), *wrist_angles):
        angle = form.signs[axis] * (form_angle + form.offsets[axis])
        q[axis] = np.arctan2(np.sin(angle), np.cos(angle)) + 0.0
    return np.clip(q, chain.lower, chain.upper)


def _collision_shapes(
    spec: OwnRobotFile, chain: UrdfChain, path: Path, folder: Path, issues: list[Issue]
) -> tuple[tuple[Shape, ...], ...]:
    """Return the collision shapes of the base and of each link; append faults to ``issues``."""
    shapes_by_link: dict[str, list[Shape]] = {link: [] for link in chain.links}
    missing_files, unsupported_files = [], []
    for shape in chain.shapes:
        if shape.kind != "mesh":
            shapes_by_link[shape.link].append(Shape(shape.kind, shape.size, shape.pose))  # type: ignore[arg-type]
            continue
        file = find_mesh_file(shape.file, spec.meshes, path, folder)
        if file is None:
            missing_files.append(shape.file)
        elif file.suffix.lower() not in PLAIN_SUFFIXES:
            unsupported_files.append(shape.file)
        else:
            shapes_by_link[shape.link].append(_hull(shape, file))
    if missing_files:
        text = (
            f"{len(missing_files)} meshes of the URDF are missing: "
            f"{', '.join(sorted(set(missing_files))[:7])}"
        )
        hint = "put them next to the URDF as in its package, or state their locations under meshes; "
        hint += "tandem robots add URDF --meshes FOLDER writes them"
        issues.append(Issue("robot.bodies", text, field="urdf", hint=hint))
    if unsupported_files:
        text = (
            f"{len(unsupported_files)} meshes of the URDF are not OBJ, STL or PLY: "
            f"{', '.join(sorted(set(unsupported_files))[:7])}"
        )
        hint = "convert them, in metres, and state under meshes the file for each, as "
        hint += "tandem robots add URDF --meshes FOLDER writes it"
        issues.append(Issue("robot.bodies", text, field="urdf", hint=hint))
    bare_links = [link for link in chain.links if not shapes_by_link[link]]
    if bare_links and not missing_files and not unsupported_files:
        text = f"the links {', '.join(bare_links)} have no <collision> geometry, so they cannot be checked"
        hint = "give each one a <collision>: a box, cylinder, sphere or mesh"
        issues.append(Issue("robot.bodies", text, field="urdf", hint=hint))
    return tuple(tuple(shapes) for shapes in shapes_by_link.values())


def _hull(shape: UrdfShape, file: Path) -> Shape:
    """Return the convex hull of a mesh, whose file is in metres times the scale of the URDF."""
    max_scale = max(abs(v) for v in shape.size)
    vertices = read_mesh(file, 1.0, max_scale).vertices * (np.array(shape.size) / max_scale)
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        message = f"the mesh {shape.file} is flat and encloses no volume"
        raise issue_error(
            "robot.bodies", message, field="urdf", hint="export it as a solid, or state a box"
        ) from None
    points = vertices[hull.vertices]
    faces = np.searchsorted(hull.vertices, hull.simplices)
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normal * hull.equations[:, :3], axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return Shape("mesh", (), shape.pose, points, faces.astype(np.int64))


def _visual_files(spec: OwnRobotFile, chain: UrdfChain, urdf: Path, folder: Path) -> dict[str, Path | None]:
    """Return the files of visual meshes by name; None for missing ones."""
    names = dict.fromkeys(
        visual.file for visual in chain.visuals if visual.kind == "mesh" and len(visual.file) <= 1000
    )
    return {name: find_mesh_file(name, (*spec.visuals, *spec.meshes), urdf, folder) for name in names}


def find_mesh_file(name: str, stated: Sequence[LinkMeshFile], urdf: Path, folder: Path) -> Path | None:
    """Return the file of a mesh, or None if it is not found.

    A stated file has priority. Otherwise the mesh is looked up next to the URDF or in its package. Stated
    names are relative to the folder of the URDF or to ``folder``; they may have been made absolute from
    ``folder``.

    Args:
        name: Name in the URDF.
        stated: Stated locations.
        urdf: URDF file.
        folder: Folder of the file that states the locations.
    """
    for location in stated:
        if location.name == name:
            stated_file = Path(location.file)
            candidates = [urdf.parent / stated_file, folder / stated_file]
            if stated_file.is_relative_to(folder):
                candidates[1:] = [
                    urdf.parent / stated_file.relative_to(folder),
                    folder / stated_file,
                    stated_file,
                ]
            return next((path for path in candidates if is_file(path)), None)
    relative = Path(name.partition("://")[2] or name)
    if relative.is_absolute() or ".." in relative.parts or not relative.parts:
        return None
    is_package = name.startswith("package://")
    for root in (urdf.parent, *urdf.parent.parents) if is_package else (urdf.parent,):
        inside = root.joinpath(*relative.parts[1:]) if is_package and root.name == relative.parts[0] else None
        for file in (root / relative, inside):
            if file is not None and is_file(file):
                return file
    return None


def with_meshes(robot: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the keys of a robot with absolute file names and with all meshes of the URDF named.

    Of visual meshes only those that can be bundled are named. An invalid robot is returned unchanged, because
    its reader reports the faults.

    Args:
        robot: Keys of the robot in the problem.
        folder: Folder to which file names are relative.
    """
    try:
        spec = OwnRobotFile.model_validate(dict(robot))
    except ValidationError:
        return dict(robot)
    path = Path(spec.urdf)
    chain = read_chain(read_urdf(path), spec.base, spec.tip)
    names = dict.fromkeys(shape.file for shape in chain.shapes if shape.kind == "mesh")
    files = [(name, find_mesh_file(name, spec.meshes, path, folder)) for name in names]
    meshes = [{"name": name, "file": str(file)} for name, file in files if file is not None]
    visuals = [
        {"name": name, "file": str(file)}
        for name, file in visual_meshes_to_bundle(_visual_files(spec, chain, path, folder)).items()
    ]
    other_keys = {key: value for key, value in robot.items() if key != "visuals"}
    return {
        **other_keys,
        **({"meshes": meshes} if meshes else {}),
        **({"visuals": visuals} if visuals else {}),
    }
