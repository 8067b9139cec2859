"""verify.level: one level of a pass alone, of the problem's number, deeper by what its file says.

The shifts follow from forces that were measured while the part was formed, so nobody can work them out again:
they are held against the problem's limits, their file against the problem, and the replayed way against the
file's. What is left without them is judged by the other rules, as any released tool is.
"""

from collections.abc import Iterator

import numpy as np

from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.claims import FormsLevel, FormsSheet
from planner.processes.forming.proof import loop_walls, springback_file
from planner.processes.forming.proof.level import OneLevel
from planner.processes.forming.proof.state import FORMING, Formed, Forming
from planner.proof.context import Context
from planner.proof.findings import Findings, in_mm
from planner.proof.rule import Measure, Outcome, at_sample, issue, mm, rule

CODE = "verify.level"
"""Code of this rule."""
NOTHING = "no level is formed alone"
"""Why it has not run."""
OFF_STEP = 0.5
"""Share of a step by which a level may reach beyond its heights: its neighbours reach a whole one. In fillets
that the ball just fits, what it touches moves by a multiple of what the ball does."""
WAY_OFF = 1e-4
"""The replayed way is off the file's by no more [m] while it forms."""


@rule("verify.level", FormsLevel)
def level(context: Context) -> Outcome:
    """One level alone is formed, the one that the problem states, between its heights; tools are deeper by
    what its file says, which is of this job and level, within the problem's limits, begins where the level
    before ended, and makes no wall steeper from there than the metal stands."""
    forming, findings = context.get(FORMING), Findings(CODE, context)
    findings.issues += _claimed(context, forming)
    for one in forming.levels:
        found = [*_stated(one)]
        found += [*_file(context, one)] if not found else []
        made = next((f for f in forming.formed if f.setup == one.index and f.claim is one.sheet), None)
        if made is None:
            findings.issues += [*found, _issue(one, f"{one.claim.segment} is not formed")]
            continue
        if not found:
            off, beyond = _heights(context, one, made)
            walls = loop_walls.of_level(made, one)
            steep = loop_walls.too_steep(CODE, context, forming, made, walls)
            found = [*beyond, *_way(context, one, made), *steep]
            findings.highest(off, one.claim.segment, OFF_STEP * one.step)
        findings.issues += found
    if not findings.measured:
        return findings.outcome_without_value("" if findings.issues else NOTHING)
    return findings.outcome(mm, "mm beyond its heights")


def _issue(one: OneLevel, what: str, measure: Measure | None = None) -> Issue:
    return issue(CODE, f"{one.claim.operation}: {what}", measure, field="level")


def _claimed(context: Context, forming: Forming) -> Iterator[Issue]:
    """Operations that form a level alone have one claim that says so."""
    for operation in context.problem.operations:
        wanted = int(getattr(operation, "level", None) is not None)
        found = sum(one.claim.operation == operation.name for one in forming.levels)
        if found != wanted:
            what = f"{operation.name} forms {wanted} levels alone, and of {found} that is claimed"
            yield Issue(CODE, what, field="level")


def _stated(one: OneLevel) -> Iterator[Issue]:
    if one.fault or one.operation is None:
        yield _issue(one, one.fault or "there is no operation of that name")
        return
    stated = one.operation.level
    name = one.first if stated.pass_name is None else stated.pass_name
    if one.sheet is None or one.claim.segment.name != name:
        yield _issue(one, f"{one.claim.segment} is formed; wanted is a level of {name}")
    elif stated.number >= one.count:
        what = f"{one.claim.segment} has levels 0 to {one.count - 1}, not {stated.number}"
        yield _issue(one, what, (float(stated.number), float(one.count - 1), None))
    elif stated.number == 0 and stated.before_mm > 0.0:
        what = f"the first level begins with a shift of {stated.before_mm:g} mm, as if one were before it"
        yield _issue(one, what, (float(stated.before_mm), 0.0, "mm"))


def _file(context: Context, one: OneLevel) -> Iterator[Issue]:
    """Whether the file is of this very job, pass and level, and within the problem's limits."""
    stated, given = one.operation.level, one.given
    if given is None:
        return
    job = springback_file.of_job(context.problem, context.setups[one.index], one.operation)
    if job is None:
        yield _issue(one, "there is no sheet that comes back")
        return
    mine = {"plan": stated.plan, "level": stated.number, "pass": one.claim.segment.name, **job}
    said = {"plan": given.plan, "level": given.number, "pass": given.name, **given.belongs}
    for name in springback_file.differing(said, mine):
        yield _issue(one, f"its file is of another: {name} is {said.get(name)}, here {mine.get(name)}")
    first = float(stated.before_mm) * MM
    for what, got, limit, unit in given.way.faults(float(stated.slope), float(stated.most_mm) * MM, first):
        told = f"its file has {what}: {got:.4g} {unit}; allowed: {limit:g}"
        yield _issue(one, told, (got, limit, unit))


def _heights(context: Context, one: OneLevel, made: Formed) -> tuple[float, list[Issue]]:
    """How far [m] what the ball touches while it forms is beyond the heights of its level."""
    claim: FormsSheet = made.claim
    near = made.near
    use = made.track.own[made.knots[near.row]] & made.touches[near.row]
    if not use.any():
        return 0.0, [_issue(one, f"the ball touches nothing of {claim.segment}")]
    depth = claim.side * (claim.start - near.tied[use, 2])
    begin, end = one.depths
    most = OFF_STEP * one.step
    if depth.max() < end - most or (one.operation.path == "helical" and depth.min() > begin + most):
        what = (
            f"level {one.operation.level.number} of {claim.segment} goes from {mm(begin):g} to {mm(end):g} "
            f"mm below the flat; formed is {mm(float(depth.min())):.3f} to {mm(float(depth.max())):.3f} mm"
        )
        return 0.0, [_issue(one, what, in_mm(depth.max(), end))]
    beyond = np.maximum(begin - depth, depth - end)
    k = int(np.argmax(beyond))
    off = max(float(beyond[k]), 0.0)
    if off <= most:
        return off, []
    what = (
        f"level {one.operation.level.number} of {claim.segment} is {mm(begin):g} to {mm(end):g} mm below the "
        f"flat; the ball forms {mm(float(depth[k])):.3f} mm below it"
    )
    row = int(made.track.rows[made.knots[near.row[use][k]]])
    return off, [at_sample(CODE, what, context.motion, claim.arm, row, in_mm(off, most))]


def _way(context: Context, one: OneLevel, made: Formed) -> Iterator[Issue]:
    """Whether the forming ball is on the file's way, shifted, all the time that it forms."""
    if one.given is None:
        return
    aside = made.track.aside
    if aside is None or not len(aside):
        yield _issue(one, f"{made.claim.segment} has no way in its file, or in the programs")
        return
    k = int(np.argmax(aside))
    if aside[k] > WAY_OFF:
        what = f"{made.claim.arm} is {mm(float(aside[k])):.3f} mm off the way of the level's file"
        row, measure = int(made.track.rows[k]), in_mm(aside[k], WAY_OFF)
        yield at_sample(CODE, what, context.motion, made.claim.arm, row, measure)
