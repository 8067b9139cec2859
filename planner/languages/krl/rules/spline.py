"""verify.spline: what is not known of the curves of KRL's spline blocks is bounded.

All other rules hold with that much less room.

The replay goes straight from point to point (:mod:`planner.proof.replay.moves`). A controller's
curve may be elsewhere, by :mod:`planner.languages.krl.reader.spline_curve`; :class:`Allowance` says by how
much at most, and :func:`tightened` takes it off clearance, margins, tolerances and feeds, once and
for all rules.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.claims.claim import Allowance, on_straight_moves_alone
from planner.geometry.arrays import FloatArray, IntArray, log_rotation
from planner.issues import Issue
from planner.languages.krl.reader import spline_curve
from planner.languages.krl.reader.spline_curve import TURN_LEVER, Bounds
from planner.languages.krl.reader.syntax_tree import SPLINE_MOVE
from planner.programs.stages import TaskText
from planner.programs.steps import JointTarget, MoveStep, PassedTarget, poses
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.replay.moves import ACCURACY, ACCURACY_TURN
from planner.proof.rule import Outcome, at_step, mm, rule
from planner.proof.rules.robot_motion import TCP_SLACK

SPLINE: Final = "verify.spline"
"""Code of this rule."""
MOST_OFF_STRAIGHT: Final = 0.1e-3
"""How far [m] a curve may be off its straight ways: no tolerance of a part is to go into that alone."""
FASTER_FACTOR: Final = 1.15
"""Between two points a tool may be faster by this factor than on the fastest way of the segment near them."""
JOINT_RATE_FACTOR: Final = 1.25
"""Joints per way are less than so many times what they are at ends and middle of a segment."""
JOINT_RATE_SPREAD: Final = 1.5
"""They may differ so much between these."""
ARM_REACH: Final = 0.4
"""Bodies of an arm reach no farther [m] from the line through its joints and its tool's tip."""
NOT_SEEN_TEXT: Final = "not seen on a controller"
"""What proofs say of how controllers plan blocks."""


@dataclasses.dataclass(frozen=True)
class Block:
    """A spline block: its moves, as ``nodes`` (N,) of the motion, through ``pose`` (N + 1, 4, 4) in the frame
    ``work`` (4, 4) of the world, with the tool ``tool`` (4, 4), over ``duration`` (N,) [s]."""

    task: TaskText
    moves: tuple[MoveStep, ...]
    nodes: IntArray
    pose: FloatArray
    work: FloatArray
    tool: FloatArray
    duration: FloatArray


def blocks(context: Context) -> Iterator[Block]:
    """The spline blocks of all tasks, in order."""
    for task in context.job.tasks:
        moves = [step for step in task.steps if isinstance(step, MoveStep)]
        first = None
        for k, move in enumerate(moves):
            if move.kind != SPLINE_MOVE:
                continue
            first = k if first is None else first
            if move.zone.fine:
                yield _block(task, moves, first, k + 1)
                first = None


def _block(task: TaskText, moves: list[MoveStep], first: int, end: int) -> Block:
    own = tuple(moves[first:end])
    targets = [move.target for move in moves[max(first - 1, 0) : end]]
    joint = JointTarget | PassedTarget
    place = np.array([target.position for target in targets if not isinstance(target, joint)])
    turn = np.array([target.quaternion for target in targets if not isinstance(target, joint)])
    work = own[0].wobj.user @ own[0].wobj.object
    times = np.array([move.time or 0.0 for move in own])
    return Block(task, own, np.arange(first, end), poses(place, turn), work, own[0].tool.pose, times)


@rule("verify.spline")
def spline(context: Context) -> Outcome:
    """Spline blocks (KRL): whatever curve of the fifth order a controller lays through their points, it is so
    near to the straight ways between them that all other rules hold with that much less room, and no faster
    than allowed."""
    found = list(blocks(context))
    if not found:
        return Outcome(nothing="no spline block")
    issues = _refused(context, found)
    if issues:
        return Outcome(tuple(issues))
    own: list[Allowance] = []
    worst = 0.0
    for block in found:
        bounds = spline_curve.bounds(block.pose, block.duration)
        issues += _near(block, bounds) + _paced(context, block, bounds)
        worst = max(worst, float(bounds.off.max()))
        one, wrong = _joints(context, block, bounds)
        issues += wrong
        own.append(one)
    most = Allowance(
        np.concatenate([one.way for one in own]),
        np.concatenate([one.turn for one in own]),
        max(one.joints for one in own),
        max(one.body for one in own),
        FASTER_FACTOR,
    )
    issues += _left(context, found[0], most) if not issues else []
    points = sum(len(block.moves) for block in found)
    where = f"{len(found)} blocks of {points} points, how they are planned {NOT_SEEN_TEXT}"
    return Outcome(
        tuple(issues),
        mm(worst),
        mm(MOST_OFF_STRAIGHT),
        "mm off the straight ways",
        where,
        context=None if issues else tightened(context, most),
    )


