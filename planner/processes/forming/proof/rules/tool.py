"""Rules on the forming tool, what it meets in the sheet, and the clamp.

verify.gouge, formed, feature_order, forming_feed, lean. verify.sheet: what tools meet besides the
face they form: what is formed already, walls, the flat sheet. verify.holder: a clamp that sinks
with the sheet's rim. It is told by its signal alone: it is as many steps below its start as there
were pulses. The level of the tool is that of the replayed motion.
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
    SheetState,
    SinksHolder,
    ToolsLean,
)
from planner.processes.forming.proof import swept
from planner.processes.forming.proof.face import Face
from planner.processes.forming.proof.reached import Depths, largest_step, on_ways, while_forming
from planner.processes.forming.proof.state import FORMING, Formed, Forming
from planner.processes.forming.proof.steps_down import LOOP_SHARE, emptiest
from planner.processes.forming.proof.swept import ENVELOPES, Head, HeadWay, Inside, insides, least, levels
from planner.processes.forming.proof.tracks import SAMPLES_AT_ONCE, ByRow, Track
from planner.proof.context import Context
from planner.proof.faces import divided
from planner.proof.findings import Findings, degrees, in_degrees, in_mm, in_percent
from planner.proof.rule import FEED_SLACK, Outcome, mm, rule
from planner.proof.verdict import CutFace
from planner.runtime.executor import Executor
from planner.runtime.memory import release_memory

NOTHING_FORMED = "nothing is formed"
"""Why rules about forming have not run."""
ISSUES_SHOWN = 50
"""Issues of one rule and segment at most."""
LIFTED_SHARE = 0.1
"""Share of the way within a forming segment on which the ball may be off the face: steps between loops."""
UNREACHED, UNREACHED_SLACK = 1.03, 2e-5
"""How far off balls stay is known within this share, and [m], of places that are looked at."""


@rule("verify.gouge", FormsSheet)
def gouge(context: Context) -> Outcome:
    """At every instant, also on its ways to and from the sheet, the forming ball is on its side of the face
    it forms and of the flat beyond, and cuts into neither by more than the tolerance."""
    forming, findings = context.get(FORMING), Findings("verify.gouge", context)
    for one in forming.formed:
        claim = one.claim
        if not len(one.pieces.first):
            continue
        need = claim.radius - claim.tolerance
        at_knots = claim.side * one.near.signed
        first, last = (np.searchsorted(one.knots, rows) for rows in (one.pieces.first, one.pieces.last))
        start, end = (one.track.centre[one.knots[rows], 0] for rows in (first, last))
        off = one.pieces.off
        between = one.face.least(start, end, np.minimum(need + off, claim.radius))
        room = np.minimum(np.minimum(at_knots[first], at_knots[last]), between - off)
        deep = claim.radius - room
        findings.beyond(deep, claim.tolerance, claim.segment)
        for i in spread(deep > claim.tolerance):
            what = (
                f"in {claim.segment} the ball cuts {mm(deep[i]):.3f} mm into the face or the flat sheet; "
                f"allowed: {mm(claim.tolerance):g} mm"
            )
            row = one.track.rows[one.pieces.last[i]]
            findings.at_sample(what, claim.arm, row, in_mm(deep[i], claim.tolerance))
    return findings.outcome_beyond(NOTHING_FORMED)


@rule("verify.formed", FormsSheet)
def formed(context: Context) -> Outcome:
    """The forming ball reaches all of a face but a stated share, within the scallop, goes all around it every
    stated step, is off it for no more than a tenth of its way, and nothing is formed that is not claimed."""
    forming, findings = context.get(FORMING), Findings("verify.formed", context)
    _unclaimed(findings, forming)
    faces: list[CutFace] = []
    for one, face in zip(forming.formed, context.get(ENVELOPES), strict=True):
        claim, field = one.claim, str(one.claim.segment)
        faces.append(face)
        limit = forming.unreached(one)
        if limit is not None and face.unreached > UNREACHED * limit + UNREACHED_SLACK:
            what = (
                f"a ball of that size stays {mm(face.unreached):.3f} mm off the part in {claim.segment}; the "
                f"problem allows {mm(limit):g} mm"
            )
            findings.add(what, in_mm(face.unreached, limit), field=field)
        if face.share < claim.share:
            leave = f"{mm(face.allowed.min()):.3g} to {mm(face.tolerance):.3g} mm"
            what = (
                f"the ball passes {100 * face.share:.2f} % of the walls of {claim.segment} within what the "
                f"steps of its path leave there, {leave}; wanted: {100 * claim.share:g} %"
            )
            findings.add(what, in_percent(face.share, claim.share), field=field)
        window = emptiest(one, forming.steps(one)) if one.level is None else None
        if window is not None and window.share < LOOP_SHARE:
            what = (
                f"from {mm(window.begin):.2f} to {mm(window.end):.2f} mm below the flat around "
                f"{claim.segment} the ball goes along {mm(window.way):.1f} mm of its walls, which are "
                f"{mm(window.contour):.1f} mm around there; by the stated steps a whole loop is there"
            )
            findings.add(what, in_percent(window.share, LOOP_SHARE), field=field)
        lifted = _lifted(one)
        if lifted > LIFTED_SHARE:
            what = (
                f"the ball is off the face for {100 * lifted:.1f} % of its way in {claim.segment}; "
                f"allowed: {100 * LIFTED_SHARE:g} %"
            )
            findings.add(what, in_percent(lifted, LIFTED_SHARE), field=field)
    if not faces:
        return Outcome(tuple(findings.issues), nothing=NOTHING_FORMED, part=swept.obj(forming))
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    return Outcome(
        tuple(findings.issues),
        100 * worst.share,
        100 * worst.wanted_share,
        "% within the scallop",
        worst.title,
        faces=tuple(faces),
        part=swept.obj(forming),
    )


def _lifted(one: Formed) -> float:
    """Share of the way within a segment at whose ends the ball is off the face by more than the scallop."""
    use = one.track.own[one.pieces.first]
    first, last = one.pieces.first[use], one.pieces.last[use]
    way = np.linalg.norm(one.track.centre[last, 0] - one.track.centre[first, 0], axis=1)
    up = ~(one.touches[np.searchsorted(one.knots, first)] | one.touches[np.searchsorted(one.knots, last)])
    return float(way[up].sum() / max(float(way.sum()), 1e-12)) if len(way) else 1.0


def _unclaimed(findings: Findings, forming: Forming) -> None:
    """Moves of segments that form, of which nothing is claimed."""
    motion, arm = findings.context.motion, findings.context.job.tasks[0].arm.name
    seen: set[str] = set()
    for node, (segment, name) in enumerate(zip(motion.node_segment, motion.node_label, strict=True)):
        if segment.kind == "form" and name not in forming.labels and name not in seen:
            seen.add(name)
            what = f"the programs form in {segment}, of which the problem claims nothing"
            findings.at_node(what, arm, node)


@rule("verify.feature_order", FormsInOrder)
def feature_order(context: Context) -> Outcome:
    """The segments that form the sheet come in the order that is claimed, each once, with its own ways in
    and out, and all of them."""
    forming, findings = context.get(FORMING), Findings("verify.feature_order", context)
    motion = context.motion
    arm = context.job.tasks[0].arm.name
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, FormsInOrder)]
    said = motion.node_segment
    setups = context.spans.of_stage[motion.node_stage]
    for index in range(len(context.setups)):
        wanted = [one.folded for where, claim in claims if where == index for one in claim.segments]
        found: list[tuple[Segment | None, int]] = []
        for node in np.flatnonzero(setups == index).tolist():
            if said[node].kind == "form" and (not found or found[-1][0] != said[node]):
                found.append((said[node], node))
            elif said[node].kind != "form" and found and found[-1][0]:
                found.append((None, node))
        there = [(name, node) for name, node in found if name is not None]
        full = [way for name in wanted for way in name.ways]
        full = [name for name in full if name in {name for name, _ in there} or name in wanted]
        for k, (name, node) in enumerate(there):
            if k >= len(full) or name != full[k]:
                known = "" if k >= len(full) else f"; {full[k]} comes first"
                what = f"{name} comes in the place {k + 1} of what is formed{known}"
                findings.at_node(what, arm, node)
                break
        else:
            for name in full[len(there) :]:
                if name in wanted:
                    findings.add(f"{name} is never formed", field=str(name))
    return findings.outcome_without_value("" if claims else NOTHING_FORMED)


@rule("verify.forming_feed", FormingFeed)
def feed(context: Context) -> Outcome:
    """While they form, the TCPs of all tools move no faster than they may."""
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
            place, speed = motion.tcp[arm].place, np.empty(len(rows))
            for begin in range(0, len(rows), SAMPLES_AT_ONCE):
                some = rows[begin : begin + SAMPLES_AT_ONCE]
                way = np.linalg.norm(place[some] - place[some - 1], axis=1)
                spent = np.maximum(motion.time[some] - motion.time[some - 1], 1e-6)
                speed[begin : begin + SAMPLES_AT_ONCE] = way / spent
            findings.highest(speed.max() / claim.upper, f"{arm} in {claim.segment}")
            for k in spread(speed > FEED_SLACK * claim.upper):
                got, most = mm(float(speed[k])), mm(claim.upper)
                what = f"{arm} moves at {got:.2f} mm/s in {claim.segment}; allowed: {most:g}"
                findings.at_sample(what, arm, rows[k], (got, most, "mm/s"))
    fed = {claim.segment.key for _, claim in claims}
    for one in forming.formed:
        if one.claim.segment.key not in fed:
            findings.add(f"{one.claim.segment} has no feed", field=str(one.claim.segment))
    if not claims:
        return findings.outcome_without_value(NOTHING_FORMED)
    return findings.outcome(float, "of the feed", FEED_SLACK)


@rule("verify.lean", ToolsLean)
def lean(context: Context) -> Outcome:
    """While they form, tools lean from the sheet's normal no farther than the problem lets them."""
    forming, findings = context.get(FORMING), Findings("verify.lean", context)
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, ToolsLean)]
    for index, claim in claims:
        way = forming.track(claim.segment, index, claim.arms)
        rows = np.flatnonzero(way.own)
        for column, (arm, above) in enumerate(zip(claim.arms, claim.above, strict=True)):
            if not len(rows):
                continue
            toward = -1.0 if above else 1.0
            angle = np.empty(len(rows))
            for begin in range(0, len(rows), SAMPLES_AT_ONCE):
                some = slice(begin, begin + SAMPLES_AT_ONCE)
                upright = way.axis(column, rows[some])[:, 2]
                angle[some] = np.arccos(np.clip(toward * upright, -1.0, 1.0))
            findings.beyond(angle, claim.upper, f"{arm} in {claim.segment}")
            for i in spread(angle > claim.upper):
                got, most, _ = measure = in_degrees(angle[i], claim.upper)
                what = f"{arm} leans {got:.2f} deg in {claim.segment}; allowed: {most:.2f} deg"
                findings.at_sample(what, arm, way.rows[rows[i]], measure)
    return findings.outcome(degrees, "deg", nothing=NOTHING_FORMED)


