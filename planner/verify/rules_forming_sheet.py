"""The rule on what tools meet besides the face they form: what is formed already, walls, the flat sheet."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.claims import SheetState
from planner.geometry.closest import small_pieces
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.forming_reached import least, levels
from planner.verify.forming_state import Formed, Forming
from planner.verify.forming_track import Track, track
from planner.verify.rules_forming import NONE, spread

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

GRAIN = 0.002
"""Faces are asked at places so near to each other [m]."""
LOOKED = 0.001
"""Where bounds do not settle it, tools are looked at whenever they have moved so far [m]."""
ROUGH = 0.15
"""Bounds by the nearest place may be too near by this share."""
BESIDE = 1e-12
_BLOCK = 32
_PLACES = 60_000


def sheet(context: Context, forming: Forming) -> Outcome:
    """Neither tool has anything inside it of what is formed already, of the walls being formed or of the flat
    sheet around, but for what its own ball forms; the other tool stays on its own side of the face."""
    issues: list[Issue] = []
    worst, limit, where = -np.inf, None, ""
    known = {state.segment.lower() for _, state in forming.states}
    for one in forming.formed:
        if one.claim.segment.lower() not in known:
            what = f"nothing says what the tools meet in {one.claim.segment}"
            issues.append(Issue("verify.sheet", what, field=one.claim.segment))
    for index, state in forming.states:
        formed = forming.of(state.segment)
        way = track(context, state.segment, index, state.arms) if formed is None else formed.track
        if len(way.rows) < 2:
            continue
        for number, arm in enumerate(state.arms):
            if arm not in way.arms:
                what = f"{arm} has no program for {state.segment}"
                issues.append(Issue("verify.sheet", what, field=state.segment))
                continue
            held = state.segment.lower() in forming.gapped
            for deep, row in _all(formed, way, state, number, held):
                k = int(np.argmax(deep)) if len(deep) else -1
                if k >= 0 and deep[k] - state.tolerance > worst:
                    worst, limit, where = float(deep[k]) - state.tolerance, mm(state.tolerance), state.segment
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
    centre, axis = way.centre[:, column], way.axis[:, column]
    former = number == 0
    whole = _Head(profile, float(profile[0, 0]))
    still = np.zeros(len(centre))
    out = [whole.into(state.fixed, centre, axis, still, state.tolerance)]
    if len(state.carried):
        out.append(whole.into(state.carried, centre, axis, _sunk(way, state), state.tolerance))
    if one is None:
        return out
    # balls are held against the face exactly: that of the forming tool elsewhere, the other one below
    face = _Head(profile, 0.0) if former or profile[0, 0] < 0.0 else whole
    level = None if former or not held else levels(one)
    there = None if level is None else (state.side, _at_rows(one, level))
    out.append(face.into(_places(one), centre, axis, still, state.tolerance, there))
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
    near = one.face.nearest(centre[one.knots])
    room = -state.side * near.signed
    doubt = np.flatnonzero(0.5 * (room[begin] + room[end] - step) - off < ball - state.tolerance)
    one_end, other_end = centre[first[doubt]], centre[last[doubt]]
    need = ball - state.tolerance + off[doubt]
    if level is None:
        between = one.face.least(one_end, other_end, need)
        return [(ball - room, one.knots), (ball - between + off[doubt], last[doubt])]
    flat = state.side * one.claim.start
    # beyond the border of the face its height over the flat is what is signed
    around = np.abs(np.abs(near.signed) - near.apart) > BESIDE
    before = ~one.track.own[one.knots] & (level >= flat)
    height = state.side * centre[one.knots, 2] - flat
    deep = np.where(before, ball + height, np.where(around, ball - room, -np.inf))
    between = least(one.face, one_end, other_end, need, state.side, level[end[doubt]])
    return [(deep, one.knots), (ball - between + off[doubt], last[doubt])]


def _sunk(way: Track, state: SheetState) -> FloatArray:
    """How far (T,) [m] what is carried has moved along z: by the farthest level that the forming ball's
    surface has reached, from the start."""
    former = way.arms.index(state.arms[0])
    level = way.centre[:, former, 2] + state.side * float(state.heads[0][0, 0])
    if state.side > 0:
        return np.minimum(np.minimum.accumulate(level) - state.start, 0.0)
    return np.maximum(np.maximum.accumulate(level) - state.start, 0.0)


def _places(one: Formed) -> FloatArray:
    """Places (P, 3) all over a face."""
    corners = one.face.corners
    area = float(one.face.area.sum())
    parts, _ = small_pieces(corners, max(GRAIN, 2.0 * float(np.sqrt(area / _PLACES))), 4 * _PLACES)
    return np.concatenate([one.face.vertices[np.unique(one.face.faces)], parts.mean(axis=1)])


class _Head:
    """The part of a tool from ``begin`` [m] behind its TCP on, a body of revolution."""

    def __init__(self, profile: FloatArray, begin: float) -> None:
        back, radius = profile[:, 0], profile[:, 1]
        if begin > back[0]:
            at = float(np.interp(begin, back, radius))
            use = back > begin
            back, radius = np.append(begin, back[use]), np.append(at, radius[use])
        if radius[0] > 0.0:
            back, radius = np.append(back[0], back), np.append(0.0, radius)
        self.back, self.radius = back, radius
        self.balls = _cover(back, radius)

    def into(
        self,
        points: FloatArray,
        centre: FloatArray,
        axis: FloatArray,
        rise: FloatArray,
        need: float,
        there: tuple[int, FloatArray] | None = None,
    ) -> tuple[FloatArray, IntArray]:
        """How deep (R,) [m] points (P, 3), moved along z by ``rise`` (T,) [m], are inside the tool, at those
        rows (R,) of its way ``centre``, ``axis`` (T, 3) at which bounds do not say that none is. Points count
        that are ``there``: as high (T,) [m] as that toward a side, or higher."""
        if not len(points):
            return np.zeros(0), np.zeros(0, dtype=np.int64)
        tree = cKDTree(points)
        doubt = np.zeros((len(self.balls), len(centre)), dtype=np.bool_)
        for own, (back, size) in zip(doubt, self.balls, strict=True):
            middle = centre - back * axis
            middle[:, 2] -= rise
            own |= _near(tree, middle, size - need)
        rows = np.flatnonzero(doubt.any(axis=0))
        rows = rows[_thinned(centre[rows] - 0.5 * self.back[-1] * axis[rows], rise[rows])]
        kept = None if there is None else (there[0], there[1][rows])
        return self._depth(tree, points, centre[rows], axis[rows], rise[rows], doubt[:, rows], kept), rows

    def _depth(
        self,
        tree: cKDTree,
        points: FloatArray,
        centre: FloatArray,
        axis: FloatArray,
        rise: FloatArray,
        doubt: BoolArray,
        there: tuple[int, FloatArray] | None,
    ) -> FloatArray:
        """``doubt`` (K, R): the rows at which a point may be in each of the balls that cover the tool."""
        deep = np.full(len(centre), -np.inf)
        for own, (back, size) in zip(doubt, self.balls, strict=True):
            middle = centre - back * axis
            middle[:, 2] -= rise
            open_ = np.flatnonzero(own)
            for rows in np.array_split(open_, max(1, len(open_) // 2000)):
                if not len(rows):
                    continue
                found = np.atleast_1d(tree.query_ball_point(middle[rows], size, return_sorted=False))
                many = [len(one) for one in found]
                if not sum(many):
                    continue
                which = np.repeat(rows, many)
                near = points[np.fromiter(itertools.chain.from_iterable(found), np.int64, sum(many))]
                rest = near - centre[which]
                rest[:, 2] += rise[which]
                behind = -np.einsum("nd,nd->n", rest, axis[which])
                beside = np.sqrt(np.maximum(np.einsum("nd,nd->n", rest, rest) - behind**2, 0.0))
                inside = self._inside(behind, beside)
                if there is not None:
                    inside = np.where(there[0] * near[:, 2] >= there[1][which], inside, -np.inf)
                np.maximum.at(deep, which, inside)
        return deep

    def _inside(self, behind: FloatArray, beside: FloatArray) -> FloatArray:
        """How deep (M,) [m] points are inside the outline, negative outside; its rear end is open."""
        most = np.interp(behind, self.back, self.radius)
        inside = (beside < most) & (behind > self.back[0]) & (behind < self.back[-1])
        off = np.full(len(behind), np.inf)
        for k in range(len(self.back) - 1):
            one = np.array([self.back[k], self.radius[k]])
            way = np.array([self.back[k + 1], self.radius[k + 1]]) - one
            rest = np.stack([behind, beside], axis=1) - one
            share = np.clip(rest @ way / max(float(way @ way), 1e-30), 0.0, 1.0)
            off = np.minimum(off, np.linalg.norm(rest - share[:, None] * way, axis=1))
        return np.where(inside, off, -off)


def _cover(back: FloatArray, radius: FloatArray) -> list[tuple[float, float]]:
    """Balls (place behind the TCP, radius) [m] that hold a body of revolution."""
    size = max(float(radius.max()), 1e-3)
    edges = np.linspace(back[0], back[-1], max(int(np.ceil((back[-1] - back[0]) / size)), 1) + 1)
    out = []
    for low, high in itertools.pairwise(edges):
        inner = (back >= low) & (back <= high)
        most = max(float(np.interp([low, high], back, radius).max()), float(radius[inner].max(initial=0.0)))
        out.append((0.5 * float(low + high), float(np.hypot(most, 0.5 * (high - low)))))
    return out


def _near(tree: cKDTree, middle: FloatArray, size: float) -> BoolArray:
    """Rows (T,) of the way of a ball's middle at which a point may be within ``size`` [m]: blocks of rows are
    settled by one look each where the ball keeps farther off than it moves within the block."""
    count = len(middle)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    first = np.arange(0, count, _BLOCK)
    last = np.minimum(first + _BLOCK, count) - 1
    out = np.zeros(count, dtype=np.bool_)
    while len(first):
        look = (first + last) // 2
        reach = np.maximum(way[last] - way[look], way[look] - way[first]) + size
        most = float(reach.max(initial=0.0))
        # many places are about as near in the middle of a dish: the nearest but for a share is enough
        bound = (1.0 + ROUGH) * most + 1e-9
        far = np.asarray(tree.query(middle[look], eps=ROUGH, distance_upper_bound=bound)[0])
        open_ = far < (1.0 + ROUGH) * reach
        small = open_ & ((way[last] - way[first] <= LOOKED) | (last == first))
        mark = np.zeros(count + 1, dtype=np.int64)
        np.add.at(mark, first[small], 1)
        np.add.at(mark, last[small] + 1, -1)
        out |= np.cumsum(mark[:-1]) > 0
        split = open_ & ~small
        first, last, look = first[split], last[split], look[split]
        first, last = np.concatenate([first, look + 1]), np.concatenate([look, last])
    return out


def _thinned(points: FloatArray, rise: FloatArray) -> IntArray:
    """Rows such that the points (T, 3) have moved by no more than ``LOOKED`` from one to the next, or by a
    single row."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1) + np.abs(np.diff(rise))
    way = np.concatenate([[0.0], np.cumsum(step)])
    return np.flatnonzero(np.diff(np.floor(way / (0.5 * LOOKED)), prepend=-1.0) != 0)
