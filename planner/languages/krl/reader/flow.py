"""Executes one KRL program symbolically, through all its files, and returns its steps.

Each move gets the settings in force, and values in place of names of the data list. The supported subset
has no conditions but the guarded wait, so there is only one order of execution. Settings are modal. A setting
that a program has not stated after BAS(#INITMOV,0) is unknown, and no move may depend on it.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.reader import syntax_tree
from planner.languages.krl.reader.panel import OperatorPanel, PanelError
from planner.languages.krl.reader.values import NO_LOAD, held_load, quaternion
from planner.programs import steps
from planner.programs.signals import NumberedSignals

MAX_CALL_DEPTH = 10
"""Maximum call depth of programs."""
MAX_STATEMENTS = 100_000
"""Maximum number of executed statements beyond those of one pass through each program.

It bounds repeated calls; programs rarely call each other.
"""
MAIN_PROCEDURE = "main"
"""Name of the main program's procedure in steps; its real name is that of the problem."""
_BLOCK_LOAD = "l_block_"
"""Prefix of the names of loads that state a tool together with the block that it holds."""
_EXACT_STOP = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Zone of a point without approximation: the arm stops there."""
_FLY_BY = steps.Zone(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Zone of a point of a spline block: the arm passes through it without a stop."""
AXIS_CHECK = "$AXIS_ACT"
"""Kind of the step that checks an external axis.

Its values are column (from 0), home, and tolerance [mm or deg]; its one switch is the text that is shown.
"""
_PRELUDE = (
    (False, "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )"),
    (True, "INTERRUPT ON 3 after it"),
    (syntax_tree.InitMotion, "BAS(#INITMOV,0) after it"),
)
"""First three statements of the main program, apart from comments.

Each is given by `StopInterrupt.on` or, for another statement, by its type, and by its name in messages.
"""
_PRELUDE_REASON = "stop reactions and settings require"
"""Reason why these statements are required, for messages."""
_UNBOUNDED = 1.0
"""Approximation distance [m] that bounds no corner, for corners that only the angle bounds."""


class _Pose(NamedTuple):
    """Pose of the TCP in $BASE, as written: X, Y, Z [mm] and a unit quaternion (w, x, y, z)."""

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


@dataclass(frozen=True)
class _KrlMotion:
    """Motion that a statement commands.

    Attributes:
        target: The target.
        speed: Speeds in force.
        time: Duration [s], None for a PTP.
        target_name: Name of the target in the data list, "" for a target in place.
        zone: How the controller rounds the corner at the target.
        zone_name: Word that selects the corner, "" for an exact stop.
    """

    target: steps.JointTarget | steps.StatusTarget | steps.RobTarget
    speed: steps.MoveSpeed
    time: float | None
    target_name: str = ""
    zone: steps.Zone = _EXACT_STOP
    zone_name: str = ""


