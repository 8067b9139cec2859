"""Rules on clearance between bodies, of each arm to itself, and between arms that are one step apart.

verify.clearance and verify.own_clearance use samples of the replayed motion. verify.step_apart covers two
controllers that meet by signals. The model check only proves that both arms are in the same interval between
meetings, or that one of them is at its end. So within each interval every pair of instants counts, one
instant for each arm. This holds for the clearance and for the distance of the tools.
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
    DISTANCE_PRECISION_M,
    MAX_SAMPLE_STRIDE_M,
    MAX_VIOLATIONS,
    MIN_SAMPLE_STRIDE_M,
    ClearanceMeasurement,
    clearance_samples,
    max_point_path,
    measure_min_distances,
)
from planner.proof.context import Context
from planner.proof.contribution import find_edges, segments_of
from planner.proof.facts import Fact
from planner.proof.findings import Findings, measure_in_mm
from planner.proof.models import MODELS, Models, StationaryPoses, cell_models
from planner.proof.rule import RuleOutcome, measured_issue, mm, rule

MAX_CLEARANCE_REDUCTION_M = 1e-3
"""Reduction [m] of the required clearance that is accepted. A tenth of the clearance is accepted if that is
less.
"""
MIN_QUERY_RANGE_M = 0.1
"""Minimum range [m] of distance queries. The range is 1.5 times the required clearance if that is more."""


def min_accepted_clearance(required: float) -> float:
    """Return the smallest clearance [m] that passes: the required one less 1 mm, or less a tenth of it.

    Args:
        required: Required clearance [m].
    """
    return required - min(MAX_CLEARANCE_REDUCTION_M, 0.1 * required)


@dataclasses.dataclass(frozen=True)
class ClearanceQueries:
    """Samples of one setup at which distances of bodies are measured.

    Attributes:
        index: Index of the setup.
        rows: Samples (K,) of the motion.
        ignore: Pairs of bodies that are not measured.
        links: Joints {arm: (S, 6)} at all S samples of the motion, or {arm: (K, 6)} at ``rows`` only if the
            queries were sent to another process.
        itself: True to measure the bodies of each arm against each other (:func:`self_clearance_pairs`),
            False to measure all other pairs.
        bases: Base poses {arm: (K, 4, 4)} of arms on coordinated tracks.
        sent: Whether the queries were sent to another process.
    """

    index: int
    rows: IntArray
    ignore: Pairs
    links: Mapping[str, FloatArray]
    itself: bool = False
    bases: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    sent: bool = False

    @property
    def q(self) -> Mapping[str, FloatArray]:
        """Joints {arm: (K, 6)} at the samples.

        They are extracted on each call and not cached, to save memory.
        """
        return self.links if self.sent else {arm: q[self.rows] for arm, q in self.links.items()}

    def __reduce__(self) -> "tuple[type[ClearanceQueries], tuple[Any, ...]]":
        """Send only the queried samples to another process."""
        return ClearanceQueries, (self.index, self.rows, self.ignore, self.q, self.itself, self.bases, True)


def clearance_queries(context: Context) -> tuple[ClearanceQueries, ...]:
    """Return the clearance queries of all setups: where distances are measured, and which pairs may touch.

    Queries between different bodies (``verify.clearance``) come first, those of each arm to itself
    (``verify.own_clearance``) last. Queries without samples are left out.
    """
    setups = range(len(context.setups))
    other_queries = [
        (k, *group, False) for k in setups for group in _groups(context, k, clearance_samples(context, k))
    ]
    self_queries = [
        (k, clearance_samples(context, k, itself=True), frozenset[frozenset[str]](), True) for k in setups
    ]
    links = context.motion.link_joints
    return tuple(
        ClearanceQueries(index, rows, ignore, links, itself, context.track_base_poses(index, rows))
        for index, rows, ignore, itself in (*other_queries, *self_queries)
        if len(rows)
    )


def self_clearance_pairs(model: CellModel) -> Pairs:
    """Return the pairs of bodies for which the clearance of an arm to itself holds.

    These are its base, its six links and the tool on its flange. The working end of the tool (wire, cutter,
    head) and a held block are not among them.
    """
    names = {solid.body for solid in model.solids}
    # Of an arm with seven axes, link 7 is not among them.
    parts = ("base_link", *(f"link_{number}" for number in range(1, 7)), "tool")
    arms = [names & {f"{arm.name}/{part}" for part in parts} for arm in model.cell.arms]
    return frozenset(frozenset(pair) for arm in arms for pair in itertools.combinations(sorted(arm), 2))


def excluded_pairs(model: CellModel, itself: bool) -> Pairs:
    """Return the pairs of bodies that are not measured.

    Args:
        model: Model of the cell.
        itself: Whether only pairs of bodies of one arm are measured, rather than all other pairs.
    """
    if not itself:
        return self_clearance_pairs(model)
    names = sorted({solid.body for solid in model.solids})
    return frozenset(map(frozenset, itertools.combinations(names, 2))) - self_clearance_pairs(model)


def required_clearance(settings: Settings, itself: bool) -> float:
    """Return the clearance [m] that a problem requires: of an arm to itself, or else between bodies."""
    return settings.self_clearance if itself else settings.clearance


def measure_queries(
    models: Models, queries: Sequence[ClearanceQueries], settings: Settings
) -> Iterator[ClearanceMeasurement | None]:
    """Yield the measurement of each query, or None if the cell model lacks a body that is to be ignored."""
    for query in queries:
        model = models(query.index).with_bases(query.bases)
        required = required_clearance(settings, query.itself)
        if _missing(model, query.ignore):
            yield None
        else:
            query_range = max(MIN_QUERY_RANGE_M, 1.5 * required)
            ignore = query.ignore | excluded_pairs(model, query.itself)
            yield measure_min_distances(model, query.q, min_accepted_clearance(required), query_range, ignore)


def _missing(model: CellModel, ignore: Pairs) -> list[str]:
    """Return the names of bodies in pairs ``ignore`` that the model does not have."""
    return sorted({name for pair in ignore for name in pair} - {s.body for s in model.solids})


QueryResults = tuple[Sequence[ClearanceQueries], Iterator[ClearanceMeasurement | None]]
"""Queries and an iterator over their measurements, which can be consumed once."""


def _query_clearance(context: Context) -> QueryResults:
    """Return the queries, and an iterator that measures them in this process when it is consumed."""
    queries = clearance_queries(context)
    return queries, measure_queries(context.get(MODELS), queries, context.problem.settings)


CLEARANCE_QUERIES: Final[Fact[Context, QueryResults]] = Fact("looks", _query_clearance)
"""Queries and their measurements, those of ``verify.clearance`` before those of ``verify.own_clearance``."""


def _measure_in_process(
    problem: Problem, stationary: StationaryPoses, queries: Sequence[ClearanceQueries], settings: Settings
) -> Iterator[ClearanceMeasurement | None]:
    """Measure queries in another process, which builds its own cell models."""
    yield from measure_queries(cell_models(problem, stationary), queries, settings)


def submit_clearance_queries(context: Context) -> QueryResults:
    """Submit the measurements to another process, which gets only the queried samples and not the motion."""
    queries = clearance_queries(context)
    arguments = context.given_problem, StationaryPoses.of(context), queries, context.problem.settings
    return queries, context.executor.submit(_measure_in_process, *arguments)


@rule("verify.clearance", parallel_group="bodies")
def bodies(context: Context) -> RuleOutcome:
    """Robots, tools, block and obstacles keep their clearance.
    A bow's wire passes the block where it cuts. Stationary bodies do not overlap: the block and its
    support, bases, obstacles.
    """
    models, findings = context.get(MODELS), Findings("verify.clearance", context)
    for index in range(len(context.setups)):
        for body, other_body, depth in clearance.find_overlaps(models(index)):
            message = f"the stationary bodies {body} and {other_body} overlap by {mm(depth):.1f} mm"
            findings.add(message, bodies=(body, other_body), value=-mm(depth), unit="mm")
    return _clearance_outcome(findings, itself=False)


@rule("verify.own_clearance", parallel_group="bodies")
def own_bodies(context: Context) -> RuleOutcome:
    """Base, links and tool of each arm keep the clearance that the problem requires of an arm to itself.

    Runs after :func:`bodies`, whose queries come first.
    """
    return _clearance_outcome(Findings("verify.own_clearance", context), itself=True)


def _clearance_outcome(findings: Findings, itself: bool) -> RuleOutcome:
    """Add the violations at the queries of a rule to the findings, and return its outcome.

    ``itself`` selects the queries, as in :class:`ClearanceQueries`. The measurements of both rules come from
    one iterator, which can be consumed once, so the rule on different bodies must come first.
    """
    context, models = findings.context, findings.context.get(MODELS)
    required = required_clearance(context.problem.settings, itself)
    limit = min_accepted_clearance(required)
    measured_rows: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    distance: list[FloatArray] = [np.zeros(0)]
    pairs: list[tuple[str, str]] = []
    unmeasured_bound = np.inf
    all_queries, measurements = context.get(CLEARANCE_QUERIES)
    queries = [query for query in all_queries if query.itself == itself]
    for query, measurement in zip(queries, itertools.islice(measurements, len(queries)), strict=True):
        if measurement is None:
            message = f"the cell model has no body {_missing(models(query.index), query.ignore)[0]}"
            findings.add(message, hint="state the edge of the bow's tool")
            continue
        measured_rows.append(query.rows[measurement.rows])
        distance.append(measurement.min_clearance.distance)
        pairs += measurement.min_clearance.pair
        unmeasured_bound = min(unmeasured_bound, measurement.unmeasured_bound)
    rows = np.concatenate(measured_rows)
    order = np.argsort(rows, kind="stable")
    rows = rows[order]
    distances = np.concatenate(distance)[order]
    min_clearance = clearance.MinClearance(distances, tuple(pairs[i] for i in order))
    for i in np.flatnonzero(~(distances >= limit)):
        pair = min_clearance.pair[int(i)]
        message = (
            f"{pair[0]} and {pair[1]} come within {mm(distances[i]):.2f} mm; allowed: {mm(required):.2f} mm"
        )
        findings.add_at_sample(
            message, _arm_of(context, pair), rows[i], measure_in_mm(distances[i], required), pair
        )
    # The worst value is the smallest measured distance, or a smaller lower bound of the unmeasured ones.
    issues, series = tuple(findings.issues), _series(findings.code, context, rows, min_clearance)
    if not len(rows):
        return RuleOutcome(issues, nothing="nothing moves", series=series)
    k = min_clearance.worst()
    worst = float(distances[k])
    where = " and ".join(min_clearance.pair[k]) if min_clearance.pair[k][0] else "none in range"
    if unmeasured_bound < worst - DISTANCE_PRECISION_M:
        worst, where = unmeasured_bound, "a lower bound of the distance"
    return RuleOutcome(issues, mm(worst), mm(limit), "mm", where, series=series)


def _series(
    code: str, context: Context, rows: IntArray, min_clearance: clearance.MinClearance
) -> dict[str, Any]:
    """Return the curves for the report: time, smallest distance and its pair of bodies at samples ``rows``.

    The arrays are (K,), and their names start with that of the rule.
    """
    name = code.removeprefix("verify.")
    return {
        f"{name}/time": context.motion.time[rows],
        f"{name}/distance": min_clearance.distance,
        f"{name}/pair": np.array([" - ".join(pair) for pair in min_clearance.pair]),
    }


def _groups(context: Context, index: int, rows: IntArray) -> list[tuple[IntArray, clearance.Pairs]]:
    """Group the samples of a setup by the pairs of bodies that may touch at them.

    A bow's wire or a cutter may touch the block in cuts. The heads of forming tools may touch the sheet, and
    each other, while they form it.

    ``rows`` (K,) are the samples of setup ``index``.

    Returns:
        Samples of each group, and the pairs of bodies that are not measured at them.
    """
    all_arms = [arm.name for arm in context.setups[index].cell.arms]
    arm_edges_by_name = {arm: arm_edges for arm in all_arms if (arm_edges := find_edges(context, index, arm))}
    arms = list(arm_edges_by_name)
    if not arms or not len(rows):
        return [(rows, frozenset())] if len(rows) else []
    labels = context.motion.labels(rows)
    # forms, cuts (K, A): whether each of A arms with a working end forms, or works in another way. A head
    # that forms meets the other head (``meet``), so it also works; cutting excludes forming.
    forms, cuts = (
        np.stack([np.isin(labels, list(segments_of(arm_edges_by_name[arm], meet))) for arm in arms], axis=1)
        for meet in (True, False)
    )
    flags = np.concatenate([forms, cuts & ~forms], axis=1)
    out = []
    for combination in np.unique(flags, axis=0):
        form, cut = combination[: len(arms)], combination[len(arms) :]
        working_arms = [
            arm for arm, forms_here, cuts_here in zip(arms, form, cut, strict=True) if forms_here or cuts_here
        ]
        heads = [arm for arm, forms_here in zip(arms, form, strict=True) if forms_here]
        touching = {frozenset((f"{arm}/edge", "stock")) for arm in working_arms}
        touching |= {frozenset((f"{a}/edge", f"{b}/edge")) for a, b in itertools.combinations(heads, 2)}
        out.append((rows[(flags == combination).all(axis=1)], frozenset(touching)))
    return out


STEP_APART = "verify.step_apart"
"""Code of the rule on arms that are one step apart in time."""
INTERVAL_INSTANTS = 13
"""Number of instants of each arm in an interval at which the distance of the tools is computed."""
MAX_INSTANT_PAIRS = 50_000
"""Maximum number of pairs of instants whose clearance is measured."""
_INTERVALS_PER_BATCH = 2000
"""Number of intervals per batch."""
_PAIRS_PER_BATCH = 250
"""Number of pairs of instants per batch of distance queries."""
_MAX_ISSUES = 20
"""Maximum number of issues of one kind, the worst first."""


@dataclasses.dataclass(frozen=True)
class Intervals:
    """K intervals between two successive meetings of two controllers, in which both arms move.

    Attributes:
        first: Samples (K,) at which the intervals start, at a meeting with both arms at rest.
        last: Samples (K,) at which the intervals end, at the next meeting. They are included.
        stage: Number (K,) of the stage to which each interval belongs.
    """

    first: IntArray
    last: IntArray
    stage: IntArray

    def subset(self, chosen: BoolArray | IntArray) -> "Intervals":
        """Return a subset of the intervals."""
        return Intervals(self.first[chosen], self.last[chosen], self.stage[chosen])


def intervals(context: Context) -> Intervals:
    """Return the intervals between meetings in which both arms move, in the order of time.

    Within an interval the arms may be apart in time by any amount.
    """
    motion = context.motion
    first: list[IntArray] = []
    last: list[IntArray] = []
    stage: list[IntArray] = []
    for number, stage_text in enumerate(context.job.stages):
        nodes = np.flatnonzero(motion.node_stage == number)
        if not stage_text.ends or not len(nodes):
            continue
        # stage_text.ends: indices of the moves of the stage at whose ends the arms meet.
        ends = motion.node_sample[nodes[[end for end in stage_text.ends if end < len(nodes)]]]
        first_sample = int(np.searchsorted(motion.stage, number))
        first.append(np.concatenate([[first_sample], ends[:-1]]).astype(np.int64))
        last.append(ends)
        stage.append(np.full(len(ends), number, dtype=np.int64))
    empty = [np.zeros(0, dtype=np.int64)]
    return Intervals(
        np.concatenate([*first, *empty]), np.concatenate([*last, *empty]), np.concatenate([*stage, *empty])
    )


def tcp_distance_change(context: Context, all_intervals: Intervals) -> FloatArray:
    """Bound the change of the distance of both TCPs if the arms are not synchronous in an interval.

    With the TCPs a(s) and b(t) at instants s and t, the bound is the maximum of | |a(s) - b(t)| - |a(r) -
    b(r)| | for r = s and for r = t, over :data:`INTERVAL_INSTANTS` instants of each arm, evenly spaced along
    the path. The change of both distances half-way to the next instants is added: to first order along the
    line between the points, to second order across it.

    Args:
        context: The proof.
        all_intervals: K intervals.

    Returns:
        Bounds (K,) [m] of the deviation from the distance that the TCPs have when the arms move together.
    """
    a, b = (context.motion.tcp[task.arm.name].position for task in context.job.tasks)
    steps = [lengths(np.diff(p, axis=0)) for p in (a, b)]
    path = np.concatenate([[0.0], np.cumsum(steps[0] + steps[1])])  # of both TCPs together, (S,) [m]
    out = np.zeros(len(all_intervals.first))
    fractions = np.linspace(0.0, 1.0, INTERVAL_INSTANTS)
    for start in range(0, len(out), _INTERVALS_PER_BATCH):
        first = all_intervals.first[start : start + _INTERVALS_PER_BATCH]
        last = all_intervals.last[start : start + _INTERVALS_PER_BATCH]
        positions = path[first][:, None] + fractions * (path[last] - path[first])[:, None]
        rows = np.clip(np.searchsorted(path, positions), first[:, None], last[:, None])
        # rows (B, INTERVAL_INSTANTS): samples of B intervals, evenly spaced along the path, with both ends.
        rows[:, 0], rows[:, -1] = first, last
        out[start : start + _INTERVALS_PER_BATCH] = _distance_change_bound(a[rows], b[rows])
    return out


def _distance_change_bound(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the bound (K,) [m] of :func:`tcp_distance_change` for points (K, M, 3) at M instants.

    ``a`` and ``b`` [m] are the positions of the first and the second TCP in K intervals.
    """
    # Distance d(s, t) = |a_s - b_t| and the unit vectors between the points, (K, M, M) and (K, M, M, 3).
    direction = a[:, :, None] - b[:, None]
    distance = np.linalg.norm(direction, axis=3)
    direction /= np.maximum(distance, 1e-9)[..., None]
    # Change of d up to half-way to the next instants: |u . step| / 2 along the line u, and across it, with
    # c the sum of both half steps, c^2 / (2 (d - c)).
    change = np.zeros_like(distance)
    across = np.zeros_like(distance)
    for points, projection in ((a, "kstx,ksx->kst"), (b, "kstx,ktx->kst")):
        step = np.diff(points, axis=1)
        zero_step = np.zeros_like(step[:, :1])
        sides = [np.concatenate(parts, axis=1) for parts in ((step, zero_step), (zero_step, step))]
        change += 0.5 * np.max([np.abs(np.einsum(projection, direction, side)) for side in sides], axis=0)
        size = 0.5 * np.max([np.linalg.norm(side, axis=2) for side in sides], axis=0)
        # Instants s of the first TCP are on axis 1, instants t of the second one on axis 2.
        across += size[:, :, None] if projection.endswith("ksx->kst") else size[:, None]
    change += across**2 / (2.0 * np.maximum(distance - across, 1e-9))
    # Compare d(s, t) with d(s, s) and d(t, t), and add the changes of both distances.
    together, diagonal_change = np.einsum("kii->ki", distance), np.einsum("kii->ki", change)
    early = np.abs(distance - together[:, :, None]) + diagonal_change[:, :, None]
    late = np.abs(distance - together[:, None]) + diagonal_change[:, None]
    return np.asarray((np.maximum(early, late) + change).max(axis=(1, 2)))


