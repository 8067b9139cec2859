"""The wire next to a ruled surface: each end of a ruling is moved outward by half of its own kerf.

The wire passes a convex corner on a polygon around the circle with a radius of half a kerf, so it nowhere
comes closer to the part. It passes an inner corner through the point that is half a kerf from both sides.

**Inner corners.** Where a surface is bent inward more tightly than half a slot, foam remains that the slot
cannot reach. This foam is reported. Next to an inner corner whose sides are shorter than half a
slot, or an inner curve of a smaller radius, the wires at half a slot form a loop. It is cut off where it
crosses itself: at the point that is half a slot from both sides (a vertex of the offset curve).

**The slot between guide points** (`melt_slots`). A wire that rotates moves slowly near its centre of
rotation, so its slot becomes wide there although both ends are fast. The slot is therefore checked all along
the wire, at and between its guide points.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, RuledSurface
from planner.geometry.rulings import outward_sides
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.straight.order import (
    WireLines,
    box_chord,
    concatenate_lines,
    distance_to_polyline,
    fastest_move,
    transverse_move,
)

DampingSchedule = tuple[tuple[float, int], ...]
"""Pairs of an exponent and a maximum number of iterations, see ``DAMPING_SCHEDULE``."""

MAX_VERTEX_ROTATION_RAD: Final = np.deg2rad(60.0)
"""Largest rotation [rad] at one vertex of the polygon around a convex corner.

The wire stays within 1 / cos 30 deg of half a kerf.
"""
MIN_VERTEX_ROTATION_RAD: Final = np.deg2rad(2.0)
"""A corner with a rotation below this [rad] needs a single vertex."""
CUSP_ROTATION_RAD: Final = np.deg2rad(175.0)
"""A rotation above this [rad] is a cusp of the part. The wire goes round it, whatever the sign."""
HALF_KERF_TOLERANCE_M: Final = 1e-7
"""Half kerfs have converged if one more iteration changes none of them by more than this [m]."""
DAMPING_SCHEDULE: Final[DampingSchedule] = ((0.5, 60), (0.25, 120), (0.1, 300), (0.05, 600))
"""Exponents and maximum numbers of iterations of the fixed point of the half kerfs.

The kerf follows from the speed, the speed from the path, and the path from the kerf. Each iteration takes the
given fraction of the step between the logarithms of two iterates. If a fraction is too large to converge, the
iteration starts again with the next one. A wide slot drives its end outward, which makes it faster and its
slot narrow: full steps oscillate forever around an edge that is blunt at one end and sharp at the other.
"""
MIN_MOVE_M: Final = 1e-5
"""Minimum length [m] of a move from which a speed is derived."""
MELTING_DISTANCE_M: Final = 1e-3
"""Distance [m] along the path, to each side, over which the speed of a slot is averaged.

