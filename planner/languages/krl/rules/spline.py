"""The rule verify.spline: bounds how far the curves of KRL's spline blocks deviate from the replay.

The replay is straight from point to point (:mod:`planner.proof.replay.moves`), but a controller's curve may
deviate from it. :mod:`planner.languages.krl.reader.spline_curve` bounds the deviation, :class:`Allowance`
holds the maximum, and :func:`tightened` subtracts it from clearance, margins, tolerances and feeds. All other
rules then check the straight moves with correspondingly less margin.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.claims.claim import Allowance, kinds_on_straight_moves
from planner.geometry.arrays import FloatArray, IntArray, log_rotation
from planner.issues import Issue
from planner.languages.krl.reader import spline_curve
from planner.languages.krl.reader.spline_curve import ROTATION_LEVER_M_PER_RAD, SplineCurveBounds
from planner.languages.krl.reader.syntax_tree import SPLINE_MOVE
from planner.programs.stages import TaskText
from planner.programs.steps import JointTarget, MoveStep, PassedTarget, poses
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.replay.moves import PATH_ACCURACY_M, PATH_ACCURACY_RAD
from planner.proof.rule import RuleOutcome, mm, rule, step_issue
from planner.proof.rules.robot_motion import TCP_SPEED_FACTOR

SPLINE: Final = "verify.spline"
"""Code of this rule."""
MAX_DEVIATION_M: Final = 0.1e-3
"""Maximum deviation of a curve from its straight segments [m]: it must not use up a part's tolerance."""
MAX_SPEED_FACTOR: Final = 1.15
"""Maximum speed of a tool between two points, relative to the fastest of the segment's moves near them."""
JOINT_RATE_FACTOR: Final = 1.25
"""Bound on joint change per distance, relative to its values at the ends and the middle of a segment."""
JOINT_RATE_SPREAD: Final = 1.5
"""Maximum ratio between these values."""
BODY_RADIUS_M: Final = 0.4
"""Maximum distance [m] of bodies of an arm from the line through its joints and its tool tip."""
NOT_OBSERVED_TEXT: Final = "not seen on a controller"
"""Text of proofs on how controllers plan blocks."""


@dataclasses.dataclass(frozen=True)
class SplineBlock:
    """A spline block.

    Attributes:
        task: Its task.
        moves: Its N moves.
        nodes: Indices of their end points among the nodes of the motion, (N,).
        pose: Points in the work frame, (N + 1, 4, 4) [m].
        work: Work frame in the world, (4, 4) [m].
        tool: TCP in the flange frame, (4, 4) [m].
        duration: Times of the moves, (N,) [s].
    """

    task: TaskText
    moves: tuple[MoveStep, ...]
    nodes: IntArray
    pose: FloatArray
    work: FloatArray
    tool: FloatArray
    duration: FloatArray


def blocks(context: Context) -> Iterator[SplineBlock]:
    """Yield the spline blocks of all tasks, in order. A block ends with its first move to a stop."""
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        first = None
        for k, move in enumerate(moves):
            if move.kind != SPLINE_MOVE:
                continue
            first = k if first is None else first
            # only the last move of a block ends in a stop
            if move.zone.fine:
                yield _block(task, moves, first, k + 1)
                first = None


def _block(task: TaskText, moves: list[MoveStep], first: int, end: int) -> SplineBlock:
    """Return the block of the moves ``first`` to ``end`` - 1 of a task.

    The first point of the block is the target of the move before it, which must be a pose.
    """
    block_moves = tuple(moves[first:end])
    targets = [move.target for move in moves[max(first - 1, 0) : end]]
    without_pose = JointTarget | PassedTarget
    position = np.array([target.position for target in targets if not isinstance(target, without_pose)])
    quaternion = np.array([target.quaternion for target in targets if not isinstance(target, without_pose)])
    work_frame = block_moves[0].wobj.user @ block_moves[0].wobj.object
    times = np.array([move.time or 0.0 for move in block_moves])
    return SplineBlock(
        task,
        block_moves,
        np.arange(first, end),
        poses(position, quaternion),
        work_frame,
        block_moves[0].tool.pose,
        times,
    )


