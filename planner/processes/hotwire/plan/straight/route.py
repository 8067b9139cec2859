"""Route of a straight wire's job: to the block, cut after cut with links in air, and away.

**Links** are paths of the wire through air from one cut to the next, around the block. A wire that keeps its
direction is a point in the plane across it, and the block is a convex polygon there. To rotate, the wire is
moved to a place beyond one side of the block with enough clearance.

`operator_actions` returns messages, questions and switching of the power around the job, such as spacers
under material that rests on a slot (`would_drop`).
"""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, exp_rotation
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.problem import Setup
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.plan.operation import MAX_AIR_STEP_M, RESTING_COSINE, Straight
from planner.processes.hotwire.plan.straight.cut import StraightCut
from planner.processes.hotwire.plan.straight.order import WireLines, concatenate_lines, enlarged_box
from planner.targets import TargetAction
from planner.tooling import Bow

DIRECTION_TOLERANCE_RAD: Final = np.deg2rad(0.5)
"""Directions that differ by less than this [rad] need no rotation."""
CLEARANCE_TOLERANCE_M: Final = 1e-4
"""A path may come closer to the block than its ends by this [m]."""
BELOW_COST_FACTOR: Final = 10.0
"""Cost of a path below the block relative to one elsewhere, because its support or holder is there."""


@dataclasses.dataclass(frozen=True)
class _AvoidedBlock:
    """Block around which a link leads.

    Attributes:
        box: Lower and upper corner of the block (2, 3) [m].
        hull: Lower and upper corner of the block with the clearance (2, 3) [m].
        down: Outward normals of the sides of the block to avoid (D, 3).
    """

    box: FloatArray
    hull: FloatArray
    down: FloatArray


def plan_link(
    a: WireLines, b: WireLines, box: FloatArray, clear: float, half: float, down: FloatArray
) -> WireLines:
    """Return the wires of the cheapest path through air from ``a`` (1) to ``b`` (1), without ``a``.

    Args:
        a: First wire.
        b: Last wire. The angle between both is at most 90 degrees.
        box: Lower and upper corner of the block (2, 3) [m].
        clear: Distance to the block that all wires keep [m].
        half: Half the length of the wire [m].
        down: Outward normals of the sides of the block to avoid (D, 3).

    Raises:
        ValueError: If there is no such path.
    """
    block = _AvoidedBlock(box=box, hull=enlarged_box(box, clear - CLEARANCE_TOLERANCE_M), down=down)
    paths: list[tuple[float, WireLines]] = []
    if _angle_between(a, b) < DIRECTION_TOLERANCE_RAD:
        paths += _paths_around(a, b, block)
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        paths += _paths_beyond_side(a, b, block, half, normal)
    if not paths:
        raise ValueError("no path around the block")
    return min(paths, key=lambda path: path[0])[1]


def _angle_between(a: WireLines, b: WireLines) -> float:
    """Return the angle [rad] between two wires (1)."""
    return float(np.arccos(np.clip(a.direction[0] @ b.direction[0], -1.0, 1.0)))


def _paths_beyond_side(
    a: WireLines, b: WireLines, block: _AvoidedBlock, half: float, normal: FloatArray
) -> list[tuple[float, WireLines]]:
    """Return paths, each with its cost [m], via a point beyond one side of the block.

    The wire rotates there from the direction of ``a`` to that of ``b``. The list is empty if no path around
    the block leads there, or if the wire keeps its direction and would point at that side.

    Args:
        a: First wire (1 line).
        b: Last wire (1 line).
        block: The block to avoid.
        half: Half the length of the wire [m].
        normal: Outward normal of the side (3,).
    """
    # height of the wire's lower end below its middle, with a margin of one half
    tilt = 1.5 * half * max(abs(float(line.direction[0] @ normal)) for line in (a, b))
    if tilt > 0.6 * half and _angle_between(a, b) < DIRECTION_TOLERANCE_RAD:
        return []  # the wire is along the side's normal: no rotation needed there
    hull = block.hull
    centre = 0.5 * (hull[0] + hull[1])
    # clearly outside the hull, so that it is a corner of the convex hull of both
    pivot = centre + normal * (
        0.5 * np.abs(normal) @ (hull[1] - hull[0]) + tilt + 10.0 * CLEARANCE_TOLERANCE_M
    )
    rotating = _rotate_wire(a.direction[0], b.direction[0], pivot, half)
    first, last = (_paths_around(*ends, block) for ends in ((a, rotating[:1]), (rotating[-1:], b)))
    return [
        (
            # chosen: a rotation by 1 rad costs as much as 0.3 half lengths of the wire
            cost_to + cost_from + 0.3 * half * _angle_between(a, b),
            concatenate_lines([to_pivot, rotating[1:], from_pivot]),
        )
        for (cost_to, to_pivot), (cost_from, from_pivot) in itertools.product(first, last)
    ]


