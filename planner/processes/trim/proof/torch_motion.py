"""Where a torch, a mill or a knife is while it trims, whether an arc burns then, and how far its body is off
the sheet."""

import dataclasses
import itertools
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.swept_body import RoundBody, least_distances, places_near
from planner.issues import Issue
from planner.processes.forming.proof.state import FORMING
from planner.processes.trim.claims import TrimsSheet, slot_names
from planner.processes.trim.proof.outlines import TRIM, Curve, Feet, SheetSide
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.part_files import UnreadError
from planner.proof.replay.tool_track import Track, track_of
from planner.tooling import Torch

SIGHT = 20e-3
"""What is farther off a torch than this [m] is not told apart."""
FACE_SPACING = 0.8e-3
"""How near [m] to one another places of a face are at which a torch is looked for."""
PLACE_STEP = 0.2e-3
"""Places of a torch's way are no farther apart than this [m];"""
PLACE_ERROR = 0.02e-3
"""What places of ways and curves, between which nothing is looked at, may hide [m]."""
BEND_SHARE = 0.05
"""straight lines between them leave its way by no more than this part of the tolerance."""
MOST_FACE_PLACES = 1_000_000
"""Places of a face at most."""


@dataclasses.dataclass(frozen=True)
class Burning:
    """Intervals [s] in which a signal is on: ``begin`` and ``end`` (B,)."""

    begin: FloatArray
    end: FloatArray

    @staticmethod
    def of(context: Context, claim: TrimsSheet) -> "Burning":
        """When the programs have the signal of a claim on."""
        begin: list[float] = []
        end: list[float] = []
        for at, value in context.motion.switched(claim.signal, context.switching((claim.arm,))):
            if value and len(begin) == len(end):
                begin.append(at)
            elif not value and len(begin) > len(end):
                end.append(at)
        if len(begin) > len(end):
            end.append(float("inf"))
        return Burning(np.array(begin), np.array(end))

    def at(self, time: FloatArray) -> BoolArray:
        """(T,) whether it is on at some times, the ends of intervals among them."""
        place = np.searchsorted(self.begin, time, side="right") - 1
        inside = place >= 0
        out = np.zeros(len(time), dtype=bool)
        out[inside] = time[inside] <= self.end[place[inside]]
        return out


CROSS_ROUNDS = 8
"""Times that the place is looked for anew in which an axis goes through a face."""


@dataclasses.dataclass(frozen=True)
class Way:
    """Places of the tool in one slot, ``PLACE_STEP`` apart at most: ``tip`` and ``axis`` (N, 3), from the TCP
    into the tool, ``feet`` on the face, and ``rows`` (N,) of the motion; ``off`` (N,) [m] from the curve that
    it cuts, below zero on the part, and where along that, ``at`` (N,) [m]. ``deep`` (N,) [m]: of a mill or a
    knife, how far along its axis the tip is behind the face, below zero over it; zero of a torch."""

    tip: FloatArray
    axis: FloatArray
    feet: Feet
    rows: IntArray
    off: FloatArray
    at: FloatArray
    deep: FloatArray


def behind(sheet: SheetSide, tip: FloatArray, axis: FloatArray) -> FloatArray:
    """How far (N,) [m] from a ``tip`` along its ``axis`` (N, 3) the axis goes through the face."""
    out = np.zeros(len(tip))
    for _ in range(CROSS_ROUNDS):
        place = tip + out[:, None] * axis
        point, normal = sheet.at(place[:, :2])
        slope = (axis * normal).sum(axis=1)
        slope = np.where(np.abs(slope) < 0.1, np.copysign(0.1, slope), slope)
        out = out - ((place - point) * normal).sum(axis=1) / slope
    return out


