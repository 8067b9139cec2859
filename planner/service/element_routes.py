"""The API's routes of building elements. An element is also the job that divides it: its files, events and
state are those of ``/v1/jobs/ID``."""

from typing import Annotated, Final, Literal

import anyio.to_thread
from fastapi import APIRouter, Depends, Query, Request, Response

from planner.issues import Issue
from planner.service import idempotency
from planner.service.answers import tagged
from planner.service.finding import Wanted
from planner.service.finding_routes import Describing
from planner.service.logs import about
from planner.service.models import (
    Change,
    Chosen,
    ElementList,
    ElementOut,
    ElementPanels,
    JobList,
    JobOut,
    Marking,
)
from planner.service.routes import (
    ASKED,
    JOB_ID,
    KNOWN,
    LIST_CURSOR,
    PAGE_SIZE,
    UPLOADED,
    Asker,
    Caller,
    Here,
    Key,
    Search,
    Tags,
    refusals,
)
from planner.service.security import RefusedError, Who
from planner.service.service import Service
from planner.service.storage import documented, take_upload
from planner.service.texts import described, read_body

router: Final = APIRouter(prefix="/v1", tags=["elements"], responses=ASKED)
_FILE: Final = {"type": "object", "description": "an element file as data; see docs/element.md"}
UPLOADS: Final = {"requestBody": documented(_FILE)}
"""How the description of the interface tells of a body that is an element."""


def own_element(element: str, _: Caller, who: Asker, here: Here) -> str:
    """The id of an element, if it is the caller's or his team's; raises :class:`RefusedError`, 404."""
    return element_of(element, who, here)


def element_of(element: str, who: Who, here: Service) -> str:
    """The id of an element, if ``who`` sees it; raises :class:`RefusedError`, 404."""
    if not JOB_ID.fullmatch(element) or not here.auth.sees(who, here.elements.owner(element)):
        what = f"element {element[:40]!r}: there is none; list the elements"
        raise RefusedError(404, Issue("service.unknown_job", what))
    about(element)
    return element


OwnElement = Annotated[str, Depends(own_element)]


