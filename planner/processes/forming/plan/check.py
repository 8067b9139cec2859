"""Checks of a forming job once its tool paths are known: refusals and warnings.

**Regions that a ball cannot reach**: sharp floors, fillets and hollows that are tighter than the ball. There
the ball leaves a fillet of its own radius, whatever the path, so this is reported before anything is planned.

A ball above a hollow has its centre beyond the plane of each facet in its way, by its radius R. The nearest
such centre is found by Dykstra's alternating projections (Boyle and Dykstra 1986). In a corner between two
planes at the angle a to each other the ball stays R (1 / cos(a / 2) - 1) away.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.catalogue.materials import untested_thickness_warning
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots, unique_rows
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.mesh import TriangleMesh, bisect_triangles, face_areas, face_normals
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.problem import Setup
from planner.processes.forming.plan import two_point
from planner.processes.forming.plan.claims import scallop_heights
from planner.processes.forming.plan.contact import MIRROR, ContactFace, FormingPass, FormingToolPath
from planner.processes.forming.plan.operation import die_mesh
from planner.processes.forming.plan.passes import ANGLE_TOLERANCE_RAD, pass_issues
from planner.processes.forming.plan.paths.level_lines import MIN_WALL_ANGLE_RAD
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.sheet_mechanics import (
    ForceEstimate,
    estimate_force,
    payload_issue,
    wall_angle,
)
from planner.processes.forming.plan.sheet_state import clearance_issues, sheet_states
from planner.processes.forming.plan.support.clearance import clamp_issues
from planner.processes.forming.plan.support.modes import support_issues
from planner.processes.forming.plan.two_point import die_issues
from planner.tooling import head_outline


def check(
    work: FormingWork, setup: Setup, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> list[Issue]:
    """Return all issues of a job except those of its die.

    Covers features, metal, passes, forces, supports that do not fulfil their task, tools that would cut into
    sheet that is formed already or reach into the clamp, walls too flat for the step-down, and the holder's
    steps.
    """
    out = [
        *work.tree.issues,
        *_metal_issues(work),
        *_force_issues(work, setup, paths),
        *_clearance_issues(work, paths),
    ]
    out += clamp_reach_issues(work, paths)
    if work.operation.level is None:
        out += flat_issues(work, paths)
    return [*out, *two_point.step_issues(work, paths)]


def shift_issues(work: FormingWork) -> Iterator[Issue]:
    """Check that the support can be shifted around the forming tool as stated (forming.shift).

    Beyond the vertical the support would leave the wall that it supports, so the shift is limited by the wall
    angle.
    """
    shift = work.operation.shift_deg
    last_passes = {forming_pass.feature: forming_pass for forming_pass in work.passes}  # later ones replace
    for number, forming_pass in last_passes.items():
        wall = wall_angle(forming_pass.vertices, forming_pass.faces) / DEG
        if shift > wall + ANGLE_TOLERANCE_RAD / DEG:
            message = format_message("forming.shift", feature=number, shift_deg=shift, wall_angle_deg=wall)
            hint = "reduce shift_deg; at the wall angle the support is directly below the forming tool"
            yield Issue(
                "forming.shift", message, field="shift_deg", value=shift, limit=wall, unit="deg", hint=hint
            )


def step_issues(work: FormingWork) -> Iterator[Issue]:
    """Check that the step-down is no larger than the part's depth (forming.path_options).

    Otherwise the only loop would be at the floor, where balls are easily too large, and nothing above it
    would be formed.
    """
    op = work.operation
    depth_mm = max(abs(forming_pass.end - forming_pass.start) for forming_pass in work.passes) / MM
    if op.mode != "adsif" and op.stepdown_mm is not None and op.stepdown_mm > depth_mm:
        message = f"stepdown_mm is {op.stepdown_mm:g}, allowed is up to {depth_mm:.3g}, the depth of the part"
        hint = f"use a tenth of that, {0.1 * depth_mm:.2g}, or state scallop_mm instead"
        yield Issue(
            "forming.path_options",
            message,
            field="operations.stepdown_mm",
            **measurement(op.stepdown_mm, depth_mm, "mm"),
            hint=hint,
        )


def flat_issues(work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]) -> Iterator[Issue]:
    """Report walls that are too flat for a constant step-down (forming.path_options).

    Loops at a constant step in height are far apart where a wall is flat. A pass is reported if the area of
    its flat walls that lies farther from the ball than the allowed ridge is a larger fraction of all its
    walls than the operation's ``share`` permits. Operations with a scallop height and mode adsif are not
    checked.
    """
    op = work.operation
    max_fraction = 1.0 - op.share
    for forming_pass, path in paths if op.stepdown_mm is not None and op.mode != "adsif" else ():
        mesh = TriangleMesh(forming_pass.vertices, forming_pass.faces)
        radius = work.heads[work.forming_arm(forming_pass)].radius
        height = forming_pass.vertices[forming_pass.faces][:, :, 2]
        is_level = [
            (np.abs(height - z) < CONTACT_TOLERANCE_M).all(axis=1)
            for z in (forming_pass.start, forming_pass.end)
        ]
        area = np.where(is_level[0] | is_level[1], 0.0, face_areas(mesh))
        angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
        ridge = scallop_heights(work, forming_pass) + op.gouge_tol_mm * MM
        flat = np.flatnonzero((area > 0.0) & (angle < MIN_WALL_ANGLE_RAD) & (ridge < 0.5 * radius))
        if area[flat].sum() <= max_fraction * area.sum():
            continue
        pieces, owner = bisect_triangles(
            forming_pass.vertices[forming_pass.faces[flat]], FINE_SPACING_FRACTION * radius, _MAX_PIECES
        )
        double_area = np.linalg.norm(
            np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1
        )
        arc = arc_length(path.forming_centre)
        samples = np.linspace(0.0, arc[-1], int(arc[-1] / (FINE_SPACING_FRACTION * radius)) + 2)
        distance = cKDTree(interpolate_polyline(path.forming_centre, arc, samples)).query(
            pieces.mean(axis=1)
        )[0]
        uncovered = 0.5 * float(double_area[distance - radius > ridge[flat][owner]].sum() / area.sum())
        if uncovered <= max_fraction:
            continue
        message = (
            f"pass {forming_pass.name}: loops {op.stepdown_mm:g} mm apart in height leave "
            f"{100 * uncovered:.0f} % of "
        )
        message += (
            f"its walls between them, which are flatter than {MIN_WALL_ANGLE_RAD / DEG:.3g} deg; allowed is "
        )
        message += f"{100 * max_fraction:.3g} %"
        hint = "state scallop_mm: 0.01 instead of stepdown_mm, so that loops are closer where walls are flat"
        field, value, limit = "operations.stepdown_mm", 100 * uncovered, 100 * max_fraction
        yield Issue(
            "forming.path_options", message, field=field, value=value, limit=limit, unit="%", hint=hint
        )


def die_check(work: FormingWork) -> Iterator[Issue]:
    """Check the die, which needs no path.

    This runs first, so that a part that does not match the die is not reported as a ball that is too large.
    """
    die = work.operation.die
    if die is not None:
        # last pass of each feature: intermediate shapes do not touch the die
        last_passes = {forming_pass.feature: forming_pass for forming_pass in work.passes}
        tolerance = work.operation.gouge_tol_mm * MM
        yield from die_issues(tuple(last_passes.values()), die, die_mesh(die), work.thickness, tolerance)


def forming_force(work: FormingWork, forming_pass: FormingPass, path: FormingToolPath) -> ForceEstimate:
    """Return the axial force on the forming tool of a pass.

    Without a stated step-down, the step is the one whose ridges have the stated scallop height at the
    steepest wall. A force that the user states replaces the formula.
    """
    op = work.operation
    radius = work.heads[work.forming_arm(forming_pass)].radius
    walls = path.contact.angle[path.contact.angle > 0.0]
    if op.stepdown_mm is not None:
        step = op.stepdown_mm * MM
    else:  # inverse of `sheet_mechanics.scallop_height`
        ridge = (op.scallop_mm or 0.0) * MM
        step = 2.0 * float(np.sin(walls.max())) * float(np.sqrt(2.0 * radius * ridge - ridge**2))
    stated_force = None if work.stated_forces is None else work.stated_forces.forming_force[forming_pass.name]
    return estimate_force(work.sheet.metal, work.thickness, 2.0 * radius, step, walls, stated_force)


def _clearance_issues(
    work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> Iterator[Issue]:
    """Report supports that do not fulfil their task, and tools that cut into the sheet around a pass."""
    pass_states = sheet_states(work.tree, work.mesh, work.passes, work.thickness, work.previous_features)
    state_of = {
        forming_pass.name: state for forming_pass, state in zip(work.passes, pass_states, strict=True)
    }
    for forming_pass, path in paths:
        state = state_of[forming_pass.name]
        arms = tuple(filter(None, (work.forming_arm(forming_pass), work.support_arm(forming_pass))))
        heads = [work.heads[arm] for arm in arms]
        support = heads[1] if len(heads) > 1 else None
        yield from support_issues(forming_pass, path, work.operation, heads[0], support, work.thickness)
        profiles = [head_outline(head) for head in heads]
        yield from clearance_issues(forming_pass, path, state, arms, profiles, work.allowed_penetration)


def clamp_reach_issues(
    work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> Iterator[Issue]:
    """Report tools that reach into the clamp on the given paths (forming.clamp).

    Motion may tilt some tools out of the clamp, so operations with a tilt cone are not checked here.
    """
    if work.operation.cone_deg == 0.0:
        for forming_pass, path in paths:
            arms = tuple(filter(None, (work.forming_arm(forming_pass), work.support_arm(forming_pass))))
            yield from clamp_issues(
                forming_pass, path, work.clamp, arms, [head_outline(work.heads[arm]) for arm in arms]
            )


def _metal_issues(work: FormingWork) -> Iterator[Issue]:
    """Report a thickness that is untested for the metal, and passes that the metal does not bear."""
    warning = untested_thickness_warning(work.sheet.metal, work.thickness)
    if warning is not None:
        yield warning
    yield from pass_issues(work.passes, work.thickness, work.operation, work.sheet.metal)


def _force_issues(
    work: FormingWork, setup: Setup, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> Iterator[Issue]:
    """Compare the largest force on each arm with its payload.

    The support has the same force as the forming tool, unless the operation states ``support_force_n``. A
    heat source has none and is not checked.
    """
    largest: dict[str, ForceEstimate] = {}
    for forming_pass, path in paths:
        force_estimate = forming_force(work, forming_pass, path)
        for arm in filter(None, (work.forming_arm(forming_pass), work.support_arm(forming_pass))):
            if work.operation.mode == "heat" and arm != work.forming_arm(forming_pass):
                continue
            arm_force, support = force_estimate, work.operation.support_force_n
            if arm != work.forming_arm(forming_pass) and support is not None:
                arm_force = ForceEstimate(support, support, support, force_estimate.angle, "support_force_n")
            if arm not in largest or arm_force.force > largest[arm].force:
                largest[arm] = arm_force
    for arm, force_estimate in largest.items():
        mounted = setup.cell.arm(arm)
        data = mounted.data
        issue = payload_issue(force_estimate, f"arm {arm}", data.title, data.payload, mounted.tool.mass)
        if issue is not None:
            yield issue


REACHED_TOLERANCE_M: Final = 2e-5
"""A ball this near [m] to a point reaches it."""
FINE_SPACING_FRACTION: Final = 0.1
"""Spacing of the points of the fine check, as a fraction of the ball's radius."""
COARSE_SPACING_FRACTION: Final = 0.35
"""Spacing of the points of the coarse check, as a fraction of the ball's radius.

Corners are wider than that along their whole length.
"""
CONTACT_TOLERANCE_M: Final = 2e-6
"""Allowed penetration [m] of a ball into the face. Heights that differ by less are one level."""
_WORST_POINTS: Final = 12
"""Number of points farthest from the ball around which corners of the mesh are checked, too."""
_MAX_NEIGHBOURS: Final = 800
"""Maximum number of points near those points. Larger sets are decimated evenly."""
_MAX_PIECES: Final = 60_000
"""Maximum number of pieces into which the face is divided."""
_MAX_PLANES: Final = 12
"""Maximum number of planes of the face that bound the nearest centre of the ball. Each round adds one."""
_PROJECTION_SWEEPS: Final = 80
"""Sweeps over these planes to find the nearest centre beyond all of them."""