class KrlRunner:
    """Executes the main program symbolically and collects its steps.

    Attributes:
        programs: Programs by lower-case name.
        data: The data list.
        base: The robot's foot in the world, (4, 4) [m].
        signals: Names of the numbered inputs and outputs.
        panel: State of the operator panel.
        steps: Steps so far.
        entered: Lower-case names of the programs that ran.
        settings: Values of the settings in force, by lower-case name.
        tools: Tools by lower-case name of their frame.
        work_objects: Work objects by lower-case name of their frame.
        pose: Pose that the last move reached, None if unknown.
        outer: External axes that the text states at that pose, as pairs (column, value).
        ptp_axis_values: Values [mm] of the axes under the arm at the last PTP, None before the first one.
        move_axis_values: Values [mm] of the axes under the arm at the last straight move since that PTP, None
            if there is none.
        outputs_on: Numbers of the outputs that are on.
        carried: Name of the load of the tool together with the block that it holds, "" if it holds none.
        load_line: Line of the last $LOAD setting.
        program: The current program.
        procedure: Name of the current segment.
        depth: Number of nested subprogram calls, 0 in the main program.
        started: Whether BAS(#INITMOV,0) has run.
        budget: Number of statements that may still be executed.
    """

    def __init__(
        self,
        programs: Mapping[str, syntax_tree.KrlProgram],
        data: syntax_tree.DataList,
        base: FloatArray,
        signals: NumberedSignals,
        panel: OperatorPanel,
    ) -> None:
        self.programs, self.data, self.base, self.signals = programs, data, base, signals
        self.panel = panel
        self.steps: list[steps.ProgramStep] = []
        self.entered: set[str] = set()
        self.settings: dict[str, float | str] = {}
        self.tools: dict[str, steps.Tool] = {}
        self.work_objects: dict[str, steps.WorkObject] = {}
        self.pose: _Pose | None = None
        self.outer: syntax_tree.StatedAxisValues = ()
        self.ptp_axis_values: tuple[float, ...] | None = None
        self.move_axis_values: tuple[float, ...] | None = None
        self.outputs_on: set[int] = set()
        self.carried = ""
        self.load_line = 0
        self.program: syntax_tree.KrlProgram
        self.procedure = MAIN_PROCEDURE
        self.depth = 0
        self.started = False
        self.budget = MAX_STATEMENTS + sum(len(program.body) for program in programs.values())
        self._open: list[str] = []
        """Lower-case names of the programs on the call stack, so that no program calls itself."""

    def run(self, main: syntax_tree.KrlProgram) -> tuple[steps.ProgramStep, ...]:
        """Return the steps of the main program.

        Raises:
            FlowError: A statement is out of place, or a value is not known.
        """
        self.program = main
        self.entered.add(main.name.lower())
        self._open.append(main.name.lower())
        first_statements = [
            statement for statement in main.body if not isinstance(statement, syntax_tree.CommentStatement)
        ][:3]
        for expected, statement in itertools.zip_longest(_PRELUDE, first_statements):
            identity = statement.on if isinstance(statement, syntax_tree.StopInterrupt) else type(statement)
            if identity != expected[0]:
                message = f"the main program does not start with {expected[1]}, as {_PRELUDE_REASON}"
                self._fail(statement.line if statement else 1, message)
        self._block(main.body)
        return tuple(self.steps)

    def _fail(self, line: int, message: str) -> NoReturn:
        raise steps.FlowError([steps.TextFault(line, 1, "krl.flow", message, self.program.file)])

    def _refuse_position(self, line: int, wrong: bool, message: str) -> None:
        """Raise `FlowError` if a statement is at a wrong position. The partial reader overrides this."""
        if wrong:
            self._fail(line, message)

    def _block(self, body: Sequence[syntax_tree.KrlStatement]) -> None:
        """Execute the statements of a program one after the other.

        Straight moves and spline blocks do not concern the panel. Before any other statement the panel is
        checked, and so it is at the end of the main program.
        """
        for statement in body:
            self.budget -= 1
            if self.budget < 0:
                self._fail(statement.line, "the programs call each other too often to be read")
            if isinstance(statement, syntax_tree.LinearStatement):
                self._linear(statement)
                continue
            if isinstance(statement, syntax_tree.SplineStatement):
                self._spline(statement)
                continue
            if not isinstance(statement, syntax_tree.SettingStatement | syntax_tree.CommentStatement):
                self._emit_load_change(statement.line)
            self._check_panel_state(statement)
            self._statement(statement)
        if not self.depth:
            self._check_panel_end(body[-1].line if body else 1)

    def _check_panel_state(self, statement: syntax_tree.KrlStatement) -> None:
        """Check that the panel allows the statement now, and append the message that it shows, if any."""
        try:
            self.panel.check(statement, self.depth)
            self._emit_message(statement)
        except PanelError as wrong:
            self._fail(statement.line, str(wrong))

    def _check_panel_end(self, line: int) -> None:
        """Refuse statements that the panel still expects at the end of the main program."""
        try:
            self.panel.check(None, 0)
        except PanelError as wrong:
            self._fail(line, str(wrong))

    def _emit_message(self, statement: syntax_tree.KrlStatement) -> None:
        """Update the panel by a statement, and append the message that it shows, if any.

        All outputs must be off at a statement at which the program may halt without a question, because an
        output of KRL stays on while the program is stopped.
        """
        message = self.panel.take(statement, self.depth)
        if self.outputs_on and self.panel.may_stop(statement):
            self._fail(statement.line, f"the program may halt while $OUT[{min(self.outputs_on)}] is on")
        if message is not None:
            where = (self.program.file.rpartition("/")[2], self.procedure, statement.line, "")
            lines = (message.text,)
            self.steps.append(
                steps.MessageStep(
                    *where, message.kind, lines, message.confirm, message.text, message.confirm, message.panel
                )
            )

    def _statement(self, statement: syntax_tree.KrlStatement) -> None:
        """Execute a statement that is not a straight move or spline block, after the panel has handled it."""
        line = statement.line
        where = (self.program.file.rpartition("/")[2], self.procedure, line, "")
        match statement:
            case syntax_tree.InitMotion():
                if self.started or self.depth:
                    self._fail(line, "BAS(#INITMOV,0) is allowed only at the start of the main program")
                self.started = True
                self.steps.append(steps.SettingStep(*where, "BAS(#INITMOV,0)", (), ()))
            case syntax_tree.SettingStatement(name=name, value=value):
                self._setting(line, name, value)
            case syntax_tree.CommentStatement(kind="segment", text=text):
                self.procedure = text
            case syntax_tree.StopInterrupt():
                message = "the interrupt of stop messages is allowed only at the start"
                self._refuse_position(line, bool(self.steps) or self.depth > 0, message)
            case syntax_tree.HaltStatement() if self.panel.dialect == "krc4":
                self.steps.append(steps.SettingStep(*where, "HALT", (), (), stops=True))
            case syntax_tree.RobrootCheck():
                self.steps.append(steps.SettingStep(*where, "$ROBROOT", (), ()))
            case syntax_tree.ExternalAxisCheck(column=column, home=home, tolerance=tolerance, text=text):
                self.steps.append(steps.SettingStep(*where, AXIS_CHECK, (text,), (column, home, tolerance)))
            case syntax_tree.OutputStatement(number=number, value=on):
                self.outputs_on = self.outputs_on | {number} if on else self.outputs_on - {number}
                name = self.signals.outputs.get(number, f"$OUT[{number}]")
                self.steps.append(
                    steps.SignalStep(*where, "$OUT", name, float(on), delay=0.0, synchronous=True)
                )
            case syntax_tree.InputPoll(number=number, value=on, seconds=seconds):
                name = self.signals.inputs.get(number, f"$IN[{number}]")
                self.steps.append(
                    steps.WaitStep(*where, "WHILE", seconds, name, float(on), after_stop=False, repeats=True)
                )
            case syntax_tree.InputWait():
                self._input_wait(statement, where)
            case syntax_tree.WaitSecStatement(seconds=seconds) if self._is_moving:
                self._dwell(line, seconds)
            case syntax_tree.WaitSecStatement(seconds=seconds):
                self.steps.append(
                    steps.WaitStep(*where, "WAIT SEC", seconds, signal="", value=None, after_stop=True)
                )
            case syntax_tree.PtpStatement(name=name):
                self._ptp(line, name)
            case syntax_tree.CallStatement(name=name):
                self._call(line, name)

    def _input_wait(self, wait: syntax_tree.InputWait, where: tuple[str, str, int, str]) -> None:
        """Append a wait for an input of the process, which ends the program on a timeout.

        On a timeout the wait must switch off all outputs that are on, and show the expected text (krc4) or
        none (krc2).
        """
        line = wait.line
        self._refuse_position(
            line, self.depth > 0, "a wait for the process is allowed only in the main program"
        )
        if still_on := self.outputs_on - wait.outputs_off:
            self._fail(line, f"the program may end while $OUT[{min(still_on)}] is on")
        name = self.signals.inputs.get(wait.number, f"$IN[{wait.number}]")
        expected = krl_sentences.INPUT_TIMEOUT.format(signal=name, seconds=wait.seconds)
        expected = expected if self.panel.dialect == "krc4" else ""
        if steps.normalised_text(wait.text) != steps.normalised_text(expected):
            self._fail(line, f"a wait that times out shows {wait.text!r}; expected {expected!r}")
        if expected and not self.panel.prepared:
            self._fail(line, "tm_opt is not set before this message")
        self.steps.append(
            steps.WaitStep(*where, "WHILE", wait.seconds, name, float(wait.value), after_stop=False)
        )

    @property
    def _is_moving(self) -> bool:
        """Whether the current subprogram contains moves. A WAIT SEC in it then stands for a move."""
        return self.depth > 0 and self.program.moves > 0

    def _call(self, line: int, name: str) -> None:
        """Execute a subprogram, and then continue with the caller's program and segment.

        A subprogram with moves must state all motion settings itself, so those of earlier files are
        forgotten.
        """
        program = self.programs.get(name)
        if program is None or self.depth >= MAX_CALL_DEPTH or name in self._open:
            reason = "is not one of the programs" if program is None else "calls itself"
            self._fail(line, f"{name}() {reason}")
        caller = self.program, self.procedure
        self.entered.add(name)
        self._open.append(name)
        self.program, self.depth = program, self.depth + 1
        if program.moves:
            for setting in syntax_tree.MOTION_SETTINGS:  # each file with moves states its own
                self.settings.pop(setting, None)
        self._block(program.body)
        self._open.pop()
        (self.program, self.procedure), self.depth = caller, self.depth - 1

    # ---- settings ----

    def _setting(self, line: int, name: str, value: float | str) -> None:
        """Check a setting and put it in force.

        Motion settings (speeds and approximation) are allowed only in subprograms, all other settings only in
        the main program. A new $TOOL or $BASE makes the last pose unknown, because poses are relative to
        them.
        """
        allowed_place = "a file with moves" if name in syntax_tree.MOTION_SETTINGS else "the main program"
        wrong = (name in syntax_tree.MOTION_SETTINGS) != (self.depth > 0)
        self._refuse_position(line, wrong, f"{name.upper()} may be set only in {allowed_place}")
        if name in syntax_tree.CHOICE_SETTINGS:
            location = (self.program.file.rpartition("/")[2], self.procedure, line, "")
            self.steps.append(steps.SettingStep(*location, name.upper(), (), ()))
        if name in syntax_tree.FRAME_SETTINGS:
            kind = syntax_tree.FRAME_SETTINGS[name]
            item = self.data.items.get(str(value))
            if item is None or item.kind != kind:
                self._fail(line, f"{value} is no {kind.upper()} of the data list")
            if name == "$load":
                self.load_line = line
            else:
                self.pose = None
        self.settings[name] = value

    def _require_settings(self, line: int, names: Sequence[str]) -> None:
        missing = [name for name in names if name not in self.settings]
        if missing:
            self._fail(line, f"{missing[0].upper()} is not set before this move; set it")

    def _tool(self, line: int) -> tuple[steps.Tool, str]:
        """Return the tool in force, with its own load, and its name in the data list."""
        self._require_settings(line, ("$tool", "$load", *syntax_tree.CHOICE_SETTINGS))
        name = str(self.settings["$tool"])
        if name not in self.tools:
            load = self.data.items.get(_tool_load(name))
            if load is None or load.kind != "load":
                self._fail(line, f"the data list has no LOAD {_tool_load(name)} for {name}")
            self.tools[name] = steps.Tool(held=True, pose=self.data.items[name].value, load=load.value)
        return self.tools[name], self.data.items[name].name

    def _work_object(self, line: int) -> tuple[steps.WorkObject, str]:
        """Return the base in force as a work object, and its name in the data list."""
        self._require_settings(line, ("$base",))
        name = str(self.settings["$base"])
        if name not in self.work_objects:
            self.work_objects[name] = steps.WorkObject(
                held=False, fixed=True, unit="", user=self.base, object=self.data.items[name].value
            )
        return self.work_objects[name], self.data.items[name].name

    def _emit_load_change(self, line: int) -> None:
        """Append a step if $LOAD changes between the tool's own load and the load of the tool with a block.

        The step states the load of the block alone, because rules compare it with the block's mass.
        """
        if "$tool" not in self.settings or "$load" not in self.settings:
            return
        tool, load = str(self.settings["$tool"]), str(self.settings["$load"])
        carried = "" if load == _tool_load(tool) else load
        if carried == self.carried:
            return
        if carried and not carried.startswith(_BLOCK_LOAD):
            self._fail(self.load_line, f"{load} is neither the load of {tool} nor a load of it with a block")
        tool_value, _ = self._tool(line)
        combined_load: steps.LoadData = self.data.items[load].value
        held = held_load(combined_load, tool_value.load, tool_value.pose) if carried else NO_LOAD
        where = (self.program.file.rpartition("/")[2], self.procedure, self.load_line, "")
        self.steps.append(steps.CarryStep(*where, held, load))
        self.carried = carried

    # ---- moves ----

    def _ptp(self, line: int, name: str) -> None:
        """Append a PTP, which is allowed only in the main program and after the check of the robot's foot.

        After a PTP to an E6POS the pose is known, so that straight moves may start there. After a PTP to an
        E6AXIS it is unknown. A PTP that moves an external axis under the arm makes another check of the foot
        necessary.
        """
        self._refuse_position(line, self.depth > 0, "PTP is allowed only in the main program")
        message = "the arm moves before the program has checked $ROBROOT"
        self._refuse_position(line, not self.panel.robroot_checked, message)
        item = self.data.items.get(name)
        if item is None or item.kind not in ("e6axis", "e6pos"):
            self._fail(line, f"{name} is no E6AXIS or E6POS of the data list")
        self._require_settings(line, syntax_tree.AXIS_SPEEDS)
        fractions = tuple(float(self.settings[axis]) / 100.0 for axis in syntax_tree.AXIS_SPEEDS)
        speed = steps.MoveSpeed(
            tcp=math.inf,
            turn=math.inf,
            linear=0.0,
            rotary=0.0,
            axes=fractions,
            external=self._external_speed_fractions(),
        )
        target: steps.JointTarget | steps.StatusTarget = item.value
        self._move(line, "PTP", _KrlMotion(target, speed, None, target_name=item.name))
        if self.panel.axis_directions and self._arm_axis_values(target) not in (
            self.ptp_axis_values,
            self.move_axis_values,
        ):
            self.panel.robroot_checked = False  # the axes have moved the foot: its position must be checked
        self.ptp_axis_values, self.move_axis_values = self._arm_axis_values(target), None
        self.pose, self.outer = None, ()
        if isinstance(target, steps.StatusTarget):
            x, y, z = (1e3 * target.position).tolist()
            w, i, j, k = target.quaternion.tolist()
            self.pose = _Pose((x, y, z), (w, i, j, k))
            self.outer = tuple(enumerate(target.external.tolist()))

    def _arm_axis_values(
        self, target: steps.RobTarget | steps.JointTarget | steps.StatusTarget
    ) -> tuple[float, ...]:
        """Return the values of the external axes that move the arm, as a target states them."""
        return tuple(float(target.external[column]) for column in self.panel.axis_directions)

    def _linear(self, move: syntax_tree.LinearStatement) -> None:
        """Append a straight move. The slower of translation and rotation determines its duration."""
        line = move.line
        start = self._start_pose(line, move.word)
        self._require_settings(line, tuple(syntax_tree.MOTION_SETTINGS))
        speed, distance, angle, end = self._speed_and_distance(line, start, move.target)
        target = _target(end, move.outer)
        zone, name = self._zone(move.corner)
        time = max(distance / speed.tcp, angle / speed.turn)
        self._move(line, move.word, _KrlMotion(target, speed, time, zone=zone, zone_name=name))
        self.pose, self.outer, self.move_axis_values = end, move.outer, self._arm_axis_values(target)

    def _spline(self, block: syntax_tree.SplineStatement) -> None:
        """Append one move for each point of a spline block.

        Each takes its fraction of the block's time, and only the last one ends in a stop.
        """
        self._start_pose(block.line, "SPLINE")
        self._require_settings(block.line, tuple(syntax_tree.MOTION_SETTINGS))
        last_move = next((step for step in reversed(self.steps) if isinstance(step, steps.MoveStep)), None)
        if last_move is None or not last_move.zone.fine:
            self._fail(
                block.line, "SPLINE does not start at an exact stop; the previous move must end in one"
            )
        remaining = block.moves
        for item in block.points:
            if isinstance(item, syntax_tree.CommentStatement):
                self._statement(item)
            elif isinstance(item, syntax_tree.SplinePoint) and self.pose is not None:
                remaining -= 1
                speed, _, _, end = self._speed_and_distance(item.line, self.pose, item.target)
                target = _target(end, item.outer)
                zone, name = (_FLY_BY, syntax_tree.SPLINE_MOVE) if remaining else (_EXACT_STOP, "")
                seconds = item.part * block.seconds
                motion = _KrlMotion(target, speed, seconds, zone=zone, zone_name=name)
                self._move(item.line, syntax_tree.SPLINE_MOVE, motion)
                self.pose, self.outer = end, item.outer

    def _start_pose(self, line: int, word: str) -> _Pose:
        """Return the pose at which a straight move or a spline block starts.

        It is a fault if the statement is in the main program, or if the pose is unknown. ``word`` is the
        statement's keyword for messages. A change of $LOAD before the move is appended first.
        """
        self._emit_load_change(line)
        message = f"{word} is in the main program; moves belong in separate files"
        self._refuse_position(line, not self.depth, message)
        if self.pose is None:
            self._fail(
                line, f"the start pose of {word} in this $BASE and $TOOL is unknown; add a PTP to an E6POS"
            )
        return self.pose

    def _speed_and_distance(
        self, line: int, start: _Pose, target: tuple[float, float, float, float, float, float]
    ) -> tuple[steps.MoveSpeed, float, float, _Pose]:
        """Return the speeds in force, and distance [m], angle [rad] and end pose of a move from ``start``.

        ``target`` is X, Y, Z [mm] and A, B, C [deg] of the end pose.
        """
        velocity, turning = float(self.settings["$vel.cp"]), float(self.settings["$vel.ori1"])
        if self.settings["$vel.ori2"] != turning:
            self._fail(line, "$VEL.ORI1 and $VEL.ORI2 differ; set both to one value")
        x, y, z, a, b, c = target
        end = _Pose((x, y, z), quaternion(a, b, c))
        distance, angle = _distance_and_angle(start, end)
        # each setting limits one of two components of the rotation: together they allow sqrt(2) of it
        rotation_speed = math.sqrt(2.0) * math.radians(turning)
        return (
            steps.MoveSpeed(velocity, rotation_speed, 0.0, 0.0, external=self._external_speed_fractions()),
            distance,
            angle,
            end,
        )

    def _external_speed_fractions(self) -> tuple[float, ...]:
        """Return the fractions (6,) of their maximum speeds that external axes may use.

        The fraction is 0 for an axis without a setting.
        """
        return tuple(float(self.settings.get(axis, 0.0)) / 100.0 for axis in syntax_tree.EXTERNAL_AXIS_SPEEDS)

    def _dwell(self, line: int, seconds: float) -> None:
        """Append a WAIT SEC in a file with moves as a move to the current pose.

        It stands for a move during which this arm stands still while the other arm moves.
        """
        if self.pose is None:
            self._fail(
                line, "WAIT SEC stands for a move, but the arm's pose in this $BASE and $TOOL is unknown"
            )
        target = _target(self.pose, self.outer)
        speed = steps.MoveSpeed(tcp=1.0, turn=1.0, linear=0.0, rotary=0.0)
        self._move(line, "WAIT SEC", _KrlMotion(target, speed, seconds))

    def _move(self, line: int, word: str, motion: _KrlMotion) -> None:
        """Append a move with the tool and the work object in force.

        Args:
            line: Line of the statement, from 1.
            word: Its keyword.
            motion: The motion that it commands.
        """
        tool, tool_name = self._tool(line)
        work_object, work_object_name = self._work_object(line)
        where = (self.program.file.rpartition("/")[2], self.procedure, line, "")
        self.steps.append(
            steps.MoveStep(
                *where,
                kind=word,
                target=motion.target,
                target_name=motion.target_name,
                id=None,
                time=motion.time,
                velocity=None,
                speed=motion.speed,
                zone=motion.zone,
                zone_name=motion.zone_name or "an exact stop",
                tool=tool,
                tool_name=tool_name,
                wobj=work_object,
                wobj_name=work_object_name,
                switches=(),
            )
        )

    def _zone(self, corner: str) -> tuple[steps.Zone, str]:
        """Return the zone of a corner and the word that selects it; an exact stop for the word "".

        C_DIS bounds the corner by the distance $APO.CDIS, C_ORI by the angle $APO.CORI, and C_SPL by both.
        """
        if not corner:
            return _EXACT_STOP, ""
        distance = 1e-3 * float(self.settings["$apo.cdis"])
        angle = math.radians(float(self.settings["$apo.cori"]))
        if corner == "C_DIS":
            angle = math.pi
        if corner == "C_ORI":
            distance = _UNBOUNDED
        # external axes leave their paths where the tool does, so they share its distance
        return steps.Zone(
            fine=False, tcp=distance, turn=0.0, external=0.0, turn_angle=angle, linear=distance, rotary=0.0
        ), corner


def _target(pose: _Pose, outer: syntax_tree.StatedAxisValues) -> steps.RobTarget:
    """Return the target of a straight move, with the external axes that the text states there."""
    axes = np.full(6, steps.UNUSED_AXIS)
    for column, value in outer:
        axes[column] = value
    return steps.RobTarget(1e-3 * np.array(pose.position), np.array(pose.quaternion), None, axes)


def _tool_load(tool: str) -> str:
    """Return the name of a tool's own load: l_x for t_x."""
    return "l_" + tool.removeprefix("t_")


def _distance_and_angle(a: _Pose, b: _Pose) -> tuple[float, float]:
    """Return the distance [m] and the rotation angle [rad] between two poses."""
    distance = math.dist(a.position, b.position)
    (w, x, y, z), (s, i, j, k) = a.quaternion, b.quaternion
    # vector part of the relative rotation: its length is sin(angle / 2), exact for small angles
    u = (w * i - x * s - y * k + z * j, w * j + x * k - y * s - z * i, w * k - x * j + y * i - z * s)
    cosine = w * s + x * i + y * j + z * k
    return 1e-3 * distance, 2.0 * math.atan2(math.hypot(*u), abs(cosine))
