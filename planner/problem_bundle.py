"""Problems as files that can be carried: file names made absolute, files packed, or counted in a digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from planner import yaml_lines
from planner.files import is_file
from planner.problem import Problem


def bundle(problem: Problem) -> dict[str, bytes]:
    """The problem as files that stand alone: ``problem.yaml`` with the cell inside, and what it names in
    ``files/``.

    Reading the bundle gives a problem with the same digest, so a result folder can be proven wherever it is
    carried.
    """
    files: dict[str, bytes] = {}

    def carry(path: Path) -> str:
        content = path.read_bytes()
        name = f"files/{hashlib.sha256(content).hexdigest()[:16]}{path.suffix.lower()}"
        files[name] = content
        return name

    text = yaml.safe_dump(_each_file(problem.source, carry), sort_keys=False, allow_unicode=True)
    return {"problem.yaml": text.encode(), **files}


def resolved(data: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The file's data with its cell inside and every file name made absolute."""
    out: dict[str, Any] = _each_file(data, lambda path: str(folder / path))
    if isinstance(data.get("cell"), str):
        path = folder / data["cell"]
        out["cell"] = _each_file(yaml_lines.read(path).data, lambda name: str(path.parent / name))
    return out


def digest(source: Mapping[str, Any]) -> str:
    """SHA-256 over the problem's values and the contents of its files: where they lie and comments do not
    matter.
    """

    def content(path: Path) -> str:
        return hashlib.sha256(path.read_bytes()).hexdigest() if is_file(path) else "missing"

    text = json.dumps(_each_file(source, content), sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _each_file(data: Any, change: Callable[[Path], str]) -> Any:
    """A copy of plain data with every value of a key ``file`` changed."""
    if isinstance(data, Mapping):
        return {
            k: change(Path(v)) if k == "file" and isinstance(v, str) else _each_file(v, change)
            for k, v in data.items()
        }
    if isinstance(data, list):
        return [_each_file(v, change) for v in data]
    return data
