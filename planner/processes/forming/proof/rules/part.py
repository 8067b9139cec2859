"""verify.forming_part: the faces of all passes, compared with the part.

Together they make up the part, each is formed where the sheet is then, in the required order, through shapes
that are no steeper than required.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull

from planner.geometry.arrays import hull_points, transform
from planner.issues import Issue
from planner.processes.forming.claims import FormsPart, FormsSheet
from planner.processes.forming.proof.formed_shapes import (
    FormedFeature,
    FormedShape,
    PartShapes,
    ordered_passes,
)
from planner.processes.forming.proof.forming_facts import FORMING, FormingFacts
from planner.proof.context import Context
from planner.proof.findings import (
    Findings,
    format_point_mm,
    measure_in_degrees,
    measure_in_mm,
    measure_in_percent,
)
from planner.proof.part_files.sheets import (
    SLOPE_STEP_M,
    largest_deviating_group,
    mesh_noise,
    vertex_deviations,
)
from planner.proof.rule import Measure, RuleOutcome, measured_issue, mm, rule

FORMING_PART = "verify.forming_part"
"""Code of this rule."""
FACE_TOLERANCE_M = 6e-5
"""Maximum deviation [m] from the part of the sheet that all passes form together: floors may be levelled
within the noise of their mesh.
"""
WITHIN_FRACTION = 0.99
"""Fraction of a noisy mesh's vertices that have to be within its tolerance of the formed sheet."""
MAX_DEVIATION_TOLERANCES = 2.5
"""Maximum deviation in tolerances: noise and rounded folds."""
GROUP_TOLERANCE_M, MAX_GROUP = 3e-5, 6
"""At most ``MAX_GROUP`` adjacent vertices may deviate to one side by more than the tolerance plus this [m].
"""
MAX_MEAN_TOLERANCES = 0.35
"""Maximum deviation of the mean at a location, in tolerances, in addition to its noise."""
MEAN_NOISE_FACTOR = 1.4
"""Noise of the mean in tolerances, times the square root of the number of vertices.

It is four standard deviations of the mean; a tolerance is three.
"""
MAX_TOLERANCE_FACTOR = 1.5
"""Maximum ratio of a mesh's tolerance to the proof's own estimate."""
ROUNDING_TOLERANCE = 1e-9
"""Tolerances [m] and fractions that differ by less are equal."""
RIM_TOLERANCE_M = 1.2e-4
"""Maximum distance [m] from the surrounding sheet at which a feature may start: twice `FLAT_NOISE_M`."""
PROTRUSION_TOLERANCE_M = 3e-4
"""Maximum distance [m] by which the sheet may protrude from the hulls of the part between stages, and from
the flat, unnoticed.
"""
RIM_FRACTION = 0.9
"""Fraction of the points on a feature's rim that count: in a noisy mesh others belong to adjacent sheet."""
NOT_RUN_REASON = "no part is to be formed"
"""Reason why this rule has not run."""
WALL_FRACTION = 0.995
"""Fraction of the walls that determines the angle of a shape: slivers are left out."""
ANGLE_TOLERANCE_RAD = np.deg2rad(1.0)
"""Tolerance [rad] of the angles of shapes: due to facets, and to walls that bend."""
MAX_FLATTENING_RAD = np.deg2rad(3.0)
"""Angle [rad] by which a shape may be flatter than its wall angle where it is not as deep as the part."""
MAX_FLATTENED_FRACTION = 0.05
"""Fraction of a shape's area that may be flatter still: creases, tips, and the last step to its floor."""
AREA_TOLERANCE_FRACTION = 0.02
"""Relative difference of areas up to which features at one place of the numbering may be exchanged."""


