"""The trajectory file of a job: one controller of ROS 2 moves all joints of all arms, goal by goal.

What the tasks of a job do side by side becomes one sequence: an action of the arm that leads, a way from rest
to rest, a goal of work. Before each goal the runner looks where the joints are; each step that may not end
names the outputs that are on, which the runner takes back then."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims import sentences
from planner.geometry.arrays import FloatArray, IntArray, log_rotation
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, refusal
from planner.languages.trajectories.writer import rows
from planner.languages.trajectories.writer.beginnings import settling_time, way_time
from planner.languages.trajectories.writer.clocks import passed, spliced
from planner.languages.trajectories.writer.curves import Curve, curve
from planner.languages.trajectories.writer.rows import JOINT_DECIMALS, TIME_DECIMALS, row
from planner.languages.trajectories.writer.straight_ways import Driven, NotKeptError
from planner.languages.trajectories.writer.wanted import wanted
from planner.languages.writing import layout
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.problem import Arm, Controller, Problem
from planner.runtime.version import __version__
from planner.targets import Action, Targets
from planner.tooling import Tool

SAME_JOINTS: Final = 1e-6
"""Joints [rad] that differ by less are one place."""
WITHIN_GOALS: Final = 2.0
"""Where a move begins is looked at within so many times what its goal may be off."""
Piece = tuple[bool, Mapping[str, list[layout.Step]]]
"""What stands between two meetings: whether arms move at once, and steps by arm."""


def joint_names(arm: Arm, controller: Controller) -> tuple[str, ...]:
    """What the controller calls the joints of an arm."""
    prefix = controller.joint_prefix.get(arm.name, "")
    return tuple(f"{prefix}{joint}" for joint in arm.data.joints)


def write(
    tasks: Sequence[layout.TaskProgram], job: layout.Job, plan: Plan, problem: Problem, margins: Margins
) -> WrittenPrograms:
    """Write the file of a job. Raises :class:`TandemError` (``post.*``)."""
    del tasks, margins  # one controller moves all arms, and the file has no comments
    main = _Main(job, plan, problem)
    path = f"{rows.stem(problem.name)}.trajectory.jsonl"
    text = rows.sealed(main.lines())
    layout.require_one_file(path, text, problem.cell.controller, main.points, "points")
    planned = [operation.time for operation in plan.operations]
    return WrittenPrograms({path: text}, {k: spliced(planned[k], runs) for k, runs in main.runs.items()})


class _Main:
    """Writes the rows of a job."""

    def __init__(self, job: layout.Job, plan: Plan, problem: Problem) -> None:
        self.job, self.plan, self.problem = job, plan, problem
        self.controller = problem.cell.controller
        self.arms = [task.arm.name for task in job.tasks]
        self.tasks = {task.arm.name: task for task in job.tasks}
        widths = [task.robot.axes for task in job.tasks]
        ends = [0, *itertools.accumulate(widths)]
        self.columns = {arm: slice(ends[i], ends[i + 1]) for i, arm in enumerate(self.arms)}
        self.width = ends[-1]
        self.here = np.concatenate([task.arm.home for task in job.tasks])
        self.on: list[str] = []
        self.tools: dict[str, Tool] = {}
        self.begins: tuple[str, Mapping[str, layout.OperationProgram]] | None = None
        """The operation's own row, and its programs, until something moves."""
        self.out: list[str] = []
        self.points = 0
        self.runs: dict[int, list[tuple[IntArray, FloatArray]]] = {}
        """Of each operation what its curves go to, and when."""

    def lines(self) -> list[str]:
        """All rows but the last one."""
        head = {
            "tandem_trajectory": rows.VERSION,
            "written_by": f"Tandem {__version__}",
            "problem": rows.text(self.problem.name) or "problem",
            "problem_digest": self.plan.digest,
        }
        self.out.append(row(head))
        for task in self.job.tasks:
            self._arm(task)
        for signal in self.job.signals:
            self._switch(signal, False)
        clear = (sentences.KRL_CLEAR if self.problem.setups[0].steps else sentences.KRL_READY).filled()
        self._ask(clear)
        for index in range(len(self.job.tasks[0].operations)):
            self._operation({task.arm.name: task.operations[index] for task in self.job.tasks})
        return self.out

    def _arm(self, task: layout.TaskProgram) -> None:
        values = {
            "arm": rows.name(task.arm.name),
            "robot": rows.name(task.arm.robot),
            "joints": [rows.name(name) for name in joint_names(task.arm, self.controller)],
            "base": rows.pose(task.base),
        }
        self.out.append(row(values))

    # ---- operations ----

    def _operation(self, programs: Mapping[str, layout.OperationProgram]) -> None:
        first = programs[self.arms[0]]
        stock = self.problem.setups[first.setup - 1].stock
        holder = stock.held_by
        head = {
            "operation": rows.text(first.name) or "operation",
            "setup": first.setup,
            "held_by": rows.name(holder) if holder else "",
            "block": rows.pose(stock.grip if holder else self.plan.places[first.setup - 1]),
        }
        self.begins = row(head), programs  # behind the setup in which tools are mounted
        for together, steps in _pieces(programs):
            if together:
                self._together(steps, programs)
            else:
                for arm, own in steps.items():
                    self._alone(arm, own, programs[arm])

    def _tool(self, arm: str, program: layout.OperationProgram) -> None:
        tool = program.arm.tool
        if self.tools.get(arm) is tool:
            return
        self.tools[arm] = tool
        require_mass(tool)
        values = {
            "tool": rows.name(tool.name),
            "arm": arm,
            "tcp": rows.pose(tool.tcp),
            "mass": rows.real(tool.mass, 3),
            "centre": rows.numbers(np.asarray(tool.cog), 6),
        }
        self.out.append(row(values))

    def _alone(self, arm: str, steps: Sequence[layout.Step], program: layout.OperationProgram) -> None:
        for kind, group in itertools.groupby(steps, key=lambda step: isinstance(step, layout.Run)):
            if kind:
                runs = [step for step in group if isinstance(step, layout.Run)]
                self._work((arm,), {arm: program}, runs)
                continue
            for step in group:
                match step:
                    case layout.Joints(q=q):
                        self._way({arm: q}, {arm: program})
                    case layout.Do(action):
                        self._action(action, arm)
                    case layout.Carry(load):
                        self._carry(arm, load)

    def _together(
        self, steps: Mapping[str, Sequence[layout.Step]], programs: Mapping[str, layout.OperationProgram]
    ) -> None:
        moving = {arm: own for arm, own in steps.items() if own}
        runs = {arm: [step for step in own if isinstance(step, layout.Run)] for arm, own in moving.items()}
        ways = {arm: [step for step in own if isinstance(step, layout.Joints)] for arm, own in moving.items()}
        if any(runs.values()):
            self._work(tuple(moving), programs, next(iter(runs.values())))
        for stations in zip(*ways.values(), strict=True):
            self._way({arm: step.q for arm, step in zip(ways, stations, strict=True)}, programs)

    def _driven(
        self, arms: Sequence[str], programs: Mapping[str, layout.OperationProgram]
    ) -> dict[str, Driven]:
        """The arms that move, their joints side by side."""
        out: dict[str, Driven] = {}
        first = 0
        for arm in arms:
            task = self.tasks[arm]
            own = slice(first, first + task.robot.axes)
            out[arm] = Driven(task.robot, task.base, programs[arm].arm.tool.tcp, own)
            first = own.stop
        for arm, driven in out.items():
            track = programs[arm].track
            holder = "" if track is None else track.frame.removeprefix("held:")
            if track is not None and holder != track.frame and holder in out:
                out[arm] = dataclasses.replace(driven, carrier=out[holder])
        return out

    # ---- moves ----

    def _way(self, ends: Mapping[str, FloatArray], programs: Mapping[str, layout.OperationProgram]) -> None:
        arms = [arm for arm in self.arms if arm in ends]
        goal = self.here.copy()
        for arm in arms:
            goal[self.columns[arm]] = np.round(ends[arm], JOINT_DECIMALS)
        if np.abs(goal - self.here).max() < SAME_JOINTS:
            return
        driven, limits = self._driven(arms, programs), self.problem.settings
        start, end = (np.concatenate([q[self.columns[arm]] for arm in arms]) for q in (self.here, goal))
        shares = (limits.speed_fraction, limits.acceleration_fraction)
        took = way_time(driven, start, end, shares, limits.tcp_speed)
        begun = self._move(arms)
        self._point(begun + took + 10.0**-TIME_DECIMALS, goal, np.zeros(self.width))

    def _work(
        self, arms: Sequence[str], programs: Mapping[str, layout.OperationProgram], runs: Sequence[layout.Run]
    ) -> None:
        first, last = runs[0].first, runs[-1].last
        tracks = {arm: programs[arm].track for arm in arms}
        lead = programs[arms[0]]
        some = slice(first, last)
        start = np.concatenate([self.here[self.columns[arm]] for arm in arms])
        found = [track.q[some] for track in tracks.values() if track is not None]
        q = np.concatenate([start[None], np.concatenate(found, axis=1)])
        driven = list(self._driven(arms, programs).values())
        targets, speed = self.plan.operations[runs[0].operation].targets, self.problem.settings.tcp_speed
        moving = {arm: programs[arm] for arm in arms}
        try:
            made = curve(driven, q, lead.stop[some], wanted(targets, moving, some, speed))
        except NotKeptError as lost:
            segment = lead.segments[first + lost.row]
            message = (
                f"operation {lead.name}: on the way to target {first + lost.row + 1} ({segment}): {lost.why}"
            )
            hint = _helps(targets, int(lead.targets[first + lost.row]), lost.share)
            raise refusal("post.trajectory", message, arm=arms[0], hint=hint) from None
        self.runs.setdefault(runs[0].operation, []).append((lead.targets[some], passed(driven[0], q, made)))
        begun = self._move(arms)
        labels = [layout.mark(lead.segments[first + row]) for row in made.end[1:].tolist()]
        self._points(made, begun, arms, labels)

    def _points(self, made: Curve, begun: float, arms: Sequence[str], labels: Sequence[str]) -> None:
        said = ""
        for k, segment in enumerate(labels, 1):
            if segment != said:
                self.out.append(row({"segment": segment}))
                said = segment
            q, v, first = self.here.copy(), np.zeros(self.width), 0
            for arm in arms:
                own = self.columns[arm]
                width = own.stop - own.start
                q[own] = np.round(made.q[k, first : first + width], JOINT_DECIMALS)
                v[own] = made.v[k, first : first + width]
                first += width
            self._point(begun + float(made.t[k]), q, v)

    def _move(self, arms: Sequence[str]) -> float:
        """A move and its first point, where it begins; the time [s] of that."""
        controller = self.controller
        if self.begins is not None:
            head, programs = self.begins
            self.out.append(head)
            for arm, program in programs.items():
                self._tool(arm, program)
            self.begins = None
        self._at()
        values = {
            "move": list(arms),
            "path": rows.numbers([controller.path_tolerance] * self.width, JOINT_DECIMALS),
            "goal": rows.numbers([controller.goal_tolerance] * self.width, JOINT_DECIMALS),
            "goal_time": rows.real(controller.goal_time, 3),
            "on_failure": list(self.on),
        }
        self.out.append(row(values))
        within = WITHIN_GOALS * controller.goal_tolerance
        begun = settling_time(self._all(), self.here, within, self.problem.settings.tcp_speed)
        self._point(begun, self.here, np.zeros(self.width))
        return float(np.round(begun, TIME_DECIMALS))

    def _all(self) -> list[Driven]:
        """All arms with what they carry: those that stand may be off as well."""
        own = ((self.tasks[arm], self.columns[arm]) for arm in self.arms)
        return [
            Driven(task.robot, task.base, self.tools.get(task.arm.name, task.arm.tool).tcp, columns)
            for task, columns in own
        ]

    def _at(self) -> None:
        within = WITHIN_GOALS * self.controller.goal_tolerance
        here = rows.numbers(self.here, JOINT_DECIMALS)
        self.out.append(row({"at": here, "within": rows.real(within, 6), "on_failure": list(self.on)}))

    def _point(self, time: float, q: FloatArray, v: FloatArray) -> None:
        values = {
            "t": rows.real(time, TIME_DECIMALS),
            "q": rows.numbers(q, JOINT_DECIMALS),
            "v": rows.numbers(v, JOINT_DECIMALS),
        }
        self.out.append(row(values))
        self.here = np.round(q, JOINT_DECIMALS)
        self.points += 1

    # ---- what is said and switched ----

    def _carry(self, arm: str, load: layout.Load | None) -> None:
        """What the tool holds from here on, in the frame of its TCP; of nothing the mass is 0."""
        mass, centre, turn, inertia = 0.0, np.zeros(3), np.zeros(3), np.zeros(3)
        if load is not None:
            mass, centre, inertia = load.mass, load.cog, load.inertia
            turn = log_rotation(load.axes[None])[0]
        values = {
            "carry": arm,
            "mass": rows.real(mass, 3),
            "centre": rows.numbers(centre, 6),
            "axes": rows.numbers(turn, JOINT_DECIMALS),
            "inertia": rows.numbers(inertia, 6),
            "on_failure": list(self.on),
        }
        self.out.append(row(values))

    def _ask(self, text: str) -> None:
        self.out.append(row({"ask": rows.text(text), "on_failure": list(self.on)}))

    def _switch(self, signal: str, on: bool) -> None:
        self.on = [name for name in self.on if name != signal] + ([signal] if on else [])
        self.out.append(row({"set": rows.name(signal), "to": int(on)}))

    def _action(self, action: Action, arm: str) -> None:
        match action.kind:
            case "message":
                self.out.append(row({"tell": rows.text(action.text)}))
            case "confirm":
                self._ask(action.text)
            case "on" | "off":
                self._switch(action.signal, action.kind == "on")
            case "wait":
                self.out.append(row({"dwell": rows.real(action.seconds, 3), "on_failure": list(self.on)}))
            case "input":
                raise TandemError(no_torch(arm))


