"""The way of a bent wire: mount, to the block, cut, across in the air, cut back, away.

Targets are dense enough between. Each target's wire is an equilibrium of exactly the wire's length.
Cuts begin and end a margin outside the block.

**Wires in space** (`Wires`), as the rest of the elastic process handles them: N planar heavy
elasticas, each in its own plane. A wire is given by the frame of its middle (x along the tangent, y
in the plane, z the plane's normal) and by curvature and force there; its weight follows from the
attitude of the plane. Everything is in the stock frame.

`slack_freedom` is the freedom of sharing the wire's slack between its ends: the wire slides along
its own curve.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, from_parts, interpolate, inverse
from planner.processes.hotwire.plan.elastic.family import Family, Spine
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import STABLE, Section, polish
from planner.processes.hotwire.plan.elastica.heavy import HeavyShape
from planner.processes.hotwire.plan.operation import AIR_STEP
from planner.targets import TableFreedom

EDGE_POINTS = 33
"""Points of a wire that stand for its shape, ends included."""


@dataclasses.dataclass(frozen=True)
class Wires:
    """N wires of one ``length`` [m]: ``frame`` (N, 4, 4) of the middle, ``bend`` (N, 3) = k, Fx, Fy there,
    in its axes.

    ``gravity`` (3,) [1/m^3]: weight per length over EI as a vector in the stock frame.
    """

    frame: FloatArray
    bend: FloatArray
    length: float
    gravity: FloatArray

    def __len__(self) -> int:
        return len(self.bend)

    def __getitem__(self, index: IndexArray | slice) -> "Wires":
        return dataclasses.replace(self, frame=self.frame[index], bend=self.bend[index])

    def load(self) -> FloatArray:
        """Weight (N, 3) [1/m^3] in the wires' own axes; the third is across the plane."""
        return np.asarray(np.swapaxes(self.frame[:, :3, :3], 1, 2) @ self.gravity)

    def shapes(self, n: int = EDGE_POINTS) -> HeavyShape:
        """The planar shapes, with the middle at the origin along x."""
        count = len(self)
        middle = np.concatenate([np.zeros((count, 3)), self.bend], axis=1)
        return heavy.from_middle(middle, np.full(count, self.length), self.load()[:, :2], n)

    def points(self, shape: HeavyShape) -> FloatArray:
        """Points (N, n, 3) of the wires' ``shapes()``."""
        axes = np.swapaxes(self.frame[:, :3, :2], 1, 2)
        return np.asarray(shape.points @ axes + self.frame[:, None, :3, 3])

    def ends(self, shape: HeavyShape) -> tuple[FloatArray, FloatArray]:
        """Poses (N, 4, 4) of start and end: x along the wire from start to end, z the plane's normal."""
        return self.frame @ planar_pose(shape.start), self.frame @ planar_pose(shape.end)

    def moved(self, shift: FloatArray) -> "Wires":
        """The wires moved by shift (3,) or (N, 3) [m]."""
        frame = self.frame.copy()
        frame[:, :3, 3] += shift
        return dataclasses.replace(self, frame=frame)


def planar_pose(pose: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) in a plane's frame of planar poses (..., 3) = x, y, theta."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    rotation = np.stack(
        [np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], axis=-2
    )
    return from_parts(rotation, np.stack([pose[..., 0], pose[..., 1], zero], axis=-1))


def from_states(planes: FloatArray, state: FloatArray, length: float, gravity: FloatArray) -> Wires:
    """Wires whose middles have the states (N, 6) in the frames ``planes`` (N, 4, 4)."""
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    fx, fy = c * state[:, 4] + s * state[:, 5], -s * state[:, 4] + c * state[:, 5]
    bend = np.stack([state[:, 3], fx, fy], axis=1)
    return Wires(planes @ planar_pose(state[:, :3]), bend, length, gravity)


def join(parts: list[Wires]) -> Wires:
    """Wires one after another; all of one length."""
    return dataclasses.replace(
        parts[0], frame=np.concatenate([w.frame for w in parts]), bend=np.concatenate([w.bend for w in parts])
    )


