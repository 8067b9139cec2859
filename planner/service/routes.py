"""API routes of jobs, schemas, catalogue, issue codes, health, metrics and sessions.

Dependencies give each route the service, the authenticated caller, and the requested job. Schemas and
catalogue are imported on demand, because loading all processes takes seconds.
"""

import dataclasses
import datetime as dt
import functools
import hashlib
import io
import json
import re
import time
import zipfile
from pathlib import PurePosixPath
from typing import Annotated, Any, Final
from urllib.parse import quote, urlencode

import anyio.to_thread
from fastapi import APIRouter, Cookie, Depends, Header, Query, Request, Response, Security
from fastapi.responses import FileResponse, PlainTextResponse, StreamingResponse
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer
from pydantic import AfterValidator, Field
from sqlalchemy.exc import SQLAlchemyError

from planner.files import RELEASE, THUMBNAIL
from planner.issue_codes import all_codes
from planner.issues import Issue, has_errors
from planner.runtime import plugins
from planner.runtime.plugins import Language
from planner.runtime.version import __version__
from planner.service import audit, idempotency, job_search, metrics, releases
from planner.service.cell_models import CellOut
from planner.service.http_responses import (
    HEAD_REQUEST_KEY,
    TemporaryFileResponse,
    conditional_json,
    gzipped_json,
    is_not_modified,
    stored_file_response,
)
from planner.service.job_search import JobFilter
from planner.service.jobs import EventStream, PlanningLimits
from planner.service.links import (
    DEFAULT_LINK_S,
    MAX_LINK_S,
    VIEWABLE_FILES,
    file_link_refusal,
    view_link_refusal,
)
from planner.service.logs import record_jobs
from planner.service.models import (
    API,
    MAX_TAG_LENGTH,
    MIN_CLIENT_API,
    OPEN_STATES,
    Catalogue,
    CheckOut,
    FileList,
    FileOut,
    Health,
    JobList,
    JobOrder,
    JobOut,
    Kind,
    LinkOut,
    LookedAt,
    Ready,
    Refusal,
    SessionOut,
    State,
    Storage,
)
from planner.service.reading_result import ReadingOptions
from planner.service.security import (
    LOCAL,
    LOCAL_PRINCIPAL,
    SAFE_METHODS,
    Principal,
    RefusedError,
    unauthorised,
    unknown_job,
)
from planner.service.service import Service
from planner.service.storage import Blob, request_body_schema, store_upload
from planner.service.upload_processes import UploadReading
from planner.service.user_texts import Line, normalised_line

COOKIE: Final = "tandem_session"
"""Name of the session cookie."""
_BEARER: Final = HTTPBearer(auto_error=False, description="a token that `tandem token add` created")
"""OpenAPI security scheme of tokens."""
_COOKIE: Final = APIKeyCookie(name=COOKIE, auto_error=False, description="cookie set by POST /v1/session")
"""OpenAPI security scheme of the session cookie."""
JOB_ID: Final = re.compile(r"[0-9a-f]{32}")
"""Pattern of job ids."""

REFUSALS: Final = {
    401: {"model": Refusal, "description": "missing, unknown, revoked or expired token"},
    403: {"model": Refusal, "description": "request from another site, or role of the token not sufficient"},
    404: {"model": Refusal, "description": "not found, or owned by another token"},
    409: {"model": Refusal, "description": "not allowed in the present state of the job"},
    413: {"model": Refusal, "description": "larger than this service accepts"},
    422: {"model": Refusal, "description": "invalid request; everything that is wrong, by code and field"},
    503: {"model": Refusal, "description": "service stopping, or database unavailable; see Retry-After"},
    507: {"model": Refusal, "description": "no space for more files; see /v1/storage"},
    429: {"model": Refusal, "description": "too many requests, jobs or streams; see Retry-After"},
}
"""OpenAPI descriptions of refusals, by HTTP status."""


def refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses for some refusals.

    Args:
        statuses: HTTP statuses.
    """
    return {status: REFUSALS[status] for status in statuses}


AUTH_REFUSALS: Final = refusals(401, 403, 429, 503)
"""Refusals of every address that requires authentication."""
UPLOAD_REFUSALS: Final = refusals(413, 422, 429, 507)
"""Refusals of addresses that take an upload."""


def current_service(request: Request) -> Service:
    """Return the service of the application (dependency)."""
    instance = request.app.state.service
    if not isinstance(instance, Service):
        raise TypeError("the application has no service")
    return instance


def count_unauthenticated(request: Request, service: Service, action: str) -> None:
    """Count an unauthenticated request against the rate limit of its client address.

    Args:
        request: Request.
        service: Service.
        action: What the client does, as the predicate of the message.

    Raises:
        RefusedError: 429.
    """
    address = request.client.host if request.client else ""
    service.failures.take(address, f"address {address} {action}")


def authenticate(
    request: Request,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)] = None,
    cookie: Annotated[str | None, Security(_COOKIE)] = None,
) -> Principal:
    """Authenticate the caller, whatever its role (dependency).

    Args:
        request: Request.
        bearer: Token in the Authorization header.
        cookie: Session cookie.

    Raises:
        RefusedError: 401, 403 beyond the scope of the token, or 429.
    """
    current = current_service(request)
    try:
        principal = _principal(request, bearer, cookie, current)
    except RefusedError:
        count_unauthenticated(request, current, "sends without a valid token")
        raise
    if principal.token != LOCAL:
        current.rates.take(principal.token, "this token sends")
    principal.check_scope(request.method, request.scope["route"].path)
    return principal


def _principal(
    request: Request, bearer: HTTPAuthorizationCredentials | None, cookie: str | None, service: Service
) -> Principal:
    """Authenticate by the token, else by the session cookie, else as the local user if none is required."""
    if bearer is not None:
        return service.auth.authenticate_token(bearer.credentials)
    if "authorization" in request.headers:
        raise unauthorised("Authorization: not a bearer token. Send 'Bearer TOKEN'.")
    if cookie is not None:
        return service.auth.authenticate_session(cookie)
    if service.options.tokens_required:
        raise unauthorised("a token is required. Send the header 'Authorization: Bearer TOKEN'.")
    return LOCAL_PRINCIPAL


CurrentPrincipal = Annotated[Principal, Depends(authenticate)]
CurrentService = Annotated[Service, Depends(current_service)]


def authorise(request: Request, principal: CurrentPrincipal) -> str:
    """Return the token that owns what the request creates, if its role allows the method (dependency).

    Raises:
        RefusedError: 401 or 403.
    """
    principal.check_role("view" if request.method in SAFE_METHODS else "plan")
    return principal.token


AuthorisedOwner = Annotated[str, Depends(authorise)]


def authorised_principal(principal: CurrentPrincipal, _: AuthorisedOwner) -> Principal:
    """Return the caller, if its role allows the method (dependency).

    Its token owns what the request creates.

    Raises:
        RefusedError: 401 or 403.
    """
    return principal


AuthorisedPrincipal = Annotated[Principal, Depends(authorised_principal)]


def own_job(job: str, _: AuthorisedOwner, principal: CurrentPrincipal, service: CurrentService) -> JobOut:
    """Return the job, if the caller or its team owns it (dependency).

    Raises:
        RefusedError: 404, also for jobs of others, so that nobody learns which jobs exist.
    """
    return visible_job(job, principal, service)


def visible_job(job: str, principal: Principal, service: Service) -> JobOut:
    """Return a job that the caller may see.

    Args:
        job: Id from the request.
        principal: Authenticated caller.
        service: Service.

    Raises:
        RefusedError: 404, the job does not exist, belongs to others, or is beyond the scope of the token.
    """
    if not JOB_ID.fullmatch(job):
        raise unknown_job(job)
    owner, job_out = service.jobs.get(job)
    if not service.auth.sees(principal, owner) or not _is_in_scope(principal, job_out):
        raise unknown_job(job)
    record_jobs(job)
    return job_out


def _is_in_scope(principal: Principal, job: JobOut) -> bool:
    """Report whether the scope of a caller contains a job.

    The scope released contains jobs whose release is in force, and if it has a tag, only those with the tag.
    """
    if principal.scope != "released":
        return True
    return job.released and (principal.tag is None or job_search.is_tagged(job.tags, principal.tag))


def _is_file_in_scope(principal: Principal, name: str) -> bool:
    """Report whether a token may read a file of a job in its scope.

    The scope released contains the programs, the release statement, the thumbnail and the viewable pages.
    """
    released = releases.is_program(name) or name in (RELEASE, THUMBNAIL, *VIEWABLE_FILES)
    return principal.scope != "released" or released


OwnJob = Annotated[JobOut, Depends(own_job)]


@dataclasses.dataclass(frozen=True)
class LinkQuery:
    """Query parameters of a link to a file (dependency).

    Attributes:
        expires: End of the link [s since 1970], or None.
        look: Id of a view link, or None.
        signature: Signature of the link, or None if the request is not one of a link.
    """

    expires: Annotated[int | None, Query(ge=0, lt=2**53, description="end of a link [s]")] = None
    look: Annotated[str | None, Query(max_length=32, description="id of a view link")] = None
    signature: Annotated[str | None, Query(max_length=200, description="signature of a link")] = None


def job_to_read(
    request: Request,
    job: str,
    name: str,
    link: Annotated[LinkQuery, Depends(LinkQuery)],
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)] = None,
    cookie: Annotated[str | None, Security(_COOKIE)] = None,
) -> JobOut:
    """Return the job whose file ``name`` is read (dependency).

    Allowed are callers who see the job, anybody with a link to that file, and anybody with a view link that
    opens it. If the request contains a signature, only the link counts, not the token of the caller. The
    token that reads, or that made the link, is stored in ``request.state.reader`` for the audit log.

    Raises:
        RefusedError: 401, 403 or 404.
    """
    service = current_service(request)
    if link.signature is None:
        principal = authenticate(request, bearer, cookie)
        request.state.reader = principal.token
        job_out = visible_job(job, principal, service)
        if not _is_file_in_scope(principal, name):
            raise unknown_file(job, name)
        return job_out
    if link.look is not None:
        job_out, _ = job_of_view_link(request, job, link.look, link.signature, service)
        if name not in VIEWABLE_FILES:
            raise view_link_refusal()
        return job_out
    owner = service.jobs.owner(job) if JOB_ID.fullmatch(job) else None
    team_tokens = () if owner is None else service.auth.team_tokens(owner)
    # The check returns None if the owner of the job made the link.
    maker = service.links.check(job, name, link.expires, link.signature, team_tokens) or owner
    if owner is None or maker is None:
        raise unknown_job(job)
    if not _is_maker_valid(service, maker):
        raise file_link_refusal("the token that created it is no longer valid. Ask for a new one.")
    request.state.reader = maker
    return service.jobs.get(job)[1]


def job_of_view_link(
    request: Request, job: str, link_id: str, signature: str, service: Service
) -> tuple[JobOut, dt.datetime]:
    """Return the job that a view link opens, and the end of the link.

    Args:
        request: Request.
        job: Id of the job.
        link_id: Id of the link.
        signature: Signature of the link.
        service: Service.

    Raises:
        RefusedError: 404 for any invalid link, or 429.
    """
    try:
        maker, expires = service.links.check_view_link(job, link_id, signature)
        owner = service.jobs.owner(job)
        if (
            owner is None
            or not _is_maker_valid(service, maker)
            or maker not in (owner, *service.auth.team_tokens(owner))
        ):
            raise view_link_refusal()
    except RefusedError:
        count_unauthenticated(request, service, "opens invalid links")
        raise
    service.rates.take(f"link {link_id}", "this link is opened")
    request.state.reader = maker
    return service.jobs.get(job)[1], expires


def _is_maker_valid(service: Service, maker: str) -> bool:
    """Report whether links that a token made are still in force.

    Those of the local user are in force while the service requires no tokens.
    """
    return (maker == LOCAL and not service.options.tokens_required) or service.auth.is_valid(maker)


def idempotency_key(
    request: Request,
    given: Annotated[
        str | None,
        Header(
            alias=idempotency.HEADER,
            description="a unique value, such as a UUID: the same request sent again with it creates nothing "
            "new and has the same answer",
            json_schema_extra={
                "minLength": 1,
                "maxLength": idempotency.MAX_KEY_LENGTH,
                "pattern": "^[!-~]+$",
            },
        ),
    ] = None,
) -> str | None:
    """Return the idempotency key of a request (dependency).

    Raises:
        RefusedError: 422.
    """
    del given  # documents the header; several values are detected below
    return idempotency.checked_header(request.headers.getlist(idempotency.HEADER))


Key = Annotated[str | None, Depends(idempotency_key)]


about_router: Final = APIRouter(tags=["about"])


@about_router.get(
    "/v1/health",
    responses={**refusals(403), 503: {"model": Health}},
    response_model_exclude_none=True,
    summary="Whether the process works",
)
def health(service: CurrentService, response: Response) -> Health:
    """Requires no token.

    503 if only a restart helps. An unavailable database or a full disk is reported by /v1/ready.
    """
    try:
        counts = service.jobs.counts()
    except SQLAlchemyError:
        counts = None
    healthy = service.runner.healthy
    response.status_code = 200 if healthy else 503
    return Health(
        status="ok" if healthy and counts is not None else "degraded",
        version=__version__,
        api=API,
        api_oldest=MIN_CLIENT_API,
        workers=service.options.workers,
        queued=None if counts is None else counts.get("queued", 0),
        running=None if counts is None else counts.get("running", 0),
    )


@about_router.get(
    "/v1/ready",
    responses={**refusals(403), 503: {"model": Ready}},
    summary="Whether jobs are accepted and planned",
)
def ready(service: CurrentService, response: Response) -> Ready:
    """Requires no token.

    503 with Retry-After while the database is unavailable, the disk is full, or no jobs are planned. Send
    requests to another host, or later.
    """
    issues = service.unready_issues()
    if issues:
        response.status_code = 503
        response.headers["Retry-After"] = "5"
    return Ready(ready=not issues, issues=issues)


@about_router.get(
    "/metrics", responses=AUTH_REFUSALS, response_class=PlainTextResponse, summary="Metrics for Prometheus"
)
def figures(_: AuthorisedOwner, service: CurrentService) -> PlainTextResponse:
    """Metrics in Prometheus text format.

    They are those of this instance since its start, except jobs and files of the store.
    """
    metrics_text = metrics.metrics_text(
        service.jobs.counts(),
        service.jobs.oldest_waiting(),
        float(service.files.used),
        service.options.workers,
        service.runner.healthy,
    )
    return PlainTextResponse(metrics_text, media_type=metrics.CONTENT_TYPE)


@about_router.get("/v1/processes", responses=AUTH_REFUSALS, summary="Processes")
def known_processes(_: AuthorisedOwner) -> dict[str, str]:
    """What each process does, by its name in problem files."""
    from planner.processes import registry

    return {name: " ".join((model.__doc__ or "").split()) for name, model in registry.schemas().items()}


@about_router.get(
    "/v1/processes/{name}/schema",
    responses=AUTH_REFUSALS | refusals(404),
    summary="JSON schema of a process's operation",
)
def process_schema(name: str, _: AuthorisedOwner) -> dict[str, Any]:
    """Fields of an operation, with ranges, defaults and help. Names of fields end with the unit."""
    from planner.service import catalogue

    return catalogue.process_schema(name)


@about_router.get("/v1/schema", responses=AUTH_REFUSALS, summary="JSON schema of problem files")
def problem_schema(_: AuthorisedOwner) -> dict[str, Any]:
    """Schema of the whole file with the operations of all processes."""
    from planner.service import catalogue

    return catalogue.problem_file()


@about_router.get("/v1/catalogue/{kind}", responses=AUTH_REFUSALS | refusals(422), summary="Built-in entries")
def catalogue_of(kind: Kind, _: AuthorisedOwner) -> Catalogue:
    """Robots and materials with the sources of their data, tools with their schemas, and cells.

    Cells are in the form in which problem files may contain them.
    """
    from planner.service import catalogue

    return Catalogue(entries=catalogue.entries(kind))


@about_router.get("/v1/issues", responses=AUTH_REFUSALS, summary="Issue codes")
def issue_codes(_: AuthorisedOwner) -> dict[str, str]:
    """Every code with its meaning."""
    return {code: entry.meaning for code, entry in all_codes().items()}


@about_router.get("/v1/storage", responses=AUTH_REFUSALS, summary="Space for files")
def storage(owner: AuthorisedOwner, service: CurrentService) -> Storage:
    """Used and allowed size of the caller's files."""
    return Storage(used_mb=service.storage.used(owner) / 1e6, limit_mb=service.limits.token_disk_mb)