def _refused(context: Context, found: list[Block]) -> list[Issue]:
    issues = []
    controller, first = context.problem.cell.controller, found[0]
    if controller.path != "spline":
        what = "a spline block; the cell's controller asks for path: slin; write SLIN, or set path: spline"
        issues.append(at_step(SPLINE, what, first.task, first.moves[0]))
    if len(context.job.tasks) > 1:
        what = "a spline block where two arms share the work; allowed: one arm alone; write SLIN"
        issues.append(at_step(SPLINE, what, first.task, first.moves[0]))
    for block in found:
        if arm_model.machine_of(block.task.arm.data).data.coupling is not None:
            what = "a spline block of an arm with parallel rods, whose joints are not bounded; write SLIN"
            issues.append(at_step(SPLINE, what, block.task, block.moves[0]))
    for kind in on_straight_moves_alone(context.claims):
        what = f"a spline block in a job that claims {kind}, which is proven on straight ways alone"
        issues.append(at_step(SPLINE, f"{what}; write SLIN", first.task, first.moves[0]))
    for claim in context.feeds:
        if claim.lower > 0.0:
            what = f"a spline block where {claim.segment} has a least feed, and a curve no least speed"
            issues.append(at_step(SPLINE, f"{what}; write SLIN", first.task, first.moves[0]))
    if (
        not issues
        and context.motion.node_segment
        and len(context.motion.node_segment) < 1 + max(int(block.nodes[-1]) for block in found)
    ):
        issues.append(at_step(SPLINE, "the motion lacks moves of a block", first.task, first.moves[0]))
    return issues


def _near(block: Block, bounds: Bounds) -> list[Issue]:
    """Segments on which curves may be too far off."""
    far = np.flatnonzero(~(bounds.off <= MOST_OFF_STRAIGHT))
    return [
        at_step(
            SPLINE,
            f"between the point before and this one a curve may be {mm(bounds.off[i]):.4f} mm off "
            f"the straight way (turns by {TURN_LEVER:g} m/rad); allowed: {mm(MOST_OFF_STRAIGHT):g}; a "
            "kink: stop there, or put "
            "points nearer to each other",
            block.task,
            block.moves[i],
        )
        for i in far[:20].tolist()
    ]


def _paced(context: Context, block: Block, bounds: Bounds) -> list[Issue]:
    """Speeds of the tool between points, and speeds in force that would not let the times be kept."""
    issues, task = [], block.task
    limit = TCP_SLACK * context.problem.settings.tcp_speed
    step = spline_curve.steps(block.pose)[:, 2]
    mean = np.linalg.norm(step[:, :3], axis=1) / block.duration
    turning = np.linalg.norm(step[:, 3:], axis=1) / TURN_LEVER / block.duration
    near = _nearby(context, block, mean)
    for i, move in enumerate(block.moves):
        if not bounds.speed[i] <= limit:
            what = f"the tool may move at {mm(bounds.speed[i]):.2f} mm/s; allowed: {mm(limit):g}"
            issues.append(at_step(SPLINE, what, task, move))
        elif context.feeds and bounds.speed[i] > FASTER_FACTOR * near[i] + 1e-9:
            what = f"before this point a curve may move the tool at {mm(bounds.speed[i]):.2f} mm/s; allowed: "
            what += (
                f"{mm(FASTER_FACTOR * near[i]):.2f}, {FASTER_FACTOR:g} times as fast as on its segment's "
                "ways nearby"
            )
            issues.append(at_step(SPLINE, what, task, move))
        if move.speed.tcp > limit:
            what = f"$VEL.CP is {mm(move.speed.tcp):g} mm/s; allowed: {mm(limit):g}"
            issues.append(at_step(SPLINE, what, task, move))
        if turning[i] > move.speed.turn:
            what = f"the tool turns at {np.rad2deg(turning[i]):.2f} deg/s, faster than $VEL.ORI lets it"
            issues.append(at_step(SPLINE, what, task, move))
    labels = {context.motion.node_label[node] for node in block.nodes}
    for claim in context.claims:
        segment = claim.uneven_feed()
        if segment is not None and segment.key in labels:
            what = f"a spline block in {segment}, whose feed changes on the way; write SLIN"
            issues.append(at_step(SPLINE, what, task, block.moves[0]))
    return issues[:20]


