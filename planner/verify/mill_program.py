"""What a G-code file asks of a tool, worked out by the proof's own reader: its passes as ways and feeds, the
ways between them, and what the operator is asked before each."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planner import dialogue
from planner.claims import Claim, FeedWindow
from planner.claims_dialogue import DialogueStep, DialogueStop, OperatorDialogue, asked
from planner.claims_milling import MillsAlong, MillsProgram
from planner.segments import Segment
from planner.verify import gcode_moves
from planner.verify.gcode_moves import Way
from planner.verify.mill_ways import down, up
from planner.verify.setups import MILL

FloatArray = NDArray[np.float64]

CHORD = 0.05
"""Arcs are parted within this share of the tolerance, or as the problem says where that is less."""
STILL = 1e-6
"""A stretch whose places are all so near to its first one [m] is no pass."""
LEVER = 0.05
"""A point so far [m] behind the tip stands for the axis."""


@dataclasses.dataclass(frozen=True)
class Pass:
    """A stretch of cuts between rapid moves: its number from 1, its places with its waits, and the question
    before it."""

    number: int
    way: Way
    question: str

    @property
    def waits(self) -> tuple[tuple[FloatArray, float], ...]:
        """Where (3,) [m] and how long [s] the tool waits behind its first place."""
        return tuple((self.way.tip[at - 1], seconds) for seconds, at in self.way.waits if at > 1)


def passes(program: MillsProgram) -> tuple[Pass, ...]:
    """The passes of a file in order. Raises ``UnreadableError``."""
    chord = min(program.file.chord_tol_mm * 1e-3, CHORD * program.tolerance)
    way = gcode_moves.read(program.file, chord)
    cutting = way.cuts.copy()
    cutting[0] = False  # where the tool is before the file's first place is not the file's
    edge = np.diff(np.concatenate([[0], cutting.astype(np.int8), [0]]))
    out: list[Pass] = []
    speed, before = 0.0, -1
    for number, (first, last) in enumerate(
        zip((np.flatnonzero(edge > 0) - 1).tolist(), (np.flatnonzero(edge < 0) - 1).tolist(), strict=True), 1
    ):
        pauses = [line for line, at in way.pauses if before < at - 1 <= first]
        spoken = [dialogue.FILE_LINE.say(line=line) for line in pauses]
        own = float(way.spindle[last])
        if own != speed:
            spoken.append((dialogue.SPEED if own > 0.0 else dialogue.SPEED_BACK).say(rpm=abs(own)))
        question = dialogue.GO_ON.say(asked=", ".join(spoken)) if spoken else ""
        rows = slice(first, last + 1)
        if _extent(way, rows) > STILL:
            out.append(Pass(number, _part(way, rows), question))
            speed, before = own, last
    return tuple(out)


def _extent(way: Way, rows: slice) -> float:
    """How far [m] a stretch goes from its first place, by the tip or the lever."""
    tip, far = way.tip[rows], way.tip[rows] + LEVER * way.axis[rows]
    return float(max(np.linalg.norm(own - own[0], axis=1).max() for own in (tip, far)))


def _dwell(way: Way) -> float:
    """The longest wait [s] at one place; places that are no farther apart than ``STILL`` are one."""
    moved = np.linalg.norm(np.diff(way.tip, axis=0), axis=1) > STILL
    moved |= np.linalg.norm(np.diff(way.axis, axis=0), axis=1) > STILL
    stretch = np.concatenate([[0], np.cumsum(moved)])
    waited = np.zeros(stretch[-1] + 1)
    for seconds, at in way.waits:
        waited[stretch[at - 1]] += seconds
    return float(waited.max())


def _part(way: Way, rows: slice) -> Way:
    tip, axis, feed, cuts = way.tip[rows], way.axis[rows], way.feed[rows], way.cuts[rows]
    waits = tuple((seconds, at - rows.start) for seconds, at in way.waits if rows.start < at <= rows.stop)
    return Way(tip, axis, feed, cuts, way.spindle[rows], way.line[rows], (), waits)


def spoken(
    claim: OperatorDialogue, programs: Sequence[MillsProgram], known: Mapping[str, tuple[Pass, ...]]
) -> OperatorDialogue:
    """The dialogue with what files ask: before the very first pass together with what is asked in any case,
    before others on the safe plane with the spindle standing; and with their waits."""
    first, stops = claim.first, list[DialogueStop]()
    off, on = claim.last[:2], claim.first[-2:]
    for program in programs:
        for number, one in enumerate(known[program.name]):
            segment = Segment(MILL, f"{program.name}_{one.number}")
            question = asked(dialogue.PLAIN, text=one.question)
            if one.question and program.first and number == 0:
                first = (*first[:1], question, *first[1:])
            elif one.question:
                stops.append(DialogueStop(segment.at("in"), "before", (*off, question, *on)))
            for place, seconds in one.waits:
                wait = (DialogueStep("wait", seconds=seconds),)
                stops.append(DialogueStop(segment, "in", wait, place, program.tolerance))
    return dataclasses.replace(claim, first=first, stops=tuple(stops))


def segments(program: MillsProgram, own: Pass) -> Iterator[Claim]:
    """The ways and feeds of one pass and of its ways in and out."""
    way, safe = own.way, program.safe
    segment = Segment(MILL, f"{program.name}_{own.number}")
    feed = np.concatenate([way.feed[1:2], way.feed[1:]])
    fastest = float(feed.max())
    yield FeedWindow(segment.at("in"), 0.0, max(fastest, safe.plunge))
    yield FeedWindow(segment, 0.0, fastest)
    yield FeedWindow(segment.at("out"), 0.0, max(fastest, safe.rapid))
    file, bounds = program.file.path.name, (program.tolerance, program.turn)
    yield MillsAlong(segment, program.arm, way.tip, way.axis, feed, *bounds, file, way.line, _dwell(way))
    yield down(safe, segment, program.arm, way.tip[0], way.axis[0], *bounds)
    yield up(safe, segment, program.arm, way.tip[-1], way.axis[-1], *bounds)
