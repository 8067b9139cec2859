"""verify.forming_holes: formed areas and forming tools stay away from cuts that were made before.

A hole that no later forming comes near keeps its position, so its edge is where the part has it. The proof
reads the curves itself and replays the tools from the program text.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import shapely

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.processes.forming.claims import FormsPart, FormsSheet
from planner.processes.forming.proof.formed_shapes import FormedShape, PartShapes
from planner.processes.forming.proof.forming_facts import FORMING, FormedPass, FormingFacts
from planner.processes.forming.proof.tracks import straight_pieces
from planner.processes.trim.claims import TrimOutline, TrimsSheet
from planner.processes.trim.proof.outlines import encloses, plan_curve
from planner.proof.context import Context
from planner.proof.findings import measure_in_mm
from planner.proof.part_files import UnreadError
from planner.proof.rule import RuleOutcome, measured_issue, mm, rule, sample_issue

FORMING_HOLES = "verify.forming_holes"
"""Code of this rule."""
NO_HOLES = "no sheet is formed that was cut before"
"""Reason why the rule has not run."""
WHOLE_SHEET_MODES = ("adsif", "tpif")
"""Modes that move the whole sheet, so that an earlier cut is at another height: the tools press all of the
sheet, or the die moves its rim.
"""
FACET_ERROR_M = 0.05e-3
"""Possible error [m] of distances, because borders consist of facets and curves of chords."""


CHORD_ERROR_M = 0.01e-3
"""Maximum deviation of straight pieces from a tool's path [m]."""


@dataclasses.dataclass(frozen=True)
class _CutHole:
    """A curve that was cut.

    Attributes:
        outline: Outline.
        vertices: Its vertices in plan (K, 2) [m].
        ring: The outline in plan as a Shapely geometry.
        edge_offset: Maximum distance in plan between the edges of the cut on both faces [m]: the length of a
            cut through the flat sheet at maximum tilt, because formed sheets get thinner.
    """

    outline: TrimOutline
    vertices: FloatArray
    ring: shapely.Geometry
    edge_offset: float


@rule("verify.forming_holes", FormsPart)
def forming_holes(context: Context) -> RuleOutcome:
    """What is formed in a sheet that was cut before, and its tools, keep the margin from each cut.

    It holds on both faces of the sheet, seen along z. Nothing is formed inside a cut, nor where the sheet was
    cut off its clamp.
    """
    forming = context.get(FORMING)
    issues: list[Issue] = []
    worst, limit, where = np.inf, 0.0, ""
    shapes_by_group = {id(group): part for part, group in forming.parts}
    holes: list[_CutHole] = []
    for index, setup in enumerate(context.setup_claims):
        for group in setup.groups:
            shapes = shapes_by_group.get(id(group))
            if holes and shapes is not None:
                for hole in holes:
                    distance, hole_issues = _check_hole(context, forming, index, (shapes, group), hole)
                    issues += hole_issues
                    if distance - shapes.part.hole_margin < worst - limit:
                        worst, limit, where = distance, shapes.part.hole_margin, hole.outline.name
            for claim in group:
                if isinstance(claim, TrimsSheet):
                    cut, unread = _find_holes(claim)
                    holes += cut
                    issues += unread
    if not where:
        return RuleOutcome(tuple(issues), nothing=NO_HOLES)
    return RuleOutcome(tuple(issues), mm(worst), mm(limit), "mm", where)


def _find_holes(claim: TrimsSheet) -> tuple[list[_CutHole], list[Issue]]:
    """Read the outlines of a claim as cuts, with issues of those that cannot be read."""
    holes, issues = [], []
    cut_length = float(np.hypot(claim.thickness, claim.thickness * np.tan(claim.cone)))
    for outline in claim.outlines:
        try:
            vertices = plan_curve(outline)
            holes.append(_CutHole(outline, vertices, shapely.LinearRing(vertices), cut_length))
        except UnreadError as error:
            message = f"{outline.name} cannot be read a second time: {error}"
            issues.append(Issue(FORMING_HOLES, message, field=outline.name))
    return holes, issues


