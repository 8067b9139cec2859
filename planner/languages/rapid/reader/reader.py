"""Strict reader of the RAPID programs of one task: from texts to `Module` values and all their faults.

`read_task` returns the modules and every fault of syntax, names, types and sizes. The reader shares no code
with the writer: it implements the language from ABB's manuals only.
"""

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from planner.languages.rapid.reader import syntax_tree
from planner.languages.rapid.reader.expressions import (
    MAX_BRACKETS,
    parse_expression,
    parse_instruction,
    parse_usual_move,
    typed_literal,
)
from planner.languages.rapid.reader.flow import CHECK_MODULE
from planner.languages.rapid.reader.lexer import (
    FUNCTIONS,
    INSTRUCTIONS,
    MODULE_ATTRIBUTES,
    RESERVED,
    RapidCursor,
    RapidSyntaxError,
    RapidToken,
    bad_token_error,
    shorten,
)
from planner.languages.rapid.reader.program_text import RapidText
from planner.languages.rapid.reader.type_check import TypeChecker
from planner.programs import text as program_text
from planner.programs.steps import TextFault

_CLOSING_WORDS = ("endproc", "endmodule", "error", "undo", "proc")
"""Words that close an open block or procedure."""
_BLOCK_ENDS = ("endif", "else", "elseif", "endwhile", "endfor")
"""Words that end a block of statements."""
_STORAGE_WORDS = ("const", "var", "pers", "task", "local")
"""First words of declarations."""
_STATEMENT_STARTS = frozenset(
    {*INSTRUCTIONS, *_CLOSING_WORDS, *_BLOCK_ENDS, *_STORAGE_WORDS, "if", "while", "for"}
)
"""First words of statements and declarations."""
_FILE_HEADER = re.compile(r"\s*%%%\s*VERSION:\s*1\s+LANGUAGE:\s*ENGLISH\s*%%%", re.IGNORECASE)
"""Header line that controllers write in front of modules."""


@dataclass(frozen=True, slots=True)
class ModuleLimits:
    """Size limits of a module.

    Attributes:
        line: Maximum length of a line [characters].
        name: Maximum length of a name [characters].
        string: Maximum length of a string [characters].
        bytes: Maximum size of the module [bytes].
    """

    line: int = 250
    name: int = 32
    string: int = 80
    bytes: int = 1_000_000


