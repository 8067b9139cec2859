"""Bundled problems and building elements for the web page, as data and as files.

A problem is given with its cell inlined and its files named by their last path component. An element is
given as its own file, with all files that it references.
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

_FOLDERS_WITHOUT_EXAMPLES: Final = ("cells",)
"""Folders of bundled files that contain no problems."""
_SCRIPT_NAME: Final = re.compile(r"\bmake_\w+\.py")
"""Script that generated the files of an example. Sentences about it are not shown."""
INFEASIBLE_FOLDER: Final = "infeasible"
"""Folder of problems that have no feasible plan."""


@functools.cache
def problems() -> dict[str, dict[str, Any]]:
    """List the bundled problems.

    Returns:
        For each name: ``name``, ``about`` (first comment of the file), ``processes``, ``cell`` (name of a
        bundled cell), ``robots`` and ``feasible``.
    """
    return dict(sorted(_problems()))


@functools.cache
def elements() -> dict[str, dict[str, Any]]:
    """List the bundled building elements.

    Returns:
        For each name: ``about`` (first comment of the file), ``kind`` of its panels, ``file`` (name of the
        element file) and ``files`` (names of the element file and of all files that it references).
    """
    return dict(sorted(_elements()))


def problem(name: str) -> dict[str, Any]:
    """Return a bundled problem as data.

    Args:
        name: Name of the problem.

    Returns:
        ``problem``: its data as JSON, with the cell inlined and files named by their last path component.
        ``cell``: name of the bundled cell. ``files``: names of its files.

    Raises:
        RefusedError: 404, no such problem.
    """
    if name not in problems():
        raise _unknown_problem(name)
    path = _path(name, "problem.yaml")
    data = _load_yaml(path)
    cell = data.get("cell")
    title = ""
    if isinstance(cell, str):
        title = Path(cell).stem
        data["cell"] = _with_base_names(_load_yaml((path.parent / cell).resolve()))
    return {"problem": _with_base_names(data), "cell": title, "files": sorted(_problem_files(path))}


def file(name: str, filename: str) -> Path:
    """Return the path of a file of a bundled problem or element.

    Args:
        name: Name of the problem or element.
        filename: Last path component of the file.

    Raises:
        RefusedError: 404, no such problem, element or file.
    """
    if name not in problems() and name not in elements():
        raise _unknown_problem(name)
    files = _problem_files(_path(name, "problem.yaml")) if name in problems() else {}
    if name in elements():
        files |= _element_files(_path(name, "element.yaml"))
    path = files.get(filename)
    if path is None:
        message = f"bundled problem {name[:80]!r}: file {filename[:80]!r} not found. List its files."
        raise RefusedError(404, Issue("service.unknown_file", message, field="name"))
    return path


def _unknown_problem(name: str) -> RefusedError:
    message = f"bundled problem {name[:80]!r}: not found. List the bundled problems."
    return RefusedError(404, Issue("service.not_found", message, field="name"))


def _problems() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and description of each bundled problem, as :func:`problems` returns them."""
    for path, data in _bundled_with_key("tandem"):
        folder = path.parent.name
        if "operations" not in data:
            continue
        cell = data["cell"]
        cell_data = _load_yaml((path.parent / cell).resolve()) if isinstance(cell, str) else cell
        key = folder if path.name == "problem.yaml" else f"{folder}/{path.stem}"
        processes = [operation.get("process", "") for operation in data["operations"]]
        yield (
            key,
            {
                "name": str(data.get("name", key)),
                "about": _head_comment(path.read_text("utf-8")),
                "processes": list(dict.fromkeys(processes)),
                "cell": Path(cell).stem if isinstance(cell, str) else "",
                "robots": [str(arm.get("robot", "")) for arm in cell_data.get("arms", [])],
                "feasible": folder != INFEASIBLE_FOLDER,
            },
        )


def _elements() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and description of each bundled element, as :func:`elements` returns them."""
    for path, data in _bundled_with_key("element"):
        folder = path.parent.name
        key = folder if path.name == "element.yaml" else f"{folder}/{path.stem}"
        yield (
            key,
            {
                "about": _head_comment(path.read_text("utf-8")),
                "kind": next(iter(data["panels"])),
                "file": path.name,
                "files": sorted(_element_files(path)),
            },
        )


def _bundled_with_key(key: str) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield path and data of the bundled files that contain a top-level key.

    The key tells problems and elements from templates, cells and tables.
    """
    for path in sorted(data_dir("problems").glob("*/*.yaml")):
        data = {} if path.parent.name in _FOLDERS_WITHOUT_EXAMPLES else _load_yaml(path)
        if key in data:
            yield path, data


def _head_comment(text: str) -> str:
    """Return the comment at the head of a problem file, without sentences about scripts and command lines."""
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
    return " ".join(sentence for sentence in sentences if not _SCRIPT_NAME.search(sentence)).strip()


def _path(name: str, default_name: str) -> Path:
    """Return the path of an example: ``default_name`` in its own folder, or the file ``NAME.yaml``."""
    location = data_dir("problems") / name
    return location / default_name if location.is_dir() else location.with_suffix(".yaml")


def _load_yaml(path: Path) -> dict[str, Any]:
    data = yaml.safe_load(path.read_text("utf-8"))
    return data if isinstance(data, dict) else {}


def _problem_files(path: Path) -> dict[str, Path]:
    """Return the bundled files that a bundled problem references, by their last path component."""
    data = _load_yaml(path)
    files = dict(_referenced_files(data, path.parent))
    if isinstance(data.get("cell"), str):
        cell = (path.parent / data["cell"]).resolve()
        files |= dict(_referenced_files(_load_yaml(cell), cell.parent))
    return files


def _element_files(path: Path) -> dict[str, Path]:
    """Return the files of a bundled element: itself, its surface, its templates and their cells."""
    data = _load_yaml(path)
    files = {path.name: path, **dict(_referenced_files(data, path.parent))}
    for job in (*data["jobs"], data.get("cut_blocks") or {}):
        if isinstance(job.get("problem"), str):
            template = path.parent / job["problem"]
            cell = (template.parent / _load_yaml(template)["cell"]).resolve()
            files |= {template.name: template, cell.name: cell, **_problem_files(template)}
    return files


def _referenced_files(data: Any, folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield name and path of the bundled files that data reference. Paths are relative to ``folder``."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key in FILE_KEYS and isinstance(value, str):
                path = (folder / value).resolve()
                if is_file(path) and path.is_relative_to(data_dir("problems").resolve()):
                    yield path.name, path
            else:
                yield from _referenced_files(value, folder)
    elif isinstance(data, list):
        for value in data:
            yield from _referenced_files(value, folder)


def _with_base_names(data: Any) -> Any:
    """Replace each path of a file in data by its last component, at all levels."""
    if isinstance(data, dict):
        return {
            key: Path(value).name if key in FILE_KEYS and isinstance(value, str) else _with_base_names(value)
            for key, value in data.items()
        }
    return [_with_base_names(value) for value in data] if isinstance(data, list) else data
