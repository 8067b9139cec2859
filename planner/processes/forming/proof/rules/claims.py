"""verify.forming_claims: the claims on each pass, compared with the part and the user's numbers.

It checks gaps, borders, feeds, tolerances and the sheet that tools may meet. `verify.forming_part` checks the
faces themselves.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.geometry.mesh import TriangleMesh, corner_normals
from planner.issues import Issue
from planner.processes.forming.claims import (
    FollowsOpposite,
    FormingFeed,
    FormsByTable,
    FormsPart,
    FormsSheet,
    SheetState,
    SinksHolder,
    SupportsBorder,
    ToolGap,
)
from planner.processes.forming.proof import accumulative
from planner.processes.forming.proof.face import CREASE_ANGLE_RAD
from planner.processes.forming.proof.formed_shapes import (
    FLAT_NOISE_M,
    FormedFeature,
    FormedShape,
    PartShapes,
    spread_points,
)
from planner.processes.forming.proof.forming_facts import FORMING
from planner.proof.context import Context
from planner.proof.findings import Findings, format_point_mm, measure_in_percent, to_percent
from planner.proof.rule import Measure, RuleOutcome, measured_issue, mm, rule

FORMING_CLAIMS = "verify.forming_claims"
"""Code of this rule."""
NOT_RUN_REASON = "no part is to be formed"
"""Reason why it has not run."""
ROUNDING_TOLERANCE = 1e-9
"""Lengths [m], angles [rad] and fractions that differ by less are equal."""
TABLE_TOLERANCE_M = 1e-6
"""Tolerance [m] for values from the response table, which is evaluated at discrete angles."""
GAP_TOLERANCE_FRACTION, LATER_GAP_TOLERANCE_FRACTION = 0.01, 0.02
"""Tolerances of a claimed gap, as fractions of the flat sheet's thickness, compared with what follows from
the walls: for a single shape, and after previous shapes, whose walls have other facets.
"""
GAP_EXCEPTION_FRACTION, MAX_GAP_EXCEPTION = 0.15, 0.15
"""After previous shapes: fraction of the walls on which the gap may deviate more, along creases, and the
maximum deviation there as a fraction of the thickness.
"""
EDGE_BAND_M = 6e-4
"""Where a shape is as deep as a later pass within this [m], its own wall may start or end, because walls
leave the contours that describe a shape tangentially.
"""
BORDER_TOLERANCE_M = 3e-4
"""Maximum deviation [m] of the path of a support from the border, offset by its radius: the outline is
faceted.
"""
MAX_BORDER_TOLERANCE_M = 5e-4
"""Maximum tolerance [m] of a claim on a support along its border."""
MAX_HEAT_TOLERANCE_M = 2e-3
"""Maximum tolerance [m] of a claim on the position of a heat source."""
MAX_LINE_TOLERANCE_RAD = np.deg2rad(4.0)
"""Maximum tolerance [rad] of a claim on the direction of the line between two tools."""
MIN_PULSE_S = 0.1
"""Minimum duration [s] of a pulse."""
MAX_RIDGE_FACTOR, MAX_MEAN_RIDGE_FACTOR = 1.1, 10.0
"""Maximum factors by which the claimed ridges may exceed those between paths one step apart: on the flattest
wall, and on average over walls, because they bend within a step.
"""
MIN_WALL_ANGLE_RAD = np.deg2rad(2.0)
"""Walls flatter than this [rad] count as flat."""
STATE_SPACING_M = 5e-3
"""Maximum distance [m] of points of the sheet from a point that the claim on the sheet's state includes."""
TOOL_REACH_M = 0.09
"""Points farther [m] from a feature in plan are out of reach of any tool."""
RIM_WIDTH_M = 0.03
"""Distance [m] about a feature in which the claim has to include formed sheet and the flat."""
_PART_POINTS = 8_000
"""Number of points of the part at which the sheet's state is checked."""


