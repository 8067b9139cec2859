"""Jobs that the motion benchmarks and tests share: made here, from geometry alone."""

from __future__ import annotations

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, Shape, from_parts, from_rpy
from planner.problem import Arm, Cell, Controller, Obstacle, Stock
from planner.targets import FlexibleTool, ScrewFreedom, Targets
from planner.tooling import PlainTool, wire_holder

HOME = np.deg2rad([0.0, -10.0, 10.0, 0.0, 60.0, 0.0])


def box(size: tuple[float, float, float], centre: tuple[float, float, float]) -> Shape:
    """A box [m] at a place."""
    return Shape("box", size, from_parts(np.eye(3), np.array(centre)))


def two_arms(distance: float = 1.6, obstacles: tuple[Obstacle, ...] = ()) -> Cell:
    """Two IRB 140 that face each other."""
    back = from_parts(np.diag([-1.0, -1.0, 1.0]), np.array([distance / 2.0, 0.0, 0.0]))
    front = from_parts(np.eye(3), np.array([-distance / 2.0, 0.0, 0.0]))
    arms = (
        Arm("left", "irb140", front, wire_holder("across", "start"), HOME),
        Arm("right", "irb140", back, wire_holder("across", "end"), HOME),
    )
    return Cell("bench", arms, obstacles, Controller())


def block(size: tuple[float, float, float], stock_pose: FloatArray | None) -> Stock:
    """A block of stock."""
    return Stock(np.array(size), stock_pose, np.eye(3))


def arc_wire(count: int = 437, length: float = 0.56, spin: bool = True) -> Targets:
    """A wire bent to an arc of radius 300 mm with straight ends, in planes tilting from 0 to 40 degrees.

    The sweep runs along y, through a block of 160 x 700 x 100 mm.
    """
    radius, bent = 0.3, 0.2
    half, straight = bent / radius / 2.0, (length - bent) / 2.0
    y = np.linspace(-0.42, 0.42, count)
    tilt = np.deg2rad(np.clip((y + 0.34) / 0.68, 0.0, 1.0) * 40.0)
    along = np.stack([np.ones(count), np.zeros(count), np.zeros(count)], axis=1)
    up = np.stack([np.zeros(count), -np.sin(tilt), np.cos(tilt)], axis=1)
    normal = np.cross(along, up)
    centre = np.stack([np.zeros(count), y, np.full(count, 0.05)], axis=1)

    def at(s: float) -> tuple[FloatArray, FloatArray]:
        inner = np.clip(s, -bent / 2.0, bent / 2.0)
        angle = -inner / radius
        x, z = radius * np.sin(inner / radius), radius * (np.cos(inner / radius) - np.cos(half))
        x, z = x + (s - inner) * np.cos(angle), z + (s - inner) * np.sin(angle)
        tangent = np.cos(angle) * along + np.sin(angle) * up
        return centre + x * along + z * up, tangent

    poses = []
    for s in (-length / 2.0, length / 2.0):
        place, tangent = at(s)
        poses.append(from_parts(np.stack([tangent, np.cross(normal, tangent), normal], axis=-1), place))
    assert straight > 0.0
    points = np.stack([at(s)[0] for s in np.linspace(-length / 2.0, length / 2.0, 29)], axis=1)
    segment = tuple("cut/front" if abs(v) < 0.37 else ("approach" if v < 0 else "retreat") for v in y)
    travel = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1))
    stop = np.zeros(count, dtype=bool)
    stop[[0, -1]] = True
    axis = np.array([1.0, 0, 0, 0, 0, 0])
    full = np.full(count, np.pi)
    freedoms = (ScrewFreedom("spin", {"left": axis, "right": axis}, -full, full, periodic=True),)
    return Targets(
        arms=("left", "right"),
        pose={"left": poses[0], "right": poses[1]},
        frame={"left": "stock", "right": "stock"},
        freedoms=freedoms if spin else (),
        feed=np.full(count, 0.02),
        feed_min=np.zeros(count),
        travel=travel,
        stop=stop,
        segment=tuple(map(Segment.read, segment)),
        coupled=True,
        flexible_tool=FlexibleTool(points, 0.0005),
        may_join=True,
    )


