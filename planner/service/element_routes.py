"""API routes of building elements.

An element is also the job that divides it. Its files, events and state are those of ``/v1/jobs/ID``.
"""

import dataclasses
from typing import Annotated, Final, Literal

import anyio.to_thread
from fastapi import APIRouter, Depends, Query, Request, Response

from planner.issues import Issue
from planner.service import idempotency
from planner.service.http_responses import conditional_json
from planner.service.job_description_routes import Describing
from planner.service.job_search import JobFilter
from planner.service.logs import record_jobs
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
    AUTH_REFUSALS,
    JOB_ID,
    LIST_CURSOR,
    LIST_RESPONSES,
    PAGE_SIZE,
    UPLOAD_REFUSALS,
    AuthorisedOwner,
    AuthorisedPrincipal,
    CurrentPrincipal,
    CurrentService,
    Key,
    Search,
    Tags,
    refusals,
)
from planner.service.security import Principal, RefusedError
from planner.service.service import Service
from planner.service.storage import request_body_schema, store_upload
from planner.service.user_texts import body_description, read_body

router: Final = APIRouter(prefix="/v1", tags=["elements"], responses=AUTH_REFUSALS)
_ELEMENT_SCHEMA: Final = {"type": "object", "description": "an element file as data; see docs/element.md"}
ELEMENT_BODY: Final = {"requestBody": request_body_schema(_ELEMENT_SCHEMA)}
"""OpenAPI description of a body that contains an element."""


def own_element(
    element: str, _: AuthorisedOwner, principal: CurrentPrincipal, service: CurrentService
) -> str:
    """Return the id of an element that the caller or its team owns (dependency).

    Raises:
        RefusedError: 404.
    """
    return visible_element_id(element, principal, service)


def visible_element_id(element: str, principal: Principal, service: Service) -> str:
    """Return the id of an element that the caller may see.

    Args:
        element: Id from the request.
        principal: Authenticated caller.
        service: Service.

    Raises:
        RefusedError: 404, the element does not exist or belongs to others.
    """
    if not JOB_ID.fullmatch(element) or not service.auth.sees(principal, service.elements.owner(element)):
        message = f"element {element[:40]!r}: not found. List the elements."
        raise RefusedError(404, Issue("service.unknown_job", message))
    record_jobs(element)
    return element


OwnElement = Annotated[str, Depends(own_element)]


@router.post(
    "/elements",
    status_code=201,
    response_model_exclude_none=True,
    responses=UPLOAD_REFUSALS,
    openapi_extra=ELEMENT_BODY,
    summary="Divide a building element",
)
async def create(request: Request, owner: AuthorisedOwner, service: CurrentService, key: Key) -> ElementOut:
    """Upload an element file as ``problem``, with all ``files`` that it names: meshes, templates, cells."""
    upload = await store_upload(request, service.storage, owner, service.limits)
    request_key = idempotency.hashed_key(owner, key, "elements", upload.content)
    earlier = await anyio.to_thread.run_sync(service.elements.created_before, request_key)
    if earlier is not None:
        return earlier
    return await service.run_in_turn(
        request, owner, lambda reading: service.elements.create(owner, upload, reading, request_key)
    )


@dataclasses.dataclass(frozen=True)
class ElementListQuery:
    """Query parameters of the list of elements (dependency).

    Attributes:
        limit: Maximum number of elements on the page.
        cursor: Cursor from the previous page, or None.
        search: Words that all occur in name, title, tags or notes.
        tag: Only with all of these tags, or None.
        sort: Order.
    """

    limit: Annotated[int, Query(ge=1, le=200)] = PAGE_SIZE
    cursor: LIST_CURSOR = None
    search: Search = ""
    tag: Tags = None
    sort: Annotated[
        Literal["newest", "oldest", "title"], Query(description="order: by creation time, or title or name")
    ] = "newest"


@router.get(
    "/elements",
    response_model=ElementList,
    responses=LIST_RESPONSES | refusals(422),
    summary="List your elements",
)
def page(
    request: Request,
    _: AuthorisedOwner,
    principal: CurrentPrincipal,
    service: CurrentService,
    query: Annotated[ElementListQuery, Depends(ElementListQuery)],
) -> Response:
    """Elements of the caller and its team, one page at a time.

    304 if ``If-None-Match`` shows that nothing has changed.
    """
    job_filter = JobFilter((), query.search, query.tag or (), query.sort, query.cursor)
    elements, next_cursor = service.elements.page(service.auth.owners(principal), job_filter, query.limit)
    return conditional_json(request, ElementList(elements=elements, next=next_cursor))


@router.get(
    "/elements/{element}",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="An element with its panels",
)
def get(element_id: OwnElement, service: CurrentService) -> ElementPanels:
    """State of the division, state of each panel, and progress."""
    return service.elements.get(element_id)


