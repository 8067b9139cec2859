"""Converts a plan to the steps of each task: which arm moves when, where tasks meet, and what arms carry.

It also decides which targets the programs move to. An arm carries the block that its tool holds, whose load
the controller must know.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from planner.cell import external_axis_motion
from planner.cell.external_axis_motion import AxisTravel
from planner.claims.claim import HoldsStock
from planner.claims.handshake import Handshake
from planner.claims.segments import Segment
from planner.geometry import corner_rounding
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, to_quaternion
from planner.geometry.units import MM
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.languages.writing import handshake as handshake_drift
from planner.languages.writing import layout
from planner.languages.writing.external_axes import (
    axis_legs,
    external_axis_values,
    table_of,
    with_axis_setpoint,
)
from planner.languages.writing.handshake import handshake_refusals, lengthen_for_stops, meeting_rows
from planner.languages.writing.language import writer_of
from planner.plans import OperationPlan, Plan
from planner.problem import EXTERNAL_AXIS_DECIMALS, Arm, Cell, Problem, Settings, Setup
from planner.targets import TargetAction, Targets
from planner.tooling import Tool

MIN_MASS_KG = 0.001
"""Minimum mass of a load in RAPID [kg]."""


def require_mass(tool: Tool, requirement: str = "a load needs at least {} kg") -> None:
    """Check that a tool has a mass.

    Args:
        tool: The tool.
        requirement: Requirement in the message, with a field {} for the minimum mass.

    Raises:
        TandemError: The mass is missing or too small (``post.tool``).
    """
    if not tool.mass >= MIN_MASS_KG:
        message = format_message(
            "post.tool", tool=tool.name, mass_kg=tool.mass, requirement=requirement.format(MIN_MASS_KG)
        )
        raise issue_error("post.tool", message, hint=f"state the tool's mass_kg, {MIN_MASS_KG} or more")


def load_changes(plan: Plan, problem: Problem) -> dict[int, dict[str, layout.CarryLoad]]:
    """Return the changes of the load that arms carry, by index of the operation before which they happen.

    A new holder takes the block of its setup, and the previous holder then carries nothing.

    Args:
        plan: The plan.
        problem: Problem of the plan.

    Returns:
        For the first operation of each setup a mapping {arm: what it carries from there on}.

    Raises:
        TandemError: A block is held and no claim states its mass (``post.load``).
    """
    out: dict[int, dict[str, layout.CarryLoad]] = {}
    previous_holder: str | None = None
    for setup in problem.setups:
        if setup.operations[0] >= len(plan.operations):
            break
        holder = setup.stock.held_by
        change: dict[str, layout.CarryLoad] = {}
        if previous_holder is not None and previous_holder != holder:
            change[previous_holder] = layout.CarryLoad(None)
        if holder is not None:
            change[holder] = layout.CarryLoad(_held_load(plan, setup, holder))
        out[setup.operations[0]] = change
        previous_holder = holder
    return out


def _held_load(plan: Plan, setup: Setup, holder: str) -> layout.HeldLoad:
    """Return the load of a setup's block in the holder's TCP frame, as a solid box of uniform density.

    The moment of inertia about each principal axis is I = m / 12 (|s|^2 - s_i^2), with edge lengths s.

    Raises:
        TandemError: No claim states a sufficient mass of the block (``post.load``).
    """
    claims = [
        claim
        for index in setup.operations
        if index < len(plan.operations)
        for claim in plan.operations[index].targets.claims
        if isinstance(claim, HoldsStock) and claim.arm == holder
    ]
    if not claims or not claims[0].mass >= MIN_MASS_KG:
        mass_text = f"{claims[0].mass:g} kg" if claims else "no claim of its mass"
        message = (
            f"setup {setup.number}: arm {holder} holds the block, with {mass_text}; at least {MIN_MASS_KG} kg"
        )
        hint = "use a larger block, or a denser foam" if claims else "name the block's foam (stock.foam)"
        raise issue_error("post.load", message, arm=holder, hint=f"{hint}, and plan again")
    claim, size = claims[0], setup.stock.upper - setup.stock.lower
    inertia = claim.mass / 12.0 * (np.sum(size**2) - size**2)
    return layout.HeldLoad(setup.number, claim.mass, claim.cog, claim.grip[:3, :3], inertia)


MAX_TASKS = 2
"""Maximum number of motion tasks."""
JOINT_TOLERANCE_RAD = 1e-6
"""Largest joint difference [rad] of two postures that count as the same; about 0.00005 deg."""


def build_job(plan: Plan, problem: Problem) -> layout.JobPrograms:
    """Return the steps of every task, from which the writers of all languages write the programs.

    Meetings and synchronised blocks are numbered over the whole job.

    Args:
        plan: The plan.
        problem: Problem of the plan.

    Raises:
        TandemError: No program can execute the plan (``post.*``).
    """
    used = {arm for operation in plan.operations for arm in operation.targets.arms}
    arms = [arm for arm in problem.cell.arms if arm.name in used]
    controller = problem.cell.controller
    max_arms = min(len(controller.tasks), len(controller.units), MAX_TASKS)
    if not 1 <= len(arms) <= max_arms:
        message = f"{len(arms)} arms move; the controller has tasks and units for {max_arms}"
        raise issue_error("post.tasks", message, hint="name one task and one unit for each arm of the cell")
    setups = {index: setup for setup in problem.setups for index in setup.operations}
    if len(plan.operations) > len(setups) or len(plan.stock_poses) < len(problem.setups):
        message = (
            f"the plan has {len(plan.operations)} operations in {len(plan.stock_poses)} setups, the problem "
            f"{len(setups)} in {len(problem.setups)}"
        )
        raise issue_error("post.plan", message, hint="plan this problem again")
    handshake = controller.handshake if controller.sync == "handshake" and len(arms) > 1 else None
    if handshake is not None:
        refusals = handshake_refusals(problem, [operation.targets for operation in plan.operations])
        if refusals:
            raise TandemError(refusals)
    homes = {arm.name: external_axis_values(arm, problem.cell, problem.axis_homes) for arm in arms}
    builder = _JobBuilder([arm.name for arm in arms], handshake, problem.settings, homes)
    loads = load_changes(plan, problem)
    travels = external_axis_motion.axis_travels(problem, plan.stock_poses)
    programs_by_operation = [
        builder.operation(
            i,
            operation,
            setups[i],
            plan.stock_poses[setups[i].number - 1],
            _Changeover(
                loads.get(i, {}),
                travels[i : i + 2],
                problem.closing_setup if i + 1 == len(problem.operations) else None,
            ),
        )
        for i, operation in enumerate(plan.operations)
    ]
    arm_index = {arm.name: i for i, arm in enumerate(problem.cell.arms)}
    tasks = tuple(
        layout.TaskProgram(
            number=n + 1,
            task=controller.tasks[arm_index[arm.name]],
            unit=controller.units[arm_index[arm.name]],
            arm=arm,
            robot=arm.data,
            base=plan.bases.get(arm.name, arm.base),
            operations=tuple(part[arm.name] for part in programs_by_operation),
            table=table_of(arm, problem.cell),
            home_setpoint=homes[arm.name],
        )
        for n, arm in enumerate(arms)
    )
    actions = [action for operation in plan.operations for action in operation.targets.actions]
    signals = dict.fromkeys(action.signal for action in actions if action.kind in ("on", "off"))
    coupled = any(operation.targets.coupled for operation in plan.operations)
    drifts = (
        () if handshake is None else handshake_drift.operation_drifts(plan, setups, programs_by_operation)
    )
    return layout.JobPrograms(
        tasks, builder.meets, builder.blocks, coupled, tuple(signals), handshake, drifts
    )


@dataclasses.dataclass(frozen=True)
class _Changeover:
    """Changes before and after an operation.

    Attributes:
        loads: What arms carry from the start of the operation on, by arm.
        travels: Travels of external axes by name of the axis: first those before the operation, then those
            after it.
        closing: Setup after the operation, if external axes go home then.
    """

    loads: Mapping[str, layout.CarryLoad]
    travels: Sequence[Mapping[str, AxisTravel]]
    closing: Setup | None = None


class _JobBuilder:
    """Lays out the operations of a job as steps of each task, and numbers meetings and blocks.

    Attributes:
        meets: Number of meetings so far.
        blocks: Number of synchronised blocks so far.
        steps: Steps of the current operation, by arm.
        axis_setpoints: Values of the external axes at this point of the job, by arm.
    """

    def __init__(
        self,
        arms: Sequence[str],
        handshake: Handshake | None,
        settings: Settings,
        axis_setpoints: Mapping[str, layout.ExternalAxisValues | None],
    ) -> None:
        self.arms = arms
        self.handshake = handshake
        self.settings = settings
        self.meets = 0 if handshake is None else 1  # the first meeting precedes all operations
        self.blocks = 0
        self.steps: dict[str, list[layout.TaskStep]] = {}
        self.axis_setpoints = dict(axis_setpoints)

    def operation(
        self, number: int, plan: OperationPlan, setup: Setup, stock_pose: FloatArray, changeover: _Changeover
    ) -> dict[str, layout.OperationProgram]:
        """Return the programs of an operation, by arm: approach, work, retreat, and changes before and after.

        Arms that do not take part in the operation get a program without moves, in which they wait.

        Args:
            number: Index of the operation, from 0.
            plan: Plan of the operation.
            setup: Setup of the operation.
            stock_pose: Pose of the stock in the world, (4, 4) [m].
            changeover: Changes before and after the operation.
        """
        targets, travels, closing = plan.targets, changeover.travels, changeover.closing
        _check_plan(plan, self.handshake is None)
        frames = _written_frames(plan, setup)
        arms = {arm.name: arm for arm in setup.cell.arms}
        writers = {arm: writer_of(arms[arm]) for arm in targets.arms}
        planned = _written_poses(plan, frames, stock_pose)
        written = {arm: writers[arm].round_poses(*poses) for arm, poses in planned.items()}
        # which targets the programs move to, stops, and meetings: all follow from the poses as written
        keep = _moved_targets(written)
        stop = _stops(targets, keep)
        meets = np.zeros(len(keep), dtype=np.int64)
        stopping_positions = [written[arm][0] for arm in targets.arms if writers[arm].stops_at_turns]
        rotation_stops = _rotation_stops(stopping_positions, targets, keep) & ~stop
        stop = stop | rotation_stops
        if self.handshake is not None and len(targets.arms) > 1:
            paused = [written[arm] for arm in targets.arms if writers[arm].stops_at_pauses]
            stop = stop | _pause_stops(paused, keep)
            stop = meeting_rows(stop, self.handshake.every)
            meets = stop.astype(np.int64)
        moves = _WrittenMoves(keep, stop, _durations(plan, keep))
        if meets.any() or rotation_stops.any():
            duration = _lengthened(moves, plan, written, arms, self.settings)
            moves = dataclasses.replace(moves, duration=duration)
        move_tables = {
            arm: _move_table(plan, arms[arm], frames[arm], moves, *written[arm]) for arm in targets.arms
        }
        segments = tuple(targets.segment[i] for i in keep)
        # before the approach: arms at home, the operator's setup, external axes to their stations
        self.steps = {arm: [] for arm in self.arms}
        self._meet(f"all tasks are ready for operation {plan.name}")
        setpoints_before = dict(self.axis_setpoints)
        setpoints = {arm: external_axis_values(arms[arm], setup.cell, setup.axis_values) for arm in self.arms}
        final_track_values = {arm: float(values[-1]) for arm, values in targets.track_positions.items()}
        setpoints_after = {
            arm: external_axis_values(arms[arm], setup.cell, {**setup.axis_values, **final_track_values})
            for arm in self.arms
        }
        homes = {arm: arms[arm].home for arm in self.arms}
        has_setup_steps = number == setup.operations[0] and bool(setup.steps)
        for arm in self.arms:
            if number == 0 and (has_setup_steps or arm not in targets.arms):
                home = layout.JointMove(homes[arm], "entry", axis_setpoint=setpoints_before[arm])
                axes_check = () if home.axis_setpoint is None else (layout.AxesCheck(home.axis_setpoint),)
                self._solo(arm, [*axes_check, home], f"{arm} is at home")
        if has_setup_steps:
            self._operator_setup(setup)
        self._move_external_axes(setpoints, arms, setup.cell, travels[0] if travels else {})
        for arm, carry in changeover.loads.items():
            self.steps[arm].append(carry)
        # approach: all arms at once, or arm by arm in the planned order
        from_home = number > 0 or has_setup_steps
        if "entry" in plan.synchronised:
            # in the first operation the arms may be anywhere, so each of them moves home first, alone
            for arm in () if from_home else plan.arm_order:
                self._solo(arm, [layout.JointMove(homes[arm], "entry")], f"{arm} is at home")
            paths = {arm: (homes[arm], *plan.approach[arm], plan.q[arm][0]) for arm in plan.arm_order}
            self._synchronised_move(paths, "entry", "start")
        else:
            for arm in plan.arm_order:
                steps = _joint_moves((homes[arm], *plan.approach[arm], plan.q[arm][0]), "entry")
                steps[-1] = layout.JointMove(plan.q[arm][0], "start")
                self._solo(arm, steps[1:] if from_home else steps, f"{arm} is at its first target")
        # work: actions at the first target, then moves and actions up to the last one
        self._actions(targets, -1, keep)
        self._blocks(number, targets, keep, segments, meets, moves.duration)
        for arm in self.arms:
            self.steps[arm] = [with_axis_setpoint(step, setpoints[arm]) for step in self.steps[arm]]
            self.axis_setpoints[arm] = setpoints_after[arm]
        # retreat: all arms at once, or in the reverse order of the approach
        if "exit" in plan.synchronised:
            self._synchronised_move(
                {arm: (plan.q[arm][-1], *plan.retreat[arm], homes[arm]) for arm in plan.arm_order}, "exit"
            )
        else:
            for arm in reversed(plan.arm_order):
                steps = _joint_moves((plan.q[arm][-1], *plan.retreat[arm], homes[arm]), "exit")
                self._solo(arm, steps[1:], f"{arm} is home again")
        for arm in self.arms:
            self.steps[arm] = [with_axis_setpoint(step, setpoints_after[arm]) for step in self.steps[arm]]
        # after the last operation external axes go home
        if closing is not None:
            self._operator_setup(closing, "all work is done")
            final_setpoints = {
                arm: external_axis_values(arms[arm], closing.cell, closing.axis_values) for arm in self.arms
            }
            self._move_external_axes(final_setpoints, arms, closing.cell, travels[1])
        ids = np.arange(1, len(keep) + 1)
        return {
            arm: layout.OperationProgram(
                plan.name,
                setup.number,
                arms[arm],
                move_tables.get(arm),
                ids,
                stop,
                meets,
                segments,
                keep,
                tuple(self.steps[arm]),
                setpoints[arm],
            )
            for arm in self.arms
        }

    def _move_external_axes(
        self,
        setpoints: Mapping[str, layout.ExternalAxisValues | None],
        arms: Mapping[str, Arm],
        cell: Cell,
        travels: Mapping[str, AxisTravel],
    ) -> None:
        """Append moves of external axes to their station, arm by arm, while the other arm waits.

        The arm is at home meanwhile. The axes of a gantry or positioner move one after the other.
        """
        for arm in self.arms:
            setpoint, current, table = setpoints[arm], self.axis_setpoints[arm], table_of(arms[arm], cell)
            if setpoint is not None and current is not None and setpoint != current:
                legs = axis_legs(current, setpoint, arms[arm], table)
                steps = [layout.JointMove(arms[arm].home, "station", axis_setpoint=leg) for leg in legs]
                moved_item = arm if table is None else "the block"
                names = arms[arm].axes_by_name if table is None else table.axes
                seconds = sum(travels[name].seconds for name in names if name in travels)
                self._solo(arm, steps, f"{moved_item} is at its station", seconds)
                self.axis_setpoints[arm] = setpoint

    def _operator_setup(self, setup: Setup, reached: str = "") -> None:
        """Append a dialogue in which the operator prepares and confirms a setup, while all arms wait."""
        messages = [TargetAction(0, "message", text=text) for text in setup.steps]
        question = TargetAction(0, "confirm", text=setup.confirmation)
        self._solo(
            self.arms[0],
            [layout.ActionStep(action) for action in (*messages, question)],
            reached or f"setup {setup.number} is done",
        )

    def _meet(self, reached: str, seconds: float = 0.0, by: str = "") -> None:
        """Append a meeting of all arms, if there are several.

        Args:
            reached: State that holds after the meeting, as a clause.
            seconds: Planned time [s] for which the other arms wait for ``by``.
            by: Arm that acts alone before the meeting, "" for none.
        """
        if len(self.arms) > 1:
            self.meets += 1
            for arm in self.arms:
                self.steps[arm].append(layout.Meeting(self.meets, reached, 0.0 if arm == by else seconds))

    def _solo(self, arm: str, steps: Sequence[layout.TaskStep], reached: str, seconds: float = 0.0) -> None:
        """Append steps that one arm executes alone, and a meeting at which the other arms wait for it.

        Without steps nothing is appended, not even the meeting.

        Args:
            arm: Name of the arm.
            steps: The steps.
            reached: State that holds after the meeting, as a clause.
            seconds: Planned time [s] of the steps, without that of waits in actions, which is added.
        """
        if steps:
            self.steps[arm] += steps
            seconds += sum(step.action.seconds for step in steps if isinstance(step, layout.ActionStep))
            self._meet(reached, seconds, arm)

    def _synchronised_move(
        self, paths: Mapping[str, Sequence[FloatArray]], role: str, last_role: str | None = None
    ) -> None:
        """Append a synchronised block that moves all arms at once through their postures.

        The arms are at their first postures already, so there is no move to these. If all arms have equal
        postures at two consecutive waypoints, the earlier waypoint is left out. If no arm moves, there is no
        block.

        Args:
            paths: Postures (6,) [rad] of each arm; all arms have the same number.
            role: Role of the moves.
            last_role: Role of the last move, None for ``role``.
        """
        postures = np.stack([np.stack(paths[arm]) for arm in paths], axis=1)
        moves = np.abs(np.diff(postures, axis=0)).max(axis=(1, 2)) >= JOINT_TOLERANCE_RAD
        if not moves.any():
            return
        started = np.logical_or.accumulate(moves)
        # drop waypoints before the first motion, and each one that the next one equals
        postures = postures[1:][started & np.append(moves[1:], True)]
        self.blocks += 1
        for k, arm in enumerate(paths):
            roles = [role] * (len(postures) - 1) + [last_role or role]
            steps = [
                layout.JointMove(posture[k], move_role, i)
                for i, (posture, move_role) in enumerate(zip(postures, roles, strict=True), 1)
            ]
            self.steps[arm] += [layout.SyncOn(self.blocks), *steps, layout.SyncOff(self.blocks)]

    def _actions(self, targets: Targets, row: int, keep: IntArray) -> None:
        """Append the actions at the target of move ``row``, and at the targets after it without a move.

        The leading arm executes them: the first arm of the job that takes part in the operation.

        Args:
            targets: Targets of the operation.
            row: Index of the move; -1 stands for the first target of the operation.
            keep: Index of the target of each move, (M,).
        """
        first_target = keep[row] if row >= 0 else 0
        end_target = keep[row + 1] if row + 1 < len(keep) else targets.count
        actions = [action for action in targets.actions if first_target <= action.target < end_target]
        actions.sort(key=lambda action: action.target)
        lead = next(arm for arm in self.arms if arm in targets.arms)
        self._solo(
            lead, [layout.ActionStep(action) for action in actions], "the actions at this stop are done"
        )

    def _blocks(
        self,
        number: int,
        targets: Targets,
        keep: IntArray,
        segments: Sequence[Segment],
        meets: IntArray,
        duration: FloatArray,
    ) -> None:
        """Append the moves of an operation, and between them the actions at their targets.

        If several arms move, their moves between two actions are one synchronised block. If one arm moves,
        the other arms wait for it at a meeting after each such sequence of moves.

        Args:
            number: Index of the operation, from 0.
            targets: Targets of the operation.
            keep: Index of the target of each move, (M,).
            segments: Segment of each move.
            meets: Nonzero for moves after which the arms meet by handshake, (M,). The entries are replaced by
                the numbers of these meetings, in place.
            duration: Times of the moves, (M,) [s].
        """
        together = len(targets.arms) > 1
        moves_before_actions = {
            int(np.searchsorted(keep, action.target, side="right")) - 1 for action in targets.actions
        }
        edges = sorted({0, len(keep)} | {end + 1 for end in moves_before_actions})
        for first, last in itertools.pairwise(edges):
            if together:
                self.blocks += 1
            runs = _runs(number, segments, first, last, together)
            for arm in targets.arms:
                if together:
                    self.steps[arm] += [layout.SyncOn(self.blocks), *runs, layout.SyncOff(self.blocks)]
                else:
                    self.steps[arm] += runs
            moves_with_meeting = np.flatnonzero(meets[first:last]) + first
            meets[moves_with_meeting] = self.meets + 1 + np.arange(len(moves_with_meeting))
            self.meets += len(moves_with_meeting)
            if not together:
                arm_name = targets.arms[0]
                self._meet(f"{arm_name} has run its moves", float(duration[first:last].sum()), arm_name)
            self._actions(targets, last - 1, keep)


def _runs(
    number: int, segments: Sequence[Segment], first: int, last: int, together: bool
) -> list[layout.SegmentRun]:
    """Return the moves ``first`` to ``last`` - 1 of operation ``number`` as runs of one segment each."""
    edges = [first, *(i for i in range(first + 1, last) if segments[i] != segments[i - 1]), last]
    return [layout.SegmentRun(number, segments[a], a, b, together) for a, b in itertools.pairwise(edges)]


def _joint_moves(postures: Sequence[FloatArray], role: str) -> list[layout.TaskStep]:
    """Return joint moves to the postures, in order.

    Of consecutive postures that are equal within the tolerance only the last one gets a move.
    """
    steps: list[layout.TaskStep] = []
    previous: FloatArray | None = None
    for q in postures:
        if previous is not None and np.abs(q - previous).max() < JOINT_TOLERANCE_RAD:
            steps.pop()
        steps.append(layout.JointMove(np.asarray(q, dtype=np.float64), role))
        previous = q
    return steps


def _check_plan(plan: OperationPlan, one_controller: bool) -> None:
    """Raise `TandemError` if programs cannot express the plan of an operation.

    The reasons are: times or joints that are not finite or do not match the targets; an approach or retreat
    of all arms at once without one controller for them or with different numbers of waypoints; an action at
    no target, or at a target other than the first one at which the arms do not stop.
    """
    targets = plan.targets
    issues = []
    arrays = [plan.time, *plan.q.values()]
    if any(len(array) != targets.count or not np.isfinite(array).all() for array in arrays):
        message = (
            f"operation {plan.name}: times and joints must be finite, one row per target ({targets.count})"
        )
        issues.append(Issue("post.plan", message, hint="plan the job again"))
    for name in plan.synchronised:
        path = {"entry": plan.approach, "exit": plan.retreat}.get(name, {})
        counts = {len(path[arm]) for arm in plan.arm_order if arm in path}
        if one_controller and set(plan.arm_order) == set(path) and len(path) > 1 and len(counts) == 1:
            continue
        message = (
            f"operation {plan.name}: the arms cannot do the {name!r} motion at once; it needs one MultiMove "
            "controller for both, and the same number of waypoints for each arm"
        )
        issues.append(Issue("post.plan", message, hint="plan the job again"))
    for action in targets.actions:
        if not 0 <= action.target < targets.count or not (targets.stop[action.target] or action.target == 0):
            message = (
                f"operation {plan.name}: action {action.kind!r} is at target {action.target}, which is not a "
                "stop"
            )
            issues.append(
                Issue(
                    "post.action",
                    message,
                    index=action.target,
                    hint=f"stop the motion at target {action.target}",
                )
            )
    if issues:
        raise TandemError(issues)


def _written_frames(plan: OperationPlan, setup: Setup) -> dict[str, str]:
    """Return the frame in which each arm's moves are written: the planned one, with one exception.

    The moves of an arm that holds the stock are planned in the stock frame but written in the world, because
    an arm cannot carry its own work object.
    """
    holder = setup.stock.held_by
    frames = plan.targets.frame
    return {
        arm: "world" if arm == holder and frames[arm] == "stock" else frames[arm] for arm in plan.targets.arms
    }


def _written_poses(
    plan: OperationPlan, frames: Mapping[str, str], stock_pose: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return positions (N, 3) [mm] and quaternions (N, 4) of each arm at all targets, rounded as written.

    The signs of consecutive quaternions are those with which they are close to each other. ``frames`` is the
    result of :func:`_written_frames`, ``stock_pose`` (4, 4) [m] the pose of the stock in the world.
    """
    out = {}
    for arm, planned in plan.targets.poses(plan.values).items():
        changes_frame = frames[arm] != plan.targets.frame[arm]
        pose = stock_pose @ planned if changes_frame else planned
        quaternion = to_quaternion(pose[:, :3, :3])
        flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
        sign = np.cumprod(np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]))
        # + 0.0 turns -0.0 into 0.0
        out[arm] = (
            np.round(pose[:, :3, 3] * 1e3, layout.POSITION_DECIMALS) + 0.0,
            np.round(quaternion * sign[:, None], layout.QUATERNION_DECIMALS) + 0.0,
        )
    return out


