"""API routes of drafts: unfinished problems, and cells, tools and templates kept for later use."""

import contextlib
import dataclasses
import datetime as dt
import json
from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

import anyio.to_thread
from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import ConfigDict, Field
from sqlalchemy import RowMapping

from planner.issues import Issue
from planner.service.drafts import DraftEdit, entity_tag, unknown_draft
from planner.service.http_responses import stored_file_response
from planner.service.models import FileOut, JobOut, Sent, utc
from planner.service.routes import (
    AUTH_REFUSALS,
    CURSOR,
    FILE_RESPONSES,
    JOB_ID,
    UPLOAD_REFUSALS,
    AuthorisedOwner,
    AuthorisedPrincipal,
    CurrentPrincipal,
    CurrentService,
    refusals,
    visible_job,
)
from planner.service.security import Principal, RefusedError
from planner.service.service import Service
from planner.service.storage import Blob, request_body_schema, store_upload
from planner.service.user_texts import Line, body_description, read_body

router: Final = APIRouter(prefix="/v1/drafts", tags=["drafts"], responses=AUTH_REFUSALS)
DraftKind = Literal["draft", "cell", "tool", "template"]
BINARY_TYPE: Final = "application/octet-stream"
"""Content type of user content, so that no browser renders it."""
SAVE_BODY: Final = {
    "requestBody": request_body_schema({"type": "object", "description": "a problem, valid or not"})
}
"""OpenAPI description of the body of a draft."""


class DraftOut(Sent):
    """A draft. Its `ETag` is its version."""

    id: str
    kind: DraftKind
    title: str
    version: int = Field(description="number of the last version")
    by: str = Field(description="name of the token that created it")
    created: dt.datetime
    changed: dt.datetime
    sent: int | None = Field(None, description="last version that was submitted as a job")
    job: str | None = Field(None, description="job of that version, if it exists")


class VersionOut(Sent):
    """A version of a draft: who saved it and when."""

    number: int
    at: dt.datetime
    by: str
    files: list[str] = Field(description="names of its files")


class DraftVersions(DraftOut):
    """A draft with its versions, newest first. The oldest versions are deleted."""

    versions: list[VersionOut]


class DraftList(Sent):
    """A page of drafts, last changed first. ``next`` is the ``cursor`` of the next page."""

    drafts: list[DraftOut]
    next: str | None = None


class DraftContent(Sent):
    """Problem and files of a version."""

    problem: FileOut
    files: list[FileOut]


class Titled(Sent):
    """The title of a draft."""

    model_config = ConfigDict(extra="forbid")
    title: Line


class Planned(Sent):
    """The job as which a version was submitted."""

    model_config = ConfigDict(extra="forbid")
    version: int = Field(ge=1, lt=2**31)
    job: str = Field(pattern=JOB_ID.pattern, max_length=32)


def own_draft(draft: str, _: AuthorisedOwner, principal: CurrentPrincipal, service: CurrentService) -> str:
    """Return the id of a draft that the caller or its team owns (dependency).

    Raises:
        RefusedError: 404, the draft does not exist or belongs to others.
    """
    if not JOB_ID.fullmatch(draft) or not service.auth.sees(principal, service.drafts.owner(draft)):
        raise unknown_draft(draft)
    return draft


OwnDraft = Annotated[str, Depends(own_draft)]
VersionOf = Annotated[str, Query(pattern="^[0-9a-f]{32}@[1-9][0-9]{0,8}$", max_length=42)]
"""A version of a draft, such as ``5e1c...@3``."""


def parse_versions(
    given: Sequence[str], owner: str, principal: Principal, service: Service
) -> list[tuple[str, int]]:
    """Parse and check versions of drafts.

    Args:
        given: Versions as ``DRAFT@NUMBER``.
        owner: Token of the caller.
        principal: Authenticated caller.
        service: Service.

    Returns:
        Pairs of draft id and version number, in the same order.

    Raises:
        RefusedError: 404, the caller has no such draft or version.
    """
    versions = []
    for draft, _, number in (version.partition("@") for version in given):
        service.drafts.version(own_draft(draft, owner, principal, service), int(number))
        versions.append((draft, int(number)))
    return versions


def mark_sent(sent: Sequence[tuple[str, int]], jobs: Sequence[JobOut], service: Service) -> None:
    """Record for each version that it was submitted as the job at the same position.

    Args:
        sent: Pairs of draft id and version number.
        jobs: Jobs in the same order. If one sequence is longer, its further items are ignored.
        service: Service.
    """
    for (draft, number), job in zip(sent, jobs, strict=False):
        with contextlib.suppress(RefusedError):  # the draft was deleted meanwhile, the jobs exist
            service.drafts.mark_sent(draft, number, job.id)


