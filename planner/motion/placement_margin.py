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
    """Smallest margin (K,) [rad] over all targets for K stock poses, on the best branches.

    Args:
        sampled: Sampled targets.
        stock: (K, 1, 4, 4) stock poses.
        bases: {arm: (K, 1, 4, 4)} base poses.
        settings: Required margins.
        scored_arms: Arms that count; None for all.
    """
    scene = Scene.of(sampled.cell, sampled.targets.arms, stock, settings, None, bases)
    margins = {}
    for arm, pose, back in _distinct_poses(scene, sampled, stock):
        if scored_arms is None or arm in scored_arms:
            margins[arm] = _pose_margins(scene.chains[arm], pose, settings)[0][:, back]
    return np.asarray(choice_scores(margins, sampled.index).max(axis=1))


def branch_margins(
    scene: Scene, sampled: SampledTargets, stock: FloatArray, settings: Settings
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Margins and joints of all branches at M sampled states.

    Where a pose is out of reach, the margin is -1 minus the distance [m] of the wrist centre from the
    reachable region.

    Args:
        scene: Cell.
        sampled: Sampled targets.
        stock: (K, 1, 4, 4) stock poses.
        settings: Required margins.

    Returns:
        Margins {arm: (K, M, B)} beyond the required ones, capped at :data:`MAX_SCORED_MARGIN_RAD`, and joints
        {arm: (K, M, B, J)} of all B branches.
    """
    out, joints = {}, {}
    for arm, pose, back in _distinct_poses(scene, sampled, stock):
        value, in_reach, q = _pose_margins(scene.chains[arm], pose, settings)
        every = np.full((*value.shape, q.shape[-1]), np.nan)
        every[in_reach] = q
        out[arm], joints[arm] = value[:, back], every[:, back]
    return out, joints


def _distinct_poses(
    scene: Scene, sampled: SampledTargets, stock: FloatArray
) -> Iterator[tuple[str, FloatArray, IndexArray]]:
    """Yield for each arm the distinct poses of its TCP and the pose index of each state.

    The poses are (K, D, 4, 4), the indices (M,).
    """
    placed = dataclasses.replace(scene, stock=stock)
    poses = placed.world_poses(sampled.targets, sampled.poses, sampled.index)
    every = np.arange(len(sampled.index))
    for arm in sampled.targets.arms:
        rows, back = sampled.distinct_poses.get(arm, (every, every))
        pose = poses[arm][..., rows, :, :]
        shape = (*np.broadcast_shapes(pose.shape, (*stock.shape[:-2], 1, 1)),)
        yield arm, np.broadcast_to(pose, shape), back


def _pose_margins(
    chain: Chain, pose: FloatArray, settings: Settings
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Margins (K, D, B) of an arm at poses (K, D, 4, 4), the poses to solve, and their joints.

    The second value are the poses (K, D) that are not surely out of reach. Joints (P, B, J) are computed only
    for these P poses.
    """
    gap, out_of_reach = _reach_gap_and_bound(chain, pose)
    in_reach = ~out_of_reach
    value = np.repeat((-1.0 - gap)[..., None], chain.robot.form.branches, axis=-1)
    base = np.broadcast_to(chain.base, pose.shape)[in_reach] if chain.base.ndim > 2 else chain.base
    q = dataclasses.replace(chain, base=base).inverse(pose[in_reach])
    limit = chain.best_limit_margin(q) - settings.joint_margin
    singular = chain.singularity_margin(q) - settings.singularity_margin
    smallest = np.minimum(np.minimum(limit, singular), MAX_SCORED_MARGIN_RAD)
    value[in_reach] = np.where(np.isfinite(smallest), smallest, value[in_reach])
    return value, in_reach, q


def reach_gap(chain: Chain, pose: FloatArray) -> FloatArray:
    """Distance (...,) [m] of the wrist centre at TCP poses (..., 4, 4) from the reachable region."""
    return _reach_gap_and_bound(chain, pose)[0]


def _reach_gap_and_bound(chain: Chain, pose: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Distances as in :func:`reach_gap`, and whether a pose is surely out of reach.

    The second value (...,) is true if the pose is out of reach for every branch.
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
    out, up = np.hypot(centre[..., 0], centre[..., 1]), centre[..., 2] - p.c1
    distance = np.hypot(out - p.a1, up)
    forearm = np.hypot(p.a2, p.c3)
    gap = np.maximum(distance - (p.c2 + forearm), abs(p.c2 - forearm) - distance)
    lower_bound = np.hypot(
        np.maximum(out - abs(p.a1) - abs(p.b), 0.0), up
    )  # for the closest shoulder position
    return np.asarray(np.maximum(gap, 0.0)), np.asarray(
        lower_bound > p.c2 + forearm + OUT_OF_REACH_TOLERANCE_M
    )


def choice_scores(margins: Mapping[str, FloatArray], index: IndexArray) -> FloatArray:
    """Score (K, B ** arms) of each combination of branches.

    The score is the minimum over the targets of the best sample, plus 0.02 times the mean over the targets.

    Args:
        margins: {arm: (K, M, B)} margins of M sampled states.
        index: (M,) target of each state, in ascending order.

    Raises:
        ValueError: There are no arms.
    """
    total: FloatArray | None = None
    for value in margins.values():
        if total is None:
            total = value
        else:
            total = np.minimum(total[..., :, None], value[..., None, :]).reshape(*value.shape[:-1], -1)
    if total is None:
        raise ValueError("targets without arms have no margin")
    starts = np.flatnonzero(np.append(True, np.diff(index) > 0))
    best = np.maximum.reduceat(total, starts, axis=1)
    minimum = best.min(axis=1)
    mean = best.mean(axis=1)
    return np.asarray(minimum + 0.02 * np.where(minimum > 0.0, mean, np.minimum(mean, 0.0)))


BranchChoice = tuple[Mapping[str, FloatArray], FloatArray]
"""A combination of branches: joints {arm: (M, 6)} of the samples of a few targets, and their margins (M,)."""


def max_free_targets(
    scene: Scene, sampled: SampledTargets, choices: Sequence[BranchChoice], failure_counts: IntArray
) -> int:
    """Largest number of targets that have a free posture on the same combination of branches.

    Only samples with a margin above 0 count. Of combinations after the first, the targets that fail most
    often are checked first. So many are checked that at least one of them must be free if the combination is
    to be better than the best so far. The rest is checked only if one is.

    Args:
        scene: Cell with a collision model.
        sampled: Sampled targets.
        choices: Combinations of branches.
        failure_counts: (N,) how often each target has had no free posture so far. It is updated in place.
    """
    count = sampled.targets.count
    best, hardest = 0, np.zeros(0, dtype=np.intp)
    has_free = np.zeros((len(choices), count), dtype=np.bool_)
    for number, (_, margin) in enumerate(choices):
        pending = np.zeros(count, dtype=np.bool_)
        pending[sampled.index[margin > 0.0]] = True
        pending[hardest] &= has_free[number, hardest]
        if pending.sum() <= best:
            continue
        pending[hardest] = False
        for low, high in ((0, FIRST_CHECKED_SAMPLES), (FIRST_CHECKED_SAMPLES, len(sampled.index))):
            queried = pending & ~has_free[number]
            has_free[number] |= _have_free_sample(
                scene, sampled, choices[number : number + 1], queried, low, high
            )[0]
        failure_counts[pending & ~has_free[number]] += 1
        best = max(best, int(has_free[number].sum()))
        if best == count:
            break
        if not number and len(choices) > 1:
            hardest = np.argsort(-failure_counts, kind="stable")[: count - best]
            queried = np.isin(np.arange(count), hardest)
            has_free[1:] = _have_free_sample(scene, sampled, choices[1:], queried, 0, len(sampled.index))
            failure_counts[hardest] += (~has_free[1:, hardest]).sum(axis=0)
    return best


def _have_free_sample(
    scene: Scene,
    sampled: SampledTargets,
    choices: Sequence[BranchChoice],
    queried: BoolArray,
    low: int,
    high: int,
) -> BoolArray:
    """Whether (C, N) the ``queried`` targets (N,) have a free posture on each combination.

    Considers the samples of each target from rank ``low`` up to ``high`` (exclusive), ranked by decreasing
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
        pairs = zip(choices, rows, strict=True)
        joint_parts = [{arm: value[sample_rows] for arm, value in q.items()} for (q, _), sample_rows in pairs]
        q = {arm: np.concatenate([part[arm] for part in joint_parts]) for arm in joint_parts[0]}
        free = scene.keeps_clearance(sampled.targets, q, index)
        out[
            np.repeat(np.arange(len(rows)), [len(sample_rows) for sample_rows in rows])[free], index[free]
        ] = True
    return out
