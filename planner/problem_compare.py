"""Two problems side by side, as their files state them."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from planner.files import is_file

ABSENT: Final = "not given"
LONGEST: Final = 60
"""Longer values are cut for display."""
_NONE: Final = object()


@dataclasses.dataclass(frozen=True)
class Difference:
    """A field in which two problems differ, such as ``settings.clearance_mm``, and its values as text."""

    field: str
    first: str
    second: str


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Where the values of two problems' sources differ, field by field in the order of the files; files that
    they name count by their contents."""
    return tuple(_compare("", first, second))


def _compare(field: str, a: Any, b: Any) -> Iterator[Difference]:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            name = f"{field}.{key}" if field else str(key)
            if key == "file":
                yield from _files(name, a.get(key, _NONE), b.get(key, _NONE))
            else:
                yield from _compare(name, a.get(key, _NONE), b.get(key, _NONE))
    elif isinstance(a, list) and isinstance(b, list):
        for i in range(max(len(a), len(b))):
            own, other = (rows[i] if i < len(rows) else _NONE for rows in (a, b))
            yield from _compare(f"{field}[{i}]", own, other)
    elif type(a) is not type(b) or a != b:
        yield Difference(field, _shown(a), _shown(b))


def _files(field: str, a: Any, b: Any) -> Iterator[Difference]:
    if not isinstance(a, str) or not isinstance(b, str):
        yield from _compare(field, a, b)
    elif (own := _content(a)) != (other := _content(b)):
        yield Difference(field, f"{Path(a).name}, {own}", f"{Path(b).name}, {other}")


def _content(name: str) -> str:
    path = Path(name)
    return f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()}" if is_file(path) else "missing"


def _shown(value: Any) -> str:
    if value is _NONE:
        return ABSENT
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
