"""The API's routes of the queue: whose turn it is, a sweep of a field, several problems
at once, how long a job may still take."""

import json
import math
import time
from typing import Annotated, Any, Final

import anyio.to_thread
from fastapi import APIRouter, Query, Request

from planner.issues import Issue
from planner.service import idempotency
from planner.service.draft_routes import VersionOf, mark_sent, versions_of
from planner.service.estimates import EstimateOut
from planner.service.models import JobList, JobOut
from planner.service.routes import ASKED, UPLOADED, UPLOADS, Asker, Caller, Here, Key, OwnJob, Tag, refusals
from planner.service.security import RefusedError
from planner.service.storage import documented, take_upload, take_uploads
from planner.service.texts import Line

router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=ASKED)
MOST_VALUES: Final = 50
"""Values of a sweep, problems of a batch."""
Scalar = Annotated[Line, Query()]


@router.post(
    "/jobs/{job}/first",
    responses=refusals(404, 409),
    response_model_exclude_none=True,
    summary="Let a job come first",
)
def first(found: OwnJob, here: Here) -> JobOut:
    """Of the jobs of its owner that wait, this one is planned first; the others keep their order, and jobs of
    other owners their turn. 409 for one that does not wait."""
    return here.jobs.first(found.id)


@router.get(
    "/jobs/{job}/estimate",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="How long a job may still take",
)
def estimate(found: OwnJob, _: Caller, who: Asker, here: Here) -> EstimateOut:
    """By medians of the stages of like jobs that were proven: of the same processes, yours or your team's.
    Where there are none, nothing is estimated."""
    return here.estimates.of(found, here.auth.owners(who), time.time())


@router.post(
    "/sweeps",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOADED | refusals(404),
    openapi_extra=UPLOADS,
    summary="Plan a problem with a field at several values",
)
async def sweep(
    request: Request,
    owner: Caller,
    here: Here,
    key: Key,
    field: Annotated[Line, Query(min_length=1, description="its place, such as operations.0.feed_mm_s")],
    value: Annotated[
        list[Scalar],
        Query(min_length=1, max_length=MOST_VALUES, description="numbers, true, false, or words"),
    ],
    who: Asker,
    tag: Annotated[Tag, Query(description="a tag that all of them get")] = "sweep",
    draft: Annotated[
        VersionOf | None,
        Query(description="whose version this is: it was sent as the first job from then on"),
    ] = None,
) -> JobList:
    """A job for each value, all or none, with a common tag, and a title that says the value. A value with
    which the problem cannot be read is refused with what is wrong."""
    values = [_value(one) for one in value]
    shown = [json.dumps(one, ensure_ascii=False) for one in values]  # 1 is not true
    doubled = sorted({one for one in shown if shown.count(one) > 1})
    if doubled:
        what = f"value: got {', '.join(doubled)[:80]} more than once; give each value once"
        raise RefusedError(422, Issue("service.request", what, field="value"))
    sent = await anyio.to_thread.run_sync(versions_of, [draft] if draft else [], owner, who, here)
    upload = await take_upload(request, here.storage, owner, here.limits)
    once = idempotency.once(owner, key, "sweeps", upload.content, field, values, tag)
    jobs = await here.made_once(
        request, owner, once, lambda reading: here.sweep(owner, upload, field, values, tag, reading, once)
    )
    await anyio.to_thread.run_sync(mark_sent, sent, jobs, here)
    return JobList(jobs=list(jobs))


@router.post(
    "/batches",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOADED | refusals(404),
    openapi_extra={"requestBody": documented({"$ref": "#/components/schemas/ProblemFile"}, MOST_VALUES)},
    summary="Plan several problems",
)
async def batch(
    request: Request,
    owner: Caller,
    here: Here,
    key: Key,
    who: Asker,
    tag: Annotated[Tag, Query(description="a tag that all of them get")] = "batch",
    draft: Annotated[
        list[VersionOf] | None,
        Query(max_length=MOST_VALUES, description="whose versions the first parts are, in their order"),
    ] = None,
) -> JobList:
    """A job for each part ``problem``, all or none, with the ``files`` in common and a tag. What is wrong
    with problems that cannot be read is told of each, by the name of its file and by its number in ``of``."""
    sent = await anyio.to_thread.run_sync(versions_of, draft or [], owner, who, here)
    uploads = await take_uploads(request, here.storage, owner, here.limits, MOST_VALUES)
    content = [[name, one.content] for name, one in uploads.items()]  # jobs are in their order
    once = idempotency.once(owner, key, "batches", content, tag)
    jobs = await here.made_once(
        request, owner, once, lambda reading: here.batch(owner, uploads, tag, reading, once)
    )
    if len(jobs) == len(uploads):  # none of those that were made before is gone
        await anyio.to_thread.run_sync(mark_sent, sent, jobs, here)
    return JobList(jobs=list(jobs))


def _value(text: str) -> Any:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return found if isinstance(found, (bool, int, float)) and math.isfinite(found) else text
