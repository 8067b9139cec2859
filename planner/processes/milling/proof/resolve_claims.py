"""Resolves claims on milling that name a G-code file or curves, to paths and feeds of segments.

- G-code, by the proof's own reader: its passes as paths and feeds, the moves between them, and the question
  to the operator before each pass.
- Engraving, from the drawn curves and the part's face alone: each curve is projected along z onto the face.
  The path has the required depth and the axis that the problem states.
- Moves of a cutter from the safe plane to a pass and back, by the problem's values: straight along its own
  axis.
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
from planner.processes.milling.claims import (
    MILL,
    Engraves,
    MillsAlong,
    MillsOver,
    MillsProgram,
    SafeMoves,
    SparesPart,
)
from planner.processes.milling.proof import gcode_moves
from planner.processes.milling.proof.gcode_lines import UnreadableError
from planner.processes.milling.proof.gcode_moves import ProgrammedPath
from planner.proof.part_files.drawn_curves import (
    CORNERED_KINDS,
    MILLIMETRE_M,
    CurveReadError,
    curve_points,
    explode_drawings,
)
from planner.proof.part_files.plan_face import PlanFace, PlanFacePoints
from planner.tooling import Cutter

MIN_PLUNGE_M = 2e-3
"""Minimum length [m] of the moves down to a pass and up from it."""


CutterPassClaim = MillsProgram | Engraves | MillsOver
"""Claim on passes, with their arm, safe moves and tolerances."""


def plunge_claim(claim: CutterPassClaim, segment: Segment, tip: FloatArray, axis: FloatArray) -> MillsAlong:
    """Return the claim on the move from the safe plane to the start of a pass.

    Args:
        claim: Claim on the pass.
        segment: Segment of the pass.
        tip: Tip at the start (3,) [m].
        axis: Axis there (3,).
    """
    safe = claim.safe
    tips, feed = np.stack([safe_point(safe, tip, axis), tip]), np.full(2, safe.plunge)
    axes = np.stack([axis, axis])
    return MillsAlong(segment.at("in"), claim.arm, tips, axes, feed, claim.tolerance, claim.turn)


def retreat_claim(claim: CutterPassClaim, segment: Segment, tip: FloatArray, axis: FloatArray) -> MillsAlong:
    """Return the claim on the move from the end of a pass back to the safe plane.

    Args:
        claim: Claim on the pass.
        segment: Segment of the pass.
        tip: Tip at the end (3,) [m].
        axis: Axis there (3,).
    """
    safe = claim.safe
    tips, feed = np.stack([tip, safe_point(safe, tip, axis)]), np.full(2, safe.rapid)
    axes = np.stack([axis, axis])
    return MillsAlong(segment.at("out"), claim.arm, tips, axes, feed, claim.tolerance, claim.turn)


def safe_point(safe: SafeMoves, tip: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the point (3,) at which a tool that is retracted along its axis reaches the safe plane.

    If the tool is beyond the plane already, it is retracted by a short distance.

    Args:
        safe: Safe plane.
        tip: Tip (3,) [m].
        axis: Axis (3,).
    """
    rise = safe.free_side * float(axis[safe.normal_axis])
    height = safe.free_side * (safe.level - float(tip[safe.normal_axis]))
    return np.asarray(tip + max(height / max(rise, 1e-6), MIN_PLUNGE_M) * axis)


ARC_CHORD_FRACTION = 0.05
"""Chord error of arcs as a fraction of the tolerance. The problem's value is used if it is smaller."""
POINT_TOLERANCE_M = 1e-6
"""Distance [m] from the first position within which a stretch of cuts does not count as a pass."""
PASS_LEVER_M = 0.05
"""Distance behind the tip [m] of the point that represents the axis."""


