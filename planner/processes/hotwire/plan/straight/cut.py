"""One cut from air to air: the lead-in through foam, the wires next to the surface, the lead-out.

A closed cut also has a start, a sense of rotation, and a slit by which the wire reaches it (`choose_start`).
"""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, RuledSurface
from planner.geometry.rulings import outward_sides, resample
from planner.geometry.units import MM
from planner.problem import Stock
from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.operation import Straight, SurfaceCut, TrimCut
from planner.processes.hotwire.plan.straight.offset import (
    MAX_VERTEX_ROTATION_RAD,
    OffsetRow,
    WireOffset,
    fit_offset,
    make_row,
)
from planner.processes.hotwire.plan.straight.order import (
    NominalSurface,
    WireLines,
    concatenate_lines,
    enlarged_box,
    exit_distance,
    fastest_move,
)
from planner.targets import FEED_FRACTION

MAX_START_CANDIDATES: Final = 48
"""Number of rulings that are tried as the start of a contour without corners."""
SLIT_DIRECTIONS: Final = 48
"""Number of directions of the slit that are tried at each start."""
HOLDING_FRACTION: Final = 0.25
"""Last fraction of a contour to be cut. It holds the piece until then."""

SLIT_IN_PART_COST: Final = 1000.0
"""Cost of a slit through the part relative to one of equal length through waste.

It exceeds all other costs.
"""
TURN_COST: Final = 0.05
"""Cost of a sharp turn between slit and contour, as a fraction of the block's diagonal."""
WRONG_HOLDING_SIDE_COST: Final = 0.6
"""Cost of cutting the wrong side last, as a fraction of the block's diagonal."""
SLIT_BELOW_COST: Final = 3.0
"""Cost of a slit that leaves the block below, at its support, as a multiple of the block's diagonal."""
SLIT_BELOW_LENGTH_FACTOR: Final = 1.2
"""A slit is preferred to one that leaves the block below if it is at most this many times longer in the part.

The proof allows somewhat more.
"""
CLEARANCE_BELOW_M: Final = 0.04
"""Free height below the block [m] that a slit needs to leave the block there."""
MIN_OUTWARD_COSINE: Final = 0.05
"""Minimum cosine between a slit and the outward normal. A flatter slit would graze the part."""


@dataclasses.dataclass(frozen=True)
class CutStart:
    """Start of a closed cut.

    Attributes:
        first: Index of the first ruling.
        backward: Whether the rulings are cut in reverse order.
        direction: Direction from the first ruling out of the block, along the slit (3,).
        length: Length of the slit in the block [m].
        length_in_part: Length of the slit in the part [m].
    """

    first: int
    backward: bool
    direction: FloatArray
    length: float
    length_in_part: float


@dataclasses.dataclass(frozen=True)
class _StartCandidates:
    """K candidates for a start.

    Attributes:
        first: Index of the first ruling (K,).
        direction: Direction from the first ruling out of the block, along the slit (K, 3).
        length: Length of the slit in the block (K,) [m].
        length_in_part: Length of the slit in the part (K,) [m].
    """

    first: IndexArray
    direction: FloatArray
    length: FloatArray
    length_in_part: FloatArray