@rule("verify.forming_part", FormsPart)
def check_forming_part(context: Context) -> RuleOutcome:
    """The faces of all passes, of all operations that form some features of it, together make up the part and
    nothing else; each feature is formed by the tool on its side, from the level at which the sheet is then,
    in the required order, through intermediate shapes that are as steep as required and never beyond the
    part.
    """
    forming, findings = context.get(FORMING), Findings(FORMING_PART, context)
    last_part = next(
        (part_shapes for part_shapes, _ in reversed(forming.parts) if part_shapes is not None), None
    )
    findings.issues += _operation_issues(forming)
    for part_shapes, group in forming.parts:
        if part_shapes is None:
            for claim in ordered_passes(group):
                message = f"no claim states the part of which {claim.segment} is a face"
                findings.add(message, field=str(claim.segment))
            continue
        if not part_shapes.own_features:
            findings.add("the part is never formed", field="part")
            continue
        findings.issues += _tolerance_issues(context, part_shapes)
        if part_shapes.part.features is None or part_shapes is last_part:
            deviation, whole_issues = (
                _whole_part_issues(part_shapes)
                if part_shapes.part.mesh_tolerance == 0.0
                else _noisy_part_issues(part_shapes)
            )
            limit = FACE_TOLERANCE_M + part_shapes.part.mesh_tolerance
            findings.note_highest(deviation, part_shapes.features[0].final.claim.segment, limit)
            findings.issues += whole_issues
            findings.issues += [] if part_shapes.part.features is None else _numbering_issues(part_shapes)
        for k, feature in part_shapes.own_features:
            findings.issues += _side_issues(part_shapes, feature)
            findings.issues += _level_issues(part_shapes, k, feature)
            findings.issues += _intermediate_issues(part_shapes.part, feature)
        findings.issues += _order_issues(part_shapes)
        if part_shapes.part.features is not None or len(part_shapes.own_features) > 1:
            findings.issues += _protrusion_issues(context, part_shapes)
    return findings.outcome(mm, "mm", nothing=NOT_RUN_REASON)


def _operation_issues(forming: FormingFacts) -> Iterator[Issue]:
    """Check that operations form the features that they name, and no two operations the same ones."""
    formed: set[int] = set()
    is_split = any(
        part_shapes is not None and part_shapes.part.features is not None for part_shapes, _ in forming.parts
    )
    for part_shapes, _ in forming.parts if is_split else ():
        if part_shapes is None or not part_shapes.own_features:
            continue
        numbers = {feature.number for _, feature in part_shapes.own_features}
        required = numbers if part_shapes.part.features is None else set(part_shapes.part.features)
        if numbers != required:
            message = f"features {sorted(numbers)} are formed, required of this operation: {sorted(required)}"
            yield _part_issue(message, part_shapes.own_features[0][1])
        if formed & numbers:
            message = f"features {sorted(formed & numbers)} are formed by two operations"
            yield _part_issue(message, part_shapes.own_features[0][1])
        formed |= numbers


def _protrusion_issues(context: Context, part_shapes: PartShapes) -> Iterator[Issue]:
    """Check that the sheet stays, after each feature, inside the solids that bodies keep clear of.

    The collision checks use these solids in place of the sheet, so formed sheet outside of them would be
    missed. Sheet that is not moved off the flat is not checked.
    """
    sheet = context.problem.stock.sheet
    hulls = [] if sheet is None else [solid for solid in sheet.formed if solid.vertices is not None]
    hull_equations = [ConvexHull(transform(solid.pose, hull_points(solid))).equations for solid in hulls]
    for k, feature in part_shapes.own_features:
        moved = part_shapes.moved[: k + 1].sum(axis=0)
        is_moved = np.abs(moved) > PROTRUSION_TOLERANCE_M
        lower_points = np.column_stack([part_shapes.points, part_shapes.level + moved])[is_moved]
        points = np.concatenate(
            [lower_points, lower_points + np.array([0.0, 0.0, part_shapes.part.thickness])]
        )
        distance = np.full(len(points), np.inf)
        for equations in hull_equations:
            distance = np.minimum(distance, (points @ equations[:, :3].T + equations[:, 3]).max(axis=1))
        if len(distance) and float(distance.max()) > PROTRUSION_TOLERANCE_M:
            message = (
                f"once {feature.final.claim.segment} is formed the sheet protrudes from the solids that "
                f"bodies keep clear of, at ({format_point_mm(points[int(distance.argmax())])}) mm"
            )
            yield _part_issue(message, feature)