def _nearby(context: Context, block: Block, mean: FloatArray) -> FloatArray:
    """The highest mean speed (N,) on segments of the block up to two before and behind each, of one label."""
    label = context.motion.node_label[block.nodes]
    out = mean.copy()
    for k in (1, 2):
        same = label[k:] == label[:-k]
        out[k:] = np.where(same, np.maximum(out[k:], mean[:-k]), out[k:])
        out[:-k] = np.where(same, np.maximum(out[:-k], mean[k:]), out[:-k])
    return out


def _joints(context: Context, block: Block, bounds: Bounds) -> tuple[Allowance, list[Issue]]:
    """What curves of a block may be off in the joints, and limits and speeds that they may pass."""
    task, motion = block.task, context.motion
    machine, q = arm_model.machine_of(task.arm.data), motion.q[task.arm.name]
    data = machine.data
    at = motion.node_sample[block.nodes]
    before = np.concatenate([[motion.node_sample[block.nodes[0] - 1]], at[:-1]])
    way, turn = _rounded(block)
    way, turn = bounds.way + way, bounds.turn + turn
    off = np.hypot(way, TURN_LEVER * turn)
    base = context.bases[task.arm.name]
    world = (block.work @ block.pose)[:, :3, :3]
    step = spline_curve.steps(block.pose)[:, 2] / block.duration[:, None]
    twist = np.concatenate(
        [
            np.einsum("ij,nj->ni", block.work[:3, :3], step[:, :3]),
            np.einsum("nij,nj->ni", world[:-1], step[:, 3:]),
        ],
        axis=1,
    )
    places = [
        _inverse(_jacobian(machine, q[rows], block.tool, base)) for rows in (before, (before + at) // 2, at)
    ]
    ways = np.array([np.linalg.norm(back, axis=2) for back in places])
    per_way = JOINT_RATE_FACTOR * ways.max(axis=0)
    rate = JOINT_RATE_FACTOR * np.max(
        [np.abs(np.einsum("nij,nj->ni", back, twist)) for back in places], axis=0
    )
    shift = per_way * off[:, None]
    rate = rate + per_way * bounds.change[:, None]
    issues = []
    for i, move in enumerate(block.moves):
        if not (ways[:, i].max(axis=0) <= JOINT_RATE_SPREAD * ways[:, i].min(axis=0)).all():
            what = (
                "the joints change so much before this point that a curve is not bounded by what they are; "
            )
            what += "put points nearer to each other, or keep farther off singular postures"
            issues.append(at_step(SPLINE, what, task, move))
        some = q[before[i] : at[i] + 1]
        room = np.minimum(some.min(axis=0) - data.lower, data.upper - some.max(axis=0)) - shift[i]
        axis = int(np.argmin(room))
        if not room[axis] >= 0.0:
            what = f"a curve may take axis {axis + 1} {np.rad2deg(-room[axis]):.3f} deg beyond its limit"
            issues.append(at_step(SPLINE, what, task, move))
        share = rate[i] / data.velocity
        axis = int(np.argmax(share))
        if not share[axis] <= 1.0:
            what = (
                f"a curve may need {100 * share[axis]:.0f} % of the speed of axis {axis + 1}; allowed: 100 %"
            )
            issues.append(at_step(SPLINE, what, task, move))
    body = _bodies(machine, q[at], block.tool, shift, way, turn)
    return Allowance(way, turn, float(shift.max()), body, FASTER_FACTOR), issues[:20]


def _rounded(block: Block) -> tuple[FloatArray, FloatArray]:
    """How far (N,) [m] and (N,) [rad] the replay itself is off the straight ways: its corners are rounded
    over half of the shorter segment at most, by h |change of speed| / 4, where ramps are up to twice as
    fast, and within its accuracy."""
    step = spline_curve.steps(block.pose)
    rate = step[:, 2] / block.duration[:, None]
    after = step[:-1, 3] / block.duration[1:, None]  # as the segment before sees it
    half = 0.5 * np.minimum(block.duration[:-1], block.duration[1:])
    change = 2.0 * half[:, None] * (np.abs(after) + np.abs(rate[:-1])) / 4.0
    straight = 2.0 * half[:, None] * np.abs(after - rate[:-1]) / 4.0
    ramps = np.zeros(len(half), dtype=bool)
    ramps[:1] = ramps[-1:] = True
    change = np.where(ramps[:, None], change, straight)
    out = []
    for some, scale, most in ((slice(0, 3), 1.0, ACCURACY), (slice(3, 6), TURN_LEVER, ACCURACY_TURN)):
        corner = np.minimum(np.linalg.norm(change[:, some], axis=1) / scale, most)
        out.append(np.maximum(np.append(corner, 0.0), np.append(0.0, corner)))
    return out[0], out[1]


def _inverse(jacobian: FloatArray) -> FloatArray:
    """Inverses (N, 6, 6); out of all bounds where there is none."""
    known = np.linalg.cond(jacobian) < 1.0 / np.finfo(np.float64).eps
    out = np.full_like(jacobian, 1e9)
    out[known] = np.linalg.inv(jacobian[known])
    return out


def _jacobian(machine: arm_model.Machine, q: FloatArray, tool: FloatArray, base: FloatArray) -> FloatArray:
    """(N, 6, 6) how the TCP moves [m/rad] and turns, by LEVER, in the world with the joints q (N, 6)."""
    size = 1e-5
    out = np.empty((len(q), 6, 6))
    for joint in range(6):
        shift = np.zeros(6)
        shift[joint] = size
        two = [base @ machine.flange(q + sign * shift) @ tool for sign in (-1.0, 1.0)]
        out[:, :3, joint] = (two[1][:, :3, 3] - two[0][:, :3, 3]) / (2 * size)
        turn = two[1][:, :3, :3] @ np.swapaxes(two[0][:, :3, :3], 1, 2)
        out[:, 3:, joint] = TURN_LEVER * log_rotation(turn) / (2 * size)
    return out


def _bodies(
    machine: arm_model.Machine,
    q: FloatArray,
    tool: FloatArray,
    shift: FloatArray,
    way: FloatArray,
    turn: FloatArray,
) -> float:
    """How far [m] any body of the arm is off at most, where its joints q (N, 6) are off by ``shift`` (N, 6)
    [rad] and its TCP by ``way`` (N,) [m] and ``turn`` (N,) [rad].

    The links up to the forearm go with the first three joints; those of the wrist, whose axes meet, with two
    more, about a place that they do not leave; the last link and the tool as the TCP does.
    """
    origins = machine.chain.frames(q)[:, :, :3, 3]
    reach = np.stack(
        [
            ARM_REACH + np.linalg.norm(origins[:, k + 1 : 6] - origins[:, k, None], axis=2).max(axis=1)
            for k in range(3)
        ],
        axis=1,
    )
    links = (shift[:, :3] * reach).sum(axis=1) + ARM_REACH * shift[:, 3:5].sum(axis=1)
    held = way + (ARM_REACH + float(np.linalg.norm(tool[:3, 3]))) * turn
    return float(np.maximum(links, held).max())


def _left(context: Context, first: Block, most: Allowance) -> list[Issue]:
    """Claims of which a curve leaves nothing."""
    issues = []
    for claim in context.claims:
        gone = claim.used_up(most)
        if gone is not None:
            what = f"curves may be {mm(gone[0]):.4f} mm off, which leaves nothing of the {mm(gone[1]):g} mm "
            what += f"that {type(claim).__name__} allows; put points nearer to each other, or write SLIN"
            issues.append(at_step(SPLINE, what, first.task, first.moves[0]))
    return issues[:5]


def tightened(context: Context, most: Allowance) -> Context:
    """The same proof with that much less room: clearance and margins, tolerances and feeds of claims."""
    settings = dataclasses.replace(
        context.problem.settings.wider(most.body),
        singularity_margin=context.problem.settings.singularity_margin + 2.0 * most.joints,
    )
    problem = dataclasses.replace(context.problem, settings=settings)
    less = {
        name: tuple(claim.tightened(most) for claim in group) for name, group in context.by_operation.items()
    }
    out = context.replaced(problem, less)
    vars(out)["motion"] = context.motion  # it follows from the text alone
    return out
