"""Download of programs: all files of a folder on a controller, by their paths in that folder."""

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
    """Return the folder that an upload of the result ``name`` created: that name, or that name and a number.

    Raises:
        TandemError: ``upload.missing`` if there is none, or more than one.
    """
    names = store.listing("") or {}
    matching = [
        entry
        for entry, is_folder in names.items()
        if is_folder and entry.removeprefix(name).strip("_0123456789") == ""
    ]
    matching = sorted(entry for entry in matching if entry == name or entry.startswith(f"{name}_"))
    if len(matching) == 1:
        return matching[0]
    text = (
        f"{name}: no such folder on the controller"
        if not matching
        else f"the controller has more than one: {', '.join(matching)}"
    )
    raise issue_error("upload.missing", f"{text}; name the right one with --there")


def fetch(store: Store, folder: str) -> dict[str, bytes]:
    """Fetch the contents of all files in a folder of a controller and its subfolders, by relative path.

    Raises:
        TandemError: ``upload.missing`` if there is no such folder, it has no files, or it is too large;
            ``upload.controller`` for an invalid file name.
    """
    out: dict[str, bytes] = {}
    subfolders, count, size = [""], 0, 0
    while subfolders:
        subfolder = subfolders.pop()
        listing = store.listing(f"{folder}/{subfolder}".rstrip("/"))
        if listing is None:
            text = f"{folder}: no such folder on the controller; give --there the folder that upload reported"
            raise issue_error("upload.missing", text)
        for name, is_folder in listing.items():
            path = f"{subfolder}/{name}".lstrip("/")
            # a name that would lead out of the folder must not be written to disk
            is_invalid = PurePosixPath(name).name != name or name in (".", "..") or "\\" in name
            if is_invalid or not name.isprintable():
                raise issue_error("upload.controller", f"{name!r} is not a valid file name")
            count += 1
            if is_folder:
                subfolders.append(path)
            elif (content := store.read(f"{folder}/{path}")) is not None:
                out[path] = content
                size += len(content)
            if count > MAX_FILES or size > MAX_BYTES or path.count("/") > MAX_DEPTH:
                text = f"{folder}: over {MAX_FILES} files and folders, {MAX_BYTES / 1e6:g} MB or {MAX_DEPTH} "
                text += "nested folders; give --there the folder that upload reported"
                raise issue_error("upload.missing", text)
    if not out:
        raise issue_error("upload.missing", f"{folder}: it has no files")
    return out
