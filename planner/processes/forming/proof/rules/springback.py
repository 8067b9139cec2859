"""verify.springback: tools that go deeper than the part to compensate springback.

The problem names a file of shifts. All other rules about sheets judge the tools without these shifts, so the
file has to be correct. Its job, limits and forces are compared with the problem; its shifts with its control
points, by the proof's own interpolation, slope limit and averaging; its path with the replayed path; and a
few control points with an elastic sheet on another mesh with another type of membrane element.
"""

import dataclasses
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.units import MM
from planner.issues import Issue
from planner.processes.forming.claims import CompensatesSpringback, FormsPart, FormsSheet
from planner.processes.forming.proof import (
    elastic_sheet,
    loop_walls,
    scan_field,
    springback_bounds,
    springback_file,
)
from planner.processes.forming.proof.compensation import CompensationClaim
from planner.processes.forming.proof.formed_shapes import PartShapes
from planner.processes.forming.proof.forming_facts import FORMING, FormedPass, FormingFacts
from planner.processes.forming.proof.rules.springback_forces import (
    CODE,
    claim_group,
    force_issues,
    forces_along,
    formula_forces,
    springback_issue,
)
from planner.processes.forming.proof.springback_bounds import POINT_SPACING_M, FilePass
from planner.processes.forming.proof.springback_file import FileControlPoint, FilePath, ScanData
from planner.proof.context import Context
from planner.proof.findings import Findings, measure_in_degrees, measure_in_mm, measure_in_percent, to_percent
from planner.proof.rule import RuleOutcome, mm, rule, sample_issue

NOT_RUN_REASON = "no tool goes deeper than the part"
"""Reason why it has not run."""
MIN_RECALCULATED = 5
"""Minimum number of control points that are recalculated, if so many are near the path."""
MAX_DRAWS = 400
"""Maximum number of points that are drawn at random to find these control points."""
MESH_TOLERANCE_FRACTION, MESH_TOLERANCE_M = 0.03, 2e-5
"""Tolerance of the recalculated springback, as a fraction, plus a constant [m]: two meshes differ."""
MAX_PATH_DISTANCE_M = 1e-4
"""Maximum distance [m] of the replayed path from the file's while it forms."""
INTERPOLATION_TOLERANCE_FRACTION = 0.05
"""Tolerance of shifts, as a fraction of the springback that is interpolated between control points."""
MAX_TOUCH_DISTANCE_M = 3e-4
"""Maximum distance [m] of control points from the points that the tool touches."""
MIN_LEVEL_DISTANCE_M = 1e-5
"""Minimum difference [m] in height of levels."""
ANGLE_RADIUS_M = 1.5e-3
"""A control point is on all walls within this distance [m]."""
ANGLE_TOLERANCE_RAD = np.deg2rad(2.0)
"""Tolerance [rad] of the wall angles of control points compared with the part's."""
CORNER_ANGLE_TOLERANCE_RAD = np.deg2rad(10.0)
"""Tolerance [rad] of the wall angles of control points in corners where the ball does not fit."""
RECALCULATED_POINTS = 3
"""Number of points anywhere on the paths at which shifts are recalculated."""
LEVEL_DIFFERENCE_FRACTION = 0.35
"""Tolerance of shifts between levels, as a fraction of the difference of the levels under the force there:
where a tool rolls onto the floor, one level is on the wall's edge and the next one on the floor.
"""
CURVE_END_FACTOR = 1.5
"""Curves that continue to more than this multiple of the force of their point are recalculated at their end
as well.
"""
MAX_PATH_POINTS = 60_000
"""Maximum number of points of a path."""
NO_CURVE = np.zeros(0)
"""Curve of a point that is not a control point."""
SCAN_TOLERANCE_M = 1e-4
"""Tolerance [m] of shifts that follow from a scan, in addition to `INTERPOLATION_TOLERANCE_FRACTION`."""
ON_PART_TOLERANCE_M = 1.5e-4
"""A pass forms the part's own face if half of its path is within this distance [m] of it."""
MIN_COVERED_FRACTION = 0.6
"""Minimum fraction of a path that a scan has to cover."""
COMPENSATED_MODES = frozenset({"spif", "dsif", "dpif_l", "heat"})
"""Modes in which the formed sheet springs back as one elastic sheet, and no tool holds its border."""


