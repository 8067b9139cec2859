"""The straight way of a URScript program: settings put into moves, names replaced by values.

There is one way: the only branch ends the program. The first statements look whether the controller
moves the planned arm. A straight move takes its time t, whatever else; its blend radius r bounds how
far from its target the way may leave the straight lines, and 0 is an exact stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NoReturn

import numpy as np

from planner.claims import vocabulary
from planner.geometry.arrays import FloatArray, exp_rotation, to_quaternion
from planner.verify.programs.steps import (
    Fault,
    FlowError,
    JointTarget,
    Load,
    MessageStep,
    MoveStep,
    RobTarget,
    SettingStep,
    SignalStep,
    Speed,
    Step,
    Tool,
    WaitStep,
    WorkObject,
    Zone,
)
from planner.verify.urscript.reader import ScriptText, pose
from planner.verify.urscript.syntax_tree import (
    Begins,
    Joint,
    Look,
    Output,
    Pause,
    Popup,
    Program,
    SetPayload,
    SetTcp,
    Statement,
    Straight,
)

MAIN_PROCEDURE: Final = "main"
"""What the program is called in steps outside of its segments: its own name is the problem's."""
LOOK_KIND: Final = "get_forward_kin"
"""Kind of the step that looks whether the controller moves the planned arm; its values are joints, the point
of the flange and its place as poses, and the distance allowed."""
_EXACT_STOP: Final = Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_AXES: Final = np.zeros(6)
"""Values of external axes, of which there are none."""


def flow(
    text: ScriptText, base: FloatArray, outputs: Mapping[int, str], arm: str, model: str, velocity: FloatArray
) -> tuple[Step, ...]:
    """Steps of a program without faults. ``base`` (4, 4): the controller's base in the world; ``outputs``:
    names by number; ``arm``, ``model``: names of arm and robot; ``velocity`` (6,) [rad/s] of its axes. Raises
    `FlowError`."""
    if text.program is None:
        return ()
    return _Runner(
        text.program, base, outputs, vocabulary.OTHER_ARM.filled(arm=arm, model=model), velocity
    ).run()


