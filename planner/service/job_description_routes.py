"""API routes to title, tag and annotate jobs, and to delete many at once."""

from typing import Annotated, Any, Final

import anyio.to_thread
from fastapi import APIRouter, Request
from pydantic import ConfigDict, Field

from planner.service.models import Deleted, JobOut, Sent
from planner.service.routes import (
    AUTH_REFUSALS,
    AuthorisedOwner,
    CurrentPrincipal,
    CurrentService,
    OwnJob,
    Tag,
    refusals,
    visible_job,
)
from planner.service.security import RefusedError
from planner.service.user_texts import Line, Lines, body_description, read_body

router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=AUTH_REFUSALS)


class Describing(Sent):
    """Title, tags and notes of a job. Omitted fields stay unchanged."""

    model_config = ConfigDict(extra="forbid")
    title: Line | None = None
    tags: list[Tag] | None = Field(None, max_length=20)
    notes: Lines | None = None

    def changed_fields(self) -> dict[str, Any]:
        """Return the fields that are given, by name."""
        return {name: value for name, value in self.model_dump().items() if value is not None}


class Deleting(Sent):
    """Jobs to delete."""

    model_config = ConfigDict(extra="forbid")
    jobs: list[Annotated[str, Field(max_length=40)]] = Field(min_length=1, max_length=200)


@router.patch(
    "/jobs/{job}",
    responses=refusals(404, 413, 422),
    openapi_extra=body_description(Describing),
    response_model_exclude_none=True,
    summary="Give a job a title, tags, notes",
)
async def describe(request: Request, job_out: OwnJob, service: CurrentService) -> JobOut:
    """A title besides the name of the problem, tags and notes. Omitted fields stay unchanged.

    Example: ``{"title": "Gewölbe 3", "tags": ["dome"], "notes": "..."}``.
    """
    body = await read_body(request, Describing)
    return await anyio.to_thread.run_sync(service.jobs.describe, job_out.id, body.changed_fields())


@router.post(
    "/jobs/delete",
    responses=refusals(413, 422),
    openapi_extra=body_description(Deleting),
    summary="Delete many jobs",
)
async def delete_many(
    request: Request, owner: AuthorisedOwner, principal: CurrentPrincipal, service: CurrentService
) -> Deleted:
    """Deletes each job as a single deletion would: ``{"jobs": ["24d8...", ...]}``.

    Ids that do not exist are listed in ``unknown``.
    """
    body = await read_body(request, Deleting)

    def delete_each() -> Deleted:
        was_deleted: dict[str, bool] = {}
        for job in dict.fromkeys(body.jobs):
            try:
                service.jobs.cancel(visible_job(job, principal, service).id, owner, also_delete=True)
                was_deleted[job] = True
            except RefusedError as refused:
                if refused.status != 404:
                    raise
                was_deleted[job] = False
        return Deleted(
            deleted=[job for job, deleted in was_deleted.items() if deleted],
            unknown=[job for job, deleted in was_deleted.items() if not deleted],
        )

    return await anyio.to_thread.run_sync(delete_each)
