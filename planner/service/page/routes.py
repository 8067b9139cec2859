"""The page's routes, and bundled problems as starting points.

Pages carry no data of users: their scripts ask the API for it, as the user. Of a bundled problem
the page has what it is, its data with the cell inside, and its files.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import yaml
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

import planner
from planner.catalogue.robots import data_dir
from planner.files import is_file
from planner.issues import Issue, has_errors
from planner.service.routes import Caller, Here
from planner.service.security import RefusedError, issue_json
from planner.service.upload import take_upload

_NO_EXAMPLES: Final = ("cells",)
"""Folders of bundled files that hold no problems."""
_NO_PROBLEMS: Final = ("faces.yaml", "expect.yaml")
"""Bundled files of YAML that are no problems."""
_SCRIPT: Final = re.compile(r"\bmake_\w+\.py")
"""A script that made an example's files; what its comment says of it is not shown."""
INFEASIBLE: Final = "infeasible"
"""The folder of problems that have no plan."""


@functools.cache
def bundled_entries() -> dict[str, dict[str, Any]]:
    """By their names: ``name``, ``about`` (its first comment), ``processes``, ``cell`` (a bundled one),
    ``robots``, ``feasible``."""
    return dict(sorted(_entries()))


def bundled_problem(name: str) -> dict[str, Any]:
    """``problem``: its data as JSON, with the cell inside and files called by their last step; ``cell``: what
    the bundled cell is called; ``files``: names of its files. Raises :class:`RefusedError`, 404."""
    path = _path(name)
    data = _data(path)
    cell = data.get("cell")
    title = ""
    if isinstance(cell, str):
        title = Path(cell).stem
        data["cell"] = _renamed(_data((path.parent / cell).resolve()))
    return {"problem": _renamed(data), "cell": title, "files": sorted(_files(name))}


def bundled_file(name: str, wanted: str) -> Path:
    """The file that a bundled problem calls ``wanted``; raises :class:`RefusedError`, 404."""
    found = _files(name).get(wanted)
    if found is None:
        what = f"bundled problem {name[:80]!r} has no file {wanted[:80]!r}; its list has their names"
        raise RefusedError(404, Issue("service.unknown_file", what, field="name"))
    return found


def _entries() -> Iterator[tuple[str, dict[str, Any]]]:
    root = data_dir("problems")
    for path in sorted(root.glob("*/*.yaml")):
        folder = path.parent.name
        if folder in _NO_EXAMPLES or path.name in _NO_PROBLEMS:
            continue
        data = _data(path)
        if "operations" not in data:
            continue
        cell = data["cell"]
        inside = _data((path.parent / cell).resolve()) if isinstance(cell, str) else cell
        key = folder if path.name == "problem.yaml" else f"{folder}/{path.stem}"
        processes = [operation.get("process", "") for operation in data["operations"]]
        yield (
            key,
            {
                "name": str(data.get("name", key)),
                "about": _about(path.read_text("utf-8")),
                "processes": list(dict.fromkeys(processes)),
                "cell": Path(cell).stem if isinstance(cell, str) else "",
                "robots": [str(arm.get("robot", "")) for arm in inside.get("arms", [])],
                "feasible": folder != INFEASIBLE,
            },
        )


