"""The API's routes of releases, who answers for the programs of a job, and of the log of who did what."""

from typing import Annotated, Final

import anyio.to_thread
from fastapi import APIRouter, Depends, Query, Request
from pydantic import ConfigDict, Field

from planner.service import audit
from planner.service.element_routes import element_of
from planner.service.models import (
    Act,
    AuditList,
    ElementReleases,
    JobOut,
    ReleaseList,
    ReleaseOut,
    Sent,
    Shown,
)
from planner.service.routes import ASKED, JOB_ID, PAGE_SIZE, Asker, Here, OwnJob, job_of, refusals
from planner.service.security import Who
from planner.service.texts import Line, Lines, described, read_body

router: Final = APIRouter(prefix="/v1", tags=["releases"], responses=ASKED)


MOST_PANELS: Final = 5000
"""Panels that one act releases."""


class Releasing(Sent):
    """A release to be: a note, and who releases where the service asks for no tokens."""

    model_config = ConfigDict(extra="forbid")
    note: Lines = ""
    name: Line | None = None


class ReleasingPanels(Releasing):
    """Panels to be released, as they were shown."""

    panels: dict[str, Shown] = Field(min_length=1, max_length=MOST_PANELS)


class Withdrawing(Sent):
    """Why a release is taken back; ``name`` as of a release."""

    model_config = ConfigDict(extra="forbid")
    reason: Annotated[Lines, Field(min_length=1)]
    name: Line | None = None


def releaser(who: Asker) -> Who:
    """Who asks, if he may release; raises :class:`RefusedError`, 401 or 403."""
    who.need("release")
    return who


Releaser = Annotated[Who, Depends(releaser)]


def job_to_release(job: str, who: Releaser, here: Here) -> JobOut:
    """The job, for who may release it; raises :class:`RefusedError`, 401, 403 or 404."""
    return job_of(job, who, here)


ToRelease = Annotated[JobOut, Depends(job_to_release)]


@router.post(
    "/jobs/{job}/release",
    status_code=201,
    responses=refusals(404, 409, 413, 422),
    openapi_extra=described(Releasing),
    response_model_exclude_none=True,
    summary="Release the programs of a job",
)
async def release(request: Request, found: ToRelease, who: Releaser, here: Here) -> ReleaseOut:
    """By who asks, whose token has a name: ``{"note": "cut of Tuesday"}``. Written down are he, the moment,
    the digest of the problem and the SHA-256 of proof and programs. 409 for what is not verified, or is
    released already."""
    given = await read_body(request, Releasing)
    return await anyio.to_thread.run_sync(here.releases.release, found.id, who, given.name, given.note)


@router.post(
    "/jobs/{job}/withdraw",
    responses=refusals(404, 409, 413, 422),
    openapi_extra=described(Withdrawing),
    response_model_exclude_none=True,
    summary="Withdraw a release",
)
async def withdraw(request: Request, found: ToRelease, who: Releaser, here: Here) -> ReleaseOut:
    """With a ``reason``; the release stays written down. 409 where the job is not released."""
    given = await read_body(request, Withdrawing)
    return await anyio.to_thread.run_sync(here.releases.withdraw, found.id, who, given.name, given.reason)


@router.post(
    "/elements/{element}/release",
    status_code=201,
    responses=refusals(404, 409, 413, 422),
    openapi_extra=described(ReleasingPanels),
    response_model_exclude_none=True,
    summary="Release the programs of panels of an element",
)
async def release_panels(request: Request, element: str, who: Releaser, here: Here) -> ElementReleases:
    """By one act, each panel by the job and digest that it had when it was looked at:
    ``{"panels": {"A01": {"job": "24d8...", "digest": "9f2c..."}}, "note": "north side"}``. Panels that are
    not proven, were changed or planned again meanwhile, or are released already, are named in ``refused``;
    409 where that is all of them."""
    found = await anyio.to_thread.run_sync(element_of, element, who, here)
    given = await read_body(request, ReleasingPanels)
    return await anyio.to_thread.run_sync(
        here.elements.release, found, given.panels, who, given.name, given.note
    )


@router.get("/audit", responses=refusals(422), response_model_exclude_none=True, summary="Who did what")
def log(
    who: Releaser,
    here: Here,
    limit: Annotated[int, Query(ge=1, le=200)] = PAGE_SIZE,
    cursor: Annotated[int | None, Query(ge=1, lt=2**31, description="`next` of the page before")] = None,
    job: Annotated[
        str | None, Query(pattern=JOB_ID.pattern, max_length=32, description="of this job")
    ] = None,
    act: Annotated[list[Act] | None, Query(description="these acts alone")] = None,
) -> AuditList:
    """The audit log of the token's team, the newest first, also of jobs that were deleted. It needs the role
    release."""
    found, following = audit.page(here.database, who, job, tuple(act or ()), cursor, limit)
    return AuditList(acts=found, next=following)


@router.get(
    "/jobs/{job}/releases",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="The releases of a job",
)
def releases(found: OwnJob, here: Here) -> ReleaseList:
    """The newest first; at most that one holds."""
    return ReleaseList(releases=here.releases.all(found.id))