@rule("verify.springback", CompensatesSpringback)
def check_springback(context: Context) -> RuleOutcome:
    """Tools that go deeper than the part do so alike, as the problem's springback file states; that belongs
    to this very job, is within its limits, makes no wall steeper than the metal allows, and an elastic sheet
    springs back as it states, at points drawn at random.
    """
    forming, findings = context.get(FORMING), Findings(CODE, context, worst=0.0)
    findings.issues += _unclaimed_issues(context, forming)
    for compensation in forming.compensations:
        if compensation.file is None:
            findings.issues.append(springback_issue(compensation, compensation.fault))
            continue
        if compensation.file.measured is not None or compensation.operation.springback.scan is not None:
            deviation, found_issues = _scan_issues(context, forming, compensation)
            found_issues += [
                *_identity_issues(context, compensation),
                *_limit_issues(compensation),
                *_path_issues(context, forming, compensation),
            ]
            findings.issues += [*found_issues, *_wall_issues(context, forming, compensation)]
        else:
            found_issues = [
                *_identity_issues(context, compensation),
                *_limit_issues(compensation),
                *force_issues(context, compensation),
            ]
            passes = [] if found_issues else list(_file_passes(context, forming, compensation))
            found_issues += _control_point_issues(compensation, passes)
            found_issues += _shift_issues(compensation, passes) if not found_issues else []
            found_issues += _path_issues(context, forming, compensation)
            found_issues += _wall_issues(context, forming, compensation)
            findings.issues += found_issues
            if found_issues:
                continue  # with these issues a recalculation is pointless
            deviation, solved = _elastic_issues(context, forming, compensation, passes)
            findings.issues += solved
        if deviation >= findings.worst:
            findings.worst, findings.where = deviation, compensation.claim.operation
    if not forming.compensations:
        return findings.outcome_without_value(NOT_RUN_REASON)
    return findings.outcome(to_percent, "% of the tolerance of two meshes", 1.0)


def _unclaimed_issues(context: Context, forming: FormingFacts) -> Iterator[Issue]:
    """Check that each operation with a springback file has a claim for it, which covers all of its passes.

    Without the claim no other check of this rule would apply to the operation.
    """
    claimed = {compensation.claim.operation: compensation for compensation in forming.compensations}
    for operation in context.problem.operations:
        if getattr(operation, "springback", None) is not None and operation.name not in claimed:
            message = f"{operation.name} names a springback file, and nothing is claimed of it"
            yield Issue(CODE, message, field="springback")
    for index, claim in forming.by_setup:
        if not isinstance(claim, FormsSheet):
            continue
        for compensation in claimed.values():
            group = claim_group(context, compensation)
            if (
                index == compensation.index
                and claim in group
                and claim.segment not in compensation.claim.segments
            ):
                yield springback_issue(compensation, f"{claim.segment} is left out of what goes deeper")


def _part_shapes(forming: FormingFacts, compensation: CompensationClaim) -> PartShapes | None:
    return next((shapes for shapes, group in forming.parts if compensation.claim in group), None)


def _identity_issues(context: Context, compensation: CompensationClaim) -> Iterator[Issue]:
    """Check that the file belongs to this part, sheet, tools and operation, and has the claimed passes."""
    springback_data = compensation.file
    own_identity = springback_file.job_identity_of(
        context.problem, context.setups[compensation.index], compensation.operation
    )
    if springback_data is None or own_identity is None:
        yield springback_issue(compensation, "there is no sheet that springs back")
        return
    for name in springback_file.differing_names(springback_data.belongs, own_identity):
        in_file, in_job = springback_data.belongs.get(name), own_identity.get(name)
        yield springback_issue(
            compensation, f"its springback file is of another job: {name} is {in_file}, here {in_job}"
        )
    if compensation.operation.mode not in COMPENSATED_MODES:
        message = f"in mode {compensation.operation.mode} the springback of the sheet is not known"
        yield springback_issue(compensation, message)
    names = {segment.name for segment in compensation.claim.segments}
    if names != set(springback_data.paths):
        message = f"its springback file has the passes {sorted(springback_data.paths)}, here {sorted(names)}"
        yield springback_issue(compensation, message)


def _limit_issues(compensation: CompensationClaim) -> Iterator[Issue]:
    """Check that shifts go into the sheet, and keep the maximum and the slope that the problem allows."""
    stated = compensation.operation.springback
    for name, file_path in ({} if compensation.file is None else compensation.file.paths).items():
        for fault, got, limit, unit in file_path.faults(float(stated.slope), float(stated.most_mm) * MM):
            message = f"{name} has {fault} in its springback file: {got:.4g} {unit}, allowed: {limit:g}"
            yield springback_issue(compensation, message, (got, limit, unit or None))


