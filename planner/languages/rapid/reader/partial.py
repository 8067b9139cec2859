"""Modules of any origin, read as far as possible."""

import dataclasses
import re
from bisect import bisect_left, insort
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.languages.rapid.reader.evaluation import UNKNOWN
from planner.languages.rapid.reader.flow import Runner
from planner.languages.rapid.reader.reader import Limits, read_task
from planner.languages.rapid.reader.syntax_tree import (
    Data,
    For,
    If,
    Module,
    Procedure,
    Statement,
    Value,
    While,
)
from planner.problem import Arm, Problem
from planner.programs.language import Files, Gap, PartlyRead
from planner.programs.steps import Fault, FlowError, JointTarget, MoveStep, RobTarget
from planner.programs.text import strange
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.proof.replay.moves import flange_at

MOVE_PATTERN: Final = re.compile(
    r"(?:^|;|\bTHEN\b|\bDO\b|\bELSE\b)[ \t]*((?:Move(?:AbsJ|ExtJ|PnP|[LJC]\w*)"
    r"|Trigg(?:AbsJ|[LJ]IOs|[LJC])|Search(?:ExtJ|[LC])|(?:Arc|Spot|Disp|Paint|Cap|Contact|EGMMove|FCPress|Laser|Glue|Cut)[LCJ]\w*))\b(?!\s*(?:\(|:=))",
    re.IGNORECASE | re.MULTILINE,
)
"""Instructions that move the arm."""
_SHIFTS: Final = re.compile(
    r"\b(PDisp\w*|EOffs\w*|SoftAct|CorrCon|CorrWrite|TuneServo|ActUnit|DeactUnit|SetSysData|ReadCfgData"
    r"|WriteCfgData|WorldAccLim|ContactL|IndAMove|IndCMove)\b",
    re.IGNORECASE,
)
"""What may move the places of all moves behind it."""


def read_partly(problem: Problem, arm: Arm, files: Files) -> PartlyRead:
    """Read modules as far as possible.

    Args:
        problem: The problem.
        arm: The arm of the task.
        files: Texts of the modules by path.
    """
    text = read_task(files, Limits(line=10_000, bytes=problem.cell.controller.max_bytes))
    faults = [*text.faults, *(fault for file, own in files.items() for fault in strange(file, own))]
    runner = _PartialRunner(text.modules, faults, files)
    runner.go()
    way = (part if isinstance(part, Gap) else _by_joints(arm, part) for part in runner.way)
    return PartlyRead(text, tuple(way), (*faults, *runner.lost))


def _by_joints(arm: Arm, move: MoveStep) -> MoveStep:
    """A MoveJ as the move by joints that it is, where its confdata say to which."""
    if move.kind != "MoveJ" or not isinstance(move.target, RobTarget) or not move.wobj.fixed:
        return move
    machine = arm_model.machine_of(arm.data)
    q = inverse_kinematics.select_by_confdata(
        machine, flange_at(move, arm.base)[None], np.array([move.target.conf])
    )[0]
    if not np.isfinite(q).all():
        return move
    target = JointTarget(machine.data.to_controller(q), move.target.external)
    return dataclasses.replace(move, kind="MoveAbsJ", target=target)