def spread(bad: BoolArray) -> IntArray:
    """The first of each run of rows that are bad, and no more than are worth telling."""
    rows = np.flatnonzero(bad)
    first = rows[np.diff(rows, prepend=-2) > 1]
    return first[:ISSUES_SHOWN]


PLACE_SPACING = 0.002
"""Faces are asked at places so near to each other [m]."""
BESIDE_BORDER = 1e-12
"""Distance from a face and height over it differ by more than this [m] only beside its border."""
_FACE_PLACES = 60_000
"""Places of a face, about, at most."""


@rule("verify.sheet", SheetState)
def sheet(context: Context) -> Outcome:
    """Neither tool has anything inside it of what is formed already, of the walls being formed or of the flat
    sheet around, but for what its own ball forms; the other tool stays on its own side of the face. The
    forming ball goes down level by level, and tools go in and out straight where they begin and end."""
    forming, findings = context.get(FORMING), Findings("verify.sheet", context)
    known = {state.segment.key for _, state in forming.states}
    for one in forming.formed:
        if one.claim.segment.key not in known:
            what = f"nothing says what the tools meet in {one.claim.segment}"
            findings.add(what, field=str(one.claim.segment))
    for index, state in forming.states:
        formed = forming.of(state.segment)
        way = forming.track(state.segment, index, state.arms) if formed is None else formed.track
        if len(way.rows) < 2:
            continue
        held = state.segment.key in forming.gapped
        asked: list[tuple[str, float, Iterator[Depths], list[Depths], list[Depths]]] = []
        places: dict[int, FloatArray] = {}
        for number, arm in enumerate(state.arms):
            if arm not in way.arms:
                what = f"{arm} has no program for {state.segment}"
                findings.add(what, field=str(state.segment))
                continue
            allowed = state.tolerance if number == 0 else state.other
            own = dataclasses.replace(state, tolerance=allowed)
            begun = 0.0 if formed is None else formed.begun
            ahead = [] if formed is None else _ahead(forming, formed, own, number, held)
            release_memory()  # what that leaves free would count beside what is inside the tool
            asked.append(
                (arm, allowed, *_all(formed, way, own, number, held, forming.executor, places, begun), ahead)
            )
        release_memory()  # what the balls leave free would count beside what heads are held against
        for arm, allowed, heads, rest, ahead in asked:
            told = [(one, "has {:.3f} mm of the sheet inside") for one in (*heads, *rest)]
            told += [(one, "is {:.3f} mm deeper than the sheet is formed by then") for one in ahead]
            for (deep, row), how in told:
                if len(deep):
                    findings.beyond(deep, allowed, state.segment)
                for i in spread(deep > allowed):
                    what = f"the tool of {arm} {how.format(mm(deep[i]))} in {state.segment}; "
                    what += f"allowed: {mm(allowed):g} mm"
                    findings.at_sample(what, arm, way.rows[row[i]], in_mm(deep[i], allowed))
    if forming.formed and not findings.measured:
        return findings.outcome_without_value(where="nothing near")
    return findings.outcome_beyond(NOTHING_FORMED)


