"""How good a place of the stock is for a job: the least margin of a few targets to limits and singular
postures on the best choice of branches, and how many of them have a free posture.
"""

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import OffsetParameters, ParallelParameters, SevenParameters
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, IntArray
from planner.motion import offset_wrist, seven_axes, three_parallel
from planner.motion.planning_scene import Chain, Scene
from planner.motion.search.subsampling import Few
from planner.problem import Settings

ENOUGH_MARGIN_RAD: Final = np.deg2rad(40.0)
"""Margins wider than this [rad] count no more."""
SURELY_OUT_M: Final = 1e-6
"""Poses farther out of reach than this [m] have no joints, whatever rounding does."""
LOOKED_FIRST: Final = 6
"""Samples of a target, those with most margin, that are looked at for collisions before the others."""


def margin(
    few: Few,
    stock: FloatArray,
    bases: Mapping[str, FloatArray],
    settings: Settings,
    judged: Collection[str] | None = None,
) -> FloatArray:
    """Least margin (K,) [rad] over all targets for K places (K, 1, 4, 4) of stock and bases, with the best
    branches; of the arms ``judged``, or of all."""
    scene = Scene.of(few.cell, few.targets.arms, stock, settings, None, bases)
    margins = {}
    for arm, pose, back in _poses_at(scene, few, stock):
        if judged is None or arm in judged:
            margins[arm] = _margins(scene.chains[arm], pose, settings)[0][:, back]
    return np.asarray(choice_scores(margins, few.index).max(axis=1))


