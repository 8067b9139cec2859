"""verify.level: a single level of a pass, with the problem's number, shifted as its file states.

The shifts follow from forces that were measured while the part was formed, so they cannot be recalculated.
They are compared with the problem's limits, their file with the problem, and the replayed path with the
file's. The tools without the shifts are checked by the other rules.
"""

from collections.abc import Iterator

import numpy as np

from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.claims import FormsLevel, FormsSheet
from planner.processes.forming.proof import loop_walls, springback_file
from planner.processes.forming.proof.forming_facts import FORMING, FormedPass, FormingFacts
from planner.processes.forming.proof.level import SingleLevel
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_mm
from planner.proof.rule import Measure, RuleOutcome, measured_issue, mm, rule, sample_issue

CODE = "verify.level"
"""Code of this rule."""
NOT_RUN_REASON = "no single level is formed"
"""Reason that is reported if the rule has nothing to check."""
MAX_EXCESS_STEPS = 0.5
"""Fraction of a step by which the ball may touch the face beyond the heights of its level.

In fillets that just admit the ball, the touched point moves by a multiple of the ball's motion. The adjacent
levels are a whole step away.
"""
MAX_PATH_DISTANCE_M = 1e-4
"""Maximum distance [m] of the replayed path from the file's while it forms."""


@rule("verify.level", FormsLevel)
def check_level(context: Context) -> RuleOutcome:
    """A single level is formed, the one that the problem states, between its heights; tools are deeper by the
    shifts of its file, which belongs to this job and level, is within the problem's limits, starts where the
    previous level ended, and makes no wall steeper from there than the metal allows.
    """
    forming, findings = context.get(FORMING), Findings(CODE, context)
    findings.issues += _claim_issues(context, forming)
    for single_level in forming.levels:
        found_issues = [*_statement_issues(single_level)]
        found_issues += [*_file_issues(context, single_level)] if not found_issues else []
        formed = next(
            (f for f in forming.formed if f.setup == single_level.index and f.claim is single_level.sheet),
            None,
        )
        if formed is None:
            findings.issues += [
                *found_issues,
                _level_issue(single_level, f"{single_level.claim.segment} is not formed"),
            ]
            continue
        if not found_issues:
            excess, height_issues = _height_issues(context, single_level, formed)
            walls = loop_walls.level_walls(formed, single_level)
            steep = loop_walls.steep_wall_issues(CODE, context, forming, formed, walls)
            found_issues = [*height_issues, *_path_issues(context, single_level, formed), *steep]
            findings.note_highest(excess, single_level.claim.segment, MAX_EXCESS_STEPS * single_level.step)
        findings.issues += found_issues
    if not findings.measured:
        return findings.outcome_without_value("" if findings.issues else NOT_RUN_REASON)
    return findings.outcome(mm, "mm beyond its heights")


def _level_issue(level: SingleLevel, message: str, measure: Measure | None = None) -> Issue:
    return measured_issue(CODE, f"{level.claim.operation}: {message}", measure, field="level")


def _claim_issues(context: Context, forming: FormingFacts) -> Iterator[Issue]:
    """Check that an operation that forms a single level has exactly one claim for it, others none."""
    for operation in context.problem.operations:
        required = int(getattr(operation, "level", None) is not None)
        claimed = sum(level.claim.operation == operation.name for level in forming.levels)
        if claimed != required:
            message = f"{operation.name} forms {required} single levels, got claims for {claimed}"
            yield Issue(CODE, message, field="level")


def _statement_issues(level: SingleLevel) -> Iterator[Issue]:
    """Check what the problem states on a level: its file, its pass, its number and its first shift."""
    if level.fault or level.operation is None:
        yield _level_issue(level, level.fault or "there is no operation of that name")
        return
    stated = level.operation.level
    name = level.first_pass if stated.pass_name is None else stated.pass_name
    if level.sheet is None or level.claim.segment.name != name:
        yield _level_issue(level, f"{level.claim.segment} is formed, expected a level of {name}")
    elif stated.number >= level.level_count:
        message = f"{level.claim.segment} has levels 0 to {level.level_count - 1}, not {stated.number}"
        yield _level_issue(level, message, (float(stated.number), float(level.level_count - 1), None))
    elif stated.number == 0 and stated.before_mm > 0.0:
        message = f"the first level starts with a shift of {stated.before_mm:g} mm, but has no previous level"
        yield _level_issue(level, message, (float(stated.before_mm), 0.0, "mm"))


