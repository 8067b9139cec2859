"""URScript programs of a job: for each UR arm one file with one program, without branches.

With another UR arm on a controller of its own, the programs meet by
:mod:`planner.languages.writing.handshake`. A thread watches the other one's running wire and ends this
program when it falls. The program switches its own running wire, because a program that asks cannot know
whether its controller counts as running meanwhile: the wire is low then in any case. The controller's
installation ensures that it falls with the program, and stays low after a pause.

A question is in the middle of a meeting: the other program waits there with its line at 1, and does not
watch from before the meeting until its wait is over. The program that asks checks both wires of the other
one before its running wire rises again, and once more when it watches: a program that was started anew
meanwhile has its line at 0.

The controller counts in a base of its own, which :func:`controller_base` finds in the arm's URDF. Joint
moves state the speed of their leading axis, at which the TCP keeps its limit. Straight moves state their
time and a blend radius.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import ParallelParameters, RobotData
from planner.cell.kinematics import forward_kinematics
from planner.claims import sentences
from planner.claims.handshake import PartnerSignals
from planner.geometry.arrays import BoolArray, FloatArray, from_rpy, inverse
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.writer import syntax
from planner.languages.urscript.writer.meetings import (
    StartWatching,
    WatchedStep,
    held_meetings,
    question_meetings_of,
    watched_meeting,
    watched_start,
)
from planner.languages.urscript.writer.syntax import comment, identifier
from planner.languages.urscript.writer.torches import ScriptTorch, task_torches
from planner.languages.urscript.writer.torches import torch_functions as torch_functions
from planner.languages.writing import handshake, layout
from planner.languages.writing.header import header
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.languages.writing.steps import require_mass
from planner.plans import Plan
from planner.problem import Arm, Problem
from planner.targets import TargetAction
from planner.tooling import Tool

CHECK_TIP: Final = from_rpy([0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
"""A point of the flange, as a pose, that is on no axis. Its position reveals a rotated base or flange."""
CHECK_TOLERANCE_M: Final = 0.01
"""Tolerance [m] for that point at the controller, because arms are calibrated individually, to some mm."""
UNKNOWN_START_FRACTION: Final = 0.10
"""Fraction of the axes' speed for a move from an unknown position: the first one of a program."""
_SPEED_SAMPLES: Final = 400
"""Number of positions of a joint move at which the TCP's speed is computed."""
_SPEED_FRACTION: Final = 0.99
"""Fraction of the speed limit that is used, because the fastest position may lie between two samples."""
MIN_JOINT_SPEED_RAD_S: Final = 0.001
"""Minimum speed [rad/s] of the leading axis that a program states."""
_ZERO: Final = np.deg2rad([-90.0, 0.0, -90.0, 0.0, 0.0])
"""Offsets [rad] of axes 2 to 6 in the zero posture of a UR controller."""
_ZERO_TOLERANCE_RAD: Final = 1e-6
"""Tolerance [rad] of these offsets."""
_UNTESTED: Final = "No controller of UR has run such a program yet: begin at low speed, and compare the time."
"""Note in the header of each program."""
_STEM_LENGTH: Final = 24
"""Maximum number of characters of the problem's name in the program's name."""


def controller_base(arm: Arm) -> FloatArray:
    """Return the base frame of a UR controller in the base frame of the arm's model, (4, 4) [m].

    With all joints at zero, the arm lies along -x of the controller's base.

    Raises:
        TandemError: Zero, signs or flange of the arm are not those of UR (``post.ur_arm``). Joints in
            programs would mean other postures.
    """
    form = arm.data.form
    wrong = ""
    if not isinstance(form, ParallelParameters):
        wrong = "its axes 2, 3 and 4 are not parallel"
    elif np.abs(form.offsets[1:] - _ZERO).max() > _ZERO_TOLERANCE_RAD or (form.signs != 1.0).any():
        wrong = "its joint zeros or directions differ from those of a UR controller"
    elif form.right is not None:
        wrong = "its tip is not the flange of a UR controller, which is on axis 6 with z out of the arm"
    if wrong or not isinstance(form, ParallelParameters):
        message = format_message("post.ur_arm", arm=arm.name, robot=arm.robot, reason=wrong)
        hint = "use UR's own URDF with base: base_link and tip: tool0, or family: generic"
        raise issue_error("post.ur_arm", message, arm=arm.name, hint=hint)
    rotation = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.pi - float(form.offsets[0])])
    return rotation if form.left is None else np.asarray(form.left @ rotation)


