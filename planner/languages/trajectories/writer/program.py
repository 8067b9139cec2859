"""Writes the trajectory file of a job: one ROS 2 controller moves all joints of all arms, goal by goal.

The parallel tasks of a job become one sequence of actions, rest-to-rest moves and goals of work. Before each
goal the runner checks the joints. Each step that may fail names the outputs that are on, which the runner
then switches off.
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims import sentences
from planner.geometry.arrays import FloatArray, IntArray, log_rotation
from planner.geometry.units import MM
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.languages.trajectories.writer import rows
from planner.languages.trajectories.writer.clocks import passing_times, splice_clocks
from planner.languages.trajectories.writer.curves import TrajectoryPoints, fit_curve
from planner.languages.trajectories.writer.requirements import segment_requirements
from planner.languages.trajectories.writer.rows import JOINT_DECIMALS, TIME_DECIMALS, row
from planner.languages.trajectories.writer.start_times import rest_to_rest_time, settling_time
from planner.languages.trajectories.writer.straight_segments import PathNotKeptError, TrajectoryArm
from planner.languages.writing import layout
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.problem import Arm, Controller, Problem
from planner.runtime.version import __version__
from planner.targets import TargetAction, Targets
from planner.tooling import Tool

JOINT_TOLERANCE_RAD: Final = 1e-6
"""Maximum joint difference [rad] of two postures that count as the same."""
CHECK_TOLERANCE_FACTOR: Final = 2.0
"""Tolerance of the check before a move, relative to the goal tolerance."""
ParallelSteps = tuple[bool, Mapping[str, list[layout.TaskStep]]]
"""Steps between two meetings: whether the arms move synchronised, and the steps of each arm by its name."""


def joint_names(arm: Arm, controller: Controller) -> tuple[str, ...]:
    """Return the controller's names of the joints of an arm.

    Args:
        arm: The arm.
        controller: Controllers of the cell.
    """
    prefix = controller.joint_prefix.get(arm.name, "")
    return tuple(f"{prefix}{joint}" for joint in arm.data.joints)


def write(
    tasks: Sequence[layout.TaskProgram],
    job: layout.JobPrograms,
    plan: Plan,
    problem: Problem,
    margins: Margins,
) -> WrittenPrograms:
    """Write the file of a job.

    Args:
        tasks: Not used: one controller moves all arms.
        job: All tasks.
        plan: The plan.
        problem: Its problem.
        margins: Not used: the file has no comments.

    Raises:
        TandemError: The file cannot be written (``post.*``).
    """
    del tasks, margins  # one controller moves all arms, and the file has no comments
    writer = _TrajectoryWriter(job, plan, problem)
    path = f"{rows.stem(problem.name)}.trajectory.jsonl"
    text = rows.seal_rows(writer.lines())
    layout.require_one_file(path, text, problem.cell.controller, writer.points, "points")
    planned = [operation.time for operation in plan.operations]
    return WrittenPrograms(
        {path: text}, {k: splice_clocks(planned[k], runs) for k, runs in writer.runs.items()}
    )


class _TrajectoryWriter:
    """Writes the rows of a job; D is the number of joints of all arms.

    Attributes:
        arms: Names of the arms in the order of their joints in rows.
        width: D.
        columns: Columns of each arm's joints among those of all arms.
        posture: Joints of all arms after the last point, rounded as written, (D,) [rad].
        outputs_on: Names of the outputs that are on, in the order in which they were switched. Each step that
            may fail names them, so that the runner switches them off.
        tools: Tool that each arm carries, as the rows so far state.
        pending_operation: Row of an operation and its programs by arm, until its first move.
        runs: Runs of each operation that are written as curves, by index of the operation. Each has its
            targets, and its path positions with times, see `splice_clocks`.
    """

    def __init__(self, job: layout.JobPrograms, plan: Plan, problem: Problem) -> None:
        self.job, self.plan, self.problem = job, plan, problem
        self.controller = problem.cell.controller
        self.arms = [task.arm.name for task in job.tasks]
        self.tasks = {task.arm.name: task for task in job.tasks}
        widths = [task.robot.axes for task in job.tasks]
        ends = [0, *itertools.accumulate(widths)]
        self.columns = {arm: slice(ends[i], ends[i + 1]) for i, arm in enumerate(self.arms)}
        self.width = ends[-1]
        self.posture = np.concatenate([task.arm.home for task in job.tasks])
        self.outputs_on: list[str] = []
        self.tools: dict[str, Tool] = {}
        self.pending_operation: tuple[str, Mapping[str, layout.OperationProgram]] | None = None
        self.rows_out: list[str] = []
        self.points = 0
        self.runs: dict[int, list[tuple[IntArray, FloatArray]]] = {}

    def lines(self) -> list[str]:
        """Return the rows of the file without the end row, which `rows.seal_rows` appends."""
        head = {
            "tandem_trajectory": rows.VERSION,
            "written_by": f"Tandem {__version__}",
            "problem": rows.ascii_text(self.problem.name) or "problem",
            "problem_digest": self.plan.digest,
        }
        self.rows_out.append(row(head))
        for task in self.job.tasks:
            self._arm(task)
        for signal in self.job.signals:
            self._switch(signal, False)
        clear = (sentences.KRL_CLEAR if self.problem.setups[0].steps else sentences.KRL_READY).format()
        self._ask(clear)
        for index in range(len(self.job.tasks[0].operations)):
            self._operation({task.arm.name: task.operations[index] for task in self.job.tasks})
        return self.rows_out

    def _arm(self, task: layout.TaskProgram) -> None:
        """Append the row of an arm."""
        values = {
            "arm": rows.require_name(task.arm.name),
            "robot": rows.require_name(task.arm.robot),
            "joints": [rows.require_name(name) for name in joint_names(task.arm, self.controller)],
            "base": rows.pose(task.base),
        }
        self.rows_out.append(row(values))

    # ---- operations ----

    def _operation(self, programs: Mapping[str, layout.OperationProgram]) -> None:
        """Append the rows of an operation. ``programs`` has the program of each arm, by name."""
        first = programs[self.arms[0]]
        stock = self.problem.setups[first.setup - 1].stock
        holder = stock.held_by
        head = {
            "operation": rows.ascii_text(first.name) or "operation",
            "setup": first.setup,
            "held_by": rows.require_name(holder) if holder else "",
            "block": rows.pose(stock.grip if holder else self.plan.stock_poses[first.setup - 1]),
        }
        # its row is written before the first move: after the setup in which tools are mounted
        self.pending_operation = row(head), programs
        for together, steps in _parallel_steps(programs):
            if together:
                self._synchronised(steps, programs)
            else:
                for arm, arm_steps in steps.items():
                    self._solo(arm, arm_steps, programs[arm])

    def _tool(self, arm: str, program: layout.OperationProgram) -> None:
        """Append the row of an arm's tool, unless it carries this tool already."""
        tool = program.arm.tool
        if self.tools.get(arm) is tool:
            return
        self.tools[arm] = tool
        require_mass(tool)
        values = {
            "tool": rows.require_name(tool.name),
            "arm": arm,
            "tcp": rows.pose(tool.tcp),
            "mass": rows.real(tool.mass, 3),
            "centre": rows.numbers(np.asarray(tool.cog), 6),
        }
        self.rows_out.append(row(values))

    def _solo(self, arm: str, steps: Sequence[layout.TaskStep], program: layout.OperationProgram) -> None:
        """Append the rows of one arm's steps between two meetings. Consecutive segments become one goal.

        ``program`` is the program of the operation to which the steps belong.
        """
        for is_work, group in itertools.groupby(steps, key=lambda step: isinstance(step, layout.SegmentRun)):
            if is_work:
                runs = [step for step in group if isinstance(step, layout.SegmentRun)]
                self._work((arm,), {arm: program}, runs)
                continue
            for step in group:
                match step:
                    case layout.JointMove(q=q):
                        self._rest_to_rest({arm: q}, {arm: program})
                    case layout.ActionStep(action):
                        self._action(action, arm)
                    case layout.CarryLoad(load):
                        self._carry(arm, load)

    def _synchronised(
        self, steps: Mapping[str, Sequence[layout.TaskStep]], programs: Mapping[str, layout.OperationProgram]
    ) -> None:
        """Append the synchronised moves of several arms: one goal of work, then rest-to-rest moves.

        The segments of all arms are the same ones, so that the first arm's segments define the goal. The
        n-th rest-to-rest moves of all arms form one goal.
        """
        moving = {arm: arm_steps for arm, arm_steps in steps.items() if arm_steps}
        runs = {
            arm: [step for step in arm_steps if isinstance(step, layout.SegmentRun)]
            for arm, arm_steps in moving.items()
        }
        joint_moves = {
            arm: [step for step in arm_steps if isinstance(step, layout.JointMove)]
            for arm, arm_steps in moving.items()
        }
        if any(runs.values()):
            self._work(tuple(moving), programs, next(iter(runs.values())))
        for simultaneous_moves in zip(*joint_moves.values(), strict=True):
            self._rest_to_rest(
                {arm: move.q for arm, move in zip(joint_moves, simultaneous_moves, strict=True)}, programs
            )

    def _driven(
        self, arms: Sequence[str], programs: Mapping[str, layout.OperationProgram]
    ) -> dict[str, TrajectoryArm]:
        """Return the arms that move in a goal, by name.

        Their joint columns are consecutive in the order of ``arms``. If one of them holds the block, it is
        the carrier of the arms that work on this block.
        """
        out: dict[str, TrajectoryArm] = {}
        first = 0
        for arm in arms:
            task = self.tasks[arm]
            columns = slice(first, first + task.robot.axes)
            out[arm] = TrajectoryArm(task.robot, task.base, programs[arm].arm.tool.tcp, columns)
            first = columns.stop
        for arm, trajectory_arm in out.items():
            track = programs[arm].moves
            # "held:NAME" is the work frame on the tool of arm NAME; other frames have no such prefix
            holder = "" if track is None else track.frame.removeprefix("held:")
            if track is not None and holder != track.frame and holder in out:
                out[arm] = dataclasses.replace(trajectory_arm, carrier=out[holder])
        return out

    # ---- moves ----

    def _rest_to_rest(
        self, ends: Mapping[str, FloatArray], programs: Mapping[str, layout.OperationProgram]
    ) -> None:
        """Append a goal with one rest-to-rest move to the joints ``ends`` by arm.

        Nothing is appended if the arms are there already. Its time keeps the limits of joints and tools.
        """
        arms = [arm for arm in self.arms if arm in ends]
        goal = self.posture.copy()
        for arm in arms:
            goal[self.columns[arm]] = np.round(ends[arm], JOINT_DECIMALS)
        if np.abs(goal - self.posture).max() < JOINT_TOLERANCE_RAD:
            return
        driven = self._driven(arms, programs)
        limits = self.problem.settings
        start, end = (np.concatenate([q[self.columns[arm]] for arm in arms]) for q in (self.posture, goal))
        fractions = (limits.speed_fraction, limits.acceleration_fraction)
        duration = rest_to_rest_time(driven, start, end, fractions, limits.tcp_speed)
        start_time = self._move(arms)
        # one more unit of the last decimal, so that rounding does not shorten the duration
        self._point(start_time + duration + 10.0**-TIME_DECIMALS, goal, np.zeros(self.width))

    def _work(
        self,
        arms: Sequence[str],
        programs: Mapping[str, layout.OperationProgram],
        runs: Sequence[layout.SegmentRun],
    ) -> None:
        """Append a goal of work: the curve through the targets of consecutive segments (``runs``).

        The curve starts at the current posture. Its times are also stored in ``self.runs`` for the kerf.

        Raises:
            TandemError: No points keep the path (``post.trajectory``).
        """
        first, last = runs[0].first, runs[-1].last
        tracks = {arm: programs[arm].moves for arm in arms}
        lead = programs[arms[0]]
        rows_of_run = slice(first, last)
        start = np.concatenate([self.posture[self.columns[arm]] for arm in arms])
        joints = [track.q[rows_of_run] for track in tracks.values() if track is not None]
        q = np.concatenate([start[None], np.concatenate(joints, axis=1)])
        driven = list(self._driven(arms, programs).values())
        targets = self.plan.operations[runs[0].operation].targets
        tcp_speed = self.problem.settings.tcp_speed
        moving = {arm: programs[arm] for arm in arms}
        try:
            trajectory = fit_curve(
                driven,
                q,
                lead.stop[rows_of_run],
                segment_requirements(targets, moving, rows_of_run, tcp_speed),
            )
        except PathNotKeptError as error:
            message = format_message(
                "post.trajectory",
                operation=lead.name,
                target_number=first + error.row + 1,
                segment=lead.segments[first + error.row],
                reason=error.reason,
            )
            hint = _remedy(targets, int(lead.targets[first + error.row]), error.feed_fraction)
            raise issue_error("post.trajectory", message, arm=arms[0], hint=hint) from None
        self.runs.setdefault(runs[0].operation, []).append(
            (lead.targets[rows_of_run], passing_times(driven[0], q, trajectory))
        )
        start_time = self._move(arms)
        labels = [layout.segment_mark(lead.segments[first + index]) for index in trajectory.end[1:].tolist()]
        self._points(trajectory, start_time, arms, labels)

    def _points(
        self, trajectory: TrajectoryPoints, start_time: float, arms: Sequence[str], labels: Sequence[str]
    ) -> None:
        """Append the points of a curve after its first one, and a row where a segment starts.

        The curve starts at ``start_time`` [s] in the goal. ``labels`` are the segments of its points 1 to
        P - 1. The joints of the curve are those of ``arms``; other arms keep their posture.
        """
        current_segment = ""
        for k, segment in enumerate(labels, 1):
            if segment != current_segment:
                self.rows_out.append(row({"segment": segment}))
                current_segment = segment
            q = self.posture.copy()
            v = np.zeros(self.width)
            first = 0
            for arm in arms:
                columns = self.columns[arm]
                width = columns.stop - columns.start
                q[columns] = np.round(trajectory.q[k, first : first + width], JOINT_DECIMALS)
                v[columns] = trajectory.v[k, first : first + width]
                first += width
            self._point(start_time + float(trajectory.t[k]), q, v)

    def _move(self, arms: Sequence[str]) -> float:
        """Append the start of a goal; return the time [s] of its first point, which is the start posture.

        The rows are those of an operation and its tools that are not written yet, the check of the joints,
        the move with its tolerances, and the first point.
        """
        controller = self.controller
        if self.pending_operation is not None:
            head, programs = self.pending_operation
            self.rows_out.append(head)
            for arm, program in programs.items():
                self._tool(arm, program)
            self.pending_operation = None
        self._posture_check()
        values = {
            "move": list(arms),
            "path": rows.numbers([controller.path_tolerance] * self.width, JOINT_DECIMALS),
            "goal": rows.numbers([controller.goal_tolerance] * self.width, JOINT_DECIMALS),
            "goal_time": rows.real(controller.goal_time, 3),
            "on_failure": list(self.outputs_on),
        }
        self.rows_out.append(row(values))
        tolerance = CHECK_TOLERANCE_FACTOR * controller.goal_tolerance
        start_time = settling_time(self._all_arms(), self.posture, tolerance, self.problem.settings.tcp_speed)
        self._point(start_time, self.posture, np.zeros(self.width))
        return float(np.round(start_time, TIME_DECIMALS))

    def _all_arms(self) -> list[TrajectoryArm]:
        """Return all arms with their tools.

        At the start of a goal, arms that do not move may deviate as well.
        """
        tasks = ((self.tasks[arm], self.columns[arm]) for arm in self.arms)
        return [
            TrajectoryArm(task.robot, task.base, self.tools.get(task.arm.name, task.arm.tool).tcp, columns)
            for task, columns in tasks
        ]

    def _posture_check(self) -> None:
        tolerance = CHECK_TOLERANCE_FACTOR * self.controller.goal_tolerance
        joints = rows.numbers(self.posture, JOINT_DECIMALS)
        self.rows_out.append(
            row({"at": joints, "within": rows.real(tolerance, 6), "on_failure": list(self.outputs_on)})
        )

    def _point(self, time: float, q: FloatArray, v: FloatArray) -> None:
        """Append a point with the joints ``q`` (D,) [rad] and velocities ``v`` (D,) [rad/s] of all arms."""
        values = {
            "t": rows.real(time, TIME_DECIMALS),
            "q": rows.numbers(q, JOINT_DECIMALS),
            "v": rows.numbers(v, JOINT_DECIMALS),
        }
        self.rows_out.append(row(values))
        self.posture = np.round(q, JOINT_DECIMALS)
        self.points += 1

    # ---- messages and signals ----

    def _carry(self, arm: str, load: layout.HeldLoad | None) -> None:
        """Append the row of the load that an arm's tool holds from here on, in its TCP frame.

        Without a load (None) all values are 0.
        """
        mass, centre, rotation_vector, inertia = 0.0, np.zeros(3), np.zeros(3), np.zeros(3)
        if load is not None:
            mass, centre, inertia = load.mass, load.cog, load.inertia
            rotation_vector = log_rotation(load.axes[None])[0]
        values = {
            "carry": arm,
            "mass": rows.real(mass, 3),
            "centre": rows.numbers(centre, 6),
            "axes": rows.numbers(rotation_vector, JOINT_DECIMALS),
            "inertia": rows.numbers(inertia, 6),
            "on_failure": list(self.outputs_on),
        }
        self.rows_out.append(row(values))

    def _ask(self, text: str) -> None:
        self.rows_out.append(row({"ask": rows.ascii_text(text), "on_failure": list(self.outputs_on)}))

    def _switch(self, signal: str, on: bool) -> None:
        self.outputs_on = [name for name in self.outputs_on if name != signal] + ([signal] if on else [])
        self.rows_out.append(row({"set": rows.require_name(signal), "to": int(on)}))

    def _action(self, action: TargetAction, arm: str) -> None:
        """Append the row of an action of the process.

        Raises:
            TandemError: The action waits for an input, as a torch requires (``post.controller``).
        """
        match action.kind:
            case "message":
                self.rows_out.append(row({"tell": rows.ascii_text(action.text)}))
            case "confirm":
                self._ask(action.text)
            case "on" | "off":
                self._switch(action.signal, action.kind == "on")
            case "wait":
                self.rows_out.append(
                    row({"dwell": rows.real(action.seconds, 3), "on_failure": list(self.outputs_on)})
                )
            case "input":
                raise TandemError(torch_issue(arm))


