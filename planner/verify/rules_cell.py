"""Rules on clearance: bodies against bodies, and the wire against everything."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.cell import clearance
from planner.cell.edge import Against, edge
from planner.cell.plant import CellModel
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.looks import PRECISE, looks, measured
from planner.verify.wire import Wire

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Models = Callable[[int], CellModel]

BETWEEN = 1e-3
"""How much less than the wanted clearance is accepted between targets [m], a tenth of it at most."""
REACH = 0.1
NEAR_CLAMP = 0.02
"""Length of wire next to a clamp that is not held against that clamp [m]."""


def accepted(wanted: float) -> float:
    """Least clearance [m] that passes where one is wanted."""
    return wanted - min(BETWEEN, 0.1 * wanted)


def bodies(context: Context, models: Models) -> tuple[Outcome, IntArray, clearance.LeastClearance]:
    """Robots, tools, block and obstacles keep apart; a bow's wire passes the block where it cuts. Bodies that
    stand are not inside of one another: the block and what bears it, bases, obstacles."""
    wanted = context.problem.settings.clearance
    limit = accepted(wanted)
    issues: list[Issue] = []
    looked: list[IntArray] = []
    distance: list[FloatArray] = []
    pairs: list[tuple[str, str]] = []
    rest = np.inf
    for index in range(len(context.setups)):
        for one, other, deep in clearance.overlaps(models(index)):
            what = f"{one} and {other}, which stand still, are {mm(deep):.1f} mm inside of one another"
            issues.append(Issue("verify.clearance", what, bodies=(one, other), value=-mm(deep), unit="mm"))
        rows = looks(context, index)
        for chosen, ignore in _groups(context, index, rows):
            model = models(index)
            missing = {name for pair in ignore for name in pair} - {s.body for s in model.solids}
            if missing:
                what = f"the cell's model has no body {sorted(missing)[0]}"
                issues.append(Issue("verify.clearance", what, hint="state the edge of the bow's tool"))
                continue
            q = {arm: q[chosen] for arm, q in context.motion.q.items()}
            found = measured(model, q, limit, max(REACH, 1.5 * wanted), ignore)
            looked.append(chosen[found.look])
            distance.append(found.least.distance)
            pairs += found.least.pair
            rest = min(rest, found.rest)
    rows = np.concatenate([*looked, np.zeros(0, dtype=np.int64)])
    order = np.argsort(rows, kind="stable")
    rows = rows[order]
    everywhere = np.concatenate([*distance, np.zeros(0)])[order]
    least = clearance.LeastClearance(everywhere, tuple(pairs[i] for i in order))
    for i in np.flatnonzero(~(everywhere >= limit)):
        pair = least.pair[int(i)]
        message = (
            f"{pair[0]} and {pair[1]} come within {mm(everywhere[i]):.2f} mm; allowed: {mm(wanted):.2f} mm"
        )
        arm = context.job.tasks[0].arm.name
        measure = (mm(everywhere[i]), mm(wanted), "mm")
        issues.append(
            at_sample("verify.clearance", message, context.motion, arm, int(rows[i]), measure, pair)
        )
    if not len(rows):
        return Outcome(tuple(issues), where="nothing moves"), rows, least
    k = least.worst()
    where = " and ".join(least.pair[k]) if least.pair[k][0] else "nothing near"
    worst = float(everywhere[k])
    if rest < worst - PRECISE:
        worst, where = rest, "a bound; bodies may keep farther apart"
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm", where), rows, least


def _groups(context: Context, index: int, rows: IntArray) -> list[tuple[IntArray, clearance.Pairs]]:
    """Samples of a setup by the pairs of bodies that may touch there: a bow's wire, or a cutter, and the
    block in cuts, the heads of forming tools and the sheet between them where they form it."""
    claims = context.setup_claims[index]
    arms = [arm.name for arm in context.setups[index].cell.arms]
    arms = [arm for arm in arms if arm in claims.straight or claims.forms(arm) or claims.mills(arm)]
    if not arms or not len(rows):
        return [(rows, frozenset())] if len(rows) else []
    labels = context.motion.labels(rows)
    forms = np.stack([np.isin(labels, list(claims.forms(arm))) for arm in arms], axis=1)
    cuts = np.stack([np.isin(labels, list(claims.cuts((arm,)) | claims.mills(arm))) for arm in arms], axis=1)
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


def wire_bodies(
    context: Context, models: Models, wires: tuple[Wire, ...]
) -> tuple[Outcome, list[FloatArray]]:
    """A bent wire keeps clear of everything, but of the stock only where it does not cut."""
    issues: list[Issue] = []
    series, least, where = [], np.inf, ""
    limit = context.problem.settings.clearance
    for wire in wires:
        distance = np.full(len(wire.sample), np.nan)
        series.append(distance)
        if wire.path is None:
            continue
        cut = wire.cutting
        groups: tuple[tuple[Against, IntArray], ...] = (
            ("no_stock", np.flatnonzero(cut)),
            ("all", np.flatnonzero(~cut)),
        )
        for against, chosen in groups:
            if not len(chosen):
                continue
            rows = wire.sample[chosen]
            found = edge(
                models(wire.setup),
                {arm: context.motion.q[arm][rows] for arm in wire.arms},
                wire.world[chosen],
                wire.radius,
                NEAR_CLAMP,
                against,
            )
            distance[chosen] = found.distance
            for i in np.flatnonzero(~(found.distance >= accepted(limit))):
                pair = found.pair[int(i)]
                message = (
                    f"the wire comes within {mm(found.distance[i]):.2f} mm of {' and '.join(pair)}; "
                    f"allowed: {mm(limit):.2f} mm"
                )
                measure = (mm(found.distance[i]), mm(limit), "mm")
                sample, arm = int(rows[i]), wire.arms[0]
                issues.append(
                    at_sample("verify.wire_clearance", message, context.motion, arm, sample, measure, pair)
                )
            k = found.worst()
            if found.distance[k] < least:
                least, where = float(found.distance[k]), " and ".join(found.pair[k])
    if not np.isfinite(least):
        return Outcome(tuple(issues), where="no bent wire"), series
    return Outcome(tuple(issues), mm(least), mm(limit), "mm", where), series
