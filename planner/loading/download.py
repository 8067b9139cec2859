"""Programs brought back from a controller: all files of a folder there, by their names in it."""

from __future__ import annotations

from pathlib import PurePosixPath

from planner.issues import Issue, TandemError
from planner.loading.store import Store

MOST_FILES = 10_000
"""Files that are fetched at most: more is no folder of ours."""


def folder(store: Store, name: str) -> str:
    """The folder that an upload of the result named ``name`` made: itself, or with a number. Raises
    ``TandemError`` (``upload.missing``) where there is none, or more than one."""
    there = store.listing("") or {}
    own = [
        one for one, deeper in there.items() if deeper and one.removeprefix(name).strip("_0123456789") == ""
    ]
    own = sorted(one for one in own if one == name or one.startswith(f"{name}_"))
    if len(own) == 1:
        return own[0]
    what = (
        f"{name}: no such folder on the controller"
        if not own
        else f"more than one is there: {', '.join(own)}"
    )
    raise TandemError(Issue("upload.missing", f"{what}; give the one that is meant by --there"))


def fetch(store: Store, folder: str) -> dict[str, bytes]:
    """All files under a folder by their names in it. Raises ``TandemError`` (``upload.missing``)."""
    out: dict[str, bytes] = {}
    todo = [""]
    while todo:
        inner = todo.pop()
        there = store.listing(f"{folder}/{inner}".rstrip("/"))
        if there is None:
            what = f"{folder}: no such folder on the controller; give the one that upload named by --there"
            raise TandemError(Issue("upload.missing", what))
        for name, deeper in there.items():
            path = f"{inner}/{name}".lstrip("/")
            if PurePosixPath(name).name != name or name in (".", "..") or "\\" in name:
                raise TandemError(Issue("upload.controller", f"{name!r} is no name of a file in a folder"))
            if len(out) >= MOST_FILES:
                what = f"{folder}: over {MOST_FILES} files in it; give the one that upload named by --there"
                raise TandemError(Issue("upload.missing", what))
            if deeper:
                todo.append(path)
            elif (content := store.read(f"{folder}/{path}")) is not None:
                out[path] = content
    if not out:
        raise TandemError(Issue("upload.missing", f"{folder}: no files in it"))
    return out