@dataclasses.dataclass(frozen=True)
class ProgramPass:
    """A stretch of cuts between rapid moves.

    Attributes:
        number: Number of the pass, from 1.
        path: Positions of the pass, and its waits.
        question: Question to the operator before the pass, "" if there is none.
    """

    number: int
    path: ProgrammedPath
    question: str

    @property
    def waits(self) -> tuple[tuple[FloatArray, float], ...]:
        """Position (3,) [m] and duration [s] of each wait after the first position of the pass."""
        return tuple((self.path.tip[at - 1], seconds) for seconds, at in self.path.waits if at > 1)


def program_passes(program: MillsProgram) -> tuple[ProgramPass, ...]:
    """Return the passes of a file in order.

    Args:
        program: Claim on the file.

    Raises:
        UnreadableError: The file cannot be read.
    """
    chord = min(program.file.chord_tol_mm * 1e-3, ARC_CHORD_FRACTION * program.tolerance)
    path = gcode_moves.read_path(program.file, chord)
    cutting = path.cuts.copy()
    cutting[0] = False  # the move to the first position is not part of the file
    changes = np.diff(np.concatenate([[0], cutting.astype(np.int8), [0]]))
    out: list[ProgramPass] = []
    speed, previous_row = 0.0, -1
    for number, (first, last) in enumerate(
        zip(
            (np.flatnonzero(changes > 0) - 1).tolist(),
            (np.flatnonzero(changes < 0) - 1).tolist(),
            strict=True,
        ),
        1,
    ):
        # a pause happens at the position before_count - 1: after the previous pass, and up to the start of
        # this one
        pauses = [line for line, before_count in path.pauses if previous_row < before_count - 1 <= first]
        parts = [milling_sentences.FILE_LINE.format(line=line) for line in pauses]
        pass_speed = float(path.spindle[last])
        if pass_speed != speed:
            parts.append(
                (
                    milling_sentences.SPEED if pass_speed > 0.0 else milling_sentences.SPEED_COUNTERCLOCKWISE
                ).format(rpm=abs(pass_speed))
            )
        question = milling_sentences.CONTINUE.format(asked=", ".join(parts)) if parts else ""
        rows = slice(first, last + 1)
        if _extent(path, rows) > POINT_TOLERANCE_M:
            out.append(ProgramPass(number, _path_slice(path, rows), question))
            speed, previous_row = pass_speed, last
    return tuple(out)


def _extent(path: ProgrammedPath, rows: slice) -> float:
    """Return how far [m] a stretch gets from its first position: the larger value of tip and lever point.

    The lever point is `PASS_LEVER_M` behind the tip, so that a rotation in place counts, too.
    """
    tip, lever_point = path.tip[rows], path.tip[rows] + PASS_LEVER_M * path.axis[rows]
    return float(max(np.linalg.norm(points - points[0], axis=1).max() for points in (tip, lever_point)))


def _longest_wait(path: ProgrammedPath) -> float:
    """Return the longest wait [s] at one position. Successive waits within ``POINT_TOLERANCE_M`` add up."""
    moved = np.linalg.norm(np.diff(path.tip, axis=0), axis=1) > POINT_TOLERANCE_M
    moved |= np.linalg.norm(np.diff(path.axis, axis=0), axis=1) > POINT_TOLERANCE_M
    stretch = np.concatenate([[0], np.cumsum(moved)])
    durations = np.zeros(stretch[-1] + 1)
    for seconds, at in path.waits:
        durations[stretch[at - 1]] += seconds  # a wait happens at the position at - 1
    return float(durations.max())


def _path_slice(path: ProgrammedPath, rows: slice) -> ProgrammedPath:
    """Return the positions ``rows`` of a path with the waits at them, without pauses."""
    tip, axis, feed, cuts = path.tip[rows], path.axis[rows], path.feed[rows], path.cuts[rows]
    waits = tuple((seconds, at - rows.start) for seconds, at in path.waits if rows.start < at <= rows.stop)
    return ProgrammedPath(tip, axis, feed, cuts, path.spindle[rows], path.line[rows], (), waits)