@dataclasses.dataclass(frozen=True)
class UnreachedRegion:
    """Region of a pass that a ball does not reach.

    Attributes:
        max_distance: Largest distance [m] between ball and face.
        point: Point (3,) [m] of the face with the largest distance.
        volume: Volume [m^3] of the fillets that the ball leaves.
        regions: Number of separate regions.
        wall_fraction: Fraction of the walls that is not reached.
    """

    max_distance: float
    point: FloatArray
    volume: float
    regions: int
    wall_fraction: float


def find_unreached_region(forming_pass: FormingPass, radius: float) -> UnreachedRegion | None:
    """Return what a ball does not reach of the face of a pass, or None if it reaches all of it.

    The result is reported to the user, who decides whether a smaller ball is needed. Coarsely spaced points
    are tested first. Only the surroundings of those that the ball does not reach are then refined.

    Args:
        forming_pass: Pass whose face is checked.
        radius: Radius [m] of the ball.
    """
    # a face that is formed from below is mirrored, so that the ball is always above it
    vertices = forming_pass.vertices if forming_pass.side > 0 else forming_pass.vertices * MIRROR
    start, end = forming_pass.side * forming_pass.start, forming_pass.side * forming_pass.end
    box = np.stack([forming_pass.region.min(axis=0), forming_pass.region.max(axis=0)])[:, :2]
    face = ContactFace(TriangleMesh(vertices, forming_pass.faces), radius, box)
    corners = vertices[face.mesh.faces]
    # the flat around the feature is always reached
    formed_faces = np.flatnonzero(corners[:, :, 2].min(axis=1) < start - CONTACT_TOLERANCE_M)
    corners = corners[formed_faces]
    pieces, owner = bisect_triangles(corners, FINE_SPACING_FRACTION * radius, _MAX_PIECES)
    area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    corner = corners[owner][:, :, 2]
    is_level = [(np.abs(corner - level) < CONTACT_TOLERANCE_M).all(axis=1) for level in (start, end)]
    is_wall = np.asarray(~(is_level[0] | is_level[1]))
    points, normal = pieces.mean(axis=1), face.normals[formed_faces[owner]]
    # coarse pass: only the surroundings of points that are not reached are refined
    sampled = _decimate(points, is_wall, COARSE_SPACING_FRACTION * radius)[0]
    unreached = sampled[face.pushed(points[sampled], normal[sampled]) > REACHED_TOLERANCE_M]
    if not len(unreached):
        return None
    unreached_distance = cKDTree(points[unreached]).query(
        points, distance_upper_bound=2.0 * COARSE_SPACING_FRACTION * radius
    )[0]
    candidates = np.flatnonzero(np.isfinite(unreached_distance))
    first, cell = _decimate(points[candidates], is_wall[candidates], FINE_SPACING_FRACTION * radius)
    cell_area = np.bincount(cell, area[candidates])
    all_walls = float(area[is_wall].sum())
    samples = candidates[first]
    area[samples] = cell_area
    to_centre = nearest_centres(face, points[samples], normal[samples]) - points[samples]
    distance = np.linalg.norm(to_centre, axis=1)
    is_unreached = distance > radius + REACHED_TOLERANCE_M
    samples, to_centre, distance = samples[is_unreached], to_centre[is_unreached], distance[is_unreached]
    if not len(samples):
        return None
    # sector between each point and the ball, as in a straight crease at distance d:
    # dV = (d^2 - R^2) / (2 d) cos(angle) dA
    along = np.maximum(dots(to_centre, normal[samples]), 0.0) / distance
    volume = float((0.5 * (distance**2 - radius**2) / distance * along * area[samples]).sum())
    worst_index = int(np.argmax(distance))
    point = points[samples[worst_index]] if forming_pass.side > 0 else points[samples[worst_index]] * MIRROR
    wall_fraction = float(area[samples][is_wall[samples]].sum() / max(all_walls, 1e-12))
    # corners of the mesh near these points are farther from the ball than the points themselves
    worst_points = points[samples[np.argsort(distance)[-_WORST_POINTS:]]]
    nearby = np.unique(
        np.concatenate(cKDTree(points).query_ball_point(worst_points, 2.0 * FINE_SPACING_FRACTION * radius))
    )
    nearby = nearby[:: -(-len(nearby) // _MAX_NEIGHBOURS)].astype(np.int64)  # step: the quotient rounded up
    corner, corner_normal = pieces[nearby].reshape(-1, 3), np.repeat(normal[nearby], 3, axis=0)
    corner_distance = np.linalg.norm(nearest_centres(face, corner, corner_normal) - corner, axis=1)
    max_distance = max(float(corner_distance.max()), float(distance[worst_index]))
    return UnreachedRegion(
        max_distance - radius, point, volume, _region_count(points[samples], radius), wall_fraction
    )


def _decimate(points: FloatArray, wall: BoolArray, size: float) -> tuple[IntArray, IntArray]:
    """Select one of the points (N, 3) [m] in each cell of a cubic grid with cells of ``size`` [m].

    Points on walls, where ``wall`` (N,) is true, and other points have separate cells.

    Returns:
        Index (C,) of the first point in each cell, and index (N,) of the cell of each point.
    """
    key = np.column_stack([np.floor(points / size).astype(np.int64), wall])
    _, first, cell = unique_rows(key)
    return first, cell


def nearest_centres(face: ContactFace, points: FloatArray, normal: FloatArray) -> FloatArray:
    """Find the nearest ball centres to points of a face at which the balls do not cut into the face.

    Args:
        face: Face with the radius of the ball.
        points: Points (N, 3) [m] of the face.
        normal: Upward unit normals (N, 3).

    Returns:
        Centres (N, 3) [m].
    """
    centres = points + face.radius * normal
    active: IntArray = np.arange(len(points))
    # active half-spaces: unit normals, and the minimum coordinate of a centre along them
    up = np.zeros((len(points), 0, 3))
    level = np.zeros((len(points), 0))
    for _ in range(_MAX_PLANES):
        distance, foot, away = face.deepest(centres[active])
        deep = distance < face.radius - CONTACT_TOLERANCE_M
        active, foot, away = active[deep], foot[deep], away[deep]
        if not len(active):
            break
        up = np.concatenate([up[deep], away[:, None]], axis=1)
        level = np.concatenate([level[deep], (dots(away, foot) + face.radius)[:, None]], axis=1)
        centres[active] = _project_beyond_planes(points[active], up, level)
    return centres


def _project_beyond_planes(points: FloatArray, up: FloatArray, level: FloatArray) -> FloatArray:
    """Return the positions (N, 3) [m] nearest to ``points`` (N, 3) that lie beyond K planes each.

    Dykstra's alternating projections onto the half-spaces {x: up_k . x >= level_k} with ``up`` (N, K, 3)
    and ``level`` (N, K) [m]; ``push`` is the correction of each plane.
    """
    position = points.copy()
    push = np.zeros(level.shape)
    for _ in range(_PROJECTION_SWEEPS if level.shape[1] > 1 else 1):
        for k in range(level.shape[1]):
            coordinate = dots(position, up[:, k]) - push[:, k]
            new_push = np.maximum(level[:, k] - coordinate, 0.0)
            position += (new_push - push[:, k])[:, None] * up[:, k]
            push[:, k] = new_push
    return position


def _region_count(points: FloatArray, radius: float) -> int:
    """Return the number of clusters of points (N, 3); neighbours in a cluster are at most 0.4 radii apart."""
    neighbours = cKDTree(points).sparse_distance_matrix(
        cKDTree(points), 4.0 * FINE_SPACING_FRACTION * radius, output_type="coo_matrix"
    )
    return int(connected_components(neighbours, directed=False)[0])


def unreached_issues(work: FormingWork) -> Iterator[Issue]:
    """Report what the balls do not reach of the part (forming.unreached).

    The issue is a note; a warning if the unreached fraction of the walls is above the allowed one; an error
    beyond the user's ``unreached_mm``.
    """
    op = work.operation
    last_passes = {forming_pass.feature: forming_pass for forming_pass in work.passes}
    for forming_pass in last_passes.values():
        radius = work.heads[work.forming_arm(forming_pass)].radius
        region = find_unreached_region(forming_pass, radius)
        if region is None:
            continue
        limit = op.unreached_mm
        distance_mm = region.max_distance / MM
        x, y, z = region.point / MM
        regions_text = "one region" if region.regions == 1 else f"{region.regions} regions"
        message = (
            f"pass {forming_pass.name}: a ball of {radius / MM:.2f} mm radius stays up to {distance_mm:.2f} "
            f"mm off the part (at ({x:.1f}, {y:.1f}, {z:.1f}) mm) and leaves fillets of its own radius in "
            f"{regions_text}, about {region.volume / MM**3:.3g} mm3; it does not reach "
            f"{100.0 * region.wall_fraction:.1f} % of the walls"
        )
        severity = Severity.NOTE if region.wall_fraction <= 1.0 - op.share else Severity.WARNING
        hint = "use a smaller ball, or round the part by the ball's radius so that all of it is reached"
        if limit is None:
            hint += "; unreached_mm limits the distance"
        elif distance_mm > limit:
            severity = Severity.ERROR
            message += f"; unreached_mm allows {limit:g} mm"
            hint = "use a smaller ball, round the part there by the ball's radius"
            hint += f", or allow {distance_mm + 0.01:.2f} mm"
        yield Issue(
            "forming.unreached",
            message,
            severity,
            field="operations.unreached_mm",
            **measurement(distance_mm, limit, "mm"),
            hint=hint,
        )