def _remedy(targets: Targets, row: int, feed_fraction: float) -> str:
    """Return the hint of the issue that no points keep the path to a target.

    ``row`` is the index of the target in ``targets``. ``feed_fraction`` is the fraction of its minimum feed
    that is possible, 1 if the feed is not the reason. Stops are proposed only where the process allows them
    or the tool does not touch the stock (``works`` is False).
    """
    if targets.may_stop or not targets.segment[row].works:
        return "stop the motion at sharp corners, or reduce the speed there"
    remedies = "lower the feed there (feed_mm_s), allow more (shape_tol_mm), or round the corner of the part"
    if feed_fraction < 1.0:
        # rounded down to 0.1 mm/s
        min_feed_mm_s = math.floor(10.0 * feed_fraction * targets.feed_min[row] / MM) / 10.0
        return f"set feed_min_mm_s: {min_feed_mm_s:g} there, which can be kept, or {remedies}"
    return remedies


def torch_issue(arm: str) -> Issue:
    """Return the issue that an arm that is driven by trajectories cannot cut with a torch."""
    what = f"arm {arm} cuts with a torch but is driven by trajectories: during a goal the runner does not "
    what += "detect a lost arc or a torch that stands still"
    hint = "cut with a mill (by: {kind: mill}), or use an arm of ABB, KUKA or UR in its own language"
    return Issue("post.controller", what, arm=arm, hint=hint)


def _parallel_steps(programs: Mapping[str, layout.OperationProgram]) -> list[ParallelSteps]:
    """Split the steps of an operation at the meetings, and at both ends of each synchronised block.

    These are common to all arms. The result lists in their order the steps that arms execute in parallel,
    including groups without steps, and is written group by group.
    """
    groups_by_arm: list[list[tuple[bool, list[layout.TaskStep]]]] = []
    for program in programs.values():
        groups: list[tuple[bool, list[layout.TaskStep]]] = [(False, [])]
        for step in program.steps:
            if isinstance(step, layout.SyncOn | layout.SyncOff | layout.Meeting):
                synchronised = isinstance(step, layout.SyncOn)
                groups.append((synchronised, []))
            else:
                groups[-1][1].append(step)
        groups_by_arm.append(groups)
    return [
        (groups[0][0], {arm: steps for arm, (_, steps) in zip(programs, groups, strict=True)})
        for groups in zip(*groups_by_arm, strict=True)
    ]