@about_router.get(
    "/v1/session",
    responses=AUTH_REFUSALS,
    response_model_exclude_none=True,
    summary="Present token and permissions",
)
def session(principal: CurrentPrincipal, service: CurrentService) -> SessionOut:
    """Name, role, team and scope of the token or session."""
    expires = None if principal.expires is None else dt.datetime.fromtimestamp(principal.expires, dt.UTC)
    tokens_required = service.options.tokens_required
    return SessionOut(
        name=principal.name,
        role=principal.role,
        team=principal.team,
        tokens=tokens_required,
        expires=expires,
        scope=principal.scope,
        tag=principal.tag,
    )


@about_router.post("/v1/session", responses=AUTH_REFUSALS, status_code=204, summary="Log a browser in")
def log_in(request: Request, principal: CurrentPrincipal, service: CurrentService) -> Response:
    """Sets a session cookie for the token in the Authorization header.

    Scripts of pages cannot read the cookie.
    """
    response = Response(status_code=204)
    if principal.token != LOCAL:
        set_session_cookie(request, response, service, principal)
    return response


def set_session_cookie(request: Request, response: Response, service: Service, principal: Principal) -> None:
    """Set the cookie of a new session.

    Args:
        request: Request.
        response: Response that gets the cookie.
        service: Service.
        principal: Authenticated caller.
    """
    cookie, lifetime_s = service.auth.open_session(principal)
    secure = request.url.scheme == "https"
    response.set_cookie(
        COOKIE, cookie, max_age=int(lifetime_s), httponly=True, samesite="strict", secure=secure
    )