def _moved_targets(written: Mapping[str, tuple[FloatArray, FloatArray]]) -> IntArray:
    """Return the indices (M,) of the targets to which programs contain a move.

    There is none to the first target, and none to a target whose written pose equals the previous one for all
    arms.

    Args:
        written: Positions (N, 3) and quaternions (N, 4) of each arm at all targets, as written.
    """
    moves = [np.any(np.diff(values, axis=0) != 0.0, axis=1) for pose in written.values() for values in pose]
    return np.flatnonzero(np.any(moves, axis=0)) + 1


def _stops(targets: Targets, keep: IntArray) -> BoolArray:
    """Return whether each move ends in a stop, (M,).

    A move stops if its target is a stop, or a target after it to which no move leads. The last move always
    stops. ``keep`` (M,) are the indices of the targets of the moves.
    """
    stop = np.zeros(len(keep), dtype=bool)
    for i in np.flatnonzero(targets.stop):
        move = int(np.searchsorted(keep, i, side="right")) - 1
        if move >= 0:
            stop[move] = True
    if len(stop):
        stop[-1] = True
    return stop


def _pause_stops(written: Sequence[tuple[FloatArray, FloatArray]], keep: IntArray) -> BoolArray:
    """Return whether each move must stop because an arm stands still in it or in the next one, (M,).

    Some controllers cannot round a corner between a move and a pause.

    Args:
        written: Positions (N, 3) [mm] and quaternions (N, 4) at all targets, of the arms that cannot.
        keep: Index of the target of each move, (M,).
    """
    still = np.zeros(len(keep), dtype=bool)
    path_targets = np.concatenate([[0], keep])
    for position, quaternion in written:
        moves = np.any(np.diff(position[path_targets], axis=0) != 0.0, axis=1)
        still |= ~(moves | np.any(np.diff(quaternion[path_targets], axis=0) != 0.0, axis=1))
    return np.asarray(still | np.append(still[1:], False))


