"""Programs of others, read as far as the readers know them: what is not read is noted, and reading goes on
behind it.

Here nothing is refused and nothing is proven: :mod:`planner.proof.partial` says what of the moves is.
"""

from __future__ import annotations

import re
from bisect import bisect_left, insort
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePosixPath

from planner.languages.krl.reader import flow, reader
from planner.languages.krl.reader.panel import Panel
from planner.languages.krl.reader.syntax_tree import Listen, Output, Program, Said, Start
from planner.languages.krl.reader.syntax_tree import Statement as KrlStatement
from planner.languages.krl.reader.values import NO_LOAD
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
from planner.programs import job, signals, stages
from planner.programs.steps import Fault, FlowError, MoveStep, Tool
from planner.programs.text import settled, strange

_RAPID_MOVE = re.compile(
    r"(?:^|;|\bTHEN\b|\bDO\b|\bELSE\b)[ \t]*((?:Move(?:AbsJ|ExtJ|PnP|[LJC]\w*)"
    r"|Trigg(?:AbsJ|[LJ]IOs|[LJC])|Search(?:ExtJ|[LC])|(?:Arc|Spot|Disp|Paint|Cap|Contact|EGMMove|FCPress|Laser|Glue|Cut)[LCJ]\w*))\b(?!\s*(?:\(|:=))",
    re.IGNORECASE | re.MULTILINE,
)
"""Instructions of RAPID that move the arm."""
_KRL_MOVE = re.compile(
    r"^[ \t]*((?:(?:S?PTP|S?LIN|S?CIRC)(?:_REL)?|SPL|ASYPTP))\b(?!\s*=)", re.IGNORECASE | re.MULTILINE
)
"""Instructions of KRL that move the arm."""
_SCRIPT_MOVE = re.compile(r"\b((?:move[jlpc]|servo[jc]|speed[jl]|optimove[jl]))[ \t]*\(")
"""Instructions of URScript that move the arm."""
_SHIFTS = re.compile(
    r"\b(PDisp\w*|EOffs\w*|SoftAct|CorrCon|CorrWrite|TuneServo|ActUnit|DeactUnit|SetSysData|ReadCfgData"
    r"|WriteCfgData|WorldAccLim|ContactL|IndAMove|IndCMove)\b",
    re.IGNORECASE,
)
"""What may move the places of all moves behind it."""
KNOWN_MOVES = frozenset({"MoveAbsJ", "MoveL", "PTP", "LIN", "SLIN", "movej", "movel"})
"""Moves whose way between targets is known."""


@dataclass(frozen=True, eq=False)
class Gap:
    """Something between two moves that is not read: what happens there is not known. ``shifts``: it may shift
    all places behind it."""

    shifts: bool = False


@dataclass(frozen=True, eq=False)
class Read:
    """One arm's programs: ``way`` of moves and gaps, ``files`` as read, ``unread`` by file and line, and
    ``moves``: (file, line) of each move instruction in the texts, however it is written."""

    arm: Arm
    name: str
    unit: str
    files: Mapping[str, str]
    way: tuple[MoveStep | Gap, ...]
    places: Mapping[str, str]
    unread: tuple[Fault, ...]
    moves: tuple[tuple[str, int], ...]


def read(problem: Problem, programs: Mapping[str, str]) -> tuple[tuple[Read, ...], tuple[str, ...]]:
    """What each arm's programs say, and files that belong to no arm. Where one arm alone has programs, all
    files of its language are its own."""
    texts = {path: settled(path, text)[0] for path, text in programs.items() if not stages.beside(path)}
    files, strays = job.task_files(problem, texts)
    names = job.task_names(problem)
    arms = dict(zip(names, problem.cell.arms, strict=False))
    used = {arm for operation in problem.operations for arm in operation.arms}
    if len(mine := [name for name, arm in arms.items() if arm.name in used]) == 1:
        ends = job.endings(arms[mine[0]])
        own = {path: text for path, text in texts.items() if PurePosixPath(path).suffix.lower() in ends}
        files, strays = {mine[0]: own}, [path for path in texts if path not in own]
    out = []
    for number, (name, arm) in enumerate(arms.items()):
        if files.get(name):
            units = problem.cell.controller.units
            unit = units[number] if number < len(units) else ""
            one = _krl if job.speaks_krl(arm) else _script if job.speaks_urscript(arm) else _rapid
            out.append(one(problem, arm, name, unit, files[name]))
    return tuple(out), tuple(path for path in strays if not path.lower().endswith(".pgf"))


def _sorted(faults: Sequence[Fault]) -> tuple[Fault, ...]:
    """One fault a line, in order."""
    first: dict[tuple[str, int], Fault] = {}
    for fault in faults:
        first.setdefault((fault.file, fault.line), fault)
    return tuple(first[key] for key in sorted(first))


def _moves(files: Mapping[str, str], pattern: re.Pattern[str], comment: str) -> tuple[tuple[str, int], ...]:
    found = []
    for file, text in files.items():
        for number, row in enumerate(text.split("\n"), 1):
            code = re.sub(r'"[^"]*"', '""', row).split(comment)[0]
            found += [(file, number)] * len(pattern.findall(code))
    return tuple(found)


