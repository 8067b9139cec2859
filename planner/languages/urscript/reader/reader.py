"""The URScript program of one arm, read strictly: the entry point of the reader.

`read` returns the program and every fault of its text. The module `flow` follows it statement by statement.
The reader shares no code with the writer: it knows the language from docs/urscript.md and the sources named
there.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import ClassVar

import numpy as np

from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, inverse
from planner.languages.urscript.reader.parser import ScriptReader
from planner.languages.urscript.reader.syntax_tree import (
    PoseCheck,
    ScriptJointMove,
    ScriptLinearMove,
    ScriptProgram,
    SetTcp,
    SixNumbers,
)
from planner.problem import Arm
from planner.programs.program_text import PartSize, ProgramText
from planner.programs.steps import BASE_FRAME, DIGEST, TextFault
from planner.proof.kinematics.arm_model import robot_machine


@dataclass(frozen=True, slots=True)
class ScriptText(ProgramText):
    """The program of one arm as read.

    Attributes:
        program: The program, None if there is none.
        faults: All faults of the text.
    """

    language: ClassVar[str] = "urscript"

    program: ScriptProgram | None
    faults: tuple[TextFault, ...]

    @property
    def base(self) -> FloatArray | None:
        """Pose (4, 4) [m] of the controller's base in the world that the program states, or None."""
        item = None if self.program is None else self.program.data.get(BASE_FRAME)
        return pose(item.value) if item is not None and item.kind == "pose" else None

    @property
    def digest(self) -> str:
        """Digest of the problem that the program names, "" if it names none."""
        item = None if self.program is None else self.program.data.get(DIGEST)
        return str(item.value) if item is not None and item.kind == "text" else ""

    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the arm's base in the world, (4, 4) [m], or None. Its controller's base is another frame."""
        return (
            None if self.base is None else np.asarray(self.base @ inverse(robot_machine(arm.data).table.base))
        )

    @property
    def sizes(self) -> tuple[PartSize, ...]:
        """Number of moves of the program."""
        program = self.program
        return () if program is None else (PartSize(program.file, program.file, program.moves),)


def pose(values: SixNumbers) -> FloatArray:
    """Return the pose (4, 4) of a position [m] and a rotation vector [rad]."""
    return from_parts(exp_rotation(np.array(values[3:])), np.array(values[:3]))


def read(files: Mapping[str, str], most_bytes: int) -> ScriptText:
    """Read the program of one arm. Any other number of files than one is a fault.

    Args:
        files: Texts by file name.
        most_bytes: Maximum size of a file [bytes].
    """
    faults: list[TextFault] = []
    programs: list[ScriptProgram] = []
    for file, text in files.items():
        size = len(text.encode("utf-8", "surrogatepass"))
        if size > most_bytes:
            message = f"{size} bytes; allowed: {most_bytes}; split the job"
            faults.append(TextFault(1, 1, "urscript.file_size", message, file))
        reader = ScriptReader(text.replace("\r\n", "\n"), file)
        program = reader.program()
        faults += reader.faults
        if program is None:
            continue
        programs.append(program)
        if PurePosixPath(file).stem != program.name:
            message = f"the file contains {program.name}; file and program must have the same name"
            faults.append(TextFault(1, 1, "urscript.name_file", message, file))
        faults += _check_names(program)
    if len(files) > 1:
        message = f"the arm has {len(files)} programs; it needs one"
        faults.append(TextFault(1, 1, "urscript.name_duplicate", message, sorted(files)[1]))
    return ScriptText(programs[0] if len(programs) == 1 else None, tuple(faults))


def _check_names(program: ScriptProgram) -> Iterator[TextFault]:
    """Yield faults of the variables that statements use: missing, or of another kind."""
    for statement in program.body:
        match statement:
            case SetTcp(name=name) | ScriptLinearMove(frame=name):
                expected = "pose"
            case ScriptJointMove(name=name) | PoseCheck(name=name):
                expected = "joints"
            case _:
                continue
        item = program.data.get(name)
        if item is None:
            message = f"{name} has no value"
            yield TextFault(statement.line, 1, "urscript.undeclared", message, program.file)
        elif item.kind != expected:
            message = f"{name} is {item.kind}; expected: {expected}"
            yield TextFault(statement.line, 1, "urscript.type", message, program.file)