Title = Annotated[Line, Query(description="title, in any language")]
Number = Annotated[int, Path(ge=1, lt=2**31)]


@router.post(
    "",
    status_code=201,
    responses=UPLOAD_REFUSALS,
    openapi_extra=SAVE_BODY,
    summary="Keep a problem, cell, tool or template",
)
async def create(
    request: Request,
    response: Response,
    principal: AuthorisedPrincipal,
    service: CurrentService,
    title: Title = "",
    kind: Annotated[DraftKind, Query(description="kind of the upload")] = "draft",
) -> DraftOut:
    """Keeps the upload and its files unchanged, valid or not.

    Members of the team can open and change it.
    """
    upload = await store_upload(request, service.storage, principal.token, service.limits)
    row = await anyio.to_thread.run_sync(service.drafts.create, principal, kind, title, upload)
    return _draft_model(row, response)


@router.get("", responses=refusals(422), summary="List your drafts")
def page(
    _: AuthorisedOwner,
    principal: CurrentPrincipal,
    service: CurrentService,
    kind: Annotated[list[DraftKind] | None, Query(description="only these kinds")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    cursor: CURSOR = None,
) -> DraftList:
    """Drafts of the caller and its team, one page at a time."""
    rows, next_cursor = service.drafts.page(service.auth.owners(principal), kind or (), limit, cursor)
    return DraftList(drafts=[_draft_model(row) for row in rows], next=next_cursor)


@router.get("/{draft}", responses=refusals(404), summary="A draft with its versions")
def get(draft_id: OwnDraft, service: CurrentService, response: Response) -> DraftVersions:
    """Who saved which version, and when."""
    row, versions = service.drafts.get(draft_id)
    version_models = [_version_model(version) for version in versions]
    return DraftVersions(**_draft_model(row, response).model_dump(), versions=version_models)


@dataclasses.dataclass(frozen=True)
class SaveRequest:
    """Header and query parameters of a request that saves a draft (dependency).

    Attributes:
        if_match: Entity tags of the version that was edited, or None.
        without: Files of the last version that are dropped, or None.
        title: New title, or None to keep it.
        instead: Set the title only if the present one is this, or None.
    """

    if_match: Annotated[
        str | None, Header(max_length=100, description="`ETag` of the version that was edited")
    ] = None
    without: Annotated[
        list[Annotated[str, Query(max_length=255)]] | None,
        Query(max_length=64, description="files of the last version that are dropped"),
    ] = None
    title: Annotated[Line | None, Query(description="new title")] = None
    instead: Annotated[Line | None, Query(description="set the title only if the present one is this")] = None


@router.put(
    "/{draft}",
    responses={
        **refusals(404, 413, 422, 507),
        412: {"description": "the draft was saved since the version in `If-Match`"},
        428: {"description": "`If-Match` is missing"},
    },
    openapi_extra=SAVE_BODY,
    summary="Save a draft",
)
async def save(
    request: Request,
    response: Response,
    draft_id: OwnDraft,
    principal: AuthorisedPrincipal,
    service: CurrentService,
    save_request: Annotated[SaveRequest, Depends(SaveRequest)],
) -> DraftOut:
    """Saves the next version: the upload, and files of the last version that are not sent again.

    412 if the draft was saved since the version in `If-Match`, so that no change is overwritten unseen.
    """
    if save_request.if_match is None:
        message = "If-Match: is missing. Send the ETag of the version that you edited."
        raise RefusedError(428, Issue("service.draft", message, field="If-Match"))
    owner = principal.token
    tags = [tag.strip().removeprefix("W/") for tag in save_request.if_match.split(",")]
    edit = DraftEdit(tags, save_request.without or (), save_request.title, save_request.instead)
    upload = await store_upload(request, service.storage, owner, service.limits)
    draft_owner = await anyio.to_thread.run_sync(service.drafts.owner, draft_id)
    if draft_owner is not None and draft_owner != owner:  # files of a draft are charged to its owner
        blobs = [upload.problem, *upload.files.values()]
        await anyio.to_thread.run_sync(service.storage.check_owner_space, draft_owner, blobs)
    row = await anyio.to_thread.run_sync(service.drafts.save, draft_id, principal, upload, edit)
    return _draft_model(row, response)


@router.patch(
    "/{draft}",
    responses=refusals(404, 413, 422),
    openapi_extra=body_description(Titled),
    summary="Rename a draft",
)
async def rename(
    request: Request, response: Response, draft_id: OwnDraft, service: CurrentService
) -> DraftOut:
    """``{"title": "Gewölbe 3"}``. This creates no new version."""
    body = await read_body(request, Titled)
    return _draft_model(await anyio.to_thread.run_sync(service.drafts.rename, draft_id, body.title), response)


@router.post(
    "/{draft}/sent",
    responses=refusals(404, 413, 422),
    openapi_extra=body_description(Planned),
    summary="Record that a draft was submitted",
)
async def sent(
    request: Request,
    response: Response,
    draft_id: OwnDraft,
    principal: CurrentPrincipal,
    service: CurrentService,
) -> DraftOut:
    """``{"version": 3, "job": "24d8..."}``.

    The draft no longer counts as unsubmitted until it is changed.
    """
    body = await read_body(request, Planned)
    await anyio.to_thread.run_sync(visible_job, body.job, principal, service)
    row = await anyio.to_thread.run_sync(service.drafts.mark_sent, draft_id, body.version, body.job)
    return _draft_model(row, response)


@router.delete("/{draft}", responses=refusals(404), status_code=204, summary="Delete a draft")
def delete(draft_id: OwnDraft, owner: AuthorisedOwner, service: CurrentService) -> Response:
    """Deletes all versions too."""
    service.drafts.delete(draft_id, owner)
    return Response(status_code=204)


@router.get("/{draft}/versions/{number}", responses=refusals(404, 422), summary="A version of a draft")
def version(draft_id: OwnDraft, number: Number, service: CurrentService) -> DraftContent:
    """Name, size and hash of its problem and files."""
    problem, files = service.drafts.version(draft_id, number)
    file_models = [_file_model(name, blob) for name, blob in sorted(files.items())]
    return DraftContent(problem=_file_model("problem", problem), files=file_models)


@router.get(
    "/{draft}/versions/{number}/problem",
    responses={
        200: {"content": {BINARY_TYPE: {"schema": {"type": "string"}}}},
        **FILE_RESPONSES,
        **refusals(404, 422),
    },
    response_class=FileResponse,
    summary="The problem of a version",
)
def problem(request: Request, draft_id: OwnDraft, number: Number, service: CurrentService) -> Response:
    """The problem file, unchanged."""
    return _file_response(request, service, service.drafts.version(draft_id, number)[0])


@router.get(
    "/{draft}/versions/{number}/files/{name:path}",
    responses={
        200: {"content": {BINARY_TYPE: {"schema": {"type": "string"}}}},
        **FILE_RESPONSES,
        **refusals(404, 422),
    },
    response_class=FileResponse,
    summary="A file of a version",
)
def file(
    request: Request, draft_id: OwnDraft, number: Number, name: str, service: CurrentService
) -> Response:
    """The file, unchanged."""
    blob = service.drafts.version(draft_id, number)[1].get(name)
    if blob is None:
        message = f"version {number} of draft {draft_id}: file {name[:200]!r} not found. List its files."
        raise RefusedError(404, Issue("service.unknown_file", message, field="name"))
    return _file_response(request, service, blob)


def _file_response(request: Request, service: CurrentService, blob: Blob) -> Response:
    headers = {"Cache-Control": "private, no-cache"}
    return stored_file_response(request, service.files.path(blob.sha), blob.sha, BINARY_TYPE, headers)


def _draft_model(row: RowMapping, response: Response | None = None) -> DraftOut:
    """Convert the database row of a draft to its API model, and set the ``ETag`` of a response."""
    fields: dict[str, Any] = {name: row[name] for name in ("id", "kind", "title", "version")}
    if response is not None:
        response.headers["ETag"] = entity_tag(row)
    fields |= {"created": utc(row["created"]), "changed": utc(row["changed"]), "by": row["made_by"]}
    fields |= {"sent": row["sent"], "job": row["sent_as"]}
    return DraftOut(**fields)


def _version_model(row: RowMapping) -> VersionOut:
    names = [file["name"] for file in json.loads(row["files"])]
    return VersionOut(number=row["number"], at=utc(row["at"]), by=row["who"], files=names)


def _file_model(name: str, blob: Blob) -> FileOut:
    return FileOut(name=name, size=blob.size, sha256=blob.sha, content_type=BINARY_TYPE)