@router.post(
    "/elements",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOADED,
    openapi_extra=UPLOADS,
    summary="Divide a building element",
)
async def create(request: Request, owner: Caller, here: Here, key: Key) -> ElementOut:
    """Upload an element file as ``problem``, with all ``files`` that it names: meshes, templates, cells."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    once = idempotency.once(owner, key, "elements", upload.content)
    known = await anyio.to_thread.run_sync(here.elements.made, once)
    if known is not None:
        return known
    return await here.in_turn(
        request, owner, lambda reading: here.elements.create(owner, upload, reading, once)
    )


@router.get(
    "/elements", response_model=ElementList, responses=KNOWN | refusals(422), summary="List your elements"
)
def page(
    request: Request,
    _: Caller,
    who: Asker,
    here: Here,
    limit: Annotated[int, Query(ge=1, le=200)] = PAGE_SIZE,
    cursor: LIST_CURSOR = None,
    search: Search = "",
    tag: Tags = None,
    sort: Annotated[
        Literal["newest", "oldest", "title"], Query(description="when made, or title or name")
    ] = "newest",
) -> Response:
    """Yours and those of your team, a page at a time; 304 for who asks again with ``If-None-Match`` and has
    it as it is."""
    wanted = Wanted((), search, tag or (), sort, cursor)
    found, following = here.elements.page(here.auth.owners(who), wanted, limit)
    return tagged(request, ElementList(elements=found, next=following))


@router.get(
    "/elements/{element}",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="An element with its panels",
)
def get(found: OwnElement, here: Here) -> ElementPanels:
    """State of the division, of each panel, and how far it is made."""
    return here.elements.get(found)


@router.patch(
    "/elements/{element}",
    responses=refusals(404, 413, 422),
    openapi_extra=described(Describing),
    response_model_exclude_none=True,
    summary="Give an element a title, tags, notes",
)
async def describe(request: Request, found: OwnElement, here: Here) -> ElementPanels:
    """As a job; an element that is divided anew keeps them."""
    given = await read_body(request, Describing)
    await anyio.to_thread.run_sync(here.jobs.describe, found, given.change())
    return await anyio.to_thread.run_sync(here.elements.get, found)


@router.post(
    "/elements/{element}/divide",
    status_code=201,
    response_model_exclude_none=True,
    responses=refusals(404) | UPLOADED,
    openapi_extra=described(Change),
    summary="Divide an element anew, with fields changed",
)
async def divide(
    request: Request,
    element: str,
    owner: Caller,
    who: Asker,
    here: Here,
    key: Key,
    instead: Annotated[
        bool, Query(description="delete the former one if nothing was planned or marked of it")
    ] = False,
) -> ElementOut:
    """Another element, with the marks of this one: ``{"fields": {"panels.hexagons.count": 120}}``."""
    change = await read_body(request, Change)
    once = idempotency.once(owner, key, f"elements/{element}/divide", change.fields, instead)
    made = await anyio.to_thread.run_sync(here.elements.made, once)
    if made is None:  # a request that was done has perhaps taken this element away
        await anyio.to_thread.run_sync(element_of, element, who, here)
        made = await here.in_turn(
            request, owner, lambda reading: here.elements.change(owner, element, change.fields, reading, once)
        )
    if instead and here.auth.sees(who, here.elements.owner(element)):
        await anyio.to_thread.run_sync(here.elements.give_up, element, owner)
    return made


@router.post(
    "/elements/{element}/plan",
    status_code=201,
    response_model_exclude_none=True,
    responses=refusals(404) | UPLOADED,
    openapi_extra=described(Chosen),
    summary="Plan panels of an element",
)
async def plan(request: Request, found: OwnElement, owner: Caller, here: Here, key: Key) -> JobList:
    """A job for each panel that is not planned yet, or for those of ``{"panels": ["A01", ...]}``; each is
    planned like one beside it."""
    chosen = await read_body(request, Chosen)
    once = idempotency.once(owner, key, f"elements/{found}/plan", chosen.panels)
    jobs = await here.made_once(
        request, owner, once, lambda reading: here.elements.plan(owner, found, chosen.panels, reading, once)
    )
    return JobList(jobs=list(jobs))


@router.post(
    "/elements/{element}/mark",
    response_model_exclude_none=True,
    responses=refusals(404, 413, 422, 507),
    openapi_extra=described(Marking),
    summary="Mark a panel as cut, glued or broken",
)
async def mark(request: Request, found: OwnElement, owner: Caller, here: Here) -> ElementPanels:
    """As ``tandem element mark`` does: ``{"panel": "A01", "state": "cut"}``. ``told`` says what is next."""
    given = await read_body(request, Marking)
    await anyio.to_thread.run_sync(here.elements.mark, owner, found, given.panel, given.state)
    return await anyio.to_thread.run_sync(here.elements.get, found)


@router.post(
    "/elements/{element}/report",
    status_code=201,
    responses=refusals(404, 422, 429, 507),
    response_model_exclude_none=True,
    summary="Report on what was planned",
)
def report(found: OwnElement, owner: Caller, here: Here, key: Key) -> JobOut:
    """A job that writes what ``tandem element report`` does: ``element.html``, ``report.csv`` and
    ``joints.csv``."""
    return here.elements.report(owner, found, idempotency.once(owner, key, f"elements/{found}/report"))


@router.post(
    "/elements/{element}/cancel",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="Cancel an element",
)
def cancel(found: OwnElement, owner: Caller, here: Here) -> ElementPanels:
    """What of it waits or runs is cancelled: its division, its panels, a report."""
    here.elements.cancel(found, owner)
    return here.elements.get(found)


@router.delete("/elements/{element}", responses=refusals(404), status_code=204, summary="Delete an element")
def delete(found: OwnElement, owner: Caller, here: Here) -> Response:
    """What of it waits or runs is cancelled; panels that were planned stay as jobs."""
    here.elements.delete(found, owner)
    return Response(status_code=204)
