"""Rules on clearance: bodies against bodies, each arm against itself, the wire against everything, arms
between meetings.

verify.clearance, own_clearance, wire_clearance. verify.step_apart: arms at any two instants of one interval
between meetings by signals, and the distance of their tools. The model check proves no more than
that both are in the same interval, or one of them at its end. So of each interval every pair of
instants counts, one for each arm.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.cell import clearance
from planner.cell.clearance import Pairs
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, lengths
from planner.issues import TandemError
from planner.problem import Problem, Settings
from planner.proof.clearance.samples import (
    DISTANCE_PRECISION,
    LEAST_STRIDE,
    MOST_BROKEN,
    SAMPLE_STRIDE,
    Measured,
    clearance_rows,
    least_distances,
    travel,
)
from planner.proof.context import Context
from planner.proof.contribution import edges, segments_of
from planner.proof.facts import Fact
from planner.proof.findings import Findings, in_mm
from planner.proof.models import MODELS, Models, Standing, cell_models
from planner.proof.rule import Outcome, issue, mm, rule

BETWEEN_TARGETS = 1e-3
"""How much less than the wanted clearance is accepted between targets [m], a tenth of it at most."""
MEASURED_REACH = 0.1
"""Distances are measured up to this [m], or up to one and a half times the wanted clearance where that is
more."""


def accepted(wanted: float) -> float:
    """Least clearance [m] that passes where one is wanted."""
    return wanted - min(BETWEEN_TARGETS, 0.1 * wanted)


@dataclasses.dataclass(frozen=True)
class Looks:
    """Samples ``rows`` (K,) of setup ``index`` at which bodies are looked at, but for pairs in ``ignore``,
    with the ``links`` {arm: (N, 6)} of all samples, or of these alone where they were ``sent`` to another
    process. ``itself``: links and tool of each arm against each other, else all other pairs. ``bases``
    {arm: (K, 4, 4)}: of arms whose tracks go along."""

    index: int
    rows: IntArray
    ignore: Pairs
    links: Mapping[str, FloatArray]
    itself: bool = False
    bases: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    sent: bool = False

    @property
    def q(self) -> Mapping[str, FloatArray]:
        """The joints {arm: (K, 6)} there, taken out anew each time: kept, those of a long motion would stand
        beside what the physics needs."""
        return self.links if self.sent else {arm: q[self.rows] for arm, q in self.links.items()}

    def __reduce__(self) -> "tuple[type[Looks], tuple[Any, ...]]":
        """Another process gets no more than the samples that are looked at."""
        return Looks, (self.index, self.rows, self.ignore, self.q, self.itself, self.bases, True)


def looks(context: Context) -> tuple[Looks, ...]:
    """Where the bodies of all setups are looked at: first against others, then each arm against itself."""
    setups = range(len(context.setups))
    others = [(k, *some, False) for k in setups for some in _groups(context, k, clearance_rows(context, k))]
    own = [(k, clearance_rows(context, k, itself=True), frozenset[frozenset[str]](), True) for k in setups]
    links = context.motion.links
    return tuple(
        Looks(index, rows, ignore, links, itself, context.ridden(index, rows))
        for index, rows, ignore, itself in (*others, *own)
        if len(rows)
    )


def of_one_arm(model: CellModel) -> Pairs:
    """Pairs of bodies between which the clearance of an arm to itself holds: its base, its six links and the
    tool on its flange. Not what works at the tool (wire, cutter, head), nor a block that it holds."""
    there = {solid.body for solid in model.solids}
    parts = ("base_link", *(f"link_{number}" for number in range(1, 7)), "tool")
    arms = [there & {f"{arm.name}/{part}" for part in parts} for arm in model.cell.arms]
    return frozenset(frozenset(two) for arm in arms for two in itertools.combinations(sorted(arm), 2))


def aside(model: CellModel, itself: bool) -> Pairs:
    """Pairs of bodies that are not looked at where arms are held against themselves, or where all else is."""
    if not itself:
        return of_one_arm(model)
    there = sorted({solid.body for solid in model.solids})
    return frozenset(map(frozenset, itertools.combinations(there, 2))) - of_one_arm(model)


def wanted_of(settings: Settings, itself: bool) -> float:
    """The clearance [m] that a problem wants of an arm to itself, or of all else."""
    return settings.of_one_arm if itself else settings.clearance


def measured(models: Models, some: Sequence[Looks], settings: Settings) -> Iterator[Measured | None]:
    """What is measured at each of the looks; None where the cell's model lacks a body that is to be
    ignored."""
    for look in some:
        model, wanted = models(look.index).with_bases(look.bases), wanted_of(settings, look.itself)
        if _missing(model, look.ignore):
            yield None
        else:
            reach, ignore = max(MEASURED_REACH, 1.5 * wanted), look.ignore | aside(model, look.itself)
            yield least_distances(model, look.q, accepted(wanted), reach, ignore)


def _missing(model: CellModel, ignore: Pairs) -> list[str]:
    return sorted({name for pair in ignore for name in pair} - {s.body for s in model.solids})


Looked = tuple[Sequence[Looks], Iterator[Measured | None]]
"""Looks, and what is measured there, to be taken once."""


def _looked(context: Context) -> Looked:
    some = looks(context)
    return some, measured(context.get(MODELS), some, context.problem.settings)


LOOKS: Final[Fact[Context, Looked]] = Fact("looks", _looked)
"""The looks of both rules, ``verify.clearance`` first."""


def _measured_there(
    given: Problem, standing: Standing, some: Sequence[Looks], settings: Settings
) -> Iterator[Measured | None]:
    yield from measured(cell_models(given, standing), some, settings)


def begin_looks(context: Context) -> Looked:
    """Begin to measure in another process, which gets only the samples of the looks and not the motion."""
    some = looks(context)
    arguments = context.given, Standing.of(context), some, context.problem.settings
    return some, context.executor.submit(_measured_there, *arguments)


@rule("verify.clearance", ahead="bodies")
def bodies(context: Context) -> Outcome:
    """Robots, tools, block and obstacles keep apart; a bow's wire passes the block where it cuts. Bodies that
    stand are not inside of one another: the block and what bears it, bases, obstacles."""
    models, findings = context.get(MODELS), Findings("verify.clearance", context)
    for index in range(len(context.setups)):
        for one, other, deep in clearance.overlaps(models(index)):
            what = f"{one} and {other}, which stand still, are {mm(deep):.1f} mm inside of one another"
            findings.add(what, bodies=(one, other), value=-mm(deep), unit="mm")
    return _kept(findings, itself=False)


@rule("verify.own_clearance", ahead="bodies")
def own_bodies(context: Context) -> Outcome:
    """Base, links and tool of each arm keep the clearance that the problem wants of an arm to itself.

    Runs after :func:`bodies`, whose looks come first.
    """
    return _kept(Findings("verify.own_clearance", context), itself=True)


def _kept(findings: Findings, itself: bool) -> Outcome:
    """What the looks of one of both rules find, behind what is wrong already."""
    context, models = findings.context, findings.context.get(MODELS)
    wanted = wanted_of(context.problem.settings, itself)
    limit = accepted(wanted)
    looked: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    distance: list[FloatArray] = [np.zeros(0)]
    pairs: list[tuple[str, str]] = []
    rest = np.inf
    every, begun = context.get(LOOKS)
    some = [look for look in every if look.itself == itself]
    for look, there in zip(some, itertools.islice(begun, len(some)), strict=True):
        if there is None:
            what = f"the cell's model has no body {_missing(models(look.index), look.ignore)[0]}"
            findings.add(what, hint="state the edge of the bow's tool")
            continue
        looked.append(look.rows[there.look])
        distance.append(there.least.distance)
        pairs += there.least.pair
        rest = min(rest, there.rest)
    rows = np.concatenate(looked)
    order = np.argsort(rows, kind="stable")
    rows = rows[order]
    everywhere = np.concatenate(distance)[order]
    least = clearance.LeastClearance(everywhere, tuple(pairs[i] for i in order))
    for i in np.flatnonzero(~(everywhere >= limit)):
        pair = least.pair[int(i)]
        message = (
            f"{pair[0]} and {pair[1]} come within {mm(everywhere[i]):.2f} mm; allowed: {mm(wanted):.2f} mm"
        )
        findings.at_sample(message, _arm_of(context, pair), rows[i], in_mm(everywhere[i], wanted), pair)
    issues, series = tuple(findings.issues), _series(findings.code, context, rows, least)
    if not len(rows):
        return Outcome(issues, nothing="nothing moves", series=series)
    k = least.worst()
    worst, where = float(everywhere[k]), " and ".join(least.pair[k]) if least.pair[k][0] else "nothing near"
    if rest < worst - DISTANCE_PRECISION:
        worst, where = rest, "a bound; bodies may keep farther apart"
    return Outcome(issues, mm(worst), mm(limit), "mm", where, series=series)


def _series(code: str, context: Context, rows: IntArray, least: clearance.LeastClearance) -> dict[str, Any]:
    """Curves of the least distance over the looks."""
    name = code.removeprefix("verify.")
    return {
        f"{name}/time": context.motion.time[rows],
        f"{name}/distance": least.distance,
        f"{name}/pair": np.array([" - ".join(pair) for pair in least.pair]),
    }


def _groups(context: Context, index: int, rows: IntArray) -> list[tuple[IntArray, clearance.Pairs]]:
    """Samples of a setup by the pairs of bodies that may touch there: a bow's wire, or a cutter, and the
    block in cuts, the heads of forming tools and the sheet between them where they form it."""
    all_arms = [arm.name for arm in context.setups[index].cell.arms]
    ends = {arm: found for arm in all_arms if (found := edges(context, index, arm))}
    arms = list(ends)
    if not arms or not len(rows):
        return [(rows, frozenset())] if len(rows) else []
    labels = context.motion.labels(rows)
    forms, cuts = (
        np.stack([np.isin(labels, list(segments_of(ends[arm], meet))) for arm in arms], axis=1)
        for meet in (True, False)
    )
    flags = np.concatenate([forms, cuts & ~forms], axis=1)
    out = []
    for flag in np.unique(flags, axis=0):
        form, cut = flag[: len(arms)], flag[len(arms) :]
        own = [arm for arm, one, other in zip(arms, form, cut, strict=True) if one or other]
        heads = [arm for arm, one in zip(arms, form, strict=True) if one]
        touching = {frozenset((f"{arm}/edge", "stock")) for arm in own}
        touching |= {frozenset((f"{a}/edge", f"{b}/edge")) for a, b in itertools.combinations(heads, 2)}
        out.append((rows[(flags == flag).all(axis=1)], frozenset(touching)))
    return out


STEP_APART = "verify.step_apart"
"""Code of the rule about arms that are apart in time."""
INTERVAL_INSTANTS = 13
"""Instants of each arm in an interval at which the distance of the tools is taken."""
MOST_INSTANT_PAIRS = 50_000
"""Pairs of instants at most whose clearance is measured."""
_INTERVALS_AT_ONCE = 2000
"""Intervals that are worked on at once."""
_PAIRS_AT_ONCE = 250
"""Pairs of instants whose distances are asked for at once."""
_ISSUES_SHOWN = 20
"""Issues of one kind at most, the worst first."""


@dataclasses.dataclass(frozen=True)
class Intervals:
    """K intervals in which both arms move: samples ``first`` and ``last`` (K,), between meetings at rest, and
    the ``stage`` (K,) that they belong to."""

    first: IntArray
    last: IntArray
    stage: IntArray

    def some(self, chosen: BoolArray | IntArray) -> "Intervals":
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
    :data:`INTERVAL_INSTANTS` instants each, evenly along the way, plus what both distances may change to
    half-way to the next instants: with the line between the points to first order, across it to second.
    """
    a, b = (context.motion.tcp[task.arm.name].place for task in context.job.tasks)
    steps = [lengths(np.diff(p, axis=0)) for p in (a, b)]
    both = np.concatenate([[0.0], np.cumsum(steps[0] + steps[1])])
    out = np.zeros(len(found.first))
    share = np.linspace(0.0, 1.0, INTERVAL_INSTANTS)
    for low in range(0, len(out), _INTERVALS_AT_ONCE):
        first, last = found.first[low : low + _INTERVALS_AT_ONCE], found.last[low : low + _INTERVALS_AT_ONCE]
        wanted = both[first][:, None] + share * (both[last] - both[first])[:, None]
        rows = np.clip(np.searchsorted(both, wanted), first[:, None], last[:, None])
        rows[:, 0], rows[:, -1] = first, last
        out[low : low + _INTERVALS_AT_ONCE] = _change(a[rows], b[rows])
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


