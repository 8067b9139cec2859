"""HTTP semantics that do not depend on the content (RFC 9110): HEAD, Allow, ETags, ranges and compression.

The module also limits the time in which the head of a request may arrive.
"""

import asyncio
import gzip
import hashlib
import os
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from fastapi.responses import FileResponse, StreamingResponse
from pydantic import BaseModel
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_TIMEOUT_S: Final = 10.0
"""Maximum time [s] until a request head is complete.

It counts from the start of the connection, or from the first byte of a further request.
"""
HEAD_REQUEST_KEY: Final = "tandem.head"
"""Key of an ASGI scope whose answer is sent without a body."""
COMPRESSIBLE_TYPES: Final = ("text/", "application/json", "application/yaml", "model/obj")
"""Prefixes of the content types that are compressed."""
MIN_COMPRESSED_BYTES: Final = 1024
"""Minimum size [bytes] of a file that is compressed."""
CHUNK_BYTES: Final = 1 << 18
"""Bytes that are read and compressed at a time."""
GZIP_WBITS: Final = 31
"""``wbits`` of zlib for a window of 32 kB in gzip format."""


class HeadMiddleware:
    """ASGI middleware that answers HEAD wherever GET is answered, with the same head and no body."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request; a HEAD request is passed on as GET and answered without a body."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        get_scope = {**scope, "method": "GET", HEAD_REQUEST_KEY: True}

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                if "route" in get_scope:  # for metrics
                    scope["route"] = get_scope["route"]
                await send(message)
                await send({"type": "http.response.body", "body": b""})  # ends streamed answers

        await self._app(get_scope, receive, send_head)


def allowed_methods(routes: list[BaseRoute], scope: Scope) -> str:
    """List the methods of an address, for the header ``Allow``.

    Args:
        routes: All routes of the application.
        scope: ASGI scope of the request.

    Returns:
        Method names, separated by commas. Empty if no route matches.
    """
    methods: set[str] = set()
    for route in routes:
        if route.matches(scope)[0] is not Match.NONE:
            methods |= set(getattr(route, "methods", None) or ())
    return ", ".join(sorted(methods | {"HEAD"} if "GET" in methods else methods))


def is_not_modified(request: Request, tag: str) -> bool:
    """Report whether the client already has the content of an ``ETag``.

    The comparison is weak (RFC 9110, section 13.1.2).

    Args:
        request: Request with the header ``If-None-Match``, if any.
        tag: Entity tag of the content, in quotes.
    """
    header = request.headers.get("if-none-match", "")
    tags = [value.strip().removeprefix("W/") for value in header.split(",")]
    return "*" in tags or tag in tags


def conditional_json(request: Request, content: BaseModel) -> Response:
    """Answer with JSON that clients poll: 304 if the content has not changed.

    Args:
        request: Request with the header ``If-None-Match``, if any.
        content: Model to send. Fields that are None are omitted.
    """
    body = content.model_dump_json(exclude_none=True, by_alias=True).encode()
    tag = f'"{hashlib.sha256(body).hexdigest()}"'
    headers = {"ETag": tag, "Cache-Control": "private, no-cache"}
    if is_not_modified(request, tag):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type="application/json", headers=headers)


def gzipped_json(request: Request, content: BaseModel) -> Response:
    """Answer with large JSON that is sent once, compressed if the client accepts gzip.

    Args:
        request: Request with the header ``Accept-Encoding``, if any.
        content: Model to send. Fields that are None are omitted.
    """
    body = content.model_dump_json(exclude_none=True, by_alias=True).encode()
    headers = {"Cache-Control": "no-store", "Vary": "Accept-Encoding"}
    if _accepts_gzip(request):
        headers["Content-Encoding"] = "gzip"
        body = gzip.compress(body, 4)
    return Response(body, media_type="application/json", headers=headers)


def stored_file_response(
    request: Request,
    path: Path,
    sha: str,
    media_type: str,
    headers: Mapping[str, str],
    filename: str | None = None,
) -> Response:
    """Answer with an immutable stored file: whole, compressed, in parts, or 304 if unchanged.

    Args:
        request: Request.
        path: Path of the stored file.
        sha: SHA-256 of its content, which becomes the ``ETag``.
        media_type: Content type.
        headers: Further headers.
        filename: Name under which a browser saves the file, or None to show it.
    """
    compress = _should_compress(request, path, media_type)
    tag = f'"{sha}-gzip"' if compress else f'"{sha}"'
    response_headers = {**headers, "ETag": tag, "Vary": "Accept-Encoding"}
    if is_not_modified(request, tag):
        return Response(status_code=304, headers=response_headers)
    if not compress:
        return FileResponse(path, media_type=media_type, filename=filename, headers=response_headers)
    disposition = FileResponse(path, filename=filename).headers.get("content-disposition")
    response_headers |= {
        "Content-Encoding": "gzip",
        **({"Content-Disposition": disposition} if disposition else {}),
    }
    return StreamingResponse(_gzip(path), media_type=media_type, headers=response_headers)


def _should_compress(request: Request, path: Path, media_type: str) -> bool:
    """Report whether a file is sent compressed. Range requests refer to the uncompressed file."""
    if (
        not _accepts_gzip(request)
        or "range" in request.headers
        or not media_type.startswith(COMPRESSIBLE_TYPES)
    ):
        return False
    return path.stat().st_size >= MIN_COMPRESSED_BYTES


def _accepts_gzip(request: Request) -> bool:
    """Report whether the header ``Accept-Encoding`` lists gzip with a weight other than 0."""
    encodings = [
        encoding.replace(" ", "").lower()
        for encoding in request.headers.get("accept-encoding", "").split(",")
    ]
    return any(
        encoding.split(";")[0] == "gzip" and not encoding.endswith(("q=0", "q=0.0")) for encoding in encodings
    )


def _gzip(path: Path) -> Iterator[bytes]:
    compressor = zlib.compressobj(wbits=GZIP_WBITS)
    with path.open("rb") as stream:
        while chunk := stream.read(CHUNK_BYTES):
            yield compressor.compress(chunk)
    yield compressor.flush()


class TemporaryFileResponse(FileResponse):
    """Answer whose content was generated for one request.

    Supports ranges; its temporary file is removed once sent.
    """

    def __init__(
        self, content: bytes, folder: Path, media_type: str, filename: str | None, headers: Mapping[str, str]
    ) -> None:
        handle, path = tempfile.mkstemp(dir=folder)
        try:
            with os.fdopen(handle, "wb") as out:
                out.write(content)
            super().__init__(path, media_type=media_type, filename=filename, headers=headers)
        except BaseException:
            Path(path).unlink()
            raise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, then delete it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            Path(self.path).unlink(missing_ok=True)


class HeaderTimeoutProtocol(H11Protocol):
    """HTTP protocol that closes connections without a complete request head within `HEADER_TIMEOUT_S`.

    Without this limit they would stay open for ever.
    """

    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer (asyncio callback)."""
        super().connection_made(transport)
        self._start_head_timer()

    def data_received(self, data: bytes) -> None:
        """Stop the timer once a request is being answered (asyncio callback)."""
        super().data_received(data)
        if self._is_answering():
            self._stop_head_timer()
        else:
            self._start_head_timer()

    def on_response_complete(self) -> None:
        """Start the timer if a part of the next request has already arrived."""
        super().on_response_complete()
        if not self._is_answering() and self.conn.trailing_data[0]:
            self._start_head_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timer (asyncio callback)."""
        self._stop_head_timer()
        super().connection_lost(exc)

    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _start_head_timer(self) -> None:
        if self._head_timer is None:
            self._head_timer = self.loop.call_later(HEADER_TIMEOUT_S, self._on_head_timeout)

    def _stop_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _on_head_timeout(self) -> None:
        self._head_timer = None
        if not self._is_answering() and not self.transport.is_closing():
            self.transport.close()
