"""Values of names and expressions while a task runs, as far as they are known before it does."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from planner.languages.rapid.reader import syntax_tree
from planner.languages.rapid.reader.lexer import INSTRUCTIONS
from planner.languages.rapid.reader.type_check import placed
from planner.programs.steps import LARGEST_NUMBER, FlowError, single

UNKNOWN = None  # the value of what only the controller knows
LEAST_WORK = 100_000
"""Statements that may run in any program,"""
WORK_PER_LINE = 20
"""and so many more for each of its lines, a move counting as five: most programs run each line about
once."""


class Names:
    """What names mean in the modules of a task, worked out once for all that is read from them.

    `modules` by lower-case name; `written`: names, in lower case, that some statement writes to; `work`: how
    much may still be done on the way through them, so that loops and calls without end come to one.
    """

    def __init__(self, modules: Sequence[syntax_tree.Module]) -> None:
        self.modules = {module.name.lower(): module for module in modules}
        self.written = frozenset(name for module in modules for name in _written(module))
        self.work = LEAST_WORK + WORK_PER_LINE * sum(module.lines for module in modules)
        self._items: dict[str, dict[str, list[syntax_tree.Data | syntax_tree.Procedure]]] = {}
        self._found: dict[
            tuple[str, str], tuple[syntax_tree.Module, syntax_tree.Data | syntax_tree.Procedure] | None
        ] = {}

    def find(
        self, key: str, here: syntax_tree.Module
    ) -> tuple[syntax_tree.Module, syntax_tree.Data | syntax_tree.Procedure] | None:
        """What a name means in module `here`, and the module that declares it."""
        place = (here.name, key)
        if place not in self._found:
            self._found[place] = self._search(key, here)
        return self._found[place]

    def _search(
        self, key: str, here: syntax_tree.Module
    ) -> tuple[syntax_tree.Module, syntax_tree.Data | syntax_tree.Procedure] | None:
        for module in (here, *(module for module in self.modules.values() if module is not here)):
            for item in self.items(module).get(key, ()):
                if module is here or not item.local:
                    return module, item
        return None

    def items(self, module: syntax_tree.Module) -> dict[str, list[syntax_tree.Data | syntax_tree.Procedure]]:
        """The declarations of a module by lower-case name."""
        key = module.name.lower()
        if key not in self._items:
            table: dict[str, list[syntax_tree.Data | syntax_tree.Procedure]] = {}
            items: list[syntax_tree.Data | syntax_tree.Procedure] = [*module.data, *module.procedures]
            for item in items:
                table.setdefault(item.name.lower(), []).append(item)
            self._items[key] = table
        return self._items[key]


class Evaluator:
    """Names and values as seen from `module`; `cells` holds what was assigned on the way.

    What is assigned anywhere in the task has no value that is known before that: a variable or persistent
    keeps its last one when the program is run again.
    """

    def __init__(self, modules: Sequence[syntax_tree.Module], names: Names | None = None) -> None:
        self.names = names or Names(modules)
        self.modules = self.names.modules
        self.module: syntax_tree.Module = modules[0]
        self.cells: dict[tuple[str, str], Any] = {}
        self.cache: dict[tuple[str, str], Any] = {}
        self.written = self.names.written

    def fail(self, start: int, message: str) -> FlowError:
        """What to raise for a place in the current module."""
        return FlowError([placed(self.module, start, "rapid.flow", message)])

    def find(self, key: str) -> tuple[syntax_tree.Module, syntax_tree.Data | syntax_tree.Procedure] | None:
        """What a name means in the current module, and the module that declares it."""
        return self.names.find(key, self.module)

    def value(self, expr: syntax_tree.Expr | None, kind: str) -> syntax_tree.Value:
        """The value of an expression, UNKNOWN where it is known at run time only."""
        match expr:
            case None:
                return UNKNOWN
            case syntax_tree.Literal():
                return self._built(expr, kind, expr.value) if expr.kind == "list" else expr.value
            case syntax_tree.Name():
                return self._name(expr)
            case syntax_tree.Aggregate():
                items = self._plain(expr)
                return UNKNOWN if items is None else self._built(expr, kind, items)
            case syntax_tree.Unary():
                inner = self.value(expr.operand, "num")
                return UNKNOWN if not isinstance(inner, bool | float | int) else _UNARY[expr.operator](inner)
            case syntax_tree.Binary():
                return self._binary(expr)
            case syntax_tree.Function():
                return UNKNOWN

    def _built(self, expr: syntax_tree.Expr, kind: str, items: Any) -> syntax_tree.Value:
        try:
            return syntax_tree.build(kind, items)
        except syntax_tree.RapidValueError as wrong:
            raise FlowError([placed(self.module, expr.start, wrong.code, wrong.message)]) from None

    def _plain(self, expr: syntax_tree.Expr) -> Any:
        if isinstance(expr, syntax_tree.Literal):
            return expr.value
        if isinstance(expr, syntax_tree.Aggregate):
            items = [self._plain(item) for item in expr.items]
            return UNKNOWN if any(item is None for item in items) else items
        if isinstance(expr, syntax_tree.Name):
            found = self.find(expr.key)
            if (
                found
                and isinstance(found[1], syntax_tree.Data)
                and found[1].kind not in ("num", "bool", "string")
            ):
                raise self.fail(
                    expr.start, f"{expr.text}: records inside records must be written out in this subset"
                )
        return self.value(expr, "num")

    def _name(self, name: syntax_tree.Name) -> syntax_tree.Value:
        counter = self.cells.get(("for", name.key))
        if counter is not None:
            return counter
        found = self.find(name.key)
        if found is None:
            return syntax_tree.PREDEFINED[name.key][1] if name.key in syntax_tree.PREDEFINED else UNKNOWN
        module, data = found
        if not isinstance(data, syntax_tree.Data):
            return UNKNOWN
        key = (module.name.lower(), name.key)
        if key in self.cells:
            return self.cells[key]
        if key not in self.cache:
            self.cache[key] = UNKNOWN  # a constant that refers to itself has no value
            self.cache[key] = self._initial(module, data)
        return self.cache[key]

    def _initial(self, module: syntax_tree.Module, data: syntax_tree.Data) -> syntax_tree.Value:
        if data.kind == "syncident":
            return syntax_tree.SyncIdent(data.name)
        if data.initial is None or data.kind in syntax_tree.OPAQUE_TYPES or data.name.lower() in self.written:
            return UNKNOWN
        if "PERS" in data.storage and data.kind not in syntax_tree.RECORDS:
            return UNKNOWN  # a number, truth or text that the operator may change between runs
        here, self.module = self.module, module
        try:
            if data.size is None:
                return self.value(data.initial, data.kind)
            items = self._plain(data.initial)
            if items is None:
                return UNKNOWN
            return tuple(self._built(data.initial, data.kind, item) for item in items)
        finally:
            self.module = here

    def _binary(self, expr: syntax_tree.Binary) -> syntax_tree.Value:
        left, right = self.value(expr.left, "num"), self.value(expr.right, "num")
        if expr.operator == "and" and (left is False or right is False):
            return False
        if expr.operator == "or" and (left is True or right is True):
            return True
        if left is None or right is None:
            return UNKNOWN
        if isinstance(left, str):  # what counts as equal is the controller's alphabet
            return left + right if expr.operator == "+" else UNKNOWN
        if not isinstance(left, bool | float | int) or not isinstance(right, bool | float | int):
            return UNKNOWN  # records are compared by the controller
        try:
            found = _BINARY[expr.operator](left, right)
        except (ArithmeticError, ValueError):
            found = math.nan
        if not abs(found) < LARGEST_NUMBER:
            raise self.fail(expr.start, f"{left:g} {expr.operator} {right:g} has no value")
        return found if all(map(_single, (left, right, found))) else UNKNOWN


def _single(value: Any) -> bool:
    """Whether a value is the same in the controller, which counts in single precision. What is computed from
    others, or compared with them, may come out otherwise there."""
    return not isinstance(value, float) or single(value) == value


def _written(module: syntax_tree.Module) -> Iterator[str]:
    """Names, in lower case, that statements of the module write to."""
    todo = [block for p in module.procedures for block in (p.body, p.error or (), p.undo or ())]
    while todo:
        for statement in todo.pop():
            match statement:
                case syntax_tree.Assign():
                    yield statement.target.key
                case syntax_tree.Instruction():
                    form = INSTRUCTIONS[statement.name.lower()]
                    slots = [*zip(form.required, statement.arguments, strict=False)]
                    slots += [(form.options[key][1], v) for key, v in statement.options if v is not None]
                    for kind, value in slots:
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
"""Operators with one operand."""
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
"""Operators with two operands."""
