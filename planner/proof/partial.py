"""Partial proof of programs of other origin: the moves that can be read, stretch by stretch.

A stretch starts where the arm's position is known: after the first move whose target defines the joints. The
motion of one arm is proven: reach, configuration, joint limits and speeds, singularity, speed of the tool,
and clearance to the cell and to other arms at home. Nothing is proven about signals, the process and the
motion of the other arms.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import Issue, TandemError
from planner.problem import Arm, Problem
from planner.programs import partial
from planner.programs.language import Gap
from planner.programs.partial import PartialPrograms
from planner.programs.program_text import NO_TEXT
from planner.programs.stages import JobStage, JobText, TaskText
from planner.programs.steps import JointTarget, MoveStep, RobTarget, StatusTarget
from planner.proof.clearance.samples import measure_min_distances
from planner.proof.context import Context
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.models import StationaryPoses, cell_models
from planner.proof.prove import Prover
from planner.proof.replay.moves import flange_at, selected_joints
from planner.proof.replay.playback import MAX_MOTION_TIME_S
from planner.proof.rules.clearance import (
    MIN_QUERY_RANGE_M,
    excluded_pairs,
    min_accepted_clearance,
    required_clearance,
)
from planner.proof.rules.robot_motion import MAX_JOINT_STEP_RAD, TCP_SPEED_FACTOR

UNREAD = "verify.unread"
"""Code of issues about lines that were not read, and moves that are not proven."""
_MAX_STRIDE_M = 0.005
"""Maximum path [m] of any point of an arm between clearance queries."""
_MAX_QUERIES = 200_000
"""Number of clearance queries of an arm after which its remaining stretches are not proven."""


@dataclasses.dataclass(frozen=True)
class ProvenShare:
    """Proven part of the moves in the texts.

    Attributes:
        moves: Number of moves in the texts.
        moves_proven: Number of proven moves.
        path: Path [m] of the moves whose start and target are read.
        path_proven: Proven part of that path [m].
        time: Time [s] of the moves whose start and target are read.
        time_proven: Proven part of that time [s].
    """

    moves: int
    moves_proven: int
    path: float
    path_proven: float
    time: float
    time_proven: float

    def __str__(self) -> str:
        path = f"{self.path_proven:.3f} of {self.path:.3f} m of path"
        time = f"{self.time_proven:.1f} of {self.time:.1f} s"
        percentage = 100 * self.moves_proven // max(self.moves, 1)  # 100 only if all are proven
        return f"{self.moves_proven} of {self.moves} moves ({percentage} %), {path} and {time}"


@dataclasses.dataclass(frozen=True)
class PartialProof:
    """Result of a partial proof.

    Attributes:
        issues: Issues about lines that were not read, and about moves that are not proven.
        proven: The proven part.
    """

    issues: tuple[Issue, ...]
    proven: ProvenShare


@dataclasses.dataclass
class _MoveCounts:
    """Results for the moves of one arm, or of all.

    Attributes:
        proven: Whether a move is proven each time that it is executed, by its (file, line).
        why: Reasons why moves are not proven, by (file, line).
        sums: Sums of path [m], proven path [m], time [s] and proven time [s].
        queries: Number of clearance queries.
    """

    proven: dict[tuple[str, int], bool] = dataclasses.field(default_factory=dict)
    why: dict[tuple[str, int], str] = dataclasses.field(default_factory=dict)
    sums: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(4))
    queries: int = 0

    def reject(self, key: tuple[str, int], why: str) -> None:
        """Record that a move is not proven. Of several reasons the first one counts."""
        self.proven[key] = False
        self.why.setdefault(key, why)


def prove_partly(problem: Problem, programs: Mapping[str, str]) -> PartialProof:
    """Read programs of any origin, and prove as many of their moves as possible, for the cell of a problem.

    Args:
        problem: The problem.
        programs: Text by file name.

    Raises:
        TandemError: A robot is not supported (``verify.robot_model``).
    """
    arm_texts, unassigned_files = partial.read_partial(problem, programs)
    issues = [_unread_issue(path, None, "it belongs to no arm of the cell") for path in unassigned_files]
    move_count, totals = 0, _MoveCounts()
    prover = Prover(problem, {})
    for arm_text in arm_texts:
        arm_count = _MoveCounts()
        for stretch in _known_stretches(problem, arm_text, arm_count):
            _prove_stretch(problem, programs, prover, arm_text, stretch, arm_count)
        unread = {(fault.file, fault.line) for fault in arm_text.unread}
        issues += [_unread_issue(f.file, f.line, f.message, arm_text.arm.name) for f in arm_text.unread]
        for key, is_proven in sorted(arm_count.proven.items()):
            if not is_proven and key not in unread:
                why = f"{arm_count.why[key]}: read, not proven"
                issues.append(Issue(UNREAD, why, file=key[0], line=key[1], arm=arm_text.arm.name))
        for key in dict.fromkeys(arm_text.moves):
            if key not in arm_count.proven and key not in unread:
                message = "the move is on no path that was read: not proven"
                issues.append(Issue(UNREAD, message, file=key[0], line=key[1], arm=arm_text.arm.name))
        move_count += len(arm_text.moves)
        totals.proven |= {
            key: is_proven for key, is_proven in arm_count.proven.items() if key in set(arm_text.moves)
        }
        totals.sums += arm_count.sums
    path_length, path_proven, time, time_proven = totals.sums.tolist()
    proven_share = ProvenShare(
        move_count, sum(totals.proven.values()), path_length, path_proven, time, time_proven
    )
    return PartialProof(tuple(issues), proven_share)


def _unread_issue(file: str, line: int | None, reason: str, arm: str | None = None) -> Issue:
    """Return an issue about a line, or a whole file, that was not read."""
    return Issue(UNREAD, f"{reason}: not read, not proven", file=file, line=line, arm=arm)


@dataclasses.dataclass(frozen=True)
class _KnownStretch:
    """Successive moves of an arm that start at known joints.

    Attributes:
        moves: The moves. A stretch grows while a text is read.
        start: Joints (6,) before the first move.
    """

    moves: list[MoveStep]
    start: FloatArray


def _known_stretches(problem: Problem, arm_text: PartialPrograms, count: _MoveCounts) -> list[_KnownStretch]:
    """Return the stretches of moves that start at known joints. Other moves are rejected in ``count``.

    A stretch starts after a move whose target defines the joints. The path of that move itself is unknown, so
    it is rejected. A stretch ends at an unread statement (``Gap``) and at a move of unknown path. If its last
    move ends in a zone, this move is rejected, too. After a statement that may shift all targets, no move is
    known.
    """
    stretches: list[_KnownStretch] = []
    is_open, shifted = False, False  # whether the last stretch goes on, and whether targets may be shifted

    def close() -> None:
        """Reject the last move of the open stretch if it ends in a zone."""
        if is_open and stretches[-1].moves and not stretches[-1].moves[-1].zone.fine:
            last_key = _move_key(arm_text, stretches[-1].moves[-1])
            count.reject(last_key, "its corner leads to an unknown motion")

    for part in arm_text.path:
        if isinstance(part, Gap):
            close()
            is_open, shifted = False, shifted or part.shifts
            continue
        key = _move_key(arm_text, part)
        why = (
            "an unread statement before it may shift all targets"
            if shifted
            else _unknown_path_reason(
                part,
                arm_text.reader.known_moves,
                bool(arm_text.arm.linear_axes),
                problem.cell.turntable is not None,
            )
        )
        if why:
            close()
            count.reject(key, why)
            is_open = False
            continue
        if is_open:
            stretches[-1].moves.append(part)
            continue
        count.reject(key, "the start of the move is unknown")
        start = _target_joints(problem, arm_text, part)
        if start is not None:
            stretches.append(_KnownStretch(moves=[], start=start))
            is_open = True
    close()
    return [stretch for stretch in stretches if stretch.moves]


def _move_key(arm_text: PartialPrograms, move: MoveStep) -> tuple[str, int]:
    """Return file and line of a move."""
    return arm_text.paths.get(move.module, move.module), move.line


def _unknown_path_reason(
    move: MoveStep, known: frozenset[str] | None, has_track: bool, has_turntable: bool
) -> str:
    """Return why the path of a move is unknown, "" if it is known.

    Args:
        move: The move.
        known: Kinds of moves whose path between targets is known, None for all kinds.
        has_track: Whether the arm is on a track or gantry.
        has_turntable: Whether the cell has a turntable.
    """
    if known is not None and move.kind not in known:
        return f"the path of {move.kind} between its targets is unknown"
    if move.wobj.held or not move.wobj.fixed or not move.tool.held:
        return "its tool or its work object is not the arm's own, or moves"
    external = move.target.external
    if has_track:
        return "its arm is on a track or gantry, which unread moves may have moved"
    if has_turntable:
        return "its block is on a turntable, which unread moves may have rotated"
    # 9E9 stands for an axis that is not used, and so does 0 if all values are 0.
    if (np.abs(external) > 0.0).any() and (external < 8.9e9).any():
        return "it moves an external axis"
    if {"conc", "corr", "z"} & set(move.switches):
        return "an option changes its path"
    return ""


def _target_joints(problem: Problem, arm_text: PartialPrograms, move: MoveStep) -> FloatArray | None:
    """Return the joints (6,) at a move's target, None if the text does not define them."""
    machine, base = arm_model.robot_machine(arm_text.arm.data), arm_text.arm.base
    target = move.target
    if isinstance(target, JointTarget):
        q = machine.data.from_controller(target.joints)
    elif isinstance(target, StatusTarget):
        q = selected_joints(move, machine, base)
    elif isinstance(target, RobTarget) and target.conf is not None:
        q = inverse_kinematics.select_by_confdata(
            machine, flange_at(move, base)[None], np.array([target.conf])
        )[0]
    else:
        return None
    return np.asarray(q) if np.isfinite(q).all() else None


