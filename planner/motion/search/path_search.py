"""Path search for an operation, by the method that suits the number of its freedoms and targets.

Tools that are to be turned toward a point, such as the base of their arm, have preferred values of their
spin. This module also computes these values and reports what following them costs.

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
    """Whether the path has to be searched on a skeleton, and can be.

    It has to with more than :data:`MAX_FULL_SEARCH_TARGETS` targets. It can if the arms are independent: no
    freedom moves more than one arm, no arm holds a work frame of another, and no wire joins them.
    """
    are_coupled = targets.coupled or targets.flexible_tool is not None
    are_coupled |= any(frame.startswith(HELD_PREFIX) for frame in targets.frame.values())
    moves_one_arm = all(isinstance(f, ScrewFreedom) and len(f.axis) == 1 for f in targets.freedoms)
    return targets.count > MAX_FULL_SEARCH_TARGETS and moves_one_arm and not are_coupled


def search_on_skeleton(
    scene: Scene, targets: Targets
) -> tuple[SampleGrid, PathResult | BlockedSearch] | None:
    """Search a path on a skeleton of the targets, and interpolate it to all of them.

    Where the interpolated path has faults, the skeleton gets more targets, up to :data:`MAX_SKELETONS` times.
    If the result is None, the caller searches all targets.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.

    Returns:
        Samples, and a path that keeps margins and clearance at and between all targets or the reasons why one
        arm alone has none. None if each arm has a path of its own, but none was found for all arms.
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
        is_faulty = skeleton.find_faults(full_path)
        if not is_faulty.any():
            return SampleGrid(full_path.values[:, None], np.zeros((0, 1), dtype=np.intp)), full_path
        refined_rows = _refine_rows(rows, is_faulty)
        if len(refined_rows) == len(rows):
            return None
        rows = refined_rows
    return None


