"""Checks that a straight cut spares other surfaces, and that its leads remove nothing of the part.

The claims of a job state the deviations of each cut surface. They do not state what a lead-in removes from
another surface, so this is checked here on the planned wires. `check_other_surfaces` compares closed surfaces
with parallel rulings in sections across the wire. `check_neighbours` checks what the slot removes from all
others: strips, and surfaces whose wires have another direction.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, RuledSurface, dots
from planner.geometry.rulings import resample, tessellate
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.hotwire.plan.operation import Straight, SurfaceCut
from planner.processes.hotwire.plan.straight.cut import StraightCut
from planner.processes.hotwire.plan.straight.order import (
    NeighbourPiece,
    WireLines,
    are_parallel,
    box_chord,
    concatenate_lines,
    contour,
    enlarged_box,
    intersect_plane,
    neighbour_pieces,
    point_text,
)

GRAZE_TOLERANCE_FRACTION: Final = 0.3
"""Depth to which a slot may enter another surface or piece, as a fraction of the tolerance.

The same bound holds for a lead and its own surface.
"""
CELL_SIZE_M: Final = 4e-3
"""Size of the cells [m] into which a surface is divided to search for points near the wires."""
FINE_CELL_SIZE_M: Final = 5e-4
"""Size of the refined cells [m]."""
EVEN_DISTANCE_TOLERANCE_M: Final = 1e-4
"""Cells whose corners and centre differ less in their distance [m] to the wires are not refined."""
CHECK_CHORD_TOLERANCE_M: Final = 2e-5
"""Chord error [m] of the checked surfaces."""
CELL_BATCH_SIZE: Final = 2_000
"""Number of cells that are refined in one batch."""
MIN_BENEATH_COSINE: Final = 0.7
"""Minimum cosine between a surface's normal and the direction from the wire for a surface above the wire."""
MAX_FACING_COSINE: Final = -0.5
"""Surfaces face each other over a gap if the cosine of their normals is below this."""
MIN_CROSSING_DISTANCE_M: Final = 1e-5
"""A surface crosses another if it is on both sides of it by more than this [m]."""
MEETING_TOLERANCE_M: Final = 1e-7
"""Tolerance for rounding errors [m] where surfaces meet."""
CROSSING_SAMPLES: Final = 700
"""Number of points that decide whether surfaces cross."""
_PAIR_BATCH_SIZE: Final = 300_000
"""Number of pairs of a point and a ruling that are processed in one batch."""