def _file_issues(context: Context, level: SingleLevel) -> Iterator[Issue]:
    """Check that the file belongs to this job, pass and level, and that its shifts are within the limits."""
    stated, level_file = level.operation.level, level.file
    if level_file is None:
        return
    job = springback_file.job_identity_of(context.problem, context.setups[level.index], level.operation)
    if job is None:
        yield _level_issue(level, "there is no sheet that springs back")
        return
    own_identity = {"plan": stated.plan, "level": stated.number, "pass": level.claim.segment.name, **job}
    file_identity = {
        "plan": level_file.plan,
        "level": level_file.number,
        "pass": level_file.name,
        **level_file.belongs,
    }
    for name in springback_file.differing_names(file_identity, own_identity):
        yield _level_issue(
            level,
            f"its file does not match: {name} is {file_identity.get(name)}, here {own_identity.get(name)}",
        )
    first_shift = float(stated.before_mm) * MM
    for fault, got, limit, unit in level_file.path.faults(
        float(stated.slope), float(stated.most_mm) * MM, first_shift
    ):
        message = f"its file has {fault}: {got:.4g} {unit}, allowed: {limit:g}"
        yield _level_issue(level, message, (got, limit, unit))


def _height_issues(context: Context, level: SingleLevel, formed: FormedPass) -> tuple[float, list[Issue]]:
    """Return how far [m] beyond the heights of its level the ball touches the face, and at most one issue.

    It is an issue if the ball touches the face more than MAX_EXCESS_STEPS steps beyond these heights, does
    not reach the level's end, or on a helical path does not start at the level's start.
    """
    claim: FormsSheet = formed.claim
    nearest = formed.nearest
    is_touch = formed.track.is_forming[formed.knots[nearest.row]] & formed.is_touching[nearest.row]
    if not is_touch.any():
        return 0.0, [_level_issue(level, f"the ball touches nothing of {claim.segment}")]
    depth = claim.side * (claim.start - nearest.tied[is_touch, 2])
    start, end = level.depths
    tolerance = MAX_EXCESS_STEPS * level.step
    if depth.max() < end - tolerance or (
        level.operation.path == "helical" and depth.min() > start + tolerance
    ):
        message = (
            f"level {level.operation.level.number} of {claim.segment} is {mm(start):g} to {mm(end):g} "
            f"mm below the flat, formed is {mm(float(depth.min())):.3f} to {mm(float(depth.max())):.3f} mm"
        )
        return 0.0, [_level_issue(level, message, measure_in_mm(depth.max(), end))]
    beyond = np.maximum(start - depth, depth - end)
    k = int(np.argmax(beyond))
    excess = max(float(beyond[k]), 0.0)
    if excess <= tolerance:
        return excess, []
    message = (
        f"level {level.operation.level.number} of {claim.segment} is {mm(start):g} to {mm(end):g} mm below "
        f"the flat, but the ball forms {mm(float(depth[k])):.3f} mm below it"
    )
    row = int(formed.track.rows[formed.knots[nearest.row[is_touch][k]]])
    return excess, [
        sample_issue(CODE, message, context.motion, claim.arm, row, measure_in_mm(excess, tolerance))
    ]


def _path_issues(context: Context, level: SingleLevel, formed: FormedPass) -> Iterator[Issue]:
    """Check that the forming ball, shifts included, is on the file's path all the time that it forms."""
    if level.file is None:
        return
    distance = formed.track.path_distance
    if distance is None or not len(distance):
        yield _level_issue(level, f"{formed.claim.segment} has no path in its file, or in the programs")
        return
    worst_index = int(np.argmax(distance))
    if distance[worst_index] > MAX_PATH_DISTANCE_M:
        message = (
            f"{formed.claim.arm} is {mm(float(distance[worst_index])):.3f} mm off the path of the level's "
            "file"
        )
        sample = int(formed.track.rows[worst_index])
        measure = measure_in_mm(distance[worst_index], MAX_PATH_DISTANCE_M)
        yield sample_issue(CODE, message, context.motion, formed.claim.arm, sample, measure)