def choose_start(
    ruled: RuledSurface,
    contours: tuple[RuledSurface, ...],
    cut: SurfaceCut,
    box: FloatArray,
    up: FloatArray,
    down: FloatArray | None = None,
) -> CutStart:
    """Choose the start of a closed cut.

    The start with the least cost is chosen among pairs of a ruling and a slit direction, for both senses of
    rotation. Costs are the length of the slit (mainly in the part), a slit that leaves the block on the side
    of the support, a sharp turn between slit and contour, and a wrong side that is cut last.

    Args:
        ruled: Surface to cut.
        contours: All closed surfaces of the part.
        cut: The cut as the operation states it.
        box: Lower and upper corner of the block (2, 3) [m].
        up: Direction that ``last: top`` means (3,).
        down: Direction of the support of the block (3,), or None if there is none.
    """
    candidates = _start_candidates(ruled, contours, cut, box)
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    cost = candidates.length + SLIT_IN_PART_COST * candidates.length_in_part
    if down is not None:
        below = _leaves_below(
            WireLines(ruled.start[candidates.first], ruled.end[candidates.first]), candidates, box, down
        )
        extra_cost = (
            SLIT_BELOW_LENGTH_FACTOR - 1.0
        ) * SLIT_IN_PART_COST * candidates.length_in_part + SLIT_BELOW_COST * diagonal
        cost = cost + np.where(below, extra_cost, 0.0)
    best: tuple[float, CutStart] | None = None
    for backward in (False, True):
        holding_cost = (
            WRONG_HOLDING_SIDE_COST
            * diagonal
            * (1.0 - _holding_score(ruled, candidates.first, backward, cut, up))
        )
        turn_cost = TURN_COST * diagonal * _turn_sharpness(ruled, candidates, backward)
        total = cost + holding_cost + turn_cost
        k = int(np.argmin(total))
        start = CutStart(
            int(candidates.first[k]),
            backward,
            candidates.direction[k],
            float(candidates.length[k]),
            float(candidates.length_in_part[k]),
        )
        if best is None or total[k] < best[0] - 1e-9:
            best = (float(total[k]), start)
    if best is None:
        raise ValueError("no start was tried")
    return best[1]


def _leaves_below(lines: WireLines, tries: _StartCandidates, box: FloatArray, down: FloatArray) -> BoolArray:
    """Return whether each slit (K,) leaves the block by its side in the direction ``down``.

    A slit does so if it would be clearly longer in a block that reached `CLEARANCE_BELOW_M` farther down.
    """
    lower = np.stack(
        [
            box[0] + CLEARANCE_BELOW_M * np.minimum(down, 0.0),
            box[1] + CLEARANCE_BELOW_M * np.maximum(down, 0.0),
        ]
    )
    return np.asarray(exit_distance(lines, tries.direction, lower) - tries.length > 0.5 * CLEARANCE_BELOW_M)


def _start_candidates(
    ruled: RuledSurface, contours: tuple[RuledSurface, ...], cut: SurfaceCut, box: FloatArray
) -> _StartCandidates:
    """Return the allowed pairs of a first ruling and a slit direction, or all pairs if none is allowed.

    Directions are normal to the ruling: `SLIT_DIRECTIONS` all around, or the stated lead alone. A slit to a
    hole must lead into the part, away from the normals of both sides of the ruling. A slit to an outline must
    lead away from the part on at least one side.
    """
    rulings = _start_rulings(ruled)
    lines = WireLines(ruled.start[rulings], ruled.end[rulings])
    direction = lines.direction
    if cut.lead == "auto":
        angle = 2.0 * np.pi * np.arange(SLIT_DIRECTIONS) / SLIT_DIRECTIONS
        first = np.stack(outward_sides(ruled))[:, rulings].mean(axis=(0, 2))
        first = first - np.sum(first * direction, axis=1, keepdims=True) * direction
        size = np.linalg.norm(first, axis=1, keepdims=True)
        # the first direction is the mean outward normal, or any if the normals cancel out at a cusp
        first = np.where(size > 1e-6, first / np.maximum(size, 1e-6), _normal_pair(direction)[0])
        second = np.cross(direction, first)
        directions = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    else:
        lead = np.array(cut.lead)
        lead = lead - np.sum(lead * direction, axis=1, keepdims=True) * direction
        directions = (lead / np.maximum(np.linalg.norm(lead, axis=1, keepdims=True), 1e-12))[:, None]
    row = np.repeat(np.arange(len(rulings)), directions.shape[1])
    slit_direction = directions.reshape(-1, 3)
    sides = np.stack(outward_sides(ruled), axis=1)[rulings].mean(axis=2)  # (K, before and after, 3)
    outward = np.einsum("ksi,ki->ks", sides[row], slit_direction)
    # a slit to a hole goes through the part, a slit to an outline must not
    is_allowed = (outward < -0.3).all(axis=1) if ruled.hole else (outward > MIN_OUTWARD_COSINE).any(axis=1)
    if not is_allowed.any():
        is_allowed[:] = True
    row, slit_direction = row[is_allowed], slit_direction[is_allowed]
    length = exit_distance(lines[row], slit_direction, box)
    return _StartCandidates(
        rulings[row],
        slit_direction,
        length,
        _length_in_part(lines[row], slit_direction, length, contours, box),
    )


