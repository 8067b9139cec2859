"""The URScript program of one arm, read strictly: the door of the reader.

`read` gives the program and every fault of its text; `flow` its straight way. The reader shares no
code with the writer: it knows the language from docs/urscript.md and the sources named there.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import ClassVar

import numpy as np

from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, inverse
from planner.languages.urscript.reader.parser import Reader
from planner.languages.urscript.reader.syntax_tree import Joint, Look, Program, SetTcp, Six, Straight
from planner.problem import Arm
from planner.programs.program_text import ProgramText, Size
from planner.programs.steps import BASE_FRAME, DIGEST, Fault
from planner.proof.kinematics.arm_model import machine_of


@dataclass(frozen=True, slots=True)
class ScriptText(ProgramText):
    """The program of one arm, None where there is none, and all `faults`."""

    language: ClassVar[str] = "urscript"

    program: Program | None
    faults: tuple[Fault, ...]

    @property
    def base(self) -> FloatArray | None:
        """Where the program says that the controller's base is in the cell (4, 4), None if it does not."""
        item = None if self.program is None else self.program.data.get(BASE_FRAME)
        return pose(item.value) if item is not None and item.kind == "pose" else None

    @property
    def digest(self) -> str:
        """The problem that the program names."""
        item = None if self.program is None else self.program.data.get(DIGEST)
        return str(item.value) if item is not None and item.kind == "text" else ""

    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the base of the arm, which is not that of its controller."""
        return None if self.base is None else np.asarray(self.base @ inverse(machine_of(arm.data).table.base))

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Number of moves of the program."""
        one = self.program
        return () if one is None else (Size(one.file, one.file, one.moves),)


def pose(values: Six) -> FloatArray:
    """Pose (4, 4) of a position [m] and a rotation vector [rad]."""
    return from_parts(exp_rotation(np.array(values[3:])), np.array(values[:3]))


def read(files: Mapping[str, str], most_bytes: int) -> ScriptText:
    """All files of one arm (file name -> text), of which there has to be one."""
    faults: list[Fault] = []
    programs: list[Program] = []
    for file, text in files.items():
        size = len(text.encode("utf-8", "surrogatepass"))
        if size > most_bytes:
            what = f"{size} bytes; allowed: {most_bytes}; split the job"
            faults.append(Fault(1, 1, "urscript.file_size", what, file))
        reader = Reader(text.replace("\r\n", "\n"), file)
        found = reader.program()
        faults += reader.faults
        if found is None:
            continue
        programs.append(found)
        if PurePosixPath(file).stem != found.name:
            what = f"the file holds {found.name}; file and program must have one name"
            faults.append(Fault(1, 1, "urscript.name_file", what, file))
        faults += _checked(found)
    if len(files) > 1:
        what = f"the arm has {len(files)} programs; it needs one"
        faults.append(Fault(1, 1, "urscript.name_duplicate", what, sorted(files)[1]))
    return ScriptText(programs[0] if len(programs) == 1 else None, tuple(faults))


def _checked(program: Program) -> Iterator[Fault]:
    """Faults of names that are used: what is not there, or of another kind."""
    for statement in program.body:
        match statement:
            case SetTcp(name=name) | Straight(frame=name):
                wanted = "pose"
            case Joint(name=name) | Look(name=name):
                wanted = "joints"
            case _:
                continue
        item = program.data.get(name)
        if item is None:
            what = f"{name} has no value"
            yield Fault(statement.line, 1, "urscript.undeclared", what, program.file)
        elif item.kind != wanted:
            what = f"{name} is {item.kind}; {wanted} must stand here"
            yield Fault(statement.line, 1, "urscript.type", what, program.file)