@about_router.delete(
    "/v1/session", responses=refusals(403, 503), status_code=204, summary="Log a browser out"
)
def log_out(service: CurrentService, tandem_session: Annotated[str | None, Cookie()] = None) -> Response:
    """Ends the session of the cookie."""
    if tandem_session is not None:
        service.auth.close_session(tandem_session)
    response = Response(status_code=204)
    response.delete_cookie(COOKIE)
    return response


job_router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=AUTH_REFUSALS)
Tag = Annotated[
    str,
    Field(min_length=1, max_length=MAX_TAG_LENGTH),
    AfterValidator(functools.partial(normalised_line, max_length=MAX_TAG_LENGTH)),
]
"""A tag of jobs."""


PLAN_FILE_NAMES: Final = ("plan.json", "plan.npz")
"""Result files that contain the plan."""
PROBLEM_BODY: Final = {"requestBody": request_body_schema({"$ref": "#/components/schemas/ProblemFile"})}
"""OpenAPI description of a body that contains a problem."""
RESULT_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".obj": "model/obj",
    ".npz": "application/octet-stream",
    ".yaml": "application/yaml",
    **{
        ending: "text/plain; charset=utf-8"
        for language in plugins.usable(Language).values()
        for ending in language.file_endings
    },
}
"""Content types of result files, by suffix."""
FILE_RESPONSES: Final[dict[int | str, dict[str, Any]]] = {
    206: {"description": "the requested `Range`"},
    304: {"description": "unchanged (`If-None-Match`)"},
    416: {"description": "a `Range` beyond the end", "content": {"text/plain": {}}},
}
"""Responses of file routes besides 200."""
LIST_RESPONSES: Final[dict[int | str, dict[str, Any]]] = {304: FILE_RESPONSES[304]}
"""Response of list routes besides 200."""
REPORT_SECURITY_POLICY: Final = "sandbox allow-scripts allow-downloads allow-popups; frame-ancestors 'self'"
"""Content security policy of reports.

They contain user data, so they run isolated from this site and without cookies.
"""
PAGE_SIZE: Final = 50
"""Default number of jobs on one page of the list."""
TIME_CURSOR_PATTERN: Final = r"^[0-9]{1,12}\.[0-9]{1,9}-[0-9a-f]{32}$"
"""Pattern of cursors of lists that are ordered by time."""
CURSOR_DESCRIPTION: Final = "`next` of the previous page"
"""OpenAPI description of a cursor."""
CURSOR = Annotated[str | None, Query(pattern=TIME_CURSOR_PATTERN, description=CURSOR_DESCRIPTION)]
LIST_CURSOR = Annotated[
    str | None,
    Query(
        pattern=f"{TIME_CURSOR_PATTERN}|^[A-Za-z0-9_-]{{0,1100}}~[0-9a-f]{{32}}$",
        description=CURSOR_DESCRIPTION,
    ),
]
"""Cursor of lists that may also be ordered by title."""
Search = Annotated[Line, Query(description="words that all occur in name, title, tags or notes")]
Tags = Annotated[list[Tag] | None, Query(max_length=10, description="only with all of these tags")]
EVENT_SCHEMA: Final = {
    "type": "object",
    "description": "one event of the stream",
    "properties": {
        "id": {"type": "string"},
        "event": {"enum": ["state", "progress", "issues", "end"]},
        "data": {"type": "string", "description": "JSON"},
    },
}
"""OpenAPI schema of an event."""


