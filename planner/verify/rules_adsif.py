"""The rule on accumulative forming: both tools against the wanted face and the response table."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner.claims_forming import FormsByTable
from planner.issues import Issue
from planner.verify.adsif_way import Way
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.forming_state import Forming
from planner.verify.response import Wanted, wanted
from planner.verify.rules_forming import spread

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ASIDE = np.deg2rad(1.0)
"""How far [rad] the line of the tools, seen along z, may turn from the wall's slope: faces are facets."""
MISSED = 0.75
"""Places of the wall are no farther from the way than this share of what loops are apart there: half would do
where all loops are even, and one that is missing leaves as much as they are apart."""
CHORD = 1e-5
"""How far [m] straight moves may go past places besides."""
BACK = 1.5
"""The way goes back toward the inside by so many of what loops are apart at most."""
STAYS = 1e-4
"""On its ways in and out a tool in the sheet stays within this [m] of where its segment begins and ends."""
ALIKE = 0.02
"""Share by which lengths may differ from those that a table holds for."""
ROUND = 0.9
"""Share of all turning that has to go the wanted way round."""


def by_table(context: Context, forming: Forming) -> Outcome:
    """In accumulative forming both tools are, at and between targets, where the response table wants them for
    the wall of the wanted face at each place, at the sheet's level, and pass all of it from the inside out;
    on their ways in and out they press into it nowhere else."""
    issues: list[Issue] = []
    worst, limit, where = -np.inf, None, ""
    for index, claim in forming.by_setup:
        if not isinstance(claim, FormsByTable):
            continue
        way = Way(context, claim, index)
        if len(way.rows) < 2:
            what = f"{' and '.join(claim.arms)} never form {claim.segment} together"
            issues.append(Issue("verify.adsif", what, field=str(claim.segment)))
            continue
        table = wanted(claim.table, claim.prefer)
        issues += _conditions(claim, table)
        off, aside, place = way.fitting(table)
        level = way.start - claim.projection + claim.radii[0]
        high = np.abs(way.centre[:, 0, 2] - level)
        across = np.hypot(*(way.centre[:, 1] - way.centre[:, 0])[:, :2].T)
        error = np.maximum(np.maximum(off, high), aside - np.sin(ASIDE) * across)
        error = error + SPARED * claim.tolerance
        k = int(np.argmax(error))
        if error[k] - claim.tolerance > worst:
            worst, limit, where = float(error[k]) - claim.tolerance, mm(claim.tolerance), str(claim.segment)
        for i in spread(error > claim.tolerance):
            issues.append(_off(context, way, i, float(error[i]), bool(high[i] > claim.tolerance)))
        issues += _passed(way, place)
        issues += _upright(context, way)
        issues += _ways(context, way)
    if limit is None:
        return Outcome(tuple(issues), where="no table is followed")
    return Outcome(tuple(issues), mm(worst) + limit, limit, "mm", where)


SPARED = 0.1
"""What the way between looks may be off, as a share of the tolerance."""


def _off(context: Context, way: Way, look: int, error: float, level: bool) -> Issue:
    claim = way.claim
    if not np.isfinite(error):
        what = f"{claim.arms[0]} touches no wall of the wanted face, or one that is not in the table"
    elif level:
        what = f"{claim.arms[0]} is {mm(error):.3f} mm off the level at which it forms"
    else:
        what = f"{claim.arms[1]} is {mm(error):.3f} mm off where the table wants it for the wall there"
    what += f" in {claim.segment}; allowed: {mm(claim.tolerance):g} mm"
    measure = (mm(min(error, 1.0)), mm(claim.tolerance), "mm")
    row = int(way.track.rows[way.rows[look]])
    return at_sample("verify.adsif", what, context.motion, claim.arms[0], row, measure)


def _conditions(claim: FormsByTable, table: Wanted) -> Iterator[Issue]:
    """What the table holds for, against what the sheet and the tools are."""
    wanted_of = {
        "thickness_mm": claim.thickness,
        "tool_radius_mm": claim.radii[0],
        "pitch_mm": claim.pitch,
        "projection_mm": claim.projection,
    }
    if table.conditions.get("metal") != claim.metal or claim.radii[0] != claim.radii[1]:
        what = f"the response table holds for {table.conditions.get('metal')} and tools of one radius"
        yield Issue("verify.adsif", what, field=str(claim.segment))
    for name, value in wanted_of.items():
        held = table.conditions.get(name, "nan")
        if not abs(mm(value) - float(held)) <= ALIKE * float(held):
            what = f"the response table holds for {name} {held}, not for {mm(value):g}"
            yield Issue("verify.adsif", what, field=str(claim.segment), value=mm(value), limit=float(held))


