"""The table of attacks and faults names tests that exist, that run, and that assert something."""

from __future__ import annotations

import ast
import re
from typing import Final

import pytest

from tests.service.support import ROOT

ROW: Final = re.compile(r"^\| (\d+)(?:–(\d+))? \|.*\| `([\w./]+)::(\w+)` \|$", re.MULTILINE)
ASSERTING_CALLS: Final = ("raises", "expect")
"""Calls that fail a test beside an ``assert``: pytest's and Playwright's."""
NEVER: Final = ("skip", "skipif", "xfail")
"""Marks by which a test is not run, or not held against anything."""


def _called_name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _asserts(function: ast.AST, helpers: dict[str, ast.FunctionDef], seen: frozenset[str]) -> bool:
    """Whether it has an assertion of something that is not constant, or a function of its file that it calls
    does."""
    for node in ast.walk(function):
        if isinstance(node, ast.Assert) and not isinstance(node.test, ast.Constant):
            return True
        if isinstance(node, ast.Call):
            name = _called_name(node)
            if name in ASSERTING_CALLS:
                return True
            if name in helpers and name not in seen and _asserts(helpers[name], helpers, seen | {name}):
                return True
    return False


def _is_never(node: ast.expr) -> bool:
    """Whether it is a mark, or a call, by which a test never runs: without a condition, or with a constant
    one."""
    name = _called_name(node) if isinstance(node, ast.Call) else getattr(node, "attr", "")
    given = node.args if isinstance(node, ast.Call) else []
    return name in NEVER and (name != "skipif" or all(isinstance(item, ast.Constant) for item in given[:1]))


def fault(source: str, name: str) -> str | None:
    """Return the fault of the named test in a file, or None. Only the source text is read."""
    tree = ast.parse(source)
    functions = {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    test = functions.get(name)
    if test is None:
        return "there is none"
    marks = [
        mark
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
        for mark in (node.value.elts if isinstance(node.value, ast.List | ast.Tuple) else [node.value])
    ]
    calls = [node.value for node in test.body if isinstance(node, ast.Expr)]
    if any(map(_is_never, [*test.decorator_list, *marks, *calls])):
        return "it never runs"
    return None if _asserts(test, functions, frozenset({name})) else "it asserts nothing"


@pytest.mark.parametrize(("part", "min_rows"), [("Attacks", 60), ("Faults", 30)])
def test_each_row_is_a_test(part: str, min_rows: int) -> None:
    text = (ROOT / "docs" / "attacks.md").read_text("utf-8")
    text = text.partition(f"\n## {part}")[2].partition("\n## ")[0]
    rows = ROW.findall(text)
    assert len(rows) == sum(line.startswith("| ") for line in text.splitlines()) - 1  # the head
    number = 0
    for first, last, path, name in rows:
        assert int(first) == number + 1
        number = int(last or first)
        assert fault((ROOT / "tests" / "service" / path).read_text("utf-8"), name) is None, name
    assert number >= min_rows


@pytest.mark.parametrize(
    ("source", "expected_fault"),
    [
        ("def other(): assert x()", "there is none"),
        ("def test_a(): run()", "it asserts nothing"),
        ("def test_a(): assert True", "it asserts nothing"),
        ("def look(): run()\ndef test_a(): look()", "it asserts nothing"),
        ("def look(): assert x()\ndef test_a(): look()", None),
        ("def test_a(shop):\n with pytest.raises(E):\n  run()", None),
        ("@pytest.mark.skip\ndef test_a(): assert x()", "it never runs"),
        ("@pytest.mark.xfail(reason='r')\ndef test_a(): assert x()", "it never runs"),
        ("@pytest.mark.skipif(True, reason='r')\ndef test_a(): assert x()", "it never runs"),
        ("@pytest.mark.skipif(sys.platform == 'win32', reason='r')\ndef test_a(): assert x()", None),
        ("pytestmark = [pytest.mark.skip]\ndef test_a(): assert x()", "it never runs"),
        ("def test_a():\n pytest.skip('r')\n assert x()", "it never runs"),
        ("def test_a():\n if y: pytest.skip('r')\n assert x()", None),
    ],
)
def test_a_row_whose_test_looks_at_nothing_is_refused(source: str, expected_fault: str | None) -> None:
    assert fault(source, "test_a") == expected_fault
