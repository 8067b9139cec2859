"""The service's log, for machines: a JSON object a line, on standard output.

Each request has an identifier, that of its header ``X-Request-Id`` where a proxy or a client gave one, which
goes back with the answer and stands in all lines about it, with the jobs that it was about. Lines have no
queries, tokens, or places on the server's disk, also where an error's own text has them.
"""

import dataclasses
import datetime as dt
import json
import logging
import re
import secrets
import sys
import time
import traceback
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any, Final, Literal

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

Kind = Literal["text", "json"]
"""How the log is written."""
HEADER: Final = "X-Request-Id"
"""Name of the header."""
LOG: Final = logging.getLogger("planner.service.requests")
"""One line for each request, when it is answered."""
FIELDS: Final = ("method", "path", "status", "seconds", "client")
"""What a record may tell besides its message."""
MOST_JOBS: Final = 100
"""Jobs that one line names."""
LONGEST: Final = 2000
"""Characters of a message, or of a field."""
DEEPEST: Final = 30
"""Frames of a trace, the innermost ones."""
_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,127}")
"""An identifier that is taken over."""
_TOKEN: Final = re.compile(r"tandem_[0-9a-f]{16}_[A-Za-z0-9_-]*")
"""A token, or the begin of one."""
_PASSWORD: Final = re.compile(r"://[^\s/@]*@")
"""User and password in a URL."""
_OPTION: Final = re.compile(r"(password\s*=\s*)(?:'(?:[^'\\]|\\.)*'?|[^\s&]+)", re.IGNORECASE)
"""A password as an option of a URL, or of a connection of PostgreSQL (libpq, 34.1.1: quoted or not)."""
_PLACE: Final = re.compile(r"(?<![\w:/.)])/(?:[^\s/'\"`,;()\[\]]+/)+[^\s/'\"`,;()\[\]]*")
"""A place on the disk: a path of two names at least from its root on."""


@dataclasses.dataclass
class _Request:
    """A request that is being answered, and the jobs that it was about so far."""

    id: str
    jobs: dict[str, None] = dataclasses.field(default_factory=dict)


_REQUEST: Final[ContextVar[_Request | None]] = ContextVar("tandem_request", default=None)


def about(*jobs: str) -> None:
    """Say which jobs the present request is about, if there is one; threads that it began may, too."""
    request = _REQUEST.get()
    if request is None:
        return
    for job in jobs:
        if len(request.jobs) >= MOST_JOBS:
            return
        request.jobs[job] = None


def identifier(given: list[str]) -> str:
    """The one that was given, if it is a single one of up to 128 letters, digits and ``. _ : -``, and no
    token; else a new one."""
    if len(given) == 1 and _ID.fullmatch(given[0]) and not _TOKEN.search(given[0]):
        return given[0]
    return secrets.token_hex(16)


class Logged:
    """Wraps the application: gives each request its identifier, and logs it when it is answered."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = _Request(identifier(Headers(scope=scope).getlist(HEADER)))
        scope.setdefault("state", {})["request_id"] = request.id
        began, status = time.monotonic(), 0
        before = _REQUEST.set(request)

        async def told(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[HEADER] = request.id
            await send(message)

        try:
            await self._app(scope, receive, told)
        except Exception:
            status = status or 500  # the framework answers
            raise
        finally:
            client = scope.get("client")
            more = {"method": scope["method"], "path": scope["path"], "status": status or None}
            more |= {"seconds": round(time.monotonic() - began, 4), "client": client[0] if client else None}
            LOG.info("%s %s", scope["method"][:20], status or "was not answered", extra=more)
            _REQUEST.reset(before)


class JsonLines(logging.Formatter):
    """A record as a line of JSON. ``hidden``: texts that are not told, with what stands in their place."""

    def __init__(self, hidden: Mapping[str, str]) -> None:
        super().__init__()
        self._hidden = hidden

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        at = dt.datetime.fromtimestamp(record.created, dt.UTC).isoformat(timespec="milliseconds")
        more = {name: getattr(record, name) for name in FIELDS if hasattr(record, name)}
        # of our own lines about requests, the message has addresses of the service; others have no such
        message = self._without(record.getMessage(), places="path" not in more)
        line: dict[str, Any] = {
            "time": at.replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": message,
        }
        request = _REQUEST.get()
        said = getattr(record, "request", None) or (request.id if request else None)
        jobs = [*getattr(record, "jobs", ()), *(request.jobs if request else ())][:MOST_JOBS]
        line |= {"request": said} if said else {}
        line |= {"jobs": jobs} if jobs else {}
        line |= {k: self._without(v, places=False) if isinstance(v, str) else v for k, v in more.items()}
        if record.exc_info and record.exc_info[1] is not None:
            line["errors"] = list(self._errors(record.exc_info[1]))
        return json.dumps(line)

    def _errors(self, error: BaseException | None) -> Iterator[dict[str, Any]]:
        """An error and what it came from, by module, function and line."""
        known: set[int] = set()
        while error is not None and id(error) not in known:
            known.add(id(error))
            frames = list(traceback.walk_tb(error.__traceback__))[-DEEPEST:]
            trace = [f"{f.f_globals.get('__name__')}:{f.f_code.co_name}:{line}" for f, line in frames]
            message = self._without(str(error), places=True)
            yield {"type": type(error).__name__, "message": message, "trace": trace}
            error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)

    def _without(self, text: str, places: bool) -> str:
        for what, instead in self._hidden.items():
            text = text.replace(what, instead)
        text = _OPTION.sub(r"\1(password)", _PASSWORD.sub("://", _TOKEN.sub("(token)", text)))
        if places:
            text = _PLACE.sub("(path)", text)
        return text[:LONGEST]


def write_json(data: Path, stream: IO[str] | None = None) -> None:
    """Let all lines of the log be JSON from now on; ``data`` is the service's folder, which is not told."""
    handler = logging.StreamHandler(stream or sys.stdout)
    hidden = {str(data.resolve()): "(data)", str(data.absolute()): "(data)"}
    handler.setFormatter(JsonLines(hidden))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    for name in ("planner.service", "uvicorn"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(logging.INFO)