def _all(
    one: Formed | None,
    way: Track,
    state: SheetState,
    number: int,
    held: bool,
    executor: Executor,
    places: dict[int, FloatArray],
    begun: float,
) -> tuple[Iterator[Depths], list[Depths]]:
    """What is inside a tool: its head, which is begun, and its ball; ``held``: two tools hold the sheet
    between them; ``places`` all over faces, by their ``id``, are worked out for the first tool that asks;
    ``begun`` [m]: how deep the face is formed already."""
    profile = state.heads[number]
    column = way.arms.index(state.arms[number])
    centre, axis = way.centres(column), way.axes(column)
    former = number == 0
    whole = Head.of(profile, float(profile[0, 0]))
    still = HeadWay.of(centre, axis, np.zeros(len(centre)), float(profile[-1, 0]))
    asked = [Inside(whole, state.fixed, still, state.tolerance)]
    if len(state.carried):
        sinking = HeadWay.of(centre, axis, _sunk(way, state, begun), float(profile[-1, 0]))
        asked.append(Inside(whole, state.carried, sinking, state.tolerance))
    if one is None:
        return executor.submit(insides, asked), []
    # balls are held against the face exactly: that of the forming tool elsewhere, the other one below
    face = Head.of(profile, 0.0) if former or profile[0, 0] < 0.0 else whole
    release_memory()  # what ways of heads leave free would count beside what the balls are nearest to
    level = None if former or not held else levels(one)
    there = None if level is None else (state.side, _at_rows(one, level, still.rows))
    here = one.face if former else one.remaining_face
    if id(here) not in places:
        release_memory()  # what ways of heads leave free would count beside the divided face
        places[id(here)] = _places(here)
    heads = executor.submit(insides, [*asked, Inside(face, places[id(here)], still, state.tolerance, there)])
    if former:
        return heads, []
    release_memory()  # what divided faces leave free would count beside what the balls are held against
    return heads, _own_side(one, centre, max(-float(profile[0, 0]), 0.0), state, level)


