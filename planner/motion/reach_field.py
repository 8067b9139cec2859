"""Reach field: where over the stock each arm can work, with its tool oriented as the process requires nearby.

The stock is sampled on a grid. At each grid point an arm takes the poses of the nearest working target,
translated so that the nearest point of its wire or tool tip lies on the grid point. If a wire joins two arms,
both move by the same translation. All branches of a few samples of the freedoms are evaluated, with joint
limits and singularities, by the functions that freedom maps use. Collisions are not checked. At an infeasible
point none of these samples has a posture; at a feasible point bodies may still collide.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IndexArray, axis_ends, inverse, spread_rows, transform
from planner.motion.freedom_ranges import arm_states
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import coarse_samples, select_targets
from planner.targets import Targets
from planner.tooling import Bow

MAX_GRID_POINTS: Final = 700
"""Maximum number of grid points."""
MAX_TARGETS: Final = 120
"""Maximum number of working targets, evenly spread, whose poses are used."""
MAX_SAMPLES: Final = 12
"""Maximum number of samples of the freedoms at each grid point."""
WIRE_POINTS: Final = 15
"""Number of points of a straight wire among which the nearest one is chosen."""


@dataclasses.dataclass(frozen=True)
class ReachField:
    """Reach of each arm over a grid.

    Attributes:
        points: (G, 3) [m] grid points in the world.
        pitch: (3,) [m] spacing along the edges of the stock.
        state: {arm: (G,)} state of the arm at each point, such as
            :data:`planner.motion.freedom_ranges.NO_REACH`.
        targets: Number of targets that were used.
        samples: Number of samples that were used.
    """

    points: FloatArray
    pitch: FloatArray
    state: Mapping[str, NDArray[np.int8]]
    targets: int
    samples: int


def compute_reach_field(
    scene: Scene, targets: Targets, lower: FloatArray, upper: FloatArray
) -> ReachField | None:
    """Compute the reach field over a standing stock.

    Returns None if no target works, which means that no move of the operation works the stock.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        lower: (3,) [m] lower corner in the stock frame.
        upper: (3,) [m] upper corner in the stock frame.
    """
    working = np.flatnonzero([segment.works for segment in targets.segment])
    if not len(working):
        return None
    sampled = select_targets(targets, working[spread_rows(len(working), MAX_TARGETS)])
    local, pitch = _grid_points(lower, upper)
    points = transform(scene.stock, local)
    freedom_values = coarse_samples(sampled)
    freedom_values = freedom_values[:, spread_rows(freedom_values.shape[1], MAX_SAMPLES)]
    state = {}
    for arm in targets.arms:
        row, shift = _nearest_targets(scene, sampled, arm, points)
        index = np.repeat(row[:, None], freedom_values.shape[1], axis=1)
        pose = scene.tcp_poses(sampled, freedom_values[row], index)[arm].copy()
        pose[..., :3, 3] += shift[:, None]
        state[arm] = arm_states(scene, arm, pose).state
    return ReachField(points, pitch, state, sampled.count, freedom_values.shape[1])


def _grid_points(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Divide a box into at most :data:`MAX_GRID_POINTS` equal boxes that are nearly cubes.

    Returns their centres (G, 3) [m] in the frame of the box and their size (3,) [m].
    """
    size = np.maximum(upper - lower, 1e-9)
    edge = float(np.prod(size) / MAX_GRID_POINTS) ** (1.0 / 3.0)
    while np.prod(np.ceil(size / edge)) > MAX_GRID_POINTS:
        edge *= 1.05
    count = np.ceil(size / edge).astype(int)
    pitch = size / count
    axes = [low + step * (np.arange(n) + 0.5) for low, step, n in zip(lower, pitch, count, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), pitch


def _nearest_targets(
    scene: Scene, sampled: Targets, arm: str, points: FloatArray
) -> tuple[IndexArray, FloatArray]:
    """Find the target whose wire or tool tip is nearest to each grid point.

    Args:
        scene: Cell with the stock in its pose.
        sampled: Working targets.
        arm: Name of the arm.
        points: (G, 3) [m] grid points in the world.

    Returns:
        Index (G,) of the target in ``sampled``, and the vector (G, 3) [m] from the nearest point of its wire
        or tool tip to the grid point.
    """
    lines = scene.edge_points(sampled, np.arange(sampled.count))
    if lines is None:
        tcp = scene.tcp_poses(dataclasses.replace(sampled, track_positions={}), sampled.neutral_values())[arm]
        tool = None if scene.model is None else scene.model.cell.arm(arm).tool
        lines = tcp[:, None, :3, 3]
        if isinstance(tool, Bow):
            start, end = transform(inverse(tool.tcp), axis_ends(tool.wire))
            fractions = np.linspace(0.0, 1.0, WIRE_POINTS)[:, None]
            rotated = np.einsum("kij,pj->kpi", tcp[:, :3, :3], start + fractions * (end - start))
            lines = rotated + tcp[:, None, :3, 3]
    all_points = lines.reshape(-1, 3)
    nearest = cKDTree(all_points).query(points)[1]
    return nearest // lines.shape[1], points - all_points[nearest]
