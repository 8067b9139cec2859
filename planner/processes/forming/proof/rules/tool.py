"""Rules on the forming tool, the sheet that it meets, and the clamp.

verify.gouge, formed, feature_order, forming_feed and lean are on the forming tool. verify.sheet is on the
sheet that tools meet besides the face that they form: formed sheet, walls and the flat sheet. verify.holder
is on a clamp that sinks with the sheet's rim. Of the clamp only its signal is known: it is as many steps
below its start as there were pulses. The level of the tool is that of the replayed motion.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue
from planner.processes.forming.claims import (
    FormingFeed,
    FormsInOrder,
    FormsSheet,
    LimitsToolTilt,
    SheetState,
    SinksHolder,
)
from planner.processes.forming.proof import swept_volume
from planner.processes.forming.proof.face import ProofFace
from planner.processes.forming.proof.formed_depth import (
    TrackDepths,
    approach_retreat_depths,
    forming_depths,
    largest_step,
)
from planner.processes.forming.proof.forming_facts import FORMING, FormedPass, FormingFacts
from planner.processes.forming.proof.loop_coverage import MIN_LOOP_FRACTION, sparsest_window
from planner.processes.forming.proof.swept_volume import (
    ENVELOPES,
    HeadPath,
    InsideQuery,
    ToolHead,
    distance_above_level,
    formed_levels,
    run_inside_queries,
)
from planner.processes.forming.proof.tracks import SAMPLES_AT_ONCE, ToolTrack, VectorRows
from planner.proof.context import Context
from planner.proof.faces import subdivide
from planner.proof.findings import Findings, measure_in_degrees, measure_in_mm, measure_in_percent, to_degrees
from planner.proof.rule import MAX_FEED_FACTOR, RuleOutcome, mm, rule
from planner.proof.verdict import CutFace
from planner.runtime.executor import Executor
from planner.runtime.memory import release_memory

NOTHING_FORMED_REASON = "nothing is formed"
"""Reason why rules about forming have not run."""
MAX_SHOWN_ISSUES = 50
"""Maximum number of issues for each rule and segment."""
MAX_LIFTED_FRACTION = 0.1
"""Maximum fraction of the path in a forming segment on which the ball may be off the face, as it is on steps
between loops.
"""
STANDOFF_TOLERANCE_FACTOR, STANDOFF_TOLERANCE_M = 1.03, 2e-5
"""Factor and offset [m] by which a ball's distance from the part, which is evaluated at discrete points, may
exceed its limit.
"""


@rule("verify.gouge", FormsSheet)
def check_gouge(context: Context) -> RuleOutcome:
    """At every instant, also on its approach and retreat, the forming ball is on its side of the face it
    forms and of the flat beyond, and cuts into neither by more than the tolerance.
    """
    forming, findings = context.get(FORMING), Findings("verify.gouge", context)
    for formed_pass in forming.formed:
        claim = formed_pass.claim
        if not len(formed_pass.pieces.first):
            continue
        need = claim.radius - claim.tolerance
        at_knots = claim.side * formed_pass.nearest.signed
        first, last = (
            np.searchsorted(formed_pass.knots, rows)
            for rows in (formed_pass.pieces.first, formed_pass.pieces.last)
        )
        start, end = (formed_pass.track.centre[formed_pass.knots[rows], 0] for rows in (first, last))
        deviation = formed_pass.pieces.deviation
        between = formed_pass.face.line_distance(start, end, np.minimum(need + deviation, claim.radius))
        distance = np.minimum(np.minimum(at_knots[first], at_knots[last]), between - deviation)
        depth = claim.radius - distance
        findings.note_excess(depth, claim.tolerance, claim.segment)
        for i in first_of_runs(depth > claim.tolerance):
            message = (
                f"in {claim.segment} the ball cuts {mm(depth[i]):.3f} mm into the face or the flat sheet, "
                f"allowed: {mm(claim.tolerance):g} mm"
            )
            row = formed_pass.track.rows[formed_pass.pieces.last[i]]
            findings.add_at_sample(message, claim.arm, row, measure_in_mm(depth[i], claim.tolerance))
    return findings.excess_outcome(NOTHING_FORMED_REASON)


@rule("verify.formed", FormsSheet)
def check_formed(context: Context) -> RuleOutcome:
    """The forming ball reaches all of a face except a stated fraction, within the scallop, goes all around it
    at every stated step, is off it for at most a tenth of its path, and nothing is formed that is not
    claimed.
    """
    forming, findings = context.get(FORMING), Findings("verify.formed", context)
    _add_unclaimed_moves(findings, forming)
    faces: list[CutFace] = []
    for formed_pass, face in zip(forming.formed, context.get(ENVELOPES), strict=True):
        claim, field = formed_pass.claim, str(formed_pass.claim.segment)
        faces.append(face)
        limit = forming.allowed_standoff(formed_pass)
        if limit is not None and face.unreached > STANDOFF_TOLERANCE_FACTOR * limit + STANDOFF_TOLERANCE_M:
            message = (
                f"a ball of that size stays {mm(face.unreached):.3f} mm off the part in {claim.segment}, the "
                f"problem allows {mm(limit):g} mm"
            )
            findings.add(message, measure_in_mm(face.unreached, limit), field=field)
        if face.share < claim.share:
            scallop_range = f"{mm(face.allowed.min()):.3g} to {mm(face.tolerance):.3g} mm"
            message = (
                f"the ball passes {100 * face.share:.2f} % of the walls of {claim.segment} within what the "
                f"steps of its path leave there, {scallop_range}, required: {100 * claim.share:g} %"
            )
            findings.add(message, measure_in_percent(face.share, claim.share), field=field)
        window = (
            sparsest_window(formed_pass, forming.pass_steps(formed_pass))
            if formed_pass.level is None
            else None
        )
        if window is not None and window.fraction < MIN_LOOP_FRACTION:
            message = (
                f"from {mm(window.start):.2f} to {mm(window.end):.2f} mm below the flat around "
                f"{claim.segment} the ball goes along {mm(window.path_length):.1f} mm of its walls, which "
                f"are {mm(window.contour):.1f} mm around there, but the stated steps require a whole loop"
            )
            findings.add(message, measure_in_percent(window.fraction, MIN_LOOP_FRACTION), field=field)
        lifted = _lifted_fraction(formed_pass)
        if lifted > MAX_LIFTED_FRACTION:
            message = (
                f"the ball is off the face for {100 * lifted:.1f} % of its path in {claim.segment}, "
                f"allowed: {100 * MAX_LIFTED_FRACTION:g} %"
            )
            findings.add(message, measure_in_percent(lifted, MAX_LIFTED_FRACTION), field=field)
    if not faces:
        return RuleOutcome(
            tuple(findings.issues), nothing=NOTHING_FORMED_REASON, part=swept_volume.formed_obj(forming)
        )
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    return RuleOutcome(
        tuple(findings.issues),
        100 * worst.share,
        100 * worst.wanted_share,
        "% within the scallop",
        worst.title,
        faces=tuple(faces),
        part=swept_volume.formed_obj(forming),
    )


def _lifted_fraction(formed: FormedPass) -> float:
    """Return the fraction of the path of a pass on which the ball is too far from the face.

    Its distance exceeds the scallop there.
    """
    use = formed.track.is_forming[formed.pieces.first]
    first, last = formed.pieces.first[use], formed.pieces.last[use]
    length = np.linalg.norm(formed.track.centre[last, 0] - formed.track.centre[first, 0], axis=1)
    is_lifted = ~(
        formed.is_touching[np.searchsorted(formed.knots, first)]
        | formed.is_touching[np.searchsorted(formed.knots, last)]
    )
    return float(length[is_lifted].sum() / max(float(length.sum()), 1e-12)) if len(length) else 1.0


def _add_unclaimed_moves(findings: Findings, forming: FormingFacts) -> None:
    """Add an issue for each label of forming moves that no claim covers, at its first node."""
    motion, arm = findings.context.motion, findings.context.job.tasks[0].arm.name
    seen: set[str] = set()
    for node, (segment, name) in enumerate(zip(motion.node_segment, motion.node_label, strict=True)):
        if segment.kind == "form" and name not in forming.labels and name not in seen:
            seen.add(name)
            message = f"the programs form in {segment}, for which there is no claim"
            findings.add_at_node(message, arm, node)


@rule("verify.feature_order", FormsInOrder)
def check_feature_order(context: Context) -> RuleOutcome:
    """The segments that form the sheet come in the claimed order, each once, with its own approach and
    retreat, and all of them.
    """
    forming, findings = context.get(FORMING), Findings("verify.feature_order", context)
    motion = context.motion
    arm = context.job.tasks[0].arm.name
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, FormsInOrder)]
    node_segments = motion.node_segment
    setups = context.spans.of_stage[motion.node_stage]
    for index in range(len(context.setups)):
        required = [
            folded_segment.folded
            for setup_index, claim in claims
            if setup_index == index
            for folded_segment in claim.segments
        ]
        # segments of this setup in the order in which they are formed, each with its first node; None between
        runs: list[tuple[Segment | None, int]] = []
        for node in np.flatnonzero(setups == index).tolist():
            if node_segments[node].kind == "form" and (not runs or runs[-1][0] != node_segments[node]):
                runs.append((node_segments[node], node))
            elif node_segments[node].kind != "form" and runs and runs[-1][0]:
                runs.append((None, node))
        forming_runs = [(segment, node) for segment, node in runs if segment is not None]
        # an approach or a retreat may be missing, a required segment may not
        expected = [phase for segment in required for phase in segment.all_phases]
        expected = [
            phase
            for phase in expected
            if phase in {formed for formed, _ in forming_runs} or phase in required
        ]
        for k, (segment, node) in enumerate(forming_runs):
            if k >= len(expected) or segment != expected[k]:
                order_hint = "" if k >= len(expected) else f", {expected[k]} has to come first"
                message = f"{segment} comes at position {k + 1} of the forming order{order_hint}"
                findings.add_at_node(message, arm, node)
                break
        else:
            for segment in expected[len(forming_runs) :]:
                if segment in required:
                    findings.add(f"{segment} is never formed", field=str(segment))
    return findings.outcome_without_value("" if claims else NOTHING_FORMED_REASON)


@rule("verify.forming_feed", FormingFeed)
def check_feed(context: Context) -> RuleOutcome:
    """While they form, the TCPs of all tools are no faster than allowed."""
    forming, findings = context.get(FORMING), Findings("verify.forming_feed", context, worst=0.0)
    motion = context.motion
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, FormingFeed)]
    for index, claim in claims:
        chosen = motion.node_label == claim.segment.key
        rows = np.flatnonzero(chosen[motion.node] & (context.sample_setup == index))
        rows = rows[rows > 0]
        rows = rows[motion.stage[rows] == motion.stage[rows - 1]]
        for arm in claim.arms:
            if arm not in motion.tcp or not len(rows):
                continue
            position, speed = motion.tcp[arm].position, np.empty(len(rows))
            for start in range(0, len(rows), SAMPLES_AT_ONCE):
                chunk = rows[start : start + SAMPLES_AT_ONCE]
                distance = np.linalg.norm(position[chunk] - position[chunk - 1], axis=1)
                duration = np.maximum(motion.time[chunk] - motion.time[chunk - 1], 1e-6)
                speed[start : start + SAMPLES_AT_ONCE] = distance / duration
            findings.note_highest(speed.max() / claim.upper, f"{arm} in {claim.segment}")
            for k in first_of_runs(speed > MAX_FEED_FACTOR * claim.upper):
                speed_mm_s, allowed = mm(float(speed[k])), mm(claim.upper)
                message = f"{arm} moves at {speed_mm_s:.2f} mm/s in {claim.segment}, allowed: {allowed:g}"
                findings.add_at_sample(message, arm, rows[k], (speed_mm_s, allowed, "mm/s"))
    claimed_keys = {claim.segment.key for _, claim in claims}
    for formed_pass in forming.formed:
        if formed_pass.claim.segment.key not in claimed_keys:
            findings.add(
                f"{formed_pass.claim.segment} has no claim on its feed", field=str(formed_pass.claim.segment)
            )
    if not claims:
        return findings.outcome_without_value(NOTHING_FORMED_REASON)
    return findings.outcome(float, "of the feed", MAX_FEED_FACTOR)


@rule("verify.lean", LimitsToolTilt)
def check_tilt(context: Context) -> RuleOutcome:
    """While they form, the tilt of the tools from the sheet's normal is within the problem's limit."""
    forming, findings = context.get(FORMING), Findings("verify.lean", context)
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, LimitsToolTilt)]
    for index, claim in claims:
        tool_track = forming.get_track(claim.segment, index, claim.arms)
        rows = np.flatnonzero(tool_track.is_forming)
        for column, (arm, above) in enumerate(zip(claim.arms, claim.above, strict=True)):
            if not len(rows):
                continue
            toward = -1.0 if above else 1.0
            angle = np.empty(len(rows))
            for start in range(0, len(rows), SAMPLES_AT_ONCE):
                chunk = slice(start, start + SAMPLES_AT_ONCE)
                upright = tool_track.axis(column, rows[chunk])[:, 2]
                angle[chunk] = np.arccos(np.clip(toward * upright, -1.0, 1.0))
            findings.note_excess(angle, claim.upper, f"{arm} in {claim.segment}")
            for i in first_of_runs(angle > claim.upper):
                tilt, allowed, _ = measure = measure_in_degrees(angle[i], claim.upper)
                message = f"{arm} is tilted by {tilt:.2f} deg in {claim.segment}, allowed: {allowed:.2f} deg"
                findings.add_at_sample(message, arm, tool_track.rows[rows[i]], measure)
    return findings.outcome(to_degrees, "deg", nothing=NOTHING_FORMED_REASON)


def first_of_runs(is_bad: BoolArray) -> IntArray:
    """Return the first index of each run of bad values (N,), at most `MAX_SHOWN_ISSUES` of them."""
    rows = np.flatnonzero(is_bad)
    first = rows[np.diff(rows, prepend=-2) > 1]  # -2, so that a run from index 0 on has a first index, too
    return first[:MAX_SHOWN_ISSUES]


POINT_SPACING_M = 0.002
"""Spacing [m] of the points at which faces are checked."""
BORDER_TOLERANCE_M = 1e-12
"""A point is beyond the border of a face if its distance from the face differs by more than this [m] from its
height above the flat.
"""
_MAX_FACE_POINTS = 60_000
"""Approximate maximum number of points of a face."""


@rule("verify.sheet", SheetState)
def check_sheet_state(context: Context) -> RuleOutcome:
    """Neither tool has inside it formed sheet, walls that are being formed or the surrounding flat sheet,
    except for what its own ball forms; the other tool stays on its own side of the face. The forming ball
    goes down level by level, and tools approach and retreat straight where the segment starts and ends.
    """
    forming, findings = context.get(FORMING), Findings("verify.sheet", context)
    claimed_keys = {state.segment.key for _, state in forming.sheet_states}
    for formed_pass in forming.formed:
        if formed_pass.claim.segment.key not in claimed_keys:
            message = f"no claim states what the tools meet in {formed_pass.claim.segment}"
            findings.add(message, field=str(formed_pass.claim.segment))
    for index, state in forming.sheet_states:
        formed = forming.pass_of_segment(state.segment)
        tool_track = forming.get_track(state.segment, index, state.arms) if formed is None else formed.track
        if len(tool_track.rows) < 2:
            continue
        held = state.segment.key in forming.gap_segments
        # for each arm: allowed depth, pending depths in its head, depths in its ball, depths in unformed
        # sheet
        queries: list[tuple[str, float, Iterator[TrackDepths], list[TrackDepths], list[TrackDepths]]] = []
        points_by_face: dict[int, FloatArray] = {}
        for number, arm in enumerate(state.arms):
            if arm not in tool_track.arms:
                message = f"{arm} has no program for {state.segment}"
                findings.add(message, field=str(state.segment))
                continue
            allowed = state.tolerance if number == 0 else state.other
            tool = ToolInSheet(dataclasses.replace(state, tolerance=allowed), number, held)
            unformed_depths = [] if formed is None else _unformed_depths(forming, formed, tool)
            release_memory()  # before the query of the tool, to limit peak memory
            queries.append(
                (
                    arm,
                    allowed,
                    *_inside_tool(formed, tool_track, tool, forming.executor, points_by_face),
                    unformed_depths,
                )
            )
        release_memory()  # before the queries of heads, to limit peak memory
        for arm, allowed, head_depths, ball_depths, unformed_depths in queries:
            results = [
                (depths, "has {:.3f} mm of the sheet inside") for depths in (*head_depths, *ball_depths)
            ]
            results += [
                (depths, "is {:.3f} mm deeper than the sheet is formed by then") for depths in unformed_depths
            ]
            for (depth, row), description in results:
                if len(depth):
                    findings.note_excess(depth, allowed, state.segment)
                for i in first_of_runs(depth > allowed):
                    message = f"the tool of {arm} {description.format(mm(depth[i]))} in {state.segment}, "
                    message += f"allowed: {mm(allowed):g} mm"
                    findings.add_at_sample(
                        message, arm, tool_track.rows[row[i]], measure_in_mm(depth[i], allowed)
                    )
    if forming.formed and not findings.measured:
        return findings.outcome_without_value(where="nothing near")
    return findings.excess_outcome(NOTHING_FORMED_REASON)


@dataclasses.dataclass(frozen=True)
class ToolInSheet:
    """One tool of a claim on the sheet's state.

    Attributes:
        state: Claim, with the tolerance of this tool.
        number: Index of the tool among the claim's arms, 0 for the forming one.
        held: Whether two tools hold the sheet between them in the segment.
    """

    state: SheetState
    number: int
    held: bool


def _inside_tool(
    formed: FormedPass | None,
    tool_track: ToolTrack,
    tool: ToolInSheet,
    executor: Executor,
    points_by_face: dict[int, FloatArray],
) -> tuple[Iterator[TrackDepths], list[TrackDepths]]:
    """Determine how deep the sheet is inside a tool along its track.

    Args:
        formed: Pass, or None if tools follow a response table.
        tool_track: Track of the tools.
        tool: Tool.
        executor: Executor to which the calculation for the head is submitted.
        points_by_face: Cache of points all over faces, by the ``id`` of the face.

    Returns:
        Pending depths of fixed and carried sheet in the whole tool, and of the face in its head. Then the
        depths of the face in the ball of the tool that does not form. There are none of the forming ball,
        which verify.gouge checks.
    """
    state, number = tool.state, tool.number
    profile = state.heads[number]
    column = tool_track.arms.index(state.arms[number])
    centre, axis = tool_track.centres(column), tool_track.axes(column)
    is_forming_tool = number == 0
    whole = ToolHead.from_profile(profile, float(profile[0, 0]))
    fixed_path = HeadPath.from_rows(centre, axis, np.zeros(len(centre)), float(profile[-1, 0]))
    queries = [InsideQuery(whole, state.fixed, fixed_path, state.tolerance)]
    if len(state.carried):
        formed_depth = 0.0 if formed is None else formed.formed_depth
        carried_path = HeadPath.from_rows(
            centre, axis, _carried_displacement(tool_track, state, formed_depth), float(profile[-1, 0])
        )
        queries.append(InsideQuery(whole, state.carried, carried_path, state.tolerance))
    if formed is None:
        return executor.submit(run_inside_queries, queries), []
    # exact checks of balls against the face: the forming tool's in verify.gouge, the other one's below
    face = ToolHead.from_profile(profile, 0.0) if is_forming_tool or profile[0, 0] < 0.0 else whole
    release_memory()  # before the nearest points of the balls, to limit peak memory
    level = None if is_forming_tool or not tool.held else formed_levels(formed)
    existing = None if level is None else (state.side, _knot_values_at(formed, level, fixed_path.rows))
    tool_face = formed.face if is_forming_tool else formed.remaining_face
    if id(tool_face) not in points_by_face:
        release_memory()  # before the face is divided, to limit peak memory
        points_by_face[id(tool_face)] = _face_points(tool_face)
    heads = executor.submit(
        run_inside_queries,
        [*queries, InsideQuery(face, points_by_face[id(tool_face)], fixed_path, state.tolerance, existing)],
    )
    if is_forming_tool:
        return heads, []
    release_memory()  # before the checks of the balls, to limit peak memory
    return heads, _wrong_side_depths(formed, centre, max(-float(profile[0, 0]), 0.0), state, level)


def _unformed_depths(forming: FormingFacts, formed: FormedPass, tool: ToolInSheet) -> list[TrackDepths]:
    """Return the depth [m] of a tool in sheet that is not formed yet, on one or more parts of its track.

    The forming tool is checked on all of its path. A second tool that holds the sheet with the forming one
    is checked on its approach and retreat, where its ball must stay beyond the end of the face: no sheet is
    there at any time. Other tools are not checked.
    """
    claim, state = formed.claim, tool.state
    column = formed.track.arms.index(state.arms[tool.number])
    if tool.number == 0:
        step = largest_step(claim, forming.pass_steps(formed))
        approach_depths = approach_retreat_depths(formed.track, column, claim.side, claim.start, claim.radius)
        return [approach_depths, *forming_depths(formed, step)]
    if not tool.held:
        return []
    ball_radius = max(-float(state.heads[tool.number][0, 0]), 0.0)
    face_end = float((claim.side * claim.vertices[:, 2]).min())
    return [approach_retreat_depths(formed.track, column, -claim.side, claim.side * face_end, ball_radius)]


def _knot_values_at(formed: FormedPass, level: FloatArray, rows: IntArray) -> FloatArray:
    """Return the values at rows (M,) of the track of a pass, from values ``level`` (K + 1,) at its knots.

    The value at a row is that of the knot at or after it.
    """
    return level[np.minimum(np.searchsorted(formed.knots, rows), len(level) - 1)]


def _wrong_side_depths(
    formed: FormedPass, centre: VectorRows, ball: float, state: SheetState, level: FloatArray | None
) -> list[tuple[FloatArray, IntArray]]:
    """Return the depth [m] of the other tool's ball in the sheet, or beyond it, with rows of the track.

    Args:
        formed: Pass with its track.
        centre: TCPs (T, 3) [m] of the other tool.
        ball: Radius [m] of its ball.
        state: Claim on the sheet's state, with the tolerance of this tool.
        level: Heights (K + 1,) [m], ``side`` times z, down to which the face is formed at each knot. Before
            the forming ball has formed any of it, the tool is compared with the flat sheet. None to compare
            it with the whole face at all times.

    Returns:
        Depths at the knots with the rows of the knots, and depths on the pieces between them with the last
        rows of the pieces. Only pieces whose ends do not exclude a depth beyond the tolerance are evaluated.
    """
    first, last, deviation = formed.pieces.first, formed.pieces.last, formed.pieces.deviation
    start_knot, end_knot = np.searchsorted(formed.knots, first), np.searchsorted(formed.knots, last)
    step = np.linalg.norm(centre[last] - centre[first], axis=1)
    face = formed.remaining_face  # without corners that the forming ball does not reach
    nearest = face.nearest(centre[formed.knots])
    distance = -state.side * nearest.signed
    undecided = np.flatnonzero(
        0.5 * (distance[start_knot] + distance[end_knot] - step) - deviation < ball - state.tolerance
    )
    one_end, other_end = centre[first[undecided]], centre[last[undecided]]
    need = ball - state.tolerance + deviation[undecided]
    if level is None:
        between = face.line_distance(one_end, other_end, need)
        return [(ball - distance, formed.knots), (ball - between + deviation[undecided], last[undecided])]
    flat = state.side * formed.claim.start
    # beyond the border of the face ``signed`` is the height above the flat
    is_over_face = np.abs(np.abs(nearest.signed) - nearest.distance) > BORDER_TOLERANCE_M
    is_before = ~formed.track.is_forming[formed.knots] & (level >= flat)
    height = state.side * centre[formed.knots][:, 2] - flat
    knot_depth = np.where(is_before, ball + height, np.where(is_over_face, ball - distance, -np.inf))
    between = distance_above_level(face, one_end, other_end, need, state.side, level[end_knot[undecided]])
    return [(knot_depth, formed.knots), (ball - between + deviation[undecided], last[undecided])]


def _carried_displacement(tool_track: ToolTrack, state: SheetState, formed_depth: float) -> FloatArray:
    """Return the displacement (T,) [m] along z of the sheet that sinks with the forming ball, at each row.

    It is that of the farthest level from the start that the tip of the forming ball has reached, and at least
    ``formed_depth`` [m], to which previous levels formed the sheet.
    """
    forming_column = tool_track.arms.index(state.arms[0])
    level = tool_track.centre[:, forming_column][:, 2] + state.side * float(state.heads[0][0, 0])
    if state.side > 0:
        return np.minimum(np.minimum.accumulate(level) - state.start, -formed_depth)
    return np.maximum(np.maximum.accumulate(level) - state.start, formed_depth)


def _face_points(face: ProofFace) -> FloatArray:
    """Return points (P, 3) [m] distributed over a face."""
    corners = face.corners
    area = float(face.area.sum())
    parts, _ = subdivide(corners, max(POINT_SPACING_M, 2.0 * float(np.sqrt(area / _MAX_FACE_POINTS))))
    return np.concatenate([face.vertices[np.unique(face.faces)], parts.mean(axis=1)])


REPLAY_TOLERANCE_M = 2e-5
"""Error [m] of a level due to rounding of the written targets and to the replay."""
PULSE_TOLERANCE_S = 1e-6
"""Times [s] that differ by less are equal."""
MAX_SHOWN_PULSES = 20
"""Maximum number of issues about pulses."""


@rule("verify.holder", SinksHolder)
def check_holder(context: Context) -> RuleOutcome:
    """The signal of a clamp that sinks is pulsed once for each step, within one step of the level that the
    forming tool has reached, and switched at no other time.
    """
    forming, findings = context.get(FORMING), Findings("verify.holder", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, SinksHolder):
            continue
        tool_track = forming.get_track(claim.segment, index, (claim.arm,))
        if not tool_track.is_forming.any():
            findings.add(f"{claim.arm} never forms {claim.segment}")
            continue
        edges = _signal_edges(context, claim)
        findings.issues += _pulse_issues(claim, edges)
        findings.issues += _outside_issues(context, claim, tool_track, edges)
        _check_clamp_level(findings, claim, tool_track, [edge.time for edge in edges if edge.value > 0.0])
    return findings.outcome(mm, "mm", nothing="no clamp sinks")


@dataclasses.dataclass(frozen=True)
class _SignalEdge:
    """The clamp's signal switches to ``value``, 0 for off, at ``time`` [s]."""

    time: float
    value: float


