"""The API's routes: jobs over HTTP; schemas, catalogue, issue codes, health, figures; sessions.

Every route is given the service, who asks, and the job that is asked for. Schemas and catalogue are
imported when they are asked for: with all processes they take seconds to load.
"""

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
from planner.service import audit, finding, idempotency, metrics, releases
from planner.service.answers import HEAD, MadeFile, is_known, packed, stored_file, tagged
from planner.service.cell_models import CellOut
from planner.service.finding import Wanted
from planner.service.jobs import Stream
from planner.service.links import LINK_S, LONGEST_LINK_S, TO_LOOK_AT, bad_link, no_look
from planner.service.logs import about
from planner.service.models import (
    API,
    LONGEST_TAG,
    OLDEST_API,
    OPEN,
    Catalogue,
    CheckOut,
    FileList,
    FileOut,
    Health,
    JobList,
    JobOut,
    Kind,
    LinkOut,
    LookedAt,
    Ready,
    Refusal,
    SessionOut,
    Sort,
    State,
    Storage,
)
from planner.service.security import (
    ANYBODY,
    LOCAL,
    SAFE_METHODS,
    RefusedError,
    Who,
    unauthorised,
    unknown_job,
)
from planner.service.service import Service
from planner.service.storage import Blob, documented, take_upload
from planner.service.texts import Line, line
from planner.service.upload_processes import Reading

COOKIE: Final = "tandem_session"
"""Name of the cookie of a session."""
_BEARER: Final = HTTPBearer(auto_error=False, description="a token that `tandem token add` made")
"""How the description of the interface tells of tokens."""
_COOKIE: Final = APIKeyCookie(name=COOKIE, auto_error=False, description="what POST /v1/session set")
"""How the description of the interface tells of the cookie."""
JOB_ID: Final = re.compile(r"[0-9a-f]{32}")
"""A job's identifier."""

REFUSALS: Final = {
    401: {"model": Refusal, "description": "no token, or one that is unknown, revoked or over"},
    403: {"model": Refusal, "description": "a request of another site, or beyond the token's role"},
    404: {"model": Refusal, "description": "there is no such thing, or it is another token's"},
    409: {"model": Refusal, "description": "the job's state does not allow it"},
    413: {"model": Refusal, "description": "larger than this service takes"},
    422: {"model": Refusal, "description": "all that is wrong, by code and field"},
    503: {"model": Refusal, "description": "the service is stopping, or its database away; see Retry-After"},
    507: {"model": Refusal, "description": "no room for more files; see /v1/storage"},
    429: {"model": Refusal, "description": "too many requests, jobs or streams; see Retry-After"},
}
"""Refusals by HTTP status."""


def refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """How the description of the interface tells of the refusals of one address."""
    return {status: REFUSALS[status] for status in statuses}


ASKED: Final = refusals(401, 403, 429, 503)
"""Refusals of every address that asks who asks."""
UPLOADED: Final = refusals(413, 422, 429, 507)
"""Refusals of what takes an upload."""


def service(request: Request) -> Service:
    """The service that the application belongs to."""
    found = request.app.state.service
    if not isinstance(found, Service):
        raise TypeError("the application has no service")
    return found


def count_unknown(request: Request, here: Service, does: str) -> None:
    """Count a request of an address of which nobody is known; raises :class:`RefusedError`, 429."""
    address = request.client.host if request.client else ""
    here.failures.take(address, f"address {address} {does}")


def asker(
    request: Request,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)] = None,
    cookie: Annotated[str | None, Security(_COOKIE)] = None,
) -> Who:
    """Who asks, whatever his role; raises :class:`RefusedError`, 401, 403 beyond the scope of his token, or
    429 for who asks too often."""
    here = service(request)
    try:
        who = _who(request, bearer, cookie, here)
    except RefusedError:
        count_unknown(request, here, "sends without a good token")
        raise
    if who.token != LOCAL:
        here.rates.take(who.token, "this token sends")
    who.ask(request.method, request.scope["route"].path)
    return who


