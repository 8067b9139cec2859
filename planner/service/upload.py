"""Takes in what a user uploads: a problem and its files, into the content-addressed store, with all that is
wrong with the request told at once."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from typing import Any, BinaryIO, Final

import anyio.to_thread
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

from planner.issues import Issue
from planner.reading.strict_yaml import MAX_YAML_BYTES
from planner.service.security import MB, Limits, RefusedError, too_large
from planner.service.storage import DISK_FULL, Blob, Storage
from planner.service.uploaded_files import base_name

PLAIN: Final = ("application/json", "application/yaml", "application/x-yaml", "text/yaml")
"""Content types of a body that is the problem itself."""
MESHES: Final = (".obj", ".stl", ".ply")
"""Endings of files that are meshes, which have a limit of their own."""
FIELDS: Final = ("problem", "files")
"""Fields of a form that uploads a problem."""
LONGEST_NAME: Final = 255
"""Characters that the name of a file may have."""


@dataclasses.dataclass(frozen=True)
class Upload:
    """A stored problem file and the files that came with it, by the user's names."""

    problem: Blob
    files: Mapping[str, Blob]


async def take_upload(request: Request, storage: Storage, owner: str, limits: Limits) -> Upload:
    """The upload of a request: ``multipart/form-data`` with ``problem`` and ``files``, or the problem alone
    as JSON or YAML.

    Raises :class:`RefusedError`, 413, 422 or 507.
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind in PLAIN:
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_YAML_BYTES:
                raise too_large("the problem", MAX_YAML_BYTES / MB, "problem")
        (blob,) = await anyio.to_thread.run_sync(storage.put, owner, [io.BytesIO(body)])
        return Upload(blob, {})
    if kind != "multipart/form-data":
        what = f"got the content type {kind[:80]!r}; send multipart/form-data, or {', '.join(PLAIN)}"
        raise RefusedError(422, _fault("Content-Type", what))
    try:
        async with request.form(
            max_files=limits.files + 1, max_fields=len(FIELDS), max_part_size=MAX_YAML_BYTES
        ) as form:
            problem, uploads = _sorted(form, limits)
            return await anyio.to_thread.run_sync(_store, storage, owner, problem, uploads)
    except HTTPException as error:
        raise RefusedError(422, _fault("body", f"the form cannot be read: {error.detail}")) from error
    except ClientDisconnect as error:
        raise RefusedError(422, _fault("body", "the upload broke off; send it again")) from error
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        what = "the disk that uploads come in on is full; send it later, or ask who runs the service"
        raise RefusedError(507, Issue("service.storage", what, field="files")) from error
    except (ValueError, LookupError) as error:  # charsets that are none, and the like
        raise RefusedError(422, _fault("body", "the form cannot be read; send UTF-8")) from error


def _sorted(form: FormData, limits: Limits) -> tuple[UploadFile | str, dict[str, UploadFile]]:
    """The problem and the files; raises :class:`RefusedError` with every fault of the form."""
    faults = [
        _fault(name[:80], f"unknown field {name[:80]!r}; the fields are {', '.join(FIELDS)}")
        for name in dict.fromkeys(form)
        if name not in FIELDS
    ]
    problems, uploads = form.getlist("problem"), form.getlist("files")
    if len(problems) != 1:
        faults.append(_fault("problem", f"got {len(problems)} problems, one is wanted; add the problem file"))
    named: dict[str, UploadFile] = {}
    for number, one in enumerate(uploads):
        field = f"files.{number}"
        if isinstance(one, str):
            faults.append(_fault(field, "is text, a file with a name is wanted; send it as a file"))
            continue
        name = one.filename or ""
        if not base_name(name) or len(name) > LONGEST_NAME or not name.isprintable():
            what = f"the name {name[:80]!r} of {len(name)} characters is empty, has more than {LONGEST_NAME} "
            what += "or one that is not printable, or ends as a folder does; rename the file"
            faults.append(Issue("service.file_name", f"{field}: {what}", field=field))
        elif name in named:
            what = f"two files have the name {name[:80]!r}; rename one"
            faults.append(Issue("service.file_name", f"{field}: {what}", field=field))
        else:
            named[name] = one
            if name.lower().endswith(MESHES) and (one.size or 0) > limits.mesh_mb * MB:
                raise too_large(f"{name[:80]!r}", limits.mesh_mb, field)
    if faults:
        raise RefusedError(422, faults)
    return problems[0], named


def _store(
    storage: Storage, owner: str, problem: UploadFile | str, uploads: Mapping[str, UploadFile]
) -> Upload:
    stream: BinaryIO = io.BytesIO(problem.encode()) if isinstance(problem, str) else problem.file
    first, *others = storage.put(owner, [stream, *(one.file for one in uploads.values())])
    return Upload(first, dict(zip(uploads, others, strict=True)))


def _fault(field: str, what: str) -> Issue:
    return Issue("service.request", f"{field}: {what}", field=field)


def documented(problem: Mapping[str, Any]) -> dict[str, Any]:
    """The request body for OpenAPI; ``problem`` is the schema of problem files."""
    text = {"type": "string", "maxLength": MAX_YAML_BYTES, "description": "the same as YAML or JSON text"}
    form = {
        "type": "object",
        "required": ["problem"],
        "additionalProperties": False,
        "properties": {
            "problem": {"anyOf": [dict(problem), text]},
            "files": {
                "type": "array",
                "items": {"type": "string", "format": "binary"},
                "description": "the files that the problem names, each under the name that it uses; folders "
                "in names do not matter",
            },
        },
    }
    encoding = {"problem": {"contentType": "application/json"}}
    content: dict[str, Any] = {"multipart/form-data": {"schema": form, "encoding": encoding}}
    content["application/json"] = {"schema": dict(problem)}
    content["application/yaml"] = {"schema": dict(problem)}
    return {"required": True, "content": content}
