"""Fields of a problem by dotted paths: ``settings.clearance_mm``, ``operations.0.feed_mm_s``,
``cell.arms.left.tool.radius_mm``; an entry of a list by its number or its name."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any


def change(data: dict[str, Any], path: str, value: Any, folder: Path) -> None:
    """Set a field of ``data``; mappings that are missing on the way are made, so that the problem's schema
    says what it does not know. Names of files in the value start at ``folder``.

    Raises ``ValueError``, which names the step, where a list has no such entry, or a value is in the way.
    """
    steps = path.split(".")
    if not all(steps):
        raise ValueError(f"{path!r} is no path; write names and numbers with single dots between them")
    node: Any = data
    for i, step in enumerate(steps[:-1]):
        key = _key(node, step, ".".join(steps[: i + 1]))
        if isinstance(node, dict) and node.get(key) is None:
            node[key] = {}
        node = node[key]
    last = _key(node, steps[-1], path)
    node[last] = _rooted(copy.deepcopy(value), folder, steps[-1])


def _key(node: Any, step: str, path: str) -> str | int:
    """The key of a step in a mapping or list."""
    if isinstance(node, dict):
        return step
    if not isinstance(node, list):
        raise ValueError(f"{path} is below a single value; end the path there")
    if step.isdigit():
        if int(step) >= len(node):
            raise ValueError(f"{path}: the list has {len(node)} entries, counted from 0; choose one of them")
        return int(step)
    named = [i for i, entry in enumerate(node) if isinstance(entry, dict) and entry.get("name") == step]
    if len(named) != 1:
        known = ", ".join(str(e["name"]) for e in node if isinstance(e, dict) and "name" in e) or "none"
        raise ValueError(f"{path}: {len(named)} entries have that name, known are {known}; choose one")
    return named[0]


def _rooted(value: Any, folder: Path, key: str) -> Any:
    """The value with names of files made absolute."""
    if key == "file" and isinstance(value, str):
        return str((folder / value).resolve())
    if isinstance(value, dict):
        return {k: _rooted(v, folder, k) for k, v in value.items()}
    if isinstance(value, list):
        return [_rooted(v, folder, "") for v in value]
    return value