class _PartialRunner(Runner):
    """Runs what is read; notes the rest."""

    def __init__(self, modules: Sequence[Module], faults: Sequence[Fault], files: Mapping[str, str]) -> None:
        if modules:
            super().__init__(modules)
        self.lost: list[Fault] = []
        self.way: list[MoveStep | Gap] = []
        self.bad: dict[str, list[int]] = {}
        for fault in faults:
            insort(self.bad.setdefault(fault.file, []), fault.line)
        self.rows = {file: text.split("\n") for file, text in files.items()}
        self.taken = 0
        self.empty = not modules

    def go(self) -> None:
        """All from main on."""
        if self.empty:
            return
        try:
            self.run("main")
        except FlowError as wrong:
            self.lost += wrong.faults
        self._flush()

    def _flush(self) -> None:
        """Takes over moves of the straight way."""
        self.way += [step for step in self.steps[self.taken :] if isinstance(step, MoveStep)]
        self.taken = len(self.steps)

    def _gap(self, shifts: bool = False) -> None:
        self._flush()
        self.way.append(Gap(shifts))

    def _between(self, line: int, to: int) -> bool:
        """Whether a line from ``line`` on and before ``to`` is not read; then there is a gap."""
        bad = self.bad.get(self.module.file, [])
        first = bisect_left(bad, line)
        if first == len(bad) or bad[first] >= to:
            return False
        rows = self.rows.get(self.module.file, [])[line - 1 : to - 1]
        self._gap(any(_SHIFTS.search(row.split("!")[0]) for row in rows))
        return True

    def block(self, statements: Sequence[Statement]) -> None:
        """Each statement that is read, with gaps where lines between them are not."""
        if statements:
            first = statements[0].line
            self._between(self._opener(first), first)
        for number, statement in enumerate(statements):
            rest = statements[number + 1 : number + 2]
            self._one(statement, rest[0].line if rest else self._end(statement.line))

    def _opener(self, line: int) -> int:
        """The first of the lines right above one that hold nothing that is read."""
        bad, rows = self.bad.get(self.module.file, []), self.rows.get(self.module.file, [])
        while line > 1:
            here = bisect_left(bad, line - 1)
            if rows[line - 2].split("!")[0].strip() and not (here < len(bad) and bad[here] == line - 1):
                break
            line -= 1
        return line

    def _end(self, line: int) -> int:
        """The first line behind the procedure that a line is in."""
        lines = [p.line for p in self.module.procedures if p.line > line]
        return min(lines, default=self.module.lines + 1)

    def _one(self, statement: Statement, following: int) -> None:
        line = statement.line
        following = max(following, line + 1)
        compound = isinstance(statement, If | While | For)
        if self._between(line, line + 1 if compound or following > line + 20 else following):
            return
        here = (self.module, self.procedure, self.depth, self.condition)
        try:
            self.statement(statement)
        except FlowError as wrong:
            if self.names.work < 0:
                raise
            self.module, self.procedure, self.depth, self.condition = here
            self.lost += wrong.faults
            self._gap()
        self._between(line + 1, following)

    def call(self, start: int, name: str) -> None:
        """As ever; a procedure of which something is not read ends in a gap."""
        super().call(start, name)
        found = self.find(name.rpartition(":")[2].lower())
        if found is not None and isinstance(found[1], Procedure):
            here, self.module = self.module, found[0]
            self._between(found[1].line, self._end(found[1].line))
            self.module = here

    def _choice(
        self, statement: Statement, condition: str, run: Callable[[], None], repeats: bool = False
    ) -> None:
        """What hangs on a condition is no part of the way, and leaves a gap where it is not read."""
        self._flush()
        way, taken = self.way, self.taken
        self.way, self.taken = [], 0
        try:
            super()._choice(statement, condition, run, repeats)
        finally:
            aside, self.way, self.taken = self.way, way, taken
            if aside:
                shifts = any(part.shifts for part in aside if isinstance(part, Gap))
                self.way.append(Gap(shifts))

    def _while(self, statement: While) -> None:
        """The first round of a loop: where a later one begins is where this one ends."""
        if self.value(statement.condition, "bool") is True:
            self._gap()
            self.lost.append(self.fail(statement.start, "a loop: its first round is read alone").faults[0])
            self.block(statement.body)
            self._gap()
            return
        super()._while(statement)

    def _initial(self, module: Module, data: Data) -> Value:
        """Return no value for data with a fault."""
        lines = [*(item.line for item in module.data), *(item.line for item in module.procedures)]
        behind = [line for line in lines if line > data.line]
        bad = self.bad.get(module.file, [])
        first = bisect_left(bad, data.line)
        if first < len(bad) and bad[first] < min(behind, default=module.lines + 1):
            return UNKNOWN
        return super()._initial(module, data)
