"""Rules on the forming tool: gouges, what is formed, the order of the features, the feed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims_forming import FormingFeed, FormsInOrder, ToolsLean
from planner.issues import Issue
from planner.segments import Segment
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_node, at_sample
from planner.verify.formed_part import envelope
from planner.verify.forming_state import Formed, Forming
from planner.verify.result import CutFace

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NONE = "nothing is formed"
SHOWN = 50
"""Issues of one rule and segment at most."""
LIFTED = 0.1
"""Share of the way within a forming segment on which the ball may be off the face: steps between loops."""
UNREACHED, BESIDE = 1.03, 2e-5
"""How far off balls stay is known within this share, and [m], of places that are looked at."""
FEED_SLACK = 1.05
"""The replay's ramps and corners may pass the feed by this factor."""


def gouge(context: Context, forming: Forming) -> Outcome:
    """At every instant, also on its ways to and from the sheet, the forming ball is on its side of the face
    it forms and of the flat beyond, and cuts into neither by more than the tolerance."""
    issues: list[Issue] = []
    worst, limit, where = -np.inf, None, ""
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
        k = int(np.argmax(deep))
        if deep[k] - claim.tolerance > worst:
            worst, limit, where = float(deep[k]) - claim.tolerance, mm(claim.tolerance), str(claim.segment)
        for i in spread(deep > claim.tolerance):
            what = (
                f"in {claim.segment} the ball cuts {mm(deep[i]):.3f} mm into the face or the flat sheet; "
                f"allowed: {mm(claim.tolerance):g} mm"
            )
            measure = (mm(float(deep[i])), mm(claim.tolerance), "mm")
            row = int(one.track.rows[one.pieces.last[i]])
            issues.append(at_sample("verify.gouge", what, context.motion, claim.arm, row, measure))
    if limit is None:
        return Outcome(tuple(issues), where=NONE)
    return Outcome(tuple(issues), mm(worst) + limit, limit, "mm", where)


def formed(context: Context, forming: Forming) -> tuple[Outcome, tuple[CutFace, ...]]:
    """The forming ball reaches all of a face but a stated share, within the scallop, is off it for no more
    than a tenth of its way, and nothing is formed that is not claimed."""
    issues = _unclaimed(context, forming)
    faces: list[CutFace] = []
    for one in forming.formed:
        claim = one.claim
        face = envelope(one)
        faces.append(face)
        limit = forming.unreached(one)
        if limit is not None and face.unreached > UNREACHED * limit + BESIDE:
            what = (
                f"a ball of that size stays {mm(face.unreached):.3f} mm off the part in {claim.segment}; the "
                f"problem allows {mm(limit):g} mm"
            )
            off, most = mm(face.unreached), mm(limit)
            field = str(claim.segment)
            issues.append(Issue("verify.formed", what, field=field, value=off, limit=most, unit="mm"))
        if face.share < claim.share:
            leave = f"{mm(face.allowed.min()):.3g} to {mm(face.tolerance):.3g} mm"
            what = (
                f"the ball passes {100 * face.share:.2f} % of the walls of {claim.segment} within what the "
                f"steps of its path leave there, {leave}; wanted: {100 * claim.share:g} %"
            )
            issues.append(_of_face("verify.formed", what, claim.segment, face.share, claim.share))
        lifted = _lifted(one)
        if lifted > LIFTED:
            what = (
                f"the ball is off the face for {100 * lifted:.1f} % of its way in {claim.segment}; "
                f"allowed: {100 * LIFTED:g} %"
            )
            issues.append(_of_face("verify.formed", what, claim.segment, lifted, LIFTED))
    if not faces:
        return Outcome(tuple(issues), where=NONE), ()
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    share, wanted = 100 * worst.share, 100 * worst.wanted_share
    return Outcome(tuple(issues), share, wanted, "% within the scallop", worst.title), tuple(faces)


def _lifted(one: Formed) -> float:
    """Share of the way within a segment at whose ends the ball is off the face by more than the scallop."""
    use = one.track.own[one.pieces.first]
    first, last = one.pieces.first[use], one.pieces.last[use]
    way = np.linalg.norm(one.track.centre[last, 0] - one.track.centre[first, 0], axis=1)
    up = ~(one.touches[np.searchsorted(one.knots, first)] | one.touches[np.searchsorted(one.knots, last)])
    return float(way[up].sum() / max(float(way.sum()), 1e-12)) if len(way) else 1.0


