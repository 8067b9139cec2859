"""Names and types over all modules of one task: what is declared, what is used, whether it fits."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence

from planner.languages.rapid.reader import syntax_tree
from planner.languages.rapid.reader.lexer import FUNCTIONS, IN_HANDLER_ONLY, INSTRUCTIONS, shown
from planner.programs.steps import Fault

_SIGNAL_TYPES = ("signaldo", "signaldi")
"""Types of signals."""
_MOVE_OPTIONS = ("id", "time", "velocity", "wobj")
"""Fields of a move whose types are checked: numbers, and the work object."""


class Checker:
    """Checks the modules of one task together. `signals`: names of the configured signals, None when not
    known.
    """

    def __init__(self, modules: Sequence[syntax_tree.Module], signals: frozenset[str] | None = None) -> None:
        self.modules = modules
        self.signals = None if signals is None else frozenset(name.lower() for name in signals)
        self.faults: list[Fault] = []
        self.module = modules[0] if modules else None
        self.globals: dict[str, syntax_tree.Data | syntax_tree.Procedure] = {}
        self.locals: dict[str, dict[str, syntax_tree.Data | syntax_tree.Procedure]] = {}
        self.counters: list[str] = []
        self._fitting: set[tuple[str, str, str]] = set()

    def run(self) -> tuple[Fault, ...]:
        """All faults, in the order of the modules and lines."""
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
        """Note a fault at an offset of the current module."""
        if self.module is not None:
            self.faults.append(placed(self.module, start, code, message))

    # ---- declarations ----

    def _declare(self, module: syntax_tree.Module) -> None:
        names: dict[str, str] = {module.name.lower(): "the module"}
        own = self.locals.setdefault(module.name.lower(), {})
        items: list[syntax_tree.Data | syntax_tree.Procedure] = [*module.data, *module.procedures]
        for item in items:
            key = item.name.lower()
            taken = names.get(key)
            if key in syntax_tree.PREDEFINED:
                taken = "predefined data"
            elif taken is None and not item.local and key in self.globals:
                taken = "a name of another module"
            if taken:
                self.fault(
                    item.start,
                    "rapid.name_duplicate",
                    f"{shown(item.name)} is already {taken}; names must differ",
                )
            names[key] = f"declared in line {item.line}"
            own[key] = item
            if not item.local:
                self.globals.setdefault(key, item)

    def find(self, key: str) -> syntax_tree.Data | syntax_tree.Procedure | None:
        """What a name means in the current module."""
        own = self.locals.get(self.module.name.lower(), {}) if self.module else {}
        return own.get(key) or self.globals.get(key)

    def _data(self, data: syntax_tree.Data) -> None:
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

    def _block(self, statements: Iterable[syntax_tree.Statement], handler: bool) -> None:
        for statement in statements:
            self._statement(statement, handler)

    def _statement(self, statement: syntax_tree.Statement, handler: bool) -> None:
        match statement:
            case syntax_tree.Move():
                self._move(statement)
            case syntax_tree.Instruction():
                self._instruction(statement, handler)
            case syntax_tree.Assign():
                self._assign(statement)
            case syntax_tree.ProcCall():
                if not isinstance(self.find(statement.name.lower()), syntax_tree.Procedure):
                    what = f"{shown(statement.name)} is no procedure of the task's modules and no instruction"
                    self.fault(statement.start, "rapid.unknown_procedure", what)
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
        """A counter is seen in its loop alone; one that has the name of other data would hide them from the
        reader in what the loop calls."""
        key = loop.name.lower()
        if (
            key in syntax_tree.PREDEFINED
            or key in self.counters
            or any(key in own for own in self.locals.values())
        ):
            message = f"{shown(loop.name)} is the name of other data; a loop counter needs one of its own"
            self.fault(loop.start, "rapid.name_duplicate", message)

    def _move(self, move: syntax_tree.Move) -> None:
        form = INSTRUCTIONS[move.kind.lower()]
        for value, kind in zip((move.target, move.speed, move.zone, move.tool), form.required, strict=True):
            self.expect(value, kind)
        for name, kind in zip(_MOVE_OPTIONS, ("num", "num", "num", "wobjdata"), strict=True):
            value = getattr(move, name)
            if value is not None:
                self.expect(value, kind)
        for option in (move.id, move.time, move.velocity):
            if isinstance(option, syntax_tree.Literal) and option.value <= 0:
                self.fault(option.start, "rapid.number", f"{option.value:g} must be above 0 (\\ID, \\T, \\V)")
        if isinstance(move.id, syntax_tree.Literal) and move.id.value != int(move.id.value):
            self.fault(move.id.start, "rapid.number", f"\\ID is {move.id.value:g}; allowed: whole numbers")

    def _instruction(self, statement: syntax_tree.Instruction, handler: bool) -> None:
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
        found = self.find(statement.target.key)
        if not isinstance(found, syntax_tree.Data):
            self._unknown(statement.target)
        elif found.storage == "CONST" or found.kind in syntax_tree.OPAQUE_TYPES:
            message = f"{found.name} is {found.storage} {found.kind}; it cannot be assigned"
            self.fault(statement.target.start, "rapid.type", message)
        else:
            self.expect(statement.value, found.kind)

    # ---- expressions ----

    def expect(self, value: syntax_tree.Expr, kind: str) -> None:
        """Note a fault unless `value` is of type `kind`."""
        if isinstance(value, syntax_tree.Literal) and value.kind == kind != "list":
            return
        if isinstance(value, syntax_tree.Name) and self.module is not None and not self.counters:
            place = (self.module.name, value.text, kind)  # moves by the thousand name the same data
            if place in self._fitting:
                return
            before = len(self.faults)
            self._expect(value, kind)
            if len(self.faults) == before:
                self._fitting.add(place)
            return
        self._expect(value, kind)

    def _expect(self, value: syntax_tree.Expr, kind: str) -> None:
        variable = kind.startswith("variable ")
        wanted = syntax_tree.base_type(kind.removeprefix("variable "))
        if isinstance(value, syntax_tree.Aggregate) and wanted in syntax_tree.RECORDS:
            parts = syntax_tree.RECORDS[wanted]
            if len(parts) != len(value.items):
                got = f"got {len(value.items)} components; a {wanted} has {len(parts)}"
                self.fault(value.start, "rapid.arity", got)
                return
            for part, item in zip(parts, value.items, strict=True):
                self.expect(item, part)
            return
        if wanted == "mecunit" and isinstance(value, syntax_tree.Name) and self.find(value.key) is None:
            return  # the controller's configuration has them
        if wanted in _SIGNAL_TYPES and isinstance(value, syntax_tree.Name) and self.find(value.key) is None:
            if self.signals is not None and value.key not in self.signals:
                known = ", ".join(sorted(self.signals))
                message = f"{shown(value.text)} is not a signal of the cell; known: {known}"
                self.fault(value.start, "rapid.undeclared", message)
            return
        if isinstance(value, syntax_tree.Literal) and value.kind == "list":
            try:
                syntax_tree.conform(wanted, value.value, wanted)
            except syntax_tree.RapidValueError as wrong:
                self.fault(value.start, wrong.code, wrong.message)
            return
        inferred = self.infer(value)
        if inferred is not None and inferred != wanted:
            self.fault(value.start, "rapid.type", f"got {inferred}; expected {wanted}")
        elif variable and isinstance(value, syntax_tree.Name):
            found = self.find(value.key)
            if not isinstance(found, syntax_tree.Data) or found.storage == "CONST":
                self.fault(
                    value.start, "rapid.type", f"{shown(value.text)} must be a VAR or PERS, for it is written"
                )

    def infer(self, value: syntax_tree.Expr) -> str | None:
        """The type of an expression, or None when a fault was noted."""
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
        if value.key in self.counters:
            return "num"
        found = self.find(value.key)
        if isinstance(found, syntax_tree.Data):
            return syntax_tree.base_type(found.kind)
        if value.key in syntax_tree.PREDEFINED:
            return syntax_tree.PREDEFINED[value.key][0]
        self._unknown(value)
        return None

    def _unknown(self, value: syntax_tree.Name) -> None:
        message = f"{shown(value.text)} is not declared in the task's modules and not predefined; declare it"
        self.fault(value.start, "rapid.undeclared", message)

    def _function(self, value: syntax_tree.Function) -> str | None:
        known = FUNCTIONS.get(value.text.lower())
        if known is None:
            allowed = ", ".join(sorted(FUNCTIONS))
            self.fault(
                value.start,
                "rapid.undeclared",
                f"function {shown(value.text)} is not known; allowed: {allowed}",
            )
            return None
        kinds, result = known
        if len(kinds) != len(value.arguments):
            message = f"{value.text} has {len(value.arguments)} arguments; allowed: {len(kinds)}"
            self.fault(value.start, "rapid.arity", message)
        for argument, kind in zip(value.arguments, kinds, strict=False):
            self.expect(argument, kind)
        return result

    def _binary(self, value: syntax_tree.Binary) -> str | None:
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


def placed(module: syntax_tree.Module, start: int, code: str, message: str) -> Fault:
    """A fault at an offset of a module's text."""
    row = bisect_right(module.starts, start)
    return Fault(row, start - module.starts[row - 1] + 1, code, message, module.file)


def walk(value: syntax_tree.Expr) -> Iterator[syntax_tree.Expr]:
    """The expression and all in it."""
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
    """The elements of a list expression, or None when it is none."""
    if isinstance(value, syntax_tree.Aggregate):
        return value.items
    if isinstance(value, syntax_tree.Literal) and value.kind == "list":
        return tuple(
            syntax_tree.Literal(value.start, "list" if isinstance(item, list) else "num", item)
            for item in value.value
        )  # one place for all: the list was read in one step
    return None
