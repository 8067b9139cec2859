"""The process `trim`: from closed curves on a formed sheet to targets of one arm's torch, mill or knife, and
claims.

See `face` (curves laid on the face, slots beside them), `slots` (ways in and out, micro-joints),
`stretches` (a knife's cuts), `cutting` (what cuts), `check` (what would go wrong), `route` (the way through
all slots), `route_targets` (targets of it), `pace` (how fast), `claims`, `shown`.

**Poses**: a torch's TCP is the place that is cut, a mill's and a knife's its tip, as far behind that as it
goes through the sheet; z is the tool's axis, which points into the sheet, x of a knife the way it cuts.
Motion may spin the tool, and lean it about the place that is cut within its cone where that keeps it clear
of the sheet; a knife it may spin a little, as it stands along its curve and square to the sheet.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, aggregate, has_errors, refusal
from planner.problem import Formed, Hole
from planner.processes.forming.plan.features.tree import LEAST_BUMP, build
from planner.processes.forming.plan.stages import formed_sheet, shown
from planner.processes.trim.plan import check
from planner.processes.trim.plan.claims import claims
from planner.processes.trim.plan.cutting import Cutting, Trimmer, cutting, mounted
from planner.processes.trim.plan.face import Face, lay
from planner.processes.trim.plan.operation import Trim, every_outline, outline_notes
from planner.processes.trim.plan.pace import too_slow
from planner.processes.trim.plan.route import route
from planner.processes.trim.plan.route_targets import targets_of
from planner.processes.trim.plan.slots import Slot, Wanted, slots
from planner.processes.trim.plan.stretches import stretches
from planner.reading import sheet as sheet_file
from planner.targets import Job, Targets

FEATURE_STEP: Final = 0.5 * MM
"""Distance of the slices of features [m]; what each one moves does not hang on it."""


class TrimJob(Job[Trim]):
    """An operation that trims, with the torch and the sheet that it finds."""

    @functools.cached_property
    def tool(self) -> Trimmer:
        """The tool of the arm. Raises ``TandemError`` (trim.tool)."""
        return mounted(self.operation, self.setup.cell.arm(self.operation.arms[0]).tool)

    @functools.cached_property
    def cutting(self) -> Cutting:
        """How it cuts. Raises ``TandemError`` (trim.tool)."""
        return cutting(self.operation, self.tool, float(self.setup.stock.size[2]))

    @functools.cached_property
    def face(self) -> Face:
        """The face that the torch follows. Raises ``TandemError`` (trim.no_sheet) and issues of files."""
        thickness = float(self.setup.stock.size[2])
        return Face(self.formed, thickness, 1 if self.operation.side == "top" else -1)

    @functools.cached_property
    def surface(self) -> Formed:
        """What the file has of the face, and how far it may be off. Raises as :attr:`face`."""
        op, stock, part = self.operation, self.setup.stock, self.part
        if not isinstance(op.surface, str):
            place = None if op.surface.frame == "find" else np.eye(4)
            part = sheet_file.build(op.surface, Path(), stock, place)
        if stock.sheet is None or part is None or part.formed is None:
            what = f"{op.name}: there is no formed sheet; give sheet: and a part of kind sheet_mesh"
            raise refusal("trim.no_sheet", what, field="sheet")
        return part.formed

    @functools.cached_property
    def formed(self) -> Mesh:
        """The lower face of the sheet as it is trimmed. Raises as :attr:`face`."""
        mesh, sheet = self.surface.mesh, self.setup.stock.sheet
        stages = None if sheet is None else sheet.stages
        if isinstance(self.operation.surface, str) and stages is not None and stages.after:
            tree = build(mesh, FEATURE_STEP, max(LEAST_BUMP, self.surface.tolerance))
            done = {number for _, some in stages.before for number in some or ()}
            known = sorted(done.intersection(one.id for one in tree.features))
            mesh = formed_sheet(mesh, tree, known)
        return mesh

    @functools.cached_property
    def wanted(self) -> tuple[Wanted, ...]:
        """The outlines in the order of cutting: those that lie in most others first."""
        found = []
        for one, points in every_outline(self.operation):
            laid = lay(one.name, points, self.face)
            found.append(Wanted(one, laid, shapely.Polygon(laid.point[:, :2])))
        inside = [
            sum(
                shapely.contains_properly(o.area.buffer(0), shapely.Point(w.laid.point[0, :2])) for o in found
            )
            for w in found
        ]
        return tuple(found[k] for k in sorted(range(len(found)), key=lambda k: -inside[k]))

    def targets(self) -> Targets:
        """Targets of the operation; raises ``TandemError`` with the codes ``trim.*``."""
        op, tool, wanted = self.operation, self.cutting, self.wanted
        sheet = self.setup.stock.sheet
        if sheet is None:
            raise refusal("trim.no_sheet", f"{op.name}: there is no sheet to trim", field="sheet")
        if tool.through and sheet.die:
            what = f"{op.name}: there is a die behind the sheet, into which the {tool.word} would go"
            hint = "take the die out, and trim by a problem of its own (surface:), or by a torch or laser"
            raise refusal("trim.die", what, field="operations.die", hint=hint)
        reach = tool.kerf + op.lead.length_mm * MM if tool.blade is None else tool.blade.width
        issues = list(check.curve_issues(wanted, sheet.opening, reach, op.shape_tol_mm * MM))
        if issues:
            raise TandemError(aggregate(issues))
        made: list[Slot] = []
        for one in wanted:
            try:
                if tool.blade is not None:
                    made += stretches(op, one, self.face, tool)
                    continue
                made += slots(op, one, [o for o in wanted if o is not one], self.face, tool.kerf)
            except TandemError as error:
                issues += error.issues
        if issues:
            raise TandemError(aggregate(issues))
        way, issues = route(op, self.setup, self.face, tool, made, wanted, self.surface.tolerance)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        free = [w for w in wanted if not w.spec.joints]  # what hangs by joints stays
        cut = [Hole(w.spec.name, w.laid.point[:, :2], w.spec.drops == "inside") for w in free]
        drawn = sheet.stages is not None and not self.brief
        left = shown(self.formed, (*sheet.holes, *cut), op.name) if drawn else {}
        found = targets_of(op, self.setup, self.tool, tool, made, wanted, way, self.claims(), left)
        return found if self.brief else dataclasses.replace(found, issues=tuple(outline_notes(op)))

    def driven(
        self, targets: Targets, time: FloatArray, passed: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """Slots in which the arm is slower on average than the operation allows."""
        if passed is not None:
            time = np.interp(np.arange(targets.count), *passed)
        return too_slow(self.operation, self.cutting, targets, time)

    def stated(self) -> tuple[Claim, ...]:
        """What must hold of the job, from the problem alone."""
        _ = self.cutting  # a cutter that does not go through is told before all else
        return claims(self.operation, self.setup, self.tool, self._rough())

    def _rough(self) -> float:
        """How far [m] the face may be off; 0 where there is none, which :meth:`targets` tells."""
        try:
            return self.surface.tolerance
        except TandemError:
            return 0.0
