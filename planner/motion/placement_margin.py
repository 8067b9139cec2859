"""Quality of a stock pose: smallest margin of a few targets, and their collisions.

The margin is that to joint limits and singularities, taken on the best combination of branches. The second
measure is how many targets have a free posture.
"""

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import OffsetParameters, ParallelParameters, SevenParameters
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, IntArray
from planner.motion import offset_wrist, seven_axes, three_parallel
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.subsampling import SampledTargets
from planner.problem import Settings

MAX_SCORED_MARGIN_RAD: Final = np.deg2rad(40.0)
"""Upper bound [rad] of margins in the score. Wider margins do not improve it."""
OUT_OF_REACH_TOLERANCE_M: Final = 1e-6
"""Distance [m] from the reachable region beyond which a pose has no solution despite rounding."""
FIRST_CHECKED_SAMPLES: Final = 6
"""Number of samples of a target, largest margin first, that are checked for collisions before the others."""


def placement_margin(
    sampled: SampledTargets,
    stock: FloatArray,
    bases: Mapping[str, FloatArray],
    settings: Settings,
    scored_arms: Collection[str] | None = None,
) -> FloatArray:
    """Compute the score (K,) [rad] of K stock poses: the smallest margin of all targets on the best branches.

    The placement search and the choice of stations compare poses by it. It is positive if all sampled targets
    are in reach with all margins. Collisions are not checked. A small fraction of the mean margin is added,
    see :func:`choice_scores`.

    Args:
        sampled: Sampled targets.
        stock: (K, 1, 4, 4) stock poses.
        bases: {arm: (K, 1, 4, 4)} base poses.
        settings: Required margins.
        scored_arms: Arms that count; None for all.
    """
    scene = Scene.of(sampled.cell, sampled.targets.arms, stock, settings, model=None, bases=bases)
    margins = {}
    for arm, pose, pose_index in _distinct_poses(scene, sampled, stock):
        if scored_arms is None or arm in scored_arms:
            margins[arm] = _pose_margins(scene.chains[arm], pose, settings)[0][:, pose_index]
    return np.asarray(choice_scores(margins, sampled.index).max(axis=1))