def _start_rulings(ruled: RuledSurface) -> IndexArray:
    """Return the rulings at which a cut may start.

    For an outline these are its convex corners. For a hole, or an outline without convex corners, they are up
    to `MAX_START_CANDIDATES` evenly spaced rulings. Inner corners are excluded as long as other rulings
    remain, because their two sides cannot both be reached from there.
    """
    previous_side, next_side = outward_sides(ruled)
    direction = (ruled.end - ruled.start)[:, None]
    convex = np.sum(np.cross(previous_side, next_side) * direction, axis=2).mean(axis=1) > 0.0
    convex |= np.sum(previous_side * next_side, axis=2).mean(axis=1) < -0.9  # a cusp
    corners = np.flatnonzero(ruled.corner & convex)
    if len(corners) and not ruled.hole:
        return corners
    count = len(ruled.start)
    step_length = np.linalg.norm(
        np.diff(_ruling_centres(ruled), axis=0, append=_ruling_centres(ruled)[:1]), axis=1
    )
    arc_length = np.concatenate([[0.0], np.cumsum(step_length)[:-1]])
    even = np.arange(min(MAX_START_CANDIDATES, count)) * step_length.sum() / min(MAX_START_CANDIDATES, count)
    candidates = np.unique(np.searchsorted(arc_length, even).clip(0, count - 1))
    smooth = candidates[~(ruled.corner & ~convex)[candidates]]
    return smooth if len(smooth) else candidates


def _ruling_centres(ruled: RuledSurface) -> FloatArray:
    """Return the middles of all rulings (N, 3) [m]."""
    return np.asarray(0.5 * (ruled.start + ruled.end))


def _normal_pair(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two arrays of unit vectors (K, 3) that are normal to ``direction`` (K, 3) and to each other."""
    axis = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(direction, first)


def _length_in_part(
    lines: WireLines,
    slit_direction: FloatArray,
    length: FloatArray,
    contours: tuple[RuledSurface, ...],
    box: FloatArray,
) -> FloatArray:
    """Return the lengths (K,) [m] that slits have in the part, projected along the wire.

    They dominate the cost of a start.

    Args:
        lines: First rulings of the slits (K).
        slit_direction: Directions of the slits (K, 3).
        length: Lengths of the slits in the block (K,) [m].
        contours: All closed surfaces of the part.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    out = np.zeros(len(lines))
    directions, direction_index = np.unique(lines.direction.round(9), axis=0, return_inverse=True)
    for number, direction in enumerate(directions):
        first, second = _normal_pair(direction[None])
        plane = np.stack([first[0], second[0]], axis=1)
        solid = _projected_part(contours, plane, box)
        group = np.flatnonzero(direction_index.ravel() == number)
        centres = 0.5 * (lines.start + lines.end)[group] @ plane
        step = slit_direction[group] @ plane
        slits = shapely.linestrings(
            # from 1 um beyond the contour, so that rounding does not count the contour itself
            np.stack([centres + 1e-6 * step, centres + length[group, None] * step], axis=1)
        )
        out[group] = shapely.length(shapely.intersection(slits, solid))
    return out


def _projected_part(
    contours: tuple[RuledSurface, ...], plane: FloatArray, box: FloatArray
) -> shapely.Geometry:
    """Return the part as projected along a wire, in the coordinates of ``plane`` (3, 2).

    It consists of outlines, or the whole block, minus their holes, plus the pieces in those holes.
    """
    shapes = [(c.hole, shapely.make_valid(shapely.Polygon(_ruling_centres(c) @ plane))) for c in contours]
    corners = np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3) @ plane
    block = shapely.MultiPoint(corners).convex_hull
    solid = block if all(hole for hole, _ in shapes) else shapely.Polygon()
    for hole, shape in sorted(shapes, key=lambda item: -item[1].area):  # nested shapes are smaller
        solid = shapely.difference(solid, shape) if hole else shapely.union(solid, shape)
    return solid