def joint_speed(
    robot: RobotData, start: FloatArray, end: FloatArray, tcp: FloatArray, limit: float, max_fraction: float
) -> float:
    """Return the highest speed [rad/s] of the leading axis of a joint move at which all limits hold.

    The leading axis is the one that moves by the largest angle. Between two of N + 1 samples it moves by
    change / N and the TCP by at most a distance d. Its speed is therefore at most limit * change / (d N),
    rounded down to 1e-4 rad/s. It is ``MIN_JOINT_SPEED_RAD_S`` if even that is too fast.

    Args:
        robot: The robot.
        start: Joints (6,) [rad] at the start.
        end: Joints (6,) [rad] at the end.
        tcp: TCP in the flange frame, (4, 4) [m].
        limit: Maximum speed [m/s] of the TCP.
        max_fraction: Maximum fraction of each axis' speed.
    """
    q = start + np.linspace(0.0, 1.0, _SPEED_SAMPLES + 1)[:, None] * (end - start)
    positions = (forward_kinematics(robot, q) @ tcp)[:, :3, 3]
    change = np.abs(end - start)
    path_rate = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).max()) * _SPEED_SAMPLES
    leading_change = float(change.max())
    speed = max_fraction * float(np.min(robot.velocity))
    if path_rate > 0.0:
        speed = min(speed, _SPEED_FRACTION * limit * leading_change / path_rate)
    return max(MIN_JOINT_SPEED_RAD_S, float(np.floor(1e4 * speed) / 1e4))