@job_router.post(
    "/jobs",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOAD_REFUSALS,
    openapi_extra=PROBLEM_BODY,
    summary="Plan a problem",
)
async def create(
    request: Request,
    owner: AuthorisedOwner,
    service: CurrentService,
    key: Key,
    timeout_s: Annotated[
        float | None,
        Query(gt=0, le=1e6, description="time limit of planning [s], at most that of the service"),
    ] = None,
    memory_mb: Annotated[
        float | None,
        Query(gt=0, le=1e6, description="memory limit of planning [MB], at most that of the service"),
    ] = None,
) -> JobOut:
    """Upload a problem with its files.

    If an identical problem was planned before, the job has its answer at once.
    """
    upload = await store_upload(request, service.storage, owner, service.limits)
    request_key = idempotency.hashed_key(owner, key, "jobs", upload.content, timeout_s, memory_mb)
    limits = PlanningLimits(timeout_s, memory_mb)
    (created,) = await service.create_idempotent(
        request,
        owner,
        request_key,
        lambda reading: service.create(owner, upload, limits, reading, request_key),
    )
    return created


@job_router.post(
    "/check",
    response_model_exclude_none=True,
    responses=UPLOAD_REFUSALS,
    openapi_extra=PROBLEM_BODY,
    summary="Validate without planning",
)
async def check(
    request: Request,
    owner: AuthorisedOwner,
    service: CurrentService,
    reach: Annotated[bool, Query(description="compute all targets and test their reach")] = False,
    targets: Annotated[
        int | None,
        Query(
            ge=1,
            le=1000,
            description="quick check: reach and clearance of about this number of targets, one by one",
        ),
    ] = None,
) -> CheckOut:
    """Reads a problem and reports its issues.

    A file that cannot be read gives 422. With ``targets``, a quick check samples about that many targets
    and does not test the motion between them; ``looked_at`` states how many. Only ``reach`` tests whether
    there is a path through all targets. Closing the connection ends the check.
    """
    upload = await store_upload(request, service.storage, owner, service.limits)
    options = ReadingOptions(reach=reach or targets is not None, targets=None if reach else targets)
    result = await service.run_in_turn(
        request, owner, lambda reading: service.examine(upload, options, reading)
    )
    return CheckOut(
        ok=not has_errors(result.issues),
        name=result.name,
        digest=result.digest,
        processes=list(result.processes),
        summary=dict(result.summary),
        issues=list(result.issues),
        looked_at=None if result.looked_at is None else LookedAt(**result.looked_at),
    )


