"""The order of the job: to the block, cut after cut with ways through the air between them, and away."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.hotwire.straight_cut import Cut
from planner.hotwire.straight_lines import Lines, join
from planner.hotwire.straight_links import AIR_STEP, link
from planner.segments import Segment

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

LEAD: Final = 0.040
"""[m] way in the air before the first cut and behind the last one."""
STRAIGHT_ON: Final = 0.94
"""Least cosine between moves in the air that are passed without a stop."""


@dataclasses.dataclass(frozen=True)
class Route:
    """All wires of the job in order, pointing the same way along the wire all the time.

    ``segment``, ``stop`` (N,) where the motion stops, ``cut`` (N,) index of the cut on whose surface
    a wire is, -1 elsewhere, ``place`` (N,) its number there. ``ends`` {index of a cut: its last target}.
    """

    lines: Lines
    segment: tuple[Segment, ...]
    stop: BoolArray
    cut: IntArray
    place: IntArray
    ends: dict[int, int]


def lay_out(cuts: list[Cut], box: FloatArray, clear: float, half: float, down: FloatArray) -> Route:
    """The route through all cuts; see :func:`planner.hotwire.straight_links.link` for the figures."""
    parts: list[Lines] = []
    segments: list[Segment] = []
    stops: list[int] = []
    owner: list[IntArray] = []
    place: list[IntArray] = []
    ends: dict[int, int] = {}

    def add(segment: Segment, lines: Lines, cut: int = -1, first: int = 0) -> None:
        """Lines of one segment; from number ``first`` on they are on the surface of a cut."""
        parts.append(lines)
        segments.extend([segment] * len(lines))
        on_it = np.arange(len(lines)) >= (first if cut >= 0 else len(lines))
        owner.append(np.where(on_it, cut, -1))
        place.append(np.where(on_it, np.arange(len(lines)) - first, -1))

    for number, cut in enumerate(cuts):
        own = cut.wanted.segment
        into, on, out = cut.into, cut.on.lines, cut.out
        if parts and parts[-1].direction[-1] @ into.direction[0] < 0.0:  # the wire has no front end
            into, on, out = (Lines(x.end, x.start) for x in (into, on, out))
        if not parts:
            add(Segment("approach"), _lead(into, on)[::-1])
            stops.append(0)
        else:
            first = len(segments) - 1
            add(Segment("link"), link(parts[-1][-1:], into[:1], box, clear, half, down))
            stops += (first + _corners(join([parts[-2][-1:], parts[-1]]))).tolist()
        stops.append(len(segments) - 1)
        # the move that reaches the first wire beside the surface still belongs to the way in
        add(own.at("in"), join([into[1:], on[:1]]), number, len(into) - 1)
        add(own, on[1:], number)
        place[-1] += 1
        if cut.turns:
            stops.append(len(segments) + cut.turns - 1)
        add(own.at("out"), out)
        ends[number] = len(segments) - 1
        stops.append(len(segments) - 1)
        last = out
    add(Segment("retreat"), _lead(last.reversed(), last.reversed()[1:])[1:])
    stops.append(len(segments) - 1)
    stop = np.zeros(len(segments), dtype=np.bool_)
    stop[stops] = True
    return Route(join(parts), tuple(segments), stop, np.concatenate(owner), np.concatenate(place), ends)


def _corners(lines: Lines) -> IntArray:
    """Numbers of the lines at which a way in the air turns: there the motion stops, as nothing melts."""
    move = np.diff(np.concatenate([lines.start, lines.end], axis=1), axis=0)
    move /= np.maximum(np.linalg.norm(move, axis=1, keepdims=True), 1e-12)
    return np.flatnonzero(np.sum(move[1:] * move[:-1], axis=1) < STRAIGHT_ON) + 1


def _lead(into: Lines, on: Lines) -> Lines:
    """Wires in the air from the first of ``into``, that one included, straight away from the second."""
    second = into[1:2] if len(into) > 1 else on[:1]
    move = into.start[0] + into.end[0] - second.start[0] - second.end[0]
    way = into.direction[0]
    move = move - (move @ way) * way
    count = max(1, int(np.ceil(LEAD / AIR_STEP)))
    shift = LEAD * np.arange(count + 1)[:, None] / count * move / max(float(np.linalg.norm(move)), 1e-12)
    return Lines(into.start[:1] + shift, into.end[:1] + shift)
