"""Path of a bent wire: mount, approach, cut, link in air, cut back, retreat.

Targets are so dense that the wire between them stays within a tolerance of the nominal one. At each target
the wire is an equilibrium of exactly its length. Cuts start and end a margin outside the block.

**Wires in space** (`WireSet`): N planar elasticas with weight, each in its own plane. A wire is given by the
frame of its middle (x along the tangent, y in the plane, z the plane's normal) and by curvature and force
there. Its weight follows from the orientation of the plane. Everything is in the stock frame.

`slack_freedom` is the freedom to distribute the slack between the wire's ends: the wire slides along its own
curve.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, from_parts, interpolate, inverse
from planner.processes.hotwire.plan.elastic.family import Spine, WireFamily
from planner.processes.hotwire.plan.elastica import heavy
from planner.processes.hotwire.plan.elastica.clamped import MIN_STABLE_MARGIN, StiffnessRatios, refine_state
from planner.processes.hotwire.plan.elastica.heavy import HeavyShape
from planner.processes.hotwire.plan.operation import MAX_AIR_STEP_M
from planner.processes.hotwire.plan.wire import HeatedWire
from planner.targets import TableFreedom

WIRE_POINTS = 33
"""Number of points that represent a wire's shape, ends included."""


@dataclasses.dataclass(frozen=True)
class WireSet:
    """N wires of one length.

    Attributes:
        frame: Frames of the wires' middles in the stock frame (N, 4, 4).
        curvature_and_force: Curvature k [1/m] and force Fx, Fy over EI [1/m^2] at the middle, in its axes
            (N, 3).
        length: Length [m].
        gravity: Weight per length over EI as a vector in the stock frame (3,) [1/m^3].
    """

    frame: FloatArray
    curvature_and_force: FloatArray
    length: float
    gravity: FloatArray

    def __len__(self) -> int:
        return len(self.curvature_and_force)

    def __getitem__(self, index: IndexArray | slice) -> "WireSet":
        return dataclasses.replace(
            self, frame=self.frame[index], curvature_and_force=self.curvature_and_force[index]
        )

    def load(self) -> FloatArray:
        """Return the weight (N, 3) [1/m^3] in the wires' own axes.

        The third component is across the plane.
        """
        return np.asarray(np.swapaxes(self.frame[:, :3, :3], 1, 2) @ self.gravity)

    def shapes(self, n: int = WIRE_POINTS) -> HeavyShape:
        """Return the planar shapes with n points. Each has its middle at the origin, tangent to x."""
        count = len(self)
        middle = np.concatenate([np.zeros((count, 3)), self.curvature_and_force], axis=1)
        return heavy.from_middle(middle, np.full(count, self.length), self.load()[:, :2], n)

    def points(self, shape: HeavyShape) -> FloatArray:
        """Return the points (N, n, 3) [m] of planar ``shapes()`` in the stock frame."""
        axes = np.swapaxes(self.frame[:, :3, :2], 1, 2)
        return np.asarray(shape.points @ axes + self.frame[:, None, :3, 3])

    def ends(self, shape: HeavyShape) -> tuple[FloatArray, FloatArray]:
        """Return the poses (N, 4, 4) of start and end of planar ``shapes()`` in the stock frame.

        x is along the wire from start to end, z is normal to the plane.
        """
        return self.frame @ planar_pose(shape.start), self.frame @ planar_pose(shape.end)

    def shifted(self, shift: FloatArray) -> "WireSet":
        """Return the wires shifted by (3,) or (N, 3) [m]."""
        frame = self.frame.copy()
        frame[:, :3, 3] += shift
        return dataclasses.replace(self, frame=frame)


def planar_pose(pose: FloatArray) -> FloatArray:
    """Return poses (..., 4, 4) in a plane's frame for planar poses x, y, theta (..., 3).

    Their x axis has the angle theta in the plane, z is the plane's normal.
    """
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    rotation = np.stack(
        [np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], axis=-2
    )
    return from_parts(rotation, np.stack([pose[..., 0], pose[..., 1], zero], axis=-1))


def wires_from_states(planes: FloatArray, state: FloatArray, length: float, gravity: FloatArray) -> WireSet:
    """Create wires whose middles have given states in given planes.

    Args:
        planes: Frames of the planes (N, 4, 4).
        state: Middle states (N, 6).
        length: Length of the wires [m].
        gravity: Weight per length over EI in the stock frame (3,) [1/m^3].
    """
    c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
    fx, fy = c * state[:, 4] + s * state[:, 5], -s * state[:, 4] + c * state[:, 5]
    bend = np.stack([state[:, 3], fx, fy], axis=1)
    return WireSet(planes @ planar_pose(state[:, :3]), bend, length, gravity)