def _check_hole(
    context: Context,
    forming: FormingFacts,
    index: int,
    formed_group: tuple[PartShapes, Sequence[Claim]],
    hole: _CutHole,
) -> tuple[float, list[Issue]]:
    """Check that a sheet with a cut is not formed too close to the cut by one later forming operation.

    ``index`` is that of the operation's setup, ``formed_group`` has its shapes and claims.

    Returns:
        The minimum distance [m] in plan of formed areas and forming tools from the edges of the cut, and
        issues. The distance is 0 if such a cut rules out any forming: the waste is outside the cut, or the
        forming mode moves the whole sheet.
    """
    shapes, group = formed_group
    part, name = shapes.part, hole.outline.name
    if not hole.outline.drops_inside:
        message = (
            f"the sheet was cut along {name}, outside of which everything drops, and is formed after that"
        )
        return 0.0, [Issue(FORMING_HOLES, message, field=name)]
    if part.mode in WHOLE_SHEET_MODES:
        message = (
            f"the sheet was cut along {name}, and is formed in {part.mode} after that, which moves all of it"
        )
        return 0.0, [Issue(FORMING_HOLES, message, field=name)]
    issues: list[Issue] = []
    min_distance = np.inf
    for _, feature in shapes.own_features:
        for shape in feature.shapes:
            distance = max(_forming_distance(shape, hole) - hole.edge_offset, 0.0)
            min_distance = min(min_distance, distance)
            if distance < part.hole_margin - FACET_ERROR_M:
                message = (
                    f"{shape.claim.segment} moves the sheet {mm(distance):.2f} mm from the edges of {name}, "
                    f"cut before, required {mm(part.hole_margin):g} mm"
                )
                issues.append(
                    measured_issue(
                        FORMING_HOLES, message, measure_in_mm(distance, part.hole_margin), field=name
                    )
                )
    passes = [
        formed_pass
        for formed_pass in forming.formed
        if formed_pass.setup == index and any(formed_pass.claim is c for c in group)
    ]
    if len(passes) != sum(isinstance(claim, FormsSheet) for claim in group):
        issues.append(Issue(FORMING_HOLES, f"not all passes near {name} are replayed", field=name))
    for formed_pass in passes:
        distance, pass_issues = _tool_distance(context, part, formed_pass, hole)
        min_distance = min(min_distance, distance)
        issues += pass_issues
    return float(min_distance), issues


def _forming_distance(shape: FormedShape, hole: _CutHole) -> float:
    """Return the distance [m] in plan of a formed area from the curve of a cut.

    It is 0 if the area overlaps the inside of the curve, and infinite if nothing is formed.
    """
    plan = shape.corners[shape.raised][:, :, :2]
    if not len(plan):
        return np.inf
    if encloses(hole.vertices, plan.mean(axis=1)).any():
        return 0.0
    tree = shapely.STRtree(shapely.polygons(plan[:, [0, 1, 2, 0]]))
    return float(tree.query_nearest(hole.ring, return_distance=True, all_matches=False)[1].min())


def _tool_distance(
    context: Context, part: FormsPart, formed_pass: FormedPass, hole: _CutHole
) -> tuple[float, list[Issue]]:
    """Return the minimum distance [m] in plan of a pass's tools from the edges of a cut, and issues.

    Only moves that form are compared. The distance of a tool that is inside the cut is 0.
    """
    track, min_distance = formed_pass.track, np.inf
    issues: list[Issue] = []
    pieces = straight_pieces(track, CHORD_ERROR_M)
    is_forming = track.is_forming[pieces.first]
    first, last = pieces.first[is_forming], pieces.last[is_forming]
    margins = pieces.deviation[is_forming] + hole.edge_offset
    radius_by_arm = dict(zip(part.arms, part.radii, strict=True))
    for column, arm in enumerate(track.arms):
        if arm not in radius_by_arm or not len(first):
            continue
        ends = np.stack([track.centre[rows, column][:, :2] for rows in (first, last)], axis=1)
        distances = shapely.distance(shapely.linestrings(ends), hole.ring) - margins - radius_by_arm[arm]
        distances = np.where(encloses(hole.vertices, ends[:, 0]), 0.0, np.maximum(distances, 0.0))
        k = int(np.argmin(distances))
        min_distance = min(min_distance, float(distances[k]))
        if distances[k] < part.hole_margin - FACET_ERROR_M:
            message = (
                f"in {formed_pass.claim.segment} the tool of {arm} comes within "
                f"{mm(float(distances[k])):.2f} mm of "
            )
            message += f"the edges of {hole.outline.name}, cut before, required {mm(part.hole_margin):g} mm"
            row, measure = int(track.rows[first[k]]), measure_in_mm(distances[k], part.hole_margin)
            issues.append(sample_issue(FORMING_HOLES, message, context.motion, arm, row, measure))
    return float(min_distance), issues
