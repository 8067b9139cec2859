"""verify.forming_holes: what is formed, and its tools, keep off curves along which the sheet was cut before.

A hole that nothing formed later comes near to stays where it was cut, so its edge is where the part has
it. Curves are those that the proof reads itself; ways of tools are replayed from the programs' text.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import shapely

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.processes.forming.claims import FormsPart, FormsSheet
from planner.processes.forming.proof.shapes import PartShapes, Shape
from planner.processes.forming.proof.state import FORMING, Formed, Forming
from planner.processes.forming.proof.tracks import pieces
from planner.processes.trim.claims import TrimOutline, TrimsSheet
from planner.processes.trim.proof.outlines import drawn, winding
from planner.proof.context import Context
from planner.proof.findings import in_mm
from planner.proof.part_files import UnreadError
from planner.proof.rule import Outcome, at_sample, issue, mm, rule

FORMING_HOLES = "verify.forming_holes"
"""Code of this rule."""
NO_HOLES = "no sheet is formed that was cut before"
"""Why it has not run."""
OF_WHOLE_SHEETS = ("adsif", "tpif")
"""Modes whose tools press all of the sheet, or whose die moves its rim: a cut before is at another height."""
FACET = 0.05e-3
"""How far [m] facets of a border, and chords of a curve, may be off them."""


CHORD = 0.01e-3
"""How far [m] straight pieces of a tool's way may be off it."""


@dataclasses.dataclass(frozen=True)
class _Hole:
    """A curve, and how far [m] in plan the cut's edge on the other face may be off it: as long as the way of
    a torch through the flat sheet that leans as far as it may, as sheets that are formed get thinner."""

    one: TrimOutline
    flat: FloatArray
    ring: shapely.Geometry
    across: float


@rule("verify.forming_holes", FormsPart)
def forming_holes(context: Context) -> Outcome:
    """What is formed in a sheet that was cut before, and all tools while they form it, stay off each cut, on
    both faces of the sheet, seen along z, by the margin of the problem; nothing is formed inside of one, nor
    where the sheet was cut off its clamp."""
    forming = context.get(FORMING)
    issues: list[Issue] = []
    worst, limit, where = np.inf, 0.0, ""
    made = {id(group): one for one, group in forming.parts}
    holes: list[_Hole] = []
    for index, setup in enumerate(context.setup_claims):
        for group in setup.groups:
            own = made.get(id(group))
            if holes and own is not None:
                for hole in holes:
                    near, found = _of_hole(context, forming, index, (own, group), hole)
                    issues += found
                    if near - own.part.hole_margin < worst - limit:
                        worst, limit, where = near, own.part.hole_margin, hole.one.name
            for claim in group:
                if isinstance(claim, TrimsSheet):
                    cut, unread = _cut(claim)
                    holes += cut
                    issues += unread
    if not where:
        return Outcome(tuple(issues), nothing=NO_HOLES)
    return Outcome(tuple(issues), mm(worst), mm(limit), "mm", where)


def _cut(claim: TrimsSheet) -> tuple[list[_Hole], list[Issue]]:
    found, issues = [], []
    across = float(np.hypot(claim.thickness, claim.thickness * np.tan(claim.cone)))
    for one in claim.outlines:
        try:
            flat = drawn(one)
            found.append(_Hole(one, flat, shapely.LinearRing(flat), across))
        except UnreadError as error:
            what = f"{one.name} cannot be read a second time: {error}"
            issues.append(Issue(FORMING_HOLES, what, field=one.name))
    return found, issues


def _of_hole(
    context: Context, forming: Forming, index: int, own: tuple[PartShapes, Sequence[Claim]], hole: _Hole
) -> tuple[float, list[Issue]]:
    """How near [m] what an operation forms, and its tools, come to a curve, and where that is too near."""
    made, group = own
    part, name = made.part, hole.one.name
    if not hole.one.inside:
        what = f"the sheet was cut along {name}, outside of which all drops, and is formed behind that"
        return 0.0, [Issue(FORMING_HOLES, what, field=name)]
    if part.mode in OF_WHOLE_SHEETS:
        what = (
            f"the sheet was cut along {name}, and is formed in {part.mode} behind that, which moves all of it"
        )
        return 0.0, [Issue(FORMING_HOLES, what, field=name)]
    issues: list[Issue] = []
    least = np.inf
    for _, feature in made.own:
        for shape in feature.shapes:
            near = max(_formed_off(shape, hole) - hole.across, 0.0)
            least = min(least, near)
            if near < part.hole_margin - FACET:
                what = (
                    f"{shape.claim.segment} moves the sheet {mm(near):.2f} mm off the edges of {name}, cut "
                    f"before; wanted: {mm(part.hole_margin):g} mm"
                )
                issues.append(issue(FORMING_HOLES, what, in_mm(near, part.hole_margin), field=name))
    passes = [one for one in forming.formed if one.setup == index and any(one.claim is c for c in group)]
    if len(passes) != sum(isinstance(claim, FormsSheet) for claim in group):
        issues.append(Issue(FORMING_HOLES, f"passes beside {name} are not all replayed", field=name))
    for one in passes:
        near, found = _tools_off(context, part, one, hole)
        least = min(least, near)
        issues += found
    return float(least), issues


def _formed_off(shape: Shape, hole: _Hole) -> float:
    """How far [m] in plan what is moved is off a curve: 0 for what lies in it, or around it."""
    plan = shape.corners[shape.raised][:, :, :2]
    if not len(plan):
        return np.inf
    if winding(hole.flat, plan.mean(axis=1)).any():
        return 0.0
    tree = shapely.STRtree(shapely.polygons(plan[:, [0, 1, 2, 0]]))
    return float(tree.query_nearest(hole.ring, return_distance=True, all_matches=False)[1].min())


def _tools_off(context: Context, part: FormsPart, one: Formed, hole: _Hole) -> tuple[float, list[Issue]]:
    """How far [m] in plan the tools of a pass stay off the edges of a cut while they form."""
    track, least = one.track, np.inf
    issues: list[Issue] = []
    parts = pieces(track, CHORD)
    use = track.own[parts.first]
    first, last, off = parts.first[use], parts.last[use], parts.off[use] + hole.across
    radius = dict(zip(part.arms, part.radii, strict=True))
    for column, arm in enumerate(track.arms):
        if arm not in radius or not len(first):
            continue
        ends = np.stack([track.centre[rows, column][:, :2] for rows in (first, last)], axis=1)
        near = shapely.distance(shapely.linestrings(ends), hole.ring) - off - radius[arm]
        near = np.where(winding(hole.flat, ends[:, 0]), 0.0, np.maximum(near, 0.0))
        k = int(np.argmin(near))
        least = min(least, float(near[k]))
        if near[k] < part.hole_margin - FACET:
            what = f"in {one.claim.segment} the tool of {arm} comes within {mm(float(near[k])):.2f} mm of "
            what += f"the edges of {hole.one.name}, which was cut before; wanted: {mm(part.hole_margin):g} mm"
            row, measure = int(track.rows[first[k]]), in_mm(near[k], part.hole_margin)
            issues.append(at_sample(FORMING_HOLES, what, context.motion, arm, row, measure))
    return float(least), issues
