"""Path search for an operation, by the method that suits the number of its freedoms and targets.

Tools that are to be turned toward a point, such as their robot's base, have preferred values of their spin.
This module also computes these values and reports what following them costs.

**Very many targets** (`search_on_skeleton`): the path is searched on some of them, the skeleton, arm by arm,
and then interpolated. If no freedom moves more than one arm, each arm has a layered graph of its own, and the
second arm keeps clearance to the postures of the first. Between two targets of the skeleton the freedoms
change linearly and joints follow exactly. Where that loses a branch, a limit or the clearance, the skeleton
gets more targets.
"""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, dots
from planner.geometry.units import DEG
from planner.motion.planning_scene import HELD_PREFIX, Scene
from planner.motion.search.layered_graph import MAX_JOINT_STEP_RAD, GraphPath
from planner.motion.search.layered_graph_search import (
    BlockedSearch,
    DeadEnd,
    PathResult,
    search_graph,
    speed_limits,
)
from planner.motion.search.reach import (
    SLIDE_SAMPLES,
    SPIN_STEP_RAD,
    CollisionChecker,
    OtherArms,
    SampleGrid,
    compute_reach,
    is_full_turn,
    is_sampled_as_slide,
    sample_freedoms,
)
from planner.motion.search.roadmap import search_roadmap
from planner.motion.search.subsampling import nominal_rotation, select_targets
from planner.motion.trajectory.joint_path import MoveSamples, is_clear, sample_moves
from planner.targets import Aim, Freedom, ScrewFreedom, Targets

MAX_FULL_SEARCH_TARGETS: Final = 3000
"""Number of targets above which an operation is planned on a skeleton."""

SKELETON_ROTATION_RAD: Final = np.deg2rad(20.0)
"""Approximate rotation [rad] of tool axes between targets of the skeleton."""
SKELETON_DISTANCE_M: Final = 0.1
"""Approximate distance [m] of TCPs between targets of the skeleton."""

MAX_SKELETON_TARGETS: Final = 4000
"""Maximum number of targets of the skeleton."""
MAX_SKELETONS: Final = 5
"""Maximum number of skeletons that are tried, each with more targets where the previous one failed."""
MAX_SPIN_SAMPLE_STEP: Final = 3
"""Maximum number of samples by which a spin may change between targets of the skeleton."""

COARSE_SPIN_STEP_RAD: Final = np.deg2rad(30.0)
"""Step [rad] of samples of all freedoms if full turns alone have no path."""
COARSE_SLIDE_SAMPLES: Final = 3
"""Number of samples of a slide in that case."""


def needs_skeleton(targets: Targets) -> bool:
    """Whether there are so many targets that a skeleton is needed, and nothing couples the arms.

    Freedoms, frames and edges may couple arms.
    """
    joined = targets.coupled or targets.flexible_tool is not None
    joined |= any(frame.startswith(HELD_PREFIX) for frame in targets.frame.values())
    moves_one_arm = all(isinstance(f, ScrewFreedom) and len(f.axis) == 1 for f in targets.freedoms)
    return targets.count > MAX_FULL_SEARCH_TARGETS and moves_one_arm and not joined


def search_on_skeleton(
    scene: Scene, targets: Targets
) -> tuple[SampleGrid, PathResult | BlockedSearch] | None:
    """Search a path on a skeleton of the targets.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.

    Returns:
        A path that keeps margins and clearance at and between all targets, or why one arm alone has none.
        None if each arm has a path of its own but none was found for all arms.
    """
    zero_angles = (
        np.stack(
            [
                nominal_rotation(targets, j) if is_full_turn(f) else np.zeros(targets.count)
                for j, f in enumerate(targets.freedoms)
            ],
            axis=1,
        )
        if targets.freedoms
        else np.zeros((targets.count, 0))
    )
    progress = _path_progress(targets)
    rows = _skeleton_rows(targets, progress)
    for _ in range(MAX_SKELETONS):
        skeleton = _Skeleton(scene, targets, zero_angles, progress, rows)
        grid, result = skeleton.search_arms()
        if not isinstance(result, PathResult):
            return None if result is None else (grid, result)
        full_path = skeleton.interpolate(result)
        faults = skeleton.find_faults(full_path)
        if not faults.any():
            return SampleGrid(full_path.values[:, None], np.zeros((0, 1), dtype=np.intp)), full_path
        refined = _refine_rows(rows, faults)
        if len(refined) == len(rows):
            return None
        rows = refined
    return None


