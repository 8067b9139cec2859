"""RAPID programs of a job. Each task has modules for data, main, check and cuts, and a program list (.pgf).

For two controllers that share digital signals, the steps of :mod:`planner.languages.writing.handshake` are
written as text.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planner.catalogue.robots import OffsetParameters
from planner.claims import sentences
from planner.claims.sentences import HEADER, UNANSWERED
from planner.issues import issue_error
from planner.languages.rapid.writer import data as rapid_data
from planner.languages.rapid.writer.data import (
    ENTRY_SPEED_NAME,
    TASK_LIST,
    JointTargetNames,
    ToolNames,
    block_name,
    data_lines,
    load_name,
    meeting_name,
    wobj_name,
)
from planner.languages.rapid.writer.syntax import (
    FrameNames,
    action_lines,
    comment,
    identifier,
    message_box,
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


def partner_lines(partner: handshake.HandshakeSide, steps: Sequence[handshake.PartnerStep]) -> list[str]:
    """Return the statements of handshake steps.

    Args:
        partner: The handshake as one of the two programs sees it.
        steps: The steps to write.
    """
    return [line for step in steps for line in _step_lines(partner, step)]


def partner_call(partner: handshake.HandshakeSide, number: int) -> str:
    """Return the call after a move that ends at a meeting; "" for number 0, which means no meeting.

    Args:
        partner: The handshake as one of the two programs sees it.
        number: Number of the meeting.
    """
    return "" if number == 0 else f"{_procedure_name(partner.phases(number))};"


def partner_procedures(partner: handshake.HandshakeSide, task: layout.TaskProgram) -> dict[str, list[str]]:
    """Return the bodies of the handshake procedures that are called after moves, by name.

    Args:
        partner: The handshake as one of the two programs sees it.
        task: The task.
    """
    bodies = {
        _procedure_name(phases): partner_lines(partner, partner.meeting_after_move(number))
        for phases, number in partner.meeting_kinds(task).items()
    }
    return {name: bodies[name] for name in sorted(bodies)}


def partner_timeout_lines(partner: handshake.HandshakeSide) -> list[str]:
    """Return the statements by which an error handler reports a wait that timed out."""
    text = write_lines(UNANSWERED.format(other=partner.other))
    return ["IF ERRNO=ERR_WAIT_MAXTIME THEN", *(f"  {line}" for line in text), "ENDIF"]


def _procedure_name(phases: tuple[int, ...]) -> str:
    """Return the name of the procedure for meetings at which the lines take these levels in turn.

    It is handshake_0 or handshake_1 for one level (toggle), and handshake for several.
    """
    return f"handshake_{phases[0]}" if len(phases) == 1 else "handshake"


def _step_lines(partner: handshake.HandshakeSide, step: handshake.PartnerStep) -> list[str]:
    """Return the statements of one handshake step, with the signals of this program's arm."""
    signals = partner.handshake.of(partner.arm)
    match step:
        case handshake.SetLine(value):
            return [f"SetDO\\Sync,{identifier(signals.output)},{value};"]
        case handshake.AwaitLine(value, seconds):
            return [
                f"WaitDI {identifier(signals.input)},{value}\\MaxTime:={layout.format_short(seconds, 3)};"
            ]
        case handshake.AwaitRunning(value, seconds):
            return [
                "WaitDI "
                f"{identifier(signals.partner_running)},{value}\\MaxTime:={layout.format_short(seconds, 3)};"
            ]
        case handshake.StopAndAsk(text):
            return ["Stop;", *message_box(HEADER, text)]
        case handshake.AskOperator(text):
            return message_box(HEADER, text)
        case handshake.ShowText(text):
            return write_lines(text)
        case handshake.CommentStep(text):
            return comment(text)


NameArray = NDArray[np.str_]
"""Names of RAPID data, one for each move, (M,)."""

