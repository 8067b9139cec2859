"""Compensation of the static sag of arms.

It computes commanded joints and targets for which the sagged arms follow the plan.

A plan states where arms are to be. Let S(q) be the joint deflection under load at q
(:func:`planner.cell.compliance.joint_deflection`). The commanded joints are q - S(q). The loads are those of
the arm at its planned position, so no iteration is needed. Weight acts throughout. The process force acts at
working targets, except at the first one, and may turn with the feed. Between targets the commanded position
changes linearly. The sag itself is not quite linear between targets; the error is evaluated at the middle of
moves.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from planner.catalogue.robots import JointStiffness, RobotData
from planner.cell.compliance import PointLoad, joint_deflection
from planner.cell.kinematics import forward_kinematics
from planner.cell.sag import sag_claims
from planner.claims.claim import FEED_PATH_M, ArmSags
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, inverse
from planner.geometry.units import GRAVITY, MM, measurement
from planner.issues import Issue, Severity, TandemError
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Settings, Setup
from planner.targets import Targets

MAX_SAG_ERROR_M: Final = 2e-5
"""Maximum error [m] of the sag between two targets while a tool works."""
AIR_SAG_ALLOWANCE_M: Final = 1e-4
"""Allowance [m] for the error of the sag between targets in the air, by which bodies may come closer than
planned.
"""
MAX_EXTRA_TURN_RAD: Final = 0.05
"""Maximum extra direction change [rad] of the commanded path at a target where the tool does not stop."""
MAX_SHIFT_FRACTION: Final = 0.25
"""Maximum shift of an arm by a force that turns with the feed, as a fraction of the length over which the
direction of the feed is averaged. Beyond it, the path of the arm could not be inferred from commanded
positions.
"""
HEIGHT_TOLERANCE_M: Final = 1e-6
"""Tolerance [m] for heights outside a table of forces."""
RANGE_CODE: Final = "motion.sag_range"
"""Issue code of sag that cannot be compensated, because it is too large or not linear enough."""


@dataclasses.dataclass(frozen=True)
class _LoadedArm:
    """An arm on its base, with its loads.

    Attributes:
        arm: The arm.
        data: Data of its robot model.
        base: (4, 4) base pose in the world.
        claim: Masses, forces and stiffness that cause its sag; None if its sag is not compensated.
        force: (K, 3) [N] process force at heights ``claim.height`` of the TCP above the stock frame.
        stock_pose: (4, 4) stock pose in the world.
    """

    arm: Arm
    data: RobotData
    base: FloatArray
    claim: ArmSags | None
    force: FloatArray
    stock_pose: FloatArray

    @property
    def turns_with_feed(self) -> bool:
        """Whether the process force turns with the feed."""
        return self.claim is not None and self.claim.frame == "feed" and bool(self.claim.force.any())

    def deflection(
        self, q: FloatArray, fraction: FloatArray, feed: FloatArray, height: FloatArray | None = None
    ) -> FloatArray:
        """Compute the joint deflections (N, 6) [rad] of the arm beyond the commanded joints.

        The loads are the weight at the centre of gravity of what the flange carries, and the process force at
        the TCP. The deflections are 0 if the sag of the arm is not compensated.

        Args:
            q: (N, 6) [rad] joints.
            fraction: (N,) fraction of the process force that acts.
            feed: (N, 3) mean feed direction in the world.
            height: (N,) [m] heights above the stock frame at which the force is looked up; None for those of
                the TCP.
        """
        if self.claim is None:
            return np.zeros_like(q)
        flange = forward_kinematics(self.data, q)
        to_base = self.base[:3, :3].T
        weight = np.broadcast_to(to_base @ [0.0, 0.0, -self.claim.mass * GRAVITY], (len(q), 3))
        payload_position = flange[:, :3, :3] @ self.claim.cog + flange[:, :3, 3]
        tcp = flange @ self.arm.tool.tcp
        match self.claim.frame:
            case "stock":
                axes = np.broadcast_to(to_base @ self.stock_pose[:3, :3], (len(q), 3, 3))
            case "tool":
                axes = tcp[:, :3, :3]
            case "feed":
                axes = _feed_axes(feed @ to_base.T, tcp[:, :3, 2])
        process_force = np.einsum(
            "nij,nj->ni", axes, self.work_forces(self.tcp_height(q) if height is None else height)
        )
        loads = (
            PointLoad(payload_position, weight),
            PointLoad(tcp[:, :3, 3], fraction[:, None] * process_force),
        )
        return joint_deflection(self.data, JointStiffness(self.claim.joints, ""), q, loads)

    def tcp_height(self, q: FloatArray) -> FloatArray:
        """Return the height (N,) [m] of the TCP above the stock frame for joints (N, 6)."""
        return np.asarray((self.tcp_poses(q)[:, :3, 3] - self.stock_pose[:3, 3]) @ self.stock_pose[:3, 2])

    def work_forces(self, height: FloatArray) -> FloatArray:
        """Return the full process force (N, 3) [N] at heights (N,) [m], in the frame that its claim names."""
        if self.claim is None or len(self.force) == 1:
            return np.broadcast_to(self.force[0], (len(height), 3))
        return np.stack([np.interp(height, self.claim.height, column) for column in self.force.T], axis=1)

    def gravity_deflection(self, q: FloatArray) -> FloatArray:
        """Compute the joint deflections (N, 6) [rad] by weight alone."""
        return self.deflection(q, np.zeros(len(q)), np.zeros((len(q), 3)))

    def tcp_poses(self, q: FloatArray) -> FloatArray:
        """Return the TCP poses (N, 4, 4) in the world for joints (N, 6)."""
        return np.asarray(self.base @ forward_kinematics(self.data, q) @ self.arm.tool.tcp)

    def tcp_distance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the distance (N,) [m] between the TCPs at two sets of joints (N, 6)."""
        return np.asarray(np.linalg.norm((self.tcp_poses(first) - self.tcp_poses(second))[:, :3, 3], axis=1))


