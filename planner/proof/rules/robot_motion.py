"""Rules on the positions of robots, and on the replayed motion of their joints and tools.

verify.robot_model and kinematics compare the robots' files with the catalogue, and every link with Drake.
The others are verify.reach, corner, continuity, joint_limits, rod_limits, joint_speed,
joint_acceleration, singularity and tcp_speed.
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
from planner.proof.findings import Findings, degrees, in_degrees, in_mm, percent
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.inverse_kinematics import singularity_distance
from planner.proof.models import MODELS
from planner.proof.replay.moves import driven_knots
from planner.proof.replay.tool_speeds import tool_speeds
from planner.proof.rule import Outcome, mm, rule
from planner.proof.rules.setups_and_frames import at_home

JOINT_JUMP = np.deg2rad(8.0)
"""A joint that turns farther than this [rad] from one sample to the next (4 ms) has changed its solution,
not moved."""
TCP_SLACK = 1.10
"""The replay's ramps may exceed the planned speed between targets by this factor."""
UNTIMED_TURN_RATE = np.deg2rad(90.0)
"""Fastest turning [rad/s] that may be stated for moves that have no time: what a tool has far from its TCP
moves with it."""
_SAMPLES_AT_ONCE = 65_536
"""Samples that are worked out at once where much is needed on the way."""


@rule("verify.reach")
def reach(context: Context) -> Outcome:
    """The arms can go the path that the text states."""
    return _faults(context, "verify.reach", ("reach", "motion"))


@rule("verify.corner")
def corners(context: Context) -> Outcome:
    """No zone joins a joint move and a straight one."""
    return _faults(context, "verify.corner", ("corner",), "stop there")


def _faults(context: Context, code: str, kinds: tuple[str, ...], hint: str | None = None) -> Outcome:
    findings = Findings(code, context)
    for fault in context.motion.faults:
        if fault.kind in kinds:
            findings.add(fault.message, file=fault.task, line=fault.line, index=fault.index, hint=hint)
    return findings.outcome_without_value()


@rule("verify.continuity")
def continuity(context: Context) -> Outcome:
    """The joints go on from where they were, from home to home: no jump between samples or moves."""
    findings = Findings("verify.continuity", context, worst=0.0)
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        edges = zip((*moves[:1], *moves[-1:]), ("first", "last"), strict=False)
        if task.text.is_trajectory:  # verify.start_posture has it begin at home
            edges = zip(moves[-1:], ("last",), strict=False)
        for move, word in edges:
            if not at_home(move, task.arm.data, task.arm.home):
                what = f"the {word} move of {task.arm.name} does not go home by its joints"
                findings.at_step(what, task, move)
    for arm, q in context.motion.q.items():
        jumps = np.zeros(max(len(q) - 1, 0), dtype=bool)
        for angle in q.T:  # one at a time: a long motion has many samples
            step = np.abs(np.diff(angle))
            findings.highest(step.max(initial=0.0))
            jumps |= step > JOINT_JUMP
        for i in np.flatnonzero(jumps)[:20]:
            steps = np.abs(q[i + 1] - q[i])
            axis = f"axis {int(np.argmax(steps)) + 1}"
            message = f"{axis} jumps by {np.rad2deg(steps.max()):.2f} deg between two samples"
            findings.at_sample(message, arm, i + 1, in_degrees(steps.max(), JOINT_JUMP), (axis,))
    return findings.outcome(degrees, "deg", JOINT_JUMP)


