"""What a forming job is refused for, or warned of, once its tools' paths are known.

**What a ball cannot reach** of a part: sharp floors, fillets and hollows that are tighter than it
is. There it leaves a fillet of its own radius, whatever the path: told before anything is planned.
A ball above a hollow is beyond the plane of each place that is in its way, by its radius; the
nearest place for its centre that is beyond all of them is found by Dykstra's alternating
projections (Boyle and Dykstra 1986). In a corner between two planes at the angle a to each other it
stays R (1 / cos(a / 2) - 1) off.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from planner.catalogue.materials import thickness_doubt
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, distinct_rows, dots
from planner.geometry.curves import along, arc_length
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals, small_pieces
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity
from planner.problem import Setup
from planner.processes.forming.plan import two_point
from planner.processes.forming.plan.claims import scallop
from planner.processes.forming.plan.contact import MIRROR, Face, Pass, ToolPath
from planner.processes.forming.plan.operation import die_mesh
from planner.processes.forming.plan.passes import SAME_ANGLE, pass_issues
from planner.processes.forming.plan.paths.level_lines import FLATTEST_WALL
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.sheet_mechanics import ForceEstimate, estimate, payload_issue, steepest
from planner.processes.forming.plan.sheet_state import clear_issues, states
from planner.processes.forming.plan.support.clearance import clamp_issues
from planner.processes.forming.plan.support.modes import support_issues
from planner.processes.forming.plan.two_point import die_issues
from planner.tooling import profile


def check(work: Work, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> list[Issue]:
    """All issues of a job but its die's: metal, passes, forces, the die's holder, supports that cannot do as
    they should, tools that would cut into what is formed already."""
    out = [*work.tree.issues, *_metal(work), *_forces(work, setup, paths), *_clear(work, paths)]
    out += clamped_issues(work, paths)
    out += flat_issues(work, paths) if work.operation.level is None else ()
    return [*out, *two_point.step_issues(work, paths)]


def shift_issues(work: Work) -> Iterator[Issue]:
    """Features around whose wall the support cannot be turned by the stated shift (forming.shift): beyond the
    vertical it would leave the wall that it supports."""
    shift, final = work.operation.shift_deg, {one.feature: one for one in work.passes}
    for number, one in final.items():
        wall = steepest(one.vertices, one.faces) / DEG
        if shift > wall + SAME_ANGLE / DEG:
            what = (
                f"feature {number}: shift_deg is {shift:g}, allowed is 0 to {wall:.1f}, the angle of its wall"
            )
            hint = "take a smaller shift_deg; at the wall's angle the support is straight behind the former"
            yield Issue(
                "forming.shift", what, field="shift_deg", value=shift, limit=wall, unit="deg", hint=hint
            )


def step_issues(work: Work) -> Iterator[Issue]:
    """A stepdown that is more than the whole part is deep (forming.path_options): its one loop would be at
    the floor, where balls are easily too large, and nothing above it would be formed."""
    op = work.operation
    deep = max(abs(one.end - one.start) for one in work.passes) / MM
    if op.mode != "adsif" and op.stepdown_mm is not None and op.stepdown_mm > deep:
        what = f"stepdown_mm is {op.stepdown_mm:g}, allowed is up to {deep:.3g}, the depth of the part"
        hint = f"take a tenth of that, {0.1 * deep:.2g}, or state scallop_mm instead"
        yield Issue(
            "forming.path_options",
            what,
            field="operations.stepdown_mm",
            **measurement(op.stepdown_mm, deep, "mm"),
            hint=hint,
        )


def flat_issues(work: Work, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """Walls so flat that loops by a step in height leave more of a pass between them than its share lets them
    (forming.path_options)."""
    op, most = work.operation, 1.0 - work.operation.share
    for one, path in paths if op.stepdown_mm is not None and op.mode != "adsif" else ():
        mesh, radius = TriangleMesh(one.vertices, one.faces), work.heads[work.former(one)].radius
        height = one.vertices[one.faces][:, :, 2]
        level = [(np.abs(height - z) < CONTACT_TOLERANCE).all(axis=1) for z in (one.start, one.end)]
        area = np.where(level[0] | level[1], 0.0, face_areas(mesh))
        angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
        ridge = scallop(work, one) + op.gouge_tol_mm * MM
        flat = np.flatnonzero((area > 0.0) & (angle < FLATTEST_WALL) & (ridge < 0.5 * radius))
        if area[flat].sum() <= most * area.sum():
            continue
        parts, owner = small_pieces(one.vertices[one.faces[flat]], FINE_SPACING * radius, _MOST_PIECES)
        size = np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
        gone = arc_length(path.former)
        places = np.linspace(0.0, gone[-1], int(gone[-1] / (FINE_SPACING * radius)) + 2)
        apart = cKDTree(along(path.former, gone, places)).query(parts.mean(axis=1))[0]
        left = 0.5 * float(size[apart - radius > ridge[flat][owner]].sum() / area.sum())
        if left <= most:
            continue
        what = f"pass {one.name}: loops {op.stepdown_mm:g} mm apart in height leave {100 * left:.0f} % of "
        what += f"its walls between them, which are flatter than {FLATTEST_WALL / DEG:.3g} deg; allowed is "
        what += f"{100 * most:.3g} %"
        hint = "state scallop_mm: 0.01 in place of stepdown_mm: loops are then nearer where walls are flat"
        field, value, limit = "operations.stepdown_mm", 100 * left, 100 * most
        yield Issue("forming.path_options", what, field=field, value=value, limit=limit, unit="%", hint=hint)


def of_die(work: Work) -> Iterator[Issue]:
    """Issues of the die, which asks for no path: a part that it is not the die of is not to be blamed on a
    ball."""
    die = work.operation.die
    if die is not None:
        final = {one.feature: one for one in work.passes}  # shapes in between stand off the die
        tolerance = work.operation.gouge_tol_mm * MM
        yield from die_issues(tuple(final.values()), die, die_mesh(die), work.thickness, tolerance)


def force(work: Work, one: Pass, path: ToolPath) -> ForceEstimate:
    """The axial force on the forming tool of a pass."""
    op, radius = work.operation, work.heads[work.former(one)].radius
    walls = path.contact.angle[path.contact.angle > 0.0]
    if op.stepdown_mm is not None:
        step = op.stepdown_mm * MM
    else:  # the step whose ridges are as high as stated, at the steepest wall
        ridge = (op.scallop_mm or 0.0) * MM
        step = 2.0 * float(np.sin(walls.max())) * float(np.sqrt(2.0 * radius * ridge - ridge**2))
    given = None if work.stated is None else work.stated.former[one.name]
    return estimate(work.sheet.metal, work.thickness, 2.0 * radius, step, walls, given)


def _clear(work: Work, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    found = states(work.tree, work.mesh, work.passes, work.thickness, work.before)
    state_of = {one.name: state for one, state in zip(work.passes, found, strict=True)}
    for one, path in paths:
        state = state_of[one.name]
        arms = tuple(filter(None, (work.former(one), work.supporter(one))))
        heads = [work.heads[arm] for arm in arms]
        support = heads[1] if len(heads) > 1 else None
        yield from support_issues(one, path, work.operation, heads[0], support, work.thickness)
        profiles = [profile(head) for head in heads]
        yield from clear_issues(one, path, state, arms, profiles, work.pressed)


def clamped_issues(work: Work, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """Tools that reach into the clamp on the paths as they are gone (forming.clamp); motion may tilt some out
    of there."""
    if work.operation.cone_deg == 0.0:
        for one, path in paths:
            arms = tuple(filter(None, (work.former(one), work.supporter(one))))
            yield from clamp_issues(one, path, work.clamp, arms, [profile(work.heads[arm]) for arm in arms])


def _metal(work: Work) -> Iterator[Issue]:
    doubt = thickness_doubt(work.sheet.metal, work.thickness)
    if doubt is not None:
        yield doubt
    yield from pass_issues(work.passes, work.thickness, work.operation, work.sheet.metal)


def _forces(work: Work, setup: Setup, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """The largest force of each arm against what it carries."""
    most: dict[str, ForceEstimate] = {}
    for one, path in paths:
        found = force(work, one, path)
        for arm in filter(None, (work.former(one), work.supporter(one))):
            if work.operation.mode == "heat" and arm != work.former(one):
                continue
            own, support = found, work.operation.support_force_n
            if arm != work.former(one) and support is not None:
                own = ForceEstimate(support, support, support, found.angle, "support_force_n")
            if arm not in most or own.force > most[arm].force:
                most[arm] = own
    for arm, found in most.items():
        mounted = setup.cell.arm(arm)
        data = mounted.data
        issue = payload_issue(found, f"arm {arm}", data.title, data.payload, mounted.tool.mass)
        if issue is not None:
            yield issue


REACHED_WITHIN: Final = 2e-5
"""A ball that comes so near [m] to a place reaches it."""
FINE_SPACING: Final = 0.1
"""Distance of the places that are looked at, over the ball's radius."""
COARSE_SPACING: Final = 0.35
"""Distance of the places that are looked at first, over the ball's radius: corners are wider than that all
along."""
CONTACT_TOLERANCE: Final = 2e-6
"""A ball may cut into the face by so much [m]; heights that differ by less are one level."""
_WORST_PLACES: Final = 12
"""Places farthest from the ball around which corners of the mesh are looked at, too."""
_MOST_NEIGHBOURS: Final = 800
"""Places around those that are looked at, at most; of more, evenly spread ones."""
_MOST_PIECES: Final = 60_000
"""Pieces that the face is divided into at most."""
_MOST_PLANES: Final = 12
"""Planes of the face at most that bound the nearest centre of the ball; one is added in each round."""
_PROJECTION_SWEEPS: Final = 80
"""Sweeps over these planes by which the nearest centre beyond all of them is found."""