def commanded_plan(problem: Problem, plan: Plan) -> tuple[Plan, tuple[Issue, ...]]:
    """Return the plan with commanded joints and poses, for which the sagged arms follow the given plan.

    Args:
        problem: Problem.
        plan: Plan that the arms should follow.

    Returns:
        The commanded plan and notes on the sag. Without compensated sag it is the plan itself, with no notes.

    Raises:
        TandemError: ``motion.sag_range`` for sag that cannot be compensated: a shift is too large, a minimum
            feed is required, a table of forces does not suit, or targets are so far apart that the sag
            between them is not linear.
    """
    if all(arm.sag is None for setup in problem.setups for arm in setup.cell.arms):
        return plan, ()
    operations, issues, errors = [], list[Issue](), list[Issue]()
    for index, operation_plan in enumerate(plan.operations):
        arms = _loaded_arms(problem, problem.setup_of(index), plan)
        commanded_operation, notes, operation_errors = _command_operation(
            operation_plan, arms, problem.settings
        )
        operations.append(commanded_operation)
        issues += notes
        errors += operation_errors
    if errors:
        raise TandemError(errors)
    return dataclasses.replace(plan, operations=tuple(operations)), tuple(issues)


def with_commanded_joints(plan: Plan, commanded: Plan) -> Plan:
    """Return the plan with the joints of the commanded plan added, for the arms for which they differ.

    Args:
        plan: Plan that the arms should follow.
        commanded: Result of :func:`commanded_plan`.
    """
    if commanded is plan:
        return plan
    operations = tuple(
        dataclasses.replace(
            operation,
            commanded={
                arm: q for arm, q in commanded_operation.q.items() if not np.array_equal(q, operation.q[arm])
            },
        )
        for operation, commanded_operation in zip(plan.operations, commanded.operations, strict=True)
    )
    return dataclasses.replace(plan, operations=operations)


