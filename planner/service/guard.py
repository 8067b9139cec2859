"""What stands before every request: the size of its body, where it comes from, and what browsers may do with
the answer."""

from __future__ import annotations

import json
from collections.abc import MutableMapping
from typing import Any, Final
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planner.issues import Issue
from planner.service.refusals import RefusedError, too_large

SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS"})
LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})
FORWARDED: Final = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip")
MB: Final = 1_000_000
HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """Wraps the application. ``open_hosts``: the names by which an instance without tokens may be addressed;
    None where tokens are required."""

    def __init__(self, app: ASGIApp, upload_mb: float, open_hosts: frozenset[str] | None) -> None:
        self._app, self._limit_mb, self._open_hosts = app, upload_mb, open_hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def hardened(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        try:
            headers = Headers(scope=scope)
            self._check_origin(scope, headers)
            await self._app(scope, self._counted(headers, receive), hardened)
        except RefusedError as refused:
            await _answer(refused, hardened)

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        host = headers.get("host", "")
        if self._open_hosts is not None:
            if _name(host) not in self._open_hosts:
                raise _foreign(f"the host is {host[:80]!r}; without tokens only this machine may ask")
            if any(name in headers for name in FORWARDED):
                raise _foreign("a proxy passed this on; start the service with --require-token behind one")
        if scope["method"] not in SAFE:
            origin = headers.get("origin")
            if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") or (
                origin is not None and _place(origin) != host.lower()
            ):
                raise _foreign("another site sent this request through a browser; use the service's own page")

    def _counted(self, headers: Headers, receive: Receive) -> Receive:
        """The body, refused when it is longer than may be: at once if it says so, else as soon as it is."""
        allowed = int(self._limit_mb * MB)
        said = headers.get("content-length", "0")
        if said.isdecimal() and int(said[:20]) > allowed:
            raise too_large("the upload", self._limit_mb)
        got = 0

        async def counted() -> MutableMapping[str, Any]:
            nonlocal got
            message = await receive()
            got += len(message.get("body", b""))
            if got > allowed:
                raise too_large("the upload", self._limit_mb)
            return message

        return counted


def _place(origin: str) -> str:
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


def _name(host: str) -> str:
    """The host without its port."""
    if host.startswith("["):
        return host[1:].split("]")[0].lower()
    return host.rsplit(":", 1)[0].lower() if host.count(":") == 1 else host.lower()


def _foreign(why: str) -> RefusedError:
    return RefusedError(403, Issue("service.foreign", why))


async def _answer(refused: RefusedError, send: Send) -> None:
    """Send a refusal that no handler of the application saw."""
    body = json.dumps(refused.body).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
    headers += [(name.lower().encode(), value.encode()) for name, value in refused.headers.items()]
    headers.append((b"connection", b"close"))  # the rest of the body is not read
    await send({"type": "http.response.start", "status": refused.status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
