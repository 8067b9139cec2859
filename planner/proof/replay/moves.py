"""Moves of one arm as arrays, the common time law of all arms, and sampling of straight moves.

The samples of a straight move are poses on the path, and joints on the branch that the targets name. The
time law states at which time a controller is at which position of a sequence of moves.

Model: Each move takes its programmed time at constant speed. A corner inside a zone is rounded by the cubic
that joins the two straight pieces with equal speeds on both sides, which is the quadratic Bezier curve of
the corner when the speeds are constant. Moves from and to a stop follow a cubic ramp that ends with the
speed of the adjacent move. The zone bounds how far from the corner the rounding starts, and it never starts
before the middle of a move. Both arms of a synchronised pair round over the same time. A real controller
has its own filters: within a zone it may deviate by a part of the rounding, which for dense targets is
micrometres. Outside zones the path is the straight line, as the manual states.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    dots,
    exp_rotation,
    from_parts,
    inverse,
    log_rotation,
)
from planner.programs.stages import TaskText
from planner.programs.steps import (
    MAX_EXTERNAL_VALUE,
    JointTarget,
    MoveStep,
    PassedTarget,
    RobTarget,
    StatusTarget,
    poses,
)
from planner.proof.kinematics import inverse_kinematics, offset_arm
from planner.proof.kinematics.arm_model import RobotMachine
from planner.proof.kinematics.inverse_kinematics import branch_of, solve, unwrapped_path


@dataclasses.dataclass(frozen=True)
class TimeLaw:
    """Progress of N moves over time.

    Attributes:
        times: Times (N + 1,) [s] of the nodes.
        rate_in: Speeds (N,) at the starts of the moves, relative to their mean speeds.
        rate_out: Speeds (N,) at the ends of the moves, relative to their mean speeds.
        window: Half widths (N + 1,) [s] of the rounding at each node, 0 at stops.
    """

    times: FloatArray
    rate_in: FloatArray
    rate_out: FloatArray
    window: FloatArray


def time_law(
    duration: FloatArray, length: FloatArray, stop: BoolArray, reach: FloatArray, min_window: FloatArray
) -> TimeLaw:
    """Return the time law of N moves: when each ends, and over which time each corner is rounded.

    Args:
        duration: Durations (N,) [s].
        length: Lengths (N,) of the moves in any common unit, to match speeds at ramps.
        stop: Whether the arms stop at the nodes (N + 1,). Node 0 is the start, node i the end of move i - 1.
        reach: Fractions (N + 1, 2), at each node, of the move before it and of the move after it, over which
            the zone allows the rounding to extend.
        min_window: Half width (N + 1,) [s] that the rounding at each node has at least, however small the
            zone. It corresponds to the path accuracy of the controller. A stop has no rounding.
    """
    count = len(duration)
    times = np.concatenate([[0.0], np.cumsum(duration)])
    rate_in, rate_out = end_rates(duration, length, stop)
    window = np.zeros(count + 1)
    # Half width: limit of the zone on both sides, at least ``min_window``, at most half the shorter move.
    inner = np.minimum(reach[1:-1, 0] * duration[:-1], reach[1:-1, 1] * duration[1:])
    inner = np.maximum(inner, min_window[1:-1])
    window[1:-1] = np.where(stop[1:-1], 0.0, np.minimum(inner, 0.5 * np.minimum(duration[:-1], duration[1:])))
    return TimeLaw(times, rate_in, rate_out, window)


def end_rates(duration: FloatArray, length: FloatArray, stop: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the speeds (N,) at the starts, and (N,) at the ends, of N moves, relative to their mean speeds.

    A move has the ratio 1 at both ends, except next to a stop: 0 at the stop, and at the other end the
    neighbour's speed, so that the ramp meets it. The arguments are those of :func:`time_law`.
    """
    # The ramp's end speed is limited to 1 to 2 times its own mean speed. A move between two stops ends at 0
    # on both sides.
    speed = length / duration
    rate_in, rate_out = np.ones(len(duration)), np.ones(len(duration))
    starts_at_stop, ends_at_stop = stop[:-1], stop[1:]
    next_ratio = np.concatenate([speed[1:], speed[-1:]]) / np.maximum(speed, 1e-12)
    previous_ratio = np.concatenate([speed[:1], speed[:-1]]) / np.maximum(speed, 1e-12)
    rate_in[starts_at_stop] = 0.0
    rate_out[ends_at_stop] = 0.0
    ramps_up, ramps_down = starts_at_stop & ~ends_at_stop, ends_at_stop & ~starts_at_stop
    rate_out[ramps_up] = np.clip(next_ratio[ramps_up], 1.0, 2.0)
    rate_in[ramps_down] = np.clip(previous_ratio[ramps_down], 1.0, 2.0)
    return rate_in, rate_out