def sag_margins(problem: Problem) -> tuple[float, float]:
    """Compute the extra clearance [m] and extra joint margin [rad] that planning needs for compensated sag.

    With them, commanded joints and sagged arms keep the required margins. Both are 0 without compensated sag.
    """
    clearance, joint_margin = 0.0, 0.0
    for setup in problem.setups:
        for claim in sag_claims(problem, setup):
            arm = setup.cell.arm(claim.arm)
            data = arm.data
            tool_length = data.form.hand + float(
                np.linalg.norm(arm.tool.tcp[:3, 3]) + np.linalg.norm(claim.cog)
            )
            force = claim.mass * GRAVITY + max_work_force(claim)
            # The joint margin bounds force * lever / stiffness. A coupling rod loads axis 2 as well.
            rods = 1.0 if data.coupling is None else 2.0
            joint_margin = max(
                joint_margin, rods * force * (data.reach + tool_length) / float(claim.joints.min())
            )
            # In the air only weight acts. Its deflection at home times the arm's length is the clearance.
            deflections = _LoadedArm(
                arm, data, arm.base, claim, force=np.zeros((1, 3)), stock_pose=np.eye(4)
            ).gravity_deflection(arm.home[None])
            clearance = max(
                clearance, float(np.abs(deflections).sum()) * (data.reach + tool_length) + AIR_SAG_ALLOWANCE_M
            )
    return clearance, joint_margin


def _loaded_arms(problem: Problem, setup: Setup, plan: Plan) -> dict[str, _LoadedArm]:
    """Return all arms of a setup by name, on their bases in the plan and with the loads of their claims."""
    stock_pose = plan.stock_poses[setup.number - 1]
    claims = {claim.arm: claim for claim in sag_claims(problem, setup)}
    out = {}
    for arm in setup.cell.arms:
        claim = claims.get(arm.name)
        force = np.zeros((1, 3)) if claim is None else claim.force
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        out[arm.name] = _LoadedArm(arm, arm.data, base, claim, force, stock_pose)
    return out


def max_work_force(claim: ArmSags) -> float:
    """Return the largest process force [N] that is stated for an arm, at any height."""
    return float(np.linalg.norm(claim.force, axis=1).max())


def force_fractions(targets: Targets) -> FloatArray:
    """Return the fraction (N,) of the process force that acts at each target.

    It is 1 at the end of a working move, except in phases such as lead-in, and 0 elsewhere and at the first
    target.
    """
    works = [segment.works and not segment.phase for segment in targets.segment]
    fractions = np.array(works, dtype=np.float64)
    fractions[:1] = 0.0
    return fractions


@dataclasses.dataclass(frozen=True)
class _FeedDirections:
    """Mean feed directions in the world; 0 where no force acts.

    Attributes:
        at: (N, 3) directions at targets.
        middle: (N - 1, 3) directions at the middle of moves.
        span: (N,) [m] path length over which the direction at each target is averaged.
    """

    at: FloatArray
    middle: FloatArray
    span: FloatArray