@rule("verify.step_apart", parallel_group="bodies")
def step_apart(context: Context) -> RuleOutcome:
    """Arms that may be one step apart keep their clearance and tool distance at any two instants of a step.
    The deviation of the tool distance stays within its limit.
    """
    if context.job.automata_by_arm is None or len(context.job.tasks) != 2:
        return RuleOutcome(nothing="one controller")
    all_intervals = intervals(context)
    if not len(all_intervals.first):
        return RuleOutcome(nothing="the arms never move at the same time")
    findings = Findings(STEP_APART, context)
    _check_tcp_distance(findings, all_intervals)
    models, min_distance = context.get(MODELS), np.inf
    for index in range(len(context.setups)):
        in_setup = context.spans.of_stage[all_intervals.stage] == index
        if in_setup.any():
            min_distance = min(
                min_distance,
                _check_arm_clearance(findings, models(index), index, all_intervals.subset(in_setup)),
            )
    where = f"change of the TCP distance; clearance of the arms at least {mm(min_distance):.3g} mm"
    return dataclasses.replace(findings.outcome(mm, "mm"), where=where)


def _check_tcp_distance(findings: Findings, all_intervals: Intervals) -> None:
    """Check the claims that bound the change of the tool distance, in all intervals of their segments.

    The largest change [m] of all intervals and the smallest limit [m] are recorded in the findings.
    """
    context, change = findings.context, tcp_distance_change(findings.context, all_intervals)
    labels = context.motion.labels(all_intervals.last)
    limits = []
    for index, setup in enumerate(context.setup_claims):
        in_setup = context.spans.of_stage[all_intervals.stage] == index
        bounds = (c.tool_distance for group in setup.groups for c in group)
        for bound in (claimed for claimed in bounds if claimed is not None):
            rows = np.flatnonzero(in_setup & (labels == bound.segment.key))
            limits += [bound.change] if len(rows) else []
            over = rows[change[rows] > bound.change]
            for k in over[np.argsort(-change[over])][:_MAX_ISSUES].tolist():
                message = (
                    "with the arms one step apart the tool distance changes by up to "
                    f"{mm(change[k]):.4f} mm; allowed: {mm(bound.change):g} mm. "
                    "Let the arms meet at more targets, or shorten the moves"
                )
                findings.add_at_sample(
                    message, bound.arms[0], all_intervals.last[k], measure_in_mm(change[k], bound.change)
                )
    findings.note_highest(change.max(), limit=min(limits, default=None))