def branch_margins(
    scene: Scene, sampled: SampledTargets, stock: FloatArray, settings: Settings
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Compute margins and joints of all branches at the M sampled states of the targets.

    Where a pose is out of reach, the margin is -1 minus the distance [m] of the wrist centre from the
    reachable region.

    Args:
        scene: Cell.
        sampled: Sampled targets.
        stock: (K, 1, 4, 4) stock poses.
        settings: Required margins.

    Returns:
        Margins {arm: (K, M, B)} [rad] beyond the required ones, capped at :data:`MAX_SCORED_MARGIN_RAD`, and
        joints {arm: (K, M, B, J)} [rad] of all B branches, NaN where a pose is surely out of reach.
    """
    margins, joints = {}, {}
    for arm, pose, pose_index in _distinct_poses(scene, sampled, stock):
        pose_margins, in_reach, q = _pose_margins(scene.chains[arm], pose, settings)
        pose_joints = np.full((*pose_margins.shape, q.shape[-1]), np.nan)
        pose_joints[in_reach] = q
        margins[arm], joints[arm] = pose_margins[:, pose_index], pose_joints[:, pose_index]
    return margins, joints


def _distinct_poses(
    scene: Scene, sampled: SampledTargets, stock: FloatArray
) -> Iterator[tuple[str, FloatArray, IndexArray]]:
    """Yield for each arm its name, the distinct poses of its TCP, and the pose index of each sampled state.

    States that differ only in freedoms of the other arms share a pose, so that it is solved once. The poses
    are (K, D, 4, 4) in the world, the indices (M,).
    """
    placed = dataclasses.replace(scene, stock=stock)
    poses = placed.world_poses(sampled.targets, sampled.poses, sampled.index)
    all_states = np.arange(len(sampled.index))
    for arm in sampled.targets.arms:
        rows, pose_index = sampled.distinct_poses.get(arm, (all_states, all_states))
        pose = poses[arm][..., rows, :, :]
        shape = (*np.broadcast_shapes(pose.shape, (*stock.shape[:-2], 1, 1)),)
        yield arm, np.broadcast_to(pose, shape), pose_index


def _pose_margins(
    chain: Chain, pose: FloatArray, settings: Settings
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Compute the margins of an arm at TCP poses (K, D, 4, 4) in the world.

    Returns:
        Margins (K, D, B) as in :func:`branch_margins`; whether (K, D) a pose is not surely out of reach; and
        joints (P, B, J) [rad] of the P poses for which that is true.
    """
    gap, out_of_reach = _reach_gap_and_bound(chain, pose)
    in_reach = ~out_of_reach
    margins = np.repeat((-1.0 - gap)[..., None], chain.robot.form.branches, axis=-1)
    base = np.broadcast_to(chain.base, pose.shape)[in_reach] if chain.base.ndim > 2 else chain.base
    q = dataclasses.replace(chain, base=base).inverse(pose[in_reach])
    limit = chain.best_limit_margin(q) - settings.joint_margin
    singular = chain.singularity_margin(q) - settings.singularity_margin
    smallest = np.minimum(np.minimum(limit, singular), MAX_SCORED_MARGIN_RAD)
    margins[in_reach] = np.where(np.isfinite(smallest), smallest, margins[in_reach])
    return margins, in_reach, q


def reach_gap(chain: Chain, pose: FloatArray) -> FloatArray:
    """Return the distance (...,) [m] of the wrist centre from its reachable region.

    Args:
        chain: Chain of the arm.
        pose: (..., 4, 4) TCP poses in the world.
    """
    return _reach_gap_and_bound(chain, pose)[0]


def _reach_gap_and_bound(chain: Chain, pose: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the distances of :func:`reach_gap`, and for each pose whether it is surely out of reach.

    The second value is true only if no branch reaches the pose. Where it is false, the pose may still be out
    of reach.
    """
    form = chain.robot.form
    flange = form.inner(np.linalg.inv(chain.base) @ pose @ np.linalg.inv(chain.tcp))
    if isinstance(form, ParallelParameters):
        gap = three_parallel.reach_gap(form, flange)
        return gap, np.zeros(gap.shape, dtype=np.bool_)
    if isinstance(form, SevenParameters):
        gap = seven_axes.reach_gap(form, flange)
        return gap, np.asarray(gap > OUT_OF_REACH_TOLERANCE_M)
    if isinstance(form, OffsetParameters):
        gap = offset_wrist.reach_gap(form, flange)
        return gap, np.asarray(gap > OUT_OF_REACH_TOLERANCE_M)
    p = chain.robot.opw
    centre = flange[..., :3, 3] - p.c4 * flange[..., :3, 2]
    radius, up = np.hypot(centre[..., 0], centre[..., 1]), centre[..., 2] - p.c1
    distance = np.hypot(radius - p.a1, up)
    forearm = np.hypot(p.a2, p.c3)
    gap = np.maximum(distance - (p.c2 + forearm), abs(p.c2 - forearm) - distance)
    # distance from the closest position that axis 2 can take on any branch
    lower_bound = np.hypot(np.maximum(radius - abs(p.a1) - abs(p.b), 0.0), up)
    return np.asarray(np.maximum(gap, 0.0)), np.asarray(
        lower_bound > p.c2 + forearm + OUT_OF_REACH_TOLERANCE_M
    )


def choice_scores(margins: Mapping[str, FloatArray], index: IndexArray) -> FloatArray:
    """Compute the score (K, C) [rad] of each of the C combinations of the arms' branches.

    The margin of a target is that of its best sample, for the arm with the smallest margin. The score is the
    minimum over the targets plus 0.02 times their mean, which tells apart candidates with equal minima. The
    mean does not make a negative minimum better.

    Args:
        margins: {arm: (K, M, B)} [rad] margins of M sampled states.
        index: (M,) target of each state, in ascending order.

    Raises:
        ValueError: There are no arms.
    """
    smallest: FloatArray | None = None
    for value in margins.values():
        if smallest is None:
            smallest = value
        else:
            smallest = np.minimum(smallest[..., :, None], value[..., None, :]).reshape(*value.shape[:-1], -1)
    if smallest is None:
        raise ValueError("targets without arms have no margin")
    starts = np.flatnonzero(np.append(True, np.diff(index) > 0))
    best = np.maximum.reduceat(smallest, starts, axis=1)
    minimum = best.min(axis=1)
    mean = best.mean(axis=1)
    return np.asarray(minimum + 0.02 * np.where(minimum > 0.0, mean, np.minimum(mean, 0.0)))


BranchChoice = tuple[Mapping[str, FloatArray], FloatArray]
"""A combination of branches: joints {arm: (M, 6)} of the samples of a few targets, and their margins (M,)."""


def max_free_targets(
    scene: Scene, sampled: SampledTargets, choices: Sequence[BranchChoice], failure_counts: IntArray
) -> int:
    """Return the largest number of targets that have a free posture on the same combination of branches.

    Only samples with a margin above 0 count. On combinations after the first, the targets that fail most
    often are checked first. Their number is such that a combination can only be better than the first one if
    one of them is free. The other targets are checked only on combinations that can still be better.

    Args:
        scene: Cell with a collision model.
        sampled: Sampled targets.
        choices: Combinations of branches.
        failure_counts: (N,) how often each target has had no free posture so far. It is updated in place.
    """
    count = sampled.targets.count
    # hardest: the targets that fail most often, which are checked on all later combinations at once
    best_count, hardest = 0, np.zeros(0, dtype=np.intp)
    has_free = np.zeros((len(choices), count), dtype=np.bool_)
    for number, (_, margin) in enumerate(choices):
        pending = np.zeros(count, dtype=np.bool_)
        pending[sampled.index[margin > 0.0]] = True
        pending[hardest] &= has_free[number, hardest]
        if pending.sum() <= best_count:  # too few targets can still be free
            continue
        pending[hardest] = False
        # the samples with the largest margins first; the others only of targets without a free one
        for low, high in ((0, FIRST_CHECKED_SAMPLES), (FIRST_CHECKED_SAMPLES, len(sampled.index))):
            queried = pending & ~has_free[number]
            has_free[number] |= _have_free_sample(
                scene, sampled, choices[number : number + 1], queried, low, high
            )[0]
        failure_counts[pending & ~has_free[number]] += 1
        best_count = max(best_count, int(has_free[number].sum()))
        if best_count == count:
            break
        if not number and len(choices) > 1:
            hardest = np.argsort(-failure_counts, kind="stable")[: count - best_count]
            queried = np.isin(np.arange(count), hardest)
            has_free[1:] = _have_free_sample(scene, sampled, choices[1:], queried, 0, len(sampled.index))
            failure_counts[hardest] += (~has_free[1:, hardest]).sum(axis=0)
    return best_count


def _have_free_sample(
    scene: Scene,
    sampled: SampledTargets,
    choices: Sequence[BranchChoice],
    queried: BoolArray,
    low: int,
    high: int,
) -> BoolArray:
    """Return for C combinations and N targets whether the target has a free posture on the combination.

    Only the targets for which ``queried`` (N,) is true are checked; the others are False. Considers the
    samples of each target from rank ``low`` up to ``high`` (exclusive), ranked by decreasing
    margin.
    """
    out = np.zeros((len(choices), sampled.targets.count), dtype=np.bool_)
    rows: list[IndexArray] = []
    for _, margin in choices:
        candidates = np.flatnonzero((margin > 0.0) & queried[sampled.index])
        candidates = candidates[np.lexsort((-margin[candidates], sampled.index[candidates]))]
        rank = np.arange(len(candidates)) - np.searchsorted(
            sampled.index[candidates], sampled.index[candidates]
        )
        rows.append(candidates[(rank >= low) & (rank < high)])
    index = sampled.index[np.concatenate(rows)]
    if len(index):
        choices_with_rows = zip(choices, rows, strict=True)
        joint_parts = [
            {arm: value[sample_rows] for arm, value in q.items()} for (q, _), sample_rows in choices_with_rows
        ]
        q = {arm: np.concatenate([part[arm] for part in joint_parts]) for arm in joint_parts[0]}
        free = scene.keeps_clearance(sampled.targets, q, index)
        out[
            np.repeat(np.arange(len(rows)), [len(sample_rows) for sample_rows in rows])[free], index[free]
        ] = True
    return out
