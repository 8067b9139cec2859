"""RAPID programs of a job: for each task a data module, a main module, cut modules, a list (.pgf).

For two controllers that share digital signals the steps of :mod:`planner.languages.writing.handshake` are
put as text.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planner.catalogue.robots import OffsetParameters
from planner.claims import sentences
from planner.claims.sentences import HEADER, UNANSWERED
from planner.issues import refusal
from planner.languages.rapid.writer import data as rapid_data
from planner.languages.rapid.writer.data import (
    ENTRY_SPEED_NAME,
    TASK_LIST,
    Stations,
    Tools,
    block,
    data_lines,
    load_name,
    meet,
    wobj_name,
)
from planner.languages.rapid.writer.syntax import (
    action_lines,
    box,
    comment,
    identifier,
    move_lines,
    part_names,
    quoted,
    write_lines,
    zones,
)
from planner.languages.writing import handshake, layout
from planner.languages.writing.header import meeting_sentences, origin, tool_names
from planner.languages.writing.language import Margins, WrittenPrograms
from planner.plans import Plan
from planner.problem import Controller, Problem
from planner.runtime.version import __version__


def partner_lines(partner: handshake.Partner, steps: Sequence[handshake.PartnerStep]) -> list[str]:
    """The statements of the steps."""
    return [line for step in steps for line in _step(partner, step)]


def partner_call(partner: handshake.Partner, number: int) -> str:
    """The call behind a move at which the meeting ``number`` is; empty for 0."""
    return "" if number == 0 else f"{_name(partner.phases(number))};"


def partner_procedures(partner: handshake.Partner, task: layout.TaskProgram) -> dict[str, list[str]]:
    """Bodies of the procedures that the task's moves are followed by, by name."""
    made = {_name(p): partner_lines(partner, partner.step(n)) for p, n in partner.kinds(task).items()}
    return {name: made[name] for name in sorted(made)}


def partner_unanswered(partner: handshake.Partner) -> list[str]:
    """What an error handler says of a wait that was over its time."""
    text = write_lines(UNANSWERED.filled(other=partner.other))
    return ["IF ERRNO=ERR_WAIT_MAXTIME THEN", *(f"  {line}" for line in text), "ENDIF"]


def _name(phases: tuple[int, ...]) -> str:
    return f"handshake_{phases[0]}" if len(phases) == 1 else "handshake"


def _step(partner: handshake.Partner, step: handshake.PartnerStep) -> list[str]:
    own = partner.handshake.of(partner.arm)
    match step:
        case handshake.SetLine(value):
            return [f"SetDO\\Sync,{identifier(own.output)},{value};"]
        case handshake.AwaitLine(value, seconds):
            return [f"WaitDI {identifier(own.input)},{value}\\MaxTime:={layout.short(seconds, 3)};"]
        case handshake.AwaitRunning(value, seconds):
            return [f"WaitDI {identifier(own.partner_running)},{value}\\MaxTime:={layout.short(seconds, 3)};"]
        case handshake.Halt(text):
            return ["Stop;", *box(HEADER, text)]
        case handshake.Ask(text):
            return box(HEADER, text)
        case handshake.Tell(text):
            return write_lines(text)
        case handshake.Note(text):
            return comment(text)


NameArray = NDArray[np.str_]

_LINES_KEPT = "Error handlers leave these lines alone: a change would be read as an arrival."
"""Said of the lines between two controllers."""
_INDENT = "  "
"""One level of indentation."""
_PROC_BYTES = 1500
"""Bytes of a procedure without its moves."""
_CALL_BYTES = 20
"""Bytes of the call that a handshake adds to each move."""


