"""Expressions and built-in instructions of RAPID; number lists and usual moves read in one step.

Arguments of instructions are read in their general form and held against the table of forms. A job
has thousands of moves that differ in their numbers only: whatever does not match their pattern
exactly goes the ordinary way, which gives the same result and explains faults.
"""

import json
import re
import sys
from typing import Any, NamedTuple

from planner.languages.rapid.reader.lexer import (
    EXCLUSIVE_OPTIONS,
    INSTRUCTIONS,
    MOVE_INSTRUCTIONS,
    RESERVED,
    Cursor,
    Form,
    RapidSyntaxError,
    shown,
)
from planner.languages.rapid.reader.syntax_tree import (
    NUMBER_TYPES,
    OPAQUE_TYPES,
    Aggregate,
    Binary,
    Expr,
    Function,
    Instruction,
    Literal,
    Move,
    Name,
    RapidValueError,
    Statement,
    Unary,
    base_type,
    build,
)
from planner.programs.steps import LARGEST_NUMBER

MAX_BRACKETS = 40
"""Brackets inside one another at most."""
MAX_OPERATORS = 60
"""Operators of one expression at most: what is read here is walked through by recursion."""

NUMERIC_TEXT = re.compile(r"[\[\]\d+\-.eE, \t\r\n]*")
"""Text of brackets and numbers alone, as most data have."""
_COMPARISONS = frozenset({"=", "<>", "<", ">", "<=", ">="})
"""Operators that compare."""


def expression(cursor: Cursor, longest_string: int, depth: int = 0) -> Expr:
    """One expression: [NOT] terms joined by OR and XOR, of relations joined by AND. Raises
    `RapidSyntaxError`.
    """
    if depth > MAX_BRACKETS:
        raise cursor.fault(f"at most {MAX_BRACKETS} nested brackets")
    if not depth:
        cursor.operators = 0
    left = _logical_term(cursor, longest_string, depth)
    while True:
        start = cursor.token.start
        word = cursor.take_word("or", "xor")
        if word is None:
            return left
        left = _joined(cursor, start, word, left, _logical_term(cursor, longest_string, depth))


def _logical_term(cursor: Cursor, longest: int, depth: int) -> Expr:
    start = cursor.token.start
    negated = cursor.take_word("not") is not None
    left = _relation(cursor, longest, depth)
    while True:
        at = cursor.token.start
        if cursor.take_word("and") is None:
            return Unary(start, "not", left) if negated else left
        if negated:
            raise RapidSyntaxError(
                at, "rapid.syntax", "NOT before AND: write brackets that say what it means"
            )
        left = _joined(cursor, at, "and", left, _relation(cursor, longest, depth))


def _relation(cursor: Cursor, longest: int, depth: int) -> Expr:
    left = _sum(cursor, longest, depth)
    token = cursor.token
    if token.kind == "symbol" and token.text in _COMPARISONS:
        cursor.take()
        return Binary(token.start, token.text, left, _sum(cursor, longest, depth))
    return left


def _sum(cursor: Cursor, longest: int, depth: int) -> Expr:
    left = _product(cursor, longest, depth)
    while cursor.token.kind == "symbol" and cursor.token.text in "+-":
        token = cursor.take()
        left = _joined(cursor, token.start, token.text, left, _product(cursor, longest, depth))
    return left


def _product(cursor: Cursor, longest: int, depth: int) -> Expr:
    left = _primary(cursor, longest, depth)
    while (cursor.token.kind == "symbol" and cursor.token.text in "*/") or cursor.token.word in (
        "div",
        "mod",
    ):
        token = cursor.take()
        left = _joined(cursor, token.start, token.word, left, _primary(cursor, longest, depth))
    return left


def _joined(cursor: Cursor, start: int, operator: str, left: Expr, right: Expr) -> Expr:
    cursor.operators += 1
    if cursor.operators > MAX_OPERATORS:
        message = f"the expression has more than {MAX_OPERATORS} operators; part it"
        raise RapidSyntaxError(start, "rapid.syntax", message)
    return Binary(start, operator, left, right)


def _primary(cursor: Cursor, longest: int, depth: int) -> Expr:
    token = cursor.token
    if token.kind == "number":
        return Literal(token.start, "num", number(cursor.take().text, token.start))
    if token.kind == "string":
        return Literal(token.start, "string", _string(cursor, longest))
    if token.kind == "name":
        return _name(cursor, longest, depth)
    if token.kind == "symbol":
        if token.text == "[":
            return aggregate(cursor, longest, depth)
        if token.text == "(":
            cursor.take()
            inside = expression(cursor, longest, depth + 1)
            cursor.expect_symbol(")", "to close the bracket")
            return inside
        if token.text in "+-":
            return _signed(cursor, longest, depth)
    raise cursor.fault("a value: a number, a string, [..], a name or a function")