def concatenate_wires(parts: list[WireSet]) -> WireSet:
    """Concatenate wires of one length."""
    return dataclasses.replace(
        parts[0],
        frame=np.concatenate([w.frame for w in parts]),
        curvature_and_force=np.concatenate([w.curvature_and_force for w in parts]),
    )


def interpolate_wires(a: WireSet, b: WireSet, t: FloatArray) -> WireSet:
    """Interpolate between wires a (t = 0) and b (t = 1), at t (N,).

    The middle's frame moves along a straight line and rotates at a constant rate. Its curvature and force are
    interpolated linearly. Each result is an equilibrium of the same length under its own weight.
    """
    bend = (1.0 - t[:, None]) * a.curvature_and_force + t[:, None] * b.curvature_and_force
    return dataclasses.replace(a, frame=interpolate(a.frame, b.frame, t), curvature_and_force=bend)


def drive_wires(a: WireSet, b: WireSet, t: float) -> tuple[WireSet, FloatArray, FloatArray]:
    """Return the wires when both ends have moved a fraction of a straight move from a to b.

    `refine` compares them with the nominal wires, because the wire follows its ends between two targets.

    Args:
        a: Wires at the start of the move (N).
        b: Wires at the end of the move (N).
        t: Fraction of the move, at constant rotation rate.

    Returns:
        The equilibria (N) next to ``interpolate_wires``; the largest deviation of their ends from the driven
        poses over the length (N,), infinite if the solver fails; and the angle (N,) [rad] by which the ends'
        tangents leave the common plane, which the planar shape neglects.
    """
    # end poses of the straight move, and the plane through both ends that is closest to both normals
    start_a, end_a = a.ends(a.shapes(3))
    start_b, end_b = b.ends(b.shapes(3))
    fraction = np.full(len(a), t)
    start, end = interpolate(start_a, start_b, fraction), interpolate(end_a, end_b, fraction)
    guess = interpolate_wires(a, b, fraction)
    chord = end[:, :3, 3] - start[:, :3, 3]
    z = start[:, :3, 2] + end[:, :3, 2]
    chord_squared = np.sum(chord * chord, axis=1, keepdims=True)
    z = z - chord * np.sum(chord * z, axis=1, keepdims=True) / chord_squared
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    x = guess.frame[:, :3, 0] - z * np.sum(z * guess.frame[:, :3, 0], axis=1, keepdims=True)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    origin = guess.frame[:, :3, 3] - z * np.sum(
        z * (guess.frame[:, :3, 3] - start[:, :3, 3]), axis=1, keepdims=True
    )
    plane = from_parts(np.stack([x, np.cross(z, x), z], axis=-1), origin)
    # planar equilibrium between the end poses, from the interpolated wire
    local_start, local_end = inverse(plane) @ start, inverse(plane) @ end
    shape = dataclasses.replace(guess, frame=plane).shapes(3)
    required_start = _to_planar(local_start, shape.start[:, 2])
    required_end = _to_planar(local_end, shape.end[:, 2])
    middle, end_error = refine_state(shape.middle, required_start, required_end, shape.length, shape.weight)
    out_of_plane_angle = np.maximum(np.abs(local_start[:, 2, 0]), np.abs(local_end[:, 2, 0]))
    end_error = np.where(np.isfinite(middle).all(axis=1), end_error, np.inf)
    middle = np.where(np.isfinite(middle), middle, shape.middle)
    return wires_from_states(plane, middle, a.length, a.gravity), end_error, out_of_plane_angle


def _to_planar(pose: FloatArray, theta: FloatArray) -> FloatArray:
    """Return planar poses (N, 3) of poses (N, 4, 4), with the angle unwrapped to lie next to theta (N,)."""
    angle = np.arctan2(pose[:, 1, 0], pose[:, 0, 0])
    angle = angle + 2.0 * np.pi * np.round((theta - angle) / (2.0 * np.pi))
    return np.stack([pose[:, 0, 3], pose[:, 1, 3], angle], axis=1)


