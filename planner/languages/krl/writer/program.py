"""KRL programs of a job: for each KUKA arm a main program, its data list, and files with moves.

The main program calls subprograms with moves. PTP speeds are whole percents of the axes' speeds at
which the TCP keeps its limit. For two controllers that share digital signals the steps of
:mod:`planner.languages.writing.handshake` are put as text.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.catalogue.robots import RobotData
from planner.cell.kinematics import forward
from planner.claims import sentences
from planner.geometry.arrays import FloatArray, IntArray
from planner.languages.krl import sentences as krl_sentences
from planner.languages.krl.writer import spline_blocks, syntax
from planner.languages.krl.writer import syntax as linear_moves
from planner.languages.krl.writer.data import Data
from planner.languages.krl.writer.syntax import Lines, comment, name
from planner.languages.writing import handshake, layout
from planner.languages.writing.header import header
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.languages.writing.outer_axes import outer_names, outer_speeds
from planner.plans import Plan
from planner.problem import Controller, KrlDialect, Problem
from planner.targets import Action


def partner_lines(
    partner: handshake.Partner,
    controller: Controller,
    steps: Sequence[handshake.PartnerStep],
    shown: bool = True,
) -> list[str]:
    """The statements of the steps; ``shown``: the panel says so while the program waits, which in a file with
    a meeting it does already."""
    waiting = krl_sentences.WAITING.filled(arm=partner.other)
    own = partner.handshake.of(partner.arm)
    output, given = controller.number(partner.arm, own.output), controller.number(partner.arm, own.input)
    runs = controller.number(partner.arm, own.partner_running)
    out: list[str] = []
    for step in steps:
        match step:
            case handshake.SetLine(value):
                out.append(f"$OUT[{output}]={_level(value)}")
            case handshake.AwaitLine(value, seconds):
                wait = _wait(f"$IN[{given}]=={_level(1 - value)}", seconds, partner.unanswered)
                out += syntax.during(waiting, wait, controller.dialect) if shown else wait
            case handshake.AwaitRunning(value, seconds):
                wait = _wait(f"$IN[{runs}]=={_level(1 - value)}", seconds, partner.not_as_wanted(value))
                out += syntax.during(waiting, wait, controller.dialect) if shown else wait
            case handshake.Halt(text):  # krc2: the HALT of the question is a stop itself
                out += ["HALT"] if controller.dialect == "krc4" else []
                out += syntax.question_lines(text, controller.dialect)
            case handshake.Ask(text):
                out += syntax.question_lines(text, controller.dialect)
            case handshake.Tell(text):
                out += syntax.message_lines(text, controller.dialect)
            case handshake.Note(text):
                out += comment(text)
    return out


def partner_suffix(phases: tuple[int, ...]) -> str:
    """The end of the name of the file with a meeting."""
    return f"meet_{phases[0]}" if len(phases) == 1 else "meet"


def _level(value: int) -> str:
    return "TRUE" if value else "FALSE"


def _wait(condition: str, seconds: float, unanswered: str) -> list[str]:
    """Wait as long as the condition holds; the program halts whenever the time is over, and waits again."""
    return [
        "$TIMER[1]=0",
        "$TIMER_STOP[1]=FALSE",
        f"WHILE {condition}",
        f"IF $TIMER[1]>{math.ceil(1e3 * seconds)} THEN",
        *comment(f"{unanswered} Start waits for it again."),
        "HALT",
        "$TIMER[1]=0",
        "ENDIF",
        "WAIT SEC 0.01",
        "ENDWHILE",
        "$TIMER_STOP[1]=TRUE",
    ]


UNKNOWN_START_PERCENT: Final = 10
"""Percents of a PTP from a place that is not known: the first one of a program."""
_SPEED_SAMPLES: Final = 400
"""Places of a PTP at which the speed of the TCP is looked at."""
ALL_PERCENT: Final = 100
"""Percents of its own speed that a track may take as it goes along: less would slow down the tool."""
_SPEED_SHARE: Final = 0.99
"""Share of the speed limit that a PTP may use, for the fastest place may lie between two of these."""


def ptp_percent(
    robot: RobotData, start: FloatArray, end: FloatArray, tcp: FloatArray, limit: float, most: float
) -> int:
    """Percents of a PTP between joints (6,) [rad] with the TCP ``tcp`` (4, 4) on the flange.

    The slowest axis runs at its share of the catalogue's speed and the others keep pace, so at the share p
    the TCP's speed is p times what it is at full speed: at most ``limit`` [m/s]. ``most`` [-]: the
    largest share. At least 1.
    """
    q = start + np.linspace(0.0, 1.0, _SPEED_SAMPLES + 1)[:, None] * (end - start)
    point = (forward(robot, q) @ tcp)[:, :3, 3]
    fastest = float(np.linalg.norm(np.diff(point, axis=0), axis=1).max()) * _SPEED_SAMPLES
    seconds = float((np.abs(end - start) / robot.velocity).max())
    share = most if fastest <= 0.0 else min(most, _SPEED_SHARE * limit * seconds / fastest)
    return max(1, int(np.floor(100.0 * share + 1e-9)))


class Main:
    """Writes the main program; :attr:`bodies` are then those of its subprograms by name."""

    def __init__(
        self,
        task: layout.TaskProgram,
        job: layout.Job,
        plan: Plan,
        problem: Problem,
        data: Data,
        split: Sequence[layout.Part],
        moves: Sequence[Lines | None],
        stem: str,
    ) -> None:
        self.task, self.job, self.problem, self.data = task, job, problem, data
        self.split, self.moves, self.stem = split, moves, stem
        self.controller = problem.cell.controller
        self.dialect = problem.cell.controller.dialect
        self.partner = handshake.Partner.of(task, job)
        self.bodies: dict[str, list[str]] = {}
        self.speeds = outer_speeds(task, plan, problem)
        self.along = {axis.column: task.base[:3, :3].T @ axis.axis for axis in task.arm.axes}
        self._held: layout.Load | None = None
        self._stood: layout.Outer | None = None
        self._at: FloatArray | None = None
        self._percent = 0
        self._slow = False

    def lines(self) -> list[str]:
        """The statements of the main program."""
        out = [*syntax.INTERRUPT, "BAS(#INITMOV,0)", "$ADVANCE=3", "$IPO_MODE=#BASE", "$ORI_TYPE=#VAR"]
        out += [self._switch(signal, False) for signal in self.job.switched(self.task)]
        out += [*syntax.prepared(self.dialect), *self._look()]
        clear = (sentences.KRL_CLEAR if self.problem.setups[0].steps else sentences.KRL_READY).filled()
        if self.partner is None:
            out += syntax.question_lines(clear, self.dialect)
        else:
            steps = self.partner.start(krl_sentences.KRL_EARLIER, clear)
            out += partner_lines(self.partner, self.controller, steps)
        for i, operation in enumerate(self.task.operations):
            out += self._operation(i, operation)
        if self.partner is not None:
            out += partner_lines(self.partner, self.controller, self.partner.end())
            for phases, number in self.partner.kinds(self.task).items():
                steps = self.partner.step(number)
                body = partner_lines(self.partner, self.controller, steps, shown=False)
                self.bodies[f"{self.stem}_{partner_suffix(phases)}"] = body
        return out

    def _operation(self, index: int, operation: layout.OperationProgram) -> list[str]:
        out = comment(f"Operation {operation.name}.")
        if any(isinstance(step, layout.Joints | layout.Run) for step in operation.steps):
            out += [
                f"$TOOL={self.data.tool(operation.arm.tool)}",
                f"$LOAD={self.data.load(operation.arm.tool, self._held)}",
                f"$BASE={self.data.base(operation)}",
            ]
        plain = (step for step in operation.steps if not isinstance(step, layout.SyncOn | layout.SyncOff))
        for moving, steps in itertools.groupby(plain, lambda step: isinstance(step, layout.Run)):
            if moving:
                out += self._runs(index, operation, [step for step in steps if isinstance(step, layout.Run)])
            else:
                done = list(steps)
                for i, step in enumerate(done):
                    out += self._step(step, index, operation, layout.question_follows(done[i + 1 :]))
        return out

    def _step(
        self, step: layout.Step, index: int, operation: layout.OperationProgram, asks: bool
    ) -> list[str]:
        """The lines of a step; ``asks``: behind it and what else is told stands a question."""
        match step:
            case layout.Joints():
                return self._ptp(step, index, operation)
            case layout.AxesLook(station):
                names = outer_names(self.task)
                looks = (syntax.axis_check(names[c], c, value, self.dialect) for c, value in station)
                return [line for look in looks for line in look]
            case layout.Meet(number, reached, seconds) if self.partner is not None:
                steps = self.partner.meet(number, seconds)
                lines = partner_lines(self.partner, self.controller, steps)
                return [*comment(f"Meeting: {reached}"), *lines]
            case layout.Do(action):
                return self._action(action, asks)
            case layout.Carry(load):
                self._held = load
                return [f"$LOAD={self.data.load(operation.arm.tool, load)}"]
        return []

    def _ptp(self, step: layout.Joints, index: int, operation: layout.OperationProgram) -> list[str]:
        limits = self.problem.settings
        share = UNKNOWN_START_PERCENT
        if self._at is not None:
            tcp, most = operation.arm.tool.tcp, limits.speed_fraction
            share = ptp_percent(self.task.robot, self._at, step.q, tcp, limits.tcp_speed, most)
        out = [] if self._slow else self._outer_speeds()
        self._slow = True
        out += [f"$VEL_AXIS[{i}]={share}" for i in range(1, 7)] if share != self._percent else []
        self._at, self._percent = step.q, share
        if step.place == "start" and operation.track is not None:
            return [*out, f"PTP {self.data.start(operation, step.q, index + 1)}"]
        out.append(f"PTP {self.data.joint(step, index + 1)}")
        if self.along and step.station != self._stood:
            self._stood = step.station
            out += self._look()  # an axis has taken the foot elsewhere
        return out

    def _look(self) -> list[str]:
        return syntax.robroot_check(self.task.arm.name, self.dialect, self.along)

    def _outer_speeds(self) -> list[str]:
        """Speeds of the external axes on the way to stations, whole percents of their own."""
        shares = {column: speed.most / speed.own for column, speed in self.speeds.items()}
        percents = {column: max(1, int(np.floor(100.0 * share + 1e-9))) for column, share in shares.items()}
        return [f"$VEL_EXTAX[{column + 1}]={percent}" for column, percent in percents.items()]

    def _action(self, action: Action, asks: bool) -> list[str]:
        match action.kind:
            case "message":
                return syntax.message_lines(action.text, self.dialect, before_question=asks)
            case "confirm":
                return syntax.question_lines(action.text, self.dialect)
            case "on" | "off":
                return [self._switch(action.signal, action.kind == "on")]
            case "wait":
                return [f"WAIT SEC {layout.short(action.seconds, 3)}"]
            case "input":
                return self._input(action)

    def _input(self, action: Action) -> list[str]:
        """A wait for an input of the process. When its time is over everything that the program switches goes
        off, the panel says so, and the program never goes on, whatever is started."""
        number = self.controller.number(self.task.arm.name, action.signal)
        seconds = math.ceil(1e3 * action.seconds)
        text = krl_sentences.NO_INPUT.filled(signal=action.signal, seconds=1e-3 * seconds)
        return [
            "$TIMER[1]=0",
            "$TIMER_STOP[1]=FALSE",
            f"WHILE $IN[{number}]==FALSE ; {action.signal}",
            f"IF $TIMER[1]>{seconds} THEN",
            *(self._switch(signal, False) for signal in self.job.switched(self.task)),
            *syntax.ended(text, self.dialect),
            "ENDIF",
            "WAIT SEC 0.01",
            "ENDWHILE",
            "$TIMER_STOP[1]=TRUE",
        ]

    def _switch(self, signal: str, on: bool) -> str:
        number = self.controller.number(self.task.arm.name, signal)
        return f"$OUT[{number}]={'TRUE' if on else 'FALSE'} ; {signal}"

    # ---- moves ----

    def _runs(self, index: int, operation: layout.OperationProgram, runs: Sequence[layout.Run]) -> list[str]:
        """Calls of the subprograms with the moves of runs that follow one another."""
        if operation.track is None:
            return []
        first, last = runs[0].first, runs[-1].last
        inside = (p for p in self.split if p.operation == index and first <= p.first < last)
        calls = []
        for _, grouped in itertools.groupby(inside, lambda part: part.module):
            word = f"{self.stem}_{len(self.bodies) + 1}"
            self.bodies[word] = self._moves(index, operation, grouped)
            calls.append(f"{word}()")
        self._at = operation.track.q[last - 1]
        if operation.track.outer is not None:  # the tool's speed says how fast the track goes along
            calls = [f"$VEL_EXTAX[{layout.TRACK_COLUMN + 1}]={ALL_PERCENT}", *calls]
            self._slow, self._stood = False, syntax.ridden(operation.station, operation.track.outer[last - 1])
        if self.partner is not None and operation.meets[first:last].any():
            together = krl_sentences.TOGETHER.filled(arm=self.partner.other)
            return syntax.during(together, calls, self.dialect)
        return calls

    def _moves(
        self, index: int, operation: layout.OperationProgram, inside: Iterable[layout.Part]
    ) -> list[str]:
        """The lines of a file: all settings stand before its first move."""
        lines, track = self.moves[index], operation.track
        out: list[str] = []
        if lines is None or track is None:
            return out
        calls = {}
        if self.partner is not None:
            calls = {
                row: f"{self.stem}_{partner_suffix(self.partner.phases(int(operation.meets[row])))}()"
                for row in np.flatnonzero(operation.meets).tolist()
            }
        for number, part in enumerate(inside):
            seconds = layout.short(float(track.duration[part.first : part.last].sum()), 2)
            out += comment(
                f"Segment {layout.mark(part.segment)}: {part.last - part.first} moves, {seconds} s."
            )
            for row in range(part.first, part.last):
                out += lines.of(row, fresh=number == 0 and row == part.first)
                out += [calls[row]] if row in calls else []
        return out


_STEM_LENGTH: Final = 16
"""Characters of the problem's name in names of files."""
_HEADER_BYTES: Final = 1500
"""Bytes of a part without its moves: the header of a file, settings, comments."""
_CALL_BYTES: Final = 30
"""Bytes of the call that a handshake adds to each move."""