def _who(
    request: Request, bearer: HTTPAuthorizationCredentials | None, cookie: str | None, here: Service
) -> Who:
    if bearer is not None:
        return here.auth.who(bearer.credentials)
    if "authorization" in request.headers:
        raise unauthorised("the Authorization header is no bearer token; send 'Bearer TOKEN'")
    if cookie is not None:
        return here.auth.session(cookie)
    if here.options.tokens_required:
        raise unauthorised("a token is needed; send the header 'Authorization: Bearer TOKEN'")
    return ANYBODY


Asker = Annotated[Who, Depends(asker)]
Here = Annotated[Service, Depends(service)]


def caller(request: Request, who: Asker) -> str:
    """The owner of what is made, if he may do what the method does: look, or make and change something.
    Raises :class:`RefusedError`, 401 or 403."""
    who.need("view" if request.method in SAFE_METHODS else "plan")
    return who.token


Caller = Annotated[str, Depends(caller)]


def own_job(job: str, _: Caller, who: Asker, here: Here) -> JobOut:
    """The job, if it is the caller's or his team's; raises :class:`RefusedError`, 404 for another one's too,
    so that nobody learns which there are."""
    return job_of(job, who, here)


def job_of(job: str, who: Who, here: Service) -> JobOut:
    """A job, if ``who`` sees it; raises :class:`RefusedError`, 404."""
    if not JOB_ID.fullmatch(job):
        raise unknown_job(job)
    belongs_to, found = here.jobs.get(job)
    if not here.auth.sees(who, belongs_to) or not _is_in_scope(who, found):
        raise unknown_job(job)
    about(job)
    return found


def _is_in_scope(who: Who, job: JobOut) -> bool:
    if who.scope != "released":
        return True
    return job.released and (who.tag is None or finding.is_tagged(job.tags, who.tag))


def _is_file_in_scope(who: Who, name: str) -> bool:
    """Whether a file of a job that is in the token's scope is, too: of what is released all but the problem
    and what is made for other programs."""
    released = releases.is_program(name) or name in (RELEASE, THUMBNAIL, *TO_LOOK_AT)
    return who.scope != "released" or released


OwnJob = Annotated[JobOut, Depends(own_job)]


def job_to_read(
    request: Request,
    job: str,
    name: str,
    here: Here,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)] = None,
    cookie: Annotated[str | None, Security(_COOKIE)] = None,
    expires: Annotated[int | None, Query(ge=0, lt=2**53, description="end of a link")] = None,
    look: Annotated[str | None, Query(max_length=32, description="id of a link to look")] = None,
    signature: Annotated[str | None, Query(max_length=200, description="signature of a link")] = None,
) -> JobOut:
    """The job, for who reads its file ``name``: the caller if he sees it, anybody with a link to that file,
    or with one to look, if it opens that.

    A link is judged as one, whoever sends it. Raises :class:`RefusedError`, 401, 403 or 404.
    """
    if signature is None:
        who = asker(request, bearer, cookie)
        request.state.reader = who.token
        found = job_of(job, who, here)
        if not _is_file_in_scope(who, name):
            raise unknown_file(job, name)
        return found
    if look is not None:
        found, _ = looked_at(request, job, look, signature, here)
        if name not in TO_LOOK_AT:
            raise no_look()
        return found
    owner = here.jobs.owner(job) if JOB_ID.fullmatch(job) else None
    mates = () if owner is None else here.auth.mates(owner)
    maker = here.links.check(job, name, expires, signature, mates) or owner
    if owner is None or maker is None:
        raise unknown_job(job)
    if not _holds(here, maker):
        raise bad_link("the token that made it, or its job, is no longer in force; ask for a new one")
    request.state.reader = maker
    return here.jobs.get(job)[1]


