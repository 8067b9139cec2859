"""Messages with one sentence are templates beside their issue codes, and each is filled completely."""

from __future__ import annotations

import ast
import string
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from planner.issue_codes import CODES, format_message

ROOT: Final = Path(__file__).parent.parent
MAKERS: Final = ("Issue", "issue_error")
"""Callables whose first two arguments are a code and a message."""


def _calls() -> Iterator[tuple[str, ast.Call]]:
    for path in sorted((ROOT / "planner").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", node


def _name(call: ast.Call) -> str | None:
    return call.func.id if isinstance(call.func, ast.Name) else None


def _code(call: ast.Call) -> str | None:
    first = call.args[0] if call.args else None
    return first.value if isinstance(first, ast.Constant) and isinstance(first.value, str) else None


def _fields(template: str) -> set[str]:
    return {
        name.partition("[")[0] for _, name, _, _ in string.Formatter().parse(template) if name is not None
    }


def test_every_template_is_filled_with_exactly_its_fields() -> None:
    """In one place of the code: a second one would have a sentence of its own."""
    places = defaultdict(list)
    for place, call in _calls():
        if _name(call) == "format_message":
            code = _code(call)
            assert code is not None and all(keyword.arg for keyword in call.keywords), place
            message = CODES[code].message
            assert message is not None, place
            assert {keyword.arg for keyword in call.keywords} == _fields(message), place
            places[code].append(place)
    assert sorted(places) == sorted(code for code, row in CODES.items() if row.message is not None)
    assert {code: found for code, found in places.items() if len(found) > 1} == {}


def _sentences(tree: ast.AST) -> dict[ast.expr, ast.expr]:
    """Names in functions that stand for one text, which is assigned once, with that text."""
    out: dict[ast.expr, ast.expr] = {}
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            values = defaultdict(list)
            for node in ast.walk(function):
                if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                    values[node.targets[0].id].append(node.value)
                elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                    values[node.target.id] += [node.target, node.value]
            for node in ast.walk(function):
                if isinstance(node, ast.Name) and len(found := values[node.id]) == 1:
                    out[node] = found[0]
    return out


def test_a_sentence_of_one_code_is_in_the_table() -> None:
    """A message that is written where the only issue of its code is made belongs beside the code."""
    named, written = defaultdict(set), {}
    for path in sorted((ROOT / "planner").rglob("*.py")):
        if path.parent.name == "issue_codes":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        sentences = _sentences(tree)
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            place = f"{path.relative_to(ROOT)}:{call.lineno}"
            for argument in (*call.args, *(keyword.value for keyword in call.keywords)):
                if isinstance(argument, ast.Constant) and argument.value in CODES:
                    named[argument.value].add(place)
            if _name(call) in MAKERS and len(call.args) > 1 and (code := _code(call)) in CODES:
                message = sentences.get(call.args[1], call.args[1])
                if isinstance(message, ast.JoinedStr | ast.Constant):
                    written[code] = place
    assert {code: place for code, place in written.items() if named[code] == {place}} == {}


def test_a_code_without_template_has_no_message() -> None:
    with pytest.raises(KeyError, match=r"'internal\.error' has no message template"):
        format_message("internal.error")
    with pytest.raises(KeyError, match=r"no\.such\.code"):
        format_message("no.such.code")
