"""Follows a URScript program statement by statement: settings are put into moves, names become values.

There is one path, because the only branches end the program. The first statements check whether the
controller moves the planned arm. A straight move takes its time t in any case. Its blend radius r bounds
how far from its target the path may leave the straight lines; 0 is an exact stop.

A program that meets the one of another controller has three functions and a thread that end it in a defined
way: they first switch off its own running wire and all that it has switched on. All of them read that wire
back, which stays low after a pause. Questions are between its fall and its rise; nothing else switches it.

A torch with a thread burns from its output's rise on, while the arm is at rest. After the wait for its input
and a pause, the thread starts. Only straight moves follow until the thread ends and the output falls.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, NoReturn

import numpy as np

from planner.claims import sentences
from planner.geometry.arrays import FloatArray, exp_rotation, to_quaternion
from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.reader import syntax_tree
from planner.languages.urscript.reader.reader import ScriptText, pose
from planner.languages.urscript.reader.torches import TorchChecks
from planner.programs import steps
from planner.programs.handshake.wire_operations import MIN_SETTLING_TIME_S

MAIN_PROCEDURE: Final = "main"
"""Name of the program in steps outside of its segments. Its own name is the problem's."""
ARM_CHECK_KIND: Final = "get_forward_kin"
"""Kind of the step that checks whether the controller moves the planned arm.

Its 19 values are six joints [rad], the checked point of the flange and its expected position as poses of six
numbers, and the allowed distance [m].
"""
SETTLING_TIME_S: Final = 0.1
"""Time [s] that a program waits after the rise of its running wire, so that it reads back the new level."""
_EXACT_STOP: Final = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Corner of a move that ends at rest."""
_NO_AXES: Final = np.zeros(6)
"""Values of the external axes, which URScript programs do not move."""


@dataclass(frozen=True)
class ControllerWires:
    """Names of a controller's signals.

    Attributes:
        outputs: Outputs by number.
        inputs: Inputs by number.
        other: Arm of the other controller, empty for none.
        line: Output whose line the other controller reads.
        running: Output of this program's running wire.
    """

    outputs: Mapping[int, str]
    inputs: Mapping[int, str]
    other: str = ""
    line: str = ""
    running: str = ""


def flow_steps(
    text: ScriptText, base: FloatArray, wires: ControllerWires, arm: str, model: str, velocity: FloatArray
) -> tuple[steps.ProgramStep, ...]:
    """Return the steps of a program without faults.

    Args:
        text: The program as read.
        base: The controller's base (4, 4) in the world.
        wires: Names of the controller's signals.
        arm: Name of the arm.
        model: Name of the robot model.
        velocity: Maximum speeds (6,) [rad/s] of its axes.

    Raises:
        FlowError: The program does not have the required structure.
    """
    if text.program is None:
        return ()
    return _FlowReader(
        text.program, base, wires, urscript_sentences.OTHER_ARM.format(arm=arm, model=model), velocity
    ).run()


@dataclass(frozen=True)
class _ScriptMotion:
    """Motion that a statement commands.

    Attributes:
        target: The target.
        speed: Speeds in force.
        zone: Corner at the target.
        work_object: Frame of the target.
        work_object_name: Name of that frame, "" for a joint target.
        time: Time [s], None for a joint move.
        target_name: Name of the target, "" for a target in place.
        acceleration: Acceleration of the leading axis [rad/s^2], None for a straight move.
    """

    target: steps.JointTarget | steps.RobTarget
    speed: steps.MoveSpeed
    zone: steps.Zone
    work_object: steps.WorkObject
    work_object_name: str
    time: float | None = None
    target_name: str = ""
    acceleration: float | None = None


class _FlowReader:
    """Follows one program.

    Attributes:
        awaits_question: Whether the last popup is a text before a question, which must follow.
        load_line: Line of the last set_payload; with the tool's name it identifies a tool.
        meets: Whether the program meets the one of another controller.
        question_wire: Statement at which the running wire fell for a question that is still open, else None.
        question_asked: Whether that question has been asked.
        watched: Whether the thread runs that watches the other program.
        stays_low_checked: Whether the program has checked that its running wire does not stay high.
        wire_rose: Whether the running wire has just risen, so that a pause must follow.
        must_watch: Whether the thread or a wait must follow before any other pause.
        waited: Time [s] of pauses since the last popup or check while the running wire is low.
    """

    def __init__(
        self,
        program: syntax_tree.ScriptProgram,
        base: FloatArray,
        wires: ControllerWires,
        expected_check_text: str,
        velocity: FloatArray,
    ) -> None:
        self.program, self.base, self.wires = program, base, wires
        self.expected_check_text, self.velocity = expected_check_text, velocity
        self.steps: list[steps.ProgramStep] = []
        self.procedure = MAIN_PROCEDURE
        self.tool_name = ""
        self.load: steps.LoadData | None = None
        self.tools: dict[tuple[str, int], steps.Tool] = {}
        self.work_objects: dict[str, steps.WorkObject] = {}
        self.arm_checked = self.moved = self.awaits_question = False
        self.load_line = 0
        self.meets = bool(program.endings)
        self.question_wire: syntax_tree.SetOutput | None = None
        self.question_asked = self.watched = self.stays_low_checked = self.wire_rose = self.must_watch = False
        self.waited = 0.0
        self.torches = TorchChecks(program, self._fail, self._output, self._input)

    def run(self) -> tuple[steps.ProgramStep, ...]:
        """Return the steps of the program.

        Raises:
            FlowError: A function or thread differs from what is required, a statement is not allowed where it
                is, or the program ends with an open question or a torch that is on.
        """
        if self.meets:
            self._check_functions()
        self.torches.check_functions()
        for statement in self.program.body:
            if isinstance(statement, syntax_tree.SegmentComment):
                self.procedure = statement.label
                continue
            if self.awaits_question and not (
                isinstance(statement, syntax_tree.Popup) and statement.kind != "note"
            ):
                self._fail(statement, "an informational popup is not followed by a question")
            if not isinstance(statement, syntax_tree.ScriptLinearMove | syntax_tree.DwellMove):
                self.procedure = MAIN_PROCEDURE
            self.torches.process(statement)
            if not (self.meets and self._take_running_wire(statement)):
                self._statement(statement)
        if self.awaits_question:
            self._fail(self.program.body[-1], "the last informational popup is not followed by a question")
        self.torches.end(self.program.body[-1])
        if self.question_wire is not None or self.wire_rose:
            at = self.question_wire or self.program.body[-1]
            self._fail(at, "the running wire falls for a question, and does not rise and settle after it")
        return tuple(self.steps)

    def _fail(self, statement: syntax_tree.Statement, message: str) -> NoReturn:
        raise steps.FlowError(
            [steps.TextFault(statement.line, 1, "urscript.flow", message, self.program.file)]
        )

    def _location(self, statement: syntax_tree.Statement) -> tuple[str, str, int, str]:
        """Return the first four fields of a step: module, procedure, line and condition."""
        return self.program.file.rpartition("/")[2], self.procedure, statement.line, ""

    def _statement(self, statement: syntax_tree.Statement) -> None:
        """Append the step of a statement, or store its setting for later moves.

        Tool and payload are stored. The checks whether an output stays on give no step.

        Raises:
            FlowError: The statement comes too early, as an output that is switched on before the check of the
                arm, or calls a function that does not exist, or a popup holds the program while its running
                wire is high.
        """
        where = self._location(statement)
        match statement:
            case syntax_tree.SetTcp(name=name):
                self.tool_name = name
                self.load = None
            case syntax_tree.SetPayload(mass=mass, centre=centre):
                if not self.tool_name:
                    self._fail(statement, "a payload is set before any tool")
                axes = np.array([1.0, 0.0, 0.0, 0.0])
                self.load = steps.LoadData(mass, np.array(centre), axes, np.zeros(3))
                self.load_line = statement.line
            case syntax_tree.SetOutput(number=number, value=on):
                if on and not self.arm_checked:
                    self._fail(statement, "an output is switched on before the program has checked the arm")
                name = self._output(number)
                self.steps.append(steps.SignalStep(*where, "set_digital_out", name, float(on), 0.0, True))
            case syntax_tree.SleepStatement(seconds=seconds):
                self.steps.append(steps.WaitStep(*where, "sleep", seconds, "", None, True))
            case syntax_tree.Popup(kind=kind, text=text):
                asks = kind == "question"
                self.awaits_question = kind == "read"
                if self.meets and kind != "note" and self.question_wire is None:
                    self._fail(statement, "a popup holds the program while its running wire is high")
                self.question_asked |= asks
                panel: Literal["line", ""] = "" if asks else "line"
                message = steps.MessageStep(
                    *where, "popup", (text,), asks, text, asks, panel, counts_as_stopped=self.meets and asks
                )
                self.steps.append(message)
            case syntax_tree.PoseCheck():
                self._check_arm(statement)
            case syntax_tree.OutputLowCheck(number=number) if self.torches.watches(number):
                if any(isinstance(step, steps.SignalStep) for step in self.steps):
                    self._fail(
                        statement, "the program checks whether a torch stays on after it has switched outputs"
                    )
            case syntax_tree.OutputLowCheck(number=number, switched_off=off, text=text):
                expected_text = urscript_sentences.STAYS_ON.format(signal=self.wires.running)
                if not self.meets or not self._runs(number) or text != expected_text:
                    self._fail(
                        statement, "a check of an output other than the running wire's, or with another text"
                    )
                if off != (number,):
                    self._fail(
                        statement,
                        f"only {self.wires.running} must be switched off where it is found to stay on",
                    )
                if self.stays_low_checked:
                    self._fail(statement, "the program checks again whether its running wire stays high")
                self.stays_low_checked = True
            case syntax_tree.AwaitSignal(name=name, value=value, seconds=seconds):
                ending = self.program.endings.get(name)
                if ending is None:
                    self._fail(statement, f"there is no function {name}")
                signal = self._input(ending.numbers[0])
                self.steps.append(steps.WaitStep(*where, name, seconds, signal, float(value), True))
            case syntax_tree.AwaitArc(name=name, seconds=seconds):
                signal = self._input(self.program.torches[name].given or 0)
                self.steps.append(steps.WaitStep(*where, name, seconds, signal, 1.0, True))
            case syntax_tree.ArcWatchdog(name=name, on=on):
                thread = self.program.torches[name]
                input_name = "" if thread.given is None else self._input(thread.given)
                output_name = self._output(-1 if thread.torch_output is None else thread.torch_output)
                self.steps.append(
                    steps.GuardStep(
                        *where, output_name, input_name, thread.max_standing_time, thread.min_travel, on
                    )
                )
            case syntax_tree.PartnerCheck(value=value, running=own_level):
                ending = self.program.endings.get(syntax_tree.CHECK)
                if ending is None:
                    self._fail(statement, f"there is no function {syntax_tree.CHECK}")
                line, partner_running = map(self._input, ending.numbers)
                self.steps.append(steps.CheckStep(*where, line, int(value), partner_running, own_level))
            case syntax_tree.WatchdogThread(on=on):
                self._watch(statement, on)
            case syntax_tree.ScriptJointMove():
                self._joint(statement)
            case syntax_tree.ScriptLinearMove():
                self._straight(statement)
            case syntax_tree.DwellMove():
                self._standing_move(statement)

    def _check_arm(self, check: syntax_tree.PoseCheck) -> None:
        """Append the step of the check whether the controller moves the planned arm."""
        if self.arm_checked or self.moved:
            self._fail(check, "the program must check the arm before it moves")
        if check.text != self.expected_check_text:
            message = f"the check of the arm shows {check.text!r}; expected: {self.expected_check_text!r}"
            self._fail(check, message)
        values = (*self.program.data[check.name].value, *check.tip, *check.position, check.tolerance)
        self.steps.append(steps.SettingStep(*self._location(check), ARM_CHECK_KIND, (), values))
        self.arm_checked = True

    # ---- the other controller ----

    def _output(self, number: int) -> str:
        """Return the name of an output, or its number in words if it has none."""
        return self.wires.outputs.get(number, f"output {number}")

    def _input(self, number: int) -> str:
        return self.wires.inputs.get(number, f"input {number}")

    def _runs(self, number: int) -> bool:
        """Return whether an output is this program's running wire."""
        return self._output(number).lower() == self.wires.running.lower()

    def _check_functions(self) -> None:
        """Check the functions and the thread that end the program because of the other controller.

        They must exist, read the running wire back, show the expected text, and switch off the running wire
        first and then all that the program switches on, except the line to the other controller.
        """
        endings = self.program.endings
        wires = self.wires
        first = next(iter(endings.values()))
        missing = [
            name
            for name in (
                syntax_tree.AWAIT_LINE,
                syntax_tree.AWAIT_RUNNING,
                syntax_tree.CHECK,
                syntax_tree.WATCH,
                syntax_tree.STAND,
            )
            if name not in endings
        ]
        if missing or not wires.other:
            cause = (
                f"{', '.join(missing)} is missing" if missing else "no other controller exists to wait for"
            )
            self._fail(first, cause)
        numbers = (
            statement.number
            for statement in self.program.body
            if isinstance(statement, syntax_tree.SetOutput) and statement.value
        )
        switched_on = {self._output(number).lower() for number in numbers} - {wires.line.lower()}
        for name, ending in endings.items():
            if name == syntax_tree.STAND:
                continue  # it ends nothing
            if not self._runs(ending.running):
                self._fail(
                    ending, f"{name} reads back {self._output(ending.running)} instead of {wires.running}"
                )
            lost = urscript_sentences.PARTNER_LOST if name == syntax_tree.WATCH else sentences.UNANSWERED
            expected_text = lost.format(other=wires.other)
            if ending.text != expected_text:
                self._fail(ending, f"{name} shows {ending.text!r}; expected: {expected_text!r}")
            switched_off = [self._output(number).lower() for number in ending.switched_off]
            if switched_off[:1] != [wires.running.lower()]:
                self._fail(ending, f"{name} does not switch off {wires.running} before all else")
            if still_on := sorted(switched_on - set(switched_off)):
                self._fail(ending, f"{name} leaves {', '.join(still_on)} on")
            if wires.line.lower() in switched_off:
                self._fail(
                    ending, f"{name} switches {wires.line}, which the other program would take for an arrival"
                )

    def _take_running_wire(self, statement: syntax_tree.Statement) -> bool:
        """Check a statement against the state of the running wire.

        - The wire falls before a question.
        - While it is low, only popups, checks of the other program, and the fall of the line before a
          question are allowed, and short pauses after the question.
        - It rises after the answer. A pause of fixed length follows, and then the thread or a wait.

        Returns:
            True if the statement needs no further processing.
        """
        if self.wire_rose:
            if not isinstance(statement, syntax_tree.SleepStatement) or statement.seconds != SETTLING_TIME_S:
                self._fail(statement, f"sleep({SETTLING_TIME_S}) must follow the rise of the running wire")
            self.wire_rose = False
            self.must_watch = True
            return True
        if self.must_watch and isinstance(statement, syntax_tree.SleepStatement):
            self._fail(statement, "the program waits after the rise of its running wire without watching")
        is_running_wire = isinstance(statement, syntax_tree.SetOutput) and self._runs(statement.number)
        self.must_watch = self.must_watch and not (
            is_running_wire or isinstance(statement, syntax_tree.WatchdogThread | syntax_tree.AwaitSignal)
        )
        if self.question_wire is None:
            if not is_running_wire or not isinstance(statement, syntax_tree.SetOutput) or statement.value:
                return False
            if not self.stays_low_checked:
                self._fail(
                    statement, "nothing checks before whether the running wire stays high without a program"
                )
            self.question_wire = statement
            self.question_asked = False
            self.waited = 0.0
            self.steps.append(steps.RunningStep(*self._location(statement), False))
            return True
        match statement:
            case syntax_tree.SetOutput(value=True) if is_running_wire and self.question_asked:
                self.steps.append(steps.RunningStep(*self._location(statement), True, self.waited))
                self.question_wire = None
                self.wire_rose = True
                return True
            case syntax_tree.SleepStatement(seconds=seconds) if self.question_asked:
                self.waited += seconds
                if self.waited > MIN_SETTLING_TIME_S:  # the model of both programs has no longer waits
                    self._fail(
                        statement,
                        f"more than {MIN_SETTLING_TIME_S} s between a check and the rise of the running wire",
                    )
                return True
            case syntax_tree.Popup() | syntax_tree.PartnerCheck(running=False):
                self.waited = 0.0
                return False
        resets_line = (
            isinstance(statement, syntax_tree.SetOutput)
            and not statement.value
            and self._is_line(statement.number)
        )
        if not resets_line or self.question_asked:
            self._fail(statement, "only a question may come while the running wire is low")
        return False

    def _is_line(self, number: int) -> bool:
        return self._output(number).lower() == self.wires.line.lower()

    def _watch(self, statement: syntax_tree.Statement, on: bool) -> None:
        """Start (``on``) or end the thread that watches the other program."""
        if on == self.watched:
            thread = "the thread that watches the other program "
            self._fail(statement, thread + ("runs already" if on else "does not run"))
        ending = self.program.endings.get(syntax_tree.WATCH)
        if ending is None:
            self._fail(statement, f"there is no thread {syntax_tree.WATCH}")
        self.watched = on
        self.steps.append(steps.WatchStep(*self._location(statement), self._input(ending.numbers[0]), on))

    # ---- moves ----

    def _joint(self, move: syntax_tree.ScriptJointMove) -> None:
        """Append the step of a movej. Its speed becomes a fraction of each axis' maximum speed."""
        target = steps.JointTarget(np.array(self.program.data[move.name].value), _NO_AXES)
        fractions = tuple(float(move.speed / axis_speed) for axis_speed in self.velocity)
        speed = steps.MoveSpeed(math.inf, math.inf, 0.0, 0.0, fractions)
        base = steps.WorkObject(False, True, "", self.base, np.eye(4))
        motion = _ScriptMotion(
            target, speed, _EXACT_STOP, base, "", target_name=move.name, acceleration=move.acceleration
        )
        self._move(move, motion)

    def _straight(self, move: syntax_tree.ScriptLinearMove) -> None:
        """Append the step of a movel, with the time and the blend radius that it states."""
        if not self.moved:
            self._fail(move, "movel has no known start; use movej to joints first")
        quaternion = to_quaternion(exp_rotation(np.array(move.target[3:])))
        target = steps.RobTarget(np.array(move.target[:3]), quaternion, None, _NO_AXES)
        stops = move.radius == 0.0
        zone = _EXACT_STOP if stops else steps.Zone(False, move.radius, 0.0, 0.0, 0.0, 0.0, 0.0)
        speed = steps.MoveSpeed(math.inf, math.inf, 0.0, 0.0)
        work_object = self._work_object(move.frame)
        self._move(move, _ScriptMotion(target, speed, zone, work_object, move.frame, time=move.seconds))

    def _standing_move(self, stand: syntax_tree.DwellMove) -> None:
        """Append the step of an arm that waits at its last target while only the other arm moves.

        The step is a move to that target, so that both arms have equal numbers of moves.
        """
        previous_move = next(
            (step for step in reversed(self.steps) if isinstance(step, steps.MoveStep)), None
        )
        if (
            syntax_tree.STAND not in self.program.endings
            or previous_move is None
            or not isinstance(previous_move.target, steps.RobTarget)
        ):
            self._fail(stand, f"{syntax_tree.STAND} is allowed only after a movel")
        motion = _ScriptMotion(
            previous_move.target,
            previous_move.speed,
            _EXACT_STOP,
            previous_move.wobj,
            previous_move.wobj_name,
            time=stand.seconds,
        )
        self._move(stand, motion)

    def _work_object(self, name: str) -> steps.WorkObject:
        if name not in self.work_objects:
            frame = pose(self.program.data[name].value)
            self.work_objects[name] = steps.WorkObject(False, True, "", self.base, frame)
        return self.work_objects[name]

    def _tool(self, statement: syntax_tree.Statement) -> steps.Tool:
        if self.load is None:
            self._fail(statement, "an arm moves before set_tcp and then set_payload have set its tool")
        key = self.tool_name, self.load_line
        if key not in self.tools:
            self.tools[key] = steps.Tool(True, pose(self.program.data[self.tool_name].value), self.load)
        return self.tools[key]

    def _move(
        self,
        move: syntax_tree.ScriptJointMove | syntax_tree.ScriptLinearMove | syntax_tree.DwellMove,
        motion: _ScriptMotion,
    ) -> None:
        """Append the step of a move with the tool in force.

        Raises:
            FlowError: The program has not checked the arm or not set its tool before.
        """
        if not self.arm_checked:
            self._fail(move, "an arm moves before the program has checked whether it is the planned one")
        tool = self._tool(move)
        kind = {
            syntax_tree.ScriptJointMove: "movej",
            syntax_tree.ScriptLinearMove: "movel",
            syntax_tree.DwellMove: syntax_tree.STAND,
        }[type(move)]
        zone = motion.zone
        self.steps.append(
            steps.MoveStep(
                *self._location(move),
                kind=kind,
                target=motion.target,
                target_name=motion.target_name,
                id=None,
                time=motion.time,
                velocity=None,
                speed=motion.speed,
                zone=zone,
                zone_name="an exact stop" if zone.fine else f"r={zone.tcp:g}",
                tool=tool,
                tool_name=self.tool_name,
                wobj=motion.work_object,
                wobj_name=motion.work_object_name,
                switches=(),
                acceleration=motion.acceleration,
            )
        )
        self.moved = True