def _tolerance_issues(context: Context, part_shapes: PartShapes) -> Iterator[Issue]:
    """Check that the tolerance of a part's mesh is the user's own, or at most the deviation of the mesh's
    vertices from a smooth face.
    """
    part = part_shapes.part
    stated = stated_tolerance(context)
    if stated is not None:
        limit = stated
        is_valid = abs(part.mesh_tolerance - stated) <= ROUNDING_TOLERANCE
    elif part.mesh_tolerance == 0.0:
        return
    else:
        limit = MAX_TOLERANCE_FACTOR * mesh_noise(part.vertices, part.faces)
        is_valid = part.mesh_tolerance <= limit
    if not is_valid:
        message = f"the tolerance of the part's mesh is {mm(part.mesh_tolerance):.3f} mm, "
        message += f"{'stated' if stated is not None else 'allowed by its vertices'}: {mm(limit):.3f} mm"
        yield _part_issue(message, part_shapes.features[0], measure_in_mm(part.mesh_tolerance, limit))


def stated_tolerance(context: Context) -> float | None:
    """Return the user's tolerance [m] of a sheet part's mesh, or None if it has to be estimated."""
    statement = (context.problem.source.get("part") or {}).get("sheet_mesh")
    if statement:
        value = statement.get("tolerance_mm", "auto")
        return None if value == "auto" else float(value) / 1000.0
    formed = None if context.problem.part is None else context.problem.part.formed
    return None if formed is None else formed.stated_tolerance


def _noisy_part_issues(part_shapes: PartShapes) -> tuple[float, list[Issue]]:
    """Compare the vertices of a part with noise with the sheet that all features form together.

    Each of these conditions is an issue:

    - More than 1 % of the vertices deviate by more than the tolerance.
    - One vertex deviates by more than two and a half tolerances.
    - The mean deviation at some location is larger than noise permits.
    - More than `MAX_GROUP` adjacent vertices deviate to one side.
    - The edge of the part is off the flat sheet.

    Returns:
        Deviation [m] that `WITHIN_FRACTION` of the vertices do not exceed, and issues.
    """
    part, issues = part_shapes.part, []
    used, index = np.unique(part.faces, return_inverse=True)
    vertices, triangles = part.vertices[used], np.asarray(index).reshape(-1, 3)
    points = vertices[:, :2]
    height = part_shapes.sheet_height(np.arange(len(part_shapes.features)), points)
    slopes = []
    for axis in np.eye(2) * SLOPE_STEP_M:
        upper, lower = (
            part_shapes.sheet_height(np.arange(len(part_shapes.features)), points + sign * axis)
            for sign in (1.0, -1.0)
        )
        slopes.append(np.maximum(np.abs(upper - height), np.abs(lower - height)) / SLOPE_STEP_M)
    steep = 1.0 / np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
    scatter_result = vertex_deviations(vertices, height, steep)
    tolerance = part.mesh_tolerance
    deviation = np.abs(scatter_result.deviation)
    quantile_deviation = float(np.quantile(deviation, WITHIN_FRACTION))
    order = np.argsort(deviation)
    quantile_index = int(order[min(int(WITHIN_FRACTION * len(deviation)), len(deviation) - 1)])
    for value, k, limit, description in (
        (quantile_deviation, quantile_index, FACE_TOLERANCE_M + tolerance, "1 % of its vertices by"),
        (
            float(deviation.max()),
            int(order[-1]),
            FACE_TOLERANCE_M + MAX_DEVIATION_TOLERANCES * tolerance,
            "a vertex by",
        ),
    ):
        if value > limit:
            message = (
                f"all passes together leave the sheet off the part, at ({format_point_mm(vertices[k])}) mm, "
            )
            issues.append(
                _part_issue(
                    f"{message}{description} {mm(value):.3f} mm",
                    part_shapes.features[0],
                    measure_in_mm(value, limit),
                )
            )
    allowed = FACE_TOLERANCE_M + tolerance * (
        MAX_MEAN_TOLERANCES + MEAN_NOISE_FACTOR / np.sqrt(scatter_result.number)
    )
    if len(scatter_result.mean) and (np.abs(scatter_result.mean) > allowed).any():
        k = int(np.argmax(np.abs(scatter_result.mean) - allowed))
        value = abs(float(scatter_result.mean[k]))
        message = (
            f"about ({format_point_mm(scatter_result.middle[k])}) mm all passes together leave the sheet "
            f"{mm(value):.3f} mm off the part on average, which noise does not explain"
        )
        issues.append(_part_issue(message, part_shapes.features[0], measure_in_mm(value, allowed[k])))
    limit = GROUP_TOLERANCE_M + max(tolerance, mesh_noise(part.vertices, part.faces))
    group = largest_deviating_group(triangles, scatter_result.deviation, limit)
    if len(group) > MAX_GROUP:
        value = float(deviation[group].max())
        middle = format_point_mm(vertices[group].mean(axis=0))
        message = (
            f"about ({middle}) mm {len(group)} adjacent vertices are off what all passes make, by up "
            f"to {mm(value):.3f} mm to one side, which noise does not explain"
        )
        issues.append(_part_issue(message, part_shapes.features[0], measure_in_mm(value, limit)))
    return quantile_deviation, [*issues, *_edge_issues(part_shapes, FACE_TOLERANCE_M + tolerance)]


