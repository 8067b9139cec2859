"""Claims on milling that name a G-code file or curves, worked out as ways and feeds of segments.

- G-code, by the proof's own reader: its passes as ways and feeds, the ways between them, and what
  the operator is asked before each.
- Engraving, from the drawn curves and the part's face alone: each curve projected along z onto the
  face, as deep as wanted, with the axis as the problem says.
- Ways of a cutter from the safe plane to a pass and back, by the problem's numbers: straight along
  its own axis.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planner.claims import sentences
from planner.claims.claim import Claim, FeedWindow
from planner.claims.dialogue import DialogueStep, DialogueStop, OperatorDialogue, question_step
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.processes.milling import sentences as milling_sentences
from planner.processes.milling.claims import MILL, Engraves, MillsAlong, MillsProgram, SafeWays, SparesPart
from planner.processes.milling.proof import gcode_moves
from planner.processes.milling.proof.gcode_lines import UnreadableError
from planner.processes.milling.proof.gcode_moves import Way
from planner.proof.part_files.drawn_curves import (
    CORNERED_KINDS,
    MILLIMETRE,
    NotThereError,
    each_curve,
    points,
)
from planner.proof.part_files.plan_face import Laid, Places
from planner.tooling import Cutter

LEAST_PLUNGE = 2e-3
"""Least way [m] down to a pass and up from it."""


def down(
    safe: SafeWays,
    segment: Segment,
    arm: str,
    tip: FloatArray,
    axis: FloatArray,
    tolerance: float,
    turn: float,
) -> MillsAlong:
    """The way from the safe plane to where a pass begins, with ``tip`` and ``axis`` (3,)."""
    tips, feed = np.stack([above(safe, tip, axis), tip]), np.full(2, safe.plunge)
    return MillsAlong(segment.at("in"), arm, tips, np.stack([axis, axis]), feed, tolerance, turn)


def up(
    safe: SafeWays,
    segment: Segment,
    arm: str,
    tip: FloatArray,
    axis: FloatArray,
    tolerance: float,
    turn: float,
) -> MillsAlong:
    """The way back to the safe plane from where a pass ends."""
    tips, feed = np.stack([tip, above(safe, tip, axis)]), np.full(2, safe.rapid)
    return MillsAlong(segment.at("out"), arm, tips, np.stack([axis, axis]), feed, tolerance, turn)


def above(safe: SafeWays, tip: FloatArray, axis: FloatArray) -> FloatArray:
    """The place (3,) at which a tool with its tip at ``tip`` (3,) is on the safe plane when it is drawn back
    along its axis; a little way back where that is beyond the plane already."""
    rise = safe.up * float(axis[safe.across])
    gap = safe.up * (safe.level - float(tip[safe.across]))
    return np.asarray(tip + max(gap / max(rise, 1e-6), LEAST_PLUNGE) * axis)


ARC_CHORD_SHARE = 0.05
"""Arcs are parted within this share of the tolerance, or as the problem says where that is less."""
SAME_PLACE = 1e-6
"""A stretch whose places are all so near to its first one [m] is no pass."""
PASS_LEVER = 0.05
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
    chord = min(program.file.chord_tol_mm * 1e-3, ARC_CHORD_SHARE * program.tolerance)
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
        spoken = [milling_sentences.FILE_LINE.filled(line=line) for line in pauses]
        own = float(way.spindle[last])
        if own != speed:
            spoken.append(
                (milling_sentences.SPEED if own > 0.0 else milling_sentences.SPEED_BACK).filled(rpm=abs(own))
            )
        question = milling_sentences.GO_ON.filled(asked=", ".join(spoken)) if spoken else ""
        rows = slice(first, last + 1)
        if _extent(way, rows) > SAME_PLACE:
            out.append(Pass(number, _part(way, rows), question))
            speed, before = own, last
    return tuple(out)


def _extent(way: Way, rows: slice) -> float:
    """How far [m] a stretch goes from its first place, by the tip or the lever."""
    tip, far = way.tip[rows], way.tip[rows] + PASS_LEVER * way.axis[rows]
    return float(max(np.linalg.norm(own - own[0], axis=1).max() for own in (tip, far)))


def _dwell(way: Way) -> float:
    """The longest wait [s] at one place; places that are no farther apart than ``SAME_PLACE`` are one."""
    moved = np.linalg.norm(np.diff(way.tip, axis=0), axis=1) > SAME_PLACE
    moved |= np.linalg.norm(np.diff(way.axis, axis=0), axis=1) > SAME_PLACE
    stretch = np.concatenate([[0], np.cumsum(moved)])
    waited = np.zeros(stretch[-1] + 1)
    for seconds, at in way.waits:
        waited[stretch[at - 1]] += seconds
    return float(waited.max())


def _part(way: Way, rows: slice) -> Way:
    tip, axis, feed, cuts = way.tip[rows], way.axis[rows], way.feed[rows], way.cuts[rows]
    waits = tuple((seconds, at - rows.start) for seconds, at in way.waits if rows.start < at <= rows.stop)
    return Way(tip, axis, feed, cuts, way.spindle[rows], way.line[rows], (), waits)


def program_dialogue(
    claim: OperatorDialogue, programs: Sequence[MillsProgram], known: Mapping[str, tuple[Pass, ...]]
) -> OperatorDialogue:
    """The dialogue with what files ask: before the very first pass together with what is asked in any case,
    before others on the safe plane with the spindle standing; and with their waits."""
    first, stops = claim.first, list[DialogueStop]()
    off, on = claim.last[:2], claim.first[-2:]
    for program in programs:
        for number, one in enumerate(known[program.name]):
            segment = Segment(MILL, f"{program.name}_{one.number}")
            question = question_step(sentences.PLAIN, text=one.question)
            if one.question and program.first and number == 0:
                first = (*first[:1], question, *first[1:])
            elif one.question:
                stops.append(DialogueStop(segment.at("in"), "before", (*off, question, *on)))
            for place, seconds in one.waits:
                wait = (DialogueStep("wait", seconds=seconds),)
                stops.append(DialogueStop(segment, "in", wait, place, program.tolerance))
    return dataclasses.replace(claim, first=first, stops=tuple(stops))


def program_segments(program: MillsProgram, own: Pass) -> Iterator[Claim]:
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


CURVE_SPACING = 0.25e-3
"""Distance [m] of the places at which a curve is laid on the face; what a tool leans along is the chord
between the two beside a place."""
UPRIGHT_ANGLE = 1e-3
"""A flat end that leans off the normal by less than this [rad] touches with its middle."""


def engraved_segments(claim: Engraves) -> Iterator[Claim]:
    """The ways and feeds of all curves. Raises ``NotThereError``."""
    claim = dataclasses.replace(
        claim, curves=each_curve(claim.curves), axis_curves=each_curve(claim.axis_curves)
    )
    if claim.axis == "curves" and len(claim.axis_curves) != len(claim.curves):
        raise NotThereError(f"{len(claim.axis_curves)} axis curves for {len(claim.curves)} curves")
    face = Laid(claim.vertices, claim.faces)
    for number, drawn in enumerate(claim.curves, 1):
        segment, safe = Segment(MILL, f"{claim.name}_c{number}"), claim.safe
        yield FeedWindow(segment.at("in"), 0.0, max(claim.feed, safe.plunge))
        yield FeedWindow(segment, 0.0, claim.feed)
        yield FeedWindow(segment.at("out"), 0.0, max(claim.feed, safe.rapid))
        curve, either = points(drawn)
        ways = _ways(claim, face, number - 1, curve)
        backs = _ways(claim, face, number - 1, curve[::-1]) if either else (None,) * len(ways)
        yield from (dataclasses.replace(way, back=back) for way, back in zip(ways, backs, strict=True))


def _ways(claim: Engraves, face: Laid, number: int, curve: FloatArray) -> tuple[MillsAlong, ...]:
    """The way along a curve (K, 3) [m], down to it and up from it."""
    tip, axis = tool_along(claim, face, number, curve)
    segment = Segment(MILL, f"{claim.name}_c{number + 1}"), claim.arm
    bounds = claim.tolerance, claim.turn
    return (
        MillsAlong(*segment, tip, axis, np.full(len(tip), claim.feed), *bounds),
        down(claim.safe, *segment, tip[0], axis[0], *bounds),
        up(claim.safe, *segment, tip[-1], axis[-1], *bounds),
    )


def tool_along(claim: Engraves, face: Laid, number: int, curve: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tips and axes (N, 3) along a curve (K, 3) [m]. Raises ``NotThereError``."""
    corners = claim.curves[number].kind in CORNERED_KINDS
    laid = face.at(evenly(curve, corners)[:, :2])
    if not np.isfinite(laid.point).all():
        at = evenly(curve, corners)[int(np.argmin(np.isfinite(laid.point[:, 2])))] / MILLIMETRE
        raise NotThereError(f"curve {number + 1} is not over the face at {at[0]:.1f}, {at[1]:.1f} mm")
    axis = _axis(claim, number, laid)
    contact = laid.point - claim.depth * laid.normal
    return tip_at(contact, laid.normal, axis, claim.cutter), axis