def box_distance(points: FloatArray, box: FloatArray) -> FloatArray:
    """Return signed distances (...,) [m] of points from the block, negative inside.

    Args:
        points: Points in the stock frame (..., 3) [m].
        box: Lower and upper corner of the block (2, 3) [m].
    """
    q = np.abs(points - box.mean(axis=0)) - 0.5 * np.ptp(box, axis=0)
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0))


LEAD_LENGTH_M = 0.040  # m from the mount to the start of the cut
_TRAVEL_STEP_M = 5e-4  # m: grid on which travel is measured


@dataclasses.dataclass(frozen=True)
class FaceCut:
    """The cut of one face.

    Attributes:
        name: Name of the face.
        spine: Planes across the sweep, one for each sweep position p.
        family: Wire in each of these planes.
        gravity: Weight per length over EI in the stock frame (3,) [1/m^3].
    """

    name: str
    spine: Spine
    family: WireFamily
    gravity: FloatArray

    def wires(self, p: FloatArray) -> WireSet:
        """Return the wires at the positions p (K,) [m] along the sweep."""
        return wires_from_states(self.spine.frames(p), self.family.state(p), self.family.length, self.gravity)


@dataclasses.dataclass(frozen=True)
class WireRoute:
    """Wires at the N targets of the job in order.

    Attributes:
        wires: The wires.
        segment: Segment of each wire (N,).
        sweep_position: Sweep position in the cut (N,) [m], NaN in air.
        stop: Whether the motion stops there (N,).
    """

    wires: WireSet
    segment: tuple[Segment, ...]
    sweep_position: FloatArray
    stop: BoolArray


def cut_range(face: FaceCut, box: FloatArray, margin: float, radius: float) -> tuple[float, float]:
    """Return the first and the last sweep position p [m] of the cut of a face.

    Between them the wire passes the block. At both it is outside the block by ``margin`` or slightly more: p
    is searched in steps of 2 mm. If the wire never comes closer, the range of the wire family is returned.

    Args:
        face: The face.
        box: Lower and upper corner of the block (2, 3) [m].
        margin: Distance to the block [m].
        radius: Radius of the wire [m].
    """
    reach = float(np.abs(face.spine.direction[:2]) @ np.abs(box[:, :2]).max(axis=0)) + margin + 2.0 * radius
    tilt_allowance = (
        float(np.ptp(box[:, 2])) + 0.3
    )  # m: tilted planes meet the block before and after its sides
    p = np.arange(-reach - tilt_allowance, reach + tilt_allowance, 0.002)
    wires = face.wires(p)
    is_clear = box_distance(wires.points(wires.shapes()), box).min(axis=1) - radius >= margin
    touching = np.nonzero(~is_clear)[0]
    if touching.size == 0:
        return float(face.family.lower), float(face.family.upper)
    return float(p[max(touching[0] - 1, 0)]), float(p[min(touching[-1] + 1, len(p) - 1)])


