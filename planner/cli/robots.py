"""``tandem robots``: built-in robots and the sources of their values.

``tandem robots add URDF`` adds your own arm. It is checked, written as YAML lines for a cell, and drawn.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table

from planner.cli.console import plain_out as out
from planner.geometry.units import DEG, MM
from planner.issues import TandemError, issue_error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from planner.catalogue.robots import RobotData
    from planner.reading.urdf import UrdfChain, UrdfShape


@dataclasses.dataclass(frozen=True)
class AddRobot:
    """Read the URDF of an arm, check it, and write its lines for a cell, and a picture.

    What a URDF does not state is stated here or recorded as assumed. The lines go under an arm of a cell, in
    the folder for which they were written.
    """

    urdf: tyro.conf.Positional[Path]
    """the URDF; from a xacro file: xacro FILE.xacro -o FILE.urdf"""
    family: str
    """controller family: abb for RAPID, kuka for KRL, ur for URScript; generic: for ROS 2 only"""
    payload_kg: float
    """payload by the data sheet"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """the file of lines, YAML, with the picture next to it, SVG; else NAME.yaml"""
    name: str | None = None
    """name of the arm; else the URDF's name"""
    base: str = "base_link"
    """link at the arm's base"""
    tip: str | None = None
    """link that carries tools; else tool0 or flange"""
    title: str | None = None
    """displayed name"""
    controller: str | None = None
    """controller; else IRC5 or KRC4"""
    full_speed_after_s: float | None = None
    """time of every axis from rest to full speed; else assumed"""
    coupled_deg: tuple[float, float] | None = None
    """for a parallel rod: range of axis 2 + axis 3"""
    home_deg: tuple[float, ...] | None = None
    """serial joints at home; else the upper arm upright, the forearm level"""
    left_out: tuple[str, ...] = ()
    """joints outside the chain whose bodies do not count: rods"""
    meshes: Path | None = None
    """folder of meshes that are not found from the URDF"""
    source: str | None = None
    """where the URDF comes from; else shown as without a source"""


def show_robots(name: str | None) -> None:
    """Print all built-in robots, or one with its sources and assumptions.

    Raises:
        TandemError: As :func:`planner.catalogue.robots.robot`.
    """
    from planner.catalogue.robots import robot, robot_names

    names = robot_names() if name is None else (name,)
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "robot", "reach mm", "kg", "controller", "assumed"):
        table.add_column(heading, no_wrap=True)
    for robot_name in names:
        data = robot(robot_name)
        reach, payload = f"{data.reach / MM:.0f}", f"{data.payload:g}"
        table.add_row(data.name, data.title, reach, payload, data.controller, str(len(data.assumed)))
    out.print(table)
    if name is None:
        out.print("Assumed or unverified figures, and sources: tandem robots NAME")
        return
    for group, lines in (("assumed or unverified", robot(name).assumed), ("sources", robot(name).sources)):
        out.print(f"{group}:")
        for line in lines:
            out.print(f"- {line}", markup=False)


def run_add(request: AddRobot) -> None:
    """Check the URDF of an arm, print its values, and write the lines for a cell and the picture.

    Raises:
        TandemError: As :func:`planner.reading.robot_file.build_robot`, and ``problem.field`` for options.
    """
    from planner.catalogue.robots import robot_names
    from planner.files import write_atomic
    from planner.reading import strict_yaml
    from planner.reading.arm_identification import fit_arm, read_custom_chain
    from planner.reading.problem import validate
    from planner.reading.robot_file import OwnRobotFile, build_robot, read_urdf
    from planner.report import arm_picture

    text = read_urdf(request.urdf)
    name = request.name or _default_name(text)
    path = request.output or Path(f"{name}.yaml")
    if name in robot_names():
        message = f"{name!r} is a built-in robot; choose another --name"
        raise issue_error("problem.duplicate_name", message, field="name")
    _require_writable(path)
    chain = read_custom_chain(text, request.base, request.tip)
    fields = _robot_lines(request, name, chain, path.parent)
    document = strict_yaml.Document(path, fields, None, b"", file=False)
    spec, issues = validate(OwnRobotFile, fields, document, ())
    if issues:
        raise TandemError(issues)
    # by its absolute path, because the output folder may not exist yet
    robot = build_robot(spec.model_copy(update={"urdf": str(request.urdf.resolve())}), path.parent)
    _print_robot(robot, chain, fit_arm(chain).deviation)
    picture = path.with_suffix(".svg")
    try:
        write_atomic(picture, arm_picture.drawing(robot))
        write_atomic(path, _robot_yaml(fields, robot, request))
    except (OSError, ValueError) as error:
        message = f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})"
        raise issue_error("output.folder", message, hint="choose another path") from error
    out.print(f"written to {path}, for an arm of a cell in {path.parent.resolve()}; drawn in {picture}")


