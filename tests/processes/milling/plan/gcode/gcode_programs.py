"""G-code files for tests, and the statements that an ordinary problem file makes about them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from planner.issues import Issue, TandemError
from planner.processes.milling.plan.gcode import reader
from planner.processes.milling.plan.operation import GCodeFile

HEAD = "G21 G90 G17 G94\nM3 S6000\nF600\n"


def spec(folder: Path, text: str | bytes, **stated: Any) -> GCodeFile:
    """The ``gcode`` of an operation for a file with this text."""
    (folder / "job.nc").write_bytes(text.encode() if isinstance(text, str) else text)
    return GCodeFile.model_validate(
        {"file": "job.nc", "origin": {"xyz_mm": [0, 0, 0]}, **stated}, context={"folder": folder}
    )


def read(folder: Path, text: str | bytes, **stated: Any) -> reader.GCodeProgram:
    """The file as read, with what the problem states."""
    return reader.read_gcode(spec(folder, text, **stated).dialect("operations.0.gcode"))


def refused(folder: Path, text: str | bytes, **stated: Any) -> tuple[Issue, ...]:
    """The issues of a file that is refused; none for one that is not."""
    try:
        read(folder, text, **stated)
    except TandemError as error:
        return error.issues
    return ()
