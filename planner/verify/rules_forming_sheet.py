"""The rule on what tools meet besides the face they form: what is formed already, walls, the flat sheet."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.claims_forming import SheetState
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.forming_face import Face
from planner.verify.forming_head import Head, HeadWay
from planner.verify.forming_reached import least, levels
from planner.verify.forming_state import Formed, Forming
from planner.verify.forming_track import Track, track
from planner.verify.rules_forming import NONE, spread
from planner.verify.surface import divided

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

GRAIN = 0.002
"""Faces are asked at places so near to each other [m]."""
BESIDE = 1e-12
_PLACES = 60_000


def sheet(context: Context, forming: Forming) -> Outcome:
    """Neither tool has anything inside it of what is formed already, of the walls being formed or of the flat
    sheet around, but for what its own ball forms; the other tool stays on its own side of the face."""
    issues: list[Issue] = []
    worst, limit, where = -np.inf, None, ""
    known = {state.segment.key for _, state in forming.states}
    for one in forming.formed:
        if one.claim.segment.key not in known:
            what = f"nothing says what the tools meet in {one.claim.segment}"
            issues.append(Issue("verify.sheet", what, field=str(one.claim.segment)))
    for index, state in forming.states:
        formed = forming.of(state.segment)
        way = track(context, state.segment, index, state.arms) if formed is None else formed.track
        if len(way.rows) < 2:
            continue
        for number, arm in enumerate(state.arms):
            if arm not in way.arms:
                what = f"{arm} has no program for {state.segment}"
                issues.append(Issue("verify.sheet", what, field=str(state.segment)))
                continue
            held = state.segment.key in forming.gapped
            allowed = state.tolerance if number == 0 else state.other
            state = dataclasses.replace(state, tolerance=allowed)
            for deep, row in _all(formed, way, state, number, held):
                k = int(np.argmax(deep)) if len(deep) else -1
                if k >= 0 and deep[k] - state.tolerance > worst:
                    worst, limit, where = (
                        float(deep[k]) - state.tolerance,
                        mm(state.tolerance),
                        str(state.segment),
                    )
                for i in spread(deep > state.tolerance):
                    what = (
                        f"the tool of {arm} has {mm(deep[i]):.3f} mm of the sheet inside in {state.segment}; "
                        f"allowed: {mm(state.tolerance):g} mm"
                    )
                    measure = (mm(float(deep[i])), mm(state.tolerance), "mm")
                    sample = int(way.rows[row[i]])
                    issues.append(at_sample("verify.sheet", what, context.motion, arm, sample, measure))
    if limit is None:
        return Outcome(tuple(issues), where=NONE if not forming.formed else "nothing near")
    return Outcome(tuple(issues), mm(worst) + limit, limit, "mm", where)


def _all(
    one: Formed | None, way: Track, state: SheetState, number: int, held: bool
) -> list[tuple[FloatArray, IntArray]]:
    """How deep [m] things are inside a tool, and at which rows of the track; ``held``: two tools hold the
    sheet between them."""
    profile = state.heads[number]
    column = way.arms.index(state.arms[number])
    centre, axis = way.centre[:, column], way.axis(column)
    former = number == 0
    whole = Head.of(profile, float(profile[0, 0]))
    still = HeadWay.of(centre, axis, np.zeros(len(centre)), float(profile[-1, 0]))
    out = [whole.into(state.fixed, still, state.tolerance)]
    if len(state.carried):
        sinking = HeadWay.of(centre, axis, _sunk(way, state), float(profile[-1, 0]))
        out.append(whole.into(state.carried, sinking, state.tolerance))
    if one is None:
        return out
    # balls are held against the face exactly: that of the forming tool elsewhere, the other one below
    face = Head.of(profile, 0.0) if former or profile[0, 0] < 0.0 else whole
    level = None if former or not held else levels(one)
    there = None if level is None else (state.side, _at_rows(one, level)[still.rows])
    out.append(face.into(_places(one.face if former else one.left), still, state.tolerance, there))
    if not former:
        out += _own_side(one, centre, max(-float(profile[0, 0]), 0.0), state, level)
    return out


def _at_rows(one: Formed, level: FloatArray) -> FloatArray:
    """What is known at the knots of a pass, at all rows of its track: that of the knot at it or behind it."""
    rows = np.searchsorted(one.knots, np.arange(len(one.track.rows)))
    return level[np.minimum(rows, len(level) - 1)]


def _own_side(
    one: Formed, centre: FloatArray, ball: float, state: SheetState, level: FloatArray | None
) -> list[tuple[FloatArray, IntArray]]:
    """How deep [m] the other tool's ball is in the face, and in the flat sheet around it, or on their wrong
    side, with rows of the track. Where ``level`` (K + 1,) [m] at the knots says what of the face is there,
    that alone counts, and all the sheet is flat before any is."""
    first, last, off = one.pieces.first, one.pieces.last, one.pieces.off
    begin, end = np.searchsorted(one.knots, first), np.searchsorted(one.knots, last)
    step = np.linalg.norm(centre[last] - centre[first], axis=1)
    face = one.left  # corners that the forming ball does not reach are not there
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
    around = np.abs(np.abs(near.signed) - near.apart) > BESIDE
    before = ~one.track.own[one.knots] & (level >= flat)
    height = state.side * centre[one.knots, 2] - flat
    deep = np.where(before, ball + height, np.where(around, ball - room, -np.inf))
    between = least(face, one_end, other_end, need, state.side, level[end[doubt]])
    return [(deep, one.knots), (ball - between + off[doubt], last[doubt])]


def _sunk(way: Track, state: SheetState) -> FloatArray:
    """How far (T,) [m] what is carried has moved along z: by the farthest level that the forming ball's
    surface has reached, from the start."""
    former = way.arms.index(state.arms[0])
    level = way.centre[:, former, 2] + state.side * float(state.heads[0][0, 0])
    if state.side > 0:
        return np.minimum(np.minimum.accumulate(level) - state.start, 0.0)
    return np.maximum(np.maximum.accumulate(level) - state.start, 0.0)


def _places(face: Face) -> FloatArray:
    """Places (P, 3) all over a face."""
    corners = face.corners
    area = float(face.area.sum())
    parts, _ = divided(corners, max(GRAIN, 2.0 * float(np.sqrt(area / _PLACES))))
    return np.concatenate([face.vertices[np.unique(face.faces)], parts.mean(axis=1)])
