"""YAML with the line of every field, so that a refused value can be found in the file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from planner.issues import Issue, TandemError

MAX_BYTES = 5_000_000
"""A problem or cell file larger than this is refused unread; parts belong in files of their own."""


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses repeated keys and reads 1e-3 as a number (YAML 1.2), as people expect."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)


class Document:
    """A parsed file: ``data`` as plain values, :meth:`line` for the place of a field."""

    def __init__(self, path: Path, data: Any, root: yaml.Node | None, text: bytes) -> None:
        self.path = path
        self.data = data
        self.text = text
        self._root = root

    def line(self, location: tuple[str | int, ...]) -> int | None:
        """Line, from 1, of the deepest part of ``location`` that the file has."""
        node, line = self._root, None
        for step in location:
            child = _child(node, step)
            if child is None:
                break
            node, line = child
        return line if line is not None else (1 if self._root is not None else None)


def read(path: Path) -> Document:
    """Parse a YAML file whose top level is a mapping.

    Raises ``TandemError`` with ``problem.missing_file``, ``problem.too_large`` or ``problem.not_yaml``.
    """
    name = str(path)
    if not path.is_file():
        raise TandemError(Issue("problem.missing_file", f"{name}: no such file; check the path", file=name))
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise TandemError(
            Issue(
                "problem.too_large",
                f"{name}: {size / 1e6:.1f} MB, at most {MAX_BYTES / 1e6:.0f} MB are read as a problem file; "
                "put meshes and point lists into files of their own",
                file=name,
                value=size / 1e6,
                limit=MAX_BYTES / 1e6,
                unit="MB",
            )
        )
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8")
        root = yaml.compose(text, Loader=_Loader)
        _refuse_repeated(root, name)
        data = yaml.load(text, Loader=_Loader)  # a SafeLoader
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        detail = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise TandemError(
            Issue(
                "problem.not_yaml",
                f"{name} is not YAML: {detail}; a problem file is a mapping such as 'tandem: 1'",
                file=name,
                line=mark.line + 1 if mark else None,
            )
        ) from error
    if not isinstance(data, dict):
        got = type(data).__name__ if data is not None else "nothing"
        raise TandemError(
            Issue(
                "problem.not_yaml",
                f"{name}: the top level is {got}, expected a mapping that begins with 'tandem: 1'",
                file=name,
                line=1,
            )
        )
    return Document(path, data, root, raw)


def _child(node: yaml.Node | None, step: str | int) -> tuple[yaml.Node, int] | None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == str(step):
                return value, key.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        child = node.value[step]
        return child, child.start_mark.line + 1
    return None


def _refuse_repeated(node: yaml.Node | None, name: str) -> None:
    """YAML lets a later key overwrite an earlier one in silence; a problem file may not."""
    stack = [node]
    seen_nodes: set[int] = set()
    while stack:
        current = stack.pop()
        if id(current) in seen_nodes:
            continue
        seen_nodes.add(id(current))
        if isinstance(current, yaml.MappingNode):
            seen: set[str] = set()
            for key, value in current.value:
                if key.value in seen:
                    raise TandemError(
                        Issue(
                            "problem.duplicate_name",
                            f"key '{key.value}' stands twice in one mapping; keep one",
                            file=name,
                            line=key.start_mark.line + 1,
                            field=str(key.value),
                        )
                    )
                seen.add(key.value)
                stack.append(value)
        elif isinstance(current, yaml.SequenceNode):
            stack.extend(current.value)
