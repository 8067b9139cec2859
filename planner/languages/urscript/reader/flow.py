"""The straight way of a URScript program: settings put into moves, names replaced by values.

There is one way: the only branches end the program. The first statements look whether the controller
moves the planned arm. A straight move takes its time t, whatever else; its blend radius r bounds how
far from its target the way may leave the straight lines, and 0 is an exact stop.

A program that meets another controller's has three functions and a thread, which end it as they have to
be: the own running wire and all that it has switched on go off before. All of them read that wire back,
which stays low behind a pause. Questions stand between its fall and its rise; nothing else switches it.

A torch that has a thread burns from its output's rise on, at rest; behind the wait for its input and a pause
the thread begins, and only straight moves stand between that and its end, with which the output falls.
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
from planner.languages.urscript.reader.torches import Torches
from planner.programs import steps
from planner.programs.handshake.moves import SLOW

MAIN_PROCEDURE: Final = "main"
"""What the program is called in steps outside of its segments: its own name is the problem's."""
LOOK_KIND: Final = "get_forward_kin"
"""Kind of the step that looks whether the controller moves the planned arm; its values are joints, the point
of the flange and its place as poses, and the distance allowed."""
SETTLED: Final = 0.1
"""How long [s] a program stands behind the rise of its running wire, so that it reads it back as it is."""
_EXACT_STOP: Final = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_AXES: Final = np.zeros(6)
"""Values of external axes, of which there are none."""


@dataclass(frozen=True)
class Wires:
    """Names of a controller's outputs and inputs by number; of one that another one stands beside (`other`,
    else empty) its output to that one and its running wire."""

    outputs: Mapping[int, str]
    inputs: Mapping[int, str]
    other: str = ""
    line: str = ""
    running: str = ""


def flow(
    text: ScriptText, base: FloatArray, wires: Wires, arm: str, model: str, velocity: FloatArray
) -> tuple[steps.Step, ...]:
    """Steps of a program without faults. ``base`` (4, 4): the controller's base in the world; ``arm``,
    ``model``: names of arm and robot; ``velocity`` (6,) [rad/s] of its axes. Raises `FlowError`."""
    if text.program is None:
        return ()
    return _Runner(
        text.program, base, wires, urscript_sentences.OTHER_ARM.filled(arm=arm, model=model), velocity
    ).run()


