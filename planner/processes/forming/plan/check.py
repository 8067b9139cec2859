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

    Covers metal, passes, forces, the die's holder, supports that do not fulfil their task, and tools that
    would cut into sheet that is formed already.
    """
    out = [
        *work.tree.issues,
        *_metal_issues(work),
        *_force_issues(work, setup, paths),
        *_clearance_issues(work, paths),
    ]
    out += clamp_reach_issues(work, paths)
    out += flat_issues(work, paths) if work.operation.level is None else ()
    return [*out, *two_point.step_issues(work, paths)]


def shift_issues(work: FormingWork) -> Iterator[Issue]:
    """Check that the support can be shifted around the forming tool as stated (forming.shift).

    Beyond the vertical the support would leave the wall that it supports, so the shift is limited by the wall
    angle.
    """
    shift, final = (
        work.operation.shift_deg,
        {forming_pass.feature: forming_pass for forming_pass in work.passes},
    )
    for number, forming_pass in final.items():
        wall = wall_angle(forming_pass.vertices, forming_pass.faces) / DEG
        if shift > wall + ANGLE_TOLERANCE_RAD / DEG:
            what = format_message("forming.shift", feature=number, shift_deg=shift, wall_angle_deg=wall)
            hint = "reduce shift_deg; at the wall angle the support is directly below the forming tool"
            yield Issue(
                "forming.shift", what, field="shift_deg", value=shift, limit=wall, unit="deg", hint=hint
            )


def step_issues(work: FormingWork) -> Iterator[Issue]:
    """Check that the step-down is no larger than the part's depth (forming.path_options).

    Otherwise the only loop would be at the floor, where balls are easily too large, and nothing above it
    would be formed.
    """
    op = work.operation
    depth_mm = max(abs(forming_pass.end - forming_pass.start) for forming_pass in work.passes) / MM
    if op.mode != "adsif" and op.stepdown_mm is not None and op.stepdown_mm > depth_mm:
        what = f"stepdown_mm is {op.stepdown_mm:g}, allowed is up to {depth_mm:.3g}, the depth of the part"
        hint = f"use a tenth of that, {0.1 * depth_mm:.2g}, or state scallop_mm instead"
        yield Issue(
            "forming.path_options",
            what,
            field="operations.stepdown_mm",
            **measurement(op.stepdown_mm, depth_mm, "mm"),
            hint=hint,
        )


def flat_issues(work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]) -> Iterator[Issue]:
    """Report walls that are too flat for a constant step-down (forming.path_options).

    Loops at a constant step in height leave more of such a pass between them than its share allows.
    """
    op, max_fraction = work.operation, 1.0 - work.operation.share
    for forming_pass, path in paths if op.stepdown_mm is not None and op.mode != "adsif" else ():
        mesh, radius = (
            TriangleMesh(forming_pass.vertices, forming_pass.faces),
            work.heads[work.forming_arm(forming_pass)].radius,
        )
        height = forming_pass.vertices[forming_pass.faces][:, :, 2]
        level = [
            (np.abs(height - z) < CONTACT_TOLERANCE_M).all(axis=1)
            for z in (forming_pass.start, forming_pass.end)
        ]
        area = np.where(level[0] | level[1], 0.0, face_areas(mesh))
        angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
        ridge = scallop_heights(work, forming_pass) + op.gouge_tol_mm * MM
        flat = np.flatnonzero((area > 0.0) & (angle < MIN_WALL_ANGLE_RAD) & (ridge < 0.5 * radius))
        if area[flat].sum() <= max_fraction * area.sum():
            continue
        parts, owner = bisect_triangles(
            forming_pass.vertices[forming_pass.faces[flat]], FINE_SPACING_FRACTION * radius, _MAX_PIECES
        )
        size = np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
        arc = arc_length(path.forming_centre)
        stations = np.linspace(0.0, arc[-1], int(arc[-1] / (FINE_SPACING_FRACTION * radius)) + 2)
        distance = cKDTree(interpolate_polyline(path.forming_centre, arc, stations)).query(
            parts.mean(axis=1)
        )[0]
        uncovered = 0.5 * float(size[distance - radius > ridge[flat][owner]].sum() / area.sum())
        if uncovered <= max_fraction:
            continue
        what = (
            f"pass {forming_pass.name}: loops {op.stepdown_mm:g} mm apart in height leave "
            f"{100 * uncovered:.0f} % of "
        )
        what += (
            f"its walls between them, which are flatter than {MIN_WALL_ANGLE_RAD / DEG:.3g} deg; allowed is "
        )
        what += f"{100 * max_fraction:.3g} %"
        hint = "state scallop_mm: 0.01 instead of stepdown_mm, so that loops are closer where walls are flat"
        field, value, limit = "operations.stepdown_mm", 100 * uncovered, 100 * max_fraction
        yield Issue("forming.path_options", what, field=field, value=value, limit=limit, unit="%", hint=hint)


def die_check(work: FormingWork) -> Iterator[Issue]:
    """Check the die, which needs no path.

    This runs first, so that a part that does not match the die is not reported as a ball that is too large.
    """
    die = work.operation.die
    if die is not None:
        final = {
            forming_pass.feature: forming_pass for forming_pass in work.passes
        }  # intermediate shapes do not touch the die
        tolerance = work.operation.gouge_tol_mm * MM
        yield from die_issues(tuple(final.values()), die, die_mesh(die), work.thickness, tolerance)


def forming_force(work: FormingWork, forming_pass: FormingPass, path: FormingToolPath) -> ForceEstimate:
    """Return the axial force on the forming tool of a pass."""
    op, radius = work.operation, work.heads[work.forming_arm(forming_pass)].radius
    walls = path.contact.angle[path.contact.angle > 0.0]
    if op.stepdown_mm is not None:
        step = op.stepdown_mm * MM
    else:  # the step whose ridges are as high as stated, at the steepest wall
        ridge = (op.scallop_mm or 0.0) * MM
        step = 2.0 * float(np.sin(walls.max())) * float(np.sqrt(2.0 * radius * ridge - ridge**2))
    given = None if work.stated_forces is None else work.stated_forces.forming_force[forming_pass.name]
    return estimate_force(work.sheet.metal, work.thickness, 2.0 * radius, step, walls, given)


def _clearance_issues(
    work: FormingWork, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> Iterator[Issue]:
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
    doubt = untested_thickness_warning(work.sheet.metal, work.thickness)
    if doubt is not None:
        yield doubt
    yield from pass_issues(work.passes, work.thickness, work.operation, work.sheet.metal)


def _force_issues(
    work: FormingWork, setup: Setup, paths: Sequence[tuple[FormingPass, FormingToolPath]]
) -> Iterator[Issue]:
    """Compare the largest force on each arm with its payload."""
    largest: dict[str, ForceEstimate] = {}
    for forming_pass, path in paths:
        estimated = forming_force(work, forming_pass, path)
        for arm in filter(None, (work.forming_arm(forming_pass), work.support_arm(forming_pass))):
            if work.operation.mode == "heat" and arm != work.forming_arm(forming_pass):
                continue
            arm_force, support = estimated, work.operation.support_force_n
            if arm != work.forming_arm(forming_pass) and support is not None:
                arm_force = ForceEstimate(support, support, support, estimated.angle, "support_force_n")
            if arm not in largest or arm_force.force > largest[arm].force:
                largest[arm] = arm_force
    for arm, estimated in largest.items():
        mounted = setup.cell.arm(arm)
        data = mounted.data
        issue = payload_issue(estimated, f"arm {arm}", data.title, data.payload, mounted.tool.mass)
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
"""Maximum number of points around those. Larger sets are decimated evenly."""
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


def find_unreached(forming_pass: FormingPass, radius: float) -> UnreachedRegion | None:
    """Return what a ball does not reach of the face of a pass, or None if it reaches all of it.

    Args:
        forming_pass: Pass whose face is checked.
        radius: Radius [m] of the ball.
    """
    vertices = forming_pass.vertices if forming_pass.side > 0 else forming_pass.vertices * MIRROR
    start, end = forming_pass.side * forming_pass.start, forming_pass.side * forming_pass.end
    box = np.stack([forming_pass.region.min(axis=0), forming_pass.region.max(axis=0)])[:, :2]
    face = ContactFace(TriangleMesh(vertices, forming_pass.faces), radius, box)
    corners = vertices[face.mesh.faces]
    moved = np.flatnonzero(
        corners[:, :, 2].min(axis=1) < start - CONTACT_TOLERANCE_M
    )  # the flat around the feature is always reached
    corners = corners[moved]
    parts, owner = bisect_triangles(corners, FINE_SPACING_FRACTION * radius, _MAX_PIECES)
    area = 0.5 * np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
    corner = corners[owner][:, :, 2]
    flat = [(np.abs(corner - level) < CONTACT_TOLERANCE_M).all(axis=1) for level in (start, end)]
    wall = np.asarray(~(flat[0] | flat[1]))
    points, normal = parts.mean(axis=1), face.normals[moved[owner]]
    # coarse pass: only the surroundings of points that are not reached are refined
    sampled = _decimate(points, wall, COARSE_SPACING_FRACTION * radius)[0]
    hit = sampled[face.pushed(points[sampled], normal[sampled]) > REACHED_TOLERANCE_M]
    if not len(hit):
        return None
    hit_distance = cKDTree(points[hit]).query(
        points, distance_upper_bound=2.0 * COARSE_SPACING_FRACTION * radius
    )[0]
    candidates = np.flatnonzero(np.isfinite(hit_distance))
    first, cell = _decimate(points[candidates], wall[candidates], FINE_SPACING_FRACTION * radius)
    total = np.bincount(cell, area[candidates])
    all_walls = float(area[wall].sum())
    rows = candidates[first]
    area[rows] = total
    back = nearest_centres(face, points[rows], normal[rows]) - points[rows]
    distance = np.linalg.norm(back, axis=1)
    use = distance > radius + REACHED_TOLERANCE_M
    rows, back, distance = rows[use], back[use], distance[use]
    if not len(rows):
        return None
    # sector between each point and the ball, as in a straight crease at distance d:
    # dV = (d^2 - R^2) / (2 d) cos(angle) dA
    along = np.maximum(dots(back, normal[rows]), 0.0) / distance
    volume = float((0.5 * (distance**2 - radius**2) / distance * along * area[rows]).sum())
    k = int(np.argmax(distance))
    point = points[rows[k]] if forming_pass.side > 0 else points[rows[k]] * MIRROR
    wall_fraction = float(area[rows][wall[rows]].sum() / max(all_walls, 1e-12))
    # corners of the mesh near these points are farther from the ball than the points themselves
    worst = points[rows[np.argsort(distance)[-_WORST_POINTS:]]]
    around = np.unique(
        np.concatenate(cKDTree(points).query_ball_point(worst, 2.0 * FINE_SPACING_FRACTION * radius))
    )
    around = around[:: -(-len(around) // _MAX_NEIGHBOURS)].astype(np.int64)
    corner, up = parts[around].reshape(-1, 3), np.repeat(normal[around], 3, axis=0)
    corner_distance = np.linalg.norm(nearest_centres(face, corner, up) - corner, axis=1)
    max_distance = max(float(corner_distance.max()), float(distance[k]))
    return UnreachedRegion(
        max_distance - radius, point, volume, _region_count(points[rows], radius), wall_fraction
    )


def _decimate(points: FloatArray, wall: BoolArray, size: float) -> tuple[IntArray, IntArray]:
    """First of N points in each cell.

    Returns the first point (C,) in each cell of ``size`` [m], walls and others separately, and the cell (N,)
    of each point.
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
    """Nearest positions (N, 3) to ``points`` (N, 3) beyond K planes.

    Dykstra's projections onto the half-spaces {x: up_k . x >= level_k} with ``up`` (N, K, 3) and ``level``
    (N, K); ``push`` is the correction of each plane.
    """
    position = points.copy()
    push = np.zeros(level.shape)
    for _ in range(_PROJECTION_SWEEPS if level.shape[1] > 1 else 1):
        for k in range(level.shape[1]):
            free = dots(position, up[:, k]) - push[:, k]
            fresh = np.maximum(level[:, k] - free, 0.0)
            position += (fresh - push[:, k])[:, None] * up[:, k]
            push[:, k] = fresh
    return position