@rule("verify.step_apart", ahead="bodies")
def step_apart(context: Context) -> Outcome:
    """Arms that may be one step apart keep clear of each other, and the distance of their tools is off no
    more than allowed, at any two instants of a step."""
    if context.job.readings is None or len(context.job.tasks) != 2:
        return Outcome(nothing="one controller")
    found = intervals(context)
    if not len(found.first):
        return Outcome(nothing="the arms never move at once")
    findings = Findings(STEP_APART, context)
    _drifts(findings, found)
    models, least = context.get(MODELS), np.inf
    for index in range(len(context.setups)):
        here = context.spans.of_stage[found.stage] == index
        if here.any():
            least = min(least, _clear(findings, models(index), index, found.some(here)))
    where = f"the distance of the TCPs; between the arms at least {mm(least):.3g} mm"
    return dataclasses.replace(findings.outcome(mm, "mm"), where=where)


def _drifts(findings: Findings, found: Intervals) -> None:
    """Claims on the gap, the largest change [m], and the least that is allowed."""
    context, change = findings.context, drift(findings.context, found)
    labels = context.motion.labels(found.last)
    limits = []
    for index, setup in enumerate(context.setup_claims):
        here = context.spans.of_stage[found.stage] == index
        bounds = (c.tool_distance for group in setup.groups for c in group)
        for bound in (one for one in bounds if one is not None):
            rows = np.flatnonzero(here & (labels == bound.segment.key))
            limits += [bound.change] if len(rows) else []
            over = rows[change[rows] > bound.change]
            for k in over[np.argsort(-change[over])][:_ISSUES_SHOWN].tolist():
                what = (
                    f"one step apart the gap of the tools is off by up to {mm(change[k]):.4f} mm; allowed: "
                    f"{mm(bound.change):g} mm; let the arms meet at more targets, or shorten the moves"
                )
                findings.at_sample(what, bound.arms[0], found.last[k], in_mm(change[k], bound.change))
    findings.highest(change.max(), limit=min(limits, default=None))