def _edge_issues(part_shapes: PartShapes, limit: float) -> Iterator[Issue]:
    """Check that the part's edge is at the flat sheet, within a limit [m]."""
    if abs(part_shapes.level) > limit:
        message = f"the part's edge is {mm(abs(part_shapes.level)):.3f} mm off the flat sheet"
        yield _part_issue(message, part_shapes.features[0], measure_in_mm(abs(part_shapes.level), limit))


def _whole_part_issues(part_shapes: PartShapes) -> tuple[float, list[Issue]]:
    """Return the maximum deviation [m] of the part from the sheet that all features form, and issues."""
    deviation = np.abs(part_shapes.moved.sum(axis=0) - part_shapes.nominal) * part_shapes.steep
    worst_index = int(np.argmax(deviation))
    issues = []
    if deviation[worst_index] > FACE_TOLERANCE_M:
        message = (
            f"at ({format_point_mm(part_shapes.points[worst_index])}) mm all passes together leave the sheet "
        )
        message += f"{mm(deviation[worst_index]):.3f} mm off the part"
        issues.append(
            _part_issue(
                message, part_shapes.features[0], measure_in_mm(deviation[worst_index], FACE_TOLERANCE_M)
            )
        )
    return float(deviation[worst_index]), [*issues, *_edge_issues(part_shapes, FACE_TOLERANCE_M)]


def _side_issues(shapes: PartShapes, feature: FormedFeature) -> Iterator[Issue]:
    """Check that the tool on the correct side forms a feature, and that its walls go in one direction.

    The wall of each shape has to lead from the surrounding flat away from the tool that forms it, or toward
    it over a male die, without turning back. It has to end at the claimed level.
    """
    part = shapes.part
    for shape in feature.shapes:
        for claim in shape.claims:
            arm = claim.arm if isinstance(claim, FormsSheet) else claim.arms[0]
            if (arm, claim.side) not in zip(part.arms, part.sides, strict=True):
                message = f"{arm} is not the tool on the side from which {claim.segment} is formed"
                yield _part_issue(message, feature)
        sign = float(shape.claim.side if part.male else -shape.claim.side)
        heights = sign * (shape.corners[:, :, 2] - shape.base)
        if heights.min() < -FACE_TOLERANCE_M:
            message = f"{shape.claim.segment} goes {mm(-heights.min()):.3f} mm toward the tool that forms it"
            yield _part_issue(message, feature, measure_in_mm(-heights.min(), FACE_TOLERANCE_M))
        if abs(float(heights.max()) - sign * (shape.end_level - shape.base)) > FACE_TOLERANCE_M:
            yield _part_issue(f"{shape.claim.segment} does not end at the level that is claimed", feature)
        turn_back_point = shape.turn_back_point(sign)
        if turn_back_point is not None:
            position = f"({format_point_mm(turn_back_point)}) mm"
            message = f"the wall of {shape.claim.segment} turns back, or splits, at {position}"
            yield _part_issue(message, feature)