def _ahead(forming: Forming, one: Formed, state: SheetState, number: int, held: bool) -> list[Depths]:
    """How deep [m] a tool is in what is not formed yet: the forming one on all of its way, another one that
    holds the sheet with it (``held``) on its ways in and out. Of such a one the face's far end is the level
    that counts: farther on there is no sheet, whatever is formed."""
    claim, column = one.claim, one.track.arms.index(state.arms[number])
    if number == 0:
        step = largest_step(claim, forming.steps(one))
        ways = on_ways(one.track, column, claim.side, claim.start, claim.radius)
        return [ways, *while_forming(one, step)]
    if not held:
        return []
    ball, far = max(-float(state.heads[number][0, 0]), 0.0), float((claim.side * claim.vertices[:, 2]).min())
    return [on_ways(one.track, column, -claim.side, claim.side * far, ball)]


def _at_rows(one: Formed, level: FloatArray, some: IntArray) -> FloatArray:
    """What is known at the knots of a pass, at rows ``some`` (K,) of its track: that of the knot at it or
    behind it."""
    return level[np.minimum(np.searchsorted(one.knots, some), len(level) - 1)]


def _own_side(
    one: Formed, centre: ByRow, ball: float, state: SheetState, level: FloatArray | None
) -> list[tuple[FloatArray, IntArray]]:
    """How deep [m] the other tool's ball is in the face, and in the flat sheet around it, or on their wrong
    side, with rows of the track. Where ``level`` (K + 1,) [m] at the knots says what of the face is there,
    that alone counts, and all the sheet is flat before any is."""
    first, last, off = one.pieces.first, one.pieces.last, one.pieces.off
    begin, end = np.searchsorted(one.knots, first), np.searchsorted(one.knots, last)
    step = np.linalg.norm(centre[last] - centre[first], axis=1)
    face = one.remaining_face  # corners that the forming ball does not reach are not there
    near = face.nearest(centre[one.knots])
    room = -state.side * near.signed
    doubt = np.flatnonzero(0.5 * (room[begin] + room[end] - step) - off < ball - state.tolerance)
    one_end, other_end = centre[first[doubt]], centre[last[doubt]]
    need = ball - state.tolerance + off[doubt]
    if level is None:
        between = face.least(one_end, other_end, need)
        return [(ball - room, one.knots), (ball - between + off[doubt], last[doubt])]
    flat = state.side * one.claim.start
    # beyond the border of the face its height over the flat is what is signed
    around = np.abs(np.abs(near.signed) - near.apart) > BESIDE_BORDER
    before = ~one.track.own[one.knots] & (level >= flat)
    height = state.side * centre[one.knots][:, 2] - flat
    deep = np.where(before, ball + height, np.where(around, ball - room, -np.inf))
    between = least(face, one_end, other_end, need, state.side, level[end[doubt]])
    return [(deep, one.knots), (ball - between + off[doubt], last[doubt])]