def _holding_score(
    ruled: RuledSurface, first: IndexArray, backward: bool, cut: SurfaceCut, up: FloatArray
) -> FloatArray:
    """Return how well (K,) the last part of the cut faces the side that is to hold the piece.

    It is the mean cosine between outward normals and that side over `HOLDING_FRACTION` of the contour. It is
    1 if any side may hold the piece.
    """
    if cut.last == "any":
        return np.ones(len(first))
    required_side = (
        up if cut.last == "top" else -up if cut.last == "bottom" else np.array(cut.last, dtype=np.float64)
    )
    required_side = required_side / max(float(np.linalg.norm(required_side)), 1e-12)
    previous_side, next_side = outward_sides(ruled)
    facing = (
        np.mean((previous_side + next_side) @ required_side, axis=1) * 0.5 * (-1.0 if ruled.hole else 1.0)
    )
    middle = _ruling_centres(ruled)
    step_length = np.linalg.norm(np.diff(middle, axis=0, append=middle[:1]), axis=1)
    facing = 0.5 * (facing + np.roll(facing, -1)) * step_length  # of the piece after each ruling
    cumulative_facing = np.concatenate([[0.0], np.cumsum(np.tile(facing, 2))])
    arc_length = np.concatenate([[0.0], np.cumsum(np.tile(step_length, 2))])
    holding_length = HOLDING_FRACTION * step_length.sum()
    # the last part before the first ruling, or in reverse order after it; arc lengths cover two rounds
    low = arc_length[first] if backward else arc_length[first + len(step_length)] - holding_length
    return np.asarray(
        (
            np.interp(low + holding_length, arc_length, cumulative_facing)
            - np.interp(low, arc_length, cumulative_facing)
        )
        / holding_length
    )


def _turn_sharpness(ruled: RuledSurface, tries: _StartCandidates, backward: bool) -> FloatArray:
    """Return how sharply (K,) the wire turns from the slit into the cut and back, on average.

    0 is straight on, 1 is a reversal.
    """
    middle, count = _ruling_centres(ruled), len(ruled.start)
    sense = -1 if backward else 1
    outgoing = middle[(tries.first + sense) % count] - middle[tries.first]
    incoming = middle[tries.first] - middle[(tries.first - sense) % count]
    sharpness = []
    for move, slit_move in ((outgoing, -tries.direction), (incoming, tries.direction)):
        cosine = np.sum(move * slit_move, axis=1) / np.maximum(np.linalg.norm(move, axis=1), 1e-12)
        sharpness.append(0.5 - 0.5 * cosine)
    return np.asarray(0.5 * (sharpness[0] + sharpness[1]))


CHORD_TOLERANCE_FRACTION: Final = 0.1
"""Chord error of straight moves between rulings, as a fraction of the tolerance."""
CORNER_FRACTION: Final = 0.6
"""Error of the polygon around a convex corner, as a fraction of the tolerance."""
MIN_LEAD_LENGTH_M: Final = 2e-3
"""Minimum length of a lead [m] if the surface itself starts in air."""
PLAIN_STEP_FACTOR: Final = 3.0
"""Factor on the step where the wire moves straight (sides of the block, leads)."""
REVERSAL_CLEARANCE_M: Final = 1e-3
"""Distance [m] of the wire's surface from the block where it reverses to go back through its slot."""


@dataclasses.dataclass(frozen=True)
class StraightCut:
    """A planned cut of one surface, from air to air.

    Attributes:
        nominal: Surface to cut.
        into: Wires of the lead-in, from air to the surface.
        on: Wires next to the surface.
        out: Wires of the lead-out, from the surface to air.
        start: Start of a closed cut, None for an open strip.
        reversal: Number of lines of ``out`` after which the wire stops in air and returns through its slot,
            or 0.
    """

    nominal: NominalSurface
    into: WireLines
    on: WireOffset
    out: WireLines
    start: CutStart | None
    reversal: int = 0