def _prove_stretch(
    problem: Problem,
    programs: Mapping[str, str],
    prover: Prover,
    arm_text: PartialPrograms,
    stretch: _KnownStretch,
    count: _MoveCounts,
) -> None:
    """Prove the moves of a stretch, and add the results to ``count``.

    The stretch is replayed as a program of its own, with the other arms at home. If the programs are too
    long, or the replay fails, all its moves are rejected.

    Args:
        problem: The problem.
        programs: Text by file name.
        prover: Prover with the cell models that are kept between stretches.
        arm_text: Programs of the arm.
        stretch: The stretch.
        count: Results for the moves of the arm.
    """
    run = stretch.moves
    keys = [_move_key(arm_text, move) for move in run]
    if count.queries > _MAX_QUERIES or count.sums[2] > MAX_MOTION_TIME_S:
        for key in keys:
            count.reject(key, "the programs are too long to be proven completely")
        return
    arms = [arm for arm in problem.cell.arms if arm.name != arm_text.arm.name]
    arm_at_start = dataclasses.replace(arm_text.arm, home=stretch.start)
    tasks = [
        TaskText(arm_text.name, arm_at_start, NO_TEXT, tuple(run), arm_text.files),
        *(TaskText(arm.name, arm, NO_TEXT, (), {}) for arm in arms),
    ]
    stage = JobStage(False, None, {task.name: task.steps for task in tasks})
    context = Context(problem, {}, programs)
    # The cached values are set, because the texts are not read in the usual way.
    context.__dict__["job"] = JobText(tuple(tasks), (stage,), (), (), (), {})
    context.__dict__["bases"] = {arm.name: arm.base for arm in problem.cell.arms}
    try:
        motion = context.motion
    except TandemError as error:
        for key in keys:
            count.reject(key, error.issues[0].message)
        return
    violations = _violations(context, prover, arm_text.arm, run, count)
    path = np.zeros(len(run))  # path [m] of the TCP in each move
    positions = motion.tcp[arm_text.arm.name][np.arange(len(motion.time))][:, :3, 3]
    np.add.at(path, motion.node[1:], np.nan_to_num(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    for i, key in enumerate(keys):
        if i in violations:
            count.reject(key, violations[i])
        else:
            count.proven.setdefault(key, True)
        is_proven = i not in violations and key not in count.why
        seconds = float(motion.node_duration[i])
        count.sums += [path[i], path[i] * is_proven, seconds, seconds * is_proven]


def _violations(
    context: Context, prover: Prover, moved_arm: Arm, run: Sequence[MoveStep], count: _MoveCounts
) -> dict[int, str]:
    """Return the first violated requirement of each move of a stretch that violates one.

    The requirements are those of the module docstring. After a pose out of reach, all later moves of the
    stretch are violations. If the motion is too long, or its clearance is undecided, all moves are that have
    no other violation.

    Args:
        context: Context whose job consists of the stretch.
        prover: Prover with the cell models.
        moved_arm: The arm that moves.
        run: Moves of the stretch.
        count: Results for the moves of the arm; its number of queries grows.

    Returns:
        Reasons by the index of the move.
    """
    arm, motion, settings = moved_arm.name, context.motion, context.problem.settings
    machine, q = arm_model.robot_machine(moved_arm.data), motion.q[arm]
    out: dict[int, str] = {}

    def mark(wrong: BoolArray, reason: str) -> None:
        """Reject the moves of samples ``wrong`` (S,)."""
        for node in np.unique(motion.node[wrong]):
            out.setdefault(int(node), reason)

    for fault in motion.faults:
        end_node = (
            len(run) if fault.kind == "reach" else fault.index + 1
        )  # its position is unknown after that
        for node in range(fault.index, end_node):
            out.setdefault(node, fault.message)
    for node in np.flatnonzero(~motion.node_conf_ok[arm]).tolist():
        out.setdefault(node, "its confdata do not match the motion")
    outside = np.any((q < machine.data.lower) | (q > machine.data.upper), axis=1)
    mark(np.asarray(outside), "an axis leaves its limits")
    if machine.data.coupling is not None:
        controller_axis_3 = q[:, 1] + q[:, 2]
        low, high = machine.data.coupling.axis3_lower, machine.data.coupling.axis3_upper
        mark(
            (controller_axis_3 < low) | (controller_axis_3 > high),
            "axis 3, as the controller counts it, leaves its limits",
        )
    jump = np.abs(np.diff(q, axis=0, prepend=q[:1])).max(axis=1) > MAX_JOINT_STEP_RAD
    mark(jump, "an axis jumps to another solution")
    fast = np.any(np.abs(motion.speed(arm)) > machine.data.velocity, axis=1)
    mark(np.asarray(fast), "an axis is too slow for its time")
    by_joints = np.array([move.by_joints for move in run])
    # As in verify.singularity, with a tolerance of 0.05 deg in straight moves.
    near_singular = singularity_distance(machine, q) < settings.singularity_margin - np.deg2rad(0.05)
    mark(near_singular & ~by_joints[motion.node], "the arm comes too close to a singular posture")
    positions = motion.tcp[arm][np.arange(len(motion.time))][:, :3, 3]
    step = np.linalg.norm(np.diff(positions, axis=0, prepend=positions[:1]), axis=1)
    elapsed = np.maximum(np.diff(motion.time, prepend=motion.time[0] - 1.0), 1e-6)
    too_fast = "the tool moves faster than the problem allows"
    mark((step / elapsed > TCP_SPEED_FACTOR * settings.tcp_speed) & ~by_joints[motion.node], too_fast)
    for i in np.flatnonzero(by_joints).tolist():  # for joint moves the stated speed counts
        stated = run[i].speed.tcp if run[i].velocity is None else run[i].velocity
        if run[i].speed.axes is None and not (stated or 0.0) <= 1.001 * settings.tcp_speed:
            out.setdefault(i, too_fast)
    # No point of the arm is assumed to be farther from an axis than 1.5 times the reach.
    path = np.cumsum(np.abs(np.diff(q, axis=0, prepend=q[:1])).sum(axis=1)) * 1.5 * machine.data.reach
    query_count = int(path[-1] / _MAX_STRIDE_M) + 1
    count.queries += query_count
    if query_count > _MAX_QUERIES:
        mark(np.ones(len(q), dtype=bool), "the stretch is too long to be proven")
        return out
    rows = np.unique(
        np.clip(np.searchsorted(path, np.linspace(0.0, path[-1], query_count + 1)), 0, len(q) - 1)
    )
    try:
        measurements = [_min_clearance(context, prover, arm, rows, q, itself) for itself in (False, True)]
    except TandemError as error:  # too many queries are undecided
        mark(np.ones(len(q), dtype=bool), error.issues[0].message)
        return out
    wrong = np.zeros(len(q), dtype=bool)
    for itself, (measured_rows, distances) in zip((False, True), measurements, strict=True):
        wrong[measured_rows[~(distances >= min_accepted_clearance(required_clearance(settings, itself)))]] = (
            True
        )
    mark(wrong, "bodies of the cell come too close to each other")
    return out


def _min_clearance(
    context: Context, prover: Prover, arm: str, rows: IntArray, q: FloatArray, itself: bool
) -> tuple[IntArray, FloatArray]:
    """Return the indices (M,) of the samples that were measured, and the smallest distances (M,) [m] there.

    Args:
        context: Context of the stretch.
        prover: Prover with the cell models.
        arm: Name of the arm that moves. All others are at home.
        rows: Samples (K,) at which distances are queried.
        q: Joints (S, J) [rad] of the arm at all samples.
        itself: Whether the distances of each arm to itself are measured, rather than all others.
    """
    problem = context.problem
    joints = {other.name: np.tile(other.home, (len(rows), 1)) for other in problem.cell.arms}
    joints[arm] = q[rows]
    required = required_clearance(problem.settings, itself)
    limit, query_range = min_accepted_clearance(required), max(MIN_QUERY_RANGE_M, 1.5 * required)
    model = cell_models(problem, StationaryPoses.of(context), prover.cache)(0)
    # Contact of the tool's edge with the block depends on the process, so it is not examined.
    contact_pair = {f"{arm}/edge", "stock"}
    ignore = (
        frozenset({frozenset(contact_pair)})
        if contact_pair <= {solid.body for solid in model.solids}
        else frozenset()
    )
    measurement = measure_min_distances(
        model, joints, limit, query_range, ignore | excluded_pairs(model, itself)
    )
    return rows[measurement.rows], np.asarray(measurement.min_clearance.distance)
