"""What of a sheet a knife's blade is in, and how it stands along its curve.

The blade is looked at as lines along its axis, from its back to its edge: each goes through both faces of
the sheet, and has cut one of them where its lower end is behind that. Headings are read from the x axis of
the TCP, which the program's text gives, and held against directions that the curve has along the blade.
"""

import dataclasses
from functools import cached_property

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.trim.claims import TrimBlade
from planner.processes.trim.proof.outlines import Curve
from planner.processes.trim.proof.torch_motion import BEND_SHARE, PLACE_STEP, TrimWork, Way, behind

LINES = 9
"""Lines along a blade that are looked at wherever it goes,"""
END_SPACING = 0.04e-3
"""and how near to one another [m] they are where it went in and where it comes out."""
ON_FACE = 1e-6
"""A line that ends no farther over a face than this [m] has cut it."""
PLAN_TURN = np.deg2rad(1.0)
"""Where a curve turns by less than this at a place, seen from above, is no corner."""
CORNER_ERROR = np.deg2rad(1.0)
"""What may be between two readings of a corner [rad]."""
LEAST_CHORD = 0.3e-3
"""Chords whose directions count are no shorter [m]."""
DIRECTIONS = 7
"""Directions of a curve that count at one place."""
WENT_ON = 0.1e-3
"""A knife that has moved along the face by less than this [m] has only gone in."""


@dataclasses.dataclass(frozen=True)
class Corners:
    """Sharp corners of a curve on the face: ``place`` (C, 3), ``normal`` (C, 3), the directions ``before``
    and ``after`` (C, 3) of the curve there, and ``at`` (C,) [m] along it, in order."""

    place: FloatArray
    normal: FloatArray
    before: FloatArray
    after: FloatArray
    at: FloatArray

    def past(self, places: FloatArray, near: float) -> FloatArray:
        """How far (N,) [m] beyond a corner places (N, 3) are that lie, within ``near`` [m], on the straight
        line on which one of its sides goes on, the least of all; inf of others."""
        out = np.full(len(places), np.inf)
        for place, normal, before, after in zip(
            self.place, self.normal, self.before, self.after, strict=True
        ):
            rest = places - place
            for way in (before, -after):
                along, aside = rest @ way, np.abs(rest @ np.cross(normal, way))
                out = np.where((aside <= near) & (along >= -near), np.minimum(out, along), out)
        return out


def sharp(work: TrimWork, curve: Curve, least: float) -> Corners:
    """Where a curve turns, on the face, by more than ``least`` [rad] at one place."""
    flat = curve.flat
    step = np.roll(flat, -1, axis=0) - flat
    after = step / np.linalg.norm(step, axis=1, keepdims=True)
    before = np.roll(after, 1, axis=0)
    plan = np.arccos(np.clip((before * after).sum(axis=1), -1.0, 1.0))
    some = np.flatnonzero(plan > PLAN_TURN)
    place, normal = work.sheet.at(flat[some])
    ways = []
    for way in (before[some], after[some]):
        up = -(way * normal[:, :2]).sum(axis=1) / np.maximum(normal[:, 2], 0.02)
        along = np.column_stack([way, up])
        ways.append(along / np.linalg.norm(along, axis=1, keepdims=True))
    turn = np.arccos(np.clip((ways[0] * ways[1]).sum(axis=1), -1.0, 1.0))
    at = curve.off(place)[1]
    rows = np.flatnonzero(turn > least)
    rows = rows[np.argsort(at[rows], kind="stable")]
    return Corners(place[rows], normal[rows], ways[0][rows], ways[1][rows], at[rows])


@dataclasses.dataclass(frozen=True)
class Cut:
    """Where lines of a blade went through one face: ``foot`` (M, 3) on the near one, ``off`` (M,) [m] from
    the curve, below zero on the part, ``at`` (M,) [m] along it, ``rows`` (M,) of the motion. ``ways`` has the
    same line by line, and along the blade at both ends."""

    ways: tuple[Way, ...]
    foot: FloatArray
    off: FloatArray
    at: FloatArray
    rows: IntArray


