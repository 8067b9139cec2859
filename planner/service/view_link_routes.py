"""API routes of view links: create, list and withdraw them, and read what they show."""

from typing import Annotated, Final

from fastapi import APIRouter, Query, Request, Response

from planner.service import releases
from planner.service.links import DEFAULT_VIEW_LINK_S, MAX_VIEW_LINK_S, VIEWABLE_FILES
from planner.service.models import LinkMade, LookList, LookOut
from planner.service.routes import (
    AUTH_REFUSALS,
    CurrentPrincipal,
    CurrentService,
    OwnJob,
    job_of_view_link,
    refusals,
)

router: Final = APIRouter(prefix="/v1", tags=["links"])
PRIVATE_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Robots-Tag": "noindex",
}
"""Headers of answers to a view link: not cached, not indexed, and not passed on as referrer."""
Signature = Annotated[str, Query(max_length=200, description="as in the link")]


@router.post(
    "/jobs/{job}/looks",
    status_code=201,
    responses=AUTH_REFUSALS | refusals(404, 409, 422),
    summary="Create a view link of a job",
)
def make(
    job_out: OwnJob,
    principal: CurrentPrincipal,
    service: CurrentService,
    seconds: Annotated[
        int, Query(ge=1, le=MAX_VIEW_LINK_S, description="lifetime of the link")
    ] = DEFAULT_VIEW_LINK_S,
) -> LinkMade:
    """Address of a page that shows this job to everybody who has the address.

    The page shows state, results, issues, report and replay of this job, and nothing else. It ends after
    ``seconds``, or when it is withdrawn, with the token that created it, or with the job.
    """
    return service.links.create_view_link(job_out, principal, seconds)


@router.get("/jobs/{job}/looks", responses=AUTH_REFUSALS | refusals(404), summary="View links of a job")
def listed(job_out: OwnJob, service: CurrentService) -> LookList:
    """The links in force, without their addresses."""
    return LookList(links=service.links.view_links(job_out.id))


@router.delete(
    "/jobs/{job}/looks/{look}",
    responses=AUTH_REFUSALS | refusals(404),
    status_code=204,
    summary="Withdraw a view link",
)
def withdraw(job_out: OwnJob, look: str, principal: CurrentPrincipal, service: CurrentService) -> Response:
    """The link opens nothing from then on, not even for an open page."""
    service.links.withdraw(job_out, look, principal)
    return Response(status_code=204)


@router.get(
    "/jobs/{job}/looks/{look}", responses=refusals(403, 404, 422, 429, 503), summary="Open a view link"
)
def look_at(
    request: Request, response: Response, job: str, look: str, service: CurrentService, signature: Signature
) -> LookOut:
    """Content of the page of a view link. Requires no token."""
    job_out, expires = job_of_view_link(request, job, look, signature, service)
    response.headers.update(PRIVATE_HEADERS)
    files = service.jobs.files(job)
    job_fields = LookOut.model_fields.keys() - {"release", "files", "expires"}
    has_programs = any(releases.is_program(name) for name in files)
    return LookOut(
        **{name: getattr(job_out, name) for name in job_fields},
        release=releases.release_state(job_out.release) if has_programs else None,
        files=[name for name in VIEWABLE_FILES if name in files],
        expires=expires,
    )