def _region_count(points: FloatArray, radius: float) -> int:
    """Number of separate regions that points (N, 3) make up."""
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
    for forming_pass in {forming_pass.feature: forming_pass for forming_pass in work.passes}.values():
        radius = work.heads[work.forming_arm(forming_pass)].radius
        region = find_unreached(forming_pass, radius)
        if region is None:
            continue
        limit = op.unreached_mm
        distance_mm = region.max_distance / MM
        x, y, z = region.point / MM
        many = "one region" if region.regions == 1 else f"{region.regions} regions"
        what = (
            f"pass {forming_pass.name}: a ball of {radius / MM:.2f} mm radius stays up to {distance_mm:.2f} "
            f"mm off the part (at ({x:.1f}, {y:.1f}, {z:.1f}) mm) and leaves fillets of its own radius in "
            f"{many}, about {region.volume / MM**3:.3g} mm3; it does not reach "
            f"{100.0 * region.wall_fraction:.1f} % of the walls"
        )
        severity = Severity.NOTE if region.wall_fraction <= 1.0 - op.share else Severity.WARNING
        hint = "use a smaller ball, or round the part by the ball's radius so that all of it is reached"
        if limit is None:
            hint += "; unreached_mm limits the distance"
        elif distance_mm > limit:
            severity = Severity.ERROR
            what += f"; unreached_mm allows {limit:g} mm"
            hint = "use a smaller ball, round the part there by the ball's radius"
            hint += f", or allow {distance_mm + 0.01:.2f} mm"
        yield Issue(
            "forming.unreached",
            what,
            severity,
            field="operations.unreached_mm",
            **measurement(distance_mm, limit, "mm"),
            hint=hint,
        )