def _rotation_stops(written: Sequence[FloatArray], targets: Targets, keep: IntArray) -> BoolArray:
    """Return whether each move must stop because a TCP stands still in it or in the next one, (M,).

    Some languages state a corner as a length on the path of the TCP. This path has no length if the arm only
    rotates about the TCP, so that no corner is possible. A move does not stop if it or the next one has a
    minimum feed.

    Args:
        written: Positions (N, 3) [mm] at all targets, of the arms whose language states corners in this way.
        targets: Targets of the operation.
        keep: Index of the target of each move, (M,).
    """
    still = np.zeros(len(keep), dtype=bool)
    for position in written:
        step = np.diff(position[np.concatenate([[0], keep])], axis=0)
        still |= np.linalg.norm(step, axis=1) <= corner_rounding.REST_DISTANCE_MM
    has_min_feed = targets.feed_min[keep] > 0.0
    may_stop = ~(has_min_feed | np.append(has_min_feed[1:], False))
    return np.asarray((still | np.append(still[1:], False)) & may_stop)


def _durations(plan: OperationPlan, keep: IntArray) -> FloatArray:
    """Return the planned times (M,) [s] of the moves to the targets ``keep`` (M,), rounded as written.

    Raises `TandemError` if a time is not positive.
    """
    clock = np.round(plan.time, layout.TIME_DECIMALS)
    duration = np.round(clock[keep] - clock[keep - 1], layout.TIME_DECIMALS)
    without_time = np.flatnonzero(duration <= 0.0)
    if len(without_time):
        i = int(keep[without_time[0]])
        location = f"operation {plan.name}, target {i} ({plan.targets.name(i)})"
        message = f"{location}: the move takes {duration[without_time[0]]} s"
        raise issue_error("post.plan", message, index=i, hint="every move needs a time above 0.00001 s")
    return np.asarray(duration)