@rule("verify.spline")
def spline(context: Context) -> RuleOutcome:
    """KRL: any quintic curve of a spline block is near enough to the straight moves, and not too fast.

    All other rules then hold with a correspondingly smaller margin.
    """
    all_blocks = list(blocks(context))
    if not all_blocks:
        return RuleOutcome(nothing="no spline block")
    issues = _refusals(context, all_blocks)
    if issues:
        return RuleOutcome(tuple(issues))
    allowances: list[Allowance] = []
    max_deviation = 0.0
    for block in all_blocks:
        bounds = spline_curve.bound_curves(block.pose, block.duration)
        issues += _deviation_issues(block, bounds) + _speed_issues(context, block, bounds)
        max_deviation = max(max_deviation, float(bounds.deviation.max()))
        allowance, wrong = _joint_allowance(context, block, bounds)
        issues += wrong
        allowances.append(allowance)
    combined = Allowance(
        np.concatenate([allowance.position for allowance in allowances]),
        np.concatenate([allowance.rotation for allowance in allowances]),
        max(allowance.joints for allowance in allowances),
        max(allowance.body for allowance in allowances),
        MAX_SPEED_FACTOR,
    )
    if not issues:
        issues += _used_up_claims(context, all_blocks[0], combined)
    points = sum(len(block.moves) for block in all_blocks)
    where = f"{len(all_blocks)} blocks of {points} points, planning {NOT_OBSERVED_TEXT}"
    return RuleOutcome(
        tuple(issues),
        mm(max_deviation),
        mm(MAX_DEVIATION_M),
        "mm from the straight moves",
        where,
        context=None if issues else tightened(context, combined),
    )


def _refusals(context: Context, all_blocks: list[SplineBlock]) -> list[Issue]:
    """Return the reasons why the job may have no spline block at all, or why blocks cannot be bounded.

    These are: a cell without ``path: spline``, work of two arms, an arm with parallel rods, a claim that is
    proven on straight moves only, a minimum feed, and a motion that lacks moves of a block.
    """
    issues = []
    controller, first = context.problem.cell.controller, all_blocks[0]
    if controller.path != "spline":
        message = "a spline block, but the cell's controller has path: slin; write SLIN, or set path: spline"
        issues.append(step_issue(SPLINE, message, first.task, first.moves[0]))
    if len(context.job.tasks) > 1:
        message = "a spline block in work of two arms; allowed: a single arm; write SLIN"
        issues.append(step_issue(SPLINE, message, first.task, first.moves[0]))
    for block in all_blocks:
        if arm_model.robot_machine(block.task.arm.data).data.coupling is not None:
            message = "a spline block of an arm with parallel rods, whose joints are not bounded; write SLIN"
            issues.append(step_issue(SPLINE, message, block.task, block.moves[0]))
    for kind in kinds_on_straight_moves(context.claims):
        message = f"a spline block in a job that claims {kind}, which is proven on straight moves only"
        issues.append(step_issue(SPLINE, f"{message}; write SLIN", first.task, first.moves[0]))
    for claim in context.feeds:
        if claim.lower > 0.0:
            message = (
                f"a spline block where {claim.segment} has a minimum feed, but a curve has no minimum speed"
            )
            issues.append(step_issue(SPLINE, f"{message}; write SLIN", first.task, first.moves[0]))
    if (
        not issues
        and context.motion.node_segment
        and len(context.motion.node_segment) < 1 + max(int(block.nodes[-1]) for block in all_blocks)
    ):
        issues.append(step_issue(SPLINE, "the motion lacks moves of a block", first.task, first.moves[0]))
    return issues


def _deviation_issues(block: SplineBlock, bounds: SplineCurveBounds) -> list[Issue]:
    """Return an issue for each segment, at most 20, on which a curve may deviate too far."""
    too_far = np.flatnonzero(~(bounds.deviation <= MAX_DEVIATION_M))
    return [
        step_issue(
            SPLINE,
            f"between the previous point and this one a curve may deviate {mm(bounds.deviation[i]):.4f} mm "
            f"from the straight move (rotations by {ROTATION_LEVER_M_PER_RAD:g} m/rad); allowed: "
            f"{mm(MAX_DEVIATION_M):g}. At a kink, stop there, or put points closer to each other",
            block.task,
            block.moves[i],
        )
        for i in too_far[:20].tolist()
    ]