Over shorter distances the wire melts one slot, whatever its speed is. Without the average, moves shorter than
half a kerf would make the iteration diverge.
"""


@dataclasses.dataclass(frozen=True)
class OffsetRow:
    """Positions of N wires next to a surface, in the order of the cut.

    Attributes:
        foot: Ruling of the surface next to each wire (N).
        normal: Offset of the wire from its ruling per half kerf, at start and end (N, 2, 3).
        corner_rotation: Rotation of the normal at the whole corner to which the wire belongs, at start and
            end, positive if convex (N, 2) [rad]. 0 away from corners.
    """

    foot: WireLines
    normal: FloatArray
    corner_rotation: FloatArray

    def __getitem__(self, rows: BoolArray) -> "OffsetRow":
        return OffsetRow(self.foot[rows], self.normal[rows], self.corner_rotation[rows])

    def lines(self, half: FloatArray) -> WireLines:
        """Return the wires for half kerfs (N, 2) [m]."""
        offset = half[:, :, None] * self.normal
        return WireLines(self.foot.start + offset[:, 0], self.foot.end + offset[:, 1])


@dataclasses.dataclass(frozen=True)
class WireOffset:
    """N wires next to a surface.

    Attributes:
        row: Positions of the wires.
        half: Half kerfs at start and end (N, 2) [m].
        speed: Speeds of both guide points if the fastest point in the foam has the feed (N, 2) [m/s].
        converged: Whether half kerfs and speeds are consistent. If not, they are those of wires offset by
            half the kerf at the feed, which is the best available approximation.
    """

    row: OffsetRow
    half: FloatArray
    speed: FloatArray
    converged: bool = True

    @property
    def lines(self) -> WireLines:
        """The wires."""
        return self.row.lines(self.half)


def make_row(
    ruled: RuledSurface,
    first: int = 0,
    backward: bool = False,
    max_vertex_rotation: float = MAX_VERTEX_ROTATION_RAD,
) -> OffsetRow:
    """Return the positions of wires next to a surface. For a closed one they end at the first ruling again.

    Args:
        ruled: The surface.
        first: First ruling of a closed surface.
        backward: Whether the rulings are cut in reverse order.
        max_vertex_rotation: Largest rotation at one vertex around a convex corner [rad].
    """
    count = len(ruled.start)
    order = np.arange(count + 1 if ruled.closed else count)
    order = (first - order if backward else first + order) % count if ruled.closed else order
    if backward and not ruled.closed:
        order = order[::-1]
    previous_normal, next_normal = outward_sides(ruled)
    if backward:
        previous_normal, next_normal = next_normal, previous_normal
    previous_normal, next_normal = previous_normal[order], next_normal[order]
    corner = ruled.corner[order].copy()
    if ruled.closed and corner[0]:  # the two sides of the first corner are separate ends
        previous_normal[0], next_normal[-1] = next_normal[0], previous_normal[-1]
        corner[[0, -1]] = False
    foot = WireLines(ruled.start[order], ruled.end[order])
    rotation = (
        _corner_rotations(previous_normal, next_normal, foot.direction, -1.0 if backward else 1.0)
        * corner[:, None]
    )
    return _with_vertices(foot, previous_normal, rotation, -1.0 if backward else 1.0, max_vertex_rotation)


def _corner_rotations(
    previous_normal: FloatArray, next_normal: FloatArray, direction: FloatArray, sign: float
) -> FloatArray:
    """Return the rotations (N, 2) [rad] of the normals at both ends of rulings, positive at a convex corner.

    Args:
        previous_normal: Unit normals of the side before each ruling, at start and end (N, 2, 3).
        next_normal: Unit normals of the side after it (N, 2, 3).
        direction: Directions of the rulings (N, 3).
        sign: -1 if the rulings are cut in reverse order, else 1.
    """
    axis = direction[:, None]
    angle = np.arctan2(
        np.sum(np.cross(previous_normal, next_normal) * axis, axis=2),
        np.sum(previous_normal * next_normal, axis=2),
    )
    return np.asarray(np.where(np.abs(angle) > CUSP_ROTATION_RAD, np.abs(angle), sign * angle))


def _with_vertices(
    foot: WireLines, normal_before: FloatArray, rotation: FloatArray, sign: float, max_vertex_rotation: float
) -> OffsetRow:
    """Return the row with as many wires at each corner as its rotation needs, on a polygon around it.

    Args:
        foot: Rulings (N).
        normal_before: Unit normals of the side before each ruling, at start and end (N, 2, 3).
        rotation: Rotations of the normal at the rulings (N, 2) [rad], positive if convex.
        sign: -1 if the rulings are cut in reverse order, else 1.
        max_vertex_rotation: Largest rotation at one vertex of the polygon [rad].
    """
    max_rotation = np.abs(rotation).max(axis=1)
    inner = rotation.min(axis=1) < -MIN_VERTEX_ROTATION_RAD
    # wires per ruling: one away from corners and at inner ones; then each wire's number at its ruling
    parts = np.where(
        inner | (max_rotation < MIN_VERTEX_ROTATION_RAD), 1, np.ceil(max_rotation / max_vertex_rotation)
    ).astype(np.intp)
    rulings = np.repeat(np.arange(len(foot)), parts)
    vertex_number = np.arange(len(rulings)) - np.repeat(np.cumsum(parts) - parts, parts)
    vertex_rotation = rotation[rulings] / parts[rulings, None]
    angle = sign * vertex_rotation * (vertex_number[:, None] + 0.5)
    unit_normal, axis = normal_before[rulings], foot.direction[rulings][:, None]
    normal = np.cos(angle)[..., None] * unit_normal + np.sin(angle)[..., None] * np.cross(axis, unit_normal)
    normal /= np.cos(0.5 * vertex_rotation)[..., None]  # vertices of a polygon around the circle
    return OffsetRow(foot[rulings], normal, rotation[rulings])


def wire_offset(
    row: OffsetRow, kerf: KerfCurve, feed: float, box: FloatArray, damping: DampingSchedule = DAMPING_SCHEDULE
) -> WireOffset:
    """Return the wires next to a surface, each end offset by half the kerf at its own speed.

    Wires next to an inner corner that are beyond its other side are dropped.

    Args:
        row: Positions of the wires.
        kerf: Kerf over speed.
        feed: Speed of the fastest point in the box [m/s].
        box: Lower and upper corner of the block (2, 3) [m].
        damping: Damping of the iteration, as ``DAMPING_SCHEDULE``.
    """
    offset = _iterate_half_kerfs(row, kerf, feed, box, damping)
    keep = _clear_of_inner_corners(offset) if offset.converged else np.ones(len(row.foot), dtype=np.bool_)
    return offset if keep.all() else _iterate_half_kerfs(row[keep], kerf, feed, box, damping)


def _iterate_half_kerfs(
    row: OffsetRow, kerf: KerfCurve, feed: float, box: FloatArray, damping: DampingSchedule
) -> WireOffset:
    """Solve for half kerfs h that are consistent with their speeds, by damped iteration.

    h_(k+1) = h_k (w(v(h_k)) / 2 h_k)^s with exponent s from ``damping``.
    """
    first = 0.5 * kerf.at(np.full((len(row.foot), 2), feed))
    for exponent, rounds in damping:
        half = first
        for _ in range(rounds):
            speed = end_speeds(row.lines(half), feed, box)
            next_half = 0.5 * kerf.at(speed)
            if np.abs(next_half - half).max() <= HALF_KERF_TOLERANCE_M:
                return WireOffset(row, half, speed)
            half = half * (next_half / half) ** exponent
    speed = end_speeds(row.lines(first), feed, box)
    return WireOffset(row, 0.5 * kerf.at(speed), speed, converged=False)


def end_speeds(lines: WireLines, feed: float, box: FloatArray) -> FloatArray:
    """Return the speeds (N, 2) [m/s] of both guide points across the wire.

    They are averaged over the moves to and from each line, and at least over ``MELTING_DISTANCE_M`` to each
    side. The first and the last line have the speed of their only move.

    Args:
        lines: N wires.
        feed: Speed of the fastest point in the box [m/s].
        box: Lower and upper corner of the block (2, 3) [m].
    """
    ends = np.stack(
        [transverse_move(lines, lines.start[:-1]), transverse_move(lines, lines.end[:-1])], axis=1
    )
    fastest_moves = fastest_move(lines, box)[1:]
    fastest_moves = np.where(np.isfinite(fastest_moves), fastest_moves, ends.max(axis=1))
    travelled = np.concatenate([[0.0], np.cumsum(np.maximum(fastest_moves, 1e-12))])
    low = np.minimum(np.concatenate([travelled[:1], travelled[:-1]]), travelled - MELTING_DISTANCE_M).clip(
        travelled[0]
    )
    high = np.maximum(np.concatenate([travelled[1:], travelled[-1:]]), travelled + MELTING_DISTANCE_M).clip(
        None, travelled[-1]
    )
    out = np.empty((len(lines), 2))
    for k in range(2):
        end_travelled = np.concatenate([[0.0], np.cumsum(ends[:, k])])
        out[:, k] = (
            feed
            * (np.interp(high, travelled, end_travelled) - np.interp(low, travelled, end_travelled))
            / (high - low)
        )
    for row, move in ((0, 0), (-1, -1)):
        if fastest_moves[move] > MIN_MOVE_M:
            out[row] = feed * ends[move] / fastest_moves[move]
    return out


def _clear_of_inner_corners(offset: WireOffset) -> BoolArray:
    """Return whether to keep each wire (N,): others would gouge the far side of an inner corner.

    From the wire of an inner corner, neighbours are dropped in both directions until one is clear of the
    corner (`_is_beyond_corner`), belongs to a corner itself, or is the first or last wire.
    """
    lines, foot = offset.lines, offset.row.foot
    keep = np.ones(len(lines), dtype=np.bool_)
    for j in np.flatnonzero(offset.row.corner_rotation.min(axis=1) < -MIN_VERTEX_ROTATION_RAD).tolist():
        for step in (-1, 1):
            i = j + step
            while 0 <= i < len(lines):
                if not 0 <= i + step < len(lines):
                    break
                if (
                    np.abs(offset.row.corner_rotation[i]) > MIN_VERTEX_ROTATION_RAD
                ).any() or _is_beyond_corner(lines, foot, j, i, step, offset.half):
                    break
                keep[i] = False
                i += step
    return keep


def _is_beyond_corner(lines: WireLines, foot: WireLines, j: int, i: int, step: int, half: FloatArray) -> bool:
    """Return whether both ends of wire i are ahead of the wire of inner corner j, along the side of wire i.

    "Ahead" is the direction from ruling j to the ruling at ``j + step``. At least 0.2 half slots are
    required, so that wires almost at the corner are dropped.
    """
    for ends, feet, end in ((lines.start, foot.start, 0), (lines.end, foot.end, 1)):
        direction = feet[j + step] - feet[j]
        length = np.linalg.norm(direction)
        if length > 1e-9 and (ends[i] - ends[j]) @ direction / length < 0.2 * half[j, end]:
            return False
    return True


NEARER_TOLERANCE_FRACTION: Final = 0.1
"""Fraction of the tolerance by which wires may be closer to their surface than half a slot."""
RULING_SPACING_M: Final = 5e-4
"""Spacing of the rulings [m] at which a surface is checked."""
QUARTER_SEGMENTS: Final = 64
"""Number of segments of a quarter circle in buffers of lines."""
MIN_LEFT_FRACTION: Final = 0.03
"""Depth at which remaining foam starts to count, as a fraction of the tolerance."""
MAX_LOOP_FACTOR: Final = 3.0
"""A loop is cut off if its length on the surface is at most this many half slots.

