"""What every route needs: the service, who asks, and the job that is asked for."""

from __future__ import annotations

import re
from typing import Annotated, Final

from fastapi import Depends, Request, Security
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer

from planner.issues import Issue
from planner.service.auth import LOCAL, unauthorised
from planner.service.models import JobOut, Refusal
from planner.service.refusals import RefusedError, unknown_job
from planner.service.service import Service

COOKIE: Final = "tandem_session"
_BEARER: Final = HTTPBearer(auto_error=False, description="a token that `tandem token add` made")
_COOKIE: Final = APIKeyCookie(name=COOKIE, auto_error=False, description="what POST /v1/session set")
_JOB: Final = re.compile(r"[0-9a-f]{32}")

REFUSALS: Final = {
    401: {"model": Refusal, "description": "no token, or one that is unknown or revoked"},
    403: {"model": Refusal, "description": "another token's job, or a request of another site"},
    404: {"model": Refusal, "description": "there is no such thing"},
    413: {"model": Refusal, "description": "larger than this service takes"},
    422: {"model": Refusal, "description": "all that is wrong, by code and field"},
    503: {"model": Refusal, "description": "the service is stopping; see Retry-After"},
    507: {"model": Refusal, "description": "no room for more files; see /v1/storage"},
    429: {"model": Refusal, "description": "too many jobs or streams; see Retry-After"},
}


def service(request: Request) -> Service:
    """The service that the application belongs to."""
    found = request.app.state.service
    if not isinstance(found, Service):
        raise TypeError("the application has no service")
    return found


def caller(
    request: Request,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)] = None,
    cookie: Annotated[str | None, Security(_COOKIE)] = None,
) -> str:
    """The owner of what is asked; raises :class:`RefusedError`, 401."""
    here = service(request)
    if bearer is not None:
        return here.auth.owner(bearer.credentials)
    if "authorization" in request.headers:
        raise unauthorised("the Authorization header is no bearer token; send 'Bearer TOKEN'")
    if cookie is not None:
        return here.auth.session(cookie)
    if here.options.tokens_required:
        raise unauthorised("a token is needed; send the header 'Authorization: Bearer TOKEN'")
    return LOCAL


Caller = Annotated[str, Depends(caller)]
Here = Annotated[Service, Depends(service)]


def own_job(job: str, owner: Caller, here: Here) -> JobOut:
    """The job, if it is the caller's; raises :class:`RefusedError`, 403 or 404."""
    if not _JOB.fullmatch(job):
        raise unknown_job(job)
    belongs_to, found = here.jobs.get(job)
    if belongs_to != owner:
        raise RefusedError(403, Issue("service.foreign", f"job {job}: it belongs to another token"))
    return found


OwnJob = Annotated[JobOut, Depends(own_job)]