def _speed_issues(context: Context, block: SplineBlock, bounds: SplineCurveBounds) -> list[Issue]:
    """Return at most 20 issues on speeds of a block.

    They concern four requirements:

    - The TCP keeps the speed limit and, if there are claims on feeds, ``MAX_SPEED_FACTOR`` times the speed of
      the moves nearby.
    - $VEL.CP keeps the speed limit.
    - $VEL.ORI lets the tool rotate fast enough for the times of the block.
    - No segment of the block has a feed that changes along the path.
    """
    issues, task = [], block.task
    limit = TCP_SPEED_FACTOR * context.problem.settings.tcp_speed
    step = spline_curve.segment_steps(block.pose)[:, 2]
    mean_speed = np.linalg.norm(step[:, :3], axis=1) / block.duration
    rotation_speed = np.linalg.norm(step[:, 3:], axis=1) / ROTATION_LEVER_M_PER_RAD / block.duration
    nearby_speed = _nearby_speed(context, block, mean_speed)
    for i, move in enumerate(block.moves):
        if not bounds.speed[i] <= limit:
            message = f"the tool may move at {mm(bounds.speed[i]):.2f} mm/s; allowed: {mm(limit):g}"
            issues.append(step_issue(SPLINE, message, task, move))
        elif context.feeds and bounds.speed[i] > MAX_SPEED_FACTOR * nearby_speed[i] + 1e-9:
            message = (
                f"before this point a curve may move the tool at {mm(bounds.speed[i]):.2f} mm/s; allowed: "
            )
            message += (
                f"{mm(MAX_SPEED_FACTOR * nearby_speed[i]):.2f}, {MAX_SPEED_FACTOR:g} times the speed of its "
                "segment's moves nearby"
            )
            issues.append(step_issue(SPLINE, message, task, move))
        if move.speed.tcp > limit:
            message = f"$VEL.CP is {mm(move.speed.tcp):g} mm/s; allowed: {mm(limit):g}"
            issues.append(step_issue(SPLINE, message, task, move))
        if rotation_speed[i] > move.speed.turn:
            message = (
                f"the tool rotates at {np.rad2deg(rotation_speed[i]):.2f} deg/s, faster than $VEL.ORI allows"
            )
            issues.append(step_issue(SPLINE, message, task, move))
    labels = {context.motion.node_label[node] for node in block.nodes}
    for claim in context.claims:
        segment = claim.uneven_feed()
        if segment is not None and segment.key in labels:
            message = f"a spline block in {segment}, whose feed changes along the path; write SLIN"
            issues.append(step_issue(SPLINE, message, task, block.moves[0]))
    return issues[:20]


def _nearby_speed(context: Context, block: SplineBlock, mean: FloatArray) -> FloatArray:
    """Return for each move the highest mean speed (N,) [m/s] of it and its neighbours with an equal label.

    The neighbours are up to two moves before and two moves after it. ``mean`` (N,) [m/s] are the mean speeds.
    """
    label = context.motion.node_label[block.nodes]
    out = mean.copy()
    for k in (1, 2):
        same = label[k:] == label[:-k]
        out[k:] = np.where(same, np.maximum(out[k:], mean[:-k]), out[k:])
        out[:-k] = np.where(same, np.maximum(out[:-k], mean[k:]), out[:-k])
    return out