Twice the depth of foam that may remain is added to this limit.
"""


def guide_lines(ruled: RuledSurface) -> tuple[FloatArray, FloatArray]:
    """Return both guide lines (M, 3) [m] of a surface. Those of a closed surface end at their first point."""
    if not ruled.closed:
        return ruled.start, ruled.end
    return np.concatenate([ruled.start, ruled.start[:1]]), np.concatenate([ruled.end, ruled.end[:1]])


def remove_loops(offset: WireOffset, ruled: RuledSurface, tolerance: float, left: float) -> OffsetRow | None:
    """Replace each loop of wires too close to the surface by one wire where the path crosses itself.

    Loops longer than `MAX_LOOP_FACTOR` allows are kept.

    Args:
        offset: Wires next to the surface.
        ruled: The surface.
        tolerance: Tolerance of the surface [m].
        left: Depth of foam that may remain [m].

    Returns:
        The row without these loops, or None if there is no loop that can be cut off, or if the first or last
        wire is too close to the surface.
    """
    lines = offset.lines
    ends = (lines.start, lines.end)
    distance = np.stack(
        [distance_to_polyline(points, guide) for points, guide in zip(ends, guide_lines(ruled), strict=True)],
        axis=1,
    )
    is_too_close = np.asarray((distance < offset.half - NEARER_TOLERANCE_FRACTION * tolerance).any(axis=1))
    if not is_too_close.any() or is_too_close[0] or is_too_close[-1]:
        return None
    # a loop is a run of wires that are too close: its edges alternate between the wire before it and its last
    edges = np.flatnonzero(np.diff(is_too_close))
    row = offset.row
    keep = np.ones(len(is_too_close), dtype=np.bool_)
    foot = [row.foot.start.copy(), row.foot.end.copy()]
    normal, corner_rotation = row.normal.copy(), row.corner_rotation.copy()
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        following = last + 1
        loop_length = max(
            float(np.linalg.norm(np.diff(f[first : following + 1], axis=0), axis=1).sum()) for f in foot
        )
        if loop_length > MAX_LOOP_FACTOR * float(offset.half[first].max()) + 2.0 * left:
            continue
        middle = (first + following) // 2
        crossings = [_self_crossing(end, first, following, lines.direction[middle]) for end in ends]
        # the middle wire of the loop moves to the crossing at each end that has one
        for k, crossing in enumerate(crossings):
            point = ends[k][middle] if crossing is None else crossing
            normal[middle, k] = (point - foot[k][middle]) / offset.half[middle, k]
        corner_rotation[middle] = 0.0
        keep[first + 1 : following] = False
        keep[middle] = True
    if keep.all():
        return None
    return OffsetRow(WireLines(*foot), normal, corner_rotation)[keep]


def _self_crossing(points: FloatArray, first: int, last: int, axis: FloatArray) -> FloatArray | None:
    """Return the point (3,) at which the path of a guide point (N, 3) crosses itself between two wires.

    The path is projected along ``axis`` (3,). The first crossing along the path is returned, or None.

    Args:
        points: Guide points of N wires (N, 3) [m].
        first: Index of the wire before the loop.
        last: Index of the wire after the loop.
        axis: Direction of the wire in the loop (3,).
    """
    plane_axis = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    plane_axis /= np.linalg.norm(plane_axis)
    loop = points[first : last + 1]
    projected = np.stack([loop @ plane_axis, loop @ np.cross(axis, plane_axis)], axis=1)
    a, edges = projected[:-1], np.diff(projected, axis=0)
    for i in range(len(edges) - 2):
        for j in range(len(edges) - 1, i + 1, -1):
            det = edges[i, 0] * edges[j, 1] - edges[i, 1] * edges[j, 0]
            gap = a[j] - a[i]
            if abs(det) < 1e-18:
                continue
            s = (gap[0] * edges[j, 1] - gap[1] * edges[j, 0]) / det
            t = (gap[0] * edges[i, 1] - gap[1] * edges[i, 0]) / det
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                return np.asarray(loop[i] + s * (loop[i + 1] - loop[i]))
    return None


@dataclasses.dataclass(frozen=True)
class RemainingFoam:
    """Foam that remains at one place.

    Attributes:
        depth: Maximum depth [m].
        point: Point of the surface where it is deepest (3,) [m].
        volume: Volume [m^3].
    """

    depth: float
    point: FloatArray
    volume: float


def remaining_foam(
    offset: WireOffset, ruled: RuledSurface, tolerance: float, box: FloatArray
) -> list[RemainingFoam]:
    """Return the foam that the round wires leave on the surface, deepest first.

    Args:
        offset: Wires next to the surface.
        ruled: The surface.
        tolerance: Depth above which foam is returned [m].
        box: Lower and upper corner of the block (2, 3) [m].
    """
    fine, lines = _dense_rulings(ruled), offset.lines
    depth = np.empty((len(fine), 2))
    for k, (points, ends) in enumerate(((fine.start, lines.start), (fine.end, lines.end))):
        nearest = cKDTree(ends).query(points)[1]
        depth[:, k] = distance_to_polyline(points, ends) - offset.half[nearest, k]
    remaining: list[RemainingFoam] = []
    for rows in _selected_runs(depth.max(axis=1) > MIN_LEFT_FRACTION * tolerance, ruled.closed):
        k = int(rows[int(np.argmax(depth[rows].max(axis=1)))])
        max_depth = float(depth[k].max())
        if max_depth > tolerance:
            remaining.append(
                RemainingFoam(
                    max_depth, fine.start[k], _remaining_volume(fine, k, max_depth, offset, box, ruled.closed)
                )
            )
    return sorted(remaining, key=lambda foam: -foam.depth)


def _dense_rulings(ruled: RuledSurface) -> WireLines:
    """Return rulings (M) of a surface, interpolated to a spacing of at most ``RULING_SPACING_M``."""
    a, b = guide_lines(ruled)
    step = np.maximum(*(np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (a, b)))
    count = np.maximum(np.ceil(step / RULING_SPACING_M).astype(np.intp), 1)
    row = np.repeat(np.arange(len(count)), count)
    fraction = ((np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)) / count[row])[:, None]
    start, end = (p[row] + fraction * (p[row + 1] - p[row]) for p in (a, b))
    if ruled.closed:
        return WireLines(start, end)
    return WireLines(np.concatenate([start, a[-1:]]), np.concatenate([end, b[-1:]]))


def _selected_runs(selected: BoolArray, closed: bool) -> Iterator[IndexArray]:
    """Yield the indices of each run of consecutive selected positions.

    On a closed line, runs at the end and at the start are one run.
    """
    indices = np.flatnonzero(selected)
    runs = np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(indices) else []
    if closed and len(runs) > 1 and selected[0] and selected[-1]:
        runs = [np.concatenate([runs[-1], runs[0]]), *runs[1:-1]]
    yield from runs


def _remaining_volume(
    fine: WireLines, k: int, depth: float, offset: WireOffset, box: FloatArray, closed: bool
) -> float:
    """Return the volume [m^3] of the foam that remains at ruling ``k`` in the block.

    In the section across the ruling, foam remains where a circle of half a slot cannot reach: the surface's
    line widened by half a slot and narrowed again (closing). The piece on the side of the wires counts.

    Args:
        fine: Dense rulings of the surface.
        k: Index of the ruling.
        depth: Maximum depth of the foam there [m].
        offset: Wires next to the surface.
        box: Lower and upper corner of the block (2, 3) [m].
        closed: Whether the surface is closed.
    """
    half, lines = float(offset.half.mean()), offset.lines
    axis = fine.direction[k]
    plane_axis = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    plane = np.stack([plane_axis, np.cross(axis, plane_axis)], axis=1) / np.linalg.norm(plane_axis)
    half_count = int(np.ceil((3.0 * half + 2.0 * depth) / RULING_SPACING_M))
    rows = np.arange(k - half_count, k + half_count + 1)
    rows = rows % len(fine) if closed else rows[(rows >= 0) & (rows < len(fine))]
    line = 0.5 * (fine.start + fine.end)[rows] @ plane
    ruling_point = 0.5 * (fine.start + fine.end)[k] @ plane
    wires = 0.5 * (lines.start + lines.end) @ plane
    to_wire = wires[int(np.argmin(np.linalg.norm(wires - ruling_point, axis=1)))] - ruling_point
    filled = (
        shapely.LineString(line)
        .buffer(half, quad_segs=QUARTER_SEGMENTS)
        .buffer(-half, quad_segs=QUARTER_SEGMENTS)
    )
    # a point within the remaining foam: 0.3 of its depth from the ruling towards the wires
    inside = shapely.Point(ruling_point + 0.3 * depth * to_wire / max(float(np.linalg.norm(to_wire)), 1e-12))
    area = sum(piece.area for piece in shapely.get_parts(filled) if piece.distance(inside) < 0.1 * depth)
    first, last = box_chord(fine[[k]], box)
    return float(area * np.nan_to_num(last - first)[0])


WIRE_FRACTIONS: Final = np.linspace(0.0, 1.0, 9)
"""Positions along the wire, between its guide points, at which its slot is checked."""
CLOCKED_SPACING_M: Final = 2e-4
"""Spacing [m] of the lines at which slots are computed if a clock gives their times."""
SLOT_SPACING_M: Final = 7e-4
"""Spacing [m] of the lines at which slots are computed without a clock."""
MAX_HALVINGS: Final = 4
"""Maximum number of times that moves between wires are halved."""
WELL_WITHIN_FRACTION: Final = 0.4
"""Moves whose slot deviates by more than this fraction of the tolerance are halved."""


@dataclasses.dataclass(frozen=True)
class MeltedSlots:
    """Slots of N wires.

    Attributes:
        lines: The wires.
        line_index: Index of the given line that each wire is at or approaches (N,).
        speed: Speeds across the wires at ``WIRE_FRACTIONS`` (N, 9) [m/s].
        half: Half the slots at ``WIRE_FRACTIONS`` (N, 9) [m].
    """

    lines: WireLines
    line_index: IndexArray
    speed: FloatArray
    half: FloatArray

    def select(self, rows: BoolArray) -> "MeltedSlots":
        """Return the wires selected by ``rows`` (N,)."""
        return MeltedSlots(self.lines[rows], self.line_index[rows], self.speed[rows], self.half[rows])

    def penetration(self, guides: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Return by how much (N, 2) [m] the slots at both guide points reach beyond guide lines (M, 3).

        Negative values are the thickness of foam that remains.
        """
        distance = [
            distance_to_polyline(points, guide)
            for points, guide in zip((self.lines.start, self.lines.end), guides, strict=True)
        ]
        return np.asarray(self.half[:, [0, -1]] - np.stack(distance, axis=1))

    def deviation(self, guides: tuple[FloatArray, FloatArray]) -> FloatArray:
        """Return by how much (N, 2) [m] the distances to guide lines (M, 3) differ from half the slots."""
        return np.abs(self.penetration(guides))