class _Runner:
    def __init__(
        self, program: Program, base: FloatArray, outputs: Mapping[int, str], other: str, velocity: FloatArray
    ) -> None:
        self.program, self.base, self.outputs = program, base, outputs
        self.other, self.velocity = other, velocity
        self.steps: list[Step] = []
        self.procedure = MAIN_PROCEDURE
        self.tool_name = ""
        self.load: Load | None = None
        self.tools: dict[tuple[str, int], Tool] = {}
        self.works: dict[str, WorkObject] = {}
        self.looked = self.moved = self.reading = False
        self.load_line = 0

    def run(self) -> tuple[Step, ...]:
        for statement in self.program.body:
            if isinstance(statement, Begins):
                self.procedure = statement.label
                continue
            if self.reading and not (isinstance(statement, Popup) and statement.kind != "note"):
                self._fail(statement, "a text that is to be read before a question, and no question follows")
            if not isinstance(statement, Straight):
                self.procedure = MAIN_PROCEDURE
            self._statement(statement)
        if self.reading:
            self._fail(self.program.body[-1], "a text that is to be read before a question, and none follows")
        return tuple(self.steps)

    def _fail(self, statement: Statement, message: str) -> NoReturn:
        raise FlowError([Fault(statement.line, 1, "urscript.flow", message, self.program.file)])

    def _where(self, statement: Statement) -> tuple[str, str, int, str]:
        return self.program.file.rpartition("/")[2], self.procedure, statement.line, ""

    def _statement(self, statement: Statement) -> None:
        where = self._where(statement)
        match statement:
            case SetTcp(name=name):
                self.tool_name, self.load = name, None
            case SetPayload(mass=mass, centre=centre):
                if not self.tool_name:
                    self._fail(statement, "a payload before any tool")
                axes = np.array([1.0, 0.0, 0.0, 0.0])
                self.load, self.load_line = Load(mass, np.array(centre), axes, np.zeros(3)), statement.line
            case Output(number=number, value=on):
                if on and not self.looked:
                    self._fail(statement, "an output is on before the program has looked at the arm")
                name = self.outputs.get(number, f"output {number}")
                self.steps.append(SignalStep(*where, "set_digital_out", name, float(on), 0.0, True))
            case Pause(seconds=seconds):
                self.steps.append(WaitStep(*where, "sleep", seconds, "", None, True))
            case Popup(kind=kind, text=text):
                asks = kind == "question"
                self.reading = kind == "read"
                panel = "" if asks else "line"
                self.steps.append(MessageStep(*where, "popup", (text,), asks, text, asks, panel))  # type: ignore[arg-type]
            case Look():
                self._look(statement)
            case Joint():
                self._joint(statement)
            case Straight():
                self._straight(statement)

    def _look(self, look: Look) -> None:
        if self.looked or self.moved:
            self._fail(look, "the program looks at the arm elsewhere than before it moves")
        if look.text != self.other:
            self._fail(look, f"the arm is looked at with the text {look.text!r}; wanted: {self.other!r}")
        values = (*self.program.data[look.name].value, *look.tip, *look.place, look.most)
        self.steps.append(SettingStep(*self._where(look), LOOK_KIND, (), values))
        self.looked = True

    # ---- moves ----

    def _joint(self, move: Joint) -> None:
        target = JointTarget(np.array(self.program.data[move.name].value), _NO_AXES)
        share = tuple(float(move.speed / most) for most in self.velocity)
        speed = Speed(math.inf, math.inf, 0.0, 0.0, share)
        where = WorkObject(False, True, "", self.base, np.eye(4)), ""
        self._move(move, target, move.name, None, speed, _EXACT_STOP, where, move.acceleration)

    def _straight(self, move: Straight) -> None:
        if not self.moved:
            self._fail(move, "movel begins nowhere; movej to joints first")
        turn = to_quaternion(exp_rotation(np.array(move.place[3:])))
        target = RobTarget(np.array(move.place[:3]), turn, None, _NO_AXES)
        stop = move.radius == 0.0
        zone = _EXACT_STOP if stop else Zone(False, move.radius, 0.0, 0.0, 0.0, 0.0, 0.0)
        speed = Speed(math.inf, math.inf, 0.0, 0.0)
        self._move(move, target, "", move.seconds, speed, zone, (self._work(move.frame), move.frame))

    def _work(self, name: str) -> WorkObject:
        if name not in self.works:
            seen = pose(self.program.data[name].value)
            self.works[name] = WorkObject(False, True, "", self.base, seen)
        return self.works[name]

    def _tool(self, statement: Statement) -> Tool:
        if self.load is None:
            self._fail(statement, "an arm moves before set_tcp and set_payload behind it have said its tool")
        key = self.tool_name, self.load_line
        if key not in self.tools:
            self.tools[key] = Tool(True, pose(self.program.data[self.tool_name].value), self.load)
        return self.tools[key]

    def _move(
        self,
        move: Joint | Straight,
        target: JointTarget | RobTarget,
        name: str,
        time: float | None,
        speed: Speed,
        zone: Zone,
        work: tuple[WorkObject, str],
        acceleration: float | None = None,
    ) -> None:
        if not self.looked:
            self._fail(move, "an arm moves before the program has looked whether it is the planned one")
        tool = self._tool(move)
        kind = "movej" if isinstance(move, Joint) else "movel"
        stop = "an exact stop" if zone.fine else f"r={zone.tcp:g}"
        self.steps.append(
            MoveStep(
                *(*self._where(move), kind, target, name, None, time, None, speed, zone, stop),
                *(tool, self.tool_name, *work, ()),
                acceleration,
            )
        )
        self.moved = True