class _ProgramWriter:
    """Writes the program of one task.

    Attributes:
        controller_base: Base frame of the controller in that of the arm, (4, 4) [m].
        base: Base frame of the controller in the world, (4, 4) [m].
        data: Values of the declared variables as text, by name.
        tools: Variable of the TCP of each tool, by the tool's name and TCP as text.
        joint_names: Variable of each joint target, by its text.
        moves: Number of straight moves so far.
        asks: Numbers of the meetings after which this program asks a question.
        held: Numbers of the meetings in which the other program asks a question.
        watching: Whether the thread that watches the other program runs.
        last_meeting: Number of the last meeting so far.
        question_meeting: Number of the meeting whose first part is already written because a question
            precedes it.
        pending_steps: Steps of the last meeting that follow a question.
        powered: Outputs that actions have switched on.
        torch: Torch of the current operation, None for none.
        lit: Whether the output of the torch is on.
        guarded: Whether the thread of the torch runs.
        joints_before: Joints [rad] at which the next move starts, None at the start of the program.
    """

    def __init__(
        self, task: layout.TaskProgram, job: layout.JobPrograms, plan: Plan, problem: Problem
    ) -> None:
        self.task, self.job, self.plan, self.problem = task, job, plan, problem
        self.controller_base = controller_base(task.arm)
        self.base = task.base @ self.controller_base
        self.data: dict[str, str] = {}
        self.tools: dict[str, str] = {}
        self.joint_names: dict[str, str] = {}
        self.moves = 0
        self.partner = handshake.HandshakeSide.of(task, job)
        self.asks = frozenset[int]()
        self.held = frozenset[int]()
        if self.partner is not None:
            self.asks = question_meetings_of(task)
            others = (question_meetings_of(other) for other in job.tasks if other is not task)
            self.held = held_meetings(self.partner, frozenset[int]().union(*others))
        self.watching = False
        self.last_meeting = 0
        self.question_meeting = 0
        self.pending_steps: list[WatchedStep] = []
        self.powered: set[str] = set()
        self.torches = task_torches(task)
        self.torch: ScriptTorch | None = None
        self.lit = self.guarded = False
        self.joints_before: FloatArray | None = None
        self._acceleration = float(np.min(task.robot.acceleration)) * problem.settings.acceleration_fraction

    def lines(self) -> tuple[list[str], list[str]]:
        """Return the lines of declarations with functions, and the statements after them.

        The statements start with checks: outputs of torches and the running wire are low, and the controller
        moves the planned arm. The question to the operator follows, then all operations.
        """
        self._declare("base_frame", syntax.pose(self.base))
        home = self._joints(layout.JointMove(self.task.arm.home, "home"), 0)
        check_pose = (
            inverse(self.controller_base)
            @ forward_kinematics(self.task.robot, self.task.arm.home)
            @ CHECK_TIP
        )
        text = urscript_sentences.OTHER_ARM.format(arm=self.task.arm.name, model=self.task.arm.robot)
        out = self._torch_off_checks()
        out += [self._switch(signal, False) for signal in self.job.switched_signals(self.task)]
        if self.partner is not None:
            running = self._signals.running
            text_stays_on = urscript_sentences.STAYS_ON.format(signal=running)
            out += syntax.low_check(self._number(running), self._set_running(False), text_stays_on)
        out += syntax.kinematics_check(home, CHECK_TIP, check_pose, CHECK_TOLERANCE_M, text)
        clear = (sentences.KRL_CLEAR if self.problem.setups[0].steps else sentences.KRL_READY).format()
        functions = self._torch_functions()
        if self.partner is None:
            out += syntax.question(clear)
        else:
            functions += self._partner_functions(self.partner)
            out += self._start(self.partner, clear)
        for i, operation in enumerate(self.task.operations, 1):
            out += self._operation(i, operation)
        return [*(f"{word} = {value}" for word, value in self.data.items()), *functions], out

    # ---- torches ----

    def _torch_off_checks(self) -> list[str]:
        """Return statements that end the program if the output of a torch is already on.

        They run before the program has switched anything.
        """
        out: list[str] = []
        for signal in dict.fromkeys(torch.signal for torch in self.torches.values()):
            text = urscript_sentences.STAYS_ON.format(signal=signal)
            out += syntax.low_check(self._number(signal), self._switch(signal, False), text)
        return out

    def _torch_functions(self) -> list[str]:
        off_statements = [self._switch(signal, False) for signal in self.job.switched_signals(self.task)]
        out: list[str] = []
        for torch in dict.fromkeys(self.torches.values()):
            input_number = None if torch.ok_signal is None else self._number(torch.ok_signal)
            out += torch_functions(torch, self._number(torch.signal), input_number, off_statements)
        return out

    def _switch_output(self, signal: str, on: bool) -> list[str]:
        """Return statements that switch an output; the thread of a torch ends before its output switches."""
        torch = self.torch
        out = [self._switch(signal, on)]
        if torch is None or signal != torch.signal:
            return out
        was_guarded = self.guarded
        self.lit = on
        self.guarded = False
        return [torch.end_thread, *out] if was_guarded else out

    # ---- the other controller ----

    def _partner_functions(self, partner: handshake.HandshakeSide) -> list[str]:
        """Return the functions that wait for the other program, and the thread that watches it."""
        signals = partner.handshake.of(partner.arm)
        off_statements = [
            self._switch(signal, False) for signal in (signals.running, *self.job.switched_signals(self.task))
        ]
        text_lost = urscript_sentences.PARTNER_LOST.format(other=partner.other)
        line, runs, running = (
            self._number(signal) for signal in (signals.input, signals.partner_running, signals.running)
        )
        return [
            *syntax.wait_function(syntax.AWAIT_LINE, line, running, off_statements, partner.timeout_text),
            *syntax.wait_function(syntax.AWAIT_RUNNING, runs, running, off_statements, partner.timeout_text),
            *syntax.check_function(line, runs, running, off_statements, partner.timeout_text),
            *syntax.watch_thread(runs, running, off_statements, text_lost),
            *syntax.stand_function(),
        ]

    @property
    def _signals(self) -> PartnerSignals:
        return self.problem.cell.controller.handshake.of(self.task.arm.name)

    def _set_running(self, on: bool) -> str:
        return self._switch(self._signals.running, on)

    def _start(self, partner: handshake.HandshakeSide, clear: str) -> list[str]:
        """Return all statements up to the end of the first meeting; ``clear`` is a question of the lead.

        A program starts with its wires low, and waits for a while before its running wire rises after a
        question. At the second question, which only the lead asks, the other program runs already.
        """
        out = [self._set_running(False)]
        popups: list[str] = []
        first = True
        for step in watched_start(partner, clear):
            match step:
                case handshake.ShowText(text) if partner.lead:
                    popups = syntax.message(text, before_question=True)
                case handshake.AskOperator(text):
                    wire_low = [] if first else [self._set_running(False)]
                    partner_check = [] if first else [syntax.partner_check(0, False)]
                    pause = f"sleep({syntax.format_real(syntax.START_PAUSE_S, 1)})"
                    out += [
                        *wire_low,
                        *popups,
                        *syntax.question(text),
                        *partner_check,
                        pause,
                        *self._raise_running(),
                    ]
                    first = False
                case _:
                    out += self._steps([step])
        wait = partner.handshake.timeout if partner.lead else partner.handshake.patience
        return [*out, *comment("First meeting: both programs run."), *self._meeting(partner, 1, wait)]

    def _raise_running(self) -> list[str]:
        """Return the rise of the running wire and the pause until it is read back correctly."""
        return [self._set_running(True), f"sleep({syntax.format_real(syntax.SETTLING_TIME_S, 1)})"]

    def _meeting(self, partner: handshake.HandshakeSide, meeting: int, wait: float) -> list[str]:
        """Return the statements of the meeting with the number ``meeting`` and a maximum ``wait`` [s].

        The program stops watching before a meeting in which the other program asks, or after which both
        end. A question of this program is between the two parts of a meeting. The lead postpones the second
        part until after its question. The follower has already written the first part before its question.
        """
        unwatched = meeting in self.held or meeting == partner.meets
        longest = partner.handshake.patience if meeting in self.held else 0.0
        first, rest = watched_meeting(partner, wait, longest)
        self.last_meeting = meeting
        out = self._watch(False) if unwatched else []
        out += [syntax.partner_check(1, True)] if self.question_meeting == meeting else self._steps(first)
        if partner.lead and meeting in self.asks:
            self.pending_steps = rest
            return out
        return out + self._steps(rest)

    def _steps(self, steps: Sequence[WatchedStep]) -> list[str]:
        """Return the statements of handshake steps.

        The thread that watches the other program is not started after the last meeting, because both
        programs then end.
        """
        out: list[str] = []
        for step in steps:
            match step:
                case handshake.SetLine(value):
                    out.append(self._switch(self._signals.output, value == 1))
                case handshake.AwaitLine(value, seconds):
                    out.append(syntax.wait_call(syntax.AWAIT_LINE, value, seconds))
                case handshake.AwaitRunning(value, seconds):
                    out.append(syntax.wait_call(syntax.AWAIT_RUNNING, value, seconds))
                case StartWatching() if self.partner is not None and self.last_meeting < self.partner.meets:
                    out += self._watch(True)
                case handshake.ShowText(text):
                    out += syntax.message(text, before_question=False)
        return out

    def _question(self, popups: Sequence[str], following: Sequence[layout.TaskStep]) -> list[str]:
        """Return the statements of a question between two meetings, with the popups that show it.

        The other program waits with its line at 1: in the previous meeting if the lead asks, in the next one
        if the follower asks. ``following`` are the steps of the operation after the question.
        """
        if self.partner is None:
            return list(popups)
        out: list[str] = []
        if not self.partner.lead and self.question_meeting != self.last_meeting + 1:
            self.question_meeting = self.last_meeting + 1
            out = self._steps(watched_meeting(self.partner, self.partner.handshake.patience)[0])
        wire_low = [self._set_running(False), *popups, syntax.partner_check(1, False), *self._raise_running()]
        out += [*self._watch(False), *wire_low, *self._watch(True), syntax.partner_check(1, True)]
        if not _asks_again(following):
            out += self._steps(self.pending_steps)
            self.pending_steps = []
        return out

    def _watch(self, on: bool) -> list[str]:
        """Start or end the thread that watches the other program, unless that is done already.

        Raises:
            TandemError: Power is on where the thread would end (``post.handshake_process``).
        """
        if on == self.watching:
            return []
        self.watching = on
        if not on and self.powered:
            listed = ", ".join(sorted(self.powered))
            message = (
                f"{listed} of arm {self.task.arm.name} is on while one of the programs asks a question; "
                "nothing would switch the power off if the other program stops then"
            )
            hint = "switch it off before the question, and on after it"
            raise issue_error("post.handshake_process", message, arm=self.task.arm.name, hint=hint)
        return [f"{syntax.WATCHING} = run {syntax.WATCH}()" if on else f"kill {syntax.WATCHING}"]

    def _declare(self, word: str, value: str) -> str:
        """Declare a variable with a value as text and return its name."""
        if self.data.setdefault(word, value) != value:
            message = f"two data of arm {self.task.arm.name} would have the name {word}"
            raise issue_error("post.name", message, hint="give the tool another name")
        return word

    def _operation(self, index: int, operation: layout.OperationProgram) -> list[str]:
        """Return the statements of an operation; ``index`` counts from 1.

        Messages right before a question are shown together with it.
        """
        out = comment(f"Operation {operation.name}.")
        tool_set = False
        self.torch = self.torches.get(index)
        popups: list[str] = []  # texts that are shown together with the question after them
        for i, step in enumerate(operation.steps):
            # the tool is set before the first move, after the setup in which it is mounted
            if not tool_set and isinstance(step, layout.JointMove | layout.SegmentRun):
                tool_set = True
                tool = operation.arm.tool
                out += [f"set_tcp({self._tool(tool)})", _payload(tool)]
            if isinstance(step, layout.ActionStep) and step.action.kind in ("message", "confirm"):
                following = operation.steps[i + 1 :]
                popups += self._action(step.action, layout.question_follows(following))
                if step.action.kind == "confirm":
                    out += self._question(popups, following)
                    popups = []
                elif not layout.question_follows(following):
                    out += popups
                    popups = []
                continue
            out += self._step(step, index, operation)
        return out

    def _step(self, step: layout.TaskStep, index: int, operation: layout.OperationProgram) -> list[str]:
        """Return the statements of a step that shows no text; ``index`` is that of the operation, from 1.

        Steps that URScript does not need give no statements.

        Raises:
            TandemError: The arm holds the block (``post.load``).
        """
        match step:
            case layout.JointMove():
                return self._movej(step, index, operation)
            case layout.ActionStep(action):
                return self._action(action, False)
            case layout.Meeting(meeting, reached, seconds) if self.partner is not None:
                wait = self.partner.handshake.patience + math.ceil(seconds)
                return [*comment(f"Meeting: {reached}"), *self._meeting(self.partner, meeting, wait)]
            case layout.SegmentRun():
                return self._run(step, operation)
            case layout.CarryLoad(load) if load is not None:
                raise TandemError(no_load(self.task.arm.name))
        return []

    def _movej(self, step: layout.JointMove, index: int, operation: layout.OperationProgram) -> list[str]:
        """Return a joint move in ``operation``, whose number ``index`` counts from 1.

        The first move of the program is slow, because its start is unknown. Speeds and accelerations are
        rounded down to four decimals.
        """
        limits = self.problem.settings
        robot = self.task.robot
        tcp = operation.arm.tool.tcp
        start = self.joints_before
        if start is None:
            speed = UNKNOWN_START_FRACTION * float(np.min(robot.velocity))
            speed = float(np.floor(1e4 * speed) / 1e4)
        else:
            speed = joint_speed(robot, start, step.q, tcp, limits.tcp_speed, limits.speed_fraction)
        self.joints_before = step.q
        acceleration = float(np.floor(1e4 * self._acceleration) / 1e4)
        return [syntax.movej(self._joints(step, index), acceleration, speed)]

    def _joints(self, step: layout.JointMove, operation: int) -> str:
        """Return the variable of a joint target; targets with equal text share one.

        ``operation`` is the number of the operation, from 1, for the name of a new variable.
        """
        text = syntax.format_joints(self.task.robot.to_controller(step.q))
        if text not in self.joint_names:
            stem = "x_home" if step.role == "home" else f"x_{operation}_{step.role}"
            count = sum(word.startswith(stem) for word in self.joint_names.values())
            word = stem if step.role == "home" else f"{stem}_{count + 1}"
            self.joint_names[text] = self._declare(word, text)
        return self.joint_names[text]

    def _tool(self, tool: Tool) -> str:
        """Return the variable of a tool's TCP; tools with equal name and TCP share one."""
        value = syntax.pose(tool.tcp)
        key = f"{tool.name} {value}"
        if key not in self.tools:
            stem = identifier(f"t_{tool.name}")
            names = itertools.chain([stem], (f"{stem}_{n}" for n in itertools.count(2)))
            variable = next(word for word in names if word not in self.tools.values())
            self.tools[key] = self._declare(variable, value)
        return self.tools[key]

    def _frame(self, operation: layout.OperationProgram) -> str:
        """Return the variable with the frame of an operation's moves in the controller's base frame.

        Raises:
            TandemError: The targets are on a block that an arm holds (``post.frame``).
        """
        kind = "world" if operation.moves is None else operation.moves.frame
        world_in_base = inverse(self.base)
        if kind == "world":
            return self._declare("b_world", syntax.pose(world_in_base))
        if kind == "stock":
            stock_frame = world_in_base @ self.plan.stock_poses[operation.setup - 1]
            word = "b_stock" if operation.setup == 1 else f"b_stock_{operation.setup}"
            return self._declare(word, syntax.pose(stock_frame))
        message = f"targets of {self.task.arm.name} are in {kind!r}, for which URScript has no frame"
        raise issue_error("post.frame", message, hint="allowed: stock, world")

    def _action(self, action: TargetAction, asks: bool) -> list[str]:
        """Return the statements of an action of the process; ``asks`` says whether a question follows.

        Raises:
            TandemError: The action waits for an input that is not that of a torch (``post.controller``).
        """
        match action.kind:
            case "message":
                return syntax.message(action.text, before_question=asks)
            case "confirm":
                return syntax.question(action.text)
            case "on" | "off":
                change = self.powered.add if action.kind == "on" else self.powered.discard
                change(action.signal)
                return self._switch_output(action.signal, action.kind == "on")
            case "wait":
                return [f"sleep({syntax.format_real(action.seconds, 3)})"]
            case "input" if self.torch is not None and action.signal == self.torch.ok_signal:
                return [self.torch.wait]
            case "input":
                raise TandemError(no_input(action, self.task.arm.name))

    def _switch(self, signal: str, on: bool) -> str:
        return f"{syntax.output(self._number(signal), on)} # {signal}"

    def _number(self, signal: str) -> int:
        number = self.problem.cell.controller.signal_number(self.task.arm.name, signal)
        if number is None:
            message = f"the cell states no number for {signal} on the controller of {self.task.arm.name}"
            raise issue_error("post.signal", message, arm=self.task.arm.name)
        return number

    def _run(self, run: layout.SegmentRun, operation: layout.OperationProgram) -> list[str]:
        """Return the statements of a run of moves: a comment, the moves, and the meetings after moves.

        The thread of a torch that is on starts before them. With a partner program, a pause replaces a move
        of zero length, in which only the other arm moves.

        Raises:
            TandemError: A move passes its target without length for a blend, or the first move of the
                operation has zero length (``post.blend``).
        """
        track = operation.moves
        run_slice = slice(run.first, run.last)
        if track is None:
            return []
        radius = syntax.blends(track, operation.stop)
        unblended = np.flatnonzero(np.isnan(radius[run_slice])) + run.first
        if len(unblended):
            first_move = f"{operation.segments[unblended[0]]}, move {unblended[0] + 1}"
            message = (
                f"operation {operation.name}: {len(unblended)} moves of arm {self.task.arm.name} would pass "
                f"targets without enough length for a blend, first {first_move}: the tool rotates about its "
                "TCP, or hardly moves"
            )
            hint = "let the motion stop there, or choose another TCP or cut, so that the tool moves"
            raise issue_error("post.blend", message, arm=self.task.arm.name, target=first_move, hint=hint)
        seconds = layout.format_short(float(track.duration[run_slice].sum()), 2)
        out: list[str] = []
        if self.torch is not None and self.lit and not self.guarded:
            out.append(self.torch.start_thread)
            self.guarded = True
        out += comment(
            f"Segment {layout.segment_mark(run.segment)}: {run.last - run.first} moves, {seconds} s."
        )
        moves = syntax.linear_moves(track, radius, self._frame(operation))[run_slice]
        if self.partner is not None and self.joints_before is not None:
            stationary = np.flatnonzero(self._stationary_moves(operation, track)[run_slice])
            for i in stationary.tolist():
                moves[i] = f"{syntax.STAND}({syntax.format_real(float(track.duration[run_slice][i]), 5)})"
        for move, meeting in zip(moves, operation.meets[run_slice].tolist(), strict=True):
            out.append(move)
            if meeting and self.partner is not None:
                out += self._meeting(self.partner, meeting, self.partner.handshake.timeout)
        self.joints_before = track.q[run.last - 1]
        self.moves += run.last - run.first
        return out

    def _stationary_moves(self, operation: layout.OperationProgram, track: layout.MoveTable) -> BoolArray:
        """Return which moves (M,) of an operation have zero length.

        Raises:
            TandemError: The first move has zero length (``post.blend``): a program can only stand still after
                a straight move.
        """
        start = next(
            step.q for step in operation.steps if isinstance(step, layout.JointMove) and step.role == "start"
        )
        out = syntax.stationary_moves(track, start)
        if out[:1].any():
            message = f"operation {operation.name}: arm {self.task.arm.name} stands still in its first move"
            hint = "let both arms move from the first target on"
            raise issue_error("post.blend", message, arm=self.task.arm.name, hint=hint)
        return out


