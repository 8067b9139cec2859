"""What HTTP asks of answers, whatever they tell (RFC 9110): HEAD, methods that an address takes, what a
browser has already, parts of files, compression; and how long the head of a request may take to come in.
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

HEAD_S: Final = 10.0
"""Time [s] in which the head of a request has to be there, from its first byte or from the connection on."""
HEAD: Final = "tandem.head"
"""Of a scope: whether its answer is sent without a body."""
COMPRESSED: Final = ("text/", "application/json", "application/yaml", "model/obj")
"""How content types begin that become smaller."""
LEAST_COMPRESSED: Final = 1024
"""Bytes of a file that is worth it."""
CHUNK_BYTES: Final = 1 << 18
"""Bytes that are compressed at once."""
GZIP: Final = 31
"""zlib's word for a window of 32 kB in gzip's format."""


class Heads:
    """Answers HEAD at every address that answers GET, by the same head without a body."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        asked = {**scope, "method": "GET", HEAD: True}

        async def headless(message: Message) -> None:
            if message["type"] == "http.response.start":
                if "route" in asked:  # for who counts
                    scope["route"] = asked["route"]
                await send(message)
                await send({"type": "http.response.body", "body": b""})  # what streams is told to end

        await self._app(asked, receive, headless)


def allowed(routes: list[BaseRoute], scope: Scope) -> str:
    """The methods that an address takes, for ``Allow``; empty where there is no such address."""
    found: set[str] = set()
    for route in routes:
        if route.matches(scope)[0] is not Match.NONE:
            found |= set(getattr(route, "methods", None) or ())
    return ", ".join(sorted(found | {"HEAD"} if "GET" in found else found))


def is_known(request: Request, tag: str) -> bool:
    """Whether who asks has the content of that ``ETag`` (section 13.1.2: compared weakly)."""
    given = request.headers.get("if-none-match", "")
    tags = [one.strip().removeprefix("W/") for one in given.split(",")]
    return "*" in tags or tag in tags


def tagged(request: Request, content: BaseModel) -> Response:
    """JSON that is asked for again and again, without what is not there: 304 for who has it as it is."""
    body = content.model_dump_json(exclude_none=True, by_alias=True).encode()
    tag = f'"{hashlib.sha256(body).hexdigest()}"'
    headers = {"ETag": tag, "Cache-Control": "private, no-cache"}
    if is_known(request, tag):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type="application/json", headers=headers)


def packed(request: Request, content: BaseModel) -> Response:
    """JSON that is made once and large, without what is not there, compressed for who takes that."""
    body = content.model_dump_json(exclude_none=True, by_alias=True).encode()
    headers = {"Cache-Control": "no-store", "Vary": "Accept-Encoding"}
    if _takes_gzip(request):
        headers["Content-Encoding"] = "gzip"
        body = gzip.compress(body, 4)
    return Response(body, media_type="application/json", headers=headers)


def stored_file(
    request: Request, path: Path, sha: str, kind: str, headers: Mapping[str, str], filename: str | None = None
) -> Response:
    """A file that never changes, by the hash of its content: 304 for who has it, compressed for who takes
    that, parts for who asks for those."""
    packed = _is_packed(request, path, kind)
    tag = f'"{sha}-gzip"' if packed else f'"{sha}"'
    more = {**headers, "ETag": tag, "Vary": "Accept-Encoding"}
    if is_known(request, tag):
        return Response(status_code=304, headers=more)
    if not packed:
        return FileResponse(path, media_type=kind, filename=filename, headers=more)
    named = FileResponse(path, filename=filename).headers.get("content-disposition")
    more |= {"Content-Encoding": "gzip", **({"Content-Disposition": named} if named else {})}
    return StreamingResponse(_gzip(path), media_type=kind, headers=more)


def _is_packed(request: Request, path: Path, kind: str) -> bool:
    if not _takes_gzip(request) or "range" in request.headers or not kind.startswith(COMPRESSED):
        return False
    return path.stat().st_size >= LEAST_COMPRESSED


def _takes_gzip(request: Request) -> bool:
    asked = [one.replace(" ", "").lower() for one in request.headers.get("accept-encoding", "").split(",")]
    return any(one.split(";")[0] == "gzip" and not one.endswith(("q=0", "q=0.0")) for one in asked)


def _gzip(path: Path) -> Iterator[bytes]:
    packer = zlib.compressobj(wbits=GZIP)
    with path.open("rb") as stream:
        while chunk := stream.read(CHUNK_BYTES):
            yield packer.compress(chunk)
    yield packer.flush()


class MadeFile(FileResponse):
    """An answer that was made for one request, whole or in parts: its file goes when it is sent."""

    def __init__(
        self, content: bytes, folder: Path, media_type: str, filename: str | None, headers: Mapping[str, str]
    ) -> None:
        handle, name = tempfile.mkstemp(dir=folder)
        try:
            with os.fdopen(handle, "wb") as out:
                out.write(content)
            super().__init__(name, media_type=media_type, filename=filename, headers=headers)
        except BaseException:
            Path(name).unlink()
            raise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            Path(self.path).unlink(missing_ok=True)


class Hurried(H11Protocol):
    """Cuts connections off whose requests have no whole head within `HEAD_S`: they would stay for ever."""

    _waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """asyncio."""
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        """asyncio."""
        super().data_received(data)
        if self._at_work():
            self._stop_waiting()
        else:
            self._wait()

    def on_response_complete(self) -> None:
        """What follows may be here in part."""
        super().on_response_complete()
        if not self._at_work() and self.conn.trailing_data[0]:
            self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """asyncio."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _at_work(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _wait(self) -> None:
        if self._waiting is None:
            self._waiting = self.loop.call_later(HEAD_S, self._cut)

    def _stop_waiting(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _cut(self) -> None:
        self._waiting = None
        if not self._at_work() and not self.transport.is_closing():
            self.transport.close()
