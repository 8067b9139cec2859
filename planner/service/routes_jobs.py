"""Jobs over HTTP."""

from __future__ import annotations

import io
import zipfile
from pathlib import PurePosixPath
from typing import Annotated, Final

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import FileResponse, StreamingResponse

from planner.issues import Issue, has_errors
from planner.service.context import REFUSALS, Caller, Here, OwnJob
from planner.service.events import Stream
from planner.service.files import Blob
from planner.service.models import OPEN, CheckOut, FileList, FileOut, JobList, JobOut, State
from planner.service.refusals import RefusedError
from planner.service.upload import documented, take

router: Final = APIRouter(prefix="/v1", tags=["jobs"], responses=REFUSALS)  # type: ignore[arg-type]
UPLOADS: Final = {"requestBody": documented({"$ref": "#/components/schemas/ProblemFile"})}
TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".obj": "model/obj",
    ".npz": "application/octet-stream",
    ".yaml": "application/yaml",
    **dict.fromkeys((".mod", ".modx", ".pgf", ".src", ".dat"), "text/plain; charset=utf-8"),
}
SANDBOX: Final = "sandbox allow-scripts allow-downloads allow-popups; frame-ancestors 'self'"
"""What is in a report came from a user: it runs apart from this site, without its cookies."""
PAGE: Final = 50
EVENT: Final = {
    "type": "object",
    "description": "one event of the stream",
    "properties": {
        "id": {"type": "string"},
        "event": {"enum": ["state", "progress", "issues", "end"]},
        "data": {"type": "string", "description": "JSON"},
    },
}


@router.post(
    "/jobs",
    status_code=201,
    response_model_exclude_none=True,
    openapi_extra=UPLOADS,
    summary="Plan a problem",
)
async def create(
    request: Request,
    owner: Caller,
    here: Here,
    timeout_s: Annotated[
        float | None,
        Query(gt=0, le=1e6, description="stop planning after so long; the service has a limit too"),
    ] = None,
    memory_mb: Annotated[
        float | None, Query(gt=0, le=1e6, description="stop planning at so much memory; likewise")
    ] = None,
) -> JobOut:
    """Upload a problem with its files. An identical problem that was planned before has its answer at
    once."""
    upload = await take(request, here.storage, owner, here.limits)
    return await here.in_turn(
        request, owner, lambda reading: here.create(owner, upload, timeout_s, memory_mb, reading)
    )


@router.post(
    "/check", response_model_exclude_none=True, openapi_extra=UPLOADS, summary="Validate without planning"
)
async def check(
    request: Request,
    owner: Caller,
    here: Here,
    reach: Annotated[bool, Query(description="make the targets and test their reach too")] = False,
) -> CheckOut:
    """Read a problem and say what is in its way; a file that cannot be read is 422."""
    upload = await take(request, here.storage, owner, here.limits)
    read = await here.in_turn(request, owner, lambda reading: here.examine(upload, reach, reading=reading))
    return CheckOut(
        ok=not has_errors(read.issues),
        name=read.name,
        digest=read.digest,
        processes=list(read.processes),
        summary=dict(read.summary),
        issues=list(read.issues),
    )


@router.get("/jobs", response_model_exclude_none=True, summary="List your jobs")
def page(
    owner: Caller,
    here: Here,
    limit: Annotated[int, Query(ge=1, le=200)] = PAGE,
    cursor: Annotated[
        str | None,
        Query(pattern=r"^[0-9]{1,12}\.[0-9]{1,9}-[0-9a-f]{32}$", description="`next` of the page before"),
    ] = None,
    state: Annotated[list[State] | None, Query(description="these states alone")] = None,
) -> JobList:
    """The newest first, a page at a time."""
    found, following = here.jobs.page(owner, state or [], cursor, limit)
    return JobList(jobs=found, next=following)


@router.get("/jobs/{job}", response_model_exclude_none=True, summary="State of a job")
def get(found: OwnJob) -> JobOut:
    """State, stage, issues, figures."""
    return found