def _level_issues(part_shapes: PartShapes, k: int, feature: FormedFeature) -> Iterator[Issue]:
    """Check that the shapes of feature ``k`` start at the sheet as features 0 to k - 1 leave it around it."""
    points = feature.final.rim
    if not len(points):
        yield _part_issue(f"{feature.final.claim.segment} starts nowhere on the sheet", feature)
        return
    sheet_height = part_shapes.sheet_height(np.arange(k), points)
    for shape in feature.shapes:
        lower_face_level = shape.base - (part_shapes.part.thickness if shape.claim.side > 0 else 0.0)
        distance = float(np.quantile(np.abs(sheet_height - lower_face_level), RIM_FRACTION))
        if distance > RIM_TOLERANCE_M:
            message = f"{shape.claim.segment} starts {mm(distance):.3f} mm off the sheet as it is then"
            yield _part_issue(message, feature, measure_in_mm(distance, RIM_TOLERANCE_M))


def _order_issues(part_shapes: PartShapes) -> Iterator[Issue]:
    """Check that features come in the required order: the user's own, or that of their nesting.

    Without an order of the user's own, inner features come first in the strategy virgin, and outer ones
    otherwise. Features of earlier operations are not checked.
    """
    numbers = [feature.number for feature in part_shapes.features]
    if part_shapes.part.order is not None:
        own_numbers = numbers[part_shapes.first :]
        if tuple(own_numbers) != part_shapes.part.order:
            message = f"features come in the order {own_numbers}, required: {list(part_shapes.part.order)}"
            yield _part_issue(message, part_shapes.own_features[0][1])
            return
        yield from _numbering_issues(part_shapes) if part_shapes.part.features is None else ()
        return
    for inner, outer in np.argwhere(part_shapes.inside).tolist():
        if min(inner, outer) < part_shapes.first:
            continue  # both were formed by earlier operations
        first, second = (inner, outer) if part_shapes.part.virgin else (outer, inner)
        if first > second:
            message = f"f{numbers[second]} is formed before f{numbers[first]}, required: "
            message += "inner features first" if part_shapes.part.virgin else "outer features first"
            yield _part_issue(message, part_shapes.features[second])


def _numbering_issues(part_shapes: PartShapes) -> Iterator[Issue]:
    """Check that features have the numbers that are shown to users.

    A feature has a lower number than those inside it. Features directly inside the same one are numbered by
    area, the largest first. Those of nearly equal area may be exchanged.
    """
    count = len(part_shapes.features)
    parents = []
    for k in range(count):
        enclosing = np.flatnonzero(part_shapes.inside[k])
        parents.append(int(enclosing[np.argmin(part_shapes.area[enclosing])]) if len(enclosing) else -1)
    order: list[int] = []
    pending = [-1]
    while pending:
        parent = pending.pop()
        if parent >= 0:
            order.append(parent)
        pending += sorted(
            (k for k in range(count) if parents[k] == parent), key=lambda k: float(part_shapes.area[k])
        )
    for number, k in enumerate(order, start=1):
        with_number = [j for j in range(count) if part_shapes.features[j].number == number]
        exchangeable = [
            j
            for j in with_number
            if parents[j] == parents[k] and _is_same_area(part_shapes.area[j], part_shapes.area[k])
        ]
        if k not in with_number and not exchangeable:
            message = (
                f"the feature that is formed as f{part_shapes.features[k].number} is number {number} of the "
                "part"
            )
            yield _part_issue(message, part_shapes.features[k])


def _is_same_area(area: float, other_area: float) -> bool:
    return abs(area - other_area) <= AREA_TOLERANCE_FRACTION * max(area, other_area)


