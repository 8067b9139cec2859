"""RAPID programs of one task, read strictly: the door of the reader.

`read_task` gives the modules and every fault of syntax, names, types and sizes; `flatten` gives the
straight way of the task, `flow` all that may run beside it too. The reader shares no code with the writer:
it knows the language from ABB's manuals only.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from planner.verify import program_text
from planner.verify.faults import Fault, FlowError
from planner.verify.rapid_ast import Module
from planner.verify.rapid_check import Checker
from planner.verify.rapid_parser import Limits, Parser
from planner.verify.rapid_ways import Flow, flatten, flow, handlers

__all__ = [
    "Fault",
    "Flow",
    "FlowError",
    "Limits",
    "Task",
    "flatten",
    "flow",
    "handlers",
    "read_module",
    "read_task",
]


CHECK = re.compile(r"(?i)TandemCheck_\w+\.(modx?)$")
"""Names of the modules that compare the cell with the plan, which a rule of their own reads."""
_COMPARES = re.compile(
    r"(?is)(?<=PROC check_cell\(\)).*?(?=^\s*ERROR\b)|^\s*PROC check_pose\b.*(?=^\s*ENDMODULE)", re.M
)


@dataclass(frozen=True, slots=True)
class Task:
    """What was read: the modules that have at least a frame, and all faults of all files."""

    modules: tuple[Module, ...]
    faults: tuple[Fault, ...]


def masked(text: str) -> str:
    """A module that compares the cell with the plan without what compares, which takes procedures with
    parameters; places stay as they are."""
    return _COMPARES.sub(lambda found: re.sub(r"[^\r\n]", " ", found.group()), text)


def read_module(
    text: str | bytes, file: str = "", limits: Limits | None = None, quick: bool = True
) -> tuple[Module | None, tuple[Fault, ...]]:
    """One module and its faults of syntax and size (names of other modules are checked by `read_task`).

    `quick=False` reads every move the ordinary way; it gives the same result and is there to prove that.
    """
    limits = limits or Limits()
    size = len(text)
    if isinstance(text, bytes):
        text, _ = program_text.settled(file, program_text.decode(text))
    faults: list[Fault] = []
    if size > limits.bytes:
        faults.append(
            Fault(1, 1, "rapid.file_size", f"{size} bytes; allowed: {limits.bytes}; split the module", file)
        )
        if size > 20 * limits.bytes:
            return None, tuple(faults)  # not worth reading
    parser = Parser(text, file, limits, quick)
    module = parser.module()
    for row, line in enumerate(text.split("\n"), 1):
        if len(line.rstrip("\r")) > limits.line:
            message = f"the line has {len(line.rstrip())} characters; allowed: {limits.line}"
            faults.append(Fault(row, limits.line + 1, "rapid.line_length", message, file))
    faults += parser.faults
    return module, tuple(sorted(faults, key=lambda fault: (fault.line, fault.column)))


def read_task(
    files: Mapping[str, str | bytes], limits: Limits | None = None, signals: Iterable[str] | None = None
) -> Task:
    """All modules of one task (file name -> text). `signals`: names of the configured signals, None to
    allow any name.

    Modules that are loaded while the task runs belong to `files` too.
    """
    modules: list[Module] = []
    faults: list[Fault] = []
    names: dict[str, str] = {}
    for file, text in files.items():
        if isinstance(text, str) and CHECK.match(PurePosixPath(file).name):
            text = masked(text)
        module, wrong = read_module(text, file, limits)
        faults += wrong
        if module is None:
            continue
        if module.name.lower() in names:
            message = f"module {module.name} is already in {names[module.name.lower()]}; names must differ"
            faults.append(Fault(1, 1, "rapid.name_duplicate", message, file))
            continue
        names[module.name.lower()] = file
        modules.append(module)
    checker = Checker(modules, None if signals is None else frozenset(signals))
    return Task(tuple(modules), (*faults, *checker.run()))
