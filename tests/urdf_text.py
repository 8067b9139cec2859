"""URDF texts of arms, written by the tests from independent figures."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from planner.catalogue.robots import ParallelParameters, RobotData, SevenParameters, robot
from planner.cell.kinematics import joint_axes, link_frames
from planner.geometry.arrays import exp_rotation, from_parts, from_rpy, inverse, to_rpy
from planner.reading.robot_file import OwnRobotFile, build_robot

DRAWN = {
    "box": 'size="{} {} {}"',
    "cylinder": 'radius="{}" length="{}"',
    "capsule": 'radius="{}" length="{}"',
    "sphere": 'radius="{}"',
}


def origin(pose):
    words = [" ".join(repr(float(v)) for v in part) for part in (pose[:3, 3], to_rpy(pose[:3, :3]))]
    return f'<origin xyz="{words[0]}" rpy="{words[1]}"/>'


def geometry_tag(kind, size, pose, file="", tag="collision", inside=""):
    """Return a <collision> or, by ``tag``, a <visual> element.

    ``inside`` is its further content. ``size`` of a mesh is its scale.
    """
    scale = f' scale="{" ".join(repr(float(v)) for v in size)}"' if size else ""
    text = f'<mesh filename="{file}"{scale}/>' if kind == "mesh" else f"<{kind} {DRAWN[kind].format(*size)}/>"
    return f"<{tag}>{origin(pose)}<geometry>{text}</geometry>{inside}</{tag}>"


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
        shapes = "".join(geometry_tag(*body) for body in (bodies or {}).get(i, ()))
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


def robot_urdf(robot: RobotData, base=None, tip=None, turns=None, bodies=None):
    """The text of a robot of the catalogue, with the links of base and tip at ``base`` (4, 4) in its base and
    at ``tip`` (4, 4) in its flange."""
    base, tip = (np.eye(4) if pose is None else pose for pose in (base, tip))
    frames = link_frames(robot, np.zeros(robot.axes))
    axes = joint_axes(robot, frames)
    back = inverse(base)
    points = frames[:-1, :3, 3] @ back[:3, :3].T + back[:3, 3]
    limits = [[float(a), float(b)] for a, b in zip(robot.lower, robot.upper, strict=True)]
    velocity = [float(v) for v in robot.velocity]
    return arm(axes @ back[:3, :3].T, points, back @ frames[-1] @ tip, limits, velocity, bodies, turns)


UR10E_DH = (
    (0.1807, 0.0, 0.5 * np.pi),
    (0.0, -0.6127, 0.0),
    (0.0, -0.57155, 0.0),
    (0.17415, 0.0, 0.5 * np.pi),
    (0.11985, 0.0, -0.5 * np.pi),
    (0.11655, 0.0, 0.0),
)
"""d [m], a [m] and alpha [rad] of a UR10e: Universal Robots, support page "DH Parameters for calculations of
kinematics and dynamics"."""
UR10E_SPEED = np.deg2rad([120.0, 120.0, 180.0, 180.0, 180.0, 180.0])
"""Of the UR10e's user manual, as ROS-Industrial's ur_description (joint_limits.yaml) cites it."""
UR10E_BODIES = {
    0: [("cylinder", (0.095, 0.1), from_parts(np.eye(3), np.array([0.0, 0.0, 0.05])))],
    1: [("sphere", (0.08,), np.eye(4))],
    2: [("capsule", (0.06, 0.55), from_rpy([-0.306, 0.0, 0.0], [0.0, np.pi / 2, 0.0]))],
    3: [("capsule", (0.045, 0.5), from_rpy([-0.286, 0.0, 0.0], [0.0, np.pi / 2, 0.0]))],
    4: [("sphere", (0.05,), np.eye(4))],
    5: [("sphere", (0.045,), np.eye(4))],
    6: [("cylinder", (0.037, 0.04), from_rpy([0.0, -0.09, 0.0], [np.pi / 2, 0.0, 0.0]))],
}
(RISE, _, _), (_, UPPER, _), (_, FORE, _), (OUT, _, _), (DOWN, _, _), (LAST, _, _) = UR10E_DH
UR10E_FORM = ParallelParameters(
    OUT, RISE, -UPPER, -FORE, DOWN, LAST, np.deg2rad([180.0, -90.0, 0.0, -90.0, 0.0, 0.0]), np.ones(6)
)
UR10E = dataclasses.replace(
    robot("irb140"),
    name="ur10e",
    family="UR",
    form=UR10E_FORM,
    lower=np.full(6, -2.0 * np.pi),
    upper=np.full(6, 2.0 * np.pi),
    velocity=UR10E_SPEED,
    reach=1.3,
)
"""The arm by its table, for kinematics alone: it has no file."""


def ur10e_data(base=None):
    """A UR10e as a problem file's ``robot:`` has it, with ``base`` as of :func:`of_robot`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ur10e.urdf"
        path.write_text(ur10e(base), encoding="utf-8")
        stated = {"urdf": path.name, "name": "ur10e", "family": "ur", "payload_kg": 12.5}
        return build_robot(OwnRobotFile.model_validate(stated), path.parent)


def ur10e_flange(q):
    """Poses (B, 4, 4) of a UR10e's flange in its base for joints q (B, 6), link by link of its table."""
    pose = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for (d, a, alpha), turn in zip(UR10E_DH, q.T, strict=True):
        about = from_parts(exp_rotation(turn[:, None] * np.array([0.0, 0.0, 1.0])), np.array([0.0, 0.0, d]))
        pose = pose @ about @ from_rpy([a, 0.0, 0.0], [alpha, 0.0, 0.0])
    return pose