@dataclasses.dataclass(frozen=True)
class _WrittenMoves:
    """Moves of an operation that programs contain.

    Attributes:
        targets: Index in the plan of the target of each move, (M,).
        stop: Whether each move ends in a stop, (M,).
        duration: Times of the moves, (M,) [s].
    """

    targets: IntArray
    stop: BoolArray
    duration: FloatArray


def _lengthened(
    moves: _WrittenMoves,
    plan: OperationPlan,
    written: Mapping[str, tuple[FloatArray, FloatArray]],
    arms: Mapping[str, Arm],
    settings: Settings,
) -> FloatArray:
    """Return the times (M,) [s] of the moves, lengthened for the stops that programs add to the plan.

    No move gets shorter. Each time is long enough for the feed, the maximum TCP speed, and the allowed joint
    accelerations of all arms, with the arms at rest at every stop.
    """
    targets, keep = plan.targets, moves.targets
    with np.errstate(divide="ignore", invalid="ignore"):
        min_duration = np.where(targets.travel > 0.0, targets.travel / targets.feed, 0.0)
    min_duration = np.diff(np.cumsum(min_duration)[np.concatenate([[0], keep])])
    steps = []
    for arm, (position, _) in written.items():
        distance = np.linalg.norm(position[keep] - position[keep - 1], axis=1)
        min_duration = np.maximum(min_duration, 1e-3 * distance / settings.tcp_speed)
        q = plan.q[arm]
        allowed = settings.acceleration_fraction * arms[arm].data.acceleration
        steps.append((q[keep] - q[keep - 1]) / allowed)
    return lengthen_for_stops(moves.duration, moves.stop, min_duration, steps)


