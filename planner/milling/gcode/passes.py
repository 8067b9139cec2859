"""A G-code file as passes of the cutter: what it cuts between its rapid moves, thinned to what the tolerance
asks for.

Rapid moves of the file are left out: between passes the tool goes its own safe way, up along its axis to the
safe plane, straight on it, and down to where the file's last rapid move ended.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from planner.claims import dialogue
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue, TandemError
from planner.milling.gcode import reader
from planner.milling.gcode.rows import Event
from planner.milling.operation import GCodeCut
from planner.milling.tool_path import Run, ToolPath, filled, parted, sharp, thinned

AXIS_LEVER: Final = 0.05
"""A point so far [m] behind the tip stands for the tool's axis."""
CHORD_SHARE: Final = 0.25
"""Share of the tolerance that thinning may take."""
SAME_PLACE: Final = 1e-6
"""Rows nearer to one another than this [m] are one place."""
SAME_FEED_FACTOR: Final = 1.05
"""Feeds that differ by less than this factor are thinned together, at the lowest of them."""
FEED_CHANGE_REACH: Final = 2.0
"""Feeds change within so many tolerances of their place: there are targets so far before and behind it."""


@dataclasses.dataclass(frozen=True)
class Passes:
    """The passes of a file, and its notes."""

    runs: tuple[Run, ...]
    notes: tuple[Issue, ...]


def passes(cut: GCodeCut, step: float, tolerance: float, field: str) -> Passes:
    """The passes of a file; ``step`` [m] is the longest way between places of a pass.

    Raises ``TandemError`` with the codes ``gcode.*``.
    """
    program = reader.read(cut.gcode.dialect(f"{field}.gcode"))
    path = program.path
    cutting = path.cuts
    cutting[0] = False  # the way to the first place is not the file's
    stretches = list(_stretches(cutting))
    file = str(cut.gcode.file)
    if not stretches:
        what = "the file has places but no cuts between them; give the G-code of the job"
        raise TandemError(Issue("gcode.empty", what, file=file, field=field))
    faults = [*_amid(program.events, stretches, file), *_speeds(path, stretches, file)]
    if faults:
        raise TandemError(faults)
    runs: list[Run] = []
    before, since = 0.0, -1
    for number, (first, last) in enumerate(stretches):
        asked = _questions(path, program.events, (first, last), since, before)
        waits = [
            (e.at - 1 - first, e.seconds)
            for e in program.events
            if e.kind == "dwell" and first < e.at - 1 <= last
        ]
        name = f"{cut.name}_{number + 1}"
        run = _run(name, path[first : last + 1], waits, asked, tolerance, step)
        if run is not None:  # else what it asks is asked before the next one
            runs.append(run)
            before, since = float(path.spindle[last]), last
    if not runs:
        what = "no cut of the file goes anywhere; give the G-code of the job"
        raise TandemError(Issue("gcode.empty", what, file=file, field=field))
    return Passes(tuple(runs), program.notes)


def _stretches(cutting: BoolArray) -> Iterator[tuple[int, int]]:
    """First and last row of each stretch of cuts, with the place where it begins."""
    edges = np.flatnonzero(np.diff(cutting.astype(np.int8), append=0))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _amid(events: Sequence[Event], stretches: Sequence[tuple[int, int]], file: str) -> Iterator[Issue]:
    """Pauses with the tool in the stock."""
    for event in events:
        if event.kind == "pause" and any(first < event.at - 1 < last for first, last in stretches):
            what = "M0 or M1 amid a cut: the spindle would stop in the stock; lead the tool off by G0 before"
            yield Issue("gcode.word", what, file=file, line=event.line, field="M0")


def _speeds(path: ToolPath, stretches: Sequence[tuple[int, int]], file: str) -> Iterator[Issue]:
    """Changes of the spindle's speed with the tool in the stock."""
    for first, last in stretches:
        changed = np.flatnonzero(np.diff(path.spindle[first + 1 : last + 1]))
        if len(changed):
            line = int(path.line[first + 2 + changed[0]])
            what = "the spindle's speed changes amid a cut but is set by hand; lead the tool off by G0 before"
            yield Issue("gcode.spindle", what, file=file, line=line, field="S", count=len(changed))
            return


