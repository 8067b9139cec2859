"""What is wrong with a program text, whatever its language."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong with a text. `line` and `column` count from 1; `code` is stable: the language's name,
    a dot, and a word that all languages share; `message` is for people.
    """

    line: int
    column: int
    code: str
    message: str
    file: str = ""

    @property
    def kind(self) -> str:
        """The code without the language."""
        return self.code.partition(".")[2]


class FlowError(ValueError):
    """The programs have no single straight way; `faults` says where and why."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        super().__init__("; ".join(f"{fault.file}:{fault.line}: {fault.message}" for fault in faults))
        self.faults = tuple(faults)
