"""Each row of ``slow_tests.txt`` names a test, and a file keeps at least one test for ``make test``."""

from __future__ import annotations

import ast
from collections import defaultdict

import pytest

from tests.conftest import SLOW_TESTS

ROOT = SLOW_TESTS.parent.parent


def _rows() -> dict[str, dict[str, int]]:
    rows: dict[str, dict[str, int]] = defaultdict(dict)
    for line in SLOW_TESTS.read_text("utf-8").splitlines():
        every, test = line.split()
        file, _, name = test.partition("::")
        assert int(every) >= 0 and name not in rows[file], line
        rows[file][name] = int(every)
    return rows


@pytest.mark.parametrize("file", sorted(_rows()))
def test_slow_tests_exist_and_leave_fast_ones(file: str) -> None:
    tree = ast.parse((ROOT / file).read_text("utf-8"))
    tests = {
        node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }
    rows = _rows()[file]
    assert set(rows) <= tests
    assert tests - {name for name, every in rows.items() if every == 0}