def check_neighbours(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield ``straight.crossing`` if the slot of a cut removes foam of another surface of the part.

    The other surface may be cut before or after. If two surfaces cross, foam outside one of them does not
    belong to the part, so removing it there is allowed. Pairs of closed surfaces with parallel rulings are
    left out, because `check_other_surfaces` compares them in sections. At most one issue is yielded.

    Args:
        op: Operation with a straight wire.
        cut: The cut.
        ruled: All ruled surfaces of the part.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    surface, lines, half = cut.nominal.ruled, cut.on.lines, cut.on.half
    reach = float(half.max()) + MIN_CROSSING_DISTANCE_M
    allowed = GRAZE_TOLERANCE_FRACTION * op.shape_tol_mm * MM
    for other in ruled:
        if other.name == surface.name or (surface.closed and other.closed and are_parallel(surface, other)):
            continue
        cells = _cells_near_wires(_surface_cells(other), lines, half, box, reach + CELL_SIZE_M)
        uneven = _needs_refinement(cells, lines, half)
        coarse = cells[uneven]
        finer = [
            _cells_near_wires(_refine_cells(coarse[k : k + CELL_BATCH_SIZE]), lines, half, box, reach)
            for k in range(0, len(coarse), CELL_BATCH_SIZE)
        ]
        cells = np.concatenate([cells[~uneven], *finer])
        if not len(cells):
            continue
        points, normal = cells.mean(axis=1), _cell_normals(cells)
        distance, foot, half_slot = _nearest_on_wires(points, lines, half)
        normal_distance = dots(foot - points, normal)
        # At points outside the cut's own surface, a wire beneath the other surface has removed all foam above
        # it: the depth is half the slot plus the distance beneath. Elsewhere a slot removes what it reaches.
        is_beyond = (normal_distance <= -MIN_BENEATH_COSINE * distance) & (
            distance < half_slot + MIN_CROSSING_DISTANCE_M
        )
        is_beyond[is_beyond] = _signed_distance(surface, points[is_beyond])[0] > -MEETING_TOLERANCE_M
        depth = half_slot - np.where(is_beyond, normal_distance, distance)
        violating = np.flatnonzero(depth > allowed)
        violating = violating[_bounds_part(points[violating], other, ruled, box)]
        if len(violating):
            k = int(violating[np.argmax(depth[violating])])
            facing = float(_signed_distance(surface, points[[k]])[1][0] @ normal[k]) < MAX_FACING_COSINE
            yield _crossing_issue(op, cut, other, (depth[k], half_slot[k]), points[k], facing)
            return


def _crossing_issue(
    op: Straight,
    cut: StraightCut,
    other: RuledSurface,
    depth_and_half_slot: tuple[float, float],
    point: FloatArray,
    is_facing: bool,
) -> Issue:
    """Return the issue ``straight.crossing`` for the deepest point of a slot in another surface.

    Args:
        op: Operation with a straight wire.
        cut: The cut whose slot it is.
        other: The other surface.
        depth_and_half_slot: Depth and half the slot at the point [m].
        point: The point (3,) [m].
        is_facing: Whether both surfaces face each other over a gap, which is too narrow for the slot then.
    """
    depth = depth_and_half_slot[0] / MM
    slot = 2.0 * depth_and_half_slot[1] / MM
    position = "[" + ", ".join(f"{value / MM:.1f}" for value in point) + "] mm"
    remedy = (
        f"their distance is {slot - depth:.2f} mm there and the slot needs {slot:.2f} mm; move them apart by "
        f"{depth:.2f} mm or use a thinner slot"
        if is_facing
        else f"the slot is {slot:.2f} mm wide; make both one surface with a corner, or move them apart"
    )
    return Issue(
        "straight.crossing",
        f"{op.name}: the slot of {cut.nominal.segment} removes {depth:.2f} mm of {other.name} at {position}: "
        f"{remedy}",
        field=str(cut.nominal.segment),
        **measurement(depth, GRAZE_TOLERANCE_FRACTION * op.shape_tol_mm, "mm"),
    )


def _surface_cells(ruled: RuledSurface) -> FloatArray:
    """Return a surface as patches (N, 4, 3) [m] with edges of at most ``CELL_SIZE_M``."""
    fine = resample(ruled, CHECK_CHORD_TOLERANCE_M, CELL_SIZE_M)
    a, b = (np.concatenate([p, p[:1]]) if ruled.closed else p for p in (fine.start, fine.end))
    count = max(int(np.ceil(np.linalg.norm(b - a, axis=1).max() / CELL_SIZE_M)), 1)
    fraction = np.linspace(0.0, 1.0, count + 1)[None, :, None]
    grid = a[:, None] + fraction * (b - a)[:, None]
    return np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)


def _refine_cells(cells: FloatArray) -> FloatArray:
    """Divide each patch (N, 4, 3) into patches of size ``FINE_CELL_SIZE_M``."""
    count = int(np.ceil(CELL_SIZE_M / FINE_CELL_SIZE_M))
    u, v = np.meshgrid(np.arange(count) / count, np.arange(count) / count)
    corners = []
    for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
        x, y = (u + du / count).ravel()[:, None], (v + dv / count).ravel()[:, None]
        a, b, c, d = (cells[:, None, k] for k in range(4))
        corners.append((1 - x) * (1 - y) * a + x * (1 - y) * b + x * y * c + (1 - x) * y * d)
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def _needs_refinement(cells: FloatArray, lines: WireLines, half: FloatArray) -> BoolArray:
    """Return whether each patch (N,) must be divided to find its smallest distance to the wires.

    It must be divided if the distances of its corners and its centre differ by more than
    `EVEN_DISTANCE_TOLERANCE_M`.
    """
    distance = np.stack(
        [_nearest_on_wires(cells[:, k], lines, half)[0] for k in range(4)]
        + [_nearest_on_wires(cells.mean(axis=1), lines, half)[0]]
    )
    return np.asarray(np.ptp(distance, axis=0) > EVEN_DISTANCE_TOLERANCE_M)