def _signal_edges(context: Context, claim: SinksHolder) -> list[_SignalEdge]:
    """Return the edges of the signal of a clamp in order of time, from off at the start.

    Clamps react to edges alone, so repeated values are left out.
    """
    switched = context.motion.signal_changes(claim.signal, context.controller_task_names((claim.arm,)))
    switchings = [_SignalEdge(time, value) for time, value in switched]
    previous_values = [0.0, *(edge.value for edge in switchings)]
    return [edge for edge, value in zip(switchings, previous_values, strict=False) if edge.value != value]


def _pulse_issues(claim: SinksHolder, edges: list[_SignalEdge]) -> list[Issue]:
    """Check that each whole step has a pulse, that pulses are long enough, and that the signal ends off."""
    issues = []
    previous: _SignalEdge | None = None
    for edge in edges:
        if previous is not None and edge.time - previous.time < claim.pulse - PULSE_TOLERANCE_S:
            state = "on" if previous.value else "off"
            message = (
                f"{claim.signal} is {state} for {edge.time - previous.time:.3f} s at {previous.time:.2f} s, "
                f"required: {claim.pulse:g} s"
            )
            issues.append(Issue("verify.holder", message, time=edge.time))
        previous = edge
    if previous is not None and previous.value:
        issues.append(Issue("verify.holder", f"{claim.signal} is still on when the programs end"))
    count = sum(edge.value > 0.0 for edge in edges)
    required = int(np.floor(abs(claim.start - claim.end) / claim.step + 1e-3))
    if count != required:
        message = (
            f"{claim.signal} is pulsed {count} times, {mm(abs(claim.start - claim.end)):g} mm in steps of "
            f"{mm(claim.step):g} mm require {required}"
        )
        issues.append(Issue("verify.holder", message, value=count, limit=required))
    return issues[:MAX_SHOWN_PULSES]


