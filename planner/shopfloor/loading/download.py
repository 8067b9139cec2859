"""Download of programs: all files of a folder on a controller, by their names in it."""

from pathlib import PurePosixPath

from planner.issues import issue_error
from planner.shopfloor.loading.store import Store

MAX_FILES = 10_000
"""Maximum number of files and folders. A folder with more was not written by Tandem."""
MAX_DEPTH = 8
"""Maximum nesting of folders. Uploads have two levels."""
MAX_BYTES = 500_000_000
"""Maximum total size [bytes]."""


def folder(store: Store, name: str) -> str:
    """Folder that an upload of the result ``name`` created: that name, possibly with a number.

    Raises:
        TandemError: ``upload.missing`` if there is none, or more than one.
    """
    names = store.listing("") or {}
    matching = [
        one for one, deeper in names.items() if deeper and one.removeprefix(name).strip("_0123456789") == ""
    ]
    matching = sorted(one for one in matching if one == name or one.startswith(f"{name}_"))
    if len(matching) == 1:
        return matching[0]
    what = (
        f"{name}: no such folder on the controller"
        if not matching
        else f"the controller has more than one: {', '.join(matching)}"
    )
    raise issue_error("upload.missing", f"{what}; name the right one with --there")


def fetch(store: Store, folder: str) -> dict[str, bytes]:
    """Fetch all files in a folder, by their names in it.

    Raises:
        TandemError: ``upload.missing``.
    """
    out: dict[str, bytes] = {}
    todo, count, size = [""], 0, 0
    while todo:
        inner = todo.pop()
        listing = store.listing(f"{folder}/{inner}".rstrip("/"))
        if listing is None:
            what = f"{folder}: no such folder on the controller; give --there the folder that upload reported"
            raise issue_error("upload.missing", what)
        for name, deeper in listing.items():
            path = f"{inner}/{name}".lstrip("/")
            odd = PurePosixPath(name).name != name or name in (".", "..") or "\\" in name
            if odd or not name.isprintable():
                raise issue_error("upload.controller", f"{name!r} is not a valid file name")
            count += 1
            if deeper:
                todo.append(path)
            elif (content := store.read(f"{folder}/{path}")) is not None:
                out[path] = content
                size += len(content)
            if count > MAX_FILES or size > MAX_BYTES or path.count("/") > MAX_DEPTH:
                what = f"{folder}: over {MAX_FILES} files and folders, {MAX_BYTES / 1e6:g} MB or {MAX_DEPTH} "
                what += "nested folders; give --there the folder that upload reported"
                raise issue_error("upload.missing", what)
    if not out:
        raise issue_error("upload.missing", f"{folder}: it has no files")
    return out
