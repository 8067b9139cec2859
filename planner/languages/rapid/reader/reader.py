"""RAPID programs of one task, read strictly: text of modules to `Module`, and all their faults.

`read_task` gives the modules and every fault of syntax, names, types and sizes. The reader shares no code
with the writer: it knows the language from ABB's manuals only.
"""

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from planner.languages.rapid.reader import syntax_tree
from planner.languages.rapid.reader.expressions import (
    MAX_BRACKETS,
    expression,
    instruction,
    quick_move,
    typed,
)
from planner.languages.rapid.reader.flow import CHECK_MODULE
from planner.languages.rapid.reader.lexer import (
    FUNCTIONS,
    INSTRUCTIONS,
    MODULE_ATTRIBUTES,
    RESERVED,
    Cursor,
    RapidSyntaxError,
    Token,
    bad_token,
    shown,
)
from planner.languages.rapid.reader.program_text import RapidText
from planner.languages.rapid.reader.type_check import Checker
from planner.programs import text as program_text
from planner.programs.steps import Fault

_CLOSING_WORDS = ("endproc", "endmodule", "error", "undo", "proc")
"""Words that end what is open."""
_BLOCK_ENDS = ("endif", "else", "elseif", "endwhile", "endfor")
"""Words that end a block of statements."""
_STORAGE_WORDS = ("const", "var", "pers", "task", "local")
"""Words that declarations begin with."""
_STATEMENT_STARTS = frozenset(
    {*INSTRUCTIONS, *_CLOSING_WORDS, *_BLOCK_ENDS, *_STORAGE_WORDS, "if", "while", "for"}
)
"""Words that a statement or declaration begins with."""
_FILE_HEADER = re.compile(r"\s*%%%\s*VERSION:\s*1\s+LANGUAGE:\s*ENGLISH\s*%%%", re.IGNORECASE)
"""Lines that controllers put in front of modules."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a module may be: `line` characters, `name` characters, `string` characters, `bytes`."""

    line: int = 250
    name: int = 32
    string: int = 80
    bytes: int = 1_000_000