def melt_slots(
    lines: WireLines, kerf: KerfCurve, feed: float, box: FloatArray, clock: FloatArray | None = None
) -> MeltedSlots:
    """Return the slots at lines and on the straight moves between them.

    Args:
        lines: N lines.
        kerf: Kerf over speed.
        feed: Speed of the fastest point in the foam [m/s]. Not used with a clock.
        box: Lower and upper corner of the block (2, 3) [m].
        clock: Positions among the lines, 3.5 being halfway from line 3 to line 4, and their times [s] (2, K).
    """
    lines, number = _dense_lines(lines, box, SLOT_SPACING_M if clock is None else CLOCKED_SPACING_M)
    time = None
    if clock is not None:
        count = np.bincount(number)
        fraction = (np.arange(len(number)) - np.cumsum(count)[number] + 1) / count[number]
        time = np.interp(number + fraction, *clock)
    speed = _slot_speeds(lines, feed, box, time)
    return MeltedSlots(lines, number, speed, 0.5 * kerf.at(speed))


def fit_offset(
    row: OffsetRow,
    nominal: RuledSurface,
    kerf: KerfCurve,
    feed: float,
    box: FloatArray,
    allowed: tuple[float, float],
) -> WireOffset:
    """Return wires next to a surface at a distance of half their slot, as closely as possible.

    Loops of wires are cut off where the slot cannot reach. Moves are halved by additional wires where the
    slot deviates from the distance by more than `WELL_WITHIN_FRACTION` of the tolerance, as long as this
    reduces the largest deviation.

    Args:
        row: Positions of the wires.
        nominal: The surface.
        kerf: Kerf over speed.
        feed: Speed of the fastest point in the foam [m/s].
        box: Lower and upper corner of the block (2, 3) [m].
        allowed: Tolerance of the surface and depth of foam that may remain [m].
    """
    guides = guide_lines(nominal)
    tolerance = allowed[0]

    def evaluate(row: OffsetRow) -> tuple[WireOffset, IndexArray, FloatArray]:
        """Return the wires, and for S samples of the path the line that each approaches and its deviation.

        Both are (S,), deviations in m.
        """
        offset = wire_offset(row, kerf, feed, box)
        passed = melt_slots(offset.lines, kerf, feed, box)
        return offset, passed.line_index, passed.deviation(guides).max(axis=1)

    best = evaluate(row)
    loop_free = remove_loops(best[0], nominal, *allowed)
    best = best if loop_free is None else evaluate(loop_free)
    for _ in range(MAX_HALVINGS):
        offset, number, deviation = best
        uneven_moves = np.unique(number[(deviation > WELL_WITHIN_FRACTION * tolerance) & (number > 0)])
        if not len(uneven_moves):
            break
        refined = evaluate(_halve_moves(offset.row, uneven_moves))
        # not always better: a wire that slows down for a wider slot may melt an even wider one
        if refined[2].max() >= deviation.max():
            break
        best = refined
    return best[0]


