"""Checks names and types over all modules of one task: declarations, uses, and whether they agree."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence

from planner.languages.rapid.reader import syntax_tree
from planner.languages.rapid.reader.lexer import FUNCTIONS, IN_HANDLER_ONLY, INSTRUCTIONS, shorten
from planner.programs.steps import TextFault

_SIGNAL_TYPES = ("signaldo", "signaldi")
"""Types of signals."""
_MOVE_OPTIONS = ("id", "time", "velocity", "wobj")
"""Optional fields of a `MoveStatement` with a value: three numbers and the work object."""


class TypeChecker:
    """Checks the modules of one task together.

    Attributes:
        modules: The modules.
        signals: Lower-case names of the configured signals, None if not known.
        faults: Faults so far.
        module: The current module.
        globals: Declarations that all modules see, by lower-case name.
        locals: Declarations of each module, by the lower-case names of module and declaration.
        counters: Lower-case names of the loop counters in scope, the innermost last.
    """

    def __init__(self, modules: Sequence[syntax_tree.Module], signals: frozenset[str] | None = None) -> None:
        self.modules = modules
        self.signals = None if signals is None else frozenset(name.lower() for name in signals)
        self.faults: list[TextFault] = []
        self.module = modules[0] if modules else None
        self.globals: dict[str, syntax_tree.DataDeclaration | syntax_tree.Procedure] = {}
        self.locals: dict[str, dict[str, syntax_tree.DataDeclaration | syntax_tree.Procedure]] = {}
        self.counters: list[str] = []
        self._checked: set[tuple[str, str, str]] = set()

    def run(self) -> tuple[TextFault, ...]:
        """Return all faults, in the order of files and lines."""
        for module in self.modules:
            self.module = module
            self._declare(module)
        for module in self.modules:
            self.module = module
            for data in module.data:
                self._data(data)
            for procedure in module.procedures:
                self._block(procedure.body, False)
                self._block(procedure.error or (), True)
                self._block(procedure.undo or (), True)
        return tuple(sorted(self.faults, key=lambda fault: (fault.file, fault.line, fault.column)))

    def fault(self, start: int, code: str, message: str) -> None:
        """Record a fault.

        Args:
            start: Offset in the current module.
            code: Issue code.
            message: What is wrong.
        """
        if self.module is not None:
            self.faults.append(fault_at(self.module, start, code, message))

    # ---- declarations ----

    def _declare(self, module: syntax_tree.Module) -> None:
        """Register the declarations of a module, with a fault for a name that is already in use.

        A name is in use by the module itself, an earlier declaration of the module, predefined data, or a
        declaration of another module if neither is LOCAL.
        """
        # for faults: who uses each lower-case name in this module
        descriptions: dict[str, str] = {module.name.lower(): "the module"}
        declared = self.locals.setdefault(module.name.lower(), {})
        items: list[syntax_tree.DataDeclaration | syntax_tree.Procedure] = [*module.data, *module.procedures]
        for item in items:
            key = item.name.lower()
            conflict = descriptions.get(key)
            if key in syntax_tree.PREDEFINED:
                conflict = "predefined data"
            elif conflict is None and not item.local and key in self.globals:
                conflict = "a name of another module"
            if conflict:
                self.fault(
                    item.start,
                    "rapid.name_duplicate",
                    f"{shorten(item.name)} is already {conflict}; names must differ",
                )
            descriptions[key] = f"declared in line {item.line}"
            declared[key] = item
            if not item.local:
                self.globals.setdefault(key, item)

    def find(self, key: str) -> syntax_tree.DataDeclaration | syntax_tree.Procedure | None:
        """Return the declaration that a lower-case name refers to in the current module, or None."""
        declared = self.locals.get(self.module.name.lower(), {}) if self.module else {}
        return declared.get(key) or self.globals.get(key)

    def _data(self, data: syntax_tree.DataDeclaration) -> None:
        """Check the initial value of a declaration against its type and array size.

        Persistent data take literals only, and some types no value at all. A missing value is not a fault
        here.
        """
        if data.initial is None:
            return
        if data.kind in syntax_tree.OPAQUE_TYPES:
            self.fault(data.start, "rapid.type", f"{data.kind} {data.name} takes no value")
            return
        if "PERS" in data.storage and any(
            not isinstance(part, syntax_tree.Literal | syntax_tree.Aggregate) for part in walk(data.initial)
        ):
            message = f"{data.storage} {data.name} must be given a literal (numbers, strings, [..])"
            self.fault(data.initial.start, "rapid.pers_literal", message)
            return
        if data.size is None:
            self.expect(data.initial, data.kind)
            return
        items = elements(data.initial)
        if items is None or len(items) != data.size:
            got = "no list" if items is None else f"{len(items)} elements"
            self.fault(data.initial.start, "rapid.arity", f"{data.name} has {data.size} elements; got {got}")
        else:
            for item in items:
                self.expect(item, data.kind)

    # ---- statements ----

    def _block(self, statements: Iterable[syntax_tree.RapidStatement], handler: bool) -> None:
        for statement in statements:
            self._statement(statement, handler)

    def _statement(self, statement: syntax_tree.RapidStatement, handler: bool) -> None:
        """Check one statement with its blocks; ``handler`` is True in an ERROR or UNDO section.

        The counter of a FOR is in scope in the body of the loop.
        """
        match statement:
            case syntax_tree.MoveStatement():
                self._move(statement)
            case syntax_tree.Instruction():
                self._instruction(statement, handler)
            case syntax_tree.Assign():
                self._assign(statement)
            case syntax_tree.ProcCall():
                if not isinstance(self.find(statement.name.lower()), syntax_tree.Procedure):
                    message = (
                        f"{shorten(statement.name)} is no procedure of the task's modules and no instruction"
                    )
                    self.fault(statement.start, "rapid.unknown_procedure", message)
            case syntax_tree.LateCall():
                self.expect(statement.name, "string")
            case syntax_tree.If():
                for condition, body in statement.branches:
                    self.expect(condition, "bool")
                    self._block(body, handler)
                self._block(statement.otherwise, handler)
            case syntax_tree.While():
                self.expect(statement.condition, "bool")
                self._block(statement.body, handler)
            case syntax_tree.For():
                for bound in (statement.first, statement.last, statement.step):
                    if bound is not None:
                        self.expect(bound, "num")
                self._counter(statement)
                self.counters.append(statement.name.lower())
                self._block(statement.body, handler)
                self.counters.pop()

    def _counter(self, loop: syntax_tree.For) -> None:
        """Check the name of a loop counter.

        A counter is visible in its loop only. The evaluator looks up counters before other data, also in
        procedures that the loop calls, so that a counter with the name of other data would shadow them there.
        """
        key = loop.name.lower()
        if (
            key in syntax_tree.PREDEFINED
            or key in self.counters
            or any(key in declared for declared in self.locals.values())
        ):
            message = f"{shorten(loop.name)} is the name of other data; a loop counter needs a unique name"
            self.fault(loop.start, "rapid.name_duplicate", message)

    def _move(self, move: syntax_tree.MoveStatement) -> None:
        """Check the types of a move's arguments and options, and the values of literal options.

        ID, T and V must be positive, and ID must be a whole number.
        """
        form = INSTRUCTIONS[move.kind.lower()]
        for value, kind in zip((move.target, move.speed, move.zone, move.tool), form.required, strict=True):
            self.expect(value, kind)
        for name, kind in zip(_MOVE_OPTIONS, ("num", "num", "num", "wobjdata"), strict=True):
            value = getattr(move, name)
            if value is not None:
                self.expect(value, kind)
        for option in (move.id, move.time, move.velocity):
            if isinstance(option, syntax_tree.Literal) and option.value <= 0:
                self.fault(
                    option.start, "rapid.number", f"\\ID, \\T and \\V must be positive; got {option.value:g}"
                )
        if isinstance(move.id, syntax_tree.Literal) and move.id.value != int(move.id.value):
            self.fault(move.id.start, "rapid.number", f"\\ID is {move.id.value:g}; allowed: whole numbers")

    def _instruction(self, statement: syntax_tree.Instruction, handler: bool) -> None:
        """Check the types of an instruction's arguments and options.

        RETRY and TRYNEXT must be in an ERROR or UNDO section (``handler``).
        """
        form = INSTRUCTIONS[statement.name.lower()]
        if statement.name.lower() in IN_HANDLER_ONLY and not handler:
            self.fault(
                statement.start, "rapid.syntax", f"{statement.name} is allowed in an ERROR section only"
            )
        for value, kind in zip(statement.arguments, form.required, strict=True):
            self.expect(value, kind)
        for name, option in statement.options:
            if option is not None:
                self.expect(option, form.options[name][1])

    def _assign(self, statement: syntax_tree.Assign) -> None:
        """Check that the target can be assigned and that the value has its type."""
        declaration = self.find(statement.target.key)
        if not isinstance(declaration, syntax_tree.DataDeclaration):
            self._unknown(statement.target)
        elif declaration.storage == "CONST" or declaration.kind in syntax_tree.OPAQUE_TYPES:
            message = f"{declaration.name} is {declaration.storage} {declaration.kind}; it cannot be assigned"
            self.fault(statement.target.start, "rapid.type", message)
        else:
            self.expect(statement.value, declaration.kind)

    # ---- expressions ----

    def expect(self, value: syntax_tree.Expr, kind: str) -> None:
        """Record a fault unless an expression has a type.

        Args:
            value: The expression.
            kind: The RAPID type. "variable <type>" requires a VAR or PERS of that type.
        """
        if isinstance(value, syntax_tree.Literal) and value.kind == kind != "list":
            return
        if isinstance(value, syntax_tree.Name) and self.module is not None and not self.counters:
            cache_key = (self.module.name, value.text, kind)  # thousands of moves name the same data
            if cache_key in self._checked:
                return
            fault_count = len(self.faults)
            self._expect(value, kind)
            if len(self.faults) == fault_count:
                self._checked.add(cache_key)
            return
        self._expect(value, kind)

    def _expect(self, value: syntax_tree.Expr, kind: str) -> None:
        """Check the type of an expression as `expect` does, without its shortcuts for repeated values.

        Records are checked by component. Signals and mechanical units need no declaration, because the
        controller's configuration declares them. If the configured signals are known, others are faults.
        """
        variable = kind.startswith("variable ")
        expected = syntax_tree.base_type(kind.removeprefix("variable "))
        if isinstance(value, syntax_tree.Aggregate) and expected in syntax_tree.RECORDS:
            parts = syntax_tree.RECORDS[expected]
            if len(parts) != len(value.items):
                got = f"got {len(value.items)} components; a {expected} has {len(parts)}"
                self.fault(value.start, "rapid.arity", got)
                return
            for part, item in zip(parts, value.items, strict=True):
                self.expect(item, part)
            return
        if expected == "mecunit" and isinstance(value, syntax_tree.Name) and self.find(value.key) is None:
            return  # the controller's configuration declares mechanical units
        if expected in _SIGNAL_TYPES and isinstance(value, syntax_tree.Name) and self.find(value.key) is None:
            if self.signals is not None and value.key not in self.signals:
                signals = ", ".join(sorted(self.signals))
                message = f"{shorten(value.text)} is not a signal of the cell; known: {signals}"
                self.fault(value.start, "rapid.undeclared", message)
            return
        if isinstance(value, syntax_tree.Literal) and value.kind == "list":
            try:
                syntax_tree.check_components(expected, value.value, expected)
            except syntax_tree.RapidValueError as wrong:
                self.fault(value.start, wrong.code, wrong.message)
            return
        inferred = self.infer(value)
        if inferred is not None and inferred != expected:
            self.fault(value.start, "rapid.type", f"got {inferred}; expected {expected}")
        elif variable and isinstance(value, syntax_tree.Name):
            declaration = self.find(value.key)
            if not isinstance(declaration, syntax_tree.DataDeclaration) or declaration.storage == "CONST":
                self.fault(
                    value.start,
                    "rapid.type",
                    f"{shorten(value.text)} is written to, so it must be a VAR or PERS",
                )

    def infer(self, value: syntax_tree.Expr) -> str | None:
        """Return the type of an expression, or None if a fault was recorded."""
        match value:
            case syntax_tree.Literal():
                return value.kind
            case syntax_tree.Aggregate():
                return "list"
            case syntax_tree.Name():
                return self._name(value)
            case syntax_tree.Function():
                return self._function(value)
            case syntax_tree.Unary():
                kind = "bool" if value.operator == "not" else "num"
                self.expect(value.operand, kind)
                return kind
            case syntax_tree.Binary():
                return self._binary(value)

    def _name(self, value: syntax_tree.Name) -> str | None:
        """Return the type of the data that a name refers to.

        If it is not declared, record a fault and return None.
        """
        if value.key in self.counters:
            return "num"
        declaration = self.find(value.key)
        if isinstance(declaration, syntax_tree.DataDeclaration):
            return syntax_tree.base_type(declaration.kind)
        if value.key in syntax_tree.PREDEFINED:
            return syntax_tree.PREDEFINED[value.key][0]
        self._unknown(value)
        return None

    def _unknown(self, value: syntax_tree.Name) -> None:
        message = (
            f"{shorten(value.text)} is not declared in the task's modules and not predefined; declare it"
        )
        self.fault(value.start, "rapid.undeclared", message)

    def _function(self, value: syntax_tree.Function) -> str | None:
        """Return the result type of a function call, after a check of its arguments.

        The result is None for an unknown function.
        """
        signature = FUNCTIONS.get(value.text.lower())
        if signature is None:
            allowed = ", ".join(sorted(FUNCTIONS))
            self.fault(
                value.start,
                "rapid.undeclared",
                f"function {shorten(value.text)} is not known; allowed: {allowed}",
            )
            return None
        kinds, result = signature
        if len(kinds) != len(value.arguments):
            message = f"{value.text} has {len(value.arguments)} arguments; allowed: {len(kinds)}"
            self.fault(value.start, "rapid.arity", message)
        for argument, kind in zip(value.arguments, kinds, strict=False):
            self.expect(argument, kind)
        return result

    def _binary(self, value: syntax_tree.Binary) -> str | None:
        """Return the result type of a binary operator, after a check of its operands.

        The result is None if one has no type.
        """
        if value.operator in ("and", "or", "xor"):
            self.expect(value.left, "bool")
            self.expect(value.right, "bool")
            return "bool"
        left, right = self.infer(value.left), self.infer(value.right)
        if left is None or right is None:
            return None
        result = "bool"
        if value.operator in ("=", "<>"):
            fits = left == right
        elif value.operator in ("<", ">", "<=", ">="):
            fits = left == right == "num"
        else:
            fits = left == right == "num" or (value.operator == "+" and left == right == "string")
            result = str(left)
        if not fits:
            self.fault(value.start, "rapid.type", f"{value.operator} does not take {left} and {right}")
        return result


def fault_at(module: syntax_tree.Module, start: int, code: str, message: str) -> TextFault:
    """Return a fault at an offset of a module's text.

    Args:
        module: The module.
        start: Offset in its text.
        code: Issue code.
        message: What is wrong.
    """
    line = bisect_right(module.starts, start)
    return TextFault(line, start - module.starts[line - 1] + 1, code, message, module.file)


def walk(value: syntax_tree.Expr) -> Iterator[syntax_tree.Expr]:
    """Yield the expression and all its subexpressions."""
    yield value
    match value:
        case syntax_tree.Aggregate():
            parts: tuple[syntax_tree.Expr, ...] = value.items
        case syntax_tree.Function():
            parts = value.arguments
        case syntax_tree.Unary():
            parts = (value.operand,)
        case syntax_tree.Binary():
            parts = (value.left, value.right)
        case _:
            parts = ()
    for part in parts:
        yield from walk(part)


def elements(value: syntax_tree.Expr) -> tuple[syntax_tree.Expr, ...] | None:
    """Return the elements of a list expression, or None if it is not a list."""
    if isinstance(value, syntax_tree.Aggregate):
        return value.items
    if isinstance(value, syntax_tree.Literal) and value.kind == "list":
        return tuple(
            syntax_tree.Literal(value.start, "list" if isinstance(item, list) else "num", item)
            for item in value.value
        )  # the list was parsed in one step: its offset stands for those of all elements
    return None