def number(text: str, start: int) -> float:
    """The number of an unsigned numeral; refuses what a controller's number cannot hold."""
    value = float(text)
    if value >= LARGEST_NUMBER:
        raise RapidSyntaxError(start, "rapid.number", f"{shown(text)} is too large for a number")
    return value


def _signed(cursor: Cursor, longest: int, depth: int) -> Expr:
    sign = cursor.take()
    if depth > MAX_BRACKETS:
        raise cursor.fault(f"at most {MAX_BRACKETS} nested signs")
    operand = _primary(cursor, longest, depth + 1)
    if isinstance(operand, Literal) and operand.kind == "num":
        value = -operand.value if sign.text == "-" else operand.value
        return Literal(sign.start, "num", value or 0.0)  # controllers write -0.00, too
    return Unary(sign.start, sign.text, operand)


def _string(cursor: Cursor, longest: int) -> str:
    token = cursor.take()
    value = token.text[1:-1].replace('""', '"')
    if "\\" in value.replace("\\\\", ""):
        message = f"the string {shown(value)} holds a character by its number; write the character"
        raise RapidSyntaxError(token.start, "rapid.syntax", message)
    value = value.replace("\\\\", "\\")
    if len(value) > longest:
        message = f"the string {shown(value)} has {len(value)} characters; allowed: {longest}"
        raise RapidSyntaxError(token.start, "rapid.string_length", message)
    return value


def _name(cursor: Cursor, longest: int, depth: int) -> Expr:
    token = cursor.token
    if token.word in ("true", "false"):
        return Literal(token.start, "bool", cursor.take().word == "true")
    if token.word in RESERVED:
        raise cursor.fault("a value, not a reserved word")
    cursor.take()
    if not cursor.take_symbol("("):
        return Name(token.start, token.text)
    arguments: list[Expr] = []
    while not cursor.take_symbol(")"):
        if arguments:
            cursor.expect_symbol(",", "or ) in the function's arguments")
        arguments.append(expression(cursor, longest, depth + 1))
    return Function(token.start, token.text, tuple(arguments))


def aggregate(cursor: Cursor, longest: int, depth: int) -> Expr:
    """`[a, b, ...]`: a `Literal` of kind "list" when all inside are numbers, else an `Aggregate`."""
    start = cursor.token.start
    quick = number_list(cursor.text, start)
    if quick is not None:
        cursor.jump(quick[1])
        return Literal(start, "list", quick[0])
    if depth > MAX_BRACKETS:
        raise cursor.fault(f"at most {MAX_BRACKETS} nested brackets")
    cursor.take()
    items = [expression(cursor, longest, depth + 1)]
    while cursor.take_symbol(","):
        items.append(expression(cursor, longest, depth + 1))
    cursor.expect_symbol("]", "or a comma in the list")
    return Aggregate(start, tuple(items))


_DECODER = json.JSONDecoder()
"""Reads text of brackets and numbers fast."""


def number_list(text: str, start: int) -> tuple[list[Any], int] | None:
    """Nested number list at `start` and the offset behind it, or None when it is not plainly one.

    A list of plain numbers is JSON too, and the JSON reader is fast. Anything else (names, truths, faults)
    returns None, and the ordinary way reads it and says what is wrong.
    """
    try:
        found, end = _DECODER.raw_decode(text, start)
    except (ValueError, RecursionError):
        return None
    if NUMERIC_TEXT.fullmatch(text, start, end) is None or text.count("[", start, end) > MAX_BRACKETS:
        return None
    return (found, end) if isinstance(found, list) and _finite(found) else None


def _finite(found: Any) -> bool:
    if isinstance(found, list):
        return bool(found) and all(map(_finite, found))
    return bool(-LARGEST_NUMBER < found < LARGEST_NUMBER)


def plain(found: Expr) -> Any:
    """Nested lists of numbers, truths and strings of an expression without names, or None."""
    if isinstance(found, Literal):
        return found.value
    if isinstance(found, Aggregate):
        items = [plain(item) for item in found.items]
        return None if any(item is None for item in items) else items
    return None


def typed(found: Expr, kind: str) -> Expr:
    """The expression as a `Literal` of type `kind` where it holds no names. Raises `RapidSyntaxError` where
    it does not fit.
    """
    if kind in OPAQUE_TYPES or isinstance(found, Name | Function | Unary | Binary):
        return found
    items = plain(found)
    if items is None:
        return found
    try:
        return Literal(found.start, base_type(kind) if kind in NUMBER_TYPES else kind, build(kind, items))
    except RapidValueError as wrong:
        raise RapidSyntaxError(found.start, wrong.code, wrong.message) from None