def _halve_moves(row: OffsetRow, indices: IndexArray) -> OffsetRow:
    """Return the row with an additional wire halfway along the move to each wire of ``indices`` (K,).

    Normals and rulings are averaged, so that the wire stays on the straight path next to a flat piece.
    """
    foot = [
        np.insert(p, indices, 0.5 * (p[indices - 1] + p[indices]), axis=0)
        for p in (row.foot.start, row.foot.end)
    ]
    normal = np.insert(row.normal, indices, 0.5 * (row.normal[indices - 1] + row.normal[indices]), axis=0)
    return OffsetRow(WireLines(*foot), normal, np.insert(row.corner_rotation, indices, 0.0, axis=0))


def _dense_lines(lines: WireLines, box: FloatArray, spacing: float) -> tuple[WireLines, IndexArray]:
    """Return denser lines (M), and the index (M,) of the given line that each one is at or approaches.

    No guide point, and no point in the box, moves farther than ``spacing`` [m] from one line to the next.
    """
    steps = [np.linalg.norm(np.diff(ends, axis=0), axis=1) for ends in (lines.start, lines.end)]
    steps.append(np.nan_to_num(fastest_move(lines, box)[1:]))
    count = np.maximum(np.ceil(np.max(steps, axis=0) / spacing).astype(np.intp), 1)
    target_index = np.repeat(np.arange(1, len(lines)), count)
    step = np.arange(len(target_index)) - np.repeat(np.cumsum(count) - count, count) + 1
    fraction = (step / count[target_index - 1])[:, None]
    ends = [
        p[target_index - 1] + fraction * (p[target_index] - p[target_index - 1])
        for p in (lines.start, lines.end)
    ]
    return concatenate_lines([lines[:1], WireLines(*ends)]), np.concatenate([[0], target_index])