def _file_passes(
    context: Context, forming: FormingFacts, compensation: CompensationClaim
) -> Iterator[FilePass]:
    """Yield the file's data of each claimed pass, sampled at points along its path, for the checks below.

    At each point they have the touched point of the face, the wall angle, the force, the ring of the path,
    and the rise. Passes that the file does not have, or for which it has no control points, are left out.
    """
    for formed in forming.formed:
        claim = formed.claim
        if (
            compensation.file is None
            or formed.setup != compensation.index
            or claim.segment not in compensation.claim.segments
        ):
            continue
        file_path = compensation.file.paths.get(claim.segment.name)
        controls = tuple(c for c in compensation.file.controls if c.segment == claim.segment.name)
        if file_path is None or not controls:
            continue
        arc, centre, ring = _resample(file_path)
        nearest = formed.face.nearest(centre)
        up = np.abs(centre[:, 2] - nearest.point[:, 2]) / np.maximum(nearest.distance, 1e-9)
        stated = compensation.operation.stepdown_mm
        # rise: by how much the touched points of a ring differ in height, at most two steps or the radius
        max_rise = claim.radius if stated is None else 2.0 * float(stated) * MM
        rise = np.zeros(len(arc))
        for k in np.unique(ring):
            is_on_ring = ring == k
            rise[is_on_ring] = min(float(np.ptp(nearest.point[is_on_ring, 2])), max_rise)
        angle = np.arccos(np.clip(up, 0.0, 1.0))
        force = forces_along(context, compensation, claim, nearest.point, angle, controls)
        yield FilePass(claim, formed.face, file_path, controls, arc, nearest.point, angle, force, ring, rise)


