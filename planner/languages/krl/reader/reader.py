"""Strict reader of the KRL programs of one arm.

`read` returns programs, data and every fault of their texts; `main_flow` returns the steps that the main
program executes. The reader
shares no code with the writer: it implements the language from docs/krl.md and the sources named there.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import ClassVar

from planner.geometry.arrays import FloatArray
from planner.languages.krl.reader import syntax_tree
from planner.languages.krl.reader.flow import KrlRunner
from planner.languages.krl.reader.panel import VARIABLES, OperatorPanel
from planner.languages.krl.reader.parser import KrlFileParser
from planner.problem import Arm
from planner.programs.program_text import PartSize, ProgramText
from planner.programs.signals import NumberedSignals
from planner.programs.steps import BASE_FRAME, DIGEST, ProgramStep, TextFault

_MOVE_WORDS: dict[str, dict[str, tuple[str, ...]]] = {
    "krc4": {"SLIN": ("", "C_SPL")},
    "krc2": {"LIN": ("", "C_DIS", "C_ORI")},
}
"""Words of straight moves in each dialect, with the words of their corners; "" is an exact stop."""


@dataclass(frozen=True, slots=True)
class KrlText(ProgramText):
    """The programs of one arm.

    Attributes:
        programs: Programs by lower-case name.
        data: The data list, or None.
        faults: All faults.
        dialect: Dialect of the controller.
    """

    language: ClassVar[str] = "krl"

    programs: Mapping[str, syntax_tree.KrlProgram]
    data: syntax_tree.DataList | None
    faults: tuple[TextFault, ...]
    dialect: str

    @property
    def main(self) -> syntax_tree.KrlProgram | None:
        """The main program, which has the name of the data list, or None."""
        return None if self.data is None else self.programs.get(self.data.name.lower())

    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the base frame that the data list states, (4, 4) [m], or None."""
        return self.base

    @property
    def base(self) -> FloatArray | None:
        """Base frame (4, 4) [m] that the data list states, or None."""
        item = None if self.data is None else self.data.items.get(BASE_FRAME)
        return item.value if item is not None and item.kind == "frame" else None

    @property
    def digest(self) -> str:
        """Digest of the problem, as the data list states it; "" if it states none."""
        item = None if self.data is None else self.data.items.get(DIGEST)
        return str(item.value) if item is not None and item.kind == "char" else ""

    @property
    def sizes(self) -> tuple[PartSize, ...]:
        """Size of each program as its number of moves."""
        return tuple(
            PartSize(program.file, program.file, program.moves) for program in self.programs.values()
        )

    @property
    def targets(self) -> Mapping[str, str]:
        """File and line of each target with Status and Turn, by name with a leading colon."""
        if self.data is None:
            return {}
        items = self.data.items.items()
        return {f":{name}": f"{self.data.file}:{item.line}" for name, item in items if item.kind == "e6pos"}


def read(files: Mapping[str, str], max_bytes: int, dialect: str) -> KrlText:
    """Read all files of one arm, and collect the faults of their texts.

    Args:
        files: Texts by file name.
        max_bytes: Maximum size of a file [bytes].
        dialect: KRL dialect of the controller.
    """
    programs: dict[str, syntax_tree.KrlProgram] = {}
    data_lists: list[syntax_tree.DataList] = []
    faults: list[TextFault] = []
    for file, text in files.items():
        size = len(text.encode("utf-8", "surrogatepass"))
        if size > max_bytes:
            message = f"{size} bytes; allowed: {max_bytes}; split the file"
            faults.append(TextFault(1, 1, "krl.file_size", message, file))
        reader = KrlFileParser(text, file)
        is_list = PurePosixPath(file).suffix.lower() == ".dat"
        content = reader.data_list() if is_list else reader.program()
        faults += reader.faults
        if content is None:
            continue
        if PurePosixPath(file).stem.lower() != content.name.lower():
            message = f"the file contains {content.name}; file and program must have the same name"
            faults.append(TextFault(1, 1, "krl.name_file", message, file))
        if isinstance(content, syntax_tree.DataList):
            data_lists.append(content)
        elif content.name.lower() in programs:
            message = f"{content.name} is already in {programs[content.name.lower()].file}"
            faults.append(TextFault(1, 1, "krl.name_duplicate", message, file))
        else:
            programs[content.name.lower()] = content
    if len(data_lists) != 1:
        message = f"the programs have {len(data_lists)} data lists; they need one"
        faults.append(
            TextFault(
                1, 1, "krl.undeclared", message, data_lists[1].file if data_lists else next(iter(files), "")
            )
        )
    unchecked = KrlText(programs, data_lists[0] if data_lists else None, (), dialect)
    return KrlText(programs, unchecked.data, (*faults, *_name_faults(unchecked, dialect)), dialect)