def program_dialogue(
    claim: OperatorDialogue, programs: Sequence[MillsProgram], known: Mapping[str, tuple[ProgramPass, ...]]
) -> OperatorDialogue:
    """Return the dialogue of an operation, completed by questions and waits from the passes of its files.

    The question before the first pass of the operation is asked at its start. The others are asked on the
    safe plane with the spindle stopped.

    Args:
        claim: Dialogue of the operation without its files.
        programs: Claims on files, in order.
        known: Passes by name of the program.
    """
    first, stops = claim.first, list[DialogueStop]()
    switch_off, switch_on = claim.last[:2], claim.first[-2:]
    for program in programs:
        for number, program_pass in enumerate(known[program.name]):
            segment = Segment(MILL, f"{program.name}_{program_pass.number}")
            question = question_step(sentences.PLAIN, text=program_pass.question)
            if program_pass.question and program.is_first and number == 0:
                first = (*first[:1], question, *first[1:])
            elif program_pass.question:
                stops.append(DialogueStop(segment.at("in"), "before", (*switch_off, question, *switch_on)))
            for point, seconds in program_pass.waits:
                wait = (DialogueStep("wait", seconds=seconds),)
                stops.append(DialogueStop(segment, "in", wait, point, program.tolerance))
    return dataclasses.replace(claim, first=first, stops=tuple(stops))


def pass_claims(program: MillsProgram, program_pass: ProgramPass) -> Iterator[Claim]:
    """Yield the claims on path and feeds of one pass and of the moves to and from it.

    Args:
        program: Claim on the file.
        program_pass: Pass.
    """
    path, safe = program_pass.path, program.safe
    segment = Segment(MILL, f"{program.name}_{program_pass.number}")
    feed = np.concatenate([path.feed[1:2], path.feed[1:]])
    fastest = float(feed.max())
    yield FeedWindow(segment.at("in"), 0.0, max(fastest, safe.plunge))
    yield FeedWindow(segment, 0.0, fastest)
    yield FeedWindow(segment.at("out"), 0.0, max(fastest, safe.rapid))
    file, bounds = program.file.path.name, (program.tolerance, program.turn)
    yield MillsAlong(
        segment, program.arm, path.tip, path.axis, feed, *bounds, file, path.line, _longest_wait(path)
    )
    yield plunge_claim(program, segment, path.tip[0], path.axis[0])
    yield retreat_claim(program, segment, path.tip[-1], path.axis[-1])


CURVE_SPACING_M = 0.25e-3
"""Distance [m] of the points at which a curve is projected onto the face.

The feed direction at a point is the chord between its neighbours.
"""
UPRIGHT_ANGLE_RAD = 1e-3
"""Angle to the normal [rad] below which a flat end touches with its centre."""


def engraving_claims(claim: Engraves) -> Iterator[Claim]:
    """Yield the claims on paths and feeds of all curves.

    Args:
        claim: Claim on the engraving.

    Raises:
        CurveReadError: A curve is missing, cannot be read, or is not over the face.
    """
    claim = dataclasses.replace(
        claim, curves=explode_drawings(claim.curves), axis_curves=explode_drawings(claim.axis_curves)
    )
    if claim.axis == "curves" and len(claim.axis_curves) != len(claim.curves):
        raise CurveReadError(f"{len(claim.axis_curves)} axis curves for {len(claim.curves)} curves")
    face = PlanFace(claim.vertices, claim.faces)
    for number, drawn in enumerate(claim.curves, 1):
        segment, safe = Segment(MILL, f"{claim.name}_c{number}"), claim.safe
        yield FeedWindow(segment.at("in"), 0.0, max(claim.feed, safe.plunge))
        yield FeedWindow(segment, 0.0, claim.feed)
        yield FeedWindow(segment.at("out"), 0.0, max(claim.feed, safe.rapid))
        curve, is_reversible = curve_points(drawn)
        path_claims = _curve_claims(claim, face, number - 1, curve)
        reverse_claims = (
            _curve_claims(claim, face, number - 1, curve[::-1])
            if is_reversible
            else (None,) * len(path_claims)
        )
        yield from (
            dataclasses.replace(claim_forward, back=back)
            for claim_forward, back in zip(path_claims, reverse_claims, strict=True)
        )


