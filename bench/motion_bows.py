"""Jobs of a straight wire that the motion benchmarks and tests share: made here, from geometry alone.

A bow cuts a prism out of a block along an outline: from the air through the foam, around, and out by the same
slot.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from planner.catalogue.materials import foam
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, from_rpy, inverse
from planner.problem import Arm, Cell, Controller, Obstacle, Stock
from planner.targets import ScrewFreedom, Targets
from planner.tooling import bow, gripper_plate

HOME = np.deg2rad([0.0, -30.0, 20.0, 0.0, 45.0, 0.0])
ASIDE = np.deg2rad([60.0, -30.0, 20.0, 0.0, 45.0, 0.0])
"""Home of facing arms with long tools."""

SPIN = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
SLIDE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
AIR = 0.04
"""Distance [m] outside the block at which the cuts begin and end."""


def polygon(corners: int, across: float) -> FloatArray:
    """Corners (corners, 2) of a regular polygon with the distance ``across`` [m] between opposite sides."""
    angle = 2.0 * np.pi * (np.arange(corners) + 0.5) / corners
    return 0.5 * across / np.cos(np.pi / corners) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def outline(stock: Stock, corners: FloatArray, count: int) -> tuple[FloatArray, tuple[str, ...]]:
    """Return points (N, 2) of the wire around a polygon (C, 2), and labels; the lead-in is along x."""
    inside = np.array([stock.lower[0], 0.5 * (corners[0, 1] + corners[-1, 1])])
    closed = np.concatenate([[[corners[:, 0].min(), inside[1]]], _from_left(corners)])
    start = inside - [AIR, 0.0]
    parts = [
        (np.array([start - [0.06, 0.0], start]), "approach"),
        (np.array([start, closed[0]]), "cut/side_in"),
    ]
    loop = np.concatenate([closed, closed[:1]])
    parts += [(loop[k : k + 2], "cut/side") for k in range(len(loop) - 1)]
    parts += [
        (np.array([closed[0], start]), "cut/side_out"),
        (np.array([start, start - [0.06, 0.0]]), "retreat"),
    ]
    total = sum(float(np.linalg.norm(p[1] - p[0])) for p, _ in parts)
    places, labels = [parts[0][0][:1]], [parts[0][1]]
    for line, label in parts:
        steps = max(2, round(count * float(np.linalg.norm(line[1] - line[0])) / total))
        places.append(line[0] + np.arange(1, steps + 1)[:, None] / steps * (line[1] - line[0]))
        labels += [label] * steps
    return np.concatenate(places), tuple(labels)


def _from_left(corners: FloatArray) -> FloatArray:
    """The corners in their order, beginning after the middle of the leftmost side."""
    middle = 0.5 * (corners + np.roll(corners, -1, axis=0))
    return np.roll(corners, -1 - int(np.argmin(middle[:, 0])), axis=0)


def cut(
    stock: Stock,
    corners: FloatArray,
    count: int,
    cutter: str,
    slide: float = 0.05,
    follow_outline: bool = False,
) -> Targets:
    """Targets of a bow that cuts a prism with its wire along the stock's z axis.

    ``turned``: the nominal pose turns with the outline and jumps at its corners, else it stays.
    """
    places, segment = outline(stock, corners, count)
    rows = len(places)
    middle = 0.5 * (stock.lower[2] + stock.upper[2])
    frame = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]) * [1.0, -1.0, 1.0]
    pose = from_parts(np.broadcast_to(frame, (rows, 3, 3)), np.column_stack([places, np.full(rows, middle)]))
    step = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if follow_outline:
        way = np.arctan2(*np.diff(places, axis=0).T[::-1])
        spin = np.zeros((rows, 3))
        spin[1:, 0] = way
        pose = pose @ np.concatenate([_turns(spin[:1]), _turns(spin[1:])])
    stop = np.zeros(rows, dtype=bool)
    stop[[0, -1]] = True
    stop[:-1] |= np.array([a != b for a, b in itertools.pairwise(segment)])
    bend = np.diff(places, axis=0) / step[:, None]
    stop[1:-1] |= np.einsum("ij,ij->i", bend[1:], bend[:-1]) < 0.99
    full, wide = np.full(rows, np.pi), np.full(rows, slide)
    freedoms = [ScrewFreedom("spin", {cutter: SPIN}, -full, full, periodic=True)]
    if slide > 0.0:
        freedoms.append(ScrewFreedom("slide", {cutter: SLIDE}, -wide, wide))
    return Targets(
        arms=(cutter,),
        pose={cutter: pose},
        frame={cutter: "stock"},
        freedoms=tuple(freedoms),
        feed=np.full(rows, 0.01),
        feed_min=np.zeros(rows),
        travel=np.append(0.0, step),
        stop=stop,
        segment=tuple(map(Segment.read, segment)),
        may_stop=True,
        may_join=True,
    )


def _turns(spin: FloatArray) -> FloatArray:
    return from_parts(exp_rotation(spin), np.zeros_like(spin))


def standing_block(
    count: int = 400, stock_pose: FloatArray | None = None, obstacles: tuple[Obstacle, ...] = ()
) -> tuple[Cell, Stock, Targets]:
    """One IRB 140 with a bow of 400 mm, cutting a square of 180 mm out of a standing block."""
    cell = Cell("bow", (Arm("left", "irb140", np.eye(4), bow(), HOME),), obstacles, Controller())
    stock = Stock(np.array([0.22, 0.22, 0.2]), stock_pose, np.eye(3), any_attitude=stock_pose is None)
    return cell, stock, cut(stock, polygon(4, 0.18), count, "left")


def held_block(
    count: int = 400,
    distance: float = 1.5,
    freedoms: tuple[str, ...] = ("spin", "slide", "x", "y", "z", "tilt_x", "tilt_y", "turn"),
    follow_outline: bool = False,
    robot: str = "irb140",
    stock_pose: FloatArray | None = None,
) -> tuple[Cell, Stock, Targets]:
    """Two arms that face each other: the right one holds a block of 300 x 300 x 200 mm by a plate, the left
    one cuts a hexagon around it with a bow of 400 mm. ``freedoms``: those that are free."""
    front = from_rpy((-distance / 2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    back = from_rpy((distance / 2.0, 0.0, 0.0), (0.0, 0.0, np.pi))
    arms = (
        Arm("left", robot, front, bow(), ASIDE),
        Arm("right", robot, back, gripper_plate(0.15, 0.15), ASIDE),
    )
    stock = Stock(
        np.array([0.3, 0.3, 0.2]),
        stock_pose,
        np.eye(3),
        any_attitude=stock_pose is None,
        foam=foam("eps"),
        held_by="right",
    )
    return (
        Cell("held", arms, (), Controller()),
        stock,
        hold(cut(stock, polygon(6, 0.26), count, "left", follow_outline=follow_outline), stock, freedoms),
    )


def hold(targets: Targets, stock: Stock, freedoms: tuple[str, ...]) -> Targets:
    """The targets of a bow in the frame of the stock, for a stock that the arm ``held_by`` holds."""
    cutter, holder = targets.arms[0], str(stock.held_by)
    rows = targets.count
    centre = (stock.grip @ np.append(0.5 * (stock.lower + stock.upper), 1.0))[:3]
    result = {f.name: f for f in targets.freedoms}
    for k, axis in enumerate("xyz"):
        twist = np.zeros(6)
        twist[3:] = stock.grip[:3, k]
        wide = np.full(rows, 0.2)
        result[axis] = ScrewFreedom(f"block_{axis}", {holder: twist}, -wide, wide)
    for k, name in enumerate(("tilt_x", "tilt_y", "turn")):
        turn = stock.grip[:3, k]
        twist = np.concatenate([turn, np.cross(centre, turn)])
        wide = np.full(rows, np.pi if name == "turn" else np.deg2rad(40.0))
        result[name] = ScrewFreedom(f"block_{name}", {holder: twist}, -wide, wide, periodic=name == "turn")
    still = np.broadcast_to(inverse(stock.grip), (rows, 4, 4))
    return dataclasses.replace(
        targets,
        arms=(cutter, holder),
        pose={cutter: stock.grip @ targets.pose[cutter], holder: still},
        frame={cutter: f"held:{holder}", holder: "stock"},
        freedoms=tuple(result[name] for name in freedoms),
    )