@rule("verify.forming_claims", FormsPart)
def check_forming_claims(context: Context) -> RuleOutcome:
    """The claims on each pass follow from the part and the user's numbers: tools, gaps by the sine law,
    borders, feeds, tolerances, ridges, steps of a clamp, and all of the sheet that tools may meet.
    """
    forming, findings = context.get(FORMING), Findings(FORMING_CLAIMS, context)
    for part_shapes, group in forming.parts:
        if part_shapes is None or not part_shapes.own_features:
            continue
        findings.issues += _number_issues(part_shapes.part, group)
        without_rim = [feature for _, feature in part_shapes.own_features if not len(feature.final.rim)]
        if without_rim:  # its surroundings cannot be checked
            segment = without_rim[0].final.claim.segment
            findings.issues.append(_claims_issue(f"{segment} starts nowhere on the sheet", segment))
            continue
        for claim in group:
            if isinstance(claim, ToolGap):
                deviation, gap_issues = _gap_issues(part_shapes, claim)
                findings.issues += gap_issues
                findings.note_highest(deviation, claim.segment)
        findings.issues += _missing_claim_issues(part_shapes.part, part_shapes, group)
        findings.issues += _state_issues(part_shapes, group)
    if not forming.parts:
        return findings.outcome_without_value(NOT_RUN_REASON)
    if not np.isfinite(findings.worst):
        return findings.outcome_without_value()
    return findings.outcome(to_percent, "% of the thickness", GAP_TOLERANCE_FRACTION)


def _claims_issue(message: str, segment: Segment, measure: Measure | None = None) -> Issue:
    return measured_issue(FORMING_CLAIMS, message, measure, field=str(segment))


_PASS_CLAIMS = (
    FormsSheet,
    FormsByTable,
    ToolGap,
    FormingFeed,
    SheetState,
    SinksHolder,
    SupportsBorder,
    FollowsOpposite,
)
"""Kinds of claims on passes."""


def _number_issues(part: FormsPart, group: Sequence[Claim]) -> Iterator[Issue]:
    """Check that the numbers in the claims on passes are those of the problem, which ``part`` states.

    These are radii, tolerances, feeds, steps and ridges. Claims on the sheet's state may allow the tools to
    be as deep in the sheet as they have to press into it, in addition to the gouge tolerance.
    """
    radius_by_arm = dict(zip(part.arms, part.radii, strict=True))
    ridge = _ridge_function(part)
    for claim in group:
        if not isinstance(claim, _PASS_CLAIMS):
            continue
        differing: list[str] = []
        if isinstance(claim, FormsSheet):
            differing = _differing_fields(
                claim, radius=radius_by_arm.get(claim.arm), tolerance=part.gouge, share=part.share
            )
            differing += [] if _ridges_are_valid(part, claim, ridge) else ["scallop"]
        elif isinstance(claim, FormsByTable):
            radii = tuple(radius_by_arm.get(arm) for arm in claim.arms)
            differing = _differing_fields(claim, radii=radii, thickness=part.thickness, tolerance=part.gap)
        elif isinstance(claim, ToolGap):
            radii = tuple(radius_by_arm.get(arm) for arm in claim.arms)
            differing = _differing_fields(claim, radii=radii, tolerance=part.gap, handshake=part.handshake)
            differing += ["turn"] if claim.turn > MAX_LINE_TOLERANCE_RAD + ROUNDING_TOLERANCE else []
        elif isinstance(claim, FormingFeed):
            differing = _differing_fields(claim, upper=part.feed, arms=part.arms)
        elif isinstance(claim, SheetState):
            allowed = part.gouge + part.pressed
            differing = ["tolerance"] if claim.tolerance > allowed + ROUNDING_TOLERANCE else []
            allowed = part.gouge + max(part.pressed, _pressed_by_table(claim, group))
            differing += ["other"] if claim.other > allowed + TABLE_TOLERANCE_M else []
        elif isinstance(claim, SinksHolder):
            signal, step = part.sinking or ("", 0.0)
            differing = _differing_fields(
                claim, signal=signal, step=step, radius=radius_by_arm.get(claim.arm)
            )
            differing += ["pulse"] if claim.pulse < MIN_PULSE_S - ROUNDING_TOLERANCE else []
        for name in differing:
            message = f"{claim.segment}: {name} of {type(claim).__name__} is not what the problem states"
            yield _claims_issue(message, claim.segment)