class RapidParser:
    """Parses one module and continues after each fault.

    Attributes:
        text: The text.
        file: Its path, for faults.
        limits: Size limits.
        fast_moves: Whether `parse_usual_move` is tried before the general parser.
        cursor: Position in the text.
        faults: All faults so far.
    """

    def __init__(self, text: str, file: str, limits: ModuleLimits, fast_moves: bool = True) -> None:
        self.text = text
        self.file = file
        self.limits = limits
        self.fast_moves = fast_moves
        self.cursor = RapidCursor(text)
        self.faults: list[TextFault] = []

    def fault(self, start: int, code: str, message: str) -> None:
        """Record a fault.

        Args:
            start: Offset in the text.
            code: Issue code.
            message: What is wrong.
        """
        line, column = self.cursor.line_and_column(start)
        self.faults.append(TextFault(line, column, code, message, self.file))

    # ---- module level ----

    def module(self) -> syntax_tree.Module | None:
        """Return the module with all that could be read, or None if its MODULE line is faulty.

        Data after the first procedure, a missing ENDMODULE and text after it are faults, too.
        """
        self._skip_old_header()
        try:
            self.cursor.expect_word("module", "to open the module")
            name = self._new_name("module")
            attributes = self._attributes()
        except RapidSyntaxError as wrong:
            self.fault(wrong.start, wrong.code, wrong.message)
            return None
        data: list[syntax_tree.DataDeclaration] = []
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
                self._record(self.cursor.fault("nothing after ENDMODULE"))
        size = len(self.text.encode("utf-8", "surrogatepass"))
        starts = self.cursor.starts
        return syntax_tree.Module(
            name, attributes, tuple(data), tuple(procedures), self.file, size, len(starts), starts
        )

    def _skip_old_header(self) -> None:
        """Skip the header of older controllers, %%% VERSION:1 LANGUAGE:ENGLISH %%%, which IRC5 accepts."""
        head = _FILE_HEADER.match(self.text)
        if head is not None:
            self.cursor.jump(head.end())

    def _attributes(self) -> tuple[str, ...]:
        """Parse the attributes in brackets after the module's name, if there are any."""
        attributes: list[str] = []
        if self.cursor.take_symbol("("):
            while True:
                word = self.cursor.take_word(*MODULE_ATTRIBUTES)
                if word is None:
                    raise self.cursor.fault(
                        "a module attribute: " + ", ".join(sorted(MODULE_ATTRIBUTES)).upper()
                    )
                attributes.append(word)
                if not self.cursor.take_symbol(","):
                    break
            self.cursor.expect_symbol(")", "after the module attributes")
        return tuple(attributes)

    def _declaration(
        self, data: list[syntax_tree.DataDeclaration], procedures: list[syntax_tree.Procedure]
    ) -> None:
        """Parse one declaration and append it to ``data`` or ``procedures``."""
        first = self.cursor.token
        local = self.cursor.take_word("local") is not None
        if self.cursor.take_word("proc"):
            procedures.append(self._procedure(first, local))
            return
        storage = self.cursor.take_word("const", "var", "pers", "task")
        if storage is None:
            raise self.cursor.fault("a declaration (CONST, VAR, PERS, TASK PERS), PROC or ENDMODULE")
        if storage == "task":
            self.cursor.expect_word("pers", "after TASK")
            storage = "task pers"
        data.append(self._data(first, storage.upper(), local))

    def _data(self, first: RapidToken, storage: str, local: bool) -> syntax_tree.DataDeclaration:
        """Parse a data declaration from its type on; ``first`` is its first token (LOCAL, CONST...).

        ``storage`` is CONST, VAR, PERS or TASK PERS. Only a VAR may have no value.
        """
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
            self.cursor.expect_symbol("}", "after the array's length")
        initial: syntax_tree.Expr | None = None
        if self.cursor.take_symbol(":="):
            initial = parse_expression(self.cursor, self.limits.string)
            if size is None:
                initial = typed_literal(initial, kind)
        self.cursor.expect_symbol(";", "after the declaration")
        if initial is None and storage != "VAR":
            required = "a literal" if "PERS" in storage else "a value"
            self.fault(
                start, "rapid.no_value", f"{storage} {name} has no value; it must be given {required} with :="
            )
        return syntax_tree.DataDeclaration(
            self.cursor.line(first.start), start, name, kind, storage, local, size, initial
        )

    def _new_name(self, role: str) -> str:
        """Take the name of a new module, procedure, loop counter or data (``role``); record a bad name."""
        token = self.cursor.token
        if token.kind != "name":
            raise self.cursor.fault(f"the {role}'s name")
        if token.word in RESERVED:
            raise RapidSyntaxError(
                token.start, "rapid.name_reserved", f"{shorten(token.text)} is a reserved word of RAPID"
            )
        if token.word in INSTRUCTIONS or token.word in FUNCTIONS or token.word in syntax_tree.ALL_TYPES:
            message = (
                f"{shorten(token.text)} is built in (instruction, function or type); choose another name"
            )
            self.fault(token.start, "rapid.name_reserved", message)
        if len(token.text) > self.limits.name:
            message = f"{shorten(token.text)} has {len(token.text)} characters; allowed: {self.limits.name}"
            self.fault(token.start, "rapid.name_length", message)
        return self.cursor.take().text

    # ---- procedures and blocks ----

    def _procedure(self, first: RapidToken, local: bool) -> syntax_tree.Procedure:
        """Parse a procedure after PROC; ``first`` is its first token (LOCAL or PROC)."""
        start = self.cursor.token.start
        name = self._new_name("procedure")
        self.cursor.expect_symbol("(", "after the procedure's name")
        self.cursor.expect_symbol(")", "(procedures of this subset take no parameters)")
        body = self._block(_CLOSING_WORDS, 0)
        error = self._block(_CLOSING_WORDS, 0) if self.cursor.take_word("error") else None
        undo = self._block(_CLOSING_WORDS, 0) if self.cursor.take_word("undo") else None
        if self.cursor.take_word("endproc") is None:
            self._record(self.cursor.fault(f"ENDPROC of {name}"))
        return syntax_tree.Procedure(self.cursor.line(first.start), start, name, local, body, error, undo)

    def _block(self, ends: tuple[str, ...], depth: int) -> tuple[syntax_tree.RapidStatement, ...]:
        """Parse statements up to one of the words ``ends``, which is not taken; ``depth`` counts nesting."""
        if depth > MAX_BRACKETS:
            raise self.cursor.fault(f"at most {MAX_BRACKETS} nested blocks")
        statements: list[syntax_tree.RapidStatement] = []
        while not (self.cursor.token.kind == "end" or self._at(ends)):
            if self._at((*_CLOSING_WORDS, "local")):
                break  # an inner block is not closed; the enclosing one reports it
            self._guard(lambda: statements.append(self._statement(depth)))
        return tuple(statements)

    def _at(self, words: tuple[str, ...]) -> bool:
        """Return whether the current token is one of these lower-case words."""
        return self.cursor.token.kind == "name" and self.cursor.token.word in words

    def _statement(self, depth: int) -> syntax_tree.RapidStatement:
        """Parse one statement; ``depth`` is the number of blocks around it."""
        first = self.cursor.token
        line = self.cursor.line(first.start)
        if first.kind == "name":
            if self.fast_moves and first.word.startswith("move"):
                move = parse_usual_move(self.cursor, line)
                if move is not None:
                    return move
            if first.word in INSTRUCTIONS:
                return parse_instruction(self.cursor, line, self.limits.string)
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
            called = typed_literal(parse_expression(self.cursor, self.limits.string), "string")
            self.cursor.expect_symbol("%", "after the name to call")
            self.cursor.expect_symbol(";", "after the call")
            return syntax_tree.LateCall(line, first.start, called)
        raise self.cursor.fault("a statement")

    def _named(self, line: int) -> syntax_tree.RapidStatement:
        """Parse a statement that starts with a name of the program: an assignment or a procedure call."""
        first = self.cursor.take()
        if self.cursor.take_symbol(":="):
            value = parse_expression(self.cursor, self.limits.string)
            self.cursor.expect_symbol(";", "after the assignment")
            return syntax_tree.Assign(line, first.start, syntax_tree.Name(first.start, first.text), value)
        if not self.cursor.take_symbol(";"):
            raise self.cursor.fault(
                f'";" or ":=" after {shorten(first.text)}, which is no instruction of the subset with '
                "arguments"
            )
        return syntax_tree.ProcCall(line, first.start, first.text)

    def _condition(self) -> tuple[syntax_tree.Expr, str]:
        """Parse a condition; return it with its text, in which each run of blanks is one space."""
        start = self.cursor.token.start
        condition = parse_expression(self.cursor, self.limits.string)
        return condition, " ".join(self.text[start : self.cursor.end].split())

    def _if(self, line: int, depth: int) -> syntax_tree.RapidStatement:
        """Parse an IF that starts in ``line``, inside ``depth`` other blocks.

        It has ELSEIF and ELSE branches, or is the short form without THEN, which has one statement.
        """
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
            self.cursor.expect_word("then", "after the condition of ELSEIF")
            branches.append((condition, self._block(ends, depth + 1)))
            sources.append(source)
        otherwise = self._block(("endif",), depth + 1) if self.cursor.take_word("else") else ()
        self._close("endif", line)
        return syntax_tree.If(line, first.start, tuple(branches), otherwise, tuple(sources))

    def _while(self, line: int, depth: int) -> syntax_tree.RapidStatement:
        first = self.cursor.take()
        condition, source = self._condition()
        self.cursor.expect_word("do", "after the condition of WHILE")
        body = self._block(("endwhile",), depth + 1)
        self._close("endwhile", line)
        return syntax_tree.While(line, first.start, condition, body, source)

    def _for(self, line: int, depth: int) -> syntax_tree.RapidStatement:
        """Parse a FOR loop that starts in ``line``, up to its ENDFOR; ``depth`` blocks are around it."""
        first = self.cursor.take()
        name = self._new_name("loop counter")
        self.cursor.expect_word("from", "after the loop counter")
        first_value = parse_expression(self.cursor, self.limits.string)
        self.cursor.expect_word("to", "after the first value")
        last = parse_expression(self.cursor, self.limits.string)
        step = parse_expression(self.cursor, self.limits.string) if self.cursor.take_word("step") else None
        self.cursor.expect_word("do", "after the range of FOR")
        body = self._block(("endfor",), depth + 1)
        self._close("endfor", line)
        return syntax_tree.For(line, first.start, name, first_value, last, step, body)

    def _close(self, word: str, line: int) -> None:
        """Take the word that closes the block which was opened in ``line``."""
        self.cursor.expect_word(word, f"that closes line {line}")
        self.cursor.take_symbol(";")  # tolerated by the controller, as an empty statement

    # ---- faults ----

    def _record(self, wrong: RapidSyntaxError) -> None:
        self.fault(wrong.start, wrong.code, wrong.message)

    def _guard(self, read: Callable[[], None]) -> None:
        """Parse one statement or declaration with ``read``; on a fault, record it and skip to the next one.

        Parsing resumes after the next ";", or at a word that starts a statement or closes a block.
        """
        start = self.cursor.token.start
        try:
            read()
        except RapidSyntaxError as wrong:
            self._record(wrong)
            self._resume(wrong.start, start)

    def _resume(self, fault_start: int, item_start: int) -> None:
        """Skip to the next statement after the item at ``item_start``, which has a fault at ``fault_start``.

        Parsing resumes after the next ";", at the first word of a statement in a later line, or at a word
        that closes a procedure. At least one token is taken. Bad tokens in skipped lines are recorded.
        """
        if item_start < self.cursor.end and self.text[self.cursor.end - 1] == ";":
            return  # the statement is complete, only its content is wrong
        line, column = self.cursor.line_and_column(fault_start)
        if not self.text[fault_start - column + 1 : fault_start].strip():
            line -= 1  # the previous statement lacks its ";"; this line may be correct
        if self.cursor.token.start == item_start and self.cursor.token.kind != "end":
            self.cursor.take()  # guarantees progress
        while self.cursor.token.kind != "end":
            token = self.cursor.token
            token_line = self.cursor.line(token.start)
            if (
                token.kind == "name"
                and token.word in _STATEMENT_STARTS
                and (token_line > line or token.word in _CLOSING_WORDS)
            ):
                return
            if token.kind == "bad" and token_line > line:
                self._record(bad_token_error(token))
                line = token_line
            if self.cursor.take().text == ";":
                return