def no_input(action: TargetAction, arm: str) -> Issue:
    """Return the issue that a UR arm cannot wait for an input of its process."""
    what = f"arm {arm} has to wait for {action.signal}, at most {action.seconds:g} s, which Tandem writes "
    what += "only in RAPID and KRL so far"
    return Issue("post.controller", what, arm=arm, hint="use an ABB or KUKA robot for it")


def no_load(arm: str) -> Issue:
    """Return the issue that a UR arm cannot hold a block."""
    message = f"arm {arm} holds the block; URScript is written only for tools"
    return Issue("post.load", message, arm=arm, hint="let the block rest in the cell")


def _payload(tool: Tool) -> str:
    """Return the statement that sets mass [kg] and centre of mass [m] in the flange frame.

    Raises:
        TandemError: The tool has no mass (``post.tool``).
    """
    require_mass(tool, "a payload needs at least {} kg")
    return f"set_payload({layout.format_fixed(tool.mass, 3)},{syntax.format_vector(np.asarray(tool.cog), 6)})"


def _asks_again(steps: Sequence[layout.TaskStep]) -> bool:
    """Return whether another question comes among ``steps`` before the next meeting or the next moves."""
    questions_and_meetings = (
        step
        for step in steps
        if isinstance(step, layout.Meeting | layout.SegmentRun) or layout.is_question(step)
    )
    return layout.is_question(next(questions_and_meetings, None))


