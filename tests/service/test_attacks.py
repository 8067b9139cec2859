"""The table of attacks and faults names tests that there are."""

from __future__ import annotations

import re
from typing import Final

import pytest

from tests.service.support import ROOT

ROW: Final = re.compile(r"^\| (\d+)(?:–(\d+))? \|.*\| `([\w./]+)::(\w+)` \|$", re.MULTILINE)


@pytest.mark.parametrize(("part", "least"), [("Attacks", 60), ("Faults", 30)])
def test_each_row_is_a_test(part: str, least: int) -> None:
    text = (ROOT / "docs" / "attacks.md").read_text("utf-8")
    text = text.partition(f"\n## {part}")[2].partition("\n## ")[0]
    rows = ROW.findall(text)
    assert len(rows) == sum(line.startswith("| ") for line in text.splitlines()) - 1  # the head
    number = 0
    for first, last, path, name in rows:
        assert int(first) == number + 1
        number = int(last or first)
        assert f"def {name}(" in (ROOT / "tests" / "service" / path).read_text("utf-8"), name
    assert number >= least
