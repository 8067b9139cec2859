"""Separation of carried shapes from stationary shapes along lines, in closed form.

The extents of two convex shapes along any line prove a distance between them, no matter how the line was
found. So does a plane along the motion that keeps the shapes on different sides.
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
"""Minimum length of the cross product of a shape's axis and the direction of motion from which the normal of
a plane along the motion is computed. If it is shorter, the two are parallel.
"""


def slides_along(
    moving: tuple[Shape, FloatArray],
    stationary: tuple[Shape, FloatArray],
    direction: FloatArray,
    travel: tuple[float, float],
) -> bool:
    """Return whether one shape slides along another, which supports it.

    Pairs for which this holds need no clearance. Two conditions must hold, with the gap of a bearing
    (``MAX_STANDING_GAP_M``) as limit:

    - A plane along the motion separates the shapes, and the gap across it is below the limit.
    - In the plane, the gap is below the limit across the motion, and also along the motion at both ends of
      the travel. A shape that is only passed, or left behind, is not a support.

    Args:
        moving: Moving shape with its pose (4, 4).
        stationary: Stationary shape with its pose (4, 4).
        direction: Unit vector (3,) of the motion.
        travel: Lower and upper end [m] of the motion, relative to the pose of the moving shape.
    """
    # Gap along the motion: the moving shape ahead at the upper end, or behind at the lower end of the travel.
    forward_gap = _gap_along(moving, stationary, direction)
    if (
        max(forward_gap + travel[1], _gap_along(stationary, moving, direction) - travel[0])
        >= external_axis_motion.MAX_STANDING_GAP_M
    ):
        return False
    axes = np.concatenate([pose[:3, :3].T for _, pose in (moving, stationary)])
    # Candidates for the normal of the plane: across the motion, perpendicular to or in line with an axis of
    # either shape.
    for normal in (*np.cross(axes, direction), *np.cross(np.cross(axes, direction), direction)):
        length = float(np.linalg.norm(normal))
        if length < MIN_NORMAL_LENGTH:
            continue
        n = normal / length
        m = np.cross(direction, n)  # in the plane, across the motion
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
    """Return the gap [m] along a line (3,) from the end of the other shape to the start of the first one.

    It is negative if the first shape starts before the other one ends.
    """
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
    """Report the first query at which no line proves that two shapes keep ``limit`` [m].

    The bound holds at each query. It also holds between two queries, because no point moves farther than the
    lever of the carried shapes per unit of the axis value.

    Args:
        axis: Axis that moves.
        motion: Its motion with the queries.
        carried: Shapes that move.
        stationary: Shapes that do not move, and their poses (4, 4).
        left_out: Flags (R, F) of the pairs of R moving and F stationary shapes that are not checked.
        limit: Required clearance [m].

    Returns:
        Text that names the two shapes and the axis value, empty if the clearance is proven.
    """
    carried_solids, (still_solids, still_poses) = carried.solids, stationary
    first, second = np.nonzero(~left_out)
    if not len(first):
        return ""
    cores = distance.make_cores([*carried_solids, *still_solids])
    previous: tuple[float, float] | None = None  # axis value and smallest gap [m] at the previous query
    for query in motion.samples:
        carried_poses = carried.poses_at(query)
        poses = np.stack([*carried_poses, *still_poses])
        still_rows = second + len(carried_solids)
        # Lines (P, 3) on which the P pairs are nearest, as the distance query finds them.
        lines = distance.measure_distances(cores, first, still_rows, poses[first], poses[still_rows])[1]
        gaps = [
            -extent(carried_solids[i].shape, carried_poses[i], -line)
            - extent(still_solids[j].shape, still_poses[j], line)
            for i, j, line in zip(first.tolist(), second.tolist(), lines, strict=True)
        ]
        worst_index = int(np.argmin(gaps))
        bound = gap = float(gaps[worst_index])
        if previous is not None:
            # Between two queries at distance d the gap is at least max(g0 - lever x, g1 - lever (d - x)).
            # The minimum over x is (g0 + g1 - lever d) / 2.
            bound = min(gap, 0.5 * (previous[1] + gap - carried.lever * abs(query.value - previous[0])))
        if bound < limit - DISTANCE_TOLERANCE_M:
            requirement = (
                f"{carried_solids[int(first[worst_index])].body} keeps {mm(limit):g} mm from "
                f"{still_solids[int(second[worst_index])].body}"
            )
            return f"it is not proven that {requirement} at {axis.format_value(query.value)}"
        previous = query.value, gap
    return ""


def stationary_solids(model: CellModel, excluded: set[str]) -> tuple[list[Solid], list[FloatArray]]:
    """Return the solids of stationary bodies with their poses (4, 4) in the world.

    Links (except for base links), tools, a held stock and the bodies ``excluded`` are left out.
    """
    poses = model.poses({})
    held = {"stock"} if model.stock.held_by is not None else set[str]()
    stationary = [
        solid
        for solid in model.solids
        if ("/" not in solid.body or solid.body.endswith("/base_link")) and solid.body not in excluded | held
    ]
    return stationary, [poses[s.body][0] @ s.shape.pose for s in stationary]


def is_round_about(shape: Shape, pose: FloatArray, centre: FloatArray, along: FloatArray) -> bool:
    """Return whether a shape at a pose (4, 4) is rotationally symmetric about a given axis.

    Rotation about the axis then does not move it. The axis passes through ``centre`` (3,) along the unit
    vector ``along`` (3,).
    """
    aside = float(np.linalg.norm(np.cross(pose[:3, 3] - centre, along)))
    skew = 0.0 if shape.kind == "sphere" else float(np.linalg.norm(np.cross(pose[:3, 2], along)))
    return shape.kind in ("sphere", "cylinder", "capsule") and max(aside, skew) < DISTANCE_TOLERANCE_M


def extent(shape: Shape, pose: FloatArray, line: FloatArray) -> float:
    """Return the support function of a shape at a pose: the largest coordinate [m] of its points on a line.

    The line passes through the origin, along a unit vector (3,).
    """
    local_line, middle = line @ pose[:3, :3], float(line @ pose[:3, 3])
    if shape.vertices is not None:
        return middle + float((shape.vertices @ local_line).max())
    if shape.kind == "box":
        return middle + 0.5 * float(np.abs(local_line) @ np.asarray(shape.size))
    # Spheres, capsules and cylinders: half length along z, plus the radius of the disc or the sphere.
    half_length = 0.5 * shape.size[1] * abs(float(local_line[2])) if len(shape.size) > 1 else 0.0
    across = (
        float(np.hypot(local_line[0], local_line[1]))
        if shape.kind == "cylinder"
        else float(np.linalg.norm(line))
    )
    return middle + half_length + shape.size[0] * across
