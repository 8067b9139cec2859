"""Torches in the straight path of a URScript program.

This module reads the statements that are required while a torch burns, and its function and thread.

A controller may be paused anywhere, and continues there. Its output is low then, and stays low. So a torch
burns only while nothing moves yet, or while a thread monitors it.
"""

import enum
from collections.abc import Callable
from typing import NoReturn

from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.reader import syntax_tree


class _TorchState(enum.Enum):
    NOT_BURNING = "no torch burns"
    LIT = "it has been lit, and nothing has moved"
    BURNS = "the program has waited for it"
    GUARDED = "the thread watches it"
    LEFT = "the thread has ended"


class TorchChecks:
    """Checks the statements of a program on the outputs that threads of torches monitor.

    Attributes:
        program: The program.
        fail: Refuses a statement.
        output: Names an output by its number.
        input: Names an input by its number.
        torch_outputs: Outputs of torches.
        state: State of the torch that burns.
        number: Its output.
        checked: Outputs that the program has checked at its start.
    """

    def __init__(
        self,
        program: syntax_tree.ScriptProgram,
        fail: Callable[[syntax_tree.Statement, str], NoReturn],
        output: Callable[[int], str],
        given: Callable[[int], str],
    ) -> None:
        self.program, self.fail, self.output, self.input = program, fail, output, given
        self.torch_outputs = {
            function.torch_output
            for function in program.torches.values()
            if function.torch_output is not None
        }
        self.state, self.number = _TorchState.NOT_BURNING, -1
        self.checked: set[int] = set()

    def watches(self, number: int) -> bool:
        """Return whether an output is a torch's."""
        return number in self.torch_outputs

    def check_functions(self) -> None:
        """Check that functions and threads switch all power off, and show why they end the program."""
        switched = {s.number for s in self.program.body if isinstance(s, syntax_tree.SetOutput) and s.value}
        for name, function in self.program.torches.items():
            if left := sorted(map(self.output, switched - set(function.switched_off))):
                self.fail(function, f"{name} leaves {', '.join(left)} on")
            if function.torch_output is None:
                continue
            signal = self.output(function.torch_output)
            expected_text = urscript_sentences.TORCH_STOOD.format(signal=signal)
            if function.given is not None:
                expected_text = urscript_sentences.ARC_LOST.format(
                    signal=signal, ok_signal=self.input(function.given)
                )
            if function.text != expected_text:
                self.fail(function, f"{name} shows {function.text!r}; expected: {expected_text!r}")

    def process(self, statement: syntax_tree.Statement) -> None:
        """Process the next statement."""
        if isinstance(statement, syntax_tree.OutputLowCheck) and self.watches(statement.number):
            self._check_low(statement)
        elif isinstance(statement, syntax_tree.AwaitArc):
            self._await(statement)
        elif isinstance(statement, syntax_tree.ArcWatchdog):
            self._guard(statement)
        elif isinstance(statement, syntax_tree.SetOutput) and self.watches(statement.number):
            self._switch(statement)
        elif self.state in (_TorchState.LIT, _TorchState.BURNS):
            if not isinstance(statement, syntax_tree.SleepStatement):
                self.fail(statement, f"{self._lit} is on, and no thread watches it yet")
        elif self.state is _TorchState.LEFT:
            self.fail(statement, f"{self._lit} is on, and no thread watches it now")
        elif self.state is _TorchState.GUARDED and not isinstance(statement, syntax_tree.ScriptLinearMove):
            self.fail(statement, f"only movel is allowed while {self._lit} is on")

    def end(self, last: syntax_tree.Statement) -> None:
        """Check the state after the last statement."""
        if self.state is not _TorchState.NOT_BURNING:
            self.fail(last, f"the program ends while {self._lit} is on")

    @property
    def _lit(self) -> str:
        return self.output(self.number)

    def _function(self, statement: syntax_tree.AwaitArc | syntax_tree.ArcWatchdog) -> syntax_tree.ArcFunction:
        function = self.program.torches.get(statement.name)
        if function is None:
            self.fail(statement, f"there is no {statement.name}")
        return function

    def _check_low(self, check: syntax_tree.OutputLowCheck) -> None:
        expected_text = urscript_sentences.STAYS_ON.format(signal=self.output(check.number))
        if check.text != expected_text:
            self.fail(check, f"the check of a torch shows {check.text!r}; expected: {expected_text!r}")
        if check.switched_off != (check.number,):
            what = f"only {self.output(check.number)} must be switched off where it is found to stay on"
            self.fail(check, what)
        if check.number in self.checked:
            self.fail(check, f"the program checks again whether {self.output(check.number)} stays on")
        self.checked.add(check.number)

    def _await(self, wait: syntax_tree.AwaitArc) -> None:
        function = self._function(wait)
        if self.state is not _TorchState.LIT:
            self.fail(wait, "a wait for an arc must directly follow its output's rise")
        expected_text = urscript_sentences.NO_ARC.format(
            signal=self.input(function.given or 0), seconds=wait.seconds
        )
        if function.text != expected_text:
            self.fail(wait, f"{wait.name} shows {function.text!r}; expected: {expected_text!r}")
        self.state = _TorchState.BURNS

    def _guard(self, guard: syntax_tree.ArcWatchdog) -> None:
        thread = self._function(guard)
        if not guard.on:
            if self.state is not _TorchState.GUARDED or thread.torch_output != self.number:
                self.fail(guard, f"{guard.name} does not run")
            self.state = _TorchState.LEFT
            return
        if self.state not in (_TorchState.LIT, _TorchState.BURNS) or thread.torch_output != self.number:
            self.fail(guard, f"{guard.name} starts where its torch has not just been lit")
        if (self.state is _TorchState.BURNS) != (thread.given is not None):
            self.fail(guard, f"the program waits for another torch than that of {guard.name}")
        self.state = _TorchState.GUARDED

    def _switch(self, statement: syntax_tree.SetOutput) -> None:
        if statement.value:
            if self.state is not _TorchState.NOT_BURNING:
                self.fail(statement, f"{self.output(statement.number)} is set while {self._lit} is on")
            if statement.number not in self.checked:
                what = f"nothing checks whether {self.output(statement.number)} stays on without a program"
                self.fail(statement, what)
            self.state, self.number = _TorchState.LIT, statement.number
            return
        if self.state is _TorchState.NOT_BURNING:
            return
        if self.state is not _TorchState.LEFT or statement.number != self.number:
            self.fail(
                statement, f"an output is switched off before the thread that watches {self._lit} has ended"
            )
        self.state = _TorchState.NOT_BURNING
