"""API routes of the queue.

These are its order, sweeps of a field, batches of problems, and estimates of the remaining time.
"""

import dataclasses
import json
import math
import time
from typing import Annotated, Any, Final

import anyio.to_thread
from fastapi import APIRouter, Depends, Query, Request

from planner.issues import Issue
from planner.service import idempotency
from planner.service.draft_routes import VersionOf, mark_sent, parse_versions
from planner.service.estimates import EstimateOut
from planner.service.models import JobList, JobOut
from planner.service.routes import (
    AUTH_REFUSALS,
    PROBLEM_BODY,
    UPLOAD_REFUSALS,
    AuthorisedOwner,
    AuthorisedPrincipal,
    CurrentPrincipal,
    CurrentService,
    Key,
    OwnJob,
    Tag,
    refusals,
)
from planner.service.security import RefusedError
from planner.service.service import FieldSweep
from planner.service.storage import request_body_schema, store_upload, store_uploads
from planner.service.user_texts import Line

router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=AUTH_REFUSALS)
MAX_VALUES: Final = 50
"""Maximum number of values of a sweep, and of problems of a batch."""
Scalar = Annotated[Line, Query()]


@router.post(
    "/jobs/{job}/first",
    responses=refusals(404, 409),
    response_model_exclude_none=True,
    summary="Move a job to the front",
)
def first(job_out: OwnJob, service: CurrentService) -> JobOut:
    """Moves a queued job before the other queued jobs of its owner.

    These keep their order, and jobs of other owners keep their turn. 409 if the job is not queued.
    """
    return service.jobs.move_to_front(job_out.id)


@router.get(
    "/jobs/{job}/estimate",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="Estimate the remaining time of a job",
)
def estimate(
    job_out: OwnJob, _: AuthorisedOwner, principal: CurrentPrincipal, service: CurrentService
) -> EstimateOut:
    """From the median stage times of proven jobs of the same processes, of the caller or its team.

    Without such jobs nothing is estimated.
    """
    return service.estimates.estimate(job_out, service.auth.owners(principal), time.time())


@dataclasses.dataclass(frozen=True)
class SweepQuery:
    """Query parameters of a sweep (dependency).

    Attributes:
        field: Path of the field.
        value: Values as text.
        tag: Tag of all jobs.
        draft: Version of the draft that is submitted, or None.
    """

    field: Annotated[Line, Query(min_length=1, description="field path, such as operations.0.feed_mm_s")]
    value: Annotated[
        list[Scalar], Query(min_length=1, max_length=MAX_VALUES, description="numbers, true, false, or texts")
    ]
    tag: Annotated[Tag, Query(description="tag of all jobs")] = "sweep"
    draft: Annotated[
        VersionOf | None,
        Query(description="version of the draft that is submitted, recorded with the first job"),
    ] = None


@router.post(
    "/sweeps",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOAD_REFUSALS | refusals(404),
    openapi_extra=PROBLEM_BODY,
    summary="Plan a problem with several values of a field",
)
async def sweep(
    request: Request,
    principal: AuthorisedPrincipal,
    service: CurrentService,
    key: Key,
    query: Annotated[SweepQuery, Depends(SweepQuery)],
) -> JobList:
    """Creates a job for each value, all or none, with a common tag and a title that contains the value.

    If the problem cannot be read with a value, the request is refused with the issues.
    """
    owner = principal.token
    values = [_parse_value(text) for text in query.value]
    value_texts = [json.dumps(text, ensure_ascii=False) for text in values]  # as text, 1 and true differ
    repeated = sorted({text for text in value_texts if value_texts.count(text) > 1})
    if repeated:
        message = f"value: is repeated (got {', '.join(repeated)[:80]}). Give each value once."
        raise RefusedError(422, Issue("service.request", message, field="value"))
    drafts = [query.draft] if query.draft else []
    sent = await anyio.to_thread.run_sync(parse_versions, drafts, owner, principal, service)
    upload = await store_upload(request, service.storage, owner, service.limits)
    request_key = idempotency.hashed_key(owner, key, "sweeps", upload.content, query.field, values, query.tag)
    field_sweep = FieldSweep(query.field, values, query.tag)
    jobs = await service.create_idempotent(
        request,
        owner,
        request_key,
        lambda reading: service.sweep(owner, upload, field_sweep, reading, request_key),
    )
    await anyio.to_thread.run_sync(mark_sent, sent, jobs, service)
    return JobList(jobs=list(jobs))


@router.post(
    "/batches",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOAD_REFUSALS | refusals(404),
    openapi_extra={
        "requestBody": request_body_schema({"$ref": "#/components/schemas/ProblemFile"}, MAX_VALUES)
    },
    summary="Plan several problems",
)
async def batch(
    request: Request,
    principal: AuthorisedPrincipal,
    service: CurrentService,
    key: Key,
    tag: Annotated[Tag, Query(description="tag of all jobs")] = "batch",
    draft: Annotated[
        list[VersionOf] | None,
        Query(max_length=MAX_VALUES, description="versions of drafts that the first parts are, in order"),
    ] = None,
) -> JobList:
    """Creates a job for each part ``problem``, all or none, with common ``files`` and a tag.

    Issues of problems that cannot be read contain the name of the file, and ``of`` contains its index.
    """
    owner = principal.token
    sent = await anyio.to_thread.run_sync(parse_versions, draft or [], owner, principal, service)
    uploads = await store_uploads(request, service.storage, owner, service.limits, MAX_VALUES)
    content = [[name, upload.content] for name, upload in uploads.items()]  # a list, because order matters
    request_key = idempotency.hashed_key(owner, key, "batches", content, tag)
    jobs = await service.create_idempotent(
        request, owner, request_key, lambda reading: service.batch(owner, uploads, tag, reading, request_key)
    )
    if len(jobs) == len(uploads):  # no job of an earlier request was deleted
        await anyio.to_thread.run_sync(mark_sent, sent, jobs, service)
    return JobList(jobs=list(jobs))


def _parse_value(text: str) -> Any:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return value if isinstance(value, (bool, int, float)) and math.isfinite(value) else text
