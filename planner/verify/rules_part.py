"""Rules on what cuts do beside their surfaces: their order, and what slots take from the part on the ways in
and out and from other surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.claims import CutsSurface, FeedWindow
from planner.issues import Issue
from planner.segments import Segment
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_node
from planner.verify.rules_surface import sweeps
from planner.verify.rules_wire import wire_issue
from planner.verify.slits import in_slit, slits
from planner.verify.spared import taken, taken_by_bent
from planner.verify.speed import local
from planner.verify.walls import Walls, walls
from planner.verify.wire import Wire, to_block

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIDE = 1e-6
"""A surface all of whose vertices are so near to one side of the datum block [m] is that side, and bounds raw
foam instead of a piece."""


def order(context: Context) -> Outcome:
    """Cuts follow one another as the operations state them, each in one go from its way in to its way out."""
    issues: list[Issue] = []
    motion = context.motion
    setups = context.spans.of_stage[motion.node_stage]
    arm = context.job.tasks[0].arm.name
    for index in range(len(context.setups)):
        rank = _ranks(context, index)
        last, before = -1, ""
        for node in np.flatnonzero(setups == index):
            label = str(motion.node_segment[node])
            here = rank.get(label, last)
            if here < last:
                what = f"{label} is cut behind {before}; it comes first"
                issues.append(at_node("verify.order", what, motion, arm, int(node)))
            last, before = here, label if label in rank else before
    return Outcome(tuple(issues))


def _ranks(context: Context, index: int) -> dict[str, int]:
    """Segments in which a setup cuts, in lower case, in the order in which they must come."""
    out: dict[str, int] = {}
    for group in context.setup_claims[index].groups:
        own = [claim.segment for claim in group if isinstance(claim, FeedWindow)]
        fed = {segment.key for segment in own}
        for segment in own:
            for way in segment.ways:
                if way.key in fed:
                    out.setdefault(way.key, len(out))
    return out


def part(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """On its ways in and out the wire's slot keeps off the part, within the tolerance, but for one plane
    slit to what the part lies around; sides of the datum block are cut from outside. Beside a surface the
    slot keeps off all the others, those that are cut already and those to come."""
    issues: list[Issue] = []
    worst, where = np.inf, ""
    own = {claim.segment.key for claim in context.surfaces}
    wanted = tuple(claim for claim in context.surfaces if not _is_side(context, claim))
    bounds = _Bounds(context, wanted)
    for wire in wires:
        speed: FloatArray | None = None
        through = slits(context, wire)
        for label in sorted(set(wire.labels.tolist()) & wire.cuts - own) if not wire.fault else ():
            rows = np.flatnonzero(wire.labels == label)
            row, column = np.nonzero(wire.inside[rows])
            if not len(row):
                continue
            row = rows[row]
            if speed is None:
                speed = local(wire.points, context.motion.time[wire.sample], wire.inside)
            points = wire.points[row, column]
            base = Segment.read(label).at("").key
            cut = next((c for c in context.surfaces if c.segment.key == base), None)
            half = np.zeros(len(row)) if cut is None else 0.5 * cut.kerf.at(speed[row, column])
            room, tolerance = bounds.off(points)
            if base in through and base != label:
                slit = in_slit(through[base], label, points, half + np.nan_to_num(tolerance))
                room = np.where(slit, np.nan, room)
            if cut is not None and cut not in wanted:
                datum = to_block(points, context.datum)
                room, tolerance = np.fmin(room, datum), np.fmin(tolerance, cut.tolerance)
            room = room - half + tolerance
            if not np.isfinite(room).any():
                continue
            k = int(np.nanargmin(room))
            if room[k] < worst:
                worst, where = float(room[k]), label
            for i in np.flatnonzero(room < 0.0)[:20]:
                deep = mm(float(tolerance[i] - room[i]))
                what = (
                    f"in {label} the slot is {deep:.2f} mm inside the part; allowed: {mm(tolerance[i]):g} mm"
                )
                measure = (deep, mm(float(tolerance[i])), "mm")
                issues.append(wire_issue(context, wire, "verify.part", what, int(row[i]), *measure))
    issues += _beside(context, wires, wanted)
    if not np.isfinite(worst):
        return Outcome(tuple(issues), where="no way in or out in the foam beside the part")
    return Outcome(tuple(issues), mm(worst), 0.0, "mm left", where)


def _beside(context: Context, wires: tuple[Wire, ...], part: tuple[CutsSurface, ...]) -> list[Issue]:
    """What slots take from other surfaces than those beside which they cut."""
    issues: list[Issue] = []
    straight = {claim.segment.key for claim in context.rulings}
    for claim, sweep in zip(context.surfaces, sweeps(context, wires), strict=True):
        if len(sweep.points) < 2:
            continue
        take = taken if claim.segment.key in straight else taken_by_bent
        for other in part:
            found = None if other is claim else take(claim, sweep, other, part, context.datum.box)
            if found is None:
                continue
            x, y, z = (mm(float(value)) for value in found.place)
            what = (
                f"beside {claim.segment} the slot of {mm(2.0 * found.half):.2f} mm takes "
                f"{mm(found.depth):.2f} mm off {other.segment} at [{x:.1f}, {y:.1f}, {z:.1f}] mm; "
                f"allowed: {mm(other.tolerance):g} mm"
            )
            measure = {"value": mm(found.depth), "limit": mm(other.tolerance), "unit": "mm"}
            issues.append(Issue("verify.part", what, field=str(claim.segment), **measure))  # type: ignore[arg-type]
    return issues


class _Bounds:
    """What bounds the part: contours that are closed, and faces that may go on beyond these."""

    def __init__(self, context: Context, claims: tuple[CutsSurface, ...]) -> None:
        closed = {
            claim.segment.key
            for claim in context.rulings
            if np.abs(claim.start[0] - claim.start[-1]).max() < SIDE
        }
        self.groups: list[tuple[Walls, FloatArray]] = []
        for contour in (True, False):
            some = tuple(c for c in claims if (c.segment.key in closed) == contour)
            if some:
                self.groups.append((walls(some), np.array([c.tolerance for c in some])))

    def off(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (N,) [m] of points (N, 3) to the part, negative inside, NaN where it is not known, and the
        tolerance (N,) there. What is outside of either the contours or the faces is outside."""
        off, tolerance = np.full(len(points), -np.inf), np.full(len(points), np.nan)
        for group, limits in self.groups:
            here, owner = group.off(points)
            tolerance = np.where(here > off, limits[owner], tolerance)
            off = np.maximum(off, here)  # NaN remains
        return np.where(np.isinf(off), np.nan, off), tolerance


def _is_side(context: Context, claim: CutsSurface) -> bool:
    """Whether a surface is a side of the datum block."""
    box = context.datum.box
    return bool((np.abs(claim.vertices[:, None] - box[None]).max(axis=0) < SIDE).any())