@dataclasses.dataclass(frozen=True)
class _Skeleton:
    """A subset of the targets of an operation.

    Attributes:
        zero: (N, F) angle from which full turns are counted.
        progress: (N,) measure that grows along the operation.
        rows: (K,) targets of the skeleton.
    """

    scene: Scene
    targets: Targets
    zero: FloatArray
    progress: FloatArray
    rows: IndexArray

    def search_arms(self) -> tuple[SampleGrid, PathResult | BlockedSearch | None]:
        """Search a path of all arms on the skeleton; each arm avoids those before it."""
        no_samples = SampleGrid(np.zeros((0, 1, 0)), np.zeros((0, 1), dtype=np.intp))
        for order in itertools.permutations(self.targets.arms):
            results: dict[str, PathResult] = {}
            for arm in order:
                standing = {a: result.q[a] for a, result in results.items()}
                absent = frozenset(self.targets.arms) - {arm, *standing}
                grid, result = self._search_arm(arm, OtherArms(standing, absent))
                if isinstance(result, BlockedSearch) and (not standing or result.common < len(self.rows)):
                    return grid, result
                if isinstance(result, BlockedSearch):
                    break
                results[arm] = result
            if len(results) == len(order):
                return no_samples, self._combine(results)
        return no_samples, None

    def _search_arm(self, arm: str, others: OtherArms) -> tuple[SampleGrid, PathResult | BlockedSearch]:
        """Search the path of one arm: over full turns only, then over all of its freedoms."""
        arm_targets, columns = (
            select_targets(_targets_of_arm(self.targets, arm), self.rows),
            self._arm_columns(arm),
        )
        full_turns_only = dataclasses.replace(
            arm_targets,
            freedoms=tuple(map(_fix_unless_full_turn, arm_targets.freedoms, arm_targets.neutral_values().T)),
        )
        for variant, step in ((full_turns_only, None), (arm_targets, COARSE_SPIN_STEP_RAD)):
            grid = (
                sample_freedoms(variant, max_step=MAX_SPIN_SAMPLE_STEP)
                if step is None
                else sample_freedoms(variant, step, COARSE_SLIDE_SAMPLES)
            )
            grid = SampleGrid(grid.values - self.zero[self.rows][:, None, columns], grid.predecessors)
            result = search_graph(self.scene, variant, grid, others)
            if isinstance(result, PathResult) or not _has_more_range(full_turns_only, arm_targets):
                break
        if isinstance(result, BlockedSearch):
            return grid, dataclasses.replace(result, subset=(variant, self.rows))
        return grid, result

    def _arm_columns(self, arm: str) -> IndexArray:
        return np.array([j for j, f in enumerate(self.targets.freedoms) if _moves_arm(f, arm)], dtype=np.intp)

    def _combine(self, results: Mapping[str, PathResult]) -> PathResult:
        arms = self.targets.arms
        values = np.zeros((len(self.rows), len(self.targets.freedoms)))
        for arm in arms:
            values[:, self._arm_columns(arm)] = results[arm].values
        branch = {arm: results[arm].path.branch[arm] for arm in arms}
        cost = max(result.path.cost for result in results.values())
        path = GraphPath(branch, np.zeros(len(self.rows), dtype=np.intp), {}, cost)
        checks, rounds = (sum(getattr(f, name) for f in results.values()) for name in ("checks", "rounds"))
        choices = int(np.prod([result.choices for result in results.values()]))
        return PathResult(path, values, {arm: results[arm].q[arm] for arm in arms}, choices, checks, rounds)

    def interpolate(self, result: PathResult) -> PathResult:
        """The path at all targets: freedoms interpolated between those of the skeleton, joints exact."""
        targets, skeleton_progress = self.targets, self.progress[self.rows]
        values = np.zeros((targets.count, len(targets.freedoms)))
        for j, freedom in enumerate(targets.freedoms):
            skeleton_values = result.values[:, j] + self.zero[self.rows, j]
            is_ring = is_full_turn(freedom)
            column = (
                np.interp(
                    self.progress,
                    skeleton_progress,
                    np.unwrap(skeleton_values) if is_ring else skeleton_values,
                )
                - self.zero[:, j]
            )
            values[:, j] = column if is_ring else np.clip(column, freedom.lower, freedom.upper)
        q = {}
        for arm, pose in self.scene.tcp_poses(targets, values).items():
            chain = self.scene.chains[arm]
            seed = np.stack(
                [np.interp(self.progress, skeleton_progress, joint) for joint in result.q[arm].T], axis=1
            )
            q[arm] = chain.on_branch(pose, result.path.branch[arm], seed)
        path = dataclasses.replace(result.path, sample=np.zeros(targets.count, dtype=np.intp))
        return dataclasses.replace(
            result, path=path, values=values, q=q, checks=result.checks + targets.count
        )

    def find_faults(self, path: PathResult) -> BoolArray:
        """Whether (N,) a limit, the branch or the clearance is lost.

        It may be lost at a target or on the linear move to it.
        """
        scene, targets = self.scene, self.targets
        out = np.zeros(targets.count, dtype=np.bool_)
        for arm, angles in path.q.items():
            chain = scene.chains[arm]
            out |= ~(chain.limit_margin(angles) >= scene.settings.joint_margin)
            out |= ~(chain.singularity_margin(angles) >= scene.settings.singularity_margin)
            out[1:] |= ~(np.abs(np.diff(angles, axis=0)) <= MAX_JOINT_STEP_RAD).all(axis=1)
        if out.any():
            return out
        samples = sample_moves(scene, targets, path.path.branch, path.q)
        lost = np.isnan(np.concatenate(list(samples.q.values()), axis=1)).any(axis=1)
        good = np.flatnonzero(~lost)
        solved_samples = MoveSamples(
            samples.move[good], samples.fraction[good], {a: v[good] for a, v in samples.q.items()}
        )
        lost[good] = ~is_clear(scene, targets, solved_samples)
        out[samples.move[lost]] = True
        return out


