"""Expressions of RAPID, and number lists read in one step."""

from __future__ import annotations

import json
import re
from typing import Any

from planner.verify.rapid_ast import Aggregate, Binary, Expr, Function, Literal, Name, Unary
from planner.verify.rapid_lexer import Cursor, RapidSyntaxError, shown
from planner.verify.rapid_values import NUMBERS, OPAQUE, RapidValueError, base_type, build
from planner.verify.rapid_words import RESERVED
from planner.verify.values import LARGEST

MAX_DEPTH = 40
MAX_OPERATORS = 60
"""As many as one expression may have: what is read here is walked through by recursion."""

NUMERIC = re.compile(r"[\[\]\d+\-.eE, \t\r\n]*")
_COMPARE = frozenset({"=", "<>", "<", ">", "<=", ">="})


def expression(cursor: Cursor, longest_string: int, depth: int = 0) -> Expr:
    """One expression: [NOT] terms joined by OR and XOR, of relations joined by AND. Raises
    `RapidSyntaxError`.
    """
    if depth > MAX_DEPTH:
        raise cursor.fault(f"at most {MAX_DEPTH} nested brackets")
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
    if token.kind == "symbol" and token.text in _COMPARE:
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
    if value >= LARGEST:
        raise RapidSyntaxError(start, "rapid.number", f"{shown(text)} is too large for a number")
    return value


def _signed(cursor: Cursor, longest: int, depth: int) -> Expr:
    sign = cursor.take()
    if depth > MAX_DEPTH:
        raise cursor.fault(f"at most {MAX_DEPTH} nested signs")
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
    if depth > MAX_DEPTH:
        raise cursor.fault(f"at most {MAX_DEPTH} nested brackets")
    cursor.take()
    items = [expression(cursor, longest, depth + 1)]
    while cursor.take_symbol(","):
        items.append(expression(cursor, longest, depth + 1))
    cursor.expect_symbol("]", "or a comma in the list")
    return Aggregate(start, tuple(items))


_DECODER = json.JSONDecoder()


def number_list(text: str, start: int) -> tuple[list[Any], int] | None:
    """Nested number list at `start` and the offset behind it, or None when it is not plainly one.

    A list of plain numbers is JSON too, and the JSON reader is fast. Anything else (names, truths, faults)
    returns None, and the ordinary way reads it and says what is wrong.
    """
    try:
        found, end = _DECODER.raw_decode(text, start)
    except (ValueError, RecursionError):
        return None
    if NUMERIC.fullmatch(text, start, end) is None or text.count("[", start, end) > MAX_DEPTH:
        return None
    return (found, end) if isinstance(found, list) and _finite(found) else None


def _finite(found: Any) -> bool:
    if isinstance(found, list):
        return bool(found) and all(map(_finite, found))
    return bool(-LARGEST < found < LARGEST)


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
    if kind in OPAQUE or isinstance(found, Name | Function | Unary | Binary):
        return found
    items = plain(found)
    if items is None:
        return found
    try:
        return Literal(found.start, base_type(kind) if kind in NUMBERS else kind, build(kind, items))
    except RapidValueError as wrong:
        raise RapidSyntaxError(found.start, wrong.code, wrong.message) from None
