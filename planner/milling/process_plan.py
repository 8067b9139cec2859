"""What a milling operation comes to: the cutter, its cuts as passes, and the faces that it must spare."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.claims.segments import clash
from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.rulings import tessellate
from planner.issues import Issue, TandemError
from planner.milling import face as milling_face
from planner.milling import flank_cut, point_cut
from planner.milling.face import Over
from planner.milling.gcode import passes
from planner.milling.operation import EngraveCut, FlankCut, GCodeCut, LinesCut, Milling, cut_name
from planner.milling.tool_path import Run
from planner.problem import Part, Setup
from planner.tooling import Cutter, Mill
from planner.units import MM

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
                done.append(_on_front(op, cut, over, front, cutter))
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
        raise TandemError(Issue("problem.duplicate_name", what, field="operations.cuts"))
    return whole


def _cutter(op: Milling, setup: Setup) -> Cutter:
    tool = setup.cell.arm(op.arms[0]).tool
    if not isinstance(tool, Mill):
        raise TandemError(
            Issue(
                "milling.tool",
                f"arm {op.arms[0]} carries the tool {tool.name}, which has no cutter; give it a "
                f"tool of kind mill",
                field="cell.arms",
                arm=op.arms[0],
            )
        )
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
    read = passes.passes(cut, op.step_mm * MM, tolerance, field)
    return Done(cut, read.runs, None, tolerance), read.notes


def _on_front(op: Milling, cut: LinesCut | EngraveCut, over: Over, front: Mesh, cutter: Cutter) -> Done:
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
        return Done(cut, runs, Face("front", mesh), tolerance)
    return Done(
        cut, tuple(point_cut.engraved_runs(op, cut, over, cutter)), None, tolerance, depth=cut.depth_mm * MM
    )


def _front(part: Part | None) -> Mesh:
    if part is None or part.front is None:
        raise TandemError(
            Issue(
                "milling.no_surface",
                "cuts: lines and engraving need a front of the part; give part.front",
                field="operations.cuts",
            )
        )
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
            what = (
                f"the part's front leans {lean:.1f} degrees off the block's top at {at} mm, where it cannot "
            )
            what += f"be milled from above; allowed: {most:.1f}"
            hint = "turn the part in the block (in_stock: rpy_deg), or leave that place out of the front"
        raise TandemError(
            Issue(
                "milling.front",
                what,
                field="part.front",
                value=lean,
                limit=most,
                unit="deg",
                hint=hint,
            )
        )
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
