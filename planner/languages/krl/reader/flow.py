"""The straight way of one KRL program through its files: settings put into moves, names replaced by values.

The subset has no conditions but the guarded wait, so there is one way. Settings are modal; what a program has
not stated itself behind BAS(#INITMOV,0) is not known, and no move may depend on it.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, NoReturn

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.reader import syntax_tree
from planner.languages.krl.reader.panel import Panel, PanelError
from planner.languages.krl.reader.values import NO_LOAD, held_load, quaternion
from planner.programs import steps
from planner.programs.signals import Signals

MAX_CALLS = 10
"""Programs that call each other may be so deep."""
MOST_STATEMENTS = 100_000
"""Statements that may run more than once; programs call each other seldom."""
MAIN_PROCEDURE = "main"
"""What the procedure of the main program is called in steps: its own name is the problem's."""
_BLOCK_LOAD = "l_block_"
"""How the loads of a tool together with a block are called."""
_EXACT_STOP = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""At a point without an approximation: the arm stops there."""
_FLY_BY = steps.Zone(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""At a point of a spline block: the arm goes through it without a stop."""
AXIS_LOOK = "$AXIS_ACT"
"""Kind of the step that looks at an external axis: its values are column [from 0], home and most off it
[mm or deg], its one switch is the text that is shown."""
_PRELUDE = (
    (False, "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )"),
    (True, "INTERRUPT ON 3 behind it"),
    (syntax_tree.Start, "BAS(#INITMOV,0) behind it"),
)
"""What the main program begins with, and how faults name it."""
_PRELUDE_REASON = "stop reactions and settings need"
"""Why they are needed, for faults."""
_UNBOUNDED = 1.0
"""A length [m] that is no bound: for a corner that the angle alone decides."""


