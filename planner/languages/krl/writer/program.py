"""Writes the KRL programs of a job: for each KUKA arm a main program, its data list, and files with moves.

The main program calls subprograms with moves. The speed of a PTP is an integer percentage of the axis speeds,
so low that the TCP keeps its limit. For two controllers that share digital signals, the steps of
:mod:`planner.languages.writing.handshake` are written as statements.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward_kinematics
from planner.claims import sentences
from planner.geometry.arrays import FloatArray, IntArray
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.writer import spline_blocks, syntax
from planner.languages.krl.writer.data import TaskDeclarations
from planner.languages.krl.writer.syntax import MoveText, comment, identifier
from planner.languages.writing import handshake, layout
from planner.languages.writing.external_axes import external_axis_names, external_axis_speeds
from planner.languages.writing.header import header
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.plans import Plan
from planner.problem import Controller, KrlDialect, Problem
from planner.targets import TargetAction


def partner_lines(
    partner: handshake.HandshakeSide,
    controller: Controller,
    steps: Sequence[handshake.PartnerStep],
    with_state: bool = True,
) -> list[str]:
    """Return the statements of handshake steps.

    Args:
        partner: The handshake as one of the two programs sees it.
        controller: Controllers of the cell.
        steps: Steps of the handshake.
        with_state: Whether the panel shows that the program waits. In a file with a meeting it already does.
    """
    waiting = krl_sentences.WAITING_FOR_PARTNER.format(arm=partner.other)
    signals = partner.handshake.of(partner.arm)
    output_number = controller.signal_number(partner.arm, signals.output)
    input_number = controller.signal_number(partner.arm, signals.input)
    running_number = controller.signal_number(partner.arm, signals.partner_running)
    out: list[str] = []
    for step in steps:
        match step:
            case handshake.SetLine(value):
                out.append(f"$OUT[{output_number}]={_level(value)}")
            case handshake.AwaitLine(value, seconds):
                wait = _wait(f"$IN[{input_number}]=={_level(1 - value)}", seconds, partner.timeout_text)
                out += syntax.with_state(waiting, wait, controller.dialect) if with_state else wait
            case handshake.AwaitRunning(value, seconds):
                wait = _wait(
                    f"$IN[{running_number}]=={_level(1 - value)}", seconds, partner.wrong_level_text(value)
                )
                out += syntax.with_state(waiting, wait, controller.dialect) if with_state else wait
            case handshake.StopAndAsk(text):
                if controller.dialect == "krc4":  # in krc2 the question itself has a HALT
                    out.append("HALT")
                out += syntax.question_lines(text, controller.dialect)
            case handshake.AskOperator(text):
                out += syntax.question_lines(text, controller.dialect)
            case handshake.ShowText(text):
                out += syntax.message_lines(text, controller.dialect)
            case handshake.CommentStep(text):
                out += comment(text)
    return out


def partner_suffix(phases: tuple[int, ...]) -> str:
    """Return the suffix of the name of a subprogram that contains a meeting after a move.

    A toggle handshake has one subprogram for each level of the lines, which are the ``phases``: "meet_0" and
    "meet_1". A four-phase handshake has a single one, "meet".
    """
    return f"meet_{phases[0]}" if len(phases) == 1 else "meet"


def _level(value: int) -> str:
    return "TRUE" if value else "FALSE"


def _wait(condition: str, seconds: float, unanswered: str) -> list[str]:
    """Return statements that wait while a condition holds.

    On a timeout they halt; after the next start they wait again.

    Args:
        condition: The condition in KRL.
        seconds: Timeout [s].
        unanswered: What a timeout means, for a comment.
    """
    return [
        "$TIMER[1]=0",
        "$TIMER_STOP[1]=FALSE",
        f"WHILE {condition}",
        f"IF $TIMER[1]>{math.ceil(1e3 * seconds)} THEN",
        *comment(f"{unanswered} Start repeats the wait."),
        "HALT",
        "$TIMER[1]=0",
        "ENDIF",
        "WAIT SEC 0.01",
        "ENDWHILE",
        "$TIMER_STOP[1]=TRUE",
    ]


UNKNOWN_START_PERCENT: Final = 10
"""Speed [%] of the first PTP of a program, which starts from an unknown position."""
_SPEED_SAMPLES: Final = 400
"""Number of intervals of a PTP. The mean speed of the TCP is computed on each of them."""
TRACK_SPEED_PERCENT: Final = 100
"""Speed [%] of a coordinated track. Less would slow down the tool."""
_SPEED_FRACTION: Final = 0.99
"""Fraction of the speed limit that a PTP may use, because the maximum may be between two samples."""


def ptp_percent(
    robot: RobotData, start: FloatArray, end: FloatArray, tcp: FloatArray, limit: float, max_fraction: float
) -> int:
    """Return the largest speed of a PTP [%] at which the TCP keeps its limit, or 1 if even that is too fast.

    The axis that needs the longest for its angle runs at a fraction p of its catalogue speed, and the others
    are synchronised with it. The TCP speed is then p times its value at full speed, v_tcp(p) = p v_tcp(1).

    Args:
        robot: The robot.
        start: Joint angles at the start, (6,) [rad].
        end: Joint angles at the end, (6,) [rad].
        tcp: The TCP in the flange frame, (4, 4) [m].
        limit: Maximum speed of the TCP [m/s].
        max_fraction: Maximum fraction of the axis speeds, for other reasons [-].
    """
    q = start + np.linspace(0.0, 1.0, _SPEED_SAMPLES + 1)[:, None] * (end - start)
    point = (forward_kinematics(robot, q) @ tcp)[:, :3, 3]
    # path_rate: largest displacement of the TCP per unit of the path parameter [m];
    # v_tcp(1) = path_rate / full_speed_time
    path_rate = float(np.linalg.norm(np.diff(point, axis=0), axis=1).max()) * _SPEED_SAMPLES
    full_speed_time = float((np.abs(end - start) / robot.velocity).max())
    fraction = max_fraction
    if path_rate > 0.0:
        fraction = min(max_fraction, _SPEED_FRACTION * limit * full_speed_time / path_rate)
    return max(1, int(np.floor(100.0 * fraction + 1e-9)))


_STEM_LENGTH: Final = 16
"""Maximum length of the problem's name in file names [characters]."""


