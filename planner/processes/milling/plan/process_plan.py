"""Result of planning a milling operation: the cutter, its cuts as passes, and the faces that it must spare.

**A G-code file as passes** (`plan_gcode_passes`): its cuts between rapid moves, with as few targets as the
tolerance allows. The file's rapid moves are left out. Between passes the tool moves on a safe path: up along
its axis to the safe plane, straight on it, and down to the start of the next cut, where the file's rapid move
ends.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from planner.claims.segments import first_clash
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh
from planner.geometry.face_from_above import FaceFromAbove
from planner.geometry.polylines import stop_flags, thin_rows
from planner.geometry.rulings import tessellate
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Part, Setup
from planner.processes.milling import sentences as milling_sentences
from planner.processes.milling.plan import cutter_contact, flank_cut, point_cut
from planner.processes.milling.plan.gcode import reader
from planner.processes.milling.plan.gcode.moves import GCodeEvent
from planner.processes.milling.plan.operation import (
    EngraveCut,
    FlankCut,
    GCodeCut,
    LinesCut,
    Milling,
    cut_name,
)
from planner.processes.milling.plan.tool_path import CutterPass, ToolPath, insert_near_changes, subdivide_path
from planner.tooling import Cutter, Mill

AXIS_LEVER_M: Final = 0.05
"""Distance behind the tip [m] of the point that represents the tool's axis."""
CHORD_FRACTION: Final = 0.25
"""Fraction of the tolerance that the removal of positions may use."""
POINT_TOLERANCE_M: Final = 1e-6
"""Distance [m] up to which positions count as equal."""
FEED_TOLERANCE_FACTOR: Final = 1.05
"""Ratio of feeds up to which a stretch counts as of one feed. It then gets its lowest feed."""
FEED_CHANGE_FACTOR: Final = 2.0
"""Distance from a change of feed within which the feed changes, as a factor of the tolerance.

Targets are added at this distance on both sides.
"""


@dataclasses.dataclass(frozen=True)
class GCodePasses:
    """Passes of a G-code file, and its notes."""

    passes: tuple[CutterPass, ...]
    notes: tuple[Issue, ...]


def plan_gcode_passes(cut: GCodeCut, step: float, tolerance: float, field: str) -> GCodePasses:
    """Plan the passes of a G-code file.

    Args:
        cut: Cut by a file.
        step: Maximum distance [m] between targets of a pass.
        tolerance: Allowed deviation [m].
        field: Field of the cut in the problem file, for messages.

    Raises:
        TandemError: Codes ``gcode.*``.
    """
    program = reader.read_gcode(cut.gcode.dialect(f"{field}.gcode"))
    path = program.path
    cutting = path.cuts
    cutting[0] = False  # the move to the first position is not part of the file
    stretches = list(_stretches(cutting))
    file = str(cut.gcode.file)
    if not stretches:
        message = "the file has positions but no cuts between them; give the G-code of the job"
        raise issue_error("gcode.empty", message, file=file, field=field)
    faults = [*_pause_issues(program.events, stretches, file), *_speed_issues(path, stretches, file)]
    if faults:
        raise TandemError(faults)
    runs: list[CutterPass] = []
    speed, last_row = 0.0, -1
    for number, (first, last) in enumerate(stretches):
        question = _operator_question(path, program.events, (first, last), last_row, speed)
        # an event happens at the position event.row - 1; waits at the start of a stretch are left out
        waits = [
            (event.row - 1 - first, event.seconds)
            for event in program.events
            if event.kind == "dwell" and first < event.row - 1 <= last
        ]
        name = f"{cut.name}_{number + 1}"
        run = _build_pass(name, path[first : last + 1], waits, question, tolerance, step)
        if run is not None:  # otherwise its questions are asked before the next pass
            runs.append(run)
            speed, last_row = float(path.spindle[last]), last
    if not runs:
        message = "no cut of the file moves the tool; give the G-code of the job"
        raise issue_error("gcode.empty", message, file=file, field=field)
    return GCodePasses(tuple(runs), program.notes)


