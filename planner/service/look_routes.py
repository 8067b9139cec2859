"""Links to look at a job: made, listed and withdrawn by who may plan, and what they show to others."""

from typing import Annotated, Final

from fastapi import APIRouter, Query, Request, Response

from planner.service import releases
from planner.service.links import LONGEST_LOOK_S, LOOK_S, TO_LOOK_AT
from planner.service.models import LinkMade, LookList, LookOut
from planner.service.routes import ASKED, Asker, Here, OwnJob, looked_at, refusals

router: Final = APIRouter(prefix="/v1", tags=["links"])
PRIVATE: Final = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Robots-Tag": "noindex"}
"""Headers of what a link opens: it is neither kept nor told to others."""
Signature = Annotated[str, Query(max_length=200, description="as in the link")]


@router.post(
    "/jobs/{job}/looks",
    status_code=201,
    responses=ASKED | refusals(404, 409, 422),
    summary="Link to look at a job",
)
def make(
    found: OwnJob,
    who: Asker,
    here: Here,
    seconds: Annotated[int, Query(ge=1, le=LONGEST_LOOK_S, description="how long it is good for")] = LOOK_S,
) -> LinkMade:
    """An address of a page for whoever has it: state, figures, issues, report and replay of this job, and
    nothing else. It ends by then, when it is withdrawn, with the token that asks for it, or with the job."""
    return here.links.make(found, who, seconds)


@router.get("/jobs/{job}/looks", responses=ASKED | refusals(404), summary="Links to look at a job")
def listed(found: OwnJob, here: Here) -> LookList:
    """Those that are not over, without their addresses."""
    return LookList(links=here.links.all(found.id))


@router.delete(
    "/jobs/{job}/looks/{look}",
    responses=ASKED | refusals(404),
    status_code=204,
    summary="Withdraw a link to look",
)
def withdraw(found: OwnJob, look: str, who: Asker, here: Here) -> Response:
    """It opens nothing from then on, also for who has the page open."""
    here.links.withdraw(found, look, who)
    return Response(status_code=204)


@router.get(
    "/jobs/{job}/looks/{look}", responses=refusals(403, 404, 422, 429, 503), summary="Look at a job by a link"
)
def look_at(
    request: Request, response: Response, job: str, look: str, here: Here, signature: Signature
) -> LookOut:
    """What its page shows. Asks for no token."""
    found, expires = looked_at(request, job, look, signature, here)
    response.headers.update(PRIVATE)
    known = here.jobs.files(job)
    own = LookOut.model_fields.keys() - {"release", "files", "expires"}
    has_programs = any(releases.is_program(name) for name in known)
    return LookOut(
        **{name: getattr(found, name) for name in own},
        release=releases.word(found.release) if has_programs else None,
        files=[name for name in TO_LOOK_AT if name in known],
        expires=expires,
    )
