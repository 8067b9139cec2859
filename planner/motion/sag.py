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


@dataclasses.dataclass(frozen=True)
class _LoadedArm:
    """An arm on its base, with its loads.

    Attributes:
        base: (4, 4) base pose.
        claim: Its sag, if it is compensated.
        force: (K, 3) [N] process force at heights ``claim.height`` of the TCP above the stock frame.
        stock_pose: (4, 4) stock pose.
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
        """Joint deflections (N, 6) [rad] of the arm beyond the commanded joints.

        Args:
            q: (N, 6) [rad] joints.
            fraction: (N,) fraction of the process force that acts.
            feed: (N, 3) mean feed direction in the world.
            height: (N,) [m] heights at which the force is looked up; None for those of the TCP.
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
        work_force = np.einsum(
            "nij,nj->ni", axes, self.work_forces(self.tcp_height(q) if height is None else height)
        )
        loads = (
            PointLoad(payload_position, weight),
            PointLoad(tcp[:, :3, 3], fraction[:, None] * work_force),
        )
        return joint_deflection(self.data, JointStiffness(self.claim.joints, ""), q, loads)

    def tcp_height(self, q: FloatArray) -> FloatArray:
        """Height (N,) [m] of the TCP in the stock frame."""
        return np.asarray((self.tcp_poses(q)[:, :3, 3] - self.stock_pose[:3, 3]) @ self.stock_pose[:3, 2])

    def work_forces(self, height: FloatArray) -> FloatArray:
        """Full process force (N, 3) [N] at heights (N,) [m], along the axes of its frame."""
        if self.claim is None or len(self.force) == 1:
            return np.broadcast_to(self.force[0], (len(height), 3))
        return np.stack([np.interp(height, self.claim.height, column) for column in self.force.T], axis=1)

    def gravity_deflection(self, q: FloatArray) -> FloatArray:
        """Joint deflections (N, 6) [rad] by weight alone."""
        return self.deflection(q, np.zeros(len(q)), np.zeros((len(q), 3)))

    def tcp_poses(self, q: FloatArray) -> FloatArray:
        """TCP poses (N, 4, 4) in the world."""
        return np.asarray(self.base @ forward_kinematics(self.data, q) @ self.arm.tool.tcp)

    def tcp_distance(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Distance (N,) [m] between the TCPs of two sets of joints."""
        return np.asarray(np.linalg.norm((self.tcp_poses(first) - self.tcp_poses(second))[:, :3, 3], axis=1))


def commanded_plan(problem: Problem, plan: Plan) -> tuple[Plan, tuple[Issue, ...]]:
    """Return the plan as commanded, and notes. Without compensated sag it is the plan itself.

    Raises:
        TandemError: ``motion.sag_range`` if a shift exceeds its range, or targets are so far apart that the
            sag between them is not linear.
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
    """Return the plan with the joints of the commanded plan added where they differ."""
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
    """Extra clearance [m] and extra joint margin [rad] that planning needs for compensated sag.

    With them commanded joints and sagged arms keep the required margins. The bounds hold in all postures.
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
            # a coupling rod transfers its load to axis 2 as well
            rods = 1.0 if data.coupling is None else 2.0
            joint_margin = max(
                joint_margin, rods * force * (data.reach + tool_length) / float(claim.joints.min())
            )
            deflections = _LoadedArm(
                arm, data, arm.base, claim, np.zeros((1, 3)), np.eye(4)
            ).gravity_deflection(arm.home[None])
            clearance = max(
                clearance, float(np.abs(deflections).sum()) * (data.reach + tool_length) + AIR_SAG_ALLOWANCE_M
            )
    return clearance, joint_margin


def _loaded_arms(problem: Problem, setup: Setup, plan: Plan) -> dict[str, _LoadedArm]:
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
    """Largest process force [N] that is stated for an arm."""
    return float(np.linalg.norm(claim.force, axis=1).max())


def force_fractions(targets: Targets) -> FloatArray:
    """Fraction (N,) of the process force at each target: 1 where a move of the work itself ends."""
    works = [segment.works and not segment.phase for segment in targets.segment]
    fractions = np.array(works, dtype=np.float64)
    fractions[:1] = 0.0
    return fractions


@dataclasses.dataclass(frozen=True)
class _FeedDirections:
    """Mean feed directions in the world; 0 where no force acts.

    Attributes:
        at: (N, 3) at targets.
        middle: (N - 1, 3) at the middle of moves.
        span: (N,) [m] path length over which the direction is averaged.
    """

    at: FloatArray
    middle: FloatArray
    span: FloatArray


def feed_directions(positions: FloatArray, fraction: FloatArray) -> _FeedDirections:
    """Mean feed directions along linear moves where the process force acts.

    Each direction is the chord from `FEED_WAY` before a position to `FEED_WAY` after it, within the same run
    of working moves, divided by its path length.

    Args:
        positions: (N, 3) [m] positions of the TCP.
        fraction: (N,) fraction of the process force that acts.
    """
    works, rows = fraction > 0.0, np.arange(len(fraction))
    path_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    begins = works & ~np.concatenate([[False], works[:-1]])
    ends = works & ~np.concatenate([works[1:], [False]])
    low = path_length[np.maximum(np.maximum.accumulate(np.where(begins, rows, 0)) - 1, 0)]
    high = path_length[np.minimum.accumulate(np.where(ends, rows, len(rows) - 1)[::-1])[::-1]]

    def mean_direction(at: FloatArray, row: IntArray) -> tuple[FloatArray, FloatArray]:
        first, last = np.maximum(at - FEED_PATH_M, low[row]), np.minimum(at + FEED_PATH_M, high[row])
        chord = np.stack(
            [np.interp(last, path_length, x) - np.interp(first, path_length, x) for x in positions.T], axis=1
        )
        span = np.where(works[row], last - first, 0.0)
        return np.where(span > 0.0, 1.0 / np.maximum(span, 1e-12), 0.0)[:, None] * chord, span

    at, span = mean_direction(path_length, rows)
    middle, _ = mean_direction(0.5 * (path_length[1:] + path_length[:-1]), rows[1:])
    is_falling = works[:-1] & ~works[1:]
    return _FeedDirections(at, np.where(is_falling[:, None], at[:-1], middle), span)


def _feed_axes(feed: FloatArray, axis: FloatArray) -> FloatArray:
    """Axes of the feed as columns (N, 3, 3): forward, right, and along the tool's ``axis`` (N, 3).

    The first two have the length of the component of ``feed`` (N, 3) across the axis.
    """
    across = feed - np.sum(feed * axis, axis=1, keepdims=True) * axis
    return np.stack([across, np.cross(axis, across), axis], axis=-1)


def _command_operation(
    plan: OperationPlan, arms: Mapping[str, _LoadedArm], settings: Settings
) -> tuple[OperationPlan, list[Issue], list[Issue]]:
    targets, has_force = (
        plan.targets,
        [loaded.claim is not None and loaded.claim.force.any() for loaded in arms.values()],
    )
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
    entry, exit_ = (
        {arm: rows - arms[arm].gravity_deflection(rows) for arm, rows in path.items()}
        for path in (plan.approach, plan.retreat)
    )
    time, stop = _retime(plan, arms, q, fractions, settings)
    commanded = dataclasses.replace(
        plan,
        targets=dataclasses.replace(targets, pose=_commanded_poses(plan, arms, q), freedoms=(), stop=stop),
        q=q,
        values=np.zeros((targets.count, 0)),
        time=time,
        approach=entry,
        retreat=exit_,
    )
    return commanded, notes, errors


def _commanded_poses(
    plan: OperationPlan, arms: Mapping[str, _LoadedArm], q: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Commanded TCP poses {arm: (N, 4, 4)} in the work frames.

    A frame that an arm carries moves with the commanded motion of that arm.
    """
    targets = plan.targets
    out = {}
    for arm, pose in targets.poses(plan.values).items():
        frame = targets.frame[arm]
        carrier = frame.removeprefix("held:") if frame.startswith("held:") else None
        if all(name is None or arms[name].claim is None for name in (arm, carrier)):
            out[arm] = pose
            continue
        frames = arms[arm].tcp_poses(plan.q[arm]) @ inverse(pose)
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
    """Times (N,) [s] and stops (N,) of the targets.

    The tool stops where the force starts and ends to rise or fall, because the commanded path has corners
    there that must not be blended. It also stops where the direction changes so fast with the feed that
    corners exceed the planned ones. Moves from and to new stops are slowed as required.

    With a cubic between two stops, a move of mean speed 1 and duration 1 has the peak speed 3/2 and the peak
    acceleration 6. With a stop at one end and the mean speed at the other end the peaks are 4/3 and 4.
    """
    targets = plan.targets
    force_changes = np.flatnonzero(np.diff(fractions) != 0.0) + 1
    stop = targets.stop.copy()
    stop[np.concatenate([force_changes - 1, force_changes])] = True
    for name in (arm for arm in targets.arms if arms[arm].turns_with_feed):
        directions = (
            _move_directions(arms[name].tcp_poses(rows)[:, :3, 3]) for rows in (plan.q[name], q[name])
        )
        planned_turns, commanded_turns = (np.diff(move_lengths, axis=0) for move_lengths in directions)
        turns_more = np.linalg.norm(commanded_turns - planned_turns, axis=1) > MAX_EXTRA_TURN_RAD
        stop[1:-1] |= turns_more & (fractions[1:-1] > 0.0)
    new_stops = stop & ~targets.stop
    ends = (stop[1:].astype(np.int64) + stop[:-1]) * (new_stops[1:] | new_stops[:-1])
    ends[force_changes - 1] = np.maximum(ends[force_changes - 1], 2)
    duration = np.diff(plan.time)
    for name in targets.arms:
        loaded = arms[name]
        # the longer of the commanded move and the move of the sagged arm
        move_lengths = np.max(
            [
                np.linalg.norm(np.diff(loaded.tcp_poses(rows)[:, :3, 3], axis=0), axis=1)
                for rows in (q[name], plan.q[name])
            ],
            axis=0,
        )
        speed = np.minimum(targets.feed[1:], settings.tcp_speed)
        # t >= k_v d / v and t >= sqrt(k_a d / a), with (k_v, k_a) = (3/2, 6) for two stops, (4/3, 4) for one
        feed_time = np.array([0.0, 4.0 / 3.0, 1.5])[ends] * move_lengths / speed
        step = np.abs(np.diff(q[name], axis=0)) / (settings.acceleration_fraction * loaded.data.acceleration)
        acceleration_time = np.sqrt(np.array([0.0, 4.0, 6.0])[ends] * step.max(axis=1, initial=0.0))
        turn = np.abs(np.diff(q[name], axis=0)) / (settings.speed_fraction * loaded.data.velocity)
        speed_time = np.array([0.0, 4.0 / 3.0, 1.5])[ends] * turn.max(axis=1, initial=0.0)
        duration = np.maximum.reduce([duration, feed_time, acceleration_time, speed_time])
    return plan.time[0] + np.concatenate([[0.0], np.cumsum(duration)]), stop


def _move_directions(positions: FloatArray) -> FloatArray:
    """Directions (N - 1, 3) of moves through positions (N, 3).

    Their length is 1, or less for moves of almost no length.
    """
    moves = np.diff(positions, axis=0)
    return np.asarray(moves / np.maximum(np.linalg.norm(moves, axis=1), 1e-6)[:, None])


def _midpoint_errors(
    loaded: _LoadedArm, q: FloatArray, fractions: FloatArray, feed: _FeedDirections
) -> FloatArray:
    """Errors (N - 1,) [m] of the TCP at the middle of moves between targets ``q`` (N, 6).

    The error is the sag at the middle minus the mean of the sags at both ends.
    """
    middle = 0.5 * (q[1:] + q[:-1])
    at_ends = loaded.deflection(q, fractions, feed.at)
    # while the force rises or falls, it is looked up at the end of the move at which it acts in full
    first, last = loaded.tcp_height(q[:-1]), loaded.tcp_height(q[1:])
    height = np.where(
        fractions[:-1] == fractions[1:], loaded.tcp_height(middle), np.where(fractions[1:] > 0.0, last, first)
    )
    middle_deflection = loaded.deflection(middle, 0.5 * (fractions[1:] + fractions[:-1]), feed.middle, height)
    return loaded.tcp_distance(middle + middle_deflection - 0.5 * (at_ends[1:] + at_ends[:-1]), middle)


def _sag_note(plan: OperationPlan, arm: str, claim: ArmSags, shift: FloatArray) -> Issue:
    worst = int(np.argmax(shift))
    load = f"{claim.mass:.2f} kg and {max_work_force(claim):g} N"
    message = f"{plan.name}: commanded positions of {arm} deviate by up to {shift[worst] / MM:.3f} mm from "
    message += f"the plan to compensate its sag under {load}; its controller must not compensate the same sag"
    hint = "switch off the controller's load compensation, or state load: false (docs/stiffness.md)"
    greatest = _LimitedLength(arm, worst, shift[worst], claim.max_deflection)
    return _target_issue("motion.sag", message, plan, greatest, hint, Severity.NOTE)


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
    """Create the issue of a length at a target of a plan."""
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
    worst = int(np.argmax(shift))
    if shift[worst] <= claim.max_deflection:
        return []
    subject = f"{plan.name}: {arm} sags by {shift[worst] / MM:.2f} mm at {plan.targets.name(worst)}"
    message = f"{subject}; allowed: {claim.max_deflection / MM:g} mm; use a stiffer arm or less force"
    hint = f"or allow more: compensate_sag: {{most_mm: {np.ceil(shift[worst] / MM * 10.0) / 10.0:g}}}"
    greatest = _LimitedLength(arm, worst, shift[worst], claim.max_deflection)
    return [_target_issue(RANGE_CODE, message, plan, greatest, hint)]


def _min_feed_issues(plan: OperationPlan, arm: str) -> list[Issue]:
    """Issue if a force starts to act, at which the tool stops, although a minimum feed is stated."""
    if not (plan.targets.feed_min > 0.0).any():
        return []
    message = (
        f"{plan.name}: the tool stops where the force on {arm} starts and ends, but a minimum feed is set; "
    )
    return [Issue(RANGE_CODE, f"{message}remove the force or the minimum feed", arm=arm)]


def _feed_force_issues(
    plan: OperationPlan, arm: str, loaded: _LoadedArm, fractions: FloatArray, span: FloatArray
) -> list[Issue]:
    """Issue if a force that turns with the feed shifts the arm too far.

    The allowed shift depends on the path length over which the force turns.
    """
    q = plan.q[arm]
    without_force = q - loaded.deflection(q, fractions, np.zeros((len(q), 3)))
    axes = loaded.tcp_poses(q)[:, :3, :2]
    forward_shift, side_shift = (
        loaded.tcp_distance(without_force, q - loaded.deflection(q, fractions, axes[:, :, k]))
        for k in range(2)
    )
    shift = forward_shift + side_shift
    excess = np.where(span > 0.0, shift - MAX_SHIFT_FRACTION * span, -np.inf)
    worst = int(np.argmax(excess))
    if not excess[worst] > 0.0:
        return []
    limit = MAX_SHIFT_FRACTION * span[worst]
    message = f"{plan.name}: at {plan.targets.name(worst)} {arm} sags by {shift[worst] / MM:.2f} mm under "
    message += f"a force that turns with the feed over {span[worst] / MM:.2f} mm of path; allowed: "
    message += (
        f"{limit / MM:.2f} mm; use a stiffer arm, less force or a longer cut, or state the force in the "
    )
    message += "tool frame"
    return [_target_issue(RANGE_CODE, message, plan, _LimitedLength(arm, worst, shift[worst], limit))]


def _force_table_issues(
    plan: OperationPlan, arm: str, loaded: _LoadedArm, fractions: FloatArray, feed: FloatArray
) -> list[Issue]:
    """Issues for work above or below a table of forces, and for a table that is too steep.

    On a steep table, the depth of the arm could not be inferred from commanded positions.
    """
    q, out = plan.q[arm], list[Issue]()
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
    """Issue if working targets are so far apart that the sag between them is not linear."""
    works = np.array([segment.works for segment in plan.targets.segment[1:]], dtype=np.bool_)
    errors = np.where(works, errors, 0.0)
    worst = int(np.argmax(errors)) if len(errors) else 0
    if not len(errors) or errors[worst] <= MAX_SAG_ERROR_M:
        return []
    name, error_mm = plan.targets.name(worst + 1), errors[worst] / MM
    message = (
        f"{plan.name}: on the move to {name} the sag of {arm} deviates by {error_mm:.3f} mm from the mean of "
    )
    message += f"both ends; allowed: {MAX_SAG_ERROR_M / MM:g} mm; place the targets closer together"
    greatest = _LimitedLength(arm, worst + 1, errors[worst], MAX_SAG_ERROR_M)
    return [_target_issue(RANGE_CODE, message, plan, greatest)]