# ---- RAPID ----


def _rapid(problem: Problem, arm: Arm, name: str, unit: str, files: Mapping[str, str]) -> Read:
    text = read_task(files, Limits(line=10_000, bytes=problem.cell.controller.max_bytes))
    faults = [*text.faults, *(fault for file, own in files.items() for fault in strange(file, own))]
    runner = _Rapid(text.modules, faults, files)
    runner.go()
    places = {module.name: module.file for module in text.modules}
    unread = _sorted([*faults, *runner.lost])
    moves = _moves(files, _RAPID_MOVE, "!")
    return Read(arm, name, unit, files, tuple(runner.way), places, unread, moves)


class _Rapid(Runner):
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
        """Data with a fault have no value."""
        lines = [*(item.line for item in module.data), *(item.line for item in module.procedures)]
        behind = [line for line in lines if line > data.line]
        bad = self.bad.get(module.file, [])
        first = bisect_left(bad, data.line)
        if first < len(bad) and bad[first] < min(behind, default=module.lines + 1):
            return UNKNOWN
        return super()._initial(module, data)


# ---- KRL ----


def _krl(problem: Problem, arm: Arm, name: str, unit: str, files: Mapping[str, str]) -> Read:
    controller = problem.cell.controller
    text = reader.read(files, controller.max_bytes, controller.dialect)
    faults = [*text.faults, *(fault for file, own in files.items() for fault in strange(file, own))]
    way: list[MoveStep | Gap] = []
    if text.main is not None and text.data is not None:
        declared = text.base_of(arm)
        base = arm.base if declared is None else declared
        panel = Panel(text.dialect, arm.name, ())
        runner = _Krl(text.programs, text.data, base, signals.krl_signals(problem, arm), panel)
        runner.begin(faults)
        runner.go(text.main)
        faults += runner.lost
        way = runner.way
    places = {file.rpartition("/")[2]: file for file in files}
    moves = _moves(files, _KRL_MOVE, ";")
    return Read(arm, name, unit, files, tuple(way), places, _sorted(faults), moves)


class _Krl(flow.Runner):
    """Runs what is read; notes the rest."""

    def begin(self, faults: Sequence[Fault]) -> None:
        """Before :meth:`go`."""
        self.lost: list[Fault] = []
        self.way: list[MoveStep | Gap] = []
        self.bad = {(fault.file, fault.line) for fault in faults}
        self.taken = 0

    def go(self, main: Program) -> None:
        """All of the main program."""
        self.program = main
        self.entered.add(main.name.lower())
        self._open.append(main.name.lower())
        with suppress(FlowError):
            self._block(main.body)
        self._flush()

    def _flush(self) -> None:
        self.way += [step for step in self.steps[self.taken :] if isinstance(step, MoveStep)]
        self.taken = len(self.steps)

    def _block(self, body: Sequence[KrlStatement]) -> None:
        last = 0
        for statement in body:
            if isinstance(statement, Said | Output | Listen | Start):
                if isinstance(statement, Said) and statement.kind == "segment":
                    self.procedure = statement.text
                continue
            lines = range(last, statement.line + 1)
            if any((self.program.file, line) in self.bad for line in lines):
                self._flush()
                self.way.append(Gap())
                self.here = None
            last = statement.line + 1
            if (self.program.file, statement.line) in self.bad:
                continue
            here, depth, opened = self.program, self.depth, list(self._open)
            try:
                super()._block([statement])
            except FlowError as wrong:
                self.lost += wrong.faults
                self.program, self.depth, self._open = here, depth, opened
                self._flush()
                self.way.append(Gap())
                self.here = None
                if self.work < 0:
                    raise

    def _misplaced(self, line: int, wrong: bool, message: str) -> None:
        """Others put moves and settings where they like."""

    def _tool(self, line: int) -> tuple[Tool, str]:
        self._needed(line, ("$tool",))
        item = self.data.items.get(str(self.settings["$tool"]))
        if item is None or item.kind != "frame":
            self._fail(line, "the tool of this move is not read")
        return Tool(True, item.value, NO_LOAD), item.name

    def _hear(self, statement: KrlStatement) -> None:
        """What is shown and asked is left to its owner, too."""

    def _close(self, line: int) -> None:
        """So is how the program ends."""

    def _carry(self, line: int) -> None:
        """Loads are left to their owner."""


# ---- URScript ----


def _script(problem: Problem, arm: Arm, name: str, unit: str, files: Mapping[str, str]) -> Read:
    """A program that is read as a whole, or not at all: of others' statements, each may change the way."""
    task, faults, lost = job.script_task(problem, arm, name, files)
    unread = [*faults, *lost, *(fault for file, own in files.items() for fault in strange(file, own))]
    way = () if unread else tuple(step for step in task.steps if isinstance(step, MoveStep))
    places = {file.rpartition("/")[2]: file for file in files}
    return Read(arm, name, unit, files, way, places, _sorted(unread), _moves(files, _SCRIPT_MOVE, "#"))