def _resample(file_path: FilePath) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return points about `POINT_SPACING_M` apart on a path of the file.

    Returns:
        Arc lengths (P,) [m], centres (P, 3) [m] of the ball, and the index (P,) of the ring of each point.
    """
    path_arc = springback_bounds.arc_lengths(file_path.point)
    count = int(min(MAX_PATH_POINTS, np.ceil(path_arc[-1] / POINT_SPACING_M))) + 1
    arc = np.linspace(0.0, float(path_arc[-1]), count)
    centre = np.stack([np.interp(arc, path_arc, file_path.point[:, axis]) for axis in range(3)], axis=1)
    return arc, centre, file_path.ring[np.clip(np.searchsorted(path_arc, arc), 0, len(file_path.ring) - 1)]


def _scan_issues(
    context: Context, forming: FormingFacts, compensation: CompensationClaim
) -> tuple[float, list[Issue]]:
    """Compare the shifts of a file of adjustments with those that the proof calculates from the scan.

    The position of the scan is checked by its flat, which must be at the flat of the sheet, and by its marks,
    which must fit hardly worse than in the best fit.

    Returns:
        Maximum deviation as a fraction of the allowed one, and issues.
    """
    springback_data, stated = compensation.file, compensation.operation.springback
    stock = context.setups[compensation.index].stock
    part = context.problem.part
    if (
        springback_data is None
        or springback_data.measured is None
        or stated.scan is None
        or part is None
        or part.formed is None
    ):
        return 0.0, [
            springback_issue(compensation, "its file does not match the scan that the problem names")
        ]
    scan = springback_data.measured
    issues: list[Issue] = []
    try:
        points = scan_field.read_scan(Path(stated.scan.file), scan)
    except ValueError as error:
        return 0.0, [springback_issue(compensation, f"{Path(stated.scan.file).name}: {error}")]
    field = scan_field.ScanField(part.formed.mesh, stock.size, scan.is_top, points)
    flat_deviation, corner_count = field.flat_deviation()
    mark_excess = scan_field.mark_excess(scan)
    if flat_deviation > scan_field.MAX_FLAT_DEVIATION_M or not corner_count:
        message = f"the flat of its scan is {mm(flat_deviation):.3f} mm off that of the sheet"
        issues.append(
            springback_issue(
                compensation, message, measure_in_mm(flat_deviation, scan_field.MAX_FLAT_DEVIATION_M)
            )
        )
    if mark_excess > scan_field.MAX_MARK_EXCESS_M:
        message = f"its scan is {mm(mark_excess):.3f} mm farther from its marks than the best fit"
        issues.append(
            springback_issue(compensation, message, measure_in_mm(mark_excess, scan_field.MAX_MARK_EXCESS_M))
        )
    worst = max(flat_deviation / scan_field.MAX_FLAT_DEVIATION_M, mark_excess / scan_field.MAX_MARK_EXCESS_M)
    for formed in forming.formed:
        claim, file_path = formed.claim, springback_data.paths.get(formed.claim.segment.name)
        if (
            formed.setup != compensation.index
            or claim.segment not in compensation.claim.segments
            or file_path is None
        ):
            continue
        deviation, pass_issues = _pass_scan_issues(
            compensation, field, scan, formed, file_path, float(stock.size[2])
        )
        worst = max(worst, deviation)
        issues = [*issues, *pass_issues]
    return worst, issues


def _pass_scan_issues(
    compensation: CompensationClaim,
    field: scan_field.ScanField,
    scan: ScanData,
    formed: FormedPass,
    file_path: FilePath,
    thickness: float,
) -> tuple[float, list[Issue]]:
    """Compare the shifts of one pass with those that follow from the scan.

    A pass that does not form the part's own face, such as one over an intermediate shape, has to keep the
    shifts with which the scanned part was formed. ``thickness`` is that of the flat sheet [m].

    Returns:
        Maximum deviation as a fraction of the allowed one, infinite if the shifts cannot be compared, and at
        most one issue.
    """
    claim, springback_data = formed.claim, compensation.file
    name = claim.segment.name
    arc, centre, _ = _resample(file_path)
    touch = formed.face.nearest(centre).point
    previous_path = None if springback_data is None else springback_data.previous_paths.get(name)
    previous_shift = scan_field.ShiftProfile(arc=np.zeros(1), shift=np.zeros(1))
    if previous_path is not None:
        previous_arc = springback_bounds.arc_lengths(previous_path.point)
        previous_shift = scan_field.ShiftProfile(
            arc=previous_arc * (arc[-1] / max(float(previous_arc[-1]), 1e-9)), shift=previous_path.shift
        )
    part_height = field.part_height(touch[:, :2]) + (thickness if claim.side > 0 else 0.0)
    forms_part = float(np.nanmedian(np.abs(part_height - touch[:, 2]))) <= ON_PART_TOLERANCE_M
    if forms_part != (name in scan.adjusts):
        message = f"{name} {'forms' if forms_part else 'does not form'} the part's own face, and its file "
        message += "leaves it as it was" if forms_part else "adjusts it by the scan"
        return np.inf, [springback_issue(compensation, message)]
    actual = np.interp(arc, springback_bounds.arc_lengths(file_path.point), file_path.shift)
    slope = float(compensation.operation.springback.slope)
    if forms_part:
        touched_path = scan_field.TouchedPath(
            plan=touch[:, :2], arc=arc, side=claim.side, radius=claim.radius
        )
        minimum, maximum, covered = scan_field.shift_bounds(field, scan, previous_shift, touched_path, slope)
        if covered < MIN_COVERED_FRACTION:
            message = f"its scan covers {100.0 * covered:.0f} % of the path of {name}"
            return np.inf, [
                springback_issue(compensation, message, measure_in_percent(covered, MIN_COVERED_FRACTION))
            ]
    else:
        minimum = maximum = np.interp(arc, previous_shift.arc, previous_shift.shift)
    expected = np.clip(actual, minimum, maximum)
    deviation = np.abs(actual - expected)
    allowed = (
        # last term: change of the shift over half of the spacing of the points
        SCAN_TOLERANCE_M + INTERPOLATION_TOLERANCE_FRACTION * np.abs(expected) + 0.5 * slope * POINT_SPACING_M
    )
    worst_index = int(np.argmax(deviation / allowed))
    if deviation[worst_index] <= allowed[worst_index]:
        return float(deviation[worst_index] / allowed[worst_index]), []
    message = (
        f"{name} is shifted by {mm(actual[worst_index]):.3f} mm at {arc[worst_index] / MM:.0f} mm of its "
        "path, its scan and the "
        f"shifts of the scanned part give {mm(expected[worst_index]):.3f} mm"
    )
    return float(deviation[worst_index] / allowed[worst_index]), [
        springback_issue(compensation, message, measure_in_mm(deviation[worst_index], allowed[worst_index]))
    ]


def _control_point_issues(compensation: CompensationClaim, passes: Sequence[FilePass]) -> Iterator[Issue]:
    """Check that the control points of a file represent the passes on which its shifts are interpolated.

    For each pass these conditions are checked:

    - The forming tool touches the part at each control point. If it does not, the other conditions of this
      pass are not checked.
    - The wall there has the stated angle, if forces follow by formula from the angle.
    - The points of a level are on one loop.
    - No point occurs twice, and no two levels have the same height.
    - The levels cover the height of the pass.

    Of wrong angles and of points off their loop only the first one in a pass is reported.
    """
    for file_pass in passes:
        tree = cKDTree(file_pass.touch)
        points = np.array([control.point for control in file_pass.controls])
        nearest = file_pass.face.nearest(points, ANGLE_RADIUS_M)
        distance = np.asarray(tree.query(points)[0])
        # in corners where the ball does not fit, a control point may be next to the ball without contact
        is_in_corner = (
            (nearest.distance <= MAX_TOUCH_DISTANCE_M)
            & (distance <= file_pass.claim.radius)
            & (distance > 0.5 * POINT_SPACING_M + MAX_TOUCH_DISTANCE_M)
        )
        distance = np.where(is_in_corner, 0.0, distance)
        k = int(np.argmax(distance))
        if distance[k] > 0.5 * POINT_SPACING_M + MAX_TOUCH_DISTANCE_M:
            x, y, z = points[k] / MM
            message = f"a control point of {file_pass.claim.segment} at ({x:.1f}, {y:.1f}, {z:.1f}) mm is "
            message += f"{mm(distance[k]):.2f} mm off what the tool touches"
            yield springback_issue(
                compensation,
                message,
                measure_in_mm(distance[k], 0.5 * POINT_SPACING_M + MAX_TOUCH_DISTANCE_M),
            )
            continue
        normal = file_pass.face.normal[nearest.triangle]
        # angles matter only for forces by formula
        has_formula = compensation.operation.force_n is None and compensation.operation.force_by is None
        for row, control in enumerate(file_pass.controls) if has_formula else ():
            around = tree.query_ball_point(points[row], ANGLE_RADIUS_M)
            walls = np.unique(normal[nearest.row == row].round(6), axis=0)
            mean = walls.sum(axis=0, keepdims=True)  # on an edge the ball rolls from one wall to the other
            walls = np.concatenate([walls, mean / np.linalg.norm(mean)])
            angles = np.append(file_pass.angle[around], np.arccos(np.clip(np.abs(walls[:, 2]), 0.0, 1.0)))
            angle_error = max(float(angles.min()) - control.angle, control.angle - float(angles.max()))
            if angle_error > (CORNER_ANGLE_TOLERANCE_RAD if is_in_corner[row] else ANGLE_TOLERANCE_RAD):
                message = f"a control point of {file_pass.claim.segment} is on a wall of "
                message += f"{np.rad2deg(control.angle):.1f} deg, where the part has "
                message += f"{np.rad2deg(angles.min()):.1f} to {np.rad2deg(angles.max()):.1f} deg"
                yield springback_issue(
                    compensation, message, measure_in_degrees(angle_error, ANGLE_TOLERANCE_RAD)
                )
                break
        height, _ = file_pass.level_groups()
        tolerance = float(file_pass.rise.max()) + MAX_TOUCH_DISTANCE_M
        for row, control in enumerate(file_pass.controls):
            if abs(control.point[2] - height[control.level]) > tolerance:
                message = (
                    f"control points of level {control.level} of {file_pass.claim.segment} are of several "
                    "loops"
                )
                yield springback_issue(
                    compensation,
                    message,
                    measure_in_mm(abs(points[row, 2] - height[control.level]), tolerance),
                )
                break
        if len(np.unique(points.round(7), axis=0)) < len(points):
            yield springback_issue(
                compensation, f"control points of {file_pass.claim.segment} are named twice"
            )
        level_distance = float(np.diff(sorted(height.values())).min(initial=np.inf))
        if not level_distance > MIN_LEVEL_DISTANCE_M:
            message = f"two levels of {file_pass.claim.segment} are at one height"
            yield springback_issue(compensation, message, measure_in_mm(level_distance, MIN_LEVEL_DISTANCE_M))
        low, high = float(file_pass.touch[:, 2].min()), float(file_pass.touch[:, 2].max())
        uncovered = max(min(height.values()) - low, high - max(height.values()))
        if uncovered > tolerance:
            message = (
                f"the levels of {file_pass.claim.segment} leave {mm(uncovered):.2f} mm of its depth without "
                "a level"
            )
            yield springback_issue(compensation, message, measure_in_mm(uncovered, tolerance))


def _shift_issues(compensation: CompensationClaim, passes: Sequence[FilePass]) -> Iterator[Issue]:
    """Check that the shifts of a file follow from its control points, one issue for each pass.

    The expected shift is the springback that is interpolated between the control points, then limited in
    slope, and then averaged over the ball's radius on either side.
    """
    slope = float(compensation.operation.springback.slope)
    for file_pass in passes:
        low, high, _ = file_pass.springback_bounds
        actual, half = file_pass.shift, file_pass.claim.radius
        minimum, maximum = (
            springback_bounds.moving_mean(
                file_pass.arc, springback_bounds.limit_slope(file_pass.arc, value, slope), half
            )
            for value in (low, high)
        )
        tolerance = (
            INTERPOLATION_TOLERANCE_FRACTION * maximum + MESH_TOLERANCE_M + 0.5 * slope * POINT_SPACING_M
        )
        excess = np.maximum(minimum - actual, actual - maximum) - tolerance
        worst_index = int(np.argmax(np.where(np.isfinite(excess), excess, np.inf)))
        if not excess[worst_index] <= 0.0:
            message = (
                f"{file_pass.claim.segment} is shifted by {mm(actual[worst_index]):.3f} mm at "
                f"{file_pass.arc[worst_index] / MM:.0f} mm of its path, its control points and the slope "
                "give "
                f"{mm(minimum[worst_index]):.3f} to {mm(maximum[worst_index]):.3f} mm"
            )
            yield springback_issue(
                compensation, message, measure_in_mm(actual[worst_index], maximum[worst_index])
            )


def _path_issues(context: Context, forming: FormingFacts, compensation: CompensationClaim) -> Iterator[Issue]:
    """Check that the forming ball, shifts included, is on the file's path all the time that it forms."""
    for formed in forming.formed:
        claim, tool_track = formed.claim, formed.track
        if formed.setup != compensation.index or claim.segment not in compensation.claim.segments:
            continue
        if tool_track.path_distance is None or not len(tool_track.path_distance):
            message = f"{claim.segment} has no path in the springback file, or in the programs"
            yield springback_issue(compensation, message)
            continue
        worst_index = int(np.argmax(tool_track.path_distance))
        if tool_track.path_distance[worst_index] > MAX_PATH_DISTANCE_M:
            message = (
                f"{claim.arm} is {mm(float(tool_track.path_distance[worst_index])):.3f} mm off the path of "
                "the "
                f"springback file in {claim.segment}, allowed: {mm(MAX_PATH_DISTANCE_M):g} mm"
            )
            measure = measure_in_mm(tool_track.path_distance[worst_index], MAX_PATH_DISTANCE_M)
            yield sample_issue(
                CODE, message, context.motion, claim.arm, int(tool_track.rows[worst_index]), measure
            )


