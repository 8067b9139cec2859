"""Reads modules of any origin as far as possible: what cannot be read becomes a gap in the path of moves."""

import dataclasses
import re
from bisect import bisect_left, insort
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.languages.rapid.reader.evaluation import UNKNOWN
from planner.languages.rapid.reader.flow import RapidRunner
from planner.languages.rapid.reader.reader import ModuleLimits, read_task
from planner.languages.rapid.reader.syntax_tree import (
    DataDeclaration,
    For,
    If,
    Module,
    Procedure,
    RapidStatement,
    Value,
    While,
)
from planner.problem import Arm, Problem
from planner.programs.language import Files, Gap, PartlyRead
from planner.programs.steps import FlowError, JointTarget, MoveStep, RobTarget, TextFault
from planner.programs.text import unexpected_characters
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.replay.moves import flange_at

MOVE_PATTERN: Final = re.compile(
    r"(?:^|;|\bTHEN\b|\bDO\b|\bELSE\b)[ \t]*((?:Move(?:AbsJ|ExtJ|PnP|[LJC]\w*)"
    r"|Trigg(?:AbsJ|[LJ]IOs|[LJC])|Search(?:ExtJ|[LC])"
    r"|(?:Arc|Spot|Disp|Paint|Cap|Contact|EGMMove|FCPress|Laser|Glue|Cut)[LCJ]\w*))\b(?!\s*(?:\(|:=))",
    re.IGNORECASE | re.MULTILINE,
)
"""Instructions that move the arm."""
_SHIFTS: Final = re.compile(
    r"\b(PDisp\w*|EOffs\w*|SoftAct|CorrCon|CorrWrite|TuneServo|ActUnit|DeactUnit|SetSysData|ReadCfgData"
    r"|WriteCfgData|WorldAccLim|ContactL|IndAMove|IndCMove)\b",
    re.IGNORECASE,
)
"""Instructions that may shift the targets of all later moves."""


def read_partly(problem: Problem, arm: Arm, files: Files) -> PartlyRead:
    """Read the modules of one task as far as possible, and follow its main flow.

    The result shows the path of programs that were not written by the planner. Lines that cannot be read
    become gaps.

    Args:
        problem: The problem.
        arm: Arm of the task.
        files: Texts of the modules by path.

    Returns:
        The modules, the moves of the main flow with gaps between them, and the faults.
    """
    text = read_task(files, ModuleLimits(line=10_000, bytes=problem.cell.controller.max_bytes))
    faults = [
        *text.faults,
        *(fault for file, content in files.items() for fault in unexpected_characters(file, content)),
    ]
    runner = _PartialRapidRunner(text.modules, faults, files)
    runner.run_main()
    path = (part if isinstance(part, Gap) else _to_joint_move(arm, part) for part in runner.path)
    return PartlyRead(text, tuple(path), (*faults, *runner.flow_faults))


def _to_joint_move(arm: Arm, move: MoveStep) -> MoveStep:
    """Convert a MoveJ to the MoveAbsJ that ends at the joints that its confdata select.

    Any other move, and a MoveJ whose target is not fixed or not reached, is returned unchanged.
    """
    if move.kind != "MoveJ" or not isinstance(move.target, RobTarget) or not move.wobj.fixed:
        return move
    machine = arm_model.robot_machine(arm.data)
    q = inverse_kinematics.select_by_confdata(
        machine, flange_at(move, arm.base)[None], np.array([move.target.conf])
    )[0]
    if not np.isfinite(q).all():
        return move
    target = JointTarget(machine.data.to_controller(q), move.target.external)
    return dataclasses.replace(move, kind="MoveAbsJ", target=target)