def _cell_normals(cells: FloatArray) -> FloatArray:
    """Return the unit normals (N, 3) of patches (N, 4, 3), away from the part. Those without area have 0."""
    across_rulings = cells[:, 1] + cells[:, 2] - cells[:, 0] - cells[:, 3]
    normal = np.cross(across_rulings, cells[:, 2] + cells[:, 3] - cells[:, 0] - cells[:, 1])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))


def _cells_near_wires(
    cells: FloatArray, lines: WireLines, half: FloatArray, box: FloatArray, reach: float
) -> FloatArray:
    """Return the patches whose centres are in the box and within ``reach`` [m] of a wire's path.

    A tree of sampled points rejects most patches before the exact distance is computed.
    """
    middle = cells.mean(axis=1)
    first, last = box_chord(lines, enlarged_box(box, CELL_SIZE_M))
    meets = np.isfinite(first)
    if not meets.any():
        return cells[:0]
    ends = [lines[meets].at(length[meets]) for length in (first, last)]
    low, high = np.min(ends, axis=(0, 1)) - reach, np.max(ends, axis=(0, 1)) + reach
    is_candidate = ((middle > box[0]) & (middle < box[1]) & (middle > low) & (middle < high)).all(axis=1)
    candidates = np.flatnonzero(is_candidate)
    count = int(np.ceil(np.linalg.norm(ends[1] - ends[0], axis=1).max() / CELL_SIZE_M)) + 1
    points = np.linspace(ends[0], ends[1], count, axis=1)
    step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(initial=0.0)
    gap = 0.5 * float(np.hypot(CELL_SIZE_M, step))  # farthest that a point of the path is from a sample
    tree = cKDTree(points.reshape(-1, 3))
    candidates = candidates[np.isfinite(tree.query(middle[candidates], distance_upper_bound=reach + gap)[0])]
    if len(candidates):
        candidates = candidates[_nearest_on_wires(middle[candidates], lines, half)[0] < reach]
    return cells[candidates]


def _nearest_on_wires(
    points: FloatArray, lines: WireLines, half: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the nearest points to points (N, 3) on the wires and on the straight moves between them.

    Returns:
        Distance (N,) [m], nearest point (N, 3) [m], half the slot there (N,) [m].
    """
    return _nearest_with_position(points, lines, half, mark_ends=False)[:3]


def _nearest_with_position(
    points: FloatArray, lines: WireLines, half: FloatArray, mark_ends: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the three results of :func:`_nearest_on_wires`, and the positions (N,) of the nearest points.

    A position counts lines: 3.5 is halfway from line 3 to line 4. With ``mark_ends`` it is NaN for points
    beyond the guide points of the wires.
    """
    direction = lines.direction
    length = np.linalg.norm(lines.end - lines.start, axis=1)
    base = dots(lines.start, direction)
    distance, half_slot, position = np.zeros(len(points)), np.zeros(len(points)), np.zeros(len(points))
    foot = np.zeros((len(points), 3))
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) * len(lines) // _PAIR_BATCH_SIZE)):
        length_along = points[chunk] @ direction.T - base
        points_on_lines = lines.start + length_along[..., None] * direction
        move = np.diff(points_on_lines, axis=1)
        gap = points[chunk, None] - points_on_lines[:, :-1]
        fraction = np.clip(dots(gap, move) / np.maximum(dots(move, move), 1e-30), 0.0, 1.0)
        gap = gap - fraction[..., None] * move
        distances = np.sqrt(dots(gap, gap))
        n, k = np.arange(len(chunk)), np.argmin(distances, axis=1)
        nearest_fraction = fraction[n, k]
        distance[chunk] = distances[n, k]
        foot[chunk] = points[chunk] - gap[n, k]
        position[chunk] = k + nearest_fraction
        # level: 0 at the guide point at the start of the wire, 1 at that at its end
        level = (1.0 - nearest_fraction) * length_along[n, k] / length[k] + nearest_fraction * length_along[
            n, k + 1
        ] / length[k + 1]
        level_in = np.clip(level, 0.0, 1.0)
        first_half, second_half = (
            (1.0 - level_in) * half[k + i, 0] + level_in * half[k + i, 1] for i in (0, 1)
        )
        half_slot[chunk] = (1.0 - nearest_fraction) * first_half + nearest_fraction * second_half
        if mark_ends:
            position[chunk] = np.where((level < 0.0) | (level > 1.0), np.nan, position[chunk])
    return distance, foot, half_slot, position