def main_flow(
    text: KrlText,
    base: FloatArray,
    signals: NumberedSignals,
    arm: str,
    others: Sequence[str] = (),
    axis_directions: Mapping[int, tuple[float, float, float]] | None = None,
) -> tuple[tuple[ProgramStep, ...], frozenset[str]]:
    """Return the steps of the main program, and the lower-case names of the programs that ran.

    Both are empty if there is no main program or data list.

    Args:
        text: Programs without faults.
        base: The robot's foot in the world, (4, 4) [m].
        signals: Names of the numbered signals.
        arm: Name of the arm.
        others: Names of the arms that it may wait for.
        axis_directions: Unit vectors in the foot's axes along which external axes move the foot, by column.

    Raises:
        FlowError: A statement is out of place, or a value is not known.
    """
    if text.main is None or text.data is None:
        return (), frozenset()
    panel = OperatorPanel(text.dialect, arm, others, axis_directions)
    runner = KrlRunner(text.programs, text.data, base, signals, panel)
    return runner.run(text.main), frozenset(runner.entered)


def _name_faults(text: KrlText, dialect: str) -> Iterator[TextFault]:
    """Yield the faults of names and words in programs without regard to their order of execution.

    These are names that are used twice, names that are not declared, variables and EXT declarations other
    than the expected ones, and words of another dialect.
    """
    data = text.data
    if data is not None and text.main is None:
        message = f"program {data.name}, to which the data list belongs, is missing"
        yield TextFault(1, 1, "krl.undeclared", message, data.file)
    items = {} if data is None else data.items
    for name, item in items.items():
        if name in text.programs and data is not None:
            message = f"{item.name} is also a program; names must differ"
            yield TextFault(item.line, 1, "krl.name_duplicate", message, data.file)
    for program in text.programs.values():
        yield from _declaration_faults(program, text, dialect)
        for statement in program.body:
            for kind, message in _statement_faults(statement, text, dialect):
                yield TextFault(statement.line, 1, f"krl.{kind}", message, program.file)


def _declaration_faults(program: syntax_tree.KrlProgram, text: KrlText, dialect: str) -> Iterator[TextFault]:
    """Yield faults of a program's EXT declarations, and of its variables, which only the main program has.

    The older dialect needs an EXT for each subprogram, the newer one none.
    """
    called = {
        statement.name for statement in program.body if isinstance(statement, syntax_tree.CallStatement)
    }
    main = program is text.main
    expected = VARIABLES[dialect] if main else {}
    if {name: kind for kind, name in program.variables} != expected or len(program.variables) != len(
        expected
    ):
        expected_text = ", ".join(f"{kind} {name}" for name, kind in expected.items()) or "none"
        message = f"the variables of {program.name} differ from the expected ones: {expected_text}"
        yield TextFault(1, 1, "krl.undeclared", message, program.file)
    if main:
        called.add("bas")
    for word in program.external:
        if word not in text.programs and not (main and word == "bas"):
            yield TextFault(1, 1, "krl.undeclared", f"EXT {word}() is not one of the files", program.file)
    if dialect == "krc2" and (undeclared := sorted(called - set(program.external))):
        yield TextFault(1, 1, "krl.undeclared", f"{undeclared[0]}() is called without EXT", program.file)
    if dialect != "krc2" and program.external:
        message = f"EXT {program.external[0]}(): this dialect needs none"
        yield TextFault(1, 1, "krl.syntax", message, program.file)


def _statement_faults(
    statement: syntax_tree.KrlStatement, text: KrlText, dialect: str
) -> Iterator[tuple[str, str]]:
    """Yield code and message of each fault in the words and names that a statement uses.

    Words of moves and spline blocks must be part of the dialect. A called subprogram, the target of a PTP and
    the value of a frame setting must be declared, with the required type.
    """
    if isinstance(statement, syntax_tree.LinearStatement):
        if statement.corner not in _MOVE_WORDS[dialect].get(statement.word, ()):
            words = f"{statement.word} {statement.corner}".rstrip()
            yield "syntax", f"{words} is not part of {dialect}, the dialect of the cell's controller"
        return
    if isinstance(statement, syntax_tree.SplineStatement) and dialect != "krc4":
        yield "syntax", f"SPLINE is not part of {dialect}, the dialect of the cell's controller"
    if isinstance(statement, syntax_tree.CallStatement):
        if statement.name not in text.programs:
            yield "undeclared", f"program {statement.name}() is missing"
        return
    used_name, allowed_kinds = "", tuple[str, ...]()
    if isinstance(statement, syntax_tree.PtpStatement):
        used_name, allowed_kinds = statement.name, ("e6axis", "e6pos")
    elif isinstance(statement, syntax_tree.SettingStatement) and statement.name in syntax_tree.FRAME_SETTINGS:
        used_name, allowed_kinds = str(statement.value), (syntax_tree.FRAME_SETTINGS[statement.name],)
    if not allowed_kinds:
        return
    item = None if text.data is None else text.data.items.get(used_name)
    if item is None:
        yield "undeclared", f"{used_name} is not in the data list"
    elif item.kind not in allowed_kinds:
        yield "type", f"{used_name} is a {item.kind.upper()}; {' or '.join(allowed_kinds).upper()} is needed"