def _wall_issues(context: Context, forming: FormingFacts, compensation: CompensationClaim) -> Iterator[Issue]:
    """Check that walls between the replayed loops, which shifts make steeper, are allowed for the metal."""
    slope = float(compensation.operation.springback.slope)
    for formed in forming.formed:
        if formed.setup != compensation.index or formed.claim.segment not in compensation.claim.segments:
            continue
        yield from loop_walls.steep_wall_issues(
            CODE, context, forming, formed, loop_walls.pass_walls(formed, slope)
        )


def _elastic_issues(
    context: Context, forming: FormingFacts, compensation: CompensationClaim, passes: Sequence[FilePass]
) -> tuple[float, list[Issue]]:
    """Recalculate the springback at randomly drawn points with an elastic sheet, independently of the file.

    In the first loop the springback that the file states at the control points around the drawn points is
    compared with the result. In the second loop the interpolated springback at the first
    `RECALCULATED_POINTS` drawn points is compared, and the shift there unless the slope limits it.

    Returns:
        Maximum deviation as a fraction of the allowed one, and issues.
    """
    springback_data, shapes_of_part = compensation.file, _part_shapes(forming, compensation)
    stock = context.setups[compensation.index].stock
    part = next((c for c in claim_group(context, compensation) if isinstance(c, FormsPart)), None)
    if springback_data is None or shapes_of_part is None or stock.sheet is None or part is None:
        return 0.0, [springback_issue(compensation, "there is no part whose sheet springs back")]
    metal = stock.sheet.metal
    clamped_sheet = elastic_sheet.ClampedSheet(
        float(stock.size[2]), metal.young, metal.poisson, stock.sheet.opening, stock.sheet.border
    )
    shapes = {
        claim.segment.name: (k, number, claim)
        for k, feature in enumerate(shapes_of_part.features)
        for number, shape in enumerate(feature.shapes)
        for claim in shape.claims
    }
    worst, issues = 0.0, []
    drawn = _draw_points(context, compensation, passes)
    if not drawn:
        issues.append(
            springback_issue(
                compensation, "its paths are too short for springback to be recalculated anywhere"
            )
        )
    for k, control in _control_points_to_solve(springback_data.controls, drawn):
        if control.segment not in shapes:
            issues.append(
                springback_issue(
                    compensation, f"a control point is of {control.segment}, which is not formed"
                )
            )
            continue
        feature, number, claim = shapes[control.segment]
        formed = elastic_sheet.PartlyFormedSheet(
            shapes_of_part, feature, number, abs(float(control.point[2]) - claim.start)
        )
        x, y, z = control.point / MM
        description = f"control point {k + 1} of its springback file, at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        try:
            calculated, doubt = _recalculate(formed, clamped_sheet, control)
        except ValueError as error:
            issues.append(
                springback_issue(
                    compensation, f"{description}: the sheet there cannot be calculated: {error}"
                )
            )
            continue
        allowed = MESH_TOLERANCE_FRACTION * calculated + MESH_TOLERANCE_M + doubt
        difference = abs(control.springback - calculated)
        worst = max(worst, difference / allowed if np.isfinite(calculated) else np.inf)
        if not difference <= allowed or not np.isfinite(calculated):
            message = (
                f"{description}: it springs back by {mm(control.springback):.4f} mm under "
                f"{control.force:.0f} N, an elastic sheet on another mesh by {mm(calculated):.4f} mm"
            )
            measure = (
                measure_in_mm(difference, allowed)
                if np.isfinite(calculated)
                else measure_in_mm(control.springback, 0.0)
            )
            issues.append(springback_issue(compensation, message, measure))
    for point in drawn[:RECALCULATED_POINTS]:
        file_pass, k = point.file_pass, point.row
        feature, number, claim = shapes[file_pass.claim.segment.name]
        formed = elastic_sheet.PartlyFormedSheet(
            shapes_of_part, feature, number, abs(float(file_pass.touch[k, 2]) - claim.start)
        )
        force, doubt_of_force = _force_at(context, compensation, file_pass, k)
        shift = float(file_pass.shift[k])
        control = FileControlPoint(
            file_pass.claim.segment.name,
            0,
            file_pass.touch[k],
            float(file_pass.angle[k]),
            force,
            shift,
            NO_CURVE,
            NO_CURVE,
        )
        x, y, z = control.point / MM
        description = f"{file_pass.claim.segment} at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        try:
            calculated, doubt = _recalculate(formed, clamped_sheet, control)
        except ValueError as error:
            issues.append(
                springback_issue(
                    compensation, f"{description}: the sheet there cannot be calculated: {error}"
                )
            )
            continue
        by_curves = (
            max(point.low - calculated, calculated - point.high, 0.0),
            0.5 * (point.low + point.high),
            point.uneven,
        )
        # verb of the message, difference, value in the file and uncertainty due to variation nearby [m]
        checks = [("has", *by_curves)]
        if point.shifted is not None:
            checks.append(("is shifted by", abs(shift - calculated), shift, point.shifted))
        for verb, difference, value, uneven in checks:
            allowed = (
                (INTERPOLATION_TOLERANCE_FRACTION + doubt_of_force) * calculated
                + MESH_TOLERANCE_M
                + doubt
                + LEVEL_DIFFERENCE_FRACTION * point.level_difference
                + uneven
            )
            worst = max(worst, difference / allowed if np.isfinite(calculated) else np.inf)
            if not difference <= allowed:
                message = f"{description} {verb} {mm(value):.4f} mm"
                message += " by the control points around" if verb == "has" else ""
                message += (
                    f", an elastic sheet springs back by {mm(calculated):.4f} mm there under {force:.0f} N"
                )
                measure = (
                    measure_in_mm(difference, allowed)
                    if np.isfinite(calculated)
                    else measure_in_mm(value, 0.0)
                )
                issues.append(springback_issue(compensation, message, measure))
    return worst, issues