@dataclasses.dataclass(frozen=True)
class CellQuery:
    """Query parameters of the drawing of a cell (dependency).

    Attributes:
        operation: Index of the operation.
        targets: Approximate number of targets to sample, or None for none.
        freedom: Freedom to map over the sampled targets, or None.
        job: Job whose plan is drawn as a path through the map, or None.
        reach: Add the reach of each arm over a fixed block.
    """

    operation: Annotated[int, Query(ge=0, le=999, description="index of the operation, from 0")] = 0
    targets: Annotated[
        int | None, Query(ge=2, le=200, description="approximate number of targets to sample")
    ] = None
    freedom: Annotated[
        str | None, Query(max_length=64, description="one of `freedoms` to map over the sampled targets")
    ] = None
    job: Annotated[
        str | None,
        Query(pattern="^[0-9a-f]{32}$", description="job whose plan is drawn as a path through the map"),
    ] = None
    reach: Annotated[
        bool, Query(description="add the reach of each arm over the block, if the block is fixed")
    ] = False


@job_router.post(
    "/cell",
    response_model=CellOut,
    responses=UPLOAD_REFUSALS | refusals(404),
    openapi_extra=PROBLEM_BODY,
    summary="Draw a cell without planning",
)
async def cell(
    request: Request,
    owner: AuthorisedOwner,
    principal: CurrentPrincipal,
    service: CurrentService,
    query: Annotated[CellQuery, Depends(CellQuery)],
) -> Response:
    """Bodies with their triangles, and their poses with all arms at home.

    With ``targets``, also sampled targets, evenly spaced, with the posture of the arms, or why there is
    none. Closing the connection ends the request.
    """
    upload = await store_upload(request, service.storage, owner, service.limits)
    arguments: dict[str, Any] = {
        "operation": query.operation,
        "max_samples": query.targets,
        "freedom": query.freedom,
        "reach": query.reach,
    }
    job = query.job
    if job is not None:
        job_files = await anyio.to_thread.run_sync(
            lambda: service.jobs.files(visible_job(job, principal, service).id)
        )
        arguments["plan"] = [
            [name, str(service.files.path(job_files[name].sha))]
            for name in PLAN_FILE_NAMES
            if name in job_files
        ]

    def draw(reading: UploadReading) -> Response:
        """Draw and compress in the owner's turn: the answer is large, so only a few are prepared at once."""
        result = service.examine(upload, ReadingOptions(cell=arguments), reading)
        if result.cell is None:
            errors = [issue for issue in result.issues if has_errors([issue])]
            is_too_large = all(issue.code == "service.too_large" for issue in errors)
            raise RefusedError(413 if is_too_large else 422, errors)
        fields = {"name": result.name, "digest": result.digest, "issues": result.issues, **result.cell}
        return gzipped_json(request, CellOut.model_validate(fields))

    return await service.run_in_turn(request, owner, draw)


@dataclasses.dataclass(frozen=True)
class JobListQuery:
    """Query parameters of the list of jobs (dependency).

    Attributes:
        limit: Maximum number of jobs on the page.
        cursor: Cursor from the previous page, or None.
        state: Only these states, or None for all.
        search: Words that all occur in name, title, tags or notes.
        tag: Only with all of these tags, or None.
        sort: Order.
    """

    limit: Annotated[int, Query(ge=1, le=200)] = PAGE_SIZE
    cursor: LIST_CURSOR = None
    state: Annotated[list[State] | None, Query(description="only these states")] = None
    search: Search = ""
    tag: Tags = None
    sort: Annotated[JobOrder, Query(description="order: by creation time, title or name, or turn")] = "newest"


@job_router.get(
    "/jobs", response_model=JobList, responses=LIST_RESPONSES | refusals(422), summary="List your jobs"
)
def page(
    request: Request,
    _: AuthorisedOwner,
    principal: CurrentPrincipal,
    service: CurrentService,
    query: Annotated[JobListQuery, Depends(JobListQuery)],
) -> Response:
    """Jobs of the caller and its team, one page at a time.

    304 if ``If-None-Match`` shows that nothing has changed.
    """
    tags = [*(query.tag or ()), *([] if principal.tag is None else [principal.tag])]
    job_filter = JobFilter(
        query.state or (),
        query.search,
        tags,
        query.sort,
        query.cursor,
        released=principal.scope == "released",
    )
    jobs, next_cursor = service.jobs.page(service.auth.owners(principal), job_filter, query.limit)
    return conditional_json(request, JobList(jobs=jobs, next=next_cursor))


@job_router.get(
    "/jobs/{job}", responses=refusals(404), response_model_exclude_none=True, summary="State of a job"
)
def get(job_out: OwnJob) -> JobOut:
    """State, stage, issues and metrics."""
    return job_out


