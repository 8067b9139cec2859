"""Rules on robot files and kinematics, and on the replayed motion of joints and tools.

verify.robot_model and kinematics compare the robots' files with the catalogue, and every link with Drake.
The others are verify.reach, corner, continuity, joint_limits, rod_limits, joint_speed, joint_acceleration,
singularity and tcp_speed.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.plant import CellModel
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issues import TandemError
from planner.problem import Cell
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.findings import Findings, measure_in_degrees, measure_in_mm, to_degrees, to_percent
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.models import MODELS
from planner.proof.replay.moves import trajectory_knots
from planner.proof.replay.tool_speeds import tool_speeds
from planner.proof.rule import RuleOutcome, mm, rule
from planner.proof.rules.setups_and_frames import at_home

MAX_JOINT_STEP_RAD = np.deg2rad(8.0)
"""Joint step [rad] between two samples (4 ms) above which the joint jumps to another solution instead of
moving.
"""
TCP_SPEED_FACTOR = 1.10
"""Ratio of the tool speed to its limit that is allowed, because ramps of the replay exceed the planned
speed.
"""
MAX_UNTIMED_ROTATION_RATE_RAD_S = np.deg2rad(90.0)
"""Maximum rotation rate [rad/s] that may be stated for moves without a time, because parts of a tool far
from its TCP move with the rotation.
"""
_SAMPLES_PER_BATCH = 65_536
"""Number of samples per batch. It limits memory."""


@rule("verify.reach")
def reachability(context: Context) -> RuleOutcome:
    """The arms can follow the path that the text states."""
    return _motion_faults(context, "verify.reach", ("reach", "motion"))


@rule("verify.corner")
def corners(context: Context) -> RuleOutcome:
    """No zone joins a joint move and a straight move."""
    return _motion_faults(context, "verify.corner", ("corner",), "stop there")


def _motion_faults(
    context: Context, code: str, kinds: tuple[str, ...], hint: str | None = None
) -> RuleOutcome:
    """Return the outcome of a rule that reports those faults of the replay whose kind is in ``kinds``.

    The kinds are those of :class:`planner.proof.replay.motion.ReplayFault`.
    """
    findings = Findings(code, context)
    for fault in context.motion.faults:
        if fault.kind in kinds:
            findings.add(fault.message, file=fault.task, line=fault.line, index=fault.index, hint=hint)
    return findings.outcome_without_value()


@rule("verify.continuity")
def continuity(context: Context) -> RuleOutcome:
    """The joints move continuously from home to home, without a jump between samples or moves."""
    findings = Findings("verify.continuity", context, worst=0.0)
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        edges = zip((*moves[:1], *moves[-1:]), ("first", "last"), strict=False)
        if task.text.is_trajectory:  # verify.start_posture checks the start, so only the last move counts
            edges = zip(moves[-1:], ("last",), strict=False)
        for move, word in edges:
            if not at_home(move, task.arm.data, task.arm.home):
                message = f"the {word} move of {task.arm.name} is not a joint move to home"
                findings.add_at_step(message, task, move)
    for arm, q in context.motion.q.items():
        jumps = np.zeros(max(len(q) - 1, 0), dtype=bool)
        for angle in q.T:  # one axis at a time to limit memory: a long motion has many samples
            step = np.abs(np.diff(angle))
            findings.note_highest(step.max(initial=0.0))
            jumps |= step > MAX_JOINT_STEP_RAD
        for i in np.flatnonzero(jumps)[:20]:  # at most 20 issues per arm
            steps = np.abs(q[i + 1] - q[i])
            axis = f"axis {int(np.argmax(steps)) + 1}"
            message = f"{axis} jumps by {np.rad2deg(steps.max()):.2f} deg between two samples"
            findings.add_at_sample(
                message, arm, i + 1, measure_in_degrees(steps.max(), MAX_JOINT_STEP_RAD), (axis,)
            )
    return findings.outcome(to_degrees, "deg", MAX_JOINT_STEP_RAD)


@rule("verify.joint_limits")
def joint_limits(context: Context) -> RuleOutcome:
    """Every axis stays within its limits."""
    findings = Findings("verify.joint_limits", context, worst=np.inf)
    for task in context.job.tasks:
        machine, arm = task.arm.data, task.arm.name
        q = context.motion.q[arm]
        # One axis at a time to limit memory: a long motion has many samples.
        rows = np.array([*(int(axis.argmin()) for axis in q.T), *(int(axis.argmax()) for axis in q.T)])
        # rows: samples (2 J,) of the lowest values of the J axes, then of the highest. ends: these values.
        ends = q[rows, np.tile(np.arange(q.shape[1]), 2)].reshape(2, -1)
        margin = np.concatenate([ends[0] - machine.lower, machine.upper - ends[1]])
        k = int(np.argmin(margin))  # the axis and end with the smallest margin; only this one is reported
        i, joint = int(rows[k]), k % len(machine.lower)
        findings.note_lowest(margin[k], f"{arm} axis {joint + 1}")
        if margin[k] < 0.0:
            measure = measure_in_degrees(
                q[i, joint], (machine.lower if q[i, joint] < 0 else machine.upper)[joint]
            )
            message = (
                f"axis {joint + 1} of {arm} is at {measure[0]:.2f} deg; allowed: "
                f"{np.rad2deg(machine.lower[joint]):g} to {np.rad2deg(machine.upper[joint]):g}"
            )
            findings.add_at_sample(message, arm, i, measure, (f"axis {joint + 1}",))
    return findings.outcome(to_degrees, "deg margin", 0.0)


@rule("verify.rod_limits")
def rod_limits(context: Context) -> RuleOutcome:
    """For arms with parallel rods, the controller's axis 3 stays within its own limits.
    This axis is the serial angle plus axis 2.
    """
    findings = Findings("verify.rod_limits", context, worst=np.inf)
    for task in context.job.tasks:
        machine, arm = task.arm.data, task.arm.name
        if machine.coupling is None:
            continue
        axis3 = context.motion.q[arm][:, 1] + context.motion.q[arm][:, 2]
        margin = np.minimum(axis3 - machine.coupling.axis3_lower, machine.coupling.axis3_upper - axis3)
        i = int(np.argmin(margin))
        findings.note_lowest(margin[i])
        if margin[i] < 0.0:
            low, high = np.rad2deg([machine.coupling.axis3_lower, machine.coupling.axis3_upper])
            message = (
                f"axis 3 of {arm}, as the controller counts it, is at {np.rad2deg(axis3[i]):.2f} deg; "
                f"allowed: {low:g} to {high:g}"
            )
            findings.add_at_sample(message, arm, i, (to_degrees(axis3[i]), float(high), "deg"), ("axis 3",))
    return findings.outcome(to_degrees, "deg margin", 0.0, nothing="no parallel-rod arm")


@rule("verify.joint_speed")
def joint_speed(context: Context) -> RuleOutcome:
    """Joint speeds that follow from the times are within the robot's limits."""
    return _check_rates(context, "verify.joint_speed", "speed", context.motion.speed, "deg/s")