def looked_at(
    request: Request, job: str, look: str, signature: str, here: Service
) -> tuple[JobOut, dt.datetime]:
    """The job that a link to look opens, whoever sends it, and the link's end. Raises
    :class:`RefusedError`, 404 for whatever is wrong with it, or 429."""
    try:
        maker, expires = here.links.looker(job, look, signature)
        owner = here.jobs.owner(job)
        if owner is None or not _holds(here, maker) or maker not in (owner, *here.auth.mates(owner)):
            raise no_look()
    except RefusedError:
        count_unknown(request, here, "opens links that do not hold")
        raise
    here.rates.take(f"link {look}", "this link is opened")
    request.state.reader = maker
    return here.jobs.get(job)[1], expires


def _holds(here: Service, maker: str) -> bool:
    """Whether links of that token are good still."""
    return (maker == LOCAL and not here.options.tokens_required) or here.auth.in_force(maker)


def idempotency_key(
    request: Request,
    given: Annotated[
        str | None,
        Header(
            alias=idempotency.HEADER,
            description="a value of your own, a UUID say: the same request sent again with it makes nothing "
            "new and has the same answer",
            json_schema_extra={"minLength": 1, "maxLength": idempotency.LONGEST, "pattern": "^[!-~]+$"},
        ),
    ] = None,
) -> str | None:
    """The idempotency key of a request; raises :class:`RefusedError`, 422."""
    del given  # the last of several
    return idempotency.checked(request.headers.getlist(idempotency.HEADER))


Key = Annotated[str | None, Depends(idempotency_key)]


about_router: Final = APIRouter(tags=["about"])


@about_router.get(
    "/v1/health",
    responses={**refusals(403), 503: {"model": Health}},
    response_model_exclude_none=True,
    summary="Whether the process works",
)
def health(here: Here, response: Response) -> Health:
    """Needs no token. 503 where only a new start helps: a database that is away, or a full disk, is told by
    /v1/ready."""
    try:
        counts = here.jobs.counts()
    except SQLAlchemyError:
        counts = None
    healthy = here.runner.healthy
    response.status_code = 200 if healthy else 503
    return Health(
        status="ok" if healthy and counts is not None else "degraded",
        version=__version__,
        api=API,
        api_oldest=OLDEST_API,
        workers=here.options.workers,
        queued=None if counts is None else counts.get("queued", 0),
        running=None if counts is None else counts.get("running", 0),
    )


@about_router.get(
    "/v1/ready",
    responses={**refusals(403), 503: {"model": Ready}},
    summary="Whether jobs are taken and planned",
)
def ready(here: Here, response: Response) -> Ready:
    """Needs no token. 503 with Retry-After while the database is away, the disk full, or nothing is planned:
    send requests elsewhere, or later."""
    issues = here.unready()
    if issues:
        response.status_code = 503
        response.headers["Retry-After"] = "5"
    return Ready(ready=not issues, issues=issues)


@about_router.get(
    "/metrics", responses=ASKED, response_class=PlainTextResponse, summary="Figures for Prometheus"
)
def figures(_: Caller, here: Here) -> PlainTextResponse:
    """In Prometheus's text format: of this instance since its start, but jobs and files of the store."""
    told = metrics.text(
        here.jobs.counts(),
        here.jobs.oldest_waiting(),
        float(here.files.used),
        here.options.workers,
        here.runner.healthy,
    )
    return PlainTextResponse(told, media_type=metrics.CONTENT_TYPE)


@about_router.get("/v1/processes", responses=ASKED, summary="The processes")
def known_processes(_: Caller) -> dict[str, str]:
    """What each one does, by the word that problem files use."""
    from planner.processes import registry

    return {name: " ".join((m.__doc__ or "").split()) for name, m in registry.schemas().items()}


@about_router.get(
    "/v1/processes/{name}/schema",
    responses=ASKED | refusals(404),
    summary="JSON schema of a process's operation",
)
def process_schema(name: str, _: Caller) -> dict[str, Any]:
    """The fields of an operation, with ranges, defaults and help; units end their names."""
    from planner.service import catalogue

    return catalogue.process(name)


