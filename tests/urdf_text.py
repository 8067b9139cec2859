"""URDF texts of arms, written by the tests from figures of their own."""

from __future__ import annotations

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import joint_axes, link_frames
from planner.geometry.arrays import from_parts, inverse, to_rpy

DRAWN = {"box": 'size="{} {} {}"', "cylinder": 'radius="{}" length="{}"', "sphere": 'radius="{}"'}


def origin(pose):
    words = [" ".join(repr(float(v)) for v in part) for part in (pose[:3, 3], to_rpy(pose[:3, :3]))]
    return f'<origin xyz="{words[0]}" rpy="{words[1]}"/>'


def drawn(kind, size, pose, file=""):
    text = f'<mesh filename="{file}"/>' if kind == "mesh" else f"<{kind} {DRAWN[kind].format(*size)}/>"
    return f"<collision>{origin(pose)}<geometry>{text}</geometry></collision>"


def arm(
    axes, points, flange, limits=None, velocity=None, bodies=None, turns=None, names=("base_link", "tool0")
):
    """The text of joints in a row: ``axes`` (N, 3) through ``points`` (N, 3) in the base and the tip's pose
    ``flange`` (4, 4), all at zero; ``turns`` (N, 3, 3): how the links' frames are turned."""
    count = len(axes)
    turns = np.tile(np.eye(3), (count, 1, 1)) if turns is None else turns
    limits = [[-2.9, 2.9]] * count if limits is None else limits
    velocity = [2.0] * count if velocity is None else velocity
    links = [names[0], *(f"l{i + 1}" for i in range(count)), names[1]]
    frames = [np.eye(4), *(from_parts(turns[i], np.asarray(points[i])) for i in range(count))]
    out = ['<robot name="own">']
    for i, link in enumerate(links[:-1]):
        shapes = "".join(drawn(*body) for body in (bodies or {}).get(i, ()))
        out.append(f'<link name="{link}">{shapes}</link>')
    out.append(f'<link name="{names[1]}"/>')
    for i in range(count):
        axis = " ".join(repr(float(v)) for v in turns[i].T @ axes[i])
        limit = f'lower="{limits[i][0]!r}" upper="{limits[i][1]!r}" velocity="{velocity[i]!r}" effort="0"'
        step = inverse(frames[i]) @ frames[i + 1]
        out.append(
            f'<joint name="j{i + 1}" type="revolute">{origin(step)}<parent link="{links[i]}"/>'
            f'<child link="{links[i + 1]}"/><axis xyz="{axis}"/><limit {limit}/></joint>'
        )
    out.append(
        f'<joint name="end" type="fixed">{origin(inverse(frames[-1]) @ flange)}<parent link="{links[-2]}"/>'
        f'<child link="{links[-1]}"/></joint></robot>'
    )
    return "\n".join(out)


def of_robot(robot: RobotData, base=None, tip=None, turns=None, bodies=None):
    """The text of a robot of the catalogue, with the links of base and tip at ``base`` (4, 4) in its base and
    at ``tip`` (4, 4) in its flange."""
    base, tip = (np.eye(4) if pose is None else pose for pose in (base, tip))
    frames = link_frames(robot, np.zeros(6))
    axes = joint_axes(robot, frames)
    back = inverse(base)
    points = frames[:6, :3, 3] @ back[:3, :3].T + back[:3, 3]
    limits = [[float(a), float(b)] for a, b in zip(robot.lower, robot.upper, strict=True)]
    velocity = [float(v) for v in robot.velocity]
    return arm(axes @ back[:3, :3].T, points, back @ frames[6] @ tip, limits, velocity, bodies, turns)
