"""Converts programs to automata: what two programs do with the wires between their controllers.

Meetings are counted by the program text, not by the cell's definition: at each meeting the program's own
output rises (four-phase) or changes (toggle). The steps between two meetings form an interval. It is a fault
if two programs have different numbers of meetings, or if a program uses a wire in a way that the automata do
not model.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

from planner.claims.handshake import HandshakeKind, SignalWire
from planner.programs.handshake.model import AutomatonAction, Levels
from planner.programs.handshake.wire_operations import MIN_SETTLING_TIME_S
from planner.programs.steps import (
    CarryStep,
    CheckStep,
    ChoiceStep,
    LoadStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    RunningStep,
    SettingStep,
    SignalStep,
    SyncStep,
    WaitStep,
    WatchStep,
    normalised_text,
)

Sections = Mapping[tuple[str, str], tuple[ProgramStep, ...]]
"""Steps of ERROR or UNDO sections by (module, procedure)."""
_READY_TEXT = "readytomeetarm"
"""Letters of the message that a following program shows before the two meet."""
_START_TEXT = "starttheprogramofarm"
"""Letters of the message of the leading program that asks the operator to start the following one."""


@dataclasses.dataclass(frozen=True)
class Wiring:
    """Wires between two controllers. Names of signals are in lower case.

    Attributes:
        wires: Wires of the handshake.
        drives: Numbers of the wires that outputs drive, by arm and name of the output.
        reads: Numbers of the wires that inputs read, by arm and name of the input.
        doubled: Descriptions of the signals that have several wires.
        running: Running wires, each of which states that a controller runs its program.
        running_outputs: Names of the outputs to running wires, by arm.
        running_inputs: Names of the inputs from running wires, by arm.
    """

    wires: tuple[SignalWire, ...]
    drives: Mapping[str, Mapping[str, int]]
    reads: Mapping[str, Mapping[str, int]]
    doubled: tuple[str, ...]
    running: tuple[SignalWire, ...] = ()
    running_outputs: Mapping[str, frozenset[str]] = dataclasses.field(default_factory=dict)
    running_inputs: Mapping[str, frozenset[str]] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of(wires: Sequence[SignalWire], arms: Sequence[str], running: Sequence[SignalWire] = ()) -> "Wiring":
        """Return the wiring of controllers.

        Args:
            wires: Wires of the handshake.
            arms: Names of the arms.
            running: Running wires.
        """
        drives: dict[str, dict[str, int]] = {arm: {} for arm in arms}
        reads: dict[str, dict[str, int]] = {arm: {} for arm in arms}
        doubled, used = [], set()
        for number, wire in enumerate((*wires, *running)):
            for arm, name in ((wire.source, wire.output), (wire.sink, wire.input)):
                if (arm, name.lower()) in used:
                    doubled.append(f"{name} of arm {arm}")
                used.add((arm, name.lower()))
            if number < len(wires):
                drives.setdefault(wire.source, {})[wire.output.lower()] = number
                reads.setdefault(wire.sink, {})[wire.input.lower()] = number
        running_outputs = {
            arm: frozenset(wire.output.lower() for wire in running if wire.source == arm) for arm in arms
        }
        running_inputs = {
            arm: frozenset(wire.input.lower() for wire in running if wire.sink == arm) for arm in arms
        }
        return Wiring(
            tuple(wires), drives, reads, tuple(doubled), tuple(running), running_outputs, running_inputs
        )


@dataclasses.dataclass(frozen=True)
class ProgramAutomaton:
    """Automaton of one program.

    Attributes:
        actions: Actions of the program. Their ``line`` is the index of a step among its steps.
        interval: Interval of each step: number of meetings before it.
        protocol: Whether each step belongs to the handshake rather than to the work.
        faults: Faults of the program, as (message, step).
    """

    actions: tuple[AutomatonAction, ...]
    interval: tuple[int, ...]
    protocol: tuple[bool, ...]
    faults: tuple[tuple[str, ProgramStep], ...]


def program_automata(
    arms: Sequence[str],
    steps: Mapping[str, Sequence[ProgramStep]],
    sections: Mapping[str, Sequence[Sections]],
    wiring: Wiring,
    kind: HandshakeKind,
    max_stop_wait: float,
) -> dict[str, ProgramAutomaton]:
    """Return the automata of the programs, by arm.

    If the panel of one program asks to start the other one, the other one begins with a gate: it does not
    start before the first one shows this text. A question whether the other program is ready is also a gate.

    Args:
        arms: Names of the arms.
        steps: Steps of each program.
        sections: ERROR and UNDO sections of each program by (module, procedure).
        wiring: Wires between the controllers.
        kind: Kind of handshake.
        max_stop_wait: Maximum time for which a program may wait until the other one is stopped [s].
    """
    builders = {
        arm: _AutomatonBuilder(
            _ArmProgram(arm, steps[arm], sections[arm]),
            wiring,
            kind,
            _ready_question(arm, steps, arms),
            max_stop_wait,
        )
        for arm in arms
    }
    for builder in builders.values():
        builder.run()
    start_positions = {
        arm: _position_naming(arm, arms, {name: builders[name].starts for name in arms}) for arm in arms
    }
    out = {}
    for arm, builder in builders.items():
        # positions in the other program are one later if it begins with a gate itself
        offset = sum(position is not None for name, position in start_positions.items() if name != arm)
        ready_position = _position_naming(arm, arms, {name: builders[name].ready for name in arms})
        gate_position = 0 if ready_position is None else ready_position + offset
        actions = [
            dataclasses.replace(action, value=gate_position) if action.kind == "gate" else action
            for action in builder.actions
        ]
        start_position = start_positions[arm]
        if start_position is not None:
            actions.insert(0, AutomatonAction("gate", wire=0, value=start_position + offset))
        out[arm] = ProgramAutomaton(
            tuple(actions), tuple(builder.interval), tuple(builder.protocol), tuple(builder.faults)
        )
    return out


def uses_wires(arm: str, steps: Iterable[ProgramStep], sections: Sequence[Sections], wiring: Wiring) -> bool:
    """Return whether a program uses the wires between two controllers, or starts the other program.

    It starts the other program if a message asks the operator to do so, or says that this program is ready to
    meet. A program that does none of this may run alone.

    Args:
        arm: Name of the arm.
        steps: Steps of the program.
        sections: ERROR and UNDO sections of the program.
        wiring: Wires between the controllers.
    """
    running_names = wiring.running_outputs.get(arm, frozenset()) | wiring.running_inputs.get(arm, frozenset())
    names = {*wiring.drives[arm], *wiring.reads[arm], *running_names}
    handlers = (step for table in sections for part in table.values() for step in part)
    for step in _all_steps((*steps, *handlers)):
        match step:
            case RunningStep() | WatchStep() | CheckStep():
                return True
            case SignalStep() | WaitStep() if step.signal.lower() in names:
                return True
            case MessageStep() if _READY_TEXT in normalised_text(step.text) or _START_TEXT in normalised_text(
                step.text
            ):
                return True
    return False


def counts_as_stopped(step: MessageStep) -> bool:
    """Return whether a program counts as stopped, with its running wire at 0, while it shows a message."""
    return step.kind == "HALT" or step.counts_as_stopped


def _position_naming(arm: str, arms: Sequence[str], positions: Mapping[str, Mapping[str, int]]) -> int | None:
    """Return the position in another program at which its panel names an arm, or None.

    Args:
        arm: Name of the arm.
        arms: Names of all arms.
        positions: For each program the positions of its messages, by the letters of the arm that they name.
    """
    matches = [
        positions[name][normalised_text(arm)]
        for name in arms
        if name != arm and normalised_text(arm) in positions[name]
    ]
    return matches[0] if matches else None


def _ready_question(arm: str, steps: Mapping[str, Sequence[ProgramStep]], arms: Sequence[str]) -> int | None:
    """Return the index of the step at which a program asks if the other panel says "ready to meet" this arm.

    None if the program does not ask before its first move, or if the other panel never says so.
    """
    sentence = _READY_TEXT + normalised_text(arm)
    is_shown = any(
        sentence in _panel_lines(steps[other], i)
        for other in arms
        if other != arm
        for i in _messages_before_moves(steps[other])
    )
    for i, step in enumerate(steps[arm]):
        if isinstance(step, MoveStep):
            break
        if (
            isinstance(step, MessageStep)
            and step.certain
            and sentence in normalised_text(step.text)
            and is_shown
        ):
            return i
    return None


def _messages_before_moves(steps: Sequence[ProgramStep]) -> Iterable[int]:
    """Yield the indices of the messages before the first move."""
    for i, step in enumerate(steps):
        if isinstance(step, MoveStep):
            return
        if isinstance(step, MessageStep):
            yield i


def _panel_lines(steps: Sequence[ProgramStep], last: int) -> str:
    """Return the letters of the text that the panel shows after the message with index ``last``.

    The text consists of the consecutive line messages up to this one, because a long sentence takes several.
    """
    text, index = "", last
    while index >= 0:
        step = steps[index]
        if not isinstance(step, MessageStep) or step.panel != "line":
            break
        text, index = normalised_text(step.text) + text, index - 1
    return text


@dataclasses.dataclass(frozen=True)
class _ArmProgram:
    """Program of one arm.

    Attributes:
        arm: Name of the arm.
        steps: Steps of the program.
        sections: ERROR and UNDO sections of the program, by (module, procedure).
    """

    arm: str
    steps: Sequence[ProgramStep]
    sections: Sequence[Sections]


class _AutomatonBuilder:
    """Builds the automaton of one program, and collects its faults.

    Attributes:
        drives: Numbers of the wires that the program's outputs drive, by name of the output.
        reads: Numbers of the wires that its inputs read, by name of the input.
        gate: Index of the step that asks whether the other program is ready, or None.
        interval: Interval of each step so far.
        protocol: Whether each step so far belongs to the handshake.
        faults: Faults so far, as (message, step).
    """

    def __init__(
        self,
        program: _ArmProgram,
        wiring: Wiring,
        kind: HandshakeKind,
        gate: int | None,
        max_stop_wait: float,
    ) -> None:
        arm = program.arm
        self.steps = program.steps
        self.drives, self.reads = wiring.drives[arm], wiring.reads[arm]
        self.running_outputs = wiring.running_outputs.get(arm, ())
        self.running_inputs = wiring.running_inputs.get(arm, ())
        self.max_stop_wait = max_stop_wait
        self.kind = kind
        self.gate = gate
        self.actions: list[AutomatonAction] = []
        self.interval: list[int] = []
        self.protocol: list[bool] = []
        self.faults: list[tuple[str, ProgramStep]] = []
        self.ready: dict[str, int] = {}
        """Positions at which the panel says "ready to meet", by the letters of the other arm's name."""
        self.starts: dict[str, int] = {}
        """Positions at which the panel asks to start another program, by the letters of its arm's name."""
        self.covered = 0
        """Remaining sets and waits of a meeting that the last check of the other running wire covers."""
        self.check_timeout: float | None = None
        """Timeout of that check [s]."""
        self.sections = program.sections
        self.resets: dict[tuple[str, str], Levels] = {}
        """Levels that handlers leave on the wires, by module and procedure."""
        self.levels: dict[int, int] = {}
        """Level that the program last set on each wire, by number."""
        self.meeting_count = 0
        """Number of meetings so far."""
        self.last_move: MoveStep | None = None
        """Last move of the current work."""
        self.working: int | None = None
        """Interval of the current work, None if the program does not work."""
        self.holds_low = False
        """Whether the program holds its running wire at 0."""
        self.uncleared = False
        """Whether the running wire rose at the start and no wait has seen the other line at 0 since then."""
        self.operator_asked = False
        """Whether the operator was asked anything, such as whether an earlier run is still active."""

    def run(self) -> None:
        """Process all steps, and end the last work.

        It is a fault if the arm moves after the last meeting, because the other program may have ended then.
        """
        for i, step in enumerate(self.steps):
            self.protocol.append(self._step(i, step))
            self.interval.append(self.meeting_count)
        if self.meeting_count and self.last_move is not None:
            message = "the arm still works when the other program may have ended, which stops this one"
            self._fault(f"{message}; add a meeting after the work", self.last_move)
        self._end_work()

    # ---- steps ----

    def _step(self, i: int, step: ProgramStep) -> bool:
        """Process the step with index ``i``, and return whether it belongs to the handshake.

        Moves, changes of outputs without a wire, branches, waits without an input, messages with a question,
        and changes of loads are work. Any other step that is not part of the handshake has no effect here,
        apart from messages that ask for the other program or say that this one is ready.
        """
        match step:
            case SignalStep() if step.signal.lower() in self.drives:
                self._set(i, step)
                return True
            case WaitStep() if step.signal and step.signal.lower() in self.running_inputs:
                self._running_wait(i, step)
                return True
            case WaitStep() if step.signal:
                self._wait(i, step)
                return True
            case MessageStep() if i == self.gate:
                self._end_work()
                if counts_as_stopped(step):
                    self._add("pause", 0, 0, i)
                self._add("gate", 0, 0, i)
                return True
            case SettingStep() if step.stops:
                self._end_work()
                self._add("pause", 0, 0, i)
                return True
            case MessageStep() if not step.confirm:
                shown = _panel_lines(self.steps, i)
                if _READY_TEXT in shown:
                    self._end_work()
                    self.ready.setdefault(shown.split(_READY_TEXT, 1)[1], len(self.actions))
                if _START_TEXT in shown:
                    self.starts.setdefault(
                        shown.split(_START_TEXT, 1)[1].split("now", 1)[0], len(self.actions)
                    )
            case SyncStep():
                self._fault(f"{step.kind} cannot synchronise the tasks of two controllers", step)
            case MoveStep():
                self._require_meeting(step, "the arm moves")
                self._start_work(i)
                self.last_move = step
            case SignalStep():
                if step.signal.lower() in (*self.reads, *self.running_inputs):
                    self._fault(f"{step.signal} is an input of this controller; it cannot be switched", step)
                elif step.signal.lower() in self.running_outputs:
                    self._fault(
                        f"{step.signal} says that the program runs; a program must not switch it", step
                    )
                elif step.value:
                    self._require_meeting(step, f"{step.signal} is switched on")
                self._start_work(i)
            case ChoiceStep():
                self._check_branch(step)
                self._start_work(i)
            case WaitStep() | MessageStep() | CarryStep() | LoadStep():
                self.operator_asked |= isinstance(step, MessageStep) and step.certain
                self._start_work(i)
                if isinstance(step, MessageStep) and counts_as_stopped(step):
                    self._add("pause", 0, 0, i)
            case CheckStep():
                self._instant_check(i, step)
                return True
            case RunningStep():
                self._require_dwell(step)
                self.uncleared = step.on and not self.meeting_count
                self.holds_low = not step.on
                return True
            case WatchStep():
                return True
            case _:
                pass
        return False

    def _set(self, i: int, step: SignalStep) -> None:
        """Process the change of the program's line to the other program.

        A meeting begins when the line rises. In a toggle handshake a fall begins a meeting, too, unless it is
        the first setting of the line. In a four-phase handshake a fall is the second half of a meeting.
        """
        wire = self.drives[step.signal.lower()]
        if step.value not in (0.0, 1.0):
            self._fault(f"{step.signal} is set to {step.value:g}; allowed: 0 and 1", step)
        if step.delay:
            self._fault(
                f"{step.signal} is set with a delay of {step.delay:g} s, when the arm may move again", step
            )
        value = int(step.value == 1.0)
        if value and self.uncleared:
            self._fault(
                "no wait checks that the other program's line is 0 after the rise of the running wire", step
            )
        self._end_work()
        previous = self.levels.get(wire)
        if previous == value:
            self._fault(f"{step.signal} is already {value}; the other program sees no change", step)
        if value != previous and (value == 1 or (self.kind == "toggle" and previous is not None)):
            self.meeting_count += 1
        self.levels[wire] = value
        self._require_check(step, value)
        self._add("set", wire, value, i)

    def _wait(self, i: int, step: WaitStep) -> None:
        """Process a wait for an input: that of the other program's line, unless the program has a fault.

        A wait for any other input is a fault, and counts as work.
        """
        if step.signal.lower() not in self.reads:
            wired = ", ".join(sorted(self.reads)) or "none"
            self._fault(f"it waits for {step.signal}, which has no wire; wired: {wired}", step)
            self._start_work(i)
            return
        if step.value not in (0.0, 1.0):
            self._fault(f"it waits for another level of {step.signal} than 0 or 1", step)
        if step.flag and not self._ends_on_timeout(i, step):
            message = f"on a timeout it continues with {step.flag} set; it must stop and end the program"
            self._fault(message, step)
        self.uncleared = self.uncleared and step.value != 0.0
        self._end_work()
        check_timeout = self.check_timeout
        self._require_check(step, int(step.value == 1.0))
        if check_timeout is not None and step.seconds is not None and check_timeout > step.seconds:
            message = (
                f"{check_timeout:g} s for the other program to run, {step.seconds:g} s for the meeting itself"
            )
            self._fault(f"{message}; the check of the running wire must not take longer", step)
        self._add("wait", self.reads[step.signal.lower()], int(step.value == 1.0), i)

    def _running_wait(self, i: int, step: WaitStep) -> None:
        """Process a wait for the other program's running wire.

        A wait for level 1 checks that the other program runs. It covers the sets and waits of the meeting
        that follows (``covered``), which need such a check. A wait for level 0 is allowed only before the
        first meeting.
        """
        if step.value not in (0.0, 1.0):
            self._fault(f"it waits for another level of {step.signal} than 0 or 1", step)
        if step.flag and not self._ends_on_timeout(i, step):
            message = f"on a timeout it continues with {step.flag} set; it must stop and end the program"
            self._fault(message, step)
        if step.seconds is None:
            self._fault(f"the wait for {step.signal} has no timeout; add one", step)
        elif step.value == 0.0 and step.seconds > self.max_stop_wait + 1e-6:
            message = (
                f"{step.seconds:g} s for the other program to be stopped; allowed: {self.max_stop_wait:g} s"
            )
            self._fault(message, step)
        if step.value == 0.0 and self.meeting_count:
            self._fault(f"after the first meeting it waits for {step.signal} to be 0", step)
        self._end_work()
        running = step.value == 1.0
        # a set and a wait for each phase: two phases, or one of a toggle handshake
        self.covered = (4 if self.kind == "four_phase" else 2) if running else 0
        self.check_timeout = step.seconds if running else None
        self._add("look", 0, int(running), i)

    def _instant_check(self, i: int, step: CheckStep) -> None:
        """Process a check of the other program's line and running wire; the program ends if it fails.

        If it also requires that the program's own running wire is 1, it covers the meeting that follows.
        """
        line, runs = step.signal.lower(), step.runs.lower()
        if line not in self.reads or runs not in self.running_inputs:
            self._fault(
                f"it checks {step.signal} and {step.runs}, which are not the wires from the other program",
                step,
            )
            return
        self._end_work()
        self.covered = 4 if step.own_level else 0
        self.check_timeout = None
        self._add("look", 0, 1, i)
        self._add("wait", self.reads[line], step.value, i)

    def _require_check(self, step: ProgramStep, value: int) -> None:
        """Record a fault if no check of the other program's running wire covers this set or wait.

        Before the first meeting a set or wait of level 0 needs no check, because it only resets the lines.
        """
        if self.covered:
            self.covered -= 1
        elif self.meeting_count or value:
            self._fault("nothing checks before this meeting that the other program runs", step)
        if not self.covered:
            self.check_timeout = None

    def _require_meeting(self, step: ProgramStep, what: str) -> None:
        """Record a fault if a step is before the first meeting. The clause ``what`` says what it does."""
        if not self.meeting_count:
            self._fault(f"{what} before the first meeting, before which the running wires are checked", step)

    def _require_dwell(self, step: RunningStep) -> None:
        """Record a fault if the running wire rises too soon after the start of the program.

        The program must wait for ``MIN_SETTLING_TIME_S`` before the first rise, so that the other one sees
        the wire at 0.
        """
        if step.on and not self.meeting_count and step.waited < MIN_SETTLING_TIME_S:
            detail = (
                f"{step.waited:g} s before the running wire rises at the start; at least: "
                f"{MIN_SETTLING_TIME_S:g} s"
            )
            self._fault(f"the program waits {detail}, so that the other one sees it low", step)

    def _ends_on_timeout(self, i: int, step: WaitStep) -> bool:
        """Return whether the step after a wait ends the program on a timeout, without motion before that.

        This step must be a branch on the wait's flag. It may show texts and change settings and outputs, and
        its last step must be EXIT.
        """
        next_step = self.steps[i + 1] if i + 1 < len(self.steps) else None
        if not isinstance(next_step, ChoiceStep):
            return False
        condition = normalised_text(next_step.condition)
        if condition not in (normalised_text(step.flag), normalised_text(step.flag) + "true"):
            return False
        last_step = next_step.steps[-1]
        without_motion = all(
            isinstance(inside, MessageStep | SettingStep | SignalStep) for inside in next_step.steps
        )
        return without_motion and isinstance(last_step, SettingStep) and last_step.kind == "EXIT"

    def _check_branch(self, step: ChoiceStep) -> None:
        """Record the faults of a branch, whose steps depend on a condition that is known at run time only.

        Such steps may neither set a line or a running wire to the other program, nor wait for an input.
        """
        for inside in step.steps:
            if isinstance(inside, ChoiceStep):
                self._check_branch(inside)
            elif isinstance(inside, SignalStep) and inside.signal.lower() in self.drives:
                self._fault(f"whether {inside.signal} is set is known at run time only", inside)
            elif isinstance(inside, SignalStep) and inside.signal.lower() in self.running_outputs:
                self._fault(
                    f"{inside.signal} says that the program runs; a program must not switch it", inside
                )
            elif isinstance(inside, WaitStep) and inside.signal:
                self._fault(f"whether it waits for {inside.signal} is known at run time only", inside)

    # ---- actions ----

    def _start_work(self, i: int) -> None:
        """Begin the work of the current interval, unless the program works already."""
        # a check before the work does not cover the meeting after it
        self.covered = 0
        self.check_timeout = None
        if self.working is None:
            self.working = self.meeting_count
            self._add("go", 0, self.meeting_count, i)

    def _end_work(self) -> None:
        """End the current work, if there is any.

        It is a fault if the last move of the work does not end in a stop: the handshake that follows might
        run before the arm has arrived.
        """
        if self.working is None:
            return
        if self.last_move is not None and not self.last_move.zone.fine:
            message = (
                f"{self.last_move.zone_name} precedes a handshake, which may run before the arm is there"
            )
            self._fault(message, self.last_move)
        self._add("done", 0, self.working, self.actions[-1].line)
        self.working = None
        self.last_move = None

    def _add(self, kind: str, wire: int, value: int, i: int) -> None:
        """Append the action of step ``i``.

        It is a fault if the action uses a wire before the operator was asked whether the other controller
        still runs an earlier program. No question is necessary while the program holds its running wire at 0.
        """
        step = self.steps[i]
        if kind in ("set", "wait", "look") and not (self.operator_asked or self.holds_low):
            message = (
                "the operator is not asked before whether the other controller still runs an earlier program"
            )
            self._fault(message, step)
            self.operator_asked = True
        self.actions.append(AutomatonAction(kind, wire, value, self._handler_levels(step), i))  # type: ignore[arg-type]

    def _handler_levels(self, step: ProgramStep) -> Levels:
        """Return the levels that the ERROR and UNDO sections of a step's procedure leave on the wires.

        The model checker needs them, because a program may stop by an error at any step. Each procedure is
        evaluated once. It is a fault if a section switches the running wire.
        """
        key = (step.module, step.procedure)
        if key not in self.resets:
            signals = [
                signal
                for table in self.sections
                for signal in _all_steps(table.get(key, ()))
                if isinstance(signal, SignalStep)
            ]
            for signal in signals:
                if signal.signal.lower() in self.running_outputs:
                    self._fault(
                        f"{signal.signal} says that the program runs; a handler must not switch it", signal
                    )
            self.resets[key] = tuple(
                (self.drives[signal.signal.lower()], int(signal.value == 1.0))
                for signal in signals
                if signal.signal.lower() in self.drives
            )
        return self.resets[key]

    def _fault(self, message: str, step: ProgramStep) -> None:
        self.faults.append((message, step))


def _all_steps(steps: Iterable[ProgramStep]) -> Iterable[ProgramStep]:
    """Yield steps, and those inside branches and loops after them."""
    for step in steps:
        yield step
        if isinstance(step, ChoiceStep):
            yield from _all_steps(step.steps)


def intervals(
    readings: Mapping[str, ProgramAutomaton], steps: Mapping[str, Sequence[ProgramStep]]
) -> list[dict[str, list[ProgramStep]]]:
    """Return for each interval the steps of each program, by arm, without those of the handshake.

    The result is empty if the programs have different numbers of meetings.

    Args:
        readings: Automata of the programs, by arm.
        steps: Steps of the programs, by arm.
    """
    counts = {(reading.interval[-1] if reading.interval else 0) for reading in readings.values()}
    if len(counts) != 1:
        return []
    out: list[dict[str, list[ProgramStep]]] = [{arm: [] for arm in readings} for _ in range(counts.pop() + 1)]
    for arm, reading in readings.items():
        for step, interval, protocol in zip(steps[arm], reading.interval, reading.protocol, strict=True):
            if not protocol:
                out[interval][arm].append(step)
    return out
