"""What is known without a job: schemas, catalogue, issue codes, health, figures; and sessions of browsers.

Schemas and catalogue are imported when they are asked for: with all processes they take seconds to load.
"""

from __future__ import annotations

from typing import Annotated, Any, Final

from fastapi import APIRouter, Cookie, Request, Response
from fastapi.responses import PlainTextResponse

import planner
from planner.issue_codes import CODES
from planner.service.auth import LOCAL, SESSION_S
from planner.service.context import COOKIE, REFUSALS, Caller, Here
from planner.service.metrics import text
from planner.service.models import Catalogue, Health, Kind, Storage

router: Final = APIRouter(tags=["about"], responses=REFUSALS)  # type: ignore[arg-type]


@router.get("/v1/health", responses={503: {"model": Health}}, summary="Whether the service works")
def health(here: Here, response: Response) -> Health:
    """Needs no token. 503 where jobs are not being planned."""
    counts = here.jobs.counts()
    healthy = here.runner.healthy
    response.status_code = 200 if healthy else 503
    return Health(
        status="ok" if healthy else "degraded",
        version=planner.__version__,
        workers=here.options.workers,
        queued=counts.get("queued", 0),
        running=counts.get("running", 0),
    )


@router.get("/metrics", response_class=PlainTextResponse, summary="Figures for Prometheus")
def metrics(owner: Caller, here: Here) -> PlainTextResponse:
    """In Prometheus's text format."""
    del owner
    return PlainTextResponse(text(here), media_type="text/plain; version=0.0.4; charset=utf-8")


@router.get("/v1/processes", summary="The processes")
def known_processes(owner: Caller) -> dict[str, str]:
    """What each one does, by the word that problem files use."""
    del owner
    from planner import processes

    return {name: " ".join((m.__doc__ or "").split()) for name, m in processes.schemas().items()}


@router.get("/v1/processes/{name}/schema", summary="JSON schema of a process's operation")
def process_schema(name: str, owner: Caller) -> dict[str, Any]:
    """The fields of an operation, with ranges, defaults and help; units end their names."""
    del owner
    from planner.service import schemas

    return schemas.process(name)


@router.get("/v1/schema", summary="JSON schema of problem files")
def problem_schema(owner: Caller) -> dict[str, Any]:
    """The whole file with the operations of all processes."""
    del owner
    from planner.service import schemas

    return schemas.problem_file()


@router.get("/v1/catalogue/{kind}", summary="What is built in")
def catalogue_of(kind: Kind, owner: Caller) -> Catalogue:
    """Robots and materials with the sources of their figures, tools with their schemas, cells as problem
    files may have them inside."""
    del owner
    from planner.service import catalogue

    return Catalogue(entries=catalogue.entries(kind))


@router.get("/v1/issues", summary="Issue codes")
def issue_codes(owner: Caller) -> dict[str, str]:
    """Every code with its meaning."""
    del owner
    return dict(CODES)


@router.get("/v1/storage", summary="Room for files")
def storage(owner: Caller, here: Here) -> Storage:
    """What your files take, and may take."""
    return Storage(used_mb=here.storage.used(owner) / 1e6, limit_mb=here.limits.token_disk_mb)


@router.post("/v1/session", status_code=204, summary="Log a browser in")
def log_in(request: Request, owner: Caller, here: Here) -> Response:
    """Sets a cookie in exchange for the token of the Authorization header; pages cannot read it."""
    response = Response(status_code=204)
    if owner != LOCAL:
        response.set_cookie(
            COOKIE,
            here.auth.open_session(owner),
            max_age=int(SESSION_S),
            httponly=True,
            samesite="strict",
            secure=request.url.scheme == "https",
        )
    return response


@router.delete("/v1/session", status_code=204, summary="Log a browser out")
def log_out(here: Here, tandem_session: Annotated[str | None, Cookie()] = None) -> Response:
    """Ends the session of the cookie."""
    if tandem_session is not None:
        here.auth.close_session(tandem_session)
    response = Response(status_code=204)
    response.delete_cookie(COOKIE)
    return response
