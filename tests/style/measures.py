"""What is counted in Python sources and in Markdown pages."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).parent
ROOT: Final = FOLDER.parent.parent
FOLDERS: Final = ("planner", "docs", "tests", "bench")
SLICES: Final = ("processes", "languages")
"""Folders of ``planner`` whose subfolders are rooms of their own."""

NAMES: Final = frozenset((FOLDER / "names.txt").read_text(encoding="utf-8").split())
"""Names that say what happened to a value, or where it was met, and not what it is."""
PREFIXES: Final = tuple(f"{mark}{word}_" for mark in ("", "_") for word in ("MOST", "LEAST", "SAME"))
"""Beginnings of constants: ``MAX_``, ``MIN_`` and ``_TOLERANCE`` are the standard ones."""
PHRASES: Final = re.compile(
    "|".join(rf"\b{line}\b" for line in (FOLDER / "phrases.txt").read_text(encoding="utf-8").splitlines()),
    re.IGNORECASE,
)
"""Phrases that a reader has to translate into technical English."""
EXCEPTIONS: Final = frozenset(
    tuple(line.partition(":")[0].split())
    for line in (FOLDER / "exceptions.txt").read_text("utf-8").splitlines()
)
"""File and name of what keeps its name because users write or read it, with the reason after the colon."""
Counts = dict[str, int]
"""Numbers by measure: ``names``, ``phrases``, ``repeated_classes``, ``undocumented``, ``absent_names``."""


def room_name(path: Path) -> str:
    """Return the room of a file: ``docs``, ``planner/motion`` or ``planner/processes/forming``."""
    parts = path.relative_to(ROOT).parts
    depth = 1 if parts[0] != "planner" else 3 if parts[1] in SLICES else 2
    return "/".join(parts[: min(depth, len(parts) - 1)])


def files() -> Iterator[Path]:
    """Yield the Python sources and Markdown pages of all rooms."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".md") and not path.is_symlink():
                yield path


def findings() -> dict[str, dict[str, list[str]]]:
    """Return what breaks the style guide, as ``file:line: text``, by room and measure."""
    out: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    classes: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for path in files():
        room, at, text = room_name(path), path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
        for match in PHRASES.finditer(text):
            out[room]["phrases"].append(f"{at}:{text.count(chr(10), 0, match.start()) + 1}: {match[0]}")
        if path.suffix == ".py":
            tree = ast.parse(text)
            for measure, line, what in _of_tree(tree, public="planner" in at.split("/")[:1]):
                if measure == "names" and (at, what) in EXCEPTIONS:
                    continue
                out[room][measure].append(f"{at}:{line}: {what}")
            if at.startswith("planner/"):
                for node in tree.body:
                    if isinstance(node, ast.ClassDef):
                        classes[node.name].append((room, f"{at}:{node.lineno}: {node.name}"))
    for places in classes.values():
        for room, what in places if len(places) > 1 else ():
            out[room]["repeated_classes"].append(what)
    return out


def counts() -> dict[str, Counts]:
    """Return the number of findings by room and measure; rooms without findings are left out."""
    result = findings()
    return {room: {key: len(result[room][key]) for key in sorted(result[room])} for room in sorted(result)}


def risen(stored: Mapping[str, Counts], counted: Mapping[str, Counts]) -> list[str]:
    """Return a sentence for each count that is higher than the stored one."""
    return [
        f"{room}: {measure} rose from {stored.get(room, {}).get(measure, 0)} to {number}"
        for room, row in counted.items()
        for measure, number in row.items()
        if number > stored.get(room, {}).get(measure, 0)
    ]


def _of_tree(tree: ast.Module, *, public: bool) -> Iterator[tuple[str, int, str]]:
    for name, line in _definitions(tree):
        if name.lower().strip("_") in NAMES or name.startswith(PREFIXES):
            yield "names", line, name
    if not public:
        return
    for node in ast.walk(tree):
        for name in _absent_names(node):
            yield "absent_names", getattr(node, "lineno", 0), name
    yield from _undocumented(tree.body)


def _absent_names(node: ast.AST) -> Iterator[str]:
    """Yield arguments and attributes that a docstring documents and the code does not have."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        documented = _documented(node, "Args")
        if node.args.kwarg is None:
            yield from (name for name in documented if name not in _parameters(node))
    elif isinstance(node, ast.ClassDef):
        known = {
            *(item.id for item in ast.walk(node) if isinstance(item, ast.Name)),
            *(item.attr for item in ast.walk(node) if isinstance(item, ast.Attribute)),
            *(item.name for item in node.body if isinstance(item, ast.FunctionDef)),
        }
        yield from (name for name in _documented(node, "Attributes") if name not in known)
        for item in node.body:
            if isinstance(item, ast.FunctionDef) and item.name == "__init__" and item.args.kwarg is None:
                yield from (name for name in _documented(node, "Args") if name not in _parameters(item))


def _parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    listed = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs, node.args.vararg)
    return {item.arg for item in listed if item is not None}


def _documented(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef, section: str) -> Iterator[str]:
    """Yield the names that a section of the docstring documents."""
    found = re.search(rf"^{section}:\n((?:    .*\n?|\n)+)", ast.get_docstring(node) or "", re.MULTILINE)
    if found:
        yield from re.findall(r"^    (\w+)(?: \([^)]*\))?:", found[1], re.MULTILINE)


def _undocumented(body: list[ast.stmt]) -> Iterator[tuple[str, int, str]]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if node.name.startswith("_"):
                continue
            if not ast.get_docstring(node):
                yield "undocumented", node.lineno, node.name
            if isinstance(node, ast.ClassDef):
                yield from _undocumented(node.body)


def _definitions(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield names of functions, parameters, classes and constants with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, node.lineno
            for item in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs):
                yield item.arg, item.lineno
        elif isinstance(node, ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, node.lineno
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Name) and target.id.isupper():
                    yield target.id, node.lineno


def totals(counted: Mapping[str, Counts]) -> Counts:
    """Return the sums over all rooms."""
    out: Counter[str] = Counter()
    for row in counted.values():
        out.update(row)
    return dict(out)