@dataclasses.dataclass(frozen=True)
class KrlTask:
    """A task with its declarations and its moves as KRL text.

    Attributes:
        program: The task.
        data: Names and declarations of the task.
        moves: Text of the moves of each operation, None for an operation in which the arm has no moves.
    """

    program: layout.TaskProgram
    data: TaskDeclarations
    moves: Sequence[MoveText | None]


class MainProgram:
    """Writes the main program of a task, and the statements of its subprograms.

    Attributes:
        stem: Name of the main program, and prefix of the names of its subprograms.
        split: Parts of the moves of the job, each of which goes into one file.
        moves: Text of the moves of each operation.
        partner: The handshake with the other controller, or None.
        bodies: Statements of the subprograms by name, filled by :meth:`lines`.
        speeds: Speeds of the external axes, by column.
        axis_directions: Directions in the foot's axes of the external axes that move the arm, by column.
    """

    def __init__(
        self,
        krl_task: KrlTask,
        job: layout.JobPrograms,
        plan: Plan,
        problem: Problem,
        split: Sequence[layout.ModulePart],
    ) -> None:
        task = krl_task.program
        self.stem = identifier(problem.name, _STEM_LENGTH)
        self.task, self.job, self.problem, self.data = task, job, problem, krl_task.data
        self.split, self.moves = split, krl_task.moves
        self.controller = problem.cell.controller
        self.dialect = problem.cell.controller.dialect
        self.partner = handshake.HandshakeSide.of(task, job)
        self.bodies: dict[str, list[str]] = {}
        self.speeds = external_axis_speeds(task, plan, problem)
        self.axis_directions = {axis.column: task.base[:3, :3].T @ axis.axis for axis in task.arm.linear_axes}
        self._held_load: layout.HeldLoad | None = None
        """Load of the block that the tool holds at this point of the program."""
        self._axis_setpoint: layout.ExternalAxisValues | None = None
        """Values of the external axes at this point of the program, None if unknown."""
        self._joints: FloatArray | None = None
        """Joint angles (6,) [rad] at this point of the program, None if unknown."""
        self._percent = 0
        """Speed of the axes in force [%], 0 if not set."""
        self._axes_slowed = False
        """Whether the external axes have the speeds for motion between stations."""

    def lines(self) -> list[str]:
        """Return the statements of the main program, and fill ``bodies`` with those of the subprograms.

        The main program first enables the stop reactions, switches its outputs off, checks the robot's foot
        and asks the operator for the start. The operations follow.
        """
        out = [*syntax.STOP_INTERRUPT, "BAS(#INITMOV,0)", "$ADVANCE=3", "$IPO_MODE=#BASE", "$ORI_TYPE=#VAR"]
        out += [self._switch(signal, False) for signal in self.job.switched_signals(self.task)]
        out += [*syntax.message_setup(self.dialect), *self._robroot_check()]
        clear = (sentences.KRL_CLEAR if self.problem.setups[0].steps else sentences.KRL_READY).format()
        if self.partner is None:
            out += syntax.question_lines(clear, self.dialect)
        else:
            steps = self.partner.start_steps(krl_sentences.KRL_EARLIER, clear)
            out += partner_lines(self.partner, self.controller, steps)
        for i, operation in enumerate(self.task.operations):
            out += self._operation(i, operation)
        if self.partner is not None:
            out += partner_lines(self.partner, self.controller, self.partner.end_steps())
            for phases, number in self.partner.meeting_kinds(self.task).items():
                steps = self.partner.meeting_after_move(number)
                body = partner_lines(self.partner, self.controller, steps, with_state=False)
                self.bodies[f"{self.stem}_{partner_suffix(phases)}"] = body
        return out

    def _operation(self, index: int, operation: layout.OperationProgram) -> list[str]:
        """Return the statements of an operation.

        If the arm moves in it, tool, load and base are set first. Consecutive runs of segments become calls
        of subprograms.

        Args:
            index: Index of the operation, from 0.
            operation: The operation.
        """
        out = comment(f"Operation {operation.name}.")
        if any(isinstance(step, layout.JointMove | layout.SegmentRun) for step in operation.steps):
            out += [
                f"$TOOL={self.data.tool(operation.arm.tool)}",
                f"$LOAD={self.data.load(operation.arm.tool, self._held_load)}",
                f"$BASE={self.data.base(operation)}",
            ]
        steps_without_sync = (
            step for step in operation.steps if not isinstance(step, layout.SyncOn | layout.SyncOff)
        )
        for is_run, steps in itertools.groupby(
            steps_without_sync, lambda step: isinstance(step, layout.SegmentRun)
        ):
            if is_run:
                out += self._runs(
                    index, operation, [step for step in steps if isinstance(step, layout.SegmentRun)]
                )
            else:
                group = list(steps)
                for i, step in enumerate(group):
                    out += self._step(step, index, operation, layout.question_follows(group[i + 1 :]))
        return out

    def _step(
        self, step: layout.TaskStep, index: int, operation: layout.OperationProgram, question_follows: bool
    ) -> list[str]:
        """Return the statements of a step that is not a run of moves; none for a meeting without a handshake.

        Args:
            step: The step.
            index: Index of the operation, from 0.
            operation: The operation.
            question_follows: Whether the next step that is not a message is a question.
        """
        match step:
            case layout.JointMove():
                return self._ptp(step, index, operation)
            case layout.AxesCheck(station):
                names = external_axis_names(self.task)
                checks = (
                    syntax.axis_check(names[column], column, value, self.dialect) for column, value in station
                )
                return [line for check in checks for line in check]
            case layout.Meeting(number, reached, seconds) if self.partner is not None:
                steps = self.partner.meeting_after_solo(number, seconds)
                lines = partner_lines(self.partner, self.controller, steps)
                return [*comment(f"Meeting: {reached}"), *lines]
            case layout.ActionStep(action):
                return self._action(action, question_follows)
            case layout.CarryLoad(load):
                self._held_load = load
                return [f"$LOAD={self.data.load(operation.arm.tool, load)}"]
        return []

    def _ptp(self, step: layout.JointMove, index: int, operation: layout.OperationProgram) -> list[str]:
        """Return a PTP with its speed settings, and a check of the robot's foot if an external axis moves it.

        The speed is the largest one at which the TCP keeps its limit. The first PTP of a program is slow
        instead, because the arm may start from anywhere. Settings that are in force already are left out.
        """
        limits = self.problem.settings
        percent = UNKNOWN_START_PERCENT
        if self._joints is not None:
            tcp, max_fraction = operation.arm.tool.tcp, limits.speed_fraction
            percent = ptp_percent(self.task.robot, self._joints, step.q, tcp, limits.tcp_speed, max_fraction)
        out = [] if self._axes_slowed else self._external_axis_speeds()
        self._axes_slowed = True
        if percent != self._percent:
            out += [f"$VEL_AXIS[{i}]={percent}" for i in range(1, 7)]
        self._joints, self._percent = step.q, percent
        if step.role == "start" and operation.moves is not None:
            return [*out, f"PTP {self.data.start(operation, step.q, index + 1)}"]
        out.append(f"PTP {self.data.joint(step, index + 1)}")
        if self.axis_directions and step.axis_setpoint != self._axis_setpoint:
            self._axis_setpoint = step.axis_setpoint
            out += self._robroot_check()  # an axis has moved the foot
        return out

    def _robroot_check(self) -> list[str]:
        return syntax.robroot_check(self.task.arm.name, self.dialect, self.axis_directions)

    def _external_axis_speeds(self) -> list[str]:
        """Return settings of the external axes' speeds between stations, as whole percentages."""
        fractions = {column: speed.travel / speed.rated for column, speed in self.speeds.items()}
        percents = {
            column: max(1, int(np.floor(100.0 * fraction + 1e-9))) for column, fraction in fractions.items()
        }
        return [f"$VEL_EXTAX[{column + 1}]={percent}" for column, percent in percents.items()]

    def _action(self, action: TargetAction, question_follows: bool) -> list[str]:
        """Return the statements of an action at a target: message, question, output, wait, or input."""
        match action.kind:
            case "message":
                return syntax.message_lines(action.text, self.dialect, before_question=question_follows)
            case "confirm":
                return syntax.question_lines(action.text, self.dialect)
            case "on" | "off":
                return [self._switch(action.signal, action.kind == "on")]
            case "wait":
                return [f"WAIT SEC {layout.format_short(action.seconds, 3)}"]
            case "input":
                return self._input(action)

    def _input(self, action: TargetAction) -> list[str]:
        """Return a wait for an input of the process.

        On a timeout the program switches all its outputs off, shows the reason, and never resumes.
        """
        number = self.controller.signal_number(self.task.arm.name, action.signal)
        milliseconds = math.ceil(1e3 * action.seconds)
        text = krl_sentences.INPUT_TIMEOUT.format(signal=action.signal, seconds=1e-3 * milliseconds)
        return [
            "$TIMER[1]=0",
            "$TIMER_STOP[1]=FALSE",
            f"WHILE $IN[{number}]==FALSE ; {action.signal}",
            f"IF $TIMER[1]>{milliseconds} THEN",
            *(self._switch(signal, False) for signal in self.job.switched_signals(self.task)),
            *syntax.end_program(text, self.dialect),
            "ENDIF",
            "WAIT SEC 0.01",
            "ENDWHILE",
            "$TIMER_STOP[1]=TRUE",
        ]

    def _switch(self, signal: str, on: bool) -> str:
        number = self.controller.signal_number(self.task.arm.name, signal)
        return f"$OUT[{number}]={'TRUE' if on else 'FALSE'} ; {signal}"

    # ---- moves ----

    def _runs(
        self, index: int, operation: layout.OperationProgram, runs: Sequence[layout.SegmentRun]
    ) -> list[str]:
        """Return calls of the subprograms with the moves of consecutive runs, and write these subprograms.

        There is one subprogram, in one file, for each module of ``split``. If a coordinated track moves with
        the tool, its speed is set before the calls. If the arms meet after moves, the panel shows during the
        calls that the arm moves with the other one.
        """
        if operation.moves is None:
            return []
        first_move, end_move = runs[0].first, runs[-1].last
        parts = (
            part for part in self.split if part.operation == index and first_move <= part.first < end_move
        )
        calls = []
        for _, grouped in itertools.groupby(parts, lambda part: part.module):
            name = f"{self.stem}_{len(self.bodies) + 1}"
            self.bodies[name] = self._moves(index, operation, grouped)
            calls.append(f"{name}()")
        self._joints = operation.moves.q[end_move - 1]
        if operation.moves.track_positions is not None:  # the tool's speed determines that of the track
            calls = [f"$VEL_EXTAX[{layout.TRACK_COLUMN + 1}]={TRACK_SPEED_PERCENT}", *calls]
            self._axes_slowed = False
            self._axis_setpoint = syntax.with_track_position(
                operation.axis_setpoint, operation.moves.track_positions[end_move - 1]
            )
        if self.partner is not None and operation.meets[first_move:end_move].any():
            state_text = krl_sentences.MOVING_WITH_PARTNER.format(arm=self.partner.other)
            return syntax.with_state(state_text, calls, self.dialect)
        return calls

    def _moves(
        self, index: int, operation: layout.OperationProgram, parts: Iterable[layout.ModulePart]
    ) -> list[str]:
        """Return the statements of a subprogram with moves.

        The first move states all settings, each later one only those that change. After each move at which
        the arms meet, the subprogram with the meeting is called.
        """
        text, moves = self.moves[index], operation.moves
        out: list[str] = []
        if text is None or moves is None:
            return out
        calls = {}
        if self.partner is not None:
            calls = {
                row: f"{self.stem}_{partner_suffix(self.partner.phases(int(operation.meets[row])))}()"
                for row in np.flatnonzero(operation.meets).tolist()
            }
        for number, part in enumerate(parts):
            seconds = layout.format_short(float(moves.duration[part.first : part.last].sum()), 2)
            out += comment(
                f"Segment {layout.segment_mark(part.segment)}: {part.last - part.first} moves, {seconds} s."
            )
            for row in range(part.first, part.last):
                out += text.lines(row, fresh=number == 0 and row == part.first)
                if row in calls:  # both arms meet after this move
                    out.append(calls[row])
        return out


