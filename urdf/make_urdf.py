"""Writes the URDF of every robot in robots.yaml: python urdf/make_urdf.py [FOLDER].

Kinematics come from the catalogue. All link frames are parallel to the base at the controller's zero pose;
joint i turns link_i about its own axis, with the controller's sign; joint_3 is the serial angle. tool0 is
ABB's tool0 and KUKA's $FLANGE. The bodies are our own, plain solids. Those of BUILDS are sized by eye from
pictures and from the data sheets' outer dimensions, not from the makers' meshes; their collision solids
contain the visible ones up to a few millimetres at bolts and edges. Those of bodies.yaml hold the makers'
collision meshes (measure_bodies.py), and are seen as they are.
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
}


@dataclasses.dataclass(frozen=True)
class Build:
    """Outer sizes in mm: foot length, width and height; radii, and widths along the pitch axes."""

    foot: tuple[float, float, float]
    column: float
    shoulder: tuple[float, float]
    arm: tuple[float, float]
    elbow: tuple[float, float]
    back: float
    forearm: float
    wrist: tuple[float, float]
    flange: float
    balancer: float = 0.0


BUILDS = {
    "irb140": Build((400, 300, 165), 122, (92, 230), (130, 112), (82, 196), 118, 62, (46, 86), 32),
    "irb1200_7_70": Build((230, 210, 150), 98, (86, 196), (128, 104), (72, 164), 88, 54, (42, 80), 32),
    "irb4400_60": Build((920, 640, 300), 310, (190, 540), (230, 200), (165, 390), 380, 112, (92, 168), 70),
    "irb4600_40": Build((680, 512, 200), 232, (165, 420), (216, 170), (145, 330), 320, 95, (72, 138), 63),
    "irb6640_185": Build(
        (1100, 720, 280), 360, (230, 620), (300, 230), (210, 460), 430, 150, (112, 214), 100, 85
    ),
    "kr60_ha": Build((850, 650, 330), 320, (190, 520), (240, 205), (170, 410), 390, 115, (88, 172), 63),
    "kr10_r1100": Build((210, 208, 185), 100, (86, 220), (126, 100), (70, 176), 112, 52, (44, 86), 32),
}


@dataclasses.dataclass(frozen=True)
class Solid:
    """A box (x, y, z), cylinder or capsule (radius, length), at xyz in mm, with its own z axis along
    ``axis``."""

    kind: str
    size: tuple[float, ...]
    xyz: tuple[float, float, float]
    axis: str = "z"
    colour: str = "paint"

    def moved(self, x: float, y: float, z: float) -> Solid:
        """The solid displaced by x, y, z [mm]."""
        here = self.xyz
        return dataclasses.replace(self, xyz=(here[0] + x, here[1] + y, here[2] + z))


Bodies = dict[str, tuple[list[Solid], list[Solid]]]


def bodies(robot: robots.RobotData, build: Build) -> Bodies:
    """Visible and collision solids by link, each in its link's upright frame (arm and forearm along +z)."""
    p = robot.opw
    a1, a2, b, c1, c2, c3, c4 = (1e3 * v for v in (p.a1, p.a2, p.b, p.c1, p.c2, p.c3, p.c4))
    out: Bodies = {}
    out["base_link"] = _base(build)
    seen, solid = _shoulder(build, a1, b, c1)
    out["link_1"] = ([s.moved(a1, b, c1) for s in seen], [s.moved(a1, b, c1) for s in solid])
    out["link_2"] = _upper_arm(build, c2)
    split = 0.42 * c3
    out["link_3"] = _elbow(build, a2, split)
    out["link_4"] = _forearm(build, c3 - split)
    radius, width = build.wrist
    thick = max(6.0, 0.09 * c4)
    reach = c4 - thick
    out["link_5"] = (
        [
            Solid("cylinder", (radius * 0.94, width * 0.62), (0, 0, 0), "y"),
            Solid("cylinder", (radius * 0.80, reach), (0, 0, reach / 2), "z"),
            Solid("cylinder", (radius * 0.60, width * 0.70), (0, 0, 0), "y", "dark"),
        ],
        [Solid("capsule", (radius, reach - 0.45 * radius), (0, 0, 0.5 * (reach - 0.45 * radius)))],
    )
    disc = (build.flange, thick)
    out["link_6"] = (
        [
            Solid("cylinder", disc, (0, 0, c4 - thick / 2), "z", "metal"),
            Solid("cylinder", (build.flange * 0.5, thick + 0.4), (0, 0, c4 - thick / 2), "z", "dark"),
        ],
        [Solid("cylinder", disc, (0, 0, c4 - thick / 2))],
    )
    return out


@functools.cache
def _measured() -> dict[str, Any]:
    return dict(yaml.safe_load(Path(__file__).with_name("bodies.yaml").read_text(encoding="utf-8")))