def _rotate_wire(a: FloatArray, b: FloatArray, pivot: FloatArray, half: float) -> WireLines:
    """Return wires through a point (3,) that rotate from direction ``a`` to ``b`` (3,), both included.

    No point moves farther between two of them than is allowed in air.
    """
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, a @ b))
    count = max(1, int(np.ceil(angle * half / MAX_AIR_STEP_M)))
    rotations = exp_rotation(np.arange(count + 1)[:, None] / count * angle * axis / max(sine, 1e-12))
    directions = rotations @ a
    return WireLines(pivot - half * directions, pivot + half * directions)


def _paths_around(a: WireLines, b: WireLines, block: _AvoidedBlock) -> list[tuple[float, WireLines]]:
    """Return paths from a to b with their costs [m]: straight if it is free, else both around the block.

    b has almost the direction of a. Paths are planned in the plane across the wire, where the block is a
    convex polygon. The convex hull of this polygon, start and goal contains both paths around it.
    """
    direction = a.direction[0]
    plane = np.linalg.svd(direction[None])[2][1:].T
    projected_hull = np.array(list(itertools.product(*block.hull.T))) @ plane
    corners = np.array(list(itertools.product(*block.box.T)))
    ends = [_nearest_to_centre(line, block.box) for line in (a, b)]
    start, goal = (point @ plane for point in ends)
    polygon = projected_hull[ConvexHull(projected_hull).vertices]
    if _is_free(start, goal, polygon):
        chains = [np.stack([start, goal])]
    else:
        points = np.concatenate([polygon, [start, goal]])
        order: list[int] = [int(v) for v in ConvexHull(points).vertices]
        if len(points) - 2 not in order or len(points) - 1 not in order:
            return []
        # the hull from start (index -2) to goal (-1) in both senses of rotation
        k = order.index(len(points) - 2)
        ring = order[k:] + order[:k]
        m = ring.index(len(points) - 1)
        chains = [points[ring[: m + 1]], points[[ring[0], *ring[: m - 1 : -1]]]]
    out = []
    for chain in chains:
        length = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        middle = 0.5 * (chain[1:] + chain[:-1]) @ plane.T
        is_below = np.any(
            [middle @ side > (corners @ side).max() - CLEARANCE_TOLERANCE_M for side in block.down], axis=0
        )
        extra_cost = BELOW_COST_FACTOR * float(length[is_below].sum())
        out.append(
            (float(length.sum()) + extra_cost, _lines_along_chain(a, b, chain @ plane.T, direction, ends))
        )
    return out


def _nearest_to_centre(line: WireLines, box: FloatArray) -> FloatArray:
    """Return the point (3,) of a line (1) that is nearest to the block's centre."""
    return np.asarray(line.at(line.nearest_length(0.5 * (box[:1] + box[1:])))[0])


def _is_free(a: FloatArray, b: FloatArray, polygon: FloatArray) -> bool:
    """Return whether the straight path from a to b (2,) stays out of a convex polygon (M, 2).

    The polygon is counter-clockwise. Touching its border is allowed.
    """
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # distances of both points from every edge, positive outside: a point is inside if all are negative
    u, v = ((point - polygon) @ normal.T for point in (a, b))
    u, v = np.diagonal(u), np.diagonal(v)
    enter, leave = 0.0, 1.0  # fractions of the path between which it is inside all edges so far
    for p, q in zip(u, v, strict=True):
        if p > -1e-9 and q > -1e-9:  # the whole path is outside this edge
            return True
        if p > 0.0 or q > 0.0:
            crossing = p / (p - q)
            enter, leave = (max(enter, crossing), leave) if p > 0.0 else (enter, min(leave, crossing))
    return enter >= leave - 1e-9


def _lines_along_chain(
    a: WireLines, b: WireLines, chain: FloatArray, direction: FloatArray, ends: list[FloatArray]
) -> WireLines:
    """Return wires along a path across the wire, from a (not included) to b.

    Slide along the wire and change of direction are proportional to the travelled path.

    Args:
        a: First wire (1).
        b: Last wire (1).
        chain: Points of the path (K, 3) [m], without their position along the wire.
        direction: Direction of the wire (3,).
        ends: Points (3,) [m] of a and b at the start and end of the path.
    """
    length = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(length)])
    slide = [float(point @ direction) for point in ends]
    total = max(float(travelled[-1]), abs(slide[1] - slide[0]))
    if total < 1e-6:
        return b[:0]  # already at the goal
    piece_samples = [
        np.linspace(travelled[k], travelled[k + 1], max(1, int(np.ceil(piece / MAX_AIR_STEP_M))) + 1)[1:]
        for k, piece in enumerate(length)
        if piece > 1e-9
    ]
    samples = np.concatenate(piece_samples) if piece_samples else np.array([travelled[-1]])
    points = np.stack([np.interp(samples, travelled, chain[:, k]) for k in range(3)], axis=1)
    fraction = samples / travelled[-1] if travelled[-1] > 1e-9 else np.ones(len(samples))
    points += (slide[0] + fraction * (slide[1] - slide[0]))[:, None] * direction
    directions = a.direction + fraction[:, None] * (b.direction - a.direction)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    half = 0.5 * float(np.linalg.norm(b.end[0] - b.start[0]))
    lines = WireLines(points - half * directions, points + half * directions)
    return WireLines(np.concatenate([lines.start[:-1], b.start]), np.concatenate([lines.end[:-1], b.end]))


