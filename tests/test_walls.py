"""Imports form no cycle, and every folder is documented; for contracts see :mod:`tests.contracts`."""

from __future__ import annotations

import ast
import functools
import itertools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PLANNER = ROOT / "planner"
PAGES = {
    name: (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("architecture.md", "extending.md")
}
"""Texts of the pages that describe the package, by file name."""
TOP = 10
"""Files at the top of the house at most."""

ImportGraph = dict[str, dict[str, int]]
"""Imported files of each file, with the first line that imports them."""


def import_lines(path: Path, files: dict[str, str]) -> dict[str, int]:
    """Find the files that a file imports, also inside functions and under ``TYPE_CHECKING``.

    Args:
        path: File to read.
        files: Names of files by names of modules. Other imports are ignored.

    Returns:
        Line of the first import of each file.
    """
    lines: dict[str, int] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import. Write the name of the package."
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            modules = [name if name in files else str(node.module) for name in names]
        else:
            continue
        for name in modules:
            if name in files:
                lines[files[name]] = min(node.lineno, lines.get(files[name], node.lineno))
    return lines


@functools.cache
def import_graph() -> ImportGraph:
    """Read all imports among the files of planner and bench."""
    files: dict[str, str] = {}
    for path in [*PLANNER.rglob("*.py"), *(ROOT / "bench").rglob("*.py")]:
        relative = path.relative_to(ROOT)
        parts = relative.parent.parts if path.name == "__init__.py" else relative.with_suffix("").parts
        files[".".join(parts)] = relative.as_posix()
    graph = {file: import_lines(ROOT / file, files) for file in files.values()}
    for file, lines in graph.items():
        lines.pop(file, None)
    return graph


def shortest_circle(graph: ImportGraph, start: str) -> list[str]:
    """Find a shortest circle through a file by breadth-first search.

    Returns:
        Files of the circle, beginning and ending with ``start``. Empty if the file is in no circle.
    """
    previous: dict[str, str] = {}
    queue = [start]
    for file in queue:
        for other in sorted(graph[file]):
            if other == start:
                circle = [start]
                while file != start:
                    circle.append(file)
                    file = previous[file]
                return [start, *reversed(circle)]
            if other not in previous:
                previous[other] = file
                queue.append(other)
    return []


def describe_circle(graph: ImportGraph, circle: list[str]) -> str:
    """List the imports of a circle, one per line."""
    return "\n".join(
        f"  {file}:{graph[file][other]} imports {other}" for file, other in itertools.pairwise(circle)
    )


def test_there_is_no_circle_of_imports() -> None:
    graph = import_graph()
    circles: dict[frozenset[str], str] = {}
    for file in sorted(graph):
        if circle := shortest_circle(graph, file):
            circles.setdefault(frozenset(circle), describe_circle(graph, circle))
    if circles:
        remedy = "Move what both files need to a file of its own, or use a protocol as type."
        pytest.fail("\n\n".join(["circular imports:", *circles.values(), remedy]), pytrace=False)


def test_circles_are_found_wherever_the_import_is(tmp_path: Path) -> None:
    """Imports at load time, under ``TYPE_CHECKING`` and inside functions count."""
    texts = {
        "a": "import p.b\n",
        "b": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p.c import C\n",
        "c": "def f():\n    from p import a\n",
        "d": "from p import a\n",
    }
    files = {f"p.{name}": f"{name}.py" for name in texts}
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(text)
    graph = {file: import_lines(tmp_path / file, files) for file in files.values()}
    assert shortest_circle(graph, "a.py") == ["a.py", "b.py", "c.py", "a.py"]
    assert shortest_circle(graph, "d.py") == []
    assert describe_circle(graph, ["b.py", "c.py", "a.py"]) == (
        "  b.py:3 imports c.py\n  c.py:2 imports a.py"
    )


def test_the_top_of_the_house_is_small_and_every_folder_says_what_it_holds() -> None:
    assert len(list(PLANNER.glob("*.py"))) <= TOP
    folders = {path.parent for path in PLANNER.rglob("*.py")}
    for folder in folders:
        assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))), folder


def section(heading: str) -> str:
    """Text of the page on the architecture from a heading to the next one."""
    _, _, text = PAGES["architecture.md"].partition(f"\n## {heading}\n")
    assert text, f"the page has no section {heading}"
    return text.partition("\n## ")[0]


def test_the_page_lists_every_room() -> None:
    """The table has one row per folder at the top, and the floors name every room that has code."""
    rooms = {path.name for path in PLANNER.iterdir() if path.is_dir() and path.name != "__pycache__"}
    rows = re.findall(r"^\| `(\w+)/` \|", section("Rooms"), re.MULTILINE)
    assert sorted(rows) == sorted(rooms)
    modules = {path.stem for path in PLANNER.glob("*.py")} - {"__init__", "__main__"}
    floors = "\n".join(re.findall(r"^\d+\. (.*)$", section("Floors"), re.MULTILINE))
    assert sorted(re.findall(r"`(\w+)`", floors)) == sorted((rooms - {"data"}) | modules)


@pytest.mark.parametrize("page", PAGES)
def test_files_and_folders_that_the_pages_name_are_there(page: str) -> None:
    """Paths start in ``planner/`` or at the root. A bare file name may stand in any folder of the package."""
    for name in re.findall(r"`([\w./]+(?:\.py|/))`", PAGES[page]):
        below = [] if "/" in name else [*PLANNER.rglob(name)]
        assert any((place / name).exists() for place in (PLANNER, ROOT)) or below, name
