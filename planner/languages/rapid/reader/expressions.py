"""Parses expressions and built-in instructions of RAPID, with a fast path for number lists and usual moves.

Arguments of instructions are parsed in their general form and checked against the table of forms. A job has
thousands of moves that differ only in their numbers. Text that does not match the pattern of such a move
exactly is parsed in the general way, which gives the same result and explains faults.
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
    InstructionForm,
    RapidCursor,
    RapidSyntaxError,
    shorten,
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
    MoveStatement,
    Name,
    RapidStatement,
    RapidValueError,
    Unary,
    base_type,
    build_value,
)
from planner.programs.steps import MAX_NUMBER

MAX_BRACKETS = 40
"""Maximum nesting depth of brackets. Chosen: expressions are walked by recursion."""
MAX_OPERATORS = 60
"""Maximum number of operators in one expression. Chosen: expressions are walked by recursion."""

NUMERIC_TEXT = re.compile(r"[\[\]\d+\-.eE, \t\r\n]*")
"""Text that consists of brackets and numbers only, as most data do."""
_COMPARISONS = frozenset({"=", "<>", "<", ">", "<=", ">="})
"""Comparison operators."""


def parse_expression(cursor: RapidCursor, max_string_length: int, depth: int = 0) -> Expr:
    """Parse one expression: terms joined by OR and XOR. A term is relations joined by AND, or NOT relation.

    Args:
        cursor: Position in the text.
        max_string_length: Maximum length of a string [characters].
        depth: Nesting depth of brackets.

    Raises:
        RapidSyntaxError: The text is not an expression of the subset.
    """
    if depth > MAX_BRACKETS:
        raise cursor.fault(f"at most {MAX_BRACKETS} nested brackets")
    if not depth:
        cursor.operators = 0
    left = _logical_term(cursor, max_string_length, depth)
    while True:
        start = cursor.token.start
        word = cursor.take_word("or", "xor")
        if word is None:
            return left
        left = _binary_node(cursor, start, word, left, _logical_term(cursor, max_string_length, depth))


def _logical_term(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse relations joined by AND, or a negated relation. NOT before AND is refused as ambiguous."""
    start = cursor.token.start
    negated = cursor.take_word("not") is not None
    left = _relation(cursor, longest, depth)
    while True:
        operator_start = cursor.token.start
        if cursor.take_word("and") is None:
            return Unary(start, "not", left) if negated else left
        if negated:
            message = "NOT before AND is ambiguous. Add brackets"
            raise RapidSyntaxError(operator_start, "rapid.syntax", message)
        left = _binary_node(cursor, operator_start, "and", left, _relation(cursor, longest, depth))


