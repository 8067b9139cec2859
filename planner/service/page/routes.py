"""The page's routes. Pages carry no data of users: their scripts ask the API for it, as the user."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

import planner
from planner.issues import Issue, has_errors
from planner.service.context import Caller, Here
from planner.service.page import examples
from planner.service.refusals import RefusedError, plain
from planner.service.upload import take

router: Final = APIRouter(include_in_schema=False)
ROOT: Final = Path(__file__).resolve().parent
STATIC: Final = ROOT / "static"
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
TEMPLATES: Final = Environment(
    loader=FileSystemLoader(ROOT / "templates"),
    autoescape=select_autoescape(default=True, default_for_string=True),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
PAGES: Final = {
    "new": "New job",
    "compare": "Compare two jobs",
    "login": "Log in",
}


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
    return examples.entries()


@router.get("/ui/example")
def one(owner: Caller, name: Annotated[str, Query(max_length=200)]) -> dict[str, Any]:
    """A bundled problem as data."""
    del owner
    return examples.problem(name)


@router.get("/ui/example/file")
def example_file(
    owner: Caller, name: Annotated[str, Query(max_length=200)], file: Annotated[str, Query(max_length=200)]
) -> FileResponse:
    """A file of a bundled problem."""
    del owner
    return FileResponse(examples.file(name, file), media_type="application/octet-stream")


@router.post("/ui/preview")
async def preview(request: Request, owner: Caller, here: Here) -> JSONResponse:
    """What is known of an upload without planning it, with the shapes that the page draws; 422 as for a
    job."""
    upload = await take(request, here.storage, owner, here.limits)
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
            "issues": [plain(issue) for issue in read.issues],
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