@job_router.get(
    "/jobs/{job}/events",
    summary="Events of a job as they happen",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {"schema": EVENT_SCHEMA}}}, **refusals(404, 422, 429)},
)
def events(
    job_out: OwnJob,
    owner: AuthorisedOwner,
    service: CurrentService,
    last_event_id: Annotated[str | None, Header()] = None,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="number of the last known event")] = 0,
) -> StreamingResponse:
    """Server-sent events from the first one, or after ``Last-Event-ID``.

    Events are ``state`` {state}, ``progress`` {stage, fraction}, ``issues`` {issues; the complete list if
    ``all`` is set}, and ``end`` when no more events follow.
    """
    if last_event_id is not None and last_event_id.isdecimal() and len(last_event_id) < 10:
        after = int(last_event_id)
    return EventStream(service.hub, owner, job_out.id, after)


@job_router.post(
    "/jobs/{job}/cancel", responses=refusals(404), response_model_exclude_none=True, summary="Cancel a job"
)
def cancel(job_out: OwnJob, owner: AuthorisedOwner, service: CurrentService) -> JobOut:
    """A queued job is cancelled at once.

    The worker of a running job is stopped within two seconds. An ended job is not changed.
    """
    return service.jobs.cancel(job_out.id, owner)


@job_router.post(
    "/jobs/{job}/retry",
    responses=refusals(404, 409, 429),
    response_model_exclude_none=True,
    summary="Plan a job again",
)
def retry(job_out: OwnJob, owner: AuthorisedOwner, service: CurrentService) -> JobOut:
    """Queues a job again that crashed, reached a limit or was cancelled.

    409 for queued and running jobs, and for results that depend on the problem alone, because they would be
    the same.
    """
    return service.jobs.retry(job_out.id, owner)


@job_router.delete("/jobs/{job}", responses=refusals(404), status_code=204, summary="Delete a job")
def delete(job_out: OwnJob, owner: AuthorisedOwner, service: CurrentService) -> Response:
    """Deletes a job with its files. A running job is cancelled."""
    service.jobs.cancel(job_out.id, owner, also_delete=True)
    return Response(status_code=204)


@job_router.get("/jobs/{job}/files", responses=refusals(404), summary="Files of a job")
def files(job_out: OwnJob, principal: CurrentPrincipal, service: CurrentService) -> FileList:
    """Its problem (``problem/...``), and its results when it has ended.

    ``release.json`` is included if its programs were released.
    """
    stored_files = service.jobs.files(job_out.id)
    if job_out.release is not None:
        statement = service.releases.statement(job_out, stored_files).content
        stored_files[RELEASE] = Blob(hashlib.sha256(statement).hexdigest(), len(statement))
    file_models = [
        file_out(name, blob)
        for name, blob in sorted(stored_files.items())
        if _is_file_in_scope(principal, name)
    ]
    return FileList(files=file_models)