def _sunk(way: Track, state: SheetState, begun: float) -> FloatArray:
    """How far (T,) [m] what is carried has moved along z: by the farthest level that the forming ball's
    surface has reached, from the start; by ``begun`` [m] before."""
    former = way.arms.index(state.arms[0])
    level = way.centre[:, former][:, 2] + state.side * float(state.heads[0][0, 0])
    if state.side > 0:
        return np.minimum(np.minimum.accumulate(level) - state.start, -begun)
    return np.maximum(np.maximum.accumulate(level) - state.start, begun)


def _places(face: Face) -> FloatArray:
    """Return points (P, 3) [m] distributed over a face."""
    corners = face.corners
    area = float(face.area.sum())
    parts, _ = divided(corners, max(PLACE_SPACING, 2.0 * float(np.sqrt(area / _FACE_PLACES))))
    return np.concatenate([face.vertices[np.unique(face.faces)], parts.mean(axis=1)])


REPLAY_ERROR = 2e-5
"""What the written targets and the replay may add [m]."""
PULSE_ROUNDING = 1e-6
"""Times [s] that differ by less are one."""
SHOWN_PULSES = 20
"""Issues about pulses at most."""


@rule("verify.holder", SinksHolder)
def holder(context: Context) -> Outcome:
    """The signal of a clamp that sinks is pulsed once for each step, within one step of the level that the
    forming tool has reached, and switched at no other time."""
    forming, findings = context.get(FORMING), Findings("verify.holder", context)
    for index, claim in forming.by_setup:
        if not isinstance(claim, SinksHolder):
            continue
        way = forming.track(claim.segment, index, (claim.arm,))
        if not way.own.any():
            findings.add(f"{claim.arm} never forms {claim.segment}")
            continue
        edges = _edges(context, claim)
        findings.issues += _pulses(claim, edges)
        findings.issues += _outside(context, claim, way, edges)
        _off(findings, claim, way, [edge.time for edge in edges if edge.value > 0.0])
    return findings.outcome(mm, "mm", nothing="no clamp sinks")


