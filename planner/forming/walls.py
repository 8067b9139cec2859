"""Walls of a part: maximal runs of a skeleton that go one way, cut at terraces. Each becomes one feature."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.forming import terraces
from planner.forming.skeleton import EXACT, Skeleton
from planner.forming.surface import SheetSurface, plan_areas
from planner.forming.values import FloatArray

CLEAR: Final = 1.1
"""How far from a noisy flat the first level line is, in units of its noise as it shows on the flat itself: of
the flat's vertices some count as parts of the walls."""


@dataclasses.dataclass(frozen=True)
class Wall:
    """One feature to be: ``parent`` index among the walls or None, ``start`` and ``end`` [m], ``first`` and
    ``last`` [m] levels between which its level lines are clean, ``height`` (V,) [m]: the surface on the wall,
    ``start`` outside it and ``end`` inside."""

    parent: int | None
    start: float
    end: float
    first: float
    last: float
    height: FloatArray

    @property
    def sign(self) -> float:
        """+1 where it rises from its start, -1 where it goes down."""
        return 1.0 if self.end > self.start else -1.0


@dataclasses.dataclass(frozen=True)
class _Run:
    begin: int
    through: tuple[int, ...]
    end: int


def walls(skeleton: Skeleton, surface: SheetSurface, noise: float) -> list[Wall]:
    """The walls, each after its parent."""
    area = plan_areas(surface)
    onward: list[list[int]] = [[] for _ in skeleton.places]
    for index, place in enumerate(skeleton.places[1:], start=1):
        onward[place.before].append(index)
    found: list[Wall] = []
    waiting: list[tuple[int, int | None]] = [(other, None) for other in onward[0]]
    while waiting:
        first, parent = waiting.pop()
        run = _run(skeleton, onward, first)
        pieces = _pieces(run, skeleton, surface, area, noise)
        owner = parent
        owners = []
        for piece in pieces:
            found.append(dataclasses.replace(piece, parent=owner))
            owner = len(found) - 1
            owners.append(owner)
        sign = pieces[0].sign
        for stop in (*run.through, run.end):
            level = skeleton.places[stop].level
            fits = [k for k, piece in enumerate(pieces) if sign * (level - piece.end) < noise]
            leaving = [other for other in onward[stop] if other not in (*run.through, run.end)]
            waiting.extend((other, owners[fits[0] if fits else -1]) for other in leaving)
    return found


def _run(skeleton: Skeleton, onward: list[list[int]], first: int) -> _Run:
    sign = skeleton.direction(first)
    through, place = [], first
    while len(same := [other for other in onward[place] if skeleton.direction(other) == sign]) == 1:
        through.append(place)
        place = same[0]
    return _Run(skeleton.places[first].before, tuple(through), place)


def _height(run: _Run, skeleton: Skeleton) -> tuple[FloatArray, FloatArray]:
    """The surface on a run, constant elsewhere; and (V,) whether a vertex lies on the run itself."""
    places = skeleton.places
    own = {*run.through, run.end}
    low = np.full(2 * len(places), places[run.begin].level)
    high = low.copy()
    mine = np.zeros(2 * len(places), dtype=bool)
    inside: set[int] = set()
    for index, place in enumerate(places):
        if index in own:
            before = places[place.before].level
            low[2 * index + 1], high[2 * index + 1] = min(before, place.level), max(before, place.level)
            low[2 * index] = high[2 * index] = place.level
            mine[2 * index : 2 * index + 2] = True
        elif place.before in inside:
            held = low[2 * place.before]
            low[2 * index : 2 * index + 2] = high[2 * index : 2 * index + 2] = held
        else:
            continue
        inside.add(index)
    element = skeleton.element
    return np.clip(skeleton.height, low[element], high[element]), mine[element]


def _pieces(
    run: _Run, skeleton: Skeleton, surface: SheetSurface, area: FloatArray, noise: float
) -> list[Wall]:
    height, mine = _height(run, skeleton)
    begin, finish = skeleton.places[run.begin], skeleton.places[run.end]
    start, end = begin.level, finish.level
    sign = 1.0 if end > start else -1.0
    off = begin.off
    if run.begin == 0:
        off = max(off, float(np.abs(surface.vertices[surface.border, 2] - start).max()))
    first, last = start + sign * (CLEAR * off + EXACT), end - sign * (CLEAR * finish.off + EXACT)
    corners = height[surface.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    reached = np.abs(corners - start).max(axis=1) > 0.0
    counts = (high > low) | mine[surface.faces].all(axis=1)
    counts &= reached & (np.abs(corners - end).max(axis=1) > 0.0)
    pauses = terraces.find(
        low[counts], high[counts], area[counts], float(area[reached].sum()), start, end, noise
    )
    pieces = []
    for pause in pauses:
        pieces.append(_wall(start, pause.level, first, pause.first, height))
        start, first = pause.level, pause.last
    pieces.append(_wall(start, end, first, last, height))
    return pieces


def _wall(start: float, end: float, first: float, last: float, height: FloatArray) -> Wall:
    if (last - first) * (end - start) <= 0.0:  # barely higher than the noise at its ends
        first, last = start + 0.4 * (end - start), start + 0.6 * (end - start)
    return Wall(None, start, end, first, last, np.clip(height, min(start, end), max(start, end)))