def _unclaimed(context: Context, forming: Forming) -> list[Issue]:
    """Moves of segments that form, of which nothing is claimed."""
    motion = context.motion
    arm = context.job.tasks[0].arm.name
    issues = []
    seen: set[str] = set()
    for node, (segment, name) in enumerate(zip(motion.node_segment, motion.node_label, strict=True)):
        if segment.kind == "form" and name not in forming.labels and name not in seen:
            seen.add(name)
            what = f"the programs form in {segment}, of which the problem claims nothing"
            issues.append(at_node("verify.formed", what, motion, arm, node))
    return issues


def feature_order(context: Context, forming: Forming) -> Outcome:
    """The segments that form the sheet come in the order that is claimed, each once, with its own ways in
    and out, and all of them."""
    motion = context.motion
    arm = context.job.tasks[0].arm.name
    issues: list[Issue] = []
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
                issues.append(at_node("verify.feature_order", what, motion, arm, node))
                break
        else:
            issues += [
                Issue("verify.feature_order", f"{name} is never formed", field=str(name))
                for name in full[len(there) :]
                if name in wanted
            ]
    return Outcome(tuple(issues), where="" if claims else NONE)


def feed(context: Context, forming: Forming) -> Outcome:
    """While they form, the TCPs of all tools move no faster than they may."""
    motion = context.motion
    issues: list[Issue] = []
    worst, where = 0.0, ""
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, FormingFeed)]
    for index, claim in claims:
        chosen = motion.node_label == claim.segment.key
        rows = np.flatnonzero(chosen[motion.node] & (context.sample_setup == index))
        rows = rows[rows > 0]
        rows = rows[motion.stage[rows] == motion.stage[rows - 1]]
        for arm in claim.arms:
            if arm not in motion.tcp or not len(rows):
                continue
            way = np.linalg.norm(motion.tcp[arm].place[rows] - motion.tcp[arm].place[rows - 1], axis=1)
            speed = way / np.maximum(motion.time[rows] - motion.time[rows - 1], 1e-6)
            if speed.max() / claim.upper > worst:
                worst, where = float(speed.max() / claim.upper), f"{arm} in {claim.segment}"
            for k in spread(speed > FEED_SLACK * claim.upper):
                what = (
                    f"{arm} moves at {mm(speed[k]):.2f} mm/s in {claim.segment}; allowed: {mm(claim.upper):g}"
                )
                measure = (mm(float(speed[k])), mm(claim.upper), "mm/s")
                issues.append(at_sample("verify.forming_feed", what, motion, arm, int(rows[k]), measure))
    fed = {claim.segment.key for _, claim in claims}
    issues += [
        Issue("verify.forming_feed", f"{one.claim.segment} has no feed", field=str(one.claim.segment))
        for one in forming.formed
        if one.claim.segment.key not in fed
    ]
    if not claims:
        return Outcome(tuple(issues), where=NONE)
    return Outcome(tuple(issues), worst, FEED_SLACK, "of the feed", where)


def lean(context: Context, forming: Forming) -> Outcome:
    """While they form, tools lean from the sheet's normal no farther than the problem lets them."""
    issues: list[Issue] = []
    worst, limit, where = -np.inf, 0.0, ""
    claims = [(index, claim) for index, claim in forming.by_setup if isinstance(claim, ToolsLean)]
    for index, claim in claims:
        way = forming.track(claim.segment, index, claim.arms)
        rows = np.flatnonzero(way.own)
        for column, (arm, above) in enumerate(zip(claim.arms, claim.above, strict=True)):
            if not len(rows):
                continue
            toward = -1.0 if above else 1.0
            angle = np.arccos(np.clip(toward * way.axis(column)[rows, 2], -1.0, 1.0))
            k = int(np.argmax(angle))
            if angle[k] - claim.upper > worst:
                worst, limit = float(angle[k] - claim.upper), claim.upper
                where = f"{arm} in {claim.segment}"
            for i in spread(angle > claim.upper):
                got, most = float(np.rad2deg(angle[i])), float(np.rad2deg(claim.upper))
                what = f"{arm} leans {got:.2f} deg in {claim.segment}; allowed: {most:.2f} deg"
                row = int(way.rows[rows[i]])
                issues.append(at_sample("verify.lean", what, context.motion, arm, row, (got, most, "deg")))
    if not np.isfinite(worst):
        return Outcome(tuple(issues), where=NONE)
    return Outcome(tuple(issues), float(np.rad2deg(worst + limit)), float(np.rad2deg(limit)), "deg", where)


def spread(bad: BoolArray) -> IntArray:
    """The first of each run of rows that are bad, and no more than are worth telling."""
    rows = np.flatnonzero(bad)
    first = rows[np.diff(rows, prepend=-2) > 1]
    return first[:SHOWN]


def _of_face(code: str, what: str, segment: Segment, value: float, limit: float) -> Issue:
    return Issue(code, what, field=str(segment), value=100 * value, limit=100 * limit, unit="%")