@router.get(
    "/jobs/{job}/events",
    summary="Events of a job as they happen",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/event-stream": {"schema": EVENT}}}},
)
def events(
    found: OwnJob,
    owner: Caller,
    here: Here,
    last_event_id: Annotated[str | None, Header()] = None,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="events up to this number are known")] = 0,
) -> StreamingResponse:
    """Server-sent events from the first on, or after ``Last-Event-ID``: ``state`` {state}, ``progress``
    {stage, fraction}, ``issues`` {issues; with ``all`` they are the whole list}, ``end`` when no more will
    come."""
    if last_event_id is not None and last_event_id.isdecimal() and len(last_event_id) < 10:
        after = int(last_event_id)
    return Stream(here.hub, owner, found.id, after)


@router.post("/jobs/{job}/cancel", response_model_exclude_none=True, summary="Cancel a job")
def cancel(found: OwnJob, here: Here) -> JobOut:
    """A job that waits is cancelled at once; one that runs has its worker stopped within a second or two.
    One that has ended stays as it is."""
    return here.jobs.cancel(found.id)


@router.delete("/jobs/{job}", status_code=204, summary="Delete a job")
def delete(found: OwnJob, here: Here) -> Response:
    """Delete a job with its files; one that runs is cancelled."""
    here.jobs.cancel(found.id, also_delete=True)
    return Response(status_code=204)


@router.get("/jobs/{job}/files", summary="Files of a job")
def files(found: OwnJob, here: Here) -> FileList:
    """Its problem (``problem/...``), and its results when it has ended."""
    known = here.jobs.files(found.id)
    return FileList(files=[file_out(name, blob) for name, blob in sorted(known.items())])


@router.get(
    "/jobs/{job}/files/{name:path}",
    summary="A file of a job",
    response_class=FileResponse,
    responses={200: {"content": {"application/octet-stream": {"schema": {"type": "string"}}}}},
)
def file(
    found: OwnJob,
    name: str,
    here: Here,
    download: Annotated[bool, Query(description="for saving, not for showing")] = False,
) -> FileResponse:
    """The file of that name in the list of files."""
    blob = here.jobs.files(found.id).get(name)
    if blob is None:
        what = f"job {found.id} has no file {name[:200]!r}; list its files"
        raise RefusedError(404, Issue("service.unknown_file", what, field="name"))
    headers = {"ETag": f'"{blob.sha}"', "Cache-Control": "private, max-age=3600"}
    if name.endswith(".html"):
        headers["Content-Security-Policy"] = SANDBOX
    return FileResponse(
        here.files.path(blob.sha),
        media_type=content_type(name),
        filename=PurePosixPath(name).name if download else None,
        headers=headers,
    )


@router.get(
    "/jobs/{job}/programs.zip",
    summary="The programs of a job",
    response_class=Response,
    responses={200: {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}}},
)
def programs(found: OwnJob, here: Here) -> Response:
    """All programs in one archive; they are there if the proof holds."""
    known = {n: blob for n, blob in here.jobs.files(found.id).items() if n.startswith("programs/")}
    if not known:
        waiting = found.state in OPEN
        what = f"job {found.id} has no programs: it is {found.state}; "
        what += "ask again when it has ended" if waiting else f"its issues say why: GET /v1/jobs/{found.id}"
        raise RefusedError(404, Issue("service.unknown_file", what))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, blob in sorted(known.items()):
            info = zipfile.ZipInfo(name.removeprefix("programs/"))
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, here.files.read(blob.sha))
    headers = {"Content-Disposition": f'attachment; filename="{found.name}.zip"'}
    return Response(packed.getvalue(), media_type="application/zip", headers=headers)


def file_out(name: str, blob: Blob) -> FileOut:
    """A file as the list has it."""
    return FileOut(name=name, size=blob.size, sha256=blob.sha, content_type=content_type(name))


def content_type(name: str) -> str:
    """By the name; what people uploaded is never shown as anything."""
    if name.startswith("problem/files/"):
        return "application/octet-stream"
    return TYPES.get(PurePosixPath(name).suffix.lower(), "application/octet-stream")