@dataclasses.dataclass(frozen=True)
class _Edge:
    """The signal goes to ``value`` at ``time`` [s]."""

    time: float
    value: float


def _edges(context: Context, claim: SinksHolder) -> list[_Edge]:
    """When the signal of a clamp, off at first, goes on and off, in order; holders see its edges alone."""
    switched = context.motion.switched(claim.signal, context.switching((claim.arm,)))
    found = [_Edge(time, value) for time, value in switched]
    before = [0.0, *(edge.value for edge in found)]
    return [edge for edge, value in zip(found, before, strict=False) if edge.value != value]


def _pulses(claim: SinksHolder, edges: list[_Edge]) -> list[Issue]:
    """On and off for long enough, as many times as there are whole steps, off at last."""
    issues = []
    before: _Edge | None = None
    for edge in edges:
        if before is not None and edge.time - before.time < claim.pulse - PULSE_ROUNDING:
            state = "on" if before.value else "off"
            what = (
                f"{claim.signal} is {state} for {edge.time - before.time:.3f} s at {before.time:.2f} s; "
                f"wanted: {claim.pulse:g} s"
            )
            issues.append(Issue("verify.holder", what, time=edge.time))
        before = edge
    if before is not None and before.value:
        issues.append(Issue("verify.holder", f"{claim.signal} is still on when the programs end"))
    count = sum(edge.value > 0.0 for edge in edges)
    wanted = int(np.floor(abs(claim.start - claim.end) / claim.step + 1e-3))
    if count != wanted:
        what = (
            f"{claim.signal} is pulsed {count} times; {mm(abs(claim.start - claim.end)):g} mm in steps of "
            f"{mm(claim.step):g} mm are {wanted}"
        )
        issues.append(Issue("verify.holder", what, value=count, limit=wanted))
    return issues[:SHOWN_PULSES]


def _outside(context: Context, claim: SinksHolder, way: Track, edges: list[_Edge]) -> list[Issue]:
    """What is switched outside of the pass, which lasts from the end of the way in to the way out."""
    own = np.flatnonzero(way.own)
    span = way.rows[[max(int(own[0]) - 1, 0), min(int(own[-1]) + 1, len(way.rows) - 1)]]
    first, last = context.motion.time[span]
    return [
        Issue(
            "verify.holder",
            f"{claim.signal} is switched at {edge.time:.2f} s, while {claim.segment} is not formed",
            time=edge.time,
        )
        for edge in edges
        if not first - PULSE_ROUNDING <= edge.time <= last + PULSE_ROUNDING
    ][:SHOWN_PULSES]


def _off(findings: Findings, claim: SinksHolder, way: Track, pulses: list[float]) -> None:
    """How far [m] the clamp is off the tip's lowest level at most, and where by more than a step."""
    rows = np.flatnonzero(way.own)
    tip = claim.side * (claim.start - way.centre[: rows[-1] + 1, 0][:, 2]) + claim.radius
    sunk = np.maximum(np.maximum.accumulate(tip), 0.0)[rows]
    now = findings.context.motion.time[way.rows[rows]]
    at = np.array(pulses)
    # at the very instant of a pulse the clamp is on its way: both levels count
    before = claim.step * np.searchsorted(at, now - PULSE_ROUNDING, side="left")
    after = claim.step * np.searchsorted(at, now + PULSE_ROUNDING, side="right")
    off = np.maximum(np.abs(sunk - before), np.abs(sunk - after))
    findings.beyond(off, claim.step, claim.segment)
    bad = np.flatnonzero(off > claim.step + REPLAY_ERROR)
    for k in bad[np.diff(bad, prepend=-2) > 1][:SHOWN_PULSES]:
        what = (
            f"the clamp is {mm(off[k]):.3f} mm off the level that the tool has reached in {claim.segment}; "
            f"allowed is one step, {mm(claim.step):g} mm"
        )
        findings.at_sample(what, claim.arm, way.rows[rows[k]], in_mm(off[k], claim.step))