def measured(robot: robots.RobotData) -> Bodies:
    """The same solids by link, visible and for collision, as bodies.yaml has them.

    An arm ``as`` another one has its bodies, stretched from the shoulder up to its elbow, and from the wrist
    back along its forearm.
    """
    rows, stretch = _measured()[robot.name], {}
    if "as" in rows:
        other = robots.robot(rows["as"]).opw
        stretch = {"link_2": (1.0, robot.opw.c2 / other.c2), "link_4": (-1.0, robot.opw.c3 / other.c3)}
        rows = _measured()[rows["as"]]
    out: Bodies = {}
    for i, (link, solids) in enumerate(rows.items()):
        shown = [_stretched(_solid(row, i), *stretch.get(link, (1.0, 1.0))) for row in solids]
        out[link] = (shown, shown)
    return out


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


def _base(build: Build) -> tuple[list[Solid], list[Solid]]:
    length, width, height = build.foot
    plate = 0.16 * height
    shift = -0.5 * length + min(0.5 * length, 1.08 * build.column)
    seen = [
        Solid("box", (length, width, plate), (shift, 0, plate / 2), "z", "dark"),
        Solid("cylinder", (0.94 * build.column, height), (0, 0, height / 2)),
        Solid("box", (0.62 * length, 0.62 * width, 0.72 * height), (shift - 0.1 * length, 0, 0.36 * height)),
        Solid(
            "box",
            (0.10 * length, 0.45 * width, 0.4 * height),
            (shift - 0.45 * length, 0, 0.3 * height),
            "z",
            "dark",
        ),
    ]
    return seen, [Solid("box", (length, max(width, 1.88 * build.column), height), (shift, 0, height / 2))]


def _shoulder(build: Build, a1: float, b: float, c1: float) -> tuple[list[Solid], list[Solid]]:
    """About the middle of axis 2."""
    radius, width = build.shoulder
    foot = build.foot[2]
    bottom, ring = foot - c1, 0.10 * foot
    top, crown = -0.35 * radius, 0.30 * radius
    cheek = 0.5 * (width - build.arm[1]) * 0.86
    centre = (width - cheek) / 2
    seen = [
        Solid("cylinder", (build.column, ring), (-a1, -b, bottom + ring / 2), "z", "dark"),
        Solid("cylinder", (0.97 * build.column, top - bottom - ring), (-a1, -b, (top + bottom + ring) / 2)),
        Solid("box", (a1 + 1.1 * radius, 0.96 * width, 0.8 * radius), (-0.5 * a1, 0, top - 0.1 * radius)),
        Solid("cylinder", (radius, cheek), (0, centre, 0), "y"),
        Solid("cylinder", (radius, cheek), (0, -centre, 0), "y"),
        Solid("cylinder", (0.62 * radius, width * 1.04), (0, 0, 0), "y", "dark"),
        Solid(
            "cylinder",
            (0.45 * radius, 1.3 * radius),
            (-a1 - 0.3 * build.column, 0.1 * width, top),
            "z",
            "dark",
        ),
    ]
    solid = [
        Solid("cylinder", (build.column, crown - bottom), (-a1, -b, (crown + bottom) / 2)),
        Solid("cylinder", (radius, 1.04 * width), (0, 0, 0), "y"),
    ]
    if build.balancer:
        length, back = 1.5 * build.column, -a1 - 0.55 * build.column
        place = (back, 0.36 * width, 0.75 * radius)
        seen.append(Solid("cylinder", (build.balancer, length), place, "x", "metal"))
        seen.append(Solid("cylinder", (0.45 * build.balancer, length * 1.1), place, "x", "dark"))
        solid.append(Solid("capsule", (build.balancer, length), place, "x"))
    return seen, solid


def _upper_arm(build: Build, c2: float) -> tuple[list[Solid], list[Solid]]:
    depth, width = build.arm
    low, high = 0.5 * depth * 1.16, min(build.elbow[0], 0.5 * depth * 1.1)
    seen = [
        Solid("cylinder", (low, width), (0, 0, 0), "y"),
        Solid("box", (depth, 0.94 * width, 0.56 * c2), (0, 0, 0.28 * c2)),
        Solid("box", (0.84 * depth, 0.94 * width, 0.5 * c2), (0, 0, 0.75 * c2)),
        Solid("cylinder", (high, width), (0, 0, c2), "y"),
        Solid("cylinder", (0.6 * high, 1.03 * width), (0, 0, c2), "y", "dark"),
        Solid("box", (0.5 * depth, 1.02 * width, 0.42 * c2), (0, 0, 0.5 * c2), "z", "dark"),
    ]
    return seen, [Solid("box", (2 * low, 1.04 * width, c2 + low + high), (0, 0, (c2 + high - low) / 2))]


