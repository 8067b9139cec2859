"""Built-in instructions: arguments read in their general form and held against the table of forms."""

from __future__ import annotations

from typing import NamedTuple

from planner.verify.rapid_ast import Expr, Instruction, Move, Name, Statement
from planner.verify.rapid_expressions import expression, typed
from planner.verify.rapid_lexer import Cursor, RapidSyntaxError, shown
from planner.verify.rapid_words import EXCLUSIVE, FORMS, MOVES, Form


class _Option(NamedTuple):
    name: str
    value: Expr | None
    slot: int
    start: int


def instruction(cursor: Cursor, line: int, longest_string: int) -> Statement:
    """The instruction at the cursor, which stands on its name. Raises `RapidSyntaxError`."""
    first = cursor.take()
    form = FORMS[first.word]
    required, options = _arguments(cursor, longest_string, form)
    cursor.expect_symbol(";", f"or a further argument of {form.name}")
    if len(required) != len(form.required):
        got = f"{form.name} has {len(required)} required arguments; allowed: {len(form.required)}"
        raise RapidSyntaxError(first.start, "rapid.arity", f"{got} ({', '.join(form.required) or 'none'})")
    arguments = tuple(_argument(value, kind) for value, kind in zip(required, form.required, strict=True))
    values = {option.name: _option(option, form) for option in options}
    if len(values) != len(options):
        raise RapidSyntaxError(first.start, "rapid.syntax", f"an option of {form.name} is given twice")
    for pair in EXCLUSIVE:
        if pair[0] in values and pair[1] in values:
            both = " and ".join("\\" + name for name in pair)
            raise RapidSyntaxError(
                first.start, "rapid.options", f"{form.name}: {both} exclude each other; give one"
            )
    if first.word not in MOVES:
        if form.name in ("ConfL", "ConfJ", "SingArea") and len(values) != 1:
            allowed = ", ".join("\\" + name for name in form.options)
            raise RapidSyntaxError(first.start, "rapid.options", f"{form.name} needs one of {allowed}")
        return Instruction(line, first.start, form.name, arguments, tuple(values.items()))
    target, speed, zone, tool = arguments
    named = {
        "id": values.get("id"),
        "time": values.get("t"),
        "velocity": values.get("v"),
        "wobj": values.get("wobj"),
    }
    switches = tuple(name for name in values if name not in ("id", "t", "v", "wobj"))
    return Move(line, first.start, form.name, target, speed, zone, tool, switches=switches, **named)


def _arguments(cursor: Cursor, longest: int, form: Form) -> tuple[list[Expr], list[_Option]]:
    required: list[Expr] = []
    options: list[_Option] = []
    while not (cursor.token.kind == "symbol" and cursor.token.text == ";"):
        comma = cursor.take_symbol(",")
        if cursor.token.kind == "symbol" and cursor.token.text == "\\":
            cursor.take()  # the comma before an option is tolerated by the controller
            token = cursor.token
            if token.kind != "name":
                raise cursor.fault("the name of an option")
            cursor.take()
            value = expression(cursor, longest) if cursor.take_symbol(":=") else None
            options.append(_Option(token.word, value, len(required), token.start))
        elif comma and not (required or options):
            raise cursor.fault(f"the first argument of {form.name}")
        elif comma or not (required or options):
            required.append(expression(cursor, longest))
        else:
            raise cursor.fault(f'"," or ";" in the arguments of {form.name}')
    return required, options


def _argument(value: Expr, kind: str) -> Expr:
    if kind.startswith("variable") or kind in ("syncident", "tasks", "signaldo", "signaldi", "clock"):
        if not isinstance(value, Name):
            raise RapidSyntaxError(
                value.start, "rapid.type", f"a name of {kind.removeprefix('variable ')} data must stand here"
            )
        return value
    return typed(value, kind)


def _option(option: _Option, form: Form) -> Expr | None:
    allowed = form.options.get(option.name)
    if allowed is None:
        names = ", ".join("\\" + name for name in form.options) or "no options"
        raise RapidSyntaxError(
            option.start, "rapid.options", f"{form.name} has no option {shown(option.name)}; allowed: {names}"
        )
    slot, kind = allowed
    if option.slot != slot:
        message = f"\\{option.name} is behind argument {option.slot} of {form.name}; allowed: behind {slot}"
        raise RapidSyntaxError(option.start, "rapid.options", message)
    if (option.value is None) != (kind == "switch"):
        wanted = "takes no value" if kind == "switch" else f"needs a value (\\{option.name}:=...)"
        raise RapidSyntaxError(option.start, "rapid.options", f"{form.name}: \\{option.name} {wanted}")
    return None if option.value is None else _argument(option.value, kind)
