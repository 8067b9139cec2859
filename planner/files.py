"""Writing files whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file through a temporary name in its folder, then rename: readers see the old file or the new
    one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    data = content.encode("utf-8") if isinstance(content, str) else content
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def write_folder(folder: Path, files: Mapping[str, str | bytes], owned: tuple[str, ...]) -> None:
    """Make ``folder`` hold exactly ``files`` among the names ``owned`` (files or subfolders at its top).

    Everything is first written to a hidden sibling inside ``folder``; only then are the old owned entries
    replaced, one rename each, so that an interruption leaves no half-written file. Other people's files in
    the folder stay.
    """
    folder.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=".tandem-", dir=folder))
    try:
        for name, content in files.items():
            write_whole(staging / name, content)
        for name in owned:
            _remove(folder / name)
            if (staging / name).exists():
                (staging / name).replace(folder / name)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