def _curve_claims(claim: Engraves, face: PlanFace, number: int, curve: FloatArray) -> tuple[MillsAlong, ...]:
    """Return the claims on three paths: along a curve, down to its start, and up from its end.

    Args:
        claim: Claim on the engraving.
        face: Face of the part.
        number: Index of the curve in the claim.
        curve: Points of the curve (K, 3) [m], in the direction of milling.
    """
    tip, axis = engraving_tool(claim, face, number, curve)
    segment, feed = Segment(MILL, f"{claim.name}_c{number + 1}"), np.full(len(tip), claim.feed)
    return (
        MillsAlong(segment, claim.arm, tip, axis, feed, claim.tolerance, claim.turn),
        plunge_claim(claim, segment, tip[0], axis[0]),
        retreat_claim(claim, segment, tip[-1], axis[-1]),
    )


def engraving_tool(
    claim: Engraves, face: PlanFace, number: int, curve: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return tips (N, 3) [m] and axes (N, 3) along a curve.

    Args:
        claim: Claim on the engraving.
        face: Face of the part.
        number: Index of the curve in the claim.
        curve: Points of the curve (K, 3) [m].

    Raises:
        CurveReadError: The curve is not over the face, or its axis curve cannot be read.
    """
    corners = claim.curves[number].kind in CORNERED_KINDS
    projected = face.points_over(resample_curve(curve, corners)[:, :2])
    if not np.isfinite(projected.point).all():
        off_face_mm = (
            resample_curve(curve, corners)[int(np.argmin(np.isfinite(projected.point[:, 2])))] / MILLIMETRE_M
        )
        raise CurveReadError(
            f"curve {number + 1} is not over the face at {off_face_mm[0]:.1f}, {off_face_mm[1]:.1f} mm"
        )
    axis = _tool_axes(claim, number, projected)
    contact = projected.point - claim.depth * projected.normal
    return tool_tips(contact, projected.normal, axis, claim.cutter), axis


def resample_curve(curve: FloatArray, corners: bool) -> FloatArray:
    """Return points (N, 3) along a curve, at most ``CURVE_SPACING_M`` apart.

    Args:
        curve: Points of the curve (K, 3) [m].
        corners: Whether its vertices are kept.
    """
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))
    count = max(int(np.ceil(lengths[-1] / CURVE_SPACING_M)), 2)
    positions = lengths[-1] * np.arange(count + 1) / count
    positions = np.union1d(positions, lengths) if corners else positions
    return np.stack([np.interp(positions, lengths, curve[:, k]) for k in range(3)], axis=1)


def tool_tips(contact: FloatArray, normal: FloatArray, axis: FloatArray, cutter: Cutter) -> FloatArray:
    """Return the tips (N, 3) [m] of a cutter that touches planes.

    The rounded edge of the cutter is a tube about a circle. Three vectors lead from the contact to the tip:
    along the normal to the centre of the tube, inwards to the axis, and down the axis.

    Args:
        contact: Contact points (N, 3) [m].
        normal: Unit normals (N, 3).
        axis: Axes (N, 3).
        cutter: Cutter.
    """
    lateral = normal - (normal * axis).sum(axis=1, keepdims=True) * axis
    size = np.linalg.norm(lateral, axis=1, keepdims=True)
    inward = np.where(size > UPRIGHT_ANGLE_RAD, lateral / np.maximum(size, 1e-12), 0.0)
    tube_centre = contact + cutter.corner * normal
    return np.asarray(tube_centre + (cutter.radius - cutter.corner) * inward - cutter.corner * axis)


def _tool_axes(claim: Engraves, number: int, projected: PlanFacePoints) -> FloatArray:
    """Return tool axes (N, 3), to the spindle, at projected points of the curve with index ``number``."""
    count = len(projected.point)
    if claim.axis == "upright":
        return np.tile([0.0, 0.0, 1.0], (count, 1))
    if claim.axis == "curves":
        drawn = claim.axis_curves[number]
        curve, is_reversible = curve_points(drawn)
        start_distances = [
            np.linalg.norm(projected.point[[0, -1]] - row[[0, -1]]) for row in (curve, curve[::-1])
        ]
        axis_curve = resample_curve(
            curve[::-1] if is_reversible and start_distances[1] < start_distances[0] else curve,
            drawn.kind in CORNERED_KINDS,
        )
        fractions = [_length_fractions(row) for row in (projected.point, axis_curve)]
        axis_points = np.stack(
            [np.interp(fractions[0], fractions[1], axis_curve[:, k]) for k in range(3)], axis=1
        )
        return _unit(axis_points - projected.point)
    previous, following = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
    chord = projected.point[following] - projected.point[previous]
    feed_direction = _unit(chord - (chord * projected.normal).sum(axis=1, keepdims=True) * projected.normal)
    left = np.cross(projected.normal, feed_direction)
    return _unit(projected.normal + np.tan(claim.lead) * feed_direction + np.tan(claim.tilt) * left)


def _length_fractions(points: FloatArray) -> FloatArray:
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.asarray(lengths / lengths[-1])


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


MILL_PATH = "verify.mill_path"
"""Code of the rule on the paths of cutters."""
Claims = Mapping[str, tuple[Claim, ...]]
"""Claims by the name of their operation."""


def resolve_claims(claims: Claims) -> tuple[Claims, tuple[Issue, ...]]:
    """Resolve claims on G-code files and on curves to paths and feeds of segments.

    Args:
        claims: Claims by operation.

    Returns:
        The resolved claims, and issues about files and curves that cannot be read.
    """
    issues: list[Issue] = []
    out = {name: tuple(_resolve_group(group, issues)) for name, group in claims.items()}
    return out, tuple(issues)


def _resolve_group(group: tuple[Claim, ...], issues: list[Issue]) -> Iterator[Claim]:
    """Yield the claims of an operation, with those on files and curves resolved.

    Issues about files and curves that cannot be read are added to ``issues``.
    """
    programs = [claim for claim in group if isinstance(claim, MillsProgram)]
    passes_by_program = {program.name: _readable_passes(program, issues) for program in programs}
    for claim in group:
        if isinstance(claim, MillsProgram):
            for program_pass in passes_by_program[claim.name]:
                yield from pass_claims(claim, program_pass)
        elif isinstance(claim, Engraves):
            try:
                yield from engraving_claims(claim)
            except CurveReadError as error:
                message = f"{claim.name}: {error}. The planner found it otherwise; report this as a defect"
                issues.append(Issue(MILL_PATH, message, field=claim.name))
        elif isinstance(claim, SparesPart) and passes_by_program:
            yield dataclasses.replace(
                claim, segments=tuple(_expand_segments(claim.segments, passes_by_program))
            )
        elif isinstance(claim, OperatorDialogue) and passes_by_program:
            yield program_dialogue(claim, programs, passes_by_program)
        else:
            yield claim


def _expand_segments(
    segments: tuple[Segment, ...], passes_by_program: Mapping[str, tuple[ProgramPass, ...]]
) -> Iterator[Segment]:
    """Yield the segments, each that stands for a file replaced by those of the file's passes."""
    for segment in segments:
        if segment.name in passes_by_program:
            yield from (
                Segment(segment.kind, f"{segment.name}_{program_pass.number}")
                for program_pass in passes_by_program[segment.name]
            )
        else:
            yield segment


def _readable_passes(program: MillsProgram, issues: list[Issue]) -> tuple[ProgramPass, ...]:
    """Return the passes of a file. If it cannot be read, return none, and add an issue to ``issues``."""
    try:
        return program_passes(program)
    except UnreadableError as error:
        path = str(program.file.path)
        where = f"{path}, line {error.line}" if error.line else path
        message = f"{where}: the proof's G-code reader cannot read it: {error}; correct the file"
        issues.append(Issue(MILL_PATH, message, file=path, line=error.line or None))
        return ()