AIR_LEAD_LENGTH_M: Final = 0.040
"""Length [m] of the path in air before the first cut and after the last one."""
MIN_PASSING_COSINE: Final = 0.94
"""Minimum cosine between moves in air that are passed without a stop."""


@dataclasses.dataclass(frozen=True)
class StraightRoute:
    """All N wires of the job in order. They point in the same direction along the wire throughout.

    Attributes:
        lines: The wires.
        segment: Segment of each wire (N,).
        stop: Whether the motion stops there (N,).
        cut: Index of the cut on whose surface a wire is (N,), -1 elsewhere.
        number: Index of the wire among those on that surface (N,), -1 elsewhere.
        last_target: Index of the last wire of each cut, lead-out included, by index of the cut.
    """

    lines: WireLines
    segment: tuple[Segment, ...]
    stop: BoolArray
    cut: IndexArray
    number: IndexArray
    last_target: dict[int, int]


def plan_route(
    cuts: list[StraightCut], box: FloatArray, clear: float, half: float, down: FloatArray
) -> StraightRoute:
    """Return the route through all cuts.

    Args:
        cuts: The cuts, in order.
        box: Lower and upper corner of the block (2, 3) [m].
        clear: Distance to the block in air [m].
        half: Half the length of the wire [m].
        down: Outward normals of the sides of the block to avoid in links (D, 3).
    """
    parts: list[WireLines] = []
    segments: list[Segment] = []
    stops: list[int] = []
    cut_index: list[IndexArray] = []
    number_on_cut: list[IndexArray] = []
    last_target: dict[int, int] = {}

    def add(segment: Segment, lines: WireLines, cut: int = -1, first: int = 0) -> None:
        """Add the lines of one segment. Those from index ``first`` on are on the surface of ``cut``."""
        parts.append(lines)
        segments.extend([segment] * len(lines))
        is_on_surface = np.arange(len(lines)) >= (first if cut >= 0 else len(lines))
        cut_index.append(np.where(is_on_surface, cut, -1))
        number_on_cut.append(np.where(is_on_surface, np.arange(len(lines)) - first, -1))

    for number, cut in enumerate(cuts):
        segment = cut.nominal.segment
        into, on, out = cut.into, cut.on.lines, cut.out
        # swap start and end of the wires if they would point against those of the previous cut
        if parts and parts[-1].direction[-1] @ into.direction[0] < 0.0:
            into, on, out = (WireLines(lines.end, lines.start) for lines in (into, on, out))
        if not parts:
            add(Segment("approach"), _air_lead(into, on)[::-1])
            stops.append(0)
        else:
            first = len(segments) - 1
            add(Segment("link"), plan_link(parts[-1][-1:], into[:1], box, clear, half, down))
            stops += (first + _air_corners(concatenate_lines([parts[-2][-1:], parts[-1]]))).tolist()
        stops.append(len(segments) - 1)
        # the move that reaches the first wire next to the surface still belongs to the lead-in
        add(segment.at("in"), concatenate_lines([into[1:], on[:1]]), number, len(into) - 1)
        add(segment, on[1:], number)
        number_on_cut[-1] += 1  # wire 0 was added with the lead-in
        if cut.reversal:
            stops.append(len(segments) + cut.reversal - 1)
        add(segment.at("out"), out)
        last_target[number] = len(segments) - 1
        stops.append(len(segments) - 1)
        last = out
    add(Segment("retreat"), _air_lead(last.reversed(), last.reversed()[1:])[1:])
    stops.append(len(segments) - 1)
    stop = np.zeros(len(segments), dtype=np.bool_)
    stop[stops] = True
    return StraightRoute(
        concatenate_lines(parts),
        tuple(segments),
        stop,
        np.concatenate(cut_index),
        np.concatenate(number_on_cut),
        last_target,
    )


def _air_corners(lines: WireLines) -> IndexArray:
    """Return the indices of lines at which a path in air turns sharply.

    The motion stops there: a wire that rests in air melts nothing.
    """
    move = np.diff(np.concatenate([lines.start, lines.end], axis=1), axis=0)
    move /= np.maximum(np.linalg.norm(move, axis=1, keepdims=True), 1e-12)
    return np.flatnonzero(np.sum(move[1:] * move[:-1], axis=1) < MIN_PASSING_COSINE) + 1


