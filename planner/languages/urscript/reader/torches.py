"""Torches in the straight way of a URScript program: what has to stand where one burns, and what its function
and its thread have to do.

A controller may be paused anywhere, and goes on in the middle. Its output is low then, and stays low: so a
torch burns only where nothing moves yet, or where a thread watches that it does.
"""

import enum
from collections.abc import Callable
from typing import NoReturn

from planner.languages.urscript import sentences as urscript_sentences
from planner.languages.urscript.reader import syntax_tree


class _State(enum.Enum):
    OFF = "no torch burns"
    LIT = "it has been lit, and nothing has moved"
    BURNS = "the program has waited for it"
    GUARDED = "the thread watches it"
    LEFT = "the thread has ended"


class Torches:
    """Goes through the statements of a program with the outputs that threads of torches watch. ``fail``
    refuses a statement; ``output`` and ``input`` name the controller's by their numbers."""

    def __init__(
        self,
        program: syntax_tree.Program,
        fail: Callable[[syntax_tree.Statement, str], NoReturn],
        output: Callable[[int], str],
        given: Callable[[int], str],
    ) -> None:
        self.program, self.fail, self.output, self.input = program, fail, output, given
        self.own = {one.own for one in program.torches.values() if one.own is not None}
        self.state, self.number = _State.OFF, -1
        self.looked: set[int] = set()

    def watches(self, number: int) -> bool:
        """Whether an output is a torch's."""
        return number in self.own

    def begin(self) -> None:
        """Functions and threads take all power back, and say why they end the program."""
        switched = {s.number for s in self.program.body if isinstance(s, syntax_tree.Output) and s.value}
        for name, one in self.program.torches.items():
            if left := sorted(map(self.output, switched - set(one.off))):
                self.fail(one, f"{name} leaves {', '.join(left)} on")
            if one.own is None:
                continue
            signal = self.output(one.own)
            wanted = urscript_sentences.TORCH_STOOD.filled(signal=signal)
            if one.given is not None:
                wanted = urscript_sentences.ARC_LOST.filled(signal=signal, ok_signal=self.input(one.given))
            if one.text != wanted:
                self.fail(one, f"{name} shows {one.text!r}; wanted: {wanted!r}")

    def take(self, statement: syntax_tree.Statement) -> None:
        """One statement, in its order."""
        if isinstance(statement, syntax_tree.StaysLow) and self.watches(statement.number):
            self._look(statement)
        elif isinstance(statement, syntax_tree.AwaitArc):
            self._await(statement)
        elif isinstance(statement, syntax_tree.GuardArc):
            self._guard(statement)
        elif isinstance(statement, syntax_tree.Output) and self.watches(statement.number):
            self._switch(statement)
        elif self.state in (_State.LIT, _State.BURNS):
            if not isinstance(statement, syntax_tree.Pause):
                self.fail(statement, f"{self._lit} is on, and no thread watches it yet")
        elif self.state is _State.LEFT:
            self.fail(statement, f"{self._lit} is on, and no thread watches it any more")
        elif self.state is _State.GUARDED and not isinstance(statement, syntax_tree.Straight):
            self.fail(statement, f"something else than movel while {self._lit} is on")

    def end(self, last: syntax_tree.Statement) -> None:
        """Behind the last statement."""
        if self.state is not _State.OFF:
            self.fail(last, f"the program ends while {self._lit} is on")

    @property
    def _lit(self) -> str:
        return self.output(self.number)

    def _function(self, statement: syntax_tree.AwaitArc | syntax_tree.GuardArc) -> syntax_tree.ArcFunction:
        found = self.program.torches.get(statement.name)
        if found is None:
            self.fail(statement, f"there is no {statement.name}")
        return found

    def _look(self, look: syntax_tree.StaysLow) -> None:
        wanted = urscript_sentences.STAYS_ON.filled(signal=self.output(look.number))
        if look.text != wanted:
            self.fail(look, f"the look at a torch shows {look.text!r}; wanted: {wanted!r}")
        if look.off != (look.number,):
            what = f"{self.output(look.number)} has to go off, and nothing else, where it is found to stay on"
            self.fail(look, what)
        if look.number in self.looked:
            self.fail(look, f"the program looks again whether {self.output(look.number)} stays on")
        self.looked.add(look.number)

    def _await(self, wait: syntax_tree.AwaitArc) -> None:
        function = self._function(wait)
        if self.state is not _State.LIT:
            self.fail(wait, "a wait for an arc elsewhere than right behind its output's rise")
        wanted = urscript_sentences.NO_ARC.filled(
            signal=self.input(function.given or 0), seconds=wait.seconds
        )
        if function.text != wanted:
            self.fail(wait, f"{wait.name} shows {function.text!r}; wanted: {wanted!r}")
        self.state = _State.BURNS

    def _guard(self, guard: syntax_tree.GuardArc) -> None:
        thread = self._function(guard)
        if not guard.on:
            if self.state is not _State.GUARDED or thread.own != self.number:
                self.fail(guard, f"{guard.name} does not run")
            self.state = _State.LEFT
            return
        if self.state not in (_State.LIT, _State.BURNS) or thread.own != self.number:
            self.fail(guard, f"{guard.name} begins where its torch has not just been lit")
        if (self.state is _State.BURNS) != (thread.given is not None):
            self.fail(guard, f"the program waits for another torch than {guard.name} watches")
        self.state = _State.GUARDED

    def _switch(self, statement: syntax_tree.Output) -> None:
        if statement.value:
            if self.state is not _State.OFF:
                self.fail(statement, f"{self.output(statement.number)} goes on while {self._lit} is on")
            if statement.number not in self.looked:
                what = (
                    f"nothing looks before whether {self.output(statement.number)} stays on without a program"
                )
                self.fail(statement, what)
            self.state, self.number = _State.LIT, statement.number
            return
        if self.state is _State.OFF:
            return
        if self.state is not _State.LEFT or statement.number != self.number:
            self.fail(
                statement, f"an output goes off while the thread that watches {self._lit} runs, or before"
            )
        self.state = _State.OFF