def write(
    tasks: Sequence[layout.TaskProgram],
    job: layout.JobPrograms,
    plan: Plan,
    problem: Problem,
    margins: Margins,
) -> WrittenPrograms:
    """Write the programs of UR arms, one file for each task.

    Args:
        tasks: Tasks to write.
        job: All tasks of the job.
        plan: The plan.
        problem: Problem of the plan.
        margins: Smallest margins of the plan, for the header.

    Raises:
        TandemError: A program cannot be written (``post.*``).
    """
    controller = problem.cell.controller
    out: dict[str, str] = {}
    for task in tasks:
        stem = identifier(problem.name, _STEM_LENGTH)
        writer = _ProgramWriter(task, job, plan, problem)
        declarations, body = writer.lines()
        header_sentences = header(task, job, plan, margins, untested=[_UNTESTED])
        head = [line for sentence in header_sentences for line in comment(sentence)]
        digest_comment = "# what this program was planned for; the proof starts from these"
        digest = f'problem_digest = "{plan.digest}"'
        lines = [f"def {stem}():", *head, digest_comment, digest, *declarations, *body, "end"]
        path = f"{task.arm.name}/{stem}.script"
        text = "".join(f"{line}{layout.LINE_END}" for line in lines)
        layout.require_one_file(path, text, controller, writer.moves, "moves")
        out[path] = text
    return WrittenPrograms(out)