def _stretches(cutting: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each stretch of cuts.

    ``cutting`` (N,) tells for each position whether the move to it cuts. The first index is the position
    before the first cut, where the stretch starts.
    """
    edges = np.flatnonzero(np.diff(cutting.astype(np.int8), append=0))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _pause_issues(
    events: Sequence[GCodeEvent], stretches: Sequence[tuple[int, int]], file: str
) -> Iterator[Issue]:
    """Yield issues about pauses for the operator inside a stretch of cuts, its ends excluded.

    An event happens at the position with the index ``event.row - 1``.
    """
    for event in events:
        if event.kind == "pause" and any(first < event.row - 1 < last for first, last in stretches):
            message = (
                "M0 or M1 inside a cut would stop the spindle in the stock; retract the tool by G0 before"
            )
            yield Issue("gcode.word", message, file=file, line=event.line, field="M0")


def _speed_issues(path: ToolPath, stretches: Sequence[tuple[int, int]], file: str) -> Iterator[Issue]:
    """Yield an issue about the first cut in which the spindle's speed changes."""
    for first, last in stretches:
        changed = np.flatnonzero(np.diff(path.spindle[first + 1 : last + 1]))
        if len(changed):
            line = int(path.line[first + 2 + changed[0]])
            message = (
                "the spindle speed changes inside a cut but is set by hand; retract the tool by G0 before"
            )
            yield Issue("gcode.spindle", message, file=file, line=line, field="S", count=len(changed))
            return


def _operator_question(
    path: ToolPath,
    events: Sequence[GCodeEvent],
    stretch: tuple[int, int],
    previous_row: int,
    previous_speed: float,
) -> str:
    """Return the question to the operator before a pass, with the spindle stopped, "" if there is none.

    ``stretch`` has the first and last index of the pass. The previous pass ended at ``previous_row`` (-1:
    none) with the spindle speed ``previous_speed`` [rad/s].
    """
    first, last = stretch
    pauses = [
        event.line for event in events if event.kind == "pause" and previous_row < event.row - 1 <= first
    ]
    parts = [milling_sentences.FILE_LINE.format(line=line) for line in pauses]
    speed = float(path.spindle[last])
    if speed != previous_speed:
        sentence = milling_sentences.SPEED if speed > 0 else milling_sentences.SPEED_COUNTERCLOCKWISE
        parts.append(sentence.format(rpm=abs(speed) * 30.0 / np.pi))  # rad/s to 1/min
    return milling_sentences.CONTINUE.format(asked=", ".join(parts)) if parts else ""


def _build_pass(
    name: str,
    path: ToolPath,
    waits: Sequence[tuple[int, float]],
    question: str,
    tolerance: float,
    step: float,
) -> CutterPass | None:
    """Return a pass with as few targets as the tolerance allows, None if the tool does not move in it.

    Targets are added near changes of the feed, so that the controller changes the speed close to them.

    Args:
        name: Name of the pass.
        path: Positions of the cuts, from the one where the pass starts.
        waits: Index in ``path`` and duration [s] of each wait.
        question: Question to the operator before the pass, or "".
        tolerance: Allowed deviation [m].
        step: Maximum distance between targets [m].
    """
    points = np.stack([path.tip, path.tip + AXIS_LEVER_M * path.axis], axis=1)
    rows = _kept_rows(points, path.feed, [row for row, _ in waits], CHORD_FRACTION * tolerance, step)
    if len(rows) < 2:
        return None
    lowest = np.minimum.reduceat(path.feed, rows[:-1] + 1)
    feed = np.concatenate([lowest[:1], lowest])
    kind = tuple(path.kind[row] for row in rows.tolist())
    thinned_path = ToolPath(
        path.tip[rows], path.axis[rows], feed, kind, path.spindle[rows], path.tool[rows], path.line[rows]
    )
    # indices: rows into ``path``, stops into ``thinned_path``, target_rows from ``subdivided`` to
    # ``thinned_path``
    stops = [(int(np.searchsorted(rows, row)), seconds) for row, seconds in waits]
    change = np.append(np.append(False, _feeds_differ(thinned_path.feed[1:-1], thinned_path.feed[2:])), False)
    change &= ~stop_flags(thinned_path.tip)  # at a stop the feed can change without additional targets
    source_rows, tip, axis = insert_near_changes(
        thinned_path.tip, thinned_path.axis, change, FEED_CHANGE_FACTOR * tolerance
    )
    # Long moves are subdivided, because otherwise the tool would spin far within one move.
    target_rows, tip, axis = subdivide_path(tip, axis, step)
    target_rows = source_rows[target_rows]
    subdivided = ToolPath(
        tip,
        axis,
        thinned_path.feed[target_rows],
        tuple(kind[row] for row in target_rows.tolist()),
        thinned_path.spindle[target_rows],
        thinned_path.tool[target_rows],
        thinned_path.line[target_rows],
    )
    pass_waits = [
        (int(np.searchsorted(target_rows, min(row, len(rows) - 1), "right")) - 1, seconds)
        for row, seconds in stops
    ]
    return CutterPass(
        name, subdivided, 0, len(subdivided) - 1, 0.0, question=question, waits=tuple(pass_waits)
    )


def _feeds_differ(previous: FloatArray, following: FloatArray) -> BoolArray:
    """Return whether feeds (N,) before and after positions differ by more than `FEED_TOLERANCE_FACTOR`."""
    return np.maximum(previous, following) > FEED_TOLERANCE_FACTOR * np.minimum(previous, following)


def _kept_rows(
    points: FloatArray, feed: FloatArray, waits: Sequence[int], chord: float, step: float
) -> IntArray:
    """Return the indices (K,) of the positions that a pass keeps, of points (N, P, 3) of the tool.

    They are both ends, changes of feed, waits, and as many positions between them as the chord error
    ``chord`` [m] and the distance ``step`` [m] require.
    """
    # level: feeds within one factor count as equal; feed[0] is not used by any move
    level = np.floor(np.log(np.maximum(feed[1:], 1e-9)) / np.log(FEED_TOLERANCE_FACTOR))
    breaks = np.unique([0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), *waits, len(feed) - 1])
    parts = [np.zeros(1, dtype=np.int64)]
    for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
        parts.append(first + thin_rows(points[first : last + 1], chord, step)[1:])
    rows = np.concatenate(parts)
    lengths = np.linalg.norm(np.diff(points[rows], axis=0), axis=2).max(axis=1, initial=0.0)
    return np.asarray(rows[np.concatenate([[True], lengths > POINT_TOLERANCE_M])])


