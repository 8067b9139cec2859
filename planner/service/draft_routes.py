"""The API's routes of drafts: problems in the making, and cells, tools and templates kept for later."""

import contextlib
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
from planner.service.answers import stored_file
from planner.service.drafts import tag_of, unknown_draft
from planner.service.models import FileOut, JobOut, Sent, utc
from planner.service.routes import (
    ASKED,
    CURSOR,
    JOB_ID,
    PARTS,
    UPLOADED,
    Asker,
    Caller,
    Here,
    job_of,
    refusals,
)
from planner.service.security import RefusedError, Who
from planner.service.service import Service
from planner.service.storage import Blob, documented, take_upload
from planner.service.texts import Line, described, read_body

router: Final = APIRouter(prefix="/v1/drafts", tags=["drafts"], responses=ASKED)
DraftKind = Literal["draft", "cell", "tool", "template"]
BINARY: Final = "application/octet-stream"
"""Content type of what people made: it is never shown as anything."""
SAVED: Final = {"requestBody": documented({"type": "object", "description": "a problem, right or wrong"})}
"""How the description of the interface tells of a draft's body."""


class DraftOut(Sent):
    """A draft; its `ETag` is its version."""

    id: str
    kind: DraftKind
    title: str
    version: int = Field(description="the last one")
    by: str = Field(description="name of the token that made it")
    created: dt.datetime
    changed: dt.datetime
    sent: int | None = Field(None, description="the version that was planned last; what is newer was not")
    job: str | None = Field(None, description="the job that it was planned as, while there is that")


class VersionOut(Sent):
    """What a draft was, by whom and since when."""

    number: int
    at: dt.datetime
    by: str
    files: list[str] = Field(description="names of its files")


class DraftVersions(DraftOut):
    """A draft with its versions, the newest first; the oldest go."""

    versions: list[VersionOut]


class DraftList(Sent):
    """A page of drafts, what was changed last first; ``next`` is the ``cursor`` of the page that follows."""

    drafts: list[DraftOut]
    next: str | None = None


class DraftContent(Sent):
    """What a version consists of."""

    problem: FileOut
    files: list[FileOut]


class Titled(Sent):
    """What people call a draft."""

    model_config = ConfigDict(extra="forbid")
    title: Line


class Planned(Sent):
    """The job that a version was sent as."""

    model_config = ConfigDict(extra="forbid")
    version: int = Field(ge=1, lt=2**31)
    job: str = Field(pattern=JOB_ID.pattern, max_length=32)


def own_draft(draft: str, _: Caller, who: Asker, here: Here) -> str:
    """The id of a draft, if it is the caller's or his team's; raises :class:`RefusedError`, 404."""
    if not JOB_ID.fullmatch(draft) or not here.auth.sees(who, here.drafts.owner(draft)):
        raise unknown_draft(draft)
    return draft


OwnDraft = Annotated[str, Depends(own_draft)]
VersionOf = Annotated[str, Query(pattern="^[0-9a-f]{32}@[1-9][0-9]{0,8}$", max_length=42)]
"""A version of a draft, such as ``5e1c...@3``."""


def versions_of(given: Sequence[str], owner: str, who: Who, here: Service) -> list[tuple[str, int]]:
    """Drafts and numbers of their versions; raises :class:`RefusedError`, 404, for what the caller has not
    got."""
    out = []
    for draft, _, number in (one.partition("@") for one in given):
        here.drafts.version(own_draft(draft, owner, who, here), int(number))
        out.append((draft, int(number)))
    return out


def mark_sent(sent: Sequence[tuple[str, int]], jobs: Sequence[JobOut], here: Service) -> None:
    """Note of each of some versions that it was sent as one of the jobs, in their order."""
    for (draft, number), job in zip(sent, jobs, strict=False):
        with contextlib.suppress(RefusedError):  # deleted meanwhile; the jobs are made
            here.drafts.mark_sent(draft, number, job.id)


Title = Annotated[Line, Query(description="what people call it, in any language")]
Number = Annotated[int, Path(ge=1, lt=2**31)]


@router.post(
    "",
    status_code=201,
    responses=UPLOADED,
    openapi_extra=SAVED,
    summary="Keep a problem, cell, tool or template",
)
async def create(
    request: Request,
    response: Response,
    owner: Caller,
    who: Asker,
    here: Here,
    title: Title = "",
    kind: Annotated[DraftKind, Query(description="what the upload is")] = "draft",
) -> DraftOut:
    """As it is sent, right or wrong, with its files. Those of one's team may open and change it."""
    upload = await take_upload(request, here.storage, owner, here.limits)
    row = await anyio.to_thread.run_sync(here.drafts.create, who, kind, title, upload)
    return _told(row, response)


