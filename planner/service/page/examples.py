"""Bundled problems as starting points: what each one is, its data with the cell inside, and its files."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import yaml

from planner.catalogue import data_dir
from planner.files import is_file
from planner.issues import Issue
from planner.service.refusals import RefusedError

_SKIPPED: Final = ("cells",)
_OTHER: Final = ("faces.yaml", "expect.yaml")
_SCRIPT: Final = re.compile(r"\bmake_\w+\.py")
INFEASIBLE: Final = "infeasible"
"""The folder of problems that have no plan."""


@functools.cache
def entries() -> dict[str, dict[str, Any]]:
    """By their names: ``name``, ``about`` (its first comment), ``processes``, ``cell`` (a bundled one),
    ``robots``, ``feasible``."""
    return dict(sorted(_entries()))


def problem(name: str) -> dict[str, Any]:
    """``problem``: its data as JSON, with the cell inside and files called by their last step; ``cell``: what
    the bundled cell is called; ``files``: names of its files. Raises :class:`RefusedError`, 404."""
    path = _path(name)
    data = _data(path)
    cell = data.get("cell")
    title = ""
    if isinstance(cell, str):
        title = Path(cell).stem
        data["cell"] = _renamed(_data((path.parent / cell).resolve()))
    return {"problem": _renamed(data), "cell": title, "files": sorted(_files(name))}


def file(name: str, wanted: str) -> Path:
    """The file that a bundled problem calls ``wanted``; raises :class:`RefusedError`, 404."""
    found = _files(name).get(wanted)
    if found is None:
        what = f"bundled problem {name[:80]!r} has no file {wanted[:80]!r}; its list has their names"
        raise RefusedError(404, Issue("service.unknown_file", what, field="name"))
    return found


def _entries() -> Iterator[tuple[str, dict[str, Any]]]:
    root = data_dir("problems")
    for path in sorted(root.glob("*/*.yaml")):
        folder = path.parent.name
        if folder in _SKIPPED or path.name in _OTHER:
            continue
        data = _data(path)
        if "operations" not in data:
            continue
        cell = data["cell"]
        inside = _data((path.parent / cell).resolve()) if isinstance(cell, str) else cell
        key = folder if path.name == "problem.yaml" else f"{folder}/{path.stem}"
        processes = [operation.get("process", "") for operation in data["operations"]]
        yield (
            key,
            {
                "name": str(data.get("name", key)),
                "about": _about(path.read_text("utf-8")),
                "processes": list(dict.fromkeys(processes)),
                "cell": Path(cell).stem if isinstance(cell, str) else "",
                "robots": [str(arm.get("robot", "")) for arm in inside.get("arms", [])],
                "feasible": folder != INFEASIBLE,
            },
        )


def _about(text: str) -> str:
    """The comment at the head of a problem file, without remarks on who wrote the file."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    sentences = re.split(r"(?<=\.) (?=[A-Z0-9])", " ".join(lines))
    return " ".join(one for one in sentences if not _SCRIPT.search(one)).strip()


def _path(name: str) -> Path:
    if name not in entries():
        what = f"bundled problem {name[:80]!r}: there is none; list the bundled problems"
        raise RefusedError(404, Issue("service.not_found", what, field="name"))
    inside = data_dir("problems") / name
    return inside / "problem.yaml" if inside.is_dir() else inside.with_suffix(".yaml")


def _data(path: Path) -> dict[str, Any]:
    data = yaml.safe_load(path.read_text("utf-8"))
    return data if isinstance(data, dict) else {}


def _files(name: str) -> dict[str, Path]:
    """Files that a bundled problem names, by the last step of their names; only such as are bundled too."""
    path = _path(name)
    data = _data(path)
    found = dict(_named(data, path.parent))
    if isinstance(data.get("cell"), str):
        cell = (path.parent / data["cell"]).resolve()
        found |= dict(_named(_data(cell), cell.parent))
    return found


def _named(data: Any, folder: Path) -> Iterator[tuple[str, Path]]:
    if isinstance(data, dict):
        for key, value in data.items():
            if key == "file" and isinstance(value, str):
                path = (folder / value).resolve()
                if is_file(path) and path.is_relative_to(data_dir("problems").resolve()):
                    yield path.name, path
            else:
                yield from _named(value, folder)
    elif isinstance(data, list):
        for value in data:
            yield from _named(value, folder)


def _renamed(data: Any) -> Any:
    if isinstance(data, dict):
        return {
            key: Path(value).name if key == "file" and isinstance(value, str) else _renamed(value)
            for key, value in data.items()
        }
    return [_renamed(value) for value in data] if isinstance(data, list) else data
