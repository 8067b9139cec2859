"""Checks the statements of a URScript program about torches that a thread monitors.

A controller may be paused anywhere, and continues there. Its outputs are low then, and stay low. Therefore a
torch may be on only while nothing has moved yet, or while a thread monitors it.
"""

import enum
from collections.abc import Callable
from typing import NoReturn

from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.reader import syntax_tree


class _TorchState(enum.Enum):
    """What the program has done with the torch, in the required order."""

    NOT_BURNING = "no torch burns"
    LIT = "it has been lit, and nothing has moved"
    BURNS = "the program has waited for it"
    GUARDED = "the thread watches it"
    LEFT = "the thread has ended"


class TorchChecks:
    """Checks the statements of a program about the outputs that threads of torches monitor.

    Attributes:
        program: The program.
        fail: Function that raises the fault of a statement.
        output: Function that returns the name of an output by its number.
        input: Function that returns the name of an input by its number.
        torch_outputs: Numbers of the outputs of torches.
        state: State of the torch that is on.
        number: Number of its output, -1 before the first one.
        checked: Numbers of the outputs that the program has checked to be off at its start.
    """

    def __init__(
        self,
        program: syntax_tree.ScriptProgram,
        fail: Callable[[syntax_tree.Statement, str], NoReturn],
        output: Callable[[int], str],
        given: Callable[[int], str],
    ) -> None:
        self.program, self.fail = program, fail
        self.output, self.input = output, given
        self.torch_outputs = {
            function.torch_output
            for function in program.torches.values()
            if function.torch_output is not None
        }
        self.state = _TorchState.NOT_BURNING
        self.number = -1
        self.checked: set[int] = set()

    def watches(self, number: int) -> bool:
        """Return whether an output is that of a torch with a thread."""
        return number in self.torch_outputs

    def check_functions(self) -> None:
        """Check that functions and threads of torches switch all outputs off and show the expected text.

        "All outputs" are those that the program switches on. The text of the waiting function is checked at
        its calls, because it names their time limit.
        """
        switched_on = {
            statement.number
            for statement in self.program.body
            if isinstance(statement, syntax_tree.SetOutput) and statement.value
        }
        for name, function in self.program.torches.items():
            if still_on := sorted(map(self.output, switched_on - set(function.switched_off))):
                self.fail(function, f"{name} leaves {', '.join(still_on)} on")
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
        """Check the next statement of the program against the state of the torch, and update the state."""
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
        """Check that no torch is on after the ``last`` statement."""
        if self.state is not _TorchState.NOT_BURNING:
            self.fail(last, f"the program ends while {self._lit} is on")

    @property
    def _lit(self) -> str:
        """Name of the output of the torch that is on."""
        return self.output(self.number)

    def _function(self, statement: syntax_tree.AwaitArc | syntax_tree.ArcWatchdog) -> syntax_tree.ArcFunction:
        function = self.program.torches.get(statement.name)
        if function is None:
            self.fail(statement, f"there is no {statement.name}")
        return function

    def _check_low(self, check: syntax_tree.OutputLowCheck) -> None:
        """Process the check that the output of a torch is off at the start of the program.

        There may be one check for each torch. It must show the expected text and switch only this output off.
        """
        expected_text = urscript_sentences.STAYS_ON.format(signal=self.output(check.number))
        if check.text != expected_text:
            self.fail(check, f"the check of a torch shows {check.text!r}; expected: {expected_text!r}")
        if check.switched_off != (check.number,):
            message = f"only {self.output(check.number)} must be switched off where it is found to stay on"
            self.fail(check, message)
        if check.number in self.checked:
            self.fail(check, f"the program checks again whether {self.output(check.number)} stays on")
        self.checked.add(check.number)

    def _await(self, wait: syntax_tree.AwaitArc) -> None:
        """Process the wait for the input of a torch, which must follow the rise of the torch's output.

        Only pauses may come between them. The waiting function must show the expected text.
        """
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
        """Process the start or the end of the thread that monitors the torch.

        The thread starts after its torch has been lit and, if the torch has an input, after the wait for it.
        It ends only while it runs.
        """
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
        """Process a rise or fall of the output of a torch.

        It may rise if no torch is on and the program has checked at its start that the output is off. It may
        fall after its thread has ended, or if no torch is on.
        """
        if statement.value:
            if self.state is not _TorchState.NOT_BURNING:
                self.fail(statement, f"{self.output(statement.number)} is set while {self._lit} is on")
            if statement.number not in self.checked:
                message = f"nothing checks whether {self.output(statement.number)} stays on without a program"
                self.fail(statement, message)
            self.state = _TorchState.LIT
            self.number = statement.number
            return
        if self.state is _TorchState.NOT_BURNING:
            return
        if self.state is not _TorchState.LEFT or statement.number != self.number:
            self.fail(
                statement, f"an output is switched off before the thread that watches {self._lit} has ended"
            )
        self.state = _TorchState.NOT_BURNING
