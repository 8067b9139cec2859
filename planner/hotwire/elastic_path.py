"""The order of the job: mount, to the block, cut, across in the air, cut back, away, and targets dense
enough between.

Each target's wire is an equilibrium of exactly the wire's length. Cuts begin and end a margin outside the
block.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from planner.hotwire.elastic_family import Family
from planner.hotwire.elastic_planes import Spine
from planner.hotwire.elastic_wires import Wires, between, box_distance, driven, from_states, join
from planner.segments import Segment

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LEAD = 0.040  # m: from the mount to where the cut begins
AIR_STEP = 0.012  # m: largest move of any wire point between targets in the air
_FINE = 5e-4  # m: grid on which travel is measured


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
    p = np.linspace(lower, upper, max(3, int(np.ceil((upper - lower) / _FINE)) // 4 + 1))
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


def _insert(route: Route, rows: NDArray[np.intp], wires: Wires, p: FloatArray) -> Route:
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
