"""Where over the block each arm can work, its tool turned as the process turns it near there.

The block is looked at on a grid. At each place an arm has the poses of the target that works nearest to it,
moved there without a turn: the point of its wire, or of its tool's tip, that was nearest comes to lie on the
place. Of a wire that joins two arms both move by the same. All branches of a few samples of what the process
leaves free are looked at, with joint limits and singular postures, by the functions that maps of a freedom
use. Bodies are not held apart: what is red has no posture there among these, what is not may be in the way of
something.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IndexArray, axis_ends, inverse, spread_rows, transform
from planner.motion.axis_map import arm_states
from planner.motion.planning_scene import Scene
from planner.motion.search.subsampling import few_samples, subset
from planner.targets import Targets
from planner.tooling import Bow

MOST_PLACES: Final = 700
"""Places of the grid at most."""
MOST_TARGETS: Final = 120
"""Working targets, evenly spread, whose poses are looked at."""
MOST_SAMPLES: Final = 12
"""Samples of what the process leaves free at each place."""
WIRE_POINTS: Final = 15
"""Points of a straight wire of which the nearest one is taken to a place."""


@dataclasses.dataclass(frozen=True)
class ReachField:
    """Places ``points`` (G, 3) [m] in the world, ``pitch`` (3,) [m] apart along the block's edges. ``state``
    {arm: (G,)}: what an arm can do there, as `axis_map` numbers it. ``targets`` and ``samples`` that were
    looked at."""

    points: FloatArray
    pitch: FloatArray
    state: Mapping[str, NDArray[np.int8]]
    targets: int
    samples: int


def reach_field(scene: Scene, targets: Targets, lower: FloatArray, upper: FloatArray) -> ReachField | None:
    """The field over a standing block with these corners (3,) in the stock frame, placed as the scene has it;
    None where no target works."""
    works = np.flatnonzero([segment.works for segment in targets.segment])
    if not len(works):
        return None
    few = subset(targets, works[spread_rows(len(works), MOST_TARGETS)])
    local, pitch = _grid(lower, upper)
    points = transform(scene.stock, local)
    free = few_samples(few)
    free = free[:, spread_rows(free.shape[1], MOST_SAMPLES)]
    state = {}
    for arm in targets.arms:
        row, shift = _nearest(scene, few, arm, points)
        index = np.repeat(row[:, None], free.shape[1], axis=1)
        pose = scene.tcp(few, free[row], index)[arm].copy()
        pose[..., :3, 3] += shift[:, None]
        state[arm] = arm_states(scene, arm, pose).state
    return ReachField(points, pitch, state, few.count, free.shape[1])


def _grid(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The middles (G, 3) of equal cells, as near to cubes as their number allows, and their sizes (3,)."""
    size = np.maximum(upper - lower, 1e-9)
    edge = float(np.prod(size) / MOST_PLACES) ** (1.0 / 3.0)
    while np.prod(np.ceil(size / edge)) > MOST_PLACES:
        edge *= 1.05
    count = np.ceil(size / edge).astype(int)
    pitch = size / count
    axes = [low + step * (np.arange(n) + 0.5) for low, step, n in zip(lower, pitch, count, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), pitch


def _nearest(scene: Scene, few: Targets, arm: str, points: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Which target (G,) works nearest to each place, and from its nearest point to there (G, 3)."""
    lines = scene.edge(few, np.arange(few.count))
    if lines is None:
        tcp = scene.tcp(dataclasses.replace(few, ride={}), few.neutral())[arm]
        tool = None if scene.model is None else scene.model.cell.arm(arm).tool
        lines = tcp[:, None, :3, 3]
        if isinstance(tool, Bow):
            start, end = transform(inverse(tool.tcp), axis_ends(tool.wire))
            share = np.linspace(0.0, 1.0, WIRE_POINTS)[:, None]
            turned = np.einsum("kij,pj->kpi", tcp[:, :3, :3], start + share * (end - start))
            lines = turned + tcp[:, None, :3, 3]
    flat = lines.reshape(-1, 3)
    found = cKDTree(flat).query(points)[1]
    return found // lines.shape[1], points - flat[found]