SURFACE_CHORD_M: Final = 2e-5
"""Chord error of the triangles of a required ruled surface [m]."""
MIN_UPWARD_Z: Final = 0.05
"""Minimum z component of a front's unit normals, because the front is milled from above."""


@dataclasses.dataclass(frozen=True)
class PartFace:
    """An open face of the part, with normals away from the part."""

    name: str
    mesh: Mesh


@dataclasses.dataclass(frozen=True)
class PlannedCut:
    """A cut as passes.

    Attributes:
        cut: Cut of the problem file.
        passes: Passes in order. Of a flank cut, the last one produces the surface ``face``.
        face: Surface that is produced, None if the cut follows curves.
        tolerance: Allowed deviation [m].
        deviation: Largest deviation of the cutter from the surface [m].
        engraving_depth: Intended depth in the part's front [m].
        fitting_radius: Radius [m] of a cutter that fits if the deviation is too large, None if it is not too
            large or if no cutter fits.
    """

    cut: FlankCut | LinesCut | EngraveCut | GCodeCut
    passes: tuple[CutterPass, ...]
    face: PartFace | None
    tolerance: float
    deviation: float = 0.0
    engraving_depth: float = 0.0
    fitting_radius: float | None = None


@dataclasses.dataclass(frozen=True)
class MillingPlan:
    """Plan of one milling operation: its cuts as passes.

    Attributes:
        operation: The operation.
        cutter: Cutter of its arm.
        cuts: Cuts in order.
        faces: All faces of the part that the tool must not enter.
        box: Block (2, 3) [m].
        notes: Notes and warnings.
    """

    operation: Milling
    cutter: Cutter
    cuts: tuple[PlannedCut, ...]
    faces: tuple[PartFace, ...]
    box: FloatArray
    notes: tuple[Issue, ...] = ()

    @property
    def passes(self) -> tuple[CutterPass, ...]:
        """All passes in order."""
        return tuple(run for planned in self.cuts for run in planned.passes)