def _passed(way: Way, place: FloatArray) -> Iterator[Issue]:
    """Whether all of the wall is passed, from the inside out, the wanted way round."""
    claim = way.claim
    place = place[np.isfinite(place[:, 0])]
    if len(place) < 2:
        return
    points, far, apart = way.passed(place)
    step = way.rise(place[:, 2])
    last = way.start - points[:, 2] < way.rise(
        points[:, 2]
    )  # loops come from the inside, whole pitches apart
    # beyond the last loop, straight moves of a round part are off to the inside, and none makes up for it
    allowed = np.where(last, 1.0 + claim.sag / claim.pitch, MISSED) * apart + CHORD
    k = int(np.argmax(far - allowed))
    if far[k] > allowed[k]:
        at = ", ".join(f"{mm(x):.1f}" for x in points[k] * [1.0, 1.0, float(claim.side)])
        what = f"{claim.segment} passes the wall at ({at}) mm by {mm(far[k]):.3f} mm"
        what += f"; loops are {mm(apart[k]):.3f} mm apart there"
        value, limit = mm(float(far[k])), mm(float(allowed[k]))
        yield Issue("verify.adsif", what, field=str(claim.segment), value=value, limit=limit, unit="mm")
    back = np.maximum.accumulate(place[:, 2]) - place[:, 2]
    if (back > BACK * step).any():
        k = int(np.argmax(back - BACK * step))
        what = f"{claim.segment} goes back to the inside by {mm(back[k]):.3f} mm of height"
        yield Issue(
            "verify.adsif", what, field=str(claim.segment), value=mm(back[k]), limit=mm(BACK * step[k])
        )
    middle = points.mean(axis=0)
    arm, move = (place - middle)[:-1, :2], np.diff(place[:, :2], axis=0)
    area = claim.turning * (arm[:, 0] * move[:, 1] - arm[:, 1] * move[:, 0])
    share = float(np.maximum(area, 0.0).sum() / max(float(np.abs(area).sum()), 1e-30))
    if share < ROUND:
        what = f"{claim.segment} goes round the wrong way for {100 * (1 - share):.0f} % of its way"
        yield Issue(
            "verify.adsif", what, field=str(claim.segment), value=100 * share, limit=100 * ROUND, unit="%"
        )


def _upright(context: Context, way: Way) -> Iterator[Issue]:
    """Whether both tools are square to the sheet."""
    claim = way.claim
    for column, toward in ((0, -1.0), (1, 1.0)):
        lean = np.arccos(np.clip(toward * way.axis(column)[way.rows, 2], -1.0, 1.0))
        for i in spread(lean > claim.lean):
            arm = claim.arms[column]
            what = f"{arm} leans {np.rad2deg(lean[i]):.2f} deg in {claim.segment}"
            what += f"; allowed: {np.rad2deg(claim.lean):.2f} deg"
            measure = (float(np.rad2deg(lean[i])), float(np.rad2deg(claim.lean)), "deg")
            row = int(way.track.rows[way.rows[i]])
            yield at_sample("verify.adsif", what, context.motion, arm, row, measure)


def _ways(context: Context, way: Way) -> Iterator[Issue]:
    """Whether tools are in the sheet, on their ways in and out, only where their segment begins and ends, and
    no deeper than there."""
    claim, track = way.claim, way.track
    own = np.flatnonzero(track.own)
    first, last = max(int(own[0]) - 1, 0), int(own[-1])
    centres = way.all_centres
    for column, flat, outward in ((0, way.start, 1.0), (1, way.start - claim.thickness, -1.0)):
        for rows, at in ((np.arange(first), first), (np.arange(last + 1, len(centres)), last)):
            if not len(rows):
                continue
            here, there = centres[rows, column], centres[at, column]
            inside = claim.radii[column] - outward * (here[:, 2] - flat)  # how deep the ball is
            deepest = claim.radii[column] - outward * (there[2] - flat)
            gone = np.hypot(*(here - there)[:, :2].T)
            wrong = (inside > claim.tolerance) & ((gone > STAYS) | (inside > deepest + claim.tolerance))
            for i in spread(wrong):
                arm = claim.arms[column]
                what = (
                    f"on its way to or from {claim.segment} {arm} is {mm(inside[i]):.3f} mm in the sheet, "
                    f"{mm(gone[i]):.3f} mm beside the place where it begins or ends"
                )
                row = int(track.rows[rows[i]])
                yield at_sample("verify.adsif", what, context.motion, arm, row)