def cut_positions(face: FaceCut, lower: float, upper: float, box: FloatArray, step: float) -> FloatArray:
    """Return positions p (K,) evenly spaced by the travel of the wire's fastest point in the block.

    Args:
        face: The face.
        lower: First position [m].
        upper: Last position [m].
        box: Lower and upper corner of the block (2, 3) [m].
        step: Maximum travel between positions [m].
    """
    # travel is measured on a grid four times as coarse as _TRAVEL_STEP_M and interpolated
    p = np.linspace(lower, upper, max(3, int(np.ceil((upper - lower) / _TRAVEL_STEP_M)) // 4 + 1))
    wires = face.wires(p)
    travelled = np.concatenate([[0.0], np.cumsum(max_travel(wires, box)[1:])])
    count = max(3, int(np.ceil(travelled[-1] / step)) + 1)
    return np.interp(np.linspace(0.0, travelled[-1], count), travelled, p)


def max_travel(wires: WireSet, box: FloatArray) -> FloatArray:
    """Return the move (N,) [m] of the fastest point in the block from the previous wire to each one.

    Points count that are in the block at one of both wires. If there are none, it is the distance of the
    fastest point of the wire. The first value is 0.
    """
    points = wires.points(wires.shapes())
    inside = box_distance(points, box) < 0.0
    distance = np.linalg.norm(np.diff(points, axis=0), axis=2)
    is_relevant = inside[1:] | inside[:-1]
    is_relevant |= ~is_relevant.any(axis=1, keepdims=True)
    return np.concatenate([[0.0], np.max(distance * is_relevant, axis=1)])


def plan_route(
    faces: list[FaceCut], box: FloatArray, margin: float, radius: float, step: float, two_runs: bool
) -> WireRoute:
    """Plan the route through all faces.

    The route consists of mount, transit, approach, then the cuts with links between them, retreat and
    unmount. The first cut sweeps along increasing p. The cuts alternate in direction unless ``two_runs`` is
    set.

    Args:
        faces: The faces, in order.
        box: Lower and upper corner of the block (2, 3) [m].
        margin: Distance to the block in air [m].
        radius: Radius of the wire [m].
        step: Maximum travel between targets in the cut [m].
        two_runs: Whether every cut sweeps along increasing p. The wire then returns over the block.
    """
    parts: list[WireSet] = []
    segments: list[Segment] = []
    positions: list[FloatArray] = []
    stops: list[int] = []

    def add(segment: Segment, wires: WireSet, p: FloatArray | None = None) -> None:
        """Append wires to the route, with their sweep positions if they are in a cut."""
        parts.append(wires)
        segments.extend([segment] * len(wires))
        positions.append(np.full(len(wires), np.nan) if p is None else p)

    is_forward = True
    for index, face in enumerate(faces):
        is_forward = index == 0 or two_runs or not is_forward
        lower, upper = cut_range(face, box, margin, radius)
        p = cut_positions(face, lower, upper, box, step)
        p = p if is_forward else p[::-1]
        wires = face.wires(p)
        signed_direction = face.spine.direction * (1.0 if is_forward else -1.0)
        if index == 0:
            # lead-in: the first wire of the cut, shifted back along the sweep
            count = 2 * max(1, int(np.ceil(0.5 * LEAD_LENGTH_M / MAX_AIR_STEP_M)))
            shift = -LEAD_LENGTH_M * (1.0 - np.arange(count + 1) / count)
            lead = wires[np.zeros(count + 1, dtype=np.intp)].shifted(shift[:, None] * signed_direction)
            add(Segment("mount"), lead[:1])
            add(Segment("transit"), lead[1 : count // 2 + 1])
            add(Segment("approach"), lead[count // 2 + 1 :])
            stops += [0, len(segments) - 1]
        else:
            link = _link_legs(parts[-1][-1:], wires[:1], box, margin, radius, two_runs)
            for leg in link:
                add(Segment("link"), leg)
                stops.append(len(segments) - 1)
        # the first wire of the cut is the last one of the lead-in or link
        add(Segment("cut", face.name), wires[1:], p[1:])
        stops.append(len(segments) - 1)
    # retreat: the last wire of the last cut, shifted on along the sweep
    count = max(2, int(np.ceil(LEAD_LENGTH_M / MAX_AIR_STEP_M)))
    shift = LEAD_LENGTH_M * (1.0 + np.arange(count)) / count
    retreat = parts[-1][np.full(count, len(parts[-1]) - 1)].shifted(shift[:, None] * signed_direction)
    add(Segment("retreat"), retreat[:-1])
    add(Segment("unmount"), retreat[-1:])
    stops.append(len(segments) - 1)
    stop = np.zeros(len(segments), dtype=np.bool_)
    stop[stops] = True
    return WireRoute(concatenate_wires(parts), tuple(segments), np.concatenate(positions), stop)


def _link_legs(
    a: WireSet, b: WireSet, box: FloatArray, margin: float, radius: float, over_block: bool
) -> list[WireSet]:
    """Return the wires on each straight leg in air from wire a to wire b.

    The first wire of each leg is left out, because it is a or the last wire of the previous leg.

    Args:
        a: First wire (1 wire).
        b: Last wire (1 wire).
        box: Lower and upper corner of the block (2, 3) [m].
        margin: Distance to the block [m].
        radius: Radius of the wire [m].
        over_block: Whether a and b are on opposite sides of the block. The wire is then raised above it,
            moved across and lowered, on three legs. Otherwise there is one leg.
    """
    waypoints = [a, b]
    if over_block:
        high = max(_lift_height(a, box, margin + radius), _lift_height(b, box, margin + radius))
        top = float(max(a.frame[0, 2, 3], b.frame[0, 2, 3])) + high
        up = np.array([0.0, 0.0, 1.0])
        waypoints = [a, a.shifted((top - a.frame[0, 2, 3]) * up), b.shifted((top - b.frame[0, 2, 3]) * up), b]
    legs = []
    for first, last in itertools.pairwise(waypoints):
        gap = np.linalg.norm(last.points(last.shapes()) - first.points(first.shapes()), axis=2).max()
        if gap < 1e-9:
            continue
        count = max(2, int(np.ceil(gap / MAX_AIR_STEP_M)))
        t = np.arange(1, count + 1) / count
        zero = np.zeros(count, dtype=np.intp)
        legs.append(interpolate_wires(first[zero], last[zero], t))
    return legs


def _lift_height(wire: WireSet, box: FloatArray, margin: float) -> float:
    """Return by how much [m] to raise a wire (1 wire) so that its part over the block is ``margin`` above it.

    The part over the block is estimated along the wire's direction. It is 0 if the wire is already high
    enough.
    """
    points = wire.points(wire.shapes(65))[0]
    half_extent = np.abs(box[:, :2]).max(axis=0) + margin
    axis = wire.frame[0, :2, 0] / np.linalg.norm(wire.frame[0, :2, 0])
    is_over = np.abs(points[:, :2] @ axis) <= np.abs(axis) @ half_extent
    lowest = points[is_over, 2].min() if is_over.any() else points[:, 2].min()
    return float(max(0.0, box[1, 2] + margin - lowest))


def refine(
    route: WireRoute, faces: list[FaceCut], box: FloatArray, tolerance: float
) -> tuple[WireRoute, FloatArray, FloatArray]:
    """Insert targets until the wire halfway along every move is within a tolerance of the nominal one.

    Halfway, the wire is the equilibrium between ends that have moved halfway along straight moves. A move is
    also halved if the solver finds no such equilibrium. Moves are halved at most 4 times.

    Args:
        route: Route through all faces.
        faces: The faces.
        box: Lower and upper corner of the block (2, 3) [m].
        tolerance: Allowed deviation [m].

    Returns:
        The route with N targets, the deviation (N,) [m] halfway along the move to each target, and the
        largest error of the ends' poses in the solution there over the length (N,), infinite if the solver
        fails. Both are 0 for the first target.
    """
    by_name = {Segment("cut", face.name): face for face in faces}
    for iteration in range(5):
        nominal, p = _halfway_wires(route, by_name)
        actual, end_error, _ = drive_wires(route.wires[:-1], route.wires[1:], 0.5)
        deviation = _deviation(actual, nominal, box, np.isfinite(p))
        needs_target = (deviation > tolerance) | ~(end_error < 1e-7)
        if not needs_target.any() or iteration == 4:
            break
        route = _insert_targets(route, np.nonzero(needs_target)[0], nominal, p)
    return route, np.concatenate([[0.0], deviation]), np.concatenate([[0.0], end_error])


def _halfway_wires(route: WireRoute, by_name: dict[Segment, FaceCut]) -> tuple[WireSet, FloatArray]:
    """Return the nominal wires halfway along all M moves, and their sweep positions (M,) [m], NaN in air.

    In a cut they are wires of the fitted family, elsewhere they are interpolated.
    """
    count = len(route.wires) - 1
    middle = interpolate_wires(route.wires[:-1], route.wires[1:], np.full(count, 0.5))
    frame, bend, p = middle.frame.copy(), middle.curvature_and_force.copy(), np.full(count, np.nan)
    label = np.array(route.segment)
    for name, face in by_name.items():
        moves = np.nonzero(
            (label[1:] == name) & np.isfinite(route.sweep_position[:-1]) & (label[:-1] == name)
        )[0]
        if moves.size:
            p[moves] = 0.5 * (route.sweep_position[moves] + route.sweep_position[moves + 1])
            exact = face.wires(p[moves])
            frame[moves], bend[moves] = exact.frame, exact.curvature_and_force
    return dataclasses.replace(middle, frame=frame, curvature_and_force=bend), p


def _deviation(actual: WireSet, nominal: WireSet, box: FloatArray, in_cut: BoolArray) -> FloatArray:
    """Return the largest distance (N,) [m] between points of actual and nominal wires, across the wire.

    In a cut (``in_cut``) only points in the block count, in air all points.
    """
    shape = nominal.shapes()
    a, b = actual.points(actual.shapes()), nominal.points(shape)
    tangent = np.gradient(b, axis=1)
    tangent = tangent / np.linalg.norm(tangent, axis=2, keepdims=True)
    offset = a - b
    offset = offset - tangent * np.sum(offset * tangent, axis=2, keepdims=True)
    is_relevant = (box_distance(b, box) < 0.0) | ~in_cut[:, None]
    return np.asarray(np.max(np.linalg.norm(offset, axis=2) * is_relevant, axis=1))


def _insert_targets(route: WireRoute, moves: IndexArray, wires: WireSet, p: FloatArray) -> WireRoute:
    """Return the route with additional targets halfway along some moves.

    Args:
        route: The route.
        moves: Indices of the moves, each between a target and the next one.
        wires: Wires halfway along all M moves.
        p: Their sweep positions (M,) [m], NaN in air.
    """
    at = moves + 1
    frame = np.insert(route.wires.frame, at, wires.frame[moves], axis=0)
    bend = np.insert(route.wires.curvature_and_force, at, wires.curvature_and_force[moves], axis=0)
    source = np.insert(np.arange(len(route.segment)), at, at)
    return WireRoute(
        dataclasses.replace(route.wires, frame=frame, curvature_and_force=bend),
        tuple(route.segment[i] for i in source),
        np.insert(route.sweep_position, at, p[moves]),
        np.insert(route.stop, at, False),
    )


SLACK_NODES: Final = 7
"""Number of slides of the wire along itself for which the freedom tabulates the poses of the ends."""
_STABILITY_STRIDE = 6  # stability is checked at every 6th target


def slack_freedom(
    wires: WireSet,
    arms: tuple[str, str],
    reach: float,
    box: FloatArray,
    end_clearance: float,
    wire: HeatedWire,
) -> TableFreedom | None:
    """Return the freedom of each wire to slide along itself, or None if no reach is possible.

    Each wire may slide as far as its ends keep their distance from the block. The reach is halved at most 3
    times until the wires are stable and within the curvature limit at both ends of their slides. The first
    and the last wire do not slide.

    Args:
        wires: N wires.
        arms: Arms at the start and end of the wire.
        reach: Maximum slide in each direction [m].
        box: Lower and upper corner of the block (2, 3) [m].
        end_clearance: Required distance of the wire's ends from the block [m].
        wire: The wire, for its stiffness ratios and its curvature limit.
    """
    section, max_curvature = wire.stiffness_ratios, wire.max_curvature
    if reach < 1e-3:
        return None
    shapes = wires.shapes()
    for _ in range(4):
        nodes = np.linspace(-reach, reach, SLACK_NODES)
        start, end = heavy.slide_ends(shapes, np.broadcast_to(nodes, (len(wires), SLACK_NODES)))
        first = wires.frame[:, None] @ planar_pose(start)
        last = wires.frame[:, None] @ planar_pose(end)
        is_free = (box_distance(first[..., :3, 3], box) >= end_clearance) & (
            box_distance(last[..., :3, 3], box) >= end_clearance
        )
        lower, upper = _free_range(nodes, is_free)
        # at the mount and unmount stops the clamps have the distance and angles stated to the operator
        lower[[0, -1]] = upper[[0, -1]] = 0.0
        if _is_stable(wires, lower, section, max_curvature) and _is_stable(
            wires, upper, section, max_curvature
        ):
            return TableFreedom("slack", nodes, {arms[0]: first, arms[1]: last}, lower, upper)
        reach *= 0.5
    return None


def _free_range(nodes: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the first and the last node (N,) of the contiguous free nodes around the middle node, 0.

    Both are 0 if the middle node is not free.

    Args:
        nodes: Slides (n,) [m], with 0 in the middle.
        free: Whether each wire is free at each node (N, n).
    """
    middle = len(nodes) // 2
    up = np.cumprod(free[:, middle:], axis=1).sum(axis=1)
    down = np.cumprod(free[:, middle::-1], axis=1).sum(axis=1)
    return nodes[middle - np.maximum(down, 1) + 1], nodes[middle + np.maximum(up, 1) - 1]


def _is_stable(wires: WireSet, slide: FloatArray, section: StiffnessRatios, max_curvature: float) -> bool:
    """Return whether wires that slid along themselves by (N,) [m] are stable and not bent too sharply.

    Every `_STABILITY_STRIDE`-th wire is checked, with ten times the smallest stable margin.
    """
    sampled = wires[slice(0, None, _STABILITY_STRIDE)]
    shifted = heavy.slide(sampled.shapes(3), slide[::_STABILITY_STRIDE], 33)
    min_margin = min(float(shifted.margin_in_plane.min()), float(shifted.margin_out_of_plane(section).min()))
    return min_margin > 10.0 * MIN_STABLE_MARGIN and float(np.abs(shifted.curvature).max()) <= max_curvature