def _check_arm_clearance(findings: Findings, model: CellModel, index: int, all_intervals: Intervals) -> float:
    """Check the clearance between the arms in intervals of setup ``index``, at any two instants of each.

    The heads of two forming tools are not measured against each other while they form, because the face is
    between them whatever the instants. Pairs whose distance does not depend on the lag are left out, too:
    verify.clearance measures them. At most the 20 worst violations of each group are reported.

    Returns:
        Lower bound [m] of the distance between the arms: the smallest measured distance, or the smallest
        bound of the pairs of instants that a bound proves, whichever is less.
    """
    context = findings.context
    required = context.problem.settings.clearance
    ignore, heads = _time_independent_pairs(context, model, index), _tool_heads(context, model)
    forming = _forming_intervals(context, index, all_intervals)
    min_distance = np.inf
    for group, pairs in (
        (all_intervals.subset(forming), ignore | heads),
        (all_intervals.subset(~forming), ignore),
    ):
        if not len(group.first):
            continue
        rows, measured, bound = _measure_instant_pairs(context, model, index, group, pairs)
        min_distance = min(min_distance, bound, float(measured.distance.min(initial=np.inf)))
        violations = np.flatnonzero(~(measured.distance >= min_accepted_clearance(required)))
        for k in violations[np.argsort(measured.distance[violations])][:_MAX_ISSUES].tolist():
            bodies, distance = measured.pair[k], measured.distance[k]
            message = (
                f"with the arms one step apart {bodies[0]} and {bodies[1]} come within {mm(distance):.2f} "
                f"mm; allowed: {mm(required):.2f} mm"
            )
            findings.add_at_sample(
                message, _arm_of(context, bodies), rows[k], measure_in_mm(distance, required), bodies
            )
    return min_distance