@rule("verify.joint_limits")
def joint_limits(context: Context) -> Outcome:
    """Every axis stays within its limits."""
    findings = Findings("verify.joint_limits", context, worst=np.inf)
    for task in context.job.tasks:
        machine, arm = task.arm.data, task.arm.name
        q = context.motion.q[arm]
        # one axis at a time: a long motion has many samples
        rows = np.array([*(int(axis.argmin()) for axis in q.T), *(int(axis.argmax()) for axis in q.T)])
        ends = q[rows, np.tile(np.arange(q.shape[1]), 2)].reshape(2, -1)
        margin = np.concatenate([ends[0] - machine.lower, machine.upper - ends[1]])
        k = int(np.argmin(margin))
        i, joint = int(rows[k]), k % len(machine.lower)
        findings.lowest(margin[k], f"{arm} axis {joint + 1}")
        if margin[k] < 0.0:
            measure = in_degrees(q[i, joint], (machine.lower if q[i, joint] < 0 else machine.upper)[joint])
            message = (
                f"axis {joint + 1} of {arm} is at {measure[0]:.2f} deg; allowed: "
                f"{np.rad2deg(machine.lower[joint]):g} to {np.rad2deg(machine.upper[joint]):g}"
            )
            findings.at_sample(message, arm, i, measure, (f"axis {joint + 1}",))
    return findings.outcome(degrees, "deg margin", 0.0)


@rule("verify.rod_limits")
def rod_limits(context: Context) -> Outcome:
    """Parallel-rod arms: the controller's axis 3, serial angle plus axis 2, is within its own limits too."""
    findings = Findings("verify.rod_limits", context, worst=np.inf)
    for task in context.job.tasks:
        machine, arm = task.arm.data, task.arm.name
        if machine.coupling is None:
            continue
        axis3 = context.motion.q[arm][:, 1] + context.motion.q[arm][:, 2]
        margin = np.minimum(axis3 - machine.coupling.axis3_lower, machine.coupling.axis3_upper - axis3)
        i = int(np.argmin(margin))
        findings.lowest(margin[i])
        if margin[i] < 0.0:
            low, high = np.rad2deg([machine.coupling.axis3_lower, machine.coupling.axis3_upper])
            message = (
                f"axis 3 of {arm}, as the controller counts it, is at {np.rad2deg(axis3[i]):.2f} deg; "
                f"allowed: {low:g} to {high:g}"
            )
            findings.at_sample(message, arm, i, (degrees(axis3[i]), float(high), "deg"), ("axis 3",))
    return findings.outcome(degrees, "deg margin", 0.0, nothing="no parallel-rod arm")


@rule("verify.joint_speed")
def joint_speed(context: Context) -> Outcome:
    """Joint speeds that the times ask for are within the robot's."""
    return _rates(context, "verify.joint_speed", "speed", context.motion.speed, "deg/s")


@rule("verify.joint_acceleration")
def joint_acceleration(context: Context) -> Outcome:
    """Joint accelerations that the times ask for are within the robot's."""
    return _rates(
        context, "verify.joint_acceleration", "acceleration", context.motion.acceleration, "deg/s^2"
    )


def _rates(
    context: Context, code: str, word: str, rates: Callable[[str, int | slice], FloatArray], unit: str
) -> Outcome:
    findings, motion = Findings(code, context, worst=0.0), context.motion
    for task in context.job.tasks:
        machine, arm = task.arm.data, task.arm.name
        limit = machine.velocity if word == "speed" else machine.acceleration
        over = np.zeros(len(motion.time), dtype=bool)
        for joint in range(len(limit)):  # one at a time: a long motion has many samples
            share = np.abs(rates(arm, joint)) / limit[joint]
            findings.highest(np.max(share), f"{arm} axis {joint + 1}")
            over |= share > 1.0
        if task.text.is_trajectory:  # samples may lie beside the peak of a short cubic
            share, line = trajectory_peaks(task, word == "speed")
            findings.highest(share, f"{arm}, line {line}")
            if share > 1.0 and not over.any():
                what = f"between two points a joint of {arm} would need {100.0 * share:.1f} % of its {word}"
                findings.add(what, arm=arm, line=line, file=min(task.files))
        nodes = np.unique(motion.node[over])
        share = np.abs(rates(arm, slice(None))) / limit if len(nodes) else np.zeros((0, len(limit)))
        for node in nodes[:200]:
            rows = np.flatnonzero(motion.node == node)
            k = int(rows[np.argmax(share[rows].max(axis=1))])
            axis = int(np.argmax(share[k]))
            value, most = degrees(share[k, axis] * limit[axis]), degrees(limit[axis])
            message = (
                f"axis {axis + 1} of {arm} would need the {word} {value:.1f} {unit}; allowed: {most:.1f}"
            )
            findings.at_sample(message, arm, k, (value, most, unit), (f"axis {axis + 1}",))
    return findings.outcome(percent, "% of the limit", 1.0)