@about_router.get("/v1/schema", responses=ASKED, summary="JSON schema of problem files")
def problem_schema(_: Caller) -> dict[str, Any]:
    """The whole file with the operations of all processes."""
    from planner.service import catalogue

    return catalogue.problem_file()


@about_router.get("/v1/catalogue/{kind}", responses=ASKED | refusals(422), summary="What is built in")
def catalogue_of(kind: Kind, _: Caller) -> Catalogue:
    """Robots and materials with the sources of their figures, tools with their schemas, cells as problem
    files may have them inside."""
    from planner.service import catalogue

    return Catalogue(entries=catalogue.entries(kind))


@about_router.get("/v1/issues", responses=ASKED, summary="Issue codes")
def issue_codes(_: Caller) -> dict[str, str]:
    """Every code with its meaning."""
    return {code: row.meaning for code, row in all_codes().items()}


@about_router.get("/v1/storage", responses=ASKED, summary="Room for files")
def storage(owner: Caller, here: Here) -> Storage:
    """What your files take, and may take."""
    return Storage(used_mb=here.storage.used(owner) / 1e6, limit_mb=here.limits.token_disk_mb)


@about_router.get(
    "/v1/session", responses=ASKED, response_model_exclude_none=True, summary="Who asks, and what he may do"
)
def session(who: Asker, here: Here) -> SessionOut:
    """Name, role, team and scope of the token, or of the cookie's."""
    expires = None if who.expires is None else dt.datetime.fromtimestamp(who.expires, dt.UTC)
    asked = here.options.tokens_required
    return SessionOut(
        name=who.name,
        role=who.role,
        team=who.team,
        tokens=asked,
        expires=expires,
        scope=who.scope,
        tag=who.tag,
    )


@about_router.post("/v1/session", responses=ASKED, status_code=204, summary="Log a browser in")
def log_in(request: Request, who: Asker, here: Here) -> Response:
    """Sets a cookie in exchange for the token of the Authorization header; pages cannot read it."""
    response = Response(status_code=204)
    if who.token != LOCAL:
        remember(request, response, here, who)
    return response


def remember(request: Request, response: Response, here: Service, who: Who) -> None:
    """Give a browser the cookie of a new session."""
    cookie, good_s = here.auth.open_session(who)
    secure = request.url.scheme == "https"
    response.set_cookie(COOKIE, cookie, max_age=int(good_s), httponly=True, samesite="strict", secure=secure)


@about_router.delete(
    "/v1/session", responses=refusals(403, 503), status_code=204, summary="Log a browser out"
)
def log_out(here: Here, tandem_session: Annotated[str | None, Cookie()] = None) -> Response:
    """Ends the session of the cookie."""
    if tandem_session is not None:
        here.auth.close_session(tandem_session)
    response = Response(status_code=204)
    response.delete_cookie(COOKIE)
    return response


job_router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=ASKED)
Tag = Annotated[
    str,
    Field(min_length=1, max_length=LONGEST_TAG),
    AfterValidator(functools.partial(line, most=LONGEST_TAG)),
]
"""A word that jobs are found by."""


