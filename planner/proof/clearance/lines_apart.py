"""Whether lines show that shapes which ride keep off those that stand, in closed form.

A line between two convex shapes shows that they are apart, whatever found it; so does a plane along the way
of what rides, which neither of them leaves its side of.
"""

from collections.abc import Callable, Sequence

import numpy as np

from planner.cell import axis_way, distance
from planner.cell.axis_way import AxisWay, Look
from planner.cell.bodies import Solid
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, Shape
from planner.proof.kinematics.external_axes import OuterAxis
from planner.proof.rule import mm

SAME_WAY = 1e-6
"""Distances that differ by no more [m] are one."""
LEAST_NORMAL = 1e-3
"""Planes along a way are square to parts of axes of shapes that are no shorter."""


def slides(
    one: tuple[Shape, FloatArray], two: tuple[Shape, FloatArray], way: FloatArray, goes: tuple[float, float]
) -> bool:
    """Whether the one of two shapes at their poses (4, 4), which ``goes`` so far [m] back and forth along a
    ``way`` (3,) from there, slides along the other, which bears it: a plane along the way lies between them,
    less than a bearing's gap apart across it and nowhere through it, and at either end of the way they are no
    farther apart than that along the plane, across the way and along it. What the one only passes, or leaves
    behind, does not bear it."""
    past = _past(one, two, way)
    if max(past + goes[1], _past(two, one, way) - goes[0]) >= axis_way.STANDING_GAP_M:
        return False
    axes = np.concatenate([pose[:3, :3].T for _, pose in (one, two)])
    for normal in (*np.cross(axes, way), *np.cross(np.cross(axes, way), way)):
        length = float(np.linalg.norm(normal))
        if length < LEAST_NORMAL:
            continue
        n = normal / length
        m = np.cross(way, n)
        across, beside = (max(_past(one, two, u), _past(two, one, u)) for u in (n, m))
        if -SAME_WAY <= across < axis_way.STANDING_GAP_M and beside < axis_way.STANDING_GAP_M:
            return True
    return False


def _past(one: tuple[Shape, FloatArray], two: tuple[Shape, FloatArray], line: FloatArray) -> float:
    """How far [m] a shape begins behind the end of another along a line (3,), less than 0 where it begins
    before it."""
    return -reach(*one, -line) - reach(*two, line)


def nearer(
    axis: OuterAxis,
    way: AxisWay,
    rides: tuple[Sequence[Solid], Callable[[Look], list[FloatArray]]],
    stands: tuple[Sequence[Solid], list[FloatArray]],
    left_out: BoolArray,
    lever: float,
    limit: float,
) -> str:
    """Shapes that ride, and shapes that stand, of which no line shows that they keep ``limit`` [m] apart at
    each look and, as no point rides farther than ``lever`` [m, m/rad] by a value of 1, between two; empty
    where there are none. With each kind of shapes: where they are. Pairs (R, F) that are ``left_out``."""
    (own, placed), (still, there) = rides, stands
    first, second = np.nonzero(~left_out)
    if not len(first):
        return ""
    cores = distance.cores([*own, *still])
    before: tuple[float, float] | None = None
    for look in way.looked:
        at = placed(look)
        poses = np.stack([*at, *there])
        behind = second + len(own)
        lines = distance.distances(cores, first, behind, poses[first], poses[behind])[1]
        apart = [
            -reach(own[i].shape, at[i], -line) - reach(still[j].shape, there[j], line)
            for i, j, line in zip(first.tolist(), second.tolist(), lines, strict=True)
        ]
        worst = int(np.argmin(apart))
        bound = gap = float(apart[worst])
        if before is not None:
            bound = min(gap, 0.5 * (before[1] + gap - lever * abs(look.value - before[0])))
        if bound < limit - SAME_WAY:
            what = (
                f"{own[int(first[worst])].body} keeps {mm(limit):g} mm off {still[int(second[worst])].body}"
            )
            return f"nothing shows that {what} at {axis.shown(look.value)}"
        before = look.value, gap
    return ""


def standing(model: CellModel, but: set[str]) -> tuple[list[Solid], list[FloatArray]]:
    """Solids of bodies that stand, as no link, tool or block that an arm holds does, and where they are."""
    poses = model.poses({})
    held = {"stock"} if model.stock.held_by is not None else set[str]()
    own = [
        solid
        for solid in model.solids
        if ("/" not in solid.body or solid.body.endswith("/base_link")) and solid.body not in but | held
    ]
    return own, [poses[s.body][0] @ s.shape.pose for s in own]


def round_about(shape: Shape, pose: FloatArray, centre: FloatArray, along: FloatArray) -> bool:
    """Whether a shape at a pose (4, 4) is round about an axis."""
    aside = float(np.linalg.norm(np.cross(pose[:3, 3] - centre, along)))
    skew = 0.0 if shape.kind == "sphere" else float(np.linalg.norm(np.cross(pose[:3, 2], along)))
    return shape.kind in ("sphere", "cylinder", "capsule") and max(aside, skew) < SAME_WAY


def reach(shape: Shape, pose: FloatArray, line: FloatArray) -> float:
    """How far [m] a shape at a pose (4, 4) goes along a line (3,), from the origin: in closed form."""
    seen, middle = line @ pose[:3, :3], float(line @ pose[:3, 3])
    if shape.vertices is not None:
        return middle + float((shape.vertices @ seen).max())
    if shape.kind == "box":
        return middle + 0.5 * float(np.abs(seen) @ np.asarray(shape.size))
    long = 0.5 * shape.size[1] * abs(float(seen[2])) if len(shape.size) > 1 else 0.0
    across = float(np.hypot(seen[0], seen[1])) if shape.kind == "cylinder" else float(np.linalg.norm(line))
    return middle + long + shape.size[0] * across