def _outside_issues(
    context: Context, claim: SinksHolder, tool_track: ToolTrack, edges: list[_SignalEdge]
) -> list[Issue]:
    """Report signal edges outside of the pass, which lasts from the end of the approach to the retreat."""
    forming_rows = np.flatnonzero(tool_track.is_forming)
    span = tool_track.rows[
        [max(int(forming_rows[0]) - 1, 0), min(int(forming_rows[-1]) + 1, len(tool_track.rows) - 1)]
    ]
    first, last = context.motion.time[span]
    return [
        Issue(
            "verify.holder",
            f"{claim.signal} is switched at {edge.time:.2f} s, while {claim.segment} is not formed",
            time=edge.time,
        )
        for edge in edges
        if not first - PULSE_TOLERANCE_S <= edge.time <= last + PULSE_TOLERANCE_S
    ][:MAX_SHOWN_PULSES]


def _check_clamp_level(
    findings: Findings, claim: SinksHolder, tool_track: ToolTrack, pulses: list[float]
) -> None:
    """Check that the clamp is within one step of the lowest level of the tip; ``pulses`` are times [s]."""
    rows = np.flatnonzero(tool_track.is_forming)
    tip = claim.side * (claim.start - tool_track.centre[: rows[-1] + 1, 0][:, 2]) + claim.radius
    tip_depth = np.maximum(np.maximum.accumulate(tip), 0.0)[rows]
    time = findings.context.motion.time[tool_track.rows[rows]]
    pulse_times = np.array(pulses)
    # at the instant of a pulse the clamp moves: both levels count
    level_before = claim.step * np.searchsorted(pulse_times, time - PULSE_TOLERANCE_S, side="left")
    level_after = claim.step * np.searchsorted(pulse_times, time + PULSE_TOLERANCE_S, side="right")
    distance = np.maximum(np.abs(tip_depth - level_before), np.abs(tip_depth - level_after))
    findings.note_excess(distance, claim.step, claim.segment)
    bad_indices = np.flatnonzero(distance > claim.step + REPLAY_TOLERANCE_M)
    for k in bad_indices[np.diff(bad_indices, prepend=-2) > 1][:MAX_SHOWN_PULSES]:
        message = (
            f"the clamp is {mm(distance[k]):.3f} mm off the level that the tool has reached in "
            f"{claim.segment}, allowed is one step, {mm(claim.step):g} mm"
        )
        findings.add_at_sample(
            message, claim.arm, tool_track.rows[rows[k]], measure_in_mm(distance[k], claim.step)
        )