PLAN: Final = ("plan.json", "plan.npz")
"""Files of a result that are its plan."""
UPLOADS: Final = {"requestBody": documented({"$ref": "#/components/schemas/ProblemFile"})}
"""How the description of the interface tells of a body that is a problem."""
TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".obj": "model/obj",
    ".npz": "application/octet-stream",
    ".yaml": "application/yaml",
    **{
        ending: "text/plain; charset=utf-8"
        for one in plugins.usable(Language).values()
        for ending in one.file_endings
    },
}
"""Content types of the files of a result."""
PARTS: Final[dict[int | str, dict[str, Any]]] = {
    206: {"description": "the part that `Range` asks for"},
    304: {"description": "who asks has it: `If-None-Match`"},
    416: {"description": "a `Range` beyond the end", "content": {"text/plain": {}}},
}
"""Answers of files beside the whole one."""
KNOWN: Final[dict[int | str, dict[str, Any]]] = {304: PARTS[304]}
"""The answer of lists beside the whole one."""
SANDBOX: Final = "sandbox allow-scripts allow-downloads allow-popups; frame-ancestors 'self'"
"""What is in a report came from a user: it runs apart from this site, without its cookies."""
PAGE_SIZE: Final = 50
"""Jobs of one page of the list, where the request does not say."""
WHEN: Final = r"^[0-9]{1,12}\.[0-9]{1,9}-[0-9a-f]{32}$"
"""What a page ends with that is sorted by when jobs were made."""
NEXT: Final = "`next` of the page before"
"""What a cursor is."""
CURSOR = Annotated[str | None, Query(pattern=WHEN, description=NEXT)]
LIST_CURSOR = Annotated[
    str | None, Query(pattern=f"{WHEN}|^[A-Za-z0-9_-]{{0,1100}}~[0-9a-f]{{32}}$", description=NEXT)
]
"""The same of lists that are sorted by titles, too."""
Search = Annotated[Line, Query(description="all of these words in name, title, tags or notes")]
Tags = Annotated[list[Tag] | None, Query(max_length=10, description="with all of these tags")]
EVENT_SCHEMA: Final = {
    "type": "object",
    "description": "one event of the stream",
    "properties": {
        "id": {"type": "string"},
        "event": {"enum": ["state", "progress", "issues", "end"]},
        "data": {"type": "string", "description": "JSON"},
    },
}
"""How the description of the interface tells of an event."""


@job_router.post(
    "/jobs",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOADED,
    openapi_extra=UPLOADS,
    summary="Plan a problem",
)
async def create(
    request: Request,
    owner: Caller,
    here: Here,
    key: Key,
    timeout_s: Annotated[
        float | None,
        Query(gt=0, le=1e6, description="stop planning after so long; the service has a limit too"),
    ] = None,
    memory_mb: Annotated[
        float | None, Query(gt=0, le=1e6, description="stop planning at so much memory; likewise")
    ] = None,
) -> JobOut:
    """Upload a problem with its files. An identical problem that was planned before has its answer at
    once."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    once = idempotency.once(owner, key, "jobs", upload.content, timeout_s, memory_mb)
    (made,) = await here.made_once(
        request, owner, once, lambda reading: here.create(owner, upload, timeout_s, memory_mb, reading, once)
    )
    return made


@job_router.post(
    "/check",
    response_model_exclude_none=True,
    responses=UPLOADED,
    openapi_extra=UPLOADS,
    summary="Validate without planning",
)
async def check(
    request: Request,
    owner: Caller,
    here: Here,
    reach: Annotated[bool, Query(description="make the targets and test their reach too")] = False,
    targets: Annotated[
        int | None,
        Query(
            ge=1,
            le=1000,
            description="a first look: reach and clearance of about so many targets, one by one",
        ),
    ] = None,
) -> CheckOut:
    """Read a problem and say what is in its way; a file that cannot be read is 422. A first look, at some
    ``targets`` evenly spread, is quick and says nothing of what lies between them; ``looked_at`` tells the
    share. Whether there is a way through all of them, ``reach`` alone tells. Who hangs up ends the check."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    far = reach or targets is not None
    some = None if reach else targets
    read = await here.in_turn(
        request, owner, lambda reading: here.examine(upload, far, reading=reading, targets=some)
    )
    return CheckOut(
        ok=not has_errors(read.issues),
        name=read.name,
        digest=read.digest,
        processes=list(read.processes),
        summary=dict(read.summary),
        issues=list(read.issues),
        looked_at=None if read.looked_at is None else LookedAt(**read.looked_at),
    )