def make_cut(
    op: Straight,
    nominal: NominalSurface,
    contours: tuple[RuledSurface, ...],
    kerf: KerfCurve,
    radius: float,
    stock: Stock,
) -> StraightCut:
    """Plan the cut of one surface, from air to air.

    Rulings are so dense that neither guide points nor the fastest point in the foam move farther than the
    step between them. The step is larger on sides of the block that are trimmed.

    Args:
        op: Operation with a straight wire.
        nominal: Surface to cut.
        contours: All closed surfaces of the part.
        kerf: Kerf over speed.
        radius: Radius of the wire [m].
        stock: The block, with its support.
    """
    box, up = stock.box, -stock.gravity
    down = stock.gravity if stock.support or stock.pedestal is not None else None
    step, feed = op.step_mm * MM, FEED_FRACTION * op.feed(nominal.cut)
    plain_step = step * PLAIN_STEP_FACTOR
    step = plain_step if isinstance(nominal.cut, TrimCut) else step
    ruled = resample(nominal.ruled, CHORD_TOLERANCE_FRACTION * op.shape_tol_mm * MM, step)
    start = None
    if nominal.ruled.closed and isinstance(nominal.cut, SurfaceCut):
        start = choose_start(ruled, contours, nominal.cut, box, up, down)
    allowed = op.shape_tol_mm * MM, op.left_mm * MM  # tolerance, depth of foam that may remain
    max_vertex_rotation = _max_vertex_rotation(0.5 * float(kerf.at(np.array([feed]))[0]), allowed[0])
    on = fit_offset(
        _offset_row(ruled, nominal, start, max_vertex_rotation), nominal.ruled, kerf, feed, box, allowed
    )
    travel = fastest_move(on.lines, box)
    longest = float(np.nanmax(travel, initial=0.0))
    if longest > 1.05 * step and on.converged:  # the wire in foam moves farther than its guide points
        # plan again with rulings that are closer by the same ratio
        ruled = resample(
            nominal.ruled, CHORD_TOLERANCE_FRACTION * op.shape_tol_mm * MM, step * step / longest
        )
        if start is not None and isinstance(nominal.cut, SurfaceCut):
            start = choose_start(ruled, contours, nominal.cut, box, up, down)
        on = fit_offset(
            _offset_row(ruled, nominal, start, max_vertex_rotation), nominal.ruled, kerf, feed, box, allowed
        )
    clear = op.margin_mm * MM + radius
    if start is not None:
        return _closed_cut(nominal, on, start, plain_step, clear, box)
    return _open_cut(nominal, on, plain_step, clear, radius, box)


def _offset_row(
    ruled: RuledSurface, nominal: NominalSurface, start: CutStart | None, max_vertex_rotation: float
) -> OffsetRow:
    """Return the positions of wires next to a resampled surface, in the order of the cut."""
    if start is not None:
        return make_row(ruled, start.first, start.backward, max_vertex_rotation)
    return make_row(ruled, 0, nominal.cut.reverse, max_vertex_rotation)


def _max_vertex_rotation(half: float, tolerance: float) -> float:
    """Return the largest rotation [rad] at one vertex of the polygon around a convex corner.

    A vertex is 1 / cos(rotation / 2) times ``half`` a slot [m] from the corner. This may exceed ``half`` by
    at most ``CORNER_FRACTION`` of the tolerance [m].
    """
    return float(min(MAX_VERTEX_ROTATION_RAD, 2.0 * np.arccos(half / (half + CORNER_FRACTION * tolerance))))


def _closed_cut(
    nominal: NominalSurface, on: WireOffset, start: CutStart, step: float, clear: float, box: FloatArray
) -> StraightCut:
    """Return a closed cut: in through the slit, around the contour, and out through the same slit.

    If the cut starts at a corner, first and last wire differ. The wire then starts and ends half a kerf
    beyond them, along the surface.
    """
    legs = []
    for k, neighbour in ((0, 1), (-1, -2)):  # first and last wire, each with its neighbour in the cut
        corner = _closing_gap(on) > 0.5 * float(on.half[k].max())
        end = _extended_line(on, k, neighbour) if corner else on.lines[[k]]
        leg = _straight_lines(end, start.direction, step, clear, box)
        legs.append(concatenate_lines([end, leg]) if corner else leg)
    return StraightCut(nominal, legs[0].reversed(), on, legs[1], start)