def _arm_of(context: Context, pair: tuple[str, str]) -> str:
    """Return the arm under which an issue on a pair of bodies is reported.

    It is the arm of the first body that belongs to one, else that of the first task.
    """
    arms = [task.arm.name for task in context.job.tasks]
    return next((arm for body in pair if (arm := body.partition("/")[0]) in arms), arms[0])


def _measure_instant_pairs(
    context: Context, model: CellModel, index: int, all_intervals: Intervals, ignore: Pairs
) -> tuple[IntArray, clearance.MinClearance, float]:
    """Measure the clearance at the pairs of instants, one of each arm, for which a bound does not suffice.

    Branch and bound: Each item is a pair of stretches, one of each arm's path, at first a whole interval. The
    clearance with both arms in the middle of their stretches, minus the paths of both to the ends, bounds the
    clearance of all pairs of instants in the stretches. If the bound is too small, the longer stretch is
    halved, until no point moves farther than half of the proof's stride in either stretch. Then the clearance
    in the middle is measured. The measurement ends after :data:`MAX_VIOLATIONS` violations.

    Args:
        context: The proof.
        model: Model of the cell in the setup.
        index: Index of the setup.
        all_intervals: Intervals of this setup.
        ignore: Pairs of bodies that are not measured.

    Returns:
        Samples (M,) of the first arm at the measured pairs of instants, the distances (M,) there, and the
        lower bound [m] for the pairs that a bound proves, infinite if there are none.

    Raises:
        TandemError: Too many pairs are undecided (``verify.duration``).
    """
    required = context.problem.settings.clearance
    limit, query_range = min_accepted_clearance(required), max(MIN_QUERY_RANGE_M, 1.5 * required)
    arms = [task.arm.name for task in context.job.tasks]
    joints = [context.motion.link_joints[arm] for arm in arms]
    along = [np.concatenate([[0.0], np.cumsum(max_point_path(context, index, arm))]) for arm in arms]
    max_stretch = 0.5 * min(MAX_SAMPLE_STRIDE_M, max(required, MIN_SAMPLE_STRIDE_M))
    min_bound = np.inf
    leaves: list[IntArray] = []
    stretches = np.stack([all_intervals.first, all_intervals.last, all_intervals.first, all_intervals.last])
    # Branch and bound over M pairs of stretches. The rows of ``stretches`` (4, M) are the first and last
    # samples of the first arm's stretch, then of the second arm's. ``along``: path (S,) [m] of each arm.
    while stretches.shape[1]:
        middle, path_to_end = _middle_samples(along, stretches)
        joints_there = {arm: q[rows] for arm, q, rows in zip(arms, joints, middle, strict=True)}
        bound = clearance.distance_lower_bound(model, joints_there, query_range, ignore) - path_to_end
        is_proven = bound >= limit
        min_bound = min(min_bound, float(bound[is_proven].min(initial=np.inf)))
        # Path [m] of each arm in its stretch. A stretch of one step cannot be halved, so it counts as 0.
        length = [
            np.where(
                stretches[2 * k + 1] - stretches[2 * k] > 1,
                path[stretches[2 * k + 1]] - path[stretches[2 * k]],
                0.0,
            )
            for k, path in enumerate(along)
        ]
        is_short = np.maximum(*length) <= max_stretch
        leaves.append(np.stack(middle)[:, ~is_proven & is_short])
        measured_count = sum(part.shape[1] for part in leaves)
        split = ~is_proven & ~is_short
        if measured_count + np.count_nonzero(split) > MAX_INSTANT_PAIRS:
            message = (
                "clearance of arms one step apart: too many undecided pairs of instants (got over "
                f"{MAX_INSTANT_PAIRS}, which is the limit). Split the job"
            )
            measure = MAX_INSTANT_PAIRS, MAX_INSTANT_PAIRS, None
            raise TandemError(measured_issue("verify.duration", message, measure))
        stretches = _halve(
            stretches[:, split], [rows[split] for rows in middle], (length[0] >= length[1])[split]
        )
    # Measure the pairs that no bound decides, until enough violations are known.
    rows = np.concatenate(leaves, axis=1)
    measurements: list[clearance.MinClearance] = []
    for start in range(0, rows.shape[1], _PAIRS_PER_BATCH):
        batch = rows[:, start : start + _PAIRS_PER_BATCH]
        joints_there = {arm: q[arm_rows] for arm, q, arm_rows in zip(arms, joints, batch, strict=True)}
        measurements.append(clearance.min_clearance(model, joints_there, query_range, ignore))
        if sum(int(np.count_nonzero(~(part.distance >= limit))) for part in measurements) > MAX_VIOLATIONS:
            break
    distance = np.concatenate([np.zeros(0), *(part.distance for part in measurements)])
    pairs = tuple(pair for part in measurements for pair in part.pair)
    return rows[0, : len(distance)], clearance.MinClearance(distance, pairs), min_bound