def _pressed_by_table(state: SheetState, group: Sequence[Claim]) -> float:
    """Return the maximum depth [m] to which the second tool must press into the flat sheet.

    The response table requires it. Both tools stay at the level of the flat sheet while it is formed, so the
    sheet was pressed like this, too, when the table was measured. The depth is 0 without a table.
    """
    max_depth = 0.0
    for claim in group:
        if isinstance(claim, FormsByTable) and claim.segment == state.segment:
            table = accumulative.solve_table(claim.table, claim.prefer)
            down = table.support_positions(claim.thickness, sum(claim.radii), claim.give)[:, 1]
            depth = claim.thickness - claim.projection + sum(claim.radii) - float(down.min())
            max_depth = max(max_depth, depth)
    return max_depth


def _differing_fields(claim: Any, **expected: Any) -> list[str]:
    """Return names of the fields of a claim that differ from the expected values by more than rounding."""
    out = []
    for name, value in expected.items():
        actual = getattr(claim, name)
        if isinstance(value, float) or (isinstance(value, tuple) and isinstance(value[0], float)):
            if not np.allclose(
                np.asarray(actual, dtype=np.float64), value, rtol=0.0, atol=ROUNDING_TOLERANCE
            ):
                out.append(name)
        elif actual != value:
            out.append(name)
    return out


def _ridge_function(part: FormsPart) -> Callable[[FloatArray, float], FloatArray]:
    """Return the function for the heights (F,) [m] of the ridges that the steps of a part's passes leave.

    Its arguments are wall angles (F,) [rad] and the radius [m] of the ball.
    """
    step, scallop = part.steps

    def ridge_height(angle: FloatArray, radius: float) -> FloatArray:
        if scallop is not None:
            return np.full(len(angle), scallop)
        # loops are step / sin(angle) apart along the wall; the ridge is in the middle between two of them
        half = np.minimum(0.5 * (step or 0.0) / np.sin(angle), radius)
        return np.asarray(radius - np.sqrt(radius**2 - half**2))

    return ridge_height