@dataclasses.dataclass(frozen=True, eq=False)
class _DrawnPoint:
    """A point of a pass that was drawn at random.

    Attributes:
        file_pass: Pass of the file.
        row: Index of the point in the pass.
        low: Minimum springback [m] by the control points.
        high: Maximum springback [m] by the control points.
        level_difference: Difference [m] of the springback of the adjacent levels.
        uneven: Uncertainty [m] of the springback due to its variation nearby.
        shifted: Uncertainty [m] of the shift due to its variation nearby, None where the slope limits the
            shift.
        around: Adjacent control points.
    """

    file_pass: FilePass
    row: int
    low: float
    high: float
    level_difference: float
    uneven: float
    shifted: float | None
    around: tuple[FileControlPoint, ...]


def _control_points_to_solve(
    controls: tuple[FileControlPoint, ...], points: list[_DrawnPoint]
) -> Iterator[tuple[int, FileControlPoint]]:
    """Yield the control points around the drawn points, each with its index among ``controls``.

    A control point has a curve of springback over force. If the curve continues far beyond the force of its
    point, because tools press more nearby, the end of the curve follows as a second control point with the
    same index.
    """
    index_by_id = {id(control): k for k, control in enumerate(controls)}
    for k in sorted({index_by_id[id(control)] for point in points for control in point.around}):
        control_point = controls[k]
        yield k, control_point
        if control_point.loads[-1] > CURVE_END_FACTOR * control_point.force:
            yield (
                k,
                dataclasses.replace(
                    control_point,
                    force=float(control_point.loads[-1]),
                    springback=float(control_point.displacement[-1]),
                ),
            )