def plan_milling(op: Milling, setup: Setup, part: Part | None) -> MillingPlan:
    """Plan the cuts of an operation, from the problem alone.

    Args:
        op: Operation.
        setup: Cell and stock as the operation finds them.
        part: Part, if the problem has one.

    Raises:
        TandemError: Codes ``milling.*``, and ``problem.duplicate_name``.
    """
    cutter = _find_cutter(op, setup)
    box = setup.stock.box
    faults: list[Issue] = []
    notes: list[Issue] = []
    cuts: list[PlannedCut] = []
    face: FaceFromAbove | None = None
    for number, cut in enumerate(op.cuts):
        try:
            if isinstance(cut, GCodeCut):
                planned, cut_notes = _plan_program(op, cut, f"operations.cuts.{number}")
                cuts.append(planned)
                notes += cut_notes
            elif isinstance(cut, FlankCut):
                planned, cut_notes = _plan_flank(op, cut, part, cutter, box)
                cuts.append(planned)
                notes += cut_notes
            else:
                front = _checked_front(part)
                face = face or FaceFromAbove(front.vertices, front.faces)
                planned, cut_notes = _plan_on_front(op, cut, face, front, cutter)
                cuts.append(planned)
                notes += cut_notes
        except TandemError as error:
            faults += error.issues
    if faults:
        raise TandemError(faults)
    plan = MillingPlan(op, cutter, tuple(cuts), _part_faces(op, part), box, tuple(notes))
    same_name = first_clash(run.segment for run in plan.passes)
    if same_name is not None:
        message = (
            f"{op.name}: two passes would be called {same_name[0].name!r} and {same_name[1].name!r}, which "
            "programs cannot distinguish (passes of patterns, files and roughing are numbered); rename one "
            "of the cuts"
        )
        raise issue_error("problem.duplicate_name", message, field="operations.cuts")
    return plan


def _find_cutter(op: Milling, setup: Setup) -> Cutter:
    """Return the cutter of the operation's arm; an arm with another tool is refused."""
    tool = setup.cell.arm(op.arms[0]).tool
    if not isinstance(tool, Mill):
        message = (
            f"arm {op.arms[0]} carries the tool {tool.name}, which has no cutter; give it a tool of kind "
        )
        message += "mill"
        raise issue_error("milling.tool", message, field="cell.arms", arm=op.arms[0])
    return tool.cutter


def _plan_flank(
    op: Milling, cut: FlankCut, part: Part | None, cutter: Cutter, box: FloatArray
) -> tuple[PlannedCut, tuple[Issue, ...]]:
    """Return a flank cut as passes, and its notes."""
    ruled = flank_cut.find_ruled_surface(part, cut.flank)
    planned = flank_cut.plan_passes(op, cut, ruled, cutter, box)
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    face = None if cut.guides == "tool" else PartFace(cut.flank, tessellate(ruled, SURFACE_CHORD_M))
    return PlannedCut(
        cut, planned.passes, face, tolerance, planned.deviation, fitting_radius=planned.fitting_radius
    ), planned.notes