_HEADER_BYTES: Final = 1500
"""Upper bound on the size of a part without its moves [bytes]: header of a file, settings, comments."""
_CALL_BYTES: Final = 30
"""Upper bound on the size of the call that a handshake adds to each move [bytes]."""


def write(
    tasks: Sequence[layout.TaskProgram],
    job: layout.JobPrograms,
    plan: Plan,
    problem: Problem,
    margins: Margins,
) -> WrittenPrograms:
    """Write the programs of KUKA arms: the moves of all arms are split into files at the same targets.

    Args:
        tasks: Tasks to write.
        job: All tasks of the job.
        plan: The plan.
        problem: Problem of the plan.
        margins: Smallest margins of the plan, for the header.

    Raises:
        TandemError: ``post.*`` if the job cannot be written in KRL, such as names that are not allowed.
    """
    limits = problem.cell.controller
    declarations = {task.number: TaskDeclarations(task, plan) for task in tasks}
    moves = {task.number: _move_texts(task, plan, problem, declarations[task.number]) for task in tasks}
    call_bytes = _CALL_BYTES if job.handshake is not None else 0
    sizes = [
        np.max([_sizes(moves[task.number][i], len(task.operations[i].ids)) for task in tasks], axis=0)
        + call_bytes
        for i in range(len(plan.operations))
    ]
    split = layout.module_parts(job, sizes, _HEADER_BYTES, limits.max_moves, limits.max_bytes)
    out: dict[str, str] = {}
    for task in tasks:
        krl_task = KrlTask(task, declarations[task.number], moves[task.number])
        out |= _files(krl_task, job, plan, problem, margins, split)
    layout.require_sizes(out, limits, "files")
    return WrittenPrograms(out)


