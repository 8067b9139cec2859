"""Writes the URDF of every robot in robots.yaml: python urdf/make_urdf.py [FOLDER].

Kinematics come from the catalogue. All link frames are parallel to the base at the controller's zero pose;
joint i turns link_i about its own axis, with the controller's sign; joint_3 is the serial angle. tool0 is
ABB's tool0 and KUKA's $FLANGE. The bodies are plain solids of our own, which hold the makers' collision
meshes (bodies.yaml, by measure_bodies.py), and are seen as they are.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from planner.catalogue import robots
from planner.cell.kinematics import link_frames
from planner.geometry.arrays import from_rpy, to_rpy

COLOURS = {
    "ABB": {"paint": (0.93, 0.40, 0.10), "dark": (0.23, 0.24, 0.26), "metal": (0.62, 0.63, 0.65)},
    "KUKA": {"paint": (0.96, 0.42, 0.02), "dark": (0.08, 0.08, 0.09), "metal": (0.62, 0.63, 0.65)},
    "generic": {"paint": (0.85, 0.86, 0.86), "dark": (0.23, 0.24, 0.26), "metal": (0.62, 0.63, 0.65)},
}


@dataclasses.dataclass(frozen=True)
class Solid:
    """A box (x, y, z) or cylinder (radius, length), at xyz in mm, with its own z axis along ``axis``."""

    kind: str
    size: tuple[float, ...]
    xyz: tuple[float, float, float]
    axis: str = "z"
    colour: str = "paint"


@functools.cache
def _measured() -> dict[str, Any]:
    return dict(yaml.safe_load(Path(__file__).with_name("bodies.yaml").read_text(encoding="utf-8")))


def bodies(robot: robots.RobotData) -> dict[str, list[Solid]]:
    """Solids by link, each in its link's upright frame (arm and forearm along +z), as bodies.yaml has them.

    An arm ``as`` another one has its bodies, stretched from the shoulder up to its elbow, and from the wrist
    back along its forearm.
    """
    rows, stretch = _measured()[robot.name], {}
    if "as" in rows:
        other = robots.robot(rows["as"]).opw
        stretch = {"link_2": (1.0, robot.opw.c2 / other.c2), "link_4": (-1.0, robot.opw.c3 / other.c3)}
        rows = _measured()[rows["as"]]
    return {
        link: [_stretched(_solid(row, i), *stretch.get(link, (1.0, 1.0))) for row in solids]
        for i, (link, solids) in enumerate(rows.items())
    }


def _solid(row: list[Any], i: int) -> Solid:
    kind, size, xyz = row
    shape, _, axis = kind.partition("_")
    return Solid(shape, tuple(size), tuple(xyz), axis or "z", ("dark", "paint", "metal")[(i > 0) + (i == 6)])


def _stretched(solid: Solid, side: float, share: float) -> Solid:
    """The solid with all of it that lies on one side of z = 0 stretched along z."""
    along = solid.axis == "z"
    if share == 1.0 or (solid.kind == "cylinder" and not along):
        high = solid.xyz[2]
        moved = high * share if side * high > 0.0 else high
        return dataclasses.replace(solid, xyz=(*solid.xyz[:2], moved))
    half = 0.5 * solid.size[-1]
    ends = [z * share if side * z > 0.0 else z for z in (solid.xyz[2] - half, solid.xyz[2] + half)]
    size = (*solid.size[:-1], ends[1] - ends[0])
    return dataclasses.replace(solid, size=size, xyz=(*solid.xyz[:2], 0.5 * (ends[0] + ends[1])))


def urdf(name: str) -> str:
    """The text of the robot's URDF."""
    robot = robots.robot(name)
    frames = link_frames(robot, np.zeros(6))
    shapes = bodies(robot)
    origin = np.vstack([np.zeros(3), frames[:6, :3, 3]])
    upright = np.concatenate([np.eye(3)[None], frames[:6, :3, :3]])
    links = ["base_link", *(f"link_{i}" for i in range(1, 7))]
    out = ['<?xml version="1.0"?>', f"<!-- {robot.title}. Written by urdf/make_urdf.py; do not edit. -->"]
    out.append(f'<robot name="{name}" xmlns:drake="http://drake.mit.edu">')
    for colour, rgb in COLOURS[robot.family].items():
        out.append(f'  <material name="{colour}"><color rgba="{_numbers(rgb)} 1"/></material>')
    for link, rotation in zip(links, upright, strict=True):
        out.append(f'  <link name="{link}">')
        out += [
            line
            for role in ("visual", "collision")
            for s in shapes[link]
            for line in _shape(role, s, rotation)
        ]
        out.append("  </link>")
    out.append('  <link name="tool0"/>')
    for i in range(6):
        axis = robot.form.signs[i] * upright[i + 1][:, "xyz".index(robot.form.axes[i])]
        low, high, speed = robot.lower[i], robot.upper[i], robot.velocity[i]
        out += [
            f'  <joint name="joint_{i + 1}" type="revolute">',
            f'    <parent link="{links[i]}"/><child link="{links[i + 1]}"/>',
            f'    <origin xyz="{_numbers(origin[i + 1] - origin[i])}" rpy="0 0 0"/>',
            f'    <axis xyz="{_numbers(axis)}"/>',
            f'    <limit lower="{low:.15g}" upper="{high:.15g}" velocity="{speed:.15g}" effort="0"/>',
            "  </joint>",
        ]
    rpy = " ".join(f"{v:.17g}" for v in to_rpy(frames[6, :3, :3]).round(15) + 0.0)
    out += [
        '  <joint name="joint_tool0" type="fixed">',
        '    <parent link="link_6"/><child link="tool0"/>',
        f'    <origin xyz="{_numbers(frames[6, :3, 3] - origin[6])}" rpy="{rpy}"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(out) + "\n"


def _shape(role: str, solid: Solid, rotation: np.ndarray) -> list[str]:
    turn = {"z": (0.0, 0.0, 0.0), "y": (np.pi / 2, 0.0, 0.0), "x": (0.0, np.pi / 2, 0.0)}[solid.axis]
    attitude = rotation @ from_rpy((0, 0, 0), turn)[:3, :3]
    xyz, rpy = _numbers(rotation @ np.array(solid.xyz) * 1e-3), _numbers(to_rpy(attitude.round(12)))
    if solid.kind == "box":
        geometry = f'<box size="{_numbers(np.array(solid.size) * 1e-3)}"/>'
    else:
        geometry = f'<cylinder radius="{solid.size[0] * 1e-3:.6g}" length="{solid.size[1] * 1e-3:.6g}"/>'
    colour = [f'      <material name="{solid.colour}"/>'] if role == "visual" else []
    return [
        f"    <{role}>",
        f'      <origin xyz="{xyz}" rpy="{rpy}"/>',
        f"      <geometry>{geometry}</geometry>",
        *colour,
        f"    </{role}>",
    ]


def _numbers(values: object) -> str:
    rounded = np.asarray(values, dtype=np.float64).round(9) + 0.0
    return " ".join(f"{v:.9g}" for v in rounded)


def main() -> None:
    """Writes all files into the folder given, by default this one."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent
    for name in robots.robot_names():
        (folder / f"{name}.urdf").write_text(urdf(name), encoding="utf-8")


if __name__ == "__main__":
    main()