def _elbow(build: Build, a2: float, split: float) -> tuple[list[Solid], list[Solid]]:
    radius, width = build.elbow
    tube, back = build.forearm, build.back
    cheek = 0.5 * (width - build.arm[1]) * 0.86
    centre = (width - cheek) / 2
    half = 0.85 * tube
    rise = abs(a2)
    seen = [
        Solid("cylinder", (radius, cheek), (0, centre, 0), "y"),
        Solid("cylinder", (radius, cheek), (0, -centre, 0), "y"),
        Solid("box", (1.6 * tube + 0.5 * rise, 2 * half, 1.4 * radius), (0.75 * a2, 0, 0.1 * radius)),
        Solid("cylinder", (0.98 * tube, 0.75 * back), (a2, 0, -0.38 * back), "z"),
        Solid("cylinder", (0.42 * tube, back), (a2 - 0.42 * tube, 0.42 * tube, -0.5 * back), "z", "dark"),
        Solid("cylinder", (0.42 * tube, back), (a2 - 0.42 * tube, -0.42 * tube, -0.5 * back), "z", "dark"),
        Solid("cylinder", (0.42 * tube, 0.92 * back), (a2 + 0.48 * tube, 0, -0.46 * back), "z", "dark"),
        Solid("cylinder", (0.58 * radius, 1.02 * width), (0, 0, 0), "y", "dark"),
        Solid("cylinder", (1.04 * tube, split), (a2, 0, split / 2), "z"),
        Solid("cylinder", (1.10 * tube, 0.14 * split), (a2, 0, 0.93 * split), "z", "dark"),
    ]
    solid = [
        Solid("cylinder", (1.1 * tube, split + back), (a2, 0, 0.5 * (split - back)), "z"),
        Solid("cylinder", (radius, 1.02 * width), (0, 0, 0), "y"),
    ]
    return seen, solid


def _forearm(build: Build, rest: float) -> tuple[list[Solid], list[Solid]]:
    """Frame at the wrist centre; the front tube comes from z = -rest and ends in a fork around the wrist."""
    radius, width = build.wrist
    tube = 0.84 * build.forearm
    prong = 0.5 * (width - 0.62 * width) * 0.9
    centre = (width - prong) / 2
    neck = 1.25 * radius
    middle = 0.55 * (rest - neck)
    seen = [
        Solid("cylinder", (tube, middle), (0, 0, -rest + middle / 2)),
        Solid("cylinder", (0.78 * tube, rest - neck - middle), (0, 0, -neck - (rest - neck - middle) / 2)),
        Solid("box", (1.7 * radius, width, 0.4 * radius), (0, 0, -neck), "z"),
        Solid("box", (1.7 * radius, prong, neck), (0, centre, -0.5 * neck)),
        Solid("box", (1.7 * radius, prong, neck), (0, -centre, -0.5 * neck)),
        Solid("cylinder", (0.96 * radius, prong), (0, centre, 0), "y"),
        Solid("cylinder", (0.96 * radius, prong), (0, -centre, 0), "y"),
        Solid("cylinder", (0.55 * radius, 1.03 * width), (0, 0, 0), "y", "dark"),
    ]
    half = max(0.85 * radius, 0.78 * tube)
    wide = max(width, 1.56 * tube)
    solid = [
        Solid("cylinder", (tube, middle), (0, 0, -rest + middle / 2)),
        Solid("box", (2 * half, wide, rest - middle), (0, 0, -0.5 * (rest - middle))),
        Solid("cylinder", (0.96 * radius, 1.03 * width), (0, 0, 0), "y"),
    ]
    return seen, solid


def urdf(name: str) -> str:
    """The text of the robot's URDF."""
    robot = robots.robot(name)
    frames = link_frames(robot, np.zeros(6))
    shapes = bodies(robot, BUILDS[name]) if name in BUILDS else measured(robot)
    origin = np.vstack([np.zeros(3), frames[:6, :3, 3]])
    upright = np.concatenate([np.eye(3)[None], frames[:6, :3, :3]])
    links = ["base_link", *(f"link_{i}" for i in range(1, 7))]
    out = ['<?xml version="1.0"?>', f"<!-- {robot.title}. Written by urdf/make_urdf.py; do not edit. -->"]
    out.append(f'<robot name="{name}" xmlns:drake="http://drake.mit.edu">')
    for colour, rgb in COLOURS[robot.family].items():
        out.append(f'  <material name="{colour}"><color rgba="{_numbers(rgb)} 1"/></material>')
    for link, rotation in zip(links, upright, strict=True):
        seen, solid = shapes[link]
        out.append(f'  <link name="{link}">')
        out += [line for s in seen for line in _shape("visual", s, rotation)]
        out += [line for s in solid for line in _shape("collision", s, rotation)]
        out.append("  </link>")
    out.append('  <link name="tool0"/>')
    for i in range(6):
        axis = robot.opw.signs[i] * upright[i + 1][:, "xyz".index("zyyzyz"[i])]
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
        tag = "cylinder" if solid.kind == "cylinder" else "drake:capsule"
        geometry = f'<{tag} radius="{solid.size[0] * 1e-3:.6g}" length="{solid.size[1] * 1e-3:.6g}"/>'
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