def feed_directions(positions: FloatArray, fraction: FloatArray) -> _FeedDirections:
    """Compute the mean feed directions along linear moves where the process force acts.

    Each direction is the chord from :data:`FEED_PATH_M` before a position to :data:`FEED_PATH_M` after it,
    within the same run of working moves, divided by the path length between these points. It is therefore
    shorter than 1 on a curve.

    Args:
        positions: (N, 3) [m] positions of the TCP.
        fraction: (N,) fraction of the process force that acts.
    """
    works, rows = fraction > 0.0, np.arange(len(fraction))
    path_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    # path lengths (N,) at which the run of working moves around each target starts and ends
    begins = works & ~np.concatenate([[False], works[:-1]])
    ends = works & ~np.concatenate([works[1:], [False]])
    # accumulated from both sides: the last start up to each target, and the first end from it on
    low = path_length[np.maximum(np.maximum.accumulate(np.where(begins, rows, 0)) - 1, 0)]
    high = path_length[np.minimum.accumulate(np.where(ends, rows, len(rows) - 1)[::-1])[::-1]]

    def mean_direction(at: FloatArray, row: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the direction (K, 3) and the span (K,) at path lengths ``at``, in the runs of ``row``."""
        start, end = np.maximum(at - FEED_PATH_M, low[row]), np.minimum(at + FEED_PATH_M, high[row])
        chord = np.stack(
            [np.interp(end, path_length, x) - np.interp(start, path_length, x) for x in positions.T], axis=1
        )
        span = np.where(works[row], end - start, 0.0)
        return np.where(span > 0.0, 1.0 / np.maximum(span, 1e-12), 0.0)[:, None] * chord, span

    at, span = mean_direction(path_length, rows)
    middle, _ = mean_direction(0.5 * (path_length[1:] + path_length[:-1]), rows[1:])
    # On the move on which the force falls, the direction is that at the last working target.
    is_falling = works[:-1] & ~works[1:]
    return _FeedDirections(at, np.where(is_falling[:, None], at[:-1], middle), span)


def _feed_axes(feed: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the axes (N, 3, 3) along which a force in the feed frame is given, as columns.

    They are forward, to the right, and along the tool's ``axis`` (N, 3). The first two are as long as the
    component of ``feed`` (N, 3) across the axis, so that the force fades where the direction changes fast.
    """
    across = feed - np.sum(feed * axis, axis=1, keepdims=True) * axis
    return np.stack([across, np.cross(axis, across), axis], axis=-1)


def _command_operation(
    plan: OperationPlan, arms: Mapping[str, _LoadedArm], settings: Settings
) -> tuple[OperationPlan, list[Issue], list[Issue]]:
    """Compute the commanded plan of one operation.

    Args:
        plan: Plan that the arms should follow.
        arms: All arms of the setup by name.
        settings: Limits of speed and acceleration.

    Returns:
        The commanded plan, notes on the sag, and errors for sag that cannot be compensated.
    """
    targets = plan.targets
    has_force = [loaded.claim is not None and loaded.claim.force.any() for loaded in arms.values()]
    fractions = force_fractions(targets) if any(has_force) else np.zeros(targets.count)
    q, notes, errors = dict(plan.q), list[Issue](), list[Issue]()
    for name in targets.arms:
        loaded = arms[name]
        if loaded.claim is None:
            continue
        feed = feed_directions(loaded.tcp_poses(plan.q[name])[:, :3, 3], fractions)
        q[name] = plan.q[name] - loaded.deflection(plan.q[name], fractions, feed.at)
        shift = loaded.tcp_distance(plan.q[name], q[name])
        notes.append(_sag_note(plan, name, loaded.claim, shift))
        errors += _range_issues(plan, name, loaded.claim, shift)
        if loaded.claim.force.any():
            errors += _min_feed_issues(plan, name)
        if loaded.turns_with_feed:
            errors += _feed_force_issues(plan, name, loaded, fractions, feed.span)
        if len(loaded.force) > 1:
            errors += _force_table_issues(plan, name, loaded, fractions, feed.at)
        errors += _uneven_sag_issues(plan, name, _midpoint_errors(loaded, plan.q[name], fractions, feed))
    approach, retreat = (
        {arm: joints - arms[arm].gravity_deflection(joints) for arm, joints in path.items()}
        for path in (plan.approach, plan.retreat)
    )
    time, stop = _retime(plan, arms, q, fractions, settings)
    commanded = dataclasses.replace(
        plan,
        targets=dataclasses.replace(targets, pose=_commanded_poses(plan, arms, q), freedoms=(), stop=stop),
        q=q,
        values=np.zeros((targets.count, 0)),
        time=time,
        approach=approach,
        retreat=retreat,
    )
    return commanded, notes, errors


def _commanded_poses(
    plan: OperationPlan, arms: Mapping[str, _LoadedArm], q: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Compute the commanded TCP poses {arm: (N, 4, 4)} in the work frames.

    A frame that an arm carries moves with the commanded motion of that arm.

    Args:
        plan: Plan that the arms should follow.
        arms: All arms of the setup by name.
        q: {arm: (N, 6)} [rad] commanded joints.
    """
    targets = plan.targets
    out = {}
    for arm, pose in targets.poses(plan.values).items():
        frame = targets.frame[arm]
        carrier = frame.removeprefix("held:") if frame.startswith("held:") else None
        if all(name is None or arms[name].claim is None for name in (arm, carrier)):
            out[arm] = pose
            continue
        frames = arms[arm].tcp_poses(plan.q[arm]) @ inverse(pose)  # of the work, in the world
        if carrier is not None:
            carrier_arm = arms[carrier]
            frames = (
                carrier_arm.tcp_poses(q[carrier]) @ inverse(carrier_arm.tcp_poses(plan.q[carrier])) @ frames
            )
        out[arm] = inverse(frames) @ arms[arm].tcp_poses(q[arm])
    return out


def _retime(
    plan: OperationPlan,
    arms: Mapping[str, _LoadedArm],
    q: Mapping[str, FloatArray],
    fractions: FloatArray,
    settings: Settings,
) -> tuple[FloatArray, BoolArray]:
    """Compute the times (N,) [s] and the stops (N,) of the commanded targets.

    Moves keep their planned durations unless an end of them becomes a stop.

    The tool stops where the force begins or ends to rise or fall, because the commanded path has corners
    there that must not be blended. It also stops where a force that turns with the feed makes the commanded
    path change its direction by more than the planned path. Moves from and to new stops are slowed as
    required.

    With a cubic between two stops, a move of mean speed 1 and duration 1 has the peak speed 3/2 and the peak
    acceleration 6. With a stop at one end and the mean speed at the other end the peaks are 4/3 and 4.

    Args:
        plan: Plan that the arms should follow.
        arms: All arms of the setup by name.
        q: {arm: (N, 6)} [rad] commanded joints.
        fractions: (N,) fraction of the process force at each target.
        settings: Limits of speed and acceleration.
    """
    targets = plan.targets
    force_changes = np.flatnonzero(np.diff(fractions) != 0.0) + 1
    stop = targets.stop.copy()
    stop[np.concatenate([force_changes - 1, force_changes])] = True
    for name in (arm for arm in targets.arms if arms[arm].turns_with_feed):
        directions = (
            _move_directions(arms[name].tcp_poses(joints)[:, :3, 3]) for joints in (plan.q[name], q[name])
        )
        planned_changes, commanded_changes = (
            np.diff(path_directions, axis=0) for path_directions in directions
        )
        turns_more = np.linalg.norm(commanded_changes - planned_changes, axis=1) > MAX_EXTRA_TURN_RAD
        stop[1:-1] |= turns_more & (fractions[1:-1] > 0.0)
    # number of stops, 0 to 2, at the ends of each move that has a new stop
    new_stops = stop & ~targets.stop
    stop_count = (stop[1:].astype(np.int64) + stop[:-1]) * (new_stops[1:] | new_stops[:-1])
    # a move on which the force rises or falls is slowed as if both of its ends were new stops
    stop_count[force_changes - 1] = np.maximum(stop_count[force_changes - 1], 2)
    duration = np.diff(plan.time)
    for name in targets.arms:
        loaded = arms[name]
        # the longer of the commanded move and the move of the sagged arm
        move_lengths = np.max(
            [
                np.linalg.norm(np.diff(loaded.tcp_poses(joints)[:, :3, 3], axis=0), axis=1)
                for joints in (q[name], plan.q[name])
            ],
            axis=0,
        )
        speed = np.minimum(targets.feed[1:], settings.tcp_speed)
        # t >= k_v d / v and t >= sqrt(k_a d / a), with (k_v, k_a) = (3/2, 6) for two stops, (4/3, 4) for one
        feed_time = np.array([0.0, 4.0 / 3.0, 1.5])[stop_count] * move_lengths / speed
        joint_change = np.abs(np.diff(q[name], axis=0))
        step = joint_change / (settings.acceleration_fraction * loaded.data.acceleration)
        acceleration_time = np.sqrt(np.array([0.0, 4.0, 6.0])[stop_count] * step.max(axis=1, initial=0.0))
        min_duration = joint_change / (settings.speed_fraction * loaded.data.velocity)
        speed_time = np.array([0.0, 4.0 / 3.0, 1.5])[stop_count] * min_duration.max(axis=1, initial=0.0)
        duration = np.maximum.reduce([duration, feed_time, acceleration_time, speed_time])
    return plan.time[0] + np.concatenate([[0.0], np.cumsum(duration)]), stop


def _move_directions(positions: FloatArray) -> FloatArray:
    """Return the directions (N - 1, 3) of linear moves through positions (N, 3) [m].

    They are unit vectors, or shorter for moves below 1 um.
    """
    moves = np.diff(positions, axis=0)
    return np.asarray(moves / np.maximum(np.linalg.norm(moves, axis=1), 1e-6)[:, None])


def _midpoint_errors(
    loaded: _LoadedArm, q: FloatArray, fractions: FloatArray, feed: _FeedDirections
) -> FloatArray:
    """Compute the position error (N - 1,) [m] of the TCP at the middle of moves between targets ``q`` (N, 6).

    ``fractions`` (N,) are those of the process force at the targets. A controller moves linearly between
    commanded targets, so the sag that it compensates at the middle is the mean of both ends. The error is the
    distance between this mean and the sag at the middle.
    """
    middle = 0.5 * (q[1:] + q[:-1])
    at_ends = loaded.deflection(q, fractions, feed.at)
    # while the force rises or falls, it is looked up at the end of the move at which it acts in full
    start_height, end_height = loaded.tcp_height(q[:-1]), loaded.tcp_height(q[1:])
    height = np.where(
        fractions[:-1] == fractions[1:],
        loaded.tcp_height(middle),
        np.where(fractions[1:] > 0.0, end_height, start_height),
    )
    middle_deflection = loaded.deflection(middle, 0.5 * (fractions[1:] + fractions[:-1]), feed.middle, height)
    return loaded.tcp_distance(middle + middle_deflection - 0.5 * (at_ends[1:] + at_ends[:-1]), middle)


def _sag_note(plan: OperationPlan, arm: str, claim: ArmSags, shift: FloatArray) -> Issue:
    """Return the note on the largest ``shift`` (N,) [m] of commanded from planned TCP positions."""
    worst_index = int(np.argmax(shift))
    load = f"{claim.mass:.2f} kg and {max_work_force(claim):g} N"
    message = (
        f"{plan.name}: commanded positions of {arm} deviate by up to {shift[worst_index] / MM:.3f} mm from "
    )
    message += f"the plan to compensate its sag under {load}; its controller must not compensate the same sag"
    hint = "switch off the controller's load compensation, or state load: false (docs/stiffness.md)"
    max_shift = _LimitedLength(arm, worst_index, shift[worst_index], claim.max_deflection)
    return _target_issue("motion.sag", message, plan, max_shift, hint, Severity.NOTE)


@dataclasses.dataclass(frozen=True)
class _LimitedLength:
    """A length of an arm at a target, with its limit.

    Attributes:
        arm: Name of the arm.
        index: Index of the target.
        value: The length [m].
        limit: Its limit [m].
    """

    arm: str
    index: int
    value: float
    limit: float


def _target_issue(
    code: str,
    message: str,
    plan: OperationPlan,
    length: _LimitedLength,
    hint: str | None = None,
    severity: Severity = Severity.ERROR,
) -> Issue:
    """Create an issue with the value and the limit of a length, in mm, at a target of a plan."""
    return Issue(
        code,
        message,
        severity,
        arm=length.arm,
        index=length.index,
        target=plan.targets.name(length.index),
        **measurement(float(length.value / MM), float(length.limit / MM), "mm"),
        hint=hint,
    )


def _range_issues(plan: OperationPlan, arm: str, claim: ArmSags, shift: FloatArray) -> list[Issue]:
    """Return an issue if the largest ``shift`` (N,) [m] of an arm exceeds the stated limit."""
    worst_index = int(np.argmax(shift))
    max_shift = _LimitedLength(arm, worst_index, shift[worst_index], claim.max_deflection)
    if max_shift.value <= max_shift.limit:
        return []
    subject = f"{plan.name}: {arm} sags by {max_shift.value / MM:.2f} mm at {plan.targets.name(worst_index)}"
    message = f"{subject}; allowed: {claim.max_deflection / MM:g} mm; use a stiffer arm or less force"
    hint = f"or allow more: compensate_sag: {{most_mm: {np.ceil(max_shift.value / MM * 10.0) / 10.0:g}}}"
    return [_target_issue(RANGE_CODE, message, plan, max_shift, hint)]


def _min_feed_issues(plan: OperationPlan, arm: str) -> list[Issue]:
    """Return an issue if a minimum feed is stated, because the tool stops where the force starts and ends."""
    if not (plan.targets.feed_min > 0.0).any():
        return []
    message = (
        f"{plan.name}: the tool stops where the force on {arm} starts and ends, but a minimum feed is set; "
    )
    return [Issue(RANGE_CODE, f"{message}remove the force or the minimum feed", arm=arm)]


def _feed_force_issues(
    plan: OperationPlan, arm: str, loaded: _LoadedArm, fractions: FloatArray, span: FloatArray
) -> list[Issue]:
    """Return an issue if a force that turns with the feed shifts the arm too far.

    The allowed shift is a fraction of the path length over which the direction of the feed is averaged.

    Args:
        plan: Plan that the arms should follow.
        arm: Name of the arm.
        loaded: The arm with its loads.
        fractions: (N,) fraction of the process force at each target.
        span: (N,) [m] path length over which the direction at each target is averaged.
    """
    q = plan.q[arm]
    without_force = q - loaded.deflection(q, fractions, np.zeros((len(q), 3)))
    axes = loaded.tcp_poses(q)[:, :3, :2]  # x and y of the tool, as two perpendicular directions of the feed
    forward_shift, side_shift = (
        loaded.tcp_distance(without_force, q - loaded.deflection(q, fractions, axes[:, :, k]))
        for k in range(2)
    )
    shift = forward_shift + side_shift  # bounds the shift for any direction of the feed
    excess = np.where(span > 0.0, shift - MAX_SHIFT_FRACTION * span, -np.inf)
    worst_index = int(np.argmax(excess))
    if not excess[worst_index] > 0.0:
        return []
    max_shift = _LimitedLength(
        arm, worst_index, shift[worst_index], limit=MAX_SHIFT_FRACTION * span[worst_index]
    )
    limit = max_shift.limit
    message = f"{plan.name}: at {plan.targets.name(worst_index)} {arm} sags by {max_shift.value / MM:.2f} mm "
    message += (
        f"under a force that turns with the feed over {span[worst_index] / MM:.2f} mm of path; allowed: "
    )
    message += (
        f"{limit / MM:.2f} mm; use a stiffer arm, less force or a longer cut, or state the force in the "
    )
    message += "tool frame"
    return [_target_issue(RANGE_CODE, message, plan, max_shift)]


def _force_table_issues(
    plan: OperationPlan, arm: str, loaded: _LoadedArm, fractions: FloatArray, feed: FloatArray
) -> list[Issue]:
    """Return issues for work above or below a table of forces, and for a table that is too steep.

    If the force of a table changes fast with the height, the depth of the arm could not be inferred from
    commanded positions.

    Args:
        plan: Plan that the arms should follow.
        arm: Name of the arm.
        loaded: The arm with its table of forces.
        fractions: (N,) fraction of the process force at each target.
        feed: (N, 3) mean feed direction at each target.
    """
    q = plan.q[arm]
    out: list[Issue] = []
    rows = np.flatnonzero(fractions > 0.0)
    knots = loaded.claim.height if loaded.claim is not None else np.zeros(1)
    if not len(rows):
        return out
    heights = loaded.tcp_height(q[rows])
    excess = np.maximum(knots[0] - heights, heights - knots[-1])
    k = int(np.argmax(excess))
    if excess[k] > HEIGHT_TOLERANCE_M:
        index, end = int(rows[k]), knots[0] if heights[k] < knots[0] else knots[-1]
        message = f"{plan.name}: {arm} works at z {heights[k] / MM:.2f} mm of the stock, at "
        message += f"{plan.targets.name(index)}; its table of forces covers {knots[0] / MM:g} to "
        message += f"{knots[-1] / MM:g} mm; add rows"
        out.append(_target_issue(RANGE_CODE, message, plan, _LimitedLength(arm, index, heights[k], end)))
    # The sag by the steepest change of the force over 1 mm of height is the change of sag per millimetre.
    slope = np.diff(loaded.force, axis=0) / np.diff(knots)[:, None]
    steep = dataclasses.replace(loaded, force=slope[[int(np.argmax(np.linalg.norm(slope, axis=1)))]])
    no_force = np.zeros(len(rows))
    change = steep.deflection(q[rows], fractions[rows] * MM, feed[rows]) - steep.deflection(
        q[rows], no_force, feed[rows]
    )
    shift = loaded.tcp_distance(q[rows], q[rows] + change)
    k = int(np.argmax(shift))
    if shift[k] > MAX_SHIFT_FRACTION * MM:
        index = int(rows[k])
        message = f"{plan.name}: where the table of forces of {arm} is steepest, the sag changes by "
        message += f"{shift[k] / MM:.2f} mm per millimetre of height, at {plan.targets.name(index)}; "
        message += f"allowed: {MAX_SHIFT_FRACTION:g} mm; use a stiffer arm, or space the rows farther apart"
        change_per_mm = _LimitedLength(arm, index, shift[k], MAX_SHIFT_FRACTION * MM)
        out.append(_target_issue(RANGE_CODE, message, plan, change_per_mm))
    return out


def _uneven_sag_issues(plan: OperationPlan, arm: str, errors: FloatArray) -> list[Issue]:
    """Return an issue if working targets are so far apart that the sag between them is not linear.

    ``errors`` (N - 1,) [m] are those of :func:`_midpoint_errors`.
    """
    works = np.array([segment.works for segment in plan.targets.segment[1:]], dtype=np.bool_)
    errors = np.where(works, errors, 0.0)
    worst_move = int(np.argmax(errors)) if len(errors) else 0
    if not len(errors) or errors[worst_move] <= MAX_SAG_ERROR_M:
        return []
    name, error_mm = plan.targets.name(worst_move + 1), errors[worst_move] / MM
    message = (
        f"{plan.name}: on the move to {name} the sag of {arm} deviates by {error_mm:.3f} mm from the mean of "
    )
    message += f"both ends; allowed: {MAX_SAG_ERROR_M / MM:g} mm; place the targets closer together"
    max_error = _LimitedLength(arm, worst_move + 1, errors[worst_move], MAX_SAG_ERROR_M)
    return [_target_issue(RANGE_CODE, message, plan, max_error)]