class Parser:
    """Reads one module. `faults` collects everything found; `module` reads on behind each fault."""

    def __init__(self, text: str, file: str, limits: Limits, quick: bool = True) -> None:
        self.text = text
        self.file = file
        self.limits = limits
        self.quick = quick
        self.cursor = Cursor(text)
        self.faults: list[Fault] = []

    def fault(self, start: int, code: str, message: str) -> None:
        """Note a fault at an offset."""
        line, column = self.cursor.place(start)
        self.faults.append(Fault(line, column, code, message, self.file))

    # ---- module level ----

    def module(self) -> syntax_tree.Module | None:
        """The module, or None when not even its frame is there."""
        self._skip_old_header()
        try:
            self.cursor.expect_word("module", "to open the module")
            name = self._new_name("module")
            attributes = self._attributes()
        except RapidSyntaxError as wrong:
            self.fault(wrong.start, wrong.code, wrong.message)
            return None
        data: list[syntax_tree.Data] = []
        procedures: list[syntax_tree.Procedure] = []
        while self.cursor.take_word("endmodule") is None:
            token = self.cursor.token
            if token.kind == "end":
                self.fault(token.start, "rapid.syntax", "the text ends here; expected ENDMODULE")
                break
            self._guard(lambda: self._declaration(data, procedures))
            if procedures and data and data[-1].start > procedures[-1].start:
                self.fault(data[-1].start, "rapid.syntax", "data must be declared before the first PROC")
        else:
            if self.cursor.token.kind != "end":
                self._note(self.cursor.fault("nothing behind ENDMODULE"))
        size = len(self.text.encode("utf-8", "surrogatepass"))
        starts = self.cursor.starts
        return syntax_tree.Module(
            name, attributes, tuple(data), tuple(procedures), self.file, size, len(starts), starts
        )

    def _skip_old_header(self) -> None:
        # IRC5 still accepts the header lines of older controllers: %%% VERSION:1 LANGUAGE:ENGLISH %%%
        head = _FILE_HEADER.match(self.text)
        if head is not None:
            self.cursor.jump(head.end())

    def _attributes(self) -> tuple[str, ...]:
        found: list[str] = []
        if self.cursor.take_symbol("("):
            while True:
                word = self.cursor.take_word(*MODULE_ATTRIBUTES)
                if word is None:
                    raise self.cursor.fault(
                        "a module attribute: " + ", ".join(sorted(MODULE_ATTRIBUTES)).upper()
                    )
                found.append(word)
                if not self.cursor.take_symbol(","):
                    break
            self.cursor.expect_symbol(")", "behind the module attributes")
        return tuple(found)

    def _declaration(self, data: list[syntax_tree.Data], procedures: list[syntax_tree.Procedure]) -> None:
        first = self.cursor.token
        local = self.cursor.take_word("local") is not None
        if self.cursor.take_word("proc"):
            procedures.append(self._procedure(first, local))
            return
        storage = self.cursor.take_word("const", "var", "pers", "task")
        if storage is None:
            raise self.cursor.fault("a declaration (CONST, VAR, PERS, TASK PERS), PROC or ENDMODULE")
        if storage == "task":
            self.cursor.expect_word("pers", "behind TASK")
            storage = "task pers"
        data.append(self._data(first, storage.upper(), local))

    def _data(self, first: Token, storage: str, local: bool) -> syntax_tree.Data:
        token = self.cursor.token
        if token.kind != "name" or token.word not in syntax_tree.ALL_TYPES:
            raise self.cursor.fault("a data type: " + ", ".join(sorted(syntax_tree.ALL_TYPES)))
        kind = self.cursor.take().word
        start = self.cursor.token.start
        name = self._new_name("data")
        size: int | None = None
        if self.cursor.take_symbol("{"):
            if re.fullmatch(r"[1-9][0-9]{0,6}", self.cursor.token.text) is None:
                raise self.cursor.fault("the array's length, a whole number from 1 to 9999999")
            size = int(self.cursor.take().text)
            self.cursor.expect_symbol("}", "behind the array's length")
        initial: syntax_tree.Expr | None = None
        if self.cursor.take_symbol(":="):
            initial = expression(self.cursor, self.limits.string)
            if size is None:
                initial = typed(initial, kind)
        self.cursor.expect_symbol(";", "behind the declaration")
        if initial is None and storage != "VAR":
            what = "a literal" if "PERS" in storage else "a value"
            self.fault(
                start, "rapid.no_value", f"{storage} {name} has no value; it must be given {what} with :="
            )
        return syntax_tree.Data(
            self.cursor.line(first.start), start, name, kind, storage, local, size, initial
        )

    def _new_name(self, what: str) -> str:
        token = self.cursor.token
        if token.kind != "name":
            raise self.cursor.fault(f"the {what}'s name")
        if token.word in RESERVED:
            raise RapidSyntaxError(
                token.start, "rapid.name_reserved", f"{shown(token.text)} is a reserved word of RAPID"
            )
        if token.word in INSTRUCTIONS or token.word in FUNCTIONS or token.word in syntax_tree.ALL_TYPES:
            message = f"{shown(token.text)} is built in (instruction, function or type); choose another name"
            self.fault(token.start, "rapid.name_reserved", message)
        if len(token.text) > self.limits.name:
            message = f"{shown(token.text)} has {len(token.text)} characters; allowed: {self.limits.name}"
            self.fault(token.start, "rapid.name_length", message)
        return self.cursor.take().text

    # ---- procedures and blocks ----

    def _procedure(self, first: Token, local: bool) -> syntax_tree.Procedure:
        start = self.cursor.token.start
        name = self._new_name("procedure")
        self.cursor.expect_symbol("(", "behind the procedure's name")
        self.cursor.expect_symbol(")", "(procedures of this subset take no parameters)")
        body = self._block(_CLOSING_WORDS, 0)
        error = self._block(_CLOSING_WORDS, 0) if self.cursor.take_word("error") else None
        undo = self._block(_CLOSING_WORDS, 0) if self.cursor.take_word("undo") else None
        if self.cursor.take_word("endproc") is None:
            self._note(self.cursor.fault(f"ENDPROC of {name}"))
        return syntax_tree.Procedure(self.cursor.line(first.start), start, name, local, body, error, undo)

    def _block(self, ends: tuple[str, ...], depth: int) -> tuple[syntax_tree.Statement, ...]:
        if depth > MAX_BRACKETS:
            raise self.cursor.fault(f"at most {MAX_BRACKETS} nested blocks")
        found: list[syntax_tree.Statement] = []
        while not (self.cursor.token.kind == "end" or self._at(ends)):
            if self._at((*_CLOSING_WORDS, "local")):
                break  # an inner block that was never closed; its owner says so
            self._guard(lambda: found.append(self._statement(depth)))
        return tuple(found)

    def _at(self, words: tuple[str, ...]) -> bool:
        return self.cursor.token.kind == "name" and self.cursor.token.word in words

    def _statement(self, depth: int) -> syntax_tree.Statement:
        first = self.cursor.token
        line = self.cursor.line(first.start)
        if first.kind == "name":
            if self.quick and first.word.startswith("move"):
                move = quick_move(self.cursor, line)
                if move is not None:
                    return move
            if first.word in INSTRUCTIONS:
                return instruction(self.cursor, line, self.limits.string)
            if first.word == "if":
                return self._if(line, depth)
            if first.word == "while":
                return self._while(line, depth)
            if first.word == "for":
                return self._for(line, depth)
            if first.word in RESERVED:
                raise self.cursor.fault("an instruction of the subset")
            return self._named(line)
        if self.cursor.take_symbol("%"):
            called = typed(expression(self.cursor, self.limits.string), "string")
            self.cursor.expect_symbol("%", "behind the name to call")
            self.cursor.expect_symbol(";", "behind the call")
            return syntax_tree.LateCall(line, first.start, called)
        raise self.cursor.fault("a statement")

    def _named(self, line: int) -> syntax_tree.Statement:
        first = self.cursor.take()
        if self.cursor.take_symbol(":="):
            value = expression(self.cursor, self.limits.string)
            self.cursor.expect_symbol(";", "behind the assignment")
            return syntax_tree.Assign(line, first.start, syntax_tree.Name(first.start, first.text), value)
        if not self.cursor.take_symbol(";"):
            raise self.cursor.fault(
                f'";" or ":=" behind {shown(first.text)}, no instruction of the subset that takes arguments'
            )
        return syntax_tree.ProcCall(line, first.start, first.text)

    def _condition(self) -> tuple[syntax_tree.Expr, str]:
        start = self.cursor.token.start
        found = expression(self.cursor, self.limits.string)
        return found, " ".join(self.text[start : self.cursor.end].split())

    def _if(self, line: int, depth: int) -> syntax_tree.Statement:
        first = self.cursor.take()
        condition, source = self._condition()
        if self.cursor.take_word("then") is None:  # the short form: IF condition statement;
            if depth > MAX_BRACKETS:
                raise self.cursor.fault(f"at most {MAX_BRACKETS} nested blocks")
            return syntax_tree.If(
                line, first.start, ((condition, (self._statement(depth + 1),)),), (), (source,)
            )
        ends = ("elseif", "else", "endif")
        branches = [(condition, self._block(ends, depth + 1))]
        sources = [source]
        while self.cursor.take_word("elseif"):
            condition, source = self._condition()
            self.cursor.expect_word("then", "behind the condition of ELSEIF")
            branches.append((condition, self._block(ends, depth + 1)))
            sources.append(source)
        otherwise = self._block(("endif",), depth + 1) if self.cursor.take_word("else") else ()
        self._close("endif", line)
        return syntax_tree.If(line, first.start, tuple(branches), otherwise, tuple(sources))

    def _while(self, line: int, depth: int) -> syntax_tree.Statement:
        first = self.cursor.take()
        condition, source = self._condition()
        self.cursor.expect_word("do", "behind the condition of WHILE")
        body = self._block(("endwhile",), depth + 1)
        self._close("endwhile", line)
        return syntax_tree.While(line, first.start, condition, body, source)

    def _for(self, line: int, depth: int) -> syntax_tree.Statement:
        first = self.cursor.take()
        name = self._new_name("loop counter")
        self.cursor.expect_word("from", "behind the loop counter")
        start = expression(self.cursor, self.limits.string)
        self.cursor.expect_word("to", "behind the first value")
        last = expression(self.cursor, self.limits.string)
        step = expression(self.cursor, self.limits.string) if self.cursor.take_word("step") else None
        self.cursor.expect_word("do", "behind the range of FOR")
        body = self._block(("endfor",), depth + 1)
        self._close("endfor", line)
        return syntax_tree.For(line, first.start, name, start, last, step, body)

    def _close(self, word: str, line: int) -> None:
        self.cursor.expect_word(word, f"that closes line {line}")
        self.cursor.take_symbol(";")  # tolerated by the controller, as an empty statement

    # ---- faults ----

    def _note(self, wrong: RapidSyntaxError) -> None:
        self.fault(wrong.start, wrong.code, wrong.message)

    def _guard(self, read: Callable[[], None]) -> None:
        """Read one item; on a fault note it and go on behind the next ";" or at the next line that opens
        something.
        """
        before = self.cursor.token.start
        try:
            read()
        except RapidSyntaxError as wrong:
            self._note(wrong)
            self._resume(wrong.start, before)

    def _resume(self, start: int, before: int) -> None:
        if before < self.cursor.end and self.text[self.cursor.end - 1] == ";":
            return  # the statement was whole; what it says is wrong
        line, column = self.cursor.place(start)
        if not self.text[start - column + 1 : start].strip():
            line -= 1  # the statement before ended without its ";"; this line may be sound
        if self.cursor.token.start == before and self.cursor.token.kind != "end":
            self.cursor.take()  # always move on
        while self.cursor.token.kind != "end":
            token = self.cursor.token
            here = self.cursor.line(token.start)
            if (
                token.kind == "name"
                and token.word in _STATEMENT_STARTS
                and (here > line or token.word in _CLOSING_WORDS)
            ):
                return
            if token.kind == "bad" and here > line:
                self._note(bad_token(token))
                line = here
            if self.cursor.take().text == ";":
                return


