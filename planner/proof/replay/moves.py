"""Moves of one arm as arrays, the time law that the moves of all arms give, straight moves sampled.

The samples of a straight move are poses on the way, and joints on the branch that the targets name.
The time law says which piece of a row of straight moves a controller runs through at which time.

Model. Each move takes its programmed time at constant speed; a corner inside a zone is rounded by
the cubic that joins the two straight pieces with equal speeds on both sides, which is the quadratic
Bezier curve of the corner when the speeds are constant; moves from and to a stop follow a cubic
ramp that ends with the speed of the neighbouring move. The zone bounds how far from the corner the
rounding starts, and it never starts before the middle of a move. Both arms of a synchronised pair
round over the same time. A real controller has its own filters: within a zone it may be off by a
part of the rounding, which for dense targets is micrometres; outside zones the path is the straight
line, as the manual says.
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
    MOST_OUTER,
    JointTarget,
    MoveStep,
    PassedTarget,
    RobTarget,
    StatusTarget,
    poses,
)
from planner.proof.kinematics import inverse_kinematics, offset_arm
from planner.proof.kinematics.arm_model import Machine
from planner.proof.kinematics.inverse_kinematics import branch_of, continued, solve


@dataclasses.dataclass(frozen=True)
class TimeLaw:
    """``times`` (N + 1,) [s] of the nodes, ``rate_in``, ``rate_out`` (N,) end speeds of the moves' progress
    in units of 1 / duration, ``window`` (N + 1,) [s] half width of the rounding at each node, 0 at stops."""

    times: FloatArray
    rate_in: FloatArray
    rate_out: FloatArray
    window: FloatArray


def time_law_of(
    duration: FloatArray, length: FloatArray, stop: BoolArray, reach: FloatArray, room: FloatArray
) -> TimeLaw:
    """The law for N moves.

    ``duration`` (N,) [s]; ``length`` (N,) of the moves in any one measure, to match speeds at ramps;
    ``stop`` (N + 1,) at nodes; ``reach`` (N + 1, 2): the largest fraction of the move before and of the move
    after each node that the zone lets the rounding take; ``room`` (N + 1,) [s]: a half width that is allowed
    at each node whatever the zone.
    """
    count = len(duration)
    times = np.concatenate([[0.0], np.cumsum(duration)])
    rate_in, rate_out = end_rates(duration, length, stop)
    window = np.zeros(count + 1)
    inner = np.minimum(reach[1:-1, 0] * duration[:-1], reach[1:-1, 1] * duration[1:])
    inner = np.maximum(inner, room[1:-1])
    window[1:-1] = np.where(stop[1:-1], 0.0, np.minimum(inner, 0.5 * np.minimum(duration[:-1], duration[1:])))
    return TimeLaw(times, rate_in, rate_out, window)


def end_rates(duration: FloatArray, length: FloatArray, stop: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Speeds (N,) in which N moves begin and end, of their means: as :func:`time_law_of` has them."""
    speed = length / duration
    rate_in, rate_out = np.ones(len(duration)), np.ones(len(duration))
    first, last = stop[:-1], stop[1:]
    ahead = np.concatenate([speed[1:], speed[-1:]]) / np.maximum(speed, 1e-12)
    behind = np.concatenate([speed[:1], speed[:-1]]) / np.maximum(speed, 1e-12)
    rate_in[first] = 0.0
    rate_out[last] = 0.0
    starts, ends = first & ~last, last & ~first
    rate_out[starts] = np.clip(ahead[starts], 1.0, 2.0)
    rate_in[ends] = np.clip(behind[ends], 1.0, 2.0)
    return rate_in, rate_out


CHORD_ERROR = np.array([1e-6, 1e-5])
"""How far [m], [rad] a straight line from sample to sample may be off the motion: a tenth of
:data:`ACCURACY` and of :data:`ACCURACY_TURN`."""