class TrimWork:
    """One claim on a trimmed sheet, with the motion of its torch. Raises `UnreadError` where part or curves
    cannot be read once more."""

    def __init__(
        self, context: Context, index: int, claim: TrimsSheet, flat: Callable[[FloatArray], FloatArray]
    ) -> None:
        self.context, self.index, self.claim = context, index, claim
        part = context.problem.source.get("part")
        self.sheet = SheetSide(claim, part, flat)
        self._other = partial(SheetSide, dataclasses.replace(claim, side=-claim.side), part, flat)
        self.curves = tuple(Curve(one, self.sheet) for one in claim.outlines)
        self._tracks: dict[tuple[str, ...], Track] = {}
        labels = tuple(sorted(set(context.motion.node_label.tolist())))
        self.track = self._track(labels)
        self._ways: dict[str, Way | None] = {}
        self.kept: dict[str, Any] = {}  # what is worked out of it elsewhere
        self.burning = Burning.of(context, claim)

    @property
    def near(self) -> float:
        """How far [m] a slot's edge may be off its outline: whatever is no farther cuts that, and is held
        against all that is asked of what cuts."""
        return self.claim.tolerance + self.sheet.tolerance + PLACE_ERROR

    @cached_property
    def other(self) -> SheetSide:
        """The sheet's other side."""
        return self._other()

    def feet(self, tip: FloatArray, axis: FloatArray) -> tuple[Feet, FloatArray]:
        """Where tools are on the face: a torch at its foot, others where their axis goes through that; and
        how deep (N,) [m] the tip is behind."""
        if self.claim.through is None:
            return self.sheet.feet(tip), np.zeros(len(tip))
        deep = behind(self.sheet, tip, axis)
        return self.sheet.feet(tip + deep[:, None] * axis), deep

    @cached_property
    def slots(self) -> dict[str, Curve]:
        """The curve that each slot cuts, by the key of its segment; of a knife's those that there are."""
        names = {Segment(TRIM, name).key: c for c in self.curves for name in slot_names(self.claim, c.one)}
        if self.claim.knife is None:
            return names
        there = set(self.context.motion.node_label.tolist())
        return {key: curve for key, curve in names.items() if key in there}

    def _track(self, labels: tuple[str, ...]) -> Track:
        if labels not in self._tracks:
            self._tracks[labels] = track_of(self.context, self.index, self.claim.arm, labels)
        return self._tracks[labels]

    def of_slot(self, key: str) -> Track:
        """The track in one slot."""
        return self._track((key,))

    def way(self, key: str) -> Way | None:
        """The way of the torch in one slot, None where it has none."""
        if key not in self._ways:
            track, curve = self.of_slot(key), self.slots[key]
            self._ways[key] = None
            if len(track.rows) > 1:
                tip, axis, rows = track.spaced(PLACE_STEP, BEND_SHARE * self.claim.tolerance)
                order = np.argsort(rows, kind="stable")
                tip, axis, rows = tip[order], axis[order], rows[order]
                feet, deep = self.feet(tip, axis)
                off, at = curve.off(feet.foot)
                off = np.where(curve.in_waste(feet.foot), off, -off)
                self._ways[key] = Way(tip, axis, feet, rows, off, at, deep)
        return self._ways[key]

    def ways(self, curve: Curve) -> dict[str, Way | None]:
        """:meth:`way` of each slot of a curve, by its key."""
        return {key: self.way(key) for key, own in self.slots.items() if own is curve}


class Trimming:
    """All claims on trimmed sheets of a proof; ``issues`` says what could not be read."""

    def __init__(self, context: Context) -> None:
        self.context, forming = context, context.get(FORMING)
        works, self.issues = list[TrimWork](), list[Issue]()
        for index, setup in enumerate(context.setup_claims):
            for group in setup.groups:
                for claim in group:
                    if not isinstance(claim, TrimsSheet):
                        continue
                    try:
                        flat = partial(forming.still_flat, group)
                        works.append(TrimWork(context, index, claim, flat))
                    except (UnreadError, OSError) as error:
                        what = f"part or curves cannot be read a second time: {error}"
                        self.issues.append(Issue("verify.trim_cut", what, field="operations.outlines"))
        self.works = tuple(works)


TRIMMING: Final[Fact[Context, Trimming]] = Fact("trimming", Trimming)
"""The trimming of a proof."""


STANDING = 0.05e-3
"""A torch that moves by no more than this [m] stands."""


def begins(track: Track) -> int:
    """The last row at which a tool still stands where its track begins: the first one of none that stands."""
    moved = np.linalg.norm(track.tip - track.tip[:1], axis=1) > STANDING
    return max(int(np.argmax(moved)) - 1, 0) if moved.any() else len(moved) - 1


FIRST_SAMPLES = 256
"""Samples at once in which it is looked for where a tool gets so far, four times as many each time."""


def longest_stay(track: Track, far: float) -> float:
    """The longest time [s] in which a tool gets no farther than ``far`` [m] from a place, from where it
    begins to move: each time from the first place that is farther from the one before."""
    worst, last, at = 0.0, len(track.tip) - 1, begins(track)
    while at < last:
        count, away = FIRST_SAMPLES, np.zeros(0, dtype=bool)
        while not away.any() and len(away) < last - at:
            away = np.linalg.norm(track.tip[at + 1 : at + 1 + count] - track.tip[at], axis=1) > far
            count *= 4
        step = int(np.argmax(away)) + 1 if away.any() else len(away)
        worst, at = max(worst, float(track.time[at + step] - track.time[at])), at + step
    return worst