def between(a: Wires, b: Wires, t: FloatArray) -> Wires:
    """Wires (N,) between a and b: frames by straight line and steady turn, curvature and force linearly.

    Each is an equilibrium of the same length under its own weight.
    """
    bend = (1.0 - t[:, None]) * a.bend + t[:, None] * b.bend
    return dataclasses.replace(a, frame=interpolate(a.frame, b.frame, t), bend=bend)


def driven(a: Wires, b: Wires, t: float) -> tuple[Wires, FloatArray, FloatArray]:
    """Where the wires are when both ends have gone the part ``t`` of a straight move, at a steady turn,
    from a to b.

    Returns the wires, on the branch next to ``between``; how far (N,) the solver's ends miss, over the
    length (inf where it fails); and how far (N,) [rad] the ends' tangents lean out of the common plane,
    which the planar shape leaves out.
    """
    start_a, end_a = a.ends(a.shapes(3))
    start_b, end_b = b.ends(b.shapes(3))
    part = np.full(len(a), t)
    start, end = interpolate(start_a, start_b, part), interpolate(end_a, end_b, part)
    guess = between(a, b, part)
    chord = end[:, :3, 3] - start[:, :3, 3]
    z = start[:, :3, 2] + end[:, :3, 2]
    size = np.sum(chord * chord, axis=1, keepdims=True)
    z = z - chord * np.sum(chord * z, axis=1, keepdims=True) / size
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    x = guess.frame[:, :3, 0] - z * np.sum(z * guess.frame[:, :3, 0], axis=1, keepdims=True)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    origin = guess.frame[:, :3, 3] - z * np.sum(
        z * (guess.frame[:, :3, 3] - start[:, :3, 3]), axis=1, keepdims=True
    )
    plane = from_parts(np.stack([x, np.cross(z, x), z], axis=-1), origin)
    local_start, local_end = inverse(plane) @ start, inverse(plane) @ end
    shape = dataclasses.replace(guess, frame=plane).shapes(3)
    want_start, want_end = _flat(local_start, shape.start[:, 2]), _flat(local_end, shape.end[:, 2])
    middle, miss = polish(shape.middle, want_start, want_end, shape.length, shape.weight)
    lean = np.maximum(np.abs(local_start[:, 2, 0]), np.abs(local_end[:, 2, 0]))
    miss = np.where(np.isfinite(middle).all(axis=1), miss, np.inf)
    middle = np.where(np.isfinite(middle), middle, shape.middle)
    return from_states(plane, middle, a.length, a.gravity), miss, lean


def _flat(pose: FloatArray, theta: FloatArray) -> FloatArray:
    """Planar poses (N, 3) of poses (N, 4, 4), the angle unwrapped to lie next to theta (N,)."""
    angle = np.arctan2(pose[:, 1, 0], pose[:, 0, 0])
    angle = angle + 2.0 * np.pi * np.round((theta - angle) / (2.0 * np.pi))
    return np.stack([pose[:, 0, 3], pose[:, 1, 3], angle], axis=1)


def box_distance(points: FloatArray, box: FloatArray) -> FloatArray:
    """Signed distances (...,) of points (..., 3) in the stock frame from the block with the corners ``box``
    (2, 3), negative inside.
    """
    q = np.abs(points - box.mean(axis=0)) - 0.5 * np.ptp(box, axis=0)
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0))


LEAD = 0.040  # m: from the mount to where the cut begins
_TRAVEL_STEP = 5e-4  # m: grid on which travel is measured


@dataclasses.dataclass(frozen=True)
class Face:
    """One face's cut: its planes and its wires over them."""

    name: str
    spine: Spine
    family: Family
    gravity: FloatArray

    def wires(self, p: FloatArray) -> Wires:
        """The wires at the places p (K,) along the sweep."""
        return from_states(self.spine.frames(p), self.family.state(p), self.family.length, self.gravity)