def corner_times(law: TimeLaw, deltas: Sequence[FloatArray], step: float) -> FloatArray:
    """Times (C,) [s] of stops, and at corners that a straight line between samples ``step`` [s] apart would
    cut off by more than ``CHORD_ERROR``: the corner, and where it is rounded places on the rounding so near
    to one another that lines between them are off by no more.

    ``deltas``: steps (N, 6) of each arm's moves, by way [m] and by turning [rad]. A corner at which the
    velocity changes by v is off the line by v step / 4, or where it is rounded over the time 2 h by
    v step^2 / 16 h; the rounding is v h / 4 off the corner, and n lines along it by an n^2-th of that.
    Corners that are within a step of each other count together.
    """
    duration, at, half = np.diff(law.times), law.times[1:-1], law.window[1:-1]
    first = np.searchsorted(at, at - step, side="left")
    last = np.searchsorted(at, at + step, side="right")
    line = np.minimum(0.25 * step, step**2 / (16.0 * np.maximum(half, 1e-9)))
    line = np.where(last - first > 1, 0.25 * step, line)
    off, stray = np.zeros(len(at)), np.zeros(len(at))
    for delta in deltas:
        before, after = (rate / duration for rate in (law.rate_out, law.rate_in))
        change = after[1:, None] * delta[1:] - before[:-1, None] * delta[:-1]
        size = (np.linalg.norm(change.reshape(-1, 2, 3), axis=2) / CHORD_ERROR).max(axis=1, initial=0.0)
        summed = np.append(0.0, np.cumsum(size))
        off = np.maximum(off, (summed[last] - summed[first]) * line)
        stray = np.maximum(stray, 0.25 * size * half)
    stops = (law.rate_out[:-1] == 0.0) & (law.rate_in[1:] == 0.0)
    nodes = np.flatnonzero((off > 1.0) | stops)
    count = 2 * np.ceil(0.5 * np.sqrt(stray[nodes])).astype(np.int64)
    node, lines = np.repeat(nodes, count + 1), np.repeat(count, count + 1)
    place = np.arange(len(node)) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)
    share = np.where(lines > 0, 2.0 * place / np.maximum(lines, 1) - 1.0, 0.0)
    return np.asarray(at[node] + share * half[node])