def _ridges_are_valid(
    part: FormsPart, claim: FormsSheet, ridge: Callable[[FloatArray, float], FloatArray]
) -> bool:
    """Return whether the scallops that a pass claims are not much higher than the ridges between its steps.

    The mean over the walls may be higher by MAX_MEAN_RIDGE_FACTOR, and the largest scallop by
    MAX_RIDGE_FACTOR. Ridges on nearly flat walls are very high, so angles have a lower bound: the angle below
    which half of the area lies that need not be formed within tolerance. ``ridge`` is the result of
    `_ridge_function`.
    """
    corners = claim.vertices[claim.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    angle = np.arccos(np.clip(cross[:, 2] / np.maximum(size, 1e-300), -1.0, 1.0))
    walls = np.flatnonzero((angle > MIN_WALL_ANGLE_RAD) & (size > 1e-16))
    if not len(walls):
        return False
    angle, size = angle[walls], size[walls]
    order = np.argsort(angle)
    area_fraction = np.cumsum(size[order]) / size.sum()
    min_angle = float(angle[order[int(np.searchsorted(area_fraction, 0.5 * (1.0 - part.share)))]])
    expected_ridge = ridge(np.maximum(angle, max(min_angle, MIN_WALL_ANGLE_RAD)), claim.radius)
    allowed = claim.scallop[walls] - part.gouge
    max_ridge = ridge(np.array([max(min_angle, MIN_WALL_ANGLE_RAD)]), claim.radius)[0]
    is_mean_valid = (allowed * size).sum() <= MAX_MEAN_RIDGE_FACTOR * (
        expected_ridge * size
    ).sum() + ROUNDING_TOLERANCE * size.sum()
    return bool(is_mean_valid and allowed.max() <= MAX_RIDGE_FACTOR * max_ridge + ROUNDING_TOLERANCE)


def _gap_issues(part_shapes: PartShapes, claim: ToolGap) -> tuple[float, list[Issue]]:
    """Compare a claimed gap with the sheet's thickness by the sine law, from the walls of its pass and of
    previous passes of the feature.

    The sine law gives a thickness of t0 cos(a) for the wall angle a. After previous passes the smallest
    thickness counts, because a sheet that was thinned stays thin. Where several walls meet, any gap between
    the smallest and the largest result is accepted. The floor is not checked.

    Returns:
        Deviation as a fraction of the flat sheet's thickness, minus the additional tolerance for previous
        passes, and at most one issue. With previous passes the `GAP_EXCEPTION_FRACTION` of the walls with the
        largest deviations is left out. The deviation is infinite if the claim belongs to no pass or face.
    """
    part = part_shapes.part
    shapes, own_shape = _shapes_up_to(part_shapes, claim.segment)
    if own_shape is None:
        message = f"the gap of {claim.segment} belongs to no pass"
        return np.inf, [_claims_issue(message, claim.segment)]
    corners = claim.vertices[claim.faces]
    is_same_face = (
        np.abs(corners - own_shape.corners).max() < ROUNDING_TOLERANCE
        if len(corners) == len(own_shape.corners)
        else False
    )
    if not is_same_face:
        message = f"the gap of {claim.segment} belongs to another face"
        return np.inf, [_claims_issue(message, claim.segment)]
    own_cosine = _wall_cosine(own_shape)
    min_ratio = max_ratio = own_cosine
    plan = corners.reshape(-1, 3)[:, :2]
    for shape in shapes[:-1]:  # a sheet that was thinned stays thin
        min_cosine, max_cosine = _wall_cosine_range(shape, plan)
        is_edge = np.abs(own_shape.displacement(plan) - shape.displacement(plan)) < EDGE_BAND_M
        min_cosine = np.where(
            is_edge, np.minimum(min_cosine, np.cos(shape.wall_angle(0.995)) - ROUNDING_TOLERANCE), min_cosine
        )
        max_cosine = np.where(is_edge, 1.0, max_cosine)
        min_ratio = np.minimum(min_ratio, min_cosine.reshape(-1, 3))
        max_ratio = np.minimum(max_ratio, max_cosine.reshape(-1, 3))
    flat_gap = part.squeeze * part.thickness
    actual = claim.gap[claim.faces]
    deviation = (
        np.maximum(np.maximum(min_ratio * flat_gap - actual, actual - max_ratio * flat_gap), 0.0).max(axis=1)
        / part.thickness
    )
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # the floor is not formed
    floor = (np.abs(corners[:, :, 2] - own_shape.end_level) < LEVEL_TOLERANCE_M).all(axis=1)
    area = np.where(own_shape.moved & ~floor, np.linalg.norm(cross, axis=1), 0.0)
    order = np.argsort(-deviation)
    formed_area = np.cumsum(area[order])
    excepted = GAP_EXCEPTION_FRACTION if len(shapes) > 1 else 0.0
    deviation_at_fraction = float(
        deviation[order[int(np.searchsorted(formed_area, excepted * formed_area[-1] + 1e-15))]]
    )
    allowed = LATER_GAP_TOLERANCE_FRACTION if len(shapes) > 1 else GAP_TOLERANCE_FRACTION
    largest = float(deviation[area > 0.0].max(initial=0.0))
    if deviation_at_fraction <= allowed and largest <= max(
        GAP_TOLERANCE_FRACTION, MAX_GAP_EXCEPTION * (len(shapes) > 1)
    ):
        return deviation_at_fraction - allowed + GAP_TOLERANCE_FRACTION, []
    deviation_at_fraction = max(deviation_at_fraction, largest)
    message = (
        f"the gap of {claim.segment} is {100 * deviation_at_fraction:.2f} % of the sheet's thickness off "
        "squeeze * t0 cos(a)"
    )
    return deviation_at_fraction, [
        _claims_issue(message, claim.segment, measure_in_percent(deviation_at_fraction, allowed))
    ]


def _shapes_up_to(
    part_shapes: PartShapes, segment: Segment
) -> tuple[tuple[FormedShape, ...], FormedShape | None]:
    """Return the shapes of a feature up to the one that a segment forms, and that one, or None."""
    for feature in part_shapes.features:
        for k, shape in enumerate(feature.shapes):
            if any(claim.segment == segment for claim in shape.claims):
                return feature.shapes[: k + 1], shape
    return (), None


def _wall_cosine(shape: FormedShape) -> FloatArray:
    """Return the cosines (T, 3) of the wall angle at the corners of a face, smooth except over creases."""
    claim = shape.claim
    normal = corner_normals(TriangleMesh(claim.vertices, claim.faces), CREASE_ANGLE_RAD)
    return np.clip(normal[:, :, 2], 0.0, 1.0)


def _wall_cosine_range(shape: FormedShape, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum and maximum cosine (N,) of the wall's angle at points in plan (N, 2).

    It is 1 outside of the shape. They differ where several triangles are at a point, as on edges.
    """
    corner = _wall_cosine(shape)[shape.moved]
    row, triangle, weight = shape.lookup.locate(points, _PLAN_TOLERANCE_M)
    value = (weight * corner[triangle]).sum(axis=1)
    minimum, maximum = np.ones(len(points)), np.zeros(len(points))
    np.minimum.at(minimum, row, value)
    np.maximum.at(maximum, row, value)
    maximum[np.setdiff1d(np.arange(len(points)), row)] = 1.0
    return minimum, maximum


_PLAN_TOLERANCE_M = 1e-4
"""Points within this distance [m] of a triangle in plan are on it."""


def _missing_claim_issues(
    part: FormsPart, part_shapes: PartShapes, group: Sequence[Claim]
) -> Iterator[Issue]:
    """Check that each pass has exactly the claims that its mode requires.

    Otherwise the rule of a missing claim would find nothing to check. The claims on the border, the heat
    source and the clamp of each feature are also compared with the feature.
    """
    required: dict[type, bool] = {
        FormingFeed: True,
        SheetState: True,
        ToolGap: part.mode in ("dsif", "dpif_l"),
        SupportsBorder: part.mode == "dpif_p",
        FollowsOpposite: part.mode == "heat",
        FormsByTable: part.mode == "adsif",
        FormsSheet: part.mode != "adsif",
    }
    for _, feature in part_shapes.own_features:
        for shape in feature.shapes:
            for claim_of_pass in shape.claims:
                for kind, needed in required.items():
                    segment_claims = (
                        c for c in group if isinstance(c, _PASS_CLAIMS) and c.segment == claim_of_pass.segment
                    )
                    matches = [c for c in segment_claims if type(c) is kind]
                    if len(matches) != int(needed):
                        message = (
                            f"{claim_of_pass.segment} has {len(matches)} claims {kind.__name__}, not "
                            f"{int(needed)}"
                        )
                        yield _claims_issue(message, claim_of_pass.segment)
        for claim in group:
            if isinstance(claim, SupportsBorder) and _belongs_to(feature, claim.segment):
                yield from _border_issues(part, feature, claim)
            if isinstance(claim, FollowsOpposite) and _belongs_to(feature, claim.segment):
                yield from _opposite_issues(part, feature, claim)
            if isinstance(claim, SinksHolder) and _belongs_to(feature, claim.segment):
                claim_of_pass = feature.shapes[0].claim
                if _differing_fields(
                    claim, start=claim_of_pass.start, end=claim_of_pass.end, side=claim_of_pass.side
                ):
                    yield _claims_issue(
                        f"{claim.segment}: the clamp sinks between other levels", claim.segment
                    )
    if part.sinking is not None and not any(isinstance(c, SinksHolder) for c in group):
        yield Issue(FORMING_CLAIMS, "no claim states how the clamp sinks", field="die")


def _belongs_to(feature: FormedFeature, segment: Segment) -> bool:
    return any(claim.segment == segment for shape in feature.shapes for claim in shape.claims)


def _border_issues(part: FormsPart, feature: FormedFeature, claim: SupportsBorder) -> Iterator[Issue]:
    """Check that the claimed path of a support goes around a feature on the other side of the flat sheet.

    Its distance in plan from the area that the feature moves has to be the tool's radius.
    """
    final = feature.final
    side = final.claim.side
    (support,) = (k for k, side_of_arm in enumerate(part.sides) if side_of_arm != side)
    radius, is_ball = part.radii[support], part.kinds[support] == "ball"
    level = final.base - side * (part.thickness + (radius if is_ball else 0.0))
    outer_distance = _plan_distance(final.corners[final.moved], claim.border) - radius
    # triangles that are moved, but not raised, may be noise of the flat
    inner_distance = _plan_distance(final.corners[final.raised], claim.border) - radius
    deviation = np.maximum(outer_distance, -inner_distance)
    is_inside = shapely.contains_xy(shapely.Polygon(claim.border[:, :2]), final.rim[:, 0], final.rim[:, 1])
    rim_distance = np.asarray(cKDTree(claim.border[:, :2]).query(final.rim)[0])
    problems = []
    if deviation.max() > BORDER_TOLERANCE_M:
        problems.append(f"{mm(float(deviation.max())):.3f} mm off the border and its radius")
    if np.abs(claim.border[:, 2] - level).max() > LEVEL_TOLERANCE_M:
        problems.append(f"{mm(float(np.abs(claim.border[:, 2] - level).max())):.3f} mm off the flat sheet")
    if not is_inside.all() or not len(rim_distance):
        problems.append("not around all of the feature")
    if claim.arm != part.arms[support] or claim.tolerance > MAX_BORDER_TOLERANCE_M + ROUNDING_TOLERANCE:
        problems.append("of another tool or tolerance")
    for problem in problems:
        yield _claims_issue(f"the path of the support about {claim.segment} is {problem}", claim.segment)


LEVEL_TOLERANCE_M = 1e-5
"""Heights [m] that differ by less count as one level."""


def _plan_distance(corners: FloatArray, ring: FloatArray) -> FloatArray:
    """Return the distances (K,) [m] in plan of a ring's points (K, 3) from triangles (T, 3, 3).

    Each is the distance from the nearest triangle.
    """
    tree = shapely.STRtree(shapely.polygons(corners[:, [0, 1, 2, 0], :2]))
    points = shapely.points(ring[:, :2])
    return np.asarray(tree.query_nearest(points, return_distance=True, all_matches=False)[1])


def _opposite_issues(part: FormsPart, feature: FormedFeature, claim: FollowsOpposite) -> Iterator[Issue]:
    """Check that a heat source is claimed to be at the other face of the sheet that the ball forms.

    Its distance from the ball's centre has to be the ball's radius plus the thickness of the sheet, which may
    be thinned by the sine law.
    """
    min_cosine = min(float(np.cos(shape.wall_angle(1.0))) for shape in feature.shapes)
    radius = dict(zip(part.arms, part.radii, strict=True)).get(claim.arms[0], np.nan)
    min_distance, max_distance = radius + part.thickness * min_cosine, radius + part.thickness
    own_shapes = [s for s in feature.shapes if any(c.segment == claim.segment for c in s.claims)]
    is_same_face = len(claim.faces) == len(own_shapes[0].claim.faces) and np.array_equal(
        claim.vertices[claim.faces], own_shapes[0].corners
    )
    is_at_sheet = (
        min_distance - ROUNDING_TOLERANCE <= claim.distance <= max_distance + ROUNDING_TOLERANCE
        and claim.tolerance <= MAX_HEAT_TOLERANCE_M + ROUNDING_TOLERANCE
    )
    if not (is_at_sheet and is_same_face and claim.side == own_shapes[0].claim.side):
        yield _claims_issue(f"the source of heat for {claim.segment} is not at the sheet", claim.segment)


@dataclasses.dataclass(frozen=True)
class FormedSheetPoints:
    """N points of the sheet when the forming of a feature starts.

    Attributes:
        plan: Positions (N, 2) [m] in plan.
        height: Heights z (N,) [m] of the sheet's lower face there.
        is_fixed: Whether (N,) the sheet is formed there and is outside of the feature.
        is_carried: Whether (N,) the sheet is formed there and sinks with the feature.
    """

    plan: FloatArray
    height: FloatArray
    is_fixed: BoolArray
    is_carried: BoolArray


def _state_issues(part_shapes: PartShapes, group: Sequence[Claim]) -> Iterator[Issue]:
    """Check that the claims on the sheet's state include all formed sheet and the surrounding flat.

    The tools are checked only against the sheet in these claims. Formed sheet outside of a feature is fixed.
    Formed sheet of features inside it is carried, because it sinks with the floor of this one. Parts over a
    male die are not checked, because only flat sheet surrounds their single feature.
    """
    part = part_shapes.part
    claimed_states = {claim.segment: claim for claim in group if isinstance(claim, SheetState)}
    points = spread_points(part.vertices[part.faces], _PART_POINTS)[0]
    points = np.concatenate(
        [points[:, :2], *(f.final.spread_points(2_000)[:, :2] for f in part_shapes.features)]
    )
    moved = np.array([feature.final.displacement(points) for feature in part_shapes.features])
    for k, feature in part_shapes.own_features:
        if part.male:
            continue  # besides the single feature there is only the flat that sinks
        low, high = feature.final.rim.min(axis=0) - TOOL_REACH_M, feature.final.rim.max(axis=0) + TOOL_REACH_M
        in_reach = ((points >= low) & (points <= high)).all(axis=1)
        is_moved = in_reach & (np.abs(moved[:k]) > 1e-4)
        formed, carried = is_moved.any(axis=0), is_moved[part_shapes.inside[:k, k]].any(axis=0)
        height = part_shapes.level + moved[:k].sum(axis=0)
        is_in_feature = np.abs(moved[k]) > FLAT_NOISE_M
        sheet_points = FormedSheetPoints(points, height, formed & ~is_in_feature, carried & is_in_feature)
        for number, shape in enumerate(feature.shapes):
            # displacement along z at which the previous shape, or the previous run of this one, ended
            sunk = 0.0 if number == 0 else feature.shapes[number - 1].end_level - shape.base
            for claim in shape.claims:
                state = claimed_states.get(claim.segment)
                if state is None:
                    continue
                is_first_pass = claim is feature.shapes[0].claims[0]
                repeat_depth = sunk if claim is shape.claims[0] else shape.end_level - shape.base
                carried_depth = 0.0 if is_first_pass else repeat_depth
                flat = _surrounding_flat(part_shapes, k, feature)
                yield from _missing_point_issues(state, part.thickness, sheet_points, carried_depth, flat)


def _surrounding_flat(part_shapes: PartShapes, k: int, feature: FormedFeature) -> FloatArray:
    """Return the points (N, 3) [m] of the flat sheet around feature ``k``.

    The result is empty if the feature is inside an earlier one.
    """
    if part_shapes.inside[k, :k].any():
        return np.zeros((0, 3))
    rim = feature.final.rim
    low, high = rim.min(axis=0) - RIM_WIDTH_M, rim.max(axis=0) + RIM_WIDTH_M
    count = 40
    x, y = np.meshgrid(*(np.linspace(a, b, count) for a, b in zip(low, high, strict=True)))
    grid = np.column_stack([x.ravel(), y.ravel()])
    rim_distance = np.asarray(cKDTree(rim).query(grid)[0])
    is_flat = np.abs(feature.final.displacement(grid)) <= FLAT_NOISE_M
    for other in part_shapes.features[:k]:
        is_flat &= np.abs(other.final.displacement(grid)) <= FLAT_NOISE_M
        is_flat &= np.asarray(cKDTree(other.final.rim).query(grid)[0]) > STATE_SPACING_M
    grid = grid[is_flat & (rim_distance < RIM_WIDTH_M - STATE_SPACING_M) & (rim_distance > STATE_SPACING_M)]
    return np.column_stack([grid, np.full(len(grid), part_shapes.level)])


def _missing_point_issues(
    state: SheetState, thickness: float, formed: FormedSheetPoints, sunk: float, flat: FloatArray
) -> Iterator[Issue]:
    """Check that a claim on the sheet's state has points near all points of formed sheet, on both faces.

    Args:
        state: Claim on the sheet's state.
        thickness: Thickness [m] of the flat sheet.
        formed: Points of the sheet when the feature starts.
        sunk: Displacement [m] along z by which an earlier pass has moved the carried points.
        flat: Points (M, 3) [m] of the flat sheet about the feature.
    """
    rise = np.array([0.0, 0.0, thickness])
    sheet_points = np.column_stack([formed.plan, formed.height])
    fixed_points = [sheet_points[formed.is_fixed], flat]
    carried_points = sheet_points[formed.is_carried]
    if sunk != 0.0:  # an earlier pass has moved them already, so they are fixed now
        fixed_points.append(carried_points + np.array([0.0, 0.0, sunk]))
        carried_points = carried_points[:0]
    for kind, required, claimed in (
        ("is fixed", np.concatenate(fixed_points), state.fixed),
        ("sinks", carried_points, state.carried),
    ):
        both_faces = np.concatenate([required, required + rise])
        if not len(both_faces):
            continue
        distance = np.full(len(both_faces), np.inf)
        if len(claimed):
            distance = np.asarray(cKDTree(claimed).query(both_faces)[0])
        k = int(np.argmax(distance))
        if distance[k] > STATE_SPACING_M:
            position = f"({format_point_mm(both_faces[k])}) mm"
            message = f"in {state.segment} no claim includes the sheet at {position}, which {kind}"
            yield _claims_issue(message, state.segment)