@dataclasses.dataclass(frozen=True)
class _Skeleton:
    """A subset of the targets of an operation.

    Attributes:
        scene: Cell with the stock in its pose.
        targets: All N targets of the operation.
        zero: (N, F) [rad] angle from which full turns are counted; 0 for other freedoms.
        progress: (N,) measure that grows along the operation, as by :func:`_path_progress`.
        rows: (K,) indices of the targets of the skeleton.
    """

    scene: Scene
    targets: Targets
    zero: FloatArray
    progress: FloatArray
    rows: IndexArray

    def search_arms(self) -> tuple[SampleGrid, PathResult | BlockedSearch | None]:
        """Search a path of all arms on the skeleton, arm by arm. Each arm avoids those before it.

        Returns:
            Samples, and the path or why one arm alone has none; None instead of a path if each arm has one of
            its own, but no order of the arms led to paths of all of them.
        """
        no_samples = SampleGrid(np.zeros((0, 1, 0)), np.zeros((0, 1), dtype=np.intp))
        for order in itertools.permutations(self.targets.arms):
            results: dict[str, PathResult] = {}
            for arm in order:
                standing = {a: result.q[a] for a, result in results.items()}
                absent = frozenset(self.targets.arms) - {arm, *standing}
                grid, result = self._search_arm(arm, OtherArms(standing, absent))
                # without other arms to avoid, or without reach, no other order of the arms helps
                if isinstance(result, BlockedSearch) and (not standing or result.common < len(self.rows)):
                    return grid, result
                if isinstance(result, BlockedSearch):
                    break
                results[arm] = result
            if len(results) == len(order):
                return no_samples, self._combine(results)
        return no_samples, None

    def _search_arm(self, arm: str, others: OtherArms) -> tuple[SampleGrid, PathResult | BlockedSearch]:
        """Search the path of one arm on the skeleton: over full turns only, then over all of its freedoms.

        ``others`` are the arms that have paths already, which this arm avoids, and those that it ignores.
        """
        arm_targets = select_targets(_targets_of_arm(self.targets, arm), self.rows)
        columns = self._arm_columns(arm)
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
        """Return the indices of the freedoms that move an arm."""
        return np.array([j for j, f in enumerate(self.targets.freedoms) if _moves_arm(f, arm)], dtype=np.intp)

    def _combine(self, results: Mapping[str, PathResult]) -> PathResult:
        """Combine the paths of the single arms into one path of all arms on the skeleton.

        Its cost is that of the slowest arm. Checks and rounds are summed, and choices multiplied.
        """
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
        """Extend a path on the skeleton to all targets.

        Freedoms are interpolated over the progress, and joints are computed exactly. Joints are NaN where the
        branch is lost.
        """
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
        """Return for each of N targets whether a path violates a margin, its branch or the clearance there.

        It may do so at the target or on the linear move to it. Clearance and moves are checked only if all
        targets keep their margins.
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
        solved = np.flatnonzero(~lost)
        solved_samples = MoveSamples(
            samples.move[solved], samples.fraction[solved], {a: v[solved] for a, v in samples.q.items()}
        )
        lost[solved] = ~is_clear(scene, targets, solved_samples)
        out[samples.move[lost]] = True
        return out


def _targets_of_arm(targets: Targets, arm: str) -> Targets:
    """Return the targets of one arm alone, with the freedoms that move it."""
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
    """Return a full turn unchanged, and any other freedom fixed at its neutral values (N,)."""
    return freedom if is_full_turn(freedom) else dataclasses.replace(freedom, lower=neutral, upper=neutral)


def _has_more_range(fixed: Targets, free: Targets) -> bool:
    """Whether a freedom of ``free`` has another range than the same freedom of ``fixed``."""
    return any(np.any(a.upper - a.lower != b.upper - b.lower) for a, b in _freedom_pairs(fixed, free))


def _freedom_pairs(fixed: Targets, free: Targets) -> list[tuple[Freedom, Freedom]]:
    return list(zip(fixed.freedoms, free.freedoms, strict=True))


def _path_progress(targets: Targets) -> FloatArray:
    """Compute a measure (N,) that grows along the operation by about 1 between targets of the skeleton.

    It is the path length of the TCPs in units of :data:`SKELETON_DISTANCE_M` plus their rotation in units of
    :data:`SKELETON_ROTATION_RAD`, summed over the arms.
    """
    step = np.full(targets.count - 1, 1e-6)
    for arm, pose in targets.pose.items():
        step += np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1) / SKELETON_DISTANCE_M
        # the angle of a rotation R follows from its trace: cos(angle) = (tr R - 1) / 2
        trace = np.einsum("nij,nij->n", pose[1:, :3, :3], pose[:-1, :3, :3])
        angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
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
    """Choose the targets (K,) of the first skeleton.

    They are about 1 apart in ``progress`` (N,), or farther if there would be more than
    :data:`MAX_SKELETON_TARGETS`. Both ends of the operation and of long moves are included.
    """
    scale = max(1.0, float(progress[-1]) / MAX_SKELETON_TARGETS)
    number = np.floor(progress / scale)
    is_chosen = np.zeros(targets.count, dtype=np.bool_)
    is_chosen[[0, -1]] = True
    # the first target of each unit of progress, and the start of each move longer than half a unit
    is_chosen[1:] |= np.diff(number) > 0
    is_chosen[:-1] |= np.diff(progress) > 0.5 * scale
    return np.flatnonzero(is_chosen)


def _refine_rows(rows: IndexArray, is_faulty: BoolArray) -> IndexArray:
    """Add faulty targets to a skeleton: the first, the middle and the last one of each of its gaps."""
    fault_rows = np.flatnonzero(is_faulty)
    gap = np.searchsorted(rows, fault_rows)  # the gap between targets of the skeleton in which a fault lies
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
    """Find the path of least cost over branches, freedoms and turns that keeps margins and clearance.

    With at most one rotational freedom, a layered graph is searched with more and more samples, until a path
    has free moves:

    1. Slides and tables are sampled in their middle.
    2. They are sampled at :data:`SLIDE_SAMPLES` positions. If not ``fine`` and these do not help near the
       dead end of the first search either, this search is skipped.
    3. If ``fine``, spins and slides are sampled twice as densely.

    With several rotational freedoms a roadmap is searched (:func:`search_roadmap`). Very many targets are
    searched on a skeleton first (:func:`search_on_skeleton`).

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
    moves, colliding_result = scene.model is not None, None
    slide_counts = (1, SLIDE_SAMPLES) if any(is_sampled_as_slide(f) for f in free_freedoms) else (1,)
    for slides in slide_counts:
        grid = sample_freedoms(targets, SPIN_STEP_RAD, slides)
        result = search_graph(scene, targets, grid, moves=moves)
        if isinstance(result, PathResult):
            if not result.has_colliding_moves:
                return grid, result
            colliding_result = colliding_result or (grid, result)
        elif slides < slide_counts[-1] and not fine and _is_dead_end(scene, targets, result):
            return grid, result
    if fine and free_freedoms:
        fine_result = _search_finely(scene, targets, result)
        if fine_result is not None and not (colliding_result and isinstance(fine_result[1], BlockedSearch)):
            return fine_result
    return colliding_result or (grid, result)