def _slot_speeds(lines: WireLines, feed: float, box: FloatArray, time: FloatArray | None) -> FloatArray:
    """Return the speeds (N, 9) [m/s] across the wire at ``WIRE_FRACTIONS``, from which its slot follows.

    They are averages over ``MELTING_DISTANCE_M`` of the path to each side.

    Args:
        lines: N wires.
        feed: Speed of the fastest point in the box [m/s], if ``time`` is None.
        box: Lower and upper corner of the block (2, 3) [m].
        time: Times at which the wires pass (N,) [s], or None.
    """
    wire_points = [lines.start + fraction * (lines.end - lines.start) for fraction in WIRE_FRACTIONS]
    moves = np.stack([transverse_move(lines, points[:-1]) for points in wire_points], axis=1)
    fastest_moves = fastest_move(lines, box)[1:]
    fastest_moves = np.where(np.isfinite(fastest_moves), fastest_moves, moves.max(axis=1))
    travelled = np.concatenate([[0.0], np.cumsum(np.maximum(fastest_moves, 1e-12))])
    low = (travelled - MELTING_DISTANCE_M).clip(travelled[0])
    high = (travelled + MELTING_DISTANCE_M).clip(None, travelled[-1])
    point_travelled = np.concatenate([np.zeros((1, len(WIRE_FRACTIONS))), np.cumsum(moves, axis=0)])
    distances = [np.interp(high, travelled, w) - np.interp(low, travelled, w) for w in point_travelled.T]
    time = travelled / feed if time is None else time
    durations = np.interp(high, travelled, time) - np.interp(low, travelled, time)
    return np.asarray(np.stack(distances, axis=1) / np.maximum(durations, 1e-9)[:, None])
