"""What a milling operation comes to: the cutter, its cuts as passes, and the faces that it must spare.

**A G-code file as passes** (`gcode_passes`): what it cuts between its rapid moves, thinned to what
the tolerance asks for. Rapid moves of the file are left out: between passes the tool goes its own
safe way, up along its axis to the safe plane, straight on it, and down to where the file's last
rapid move ended.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from planner.claims.segments import clash
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh
from planner.geometry.face_places import Over
from planner.geometry.polylines import sharp, thinned
from planner.geometry.rulings import tessellate
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.problem import Part, Setup
from planner.processes.milling import sentences as milling_sentences
from planner.processes.milling.plan import cutter_contact as milling_face
from planner.processes.milling.plan import flank_cut, point_cut
from planner.processes.milling.plan.gcode import reader
from planner.processes.milling.plan.gcode.moves import Event
from planner.processes.milling.plan.operation import (
    EngraveCut,
    FlankCut,
    GCodeCut,
    LinesCut,
    Milling,
    cut_name,
)
from planner.processes.milling.plan.tool_path import Run, ToolPath, filled, parted
from planner.tooling import Cutter, Mill

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


def gcode_passes(cut: GCodeCut, step: float, tolerance: float, field: str) -> Passes:
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
        raise refusal("gcode.empty", what, file=file, field=field)
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
        raise refusal("gcode.empty", what, file=file, field=field)
    return Passes(tuple(runs), program.notes)


def _stretches(cutting: BoolArray) -> Iterator[tuple[int, int]]:
    """First and last row of each stretch of cuts, with the place where it begins."""
    edges = np.flatnonzero(np.diff(cutting.astype(np.int8), append=0))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _amid(events: Sequence[Event], stretches: Sequence[tuple[int, int]], file: str) -> Iterator[Issue]:
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
    path: ToolPath, events: Sequence[Event], stretch: tuple[int, int], since: int, before: float
) -> str:
    """What the operator is asked before a pass, with the spindle standing; empty for nothing. The pass
    before ended at row ``since``, at the speed ``before``."""
    first, last = stretch
    pauses = [e.line for e in events if e.kind == "pause" and since < e.at - 1 <= first]
    asked = [milling_sentences.FILE_LINE.filled(line=line) for line in pauses]
    speed = float(path.spindle[last])
    if speed != before:
        way = milling_sentences.SPEED if speed > 0 else milling_sentences.SPEED_BACK
        asked.append(way.filled(rpm=abs(speed) * 30.0 / np.pi))
    return milling_sentences.GO_ON.filled(asked=", ".join(asked)) if asked else ""


def _run(
    name: str, path: ToolPath, waits: Sequence[tuple[int, float]], asked: str, tolerance: float, step: float
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


SURFACE_CHORD: Final = 2e-5
"""[m] the triangles of a wanted ruled surface are as near to it as this."""
LEAST_UPWARD: Final = 0.05
"""Least z of a front's normals: it must look up to be seen from above."""


@dataclasses.dataclass(frozen=True)
class Face:
    """A face of the part, open, with normals away from it."""

    name: str
    mesh: Mesh


@dataclasses.dataclass(frozen=True)
class Done:
    """A cut as passes, the last one of which makes the surface ``face`` (None: it follows curves).

    ``tolerance`` [m]; ``off`` [m], how far the cutter is off the surface at most; ``depth`` [m], how deep it
    goes into the part's front by intent; ``fits`` [m], the radius of a cutter that is not as far off.
    """

    cut: FlankCut | LinesCut | EngraveCut | GCodeCut
    runs: tuple[Run, ...]
    face: Face | None
    tolerance: float
    off: float = 0.0
    depth: float = 0.0
    fits: float | None = None


@dataclasses.dataclass(frozen=True)
class Work:
    """What one operation mills. ``faces``: all faces of the part that the problem knows."""

    operation: Milling
    cutter: Cutter
    cuts: tuple[Done, ...]
    faces: tuple[Face, ...]
    box: FloatArray
    notes: tuple[Issue, ...] = ()

    @property
    def runs(self) -> tuple[Run, ...]:
        """All passes in order."""
        return tuple(run for one in self.cuts for run in one.runs)


def work(op: Milling, setup: Setup, part: Part | None) -> Work:
    """The job, from the problem alone. Raises ``TandemError`` with the codes ``milling.*``, and
    ``problem.duplicate_name``."""
    cutter = _cutter(op, setup)
    box = setup.stock.box
    faults: list[Issue] = []
    notes: list[Issue] = []
    done: list[Done] = []
    over: Over | None = None
    for number, cut in enumerate(op.cuts):
        try:
            if isinstance(cut, GCodeCut):
                made, told = _program(op, cut, f"operations.cuts.{number}")
                done.append(made)
                notes += told
            elif isinstance(cut, FlankCut):
                made, told = _flank(op, cut, part, cutter, box)
                done.append(made)
                notes += told
            else:
                front = _front(part)
                over = over or Over(front.vertices, front.faces)
                made, told = _on_front(op, cut, over, front, cutter)
                done.append(made)
                notes += told
        except TandemError as error:
            faults += error.issues
    if faults:
        raise TandemError(faults)
    whole = Work(op, cutter, tuple(done), _faces(op, part), box, tuple(notes))
    both = clash(run.segment for run in whole.runs)
    if both is not None:
        what = (
            f"{op.name}: two passes would be called {both[0].name!r} and {both[1].name!r}, which programs "
            "cannot tell apart (passes of patterns, files and roughing are numbered); rename one of the cuts"
        )
        raise refusal("problem.duplicate_name", what, field="operations.cuts")
    return whole


