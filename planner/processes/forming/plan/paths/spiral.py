"""Level lines joined to the curve that the contact follows: loop after loop, or one spiral.

`PathOptions` has the user's options for the path of the contact on a face.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from shapely import Point, Polygon

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.forming.plan.paths.level_lines import LevelLoop

PathKind = Literal["contour", "alternating", "stepped", "helical"]
LoopDirection = Literal["ccw", "cw"]


MAX_MISSED_DISTANCE_M: Final = 2e-5
"""Smooth regions from which a ball stays farther away [m] are too narrow for it, if the mesh has no noise."""


@dataclasses.dataclass(frozen=True)
class PathOptions:
    """Options for the path of the contact over a face.

    Attributes:
        kind: Kind of the path. "contour": closed loops, joined by a diagonal step along the face at the seam.
            "alternating": such loops, of which every other one is reversed. "stepped": closed loops; at the
            seam the ball moves level along the sheet and then straight down. "helical": one spiral between a
            flat first and a flat last loop.
        stepdown: Distance [m] from level to level. Either this or ``scallop`` is stated.
        scallop: Height [m] of the ridges left between loops.
        tangent_angle: Turn [rad] of the contact's path after which there is a target; corners always get one.
        chord: Maximum deviation [m] of the straight moves of the ball's centre from the true offset of the
            face.
        cut: Maximum depth [m] to which straight moves cut into the face.
        start_angle: Angle [rad] of the ray from the middle of the feature on which the loops start.
        direction: Direction of the loops seen from +z.
        longest: Longest move [m].
        lift: Height [m] above everything at which the ball moves to another loop.
        missed: A point of a smooth face from which the ball stays farther away [m] than this (and than the
            mesh's own facets cause) is too narrow for the tool; infinite if a stated tolerance is checked
            before.
        spare: Fillets that a ball with this much more radius [m] does not fit count as creases; 0 if nothing
            depends on the point that the ball touches.
        seams: Whether every loop of a spiral gets a target at its seam, so that it can be formed alone.
    """

    kind: PathKind = "contour"
    stepdown: float | None = 1e-3
    scallop: float | None = None
    tangent_angle: float = math.radians(5.0)
    chord: float = 5e-5
    cut: float = 5e-5
    start_angle: float = 0.0
    direction: LoopDirection = "ccw"
    longest: float = 0.02
    lift: float = 5e-3
    missed: float = MAX_MISSED_DISTANCE_M
    spare: float = 0.0
    seams: bool = False


LoopTransition = Literal["join", "step", "lift"]

_FAN_LENGTH_M_PER_RAD: Final = 1e-3
"""Path length [m/rad] that a turn of the normal over a crease counts as, so that it has its own points."""


@dataclasses.dataclass(frozen=True)
class ContactCurve:
    """A curve of required contact through K points.

    Attributes:
        point: Points (K, 3) [m].
        normal: Unit normals (K, 3).
        loop: Number (K,) of the loop.
        piece: Piece (K,). A piece is formed without interruption.
        is_off_face: Whether (K - 1,) the straight line from each point to the next leaves the face, so that
            the curve is that of the nearest points on the face.
        keep: Whether (K,) each point must become a target.
        transitions: How each piece leads to the next (pieces - 1 of them).
    """

    point: FloatArray
    normal: FloatArray
    loop: IntArray
    piece: IntArray
    is_off_face: BoolArray
    keep: BoolArray
    transitions: tuple[LoopTransition, ...]


def start_at_seam(
    loop: LevelLoop, centre: FloatArray, angle: float, previous_end: FloatArray | None
) -> LevelLoop:
    """Return the loop, starting where it meets the ray from a centre, so that seams are in one line.

    If it meets the ray several times, it starts at the crossing nearest to ``previous_end``, or at the
    outermost one if ``previous_end`` is None. A loop that misses the ray starts at its point nearest to
    ``previous_end``, or nearest to the ray if that is None.

    Args:
        loop: Loop.
        centre: Origin (2,) [m] of the ray in plan.
        angle: Direction [rad] of the ray.
        previous_end: Point (3,) [m] to start near, or None.
    """
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    offset = loop.point[:, :2] - centre
    side, ray_distance = offset @ across, offset @ along
    hit = np.flatnonzero((side[:-1] >= 0.0) != (side[1:] >= 0.0))
    fraction = side[hit] / (side[hit] - side[hit + 1])
    reach = ray_distance[hit] + fraction * (ray_distance[hit + 1] - ray_distance[hit])
    hit, fraction, reach = (hit[reach > 0.0], fraction[reach > 0.0], reach[reach > 0.0])
    if len(hit):
        crossing = loop.point[hit] + fraction[:, None] * (loop.point[hit + 1] - loop.point[hit])
        distance = -reach if previous_end is None else np.linalg.norm(crossing - previous_end, axis=1)
        best_index = int(np.argmin(distance))
        segment, segment_fraction = int(hit[best_index]), float(fraction[best_index])
    else:
        target = loop.point[np.argmin(np.abs(side) - ray_distance)] if previous_end is None else previous_end
        segment, segment_fraction = int(np.argmin(np.linalg.norm(loop.point[:-1] - target, axis=1))), 0.0
    point = loop.point[segment] + segment_fraction * (loop.point[segment + 1] - loop.point[segment])
    normal = (1.0 - segment_fraction) * loop.normal[segment] + segment_fraction * loop.normal[segment + 1]
    normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
    first = segment + 1 if segment_fraction < 1.0 else segment + 2
    last = segment + 1 if segment_fraction > 0.0 else segment
    points = np.concatenate([point[None], loop.point[first:-1], loop.point[:last], point[None]])
    normals = np.concatenate([normal[None], loop.normal[first:-1], loop.normal[:last], normal[None]])
    return LevelLoop(points, normals, loop.level)


def order_loops(
    levels: Sequence[Sequence[LevelLoop]], options: PathOptions, centre: FloatArray
) -> tuple[list[LevelLoop], list[LoopTransition]]:
    """Return all loops in the order of forming, and the transition from each to the next.

    Each loop starts at its seam and has the direction in which it is formed. If a level has several loops,
    the one nearest to the end of the previous loop comes next; the very first loop is the longest one. A loop
    is joined to the previous one if both are the only ones of their levels and one lies inside the other.
    Between other loops the tool lifts.

    Args:
        levels: Loops of each level, in the order of forming.
        options: Options of the path.
        centre: Origin (2,) [m] in plan of the ray on which loops start.

    Returns:
        N loops and N - 1 transitions.
    """
    ordered: list[LevelLoop] = []
    transitions: list[LoopTransition] = []
    was_single = False
    sign = 1.0 if options.direction == "ccw" else -1.0
    for group in levels:
        remaining = list(group)
        is_single = len(remaining) == 1
        while remaining:
            previous_end = ordered[-1].point[-1] if ordered else None
            if previous_end is None:
                nearest_loop = max(remaining, key=LevelLoop.length)
            else:
                nearest_loop = min(
                    remaining,
                    key=lambda candidate: float(np.linalg.norm(candidate.point - previous_end, axis=1).min()),
                )
            remaining = [candidate for candidate in remaining if candidate is not nearest_loop]
            loop_sign = -sign if options.kind == "alternating" and len(ordered) % 2 else sign
            if nearest_loop.area() * loop_sign < 0.0:
                nearest_loop = nearest_loop.reversed()
            loop = start_at_seam(nearest_loop, centre, options.start_angle, previous_end)
            if ordered:
                joined = is_single and was_single and _follows(ordered[-1], loop)
                transitions.append(("step" if options.kind == "stepped" else "join") if joined else "lift")
            ordered.append(loop)
        was_single = is_single
    return ordered, transitions


def loop_curve(loops: Sequence[LevelLoop], transitions: Sequence[LoopTransition]) -> ContactCurve:
    """Return the curve of closed loops one after the other.

    Joined loops are connected by a diagonal step along the face.
    """
    keep = [np.zeros(len(loop.point), dtype=np.bool_) for loop in loops]
    for kept in keep:
        kept[0] = kept[-1] = True
    is_off_face = [np.append(np.zeros(len(loop.point) - 1, dtype=np.bool_), True) for loop in loops]
    piece = np.concatenate([[0], np.cumsum([transition != "join" for transition in transitions])]).astype(
        np.int64
    )
    count = [len(loop.point) for loop in loops]
    return ContactCurve(
        np.concatenate([loop.point for loop in loops]),
        np.concatenate([loop.normal for loop in loops]),
        np.repeat(np.arange(len(loops)), count),
        np.repeat(piece, count),
        np.concatenate(is_off_face)[:-1],
        np.concatenate(keep),
        tuple(transition for transition in transitions if transition != "join"),
    )


def spiral_curve(
    loops: Sequence[LevelLoop], transitions: Sequence[LoopTransition], seams: bool = False
) -> ContactCurve:
    """Return one spiral through all loops that are joined.

    The spiral is flat along the first and along the last loop. Between them it goes from each loop C_i to the
    next by p = (1 - s) C_i(s) + s C_i+1(s), with s the fraction of the loops' length. Loops that are not
    joined are separate pieces, each with its own spiral.

    Args:
        loops: Loops in the order of forming.
        transitions: Transition from each loop to the next.
        seams: Whether targets are kept where each loop ends.
    """
    parts: list[ContactCurve] = []
    start = 0
    loop_number = 0
    for stop in range(1, len(loops) + 1):
        if stop < len(loops) and transitions[stop - 1] == "join":
            continue
        part = _spiral_piece(loops[start:stop], loop_number, len(parts), seams)
        parts.append(part)
        loop_number = int(part.loop[-1]) + 1
        start = stop
    is_off_face = [np.append(part.is_off_face, False) for part in parts]
    return ContactCurve(
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.loop for part in parts]),
        np.concatenate([part.piece for part in parts]),
        np.concatenate(is_off_face)[:-1],
        np.concatenate([part.keep for part in parts]),
        tuple(transition for transition in transitions if transition != "join"),
    )


def _spiral_piece(loops: Sequence[LevelLoop], number: int, piece: int, seams: bool) -> ContactCurve:
    """Return the spiral through joined loops as one piece of a curve, as `spiral_curve` describes it.

    Args:
        loops: Joined loops.
        number: Number of the first loop of the spiral.
        piece: Number of the piece.
        seams: Whether the last point of each loop must become a target.
    """
    fractions = [_length_fractions(loop) for loop in loops]
    point = [loops[0].point]
    normal = [loops[0].normal]
    is_off_face = [np.zeros(len(loops[0].point) - 1, dtype=bool)]
    for k in range(len(loops) - 1):
        # points of both loops, without the first one, which the curve already has
        positions = np.union1d(fractions[k], fractions[k + 1])[1:]
        interpolated = [
            np.stack([np.interp(positions, fractions[other], values[:, axis]) for axis in range(3)], axis=1)
            for other in (k, k + 1)
            for values in (loops[other].point, loops[other].normal)
        ]
        weight = positions[:, None]
        point.append((1.0 - weight) * interpolated[0] + weight * interpolated[2])
        blend = (1.0 - weight) * interpolated[1] + weight * interpolated[3]
        normal.append(blend / np.maximum(np.linalg.norm(blend, axis=1, keepdims=True), 1e-300))
        is_off_face.append(np.ones(len(positions), dtype=bool))
    if len(loops) > 1:
        point.append(loops[-1].point[1:])
        normal.append(loops[-1].normal[1:])
        is_off_face.append(np.zeros(len(loops[-1].point) - 1, dtype=bool))
    count = [len(points) for points in point]
    keep = np.zeros(sum(count), dtype=np.bool_)
    keep[[0, count[0] - 1, sum(count) - 1]] = True
    if len(loops) > 1:
        keep[sum(count[:-1]) - 1] = True
    if seams:
        keep[np.cumsum(count) - 1] = True
    return ContactCurve(
        np.concatenate(point),
        np.concatenate(normal),
        number + np.repeat(np.arange(len(count)), count),
        np.full(sum(count), piece),
        np.concatenate(is_off_face),
        keep,
        (),
    )


def _length_fractions(loop: LevelLoop) -> FloatArray:
    """Return the fraction (K,) of a loop's length at each point, with the normal's rotation at creases."""
    move = np.linalg.norm(np.diff(loop.point, axis=0), axis=1)
    normal_change = np.linalg.norm(np.diff(loop.normal, axis=0), axis=1)
    along = np.concatenate(
        [[0.0], np.cumsum(move + np.where(move < 1e-6, _FAN_LENGTH_M_PER_RAD * normal_change, 0.0))]
    )
    return np.asarray(along / max(along[-1], 1e-300))


def _follows(loop: LevelLoop, other: LevelLoop) -> bool:
    """Return whether loops of adjacent levels are consecutive: one encloses a point of the other."""
    first, second = Polygon(loop.point[:, :2]).buffer(0.0), Polygon(other.point[:, :2]).buffer(0.0)
    if first.is_empty or second.is_empty:
        return bool(np.linalg.norm(loop.point[0] - other.point[0]) < 1e-2)
    a, b = Point(first.representative_point()), Point(second.representative_point())
    return bool(first.contains(b) or second.contains(a))