def write(
    tasks: Sequence[layout.TaskProgram], job: layout.Job, plan: Plan, problem: Problem, margins: Margins
) -> WrittenPrograms:
    """Write the programs of ABB arms. Raises :class:`TandemError` (``post.*``)."""
    zone = [_zones(job, i) for i in range(len(plan.operations))]
    moves = {task.number: _moves(task, job, zone) for task in tasks}
    sizes = [
        np.max(
            [
                [len(line) + len(_INDENT) * 2 + len(layout.LINE_END) for line in moves[t.number][i]]
                or [0] * len(t.operations[i].ids)
                for t in tasks
            ],
            axis=0,
        )
        for i in range(len(plan.operations))
    ]
    if job.handshake is not None:
        sizes = [size + _CALL_BYTES for size in sizes]
    limits = problem.cell.controller
    split = part_names(layout.parts(job, sizes, _PROC_BYTES, limits.max_moves, limits.max_bytes))
    out: dict[str, str] = {}
    for task in tasks:
        writer = _Task(task, job, plan, problem, margins, split, moves[task.number])
        own_zones = {name for op in zone for name in op.get(task.number, np.array([])).tolist()}
        out |= {name: text.replace("\n", layout.LINE_END) for name, text in writer.files(own_zones).items()}
    layout.require_sizes(out, limits, "modules")
    return WrittenPrograms(out)


def module_suffix(controller: Controller) -> str:
    """Ending of the names of modules: RobotWare 7 does not load ``.mod``."""
    return ".mod" if controller.robotware == 6 else ".modx"


def _moving(job: layout.Job, operation: int) -> list[layout.TaskProgram]:
    return [task for task in job.tasks if task.operations[operation].track is not None]


def _zones(job: layout.Job, operation: int) -> dict[int, NameArray]:
    """Zone names of each task's moves; stops are the same moves in all tasks."""
    out = {}
    for task in _moving(job, operation):
        program = task.operations[operation]
        if program.track is not None:
            out[task.number] = zones(program.track, program.stop)
    return out


def _moves(
    task: layout.TaskProgram, job: layout.Job, zone: Sequence[Mapping[int, NameArray]]
) -> list[list[str]]:
    out: list[list[str]] = []
    tools = Tools(task)
    for i, program in enumerate(task.operations):
        if program.track is None:
            out.append([])
            continue
        ids = program.ids if len(_moving(job, i)) > 1 and job.handshake is None else None
        names = (tools.of(program.arm.tool), wobj_name(program.track.frame, program.setup))
        own = zone[i][task.number]
        out.append(move_lines(task.robot, program.track, ids, own, *names, program.station))
    return out