def _targets_of_arm(targets: Targets, arm: str) -> Targets:
    return dataclasses.replace(
        targets,
        arms=(arm,),
        pose={arm: targets.pose[arm]},
        frame={arm: targets.frame.get(arm, "stock")},
        freedoms=tuple(f for f in targets.freedoms if _moves_arm(f, arm)),
    )


def _moves_arm(freedom: Freedom, arm: str) -> bool:
    return isinstance(freedom, ScrewFreedom) and arm in freedom.axis


def _fix_unless_full_turn(freedom: Freedom, neutral: FloatArray) -> Freedom:
    """The freedom itself if it is a full turn, else fixed at its ``neutral`` values (N,)."""
    return freedom if is_full_turn(freedom) else dataclasses.replace(freedom, lower=neutral, upper=neutral)


def _has_more_range(held: Targets, all_freedoms: Targets) -> bool:
    return any(np.any(a.upper - a.lower != b.upper - b.lower) for a, b in _freedom_pairs(held, all_freedoms))


def _freedom_pairs(held: Targets, all_freedoms: Targets) -> list[tuple[Freedom, Freedom]]:
    return list(zip(held.freedoms, all_freedoms.freedoms, strict=True))


def _path_progress(targets: Targets) -> FloatArray:
    """Measure (N,) that grows along the operation by about 1 between targets of the skeleton."""
    step = np.full(targets.count - 1, 1e-6)
    for arm, pose in targets.pose.items():
        step += np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1) / SKELETON_DISTANCE_M
        turn = np.einsum("nij,nij->n", pose[1:, :3, :3], pose[:-1, :3, :3])
        angle = np.arccos(np.clip(0.5 * (turn - 1.0), -1.0, 1.0))
        spins = [
            f.axis[arm][:3]
            for f in targets.freedoms
            if isinstance(f, ScrewFreedom) and arm in f.axis and is_full_turn(f)
        ]
        if len(spins) == 1 and np.any(spins[0]):  # rotation about the free axis does not count
            axis = pose[:, :3, :3] @ (spins[0] / np.linalg.norm(spins[0]))
            angle = np.arccos(np.clip(dots(axis[1:], axis[:-1]), -1.0, 1.0))
        step += angle / SKELETON_ROTATION_RAD
    return np.append(0.0, np.cumsum(step))


