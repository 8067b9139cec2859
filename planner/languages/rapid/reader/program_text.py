"""The modules of a task."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

from planner.geometry.arrays import FloatArray
from planner.languages.rapid.reader.syntax_tree import Data, Literal, Module, Move, build
from planner.problem import Arm
from planner.programs.program_text import ProgramText, Size
from planner.programs.steps import BASE_FRAME, DIGEST, Fault


@dataclass(frozen=True, slots=True)
class RapidText(ProgramText):
    """What was read.

    Attributes:
        modules: The modules that have at least a frame.
        faults: All faults of all files.
    """

    language: ClassVar[str] = "rapid"

    modules: tuple[Module, ...]
    faults: tuple[Fault, ...]

    @property
    def digest(self) -> str:
        """The problem that the task names, perhaps by several strings."""
        found = (data for data in self._named(rf"{DIGEST}(_\d+)?") if data.kind == "string")
        return "".join(str(data.initial.value) for data in found if isinstance(data.initial, Literal))

    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the base frame that the task declares."""
        found = [data for data in self._named(BASE_FRAME) if data.kind == "pose"]
        literal = found[0].initial if len(found) == 1 else None
        if not isinstance(literal, Literal):
            return None
        value: FloatArray = build("pose", literal.value) if literal.kind == "list" else literal.value
        return value

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Number of moves of each module."""
        return tuple(Size(f"module {module.name}", module.file, _moves(module)) for module in self.modules)

    @property
    def targets(self) -> Mapping[str, str]:
        """Places of the robtargets."""
        return {
            f":{data.name.lower()}": f"{module.file}:{data.line}"
            for module in self.modules
            for data in module.data
            if data.kind == "robtarget"
        }

    def module_of(self, file: str) -> str:
        """Return the name of the module in a file."""
        found = (module.name for module in self.modules if module.file == file)
        return next(found, ProgramText.module_of(self, file))

    def _named(self, pattern: str) -> Iterator[Data]:
        """Data whose names match a regular expression, in any case."""
        for module in self.modules:
            yield from (data for data in module.data if re.fullmatch(pattern, data.name, re.IGNORECASE))


def modules_of(text: ProgramText) -> tuple[Module, ...]:
    """Return the modules of a task, none in other languages."""
    return text.modules if isinstance(text, RapidText) else ()


def _moves(module: Module) -> int:
    return sum(isinstance(step, Move) for procedure in module.procedures for step in procedure.body)