def _air_lead(into: WireLines, on: WireLines) -> WireLines:
    """Return wires in air that extend a lead beyond its first wire, which is included as the first one.

    The direction is that from the second wire to the first one. If the lead has one wire, the second is
    ``on[0]``.
    """
    second = into[1:2] if len(into) > 1 else on[:1]
    move = into.start[0] + into.end[0] - second.start[0] - second.end[0]
    direction = into.direction[0]
    move = move - (move @ direction) * direction
    count = max(1, int(np.ceil(AIR_LEAD_LENGTH_M / MAX_AIR_STEP_M)))
    shift = (
        AIR_LEAD_LENGTH_M
        * np.arange(count + 1)[:, None]
        / count
        * move
        / max(float(np.linalg.norm(move)), 1e-12)
    )
    return WireLines(into.start[:1] + shift, into.end[:1] + shift)


def operator_actions(
    op: Straight, bow: Bow, setup: Setup, cuts: list[StraightCut], route: StraightRoute
) -> tuple[TargetAction, ...]:
    """Return messages and questions to the operator, and the switching of the power, by target index.

    At the first target the wire is heated up, at the last one it cools down. Spacers are inserted after each
    cut whose material would drop, if the operation requests them.
    """
    diameter, material = 2.0 * bow.radius / MM, f" {op.wire_material}".rstrip()
    if op.power_w is not None:
        mount_message = hotwire_sentences.BOW_POWER.format(
            diameter_mm=diameter, material=material, power_w=op.power_w
        )
    else:
        mount_message = hotwire_sentences.BOW_SLOT.format(
            diameter_mm=diameter, material=material, kerf_mm=op.kerf_mm or 0.0
        )
    last = len(route.segment) - 1
    out = [
        TargetAction(0, "message", mount_message),
        TargetAction(0, "confirm", hotwire_sentences.TAUT.format()),
        TargetAction(0, "on", signal=op.signal),
        TargetAction(0, "wait", seconds=op.heat_up_s),
    ]
    for number, cut in enumerate(cuts):
        if op.spacers and would_drop(cut, setup):
            out += _spacer_actions(op, route.last_target[number], 2.0 * float(cut.on.half.mean()))
    return (
        *out,
        TargetAction(last, "off", signal=op.signal),
        TargetAction(last, "wait", seconds=op.cool_down_s),
        TargetAction(last, "confirm", hotwire_sentences.COLD.format()),
    )


def would_drop(cut: StraightCut, setup: Setup) -> bool:
    """Return whether the material above an open cut would drop by a kerf.

    It would if the slot is nearly level (`RESTING_COSINE`) and no arm holds the block.
    """
    if cut.nominal.ruled.closed or setup.stock.held_by is not None:
        return False
    normal = cut.on.row.normal.mean(axis=(0, 1))
    return bool(abs(normal @ setup.stock.gravity) > RESTING_COSINE * np.linalg.norm(normal))


def check_drops(op: Straight, cuts: list[StraightCut], setup: Setup) -> Iterator[Issue]:
    """Yield ``straight.drop`` if no spacers are requested and material that drops by a kerf is cut later."""
    up = -setup.stock.gravity
    height = [float((cut.on.row.foot.start + cut.on.row.foot.end).mean(axis=0) @ up) for cut in cuts]
    for number, cut in enumerate(cuts):
        later = [k for k in range(number + 1, len(cuts)) if height[k] > height[number]]
        if op.spacers or not later or not would_drop(cut, setup):
            continue
        slot = 2.0 * float(cut.on.half.mean()) / MM
        yield Issue(
            "straight.drop",
            format_message(
                "straight.drop",
                operation=op.name,
                segment=cut.nominal.segment,
                slot_mm=slot,
                later_segment=cuts[later[0]].nominal.segment,
            ),
            Severity.WARNING,
            field=str(cut.nominal.segment),
            **measurement(slot, None, "mm"),
            accepted=False,
        )


def _spacer_actions(op: Straight, at: int, kerf: float) -> list[TargetAction]:
    """Return the actions of inserting spacers. The wire is off and cold, because hands come near it."""
    return [
        TargetAction(at, "off", signal=op.signal),
        TargetAction(at, "wait", seconds=op.cool_down_s),
        TargetAction(at, "message", hotwire_sentences.SPACERS.format(kerf_mm=kerf / MM)),
        TargetAction(at, "confirm", hotwire_sentences.SPACED.format()),
        TargetAction(at, "on", signal=op.signal),
        TargetAction(at, "wait", seconds=op.heat_up_s),
    ]