def _questions(
    path: ToolPath,
    events: Sequence[Event],
    stretch: tuple[int, int],
    since: int,
    before: float,
) -> str:
    """What the operator is asked before a pass, with the spindle standing; empty for nothing. The pass
    before ended at row ``since``, at the speed ``before``."""
    first, last = stretch
    pauses = [e.line for e in events if e.kind == "pause" and since < e.at - 1 <= first]
    asked = [dialogue.FILE_LINE.filled(line=line) for line in pauses]
    speed = float(path.spindle[last])
    if speed != before:
        way = dialogue.SPEED if speed > 0 else dialogue.SPEED_BACK
        asked.append(way.filled(rpm=abs(speed) * 30.0 / np.pi))
    return dialogue.GO_ON.filled(asked=", ".join(asked)) if asked else ""


def _run(
    name: str,
    path: ToolPath,
    waits: Sequence[tuple[int, float]],
    asked: str,
    tolerance: float,
    step: float,
) -> Run | None:
    """A pass, thinned; None where it goes nowhere."""
    points = np.stack([path.tip, path.tip + AXIS_LEVER * path.axis], axis=1)
    rows = _kept(points, path.feed, [row for row, _ in waits], CHORD_SHARE * tolerance, step)
    if len(rows) < 2:
        return None
    lowest = np.minimum.reduceat(path.feed, rows[:-1] + 1)
    feed = np.concatenate([lowest[:1], lowest])
    kind = tuple(path.kind[row] for row in rows.tolist())
    thin = ToolPath(
        path.tip[rows], path.axis[rows], feed, kind, path.spindle[rows], path.tool[rows], path.line[rows]
    )
    stops = [(int(np.searchsorted(rows, row)), seconds) for row, seconds in waits]
    change = np.append(np.append(False, _differ(thin.feed[1:-1], thin.feed[2:])), False)
    change &= ~sharp(thin.tip)  # from rest to rest a tool needs no places of its own to change its speed
    by, tip, axis = parted(thin.tip, thin.axis, change, FEED_CHANGE_REACH * tolerance)
    # a long move gets places of its own, or a spin about the tool would have to turn all at once
    to, tip, axis = filled(tip, axis, step)
    to = by[to]
    own = ToolPath(
        tip,
        axis,
        thin.feed[to],
        tuple(kind[row] for row in to.tolist()),
        thin.spindle[to],
        thin.tool[to],
        thin.line[to],
    )
    held = [(int(np.searchsorted(to, min(at, len(rows) - 1), "right")) - 1, s) for at, s in stops]
    return Run(name, own, 0, len(own) - 1, 0.0, before=asked, waits=tuple(held))


def _differ(before: FloatArray, after: FloatArray) -> BoolArray:
    """Whether feeds (N,) are so different that their change counts."""
    return np.maximum(before, after) > SAME_FEED_FACTOR * np.minimum(before, after)


def _kept(points: FloatArray, feed: FloatArray, waits: Sequence[int], chord: float, step: float) -> IntArray:
    """Rows (K,) that are kept of points (N, P, 3): both ends, where feeds change or the tool waits, and as
    many between as the chord error asks for."""
    level = np.floor(np.log(np.maximum(feed[1:], 1e-9)) / np.log(SAME_FEED_FACTOR))
    breaks = np.unique([0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), *waits, len(feed) - 1])
    found = [np.zeros(1, dtype=np.int64)]
    for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
        found.append(first + thinned(points[first : last + 1], chord, step)[1:])
    rows = np.concatenate(found)
    way = np.linalg.norm(np.diff(points[rows], axis=0), axis=2).max(axis=1, initial=0.0)
    return np.asarray(rows[np.concatenate([[True], way > SAME_PLACE])])