_LINES_UNCHANGED = "Error handlers do not change these lines: a change would signal an arrival."
"""Comment on the signal lines between two controllers."""
_INDENT = "  "
"""One level of indentation."""
_PROC_BYTES = 1500
"""Size of a procedure without its moves [bytes]."""
_CALL_BYTES = 20
"""Size of the call that a handshake adds to each move [bytes]."""


def write(
    tasks: Sequence[layout.TaskProgram],
    job: layout.JobPrograms,
    plan: Plan,
    problem: Problem,
    margins: Margins,
) -> WrittenPrograms:
    """Write the programs of ABB arms.

    Args:
        tasks: Tasks to write.
        job: All tasks of the job.
        plan: The plan.
        problem: Its problem.
        margins: Smallest margins of the plan, for the header.

    Raises:
        TandemError: ``post.*`` if the programs cannot be written, for example because a name is not valid.
    """
    zone_names = [_zones(job, i) for i in range(len(plan.operations))]
    moves = {task.number: _moves(task, job, zone_names) for task in tasks}
    # bytes of each move of each operation, the largest over the tasks: all tasks are split at the same moves
    sizes = [
        np.max(
            [
                [len(line) + len(_INDENT) * 2 + len(layout.LINE_END) for line in moves[task.number][i]]
                or [0] * len(task.operations[i].ids)
                for task in tasks
            ],
            axis=0,
        )
        for i in range(len(plan.operations))
    ]
    if job.handshake is not None:
        sizes = [size + _CALL_BYTES for size in sizes]
    limits = problem.cell.controller
    split = part_names(layout.module_parts(job, sizes, _PROC_BYTES, limits.max_moves, limits.max_bytes))
    out: dict[str, str] = {}
    for task in tasks:
        procedures = _MoveProcedures(split, moves[task.number])
        writer = _TaskWriter(task, job, plan, problem, margins, procedures)
        task_zones = {
            name for by_task in zone_names for name in by_task.get(task.number, np.array([])).tolist()
        }
        out |= {name: text.replace("\n", layout.LINE_END) for name, text in writer.files(task_zones).items()}
    layout.require_sizes(out, limits, "modules")
    return WrittenPrograms(out)


def module_suffix(controller: Controller) -> str:
    """Return the suffix of module files: RobotWare 7 does not load ``.mod``."""
    return ".mod" if controller.robotware == 6 else ".modx"


def _moving_tasks(job: layout.JobPrograms, operation: int) -> list[layout.TaskProgram]:
    return [task for task in job.tasks if task.operations[operation].moves is not None]


def _zones(job: layout.JobPrograms, operation: int) -> dict[int, NameArray]:
    """Return the zone names of the moves of an operation, by task number, for the tasks that move in it."""
    out = {}
    for task in _moving_tasks(job, operation):
        program = task.operations[operation]
        if program.moves is not None:
            out[task.number] = zones(program.moves, program.stop)
    return out


def _moves(
    task: layout.TaskProgram, job: layout.JobPrograms, zones_by_task: Sequence[Mapping[int, NameArray]]
) -> list[list[str]]:
    """Return one line for each move of a task, by operation; a list is empty if the arm has no moves in it.

    Moves have numbers (``ID``) where several tasks of one controller move synchronised.
    """
    out: list[list[str]] = []
    tools = ToolNames(task)
    for i, program in enumerate(task.operations):
        if program.moves is None:
            out.append([])
            continue
        ids = program.ids if len(_moving_tasks(job, i)) > 1 and job.handshake is None else None
        frames = FrameNames(tools.of(program.arm.tool), wobj_name(program.moves.frame, program.setup))
        zone_names = zones_by_task[i][task.number]
        out.append(move_lines(task.robot, program.moves, ids, zone_names, frames, program.axis_setpoint))
    return out


@dataclasses.dataclass(frozen=True)
class _MoveProcedures:
    """Moves of a task, and the procedures into which they are split.

    Attributes:
        names: Name of the procedure of each part.
        moves: Lines of the moves of each operation, empty for an operation in which the arm has no moves.
    """

    names: Mapping[layout.ModulePart, str]
    moves: Sequence[Sequence[str]]