def _relation(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse a sum, or a comparison of two sums."""
    left = _sum(cursor, longest, depth)
    token = cursor.token
    if token.kind == "symbol" and token.text in _COMPARISONS:
        cursor.take()
        return Binary(token.start, token.text, left, _sum(cursor, longest, depth))
    return left


def _sum(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    left = _product(cursor, longest, depth)
    while cursor.token.kind == "symbol" and cursor.token.text in "+-":
        token = cursor.take()
        left = _binary_node(cursor, token.start, token.text, left, _product(cursor, longest, depth))
    return left


def _product(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse operands joined by * / DIV or MOD, from left to right."""
    left = _primary(cursor, longest, depth)
    while (cursor.token.kind == "symbol" and cursor.token.text in "*/") or cursor.token.word in (
        "div",
        "mod",
    ):
        token = cursor.take()
        left = _binary_node(cursor, token.start, token.word, left, _primary(cursor, longest, depth))
    return left


def _binary_node(cursor: RapidCursor, start: int, operator: str, left: Expr, right: Expr) -> Expr:
    """Return an operator with its operands; raise a fault if the expression has too many operators."""
    cursor.operators += 1
    if cursor.operators > MAX_OPERATORS:
        message = f"the expression has more than {MAX_OPERATORS} operators; split it"
        raise RapidSyntaxError(start, "rapid.syntax", message)
    return Binary(start, operator, left, right)


def _primary(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse an operand: a literal, a name, a function call, an aggregate, or an expression in brackets."""
    token = cursor.token
    if token.kind == "number":
        return Literal(token.start, "num", parse_number(cursor.take().text, token.start))
    if token.kind == "string":
        return Literal(token.start, "string", _string(cursor, longest))
    if token.kind == "name":
        return _name(cursor, longest, depth)
    if token.kind == "symbol":
        if token.text == "[":
            return parse_aggregate(cursor, longest, depth)
        if token.text == "(":
            cursor.take()
            inside = parse_expression(cursor, longest, depth + 1)
            cursor.expect_symbol(")", "to close the bracket")
            return inside
        if token.text in "+-":
            return _signed(cursor, longest, depth)
    raise cursor.fault("a value: a number, a string, [..], a name or a function")


def parse_number(text: str, start: int) -> float:
    """Return the value of an unsigned numeral.

    Args:
        text: The numeral.
        start: Its offset.

    Raises:
        RapidSyntaxError: The number exceeds the range of single precision.
    """
    value = float(text)
    if value >= MAX_NUMBER:
        raise RapidSyntaxError(start, "rapid.number", f"{shorten(text)} is too large for a number")
    return value


def _signed(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse + or - with its operand; a sign before a number becomes part of the literal."""
    sign = cursor.take()
    if depth > MAX_BRACKETS:
        raise cursor.fault(f"at most {MAX_BRACKETS} nested signs")
    operand = _primary(cursor, longest, depth + 1)
    if isinstance(operand, Literal) and operand.kind == "num":
        value = -operand.value if sign.text == "-" else operand.value
        return Literal(sign.start, "num", value or 0.0)  # -0.00, which controllers also write, becomes 0.0
    return Unary(sign.start, sign.text, operand)


def _string(cursor: RapidCursor, longest: int) -> str:
    """Take a string and return its value, with doubled quotes and backslashes resolved.

    ``longest`` is the maximum length [characters]. A character code, which a backslash starts, is refused.
    """
    token = cursor.take()
    value = token.text[1:-1].replace('""', '"')
    if "\\" in value.replace("\\\\", ""):
        message = f"the string {shorten(value)} contains a character code; write the character itself"
        raise RapidSyntaxError(token.start, "rapid.syntax", message)
    value = value.replace("\\\\", "\\")
    if len(value) > longest:
        message = f"the string {shorten(value)} has {len(value)} characters; allowed: {longest}"
        raise RapidSyntaxError(token.start, "rapid.string_length", message)
    return value


def _name(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse TRUE, FALSE, the name of data, or a function call."""
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
        arguments.append(parse_expression(cursor, longest, depth + 1))
    return Function(token.start, token.text, tuple(arguments))


def parse_aggregate(cursor: RapidCursor, longest: int, depth: int) -> Expr:
    """Parse `[a, b, ...]`: a `Literal` of kind "list" if it contains numbers only, else an `Aggregate`.

    Args:
        cursor: Position in the text, at the opening bracket.
        longest: Maximum length of a string [characters].
        depth: Nesting depth of brackets.
    """
    start = cursor.token.start
    number_list = parse_number_list(cursor.text, start)
    if number_list is not None:
        items_of_list, end = number_list
        cursor.jump(end)
        return Literal(start, "list", items_of_list)
    if depth > MAX_BRACKETS:
        raise cursor.fault(f"at most {MAX_BRACKETS} nested brackets")
    cursor.take()
    items = [parse_expression(cursor, longest, depth + 1)]
    while cursor.take_symbol(","):
        items.append(parse_expression(cursor, longest, depth + 1))
    cursor.expect_symbol("]", "or a comma in the list")
    return Aggregate(start, tuple(items))


_DECODER = json.JSONDecoder()
"""JSON decoder, which parses nested lists of numbers fast."""


def parse_number_list(text: str, start: int) -> tuple[list[Any], int] | None:
    """Return the nested list of numbers at an offset and the offset after it, or None for any other text.

    A list of numbers is also JSON, and the JSON decoder is fast. Anything else (names, truth values, faults,
    numbers beyond single precision, empty lists) gives None; the general parser reads it and explains faults.

    Args:
        text: Text of the module.
        start: Offset of the list.
    """
    try:
        items, end = _DECODER.raw_decode(text, start)
    except (ValueError, RecursionError):
        return None
    if NUMERIC_TEXT.fullmatch(text, start, end) is None or text.count("[", start, end) > MAX_BRACKETS:
        return None
    return (items, end) if isinstance(items, list) and _all_finite(items) else None


def _all_finite(value: Any) -> bool:
    """Return whether nested lists are not empty and contain only numbers in the range of single precision."""
    if isinstance(value, list):
        return bool(value) and all(map(_all_finite, value))
    return bool(-MAX_NUMBER < value < MAX_NUMBER)


def literal_items(expr: Expr) -> Any:
    """Return the value of a literal, or the values in an aggregate of literals as nested lists, or None."""
    if isinstance(expr, Literal):
        return expr.value
    if isinstance(expr, Aggregate):
        items = [literal_items(item) for item in expr.items]
        return None if any(item is None for item in items) else items
    return None


def typed_literal(expr: Expr, kind: str) -> Expr:
    """Return a literal, or an aggregate of literals, as a `Literal` of a type; other expressions unchanged.

    Args:
        expr: The expression.
        kind: The RAPID type.

    Raises:
        RapidSyntaxError: The value does not fit the type.
    """
    if kind in OPAQUE_TYPES or isinstance(expr, Name | Function | Unary | Binary):
        return expr
    items = literal_items(expr)
    if items is None:
        return expr
    try:
        return Literal(
            expr.start, base_type(kind) if kind in NUMBER_TYPES else kind, build_value(kind, items)
        )
    except RapidValueError as wrong:
        raise RapidSyntaxError(expr.start, wrong.code, wrong.message) from None


class _RapidOption(NamedTuple):
    """An option as written: lower-case name, value or None, number of arguments before it, and offset."""

    name: str
    value: Expr | None
    slot: int
    start: int


def parse_instruction(cursor: RapidCursor, line: int, max_string_length: int) -> RapidStatement:
    """Parse the built-in instruction whose name is at the cursor, up to its semicolon.

    Args:
        cursor: Position in the text.
        line: Line of the statement, from 1.
        max_string_length: Maximum length of a string [characters].

    Raises:
        RapidSyntaxError: Arguments or options do not fit the instruction.
    """
    first = cursor.take()
    form = INSTRUCTIONS[first.word]
    required, options = _arguments(cursor, max_string_length, form)
    cursor.expect_symbol(";", f"or a further argument of {form.name}")
    if len(required) != len(form.required):
        message = f"{form.name} has {len(required)} required arguments; allowed: {len(form.required)}"
        raise RapidSyntaxError(
            first.start, "rapid.arity", f"{message} ({', '.join(form.required) or 'none'})"
        )
    arguments = tuple(_argument(value, kind) for value, kind in zip(required, form.required, strict=True))
    values = {option.name: _option(option, form) for option in options}
    if len(values) != len(options):
        raise RapidSyntaxError(first.start, "rapid.syntax", f"an option of {form.name} is given twice")
    for pair in EXCLUSIVE_OPTIONS:
        if pair[0] in values and pair[1] in values:
            names = " and ".join("\\" + name for name in pair)
            raise RapidSyntaxError(
                first.start, "rapid.options", f"{form.name}: {names} exclude each other; give one"
            )
    if first.word not in MOVE_INSTRUCTIONS:
        if form.name in ("ConfL", "ConfJ", "SingArea") and len(values) != 1:
            allowed = ", ".join("\\" + name for name in form.options)
            raise RapidSyntaxError(first.start, "rapid.options", f"{form.name} needs one of {allowed}")
        return Instruction(line, first.start, form.name, arguments, tuple(values.items()))
    target, speed, zone, tool = arguments
    move_options = {
        "id": values.get("id"),
        "time": values.get("t"),
        "velocity": values.get("v"),
        "wobj": values.get("wobj"),
    }
    switches = tuple(name for name in values if name not in ("id", "t", "v", "wobj"))
    return MoveStatement(
        line, first.start, form.name, target, speed, zone, tool, switches=switches, **move_options
    )


def _arguments(
    cursor: RapidCursor, longest: int, form: InstructionForm
) -> tuple[list[Expr], list[_RapidOption]]:
    """Parse the required arguments and the options of an instruction, up to the semicolon.

    Commas separate required arguments. An option starts with a backslash, and a comma before it is optional.
    Number and types are not checked here.
    """
    required: list[Expr] = []
    options: list[_RapidOption] = []
    while not (cursor.token.kind == "symbol" and cursor.token.text == ";"):
        comma = cursor.take_symbol(",")
        if cursor.token.kind == "symbol" and cursor.token.text == "\\":
            cursor.take()  # the comma before an option is tolerated by the controller
            token = cursor.token
            if token.kind != "name":
                raise cursor.fault("the name of an option")
            cursor.take()
            value = parse_expression(cursor, longest) if cursor.take_symbol(":=") else None
            options.append(_RapidOption(token.word, value, len(required), token.start))
        elif comma and not (required or options):
            raise cursor.fault(f"the first argument of {form.name}")
        elif comma or not (required or options):
            required.append(parse_expression(cursor, longest))
        else:
            raise cursor.fault(f'"," or ";" in the arguments of {form.name}')
    return required, options


def _argument(value: Expr, kind: str) -> Expr:
    """Return an argument as a literal of its type if it consists of literals, else unchanged.

    ``kind`` is its RAPID type. Some types can only be named.

    Raises:
        RapidSyntaxError: The argument is not a name although its type requires one, or its value is wrong.
    """
    if kind.startswith("variable") or kind in ("syncident", "tasks", "signaldo", "signaldi", "clock"):
        if not isinstance(value, Name):
            raise RapidSyntaxError(
                value.start, "rapid.type", f"expected a name of {kind.removeprefix('variable ')} data"
            )
        return value
    return typed_literal(value, kind)


def _option(option: _RapidOption, form: InstructionForm) -> Expr | None:
    """Return the value of an option, None for a switch.

    Raises:
        RapidSyntaxError: The instruction has no such option, the option follows another argument, or its
            value is missing, wrong or not allowed.
    """
    allowed = form.options.get(option.name)
    if allowed is None:
        names = ", ".join("\\" + name for name in form.options) or "no options"
        raise RapidSyntaxError(
            option.start,
            "rapid.options",
            f"{form.name} has no option {shorten(option.name)}; allowed: {names}",
        )
    slot, kind = allowed
    if option.slot != slot:
        message = (
            f"\\{option.name} follows argument {option.slot} of {form.name}; allowed: after argument {slot}"
        )
        raise RapidSyntaxError(option.start, "rapid.options", message)
    if (option.value is None) != (kind == "switch"):
        requirement = "takes no value" if kind == "switch" else f"needs a value (\\{option.name}:=...)"
        raise RapidSyntaxError(option.start, "rapid.options", f"{form.name}: \\{option.name} {requirement}")
    return None if option.value is None else _argument(option.value, kind)


_MOVE_HEAD = re.compile(
    r"(?:Move(?P<linear>[LJ])|MoveAbsJ)[ \t]+(?P<name>[A-Za-z]\w*)?", re.IGNORECASE | re.ASCII
)
"""Start of a move: its instruction and the name of its target, if that is named."""
_MOVE_KINDS = {"L": "MoveL", "J": "MoveJ"}
# possessive quantifiers: three runs of blanks in a row would backtrack against each other
_MOVE_TAIL = re.compile(
    r"""[ \t]*+(?:\\ID:=(?P<id>\d{1,9}))?[ \t]*+(?P<still>\\NoEOffs)?[ \t]*+,[ \t]*+
    (?P<speed>[A-Za-z]\w*|\[[^\[\]]*\])(?:[ \t]*+\\T:=(?P<time>\d+(?:\.\d+)?))?[ \t]*+,[ \t]*+
    (?P<zone>[A-Za-z]\w*)[ \t]*+,[ \t]*+(?P<tool>[A-Za-z]\w*)
    (?:[ \t]*+\\WObj:=(?P<wobj>[A-Za-z]\w*))?[ \t]*+;""",
    re.IGNORECASE | re.ASCII | re.VERBOSE,
)
"""Rest of a move of the usual form after its target, up to its semicolon."""


def parse_usual_move(cursor: RapidCursor, line: int) -> MoveStatement | None:
    """Parse the move at the cursor if it has the usual form; otherwise return None and leave the cursor.

    In the usual form, target and speed are names or numbers. Zone, tool and work object are names. There are
    no other options than ID, T, WObj and NoEOffs.

    Args:
        cursor: Position in the text.
        line: Line of the statement, from 1.
    """
    text, first = cursor.text, cursor.token.start
    head = _MOVE_HEAD.match(text, first)
    if head is None:
        return None
    kind = "MoveAbsJ" if head["linear"] is None else _MOVE_KINDS[head["linear"].upper()]
    try:
        end = head.end()
        if head["name"]:
            target: Expr | None = _data_name(head["name"], head.start("name"))
        else:
            number_list = parse_number_list(text, end)
            if number_list is None:
                return None
            record = "jointtarget" if kind == "MoveAbsJ" else "robtarget"
            target = Literal(end, record, build_value(record, number_list[0]))
            end = number_list[1]
        tail = _MOVE_TAIL.match(text, end)
        if tail is None or target is None or (tail["still"] and kind != "MoveAbsJ"):
            return None
        zone = _data_name(tail["zone"], tail.start("zone"))
        tool = _data_name(tail["tool"], tail.start("tool"))
        wobj = _data_name(tail["wobj"], tail.start("wobj")) if tail["wobj"] else None
        speed = _speed(text, tail)
        if zone is None or tool is None or speed is None or (tail["wobj"] and wobj is None):
            return None
    except RapidValueError:
        return None
    if tail["time"] and float(tail["time"]) >= MAX_NUMBER:
        return None
    ident = Literal(tail.start("id"), "num", float(tail["id"])) if tail["id"] else None
    time = Literal(tail.start("time"), "num", float(tail["time"])) if tail["time"] else None
    switches = ("noeoffs",) if tail["still"] else ()
    cursor.jump(tail.end())
    return MoveStatement(line, first, kind, target, speed, zone, tool, ident, time, None, wobj, switches)


def _data_name(text: str, start: int) -> Name | None:
    """Return a reference to data, or None for a reserved word. Equal names share one string in memory."""
    return None if text.lower() in RESERVED else Name(start, sys.intern(text))


def _speed(text: str, tail: re.Match[str]) -> Expr | None:
    """Return the speed in the rest of a usual move, a name or speeddata, or None if it is neither."""
    start = tail.start("speed")
    if text[start] != "[":
        return _data_name(tail["speed"], start)
    number_list = parse_number_list(text, start)
    if number_list is None or number_list[1] != tail.end("speed"):
        return None
    return Literal(start, "speeddata", build_value("speeddata", number_list[0]))
