"""Files that a result folder carries: each has the beginning of its contents' SHA-256 as its name."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

_CARRIED: Final = re.compile(r"[0-9a-f]{16}")


def changed(source: Any) -> tuple[str, ...]:
    """Names of carried files of a problem's source that are not what they were when they were carried."""
    out: list[str] = []
    if isinstance(source, Mapping):
        for key, value in source.items():
            path = Path(value) if key == "file" and isinstance(value, str) else None
            if path is None:
                out += changed(value)
            elif path.parent.name == "files" and _CARRIED.fullmatch(path.stem) and _other(path):
                out.append(f"{path.parent.name}/{path.name}")
    elif isinstance(source, list | tuple):
        for value in source:
            out += changed(value)
    return tuple(dict.fromkeys(out))


def _other(path: Path) -> bool:
    """Whether a file has other contents than its name says."""
    return path.is_file() and not hashlib.sha256(path.read_bytes()).hexdigest().startswith(path.stem)