def _plan_program(op: Milling, cut: GCodeCut, field: str) -> tuple[PlannedCut, tuple[Issue, ...]]:
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    read = plan_gcode_passes(cut, op.step_mm * MM, tolerance, field)
    return PlannedCut(cut, read.passes, None, tolerance), read.notes


def _plan_on_front(
    op: Milling, cut: LinesCut | EngraveCut, face: FaceFromAbove, front: Mesh, cutter: Cutter
) -> tuple[PlannedCut, tuple[Issue, ...]]:
    """Return lines over the front, or an engraving of it, as passes, and the notes."""
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    if isinstance(cut, LinesCut):
        # The strip within the margin is not milled, so it is not required either.
        area = cutter_contact.inner_area(front, cut.margin_mm * MM) if cut.margin_mm else None
        if cutter.kind == "ball":
            region = cutter_contact.find_unreached_region(front, cutter.radius, tolerance, area)
            if region is not None:
                raise TandemError(
                    cutter_contact.unreached_issue(cut_name(cut), region, cutter.radius, tolerance)
                )
        runs = tuple(point_cut.plan_lines(op, cut, face, cutter, area))
        mesh = front if area is None else cutter_contact.clip_face(front, area)
        return PlannedCut(cut, runs, PartFace("front", mesh), tolerance), ()
    engraved, notes = point_cut.plan_engraving(op, cut, face, cutter)
    return PlannedCut(cut, tuple(engraved), None, tolerance, engraving_depth=cut.depth_mm * MM), tuple(notes)


def _checked_front(part: Part | None) -> Mesh:
    """Return the front of a part, after checking that there is one and that it faces upwards."""
    if part is None or part.front is None:
        message = "cuts: lines and engraving need a front of the part; give part.front"
        raise issue_error("milling.no_surface", message, field="operations.cuts")
    corners = part.front.vertices[part.front.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = cross[:, 2] / np.maximum(np.linalg.norm(cross, axis=1), 1e-30)
    worst_index = int(np.argmin(up))
    if float(up[worst_index]) < MIN_UPWARD_Z:
        tilt_deg = float(np.rad2deg(np.arccos(np.clip(up, -1.0, 1.0)))[worst_index])
        max_tilt_deg = float(np.rad2deg(np.arccos(MIN_UPWARD_Z)))
        if float(up.max()) < -MIN_UPWARD_Z:
            message = "all of the part's front faces down in the block and cannot be milled from above"
            hint = "if only its normals are inverted, change flip (part.front.loft or part.front.mesh: "
            hint += "flip: true unless it is set already), else turn the part over in the block (in_stock)"
        else:
            centre_text = ", ".join(f"{v / MM:.1f}" for v in corners[worst_index].mean(axis=0))
            message = (
                f"the part's front is tilted {tilt_deg:.1f} degrees from the block's top at {centre_text} mm "
                "and "
            )
            message += f"cannot be milled from above there, allowed {max_tilt_deg:.1f}"
            hint = "rotate the part in the block (in_stock: rpy_deg), or exclude that region from the front"
        raise issue_error(
            "milling.front",
            message,
            field="part.front",
            **measurement(tilt_deg, max_tilt_deg, "deg"),
            hint=hint,
        )
    return part.front


def _part_faces(op: Milling, part: Part | None) -> tuple[PartFace, ...]:
    """Return the part's front, back and ruled surfaces, except those whose guides only lead a tool."""
    if part is None:
        return ()
    guide_names = {cut.flank for cut in op.cuts if isinstance(cut, FlankCut) and cut.guides == "tool"}
    out = [
        PartFace(ruled.name, tessellate(ruled, SURFACE_CHORD_M))
        for ruled in part.ruled
        if ruled.name not in guide_names
    ]
    sides: Sequence[tuple[str, Mesh | None]] = (("front", part.front), ("back", part.back))
    out += [PartFace(name, mesh) for name, mesh in sides if mesh is not None]
    return tuple(out)