def _clear(findings: Findings, model: CellModel, index: int, found: Intervals) -> float:
    """Clearance between the arms of setup ``index``; returns the least that is known [m].

    The heads of two tools are left out where they form: the face is between them at any instant of either.
    """
    context = findings.context
    wanted = context.problem.settings.clearance
    ignore, heads = _others(context, model, index), _heads(context, model)
    form = _forming(context, index, found)
    least = np.inf
    for some, pairs in ((found.some(form), ignore | heads), (found.some(~form), ignore)):
        if not len(some.first):
            continue
        rows, measured, bound = _nearest(context, model, index, some, pairs)
        least = min(least, bound, float(measured.distance.min(initial=np.inf)))
        bad = np.flatnonzero(~(measured.distance >= accepted(wanted)))
        for k in bad[np.argsort(measured.distance[bad])][:_ISSUES_SHOWN].tolist():
            bodies, near = measured.pair[k], measured.distance[k]
            what = (
                f"one step apart {bodies[0]} and {bodies[1]} come within {mm(near):.2f} mm; "
                f"allowed: {mm(wanted):.2f} mm"
            )
            findings.at_sample(what, _arm_of(context, bodies), rows[k], in_mm(near, wanted), bodies)
    return least


def _arm_of(context: Context, pair: tuple[str, str]) -> str:
    """The arm at whose program a pair of bodies is told: the first that one of them is of, else that of the
    first task."""
    arms = [task.arm.name for task in context.job.tasks]
    return next((arm for body in pair if (arm := body.partition("/")[0]) in arms), arms[0])