def body(torch: Torch) -> RoundBody:
    """A torch as a body of revolution, from the TCP backwards: cone and body, by its half section, a convex
    polygon; distances outside of it are from its edges, inside from the nearest of them."""
    corners = np.array(
        [
            [torch.standoff, 0.0],
            [torch.standoff, torch.nozzle],
            [torch.standoff + torch.cone, torch.body],
            [torch.back, torch.body],
            [torch.back, 0.0],
        ]
    )

    def distance(back: FloatArray, beside: FloatArray) -> FloatArray:
        shape, point = back.shape, np.stack([back.ravel(), beside.ravel()], axis=1)
        best, inside = np.full(len(point), np.inf), np.ones(len(point), dtype=bool)
        for a, b in itertools.pairwise(corners):
            way, rest = b - a, point - a
            inside &= way[0] * rest[:, 1] - way[1] * rest[:, 0] <= 0.0
            share = np.clip(rest @ way / max(float(way @ way), 1e-24), 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(rest - share[:, None] * way, axis=1))
        return np.asarray(np.where(inside, -best, best).reshape(shape))

    return RoundBody(torch.standoff, torch.back, torch.body, distance)


def cylinder(low: float, high: float, radius: float) -> RoundBody:
    """A cylinder from ``low`` to ``high`` [m] behind the tip."""

    def distance(back: FloatArray, beside: FloatArray) -> FloatArray:
        side, ends = beside - radius, np.maximum(low - back, back - high)
        outside = np.hypot(np.maximum(side, 0.0), np.maximum(ends, 0.0))
        return np.asarray(np.where(outside > 0.0, outside, np.maximum(side, ends)))

    return RoundBody(low, high, radius, distance)


def bodies(claim: TrimsSheet) -> list[RoundBody]:
    """What of the tool keeps clear of the sheet: a torch; shank, holder and spindle of a mill; a knife's
    body."""
    if claim.torch is not None:
        return [body(claim.torch)]
    if claim.knife is not None:
        return [cylinder(claim.knife.blade.length, claim.knife.back, claim.knife.body)]
    if claim.mill is None:
        return []
    cutter = claim.mill.cutter
    out = [cylinder(cutter.flute, cutter.overhang, cutter.shank)] if cutter.overhang > cutter.flute else []
    rings = cutter.behind.tolist()
    return out + [cylinder(a[0], b[0], a[1]) for a, b in zip(rings[::2], rings[1::2], strict=True)]


def off_sheet(work: TrimWork, rows: IntArray) -> tuple[float, int]:
    """Least distance [m] of the tool from the sheet at rows of its track, ``SIGHT`` at most, and the row."""
    found = [_off_sheet(work, rows, own) for own in bodies(work.claim)]
    return min(found, key=lambda one: one[0])


def _off_sheet(work: TrimWork, rows: IntArray, own: RoundBody) -> tuple[float, int]:
    tip, axis = work.track.tip[rows], work.track.axis[rows]
    corners = work.sheet.vertices[work.sheet.faces]
    low, high = corners.reshape(-1, 3)[:, :2].min(axis=0), corners.reshape(-1, 3)[:, :2].max(axis=0)
    size = 0.5 * np.asarray(work.context.stock(work.index).size)[:2]
    flat = []
    xs, ys = [min(-size[0], low[0]), max(size[0], high[0])], [min(-size[1], low[1]), max(size[1], high[1])]
    for x0, y0, x1, y1 in (
        (xs[0], ys[0], low[0], ys[1]),
        (high[0], ys[0], xs[1], ys[1]),
        (low[0], ys[0], high[0], low[1]),
        (low[0], high[1], high[0], ys[1]),
    ):
        a, b, c, d = (np.array([x, y, work.sheet.rise]) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)))
        flat += [np.array([a, b, c]), np.array([a, c, d])]
    every = np.concatenate([corners, np.array(flat)])
    # no place of a face is looked at that is farther off than the nearest corner
    corner, where = least_distances(work.sheet.vertices, tip, axis, own, SIGHT, -np.inf)
    k = int(np.argmin(corner))
    near = max(float(corner[k]), 0.0) + PLACE_ERROR
    places, _, count = places_near(every, tip, axis, own, near, FACE_SPACING, MOST_FACE_PLACES)
    if count > MOST_FACE_PLACES:
        raise UnreadError(
            f"the sheet would have to be looked at in {count} places; {MOST_FACE_PLACES} may be"
        )
    off, at = least_distances(places, tip, axis, own, near, -np.inf)
    if len(off) and float(off.min()) < float(corner[k]):
        corner, where, k = off, at, int(np.argmin(off))
    return float(corner[k]), int(rows[where[k]])
