"""Imports between rooms of the house are those of the table in docs/architecture.md, and make no circle."""

from __future__ import annotations

import ast
import functools
import itertools
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

import planner
from planner.verify.prove import RULE_CODES

ROOT = Path(__file__).parents[1]
PLANNER = ROOT / "planner"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
ABOVE = {"pipeline", "batch", "service", "cli", "__main__", ""}
"""What may import anything; the package itself makes its imports when they are asked for."""
EVERYWHERE = {"issues", "files"}
"""Rooms that every room may import."""
TOP = 10
"""Files at the top of the house at most."""


def module(path: Path) -> str:
    """The name of a file's module without ``planner.``."""
    name = ".".join(path.relative_to(PLANNER).with_suffix("").parts)
    return name.removesuffix("__init__").removesuffix(".")


FILES = {module(path): path for path in PLANNER.rglob("*.py")}


@functools.cache
def imports(path: Path) -> tuple[set[str], set[str]]:
    """Modules of the house that a file imports: when it is loaded, and anywhere. The trees of all files are
    two million objects, which every collection of garbage would go through in all tests behind these: none
    is kept."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return of_house(tree.body), of_house(ast.walk(tree))


def imported(path: Path, inside: bool = True) -> set[str]:
    """Modules of the house that a file imports, ``inside`` of functions too."""
    return imports(path)[inside]


def of_house(nodes: Iterable[ast.AST]) -> set[str]:
    found = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "planner":
            package = str(node.module).removeprefix("planner").removeprefix(".")
            for alias in node.names:
                whole = f"{package}.{alias.name}".removeprefix(".")
                found.add(whole if whole in FILES else package)
    return found


def room(name: str) -> str:
    return name.split(".")[0]


def table() -> dict[str, set[str]]:
    """Rooms and what each may import, as the page has them."""
    text = PAGE.split("## Walls")[1].split("\n## ")[0]
    out: dict[str, set[str]] = {}
    for left, right in re.findall(r"^\| (`.*) \| (.*) \|$", text, re.MULTILINE):
        rooms = re.findall(r"`(\w+)`", left)
        others = set(re.findall(r"`(\w+)`", right)) | (set(rooms) if "one another" in right else set())
        out |= dict.fromkeys(rooms, others)
    return out


@pytest.mark.parametrize("name", sorted({room(name) for name in FILES} - ABOVE))
def test_rooms_import_what_the_page_lists(name: str) -> None:
    allowed = table()[name] | EVERYWHERE | {name}
    wrong = {
        f"{file} imports {other}"
        for file, path in FILES.items()
        if room(file) == name
        for other in imported(path)
        if room(other) not in allowed
    }
    assert not wrong, "docs/architecture.md, Walls, does not list this"


def test_every_row_is_needed() -> None:
    used: dict[str, set[str]] = {}
    for file, path in FILES.items():
        used.setdefault(room(file), set()).update(room(other) for other in imported(path))
    groups = [re.findall(r"`(\w+)`", left) for left in re.findall(r"^\| (`[^|]*) \|", PAGE, re.MULTILINE)]
    for name, others in table().items():
        group = next((set(rooms) for rooms in groups if name in rooms and rooms[0] in table()), {name})
        together = set().union(*(used.get(one, set()) for one in group))
        assert others - together - group == set(), f"{name}: listed, but not imported"


WORDS_OF_PROGRAMS = {"claims.vocabulary", "claims.sag"}
"""Modules of claims that motion and post may know: sentences, signals and names of moves, arms that sag."""
CLAIMS_OF_NO_PROCESS = {"Claim", "HoldsStock", "ArmSags", "FEED_WAY", "ForceFrame", "on_straight_moves_alone"}
"""What they may know of ``claims.claim``: what a robot carries and bends under, and kinds by name."""


@pytest.mark.parametrize("name", ["motion", "post"])
def test_motion_and_post_ask_no_process(name: str) -> None:
    """What they need of a process is a word of `Targets`, not a claim that they look for."""
    wrong = set()
    for file, path in FILES.items():
        if room(file) != name:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("planner.claims"):
                package = str(node.module).removeprefix("planner.")
                known = {alias.name for alias in node.names}
                if package == "claims":
                    known = {one for one in known if f"claims.{one}" not in WORDS_OF_PROGRAMS}
                elif package == "claims.claim":
                    known -= CLAIMS_OF_NO_PROCESS
                elif package in WORDS_OF_PROGRAMS:
                    continue
                wrong |= {f"{file} imports {package}.{one}" for one in known}
    assert not wrong, "docs/architecture.md, Walls: motion and post ask no process"


CIRCULAR_FILES = {
    "planner/batch/batch_file.py",
    "planner/batch/compare.py",
    "planner/batch/division.py",
    "planner/batch/job.py",
    "planner/batch/run.py",
    "planner/batch/worker.py",
    "planner/batch/workers.py",
    "planner/cli/command_line.py",
    "planner/cli/loading.py",
    "planner/pipeline.py",
}
"""Files that still are in a circle of imports. The list may only become shorter."""
PUBLIC_NAMES = "planner/__init__.py"
"""Not part of the graph: it loads the public names on first use, and other files only read its version."""

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
    files = {name: file for name, file in files.items() if file != PUBLIC_NAMES}
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
    for file in sorted(graph.keys() - CIRCULAR_FILES):
        if circle := shortest_circle(graph, file):
            circles.setdefault(frozenset(circle), describe_circle(graph, circle))
    if circles:
        remedy = "Move what both files need to a file of its own, or use a protocol as type."
        pytest.fail("\n\n".join(["circular imports:", *circles.values(), remedy]), pytrace=False)


def test_exceptions_from_the_rule_about_circles_are_needed() -> None:
    graph = import_graph()
    unneeded = sorted(
        file for file in CIRCULAR_FILES if file not in graph or not shortest_circle(graph, file)
    )
    if unneeded:
        text = "\n".join(f"  {file}" for file in unneeded)
        pytest.fail(f"in no circle of imports any more:\n{text}\nRemove from CIRCULAR_FILES.", pytrace=False)


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


def test_the_package_itself_is_imported_for_its_version_only() -> None:
    """The graph of imports omits ``planner/__init__.py``, so nothing may reach other files through it."""
    public = set(planner.__all__) - {"__version__"}
    wrong = []
    for path in PLANNER.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if not re.search(r"\b(from planner import|import planner)\b", text):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module == "planner":
                names = {alias.name for alias in node.names}
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                names = {node.attr} if node.value.id == "planner" else set()
            else:
                continue
            modules = {name for name in names if name in FILES or f"{name}.__init__" in FILES}
            wrong += [f"{path.relative_to(ROOT)}:{node.lineno}: {name}" for name in names & public - modules]
    assert not wrong, "import these names from the files that define them"


def test_the_top_of_the_house_is_small_and_every_folder_says_what_it_holds() -> None:
    assert len(list(PLANNER.glob("*.py"))) <= TOP
    folders = {path.parent for path in PLANNER.rglob("*.py")}
    for folder in folders:
        assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))), folder
    listed = set(re.findall(r"`(\w+)/`", PAGE.split("## Folders")[1].split("\n## ")[0]))
    assert {path.name for path in folders if path.parent == PLANNER} <= listed


def test_the_page_lists_every_rule_where_it_stands() -> None:
    text = PAGE.split("by file in `verify/rules/`")[1].split("\nAny other")[0]
    listed = {
        name: [f"verify.{code}" for code in codes.split(", ")]
        for name, codes in re.findall(r"^\| `(\w+\.py)` \| (.*) \|$", text, re.MULTILINE)
    }
    found = {
        path.name: re.findall(r'^@rule\(\s*"([\w.]+)"', path.read_text(encoding="utf-8"), re.MULTILINE)
        for path in (PLANNER / "verify" / "rules").glob("*.py")
    }
    assert listed == {name: codes for name, codes in found.items() if codes}
    assert sorted(code for codes in listed.values() for code in codes) == sorted(RULE_CODES)


def test_files_that_the_page_names_are_there() -> None:
    for name in re.findall(r"`((?:\w+/)*\w+\.py)`", PAGE):
        assert any((place / name).is_file() for place in (PLANNER, ROOT)) or list(PLANNER.rglob(name)), name
