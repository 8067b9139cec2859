"""The application: routes, refusals, and the life of the service behind them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import planner
from planner.issues import Issue
from planner.service import routes_about, routes_jobs
from planner.service.context import REFUSALS
from planner.service.guard import LOOPBACK, Guard
from planner.service.metrics import REQUESTS
from planner.service.page import routes as routes_page
from planner.service.refusals import RefusedError
from planner.service.service import Service

LOG: Final = logging.getLogger("planner.service")
ABOUT: Final = """Plans the motion of two industrial robots that share one job. Problems go in as files,
programs come out if they are proven. Every refusal has `issues`, each with a `code` and the `field`."""


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
    app.include_router(routes_jobs.router)
    app.include_router(routes_about.router)
    app.include_router(routes_page.router)
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


def _openapi(app: FastAPI) -> dict[str, Any]:
    """OpenAPI with the schemas of problem files among its components."""
    if app.openapi_schema is None:
        from planner.service.schemas import IN_OPENAPI, problem_schema  # loads all processes

        made = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        made["components"]["schemas"] |= problem_schema(IN_OPENAPI)[1]
        refusal = {"application/json": {"schema": {"$ref": "#/components/schemas/Refusal"}}}
        told = [str(one["description"]) for one in REFUSALS.values()]
        for path in made["paths"].values():
            for method in path.values():
                for status, answer in method["responses"].items():
                    if status[0] == "4" or answer["description"] in told:  # JSON, whatever a good answer is
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