@job_router.post(
    "/cell",
    response_model=CellOut,
    responses=UPLOADED | refusals(404),
    openapi_extra=UPLOADS,
    summary="Draw a cell without planning",
)
async def cell(
    request: Request,
    owner: Caller,
    who: Asker,
    here: Here,
    operation: Annotated[int, Query(ge=0, le=999, description="as which operation finds it, from 0")] = 0,
    targets: Annotated[
        int | None, Query(ge=2, le=200, description="look at about so many of its targets")
    ] = None,
    freedom: Annotated[
        str | None,
        Query(max_length=64, description="map of this one of `freedoms` over these targets, if it has it"),
    ] = None,
    job: Annotated[
        str | None,
        Query(pattern="^[0-9a-f]{32}$", description="with the path of this job's plan through the map"),
    ] = None,
    reach: Annotated[
        bool, Query(description="with what each arm can do over the block, if that stands")
    ] = False,
) -> Response:
    """Bodies with their triangles, and where they are with all arms at home. With ``targets``, where some of
    them are, evenly spread, the posture that the arms have there, or why there is none. Who hangs up ends
    it."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    asked: dict[str, Any] = {"operation": operation, "most": targets, "freedom": freedom, "reach": reach}
    if job is not None:
        known = await anyio.to_thread.run_sync(lambda: here.jobs.files(job_of(job, who, here).id))
        asked["plan"] = [[name, str(here.files.path(known[name].sha))] for name in PLAN if name in known]

    def drawn(reading: Reading) -> Response:
        """Packed in the owner's turn too: it is large, and few turns are taken at once."""
        read = here.examine(upload, cell=asked, reading=reading)
        if read.cell is None:
            wrong = [issue for issue in read.issues if has_errors([issue])]
            large = all(issue.code == "service.too_large" for issue in wrong)
            raise RefusedError(413 if large else 422, wrong)
        seen = {"name": read.name, "digest": read.digest, "issues": read.issues, **read.cell}
        return packed(request, CellOut.model_validate(seen))

    return await here.in_turn(request, owner, drawn)


@job_router.get("/jobs", response_model=JobList, responses=KNOWN | refusals(422), summary="List your jobs")
def page(
    request: Request,
    _: Caller,
    who: Asker,
    here: Here,
    limit: Annotated[int, Query(ge=1, le=200)] = PAGE_SIZE,
    cursor: LIST_CURSOR = None,
    state: Annotated[list[State] | None, Query(description="these states alone")] = None,
    search: Search = "",
    tag: Tags = None,
    sort: Annotated[Sort, Query(description="when made, title or name, whose turn")] = "newest",
) -> Response:
    """Yours and those of your team, a page at a time; 304 for who asks again with
    ``If-None-Match`` and has it as it is."""
    tags = [*(tag or ()), *([] if who.tag is None else [who.tag])]
    wanted = Wanted(state or (), search, tags, sort, cursor, released=who.scope == "released")
    found, following = here.jobs.page(here.auth.owners(who), wanted, limit)
    return tagged(request, JobList(jobs=found, next=following))


@job_router.get(
    "/jobs/{job}", responses=refusals(404), response_model_exclude_none=True, summary="State of a job"
)
def get(found: OwnJob) -> JobOut:
    """State, stage, issues, figures."""
    return found


@job_router.get(
    "/jobs/{job}/events",
    summary="Events of a job as they happen",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {"schema": EVENT_SCHEMA}}}, **refusals(404, 422, 429)},
)
def events(
    found: OwnJob,
    owner: Caller,
    here: Here,
    last_event_id: Annotated[str | None, Header()] = None,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="events up to this number are known")] = 0,
) -> StreamingResponse:
    """Server-sent events from the first on, or after ``Last-Event-ID``: ``state`` {state}, ``progress``
    {stage, fraction}, ``issues`` {issues; with ``all`` they are the whole list}, ``end`` when no more will
    come."""
    if last_event_id is not None and last_event_id.isdecimal() and len(last_event_id) < 10:
        after = int(last_event_id)
    return Stream(here.hub, owner, found.id, after)