def _is_dead_end(scene: Scene, targets: Targets, blocked: BlockedSearch) -> bool:
    """Whether the targets around a dead end have no path with more slide samples either.

    The neighbouring targets are searched alone. If they have no path, all targets have none. False if the
    search has no dead end, or if there are too few targets for this to save time.
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
    """Return the number of freedoms that rotate something and have a range."""
    return sum(not is_sampled_as_slide(f) for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0)


def _search_finely(
    scene: Scene, targets: Targets, coarse_result: PathResult | BlockedSearch
) -> tuple[SampleGrid, PathResult | BlockedSearch] | None:
    """Search with the finest samples.

    If the coarse search failed, the finest samples are tried first at the target where its paths end, then up
    to that target, and only then for all targets.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        coarse_result: Result of the search with coarser samples.

    Returns:
        The samples, and the path or better reasons why there is none; None if the finest samples do not help.
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
            # Only the first targets were searched, so a later free target is known from the coarse search.
            later = coarse_result.dead_end.later if not first_result.dead_end.free.any() else None
            later = later if later is not None and later[1] > first_result.dead_end.index else None
            dead_end = dataclasses.replace(first_result.dead_end, later=later)
            return grid, dataclasses.replace(first_result, dead_end=dead_end, common=targets.count)
    grid = sample_freedoms(targets, *FINE_SAMPLING)
    return grid, search_graph(scene, targets, grid, moves=moves)


def _is_blocked_finely(scene: Scene, targets: Targets, dead_end: DeadEnd) -> bool:
    """Whether the target where paths end has no free sample among the finest ones either.

    All branch combinations that the coarse search tried are checked. If none has a free sample, a finer
    search of all targets cannot succeed.
    """
    single_target = select_targets(targets, np.array([dead_end.index]))
    grid = sample_freedoms(single_target, *FINE_SAMPLING)
    reach = compute_reach(scene, single_target, grid)
    for branches in dead_end.tried:
        if all(b in r.branches for r, b in zip(reach.values(), branches, strict=True)):
            states = {arm: r.branches[b] for (arm, r), b in zip(reach.items(), branches, strict=True)}
            if CollisionChecker(scene, single_target, grid, states).free_samples(0).any():
                return False
    return True


def _end_index(blocked: BlockedSearch) -> int:
    """Return the target at which paths end: a dead end, or where the first arm without a branch fails."""
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
    """Return the targets with preferred values for every spin that should follow an aim.

    Targets without such a spin are returned themselves.
    """
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
    """Compute values (N,) [rad] of a spin at which a ray of the tool aims at a point as closely as possible.

    Args:
        scene: Cell with the stock in its pose.
        targets: N targets.
        freedom: The spin.
        aim: The ray in the frame of the tool, and the point in the work frame; without a point it is the base
            of the arm.
    """
    pose = scene.world_poses(targets, {arm: targets.pose[arm] for arm in targets.arms})[aim.arm]
    if aim.point is None:
        aim_point = scene.chains[aim.arm].base[:3, 3]
    else:
        frames = scene.world_poses(targets, {arm: np.eye(4) for arm in targets.arms})[aim.arm]
        aim_point = frames[..., :3, :3] @ aim.point + frames[..., :3, 3]
    direction = np.einsum("nji,nj->ni", pose[:, :3, :3], aim_point - pose[:, :3, 3])  # in the tool's frame
    axis = freedom.axis[aim.arm][:3] / np.linalg.norm(freedom.axis[aim.arm][:3])
    across = direction - (direction @ axis)[:, None] * axis
    angle = np.arctan2(np.cross(aim.ray, across) @ axis, across @ aim.ray)
    return np.asarray(np.clip(angle, freedom.lower, freedom.upper))