@dataclasses.dataclass(frozen=True)
class Unreached:
    """What a ball does not reach of a pass: by how much at most it stays ``off`` [m], at the place ``at``
    (3,) [m] of the face that it forms; the ``volume`` [m^3] that its fillets leave, in how many ``places``;
    and the ``share`` of the walls."""

    off: float
    at: FloatArray
    volume: float
    places: int
    share: float


def unreached(one: Pass, radius: float) -> Unreached | None:
    """What a ball of ``radius`` [m] does not reach of the face of a pass, None where it reaches all of it."""
    vertices = one.vertices if one.side > 0 else one.vertices * MIRROR
    start, end = one.side * one.start, one.side * one.end
    box = np.stack([one.region.min(axis=0), one.region.max(axis=0)])[:, :2]
    face = Face(TriangleMesh(vertices, one.faces), radius, box)
    corners = vertices[face.mesh.faces]
    moved = np.flatnonzero(
        corners[:, :, 2].min(axis=1) < start - CONTACT_TOLERANCE
    )  # the flat around is reached anyhow
    corners = corners[moved]
    parts, owner = small_pieces(corners, FINE_SPACING * radius, _MOST_PIECES)
    area = 0.5 * np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
    corner = corners[owner][:, :, 2]
    flat = [(np.abs(corner - level) < CONTACT_TOLERANCE).all(axis=1) for level in (start, end)]
    wall = np.asarray(~(flat[0] | flat[1]))
    points, normal = parts.mean(axis=1), face.normals[moved[owner]]
    few = _thinned(points, wall, COARSE_SPACING * radius)[0]
    hit = few[face.pushed(points[few], normal[few]) > REACHED_WITHIN]
    if not len(hit):
        return None
    near = cKDTree(points[hit]).query(points, distance_upper_bound=2.0 * COARSE_SPACING * radius)[0]
    some = np.flatnonzero(np.isfinite(near))
    first, cell = _thinned(points[some], wall[some], FINE_SPACING * radius)
    total = np.bincount(cell, area[some])
    all_walls = float(area[wall].sum())
    rows = some[first]
    area[rows] = total
    back = nearest_centres(face, points[rows], normal[rows]) - points[rows]
    apart = np.linalg.norm(back, axis=1)
    use = apart > radius + REACHED_WITHIN
    rows, back, apart = rows[use], back[use], apart[use]
    if not len(rows):
        return None
    # of each place the sector between it and the ball, as in a straight crease
    along = np.maximum(dots(back, normal[rows]), 0.0) / apart
    volume = float((0.5 * (apart**2 - radius**2) / apart * along * area[rows]).sum())
    k = int(np.argmax(apart))
    at = points[rows[k]] if one.side > 0 else points[rows[k]] * MIRROR
    share = float(area[rows][wall[rows]].sum() / max(all_walls, 1e-12))
    # the farthest are corners of the mesh itself, beside these
    worst = points[rows[np.argsort(apart)[-_WORST_PLACES:]]]
    around = np.unique(np.concatenate(cKDTree(points).query_ball_point(worst, 2.0 * FINE_SPACING * radius)))
    around = around[:: -(-len(around) // _MOST_NEIGHBOURS)].astype(np.int64)
    corner, up = parts[around].reshape(-1, 3), np.repeat(normal[around], 3, axis=0)
    far = np.linalg.norm(nearest_centres(face, corner, up) - corner, axis=1)
    most = max(float(far.max()), float(apart[k]))
    return Unreached(most - radius, at, volume, _groups(points[rows], radius), share)


def _thinned(points: FloatArray, wall: BoolArray, size: float) -> tuple[IntArray, IntArray]:
    """The first (C,) of N points, of walls and of what is none, in each cell of a ``size`` [m], and the cells
    (N,)."""
    key = np.column_stack([np.floor(points / size).astype(np.int64), wall])
    _, first, cell = distinct_rows(key)
    return first, cell


def nearest_centres(face: Face, points: FloatArray, normal: FloatArray) -> FloatArray:
    """The nearest centres (N, 3) [m] to ``points`` (N, 3) of a face, with unit ``normal`` (N, 3) up, of its
    balls that cut in nowhere."""
    found = points + face.radius * normal
    open_: IntArray = np.arange(len(points))
    # planes in the way: unit normals, and how far along them a centre is at least
    up = np.zeros((len(points), 0, 3))
    level = np.zeros((len(points), 0))
    for _ in range(_MOST_PLANES):
        distance, place, away = face.deepest(found[open_])
        deep = distance < face.radius - CONTACT_TOLERANCE
        open_, place, away = open_[deep], place[deep], away[deep]
        if not len(open_):
            break
        up = np.concatenate([up[deep], away[:, None]], axis=1)
        level = np.concatenate([level[deep], (dots(away, place) + face.radius)[:, None]], axis=1)
        found[open_] = _projected(points[open_], up, level)
    return found


def _projected(points: FloatArray, up: FloatArray, level: FloatArray) -> FloatArray:
    """The nearest places (N, 3) to ``points`` (N, 3) beyond K planes, ``up`` (N, K, 3), ``level`` (N, K)."""
    place = points.copy()
    push = np.zeros(level.shape)
    for _ in range(_PROJECTION_SWEEPS if level.shape[1] > 1 else 1):
        for k in range(level.shape[1]):
            free = dots(place, up[:, k]) - push[:, k]
            fresh = np.maximum(level[:, k] - free, 0.0)
            place += (fresh - push[:, k])[:, None] * up[:, k]
            push[:, k] = fresh
    return place


def _groups(points: FloatArray, radius: float) -> int:
    """How many places that are apart points (N, 3) make up."""
    near = cKDTree(points).sparse_distance_matrix(
        cKDTree(points), 4.0 * FINE_SPACING * radius, output_type="coo_matrix"
    )
    return int(connected_components(near, directed=False)[0])


def unreached_issues(work: Work) -> Iterator[Issue]:
    """What the balls do not reach of the part (forming.unreached): a note, a warning where that is more of
    the walls than may be off, or an error beyond the user's ``unreached_mm``."""
    op = work.operation
    for one in {one.feature: one for one in work.passes}.values():
        radius = work.heads[work.former(one)].radius
        found = unreached(one, radius)
        if found is None:
            continue
        limit = op.unreached_mm
        off = found.off / MM
        x, y, z = found.at / MM
        many = "one place" if found.places == 1 else f"{found.places} places"
        what = (
            f"pass {one.name}: a ball of {radius / MM:.2f} mm radius stays up to {off:.2f} mm off the part, "
            f"most at ({x:.1f}, {y:.1f}, {z:.1f}) mm, and leaves fillets of its own radius in {many}, about "
            f"{found.volume / MM**3:.3g} mm3; it does not reach {100.0 * found.share:.1f} % of the walls"
        )
        severity = Severity.NOTE if found.share <= 1.0 - op.share else Severity.WARNING
        hint = "a smaller ball reaches more, and a part that is rounded by the ball's radius is reached whole"
        if limit is None:
            hint += "; unreached_mm says how far it may stay off"
        elif off > limit:
            severity, what = Severity.ERROR, f"{what}; unreached_mm allows {limit:g} mm"
            hint = "take a smaller ball, round the part there by the ball's radius"
            hint += f", or allow {off + 0.01:.2f} mm"
        yield Issue(
            "forming.unreached",
            what,
            severity,
            field="operations.unreached_mm",
            **measurement(off, limit, "mm"),
            hint=hint,
        )
