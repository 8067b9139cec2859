"""``tandem robots``: what is built in, and where its figures come from; ``tandem robots add URDF``: an arm of
one's own, checked, as the lines that a cell has of it, and drawn."""

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
from planner.issues import TandemError, refusal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from planner.catalogue.robots import RobotData
    from planner.reading.urdf import UrdfChain, UrdfShape


@dataclasses.dataclass(frozen=True)
class Add:
    """Read the URDF of an arm, check it, and write the lines that a cell has of it, and a picture.

    What a URDF does not say is stated here or written down as assumed. The lines go under an arm of a
    cell, in the folder for which they were written.
    """

    urdf: tyro.conf.Positional[Path]
    """the URDF; of a xacro: xacro FILE.xacro -o FILE.urdf"""
    family: str
    """of its controller: abb for RAPID, kuka for KRL, ur for URScript; generic: for ROS 2 alone"""
    payload_kg: float
    """what the arm may carry, by the data sheet"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """the file of lines, YAML; the picture lies beside it, SVG; else NAME.yaml"""
    name: str | None = None
    """what the arm is called; else the URDF's name"""
    base: str = "base_link"
    """link that stands where the arm's base is"""
    tip: str | None = None
    """link that tools are on; else tool0 or flange"""
    title: str | None = None
    """its name for people"""
    controller: str | None = None
    """else IRC5 or KRC4"""
    full_speed_after_s: float | None = None
    """time of every axis from rest to full speed; else assumed"""
    coupled_deg: tuple[float, float] | None = None
    """of a parallel rod: range of axis 2 + axis 3"""
    home_deg: tuple[float, ...] | None = None
    """serial joints at home; else the upper arm upright, the forearm level"""
    left_out: tuple[str, ...] = ()
    """joints beside the chain whose bodies do not count: rods"""
    meshes: Path | None = None
    """folder where meshes lie that are not found from the URDF"""
    source: str | None = None
    """where the URDF comes from; else shown as without a source"""


def show(name: str | None) -> None:
    """Print all robots that are built in, or one with its sources and what is assumed of it. Raises
    `TandemError` as :func:`planner.catalogue.robots.robot`."""
    from planner.catalogue.robots import robot, robot_names

    names = robot_names() if name is None else (name,)
    table = Table(box=None, pad_edge=False)
    for head in ("name", "robot", "reach mm", "kg", "controller", "assumed"):
        table.add_column(head, no_wrap=True)
    for one in names:
        data = robot(one)
        reach, payload = f"{data.reach / MM:.0f}", f"{data.payload:g}"
        table.add_row(data.name, data.title, reach, payload, data.controller, str(len(data.assumed)))
    out.print(table)
    if name is None:
        out.print("What is assumed or unverified, and the sources: tandem robots NAME")
        return
    for word, lines in (("assumed or unverified", robot(name).assumed), ("sources", robot(name).sources)):
        out.print(f"{word}:")
        for line in lines:
            out.print(f"- {line}", markup=False)


def run_add(request: Add) -> None:
    """Check, print, and write lines and picture. Raises `TandemError` as
    :func:`planner.reading.robot_file.robot_of`, and ``problem.field`` for options."""
    from planner.catalogue.robots import robot_names
    from planner.files import write_whole
    from planner.reading import strict_yaml
    from planner.reading.opw import fit, own_chain
    from planner.reading.problem import validate
    from planner.reading.robot_file import OwnRobotFile, read_urdf, robot_of
    from planner.report import arm_picture

    text = read_urdf(request.urdf)
    name = request.name or _name(text)
    path = request.output or Path(f"{name}.yaml")
    if name in robot_names():
        what = f"{name!r} is a robot that is built in; give --name another one"
        raise refusal("problem.duplicate_name", what, field="name")
    _require_own(path)
    chain = own_chain(text, request.base, request.tip)
    lines = _stated(request, name, chain, path.parent)
    document = strict_yaml.Document(path, lines, None, b"", file=False)
    spec, issues = validate(OwnRobotFile, lines, document, ())
    if issues:
        raise TandemError(issues)
    # by its place, for the folder that is written to may not be there yet
    robot = robot_of(spec.model_copy(update={"urdf": str(request.urdf.resolve())}), path.parent)
    _print(robot, chain, fit(chain).off)
    picture = path.with_suffix(".svg")
    try:
        write_whole(picture, arm_picture.drawing(robot))
        write_whole(path, _written(lines, robot, request))
    except (OSError, ValueError) as error:
        what = f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})"
        raise refusal("output.folder", what, hint="choose a place of your own") from error
    out.print(f"written to {path}, for an arm of a cell in {path.parent.resolve()}; drawn in {picture}")


def _require_own(path: Path) -> None:
    """See that a file is new, or lines of an arm, which may be written anew: somebody's cell may not."""
    if path.suffix not in (".yaml", ".yml"):
        what = f"{path}: the lines are YAML; give a name that ends with .yaml"
        raise refusal("output.folder", what, field="output")
    if path.exists() and not (path.is_file() and "\nrobot:\n" in path.read_text("utf-8", "replace")):
        what = f"{path} is there, and is no file of tandem robots add; choose another name"
        raise refusal("output.folder", what, field="output")


def _name(text: str) -> str:
    found = re.search(r"<robot[^>]*\bname\s*=\s*[\"']([^\"']*)", text)
    plain = re.sub(r"\W+", "_", found[1] if found else "", flags=re.ASCII).strip("_")
    return (plain if plain[:1].isalpha() else f"arm_{plain}")[:24].rstrip("_")