class _PartialRapidRunner(RapidRunner):
    """Executes the statements that could be read, and records gaps for the others.

    Attributes:
        path: Moves and gaps of the main flow so far.
        faulty_lines: Sorted lines with a fault, by file.
        source_lines: Lines of the text, by file.
        flushed: Number of ``steps`` whose moves are in ``path``.
    """

    def __init__(
        self, modules: Sequence[Module], faults: Sequence[TextFault], files: Mapping[str, str]
    ) -> None:
        if modules:
            super().__init__(modules)
        self.flow_faults: list[TextFault] = []
        self.path: list[MoveStep | Gap] = []
        self.faulty_lines: dict[str, list[int]] = {}
        for fault in faults:
            insort(self.faulty_lines.setdefault(fault.file, []), fault.line)
        self.source_lines = {file: text.split("\n") for file, text in files.items()}
        self.flushed = 0
        self.empty = not modules

    def run_main(self) -> None:
        """Execute everything from main on."""
        if self.empty:
            return
        try:
            self.run("main")
        except FlowError as wrong:
            self.flow_faults += wrong.faults
        self._flush()

    def _flush(self) -> None:
        """Append new moves of the main flow to the path."""
        self.path += [step for step in self.steps[self.flushed :] if isinstance(step, MoveStep)]
        self.flushed = len(self.steps)

    def _append_gap(self, shifts: bool = False) -> None:
        """Append a gap to the path; ``shifts`` means that it may shift the targets of later moves."""
        self._flush()
        self.path.append(Gap(shifts))

    def _gap_if_unread(self, line: int, end: int) -> bool:
        """Record a gap if a line in [``line``, ``end``) could not be read; return whether there is one."""
        faulty_lines = self.faulty_lines.get(self.module.file, [])
        index = bisect_left(faulty_lines, line)
        if index == len(faulty_lines) or faulty_lines[index] >= end:
            return False
        unread = self.source_lines.get(self.module.file, [])[line - 1 : end - 1]
        self._append_gap(any(_SHIFTS.search(text.split("!")[0]) for text in unread))
        return True

    def block(self, statements: Sequence[RapidStatement]) -> None:
        """Execute each statement that was read, with gaps for unread lines before, between and after them."""
        if statements:
            first = statements[0].line
            self._gap_if_unread(self._first_unread_line(first), first)
        for number, statement in enumerate(statements):
            following = statements[number + 1 : number + 2]
            self._statement_or_gap(
                statement, following[0].line if following else self._line_after_procedure(statement.line)
            )

    def _first_unread_line(self, line: int) -> int:
        """Return the first of the contiguous lines above ``line`` that are faulty, blank or only a comment.

        Without such a line the result is ``line``.
        """
        faulty_lines = self.faulty_lines.get(self.module.file, [])
        source_lines = self.source_lines.get(self.module.file, [])
        while line > 1:
            index = bisect_left(faulty_lines, line - 1)
            faulty = index < len(faulty_lines) and faulty_lines[index] == line - 1
            if source_lines[line - 2].split("!")[0].strip() and not faulty:
                break
            line -= 1
        return line

    def _line_after_procedure(self, line: int) -> int:
        """Return the first line of the next procedure after ``line``, or the line after the module's end."""
        starts = [procedure.line for procedure in self.module.procedures if procedure.line > line]
        return min(starts, default=self.module.lines + 1)

    def _statement_or_gap(self, statement: RapidStatement, next_line: int) -> None:
        """Execute a statement, or record a gap if one of its lines has a fault or it cannot be followed.

        ``next_line`` is the line of the next statement that was read.

        Raises:
            FlowError: The statement budget is used up, so that reading ends.
        """
        line = statement.line
        next_line = max(next_line, line + 1)
        compound = isinstance(statement, If | While | For)
        # The blocks of a compound statement record their own gaps. More than 20 lines are not one statement:
        # faults further down belong to statements that were not read, and leave a gap after this one.
        if self._gap_if_unread(line, line + 1 if compound or next_line > line + 20 else next_line):
            return
        state = (self.module, self.procedure, self.depth, self.condition)
        try:
            self.statement(statement)
        except FlowError as wrong:
            if self.names.budget < 0:
                raise  # the program has no end: no later statement could run either
            self.module, self.procedure, self.depth, self.condition = state
            self.flow_faults += wrong.faults
            self._append_gap()
        self._gap_if_unread(line + 1, next_line)

    def call(self, start: int, name: str) -> None:
        """Execute a procedure at the place of its call. If it has unread lines, a gap follows."""
        super().call(start, name)
        declaration = self.find(name.rpartition(":")[2].lower())
        if declaration is not None and isinstance(declaration[1], Procedure):
            caller = self.module
            self.module = declaration[0]
            self._gap_if_unread(declaration[1].line, self._line_after_procedure(declaration[1].line))
            self.module = caller

    def _choice(
        self, statement: RapidStatement, condition: str, run: Callable[[], None], repeats: bool = False
    ) -> None:
        """Collect a branch under a run-time condition: one gap stands for all its moves and gaps."""
        self._flush()
        path, flushed = self.path, self.flushed
        self.path = []
        self.flushed = 0  # the base class collects the branch in a new list of steps
        try:
            super()._choice(statement, condition, run, repeats)
        finally:
            branch_path, self.path, self.flushed = self.path, path, flushed
            if branch_path:
                shifts = any(part.shifts for part in branch_path if isinstance(part, Gap))
                self.path.append(Gap(shifts))

    def _while(self, statement: While) -> None:
        """Execute only the first iteration of a loop whose condition holds, between two gaps.

        The gaps stand for the moves to the start of later iterations, which begin elsewhere. A loop whose
        condition is unknown or FALSE is executed as in the base class.
        """
        if self.value(statement.condition, "bool") is True:
            self._append_gap()
            self.flow_faults.append(
                self.flow_error(statement.start, "a loop: only its first iteration is read").faults[0]
            )
            self.block(statement.body)
            self._append_gap()
            return
        super()._while(statement)

    def _initial_value(self, module: Module, data: DataDeclaration) -> Value:
        """Return the value of a datum when main starts.

        It is UNKNOWN also if a line from its declaration to the next declaration has a fault.
        """
        lines = [*(item.line for item in module.data), *(item.line for item in module.procedures)]
        later_lines = [line for line in lines if line > data.line]
        faulty_lines = self.faulty_lines.get(module.file, [])
        index = bisect_left(faulty_lines, data.line)
        if index < len(faulty_lines) and faulty_lines[index] < min(later_lines, default=module.lines + 1):
            return UNKNOWN
        return super()._initial_value(module, data)
