"""The process ``trim``: from closed curves on a formed sheet to targets of one arm's tool, and claims.

The tool is a torch, a mill or a knife. See `face` (curves on the face, offset slots), `slots` (leads,
micro-joints), `stretches` (cuts of a knife), `cutting` (tools), `check` (checks before motion planning),
`route` (path through all slots), `route_targets` (its targets), `feed_check` (feeds), `claims` and
`exhibits`.

**Poses**: the TCP of a torch is the point that is cut. That of a mill or knife is its tip, as deep behind
that point as it goes through the sheet. z is the tool's axis, which points into the sheet; x of a knife is
its cutting direction. Motion planning may spin a tool. It may tilt it about the point that is cut, within its
cone, where the tool stays clear of the sheet. A knife may only spin a little, because it is aligned with its
curve and normal to the sheet.
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
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, aggregate, has_errors, issue_error
from planner.problem import FormedPart, SheetHole
from planner.processes.forming.plan.features.tree import MIN_BUMP_HEIGHT_M, build_feature_tree
from planner.processes.forming.plan.stages import formed_sheet, sheet_exhibit
from planner.processes.trim.plan import check
from planner.processes.trim.plan.claims import trim_claims
from planner.processes.trim.plan.cutting import CuttingTool, TrimTool, cutting_tool, mounted_tool
from planner.processes.trim.plan.face import SheetFace, project_curve
from planner.processes.trim.plan.feed_check import slow_issues
from planner.processes.trim.plan.operation import Trim, every_outline, outline_notes
from planner.processes.trim.plan.route import plan_route
from planner.processes.trim.plan.route_targets import build_targets
from planner.processes.trim.plan.slots import PlannedOutline, Slot, SlotPlan, plan_slots
from planner.processes.trim.plan.stretches import plan_stretches
from planner.reading import sheet as sheet_file
from planner.targets import Job, Targets

FEATURE_STEP: Final = 0.5 * MM
"""Distance of the slices of features [m]. The shape of the features does not depend on it."""


class TrimJob(Job[Trim]):
    """Job of an operation that trims, with its tool and the sheet as the operation finds it."""

    @functools.cached_property
    def tool(self) -> TrimTool:
        """The tool of the arm.

        Raises:
            TandemError: ``trim.tool`` if it does not cut as the operation states.
        """
        return mounted_tool(self.operation, self.setup.cell.arm(self.operation.arms[0]).tool)

    @functools.cached_property
    def cutting(self) -> CuttingTool:
        """How the tool cuts.

        Raises:
            TandemError: ``trim.tool`` also for cutters and blades that do not go through the sheet.
        """
        return cutting_tool(self.operation, self.tool, float(self.setup.stock.size[2]))

    @functools.cached_property
    def face(self) -> SheetFace:
        """The face that the tool follows.

        Raises:
            TandemError: ``trim.no_sheet``, and issues of files.
        """
        thickness = float(self.setup.stock.size[2])
        return SheetFace(self.formed, thickness, 1 if self.operation.side == "top" else -1)

    @functools.cached_property
    def surface(self) -> FormedPart:
        """The formed sheet of the operation's file or of the part. It raises as :attr:`face` does."""
        op, stock, part = self.operation, self.setup.stock, self.part
        if not isinstance(op.surface, str):
            pose = None if op.surface.frame == "find" else np.eye(4)
            part = sheet_file.build_formed_part(op.surface, Path(), stock, pose)
        if stock.sheet is None or part is None or part.formed is None:
            message = f"{op.name}: there is no formed sheet; give sheet: and a part of kind sheet_mesh"
            raise issue_error("trim.no_sheet", message, field="sheet")
        return part.formed

    @functools.cached_property
    def formed(self) -> Mesh:
        """The lower face of the sheet as it is trimmed.

        If later operations form more of the part, it has only the features that are formed before. It raises
        the same errors as :attr:`face`.
        """
        mesh, sheet = self.surface.mesh, self.setup.stock.sheet
        stages = None if sheet is None else sheet.stages
        if isinstance(self.operation.surface, str) and stages is not None and stages.following:
            tree = build_feature_tree(mesh, FEATURE_STEP, max(MIN_BUMP_HEIGHT_M, self.surface.tolerance))
            done = {number for _, numbers in stages.previous for number in numbers or ()}
            formed_features = sorted(done.intersection(feature.id for feature in tree.features))
            mesh = formed_sheet(mesh, tree, formed_features)
        return mesh

    @functools.cached_property
    def outlines(self) -> tuple[PlannedOutline, ...]:
        """The outlines in the order of cutting: first those that are inside most other outlines."""
        outlines = []
        for spec, points in every_outline(self.operation):
            curve = project_curve(spec.name, points, self.face)
            outlines.append(PlannedOutline(spec, curve, shapely.Polygon(curve.point[:, :2])))
        nesting_depths = [
            sum(
                shapely.contains_properly(other.area.buffer(0), shapely.Point(outline.curve.point[0, :2]))
                for other in outlines
            )
            for outline in outlines
        ]
        return tuple(outlines[k] for k in sorted(range(len(outlines)), key=lambda k: -nesting_depths[k]))

    def targets(self) -> Targets:
        """Return the targets of the operation, from which its motion is planned.

        Slots are planned along all outlines, then the route through them, then its targets. Targets for a
        quick check (``is_brief``) have no pictures of the sheet and no notes.

        Raises:
            TandemError: All issues ``trim.*`` of the first of these steps that fails, and issues of files.
        """
        op, tool, outlines = self.operation, self.cutting, self.outlines
        sheet = self.setup.stock.sheet
        if sheet is None:
            raise issue_error("trim.no_sheet", f"{op.name}: there is no sheet to trim", field="sheet")
        if tool.goes_through and sheet.die:
            message = format_message("trim.die", operation=op.name, tool=tool.label)
            hint = "remove the die and trim in a separate problem (surface:), or use a torch or laser"
            raise issue_error("trim.die", message, field="operations.die", hint=hint)
        # width of the slot and its leads beside an outline
        reach = tool.kerf + op.lead.length_mm * MM if tool.blade is None else tool.blade.width
        issues = list(check.curve_issues(outlines, sheet.opening, reach, op.shape_tol_mm * MM))
        if issues:
            raise TandemError(aggregate(issues))
        cut_slots: list[Slot] = []
        for outline in outlines:
            try:
                if tool.blade is not None:
                    cut_slots += plan_stretches(op, outline, self.face, tool)
                    continue
                cut_slots += plan_slots(
                    op, outline, [other for other in outlines if other is not outline], self.face, tool.kerf
                )
            except TandemError as error:
                issues += error.issues
        if issues:
            raise TandemError(aggregate(issues))
        slot_plan = SlotPlan(outlines, tuple(cut_slots))
        trim_route, issues = plan_route(op, self.setup, self.face, tool, slot_plan, self.surface.tolerance)
        if has_errors(issues):
            raise TandemError(aggregate(issues))
        # pieces held by joints stay in the sheet
        cut_free = [outline for outline in outlines if not outline.spec.joints]
        new_holes = [
            SheetHole(outline.spec.name, outline.curve.point[:, :2], outline.spec.drops == "inside")
            for outline in cut_free
        ]
        is_drawn = sheet.stages is not None and not self.is_brief
        sheet_exhibits = sheet_exhibit(self.formed, (*sheet.holes, *new_holes), op.name) if is_drawn else {}
        targets = build_targets(op, self.setup, tool, slot_plan, trim_route, self.claims())
        if self.is_brief:
            return targets
        return dataclasses.replace(
            targets, exhibits={**targets.exhibits, **sheet_exhibits}, issues=tuple(outline_notes(op))
        )

    def check_timing(
        self, targets: Targets, time: FloatArray, program_clock: FloatArray | None = None
    ) -> tuple[Issue, ...]:
        """Return issues of slots in which the arm is slower than the operation allows.

        Args:
            targets: Targets of the operation.
            time: Times of the targets (N,) [s]; not used if there is a ``program_clock``.
            program_clock: Fractional indices (2, K) of targets and their times [s], if the motion does not
                pass exactly through targets.
        """
        if program_clock is not None:
            time = np.interp(np.arange(targets.count), *program_clock)
        return slow_issues(self.operation, self.cutting, targets, time)

    def make_claims(self) -> tuple[Claim, ...]:
        """Return what must hold of the job, from the problem alone."""
        _ = self.cutting  # a cutter that does not go through is reported before everything else
        return trim_claims(self.operation, self.setup, self.tool, self._surface_error())

    def _surface_error(self) -> float:
        """Return the possible deviation of the face [m].

        It is 0 if there is no face, which :meth:`targets` reports.
        """
        try:
            return self.surface.tolerance
        except TandemError:
            return 0.0
