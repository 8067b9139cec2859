"""Programs of any origin, read as far as possible."""

import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from planner.languages.krl.reader import reader
from planner.languages.krl.reader.flow import Runner
from planner.languages.krl.reader.panel import Panel
from planner.languages.krl.reader.syntax_tree import Listen, Output, Program, Said, Start, Statement
from planner.languages.krl.reader.values import NO_LOAD
from planner.problem import Arm, Problem
from planner.programs.language import Files, Gap, PartlyRead, Way
from planner.programs.signals import krl_signals
from planner.programs.steps import Fault, FlowError, MoveStep, Tool
from planner.programs.text import strange

MOVE_PATTERN: Final = re.compile(
    r"^[ \t]*((?:(?:S?PTP|S?LIN|S?CIRC)(?:_REL)?|SPL|ASYPTP))\b(?!\s*=)", re.IGNORECASE | re.MULTILINE
)
"""Instructions that move the arm."""


def read_partly(problem: Problem, arm: Arm, files: Files) -> PartlyRead:
    """Read programs as far as possible.

    Args:
        problem: The problem.
        arm: The arm of the programs.
        files: Texts of the programs and data lists by path.
    """
    controller = problem.cell.controller
    text = reader.read(files, controller.max_bytes, controller.dialect)
    faults = [*text.faults, *(fault for file, own in files.items() for fault in strange(file, own))]
    way: Way = ()
    if text.main is not None and text.data is not None:
        base = arm.base if text.base is None else text.base
        panel = Panel(text.dialect, arm.name, ())
        runner = _PartialRunner(text.programs, text.data, base, krl_signals(problem, arm), panel)
        runner.begin(faults)
        runner.go(text.main)
        faults += runner.lost
        way = tuple(runner.way)
    return PartlyRead(text, way, tuple(faults))


class _PartialRunner(Runner):
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

    def _block(self, body: Sequence[Statement]) -> None:
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

    def _hear(self, statement: Statement) -> None:
        """What is shown and asked is left to its owner, too."""

    def _close(self, line: int) -> None:
        """So is how the program ends."""

    def _carry(self, line: int) -> None:
        """Loads are left to their owner."""