def _intermediate_issues(part: FormsPart, feature: FormedFeature) -> Iterator[Issue]:
    """Check that the shapes before the final one are as many and as steep as required.

    Each must be run as often as required, be at least as deep as the shapes before it, and have its wall
    angle wherever it is not as deep as the final shape.
    """
    final = feature.final
    angles = [shape.wall_angle(WALL_FRACTION) for shape in feature.shapes]
    for shape in feature.shapes:
        if len(shape.claims) != part.repeats:
            message = f"{shape.claim.segment} is run {len(shape.claims)} times, required: {part.repeats}"
            yield _part_issue(message, feature, (len(shape.claims), part.repeats, None))
    yield from _angle_issues(part, feature, angles)
    points = final.spread_points(4000)[:, :2]
    sign = -1.0 if final.end_level < final.base else 1.0
    previous_depth, wall_cosine = np.zeros(len(points)), float(np.cos(angles[-1]))
    for shape in feature.shapes:
        depth = sign * shape.displacement(points)
        missing_depth = float((previous_depth - depth).max()) * wall_cosine
        if missing_depth > FACE_TOLERANCE_M * 2:
            message = (
                f"{shape.claim.segment} is {mm(missing_depth):.3f} mm less deep than what is formed before"
            )
            yield _part_issue(message, feature, measure_in_mm(missing_depth, 2 * FACE_TOLERANCE_M))
        previous_depth = np.maximum(previous_depth, depth)
    for shape, angle in zip(feature.shapes[:-1], angles, strict=False):
        fraction = _flattened_fraction(shape, final, angle, sign)
        if fraction > MAX_FLATTENED_FRACTION:
            message = (
                f"{100 * fraction:.1f} % of {shape.claim.segment} are neither on the part nor as steep as "
                f"the shape's {np.rad2deg(angle):.1f} deg"
            )
            yield _part_issue(message, feature, measure_in_percent(fraction, MAX_FLATTENED_FRACTION))


def _angle_issues(part: FormsPart, feature: FormedFeature, angles: list[float]) -> Iterator[Issue]:
    """Check the wall angles [rad] of a feature's shapes, so that no pass stretches the metal too far.

    In mode adsif and over a male die a feature has one shape only. If the user states angles, the shapes have
    these angles, as far as they are below that of the final shape. Otherwise the first shape may have the
    metal's limit, and each further one an angle step more than the one before, or the limit if that is more.
    """
    if part.mode == "adsif" or part.male:
        if len(angles) != 1:
            message = (
                f"{feature.final.claim.segment} is formed through other shapes, which this mode excludes"
            )
            yield _part_issue(message, feature)
        return
    if part.passes is not None:
        required = [angle for angle in part.passes if angle < angles[-1] - ANGLE_TOLERANCE_RAD]
        permitted = [angle for angle in part.passes if angle < angles[-1] + ANGLE_TOLERANCE_RAD]
        is_valid = len(required) <= len(angles) - 1 <= len(permitted)
        is_valid = is_valid and all(
            abs(a - b) <= ANGLE_TOLERANCE_RAD
            for a, b in zip(angles, part.passes, strict=False)
            if b in required
        )
        if not is_valid:
            actual = ", ".join(f"{np.rad2deg(a):.1f}" for a in angles)
            message = f"the shapes of f{feature.number} have walls of {actual} deg, other than required"
            yield _part_issue(message, feature)
        return
    previous_angle = part.limit - part.angle_step
    for shape, angle in zip(feature.shapes, angles, strict=True):
        # the part's own angle is known only as far as its walls bend
        if angle > max(previous_angle + part.angle_step, part.limit) + ANGLE_TOLERANCE_RAD:
            message = f"{shape.claim.segment} has a wall of {np.rad2deg(angle):.1f} deg in one pass"
            yield _part_issue(
                message, feature, measure_in_degrees(angle, max(previous_angle + part.angle_step, part.limit))
            )
        previous_angle = angle


def _flattened_fraction(shape: FormedShape, final: FormedShape, angle: float, sign: float) -> float:
    """Return the fraction of a shape's area that is flatter than ``angle`` [rad] but not at its final depth.

    ``final`` is the shape with the final depths. ``sign`` is -1 if the feature goes down, and +1 if it goes
    up. Triangles count as flatter if their angle is smaller by more than MAX_FLATTENING_RAD.
    """
    corners = shape.corners[shape.moved]
    triangle_angle, area = shape.angles_and_areas
    middle = corners.mean(axis=1)
    missing_depth = sign * (final.displacement(middle[:, :2]) - (middle[:, 2] - shape.base))
    is_flattened = (triangle_angle < angle - MAX_FLATTENING_RAD) & (missing_depth > 2e-4)
    return float(area[is_flattened].sum() / max(float(area.sum()), 1e-30))


def _part_issue(message: str, feature: FormedFeature, measure: Measure | None = None) -> Issue:
    return measured_issue(FORMING_PART, message, measure, field=str(feature.final.claim.segment))
