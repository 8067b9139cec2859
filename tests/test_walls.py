"""Imports between rooms of the house are those of the table in docs/architecture.md, and make no circle."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

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


def test_there_is_no_circle_of_imports() -> None:
    """Looked at from each file: what it imports when it is loaded never leads back to it."""
    graph = {name: imported(path, inside=False) & set(FILES) - {name} for name, path in FILES.items()}
    done: set[str] = set()
    on: list[str] = []

    def visit(name: str) -> None:
        if name in on:
            pytest.fail(" -> ".join([*on[on.index(name) :], name]))
        if name in done:
            return
        on.append(name)
        for other in sorted(graph[name]):
            visit(other)
        on.pop()
        done.add(name)

    for name in sorted(graph):
        visit(name)


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