def s_curve(count: int = 400) -> tuple[Cell, Targets]:
    """One IRB 140 with a pointed tool that follows an S-curve, free to spin about the tool's axis."""
    tool = PlainTool(
        "point",
        from_parts(np.eye(3), np.array([0.0, 0.0, 0.12])),
        0.5,
        np.array([0.0, 0.0, 0.06]),
        (box((0.02, 0.02, 0.1), (0.0, 0.0, 0.055)),),
    )
    cell = Cell("one", (Arm("arm", "irb140", np.eye(4), tool, HOME),), (), Controller())
    t = np.linspace(-1.0, 1.0, count)
    points = np.stack([0.5 + 0.1 * np.sin(np.pi * t), 0.3 * t, np.full(count, 0.3)], axis=1)
    pose = from_parts(np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (count, 3, 3)), points)
    full = np.full(count, np.pi)
    stop = np.zeros(count, dtype=bool)
    stop[[0, -1]] = True
    targets = Targets(
        arms=("arm",),
        pose={"arm": pose},
        frame={"arm": "world"},
        freedoms=(ScrewFreedom("spin", {"arm": np.array([0.0, 0, 1, 0, 0, 0])}, -full, full, periodic=True),),
        feed=np.full(count, 0.1),
        feed_min=np.zeros(count),
        travel=np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1)),
        stop=stop,
        segment=(Segment("path"),) * count,
        may_stop=True,
        may_join=True,
    )
    return cell, targets


def spiral_pair(
    count: int, loops: int, tilt: float = 0.0, obstacles: tuple[Obstacle, ...] = ()
) -> tuple[Cell, Targets]:
    """Two IRB 140 with balls of 5 mm radius on both sides of a spiral in the plane x = 0, each free to spin.

    The balls' centres are 12 mm apart, the loops shrink from 80 to 40 mm. Tools are bent by 45 degrees; their
    axes tilt by ``tilt`` [rad] to the spiral's outside and turn with it. The first and the last target are 40
    mm from the plane.
    """
    lean = from_rpy((0.0, 0.0, 0.02), (0.0, np.deg2rad(45.0), 0.0))
    ball = Shape("capsule", (0.005, 0.1), lean @ from_parts(np.eye(3), np.array([0.0, 0.0, 0.06])))
    tcp = lean @ from_parts(np.eye(3), np.array([0.0, 0.0, 0.11]))
    tool = PlainTool("ball", tcp, 0.5, np.array([0.04, 0.0, 0.06]), (ball,))
    arms = tuple(Arm(a.name, a.robot, a.base, tool, a.home) for a in two_arms(1.3).arms)
    fraction = np.linspace(0.0, 1.0, count - 2)
    angle, radius = 2.0 * np.pi * loops * fraction, 0.08 - 0.04 * fraction
    out = np.stack([np.zeros(count - 2), np.cos(angle), np.sin(angle)], axis=1)
    tangent = np.stack([np.zeros(count - 2), -np.sin(angle), np.cos(angle)], axis=1)
    poses = {}
    for name, side in (("left", -1.0), ("right", 1.0)):
        z = np.array([-side * np.cos(tilt), 0.0, 0.0]) + np.sin(tilt) * out
        points = np.array([side * 0.006, 0.0, 0.55]) + radius[:, None] * out
        turn = np.stack([tangent, np.cross(z, tangent), z], axis=-1)
        pose = from_parts(turn, points)[np.r_[0, 0 : count - 2, count - 3]]
        pose[[0, -1], 0, 3] += side * 0.04
        poses[name] = pose
    full = np.full(count, np.pi)
    axis = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    step = [np.linalg.norm(np.diff(p[:, :3, 3], axis=0), axis=1) for p in poses.values()]
    stop = np.zeros(count, dtype=bool)
    stop[[0, 1, -2, -1]] = True
    return Cell("spiral", arms, obstacles, Controller()), Targets(
        arms=("left", "right"),
        pose=poses,
        frame={"left": "world", "right": "world"},
        freedoms=tuple(ScrewFreedom(f"spin_{a}", {a: axis}, -full, full, periodic=True) for a in poses),
        feed=np.full(count, 0.1),
        feed_min=np.zeros(count),
        travel=np.append(0.0, np.max(step, axis=0)),
        stop=stop,
        segment=(Segment("approach"), *(Segment("cut", "spiral"),) * (count - 2), Segment("retreat")),
        may_join=True,
    )
