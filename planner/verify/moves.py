"""Moves of one arm in one stage as arrays, and the time law that the moves of all arms give."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import inverse, log_rotation
from planner.geometry.vectors import dots
from planner.verify import krl_status, time_law
from planner.verify.arm_ik import branch_of, continued, solve
from planner.verify.job import TaskText
from planner.verify.machines import Machine
from planner.verify.steps import MessageStep, MoveStep, SettingStep, Step, WaitStep
from planner.verify.values import JointTarget, RobTarget, StatusTarget, poses

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ARM_LENGTH = 0.3
"""Weight [m/rad] of turning against moving where speeds at ramps are matched."""
_REACH_HALF = 0.5
ACCURACY = 1e-5
"""Path accuracy [m] that a corner is rounded within even without a zone; a tenth of what ABB states for path
repeatability."""
ACCURACY_TURN = 1e-4
"""The same for turning [rad]."""


@dataclasses.dataclass(frozen=True)
class Row:
    """N moves of one arm in a stage: which are ``joint`` moves (N,), targets as TCP ``pose`` (N, 4, 4) and as
    ``q`` (N, 6) where they are joints, ``conf`` (N, 4) of those that are ``named`` (N,) by confdata, ``tool``
    (N, 4, 4), ``base`` (4, 4).

    Poses are in the world, unless the flange of arm ``carrier`` carries the work object: then they are in
    the frame that lies at ``ride`` (4, 4) in that flange, and the moves are straight in it.
    """

    task: TaskText
    moves: tuple[MoveStep, ...]
    robot: Machine
    base: FloatArray
    tool: FloatArray
    joint: NDArray[np.bool_]
    pose: FloatArray
    q: FloatArray
    conf: IntArray
    named: NDArray[np.bool_]
    carrier: str | None
    ride: FloatArray

    def tcp(self, q: FloatArray) -> FloatArray:
        """TCP poses (..., 4, 4) in the world of joints (..., 6), with the tool of the first move."""
        return np.asarray(self.base @ self.robot.flange(q) @ self.tool[0])

    def flanges(self) -> FloatArray:
        """Flange poses (N, 4, 4) in the world at the targets, for a row that is in the world."""
        out = self.pose @ inverse(self.tool)
        out[self.joint] = self.base @ self.robot.flange(self.q[self.joint])
        return np.asarray(out)


def make_row(
    task: TaskText,
    moves: tuple[MoveStep, ...],
    machine: Machine,
    base: FloatArray,
    units: Mapping[str, str],
) -> Row:
    """Targets of one arm's moves; ``units`` {unit in lower case: arm} are those of the other arms.

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
    q = np.full((count, 6), np.nan)
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
    ride = np.eye(4) if carrier is None else frame[int(np.argmin(joint))]
    pose = (np.linalg.inv(ride) if carrier is not None else np.eye(4)) @ frame @ poses(position, quaternion)
    if carrier is None:
        pose[joint] = base @ machine.flange(q[joint]) @ tool[joint]
    return Row(task, moves, machine, base, tool, joint, pose, q, conf, named, carrier, ride)


def chosen(move: MoveStep, machine: Machine, base: FloatArray) -> FloatArray:
    """The joints (6,) [rad, serial] that Status and Turn select for a move's target; NaN where they select
    none, or more than one. ``base`` (4, 4) in the world."""
    found = solutions(move, machine, base)
    return np.asarray(found.q[0]) if len(found.q) == 1 else np.full(6, np.nan)


def solutions(move: MoveStep, machine: Machine, base: FloatArray) -> krl_status.Chosen:
    """All that Status and Turn select for a move's target; nothing for other targets."""
    target = move.target
    if not isinstance(target, StatusTarget):
        return krl_status.Chosen(np.zeros((0, 6)), ())
    return krl_status.select(machine, flange_at(move, base), target.status, target.turn)


