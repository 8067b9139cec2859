"""Log of the service as JSON lines on standard output.

Each request has an identifier: that of its header ``X-Request-Id`` if a proxy or client sent one. It is
returned with the answer and appears in all lines about the request, together with the ids of its jobs.
Lines contain no query strings, tokens or paths of the server, not even in the texts of errors.
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
"""Format of the log."""
HEADER: Final = "X-Request-Id"
"""Name of the header with the request identifier."""
LOG: Final = logging.getLogger("planner.service.requests")
"""Logger with one line for each answered request."""
EXTRA_FIELDS: Final = ("method", "path", "status", "seconds", "client")
"""Extra fields of a log record."""
MAX_JOBS: Final = 100
"""Maximum number of job ids in one line."""
MAX_TEXT_LENGTH: Final = 2000
"""Maximum number of characters of a message or field."""
MAX_FRAMES: Final = 30
"""Maximum number of frames of a traceback, counted from the innermost."""
_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,127}")
"""An identifier that is accepted from the header."""
_TOKEN: Final = re.compile(r"tandem_[0-9a-f]{16}_[A-Za-z0-9_-]*")
"""An API token, or the beginning of one."""
_PASSWORD: Final = re.compile(r"://[^\s/@]*@")
"""User and password in a URL."""
_PASSWORD_OPTION: Final = re.compile(r"(password\s*=\s*)(?:'(?:[^'\\]|\\.)*'?|[^\s&]+)", re.IGNORECASE)
"""A password as an option of a URL or of a PostgreSQL connection (libpq, 34.1.1: quoted or not)."""
_PATH: Final = re.compile(r"(?<![\w:/.)])/(?:[^\s/'\"`,;()\[\]]+/)+[^\s/'\"`,;()\[\]]*")
"""An absolute path with at least two components."""


@dataclasses.dataclass
class _LoggedRequest:
    """A request in progress, and the jobs that it has concerned so far."""

    id: str
    jobs: dict[str, None] = dataclasses.field(default_factory=dict)


_REQUEST: Final[ContextVar[_LoggedRequest | None]] = ContextVar("tandem_request", default=None)


def record_jobs(*jobs: str) -> None:
    """Record which jobs the present request concerns, if there is one.

    Threads of the request may call it, too.
    """
    request = _REQUEST.get()
    if request is None:
        return
    for job in jobs:
        if len(request.jobs) >= MAX_JOBS:
            return
        request.jobs[job] = None


def identifier(given: list[str]) -> str:
    """Return the given request identifier if it is valid, else a new one.

    Valid is a single value of up to 128 letters, digits and ``. _ : -`` that is not a token.

    Args:
        given: Values of the header.
    """
    if len(given) == 1 and _ID.fullmatch(given[0]) and not _TOKEN.search(given[0]):
        return given[0]
    return secrets.token_hex(16)


class RequestLogMiddleware:
    """ASGI middleware that gives each request an identifier and logs it when it is answered."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request and log its answer. Other connections are passed on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = _LoggedRequest(identifier(Headers(scope=scope).getlist(HEADER)))
        scope.setdefault("state", {})["request_id"] = request.id
        started, status = time.monotonic(), 0
        token = _REQUEST.set(request)

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[HEADER] = request.id
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            status = status or 500  # the framework sends the answer
            raise
        finally:
            client = scope.get("client")
            fields = {"method": scope["method"], "path": scope["path"], "status": status or None}
            fields |= {
                "seconds": round(time.monotonic() - started, 4),
                "client": client[0] if client else None,
            }
            LOG.info("%s %s", scope["method"][:20], status or "was not answered", extra=fields)
            _REQUEST.reset(token)


class JsonLinesFormatter(logging.Formatter):
    """Log formatter that writes one line of JSON.

    Args:
        hidden: Texts that must not appear, with their replacements.
    """

    def __init__(self, hidden: Mapping[str, str]) -> None:
        super().__init__()
        self._hidden = hidden

    def format(self, record: logging.LogRecord) -> str:
        """Return the line without its end."""
        timestamp = dt.datetime.fromtimestamp(record.created, dt.UTC).isoformat(timespec="milliseconds")
        fields = {name: getattr(record, name) for name in EXTRA_FIELDS if hasattr(record, name)}
        # Messages of request lines contain addresses of the service, which look like paths of a disk.
        message = self._redact(record.getMessage(), hide_paths="path" not in fields)
        line: dict[str, Any] = {
            "time": timestamp.replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": message,
        }
        request = _REQUEST.get()
        request_id = getattr(record, "request", None) or (request.id if request else None)
        jobs = [*getattr(record, "jobs", ()), *(request.jobs if request else ())][:MAX_JOBS]
        line |= {"request": request_id} if request_id else {}
        line |= {"jobs": jobs} if jobs else {}
        line |= {
            name: self._redact(value, hide_paths=False) if isinstance(value, str) else value
            for name, value in fields.items()
        }
        if record.exc_info and record.exc_info[1] is not None:
            line["errors"] = list(self._errors(record.exc_info[1]))
        return json.dumps(line)

    def _errors(self, error: BaseException | None) -> Iterator[dict[str, Any]]:
        """Yield an error and its causes, with tracebacks of module, function and line."""
        seen: set[int] = set()
        while error is not None and id(error) not in seen:
            seen.add(id(error))
            frames = list(traceback.walk_tb(error.__traceback__))[-MAX_FRAMES:]
            trace = [
                f"{frame.f_globals.get('__name__')}:{frame.f_code.co_name}:{line}" for frame, line in frames
            ]
            message = self._redact(str(error), hide_paths=True)
            yield {"type": type(error).__name__, "message": message, "trace": trace}
            error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)

    def _redact(self, text: str, hide_paths: bool) -> str:
        """Replace hidden texts, tokens, passwords and, if requested, absolute paths. Shorten long texts."""
        for secret, replacement in self._hidden.items():
            text = text.replace(secret, replacement)
        text = _PASSWORD_OPTION.sub(r"\1(password)", _PASSWORD.sub("://", _TOKEN.sub("(token)", text)))
        if hide_paths:
            text = _PATH.sub("(path)", text)
        return text[:MAX_TEXT_LENGTH]


def write_json(data: Path, stream: IO[str] | None = None) -> None:
    """Write all log lines as JSON from now on.

    Args:
        data: Data folder of the service, which is hidden in the log.
        stream: Output, standard output by default.
    """
    handler = logging.StreamHandler(stream or sys.stdout)
    hidden = {str(data.resolve()): "(data)", str(data.absolute()): "(data)"}
    handler.setFormatter(JsonLinesFormatter(hidden))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
    for name in ("planner.service", "uvicorn"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(logging.INFO)