def _stated(request: Add, name: str, chain: UrdfChain, folder: Path) -> dict[str, Any]:
    """The lines of the arm, as a problem has them; names of files start at ``folder``."""
    from planner.reading.dae import DAE_SUFFIX

    urdf = Path(os.path.relpath(request.urdf.resolve(), folder.resolve())).as_posix()
    lines: dict[str, Any] = {"urdf": urdf, "name": name, "base": request.base, "tip": chain.tip_link}
    lines |= {"family": request.family, "payload_kg": request.payload_kg}
    for key in ("title", "controller", "full_speed_after_s", "coupled_deg", "home_deg", "left_out"):
        value = getattr(request, key)
        if value not in (None, ()):
            lines[key] = list(value) if isinstance(value, tuple) else value
    if request.meshes is not None:
        lines["meshes"] = _meshes(chain.shapes, request.meshes, request.urdf)
        there = {one["name"] for one in lines["meshes"]}
        seen = _meshes(chain.visuals, request.meshes, request.urdf, (DAE_SUFFIX,))
        lines |= {"visuals": own} if (own := [one for one in seen if one["name"] not in there]) else {}
    if request.source is not None:
        lines["sources"] = {"urdf": request.source}
    return lines


def _meshes(
    shapes: Sequence[UrdfShape], folder: Path, urdf: Path, more: tuple[str, ...] = ()
) -> list[dict[str, str]]:
    """Where meshes of the URDF lie in a folder, each by as much of its path as is there, else by its name;
    for one that is not read (DAE of a collision), or is not there, what was converted, of the same name but
    for its ending. ``more``: endings that are read besides."""
    from planner.geometry.mesh_files import PLAIN_SUFFIXES

    there = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() in (*PLAIN_SUFFIXES, *more)]
    plain = [path for path in there if path.suffix.lower() in PLAIN_SUFFIXES]
    out = []
    for name in dict.fromkeys(one.file for one in shapes if one.kind == "mesh"):
        wanted = Path(name.partition("://")[2] or name)
        suffix = wanted.suffix.lower()
        found = _ends(wanted, there) if suffix in (*PLAIN_SUFFIXES, *more) else []
        if not found and suffix not in PLAIN_SUFFIXES:
            stems = _ends(wanted.with_suffix(""), [path.with_suffix("") for path in plain])
            found = [path for path in plain if path.with_suffix("") in stems]
        if len(found) == 1:
            beside = os.path.relpath(found[0].resolve(), urdf.resolve().parent)
            out.append({"name": name, "file": Path(beside).as_posix()})
    return out


def _ends(wanted: Path, there: Sequence[Path]) -> list[Path]:
    for count in range(len(wanted.parts), 0, -1):
        found = [path for path in there if path.parts[-count:] == wanted.parts[-count:]]
        if found:
            return found
    return []


def _written(lines: dict[str, Any], robot: RobotData, request: Add) -> str:
    """The lines as YAML, and as comments what was assumed."""
    from planner.reading.robot_file import FULL_SPEED_AFTER, home_words

    home = ", ".join(f"{v:g}" for v in (robot.home / DEG).round(6) + 0.0)
    usual = {
        "full_speed_after_s": f"{FULL_SPEED_AFTER:g}  # of every axis from rest, as the largest built in",
        "home_deg": f"[{home}]  # serial joints: {home_words(robot.form)}",
        "coupled_deg": "null  # of a parallel rod: the range of axis 2 + axis 3",
    }
    body = [f"  {key}: {json.dumps(value, ensure_ascii=False)}" for key, value in lines.items()]
    left = [f"  # {key}: {value}; assumed" for key, value in usual.items() if key not in lines]
    told = [f"# {line}" for line in robot.assumed]
    head = [f"# {robot.title}, from {request.urdf.name}, for an arm of a cell. Without a source, or assumed:"]
    return "\n".join([*head, *told, "robot:", *body, *left, ""])


def _print(robot: RobotData, chain: UrdfChain, off: tuple[float, float]) -> None:
    table = Table("axis", "joint", "from deg", "to deg", "deg/s", "bodies")
    shapes = robot.file.shapes if robot.file is not None else ()
    for i, joint in enumerate(chain.joints):
        low, high, speed = (f"{v[i] / DEG:.6g}" for v in (robot.lower, robot.upper, robot.velocity))
        bodies = ", ".join(sorted("hull" if one.kind == "mesh" else one.kind for one in shapes[i + 1]))
        table.add_row(str(i + 1), joint, low, high, speed, bodies)
    out.print(table)
    figures = vars(robot.form).items()
    lengths = ", ".join(f"{key} {v / MM:.7g}" for key, v in figures if isinstance(v, float))
    count = "seven axes, the last one free," if robot.axes == 7 else "six axes"
    out.print(f"{count} in closed form: {lengths} mm; it reaches {robot.reach / MM:.0f} mm")
    out.print(f"at most {off[0] / MM:.2g} mm and {off[1]:.2g} rad beside the URDF on 1000 postures")
    out.print("without a source, or assumed:")
    for line in robot.assumed:
        out.print(f"- {line}", markup=False)
    unseen = robot.file.unseen if robot.file is not None else ()
    if unseen:
        out.print("shown by bodies for collision, for what the URDF has to be seen cannot be read:")
    for line in unseen:
        out.print(f"- {line}", markup=False)
