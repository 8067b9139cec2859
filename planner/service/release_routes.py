"""API routes of releases and of the audit log.

A release names the person who is responsible for the programs of a job.
"""

from typing import Annotated, Final

import anyio.to_thread
from fastapi import APIRouter, Depends, Query, Request
from pydantic import ConfigDict, Field

from planner.service import audit
from planner.service.element_routes import visible_element_id
from planner.service.models import (
    AuditAct,
    AuditList,
    ElementReleases,
    JobOut,
    ReleaseList,
    ReleaseOut,
    Sent,
    Shown,
)
from planner.service.routes import (
    AUTH_REFUSALS,
    JOB_ID,
    PAGE_SIZE,
    CurrentPrincipal,
    CurrentService,
    OwnJob,
    refusals,
    visible_job,
)
from planner.service.security import Principal
from planner.service.user_texts import Line, Lines, body_description, read_body

router: Final = APIRouter(prefix="/v1", tags=["releases"], responses=AUTH_REFUSALS)


MAX_PANELS: Final = 5000
"""Maximum number of panels in one release."""


class Releasing(Sent):
    """A release: a note, and the name of the person if the service requires no tokens."""

    model_config = ConfigDict(extra="forbid")
    note: Lines = ""
    name: Line | None = None


class ReleasingPanels(Releasing):
    """Panels to release, as the person saw them."""

    panels: dict[str, Shown] = Field(min_length=1, max_length=MAX_PANELS)


class Withdrawing(Sent):
    """Reason of a withdrawal. ``name`` is the person if the service requires no tokens."""

    model_config = ConfigDict(extra="forbid")
    reason: Annotated[Lines, Field(min_length=1)]
    name: Line | None = None


def releaser(principal: CurrentPrincipal) -> Principal:
    """Return the caller if it may release (dependency).

    Raises:
        RefusedError: 401 or 403.
    """
    principal.check_role("release")
    return principal


Releaser = Annotated[Principal, Depends(releaser)]


def job_to_release(job: str, principal: Releaser, service: CurrentService) -> JobOut:
    """Return the job if the caller may release it (dependency).

    Raises:
        RefusedError: 401, 403 or 404.
    """
    return visible_job(job, principal, service)


ToRelease = Annotated[JobOut, Depends(job_to_release)]


@router.post(
    "/jobs/{job}/release",
    status_code=201,
    responses=refusals(404, 409, 413, 422),
    openapi_extra=body_description(Releasing),
    response_model_exclude_none=True,
    summary="Release the programs of a job",
)
async def release(
    request: Request, job_out: ToRelease, principal: Releaser, service: CurrentService
) -> ReleaseOut:
    """Releases in the name of the token: ``{"note": "cut of Tuesday"}``.

    Recorded are this name, the time, the digest of the problem and the SHA-256 of proof and programs. 409
    if the job is not verified, or already released.
    """
    body = await read_body(request, Releasing)
    return await anyio.to_thread.run_sync(
        service.releases.release, job_out.id, principal, body.name, body.note
    )


@router.post(
    "/jobs/{job}/withdraw",
    responses=refusals(404, 409, 413, 422),
    openapi_extra=body_description(Withdrawing),
    response_model_exclude_none=True,
    summary="Withdraw a release",
)
async def withdraw(
    request: Request, job_out: ToRelease, principal: Releaser, service: CurrentService
) -> ReleaseOut:
    """Requires a ``reason``. The release stays in the audit log. 409 if the job is not released."""
    body = await read_body(request, Withdrawing)
    return await anyio.to_thread.run_sync(
        service.releases.withdraw, job_out.id, principal, body.name, body.reason
    )


@router.post(
    "/elements/{element}/release",
    status_code=201,
    responses=refusals(404, 409, 413, 422),
    openapi_extra=body_description(ReleasingPanels),
    response_model_exclude_none=True,
    summary="Release the programs of panels of an element",
)
async def release_panels(
    request: Request, element: str, principal: Releaser, service: CurrentService
) -> ElementReleases:
    """Releases panels in one act, each by the job and digest that the person saw.

    Example: ``{"panels": {"A01": {"job": "24d8...", "digest": "9f2c..."}}, "note": "north side"}``. Panels
    that are not proven, have changed, were planned again or are already released are listed in ``refused``.
    409 if these are all of them.
    """
    element_id = await anyio.to_thread.run_sync(visible_element_id, element, principal, service)
    body = await read_body(request, ReleasingPanels)
    return await anyio.to_thread.run_sync(
        service.elements.release, element_id, body.panels, principal, body.name, body.note
    )


@router.get("/audit", responses=refusals(422), response_model_exclude_none=True, summary="Audit log")
def log(
    principal: Releaser,
    service: CurrentService,
    limit: Annotated[int, Query(ge=1, le=200)] = PAGE_SIZE,
    cursor: Annotated[int | None, Query(ge=1, lt=2**31, description="`next` of the previous page")] = None,
    job: Annotated[
        str | None, Query(pattern=JOB_ID.pattern, max_length=32, description="only this job")
    ] = None,
    act: Annotated[list[AuditAct] | None, Query(description="only these acts")] = None,
) -> AuditList:
    """Audit log of the token's team, newest first, including deleted jobs. Requires the role release."""
    entries, next_cursor = audit.page(service.database, principal, job, tuple(act or ()), cursor, limit)
    return AuditList(acts=entries, next=next_cursor)


@router.get(
    "/jobs/{job}/releases",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="The releases of a job",
)
def releases(job_out: OwnJob, service: CurrentService) -> ReleaseList:
    """Newest first. Only the newest can be in force."""
    return ReleaseList(releases=service.releases.all(job_out.id))