def aim_exhibit(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return a table for the report that shows what following the aims costs.

    It compares the plan with a path that always aims and one that never does. Empty if no spin has an aim.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        q: {arm: (N, J)} [rad] planned joints.
    """
    aimed_freedoms = [f for f in targets.freedoms if _aim_of(f) is not None]
    if not aimed_freedoms:
        return {}
    # the free path first: its samples are those of the plan, whose reach is cached
    free_cells = _path_cells(scene, targets, _without_aim(targets))
    aimed_cells = _path_cells(scene, targets, _fixed_at_aim(scene, targets))
    rows = [
        ("as planned", *_format_cells(scene, targets, q)),
        ("always toward the base, not optimised", *aimed_cells),
        ("free, not optimised", *free_cells),
    ]
    columns = tuple(c for c in SPIN_COLUMNS if c != "[deg]")  # without the heading that has no cells
    return {
        "aim": {
            "kind": "table",
            "title": "Effect of turning the tool toward the base",
            "columns": columns,
            "rows": rows,
        }
    }


def _path_cells(scene: Scene, targets: Targets, freedoms: tuple[Any, ...]) -> tuple[str, ...]:
    """Search a path of the targets with other freedoms, and return its cells of the table of spins."""
    changed_targets = dataclasses.replace(targets, freedoms=freedoms, exhibits={}, claims=())
    _, result = find_path(scene, changed_targets)
    if not isinstance(result, PathResult):
        return ("no path", *[""] * 4)
    return _format_cells(scene, changed_targets, result.q)


def _format_cells(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Format motion, time and smallest margins of joint paths {arm: (N, J)} as table cells.

    The columns are those of :data:`SPIN_COLUMNS` after the first: the sum of all joint changes [deg], the
    largest of one joint [deg], the time [s] at full joint speed, and both margins [deg].
    """
    total_motion, largest, time, limit, singularity = 0.0, 0.0, 0.0, np.inf, np.inf
    for arm in targets.arms:
        chain = scene.chains[arm]
        steps = np.abs(np.diff(q[arm], axis=0))
        total_motion += float(steps.sum())
        largest = max(largest, float(steps.sum(axis=0).max()))
        time = max(time, float((steps / speed_limits(scene, arm)).max(axis=1).sum()))
        limit = min(limit, float(chain.limit_margin(q[arm]).min()))
        singularity = min(singularity, float(chain.singularity_margin(q[arm]).min()))
    values = [total_motion / DEG, largest / DEG, time, limit / DEG, singularity / DEG]
    return tuple(f"{value:.{digits}f}" for value, digits in zip(values, (0, 0, 1, 1, 1), strict=True))


def _fixed_at_aim(scene: Scene, targets: Targets) -> tuple[Any, ...]:
    """Return the freedoms of the targets, where spins with an aim are fixed at their aimed values."""
    out = []
    for freedom in targets.freedoms:
        aim = _aim_of(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None:
            values = aimed_values(scene, targets, freedom, aim)
            freedom = dataclasses.replace(freedom, lower=values, upper=values, prefer=None, aim=None)
        out.append(freedom)
    return tuple(out)


def _without_aim(targets: Targets) -> tuple[Any, ...]:
    """Return the freedoms of the targets, where spins with an aim have no aim and no preferred values."""
    return tuple(
        dataclasses.replace(f, prefer=None, aim=None)
        if isinstance(f, ScrewFreedom) and _aim_of(f) is not None
        else f
        for f in targets.freedoms
    )


def _aim_of(freedom: object) -> Aim | None:
    """Return the aim of a spin; None if the freedom is not a spin or has no aim."""
    return freedom.aim if isinstance(freedom, ScrewFreedom) else None