def write(
    tasks: Sequence[layout.TaskProgram], job: layout.Job, plan: Plan, problem: Problem, margins: Margins
) -> WrittenPrograms:
    """Write the programs of KUKA arms. Raises :class:`TandemError` (``post.*``)."""
    limits = problem.cell.controller
    data = {task.number: Data(task, plan) for task in tasks}
    moves = {task.number: _lines(task, plan, problem, data[task.number]) for task in tasks}
    call = _CALL_BYTES if job.handshake is not None else 0
    sizes = [
        np.max([_sizes(moves[t.number][i], len(t.operations[i].ids)) for t in tasks], axis=0) + call
        for i in range(len(plan.operations))
    ]
    split = layout.parts(job, sizes, _HEADER_BYTES, limits.max_moves, limits.max_bytes)
    out: dict[str, str] = {}
    for task in tasks:
        out |= _files(task, job, plan, problem, margins, data[task.number], split, moves[task.number])
    layout.require_sizes(out, limits, "files")
    return WrittenPrograms(out)


def _lines(
    task: layout.TaskProgram, plan: Plan, problem: Problem, data: Data
) -> list[linear_moves.Lines | None]:
    controller = problem.cell.controller
    rows = spline_blocks.operation_rows(task, data)
    lines = [
        None
        if own is None
        else linear_moves.lines(own, controller.dialect, operation.station, _ridden(operation))
        for own, operation in zip(rows, task.operations, strict=True)
    ]
    if controller.path == "slin":
        return lines
    found = spline_blocks.operation_blocks(task, plan, data)
    return [
        None if text is None or own is None else spline_blocks.with_blocks(text, own, runs)
        for text, own, runs in zip(lines, rows, found, strict=True)
    ]


