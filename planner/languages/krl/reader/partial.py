"""Reads KRL programs that the planner did not write, as far as they use the supported subset."""

import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from planner.languages.krl.reader import reader
from planner.languages.krl.reader.flow import KrlRunner
from planner.languages.krl.reader.panel import OperatorPanel
from planner.languages.krl.reader.syntax_tree import (
    CommentStatement,
    InitMotion,
    InputPoll,
    KrlProgram,
    KrlStatement,
    OutputStatement,
)
from planner.languages.krl.reader.values import NO_LOAD
from planner.problem import Arm, Problem
from planner.programs.language import Files, Gap, PartialPath, PartlyRead
from planner.programs.signals import controller_signals
from planner.programs.steps import FlowError, MoveStep, TextFault, Tool
from planner.programs.text import unexpected_characters

MOVE_PATTERN: Final = re.compile(
    r"^[ \t]*((?:(?:S?PTP|S?LIN|S?CIRC)(?:_REL)?|SPL|ASYPTP))\b(?!\s*=)", re.IGNORECASE | re.MULTILINE
)
"""Instructions that move the arm."""


def read_partly(problem: Problem, arm: Arm, files: Files) -> PartlyRead:
    """Read programs as far as possible.

    Args:
        problem: The problem.
        arm: Arm of the programs.
        files: Texts of the programs and data lists by path.

    Returns:
        The programs, the moves that could be read with a gap for each part that could not, and the faults.
    """
    controller = problem.cell.controller
    text = reader.read(files, controller.max_bytes, controller.dialect)
    faults = [
        *text.faults,
        *(fault for file, content in files.items() for fault in unexpected_characters(file, content)),
    ]
    path: PartialPath = ()
    if text.main is not None and text.data is not None:
        base = arm.base if text.base is None else text.base
        panel = OperatorPanel(text.dialect, arm.name, ())
        runner = _PartialKrlRunner(text.programs, text.data, base, controller_signals(problem, arm), panel)
        runner.set_up(faults)
        runner.run_main(text.main)
        faults += runner.flow_faults
        path = tuple(runner.path)
    return PartlyRead(text, path, tuple(faults))


class _PartialKrlRunner(KrlRunner):
    """Executes the statements that could be read, and records a gap for each part that could not.

    After a gap the pose of the arm is unknown. ``path`` has the moves and gaps in order.
    """

    def set_up(self, faults: Sequence[TextFault]) -> None:
        """Set up the state of the partial run; call before :meth:`run_main`."""
        self.flow_faults: list[TextFault] = []
        self.path: list[MoveStep | Gap] = []
        self.faulty_lines = {(fault.file, fault.line) for fault in faults}
        self.flushed = 0

    def run_main(self, main: KrlProgram) -> None:
        """Execute the main program until its end or until the budget of statements is used up."""
        self.program = main
        self.entered.add(main.name.lower())
        self._open.append(main.name.lower())
        with suppress(FlowError):
            self._block(main.body)
        self._flush()

    def _flush(self) -> None:
        """Copy the moves among the new steps to the path."""
        self.path += [step for step in self.steps[self.flushed :] if isinstance(step, MoveStep)]
        self.flushed = len(self.steps)

    def _block(self, body: Sequence[KrlStatement]) -> None:
        """Execute statements one after the other, and record a gap for each part that is not understood.

        Such a part is a line with a fault between two statements or in one, or a statement that cannot be
        executed. Outputs, waits for inputs and comments do not affect the path; only the segment of a comment
        counts.
        """
        next_line = 0
        for statement in body:
            if isinstance(statement, CommentStatement | OutputStatement | InputPoll | InitMotion):
                if isinstance(statement, CommentStatement) and statement.kind == "segment":
                    self.procedure = statement.text
                continue
            lines = range(next_line, statement.line + 1)
            if any((self.program.file, line) in self.faulty_lines for line in lines):
                self._flush()
                self.path.append(Gap())
                self.pose = None
            next_line = statement.line + 1
            if (self.program.file, statement.line) in self.faulty_lines:
                continue
            program, depth, opened = self.program, self.depth, list(self._open)
            try:
                super()._block([statement])
            except FlowError as wrong:
                self.flow_faults += wrong.faults
                self.program, self.depth, self._open = program, depth, opened
                self._flush()
                self.path.append(Gap())
                self.pose = None
                if self.budget < 0:
                    raise

    def _refuse_position(self, line: int, wrong: bool, message: str) -> None:
        """Accept every position: programs of other origin put moves and settings anywhere."""

    def _tool(self, line: int) -> tuple[Tool, str]:
        """Return the tool in force without a load, because programs of other origin name loads freely."""
        self._require_settings(line, ("$tool",))
        item = self.data.items.get(str(self.settings["$tool"]))
        if item is None or item.kind != "frame":
            self._fail(line, "the tool of this move is not read")
        return Tool(held=True, pose=item.value, load=NO_LOAD), item.name

    def _check_panel_state(self, statement: KrlStatement) -> None:
        """Ignore the panel, which is up to the program's owner."""

    def _check_panel_end(self, line: int) -> None:
        """Ignore how the program ends."""

    def _emit_load_change(self, line: int) -> None:
        """Ignore loads."""