def ur10e(base=None, tip=None, limits=((-2.0 * np.pi, 2.0 * np.pi),) * 6):
    """The text of a UR10e, with plain bodies by eye; ``base``, ``tip`` as of :func:`of_robot`."""
    base, tip = (np.eye(4) if pose is None else pose for pose in (base, tip))
    back, side = inverse(base), np.array([0.0, -1.0, 0.0])
    axes = np.array([[0.0, 0.0, 1.0], side, side, side, [0.0, 0.0, -1.0], side])
    points = np.array(
        [
            (0.0, 0.0, RISE),
            (0.0, -0.176, RISE),
            (UPPER, -0.039, RISE),
            (UPPER + FORE, -0.12, RISE),
            (UPPER + FORE, -OUT, RISE - DOWN),
            (UPPER + FORE, -OUT, RISE - DOWN),
        ]
    )
    points = points @ back[:3, :3].T + back[:3, 3]
    flange = back @ ur10e_flange(np.zeros((1, 6)))[0] @ tip
    bodies = {0: [(kind, size, back @ pose) for kind, size, pose in UR10E_BODIES[0]]}
    turn = from_parts(back[:3, :3], np.zeros(3))
    bodies |= {i: [(kind, size, turn @ pose) for kind, size, pose in UR10E_BODIES[i]] for i in range(1, 7)}
    return arm(axes @ back[:3, :3].T, points, flange, limits, UR10E_SPEED.tolist(), bodies)


PANDA_LIMITS = [
    [-2.8973, 2.8973],
    [-1.7628, 1.7628],
    [-2.8973, 2.8973],
    [-3.0718, -0.0698],
    [-2.8973, 2.8973],
    [-0.0175, 3.7525],
    [-2.8973, 2.8973],
]
PANDA_SPEED = [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]
"""Limits [rad], speeds [rad/s] and, below, lengths [m] of a Panda: Franka Emika, "Franka Control Interface
documentation", robot and interface specifications."""
PANDA_FORM = SevenParameters(
    0.0825, -0.0825, -0.088, 0.333, 0.316, 0.384, 0.107,
    offsets=np.deg2rad([0.0, 0.0, 0.0, 0.0, 0.0, -180.0, -180.0]),
    signs=np.array([1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0]),
)  # fmt: skip
IIWA_LIMITS = [[-a, a] for a in np.deg2rad([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0]).tolist()]
IIWA_SPEED = np.deg2rad([85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0]).tolist()
"""Speed limits [rad/s] of an LBR iiwa 14 R820, from KUKA's data sheet."""


def _up(length, z):
    """A capsule along z, its middle at ``z`` [m]."""
    return ("capsule", (0.055, length), from_parts(np.eye(3), np.array([0.0, 0.0, z])))


FOOT = ("cylinder", (0.09, 0.12), from_parts(np.eye(3), np.array([0.0, 0.0, 0.06])))
BALL, WRIST = ("sphere", (0.065,), np.eye(4)), ("sphere", (0.05,), np.eye(4))
PANDA_BODIES = (FOOT, _up(0.08, -0.08), BALL, _up(0.12, -0.13), BALL, _up(0.14, -0.16), WRIST)
IIWA_BODIES = (FOOT, _up(0.04, 0.1), BALL, _up(0.1, 0.1), BALL, _up(0.06, 0.08), WRIST)
"""Plain bodies by eye, in links whose frames are parallel to the base at zero; one more is the hand."""


def panda(base=None, tip=None, limits=PANDA_LIMITS):
    """The text of a Panda, with plain bodies by eye; ``base``, ``tip`` as of :func:`of_robot`."""
    axes = [(0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, -1, 0), (0, 0, -1)]
    points = [(0, 0, 0.333), (0, 0, 0.333), (0, 0, 0.649), (0.0825, 0, 0.649)]
    points += [(0, 0, 1.033), (0, 0, 1.033), (0.088, 0, 1.033)]
    flange = from_parts(np.diag([1.0, -1.0, -1.0]), np.array([0.088, 0.0, 0.926]))
    hand = ("cylinder", (0.045, 0.04), from_parts(np.eye(3), np.array([0.0, 0.0, -0.085])))
    return _seven(axes, points, flange, limits, PANDA_SPEED, (*PANDA_BODIES, hand), base, tip)


def iiwa(base=None, tip=None, limits=IIWA_LIMITS):
    """The text of an iiwa, as :func:`panda`."""
    axes = [(0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1)]
    points = [(0, 0, z) for z in (0.15, 0.36, 0.5, 0.78, 0.98, 1.18, 1.25)]
    flange = from_parts(np.eye(3), np.array([0.0, 0.0, 1.306]))
    hand = ("cylinder", (0.045, 0.04), from_parts(np.eye(3), np.array([0.0, 0.0, 0.034])))
    return _seven(axes, points, flange, limits, IIWA_SPEED, (*IIWA_BODIES, hand), base, tip)


def _seven(axes, points, flange, limits, speed, bodies, base, tip):
    base, tip = (np.eye(4) if pose is None else pose for pose in (base, tip))
    back = inverse(base)
    turn = from_parts(back[:3, :3], np.zeros(3))
    points = np.array(points) @ back[:3, :3].T + back[:3, 3]
    links = {i: [(k, size, (turn if i else back) @ pose)] for i, (k, size, pose) in enumerate(bodies)}
    return arm(np.array(axes) @ back[:3, :3].T, points, back @ flange @ tip, limits, speed, links)