def _draw_points(
    context: Context, compensation: CompensationClaim, passes: Sequence[FilePass]
) -> list[_DrawnPoint]:
    """Draw points at random on the paths of all passes, at which the springback is recalculated.

    All points of the paths are equally likely, except that the start of each path is left out. Points are
    drawn instead of control points, so that crowded control points on a short section of the path are not
    checked more often than others. The first `RECALCULATED_POINTS` points are all kept. More points are kept
    if they add control points, until there are `MIN_RECALCULATED` control points around them or `MAX_DRAWS`
    points are drawn.
    """
    slope = float(compensation.operation.springback.slope)
    candidate_rows = [np.flatnonzero(file_pass.arc > 2.0 * file_pass.claim.radius) for file_pass in passes]
    owner = np.repeat(np.arange(len(passes)), [len(rows) for rows in candidate_rows])
    rows = np.concatenate([*candidate_rows, np.zeros(0, dtype=np.int64)])
    bounds = {k: file_pass.springback_bounds for k, file_pass in enumerate(passes)}
    slope_reduction = {
        # by how much the limit on the slope reduces the shift at each point of the pass
        k: np.maximum(
            low - springback_bounds.limit_slope(passes[k].arc, low, slope),
            high - springback_bounds.limit_slope(passes[k].arc, high, slope),
        )
        for k, (low, high, _) in bounds.items()
    }
    out: list[_DrawnPoint] = []
    drawn_controls: set[int] = set()
    for draw in _random_order(context.problem.digest, len(rows), MAX_DRAWS):
        k, row = int(owner[draw]), int(rows[draw])
        file_pass, (low, high, level_difference) = passes[k], bounds[k]
        reach = int(np.ceil(2.0 * file_pass.claim.radius / max(float(file_pass.arc[1]), 1e-9)))
        window = slice(max(row - reach, 0), row + reach + 1)
        around = springback_bounds.adjacent_controls(file_pass, row)
        if len(out) >= RECALCULATED_POINTS and drawn_controls.issuperset(map(id, around)):
            continue
        drawn_controls.update(map(id, around))
        shifted = 0.5 * float(np.ptp(file_pass.shift[window])) if slope_reduction[k][row] < 1e-6 else None
        uneven = 0.5 * float(np.ptp(low[window]))
        out.append(
            _DrawnPoint(
                file_pass,
                row,
                float(low[row]),
                float(high[row]),
                float(level_difference[row]),
                uneven,
                shifted,
                around,
            )
        )
        if len(out) >= RECALCULATED_POINTS and len(drawn_controls) >= MIN_RECALCULATED:
            break
    return out