def flange_at(move: MoveStep, base: FloatArray) -> FloatArray:
    """Flange pose (4, 4) in the base at a move's target, which is a pose in a frame that stands still."""
    target = move.target
    if isinstance(target, JointTarget):
        return np.full((4, 4), np.nan)
    pose = move.wobj.user @ move.wobj.object @ poses(target.position, target.quaternion)
    return np.asarray(inverse(base) @ pose @ inverse(move.tool.pose))


def make_law(
    rows: Sequence[Row],
    starts: Sequence[FloatArray],
    joints: Sequence[FloatArray],
    stop: NDArray[np.bool_],
) -> time_law.TimeLaw:
    """The time law of the moves: the slowest of the arms sets each move's time, the smallest zone the
    rounding. ``starts`` (4, 4) are each row's TCP in the frame of its poses, ``joints`` (6,) its angles."""
    count = len(rows[0].moves)
    duration, length = np.zeros(count), np.zeros(count)
    reach = np.full((count + 1, 2), _REACH_HALF)
    deltas = []
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
    duration = np.maximum(duration, 1e-4)
    room = np.full(count + 1, np.inf)
    for (
        delta,
        accuracy,
    ) in deltas:  # a rounding of half width h strays from the corner by h |change of speed| / 4
        change = _sideways(delta / duration[:, None])
        room[1:-1] = np.minimum(room[1:-1], 4.0 * accuracy / np.maximum(change, 1e-12))
    return time_law.make(duration, length, stop, np.clip(reach, 0.0, _REACH_HALF), room)


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
    some = slice(first, i)
    own = np.full(i - first, branch_of(row.robot, here), dtype=np.int64)
    branch = np.where(row.named[some], row.conf[some, 3], own)
    flange = inverse(row.base) @ row.pose[some] @ inverse(row.tool[some])
    q = continued(solve(row.robot, flange, branch), here)[-1]
    return np.asarray(q if np.isfinite(q).all() else here)


def _sideways(speed: FloatArray) -> FloatArray:
    """Change (N - 1,) of speeds (N, 3) across the path; a change along it does not leave the path, unless it
    turns back."""
    before, after = speed[:-1], speed[1:]
    size = np.maximum(np.linalg.norm(speed, axis=1), 1e-12)
    along = dots(before, after)
    whole = np.linalg.norm(after - before, axis=1)
    cross = np.linalg.norm(np.cross(before, after), axis=1)
    across = cross / np.minimum(size[:-1], size[1:])
    still = np.minimum(size[:-1], size[1:]) < 1e-9
    return np.asarray(np.where((along < 0.0) | still, whole, np.minimum(across, whole)))


def _share(zone: FloatArray, angle: FloatArray, step: FloatArray, turn: FloatArray) -> FloatArray:
    """Fraction of moves that zones cover: by the way of the TCP, or by the turning of a TCP that stands."""
    by_turn = np.where(turn > 1e-6, angle / np.maximum(turn, 1e-6), _REACH_HALF)
    return np.where(step > 1e-5, zone / np.maximum(step, 1e-5), by_turn)


def between(steps: tuple[Step, ...], count: int) -> list[list[Step]]:
    """Steps that are no moves: before the first move, behind each of ``count`` moves (the last takes what
    remains)."""
    out: list[list[Step]] = [[] for _ in range(count + 1)]
    seen = 0
    for step in steps:
        if isinstance(step, MoveStep):
            seen += 1
        else:
            out[min(seen, count)].append(step)
    return out


def waits(steps: list[Step]) -> float:
    return sum(step.pause for step in steps if isinstance(step, WaitStep))


def holds(steps: list[Step]) -> bool:
    """Whether the steps need the arm to stand: waits and questions to the operator, not settings."""
    return any(
        isinstance(step, WaitStep) or (isinstance(step, MessageStep) and step.confirm) for step in steps
    ) or any(isinstance(step, SettingStep) and step.stops for step in steps)