def offsets(law: TimeLaw, delta: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nodes (S,) and offsets (S, D) from them at times ``at`` (S,), for moves that step by ``delta`` (N,
    D)."""
    count = len(delta)
    move = np.clip(np.searchsorted(law.times, at, side="right") - 1, 0, count - 1)
    progress, _ = _progress(law, move, at - law.times[move])
    node = move + 1
    xi = (progress - 1.0)[:, None] * delta[move]
    nearest = np.where(law.times[node] - at < at - law.times[move], node, move)
    inside = np.abs(at - law.times[nearest]) < law.window[nearest]
    if np.any(inside):
        corner = nearest[inside]
        xi[inside] = _rounded(law, delta, corner, at[inside])
        node[inside] = corner
    return node, xi


def _rounded(law: TimeLaw, delta: FloatArray, corner: IntArray, at: FloatArray) -> FloatArray:
    half = law.window[corner]
    before, rate_before = _progress(law, corner - 1, law.times[corner] - half - law.times[corner - 1])
    after, rate_after = _progress(law, corner, half)
    a, b = (before - 1.0)[:, None] * delta[corner - 1], after[:, None] * delta[corner]
    va, vb = rate_before[:, None] * delta[corner - 1], rate_after[:, None] * delta[corner]
    span = 2.0 * half
    s = ((at - law.times[corner] + half) / span)[:, None]
    one = 1.0 - s
    span = span[:, None]
    return np.asarray(
        one * one * (1.0 + 2.0 * s) * a + s * s * (3.0 - 2.0 * s) * b + s * one * span * (one * va - s * vb)
    )


def _progress(law: TimeLaw, move: IntArray, elapsed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Progress 0..1 of moves and its rate [1/s]: the cubic with the moves' end rates."""
    duration = law.times[move + 1] - law.times[move]
    x = np.clip(elapsed / duration, 0.0, 1.0)
    a, b = law.rate_in[move], law.rate_out[move]
    c2, c3 = 3.0 - 2.0 * a - b, a + b - 2.0
    return x * (a + x * (c2 + x * c3)), (a + x * (2.0 * c2 + 3.0 * c3 * x)) / duration


@dataclasses.dataclass(frozen=True)
class Riding:
    """How the base of an arm rides while it works: along the unit vector ``axis`` (3,) of the world, by the
    value in ``column`` of external axes times ``scale`` [m], counted from the ``station`` [m]."""

    axis: FloatArray
    column: int
    scale: float
    station: float

    def gone(self, moves: Sequence[MoveStep], before: float, works: bool) -> tuple[FloatArray, bool]:
        """How far (N + 1,) [m] the base is from its station before N moves, where it is ``before`` [m], and
        behind each; a move by joints takes it there before it ``works``, as the arm goes straight. And
        whether it works behind them."""
        out = [before]
        for move in moves:
            works |= not move.by_joints
            value = float(move.target.external[self.column])
            if abs(value) >= MOST_OUTER:  # none, which verify.external_axes tells
                out.append(out[-1])
                continue
            out.append(self.scale * value - self.station if works else 0.0)
        return np.array(out), works


_ARM_LENGTH = 0.3
"""Weight [m/rad] of turning against moving where speeds at ramps are matched."""
_MOST_CORNER_SHARE = 0.5
"""Share of a move that a corner takes at most."""
ACCURACY = 1e-5
"""Path accuracy [m] that a corner is rounded within even without a zone; a tenth of what ABB states for path
repeatability."""
ACCURACY_TURN = 1e-4
"""The same for turning [rad]."""


@dataclasses.dataclass(frozen=True)
class Row:
    """N moves of one arm in a stage: which are ``joint`` moves (N,), targets as TCP ``pose`` (N, 4, 4) and as
    ``q`` (N, 6) where they are joints, ``conf`` (N, 4) of those that are ``named`` (N,) by confdata, ``tool``
    (N, 4, 4), ``base`` (4, 4), from which it has ``gone`` (N + 1,) [m] along ``axis`` (3,) before the moves
    and behind each, where it rides; it goes as evenly as the tool does.

    ``rates`` (N, J) [rad/s]: of an arm that is driven by trajectories the velocities at its targets, which
    are all joints.

    Poses are in the world, unless the flange of arm ``carrier`` carries the work object: then they are in the
    frame that lies at ``ride`` (4, 4) in that flange, and the moves are straight in it."""

    task: TaskText
    moves: tuple[MoveStep, ...]
    robot: Machine
    base: FloatArray
    tool: FloatArray
    joint: BoolArray
    pose: FloatArray
    q: FloatArray
    conf: IntArray
    named: BoolArray
    carrier: str | None
    ride: FloatArray
    gone: FloatArray | None = None
    axis: FloatArray | None = None
    rates: FloatArray | None = None

    def tcp(self, q: FloatArray) -> FloatArray:
        """TCP poses (..., 4, 4) in the world of joints (..., 6) before the first move, with its tool."""
        return np.asarray(self.base_behind(0) @ self.robot.flange(q) @ self.tool[0])

    def base_gone(self, gone: FloatArray) -> FloatArray:
        """Base poses (..., 4, 4) where it has gone so far (...,) [m]."""
        if self.axis is None:
            return self.base
        out = np.array(np.broadcast_to(self.base, (*gone.shape, 4, 4)))
        out[..., :3, 3] += gone[..., None] * self.axis
        return out

    def base_behind(self, node: int | slice) -> FloatArray:
        """Base poses (4, 4) or (M, 4, 4) before the first move (0) and behind moves (1 to N)."""
        return self.base if self.gone is None else self.base_gone(np.asarray(self.gone[node]))

    def base_on_way(self, law: TimeLaw, a: int, b: int, when: FloatArray) -> FloatArray:
        """Base poses (4, 4), or (S, 4, 4) where it rides, at times ``when`` (S,) of the moves a to b - 1,
        whose law is given."""
        return self.base if self.gone is None else self.base_gone(self.gone_on_way(law, a, b, when))

    def gone_on_way(self, law: TimeLaw, a: int, b: int, when: FloatArray) -> FloatArray:
        """How far (S,) [m] the base has gone then."""
        if self.gone is None:
            return np.zeros(len(when))
        nodes = self.gone[a : b + 1, None]
        node, xi = offsets(law, np.diff(nodes, axis=0), when)
        return np.asarray((nodes[node] + xi)[:, 0])

    def flanges(self) -> FloatArray:
        """Flange poses (N, 4, 4) in the world at the targets, for a row that is in the world."""
        out = self.pose @ inverse(self.tool)
        base = np.broadcast_to(self.base_behind(slice(1, None)), out.shape)
        out[self.joint] = base[self.joint] @ self.robot.flange(self.q[self.joint])
        return np.asarray(out)


def make_row(
    task: TaskText,
    moves: tuple[MoveStep, ...],
    machine: Machine,
    base: FloatArray,
    units: Mapping[str, str],
    rides: tuple[FloatArray, FloatArray] | None = None,
) -> Row:
    """Targets of one arm's moves; ``units`` {unit in lower case: arm} are those of the other arms. ``rides``:
    how far the base has gone (N + 1,) [m] and along what (3,), where it rides.

    Moves in several frames that move, or in one and in the world, are a fault that ``verify.held_frame``
    names; they are taken as if all frames stood still.
    """
    count = len(moves)
    straight = [move for move in moves if not move.by_joints]
    carriers = {None if move.wobj.fixed else units.get(move.wobj.unit.lower()) for move in straight}
    carrier = carriers.pop() if len(carriers) == 1 else None
    joint = np.array([move.by_joints for move in moves])
    position, quaternion = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    conf = np.zeros((count, 4), dtype=np.int64)
    named = np.zeros(count, dtype=bool)
    axes = machine.data.axes
    q = np.full((count, axes), np.nan)
    rates = np.zeros((count, axes)) if task.text.is_trajectory else None
    work: dict[int, FloatArray] = {}
    frame = np.zeros((count, 4, 4))
    tool = np.zeros((count, 4, 4))
    for i, move in enumerate(moves):
        tool[i] = move.tool.pose
        key = id(move.wobj)
        if key not in work:
            work[key] = move.wobj.user @ move.wobj.object
        frame[i] = work[key]
        match move.target:
            case RobTarget(position=place, quaternion=turn, conf=stated):
                position[i], quaternion[i], named[i] = place, turn, stated is not None
                conf[i] = conf[i] if stated is None else stated
            case StatusTarget():
                q[i] = chosen(move, machine, base)
            case JointTarget(joints=values):
                q[i] = machine.data.from_controller(values)
            case PassedTarget(joints=values, rates=rate):
                q[i] = values
                if rates is not None:
                    rates[i] = rate
    ride = np.eye(4) if carrier is None else frame[int(np.argmin(joint))]
    pose = (np.linalg.inv(ride) if carrier is not None else np.eye(4)) @ frame @ poses(position, quaternion)
    gone, axis = (None, None) if rides is None else rides
    row = Row(task, moves, machine, base, tool, joint, pose, q, conf, named, carrier, ride, gone, axis, rates)
    if rates is not None:
        pose[:] = base @ machine.flange(q) @ tool
    elif carrier is None:
        stands = np.broadcast_to(row.base_behind(slice(1, None)), pose.shape)
        pose[joint] = stands[joint] @ machine.flange(q[joint]) @ tool[joint]
    return row


def chosen(move: MoveStep, machine: Machine, base: FloatArray) -> FloatArray:
    """The joints (6,) [rad, serial] that Status and Turn select for a move's target; NaN where they select
    none, or more than one. ``base`` (4, 4) in the world."""
    found = solutions(move, machine, base)
    return np.asarray(found.q[0]) if len(found.q) == 1 else np.full(6, np.nan)


def solutions(move: MoveStep, machine: Machine, base: FloatArray) -> inverse_kinematics.Chosen:
    """All that Status and Turn select for a move's target; nothing for other targets."""
    target = move.target
    if not isinstance(target, StatusTarget):
        return inverse_kinematics.Chosen(np.zeros((0, 6)), ())
    return inverse_kinematics.select_by_status(machine, flange_at(move, base), target.status, target.turn)


def flange_at(move: MoveStep, base: FloatArray) -> FloatArray:
    """Flange pose (4, 4) in the base at a move's target, which is a pose in a frame that stands still."""
    target = move.target
    if isinstance(target, JointTarget | PassedTarget):
        return np.full((4, 4), np.nan)
    pose = move.wobj.user @ move.wobj.object @ poses(target.position, target.quaternion)
    return np.asarray(inverse(base) @ pose @ inverse(move.tool.pose))


def driven_law(rows: Sequence[Row]) -> TimeLaw:
    """The law of moves that are driven by trajectories: each takes its own time, the same for all arms, and
    no corner is rounded."""
    count = len(rows[0].moves)
    took = np.max([[move.time or 0.0 for move in row.moves] for row in rows], axis=0)
    times = np.concatenate([[0.0], np.cumsum(np.maximum(took, 1e-4))])
    return TimeLaw(times, np.ones(count), np.ones(count), np.zeros(count + 1))


def driven_joints(law: TimeLaw, start: FloatArray, row: Row, when: FloatArray) -> FloatArray:
    """Joints (S, J) [rad] at times ``when`` (S,) of moves that are driven from joints ``start`` (J,) at rest:
    on each the cubic with the positions and velocities of its two ends, as the controller interpolates."""
    if row.rates is None:
        raise TypeError("a row without velocities at its targets")
    move = np.clip(np.searchsorted(law.times, when, side="left") - 1, 0, len(row.moves) - 1)
    q = np.concatenate([start[None], row.q])
    v = np.concatenate([np.zeros((1, q.shape[1])), row.rates])
    span = np.diff(law.times)[move][:, None]
    share = (when - law.times[move])[:, None] / span
    return cubic(q[move], q[move + 1], v[move], v[move + 1], span, share)


def cubic(
    a: FloatArray, b: FloatArray, va: FloatArray, vb: FloatArray, span: FloatArray, share: FloatArray
) -> FloatArray:
    """Joints (..., J) at shares (..., 1) of the time ``span`` (..., 1) [s] on cubics from ``a`` to ``b`` with
    velocities ``va`` and ``vb`` (..., J) there (Hermite's)."""
    way = a + share**2 * (3.0 - 2.0 * share) * (b - a)
    return np.asarray(way + span * share * (1.0 - share) * ((1.0 - share) * va - share * vb))


def driven_knots(
    robot: RobotData, moves: Sequence[MoveStep], start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Joints and velocities (N + 1, J) at which an arm is driven by N moves from rest at ``start`` (J,)."""
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
                raise TypeError("a move that trajectories do not state")
    return np.array(q), np.array(v)


def make_law(
    rows: Sequence[Row], starts: Sequence[FloatArray], joints: Sequence[FloatArray], stop: BoolArray
) -> tuple[TimeLaw, tuple[FloatArray, ...]]:
    """The time law of the moves, and each arm's steps (N, 6) by way [m] and turning [rad]: the slowest of the
    arms sets each move's time, the smallest zone the rounding. ``starts`` (4, 4) are each row's TCP in the
    frame of its poses, ``joints`` (6,) its angles."""
    count = len(rows[0].moves)
    duration, length = np.zeros(count), np.zeros(count)
    reach = np.full((count + 1, 2), _MOST_CORNER_SHARE)
    deltas: list[tuple[FloatArray, float]] = []
    paired: list[tuple[FloatArray, float]] = []
    for row, start, q in zip(rows, starts, joints, strict=True):
        before = np.concatenate([start[None], row.pose[:-1]])
        shift = row.pose[:, :3, 3] - before[:, :3, 3]
        turning = log_rotation(np.swapaxes(before[:, :3, :3], 1, 2) @ row.pose[:, :3, :3])
        step, turn = np.linalg.norm(shift, axis=1), np.linalg.norm(turning, axis=1)
        deltas += [(shift, ACCURACY), (turning, ACCURACY_TURN)]
        length = np.hypot(length, np.hypot(step, _ARM_LENGTH * turn))
        duration = np.maximum(duration, _durations(row, q, step, turn))
        zone = np.array([0.0 if move.zone.fine else move.zone.tcp for move in row.moves])
        angle = np.array([0.0 if move.zone.fine else move.zone.turn_angle for move in row.moves])
        reach[1:, 0] = np.minimum(reach[1:, 0], _share(zone, angle, step, turn))
        reach[1:-1, 1] = np.minimum(reach[1:-1, 1], _share(zone[:-1], angle[:-1], step[1:], turn[1:]))
        if row.gone is not None:  # a zone is a length of the track, too
            # a straight tool has a corner where the track's share of its way changes
            paired.append((np.column_stack([shift, np.diff(row.gone)]), ACCURACY))
            way, still = np.abs(np.diff(row.gone)), np.zeros(count)
            linear = np.array([0.0 if move.zone.fine else move.zone.linear for move in row.moves])
            reach[1:, 0] = np.minimum(reach[1:, 0], _share(linear, still, way, still))
            reach[1:-1, 1] = np.minimum(reach[1:-1, 1], _share(linear[:-1], still[1:], way[1:], still[1:]))
    duration = np.maximum(duration, 1e-4)
    room = np.full(count + 1, np.inf)
    rate_in, rate_out = end_rates(duration, length, stop)
    for delta, accuracy in deltas + paired:
        # a rounding of half width h strays from the corner by h |change of speed| / 4
        speed = delta / duration[:, None]
        change = _sideways(rate_out[:-1, None] * speed[:-1], rate_in[1:, None] * speed[1:])
        room[1:-1] = np.minimum(room[1:-1], 4.0 * accuracy / np.maximum(change, 1e-12))
    law = time_law_of(duration, length, stop, np.clip(reach, 0.0, _MOST_CORNER_SHARE), room)
    ways, turns = deltas[::2], deltas[1::2]
    return law, tuple(np.concatenate([a, b], axis=1) for (a, _), (b, _) in zip(ways, turns, strict=True))


def _durations(row: Row, start: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    """Time of each move: \\T where given, else by the speed and by what the joints can do from stop to
    stop."""
    out = np.zeros(len(row.moves))
    for i, move in enumerate(row.moves):
        if move.time is not None:
            out[i] = move.time
            continue
        tcp = move.velocity if move.velocity is not None else move.speed.tcp
        out[i] = max(step[i] / max(tcp, 1e-6), turn[i] / max(move.speed.turn, 1e-6))
        if row.joint[i]:
            past = row.q[i - 1] if i and row.joint[i - 1] else _behind(row, i, start)
            change = np.abs(row.q[i] - past)
            ramps = np.sqrt(6.0 * change / row.robot.data.acceleration)
            share = np.ones(6) if move.speed.axes is None else np.array(move.speed.axes)
            fastest = share * row.robot.data.velocity
            out[i] = max(out[i], float(np.max(1.5 * change / fastest)), float(ramps.max()))
            out[i] *= 1.02  # the controller's own ramps stay inside the limits
    return out


def _behind(row: Row, i: int, start: FloatArray) -> FloatArray:
    """Joints (6,) behind the straight moves that end before move i, which begin at the joints before them;
    ``start`` (6,) are those of the row."""
    before = np.flatnonzero(row.joint[:i])
    first = int(before[-1]) + 1 if len(before) else 0
    here = row.q[first - 1] if first else start
    if first == i or row.carrier is not None or not np.isfinite(here).all():
        return here
    if row.robot.followed:
        shares = np.arange(1, _LOOKS + 1) / _LOOKS
        ends = np.concatenate([row.tcp(here[None]), row.pose[first:i]])
        turn = log_rotation(np.swapaxes(ends[:-1, :3, :3], 1, 2) @ ends[1:, :3, :3])[:, None]
        place = ends[:-1, None, :3, 3] + shares[:, None] * np.diff(ends[:, :3, 3], axis=0)[:, None]
        rotation = ends[:-1, None, :3, :3] @ exp_rotation(shares[:, None] * turn)
        path = from_parts(rotation, place).reshape(-1, 4, 4)
        tools = np.repeat(inverse(row.tool[first:i]), _LOOKS, axis=0)
        base = row.base
        if row.gone is not None:
            step = np.diff(row.gone[first : i + 1])[:, None]
            base = row.base_gone((row.gone[first:i, None] + shares * step).ravel())
        q = offset_arm.follow(row.robot.chain, inverse(base) @ path @ tools, here)[-1]
        return np.asarray(q if np.isfinite(q).all() else here)
    some = slice(first, i)
    own = np.full(i - first, branch_of(row.robot, here), dtype=np.int64)
    branch = np.where(row.named[some], row.conf[some, 3], own)
    base = row.base_behind(slice(first + 1, i + 1))
    flange = inverse(base) @ row.pose[some] @ inverse(row.tool[some])
    q = continued(row.robot, solve(row.robot, flange, branch), here)[-1]
    return np.asarray(q if np.isfinite(q).all() else here)


_LOOKS: Final = 20
"""Places of a straight move at which an arm with an offset wrist is followed."""


def _sideways(before: FloatArray, after: FloatArray) -> FloatArray:
    """Change (M,) of speeds across the path, from ``before`` to ``after`` (M, D); a change along it does not
    leave the path, unless it turns back."""
    size = np.maximum(np.stack([np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)]), 1e-12)
    along = dots(before, after)
    whole = np.linalg.norm(after - before, axis=1)
    pairs = list(itertools.combinations(range(before.shape[1]), 2))[::-1]
    wedge = [before[:, i] * after[:, j] - before[:, j] * after[:, i] for i, j in pairs]
    cross = np.linalg.norm(np.stack(wedge, axis=1), axis=1)  # of three numbers the cross product
    across = cross / size.min(axis=0)
    still = size.min(axis=0) < 1e-9
    return np.asarray(np.where((along < 0.0) | still, whole, np.minimum(across, whole)))


def _share(zone: FloatArray, angle: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    """Fraction of moves that zones cover: by the way of the TCP, or by the turning of a TCP that stands."""
    by_turn = np.where(turn > 1e-6, angle / np.maximum(turn, 1e-6), _MOST_CORNER_SHARE)
    return np.where(step > 1e-5, zone / np.maximum(step, 1e-5), by_turn)


SAMPLES_AT_ONCE = 32_768
"""Samples that are worked out at once."""


def chunks(first: int, last: int) -> Iterator[slice]:
    """The samples from ``first`` to before ``last``, some thousands at once: what is worked out on the way
    needs much memory."""
    for begin in range(first, last, SAMPLES_AT_ONCE):
        yield slice(begin, min(begin + SAMPLES_AT_ONCE, last))


def samples_on_way(row: Row, a: int, b: int, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses (N + 1, 4, 4) between the moves a to b - 1 from ``start`` on in the row's frame, and each
    move's way and turning (N, 6)."""
    nodes = np.concatenate([start[None], row.pose[a:b]])
    turn = log_rotation(np.swapaxes(nodes[:-1, :3, :3], 1, 2) @ nodes[1:, :3, :3])
    return nodes, np.concatenate([np.diff(nodes[:, :3, 3], axis=0), turn], axis=1)


def poses_on_way(law: TimeLaw, nodes: FloatArray, delta: FloatArray, when: FloatArray) -> FloatArray:
    """TCP poses (S, 4, 4) in the row's frame on straight moves, of poses and steps as :func:`steps`
    gives."""
    at_node, xi = offsets(law, delta, when)
    rotation = nodes[at_node, :3, :3] @ exp_rotation(xi[:, 3:])
    return from_parts(rotation, nodes[at_node, :3, 3] + xi[:, :3])


def branches_on_way(row: Row, a: int, b: int, here: FloatArray) -> IntArray:
    """The branch (N,) of each of the straight moves a to b - 1, which begin at joints ``here`` (6,)."""
    if row.robot.data.coupling is None and row.named[a:b].all():
        return np.asarray(row.conf[a:b, 3])
    # KRL and URScript name no branch here, and cfx of parallel-rod arms is not settled: the arm keeps its own
    return np.full(b - a, inverse_kinematics.branch_of(row.robot, here), dtype=np.int64)


def joints_on_way(
    row: Row, law: TimeLaw, a: int, branch: IntArray, here: FloatArray, when: FloatArray, tcp: FloatArray
) -> FloatArray:
    """Joint angles (S, 6) on straight moves from move a on: the ``branch`` of each move's target,
    unwrapped from the joints ``here`` of the sample before; ``law`` is that of these moves."""
    move = np.clip(np.searchsorted(law.times, when, side="left") - 1, 0, len(branch) - 1)
    base = row.base_on_way(law, a, a + len(branch), when)
    flange = inverse(base) @ tcp @ inverse(row.tool[a + move])
    if row.robot.followed:
        return offset_arm.follow(row.robot.chain, flange, here)
    q = inverse_kinematics.solve(row.robot, flange, branch[move])
    return inverse_kinematics.continued(row.robot, q, here)