def _skeleton_rows(targets: Targets, progress: FloatArray) -> IndexArray:
    """Targets (K,) about 1 apart in ``progress`` (N,), both ends, and both ends of long moves."""
    scale = max(1.0, float(progress[-1]) / MAX_SKELETON_TARGETS)
    number = np.floor(progress / scale)
    pick = np.zeros(targets.count, dtype=np.bool_)
    pick[[0, -1]] = True
    pick[1:] |= np.diff(number) > 0
    pick[:-1] |= np.diff(progress) > 0.5 * scale
    return np.flatnonzero(pick)


def _refine_rows(rows: IndexArray, is_fault: BoolArray) -> IndexArray:
    """The skeleton with the first, the middle and the last fault between each pair of its targets added."""
    fault_rows = np.flatnonzero(is_fault)
    gap = np.searchsorted(rows, fault_rows)
    first = np.flatnonzero(np.diff(gap, prepend=-1))
    last = np.append(first[1:], len(fault_rows)) - 1
    middle = (first + last) // 2
    return np.union1d(rows, fault_rows[np.concatenate([first, middle, last])])


MAX_GRAPH_ROTATIONS = 1
"""Maximum number of rotational freedoms for a layered graph over all samples. With more it would be too
large.
"""

FINE_SAMPLING = (SPIN_STEP_RAD / 2.0, 2 * SLIDE_SAMPLES - 1)
"""Step [rad] of spins and number of samples of slides in the last attempt."""

DEAD_END_NEIGHBOURS = 16
"""Number of targets on both sides of a dead end that must have a path before more samples are tried for all
targets.
"""