CHORD_TOLERANCE = np.array([1e-6, 1e-5])
"""Tolerance [m], [rad] between the motion and a straight line from sample to sample.
Chosen: a tenth of :data:`PATH_ACCURACY_M` and of :data:`PATH_ACCURACY_RAD`.
"""


def corner_times(law: TimeLaw, deltas: Sequence[FloatArray], step: float) -> FloatArray:
    """Return additional times (C,) [s] at stops and corners, at which the replay adds poses between samples.

    A corner is included if a straight line between samples would cut it off by over ``CHORD_TOLERANCE``. A
    rounded corner gets positions on the rounding, so dense that lines between them deviate by no more.

    Bounds: If the velocity changes by v, a corner deviates from the line between samples by v step / 4, or by
    v step^2 / (16 h) if it is rounded over the time 2 h. The rounding deviates from the corner by v h / 4,
    and n lines along the rounding deviate from it by 1 / n^2 of that. The changes of velocity of corners
    within a step of each other are added.

    Args:
        law: Time law of N moves.
        deltas: Translation [m] and rotation [rad] (N, 6) of the moves of each arm.
        step: Time [s] between samples.
    """
    # Arrays per inner node, (N - 1,). deviation and rounding_deviation are in units of CHORD_TOLERANCE.
    duration, corners, half_widths = np.diff(law.times), law.times[1:-1], law.window[1:-1]
    # first to last - 1: the corners within a step of each corner.
    first = np.searchsorted(corners, corners - step, side="left")
    last = np.searchsorted(corners, corners + step, side="right")
    line = np.minimum(0.25 * step, step**2 / (16.0 * np.maximum(half_widths, 1e-9)))
    line = np.where(last - first > 1, 0.25 * step, line)
    deviation, rounding_deviation = np.zeros(len(corners)), np.zeros(len(corners))
    for delta in deltas:
        rates_before, rates_after = (rate / duration for rate in (law.rate_out, law.rate_in))
        change = rates_after[1:, None] * delta[1:] - rates_before[:-1, None] * delta[:-1]
        size = (np.linalg.norm(change.reshape(-1, 2, 3), axis=2) / CHORD_TOLERANCE).max(axis=1, initial=0.0)
        summed = np.append(0.0, np.cumsum(size))
        deviation = np.maximum(deviation, (summed[last] - summed[first]) * line)
        rounding_deviation = np.maximum(rounding_deviation, 0.25 * size * half_widths)
    stops = (law.rate_out[:-1] == 0.0) & (law.rate_in[1:] == 0.0)
    nodes = np.flatnonzero((deviation > 1.0) | stops)
    # n lines along a rounding deviate by (deviation of the rounding) / n^2, which must be at most 1
    # tolerance.
    count = 2 * np.ceil(0.5 * np.sqrt(rounding_deviation[nodes])).astype(np.int64)
    node, lines = np.repeat(nodes, count + 1), np.repeat(count, count + 1)
    line_index = np.arange(len(node)) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    positions = np.where(lines > 0, 2.0 * line_index / np.maximum(lines, 1) - 1.0, 0.0)
    return np.asarray(corners[node] + positions * half_widths[node])


