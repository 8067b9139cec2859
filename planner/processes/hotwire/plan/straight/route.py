"""The order of a straight wire's job: to the block, cut after cut, ways in the air between, away.

**Links** are ways of the wire through the air from one cut to the next, around the block. A wire
that keeps its direction is a point in the plane across it, and the block a convex polygon there. To
turn, it is taken to a place beyond one side of the block where there is room for that.

`actions` is what the programs say and switch around the job, such as spacers under what rests on a
slot (`drops`).
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
from planner.issues import Issue, Severity
from planner.problem import Setup
from planner.processes.hotwire import sentences as hotwire_sentences
from planner.processes.hotwire.plan.operation import AIR_STEP, RESTING_COSINE, Straight
from planner.processes.hotwire.plan.straight.cut import Cut
from planner.processes.hotwire.plan.straight.order import Lines, grown, join
from planner.targets import Action
from planner.tooling import Bow

SAME_DIRECTION: Final = np.deg2rad(0.5)
"""Directions that differ by less [rad] need no place to turn."""
NEARER_ROOM: Final = 1e-4
"""[m] a way may come nearer to the block by this than its ends are."""
BELOW_FACTOR: Final = 10.0
"""What a way below the block costs, against one elsewhere: there is its support or its holder."""


def link(a: Lines, b: Lines, box: FloatArray, clear: float, half: float, down: FloatArray) -> Lines:
    """Wires from ``a`` (1) to ``b`` (1), the first left out, that stay ``clear`` [m] of the block ``box``.

    ``half`` [m] is half the wire's length, ``down`` (D, 3) the sides of the block to keep away from. Both
    ends point the same way along the wire, within 90 degrees.
    """
    hull = grown(box, clear - NEARER_ROOM)
    ways: list[tuple[float, Lines]] = []
    if _angle(a, b) < SAME_DIRECTION:
        ways += _around(a, b, hull, down, box)
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        ways += _over(a, b, hull, half, normal, down, box)
    if not ways:
        raise ValueError("no way around the block")
    return min(ways, key=lambda way: way[0])[1]


def _angle(a: Lines, b: Lines) -> float:
    return float(np.arccos(np.clip(a.direction[0] @ b.direction[0], -1.0, 1.0)))


def _over(
    a: Lines, b: Lines, hull: FloatArray, half: float, normal: FloatArray, down: FloatArray, box: FloatArray
) -> list[tuple[float, Lines]]:
    """Ways by a place beyond one side, where the wire turns from one direction to the other."""
    tilt = 1.5 * half * max(abs(float(line.direction[0] @ normal)) for line in (a, b))
    if tilt > 0.6 * half and _angle(a, b) < SAME_DIRECTION:
        return []  # along the side's normal: nothing to turn for there
    centre = 0.5 * (hull[0] + hull[1])
    # clearly outside the hull, so that it is a corner of what lies around both
    place = centre + normal * (0.5 * np.abs(normal) @ (hull[1] - hull[0]) + tilt + 10.0 * NEARER_ROOM)
    turning = _turn(a.direction[0], b.direction[0], place, half)
    first, last = (_around(*ends, hull, down, box) for ends in ((a, turning[:1]), (turning[-1:], b)))
    return [
        (c + d + 0.3 * half * _angle(a, b), join([one, turning[1:], two]))
        for (c, one), (d, two) in itertools.product(first, last)
    ]


def _turn(a: FloatArray, b: FloatArray, place: FloatArray, half: float) -> Lines:
    """The wire turning about a place from direction a to b (3,), no point of it faster than in the air."""
    axis = np.cross(a, b)
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(size, a @ b))
    count = max(1, int(np.ceil(angle * half / AIR_STEP)))
    turns = exp_rotation(np.arange(count + 1)[:, None] / count * angle * axis / max(size, 1e-12))
    way = turns @ a
    return Lines(place - half * way, place + half * way)


def _around(
    a: Lines, b: Lines, hull: FloatArray, down: FloatArray, box: FloatArray
) -> list[tuple[float, Lines]]:
    """Ways from a to b, which has nearly a's direction, around the block's shadow: straight, or both ways
    round."""
    direction = a.direction[0]
    plane = np.linalg.svd(direction[None])[2][1:].T
    shadow = np.array(list(itertools.product(*hull.T))) @ plane
    block = np.array(list(itertools.product(*box.T)))
    ends = [_foot(line, box) for line in (a, b)]
    start, goal = (point @ plane for point in ends)
    polygon = shadow[ConvexHull(shadow).vertices]
    if _free(start, goal, polygon):
        chains = [np.stack([start, goal])]
    else:
        points = np.concatenate([polygon, [start, goal]])
        order: list[int] = [int(v) for v in ConvexHull(points).vertices]
        if len(points) - 2 not in order or len(points) - 1 not in order:
            return []
        k = order.index(len(points) - 2)
        ring = order[k:] + order[:k]
        m = ring.index(len(points) - 1)
        chains = [points[ring[: m + 1]], points[[ring[0], *ring[: m - 1 : -1]]]]
    out = []
    for chain in chains:
        length = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        middle = 0.5 * (chain[1:] + chain[:-1]) @ plane.T
        low = np.any([middle @ side > (block @ side).max() - NEARER_ROOM for side in down], axis=0)
        below = BELOW_FACTOR * float(length[low].sum())
        out.append((float(length.sum()) + below, _along(a, b, chain @ plane.T, direction, ends)))
    return out


def _foot(line: Lines, box: FloatArray) -> FloatArray:
    """The point (3,) of a line (1) that is abreast of the block's middle."""
    return np.asarray(line.at(line.abreast(0.5 * (box[:1] + box[1:])))[0])