def _nearest(
    context: Context, model: CellModel, index: int, found: Intervals, ignore: Pairs
) -> tuple[IntArray, clearance.LeastClearance, float]:
    """Samples (M,) of the first arm at pairs of instants that were measured, the distances there, and what
    all other pairs keep at least [m].

    Of one stretch of each arm's way, at first a whole interval, the clearance with both in the middle less
    the ways of both to the ends bounds that of all pairs of instants. Where it is not enough the longer
    stretch is halved, until no point moves farther than half of the proof's stride in either; then it is
    measured.
    """
    wanted = context.problem.settings.clearance
    limit, reach = accepted(wanted), max(MEASURED_REACH, 1.5 * wanted)
    arms = [task.arm.name for task in context.job.tasks]
    joints = [context.motion.links[arm] for arm in arms]
    along = [np.concatenate([[0.0], np.cumsum(travel(context, index, arm))]) for arm in arms]
    short = 0.5 * min(SAMPLE_STRIDE, max(wanted, LEAST_STRIDE))
    least = np.inf
    leaves: list[IntArray] = []
    open_ = np.stack([found.first, found.last, found.first, found.last])
    while open_.shape[1]:
        middle, far = _middles(along, open_)
        there = {arm: q[rows] for arm, q, rows in zip(arms, joints, middle, strict=True)}
        bound = clearance.at_least(model, there, reach, ignore) - far
        enough = bound >= limit
        least = min(least, float(bound[enough].min(initial=np.inf)))
        length = [
            np.where(open_[2 * k + 1] - open_[2 * k] > 1, way[open_[2 * k + 1]] - way[open_[2 * k]], 0.0)
            for k, way in enumerate(along)
        ]
        small = np.maximum(*length) <= short
        leaves.append(np.stack(middle)[:, ~enough & small])
        measured = sum(part.shape[1] for part in leaves)
        split = ~enough & ~small
        if measured + np.count_nonzero(split) > MOST_INSTANT_PAIRS:
            what = (
                f"clearance of arms one step apart is in doubt at over {MOST_INSTANT_PAIRS} pairs of "
                "instants, at most so many are measured; split the job"
            )
            measure = MOST_INSTANT_PAIRS, MOST_INSTANT_PAIRS, None
            raise TandemError(issue("verify.duration", what, measure))
        open_ = _halved(open_[:, split], [rows[split] for rows in middle], (length[0] >= length[1])[split])
    rows = np.concatenate(leaves, axis=1)
    found_near: list[clearance.LeastClearance] = []
    for begin in range(0, rows.shape[1], _PAIRS_AT_ONCE):
        some = rows[:, begin : begin + _PAIRS_AT_ONCE]
        there = {arm: q[own] for arm, q, own in zip(arms, joints, some, strict=True)}
        found_near.append(clearance.least(model, there, reach, ignore))
        if sum(int(np.count_nonzero(~(part.distance >= limit))) for part in found_near) > MOST_BROKEN:
            break
    distance = np.concatenate([np.zeros(0), *(part.distance for part in found_near)])
    pairs = tuple(pair for part in found_near for pair in part.pair)
    return rows[0, : len(distance)], clearance.LeastClearance(distance, pairs), least