@rule("verify.singularity")
def singularity(context: Context) -> Outcome:
    """The arms keep off their singular postures by the problem's margin wherever they move straight."""
    findings = Findings("verify.singularity", context, worst=np.inf)
    limit = context.problem.settings.singularity_margin
    for task in context.job.tasks:
        arm = task.arm.name
        rows = np.flatnonzero(straight_nodes(context, arm)[context.motion.node])
        if not len(rows):
            continue
        parts = np.array_split(rows, len(rows) // _SAMPLES_AT_ONCE + 1)
        machine, q = arm_model.machine_of(task.arm.data), context.motion.q[arm]
        distance = np.concatenate([singularity_distance(machine, q[part]) for part in parts])
        k = int(np.argmin(distance))
        findings.lowest(distance[k], arm)
        if distance[k] < limit - np.deg2rad(0.05):
            measure = in_degrees(distance[k], limit)
            message = (
                f"{arm} comes within {measure[0]:.2f} deg of a singular posture; allowed: {measure[1]:.2f}"
            )
            findings.at_sample(message, arm, rows[k], measure)
    return findings.outcome(degrees, "deg", limit)


@rule("verify.tcp_speed")
def tcp_speed(context: Context) -> Outcome:
    """The tools move no faster than the problem allows: where the text states the time of a move by what
    follows from it, elsewhere by the speed that it states; on the cubics of trajectories at every instant."""
    motion, findings = context.motion, Findings("verify.tcp_speed", context, worst=0.0)
    limit = context.problem.settings.tcp_speed
    for task in context.job.tasks:
        arm = task.arm.name
        if task.text.is_trajectory:
            own = tool_speeds(context)[arm]
            findings.highest(own.world.max(initial=0.0), arm)
            for k in np.flatnonzero(own.world > limit * (1.0 + 1e-6))[:20].tolist():
                message = f"the tool of {arm} moves at up to {mm(own.world[k]):.1f} mm/s; allowed: "
                findings.at_step(f"{message}{mm(limit):.1f}", task, own.moves[k])
            continue
        timed = _timed(context)[motion.node[1:]] & (motion.stage[1:] == motion.stage[:-1])
        place, speed = motion.tcp[arm].place, np.zeros(len(timed))
        for begin in range(0, len(timed), _SAMPLES_AT_ONCE):
            some = slice(begin, min(begin + _SAMPLES_AT_ONCE, len(timed)))
            step = np.linalg.norm(np.diff(place[some.start : some.stop + 1], axis=0), axis=1)
            spent = np.maximum(np.diff(motion.time[some.start : some.stop + 1]), 1e-6)
            speed[some] = np.where(timed[some], step / spent, 0.0)
        if len(speed):
            k = int(np.argmax(speed))
            findings.highest(speed[k], arm)
            if speed[k] > TCP_SLACK * limit:
                message = f"the tool of {arm} moves at {mm(speed[k]):.1f} mm/s; allowed: {mm(limit):.1f}"
                findings.at_sample(message, arm, k + 1, (mm(speed[k]), mm(limit), "mm/s"))
        for move in task.steps:
            if not isinstance(move, MoveStep) or move.time is not None or move.speed.axes is not None:
                continue
            stated = move.velocity if move.velocity is not None else move.speed.tcp
            if stated > limit * (1.0 + 1e-6):
                message = f"the move's speed is {mm(stated):g} mm/s; allowed: {mm(limit):g} mm/s"
                findings.at_step(message, task, move)
            if move.speed.turn > UNTIMED_TURN_RATE:
                message = (
                    f"the tool may turn at {np.rad2deg(move.speed.turn):g} deg/s in a move without a time; "
                    f"allowed: {np.rad2deg(UNTIMED_TURN_RATE):g} deg/s"
                )
                findings.at_step(message, task, move)
    return findings.outcome(mm, "mm/s", limit)


def _timed(context: Context) -> BoolArray:
    """Moves (K,) in which some arm runs by a stated time, or by stated shares of its axes' speeds."""
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
    """Nodes (K,) that the arm reaches by a straight move."""
    return context.get(_STRAIGHT)[arm]


def _straight(context: Context) -> dict[str, BoolArray]:
    """Nodes (K,) that each arm reaches by a straight move."""
    stages, out = context.motion.node_stage, {}
    for task in context.job.tasks:
        lines = context.motion.node_line[task.arm.name]
        flags = out[task.arm.name] = np.zeros(len(lines), dtype=bool)
        for number, stage in enumerate(context.job.stages):
            rows = np.flatnonzero((stages == number) & (lines > 0))
            for row, move in zip(rows, stage.moves(task.name), strict=False):
                flags[row] = not move.by_joints
    return out


_STRAIGHT: Final[Fact[Context, dict[str, BoolArray]]] = Fact("straight nodes", _straight)
"""Nodes (K,) that each arm reaches by a straight move."""


def trajectory_peaks(task: TaskText, speed: bool) -> tuple[float, int]:
    """The largest share of a limit that a joint of an arm needs on the cubics of its trajectories, of its
    ``speed`` or else of its acceleration, and the line of the point behind; exactly, whatever the samples."""
    robot = task.arm.data
    steps = [step for step in task.steps if isinstance(step, MoveStep)]
    if not steps:
        return 0.0, 0
    q, v = driven_knots(robot, steps, task.arm.home)
    span = np.array([max(step.time or 0.0, 1e-9) for step in steps])[:, None]
    mean, before, v = np.diff(q, axis=0) / span, v[:-1], v[1:]
    first = (6.0 * mean - 4.0 * before - 2.0 * v) / span
    last = (2.0 * before + 4.0 * v - 6.0 * mean) / span
    if speed:
        turn = np.clip(first / np.where(first == last, np.inf, first - last), 0.0, 1.0)  # acceleration 0
        middle = before + span * turn * (first + 0.5 * turn * (last - first))
        share = np.abs(np.stack([before, v, middle])).max(axis=0) / robot.velocity
    else:
        share = np.maximum(np.abs(first), np.abs(last)) / robot.acceleration
    most = share.max(axis=1)
    worst = int(np.argmax(most))
    return float(most[worst]), steps[worst].line


DRAKE_SAMPLES: Final = 1000
"""Samples of a motion at which every link is held against Drake; each setup has a tenth of them at least."""
LINK_ERROR: Final = 1e-9
"""How far two ways to work out where a link is may differ [m, and in each entry of the rotation]."""
TCP_ERROR: Final = 1e-6
"""How far a tool may be from where the replay has it [m]: the text's figures of the tool are rounded."""


@rule("verify.robot_model")
def robot_model(context: Context) -> Outcome:
    """The robots' URDF files are those of arms that the proof can follow, and dimensions and limits that
    the programs were planned with are theirs."""
    findings = Findings(arm_model.ROBOT_MODEL, context)
    cells = [context.problem.cell, *(setup.cell for setup in context.setups)]
    names = {arm.robot: arm.data for cell in cells for arm in cell.arms}
    for name, data in sorted(names.items()):
        try:
            differ = arm_model.differences(arm_model.machine_of(data))
        except TandemError as error:
            findings.issues += error.issues
            continue
        for what in differ:
            findings.add(f"the robot {name}: {what}", hint=arm_model.hint_of(data))
    for given, data in _from_files(context.problem.source, context.problem.cell):
        for what in arm_model.stated_otherwise(given, data):
            findings.add(f"the robot {data.name}: {what}", hint=arm_model.hint_of(data))
    return findings.outcome_without_value(where=", ".join(sorted(names)))


def _from_files(source: Mapping[str, Any], cell: Cell) -> Iterator[tuple[Mapping[str, Any], RobotData]]:
    stated = source.get("cell", {}).get("arms", []) if isinstance(source.get("cell"), Mapping) else []
    for arm, own in zip(cell.arms, stated, strict=False):
        if arm.given is not None:
            yield (own["robot"] if isinstance(own["robot"], Mapping) else {}), arm.given


@rule("verify.kinematics", ahead="bodies")
def kinematics(context: Context) -> Outcome:
    """Drake puts every link where the robots' files do, and so does what bounds the clearance; the tools,
    and the block that one holds, are where the replay has them."""
    models, findings = context.get(MODELS), Findings("verify.kinematics", context, worst=0.0)
    count = 0
    total = len(context.sample_setup)
    for index in range(len(context.setups)):
        rows = np.flatnonzero(context.sample_setup == index)
        if not len(rows):
            continue
        wanted = max(DRAKE_SAMPLES * len(rows) // total, DRAKE_SAMPLES // 10)
        some = rows[np.unique(np.linspace(0, len(rows) - 1, wanted).astype(np.int64))]
        _setup(context, models(index), index, some, findings)
        count += len(some)
    return dataclasses.replace(findings.outcome(mm, "mm", TCP_ERROR), where=f"every link at {count} samples")


def _setup(context: Context, model: CellModel, index: int, rows: IntArray, findings: Findings) -> None:
    """Bodies of a setup that are elsewhere by one way than by another at samples ``rows`` (K,), each at its
    worst sample."""
    motion, model = context.motion, model.with_bases(context.ridden(index, rows))
    at_home = {arm.name: np.tile(arm.home, (len(rows), 1)) for arm in model.cell.arms}
    q = at_home | {arm: np.asarray(angles[rows]) for arm, angles in motion.links.items()}
    drake = _drake(model, q)
    held = context.holder(index)
    tools = {f"{arm}/tool": model.cell.arm(arm).tool.tcp for arm in motion.q}
    replayed = {name: motion.tcp[name.removesuffix("/tool")][rows] for name in tools}
    if held is not None and held.arm in motion.q:
        replayed["stock"], tools["stock"] = context.stock_poses(index, rows), np.eye(4)
    places = {name: drake[name] @ tool for name, tool in tools.items()}
    for words, ours, theirs, limit in (
        ("by the chain of its URDF, and by Drake", _chains(model, q), drake, LINK_ERROR),
        ("by what bounds the clearance, and by Drake", model.poses(q), drake, LINK_ERROR),
        ("by the replay, and by Drake", replayed, places, TCP_ERROR),
    ):
        for name in sorted(ours.keys() & theirs.keys()):
            off = np.abs(ours[name] - theirs[name]).reshape(len(rows), -1).max(axis=1)
            k = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
            findings.highest(off[k])
            if not off[k] <= limit:
                message = f"{name} is at two places that are {mm(off[k]):.6f} mm apart: {words}"
                arm = name.split("/")[0] if name.split("/")[0] in motion.q else next(iter(motion.q))
                findings.at_sample(message, arm, rows[k], in_mm(off[k], limit), (name,))


def _drake(model: CellModel, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Poses (K, 4, 4) in the world of all links and tools, and of a held block, by Drake's plant."""
    names = [f"{arm}/{link}" for arm in model.arms for link in _bodies(len(model.cell.arm(arm).home))]
    names += ["stock"] if model.stock.held_by is not None else []
    some = [model.body(name) for name in names]
    rows = model.stack(q)
    out = np.empty((len(some), len(rows), 4, 4))
    plant = model.plant
    for k, row in enumerate(rows):
        at = model.at_rows(k).checker.UpdatePositions(row)
        for i, body in enumerate(some):
            out[i, k] = plant.EvalBodyPoseInWorld(at, body).GetAsMatrix4()
    return dict(zip(names, out, strict=True))


def _bodies(joints: int) -> tuple[str, ...]:
    """Bodies of an arm of so many joints from its base to its tool."""
    return ("base_link", *(f"link_{i + 1}" for i in range(joints)), "tool")


def _chains(model: CellModel, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The same of the links and the flange, which a tool's body stands in, by the chains of the URDFs."""
    out = {}
    for arm, rows in q.items():
        chain = arm_model.machine_of(model.cell.arm(arm).data).chain
        frames = model.bases[arm].reshape(-1, 1, 4, 4) @ chain.frames(rows)
        for i, link in enumerate(_bodies(len(chain.axis))[1:]):
            out[f"{arm}/{link}"] = frames[:, i]
    return out