def _joint_allowance(
    context: Context, block: SplineBlock, bounds: SplineCurveBounds
) -> tuple[Allowance, list[Issue]]:
    """Return the deviation of a block's curves from the replay, and issues of joint limits that they exceed.

    There are at most 20 issues: joints that change too much to be bounded, joint limits, and axis speeds. The
    inverse Jacobian converts deviations of the TCP to those of joints. It is evaluated at both ends and
    the middle of each segment, where its values must not differ too much.
    """
    task, motion = block.task, context.motion
    machine, q = arm_model.robot_machine(task.arm.data), motion.q[task.arm.name]
    data = machine.data
    # samples of the motion at the end and at the start of each move
    sample = motion.node_sample[block.nodes]
    previous = np.concatenate([[motion.node_sample[block.nodes[0] - 1]], sample[:-1]])
    replay_translation, replay_rotation = _replay_deviation(block)
    translation = bounds.translation + replay_translation
    rotation = bounds.rotation + replay_rotation
    deviation = np.hypot(translation, ROTATION_LEVER_M_PER_RAD * rotation)
    base = context.bases[task.arm.name]
    world = (block.work @ block.pose)[:, :3, :3]
    step = spline_curve.segment_steps(block.pose)[:, 2] / block.duration[:, None]
    # mean velocity and angular velocity of the TCP on each segment, in the axes of the world
    twist = np.concatenate(
        [
            np.einsum("ij,nj->ni", block.work[:3, :3], step[:, :3]),
            np.einsum("nij,nj->ni", world[:-1], step[:, 3:]),
        ],
        axis=1,
    )
    inverses = [
        _inverse(_jacobian(machine, q[samples], block.tool, base))
        for samples in (previous, (previous + sample) // 2, sample)
    ]
    # the norm of a row bounds the change of a joint per change of the pose in any direction
    joint_rates = np.array([np.linalg.norm(inverse, axis=2) for inverse in inverses])
    rate_bound = JOINT_RATE_FACTOR * joint_rates.max(axis=0)
    joint_speed = JOINT_RATE_FACTOR * np.max(
        [np.abs(np.einsum("nij,nj->ni", inverse, twist)) for inverse in inverses], axis=0
    )
    shift = rate_bound * deviation[:, None]
    joint_speed = joint_speed + rate_bound * bounds.speed_change[:, None]
    issues = []
    for i, move in enumerate(block.moves):
        if not (joint_rates[:, i].max(axis=0) <= JOINT_RATE_SPREAD * joint_rates[:, i].min(axis=0)).all():
            message = "the joints change so much before this point that their values do not bound a curve; "
            message += "put points closer to each other, or keep farther from singularities"
            issues.append(step_issue(SPLINE, message, task, move))
        joints = q[previous[i] : sample[i] + 1]
        margin = np.minimum(joints.min(axis=0) - data.lower, data.upper - joints.max(axis=0)) - shift[i]
        axis = int(np.argmin(margin))
        if not margin[axis] >= 0.0:
            message = f"a curve may move axis {axis + 1} {np.rad2deg(-margin[axis]):.3f} deg beyond its limit"
            issues.append(step_issue(SPLINE, message, task, move))
        speed_fraction = joint_speed[i] / data.velocity
        axis = int(np.argmax(speed_fraction))
        if not speed_fraction[axis] <= 1.0:
            message = (
                f"a curve may need {100 * speed_fraction[axis]:.0f} % of the speed of axis {axis + 1}; "
                "allowed: 100 %"
            )
            issues.append(step_issue(SPLINE, message, task, move))
    body = _body_deviation(machine, q[sample], block.tool, shift, translation, rotation)
    return Allowance(translation, rotation, float(shift.max()), body, MAX_SPEED_FACTOR), issues[:20]


def _replay_deviation(block: SplineBlock) -> tuple[FloatArray, FloatArray]:
    """Return the deviation (N,) [m] and (N,) [rad] of the replay itself from the straight segments.

    The replay rounds the corner between two segments over half of the time of the shorter one, h. With the
    velocities v1 and v2 it deviates there by at most h |v2 - v1| / 4. As velocities, twice the mean ones are
    taken. At the first and the last corner of the block, next to rest, the two velocities may have any ratio,
    so |v1| + |v2| replaces |v2 - v1|. The accuracy of the replay is another upper bound on the deviation. A
    segment has the larger deviation of its two corners.
    """
    step = spline_curve.segment_steps(block.pose)
    velocity = step[:, 2] / block.duration[:, None]
    next_velocity = step[:-1, 3] / block.duration[1:, None]  # in the frame of the previous segment
    half = 0.5 * np.minimum(block.duration[:-1], block.duration[1:])
    # half is h; 2.0: twice the mean velocities
    change = 2.0 * half[:, None] * (np.abs(next_velocity) + np.abs(velocity[:-1])) / 4.0
    straight = 2.0 * half[:, None] * np.abs(next_velocity - velocity[:-1]) / 4.0
    ramps = np.zeros(len(half), dtype=bool)
    ramps[:1] = ramps[-1:] = True
    change = np.where(ramps[:, None], change, straight)
    out = []
    for components, scale, accuracy in (
        (slice(0, 3), 1.0, PATH_ACCURACY_M),
        (slice(3, 6), ROTATION_LEVER_M_PER_RAD, PATH_ACCURACY_RAD),
    ):
        corner = np.minimum(np.linalg.norm(change[:, components], axis=1) / scale, accuracy)
        # corner i is at the end of segment i and at the start of segment i + 1
        out.append(np.maximum(np.append(corner, 0.0), np.append(0.0, corner)))
    return out[0], out[1]


def _inverse(jacobian: FloatArray) -> FloatArray:
    """Return the inverses (N, 6, 6) of Jacobians.

    A singular Jacobian gets 1e9 in all entries, so that any deviation exceeds the joint limits.
    """
    regular = np.linalg.cond(jacobian) < 1.0 / np.finfo(np.float64).eps
    out = np.full_like(jacobian, 1e9)
    out[regular] = np.linalg.inv(jacobian[regular])
    return out


def _jacobian(
    machine: arm_model.RobotMachine, q: FloatArray, tool: FloatArray, base: FloatArray
) -> FloatArray:
    """Return the Jacobian (N, 6, 6) of the TCP in the world at joints (N, 6) [rad], by central differences.

    The first three rows are the position [m/rad], the last three the rotation times
    ``ROTATION_LEVER_M_PER_RAD``.
    """
    joint_step = 1e-5
    out = np.empty((len(q), 6, 6))
    for joint in range(6):
        shift = np.zeros(6)
        shift[joint] = joint_step
        perturbed = [base @ machine.flange(q + sign * shift) @ tool for sign in (-1.0, 1.0)]
        out[:, :3, joint] = (perturbed[1][:, :3, 3] - perturbed[0][:, :3, 3]) / (2 * joint_step)
        rotation = perturbed[1][:, :3, :3] @ np.swapaxes(perturbed[0][:, :3, :3], 1, 2)
        out[:, 3:, joint] = ROTATION_LEVER_M_PER_RAD * log_rotation(rotation) / (2 * joint_step)
    return out


def _body_deviation(
    machine: arm_model.RobotMachine,
    q: FloatArray,
    tool: FloatArray,
    shift: FloatArray,
    translation: FloatArray,
    rotation: FloatArray,
) -> float:
    """Return the maximum deviation [m] of any body of the arm.

    The links up to the forearm move with the first three joints. Those of a wrist, whose axes meet, also
    move with two more joints about that point. The last link and the tool move with the TCP.

    Args:
        machine: The arm.
        q: Joints, (N, 6) [rad].
        tool: TCP in the flange frame, (4, 4) [m].
        shift: Joint deviations, (N, 6) [rad].
        translation: Deviations of the TCP, (N,) [m].
        rotation: Rotation deviations of the TCP, (N,) [rad].
    """
    origins = machine.chain.frames(q)[:, :, :3, 3]
    reach = np.stack(
        [
            BODY_RADIUS_M + np.linalg.norm(origins[:, k + 1 : 6] - origins[:, k, None], axis=2).max(axis=1)
            for k in range(3)
        ],
        axis=1,
    )
    links = (shift[:, :3] * reach).sum(axis=1) + BODY_RADIUS_M * shift[:, 3:5].sum(axis=1)
    tool_deviation = translation + (BODY_RADIUS_M + float(np.linalg.norm(tool[:3, 3]))) * rotation
    return float(np.maximum(links, tool_deviation).max())


def _used_up_claims(context: Context, first: SplineBlock, allowance: Allowance) -> list[Issue]:
    """Return an issue for each claim, at most 5, whose tolerance the deviation of curves uses up."""
    issues = []
    for claim in context.claims:
        used = claim.used_up(allowance)
        if used is not None:
            message = f"curves may deviate {mm(used[0]):.4f} mm, which uses up the {mm(used[1]):g} mm "
            message += f"that {type(claim).__name__} allows; put points closer to each other, or write SLIN"
            issues.append(step_issue(SPLINE, message, first.task, first.moves[0]))
    return issues[:5]


def tightened(context: Context, allowance: Allowance) -> Context:
    """Return the context of a proof with tightened clearance and margins, and with tightened claims.

    If the replay of straight moves satisfies them, the controller's curves satisfy the original ones.

    Args:
        context: The proof.
        allowance: Maximum deviation of all curves.
    """
    settings = dataclasses.replace(
        context.problem.settings.widen_clearances(allowance.body),
        singularity_margin=context.problem.settings.singularity_margin + 2.0 * allowance.joints,
    )
    problem = dataclasses.replace(context.problem, settings=settings)
    claims = {
        name: tuple(claim.tightened(allowance) for claim in group)
        for name, group in context.by_operation.items()
    }
    out = context.with_changes(problem, claims)
    vars(out)["motion"] = (
        context.motion
    )  # it depends on the program text alone, so it need not be computed again
    return out