_COMPARING_TEXT = re.compile(
    r"(?is)(?<=PROC check_(?:cell|axes)\(\)).*?(?=^\s*ERROR\b)|^\s*PROC check_pose\b.*(?=^\s*ENDMODULE)", re.M
)
"""Bodies of check_cell and check_axes up to ERROR, and check_pose with all procedures after it."""


def mask_comparisons(text: str) -> str:
    """Return a check module with blanks in place of its comparing code.

    That code calls procedures with parameters, which the parser does not support. A separate rule reads it.
    Offsets and lines stay unchanged.
    """
    return _COMPARING_TEXT.sub(lambda match: re.sub(r"[^\r\n]", " ", match.group()), text)


def read_module(
    text: str | bytes, file: str = "", limits: ModuleLimits | None = None, fast_moves: bool = True
) -> tuple[syntax_tree.Module | None, tuple[TextFault, ...]]:
    """Return one module and its faults of syntax and size. `read_task` also checks names and types.

    The module is None if its MODULE line is faulty, or if the text exceeds 20 times the size limit.

    Args:
        text: The text; bytes are decoded.
        file: Its path, for faults.
        limits: Size limits; None for the default ones.
        fast_moves: Whether usual moves take the fast path. False gives the same result; tests compare both.
    """
    limits = limits or ModuleLimits()
    size = len(text)
    if isinstance(text, bytes):
        text, _ = program_text.normalise_text(file, program_text.decode(text))
    faults: list[TextFault] = []
    if size > limits.bytes:
        faults.append(
            TextFault(
                1, 1, "rapid.file_size", f"{size} bytes; allowed: {limits.bytes}; split the module", file
            )
        )
        if size > 20 * limits.bytes:
            return None, tuple(faults)  # not worth reading
    parser = RapidParser(text, file, limits, fast_moves)
    module = parser.module()
    for number, line in enumerate(text.split("\n"), 1):
        if len(line.rstrip("\r")) > limits.line:
            message = f"the line has {len(line.rstrip())} characters; allowed: {limits.line}"
            faults.append(TextFault(number, limits.line + 1, "rapid.line_length", message, file))
    faults += parser.faults
    return module, tuple(sorted(faults, key=lambda fault: (fault.line, fault.column)))