def offsets(law: TimeLaw, delta: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return positions at times ``at`` (S,) on N moves with steps ``delta`` (N, D) from node to node.

    The caller adds the offset to the node, as joints, as a track position, or as a translation and rotation.

    Returns:
        Index (S,) of a node, 0 to N, and offset (S, D) from it, in the units of ``delta``. The node is the
        end of the current move, or the corner that is being rounded.
    """
    count = len(delta)
    move = np.clip(np.searchsorted(law.times, at, side="right") - 1, 0, count - 1)
    progress, _ = _progress(law, move, at - law.times[move])
    node = move + 1
    xi = (progress - 1.0)[:, None] * delta[move]
    nearest = np.where(law.times[node] - at < at - law.times[move], node, move)
    inside = np.abs(at - law.times[nearest]) < law.window[nearest]
    if np.any(inside):
        corner = nearest[inside]
        xi[inside] = _rounding_offsets(law, delta, corner, at[inside])
        node[inside] = corner
    return node, xi


def _rounding_offsets(law: TimeLaw, delta: FloatArray, corner: IntArray, at: FloatArray) -> FloatArray:
    """Return offsets (S, D) from nodes ``corner`` (S,) at times ``at`` (S,) on their roundings.

    A rounding is the cubic with the positions and velocities of both of its ends.
    """
    half = law.window[corner]
    progress_before, rate_before = _progress(
        law, corner - 1, law.times[corner] - half - law.times[corner - 1]
    )
    progress_after, rate_after = _progress(law, corner, half)
    a, b = (progress_before - 1.0)[:, None] * delta[corner - 1], progress_after[:, None] * delta[corner]
    va, vb = rate_before[:, None] * delta[corner - 1], rate_after[:, None] * delta[corner]
    # cubic Hermite over span = 2 half from a, va to b, vb:
    # (1 - s)^2 (1 + 2 s) a + s^2 (3 - 2 s) b + s (1 - s) span ((1 - s) va - s vb)
    span = 2.0 * half
    s = ((at - law.times[corner] + half) / span)[:, None]
    rest = 1.0 - s
    span = span[:, None]
    return np.asarray(
        rest * rest * (1.0 + 2.0 * s) * a
        + s * s * (3.0 - 2.0 * s) * b
        + s * rest * span * (rest * va - s * vb)
    )


def _progress(law: TimeLaw, move: IntArray, elapsed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the progress (S,) from 0 to 1 of moves, and its rate (S,) [1/s].

    The progress over time is the cubic with the end rates of the time law.

    Args:
        law: Time law of N moves.
        move: Index (S,) of the move.
        elapsed: Time (S,) [s] since the start of the move.
    """
    duration = law.times[move + 1] - law.times[move]
    x = np.clip(elapsed / duration, 0.0, 1.0)
    a, b = law.rate_in[move], law.rate_out[move]
    # p(x) = x (a + x (c2 + x c3)) with p(0) = 0, p(1) = 1, p'(0) = a, p'(1) = b.
    c2, c3 = 3.0 - 2.0 * a - b, a + b - 2.0
    return x * (a + x * (c2 + x * c3)), (a + x * (2.0 * c2 + 3.0 * c3 * x)) / duration


@dataclasses.dataclass(frozen=True)
class TrackMotion:
    """Motion of the base of an arm on a coordinated track.

    Attributes:
        axis: Unit vector (3,) of the track in the world.
        column: Index of its value among the external axes of targets.
        scale: Factor from the value to [m].
        station: Position [m] from which the motion is counted.
    """

    axis: FloatArray
    column: int
    scale: float
    station: float

    def base_positions(
        self, moves: Sequence[MoveStep], previous: float, works: bool
    ) -> tuple[FloatArray, bool]:
        """Return the base positions before N moves and after each.

        An arm works from its first straight move of a setup on. Before that its base stays at the station.
        A move whose target does not name the axis leaves the base where it is.

        Args:
            moves: The moves.
            previous: Distance [m] of the base from the station before the moves.
            works: Whether the arm has moved straight before these moves.

        Returns:
            Distances (N + 1,) [m] from the station, and whether the arm works after the moves.
        """
        out = [previous]
        for move in moves:
            works |= not move.by_joints
            value = float(move.target.external[self.column])
            if abs(value) >= MAX_EXTERNAL_VALUE:  # the axis is missing, which verify.external_axes reports
                out.append(out[-1])
                continue
            out.append(self.scale * value - self.station if works else 0.0)
        return np.array(out), works


_ROTATION_WEIGHT_M_RAD = 0.3
"""Weight [m/rad] of rotation against translation where speeds at ramps are matched."""
_MAX_CORNER_FRACTION = 0.5
"""Maximum fraction of a move that a corner takes."""
PATH_ACCURACY_M = 1e-5
"""Path accuracy [m] within which a corner is rounded even without a zone.
Chosen: a tenth of the path repeatability that ABB states.
"""
PATH_ACCURACY_RAD = 1e-4
"""Angular path accuracy [rad] within which a corner is rounded even without a zone."""


@dataclasses.dataclass(frozen=True)
class ArmMoves:
    """N moves of one arm in a stage.

    Poses are in the world, unless the flange of another arm carries the work object. Then they are in the
    frame of the carried work object, in which the moves are straight.

    Attributes:
        task: Task of the arm.
        moves: The moves.
        robot: Kinematics of the arm.
        base: Base pose (4, 4) in the world, at the station of a coordinated track.
        tool: TCP (N, 4, 4) in the flange.
        joint: Whether the moves are joint moves (N,).
        pose: Targets (N, 4, 4) as TCP poses.
        q: Targets (N, 6) [rad] as serial joint angles, NaN for targets that are poses only.
        conf: Confdata (N, 4) of the targets: quadrants of axes 1, 4 and 6, and the branch. 0 without.
        named: Whether the targets have confdata (N,).
        carrier: Name of the arm that carries the work object, None if none does.
        carrier_frame: Frame (4, 4) of the work object in the flange of the carrier.
        track_position: Distance (N + 1,) [m] of the base on its track before the moves and after each.
        track_direction: Unit vector (3,) of the coordinated track. The base moves by the tool's time law.
        rates: Joint velocities (N, J) [rad/s] at the targets of a trajectory-driven arm, which are all
            joints.
    """

    task: TaskText
    moves: tuple[MoveStep, ...]
    robot: RobotMachine
    base: FloatArray
    tool: FloatArray
    joint: BoolArray
    pose: FloatArray
    q: FloatArray
    conf: IntArray
    named: BoolArray
    carrier: str | None
    carrier_frame: FloatArray
    track_position: FloatArray | None = None
    track_direction: FloatArray | None = None
    rates: FloatArray | None = None

    def tcp(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (..., 4, 4) in the world at joints (..., 6) before the first move."""
        return np.asarray(self.base_after(0) @ self.robot.flange(q) @ self.tool[0])

    def base_at(self, track_position: FloatArray) -> FloatArray:
        """Return the base poses (..., 4, 4) at distances (...,) [m] along the track."""
        if self.track_direction is None:
            return self.base
        out = np.array(np.broadcast_to(self.base, (*track_position.shape, 4, 4)))
        out[..., :3, 3] += track_position[..., None] * self.track_direction
        return out

    def base_after(self, node: int | slice) -> FloatArray:
        """Return base poses at nodes: 0 is before the first move, i (1 to N) is after move i - 1.

        They are (M, 4, 4) for a slice of M nodes on a coordinated track. Otherwise there is one pose (4, 4).
        """
        return (
            self.base if self.track_position is None else self.base_at(np.asarray(self.track_position[node]))
        )

    def base_at_times(self, law: TimeLaw, a: int, b: int, when: FloatArray) -> FloatArray:
        """Return the base pose at times ``when`` (S,) of the moves a to b - 1.

        It is (4, 4), or (S, 4, 4) on a coordinated track. ``law`` is the time law of these moves.
        """
        return (
            self.base
            if self.track_position is None
            else self.base_at(self.track_positions_at(law, a, b, when))
        )

    def track_positions_at(self, law: TimeLaw, a: int, b: int, when: FloatArray) -> FloatArray:
        """Return the distances (S,) [m] of the base from its station at times ``when`` (S,).

        The arguments are those of :meth:`base_at_times`. The distances are 0 without a coordinated track.
        """
        if self.track_position is None:
            return np.zeros(len(when))
        nodes = self.track_position[a : b + 1, None]
        node, xi = offsets(law, np.diff(nodes, axis=0), when)
        return np.asarray((nodes[node] + xi)[:, 0])

    def flange_poses(self) -> FloatArray:
        """Return the flange poses (N, 4, 4) in the world at the targets.

        They are defined only if no arm carries the work object. Targets of joint moves follow from joints.
        """
        out = self.pose @ inverse(self.tool)
        base = np.broadcast_to(self.base_after(slice(1, None)), out.shape)
        out[self.joint] = base[self.joint] @ self.robot.flange(self.q[self.joint])
        return np.asarray(out)


def arm_moves(
    task: TaskText,
    moves: tuple[MoveStep, ...],
    machine: RobotMachine,
    base: FloatArray,
    units: Mapping[str, str],
    track: tuple[FloatArray, FloatArray] | None = None,
) -> ArmMoves:
    """Return the moves of one arm as arrays, from which the replay computes its motion.

    Moves in several moving frames, or in one and in the world, are a fault that ``verify.held_frame``
    reports. They are taken as if all frames were fixed.

    Args:
        task: Task of the arm.
        moves: Its moves.
        machine: Kinematics of the arm.
        base: Base pose (4, 4) in the world.
        units: {mechanical unit in lower case: arm} of the other arms.
        track: Distances (N + 1,) [m] and direction (3,) of the base on a coordinated track.
    """
    count = len(moves)
    straight = [move for move in moves if not move.by_joints]
    # Arms that carry the work objects of straight moves. Only if it is exactly one, the work is carried.
    carriers = {None if move.wobj.fixed else units.get(move.wobj.unit.lower()) for move in straight}
    carrier = carriers.pop() if len(carriers) == 1 else None
    joint = np.array([move.by_joints for move in moves])
    position, quaternion = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    conf = np.zeros((count, 4), dtype=np.int64)
    named = np.zeros(count, dtype=bool)
    axes = machine.data.axes
    q = np.full((count, axes), np.nan)
    rates = np.zeros((count, axes)) if task.text.is_trajectory else None
    work_frames: dict[int, FloatArray] = {}  # by the identity of the work object
    frame = np.zeros((count, 4, 4))
    tool = np.zeros((count, 4, 4))
    for i, move in enumerate(moves):
        tool[i] = move.tool.pose
        key = id(move.wobj)
        if key not in work_frames:
            work_frames[key] = move.wobj.user @ move.wobj.object
        frame[i] = work_frames[key]
        match move.target:
            case RobTarget(position=target_position, quaternion=target_quaternion, conf=stated):
                position[i], quaternion[i], named[i] = target_position, target_quaternion, stated is not None
                conf[i] = conf[i] if stated is None else stated
            case StatusTarget():
                q[i] = selected_joints(move, machine, base)
            case JointTarget(joints=values):
                q[i] = machine.data.from_controller(values)
            case PassedTarget(joints=values, rates=rate):
                q[i] = values
                if rates is not None:
                    rates[i] = rate
    # argmin of the flags is the first straight move.
    carrier_frame = np.eye(4) if carrier is None else frame[int(np.argmin(joint))]
    pose = (
        (np.linalg.inv(carrier_frame) if carrier is not None else np.eye(4))
        @ frame
        @ poses(position, quaternion)
    )
    track_position, axis = (None, None) if track is None else track
    result = ArmMoves(
        task,
        moves,
        machine,
        base,
        tool,
        joint,
        pose,
        q,
        conf,
        named,
        carrier,
        carrier_frame,
        track_position,
        axis,
        rates,
    )
    # Poses of joint targets follow from the joints. They are written into the array of the result.
    if rates is not None:
        pose[:] = base @ machine.flange(q) @ tool
    elif carrier is None:
        bases = np.broadcast_to(result.base_after(slice(1, None)), pose.shape)
        pose[joint] = bases[joint] @ machine.flange(q[joint]) @ tool[joint]
    return result


def selected_joints(move: MoveStep, machine: RobotMachine, base: FloatArray) -> FloatArray:
    """Return the joints (6,) [rad, serial] that Status and Turn select for a move's target.

    NaN if they select none or more than one. ``base`` (4, 4) is in the world.
    """
    selected = status_solutions(move, machine, base)
    return np.asarray(selected.q[0]) if len(selected.q) == 1 else np.full(6, np.nan)


def status_solutions(
    move: MoveStep, machine: RobotMachine, base: FloatArray
) -> inverse_kinematics.StatusSolutions:
    """Return all solutions that KUKA's Status and Turn select for a move's target in KRL.

    Other targets have none. ``base`` (4, 4) is in the world.
    """
    target = move.target
    if not isinstance(target, StatusTarget):
        return inverse_kinematics.StatusSolutions(np.zeros((0, 6)), ())
    return inverse_kinematics.select_by_status(machine, flange_at(move, base), target.status, target.turn)


def flange_at(move: MoveStep, base: FloatArray) -> FloatArray:
    """Return the flange pose (4, 4) in the base at a move's target, NaN if the target is joints.

    The work object must be fixed. ``base`` (4, 4) is in the world.
    """
    target = move.target
    if isinstance(target, JointTarget | PassedTarget):
        return np.full((4, 4), np.nan)
    pose = move.wobj.user @ move.wobj.object @ poses(target.position, target.quaternion)
    return np.asarray(inverse(base) @ pose @ inverse(move.tool.pose))


def trajectory_time_law(rows: Sequence[ArmMoves]) -> TimeLaw:
    """Return the time law of trajectory-driven moves.

    Each move takes its stated time, which is equal for all arms, and no corner is rounded.
    """
    count = len(rows[0].moves)
    durations = np.max([[move.time or 0.0 for move in row.moves] for row in rows], axis=0)
    times = np.concatenate([[0.0], np.cumsum(np.maximum(durations, 1e-4))])
    return TimeLaw(times, np.ones(count), np.ones(count), np.zeros(count + 1))


def trajectory_joints(law: TimeLaw, start: FloatArray, row: ArmMoves, when: FloatArray) -> FloatArray:
    """Return the joints (S, J) [rad] at times ``when`` (S,) of trajectory-driven moves.

    The moves start from rest at ``start`` (J,). Each move is the cubic with the positions and velocities of
    its two ends, which is the controller's interpolation, too.
    """
    if row.rates is None:
        raise TypeError("the moves have no velocities at their targets")
    move = np.clip(np.searchsorted(law.times, when, side="left") - 1, 0, len(row.moves) - 1)
    q = np.concatenate([start[None], row.q])
    v = np.concatenate([np.zeros((1, q.shape[1])), row.rates])
    span = np.diff(law.times)[move][:, None]
    fraction = (when - law.times[move])[:, None] / span
    return hermite(q[move], q[move + 1], v[move], v[move + 1], span, fraction)


def hermite(
    a: FloatArray, b: FloatArray, va: FloatArray, vb: FloatArray, span: FloatArray, fraction: FloatArray
) -> FloatArray:
    """Evaluate cubic Hermite curves.

    Args:
        a: Joints (..., J) at the start.
        b: Joints (..., J) at the end.
        va: Joint velocities (..., J) at the start.
        vb: Joint velocities (..., J) at the end.
        span: Duration (..., 1) [s].
        fraction: Fraction (..., 1) of the duration.
    """
    # a + s^2 (3 - 2 s) (b - a) + s (1 - s) span ((1 - s) va - s vb)
    chord = a + fraction**2 * (3.0 - 2.0 * fraction) * (b - a)
    return np.asarray(chord + span * fraction * (1.0 - fraction) * ((1.0 - fraction) * va - fraction * vb))


def trajectory_knots(
    robot: RobotData, moves: Sequence[MoveStep], start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return joints and joint velocities, (N + 1, J) each, before and after N trajectory-driven moves.

    The moves start from rest at ``start`` (J,).
    """
    q, v = [start], [np.zeros(robot.axes)]
    for move in moves:
        match move.target:
            case PassedTarget(joints=values, rates=rates):
                q.append(values)
                v.append(rates)
            case JointTarget(joints=values):
                q.append(robot.from_controller(values))
                v.append(np.zeros(robot.axes))
            case _:
                raise TypeError("trajectories have no such target")
    return np.array(q), np.array(v)


def arms_time_law(
    rows: Sequence[ArmMoves], starts: Sequence[FloatArray], joints: Sequence[FloatArray], stop: BoolArray
) -> tuple[TimeLaw, tuple[FloatArray, ...]]:
    """Return the time law on which the moves of all arms run, and the steps of each arm.

    The slowest arm determines the time of each move, and the smallest zone determines the rounding.

    Args:
        rows: Moves of each arm.
        starts: TCP (4, 4) of each arm before the moves, in the frame of its poses.
        joints: Joints (6,) [rad] of each arm before the moves.
        stop: Whether the arms stop at the nodes (N + 1,).

    Returns:
        Time law, and translation [m] and rotation vector [rad] (N, 6) of each arm's moves.
    """
    count = len(rows[0].moves)
    duration, length = np.zeros(count), np.zeros(count)
    reach = np.full((count + 1, 2), _MAX_CORNER_FRACTION)
    # Steps (N, D) of each arm with the accuracy of a corner: translation and rotation in turn, and tracks.
    deltas: list[tuple[FloatArray, float]] = []
    track_deltas: list[tuple[FloatArray, float]] = []
    for row, start, q in zip(rows, starts, joints, strict=True):
        previous = np.concatenate([start[None], row.pose[:-1]])
        shift = row.pose[:, :3, 3] - previous[:, :3, 3]
        rotation = log_rotation(np.swapaxes(previous[:, :3, :3], 1, 2) @ row.pose[:, :3, :3])
        step, angle_change = np.linalg.norm(shift, axis=1), np.linalg.norm(rotation, axis=1)
        deltas += [(shift, PATH_ACCURACY_M), (rotation, PATH_ACCURACY_RAD)]
        length = np.hypot(length, np.hypot(step, _ROTATION_WEIGHT_M_RAD * angle_change))
        duration = np.maximum(duration, _move_durations(row, q, step, angle_change))
        zone = np.array([0.0 if move.zone.fine else move.zone.tcp for move in row.moves])
        zone_angle = np.array([0.0 if move.zone.fine else move.zone.turn_angle for move in row.moves])
        reach[1:, 0] = np.minimum(reach[1:, 0], _zone_fraction(zone, zone_angle, step, angle_change))
        reach[1:-1, 1] = np.minimum(
            reach[1:-1, 1], _zone_fraction(zone[:-1], zone_angle[:-1], step[1:], angle_change[1:])
        )
        if row.track_position is not None:  # zones bound the track's path, too
            # On a straight tool path the arm has a corner where the track's fraction of it changes.
            track_deltas.append((np.column_stack([shift, np.diff(row.track_position)]), PATH_ACCURACY_M))
            track_path, no_rotation = np.abs(np.diff(row.track_position)), np.zeros(count)
            linear = np.array([0.0 if move.zone.fine else move.zone.linear for move in row.moves])
            reach[1:, 0] = np.minimum(
                reach[1:, 0], _zone_fraction(linear, no_rotation, track_path, no_rotation)
            )
            reach[1:-1, 1] = np.minimum(
                reach[1:-1, 1], _zone_fraction(linear[:-1], no_rotation[1:], track_path[1:], no_rotation[1:])
            )
    duration = np.maximum(duration, 1e-4)
    min_window = np.full(count + 1, np.inf)
    rate_in, rate_out = end_rates(duration, length, stop)
    for delta, accuracy in deltas + track_deltas:
        # A rounding of half width h deviates from the corner by h |change of speed| / 4.
        speed = delta / duration[:, None]
        change = _lateral_velocity_change(rate_out[:-1, None] * speed[:-1], rate_in[1:, None] * speed[1:])
        min_window[1:-1] = np.minimum(min_window[1:-1], 4.0 * accuracy / np.maximum(change, 1e-12))
    law = time_law(duration, length, stop, np.clip(reach, 0.0, _MAX_CORNER_FRACTION), min_window)
    path_deltas, rotation_deltas = deltas[::2], deltas[1::2]  # they alternate
    return law, tuple(
        np.concatenate([a, b], axis=1) for (a, _), (b, _) in zip(path_deltas, rotation_deltas, strict=True)
    )


def _move_durations(row: ArmMoves, start: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    r"""Return the duration (N,) [s] of each move.

    It is \T if the text states it. Otherwise it follows from the stated speed. A joint move without \T also
    takes at least the time that its joints need from stop to stop within their limits, plus 2 %.

    Args:
        row: N moves of the arm.
        start: Joints (J,) [rad] before the moves.
        step: Length (N,) [m] of the TCP's path in each move.
        turn: Angle (N,) [rad] by which the tool rotates in each move.
    """
    out = np.zeros(len(row.moves))
    for i, move in enumerate(row.moves):
        if move.time is not None:
            out[i] = move.time
            continue
        tcp = move.velocity if move.velocity is not None else move.speed.tcp
        out[i] = max(step[i] / max(tcp, 1e-6), turn[i] / max(move.speed.turn, 1e-6))
        if row.joint[i]:
            start_joints = row.q[i - 1] if i and row.joint[i - 1] else _joints_after_straight(row, i, start)
            # A cubic from stop to stop over T has the peak speed 1.5 |dq| / T and acceleration 6 |dq| / T^2.
            change = np.abs(row.q[i] - start_joints)
            ramps = np.sqrt(6.0 * change / row.robot.data.acceleration)
            axis_fraction = np.ones(6) if move.speed.axes is None else np.array(move.speed.axes)
            max_speed = axis_fraction * row.robot.data.velocity
            out[i] = max(out[i], float(np.max(1.5 * change / max_speed)), float(ramps.max()))
            out[i] *= 1.02  # keeps the controller's own ramps inside the limits
    return out


def _joints_after_straight(row: ArmMoves, i: int, start: FloatArray) -> FloatArray:
    """Return the joints (6,) [rad] at which joint move ``i`` starts, after the straight moves before it.

    They determine how long the joint move takes. If there are no straight moves, or if their end cannot be
    computed, the result is the joints before the straight moves. ``start`` (6,) are the joints before all
    moves.
    """
    joint_moves = np.flatnonzero(row.joint[:i])
    first = int(joint_moves[-1]) + 1 if len(joint_moves) else 0
    start_joints = row.q[first - 1] if first else start
    if first == i or row.carrier is not None or not np.isfinite(start_joints).all():
        return start_joints
    # is_followed: an arm with an offset wrist. Its joints are followed at intermediate positions of each
    # straight move, because its targets name no branch.
    if row.robot.is_followed:
        fractions = np.arange(1, _POSITIONS_PER_MOVE + 1) / _POSITIONS_PER_MOVE
        ends = np.concatenate([row.tcp(start_joints[None]), row.pose[first:i]])
        rotation_vectors = log_rotation(np.swapaxes(ends[:-1, :3, :3], 1, 2) @ ends[1:, :3, :3])[:, None]
        positions = ends[:-1, None, :3, 3] + fractions[:, None] * np.diff(ends[:, :3, 3], axis=0)[:, None]
        rotation = ends[:-1, None, :3, :3] @ exp_rotation(fractions[:, None] * rotation_vectors)
        path = from_parts(rotation, positions).reshape(-1, 4, 4)
        tools = np.repeat(inverse(row.tool[first:i]), _POSITIONS_PER_MOVE, axis=0)
        base = row.base
        if row.track_position is not None:
            step = np.diff(row.track_position[first : i + 1])[:, None]
            base = row.base_at((row.track_position[first:i, None] + fractions * step).ravel())
        q = offset_arm.follow(row.robot.chain, inverse(base) @ path @ tools, start_joints)[-1]
        return np.asarray(q if np.isfinite(q).all() else start_joints)
    straight = slice(first, i)
    start_branch = np.full(i - first, branch_of(row.robot, start_joints), dtype=np.int64)
    branch = np.where(row.named[straight], row.conf[straight, 3], start_branch)
    base = row.base_after(slice(first + 1, i + 1))
    flange = inverse(base) @ row.pose[straight] @ inverse(row.tool[straight])
    q = unwrapped_path(row.robot, solve(row.robot, flange, branch), start_joints)[-1]
    return np.asarray(q if np.isfinite(q).all() else start_joints)


_POSITIONS_PER_MOVE: Final = 20
"""Number of positions of a straight move at which an arm with an offset wrist is followed."""


def _lateral_velocity_change(previous: FloatArray, following: FloatArray) -> FloatArray:
    """Return the size (M,) of the velocity change from ``previous`` to ``following`` (M, D) across the path.

    A rounded corner deviates from the path in proportion to it. A change along the path causes no deviation.
    If the motion reverses, or stands still before or after, the full change counts.
    """
    # Component of the faster velocity normal to the slower one: |previous ^ following| / smaller speed.
    speeds = np.maximum(
        np.stack([np.linalg.norm(previous, axis=1), np.linalg.norm(following, axis=1)]), 1e-12
    )
    along = dots(previous, following)
    full_change = np.linalg.norm(following - previous, axis=1)
    pairs = list(itertools.combinations(range(previous.shape[1]), 2))[::-1]
    wedge = [previous[:, i] * following[:, j] - previous[:, j] * following[:, i] for i, j in pairs]
    cross = np.linalg.norm(np.stack(wedge, axis=1), axis=1)  # the cross product for D = 3
    across = cross / speeds.min(axis=0)
    is_still = speeds.min(axis=0) < 1e-9
    return np.asarray(np.where((along < 0.0) | is_still, full_change, np.minimum(across, full_change)))


def _zone_fraction(zone: FloatArray, angle: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    """Return the fraction (M,) of each move over which a zone allows the corner to be rounded.

    It is the size of the ``zone`` [m] divided by the path ``step`` [m]. If the TCP moves by at most 0.01 mm,
    it is the ``angle`` [rad] of the zone divided by the rotation ``turn`` [rad].
    """
    by_rotation = np.where(turn > 1e-6, angle / np.maximum(turn, 1e-6), _MAX_CORNER_FRACTION)
    return np.where(step > 1e-5, zone / np.maximum(step, 1e-5), by_rotation)


SAMPLES_PER_BATCH = 32_768
"""Number of samples per batch."""


def batches(first: int, last: int) -> Iterator[slice]:
    """Yield the samples ``first`` to ``last`` - 1 as slices, because intermediate values need much memory."""
    for start in range(first, last, SAMPLES_PER_BATCH):
        yield slice(start, min(start + SAMPLES_PER_BATCH, last))


def nodes_and_steps(row: ArmMoves, a: int, b: int, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the nodes and steps of the N straight moves ``a`` to ``b`` - 1, from which their poses follow.

    Args:
        row: All moves of the arm.
        a: Index of the first move.
        b: Index after that of the last move.
        start: TCP (4, 4) before the moves, in the frame of their poses.

    Returns:
        Poses (N + 1, 4, 4) in the same frame, and translation [m] and rotation vector [rad] (N, 6) of each
        move.
    """
    nodes = np.concatenate([start[None], row.pose[a:b]])
    rotation = log_rotation(np.swapaxes(nodes[:-1, :3, :3], 1, 2) @ nodes[1:, :3, :3])
    return nodes, np.concatenate([np.diff(nodes[:, :3, 3], axis=0), rotation], axis=1)


def path_poses(law: TimeLaw, nodes: FloatArray, delta: FloatArray, when: FloatArray) -> FloatArray:
    """Return the TCP poses (S, 4, 4) at times ``when`` (S,) on straight moves, in the frame of their poses.

    Nodes and steps are as :func:`nodes_and_steps` returns them.
    """
    at_node, xi = offsets(law, delta, when)
    rotation = nodes[at_node, :3, :3] @ exp_rotation(xi[:, 3:])
    return from_parts(rotation, nodes[at_node, :3, 3] + xi[:, :3])


def path_branches(row: ArmMoves, a: int, b: int, start_joints: FloatArray) -> IntArray:
    """Return the branch (N,) of each of the straight moves ``a`` to ``b`` - 1.

    It is that of the targets' confdata if all targets have confdata and the arm has no parallel rods.
    Otherwise it is the branch of ``start_joints`` (6,), the joints at which the moves start.
    """
    if row.robot.data.coupling is None and row.named[a:b].all():
        return np.asarray(row.conf[a:b, 3])
    # KRL and URScript name no branch here, and the meaning of cfx of parallel-rod arms is not certain, so the
    # arm keeps its branch.
    return np.full(b - a, inverse_kinematics.branch_of(row.robot, start_joints), dtype=np.int64)


@dataclasses.dataclass(frozen=True)
class StraightPath:
    """Path of N successive straight moves of one arm.

    Attributes:
        row: All moves of the arm.
        law: Time law of the straight moves.
        first: Index of the first straight move among the moves of the arm.
        branch: Branch (N,) of the target of each straight move.
    """

    row: ArmMoves
    law: TimeLaw
    first: int
    branch: IntArray


def path_joints(
    straight: StraightPath, start_joints: FloatArray, when: FloatArray, tcp: FloatArray
) -> FloatArray:
    """Return the joints (S, 6) [rad] on straight moves, NaN where the arm does not reach the path.

    For an arm with an offset wrist they continue from the joints before. For other arms they are on the
    branch of the current move.

    Args:
        straight: Path of the moves.
        start_joints: Joints (6,) [rad] at the previous time, from which the joints continue without jumps by
            whole turns.
        when: Times (S,) [s].
        tcp: TCP poses (S, 4, 4) in the world.
    """
    row, law, a, branch = straight.row, straight.law, straight.first, straight.branch
    move = np.clip(np.searchsorted(law.times, when, side="left") - 1, 0, len(branch) - 1)
    base = row.base_at_times(law, a, a + len(branch), when)
    flange = inverse(base) @ tcp @ inverse(row.tool[a + move])
    if row.robot.is_followed:
        return offset_arm.follow(row.robot.chain, flange, start_joints)
    q = inverse_kinematics.solve(row.robot, flange, branch[move])
    return inverse_kinematics.unwrapped_path(row.robot, q, start_joints)
