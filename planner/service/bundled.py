"""What is bundled to begin with, for the page: problems and building elements, as data and as files.

A problem is given with its cell inside and its files called by the last step of their names; an element as
its own file, with all that it names.
"""

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import yaml

from planner.catalogue.robots import data_dir
from planner.files import FILE_KEYS, is_file
from planner.issues import Issue
from planner.service.security import RefusedError

_NO_EXAMPLES: Final = ("cells",)
"""Folders of bundled files that hold no problems."""
_SCRIPT: Final = re.compile(r"\bmake_\w+\.py")
"""A script that made an example's files; what its comment says of it is not shown."""
INFEASIBLE: Final = "infeasible"
"""The folder of problems that have no plan."""


@functools.cache
def problems() -> dict[str, dict[str, Any]]:
    """By their names: ``name``, ``about`` (its first comment), ``processes``, ``cell`` (a bundled one),
    ``robots``, ``feasible``."""
    return dict(sorted(_problems()))


@functools.cache
def elements() -> dict[str, dict[str, Any]]:
    """By their names: ``about`` (its first comment), ``kind`` of its panels, ``file`` of the element, and
    ``files``, all that it names and itself."""
    return dict(sorted(_elements()))


def problem(name: str) -> dict[str, Any]:
    """``problem``: its data as JSON, with the cell inside and files called by their last step; ``cell``: what
    the bundled cell is called; ``files``: names of its files. Raises :class:`RefusedError`, 404."""
    if name not in problems():
        raise _none(name)
    path = _path(name, "problem.yaml")
    data = _data(path)
    cell = data.get("cell")
    title = ""
    if isinstance(cell, str):
        title = Path(cell).stem
        data["cell"] = _renamed(_data((path.parent / cell).resolve()))
    return {"problem": _renamed(data), "cell": title, "files": sorted(_files(path))}


def file(name: str, wanted: str) -> Path:
    """The file that a bundled problem or element calls ``wanted``; raises :class:`RefusedError`, 404."""
    if name not in problems() and name not in elements():
        raise _none(name)
    files = _files(_path(name, "problem.yaml")) if name in problems() else {}
    if name in elements():
        files |= _files_of_element(_path(name, "element.yaml"))
    found = files.get(wanted)
    if found is None:
        what = f"bundled problem {name[:80]!r} has no file {wanted[:80]!r}; its list has their names"
        raise RefusedError(404, Issue("service.unknown_file", what, field="name"))
    return found


def _none(name: str) -> RefusedError:
    what = f"bundled problem {name[:80]!r}: there is none; list the bundled problems"
    return RefusedError(404, Issue("service.not_found", what, field="name"))


def _problems() -> Iterator[tuple[str, dict[str, Any]]]:
    for path, data in _bundled("tandem"):
        folder = path.parent.name
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


def _elements() -> Iterator[tuple[str, dict[str, Any]]]:
    for path, data in _bundled("element"):
        folder = path.parent.name
        key = folder if path.name == "element.yaml" else f"{folder}/{path.stem}"
        yield (
            key,
            {
                "about": _about(path.read_text("utf-8")),
                "kind": next(iter(data["panels"])),
                "file": path.name,
                "files": sorted(_files_of_element(path)),
            },
        )


def _bundled(key: str) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Bundled files whose data begin with that key: templates, cells and tables have none."""
    for path in sorted(data_dir("problems").glob("*/*.yaml")):
        data = {} if path.parent.name in _NO_EXAMPLES else _data(path)
        if key in data:
            yield path, data


def _about(text: str) -> str:
    """The comment at the head of a problem file, without remarks on who wrote the file and what to type."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        words = line.lstrip("# ").rstrip()
        if not words.startswith("tandem "):
            lines.append(words)
        elif lines and lines[-1].endswith(":"):
            lines[-1] = f"{lines[-1][:-1]}."
    sentences = re.split(r"(?<=\.) (?=[A-Z0-9])", " ".join(lines))
    return " ".join(one for one in sentences if not _SCRIPT.search(one)).strip()


def _path(name: str, usual: str) -> Path:
    inside = data_dir("problems") / name
    return inside / usual if inside.is_dir() else inside.with_suffix(".yaml")


def _data(path: Path) -> dict[str, Any]:
    data = yaml.safe_load(path.read_text("utf-8"))
    return data if isinstance(data, dict) else {}


def _files(path: Path) -> dict[str, Path]:
    """Files that a bundled problem names, by the last step of their names; only such as are bundled too."""
    data = _data(path)
    found = dict(_named(data, path.parent))
    if isinstance(data.get("cell"), str):
        cell = (path.parent / data["cell"]).resolve()
        found |= dict(_named(_data(cell), cell.parent))
    return found


def _files_of_element(path: Path) -> dict[str, Path]:
    """The same of a bundled element: itself, its surface, its templates and their cells."""
    data = _data(path)
    found = {path.name: path, **dict(_named(data, path.parent))}
    for one in (*data["jobs"], data.get("cut_blocks") or {}):
        if isinstance(one.get("problem"), str):
            template = path.parent / one["problem"]
            cell = (template.parent / _data(template)["cell"]).resolve()
            found |= {template.name: template, cell.name: cell, **_files(template)}
    return found


def _named(data: Any, folder: Path) -> Iterator[tuple[str, Path]]:
    if isinstance(data, dict):
        for key, value in data.items():
            if key in FILE_KEYS and isinstance(value, str):
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
            key: Path(value).name if key in FILE_KEYS and isinstance(value, str) else _renamed(value)
            for key, value in data.items()
        }
    return [_renamed(value) for value in data] if isinstance(data, list) else data