class _Runner:
    def __init__(
        self, program: syntax_tree.Program, base: FloatArray, wires: Wires, other: str, velocity: FloatArray
    ) -> None:
        self.program, self.base, self.wires = program, base, wires
        self.other, self.velocity = other, velocity
        self.steps: list[steps.Step] = []
        self.procedure = MAIN_PROCEDURE
        self.tool_name = ""
        self.load: steps.Load | None = None
        self.tools: dict[tuple[str, int], steps.Tool] = {}
        self.works: dict[str, steps.WorkObject] = {}
        self.looked = self.moved = self.reading = False
        self.load_line = 0
        self.meets = bool(program.endings)
        self.low: syntax_tree.Output | None = None
        """Where the running wire has fallen for a question that is still open."""
        self.asked = self.watched = self.stays_low = self.rose = self.unwatched = False
        self.waited = 0.0
        self.torches = Torches(program, self._fail, self._output, self._input)

    def run(self) -> tuple[steps.Step, ...]:
        if self.meets:
            self._endings()
        self.torches.begin()
        for statement in self.program.body:
            if isinstance(statement, syntax_tree.Begins):
                self.procedure = statement.label
                continue
            if self.reading and not (isinstance(statement, syntax_tree.Popup) and statement.kind != "note"):
                self._fail(statement, "a text that is to be read before a question, and no question follows")
            if not isinstance(statement, syntax_tree.Straight | syntax_tree.Stand):
                self.procedure = MAIN_PROCEDURE
            self.torches.take(statement)
            if not (self.meets and self._runs_or_not(statement)):
                self._statement(statement)
        if self.reading:
            self._fail(self.program.body[-1], "a text that is to be read before a question, and none follows")
        self.torches.end(self.program.body[-1])
        if self.low is not None or self.rose:
            last = self.low or self.program.body[-1]
            self._fail(last, "the running wire falls for a question, and does not rise and settle behind it")
        return tuple(self.steps)

    def _fail(self, statement: syntax_tree.Statement, message: str) -> NoReturn:
        raise steps.FlowError([steps.Fault(statement.line, 1, "urscript.flow", message, self.program.file)])

    def _where(self, statement: syntax_tree.Statement) -> tuple[str, str, int, str]:
        return self.program.file.rpartition("/")[2], self.procedure, statement.line, ""

    def _statement(self, statement: syntax_tree.Statement) -> None:
        where = self._where(statement)
        match statement:
            case syntax_tree.SetTcp(name=name):
                self.tool_name, self.load = name, None
            case syntax_tree.SetPayload(mass=mass, centre=centre):
                if not self.tool_name:
                    self._fail(statement, "a payload before any tool")
                axes = np.array([1.0, 0.0, 0.0, 0.0])
                self.load, self.load_line = (
                    steps.Load(mass, np.array(centre), axes, np.zeros(3)),
                    statement.line,
                )
            case syntax_tree.Output(number=number, value=on):
                if on and not self.looked:
                    self._fail(statement, "an output is on before the program has looked at the arm")
                name = self._output(number)
                self.steps.append(steps.SignalStep(*where, "set_digital_out", name, float(on), 0.0, True))
            case syntax_tree.Pause(seconds=seconds):
                self.steps.append(steps.WaitStep(*where, "sleep", seconds, "", None, True))
            case syntax_tree.Popup(kind=kind, text=text):
                asks = kind == "question"
                self.reading = kind == "read"
                if self.meets and kind != "note" and self.low is None:
                    self._fail(statement, "a popup holds the program while its running wire is high")
                self.asked |= asks
                panel: Literal["line", ""] = "" if asks else "line"
                falls = self.meets and asks
                step = steps.MessageStep(*where, "popup", (text,), asks, text, asks, panel, stands=falls)
                self.steps.append(step)
            case syntax_tree.Look():
                self._look(statement)
            case syntax_tree.StaysLow(number=number) if self.torches.watches(number):
                if any(isinstance(step, steps.SignalStep) for step in self.steps):
                    what = "the program looks whether a torch stays on behind what it has switched"
                    self._fail(statement, what)
            case syntax_tree.StaysLow(number=number, off=off, text=text):
                wanted = urscript_sentences.STAYS_ON.filled(signal=self.wires.running)
                if not self.meets or not self._runs(number) or text != wanted:
                    self._fail(
                        statement, "a look at an output that is not the own running wire's, or its text"
                    )
                if off != (number,):
                    what = (
                        f"{self.wires.running} has to go off, and nothing else, where it is found to stay on"
                    )
                    self._fail(statement, what)
                if self.stays_low:
                    self._fail(statement, "the program looks again whether its running wire stays high")
                self.stays_low = True
            case syntax_tree.Await(name=name, value=value, seconds=seconds):
                ending = self.program.endings.get(name)
                if ending is None:
                    self._fail(statement, f"there is no function {name}")
                given = self._input(ending.numbers[0])
                self.steps.append(steps.WaitStep(*where, name, seconds, given, float(value), True))
            case syntax_tree.AwaitArc(name=name, seconds=seconds):
                given = self._input(self.program.torches[name].given or 0)
                self.steps.append(steps.WaitStep(*where, name, seconds, given, 1.0, True))
            case syntax_tree.GuardArc(name=name, on=on):
                thread = self.program.torches[name]
                given = "" if thread.given is None else self._input(thread.given)
                own = self._output(-1 if thread.own is None else thread.own)
                self.steps.append(steps.GuardStep(*where, own, given, thread.stood, thread.far, on))
            case syntax_tree.Check(value=value, own=own):
                ending = self.program.endings.get(syntax_tree.CHECK)
                if ending is None:
                    self._fail(statement, f"there is no function {syntax_tree.CHECK}")
                line, runs = map(self._input, ending.numbers)
                self.steps.append(steps.CheckStep(*where, line, int(value), runs, own))
            case syntax_tree.Watch(on=on):
                self._watch(statement, on)
            case syntax_tree.Joint():
                self._joint(statement)
            case syntax_tree.Straight():
                self._straight(statement)
            case syntax_tree.Stand():
                self._stand(statement)

    def _look(self, look: syntax_tree.Look) -> None:
        if self.looked or self.moved:
            self._fail(look, "the program looks at the arm elsewhere than before it moves")
        if look.text != self.other:
            self._fail(look, f"the arm is looked at with the text {look.text!r}; wanted: {self.other!r}")
        values = (*self.program.data[look.name].value, *look.tip, *look.place, look.most)
        self.steps.append(steps.SettingStep(*self._where(look), LOOK_KIND, (), values))
        self.looked = True

    # ---- the other controller ----

    def _output(self, number: int) -> str:
        return self.wires.outputs.get(number, f"output {number}")

    def _input(self, number: int) -> str:
        return self.wires.inputs.get(number, f"input {number}")

    def _runs(self, number: int) -> bool:
        """Whether an output is the own running wire's."""
        return self._output(number).lower() == self.wires.running.lower()

    def _endings(self) -> None:
        """The functions and the thread are there, read the own running wire back, and switch off what has to
        be off where a program ends."""
        found, wires = self.program.endings, self.wires
        first = next(iter(found.values()))
        missing = [
            name
            for name in (
                syntax_tree.AWAIT_LINE,
                syntax_tree.AWAIT_RUNNING,
                syntax_tree.CHECK,
                syntax_tree.WATCH,
                syntax_tree.STAND,
            )
            if name not in found
        ]
        if missing or not wires.other:
            what = (
                f"{', '.join(missing)} is missing" if missing else "there is no other controller to wait for"
            )
            self._fail(first, what)
        switched = (s.number for s in self.program.body if isinstance(s, syntax_tree.Output) and s.value)
        on = {self._output(number).lower() for number in switched} - {wires.line.lower()}
        for name, ending in found.items():
            if name == syntax_tree.STAND:
                continue  # it ends nothing
            if not self._runs(ending.own):
                self._fail(ending, f"{name} reads {self._output(ending.own)} back, not {wires.running}")
            lost = urscript_sentences.PARTNER_LOST if name == syntax_tree.WATCH else sentences.UNANSWERED
            wanted = lost.filled(other=wires.other)
            if ending.text != wanted:
                self._fail(ending, f"{name} shows {ending.text!r}; wanted: {wanted!r}")
            off = [self._output(number).lower() for number in ending.off]
            if off[:1] != [wires.running.lower()]:
                self._fail(ending, f"{name} does not take {wires.running} back before all else")
            if left := sorted(on - set(off)):
                self._fail(ending, f"{name} leaves {', '.join(left)} on")
            if wires.line.lower() in off:
                self._fail(
                    ending, f"{name} switches {wires.line}, which the other program would take for an arrival"
                )

    def _runs_or_not(self, statement: syntax_tree.Statement) -> bool:
        """Take the running wire's fall before a question, what may stand while it is low, and its rise and
        settling; whether the statement is no more than that."""
        if self.rose:
            if not isinstance(statement, syntax_tree.Pause) or statement.seconds != SETTLED:
                self._fail(statement, f"behind the rise of the running wire sleep({SETTLED}) must stand")
            self.rose, self.unwatched = False, True
            return True
        if self.unwatched and isinstance(statement, syntax_tree.Pause):
            self._fail(
                statement, "the program waits behind the rise of its running wire, and watches nothing"
            )
        own = isinstance(statement, syntax_tree.Output) and self._runs(statement.number)
        self.unwatched = self.unwatched and not (
            own or isinstance(statement, syntax_tree.Watch | syntax_tree.Await)
        )
        if self.low is None:
            if not own or not isinstance(statement, syntax_tree.Output) or statement.value:
                return False
            if not self.stays_low:
                what = "nothing looks before whether the running wire stays high without a program"
                self._fail(statement, what)
            self.low, self.asked, self.waited = statement, False, 0.0
            self.steps.append(steps.RunningStep(*self._where(statement), False))
            return True
        match statement:
            case syntax_tree.Output(value=True) if own and self.asked:
                self.steps.append(steps.RunningStep(*self._where(statement), True, self.waited))
                self.low, self.rose = None, True
                return True
            case syntax_tree.Pause(seconds=seconds) if self.asked:
                self.waited += seconds
                if self.waited > SLOW:  # what is longer the model of both programs does not know
                    self._fail(
                        statement, f"more than {SLOW} s between a look and the rise of the running wire"
                    )
                return True
            case syntax_tree.Popup() | syntax_tree.Check(own=False):
                self.waited = 0.0
                return False
        line = (
            isinstance(statement, syntax_tree.Output)
            and not statement.value
            and self._is_line(statement.number)
        )
        if not line or self.asked:
            self._fail(statement, "something else than a question while the running wire is low")
        return False

    def _is_line(self, number: int) -> bool:
        return self._output(number).lower() == self.wires.line.lower()

    def _watch(self, statement: syntax_tree.Statement, on: bool) -> None:
        if on == self.watched:
            what = "the thread that watches the other program "
            self._fail(statement, what + ("runs already" if on else "does not run"))
        ending = self.program.endings.get(syntax_tree.WATCH)
        if ending is None:
            self._fail(statement, f"there is no thread {syntax_tree.WATCH}")
        self.watched = on
        self.steps.append(steps.WatchStep(*self._where(statement), self._input(ending.numbers[0]), on))

    # ---- moves ----

    def _joint(self, move: syntax_tree.Joint) -> None:
        target = steps.JointTarget(np.array(self.program.data[move.name].value), _NO_AXES)
        share = tuple(float(move.speed / most) for most in self.velocity)
        speed = steps.Speed(math.inf, math.inf, 0.0, 0.0, share)
        where = steps.WorkObject(False, True, "", self.base, np.eye(4)), ""
        self._move(move, target, move.name, None, speed, _EXACT_STOP, where, move.acceleration)

    def _straight(self, move: syntax_tree.Straight) -> None:
        if not self.moved:
            self._fail(move, "movel begins nowhere; movej to joints first")
        turn = to_quaternion(exp_rotation(np.array(move.place[3:])))
        target = steps.RobTarget(np.array(move.place[:3]), turn, None, _NO_AXES)
        stop = move.radius == 0.0
        zone = _EXACT_STOP if stop else steps.Zone(False, move.radius, 0.0, 0.0, 0.0, 0.0, 0.0)
        speed = steps.Speed(math.inf, math.inf, 0.0, 0.0)
        self._move(move, target, "", move.seconds, speed, zone, (self._work(move.frame), move.frame))

    def _stand(self, stand: syntax_tree.Stand) -> None:
        """The arm's part of a move in which only the other one moves."""
        last = next((step for step in reversed(self.steps) if isinstance(step, steps.MoveStep)), None)
        if (
            syntax_tree.STAND not in self.program.endings
            or last is None
            or not isinstance(last.target, steps.RobTarget)
        ):
            self._fail(stand, f"{syntax_tree.STAND} stands for a move behind a movel")
        where = last.wobj, last.wobj_name
        self._move(stand, last.target, "", stand.seconds, last.speed, _EXACT_STOP, where)

    def _work(self, name: str) -> steps.WorkObject:
        if name not in self.works:
            seen = pose(self.program.data[name].value)
            self.works[name] = steps.WorkObject(False, True, "", self.base, seen)
        return self.works[name]

    def _tool(self, statement: syntax_tree.Statement) -> steps.Tool:
        if self.load is None:
            self._fail(statement, "an arm moves before set_tcp and set_payload behind it have said its tool")
        key = self.tool_name, self.load_line
        if key not in self.tools:
            self.tools[key] = steps.Tool(True, pose(self.program.data[self.tool_name].value), self.load)
        return self.tools[key]

    def _move(
        self,
        move: syntax_tree.Joint | syntax_tree.Straight | syntax_tree.Stand,
        target: steps.JointTarget | steps.RobTarget,
        name: str,
        time: float | None,
        speed: steps.Speed,
        zone: steps.Zone,
        work: tuple[steps.WorkObject, str],
        acceleration: float | None = None,
    ) -> None:
        if not self.looked:
            self._fail(move, "an arm moves before the program has looked whether it is the planned one")
        tool = self._tool(move)
        kind = {
            syntax_tree.Joint: "movej",
            syntax_tree.Straight: "movel",
            syntax_tree.Stand: syntax_tree.STAND,
        }[type(move)]
        stop = "an exact stop" if zone.fine else f"r={zone.tcp:g}"
        self.steps.append(
            steps.MoveStep(
                *(*self._where(move), kind, target, name, None, time, None, speed, zone, stop),
                *(tool, self.tool_name, *work, ()),
                acceleration,
            )
        )
        self.moved = True
