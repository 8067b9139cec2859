"""Arms at any two instants of one interval between meetings by signals: clearance, and distance of tools.

The model check proves no more than that both are in the same interval, or one of them at its end. So of each
interval every pair of instants counts, one for each arm.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from planner.cell import clearance
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.claims import ToolGap
from planner.issues import Issue, TandemError
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.looks import LEAST, STRIDE, lever
from planner.verify.rules_cell import REACH, accepted

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Models = Callable[[int], CellModel]

CODE = "verify.step_apart"
MARKS = 13
"""Instants of each arm in an interval at which the distance of the tools is taken."""
MOST = 50_000
"""Pairs of instants at most whose clearance is measured."""
_CHUNK = 2000
_SHOWN = 20


@dataclasses.dataclass(frozen=True)
class Intervals:
    """K intervals in which both arms move: samples ``first`` and ``last`` (K,), between meetings at rest, and
    the ``stage`` (K,) that they belong to."""

    first: IntArray
    last: IntArray
    stage: IntArray

    def some(self, chosen: NDArray[np.bool_] | IntArray) -> Intervals:
        """Some of them."""
        return Intervals(self.first[chosen], self.last[chosen], self.stage[chosen])


def intervals(context: Context) -> Intervals:
    """The intervals between meetings in which both arms move."""
    motion = context.motion
    first: list[IntArray] = []
    last: list[IntArray] = []
    stage: list[IntArray] = []
    for number, found in enumerate(context.job.stages):
        nodes = np.flatnonzero(motion.node_stage == number)
        if not found.ends or not len(nodes):
            continue
        ends = motion.node_sample[nodes[[end for end in found.ends if end < len(nodes)]]]
        begin = int(np.searchsorted(motion.stage, number))
        first.append(np.concatenate([[begin], ends[:-1]]).astype(np.int64))
        last.append(ends)
        stage.append(np.full(len(ends), number, dtype=np.int64))
    none = [np.zeros(0, dtype=np.int64)]
    return Intervals(
        np.concatenate([*first, *none]), np.concatenate([*last, *none]), np.concatenate([*stage, *none])
    )


def drift(context: Context, found: Intervals) -> FloatArray:
    """Bounds (K,) [m] of how much the distance of both TCPs may differ from what it is when the arms go
    together, for any instant of either arm in each interval.

    With a(s), b(t) the TCPs: the most of | |a(s) - b(t)| - |a(r) - b(r)| |, r = s and r = t, over
    :data:`MARKS` instants each, evenly along the way, plus what both distances may change to half-way to the
    next instants: with the line between the points to first order, across it to second.
    """
    a, b = (context.motion.tcp[task.arm.name][:, :3, 3] for task in context.job.tasks)
    steps = [np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (a, b)]
    both = np.concatenate([[0.0], np.cumsum(steps[0] + steps[1])])
    out = np.zeros(len(found.first))
    share = np.linspace(0.0, 1.0, MARKS)
    for low in range(0, len(out), _CHUNK):
        first, last = found.first[low : low + _CHUNK], found.last[low : low + _CHUNK]
        wanted = both[first][:, None] + share * (both[last] - both[first])[:, None]
        rows = np.clip(np.searchsorted(both, wanted), first[:, None], last[:, None])
        rows[:, 0], rows[:, -1] = first, last
        out[low : low + _CHUNK] = _change(a[rows], b[rows])
    return out


def _change(a: FloatArray, b: FloatArray) -> FloatArray:
    """The bound (K,) of :func:`drift` for points (K, M, 3) at M instants."""
    line = a[:, :, None] - b[:, None]
    distance = np.linalg.norm(line, axis=3)
    line /= np.maximum(distance, 1e-9)[..., None]
    slack = np.zeros_like(distance)
    across = np.zeros_like(distance)
    for points, way in ((a, "kstx,ksx->kst"), (b, "kstx,ktx->kst")):
        step = np.diff(points, axis=1)
        still = np.zeros_like(step[:, :1])
        sides = [np.concatenate(parts, axis=1) for parts in ((step, still), (still, step))]
        slack += 0.5 * np.max([np.abs(np.einsum(way, line, side)) for side in sides], axis=0)
        size = 0.5 * np.max([np.linalg.norm(side, axis=2) for side in sides], axis=0)
        across += size[:, :, None] if way.endswith("ksx->kst") else size[:, None]
    slack += across**2 / (2.0 * np.maximum(distance - across, 1e-9))
    together, aside = np.einsum("kii->ki", distance), np.einsum("kii->ki", slack)
    early = np.abs(distance - together[:, :, None]) + aside[:, :, None]
    late = np.abs(distance - together[:, None]) + aside[:, None]
    return np.asarray((np.maximum(early, late) + slack).max(axis=(1, 2)))


def step_apart(context: Context, models: Models) -> Outcome:
    """Arms that may be one step apart keep clear of each other, and the distance of their tools is off no
    more than allowed, at any two instants of a step."""
    if context.job.readings is None or len(context.job.tasks) != 2:
        return Outcome(where="one controller")
    found = intervals(context)
    if not len(found.first):
        return Outcome(where="the arms never move at once")
    issues, worst, limit = _drifts(context, found)
    least = np.inf
    for index in range(len(context.setups)):
        here = context.spans.of_stage[found.stage] == index
        if here.any():
            wrong, near = _clear(context, models(index), index, found.some(here))
            issues += wrong
            least = min(least, near)
    where = f"the distance of the TCPs; between the arms at least {mm(least):.3g} mm"
    return Outcome(tuple(issues), mm(worst), None if limit is None else mm(limit), "mm", where)


def _drifts(context: Context, found: Intervals) -> tuple[list[Issue], float, float | None]:
    """Issues of claims on the gap, the largest change [m], and the least that is allowed."""
    change = drift(context, found)
    labels = context.motion.labels()[found.last]
    issues: list[Issue] = []
    limits = []
    for index, setup in enumerate(context.setup_claims):
        here = context.spans.of_stage[found.stage] == index
        for claim in (c for group in setup.groups for c in group if isinstance(c, ToolGap)):
            rows = np.flatnonzero(here & (labels == claim.segment.lower()))
            limits += [claim.handshake] if len(rows) else []
            over = rows[change[rows] > claim.handshake]
            for k in over[np.argsort(-change[over])][:_SHOWN].tolist():
                what = (
                    f"one step apart the gap of the tools is off by up to {mm(change[k]):.4f} mm; allowed: "
                    f"{mm(claim.handshake):g} mm; let the arms meet at more targets, or shorten the moves"
                )
                measure = (mm(change[k]), mm(claim.handshake), "mm")
                arm, at = claim.arms[0], int(found.last[k])
                issues.append(at_sample(CODE, what, context.motion, arm, at, measure))
    return issues, float(change.max()), min(limits, default=None)


def _clear(context: Context, model: CellModel, index: int, found: Intervals) -> tuple[list[Issue], float]:
    """Issues of clearance between the arms of setup ``index``, and the least that is known [m].

    Where the arms' clearance in the middle of an interval less the ways of both to its ends is enough, no
    more is looked at; else pairs of instants so close that no point moves farther than the proof's stride
    between them.
    """
    wanted = context.problem.settings.clearance
    limit, reach = accepted(wanted), max(REACH, 1.5 * wanted)
    ignore = _others(context, model, index)
    arms = [task.arm.name for task in context.job.tasks]
    joints = [context.motion.q[arm] for arm in arms]
    along = []
    for arm, q in zip(arms, joints, strict=True):
        way = np.abs(np.diff(q, axis=0)) @ lever(context, index, arm)
        along.append(np.concatenate([[0.0], np.cumsum(way)]))
    first, last = found.first, found.last
    both = along[0] + along[1]
    middle = np.clip(np.searchsorted(both, 0.5 * (both[first] + both[last])), first, last)
    far = sum(np.maximum(way[middle] - way[first], way[last] - way[middle]) for way in along)
    lower = clearance.at_least(
        model, {a: q[middle] for a, q in zip(arms, joints, strict=True)}, reach, ignore
    )
    bound = lower - far
    doubted = np.flatnonzero(bound < limit)
    least = float(np.delete(bound, doubted).min(initial=np.inf))
    pairs = [*_combined(along, first[doubted], last[doubted], min(STRIDE, max(wanted, LEAST)))]
    count = sum(len(rows[0]) for rows in pairs)
    if count > MOST:
        what = (
            f"clearance of arms one step apart is in doubt at {count} pairs of instants, at most {MOST} are"
        )
        raise TandemError(
            Issue("verify.duration", f"{what} measured; split the job", value=count, limit=MOST)
        )
    if not pairs:
        return [], least
    rows = [np.concatenate([pair[i] for pair in pairs]) for i in range(2)]
    measured = clearance.least(
        model, {a: q[r] for a, q, r in zip(arms, joints, rows, strict=True)}, reach, ignore
    )
    issues = []
    bad = np.flatnonzero(~(measured.distance >= limit))
    for k in bad[np.argsort(measured.distance[bad])][:_SHOWN].tolist():
        bodies = measured.pair[k]
        what = (
            f"one step apart {bodies[0]} and {bodies[1]} come within {mm(measured.distance[k]):.2f} mm; "
            f"allowed: {mm(wanted):.2f} mm"
        )
        measure = (mm(measured.distance[k]), mm(wanted), "mm")
        issues.append(at_sample(CODE, what, context.motion, arms[0], int(rows[0][k]), measure, bodies))
    return issues, min(least, float(measured.distance.min()))


def _combined(
    along: list[FloatArray], first: IntArray, last: IntArray, stride: float
) -> Iterator[tuple[IntArray, IntArray]]:
    """Pairs of samples of each interval, so close that each arm goes half a stride at most between them."""
    for begin, end in zip(first.tolist(), last.tolist(), strict=True):
        marks = []
        for way in along:
            count = int(np.ceil((way[end] - way[begin]) / (0.5 * stride))) + 1
            at = np.searchsorted(way, np.linspace(way[begin], way[end], count))
            marks.append(np.unique(np.clip(at, begin, end)))
        grid = np.array(list(itertools.product(*marks)), dtype=np.int64)
        yield grid[:, 0], grid[:, 1]


def _others(context: Context, model: CellModel, index: int) -> Pairs:
    """Pairs of bodies that do not depend on how far apart the arms are, or whose distance a claim bounds."""
    arms = [task.arm.name for task in context.job.tasks]
    names = sorted({solid.body for solid in model.solids})
    owner = {name: next((arm for arm in arms if name.startswith(f"{arm}/")), "") for name in names}
    claims = (c for group in context.setup_claims[index].groups for c in group)
    forming = {frozenset(f"{arm}/edge" for arm in c.arms) for c in claims if isinstance(c, ToolGap)}
    return frozenset(
        pair
        for a, b in itertools.combinations(names, 2)
        for pair in [frozenset((a, b))]
        if owner[a] == owner[b] or not owner[a] or not owner[b] or pair in forming
    )