@rule("verify.joint_acceleration")
def joint_acceleration(context: Context) -> RuleOutcome:
    """Joint accelerations that follow from the times are within the robot's limits."""
    return _check_rates(
        context, "verify.joint_acceleration", "acceleration", context.motion.acceleration, "deg/s^2"
    )


def _check_rates(
    context: Context, code: str, word: str, rates: Callable[[str, int | slice], FloatArray], unit: str
) -> RuleOutcome:
    """Check joint speeds or accelerations against the robots' limits.

    Each axis is checked at each sample. One issue is reported per move that exceeds a limit, at its worst
    sample, for the first 200 such moves. For a task that is driven by trajectories, the peaks between samples
    count, too; they get an issue only if no sample exceeds a limit.

    Args:
        context: The proof.
        code: Code of the rule.
        word: ``speed`` or ``acceleration``.
        rates: Function of an arm's name and an axis (from 0) or a slice of axes. It returns the rates of
            the S samples, (S,) [rad/s, rad/s^2] for one axis or (S, J) for a slice.
        unit: Unit of the rates in messages.

    Returns:
        Outcome of the rule. Its worst value is the largest fraction of a limit, in per cent.
    """
    findings, motion = Findings(code, context, worst=0.0), context.motion
    for task in context.job.tasks:
        machine, arm = task.arm.data, task.arm.name
        limit = machine.velocity if word == "speed" else machine.acceleration
        over = np.zeros(len(motion.time), dtype=bool)
        for joint in range(len(limit)):  # one at a time to limit memory: a long motion has many samples
            fraction = np.abs(rates(arm, joint)) / limit[joint]
            findings.note_highest(np.max(fraction), f"{arm} axis {joint + 1}")
            over |= fraction > 1.0
        if task.text.is_trajectory:  # samples may miss the peak of a short cubic
            fraction, line = trajectory_peaks(task, word == "speed")
            findings.note_highest(fraction, f"{arm}, line {line}")
            if fraction > 1.0 and not over.any():
                message = (
                    f"between two points a joint of {arm} would need {100.0 * fraction:.1f} % of its {word}"
                )
                findings.add(message, arm=arm, line=line, file=min(task.files))
        # Nodes (moves) with a sample beyond a limit, and fractions (S, J) of the limits if there are any.
        nodes = np.unique(motion.node[over])
        fraction = np.abs(rates(arm, slice(None))) / limit if len(nodes) else np.zeros((0, len(limit)))
        for node in nodes[:200]:
            rows = np.flatnonzero(motion.node == node)
            k = int(rows[np.argmax(fraction[rows].max(axis=1))])
            axis = int(np.argmax(fraction[k]))
            value, limit_value = to_degrees(fraction[k, axis] * limit[axis]), to_degrees(limit[axis])
            message = (
                f"axis {axis + 1} of {arm} would need the {word} {value:.1f} {unit}; allowed: "
                f"{limit_value:.1f}"
            )
            findings.add_at_sample(message, arm, k, (value, limit_value, unit), (f"axis {axis + 1}",))
    return findings.outcome(to_percent, "% of the limit", 1.0)