@job_router.post(
    "/jobs/{job}/cancel", responses=refusals(404), response_model_exclude_none=True, summary="Cancel a job"
)
def cancel(found: OwnJob, owner: Caller, here: Here) -> JobOut:
    """A job that waits is cancelled at once; one that runs has its worker stopped within a second or two.
    One that has ended stays as it is."""
    return here.jobs.cancel(found.id, owner)


@job_router.post(
    "/jobs/{job}/retry",
    responses=refusals(404, 409, 429),
    response_model_exclude_none=True,
    summary="Plan a job again",
)
def retry(found: OwnJob, owner: Caller, here: Here) -> JobOut:
    """A job that crashed, met a limit or was cancelled waits again, as if it had come now. 409 for one that
    waits or runs, and for one whose end the problem alone decides: it would end so again."""
    return here.jobs.retry(found.id, owner)


@job_router.delete("/jobs/{job}", responses=refusals(404), status_code=204, summary="Delete a job")
def delete(found: OwnJob, owner: Caller, here: Here) -> Response:
    """Delete a job with its files; one that runs is cancelled."""
    here.jobs.cancel(found.id, owner, also_delete=True)
    return Response(status_code=204)


@job_router.get("/jobs/{job}/files", responses=refusals(404), summary="Files of a job")
def files(found: OwnJob, who: Asker, here: Here) -> FileList:
    """Its problem (``problem/...``), its results when it has ended, and ``release.json`` where its programs
    were released."""
    known = here.jobs.files(found.id)
    if found.release is not None:
        said = here.releases.told(found, known).content
        known[RELEASE] = Blob(hashlib.sha256(said).hexdigest(), len(said))
    seen = [file_out(name, blob) for name, blob in sorted(known.items()) if _is_file_in_scope(who, name)]
    return FileList(files=seen)