_COMPARES = re.compile(
    r"(?is)(?<=PROC check_(?:cell|axes)\(\)).*?(?=^\s*ERROR\b)|^\s*PROC check_pose\b.*(?=^\s*ENDMODULE)", re.M
)


def masked(text: str) -> str:
    """A module that compares the cell with the plan without what compares, which takes procedures with
    parameters; places stay as they are."""
    return _COMPARES.sub(lambda found: re.sub(r"[^\r\n]", " ", found.group()), text)


def read_module(
    text: str | bytes, file: str = "", limits: Limits | None = None, quick: bool = True
) -> tuple[syntax_tree.Module | None, tuple[Fault, ...]]:
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


MOST_KEPT = 32_768
"""Characters of a module that is remembered; longer ones would take much memory."""


@functools.lru_cache(maxsize=32)
def _kept(text: str, file: str, limits: Limits | None) -> tuple[syntax_tree.Module | None, tuple[Fault, ...]]:
    """:func:`read_module`, remembered: of programs that differ in one module the others are read once."""
    return read_module(text, file, limits)


def read_task(
    files: Mapping[str, str | bytes], limits: Limits | None = None, signals: Iterable[str] | None = None
) -> RapidText:
    """All modules of one task (file name -> text). `signals`: names of the configured signals, None to
    allow any name.

    Modules that are loaded while the task runs belong to `files` too.
    """
    modules: list[syntax_tree.Module] = []
    faults: list[Fault] = []
    names: dict[str, str] = {}
    for file, text in files.items():
        if isinstance(text, str) and CHECK_MODULE.match(PurePosixPath(file).name):
            text = masked(text)
        short = isinstance(text, str) and len(text) <= MOST_KEPT
        module, wrong = _kept(text, file, limits) if short else read_module(text, file, limits)
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
    return RapidText(tuple(modules), (*faults, *checker.run()))