@router.get("", responses=refusals(422), summary="List your drafts")
def page(
    _: Caller,
    who: Asker,
    here: Here,
    kind: Annotated[list[DraftKind] | None, Query(description="these kinds alone")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    cursor: CURSOR = None,
) -> DraftList:
    """Yours and those of your team, a page at a time."""
    rows, following = here.drafts.page(here.auth.owners(who), kind or (), limit, cursor)
    return DraftList(drafts=[_told(row) for row in rows], next=following)


@router.get("/{draft}", responses=refusals(404), summary="A draft with its versions")
def get(found: OwnDraft, here: Here, response: Response) -> DraftVersions:
    """Who saved which version, and when."""
    row, versions = here.drafts.get(found)
    told = [_version(one) for one in versions]
    return DraftVersions(**_told(row, response).model_dump(), versions=told)


@router.put(
    "/{draft}",
    responses={
        **refusals(404, 413, 422, 507),
        412: {"description": "somebody else has saved it meanwhile"},
        428: {"description": "`If-Match` is missing"},
    },
    openapi_extra=SAVED,
    summary="Save a draft",
)
async def save(
    request: Request,
    response: Response,
    found: OwnDraft,
    owner: Caller,
    who: Asker,
    here: Here,
    if_match: Annotated[
        str | None, Header(max_length=100, description="`ETag` of the version that was changed")
    ] = None,
    without: Annotated[
        list[Annotated[str, Query(max_length=255)]] | None,
        Query(max_length=64, description="files of before that are no longer part of it"),
    ] = None,
    title: Annotated[Line | None, Query(description="what it is called from now on")] = None,
    instead: Annotated[
        Line | None, Query(description="if it is called so still: what somebody called it otherwise stays")
    ] = None,
) -> DraftOut:
    """The next version: the upload, and files of the last one that are not sent anew. 412 where somebody else
    has saved it since the version that `If-Match` names, so that nothing is overwritten unseen."""
    if if_match is None:
        what = "If-Match: is missing; send the ETag of the version that you changed"
        raise RefusedError(428, Issue("service.draft", what, field="If-Match"))
    tags = [one.strip().removeprefix("W/") for one in if_match.split(",")]
    upload = await take_upload(request, here.storage, owner, here.limits)
    of = await anyio.to_thread.run_sync(here.drafts.owner, found)
    if of is not None and of != owner:  # whose files the versions of a draft are
        blobs = [upload.problem, *upload.files.values()]
        await anyio.to_thread.run_sync(here.storage.allow_of_other, of, blobs)
    row = await anyio.to_thread.run_sync(
        here.drafts.save, found, who, tags, upload, without or (), title, instead
    )
    return _told(row, response)


@router.patch(
    "/{draft}",
    responses=refusals(404, 413, 422),
    openapi_extra=described(Titled),
    summary="Call a draft otherwise",
)
async def rename(request: Request, response: Response, found: OwnDraft, here: Here) -> DraftOut:
    """``{"title": "Gewölbe 3"}``; it is no new version."""
    given = await read_body(request, Titled)
    return _told(await anyio.to_thread.run_sync(here.drafts.rename, found, given.title), response)


@router.post(
    "/{draft}/sent",
    responses=refusals(404, 413, 422),
    openapi_extra=described(Planned),
    summary="Note that a draft was sent",
)
async def sent(request: Request, response: Response, found: OwnDraft, who: Asker, here: Here) -> DraftOut:
    """``{"version": 3, "job": "24d8..."}``: so the draft is no unsent work any more, until it is changed."""
    given = await read_body(request, Planned)
    await anyio.to_thread.run_sync(job_of, given.job, who, here)
    row = await anyio.to_thread.run_sync(here.drafts.mark_sent, found, given.version, given.job)
    return _told(row, response)


@router.delete("/{draft}", responses=refusals(404), status_code=204, summary="Delete a draft")
def delete(found: OwnDraft, owner: Caller, here: Here) -> Response:
    """With all its versions."""
    here.drafts.delete(found, owner)
    return Response(status_code=204)


@router.get("/{draft}/versions/{number}", responses=refusals(404, 422), summary="A version of a draft")
def version(found: OwnDraft, number: Number, here: Here) -> DraftContent:
    """Its problem and files, by name, size and hash."""
    problem, files = here.drafts.version(found, number)
    told = [_file(name, blob) for name, blob in sorted(files.items())]
    return DraftContent(problem=_file("problem", problem), files=told)


@router.get(
    "/{draft}/versions/{number}/problem",
    responses={200: {"content": {BINARY: {"schema": {"type": "string"}}}}, **PARTS, **refusals(404, 422)},
    response_class=FileResponse,
    summary="The problem of a version",
)
def problem(request: Request, found: OwnDraft, number: Number, here: Here) -> Response:
    """As it was sent."""
    return _sent(request, here, here.drafts.version(found, number)[0])


@router.get(
    "/{draft}/versions/{number}/files/{name:path}",
    responses={200: {"content": {BINARY: {"schema": {"type": "string"}}}}, **PARTS, **refusals(404, 422)},
    response_class=FileResponse,
    summary="A file of a version",
)
def file(request: Request, found: OwnDraft, number: Number, name: str, here: Here) -> Response:
    """As it was sent."""
    blob = here.drafts.version(found, number)[1].get(name)
    if blob is None:
        what = f"version {number} of draft {found} has no file {name[:200]!r}; its list has their names"
        raise RefusedError(404, Issue("service.unknown_file", what, field="name"))
    return _sent(request, here, blob)


def _sent(request: Request, here: Here, blob: Blob) -> Response:
    headers = {"Cache-Control": "private, no-cache"}
    return stored_file(request, here.files.path(blob.sha), blob.sha, BINARY, headers)


def _told(row: RowMapping, response: Response | None = None) -> DraftOut:
    known: dict[str, Any] = {name: row[name] for name in ("id", "kind", "title", "version")}
    if response is not None:
        response.headers["ETag"] = tag_of(row)
    known |= {"created": utc(row["created"]), "changed": utc(row["changed"]), "by": row["made_by"]}
    known |= {"sent": row["sent"], "job": row["sent_as"]}
    return DraftOut(**known)


def _version(row: RowMapping) -> VersionOut:
    names = [one["name"] for one in json.loads(row["files"])]
    return VersionOut(number=row["number"], at=utc(row["at"]), by=row["who"], files=names)


def _file(name: str, blob: Blob) -> FileOut:
    return FileOut(name=name, size=blob.size, sha256=blob.sha, content_type=BINARY)