class BladeWay:
    """The way of a knife in one slot: ``tip``, ``axis``, ``ahead`` (N, 3), from the TCP into the tool and the
    way it cuts, at places no farther apart than ``PLACE_STEP``, and ``rows`` (N,) of the motion."""

    def __init__(self, work: TrimWork, own: TrimBlade, key: str) -> None:
        self.work, self.own, self.curve = work, own, work.slots[key]
        track, claim = work.of_slot(key), work.claim
        bend = BEND_SHARE * claim.tolerance
        tip, axis, ahead, rows = track.turned(PLACE_STEP, bend, own.blade.width)
        order = np.argsort(rows, kind="stable")
        self.tip, self.axis, self.ahead = tip[order], axis[order], ahead[order]
        self.rows = rows[order]
        self.feet, self.deep = work.feet(self.tip, self.axis)

    @cached_property
    def moved(self) -> BoolArray:
        """(N,) whether it has gone on along the face, not only in."""
        return np.asarray(np.linalg.norm(self.feet.foot - self.feet.foot[0], axis=1) > WENT_ON)

    @cached_property
    def near(self) -> Cut:
        """What is cut of the near face."""
        return self._cut(False)

    @cached_property
    def far(self) -> Cut:
        """What is cut of the far one."""
        return self._cut(True)

    def _cut(self, far: bool) -> Cut:
        blade = self.own.blade
        most = float(blade.front(min(float(self.deep.max()) + self.work.claim.height, blade.length)))
        before = np.unique(np.append(np.linspace(-blade.end, most, LINES), 0.0))
        every = np.arange(len(self.tip))
        ways = [self._line(every, np.full(len(every), x), far) for x in before]
        fine = np.linspace(-blade.end, most, max(int(np.ceil((blade.end + most) / END_SPACING)), 2))
        inside = int(np.argmax(self.deep >= self.deep.max() - 0.5 * self.work.claim.height))
        ends = (np.full(len(fine), row) for row in (inside, len(every) - 1))
        ways += [self._line(row, fine, far) for row in ends]
        foot = np.concatenate([way.feet.foot for way in ways])
        off, at, rows = (
            np.concatenate([getattr(way, name) for way in ways]) for name in ("off", "at", "rows")
        )
        return Cut(tuple(way for way in ways if len(way.rows)), foot, off, at, rows)

    def _line(self, index: IntArray, before: FloatArray, far: bool) -> Way:
        """Lines ``before`` (M,) [m] the TCP at places ``index`` (M,) that have cut a face."""
        blade, work = self.own.blade, self.work
        axis = self.axis[index]
        base = self.tip[index] + before[:, None] * self.ahead[index]
        up = behind(work.other if far else work.sheet, base, axis)
        front, full = np.maximum(before, 0.0), blade.width - blade.end
        low = front / full * blade.ground if full > 0.0 else np.zeros(len(before))
        cut = (low <= up + ON_FACE) & (up <= blade.length)
        index, axis, place = index[cut], axis[cut], (base + up[:, None] * axis)[cut]
        feet = work.sheet.feet(place)
        off, at = self.curve.off(feet.foot)
        off = np.where(self.curve.in_waste(feet.foot), off, -off)
        return Way(place, axis, feet, self.rows[index], off, at, np.zeros(len(index)))

    def off_heading(self) -> FloatArray:
        """How far (N,) [rad] the blade is turned off all directions that its curve has within half of its
        width either way, on one side of a sharp corner or on the other."""
        work, curve, blade = self.work, self.curve, self.own.blade
        normal, foot = self.feet.normal, self.feet.foot
        at = curve.off(foot)[1]
        ends = sharp(work, curve, self.own.turns + CORNER_ERROR + work.sheet.turn).at
        long = blade.end + float(blade.front(min(float(np.max(self.deep)), blade.length)))
        reach, best = max(0.5 * long, LEAST_CHORD), np.full(len(at), np.inf)
        for low, high in _sides(at, ends, curve.length, long + work.near):
            least, most = np.full(len(at), np.inf), np.full(len(at), -np.inf)
            for x in np.linspace(-reach, reach, DIRECTIONS):
                first = np.clip(at + x - 0.5 * LEAST_CHORD, low, high - LEAST_CHORD)
                last = np.maximum(np.minimum(first + LEAST_CHORD, high), first + LEAST_CHORD)
                turn = _turned(self.ahead, curve.on(last) - curve.on(first), normal)
                least, most = np.minimum(least, turn), np.maximum(most, turn)
            best = np.minimum(best, np.maximum(np.maximum(least, -most), 0.0))
        return best


def _sides(
    at: FloatArray, ends: FloatArray, length: float, reach: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Between which corners (N,) [m] a place is that is ``at`` (N,) along a curve: those on both sides of it,
    and of a place within ``reach`` [m] of a corner those on that one's other side, too."""
    if not len(ends):
        return [(np.full(len(at), -np.inf), np.full(len(at), np.inf))]
    marks = np.concatenate([ends + turn * length for turn in (-2.0, -1.0, 0.0, 1.0, 2.0)])
    k = np.searchsorted(marks, at, side="right")
    before, behind_it = at - marks[k - 1] < reach, marks[k] - at < reach
    return [
        (marks[k - 1], marks[k]),
        (np.where(before, marks[k - 2], marks[k - 1]), np.where(before, marks[k - 1], marks[k])),
        (np.where(behind_it, marks[k], marks[k - 1]), np.where(behind_it, marks[k + 1], marks[k])),
    ]


def _turned(ahead: FloatArray, way: FloatArray, normal: FloatArray) -> FloatArray:
    """Angle (N,) [rad] from lines along one way to those along another, about the normal (N, 3), a quarter of
    a turn either way at most."""
    across = (np.cross(ahead, way) * normal).sum(axis=1)
    flat = (ahead * way).sum(axis=1) - (ahead * normal).sum(axis=1) * (way * normal).sum(axis=1)
    return np.asarray(np.arctan2(np.where(flat < 0.0, -across, across), np.abs(flat)))


def blade_way(work: TrimWork, own: TrimBlade, key: str) -> BladeWay:
    """The way of a knife in one slot, worked out once."""
    if key not in work.kept:
        work.kept[key] = BladeWay(work, own, key)
    return work.kept[key]  # type: ignore[no-any-return]