def _force_at(
    context: Context, compensation: CompensationClaim, file_pass: FilePass, k: int
) -> tuple[float, float]:
    """Return the force [N] at point ``k`` of a pass, as stated or by a formula, and its uncertainty.

    The uncertainty is a fraction of the force. For a force by formula it is due to the uncertain wall angle,
    for a stated force to the uncertain position.
    """
    operation, setup = compensation.operation, context.setups[compensation.index]
    if operation.force_n is not None or operation.force_by is not None:
        low, high = (float(force) for force in file_pass.force[:, k])
        return 0.5 * (low + high), 0.5 * (high - low) / max(high, 1e-9)
    sheet = setup.stock.sheet
    tensile = 0.0 if sheet is None else sheet.metal.tensile_stress
    nearby_angles = [
        float(file_pass.angle[k]) + angle_offset
        for angle_offset in (0.0, -ANGLE_TOLERANCE_RAD, ANGLE_TOLERANCE_RAD)
    ]
    angle = np.maximum(np.array([*nearby_angles, *(control.angle for control in file_pass.controls)]), 0.0)
    force = formula_forces(operation, tensile, setup, file_pass.claim.radius, angle)
    return float(force[0]), float(np.abs(force[1:3] / force[0] - 1.0).max())


def _recalculate(
    formed: elastic_sheet.PartlyFormedSheet,
    clamped_sheet: elastic_sheet.ClampedSheet,
    control: FileControlPoint,
) -> tuple[float, float]:
    """Return the springback [m] of an elastic sheet at a control point, and its uncertainty [m].

    If it differs from that of the file, a mesh with more points decides, and half of the difference of both
    meshes is the uncertainty.
    """
    position, force = control.point[:2], control.force
    coarse, _ = elastic_sheet.springback_at(formed, clamped_sheet, position, force)
    if abs(control.springback - coarse) <= MESH_TOLERANCE_FRACTION * coarse + MESH_TOLERANCE_M:
        return coarse, 0.0
    finer, _ = elastic_sheet.springback_at(
        formed, clamped_sheet, position, force, elastic_sheet.MAX_POINTS_FINER
    )
    return finer, 0.5 * abs(finer - coarse) if np.isfinite(finer - coarse) else 0.0


def _random_order(digest: str, count: int, max_count: int) -> list[int]:
    """Draw at most ``max_count`` of the indices of ``count`` items in random order.

    The problem's digest is the seed, so that proofs are reproducible, and a changed problem has other points.
    """
    seed = int.from_bytes(hashlib.sha256(f"springback {digest}".encode()).digest()[:8], "big")
    return list(np.random.default_rng(seed).permutation(count)[:max_count].tolist())
