"""Programs brought back from a controller: all files of a folder there, by their names in it."""

from pathlib import PurePosixPath

from planner.issues import refusal
from planner.shopfloor.loading.store import Store

MOST_FILES = 10_000
"""Files and folders that are fetched at most: more is no folder of ours."""
MOST_DEEP = 8
"""Folders within each other; ours are two."""
MOST_BYTES = 500_000_000
"""Bytes of all of them at most."""


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
    raise refusal("upload.missing", f"{what}; give the one that is meant by --there")


def fetch(store: Store, folder: str) -> dict[str, bytes]:
    """All files under a folder by their names in it. Raises ``TandemError`` (``upload.missing``)."""
    out: dict[str, bytes] = {}
    todo, count, size = [""], 0, 0
    while todo:
        inner = todo.pop()
        there = store.listing(f"{folder}/{inner}".rstrip("/"))
        if there is None:
            what = f"{folder}: no such folder on the controller; give the one that upload named by --there"
            raise refusal("upload.missing", what)
        for name, deeper in there.items():
            path = f"{inner}/{name}".lstrip("/")
            odd = PurePosixPath(name).name != name or name in (".", "..") or "\\" in name
            if odd or not name.isprintable():
                raise refusal("upload.controller", f"{name!r} is no name of a file in a folder")
            count += 1
            if deeper:
                todo.append(path)
            elif (content := store.read(f"{folder}/{path}")) is not None:
                out[path] = content
                size += len(content)
            if count > MOST_FILES or size > MOST_BYTES or path.count("/") > MOST_DEEP:
                what = (
                    f"{folder}: over {MOST_FILES} files and folders, {MOST_BYTES / 1e6:g} MB or {MOST_DEEP} "
                )
                what += "folders within each other are in it; give the one that upload named by --there"
                raise refusal("upload.missing", what)
    if not out:
        raise refusal("upload.missing", f"{folder}: no files in it")
    return out