def _cutter(op: Milling, setup: Setup) -> Cutter:
    tool = setup.cell.arm(op.arms[0]).tool
    if not isinstance(tool, Mill):
        what = f"arm {op.arms[0]} carries the tool {tool.name}, which has no cutter; give it a tool of kind "
        what += "mill"
        raise refusal("milling.tool", what, field="cell.arms", arm=op.arms[0])
    return tool.cutter


def _flank(
    op: Milling, cut: FlankCut, part: Part | None, cutter: Cutter, box: FloatArray
) -> tuple[Done, tuple[Issue, ...]]:
    ruled = flank_cut.surface(part, cut.flank)
    made = flank_cut.passes(op, cut, ruled, cutter, box)
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    face = None if cut.guides == "tool" else Face(cut.flank, tessellate(ruled, SURFACE_CHORD))
    return Done(cut, made.runs, face, tolerance, made.off, fits=made.fits), made.notes


def _program(op: Milling, cut: GCodeCut, field: str) -> tuple[Done, tuple[Issue, ...]]:
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    read = gcode_passes(cut, op.step_mm * MM, tolerance, field)
    return Done(cut, read.runs, None, tolerance), read.notes


def _on_front(
    op: Milling, cut: LinesCut | EngraveCut, over: Over, front: Mesh, cutter: Cutter
) -> tuple[Done, tuple[Issue, ...]]:
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    if isinstance(cut, LinesCut):
        # what the margin leaves out is not made, so it is not wanted either
        area = milling_face.inner(front, cut.margin_mm * MM) if cut.margin_mm else None
        if cutter.kind == "ball":
            left = milling_face.unreached(front, cutter.radius, tolerance, area)
            if left is not None:
                raise TandemError(milling_face.unreached_issue(cut_name(cut), left, cutter.radius, tolerance))
        runs = tuple(point_cut.line_runs(op, cut, over, cutter, area))
        mesh = front if area is None else milling_face.clipped(front, area)
        return Done(cut, runs, Face("front", mesh), tolerance), ()
    engraved, notes = point_cut.engraved_runs(op, cut, over, cutter)
    return Done(cut, tuple(engraved), None, tolerance, depth=cut.depth_mm * MM), tuple(notes)


def _front(part: Part | None) -> Mesh:
    if part is None or part.front is None:
        what = "cuts: lines and engraving need a front of the part; give part.front"
        raise refusal("milling.no_surface", what, field="operations.cuts")
    corners = part.front.vertices[part.front.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = cross[:, 2] / np.maximum(np.linalg.norm(cross, axis=1), 1e-30)
    worst = int(np.argmin(up))
    if float(up[worst]) < LEAST_UPWARD:
        lean = float(np.rad2deg(np.arccos(np.clip(up, -1.0, 1.0)))[worst])
        most = float(np.rad2deg(np.arccos(LEAST_UPWARD)))
        if float(up.max()) < -LEAST_UPWARD:
            what = "all of the part's front looks down in the block and cannot be milled from above"
            hint = "where only its faces are turned round, change flip (part.front.loft or part.front.mesh: "
            hint += "flip: true unless it stands there), else turn the part over in the block (in_stock)"
        else:
            at = ", ".join(f"{v / MM:.1f}" for v in corners[worst].mean(axis=0))
            what = f"the part's front leans {lean:.1f} degrees off the block's top at {at} mm, where it "
            what += f"cannot be milled from above; allowed: {most:.1f}"
            hint = "turn the part in the block (in_stock: rpy_deg), or leave that place out of the front"
        raise refusal("milling.front", what, field="part.front", **measurement(lean, most, "deg"), hint=hint)
    return part.front


def _faces(op: Milling, part: Part | None) -> tuple[Face, ...]:
    """Ruled surfaces but those that only lead a tool, front and back."""
    if part is None:
        return ()
    led = {cut.flank for cut in op.cuts if isinstance(cut, FlankCut) and cut.guides == "tool"}
    out = [Face(own.name, tessellate(own, SURFACE_CHORD)) for own in part.ruled if own.name not in led]
    sides: Sequence[tuple[str, Mesh | None]] = (("front", part.front), ("back", part.back))
    out += [Face(name, mesh) for name, mesh in sides if mesh is not None]
    return tuple(out)
