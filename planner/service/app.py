"""The application and its server: routes, refusals, the life of the service, options and log."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import resource
import signal
import ssl
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, Final

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import planner
from planner.batch.cluster import Cluster
from planner.batch.workers import Workers
from planner.issues import Issue, TandemError
from planner.service import routes
from planner.service.page import routes as page_routes
from planner.service.routes import REFUSALS, REQUESTS
from planner.service.runner import Team
from planner.service.security import LOOPBACK, Guard, RefusedError
from planner.service.service import Options, Service

LOG: Final = logging.getLogger("planner.service")
"""Log of the service."""
ABOUT: Final = """Plans the motion of two industrial robots that share one job. Problems go in as files,
programs come out if they are proven. Every refusal has `issues`, each with a `code` and the `field`."""
"""What the description of the interface begins with."""


def create_app(service: Service) -> FastAPI:
    """The application over a service, which starts and ends with it."""

    @contextlib.asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        del app
        service.start()
        news = asyncio.create_task(service.hub.run())
        try:
            yield
        finally:
            news.cancel()
            await asyncio.to_thread(service.close)

    app = FastAPI(
        title="Tandem",
        version=planner.__version__,
        description=ABOUT,
        lifespan=life,
        docs_url=None,
        redoc_url=None,
    )
    app.state.service = service
    app.include_router(routes.job_router)
    app.include_router(routes.about_router)
    app.include_router(page_routes.router)
    app.add_exception_handler(RefusedError, _refused)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(Exception, _failed)
    options = service.options
    names = None if options.tokens_required else LOOPBACK | {options.host}
    app.add_middleware(Guard, upload_mb=service.limits.upload_mb, open_hosts=names)
    app.add_middleware(_Counted)
    app.openapi = lambda: _openapi(app)  # type: ignore[method-assign]
    return app


class _Counted:
    """Counts answers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                known = scope["method"] if scope["method"] in METHODS else "other"
                REQUESTS.count(known, message["status"])
            await send(message)

        await self._app(scope, receive, counted if scope["type"] == "http" else send)


METHODS: Final = frozenset({"GET", "HEAD", "POST", "DELETE", "PUT", "PATCH", "OPTIONS"})
"""Methods that are counted by name; others are counted together."""


def _openapi(app: FastAPI) -> dict[str, Any]:
    """OpenAPI with the schemas of problem files among its components."""
    if app.openapi_schema is None:
        from planner.service.catalogue import (
            IN_OPENAPI,
            problem_schema,  # loads all processes
        )

        made = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        made["components"]["schemas"] |= problem_schema(IN_OPENAPI)[1]
        refusal = {"application/json": {"schema": {"$ref": "#/components/schemas/Refusal"}}}
        general = [str(one["description"]) for one in REFUSALS.values()]
        for path in made["paths"].values():
            for method in path.values():
                for status, answer in method["responses"].items():
                    # JSON, whatever a good answer is
                    if status[0] == "4" or answer["description"] in general:
                        answer["content"] = refusal
        app.openapi_schema = made
    return app.openapi_schema


async def _refused(request: Request, error: Exception) -> JSONResponse:
    del request
    if not isinstance(error, RefusedError):
        raise error
    return JSONResponse(error.body, error.status, headers=error.headers)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    issues = []
    for fault in error.errors():
        field = ".".join(str(step) for step in fault["loc"][1:]) or "body"
        got = "" if fault["type"] == "missing" else f", got {str(fault.get('input'))[:80]!r}"
        what = f"{field}: {fault['msg']}{got}; correct it"
        issues.append(Issue("service.request", what, field=field))
    return await _refused(request, RefusedError(422, issues))


async def _http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    allowed = (error.headers or {}).get("Allow")  # of an address that takes other methods
    way = f"; use {allowed}" if allowed else ""
    what = f"{request.method} {request.url.path[:200]}: {error.detail}{way}; see /openapi.json"
    code = "service.not_found" if error.status_code in (404, 405) else "service.request"
    return await _refused(request, RefusedError(error.status_code, Issue(code, what), error.headers))


async def _failed(request: Request, error: Exception) -> JSONResponse:
    LOG.error("%s %s failed", request.method, request.url.path, exc_info=error)
    issue = Issue("internal.error", "the service itself failed, and has written down how; report this")
    return await _refused(request, RefusedError(500, issue))


STREAMS_END_S: Final = 3
"""Streams that are open get so long to end when the service stops."""


def serve(options: Options, certificate: Path | None = None, key: Path | None = None) -> None:
    """Serve until told to stop: after SIGTERM it returns. Raises ``TandemError`` where it cannot start."""
    if (certificate is None) != (key is None):
        raise TandemError(
            Issue("service.start", "TLS needs --certificate and --key, give both", field="certificate")
        )
    if certificate is not None and key is not None:
        try:
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
        except (OSError, ssl.SSLError) as error:
            message = f"certificate {certificate} with key {key}: cannot be used ({error}); give PEM files"
            raise TandemError(Issue("service.start", message, field="certificate")) from error
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # a connection is a file
    service = Service(options, make_team(options))
    config = uvicorn.Config(
        create_app(service),
        host=options.host,
        port=options.port,
        log_level="info",
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=STREAMS_END_S,
        limit_concurrency=None,
        backlog=4096,
        h11_max_incomplete_event_size=64 * 1024,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    # Uvicorn raises the signal that ended it again when all is stopped; to be asked to end is no failure, so
    # nothing more is to be done then
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    _Server(config, service).run()


class _Server(uvicorn.Server):
    """Ends streams of events and the reading of uploads as soon as it is told to stop: nobody waits for
    them."""

    def __init__(self, config: uvicorn.Config, service: Service) -> None:
        super().__init__(config)
        self._service = service

    async def shutdown(self, sockets: list[object] | None = None) -> None:  # type: ignore[override]
        self._service.hub.close()
        self._service.stop_reading()
        await super().shutdown(sockets)  # type: ignore[arg-type]


def make_team(options: Options) -> Callable[[], Team]:
    """What plans the jobs: processes of this machine, or a cluster. Raises ``TandemError`` for a cluster that
    cannot be used."""
    memory_mb, count = options.limits.job_memory_mb, options.workers
    if options.cluster is None:
        return lambda: Workers(count, memory_mb=memory_mb)
    address = options.cluster
    first = [Cluster(address, count, memory_mb)]  # what is wrong is told at the start
    return lambda: first.pop() if first else Cluster(address, count, memory_mb)