@job_router.get(
    "/jobs/{job}/files/{name:path}",
    summary="A file of a job",
    response_class=FileResponse,
    responses={
        200: {"content": {"application/octet-stream": {"schema": {"type": "string"}}}},
        **FILE_RESPONSES,
        **refusals(404, 422),
    },
)
def file(
    job_out: Annotated[JobOut, Depends(job_to_read)],
    name: str,
    request: Request,
    service: CurrentService,
    download: Annotated[bool, Query(description="send as an attachment")] = False,
) -> Response:
    """The file with that name in the list of files.

    With ``expires`` and ``signature`` of a link no token is required.
    """
    headers = {"Cache-Control": "private, max-age=3600"}
    if releases.is_program(name) or name == RELEASE:  # the release state may change
        headers = {
            "Cache-Control": "private, no-cache",
            releases.HEADER: releases.release_state(job_out.release),
        }
    if "signature" in request.query_params:  # links are neither cached nor passed on as referrer
        headers |= {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer"}
    if name.endswith(".html"):
        headers["Content-Security-Policy"] = REPORT_SECURITY_POLICY
    saved_as = PurePosixPath(name).name if download else None
    blob = existing_file(service, job_out, name)
    if blob is None:
        content = service.releases.statement(job_out, service.jobs.files(job_out.id)).content
        headers["ETag"] = f'"{hashlib.sha256(content).hexdigest()}"'
        if is_not_modified(request, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        return TemporaryFileResponse(content, service.scratch, content_type(name), saved_as, headers)
    if releases.is_program(name):
        service.releases.read_programs(job_out.id, {name: blob})
    kind = content_type(name)
    answer = stored_file_response(request, service.files.path(blob.sha), blob.sha, kind, headers, saved_as)
    if releases.is_program(name) and answer.status_code != 304:
        by_link = "signature" in request.query_params
        record_program_download(
            request, service, job_out, name, releases.release_state(job_out.release), by_link
        )
    return answer


@job_router.post("/jobs/{job}/links", responses=refusals(404, 422), summary="Link to a file of a job")
def link(
    job_out: OwnJob,
    principal: CurrentPrincipal,
    service: CurrentService,
    name: Annotated[str, Query(max_length=255, description="name in the list of files")],
    seconds: Annotated[
        int, Query(ge=1, le=MAX_LINK_S, description="lifetime of the link [s]")
    ] = DEFAULT_LINK_S,
) -> LinkOut:
    """Address at which a browser reads this file without a token.

    It is valid until the link expires or the token that created it expires or is revoked.
    """
    existing_file(service, job_out, name)
    expires = int(time.time()) + seconds
    expiry_time = dt.datetime.fromtimestamp(expires, dt.UTC)
    details = {"name": job_out.name, "file": name, "until": expiry_time.isoformat()}
    with service.database.write() as db:
        event = audit.AuditEvent("linked", job_out.id, details)
        audit.record_act(service.database, db, principal.token, event)
    token_id = None if service.jobs.owner(job_out.id) == principal.token else principal.token
    query = urlencode(
        {"expires": expires, "signature": service.links.sign(job_out.id, name, expires, token_id)}
    )
    path = f"/v1/jobs/{job_out.id}/files/{quote(name)}?{query}"
    return LinkOut(path=path, expires=expiry_time)


@job_router.get(
    "/jobs/{job}/programs.zip",
    summary="The programs of a job",
    response_class=Response,
    responses={
        200: {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}},
        **FILE_RESPONSES,
        **refusals(404),
    },
)
def programs(
    job_out: OwnJob, principal: CurrentPrincipal, service: CurrentService, request: Request
) -> Response:
    """All programs in one archive, with ``release.json``.

    This file, the header ``Tandem-Release`` and the file name state whether they are released. Programs
    exist if the proof holds.
    """
    stored_programs = {
        name: blob for name, blob in service.jobs.files(job_out.id).items() if name.startswith("programs/")
    }
    if not stored_programs:
        is_open = job_out.state in OPEN_STATES
        message = f"job {job_out.id}: has no programs (state {job_out.state}). "
        message += (
            "Try again when it has ended." if is_open else f"See its issues: GET /v1/jobs/{job_out.id}."
        )
        raise RefusedError(404, Issue("service.unknown_file", message))
    statement = service.releases.statement(job_out, stored_programs)
    parts = json.dumps([sorted(stored_programs.items()), hashlib.sha256(statement.content).hexdigest()])
    tag = f'"{hashlib.sha256(parts.encode()).hexdigest()}"'
    headers = {"ETag": tag, "Cache-Control": "private, no-cache", releases.HEADER: statement.word}
    if is_not_modified(request, tag):
        return Response(status_code=304, headers=headers)
    contents = {
        name.removeprefix("programs/"): content
        for name, content in service.releases.read_programs(job_out.id, stored_programs).items()
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted({**contents, RELEASE: statement.content}.items()):
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    content = buffer.getvalue()
    request.state.reader = principal.token
    record_program_download(request, service, job_out, "programs.zip", statement.word)
    return TemporaryFileResponse(
        content, service.scratch, "application/zip", f"{job_out.name}-{statement.word}.zip", headers
    )


def record_program_download(
    request: Request, service: Service, job: JobOut, file: str, release_state: str, by_link: bool = False
) -> None:
    """Record a download of programs in the audit log. HEAD requests are not recorded.

    Args:
        request: Request, whose state names the reader.
        service: Service.
        job: Job.
        file: Name of the file.
        release_state: Release state.
        by_link: Whether a link was used.
    """
    if not request.scope.get(HEAD_REQUEST_KEY):
        details = {"name": job.name, "file": file, "release": release_state} | (
            {"link": True} if by_link else {}
        )
        audit.record_download(service.database, request.state.reader, job.id, details)


def existing_file(service: Service, job: JobOut, name: str) -> Blob | None:
    """Return a file of a job, or None for ``release.json``, which is generated.

    Args:
        service: Service.
        job: Job.
        name: Name of the file.

    Raises:
        RefusedError: 404.
    """
    blob = service.jobs.files(job.id).get(name)
    if blob is None and not (name == RELEASE and job.release is not None):
        raise unknown_file(job.id, name)
    return blob


def unknown_file(job: str, name: str) -> RefusedError:
    """Return the refusal for an unknown file: 404."""
    message = f"job {job}: file {name[:200]!r} not found. List its files."
    return RefusedError(404, Issue("service.unknown_file", message, field="name"))


def file_out(name: str, blob: Blob) -> FileOut:
    """Convert a stored file to its API model."""
    return FileOut(name=name, size=blob.size, sha256=blob.sha, content_type=content_type(name))


def content_type(name: str) -> str:
    """Return the content type of a file by its name. Uploaded files are never rendered."""
    if name.startswith("problem/files/"):
        return "application/octet-stream"
    return RESULT_TYPES.get(PurePosixPath(name).suffix.lower(), "application/octet-stream")