@router.patch(
    "/elements/{element}",
    responses=refusals(404, 413, 422),
    openapi_extra=body_description(Describing),
    response_model_exclude_none=True,
    summary="Give an element a title, tags, notes",
)
async def describe(request: Request, element_id: OwnElement, service: CurrentService) -> ElementPanels:
    """As for a job. An element that is divided again keeps them."""
    body = await read_body(request, Describing)
    await anyio.to_thread.run_sync(service.jobs.describe, element_id, body.changed_fields())
    return await anyio.to_thread.run_sync(service.elements.get, element_id)


@router.post(
    "/elements/{element}/divide",
    status_code=201,
    response_model_exclude_none=True,
    responses=refusals(404) | UPLOAD_REFUSALS,
    openapi_extra=body_description(Change),
    summary="Divide an element again with changed fields",
)
async def divide(
    request: Request,
    element: str,
    principal: AuthorisedPrincipal,
    service: CurrentService,
    key: Key,
    instead: Annotated[
        bool, Query(description="delete the present element if none of its panels was planned or marked")
    ] = False,
) -> ElementOut:
    """Creates another element with the marks of this one: ``{"fields": {"panels.hexagons.count": 120}}``."""
    owner = principal.token
    change = await read_body(request, Change)
    request_key = idempotency.hashed_key(owner, key, f"elements/{element}/divide", change.fields, instead)
    created = await anyio.to_thread.run_sync(service.elements.created_before, request_key)
    if created is None:  # an earlier request with this key may have deleted the element
        await anyio.to_thread.run_sync(visible_element_id, element, principal, service)
        created = await service.run_in_turn(
            request,
            owner,
            lambda reading: service.elements.divide_again(
                owner, element, change.fields, reading, request_key
            ),
        )
    if instead and service.auth.sees(principal, service.elements.owner(element)):
        await anyio.to_thread.run_sync(service.elements.delete_unused, element, owner)
    return created


@router.post(
    "/elements/{element}/plan",
    status_code=201,
    response_model_exclude_none=True,
    responses=refusals(404) | UPLOAD_REFUSALS,
    openapi_extra=body_description(Chosen),
    summary="Plan panels of an element",
)
async def plan(
    request: Request, element_id: OwnElement, owner: AuthorisedOwner, service: CurrentService, key: Key
) -> JobList:
    """Creates a job for each panel that is not planned yet, or for those in ``{"panels": ["A01", ...]}``.

    The plan of an adjacent panel is the reference plan.
    """
    body = await read_body(request, Chosen)
    request_key = idempotency.hashed_key(owner, key, f"elements/{element_id}/plan", body.panels)
    jobs = await service.create_idempotent(
        request,
        owner,
        request_key,
        lambda reading: service.elements.plan(owner, element_id, body.panels, reading, request_key),
    )
    return JobList(jobs=list(jobs))


@router.post(
    "/elements/{element}/mark",
    response_model_exclude_none=True,
    responses=refusals(404, 413, 422, 507),
    openapi_extra=body_description(Marking),
    summary="Mark a panel as cut, glued or broken",
)
async def mark(
    request: Request, element_id: OwnElement, owner: AuthorisedOwner, service: CurrentService
) -> ElementPanels:
    """Same as ``tandem element mark``: ``{"panel": "A01", "state": "cut"}``.

    ``told`` lists the next steps.
    """
    body = await read_body(request, Marking)
    await anyio.to_thread.run_sync(service.elements.mark, owner, element_id, body.panel, body.state)
    return await anyio.to_thread.run_sync(service.elements.get, element_id)


@router.post(
    "/elements/{element}/report",
    status_code=201,
    responses=refusals(404, 422, 429, 507),
    response_model_exclude_none=True,
    summary="Report on the planned panels",
)
def report(element_id: OwnElement, owner: AuthorisedOwner, service: CurrentService, key: Key) -> JobOut:
    """Creates a job that writes the same files as ``tandem element report``.

    These are ``element.html``, ``report.csv`` and ``joints.csv``.
    """
    return service.elements.report(
        owner, element_id, idempotency.hashed_key(owner, key, f"elements/{element_id}/report")
    )


@router.post(
    "/elements/{element}/cancel",
    responses=refusals(404),
    response_model_exclude_none=True,
    summary="Cancel an element",
)
def cancel(element_id: OwnElement, owner: AuthorisedOwner, service: CurrentService) -> ElementPanels:
    """Cancels its queued and running jobs: division, panels and report."""
    service.elements.cancel(element_id, owner)
    return service.elements.get(element_id)


@router.delete("/elements/{element}", responses=refusals(404), status_code=204, summary="Delete an element")
def delete(element_id: OwnElement, owner: AuthorisedOwner, service: CurrentService) -> Response:
    """Cancels its queued and running jobs. Planned panels remain as jobs."""
    service.elements.delete(element_id, owner)
    return Response(status_code=204)
