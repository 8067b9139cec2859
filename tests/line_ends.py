"""Programs with the line ends that tests use to search and change texts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath


def bare(files: Mapping[str, str]) -> dict[str, str]:
    """RAPID modules with bare line feeds, which a controller reads alike; all else as it was written."""
    modules = (".mod", ".modx")
    return {
        name: text.replace("\r\n", "\n") if PurePosixPath(name).suffix in modules else text
        for name, text in files.items()
    }