def _helps(targets: Targets, row: int, share: float) -> str:
    """What to do where no points keep the way to target ``row``, or but a ``share`` of its least feed."""
    if targets.may_stop or not targets.segment[row].works:
        return "let the motion stop at sharp corners, or go slower there"
    slower = "go slower there (feed_mm_s), allow more (shape_tol_mm), or round the corner in the part"
    if share < 1.0:
        least = math.floor(10.0 * share * targets.feed_min[row] / MM) / 10.0
        return f"feed_min_mm_s: {least:g} there, which is kept; or {slower}"
    return slower


def no_torch(arm: str) -> Issue:
    """Why an arm that is driven by trajectories cuts with no torch."""
    what = f"arm {arm} is to cut with a torch, driven by trajectories: nothing between the goals of a runner "
    what += "sees an arc go out, or a torch stand"
    hint = "cut by a mill (by: {kind: mill}), or take an arm of ABB, KUKA or UR in its own language"
    return Issue("post.controller", what, arm=arm, hint=hint)


def _pieces(programs: Mapping[str, layout.OperationProgram]) -> list[Piece]:
    """The steps of an operation between meetings, side by side."""
    parts: list[list[tuple[bool, list[layout.Step]]]] = []
    for program in programs.values():
        inside, own = False, [(False, list[layout.Step]())]
        for step in program.steps:
            if isinstance(step, layout.SyncOn | layout.SyncOff | layout.Meet):
                inside = isinstance(step, layout.SyncOn)
                own.append((inside, []))
            else:
                own[-1][1].append(step)
        parts.append(own)
    return [
        (pieces[0][0], {arm: steps for arm, (_, steps) in zip(programs, pieces, strict=True)})
        for pieces in zip(*parts, strict=True)
    ]
