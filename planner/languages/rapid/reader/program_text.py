"""The modules of a task."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

from planner.geometry.arrays import FloatArray
from planner.languages.rapid.reader.syntax_tree import (
    DataDeclaration,
    Literal,
    Module,
    MoveStatement,
    build_value,
)
from planner.problem import Arm
from planner.programs.program_text import PartSize, ProgramText
from planner.programs.steps import BASE_FRAME, DIGEST, TextFault


@dataclass(frozen=True, slots=True)
class RapidText(ProgramText):
    """Modules of a task as read.

    Attributes:
        modules: The modules whose MODULE line could be read, perhaps with faults.
        faults: All faults of all files.
    """

    language: ClassVar[str] = "rapid"

    modules: tuple[Module, ...]
    faults: tuple[TextFault, ...]

    @property
    def digest(self) -> str:
        """Digest of the problem that the task names, joined if several strings hold it; "" if none does."""
        digests = (data for data in self._data_named(rf"{DIGEST}(_\d+)?") if data.kind == "string")
        return "".join(str(data.initial.value) for data in digests if isinstance(data.initial, Literal))

    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the pose of the arm's base in the world that the task declares, (4, 4) [m], or None."""
        frames = [data for data in self._data_named(BASE_FRAME) if data.kind == "pose"]
        literal = frames[0].initial if len(frames) == 1 else None
        if not isinstance(literal, Literal):
            return None
        value: FloatArray = build_value("pose", literal.value) if literal.kind == "list" else literal.value
        return value

    @property
    def sizes(self) -> tuple[PartSize, ...]:
        """Number of moves of each module."""
        return tuple(
            PartSize(f"module {module.name}", module.file, _move_count(module)) for module in self.modules
        )

    @property
    def targets(self) -> Mapping[str, str]:
        """Location "file:line" of each robtarget, by a colon and its lower-case name."""
        return {
            f":{data.name.lower()}": f"{module.file}:{data.line}"
            for module in self.modules
            for data in module.data
            if data.kind == "robtarget"
        }

    def module_of(self, file: str) -> str:
        """Return the name of the module in a file."""
        names = (module.name for module in self.modules if module.file == file)
        return next(names, ProgramText.module_of(self, file))

    def _data_named(self, pattern: str) -> Iterator[DataDeclaration]:
        """Yield the data whose whole name matches a regular expression, case ignored."""
        for module in self.modules:
            yield from (data for data in module.data if re.fullmatch(pattern, data.name, re.IGNORECASE))


def modules_of(text: ProgramText) -> tuple[Module, ...]:
    """Return the modules of a task; empty for other languages."""
    return text.modules if isinstance(text, RapidText) else ()


def _move_count(module: Module) -> int:
    return sum(
        isinstance(statement, MoveStatement)
        for procedure in module.procedures
        for statement in procedure.body
    )