class _Option(NamedTuple):
    name: str
    value: Expr | None
    slot: int
    start: int


def instruction(cursor: Cursor, line: int, longest_string: int) -> Statement:
    """The instruction at the cursor, which stands on its name. Raises `RapidSyntaxError`."""
    first = cursor.take()
    form = INSTRUCTIONS[first.word]
    required, options = _arguments(cursor, longest_string, form)
    cursor.expect_symbol(";", f"or a further argument of {form.name}")
    if len(required) != len(form.required):
        got = f"{form.name} has {len(required)} required arguments; allowed: {len(form.required)}"
        raise RapidSyntaxError(first.start, "rapid.arity", f"{got} ({', '.join(form.required) or 'none'})")
    arguments = tuple(_argument(value, kind) for value, kind in zip(required, form.required, strict=True))
    values = {option.name: _option(option, form) for option in options}
    if len(values) != len(options):
        raise RapidSyntaxError(first.start, "rapid.syntax", f"an option of {form.name} is given twice")
    for pair in EXCLUSIVE_OPTIONS:
        if pair[0] in values and pair[1] in values:
            both = " and ".join("\\" + name for name in pair)
            raise RapidSyntaxError(
                first.start, "rapid.options", f"{form.name}: {both} exclude each other; give one"
            )
    if first.word not in MOVE_INSTRUCTIONS:
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


_MOVE_HEAD = re.compile(
    r"(?:Move(?P<linear>[LJ])|MoveAbsJ)[ \t]+(?P<name>[A-Za-z]\w*)?", re.IGNORECASE | re.ASCII
)
"""First words of a move."""
_MOVES = {"L": "MoveL", "J": "MoveJ"}
# possessive, as three runs of blanks in a row would be tried against each other
_MOVE_TAIL = re.compile(
    r"""[ \t]*+(?:\\ID:=(?P<id>\d{1,9}))?[ \t]*+(?P<still>\\NoEOffs)?[ \t]*+,[ \t]*+
    (?P<speed>[A-Za-z]\w*|\[[^\[\]]*\])(?:[ \t]*+\\T:=(?P<time>\d+(?:\.\d+)?))?[ \t]*+,[ \t]*+
    (?P<zone>[A-Za-z]\w*)[ \t]*+,[ \t]*+(?P<tool>[A-Za-z]\w*)
    (?:[ \t]*+\\WObj:=(?P<wobj>[A-Za-z]\w*))?[ \t]*+;""",
    re.IGNORECASE | re.ASCII | re.VERBOSE,
)
"""The rest of a move behind its target."""


def quick_move(cursor: Cursor, line: int) -> Move | None:
    """The move at the cursor, or None when it is not of the usual form; then the cursor has not moved."""
    text, first = cursor.text, cursor.token.start
    head = _MOVE_HEAD.match(text, first)
    if head is None:
        return None
    kind = "MoveAbsJ" if head["linear"] is None else _MOVES[head["linear"].upper()]
    try:
        end = head.end()
        if head["name"]:
            target: Expr | None = _free_name(head["name"], head.start("name"))
        else:
            found = number_list(text, end)
            if found is None:
                return None
            record = "jointtarget" if kind == "MoveAbsJ" else "robtarget"
            target, end = Literal(end, record, build(record, found[0])), found[1]
        tail = _MOVE_TAIL.match(text, end)
        if tail is None or target is None or (tail["still"] and kind != "MoveAbsJ"):
            return None
        zone = _free_name(tail["zone"], tail.start("zone"))
        tool = _free_name(tail["tool"], tail.start("tool"))
        wobj = _free_name(tail["wobj"], tail.start("wobj")) if tail["wobj"] else None
        speed = _speed(text, tail)
        if zone is None or tool is None or speed is None or (tail["wobj"] and wobj is None):
            return None
    except RapidValueError:
        return None
    if tail["time"] and float(tail["time"]) >= LARGEST_NUMBER:
        return None
    ident = Literal(tail.start("id"), "num", float(tail["id"])) if tail["id"] else None
    time = Literal(tail.start("time"), "num", float(tail["time"])) if tail["time"] else None
    switches = ("noeoffs",) if tail["still"] else ()
    cursor.jump(tail.end())
    return Move(line, first, kind, target, speed, zone, tool, ident, time, None, wobj, switches)


def _free_name(text: str, start: int) -> Name | None:
    return None if text.lower() in RESERVED else Name(start, sys.intern(text))  # by the ten thousand


def _speed(text: str, tail: re.Match[str]) -> Expr | None:
    start = tail.start("speed")
    if text[start] != "[":
        return _free_name(tail["speed"], start)
    found = number_list(text, start)
    if found is None or found[1] != tail.end("speed"):
        return None
    return Literal(start, "speeddata", build("speeddata", found[0]))