def _middle_samples(along: list[FloatArray], stretches: IntArray) -> tuple[list[IntArray], FloatArray]:
    """Return the middle samples of pairs of stretches, and the paths from there to the ends.

    Args:
        along: Path length (S,) [m] of each arm at each sample.
        stretches: First and last samples of both stretches, (4, M).

    Returns:
        Middle sample (M,) of each arm's stretches, and sum (M,) [m] of both arms' paths to the farther ends.
    """
    rows, path_to_end = [], np.zeros(stretches.shape[1])
    for k, path in enumerate(along):
        first, last = stretches[2 * k], stretches[2 * k + 1]
        middle_row = np.clip(np.searchsorted(path, 0.5 * (path[first] + path[last])), first, last)
        inner = np.clip(middle_row, first + 1, np.maximum(last - 1, first + 1))
        middle_row = np.where(last - first > 1, inner, middle_row)
        rows.append(middle_row)
        path_to_end += np.maximum(path[middle_row] - path[first], path[last] - path[middle_row])
    return rows, path_to_end


def _halve(stretches: IntArray, middle: list[IntArray], first: BoolArray) -> IntArray:
    """Halve one of the two stretches of each of M pairs, and return both halves, (4, 2 M).

    Args:
        stretches: First and last samples of both stretches, (4, M).
        middle: Middle sample (M,) of each arm's stretches, which becomes an end of both halves.
        first: Whether the stretch of the first arm is halved (M,), rather than that of the second arm.
    """
    first_half, second_half = stretches.copy(), stretches.copy()
    for k, chosen in enumerate((first, ~first)):
        first_half[2 * k + 1, chosen] = middle[k][chosen]
        second_half[2 * k, chosen] = middle[k][chosen]
    return np.concatenate([first_half, second_half], axis=1)