def _move_table(
    plan: OperationPlan,
    arm: Arm,
    frame: str,
    moves: _WrittenMoves,
    position: FloatArray,
    quaternion: FloatArray,
) -> layout.MoveTable:
    """Return the moves of one arm in an operation.

    Args:
        plan: Plan of the operation.
        arm: The arm.
        frame: Name of the work frame in which its moves are written.
        moves: Moves of the operation.
        position: Positions at all targets, as written, (N, 3) [mm].
        quaternion: Orientations at all targets, as written, (N, 4).
    """
    keep = moves.targets
    distance = np.linalg.norm(position[keep] - position[keep - 1], axis=1)
    path_targets = np.concatenate([[0], keep])
    segments = [plan.targets.segment[i] for i in keep]
    max_zones = corner_rounding.max_zones(
        position[path_targets],
        quaternion[path_targets],
        moves.stop,
        1e3 * plan.targets.rounding.rotation_lever(arm.name, arm.tool),
        1e3 * plan.targets.rounding.deviations(segments),
    )
    track_positions = plan.targets.track_positions.get(arm.name)
    rounded_positions = (
        None
        if track_positions is None
        else np.round(track_positions[keep] / MM, EXTERNAL_AXIS_DECIMALS) + 0.0
    )
    q = plan.q[arm.name][keep]
    return layout.MoveTable(
        position[keep], quaternion[keep], q, moves.duration, distance, *max_zones, frame, rounded_positions
    )