def find_path(
    scene: Scene, targets: Targets, fine: bool = True
) -> tuple[SampleGrid, PathResult | BlockedSearch]:
    """Find the path of least cost.

    With few freedoms, slides and tables are first sampled in their middle, and at more positions only if that
    has no path with free moves. Finally, if ``fine``, spins and slides are sampled twice as densely. If not
    ``fine``, a dead end that more positions do not pass either ends the search, with the reasons for slides
    in their middle. Very many targets are planned on a skeleton first.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        fine: Whether the finest samples are tried.

    Returns:
        The samples, and the path or the reasons why there is none.
    """
    if needs_skeleton(targets):
        skeleton_result = search_on_skeleton(scene, targets)
        if skeleton_result is not None:
            return skeleton_result
    if count_rotational_freedoms(targets) > MAX_GRAPH_ROTATIONS:
        return search_roadmap(scene, targets)
    free_freedoms = [f for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    moves, kept = scene.model is not None, None
    slide_counts = (1, SLIDE_SAMPLES) if any(is_sampled_as_slide(f) for f in free_freedoms) else (1,)
    for slides in slide_counts:
        grid = sample_freedoms(targets, SPIN_STEP_RAD, slides)
        result = search_graph(scene, targets, grid, moves=moves)
        if isinstance(result, PathResult):
            if not result.has_colliding_moves:
                return grid, result
            kept = kept or (grid, result)
        elif slides < slide_counts[-1] and not fine and _is_dead_end(scene, targets, result):
            return grid, result
    if fine and free_freedoms:
        fine_result = _search_finely(scene, targets, result)
        if fine_result is not None and not (kept and isinstance(fine_result[1], BlockedSearch)):
            return fine_result
    return kept or (grid, result)


def _is_dead_end(scene: Scene, targets: Targets, blocked: BlockedSearch) -> bool:
    """Whether targets around a dead end have no path among themselves with more slide samples either.

    Then all targets have none.
    """
    if blocked.dead_end is None or targets.count <= 2 * DEAD_END_NEIGHBOURS:
        return False
    end = blocked.dead_end.index
    neighbourhood = select_targets(
        targets, np.arange(max(end - DEAD_END_NEIGHBOURS, 0), min(end + DEAD_END_NEIGHBOURS, targets.count))
    )
    return isinstance(
        search_graph(scene, neighbourhood, sample_freedoms(neighbourhood, SPIN_STEP_RAD, SLIDE_SAMPLES)),
        BlockedSearch,
    )


def count_rotational_freedoms(targets: Targets) -> int:
    """Number of freedoms that rotate something."""
    return sum(not is_sampled_as_slide(f) for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0)


def _search_finely(
    scene: Scene, targets: Targets, coarse_result: PathResult | BlockedSearch
) -> tuple[SampleGrid, PathResult | BlockedSearch] | None:
    """Search with the finest samples; None if they do not help.

    They must pass the target where paths end before they are used for all targets.
    """
    moves = scene.model is not None
    if isinstance(coarse_result, BlockedSearch):
        if coarse_result.dead_end is not None and _is_blocked_finely(scene, targets, coarse_result.dead_end):
            return None
        rows = np.arange(min(_end_index(coarse_result) + 2, targets.count))
        first_targets = select_targets(targets, rows)
        grid = sample_freedoms(first_targets, *FINE_SAMPLING)
        tried_branches = coarse_result.dead_end.tried if coarse_result.dead_end is not None else None
        first_result = search_graph(scene, first_targets, grid, moves=moves, only=tried_branches)
        if isinstance(first_result, BlockedSearch):
            if (
                first_result.dead_end is None
                or coarse_result.dead_end is None
                or first_result.dead_end.index < coarse_result.dead_end.index
            ):
                return None
            later = coarse_result.dead_end.later if not first_result.dead_end.free.any() else None
            later = later if later is not None and later[1] > first_result.dead_end.index else None
            dead = dataclasses.replace(first_result.dead_end, later=later)
            return grid, dataclasses.replace(first_result, dead_end=dead, common=targets.count)
    grid = sample_freedoms(targets, *FINE_SAMPLING)
    return grid, search_graph(scene, targets, grid, moves=moves)


def _is_blocked_finely(scene: Scene, targets: Targets, dead_end: DeadEnd) -> bool:
    """Whether the target where paths end is not free with the finest samples either, on any branches."""
    single_target = select_targets(targets, np.array([dead_end.index]))
    grid = sample_freedoms(single_target, *FINE_SAMPLING)
    table = compute_reach(scene, single_target, grid)
    for branches in dead_end.tried:
        if all(b in r.branches for r, b in zip(table.values(), branches, strict=True)):
            rungs = {arm: r.branches[b] for (arm, r), b in zip(table.items(), branches, strict=True)}
            if CollisionChecker(scene, single_target, grid, rungs).free_samples(0).any():
                return False
    return True


def _end_index(blocked: BlockedSearch) -> int:
    if blocked.dead_end is not None:
        return blocked.dead_end.index
    ends = [int(np.argmin(r.exists, axis=1).max()) for r in blocked.reach.values() if not r.branches]
    return min(ends) if ends else blocked.common


SPIN_COLUMNS: Final = (
    "spin",
    "joint motion [deg]",
    "largest by one joint",
    "[deg]",
    "at full joint speed [s]",
    "smallest margin to limits [deg]",
    "smallest margin to singularities [deg]",
)
"""Headings of the table of spins in reports."""


def with_aims(scene: Scene, targets: Targets) -> Targets:
    """Add preferred values to every spin that has an aim to follow."""
    if not any(_aim_of(f) is not None for f in targets.freedoms):
        return targets
    freedoms = []
    for freedom in targets.freedoms:
        aim = _aim_of(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None and aim.is_preferred:
            freedom = dataclasses.replace(
                freedom, prefer=aimed_values(scene, targets, freedom, aim), weight=aim.weight
            )
        freedoms.append(freedom)
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def aimed_values(scene: Scene, targets: Targets, freedom: ScrewFreedom, aim: Aim) -> FloatArray:
    """Values (N,) [rad] of a spin at which its ray points to the aim as closely as a rotation allows."""
    pose = scene.world_poses(targets, {arm: targets.pose[arm] for arm in targets.arms})[aim.arm]
    if aim.point is None:
        aim_point = scene.chains[aim.arm].base[:3, 3]
    else:
        frames = scene.world_poses(targets, {arm: np.eye(4) for arm in targets.arms})[aim.arm]
        aim_point = frames[..., :3, :3] @ aim.point + frames[..., :3, 3]
    direction = np.einsum("nji,nj->ni", pose[:, :3, :3], aim_point - pose[:, :3, 3])
    axis = freedom.axis[aim.arm][:3] / np.linalg.norm(freedom.axis[aim.arm][:3])
    across = direction - (direction @ axis)[:, None] * axis
    angle = np.arctan2(np.cross(aim.ray, across) @ axis, across @ aim.ray)
    return np.asarray(np.clip(angle, freedom.lower, freedom.upper))


def aim_exhibit(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Table for the report that compares the plan with a path that always aims and one that never does.

    Empty if nothing aims.
    """
    aims = [f for f in targets.freedoms if _aim_of(f) is not None]
    if not aims:
        return {}
    # the free path first: its samples are those of the plan, whose reach is cached
    free = _path_figures(scene, targets, _without_aim(targets))
    held = _path_figures(scene, targets, _fixed_at_aim(scene, targets))
    rows = [
        ("as planned", *_format_figures(scene, targets, q)),
        ("always toward the base, not optimised", *held),
        ("free, not optimised", *free),
    ]
    columns = tuple(c for c in SPIN_COLUMNS if c != "[deg]")
    return {
        "aim": {
            "kind": "table",
            "title": "Effect of turning the tool toward the base",
            "columns": columns,
            "rows": rows,
        }
    }


def _path_figures(scene: Scene, targets: Targets, freedoms: tuple[Any, ...]) -> tuple[str, ...]:
    """Figures of the path of the targets with other freedoms."""
    other = dataclasses.replace(targets, freedoms=freedoms, exhibits={}, claims=())
    _, result = find_path(scene, other)
    return (
        _format_figures(scene, other, result.q) if isinstance(result, PathResult) else ("no path", *[""] * 4)
    )


def _format_figures(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> tuple[str, ...]:
    total_motion, largest, time, limit, singularity = 0.0, 0.0, 0.0, np.inf, np.inf
    for arm in targets.arms:
        chain = scene.chains[arm]
        steps = np.abs(np.diff(q[arm], axis=0))
        total_motion += float(steps.sum())
        largest = max(largest, float(steps.sum(axis=0).max()))
        time = max(time, float((steps / speed_limits(scene, arm)).max(axis=1).sum()))
        limit = min(limit, float(chain.limit_margin(q[arm]).min()))
        singularity = min(singularity, float(chain.singularity_margin(q[arm]).min()))
    shown = [total_motion / DEG, largest / DEG, time, limit / DEG, singularity / DEG]
    return tuple(f"{value:.{digits}f}" for value, digits in zip(shown, (0, 0, 1, 1, 1), strict=True))


def _fixed_at_aim(scene: Scene, targets: Targets) -> tuple[Any, ...]:
    out = []
    for freedom in targets.freedoms:
        aim = _aim_of(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None:
            held = aimed_values(scene, targets, freedom, aim)
            freedom = dataclasses.replace(freedom, lower=held, upper=held, prefer=None, aim=None)
        out.append(freedom)
    return tuple(out)


def _without_aim(targets: Targets) -> tuple[Any, ...]:
    return tuple(
        dataclasses.replace(f, prefer=None, aim=None)
        if isinstance(f, ScrewFreedom) and _aim_of(f) is not None
        else f
        for f in targets.freedoms
    )


def _aim_of(freedom: object) -> Aim | None:
    return freedom.aim if isinstance(freedom, ScrewFreedom) else None