def evenly(curve: FloatArray, corners: bool) -> FloatArray:
    """Places (N, 3) along a curve, ``CURVE_SPACING`` apart at most, its corners among them where it has "
    "some."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    count = max(int(np.ceil(way[-1] / CURVE_SPACING)), 2)
    at = way[-1] * np.arange(count + 1) / count
    at = np.union1d(at, way) if corners else at
    return np.stack([np.interp(at, way, curve[:, k]) for k in range(3)], axis=1)


def tip_at(contact: FloatArray, normal: FloatArray, axis: FloatArray, cutter: Cutter) -> FloatArray:
    """Tips (N, 3) of a cutter that touches a plane with ``normal`` (N, 3) at ``contact`` (N, 3): from the
    contact to the middle of the round edge's tube, in to the middle of the edge, and down the axis."""
    out = normal - (normal * axis).sum(axis=1, keepdims=True) * axis
    size = np.linalg.norm(out, axis=1, keepdims=True)
    inward = np.where(size > UPRIGHT_ANGLE, out / np.maximum(size, 1e-12), 0.0)
    tube = contact + cutter.corner * normal
    return np.asarray(tube + (cutter.radius - cutter.corner) * inward - cutter.corner * axis)


def _axis(claim: Engraves, number: int, laid: Places) -> FloatArray:
    """Axes (N, 3) from the tip to the spindle."""
    count = len(laid.point)
    if claim.axis == "upright":
        return np.tile([0.0, 0.0, 1.0], (count, 1))
    if claim.axis == "curves":
        drawn = claim.axis_curves[number]
        curve, either = points(drawn)
        there = [np.linalg.norm(laid.point[[0, -1]] - row[[0, -1]]) for row in (curve, curve[::-1])]
        other = evenly(curve[::-1] if either and there[1] < there[0] else curve, drawn.kind in CORNERED_KINDS)
        shares = [_shares(row) for row in (laid.point, other)]
        at = np.stack([np.interp(shares[0], shares[1], other[:, k]) for k in range(3)], axis=1)
        return _unit(at - laid.point)
    before, behind = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
    chord = laid.point[behind] - laid.point[before]
    ahead = _unit(chord - (chord * laid.normal).sum(axis=1, keepdims=True) * laid.normal)
    left = np.cross(laid.normal, ahead)
    return _unit(laid.normal + np.tan(claim.lead) * ahead + np.tan(claim.tilt) * left)