def _signed_distance(ruled: RuledSurface, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return signed distances (N,) [m] of points (N, 3) from a surface, and its unit normals (N, 3) there.

    Distances are negative on the part's side. They are NaN beyond the rims of the surface.
    """
    fine = resample(ruled, CHECK_CHORD_TOLERANCE_M, 0.05)
    start, end = (np.concatenate([p, p[:1]]) if ruled.closed else p for p in (fine.start, fine.end))
    lines = WireLines(start, end)
    distance, foot, _, position = _nearest_with_position(points, lines, np.zeros((len(start), 2)), True)
    normal = _cell_normals(np.stack([start[:-1], start[1:], end[1:], end[:-1]], axis=1))
    last = len(normal) - 1
    is_known = np.isfinite(position)
    if not ruled.closed:
        is_known &= (position > 0.0) & (position < last + 1)
    index = np.where(np.isfinite(position), position, 0.0)
    # Patches before and after the nearest point, which differ if it lies on a line: there ceil and floor of
    # the position are equal. The sum of both normals then tells the side.
    low, high = np.ceil(index).astype(np.intp) - 1, np.floor(index).astype(np.intp)
    ring = (low % (last + 1), high % (last + 1)) if ruled.closed else (low.clip(0, last), high.clip(0, last))
    mean = normal[ring[0]] + normal[ring[1]]
    outside = dots(points - foot, mean) >= 0.0
    mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-30)
    return np.where(is_known, np.where(outside, distance, -distance), np.nan), mean


def _bounds_part(
    candidates: FloatArray, surface: RuledSurface, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> BoolArray:
    """Return whether each of the points (N, 3) of a surface belongs to the boundary of the part.

    Removing foam at other points is allowed. A point does not belong to the boundary if it is outside another
    surface that crosses this one in the box.
    """
    is_boundary = np.ones(len(candidates), dtype=np.bool_)
    if not len(candidates):
        return is_boundary
    points = np.concatenate([_surface_cells(surface).mean(axis=1), candidates])
    points = points[((points > box[0]) & (points < box[1])).all(axis=1)]
    # random, because a stride would select one row of cells
    points = np.random.default_rng(0).permutation(points)[:CROSSING_SAMPLES]
    for other in ruled:
        if other.name != surface.name:
            distance = _signed_distance(other, points)[0]
            if (distance > MIN_CROSSING_DISTANCE_M).any() and (distance < -MIN_CROSSING_DISTANCE_M).any():
                is_boundary &= ~(_signed_distance(other, candidates)[0] > -MEETING_TOLERANCE_M)
    return is_boundary


def _extended_strip(ruled: RuledSurface, box: FloatArray) -> RuledSurface:
    """Return a strip extended straight beyond both ends, by the diagonal of the block (2, 3).

    A closed surface is returned unchanged.
    """
    if ruled.closed:
        return ruled
    length = float(np.linalg.norm(np.ptp(box, axis=0)))
    ends = np.stack([ruled.start, ruled.end])
    direction = (ends[:, [0, -1]] - ends[:, [1, -2]]).sum(axis=0)
    extensions = ends[:, [0, -1]] + length * direction / np.maximum(
        np.linalg.norm(direction, axis=1, keepdims=True), 1e-30
    )
    ends = np.concatenate([extensions[:, :1], ends, extensions[:, 1:]], axis=1)
    corner = np.concatenate([[True], ruled.corner, [True]])
    return dataclasses.replace(ruled, start=ends[0], end=ends[1], corner=corner)


LEVEL_FRACTIONS: Final = (0.02, 0.5, 0.98)
"""Positions of the sections in which slots are compared with other pieces, as fractions of the rulings."""
MAX_SLIT_LENGTH_PER_CROSSING: Final = 6.0
"""Allowed length of a slit close to another contour at each crossing, in half slots.

A slit is within half a slot of a straight contour for 2 / sin(angle) half slots: 6 at a crossing of 20
degrees.
"""
LEAD_FRACTIONS: Final = np.linspace(0.01, 0.99, 9)
"""Points of the wire, as fractions of its length in the foam, whose paths on leads are checked."""
LEAD_CHORD_TOLERANCE_M: Final = 2e-4
"""Chord error [m] of surfaces that leads might cross."""


def check_other_surfaces(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield issues of a cut that removes foam of other surfaces of the part.

    Codes: ``straight.crossing``, and ``straight.lead`` for foam that leads remove, also of the cut's own
    surface. `check_neighbours` is called only if the checks of slots in sections and of leads find nothing.

    Args:
        op: Operation with a straight wire.
        cut: The cut.
        ruled: All ruled surfaces of the part.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    issues: list[Issue] = []
    if cut.nominal.ruled.closed:
        issues += [*_slot_overlap_issues(op, cut, ruled, box), *_parallel_slit_issues(op, cut, ruled, box)]
    elif isinstance(cut.nominal.cut, SurfaceCut):
        issues += [*_lead_side_issues(op, cut), *_entering_lead_issues(op, cut, ruled, box)]
    yield from issues or check_neighbours(op, cut, ruled, box)


def _slot_overlap_issues(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield an issue if the slot or a lead of a closed cut reaches another piece with parallel rulings.

    The code is ``straight.crossing`` for the slot and ``straight.lead`` for a lead. Leads of holes and of
    pieces inside holes are left out. At most one issue is yielded.
    """
    allowed = GRAZE_TOLERANCE_FRACTION * op.shape_tol_mm * MM
    for level in LEVEL_FRACTIONS:
        pieces = neighbour_pieces(cut.nominal.ruled, ruled, box, level)
        if not pieces.others:
            continue
        paths = (
            ("straight.crossing", cut.on.lines, cut.on.half),
            ("straight.lead", cut.into, cut.on.half[:1]),
            ("straight.lead", cut.out, cut.on.half[-1:]),
        )
        for code, lines, half in paths:
            if code == "straight.lead" and (cut.nominal.ruled.hole or pieces.enclosed):
                continue  # its slit is reported by check_cut
            others = [p for p in pieces.others if code == "straight.crossing" or not p.around]
            overlap = _deepest_overlap(
                intersect_plane(lines, pieces.plane), half.max(axis=1), others, allowed
            )
            if overlap is None:
                continue
            depth, position, other = overlap
            point = pieces.plane.point(position)
            tool = "the slot" if code == "straight.crossing" else "the lead-in or lead-out"
            yield Issue(
                code,
                f"{op.name}: {tool} of {cut.nominal.segment} removes {depth / MM:.2f} mm of {other.name} at "
                f"{point_text(point)}; move the pieces apart, use a thinner slot"
                + ("" if code == "straight.crossing" else " or state another lead"),
                field=str(cut.nominal.segment),
                **measurement(depth / MM, allowed / MM, "mm"),
            )
            return


def _parallel_slit_issues(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield ``straight.lead`` if the slit to a closed cut runs along another contour, not just across it.

    Only slits of at least 0.1 mm in the part count. The length within half a slot of the other contour may be
    `MAX_SLIT_LENGTH_PER_CROSSING` half slots for each crossing.
    """
    if cut.start is None or cut.start.length_in_part < 1e-4:
        return
    pieces = neighbour_pieces(cut.nominal.ruled, ruled, box, 0.5)
    half = float(cut.on.half[[0, -1]].max())
    allowed = GRAZE_TOLERANCE_FRACTION * op.shape_tol_mm * MM
    for lines in (cut.into, cut.out):
        path = shapely.LineString(intersect_plane(lines, pieces.plane)[[0, -1]])
        for other in ruled:
            if not other.closed or other.name == cut.nominal.ruled.name:
                continue
            border = shapely.boundary(contour(other, pieces.plane))
            length_alongside = path.intersection(shapely.buffer(border, half)).length
            crossings = (
                shapely.get_num_geometries(path.intersection(border)) if path.intersects(border) else 0
            )
            if length_alongside > MAX_SLIT_LENGTH_PER_CROSSING * half * crossings + allowed:
                yield Issue(
                    "straight.lead",
                    f"{op.name}: the slit to {cut.nominal.segment} runs along {other.name} for "
                    f"{length_alongside / MM:.1f} mm and removes material of it; state another lead",
                    field=str(cut.nominal.segment),
                    **measurement(
                        length_alongside / MM, MAX_SLIT_LENGTH_PER_CROSSING * half * crossings / MM, "mm"
                    ),
                )
                return


def _deepest_overlap(
    path: FloatArray, half: FloatArray, others: list[NeighbourPiece], allowed: float
) -> tuple[float, FloatArray, NeighbourPiece] | None:
    """Return where the slot about a path enters other pieces most deeply.

    Args:
        path: Path of the wire in the section (N, 2) [m].
        half: Half slots along the path, (N,) or (1,) [m].
        others: The pieces.
        allowed: Depth that is not reported [m].

    Returns:
        Depth [m], position in the section (2,) [m] and piece, or None if no depth exceeds ``allowed``.
    """
    if len(path) < 2 or not others:
        return None
    moves = shapely.linestrings(np.stack([path[:-1], path[1:]], axis=1))
    half = np.broadcast_to(half, (len(path),))
    half_slot = np.maximum(half[:-1], half[1:])
    tree = shapely.STRtree([piece.shape for piece in others])
    move, piece = tree.query(moves, predicate="dwithin", distance=np.maximum(half_slot - allowed, 0.0))
    if not len(move):
        return None
    depth = half_slot[move] - shapely.distance(moves[move], tree.geometries[piece])
    k = int(np.argmax(depth))
    return float(depth[k]), path[move[k]], others[int(piece[k])]


def _lead_side_issues(op: Straight, cut: StraightCut) -> Iterator[Issue]:
    """Yield ``straight.lead`` if the lead-in of a strip comes through the part, from below its surface.

    An automatic lead that continues the strip straight beyond its end is allowed.
    """
    foot, into = cut.on.row.foot, cut.into
    if len(into) < 2:
        return
    direction = into.start[0] + into.end[0] - into.start[-1] - into.end[-1]
    normal = cut.on.row.normal[0].mean(axis=0)
    depth = -0.5 * float(direction @ normal) / max(float(np.linalg.norm(normal)), 1e-12)
    if depth <= GRAZE_TOLERANCE_FRACTION * op.shape_tol_mm * MM:
        return
    # an automatic lead may go straight on where the strip bends away beyond its end
    straight_direction = foot.start[0] + foot.end[0] - foot.start[1] - foot.end[1]
    if (
        isinstance(cut.nominal.cut, SurfaceCut)
        and cut.nominal.cut.lead == "auto"
        and direction @ straight_direction > 0.0
    ):
        return
    message = (
        f"{op.name}: the lead of {cut.nominal.segment} comes through the part, {depth / MM:.1f} mm below "
    )
    message += f"its surface, to {point_text(foot.start[0])}; state a lead on the outer side, or auto"
    yield Issue(
        "straight.lead", message, field=str(cut.nominal.segment), **measurement(depth / MM, 0.0, "mm")
    )


def _entering_lead_issues(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield ``straight.lead`` if a lead of a strip enters the part through another surface.

    Surfaces that the strip itself crosses do not count. Entries at points that do not bound the part
    (`_bounds_part`) do not count either. To decide this, strips are extended straight, as their leads are.
    """
    wires = cut.on.lines
    bounds = tuple(_extended_strip(surface, box) for surface in ruled)
    min_distance = 4.0 * float(cut.on.half.max())
    for other in ruled:
        if other.name == cut.nominal.ruled.name:
            continue
        mesh = tessellate(resample(other, LEAD_CHORD_TOLERANCE_M, 0.05), LEAD_CHORD_TOLERANCE_M)
        triangles = mesh.vertices[mesh.faces]
        inner = _inner_lines(wires, min_distance)
        # a surface that the strip itself crosses does not count; about 40 to 80 of its wires decide this
        sampled = inner[:: max(1, len(inner) // 40)]
        if len(inner) > 1 and any(
            map(len, _triangle_crossings(sampled, triangles, box, both_directions=True))
        ):
            continue
        out = cut.out[: cut.reversal] if cut.reversal else cut.out
        for lines, word in ((cut.into.reversed(), "in"), (out, "out")):
            # from the previous wire, because the last one may lie exactly in the other surface
            ends = concatenate_lines([wires[[1 if word == "in" else -2]], lines[[-1]]])
            entry_points = np.concatenate(
                list(_triangle_crossings(ends, triangles, box, both_directions=False))
            )
            entry_points = entry_points[_bounds_part(entry_points, other, bounds, box)]
            if len(entry_points):
                message = f"{op.name}: the lead-{word} of {cut.nominal.segment} goes straight through the "
                message += (
                    f"part, which it enters through {other.name} at {point_text(entry_points[0])}; make "
                )
                message += "both one surface with a corner, or move them apart"
                yield Issue("straight.lead", message, field=str(cut.nominal.segment))
                return


def _inner_lines(lines: WireLines, min_distance: float) -> WireLines:
    """Return the lines that are farther than ``min_distance`` [m] from the first and the last one."""
    middle = 0.5 * (lines.start + lines.end)
    is_far = [np.linalg.norm(middle - middle[k], axis=1) > min_distance for k in (0, -1)]
    return lines[is_far[0] & is_far[1]]


def _triangle_crossings(
    lines: WireLines, triangles: FloatArray, box: FloatArray, both_directions: bool
) -> Iterator[FloatArray]:
    """Yield the points (K, 3) where moves of points of the wire in the foam cross triangles (T, 3, 3).

    There is one result for each of `LEAD_FRACTIONS` on each move from line to line. Crossings count from
    outside to inside, or in both directions. Source: Moller and Trumbore's test.
    """
    # outside the block the points are distributed between the guide points of the wire
    length = np.linalg.norm(lines.end - lines.start, axis=1)
    first, last = box_chord(lines, box)
    first, last = np.nan_to_num(first), np.where(np.isfinite(last), last, length)
    length_along = first[:, None] + (last - first)[:, None] * LEAD_FRACTIONS
    base = lines.start[:, None] + lines.direction[:, None] * length_along[..., None]
    origin, moves = base[:-1].reshape(-1, 3), np.diff(base, axis=0).reshape(-1, 3)
    a, edge_1, edge_2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    for start, move in zip(origin, moves, strict=True):
        cross = np.cross(move, edge_2)
        determinant = np.sum(edge_1 * cross, axis=1)
        divisor = np.where(np.abs(determinant) > 1e-18, determinant, np.inf)
        from_vertex = start - a
        u = np.sum(from_vertex * cross, axis=1) / divisor
        cross_edge = np.cross(from_vertex, edge_1)
        v = cross_edge @ move / divisor
        t = np.sum(edge_2 * cross_edge, axis=1) / divisor
        hit = (u > 0.0) & (v > 0.0) & (u + v < 1.0) & (t > 0.0) & (t < 1.0)
        if not both_directions:
            hit &= np.cross(edge_1, edge_2) @ move < 0.0
        yield start + t[hit, None] * move
