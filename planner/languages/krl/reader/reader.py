"""The KRL programs of one arm, read strictly: the door of the reader.

`read` gives programs, data and every fault of their texts; `flow` the straight way. The reader shares no code
with the writer: it knows the language from docs/krl.md and the sources named there.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import ClassVar

from planner.geometry.arrays import FloatArray
from planner.languages.krl.reader import syntax_tree
from planner.languages.krl.reader.flow import Runner
from planner.languages.krl.reader.panel import VARIABLES, Panel
from planner.languages.krl.reader.parser import Reader
from planner.problem import Arm
from planner.programs.program_text import ProgramText, Size
from planner.programs.signals import Signals
from planner.programs.steps import BASE_FRAME, DIGEST, Fault, Step

_MOVE_WORDS: dict[str, dict[str, tuple[str, ...]]] = {
    "krc4": {"SLIN": ("", "C_SPL")},
    "krc2": {"LIN": ("", "C_DIS", "C_ORI")},
}
"""Words of straight moves and of their corners in each dialect."""


@dataclass(frozen=True, slots=True)
class KrlText(ProgramText):
    """The programs of one arm. `programs` by name in lower case; `data` None where there is no data list; all
    `faults`; the `dialect` of the controller."""

    language: ClassVar[str] = "krl"

    programs: Mapping[str, syntax_tree.Program]
    data: syntax_tree.DataList | None
    faults: tuple[Fault, ...]
    dialect: str

    @property
    def main(self) -> syntax_tree.Program | None:
        """The main program: the one that has the data list's name."""
        return None if self.data is None else self.programs.get(self.data.name.lower())

    def base_of(self, arm: Arm) -> FloatArray | None:
        """Return the base frame that the data list states."""
        return self.base

    @property
    def base(self) -> FloatArray | None:
        """The base frame (4, 4) that the data list states, None without one."""
        item = None if self.data is None else self.data.items.get(BASE_FRAME)
        return item.value if item is not None and item.kind == "frame" else None

    @property
    def digest(self) -> str:
        """The problem that the data list names."""
        item = None if self.data is None else self.data.items.get(DIGEST)
        return str(item.value) if item is not None and item.kind == "char" else ""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Number of moves of each program."""
        return tuple(Size(one.file, one.file, one.moves) for one in self.programs.values())

    @property
    def targets(self) -> Mapping[str, str]:
        """Places of the targets with Status and Turn."""
        if self.data is None:
            return {}
        items = self.data.items.items()
        return {f":{name}": f"{self.data.file}:{item.line}" for name, item in items if item.kind == "e6pos"}


def read(files: Mapping[str, str], most_bytes: int, dialect: str) -> KrlText:
    """All files of one arm (file name -> text)."""
    programs: dict[str, syntax_tree.Program] = {}
    lists: list[syntax_tree.DataList] = []
    faults: list[Fault] = []
    for file, text in files.items():
        size = len(text.encode("utf-8", "surrogatepass"))
        if size > most_bytes:
            what = f"{size} bytes; allowed: {most_bytes}; split the file"
            faults.append(Fault(1, 1, "krl.file_size", what, file))
        reader = Reader(text, file)
        is_list = PurePosixPath(file).suffix.lower() == ".dat"
        found = reader.data_list() if is_list else reader.program()
        faults += reader.faults
        if found is None:
            continue
        if PurePosixPath(file).stem.lower() != found.name.lower():
            what = f"the file holds {found.name}; file and program must have one name"
            faults.append(Fault(1, 1, "krl.name_file", what, file))
        if isinstance(found, syntax_tree.DataList):
            lists.append(found)
        elif found.name.lower() in programs:
            what = f"{found.name} is in {programs[found.name.lower()].file} too"
            faults.append(Fault(1, 1, "krl.name_duplicate", what, file))
        else:
            programs[found.name.lower()] = found
    if len(lists) != 1:
        what = f"the programs have {len(lists)} data lists; they need one"
        faults.append(Fault(1, 1, "krl.undeclared", what, lists[1].file if lists else next(iter(files), "")))
    text_ = KrlText(programs, lists[0] if lists else None, (), dialect)
    return KrlText(programs, text_.data, (*faults, *_checked(text_, dialect)), dialect)


def flow(
    text: KrlText,
    base: FloatArray,
    signals: Signals,
    arm: str,
    others: Sequence[str] = (),
    along: Mapping[int, tuple[float, float, float]] | None = None,
) -> tuple[tuple[Step, ...], frozenset[str]]:
    """Steps of the main program, and names of the programs that ran. ``base`` (4, 4): the robot's foot in the
    world; ``arm``, ``others``: the names of its arm and of those that it may wait for; ``along``: unit
    vectors in the foot's axes along which external axes move the foot, by their columns. For texts without
    faults.
    Raises `FlowError`."""
    if text.main is None or text.data is None:
        return (), frozenset()
    panel = Panel(text.dialect, arm, others, along)
    runner = Runner(text.programs, text.data, base, signals, panel)
    return runner.run(text.main), frozenset(runner.entered)


def _checked(text: KrlText, dialect: str) -> Iterator[Fault]:
    """Faults of names over all files, of what is used but not there, and of words of the other dialect."""
    data = text.data
    if data is not None and text.main is None:
        what = f"there is no program {data.name}, which the data list is for"
        yield Fault(1, 1, "krl.undeclared", what, data.file)
    items = {} if data is None else data.items
    for name, item in items.items():
        if name in text.programs and data is not None:
            what = f"{item.name} is a program too; names must differ"
            yield Fault(item.line, 1, "krl.name_duplicate", what, data.file)
    for program in text.programs.values():
        yield from _externals(program, text, dialect)
        for statement in program.body:
            for kind, what in _used(statement, text, dialect):
                yield Fault(statement.line, 1, f"krl.{kind}", what, program.file)


def _externals(program: syntax_tree.Program, text: KrlText, dialect: str) -> Iterator[Fault]:
    """Faults of EXT declarations: the older dialect needs one for each subprogram, the newer one none; and of
    variables, which the main program alone has."""
    called = {statement.name for statement in program.body if isinstance(statement, syntax_tree.Call)}
    main = program is text.main
    wanted = VARIABLES[dialect] if main else {}
    if {name: kind for kind, name in program.variables} != wanted or len(program.variables) != len(wanted):
        known = ", ".join(f"{kind} {name}" for name, kind in wanted.items()) or "none"
        what = f"{program.name} declares other variables than it may and must have: {known}"
        yield Fault(1, 1, "krl.undeclared", what, program.file)
    called |= {"bas"} if main else set()
    for word in program.external:
        if word not in text.programs and not (main and word == "bas"):
            yield Fault(1, 1, "krl.undeclared", f"EXT {word}() is none of the files", program.file)
    if dialect == "krc2" and (lost := sorted(called - set(program.external))):
        yield Fault(1, 1, "krl.undeclared", f"{lost[0]}() is called without EXT", program.file)
    if dialect != "krc2" and program.external:
        what = f"EXT {program.external[0]}(): this dialect needs none"
        yield Fault(1, 1, "krl.syntax", what, program.file)


def _used(statement: syntax_tree.Statement, text: KrlText, dialect: str) -> Iterator[tuple[str, str]]:
    """What is wrong with the words and names that a statement uses."""
    if isinstance(statement, syntax_tree.Straight):
        if statement.corner not in _MOVE_WORDS[dialect].get(statement.word, ()):
            words = f"{statement.word} {statement.corner}".rstrip()
            yield "syntax", f"{words} is not of the dialect {dialect}, which the cell's controller has"
        return
    if isinstance(statement, syntax_tree.Spline) and dialect != "krc4":
        yield "syntax", f"SPLINE is not of the dialect {dialect}, which the cell's controller has"
    if isinstance(statement, syntax_tree.Call):
        if statement.name not in text.programs:
            yield "undeclared", f"there is no {statement.name}()"
        return
    used, wanted = "", tuple[str, ...]()
    if isinstance(statement, syntax_tree.Joint):
        used, wanted = statement.name, ("e6axis", "e6pos")
    elif isinstance(statement, syntax_tree.Set) and statement.name in syntax_tree.FRAME_SETTINGS:
        used, wanted = str(statement.value), (syntax_tree.FRAME_SETTINGS[statement.name],)
    if not wanted:
        return
    item = None if text.data is None else text.data.items.get(used)
    if item is None:
        yield "undeclared", f"{used} is not in the data list"
    elif item.kind not in wanted:
        yield "type", f"{used} is a {item.kind.upper()}; {' or '.join(wanted).upper()} is needed"