class _TaskWriter:
    """Writes the modules of one task.

    Attributes:
        split: Name of the procedure of each part of the job.
        moves: Lines of the moves of each operation.
    """

    def __init__(
        self,
        task: layout.TaskProgram,
        job: layout.JobPrograms,
        plan: Plan,
        problem: Problem,
        margins: Margins,
        procedures: _MoveProcedures,
    ) -> None:
        self.task, self.job, self.plan, self.problem = task, job, plan, problem
        self.margins, self.split, self.moves = margins, procedures.names, procedures.moves
        self.joint_targets = JointTargetNames(task)
        self.tools = ToolNames(task)
        self.partner = handshake.HandshakeSide.of(task, job)
        self.signals = job.switched_signals(task)
        # tasks of two controllers may have the same name
        uses_handshake = problem.cell.controller.sync == "handshake"
        self.folder = task.arm.name if uses_handshake else task.task

    def files(self, zone_names: set[str]) -> dict[str, str]:
        """Return the task's files by relative name.

        Args:
            zone_names: Names of the zones that its moves use.
        """
        number = self.task.number
        names = (self.tools, self.joint_targets)
        data = data_lines(self.task, self.job, self.plan, self.problem, names, zone_names)
        bodies = {
            f"TandemData_{number}": data,
            f"TandemMain_{number}": self._main(),
            f"TandemCheck_{number}": self._check(),
        }
        parts = [part for part in self.split if self.task.operations[part.operation].moves is not None]
        for module in dict.fromkeys(part.module for part in parts):
            lines = [line for part in parts if part.module == module for line in [*self._part(part), ""]]
            bodies[f"TandemCut{module}_{number}"] = lines[:-1]
        self._require_unique_names(bodies)
        suffix = module_suffix(self.problem.cell.controller)
        files = {f"{name}{suffix}": self._module(name, lines) for name, lines in bodies.items()}
        listed = "".join(f"\t<Module>{name}</Module>\n" for name in files)
        head = '<?xml version="1.0" encoding="ISO-8859-1" ?>\n'
        files[f"Tandem_{number}.pgf"] = f"{head}<Program>\n{listed}</Program>\n"
        return {f"{self.folder}/{name}": text for name, text in files.items()}

    def _require_unique_names(self, bodies: Mapping[str, Sequence[str]]) -> None:
        """Check that all declarations of the task have different names.

        Raises:
            TandemError: Two of them have one name (``post.name``).
        """
        # the words of each line before brackets or a value: the last word of a declaration is its name
        heads = [
            line.split("(")[0].split(":=")[0].rstrip(";").split() for body in bodies.values() for line in body
        ]
        names = [
            words[-1].split("{")[0].lower()
            for words in heads
            if words and words[0] in ("PROC", "CONST", "PERS", "TASK", "VAR")
        ]
        duplicates = (
            sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
        )
        if duplicates:
            message = f"task {self.task.task} would use the name {duplicates[0]} twice"
            raise issue_error("post.name", message, hint="give the segment or tool another name")

    def _module(self, name: str, lines: Sequence[str]) -> str:
        """Return the text of a module with header comments and these lines, indented by one level."""
        inside = [f"{_INDENT}{line}" if line else "" for line in [*self._header(), "", *lines]]
        return "\n".join([f"MODULE {name}", *inside, "ENDMODULE", ""])

    def _header(self) -> list[str]:
        """Return the comment lines at the start of each module.

        They state the origin of the programs, and warn before a start.
        """
        task = self.task
        header_sentences = [
            f"Written by Tandem {__version__} for task {task.task}, {task.unit}: {task.robot.title}.",
            f"Arm {task.arm.name}, tool {tool_names(task)}. Written, not taught: plan again to change it.",
            *origin(self.plan, self.margins),
        ]
        if isinstance(task.robot.form, OffsetParameters):
            header_sentences.append(
                "Arm with an offset wrist: how it counts confdata is not confirmed, so they are all 0 here "
                "and ConfL is off: moves continue from the posture of the previous joint move. First run it "
                "without stock."
            )
        if task.robot.coupling is not None:
            header_sentences.append(
                "Parallel-rod arm: jointtargets hold the controller's axis 3 (serial angle plus axis 2). How "
                "this arm counts cfx is not confirmed, so ConfL is off here: first run it without stock."
            )
        if self.partner is not None:
            signals, wires, *drifts = meeting_sentences(self.partner, self.job)
            header_sentences += [signals, f"{wires} {_LINES_UNCHANGED}", *drifts]
        if self.signals:
            header_sentences.append(
                f"Error handlers switch {', '.join(self.signals)} off first. An emergency stop runs no "
                "handler: wire the power so that it goes off with the motors."
            )
        return [line for sentence in header_sentences for line in comment(sentence)]

    # ---- main module ----

    def _main(self) -> list[str]:
        """Return the lines of the main module.

        These are main, the handshake procedures, and a procedure for each operation.
        """
        conf = "Off" if self.task.robot.has_unnamed_postures else "On"
        body = [f"{rapid_data.CELL_CHECK};", "ConfJ\\On;", f"ConfL\\{conf};", "SingArea\\Off;"]
        units = [axis.unit for axis in self.task.arm.linear_axes]
        units += [] if self.task.table is None else [self.task.table.unit]
        activations = [f"ActUnit {identifier(unit)};" for unit in dict.fromkeys(units)]
        if activations:
            body += [*activations, "EOffsOff;"]  # an offset from another program would shift the axes
        clear = (sentences.CLEAR if self.problem.setups[0].steps else sentences.READY).format()
        if self.partner is not None:
            body += [
                *self._power_off_lines(),
                *partner_lines(self.partner, self.partner.start_steps(sentences.EARLIER_RUN, clear)),
            ]
        elif self.task.number == 1:
            body += self._power_off_lines()
            # the question also stops a controller that repeats its program from starting over
            body += message_box(sentences.HEADER, sentences.NO_WIRE.format() if self.job.coupled else clear)
        count = len(self.task.operations)
        body += [f"operation_{i};" for i in range(1, count + 1)]
        body += [] if self.partner is None else partner_lines(self.partner, self.partner.end_steps())
        out = self._procedure("main", body)
        if self.partner is not None:
            for name, lines in partner_procedures(self.partner, self.task).items():
                out += ["", *self._procedure(name, lines)]
        for i, operation in enumerate(self.task.operations):
            out += ["", *self._operation(i, operation)]
        return out

    def _check(self) -> list[str]:
        """Return the lines of the check module.

        These are comparisons with the controller's data, and their helper procedures.
        """
        task = self.task
        multiple_tasks = len(self.job.tasks) > 1 and self.partner is None
        arm_index = [arm.name for arm in self.problem.cell.arms].index(task.arm.name)
        robot = self.problem.cell.controller.robot_name(arm_index)
        body = rapid_data.cell_check_statements(task, self.job, self.plan, self.tools, robot)
        out = self._procedure(rapid_data.CELL_CHECK, body)
        axes = rapid_data.axes_check_statements(task)
        if axes:
            out += ["", *self._procedure(rapid_data.AXES_CHECK, axes)]
        return [*out, "", *rapid_data.check_helpers(multiple_tasks, bool(axes))]

    def _operation(self, index: int, operation: layout.OperationProgram) -> list[str]:
        body = comment(f"Operation {operation.name}.")
        for step in operation.steps:
            body += self._step(step, index)
        return self._procedure(f"operation_{index + 1}", body)

    def _step(self, step: layout.TaskStep, operation: int) -> list[str]:
        """Return the statements of one step of the operation with this index, from 0.

        A run of moves becomes calls of the procedures into which the moves are split.
        """
        match step:
            case layout.JointMove():
                name = self.joint_targets.of(step, operation + 1)
                tool = self.tools.of(self.task.operations[operation].arm.tool)
                ident = "" if step.id is None else f"\\ID:={step.id}"
                return [f"MoveAbsJ {name}{ident}\\NoEOffs,{ENTRY_SPEED_NAME},fine,{tool};"]
            case layout.AxesCheck():
                return [f"{rapid_data.AXES_CHECK};"]
            case layout.Meeting(number, reached, seconds) if self.partner is not None:
                steps = self.partner.meeting_after_solo(number, seconds)
                return [*comment(f"Meeting: {reached}"), *partner_lines(self.partner, steps)]
            case layout.SyncOn() | layout.SyncOff() if self.partner is not None:
                return []  # two controllers have no synchronised moves
            case layout.Meeting(number, reached):
                return [
                    *comment(f"{meeting_name(number)}: {reached}"),
                    f"WaitSyncTask {meeting_name(number)},{TASK_LIST};",
                ]
            case layout.SyncOn(number):
                return [f"SyncMoveOn {block_name(number, 'on')},{TASK_LIST};"]
            case layout.SyncOff(number):
                return [f"SyncMoveOff {block_name(number, 'off')};"]
            case layout.ActionStep(action):
                return action_lines(action)
            case layout.CarryLoad(load):
                return [f"GripLoad {load_name(load)};"]
            case layout.SegmentRun():
                parts = (part for part in self.split if part.operation == step.operation)
                return [f"{self.split[part]};" for part in parts if step.first <= part.first < step.last]

    # ---- procedures ----

    def _part(self, part: layout.ModulePart) -> list[str]:
        """Return the procedure with the moves of a part.

        A handshake follows each move that ends at a meeting.
        """
        operation = self.task.operations[part.operation]
        part_slice = slice(part.first, part.last)
        seconds = (
            layout.format_short(float(operation.moves.duration[part_slice].sum()), 2)
            if operation.moves is not None
            else "0"
        )
        body = comment(f"Segment {part.segment}: {part.last - part.first} moves, {seconds} s.")
        moves = self.moves[part.operation][part_slice]
        if self.partner is not None:
            calls = [partner_call(self.partner, number) for number in operation.meets[part_slice].tolist()]
            moves = [
                line for move_and_call in zip(moves, calls, strict=True) for line in move_and_call if line
            ]
        return self._procedure(self.split[part], [*body, *moves])

    def _procedure(self, name: str, body: Sequence[str]) -> list[str]:
        """Return the lines of a procedure with an ERROR section.

        It also has an UNDO section if the job switches power or has synchronised blocks.
        """
        out = [f"PROC {name}()", *(_INDENT + line for line in body)]
        out += ["ERROR", *(_INDENT + line for line in self._handler(name))]
        undo = [*self._power_off_lines(), *self._leave_block_lines()]
        if undo:
            # in every procedure: if the program pointer is moved, the controller may run the innermost UNDO
            # only (not confirmed)
            out += ["UNDO", *(_INDENT + line for line in ("! the program pointer was moved away", *undo))]
        return [*out, "ENDPROC"]

    def _power_off_lines(self) -> list[str]:
        return [f"SetDO {identifier(signal)},0;" for signal in self.signals]

    def _leave_block_lines(self) -> list[str]:
        return ["SyncMoveUndo;"] if self.job.blocks and self.partner is None else []

    def _handler(self, name: str) -> list[str]:
        """Return the body of the error handler of the procedure ``name``.

        It switches power off, stops the motion, shows the error, stops all tasks, and ends the program, so
        that no arm resumes.
        """
        warning = (sentences.JOINED if self.job.coupled else sentences.ALONE).format()
        stop = "Stop\\AllMoveTasks;" if len(self.job.tasks) > 1 and self.partner is None else "Stop;"
        message = quoted(f"{sentences.FAILED.format(procedure=name)} ")
        return [
            *self._power_off_lines(),
            "StopMove\\Quick;",
            f"TPWrite {message}\\Num:=ERRNO;",
            *([] if self.partner is None else partner_timeout_lines(self.partner)),
            f"TPWrite {quoted(warning)};",
            stop,
            "EXIT;",
        ]