def _free(a: FloatArray, b: FloatArray, polygon: FloatArray) -> bool:
    """Whether the straight way from a to b (2,) stays out of a convex polygon (M, 2), counter-clockwise."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    u, v = ((point - polygon) @ normal.T for point in (a, b))
    u, v = np.diagonal(u), np.diagonal(v)
    enter, leave = 0.0, 1.0
    for p, q in zip(u, v, strict=True):  # inside is where all are negative
        if p > -1e-9 and q > -1e-9:
            return True
        if p > 0.0 or q > 0.0:
            cross = p / (p - q)
            enter, leave = (max(enter, cross), leave) if p > 0.0 else (enter, min(leave, cross))
    return enter >= leave - 1e-9


def _along(a: Lines, b: Lines, chain: FloatArray, direction: FloatArray, ends: list[FloatArray]) -> Lines:
    """Wires along a chain of points across the wire, from a (left out) to b; what is along the wire goes
    evenly with the way."""
    length = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    gone = np.concatenate([[0.0], np.cumsum(length)])
    slide = [float(point @ direction) for point in ends]
    total = max(float(gone[-1]), abs(slide[1] - slide[0]))
    if total < 1e-6:
        return b[:0]  # there already
    own = [
        np.linspace(gone[k], gone[k + 1], max(1, int(np.ceil(piece / AIR_STEP))) + 1)[1:]
        for k, piece in enumerate(length)
        if piece > 1e-9
    ]
    at = np.concatenate(own) if own else np.array([gone[-1]])
    points = np.stack([np.interp(at, gone, chain[:, k]) for k in range(3)], axis=1)
    share = at / gone[-1] if gone[-1] > 1e-9 else np.ones(len(at))
    points += (slide[0] + share * (slide[1] - slide[0]))[:, None] * direction
    way = a.direction + share[:, None] * (b.direction - a.direction)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    half = 0.5 * float(np.linalg.norm(b.end[0] - b.start[0]))
    lines = Lines(points - half * way, points + half * way)
    return Lines(np.concatenate([lines.start[:-1], b.start]), np.concatenate([lines.end[:-1], b.end]))


AIR_LEAD: Final = 0.040
"""[m] way in the air before the first cut and behind the last one."""
PASSING_COSINE: Final = 0.94
"""Least cosine between moves in the air that are passed without a stop."""


@dataclasses.dataclass(frozen=True)
class Route:
    """All wires of the job in order, pointing the same way along the wire all the time.

    ``segment``, ``stop`` (N,) where the motion stops, ``cut`` (N,) index of the cut on whose surface
    a wire is, -1 elsewhere, ``place`` (N,) its number there. ``ends`` {index of a cut: its last target}.
    """

    lines: Lines
    segment: tuple[Segment, ...]
    stop: BoolArray
    cut: IndexArray
    place: IndexArray
    ends: dict[int, int]


def lay_out(cuts: list[Cut], box: FloatArray, clear: float, half: float, down: FloatArray) -> Route:
    """The route through all cuts; see :func:`planner.processes.hotwire.plan.straight.route.link` for the
    figures."""
    parts: list[Lines] = []
    segments: list[Segment] = []
    stops: list[int] = []
    owner: list[IndexArray] = []
    place: list[IndexArray] = []
    ends: dict[int, int] = {}

    def add(segment: Segment, lines: Lines, cut: int = -1, first: int = 0) -> None:
        """Lines of one segment; from number ``first`` on they are on the surface of a cut."""
        parts.append(lines)
        segments.extend([segment] * len(lines))
        on_it = np.arange(len(lines)) >= (first if cut >= 0 else len(lines))
        owner.append(np.where(on_it, cut, -1))
        place.append(np.where(on_it, np.arange(len(lines)) - first, -1))

    for number, cut in enumerate(cuts):
        own = cut.wanted.segment
        into, on, out = cut.into, cut.on.lines, cut.out
        if parts and parts[-1].direction[-1] @ into.direction[0] < 0.0:  # the wire has no front end
            into, on, out = (Lines(x.end, x.start) for x in (into, on, out))
        if not parts:
            add(Segment("approach"), _lead(into, on)[::-1])
            stops.append(0)
        else:
            first = len(segments) - 1
            add(Segment("link"), link(parts[-1][-1:], into[:1], box, clear, half, down))
            stops += (first + _corners(join([parts[-2][-1:], parts[-1]]))).tolist()
        stops.append(len(segments) - 1)
        # the move that reaches the first wire beside the surface still belongs to the way in
        add(own.at("in"), join([into[1:], on[:1]]), number, len(into) - 1)
        add(own, on[1:], number)
        place[-1] += 1
        if cut.turns:
            stops.append(len(segments) + cut.turns - 1)
        add(own.at("out"), out)
        ends[number] = len(segments) - 1
        stops.append(len(segments) - 1)
        last = out
    add(Segment("retreat"), _lead(last.reversed(), last.reversed()[1:])[1:])
    stops.append(len(segments) - 1)
    stop = np.zeros(len(segments), dtype=np.bool_)
    stop[stops] = True
    return Route(join(parts), tuple(segments), stop, np.concatenate(owner), np.concatenate(place), ends)


def _corners(lines: Lines) -> IndexArray:
    """Numbers of the lines at which a way in the air turns: there the motion stops, as nothing melts."""
    move = np.diff(np.concatenate([lines.start, lines.end], axis=1), axis=0)
    move /= np.maximum(np.linalg.norm(move, axis=1, keepdims=True), 1e-12)
    return np.flatnonzero(np.sum(move[1:] * move[:-1], axis=1) < PASSING_COSINE) + 1


def _lead(into: Lines, on: Lines) -> Lines:
    """Wires in the air from the first of ``into``, that one included, straight away from the second."""
    second = into[1:2] if len(into) > 1 else on[:1]
    move = into.start[0] + into.end[0] - second.start[0] - second.end[0]
    way = into.direction[0]
    move = move - (move @ way) * way
    count = max(1, int(np.ceil(AIR_LEAD / AIR_STEP)))
    shift = AIR_LEAD * np.arange(count + 1)[:, None] / count * move / max(float(np.linalg.norm(move)), 1e-12)
    return Lines(into.start[:1] + shift, into.end[:1] + shift)


def actions(op: Straight, bow: Bow, setup: Setup, cuts: list[Cut], route: Route) -> tuple[Action, ...]:
    """The operator's steps and the wire's power, by target."""
    diameter, material = 2.0 * bow.radius / MM, f" {op.wire_material}".rstrip()
    if op.power_w is not None:
        mounted = hotwire_sentences.BOW_POWER.filled(
            diameter_mm=diameter, material=material, power_w=op.power_w
        )
    else:
        mounted = hotwire_sentences.BOW_SLOT.filled(
            diameter_mm=diameter, material=material, kerf_mm=op.kerf_mm or 0.0
        )
    last = len(route.segment) - 1
    out = [
        Action(0, "message", mounted),
        Action(0, "confirm", hotwire_sentences.TAUT.filled()),
        Action(0, "on", signal=op.signal),
        Action(0, "wait", seconds=op.heat_up_s),
    ]
    for number, cut in enumerate(cuts):
        if op.spacers and drops(cut, setup):
            out += _spacers(op, route.ends[number], 2.0 * float(cut.on.half.mean()))
    return (
        *out,
        Action(last, "off", signal=op.signal),
        Action(last, "wait", seconds=op.cool_down_s),
        Action(last, "confirm", hotwire_sentences.COLD.filled()),
    )


def drops(cut: Cut, setup: Setup) -> bool:
    """Whether what is above an open cut rests on its slot and would drop by a kerf: the slot is level and
    goes through the block, and nothing holds what is above."""
    if cut.wanted.ruled.closed or setup.stock.held_by is not None:
        return False
    normal = cut.on.row.normal.mean(axis=(0, 1))
    return bool(abs(normal @ setup.stock.gravity) > RESTING_COSINE * np.linalg.norm(normal))


def check_drops(op: Straight, cuts: list[Cut], setup: Setup) -> Iterator[Issue]:
    """straight.drop where no spacers are asked for and what drops by a kerf is cut later."""
    up = -setup.stock.gravity
    height = [float((cut.on.row.foot.start + cut.on.row.foot.end).mean(axis=0) @ up) for cut in cuts]
    for number, cut in enumerate(cuts):
        later = [k for k in range(number + 1, len(cuts)) if height[k] > height[number]]
        if op.spacers or not later or not drops(cut, setup):
            continue
        slot = 2.0 * float(cut.on.half.mean()) / MM
        yield Issue(
            "straight.drop",
            f"{op.name}: what is above {cut.wanted.segment} drops by the slot of {slot:.1f} mm before "
            f"{cuts[later[0]].wanted.segment} is cut in it; set spacers: true, or cut it later",
            Severity.WARNING,
            field=str(cut.wanted.segment),
            **measurement(slot, None, "mm"),
            accepted=False,
        )


def _spacers(op: Straight, at: int, kerf: float) -> list[Action]:
    """Off, spacers in, on again: hands come near the wire."""
    return [
        Action(at, "off", signal=op.signal),
        Action(at, "wait", seconds=op.cool_down_s),
        Action(at, "message", hotwire_sentences.SPACERS.filled(kerf_mm=kerf / MM)),
        Action(at, "confirm", hotwire_sentences.SPACED.filled()),
        Action(at, "on", signal=op.signal),
        Action(at, "wait", seconds=op.heat_up_s),
    ]
