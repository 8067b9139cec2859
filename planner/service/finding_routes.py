"""The API's routes by which people keep order among jobs: what they call them, and deleting many."""

from typing import Annotated, Any, Final

import anyio.to_thread
from fastapi import APIRouter, Request
from pydantic import ConfigDict, Field

from planner.service.models import Deleted, JobOut, Sent
from planner.service.routes import ASKED, Asker, Caller, Here, OwnJob, Tag, job_of, refusals
from planner.service.security import RefusedError
from planner.service.texts import Line, Lines, described, read_body

router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=ASKED)


class Describing(Sent):
    """What people call a job; what is left out stays."""

    model_config = ConfigDict(extra="forbid")
    title: Line | None = None
    tags: list[Tag] | None = Field(None, max_length=20)
    notes: Lines | None = None

    def change(self) -> dict[str, Any]:
        """What is said, by its name."""
        return {name: value for name, value in self.model_dump().items() if value is not None}


class Deleting(Sent):
    """Jobs to be deleted."""

    model_config = ConfigDict(extra="forbid")
    jobs: list[Annotated[str, Field(max_length=40)]] = Field(min_length=1, max_length=200)


@router.patch(
    "/jobs/{job}",
    responses=refusals(404, 413, 422),
    openapi_extra=described(Describing),
    response_model_exclude_none=True,
    summary="Give a job a title, tags, notes",
)
async def describe(request: Request, found: OwnJob, here: Here) -> JobOut:
    """What people call it, beside the name that its problem has: ``{"title": "Gewölbe 3", "tags": ["dome"],
    "notes": "..."}``. What is left out stays as it is."""
    given = await read_body(request, Describing)
    return await anyio.to_thread.run_sync(here.jobs.describe, found.id, given.change())


@router.post(
    "/jobs/delete",
    responses=refusals(413, 422),
    openapi_extra=described(Deleting),
    summary="Delete many jobs",
)
async def delete_many(request: Request, owner: Caller, who: Asker, here: Here) -> Deleted:
    """As each of them alone would be: ``{"jobs": ["24d8...", ...]}``. Those that there are not are told."""
    given = await read_body(request, Deleting)

    def delete_each() -> Deleted:
        done: dict[str, bool] = {}
        for job in dict.fromkeys(given.jobs):
            try:
                here.jobs.cancel(job_of(job, who, here).id, owner, also_delete=True)
                done[job] = True
            except RefusedError as refused:
                if refused.status != 404:
                    raise
                done[job] = False
        return Deleted(
            deleted=[j for j, ok in done.items() if ok], unknown=[j for j, ok in done.items() if not ok]
        )

    return await anyio.to_thread.run_sync(delete_each)