def _tool_heads(context: Context, model: CellModel) -> Pairs:
    """Return one pair with the heads of both arms' tools, which may touch while they form.

    The head is the body ``edge`` of an arm. There is no pair if a tool has none.
    """
    names = frozenset(f"{task.arm.name}/edge" for task in context.job.tasks)
    return frozenset({names}) if names <= {solid.body for solid in model.solids} else frozenset()


def _forming_intervals(context: Context, index: int, all_intervals: Intervals) -> BoolArray:
    """Return flags (K,) of the intervals in which the heads of two forming tools need no clearance.

    In all moves of such an interval both arms form, or a claim bounds the tool distance. While both arms
    form, ``verify.gouge`` and ``verify.sheet`` prove that the heads of their tools are on
    different sides of one face, whatever the instants.
    """
    motion, setup = context.motion, context.setup_claims[index]
    arms = (task.arm.name for task in context.job.tasks)
    names = frozenset.intersection(*(segments_of(find_edges(context, index, arm), meet=True) for arm in arms))
    bounds = (c.tool_distance for group in setup.groups for c in group)
    names |= {bound.segment.key for bound in bounds if bound is not None}
    # An interval has no other move if the number of other moves does not grow from its first to its last.
    other = np.isin(motion.node_label, sorted(names), invert=True).astype(np.int64)
    count = np.concatenate([[0], np.cumsum(other)])
    first = motion.node[np.minimum(all_intervals.first + 1, all_intervals.last)]
    last = motion.node[all_intervals.last]
    return np.asarray(count[last + 1] == count[first])


def _time_independent_pairs(context: Context, model: CellModel, index: int) -> Pairs:
    """Return the pairs of bodies whose distance does not depend on how far the arms are apart in time.

    They are all pairs except those of a body of one arm and a body of another arm.
    """
    arms = [task.arm.name for task in context.job.tasks]
    names = sorted({solid.body for solid in model.solids})
    arm_of_body = {name: next((arm for arm in arms if name.startswith(f"{arm}/")), "") for name in names}
    return frozenset(
        frozenset((a, b))
        for a, b in itertools.combinations(names, 2)
        if arm_of_body[a] == arm_of_body[b] or not arm_of_body[a] or not arm_of_body[b]
    )