def margins_at(
    scene: Scene, few: Few, stock: FloatArray, settings: Settings
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Margins {arm: (K, M, B)} beyond the hard ones, capped, and joints {arm: (K, M, B, J)} of all B
    branches, for M sampled states.

    Out of reach the margin is -1 less the distance [m] by which the wrist's centre is out of reach.
    """
    out, joints = {}, {}
    for arm, pose, back in _poses_at(scene, few, stock):
        value, near, q = _margins(scene.chains[arm], pose, settings)
        every = np.full((*value.shape, q.shape[-1]), np.nan)
        every[near] = q
        out[arm], joints[arm] = value[:, back], every[:, back]
    return out, joints


def _poses_at(scene: Scene, few: Few, stock: FloatArray) -> Iterator[tuple[str, FloatArray, IndexArray]]:
    """Each arm with the different poses (K, D, 4, 4) of its TCP, and which of them each state (M,) has."""
    placed = dataclasses.replace(scene, stock=stock)
    poses = placed.world(few.targets, few.poses, few.index)
    every = np.arange(len(few.index))
    for arm in few.targets.arms:
        rows, back = few.distinct_poses.get(arm, (every, every))
        pose = poses[arm][..., rows, :, :]
        shape = (*np.broadcast_shapes(pose.shape, (*stock.shape[:-2], 1, 1)),)
        yield arm, np.broadcast_to(pose, shape), back


def _margins(chain: Chain, pose: FloatArray, settings: Settings) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Margins (K, D, B) of an arm at poses (K, D, 4, 4), which of these are not surely out of reach (K, D),
    and the joints (P, B, J) at those, which alone are worked out."""
    gap, far = _gap(chain, pose)
    near = ~far
    value = np.repeat((-1.0 - gap)[..., None], chain.robot.form.branches, axis=-1)
    base = np.broadcast_to(chain.base, pose.shape)[near] if chain.base.ndim > 2 else chain.base
    q = dataclasses.replace(chain, base=base).inverse(pose[near])
    limit = chain.best_limit_margin(q) - settings.joint_margin
    single = chain.singularity_margin(q) - settings.singularity_margin
    least = np.minimum(np.minimum(limit, single), ENOUGH_MARGIN_RAD)
    value[near] = np.where(np.isfinite(least), least, value[near])
    return value, near, q


def reach_gap(chain: Chain, pose: FloatArray) -> FloatArray:
    """How far (...,) [m] the wrist's centre of TCP poses (..., 4, 4) lies outside what the arm reaches."""
    return _gap(chain, pose)[0]


def _gap(chain: Chain, pose: FloatArray) -> tuple[FloatArray, BoolArray]:
    """What :func:`reach_gap` gives, and where (...,) poses are surely too far away for every branch."""
    form = chain.robot.form
    flange = form.inner(np.linalg.inv(chain.base) @ pose @ np.linalg.inv(chain.tcp))
    if isinstance(form, ParallelParameters):
        gap = three_parallel.reach_gap(form, flange)
        return gap, np.zeros(gap.shape, dtype=np.bool_)
    if isinstance(form, SevenParameters):
        gap = seven_axes.reach_gap(form, flange)
        return gap, np.asarray(gap > SURELY_OUT_M)
    if isinstance(form, OffsetParameters):
        gap = offset_wrist.reach_gap(form, flange)
        return gap, np.asarray(gap > SURELY_OUT_M)
    p = chain.robot.opw
    centre = flange[..., :3, 3] - p.c4 * flange[..., :3, 2]
    out, up = np.hypot(centre[..., 0], centre[..., 1]), centre[..., 2] - p.c1
    distance = np.hypot(out - p.a1, up)
    forearm = np.hypot(p.a2, p.c3)
    gap = np.maximum(distance - (p.c2 + forearm), abs(p.c2 - forearm) - distance)
    least = np.hypot(np.maximum(out - abs(p.a1) - abs(p.b), 0.0), up)  # from the shoulder's nearer side
    return np.asarray(np.maximum(gap, 0.0)), np.asarray(least > p.c2 + forearm + SURELY_OUT_M)


def choice_scores(margins: Mapping[str, FloatArray], index: IndexArray) -> FloatArray:
    """Score (K, B ** arms) of each choice of branches: least over targets of the best sample, and a little of
    the mean."""
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
    least = best.min(axis=1)
    mean = best.mean(axis=1)
    return np.asarray(least + 0.02 * np.where(least > 0.0, mean, np.minimum(mean, 0.0)))


Choice = tuple[Mapping[str, FloatArray], FloatArray]
"""A choice of branches: joints {arm: (M, 6)} of the samples of a few targets, and their margins (M,)."""


def most_free(scene: Scene, few: Few, choices: Sequence[Choice], failed: IntArray) -> int:
    """How many of a few targets have a free posture on the choice of branches on which the most have one,
    among the samples with a margin above 0.

    ``failed`` (N,): how often targets have had none so far, which is counted on. Of choices behind the first
    one the targets that fail the most are asked at once, so many that one of them must be free where a choice
    is to be better; what is left is asked where one is.
    """
    count = few.targets.count
    most, hard = 0, np.zeros(0, dtype=np.intp)
    known = np.zeros((len(choices), count), dtype=np.bool_)
    for number, (_, margin) in enumerate(choices):
        open_ = np.zeros(count, dtype=np.bool_)
        open_[few.index[margin > 0.0]] = True
        open_[hard] &= known[number, hard]
        if open_.sum() <= most:
            continue
        open_[hard] = False
        for low, high in ((0, LOOKED_FIRST), (LOOKED_FIRST, len(few.index))):
            asked = open_ & ~known[number]
            known[number] |= _free_at(scene, few, choices[number : number + 1], asked, low, high)[0]
        failed[open_ & ~known[number]] += 1
        most = max(most, int(known[number].sum()))
        if most == count:
            break
        if not number and len(choices) > 1:
            hard = np.argsort(-failed, kind="stable")[: count - most]
            asked = np.isin(np.arange(count), hard)
            known[1:] = _free_at(scene, few, choices[1:], asked, 0, len(few.index))
            failed[hard] += (~known[1:, hard]).sum(axis=0)
    return most


def _free_at(
    scene: Scene, few: Few, choices: Sequence[Choice], asked: BoolArray, low: int, high: int
) -> BoolArray:
    """Which (C, N) of the targets ``asked`` (N,) have a free posture on each of the choices, among the
    samples from ``low`` to before ``high``, those with most margin first."""
    out = np.zeros((len(choices), few.targets.count), dtype=np.bool_)
    rows: list[IndexArray] = []
    for _, margin in choices:
        good = np.flatnonzero((margin > 0.0) & asked[few.index])
        good = good[np.lexsort((-margin[good], few.index[good]))]
        rank = np.arange(len(good)) - np.searchsorted(few.index[good], few.index[good])
        rows.append(good[(rank >= low) & (rank < high)])
    index = few.index[np.concatenate(rows)]
    if len(index):
        own = zip(choices, rows, strict=True)
        parts = [{arm: value[some] for arm, value in q.items()} for (q, _), some in own]
        q = {arm: np.concatenate([part[arm] for part in parts]) for arm in parts[0]}
        free = scene.free(few.targets, q, index)
        out[np.repeat(np.arange(len(rows)), [len(some) for some in rows])[free], index[free]] = True
    return out