@dataclasses.dataclass(frozen=True)
class Route:
    """The whole job's wires in order: ``segment``, ``p`` place in the cut (NaN in the air),
    ``stop``.
    """

    wires: Wires
    segment: tuple[Segment, ...]
    p: FloatArray
    stop: BoolArray


def cut_range(face: Face, box: FloatArray, margin: float, radius: float) -> tuple[float, float]:
    """Places p between which the wire passes the block: at both it is just ``margin`` [m] clear of it."""
    reach = float(np.abs(face.spine.direction[:2]) @ np.abs(box[:, :2]).max(axis=0)) + margin + 2.0 * radius
    lean = float(np.ptp(box[:, 2])) + 0.3  # planes may lean: look far enough
    p = np.arange(-reach - lean, reach + lean, 0.002)
    wires = face.wires(p)
    clear = box_distance(wires.points(wires.shapes()), box).min(axis=1) - radius >= margin
    touched = np.nonzero(~clear)[0]
    if touched.size == 0:
        return float(face.family.lower), float(face.family.upper)
    return float(p[max(touched[0] - 1, 0)]), float(p[min(touched[-1] + 1, len(p) - 1)])


def cut_places(face: Face, lower: float, upper: float, box: FloatArray, step: float) -> FloatArray:
    """Places p (K,) from lower to upper, evenly spaced by the travel of the wire's fastest point in the
    block.
    """
    p = np.linspace(lower, upper, max(3, int(np.ceil((upper - lower) / _TRAVEL_STEP)) // 4 + 1))
    wires = face.wires(p)
    gone = np.concatenate([[0.0], np.cumsum(travel(wires, box)[1:])])
    count = max(3, int(np.ceil(gone[-1] / step)) + 1)
    return np.interp(np.linspace(0.0, gone[-1], count), gone, p)


def travel(wires: Wires, box: FloatArray) -> FloatArray:
    """How far (N,) [m] the fastest point in the block moves on the way to each wire; the fastest of all
    where none is in it.
    """
    points = wires.points(wires.shapes())
    inside = box_distance(points, box) < 0.0
    move = np.linalg.norm(np.diff(points, axis=0), axis=2)
    near = inside[1:] | inside[:-1]
    near |= ~near.any(axis=1, keepdims=True)
    return np.concatenate([[0.0], np.max(move * near, axis=1)])


def lay_out(
    faces: list[Face], box: FloatArray, margin: float, radius: float, step: float, two_runs: bool
) -> Route:
    """The route through all faces. The first sweeps along growing p; the next comes back, or with
    ``two_runs`` goes on anew.
    """
    parts: list[Wires] = []
    segments: list[Segment] = []
    places: list[FloatArray] = []
    stops: list[int] = []

    def add(segment: Segment, wires: Wires, p: FloatArray | None = None) -> None:
        parts.append(wires)
        segments.extend([segment] * len(wires))
        places.append(np.full(len(wires), np.nan) if p is None else p)

    forward = True
    for index, face in enumerate(faces):
        forward = index == 0 or two_runs or not forward
        lower, upper = cut_range(face, box, margin, radius)
        p = cut_places(face, lower, upper, box, step)
        p = p if forward else p[::-1]
        wires = face.wires(p)
        sense = face.spine.direction * (1.0 if forward else -1.0)
        if index == 0:
            count = 2 * max(1, int(np.ceil(0.5 * LEAD / AIR_STEP)))
            shift = -LEAD * (1.0 - np.arange(count + 1) / count)
            lead = wires[np.zeros(count + 1, dtype=np.intp)].moved(shift[:, None] * sense)
            add(Segment("mount"), lead[:1])
            add(Segment("transit"), lead[1 : count // 2 + 1])
            add(Segment("approach"), lead[count // 2 + 1 :])
            stops += [0, len(segments) - 1]
        else:
            link = _link(parts[-1][-1:], wires[:1], box, margin, radius, two_runs)
            for leg in link:
                add(Segment("link"), leg)
                stops.append(len(segments) - 1)
        add(Segment("cut", face.name), wires[1:], p[1:])
        stops.append(len(segments) - 1)
    count = max(2, int(np.ceil(LEAD / AIR_STEP)))
    shift = LEAD * (1.0 + np.arange(count)) / count
    away = parts[-1][np.full(count, len(parts[-1]) - 1)].moved(shift[:, None] * sense)
    add(Segment("retreat"), away[:-1])
    add(Segment("unmount"), away[-1:])
    stops.append(len(segments) - 1)
    stop = np.zeros(len(segments), dtype=np.bool_)
    stop[stops] = True
    return Route(join(parts), tuple(segments), np.concatenate(places), stop)


def _link(a: Wires, b: Wires, box: FloatArray, margin: float, radius: float, over: bool) -> list[Wires]:
    """Legs from wire a to wire b in the air; ``over`` the block where b begins at its other side."""
    way = [a, b]
    if over:
        high = max(_lift(a, box, margin + radius), _lift(b, box, margin + radius))
        top = float(max(a.frame[0, 2, 3], b.frame[0, 2, 3])) + high
        up = np.array([0.0, 0.0, 1.0])
        way = [a, a.moved((top - a.frame[0, 2, 3]) * up), b.moved((top - b.frame[0, 2, 3]) * up), b]
    legs = []
    for first, last in itertools.pairwise(way):
        gap = np.linalg.norm(last.points(last.shapes()) - first.points(first.shapes()), axis=2).max()
        if gap < 1e-9:
            continue
        count = max(2, int(np.ceil(gap / AIR_STEP)))
        t = np.arange(1, count + 1) / count
        zero = np.zeros(count, dtype=np.intp)
        legs.append(between(first[zero], last[zero], t))
    return legs


def _lift(wire: Wires, box: FloatArray, margin: float) -> float:
    """How far [m] to raise a wire so that all of it that may come over the block is ``margin`` above it."""
    points = wire.points(wire.shapes(65))[0]
    flat = np.abs(box[:, :2]).max(axis=0) + margin
    axis = wire.frame[0, :2, 0] / np.linalg.norm(wire.frame[0, :2, 0])
    over = np.abs(points[:, :2] @ axis) <= np.abs(axis) @ flat
    lowest = points[over, 2].min() if over.any() else points[:, 2].min()
    return float(max(0.0, box[1, 2] + margin - lowest))


def refine(
    route: Route, faces: list[Face], box: FloatArray, tolerance: float
) -> tuple[Route, FloatArray, FloatArray]:
    """Insert targets until the wire half-way of every move, driven by its ends, is within ``tolerance`` [m]
    of the wanted one.

    Returns the route, that deviation (N,) on the way to each target, and the largest misses (N,) of the
    solver over the length.
    """
    by_name = {Segment("cut", face.name): face for face in faces}
    for turn in range(5):
        wanted, p = _halfway(route, by_name)
        now, miss, _ = driven(route.wires[:-1], route.wires[1:], 0.5)
        off = _deviation(now, wanted, box, np.isfinite(p))
        bad = (off > tolerance) | ~(miss < 1e-7)
        if not bad.any() or turn == 4:
            break
        route = _insert(route, np.nonzero(bad)[0], wanted, p)
    return route, np.concatenate([[0.0], off]), np.concatenate([[0.0], miss])


def _halfway(route: Route, by_name: dict[Segment, Face]) -> tuple[Wires, FloatArray]:
    """The wanted wires half-way of every move, and their places in the cut."""
    count = len(route.wires) - 1
    middle = between(route.wires[:-1], route.wires[1:], np.full(count, 0.5))
    frame, bend, p = middle.frame.copy(), middle.bend.copy(), np.full(count, np.nan)
    label = np.array(route.segment)
    for name, face in by_name.items():
        rows = np.nonzero((label[1:] == name) & np.isfinite(route.p[:-1]) & (label[:-1] == name))[0]
        if rows.size:
            p[rows] = 0.5 * (route.p[rows] + route.p[rows + 1])
            exact = face.wires(p[rows])
            frame[rows], bend[rows] = exact.frame, exact.bend
    return dataclasses.replace(middle, frame=frame, bend=bend), p


def _deviation(now: Wires, wanted: Wires, box: FloatArray, in_cut: BoolArray) -> FloatArray:
    """Largest distance (N,) across the wire, in the block (anywhere in the air), from the wanted wires."""
    shape = wanted.shapes()
    a, b = now.points(now.shapes()), wanted.points(shape)
    tangent = np.gradient(b, axis=1)
    tangent = tangent / np.linalg.norm(tangent, axis=2, keepdims=True)
    gap = a - b
    gap = gap - tangent * np.sum(gap * tangent, axis=2, keepdims=True)
    counted = (box_distance(b, box) < 0.0) | ~in_cut[:, None]
    return np.asarray(np.max(np.linalg.norm(gap, axis=2) * counted, axis=1))


def _insert(route: Route, rows: IndexArray, wires: Wires, p: FloatArray) -> Route:
    """The route with the half-way wires of the moves ``rows`` as targets of their own."""
    at = rows + 1
    frame = np.insert(route.wires.frame, at, wires.frame[rows], axis=0)
    bend = np.insert(route.wires.bend, at, wires.bend[rows], axis=0)
    taken = np.insert(np.arange(len(route.segment)), at, at)
    return Route(
        dataclasses.replace(route.wires, frame=frame, bend=bend),
        tuple(route.segment[i] for i in taken),
        np.insert(route.p, at, p[rows]),
        np.insert(route.stop, at, False),
    )


SLACK_NODES: Final = 7
"""Slides of the wire through its section that are tried between the bounds, as nodes of a table."""
_STABILITY_STRIDE = 6  # stability is checked at every so many targets


def slack_freedom(
    wires: Wires,
    arms: tuple[str, str],
    reach: float,
    box: FloatArray,
    clear: float,
    section: Section,
    bend: float,
) -> TableFreedom | None:
    """How far each wire may slide along itself: at most ``reach`` [m] either way, its ends ``clear`` [m] of
    the block.

    The reach is halved until the slid wires are stable and bent less than ``bend`` [1/m]; None where
    nothing is left.
    """
    if reach < 1e-3:
        return None
    shapes = wires.shapes()
    for _ in range(4):
        nodes = np.linspace(-reach, reach, SLACK_NODES)
        start, end = heavy.extend(shapes, np.broadcast_to(nodes, (len(wires), SLACK_NODES)))
        first = wires.frame[:, None] @ planar_pose(start)
        last = wires.frame[:, None] @ planar_pose(end)
        free = (box_distance(first[..., :3, 3], box) >= clear) & (
            box_distance(last[..., :3, 3], box) >= clear
        )
        lower, upper = _range(nodes, free)
        # at the mount and the unmount stop the operator has the stated distance and angles of the clamps
        lower[[0, -1]] = upper[[0, -1]] = 0.0
        if _holds(wires, lower, section, bend) and _holds(wires, upper, section, bend):
            return TableFreedom("slack", nodes, {arms[0]: first, arms[1]: last}, lower, upper)
        reach *= 0.5
    return None


def _range(nodes: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (N,) of the nodes next to 0 that are free without a gap."""
    middle = len(nodes) // 2
    up = np.cumprod(free[:, middle:], axis=1).sum(axis=1)
    down = np.cumprod(free[:, middle::-1], axis=1).sum(axis=1)
    return nodes[middle - np.maximum(down, 1) + 1], nodes[middle + np.maximum(up, 1) - 1]


def _holds(wires: Wires, slide: FloatArray, section: Section, bend: float) -> bool:
    some = wires[slice(0, None, _STABILITY_STRIDE)]
    slid = heavy.slide(some.shapes(3), slide[::_STABILITY_STRIDE], 33)
    stable = min(float(slid.margin_in_plane.min()), float(slid.margin_out_of_plane(section).min()))
    return stable > 10.0 * STABLE and float(np.abs(slid.curvature).max()) <= bend
