"""Separation of carried shapes from stationary shapes along lines, in closed form.

The extents of two convex shapes along any line prove a distance between them, whatever found the line. So
does a plane along the motion that keeps both shapes on their sides.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from planner.cell import distance, external_axis_motion
from planner.cell.bodies import Solid
from planner.cell.external_axis_motion import AxisMotionCheck, AxisSample
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, Shape
from planner.proof.kinematics.external_axes import TaskAxis
from planner.proof.rule import mm

DISTANCE_TOLERANCE_M = 1e-6
"""Tolerance [m] within which distances are equal."""
MIN_NORMAL_LENGTH = 1e-3
"""Minimum length of the component of a shape's axis to which a plane along a motion is square."""


def slides_along(
    moving: tuple[Shape, FloatArray],
    stationary: tuple[Shape, FloatArray],
    direction: FloatArray,
    travel: tuple[float, float],
) -> bool:
    """Return whether one shape slides along another, which supports it.

    A plane along the motion lies between them, less than a bearing's gap apart across it and nowhere
    through it. At either end of the motion they are no farther apart than that along the plane, across the
    motion and along it. A shape that is only passed, or left behind, is no support.

    Args:
        moving: Moving shape with its pose (4, 4).
        stationary: Stationary shape with its pose (4, 4).
        direction: Direction (3,) of the motion.
        travel: Range [m] of the motion from the pose.
    """
    past = _gap_along(moving, stationary, direction)
    if (
        max(past + travel[1], _gap_along(stationary, moving, direction) - travel[0])
        >= external_axis_motion.MAX_STANDING_GAP_M
    ):
        return False
    axes = np.concatenate([pose[:3, :3].T for _, pose in (moving, stationary)])
    for normal in (*np.cross(axes, direction), *np.cross(np.cross(axes, direction), direction)):
        length = float(np.linalg.norm(normal))
        if length < MIN_NORMAL_LENGTH:
            continue
        n = normal / length
        m = np.cross(direction, n)
        across, sideways = (
            max(_gap_along(moving, stationary, u), _gap_along(stationary, moving, u)) for u in (n, m)
        )
        if (
            -DISTANCE_TOLERANCE_M <= across < external_axis_motion.MAX_STANDING_GAP_M
            and sideways < external_axis_motion.MAX_STANDING_GAP_M
        ):
            return True
    return False


def _gap_along(
    shape_pose: tuple[Shape, FloatArray], other_pose: tuple[Shape, FloatArray], line: FloatArray
) -> float:
    """Return how far [m] a shape starts after the end of another along a line (3,), negative if before it."""
    return -extent(*shape_pose, -line) - extent(*other_pose, line)


@dataclasses.dataclass(frozen=True)
class CarriedSolids:
    """Shapes that an axis moves.

    Attributes:
        solids: The shapes.
        poses_at: Function for the poses (4, 4) of the shapes at a query.
        lever: Maximum motion [m, m/rad] of any of their points per unit of the axis value.
    """

    solids: Sequence[Solid]
    poses_at: Callable[[AxisSample], list[FloatArray]]
    lever: float


def unproven_clearance(
    axis: TaskAxis,
    motion: AxisMotionCheck,
    carried: CarriedSolids,
    stationary: tuple[Sequence[Solid], list[FloatArray]],
    left_out: BoolArray,
    limit: float,
) -> str:
    """Report two shapes for which no line proves that they keep ``limit`` [m].

    The bound holds at each query and, as no point moves farther than the lever of the carried shapes per
    unit of the axis value, between two queries.

    Args:
        axis: Axis that moves.
        motion: Its motion with the queries.
        carried: Shapes that move.
        stationary: Shapes that do not move, with their poses.
        left_out: Pairs (R, F) that are not checked.
        limit: Required clearance [m].

    Returns:
        What is wrong, or an empty text.
    """
    carried_solids, (still_solids, still_poses) = carried.solids, stationary
    first, second = np.nonzero(~left_out)
    if not len(first):
        return ""
    cores = distance.make_cores([*carried_solids, *still_solids])
    previous: tuple[float, float] | None = None
    for query in motion.samples:
        carried_poses = carried.poses_at(query)
        poses = np.stack([*carried_poses, *still_poses])
        still_rows = second + len(carried_solids)
        lines = distance.measure_distances(cores, first, still_rows, poses[first], poses[still_rows])[1]
        gaps = [
            -extent(carried_solids[i].shape, carried_poses[i], -line)
            - extent(still_solids[j].shape, still_poses[j], line)
            for i, j, line in zip(first.tolist(), second.tolist(), lines, strict=True)
        ]
        worst = int(np.argmin(gaps))
        bound = gap = float(gaps[worst])
        if previous is not None:
            bound = min(gap, 0.5 * (previous[1] + gap - carried.lever * abs(query.value - previous[0])))
        if bound < limit - DISTANCE_TOLERANCE_M:
            what = (
                f"{carried_solids[int(first[worst])].body} keeps {mm(limit):g} mm from "
                f"{still_solids[int(second[worst])].body}"
            )
            return f"it is not proven that {what} at {axis.format_value(query.value)}"
        previous = query.value, gap
    return ""


def stationary_solids(model: CellModel, excluded: set[str]) -> tuple[list[Solid], list[FloatArray]]:
    """Return the solids of stationary bodies with their poses: no links, tools or held blocks."""
    poses = model.poses({})
    held = {"stock"} if model.stock.held_by is not None else set[str]()
    stationary = [
        solid
        for solid in model.solids
        if ("/" not in solid.body or solid.body.endswith("/base_link")) and solid.body not in excluded | held
    ]
    return stationary, [poses[s.body][0] @ s.shape.pose for s in stationary]


def is_round_about(shape: Shape, pose: FloatArray, centre: FloatArray, along: FloatArray) -> bool:
    """Return whether a shape at a pose (4, 4) is rotationally symmetric about an axis."""
    aside = float(np.linalg.norm(np.cross(pose[:3, 3] - centre, along)))
    skew = 0.0 if shape.kind == "sphere" else float(np.linalg.norm(np.cross(pose[:3, 2], along)))
    return shape.kind in ("sphere", "cylinder", "capsule") and max(aside, skew) < DISTANCE_TOLERANCE_M


def extent(shape: Shape, pose: FloatArray, line: FloatArray) -> float:
    """Return the extent [m] of a shape at a pose (4, 4) along a line (3,) from the origin, in closed form."""
    local_line, middle = line @ pose[:3, :3], float(line @ pose[:3, 3])
    if shape.vertices is not None:
        return middle + float((shape.vertices @ local_line).max())
    if shape.kind == "box":
        return middle + 0.5 * float(np.abs(local_line) @ np.asarray(shape.size))
    half_length = 0.5 * shape.size[1] * abs(float(local_line[2])) if len(shape.size) > 1 else 0.0
    across = (
        float(np.hypot(local_line[0], local_line[1]))
        if shape.kind == "cylinder"
        else float(np.linalg.norm(line))
    )
    return middle + half_length + shape.size[0] * across