def _move_texts(
    task: layout.TaskProgram, plan: Plan, problem: Problem, data: TaskDeclarations
) -> list[MoveText | None]:
    """Return the text of the moves of each operation, None for an operation in which the arm has no moves.

    Each move has a text of its own. If the problem requires splines, the moves from one stop to the next form
    a spline block where that is possible.
    """
    controller = problem.cell.controller
    moves_by_operation = spline_blocks.operation_rows(task, data)
    single_move_texts = [
        None
        if moves is None
        else syntax.move_text(moves, controller.dialect, operation.axis_setpoint, _track_positions(operation))
        for moves, operation in zip(moves_by_operation, task.operations, strict=True)
    ]
    if controller.path == "slin":
        return single_move_texts
    block_runs_by_operation = spline_blocks.operation_runs(task, plan, data)
    return [
        None if text is None or moves is None else spline_blocks.with_blocks(text, moves, runs)
        for text, moves, runs in zip(
            single_move_texts, moves_by_operation, block_runs_by_operation, strict=True
        )
    ]


def _track_positions(operation: layout.OperationProgram) -> FloatArray | None:
    """Return the values (M,) [mm] of a coordinated track, None if the track does not move with the tool."""
    return None if operation.moves is None else operation.moves.track_positions


def _files(
    krl_task: KrlTask,
    job: layout.JobPrograms,
    plan: Plan,
    problem: Problem,
    margins: Margins,
    split: Sequence[layout.ModulePart],
) -> dict[str, str]:
    """Return the files of one task by path: main program, data list, and subprograms."""
    task = krl_task.program
    main = MainProgram(krl_task, job, plan, problem, split)
    stem = main.stem
    body = main.lines()
    assumptions = spline_blocks.SPLINE_ASSUMPTIONS if problem.cell.controller.path == "spline" else ()
    header_sentences = header(task, job, plan, margins, assumptions)
    head = [line for sentence in header_sentences for line in comment(sentence)]
    digest_comment = comment(f"Problem {plan.problem_name}, SHA-256 {plan.digest}.")
    dialect = problem.cell.controller.dialect
    digest_note = "; problem that this program was planned for; the proof starts from this digest"
    data_lines = krl_task.data.data_list(stem, [*head, digest_note], {"problem_digest": plan.digest})
    head = [*syntax.declarations(dialect), *head]
    files = {f"{stem}.src": _program(stem, head, body, main.bodies, dialect), f"{stem}.dat": data_lines}
    for name, lines in main.bodies.items():
        files[f"{name}.src"] = _program(name, digest_comment, lines, main.bodies, dialect)
    return {
        f"{task.arm.name}/{path}": "".join(
            f"{line}{layout.LINE_END}" for line in ["&ACCESS RVP", "&REL 1", *lines]
        )
        for path, lines in files.items()
    }


def _program(
    name: str,
    head: Sequence[str],
    body: Sequence[str],
    subprograms: Mapping[str, object],
    dialect: KrlDialect,
) -> list[str]:
    """Return the lines of a program, DEF to END, with statements ``body`` after lines ``head``.

    krc2 also needs declarations of the ``subprograms`` (names as keys) that it calls.
    """
    called = dict.fromkeys(line[:-2] for line in body if line.endswith("()") and line[:-2] in subprograms)
    declared = [f"EXT {other}()" for other in called] if dialect == "krc2" else []
    if dialect == "krc2" and any(line.startswith("BAS(") for line in body):
        declared.insert(0, syntax.EXT_BAS)
    return [f"DEF {name}()", *declared, *head, *body, "END"]


def _sizes(lines: MoveText | None, count: int) -> IntArray:
    """Return the size (M,) of each move of an operation [bytes]; ``count`` zeros if the arm does not move."""
    return np.zeros(count, dtype=np.int64) if lines is None else lines.sizes()