def _middles(along: list[FloatArray], open_: IntArray) -> tuple[list[IntArray], FloatArray]:
    """Samples (M,) of both arms halfway along stretches ``open_`` (4, M), first and last of each, and how far
    (M,) both go from there to an end at most, together."""
    rows, far = [], np.zeros(open_.shape[1])
    for k, way in enumerate(along):
        first, last = open_[2 * k], open_[2 * k + 1]
        at = np.clip(np.searchsorted(way, 0.5 * (way[first] + way[last])), first, last)
        inner = np.clip(at, first + 1, np.maximum(last - 1, first + 1))
        at = np.where(last - first > 1, inner, at)
        rows.append(at)
        far += np.maximum(way[at] - way[first], way[last] - way[at])
    return rows, far


def _halved(open_: IntArray, middle: list[IntArray], first: BoolArray) -> IntArray:
    """Both halves of each pair of stretches (4, M): of the first arm's, or else of the second one's."""
    ahead, behind = open_.copy(), open_.copy()
    for k, own in enumerate((first, ~first)):
        ahead[2 * k + 1, own] = middle[k][own]
        behind[2 * k, own] = middle[k][own]
    return np.concatenate([ahead, behind], axis=1)


def _heads(context: Context, model: CellModel) -> Pairs:
    """The heads of both arms' tools as a pair of bodies, if both have one."""
    names = frozenset(f"{task.arm.name}/edge" for task in context.job.tasks)
    return frozenset({names}) if names <= {solid.body for solid in model.solids} else frozenset()


def _forming(context: Context, index: int, found: Intervals) -> BoolArray:
    """Intervals (K,) in which both arms form, or go in and out: ``verify.gouge`` and ``verify.sheet`` hold
    the heads of their tools on the two sides of one face then, whatever the instant; or a claim bounds the
    gap."""
    motion, setup = context.motion, context.setup_claims[index]
    arms = (task.arm.name for task in context.job.tasks)
    names = frozenset.intersection(*(segments_of(edges(context, index, arm), True) for arm in arms))
    bounds = (c.tool_distance for group in setup.groups for c in group)
    names |= {bound.segment.key for bound in bounds if bound is not None}
    other = np.isin(motion.node_label, sorted(names), invert=True).astype(np.int64)
    count = np.concatenate([[0], np.cumsum(other)])
    first, last = motion.node[np.minimum(found.first + 1, found.last)], motion.node[found.last]
    return np.asarray(count[last + 1] == count[first])


def _others(context: Context, model: CellModel, index: int) -> Pairs:
    """Pairs of bodies that do not depend on how far apart the arms are."""
    arms = [task.arm.name for task in context.job.tasks]
    names = sorted({solid.body for solid in model.solids})
    owner = {name: next((arm for arm in arms if name.startswith(f"{arm}/")), "") for name in names}
    return frozenset(
        frozenset((a, b))
        for a, b in itertools.combinations(names, 2)
        if owner[a] == owner[b] or not owner[a] or not owner[b]
    )