class _Task:
    """Writes the modules of one task."""

    def __init__(
        self,
        task: layout.TaskProgram,
        job: layout.Job,
        plan: Plan,
        problem: Problem,
        margins: Margins,
        split: Mapping[layout.Part, str],
        moves: Sequence[Sequence[str]],
    ) -> None:
        self.task, self.job, self.plan, self.problem = task, job, plan, problem
        self.margins, self.split, self.moves = margins, split, moves
        self.stations = Stations(task)
        self.tools = Tools(task)
        self.partner = handshake.Partner.of(task, job)
        self.signals = job.switched(task)
        # tasks of two controllers may have the same name
        alone = problem.cell.controller.sync == "handshake"
        self.folder = task.arm.name if alone else task.task

    def files(self, zone_names: set[str]) -> dict[str, str]:
        """The task's files by relative name."""
        n = self.task.number
        names = (self.tools, self.stations)
        data = data_lines(self.task, self.job, self.plan, self.problem, names, zone_names)
        bodies = {f"TandemData_{n}": data, f"TandemMain_{n}": self._main(), f"TandemCheck_{n}": self._check()}
        own = [part for part in self.split if self.task.operations[part.operation].track is not None]
        for module in dict.fromkeys(part.module for part in own):
            lines = [line for part in own if part.module == module for line in [*self._part(part), ""]]
            bodies[f"TandemCut{module}_{n}"] = lines[:-1]
        self._unique(bodies)
        suffix = module_suffix(self.problem.cell.controller)
        files = {f"{name}{suffix}": self._module(name, lines) for name, lines in bodies.items()}
        listed = "".join(f"\t<Module>{name}</Module>\n" for name in files)
        head = '<?xml version="1.0" encoding="ISO-8859-1" ?>\n'
        files[f"Tandem_{n}.pgf"] = f"{head}<Program>\n{listed}</Program>\n"
        return {f"{self.folder}/{name}": text for name, text in files.items()}

    def _unique(self, bodies: Mapping[str, Sequence[str]]) -> None:
        """Raise an issue when two things of the task would have one name."""
        words = [
            line.split("(")[0].split(":=")[0].rstrip(";").split() for body in bodies.values() for line in body
        ]
        names = [
            w[-1].split("{")[0].lower()
            for w in words
            if w and w[0] in ("PROC", "CONST", "PERS", "TASK", "VAR")
        ]
        double = (
            sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
        )
        if double:
            message = f"two things of task {self.task.task} would be called {double[0]}"
            raise refusal("post.name", message, hint="give the segment or tool another name")

    def _module(self, name: str, lines: Sequence[str]) -> str:
        inside = [f"{_INDENT}{line}" if line else "" for line in [*self._header(), "", *lines]]
        return "\n".join([f"MODULE {name}", *inside, "ENDMODULE", ""])

    def _header(self) -> list[str]:
        task = self.task
        told = [
            f"Written by Tandem {__version__} for task {task.task}, {task.unit}: {task.robot.title}.",
            f"Arm {task.arm.name}, tool {tool_names(task)}. Written, not taught: plan again to change it.",
            *origin(self.plan, self.margins),
        ]
        if isinstance(task.robot.form, OffsetParameters):
            told.append(
                "Arm with an offset wrist: how it counts confdata is not settled, so they are all 0 here and "
                "ConfL is off: moves go on from the posture of the joint move before them. First run it "
                "without stock."
            )
        if task.robot.coupling is not None:
            told.append(
                "Parallel-rod arm: jointtargets hold the controller's axis 3 (serial angle plus axis 2). How "
                "this arm counts cfx is not settled, so ConfL is off here: first run it without stock."
            )
        if self.partner is not None:
            signals, wires, *drifts = meeting_sentences(self.partner, self.job)
            told += [signals, f"{wires} {_LINES_KEPT}", *drifts]
        if self.signals:
            told.append(
                f"Error handlers switch {', '.join(self.signals)} off first. An emergency stop runs no "
                "handler: wire the power so that it falls with the motors."
            )
        return [line for sentence in told for line in comment(sentence)]

    # ---- main module ----

    def _main(self) -> list[str]:
        conf = "Off" if self.task.robot.unnamed else "On"
        body = [f"{rapid_data.CELL_CHECK};", "ConfJ\\On;", f"ConfL\\{conf};", "SingArea\\Off;"]
        moved = [axis.unit for axis in self.task.arm.axes]
        moved += [] if self.task.table is None else [self.task.table.unit]
        units = [f"ActUnit {identifier(unit)};" for unit in dict.fromkeys(moved)]
        body += [*units, "EOffsOff;"] if units else []  # offsets of another program would shift the axes
        clear = (sentences.CLEAR if self.problem.setups[0].steps else sentences.READY).filled()
        if self.partner is not None:
            body += [
                *self._power_off(),
                *partner_lines(self.partner, self.partner.start(sentences.EARLIER, clear)),
            ]
        elif self.task.number == 1:
            body += self._power_off()
            # also keeps a controller that repeats its program from starting over by itself
            body += box(sentences.HEADER, sentences.NO_WIRE.filled() if self.job.coupled else clear)
        count = len(self.task.operations)
        body += [f"operation_{i};" for i in range(1, count + 1)]
        body += [] if self.partner is None else partner_lines(self.partner, self.partner.end())
        out = self._procedure("main", body)
        if self.partner is not None:
            for name, lines in partner_procedures(self.partner, self.task).items():
                out += ["", *self._procedure(name, lines)]
        for i, operation in enumerate(self.task.operations):
            out += ["", *self._operation(i, operation)]
        return out

    def _check(self) -> list[str]:
        task, together = self.task, len(self.job.tasks) > 1 and self.partner is None
        place = [arm.name for arm in self.problem.cell.arms].index(task.arm.name)
        robot = self.problem.cell.controller.robot(place)
        body = rapid_data.check_procedures(task, self.job, self.plan, self.tools, robot)
        out = self._procedure(rapid_data.CELL_CHECK, body)
        axes = rapid_data.axes_checks(task)
        if axes:
            out += ["", *self._procedure(rapid_data.AXES_CHECK, axes)]
        return [*out, "", *rapid_data.helpers(together, bool(axes))]

    def _operation(self, index: int, operation: layout.OperationProgram) -> list[str]:
        body = comment(f"Operation {operation.name}.")
        for step in operation.steps:
            body += self._step(step, index)
        return self._procedure(f"operation_{index + 1}", body)

    def _step(self, step: layout.Step, operation: int) -> list[str]:
        match step:
            case layout.Joints():
                name = self.stations.of(step, operation + 1)
                tool = self.tools.of(self.task.operations[operation].arm.tool)
                ident = "" if step.id is None else f"\\ID:={step.id}"
                return [f"MoveAbsJ {name}{ident}\\NoEOffs,{ENTRY_SPEED_NAME},fine,{tool};"]
            case layout.AxesLook():
                return [f"{rapid_data.AXES_CHECK};"]
            case layout.Meet(number, reached, seconds) if self.partner is not None:
                steps = self.partner.meet(number, seconds)
                return [*comment(f"Meeting: {reached}"), *partner_lines(self.partner, steps)]
            case layout.SyncOn() | layout.SyncOff() if self.partner is not None:
                return []
            case layout.Meet(number, reached):
                return [*comment(f"{meet(number)}: {reached}"), f"WaitSyncTask {meet(number)},{TASK_LIST};"]
            case layout.SyncOn(number):
                return [f"SyncMoveOn {block(number, 'on')},{TASK_LIST};"]
            case layout.SyncOff(number):
                return [f"SyncMoveOff {block(number, 'off')};"]
            case layout.Do(action):
                return action_lines(action)
            case layout.Carry(load):
                return [f"GripLoad {load_name(load)};"]
            case layout.Run():
                inside = (p for p in self.split if p.operation == step.operation)
                return [f"{self.split[p]};" for p in inside if step.first <= p.first < step.last]

    # ---- procedures ----

    def _part(self, part: layout.Part) -> list[str]:
        operation = self.task.operations[part.operation]
        rows = slice(part.first, part.last)
        seconds = (
            layout.short(float(operation.track.duration[rows].sum()), 2)
            if operation.track is not None
            else "0"
        )
        body = comment(f"Segment {part.segment}: {part.last - part.first} moves, {seconds} s.")
        moves = self.moves[part.operation][rows]
        if self.partner is not None:
            calls = [partner_call(self.partner, number) for number in operation.meets[rows].tolist()]
            moves = [line for pair in zip(moves, calls, strict=True) for line in pair if line]
        return self._procedure(self.split[part], [*body, *moves])

    def _procedure(self, name: str, body: Sequence[str]) -> list[str]:
        out = [f"PROC {name}()", *(_INDENT + line for line in body)]
        out += ["ERROR", *(_INDENT + line for line in self._handler(name))]
        leave = [*self._power_off(), *self._block_off()]
        if leave:
            # in every one: whether a pointer that is moved runs the innermost UNDO alone is not certain
            out += ["UNDO", *(_INDENT + line for line in ("! the program pointer was moved away", *leave))]
        return [*out, "ENDPROC"]

    def _power_off(self) -> list[str]:
        return [f"SetDO {identifier(signal)},0;" for signal in self.signals]

    def _block_off(self) -> list[str]:
        return ["SyncMoveUndo;"] if self.job.blocks and self.partner is None else []

    def _handler(self, name: str) -> list[str]:
        """Power off, then stop; the program ends there, so that no arm goes on by itself."""
        joined = (sentences.JOINED if self.job.coupled else sentences.ALONE).filled()
        stop = "Stop\\AllMoveTasks;" if len(self.job.tasks) > 1 and self.partner is None else "Stop;"
        note = quoted(f"{sentences.FAILED.filled(procedure=name)} ")
        return [
            *self._power_off(),
            "StopMove\\Quick;",
            f"TPWrite {note}\\Num:=ERRNO;",
            *([] if self.partner is None else partner_unanswered(self.partner)),
            f"TPWrite {quoted(joined)};",
            stop,
            "EXIT;",
        ]
