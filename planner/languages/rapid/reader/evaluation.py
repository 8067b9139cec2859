"""Values of names and expressions of a task, as far as they are known before it runs."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from planner.languages.rapid.reader import syntax_tree
from planner.languages.rapid.reader.lexer import INSTRUCTIONS
from planner.languages.rapid.reader.type_check import fault_at
from planner.programs.steps import MAX_NUMBER, FlowError, to_single

UNKNOWN = None  # value that only the controller knows
MIN_STATEMENT_BUDGET = 100_000
"""Number of statements that any program may execute. Chosen: stops loops and calls that never end."""
STATEMENT_BUDGET_PER_LINE = 20
"""Additional number of statements for each line of the program; a move counts as five.

Most programs run each line about once.
"""


class NameTable:
    """Meaning of names in the modules of a task, resolved once for all that is read from them.

    Attributes:
        modules: Modules by lower-case name.
        written: Lower-case names that some statement writes to.
        budget: Remaining statement budget; it ends loops and calls that never end.
    """

    def __init__(self, modules: Sequence[syntax_tree.Module]) -> None:
        self.modules = {module.name.lower(): module for module in modules}
        self.written = frozenset(name for module in modules for name in _written_names(module))
        self.budget = MIN_STATEMENT_BUDGET + STATEMENT_BUDGET_PER_LINE * sum(
            module.lines for module in modules
        )
        self._items: dict[str, dict[str, list[syntax_tree.DataDeclaration | syntax_tree.Procedure]]] = {}
        self._resolved: dict[
            tuple[str, str],
            tuple[syntax_tree.Module, syntax_tree.DataDeclaration | syntax_tree.Procedure] | None,
        ] = {}

    def find(
        self, key: str, module: syntax_tree.Module
    ) -> tuple[syntax_tree.Module, syntax_tree.DataDeclaration | syntax_tree.Procedure] | None:
        """Return the declaration that a name refers to, with its module, or None.

        Args:
            key: The name in lower case.
            module: Module in which the name is used.
        """
        cache_key = (module.name, key)
        if cache_key not in self._resolved:
            self._resolved[cache_key] = self._search(key, module)
        return self._resolved[cache_key]

    def _search(
        self, key: str, current: syntax_tree.Module
    ) -> tuple[syntax_tree.Module, syntax_tree.DataDeclaration | syntax_tree.Procedure] | None:
        """Return the declaration of a lower-case name with its module, or None.

        All declarations of the current module come first, then those of other modules that are not LOCAL.
        """
        for module in (current, *(module for module in self.modules.values() if module is not current)):
            for item in self.items(module).get(key, ()):
                if module is current or not item.local:
                    return module, item
        return None

    def items(
        self, module: syntax_tree.Module
    ) -> dict[str, list[syntax_tree.DataDeclaration | syntax_tree.Procedure]]:
        """Return the declarations of a module by lower-case name."""
        key = module.name.lower()
        if key not in self._items:
            table: dict[str, list[syntax_tree.DataDeclaration | syntax_tree.Procedure]] = {}
            items: list[syntax_tree.DataDeclaration | syntax_tree.Procedure] = [
                *module.data,
                *module.procedures,
            ]
            for item in items:
                table.setdefault(item.name.lower(), []).append(item)
            self._items[key] = table
        return self._items[key]


class Evaluator:
    """Evaluates names and expressions as seen from one module.

    A name that is assigned anywhere in the task has no value before that assignment: a variable or
    persistent keeps its last value when the program runs again.

    Attributes:
        names: Meaning of names.
        modules: Modules by lower-case name.
        module: The current module.
        assigned: Values that were assigned so far, by (module, name) in lower case. A loop counter has
            the key ("for", name).
        cache: Initial values that were computed, by (module, name) in lower case.
        written: Lower-case names that some statement writes to.
    """

    def __init__(self, modules: Sequence[syntax_tree.Module], names: NameTable | None = None) -> None:
        self.names = names or NameTable(modules)
        self.modules = self.names.modules
        self.module: syntax_tree.Module = modules[0]
        self.assigned: dict[tuple[str, str], Any] = {}
        self.cache: dict[tuple[str, str], Any] = {}
        self.written = self.names.written

    def flow_error(self, start: int, message: str) -> FlowError:
        """Return the exception for an offset in the current module.

        Args:
            start: Offset in the text.
            message: What is wrong.
        """
        return FlowError([fault_at(self.module, start, "rapid.flow", message)])

    def find(
        self, key: str
    ) -> tuple[syntax_tree.Module, syntax_tree.DataDeclaration | syntax_tree.Procedure] | None:
        """Return the declaration that a name refers to in the current module, with its module, or None."""
        return self.names.find(key, self.module)

    def value(self, expr: syntax_tree.Expr | None, kind: str) -> syntax_tree.Value:
        """Return the value of an expression, UNKNOWN if it is only known at run time.

        Args:
            expr: The expression. None (an option that is not given) is UNKNOWN.
            kind: Its RAPID type.

        Raises:
            FlowError: The value does not fit its type, an operation has no finite result, or a record names
                another record as a component.
        """
        match expr:
            case None:
                return UNKNOWN
            case syntax_tree.Literal():
                return self._build_value(expr, kind, expr.value) if expr.kind == "list" else expr.value
            case syntax_tree.Name():
                return self._name_value(expr)
            case syntax_tree.Aggregate():
                items = self._literal_items(expr)
                return UNKNOWN if items is None else self._build_value(expr, kind, items)
            case syntax_tree.Unary():
                inner = self.value(expr.operand, "num")
                return UNKNOWN if not isinstance(inner, bool | float | int) else _UNARY[expr.operator](inner)
            case syntax_tree.Binary():
                return self._binary_value(expr)
            case syntax_tree.Function():
                return UNKNOWN

    def _build_value(self, expr: syntax_tree.Expr, kind: str, items: Any) -> syntax_tree.Value:
        try:
            return syntax_tree.build_value(kind, items)
        except syntax_tree.RapidValueError as wrong:
            raise FlowError([fault_at(self.module, expr.start, wrong.code, wrong.message)]) from None

    def _literal_items(self, expr: syntax_tree.Expr) -> Any:
        """Return the components of an aggregate as nested lists for `build_value`.

        The result is UNKNOWN if one of them is unknown.
        """
        if isinstance(expr, syntax_tree.Literal):
            return expr.value
        if isinstance(expr, syntax_tree.Aggregate):
            items = [self._literal_items(item) for item in expr.items]
            return UNKNOWN if any(item is None for item in items) else items
        if isinstance(expr, syntax_tree.Name):
            declaration = self.find(expr.key)
            if (
                declaration
                and isinstance(declaration[1], syntax_tree.DataDeclaration)
                and declaration[1].kind not in ("num", "bool", "string")
            ):
                raise self.flow_error(
                    expr.start, f"{expr.text}: this subset requires records inside records to be written out"
                )
        return self.value(expr, "num")

    def _name_value(self, name: syntax_tree.Name) -> syntax_tree.Value:
        """Return the value of a name, UNKNOWN if it is only known at run time.

        The value of a loop counter comes first, then the last assigned value, then the initial value.
        """
        counter = self.assigned.get(("for", name.key))
        if counter is not None:
            return counter
        declaration = self.find(name.key)
        if declaration is None:
            return syntax_tree.PREDEFINED[name.key][1] if name.key in syntax_tree.PREDEFINED else UNKNOWN
        module, data = declaration
        if not isinstance(data, syntax_tree.DataDeclaration):
            return UNKNOWN
        key = (module.name.lower(), name.key)
        if key in self.assigned:
            return self.assigned[key]
        if key not in self.cache:
            self.cache[key] = UNKNOWN  # a constant that refers to itself has no value
            self.cache[key] = self._initial_value(module, data)
        return self.cache[key]

    def _initial_value(
        self, module: syntax_tree.Module, data: syntax_tree.DataDeclaration
    ) -> syntax_tree.Value:
        """Return the value of a datum when main starts.

        It is UNKNOWN if an earlier run or the operator may have changed it.
        """
        if data.kind == "syncident":
            return syntax_tree.SyncIdent(data.name)
        if data.initial is None or data.kind in syntax_tree.OPAQUE_TYPES or data.name.lower() in self.written:
            return UNKNOWN
        if "PERS" in data.storage and data.kind not in syntax_tree.RECORDS:
            return UNKNOWN  # the operator may change numbers, truth values and texts between runs
        saved_module, self.module = self.module, module
        try:
            if data.size is None:
                return self.value(data.initial, data.kind)
            items = self._literal_items(data.initial)
            if items is None:
                return UNKNOWN
            return tuple(self._build_value(data.initial, data.kind, item) for item in items)
        finally:
            self.module = saved_module

    def _binary_value(self, expr: syntax_tree.Binary) -> syntax_tree.Value:
        """Return the result of a binary operator.

        It is UNKNOWN if the controller's single precision may give another one.
        """
        left, right = self.value(expr.left, "num"), self.value(expr.right, "num")
        if expr.operator == "and" and (left is False or right is False):
            return False
        if expr.operator == "or" and (left is True or right is True):
            return True
        if left is None or right is None:
            return UNKNOWN
        if isinstance(left, str):  # equality of strings depends on the controller's character set
            return left + right if expr.operator == "+" else UNKNOWN
        if not isinstance(left, bool | float | int) or not isinstance(right, bool | float | int):
            return UNKNOWN  # only the controller compares records
        try:
            result = _BINARY[expr.operator](left, right)
        except (ArithmeticError, ValueError):
            result = math.nan
        if not abs(result) < MAX_NUMBER:
            raise self.flow_error(expr.start, f"{left:g} {expr.operator} {right:g} has no value")
        return result if all(map(_is_single_precision, (left, right, result))) else UNKNOWN


def _is_single_precision(value: Any) -> bool:
    """Return whether the controller, which computes in single precision, holds exactly this value.

    If it rounds an operand, results and comparisons on the controller may differ from those here.
    """
    return not isinstance(value, float) or to_single(value) == value


def _written_names(module: syntax_tree.Module) -> Iterator[str]:
    """Return the names, in lower case, that statements of the module write to.

    These are targets of assignments and "variable" arguments.
    """
    todo = [
        block
        for procedure in module.procedures
        for block in (procedure.body, procedure.error or (), procedure.undo or ())
    ]
    while todo:
        for statement in todo.pop():
            match statement:
                case syntax_tree.Assign():
                    yield statement.target.key
                case syntax_tree.Instruction():
                    form = INSTRUCTIONS[statement.name.lower()]
                    typed_values = [*zip(form.required, statement.arguments, strict=False)]
                    typed_values += [
                        (form.options[key][1], value) for key, value in statement.options if value is not None
                    ]
                    for kind, value in typed_values:
                        if kind.startswith("variable") and isinstance(value, syntax_tree.Name):
                            yield value.key
                case syntax_tree.If():
                    todo += [body for _, body in statement.branches]
                    todo.append(statement.otherwise)
                case syntax_tree.While() | syntax_tree.For():
                    todo.append(statement.body)
                case _:
                    pass


_UNARY: dict[str, Callable[[Any], Any]] = {"-": lambda x: -x, "+": lambda x: x, "not": lambda x: not x}
"""Unary operators."""
_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "div": lambda a, b: float(int(a / b)),
    "mod": lambda a, b: a - b * int(a / b),
    "=": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "xor": lambda a, b: a != b,
}
"""Binary operators."""