@job_router.get(
    "/jobs/{job}/files/{name:path}",
    summary="A file of a job",
    response_class=FileResponse,
    responses={
        200: {"content": {"application/octet-stream": {"schema": {"type": "string"}}}},
        **PARTS,
        **refusals(404, 422),
    },
)
def file(
    found: Annotated[JobOut, Depends(job_to_read)],
    name: str,
    request: Request,
    here: Here,
    download: Annotated[bool, Query(description="for saving, not for showing")] = False,
) -> Response:
    """The file of that name in the list of files. With ``expires`` and ``signature`` of a link it asks for
    no token."""
    headers = {"Cache-Control": "private, max-age=3600"}
    if releases.is_program(name) or name == RELEASE:  # what it says of its release is said anew
        headers = {"Cache-Control": "private, no-cache", releases.HEADER: releases.word(found.release)}
    if "signature" in request.query_params:  # nothing of a link is kept or told to others
        headers |= {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer"}
    if name.endswith(".html"):
        headers["Content-Security-Policy"] = SANDBOX
    saved_as = PurePosixPath(name).name if download else None
    blob = known_file(here, found, name)
    if blob is None:
        content = here.releases.told(found, here.jobs.files(found.id)).content
        headers["ETag"] = f'"{hashlib.sha256(content).hexdigest()}"'
        if is_known(request, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        return MadeFile(content, here.scratch, content_type(name), saved_as, headers)
    if releases.is_program(name):
        here.releases.read(found.id, {name: blob})
    kind = content_type(name)
    answer = stored_file(request, here.files.path(blob.sha), blob.sha, kind, headers, saved_as)
    if releases.is_program(name) and answer.status_code != 304:
        by_link = "signature" in request.query_params
        downloaded(request, here, found, name, releases.word(found.release), by_link)
    return answer


@job_router.post("/jobs/{job}/links", responses=refusals(404, 422), summary="Link to a file of a job")
def link(
    found: OwnJob,
    who: Asker,
    here: Here,
    name: Annotated[str, Query(max_length=255, description="a name of the list of files")],
    seconds: Annotated[int, Query(ge=1, le=LONGEST_LINK_S, description="how long it is good for")] = LINK_S,
) -> LinkOut:
    """An address that reads this file without a token, for a browser, until it ends or the token that asks
    for it is revoked or over."""
    known_file(here, found, name)
    expires = int(time.time()) + seconds
    until = dt.datetime.fromtimestamp(expires, dt.UTC)
    said = {"name": found.name, "file": name, "until": until.isoformat()}
    with here.database.write() as db:
        audit.note(here.database, db, who.token, "linked", found.id, said)
    by = None if here.jobs.owner(found.id) == who.token else who.token
    asked = urlencode({"expires": expires, "signature": here.links.sign(found.id, name, expires, by)})
    path = f"/v1/jobs/{found.id}/files/{quote(name)}?{asked}"
    return LinkOut(path=path, expires=until)


@job_router.get(
    "/jobs/{job}/programs.zip",
    summary="The programs of a job",
    response_class=Response,
    responses={
        200: {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}},
        **PARTS,
        **refusals(404),
    },
)
def programs(found: OwnJob, who: Asker, here: Here, request: Request) -> Response:
    """All programs in one archive, and ``release.json``, which says whether they are released, as the header
    ``Tandem-Release`` and the file's name do. They are there if the proof holds."""
    known = {n: blob for n, blob in here.jobs.files(found.id).items() if n.startswith("programs/")}
    if not known:
        waiting = found.state in OPEN
        what = f"job {found.id} has no programs: it is {found.state}; "
        what += "ask again when it has ended" if waiting else f"its issues say why: GET /v1/jobs/{found.id}"
        raise RefusedError(404, Issue("service.unknown_file", what))
    told = here.releases.told(found, known)
    parts = json.dumps([sorted(known.items()), hashlib.sha256(told.content).hexdigest()])
    tag = f'"{hashlib.sha256(parts.encode()).hexdigest()}"'
    headers = {"ETag": tag, "Cache-Control": "private, no-cache", releases.HEADER: told.word}
    if is_known(request, tag):
        return Response(status_code=304, headers=headers)
    contents = {n.removeprefix("programs/"): c for n, c in here.releases.read(found.id, known).items()}
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted({**contents, RELEASE: told.content}.items()):
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    content = packed.getvalue()
    request.state.reader = who.token
    downloaded(request, here, found, "programs.zip", told.word)
    return MadeFile(content, here.scratch, "application/zip", f"{found.name}-{told.word}.zip", headers)


def downloaded(
    request: Request, here: Service, job: JobOut, file: str, word: str, by_link: bool = False
) -> None:
    """Write down that programs go out now."""
    if not request.scope.get(HEAD):
        said = {"name": job.name, "file": file, "release": word} | ({"link": True} if by_link else {})
        audit.note_download(here.database, request.state.reader, job.id, said)


def known_file(here: Service, job: JobOut, name: str) -> Blob | None:
    """The file of a job, None for the one that says who released it; raises :class:`RefusedError`, 404."""
    blob = here.jobs.files(job.id).get(name)
    if blob is None and not (name == RELEASE and job.release is not None):
        raise unknown_file(job.id, name)
    return blob


def unknown_file(job: str, name: str) -> RefusedError:
    """404."""
    what = f"job {job} has no file {name[:200]!r}; list its files"
    return RefusedError(404, Issue("service.unknown_file", what, field="name"))


def file_out(name: str, blob: Blob) -> FileOut:
    """A file as the list has it."""
    return FileOut(name=name, size=blob.size, sha256=blob.sha, content_type=content_type(name))


def content_type(name: str) -> str:
    """By the name; what people uploaded is never shown as anything."""
    if name.startswith("problem/files/"):
        return "application/octet-stream"
    return TYPES.get(PurePosixPath(name).suffix.lower(), "application/octet-stream")