def _about(text: str) -> str:
    """The comment at the head of a problem file, without remarks on who wrote the file."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    sentences = re.split(r"(?<=\.) (?=[A-Z0-9])", " ".join(lines))
    return " ".join(one for one in sentences if not _SCRIPT.search(one)).strip()


def _path(name: str) -> Path:
    if name not in bundled_entries():
        what = f"bundled problem {name[:80]!r}: there is none; list the bundled problems"
        raise RefusedError(404, Issue("service.not_found", what, field="name"))
    inside = data_dir("problems") / name
    return inside / "problem.yaml" if inside.is_dir() else inside.with_suffix(".yaml")


def _data(path: Path) -> dict[str, Any]:
    data = yaml.safe_load(path.read_text("utf-8"))
    return data if isinstance(data, dict) else {}


def _files(name: str) -> dict[str, Path]:
    """Files that a bundled problem names, by the last step of their names; only such as are bundled too."""
    path = _path(name)
    data = _data(path)
    found = dict(_named(data, path.parent))
    if isinstance(data.get("cell"), str):
        cell = (path.parent / data["cell"]).resolve()
        found |= dict(_named(_data(cell), cell.parent))
    return found


def _named(data: Any, folder: Path) -> Iterator[tuple[str, Path]]:
    if isinstance(data, dict):
        for key, value in data.items():
            if key == "file" and isinstance(value, str):
                path = (folder / value).resolve()
                if is_file(path) and path.is_relative_to(data_dir("problems").resolve()):
                    yield path.name, path
            else:
                yield from _named(value, folder)
    elif isinstance(data, list):
        for value in data:
            yield from _named(value, folder)


def _renamed(data: Any) -> Any:
    if isinstance(data, dict):
        return {
            key: Path(value).name if key == "file" and isinstance(value, str) else _renamed(value)
            for key, value in data.items()
        }
    return [_renamed(value) for value in data] if isinstance(data, list) else data


router: Final = APIRouter(include_in_schema=False)
ROOT: Final = Path(__file__).resolve().parent
"""The folder of the page."""
STATIC: Final = ROOT / "static"
"""The folder of the files that are sent as they are."""
POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data:",
        "connect-src 'self'",
        "frame-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
        "require-trusted-types-for 'script'",
    )
)
"""Nothing but this site's own files; no inline script or style, and no text becomes markup."""
TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
"""Content types of these files."""
TEMPLATES: Final = Environment(
    loader=FileSystemLoader(ROOT / "templates"),
    autoescape=select_autoescape(default=True, default_for_string=True),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
"""Templates of the pages; all that is put in them is escaped."""
PAGES: Final = {
    "new": "New job",
    "compare": "Compare two jobs",
    "login": "Log in",
}
"""Titles of the pages, by name."""


@router.get("/")
def home(here: Here) -> HTMLResponse:
    """The history of jobs."""
    return _page("jobs", "Jobs", here)


@router.get("/ui/jobs/{job}")
def job(job: str, here: Here) -> HTMLResponse:
    """One job; the script finds out whether there is one of that id."""
    return _page("job", "Job", here, job=job)


@router.get("/ui/static/{name:path}")
def static(name: str) -> Response:
    """Styles and scripts of this version."""
    path = STATIC / name
    kind = TYPES.get(path.suffix)
    if kind is None or ".." in name or not path.is_file():
        raise _unknown(f"/ui/static/{name}")
    return FileResponse(path, media_type=kind, headers={"Cache-Control": "no-cache"})


@router.get("/ui/examples")
def bundled(owner: Caller) -> dict[str, Any]:
    """Bundled problems."""
    del owner
    return bundled_entries()


@router.get("/ui/example")
def one(owner: Caller, name: Annotated[str, Query(max_length=200)]) -> dict[str, Any]:
    """A bundled problem as data."""
    del owner
    return bundled_problem(name)


@router.get("/ui/example/file")
def example_file(
    owner: Caller, name: Annotated[str, Query(max_length=200)], file: Annotated[str, Query(max_length=200)]
) -> FileResponse:
    """A file of a bundled problem."""
    del owner
    return FileResponse(bundled_file(name, file), media_type="application/octet-stream")


@router.post("/ui/preview")
async def preview(request: Request, owner: Caller, here: Here) -> JSONResponse:
    """What is known of an upload without planning it, with the shapes that the page draws; 422 as for a
    job."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    read = await here.in_turn(
        request, owner, lambda reading: here.examine(upload, draw=True, reading=reading)
    )
    return JSONResponse(
        {
            "ok": not has_errors(read.issues),
            "name": read.name,
            "digest": read.digest,
            "processes": list(read.processes),
            "summary": dict(read.summary),
            "issues": [issue_json(issue) for issue in read.issues],
            "shapes": list(read.shapes),
        }
    )


@router.get("/ui/{name}")
def page(name: str, here: Here) -> HTMLResponse:
    """The other pages."""
    if name not in PAGES:
        raise _unknown(f"/ui/{name}")
    return _page(name, PAGES[name], here)


def _page(name: str, title: str, here: Any, **more: str) -> HTMLResponse:
    text = TEMPLATES.get_template(f"{name}.html").render(
        title=title,
        page=name,
        version=planner.__version__,
        tokens=here.options.tokens_required,
        **more,
    )
    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-store"}
    return HTMLResponse(text, headers=headers)


def _unknown(path: str) -> RefusedError:
    return RefusedError(404, Issue("service.not_found", f"{path[:200]}: there is no such page; begin at /"))
