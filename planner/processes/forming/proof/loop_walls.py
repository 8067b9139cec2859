"""How steep the wall is between the loops of a track whose tools go deeper than the part.

Of each place of the former's way in plan the loop above is the nearest one that it went along before, seen
square to its way: a ray to either side meets it. No loop is known by number. The wall between both as tools
are commanded is held against what a metal stands in one pass, and told beside the wall without the shifts.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, lengths
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.proof.level import OneLevel
from planner.processes.forming.proof.state import Formed, Forming
from planner.proof.context import Context
from planner.proof.rule import at_sample

SPACING = 1e-3
"""Places of a way at which walls are looked at are so far apart [m] at most."""
NEAREST, FARTHEST = 0.5e-3, 16e-3
"""Loops above are looked for within so much [m] in plan, then within twice that, up to the other."""
AT_ONCE = 20_000
"""Places whose loops above are looked for at once."""
SAMPLE = 2_000
"""Places by which the usual distance of loops is known."""
LEAST_APART = 0.5
"""Loops nearer than this share of their usual distance are one: the seam, and a level last loop over the one
before it. Then the next one above counts."""
HALF = 3e-3
"""Distances and heights of loops are means over so much way [m] on either side: loops are polygons, whose
corners lie beside one another by chance."""
LEAST_MOVE = 1e-7
"""Moves shorter in plan [m] have no side."""
RUN_IN = 0.8
"""Where the shift is this share of what its slope allows from the first place on, or more, it still grows
from 0: that is no wall, for the sheet is not formed before the tools are as deep as it gives way."""
LEAST_RISE = 0.1
"""Levels that go down by less than this share of a step are floors."""
ANGLE = np.deg2rad(1.0)
"""Walls may be steeper than what is allowed by so much [rad]: chords of a wall that bends."""
ANGLE_STEP, SAME_STEP = np.deg2rad(15.0), np.deg2rad(1.0)
"""From shape to shape walls may get steeper by the first [rad], or by the operation's own step, and by the
other more."""
WALL_SHARE = 0.995
"""Share of the walls that counts as the angle of a shape."""
SUPPORTED = frozenset({"dsif", "dpif_l", "adsif"})
"""Modes with a tool opposite the forming one."""
ACCEPTS = "forming.wall_angle"
"""What a problem accepts whose metal stands steeper walls than its row says."""


@dataclasses.dataclass(frozen=True)
class Walls:
    """K walls: ``angle`` (K,) [rad] as tools are commanded, ``before`` (K,) [rad] without their shifts, at
    the places ``row`` (K,) of the way, which are their lower ends."""

    angle: FloatArray
    before: FloatArray
    row: IntArray


NONE = Walls(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))
"""No wall."""


def too_steep(code: str, context: Context, forming: Forming, made: Formed, walls: Walls) -> Iterator[Issue]:
    """What is wrong with the steepest of the ``walls`` of a pass, if anything, at its sample. What is as
    steep without the shifts is for other rules."""
    limit = _allowed(context, forming, made)
    if limit is None or not len(walls.row):
        return
    over = walls.angle - np.maximum(limit, walls.before)
    k = int(np.argmax(over))
    if over[k] <= ANGLE:
        return
    got, was, most = (float(np.rad2deg(one)) for one in (walls.angle[k], walls.before[k], limit))
    what = f"{made.claim.segment} has a wall of {got:.1f} deg between loops as its tools are deeper, "
    what += f"{was:.1f} deg without; the sheet stands {most:.1f} deg there at once"
    row = int(made.track.rows[walls.row[k]])
    yield at_sample(code, what, context.motion, made.claim.arm, row, (got, most, "deg"))


def _allowed(context: Context, forming: Forming, made: Formed) -> float | None:
    """The steepest wall [rad] of a pass that the metal stands, behind the shapes before it; None where the
    problem accepts any, or there is no sheet."""
    stock = context.setups[made.setup].stock
    if ACCEPTS in context.problem.accept or stock.sheet is None:
        return None
    found = (
        (one.part, feature.shapes[:number])
        for one, _ in forming.parts
        if one is not None
        for feature in one.features
        for number, shape in enumerate(feature.shapes)
        if any(claim is made.claim for claim in shape.claims)
    )
    part, earlier = next(found, (None, ()))
    metal = stock.sheet.metal
    supported = part is not None and part.mode in SUPPORTED
    limit = float(metal.wall_angle_supported if supported else metal.wall_angle_single)
    if part is None or not earlier:
        return limit
    before = max(shape.steepest(WALL_SHARE) for shape in earlier)
    return float(max(limit, before + max(part.angle_step, ANGLE_STEP) + SAME_STEP))


def of_pass(made: Formed, slope: float) -> Walls:
    """The walls of a whole pass, whose shifts change by ``slope`` at most; `Walls.row` is of its track."""
    rows = _rows(made)
    if made.track.lifted is None or len(rows) < 2:
        return NONE
    side = made.claim.side
    found = between_loops(made.track.commanded(0, rows), side * made.track.lifted[rows], side, slope)
    return dataclasses.replace(found, row=rows[found.row])


def of_level(made: Formed, one: OneLevel) -> Walls:
    """The walls between a level that is formed alone and the one above it, of which the problem says at what
    shift it ended: elsewhere its shift is larger by the slope of the way to its end at most, so that walls
    are as steep as this says, or steeper. None of the first level, nor of floors."""
    rows = _rows(made)
    begin, end = one.depths
    rise, stated = end - begin, one.operation.level
    if made.track.lifted is None or len(rows) < 2 or begin <= 0.0 or rise < LEAST_RISE * one.step:
        return NONE
    centre = made.track.centre[rows, 0]
    gone = np.append(0.0, np.cumsum(lengths(np.diff(centre, axis=0))))
    slope, first = float(stated.slope), float(stated.before_mm) * MM
    if first > 0.0 and first >= RUN_IN * slope * gone[-1] * float(stated.number):
        return NONE
    found = made.face.nearest(centre)
    up = np.abs(centre[:, 2] - found.place[:, 2]) / np.maximum(found.apart, 1e-9)
    before = np.arccos(np.clip(up, 0.0, 1.0))
    more = made.claim.side * made.track.lifted[rows] - first - slope * (gone[-1] - gone)
    angle = np.arctan(np.tan(np.minimum(before, np.deg2rad(89.9))) * (1.0 + np.maximum(more, 0.0) / rise))
    return Walls(angle, before, rows)


def _rows(made: Formed) -> IntArray:
    """Rows of a track while it forms: where its straight pieces meet, and others between."""
    own = np.flatnonzero(made.track.own)
    if len(own) < 2:
        return own
    centre = made.track.centre[own, 0]
    gone = np.append(0.0, np.cumsum(lengths(np.diff(centre, axis=0))))
    even = np.searchsorted(gone, np.arange(0.0, gone[-1], SPACING))
    meet = np.searchsorted(own, made.knots[made.track.own[made.knots]])
    return np.asarray(own[np.unique(np.concatenate([even, meet, [0, len(own) - 1]]))])


def between_loops(place: FloatArray, shift: FloatArray, side: int, slope: float) -> Walls:
    """The walls between loops of the way ``place`` (N, 3) [m] of a ball on ``side``, which is deeper by
    ``shift`` (N,) [m], of ``slope`` at most; `Walls.row` is of the way."""
    deep = -side * place[:, 2]
    released = deep - shift
    gone = np.append(0.0, np.cumsum(np.hypot(lengths(np.diff(place[:, :2], axis=0)), np.diff(released))))
    grows = (shift >= RUN_IN * slope * gone) & (gone > 0.0)
    begun = float(gone[grows].max(initial=0.0))
    step = np.diff(place[:, :2], axis=0)
    some = np.flatnonzero(lengths(step) > LEAST_MOVE)
    if len(some) < 2:
        return NONE
    loops = _Loops(place[some, :2], step[some], *(np.stack([z[some], z[some + 1]]) for z in (deep, released)))
    sample = np.arange(0, len(some), max(1, len(some) // SAMPLE))
    usual = loops.above(sample, 0.0).apart
    if not len(usual):
        return NONE
    found = loops.above(np.arange(len(some)), LEAST_APART * float(np.median(usual)))
    kept = found.at(np.argsort(found.lower))
    kept = kept.at(np.flatnonzero(gone[some[kept.upper]] > begun))
    at = gone[some[kept.lower]]
    away, rise, before = (_mean(at, one) for one in (kept.away, kept.rise, kept.released))
    return Walls(np.arctan2(rise, away), np.arctan2(before, away), some[kept.lower])


def _mean(at: FloatArray, value: FloatArray) -> FloatArray:
    """The mean (K,) of ``value`` (K,) at places ``at`` (K,) [m] within `HALF` on either side."""
    total = np.append(0.0, np.cumsum(value))
    first, last = np.searchsorted(at, at - HALF), np.searchsorted(at, at + HALF, side="right")
    return np.asarray((total[last] - total[first]) / (last - first))


@dataclasses.dataclass(frozen=True)
class _Above:
    """Of pieces ``lower`` (K,) the pieces ``upper`` (K,) above them, ``away`` (K,) [m] in plan, and how far
    these are above [m]: ``rise`` as commanded, ``released`` without shifts."""

    lower: IntArray
    upper: IntArray
    away: FloatArray
    rise: FloatArray
    released: FloatArray

    @property
    def apart(self) -> FloatArray:
        return np.hypot(self.away, self.released)

    def at(self, rows: IntArray) -> "_Above":
        return _Above(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


class _Loops:
    """Straight pieces of a way, in its order: ``start``, ``step`` (M, 2) [m] in plan, how deep (2, M) [m]
    both ends are as commanded and released."""

    def __init__(self, start: FloatArray, step: FloatArray, deep: FloatArray, released: FloatArray) -> None:
        self._start, self._step = start, step
        self._middle = start + 0.5 * step
        self._aside = np.stack([-step[:, 1], step[:, 0]], axis=1) / lengths(step)[:, None]
        self._deep, self._released = deep, released
        self._tree = shapely.STRtree(shapely.linestrings(np.stack([start, start + step], axis=1)))

    def above(self, some: IntArray, least: float) -> _Above:
        """What is above the middles of pieces ``some`` (S,), ``least`` [m] apart without shifts."""
        out = []
        for part in np.array_split(some, len(some) // AT_ONCE + 1):
            left, reach = part, NEAREST
            while len(left) and reach <= FARTHEST:
                found = self._within(left, reach, least)
                out.append(found)
                left, reach = np.setdiff1d(left, found.lower), 2.0 * reach
        names = [field.name for field in dataclasses.fields(_Above)]
        return _Above(*(np.concatenate([getattr(one, name) for one in out]) for name in names))

    def _within(self, some: IntArray, reach: float, least: float) -> _Above:
        middle, aside = self._middle[some], self._aside[some]
        rays = shapely.linestrings(np.stack([middle - reach * aside, middle + reach * aside], axis=1))
        ray, upper = self._tree.query(rays, predicate="intersects")
        earlier = upper < some[ray]
        ray, upper = ray[earlier], upper[earlier]
        to, way, out = self._start[upper] - middle[ray], self._step[upper], aside[ray]
        turn = _cross(out, way)
        good: BoolArray = np.abs(turn) > 1e-3 * lengths(way)
        ray, upper, to, way, out, turn = (one[good] for one in (ray, upper, to, way, out, turn))
        away: FloatArray = np.abs(_cross(to, way) / turn)
        share = np.clip(_cross(to, out) / turn, 0.0, 1.0)
        lower: IntArray = np.asarray(some[ray], dtype=np.int64)
        upper = np.asarray(upper, dtype=np.int64)
        rise, released = (
            0.5 * z[:, lower].sum(axis=0) - (1.0 - share) * z[0, upper] - share * z[1, upper]
            for z in (self._deep, self._released)
        )
        far = np.hypot(away, released) >= max(least, LEAST_MOVE)
        order = np.flatnonzero(far)[np.lexsort((away[far], lower[far]))]
        first = order[np.flatnonzero(np.diff(lower[order], prepend=-1))]
        return _Above(lower[first], upper[first], away[first], rise[first], released[first])


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