MAX_CACHED_LENGTH = 32_768
"""Maximum size of a module that is cached [characters]; longer ones would take much memory."""


@functools.lru_cache(maxsize=32)
def _read_module_cached(
    text: str, file: str, limits: ModuleLimits | None
) -> tuple[syntax_tree.Module | None, tuple[TextFault, ...]]:
    """Cached :func:`read_module`: modules that several programs share are read once."""
    return read_module(text, file, limits)


def read_task(
    files: Mapping[str, str | bytes], limits: ModuleLimits | None = None, signals: Iterable[str] | None = None
) -> RapidText:
    """Read all modules of one task.

    Args:
        files: Texts by file name, including modules that are loaded while the task runs.
        limits: Size limits; None for the default ones.
        signals: Names of the configured signals; None allows any name.
    """
    modules: list[syntax_tree.Module] = []
    faults: list[TextFault] = []
    names: dict[str, str] = {}
    for file, text in files.items():
        if isinstance(text, str) and CHECK_MODULE.match(PurePosixPath(file).name):
            text = mask_comparisons(text)
        short = isinstance(text, str) and len(text) <= MAX_CACHED_LENGTH
        module, module_faults = (
            _read_module_cached(text, file, limits) if short else read_module(text, file, limits)
        )
        faults += module_faults
        if module is None:
            continue
        if module.name.lower() in names:
            message = f"module {module.name} is already in {names[module.name.lower()]}; names must differ"
            faults.append(TextFault(1, 1, "rapid.name_duplicate", message, file))
            continue
        names[module.name.lower()] = file
        modules.append(module)
    checker = TypeChecker(modules, None if signals is None else frozenset(signals))
    return RapidText(tuple(modules), (*faults, *checker.run()))