def _require_writable(path: Path) -> None:
    """Require that a file is new, or that this command wrote it. A user's cell is never overwritten.

    Raises:
        TandemError: ``output.folder``.
    """
    if path.suffix not in (".yaml", ".yml"):
        message = f"{path}: unsupported suffix; use .yaml"
        raise issue_error("output.folder", message, field="output")
    if path.exists() and not (path.is_file() and "\nrobot:\n" in path.read_text("utf-8", "replace")):
        message = f"{path} exists and was not written by tandem robots add; choose another name"
        raise issue_error("output.folder", message, field="output")


def _default_name(text: str) -> str:
    """Return a valid name of the arm from the name in the text of its URDF, at most 24 characters."""
    match = re.search(r"<robot[^>]*\bname\s*=\s*[\"']([^\"']*)", text)
    name = re.sub(r"\W+", "_", match[1] if match else "", flags=re.ASCII).strip("_")
    return (name if name[:1].isalpha() else f"arm_{name}")[:24].rstrip("_")


def _robot_lines(request: AddRobot, name: str, chain: UrdfChain, folder: Path) -> dict[str, Any]:
    """Return the fields of the arm for a problem file. File names are relative to ``folder``."""
    from planner.reading.dae import DAE_SUFFIX

    urdf = Path(os.path.relpath(request.urdf.resolve(), folder.resolve())).as_posix()
    fields: dict[str, Any] = {"urdf": urdf, "name": name, "base": request.base, "tip": chain.tip_link}
    fields |= {"family": request.family, "payload_kg": request.payload_kg}
    for key in ("title", "controller", "full_speed_after_s", "coupled_deg", "home_deg", "left_out"):
        value = getattr(request, key)
        if value not in (None, ()):
            fields[key] = list(value) if isinstance(value, tuple) else value
    if request.meshes is not None:
        fields["meshes"] = _mesh_files(chain.shapes, request.meshes, request.urdf)
        mesh_names = {mesh["name"] for mesh in fields["meshes"]}
        visuals = _mesh_files(chain.visuals, request.meshes, request.urdf, (DAE_SUFFIX,))
        visual_meshes = [mesh for mesh in visuals if mesh["name"] not in mesh_names]
        if visual_meshes:
            fields["visuals"] = visual_meshes
    if request.source is not None:
        fields["sources"] = {"urdf": request.source}
    return fields


def _mesh_files(
    shapes: Sequence[UrdfShape], folder: Path, urdf: Path, extra_suffixes: tuple[str, ...] = ()
) -> list[dict[str, str]]:
    """Find the files of a URDF's meshes in a folder.

    The end of a mesh's path is compared with the files, the whole path first and the name alone last. If no
    file matches a mesh in another format than the usual ones (such as DAE), a converted file with one of
    their suffixes may match. Meshes with several matches are left out.

    Args:
        shapes: Shapes of the URDF.
        folder: Folder that is searched, with its subfolders.
        urdf: The URDF. Paths of the result are relative to its folder.
        extra_suffixes: Suffixes that can be read in addition to the usual ones.

    Returns:
        ``name`` of each mesh in the URDF, and path of its ``file``.
    """
    from planner.geometry.mesh_files import PLAIN_SUFFIXES

    files = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in (*PLAIN_SUFFIXES, *extra_suffixes)
    ]
    plain_files = [path for path in files if path.suffix.lower() in PLAIN_SUFFIXES]
    entries = []
    for name in dict.fromkeys(shape.file for shape in shapes if shape.kind == "mesh"):
        mesh_path = Path(name.partition("://")[2] or name)
        suffix = mesh_path.suffix.lower()
        matches = _match_path_end(mesh_path, files) if suffix in (*PLAIN_SUFFIXES, *extra_suffixes) else []
        if not matches and suffix not in PLAIN_SUFFIXES:
            stems = _match_path_end(mesh_path.with_suffix(""), [path.with_suffix("") for path in plain_files])
            matches = [path for path in plain_files if path.with_suffix("") in stems]
        if len(matches) == 1:
            relative_path = os.path.relpath(matches[0].resolve(), urdf.resolve().parent)
            entries.append({"name": name, "file": Path(relative_path).as_posix()})
    return entries