def _extended_line(on: WireOffset, k: int, neighbour: int) -> WireLines:
    """Return the wire (1 line) that continues the move from line ``neighbour`` to ``k`` by half its kerf.

    Both ends continue at their own speeds, so that the slot keeps its width up to the end of the surface.
    """
    lines = on.lines
    move = np.stack([lines.start[k] - lines.start[neighbour], lines.end[k] - lines.end[neighbour]])
    move *= float(on.half[k].max()) / max(float(np.linalg.norm(move, axis=1).max()), 1e-12)
    return WireLines(lines.start[[k]] + move[0], lines.end[[k]] + move[1])


def _closing_gap(on: WireOffset) -> float:
    """Return the distance [m] between the first and the last wire of a closed cut, summed over both ends.

    It is positive if the cut starts at a corner.
    """
    lines = on.lines
    return float(
        np.linalg.norm(lines.start[0] - lines.start[-1]) + np.linalg.norm(lines.end[0] - lines.end[-1])
    )


def _open_cut(
    nominal: NominalSurface, on: WireOffset, step: float, clear: float, radius: float, box: FloatArray
) -> StraightCut:
    """Return the cut of a strip, with a straight lead-in and, as the cut states, one of two lead-outs.

    With ``leave: onwards`` the wire goes straight on beyond the strip's end. Otherwise it leaves the foam
    there, stops, and returns through its own slot and the lead-in.
    """
    lines = on.lines
    ends = [_extended_line(on, 0, 1), _extended_line(on, -1, -2)]
    first, last = _ruling_direction(on.row.foot, 0, 1), _ruling_direction(on.row.foot, -1, -2)
    if isinstance(nominal.cut, SurfaceCut) and nominal.cut.lead != "auto":
        first = -_unit_across(np.array(nominal.cut.lead), lines.direction[0])
    into = concatenate_lines([ends[0], _straight_lines(ends[0], -first, step, clear, box)]).reversed()
    if nominal.cut.leave == "onwards":
        return StraightCut(
            nominal,
            into,
            on,
            concatenate_lines([ends[1], _straight_lines(ends[1], -last, step, clear, box)]),
            start=None,
        )
    reversal_distance = radius + float(on.half[-1].max()) + REVERSAL_CLEARANCE_M
    beyond_foam = concatenate_lines([ends[1], _straight_lines(ends[1], -last, step, reversal_distance, box)])
    out = concatenate_lines([beyond_foam, beyond_foam.reversed()[1:], lines.reversed(), into.reversed()])
    return StraightCut(nominal, into, on, out, start=None, reversal=len(beyond_foam))


def _ruling_direction(foot: WireLines, k: int, next_one: int) -> FloatArray:
    """Return the unit vector (3,) from ruling ``k`` to ``next_one``, across the wire."""
    move = foot.start[next_one] - foot.start[k] + foot.end[next_one] - foot.end[k]
    return _unit_across(move, foot.direction[k])


def _unit_across(vector: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the component of a vector (3,) across a unit vector (3,), as a unit vector."""
    vector = vector - (vector @ direction) * direction
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))


def _straight_lines(
    line: WireLines, direction: FloatArray, step: float, clear: float, box: FloatArray
) -> WireLines:
    """Return the wires of a straight lead along a direction (3,) until ``clear`` [m] from the block.

    ``line`` (1), at which the lead starts, is not included.
    """
    length = max(float(exit_distance(line, direction[None], enlarged_box(box, clear))[0]), MIN_LEAD_LENGTH_M)
    count = max(1, int(np.ceil(length / step - 1e-9)))
    distance = length * np.arange(1, count + 1) / count
    return WireLines(line.start + distance[:, None] * direction, line.end + distance[:, None] * direction)