@rule("verify.singularity")
def singularity(context: Context) -> RuleOutcome:
    """The arms keep the problem's margin from singular postures in all straight moves."""
    findings = Findings("verify.singularity", context, worst=np.inf)
    limit = context.problem.settings.singularity_margin
    for task in context.job.tasks:
        arm = task.arm.name
        rows = np.flatnonzero(straight_nodes(context, arm)[context.motion.node])
        if not len(rows):
            continue
        parts = np.array_split(rows, len(rows) // _SAMPLES_PER_BATCH + 1)
        machine, q = arm_model.robot_machine(task.arm.data), context.motion.q[arm]
        distance = np.concatenate([singularity_distance(machine, q[part]) for part in parts])
        k = int(np.argmin(distance))
        findings.note_lowest(distance[k], arm)
        if distance[k] < limit - np.deg2rad(0.05):  # tolerance: the text rounds
            measure = measure_in_degrees(distance[k], limit)
            message = (
                f"{arm} comes within {measure[0]:.2f} deg of a singular posture; allowed: {measure[1]:.2f}"
            )
            findings.add_at_sample(message, arm, rows[k], measure)
    return findings.outcome(to_degrees, "deg", limit)


@rule("verify.tcp_speed")
def tcp_speed(context: Context) -> RuleOutcome:
    """The tools move no faster than the problem allows.
    If the text states the time of a move, the resulting speed counts, else the stated speed. On the
    cubics of trajectories the limit holds at every instant.
    """
    motion, findings = context.motion, Findings("verify.tcp_speed", context, worst=0.0)
    limit = context.problem.settings.tcp_speed
    for task in context.job.tasks:
        arm = task.arm.name
        if task.text.is_trajectory:
            speeds = tool_speeds(context)[arm]
            findings.note_highest(speeds.world.max(initial=0.0), arm)
            # 1e-6 allows for rounding. At most 20 issues per task.
            for k in np.flatnonzero(speeds.world > limit * (1.0 + 1e-6))[:20].tolist():
                message = f"the tool of {arm} moves at up to {mm(speeds.world[k]):.1f} mm/s; allowed: "
                findings.add_at_step(f"{message}{mm(limit):.1f}", task, speeds.moves[k])
            continue
        # Steps (S - 1,) from sample to sample in timed moves, without the steps from one stage to the next.
        timed = _timed_moves(context)[motion.node[1:]] & (motion.stage[1:] == motion.stage[:-1])
        positions, speed = motion.tcp[arm].position, np.zeros(len(timed))
        for start in range(0, len(timed), _SAMPLES_PER_BATCH):
            batch = slice(start, min(start + _SAMPLES_PER_BATCH, len(timed)))
            step = np.linalg.norm(np.diff(positions[batch.start : batch.stop + 1], axis=0), axis=1)
            durations = np.maximum(np.diff(motion.time[batch.start : batch.stop + 1]), 1e-6)
            speed[batch] = np.where(timed[batch], step / durations, 0.0)
        if len(speed):
            k = int(np.argmax(speed))
            findings.note_highest(speed[k], arm)
            if speed[k] > TCP_SPEED_FACTOR * limit:
                message = f"the tool of {arm} moves at {mm(speed[k]):.1f} mm/s; allowed: {mm(limit):.1f}"
                findings.add_at_sample(message, arm, k + 1, (mm(speed[k]), mm(limit), "mm/s"))
        # Untimed moves: the stated speed counts. ``speed.turn`` is the stated rotation rate [rad/s].
        for move in task.steps:
            if not isinstance(move, MoveStep) or move.time is not None or move.speed.axes is not None:
                continue
            stated = move.velocity if move.velocity is not None else move.speed.tcp
            if stated > limit * (1.0 + 1e-6):
                message = f"the move's speed is {mm(stated):g} mm/s; allowed: {mm(limit):g} mm/s"
                findings.add_at_step(message, task, move)
            if move.speed.turn > MAX_UNTIMED_ROTATION_RATE_RAD_S:
                message = (
                    f"the tool may turn at {np.rad2deg(move.speed.turn):g} deg/s in a move without a time; "
                    f"allowed: {np.rad2deg(MAX_UNTIMED_ROTATION_RATE_RAD_S):g} deg/s"
                )
                findings.add_at_step(message, task, move)
    return findings.outcome(mm, "mm/s", limit)


def _timed_moves(context: Context) -> BoolArray:
    """Return flags (K,) of the nodes whose moves are checked by their replayed speed, one per node (move).

    They are the moves for which the text of any task states a time, or fractions of the axes' speeds.
    """
    motion = context.motion
    out = np.zeros(len(motion.node_segment), dtype=bool)
    for number, stage in enumerate(context.job.stages):
        rows = np.flatnonzero(motion.node_stage == number)
        for task in context.job.tasks:
            moves = stage.moves(task.name)[: len(rows)]
            flags = [move.time is not None or move.speed.axes is not None for move in moves]
            out[rows[: len(flags)]] |= np.array(flags, dtype=bool)
    return out


def straight_nodes(context: Context, arm: str) -> BoolArray:
    """Return flags (K,), one per node of the motion: whether the arm reaches it by a straight move.

    Several rules hold in straight moves only. A node at which the arm has no move has the flag False.
    """
    return context.get(_STRAIGHT_NODES)[arm]


def _straight_nodes(context: Context) -> dict[str, BoolArray]:
    """Return flags (K,) of the nodes that each arm reaches by a straight move, by the name of the arm."""
    stages, out = context.motion.node_stage, {}
    for task in context.job.tasks:
        lines = context.motion.node_line[task.arm.name]
        flags = out[task.arm.name] = np.zeros(len(lines), dtype=bool)
        for number, stage in enumerate(context.job.stages):
            rows = np.flatnonzero((stages == number) & (lines > 0))  # line 0: the arm has no move there
            for row, move in zip(rows, stage.moves(task.name), strict=False):
                flags[row] = not move.by_joints
    return out


_STRAIGHT_NODES: Final[Fact[Context, dict[str, BoolArray]]] = Fact("straight nodes", _straight_nodes)
"""Flags (K,) of the nodes that each arm reaches by a straight move, by the name of the arm."""


def trajectory_peaks(task: TaskText, speed: bool) -> tuple[float, int]:
    """Return the largest fraction of a joint limit on the cubics of a task's trajectories.

    Each move is one cubic per joint. The rules on joint speed and acceleration use the result, because
    samples may miss the peak of a short cubic. It is exact.

    Args:
        task: Task that is driven by trajectories.
        speed: Whether the limit is that of speed, rather than of acceleration.

    Returns:
        Fraction of the limit, and the line of the point at the end of that cubic. Both are 0 without moves.
    """
    robot = task.arm.data
    steps = [step for step in task.steps if isinstance(step, MoveStep)]
    if not steps:
        return 0.0, 0
    q, v = trajectory_knots(robot, steps, task.arm.home)
    span = np.array([max(step.time or 0.0, 1e-9) for step in steps])[:, None]
    mean, start_velocity, v = np.diff(q, axis=0) / span, v[:-1], v[1:]
    # Hermite cubic: accelerations a0 = (6 m - 4 v0 - 2 v1) / T and a1 = (2 v0 + 4 v1 - 6 m) / T at its ends.
    first = (6.0 * mean - 4.0 * start_velocity - 2.0 * v) / span
    last = (2.0 * start_velocity + 4.0 * v - 6.0 * mean) / span
    if speed:
        # The speed is largest at an end, or at the extremum where the acceleration is 0. ``extremum`` is its
        # fraction of the duration, 0 if the acceleration is constant.
        extremum = np.clip(first / np.where(first == last, np.inf, first - last), 0.0, 1.0)
        middle = start_velocity + span * extremum * (first + 0.5 * extremum * (last - first))
        fraction = np.abs(np.stack([start_velocity, v, middle])).max(axis=0) / robot.velocity
    else:
        fraction = np.maximum(np.abs(first), np.abs(last)) / robot.acceleration
    max_fractions = fraction.max(axis=1)
    worst_index = int(np.argmax(max_fractions))
    return float(max_fractions[worst_index]), steps[worst_index].line


MIN_DRAKE_SAMPLES: Final = 1000
"""Number of samples of a motion at which every link is compared with Drake. Each setup has at least a tenth
of them.
"""
LINK_POSE_TOLERANCE: Final = 1e-9
"""Tolerance between two computations of a link's pose [m, and each entry of the rotation]."""
TCP_TOLERANCE_M: Final = 1e-6
"""Tolerance [m] between a tool in Drake and in the replay, because the text rounds the values of the tool."""


@rule("verify.robot_model")
def robot_model(context: Context) -> RuleOutcome:
    """The robots' URDF files describe arms that the proof supports.
    The dimensions and limits with which the programs were planned are those of the files.
    """
    findings = Findings(arm_model.ROBOT_MODEL, context)
    cells = [context.problem.cell, *(setup.cell for setup in context.setups)]
    names = {arm.robot: arm.data for cell in cells for arm in cell.arms}
    for name, data in sorted(names.items()):
        try:
            differences = arm_model.compare_with_catalogue(arm_model.robot_machine(data))
        except TandemError as error:
            findings.issues += error.issues
            continue
        for difference in differences:
            findings.add(f"the robot {name}: {difference}", hint=arm_model.robot_hint(data))
    for stated, data in _robots_from_files(context.problem.source, context.problem.cell):
        for difference in arm_model.compare_with_problem(stated, data):
            findings.add(f"the robot {data.name}: {difference}", hint=arm_model.robot_hint(data))
    return findings.outcome_without_value(where=", ".join(sorted(names)))


def _robots_from_files(
    source: Mapping[str, Any], cell: Cell
) -> Iterator[tuple[Mapping[str, Any], RobotData]]:
    """Yield the robots whose data come from a file of the user, to compare the data with the problem.

    Each has the mapping that the problem states for it (empty if it states only a name), and its data.
    """
    stated = source.get("cell", {}).get("arms", []) if isinstance(source.get("cell"), Mapping) else []
    for arm, stated_arm in zip(cell.arms, stated, strict=False):
        if arm.custom_data is not None:
            yield (stated_arm["robot"] if isinstance(stated_arm["robot"], Mapping) else {}), arm.custom_data


@rule("verify.kinematics", parallel_group="bodies")
def kinematics(context: Context) -> RuleOutcome:
    """Drake puts every link where the robots' files and the clearance bounds put it.
    Tools and a held block are where the replay has them.
    """
    models, findings = context.get(MODELS), Findings("verify.kinematics", context, worst=0.0)
    count = 0
    total = len(context.sample_setup)
    for index in range(len(context.setups)):
        rows = np.flatnonzero(context.sample_setup == index)
        if not len(rows):
            continue
        count_here = max(MIN_DRAKE_SAMPLES * len(rows) // total, MIN_DRAKE_SAMPLES // 10)
        samples = rows[np.unique(np.linspace(0, len(rows) - 1, count_here).astype(np.int64))]
        _compare_poses(context, models(index), index, samples, findings)
        count += len(samples)
    return dataclasses.replace(
        findings.outcome(mm, "mm", TCP_TOLERANCE_M), where=f"every link at {count} samples"
    )


def _compare_poses(
    context: Context, model: CellModel, index: int, rows: IntArray, findings: Findings
) -> None:
    """Compare the poses of bodies of setup ``index`` at samples ``rows`` (K,) with those that Drake computes.

    Three other computations are compared with Drake: the URDF chains (links), the clearance bounds (all
    bodies), and the replay (TCPs and a held block). Each body whose poses differ is reported once per
    comparison, at its worst sample.
    """
    motion, model = context.motion, model.with_bases(context.track_base_poses(index, rows))
    at_home = {arm.name: np.tile(arm.home, (len(rows), 1)) for arm in model.cell.arms}
    q = at_home | {arm: np.asarray(angles[rows]) for arm, angles in motion.link_joints.items()}
    drake = _drake_poses(model, q)
    held = context.stock_holder(index)
    tools = {f"{arm}/tool": model.cell.arm(arm).tool.tcp for arm in motion.q}
    replayed = {name: motion.tcp[name.removesuffix("/tool")][rows] for name in tools}
    if held is not None and held.arm in motion.q:
        replayed["stock"], tools["stock"] = context.stock_poses(index, rows), np.eye(4)
    drake_tools = {name: drake[name] @ tool for name, tool in tools.items()}
    for sources, poses, drake_poses, limit in (
        ("according to its URDF chain and to Drake", _chain_poses(model, q), drake, LINK_POSE_TOLERANCE),
        ("according to the clearance bounds and to Drake", model.poses(q), drake, LINK_POSE_TOLERANCE),
        ("according to the replay and to Drake", replayed, drake_tools, TCP_TOLERANCE_M),
    ):
        for name in sorted(poses.keys() & drake_poses.keys()):
            deviation = np.abs(poses[name] - drake_poses[name]).reshape(len(rows), -1).max(axis=1)
            k = int(np.argmax(np.where(np.isfinite(deviation), deviation, np.inf)))  # NaN is the worst
            findings.note_highest(deviation[k])
            if not deviation[k] <= limit:
                message = f"{name} has two poses that differ by {mm(deviation[k]):.6f} mm, {sources}"
                arm = name.split("/")[0] if name.split("/")[0] in motion.q else next(iter(motion.q))
                findings.add_at_sample(message, arm, rows[k], measure_in_mm(deviation[k], limit), (name,))


def _drake_poses(model: CellModel, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the poses (K, 4, 4) of all links, tools and a held block in the world, by name of the body.

    Drake's plant computes them at the K postures of ``q`` {arm: (K, J)}.
    """
    names = [f"{arm}/{link}" for arm in model.arms for link in _body_names(len(model.cell.arm(arm).home))]
    names += ["stock"] if model.stock.held_by is not None else []
    bodies = [model.body(name) for name in names]
    rows = model.stack_rows(q)
    out = np.empty((len(bodies), len(rows), 4, 4))
    plant = model.plant
    for k, row in enumerate(rows):
        positions = model.at_rows(k).checker.UpdatePositions(row)
        for i, body in enumerate(bodies):
            out[i, k] = plant.EvalBodyPoseInWorld(positions, body).GetAsMatrix4()
    return dict(zip(names, out, strict=True))


def _body_names(joints: int) -> tuple[str, ...]:
    """Return the names of the bodies of an arm with this number of joints, from base to tool."""
    return ("base_link", *(f"link_{i + 1}" for i in range(joints)), "tool")


def _chain_poses(model: CellModel, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the poses (K, 4, 4) of all links except the base in the world, by ``arm/link``.

    They follow from joints ``q`` {arm: (K, J)} and the URDF chains, without Drake. The last one is the
    flange. It has the name of the tool's body, because that body has the frame of the flange.
    """
    out = {}
    for arm, rows in q.items():
        chain = arm_model.robot_machine(model.cell.arm(arm).data).chain
        frames = model.bases[arm].reshape(-1, 1, 4, 4) @ chain.frames(rows)
        for i, link in enumerate(_body_names(len(chain.axis))[1:]):
            out[f"{arm}/{link}"] = frames[:, i]
    return out