def _shares(row: FloatArray) -> FloatArray:
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(row, axis=0), axis=1)))
    return np.asarray(way / way[-1])


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


MILL_PATH = "verify.mill_path"
"""Code of the rule that these ways belong to."""
Claims = Mapping[str, tuple[Claim, ...]]


def worked_out(claims: Claims) -> tuple[Claims, tuple[Issue, ...]]:
    """The claims by operation, those on G-code files and on curves put as ways and feeds of segments; and
    what could not be read."""
    issues: list[Issue] = []
    out = {name: tuple(_group(group, issues)) for name, group in claims.items()}
    return out, tuple(issues)


def _group(group: tuple[Claim, ...], issues: list[Issue]) -> Iterator[Claim]:
    programs = [claim for claim in group if isinstance(claim, MillsProgram)]
    known = {program.name: _passes(program, issues) for program in programs}
    for claim in group:
        if isinstance(claim, MillsProgram):
            for own in known[claim.name]:
                yield from program_segments(claim, own)
        elif isinstance(claim, Engraves):
            try:
                yield from engraved_segments(claim)
            except NotThereError as error:
                what = f"{claim.name}: {error}; the planner has it otherwise, report this"
                issues.append(Issue(MILL_PATH, what, field=claim.name))
        elif isinstance(claim, SparesPart) and known:
            yield dataclasses.replace(claim, segments=tuple(_each(claim.segments, known)))
        elif isinstance(claim, OperatorDialogue) and known:
            yield program_dialogue(claim, programs, known)
        else:
            yield claim


def _each(segments: tuple[Segment, ...], known: Mapping[str, tuple[Pass, ...]]) -> Iterator[Segment]:
    """The segments, a file's passes for the name of that file's cut."""
    for segment in segments:
        if segment.name in known:
            yield from (Segment(segment.kind, f"{segment.name}_{one.number}") for one in known[segment.name])
        else:
            yield segment


def _passes(program: MillsProgram, issues: list[Issue]) -> tuple[Pass, ...]:
    """The passes of a file; none where it cannot be read, which is an issue."""
    try:
        return passes(program)
    except UnreadableError as error:
        path = str(program.file.path)
        where = f"{path}, line {error.line}" if error.line else path
        what = f"{where}: the proof's own reader of G-code cannot read it: {error}; correct the file"
        issues.append(Issue(MILL_PATH, what, file=path, line=error.line or None))
        return ()