class _Pose(NamedTuple):
    """A target as the text has it, to know how far the next move goes: X, Y, Z [mm], unit quaternion."""

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class Runner:
    """Runs the main program. `entered`: names of the programs that ran, in lower case."""

    def __init__(
        self,
        programs: Mapping[str, syntax_tree.Program],
        data: syntax_tree.DataList,
        base: FloatArray,
        signals: Signals,
        panel: Panel,
    ) -> None:
        self.programs, self.data, self.base, self.signals = programs, data, base, signals
        self.panel = panel
        self.steps: list[steps.Step] = []
        self.entered: set[str] = set()
        self.settings: dict[str, float | str] = {}
        self.tools: dict[str, steps.Tool] = {}
        self.works: dict[str, steps.WorkObject] = {}
        self.here: _Pose | None = None
        self.outer: syntax_tree.Outer = ()
        self.stood: tuple[float, ...] | None = None
        self.rode: tuple[float, ...] | None = None
        self.on: set[int] = set()
        self.carried = ""
        self.load_line = 0
        self.program: syntax_tree.Program
        self.procedure = MAIN_PROCEDURE
        self.depth = 0
        self.started = False
        self.work = MOST_STATEMENTS + sum(len(program.body) for program in programs.values())
        self._open: list[str] = []

    def run(self, main: syntax_tree.Program) -> tuple[steps.Step, ...]:
        """Steps of the main program. Raises `FlowError`."""
        self.program = main
        self.entered.add(main.name.lower())
        self._open.append(main.name.lower())
        head = [s for s in main.body if not isinstance(s, syntax_tree.Said)][:3]
        for wanted, s in itertools.zip_longest(_PRELUDE, head):
            part = s.on if isinstance(s, syntax_tree.StopInterrupt) else type(s)
            if part != wanted[0]:
                what = f"the main program does not begin with {wanted[1]}, as {_PRELUDE_REASON}"
                self._fail(s.line if s else 1, what)
        self._block(main.body)
        return tuple(self.steps)

    def _fail(self, line: int, message: str) -> NoReturn:
        raise steps.FlowError([steps.Fault(line, 1, "krl.flow", message, self.program.file)])

    def _misplaced(self, line: int, wrong: bool, message: str) -> None:
        """Refuse what stands where the programs do not have it."""
        if wrong:
            self._fail(line, message)

    def _block(self, body: Sequence[syntax_tree.Statement]) -> None:
        for statement in body:
            self.work -= 1
            if self.work < 0:
                self._fail(statement.line, "the programs call each other too often to be read")
            if isinstance(statement, syntax_tree.Straight):
                self._straight(statement)
                continue
            if isinstance(statement, syntax_tree.Spline):
                self._spline(statement)
                continue
            if not isinstance(statement, syntax_tree.Set | syntax_tree.Said):
                self._carry(statement.line)
            self._hear(statement)
            self._statement(statement)
        if not self.depth:
            self._close(body[-1].line if body else 1)

    def _hear(self, statement: syntax_tree.Statement) -> None:
        try:
            self.panel.check(statement, self.depth)
            self._say(statement)
        except PanelError as wrong:
            self._fail(statement.line, str(wrong))

    def _close(self, line: int) -> None:
        """Refuse what the panel still waits for at the end of the main program."""
        try:
            self.panel.check(None, 0)
        except PanelError as wrong:
            self._fail(line, str(wrong))

    def _say(self, statement: syntax_tree.Statement) -> None:
        said = self.panel.take(statement, self.depth)
        if self.on and self.panel.halts(statement):
            self._fail(statement.line, f"the program may halt while $OUT[{min(self.on)}] is on")
        if said is not None:
            where = (self.program.file.rpartition("/")[2], self.procedure, statement.line, "")
            lines = (said.text,)
            self.steps.append(
                steps.MessageStep(*where, said.kind, lines, said.confirm, said.text, said.confirm, said.panel)
            )

    def _statement(self, statement: syntax_tree.Statement) -> None:
        line = statement.line
        where = (self.program.file.rpartition("/")[2], self.procedure, line, "")
        match statement:
            case syntax_tree.Start():
                if self.started or self.depth:
                    self._fail(line, "BAS(#INITMOV,0) stands elsewhere than at the start of the main program")
                self.started = True
                self.steps.append(steps.SettingStep(*where, "BAS(#INITMOV,0)", (), ()))
            case syntax_tree.Set(name=name, value=value):
                self._set(line, name, value)
            case syntax_tree.Said(kind="segment", text=text):
                self.procedure = text
            case syntax_tree.StopInterrupt():
                what = "the interrupt of stop messages stands elsewhere than at the start"
                self._misplaced(line, bool(self.steps) or self.depth > 0, what)
            case syntax_tree.Halt() if self.panel.dialect == "krc4":
                self.steps.append(steps.SettingStep(*where, "HALT", (), (), stops=True))
            case syntax_tree.Foot():
                self.steps.append(steps.SettingStep(*where, "$ROBROOT", (), ()))
            case syntax_tree.AxisLook(column=column, home=home, most=most, text=text):
                self.steps.append(steps.SettingStep(*where, AXIS_LOOK, (text,), (column, home, most)))
            case syntax_tree.Output(number=number, value=on):
                self.on = self.on | {number} if on else self.on - {number}
                name = self.signals.outputs.get(number, f"$OUT[{number}]")
                self.steps.append(steps.SignalStep(*where, "$OUT", name, float(on), 0.0, True))
            case syntax_tree.Listen(number=number, value=on, seconds=seconds):
                name = self.signals.inputs.get(number, f"$IN[{number}]")
                self.steps.append(
                    steps.WaitStep(*where, "WHILE", seconds, name, float(on), False, again=True)
                )
            case syntax_tree.Await():
                self._await(statement, where)
            case syntax_tree.Pause(seconds=seconds) if self._moving:
                self._stand(line, seconds)
            case syntax_tree.Pause(seconds=seconds):
                self.steps.append(steps.WaitStep(*where, "WAIT SEC", seconds, "", None, True))
            case syntax_tree.Joint(name=name):
                self._joint(line, name)
            case syntax_tree.Call(name=name):
                self._call(line, name)

    def _await(self, wait: syntax_tree.Await, where: tuple[str, str, int, str]) -> None:
        """A wait for an input, behind which everything is off where it was in vain."""
        line = wait.line
        self._misplaced(
            line, self.depth > 0, "a wait for the process stands elsewhere than in the main program"
        )
        if left := self.on - wait.off:
            self._fail(line, f"the program may end while $OUT[{min(left)}] is on")
        name = self.signals.inputs.get(wait.number, f"$IN[{wait.number}]")
        wanted = krl_sentences.NO_INPUT.filled(signal=name, seconds=wait.seconds)
        wanted = wanted if self.panel.dialect == "krc4" else ""
        if steps.letters(wait.text) != steps.letters(wanted):
            self._fail(line, f"a wait that was in vain shows {wait.text!r}; wanted: {wanted!r}")
        if wanted and not self.panel.prepared:
            self._fail(line, "a message, and tm_opt is not set before")
        self.steps.append(steps.WaitStep(*where, "WHILE", wait.seconds, name, float(wait.value), False))

    @property
    def _moving(self) -> bool:
        """Whether a file with moves is being read, in which a wait stands for a move."""
        return self.depth > 0 and self.program.moves > 0

    def _call(self, line: int, name: str) -> None:
        program = self.programs.get(name)
        if program is None or self.depth >= MAX_CALLS or name in self._open:
            what = "is none of the programs" if program is None else "calls itself"
            self._fail(line, f"{name}() {what}")
        here = self.program, self.procedure
        self.entered.add(name)
        self._open.append(name)
        self.program, self.depth = program, self.depth + 1
        if program.moves:
            for setting in syntax_tree.MOTION_SETTINGS:  # each file with moves states its own
                self.settings.pop(setting, None)
        self._block(program.body)
        self._open.pop()
        (self.program, self.procedure), self.depth = here, self.depth - 1

    # ---- settings ----

    def _set(self, line: int, name: str, value: float | str) -> None:
        where = "a file with moves" if name in syntax_tree.MOTION_SETTINGS else "the main program"
        wrong = (name in syntax_tree.MOTION_SETTINGS) != (self.depth > 0)
        self._misplaced(line, wrong, f"{name.upper()} is set elsewhere than in {where}")
        if name in syntax_tree.CHOICE_SETTINGS:
            where_ = (self.program.file.rpartition("/")[2], self.procedure, line, "")
            self.steps.append(steps.SettingStep(*where_, name.upper(), (), ()))
        if name in syntax_tree.FRAME_SETTINGS:
            kind = syntax_tree.FRAME_SETTINGS[name]
            item = self.data.items.get(str(value))
            if item is None or item.kind != kind:
                self._fail(line, f"{value} is no {kind.upper()} of the data list")
            if name == "$load":
                self.load_line = line
            else:
                self.here = None
        self.settings[name] = value

    def _needed(self, line: int, names: Sequence[str]) -> None:
        missing = [name for name in names if name not in self.settings]
        if missing:
            self._fail(line, f"{missing[0].upper()} is not set before this move; set it")

    def _tool(self, line: int) -> tuple[steps.Tool, str]:
        self._needed(line, ("$tool", "$load", *syntax_tree.CHOICE_SETTINGS))
        name = str(self.settings["$tool"])
        if name not in self.tools:
            own = self.data.items.get(_own_load(name))
            if own is None or own.kind != "load":
                self._fail(line, f"the data list has no LOAD {_own_load(name)} for {name}")
            self.tools[name] = steps.Tool(True, self.data.items[name].value, own.value)
        return self.tools[name], self.data.items[name].name

    def _work(self, line: int) -> tuple[steps.WorkObject, str]:
        self._needed(line, ("$base",))
        name = str(self.settings["$base"])
        if name not in self.works:
            self.works[name] = steps.WorkObject(False, True, "", self.base, self.data.items[name].value)
        return self.works[name], self.data.items[name].name

    def _carry(self, line: int) -> None:
        """A step where the load is another one than before: the tool's own, or one of the tool with what it
        holds."""
        if "$tool" not in self.settings or "$load" not in self.settings:
            return
        tool, load = str(self.settings["$tool"]), str(self.settings["$load"])
        carried = "" if load == _own_load(tool) else load
        if carried == self.carried:
            return
        if carried and not carried.startswith(_BLOCK_LOAD):
            self._fail(self.load_line, f"{load} is neither the load of {tool} nor one of it with a block")
        mine, _ = self._tool(line)
        whole: steps.Load = self.data.items[load].value
        found = held_load(whole, mine.load, mine.pose) if carried else NO_LOAD
        where = (self.program.file.rpartition("/")[2], self.procedure, self.load_line, "")
        self.steps.append(steps.CarryStep(*where, found, load))
        self.carried = carried

    # ---- moves ----

    def _joint(self, line: int, name: str) -> None:
        self._misplaced(line, self.depth > 0, "PTP stands elsewhere than in the main program")
        what = "an arm moves before the program has looked at $ROBROOT"
        self._misplaced(line, not self.panel.looked, what)
        item = self.data.items.get(name)
        if item is None or item.kind not in ("e6axis", "e6pos"):
            self._fail(line, f"{name} is no E6AXIS or E6POS of the data list")
        self._needed(line, syntax_tree.AXIS_SPEEDS)
        share = tuple(float(self.settings[axis]) / 100.0 for axis in syntax_tree.AXIS_SPEEDS)
        speed = steps.Speed(math.inf, math.inf, 0.0, 0.0, share, self._outer_shares())
        target: steps.JointTarget | steps.StatusTarget = item.value
        self._move(line, "PTP", target, item.name, None, speed, _EXACT_STOP, "")
        if self.panel.along and self._under(target) not in (self.stood, self.rode):
            self.panel.looked = False  # where the axes stand now is not known before the next look
        self.stood, self.rode = self._under(target), None
        self.here, self.outer = None, ()
        if isinstance(target, steps.StatusTarget):
            x, y, z = (1e3 * target.position).tolist()
            w, i, j, k = target.quaternion.tolist()
            self.here = _Pose((x, y, z), (w, i, j, k))
            self.outer = tuple(enumerate(target.external.tolist()))

    def _under(self, target: steps.RobTarget | steps.JointTarget | steps.StatusTarget) -> tuple[float, ...]:
        """Values of the external axes that take the arm, as a target has them."""
        return tuple(float(target.external[column]) for column in self.panel.along)

    def _straight(self, move: syntax_tree.Straight) -> None:
        line = move.line
        here = self._begins(line, move.word)
        self._needed(line, tuple(syntax_tree.MOTION_SETTINGS))
        speed, way, turn, there = self._paced(line, here, move.place)
        target = _target(there, move.outer)
        zone, name = self._zone(move.corner)
        time = max(way / speed.tcp, turn / speed.turn)
        self._move(line, move.word, target, "", time, speed, zone, name)
        self.here, self.outer, self.rode = there, move.outer, self._under(target)

    def _spline(self, block: syntax_tree.Spline) -> None:
        """The points of a spline block as moves: each takes its share of the block's time, and only the last
        one ends in a stop."""
        self._begins(block.line, "SPLINE")
        self._needed(block.line, tuple(syntax_tree.MOTION_SETTINGS))
        last = next((step for step in reversed(self.steps) if isinstance(step, steps.MoveStep)), None)
        if last is None or not last.zone.fine:
            self._fail(block.line, "SPLINE does not begin at an exact stop; the move before it must be one")
        left = block.moves
        for item in block.points:
            if isinstance(item, syntax_tree.Said):
                self._statement(item)
            elif isinstance(item, syntax_tree.Point) and self.here is not None:
                left -= 1
                speed, _, _, there = self._paced(item.line, self.here, item.place)
                target = _target(there, item.outer)
                zone, name = (_FLY_BY, syntax_tree.SPLINE_MOVE) if left else (_EXACT_STOP, "")
                seconds = item.part * block.seconds
                self._move(item.line, syntax_tree.SPLINE_MOVE, target, "", seconds, speed, zone, name)
                self.here, self.outer = there, item.outer

    def _begins(self, line: int, word: str) -> _Pose:
        """The pose at which a straight move, or a spline block, begins."""
        self._carry(line)
        what = f"{word} stands in the main program; moves have files of their own"
        self._misplaced(line, not self.depth, what)
        if self.here is None:
            self._fail(line, f"{word} begins at no pose of this $BASE and $TOOL; PTP to an E6POS first")
        return self.here

    def _paced(
        self, line: int, here: _Pose, place: tuple[float, float, float, float, float, float]
    ) -> tuple[steps.Speed, float, float, _Pose]:
        """The speeds in force, way [m] and turn [rad] to a place, and that."""
        velocity, turning = float(self.settings["$vel.cp"]), float(self.settings["$vel.ori1"])
        if self.settings["$vel.ori2"] != turning:
            self._fail(line, "$VEL.ORI1 and $VEL.ORI2 differ; set both to one value")
        x, y, z, a, b, c = place
        there = _Pose((x, y, z), quaternion(a, b, c))
        way, turn = _apart(here, there)
        rate = math.sqrt(2.0) * math.radians(turning)
        return steps.Speed(velocity, rate, 0.0, 0.0, outer=self._outer_shares()), way, turn, there

    def _outer_shares(self) -> tuple[float, ...]:
        """The shares (6,) of their own speeds that external axes may take."""
        return tuple(float(self.settings.get(axis, 0.0)) / 100.0 for axis in syntax_tree.OUTER_SPEEDS)

    def _stand(self, line: int, seconds: float) -> None:
        """A wait in a file with moves: the arm's part of a move in which it stands still."""
        if self.here is None:
            self._fail(line, "WAIT SEC stands for a move, but the arm is at no pose of this $BASE and $TOOL")
        target = _target(self.here, self.outer)
        speed = steps.Speed(1.0, 1.0, 0.0, 0.0)
        self._move(line, "WAIT SEC", target, "", seconds, speed, _EXACT_STOP, "")

    def _move(
        self,
        line: int,
        word: str,
        target: steps.JointTarget | steps.StatusTarget | steps.RobTarget,
        name: str,
        time: float | None,
        speed: steps.Speed,
        zone: steps.Zone,
        corner: str,
    ) -> None:
        tool, tool_name = self._tool(line)
        work, work_name = self._work(line)
        where = (self.program.file.rpartition("/")[2], self.procedure, line, "")
        stop = corner or "an exact stop"
        self.steps.append(
            steps.MoveStep(
                *(*where, word, target, name, None, time, None, speed, zone, stop),
                *(tool, tool_name, work, work_name, ()),
            )
        )

    def _zone(self, corner: str) -> tuple[steps.Zone, str]:
        if not corner:
            return _EXACT_STOP, ""
        way, angle = 1e-3 * float(self.settings["$apo.cdis"]), math.radians(float(self.settings["$apo.cori"]))
        if corner == "C_DIS":
            angle = math.pi
        if corner == "C_ORI":
            way = _UNBOUNDED
        # external axes leave their ways with the tool, where that does
        return steps.Zone(False, way, 0.0, 0.0, angle, way, 0.0), corner


def _target(place: _Pose, outer: syntax_tree.Outer) -> steps.RobTarget:
    """A pose that the arm goes straight to, with the external axes that the text states there."""
    axes = np.full(6, steps.UNUSED_AXIS)
    for column, value in outer:
        axes[column] = value
    return steps.RobTarget(1e-3 * np.array(place.position), np.array(place.quaternion), None, axes)


def _own_load(tool: str) -> str:
    """The name of a tool's own load: l_x of t_x."""
    return "l_" + tool.removeprefix("t_")


def _apart(a: _Pose, b: _Pose) -> tuple[float, float]:
    """Way [m] and angle [rad] from one pose to another."""
    way = math.dist(a.position, b.position)
    (w, x, y, z), (s, i, j, k) = a.quaternion, b.quaternion
    # the vector part of the turn between them: its length is the sine of half the angle, exact for small ones
    u = (w * i - x * s - y * k + z * j, w * j + x * k - y * s - z * i, w * k - x * j + y * i - z * s)
    cosine = w * s + x * i + y * j + z * k
    return 1e-3 * way, 2.0 * math.atan2(math.hypot(*u), abs(cosine))
