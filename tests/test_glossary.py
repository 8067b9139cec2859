"""The glossary: each term once, each with a place in the code that exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
ROW = re.compile(r"^\| (?P<term>[^|]+) \| (?P<meaning>[^|]+\.) \| `(?P<place>[^`|]+)` \|$", re.MULTILINE)
HEADER = re.compile(r"^\| term \| meaning \| in code \|$|^\|---\|---\|---\|$")


def rows() -> list[re.Match[str]]:
    return list(ROW.finditer((ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")))


def words_of_the_code() -> set[str]:
    """Names that the package defines or uses: definitions, attributes, parameters."""
    result: set[str] = set()
    for path in (ROOT / "planner").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                result.add(node.name)
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                result.add(node.target.id)
            elif isinstance(node, ast.arg):
                result.add(node.arg)
    return result


def test_every_row_is_read() -> None:
    lines = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").splitlines()
    tables = [line for line in lines if line.startswith("|") and not HEADER.match(line)]
    assert len(tables) == len(rows())


def test_each_term_stands_once() -> None:
    terms = [term for row in rows() for term in row["term"].split(", ")]
    assert sorted(terms, key=str.lower) == sorted(set(terms), key=str.lower)
    assert 60 <= len(rows()) <= 100


def test_each_place_exists() -> None:
    known = words_of_the_code()
    paths = [f"/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / "planner").rglob("*")]
    paths += [f"/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / "tests").rglob("*.py")]
    missing = [
        row["place"]
        for row in rows()
        if row["place"] not in known
        and not any(path.endswith("/" + row["place"].rstrip("/")) for path in paths)
    ]
    assert not missing