def _ridden(operation: layout.OperationProgram) -> FloatArray | None:
    """Values (M,) [mm] of a track that goes along, None where it stands."""
    return None if operation.track is None else operation.track.outer


def _files(
    task: layout.TaskProgram,
    job: layout.Job,
    plan: Plan,
    problem: Problem,
    margins: Margins,
    data: Data,
    split: Sequence[layout.Part],
    moves: Sequence[linear_moves.Lines | None],
) -> dict[str, str]:
    stem = name(problem.name, _STEM_LENGTH)
    main = Main(task, job, plan, problem, data, split, moves, stem)
    body = main.lines()
    assumptions = spline_blocks.SPLINE_ASSUMPTIONS if problem.cell.controller.path == "spline" else ()
    told = header(task, job, plan, margins, assumptions)
    head = [line for sentence in told for line in comment(sentence)]
    brief = comment(f"Problem {plan.problem_name}, SHA-256 {plan.digest}.")
    dialect = problem.cell.controller.dialect
    note = "; what this program was planned for; the proof starts from these"
    listed = data.list(stem, [*head, note], {"problem_digest": plan.digest})
    head = [*syntax.declarations(dialect), *head]
    files = {f"{stem}.src": _program(stem, head, body, main.bodies, dialect), f"{stem}.dat": listed}
    for word, lines in main.bodies.items():
        files[f"{word}.src"] = _program(word, brief, lines, main.bodies, dialect)
    return {
        f"{task.arm.name}/{path}": "".join(
            f"{line}{layout.LINE_END}" for line in ["&ACCESS RVP", "&REL 1", *lines]
        )
        for path, lines in files.items()
    }


def _program(
    word: str, head: Sequence[str], body: Sequence[str], known: Mapping[str, object], dialect: KrlDialect
) -> list[str]:
    """A DEF; what it calls is declared where the dialect wants that."""
    called = dict.fromkeys(line[:-2] for line in body if line.endswith("()") and line[:-2] in known)
    declared = [f"EXT {other}()" for other in called] if dialect == "krc2" else []
    if dialect == "krc2" and any(line.startswith("BAS(") for line in body):
        declared.insert(0, syntax.EXT_BAS)
    return [f"DEF {word}()", *declared, *head, *body, "END"]


def _sizes(lines: linear_moves.Lines | None, count: int) -> IntArray:
    return np.zeros(count, dtype=np.int64) if lines is None else lines.sizes()