def _match_path_end(requested_path: Path, candidates: Sequence[Path]) -> list[Path]:
    """Return the candidates that share the longest end of their path with the requested path, if any."""
    for count in range(len(requested_path.parts), 0, -1):
        matches = [path for path in candidates if path.parts[-count:] == requested_path.parts[-count:]]
        if matches:
            return matches
    return []


def _robot_yaml(fields: dict[str, Any], robot: RobotData, request: AddRobot) -> str:
    """Return the fields of the arm as YAML, with assumptions and default values as comments."""
    from planner.reading.robot_file import DEFAULT_FULL_SPEED_TIME_S, home_description

    home = ", ".join(f"{angle:g}" for angle in (robot.home / DEG).round(6) + 0.0)
    defaults_by_key = {
        "full_speed_after_s": f"{DEFAULT_FULL_SPEED_TIME_S:g}  # of every axis from rest, as the largest "
        "built in",
        "home_deg": f"[{home}]  # serial joints: {home_description(robot.form)}",
        "coupled_deg": "null  # of a parallel rod: the range of axis 2 + axis 3",
    }
    body = [f"  {key}: {json.dumps(value, ensure_ascii=False)}" for key, value in fields.items()]
    defaults = [f"  # {key}: {value}; assumed" for key, value in defaults_by_key.items() if key not in fields]
    assumptions = [f"# {line}" for line in robot.assumed]
    head = [f"# {robot.title}, from {request.urdf.name}, for an arm of a cell. Without a source, or assumed:"]
    return "\n".join([*head, *assumptions, "robot:", *body, *defaults, ""])


def _print_robot(robot: RobotData, chain: UrdfChain, deviation: tuple[float, float]) -> None:
    """Print axes, dimensions and assumptions of an arm.

    Args:
        robot: Arm.
        chain: Chain of joints in the URDF.
        deviation: Largest distance [m] and angle [rad] between the closed form and the URDF.
    """
    table = Table("axis", "joint", "from deg", "to deg", "deg/s", "bodies")
    shapes = robot.file.shapes if robot.file is not None else ()
    for index, joint in enumerate(chain.joints):
        low, high, speed = (
            f"{values[index] / DEG:.6g}" for values in (robot.lower, robot.upper, robot.velocity)
        )
        bodies = ", ".join(
            sorted("hull" if shape.kind == "mesh" else shape.kind for shape in shapes[index + 1])
        )
        table.add_row(str(index + 1), joint, low, high, speed, bodies)
    out.print(table)
    dimensions = vars(robot.form).items()
    lengths = ", ".join(f"{key} {value / MM:.7g}" for key, value in dimensions if isinstance(value, float))
    count = "seven axes, the last one free," if robot.axes == 7 else "six axes"
    out.print(f"{count} in closed form: {lengths} mm; it reaches {robot.reach / MM:.0f} mm")
    out.print(
        f"deviates from the URDF by at most {deviation[0] / MM:.2g} mm and {deviation[1]:.2g} rad in 1000 "
        "postures"
    )
    out.print("without a source, or assumed:")
    for line in robot.assumed:
        out.print(f"- {line}", markup=False)
    missing_visuals = robot.file.unseen if robot.file is not None else ()
    if missing_visuals:
        out.print("shown by collision bodies, because the visuals of the URDF cannot be read:")
    for line in missing_visuals:
        out.print(f"- {line}", markup=False)
